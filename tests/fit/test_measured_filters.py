"""A paint behind filters that are not what their catalogue says: right when their curves are given, wrong without."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from data_schemas import BandPassFilter, BandSignals, FilterWheelSettings, Optics, SpectralCurve, half_maximum_nm
from data_schemas.storage import assumed_camera_response, halogen_lamp
from finray_calib.fit import NO_DISCREPANCY, EmissionPrior, band_data, fit_emission
from finray_calib.spectra import WAVELENGTH_NM, band_tolerances, rig_emission_weights
from finray_calib.spectra._band_weights import measured_transmission
from rigs import simulated_rig
from rigs._rig_files import PAPER_FILTERS_NM
from rigs.simulated import Bench, bench_truth
from tests.fit.synthetic_bands import QUICK, ZHENG

SHARES = np.array([0.01, 0.09, 0.9])
RIG = simulated_rig("red", seed=3)
TRUTH = bench_truth(RIG, Path())


def skewed_flat_top(center_nm: float) -> SpectralCurve:
    """Return a pass band with a steep blue edge, a sloping top and a long red tail, 14 nm wide.

    Its half maxima lie 3 nm further to the red than the catalogue's centre says.
    """
    x_nm = np.arange(center_nm - 25.0, center_nm + 40.1, 0.25)
    rise = 1 / (1 + np.exp(-(x_nm - center_nm + 4.0) / 0.3))
    fall = 1 / (1 + np.exp((x_nm - center_nm - 10.0) / 2.0))
    top = 1 + 0.02 * (x_nm - center_nm)
    return SpectralCurve(name="measured", wavelength_nm=x_nm, values=0.6 * rise * fall * top / 1.2, source="m.csv")


def bench_optics(given: bool) -> tuple[Bench, Optics]:
    """Return the bench with skewed filters, and what its owner knows: their curves, or the catalogue only."""
    laser_filter = PAPER_FILTERS_NM.index(450)  # nominal, so that both owners know the laser's level alike
    curves = {str(c): skewed_flat_top(c) for i, c in enumerate(PAPER_FILTERS_NM) if i != laser_filter}

    def band(slot: int, name: str, curve: str | None) -> BandPassFilter:
        return BandPassFilter(slot=slot, name=name, center_nm=float(name), fwhm_nm=14.0, curve=curve)

    def wheel(known: bool) -> FilterWheelSettings:
        named = enumerate(map(str, PAPER_FILTERS_NM), 1)
        return FilterWheelSettings(
            filters=tuple(band(slot, name, "m.csv" if known and name in curves else None) for slot, name in named)
        )

    response = assumed_camera_response()
    bench = Bench(RIG.model_copy(update={"filter_wheel": wheel(True)}), Path(), response, curves)
    optics = Optics(
        filters=wheel(given).filters,
        excitation_filter="450",
        laser=RIG.laser,
        lamp=halogen_lamp(),
        white_reference=RIG.white_reference,
        camera_response=response,
        filter_curves=curves if given else {},
    )
    return bench, optics


def noise_free_bands(given: bool) -> BandSignals:
    """Return signals of the bench's paint, with what its owner knows of the filters."""
    bench, optics = bench_optics(given)
    lamp, laser, reflectance = bench.lights["lamp"], bench.lights["laser"], RIG.white_reference.reflectance

    def signal(radiance: np.ndarray) -> np.ndarray:
        return np.array([bench.band_electrons_per_s(radiance, band.slot) for band in optics.filters])

    white = signal(reflectance * lamp)
    level = signal(reflectance * laser)[1] / white[1] @ SHARES
    y = signal(bench.sample_radiance(laser)) / white / level
    rho = reflectance * signal(bench.sample_radiance(lamp)) / white
    return BandSignals(
        paint_name="red",
        optics=optics,
        fluorescence=y,
        fluorescence_covariance=np.diag((0.002 * y.ravel()) ** 2),
        reflectance=rho,
        reflectance_covariance=np.diag((0.002 * rho.ravel()) ** 2),
        channel_weights=SHARES,
        flags=(("ok", "ok", "ok"),) * len(y),
        saturated_fraction=np.zeros(y.shape),
        region_pixels=1000,
    )


