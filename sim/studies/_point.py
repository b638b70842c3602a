"""The points of a design study: planned in TOML as whole designs, computed in a worker process, kept as records.

A point is its press, renders, metrics, and the record that keeps them. What is measured is the light and the colours
of the coat, how the touch shows, and force. The 95 % interval of a number of an image comes from independent renders
of the point and from their halves: it knows their noise (that of the baked walls included) and nothing of materials,
geometry or camera, which are the design's.
"""

import hashlib
import itertools
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import qmc
from scipy.stats import t as student_t

from data_schemas import (
    DesignStudy,
    DesignValue,
    FingerDesign,
    FingerSurfaces,
    PressMechanics,
    Provenance,
    Record,
    RecordError,
    SimulateError,
    StudyMetric,
    StudyPoint,
    explain,
)
from data_schemas.storage import (
    ProductSet,
    clear_leftovers,
    read_record,
    read_toml,
    write_bytes,
    write_record,
)
from sim import PRESETS, preset_design, read_design
from sim.experiments import (
    camera_rgb,
    coat_cells,
    design_digests,
    imprinted_shapes,
    paint_finger,
    press_records,
    vividness,
)
from sim.mechanics import PressSettings, press_as_designed
from sim.optics import (
    BAND_NAMES,
    PaintOptics,
    Preference,
    PressRender,
    RenderSettings,
    choose_variant,
    last_band,
    open_renderer,
    render_press,
    stream_seed,
)
from sim.surface_meshes import FingerShape, check_no_intersections, everyday_objects, restore_shapes

_PLANS: Final = Path(__file__).parent / "plans"
SHIPPED_PLANS: Final[tuple[str, ...]] = tuple(sorted(path.stem for path in _PLANS.glob("*.toml")))
"""Names of the plans that come with the package: the paper's experiments."""
PRESET: Final = "preset"
SEED: Final = "seed"


@dataclass(frozen=True, slots=True)
class PlannedPoint:
    """One point of a study.

    Attributes
    ----------
    number
        From 1, in the order of the plan.
    changes
        What the point changes, by dotted field.
    design
        The whole finger.
    seed
        Of its renders.
    """

    number: int
    changes: dict[str, DesignValue]
    design: FingerDesign
    seed: int


def read_plan(name_or_path: str | Path) -> tuple[DesignStudy, Path]:
    """Read a plan by its file, or one that comes with the package by its name; return it and its file.

    Raises
    ------
    RecordError
        There is neither a file nor a shipped plan of this name, or the file is no plan.
    """
    path = Path(name_or_path)
    # the folder of an earlier run of a shipped plan has its name
    if not path.is_file() and str(name_or_path) in SHIPPED_PLANS:
        path = _PLANS / f"{name_or_path}.toml"
    if not path.exists():
        raise RecordError(
            f"{path}: no such plan; give a plan file (TOML) or one of the shipped plans, {', '.join(SHIPPED_PLANS)}"
        )
    return read_toml(path, DesignStudy), path


def study_points(plan: DesignStudy, path: Path) -> list[PlannedPoint]:
    """Return the points of a plan, each with its whole design.

    All points of a random study together are a scrambled Sobol' sample of the box of its ranges.

    Parameters
    ----------
    plan, path
        From :func:`read_plan`; a design file is looked for beside the plan.

    Raises
    ------
    SimulateError
        A point is no finger: a field is unknown or a value is not allowed. The message names point and field.
    """
    points = []
    for number, changes in enumerate(_changes(plan), start=1):
        base = _base(plan, path, changes)
        try:
            drawn = set(changes) if plan.combine == "random" else set()
            design, taken = _changed(base, {**plan.set, **changes}, drawn)
        except ValidationError as error:
            raise SimulateError(f"{path}, point {number} ({_words(changes)}): {explain(error, FingerDesign)}") from None
        except SimulateError as error:
            raise SimulateError(f"{path}: point {number} ({_words(changes)}): {error}") from None
        taken[SEED] = seed = _seed(plan, changes, path)
        points.append(PlannedPoint(number, {f: taken.get(f, value) for f, value in changes.items()}, design, seed))
    return points


