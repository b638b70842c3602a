"""``finray rig``: a rig file to start from, what can be found, and what the devices of a rig report."""

import io
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import tifffile

from data_schemas import (
    BandPassFilter,
    CameraSettings,
    FilterWheelSettings,
    LampSettings,
    LaserSettings,
    LostError,
    MissingExtraError,
    RefusedError,
    RigFile,
    WhiteReference,
)
from data_schemas.storage import read_toml
from finray_calib.cli._rig import choose
from rigs import Driver, FoundDevice, Kind, detect, driver_module, offered, paper_rig, rig_locked, rig_toml
from rigs.simulated import SimulatedFilterWheel, SimulatedLight
from tests.capture.drivers.fake_gigevision_camera import fake_camera
from tests.capture.drivers.firmware_in_qemu import build, firmware_board
from tests.capture.drivers.indi_server import PANEL, IndiServer
from tests.capture.drivers.programs import require
from tests.capture.drivers.thorlabs_wheel import emulated_wheel
from tests.command_line.running import edit, finray, succeed

KINDS: tuple[Kind, ...] = ("camera", "filter wheel", "light")
CAMERA = FoundDevice("camera", "aravis", "FLIR-1234", "FLIR Chameleon3, serial 1234, at usb")
WHEEL = FoundDevice("filter wheel", "thorlabs", "/dev/ttyUSB7", "Thorlabs FW212C filter wheel, firmware 1.04")
LIGHTS = tuple(FoundDevice("light", "arduino", f"/dev/ttyACM{n}", "light with dead-man") for n in (3, 4))


FUNCTIONS = ("open_camera", "open_wheel", "open_switch", "HAS_DEAD_MAN")


def driver(monkeypatch: pytest.MonkeyPatch, kind: Kind, name: str, **contents: object) -> None:
    """Put a module with these contents in the place of a driver."""
    module = ModuleType(f"stand_in_{kind}_{name}".replace("-", "_").replace(" ", "_"))
    vars(module).update(dict.fromkeys(FUNCTIONS), **contents)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(offered(kind), name, (Driver(kind, name, module.__name__),))


def raising(error: Exception):
    def fail(*_: object) -> list[tuple[str, str]]:
        raise error

    return fail


@pytest.fixture
def nothing_in_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the search from this computer's own ports and networks."""
    for kind in KINDS:
        for name in offered(kind):
            driver(monkeypatch, kind, name, found=lambda: [])


def test_init_without_a_terminal_writes_the_papers_rig_and_says_what_to_fill_in(tmp_path: Path) -> None:
    said = succeed(f"rig init --out {tmp_path}/rig.toml")
    rig = read_toml(tmp_path / "rig.toml", RigFile)
    assert rig == paper_rig({})
    assert (rig.camera.driver, rig.camera.model) == ("aravis", "CM3-U3-13Y3C-CS")
    assert (rig.filter_wheel.driver, rig.filter_wheel.model) == ("thorlabs", "FW212C")
    assert (rig.laser.driver, rig.laser.wavelength_nm, rig.laser.power_mw, rig.laser.laser_class) == (
        "arduino",
        450.0,
        4.5,
        "3R",
    )
    assert rig.lamp.driver == "manual"
    assert [f.center_nm for f in rig.filter_wheel.filters] == [405, 450, 500, 532, 560, 600, 630, 660]
    # what a catalogue leaves open: 1.5 nm of centre and 1 nm of width, evenly likely
    assert {(f.center_uncertainty_nm, f.fwhm_uncertainty_nm) for f in rig.filter_wheel.filters} == {(0.9, 0.6)}
    for what in ("SERIAL-NUMBER", "/dev/ttyUSB0", "/dev/ttyACM0", "laser_class", f"finray rig show {tmp_path}"):
        assert what in said
    again = finray(f"rig init --out {tmp_path}/rig.toml")
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err


def test_every_field_of_the_written_file_has_a_comment() -> None:
    text = rig_toml(paper_rig({}))
    lines = text.splitlines()
    models = (CameraSettings, FilterWheelSettings, BandPassFilter, LaserSettings, LampSettings, WhiteReference)
    fields = {name for model in models for name in model.model_fields} - {"filters", "curve"}
    for field in fields:
        number = next(n for n, line in enumerate(lines) if line.removeprefix("# ").startswith(f"{field} = "))
        assert "  # " in lines[number] or lines[number - 1].startswith("# "), lines[number]
    assert "curve = " in text
    assert max(map(len, lines)) <= 120


