"""The re-radiation matrix against measured matrices, its closure, and its conservation checks."""

import numpy as np
import pytest

from data_schemas import CurveError, Estimate, Reradiation, SpectralCurve
from data_schemas.storage import read_donaldson_matrix
from finray_calib.spectra import photon_yield, reradiation_matrix

LASER_NM = 450.0
# Rank-one share of the Stokes block (excitation 380-470 nm, emission from 490 nm) as read off with a bare SVD.
RANK_ONE_SHARE = {
    "hercules_orange_ink": 0.991,
    "textile_yellow": 0.998,
    "postit_yellow_3m": 0.993,
    "postit_pink_3m": 0.946,
}


def emitted_energy(matrix):
    """Return emitted over incident energy at each excitation: the integral of its column, dimensionless (E,)."""
    return np.asarray(np.trapezoid(matrix.radiance_factor_per_nm, matrix.emission_nm, axis=0))


def emitted_photons(matrix):
    """Return emitted over incident photons at each excitation: the integral of D out/in, dimensionless (E,)."""
    photons = matrix.radiance_factor_per_nm * matrix.emission_nm[:, None] / matrix.excitation_nm
    return np.asarray(np.trapezoid(photons, matrix.emission_nm, axis=0))


def rank_one_share(block):
    """Return the share of the squared entries of a block that its best rank-one matrix holds, s_1^2 / sum s_i^2."""
    singular = np.linalg.svd(block, compute_uv=False)
    return float(singular[0] ** 2 / (singular**2).sum())


def absorption(excitation_nm, draws):
    low95, high95 = np.quantile(draws, [0.025, 0.975], axis=0)
    return Reradiation(
        excitation_nm=excitation_nm,
        laser_nm=LASER_NM,
        absorption_rel=draws.mean(axis=0),
        low95=low95,
        high95=high95,
        absorption_rel_draws=draws,
        stokes_shift_nm=Estimate(estimate=35, sd=15, low68=20, high68=50, low95=6, high95=64),
        stokes_shift_draws_nm=np.full(len(draws), 35.0),
        measured_at_nm=(LASER_NM,),
        prior_driven=True,
        prior={},
        distinct_shapes=1,
        rejected_share=0.0,
        violating_share=0.0,
        statement="test",
    )


def flat_reflectance(value):
    return SpectralCurve(
        name="flat", wavelength_nm=np.array([300.0, 800.0]), values=np.array([value, value]), source="test"
    )


@pytest.fixture
def bell():
    """Emission of photon yield 0.5 under the laser, on a 1 nm grid."""
    grid = np.arange(380.0, 801.0)
    curve = np.exp(-0.5 * ((grid - 600) / 20) ** 2)
    return grid, 0.5 * curve / photon_yield(curve, grid, LASER_NM)


@pytest.mark.shared_data
@pytest.mark.parametrize("material", RANK_ONE_SHARE)
def test_measured_matrix_is_reproduced_from_one_emission_and_one_absorption(shared_data, material):
    measured = read_donaldson_matrix(shared_data / "spectra" / "materials" / f"{material}.csv")
    emission, excitation = measured.emission_nm, measured.excitation_nm
    at_laser = list(excitation).index(LASER_NM)
    block = np.ix_(emission >= 490, (excitation >= 380) & (excitation <= 470))
    truth = measured.radiance_factor_per_nm[block]
    share = rank_one_share(truth)
    assert share == pytest.approx(RANK_ONE_SHARE[material], abs=0.001)  # three digits are given

    yields = measured.radiance_factor_per_nm[emission >= 490].sum(axis=0)
    a = np.clip(yields / yields[at_laser] * LASER_NM / excitation, 0, None)
    column = measured.radiance_factor_per_nm[:, at_laser]
    ours = reradiation_matrix(column[None], emission, absorption(excitation, a[None]), measured.reflectance, material)
    assert ours.mean.radiance_factor_per_nm[:, at_laser] == pytest.approx(column, abs=1e-12)  # rows are emission
    error = np.linalg.norm(ours.mean.radiance_factor_per_nm[block] - truth) / np.linalg.norm(truth)
    best = np.sqrt(1 - share)
    # One emission and one row of yields, each with its noise of 5-15 %, stand for all: worse than the best rank one,
    # but not by more than the two errors of its size that they add.
    assert best <= error < 3 * best


def test_every_absorbed_photon_gives_the_quantum_yield_back(bell):
    grid, emission = bell
    a = np.array([[1.2, 1.0, 0.4]])
    excitation = np.array([405.0, LASER_NM, 500.0])
    ours = reradiation_matrix(emission[None], grid, absorption(excitation, a), flat_reflectance(0.1), "bell")
    # The bell ends 5 sd above these lights, so that cutting it below the excitation loses less than 1e-6 of it.
    assert emitted_photons(ours.mean) == pytest.approx(0.5 * a[0], rel=1e-6)
    assert emitted_energy(ours.mean) == pytest.approx(0.5 * a[0] * excitation / 600, rel=2e-3)  # <1/l> is not 1/<l>
    assert ours.warnings == ()
    # Equal draws have no spread but for the rounding of a difference of squares.
    assert (ours.sd_per_nm <= 1e-7 * emission.max()).all()


def test_nothing_is_emitted_at_or_below_the_excitation(bell):
    grid, emission = bell
    excitation = np.array([590.0, 600.0, 610.0])
    ours = reradiation_matrix(emission[None], grid, absorption(excitation, np.ones((1, 3))), flat_reflectance(0), "b")
    below = grid[:, None] <= excitation
    assert (ours.mean.radiance_factor_per_nm[below] == 0).all()
    assert (ours.mean.radiance_factor_per_nm[~below] > 0).all()


