"""Sizes in mm of what a comparison looks at, and a scale that belongs to another camera."""

import re

import numpy as np
import pytest

from data_schemas import CompareError, NormalMapRecord
from finray_calib.compare import CheckOptions, compare_checked
from finray_calib.reports import comparison_page
from finray_calib.sensing import BoardUncertainty, patch_scale, pixel_scale, with_measured_scale
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
    return pixel_scale(views[0], views[1:], SIZE_PX, BOARD, BoardUncertainty(0.002), 1, "pinhole")


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
            any(re.search(r"states 0\.2 mm per pixel, but .* at the patch is 0\.(4|39|40)", f) for f in report.findings)
            is told
        )


def test_a_scale_of_another_picture_is_refused(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    other = scale.model_copy(update={"calibration": scale.calibration.model_copy(update={"width_px": 640})})
    with pytest.raises(
        CompareError, match="was measured on pictures of 640 x 60 px, but capture of the strip has 80 x 60 px"
    ):
        patch_scale(other, capture, simulated.distance, FACTORS)


def test_a_plane_that_is_not_seen_is_refused(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    # the plane stands on edge, beyond the left border of the picture
    place = tuple(pose_of([0.0, np.pi / 2, 0.0], (-40.0, 0.0, 20.0)))
    with pytest.raises(
        CompareError, match="the pixel scale is not known to 5 % at column 40, row 30, the middle of the patch"
    ):
        patch_scale(scale.model_copy(update={"place": place}), capture, simulated.distance, FACTORS)


def map_taught_at(mm_per_px):
    """Return a map of the strip's size that was taught at a scale."""
    return NormalMapRecord(
        name="map", degree=1, coefficients=np.zeros((6, 2)), lowest_change_rel=-np.ones(3),
        highest_change_rel=np.ones(3),
        height_px=60, width_px=80, mm_per_px=mm_per_px, encoding="linear", presses=14,
        held_out_explained_rel=np.array([0.9]), held_out_angle_deg=np.array([2.0]),
    )  # fmt: skip


def test_a_planned_scale_is_replaced_by_the_measured_one_before_sensing(scale):
    """The ball plan runs with the planned value; its map is taught with the measured one, and so is the comparison."""
    simulated = press()
    capture = capture_of(simulated, 50.0).model_copy(update={"mm_per_px": 1.15 * MM_PER_PX, "mm_per_px_u_rel": 0.2})
    normal_map = map_taught_at(with_measured_scale(capture, scale).mm_per_px)
    with pytest.raises(CompareError, match=r"or give the measured scale \(--scale\) if the capture states a planned"):
        compare_checked(simulated, capture, 1, CheckOptions(normal_map=normal_map))
    report, _ = compare_checked(simulated, capture, 1, CheckOptions(normal_map=normal_map, pixel_scale=scale))
    assert report.sensing is not None
    assert not any(finding.startswith("scale:") for finding in report.findings)


def test_a_large_patch_is_not_cut_short(scale):
    """More pixels than are looked at for the range of the scale: extents still reach from border to border."""
    shape = (480, 640)
    lens = scale.calibration.model_copy(
        update={"width_px": 640, "height_px": 480, "focal_px": (400.0, 400.0), "centre_px": (319.5, 239.5)}
    )
    large = scale.model_copy(update={"calibration": lens})
    raw = np.zeros((*shape, 3), dtype=np.uint16)
    capture = capture_of(press(), 50.0).model_copy(update={"contact": raw, "no_contact": raw, "repeat_no_contact": raw})
    rows, columns = np.indices(shape)
    distance = np.hypot(columns - 320, rows - 240) / 150.0
    found = patch_scale(large, capture, distance, {"contact patch": 1.0})
    # columns 170 to 470; one pixel less would be 3e-3, the fitted tilt of the plane changes the scale by below 1e-3
    assert found.extents[0].along_x_mm == pytest.approx(301 * found.middle.along_x_mm_per_px, rel=1e-3)
    assert found.extents[0].along_y_mm == pytest.approx(301 * found.middle.along_y_mm_per_px, rel=1e-3)


def test_an_empty_patch_is_refused(scale):
    simulated = press()
    capture = capture_of(simulated, 50.0)
    with pytest.raises(CompareError, match="no pixel of the render lies within 1 half-width of the contact"):
        patch_scale(scale, capture, simulated.distance + 1.5, FACTORS)
