"""The emulator of a design's numbers: its fit, what it finds with noise, and whether its intervals hold."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import approx_fprime

from data_schemas import CompareError
from finray_calib.decide import (
    DesignEmulator,
    best_design,
    emulator_ensemble,
    fit_emulator,
    joint_draws,
    next_design,
    screening_designs,
)
from finray_calib.decide._design_emulator import SMOOTHNESSES, _negative_ln_posterior, main_effect, near_front

Floats = NDArray[np.float64]
NOISE = 0.03
BEST = np.array([0.3, 0.6, 0.45, 0.7, 0.2, 0.5])
HARTMANN_SLOPES = np.array(
    [[10, 3, 17, 3.5, 1.7, 8], [0.05, 10, 17, 0.1, 8, 14], [3, 3.5, 1.7, 10, 17, 8], [17, 8, 0.05, 10, 0.1, 14]]
)
HARTMANN_PLACES = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)


def bowl(x: Floats) -> float:
    """Return a number whose least value is -1, at BEST: two inputs go together, and the last counts for nothing."""
    z = x - BEST
    return -float(
        np.exp(-(4 * z[0] ** 2 + 3 * z[1] ** 2 + 3 * z[0] * z[1] + 2 * z[2] ** 2 + z[3] ** 2 + z[4] ** 2 / 2))
    )


def hartmann(x: Floats) -> float:
    """Return Hartmann's function of six inputs over its known optimum: least value -1, with other minima."""
    terms = np.exp(-(HARTMANN_SLOPES * (x - HARTMANN_PLACES) ** 2).sum(axis=1))
    return -float(np.array([1.0, 1.2, 3.0, 3.2]) @ terms) / 3.32237


def searched(truth, seed: int, evaluations: int) -> tuple[DesignEmulator, Floats]:
    """Return the emulator after a search with noise, and the design that it recommends."""
    rng = np.random.default_rng(seed)
    inputs = screening_designs(6, 24, seed)
    values = np.array([truth(x) + NOISE * rng.standard_normal() for x in inputs])
    fitted = None
    while len(values) < evaluations:
        is_fit = fitted is None or len(values) % 4 == 0
        fitted = (
            fit_emulator(inputs, values, fitted) if is_fit else DesignEmulator(inputs, values, fitted.ln_parameters)
        )
        at = next_design([fitted], np.ones(1), rng)
        inputs = np.concatenate([inputs, at[None]])
        values = np.append(values, truth(at) + NOISE * rng.standard_normal())
    fitted = fit_emulator(inputs, values, fitted)
    return fitted, best_design([fitted], np.ones(1), rng)


@pytest.mark.parametrize("smoothness", SMOOTHNESSES)
def test_the_gradient_is_that_of_the_posterior(smoothness: float) -> None:
    rng = np.random.default_rng(2)
    inputs, scaled = rng.random((12, 2)), rng.standard_normal(12)
    squares = [(column[:, None] - column) ** 2 for column in inputs.T]
    at = np.log([0.4, 0.9, 1.2, 0.1])
    own = _negative_ln_posterior(at, squares, scaled, smoothness)[1]
    by_steps = approx_fprime(at, lambda p: _negative_ln_posterior(p, squares, scaled, smoothness)[0], 1e-6)
    # forward differences of 1e-6 are good to some 1e-5
    np.testing.assert_allclose(own, by_steps, rtol=1e-3, atol=1e-3)


def test_a_smooth_number_without_noise_is_met_between_its_points() -> None:
    inputs = screening_designs(2, 40, 1)
    truth = np.sin(3.0 * inputs[:, 0]) + inputs[:, 1] ** 2
    fitted = fit_emulator(inputs[:32], truth[:32])
    spread = truth.std()
    # some of the eight lie outside the others, where the emulator extrapolates
    assert np.abs(fitted.mean(inputs[32:]) - truth[32:]).max() < 0.05 * spread
    assert fitted.left_out_error_rel < 0.05
    # noise that moves all values explains nothing: the error of left-out values is their spread
    noise = np.random.default_rng(4).standard_normal(32)
    assert fit_emulator(inputs[:32], noise).left_out_error_rel > 0.8


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_optimum_of_a_noisy_bowl_is_found_within_2_percent(seed: int) -> None:
    _, found = searched(bowl, seed, 90)
    assert bowl(found) < -0.98


