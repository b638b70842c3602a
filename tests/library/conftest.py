"""A small laboratory, made by the library itself: rig, session, band signals, paint; and made-up records."""

from pathlib import Path

import pytest

import finray_calib as finray
from rigs import paint_plan, simulated_rig, write_plan, write_rig
from tests.command_line.records import capture_of, press, sweep, with_known_camera

FINGER = (
    'preset = "flat-70x35"\nname = "small finger"\n[camera]\nwidth_px = 96\nheight_px = 72\n[mesh]\npreset = "coarse"\n'
)


@pytest.fixture(scope="package")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that tests only read."""
    folder = tmp_path_factory.mktemp("library")
    rig = simulated_rig("red", width_px=320, height_px=256)
    write_rig(rig, folder / "rig.toml")
    write_plan(paint_plan("red", rig.camera), folder / "plan.toml")
    (folder / "finger.toml").write_text(FINGER)
    finray.capture_session(folder / "plan.toml", folder / "rig.toml", folder / "session")
    finray.write_record(finray.reduce_session(folder / "session"), folder / "bands.json")
    finray.write_record(finray.fit_paint(folder / "bands.json", seed=5), folder / "red.paint.json")
    linear = with_known_camera(press())
    for name, record in {"press": linear, "capture": capture_of(linear, 50.0), "sweep": sweep()}.items():
        finray.write_record(record, folder / f"{name}.json")
    return folder


@pytest.fixture(scope="package")
def paint(lab: Path) -> finray.PaintCalibration:
    """The fitted paint."""
    record = finray.read_record(lab / "red.paint.json")
    assert isinstance(record, finray.PaintCalibration)
    return record
