"""The contracts of rigs.contracts over every implementation that can be opened here."""

import os
import pty
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from data_schemas import (
    CameraSettings,
    FilterWheelSettings,
    LampSettings,
    LoadCellSettings,
    StageSettings,
    Target,
)
from rigs import (
    Camera,
    FilterWheel,
    Light,
    LoadCell,
    OpenRig,
    Stage,
    TerminalOperator,
    open_camera,
    open_lamp,
    open_load_cell,
    open_rig,
    open_stage,
    open_wheel,
    simulated_rig,
    tactile_rig,
    write_rig,
    write_tactile_rig,
)
from rigs.capture import open_tactile_rig
from rigs.contracts import CameraContract, FilterWheelContract, LightContract, LoadCellContract, StageContract
from rigs.light_guard import guarded_light
from rigs.simulated import SimulatedCamera, SimulatedFilterWheel, SimulatedLight
from tests.capture.drivers import picamera2_stand_in
from tests.capture.drivers.alpaca_server import AlpacaServer
from tests.capture.drivers.fake_gigevision_camera import fake_camera
from tests.capture.drivers.firmware_in_qemu import build, firmware_board
from tests.capture.drivers.indi_server import CCD, PANEL, SIMULATORS, WHEEL, IndiServer
from tests.capture.drivers.press_bench import PressBench, press_bench
from tests.capture.drivers.programs import require, require_module
from tests.capture.drivers.rig_excerpts import camera_settings as indi_camera_settings
from tests.capture.drivers.rig_excerpts import wheel_settings as settings_of_wheel
from tests.capture.drivers.test_micro_manager import DEMO
from tests.capture.drivers.test_micro_manager import SETTINGS as DEMO_SETTINGS
from tests.capture.drivers.test_mjpeg import HEIGHT_PX as PICTURE_HEIGHT_PX
from tests.capture.drivers.test_mjpeg import WIDTH_PX as PICTURE_WIDTH_PX
from tests.capture.drivers.test_mjpeg import ffmpeg_server
from tests.capture.drivers.test_stage_and_cell import cell_settings, stage_settings
from tests.capture.drivers.thorlabs_wheel import emulated_wheel
from tests.capture.test_operator import QUESTION, read_until
from tests.command_line.running import finray

RIG = simulated_rig("red", width_px=64, height_px=64)


FINGER = tactile_rig(simulated=True)


class TestSimulatedStage(StageContract):
    @pytest.fixture
    def stage_settings(self) -> StageSettings | None:
        return FINGER.stage

    @pytest.fixture
    def stage(self) -> Iterator[Stage | None]:
        with open_tactile_rig(FINGER, Path()) as opened:
            yield opened.stage

    @pytest.fixture
    def guard(self) -> Callable[[], None]:
        return lambda: None  # nothing to touch: only the driver is looked at


class TestSimulatedLoadCell(LoadCellContract):
    @pytest.fixture
    def load_cell_settings(self) -> LoadCellSettings | None:
        return FINGER.load_cell

    @pytest.fixture
    def load_cell(self) -> Iterator[LoadCell | None]:
        with open_tactile_rig(FINGER, Path()) as opened:
            yield opened.load_cell


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PressBench]:
    with press_bench(tmp_path_factory.mktemp("boards")) as running:
        yield running


class TestGrblStage(StageContract):
    @pytest.fixture
    def stage_settings(self, boards: PressBench) -> StageSettings:
        return stage_settings(str(boards.controller.port.path), clear_mm=-0.5)

    @pytest.fixture
    def stage(self, stage_settings: StageSettings) -> Iterator[Stage]:
        with open_stage(stage_settings) as opened:
            yield opened

    @pytest.fixture
    def guard(self) -> Callable[[], None]:
        return lambda: None  # nothing to touch: only the driver is looked at


class TestHx711Cell(LoadCellContract):
    @pytest.fixture
    def load_cell_settings(self, tmp_path: Path) -> Iterator[LoadCellSettings]:
        with press_bench(tmp_path) as running:
            yield cell_settings(str(running.amplifier.port.path))

    @pytest.fixture
    def load_cell(self, load_cell_settings: LoadCellSettings) -> Iterator[LoadCell]:
        with open_load_cell(load_cell_settings) as opened:
            yield opened


