"""Find the corners of a ChArUco board in a picture, directly or through a mirror, or say why they are not found."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CharucoBoard, CompareError

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
            f"board.square_mm = {board.square_mm:g} mm: squares of {low:g} to {high:g} mm can be used; was it given in "
            f"{unit}? Then write square_mm = {board.square_mm * factor:g}, and marker_mm likewise"
        )


def find_board(grey: NDArray[np.uint8], board: CharucoBoard, name: str) -> BoardView:
    """Return the corners of a board; a picture without any is tried mirrored.

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
            f"{name}: {len(ids)} of the {len(all_corners)} corners of the board are found, {LEAST_CORNERS} are needed. "
            f"Is it a ChArUco board of {board.squares[0]} x {board.squares[1]} squares of {board.dictionary}? Light it "
            "evenly, avoid glare and blur, and bring it nearer"
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
            f"board.dictionary = {board.dictionary} has {len(dictionary.bytesList)} markers, a board of "
            f"{board.squares[0]} x {board.squares[1]} squares needs {markers}: give the dictionary it was printed with"
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
            f"{view.name}: the {len(view.pixels)} corners that are found lie on one line; bring more of the board into "
            "the picture"
        )


def _require_large(view: BoardView, board: CharucoBoard) -> None:
    """Refuse a board whose squares are too few pixels, by the root of a square's area under the best affine map."""
    places = np.column_stack([view.places_mm, np.ones(len(view.places_mm))])
    affine = np.linalg.lstsq(places, view.pixels, rcond=None)[0][:2]
    square_px = board.square_mm * float(np.sqrt(abs(np.linalg.det(affine))))
    if square_px < LEAST_SQUARE_PX:
        raise CompareError(
            f"{view.name}: the board is too small in the picture, a square has {square_px:.1f} px of "
            f"{LEAST_SQUARE_PX:g} px that are needed; bring it nearer, or print larger squares"
        )
