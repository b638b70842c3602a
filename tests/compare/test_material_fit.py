"""Moduli by force curves: hidden ones in closed form, what a curve cannot tell, and intervals that hold the truth."""

import dataclasses

import numpy as np
import pytest

from data_schemas import CompareError, FingerDesign, ForceSlope, PressSensitivities, SimulateError
from finray_calib.force import ForceModel, MeasuredForce, fit_material
from sim.experiments import block_force_model
from sim.mechanics import GelBlock, Ogden, compress_block
from sim.mechanics import _loads as loads_module
from sim.mechanics._increments import load_increments
from tests.compare.bench_blocks import force_n, measured

C10_MPA, BULK = 0.17, 400.0
PLATES = ("lubricated", "confined")


def block(plates):
    return GelBlock(20.0, 20.0, 10.0, plates)


@pytest.fixture(scope="module")
def models():
    return {plates: block_force_model(block(plates), 2.73) for plates in PLATES}


def fitted(models, *plates, seed=3, **truth):
    rng = np.random.default_rng(seed)
    curves = [measured(rng, truth.get("c10", C10_MPA), truth.get("bulk", BULK), one) for one in plates]
    return fit_material(curves, [models[one] for one in plates], rng)


@pytest.mark.parametrize("plates", PLATES)
@pytest.mark.parametrize("bulk_over_shear", [20.0, 1000.0])
def test_the_elements_press_a_block_as_the_closed_form_does(plates, bulk_over_shear):
    pushes, mu, step = np.array([1.0, 3.0]), 0.34, 1e-3
    found = compress_block(block(plates), Ogden((mu,), (2.0,), bulk_over_shear), pushes)
    # a difference over 1e-5 of a minimum that is known to 1e-12
    assert found.force_n == pytest.approx(force_n(pushes, mu, mu * bulk_over_shear, plates), rel=2e-6)
    low, high = (force_n(pushes, mu, mu * bulk_over_shear * np.exp(s), plates) for s in (-step, step))
    # the closed form's own rounding, 1e-6 of the force over twice the step
    assert found.ln_force_per_ln_bulk == pytest.approx(np.log(high / low) / (2.0 * step), abs=2e-4)


def test_between_the_tabulated_moduli_the_force_is_that_of_the_elements(models):
    push = np.array([[0.4, 1.3, 2.5]])
    for plates in PLATES:
        for bulk in (15.0, 60.0, 5000.0):
            mu = 2.0 * C10_MPA
            told = models[plates].force_n(np.log([[C10_MPA, bulk]]), push)[0]
            # cubics between five pushes and seven K/mu
            assert told == pytest.approx(force_n(push[0], mu, mu * bulk, plates), rel=3e-3)


def test_a_free_block_measures_the_shear_modulus_and_says_that_it_does_not_tell_the_bulk_modulus(models):
    fit = fitted(models, "lubricated")
    gel, bulk = fit.moduli
    assert gel.verdict == "measured"
    assert gel.posterior.low95 < C10_MPA < gel.posterior.high95
    assert bulk.verdict == "not measured (prior)"
    # the prior, even in the logarithm from 10 to 10,000, comes back
    assert bulk.left_of_prior_rel > 0.8
    assert bulk.posterior.low95 < 20.0
    assert bulk.posterior.high95 > 5000.0
    assert "bulk_over_shear" not in fit.design_toml
    assert any("nearly the same for every K/mu" in note for note in fit.notes)
    assert fit.trusted


def test_a_free_and_a_confined_block_measure_both(models):
    fit = fitted(models, *PLATES)
    gel, bulk = fit.moduli
    assert gel.verdict == bulk.verdict == "measured"
    assert gel.posterior.low95 < C10_MPA < gel.posterior.high95
    assert bulk.posterior.low95 < BULK < bulk.posterior.high95
    assert "bulk_over_shear" in fit.design_toml


def test_a_confined_block_alone_tells_the_product(models):
    fit = fitted(models, "confined")
    assert all(modulus.verdict == "constrained in part" for modulus in fit.moduli)
    whole = 2.0 * C10_MPA * BULK
    assert fit.bulk_modulus_mpa.low95 < whole < fit.bulk_modulus_mpa.high95
    assert fit.bulk_modulus_mpa.sd < 0.05 * whole


