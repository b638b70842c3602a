"""The netCDF file against ArviZ, which it is made for."""

import sys
import warnings

import numpy as np
import pytest

from data_schemas import ChainCheck, MissingExtraError
from finray_calib.exchange._paint_formats import REPLICATES, netcdf_bytes

pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def az():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # announces its refactoring on import
        return pytest.importorskip("arviz")


@pytest.fixture
def opened(az, paint, spectra, origin, tmp_path):
    file = tmp_path / "p.nc"
    file.write_bytes(netcdf_bytes(paint, spectra, origin, np.random.default_rng(1)))
    return az.from_netcdf(str(file))


def test_summary_of_arviz_is_that_of_the_draws(az, paint, opened):
    summary = az.summary(opened, kind="stats", round_to="none")
    assert list(summary.index) == list(paint.sampled)
    np.testing.assert_allclose(summary["mean"], paint.draws.mean(axis=0))
    np.testing.assert_allclose(summary["sd"], paint.draws.std(axis=0, ddof=1))


def test_groups_that_arviz_knows(opened, paint):
    assert opened.posterior.sizes == {"chain": 1, "draw": len(paint.draws)}
    assert opened.prior.sizes == {"chain": 1, "draw": len(paint.prior_draws)}
    np.testing.assert_array_equal(opened.observed_data["fluorescence"], paint.measured)
    assert list(opened.observed_data["channel"].values) == ["red", "green", "blue"]
    assert list(opened.observed_data["filter"].values) == [f.name for f in paint.optics.filters]
    np.testing.assert_array_equal(opened.constant_data["usable"], paint.usable)
    assert opened.posterior.attrs["inference_library"] == "finray-calib"
    assert "SHA-256" in opened.posterior.attrs["inputs"]


def test_replicated_data_scatter_as_stored(opened, paint):
    replicated = opened.posterior_predictive["fluorescence"].values[0]
    assert replicated.shape == (REPLICATES, *paint.measured.shape)
    sd = np.hypot(paint.predicted_sd, paint.measured_sd)
    # 24 means of 1000 draws: the largest is beyond 4.5 standard errors once in 6000 seeds
    np.testing.assert_array_less(np.abs(replicated.mean(axis=0) - paint.predicted), 4.5 * sd / np.sqrt(REPLICATES))
    # the relative error of a standard deviation from 1000 draws is 2.2 %
    np.testing.assert_allclose(replicated.std(axis=0, ddof=1), sd, rtol=4.5 * 0.0224)


def test_diagnostics_and_curves(opened, paint, spectra):
    parameters = opened.sample_stats["parameter"].values.tolist()
    assert parameters == list(paint.sampled)
    np.testing.assert_array_equal(opened.sample_stats["map_estimate"], [paint.map_estimate[p] for p in parameters])
    assert opened.sample_stats.attrs["pareto_k"] == paint.diagnostics.pareto_k
    assert opened.sample_stats.attrs["trusted"] == int(paint.diagnostics.trusted)
    curves = opened["emission_posterior"]
    np.testing.assert_array_equal(curves["emission_per_nm"][0], spectra.emission_draws_per_nm)
    np.testing.assert_array_equal(curves["absorption_rel"][0], spectra.absorption_rel_draws)
    assert curves.attrs["statement"] == spectra.statement


def test_a_chain_of_emcee_is_kept(paint, spectra, origin, az, tmp_path):
    one = dict.fromkeys(paint.sampled, 1.5)
    chain = ChainCheck(
        walkers=32,
        steps=100,
        converged=False,
        acceptance_fraction=0.3,
        autocorrelation_time=one,
        r_hat=one,
        effective_samples=one,
        mean_shift_sd=one,
    )
    checked = paint.model_copy(update={"diagnostics": paint.diagnostics.model_copy(update={"chain": chain})})
    (tmp_path / "p.nc").write_bytes(netcdf_bytes(checked, spectra, origin, np.random.default_rng(1)))
    statistics = az.from_netcdf(str(tmp_path / "p.nc")).sample_stats
    np.testing.assert_array_equal(statistics["r_hat"], 1.5)
    assert (statistics.attrs["chain_walkers"], statistics.attrs["chain_converged"]) == (32, 0)


def test_a_shape_of_weights_that_is_unknown_is_nan(paint, spectra, origin, az, tmp_path):
    unknown = paint.model_copy(update={"diagnostics": paint.diagnostics.model_copy(update={"pareto_k": None})})
    (tmp_path / "p.nc").write_bytes(netcdf_bytes(unknown, spectra, origin, np.random.default_rng(1)))
    assert np.isnan(az.from_netcdf(str(tmp_path / "p.nc")).sample_stats.attrs["pareto_k"])


@pytest.mark.parametrize("package", ["h5netcdf", "h5py"])
def test_missing_package_is_named(paint, spectra, origin, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[netcdf\]'"):
        netcdf_bytes(paint, spectra, origin, np.random.default_rng(1))
