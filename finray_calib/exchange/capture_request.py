"""Tell a lab exactly which captures to take: a page for people, and tactile plans for 'finray capture'."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import RecordError
from finray_calib.compare.normal_map_fit import MINIMUM_PRESSES

ANGLES_DEG: Final = (0.0, 30.0, 60.0, 90.0)
"""Panel angles of the sweep, the design's own beside them."""
BALL_PRESSES: Final = 18

_BALL_DEPTHS_REL = (0.1, 0.2, 0.3)
_PRESS_DEPTHS_REL = (1.0 / 3.0, 2.0 / 3.0, 1.0)
_REPEATS, _NO_CONTACT_IMAGES, _BOARD_IMAGES = 3, 2, 10
_BRACKET_POWERS = (4, 22)
_LED_CURRENT_MA = 20.0
_DEPTH_U_MM, _POSITION_U_MM, _TILT_U_DEG, _ANGLE_U_DEG = 0.02, 0.1, 0.3, 0.5
_LARGEST_BALL_MM = 4.0
# the contact circle of the deepest press stays this far inside the pad
_RIM_MM = 0.5
_ACROSS_REL = (-0.6, 0.0, 0.6)


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """A page (Markdown) and the plans that it speaks of, file name -> TOML."""

    page: str
    plans: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Press:
    depth_mm: float
    position_mm: float
    across_mm: float = 0.0


