"""A data set for learning: random presses of a design, rendered in worker processes, stored in shards of TAR.

A press is drawn from its number and the seed, and so are its lights and paints: which worker computes it, and when,
does not matter. A shard holds a range of presses. It is written under a hidden name and gets its own together with its
record, so that whatever ends the run loses the shards in flight only, and the same command continues with the others.
"""

import functools
import hashlib
import io
import json
import math
import tarfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    DatasetFailure,
    DatasetPlan,
    DatasetSample,
    DatasetShard,
    DatasetSplit,
    FingerDesign,
    FinrayError,
    PathPose,
    PressMechanics,
    Provenance,
    SimulateError,
    why_failed,
)
from data_schemas.storage import ProductSet, clear_leftovers, read_record, write_record
from sim.experiments import (
    PaintDraws,
    PaintedFinger,
    RenderedSample,
    SamplePaints,
    design_digests,
    paint_finger,
    press_records,
    render_noise_rel,
    render_samples,
    sampled_paints,
)
from sim.mechanics import PressSettings, press_as_designed
from sim.optics import Preference, RenderSettings, camera_view, choose_variant, open_renderer
from sim.studies._engine import Progress, each_computed, not_seen, when_seen
from sim.surface_meshes import FingerShape, check_analytic_press, contact_half_width_mm, restore_shapes

Floats = NDArray[np.float64]

SHARDS: Final = "shards"
VERSION: Final = 1
"""Part of a shard's key: it is raised when the same plan gives other samples."""
VERSION_OF_PATHS: Final = 2
"""The same for designs whose indenter moves along a path."""

_SPLIT_CYCLE: Final = 10
_SPLIT_OF: Final[Mapping[int, DatasetSplit]] = {8: "validation", 9: "test"}
_RENDER_STREAM: Final = 1
_PRESS_STREAM, _LIGHT_STREAM, _PAINT_STREAM = 2, 3, 4
_MOST_SEED: Final = 2**31


@dataclass(frozen=True, slots=True)
class DatasetTask:
    """What every shard of a data set needs.

    Attributes
    ----------
    plan
        What is drawn.
    paints
        "red" and "green": their optics and the draws of their emission, one draw where there is no posterior.
    sources
        Colour -> where the paint comes from; part of what a shard is known by.
    engine
        Of the renderer.
    folder
        Where the data set is kept; one that all workers see.
    design_folder
        Where relative paths in the design start.
    origin
        Of the records.
    """

    plan: DatasetPlan
    paints: Mapping[str, PaintDraws]
    sources: Mapping[str, str]
    engine: Preference
    folder: Path
    design_folder: Path
    origin: Provenance


@dataclass(frozen=True, slots=True)
class PlannedShard:
    """One shard: its number from 0 and its presses."""

    number: int
    presses: range


def planned_shards(plan: DatasetPlan, presses: int) -> list[PlannedShard]:
    """Return the shards of a data set, the last one with the remaining presses.

    Raises
    ------
    SimulateError
        An indenter of the plan's ranges does not fit the pad, or the analytic press cannot shape it.
    """
    _require_room(plan)
    size = plan.presses_per_shard
    starts = range(0, presses, size)
    return [PlannedShard(k, range(first, min(first + size, presses))) for k, first in enumerate(starts)]


def _require_room(plan: DatasetPlan) -> None:
    """Check that the largest indenter of a plan leaves room on the pad wherever it is pressed in."""
    for shape in plan.shapes:
        indenter = plan.design.indenter.model_copy(
            update={"shape": shape, "radius_mm": plan.radius_mm[1], "depth_mm": plan.depth_mm[1], "across_mm": 0.0,
                    "rotation_deg": (0.0, 0.0, 0.0), "size_mm": None, "file": None}
        )  # fmt: skip
        largest = plan.design.model_copy(update={"indenter": indenter})
        if plan.press == "analytic":
            check_analytic_press(largest)
        room = _room_mm(largest)
        if min(room) <= 0.0:
            aside = ", and indenter.path moves it aside" if indenter.path else ""
            raise SimulateError(
                f"a {shape} of {plan.radius_mm[1]:g} mm radius, {plan.depth_mm[1]:g} mm deep, leaves no room on the "
                f"pad of {plan.design.pad.length_mm:g} x {plan.design.pad.width_mm:g} mm, because its contact is "
                f"{2.0 * float(contact_half_width_mm(largest)):.3g} mm wide{aside}; give a smaller --radius-mm or "
                "--depth-mm"
            )