def test_devices_that_the_user_takes_stand_in_the_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\nno\nY\n\n"))
    chosen = choose((CAMERA, *LIGHTS))
    assert chosen == {"camera": CAMERA, "laser": LIGHTS[1], "lamp": LIGHTS[0]}
    asked = capsys.readouterr().err
    assert "camera found: FLIR Chameleon3, serial 1234, at usb (aravis, FLIR-1234); use it? [Y/n]" in asked
    rig = paper_rig(chosen)
    assert (rig.camera.address, rig.camera.model) == ("FLIR-1234", CAMERA.what)
    assert (rig.laser.address, rig.lamp.driver, rig.lamp.address) == ("/dev/ttyACM4", "arduino", "/dev/ttyACM3")
    assert rig.filter_wheel.address == "/dev/ttyUSB0"


def test_a_cameras_own_wheel_is_offered_before_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = FoundDevice("camera", "indi", "localhost:7624/ZWO CCD ASI1600MM", "INDI camera")
    within = FoundDevice("filter wheel", camera.driver, camera.address, "INDI filter wheel")
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n"))
    assert choose((WHEEL, camera, within)) == {"camera": camera, "filter wheel": within}
    assert WHEEL.address not in capsys.readouterr().err
    monkeypatch.setattr(sys, "stdin", io.StringIO("no\n\n"))
    assert choose((WHEEL, camera, within)) == {"filter wheel": WHEEL}  # another camera has no say


@pytest.mark.parametrize(("preset", "mode_nm"), [("simulated", 597.0), ("simulated-green", 516.0)])
def test_a_rig_to_practise_on_asks_for_no_device(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, preset: str, mode_nm: float
) -> None:
    monkeypatch.setattr("finray_calib.cli._rig.chosen_devices", raising(AssertionError("looks for devices")))
    said = succeed(f"rig init --preset {preset} --out {tmp_path}/rig.toml")
    assert f"next: finray rig show {tmp_path}/rig.toml\n" in said
    assert "fill in" not in said
    rig = read_toml(tmp_path / "rig.toml", RigFile)
    assert rig.is_simulated
    assert rig.simulated is not None
    assert rig.simulated.paint is not None
    assert rig.simulated.paint.mode_nm == mode_nm


def test_end_of_input_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert choose((CAMERA, WHEEL)) == {}


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.usefixtures("nothing_in_reach")
def test_init_on_a_terminal_offers_what_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    driver(monkeypatch, "filter wheel", "thorlabs", found=lambda: [(WHEEL.address, WHEEL.what)])
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    monkeypatch.setattr(sys, "stderr", Terminal())
    from finray_calib.cli._rig import chosen_devices

    assert chosen_devices() == {"filter wheel": WHEEL}


