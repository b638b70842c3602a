"""Tell a lab exactly which captures to take: a page for people, and tactile plans for 'finray capture'.

The page (Markdown) says what to prepare, to press, to measure and to send; a plan is TOML with the lines marked that a
lab must measure. Places and depths of the presses suit a design's pad.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from data_schemas import FingerDesign, RecordError
from data_schemas.storage import toml_text
from finray_calib.sensing import MINIMUM_PRESSES

BALL_PRESSES: Final = 18

_BALL_DEPTHS_REL = (0.1, 0.2, 0.3)
_PRESS_DEPTHS_REL = (1.0 / 3.0, 2.0 / 3.0, 1.0)
_LARGEST_BALL_MM = 4.0
# the contact circle of the deepest press stays this far inside what is seen of the pad
_RIM_MM = 0.5
_ACROSS_REL = (-0.6, 0.0, 0.6)


@dataclass(frozen=True, slots=True)
class PlannedView:
    """What the camera is planned to see of the pad: from where to where, and how large a raw pixel is there."""

    along_mm: tuple[float, float]
    across_mm: tuple[float, float]
    mm_per_px: float
    mm_per_px_u_rel: float


@dataclass(frozen=True, slots=True)
class Press:
    """One press: how deep, where along the pad from its base, and how far across from its middle line."""

    depth_mm: float
    position_mm: float
    across_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class IndenterPresses:
    """Presses of one indenter."""

    shape: str
    radius_mm: float
    presses: Sequence[Press]


def ball_presses(design: FingerDesign, view: PlannedView) -> IndenterPresses:
    """Return presses of a ball that suits the pad, all over what the camera sees; depths are shares of its thickness.

    Raises
    ------
    RecordError
        What is seen of the pad is too small for a ball.
    """
    pad = design.pad
    deepest = max(_BALL_DEPTHS_REL) * pad.thickness_mm
    radius = min(_LARGEST_BALL_MM, pad.width_mm / 4.0)
    rim = float(np.sqrt(2.0 * radius * deepest - deepest**2)) + _RIM_MM if deepest < radius else np.inf
    base, tip = max(0.0, view.along_mm[0]), min(pad.length_mm, view.along_mm[1])
    half = min(pad.width_mm / 2.0, -view.across_mm[0], view.across_mm[1])
    if 2.0 * rim >= min(tip - base, 2.0 * half):
        raise RecordError(
            f"pad: the camera sees only {max(tip - base, 0.0):.1f} x {max(2.0 * half, 0.0):.1f} mm of the pad of "
            f"{pad.length_mm:g} x {pad.width_mm:g} x {pad.thickness_mm:g} mm, too little for the presses that a "
            f"normal map needs (a ball of {radius:g} mm radius, {deepest:g} mm deep); change the pad or the camera of "
            "the design"
        )
    reach_mm = half - rim
    columns = BALL_PRESSES // len(_ACROSS_REL)
    along = np.linspace(base + rim, tip - rim, columns)
    presses = [
        # neither along nor across do all presses of one depth stand in line
        Press(_BALL_DEPTHS_REL[(i + j) % len(_BALL_DEPTHS_REL)] * pad.thickness_mm, float(z), share * reach_mm)
        for i, z in enumerate(along)
        for j, share in enumerate(_ACROSS_REL)
    ]
    return IndenterPresses("ball", radius, presses)


def indenter_presses(design: FingerDesign) -> IndenterPresses:
    """Return presses of the design's own indenter at its place, up to its depth.

    Raises
    ------
    RecordError
        The indenter is none that a tactile plan knows, or does not press.
    """
    indenter = design.indenter
    if indenter.shape not in ("cylinder", "ball") or indenter.depth_mm <= 0.0:
        raise RecordError(
            f"indenter.shape = {indenter.shape!r} with depth_mm = {indenter.depth_mm:g} mm is not supported, because "
            "a capture request needs a cylinder or a ball and a depth above 0 mm; change the indenter of the design"
        )
    presses = [Press(share * indenter.depth_mm, indenter.position_mm) for share in _PRESS_DEPTHS_REL]
    return IndenterPresses(indenter.shape, indenter.radius_mm, presses)


ANGLES_DEG: Final = (0.0, 30.0, 60.0, 90.0)
"""Panel angles of the sweep, the design's own beside them."""


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """A page (Markdown) and the plans that it speaks of, file name -> TOML."""

    page: str
    plans: dict[str, str]


