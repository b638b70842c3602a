"""How the force of a press answers to the design's materials and dimensions: presses with one number changed."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import Preset
from data_schemas.press_mechanics import PressSensitivities, VariedPress
from sim.experiments.changed_design import changed_design, design_value
from sim.mechanics.finger_mesh import finger_mesh
from sim.mechanics.press import press_finger
from sim.mechanics.press_contact import ContactChoice, chosen_contact
from sim.mechanics.pressed_finger import PressedFinger

Progress = Callable[[int, int, str], None]

# a secant of ln F over ln x, exact for any power of x; small against what makes ribs buckle
CHANGE_REL: Final = 0.1
PRESET: Final[Preset] = "coarse"
UNCERTAIN_FIELDS: Final = (
    "mechanics.gel.c10_mpa",
    "mechanics.gel.bulk_over_shear",
    "mechanics.skeleton.mu_mpa",
    "mechanics.skeleton.bulk_over_shear",
    "mechanics.onyx.youngs_modulus_mpa",
    "mechanics.mirror.youngs_modulus_mpa",
    "mechanics.film.youngs_modulus_mpa",
    "pad.thickness_mm",
    "pad.film.thickness_mm",
    "skeleton.front_fin_thickness_mm",
    "skeleton.back_fin_thickness_mm",
    "skeleton.rib_thickness_mm",
    "skeleton.rib_width_mm",
    "skeleton.mirror_thickness_mm",
    "skeleton.backing.thickness_mm",
)
"""What is changed, where the design has it: stiffnesses, and thicknesses through which the force goes."""


def press_sensitivities(
    design: FingerDesign,
    pressed: PressedFinger,
    threads: int = 1,
    progress: Progress | None = None,
    contact: ContactChoice = "auto",
    folder: Path = Path(),
    fields: Sequence[str] | None = None,
) -> PressSensitivities:
    """Press the design again with each number changed by a tenth, on the coarse mesh.

    The change is up, but down where only that keeps the mesh's count of nodes: another mesh would change the force
    by itself. With the penalty, each press starts from the displacements of the unchanged one.

    Parameters
    ----------
    design, contact, folder
        As they went into :func:`sim.mechanics.press.press_finger`.
    pressed
        What came out, pressed from first touch; taken as the unchanged press where it is on the coarse mesh.
    threads
        Of elements and factorisation.
    progress
        Called after each press.
    fields
        Dotted paths of the numbers, by default UNCERTAIN_FIELDS and those whose uncertainty the design
        states; what the design does not have, or what is no continuous number, is left out.

    Raises
    ------
    SimulateError
        When the unchanged design finds no equilibrium on the coarse mesh.
    """
    increments = len(pressed.depth_mm)
    before = pressed
    if design.mesh.preset != PRESET:
        before = press_finger(design, PRESET, increments, threads, contact=contact, folder=folder)
    start = before if chosen_contact(design, contact) == "penalty" else None
    changes = list(_changes(design, _uncertain(design) if fields is None else fields))
    varied = []
    for done, (field, change_rel) in enumerate(changes):
        try:
            changed = _changed(design, field, change_rel)
            again = _pressed(changed, increments, threads, start, contact, folder)
            depth, force, failure = again.depth_mm, again.force_n[:, 1], again.unreached
        except SimulateError as failed:
            depth, force, failure = np.empty(0), np.empty(0), str(failed)
        varied.append(VariedPress(field=field, change_rel=change_rel, depth_mm=depth, force_n=force, failure=failure))
        if progress is not None:
            progress(done + 1, len(changes), field)
    return PressSensitivities(
        preset=PRESET, depth_mm=before.depth_mm, force_n=before.force_n[:, 1], varied=tuple(varied)
    )


def _pressed(
    design: FingerDesign,
    increments: int,
    threads: int,
    start: PressedFinger | None,
    contact: ContactChoice,
    folder: Path,
) -> PressedFinger:
    """Press a changed design from a start, or from rest where its mesh is too different for that."""
    try:
        return press_finger(design, PRESET, increments, threads, None, start, contact=contact, folder=folder)
    except SimulateError:
        if start is None:
            raise
    return press_finger(design, PRESET, increments, threads, contact=contact, folder=folder)


def _uncertain(design: FingerDesign) -> tuple[str, ...]:
    """Return the fields that are uncertain in every design, and further ones that this design calls so."""
    return tuple(dict.fromkeys((*UNCERTAIN_FIELDS, *design.uncertainty_rel)))


def _changes(design: FingerDesign, fields: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield field and relative change of every number that the design has."""
    nodes = len(finger_mesh(design, PRESET).nodes_mm)
    for field in fields:
        unused = field.startswith("mechanics.onyx.") and design.skeleton.backing is None
        if unused or not isinstance(design_value(design, field), float | tuple):
            continue
        material = field.startswith("mechanics.")
        up = material or _node_count(design, field, CHANGE_REL) == nodes
        yield field, CHANGE_REL if up or _node_count(design, field, -CHANGE_REL) != nodes else -CHANGE_REL


def _changed(design: FingerDesign, field: str, change_rel: float) -> FingerDesign:
    """Return a design with a number, or all numbers of a list, scaled."""
    value, factor = design_value(design, field), 1.0 + change_rel
    return changed_design(
        design, field, tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    )


def _node_count(design: FingerDesign, field: str, change_rel: float) -> int:
    """Return the number of nodes of the changed design's mesh; 0 where its parts do not fit."""
    try:
        return len(finger_mesh(_changed(design, field, change_rel), PRESET).nodes_mm)
    except SimulateError:
        return 0
