"""Any camera that Micro-Manager has a device adapter for, through pymmcore.

pymmcore-plus is built on pymmcore: a camera takes its core as well, and adapters that it has installed are found.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    CameraSettings,
    CaptureError,
    DeviceIdentity,
    LostError,
    MissingExtraError,
    RefusedError,
    TimedOutError,
)
from rigs import CallThread, NoAnswerError, RawFrame
from rigs.cameras._genicam import CLOCK_REL, LINE_S, name_of

if TYPE_CHECKING:
    from pymmcore import CMMCore

T = TypeVar("T")
ADAPTERS_VARIABLE: Final = "MICROMANAGER_PATH"
OPEN_DEADLINE_S: Final = 60.0  # some adapters initialise a sensor's cooling
CLOSE_DEADLINE_S: Final = 5.0
ANSWER_S: Final = 5.0  # Micro-Manager's own time-out
READOUT_S: Final = 2.0
UNBINNED: Final = ("1", "1x1")
"""As adapters write it: that of Micro-Manager's own camera, and that of PCO's."""
RECORDED: Final = ("PixelType", "BitDepth", "Gain", "Offset", "Binning", "ReadoutMode")


class MicroManagerCamera:
    """The camera of a Micro-Manager configuration; every frame is a snap.

    Parameters
    ----------
    settings
        Camera of the rig file.
    configuration
        The .cfg file.
    core
        A Micro-Manager core without devices; that of pymmcore-plus is one.
    """

    def __init__(self, settings: CameraSettings, configuration: Path, core: "CMMCore") -> None:
        self._settings, self._configuration, self._core = settings, configuration, core
        self._where = name_of(settings)
        self._thread = CallThread("micro-manager camera")
        self._camera = ""

    def open(self) -> None:
        """Load the configuration and check the camera against the rig file."""
        self._call(
            self._load,
            OPEN_DEADLINE_S,
            RefusedError,
            "check that the camera is switched on, and that its device adapters are beside the .cfg file or in the "
            f"folder that {ADAPTERS_VARIABLE} names",
        )

    def close(self) -> None:
        """Unload all devices."""
        self._thread.close(self._core.reset, CLOSE_DEADLINE_S)

    def identity(self) -> DeviceIdentity:
        """Return what the camera says it is."""
        return self._call(self._identity, ANSWER_S)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take one frame.

        Raises
        ------
        TimedOutError
            The camera or its adapter did not finish in time.
        LostError
            The adapter reports an error.
        BadFrameError
            A count is larger than the camera's bits allow.
        RefusedError
            The camera keeps another exposure.
        """
        end_s = time.monotonic() + deadline_s
        actual_s = self._call(lambda: self._set_exposure(exposure_s), min(ANSWER_S, deadline_s))
        if abs(actual_s - exposure_s) > LINE_S + CLOCK_REL * abs(exposure_s):
            raise RefusedError(
                f"{self._where}: an exposure of {exposure_s:g} s was requested, but the camera uses {actual_s:g} s; "
                "correct shortest_exposure_s and longest_exposure_s in the rig file"
            )
        started_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        limit_s = min(actual_s + READOUT_S, end_s - time.monotonic())
        counts = self._call(self._snap, limit_s)
        if counts.max(initial=0) >= 2**self._settings.bit_depth:
            raise BadFrameError(
                f"{self._where}: the frame contains a count of {counts.max()} DN, but {self._settings.bit_depth} bits "
                "allow less; correct bit_depth in the rig file"
            )
        return RawFrame(
            counts=counts,
            exposure_requested_s=exposure_s,
            exposure_s=actual_s,
            captured_utc=started_utc,
            settings=self._call(self._recorded, ANSWER_S),
        )

    def _call(
        self,
        function: Callable[[], T],
        limit_s: float,
        failed: type[CaptureError] = LostError,
        advice: str = "check the camera's cable and power, and try it in Micro-Manager",
    ) -> T:
        """Call the core with a deadline; its errors become ours."""
        try:
            return self._thread.call(function, limit_s)
        except NoAnswerError:
            raise TimedOutError(
                f"{self._where}: the device adapter did not finish within {limit_s:.2f} s; {advice}"
            ) from None
        except (RuntimeError, OSError) as error:
            text = " ".join(str(error).split())
            kind = TimedOutError if "timed out" in text else failed
            raise kind(f"{self._where}: Micro-Manager reports '{text}'; {advice}") from error

    def _load(self) -> None:
        core = self._core
        core.loadSystemConfiguration(str(self._configuration))
        self._camera = core.getCameraDevice()
        if not self._camera:
            raise RefusedError(
                f"{self._where}: the configuration names no camera; add the line 'Property,Core,Camera,NAME'"
            )
        if core.hasProperty(self._camera, "Binning"):
            allowed = core.getAllowedPropertyValues(self._camera, "Binning")
            core.setProperty(self._camera, "Binning", next((word for word in UNBINNED if word in allowed), UNBINNED[0]))
        core.clearROI()
        self._require_raw()

    def _require_raw(self) -> None:
        """Refuse what the rig file does not describe."""
        core, settings = self._core, self._settings
        if settings.gain_db:
            raise RefusedError(
                f"{self._where}: gain_db cannot be set, because gains of Micro-Manager have no common unit; set the "
                "camera's gain in the configuration and leave gain_db out of the rig file"
            )
        if core.getNumberOfComponents() != 1 or core.getBytesPerPixel() not in (1, 2):
            raise RefusedError(
                f"{self._where}: delivers {core.getNumberOfComponents()} component(s) in {core.getBytesPerPixel()} "
                "bytes a pixel, but raw counts of 8 or 16 bits are needed; correct PixelType in the configuration"
            )
        found = (core.getImageBitDepth(), core.getImageWidth(), core.getImageHeight())
        wanted = (settings.bit_depth, settings.width_px, settings.height_px)
        if found != wanted:
            raise RefusedError(
                f"{self._where}: has {found[0]} bits and {found[1]} x {found[2]} px, but the rig file states "
                f"{wanted[0]} bits and {wanted[1]} x {wanted[2]} px; correct bit_depth, width_px and height_px"
            )

    def _identity(self) -> DeviceIdentity:
        core, camera = self._core, self._camera
        return DeviceIdentity(
            role="camera",
            driver="micro-manager",
            address=self._settings.address,
            vendor=core.getDeviceLibrary(camera),
            model=f"{core.getDeviceName(camera)} ({core.getDeviceDescription(camera)})",
            serial=core.getProperty(camera, "CameraID") if core.hasProperty(camera, "CameraID") else "",
            firmware=core.getVersionInfo(),
        )

    def _set_exposure(self, exposure_s: float) -> float:
        self._core.waitForDevice(self._camera)
        self._core.setExposure(1e3 * exposure_s)
        return 1e-3 * float(self._core.getExposure())

    def _snap(self) -> NDArray[np.uint16]:
        self._core.snapImage()
        return np.array(self._core.getImage(), dtype=np.uint16)

    def _recorded(self) -> dict[str, str | float]:
        core, camera = self._core, self._camera
        return {name: str(core.getProperty(camera, name)) for name in RECORDED if core.hasProperty(camera, name)}