def test_intervals_hold_hidden_moduli(models):
    rng, held = np.random.default_rng(11), 0
    for _ in range(24):
        c10, bulk = np.exp(rng.uniform(np.log([0.03, 20.0]), np.log([1.0, 5000.0])))
        fit = fit_material([measured(rng, c10, bulk, "lubricated")], [models["lubricated"]], rng)
        held += fit.moduli[0].posterior.low95 < c10 < fit.moduli[0].posterior.high95
    # of 24 at 95 %, fewer than 19 are held in one of 800 runs
    assert held >= 19


def proportional_model(scale_u_rel=0.02):
    """A specimen whose force is 20 N/mm times C10 in MPa, and does not depend on K/mu."""
    depth = np.linspace(0.25, 2.0, 5)
    ln_force = np.log(10.0 * depth)
    return ForceModel(
        "block", depth, np.array([0.5]), ln_force[None], np.ones((1, 5)), np.array([10.0, 10_000.0]),
        np.stack([ln_force, ln_force]), np.zeros((2, 5)), BULK, scale_u_rel=scale_u_rel,
    )  # fmt: skip


def proportional_curve(rng, u_n, stated=True, scale=1.0):
    at = np.linspace(0.05, 2.0, 60)
    force = scale * 20.0 * C10_MPA * at + u_n * rng.standard_normal(60)
    return MeasuredForce("c.csv", at, force, np.full(60, u_n) if stated else None)


def test_the_band_of_a_point_that_is_measured_again_holds_its_stated_uncertainty():
    for seed in range(3):
        rng, u_n = np.random.default_rng(seed), 0.1
        fit = fit_material([proportional_curve(rng, u_n)], [proportional_model()], rng).curves[0]
        again = 20.0 * C10_MPA * fit.displacement_mm + u_n * rng.standard_normal((200, 60))
        held = ((again > fit.low95_n) & (again < fit.high95_n)).mean()
        # 95 %, and a little more where the fit leaves room for noise beside what is stated
        assert 0.92 < held < 0.99


def test_the_band_is_wide_where_the_displacement_is_stated_to_be_unsure():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        curve = proportional_curve(rng, 0.005)
        u_mm = np.where(np.arange(60) % 2, 0.03, 0.0)  # 0.1 N by the slope
        slope = 20.0 * C10_MPA
        unsure = dataclasses.replace(
            curve, force_n=curve.force_n + slope * u_mm * rng.standard_normal(60), u_displacement_mm=u_mm
        )
        fit = fit_material([unsure], [proportional_model()], rng).curves[0]
        width = (fit.high95_n - fit.low95_n) / 3.92
        assert width[1::2] == pytest.approx(np.full(30, slope * 0.03), rel=0.1)
        assert (width[::2] < 0.05).all()


def test_repeated_presses_of_one_specimen_share_the_error_of_its_computed_force():
    rng = np.random.default_rng(2)
    curves = [proportional_curve(rng, 0.005, stated=False) for _ in range(3)]
    model, other = proportional_model(), dataclasses.replace(proportional_model(), name="another block")
    one, three = (fit_material(c, [model] * len(c), rng).moduli[0].posterior for c in (curves[:1], curves))
    # C10 is known to no less than the 2 % of the scale, however many presses of the block there are
    assert one.sd / one.estimate > 0.018
    assert three.sd / three.estimate > 0.018
    two_blocks = fit_material(curves[:2], [model, other], rng).moduli[0].posterior
    # of two blocks it is the mean of two errors: 2 % over the root of 2, and the first touches besides
    assert two_blocks.sd / two_blocks.estimate < 0.018


def curve_of_a_finger(gel, skeleton, depth):
    return 4.0 * (gel / 0.13) ** 0.3 * skeleton**0.7 * depth


def press(gel, depth):
    slopes = {"mechanics.gel.c10_mpa": 0.3, "mechanics.gel.bulk_over_shear": 0.0, "mechanics.skeleton.mu_mpa": 0.7}
    return PressSensitivities(
        preset="coarse",
        depth_mm=depth,
        force_n=curve_of_a_finger(gel, 1.0, depth) * 1.1,
        varied=(),
        slopes=tuple(ForceSlope(field=f, ln_force_per_ln_number=np.full(len(depth), s)) for f, s in slopes.items()),
    )


