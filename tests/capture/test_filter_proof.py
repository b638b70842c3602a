"""The frames themselves show which filter is in the beam; a bench whose filters sit in other slots is convicted."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    CaptureError,
    CaptureSession,
    DeviceIdentity,
    FilterProof,
    PaintPlan,
    RigFile,
    WrongPositionError,
)
from rigs import FilterWheel, open_rig
from rigs.capture import Interrupted, SessionRequest, paint_steps, read_interrupted, read_session
from rigs.capture import _paint_session as paint_session
from rigs.capture._filter_proof import LEAST_SIGNAL_FRACTION, compare_with_last, judge_filters, signal_floor
from rigs.capture._journal import read_journal
from rigs.capture._paint_session import capture_with

NAMES = ("405", "450", "500", "532", "560", "600", "630", "660")


def exchanged(rig: RigFile, first: str, second: str) -> RigFile:
    """The same rig with two filters put into each other's slots."""
    slots = {f.name: f.slot for f in rig.filter_wheel.filters}
    slots[first], slots[second] = slots[second], slots[first]
    filters = tuple(f.model_copy(update={"slot": slots[f.name]}) for f in rig.filter_wheel.filters)
    wheel = rig.filter_wheel.model_copy(update={"filters": filters})
    return rig.model_copy(update={"filter_wheel": wheel})


@pytest.mark.parametrize("pair", [("450", "600"), ("500", "560"), ("405", "450"), ("600", "630")])
def test_exchanged_filters_are_found_before_a_frame_is_stored(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, pair: tuple[str, str]
) -> None:
    """The bench holds other filters than the rig file says; the wheel's own counter sees nothing wrong."""
    with open_rig(exchanged(rig, *pair), Path()) as opened:
        try:
            session = capture_with(
                opened, rig, plan, paint_steps(plan, rig), SessionRequest(tmp_path / "out", "finray capture")
            )
        except WrongPositionError as error:
            assert all(name in str(error) for name in pair)  # noqa: PT017
            assert not list((tmp_path / "out").glob("frames/*"))
        else:  # neighbours of the same colour: it must not claim to have seen them in place
            assert session.filter_proof is not None
            assert session.filter_proof.verdict == "cannot tell"
            assert f"{pair[0]} and {pair[1]}" in session.filter_proof.text


def test_at_least_the_laser_filter_is_proved(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    with (
        open_rig(exchanged(rig, "450", "600"), Path()) as opened,
        pytest.raises(WrongPositionError, match="450 and 600"),
    ):
        capture_with(opened, rig, plan, paint_steps(plan, rig), SessionRequest(tmp_path, "finray capture"))


def test_filters_in_place_are_not_convicted(captured) -> None:
    out, session, _ = captured
    assert session.filter_proof is not None
    assert session.filter_proof.verdict in ("confirmed", "cannot tell")
    assert read_session(out).filter_proof == session.filter_proof
    assert len(session.white_rates_dn_per_s) == 8


def test_no_wrong_conviction_within_the_stated_error() -> None:
    """Predictions 30 % off, filter by filter and channel by channel: at most 1 in 100 is convicted wrongly."""
    rng = np.random.default_rng(3)
    predicted = np.exp(rng.normal(0, 1.5, (8, 3)))
    convicted = 0
    for _ in range(300):
        measured = 100 * predicted * np.exp(0.3 * rng.standard_normal((8, 3)))
        convicted += judge_filters(NAMES, measured, predicted).verdict == "contradicted"
    assert convicted <= 9  # 3 expected at 1 %, 9 is the 99.6 % quantile of that


def test_dark_camera_proves_nothing() -> None:
    proof = judge_filters(NAMES, np.full((8, 3), 0.2), np.ones((8, 3)))
    assert proof.verdict == "cannot tell"
    assert "dark through every filter" in proof.text


def test_earlier_session_finds_a_soiled_filter(captured) -> None:
    _, session, _ = captured
    before = np.array(session.white_rates_dn_per_s)
    names = list(dict.fromkeys(f.filter_name for f in session.frames if f.frame_type == "white"))
    assert compare_with_last(names, 0.7 * before, session).verdict == "confirmed"  # another aperture
    soiled = before.copy()
    soiled[names.index("560")] *= 0.8
    found = compare_with_last(names, soiled, session)
    assert found.verdict == "contradicted"
    assert "filter 560" in found.text
    assert compare_with_last(names[:2], before[:2], session).verdict == "cannot tell"


def test_earlier_session_finds_exchanged_filters_of_other_colours(captured) -> None:
    _, session, _ = captured
    before = np.array(session.white_rates_dn_per_s)
    names = list(dict.fromkeys(f.filter_name for f in session.frames if f.frame_type == "white"))
    first, second = names.index("450"), names.index("600")
    exchanged = before.copy()
    exchanged[[first, second]] = exchanged[[second, first]]
    assert compare_with_last(names, exchanged, session).verdict == "contradicted"
    assert compare_with_last(names, np.zeros((8, 3)), session).verdict == "cannot tell"


@dataclass
class CountingWheel:
    """A wheel that counts its steps and does not turn."""

    wheel: FilterWheel
    slot: int = 1

    @property
    def slots(self) -> tuple[int, ...]:
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self) -> int | None:
        return None if self.wheel.position() is None else self.slot

    def go_to(self, slot: int, deadline_s: float) -> None:
        self.slot = slot


