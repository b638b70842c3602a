"""Validation uncertainties, budget and the sweep's objective, against numbers by hand."""

import numpy as np
import pytest
from scipy.stats import norm

from data_schemas import CompareError, KnownInputs
from finray_calib.compare import Region
from finray_calib.compare._comparison import prepare_comparison
from finray_calib.compare._image_noise import CaptureNoise
from finray_calib.compare._input_draws import DRIFT, PIXELS, WALLS, Inputs
from finray_calib.compare._photometric_error import (
    ALONE_DRAWS,
    STORED_DRAWS,
    VALIDATION_DRAWS,
    BrightnessDraws,
    brightness_draws,
    captured_share,
    objective_error,
    propagated_draws,
    ring_of,
    uncertainty_budget,
    validation_cells,
)
from tests.compare.layered_scenes import captured_of, layers_of
from tests.compare.twins import twin

SHAPE = (30, 45)
EVERYWHERE = np.ones(SHAPE, bool)
REGIONS = [Region("all", EVERYWHERE, 2.0)]
PIXELS_OF_PART = 10 * 15
CAPTURE = twin(np.random.default_rng(0)).capture
# four standard errors of a standard deviation
VALIDATION_REL, BUDGET_REL = (4.0 / np.sqrt(2.0 * n) for n in (VALIDATION_DRAWS, ALONE_DRAWS))
SD = 0.05


def response(stored=20_000):
    """One factor on each channel, log-normal with median 1."""
    factors = np.exp(SD * np.random.default_rng(9).standard_normal((stored, 3, 1))) * np.ones(3)
    return KnownInputs(
        names=("camera response",), keys=("response",), evaluations=("B",), sources=("stated",),
        factors=factors[None].astype(np.float32),
    )  # fmt: skip


def flat_comparison(press_dn=50.0, noise=None, render_sd=0.0, drift=None, walls=None, pose_sd_mm=None):
    """A render of 60 where the capture has `press_dn`, both 100 without contact; the pose moves the press 8 per mm."""
    level = np.ones((*SHAPE, 3))
    halves = render_sd * np.random.default_rng(1).standard_normal((2, *level.shape))
    layers = layers_of(
        60.0 * level + halves[0], 100.0 * level, np.eye(3), noise=(halves[1], 0.0 * level),
        pose={"depth_mm": -8.0 * level}, inputs=response(), names=("led>red", "led>green", "led"),
    )  # fmt: skip
    camera = noise or CaptureNoise(np.zeros(3), np.zeros(3))
    images = captured_of(press_dn * level, 100.0 * level, 100.0 * level, camera)
    inputs = Inputs(layers, pose_sd_mm or {}, drift, walls)
    return prepare_comparison(layers, images, REGIONS, inputs, True, True), inputs


def cells(**options):
    comparison, inputs = flat_comparison(**options)
    return validation_cells(comparison, inputs, np.random.default_rng(2))


def test_error_and_input_uncertainty_by_hand():
    """E = 60 / 50 - 1. Factors of sd s, and the exposure: r / mean(r, g, b) has the sd s sqrt(4 + 1 + 1) / 3."""
    found = cells()
    assert len(found) == 27
    assert {(c.row, c.column, c.channel) for c in found} == {
        (row, column, channel) for row in range(3) for column in range(3) for channel in ("red", "green", "blue")
    }
    for cell in found:
        assert cell.pixels == PIXELS_OF_PART
        assert cell.error_rel == pytest.approx(0.2, rel=1e-6)
        assert cell.u_data_rel == 0.0
        assert cell.u_numerical_rel < 1e-12
        # of second order in s: a quarter of a per cent
        assert cell.u_input_rel == pytest.approx(1.2 * SD * np.sqrt(6.0) / 3.0, rel=VALIDATION_REL + 0.003)
        assert cell.u_validation_rel == pytest.approx(cell.u_input_rel, rel=1e-9)
        assert not cell.within
        # the whole distribution lies above the capture
        assert cell.area_too_bright_rel == pytest.approx(0.2, rel=0.05)
        assert cell.area_too_dark_rel < 1e-4


def test_an_error_within_twice_its_uncertainty_is_within():
    """E = 0.05, u = 0.043: within; the area metric of a normal distribution off by 1.17 u."""
    for cell in cells(press_dn=60.0 / 1.05):
        assert cell.error_rel == pytest.approx(0.05, rel=1e-6)
        assert cell.within
        u = cell.u_input_rel
        z = 0.05 / u
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        # E max(x, 0) of x ~ N(0.05, u) is u (density + z Phi): 0.0525 for z = 1.17, Phi 0.879
        assert cell.area_too_bright_rel == pytest.approx(u * (density + z * norm.cdf(z)), rel=0.06)
        assert cell.area_too_bright_rel - cell.area_too_dark_rel == pytest.approx(
            0.05, abs=4.0 * u / np.sqrt(VALIDATION_DRAWS)
        )


