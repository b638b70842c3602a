import sys
from pathlib import Path

import pytest

from data_schemas import CaptureSession, PaintPlan, RigFile
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session
from tests.capture.drivers import picamera2_stand_in

WIDTH_PX, HEIGHT_PX = 160, 128


@pytest.fixture(scope="session")
def rig() -> RigFile:
    """The red paint on a small sensor."""
    return simulated_rig("red", width_px=WIDTH_PX, height_px=HEIGHT_PX)


@pytest.fixture(scope="session")
def plan(rig: RigFile) -> PaintPlan:
    return paint_plan("red", rig.camera)


@pytest.fixture(scope="session")
def captured(
    rig: RigFile, plan: PaintPlan, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, CaptureSession, list[tuple[int, int, str]]]:
    """A whole session: its folder, its record and the calls of its progress function."""
    out = tmp_path_factory.mktemp("session") / "paint"
    calls: list[tuple[int, int, str]] = []
    session = capture_paint_session(
        rig, plan, SessionRequest(out, "finray capture", progress=lambda *call: calls.append(call))
    )
    return out, session, calls


@pytest.fixture
def sensor(monkeypatch):
    monkeypatch.setitem(sys.modules, "picamera2", picamera2_stand_in.module())
    return picamera2_stand_in.Picamera2.sensor