@pytest.mark.parametrize("stuck", NAMES)
def test_wheel_that_counts_and_does_not_turn_is_convicted(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, stuck: str
) -> None:
    with open_rig(rig, Path()) as opened:
        opened.wheel.go_to(NAMES.index(stuck) + 1, 20.0)
        broken = replace(opened, wheel=CountingWheel(opened.wheel))
        with pytest.raises(
            WrongPositionError, match=f"show filter {stuck} at every slot, so the wheel reports new slots"
        ):
            capture_with(broken, rig, plan, paint_steps(plan, rig), SessionRequest(tmp_path, "finray capture"))
    assert not list(tmp_path.glob("frames/*"))


def test_picture_that_needs_no_lamp_proves_nothing(captured) -> None:
    """A coloured test pattern looks like one filter at every slot; with the lamp off it is still there."""
    _, session, _ = captured
    predicted = np.array(session.white_rates_dn_per_s)
    pattern = np.repeat(predicted[7:], 8, axis=0)
    assert judge_filters(NAMES, pattern, predicted, lambda name: 0.01 * pattern[0]).verdict == "contradicted"
    proof = judge_filters(NAMES, pattern, predicted, lambda name: 0.9 * pattern[0])
    assert proof.verdict == "cannot tell"
    assert "hardly changes when the lamp goes off" in proof.text


def test_the_lamp_goes_off_behind_a_filter_that_is_judged(captured) -> None:
    """The first filter is too dim to be judged, and dark with the lamp off too; the picture of the others stays."""
    _, session, _ = captured
    predicted = np.array(session.white_rates_dn_per_s)
    rates = np.repeat(predicted[7:], 8, axis=0)
    rates[0] *= 1e-3
    floor = np.full(8, 0.1 * rates[7].max())

    def lamp_off(name: str = NAMES[0]) -> np.ndarray:
        return 0.9 * rates[NAMES.index(name)]

    proof = judge_filters(NAMES, rates, predicted, lamp_off, floor=floor)
    assert proof.verdict == "cannot tell"
    assert "hardly changes when the lamp goes off" in proof.text


def test_grey_picture_and_single_filter_prove_nothing(captured) -> None:
    """A camera that does not see the lamp gives the same grey picture behind all filters: no filter looks like that."""
    _, session, _ = captured
    predicted = np.array(session.white_rates_dn_per_s)  # the simulated bench keeps close to the prediction
    assert judge_filters(NAMES, np.full((8, 3), 500.0), predicted).verdict == "cannot tell"
    assert judge_filters(NAMES[:1], predicted[:1], predicted[:1]).verdict == "cannot tell"


def test_earlier_session_of_other_filters_leaves_the_verdict(
    rig: RigFile, plan: PaintPlan, captured, tmp_path: Path
) -> None:
    _, session, _ = captured
    frames = tuple(f for f in session.frames if f.frame_type != "white")
    with open_rig(rig, Path()) as opened:
        now = capture_with(
            opened,
            rig,
            plan,
            paint_steps(plan, rig),
            SessionRequest(tmp_path, "finray capture"),
            last_good=session.model_copy(update={"frames": frames}),
        )
    assert now.filter_proof is not None
    assert session.filter_proof is not None
    assert now.filter_proof.verdict == session.filter_proof.verdict
    assert now.filter_proof.text.endswith("the earlier session shares no filter with this one")


