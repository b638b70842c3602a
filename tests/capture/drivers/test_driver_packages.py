"""Drivers of packages outside the tree: found by name, refused in one sentence with their package; the printed one."""

import importlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MethodType, SimpleNamespace

import pytest

from data_schemas import (
    NO_ADDRESS,
    CameraSettings,
    CaptureError,
    CaptureSession,
    FilterWheelSettings,
    LampSettings,
    LaserSettings,
    PlugIn,
    RecordError,
    RefusedError,
    RigFile,
    Target,
    TimedOutError,
)
from data_schemas.storage import read_toml
from finray_calib.demo._machine_checks import check_drivers
from rigs import (
    Kind,
    RawFrame,
    detect,
    find_driver,
    offered,
    open_lamp,
    open_rig,
    open_wheel,
    paint_plan,
    simulated_rig,
    write_rig,
)
from rigs._drivers import _PackagedDevice
from rigs.capture import SessionRequest, capture_paint_session
from rigs.capture._press_rounds import _StopRequestedError
from rigs.contracts import FilterWheelContract
from rigs.simulated import SimulatedCamera
from tests.capture import finger_session
from tests.capture.drivers import file_switch
from tests.capture.drivers.driver_packages import install, site
from tests.capture.drivers.grbl_board import GrblBoard, grbl_board
from tests.capture.drivers.test_whole_sessions import INTERLOCK, LASER, Hands
from tests.command_line.running import finray

__all__ = ["site"]
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "write-a-driver.md"
WHEELS, CAMERAS, LIGHTS = (f"finray_calib.{kind}" for kind in ("filter_wheels", "cameras", "lights"))
SIMULATED = simulated_rig("red", width_px=160, height_px=128)