def test_guard_of_the_contract_stops_at_a_real_force(tmp_path: Path) -> None:
    """A rig file whose clear_mm lies too near to the pad, on boards in real time."""
    from rigs import ForceLimitError
    from rigs.capture import free_travel_guard, open_tactile_rig
    from tests.capture.test_stage_press import real_rig

    with press_bench(tmp_path) as bench:
        bench.surface_mm = -0.75
        rig = real_rig(tmp_path, bench)
        assert rig.stage is not None
        assert rig.load_cell is not None
        with open_tactile_rig(rig, tmp_path, only="stage and load cell") as opened:
            guard, stage = free_travel_guard(opened, rig, tmp_path), opened.stage
            assert stage is not None
            stage.home(10.0, guard)
            contract = StageContract()
            contract.go(stage, rig.stage, 0, guard)  # clear of the pad, in steps
            with pytest.raises(
                ForceLimitError, match=r"beyond the limit of 0\.4 N; the indenter touches before clear_mm"
            ):
                contract.go(stage, rig.stage, 20, guard)
            time.sleep(0.3)
            stood_mm = bench.controller.at_mm["Z"]
            time.sleep(0.3)
        assert bench.controller.at_mm["Z"] == stood_mm
        # a tenth of 4 N, and what one step of 0.1 mm adds at 4 N/mm
        assert 0.4 <= bench.strongest_n <= 0.4 + 0.4 + 0.05


def test_suite_runs_on_a_finger_rig(tmp_path: Path) -> None:
    write_tactile_rig(FINGER, tmp_path / "rig.toml")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--pyargs", "rigs.contracts"]
    options = {"cwd": tmp_path, "capture_output": True, "text": True, "check": False}
    # a stage does not move before its cell can tell newtons
    refused = subprocess.run([*command, "--rig", "rig.toml", "-k", "TestStage"], **options)
    assert refused.returncode != 0
    assert "finray rig calibrate-cell" in refused.stdout
    calibrated = finray(f"rig calibrate-cell {tmp_path}/rig.toml --masses-g 20,50,100,200 --gravity 9.81")
    assert calibrated.status == 0
    done = subprocess.run([*command, "--rig", "rig.toml"], **options)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "IS HOMED and MOVES some steps from clear_mm" in done.stdout
    # five of the stage and four of the cell beside those of the camera
    assert int(done.stdout.rpartition(" passed")[0].split()[-1]) >= 9 + 5