def test_a_finger_alone_cannot_tell_its_gel_from_its_skeleton():
    depth = np.linspace(0.25, 2.0, 4)
    design = FingerDesign()
    gels = [(c10, press(c10, depth)) for c10 in (0.065, 0.13, 0.26)]
    model = ForceModel.of_finger("finger", design, gels, [(b, press(0.13, depth)) for b in (10.0, 10_000.0)], 0.1)
    at = np.linspace(0.1, 2.0, 20)
    skeleton = sum(design.mechanics.skeleton.mu_mpa)
    moduli = np.log([[0.2, 500.0, 1.3 * skeleton]])
    # power laws are met everywhere, and the mesh's excess of a tenth is taken off
    assert model.force_n(moduli, at[None])[0] == pytest.approx(curve_of_a_finger(0.2, 1.3, at), rel=1e-9)
    rng = np.random.default_rng(5)
    force = curve_of_a_finger(0.2, 1.0, at) * (1.0 + 0.003 * rng.standard_normal(20))
    fit = fit_material([MeasuredForce("finger.csv", at, force)], [model], rng)
    gel, bulk, fin = fit.moduli
    # the skeleton's modulus, known to a fifth, is worth 0.7/0.3 of that in the gel's, and the scale is open besides
    assert gel.verdict == "constrained in part"
    assert gel.posterior.low95 < 0.2 < gel.posterior.high95
    assert bulk.verdict == fin.verdict == "not measured (prior)"
    assert fit.design_toml == ""


def test_bad_curves_and_blocks_are_refused(models):
    rng = np.random.default_rng(7)
    good = measured(rng, C10_MPA, BULK, "lubricated")
    with pytest.raises(
        CompareError, match="1 curves and 2 specimens; give at least one curve, and one specimen for each curve"
    ):
        fit_material([good], [models["lubricated"]] * 2, rng)
    far = MeasuredForce("far.csv", good.displacement_mm + 10.0, good.force_n)
    with pytest.raises(
        CompareError, match=r"far\.csv: the displacements begin at 10\.\d+ mm .* count displacements from near"
    ):
        fit_material([far], [models["lubricated"]], rng)
    with pytest.raises(
        SimulateError, match="pushes of a bonded block 10 mm high must increase, be above 0 and at most"
    ):
        compress_block(block("bonded"), Ogden((0.3,), (2.0,)), [3.0])
    with pytest.raises(
        SimulateError, match=r"height_mm must be from 0\.5 to 300 mm for an edge of a block, got 0\.1 mm"
    ):
        GelBlock(20.0, 20.0, 0.1, "bonded")
    without = press(0.13, np.linspace(0.25, 2.0, 4)).model_copy(update={"slopes": ()})
    with pytest.raises(
        CompareError,
        match=r"by mechanics\.gel\.c10_mpa is not available for this press, because the finger is about to snap, or",
    ):
        ForceModel.of_finger("f", FingerDesign(), [(0.13, without)], [(20.0, without)], 0.1)


def test_forces_of_another_unit_are_not_explained(models):
    rng = np.random.default_rng(7)
    good = measured(rng, C10_MPA, BULK, "lubricated")
    wrong = MeasuredForce("mN.csv", good.displacement_mm, 1e6 * good.force_n)
    with pytest.raises(CompareError, match=r"mN\.csv: no modulus explains this curve; the nearest fit differs by"):
        fit_material([wrong], [models["lubricated"]], rng)


def test_a_block_has_a_force_for_each_push_also_where_increments_are_shortened(monkeypatch):
    def shortened(assembly, solver, load, stops):
        return load_increments(assembly, solver, load, sorted({*stops, *(0.9 * stop for stop in stops)}))

    given = block("confined"), Ogden((0.3,), (2.0,)), [0.5, 1.0, 2.0]
    usual = compress_block(*given)
    monkeypatch.setattr(loads_module, "load_increments", shortened)
    found = compress_block(*given)
    assert found.push_mm.tolist() == [0.5, 1.0, 2.0]
    # the equilibrium's tolerance is 1e-6 of the forces
    assert found.force_n == pytest.approx(usual.force_n, rel=1e-5)


def test_a_bonded_block_is_stiffer_the_thinner_it_is():
    forces = [
        compress_block(GelBlock(20.0, 20.0, height, "bonded"), Ogden((0.34,), (2.0,), 1000.0), [0.02 * height], cells=4)
        for height in (40.0, 10.0, 4.0)
    ]
    apparent_mpa = [one.force_n[0] / 400.0 / 0.02 for one in forces]
    # E (1 + 2 S^2) with S = side / (4 height), good to some tenths for squares (P. B. Lindley, 1979)
    shape = 20.0 / (4.0 * np.array([40.0, 10.0, 4.0]))
    assert apparent_mpa == pytest.approx(3.0 * 0.34 * (1.0 + 2.0 * shape**2), rel=0.25)
