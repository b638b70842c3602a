"""The camera of a finger: a new frame of the right size and exposure each time, refused ones taken again."""

import math
from collections.abc import Callable
from typing import Final

from data_schemas.devices import CameraSettings
from data_schemas.errors import FrameSizeError, RefusedError
from rigs.capture.attempts import exposed, within_attempts
from rigs.capture.exchange import CAMERA_DEADLINE_MARGIN_S, EXPOSURE_TOLERANCE_REL, require_new
from rigs.protocols import Camera, RawFrame

DEADLINE_EXPOSURES: Final = 3.0
"""A camera that runs freely may have to end one exposure before it begins the one asked for."""


class TactileCamera:
    """A camera behind checks of what it delivers.

    Parameters
    ----------
    camera, settings
        The open camera and what the rig file says about it.
    one_exposure
        Whether the session needs one exposure time only, so that a camera may leave it unknown.
    on_refusal
        Called with a text for every frame that is refused and taken again.
    """

    def __init__(
        self, camera: Camera, settings: CameraSettings, one_exposure: bool, on_refusal: Callable[[str], None]
    ) -> None:
        self._camera, self._settings, self._one_exposure = camera, settings, one_exposure
        self._on_refusal = on_refusal
        self._last: RawFrame | None = None

    def expose(self, exposure_s: float) -> tuple[RawFrame, int]:
        """Return a frame and how many attempts it took, four at most.

        Raises
        ------
        BadFrameError, FrameSizeError, LostError
            Every attempt failed.
        RefusedError
            The camera used another exposure, or delivers what a tactile capture cannot hold.
        """
        return within_attempts(lambda attempt: self._once(exposure_s), self._on_refusal, f"{exposure_s:g} s")

    def _once(self, exposure_s: float) -> RawFrame:
        """Take one frame and check it."""
        raw = exposed(self._camera, exposure_s, DEADLINE_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S)
        if not math.isfinite(raw.exposure_s):
            if not self._one_exposure:
                raise RefusedError(
                    "camera: does not say its exposure time, so that a bracket would be the same image several times; "
                    "give one exposure in exposures_s (the one set at the camera's server)"
                )
        elif abs(raw.exposure_s / exposure_s - 1.0) > EXPOSURE_TOLERANCE_REL:
            raise RefusedError(
                f"camera: {exposure_s:g} s were asked for, it reads back {raw.exposure_s:g} s (within "
                f"{EXPOSURE_TOLERANCE_REL:.0%} is allowed); correct the exposures of the plan or the limits of the rig"
            )
        self._require_images(raw)
        require_new(raw, self._last)
        self._last = raw
        return raw

    def _require_images(self, raw: RawFrame) -> None:
        """Refuse what is neither a Bayer frame nor an RGB picture of the rig's size and bit depth."""
        asked = (self._settings.height_px, self._settings.width_px)
        counts, pixels = raw.counts, str(raw.settings.get("pixel_format", ""))
        if counts.shape not in (asked, (*asked, 3)):
            raise FrameSizeError(
                f"camera: delivered a frame of {' x '.join(map(str, counts.shape))}, the rig file says {asked[0]} x "
                f"{asked[1]} px (height x width); correct the rig file"
            )
        if pixels.lower().startswith("mono"):
            raise RefusedError(
                f"camera: delivers {pixels}, and a tactile capture needs colours (Bayer RGGB or RGB); use a colour "
                "camera"
            )
        if int(counts.max()) >= 2**self._settings.bit_depth:
            raise RefusedError(
                f"camera: delivered a count of {counts.max()} DN, more than camera.bit_depth = "
                f"{self._settings.bit_depth} allows ({2**self._settings.bit_depth - 1} DN); correct the rig file"
            )
