import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.compare import Region, disc, strip_from_distance
from finray_calib.compare._regions import MINIMUM_TILES, tile_indices, tile_side_px, usable_pixels


def test_disc_has_the_area_of_a_circle():
    mask = disc((200, 300), (90.3, 140.8), 60.0)
    # Gauss's circle problem: the error of the pixel count is far below one perimeter.
    assert abs(int(mask.sum()) - np.pi * 60**2) < 2 * np.pi * 60 / 4
    rows, columns = np.nonzero(mask)
    assert abs(rows.mean() - 90.3) < 0.1
    assert abs(columns.mean() - 140.8) < 0.1


def test_disc_takes_row_before_column():
    mask = disc((20, 40), (5, 30), 0.0)
    assert np.argwhere(mask).tolist() == [[5, 30]]


def test_disc_outside_the_image_is_refused():
    with pytest.raises(CompareError, match=r"radius 3 px around row 30, column 5 has no pixel"):
        disc((20, 40), (30, 5), 3)


def test_strip_leaves_out_what_does_not_see_the_pad():
    distance = np.array([[0.0, 1.0, 1.01], [np.nan, 0.5, np.nan]])
    assert strip_from_distance(distance, 1.0).tolist() == [[True, True, False], [False, True, False]]
    with pytest.raises(CompareError, match=r"No pixel lies within 2 half-widths"):
        strip_from_distance(np.full((3, 3), np.nan), 2)


def test_region_is_checked_and_read_only():
    mask = np.eye(3, dtype=bool)
    region = Region("contact", mask, 1.0)
    mask[:] = False
    assert region.mask.sum() == 3
    with pytest.raises(ValueError, match="read-only"):
        region.mask[0, 0] = False
    with pytest.raises(CompareError, match=r"Region 'halo' is empty"):
        Region("halo", np.zeros((3, 3), bool), 2.0)
    with pytest.raises(CompareError, match=r"must be a boolean array .* got float64 of shape \(3, 3\)"):
        Region("halo", np.ones((3, 3)), 2.0)
    with pytest.raises(CompareError, match=r"got bool of shape \(3,\)"):
        Region("halo", np.ones(3, bool), 2.0)


def test_usable_pixels_drop_what_is_not_finite_and_refuse_wrong_shapes():
    image = np.ones((3, 4, 2))
    image[0, 0, 1] = np.nan
    image[2, 3, 0] = np.inf
    everywhere = np.ones((3, 4), bool)
    assert usable_pixels(everywhere, image, np.ones_like(image)).sum() == 10
    with pytest.raises(CompareError, match=r"the same shape .* \(3, 4, 2\), \(3, 4, 3\)"):
        usable_pixels(everywhere, image, np.ones((3, 4, 3)))
    with pytest.raises(CompareError, match=r"the same shape .* \(3, 4\)"):
        usable_pixels(everywhere, np.ones((3, 4)))
    with pytest.raises(CompareError, match=r"mask has shape \(4, 3\) but the images are 3 x 4 px"):
        usable_pixels(everywhere.T, image)
    with pytest.raises(CompareError, match=r"None of the 12 pixels of the region is usable"):
        usable_pixels(everywhere, np.full((3, 4, 1), np.nan))


def test_tiles_partition_the_region():
    mask = np.zeros((50, 70), bool)
    mask[3:43, 5:65] = True
    tile = tile_indices(mask, 16)
    # 40 x 60 px from the corner of the region: 3 x 4 tiles.
    assert np.unique(tile).tolist() == list(range(12))
    numbers = np.full(mask.shape, -1)
    numbers[mask] = tile
    assert np.ptp(numbers[3:19, 5:21]) == 0
    assert tile_side_px(mask) == 16


def test_tile_side_shrinks_for_small_regions():
    # 16 x 16 px: one tile of 16 px, four of 8 px, sixteen of 4 px.
    square = np.ones((16, 16), bool)
    assert tile_side_px(square) == 4
    small = disc((40, 40), (20, 20), 6.0)
    assert tile_indices(small, tile_side_px(small)).max() + 1 >= MINIMUM_TILES
    with pytest.raises(CompareError, match=r"has only 9 usable pixels, but an interval needs at least 12"):
        tile_side_px(np.ones((3, 3), bool))