def printed(language: str) -> str:
    """Return the page's only block of a language."""
    (block,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    return block


@pytest.fixture
def grbl(site: Path) -> Path:
    """Install the package of the page, from the page."""
    project = tomllib.loads(printed("toml"))["project"]
    assert project["version"] == "0.1"
    ((group, names),) = project["entry-points"].items()
    install(site, project["name"], {group: names}, **{names["grbl"]: printed("python")})
    return site


@pytest.fixture
def board() -> Iterator[GrblBoard]:
    with grbl_board() as running:
        yield running


def wheel_of(driver: str, address: str) -> FilterWheelSettings:
    return SIMULATED.filter_wheel.model_copy(update={"driver": driver, "address": address})


def real_rig(folder: Path, wheel: FilterWheelSettings, **others: object) -> Path:
    """Write a rig file with a wheel of an outside driver and a lamp in a folder."""
    parts: dict[str, object] = {
        "camera": SIMULATED.camera.model_copy(update={"driver": "bench", "address": str(folder / "camera")}),
        "laser": LaserSettings(driver="file", address=str(folder / "laser"), outside_layer=INTERLOCK, **LASER),
        "lamp": LampSettings(driver="file", address=str(folder / "lamp")),
        **others,
    }
    for light in ("laser", "lamp"):
        (folder / light).mkdir(exist_ok=True)
    rig = RigFile.model_validate({"name": "bench of packages", "filter_wheel": wheel, **parts})
    return write_rig(rig, folder / "rig.toml")


def test_the_printed_driver_is_short() -> None:
    lines = [line for line in printed("python").splitlines() if line.strip()]
    assert len(lines) < 60
    assert max(map(len, lines)) <= 120


class TestPrintedWheel(FilterWheelContract):
    """The contracts of filter wheels, on the page's driver and a simulated board."""

    @pytest.fixture
    def wheel_settings(self, board: GrblBoard) -> FilterWheelSettings:
        return wheel_of("grbl", board.address)

    @pytest.fixture
    def wheel(self, grbl: Path, wheel_settings: FilterWheelSettings):
        with open_wheel(wheel_settings, Hands()) as wheel:
            yield wheel


def test_it_homes_before_its_first_move_only_and_stands_where_it_says(grbl: Path, board: GrblBoard) -> None:
    with open_wheel(wheel_of("grbl", board.address), Hands()) as wheel:
        assert (wheel.position(), board.homings) == (None, 0)  # opening moves nothing
        for slot in (3, 8, 1):
            wheel.go_to(slot, 5.0)
            assert (wheel.position(), board.in_beam(), board.homings) == (slot, slot, 1)
        assert wheel.identity().firmware == "1.1h.20190825"
    with open_wheel(wheel_of("grbl", board.address), Hands()) as wheel:
        assert wheel.position() == 1  # as the board says, not as this driver was told


def test_it_homes_again_after_a_move_that_was_cut_off(grbl: Path, board: GrblBoard) -> None:
    with open_wheel(wheel_of("grbl", board.address), Hands()) as wheel:
        wheel.go_to(1, 5.0)
        board.slots_per_s = 2.0  # so that it still turns when the answer is given up, after a second
        with pytest.raises(TimedOutError, match=r"not at slot 8 in 0\.01 s, says Run"):
            wheel.go_to(8, 0.01)
        board.is_mute = True
        with pytest.raises(TimedOutError, match="did not answer"):
            wheel.position()
        board.is_mute, board.slots_per_s = False, 40.0
        wheel.go_to(2, 5.0)
        assert board.in_beam() == wheel.position() == 2
        assert board.homings == 2


def test_a_board_that_counts_other_steps_is_refused(grbl: Path) -> None:
    with (
        grbl_board(steps_per_slot=250.0) as board,
        pytest.raises(RefusedError, match=r"X axis does not count slots; send it \$100=400"),
        open_wheel(wheel_of("grbl", board.address), Hands()),
    ):
        pytest.fail("opened")


BENCH_CAMERA = """
from contextlib import contextmanager
CAMERA = None

@contextmanager
def open_camera(settings, folder):
    yield CAMERA
"""


@dataclass
class BenchCamera:
    """A camera that sees the light of the file lights through the slot in which the board's wheel really stands."""

    camera: SimulatedCamera
    board: GrblBoard
    folder: Path

    def identity(self):
        return self.camera.identity().model_copy(update={"driver": "bench"})

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        state, slot = self.camera.state, self.board.in_beam()
        assert slot is not None
        state.slot = slot
        state.lamp, state.laser = ((self.folder / light / "on").exists() for light in ("lamp", "laser"))
        frame = self.camera.expose(exposure_s, deadline_s)
        return replace(frame, captured_utc=datetime.now(UTC).isoformat(timespec="milliseconds"))


class BenchHands(Hands):
    """An operator who places targets on the bench."""

    def __init__(self, camera: SimulatedCamera) -> None:
        super().__init__()
        self._state = camera.state

    def place(self, target: Target) -> None:
        self._state.target, self._state.wheel_swung_out = target, False

    def swing_wheel_out(self) -> None:
        self._state.wheel_swung_out = True

    def tilt(self, angle_deg: float) -> None:
        self._state.tilt_deg = angle_deg


def captured(site: Path, folder: Path, board: GrblBoard) -> CaptureSession:
    """Capture a whole session with camera, wheel, laser and lamp of packages outside the tree."""
    install(
        site,
        "bench-devices",
        {CAMERAS: {"bench": "bench_camera"}, LIGHTS: {"file": file_switch.__name__}},
        bench_camera=BENCH_CAMERA,
    )
    path = real_rig(folder, wheel_of("grbl", board.address))
    rig = read_toml(path, RigFile)
    with open_rig(SIMULATED, Path()) as bench:
        assert isinstance(bench.camera, SimulatedCamera)
        importlib.import_module("bench_camera").CAMERA = BenchCamera(bench.camera, board, folder)
        hands = BenchHands(bench.camera)
        plan = paint_plan("red", rig.camera)
        return capture_paint_session(
            rig, plan, SessionRequest(folder / "session", "finray capture", rig_folder=folder, operator=hands)
        )


def test_a_whole_session_with_devices_of_other_packages(grbl: Path, board: GrblBoard, tmp_path: Path) -> None:
    session = captured(grbl, tmp_path, board)
    assert session.filter_proof is not None
    assert session.filter_proof.verdict == "confirmed"
    assert board.homings == 1
    assert {note for note in session.notes if "driver" in note} == {
        "filter wheel: driver grbl (finray-grbl-wheel 0.1)",
        "camera: driver bench (bench-devices 0.1)",
        "light: driver file (bench-devices 0.1)",
    }
    assert [d.driver for d in session.devices][:2] == ["bench", "grbl"]
    assert not any((tmp_path / light / "on").exists() for light in ("lamp", "laser"))


def test_a_slot_that_the_motor_lost_is_seen_in_the_frames(grbl: Path, tmp_path: Path) -> None:
    with (
        grbl_board(slipped=1) as board,
        pytest.raises(CaptureError, match=r"frames fit much better with filters .* exchanged; open the wheel and look"),
    ):
        captured(grbl, tmp_path, board)


def test_a_tactile_session_notes_the_package_of_its_camera(site: Path, sensor, tmp_path: Path) -> None:
    source = "from rigs.cameras.raspberry_pi import open_camera as open_camera"
    install(site, "my-camera", {CAMERAS: {"my-camera": "my_camera"}}, my_camera=source)
    rig = finger_session.rig_of(tmp_path)
    rig = rig.model_copy(update={"camera": rig.camera.model_copy(update={"driver": "my-camera"})})
    plan = finger_session.plan_of(tmp_path)
    session = finger_session.capture(tmp_path, plan, rig, finger_session.pressing(sensor))
    assert session.notes[0] == "camera: driver my-camera (my-camera 0.1)"


def pytest_of(rig: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    """Run the contracts as their users do."""
    command = [sys.executable, "-m", "pytest", "--pyargs", "rigs.contracts", "--rig", rig.name, *options]
    return subprocess.run(
        [*command, "-p", "no:cacheprovider", "-rs"],
        cwd=rig.parent, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def test_the_contracts_run_on_a_rig_file_and_say_what_moves(grbl: Path, board: GrblBoard, tmp_path: Path) -> None:
    install(grbl, "file-lights", {LIGHTS: {"file": file_switch.__name__}})
    folder_camera = CameraSettings(driver="folder", address="images")
    done = pytest_of(real_rig(tmp_path, wheel_of("grbl", board.address), camera=folder_camera), "-k", "not TestCamera")
    assert done.returncode == 0, done.stdout
    assert (
        f"filter wheel: grbl (finray-grbl-wheel 0.1) at {board.address}; TURNS through all of its slots" in done.stdout
    )
    assert f"lamp: file (file-lights 0.1) at {tmp_path}/lamp; IS SWITCHED ON briefly" in done.stdout
    assert "stays off, without --with-laser" in done.stdout
    assert "takes frames" not in done.stdout  # its tests are not among the selected ones
    assert "LASER NOT TESTED" in done.stdout
    assert re.search(r"10 passed, 6 skipped, 15 deselected", done.stdout), done.stdout


def test_show_and_detect_and_doctor_name_the_package(
    grbl: Path, board: GrblBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(grbl, "file-lights", {LIGHTS: {"file": file_switch.__name__}})
    rig = real_rig(tmp_path, wheel_of("grbl", board.address), camera=CameraSettings(driver="folder", address="images"))
    shown = finray(f"rig show {rig}")
    assert f"filter wheel: grbl (finray-grbl-wheel 0.1) at {board.address}\n  stepper wheel on GRBL, firmware 1.1h" in (
        shown.out
    )
    assert board.homings == 0
    for kind in ("camera", "filter wheel", "light"):
        for name in set(offered(kind)) - {"grbl", "file"}:
            monkeypatch.delitem(offered(kind), name)
    detection = detect()
    assert detection.notes == (
        "filter wheel driver grbl (finray-grbl-wheel 0.1) is installed",
        "light driver file (file-lights 0.1) is installed",
    )
    assert detection.not_searched == ("grbl", "file")


def test_doctor_lists_them_and_says_what_is_wrong(grbl: Path) -> None:
    assert check_drivers() == {"state": "good", "found": "filter wheel grbl (finray-grbl-wheel 0.1)", "mend": ""}
    install(grbl, "broken-camera", {CAMERAS: {"broken": "broken_camera"}}, broken_camera="")
    offered.cache_clear()
    wrong = check_drivers()
    assert wrong["state"] == "note"
    assert wrong["found"].startswith("camera: driver 'broken' of package broken-camera 0.1 does not define open_camera")
    assert wrong["mend"].startswith("update it (pip install --upgrade broken-camera)")


WORKS = "from contextlib import contextmanager\n@contextmanager\ndef open_wheel(settings, operator):\n    yield {}\n"


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("import no_such_module_anywhere", r"cannot be imported \(ModuleNotFoundError: No module named"),
        ("raise OSError('board')", r"cannot be imported \(OSError: board\)"),
        ("1 +", r"cannot be imported \(SyntaxError"),
        ("", "does not define open_wheel in its module broken_wheel"),
        (WORKS.format("object()"), "returns a device that lacks identity, slots, position, go_to"),
        (WORKS.format("settings.no_such_field"), r"fails when it opens \(AttributeError"),
        ("def open_wheel(settings):\n    return None", r"fails when it opens \(TypeError"),
    ],
)
def test_a_driver_that_is_not_as_it_must_be_is_refused_with_its_package(site: Path, source: str, why: str) -> None:
    install(site, "broken-wheel", {WHEELS: {"broken": "broken_wheel"}}, broken_wheel=source)
    wheel = wheel_of("broken", "/dev/null")
    named = "filter wheel: driver 'broken' of package broken-wheel 0.1 "
    with (
        pytest.raises(RefusedError, match=f"^{named}{why}.*pip install --upgrade broken-wheel"),
        open_wheel(wheel, Hands()),
    ):
        pytest.fail("opened")


FAILING = """
from contextlib import contextmanager
from data_schemas import DeviceIdentity

class Wheel:
    slots = (1, 2, 3)
    def identity(self): return DeviceIdentity(role="filter wheel", driver="failing")
    def position(self): {fault}
    def go_to(self, slot, deadline_s): {fault}

@contextmanager
def open_wheel(settings, operator):
    yield Wheel()
"""


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (
            "return int('POS three')",
            r"ValueError: invalid literal.*; update it \(pip install --upgrade failing-wheel\)",
        ),
        ("raise OSError('board gone')", r"OSError: board gone\); check the device and its cable"),
        ("raise SystemExit(3)", r"SystemExit: 3\); update it"),
    ],
)
def test_an_error_of_a_drivers_own_after_opening_names_device_and_method(
    site: Path, tmp_path: Path, fault: str, why: str
) -> None:
    install(
        site,
        "failing-wheel",
        {WHEELS: {"failing": "failing_wheel"}, LIGHTS: {"file": file_switch.__name__}},
        failing_wheel=FAILING.replace("{fault}", fault),
    )
    named = rf"filter wheel: driver 'failing' of package failing-wheel 0\.1 fails in {{}}\(\) \({why}"
    with open_wheel(wheel_of("failing", "1"), Hands()) as wheel:
        assert wheel.slots == (1, 2, 3)
        for method, act in (("position", wheel.position), ("go_to", lambda: wheel.go_to(1, 1.0))):
            with pytest.raises(CaptureError, match=f"^{named.format(method)}"):
                act()
    rig = real_rig(tmp_path, wheel_of("failing", "1"), camera=CameraSettings(driver="folder", address="images"))
    shown = finray(f"rig show {rig}")
    assert shown.status == 2
    assert re.search(f"ERROR: {named.format('position')}", shown.out), shown.out
    assert "\nfilters and curves\n" in shown.out  # the other parts are shown all the same