@pytest.mark.parametrize("seed", [1, 2])
def test_the_optimum_among_several_is_found_within_2_percent(seed: int) -> None:
    _, found = searched(hartmann, seed, 100)
    assert hartmann(found) < -0.98


def test_intervals_of_a_gain_cover_at_their_rate() -> None:
    """Numbers drawn from processes of either smoothness, seen at 24 designs with noise; a gain between two others."""
    covered, trials = 0, 80
    for trial in range(trials):
        rng = np.random.default_rng([7, trial])
        inputs = screening_designs(2, 24, trial)
        at = rng.random((2, 2))
        truth = DesignEmulator(
            np.zeros((1, 2)), np.zeros(1), np.array([*rng.normal(np.log(0.6), 0.5, 2), 0.0, np.log(1e3)]),
            SMOOTHNESSES[trial % 2],
        )  # fmt: skip
        both = np.concatenate([inputs, at])
        drawn = rng.multivariate_normal(np.zeros(len(both)), truth.covariance(both), method="eigh")
        values = drawn[:-2] + 0.1 * rng.standard_normal(24)
        ensemble = emulator_ensemble(fit_emulator(inputs, values), rng)
        draws = joint_draws(ensemble, at, 800, rng)
        low, high = np.quantile(draws[:, 0] - draws[:, 1], [0.025, 0.975])
        covered += low <= drawn[-2] - drawn[-1] <= high
    # of 80 at 95 %, 71 or fewer come up with 2 %, and all 80 with 2 %
    assert 71 < covered <= 80


def test_designs_that_cannot_be_built_are_left_out() -> None:
    def half(x: Floats) -> bool:
        return bool(x[0] < 0.5)

    inputs = screening_designs(2, 16, 3, half)
    assert len(inputs) == 16
    assert inputs[:, 0].max() < 0.5
    # the best of all would have a large first input
    fitted = fit_emulator(inputs, -inputs[:, 0])
    rng = np.random.default_rng(0)
    assert next_design([fitted], np.ones(1), rng, half)[0] < 0.5
    assert 0.4 < best_design([fitted], np.ones(1), rng, half)[0] < 0.5
    with pytest.raises(CompareError, match=r"only 0 of \d+ tried designs .* give narrower limits"):
        screening_designs(2, 4, 3, lambda x: False)


def test_the_front_leaves_out_what_is_beaten_in_everything() -> None:
    rivals = np.array([[0.0, 1.0], [1.0, 0.0], [0.5, 0.5]])
    asked = np.array([[0.5, 0.5], [0.6, 0.6], [0.505, 0.505], [0.0, 3.0], [-0.1, 3.0]])
    assert near_front(asked, rivals, 0.01).tolist() == [True, False, True, False, True]


def test_a_main_effect_is_that_of_its_input_alone() -> None:
    inputs = screening_designs(2, 48, 5)
    fitted = fit_emulator(inputs, 2.0 * inputs[:, 0] + 0.0 * inputs[:, 1])
    rng = np.random.default_rng(0)
    levels, others = np.array([0.0, 0.5, 1.0]), screening_designs(2, 32, 6)
    of_first = main_effect([fitted], 0, levels, others, rng).mean(axis=0)
    of_second = main_effect([fitted], 1, levels, others, rng).mean(axis=0)
    np.testing.assert_allclose(of_first, [0.0, 1.0, 2.0], atol=0.02)
    np.testing.assert_allclose(of_second, of_second[0], atol=0.02)
