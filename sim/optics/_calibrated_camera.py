"""A calibrated camera: its file, the ray of every point of its picture, and the renderer's sensor of such rays.

Calibrations are read as OpenCV's own programs and ROS write them. OpenCV's own inversion gives the rays on a grid; a
cubic spline through them is what the renderer and the pixel maps evaluate, for every integrator and every variant.
Directions are in OpenCV's axes: x right, y down, z forward.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.interpolate import BSpline, make_lsq_spline

from data_schemas import CameraCalibration, ImportFormatError, SimulateError, explain
from data_schemas.storage import parse_in_child, read_bytes

Floats = NDArray[np.float64]

_MATRIX_NAMES = ("camera_matrix", "K", "cameraMatrix")
_DISTORTION_NAMES = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")
# what calibration programs call the two models; the second column are those of ROS
_MODEL_NAMES = {
    "pinhole": "pinhole", "plumb_bob": "pinhole", "rational_polynomial": "pinhole", "": "pinhole",
    "fisheye": "fisheye", "equidistant": "fisheye",
}  # fmt: skip
_LARGEST_FILE_BYTES = 1_000_000
_DEEPEST, _MOST_NUMBERS = 4, 64


def read_calibration(path: Path) -> CameraCalibration:
    """Read a calibration written by cv2.FileStorage (YAML or JSON), OpenCV's calibration sample, or ROS camera_info.

    Fields: camera_matrix (3 x 3); distortion_coefficients or dist_coeffs; image_width, image_height;
    distortion_model (pinhole or fisheye, plumb_bob, rational_polynomial or equidistant), pinhole if it is missing.

    Raises
    ------
    ImportFormatError
        The file is missing or unreadable, or a field is missing or not what it must be.
    """
    content = read_bytes(path, "an OpenCV calibration (YAML or JSON)", ImportFormatError, _LARGEST_FILE_BYTES)
    found, _ = parse_in_child(f"{__name__}:calibration_fields", content, path, "a calibration", ImportFormatError)
    try:
        return CameraCalibration.model_validate({**found["values"], "source": path.name})
    except ValidationError as error:
        reason = explain(error, CameraCalibration)
        raise ImportFormatError(f"{path}: {found['coefficients']} and {found['matrix']}: {reason}") from None


def calibration_fields(content: bytes, where: str) -> tuple[dict[str, Any], dict[str, Floats]]:
    """Return what a calibration says, not yet checked; it runs in a child process, for OpenCV's YAML crashes at depth.

    Raises
    ------
    ImportFormatError
        The file is unreadable, or a field is missing or not what it must be.
    """
    storage = _open_storage(content, where)
    try:
        matrix_name, matrix = _first_matrix(where, storage, _MATRIX_NAMES)
        coefficients_name, coefficients = _first_matrix(where, storage, _DISTORTION_NAMES)
        if matrix.size != 9:
            raise ImportFormatError(f"{where}: {matrix_name} must contain 3 x 3 numbers, got {matrix.size} numbers")
        k = matrix.reshape(3, 3)
        if not (np.isfinite(matrix).all() and np.isfinite(coefficients).all()):
            raise ImportFormatError(f"{where}: {matrix_name} and {coefficients_name} must contain only finite numbers")
        if k[0, 1] != 0.0 or (k[1:, :2] != np.array([[0.0, k[1, 1]], [0.0, 0.0]])).any() or k[2, 2] != 1.0:
            raise ImportFormatError(f"{where}: {matrix_name} must be [fx 0 cx; 0 fy cy; 0 0 1], got {k.tolist()}")
        values: dict[str, Any] = {
            "model": _model(where, storage),
            "width_px": _whole_number(where, storage, "image_width"),
            "height_px": _whole_number(where, storage, "image_height"),
            "focal_px": (k[0, 0], k[1, 1]),
            "centre_px": (k[0, 2], k[1, 2]),
            "distortion": tuple(coefficients.tolist()),
        }
    finally:
        storage.release()
    return {"values": values, "matrix": matrix_name, "coefficients": coefficients_name}, {}


def _open_storage(content: bytes, where: str) -> Any:
    """Open a calibration; plain YAML gets the header that OpenCV's reader wants."""
    try:
        text = content.decode("utf-8")
        if not text.lstrip().startswith(("%YAML", "{", "<?xml")):
            text = "%YAML:1.0\n---\n" + text.lstrip().removeprefix("---")
        return cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError, UnicodeDecodeError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise ImportFormatError(f"{where}: is not a readable YAML or JSON file of OpenCV ({reason})") from None


def _first_matrix(where: str, storage: Any, names: tuple[str, ...]) -> tuple[str, Floats]:
    """Return the name and the numbers of the first of several fields that is there."""
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            return name, _numbers(where, name, node)
    raise ImportFormatError(f"{where}: field {names[0]} is missing (also known as {', '.join(names[1:])})")


