"""Paint maps: against scipy pixel by pixel, coverage of the intervals, uniformity with known truth, bad input."""

from argparse import Namespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom

from data_schemas import BandSignals, FitError, PaintMap, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.cli._fit import run_map
from finray_calib.fit import FitOptions, PixelSpread, calibrate_paint, map_paint, map_pixels
from finray_calib.fit._pixel_maps import RegionFit, pixel_problem, region_fit
from finray_calib.reports import paint_map_figure, spot_sentence, spread_sentence
from finray_calib.reports._fit_figures import thinned
from finray_calib.spectra import family_named, rig_emission_weights
from finray_calib.spectra.family_kernels import CURVE_CONSTANTS, LANES, SHAPES, curve_constants, curve_slopes, logarithm
from tests.fit.pixel_scenes import CHANNEL_WEIGHTS, SPREAD, bands_of, center_of, drawn_truths, scene, whole_rule

FAMILIES = ("zheng2014", "log_normal_wavenumber")
LARGEST_MODE_DIFFERENCE_NM = 0.02
LARGEST_DIFFERENCE_SD = 0.05
"""What the stopping rule, first-order leaks, fast functions and float32 may leave of a pixel's standard deviation."""


def changed(record, **fields):
    return type(record).model_validate({**dict(record), **fields})


@pytest.fixture(scope="module", params=FAMILIES)
def drawn(request, optics):
    """4096 pixels whose truth comes from the prior, and their map."""
    rng = np.random.default_rng(3)
    made = scene(request.param, optics, drawn_truths(request.param, 4096, rng), rng)
    return made, map_pixels(made.pixels, made.region, SPREAD)


@pytest.mark.parametrize("name", FAMILIES)
def test_slopes_of_the_curve(name, optics):
    center = center_of(name)
    region = scene(name, optics, np.tile(center, (64, 1)), np.random.default_rng(0)).region
    problem, _ = pixel_problem(region, rig_emission_weights(optics, CHANNEL_WEIGHTS), SPREAD)
    family, k = family_named(name), np.empty(CURVE_CONSTANTS * LANES)
    wavelengths = np.array([520.0, 590.0, 600.0, 690.0])
    block = np.tile(center[:SHAPES, None], LANES)
    block[3, :3] = owns = (center[3], -0.4, 0.0)
    curve_constants(problem.family, problem.table, block, k)
    lanes = np.empty((len(wavelengths), SHAPES, LANES))
    for wavelength, curve in zip(wavelengths, lanes, strict=True):
        curve_slopes(problem.family, k, wavelength, curve.reshape(-1))
    for lane, own in enumerate(owns):
        theta, out = np.append(center[:3], own), lanes[:, :, lane].T
        # 1e-4 of asymmetry stand for none, which the far tails notice; the arctangent is exact to 2e-8
        np.testing.assert_allclose(
            out[0], family.curves(theta[None], wavelengths)[0], rtol=1e-6 if own else 5e-3, atol=1e-12
        )
        for row, j in ((1, 0), (2, 1), (3, 3)):
            step = 1e-4 * np.eye(4)[j]
            high, low = family.curves(np.array([theta + step, theta - step]), wavelengths)
            # central differences over 2e-4, and kinks in the second slope of the interpolated table
            np.testing.assert_allclose(out[row], (high - low) / 2e-4, rtol=2e-3, atol=1e-3 * np.exp(theta[2]))


def test_logarithm_keeps_its_promise():
    x = np.geomspace(0.02, 20.0, 2001)
    np.testing.assert_allclose([logarithm(v) for v in x], np.log(x), rtol=0, atol=1e-7)