def capture_request(
    design: FingerDesign, design_file: str, stem: str, view: PlannedView, angles_deg: Sequence[float] = ANGLES_DEG
) -> CaptureRequest:
    """Return what a lab must capture so that a design can be compared, its normals sensed and its light decided.

    One plan of ball presses teaches the normal map; one plan for each panel angle presses the design's own indenter.
    Depths are shares of the design's depth (of the pad's thickness for the ball).

    Parameters
    ----------
    design
        The finger; its indenter is pressed at the panel angles.
    design_file
        Its file, as the plans name it.
    stem
        File name of the page without ".md"; the plans are named after it.
    view
        What the design's camera sees: the balls are pressed there, and the plans hold its scale.
    angles_deg
        Panel angles of the sweep, deg; the design's own is added.

    Raises
    ------
    RecordError
        When the design's indenter is none that a tactile plan knows, it does not press, the pad is too small for a
        ball, or two angles would share a plan.
    """
    own, ball = indenter_presses(design), ball_presses(design, view)
    plans = {
        f"{stem}.ball.toml": tactile_plan_text(design, design_file, ball, view, design.light.angle_deg, board=True)
    }
    for angle in sorted({*angles_deg, design.light.angle_deg}):
        name = f"{stem}.angle-{angle:g}.toml"
        if name in plans:
            raise RecordError(
                f"panel angle of {float(angle)!r} deg: the plan of another angle has the same name, {name}; round the "
                "angles, and light.angle_deg of the design, to six digits"
            )
        plans[name] = tactile_plan_text(design, design_file, own, view, angle, board=False)
    return CaptureRequest(capture_request_page(design, ball, own, tuple(plans)), plans)


REPEATS: Final = 3
NO_CONTACT_IMAGES: Final = 2
BOARD_IMAGES: Final = 10
BRACKET_POWERS: Final = (4, 22)

_LED_CURRENT_MA = 20.0
_DEPTH_U_MM, _POSITION_U_MM, _TILT_U_DEG, _ANGLE_U_DEG = 0.02, 0.1, 0.3, 0.5
_BOARD = f"""
[board]                          # your ChArUco board; images of it in many places and tilts
on_pad = true                    # in the first image the board lies flat where the pad's coat is
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
# Written by finray. Lines with MEASURE hold planned values: replace them by what you measured.
kind = "tactile"
name = {toml_text(name)}
design = {toml_text(design_file)}
bracket_powers = [{BRACKET_POWERS[0]}, {BRACKET_POWERS[1]}]         # exposures 2^n us: first and last n
no_contact_images = {NO_CONTACT_IMAGES}            # before and after each press
repeats = {REPEATS}                      # of each press; the indenter is retracted between them
led_current_ma = {_LED_CURRENT_MA:.1f}            # MEASURE
light_angle_deg = {_float(angle_deg)}           # MEASURE: the panel's normal from the pad plane
light_angle_uncertainty_deg = {_ANGLE_U_DEG}  # MEASURE: standard uncertainty
mm_per_px = {_float(view.mm_per_px)}  # MEASURE: 'finray sense scale' prints it and the next line
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


def _float(value: float) -> str:
    """Return a TOML float of at most four decimals."""
    return repr(round(float(value), 4))


_BEFORE = """\
## Before you begin

- Raw frames of the sensor (Bayer, DNG), no JPEG, no MJPEG. Auto exposure, auto white balance, denoising and sharpening
  off; both colour gains 1; analogue gain 1. A picture with the tone curve of a camera cannot be compared as light.
- Warm the LEDs up for ten minutes, at a constant current. Write the current down.
- Work in the dark. Focus, aperture and finger stay as they are from the first frame to the last.
- Clean the pad; take no frame with dust or dents of the last press in it (wait a minute after each press).

"""
_TO_CAPTURE = f"""\
## What to capture

Around each press: {NO_CONTACT_IMAGES} images of no contact before it and {NO_CONTACT_IMAGES} after it. Repeat each
press {REPEATS} times, and take the indenter away between. Take every image at all exposures 2^{BRACKET_POWERS[0]} to
2^{BRACKET_POWERS[1]} us that the camera allows (16 us to 4.2 s).

1. The camera's geometry and the scale: {BOARD_IMAGES} images of a ChArUco board of 7 x 5 squares, glued to a flat
   plate. Measure all seven squares with a calliper at once; a seventh of that length, and of its uncertainty, is that
   of one square. For the first image the board lies flat where the pad's coat is, with its printed face to the camera;
   take it before the pad is put in, or lay the board on the pad. All of the board must be in the view through the
   mirror. For the other images, turn the board and tilt it by 20 to 45 deg in all directions, in some of them so that
   it reaches the corners of the picture. Camera, mirror and focus are those of the presses. If the printed face cannot
   lie in the plane of the coat, measure how far behind it the coat is, to 0.1 mm: 1 mm at 50 mm changes the scale by
   2 %. The ball plan asks for these images first. Its session then gives millimetres per raw pixel along x and y, with
   uncertainty, and names what cannot be measured:

       finray sense scale SESSION --square-u-mm 0.01 --out pixel-scale.json

   Put the two lines it prints into the plans that are still to be run. The ball plan itself may be run with the planned
   value: 'finray sense teach --scale pixel-scale.json' puts the measured one in its place, and 'finray compare
   --scale pixel-scale.json' states the sizes of patch and halo in mm. A capture without contact needs nothing more; one
   taken without these images cannot be given a scale afterwards.