@contextmanager
def open_camera(settings: CameraSettings, folder: Path) -> Iterator[MicroManagerCamera]:
    """Open the camera of a Micro-Manager configuration for a ``with`` block; the address is its .cfg file.

    Device adapters are looked for in the folder that the environment variable MICROMANAGER_PATH names, then beside the
    configuration file, then where pymmcore-plus has installed some.

    Raises
    ------
    MissingExtraError
        pymmcore is not installed.
    """
    try:
        from pymmcore import CMMCore
    except ImportError as error:
        raise MissingExtraError(
            f"camera driver 'micro-manager' needs pymmcore ({error}); install it with pip install "
            "'finray-calib[micro-manager]'"
        ) from None
    configuration = folder / settings.address
    if not configuration.is_file():
        raise RefusedError(
            f"{name_of(settings)}: the configuration file {configuration} does not exist; write one with "
            "Micro-Manager's Hardware Configuration Wizard and give it as the address in the rig file"
        )
    core = CMMCore()
    core.setDeviceAdapterSearchPaths(_adapter_folders(configuration))
    camera = MicroManagerCamera(settings, configuration, core)
    try:
        camera.open()
        yield camera
    finally:
        camera.close()


def _adapter_folders(configuration: Path) -> list[str]:
    """Return the folders of device adapters, in the order in which they are searched."""
    named, beside = os.environ.get(ADAPTERS_VARIABLE), str(configuration.resolve().parent)
    try:
        from pymmcore_plus import find_micromanager
    except ImportError:
        installed = None
    else:
        installed = find_micromanager()
    return [folder for folder in (named, beside, installed) if folder]
