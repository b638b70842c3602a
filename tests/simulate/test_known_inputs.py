"""Draws of paints and camera as factors on the layers of a render, against renders' own arithmetic done anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import FingerDesign, PaintCalibration, SimulateError
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import assumed_camera_response
from sim.experiments import PaintedFinger
from sim.experiments._rendered_press import DRAWS, known_inputs
from sim.optics import BAND_NAMES, chain_matrix, conversion_gains, paint_bands

CHAINS = ("led>red", "led>green", "led", "led>green>red")
RESPONSE_SD = assumed_camera_response()[0].uncertainty_rel
LED_SD = 0.2
DESIGN = FingerDesign(camera=TactileCamera(width_px=96, height_px=72, response_at_led_uncertainty_rel=LED_SD))
SHA = {"red": "a" * 64, "green": "b" * 64}
# factors are stored in single precision
SINGLE = 1e-6
YIELD_SD = 0.05


@pytest.fixture
def finger(paints):
    """A finger whose green emission excites the red paint."""
    w = paints["red"].wavelength_nm
    absorption = {name: np.exp(-0.5 * ((w - at) / 45.0) ** 2) for name, at in (("red", 500.0), ("green", 450.0))}
    exciting = {name: replace(paint, absorption_rel=absorption[name]) for name, paint in paints.items()}
    return PaintedFinger(DESIGN, exciting, assumed_camera_response(), SimpleNamespace())


def calibration(paint, draws=40, sd=YIELD_SD):
    """A posterior of yields, with a shape that narrows as the yield grows."""
    yields = 1.0 + sd * np.random.default_rng(2).standard_normal(draws)
    shape = np.exp(-np.outer(yields - 1.0, ((paint.wavelength_nm - 600.0) / 60.0) ** 2))
    return PaintCalibration.model_construct(
        paint_name=f"{paint.name} acrylic", emission_draws_per_nm=yields[:, None] * shape * paint.emission_per_nm
    )


def matrix_of(finger, paints):
    """Matrix from chains to RGB of other paints, from their bands: (3, chain) with the same camera."""
    mean, bands = (paint_bands(p["red"], p["green"], DESIGN.light) for p in (finger.paints, paints))
    gains = conversion_gains(mean.conversion, bands.conversion)
    return finger.camera_matrix(bands) @ chain_matrix(CHAINS, gains)


@pytest.mark.parametrize("colour", ["red", "green"])
def test_every_draw_of_a_paint_is_the_matrix_of_that_paint(finger, colour):
    fit = calibration(finger.paints[colour])
    found = known_inputs(finger, {colour: fit}, SHA, CHAINS, draws=60)
    assert found.names == (f"{colour} paint", "camera response")
    best = matrix_of(finger, finger.paints)
    possible = np.array(
        [
            matrix_of(finger, {**finger.paints, colour: replace(finger.paints[colour], emission_per_nm=emission)})
            / best
            for emission in fit.emission_draws_per_nm
        ]
    )
    for factor in found.factors[0]:
        assert np.abs(possible / factor - 1.0).max(axis=(1, 2)).min() < SINGLE
    # draws are of all the posterior: 60 of 40 leave out 40 e^-1.5 = 9 on average
    assert len(np.unique(found.factors[0][:, 0, CHAINS.index(f"led>{colour}")])) > 20


def test_light_that_never_meets_a_paint_does_not_depend_on_it(finger):
    factors = known_inputs(finger, {"red": calibration(finger.paints["red"])}, SHA, CHAINS, draws=20).factors[0]
    assert factors[..., CHAINS.index("led")] == pytest.approx(1.0, rel=SINGLE)
    assert factors[..., CHAINS.index("led>green")] == pytest.approx(1.0, rel=SINGLE)
    assert factors[..., CHAINS.index("led>red")].std() > 0.5 * YIELD_SD


def test_the_camera_is_uncertain_by_channel_and_more_so_in_the_leds_band(finger):
    found = known_inputs(finger, {}, {}, CHAINS)
    assert (found.names, found.evaluations) == (("camera response",), ("B",))
    assert found.sources[0].endswith("; its uncertainty at the LED's wavelengths is stated as 20 %")
    camera = found.factors[0].astype(float)
    assert camera.shape == (DRAWS, 3, len(CHAINS))
    led = CHAINS.index("led")
    # all fluorescence of a channel moves together, the LED's light by a factor of its own on top
    assert (camera[..., 0] == camera[..., 1]).all()
    assert (camera[..., 0] == camera[..., 3]).all()
    at_led = np.sqrt((1.0 + RESPONSE_SD**2) * (1.0 + LED_SD**2) - 1.0)
    for values, sd in ((camera[..., 0], RESPONSE_SD), (camera[..., led], at_led)):
        # four standard errors; a log-normal of sd 0.2 has heavier tails, by a fifth
        assert values.mean(axis=0) == pytest.approx(1.0, abs=4.0 * sd / np.sqrt(DRAWS))
        assert values.std(axis=0) == pytest.approx(sd, rel=1.2 * 4.0 / np.sqrt(2.0 * DRAWS))
    correlation = np.corrcoef(camera[..., 0].T) - np.eye(3)
    assert np.abs(correlation).max() < 4.0 / np.sqrt(DRAWS)
    assert (camera > 0.0).all()


def test_the_same_key_gives_the_same_draws_whatever_else_is_drawn(finger):
    fits = {name: calibration(paint) for name, paint in finger.paints.items()}
    both, alone = (
        known_inputs(finger, fits, SHA, CHAINS, 30),
        known_inputs(finger, {"green": fits["green"]}, SHA, CHAINS, 30),
    )
    assert both.names == ("red paint", "green paint", "camera response")
    assert both.evaluations == ("A", "A", "B")
    assert both.sources[:2] == ("posterior of red acrylic", "posterior of green acrylic")
    assert both.keys[:2] == (SHA["red"], SHA["green"])
    assert both.keys[1:] == alone.keys
    assert (both.factors[1:] == alone.factors).all()
    renamed = known_inputs(finger, {"green": fits["green"]}, {}, CHAINS, 30)
    assert renamed.keys[0] == "green acrylic"
    assert not (renamed.factors[0] == alone.factors[0]).all()


def test_another_camera_has_another_key(finger):
    surer = replace(
        finger, design=DESIGN.model_copy(update={"camera": TactileCamera(response_at_led_uncertainty_rel=0.1)})
    )
    assert known_inputs(finger, {}, {}, CHAINS, 5).keys != known_inputs(surer, {}, {}, CHAINS, 5).keys


def test_bands_are_layers_too(finger):
    """Where chains do not stand apart the first chain of each band stands for it."""
    found = known_inputs(finger, {"red": calibration(finger.paints["red"])}, SHA, CHAINS[:3], 20)
    assert found.factors.shape == (2, 20, 3, len(BAND_NAMES))


def test_negative_emission_of_a_draw_is_none(finger):
    fit = calibration(finger.paints["red"])
    below = fit.emission_draws_per_nm.copy()
    below[:, below[0] < 1e-6 * below[0].max()] -= 1e-3
    fixed = PaintCalibration.model_construct(paint_name="p", emission_draws_per_nm=below)
    first, second = (known_inputs(finger, {"red": f}, SHA, CHAINS, 20) for f in (fit, fixed))
    assert first.factors == pytest.approx(second.factors, rel=1e-3)


def test_unphysical_draws_are_left_out_and_too_many_refused(finger):
    """Draws with seven times the emission return more light than the LED brings."""
    fit = calibration(finger.paints["red"])
    some, most = fit.emission_draws_per_nm.copy(), fit.emission_draws_per_nm.copy()
    some[:10] *= 7.0
    most[:-4] *= 7.0
    kept = known_inputs(finger, {"red": fit.model_copy(update={"emission_draws_per_nm": some})}, SHA, CHAINS, 100)
    assert kept.factors.shape[1] == 100
    assert kept.factors[0].max() < 1.5
    with pytest.raises(
        SimulateError, match=r"more than half of the posterior draws of red acrylic return more light .* white"
    ):
        known_inputs(finger, {"red": fit.model_copy(update={"emission_draws_per_nm": most})}, SHA, CHAINS, 100)


def test_a_channel_that_is_blind_to_a_band_stays_so(finger):
    red, green, blue = assumed_camera_response()
    cut = red.model_copy(update={"values": np.where(red.wavelength_nm < 520.0, 0.0, red.values)})
    camera = replace(finger, response=(cut, green, blue))
    found = known_inputs(camera, {"red": calibration(finger.paints["red"])}, SHA, CHAINS, draws=20)
    assert camera.camera_matrix(paint_bands(**finger.paints, light=DESIGN.light))[0, BAND_NAMES.index("led")] == 0.0
    assert np.isfinite(found.factors).all()
    assert (found.factors[0, :, 0, CHAINS.index("led")] == 1.0).all()