def scipy_fit(made, i, bands_at):
    """scipy's fit of one pixel with the map's prior: maximum, covariance and chi-square of the bands."""
    y, sd = (a[:, *np.unravel_index(i, a.shape[1:])] for a in (made.pixels.fluorescence, made.pixels.fluorescence_sd))
    prior_sd = np.append(SPREAD.of(made.region.family), 0.1)

    def residual(theta):
        return np.concatenate([(bands_at(theta) - y) / sd, (theta - made.region.theta) / prior_sd])

    best = least_squares(residual, made.region.theta, x_scale=prior_sd, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return best.x, np.linalg.inv(best.jac.T @ best.jac), (best.fun[: y.size] ** 2).sum()


def map_at(found, i):
    values = found.mode_nm, np.log(found.fwhm_nm), np.log(found.peak_per_nm), found.shape_value
    return np.array([v.flat[i] for v in (*values, found.reflectance_at_laser)])


def test_agrees_with_scipy(drawn):
    """The same bands and prior: only the fitter differs."""
    made, found = drawn
    problem, _ = pixel_problem(made.region, rig_emission_weights(made.optics, CHANNEL_WEIGHTS), SPREAD)
    nodes, weights = whole_rule(problem)
    channel, curves = made.pixels.channel.ravel(), made.region.family.curves
    for i in np.random.default_rng(8).choice(channel.size, 40, replace=False):
        c = channel[i]

        def bands_at(theta, c=c):
            return weights[c] @ curves(theta[None, :4], nodes)[0] + theta[4] * problem.laser[c]

        best, covariance, chi_square = scipy_fit(made, i, bands_at)
        sd = np.sqrt(np.diag(covariance))
        assert abs(found.mode_nm.flat[i] - best[0]) < LARGEST_MODE_DIFFERENCE_NM
        assert (np.abs(map_at(found, i) - best) < LARGEST_DIFFERENCE_SD * sd).all()
        assert found.mode_sd_nm.flat[i] == pytest.approx(sd[0], rel=0.01)
        assert found.chi_square.flat[i] == pytest.approx(chi_square, abs=0.05)


def test_agrees_with_scipy_on_whole_curves(drawn):
    """Few nodes and a coarse grid of the leak are enough: a tenth of the pixel's own uncertainty at most."""
    made, found = drawn
    channel = made.pixels.channel.ravel()
    off = []
    for i in np.random.default_rng(9).choice(channel.size, 20, replace=False):
        best, covariance, _ = scipy_fit(made, i, lambda t, i=i: made.predicted(t[None], channel[i : i + 1])[0])
        off.append(np.abs(map_at(found, i) - best) / np.sqrt(np.diag(covariance)))
    assert np.max(off) < 0.1
    assert np.median(off) < 0.005


def test_intervals_cover_the_truth(drawn):
    made, found = drawn
    grid = np.arange(450.0, 780.5, 1.0)
    true_yield = np.trapezoid(made.region.family.curves(made.truth[:, :4], grid), grid, axis=1)
    shape = found.mode_nm.shape
    low, high = binom.ppf([0.0005, 0.9995], found.mode_nm.size, 0.95) / found.mode_nm.size
    # Laplace's approximation may be off by a point where a blue pixel sees little of a red paint
    low, high = low - 0.01, high + 0.01
    for name, value, sd, truth in (
        ("mode", found.mode_nm, found.mode_sd_nm, made.truth[:, 0]),
        ("FWHM", np.log(found.fwhm_nm), found.fwhm_sd_nm / found.fwhm_nm, made.truth[:, 1]),
        ("peak", np.log(found.peak_per_nm), found.peak_sd_per_nm / found.peak_per_nm, made.truth[:, 2]),
        ("own", found.shape_value, found.shape_sd, made.truth[:, 3]),
        ("reflectance", found.reflectance_at_laser, found.reflectance_at_laser_sd, made.truth[:, 4]),
        ("yield", np.log(found.energy_yield), found.energy_yield_sd / found.energy_yield, np.log(true_yield)),
    ):
        covered = (np.abs(value - truth.reshape(shape)) < 1.96 * sd).mean()
        assert low < covered < high, f"{name}: {covered:.3f}"
    # blue pixels of a red paint see mostly leaked light; some steps then creep along a valley, and are flagged
    assert found.unconverged_pixels == (~found.converged).sum() <= 0.005 * found.mode_nm.size


def test_common_errors_of_the_bands_leave_no_trace(optics):
    """Calibration errors of region and pixels alike cancel: the map is that of the true bands."""
    rng = np.random.default_rng(1)
    made = scene("log_normal_wavenumber", optics, drawn_truths("log_normal_wavenumber", 256, rng), rng)
    error = 1 + 0.05 * rng.standard_normal((8, 3))
    per_pixel = error[:, made.pixels.channel].astype(np.float32)
    bent = changed(
        made.pixels,
        fluorescence=made.pixels.fluorescence * per_pixel,
        fluorescence_sd=made.pixels.fluorescence_sd * per_pixel,
    )
    region = RegionFit(
        made.region.family,
        made.region.theta,
        made.region.theta_sd,
        np.ones(8),
        made.region.signal * error,
        made.region.quantities,
    )
    plain, found = (map_pixels(p, r, SPREAD) for p, r in ((made.pixels, made.region), (bent, region)))
    np.testing.assert_allclose(found.mode_nm, plain.mode_nm, atol=0.005)  # nm; float32 signals
    np.testing.assert_allclose(found.band_factor / plain.band_factor, error, rtol=1e-9)


def uneven(optics, peak_sd, mode_sd_nm, noise_rel, rng):
    """Pixels whose height and mode differ by known amounts."""
    truth = np.tile(center_of("log_normal_wavenumber"), (10_000, 1))
    truth[:, 2] += peak_sd * rng.standard_normal(len(truth))
    truth[:, 0] += mode_sd_nm * rng.standard_normal(len(truth))
    made = scene("log_normal_wavenumber", optics, truth, rng, noise_rel=noise_rel, rows=100)
    return map_pixels(made.pixels, made.region, SPREAD)


def test_spread_without_noise(optics):
    found = uneven(optics, 0.08, 1.0, 0.02, np.random.default_rng(5))
    peak, mode, total = (found.uniformity[name] for name in ("peak_per_nm", "mode_nm", "energy_yield"))
    # 10 000 pixels: the robust spread has 1.2 % of error of its own; 6 % leaves room for the unshrinking
    assert total.sd / total.estimate == pytest.approx(0.08, rel=0.06)
    assert total.resolved
    assert peak.estimate == pytest.approx(0.004, rel=0.01)
    assert 0.5 < mode.sd < 1.5
    assert mode.noise_share > total.noise_share


def test_an_even_paint_is_called_even(optics):
    found = uneven(optics, 0.0, 0.0, 0.03, np.random.default_rng(6))
    spread = found.uniformity["energy_yield"]
    assert not spread.resolved
    assert spread.sd < spread.high
    assert found.worst_spots == ()
    assert "no differences between single pixels beyond their noise" in spread_sentence(found, "energy_yield")


def test_pixels_too_noisy_to_tell(optics):
    found = uneven(optics, 0.05, 0.0, 20.0, np.random.default_rng(6))
    assert found.uniformity["mode_nm"].pixels == 0
    assert "too noisy to show" in spread_sentence(found, "mode_nm")
    assert np.nanmedian(np.abs(found.mode_nm - 597.0)) < 1.0  # shrunk to the region


def test_a_thin_spot_is_found_where_it_is(optics):
    rng = np.random.default_rng(7)
    truth = np.tile(center_of("zheng2014"), (96, 96, 1))
    truth[40:48, 64:72, 2] += np.log(0.7)
    made = scene("zheng2014", optics, truth.reshape(-1, 5), rng, rows=96)
    found = map_pixels(made.pixels, made.region, SPREAD)
    worst = found.worst_spots[0]
    assert (worst.row_px, worst.column_px) == (100 + 44, 200 + 68)
    assert worst.deviation_rel == pytest.approx(-0.3, abs=4 * worst.deviation_sd_rel + 0.01)  # 1 %: pull of the prior
    assert "row 144, column 268: yield -3" in spot_sentence(worst)


def test_unusable_pixels_are_nan_and_counted(optics):
    rng = np.random.default_rng(2)
    made = scene("zheng2014", optics, drawn_truths("zheng2014", 1024, rng), rng)
    signals, usable = np.array(made.pixels.fluorescence), np.array(made.pixels.usable)
    signals[:5, 0, 0] = np.nan
    signals[:4, 0, 1] = np.nan
    usable[3, 3] = False
    found = map_pixels(changed(made.pixels, fluorescence=signals, usable=usable), made.region, SPREAD)
    assert np.isnan(found.mode_nm[0, 0])
    assert np.isnan(found.chi_square[3, 3])
    assert np.isfinite(found.mode_nm[0, 1])
    assert (found.bands_used[0, 0], found.bands_used[0, 1]) == (3, 4)
    assert (found.unusable_pixels, found.fitted_pixels) == (2, 1022)
    with pytest.raises(FitError, match=r"none of 1024 pixels has 4 usable bands; check in the masks"):
        map_pixels(changed(made.pixels, usable=np.zeros_like(usable)), made.region, SPREAD)


@pytest.fixture(scope="module")
def calibrated(optics):
    """A fit of the region by the paper's family, for pixels of the same session."""
    y = bands_of("zheng2014", optics, center_of("zheng2014")[None])[0]
    bands = BandSignals(
        paint_name="orange",
        optics=optics,
        fluorescence=y,
        fluorescence_covariance=np.diag((0.003 * y.ravel()) ** 2 + 1e-10),
        reflectance=np.full((8, 3), 0.2),
        reflectance_covariance=np.eye(24) * 1e-6,
        channel_weights=np.array(CHANNEL_WEIGHTS),
        flags=(("ok",) * 3,) * 8,
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=1024,
    )
    return calibrate_paint(bands, 1, FitOptions(family="zheng2014"))


def test_map_from_the_records(calibrated, optics):
    rng = np.random.default_rng(4)
    made = scene("zheng2014", optics, np.tile(center_of("zheng2014"), (1024, 1)), rng)
    found = map_paint(made.pixels, calibrated)
    assert isinstance(found, PaintMap)
    spread = found.uniformity
    for name in ("mode_nm", "peak_per_nm", "energy_yield"):  # the map's level is that of the region
        typical = spread[name]
        noise = 0.1 * typical.high + 1e-3 * typical.estimate
        assert typical.estimate == pytest.approx(calibrated.parameters[name].estimate, abs=4 * noise)
    svg = paint_map_figure(found)
    assert svg.startswith("<?xml")
    assert svg == paint_map_figure(found)


def test_map_from_files(calibrated, optics, tmp_path, capsys):
    rng = np.random.default_rng(4)
    made = scene("zheng2014", optics, np.tile(center_of("zheng2014"), (1024, 1)), rng)
    files = {"bands": [tmp_path / "orange.pixels.json"], "paint": tmp_path / "orange.paint.json"}
    write_record(made.pixels, files["bands"][0], provenance("pytest"))
    write_record(calibrated, files["paint"], provenance("pytest"))
    out = tmp_path / "orange.map.json"
    run_map(Namespace(**files, out=out))
    found = read_record(out, PaintMap)
    np.testing.assert_array_equal(found.mode_nm, map_paint(made.pixels, calibrated).mode_nm)
    assert (tmp_path / "orange.map.svg").read_text(encoding="utf-8") == paint_map_figure(found)
    said = capsys.readouterr().out
    assert "'orange' in 1024 pixels (zheng2014)" in said
    assert "energy yield: median" in said
    with pytest.raises(
        FitError, match=r"orange\.pixels\.json: --map needs --paint, the fit of the region.*add --paint"
    ):
        run_map(Namespace(bands=files["bands"], paint=None, out=None))


def test_what_does_not_belong_together_is_refused(calibrated, optics):
    rng = np.random.default_rng(4)
    pixels = scene("zheng2014", optics, np.tile(center_of("zheng2014"), (64, 1)), rng).pixels
    with pytest.raises(
        FitError, match="the pixels are of paint 'green', but the fit is of paint 'orange'; give the fit of the same"
    ):
        map_paint(changed(pixels, paint_name="green"), calibrated)
    fewer = changed(optics, filters=optics.filters[:7])
    cut = {name: getattr(pixels, name)[:7] for name in ("fluorescence", "fluorescence_sd", "common_sd_rel")}
    with pytest.raises(FitError, match=r"pixels \(7 filters\) differ from those of the fit \(8 filters\)"):
        map_paint(changed(pixels, optics=fewer, **cut), calibrated)
    with pytest.raises(FitError, match=r"skew_t has 5 parameters.*choose zheng2014 or log_normal_wavenumber"):
        region_fit(calibrated.model_copy(update={"family": "skew_t"}))
    with pytest.raises(FitError, match="every width must be positive"):
        PixelSpread(mode_sd_nm=0.0)


def test_a_channel_that_is_no_colour_is_refused(drawn):
    made, _ = drawn
    channel = made.pixels.channel.copy()
    channel[0, 0] = 7  # compiled functions take it as an index
    with pytest.raises(ValueError, match=r"channel contains 7, but only 0 \(red\), 1 \(green\) and 2 \(blue\)"):
        changed(made.pixels, channel=channel)


def test_sizes_that_disagree_are_refused(drawn):
    _, found = drawn
    with pytest.raises(ValueError, match=r"area is 31 x 128 px, but the maps have 32 x 128"):
        changed(found, area=found.area.model_copy(update={"height_px": 31}))
    with pytest.raises(ValueError, match="'mode_sd_nm' has 31 entries along 'row', but 'mode_nm' has 32"):
        changed(found, mode_sd_nm=found.mode_sd_nm[:31])


def test_thinned_map_keeps_medians():
    values = np.arange(482.0 * 6).reshape(6, 482)
    values[0, :4] = np.nan
    out = thinned(values)
    assert out.shape == (2, 121)
    assert out[0, 0] == np.median(values[1:4, :4])
    assert out[1, 0] == np.median(values[4:, :4])  # a cut square: what is there
