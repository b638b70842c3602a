"""Capture requests: plans that 'finray capture' accepts, presses that fit the pad, a page that names them all."""

import numpy as np
import pytest

from data_schemas.design import FingerDesign, GelPad, Indenter
from data_schemas.errors import RecordError
from data_schemas.storage import read_toml
from data_schemas.tactile import TactilePlan
from finray_calib.compare.normal_map_fit import MINIMUM_PRESSES
from finray_calib.exchange.capture_request import ANGLES_DEG, capture_request
from sim.design_toml import design_toml
from tests.command_line.running import finray, succeed

RIG = """\
name = "a Raspberry Pi"
[camera]
driver = "picamera2"
address = "0"
model = "imx219"
width_px = 1638
height_px = 1230
bit_depth = 10
shortest_exposure_s = 1e-4
longest_exposure_s = 4.2
"""


@pytest.fixture
def design_file(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text(design_toml(FingerDesign()))
    return path


def test_the_capture_verb_accepts_every_plan(tmp_path, design_file):
    said = succeed(f"export capture-request {design_file} --out {tmp_path}/ask.md")
    (tmp_path / "rig.toml").write_text(RIG)
    plans = sorted(tmp_path.glob("ask.*.toml"))
    page = (tmp_path / "ask.md").read_text()
    assert len(plans) == 1 + len(ANGLES_DEG)
    for plan in plans:
        assert str(plan) in said
        assert plan.name in page
        assert "presses, 3 times each" in succeed(f"capture {plan} --rig {tmp_path}/rig.toml --dry-run")
        assert read_toml(plan, TactilePlan).design == "finger.toml"
    again = finray(f"export capture-request {design_file} --out {tmp_path}/ask.md")
    assert again.status == 2
    assert "exists already" in again.err


def test_plans_hold_what_the_design_needs(tmp_path):
    design = FingerDesign(indenter=Indenter(shape="cylinder", radius_mm=5.0, depth_mm=1.2, position_mm=30.0))
    request = capture_request(design, "f.toml", "r", (10.0, 80.0))
    read = {}
    for name, text in request.plans.items():
        (tmp_path / name).write_text(text)
        read[name] = read_toml(tmp_path / name, TactilePlan)
    ball = read.pop("r.ball.toml")
    assert ball.indenter.shape == "ball"
    assert len(ball.presses) >= MINIMUM_PRESSES
    assert ball.board is not None
    assert {plan.light_angle_deg for plan in read.values()} == {10.0, 80.0, design.light.angle_deg}
    for plan in read.values():
        assert (plan.indenter.shape, plan.indenter.radius_mm) == ("cylinder", 5.0)
        assert [p.depth_mm for p in plan.presses] == [0.4, 0.8, 1.2]
        assert plan.bracket_powers == (4, 22)
    # every contact circle lies on the pad, and depths are not tied to places
    for press in ball.presses:
        rim = np.sqrt(2.0 * ball.indenter.radius_mm * press.depth_mm - press.depth_mm**2)
        assert rim <= press.position_mm <= design.pad.length_mm - rim
    depths = [p.depth_mm for p in ball.presses]
    assert abs(np.corrcoef(depths, [p.position_mm for p in ball.presses])[0, 1]) < 0.3
    for needed in ("ChArUco", "Raw frames", "standard", "press-001.json,412.5", "| 18 |"):
        assert needed.lower() in request.page.lower()


def test_names_with_quotes_stay_toml(tmp_path):
    request = capture_request(FingerDesign(name='finger "3" \\ a'), 'my "f".toml', "r")
    (tmp_path / "p.toml").write_text(request.plans["r.ball.toml"])
    plan = read_toml(tmp_path / "p.toml", TactilePlan)
    assert plan.name.startswith('finger "3" \\ a')
    assert plan.design == 'my "f".toml'


@pytest.mark.parametrize(
    ("design", "message"),
    [
        (
            FingerDesign(indenter=Indenter(shape="cuboid", size_mm=(5.0, 5.0, 5.0))),
            "a capture request needs a cylinder",
        ),
        (FingerDesign(indenter=Indenter(depth_mm=0.0)), "depth_mm = 0 mm: a capture request needs"),
        (
            FingerDesign(pad=GelPad(length_mm=10.0, width_mm=4.0), indenter=Indenter(position_mm=5.0, radius_mm=2.0)),
            "leaves no room for presses of a ball of 1 mm radius",
        ),
    ],
)
def test_designs_that_nobody_can_capture_are_refused(design, message):
    with pytest.raises(RecordError, match=message):
        capture_request(design, "f.toml", "r")
