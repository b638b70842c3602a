"""Filter tolerances: the linear columns against the moved rig itself, and the marginal covariance against draws."""

import numpy as np
import pytest

from data_schemas.radiometry import Optics
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.likelihood import BandData, LogPosterior
from finray_calib.fit.nuisances import NuisanceModel
from finray_calib.fit.prior import EmissionPrior
from finray_calib.spectra.band_tolerances import tolerances_of
from finray_calib.spectra.rig_curves import weights_of
from rigs.presets import simulated_rig
from tests.fit.predictions import predict_bands

SHARES = (0.1, 0.3, 0.6)
THETA = np.array([[597.0, np.log(48.0), 1.8, np.log(0.004), np.log(0.05), 0.3]])


@pytest.fixture(scope="module")
def optics() -> Optics:
    rig = simulated_rig("red")
    return Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        camera_response=assumed_camera_response(),
    )


def moved(optics: Optics, name: str, **change: float) -> Optics:
    filters = tuple(
        f.model_copy(update={k: getattr(f, k) + v for k, v in change.items()}) if f.name == name else f
        for f in optics.filters
    )
    return optics.model_copy(update={"filters": filters})


@pytest.mark.parametrize(
    ("name", "change", "kind"),
    [
        ("500", {"center_nm": 0.15}, 2),
        ("600", {"fwhm_nm": 0.15}, 3),
        ("450", {"center_nm": 0.15}, 2),
        ("450", {"fwhm_nm": 0.15}, 3),
    ],
)
def test_column_is_the_effect_of_moving_that_filter(optics, name, change, kind):
    nominal = weights_of(optics, SHARES)
    mu, columns = NuisanceModel(nominal, 0.01, tolerances_of(optics, SHARES)).predict(THETA)
    band = [f.name for f in optics.filters].index(name)
    effect = predict_bands(THETA, weights_of(moved(optics, name, **change), SHARES)) - mu
    # the columns are taken at the nominal leak; here it is exp(0.3) times that, which scales the dim channels' shift
    tolerance = 0.35 * np.abs(effect[0])
    plain = THETA.copy()
    plain[0, 5] = 0.0
    np.testing.assert_allclose(columns[0, :, 8 * kind + band], effect[0], atol=tolerance.max(), rtol=0.35)
    mu, columns = NuisanceModel(nominal, 0.01, tolerances_of(optics, SHARES)).predict(plain)
    effect = predict_bands(plain, weights_of(moved(optics, name, **change), SHARES)) - mu
    # exact at the nominal leak: the columns of an excitation filter lose second order in a shift of 1.5 % of its width
    np.testing.assert_allclose(columns[0, :, 8 * kind + band], effect[0], rtol=0.02, atol=1e-6 * np.abs(mu).max())


def test_blocking_column_is_the_slope_in_the_optical_density(optics):
    nominal = weights_of(optics, SHARES)
    _, columns = NuisanceModel(nominal, 0.01, tolerances_of(optics, SHARES)).predict(THETA)
    step = 1e-4
    leakier, tighter = (
        predict_bands(THETA, weights_of(moved(optics, "500", blocking_od=sign * step), SHARES)) for sign in (-1, 1)
    )
    slope = (leakier - tighter)[0] / (2 * step) * 0.2  # one standard uncertainty is 0.2 in optical density
    assert np.abs(slope).max() > 0
    np.testing.assert_allclose(columns[0, :, 8 + 2], slope, rtol=1e-3, atol=1e-12)


def test_leak_multiplier_equals_another_optical_density(optics):
    leakier = optics.model_copy(
        update={
            "filters": tuple(
                f if f.name == "450" else f.model_copy(update={"blocking_od": f.blocking_od - 0.3 / np.log(10)})
                for f in optics.filters
            )
        }
    )
    plain = THETA.copy()
    plain[0, 5] = 0.0
    np.testing.assert_allclose(
        predict_bands(THETA, weights_of(optics, SHARES)), predict_bands(plain, weights_of(leakier, SHARES)), rtol=1e-9
    )


def test_likelihood_with_tolerances_equals_the_plain_gaussian(optics):
    from scipy.stats import multivariate_normal

    weights = weights_of(optics, SHARES)
    tolerances = tolerances_of(optics, SHARES)
    rng = np.random.default_rng(3)
    mu, columns = NuisanceModel(weights, 0.01, tolerances).predict(THETA)
    noise = np.diag((0.003 * mu[0] + 1e-6) ** 2)
    y = mu[0] + columns[0] @ rng.standard_normal(columns.shape[2]) + np.sqrt(np.diag(noise)) * rng.standard_normal(24)
    data = BandData(y.reshape(8, 3), noise, np.ones((8, 3), bool), weights, 0.01, tolerances)
    expected = multivariate_normal(mu[0], noise + columns[0] @ columns[0].T).logpdf(y)
    assert LogPosterior(data, EmissionPrior()).log_likelihood(THETA)[0] == pytest.approx(expected, abs=1e-5)