@pytest.mark.parametrize("rate_dn_per_s", [-1.0, 0.0, 0.3])
def test_earlier_session_whose_white_tile_was_dark_proves_nothing(captured, rate_dn_per_s: float) -> None:
    """Its rates are what is left of the black level: no logarithm, or one of noise."""
    _, session, _ = captured
    rates, noise = np.array(session.white_rates_dn_per_s), np.random.default_rng(4).uniform(0.5, 1.5, (8, 3))
    dark = session.model_copy(update={"white_rates_dn_per_s": tuple(map(tuple, (rate_dn_per_s * noise).tolist()))})
    proof = compare_with_last(NAMES, rates, dark, np.full(8, 1e-3))
    assert proof.verdict == "cannot tell"
    assert proof.text.endswith("the white tile was too dim in that session, so compare with another session")
    one_dim = session.model_copy(update={"white_rates_dn_per_s": ((0.1, 0.2, 0.1), *session.white_rates_dn_per_s[1:])})
    assert compare_with_last(NAMES, rates, one_dim).verdict == "confirmed"


def test_session_unlike_an_earlier_one_is_refused(rig: RigFile, plan: PaintPlan, captured, tmp_path: Path) -> None:
    _, session, _ = captured
    rates = [list(row) for row in session.white_rates_dn_per_s]
    rates[0] = [2 * rate for rate in rates[0]]
    other = session.model_copy(update={"white_rates_dn_per_s": tuple(tuple(row) for row in rates)})
    with open_rig(rig, Path()) as opened, pytest.raises(CaptureError, match="differs from the earlier session"):
        capture_with(
            opened, rig, plan, paint_steps(plan, rig), SessionRequest(tmp_path, "finray capture"), last_good=other
        )


@pytest.mark.parametrize("where", ["at the terminal", "by resuming"])
def test_exchanged_filters_that_are_put_right_let_the_session_go_on(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, where: str
) -> None:
    """The bench's filters are exchanged, found, and put right; the proofs are taken again, not remembered."""
    small = plan.model_copy(update={"filters": ("450", "532", "600"), "bracket": (1.0,), "darks_per_exposure": 1})
    steps, asked = paint_steps(small, rig), []
    with open_rig(exchanged(rig, "450", "600"), Path()) as wrong, open_rig(rig, Path()) as right:

        def put_right() -> None:
            wrong.camera.bench = right.camera.bench

        def mend(text: str) -> bool:
            asked.append(text)
            if where == "at the terminal":
                put_right()
            return where == "at the terminal"

        def run(interrupted: Interrupted | None = None) -> CaptureSession:
            return capture_with(
                wrong, rig, small, steps, SessionRequest(tmp_path, "finray capture"), interrupted=interrupted, mend=mend
            )

        if where == "by resuming":
            with pytest.raises(WrongPositionError, match="450 and 600"):
                run()
            assert read_interrupted(tmp_path).metered == {}
            put_right()
            session = run(read_interrupted(tmp_path))
        else:
            session = run()
    assert len(asked) == 1
    assert "450 and 600" in asked[0]
    assert session.filter_proof is not None
    assert session.filter_proof.verdict != "contradicted"
    repairs = [line for line in read_journal(tmp_path) if line["event"] == "repair"]
    assert len(repairs) == (where == "at the terminal")


def test_filters_that_stay_exchanged_end_the_session_after_some_repairs(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paint_session, "MOST_REPAIRS", 1)
    small = plan.model_copy(update={"filters": ("450", "532", "600"), "bracket": (1.0,), "darks_per_exposure": 1})
    asked: list[str] = []
    with (
        open_rig(exchanged(rig, "450", "600"), Path()) as opened,
        pytest.raises(WrongPositionError, match="450 and 600"),
    ):
        capture_with(
            opened,
            rig,
            small,
            paint_steps(small, rig),
            SessionRequest(tmp_path, "finray capture"),
            mend=lambda text: not asked.append(text),
        )
    assert len(asked) == 1


FULL_SCALE_DN = 65535


