"""The exposure factor, levels of the parts of a region, and the layers they are formed from."""

import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.compare._comparison import exposure_fit, part_levels
from finray_calib.compare._image_noise import CaptureNoise
from finray_calib.compare._input_draws import InputDraws, Inputs
from finray_calib.compare._region_sums import render_layers
from tests.command_line.records import press as made_up_press
from tests.compare.layered_scenes import EVERYWHERE, MATRIX, SHAPE, captured_of, layers_of, smooth_layers
from tests.compare.twins import twin

# layers are kept in single precision
SINGLE = 1e-6


def test_a_render_at_another_exposure_gets_its_factor():
    base, pressed = smooth_layers()
    fit = exposure_fit(layers_of(pressed, base), 700.0 * base @ MATRIX.T, 0.0 * base, EVERYWHERE)
    assert fit(np.array([MATRIX, 2.0 * MATRIX])) == pytest.approx([700.0, 350.0], rel=SINGLE)


def test_all_channels_count_alike_however_bright():
    """1 / k is the mean of simulated over captured: channels at 1, 1/2 and 1/4 of the render's level give 3 / 7."""
    flat = np.ones((*SHAPE, 3))
    fit = exposure_fit(layers_of(flat, flat, np.eye(3)), flat * [1.0, 0.5, 0.25], 0.0 * flat, EVERYWHERE)
    assert fit(np.eye(3)[None])[0] == pytest.approx(3.0 / 7.0, rel=SINGLE)


def test_the_factor_scatters_as_it_says():
    """400 noisy renders and captures: four standard errors of a standard deviation."""
    flat, rng = np.ones((*SHAPE, 3)), np.random.default_rng(2)
    factors, claimed = [], []
    for _ in range(400):
        halves = 0.2 * rng.standard_normal((2, *flat.shape))
        layers = layers_of(flat, flat + halves[0], np.diag([1.0, 2.0, 0.5]), noise=(0.0 * flat, halves[1]))
        fit = exposure_fit(layers, 100.0 * flat + 30.0 * rng.standard_normal(flat.shape), 900.0 * flat, EVERYWHERE)
        factors.append(float(fit(layers.matrix[None])[0]))
        claimed.append(fit.noise_sd_rel)
    assert np.std(factors, ddof=1) / np.mean(factors) == pytest.approx(np.mean(claimed), rel=4.0 / np.sqrt(800.0))


def test_the_press_itself_does_not_matter():
    base, pressed = smooth_layers()
    fits = [
        exposure_fit(layers_of(contact, base), base @ MATRIX.T, 0.0 * base, EVERYWHERE)
        for contact in (pressed, 5.0 * pressed)
    ]
    assert fits[0](MATRIX[None]) == fits[1](MATRIX[None])


@pytest.mark.parametrize(("render", "capture"), [(0.0, 1.0), (1.0, 0.0), (1.0, -1.0)])
def test_black_images_have_no_exposure_factor(render, capture):
    flat = np.ones((*SHAPE, 3))
    with pytest.raises(
        CompareError,
        match="no exposure factor fits, because the render or a channel of the capture without contact is black",
    ):
        exposure_fit(layers_of(render * flat, render * flat), capture * flat, 0.0 * flat, EVERYWHERE)


def test_levels_of_nine_parts_are_the_direct_means():
    base, pressed = smooth_layers()
    slope = np.random.default_rng(0).uniform(-0.2, 0.2, pressed.shape).astype(np.float32)
    layers = layers_of(pressed, base, pose={"depth_mm": slope})
    captured = captured_of(700.0 * pressed @ MATRIX.T, 690.0 * base @ MATRIX.T)
    levels = part_levels(layers, captured, EVERYWHERE, ("depth_mm",))
    assert levels.places == tuple((r, c) for r in range(3) for c in range(3))
    # 48 x 64 px in thirds
    assert levels.pixels.tolist() == [16 * n for n in (22, 21, 21)] * 3
    drawn = InputDraws(MATRIX, {}, {"depth": np.array([0.0, 0.5])}, np.array([0.0, 0.01]))
    found = levels.simulated(drawn, np.array([100.0, 200.0]))
    for i, part in enumerate(np.ix_(np.arange(16 * r, 16 * r + 16), c) for r in range(3) for c in _thirds()):
        for d, (k, move) in enumerate([(100.0, 0.0), (200.0, 0.5)]):
            images = (base, pressed + move * slope)
            direct = [k * (image[part] @ MATRIX.T).mean(axis=(0, 1)) for image in images]
            assert found[d, :, :, i] == pytest.approx(np.array(direct), rel=SINGLE)
    fit = exposure_fit(layers, captured.no_contact, 0.0 * base, EVERYWHERE)
    ratio = levels.log_ratio(drawn, fit)
    # without contact the exposure takes all: nothing is left; with it 690 / 700, and the drift of the capture
    assert ratio[0, 0] == pytest.approx(0.0, abs=SINGLE)
    assert ratio[0, 1] == pytest.approx(np.log(690.0 / 700.0), abs=SINGLE)
    still = levels.log_ratio(InputDraws(MATRIX, {}, {"depth": np.array([0.5])}, np.zeros(1)), fit)
    assert ratio[1, 1] == pytest.approx(still[0, 1] - 0.01, abs=SINGLE)


def _thirds():
    return np.arange(0, 22), np.arange(22, 43), np.arange(43, 64)