def _numbers(where: str, name: str, node: Any, depth: int = 0) -> Floats:
    """Return the numbers of OpenCV's matrix, of ROS's {rows, cols, data}, or of plain (nested) lists."""
    if depth > _DEEPEST or (node.isSeq() and node.size() > _MOST_NUMBERS):
        raise ImportFormatError(f"{where}: {name} must be a matrix of at most {_MOST_NUMBERS} numbers")
    if node.isMap():
        return _numbers(where, f"{name}.data", node.getNode("data"), depth + 1)
    if node.isSeq():
        items = [node.at(i) for i in range(node.size())]
        return np.concatenate([np.empty(0), *(_numbers(where, name, item, depth + 1) for item in items)])
    if node.isInt() or node.isReal():
        return np.array([node.real()])
    raise ImportFormatError(f"{where}: {name} must be a matrix or a list of numbers")


def _whole_number(where: str, storage: Any, name: str) -> int:
    """Return a field that counts pixels."""
    node = storage.getNode(name)
    if not node.isInt():
        raise ImportFormatError(f"{where}: field {name} (whole number of pixels) is missing")
    return int(node.real())


def _model(where: str, storage: Any) -> str:
    """Return which of the two models the coefficients belong to."""
    named = storage.getNode("distortion_model")
    if named.empty():
        sample = storage.getNode("fisheye_model")  # what OpenCV's calibration sample writes
        return "fisheye" if not sample.empty() and sample.real() == 1.0 else "pinhole"
    name = named.string().lower() if named.isString() else ""
    if name not in _MODEL_NAMES or not name:
        known = ", ".join(filter(None, _MODEL_NAMES))
        raise ImportFormatError(f"{where}: distortion_model must be one of {known}, got '{name}'")
    return _MODEL_NAMES[name]


# OpenCV stops after five steps unless told otherwise, which leaves up to 0.2 px with a wide lens
_STEPS, _STEP_TOLERANCE = 500, 1e-13
_LARGEST_INVERSION_ERROR_PX = 1e-5
_BISECTIONS = 60
_NEWTON_STEPS, _WAY_POINTS = 60, 65
# grid of the spline: with 8 px per interval a lens of 120 deg is met to better than 1e-4 px
_INTERVAL_PX, _FEWEST_INTERVALS, _MOST_INTERVALS = 8.0, 64, 256
_DEGREE = 3


@dataclass(frozen=True, slots=True)
class RayTable:
    """Rays of a picture as a uniform cubic B-spline.

    ``coefficients`` (rows, columns, 3) stand at texel centres; the picture's edges lie 1.5 texels inside the outer
    edges, so that no value outside the picture was ever asked for.
    """

    coefficients: Floats

    def directions(self, film: Floats) -> Floats:
        """Return unit directions (..., 3) of points (..., 2) of the film, x and y in 0..1."""
        points = film.reshape(-1, 2)
        weights = [_basis(points[:, axis], self.coefficients.shape[1 - axis] - _DEGREE) for axis in (0, 1)]
        (first_x, weight_x), (first_y, weight_y) = weights
        offsets = np.arange(_DEGREE + 1)
        near = self.coefficients[first_y[:, None, None] + offsets[:, None], first_x[:, None, None] + offsets]
        rays = np.einsum("nyxc,ny,nx->nc", near, weight_y, weight_x)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.asarray(rays.reshape(*film.shape[:-1], 3))


def ray_table(calibration: CameraCalibration) -> RayTable:
    """Return the rays of a calibrated camera.

    Raises
    ------
    SimulateError
        When the distortion cannot be inverted somewhere in the picture.
    """
    size = np.array([calibration.width_px, calibration.height_px])
    intervals = np.clip(np.ceil(size / _INTERVAL_PX), _FEWEST_INTERVALS, _MOST_INTERVALS).astype(int)
    x, y = (np.linspace(0.0, 1.0, 2 * n + 1) for n in intervals)
    film = np.stack(np.meshgrid(x, y), -1)
    rays = rays_of_pixels(calibration, film * size - 0.5)
    along_rows = make_lsq_spline(y, rays, _knots(intervals[1]), k=_DEGREE).c
    return RayTable(np.moveaxis(make_lsq_spline(x, np.moveaxis(along_rows, 1, 0), _knots(intervals[0])).c, 0, 1))


def require_same_shape(calibration: CameraCalibration, width_px: int, height_px: int) -> None:
    """Refuse a picture whose sides have another ratio than the calibrated one; its size may differ.

    Raises
    ------
    SimulateError
        When the ratio differs by more than half a pixel of the smaller picture.
    """
    expected = width_px * calibration.height_px / calibration.width_px
    if abs(expected - height_px) > 0.5:
        raise SimulateError(
            f"{calibration.source} calibrates a picture of {calibration.width_px} x {calibration.height_px} px, but "
            f"the design's camera has another aspect ratio ({width_px} x {height_px} px in its rendering); set "
            "camera.width_px and camera.height_px to the calibrated size or a fraction of it"
        )


