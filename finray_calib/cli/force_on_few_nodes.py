"""What the console says of a press whose penalty rests on few nodes, or on none."""

from typing import TYPE_CHECKING

from finray_calib.cli.options import warn

if TYPE_CHECKING:
    from data_schemas.press_mechanics import PressMechanics
    from sim.mechanics.pressed_finger import PressedFinger


def tell_few_nodes(pressed: "PressedFinger", mechanics: "PressMechanics") -> None:
    """Warn of a force that rests on few nodes; refuse one that rests on none.

    Raises
    ------
    SimulateError
        When the indenter touches no node of the coat at the end of its push.
    """
    from data_schemas.errors import SimulateError
    from sim.mechanics.chord_error import LARGEST_UNTOLD_REL, chord_shortfall_rel
    from sim.mechanics.finger_mesh import STEPS

    if pressed.kind != "penalty":
        return
    push_mm, step_mm = float(mechanics.depth_mm[-1]), STEPS[mechanics.preset].pad_mm
    force_n = float(mechanics.force_n[-1, 1])
    finer = "a finer [mesh] preset"
    remedy = f"press with {finer if mechanics.wanted_force_n is not None else f'--contact barrier, or with {finer}'}"
    if force_n <= 0.0:
        raise SimulateError(
            f"at a push of {push_mm:.4g} mm the indenter touches no node of the coat, whose elements are {step_mm:g} "
            f"mm wide: the force of {force_n:.3g} N is the mesh's, not the finger's; {remedy}. What was computed is "
            "stored"
        )
    short = chord_shortfall_rel(mechanics.design, mechanics.preset, push_mm)
    if short > LARGEST_UNTOLD_REL:
        warn(
            f"warning: the coat's elements of {step_mm:g} mm are wide for this indenter and push of {push_mm:.4g} mm: "
            f"at this push the force is some {short:.0%} too low; {remedy}"
        )
