"""Whole paint sessions of eight filters through real drivers and other people's devices."""

import datetime
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from data_schemas import (
    CameraSettings,
    CaptureSession,
    FilterWheelSettings,
    LampSettings,
    LaserSettings,
    OutsideLayer,
    PaintPlan,
    RegionOfInterest,
    RigFile,
    Target,
)
from data_schemas.storage import read_toml
from rigs import simulated_rig, write_rig
from rigs.capture import SessionRequest, capture_paint_session, read_frame_of, read_session
from tests.capture.drivers.fake_gigevision_camera import fake_camera
from tests.capture.drivers.firmware_in_qemu import build, firmware_board
from tests.capture.drivers.indi_server import CCD, PANEL, SIMULATORS, WHEEL, IndiServer
from tests.capture.drivers.programs import require_module
from tests.capture.drivers.thorlabs_wheel import emulated_wheel

FILTERS = simulated_rig("red").filter_wheel.filters
LASER = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}
INTERLOCK = OutsideLayer(
    kind="interlock", tested_on=datetime.date.today().isoformat(), test="a simulated panel, which hurts nobody"
)
EXPOSURES = {"shortest_exposure_s": 0.01, "longest_exposure_s": 0.1}
STEPS = {"white": 8, "laser white": 1, "room light": 1, "reflectance": 8, "fluorescence": 8, "fluorescence repeat": 1}


@dataclass
class Hands:
    """An operator who does what is asked at once, and remembers it."""

    asked: list[str] = field(default_factory=list)

    def place(self, target: Target) -> None:
        self.asked.append(target)

    def swing_wheel_out(self) -> None:
        self.asked.append("swing out")

    def tilt(self, angle_deg: float) -> None:
        self.asked.append(f"tilt {angle_deg:g}")

    def do(self, instruction: str) -> None:
        self.asked.append(instruction)

    def allows(self, question: str) -> bool:
        self.asked.append(question)
        return False


def captured(rig: RigFile, folder: Path) -> tuple[CaptureSession, Hands]:
    """Capture with the rig as its file describes it; these cameras are no light meters, so one exposure each."""
    write_rig(rig, folder / "rig.toml")
    stored = read_toml(folder / "rig.toml", RigFile)
    region = RegionOfInterest(row_px=100, column_px=100, height_px=64, width_px=64)
    plan = PaintPlan(paint_name="red", region=region, bracket=(1.0,), darks_per_exposure=2)
    hands = Hands()
    return capture_paint_session(
        stored, plan, SessionRequest(folder / "session", "finray capture", rig_folder=folder, operator=hands)
    ), hands


def check(session: CaptureSession, folder: Path) -> None:
    """Every step is there, at its own slot, under its own light; every frame is whole; the record reads back."""
    assert {k: n for k, n in Counter(f.frame_type for f in session.frames).items() if k != "dark"} == STEPS
    slots = {f.name: f.slot for f in FILTERS}
    for frame in session.frames:
        assert frame.slot_before == frame.slot_after
        if frame.filter_name is not None:
            assert frame.slot_before == slots[frame.filter_name]
        assert frame.lights_before == frame.lights_after == tuple({frame.light} & {"lamp", "laser"})
        read_frame_of(folder / "session", frame)
    assert read_session(folder / "session").frames == session.frames
    assert [d.role for d in session.devices] == ["camera", "filter wheel", "laser", "lamp"]
    assert all(d.model or d.vendor for d in session.devices if d.driver != "manual")
    assert session.filter_proof is not None
    assert session.filter_proof.verdict == "cannot tell"  # none of these cameras sees any light


@pytest.mark.rigs
def test_indi_camera_wheel_and_light_panel(tmp_path: Path) -> None:
    with IndiServer(tmp_path, SIMULATORS) as server:
        rig = RigFile(
            name="INDI simulators",
            camera=CameraSettings(
                driver="indi", address=server.address(CCD), bit_depth=16, black_level_dn=0, **EXPOSURES
            ),
            filter_wheel=FilterWheelSettings(driver="indi", address=server.address(WHEEL), filters=FILTERS),
            laser=LaserSettings(driver="indi", address=server.address(PANEL), outside_layer=INTERLOCK, **LASER),
            lamp=LampSettings(driver="manual"),
        )
        session, _ = captured(rig, tmp_path)
    check(session, tmp_path)
    headers = {f.slot_before: f.settings["filter_header"] for f in session.frames if f.filter_name is not None}
    assert len(set(headers.values())) == len(FILTERS)  # the camera was told which wheel to follow


@pytest.mark.rigs
def test_aravis_camera_thorlabs_wheel_and_arduino_laser(tmp_path: Path) -> None:
    with ExitStack() as stack:
        stack.enter_context(fake_camera())
        wheel = stack.enter_context(emulated_wheel())
        board = stack.enter_context(firmware_board(build(tmp_path)))
        rig = RigFile(
            name="paper's rig, emulated",
            camera=CameraSettings(
                driver="aravis",
                address="127.0.0.1",
                width_px=512,
                height_px=512,
                bit_depth=8,
                black_level_dn=0,
                shortest_exposure_s=0.001,
                longest_exposure_s=0.008,
            ),
            filter_wheel=FilterWheelSettings(driver="thorlabs", address=wheel.address, filters=FILTERS),
            laser=LaserSettings(driver="arduino", address=board.address, **LASER),
            lamp=LampSettings(driver="manual"),
        )
        session, hands = captured(rig, tmp_path)
        assert not board.state()
    check(session, tmp_path)
    assert len({f.frame_id for f in session.frames}) == len(session.frames)
    assert sum("lamp" in text for text in hands.asked) >= 4  # on and off, for the white tile and for the sample


@pytest.mark.rigs
def test_micro_manager_camera_thorlabs_wheel_and_arduino_laser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require_module("pymmcore", "pymmcore")
    require_module("mm_test_adapters", "mm-test-adapters")
    import mm_test_adapters

    monkeypatch.setenv("MICROMANAGER_PATH", str(Path(mm_test_adapters.__file__).parent / "libs"))
    lines = (
        "Property,Core,Initialize,0",
        "Device,Camera,DemoCamera,DCam",
        "Property,Core,Initialize,1",
        "Property,Core,Camera,Camera",
        "Property,Camera,PixelType,16bit",
        "Property,Camera,BitDepth,12",
        "Property,Camera,Mode,Noise",
    )
    (tmp_path / "camera.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with ExitStack() as stack:
        wheel = stack.enter_context(emulated_wheel())
        board = stack.enter_context(firmware_board(build(tmp_path)))
        rig = RigFile(
            name="Micro-Manager's camera",
            camera=CameraSettings(
                driver="micro-manager",
                address="camera.cfg",
                width_px=512,
                height_px=512,
                bit_depth=12,
                black_level_dn=99,
                shortest_exposure_s=0.001,
                longest_exposure_s=0.03,
            ),
            filter_wheel=FilterWheelSettings(driver="thorlabs", address=wheel.address, filters=FILTERS),
            laser=LaserSettings(driver="arduino", address=board.address, **LASER),
            lamp=LampSettings(driver="manual"),
        )
        session, _ = captured(rig, tmp_path)
        assert not board.state()
    check(session, tmp_path)
