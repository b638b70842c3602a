"""A comparison with what goes before it: do the images belong together, and does the camera stand where it should."""

from dataclasses import dataclass

import numpy as np

from data_schemas.capture import TactileCapture
from data_schemas.compare import PhotometricErrorReport
from data_schemas.errors import CompareError
from data_schemas.pixel_scale import PixelScale
from data_schemas.sensing import NormalMapRecord
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.comparison_record import compare_press
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.mismatch import find_mismatches, require_no_mismatch
from finray_calib.compare.patch_scale import patch_scale, scale_finding, with_measured_scale
from finray_calib.compare.press_conditions import require_same_conditions
from finray_calib.compare.regions import FACTORS
from finray_calib.compare.registered_press import move_press, register_press

#: How the finding begins that says that the camera stands where the render has it.
NO_DRIFT = "no drift of the camera to speak of"
_ONE_PICTURE = (
    "a drift of the camera cannot be told: the prediction begins from the capture's own image without contact, so that "
    "both stand alike whatever the camera did"
)
_WHAT_TO_DO = (
    "Check that the render has the camera, the design and the light angle of the capture, or calibrate the camera with "
    "a ChArUco board and simulate with that calibration"
)


@dataclass(frozen=True, slots=True)
class CheckOptions:
    """What to do with what the checks find.

    Attributes
    ----------
    registered : bool
        Move the render by the drift of the camera that was found; else the drift is only told. The render stands where
        the calibrated camera puts it, so that a drift is a fact about the rig, which a silent correction would hide.
    despite_mismatch : bool
        Compare images that do not belong together; the findings stand in the report.
    normal_map : NormalMapRecord or None
        Of the capture's sensor, for the error in sensing space.
    pixel_scale : PixelScale or None
        Of the capture's camera, for the sizes of patch and halo in mm; it takes the place of what the capture states.
    """

    registered: bool = False
    despite_mismatch: bool = False
    normal_map: NormalMapRecord | None = None
    pixel_scale: PixelScale | None = None


def compare_checked(
    press: SimulatedPress, capture: TactileCapture, seed: int, options: CheckOptions | None = None
) -> tuple[PhotometricErrorReport, SimulatedPress]:
    """Compare a press with a capture after checking that they belong together.

    Returns
    -------
    PhotometricErrorReport
        What the checks found stands in its `findings`; `forced_mismatch` where they would have refused it.
    SimulatedPress
        The press as it was compared: moved, if that was asked for and the camera has drifted.

    Raises
    ------
    CompareError
        The images do not belong together, cannot be compared (see `compare_press`), or the registration that was asked
        for cannot be trusted.
    """
    chosen = options or CheckOptions()
    # before the images: a press elsewhere looks like another exposure
    require_same_conditions(press, capture)
    findings = find_mismatches(press, capture)
    if not chosen.despite_mismatch:
        require_no_mismatch(findings)
    compared, told = _placed_press(press, capture, chosen.registered)
    checks = (*(f"{f.about}: {f.text}" for f in findings), *told)
    scale, scaled = None, capture
    if chosen.pixel_scale is not None:
        scaled = with_measured_scale(capture, chosen.pixel_scale)
    report = compare_press(compared, scaled, seed, chosen.normal_map)
    if chosen.pixel_scale is not None:
        scale = patch_scale(chosen.pixel_scale, capture, compared.distance, FACTORS)
        other = scale_finding(scale, capture)
        checks = checks if other is None else (*checks, other)
    forced = any(f.severity == "refuse" for f in findings)
    found = {"findings": (*report.findings, *checks), "forced_mismatch": forced, "patch_scale": scale}
    return report.model_copy(update=found), compared


def _placed_press(press: SimulatedPress, capture: TactileCapture, registered: bool) -> tuple[SimulatedPress, list[str]]:
    """Return the press, moved if asked, and what to tell of the camera's drift."""
    if _begins_from(press, capture):
        return press, [_ONE_PICTURE]
    try:
        found, state = register_press(press, capture)
    except CompareError as error:
        if registered:
            raise CompareError(f"{error}. {_WHAT_TO_DO}, or compare without --register") from None
        return press, [f"whether the camera stands where the render has it cannot be told: {error}. {_WHAT_TO_DO}"]
    if not found.significant:
        return press, [f"{NO_DRIFT}, by the images with {state}: {found}"]
    if not registered:
        return press, [f"the camera has drifted, by the images with {state}: {found}; --register moves the render"]
    return move_press(press, found.to_render), [f"the render was moved, by the images with {state}: {found}"]


def _begins_from(press: SimulatedPress, capture: TactileCapture) -> bool:
    """Return whether the image without contact of a press is that of the capture itself."""
    own = rgb_image(capture.no_contact, capture)
    seen = np.isfinite(own)
    return press.no_contact.shape == own.shape and np.array_equal(
        press.no_contact[seen], own[seen].astype(press.no_contact.dtype)
    )
