"""Millimetres per pixel: against a scale solved for directly, and whether intervals cover it as often as they claim."""

import numpy as np
import pytest
from scipy.stats import binom

from data_schemas import CompareError
from finray_calib.sensing import BoardUncertainty, BoardView, calibrate_lens, find_board, pixel_scale, require_plausible
from finray_calib.sensing._lens_calibration import POSE, adjust, refined_views
from finray_calib.sensing._pixel_scale import (
    ScaleDraws,
    SeenPlane,
    plane_places_mm,
    plane_scale,
    scales_only,
    seen_plane,
    widened_factor,
)
from tests.compare.board_scenes import (
    BOARD,
    FISHEYE,
    PINHOLE,
    PLACES_MM,
    SIZE_PX,
    board_views,
    picture,
    pose_of,
    poses,
    projected,
    true_scale,
)

LENSES = [("fisheye", FISHEYE), ("pinhole", PINHOLE)]
PIXELS = np.array([[330.0, 235.0], [200.0, 160.0]])
TRIALS = 60
# of each coverage count: both ends together, so that one of the twelve counts below fails by chance once in 500 seeds
CHANCE = 1.0 / 6000.0


def known(model, lens, pose, **more):
    """Return a plane without uncertainty."""
    size = len(lens) + POSE
    return SeenPlane(model, lens, pose, np.zeros((size, size)), **more)


@pytest.mark.parametrize(("model", "lens"), LENSES)
def test_the_scale_is_the_step_on_the_plane(model, lens):
    pose = pose_of([0.3, -0.2, 0.1], (0.5, -0.3, 15.0))
    found = scales_only(known(model, lens, pose), PIXELS)
    for row, pixel in zip(found, PIXELS, strict=True):
        # a step of 0.05 px each way: the third derivative of the scale is far below 1e-5
        assert row[:2] == pytest.approx(true_scale(model, lens, pose, pixel), rel=1e-6)
    places = plane_places_mm(known(model, lens, pose), PIXELS)
    assert projected(model, lens, pose, places) == pytest.approx(PIXELS, abs=1e-6)