def test_moments_are_those_of_the_single_products(bell):
    grid, emission = bell
    rng = np.random.default_rng(3)
    scale = rng.uniform(0.5, 1.0, 50)
    a = np.stack([np.ones(50), 2 - scale], axis=1)  # absorption falls where emission rises: pairing matters
    excitation = np.array([LASER_NM, 500.0])
    draws = scale[:, None] * emission
    ours = reradiation_matrix(draws, grid, absorption(excitation, a), flat_reflectance(0.0), "bell")
    row = list(grid).index(600.0)
    single = draws[:, row] * a[:, 1] * 500 / LASER_NM
    assert ours.mean.radiance_factor_per_nm[row, 1] == pytest.approx(single.mean(), rel=1e-12)
    assert ours.sd_per_nm[row, 1] == pytest.approx(single.std(), rel=1e-6)  # a difference of squares loses digits


def test_too_much_energy_is_reported(bell):
    grid, emission = bell
    excitation = np.array([LASER_NM, 560.0])
    paint = absorption(excitation, np.array([[1.0, 1.9]]))
    ours = reradiation_matrix(emission[None], grid, paint, flat_reflectance(0.4), "bell")
    assert len(ours.warnings) == 1
    assert "1 of 2 excitation wavelengths" in ours.warnings[0]
    emitted = emitted_energy(ours.mean)[1]
    assert (
        f"(worst 560 nm: {emitted:.3f} emitted, 0.400 reflected, together {emitted + 0.4:.3f} +- 0.000)"
        in (ours.warnings[0])
    )


def test_too_many_photons_are_reported(bell):
    grid, emission = bell
    paint = absorption(np.array([405.0, LASER_NM]), np.ones((1, 2)))
    # Energy closes (0.5 * 450/600 + 0.55 < 1), photons do not: 0.5 emitted and 0.55 reflected of each.
    ours = reradiation_matrix(emission[None], grid, paint, flat_reflectance(0.55), "bell")
    assert len(ours.warnings) == 1
    assert "0.500 emitted, 0.550 reflected, together 1.050 +- 0.000" in ours.warnings[0]


def sized(bell, sd, seed=4):
    """Draws of the bell whose photon yield has mean 0.5 and exactly this standard deviation."""
    z = np.random.default_rng(seed).standard_normal(500)
    z = (z - z.mean()) / z.std()
    grid, emission = bell
    return grid, (1 + z * sd / 0.5)[:, None] * emission


@pytest.mark.parametrize(("sd", "surely"), [(0.024, True), (0.026, False)])
@pytest.mark.parametrize("uncertain", ["emission", "reflectance", "both"])
def test_warnings_need_two_standard_deviations(bell, sd, surely, uncertain):
    # 0.5 emitted and 0.55 reflected photons exceed 1 by 0.05: two standard deviations of 0.025
    share = {"emission": (1.0, 0.0), "reflectance": (0.0, 1.0), "both": (0.6, 0.8)}[uncertain]
    grid, draws = sized(bell, share[0] * sd)
    paint = absorption(np.array([405.0, LASER_NM]), np.ones((500, 2)))
    known = flat_reflectance(0.55)
    ours = reradiation_matrix(draws, grid, paint, known, "bell", flat_reflectance(share[1] * sd))
    assert len(ours.warnings) == int(surely)
    # the curve's own relative uncertainty says the same where no other is given
    scaled = known.model_copy(update={"uncertainty_rel": share[1] * sd / 0.55})
    assert len(reradiation_matrix(draws, grid, paint, scaled, "bell").warnings) == int(surely)


@pytest.mark.parametrize(("sd", "surely"), [(0.024, True), (0.026, False)])
def test_energy_warnings_need_two_standard_deviations(bell, sd, surely):
    grid, emission = bell
    excitation = np.array([405.0, 560.0])
    a = np.array([[0.2, 1.9]])
    paint = absorption(excitation, a)
    exact = reradiation_matrix(emission[None], grid, paint, flat_reflectance(0.0), "bell")
    reflected = flat_reflectance(1.05 - emitted_energy(exact.mean)[1])  # an excess of 0.05 at 560 nm
    ours = reradiation_matrix(emission[None], grid, paint, reflected, "bell", flat_reflectance(sd))
    energy = [w for w in ours.warnings if "energy" in w]
    assert len(energy) == int(surely)


def test_reflectance_held_beyond_its_range_is_half_unknown(bell):
    grid, emission = bell
    paint = absorption(np.array([LASER_NM, 560.0]), np.array([[0.1, 1.9]]))
    everywhere = flat_reflectance(0.4)
    ends_at_500 = everywhere.model_copy(update={"wavelength_nm": np.array([300.0, 500.0])})
    assert len(reradiation_matrix(emission[None], grid, paint, everywhere, "bell").warnings) == 1
    assert reradiation_matrix(emission[None], grid, paint, ends_at_500, "bell").warnings == ()


def test_draws_must_be_paired(bell):
    grid, emission = bell
    paint = absorption(np.array([405.0, LASER_NM]), np.ones((2, 2)))
    with pytest.raises(CurveError, match="pair emission and absorption draws one to one"):
        reradiation_matrix(emission[None], grid, paint, flat_reflectance(0.5), "bell")
