"""What a finger's stiffness and the force of a press answer to a changed design: one number at a time.

Stiffness in bending and twist, with the dimensions that are assumed changed up and down; and presses with one of the
design's materials or dimensions changed.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from pydantic import ValidationError

from data_schemas import (
    FingerDesign,
    FingerStiffness,
    Indenter,
    Measure,
    NoEquilibriumError,
    Preset,
    PressSensitivities,
    SimulateError,
    StiffnessOrder,
    StiffnessRow,
    VariedPress,
)
from sim.mechanics import (
    ContactChoice,
    LoadedFinger,
    PressedFinger,
    PressSettings,
    chosen_contact,
    contact_forces_n,
    finger_mesh,
    frictionless_torque_n_mm,
    press_finger,
    press_to_force,
    slip_torque_n_mm,
)


def design_value(design: FingerDesign, field: str) -> Any:
    """Return the value at a dotted path; None where a part that the path leads through is absent."""
    value: Any = design
    for name in field.split("."):
        value = None if value is None else getattr(value, name)
    return value


def changed_design(design: FingerDesign, field: str, value: Any) -> FingerDesign:
    """Return a design with the value at a dotted path changed.

    Raises
    ------
    SimulateError
        When the design refuses the value.
    """
    whole: dict[str, Any] = design.model_dump()
    place = whole
    *path, last = field.split(".")
    for name in path:
        place = place[name]
    place[last] = value
    try:
        return FingerDesign.model_validate(whole)
    except ValidationError as refused:
        raise SimulateError(refused.errors()[0]["msg"]) from refused


Progress = Callable[[int, int, str], None]

# small against what buckles ribs, large against the equilibrium's tolerance of 1e-6
TIP_FORCE_N, PAD_FORCE_N, TWIST_DEG = 0.5, 2.0, 5.0
GRIP_FORCE_N = 2.0
_FEWEST_RIBS = 1


def study_finger_stiffness(
    designs: Sequence[FingerDesign], share: float = 0.2, threads: int = 1, progress: Progress | None = None
) -> FingerStiffness:
    """Load each finger at tip and pad, twist it, and do so again with each assumed dimension changed up and down.

    Each finger as it is also grips a cylinder, for the torque at which that begins to turn; a grip that does not reach
    its force is stored with the reason.

    Changed are the numbers of ``skeleton`` that a design's ``origin`` does not list, one at a time; a change that
    leaves no room for a part is stored with the reason.

    Parameters
    ----------
    designs
        Fingers with different names; loads of each on the mesh of its design.
    share
        Change of a dimension over its value; 0 for the designs alone.
    threads
        Of elements and factorisation.
    progress
        Called after each finger.

    Raises
    ------
    SimulateError
        When two designs share a name, the share is not from 0 to 0.5, or a design as it is has no equilibrium.
    """
    names = [design.name for design in designs]
    if len(set(names)) < len(names):
        raise SimulateError(f"the designs are named {', '.join(names)}: give each a name of its own")
    if not 0.0 <= share <= 0.5:
        raise SimulateError(f"assumed dimensions cannot be varied by {share:g} of their value: give 0 to 0.5")
    variants = [(design, *variant) for design in designs for variant in _variants(design, share)]
    rows = []
    for done, (design, field, change_rel, value) in enumerate(variants):
        rows.append(_row(design, field, change_rel, value, threads))
        if progress is not None:
            progress(done + 1, len(variants), f"{design.name} {field}".strip())
    return FingerStiffness(
        label=f"finite elements, {len(rows)} fingers of {len(designs)} designs; contact between ribs is not computed",
        designs=tuple(designs),
        tip_force_n=TIP_FORCE_N,
        pad_force_n=PAD_FORCE_N,
        twist_deg=TWIST_DEG,
        grip_force_n=GRIP_FORCE_N,
        share=share,
        rows=tuple(rows),
        orders=tuple(_orders(names, rows)),
        notes=("dimensions of the skeleton are assumed unless the design's origin says otherwise; unvalidated",),
    )


def _variants(design: FingerDesign, share: float) -> Iterator[tuple[str, float, float]]:
    """Yield field, relative change and value: first of the design as it is, without a field."""
    yield "", 0.0, 0.0
    skeleton = design.skeleton.model_dump()
    fields = {f"skeleton.{name}": value for name, value in skeleton.items() if not isinstance(value, dict)}
    fields |= {f"skeleton.backing.{name}": value for name, value in (skeleton["backing"] or {}).items()}
    for field, value in fields.items():
        if field in design.origin or not value or not share:
            continue
        for factor in (1.0 - share, 1.0 + share):
            changed = factor * value
            if isinstance(value, int):
                # whole numbers change by one at least
                changed = max(_FEWEST_RIBS, value + int(math.copysign(max(1, round(share * value)), factor - 1.0)))
            yield field, changed / value - 1.0, changed


def _row(design: FingerDesign, field: str, change_rel: float, value: float, threads: int) -> StiffnessRow:
    """Load one finger; a changed one may fail."""
    try:
        finger = LoadedFinger(changed_design(design, field, value) if field else design, threads=threads)
        slip, tipping, loose = (None, None, "") if field else _held_torques(design, threads)
        return StiffnessRow(
            design=design.name,
            changed=field,
            change_rel=change_rel,
            bending_n_per_mm=finger.push("tip", (0.0, -TIP_FORCE_N, 0.0)).stiffness_n_per_mm,
            sideways_n_per_mm=finger.push("tip", (TIP_FORCE_N, 0.0, 0.0)).stiffness_n_per_mm,
            pad_n_per_mm=finger.push("pad", (0.0, -PAD_FORCE_N, 0.0)).stiffness_n_per_mm,
            twist_n_mm_per_deg=finger.twist(TWIST_DEG).stiffness_n_mm_per_deg,
            slip_torque_per_friction_n_mm=slip,
            tipping_torque_n_mm=tipping,
            grip_failure=loose,
        )
    except SimulateError as failed:
        if not field:
            raise
        return StiffnessRow(design=design.name, changed=field, change_rel=change_rel, failure=str(failed))


def _held_torques(design: FingerDesign, threads: int) -> tuple[float | None, float | None, str]:
    """Return the torques that the grip of a cylinder holds: by friction over its coefficient, and by its width.

    None, and why, where the grip does not reach its force.
    """
    gripped = design.model_copy(update={"indenter": Indenter(position_mm=design.pad.length_mm / 2.0)})
    try:
        pressed = press_to_force(gripped, GRIP_FORCE_N, PressSettings(increments=1, threads=threads))
    except NoEquilibriumError as stuck:
        return None, None, str(stuck)
    if pressed.unreached:
        return None, None, f"the grip ended early, at {pressed.force_n[-1, 1]:.4g} N: {pressed.unreached}"
    places, forces = contact_forces_n(pressed)
    return slip_torque_n_mm(places, forces, 1.0), frictionless_torque_n_mm(places, forces, design.pad.width_mm), ""


def _orders(names: Sequence[str], rows: Sequence[StiffnessRow]) -> Iterator[StiffnessOrder]:
    """Yield for each pair of designs and each measure whether the stiffer one stays so."""
    of_design = {name: [row for row in rows if row.design == name and not row.failure] for name in names}
    for pair, measure in itertools.product(itertools.combinations(names, 2), get_args(Measure)):
        soft, stiff = sorted(pair, key=lambda name: float(getattr(of_design[name][0], measure)))
        softs, stiffs = (_by_change(of_design[name], measure) for name in (soft, stiff))
        ratios = {change: stiffs[change] / softs[change] for change in stiffs if change in softs}
        at = min(ratios, key=lambda change: ratios[change])
        yield StiffnessOrder(
            measure=measure,
            stiffer=stiff,
            softer=soft,
            ratio=ratios[""],
            smallest_ratio=ratios[at],
            at=at,
            independent_ratio=min(stiffs.values()) / max(softs.values()),
            note=""
            if len(ratios) == len(stiffs) == len(softs)
            else "dimensions that only one of them has are left out",
        )


def _by_change(own: Sequence[StiffnessRow], measure: Measure) -> dict[str, float]:
    """Return the measure by what was changed and in which direction; as designed under the empty name."""
    sides = {0.0: "", -1.0: " less", 1.0: " more"}
    return {row.changed + sides[float(np.sign(row.change_rel))]: float(getattr(row, measure)) for row in own}


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
        As they went into :func:`sim.mechanics.press_finger`.
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
    if contact == "auto" and pressed.kind != "unknown":
        contact = pressed.kind  # all by one contact: their differences count
    if design.mesh.preset != PRESET:
        before = press_finger(design, PressSettings(PRESET, increments, threads, contact), folder=folder)
    start = before if chosen_contact(contact) == "penalty" else None
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
    settings = PressSettings(PRESET, increments, threads, contact)
    try:
        return press_finger(design, settings, folder=folder, start=start)
    except SimulateError:
        if start is None:
            raise
    return press_finger(design, settings, folder=folder)


def _uncertain(design: FingerDesign) -> tuple[str, ...]:
    """Return the fields that are uncertain in every design, and further ones that this design calls so."""
    return tuple(dict.fromkeys((*UNCERTAIN_FIELDS, *design.uncertainty_rel)))


def _changes(design: FingerDesign, fields: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield field and relative change of every number that the design has."""
    nodes, idle = len(finger_mesh(design, PRESET).nodes_mm), design.idle_fields()
    for field in fields:
        unused = field in idle or (field.startswith("mechanics.onyx.") and design.skeleton.backing is None)
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
