"""What every GenICam camera is told, by whichever library it is reached: raw pixels, nothing automatic, read back."""

from typing import Final, Protocol

from data_schemas.devices import CameraSettings
from data_schemas.errors import BadFrameError, RefusedError
from rigs.cameras.genicam_pixels import RawPixels, raw_pixels

# Names before and after the GenICam Standard Features Naming Convention 1.0.
EXPOSURE_NAMES: Final = ("ExposureTime", "ExposureTimeAbs")
AUTOMATIC: Final = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto", "AcquisitionFrameRateAuto")
TRIGGER: Final = "TriggerMode"
MIRRORED: Final = ("ReverseX", "ReverseY")
# A limited frame rate limits the exposure; the others change raw counts.
SWITCHED_OFF: Final = (
    "AcquisitionFrameRateEnable",
    "AcquisitionFrameRateEnabled",
    "GammaEnable",
    "GammaEnabled",
    "LUTEnable",
    "SharpnessEnable",
    "SharpnessEnabled",
    "SaturationEnable",
    "SaturationEnabled",
)
# Exposures are multiples of a line time (some 10 us to 40 us), by a clock that is good to 0.1 %.
LINE_S: Final = 50e-6
CLOCK_REL: Final = 1e-3
GAIN_STEP_DB: Final = 0.1
BALANCE_STEP: Final = 5e-3


class FeatureError(Exception):
    """A camera library refuses to read or write a feature."""


class ConnectionBrokenError(FeatureError):
    """The camera does not answer any more."""


class Features(Protocol):
    """Features of an open GenICam camera; every method may raise :class:`FeatureError`."""

    def has(self, name: str) -> bool:
        """Return whether the camera has this feature now."""
        ...

    def entries(self, name: str) -> tuple[str, ...]:
        """Return what an enumeration can be set to."""
        ...

    def text(self, name: str) -> str:
        """Read an enumeration or string."""
        ...

    def number(self, name: str) -> float:
        """Read a number."""
        ...

    def is_on(self, name: str) -> bool:
        """Read a switch."""
        ...

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the smallest and largest value of a number."""
        ...

    def set_text(self, name: str, value: str) -> None:
        """Write an enumeration or string."""
        ...

    def set_number(self, name: str, value: float) -> None:
        """Write a number."""
        ...

    def switch(self, name: str, on: bool) -> None:
        """Write a switch."""
        ...


def configure(features: Features, settings: CameraSettings, camera: str) -> RawPixels:
    """Set everything but the exposure: nothing automatic, raw pixels, whole frame, gain; each is read back.

    Raises
    ------
    RefusedError
        The camera cannot do what the rig file says, or reads back something else.
    """
    # A mirrored frame begins with another colour, and some cameras then offer other formats.
    for name in MIRRORED:
        _switch_off(features, name, camera)
    pixels = raw_pixels(features.entries("PixelFormat"), settings.bit_depth, camera)
    _set_text(features, "PixelFormat", pixels.name, camera)
    for name in (*AUTOMATIC, TRIGGER):
        if features.has(name):
            _set_text(features, name, "Off", camera)
    for name in SWITCHED_OFF:
        _switch_off(features, name, camera)
    _equal_white_balance(features, camera)
    if features.has("Gamma"):
        _set_number(features, "Gamma", 1.0, 1e-3, camera, "gamma is fixed at 1")
    _whole_frame(features, settings, camera)
    _set_gain(features, settings.gain_db, camera)
    return pixels


def read_settings(features: Features) -> dict[str, str | float]:
    """Read back what a frame's record should hold beside its exposure."""
    found: dict[str, str | float] = {"pixel_format": features.text("PixelFormat")}
    found |= {name: features.text(name) for name in AUTOMATIC if features.has(name)}
    found |= {name: features.number(name) for name in ("Gain", "BlackLevel", "Gamma") if features.has(name)}
    return found


def exposure_name(features: Features, camera: str) -> str:
    """Return the name of the exposure time.

    Raises
    ------
    RefusedError
        The camera has none.
    """
    name = next((name for name in EXPOSURE_NAMES if features.has(name)), None)
    if name is None:
        raise RefusedError(
            f"{camera}: has no feature {' or '.join(EXPOSURE_NAMES)}, so its exposure can neither be set nor read; a "
            "calibration needs a camera with a settable exposure time"
        )
    return name