def rays_of_pixels(calibration: CameraCalibration, pixels: Floats) -> Floats:
    """Return the unit directions (..., 3) that a camera images onto points (..., 2) of its picture.

    Pinhole models are inverted by cv2.undistortPoints, and by Newton's method where that does not converge; fisheye
    models by bisection of theta_d(theta), because OpenCV's inversion ends at 90 deg from the axis.

    Raises
    ------
    SimulateError
        When the distortion cannot be inverted at one of the points: its polynomial is not monotonic there.
    """
    points = np.ascontiguousarray(pixels.reshape(-1, 1, 2), dtype=np.float64)
    rays = (_fisheye_rays if calibration.model == "fisheye" else _pinhole_rays)(calibration, points)
    return np.asarray(rays.reshape(*pixels.shape[:-1], 3))


def camera_matrix_of(calibration: CameraCalibration) -> Floats:
    """Return OpenCV's 3 x 3 matrix."""
    (fx, fy), (cx, cy) = calibration.focal_px, calibration.centre_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _pinhole_rays(calibration: CameraCalibration, points: Floats) -> Floats:
    """Invert the pinhole model and make sure that it was inverted."""
    matrix, distortion = camera_matrix_of(calibration), np.array(calibration.distortion or (0.0,) * 4)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _STEP_TOLERANCE)
    plane: Floats = np.asarray(cv2.undistortPoints(points, matrix, distortion, criteria=criteria)[:, 0], np.float64)
    image, slope = _image_of_plane(calibration, plane)
    bad = ~(np.linalg.norm(image - points[:, 0], axis=-1) < _LARGEST_INVERSION_ERROR_PX) | ~(np.linalg.det(slope) > 0.0)
    if bad.any():  # OpenCV's steps do not end where the picture is squeezed much
        plane[bad], bad[bad] = _by_newton(calibration, points[bad, 0])
    _require_invertible(calibration, points, bad)
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=-1)[:, None]
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _image_of_plane(calibration: CameraCalibration, plane: Floats) -> tuple[Floats, Floats]:
    """Return the image (N, 2) of points at distance 1, px, and its derivatives (N, 2, 2) by their place."""
    matrix, distortion = camera_matrix_of(calibration), np.array(calibration.distortion or (0.0,) * 4)
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=-1)[:, None]
    image, jacobian = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, distortion)
    moved = jacobian[:, 3:5].reshape(-1, 2, 2)  # columns 3, 4 are the translation's
    return np.asarray(image[:, 0], np.float64), np.asarray(moved, np.float64)