def _changes(plan: DesignStudy) -> Iterator[dict[str, DesignValue]]:
    """Yield what each point changes."""
    fields = [variation.field for variation in plan.vary]
    if plan.combine == "random":
        low = [float(variation.low or 0.0) for variation in plan.vary]
        high = [float(variation.high or 0.0) for variation in plan.vary]
        # a power of two of points keeps the sample balanced; what is too many is left out
        exponent = max(1, (int(plan.count or 2) - 1).bit_length())
        sample = qmc.Sobol(len(fields), seed=plan.seed).random_base2(exponent)[: plan.count]
        rows: Iterator[tuple[DesignValue, ...]] = (
            tuple(float(value) for value in row) for row in qmc.scale(sample, low, high)
        )
    else:
        together = zip if plan.combine == "together" else itertools.product
        rows = iter(together(*(variation.values for variation in plan.vary)))
    for row in rows:
        yield dict(zip(fields, row, strict=True))


def _base(plan: DesignStudy, path: Path, changes: Mapping[str, DesignValue]) -> FingerDesign:
    """Return the design that a point starts from."""
    name = changes.get(PRESET, plan.design)
    if not isinstance(name, str):
        raise SimulateError(f"{path}: preset must be the name of a ready-made finger, got {name!r}")
    file = path.parent / name
    if PRESET not in changes and name not in PRESETS:
        return read_design(file)
    try:
        return preset_design(name)
    except SimulateError as error:
        raise SimulateError(f"{path}: {error}") from None


def _changed(
    base: FingerDesign, changes: Mapping[str, DesignValue], drawn: set[str]
) -> tuple[FingerDesign, dict[str, DesignValue]]:
    """Return a design with other values, and these; what a value came from no longer holds where it is changed."""
    tables = base.model_dump(mode="python", exclude={"provenance"})
    taken = {f: _set(tables, f, value, f in drawn) for f, value in changes.items() if f not in (PRESET, SEED)}
    tables["origin"] = {field: where for field, where in base.origin.items() if field not in changes}
    return FingerDesign.model_validate(tables), taken


def _set(tables: dict[str, Any], field: str, value: DesignValue, is_drawn: bool) -> DesignValue:
    """Put a value at a dotted field and return it; where a whole number stands, a drawn one is rounded to one."""
    *above, last = field.split(".")
    table: Any = tables
    for name in above:
        table = table.get(name) if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise SimulateError(
            f"'{field}' is not a field of this finger, because it has no [{'.'.join(above)}]; 'finray design init' "
            "writes a file with all fields"
        )
    if last not in table:
        raise SimulateError(f"'{field}' is not a field of a design; 'finray design init' writes a file with all fields")
    is_whole = isinstance(table[last], int) and not isinstance(table[last], bool)
    table[last] = value = round(value) if is_whole and is_drawn and isinstance(value, float) else value
    return value


def _seed(plan: DesignStudy, changes: Mapping[str, DesignValue], path: Path) -> int:
    """Return the seed of a point: the study's, so that points share their random numbers, unless it is varied."""
    seed = changes.get(SEED, plan.seed)
    is_drawn = SEED in changes and plan.combine == "random"
    if isinstance(seed, bool) or not isinstance(seed, int | float) or seed < 0 or not (is_drawn or seed == int(seed)):
        raise SimulateError(f"{path}: seed must be a whole number of 0 or more, got {seed!r}")
    return int(seed)


def _words(changes: Mapping[str, DesignValue]) -> str:
    """Say what a point changes."""
    return ", ".join(f"{field} = {value}" for field, value in changes.items())


POINTS: Final = "points"
PRESSES: Final = "presses"
OBJECTS: Final = "objects"
STUDY_FOLDERS: Final = (POINTS, PRESSES, OBJECTS)
"""Folders by which a study's own folder is known."""


def design_folder(path: Path, points: Sequence[PlannedPoint], out: Path) -> Path:
    """Return where relative paths in a study's designs start: beside its plan.

    The objects that a shipped plan presses in are written into the folder of the study first.
    """
    if path.parent != _PLANS:
        return path.parent.absolute()
    folder = out.absolute() / OBJECTS
    _write_everyday_objects({point.design.indenter.file or "" for point in points} - {""}, folder)
    return folder


