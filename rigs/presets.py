"""Ready-made rigs: the paper's eight filters over a simulated bench, and capture plans for them."""

from pathlib import Path

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.camera import CameraPlan
from data_schemas.capture import PaintPlan, RegionOfInterest
from data_schemas.devices import CameraSettings, FilterWheelSettings
from data_schemas.rig import HiddenPaint, RigFile, SimulatedBench

PAPER_FILTERS_NM = (405, 450, 500, 532, 560, 600, 630, 660)
# The simulated filters come with a certificate: centre and width within 0.2 nm, evenly likely, is 0.12 nm, rounded up.
CERTIFIED_NM = 0.15
CAMERA_FILTER = "532"
REGION_OF_HEIGHT = 220 / 1024
RED_PAINT = HiddenPaint(
    name="red",
    mode_nm=597.0,
    fwhm_nm=48.0,
    asinh_skewness=1.8,
    energy_yield=0.25,
    absorption_peak_nm=560.0,
)
GREEN_PAINT = HiddenPaint(
    name="green",
    mode_nm=516.0,
    fwhm_nm=38.0,
    asinh_skewness=0.9,
    energy_yield=0.30,
    absorption_peak_nm=470.0,
    reflectance_long_wavelength=0.25,
)
DEFAULT_PAINTS = {"red": RED_PAINT, "green": GREEN_PAINT}


def simulated_rig(
    paint: str,
    camera_response: str | None = None,
    seed: int = 1,
    width_px: int = 1280,
    height_px: int = 1024,
) -> RigFile:
    """Return the paper's rig over a simulated bench.

    Parameters
    ----------
    paint
        "red" or "green" (a default hidden paint), or the CSV file of a measured re-radiation matrix.
    camera_response
        CSV file of the camera's response; the assumed response if left out.
    seed
        Seed of everything on the bench that is left to chance.
    width_px, height_px
        Size of the sensor (pixels).
    """
    hidden = DEFAULT_PAINTS.get(paint)
    return RigFile(
        name=f"simulated rig, {paint if hidden else Path(paint).stem}",
        camera=CameraSettings(width_px=width_px, height_px=height_px, response=camera_response or "assumed"),
        filter_wheel=FilterWheelSettings(
            filters=tuple(
                BandPassFilter(
                    slot=slot,
                    name=str(center_nm),
                    center_nm=center_nm,
                    center_uncertainty_nm=CERTIFIED_NM,
                    fwhm_uncertainty_nm=CERTIFIED_NM,
                )
                for slot, center_nm in enumerate(PAPER_FILTERS_NM, 1)
            )
        ),
        simulated=SimulatedBench(seed=seed, paint=hidden, material=None if hidden else paint),
    )


def paint_plan(paint_name: str, camera: CameraSettings | None = None) -> PaintPlan:
    """Return a plan whose region is the middle of the sample: 220 x 220 px of a frame 1024 px high."""
    return PaintPlan(paint_name=paint_name, region=_middle(camera or CameraSettings()))


def camera_plan(
    camera_name: str, camera: CameraSettings | None = None, filter_name: str | None = CAMERA_FILTER
) -> CameraPlan:
    """Return a plan whose region is the middle of the white tile, lit through one filter (none: the wheel is out).

    The filter at 532 nm lets the lamp saturate green first, and red and blue within the longest exposure.
    """
    return CameraPlan(camera_name=camera_name, filter_name=filter_name, region=_middle(camera or CameraSettings()))


def _middle(camera: CameraSettings) -> RegionOfInterest:
    """Return the middle of the frame: 220 x 220 px of one 1024 px high."""
    side_px = 2 * round(0.5 * REGION_OF_HEIGHT * camera.height_px)
    return RegionOfInterest(
        row_px=(camera.height_px - side_px) // 4 * 2,
        column_px=(camera.width_px - side_px) // 4 * 2,
        height_px=side_px,
        width_px=side_px,
    )
