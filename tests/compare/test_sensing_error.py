"""Depth from slopes against closed forms and a sparse solver; the sensing error of dents of known shape."""

import numpy as np
import pytest
from scipy.sparse import coo_array, vstack
from scipy.sparse.linalg import lsqr

from data_schemas import CompareError
from finray_calib.sensing import fit_normal_map, poisson_depth_mm, sensing_error
from finray_calib.sensing._normal_map import angles_deg
from tests.compare.three_lights import SHAPE_PX, ball_presses, dent_slopes, shaded

MM_PER_PX = 0.05
NO_CONTACT = shaded(np.zeros((*SHAPE_PX, 2)))
CENTRE = (30.0, 40.0)
RADIUS_PX = 11.0
INSIDE = np.hypot(*(np.indices(SHAPE_PX) - np.array(CENTRE)[:, None, None])) <= 0.9 * RADIUS_PX


@pytest.fixture(scope="module")
def fitted():
    return fit_normal_map(ball_presses(24, noise_dn=0.1), seed=1)


def test_a_quadratic_depth_comes_back_exactly():
    rows, columns = np.indices((13, 17)) * MM_PER_PX
    depth = 0.3 * columns**2 - 0.2 * rows**2 + 0.5 * rows * columns + 0.1 * columns - 0.4 * rows
    slopes = np.stack([0.6 * columns + 0.5 * rows + 0.1, -0.4 * rows + 0.5 * columns - 0.4], axis=-1)
    assert np.allclose(poisson_depth_mm(slopes, MM_PER_PX), depth - depth.mean(), atol=1e-12)


def test_slopes_of_no_surface_give_the_least_squares_solution_of_a_sparse_solver():
    rng = np.random.default_rng(2)
    shape = (6, 9)
    slopes = rng.normal(size=(*shape, 2))
    index = np.arange(np.prod(shape)).reshape(shape)
    equations, right = [], []
    for axis, component in ((1, 0), (0, 1)):
        first, second = (np.take(index, range(k, shape[axis] - 1 + k), axis).ravel() for k in (0, 1))
        ones = np.ones(len(first))
        at = np.arange(len(first))
        equations.append(
            coo_array((np.concatenate([-ones, ones]), (np.tile(at, 2), np.concatenate([first, second]))),
                      shape=(len(first), index.size))
        )  # fmt: skip
        flat = slopes[..., component].ravel()
        right.append(MM_PER_PX * (flat[first] + flat[second]) / 2.0)
    solved = lsqr(vstack(equations).tocsr(), np.concatenate(right), atol=1e-14, btol=1e-14)[0]
    expected = solved - solved.mean()
    assert np.allclose(poisson_depth_mm(slopes, MM_PER_PX).ravel(), expected, atol=1e-9)


def test_a_render_that_is_the_capture_has_no_error(fitted):
    image = shaded(dent_slopes(*CENTRE, RADIUS_PX))
    error = sensing_error(fitted, image, NO_CONTACT, image, NO_CONTACT, INSIDE, MM_PER_PX)
    assert (error.normal_angle_mean_deg, error.normal_angle_p95_deg, error.depth_rms_mm) == (0.0, 0.0, 0.0)
    assert error.pixels == INSIDE.sum()
    assert np.isnan(error.angle_deg[~INSIDE]).all()


def test_a_ball_of_another_radius_has_the_error_of_geometry(fitted):
    """Balls of 20 and 26 px in the same circle: angle and depth difference are closed forms."""
    slopes = [dent_slopes(*CENTRE, RADIUS_PX, ball_px) for ball_px in (20.0, 26.0)]
    images = [shaded(s) for s in slopes]
    error = sensing_error(fitted, images[1], NO_CONTACT, images[0], NO_CONTACT, INSIDE, MM_PER_PX)
    true_angle = angles_deg(slopes[0], slopes[1])[INSIDE]
    # the map itself errs by about a degree
    assert error.normal_angle_mean_deg == pytest.approx(true_angle.mean(), abs=0.7)
    assert error.normal_angle_p95_deg == pytest.approx(np.percentile(true_angle, 95), abs=1.5)
    radii = np.hypot(*(np.indices(SHAPE_PX) - np.array(CENTRE)[:, None, None]))[INSIDE]
    depths = [MM_PER_PX * (np.sqrt(b**2 - radii**2) - np.sqrt(b**2 - RADIUS_PX**2)) for b in (20.0, 26.0)]
    difference = depths[1] - depths[0]
    expected = np.sqrt(np.mean((difference - np.median(difference)) ** 2))
    assert error.depth_rms_mm == pytest.approx(expected, rel=0.25)


def test_clipped_pixels_are_left_out_and_strange_colours_are_counted(fitted):
    image = shaded(dent_slopes(*CENTRE, RADIUS_PX))
    clipped = image.copy()
    clipped[28:31, 38:41] = np.nan
    error = sensing_error(fitted, image + 500.0, NO_CONTACT, clipped, NO_CONTACT, INSIDE, MM_PER_PX)
    assert error.pixels == INSIDE.sum() - 9
    assert np.isnan(error.angle_deg[28:31, 38:41]).all()
    assert error.outside_share_simulated == 1.0
    assert error.outside_share_captured < 0.05


def test_a_region_without_a_usable_pixel_is_refused(fitted):
    nothing = np.full((*SHAPE_PX, 3), np.nan)
    with pytest.raises(CompareError, match="every pixel of the region is clipped or missing"):
        sensing_error(fitted, NO_CONTACT, NO_CONTACT, nothing, NO_CONTACT, INSIDE, MM_PER_PX)