_OPTICAL_PARTS: Final = {
    "name", "coating", "light", "second_light", "further_lights", "camera", "materials", "origin", "provenance",
}  # fmt: skip
"""Parts of a design that do not change a press, but for how far down panels reach: the base plate lies below them.

Points that differ in these alone share one press.
"""


@dataclass(frozen=True, slots=True)
class StudyPaints:
    """The paints of a study: their optics, and by colour their origin, which is part of a point's identity."""

    optics: Mapping[str, PaintOptics]
    sources: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class StudyTask:
    """What every point of a study needs besides its own design.

    Attributes
    ----------
    plan
        The study.
    paints
        Of the walls.
    engine
        Of the renderer.
    folder
        Where the study is kept; one that all workers see.
    design_folder
        Where relative paths in the design start.
    origin
        Of the records.
    renew
        Whether points and presses that other code computed are computed anew.
    """

    plan: DesignStudy
    paints: StudyPaints
    engine: Preference
    folder: Path
    design_folder: Path
    origin: Provenance
    renew: bool = False


def point_file(folder: Path, number: int) -> Path:
    """Return the record of a point."""
    return folder / POINTS / f"{number:05d}.json"


def point_key(task: StudyTask, point: PlannedPoint) -> str:
    """Return the SHA-256 of what a point is computed from."""
    return _sha256(
        {
            "design": point.design.model_dump(mode="json", exclude={"provenance"}),
            **design_digests(point.design, task.design_folder, ["indenter"] + ["camera"] * task.plan.measure.images),
            "measure": task.plan.measure.model_dump(mode="json"),
            "seed": point.seed,
            "paints": dict(task.paints.sources) if task.plan.measure.images else {},
        }
    )


def press_file(task: StudyTask, design: FingerDesign) -> Path | None:
    """Return the surfaces of the press that a design needs, named by what it is computed from; None: no press."""
    if task.plan.measure.press == "analytic":
        return None
    known = design.model_dump(mode="json", exclude=_OPTICAL_PARTS)
    panels_mm = min(light.position_mm[2] - light.height_mm / 2.0 for light in design.lights)
    increments = task.plan.measure.increments
    indenter = design_digests(design, task.design_folder, ["indenter"])
    digest = _sha256({"design": known, **indenter, "increments": increments, "panels_mm": panels_mm})
    return task.folder / PRESSES / f"{digest[:16]}.surfaces.json"


def has_press(task: StudyTask, surfaces_file: Path) -> bool:
    """Return whether a press is kept, and need not be computed anew."""
    if not surfaces_file.exists():
        return False
    return not task.renew or _code(read_record(_mechanics_file(surfaces_file), PressMechanics)) == task.origin.code


def compute_press(task: StudyTask, design: FingerDesign) -> None:
    """Press a finger by finite elements on one core, and keep force and surfaces together."""
    surfaces_file = press_file(task, design)
    if surfaces_file is None or has_press(task, surfaces_file):
        return
    surfaces_file.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(surfaces_file.parent)
    settings = PressSettings(None, task.plan.measure.increments, 1)
    pressed = press_as_designed(design, settings, folder=task.design_folder)
    mechanics, surfaces = press_records(design, pressed)
    _remove(surfaces_file, surfaces_file.name.removesuffix(".surfaces.json"))
    with ProductSet(surfaces_file) as products:
        write_record(mechanics, _mechanics_file(surfaces_file), task.origin.of_this_process(), products)
        write_record(surfaces, surfaces_file, task.origin.of_this_process(), products)


def compute_point(task: StudyTask, point: PlannedPoint) -> None:
    """Compute a point and keep it; what it shares with others was computed before."""
    if stored_point(task, point) is not None:  # a worker that died after it had written
        return
    file = point_file(task.folder, point.number)
    file.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(file.parent)
    begun = time.process_time()
    metrics: list[StudyMetric] = []
    pressed = press_file(task, point.design)
    surfaces = None
    if pressed is not None:
        surfaces = read_record(pressed, FingerSurfaces)
        metrics += mechanics_metrics(read_record(_mechanics_file(pressed), PressMechanics))
    pictures: dict[str, NDArray[np.float32]] = {}
    notes: tuple[str, ...] = ()
    if task.plan.measure.images:
        found, pictures, notes = _rendered(task, point, surfaces)
        metrics += found
    record = StudyPoint(
        study=task.plan.name,
        number=point.number,
        key=point_key(task, point),
        changes=point.changes,
        design=point.design,
        metrics=tuple(metrics),
        no_contact=pictures.get("no_contact"),
        contact=pictures.get("contact"),
        notes=notes,
        processor_s=time.process_time() - begun,
    )
    _remove(file, file.stem)
    write_record(record, file, task.origin.of_this_process())