def test_stage_without_switches_moves_only_after_yes(tmp_path: Path) -> None:
    write_tactile_rig(FINGER, tmp_path / "rig.toml")
    assert finray(f"rig calibrate-cell {tmp_path}/rig.toml --masses-g 20,50,100,200 --gravity 9.81").status == 0
    text = (tmp_path / "rig.toml").read_text()
    assert 'homing = "switches"' in text
    (tmp_path / "rig.toml").write_text(text.replace('homing = "switches"', 'homing = "by hand"'))
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--pyargs", "rigs.contracts", "-s", "-rs"]
    command += ["--rig", "rig.toml", "-k", "TestStage and arrives"]
    unasked = subprocess.run(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert "NOT TESTED: nobody confirmed that the stage is at its zero" in unasked.stdout
    assert " passed" not in unasked.stdout
    for answer, ends in ((b"no\n", b"1 skipped"), (b"yes\n", b"1 passed")):
        ours, theirs = pty.openpty()
        with subprocess.Popen(command, cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs):
            os.close(theirs)
            assert b"Have you brought the stage to the zero" in read_until(ours, QUESTION)
            os.write(ours, answer)
            assert ends in read_until(ours, ends)
            read_until(ours, b"\0")  # until the program has ended
        os.close(ours)


class Willing:
    """An operator who does everything at once."""

    def place(self, target: Target) -> None: ...

    def swing_wheel_out(self) -> None: ...

    def tilt(self, angle_deg: float) -> None: ...

    def do(self, instruction: str) -> None: ...


@pytest.fixture(scope="module")
def bench() -> Iterator[OpenRig]:
    with open_rig(RIG, Path()) as opened:
        yield opened


class TestSimulatedCamera(CameraContract):
    @pytest.fixture
    def camera_settings(self) -> CameraSettings:
        return RIG.camera

    @pytest.fixture
    def camera(self, bench: OpenRig) -> Camera:
        return bench.camera


class TestSimulatedWheel(FilterWheelContract):
    @pytest.fixture
    def wheel_settings(self) -> FilterWheelSettings:
        return RIG.filter_wheel

    @pytest.fixture
    def wheel(self, bench: OpenRig) -> FilterWheel:
        return bench.wheel


@pytest.mark.parametrize("name", ["lamp", "laser"])
class TestSimulatedLights(LightContract):
    @pytest.fixture
    def light(self, bench: OpenRig, name: str) -> Light:
        return bench.lamp if name == "lamp" else bench.laser

    @pytest.fixture
    def switch_off_behind(self, light: SimulatedLight) -> Callable[[], None]:
        return lambda: setattr(light.bench_state, light.name, False)


@pytest.fixture(scope="module")
def fw212c() -> Iterator[str]:
    with emulated_wheel() as running:
        running.reset()
        yield running.address


@pytest.mark.rigs
class TestThorlabsWheel(FilterWheelContract):
    @pytest.fixture
    def wheel_settings(self, fw212c: str) -> FilterWheelSettings:
        return settings_of_wheel(fw212c, "thorlabs", 8)

    @pytest.fixture
    def wheel(self, wheel_settings: FilterWheelSettings) -> Iterator[FilterWheel]:
        with open_wheel(wheel_settings, Willing()) as wheel:
            yield wheel


class TestManualWheel(FilterWheelContract):
    @pytest.fixture
    def wheel_settings(self) -> FilterWheelSettings:
        return settings_of_wheel("", "manual")

    @pytest.fixture
    def wheel(self, wheel_settings: FilterWheelSettings) -> Iterator[FilterWheel]:
        with open_wheel(wheel_settings, Willing()) as wheel:
            yield wheel


class TestManualLamp(LightContract):
    @pytest.fixture
    def light(self) -> Iterator[Light]:
        with open_lamp(LampSettings(driver="manual"), Willing()) as lamp:
            yield lamp


class TestMicroManagerCamera(CameraContract):
    @pytest.fixture
    def camera_settings(self) -> CameraSettings:
        return DEMO_SETTINGS

    @pytest.fixture
    def camera(
        self, camera_settings: CameraSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> Iterator[Camera]:
        require_module("pymmcore", "pymmcore")
        require_module("mm_test_adapters", "mm-test-adapters")
        import mm_test_adapters

        monkeypatch.setenv("MICROMANAGER_PATH", str(Path(mm_test_adapters.__file__).parent / "libs"))
        (tmp_path / camera_settings.address).write_text("\n".join(DEMO) + "\n", encoding="utf-8")
        with open_camera(camera_settings, tmp_path) as camera:
            yield camera


class TestImageFolder(CameraContract):
    @pytest.fixture
    def camera_settings(self, tmp_path: Path) -> CameraSettings:
        return CameraSettings(driver="folder", address=str(tmp_path), width_px=96, height_px=64)

    @pytest.fixture
    def camera(self, camera_settings: CameraSettings, tmp_path: Path) -> Iterator[Camera]:
        folder_of_images(tmp_path)
        with open_camera(camera_settings, tmp_path) as camera:
            yield camera


def folder_of_images(folder: Path) -> None:
    """Write images of noise with the exposures that the contracts ask for."""
    exposures_s = (0.01,) * 4 + (0.02,) * 2 + (2.0,) * 2
    lines = ["file,exposure_s"]
    for number, exposure_s in enumerate(exposures_s):
        counts = np.random.default_rng(number).integers(0, 1024, (64, 96)).astype(np.uint16)
        tifffile.imwrite(folder / f"{number}.tiff", counts, photometric="minisblack")
        lines.append(f"{number}.tiff,{exposure_s}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")


class TestRaspberryPiCamera(CameraContract):
    """Over a stand-in that follows picamera2's source; not hardware-verified."""

    @pytest.fixture
    def camera_settings(self) -> CameraSettings:
        return CameraSettings(driver="picamera2", address="0", width_px=96, height_px=64)

    @pytest.mark.skip(reason="the stand-in takes frames in the caller's thread and knows no time-out but for silence")
    def test_deadline_is_kept(self) -> None: ...

    @pytest.fixture
    def camera(self, camera_settings: CameraSettings, monkeypatch: pytest.MonkeyPatch) -> Iterator[Camera]:
        monkeypatch.setitem(sys.modules, "picamera2", picamera2_stand_in.module())
        with open_camera(camera_settings, Path()) as camera:
            yield camera


@pytest.mark.rigs
class TestMjpegCamera(CameraContract):
    @pytest.fixture
    def camera_settings(self) -> Iterator[CameraSettings]:
        with ffmpeg_server() as (address, _):
            yield mjpeg_settings(address)

    @pytest.fixture
    def camera(self, camera_settings: CameraSettings) -> Iterator[Camera]:
        with open_camera(camera_settings, Path()) as camera:
            yield camera


def mjpeg_settings(address: str) -> CameraSettings:
    size = {"width_px": PICTURE_WIDTH_PX, "height_px": PICTURE_HEIGHT_PX, "bit_depth": 8}
    return CameraSettings.model_validate({"driver": "mjpeg", "address": address, **size})


@pytest.fixture(scope="module")
def gigevision() -> Iterator[str]:
    require("arv-tool-0.8", "aravis-tools-cli libaravis-0.8-0")
    with fake_camera():
        yield "127.0.0.1"


@pytest.mark.rigs
class TestAravisCamera(CameraContract):
    @pytest.fixture
    def camera_settings(self, gigevision: str) -> CameraSettings:
        return CameraSettings(driver="aravis", address=gigevision, width_px=512, height_px=512, bit_depth=8)

    @pytest.fixture
    def camera(self, camera_settings: CameraSettings) -> Iterator[Camera]:
        with open_camera(camera_settings, Path()) as camera:
            yield camera


@pytest.fixture(scope="module")
def indi(tmp_path_factory: pytest.TempPathFactory) -> Iterator[IndiServer]:
    with IndiServer(tmp_path_factory.mktemp("indi"), SIMULATORS) as server:
        yield server


@pytest.mark.rigs
class TestIndiCamera(CameraContract):
    @pytest.fixture
    def camera_settings(self, indi: IndiServer) -> CameraSettings:
        return indi_camera_settings(indi.address(CCD), width_px=64, height_px=64)

    @pytest.fixture
    def camera(self, camera_settings: CameraSettings) -> Iterator[Camera]:
        with open_camera(camera_settings, Path()) as camera:
            yield camera


@pytest.mark.rigs
class TestIndiWheel(FilterWheelContract):
    @pytest.fixture
    def wheel_settings(self, indi: IndiServer) -> FilterWheelSettings:
        return settings_of_wheel(indi.address(WHEEL), "indi", 8)

    @pytest.fixture
    def wheel(self, wheel_settings: FilterWheelSettings) -> Iterator[FilterWheel]:
        with open_wheel(wheel_settings, Willing()) as wheel:
            yield wheel


@pytest.mark.rigs
class TestIndiLaser(LightContract):
    @pytest.fixture
    def light(self, indi: IndiServer) -> Iterator[Light]:
        with guarded_light("laser", "indi", indi.address(PANEL)) as light:
            yield light

    @pytest.fixture
    def switch_off_behind(self, indi: IndiServer) -> Callable[[], None]:
        return lambda: indi.put(PANEL, "FLAT_LIGHT_CONTROL.FLAT_LIGHT_OFF=On")


@pytest.mark.rigs
class TestIndiLamp(LightContract):
    @pytest.fixture
    def light(self, indi: IndiServer) -> Iterator[Light]:
        settings = LampSettings(driver="indi", address=indi.address(PANEL))
        with open_lamp(settings, TerminalOperator()) as light:
            yield light

    @pytest.fixture
    def switch_off_behind(self, indi: IndiServer) -> Callable[[], None]:
        return lambda: indi.put(PANEL, "FLAT_LIGHT_CONTROL.FLAT_LIGHT_OFF=On")


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("firmware"))


@pytest.mark.rigs
class TestArduinoLaser(LightContract):
    @pytest.fixture
    def light(self, elf: Path) -> Iterator[Light]:
        with ExitStack() as stack:
            board = stack.enter_context(firmware_board(elf))
            yield stack.enter_context(guarded_light("laser", "arduino", board.address))


@pytest.fixture(scope="module")
def alpaca(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AlpacaServer]:
    with AlpacaServer(tmp_path_factory.mktemp("alpaca")) as server:
        yield server


@pytest.mark.rigs
class TestAlpacaWheel(FilterWheelContract):
    @pytest.fixture
    def wheel_settings(self, alpaca: AlpacaServer) -> FilterWheelSettings:
        return settings_of_wheel(f"{alpaca.url}/0", "alpaca", 8)

    @pytest.fixture
    def wheel(self, wheel_settings: FilterWheelSettings) -> Iterator[FilterWheel]:
        with open_wheel(wheel_settings, Willing()) as wheel:
            yield wheel


@pytest.mark.rigs
class TestAlpacaLaser(LightContract):
    @pytest.fixture
    def light(self, alpaca: AlpacaServer) -> Iterator[Light]:
        with guarded_light("laser", "alpaca", f"{alpaca.url}/switch/0/0") as light:
            yield light

    @pytest.fixture
    def switch_off_behind(self, alpaca: AlpacaServer) -> Callable[[], None]:
        return lambda: put(f"{alpaca.url}/api/v1/switch/0/setswitch", Id="0", State="False")


@pytest.mark.rigs
class TestAlpacaLamp(LightContract):
    @pytest.fixture
    def light(self, alpaca: AlpacaServer) -> Iterator[Light]:
        settings = LampSettings(driver="alpaca", address=f"{alpaca.url}/covercalibrator/0")
        with open_lamp(settings, TerminalOperator()) as light:
            yield light

    @pytest.fixture
    def switch_off_behind(self, alpaca: AlpacaServer) -> Callable[[], None]:
        return lambda: put(f"{alpaca.url}/api/v1/covercalibrator/0/calibratoroff")


def put(url: str, **fields: str) -> None:
    """Send an Alpaca request as any other client would."""
    body = urllib.parse.urlencode({"ClientID": "77", "ClientTransactionID": "1", **fields}).encode()
    urllib.request.urlopen(urllib.request.Request(url, data=body, method="PUT"), timeout=5.0).close()


class TestBrokenDevices:
    """What the suites are there to find is found."""

    def test_wheel_that_is_stuck(self, bench: OpenRig, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(SimulatedFilterWheel, "go_to", lambda self, slot, deadline_s: None)
        with pytest.raises(AssertionError):
            FilterWheelContract().test_every_slot_is_reached_and_read_twice(bench.wheel)

    def test_wheel_that_takes_any_slot(self, bench: OpenRig, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(SimulatedFilterWheel, "go_to", lambda self, slot, deadline_s: None)
        with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
            FilterWheelContract().test_slot_that_it_lacks_is_refused_before_it_moves(bench.wheel)

    def test_light_that_an_exception_leaves_on(self, bench: OpenRig, monkeypatch: pytest.MonkeyPatch) -> None:
        @contextmanager
        def lit(light: SimulatedLight) -> Iterator[None]:
            light.bench_state.lamp = True
            yield
            light.bench_state.lamp = False

        monkeypatch.setattr(SimulatedLight, "lit", lit)
        LightContract().test_on_and_off_are_confirmed(bench.lamp)
        try:
            with pytest.raises(AssertionError):
                LightContract().test_exception_leaves_it_off(bench.lamp)
        finally:
            bench.lamp.bench_state.lamp = False

    def test_light_whose_state_is_remembered(self, bench: OpenRig) -> None:
        with pytest.raises(AssertionError):
            LightContract().test_state_is_asked_afresh(bench.lamp, lambda: None)

    def test_camera_that_repeats_a_frame(self, bench: OpenRig, monkeypatch: pytest.MonkeyPatch) -> None:
        frame = bench.camera.expose(0.01, 5.0)
        monkeypatch.setattr(SimulatedCamera, "expose", lambda self, exposure_s, deadline_s: frame)
        with pytest.raises(AssertionError):
            CameraContract().test_every_frame_is_new(bench.camera, (0.01, 0.02))

    def test_camera_that_keeps_its_exposure(self, bench: OpenRig, monkeypatch: pytest.MonkeyPatch) -> None:
        frame = bench.camera.expose(0.01, 5.0)
        monkeypatch.setattr(
            SimulatedCamera, "expose", lambda self, asked_s, deadline_s: replace(frame, exposure_requested_s=asked_s)
        )
        with pytest.raises(AssertionError):
            CameraContract().test_exposure_is_read_back(bench.camera, RIG.camera, (0.01, 0.02))
        with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
            CameraContract().test_impossible_exposure_is_refused_and_the_next_is_not(
                bench.camera, RIG.camera, (0.01, 0.02)
            )


class TestOnARigFile:
    """The suites as their users run them."""

    def run(self, folder: Path, *options: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "pytest", "--pyargs", "rigs.contracts"]
        return subprocess.run(
            [*command, "-p", "no:cacheprovider", "-rs", *options],
            cwd=folder, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip

    def test_simulated_rig_passes(self, tmp_path: Path) -> None:
        write_rig(RIG, tmp_path / "my-rig.toml")
        done = self.run(tmp_path, "--rig", "my-rig.toml", "-v")
        assert done.returncode == 0, done.stdout
        assert "laser: simulated (450 nm, 4.5 mW, class 3R); IS SWITCHED ON" in done.stdout
        for name in ("TestCamera::", "TestFilterWheel::", "TestLaser::", "TestLamp::"):
            assert name in done.stdout

    def test_laser_of_a_real_rig_stays_off_unless_it_is_asked_for(self, tmp_path: Path) -> None:
        for name, text in (("missing.toml", ""), ("real.toml", real_rig_text())):
            (tmp_path / name).write_text(text)
        asked = self.run(tmp_path, "--rig", "real.toml", "-k", "TestLaser or TestLamp")
        assert asked.returncode == 0, asked.stdout
        assert "takes frames" not in asked.stdout  # neither camera nor wheel is among the selected tests
        assert "TURNS through all of its slots" not in asked.stdout
        assert "NOT TESTED: the operator is asked at the terminal" in asked.stdout  # the lamp is switched by hand
        assert "stays off, without --with-laser" in asked.stdout
        assert "LASER NOT TESTED: it is switched on only with --with-laser" in asked.stdout
        refused = self.run(tmp_path, "--rig", "missing.toml")
        assert refused.returncode == pytest.ExitCode.USAGE_ERROR
        assert "missing.toml" in refused.stderr

    def test_rig_of_a_tactile_session_has_a_camera_only(self, tmp_path: Path) -> None:
        folder_of_images(tmp_path)
        camera = 'driver = "folder"\naddress = "."\nwidth_px = 96\nheight_px = 64\n'
        (tmp_path / "tactile.toml").write_text(f'name = "finger"\n[camera]\n{camera}')
        done = self.run(tmp_path, "--rig", "tactile.toml", "-k", "says_what_it_is")
        assert done.returncode == 0, done.stdout
        assert "camera: folder at .; takes frames" in done.stdout
        assert "1 passed" in done.stdout
        assert "skipped" not in done.stdout  # what such a rig never has is deselected

    def test_plugin_may_be_named(self, tmp_path: Path) -> None:
        """As it had to be before."""
        write_rig(RIG, tmp_path / "my-rig.toml")
        done = self.run(tmp_path, "-p", "rigs.contracts.plugin", "--rig", "my-rig.toml", "-k", "says_what_it_is")
        assert done.returncode == 0, done.stdout + done.stderr

    def test_nothing_is_tested_without_a_rig_file(self, tmp_path: Path) -> None:
        assert self.run(tmp_path).returncode == pytest.ExitCode.NO_TESTS_COLLECTED

    def test_missing_pytest_is_named(self) -> None:
        code = "import sys; sys.modules['pytest'] = None; import rigs.contracts"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert "need pytest" in done.stderr
        assert "pip install pytest" in done.stderr


def real_rig_text() -> str:
    """A rig whose laser must not be opened here: its port does not exist."""
    from rigs import paper_rig, rig_toml

    return rig_toml(paper_rig({}))
