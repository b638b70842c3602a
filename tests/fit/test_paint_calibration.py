"""From band signals to the paint record: reflectance without fluorescence, held curves, total chi-square."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from data_schemas import BandSignals, Estimate, FitError, PaintCalibration, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.fit import (
    DEFAULT_FAMILY,
    LARGEST_MEMORY,
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    EmissionPrior,
    FitOptions,
    FitSettings,
    SamplerSettings,
    band_data,
    calibrate_paint,
    curve_bands,
    fit_emission,
    reflectance,
    smooth_weights,
)
from finray_calib.fit import _paint_calibration as paint_calibration
from finray_calib.fit._paint_calibration import energy_warnings, fit_warnings
from finray_calib.spectra import (
    FAMILIES,
    WAVELENGTH_NM,
    SkewCauchy,
    extrapolated_shares,
    filter_transmission,
    photon_yield,
)
from rigs import simulated_rig
from rigs.simulated import bench_truth


@pytest.fixture(scope="module")
def bands(red_bands) -> BandSignals:
    return red_bands


FEW = FitOptions(
    settings=FitSettings(importance_draws=4000, kept_draws=500, chain=SamplerSettings(walkers=32, most_steps=300))
)


@pytest.fixture(scope="module")
def paint(bands):
    return calibrate_paint(bands, 1, FEW)


def test_bench_and_nominal_fitter_agree_on_mode_width_and_yield(paint):
    truth = bench_truth(simulated_rig("red", seed=3), Path())
    for name in ("mode_nm", "fwhm_nm", "energy_yield"):
        value = paint.parameters[name]
        assert value.low95 < getattr(truth, name) < value.high95
    assert paint.energy_yield == paint.parameters["energy_yield"]
    assert not any("cannot explain" in said for said in paint.warnings)


def test_linear_algebra_takes_one_thread_during_a_fit_and_all_again_after_it(bands, monkeypatch):
    """The families are fitted side by side; threads of the matrices' own would only wait for each other."""

    def blas_threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    monkeypatch.setattr(paint_calibration, "_calibrate", lambda *_: blas_threads())
    with threadpool_limits(limits=2, user_api="blas"):
        assert calibrate_paint(bands, 1) == {1}
        assert blas_threads() == {2}


@pytest.mark.parametrize("draws", [501, 2, 1])
def test_limits_of_curves_are_numpys_quantiles(draws):
    curves = np.random.default_rng(1).gamma(2.0, size=(draws, 30))
    got = curve_bands(curves)
    expected = np.quantile(curves, [0.025, 0.16, 0.84, 0.975], axis=0)
    assert np.allclose([got.low95, got.low68, got.high68, got.high95], expected, rtol=1e-14, atol=0)
    assert np.array_equal(got.mean, curves.mean(axis=0))


def test_all_families_stand_beside_the_reported_one(paint):
    names = [f.name for f in paint.families]
    assert names == [*FAMILIES, "zheng2014"]  # the paper's family a second time, without discrepancy
    assert sum(f.probability for f in paint.families[:-1]) == pytest.approx(1.0)
    assert [f.with_discrepancy for f in paint.families] == [True] * 4 + [False]
    assert paint.families[-1].left_out_bands is None
    assert paint.families[-1].probability is None
    assert paint.family in FAMILIES
    assert paint.family_choice.startswith(paint.family)


def test_own_leaks_of_filters_stand_behind_the_common_blocking_by_name(paint):
    leaks = paint.sampled[paint.sampled.index("ln_blocking") + 1 :]
    assert leaks
    assert set(leaks) <= {f"leak_{f.name}" for f in paint.optics.filters}
    for name in leaks:
        assert paint.prior[name].startswith(f"normal(0, 1): ln(leak of filter {name.removeprefix('leak_')} / ")
        assert name in paint.map_estimate
        assert name in paint.parameters
    assert paint.draws.shape[1] == paint.prior_draws.shape[1] == len(paint.sampled)


def test_paper_parameters_are_those_of_the_paper_curve(paint):
    """l0, gamma, omega and h of the paper give back the mode of its own fit."""
    p = {name: e.estimate for name, e in paint.paper.items()}
    curve = SkewCauchy(p["location_nm"], p["scale_nm"], p["skewness"], p["amplitude_nm"])
    mode = paint.families[-1].quantities["mode_nm"]
    # medians of four correlated parameters: half a posterior interval
    assert curve.mode_nm == pytest.approx(mode.estimate, abs=max(1.0, mode.high95 - mode.low95))


def test_band_integrals_are_means_over_the_transmissions(paint):
    for band, got in zip(paint.optics.filters, paint.band_integrals, strict=True):
        passed = filter_transmission(band, WAVELENGTH_NM)
        drawn = paint.emission_draws_per_nm @ passed / passed.sum()
        # the stored draws are the first of those that were summarised: their median scatters by a tenth of an sd
        assert got.estimate == pytest.approx(np.median(drawn), abs=0.25 * got.sd)