def _remove(file: Path, name: str) -> None:
    """Remove a record that other code wrote, with its arrays, just before it is written anew."""
    if file.exists():
        for part in file.parent.glob(f"{name}.*"):
            part.unlink()


def stored_point(task: StudyTask, point: PlannedPoint) -> StudyPoint | None:
    """Return a point that is kept already and need not be computed anew.

    Raises
    ------
    SimulateError
        The folder holds a point of this number that was computed from something else.
    """
    file = point_file(task.folder, point.number)
    if not file.exists():
        return None
    record = read_record(file, StudyPoint)
    if record.key != point_key(task, point):
        raise SimulateError(
            f"{file}: was computed from another plan, design, paint or seed; give another --out, or the plan as it "
            f"was before"
        )
    return record if not task.renew or point_code(task, record) == task.origin.code else None


def point_code(task: StudyTask, point: StudyPoint) -> str:
    """Return version and commit of the code that computed a point, and those of its press where they are others."""
    code, pressed = _code(point), press_file(task, point.design)
    if pressed is None or not pressed.exists():
        return code
    press = _code(read_record(_mechanics_file(pressed), PressMechanics))
    return code if press == code else f"{code}; its press by {press}"


def _code(record: Record) -> str:
    """Return version and commit of the code that wrote a record."""
    return record.provenance.code if record.provenance is not None else "unknown code"


def _rendered(
    task: StudyTask, point: PlannedPoint, surfaces: FingerSurfaces | None
) -> tuple[tuple[StudyMetric, ...], dict[str, NDArray[np.float32]], tuple[str, ...]]:
    """Return the metrics of a point's renders, their mean images in camera RGB, and what is said of them."""
    measure, renderer = task.plan.measure, open_renderer(choose_variant(task.engine), threads=1)
    design = point.design
    if surfaces is not None and surfaces.push_mm is not None:
        indenter = design.indenter.model_copy(update={"depth_mm": surfaces.push_mm})
        design = design.model_copy(update={"indenter": indenter})
    finger = paint_finger(design, task.paints.optics, task.design_folder, renderer)
    shapes = imprinted_shapes(design, task.design_folder) if surfaces is None else _searched(restore_shapes(surfaces))
    renders: list[PressRender] = [
        render_press(
            design,
            finger.paints,
            renderer,
            # the same seeds for all points of a study, so that differences share their noise
            RenderSettings("b", stream_seed(point.seed, k), measure.samples),
            shapes=shapes,
            calibration=finger.calibration,
        )
        for k in range(measure.repeats)
    ]
    matrix = finger.camera_matrix(renders[0].bands)
    pictures = {
        name: camera_rgb(np.mean([getattr(r, f"{name}_bands") for r in renders], axis=0), matrix)
        for name in ("no_contact", "contact")
    }
    notes = (renders[0].label, f"shape of the finger: {renders[0].contact_label}")
    replicates = [half for render in renders for half in independent_halves(render)]
    return image_metrics(design, replicates, matrix), pictures, (*notes, *finger.coverage_notes(renders[0].bands))


def independent_halves(render: PressRender) -> tuple[PressRender, ...]:
    """Return a render's two halves, each with its own paths and its own batches of the walls' light.

    Intervals are as narrow with half as many renders. A render that does not hold its chains apart is returned whole:
    its halves share light that one paint excites in another.
    """
    if not render.chains_apart:
        return (render,)
    of_band = np.array([[last_band(c) == band for band in BAND_NAMES] for c in render.chains], dtype=np.float32)
    before, after = (d @ of_band for d in (render.no_contact_half_difference, render.contact_half_difference))
    return tuple(
        replace(
            render,
            no_contact_bands=render.no_contact_bands + sign * before,
            contact_bands=render.contact_bands + sign * after,
        )
        for sign in (np.float32(1.0), np.float32(-1.0))
    )


