"""Adaptive Monte Carlo: normal distributions of known width, and the examples of JCGM 101."""

import numpy as np
import pytest
from scipy.stats import norm

from finray_calib.compare._input_draws import BLOCK_DRAWS, LARGEST_BLOCKS, ends, numerical_tolerance, propagate


@pytest.mark.parametrize(
    # JCGM 101:2008, 7.9.2, examples 1 to 3: 100.021 47 g with 0.000 35 g, the same with one digit, 2 K
    ("u", "digits", "tolerance"),
    [(0.00035, 2, 0.000005), (0.00035, 1, 0.00005), (2.0, 1, 0.5), (0.0, 2, 0.0)],
)
def test_tolerances_of_the_guide(u, digits, tolerance):
    assert numerical_tolerance(u, digits) == pytest.approx(tolerance, rel=1e-12)


def normal_blocks(mean, sd, seed=0):
    rng = np.random.default_rng(seed)

    def block(draws):
        headline = mean + sd * rng.standard_normal(draws)
        return {"headline": headline, "other": np.stack([headline, -headline], axis=1)}

    return block


def test_a_width_of_one_is_stable_to_two_digits_after_four_blocks():
    """The ends of 10 000 normal draws scatter by 0.027: twice that over sqrt(4) is less than half a tenth."""
    found = propagate(normal_blocks(5.0, 1.0), "headline")
    assert found.significant_digits == 2
    assert len(found.draws["headline"]) == 4 * BLOCK_DRAWS
    assert found.draws["other"].shape == (4 * BLOCK_DRAWS, 2)
    assert (found.draws["other"][:, 1] == -found.draws["headline"]).all()
    low, high = ends(found.draws["headline"])
    # what the rule promises: each end to half a unit of the second digit of 1.0, which it reaches four times over
    assert (low, high) == pytest.approx(tuple(5.0 + norm.ppf([0.025, 0.975])), abs=0.05)


def test_a_width_of_nine_and_a_half_stays_at_one_digit():
    """Half a tenth of 9.5: the ends scatter by 0.25, over sqrt(12) blocks twice that is still 0.15."""
    found = propagate(normal_blocks(0.0, 9.5), "headline")
    assert found.significant_digits == 1
    assert len(found.draws["headline"]) == LARGEST_BLOCKS * BLOCK_DRAWS


def test_blocks_that_do_not_agree_are_not_stable():
    """Means 0 to 11 of equal spread: standard deviation 3.5 in all, the mean of 12 such blocks known to 1."""
    means = iter(range(LARGEST_BLOCKS))
    rng = np.random.default_rng(1)
    found = propagate(lambda draws: {"headline": next(means) + 0.1 * rng.standard_normal(draws)}, "headline")
    assert found.significant_digits == 0


def test_what_does_not_vary_needs_no_more_draws():
    found = propagate(lambda draws: {"headline": np.full(draws, 0.3)}, "headline")
    assert found.significant_digits == 2
    assert len(found.draws["headline"]) == 4 * BLOCK_DRAWS


def test_ends_are_taken_along_the_first_axis():
    values = np.stack([np.linspace(0.0, 1.0, 1001), np.linspace(0.0, 2.0, 1001)], axis=1)
    low, high = ends(values)
    assert low == pytest.approx([0.025, 0.05])
    assert high == pytest.approx([0.975, 1.95])
