"""The Micro-Manager driver against Micro-Manager's own DemoCamera."""

import json
import os
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_schemas import BadFrameError, CameraSettings, LostError, MissingExtraError, RefusedError, TimedOutError
from finray_calib.radiometry import FrameStack, photon_transfer
from finray_calib.radiometry._photon_transfer import MONOCHROME, StackStatistics
from rigs.cameras.micro_manager import MicroManagerCamera, open_camera
from tests.capture.drivers.programs import others_python, require_module

SIDE_PX, BIT_DEPTH, FULL_SCALE_DN = 512, 12, 4095
EXPOSURE_S, DEADLINE_S = 0.01, 5.0
SETTINGS = CameraSettings(
    driver="micro-manager", address="rig.cfg", width_px=SIDE_PX, height_px=SIDE_PX, bit_depth=BIT_DEPTH
)
DEMO = (
    "Property,Core,Initialize,0",
    "Device,Camera,DemoCamera,DCam",
    "Device,Shutter,DemoCamera,DShutter",
    "Property,Core,Initialize,1",
    "Property,Core,Camera,Camera",
    "Property,Camera,PixelType,16bit",
    f"Property,Camera,BitDepth,{BIT_DEPTH}",
)


@pytest.fixture(autouse=True)
def adapters(monkeypatch: pytest.MonkeyPatch) -> Path:
    require_module("pymmcore", "pymmcore")
    require_module("mm_test_adapters", "mm-test-adapters")
    import mm_test_adapters

    folder = Path(mm_test_adapters.__file__).parent / "libs"
    monkeypatch.setenv("MICROMANAGER_PATH", str(folder))
    return folder


def demo(folder: Path, *more: str, **change: Any) -> AbstractContextManager[MicroManagerCamera]:
    (folder / "rig.cfg").write_text("\n".join((*DEMO, *more)) + "\n", encoding="utf-8")
    return open_camera(SETTINGS.model_copy(update=change), folder)


def test_frame_is_what_was_asked(tmp_path: Path) -> None:
    with demo(tmp_path) as camera:
        frame = camera.expose(EXPOSURE_S, DEADLINE_S)
        identity = camera.identity()
    assert frame.counts.shape == (SIDE_PX, SIDE_PX)
    assert frame.counts.dtype == np.uint16
    assert 0 < frame.counts.max() <= FULL_SCALE_DN
    assert frame.exposure_s == pytest.approx(EXPOSURE_S)
    assert frame.settings["Binning"] == "1"
    assert frame.settings["PixelType"] == "16bit"
    assert (identity.vendor, identity.model, identity.serial) == ("DemoCamera", "DCam (Demo camera)", "V1.0")
    assert identity.firmware.startswith("MMCore")


@pytest.mark.parametrize("allowed", [("1", "2", "4"), ("1x1", "2x2"), ()])
def test_binning_is_switched_off_in_the_words_of_the_adapter(
    tmp_path: Path, adapters: Path, allowed: tuple[str, ...]
) -> None:
    """Micro-Manager's own camera counts 1, 2, 4; the adapter of PCO, for one, has 1x1, 2x2; some list nothing."""
    from pymmcore import CMMCore

    class Core(CMMCore):
        binning = "before"

        def getAllowedPropertyValues(self, device: str, name: str) -> tuple[str, ...]:  # noqa: N802
            return allowed if name == "Binning" else super().getAllowedPropertyValues(device, name)

        def setProperty(self, device: str, name: str, value: str) -> None:  # noqa: N802
            if name != "Binning":
                super().setProperty(device, name, value)
            elif allowed and value not in allowed:
                raise RuntimeError(f'Cannot set property "Binning" of device "{device}" to "{value}"')
            else:
                self.binning = value

    core = Core()
    core.setDeviceAdapterSearchPaths([str(adapters)])
    (tmp_path / "rig.cfg").write_text("\n".join(DEMO) + "\n", encoding="utf-8")
    camera = MicroManagerCamera(SETTINGS, tmp_path / "rig.cfg", core)
    try:
        camera.open()
        assert camera.expose(EXPOSURE_S, DEADLINE_S).counts.shape == (SIDE_PX, SIDE_PX)
    finally:
        camera.close()
    assert core.binning == (allowed or ("1",))[0]