def test_noise_and_drift_of_the_capture_are_its_uncertainty():
    noise = CaptureNoise(np.full(3, 9.0), np.full(3, 0.5))
    # 60 degrees of freedom: sd of the scaled t sqrt(60 / 58), and tails near the normal
    found = cells(noise=noise, drift=(0.01, 60))
    of_noise = np.sqrt((9.0 + 0.5 * 50.0) / 50.0**2 / PIXELS_OF_PART)
    for cell in found:
        assert cell.u_data_rel == pytest.approx(np.hypot(of_noise, 0.01 * np.sqrt(60.0 / 58.0)), rel=VALIDATION_REL)
        assert cell.u_validation_rel == pytest.approx(np.hypot(cell.u_input_rel, cell.u_data_rel), rel=1e-9)
    # the light's drift is the capture's: the spread of the simulation does not know of it
    assert found[0].u_input_rel == pytest.approx(1.2 * SD * np.sqrt(6.0) / 3.0, rel=VALIDATION_REL + 0.003)


def test_noise_of_pixels_and_walls_is_numerical():
    """0.5 in 60 per pixel, times S / D = 1.2. Walls: 1 % in red and green; blue moves by the exposure only."""
    scale = np.array([0.01, 0.01, 0.0])
    found = cells(render_sd=0.5, walls=(scale, 60))
    sd = 0.01 * np.sqrt(60.0 / 58.0)
    of_pixels = 0.5 / 60.0 / np.sqrt(PIXELS_OF_PART)
    expected = {"red": sd * np.sqrt(5.0) / 3.0, "green": sd * np.sqrt(5.0) / 3.0, "blue": sd * np.sqrt(2.0) / 3.0}
    for cell in found:
        # a variance of 150 pixels is known to 4 x 12 %, a seventh of which enters the blue root
        margin = VALIDATION_REL + 0.01 + 2.0 * np.sqrt(2.0 / PIXELS_OF_PART) * (of_pixels / expected[cell.channel]) ** 2
        assert cell.u_numerical_rel == pytest.approx(1.2 * np.hypot(of_pixels, expected[cell.channel]), rel=margin)


def test_the_pose_is_an_input():
    """8 per mm of 60, known to 0.5 mm, adds 4 / 60 to the spread of the colours; both times S / D = 1.2."""
    u_input = cells(pose_sd_mm={"depth_mm": 0.5})[0].u_input_rel
    assert u_input == pytest.approx(1.2 * np.hypot(SD * np.sqrt(6.0) / 3.0, 4.0 / 60.0), rel=VALIDATION_REL + 0.003)


def test_the_budget_names_every_input_with_what_it_does_alone():
    noise = CaptureNoise(np.full(3, 9.0), np.full(3, 0.0))
    comparison, inputs = flat_comparison(
        noise=noise,
        render_sd=0.5,
        drift=(0.01, 60),
        walls=(np.array([0.01, 0.01, 0.0]), 60),
        pose_sd_mm={"depth_mm": 0.5},
    )
    share = np.array([1.0, 0.0, 0.0])
    lines = uncertainty_budget(comparison, inputs, EVERYWHERE, share, CAPTURE, np.random.default_rng(3))
    found = {line.input: line for line in lines}
    assert list(found) == [line.input for line in sorted(lines, key=lambda line: -line.skill_u)]
    depth = "depth of the indenter"
    assert {name: line.evaluation for name, line in found.items()} == {
        "camera response": "B", depth: "B", WALLS: "A", DRIFT: "A", PIXELS: "A"
    }  # fmt: skip
    assert found["camera response"].source == "stated"
    assert found[depth].source == f"0.5 mm, as {CAPTURE.name} states"
    assert found[DRIFT].source.startswith("1.00 %, from the repeat")
    # the objective is red over captured: as in the validation, but known before the capture
    t, of_exposure = np.sqrt(60.0 / 58.0), comparison.exposure.noise_sd_rel
    expected = {
        "camera response": 1.2 * SD * np.sqrt(6.0) / 3.0,
        depth: 1.2 * 4.0 / 60.0,
        WALLS: 1.2 * 0.01 * t * np.sqrt(5.0) / 3.0,
        DRIFT: 1.2 * 0.01 * t,
        PIXELS: 1.2 * np.hypot(np.hypot(0.5 / 60.0, 3.0 / 50.0) / np.sqrt(EVERYWHERE.sum()), of_exposure),
    }
    for name, u in expected.items():
        assert found[name].objective_u_rel == pytest.approx(u, rel=BUDGET_REL + 0.02)
    # captured levels tell pose and colours: of the 6 % and more that they are uncertain by, the skill shows a part only
    skills = [_skill(comparison, exposure) for exposure in (0.999, 1.001)]
    u = np.hypot(comparison.headline_noise, (skills[1] - skills[0]) / 0.002 * of_exposure)
    # captured levels move the mean of the colours, and with it what a wrong exposure does
    assert comparison.headline_noise * (1.0 - BUDGET_REL) < found[PIXELS].skill_u < u * (1.0 + BUDGET_REL)
    alone = inputs.draw(2000, np.random.default_rng(4)).only(depth)
    blind = comparison.sums[-1].simulation(alone.weights, comparison.exposure_of(alone.matrix), alone.drift)
    signal = comparison.sums[-1].signal(np.ones(1)) @ comparison.channel_weights
    assert found[depth].skill_u < 0.9 * float((blind @ comparison.channel_weights / signal).std())