def _room_mm(design: FingerDesign) -> tuple[float, float]:
    """Return how far a contact's middle may be from that of the pad, along and across; a cylinder stays on the line."""
    half, (along, across) = float(contact_half_width_mm(design)), _reach_mm(design.indenter.path)
    ball = half + across[1] if design.indenter.shape == "ball" else 0.0
    return design.pad.length_mm / 2.0 - half - along[1], design.pad.width_mm / 2.0 - ball


def _reach_mm(path: tuple[PathPose, ...]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return middle and half width of where a path moves to along the pad, and across it; it starts at 0, 0."""
    ways = np.array([[0.0, 0.0], *([pose.along_mm, pose.across_mm] for pose in path)])
    low, high = ways.min(axis=0), ways.max(axis=0)
    middles, halves = ((low + high) / 2.0).tolist(), ((high - low) / 2.0).tolist()
    return (middles[0], halves[0]), (middles[1], halves[1])


def split_of(press: int) -> DatasetSplit:
    """Return the part that a press belongs to: of ten presses eight train, one validates, one tests.

    Presses are independent draws, so that any fixed rule is a random split; this one does not change when a set grows.
    """
    return _SPLIT_OF.get(press % _SPLIT_CYCLE, "train")


def sampled_press(plan: DatasetPlan, press: int) -> FingerDesign:
    """Return the design with the indenter of a press: shape, radius, depth and place drawn evenly.

    The whole contact lies on the pad, wherever the indenter's path moves it aside.

    Parameters
    ----------
    plan
        Ranges.
    press
        Number of the press.
    """
    rng = np.random.default_rng((plan.seed, _PRESS_STREAM, press))
    radius = float(rng.uniform(*plan.radius_mm))
    indenter = plan.design.indenter.model_copy(
        update={
            "shape": plan.shapes[int(rng.integers(len(plan.shapes)))],
            "radius_mm": radius,
            "depth_mm": float(rng.uniform(*plan.depth_mm)),
            "rotation_deg": (0.0, 0.0, 0.0),
            "size_mm": None,
            "file": None,
        }
    )
    along, across = _room_mm(plan.design.model_copy(update={"indenter": indenter}))
    place, aside = rng.uniform(-1.0, 1.0, 2), _reach_mm(indenter.path)
    placed: dict[str, Any] = {
        "position_mm": plan.design.pad.length_mm / 2.0 - aside[0][0] + along * float(place[0]),
        "across_mm": across * float(place[1]) - aside[1][0] if indenter.shape == "ball" else 0.0,
        "path": _to_depth(indenter.path, indenter.depth_mm),
    }
    return plan.design.model_copy(update={"indenter": indenter.model_copy(update=placed)})


def _to_depth(path: tuple[PathPose, ...], depth_mm: float) -> tuple[PathPose, ...]:
    """Return a path whose pushes are scaled so that the deepest is as deep as was drawn; its moves aside stay."""
    if not path:
        return path
    deepest = max(pose.push_mm for pose in path)
    if deepest <= 0.0:
        raise SimulateError(
            f"indenter.path: no pose pushes into the pad (the largest push_mm is {deepest:g} mm), but a data set "
            "scales the deepest push of a path to a randomly drawn depth; give at least one pose with push_mm above 0"
        )
    return tuple(pose.model_copy(update={"push_mm": pose.push_mm * depth_mm / deepest}) for pose in path)


def sampled_light(plan: DatasetPlan, design: FingerDesign, press: int, light: int) -> FingerDesign:
    """Return a design with the angles of its panels drawn evenly around their own, from -180 to 180 deg.

    Parameters
    ----------
    plan
        Reach of the angles.
    design
        With its press.
    press, light
        Numbers of the press and of the draw.
    """
    rng = np.random.default_rng((plan.seed, _LIGHT_STREAM, press, light))
    reach = plan.light_angle_reach_deg

    def turned(panel: Any) -> Any:
        angle_deg = panel.angle_deg + float(rng.uniform(-reach, reach))
        return panel.model_copy(update={"angle_deg": math.remainder(angle_deg, 360.0)})

    return design.model_copy(
        update={
            "light": turned(design.light),
            "second_light": None if design.second_light is None else turned(design.second_light),
            "further_lights": tuple(turned(panel) for panel in design.further_lights),
        }
    )


def shard_key(task: DatasetTask, shard: PlannedShard) -> str:
    """Return the SHA-256 of what a shard is computed from; the number of presses of the whole set is no part of it."""
    known = {
        "version": VERSION_OF_PATHS if task.plan.design.indenter.path else VERSION,
        "plan": task.plan.model_dump(mode="json", exclude={"design": {"provenance"}}),
        **design_digests(task.plan.design, task.design_folder, ["camera"]),
        "paints": dict(task.sources),
        "presses": [shard.presses.start, shard.presses.stop],
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def shard_file(folder: Path, number: int) -> Path:
    """Return the TAR file of a shard; its record has the same name with .json."""
    return folder / SHARDS / f"shard-{number:06d}.tar"


def stored_shard(task: DatasetTask, shard: PlannedShard) -> DatasetShard | None:
    """Return the record of a shard that is kept already.

    Raises
    ------
    SimulateError
        The folder holds a shard of this number that was computed from something else.
    """
    file = shard_file(task.folder, shard.number).with_suffix(".json")
    if not file.exists():
        return None
    record = read_record(file, DatasetShard)
    if record.key != shard_key(task, shard):
        raise SimulateError(
            f"{file}: was computed from another design or seed, other ranges or paints, or contains fewer presses than "
            "planned; give another --out, or the same options as before (a data set can grow only by whole shards)"
        )
    return record


def run_dataset(
    task: DatasetTask,
    shards: Sequence[PlannedShard],
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> tuple[list[DatasetShard], list[DatasetFailure]]:
    """Compute what a data set still lacks; return the records of its shards, and presses that failed.

    A shard that was computed and is not seen after a minute, as on a slow network file system, counts as failed; the
    next run takes it up where it is there by then, and computes it again where it is not.

    Parameters
    ----------
    task
        What all shards need.
    shards
        From :func:`planned_shards`.
    workers, scheduler, progress
        As of :func:`sim.studies.run_study`.

    Raises
    ------
    SimulateError
        The folder holds shards of something else, or the scheduler does not answer.
    MissingExtraError
        Dask is not installed.
    """
    clear_leftovers(task.folder / SHARDS)  # the last shard of a run that was killed may be whole already
    todo = [shard for shard in shards if stored_shard(task, shard) is None]
    failed: dict[int, str] = {}
    for shard, reason in each_computed(_try_shard, task, todo, "shard ", (workers, scheduler), progress, task.folder):
        if reason is not None:
            failed[shard.number] = reason
    whole = [shard for shard in shards if shard.number not in failed]
    found = when_seen(functools.partial(stored_shard, task), whole, task.folder / SHARDS)
    kept = [record for record in found.values() if record is not None]
    failed |= {number: not_seen(task.folder) for number, record in found.items() if record is None}
    lost = [(shard, failed[shard.number]) for shard in shards if shard.number in failed]
    return kept, [
        *(failure for record in kept for failure in record.failures),
        *(DatasetFailure(press=press, reason=reason) for shard, reason in lost for press in shard.presses),
    ]


def _try_shard(task: DatasetTask, shard: PlannedShard) -> str | None:
    """Compute a shard, in a worker; return why it failed."""
    try:
        compute_shard(task, shard)
    except FinrayError as error:
        return why_failed(error)
    return None


def compute_shard(task: DatasetTask, shard: PlannedShard) -> None:
    """Compute a shard and keep it with its record; a press that fails is told there and stops no other."""
    if stored_shard(task, shard) is not None:  # a worker that died after it had written
        return
    file = shard_file(task.folder, shard.number)
    file.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(file.parent)
    begun = time.process_time()
    samples: list[DatasetSample] = []
    failures: list[DatasetFailure] = []
    members: list[tuple[str, bytes]] = []
    for press in shard.presses:
        try:
            for sample, truth in press_samples(task, press):
                samples.append(sample)
                members += sample_members(sample, truth)
        except FinrayError as error:
            failures.append(DatasetFailure(press=press, reason=why_failed(error)))
    content = shard_bytes(members)
    record = DatasetShard(
        number=shard.number,
        key=shard_key(task, shard),
        sha256=hashlib.sha256(content).hexdigest(),
        samples=tuple(samples),
        failures=tuple(failures),
        processor_s=time.process_time() - begun,
    )
    with ProductSet(file.with_suffix(".json")) as products:
        products.add(file, content)
        write_record(record, file.with_suffix(".json"), task.origin.of_this_process(), products)


def press_samples(task: DatasetTask, press: int) -> list[tuple[DatasetSample, RenderedSample]]:
    """Return all samples of one press: each light rendered once, each paint by arithmetic.

    Parameters
    ----------
    task
        Plan, paints and renderer.
    press
        Number of the press.

    Raises
    ------
    SimulateError
        The press or a render fails.
    """
    plan = task.plan
    renderer = open_renderer(choose_variant(task.engine), threads=1)
    pressed = _pressed(task, sampled_press(plan, press))
    found = []
    for light in range(plan.lights):
        design = sampled_light(plan, pressed.design, press, light)
        optics = {colour: paint.optics for colour, paint in task.paints.items()}
        finger = paint_finger(design, optics, task.design_folder, renderer)
        looks = [_sampled_look(task, finger, press, light, paint) for paint in range(plan.paints)]
        seed = _render_seed(plan.seed, press, light)
        truths, render = render_samples(
            finger, looks, RenderSettings("b", seed, plan.samples_per_pixel), pressed.shapes
        )
        noise = render_noise_rel(finger, render)
        largest = float(np.nanmax(render.contact_maps.depth_mm))
        for paint, (look, truth) in enumerate(zip(looks, truths, strict=True)):
            label = DatasetSample(
                sample=(press * plan.lights + light) * plan.paints + paint,
                press=press,
                split=split_of(press),
                light=light,
                paint=paint,
                indenter=design.indenter,
                light_angles_deg=tuple(panel.angle_deg for panel in design.lights),
                emission_draws=dict(look.draws),
                emission_factors=dict(look.factors),
                render_seed=seed,
                gains=truth.gains,
                clipped_share=truth.clipped_share,
                render_noise_rel=noise,
                largest_depth_mm=largest,
                force_n=pressed.force_n,
                slip_torque_per_friction_n_mm=pressed.slip_torque_per_friction_n_mm,
            )
            found.append((label, truth))
    return found


def _render_seed(seed: int, press: int, light: int) -> int:
    """Return the seed of a render."""
    words = np.random.SeedSequence((seed, _RENDER_STREAM, press, light)).generate_state(1)
    return int(words[0]) % _MOST_SEED


def _sampled_look(task: DatasetTask, finger: PaintedFinger, press: int, light: int, paint: int) -> SamplePaints:
    """Return one draw of the paints."""
    rng = np.random.default_rng((task.plan.seed, _PAINT_STREAM, press, light, paint))
    return sampled_paints(finger, task.paints, task.plan.emission_ratio, rng)


@dataclass(frozen=True, slots=True)
class _Pressed:
    """A press: the design with the push that was reached, its surfaces and force; none of both for the analytic one."""

    design: FingerDesign
    shapes: tuple[FingerShape, FingerShape] | None = None
    force_n: float | None = None
    slip_torque_per_friction_n_mm: float | None = None


def _pressed(task: DatasetTask, design: FingerDesign) -> _Pressed:
    """Press, by finite elements where the plan says so."""
    if task.plan.press == "analytic":
        return _Pressed(design)
    pressed = press_as_designed(design, PressSettings(None, task.plan.increments, 1), folder=task.design_folder)
    mechanics, surfaces = press_records(design, pressed)
    push = max(float(mechanics.depth_mm[-1]), 0.0)  # a path may end above the coat
    reached = design.indenter.model_copy(update={"depth_mm": push})
    return _Pressed(
        design.model_copy(update={"indenter": reached}),
        restore_shapes(surfaces),
        _normal_force_n(mechanics),
        mechanics.slip_torque_per_friction_n_mm,
    )


def _normal_force_n(mechanics: PressMechanics) -> float:
    """Return the force along the pad's normal at the end of the push."""
    return float(mechanics.force_n[-1, 1])


def pixel_places_mm(task: DatasetTask) -> Floats:
    """Return the place (x across, z along) on the undeformed coat that each pixel sees without contact, NaN off it.

    Shape (rows, columns, 2); it serves all samples, as camera and finger are the same.

    Parameters
    ----------
    task
        Design, renderer, and where the file of the camera's calibration is looked for.
    """
    design, renderer = task.plan.design, open_renderer(choose_variant(task.engine), threads=1)
    place = camera_view(design, task.design_folder, renderer).maps.coat_mm(design)
    return np.asarray(place[..., ::-1])


def sample_members(sample: DatasetSample, truth: RenderedSample) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the files of a sample: pictures, depth and normal as PNG, and the labels as JSON."""
    key = f"{sample.sample:06d}"
    yield f"{key}.depth.png", _png(truth.depth_um)
    yield f"{key}.json", json.dumps(sample.model_dump(mode="json"), sort_keys=True).encode()
    yield f"{key}.normals.png", _png(truth.normal)
    yield f"{key}.rest.png", _png(truth.rest)
    yield f"{key}.rgb.png", _png(truth.contact)


def _png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return an image, grey or RGB, as PNG."""
    stored = image if image.ndim == 2 else image[..., ::-1]
    _, content = cv2.imencode(".png", np.ascontiguousarray(stored))
    return content.tobytes()


def shard_bytes(members: Sequence[tuple[str, bytes]]) -> bytes:
    """Return files as a TAR archive that holds nothing but their names and contents: no time, no owner."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in members:
            info = tarfile.TarInfo(name)
            info.size, info.mode = len(content), 0o644
            archive.addfile(info, io.BytesIO(content))
    return stream.getvalue()
