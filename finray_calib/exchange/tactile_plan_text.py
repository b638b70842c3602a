"""A tactile plan for 'finray capture' as TOML text, with the lines marked that a lab must measure."""

import json
from typing import Final

from data_schemas.design import FingerDesign
from finray_calib.exchange.requested_presses import IndenterPresses, PlannedView, Press

REPEATS: Final = 3
NO_CONTACT_IMAGES: Final = 2
BOARD_IMAGES: Final = 10
BRACKET_POWERS: Final = (4, 22)

_LED_CURRENT_MA = 20.0
_DEPTH_U_MM, _POSITION_U_MM, _TILT_U_DEG, _ANGLE_U_DEG = 0.02, 0.1, 0.3, 0.5
_BOARD = f"""
[board]                          # your ChArUco board; images of it in many places and tilts
on_pad = true                    # the first one: flat where the pad's coat is
squares = [7, 5]
square_mm = 3.0                  # MEASURE
marker_mm = 2.2                  # MEASURE
dictionary = "DICT_4X4_50"
images = {BOARD_IMAGES}
"""


def tactile_plan_text(
    design: FingerDesign, design_file: str, asked: IndenterPresses, view: PlannedView, angle_deg: float, board: bool
) -> str:
    """Return a plan of presses at one panel angle.

    Parameters
    ----------
    design
        The finger.
    design_file
        Its file, as the plan names it.
    asked
        What to press.
    view
        Whose scale is planned.
    angle_deg
        Of the panel, deg.
    board
        Whether images of a ChArUco board come first.
    """
    tables = "".join(_press_table(press) for press in asked.presses)
    return _head(design, design_file, asked, view, angle_deg) + (_BOARD if board else "") + tables


def _head(design: FingerDesign, design_file: str, asked: IndenterPresses, view: PlannedView, angle_deg: float) -> str:
    """Return what all presses of a plan share."""
    name = f"{design.name}, {asked.shape}, panel at {angle_deg:g} deg"
    return f"""\
# Written by finray. Lines with MEASURE hold what is planned: put in what you measured.
kind = "tactile"
name = {_text(name)}
design = {_text(design_file)}
bracket_powers = [{BRACKET_POWERS[0]}, {BRACKET_POWERS[1]}]         # powers of two of 1 us that the camera allows
no_contact_images = {NO_CONTACT_IMAGES}            # before and after each press
repeats = {REPEATS}                      # of each press, the indenter taken away between
led_current_ma = {_LED_CURRENT_MA:.1f}            # MEASURE
light_angle_deg = {_float(angle_deg)}           # MEASURE: the panel's normal from the pad plane
light_angle_uncertainty_deg = {_ANGLE_U_DEG}  # MEASURE: standard uncertainty
mm_per_px = {_float(view.mm_per_px)}  # MEASURE: 'finray study pixel-scale' says it and the next line
mm_per_px_u_rel = {_float(view.mm_per_px_u_rel)}  # MEASURE: relative standard uncertainty

[indenter]
shape = "{asked.shape}"
radius_mm = {_float(asked.radius_mm)}
"""


def _press_table(press: Press) -> str:
    """Return the table of one press."""
    return f"""
[[presses]]                      # {press.across_mm:+.1f} mm across, from the middle line
depth_mm = {_float(press.depth_mm)}
position_mm = {_float(press.position_mm)}
depth_uncertainty_mm = {_DEPTH_U_MM}      # MEASURE
position_uncertainty_mm = {_POSITION_U_MM}    # MEASURE
tilt_uncertainty_deg = {_TILT_U_DEG}       # MEASURE
"""


def _text(text: str) -> str:
    """Return a TOML string."""
    return json.dumps(text, ensure_ascii=False)


def _float(value: float) -> str:
    """Return a TOML float of at most four decimals."""
    return repr(round(float(value), 4))
