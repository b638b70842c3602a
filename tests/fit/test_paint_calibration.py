"""From band signals to the paint record: reflectance without fluorescence, held curves, total chi-square."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas.estimate import Estimate
from data_schemas.radiometry import BandSignals
from data_schemas.standard_curves import assumed_camera_response
from finray_calib.fit.paint_calibration import calibrate_paint
from finray_calib.fit.reflectance import reflectance
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, held_shares
from rigs.presets import simulated_rig
from rigs.simulated.bench import Bench, bench_truth

SHARES = np.array([0.01, 0.09, 0.9])


@pytest.fixture(scope="module")
def bands(optics) -> BandSignals:
    """Noise-free signals of the red paint on the simulated bench."""
    rig = simulated_rig("red", seed=3)
    bench = Bench(rig, Path(), assumed_camera_response())
    slots = [f.slot for f in rig.filter_wheel.filters]

    def signal(what: str, light: str) -> np.ndarray:
        radiance = (
            rig.white_reference.reflectance * bench.lights[light]
            if what == "white"
            else bench.sample_radiance(bench.lights[light])
        )
        return np.array([bench.band_electrons_per_s(radiance, slot) for slot in slots])

    white = signal("white", "lamp")
    level = signal("white", "laser")[1] / white[1] @ SHARES
    y, rho = signal("sample", "laser") / white / level, 0.98 * signal("sample", "lamp") / white
    return BandSignals(
        paint_name="red",
        optics=optics,
        fluorescence=y,
        fluorescence_covariance=np.diag((0.002 * y.ravel()) ** 2),
        reflectance=rho,
        reflectance_covariance=np.diag((0.002 * rho.ravel()) ** 2),
        channel_weights=SHARES,
        flags=(("ok", "ok", "ok"),) * 8,
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=1000,
    )


@pytest.fixture(scope="module")
def paint(bands):
    return calibrate_paint(bands, 1, settings=SamplerSettings(most_steps=2000))


def test_bench_and_nominal_fitter_agree_on_mode_width_and_yield(paint):
    truth = bench_truth(simulated_rig("red", seed=3), Path())
    for name in ("mode_nm", "fwhm_nm"):
        value = paint.parameters[name]
        assert value.low95 < getattr(truth, name) < value.high95
    assert paint.energy_yield.low95 < truth.energy_yield < paint.energy_yield.high95
    assert paint.warnings == ()


def test_reflectance_without_fluorescence_holds_the_true_one(paint):
    truth = bench_truth(simulated_rig("red", seed=3), Path()).reflectance
    inside = [
        r.low95 <= float(truth(f.center_nm)) <= r.high95
        for f, r in zip(paint.optics.filters, paint.reflectance, strict=True)
    ]
    assert inside == [True] * 8


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
    shares = held_shares(optics.model_copy(update={"camera_response": short}))
    assert shares[0].min() == pytest.approx(1.0, abs=1e-6)
    assert 0.1 < shares[7].min() < 0.5
    assert held_shares(optics).max() < 1e-6