def _by_newton(calibration: CameraCalibration, pixels: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Invert the pinhole model by Newton's method, from the undistorted place, and say where it cannot be inverted.

    The way from the axis to a ray that is found must keep its sense of rotation: behind a fold the image may turn back.
    """
    plane = (pixels - np.array(calibration.centre_px)) / np.array(calibration.focal_px)
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            image, slope = _image_of_plane(calibration, plane)
            flat = ~(np.linalg.det(slope) > 0.0)
            step = np.linalg.solve(np.where(flat[:, None, None], np.eye(2), slope), (pixels - image)[..., None])[..., 0]
            plane = np.where(flat[:, None], np.nan, plane + step)
        image, _ = _image_of_plane(calibration, plane)
        bad = ~(np.linalg.norm(image - pixels, axis=-1) < _LARGEST_INVERSION_ERROR_PX)
        for share in np.linspace(0.0, 1.0, _WAY_POINTS):
            bad |= ~(np.linalg.det(_image_of_plane(calibration, share * plane)[1]) > 0.0)
    return plane, bad


def _fisheye_rays(calibration: CameraCalibration, points: Floats) -> Floats:
    """Invert the fisheye model up to 180 deg from the axis."""
    k = np.array(calibration.distortion or (0.0,) * 4)
    plane = (points[:, 0] - np.array(calibration.centre_px)) / np.array(calibration.focal_px)
    distorted = np.linalg.norm(plane, axis=-1)

    def theta_d(theta: Floats) -> Floats:
        square = theta**2
        return np.asarray(theta * (1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))))

    samples = np.linspace(0.0, np.pi, 4097)
    falls = np.flatnonzero(np.diff(theta_d(samples)) <= 0.0)
    last = samples[falls[0] if falls.size else -1]
    _require_invertible(calibration, points, ~(distorted <= theta_d(last)))
    low, high = np.zeros_like(distorted), np.full_like(distorted, last)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = theta_d(middle) < distorted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    theta = 0.5 * (low + high)
    across = np.divide(np.sin(theta), distorted, out=np.ones_like(theta), where=distorted > 0.0)
    return np.column_stack([plane * across[:, None], np.cos(theta)])


def _require_invertible(calibration: CameraCalibration, points: Floats, bad: NDArray[np.bool_]) -> None:
    """Refuse a distortion that folds inside the picture."""
    if bad.any():
        column, row = points[int(np.argmax(bad)), 0]
        raise SimulateError(
            f"{calibration.source}: the {calibration.model} distortion cannot be inverted at {100 * bad.mean():.1f} % "
            f"of the picture, for example at column {column:.0f}, row {row:.0f}, because its polynomial is not "
            "monotonic there. Calibrate with boards that reach the corners, or with fewer coefficients"
        )


def _knots(intervals: int) -> Floats:
    """Return uniform knots on 0..1 that go on beyond both ends."""
    return np.asarray(np.arange(-_DEGREE, intervals + _DEGREE + 1) / intervals)


def _basis(x: Floats, intervals: int) -> tuple[NDArray[np.int64], Floats]:
    """Return the first coefficient that counts at each point, and the weights of the four."""
    place = x * intervals
    first = np.clip(np.floor(place), 0, intervals - 1).astype(np.int64)
    unit = BSpline.basis_element(np.arange(_DEGREE + 2.0), extrapolate=False)
    t = place - first
    return first, np.stack([np.nan_to_num(unit(t + _DEGREE - j)) for j in range(_DEGREE + 1)], -1)


SENSOR_NAME = "finray_opencv_camera"
_registered: set[str] = set()


def opencv_sensor(
    calibration: CameraCalibration, to_world: Any, film: Mapping[str, Any], renderer: ModuleType
) -> dict[str, Any]:
    """Return a sensor dictionary for the renderer.

    Parameters
    ----------
    calibration
        The camera. The film may have any number of pixels: it always covers the whole calibrated picture.
    to_world
        The renderer's transform that places the camera; its axes are x left, y up, z forward.
    film
        Film dictionary, with a crop if only a part is wanted; it must have a box filter, so that a pixel gathers
        what falls onto its area.
    renderer
        From :func:`sim.optics.open_renderer`.

    Raises
    ------
    SimulateError
        When the distortion cannot be inverted somewhere in the picture, or film and calibration differ in shape.
    """
    require_same_shape(calibration, film["width"], film["height"])
    if renderer.variant() not in _registered:
        renderer.register_sensor(SENSOR_NAME, _sensor_class(renderer))
        _registered.add(renderer.variant())
    rays = ray_table(calibration).coefficients.astype(np.float32)
    return {
        "type": SENSOR_NAME,
        "rays": renderer.TensorXf(rays),
        "to_world": to_world,
        "film": dict(film),
        "sampler": {"type": "independent", "sample_count": 16},
    }


def _sensor_class(renderer: ModuleType) -> type[Any]:
    """Return the sensor for the variant that is set: its base class differs from variant to variant."""
    mi: Any = renderer
    dr: Any = import_module("drjit")

    class OpencvCamera(mi.Sensor):  # type: ignore[misc]
        """Looks along the rays of a :class:`sim.optics._calibrated_camera.RayTable`, in OpenCV's axes."""

        def __init__(self, props: Any) -> None:
            rays = np.array(props["rays"], dtype=np.float32)
            super().__init__(props)
            self.m_needs_sample_3 = False  # a pinhole has no aperture to sample
            # the renderer's texture unit would round the weights of a spline to 8 bit on a GPU
            self.rays = mi.Texture2f(mi.TensorXf(rays), False)
            texels = np.array(rays.shape[1::-1], dtype=np.float64)
            film = self.film()
            size, crop, offset = (np.array(v) for v in (film.size(), film.crop_size(), film.crop_offset()))
            # position on the cropped film -> on the film -> in the texture, see RayTable
            scale, shift = crop / size * (texels - 3.0) / texels, (offset / size * (texels - 3.0) + 1.5) / texels
            self.scale, self.shift = [float(v) for v in scale], [float(v) for v in shift]

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, _sample3: Any, active: Any = True) -> Any:
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            place = mi.Point2f(*(sample2[i] * self.scale[i] + self.shift[i] for i in (0, 1)))
            right, down, forward = self.rays.eval_cubic(place, active, force_nonaccel=True)
            world = self.world_transform()
            direction = world @ dr.normalize(mi.Vector3f(-right, -down, forward))
            return mi.Ray3f(world @ mi.Point3f(0.0), direction, time, wavelengths), weight

        def sample_ray_differential(self, *arguments: Any) -> Any:
            ray, weight = self.sample_ray(*arguments)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()  # the camera has no body

        def to_string(self) -> str:
            return f"OpencvCamera[{self.rays.shape}]"

    return OpencvCamera
