"""Boards seen by a known camera: the truth that a calibration must find again."""

import cv2
import numpy as np

from data_schemas import CharucoBoard
from finray_calib.sensing import BoardView

SIZE_PX = (640, 480)
# 120 deg across the picture, as the finger's camera
FISHEYE = np.array([305.0, 306.0, 322.0, 238.0, 0.02, -0.01, 0.002, -0.0005])
PINHOLE = np.array([420.0, 421.0, 322.0, 238.0, -0.1, 0.02, 0.001, -0.001, 0.0])
BOARD = CharucoBoard(squares=(7, 5), square_mm=3.0, marker_mm=2.2, dictionary="DICT_4X4_50")
PLACES_MM = np.stack(np.meshgrid(3.0 * np.arange(1, 7), 3.0 * np.arange(1, 5)), -1).reshape(-1, 2)
CENTRE_MM = np.array([10.5, 7.5])
RIM_PX = 6.0


def projected(model, lens, pose, places_mm):
    """Project places of a plane by OpenCV, independent of the code under test."""
    matrix = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    points = np.column_stack([places_mm, np.zeros(len(places_mm))]).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    return project(points, pose[:3], pose[3:], matrix, lens[4:])[0].reshape(-1, 2)


def pose_of(turn, middle_mm):
    """Return the pose that puts the board's centre at a place in front of the camera."""
    shift = np.asarray(middle_mm) - cv2.Rodrigues(np.asarray(turn, dtype=float))[0][:, :2] @ CENTRE_MM
    return np.concatenate([turn, shift])


def true_scale(model, lens, pose, pixel, step_px=0.05):
    """Return mm per px along x and y at a pixel, by solving for the places of its neighbours on the plane."""
    from scipy.optimize import fsolve

    def place(target):
        return fsolve(lambda p: projected(model, lens, pose, p[None])[0] - target, CENTRE_MM, xtol=1e-13)

    steps = np.eye(2) * step_px
    return np.array([np.linalg.norm(place(pixel + s) - place(pixel - s)) / (2 * step_px) for s in steps])


def poses(model, lens, rng, count):
    """Return poses with every corner inside the picture: first that on the pad, then turned and tilted ones."""
    found = [pose_of([0.05, 0.1, 0.02], (0.5, -0.3, 15.0))]
    while len(found) <= count:
        middle = (rng.uniform(-8, 8), rng.uniform(-6, 6), rng.uniform(12, 22))
        pose = pose_of(rng.uniform(-0.7, 0.7, 3), middle)
        seen = projected(model, lens, pose, PLACES_MM)
        if (seen > RIM_PX).all() and (seen < np.array(SIZE_PX) - RIM_PX).all():
            found.append(pose)
    return found


def board_views(model, lens, places, rng, noise_px=0.1, square_error_rel=0.0):
    """Return noisy views; the printed board is larger than its nominal size by the relative error."""
    views = []
    for k, pose in enumerate(places):
        seen = projected(model, lens, pose, PLACES_MM * (1.0 + square_error_rel))
        views.append(BoardView(f"board-{k}.png", PLACES_MM, seen + rng.normal(0.0, noise_px, seen.shape)))
    return views


def picture(model, lens, pose, pixels_per_square=60, supersample=2):
    """Render the printed board as the camera sees it, 8 bit, on grey: rays of all pixels onto its plane."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, BOARD.dictionary))
    board = cv2.aruco.CharucoBoard(BOARD.squares, BOARD.square_mm, BOARD.marker_mm, dictionary)
    width, height = (n * pixels_per_square for n in BOARD.squares)
    printed = board.generateImage((width, height), None, 0, 1)
    columns, rows = (np.arange(n * supersample) for n in SIZE_PX)
    grid = np.stack(np.meshgrid((columns + 0.5) / supersample - 0.5, (rows + 0.5) / supersample - 0.5), -1)
    matrix = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
    undistort = cv2.fisheye.undistortPoints if model == "fisheye" else cv2.undistortPoints
    rays = undistort(grid.reshape(-1, 1, 2), matrix, lens[4:]).reshape(-1, 2)
    turn = cv2.Rodrigues(pose[:3])[0]
    # plane to ray: (X, Y, 1) ~ inverse of [r1 r2 t] times the ray
    plane = np.linalg.inv(np.column_stack([turn[:, :2], pose[3:]])) @ np.column_stack([rays, np.ones(len(rays))]).T
    places = (plane[:2] / plane[2]).T
    on_print = (places / BOARD.square_mm * pixels_per_square - 0.5).astype(np.float32)
    shape = (SIZE_PX[1] * supersample, SIZE_PX[0] * supersample)
    x, y = (on_print[:, k].reshape(shape) for k in (0, 1))
    seen = cv2.remap(printed, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=200)
    return cv2.resize(seen, SIZE_PX, interpolation=cv2.INTER_AREA)