def test_a_driver_is_not_blamed_for_the_stop_that_a_check_asks_for() -> None:
    """The check of a stage ends its move by an error of its own."""

    class Mover:
        def move(self, watch: Callable[[], None]) -> None:
            watch()

    def ask() -> None:
        raise _StopRequestedError

    plug_in = SimpleNamespace(refusal=lambda *_: AssertionError("the driver is blamed"))
    plug_in.call = MethodType(PlugIn.call, plug_in)
    with pytest.raises(_StopRequestedError):
        _PackagedDevice(plug_in, Mover(), Mover).move(ask)


def test_a_session_whose_driver_fails_ends_with_the_lights_off(
    grbl: Path, board: GrblBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exposures = []

    def fail_in_light(camera: BenchCamera, exposure_s: float, deadline_s: float) -> RawFrame:
        exposures.append((tmp_path / "laser" / "on").exists())
        if exposures[-1]:
            raise ZeroDivisionError("gain")
        return expose(camera, exposure_s, deadline_s)

    expose = BenchCamera.expose
    monkeypatch.setattr(BenchCamera, "expose", fail_in_light)
    why = r"camera: driver 'bench' of package bench-devices 0\.1 fails in expose\(\) \(ZeroDivisionError: gain\)"
    with pytest.raises(RefusedError, match=why):
        captured(grbl, tmp_path, board)
    assert exposures[-1]
    assert not any((tmp_path / light / "on").exists() for light in ("lamp", "laser"))


def test_two_packages_of_one_name_are_refused_and_no_other_driver_is(site: Path) -> None:
    for package in ("one-wheel", "other-wheel"):
        install(site, package, {WHEELS: {"same": "same_wheel", "thorlabs": "same_wheel"}}, same_wheel="")
    with pytest.raises(
        RefusedError,
        match=r"'same' is offered by o.*-wheel 0\.1 and by o.*-wheel 0\.1, and finray "
        r"cannot",
    ):
        find_driver("filter wheel", "same")
    with pytest.raises(RefusedError, match=r"'thorlabs' is offered by finray-calib and by .*pip uninstall o.*-wheel"):
        find_driver("filter wheel", "thorlabs")
    assert find_driver("filter wheel", "alpaca").module == "rigs.filter_wheels.alpaca"


def test_a_driver_that_is_not_installed_is_refused_before_anything_opens(site: Path, tmp_path: Path) -> None:
    install(site, "bench-devices", {CAMERAS: {"bench": "bench_camera"}}, bench_camera=BENCH_CAMERA)
    rig = read_toml(real_rig(tmp_path, wheel_of("grlb", "/dev/ttyUSB0")), RigFile)
    known = r"valid drivers are alpaca, indi, manual, simulated, thorlabs. Change the key driver in the rig file"
    with (
        pytest.raises(RefusedError, match=rf"filter wheel: no driver 'grlb' is installed; {known}"),
        open_rig(rig, tmp_path),
    ):
        pytest.fail("opened")


def test_a_misspelt_driver_is_named_with_the_nearest_one() -> None:
    """Also where the address is missing, which would otherwise be asked for first."""
    for driver, hint in (
        ("simulatd", "did you mean 'simulated'"),
        ("araviss", "'aravis'"),
        ("xyzzy", "if another package"),
    ):
        with pytest.raises(ValueError, match=f"finray has no driver '{driver}'; .*{hint}"):
            CameraSettings(driver=driver)
    with pytest.raises(RefusedError, match="no driver 'thorlab' is installed; did you mean 'thorlabs'"):
        find_driver("filter wheel", "thorlab")


@pytest.mark.parametrize("kind", ["camera", "filter wheel", "light", "stage", "load cell"])
def test_every_driver_of_finray_is_known_where_its_address_is_missing(kind: Kind) -> None:
    ours = {name for name, found in offered(kind).items() if found[0].is_ours} - set(NO_ADDRESS)
    assert ours
    for name in ours:
        with pytest.raises(ValueError, match=f"driver '{name}' needs an address"):
            CameraSettings(driver=name)


@pytest.mark.parametrize("name", ["finray_grbl_wheel:GrblWheel", "os.system", "GRBL", "", "x" * 41])
def test_a_rig_file_cannot_name_a_module(name: str, tmp_path: Path) -> None:
    path = real_rig(tmp_path, wheel_of("grbl", "/dev/ttyUSB0"))
    path.write_text(path.read_text().replace('driver = "grbl"', f'driver = "{name}"'))
    with pytest.raises(RecordError, match="cannot name a module, because it must not decide which code runs"):
        read_toml(path, RigFile)


LACKING_LIGHT = """
from contextlib import contextmanager
from data_schemas import DeviceIdentity
HAS_DEAD_MAN = False

class Switch:
    has_dead_man = False
    def identity(self): return DeviceIdentity(role="lamp", driver="half")
    def switch(self, on, deadline_s): pass
    def state(self, deadline_s): return False
    def keep_alive(self): pass

@contextmanager
def open_switch(address, role, operator):
    yield Switch()
"""


def test_a_light_that_could_not_be_guarded_is_refused(site: Path) -> None:
    install(site, "half-light", {LIGHTS: {"half": "half_light"}}, half_light=LACKING_LIGHT)
    with (
        pytest.raises(
            RefusedError, match=r"lamp at 1: its driver half_light .* lacks off_words, prove_dead_man; update"
        ),
        open_lamp(LampSettings(driver="half", address="1"), Hands()),
    ):
        pytest.fail("opened")