def capture_request(
    design: FingerDesign, design_file: str, stem: str, angles_deg: Sequence[float] = ANGLES_DEG
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
    angles_deg
        Panel angles of the sweep, deg; the design's own is added.

    Raises
    ------
    RecordError
        When the design's indenter is none that a tactile plan knows, it does not press, the pad is too small for a
        ball, or two angles would share a plan.
    """
    indenter = design.indenter
    if indenter.shape not in ("cylinder", "ball") or indenter.depth_mm <= 0.0:
        raise RecordError(
            f"indenter.shape = {indenter.shape!r}, depth_mm = {indenter.depth_mm:g} mm: a capture request needs a "
            "cylinder or a ball that is pressed in; change the design's indenter"
        )
    ball_mm, ball = _ball_presses(design)
    plans = {f"{stem}.ball.toml": _plan(design, design_file, "ball", ball_mm, ball, design.light.angle_deg, board=True)}
    presses = [_Press(share * indenter.depth_mm, indenter.position_mm) for share in _PRESS_DEPTHS_REL]
    for angle in sorted({*angles_deg, design.light.angle_deg}):
        name = f"{stem}.angle-{angle:g}.toml"
        if name in plans:
            raise RecordError(
                f"panel angle of {float(angle)!r} deg: the plan of another angle is named {name} too; round the "
                "angles, and light.angle_deg of the design, to six digits"
            )
        plans[name] = _plan(design, design_file, indenter.shape, indenter.radius_mm, presses, angle, board=False)
    return CaptureRequest(_page(design, ball_mm, ball, presses, plans), plans)


def _ball_presses(design: FingerDesign) -> tuple[float, list[_Press]]:
    """Return the radius of a ball that suits the pad, and presses all over it."""
    pad = design.pad
    deepest = max(_BALL_DEPTHS_REL) * pad.thickness_mm
    radius = min(_LARGEST_BALL_MM, pad.width_mm / 4.0)
    rim = float(np.sqrt(2.0 * radius * deepest - deepest**2)) + _RIM_MM if deepest < radius else np.inf
    if 2.0 * rim >= min(pad.length_mm, pad.width_mm):
        raise RecordError(
            f"pad: {pad.length_mm:g} x {pad.width_mm:g} x {pad.thickness_mm:g} mm leaves no room for presses of a ball "
            f"of {radius:g} mm radius to {deepest:g} mm; a normal map cannot be asked for"
        )
    columns = BALL_PRESSES // len(_ACROSS_REL)
    along = np.linspace(rim, pad.length_mm - rim, columns)
    presses = [
        # neither along nor across do all presses of one depth stand in line
        _Press(
            _BALL_DEPTHS_REL[(i + j) % len(_BALL_DEPTHS_REL)] * pad.thickness_mm, float(z), share * _reach(design, rim)
        )
        for i, z in enumerate(along)
        for j, share in enumerate(_ACROSS_REL)
    ]
    return radius, presses


def _reach(design: FingerDesign, rim_mm: float) -> float:
    """Return how far from the middle line a ball may be pressed."""
    return design.pad.width_mm / 2.0 - rim_mm


def _plan(
    design: FingerDesign,
    design_file: str,
    shape: str,
    radius_mm: float,
    presses: Sequence[_Press],
    angle_deg: float,
    board: bool,
) -> str:
    """Return a tactile plan as TOML."""
    scale_mm = design.pad.length_mm / design.camera.width_px
    scale = (
        f"mm_per_px = {_float(scale_mm)}  # MEASURE: 'finray study pixel-scale' says it and the next line\n"
        "mm_per_px_u_rel = 0.2            # MEASURE: relative standard uncertainty\n"
    )
    name = f"{design.name}, {shape}, panel at {angle_deg:g} deg"
    head = f"""\
# Written by finray. Lines with MEASURE hold what is planned: put in what you measured.
kind = "tactile"
name = {_text(name)}
design = {_text(design_file)}
bracket_powers = [{_BRACKET_POWERS[0]}, {_BRACKET_POWERS[1]}]         # powers of two of 1 us that the camera allows
no_contact_images = {_NO_CONTACT_IMAGES}            # before and after each press
repeats = {_REPEATS}                      # of each press, the indenter taken away between
led_current_ma = {_LED_CURRENT_MA:.1f}            # MEASURE
light_angle_deg = {_float(angle_deg)}           # MEASURE: the panel's normal from the pad plane
light_angle_uncertainty_deg = {_ANGLE_U_DEG}  # MEASURE: standard uncertainty
{scale}
[indenter]
shape = "{shape}"
radius_mm = {_float(radius_mm)}
"""
    charuco = f"""
[board]                          # your ChArUco board; images of it in many places and tilts
on_pad = true                    # the first one: flat where the pad's coat is
squares = [7, 5]
square_mm = 3.0                  # MEASURE
marker_mm = 2.2                  # MEASURE
dictionary = "DICT_4X4_50"
images = {_BOARD_IMAGES}
"""
    tables = [
        f"""
[[presses]]                      # {press.across_mm:+.1f} mm across, from the middle line
depth_mm = {_float(press.depth_mm)}
position_mm = {_float(press.position_mm)}
depth_uncertainty_mm = {_DEPTH_U_MM}      # MEASURE
position_uncertainty_mm = {_POSITION_U_MM}    # MEASURE
tilt_uncertainty_deg = {_TILT_U_DEG}       # MEASURE
"""
        for press in presses
    ]
    return head + (charuco if board else "") + "".join(tables)


def _page(
    design: FingerDesign, ball_mm: float, ball: Sequence[_Press], presses: Sequence[_Press], plans: dict[str, str]
) -> str:
    """Return the page for people."""
    ball_plan, *angle_plans = plans
    rows = "\n".join(
        f"| {k} | {_files(k)} | {p.position_mm:.1f} | {p.across_mm:+.1f} | {p.depth_mm:.2f} |"
        for k, p in enumerate(ball, start=1)
    )
    depths = ", ".join(f"{p.depth_mm:.2f}" for p in presses)
    pad, indenter = design.pad, design.indenter
    listed = "\n".join(f"       finray capture {name} --rig rig.toml" for name in plans)
    return f"""\
# Capture request: {design.name}

What these captures are for: a render of this finger is compared with them, a map from colour to surface normal is
fitted to them, and the angle of the blue panel is decided with the error that they show.

The finger: pad {pad.length_mm:g} x {pad.width_mm:g} mm, {pad.thickness_mm:g} mm thick; blue panel at
{design.light.angle_deg:g} deg from the pad plane. Places are in mm along the pad from its base, and across it from the
middle line (positive towards the green wall).

## Before you begin

- Raw frames of the sensor (Bayer, DNG), no JPEG, no MJPEG. Auto exposure, auto white balance, denoising and sharpening
  off; both colour gains 1; analogue gain 1. What goes through a camera's own curve cannot be compared as light.
- Warm the LEDs up for ten minutes, at a constant current. Write the current down.
- Work in the dark. Focus, aperture and finger stay as they are from the first frame to the last.
- Clean the pad; take no frame with dust or dents of the last press in it (wait a minute after each press).

## What to capture

Around each press: {_NO_CONTACT_IMAGES} images of no contact before it and {_NO_CONTACT_IMAGES} after it. Each press
{_REPEATS} times, the indenter taken away between. Every image at all exposures 2^{_BRACKET_POWERS[0]} to
2^{_BRACKET_POWERS[1]} us that the camera allows (16 us to 4.2 s).

1. The camera's geometry and the scale: {_BOARD_IMAGES} images of a ChArUco board of 7 x 5 squares, glued to a flat
   plate. Measure all seven squares with a calliper at once; a seventh of that, and of its uncertainty, is that of one.
   The first image: the board flat where the pad's coat is, printed face to the camera, before the pad is in or laid on
   it, all of it in view (through the mirror is right). The others: turned, and tilted by 20 to 45 deg in all
   directions, some into the corners of the picture. Camera, mirror and focus are those of the presses. If the printed
   face cannot lie in the plane of the coat, measure how far behind it the coat is, to 0.1 mm: 1 mm at 50 mm changes the
   scale by 2 %. The ball plan asks for these images first. Its session then gives millimetres per raw pixel along x and
   y, with uncertainty, and refuses in plain words what cannot be measured:

       finray study pixel-scale SESSION --square-u-mm 0.01 --out pixel-scale.json

   Put the two lines it prints into the plans that are still to be run. The ball plan itself may be run with the planned
   value: 'finray study normal-map --scale pixel-scale.json' puts the measured one in its place, and 'finray compare
   --scale pixel-scale.json' states the sizes of patch and halo in mm. A capture without contact needs nothing more; one
   taken without these images cannot be given a scale afterwards.
2. {len(ball)} presses of a ball of {ball_mm:g} mm radius ({2 * ball_mm:g} mm diameter), panel at
   {design.light.angle_deg:g} deg; at least {MINIMUM_PRESSES} are needed, spread over pad and depth as here
   (`{ball_plan}`):

| press | files | along, mm | across, mm | depth, mm |
|---|---|---|---|---|
{rows}

3. The {indenter.shape} of {indenter.radius_mm:g} mm radius at {indenter.position_mm:g} mm along the pad, on the middle
   line, to depths of {depths} mm, at each of these panel angles: {_angles(angle_plans)} deg.
   The panel moves and nothing else; measure its angle each time.

## What to state

Standard uncertainties (for "within 0.1 mm, evenly likely" that is 0.1 / sqrt(3) = 0.058 mm): depth, place along the pad
and tilt of each press, the panel's angle, the radius of the indenter, the side of a square. How zero depth was found
(first contact seen, or felt by a force sensor). Model of the camera and its lens, of the LEDs; room temperature.

## How to do it

With finray and a rig file of your camera (docs/how-to/capture-presses.md); it asks for each press in turn. In the
plans, correct the lines marked MEASURE:

{listed}

Check a plan first with `--dry-run`: it says how many frames and how much disk. Send `pixel-scale.json` and the session
folders whole: `session.json`, `journal`, `frames/` and `press-*.json`, one for each contact. For the ball add
`circles.csv`, with a line for each file (press 1 is {_files(1)}), all {_REPEATS * len(ball)} of them: its contact
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
    return f"press-{_REPEATS * (press - 1) + 1:03d} to press-{_REPEATS * press:03d}"


def _text(text: str) -> str:
    """Return a TOML string."""
    return json.dumps(text, ensure_ascii=False)


def _float(value: float) -> str:
    """Return a TOML float of at most four decimals."""
    return repr(round(float(value), 4))
