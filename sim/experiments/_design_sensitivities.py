"""What a finger's stiffness and the force of a press answer to a changed design: one number at a time.

Stiffness in bending and twist, with the dimensions that are assumed changed up and down; and presses with one of the
design's materials or dimensions changed. And the force of a press, or of a block of its gel, as its moduli have it, to
be fitted to a bench.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    FingerDesign,
    FingerStiffness,
    ForceSlope,
    ImpossibleFingerError,
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
from finray_calib.force import BULK_RANGE, GEL_RANGE_MPA, ForceModel
from sim.mechanics import (
    FORCE_EXCESS_REL,
    ContactChoice,
    DesignChange,
    GelBlock,
    LoadedFinger,
    Ogden,
    PressedFinger,
    PressSettings,
    chosen_contact,
    compress_block,
    contact_forces_n,
    finger_mesh,
    frictionless_torque_n_mm,
    press_derivatives,
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
        raise ImpossibleFingerError(refused.errors()[0]["msg"]) from refused


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
        raise SimulateError(f"two designs have the same name ({', '.join(names)}); give each design a unique name")
    if not 0.0 <= share <= 0.5:
        raise SimulateError(
            f"assumed dimensions cannot be varied by {share:g} of their value; give a share from 0 to 0.5"
        )
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
        notes=(
            "dimensions of the skeleton are assumed unless the design's origin says otherwise; the results are not "
            "validated",
        ),
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
            else "dimensions that only one of the two fingers has are left out",
        )


def _by_change(own: Sequence[StiffnessRow], measure: Measure) -> dict[str, float]:
    """Return the measure by what was changed and in which direction; as designed under the empty name."""
    sides = {0.0: "", -1.0: " less", 1.0: " more"}
    return {row.changed + sides[float(np.sign(row.change_rel))]: float(getattr(row, measure)) for row in own}


# a secant of ln F over ln x, exact for any power of x; small against what makes ribs buckle
CHANGE_REL: Final = 0.1
SLOPE_STEP_LN: Final = 1e-4
"""Half the difference of ln x in a derivative: its square is the error, and rounding leaves 1e-9."""
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
    """Return how the force of a press changes with each number of its design, on the coarse mesh.

    By derivatives at each increment (:func:`sim.mechanics.press_derivatives`). Numbers that have none are changed by a
    tenth and the design is pressed again: with the barrier, near a snap, and where a small change makes another mesh.
    The change is up, but down where only that keeps the mesh's count of nodes: another mesh would change the force by
    itself.

    Parameters
    ----------
    design, contact, folder
        As they went into :func:`sim.mechanics.press_finger`.
    pressed
        What came out, pressed from first touch; taken as the unchanged press where it is on the coarse mesh.
    threads
        Of elements and factorisation.
    progress
        Called before the derivatives and after each press.
    fields
        Dotted paths of the numbers, by default UNCERTAIN_FIELDS and those whose uncertainty the design
        states; what the design does not have, or what is no continuous number, is left out.

    Raises
    ------
    SimulateError
        When the unchanged design finds no equilibrium on the coarse mesh, or one without force.
    """
    increments = len(pressed.depth_mm)
    before = pressed
    if contact == "auto" and pressed.kind != "unknown" and pressed.parts_touch_from_mm is None:
        contact = pressed.kind  # all by one contact: their differences count
    if design.mesh.preset != PRESET:
        before = press_finger(design, PressSettings(PRESET, increments, threads, contact), folder=folder)
    start = before if chosen_contact(contact) == "penalty" and before.parts_touch_from_mm is None else None
    wanted = [f for f in (_uncertain(design) if fields is None else fields) if _is_continuous(design, f)]
    if progress is not None:
        progress(0, 1, "sensitivities of the force")
    slopes = _slopes(design, before, wanted, threads, folder)
    changes = list(_changes(design, [field for field in wanted if field not in slopes]))
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
        preset=PRESET,
        depth_mm=before.depth_mm,
        force_n=before.force_n[:, 1],
        varied=tuple(varied),
        slopes=tuple(ForceSlope(field=field, ln_force_per_ln_number=slope) for field, slope in slopes.items()),
    )


def _slopes(
    design: FingerDesign, pressed: PressedFinger, fields: Sequence[str], threads: int, folder: Path
) -> dict[str, NDArray[np.float64]]:
    """Return d ln F / d ln x at the increments of a press, of the numbers that have it.

    Raises
    ------
    SimulateError
        When an increment has no force.
    """
    if (without := pressed.force_n[:, 1] <= 0.0).any():
        raise SimulateError(
            f"the force of the press is 0 N at a push of {pressed.depth_mm[without][-1]:.3g} mm on the {PRESET} mesh, "
            "so that its relative change is not defined; press deeper, or in fewer increments"
        )
    changes = {}
    for field in fields:
        try:
            low, high = (_changed(design, field, math.expm1(sign * SLOPE_STEP_LN)) for sign in (-1.0, 1.0))
        except SimulateError:
            continue  # at a limit of what a design may be
        changes[field] = DesignChange(low, high, 2.0 * SLOPE_STEP_LN)
    try:
        found = press_derivatives(design, pressed, changes, PressSettings(PRESET, threads=threads), folder)
    except SimulateError:
        return {}
    relative = found.force_n[:, :, 1] / pressed.force_n[:, 1, None]
    return {name: relative[:, k] for k, name in enumerate(found.names)}


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
    """Yield fields and their relative changes."""
    nodes = len(finger_mesh(design, PRESET).nodes_mm)
    for field in fields:
        material = field.startswith("mechanics.")
        up = material or _node_count(design, field, CHANGE_REL) == nodes
        yield field, CHANGE_REL if up or _node_count(design, field, -CHANGE_REL) != nodes else -CHANGE_REL


def _is_continuous(design: FingerDesign, field: str) -> bool:
    """Whether a field is a number, or a list of them, of a part that the design has."""
    backing = field.startswith("mechanics.onyx.") and design.skeleton.backing is None
    unused = backing or field in design.unused_fields()
    return not unused and isinstance(design_value(design, field), float | tuple)


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


# C10 over the design's; between, the force's derivatives bend little
_GEL_FACTORS = (0.5, 1.0, 2.0)
_MODEL_INCREMENTS = 4
_PUSH_SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
_BULK_NODES, _BULK_NODES_OF_FINGER = 7, 4
_BLOCK_CELLS = (5, 8)
_BLOCK_BULK_OVER_SHEAR = 100.0
_EDGE_LIMIT_MM = 0.1  # a cut or cast edge; a rectangular distribution within it (JCGM 100, 4.3.7)


def finger_force_model(
    design: FingerDesign, push_mm: float, threads: int = 1, progress: Progress | None = None, folder: Path = Path()
) -> ForceModel:
    """Return the force of a finger's press by its moduli: whole presses with other gels, each with its derivatives.

    Parameters
    ----------
    design, folder
        Finger, indenter and where the design stands.
    push_mm
        Deepest push.
    threads
        Of elements and factorisation.
    progress
        Called after each press.

    Raises
    ------
    SimulateError
        When a press finds no equilibrium, has no force or ends early, or the indenter needs the barrier.
    """
    deep = design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": push_mm})})
    own = deep.mechanics.gel
    # a design holds C10 from 0.01 to 10 MPa
    gels = [
        factor * own.c10_mpa for factor in _GEL_FACTORS if GEL_RANGE_MPA[0] <= factor * own.c10_mpa <= GEL_RANGE_MPA[1]
    ]
    bulks = list(np.geomspace(*BULK_RANGE, _BULK_NODES_OF_FINGER))
    wanted = [("mechanics.gel.c10_mpa", gel) for gel in gels] + [("mechanics.gel.bulk_over_shear", b) for b in bulks]
    found = []
    for done, (field, value) in enumerate(wanted):
        changed = changed_design(deep, field, value)
        pressed = press_finger(changed, PressSettings(PRESET, _MODEL_INCREMENTS, threads, "penalty"), folder=folder)
        if pressed.unreached:
            raise NoEquilibriumError(f"the press with {field} = {value:.3g} ended early: {pressed.unreached}")
        slopes = _slopes(
            changed, pressed, [f for f in _uncertain(changed) if _is_continuous(changed, f)], threads, folder
        )
        # cutbacks put increments between; all presses are read at the same ones
        found.append(_sensitivities(pressed, slopes, push_mm * np.arange(1, _MODEL_INCREMENTS + 1) / _MODEL_INCREMENTS))
        if progress is not None:
            progress(done + 1, len(wanted), f"{field} = {value:.3g}")
    return ForceModel.of_finger(
        f"{design.name}, {PRESET} mesh", deep, list(zip(gels, found[: len(gels)], strict=True)),
        list(zip(bulks, found[len(gels) :], strict=True)), FORCE_EXCESS_REL[PRESET],
    )  # fmt: skip


def _sensitivities(
    pressed: PressedFinger, slopes: dict[str, NDArray[np.float64]], push_mm: NDArray[np.float64]
) -> PressSensitivities:
    """Return forces and derivatives of a press at some of its increments."""
    at = np.abs(pressed.depth_mm[:, None] - push_mm).argmin(axis=0)
    return PressSensitivities(
        preset=PRESET,
        depth_mm=pressed.depth_mm[at],
        force_n=pressed.force_n[at, 1],
        varied=(),
        slopes=tuple(ForceSlope(field=field, ln_force_per_ln_number=slope[at]) for field, slope in slopes.items()),
    )


def block_force_model(
    block: GelBlock, push_mm: float, threads: int = 1, progress: Progress | None = None
) -> ForceModel:
    """Return the force of a block of gel between plates by C10, which it is proportional to, and K/mu.

    Parameters
    ----------
    block
        What is compressed.
    push_mm
        Deepest push.
    threads
        Of elements and factorisation.
    progress
        Called after each K/mu.

    Raises
    ------
    SimulateError
        When the push is too deep for the block, or finds no equilibrium.
    """
    pushes = [share * push_mm for share in _PUSH_SHARES]
    bulks = np.geomspace(*BULK_RANGE, _BULK_NODES)
    found = []
    for done, bulk in enumerate(bulks):
        found.append(compress_block(block, Ogden((1.0,), (2.0,), float(bulk)), pushes, threads=threads))
        if progress is not None:
            progress(done + 1, len(bulks), f"{block.plates} block, K/mu = {bulk:.4g}")
    gel = Ogden((1.0,), (2.0,), _BLOCK_BULK_OVER_SHEAR)
    rough, fine = (compress_block(block, gel, pushes, cells, threads) for cells in _BLOCK_CELLS)
    # the error falls with the edge of the elements: at the free edges of bonded plates stress is infinite
    excess = float(np.log(rough.force_n[-1] / fine.force_n[-1])) / (_BLOCK_CELLS[1] / _BLOCK_CELLS[0] - 1.0)
    edges = (_EDGE_LIMIT_MM / math.sqrt(3.0) / edge for edge in (block.length_mm, block.width_mm, block.height_mm))
    # of mu = 1 MPa, so of C10 = 0.5 MPa
    return ForceModel(
        f"block {block.length_mm:g} x {block.width_mm:g} x {block.height_mm:g} mm, {block.plates}",
        np.array(pushes),
        np.array([0.5]),
        np.log(fine.force_n)[None] - excess,
        np.ones((1, len(pushes))),
        bulks,
        np.log([one.force_n for one in found]),
        np.array([one.ln_force_per_ln_bulk for one in found]),
        _BLOCK_BULK_OVER_SHEAR,
        scale_u_rel=math.hypot(0.5 * excess, *edges),
    )
