import re

import numpy as np
import pytest

from data_schemas import ComparedPair, CompareError, ContactCircle, IndenterPose, Interval, TactileCapture
from finray_calib.compare import (
    PairRow,
    pair_by_name,
    pairs_of_rows,
    predicted_press,
    rank_simulators,
    skill_differences,
    skill_over_presses,
    to_capture,
    train_table,
    worst_pairs,
)
from finray_calib.compare._batch import pair_name


def test_files_are_paired_by_name():
    pairs, alone = pair_by_name(
        ["two.press.json", "one.press.json", "three.press.json", "one.capture.json", "notes.txt"],
        ["one.capture.json", "two.capture.json", "four.capture.json", "report.json"],
    )
    assert pairs == {"one": ("one.press.json", "one.capture.json"), "two": ("two.press.json", "two.capture.json")}
    assert alone == ["four.capture.json", "three.press.json"]
    assert pair_by_name(["a.json"], ["a.json"])[0] == {"a": ("a.json", "a.json")}
    assert pair_name("one.press.json") == pair_name("one.capture.json") == "one"
    with pytest.raises(
        CompareError,
        match=r"no simulated press and capture have the same name \(1 presses, 0 captures\); give the simulated "
        r"presses first and the captures last, and give each pair one name",
    ):
        pair_by_name(["a.press.json"], [])


def test_files_are_paired_by_a_table():
    rows = [
        {"simulated": " s/a.json", "captured": "c/x.capture.json "},
        {"simulated": "s/b.json", "captured": "c\\y.json", "name": "why", "simulator": "mine", "session": "day 2"},
        {"simulated": "s/c.json", "captured": "c/x.capture.json", "simulator": "mine", "press": "5", "sensor": "A"},
    ]
    assert pairs_of_rows(rows) == [
        PairRow("x", "s/a.json", "c/x.capture.json"),
        PairRow("why", "s/b.json", "c\\y.json", "mine", session="day 2"),
        PairRow("x", "s/c.json", "c/x.capture.json", "mine", "5", None, "A"),
    ]
    with pytest.raises(
        CompareError, match="row 2: the name 'x' occurs twice; give each pair a unique name in the column 'name'"
    ):
        pairs_of_rows([rows[0], rows[0]])
    with pytest.raises(CompareError, match="row 1: must name a file in both columns, simulated and captured"):
        pairs_of_rows([{"simulation": "a", "captured": "b"}])
    with pytest.raises(CompareError, match="no pair is listed; give one row per press"):
        pairs_of_rows([])


def pair(name, skill, signal=1.0, **told):
    interval = None if skill is None else Interval(estimate=skill, low95=skill, high95=skill)
    return ComparedPair(name=str(name), simulated="s", captured="c", skill=interval, contact_signal=signal, **told)


@pytest.mark.parametrize("spread", [0.3, 0.45, 0.8])
@pytest.mark.parametrize("presses", [3, 5, 8, 12])
def test_the_interval_over_presses_holds_the_truth(presses, spread):
    """Log-normal 1 - E and signals, 500 samples: 0.90 to 0.98 are held, less and more two standard errors (0.027).

    Three presses more alike than in any real set (0.4) are held more often: their prior is 0.4.
    """
    rng = np.random.default_rng([presses, int(100 * spread)])
    truth, held = 1.0 - 0.05 * np.exp(spread**2 / 2.0), 0
    for _ in range(500):
        left = 0.05 * np.exp(spread * rng.standard_normal(presses))
        signals = np.exp(0.5 * rng.standard_normal(presses))
        found = skill_over_presses([pair(k, 1.0 - e, s) for k, (e, s) in enumerate(zip(left, signals, strict=True))])
        assert found.low95 < found.estimate < found.high95 < 1.0
        held += found.low95 <= truth <= found.high95
    assert 0.90 - 0.027 <= held / 500 <= (1.0 if (presses, spread) == (3, 0.3) else 0.98 + 0.013)