def test_levels_scatter_as_their_variance_says():
    """300 noisy images: four standard errors of a variance."""
    flat = np.ones((*SHAPE, 3))
    noise = CaptureNoise(np.full(3, 4.0), np.full(3, 0.2))
    rng = np.random.default_rng(1)
    ratios, claimed, of_render = [], [], []
    for _ in range(300):
        halves = 0.1 * rng.standard_normal((2, 2, *flat.shape))
        layers = layers_of(flat + halves[0, 0], flat + halves[0, 1], np.eye(3), noise=tuple(halves[1]))
        images = [100.0 * flat + np.sqrt(24.0) * rng.standard_normal(flat.shape) for _ in range(2)]
        levels = part_levels(layers, captured_of(*images, noise=noise), EVERYWHERE, ())
        ratios.append(levels.log_ratio(Inputs(layers, {}, None, None).best(), None)[0])
        claimed.append(levels.noise_variance)
        of_render.append(levels.render_variance)
    seen, claim = np.var(ratios, axis=0, ddof=1), np.mean(claimed, axis=0)
    pixels = np.array([16 * n for n in (22, 21, 21)] * 3)
    # of the render 0.1^2, of the camera (4 + 0.2 x 100) / 100^2
    assert claim * pixels == pytest.approx(np.full((2, 3, 9), 0.01 + 0.0024), rel=0.02)
    assert np.mean(of_render, axis=0) * pixels == pytest.approx(np.full((2, 3, 9), 0.01), rel=0.02)
    # 54 variances of 300: each within 4.5 standard errors
    assert seen == pytest.approx(claim, rel=4.5 * np.sqrt(2.0 / 300.0))


def test_dark_parts_are_left_out():
    base, pressed = smooth_layers()
    contact = pressed @ MATRIX.T
    contact[:16, :22] = 0.0
    levels = part_levels(layers_of(pressed, base), captured_of(contact, base @ MATRIX.T), EVERYWHERE, ())
    assert len(levels.places) == 8
    assert (0, 0) not in levels.places


def test_a_region_without_a_usable_part_is_refused():
    base, pressed = smooth_layers()
    few = np.zeros(SHAPE, bool)
    few[:9, :9] = True
    with pytest.raises(CompareError, match=r"the region was divided .* none has at least 10 usable pixels .* larger"):
        part_levels(layers_of(pressed, base), captured_of(pressed @ MATRIX.T, base @ MATRIX.T), few, ())


def test_layers_of_a_render_give_its_picture_and_both_halves():
    press = twin(np.random.default_rng(0)).press
    layers = render_layers(press)
    assert layers.names == ("red", "green", "led")
    assert layers.rgb(layers.contact) == pytest.approx(press.contact, rel=SINGLE)
    assert layers.contact_variance == pytest.approx(layers.rgb(press.contact_half_difference) ** 2)
    corner = np.zeros(layers.contact.shape[:2], bool)
    corner[:2, :3] = True
    first, second = layers.halves("contact", corner, ("depth_mm",))
    assert first.shape == (6, 6)
    assert (first + second)[:, :3] / 2.0 == pytest.approx(press.contact_bands[corner].astype(float), rel=SINGLE)
    assert (first - second)[:, :3] / 2.0 == pytest.approx(
        press.contact_half_difference[corner].astype(float), rel=1e-5, abs=SINGLE
    )
    assert (first + second)[:, 3:] / 2.0 == pytest.approx(press.pose_response.derivative[0][corner], rel=SINGLE)
    assert layers.halves("no_contact", corner)[0].shape == (6, 3)


def test_chains_come_before_bands_and_a_press_without_halves_is_its_picture():
    press = twin(np.random.default_rng(0)).press
    chains = {
        "contact_chains": 2.0 * press.contact_bands,
        "no_contact_chains": 2.0 * press.no_contact_bands,
        "chains": ("led>red", "led>green", "led"),
    }
    apart = render_layers(press.model_copy(update=chains))
    assert apart.names == chains["chains"]
    assert (apart.contact == chains["contact_chains"]).all()
    plain = render_layers(press.model_copy(update={"contact_half_difference": None}))
    assert plain.names == ("red", "green", "blue")
    assert (plain.rgb(plain.contact) == press.contact).all()
    assert (plain.contact_variance == 0.0).all()
    assert plain.inputs is None
    assert plain.pose_names == ()


def test_blocks_of_layers_are_means_of_everything():
    layers = render_layers(twin(np.random.default_rng(0)).press)
    blocked = layers.blocked(4)
    assert blocked.contact.shape == (16, 20, 3)
    assert blocked.pose.shape == (1, 16, 20, 3)
    assert blocked.contact_half[1, 2] == pytest.approx(layers.contact_half[4:8, 8:12].mean(axis=(0, 1)), abs=SINGLE)
    assert blocked.pose_half[0, 1, 2] == pytest.approx(layers.pose_half[0, 4:8, 8:12].mean(axis=(0, 1)), abs=SINGLE)
    assert render_layers(made_up_press()).blocked(2).pose.shape == (0, 30, 40, 3)


def test_a_render_that_failed_is_refused():
    press = made_up_press()
    broken = press.contact.copy()
    broken[3, 4, 1] = np.nan
    with pytest.raises(CompareError, match="strip contains values that are not finite, because the render failed"):
        render_layers(press.model_copy(update={"contact": broken}))
