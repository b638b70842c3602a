"""One finger evaluated: the error that a sweep finds, nothing traced twice, equal digits for an equal seed."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FingerDesign, LightPanel, SimulateError, SpectralCurve
from data_schemas._design_parts import TactileCamera
from sim.experiments import EvaluationSettings, FingerEvaluator, PaintDraws, PaintedFinger, with_changed_values
from sim.experiments._design_sensitivities import changed_design
from sim.experiments._finger_evaluation import errors_at
from sim.experiments._light_angle import angle_objectives
from sim.optics import paint_bands

pytestmark = pytest.mark.renderer

DESIGN = FingerDesign(camera=TactileCamera(width_px=128, height_px=96))
SETTINGS = EvaluationSettings(rays=512, repeats=2, draws=2, seed=5)
NM = np.arange(380.0, 781.0)


def response():
    """Three smooth channels."""
    return tuple(
        SpectralCurve(
            name=name, wavelength_nm=NM, values=np.exp(-0.5 * ((NM - centre) / 40.0) ** 2) + 0.02, source="made up"
        )
        for name, centre in zip("RGB", (610.0, 530.0, 460.0), strict=True)
    )


def without_spread(paint):
    return PaintDraws(paint, paint.emission_per_nm[None])


def scaled(paint, factor):
    return without_spread(replace(paint, emission_per_nm=factor * paint.emission_per_nm))


def test_the_error_is_that_of_a_sweep_over_one_angle(llvm, paints):
    """Against the tracer that knows the paints instead of chains: same paths, same noise, same exposure."""
    evaluator = FingerEvaluator(response(), llvm, SETTINGS)
    found = evaluator.evaluate(DESIGN, {colour: without_spread(paint) for colour, paint in paints.items()})
    finger = PaintedFinger(DESIGN, paints, response(), llvm)
    matrix = finger.camera_matrix(paint_bands(paints["red"], paints["green"], DESIGN.light))
    objectives, limits = angle_objectives(
        finger, np.array([matrix] * SETTINGS.draws), [DESIGN.light.angle_deg], SETTINGS.seed, SETTINGS.rays
    )
    by_name = {one.name: one for one in objectives}
    # chains end after three conversions, presses are a mean over places, and other signals draw other noise
    error = by_name["held-out normal error"]
    assert found.error_by_place_deg.mean(axis=1) == pytest.approx(error.place_values[0].mean(axis=1), rel=0.03)
    assert found.evenness_rel == pytest.approx(by_name["uniformity"].values.mean(), rel=0.02)
    assert found.separation_deg == pytest.approx(by_name["colour separation"].values.mean(), rel=0.01)
    # a median over 30 points of differences of two noisy facets each
    assert found.one_pixel_sigma_deg == pytest.approx(by_name["normal from one pixel"].values.mean(), rel=0.1)
    assert found.in_the_way == limits.in_the_way[0]


def test_nothing_is_traced_twice_and_equal_questions_have_equal_digits(llvm, paints):
    given = {colour: without_spread(paint) for colour, paint in paints.items()}
    evaluator = FingerEvaluator(response(), llvm, SETTINGS)
    first = evaluator.evaluate(DESIGN, given)
    dull = evaluator.evaluate(DESIGN, given | {"red": scaled(paints["red"], 0.3)})
    deeper = evaluator.evaluate(changed_design(DESIGN, "indenter.depth_mm", 2.5), given)
    assert evaluator.traced == 1
    assert dull.normal_error_deg > first.normal_error_deg
    assert deeper.normal_error_deg != first.normal_error_deg  # more of the coat is tilted: another exposure
    turned = evaluator.evaluate(changed_design(DESIGN, "light.angle_deg", 80.0), given)
    assert evaluator.traced == 2
    assert turned.normal_error_deg > first.normal_error_deg
    again = FingerEvaluator(response(), llvm, SETTINGS).evaluate(DESIGN, given)
    assert again.normal_error_deg == pytest.approx(first.normal_error_deg, rel=1e-4)
    assert evaluator.evaluate(DESIGN, given).normal_error_deg == first.normal_error_deg


def test_at_equal_exposure_less_light_is_more_noise(llvm, paints):
    given = {colour: without_spread(paint) for colour, paint in paints.items()}
    evaluator = FingerEvaluator(response(), llvm, SETTINGS)
    first = evaluator.evaluate(DESIGN, given)
    dark = changed_design(DESIGN, "light.power_rel", 0.2)
    own = evaluator.evaluate(dark, given)
    same = evaluator.evaluate(dark, given, first.electrons_per_radiance)
    assert own.normal_error_deg == pytest.approx(first.normal_error_deg, rel=0.01)
    assert own.brightness_rel == pytest.approx(0.2 * first.brightness_rel, rel=0.01)
    assert own.electrons_per_radiance == pytest.approx(5.0 * first.electrons_per_radiance, rel=0.01)
    assert same.normal_error_deg > 1.05 * first.normal_error_deg


def test_a_second_panel_through_the_mirror_cannot_be_mounted(llvm, paints):
    """Also by an evaluator that has seen the same first panel alone."""
    given = {colour: without_spread(paint) for colour, paint in paints.items()}
    evaluator = FingerEvaluator(response(), llvm, replace(SETTINGS, rays=64, repeats=1))
    assert evaluator.evaluate(DESIGN, given).in_the_way == ""
    second = DESIGN.light.model_copy(update={"angle_deg": 150.0, "position_mm": (0.0, -10.0, 50.0)})
    assert evaluator.evaluate(DESIGN.model_copy(update={"second_light": second}), given).in_the_way == "mirror"


def test_what_cannot_be_evaluated_is_refused(llvm, paints):
    with pytest.raises(SimulateError, match="at least one ray"):
        FingerEvaluator(response(), llvm, EvaluationSettings(rays=0))
    off = FingerEvaluator(response(), llvm, replace(SETTINGS, contact_places_mm=(35.0, 80.0)))
    given = {colour: without_spread(paint) for colour, paint in paints.items()}
    with pytest.raises(SimulateError, match="must lie on the pad, 0 to 70 mm"):
        off.evaluate(DESIGN, given)
    with pytest.raises(SimulateError, match="--paint green=FILE"):
        FingerEvaluator(response(), llvm, SETTINGS).evaluate(DESIGN, {"red": given["red"]})


def test_errors_between_rows_are_linear():
    points = np.array([[x, z] for z in (10.0, 20.0, 40.0) for x in (-1.0, 0.0, 1.0)])
    errors = np.repeat([1.0, 3.0, 7.0], 3)[None] + np.tile([-0.5, 0.0, 0.5], 3)
    places = np.array([5.0, 10.0, 15.0, 20.0, 35.0, 60.0])
    grid = np.array([[x, z] for z in np.linspace(10.0, 60.0, 6) for x in (-1.0, 1.0)])
    middle = errors_at(grid, np.repeat(np.arange(6.0), 2)[None], np.array([0.0, 25.0, 99.0]))
    assert middle.tolist() == [[0.0, 1.5, 5.0]]
    assert errors_at(points[:3], errors[:, :3], places)[0].tolist() == [1.0] * 6


def test_light_adds_and_other_powers_trace_nothing(llvm, paints):
    """Two panels one by one, mixed, against both at once and against a finger of other powers."""
    given = {colour: without_spread(paint) for colour, paint in paints.items()}
    second = LightPanel(position_mm=(0.0, -4.0, 73.0), angle_deg=150.0)
    design = DESIGN.model_copy(update={"second_light": second})
    evaluator = FingerEvaluator(response(), llvm, replace(SETTINGS, rays=128, repeats=3, draws=3))
    lit = evaluator.lit_apart(design, given)
    both = evaluator.evaluate(design, given)
    traced = evaluator.traced
    mixed = lit.evaluated(np.ones(2))
    # the same paths: what one panel is worth does not depend on the other's power
    assert mixed.brightness_rel == pytest.approx(both.brightness_rel, rel=1e-3)
    assert mixed.evenness_rel == pytest.approx(both.evenness_rel, rel=0.02)
    assert mixed.normal_error_deg == pytest.approx(both.normal_error_deg, rel=0.01)
    other = with_changed_values(design, {"light.power_rel": 2.0, "second_light.power_rel": 0.5})
    assert lit.evaluated(np.array([2.0, 0.5])).brightness_rel == pytest.approx(
        evaluator.evaluate(other, given).brightness_rel, rel=1e-3
    )
    assert evaluator.traced == traced + 1
    basis = lit.basis()
    assert basis.level(basis.mean).sum() == pytest.approx(1.0)
    assert basis.mean.shape == (2, 2 * len(lit.points_mm))
    # the panel at the tip lights the tip: mean place of the light of each
    along = lit.points_mm[:, 1]
    base, tip = (np.average(along, weights=one[: len(along)]) for one in basis.mean)
    assert base < tip
