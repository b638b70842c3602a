"""Sums over a region and their draws: images and gradients, propagated and resampled."""

import numpy as np
import pytest

from finray_calib.compare._image_noise import NOISE_EXCESS, CaptureNoise
from finray_calib.compare._input_draws import InputDraws, Inputs
from finray_calib.compare._photometric_error import RegionDraws, propagated_draws, resampled_draws
from finray_calib.compare._region_sums import gradient_sums, image_sums
from tests.compare.layered_scenes import EVERYWHERE, MATRIX, SHAPE, captured_of, layers_of, smooth_layers

DN = 900.0
# single-precision layers, summed in double
SINGLE = 1e-6


@pytest.fixture
def scene():
    base, pressed = smooth_layers()
    rng = np.random.default_rng(0)
    captured = DN * pressed @ MATRIX.T * rng.uniform(0.95, 1.05, (*SHAPE, 3))
    no_contact = DN * base @ MATRIX.T
    repeat = no_contact * 1.002
    return layers_of(pressed, base), captured_of(captured, no_contact, repeat)


def best(layers):
    return Inputs(layers, {}, None, None).best()


def central(image):
    """Sobel / 8 of the inside of an image, written out: rows, then columns."""
    down = (image[2:] - image[:-2]) / 2.0
    down = (down[:, :-2] + 2.0 * down[:, 1:-1] + down[:, 2:]) / 4.0
    right = (image[:, 2:] - image[:, :-2]) / 2.0
    right = (right[:-2] + 2.0 * right[1:-1] + right[2:]) / 4.0
    return np.array([down, right])


def test_images_at_the_best_values_are_the_direct_sums(scene):
    layers, captured = scene
    simulated = DN * layers.rgb(layers.contact)
    draws = propagated_draws(image_sums(layers, captured, EVERYWHERE, DN, ()), best(layers), np.array([DN]), None)
    real, nothing = captured.contact, captured.no_contact
    direct = {
        "simulation": ((simulated - real) ** 2).sum(axis=(0, 1)),
        "do nothing": ((nothing - real) ** 2).sum(axis=(0, 1)),
        "floor": ((captured.repeat - nothing) ** 2).sum(axis=(0, 1)),
    }
    weights = np.array([1.0, 2.0, 3.0])
    for name, squares in direct.items():
        assert draws.error[name][0] == pytest.approx(squares, rel=SINGLE)
        skill = 1.0 - squares @ weights / (direct["do nothing"] @ weights)
        assert draws.skill(name, weights)[0] == pytest.approx(skill, abs=SINGLE)
        assert draws.channel_skill(name)[0] == pytest.approx(1.0 - squares / direct["do nothing"], abs=SINGLE)
        rms = np.sqrt(squares / EVERYWHERE.sum()) / real.mean(axis=(0, 1))
        assert draws.relative_rms(name)[0] == pytest.approx(rms, rel=SINGLE)
        assert draws.relative_rms_of_all(name)[0] == pytest.approx(np.sqrt((rms**2).mean()), rel=SINGLE)


def test_gradients_at_the_best_values_are_the_direct_sums(scene):
    layers, captured = scene
    sums = gradient_sums(layers, captured, [EVERYWHERE], DN, ())[0]
    draws = propagated_draws(sums, best(layers), np.array([DN]), None)
    simulated = DN * layers.rgb(layers.contact - layers.no_contact)
    real = central(captured.contact - captured.no_contact)
    assert sums.pixels == real[..., 0].size
    direct = {
        "simulation": ((central(simulated) - real) ** 2).sum(axis=(0, 1, 2)),
        "do nothing": (real**2).sum(axis=(0, 1, 2)),
        "floor": (central(captured.repeat - captured.no_contact) ** 2).sum(axis=(0, 1, 2)),
    }
    level = captured.no_contact[1:-1, 1:-1].mean(axis=(0, 1))
    for name, squares in direct.items():
        assert draws.error[name][0] == pytest.approx(squares, rel=1e-5)
        assert draws.relative_rms(name)[0] == pytest.approx(np.sqrt(squares / sums.pixels) / level, rel=1e-5)


