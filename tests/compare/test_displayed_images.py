import sys
from types import SimpleNamespace

import colour
import numpy as np
import pytest

from data_schemas import CompareError, MissingExtraError
from finray_calib.compare._displayed_images import (
    display_white_dn,
    displayed_image,
    flip_mean,
)


def test_linear_light_goes_through_the_curve_of_srgb():
    light = np.linspace(0, 1, 3000).reshape(-1, 10, 3)
    # colour-science, same standard
    assert displayed_image(400 * light, 400.0, linear=True) == pytest.approx(colour.cctf_encoding(light), abs=1e-12)


def test_encoded_values_are_shown_as_they_are_and_everything_is_clipped():
    image = np.array([[[-5.0, 51.0, 300.0], [np.nan, 0.0, 255.0]]])
    shown = displayed_image(image, 255.0, linear=False)
    assert shown[0, 0].tolist() == [0.0, 0.2, 1.0]
    assert np.isnan(shown[0, 1, 0])
    assert shown[0, 1, 1:].tolist() == [0.0, 1.0]


def test_white_is_the_brightest_half_per_cent_without_contact():
    image = np.arange(3000.0).reshape(10, 100, 3)
    image[0, 0, 0] = np.nan
    assert display_white_dn(image) == pytest.approx(np.percentile(np.arange(1.0, 3000), 99.5))
    for black in (np.zeros((4, 4, 3)), np.full((4, 4, 3), np.nan)):
        with pytest.raises(CompareError, match=r"no-contact image is black .* cannot be shown: check the light"):
            display_white_dn(black)
    with pytest.raises(CompareError, match="white level must be positive, got 0"):
        displayed_image(image, 0.0, linear=True)


def test_flip_is_asked_for_the_displayed_images_and_averaged_over_the_region(monkeypatch):
    """What is handed to the package and what is done with its answer; its numbers are its makers'."""
    asked = {}

    def evaluate(reference, test, dynamic_range, **settings):
        asked.update(reference=reference, test=test, dynamic_range=dynamic_range, **settings)
        return np.abs(reference - test).mean(axis=2, keepdims=True), -1.0, {}

    monkeypatch.setitem(sys.modules, "flip_evaluator", SimpleNamespace(evaluate=evaluate))
    reference, test = np.full((6, 8, 3), 0.5), np.full((6, 8, 3), 0.75)
    reference[0, 0, 0] = np.nan
    mask = np.zeros((6, 8), bool)
    mask[:3] = True
    test[3:] = 0.0
    assert flip_mean(reference, test, mask) == pytest.approx(0.25)
    assert asked["dynamic_range"] == "LDR"
    assert asked["parameters"] == {"ppd": 67.0}
    assert asked["inputsRGB"] is True
    assert asked["reference"][0, 0].tolist() == asked["test"][0, 0].tolist() == [0, 0, 0]
    assert asked["test"].dtype == np.float32


def test_flip_by_its_makers_program():
    pytest.importorskip("flip_evaluator")
    black, white = np.zeros((32, 32, 3)), np.ones((32, 32, 3))
    everywhere = np.ones((32, 32), bool)
    assert flip_mean(black, black, everywhere) == 0
    # the largest difference there is: the paper's scale ends at 1
    assert flip_mean(black, white, everywhere) == pytest.approx(1.0, abs=0.05)


def test_flip_of_a_region_is_that_of_the_whole_picture():
    """What lies farther from the region than the filters reach changes no digit."""
    program = pytest.importorskip("flip_evaluator")
    rng = np.random.default_rng(5)
    reference = rng.random((90, 120, 3))
    test = np.clip(reference + 0.1 * rng.standard_normal(reference.shape), 0.0, 1.0)
    rows, columns = np.indices(reference.shape[:2])
    for row, column in ((45, 60), (3, 116)):
        mask = np.hypot(rows - row, columns - column) < 12
        images = (image.astype(np.float32) for image in (reference, test))
        settings = {"inputsRGB": True, "applyMagma": False, "computeMeanError": False, "parameters": {"ppd": 67.0}}
        whole = np.asarray(program.evaluate(*images, "LDR", **settings)[0], dtype=np.float64).reshape(mask.shape)
        assert flip_mean(reference, test, mask) == whole[mask].mean()


def test_without_the_package_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[flip\]'"):
        flip_mean(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)), np.ones((4, 4), bool))
