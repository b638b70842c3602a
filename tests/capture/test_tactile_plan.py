"""Tactile plans, poses of a stage and rigs of fingers, right and wrong."""

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from data_schemas import CaptureError, RecordError, TactilePlan
from rigs.capture import planned_presses, tactile_shots
from rigs.capture._plan import instruction
from tests.capture.finger_session import PLAN, plan_of, rig_of

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"


def test_poses_of_a_stage_are_read(tmp_path):
    text = PLAN[: PLAN.index("[[presses]]")].replace("exposures_s", 'poses_csv = "poses.csv"\nexposures_s')
    (tmp_path / "poses.csv").write_text(
        "position_mm,depth_mm,position_uncertainty_mm,depth_uncertainty_mm,tilt_uncertainty_deg\n"
        "35.02,0.998,0.01,0.005,\n40.01,1.501,0.01,0.005,0.2\n",
        encoding="utf-8",
    )
    first, second = planned_presses(plan_of(tmp_path, text), tmp_path)
    assert (first.depth_mm, first.position_mm, first.tilt_uncertainty_deg) == (0.998, 35.02, None)
    assert second.tilt_uncertainty_deg == 0.2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        ("depth_mm\n", "contains 0 poses"),
        ("depth_mm,position_mm\n1\n", "line 2: has 1 columns, but the header has 2"),
        ("depth_mm,position_mm\n1,2,3\n", "line 2: has 3 columns, but the header has 2"),
        ("depth_mm,position_mm\n1,2\n", "line 2: 'depth_uncertainty_mm': is missing"),
        ("depth_mm,height_mm\n1,2\n", "'height_mm': unknown key"),
        ('depth_mm\n"1\n', "cannot be read as CSV"),
    ],
    ids=["missing", "empty", "short", "long", "incomplete", "unknown", "torn"],
)
def test_bad_poses_are_refused(tmp_path, content, message):
    text = PLAN[: PLAN.index("[[presses]]")].replace("exposures_s", 'poses_csv = "poses.csv"\nexposures_s')
    if content is not None:
        (tmp_path / "poses.csv").write_text(content, encoding="utf-8")
    with pytest.raises(RecordError, match=message):
        planned_presses(plan_of(tmp_path, text), tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[[presses]]", "[[pressings]]", "'pressings': unknown key; did you mean 'presses'"),
        ("exposures_s = [0.01]", "", "exactly one of exposures_s and bracket_powers"),
        ("[0.01]", "[0.01, 0.01]", "an exposure is listed twice"),
        ("exposures_s = [0.01]", "bracket_powers = [9, 4]", "the first power must not be greater than the last"),
        ("exposures_s", 'poses_csv = "p.csv"\nexposures_s', r"exactly one of \[\[presses\]\] tables and poses_csv"),
        ("led_current_ma = 20.0\n", "", "'led_current_ma': is missing"),
        ("led_current_ma = 20.0", "led_current_ma = -1", "in mA"),
    ],
)
def test_senseless_plan_is_refused(tmp_path, old, new, message):
    with pytest.raises(RecordError, match=message):
        plan_of(tmp_path, PLAN.replace(old, new))


@pytest.mark.parametrize(
    ("board", "message"),
    [({"marker_mm": 3.0}, "must be smaller than square_mm"), ({"dictionary": "DICT_4X5_50"}, "pattern")],
)
def test_senseless_board_is_refused(board, message):
    plan = tomllib.loads(PLAN)
    plan["board"] = {"squares": [7, 5], "square_mm": 3.0, "marker_mm": 2.0, "dictionary": "DICT_4X4_50"} | board
    with pytest.raises(ValidationError, match=message):
        TactilePlan.model_validate(plan)


def test_rig_of_the_simulated_bench_is_refused(tmp_path):
    with pytest.raises(RecordError, match="so the tables"):
        rig_of(tmp_path, 'name = "bench"\n[camera]\n')


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.01]", "[40.0]", r"exposures_s: 40 s is outside the rig's range of 0\.0001 to 30 s"),
        (
            "exposures_s = [0.01]",
            "bracket_powers = [0, 5]",
            r"none of the exposures is within the rig's range of 0\.0001 to 30 s",
        ),
    ],
)
def test_exposures_out_of_range_are_refused(tmp_path, old, new, message):
    with pytest.raises(CaptureError, match=message):
        tactile_shots(plan_of(tmp_path, PLAN.replace(old, new)), rig_of(tmp_path).camera, 2)


def test_printed_plan_and_rigs_are_valid(tmp_path):
    blocks = {
        name: re.findall(r"^```toml\n(.*?)^```", (HOW_TO / name).read_text(encoding="utf-8"), re.M | re.S)
        for name in ("capture-presses.md", "connect-a-raspberry-pi-camera.md")
    }
    (plan_text,) = [block for block in blocks["capture-presses.md"] if 'kind = "tactile"' in block]
    plan = plan_of(tmp_path, plan_text)
    rigs = [block for page in blocks.values() for block in page if "[camera]" in block]
    assert len(rigs) == 3
    for block in rigs:
        rig = rig_of(tmp_path, block)
        if rig.camera.driver != "mjpeg":
            shots = tactile_shots(plan, rig.camera, len(plan.presses))
            assert instruction(shots[0], plan, plan.presses)
