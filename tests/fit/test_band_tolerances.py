"""Filter tolerances: the linear columns against the moved rig itself, and the marginal covariance against draws."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from data_schemas import Optics
from finray_calib.fit import BandData, EmissionPrior, LogPosterior
from finray_calib.fit._band_data import Reference, tolerance_columns
from finray_calib.spectra import band_tolerances, rig_emission_weights
from tests.fit.synthetic_bands import ZHENG, full_sum

SHARES = (0.1, 0.3, 0.6)
PLAIN = np.array([597.0, np.log(48.0), np.log(0.004), 1.8, np.log(0.05), 0.0])


def values(weights, theta=PLAIN):
    return full_sum(ZHENG, theta, weights)[0]


def columns_of(weights, tolerances):
    curve = ZHENG.curves(PLAIN[None], weights.wavelength_nm)[0]
    return tolerance_columns(Reference(curve, 0.05, np.ones(len(weights.band_index))), weights, tolerances)


def moved(optics: Optics, name: str, **change: float) -> Optics:
    filters = tuple(
        f.model_copy(update={k: getattr(f, k) + v for k, v in change.items()}) if f.name == name else f
        for f in optics.filters
    )
    return optics.model_copy(update={"filters": filters})


@pytest.mark.parametrize(
    ("name", "change", "kind"),
    [
        ("500", {"center_nm": 0.15}, 1),
        ("600", {"fwhm_nm": 0.15}, 2),
        ("450", {"center_nm": 0.15}, 1),
        ("450", {"fwhm_nm": 0.15}, 2),
    ],
)
def test_column_is_the_effect_of_moving_that_filter(optics, name, change, kind):
    nominal = rig_emission_weights(optics, SHARES)
    columns = columns_of(nominal, band_tolerances(optics, SHARES))
    band = [f.name for f in optics.filters].index(name)
    mu = values(nominal)
    effect = values(rig_emission_weights(moved(optics, name, **change), SHARES)) - mu
    # an excitation filter's columns lose second order in a shift of 1.5 % of its width
    np.testing.assert_allclose(columns[:, 8 * kind + band], effect, rtol=0.02, atol=1e-6 * np.abs(mu).max())


# the laser's own filter leaks lamp into the white that the laser is compared with, which moves all bands
@pytest.mark.parametrize(("name", "band", "moves"), [("500", 2, 3), ("450", 1, 24)])
def test_blocking_column_is_the_slope_in_the_optical_density(optics, name, band, moves):
    columns = columns_of(rig_emission_weights(optics, SHARES), band_tolerances(optics, SHARES))
    step = 1e-4
    leakier, tighter = (
        values(rig_emission_weights(moved(optics, name, blocking_od=sign * step), SHARES)) for sign in (-1, 1)
    )
    slope = (leakier - tighter) / (2 * step) * 0.2  # one standard uncertainty is 0.2 in optical density
    assert (slope != 0).sum() == moves
    # the laser that passes its filter is taken not to leak as well: 10^-5 or less of it
    np.testing.assert_allclose(columns[:, band], slope, rtol=1e-3, atol=1e-4 * np.abs(slope).max())


def test_leak_multiplier_equals_another_optical_density(optics):
    leakier = optics
    for band in optics.filters:
        leakier = moved(leakier, band.name, blocking_od=-0.3 / np.log(10))
    more = PLAIN.copy()
    more[5] = 0.3
    got = values(rig_emission_weights(optics, SHARES), more)
    # the laser that passes its filter is taken not to leak as well: of it, 10^-5 or less
    np.testing.assert_allclose(got, values(rig_emission_weights(leakier, SHARES)), rtol=1e-4)


def test_likelihood_with_tolerances_equals_the_plain_gaussian(optics):
    weights, tolerances = rig_emission_weights(optics, SHARES), band_tolerances(optics, SHARES)
    rng = np.random.default_rng(3)
    mu = values(weights)
    noise = np.diag((0.003 * mu + 1e-6) ** 2)
    y = mu * (1 + 0.01 * rng.standard_normal(24))
    data = BandData(y.reshape(8, 3), noise, np.ones((8, 3), bool), weights, 0.01, tolerances)
    same_band = weights.band_index[:, None] == weights.band_index
    columns = columns_of(weights, tolerances)
    reference = Reference(ZHENG.curves(PLAIN[None], weights.wavelength_nm)[0], 0.05, np.ones(24))
    covariance = noise + 1e-4 * np.outer(y, y) * same_band + columns @ columns.T
    posterior = LogPosterior(data, ZHENG, EmissionPrior(), reference=reference)
    expected = multivariate_normal(posterior.predict_usable(PLAIN[None])[0], covariance).logpdf(y)
    assert posterior.log_likelihood(PLAIN[None])[0] == pytest.approx(expected, abs=1e-6)
