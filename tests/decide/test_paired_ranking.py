"""Ranking by draws: equal choices are not told apart more often than stated, unequal ones are, and by hand."""

import numpy as np
import pytest

from data_schemas import CompareError, FingerDesign
from finray_calib.decide import paint_choice, rank_by_draws

DRAWS = 100
WORLDS = 1500
#: Of a share of the worlds that is 0.05: a right method is beyond four of them once in 30,000 times.
SHARE_SD = np.sqrt(0.05 * 0.95 / WORLDS)


def worlds(truth, seed, shared=1.0, own=0.5):
    """Yield draws (choice, draw) of posteriors whose centres miss the truth as their draws say.

    All choices share a disturbance, as pairs of paints share one paint and the camera.
    """
    rng = np.random.default_rng(seed)
    for _ in range(WORLDS):
        missed = own * rng.standard_normal((len(truth), 1))
        scatter = own * rng.standard_normal((len(truth), DRAWS)) + shared * rng.standard_normal(DRAWS)
        yield np.asarray(truth)[:, None] + missed + scatter


@pytest.mark.parametrize("choices", [2, 6])
def test_equal_choices_are_told_apart_in_five_per_cent_at_most(choices):
    # however many are compared: the share of worlds where any two are told apart
    share = np.mean([rank_by_draws(draws).distinguishable.any() for draws in worlds([7.0] * choices, 3)])
    assert share < 0.05 + 4.0 * SHARE_SD
    # and the method is no excuse to say nothing
    assert share > 0.02


def test_a_difference_of_five_standard_deviations_is_found_and_points_the_right_way():
    # the difference of two centres has a standard deviation of 0.71
    found = [rank_by_draws(draws) for draws in worlds([7.0, 7.0 + 5.0 * 0.5 * np.sqrt(2.0)], 4)]
    told = np.mean([ranking.distinguishable[0, 1] for ranking in found])
    # 0.998 for a normal difference and a limit of 1.96 to 2.2 standard deviations, 1,500 worlds
    assert told > 0.99
    assert np.mean([ranking.order[0] == 0 for ranking in found]) > 0.999


def test_what_all_choices_share_does_not_hide_a_difference():
    rng = np.random.default_rng(5)
    shared, own = 10.0 * rng.standard_normal(DRAWS), 0.1 * rng.standard_normal((2, DRAWS))
    ranking = rank_by_draws(np.array([[7.0], [8.0]]) + own + shared)
    assert ranking.distinguishable[0, 1]
    assert not rank_by_draws(
        np.array([[7.0], [8.0]]) + own + 10.0 * rng.standard_normal((2, DRAWS))
    ).distinguishable.any()


def test_two_choices_of_the_same_draws_are_one():
    draws = np.random.default_rng(6).uniform(6.0, 8.0, DRAWS)
    ranking = rank_by_draws(np.stack([draws, draws, draws + 1.0]))
    assert ranking.order.tolist() == [0, 1, 2]
    assert ranking.best_share.tolist() == [0.5, 0.5, 0.0]
    np.testing.assert_array_equal(
        ranking.distinguishable, [[False, False, True], [False, False, True], [True, True, False]]
    )
    np.testing.assert_allclose(ranking.above_best, [[0.0] * DRAWS, [0.0] * DRAWS, [1.0] * DRAWS])


@pytest.mark.parametrize("values", [np.ones((1, 100)), np.ones((2, 18)), np.full((2, 100), np.nan)])
def test_too_little_to_rank_is_refused(values):
    with pytest.raises(CompareError, match="at least 2 choices and 19 draws"):
        rank_by_draws(values)


PAIRS = (("A", "B"), ("B", "A"), ("A", "C"))


def choice(*means):
    rng = np.random.default_rng(7)
    errors = np.array(means)[:, None] + 0.1 * rng.standard_normal((3, DRAWS))
    return paint_choice(FingerDesign(), PAIRS, errors, np.full((3, DRAWS), 20.0), np.array([1.0, 1.1, 1.2]))


def test_the_record_lists_the_best_pair_first():
    record = choice(8.0, 9.0, 7.0)
    assert [(row.red, row.green) for row in record.pairs] == [("A", "C"), ("A", "B"), ("B", "A")]
    assert [row.is_worse for row in record.pairs] == [False, True, True]
    assert [row.exposure_rel for row in record.pairs] == [1.2, 1.0, 1.1]
    np.testing.assert_allclose(record.normal_error_draws_deg.mean(axis=1), [7.0, 8.0, 9.0], atol=0.05)
    assert record.pairs[1].above_best_deg.estimate == pytest.approx(1.0, abs=0.1)
    assert record.sentence.startswith("Paint the red wall with A and the green wall with C: the expected error")
    assert record.sentence.endswith("Every other pair is worse.")


def test_the_sentence_says_which_pairs_are_as_good():
    assert choice(7.0, 7.0, 8.0).sentence.endswith("All other pairs are shown to be worse.")
    assert "Not shown to be worse: " in choice(7.0, 7.0, 8.0).sentence
    assert "No other pair is shown to be worse" in choice(7.0, 7.0, 7.0).sentence
