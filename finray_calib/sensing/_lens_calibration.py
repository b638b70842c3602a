"""Calibrate a lens from views of a flat board: its corners, then a bundle adjustment with uncertainties.

The corners of a ChArUco board are found in a picture, directly or through a mirror; otherwise the error gives the
reason. With a first calibration they are located again in the plane of the board, where the lens does not bend edges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CharucoBoard, CompareError, DistortionModel

Floats = NDArray[np.float64]

LEAST_CORNERS = 8
"""Of a view: six numbers of its pose leave ten of sixteen coordinates to judge it by."""
LEAST_SQUARE_PX = 8.0
"""Markers of 4 to 7 cells in a square any smaller are read by luck, and corners are off by tenths of a pixel."""
SQUARE_RANGE_MM = (0.2, 100.0)
"""No printer makes smaller squares, no finger holds larger ones; a factor of 1000 leaves the range from either end."""


@dataclass(frozen=True, slots=True)
class BoardView:
    """Corners of one picture of the board.

    Attributes
    ----------
    name
        File that it comes from.
    places_mm, pixels
        (N, 2) places on the board and where they are seen, (column, row) with whole numbers at pixel centres.
    mirrored
        The board was seen through an odd number of mirrors.
    """

    name: str
    places_mm: Floats
    pixels: Floats
    mirrored: bool = False


def require_plausible(board: CharucoBoard) -> None:
    """Refuse squares that cannot be meant in mm.

    Raises
    ------
    CompareError
        The side of a square is out of range.
    """
    low, high = SQUARE_RANGE_MM
    if not low <= board.square_mm <= high:
        unit = "metres" if board.square_mm < low else "micrometres"
        factor = 1e3 if board.square_mm < low else 1e-3
        raise CompareError(
            f"board.square_mm = {board.square_mm:g} mm must be {low:g} to {high:g} mm; if it was given in {unit}, "
            f"write square_mm = {board.square_mm * factor:g}, and change marker_mm likewise"
        )


def find_board(grey: NDArray[np.uint8], board: CharucoBoard, name: str) -> BoardView:
    """Return the corners of a board; a picture without any is mirrored and tried again.

    Parameters
    ----------
    grey
        (H, W) picture.
    board
        What was printed.
    name
        Of the picture, for messages.

    Raises
    ------
    CompareError
        Fewer than 8 corners are found, they lie on a line, or a square has less than 8 px.
    """
    opencv = _opencv_board(board)
    ids, pixels = _detected(grey, opencv)
    mirrored = len(ids) == 0
    if mirrored:
        ids, pixels = _detected(np.ascontiguousarray(grey[:, ::-1]), opencv)
        pixels[:, 0] = grey.shape[1] - 1 - pixels[:, 0]
    all_corners = np.asarray(opencv.getChessboardCorners())[:, :2]
    if len(ids) < LEAST_CORNERS:
        raise CompareError(
            f"{name}: only {len(ids)} of the {len(all_corners)} corners of the board were found, but at least "
            f"{LEAST_CORNERS} are needed. Check that it is a ChArUco board of {board.squares[0]} x {board.squares[1]} "
            f"squares of {board.dictionary}, light it evenly, avoid glare and blur, and bring it nearer"
        )
    view = BoardView(name, all_corners[ids].astype(np.float64), pixels, mirrored)
    _require_spread(view)
    _require_large(view, board)
    return view


def _opencv_board(board: CharucoBoard) -> Any:
    """Return OpenCV's board."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    markers = board.squares[0] * board.squares[1] // 2
    if markers > len(dictionary.bytesList):
        raise CompareError(
            f"board.dictionary = {board.dictionary} has only {len(dictionary.bytesList)} markers, but a board of "
            f"{board.squares[0]} x {board.squares[1]} squares needs {markers}; give the dictionary that the board was "
            "printed with"
        )
    return cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, dictionary)