@pytest.mark.parametrize("kind", ["a tail of bad presses", "two of them alike", "even"])
def test_three_presses_that_are_alike_by_chance_do_not_claim_to_be_certain(kind):
    """By the jackknife alone 0.89 to 0.91 of 1000 samples hold the truth (standard error 0.01); at least 0.94 do."""
    rng = np.random.default_rng(3)
    draws = {
        "a tail of bad presses": lambda shape: (rng.gamma(4.0, 1.0, shape) - 4.0) / 2.0,
        "two of them alike": lambda shape: (
            np.sqrt(0.5) * (rng.standard_normal(shape) + rng.standard_normal((shape[0], 2))[:, [0, 0, 1]])
        ),
        "even": lambda shape: rng.uniform(-1.0, 1.0, shape) * np.sqrt(3.0),
    }
    many = np.exp(0.4 * draws[kind]((200_000, 3)))
    truth = 1.0 - 0.05 * many.mean()
    held = 0
    for left in 0.05 * many[:1000]:
        found = skill_over_presses([pair(k, 1.0 - e, 1.0) for k, e in enumerate(left)])
        held += found.low95 <= truth <= found.high95
    assert held >= 940
    alike = skill_over_presses([pair(k, e) for k, e in enumerate((0.950, 0.951, 0.949))])
    assert alike.method.endswith("widened by a weak prior, because presses are more alike than usual")
    assert 0.88 < alike.low95 < 0.95 < alike.high95 < 1.0


def test_the_interval_is_that_of_a_jackknife_by_hand():
    """Three presses: 1 - E = 0.1, 0.2, 0.4 of signals 1, 2, 1 is 0.9 / 4; without one 0.8 / 3, 0.5 / 2, 0.5 / 3."""
    found = skill_over_presses([pair("a", 0.9, 1.0), pair("b", 0.8, 2.0), pair("c", 0.6, 1.0)])
    logs = np.log([0.8 / 3.0, 0.5 / 2.0, 0.5 / 3.0])
    half = 4.302653 * np.sqrt(2.0 / 3.0 * ((logs - logs.mean()) ** 2).sum())
    assert found.estimate == pytest.approx(1.0 - 0.9 / 4.0)
    assert found.low95 == pytest.approx(1.0 - 0.225 * np.exp(half), rel=1e-6)
    assert found.high95 == pytest.approx(1.0 - 0.225 * np.exp(-half), rel=1e-6)
    assert (found.unit, found.units, found.presses) == ("press", 3, 3)
    assert found.not_sampled == ("other sensors", "other sessions")


def test_two_presses_have_no_interval_and_what_noise_leaves_ends_at_one():
    two = skill_over_presses([pair("a", 0.391), pair("b", 0.9)])
    assert (two.low95, two.high95) == (None, None)
    assert two.method == "no interval: it needs three independent presses, sessions or sensors, and there are 2"
    assert skill_over_presses([pair("a", None)]) is None
    # noise that was taken out leaves one press no error
    above = skill_over_presses([pair("a", 0.95), pair("b", 1.02), pair("c", 0.97)])
    assert above.low95 < above.estimate < above.high95 == 1.0
    assert "leaves some presses without error" in above.method
    over = skill_over_presses([pair("a", 1.01), pair("b", 1.02), pair("c", 1.03)])
    assert over.estimate == over.high95 == pytest.approx(1.02)


def test_the_unit_is_the_highest_level_with_three_and_repeats_are_one_press():
    """Repeats of one press differ by little: counted as presses they would claim far too much."""
    repeats = [pair(f"{p}{r}", 0.9 + 0.02 * p, 1.0, press=str(p)) for p in range(3) for r in range(5)]
    found = skill_over_presses(repeats)
    assert (found.unit, found.units, found.presses) == ("press", 3, 15)
    alone = skill_over_presses([p.model_copy(update={"press": ""}) for p in repeats])
    assert found.high95 - found.low95 > 2.0 * (alone.high95 - alone.low95)
    sessions = [pair(k, 0.9 + 0.01 * (k % 3), session=f"day {k % 3}") for k in range(9)]
    assert skill_over_presses(sessions).unit == "session"
    assert skill_over_presses(sessions).not_sampled == ("other sensors",)
    sensors = [p.model_copy(update={"sensor": p.name}) for p in sessions]
    assert (skill_over_presses(sensors).unit, skill_over_presses(sensors).not_sampled) == ("sensor", ())


