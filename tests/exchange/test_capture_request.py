"""Capture requests: plans that 'finray capture' accepts, presses that fit the pad, a page that names them all."""

import re
import sys

import numpy as np
import pytest

from data_schemas import FingerDesign, GelPad, Indenter, LightPanel, RecordError, TactileCapture, TactilePlan
from data_schemas.storage import read_record, read_toml
from finray_calib.exchange import PlannedView, capture_request, read_circles
from finray_calib.exchange._capture_request import ANGLES_DEG, ball_presses
from finray_calib.sensing import MINIMUM_PRESSES
from finray_calib.sensing._normal_map_fit import calibration_press
from sim import design_toml
from tests.capture.drivers import picamera2_stand_in
from tests.capture.finger_session import RIG as SMALL_RIG
from tests.capture.finger_session import capture, plan_of, pressing, rig_of
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


VIEW = PlannedView(along_mm=(0.1, 66.6), across_mm=(-17.5, 17.5), mm_per_px=0.154, mm_per_px_u_rel=0.49)


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
    request = capture_request(design, "f.toml", "r", VIEW, (10.0, 80.0))
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
    # the scale: the board on the pad first, and in every plan a place for what was measured
    assert ball.board.on_pad
    for plan in (ball, *read.values()):
        assert plan.mm_per_px is not None
        assert plan.mm_per_px_u_rel == VIEW.mm_per_px_u_rel
    for text in request.plans.values():
        assert text.count("MEASURE: 'finray sense scale' prints it") == 1
    for needed in (
        "ChArUco", "Raw frames", "standard", "press-001.json,412.5", "| 18 |",
        "finray sense scale SESSION --square-u-mm 0.01 --out pixel-scale.json",
        "the board lies flat where the pad's coat is", "A capture without contact needs nothing more",
    ):  # fmt: skip
        assert needed.lower() in request.page.lower()


def test_captures_of_the_ball_plan_teach_a_normal_map(tmp_path, monkeypatch):
    """The first two presses, at the exposures of a quick camera, with the circles that the page asks for."""
    monkeypatch.setitem(sys.modules, "picamera2", picamera2_stand_in.module())
    request = capture_request(FingerDesign(), "f.toml", "r", VIEW)
    plan = plan_of(tmp_path, request.plans["r.ball.toml"])
    rows = {int(k): files for k, files in re.findall(r"^\| (\d+) \| (press-\d+ to press-\d+) \|", request.page, re.M)}
    assert list(rows) == list(range(1, len(plan.presses) + 1))
    assert "(press 1 is press-001 to press-003), all 54 of them" in request.page
    circles = re.search(r"^    image,.*\n    press-001\.json,.*$", request.page, re.M)
    assert circles is not None
    (tmp_path / "circles.csv").write_text(circles[0])
    circle = read_circles(tmp_path / "circles.csv")["press-001.json"].circle

    plan = plan.model_copy(update={"presses": plan.presses[:2], "board": None})
    rig = rig_of(tmp_path, SMALL_RIG + "shortest_exposure_s = 1e-2\nlongest_exposure_s = 0.02\n")
    session = capture(tmp_path, plan, rig, pressing(picamera2_stand_in.Picamera2.sensor))
    for k, press in enumerate(plan.presses, start=1):
        first, last = (int(n) for n in re.findall(r"\d+", rows[k]))
        for file in session.captures[first - 1 : last]:
            stored = read_record(tmp_path / "out" / file, TactileCapture)
            assert stored.indenter.depth_mm == press.depth_mm
            lesson = calibration_press(stored.model_copy(update={"contact_circle": circle}))
            # two raw pixels to a Bayer cell
            assert lesson.ball_radius_px == pytest.approx(plan.indenter.radius_mm / VIEW.mm_per_px / 2.0, rel=1e-3)
    assert session.captures == tuple(f"press-{n:03d}.json" for n in range(1, 7))


@pytest.mark.parametrize("name", ['finger "3" \\ a', "two\nlines\r\tand \x01", "Finger für Lötstellen 指"])
def test_names_of_any_text_stay_toml(tmp_path, name):
    request = capture_request(FingerDesign(name=name), 'my "f".toml', "r", VIEW)
    for text in request.plans.values():
        (tmp_path / "p.toml").write_text(text, encoding="utf-8", newline="")
        plan = read_toml(tmp_path / "p.toml", TactilePlan)
        assert plan.name.startswith(f"{name}, ")
        assert plan.design == 'my "f".toml'


def test_angles_that_would_share_a_plan_are_refused():
    design = FingerDesign(light=LightPanel(angle_deg=30.00000001))
    with pytest.raises(RecordError, match=r"angle of 30\.00000001 deg: .* the same name, r\.angle-30\.toml; round"):
        capture_request(design, "f.toml", "r", VIEW)


@pytest.mark.parametrize(
    ("design", "message"),
    [
        (
            FingerDesign(indenter=Indenter(shape="cuboid", size_mm=(5.0, 5.0, 5.0))),
            "a capture request needs a cylinder",
        ),
        (
            FingerDesign(indenter=Indenter(depth_mm=0.0)),
            "depth_mm = 0 mm is not supported, because a capture",
        ),
        (
            FingerDesign(pad=GelPad(length_mm=10.0, width_mm=4.0), indenter=Indenter(position_mm=5.0, radius_mm=2.0)),
            "too little for the presses that a normal map needs",
        ),
    ],
)
def test_designs_that_nobody_can_capture_are_refused(design, message):
    with pytest.raises(RecordError, match=message):
        capture_request(design, "f.toml", "r", VIEW)


def test_the_camera_sees_every_ball_press_whole():
    design = FingerDesign()
    asked = ball_presses(design, VIEW)
    for press in asked.presses:
        circle_mm = np.sqrt(2.0 * asked.radius_mm * press.depth_mm - press.depth_mm**2)
        assert VIEW.along_mm[0] <= press.position_mm - circle_mm
        assert press.position_mm + circle_mm <= VIEW.along_mm[1]
        assert VIEW.across_mm[0] <= press.across_mm - circle_mm
        assert press.across_mm + circle_mm <= VIEW.across_mm[1]


def test_the_planned_scale_is_what_the_camera_of_the_design_sees(tmp_path, design_file):
    succeed(f"export capture-request {design_file} --out {tmp_path}/ask.md")
    told = succeed(f"design show {design_file} --engine scalar")
    px_per_mm = [float(n) for pair in re.findall(r"([\d.]+) to ([\d.]+) px/mm", told) for n in pair]
    for plan in (read_toml(path, TactilePlan) for path in tmp_path.glob("ask.*.toml")):
        reach = 1.0 + 2.0 * plan.mm_per_px_u_rel
        assert plan.mm_per_px / reach < 1.0 / max(px_per_mm) * 1.05
        assert plan.mm_per_px * reach > 1.0 / min(px_per_mm) * 0.95
        assert 1.0 / max(px_per_mm) < plan.mm_per_px < 1.0 / min(px_per_mm)