def test_draws_of_paint_pose_exposure_and_drift_are_the_direct_sums(scene):
    base, pressed = smooth_layers()
    slope = np.random.default_rng(1).uniform(-0.2, 0.2, pressed.shape).astype(np.float32).astype(float)
    layers, captured = layers_of(pressed, base, pose={"depth_mm": slope}), scene[1]
    rng = np.random.default_rng(2)
    draws = 5
    drawn = InputDraws(
        MATRIX,
        {"paint": 0.1 * rng.standard_normal((draws, 3, 3)), "camera": 0.1 * rng.standard_normal((draws, 3, 3))},
        {"depth": 0.3 * rng.standard_normal(draws)},
        0.01 * rng.standard_normal(draws),
    )
    exposure = DN * rng.uniform(0.9, 1.1, draws)
    images = propagated_draws(image_sums(layers, captured, EVERYWHERE, DN, ("depth_mm",)), drawn, exposure, None)
    gradients = propagated_draws(
        gradient_sums(layers, captured, [EVERYWHERE], DN, ("depth_mm",))[0], drawn, exposure, None
    )
    for d in range(draws):
        matrix = MATRIX * np.exp(drawn.log_factors["paint"][d] + drawn.log_factors["camera"][d])
        simulated = exposure[d] * (pressed + drawn.moves_mm["depth"][d] * slope) @ matrix.T
        real = np.exp(drawn.log_drift[d]) * captured.contact
        assert images.error["simulation"][d] == pytest.approx(((simulated - real) ** 2).sum(axis=(0, 1)), rel=1e-5)
        nothing = ((captured.no_contact - real) ** 2).sum(axis=(0, 1))
        assert images.error["do nothing"][d] == pytest.approx(nothing, rel=SINGLE)
        change = simulated - exposure[d] * base @ matrix.T
        # of gradients the drift multiplies the whole change: 1 % of a per cent of the level, left out of its slope
        of_change = np.exp(drawn.log_drift[d]) * central(captured.contact - captured.no_contact)
        direct = ((central(change) - of_change) ** 2).sum(axis=(0, 1, 2))
        assert gradients.error["simulation"][d] == pytest.approx(direct, rel=1e-4)


def test_noise_leaves_no_bias_in_images_and_gradients():
    """200 captures and renders of a scene whose noise is as large as its contact signal."""
    base, pressed = smooth_layers()
    rng = np.random.default_rng(3)
    clean = [DN * image @ MATRIX.T for image in (1.05 * pressed, base)]
    noise = CaptureNoise(np.full(3, 50.0**2), np.full(3, 3.0))
    truth, found = {}, {"images": [], "gradients": []}
    for trial in range(201):
        noisy = trial > 0
        halves = [0.05 * noisy * rng.standard_normal((2, *base.shape)) for _ in range(2)]
        # the halves differ by twice the half difference; their mean has the same standard deviation
        layers = layers_of(pressed + halves[0][0], base + halves[0][1], noise=(halves[1][0], halves[1][1]))
        images = [i + noisy * np.sqrt(noise.variance(i)) * rng.standard_normal(i.shape) for i in (*clean, clean[1])]
        captured = captured_of(*images, noise if noisy else CaptureNoise(np.zeros(3), np.zeros(3)))
        of_images = image_sums(layers, captured, EVERYWHERE, DN, ())
        (of_gradients,) = gradient_sums(layers, captured, [EVERYWHERE], DN, ())
        for name, sums in (("images", of_images), ("gradients", of_gradients)):
            errors = propagated_draws(sums, best(layers), np.array([DN]), None).error
            values = np.array([errors[candidate][0] for candidate in ("simulation", "do nothing", "floor")])
            if noisy:
                found[name].append(values)
            else:
                truth[name] = values
    for name, values in found.items():
        standard_error = np.std(values, axis=0, ddof=1) / np.sqrt(200)
        # 18 numbers: one of them exceeds 3.5 standard errors with a probability of 0.8 %
        assert (np.abs(np.mean(values, axis=0) - truth[name]) < 3.5 * standard_error).all()


def test_sums_of_squared_gradients_scatter_as_claimed():
    """Noise alone, 500 images: neighbouring gradients share pixels."""
    flat = np.ones((*SHAPE, 3))
    rng = np.random.default_rng(4)
    noise = CaptureNoise(np.full(3, 1.0), np.zeros(3))
    layers, sums, claimed = layers_of(flat, flat), [], []
    for _ in range(500):
        images = [100.0 + rng.standard_normal(flat.shape) for _ in range(2)]
        found = gradient_sums(layers, captured_of(*images, noise=noise), [EVERYWHERE], 1.0, ())[0]
        sums.append(found.contact_square)
        claimed.append(2.0 * found.noise.signal[0])
    # Without squares of a signal, of which noise leaves some: 2 v^2 per gradient and the excess.
    variance = 2.0 * 0.1875
    squares = 2.0 * variance**2 * found.pixels
    excess = np.var(sums, axis=0, ddof=1).mean() / squares
    # three channels of 500: four standard errors; at the frame's edge neighbours are missing
    assert excess == pytest.approx(0.98 * NOISE_EXCESS, rel=4.0 * np.sqrt(2.0 / 1500.0))
    assert np.mean(claimed) > squares * excess