def test_adapters_are_found_beside_the_configuration(adapters: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MICROMANAGER_PATH")
    change = {"address": "MMConfig_demo.cfg", "bit_depth": 16}
    with open_camera(SETTINGS.model_copy(update=change), adapters) as camera:
        assert camera.expose(EXPOSURE_S, DEADLINE_S).counts.max() > 0


def stack_of(*frames: np.ndarray) -> StackStatistics:
    stack = FrameStack("test frames", [MONOCHROME], FULL_SCALE_DN)
    for frame in frames:
        stack.add(frame)
    return stack.statistics()[0]


@pytest.mark.parametrize(
    ("k_dn_per_e", "read_noise_e", "longest_s", "noise_tolerance_rel"), [(1.0, 2.5, 0.06, 0.08), (2.0, 7.0, 0.03, 0.05)]
)
def test_gain_and_noise_through_the_driver_are_the_devices_own(
    tmp_path: Path, k_dn_per_e: float, read_noise_e: float, longest_s: float, noise_tolerance_rel: float
) -> None:
    noise = (
        "Property,Camera,Mode,Noise",
        f"Property,Camera,Photon Conversion Factor,{1.0 / k_dn_per_e}",
        f"Property,Camera,ReadNoise (electrons),{read_noise_e}",
        "Property,Camera,Photon Flux,50",
    )
    with demo(tmp_path, *noise) as camera:

        def pair(exposure_s: float) -> StackStatistics:
            return stack_of(*(camera.expose(exposure_s, DEADLINE_S).counts for _ in range(2)))

        dark = [pair(0.0) for _ in range(4)]  # it makes no light at exposure 0 only
        lit = [pair(t) for t in np.linspace(longest_s / 12, longest_s, 12)]
    found = photon_transfer([*dark, *lit], float(np.mean([s.mean_dn for s in dark])), "demo camera")
    # two frames of 512 x 512 px at 12 levels tell the gain to 0.25 % and the read noise to 2.5 %
    assert 1.0 / found.gain_e_per_dn.estimate == pytest.approx(k_dn_per_e, rel=0.01)
    assert found.read_noise_e.estimate == pytest.approx(read_noise_e, rel=noise_tolerance_rel)


@pytest.mark.parametrize("exposure_s", [-0.005, 20.0])
def test_exposure_that_is_kept_silently_is_refused(tmp_path: Path, exposure_s: float) -> None:
    with demo(tmp_path) as camera:
        with pytest.raises(
            RefusedError, match=rf"an exposure of {exposure_s:g} s was requested, but the camera uses 0\.01 s"
        ):
            camera.expose(exposure_s, 25.0)
        assert camera.expose(EXPOSURE_S, DEADLINE_S).exposure_s == pytest.approx(EXPOSURE_S)


def test_slow_adapter_times_out_before_the_deadline_and_recovers(tmp_path: Path) -> None:
    with demo(tmp_path, "Property,Camera,ReadoutTime,3000") as camera:
        started_s = time.monotonic()
        with pytest.raises(TimedOutError, match=r"the device adapter did not finish within 2\.01 s"):
            camera.expose(EXPOSURE_S, DEADLINE_S)
        assert time.monotonic() - started_s < EXPOSURE_S + 2.5
        assert camera.identity().vendor == "DemoCamera"


def test_time_out_of_a_device_is_a_time_out(tmp_path: Path) -> None:
    with (
        pytest.raises(TimedOutError, match='Wait for device "Shutter" timed out after 50ms'),
        demo(tmp_path, "Property,Core,Shutter,Shutter", "Delay,Shutter,1000", "Property,Core,TimeoutMs,50"),
    ):
        pass


@pytest.mark.parametrize(
    ("lines", "change", "message"),
    [
        ((), {"gain_db": 3.0}, "gains of Micro-Manager have no common unit.*leave gain_db out"),
        ((), {"bit_depth": 10}, "has 12 bits and 512 x 512 px, but the rig file states 10 bits"),
        (("Property,Camera,PixelType,32bitRGB",), {}, r"delivers 4 component\(s\) in 4 bytes a pixel"),
        (("Property,Core,Camera,",), {}, "the configuration names no camera"),
        (("Device,More,NoSuchAdapter,X",), {}, "reports .*NoSuchAdapter.*the folder that MICROMANAGER_PATH names"),
        ((), {"address": "other.cfg"}, r"the configuration file .*other\.cfg does not exist"),
    ],
)
def test_configuration_that_does_not_fit_is_refused(
    tmp_path: Path, lines: tuple[str, ...], change: dict[str, Any], message: str
) -> None:
    with pytest.raises(RefusedError, match=message), demo(tmp_path, *lines, **change):
        pass


def test_counts_beyond_the_bits_are_no_frame(tmp_path: Path) -> None:
    """The adapter says 12 bits until its bit depth is changed behind the driver's back."""
    from pymmcore import CMMCore

    (tmp_path / "rig.cfg").write_text("\n".join((*DEMO, "Property,Camera,Mode,Noise")), encoding="utf-8")
    core = CMMCore()
    core.setDeviceAdapterSearchPaths([os.environ["MICROMANAGER_PATH"]])
    camera = MicroManagerCamera(SETTINGS, tmp_path / "rig.cfg", core)
    camera.open()
    core.setProperty("Camera", "BitDepth", "16")
    core.setProperty("Camera", "Photon Flux", "5000")
    with pytest.raises(BadFrameError, match="but 12 bits allow less"):
        camera.expose(EXPOSURE_S, DEADLINE_S)
    core.unloadAllDevices()
    with pytest.raises(LostError, match="Micro-Manager reports 'No device with label"):
        camera.expose(EXPOSURE_S, DEADLINE_S)
    camera.close()


FAULTY_PIXELS = """
import json, sys
from pathlib import Path
import numpy as np
from data_schemas._rig import CameraSettings
from rigs.cameras.micro_manager import open_camera
settings = CameraSettings.model_validate_json(sys.argv[2])
with open_camera(settings, Path(sys.argv[1])) as camera:
    counts = camera.expose(0.01, 5.0).counts
    found = {value: float(np.mean(counts == value)) for value in (0, 4095)}
    sys.stdout.write(json.dumps(found))
"""


@pytest.mark.parametrize(("fault", "count"), [("SaturatePixels", "4095"), ("DropPixels", "0")])
def test_saturated_and_dropped_pixels_come_through_unchanged(tmp_path: Path, fault: str, count: str) -> None:
    """DemoCamera writes some of these pixels beyond its buffer (75.20261014): a process of its own, few pixels."""
    fraction = 0.002
    lines = (f"Property,Camera,{fault},1", f"Property,Camera,FractionOfPixelsToDropOrSaturate,{fraction}")
    (tmp_path / "rig.cfg").write_text("\n".join((*DEMO, *lines)) + "\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", FAULTY_PIXELS, str(tmp_path), SETTINGS.model_dump_json(exclude_unset=True)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.stdout, done.stderr
    # 524 pixels at random places, some twice
    assert json.loads(done.stdout)[count] == pytest.approx(fraction, rel=0.05)


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pymmcore", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[micro-manager\]'"), demo(tmp_path):
        pass


WITH_PLUS = """
import json, sys
from pathlib import Path
from pymmcore_plus import CMMCorePlus, find_micromanager
from data_schemas._rig import CameraSettings
from rigs.cameras.micro_manager import MicroManagerCamera, open_camera
settings, folder = CameraSettings.model_validate_json(sys.argv[2]), Path(sys.argv[1])
with open_camera(settings, folder) as camera:
    found = [int(camera.expose(0.01, 5.0).counts.max())]
core = CMMCorePlus()
core.setDeviceAdapterSearchPaths([find_micromanager()])
camera = MicroManagerCamera(settings, folder / settings.address, core)
camera.open()
frame = camera.expose(0.02, 5.0)
found += [int(frame.counts.max()), frame.exposure_s, camera.identity().vendor]
camera.close()
sys.stdout.write(json.dumps(found))
"""


@pytest.mark.rigs
def test_pymmcore_plus_brings_its_adapters_and_its_core_serves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It lies in the environment of other people's programs: it brings 40 packages that a camera does not need."""
    python = others_python("pymmcore-plus")
    monkeypatch.delenv("MICROMANAGER_PATH")  # nothing but pymmcore-plus knows where the adapters are
    (tmp_path / "rig.cfg").write_text("\n".join(DEMO) + "\n", encoding="utf-8")
    done = subprocess.run(
        [python, "-c", WITH_PLUS, str(tmp_path), SETTINGS.model_dump_json(exclude_unset=True)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    assert done.stdout, done.stderr
    by_driver, by_plus, exposure_s, vendor = json.loads(done.stdout.splitlines()[-1])
    assert by_driver > 0
    assert by_plus > 0
    assert (exposure_s, vendor) == (pytest.approx(0.02), "DemoCamera")