def test_noise_of_a_camera_that_sees_nothing_convicts_nobody() -> None:
    """Five counts of 65535 at 10 ms are 500 DN/s, which once decided; now nothing below 2 % of full scale does."""
    rng = np.random.default_rng(8)
    predicted = np.exp(rng.normal(0, 1.5, (8, 3)))
    floor = signal_floor([0.01] * 8, FULL_SCALE_DN)
    without = [judge_filters(NAMES, 500.0 * rng.random((8, 3)), predicted).verdict for _ in range(100)]
    within = [judge_filters(NAMES, 500.0 * rng.random((8, 3)), predicted, floor=floor) for _ in range(100)]
    assert "contradicted" in without
    assert {proof.verdict for proof in within} == {"cannot tell"}
    assert "no signal through any filter; brighten the lamp" in within[0].text


def test_dim_filters_are_not_judged_and_named() -> None:
    rng = np.random.default_rng(9)
    predicted = np.exp(rng.normal(0, 1.5, (8, 3)))
    measured = 1e4 * predicted
    floor = signal_floor([1.0] * 8, FULL_SCALE_DN)
    assert judge_filters(NAMES, measured, predicted, floor=floor).verdict != "contradicted"
    dim = measured.copy()
    dim[[0, 7]] = 100.0 * rng.random((2, 3))
    proof = judge_filters(NAMES, dim, predicted, floor=floor)
    assert proof.verdict == "cannot tell"
    assert "filters 405, 660 are too dim to be judged" in proof.text
    dim[2:] = 100.0
    proof = judge_filters(NAMES, dim, predicted, floor=floor)
    assert proof.verdict == "cannot tell"
    assert "only 1 filter gives a signal" in proof.text


def test_floor_is_two_per_cent_of_full_scale_and_five_uncertainties() -> None:
    assert signal_floor([1.0, 0.5], 1000.0, np.array([0.0, 2.0])).tolist() == [20.0, 50.0]


def test_black_level_that_is_wrong_convicts_nobody_once_the_dark_level_is_measured() -> None:
    """A tenth of full scale too low, it is most of what dim filters show at the camera's longest exposure."""
    rng = np.random.default_rng(10)
    verdicts = []
    for _ in range(50):
        predicted = np.exp(rng.normal(0, 1.5, (8, 3)))
        exposures_s = np.minimum(0.6 / predicted.max(axis=1), 0.1)
        pedestal = 0.1 * FULL_SCALE_DN / exposures_s[:, None]
        measured = FULL_SCALE_DN * predicted + pedestal
        floor = signal_floor(exposures_s, FULL_SCALE_DN)
        verdicts.append(
            [judge_filters(NAMES, rates, predicted, floor=floor).verdict for rates in (measured, measured - pedestal)]
        )
    assert "contradicted" in {before for before, _ in verdicts}
    assert "contradicted" not in {after for _, after in verdicts}


def test_dark_level_is_measured_before_a_conviction(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rig file says 0 DN where the sensor's black level is 16 DN."""
    told = rig.model_copy(update={"camera": rig.camera.model_copy(update={"black_level_dn": 0})})
    small = plan.model_copy(update={"filters": ("450", "532", "600"), "bracket": (1.0,), "darks_per_exposure": 1})
    judged: list[tuple[np.ndarray, np.ndarray]] = []

    def judge(names, measured, predicted, lamp_off, apart, floor) -> FilterProof:
        judged.append((measured, floor))
        return FilterProof(verdict="contradicted" if len(judged) == 1 else "cannot tell", text="lamp")

    monkeypatch.setattr(paint_session, "judge_filters", judge)
    with open_rig(rig, Path()) as opened:
        session = capture_with(
            opened, told, small, paint_steps(small, told), SessionRequest(tmp_path, "finray capture")
        )
    assert session.filter_proof is not None
    assert session.filter_proof.text.startswith("lamp")
    (before, low), (after, high) = judged
    exposures_s = LEAST_SIGNAL_FRACTION * 1023 / low[:, None]
    # 784 px of read noise below 3 DN, in two frames, and the sensor's offsets: well below 1 DN
    np.testing.assert_allclose((before - after) * exposures_s, 16.0, atol=1.0)
    assert np.all(high >= low)