def test_a_board_seen_straight_on_has_the_scale_of_a_pinhole():
    lens = np.array([400.0, 500.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    plane = known("pinhole", lens, pose_of([0.0, 0.0, 0.0], (0.0, 0.0, 20.0)), behind_mm=5.0)
    assert scales_only(plane, PIXELS) == pytest.approx(
        np.tile([25.0 / 400.0, 25.0 / 500.0, 25.0 / np.sqrt(400.0 * 500.0)], (2, 1)), rel=1e-9
    )


def test_the_coat_lies_behind_the_board_whichever_way_its_axes_point():
    # turned over, the normal of the board points at the camera
    for turn in ([0.0, 0.0, 0.0], [np.pi, 0.0, 0.0]):
        near = scales_only(known("pinhole", PINHOLE, pose_of(turn, (0.0, 0.0, 20.0))), PIXELS)
        far = scales_only(known("pinhole", PINHOLE, pose_of(turn, (0.0, 0.0, 20.0)), behind_mm=2.0), PIXELS)
        assert far / near == pytest.approx(np.full((2, 3), 1.1), rel=1e-9)


def test_declared_tolerances_enter_as_they_are():
    size = len(PINHOLE) + POSE
    pose = pose_of([0.0, 0.0, 0.0], (0.0, 0.0, 20.0))
    plane = SeenPlane("pinhole", PINHOLE, pose, np.zeros((size, size)), 0.0, 0.2, 0.003)
    found = plane_scale(plane, PIXELS)
    assert found.parts_rel["printed squares"] == pytest.approx(np.full((2, 3), 0.003))
    assert found.parts_rel["distance of the coat from the board"] == pytest.approx(np.full((2, 3), 0.01), rel=1e-3)
    assert found.u_rel == pytest.approx(np.full((2, 3), np.hypot(0.003, 0.01)), rel=1e-3)


def test_where_the_plane_is_not_seen_there_is_no_scale():
    # seen from the side: the upper half of the picture looks past the plane
    plane = known("pinhole", PINHOLE, pose_of([1.4, 0.0, 0.0], (0.0, 0.0, 20.0)))
    found = scales_only(plane, np.array([[320.0, 5.0], [320.0, 470.0]]))
    assert np.isfinite(found).all(axis=1).sum() == 1


@pytest.mark.parametrize(("model", "lens"), LENSES)
def test_intervals_cover_the_true_scale(model, lens):
    """95 % intervals, squares of an unknown true size included; 400 trials each gave 93 to 97 %."""
    rng = np.random.default_rng(11)
    places = poses(model, lens, rng, 10)
    truth = scales_only(known(model, lens, places[0]), PIXELS)
    square_u = 5e-4
    hits = np.zeros(truth.shape, dtype=int)
    for _ in range(TRIALS):
        views = board_views(model, lens, places, rng, square_error_rel=rng.normal(0.0, square_u))
        found = adjust(views, SIZE_PX, model, lens, np.array(places))
        size = len(lens) + POSE
        plane = SeenPlane(model, found.lens, found.poses[0], found.covariance[:size, :size], square_u_rel=square_u)
        scale = plane_scale(plane, PIXELS)
        hits += np.abs(np.log(scale.mm_per_px / truth)) < 1.959964 * scale.u_rel
    least, most = binom.ppf([CHANCE / 2.0, 1.0 - CHANCE / 2.0], TRIALS, 0.95)
    assert (hits >= least).all()
    assert (hits <= most).all()
    # intervals twice too wide would miss one value in 16 000
    assert hits.sum() < hits.size * TRIALS


@pytest.fixture(scope="module")
def seen():
    """Pictures of the board through the fisheye lens, with noise; the first on the pad."""
    rng = np.random.default_rng(5)
    places = poses("fisheye", FISHEYE, rng, 6)
    images = []
    for pose in places:
        noisy = picture("fisheye", FISHEYE, pose) + rng.normal(0.0, 2.0, SIZE_PX[::-1])
        images.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return places, {f"board-{k}.png": image for k, image in enumerate(images)}


def test_from_pictures_to_the_scale(seen):
    places, images = seen
    views = [find_board(image, BOARD, name) for name, image in images.items()]
    record = pixel_scale(views[0], views[1:], SIZE_PX, BOARD, BoardUncertainty(0.001), 1, pictures=images)
    middle = record.middle
    truth = true_scale("fisheye", FISHEYE, places[0], np.array([middle.column_px, middle.row_px]))
    # corners of rendered pictures err by a few hundredths of a pixel, partly together
    assert middle.along_x_mm_per_px == pytest.approx(truth[0], rel=1e-3)
    assert middle.along_y_mm_per_px == pytest.approx(truth[1], rel=1e-3)
    assert record.calibration.model == "fisheye"
    assert np.sqrt(sum(line.u_rel**2 for line in record.budget)) == pytest.approx(middle.mean_u_rel)
    # the edge of a wide picture: a pixel spans more of the pad, and the map says so
    over = record.over_board
    assert over.along_x_low_mm_per_px <= middle.along_x_mm_per_px <= over.along_x_high_mm_per_px
    again = plane_scale(seen_plane(record), np.array([[middle.column_px, middle.row_px]]))
    assert again.mm_per_px[0, 2] == pytest.approx(middle.mean_mm_per_px)
    assert again.u_rel[0, 2] == pytest.approx(middle.mean_u_rel)
    assert np.isfinite(record.map_mm_per_px[12, 16]).all()


def test_corners_found_in_the_plane_of_the_board_are_nearer(seen):
    places, images = seen
    views = [find_board(image, BOARD, name) for name, image in images.items()]
    lens = calibrate_lens(views, SIZE_PX, "fisheye")
    refined = refined_views(views, images, lens, BOARD)

    def error_px(found):
        return np.sqrt(
            np.mean(
                [
                    ((v.pixels - projected("fisheye", FISHEYE, pose, v.places_mm)) ** 2).sum(axis=1).mean()
                    for v, pose in zip(found, places, strict=True)
                ]
            )
        )

    assert error_px(refined) < 0.8 * error_px(views)
    assert refined_views(views, {}, lens, BOARD) == views


def test_a_mirror_changes_no_length(seen):
    _, images = seen
    grey = images["board-0.png"]
    direct, mirrored = find_board(grey, BOARD, "a"), find_board(np.ascontiguousarray(grey[:, ::-1]), BOARD, "b")
    assert mirrored.mirrored
    assert not direct.mirrored
    assert mirrored.pixels[:, 0] == pytest.approx(SIZE_PX[0] - 1 - direct.pixels[:, 0], abs=1e-9)
    assert mirrored.places_mm == pytest.approx(direct.places_mm)


def test_a_mirrored_board_gives_the_same_scale():
    rng = np.random.default_rng(12)
    places = poses("pinhole", PINHOLE, rng, 8)
    views = board_views("pinhole", PINHOLE, places, rng)
    mirrored_lens = PINHOLE.copy()
    mirrored_lens[2] = SIZE_PX[0] - 1 - PINHOLE[2]
    flipped = [
        BoardView(v.name, v.places_mm, np.column_stack([SIZE_PX[0] - 1 - v.pixels[:, 0], v.pixels[:, 1]]), True)
        for v in views
    ]
    plain, other = (
        pixel_scale(v[0], v[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole").middle for v in (views, flipped)
    )
    # p2, which bends along x, changes its sign under reflection: the models are one family
    assert other.along_x_mm_per_px == pytest.approx(plain.along_x_mm_per_px, rel=1e-6)
    assert other.along_y_mm_per_px == pytest.approx(plain.along_y_mm_per_px, rel=1e-6)


def test_pictures_that_err_together_widen_the_uncertainty():
    rng = np.random.default_rng(13)
    places = poses("pinhole", PINHOLE, rng, 10)
    good = board_views("pinhole", PINHOLE, places, rng)
    # another board in every picture: sheets bent by up to 2 % of their length
    bent = [
        BoardView(v.name, v.places_mm, projected("pinhole", PINHOLE, p, v.places_mm * (1.0 + rng.normal(0, 0.02, 2))))
        for v, p in zip(good, places, strict=True)
    ]
    honest = pixel_scale(good[0], good[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole")
    doubtful = pixel_scale(good[0], bent[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole")
    assert honest.widened_factor == 1.0
    assert honest.resampled_u_rel == pytest.approx(honest.middle.mean_u_rel, rel=0.5)
    assert doubtful.middle.mean_u_rel >= 0.99 * doubtful.resampled_u_rel
    assert doubtful.middle.mean_u_rel > 3.0 * honest.middle.mean_u_rel


def test_a_pad_picture_through_something_else_is_told():
    rng = np.random.default_rng(14)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 8), rng)
    pad = views[0]
    wavy = BoardView(pad.name, pad.places_mm, pad.pixels + 1.5 * np.sin(pad.places_mm[:, ::-1]))
    record = pixel_scale(wavy, views[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole")
    assert any("taken through the gel" in note for note in record.notes)


def views_of(rng, pad_pose, noise_px=0.1, count=6):
    """Return views with a pose of one's own on the pad."""
    places = [pad_pose, *poses("pinhole", PINHOLE, rng, count)[1:]]
    return board_views("pinhole", PINHOLE, places, rng, noise_px)


def test_a_board_seen_from_the_side_is_refused():
    views = views_of(np.random.default_rng(15), pose_of([1.35, 0.0, 0.0], (0.0, 0.0, 25.0)))
    with pytest.raises(CompareError, match=r"seen at 7\d deg from its normal, but at most 70 deg"):
        pixel_scale(views[0], views[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole")


def test_a_scale_that_is_hardly_known_is_refused():
    rng = np.random.default_rng(16)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 8), rng)
    with pytest.raises(
        CompareError, match=r"is 8 %, but at most 5 % is allowed; most of it comes from 'printed squares'"
    ):
        pixel_scale(views[0], views[1:], SIZE_PX, BOARD, BoardUncertainty(0.08), 1, "pinhole")


def test_few_pictures_beside_the_pad_are_refused():
    rng = np.random.default_rng(17)
    views = board_views("pinhole", PINHOLE, poses("pinhole", PINHOLE, rng, 3), rng)
    with pytest.raises(CompareError, match=r"3 usable pictures of .* are too few; give at least 4"):
        pixel_scale(views[0], views[1:], SIZE_PX, BOARD, BoardUncertainty(0.0), 1, "pinhole")


@pytest.mark.parametrize(("square_mm", "unit", "meant"), [(0.003, "metres", "3"), (3000.0, "micrometres", "3")])
def test_another_unit_is_recognised(square_mm, unit, meant):
    # LengthMm ends at 1000 mm, so a file cannot say 3000: only code that makes boards can
    board = BOARD.model_copy(update={"square_mm": square_mm, "marker_mm": square_mm * 0.7})
    with pytest.raises(CompareError, match=f"if it was given in {unit}, write square_mm = {meant},"):
        require_plausible(board)


def test_pictures_without_a_usable_board_are_refused(seen):
    _, images = seen
    grey = images["board-0.png"]
    with pytest.raises(CompareError, match=r"blank: only 0 of the 24 corners .* but at least 8"):
        find_board(np.full_like(grey, 128), BOARD, "blank")
    with pytest.raises(CompareError, match="of the 24 corners"):
        find_board(grey, BOARD.model_copy(update={"squares": (5, 7)}), "turned")
    with pytest.raises(CompareError, match="DICT_4X4_50 has only 50 markers, but a board of 12 x 9 squares needs 54"):
        find_board(grey, BOARD.model_copy(update={"squares": (12, 9)}), "large")


def test_a_board_that_is_too_small_or_a_line_is_refused(monkeypatch):
    seen = projected("pinhole", PINHOLE, pose_of([0.0, 0.0, 0.0], (0.0, 0.0, 15.0)), PLACES_MM)
    ids = np.arange(len(PLACES_MM))
    from finray_calib.sensing import _lens_calibration as board_corners

    def found(corners, numbers):
        return lambda grey, board: (numbers, corners.copy())

    grey = np.zeros(SIZE_PX[::-1], dtype=np.uint8)
    monkeypatch.setattr(board_corners, "_detected", found(300.0 + 0.05 * seen, ids))
    with pytest.raises(CompareError, match=r"too small .* a square has only 4\.\d px, but at least 8 px"):
        find_board(grey, BOARD, "far")
    wide = BOARD.model_copy(update={"squares": (10, 5)})
    monkeypatch.setattr(board_corners, "_detected", found(seen[:9], np.arange(9)))
    with pytest.raises(CompareError, match="lie on one line"):
        find_board(grey, wide, "edge")


def draws_with(corners_u, lens_u):
    """Return a scale whose parts are these."""
    parts = {"corners of the board on the pad": np.full((1, 3), corners_u), "lens": np.full((1, 3), lens_u)}
    return ScaleDraws(np.ones((1, 3)), np.full((1, 3), np.hypot(corners_u, lens_u)), parts)


def test_corners_without_error_leave_nothing_to_widen():
    assert widened_factor(0.0, draws_with(0.0, 0.0)) == 1.0
    assert widened_factor(3e-3, draws_with(8e-4, 6e-4)) == pytest.approx(3.0)


def test_a_scatter_beyond_all_bounds_is_refused():
    with pytest.raises(CompareError, match=r"scatters 2000 times as much .* at most 1000 times is allowed"):
        widened_factor(2e-3, draws_with(8e-7, 6e-7))
