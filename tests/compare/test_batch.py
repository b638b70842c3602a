import numpy as np
import pytest

from data_schemas import ComparedPair, CompareError, Interval
from finray_calib.compare import mean_skill, pair_by_name, pairs_of_rows, worst_pairs
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
        CompareError, match=r"no press has a capture of its name \(1 presses, 0 captures\): name them one"
    ):
        pair_by_name(["a.press.json"], [])


def test_files_are_paired_by_a_table():
    rows = [
        {"simulated": " s/a.json", "captured": "c/x.capture.json "},
        {"simulated": "s/b.json", "captured": "c\\y.json", "name": "why"},
    ]
    assert pairs_of_rows(rows) == {"x": ("s/a.json", "c/x.capture.json"), "why": ("s/b.json", "c\\y.json")}
    with pytest.raises(CompareError, match="row 2: the name 'x' occurs twice; add a column name"):
        pairs_of_rows([rows[0], rows[0]])
    with pytest.raises(CompareError, match="row 1: needs a file in each of the columns simulated, captured"):
        pairs_of_rows([{"simulation": "a", "captured": "b"}])
    with pytest.raises(CompareError, match="no pair is listed; give one row per press"):
        pairs_of_rows([])


def test_the_mean_over_presses_and_its_interval():
    """Four presses, a thousand times: the interval holds the mean in 95 %, 4 standard errors are 2.8 %."""
    skills = np.random.default_rng(0).normal(0.8, 0.1, (1000, 4))
    found = [mean_skill(row) for row in skills]
    assert found[0].estimate == pytest.approx(skills[0].mean())
    assert np.mean([f.low95 <= 0.8 <= f.high95 for f in found]) == pytest.approx(0.95, abs=0.028)
    assert mean_skill(skills[0, :1]) is None
    # noise taken out of each: a mean above 1 stays inside its own interval
    above = mean_skill(np.array([1.02, 1.046]))
    assert above.estimate == pytest.approx(1.033)
    assert above.low95 < above.estimate < above.high95


def test_the_worst_pairs_come_first():
    def pair(name, skill):
        interval = None if skill is None else Interval(estimate=skill, low95=skill, high95=skill)
        return ComparedPair(name=name, simulated="s", captured="c", skill=interval)

    pairs = [pair(n, s) for n, s in zip("abcdefg", [0.5, 0.1, None, 0.9, -2.0, 0.3, 0.4], strict=True)]
    assert worst_pairs(pairs) == ("e", "b", "f", "g", "a")
