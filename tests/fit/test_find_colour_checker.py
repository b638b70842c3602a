import numpy as np
import pytest

from data_schemas import RadiometryError
from finray_calib.fit import find_colour_checker, linear_cells, patch_colours
from finray_calib.fit._colour_checker import LARGEST_MISMATCH_REL
from tests.radiometry.colour_checker_scene import patch_rgb, render

REFERENCE = patch_colours().xyz
# 1 % multiplicative and 2 DN additive noise over at least 9 cells, and the blur at the edges.
PATCH_TOLERANCE_REL = 0.03
PATCH_TOLERANCE_DN = 3.0


def assert_patches_right(found, temperature_k=5000.0):
    rgb, _ = patch_rgb(temperature_k)
    np.testing.assert_allclose(found.mean_dn, rgb, rtol=PATCH_TOLERANCE_REL, atol=PATCH_TOLERANCE_DN)


@pytest.mark.parametrize("turned_deg", [0, 90, 180, 250])
@pytest.mark.parametrize(
    ("width_px", "background", "temperature_k"),
    [(100, "table", 2856.0), (200, "cloth", 5000.0), (400, "paper", 6500.0)],
)
def test_a_chart_is_found_whatever_its_angle_size_and_light(turned_deg, width_px, background, temperature_k):
    rng = np.random.default_rng(width_px + turned_deg)
    image, centers = render(rng, width_px, turned_deg, 0.15, background, temperature_k)
    found = find_colour_checker(image, REFERENCE)
    assert_patches_right(found, temperature_k)
    # "dark skin" is the patch nearest to the first corner, in the chart's own orientation.
    assert np.linalg.norm(centers - found.corners_px[0], axis=1).argmin() == 0
    assert np.linalg.norm(centers - found.corners_px[2], axis=1).argmin() == 23
    # 1 % noise and 2 DN, over bright and dark patches
    assert (found.sd_dn < 0.03 * found.mean_dn + 6.0).all()


def test_the_mismatch_tells_a_chart_from_one_that_is_turned_shifted_or_mirrored():
    def mismatch(rgb):
        mapped = rgb @ np.linalg.lstsq(rgb, REFERENCE, rcond=None)[0]
        return np.linalg.norm(mapped - REFERENCE) / np.linalg.norm(REFERENCE - REFERENCE.mean(axis=0))

    rgb, _ = patch_rgb()
    wrong = [rgb[::-1], np.roll(rgb, 1, axis=0), np.roll(rgb, 6, axis=0), rgb.reshape(4, 6, 3)[:, ::-1].reshape(24, 3)]
    assert mismatch(rgb) < LARGEST_MISMATCH_REL / 2
    assert min(mismatch(w) for w in wrong) > 5 * LARGEST_MISMATCH_REL


def test_frames_without_a_chart_are_refused():
    rng = np.random.default_rng(1)
    image, _ = render(rng, 200, 0)
    with pytest.raises(RadiometryError, match=r"no ColorChecker was found in the frame of 512 x 640 cells"):
        find_colour_checker(np.abs(rng.normal(200, 20, image.shape)), REFERENCE)
    # The chart of another set of colours is seen by the detector and refused by its colours.
    recoloured = image[..., ::-1] ** 1.6
    with pytest.raises(
        RadiometryError,
        match=r"no ColorChecker was found .*\(the colours of the best candidate "
        r"differ by",
    ):
        find_colour_checker(recoloured, REFERENCE)


def test_clipped_patches_are_named():
    image, _ = render(np.random.default_rng(2), 200, 10)
    # White is the brightest patch (number 19): only it exceeds 90 % of the brightest value in all noise.
    image[(image > 0.9 * 800).any(axis=-1)] = np.nan
    with pytest.raises(RadiometryError, match=r"patches 19 of the ColorChecker are clipped"):
        find_colour_checker(image, REFERENCE)


def test_cells_are_dark_corrected_and_clipped_ones_are_marked():
    counts = np.tile(np.array([[100, 200], [220, 1023]], np.uint16), (2, 2))
    cells = linear_cells(counts, 16.0, 1023)
    assert cells.shape == (2, 2, 3)
    np.testing.assert_array_equal(cells[0, 0], [84, 194, np.nan])
