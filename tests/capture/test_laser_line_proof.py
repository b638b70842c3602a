"""The laser's line comes through the excitation filter and no other, or the wheel is convicted."""

import json
from pathlib import Path

import numpy as np
import pytest

from data_schemas import FilterProof, PaintPlan, RigFile, WrongPositionError
from rigs import open_rig
from rigs.capture import SessionRequest, paint_steps
from rigs.capture import _paint_session as paint_recorder
from rigs.capture._filter_proof import LaserLine, judge_filters
from rigs.capture._paint_session import capture_with
from tests.capture.test_filter_proof import NAMES, exchanged

OTHERS = tuple(name for name in NAMES if name != "450")


@pytest.fixture(scope="module")
def opened(rig: RigFile):
    with open_rig(rig, Path()) as opened:
        yield opened


@pytest.fixture(scope="module")
def metered(captured) -> tuple[list[float], list[list[float]]]:
    """Rates under the laser of the white tile behind filter 450 and of the sample behind all filters."""
    out, _, _ = captured
    lines = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    rates = {line["label"]: line["rates_dn_per_s"] for line in lines if "rates_dn_per_s" in line}
    white = rates["laser white (white, laser) through filter 450"]
    return white, [rates[f"fluorescence (sample, laser) through filter {name}"] for name in NAMES]


def laser_line(rig: RigFile, opened, white, sample) -> LaserLine:
    filters = [next(f for f in rig.filter_wheel.filters if f.name == name) for name in NAMES]
    return LaserLine(
        filters, "450", rig.laser.wavelength_nm, opened.filter_curves, opened.camera_response, white, sample
    )


@pytest.mark.parametrize("other", OTHERS)
def test_excitation_filter_elsewhere_is_convicted_by_the_laser_alone(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: str
) -> None:
    """The bench holds two filters in each other's slots, and the lamp does not tell."""
    blind = FilterProof(verdict="cannot tell", text="lamp")
    monkeypatch.setattr(paint_recorder, "judge_filters", lambda *_: blind)
    with (
        open_rig(exchanged(rig, "450", other), Path()) as opened,
        pytest.raises(WrongPositionError, match=f"450 and {other} are exchanged"),
    ):
        capture_with(opened, rig, plan, paint_steps(plan, rig), SessionRequest(tmp_path, "finray capture"))
    assert not list(tmp_path.glob("frames/*"))


def test_filter_in_place_is_confirmed(rig: RigFile, opened, metered, captured) -> None:
    line = laser_line(rig, opened, *metered)
    assert line.judge(lambda name: (0.0, 0.0, 0.0)).verdict == "confirmed"
    assert line.not_exchanged() == set(OTHERS)
    _, session, _ = captured
    assert session.filter_proof is not None
    assert session.filter_proof.text.endswith("only filter 450 passes the laser's line")


def test_pair_that_the_lamp_cannot_tell_apart_is_told_by_the_laser() -> None:
    predicted = np.exp(np.random.default_rng(1).normal(0.0, 1.5, (8, 3)))
    predicted[0] = predicted[1]
    proof = judge_filters(NAMES, 100 * predicted, predicted)
    assert proof.verdict == "cannot tell"
    assert "405 and 450" in proof.text
    told = judge_filters(NAMES, 100 * predicted, predicted, apart=[frozenset(("450", "405"))])
    assert told.verdict == "confirmed"


@pytest.mark.parametrize("rate", [0.3, 500.0])
def test_camera_that_does_not_see_the_laser_proves_nothing(rig: RigFile, opened, rate: float) -> None:
    line = laser_line(rig, opened, [rate] * 3, [[rate] * 3] * 8)
    assert line.judge(lambda name: [rate] * 3).verdict == "cannot tell"
    assert not line.not_exchanged()


def test_picture_that_needs_no_laser_proves_nothing(rig: RigFile, opened, metered) -> None:
    """Room light on the sample looks like a line where none should be; it is still there when the laser goes off."""
    white, sample = metered
    lit = [[rate + 100.0 * max(white) for rate in row] for row in sample]
    line = laser_line(rig, opened, white, lit)
    assert line.judge(lambda name: lit[0]).verdict == "cannot tell"
    assert line.judge(lambda name: (0.0, 0.0, 0.0)).verdict == "contradicted"


def test_paint_as_bright_as_the_line_is_not_convicted(rig: RigFile, opened, metered) -> None:
    """All light comes back behind every filter, and every rate is 30 % off, as is the line's."""
    white, _ = metered
    rng = np.random.default_rng(5)
    convicted = 0
    for _ in range(1000):
        off = np.exp(0.3 * np.sqrt(2.0) * rng.standard_normal(8))
        line = laser_line(rig, opened, white, np.outer(off, white))
        convicted += line.judge(lambda name: (0.0, 0.0, 0.0)).verdict == "contradicted"
    assert convicted <= 7  # 7 filters beyond 3.5 standard deviations: 1.9 expected, 7 is the 99.9 % quantile of that