def set_exposure(features: Features, exposure_s: float, camera: str) -> float:
    """Set the exposure time (s) and return the one that is read back (s).

    Raises
    ------
    RefusedError
        The camera has no exposure time, not this one, or keeps another.
    """
    name = exposure_name(features, camera)
    low_us, high_us = features.bounds(name)
    if not low_us <= 1e6 * exposure_s <= high_us:
        raise RefusedError(
            f"{camera}: cannot expose for {exposure_s:g} s; it allows {1e-6 * low_us:g} to {1e-6 * high_us:g} s: "
            "correct shortest_exposure_s and longest_exposure_s of the rig file"
        )
    features.set_number(name, 1e6 * exposure_s)
    actual_s = 1e-6 * features.number(name)
    if abs(actual_s - exposure_s) > LINE_S + CLOCK_REL * exposure_s:
        raise RefusedError(
            f"{camera}: was asked to expose for {exposure_s:g} s and keeps {actual_s:g} s; is an automatic exposure or "
            "a frame rate limit on?"
        )
    return actual_s


def require_new(label: tuple[int, float], last: tuple[int, float] | None, camera: str) -> None:
    """Refuse the frame that was delivered last time, by its number and the camera's time (s).

    Neither tells alone: numbers wrap or begin again with each acquisition, and some cameras give no time.

    Raises
    ------
    BadFrameError
        Both are those of the last frame.
    """
    if label[1] > 0.0 and label == last:
        raise BadFrameError(f"{camera}: delivered frame {label[0]} twice; does its stream hang?")


def _whole_frame(features: Features, settings: CameraSettings, camera: str) -> None:
    """Read out the frame of the rig file, centred on the sensor."""
    for size, offset, wanted in (
        ("Width", "OffsetX", settings.width_px),
        ("Height", "OffsetY", settings.height_px),
    ):
        if features.has(offset):
            _set_number(features, offset, features.bounds(offset)[0], 0.0, camera, "the whole frame is needed")
        largest = features.bounds(size)[1]
        if wanted > largest:
            raise RefusedError(
                f"{camera}: cannot read out {size} = {wanted} px; its largest is {largest:g} px: correct "
                f"{size.lower()}_px of the rig file"
            )
        _set_number(features, size, wanted, 0.0, camera, f"correct {size.lower()}_px of the rig file")


def _switch_off(features: Features, name: str, camera: str) -> None:
    """Switch off what a camera may have, and read it back."""
    if features.has(name) and features.is_on(name):
        features.switch(name, False)
        if features.is_on(name):
            raise RefusedError(
                f"{camera}: {name} stays on, which changes raw counts or limits the exposure; switch it off in the "
                "camera maker's program"
            )


def _equal_white_balance(features: Features, camera: str) -> None:
    """Set the digital gains of the colours to 1: also with nothing automatic, some cameras apply them to raw counts."""
    if not (features.has("BalanceRatioSelector") and features.has("BalanceRatio")):
        return
    for colour in features.entries("BalanceRatioSelector"):
        _set_text(features, "BalanceRatioSelector", colour, camera)
        _set_number(features, "BalanceRatio", 1.0, BALANCE_STEP, camera, f"white balance ({colour}) changes raw counts")


def _set_gain(features: Features, gain_db: float, camera: str) -> None:
    """Set the gain (dB); a camera without one has 0 dB."""
    if features.has("Gain"):
        _set_number(features, "Gain", gain_db, GAIN_STEP_DB, camera, "correct gain_db of the rig file")
    elif gain_db:
        raise RefusedError(f"{camera}: has no feature Gain, the rig file asks for {gain_db:g} dB; leave gain_db out")


def _set_text(features: Features, name: str, value: str, camera: str) -> None:
    """Set an enumeration, which may be fixed at the value, and read it back."""
    if features.text(name) == value:
        return
    features.set_text(name, value)
    found = features.text(name)
    if found != value:
        raise RefusedError(
            f"{camera}: {name} was set to {value} and reads back {found}; set it in the camera maker's program"
        )


def _set_number(features: Features, name: str, value: float, tolerance: float, camera: str, advice: str) -> None:
    """Set a number, which may be fixed at the value, and read it back."""
    if abs(features.number(name) - value) <= tolerance:
        return
    features.set_number(name, value)
    found = features.number(name)
    if abs(found - value) > tolerance:
        raise RefusedError(f"{camera}: {name} was set to {value:g} and reads back {found:g}; {advice}")
