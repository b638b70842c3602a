"""One comparison from layers to draws of every region."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import CompareError, KnownInputs
from finray_calib.compare import Region
from finray_calib.compare import _input_draws as stopping_rule
from finray_calib.compare._comparison import prepare_comparison
from finray_calib.compare._image_noise import CaptureNoise
from finray_calib.compare._input_draws import WALLS, Inputs, generator_of, inputs_of
from finray_calib.compare._photometric_error import best, propagated, resampled
from finray_calib.compare._prepared_images import prepare_images
from tests.compare.layered_scenes import EVERYWHERE, MATRIX, SHAPE, captured_of, layers_of, smooth_layers
from tests.compare.plain_skill import skill_score
from tests.compare.twins import CAMERA_SD, DEPTH_SD_MM, twin

DN = 900.0
SINGLE = 1e-5
ROWS = np.arange(SHAPE[0])[:, None]
CONTACT, HALO = (np.broadcast_to(np.abs(ROWS - 24) <= reach, SHAPE).copy() for reach in (7, 14))
REGIONS = (Region("contact", CONTACT, 1.0), Region("halo", HALO, 2.0))


def compare(layers, captured, regions=REGIONS, inputs=None, fit_exposure=False, relative_weights=True):
    return prepare_comparison(layers, captured, regions, inputs, fit_exposure, relative_weights)


@pytest.fixture
def scene():
    """Layers in DN, and a capture that they miss by some per cent."""
    base, pressed = (DN * image for image in smooth_layers())
    rng = np.random.default_rng(0)
    real = pressed @ MATRIX.T * rng.uniform(0.97, 1.03, (*SHAPE, 3))
    return layers_of(pressed, base), captured_of(real, base @ MATRIX.T, 1.001 * base @ MATRIX.T)


@pytest.mark.parametrize("relative_weights", [True, False])
def test_the_best_values_give_the_plain_skill_of_the_picture(scene, relative_weights):
    layers, captured = scene
    comparison = compare(layers, captured, relative_weights=relative_weights)
    weights = comparison.channel_weights
    assert (weights == 1.0).all() != relative_weights
    for region, result in zip(REGIONS, best(comparison), strict=True):
        images = {
            "simulation": layers.rgb(layers.contact),
            "do nothing": captured.no_contact,
            "floor": captured.contact + captured.repeat - captured.no_contact,
        }
        for name, image in images.items():
            plain = skill_score(image, captured.contact, captured.no_contact, region.mask, weights)
            assert result.images.skill(name, weights)[0] == pytest.approx(plain.skill, abs=SINGLE)
            assert result.images.channel_skill(name)[0] == pytest.approx(plain.per_channel_skill, abs=SINGLE)


def test_noise_of_the_rest_that_a_render_begins_from_is_exposed_with_it(scene):
    """A render 1.6 times as dim, brightened by 1.6, holds the same noise of the image without contact."""
    layers, captured = scene
    noise = CaptureNoise(np.full(3, 200.0), np.full(3, 0.5))
    captured, rest_noise = replace(captured, noise=noise), np.full((*SHAPE, 3), 0.8)
    dimmer = replace(layers_of(layers.contact / 1.6, layers.no_contact / 1.6), rest_noise=rest_noise / 1.6**2)
    dim = compare(dimmer, captured, fit_exposure=True)
    one = compare(replace(layers, rest_noise=rest_noise), captured, fit_exposure=True)
    assert dim.best_exposure / one.best_exposure == pytest.approx(1.6, rel=1e-3)
    weights = np.ones(3)
    for found, expected in zip(best(dim), best(one), strict=True):
        for name in ("images", "gradients"):
            pair = [getattr(result, name).skill("simulation", weights)[0] for result in (found, expected)]
            assert pair[0] == pytest.approx(pair[1], abs=1e-4)
    bare = best(compare(layers, captured, fit_exposure=True))[0].images.skill("simulation", weights)[0]
    assert abs(bare - best(one)[0].images.skill("simulation", weights)[0]) > 0.005  # the noise matters here


def test_one_exposure_factor_serves_all_regions_and_not_the_do_nothing_row(scene):
    layers, captured = scene
    dimmer = layers_of(layers.contact / 1.6, layers.no_contact / 1.6)
    comparison = compare(dimmer, captured, fit_exposure=True)
    assert comparison.best_exposure == pytest.approx(1.6, rel=SINGLE)
    plain = best(compare(layers, captured))
    for result, expected in zip(best(comparison), plain, strict=True):
        weights = comparison.channel_weights
        assert result.images.skill("simulation", weights) == pytest.approx(expected.images.skill("simulation", weights))
        assert result.images.skill("do nothing", weights) == 0.0


def test_exposure_from_the_images_without_contact_cannot_buy_contact(scene):
    """The render without contact as the press: a factor fitted to the press would dim it towards the contact."""
    layers, captured = scene
    nothing = compare(layers_of(layers.no_contact, layers.no_contact), captured, fit_exposure=True)
    assert nothing.best_exposure == pytest.approx(1.0, rel=SINGLE)
    assert best(nothing)[1].images.skill("simulation", nothing.channel_weights)[0] == pytest.approx(0.0, abs=1e-4)


def test_pixels_missing_in_any_image_are_left_out_of_every_row(scene):
    layers, captured = scene
    contact = captured.contact.copy()
    contact[20:24, 10:20] = np.nan
    comparison = compare(layers, captured_of(contact, captured.no_contact, captured.repeat))
    left = CONTACT & np.isfinite(contact).all(axis=2)
    assert (comparison.used[0] == left).all()
    result = best(comparison)[0].images
    assert result.pixels == CONTACT.sum() - 40
    plain = skill_score(
        layers.rgb(layers.contact), captured.contact, captured.no_contact, left, comparison.channel_weights
    )
    assert result.skill("simulation", comparison.channel_weights)[0] == pytest.approx(plain.skill, abs=SINGLE)


def test_resampled_parts_spread_around_the_whole(scene):
    comparison = compare(*scene)
    whole, draws = best(comparison), resampled(comparison, np.random.default_rng(1))
    for one, many in zip(whole, draws, strict=True):
        for candidate in ("simulation", "floor"):
            values = many.images.skill(candidate, comparison.channel_weights)
            low, high = np.quantile(values, [0.025, 0.975])
            assert low < one.images.skill(candidate, comparison.channel_weights)[0] < high
        assert many.gradients.relative_rms("simulation").shape == (2000, 3)
        assert (many.images.skill("do nothing", comparison.channel_weights) == 0.0).all()


def test_the_same_seed_gives_the_same_draws_and_captures_have_their_own():
    captures = [twin(np.random.default_rng(s)).capture for s in (0, 1)]
    numbers = [generator_of(c, seed).standard_normal() for c, seed in ((captures[0], 1),) * 2 + ((captures[0], 2),)]
    assert numbers[0] == numbers[1]
    assert len({*numbers, generator_of(captures[1], 1).standard_normal()}) == 3


def inputs_for(layers, drift=None, walls=None, poses=()):
    return Inputs(layers, dict.fromkeys(poses, 0.1), drift, walls)


def known(sd, draws=4000):
    """A factor on all channels and layers alike, and one on the red channel."""
    rng = np.random.default_rng(3)
    common = np.exp(sd * rng.standard_normal((draws, 1, 1))) * np.ones((3, 3))
    red = np.ones((draws, 3, 3))
    red[:, 0] = np.exp(sd * rng.standard_normal((draws, 1)))
    return KnownInputs(
        names=("LED", "red response"), keys=("a", "b"), evaluations=("A", "B"), sources=("c", "d"),
        factors=np.array([common, red], dtype=np.float32),
    )  # fmt: skip


def test_the_stopping_rule_watches_the_headline(scene, monkeypatch):
    monkeypatch.setattr(stopping_rule, "BLOCK_DRAWS", 500)
    layers = layers_of(scene[0].contact, scene[0].no_contact, inputs=known(0.02))
    comparison = compare(layers, scene[1], inputs=inputs_for(layers, drift=(0.005, 4)), fit_exposure=True)
    results, draws = propagated(comparison, comparison.inputs, np.random.default_rng(4))
    count = len(draws.draws["headline"])
    assert 4 * 500 <= count <= 12 * 500
    headline = results[-1].images.skill("simulation", comparison.channel_weights)
    assert (headline == draws.draws["headline"]).all()
    assert len(draws.draws["exposure"]) == count
    assert set(results[0].images.error) == {"do nothing", "simulation", "floor"}
    assert results[0].gradients.error["floor"].shape == (count, 3)


def test_a_factor_that_exposure_takes_away_does_not_count(scene, monkeypatch):
    """A common factor of 30 % is taken by the exposure; the red channel's alone is not."""
    layers = layers_of(scene[0].contact, scene[0].no_contact, inputs=known(0.3))
    comparison = compare(layers, scene[1], inputs=inputs_for(layers), fit_exposure=True)
    drawn = comparison.inputs.draw(2000, np.random.default_rng(5))
    weights = comparison.channel_weights
    spreads = []
    for name in ("LED", "red response"):
        alone = drawn.only(name)
        exposure = comparison.exposure_of(alone.matrix)
        error = comparison.sums[-1].simulation(alone.weights, exposure, alone.drift)
        spreads.append(float((error @ weights / (comparison.sums[-1].signal(np.ones(1)) @ weights)).std()))
    assert spreads[0] < 1e-6
    assert spreads[1] > 0.1