@pytest.mark.usefixtures("nothing_in_reach")
def test_detect_lists_devices_and_no_error_hides_another(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = MissingExtraError("harvesters is not installed (pip install 'finray-calib[gentl]')")
    driver(monkeypatch, "camera", "gentl", found=raising(missing))
    driver(monkeypatch, "camera", "aravis", found=lambda: [(CAMERA.address, CAMERA.what)])
    driver(monkeypatch, "camera", "mjpeg")
    kinds: tuple[Kind, ...] = ("filter wheel", "light")
    for kind in kinds:
        driver(monkeypatch, kind, "indi", found=raising(LostError("no server")))
    driver(monkeypatch, "filter wheel", "thorlabs", found=raising(RuntimeError("a driver's own mistake")))
    driver(monkeypatch, "light", "arduino", found=lambda: [(LIGHTS[0].address, LIGHTS[0].what)])
    outcome = finray("rig detect")
    assert outcome.status == 0
    table = [line.split(maxsplit=3) for line in outcome.out.splitlines()]
    assert table[0][:3] == ["device", "driver", "address"]
    assert table[1] == ["camera", "aravis", CAMERA.address, CAMERA.what]
    assert table[2] == ["light", "arduino", LIGHTS[0].address, LIGHTS[0].what]
    assert len(table) == 3
    assert "note: gentl: harvesters is not installed (pip install 'finray-calib[gentl]')" in outcome.err
    assert "note: thorlabs: a driver's own mistake" in outcome.err
    assert outcome.err.count("note: indi: no server") == 1
    assert "mjpeg cannot be found by a search" in outcome.err


@pytest.mark.usefixtures("nothing_in_reach")
def test_detect_says_when_there_is_nothing() -> None:
    assert succeed("rig detect") == "no device found\n"


@pytest.mark.usefixtures("nothing_in_reach")
def test_a_search_that_hangs_ends_at_its_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    driver(monkeypatch, "camera", "aravis", found=lambda: [("late", "late")] if released.wait(60.0) else [])
    driver(monkeypatch, "light", "arduino", found=lambda: [(LIGHTS[0].address, LIGHTS[0].what)])
    try:
        detection = detect(limit_s=0.2)
    finally:
        released.set()
    assert detection.notes == ("aravis: the search for a camera did not end within 0.2 s",)
    assert detection.devices == (LIGHTS[0],)


def test_every_search_returns_addresses_that_a_rig_file_can_hold() -> None:
    """Whatever drivers are there: what a search is called and what it returns is what the table needs."""
    drivers = [found for kind in KINDS for (found,) in offered(kind).values() if found.name != "simulated"]
    assert {(found.kind, found.name) for found in drivers} >= {
        *(("camera", name) for name in ("aravis", "gentl", "mjpeg", "picamera2", "indi", "micro-manager", "folder")),
        *(("filter wheel", name) for name in ("thorlabs", "indi", "alpaca", "manual")),
        *(("light", name) for name in ("arduino", "indi", "alpaca", "manual")),
    }
    for found in drivers:
        search = getattr(driver_module(found), "found", None)
        assert search is None or search.__annotations__["return"] in (list[tuple[str, str]], "list[tuple[str, str]]")


def test_show_prints_every_part_of_a_simulated_rig_and_moves_nothing(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("nothing may move or be lit")

    monkeypatch.setattr(SimulatedFilterWheel, "go_to", forbidden)
    monkeypatch.setattr(SimulatedLight, "lit", forbidden)
    said = succeed(f"rig show {lab}/rig.toml")
    for part in ("laser: simulated", "lamp: simulated", "filter wheel: simulated", "camera: simulated"):
        assert f"\n{part}\n" in said
    assert said.count("reports off") == 2
    assert "450 nm, 4.5 mW, class 3R" in said
    assert "at slot 1, filter 405" in said
    assert "320 x 256 px; 0.01 s requested, 0.01 s read back" in said
    assert "states a black level of 16 DN" in said
    rows = [line.split() for line in said.splitlines() if line.endswith(" nominal")]
    assert [row[1] for row in rows] == ["405", "450", "500", "532", "560", "600", "630", "660"]
    assert rows[0] == ["1", "405", "405", "+-", "0.15", "10", "+-", "0.15", "5", "nominal"]
    assert "warning: the camera's response is assumed" in said


def test_show_puts_each_error_beside_its_device(tmp_path: Path) -> None:
    succeed(f"rig init --out {tmp_path}/rig.toml")
    rig = tmp_path / "rig.toml"
    edit(rig, 'driver = "aravis"', 'driver = "gentl"')
    edit(rig, '"SERIAL-NUMBER"', '"nowhere.cti"')
    edit(rig, "/dev/ttyUSB0", f"{tmp_path}/no-wheel")
    edit(rig, "/dev/ttyACM0", f"{tmp_path}/no-laser")
    outcome = finray(f"rig show {rig}")
    assert outcome.status == 2
    parts = dict(part.split("\n", 1) for part in outcome.out.split("\n\n")[1:])
    assert "ERROR: laser at" in parts[f"laser: arduino at {tmp_path}/no-laser"]
    assert "switched by hand, and this command does not ask" in parts["lamp: manual"]
    assert "ERROR: filter wheel at" in parts[f"filter wheel: thorlabs at {tmp_path}/no-wheel"]
    assert "does not exist" in parts["camera: gentl at nowhere.cti"]
    assert " 660 " in parts["filters and curves"]
    assert "laser: arduino at" in outcome.err


def test_show_says_what_does_not_fit_the_rig_file(lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rig.toml").write_text((lab / "rig.toml").read_text())
    edit(tmp_path / "rig.toml", 'response = "assumed"', 'response = "missing.csv"')
    outcome = finray(f"rig show {tmp_path}/rig.toml")
    assert outcome.status == 2
    assert outcome.out.count("missing.csv") == 1  # one cause is told once
    assert outcome.out.count("ERROR: the same as above (laser: simulated)") == 4
    monkeypatch.setattr(SimulatedLight, "state", lambda self: True)
    monkeypatch.setattr(SimulatedFilterWheel, "position", lambda self: None)
    said = succeed(f"rig show {lab}/rig.toml")
    assert said.count("warning: reports ON although it was switched off") == 2
    assert "position unknown" in said
    monkeypatch.setattr(SimulatedFilterWheel, "position", lambda self: "three")
    said = succeed(f"rig show {lab}/rig.toml")
    assert "its driver returns the position 'three', where the number of a slot or None is needed" in said
    assert "at slot three" not in said


def test_show_says_that_two_devices_share_a_port_in_the_words_of_a_capture(tmp_path: Path) -> None:
    rig, port, link = (tmp_path / name for name in ("rig.toml", "port", "by-id"))
    succeed(f"rig init --out {rig}")
    edit(rig, 'driver = "aravis"', 'driver = "folder"')
    edit(rig, '"SERIAL-NUMBER"', '"."')
    port.touch()
    link.symlink_to(port)
    edit(rig, "/dev/ttyUSB0", str(port))
    edit(rig, "/dev/ttyACM0", str(link))
    outcome = finray(f"rig show {rig}")
    assert outcome.status == 2
    why = f"filter wheel at {port} and laser at {link} are the same device"
    with pytest.raises(RefusedError, match=why) as refused, rig_locked(read_toml(rig, RigFile)):
        pytest.fail("locked")
    assert f"\naddresses\n  ERROR: {refused.value}\n" in outcome.out


@pytest.mark.rigs
def test_show_of_real_drivers_on_emulated_devices(tmp_path: Path) -> None:
    require("arv-tool-0.8", "aravis-tools-cli libaravis-0.8-0")
    rig = tmp_path / "rig.toml"
    with ExitStack() as stack:
        stack.enter_context(fake_camera())
        wheel = stack.enter_context(emulated_wheel())
        wheel.reset()
        board = stack.enter_context(firmware_board(build(tmp_path)))
        succeed(f"rig init --out {rig}")
        edit(rig, "SERIAL-NUMBER", "127.0.0.1")
        edit(rig, "/dev/ttyUSB0", wheel.address)
        edit(rig, "/dev/ttyACM0", board.address)
        for old, new in (("width_px = 1280", "width_px = 512"), ("height_px = 1024", "height_px = 512")):
            edit(rig, old, new)
        edit(rig, "bit_depth = 10", "bit_depth = 8")
        said = succeed(f"rig show {rig}")
        assert not board.state()
        assert not board.times("host", b"L1")
        assert wheel.control.get("pos") == 1
    assert "off when a process of finray is killed or stopped: yes, by the other processes, within 1 s" in said
    assert (
        "the light's cable is pulled or all processes are killed: yes, by the dead-man in the light's controller"
        in said
    )
    assert "cannot be lit" not in said
    assert "light with dead-man, firmware 1.2" in said
    assert "Aravis Fake, serial FINRAY01" in said
    assert "512 x 512 px; 0.01 s requested, 0.01 s read back" in said
    assert "pixel_format BayerRG8" in said
    assert "at slot 1, filter 405" in said
    assert "12 (none)" in said


@pytest.mark.rigs
def test_show_says_that_a_light_without_dead_man_stays_on_and_cannot_be_lit(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    succeed(f"rig init --out {rig}")
    with IndiServer(tmp_path, {"indi_simulator_lightpanel": PANEL}) as server:
        edit(rig, 'driver = "arduino"', 'driver = "indi"')
        edit(rig, "/dev/ttyACM0", server.address(PANEL))
        outcome = finray(f"rig show {rig}")
    laser = next(part for part in outcome.out.split("\n\n") if part.startswith("laser: indi"))
    assert "reports off" in laser
    assert "off when a process of finray is killed or stopped: yes, by the other processes, within 1 s" in laser
    assert "warning: off when the computer hangs, the light's cable is pulled or all processes are killed: NO" in laser
    assert "warning: cannot be lit: a class 3R laser is switched on only if hardware outside the computer" in laser


def test_show_of_another_file_is_a_mistake(lab: Path) -> None:
    outcome = finray(f"rig show {lab}/plan.toml")
    assert outcome.status == 2
    assert "plan.toml: " in outcome.err


def test_show_takes_the_rig_of_a_finger_which_is_a_camera_alone(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "press.tiff", np.full((64, 64), 16, np.uint16))
    (tmp_path / "frames.csv").write_text("file,exposure_s\npress.tiff,0.01\n")
    camera = 'driver = "folder"\naddress = "."\nwidth_px = 64\nheight_px = 64\n'
    (tmp_path / "finger.toml").write_text(f'name = "finger"\n\n[camera]\n{camera}')
    said = succeed(f"rig show {tmp_path}/finger.toml")
    assert "camera: folder at ." in said
    assert "each image of a folder can be used only once" in said
    assert "laser" not in said
