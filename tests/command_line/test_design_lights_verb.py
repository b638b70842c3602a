"""``finray design lights``: powers of a finger with a map, of a classic sensor, their files, and what is refused."""

from html import unescape
from pathlib import Path

import numpy as np
import pytest

from data_schemas import LightPowers
from data_schemas.storage import read_record
from sim import read_design, read_sensor
from tests.command_line.running import finray, succeed

FINGER = """\
preset = "flat-70x35"
name = "two panels"
[camera]
width_px = 64
height_px = 48
[second_light]
position_mm = [0.0, -4.0, 73.0]
angle_deg = 150.0
"""
SENSOR = """\
kind = "sensor"
preset = "digit"
name = "small digit"
[camera]
width_px = 36
height_px = 48
"""


@pytest.mark.renderer
def test_a_finger_gets_even_powers_and_a_map(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    maps = '--map light.angle_deg=20:40:20 --map "light.position_mm[y]=-11:-9:2"'
    said = succeed(f"design lights {tmp_path}/finger.toml --samples 32 {maps} --out {tmp_path}/found.json --seed 3")
    found = read_record(tmp_path / "found.json", LightPowers)
    assert found.sentence in said
    assert found.gap_rel < 1e-7
    # the panel at the tip stands near the gel and outshines the other
    powers = [row.power_rel for row in found.rows]
    assert powers[0] > 1.0 > powers[1]
    assert found.variation_rel.estimate < 0.8 * found.variation_now_rel.estimate
    changed = read_design(tmp_path / "found.toml")
    assert [panel.power_rel for panel in changed.lights] == pytest.approx(powers, abs=1e-4)
    assert found.map is not None
    assert found.map.normal_error_deg.shape == (2, 2)
    assert np.isfinite(found.map.normal_error_deg).all()
    page = " ".join(unescape((tmp_path / "found.html").read_text()).split())
    assert found.sentence in page


@pytest.mark.renderer
def test_a_classic_sensor_gets_even_powers(tmp_path: Path) -> None:
    (tmp_path / "sensor.toml").write_text(SENSOR)
    succeed(f"design lights {tmp_path}/sensor.toml --samples 2 --out {tmp_path}/found.json")
    found = read_record(tmp_path / "found.json", LightPowers)
    assert len(found.rows) == 3
    assert found.normal_error is None
    assert "not evaluated for a classic sensor" in found.sentence
    powers = [light.power_rel for light in read_sensor(tmp_path / "found.toml").lights]
    assert powers == pytest.approx([row.power_rel for row in found.rows], abs=1e-4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("flat-70x35 --range 4:1", "must be LOW:HIGH, two factors above 0"),
        ("flat-70x35 --range 0:1", "must be LOW:HIGH, two factors above 0"),
        ("flat-70x35 --total 0.1", "but the total allows only"),
        ("flat-70x35 --samples 3", "must be an even whole number"),
        ("flat-70x35 --map light.angle_deg=0:60:30", "needs a finger and two of its numbers; give --map twice"),
        ("flat-70x35 --map light.angle_deg=0:60 --map light.angle_deg=0:60:10", "FIELD=LOW:HIGH:STEP"),
        ("flat-70x35 --map light.angel_deg=0:60:10 --map pad.thickness_mm=5:6:1", "is not a field of a design"),
        ("digit --map light.angle_deg=0:60:30 --map light.angle_deg=0:60:30", "a finger and two of its numbers"),
        ("digit --paint red=none.json", "carries no fluorescent paint"),
        ("nowhere.toml", "nowhere.toml"),
    ],
)
def test_what_cannot_be_solved_is_refused(words: str, message: str, tmp_path: Path) -> None:
    outcome = finray(f"design lights {words} --out {tmp_path}/found.json")
    assert outcome.status == 2
    assert message in " ".join(outcome.err.split())
    assert not (tmp_path / "found.json").exists()
