"""A weak touch is judged over blocks of pixels, where single ones hold more noise than signal."""

import numpy as np
import pytest

from finray_calib.compare import DILATED, compare_press
from finray_calib.compare import _input_draws as stopping_rule
from tests.compare.twins import twin


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


@pytest.mark.parametrize("share", [0.3, 0.05])
@pytest.mark.parametrize("drift", [lambda image: image, lambda image: 1.05 * image], ids=["steady", "drifting"])
def test_a_weak_touch_is_judged_over_blocks(made, share, drift):
    contact, without, again = light_of(made.capture)
    weak = with_contact(made.capture, drift(again + share * (contact - without)))
    report = compare_press(made.press, weak, seed=1)
    assert report.headline_region == DILATED
    if share < 0.1:
        # pixel by pixel this touch drowns in noise
        assert report.block_px > 1