def test_draws_are_those_of_the_record_the_pose_and_the_drift():
    press, capture = twin(np.random.default_rng(0)).press, twin(np.random.default_rng(0)).capture
    images = prepare_images(press, capture)
    pad = np.isfinite(images.distance)
    inputs = inputs_of(images.layers, capture, images.captured.no_contact, images.captured.repeat, pad)
    names = ("red paint", "green paint", "camera response", "depth of the indenter", WALLS, "drift of the light")
    assert inputs.names == names
    draws = 20_000
    drawn = inputs.draw(draws, np.random.default_rng(1))
    camera = drawn.log_factors["camera response"][:, :, 0]
    # stored are 1000 draws of a normal logarithm: 2 % of their spread, and four standard errors
    assert camera.std(axis=0) == pytest.approx(CAMERA_SD, rel=4.0 / np.sqrt(2.0 * 1000.0))
    assert drawn.moves_mm["depth of the indenter"].std() == pytest.approx(DEPTH_SD_MM, rel=4.0 / np.sqrt(2.0 * draws))
    # scale from three observations of 0.7 % and the one between the repeats, four degrees of freedom
    before, after = images.captured.no_contact, images.captured.repeat
    change = after.sum() / before.sum() - 1.0
    scale = np.sqrt((3.0 * 0.007**2 + change**2) / 4.0)
    assert inputs.drift == (pytest.approx(scale), 4)
    # quartiles of a Student t with 4 degrees of freedom lie at 0.7407; sd of one: sqrt(3 / 16 n) / density 0.2733
    quartile = np.quantile(drawn.log_drift, 0.75)
    assert quartile == pytest.approx(0.7407 * scale, rel=4.0 * np.sqrt(3.0 / 16.0 / draws) / 0.2733 / 0.7407 + 0.002)
    # the LED's own light comes from no wall
    walls = drawn.log_factors[WALLS]
    assert (walls[..., 2] == 0.0).all()
    assert (walls[:, 0] == walls[:, 1]).all()
    assert 0.005 < walls[..., 0].std() < 0.05
    assert drawn.matrix[7] == pytest.approx(
        MATRIX * np.exp(sum(np.asarray(f[7]) for f in drawn.log_factors.values())), rel=1e-12
    )