def test_spread_between_sessions_is_held_by_sessions_not_by_presses():
    """Four sessions of six presses that share half of their spread: sessions as units hold 95 %, presses do not."""
    rng = np.random.default_rng(4)
    truth, held = 1.0 - 0.05 * np.exp(0.3**2), {"session": 0, "press": 0}
    for _ in range(400):
        shared = np.repeat(0.3 * rng.standard_normal(4), 6)
        left = 0.05 * np.exp(shared + 0.3 * rng.standard_normal(24))
        pairs = [pair(k, 1.0 - e, session=str(k // 6)) for k, e in enumerate(left)]
        for unit, told in (("session", pairs), ("press", [p.model_copy(update={"session": None}) for p in pairs])):
            found = skill_over_presses(told)
            assert found.unit == unit
            held[unit] += found.low95 <= truth <= found.high95
    assert held["session"] / 400 >= 0.90
    assert held["press"] / 400 < 0.85


def test_a_paired_difference_is_surer_than_its_simulators():
    """What makes a press hard for both cancels; 400 samples of 8 presses hold the difference in 0.90 to 0.98."""
    rng = np.random.default_rng(2)
    truth, held = 0.02 * np.exp(0.45**2 / 2.0), 0
    for _ in range(400):
        hard = np.exp(0.45 * rng.standard_normal(8))
        own = np.exp(0.1 * rng.standard_normal(8) - 0.1**2 / 2.0)
        pairs = [pair(k, 1.0 - 0.05 * h, simulator="a") for k, h in enumerate(hard)]
        pairs += [pair(k, 1.0 - 0.07 * h * o, simulator="b") for k, (h, o) in enumerate(zip(hard, own, strict=True))]
        (found,) = skill_differences(pairs, ["a", "b"])
        held += found.low95 <= truth <= found.high95
    assert 0.90 - 0.03 <= held / 400 <= 0.98 + 0.014
    (one, other), left_out = rank_simulators(pairs)
    assert (one.simulator, other.simulator, left_out) == ("a", "b", ())
    assert found.low95 > 0.0 > one.skill.low95 - other.skill.high95  # told apart although both intervals overlap
    three = skill_differences([*pairs, *(p.model_copy(update={"simulator": "c"}) for p in pairs[:8])], ["a", "b", "c"])
    wider = next(d for d in three if (d.first, d.second) == ("a", "b"))
    assert wider.high95 - wider.low95 > found.high95 - found.low95  # three intervals that hold together
    same = next(d for d in three if (d.first, d.second) == ("a", "c"))
    assert (same.estimate, same.low95, same.high95, same.better_in) == (0.0, 0.0, 0.0, 0)


def test_a_difference_does_not_depend_on_which_simulator_is_named_first():
    """The change by contact of a press depends on the simulator, whose gain is taken out and whose region counts."""
    pairs = [pair(k, 0.9, 1.0, simulator="a") for k in range(4)] + [pair(k, 0.8, 1.5, simulator="b") for k in range(4)]
    one, other = (skill_differences(pairs, names)[0] for names in (["a", "b"], ["b", "a"]))
    assert one.estimate == pytest.approx(0.1)  # in every press it is so much
    assert other.estimate == pytest.approx(-0.1)
    assert one.high95 == pytest.approx(0.1)


def test_presses_whose_change_by_contact_is_not_known_give_no_difference():
    pairs = [pair(0, 0.9, None, simulator="a"), pair(0, 0.8, None, simulator="b")]
    assert skill_differences(pairs, ["a", "b"]) == ()


def test_simulators_are_ranked_over_the_presses_that_all_have():
    """One that fails on the hard press gains nothing by it."""
    pairs = [pair(k, s, simulator="whole") for k, s in enumerate((0.9, 0.9, 0.9, 0.2))]
    pairs += [pair(k, s, simulator="fails") for k, s in enumerate((0.8, 0.8, 0.8, None))]
    pairs.append(pair(0, None, simulator="never"))
    scores, left_out = rank_simulators(pairs)
    assert [(s.simulator, s.compared, s.failed) for s in scores] == [("whole", 4, 0), ("fails", 3, 1), ("never", 0, 1)]
    assert left_out == ("3",)
    assert scores[0].skill.estimate == pytest.approx(0.9)
    assert scores[2].skill is None


def test_what_to_capture_next_follows_from_what_is_missing():
    told = to_capture([pair("a", 0.9), pair("b", 0.8)])
    assert told[0].startswith("1 more press, at other places and depths: an interval needs at least 3")
    assert any("second image without contact for each press: 2 of 2 pairs have none" in wish for wish in told)
    many = to_capture([pair(k, s) for k, s in enumerate((0.93, 0.95, 0.96, 0.94, 0.95, 0.97))])
    assert re.match(r"\d+ more presses: the interval reaches 0\.0\d+ to either side with 6", many[0])
    assert to_capture([pair("a", None)]) == ()
    failed = [pair(name, None, simulator="fails") for name in "ab"]
    assert to_capture([*failed, pair("a", 0.9, simulator="one"), pair("b", 0.8, simulator="one")]) == told


def test_a_gain_between_images_of_the_render_asks_for_no_other_captures():
    """What is told is what finray.compare.find_mismatches tells of exposures."""
    for changed, is_asked in (("capture", True), ("render", False)):
        finding = f"exposure: ...; {changed} both images with the same exposure, gain, white balance and bit depth"
        told = to_capture([pair(name, 0.9, findings=(finding,)) for name in "abc"])
        assert any("in 3 of 3 pairs the camera's gain changed between the images" in wish for wish in told) is is_asked


def test_the_worst_pairs_come_first():
    pairs = [pair(n, s) for n, s in zip("abcdefg", [0.5, 0.1, None, 0.9, -2.0, 0.3, 0.4], strict=True)]
    assert worst_pairs(pairs) == ("e", "b", "f", "g", "a")


def test_a_prediction_changes_nothing_where_nothing_touches():
    """Also below the black level, where noise makes a pixel negative: clipped on one side alone it would be a touch."""
    counts = np.random.default_rng(3).integers(10, 40, (60, 80, 3)).astype(np.uint16)
    capture = TactileCapture(
        name="dark", contact=counts, no_contact=counts, repeat_no_contact=None, layout="RGB", encoding="unknown",
        bit_depth=8, black_level_dn=16.0, exposure_s=None, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=3.0, depth_mm=None, position_mm=None),
        contact_circle=None, mm_per_px=None, source="made up",
    )  # fmt: skip
    ratio = np.ones((60, 80, 3))
    ratio[20:40, 30:50] = 0.5
    press = predicted_press(capture, ratio, np.full((60, 80), 9.0), ("table", "made up", "table"), "taught by none")
    assert (press.no_contact < 0.0).any()
    touched = ratio != 1.0
    assert np.array_equal(press.contact[~touched], press.no_contact[~touched])
    assert press.contact[touched].min() >= 0.0


def test_presses_of_which_no_pixel_can_be_used_are_refused():
    """Without contact the image is at the black level, so no change of it by contact can be told as a ratio."""
    level = np.full((60, 80, 3), 16, dtype=np.uint16)
    capture = TactileCapture(
        name="dark", contact=level + 9, no_contact=level, repeat_no_contact=None, layout="RGB", encoding="unknown",
        bit_depth=8, black_level_dn=16.0, exposure_s=None, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=3.0, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=30.0, column_px=40.0, radius_px=8.0), mm_per_px=None, source="made up",
    )  # fmt: skip
    with pytest.raises(CompareError, match="no pixel near the contact of any press can be used, because all are"):
        train_table([capture])
    bright = capture.model_copy(update={"name": "bright", "contact": level + 90, "no_contact": level + 60})
    table = train_table([bright, capture])  # one that shows nothing beside one that does is no fault
    assert table.coefficients == pytest.approx(train_table([bright]).coefficients)