def _detected(grey: NDArray[np.uint8], board: Any) -> tuple[NDArray[np.int64], Floats]:
    """Return numbers (N,) and pixels (N, 2) of the corners that are found."""
    detected: Any = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    corners, ids = detected[:2]
    if ids is None or corners is None:
        return np.empty(0, dtype=np.int64), np.empty((0, 2))
    return np.asarray(ids, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _require_spread(view: BoardView) -> None:
    """Refuse corners that lie on one line: the tilt of the board across it is not seen."""
    centred = view.places_mm - view.places_mm.mean(axis=0)
    singular = np.linalg.svd(centred, compute_uv=False)
    if singular[1] < 0.1 * singular[0]:
        raise CompareError(
            f"{view.name}: the {len(view.pixels)} corners found lie on one line; bring more of the board into the "
            "picture"
        )


def _require_large(view: BoardView, board: CharucoBoard) -> None:
    """Refuse a board whose squares are too few pixels, by the root of a square's area under the best affine map."""
    places = np.column_stack([view.places_mm, np.ones(len(view.places_mm))])
    affine = np.linalg.lstsq(places, view.pixels, rcond=None)[0][:2]
    square_px = board.square_mm * float(np.sqrt(abs(np.linalg.det(affine))))
    if square_px < LEAST_SQUARE_PX:
        raise CompareError(
            f"{view.name}: the board is too small in the picture, because a square has only {square_px:.1f} px, but "
            f"at least {LEAST_SQUARE_PX:g} px are needed; bring the board nearer, or print larger squares"
        )


COEFFICIENTS = {"pinhole": 5, "fisheye": 4}
"""k1 k2 p1 p2 k3, and k1 to k4: what a picture of a board determines for common lenses."""
LEAST_VIEWS = 4
"""Besides that of the pad: three determine a lens, one more shows whether they agree."""
POSE = 6
LARGEST_RMS_PX = 3.0
LARGEST_FOCAL_U_REL = 0.05
_MOST_STEPS, _STEP_TOLERANCE_REL = 100, 1e-10
_FIRST_DAMPING, _MOST_DAMPING = 1e-3, 1e8


@dataclass(frozen=True, slots=True)
class LensCalibration:
    """A lens and the places of the board, with their joint covariance.

    Attributes
    ----------
    model, width_px, height_px
        OpenCV's distortion model and the size of the pictures.
    lens
        (n,) fx, fy, cx, cy and the coefficients of the distortion.
    poses
        (views, 6) rotation vector and translation in mm, from the board to the camera.
    covariance
        (n + 6 views, n + 6 views) s^2 (J'J)^-1 of lens and poses, in this order.
    corner_sd_px
        s: standard deviation of one coordinate of a corner, from the residuals.
    view_rms_px
        (views,) root mean square distance of the corners of a view from where they should be.
    degrees_of_freedom
        Of s.
    """

    model: DistortionModel
    width_px: int
    height_px: int
    lens: Floats
    poses: Floats
    covariance: Floats
    corner_sd_px: float
    view_rms_px: Floats
    degrees_of_freedom: int

    @property
    def focal_u_rel(self) -> float:
        """Relative standard uncertainty of the focal length, the larger of both axes."""
        return float((np.sqrt(np.diag(self.covariance)[:2]) / self.lens[:2]).max())


def calibrate_lens(views: Sequence[BoardView], size_px: tuple[int, int], model: DistortionModel) -> LensCalibration:
    """Fit a lens and the places of the board by least squares of the corners' residuals.

    Parameters
    ----------
    views
        Pictures of one board with one camera, four or more, turned and tilted.
    size_px
        Width and height.
    model
        "pinhole" or "fisheye".

    Raises
    ------
    CompareError
        There are too few views, the fit fails or leaves more than 3 px, or the pictures do not determine the focal
        length.

    References
    ----------
    Z. Zhang, IEEE Trans. Pattern Analysis and Machine Intelligence 22 (2000) 1330; J. Kannala, S. S. Brandt, ibid. 28
    (2006) 1335.
    """
    if len(views) < LEAST_VIEWS:
        raise CompareError(
            f"{len(views)} usable pictures of the board are too few to calibrate a lens; give at least {LEAST_VIEWS} "
            "(ten is a good number), each with the board turned and tilted differently"
        )
    found = adjust(views, size_px, model, *_start(views, size_px, model))
    rms = float(np.sqrt((found.view_rms_px**2).mean()))
    if not rms <= LARGEST_RMS_PX:
        worst = int(np.argmax(found.view_rms_px))
        raise CompareError(
            f"the {model} model leaves residuals of {rms:.1f} px at the corners ({found.view_rms_px[worst]:.1f} px in "
            f"{views[worst].name}), but at most {LARGEST_RMS_PX:g} px are allowed. Check that the board is flat, that "
            "squares and dictionary are those that were printed, and that the focus was the same in all pictures"
        )
    if not found.focal_u_rel <= LARGEST_FOCAL_U_REL:
        raise CompareError(
            f"the standard uncertainty of the focal length is {100 * found.focal_u_rel:.0f} %, but at most "
            f"{100 * LARGEST_FOCAL_U_REL:.0f} % is allowed; the poses of the board are too similar. Take pictures "
            "with the board tilted by 20 to 45 deg in several directions, some reaching into the corners"
        )
    return found


def adjust(
    views: Sequence[BoardView],
    size_px: tuple[int, int],
    model: DistortionModel,
    lens: Floats,
    poses: Floats,
    weights: Floats | None = None,
) -> LensCalibration:
    """Refine lens and poses from a start by Levenberg-Marquardt; weights count views more than once.

    Raises
    ------
    CompareError
        The corners do not determine what is fitted.
    """
    counts = np.ones(len(views)) if weights is None else weights
    n = len(lens)
    state = np.concatenate([lens, poses.ravel()])
    residuals, jacobian = _linearised(views, model, state, n, counts)
    cost, damping = float(residuals @ residuals), _FIRST_DAMPING
    for _ in range(_MOST_STEPS):
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        scaled = jacobian / scale
        normal = scaled.T @ scaled
        step = np.linalg.solve(normal + damping * np.eye(len(state)), scaled.T @ residuals) / scale
        tried = state + step
        new_residuals, new_jacobian = _linearised(views, model, tried, n, counts)
        new_cost = float(new_residuals @ new_residuals)
        if np.isfinite(new_cost) and new_cost <= cost:
            done = cost - new_cost <= _STEP_TOLERANCE_REL * cost
            state, residuals, jacobian, cost = tried, new_residuals, new_jacobian, new_cost
            damping /= 10.0
            if done:
                break
        else:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
    return _described(views, size_px, model, state, n, residuals, jacobian, counts)


def project(model: DistortionModel, lens: Floats, pose: Floats, places: Floats) -> tuple[Floats, Floats]:
    """Return pixels (N, 2) of places (N, 3) and their derivatives (N, 2, n + 6) by lens and pose."""
    matrix = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    points = np.ascontiguousarray(places, dtype=np.float64).reshape(-1, 1, 3)
    n = len(lens)
    if model == "fisheye":
        pixels, columns = cv2.fisheye.projectPoints(points, pose[:3], pose[3:], matrix, lens[4:])
        order = [*range(n), *range(n, n + POSE)]
    else:
        pixels, columns = cv2.projectPoints(points, pose[:3], pose[3:], matrix, lens[4:])
        order = [*range(POSE, POSE + n), *range(POSE)]
    derivatives = np.asarray(columns, dtype=np.float64)[:, order].reshape(-1, 2, n + POSE)
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), derivatives