def test_noise_spreads_the_draws_as_the_sums_say(scene):
    layers, captured = scene
    noise = CaptureNoise(np.full(3, 100.0), np.full(3, 2.0))
    sums = image_sums(
        layers, captured_of(captured.contact, captured.no_contact, captured.repeat, noise), EVERYWHERE, DN, ()
    )
    draws = 20_000
    drawn = InputDraws(MATRIX, {}, {}, np.zeros(draws))
    found = propagated_draws(sums, drawn, np.full(draws, DN), np.random.default_rng(5))
    # four standard errors of a standard deviation
    margin = 4.0 / np.sqrt(2.0 * draws)
    assert found.error["simulation"].std(axis=0) == pytest.approx(np.sqrt(sums.noise.error), rel=margin)
    assert found.error["do nothing"].std(axis=0) == pytest.approx(np.sqrt(sums.noise.signal), rel=margin)
    assert found.error["floor"].std(axis=0) == pytest.approx(sums.floor_noise_sd, rel=margin)


def test_missing_pixels_and_frame_edges_have_no_gradient(scene):
    layers, captured = scene
    contact = captured.contact.copy()
    contact[20, 30, 1] = np.nan
    used = np.isfinite(contact).all(axis=2)
    sums = gradient_sums(layers, captured_of(contact, captured.no_contact), [used], DN, ())[0]
    whole = np.zeros(SHAPE, bool)
    whole[1:-1, 1:-1] = True
    whole[19:22, 29:32] = False
    assert (sums.where == whole).all()
    assert sums.floor is None
    edge = np.zeros(SHAPE, bool)
    edge[0] = True
    assert gradient_sums(layers, captured, [edge], DN, ()) == [None]


def test_a_channel_without_contact_has_no_skill_of_its_own():
    error = {"do nothing": np.array([[1.0, 0.0, 2.0]]), "simulation": np.array([[0.5, 0.0, -0.1]])}
    draws = RegionDraws(error, np.ones((1, 3)), 1)
    assert draws.channel_skill("simulation")[0] == pytest.approx([0.5, np.nan, 1.05], nan_ok=True)
    # what noise made negative is no error at all
    assert draws.relative_rms("simulation")[0] == pytest.approx([np.sqrt(0.5), 0.0, 0.0])


def test_parts_of_a_region_cover_the_truth():
    """Errors drawn per 8 px block on 96 x 128 px: 48 tiles. Truths in closed form; 95 % intervals, 200 scenes."""
    rng = np.random.default_rng(6)
    shape = (96, 128)
    everywhere, nothing = np.ones(shape, bool), np.full((*shape, 3), 100.0)
    captured = np.full((*shape, 3), 80.0)
    skill_inside, rms_inside = 0, 0
    for _ in range(200):
        blotches = np.kron(rng.standard_normal((12, 16)), np.ones((8, 8)))[..., None] * np.ones(3)
        layers = layers_of(captured + 4.0 * blotches, nothing, np.eye(3))
        sums = image_sums(layers, captured_of(captured, nothing), everywhere, 1.0, ())
        draws = resampled_draws(sums, 1000, rng)
        low, high = np.quantile(draws.skill("simulation", np.ones(3)), [0.025, 0.975])
        skill_inside += low <= 1.0 - (4.0 / 20.0) ** 2 <= high
        low, high = np.quantile(draws.relative_rms("simulation")[:, 0], [0.025, 0.975])
        rms_inside += low <= 4.0 / 80.0 <= high
        assert (draws.skill("do nothing", np.ones(3)) == 0.0).all()
    # 48 tiles cover 0.94. Binomial(200, 0.94) is below 174 or above 198 with probability 1.3e-4.
    assert 174 <= skill_inside <= 198
    assert 174 <= rms_inside <= 198


def test_parts_of_different_size_leave_the_mean_where_it_is():
    """A region whose tiles differ in size: draws are brought to its number of pixels, so their centre is its sum."""
    base, pressed = smooth_layers()
    rng = np.random.default_rng(7)
    real = pressed @ MATRIX.T * rng.uniform(0.9, 1.1, (*SHAPE, 3))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    disc = np.hypot(rows - 24.0, columns - 30.0) < 23.0
    sums = image_sums(layers_of(pressed, base), captured_of(real, base @ MATRIX.T, base @ MATRIX.T), disc, 1.0, ())
    draws = resampled_draws(sums, 4000, rng)
    total = sums.per_pixel["error"].sum(axis=0)
    # four standard errors, and the bias of a ratio of about a 20th of a relative variance over so many tiles
    spread = draws.error["simulation"].std(axis=0)
    assert draws.error["simulation"].mean(axis=0) == pytest.approx(total, abs=(4.0 * spread / 63.0).max(), rel=0.01)
    assert draws.level.mean(axis=0) == pytest.approx(sums.level, rel=0.01)
    assert (draws.error["floor"] == 0.0).all()
