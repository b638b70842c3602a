"""Sizes in mm of what a comparison looks at, and a scale that belongs to another camera."""

import re

import numpy as np
import pytest

from data_schemas.errors import CompareError
from finray_calib.compare.checked_comparison import CheckOptions, compare_checked
from finray_calib.compare.patch_scale import patch_scale
from finray_calib.compare.pixel_scale_record import Declared, pixel_scale
from finray_calib.reports.comparison_page import comparison_page
from tests.command_line.records import capture_of, press
from tests.compare.board_scenes import BOARD, PINHOLE, board_views, pose_of, poses

# the pictures of the board at the size of the made-up press, 80 x 60 px; a lens without distortion, seen straight on
SIZE_PX = (80, 60)
LENS = np.array([50.0, 50.0, 39.5, 29.5, 0.0, 0.0, 0.0, 0.0, 0.0])
HEIGHT_MM = 20.0
MM_PER_PX = HEIGHT_MM / 50.0
FACTORS = {"contact patch": 1.0, "contact patch dilated 2x": 2.0}


@pytest.fixture(scope="module")
def scale():
    rng = np.random.default_rng(1)
    places = [pose_of([0.0, 0.0, 0.0], (0.0, 0.0, HEIGHT_MM)), *poses("pinhole", PINHOLE, rng, 8)[1:]]
    views = board_views("pinhole", LENS, places, rng, noise_px=0.01)
    return pixel_scale(views[0], views[1:], SIZE_PX, BOARD, Declared(0.002), 1, "pinhole")


def test_the_strip_has_its_size_in_mm(scale):
    simulated = press()
    found = patch_scale(scale, capture_of(simulated, 50.0), simulated.distance, FACTORS)
    # |column - 40| <= 12: 25 columns; 49 within twice that; all 60 rows
    for extent, columns in zip(found.extents, (25, 49), strict=True):
        assert extent.along_x_mm == pytest.approx(columns * MM_PER_PX, rel=0.01)
        assert extent.along_y_mm == pytest.approx(60 * MM_PER_PX, rel=0.01)
        # the ends lie anywhere in their pixels
        assert extent.along_x_u_mm >= MM_PER_PX / np.sqrt(6.0)
    assert found.middle.along_x_mm_per_px == pytest.approx(MM_PER_PX, abs=4 * found.middle.along_x_u_rel * MM_PER_PX)
    assert found.middle.along_x_u_rel >= 0.002
    assert (found.middle.column_px, found.middle.row_px) == pytest.approx((40.0, 29.5))


def test_a_bayer_cell_has_two_raw_pixels(scale):
    simulated = press()
    raw = np.zeros((60, 80, 1), dtype=np.uint16)
    capture = capture_of(simulated, 50.0).model_copy(
        update={"layout": "Bayer RGGB", "contact": raw, "no_contact": raw, "repeat_no_contact": raw}
    )
    found = patch_scale(scale, capture, simulated.distance[:30, 20:60], FACTORS)
    # 25 columns of cells, in the middle of 40
    assert found.extents[0].along_x_mm == pytest.approx(50 * MM_PER_PX, rel=0.01)
    assert found.middle.column_px == pytest.approx(2 * 20 + 0.5)


def test_the_comparison_states_the_scale_and_the_page_shows_it(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    report, shown = compare_checked(simulated, capture, 1, CheckOptions(pixel_scale=scale))
    assert report.patch_scale is not None
    assert not any(finding.startswith("scale:") for finding in report.findings)
    page = comparison_page(report, shown, capture, "finray compare", {})
    assert "mm per pixel at the middle of the patch" in page
    assert "the contact patch of the render is 10" in " ".join(page.split()).replace("\N{NO-BREAK SPACE}", " ")
    without, _ = compare_checked(simulated, capture, 1, CheckOptions())
    assert without.patch_scale is None
    assert "mm per pixel at the middle" not in comparison_page(without, shown, capture, "finray compare", {})


def test_another_scale_in_the_capture_is_told(scale):
    simulated = press()
    for stated, told in ((MM_PER_PX, False), (MM_PER_PX / 2.0, True)):
        capture = capture_of(simulated, 50.0).model_copy(update={"mm_per_px": stated})
        report, _ = compare_checked(simulated, capture, 1, CheckOptions(pixel_scale=scale))
        assert (
            any(re.search(r"states 0\.2 mm per pixel, the pixel scale 0\.(4|39|40)", f) for f in report.findings)
            is told
        )


def test_a_scale_of_another_picture_is_refused(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    other = scale.model_copy(update={"calibration": scale.calibration.model_copy(update={"width_px": 640})})
    with pytest.raises(CompareError, match="is of pictures of 640 x 60 px, capture of the strip has 80 x 60 px"):
        patch_scale(other, capture, simulated.distance, FACTORS)


def test_a_plane_that_is_not_seen_is_refused(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    # the plane stands on edge, beyond the left border of the picture
    place = tuple(pose_of([0.0, np.pi / 2, 0.0], (-40.0, 0.0, 20.0)))
    with pytest.raises(
        CompareError, match="at column 40, row 30, the middle of the patch, the pixel scale is not known to 5%"
    ):
        patch_scale(scale.model_copy(update={"place": place}), capture, simulated.distance, FACTORS)
