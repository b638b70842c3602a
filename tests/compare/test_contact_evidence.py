"""A touch is local: drifts of light and camera are refused as contact, weak touches are not."""

import numpy as np
import pytest
from scipy.ndimage import shift

from data_schemas.errors import CompareError
from finray_calib.compare import stopping_rule
from finray_calib.compare.capture_noise import NO_NOISE
from finray_calib.compare.comparison_record import DILATED, compare_press
from finray_calib.compare.contact_evidence import require_touch
from finray_calib.compare.region_sums import Captured
from finray_calib.compare.regions import Region
from tests.compare.twins import twin

SEEDS = 40
# of refusals by chance: three standard errors one-sided are 0.1 %, and tiles are few
MOST_BY_CHANCE = 2


@pytest.fixture(autouse=True)
def _few_draws(monkeypatch):
    monkeypatch.setattr(stopping_rule, "BLOCK_DRAWS", 500)


@pytest.fixture(scope="module")
def made():
    return twin(np.random.default_rng(0))


def with_contact(capture, light):
    """Return the capture with another contact image, in light above the black level."""
    counts = np.clip(np.rint(light + capture.black_level_dn), 0, 2**capture.bit_depth - 1)
    return capture.model_copy(update={"contact": counts.astype(np.uint16)})


def light_of(capture):
    """Return contact, no contact and repeat above the black level."""
    images = (capture.contact, capture.no_contact, capture.repeat_no_contact)
    return tuple(image.astype(float) - capture.black_level_dn for image in images)


ACROSS = np.linspace(-1.0, 1.0, 80)[None, :, None]
DRIFTS = {
    "darker": lambda image: 0.9 * image,
    "brighter": lambda image: 1.05 * image,
    "one channel": lambda image: image * np.array([1.0, 1.1, 1.0]),
    "uneven": lambda image: image * (1.0 + 0.05 * ACROSS),
    "stray light": lambda image: image + 20.0,
    "shifted": lambda image: shift(image, (0.4, -0.3, 0.0), order=1, mode="nearest"),
    "all of it": lambda image: shift(1.03 * image + 5.0, (0.2, 0.2, 0.0), order=1, mode="nearest"),
}


@pytest.mark.parametrize("drift", DRIFTS.values(), ids=DRIFTS)
def test_a_drift_without_touch_is_no_contact(made, drift):
    _, _, again = light_of(made.capture)
    with pytest.raises(CompareError, match=r"shows no touch in the region 'contact patch dilated 2x': .* as a drift"):
        compare_press(made.press, with_contact(made.capture, drift(again)), seed=1)


def test_the_change_of_the_level_is_told(made):
    _, _, again = light_of(made.capture)
    with pytest.raises(
        CompareError, match=r"image, 0\.9\d\d, 0\.9\d\d, 0\.9\d\d times as bright in red, green, blue, as"
    ):
        compare_press(made.press, with_contact(made.capture, 0.95 * again), seed=1)


@pytest.mark.parametrize("share", [0.3, 0.05])
@pytest.mark.parametrize("drift", [lambda image: image, DRIFTS["brighter"]], ids=["steady", "drifting"])
def test_a_weak_touch_is_judged_over_blocks(made, share, drift):
    contact, without, again = light_of(made.capture)
    weak = with_contact(made.capture, drift(again + share * (contact - without)))
    report = compare_press(made.press, weak, seed=1)
    assert report.headline_region == DILATED
    if share < 0.1:
        # pixel by pixel this touch drowns in noise
        assert report.block_px > 1


def test_no_touch_is_hardly_ever_taken_for_one(made):
    """Fresh noise of the twin's size on a drifting picture, for many seeds; and a weak touch is always seen."""
    contact, without, _ = light_of(made.capture)
    sd = np.sqrt(np.maximum(without, 0.0) * 0.5 + 4.0)
    distance = made.press.distance.astype(float)
    region = Region("headline", distance <= 2.0, 2.0)
    weights = 1.0 / without.mean(axis=(0, 1)) ** 2
    taken, missed = 0, 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        first, second, third = (without + sd * rng.standard_normal(without.shape) for _ in range(3))
        drifted = (1.0 + 0.05 * rng.standard_normal()) * third
        for image, is_touch in ((drifted, False), (drifted + 0.3 * (contact - without), True)):
            try:
                require_touch(Captured(image, first, second, NO_NOISE), distance, region, region.mask, weights)
                taken += not is_touch
            except CompareError:
                missed += is_touch
    assert taken <= MOST_BY_CHANCE
    assert missed == 0


def scene(rows=40, columns=60):
    """Return a smooth pad and distances that reach 6 half-widths."""
    y, x = np.mgrid[:rows, :columns]
    pad = np.stack([100.0 + x, 150.0 - y, 120.0 + 0.5 * x], axis=-1)
    return pad, np.abs(x - columns / 2.0) / 5.0


def test_without_a_surround_the_drift_is_fitted_to_all_of_the_pad():
    pad, distance = scene()
    near = distance / 4.0
    region = Region("all", near <= 2.0, 2.0)
    touched = pad * (1.0 - 0.3 * np.exp(-(distance**2)))[..., None]
    require_touch(Captured(touched, pad, None, NO_NOISE), near, region, region.mask, np.ones(3))
    with pytest.raises(CompareError, match="shows no touch in the region 'all'"):
        require_touch(Captured(1.2 * pad, pad, None, NO_NOISE), near, region, region.mask, np.ones(3))


def test_the_message_tells_what_a_repeat_shows():
    pad, distance = scene()
    region = Region("patch", distance <= 2.0, 2.0)
    dent = 10.0 * np.exp(-(distance**2))[..., None] * np.ones(3)
    with pytest.raises(CompareError, match=r"a repeat of the no-contact image by [1-9]\.\d\d%"):
        require_touch(Captured(1.1 * pad, pad, pad + dent, NO_NOISE), distance, region, region.mask, np.ones(3))


def test_clipped_pixels_do_not_count():
    pad, distance = scene()
    region = Region("patch", distance <= 2.0, 2.0)
    touched = pad - 10.0 * np.exp(-(distance**2))[..., None]
    touched[:5] = np.nan
    require_touch(Captured(touched, pad, None, NO_NOISE), distance, region, region.mask, np.ones(3))