def test_asked_for_family_is_reported_with_what_the_rule_says(bands, paint):
    fitted = calibrate_paint(bands, 1, replace(FEW, family="zheng2014"))
    assert fitted.family == "zheng2014"
    assert fitted.family_choice.startswith("zheng2014")
    assert "kappa" in fitted.sampled
    assert fitted.families == paint.families  # the same seed gives the same numbers


def test_without_discrepancy_a_family_that_the_bands_rule_out_is_not_reported(bands):
    """The paint has the paper's curve: as a log-normal one, its mode is 14 nm and its yield four fifths off."""
    fitted = calibrate_paint(bands, 1, replace(FEW, discrepancy=NO_DISCREPANCY))
    assert fitted.family in ("zheng2014", "skew_t")
    truth = bench_truth(simulated_rig("red", seed=3), Path())
    assert fitted.mode_nm.low95 <= truth.mode_nm <= fitted.mode_nm.high95


def flagged(bands, lost):
    flags = tuple(("saturated",) * 3 if f.name in lost else ("ok",) * 3 for f in bands.optics.filters)
    return bands.model_copy(update={"flags": flags})


def test_saturated_bands_give_wider_intervals(bands, paint):
    few = calibrate_paint(flagged(bands, {"560", "600", "630"}), 1, FEW)
    truth = bench_truth(simulated_rig("red", seed=3), Path())
    for name in ("mode_nm", "peak_per_nm", "energy_yield"):
        # of the estimate: without its brightest bands the level itself is lower, and a share of it says what is known
        wide, narrow = few.parameters[name], paint.parameters[name]
        assert wide.sd / wide.estimate > 1.3 * narrow.sd / narrow.estimate
    for name in ("mode_nm", "energy_yield"):
        assert few.parameters[name].low95 < getattr(truth, name) < few.parameters[name].high95
    lost = {r.filter_name for r in few.bands if r.degrees_of_freedom == 0}
    assert lost == {"560", "600", "630"}


def test_an_ambiguity_and_other_doubts_are_told(bands):
    """Two maxima 1 nat apart and a third that the bands exclude, untrusted draws, a chain that disagrees."""
    maxima = SimpleNamespace(
        log_posterior=np.array([10.0, 9.0, -9.0]), theta=np.array([[606.0, 0], [561.0, 0], [700.0, 0]])
    )
    doubtful = SimpleNamespace(
        maxima=maxima, sampling=SimpleNamespace(trusted=False), share_below_laser=np.full(10, 0.07)
    )
    unexplained = SimpleNamespace(filter_name="532", explained=False)
    said = fit_warnings(doubtful, (unexplained,), SimpleNamespace(mean_shift_sd={"kappa": -0.4}), True)
    for words in (
        "cannot explain the frames of filter 532",
        "2 maxima of the posterior, with modes at 606, 561 nm",
        "sampling cannot be trusted",
        "emcee disagrees",
        "7 % of the fitted curve lies below the laser line",
    ):
        assert any(words in line for line in said)
    fine = SimpleNamespace(
        maxima=SimpleNamespace(log_posterior=np.array([10.0, 1.0]), theta=maxima.theta[:2]),
        sampling=SimpleNamespace(trusted=True),
        share_below_laser=np.zeros(10),
    )
    assert fit_warnings(fine, (), None, False) == ()
    assert "emcee itself made the draws" in fit_warnings(fine, (), None, True)[0]  # asked for, but not independent


def test_a_level_that_contradicts_energy_is_told():
    """A paint that emits all that it absorbs has half of its draws cut off: no reason to warn."""
    assert energy_warnings(SimpleNamespace(excess_share=0.6, conserving=True)) == ()
    told = energy_warnings(SimpleNamespace(excess_share=0.99, conserving=False))[0]
    assert told.startswith("99 % of the draws emit more photons than are absorbed at the laser")
    assert "too few other draws remain, so that all were kept" in told


