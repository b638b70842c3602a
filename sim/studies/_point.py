"""One point of a study in a worker process: press, renders, metrics, and the record that keeps them."""

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    DesignStudy,
    FingerDesign,
    FingerSurfaces,
    PressMechanics,
    Provenance,
    SimulateError,
    StudyMetric,
    StudyPoint,
)
from data_schemas.storage import ProductSet, clear_leftovers, read_record, write_record
from sim.experiments import camera_rgb, paint_finger, press_records
from sim.mechanics import press_finger
from sim.optics import PaintOptics, Preference, PressRender, choose_variant, open_renderer, render_press
from sim.studies._metrics import image_metrics, mechanics_metrics
from sim.studies._plan import PlannedPoint
from sim.surface_meshes import restore_shapes

POINTS: Final = "points"
PRESSES: Final = "presses"

_OPTICAL_PARTS: Final = ("name", "coating", "light", "second_light", "camera", "materials", "origin", "provenance")
"""Parts of a design that a press does not know: points that differ in them alone share it."""


@dataclass(frozen=True, slots=True)
class StudyPaints:
    """The paints of a study: their optics, and by colour where they come from (part of what a point is known by)."""

    optics: Mapping[str, PaintOptics]
    sources: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class StudyTask:
    """What every point of a study needs beside itself.

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
    """

    plan: DesignStudy
    paints: StudyPaints
    engine: Preference
    folder: Path
    design_folder: Path
    origin: Provenance


def point_file(folder: Path, number: int) -> Path:
    """Return the record of a point."""
    return folder / POINTS / f"{number:05d}.json"


def point_key(task: StudyTask, point: PlannedPoint) -> str:
    """Return the SHA-256 of what a point is computed from."""
    return _sha256(
        {
            "design": point.design.model_dump(mode="json", exclude={"provenance"}),
            "measure": task.plan.measure.model_dump(mode="json"),
            "seed": point.seed,
            "paints": dict(task.paints.sources) if task.plan.measure.images else {},
        }
    )


def press_file(task: StudyTask, design: FingerDesign) -> Path | None:
    """Return the surfaces of the press that a design needs, named by what it is computed from; None: no press."""
    if task.plan.measure.press == "analytic":
        return None
    known = design.model_dump(mode="json", exclude=set(_OPTICAL_PARTS))
    digest = _sha256({"design": known, "increments": task.plan.measure.increments})
    return task.folder / PRESSES / f"{digest[:16]}.surfaces.json"


def compute_press(task: StudyTask, design: FingerDesign) -> None:
    """Press a finger by finite elements on one core, and keep force and surfaces together."""
    surfaces_file = press_file(task, design)
    if surfaces_file is None or surfaces_file.exists():
        return
    surfaces_file.parent.mkdir(parents=True, exist_ok=True)
    clear_leftovers(surfaces_file.parent)
    pressed = press_finger(design, None, task.plan.measure.increments, 1, folder=task.design_folder)
    mechanics, surfaces = press_records(design, pressed)
    with ProductSet(surfaces_file) as products:
        write_record(mechanics, _mechanics_file(surfaces_file), task.origin, products)
        write_record(surfaces, surfaces_file, task.origin, products)


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
    write_record(record, file, task.origin)


def stored_point(task: StudyTask, point: PlannedPoint) -> StudyPoint | None:
    """Return a point that is kept already.

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
            f"{file}: was computed from another plan, design, paint or seed; give another --out, or the plan as it was"
        )
    return record


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
    shapes = None if surfaces is None else restore_shapes(surfaces)
    renders: list[PressRender] = [
        render_press(
            design, finger.paints, renderer, "b", _repeat_seed(point.seed, k), measure.samples,
            shapes=shapes, calibration=finger.calibration,
        )
        for k in range(measure.repeats)
    ]  # fmt: skip
    matrix = finger.camera_matrix(renders[0].bands)
    pictures = {
        name: camera_rgb(np.mean([getattr(r, f"{name}_bands") for r in renders], axis=0), matrix)
        for name in ("no_contact", "contact")
    }
    notes = (renders[0].label, f"shape of the finger: {renders[0].contact_label}")
    return image_metrics(design, renders, matrix), pictures, (*notes, *finger.coverage_notes(renders[0].bands))


def _repeat_seed(seed: int, repeat: int) -> int:
    """Return the seed of a repeat: the same for all points of a study, so that differences share their noise."""
    return int(np.random.SeedSequence((seed, repeat)).generate_state(1)[0])


def _mechanics_file(surfaces_file: Path) -> Path:
    """Return the record of the force beside that of the surfaces."""
    return surfaces_file.with_name(surfaces_file.name.replace(".surfaces.", ".mechanics."))


def _sha256(content: dict[str, Any]) -> str:
    """Return the SHA-256 of content as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