@pytest.fixture(scope="module", params=[True, False], ids=["curves given", "catalogue only"])
def fitted(request: pytest.FixtureRequest) -> tuple[bool, np.ndarray]:
    """Whether the curves were given, and draws of (mode_nm, ln fwhm_nm); the hidden paint is of the fitted family."""
    data = band_data(noise_free_bands(request.param))
    posterior = fit_emission(data, ZHENG, EmissionPrior(), NO_DISCREPANCY, QUICK, np.random.default_rng(1))
    return request.param, posterior.draws[:, :2]


def test_mode_and_width_are_right_only_when_the_curves_are_given(fitted):
    given, draws = fitted
    mode_nm, fwhm_nm = draws[:, 0].mean(), np.exp(draws[:, 1]).mean()
    # the bench's filters lie up to 0.2 nm beside their curves; half a nanometre is half a posterior sd
    assert (abs(mode_nm - TRUTH.mode_nm) < 0.5) == given
    if given:
        assert abs(fwhm_nm - TRUTH.fwhm_nm) < 0.5
    else:
        # all filters but the laser's pass light 3 nm redder than the catalogue says
        assert -6.0 < mode_nm - TRUTH.mode_nm < -2.0


def test_transmission_on_the_grid_integrates_the_curve_and_holds_the_floor_beside_it():
    curve = SpectralCurve(
        name="steep",
        wavelength_nm=np.array([590.0, 595.33, 595.37, 604.81, 604.84, 610.0]),
        values=np.array([0.0, 0.0, 0.9, 0.7, 1e-3, 1e-3]),
        source="steep.csv",
    )
    passed = measured_transmission(curve, blocking_od=5.0)
    # linear emission through a band steeper than the grid: exact but for a tenth of a step at the edges
    emission = 1.0 + 0.02 * (WAVELENGTH_NM - 600.0)
    exact = quad(lambda x: (1 + 0.02 * (x - 600)) * float(curve(x)), 590, 610, points=curve.wavelength_nm[1:-1])[0]
    assert passed @ emission == pytest.approx(exact, rel=0.01)
    np.testing.assert_allclose(passed[abs(WAVELENGTH_NM - 600.0) > 11.0], 1e-5)
    assert passed[WAVELENGTH_NM == 592.0] == pytest.approx(1e-5)  # measured as 0
    assert passed[WAVELENGTH_NM == 607.0] == pytest.approx(1e-3)


@pytest.mark.parametrize(("kind", "field"), [(0, "center_uncertainty_nm"), (1, "fwhm_uncertainty_nm")])
def test_tolerance_of_a_measured_filter_shifts_and_stretches_its_curve(kind, field):
    _, optics = bench_optics(True)
    shift = band_tolerances(optics, SHARES).emission_shift[kind]
    weights = rig_emission_weights(optics, SHARES)
    rows = weights.band_index == list(PAPER_FILTERS_NM).index(600)
    x = weights.wavelength_nm
    sd_nm = getattr(optics.filters[5], field)
    assert sd_nm == 0.15
    curve, low_nm, high_nm = optics.filter_curves["600"], *half_maximum_nm(optics.filter_curves["600"])
    middle_nm = 0.5 * (low_nm + high_nm)
    by = 1.0 if kind == 0 else (curve.wavelength_nm - middle_nm) / (high_nm - low_nm)
    moved_nm = curve.wavelength_nm + sd_nm * by
    moved = optics.filter_curves | {"600": curve.model_copy(update={"wavelength_nm": moved_nm})}
    after = rig_emission_weights(optics.model_copy(update={"filter_curves": moved}), SHARES)
    np.testing.assert_allclose(shift[rows], (after.emission - weights.emission)[rows], atol=1e-9)
    centroid = (after.emission[rows] @ x / after.emission[rows].sum(axis=1)) - (
        weights.emission[rows] @ x / weights.emission[rows].sum(axis=1)
    )
    # red and green (blue sees the leak): a shift moves the centroid by itself, a stretch about the half maxima hardly
    assert (abs(centroid - (sd_nm if kind == 0 else 0.0))[:2] < 0.03).all()