def _searched(shapes: tuple[FingerShape, FingerShape]) -> tuple[FingerShape, FingerShape]:
    """Return shapes that do not pass through themselves, searched once for all repeats."""
    for shape in shapes:
        check_no_intersections(shape.gel)
    rest, pressed = shapes
    return replace(rest, is_apart=True), replace(pressed, is_apart=True)


def _mechanics_file(surfaces_file: Path) -> Path:
    """Return the record of the force beside that of the surfaces."""
    return surfaces_file.with_name(surfaces_file.name.replace(".surfaces.", ".mechanics."))


def _sha256(content: dict[str, Any]) -> str:
    """Return the SHA-256 of content as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


Floats = NDArray[np.float64]

CELL_MM = 2.5
"""Side of the cells that the coat's light is averaged over."""

HALO = 2.0
"""The touch is looked for up to this many half-widths of the contact, as comparisons do."""
_TOUCH = "touch_rel"

_MEANINGS: dict[str, tuple[str, str]] = {
    "seen_area_mm2": ("mm2", "area of the coat that the camera sees through the mirror, without contact"),
    "brightness_rel": ("radiance of the panel", "mean of the camera's channels over the visible coat, without contact"),
    "variation_rel": (
        "1",
        "standard deviation of brightness over the visible coat, relative to its mean: 0 is even light",
    ),
    **{
        f"{name}_share": (
            "1",
            f"share of the visible coat where the light of the {source} is strongest, each light relative to its own "
            "mean",
        )
        for name, source in (("red", "red paint"), ("green", "green paint"), ("blue", "LED"))
    },
    "vividness": (
        "CIELAB chroma",
        "mean chroma of the visible coat, exposed to middle grey and white-balanced so that the coat is grey on "
        "average",
    ),
    _TOUCH: (
        "1",
        f"change of brightness by the touch, rms over cells of {CELL_MM:g} mm of contact and halo, relative to the "
        "brightness there",
    ),
    "force_n": (
        "N",
        "force of the indenter along the pad's normal at the end of the push, not validated; the limits come from the "
        "mesh",
    ),
    "push_mm": ("mm", "push that was reached"),
}


@dataclass(frozen=True, slots=True)
class _Seen:
    """What one render shows: light of the coat's cells, and brightness of those of contact and halo.

    Attributes
    ----------
    light
        Of the three bands in the camera, (cell, 3).
    rgb
        Camera RGB without contact, (cell, 3).
    before, after
        Brightness near the contact, without it and with it, by cells of the coat that the pixels see without it.
    """

    light: Floats
    rgb: Floats
    before: Floats
    after: Floats


def image_metrics(design: FingerDesign, renders: Sequence[PressRender], matrix: Floats) -> tuple[StudyMetric, ...]:
    r"""Return the metrics of a point's renders, or of their halves.

    Squares, of the spread over the coat and of the change by the touch, are products of two independent renders, whose
    noise averages out. Limits by the jackknife over the renders,

    .. math:: u^2 = \frac{R - 1}{R} \sum_i (\theta_{(i)} - \bar\theta)^2,

    with Student's t of R - 1 degrees of freedom; the limits of the touch are roots of those of its square.

    Parameters
    ----------
    design
        The finger.
    renders
        R independent renders of it, or halves of renders; at least three.
    matrix
        Camera RGB from bands, (3, 3).
    """
    seen = [_seen(design, render, matrix) for render in renders]
    count, whole = len(seen), _metrics(seen)
    without = [_metrics([*seen[:i], *seen[i + 1 :]]) for i in range(count)]
    t95 = float(student_t.ppf(0.975, count - 1))
    area_mm2 = len(seen[0].rgb) * _cell_area_mm2(design)
    found = [_metric("seen_area_mm2", area_mm2, None)]
    for name, value in whole.items():
        others = np.array([values[name] for values in without])
        reach95 = t95 * float(np.sqrt((count - 1) / count * ((others - others.mean()) ** 2).sum()))
        if name == _TOUCH:  # its square may be 0 within its noise, where the root has no spread of its own
            low, high = _root(value - reach95), _root(max(value, 0.0) + reach95)
            found.append(_metric(name, _root(value), None).model_copy(update={"low95": low, "high95": high}))
        else:
            found.append(_metric(name, value, reach95))
    return tuple(found)