def test_the_spectrum_rests_on_measured_spectra_unless_a_family_is_asked_for(bands, paint):
    assert paint.spectrum_from == "prior learned from measured spectra"
    assert set(paint.prior_shares) == {"mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "stokes_shift_nm"}
    assert paint.prior_shares["mode_nm"].share < 0.01  # some nm of some sixty
    assert paint.mostly_prior == ()
    low, high = paint.emission_low95_simultaneous_per_nm, paint.emission_high95_simultaneous_per_nm
    counted = paint.emission_per_nm > 0.05 * paint.emission_per_nm.max()
    whole = ((paint.emission_draws_per_nm >= low) & (paint.emission_draws_per_nm <= high))[:, counted].all(axis=1)
    assert 0.9 < whole.mean() < 0.99  # 400 of the 500 draws of which 95 % define it: 2 sd of 0.011 and of 0.01
    asked = calibrate_paint(bands, 1, replace(FEW, family="zheng2014"))
    assert asked.spectrum_from == asked.family_title


def test_photons_are_conserved_in_every_draw(paint):
    emitted = photon_yield(paint.emission_draws_per_nm, WAVELENGTH_NM, paint.optics.laser.wavelength_nm)
    absorbed = emitted[:, None] * paint.reradiation.absorption_rel_draws
    assert (absorbed <= 1 + 1e-9).all()
    assert paint.reradiation.violating_share < 0.05


def test_emcee_that_took_over_is_no_check_of_itself(bands, tmp_path, monkeypatch):
    """Weights of unknown shape: emcee makes the draws, and the record can be stored."""
    monkeypatch.setattr("finray_calib.fit._importance.smooth_weights", without_shape)
    monkeypatch.setattr("finray_calib.fit._family_choice.smooth_weights", without_shape)
    monkeypatch.setattr("finray_calib.fit._paint_calibration.check_by_chain", refuse_call)
    monkeypatch.setattr("finray_calib.fit._markov_chains.LARGEST_MEMORY", 0.0)  # as if the moved draws remembered
    short = SamplerSettings(walkers=24, block_steps=100, most_steps=100, kept_draws=100)
    options = FitOptions(settings=FitSettings(importance_draws=1000, kept_draws=100, chain=short), check_by_emcee=True)
    taken_over = calibrate_paint(bands, 1, options)
    assert any("the check by emcee was left out" in said for said in taken_over.warnings)
    path = write_record(taken_over, tmp_path / "paint.json", provenance("finray fit"))
    stored = read_record(path, PaintCalibration)
    diagnostics, first = stored.diagnostics, stored.families[0]
    assert diagnostics.method == "emcee"
    assert diagnostics.chain.mean_shift_sd == {}
    assert (diagnostics.pareto_k, first.pareto_k, first.left_out_pareto_k) == (None, None, None)


def test_moved_draws_are_told_in_the_record(bands, tmp_path, monkeypatch):
    monkeypatch.setattr("finray_calib.fit._importance.smooth_weights", without_shape)
    monkeypatch.setattr("finray_calib.fit._family_choice.smooth_weights", without_shape)
    options = FitOptions(settings=FitSettings(importance_draws=1000, kept_draws=100))
    path = write_record(calibrate_paint(bands, 1, options), tmp_path / "paint.json", provenance("finray fit"))
    diagnostics = read_record(path, PaintCalibration).diagnostics
    assert (diagnostics.method, diagnostics.trusted, diagnostics.chain) == ("resample-move", True, None)
    assert 0 < diagnostics.memory <= LARGEST_MEMORY
    assert diagnostics.effective_samples == 100  # all kept draws differ


def refuse_call(*_):
    raise AssertionError("a second run of emcee is not independent")


def without_shape(ln_weight):
    return replace(smooth_weights(ln_weight), pareto_k=np.inf)


def test_unusable_sessions_are_refused(bands):
    with pytest.raises(FitError, match="only 3 bands have a usable channel, but at least 4"):
        band_data(flagged(bands, {"405", "500", "532", "560", "600"}))
    y = bands.fluorescence.copy()
    y[2, 1] = np.nan
    with pytest.raises(FitError, match="NaN or infinite"):
        calibrate_paint(bands.model_copy(update={"fluorescence": y}), 1)
    with pytest.raises(FitError, match="'cauchy' is unknown"):
        calibrate_paint(bands, 1, FitOptions(family="cauchy"))


def test_two_sessions_of_one_light_are_refused(bands):
    with pytest.raises(FitError, match="two sessions have the same excitation"):
        calibrate_paint(bands, 1, FEW, other_lights=[bands])


def under_another_light(bands, **fields):
    """Return the bands as if a light at 470 nm had excited them."""
    laser = bands.optics.laser.model_copy(update={"wavelength_nm": 470.0})
    return bands.model_copy(update={"optics": bands.optics.model_copy(update={"laser": laser}), **fields})


def test_another_light_of_another_paint_is_refused(bands):
    with pytest.raises(FitError, match="one session is of paint 'green', but the first is of paint 'red'"):
        calibrate_paint(bands, 1, FEW, other_lights=[under_another_light(bands, paint_name="green")])


def test_a_light_too_dim_to_constrain_the_absorption_is_refused(bands):
    """Noise of a hundred times the signal leaves the yield to the prior, whose logarithm has an sd of 1.2."""
    noise = np.diag(np.full(24, (100 * bands.fluorescence.max()) ** 2))
    dim = under_another_light(bands, fluorescence_covariance=noise)
    with pytest.raises(
        FitError, match=r"at 470 nm .* the yield must be above 0, and its uncertainty above 0 and at most 0\.5"
    ):
        calibrate_paint(bands, 1, FEW, other_lights=[dim])


def test_reflectance_without_fluorescence_holds_the_true_one(paint):
    truth = bench_truth(simulated_rig("red", seed=3), Path()).reflectance
    inside = [
        r.low95 <= float(truth(f.center_nm)) <= r.high95
        for f, r in zip(paint.optics.filters, paint.reflectance, strict=True)
    ]
    assert inside == [True] * 8


def test_a_photon_of_the_lamp_excites_as_one_of_the_laser_does(bands):
    """Photons are counted: a paint that takes all up to where it emits, and reflects a tenth, has a reflectance of 0.1.

    The excitation is a sum over lines of 1 nm, not the code's integral: both differ by half a line at the ends.
    """
    optics, excitation_nm = bands.optics, np.arange(380.0, 781.0)
    emission_per_nm = 0.004 * np.exp(-(((WAVELENGTH_NM - 600) / 30) ** 2))
    absorbing_nm = excitation_nm[excitation_nm < 600 - 30 * np.sqrt(np.log(10))]
    photons = optics.lamp(absorbing_nm) * absorbing_nm  # of each line, in a common unit
    of_laser = optics.laser.wavelength_nm  # of as much energy as the lamp has in a line of 1
    emitted = emission_per_nm * photons.sum() / of_laser
    glow = []
    for band in optics.filters:
        passed = filter_transmission(band, WAVELENGTH_NM) * np.array([c(WAVELENGTH_NM) for c in optics.camera_response])
        glow.append(passed @ emitted / (passed @ optics.lamp(WAVELENGTH_NM)))
    lit = bands.model_copy(update={"reflectance": 0.1 + np.array(glow)})
    at_laser = Estimate(estimate=0.05, sd=0.001, low68=0.049, high68=0.051, low95=0.048, high95=0.052)
    found = reflectance(lit, emission_per_nm, at_laser)
    assert np.max(glow) > 0.2
    assert [r.estimate for r in found if r is not at_laser] == pytest.approx([0.1] * 7, abs=0.004)


def test_lost_filter_has_an_unknown_reflectance(bands):
    flags = (("saturated",) * 3,) + (("ok",) * 3,) * 7
    estimates = reflectance(
        bands.model_copy(update={"flags": flags}),
        np.exp(-(((WAVELENGTH_NM - 600) / 30) ** 2)),
        Estimate(estimate=0.05, sd=0.001, low68=0.049, high68=0.051, low95=0.048, high95=0.052),
    )
    assert estimates[0].low95 == 0.025
    assert estimates[0].high95 == 0.975
    assert estimates[1].estimate == 0.05


def test_held_share_of_a_curve_that_ends_early(optics):
    def from_658_nm(curve):
        kept = curve.wavelength_nm >= 658
        return curve.model_copy(update={"wavelength_nm": curve.wavelength_nm[kept], "values": curve.values[kept]})

    short = tuple(from_658_nm(c) for c in optics.camera_response)
    shares = extrapolated_shares(optics.model_copy(update={"camera_response": short}))
    assert shares[0].min() == pytest.approx(1.0, abs=1e-6)
    assert 0.1 < shares[7].min() < 0.5
    assert extrapolated_shares(optics).max() < 1e-6


@pytest.mark.parametrize("name", [name for name in FAMILIES if name != DEFAULT_FAMILY])
def test_fewer_draws_of_the_other_families_give_the_numbers_of_all_draws(bands, name):
    result = next(r for r in calibrate_paint(bands, 3).families if r.name == name)
    full = fit_emission(
        band_data(bands), FAMILIES[name], EmissionPrior(), PAINT_DISCREPANCY, FitSettings(), np.random.default_rng(4)
    )
    sample = full.sampling.sample
    # four standard errors: a false alarm in 2e4 families
    error = np.hypot(result.ln_evidence_sd, sample.ln_evidence_sd)
    assert result.ln_evidence == pytest.approx(sample.ln_evidence, abs=4 * error)
    # 500 draws of 750 effective ones are worth 300, 1000 of 1500 600; a median scatters by 1.25 sd / sqrt(n)
    apart = 4 * 1.25 * np.sqrt(1 / 300 + 1 / 600)
    for quantity, draws in (("mode_nm", full.quantities.mode_nm), ("fwhm_nm", full.quantities.fwhm_nm)):
        got = result.quantities[quantity]
        assert abs(got.estimate - np.median(draws)) < apart * got.sd
        assert (
            0.75 < got.sd / draws.std(ddof=1) < 1.33
        )  # four standard errors, 1 / sqrt(2 n) each, of tails twice normal