"""
_TO_STATE = """\
## What to state

Standard uncertainties (0.1 / sqrt(3) = 0.058 mm for a value that lies anywhere within 0.1 mm): depth, place along
the pad and tilt of each press, the panel's angle, the radius of the indenter, the side of a square. How zero depth
was found (first contact seen, or felt by a force sensor). Model of the camera and its lens, of the LEDs; room
temperature.

"""


def capture_request_page(
    design: FingerDesign, ball: IndenterPresses, own: IndenterPresses, plans: Sequence[str]
) -> str:
    """Return the page.

    Parameters
    ----------
    design
        The finger.
    ball, own
        Presses of the ball, and of the design's own indenter at each panel angle.
    plans
        Names of the plans' files: that of the ball, then one for each panel angle.
    """
    return _purpose(design) + _BEFORE + _TO_CAPTURE + _presses(design, ball, own, plans) + _TO_STATE + _how(ball, plans)


def _purpose(design: FingerDesign) -> str:
    """Return the heading, what the captures are for, and the finger's axes."""
    pad = design.pad
    return f"""\
# Capture request: {design.name}

What these captures are for: a render of this finger is compared with them, a map from colour to surface normal is
fitted to them, and the angle of the blue panel is decided with the error that they show.

The finger: pad {pad.length_mm:g} x {pad.width_mm:g} mm, {pad.thickness_mm:g} mm thick; blue panel at
{design.light.angle_deg:g} deg from the pad plane. Places are in mm along the pad from its base, and across it from the
middle line (positive towards the green wall).

"""


def _presses(design: FingerDesign, ball: IndenterPresses, own: IndenterPresses, plans: Sequence[str]) -> str:
    """Return what to press after the images of the board: the ball, then the design's own indenter."""
    ball_plan, *angle_plans = plans
    rows = "\n".join(
        f"| {k} | {_files(k)} | {p.position_mm:.1f} | {p.across_mm:+.1f} | {p.depth_mm:.2f} |"
        for k, p in enumerate(ball.presses, start=1)
    )
    radius_mm, depths = ball.radius_mm, ", ".join(f"{p.depth_mm:.2f}" for p in own.presses)
    return f"""\
2. {len(ball.presses)} presses of a ball of {radius_mm:g} mm radius ({2 * radius_mm:g} mm diameter), panel at
   {design.light.angle_deg:g} deg; at least {MINIMUM_PRESSES} are needed, spread over pad and depth as here
   (`{ball_plan}`):

| press | files | along, mm | across, mm | depth, mm |
|---|---|---|---|---|
{rows}

3. The {own.shape} of {own.radius_mm:g} mm radius at {own.presses[0].position_mm:g} mm along the pad, on the middle
   line, to depths of {depths} mm, at each of these panel angles: {_angles(angle_plans)} deg.
   Move only the panel, and measure its angle each time.

"""


def _how(ball: IndenterPresses, plans: Sequence[str]) -> str:
    """Return how to run the plans, and what to send."""
    files = REPEATS * len(ball.presses)
    listed = "\n".join(f"       finray capture {name} --rig rig.toml" for name in plans)
    return f"""\
## How to do it

With finray and a rig file of your camera (docs/how-to/capture-presses.md); it asks for each press in turn. In the
plans, correct the lines marked MEASURE:

{listed}

Check a plan first with `--dry-run`: it prints the number of frames and the disk space. Send `pixel-scale.json` and the
complete session folders: `session.json`, `journal`, `frames/` and `press-*.json`, one for each contact. For the ball
add `circles.csv`, with a line for each file (press 1 is {_files(1)}), all {files} of them: its contact
circle in raw pixels, drawn by hand on the picture.

    image,column_px,row_px,radius_px
    press-001.json,412.5,300.0,61.0

Without finray: one folder for each press with `contact`, `no_contact` and `repeat_no_contact` as DNG or 16-bit TIFF,
the metadata of each image beside it (`contact.json`, from rpicam-still --metadata), and `press.toml` with name and
indenter; 'finray import raspberry-pi' reads it.
"""


def _angles(names: Sequence[str]) -> str:
    """Return the angles that the plans' names end in."""
    return ", ".join(name.rsplit("angle-", 1)[1].removesuffix(".toml") for name in names)


def _files(press: int) -> str:
    """Return the first and the last file of a press (from 1): the session counts contacts, repeats among them."""
    return f"press-{REPEATS * (press - 1) + 1:03d} to press-{REPEATS * press:03d}"