def test_reports_on_the_same_paints_share_their_draws():
    """Draws in stored order do not depend on the capture's generator; those of the capture do."""
    layers = layers_of(*smooth_layers()[::-1], inputs=known(0.1))
    inputs = inputs_for(layers, drift=(0.005, 4))
    one, other = (inputs.draw(50, np.random.default_rng(seed), paired=True) for seed in (1, 2))
    assert (one.log_factors["LED"] == other.log_factors["LED"]).all()
    assert one.log_factors["LED"][:, 0, 0] == pytest.approx(np.log(known(0.1).factors[0, :50, 0, 0]))
    assert not (one.log_drift == other.log_drift).any()


def test_factors_stay_positive_whatever_their_tails_say():
    layers = layers_of(*smooth_layers()[::-1], inputs=known(0.1).model_copy(update={"factors": -np.ones((2, 5, 3, 3))}))
    drawn = inputs_for(layers, drift=(5.0, 3), walls=(np.full(3, 5.0), 3)).draw(1000, np.random.default_rng(0))
    assert (drawn.matrix > 0.0).all()
    assert (drawn.drift > 0.0).all()


def test_no_region_is_refused(scene):
    with pytest.raises(CompareError, match="no region to compare is given; give the contact region"):
        compare(*scene, regions=())


def test_other_grids_are_refused(scene):
    layers, captured = scene
    with pytest.raises(CompareError, match="All images must have the same shape"):
        compare(layers_of(layers.contact[:-1], layers.no_contact[:-1]), captured)
    small = Region("contact", np.ones((3, 3), bool), 1.0)
    with pytest.raises(CompareError, match=r"mask has shape \(3, 3\) but the images are 48 x 64 px"):
        compare(layers, captured, regions=[small])


def test_clipped_everywhere_is_refused(scene):
    layers, captured = scene
    contact = np.full_like(captured.contact, np.nan)
    with pytest.raises(CompareError, match=r"None of the \d+ pixels of the region is usable"):
        compare(layers, captured_of(contact, captured.no_contact))


@pytest.mark.parametrize(
    "noise", [CaptureNoise(np.zeros(3), np.zeros(3)), CaptureNoise(np.full(3, 400.0), np.zeros(3))]
)
def test_a_contact_that_changes_nothing_beyond_noise_is_refused(scene, noise):
    layers, captured = scene
    rng = np.random.default_rng(8)
    sd = np.sqrt(noise.offset)
    images = [captured.no_contact + sd * rng.standard_normal(captured.contact.shape) for _ in range(2)]
    with pytest.raises(CompareError, match="contact changes nothing in the region 'contact' beyond the camera's noise"):
        compare(layers, captured_of(*images, noise=noise))
    # the press itself is seen through the same noise
    assert compare(layers, captured_of(captured.contact + images[0] - captured.no_contact, images[1], noise=noise))


def test_a_region_may_be_the_whole_image(scene):
    comparison = compare(*scene, regions=[Region("all", EVERYWHERE, 2.0)])
    assert comparison.used[0].all()
    assert comparison.gradients[0].where.sum() == (SHAPE[0] - 2) * (SHAPE[1] - 2)
