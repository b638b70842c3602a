import warnings

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import genpareto

from finray_calib.fit import smooth_weights
from finray_calib.fit._importance import fit_pareto_tail


def weights_with_tail(shape, count=4000, seed=3):
    """Logarithms of weights whose law is generalised Pareto: the ratio of two densities with tail index 1 / shape."""
    return np.log(genpareto(shape).rvs(count, random_state=np.random.default_rng(seed)) + 1e-3)


@pytest.fixture(scope="module")
def psislw():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # arviz announces its own future on import
        from arviz import psislw
    return psislw


@pytest.mark.parametrize("shape", [0.4, 0.55, 0.7, 1.0, 1.6])
@pytest.mark.parametrize("count", [500, 4000])
def test_weights_and_shape_are_those_of_arviz(psislw, shape, count):
    ln_weight = weights_with_tail(shape, count)
    ln_expected, k = psislw(ln_weight.copy())
    got = smooth_weights(ln_weight)
    assert got.pareto_k == pytest.approx(float(k), abs=1e-10)
    # arviz leaves tails shorter than k = 1/3 as they are, which these shapes do not reach
    assert k > 1 / 3
    assert np.allclose(got.weight, np.exp(ln_expected - logsumexp(ln_expected)), rtol=1e-10, atol=0)


@pytest.mark.parametrize("shape", [0.1, 0.5, 0.9])
def test_shape_of_a_known_tail_is_estimated(shape):
    """Mean over 40 samples of 200 tail draws; the prior draws k to 0.5 as if by ten draws."""
    law = genpareto(shape, scale=2.5)
    fits = np.array(
        [fit_pareto_tail(np.sort(law.rvs(200, random_state=np.random.default_rng(seed)))) for seed in range(40)]
    )
    expected = (200 * shape + 10 * 0.5) / 210
    # asymptotic sd of the shape is (1 + k) / sqrt(n); five standard errors of the mean and a small-sample bias of 1/n
    assert fits[:, 0].mean() == pytest.approx(expected, abs=5 * (1 + shape) / np.sqrt(200 * 40) + 0.01)
    assert fits[:, 1].mean() == pytest.approx(2.5, rel=0.1)


def test_bounded_weights_have_a_small_shape_and_nearly_all_draws_count():
    ln_weight = np.log1p(np.random.default_rng(1).random(4000))
    got = smooth_weights(ln_weight)
    assert got.pareto_k < 0.1
    assert got.effective == pytest.approx(4000 * 1.5**2 / (7 / 3), rel=0.02)  # E[w]^2 / E[w^2] of uniform on 1..2


def test_smoothing_keeps_order_sum_and_the_largest_raw_weight_as_limit():
    ln_weight = weights_with_tail(1.2)
    got = smooth_weights(ln_weight)
    assert got.weight.sum() == pytest.approx(1.0, abs=1e-12)
    assert (np.diff(got.weight[np.argsort(ln_weight)]) >= 0).all()
    raw = np.exp(ln_weight - ln_weight.max())
    body = np.argsort(ln_weight)[:3000]
    # relative to a body weight no smoothed weight exceeds what the largest raw one was
    assert got.weight.max() / got.weight[body[0]] <= raw.max() / raw[body[0]] * (1 + 1e-9)


def test_weights_of_zero_stay_zero():
    ln_weight = np.append(weights_with_tail(0.5), [-np.inf, -np.inf])
    assert smooth_weights(ln_weight).weight[-2:].tolist() == [0.0, 0.0]


def test_equal_weights_stay_equal_and_say_that_they_have_no_tail():
    got = smooth_weights(np.zeros(1000))
    assert np.allclose(got.weight, 1e-3)
    assert got.effective == pytest.approx(1000.0)


def test_constant_factor_changes_nothing():
    ln_weight = weights_with_tail(0.6)
    assert np.allclose(smooth_weights(ln_weight).weight, smooth_weights(ln_weight + 300.0).weight, rtol=1e-9)


@pytest.mark.parametrize("rounding", [0.0, 1e-12])
def test_equal_weights_are_a_perfect_sample(rounding):
    got = smooth_weights(-300.0 + rounding * np.random.default_rng(2).random(4000))
    assert got.pareto_k == 0.0
    assert got.effective == pytest.approx(4000, rel=1e-9)


def test_shape_of_a_handful_of_weights_is_unknown():
    ln_weight = np.full(4000, -np.inf)
    ln_weight[:3] = [0.0, -1.0, -2.0]
    assert smooth_weights(ln_weight).pareto_k == np.inf
