"""The page of a capture request, for people: what to prepare, to press, to measure and to send. Markdown."""

from collections.abc import Sequence

from data_schemas.design import FingerDesign
from finray_calib.compare.normal_map_fit import MINIMUM_PRESSES
from finray_calib.exchange.requested_presses import IndenterPresses
from finray_calib.exchange.tactile_plan_text import BOARD_IMAGES, BRACKET_POWERS, NO_CONTACT_IMAGES, REPEATS

_BEFORE = """\
## Before you begin

- Raw frames of the sensor (Bayer, DNG), no JPEG, no MJPEG. Auto exposure, auto white balance, denoising and sharpening
  off; both colour gains 1; analogue gain 1. What goes through a camera's own curve cannot be compared as light.
- Warm the LEDs up for ten minutes, at a constant current. Write the current down.
- Work in the dark. Focus, aperture and finger stay as they are from the first frame to the last.
- Clean the pad; take no frame with dust or dents of the last press in it (wait a minute after each press).

"""
_TO_CAPTURE = f"""\
## What to capture

Around each press: {NO_CONTACT_IMAGES} images of no contact before it and {NO_CONTACT_IMAGES} after it. Each press
{REPEATS} times, the indenter taken away between. Every image at all exposures 2^{BRACKET_POWERS[0]} to
2^{BRACKET_POWERS[1]} us that the camera allows (16 us to 4.2 s).

1. The camera's geometry and the scale: {BOARD_IMAGES} images of a ChArUco board of 7 x 5 squares, glued to a flat
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
"""
_TO_STATE = """\
## What to state

Standard uncertainties (for "within 0.1 mm, evenly likely" that is 0.1 / sqrt(3) = 0.058 mm): depth, place along the pad
and tilt of each press, the panel's angle, the radius of the indenter, the side of a square. How zero depth was found
(first contact seen, or felt by a force sensor). Model of the camera and its lens, of the LEDs; room temperature.

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
   The panel moves and nothing else; measure its angle each time.

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

Check a plan first with `--dry-run`: it says how many frames and how much disk. Send `pixel-scale.json` and the session
folders whole: `session.json`, `journal`, `frames/` and `press-*.json`, one for each contact. For the ball add
`circles.csv`, with a line for each file (press 1 is {_files(1)}), all {files} of them: its contact
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