def _linearised(
    views: Sequence[BoardView], model: DistortionModel, state: Floats, n: int, counts: Floats
) -> tuple[Floats, Floats]:
    """Return weighted residuals, measured minus projected, and the derivatives of what is projected."""
    residuals, blocks = [], []
    for index, view in enumerate(views):
        first = n + POSE * index
        places = np.column_stack([view.places_mm, np.zeros(len(view.places_mm))])
        pixels, columns = project(model, state[:n], state[first : first + POSE], places)
        root = np.sqrt(counts[index])
        residuals.append(root * (view.pixels - pixels).ravel())
        block = np.zeros((2 * len(places), len(state)))
        columns = columns.reshape(-1, n + POSE)
        block[:, :n], block[:, first : first + POSE] = columns[:, :n], columns[:, n:]
        blocks.append(root * block)
    return np.concatenate(residuals), np.concatenate(blocks)


def _described(
    views: Sequence[BoardView],
    size_px: tuple[int, int],
    model: DistortionModel,
    state: Floats,
    n: int,
    residuals: Floats,
    jacobian: Floats,
    counts: Floats,
) -> LensCalibration:
    """Return what was fitted with its covariance."""
    freedom = int(sum(2 * len(v.pixels) * (c > 0) for v, c in zip(views, counts, strict=True))) - len(state)
    scale = np.linalg.norm(jacobian, axis=0)
    variance = float(residuals @ residuals) / max(freedom, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = jacobian / scale
    if freedom < 1 or not np.isfinite(scaled).all() or np.linalg.matrix_rank(scaled) < len(state):
        raise CompareError(
            f"the corners do not determine a {model} lens and the positions of the board; take more pictures, with "
            "the board tilted in several directions"
        )
    covariance = variance * np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    poses = state[n:].reshape(-1, POSE)
    rms = []
    for view, pose in zip(views, poses, strict=True):
        places = np.column_stack([view.places_mm, np.zeros(len(view.places_mm))])
        error = view.pixels - project(model, state[:n], pose, places)[0]
        rms.append(np.sqrt((error**2).sum(axis=1).mean()))
    return LensCalibration(
        model, *size_px, state[:n], poses, covariance, float(np.sqrt(variance)), np.array(rms), freedom
    )


def _start(views: Sequence[BoardView], size_px: tuple[int, int], model: DistortionModel) -> tuple[Floats, Floats]:
    """Return lens (n,) and poses (views, 6) as OpenCV calibrates them."""
    places: list[Any] = [
        np.column_stack([v.places_mm, np.zeros(len(v.places_mm))]).astype(np.float32).reshape(1, -1, 3) for v in views
    ]
    pixels: list[Any] = [v.pixels.astype(np.float32).reshape(1, -1, 2) for v in views]
    try:
        if model == "fisheye":
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC + cv2.CALIB_FIX_SKEW
            _, matrix, coefficients, turns, shifts = cv2.fisheye.calibrate(
                places, pixels, size_px, np.eye(3), np.zeros(4), flags=flags
            )
        else:
            _, matrix, coefficients, turns, shifts = cv2.calibrateCamera(places, pixels, size_px, None, None)
    except cv2.error as error:
        raise CompareError(
            f"the {model} calibration failed ({' '.join(str(error.err).split())}); take more pictures, with the board "
            "turned and tilted in several directions, some reaching into the corners"
        ) from None
    lens = np.concatenate(
        [[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], np.ravel(coefficients)[: COEFFICIENTS[model]]]
    )
    poses = [np.concatenate([np.ravel(t), np.ravel(s)]) for t, s in zip(turns, shifts, strict=True)]
    return lens.astype(np.float64), np.array(poses, dtype=np.float64)


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
