"""Find corners of a board again in the plane of the board, where the lens bends no edge."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.tactile import CharucoBoard
from finray_calib.compare.board_corners import BoardView
from finray_calib.compare.lens_calibration import LensCalibration, project

Floats = NDArray[np.float64]

_HALF_SAMPLES = 10
#: A smaller neighbourhood is all blur.
_LEAST_HALF_PX = 3.0
#: Further away the point found is another one.
_LARGEST_MOVE_OF_WINDOW = 0.5


def refined_views(
    views: Sequence[BoardView],
    pictures: Mapping[str, NDArray[np.uint8]],
    lens: LensCalibration,
    board: CharucoBoard,
) -> list[BoardView]:
    """Return the views with corners found in rectified neighbourhoods.

    Least squares of grad I . (p - c) = 0: the corner is the point that all edges of its neighbourhood run through. In
    the picture edges are bent and slanted, which moves corners of a wide lens by tenths of a pixel, all alike: a board
    then seems larger than it is. The neighbourhood ends where markers begin.

    Parameters
    ----------
    views
        As they went into `lens`.
    pictures
        (H, W) by the name of the view; views without one stay as they are.
    lens
        Calibration by these views, good to a pixel.
    board
        What was printed.

    References
    ----------
    W. Foerstner, E. Guelch, ISPRS Intercommission Workshop, Interlaken (1987) 281; A. Datta, J.-S. Kim, T. Kanade, IEEE
    ICCV Workshops (2009) 1201.
    """
    half_mm = (board.square_mm - board.marker_mm) / 2.0
    return [
        view if view.name not in pictures else _refined(view, pictures[view.name], lens, pose, half_mm)
        for view, pose in zip(views, lens.poses, strict=True)
    ]


def _refined(
    view: BoardView, picture: NDArray[np.uint8], lens: LensCalibration, pose: Floats, half_mm: float
) -> BoardView:
    """Return a view with the corners that can be found again moved to where they are found."""
    axis = np.linspace(-half_mm, half_mm, 2 * _HALF_SAMPLES + 1)
    window = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    weight = np.exp(-(window**2).sum(axis=1) / half_mm**2)
    grey = picture.astype(np.float32)
    pixels = view.pixels.copy()
    for index, corner in enumerate(view.places_mm):
        around = _on_picture(lens, pose, corner + window)
        reach_px = np.linalg.norm(around - around.mean(axis=0), axis=1).max() / np.sqrt(2.0)
        inside = (around >= 0.0).all() and (around <= np.array([lens.width_px - 1, lens.height_px - 1])).all()
        if reach_px < _LEAST_HALF_PX or not inside:
            continue
        grid = around.astype(np.float32).reshape(len(axis), len(axis), 2)
        patch = cv2.remap(grey, grid[..., 0], grid[..., 1], cv2.INTER_CUBIC)
        move = _meeting_point(patch, window, weight)
        if move is not None and np.abs(move).max() <= _LARGEST_MOVE_OF_WINDOW * half_mm:
            pixels[index] = _on_picture(lens, pose, (corner + move)[None])[0]
    return BoardView(view.name, view.places_mm, pixels, view.mirrored)


def _meeting_point(patch: NDArray[np.number], window: Floats, weight: Floats) -> Floats | None:
    """Return the point of a neighbourhood (its own coordinates) that its edges run through; None without corner."""
    down, along = np.gradient(patch.astype(np.float64))
    gradients = np.column_stack([along.ravel(), down.ravel()])
    weighted = gradients * weight[:, None]
    normal = weighted.T @ gradients
    low, high = np.linalg.eigvalsh(normal)
    # edges in one direction only meet nowhere
    if low <= 0.05 * high:
        return None
    return np.asarray(np.linalg.solve(normal, weighted.T @ (gradients * window).sum(axis=1)))


def _on_picture(lens: LensCalibration, pose: Floats, places: Floats) -> Floats:
    """Return pixels (N, 2) of places (N, 2) on the board."""
    return project(lens.model, lens.lens, pose, np.column_stack([places, np.zeros(len(places))]))[0]