def _skill(comparison, exposure):
    """Skill at the best values with another exposure."""
    drawn = comparison.inputs.best()
    factor = np.array([exposure * comparison.best_exposure])
    draws = propagated_draws(comparison.sums[-1], drawn, factor, None)
    return float(draws.skill("simulation", comparison.channel_weights)[0])


def test_a_prior_is_said_to_be_one():
    comparison, inputs = flat_comparison(drift=(0.007, 3))
    lines = uncertainty_budget(comparison, inputs, EVERYWHERE, np.ones(3), CAPTURE, np.random.default_rng(5))
    drift = next(line for line in lines if line.input == DRIFT)
    assert drift.evaluation == "B"
    assert drift.source == "0.7 %, from what real sensors show"


def test_the_ring_lies_between_one_and_one_and_a_half_half_widths():
    distance = np.array([[0.0, 0.99, 1.0, 1.5, 1.51, np.nan, 1.2]])
    usable = np.array([[True, True, True, True, True, True, False]])
    assert ring_of(distance, usable).tolist() == [[False, False, True, True, False, False, False]]
    with pytest.raises(CompareError, match=r"no usable pixel lies 1 to 1\.5 contact half-widths from the indenter"):
        ring_of(distance, np.zeros_like(usable))


def test_brightness_is_white_balanced():
    """Red 10 % and green 20 % too bright, blue right; by captured shares 2, 1, 1."""
    draws = BrightnessDraws(np.log([[1.1, 1.2, 1.0]]), np.ones(1))
    assert draws.error_rel(np.array([2.0, 1.0, 1.0])) == pytest.approx([(0.2 + 0.2) / 4.0])


def test_brightness_of_render_and_capture_beside_the_indenter():
    comparison, inputs = flat_comparison(pose_sd_mm={"depth_mm": 0.5})
    ring = np.zeros(SHAPE, bool)
    ring[:3] = True
    draws = brightness_draws(comparison, inputs, ring, inputs.best(), None)
    assert draws.log_ratio == pytest.approx(np.log(np.full((1, 3), 60.0 / 50.0)), rel=1e-6)
    pad = np.zeros(SHAPE, bool)
    pad[5:] = True
    assert captured_share(comparison, ring, pad) == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.parametrize("exposed", [True, False])
def test_the_objective_comes_with_draws_that_reports_share(exposed):
    comparison, inputs = flat_comparison(drift=(0.01, 60))
    capture = CAPTURE.model_copy(update={"rig": "bench 1"} | ({} if exposed else {"led_current_ma": None}))
    share = np.array([1.0, 1.0, 1.0])
    record = objective_error(comparison, inputs, EVERYWHERE, share, capture, np.random.default_rng(6))
    assert record.log_ratio_draws.shape == (STORED_DRAWS, 3)
    assert record.source == "response"
    assert record.rig == "bench 1"
    # channels add up to three times the exposure's own mean: factors cancel but for the drift
    error = record.error_rel
    assert error.estimate == pytest.approx(0.2, abs=4.0 * 1.2 * 0.01 / np.sqrt(STORED_DRAWS) * 1.2533)
    assert (error.high95 - error.low95) / 2.0 == pytest.approx(1.2 * 0.01 * 2.0, rel=0.2)
    if exposed:
        factor = np.exp(record.log_exposure_draws) * CAPTURE.exposure_s * CAPTURE.led_current_ma
        paired = inputs.draw(STORED_DRAWS, np.random.default_rng(7), paired=True)
        assert factor == pytest.approx(comparison.exposure_of(paired.matrix), rel=1e-9)
    else:
        assert record.log_exposure_draws is None
