"""A paint behind filters that are not what their catalogue says: right when their curves are given, wrong without."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas.curves import SpectralCurve
from data_schemas.radiometry import BandSignals, Optics
from data_schemas.rig import BandPassFilter, FilterWheelSettings
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.discrepancy import NO_DISCREPANCY
from finray_calib.fit.emission import fit_emission
from finray_calib.fit.paint_calibration import band_data
from finray_calib.fit.prior import EmissionPrior
from tests.fit.synthetic_bands import QUICK, ZHENG
from rigs.presets import PAPER_FILTERS_NM, simulated_rig
from rigs.simulated.bench import Bench, bench_truth

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

def test_show(fitted):
    given, d = fitted
    fw = np.exp(d[:,1])
    print(given, d[:,0].mean(), d[:,0].std(), TRUTH.mode_nm, fw.mean(), fw.std(), TRUTH.fwhm_nm)
