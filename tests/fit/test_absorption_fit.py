"""The absorption fit: coverage under its own model, on measured materials, and honesty with one laser."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from data_schemas import FitError, SpectralCurve
from data_schemas.storage import read_donaldson_matrix
from finray_calib.fit import AbsorptionPrior, ExcitationYield, fit_absorption
from finray_calib.fit._absorption import EXCITATION_NM, LightYields, draw_candidates
from finray_calib.spectra import absorptance, photon_yield, smooth_covariance

LASER_NM = 450.0
GRID_NM = np.arange(380.0, 781.0)
PRIOR = AbsorptionPrior()
LIGHTS_NM = (450.0, 405.0, 470.0, 500.0)
MATERIALS = ("hercules_orange_ink", "textile_yellow", "postit_yellow_3m", "postit_pink_3m")


def bells(mode_nm, peak_per_nm=1e-4):
    """Emission draws that carry so little light that no bound acts."""
    return peak_per_nm * np.exp(-0.5 * ((GRID_NM - np.asarray(mode_nm)[:, None]) / 20) ** 2)


NO_BOUND_PER_NM = 1e-12
"""So little light that the conservation of energy bounds no absorption."""


def lines(lights_nm, yields, sd_rel=0.03):
    return [ExcitationYield(float(n), float(y), sd_rel) for n, y in zip(lights_nm, yields, strict=True)]


def fit(emission, yields, seed, reflectance=None):
    return fit_absorption(emission, GRID_NM, LASER_NM, yields, PRIOR, np.random.default_rng(seed), reflectance)


def prior_truth(rng):
    """Draw a paint from the prior: emission maximum, Stokes shift, a(l)/a(laser) on the grid and at the lights."""
    mode_nm = rng.choice(np.arange(520.0, 621.0))
    shift, shape = PRIOR.draw(1, rng)
    points = np.concatenate([EXCITATION_NM, LIGHTS_NM])
    covariance = smooth_covariance(points, PRIOR.deviation_rel, PRIOR.deviation_length_nm)
    deviation = np.linalg.cholesky(covariance + 1e-10 * np.eye(points.size)) @ rng.standard_normal(points.size)
    a = np.maximum(absorptance(points, mode_nm - shift[0], *shape[:, 0]), 1e-9) * np.exp(deviation)
    a /= a[EXCITATION_NM.size]  # the first light is the laser
    return mode_nm, shift[0], a[: EXCITATION_NM.size], a[EXCITATION_NM.size :]


REPLICATES = 200
# How many of them a right 95 % interval covers: each of the five counts strays outside with a chance of 1 in 1000.
FEWEST, MOST = binom.interval(0.999, REPLICATES, 0.95)


def test_intervals_cover_truths_drawn_from_the_prior():
    rng = np.random.default_rng(20)
    at_nm = (340.0, 420.0, 485.0, 540.0)
    inside = np.zeros(len(at_nm) + 1, dtype=int)
    for seed in range(REPLICATES):
        mode_nm, shift_nm, a, at_lights = prior_truth(rng)
        # The truth is one of the draws of an emission posterior 3 nm wide.
        centre_nm = mode_nm - np.round(3 * rng.standard_normal())
        draws = bells(centre_nm + np.round(3 * rng.standard_normal(200)), NO_BOUND_PER_NM)
        noise = np.exp(0.03 * rng.standard_normal(len(LIGHTS_NM)))
        result = fit(draws, lines(LIGHTS_NM, at_lights * np.array(LIGHTS_NM) * noise), seed)
        for i, nm in enumerate(at_nm):
            j = int(np.searchsorted(EXCITATION_NM, nm))
            inside[i] += result.low95[j] <= a[j] <= result.high95[j]
        inside[-1] += result.stokes_shift_nm.low95 <= shift_nm <= result.stokes_shift_nm.high95
    assert (inside >= FEWEST).all(), inside
    assert (inside <= MOST).all(), inside


# Noise of the measured matrices: 0.001 per entry (anti-Stokes side) and 4 % between neighbouring columns, which
# belongs to the "truth" and not to our intervals.
ENTRY_NOISE, COLUMN_NOISE_REL = 0.001, 0.04


@cache
def material(folder, name):
    """Return emission draws, measured a(l)/a(laser) with its noise, yields at the lights, and reflectance."""
    measured = read_donaldson_matrix(folder / "spectra" / "materials" / f"{name}.csv")
    emission, excitation = measured.emission_nm, measured.excitation_nm
    at_laser = list(excitation).index(LASER_NM)
    column = np.where(emission < 480, 0.0, measured.radiance_factor_per_nm[:, at_laser])
    peak_nm = emission[column.argmax()]
    strip = (emission >= peak_nm + 10) & (emission <= peak_nm + 40)
    signal = 10 * measured.radiance_factor_per_nm[strip].sum(axis=0)
    noise = ENTRY_NOISE * np.sqrt(strip.sum())
    curve = np.clip(np.interp(GRID_NM, emission, column), 0.0, None)
    return np.tile(curve, (400, 1)), peak_nm, excitation, signal, noise, measured.reflectance


def covered(folder, name, lights_nm, seed=1):
    """Return which measured a(l)/a(laser) above a twentieth of the maximum lie inside the predictive band."""
    emission, peak_nm, excitation, signal, noise, reflectance = material(folder, name)
    seen = np.interp(lights_nm, excitation, signal)
    yields = [
        ExcitationYield(nm, float(s), float(np.hypot(0.03, noise / s))) for nm, s in zip(lights_nm, seen, strict=True)
    ]
    result = fit(emission, yields, seed, reflectance)
    at_laser = float(np.interp(LASER_NM, excitation, signal))
    truth = signal / at_laser * LASER_NM / excitation
    rng = np.random.default_rng(seed)
    draws = np.array([np.interp(excitation, EXCITATION_NM, draw) for draw in result.absorption_rel_draws])
    draws = draws * (1 + COLUMN_NOISE_REL * rng.standard_normal(draws.shape))
    draws = draws + noise / at_laser * LASER_NM / excitation * rng.standard_normal(draws.shape)
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    judged = (excitation >= 380) & (excitation <= peak_nm) & (truth > 0.05 * truth.max()) & (excitation != LASER_NM)
    return ((truth >= low) & (truth <= high))[judged], result


@pytest.mark.shared_data
@pytest.mark.parametrize("lights_nm", [LIGHTS_NM[:3], LIGHTS_NM], ids=["3 lights", "4 lights"])
def test_measured_absorption_is_covered_with_several_lights(shared_data, lights_nm):
    inside = np.concatenate([covered(shared_data, name, lights_nm)[0] for name in MATERIALS])
    assert inside.size > 60
    # Some 70 values with correlation of 20 nm are about 35 independent ones: nominal 0.95, three sd of 0.037 below.
    assert inside.mean() >= 0.84


@pytest.mark.shared_data
@pytest.mark.parametrize("name", MATERIALS)
def test_further_lights_narrow_the_band_and_one_laser_stays_wide(shared_data, name):
    _, one = covered(shared_data, name, (LASER_NM,))
    _, several = covered(shared_data, name, LIGHTS_NM)
    between = (EXCITATION_NM >= 400) & (EXCITATION_NM <= 500)
    width_one, width_several = ((r.high95 - r.low95)[between].mean() for r in (one, several))
    assert width_several < 0.6 * width_one
    assert one.prior_driven
    assert several.prior_driven == (several.stokes_shift_nm.sd > 15)
    # The reflectance may narrow the shift, one laser alone cannot.
    assert one.stokes_shift_nm.sd > 8
    assert one.violating_share < 0.02


@pytest.mark.shared_data
def test_one_laser_is_honest_about_measured_materials(shared_data):
    inside = np.concatenate([covered(shared_data, name, (LASER_NM,))[0] for name in MATERIALS])
    # The prior is as wide as four materials differ: 0.95 less three sd, four materials counting as some 20 values.
    assert inside.mean() >= 0.80


def test_with_one_laser_the_posterior_is_the_prior():
    result = fit(bells(np.full(4000, 560.0), NO_BOUND_PER_NM), lines((LASER_NM,), (1.0,)), 3)
    assert result.prior_driven
    assert "comes from the prior: one laser at 450 nm fixes absorption at 450 nm only" in result.statement
    believed = PRIOR.draw(100_000, np.random.default_rng(1))[0]
    # 4000 draws, and the 20000 shapes they come from: a median is known to 0.5 nm, a share of 0.19 to 0.007
    assert result.stokes_shift_nm.estimate == pytest.approx(np.median(believed), abs=1.5)
    share = (result.stokes_shift_draws_nm > 80).mean()
    assert share == pytest.approx((believed > 80).mean(), abs=0.025)
    at_laser = list(EXCITATION_NM).index(LASER_NM)
    # The jitter that keeps the covariance positive is 1e-5 in ln a.
    assert result.absorption_rel_draws[:, at_laser] == pytest.approx(1.0, abs=1e-4)
    assert result.rejected_share == 0


def test_draws_are_paired_with_their_emission():
    mode_nm = np.repeat([540.0, 600.0], 400)
    result = fit(bells(mode_nm), lines((LASER_NM,), (1.0,)), 4)
    absorbed_at_600 = result.absorption_rel_draws[:, list(EXCITATION_NM).index(600.0)]
    # A paint that emits at 540 nm hardly absorbs at 600 nm; the prior puts the other's edge some 20 nm below 600.
    assert np.median(absorbed_at_600[:400]) < 0.01 < np.median(absorbed_at_600[400:])


def test_prior_of_the_stokes_shift_holds_what_fluorophores_and_the_paper_have():
    """Quantiles of the draws: 95 % of 142 fluorophores lie within 2.6 to 240 nm, the paper states 20 and 100 nm."""
    low, high = np.quantile(PRIOR.draw(100_000, np.random.default_rng(1))[0], [0.025, 0.975])
    assert low < 8
    assert 200 < high < 300
    density = PRIOR.stokes_density(np.array([-1.0, 0.0, 20.0, 100.0]))
    assert (density[:2] == 0).all()
    assert (density[2:] > 0.01 * density.max()).all()
    drawn, _ = np.histogram(PRIOR.draw(200_000, np.random.default_rng(2))[0], bins=[10, 20, 40, 100, 200])
    grid = np.linspace(0.01, 1000, 200_000)
    below = np.cumsum(PRIOR.stokes_density(grid))
    expected = np.diff(np.interp([10, 20, 40, 100, 200], grid, below / below[-1]))
    assert drawn / 200_000 == pytest.approx(expected, abs=0.005)  # four sd of 0.0011


def test_absorption_never_exceeds_what_is_not_reflected():
    """A yield of 0.8 beside a reflectance of 0.15: the paint can absorb 1.06 times as much as at the laser."""
    emission = bells(np.full(200, 560.0))
    emission *= 0.8 / np.trapezoid(emission * GRID_NM / LASER_NM, GRID_NM, axis=1)[:, None]
    result = fit(emission, lines((LASER_NM,), (1.0,)), 5, flat(0.15))
    assert result.absorption_rel_draws.max() <= 0.85 / 0.8 + 1e-6  # the emission's area by another rule
    assert result.violating_share == 0
    bright = fit(emission / 0.8 * 0.95, lines((LASER_NM,), (1.0,)), 5, flat(0.15))
    assert bright.violating_share == 1


def test_a_light_at_the_edge_fixes_the_stokes_shift():
    rng = np.random.default_rng(8)
    mode_nm, _, _, _ = prior_truth(rng)
    nm = np.array([450.0, 405.0, 470.0, 500.0, mode_nm - 30, mode_nm - 15, mode_nm])
    a = absorptance(nm, mode_nm - 25, 1.0, 20.0, 60.0, 0.1)
    result = fit(bells(np.full(400, mode_nm)), lines(nm, a * nm / a[0]), 8)
    assert result.stokes_shift_nm.sd < 10
    assert not result.prior_driven
    assert result.stokes_shift_nm.low95 < 25 < result.stokes_shift_nm.high95


def flat(value):
    return SpectralCurve(name="r", wavelength_nm=np.array([300.0, 800.0]), values=np.full(2, value), source="test")


def test_no_paint_sends_out_more_photons_than_it_absorbs():
    emission = bells(np.full(400, 560.0))
    emission *= 0.4 / photon_yield(emission[:1], GRID_NM, LASER_NM)
    free = fit(emission, lines((LASER_NM,), (1.0,)), 5)
    bound = fit(emission, lines((LASER_NM,), (1.0,)), 5, flat(0.5))
    ceiling = 0.5 / 0.4
    assert (free.absorption_rel_draws > ceiling).any(axis=1).mean() > 0.2
    kept = ~(bound.absorption_rel_draws > ceiling).any(axis=1)
    assert 1 - kept.mean() == pytest.approx(bound.violating_share)
    assert bound.statement.endswith("the reflectance only bounds the absorption from above")
    assert bound.violating_share < 0.02 < bound.rejected_share


def test_an_emission_beyond_the_absorbed_light_is_reported():
    emission = bells(np.full(200, 560.0))
    emission *= 0.6 / photon_yield(emission[:1], GRID_NM, LASER_NM)
    assert fit(emission, lines((LASER_NM,), (1.0,)), 6, flat(0.5)).violating_share == 1.0


def test_yields_against_the_prior_are_reported():
    result = fit(bells(np.full(200, 560.0)), lines((450, 400, 440, 460, 500), (1, 9, 0.1, 9, 0.1), 0.01), 7)
    assert result.distinct_shapes < 50
    assert "the yields contradict the prior" in result.statement


def test_yields_that_no_shape_of_an_emission_maximum_gives_are_refused():
    """Only one shape is likely, and it absorbs some 35 nm below 600 nm: an emission at 500 nm would gain energy."""
    nobody = SimpleNamespace(log_likelihood=lambda residual: np.where(np.arange(len(residual)) == 0, 0.0, -np.inf))
    lights = LightYields(LASER_NM, np.array([470.0]), np.zeros(1), np.array([0.03, 0.03]))
    modes_nm, counts = np.array([600.0, 500.0]), np.array([999, 1])
    with pytest.raises(
        FitError, match=r"none of 20000 shapes .* emission maximum at 500 nm; check the sessions of the other lights"
    ):
        draw_candidates(modes_nm, counts, lights, nobody, PRIOR, np.random.default_rng(1))


def test_four_hundred_draws_take_a_third_of_a_second(benchmark_seconds):
    emission = bells(np.full(400, 560.0))
    yields = lines(LIGHTS_NM, (1.0, 0.7, 1.1, 1.2))
    assert benchmark_seconds(lambda: fit(emission, yields, 9)) < 0.3


@pytest.fixture
def benchmark_seconds():
    """Return a function -> least processor time of three runs, s; other processes do not count."""
    import time

    def seconds(run):
        times = []
        for _ in range(3):
            start = time.process_time()
            run()
            times.append(time.process_time() - start)
        return min(times)

    return seconds


@pytest.mark.parametrize(
    ("yields", "message"),
    [
        ([], "first yield must be the yield under the laser at 450 nm, but it is missing"),
        (lines((405.0,), (1.0,)), "it is 405 nm"),
        (lines((450.0, 405.0), (1.0, 0.0)), "at 405 nm the yield is 0 with relative uncertainty 0.03"),
        (lines((450.0, 405.0), (1.0, 1.0), 0.6), "measure this light longer"),
        (lines((450.0, 405.0, 405.0), (1.0, 1.0, 1.0)), "two yields have the same excitation"),
    ],
)
def test_unusable_yields_are_refused(yields, message):
    with pytest.raises(FitError, match=message):
        fit(bells(np.full(200, 560.0)), yields, 1)


@pytest.mark.parametrize(
    ("emission", "message"),
    [
        (np.ones((200, 3)), "emission draws must be finite and of shape"),
        (np.where(GRID_NM < LASER_NM, 1.0, 0.0)[None].repeat(200, 0), "is 0 at all .* above the laser's 450 nm"),
    ],
)
def test_unusable_emission_is_refused(emission, message):
    with pytest.raises(FitError, match=message):
        fit(emission, lines((LASER_NM,), (1.0,)), 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ln_stokes_sd": 0.0}, "ln_stokes_sd is 0, but must be above 0"),
        ({"blue_floor_high_rel": 0.01}, "blue floor runs from 0.02 to 0.01"),
    ],
)
def test_impossible_priors_are_refused(change, message):
    with pytest.raises(FitError, match=message):
        AbsorptionPrior(**change)
