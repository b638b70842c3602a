"""A lens found from a board: against OpenCV's own covariance, and where it cannot be found."""

import cv2
import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.sensing import calibrate_lens
from finray_calib.sensing._lens_calibration import LEAST_VIEWS, adjust, project
from tests.compare.board_scenes import (
    FISHEYE,
    PINHOLE,
    PLACES_MM,
    SIZE_PX,
    board_views,
    pose_of,
    poses,
)

# the largest of 60 normal values exceeds it once in 2000 tries
CHANCE_SD = 4.5


@pytest.mark.parametrize(("model", "lens"), [("fisheye", FISHEYE), ("pinhole", PINHOLE)])
def test_the_lens_is_found_within_its_uncertainty(model, lens):
    rng = np.random.default_rng(2)
    found = calibrate_lens(board_views(model, lens, poses(model, lens, rng, 10), rng), SIZE_PX, model)
    z = (found.lens - lens) / np.sqrt(np.diag(found.covariance)[: len(lens)])
    assert np.abs(z).max() < CHANCE_SD
    # standard deviation of a standard deviation from this many residuals
    assert found.corner_sd_px == pytest.approx(0.1, rel=CHANCE_SD / np.sqrt(2.0 * found.degrees_of_freedom))
    assert found.focal_u_rel < 0.01


def test_the_covariance_is_that_of_opencv():
    rng = np.random.default_rng(3)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 10), rng)
    found = calibrate_lens(views, SIZE_PX, "pinhole")
    places = [np.column_stack([v.places_mm, np.zeros(len(v.places_mm))]).astype(np.float32) for v in views]
    theirs = cv2.calibrateCameraExtended(places, [v.pixels.astype(np.float32) for v in views], SIZE_PX, None, None)
    assert np.sqrt(np.diag(found.covariance)[:9]) == pytest.approx(theirs[5].ravel()[:9], rel=1e-4)
    assert found.lens[:4] == pytest.approx(theirs[1][[0, 1, 0, 1], [0, 1, 2, 2]], abs=1e-3)


@pytest.mark.parametrize(("model", "lens"), [("fisheye", FISHEYE), ("pinhole", PINHOLE)])
def test_derivatives_are_those_of_the_projection(model, lens):
    pose = pose_of([0.3, -0.2, 0.1], (0.5, 0.2, 15.0))
    places = np.column_stack([PLACES_MM, np.zeros(len(PLACES_MM))])
    values = np.concatenate([lens, pose])
    _, columns = project(model, lens, pose, places)
    for index in range(len(values)):
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            moved[index] += sign * 1e-5
            ends.append(project(model, moved[: len(lens)], moved[len(lens) :], places)[0])
        numeric = (ends[0] - ends[1]) / 2e-5
        assert columns[..., index] == pytest.approx(numeric, abs=1e-5 * max(1.0, float(np.abs(numeric).max())))


def test_a_picture_that_counts_twice_is_two_pictures():
    rng = np.random.default_rng(4)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 6), rng)
    once = calibrate_lens(views, SIZE_PX, "pinhole")
    weights = np.ones(len(views))
    weights[1] = 2.0
    weighted = adjust(views, SIZE_PX, "pinhole", once.lens, once.poses, weights)
    twice = adjust([*views, views[1]], SIZE_PX, "pinhole", once.lens, np.concatenate([once.poses, once.poses[1:2]]))
    assert weighted.lens == pytest.approx(twice.lens, rel=1e-6, abs=1e-6)


def test_too_few_pictures_are_refused():
    rng = np.random.default_rng(5)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, LEAST_VIEWS - 2), rng)
    with pytest.raises(CompareError, match=r"3 usable pictures .* are too few to calibrate a lens; give at least 4"):
        calibrate_lens(views, SIZE_PX, "pinhole")


def test_boards_that_are_not_tilted_leave_the_focal_length_open():
    rng = np.random.default_rng(6)
    flat = [
        pose_of([0.0, 0.0, turn], (x, 0.0, z))
        for turn, x, z in zip((0, 0.3, 1, 2, 3), (-2, 0, 1, 2, 0), (15, 16, 15, 14, 15), strict=True)
    ]
    views = board_views("pinhole", PINHOLE, flat, rng, noise_px=0.3)
    with pytest.raises(CompareError, match=r"poses of the board are too similar|do not determine"):
        calibrate_lens(views, SIZE_PX, "pinhole")


def test_a_board_that_is_not_what_it_is_said_to_be_leaves_residuals():
    rng = np.random.default_rng(7)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 8), rng)
    bent = [type(v)(v.name, v.places_mm, v.pixels + 12.0 * np.sin(v.places_mm[:, ::-1])) for v in views]
    with pytest.raises(CompareError, match="Check that the board is flat"):
        calibrate_lens(bent, SIZE_PX, "pinhole")


def test_a_calibration_that_fails_says_what_to_do(monkeypatch):
    rng = np.random.default_rng(8)
    views = board_views("fisheye", FISHEYE, poses("fisheye", FISHEYE, rng, 5), rng)

    def fails(*arguments, **options):
        raise cv2.error("CALIB_CHECK_COND - Ill-conditioned matrix")

    monkeypatch.setattr(cv2.fisheye, "calibrate", fails)
    with pytest.raises(CompareError, match="the fisheye calibration failed"):
        calibrate_lens(views, SIZE_PX, "fisheye")


def test_corners_that_determine_nothing_are_refused():
    rng = np.random.default_rng(9)
    views = board_views("pinhole", PINHOLE, [pose_of([0.1, 0.0, 0.0], (0.0, 0.0, 15.0))], rng)
    pair = [type(v)(v.name, v.places_mm[:4], v.pixels[:4]) for v in views]
    with pytest.raises(CompareError, match="do not determine a pinhole lens"):
        adjust(pair, SIZE_PX, "pinhole", PINHOLE, np.array([pose_of([0.1, 0.0, 0.0], (0.0, 0.0, 15.0))]))
