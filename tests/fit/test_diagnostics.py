import numpy as np
import pytest
from scipy.signal import lfilter

from finray_calib.fit import autocorrelation_time, bulk_ess, rank_r_hat


def autoregressive(rho, steps, chains, rng):
    """Stationary AR(1) chains of unit variance; integrated autocorrelation time (1 + rho) / (1 - rho)."""
    noise = rng.standard_normal((steps + 500, chains)) * np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise, axis=0)[500:]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_ess_and_autocorrelation_time_of_autoregressive_chains(rho):
    chains = autoregressive(rho, 4000, 20, np.random.default_rng(6))
    tau = (1 + rho) / (1 - rho)
    # Sokal: relative sd of the estimate is sqrt(2 (2 M + 1) / N) with the window M = 5 tau; four of them
    tolerance = 4 * np.sqrt(2 * (10 * tau + 1) / chains.size)
    assert autocorrelation_time(chains) == pytest.approx(tau, rel=tolerance)
    assert bulk_ess(chains) == pytest.approx(chains.size / tau, rel=tolerance)


def test_antithetic_chains_have_more_effective_than_drawn_values():
    chains = autoregressive(-0.5, 4000, 10, np.random.default_rng(6))
    assert bulk_ess(chains) == pytest.approx(3 * chains.size, rel=0.12)  # tau = 1/3 is the sum of few terms


def test_r_hat_is_one_for_agreeing_chains():
    assert rank_r_hat(np.random.default_rng(1).standard_normal((1000, 8))) == pytest.approx(1.0, abs=0.01)


def test_r_hat_of_shifted_chains_equals_its_closed_form():
    """Half the chains shifted by d sd: between/within = d^2/4 before ranking; ranking changes it little."""
    chains = np.random.default_rng(1).standard_normal((2000, 40))
    chains[:, ::2] += 0.5
    expected = np.sqrt(1 + 0.5**2 / 4 * 40 / 39)
    assert rank_r_hat(chains) == pytest.approx(expected, abs=0.01)


def test_r_hat_sees_a_drift_and_a_different_spread():
    rng = np.random.default_rng(1)
    drifting = rng.standard_normal((1000, 4)) + np.linspace(0, 2, 1000)[:, None]
    assert rank_r_hat(drifting) > 1.1
    spread = rng.standard_normal((1000, 4)) * [1, 1, 1, 4]
    assert rank_r_hat(spread) > 1.1  # only the folded ranks can see it


def test_r_hat_survives_heavy_tails():
    assert rank_r_hat(np.random.default_rng(1).standard_cauchy((1000, 8))) < 1.01