def mechanics_metrics(mechanics: PressMechanics) -> tuple[StudyMetric, ...]:
    """Return force and push of a press by finite elements, the force with what its mesh leaves open."""
    force = _metric("force_n", float(mechanics.force_n[-1, 1]), None)
    if mechanics.mesh_excess_rel is not None:
        low = force.value / (1.0 + mechanics.mesh_excess_rel)
        force = force.model_copy(update={"low95": low, "high95": force.value})
    return force, _metric("push_mm", float(mechanics.depth_mm[-1]), None)


def _seen(design: FingerDesign, render: PressRender, matrix: Floats) -> _Seen:
    """Return what one render shows."""
    place = render.no_contact_maps.coat_mm(design)
    cells, _ = coat_cells(design, place, np.isfinite(place[..., 0]), render, matrix, CELL_MM)
    lit = cells[np.isfinite(cells[..., 0])]
    if not len(lit):
        raise SimulateError(
            f"the pixels are too coarse, because no cell of {CELL_MM:g} mm on the coat covers four pixels; raise "
            f"camera.width_px and camera.height_px ({design.camera.width_px} x {design.camera.height_px}), or turn the "
            "camera towards the coat"
        )
    bands, weights = len(BAND_NAMES), matrix.mean(axis=0)
    near = (render.contact_maps.contact_distance <= HALO) & np.isfinite(place[..., 0])
    _, cell = np.unique((place[near] // CELL_MM).astype(int), axis=0, return_inverse=True)
    pixels = np.bincount(cell.ravel())
    before, after = (
        np.bincount(cell.ravel(), image[near] @ weights) / pixels
        for image in (render.no_contact_bands, render.contact_bands)
    )
    return _Seen(lit[:, :bands] * matrix.sum(axis=0), lit[:, bands:], before, after)


def _cell_area_mm2(design: FingerDesign) -> float:
    """Return the area of one cell of the coat."""
    along, across = round(design.pad.length_mm / CELL_MM), round(design.pad.width_mm / CELL_MM)
    return design.pad.length_mm * design.pad.width_mm / (along * across)


def _metrics(seen: Sequence[_Seen]) -> dict[str, float]:
    """Return the metrics of at least two independent renders; of the change by the touch its square."""
    rgb = np.mean([one.rgb for one in seen], axis=0)
    light = np.mean([one.light for one in seen], axis=0)
    leads = np.argmax(light / light.mean(axis=0), axis=-1)
    brightness = np.array([one.rgb.mean(axis=-1) for one in seen])
    level = float(brightness.mean())
    found = {
        "brightness_rel": level,
        "variation_rel": _root(_mean_product(brightness - brightness.mean(axis=1, keepdims=True))) / level,
        **{f"{name}_share": float(np.mean(leads == k)) for k, name in enumerate(("red", "green", "blue"))},
        "vividness": vividness(rgb),
    }
    if seen[0].before.size:
        changes = np.array([one.after - one.before for one in seen])
        found[_TOUCH] = _mean_product(changes) / float(np.mean([one.before for one in seen])) ** 2
    return found


def _mean_product(values: Floats) -> float:
    """Return the mean product of two different rows, (row, n), whose noise averages out; it may become negative."""
    count, n = values.shape
    return float(((values.sum(axis=0) ** 2).sum() - (values**2).sum()) / (count * (count - 1) * n))


def _root(square: float) -> float:
    """Return a root, zero where noise makes its square negative."""
    return float(np.sqrt(max(square, 0.0)))


def _metric(name: str, value: float, reach95: float | None) -> StudyMetric:
    """Return a number with its words, and with limits where they are known."""
    unit, meaning = _MEANINGS[name]
    low, high = (None, None) if reach95 is None else (value - reach95, value + reach95)
    return StudyMetric(name=name, value=value, low95=low, high95=high, unit=unit, meaning=meaning)


def _write_everyday_objects(names: Iterable[str], folder: Path) -> None:
    """Write those of the named objects that are not in a folder yet."""
    missing = {name for name in names if not (folder / name).exists()}
    for name, content in everyday_objects().items() if missing else ():
        if name in missing:
            folder.mkdir(parents=True, exist_ok=True)
            write_bytes(folder / name, content)
