"""Cameras calibrated with OpenCV: files, rays against OpenCV's own projection, and rays in the renderer."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from data_schemas import CameraCalibration, FieldError, FinrayError, ImportFormatError, SimulateError
from sim.optics import read_calibration
from sim.optics._calibrated_camera import camera_matrix_of, opencv_sensor, ray_table, rays_of_pixels
from sim.optics._renderer import LLVM_VARIANT

LARGEST_ERROR_PX = 1e-3
MATRIX = np.array([[310.0, 0.0, 322.5], [0.0, 312.0, 236.0], [0.0, 0.0, 1.0]])


def calibration(model="pinhole", distortion=(-0.28, 0.11, 0.001, -0.002, -0.01), focal=310.0, **changed):
    values = {
        "model": model, "width_px": 640, "height_px": 480, "focal_px": (focal, focal + 2.0),
        "centre_px": (322.5, 236.0), "distortion": distortion, "source": "lens.yaml",
    }  # fmt: skip
    return CameraCalibration(**{**values, **changed})


PINHOLE = calibration()
RATIONAL = calibration(distortion=(0.8, 0.1, 0.0005, 0.0003, 0.01, 1.1, 0.3, 0.03))
# theta_d of the corners, 400 px from the centre, is 1.7: up to 104 deg from the axis
FISHEYE = calibration("fisheye", (-0.02, 0.004, -0.001, 0.0001), focal=235.0)


def film_points():
    rng = np.random.default_rng(3)
    edges = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), -1).reshape(-1, 2)
    return np.concatenate([edges, rng.random((2000, 2))])


def projected(camera, rays):
    """OpenCV's projection; the fisheye formula of its documentation holds beyond 90 deg, its code does not."""
    if camera.model == "pinhole":
        zero = np.zeros(3)
        return cv2.projectPoints(rays[:, None], zero, zero, camera_matrix_of(camera), np.array(camera.distortion))[0][
            :, 0
        ]
    k = np.concatenate([[1.0], camera.distortion])
    theta = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    theta_d = sum(c * theta ** (2 * i + 1) for i, c in enumerate(k))
    radius = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-300)
    return theta_d[:, None] * rays[:, :2] / radius[:, None] * camera.focal_px + camera.centre_px


@pytest.mark.parametrize("camera", [PINHOLE, RATIONAL, FISHEYE, calibration(distortion=())])
def test_rays_of_the_table_meet_their_pixel(camera):
    film = film_points()
    rays = ray_table(camera).directions(film)
    pixels = film * [camera.width_px, camera.height_px] - 0.5
    assert np.abs(projected(camera, rays) - pixels).max() < LARGEST_ERROR_PX
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, rtol=1e-12)


def test_pinhole_rays_agree_with_the_undistortion_of_opencv():
    pixels = film_points() * [640, 480] - 0.5
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    plane = cv2.undistortPoints(
        pixels[:, None], camera_matrix_of(PINHOLE), np.array(PINHOLE.distortion), criteria=criteria
    )[:, 0]
    rays = ray_table(PINHOLE).directions(film_points())
    error = (rays[:, :2] / rays[:, 2:] - plane) * PINHOLE.focal_px
    assert np.abs(error).max() < LARGEST_ERROR_PX


def test_monotonic_distortions_at_which_the_steps_of_opencv_do_not_end_are_inverted():
    """Rays are projected and found again; where cv2.undistortPoints comes to an end, it finds the same."""
    ray_table(calibration(distortion=(-0.2, 0.02, 0.0, 0.0)))
    distortion = (-0.2, 0.021, 0.001, -0.001)
    camera = calibration(distortion=distortion)
    radius, angle = np.meshgrid(np.linspace(0.0, 2.7, 200), np.linspace(0.0, 6.2, 20))
    plane = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 2)
    rays = np.column_stack([plane, np.ones(len(plane))])
    pixels = projected(camera, rays)
    found = rays_of_pixels(camera, pixels)
    np.testing.assert_allclose(found[:, :2] / found[:, 2:], plane, atol=1e-9)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    matrix, given = camera_matrix_of(camera), np.array(distortion)
    theirs = cv2.undistortPoints(pixels[:, None], matrix, given, criteria=criteria)[:, 0]
    ends = np.linalg.norm(theirs - plane, axis=1) < 1e-9
    assert 0.8 < ends.mean() < 1.0


def test_fisheye_agrees_with_opencv_up_to_its_limit_and_goes_on_beyond():
    pixels = film_points() * [640, 480] - 0.5
    rays = rays_of_pixels(FISHEYE, pixels)
    angle = np.degrees(np.arccos(rays[:, 2]))
    assert angle.max() > 95.0
    narrow = angle < 85.0
    matrix, k = camera_matrix_of(FISHEYE), np.array(FISHEYE.distortion)
    back = cv2.fisheye.projectPoints(rays[narrow][:, None], np.zeros(3), np.zeros(3), matrix, k)[0][:, 0]
    np.testing.assert_allclose(back, pixels[narrow], atol=LARGEST_ERROR_PX)
    plane = cv2.fisheye.undistortPoints(pixels[narrow][:, None], matrix, k)[:, 0]
    np.testing.assert_allclose(rays[narrow][:, :2] / rays[narrow][:, 2:], plane, rtol=1e-6, atol=1e-8)


def test_axis_of_a_fisheye_looks_straight_ahead():
    np.testing.assert_allclose(rays_of_pixels(FISHEYE, np.array([[322.5, 236.0]])), [[0.0, 0.0, 1.0]], atol=1e-12)


def test_distortion_that_turns_round_is_refused():
    # r (1 - 0.5 r^2) has its maximum at r = 0.82, the corners lie at r = 1.3
    with pytest.raises(SimulateError, match=r"lens.yaml: the pinhole distortion cannot be inverted .* column -?\d+"):
        ray_table(calibration(distortion=(-0.5, 0.0, 0.0, 0.0)))
    with pytest.raises(SimulateError, match="the fisheye distortion cannot be inverted"):
        ray_table(calibration("fisheye", (-0.3, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
@pytest.mark.parametrize("variant", ["scalar", "llvm"])
def test_renderer_sends_its_rays_through_the_calibration(request, variant, camera):
    renderer = request.getfixturevalue(variant)
    transform = renderer.ScalarTransform4f().look_at(origin=[1.0, 2.0, 3.0], target=[4.0, 2.0, 4.0], up=[0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "width": 320, "height": 240, "rfilter": {"type": "box"}}
    crop = {"crop_offset_x": 40, "crop_offset_y": 30, "crop_width": 160, "crop_height": 120}
    sensor = renderer.load_dict(opencv_sensor(camera, transform, film | crop, renderer))
    on_crop = film_points()[:60]
    rays = []
    for point in on_crop:
        ray, weight = sensor.sample_ray(0.0, 0.5, renderer.Point2f(*point.tolist()), renderer.Point2f(0.5), True)
        rays.append(np.array(ray.d, dtype=float).ravel())
        np.testing.assert_allclose(np.array(ray.o).ravel(), [1.0, 2.0, 3.0], atol=1e-6)
        assert np.array(weight).ravel()[0] == 1.0
    to_camera = np.array(transform.matrix)[:3, :3].T
    local = np.array(rays) @ to_camera.T * [-1.0, -1.0, 1.0]
    pixels = (on_crop * 0.5 + 0.125) * [640, 480] - 0.5
    assert np.abs(projected(camera, local) - pixels).max() < LARGEST_ERROR_PX


def test_picture_of_another_shape_is_refused(scalar):
    film = {"type": "hdrfilm", "width": 320, "height": 200, "rfilter": {"type": "box"}}
    with pytest.raises(SimulateError, match=r"lens\.yaml calibrates a picture of 640 x 480 px, .* \(320 x 200 px in"):
        opencv_sensor(PINHOLE, scalar.ScalarTransform4f(), film, scalar)


@pytest.mark.renderer
def test_calibrated_pinhole_renders_what_the_perspective_camera_renders(llvm):
    # 0.5 px: OpenCV's picture begins half a pixel before its first pixel centre
    camera = calibration(distortion=(), focal_px=(300.0, 300.0), centre_px=(319.5, 239.5))
    transform = llvm.ScalarTransform4f().look_at(origin=[0.0, 1.0, -4.0], target=[0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": "box"}, "component_format": "float32"}
    stock = {
        "type": "perspective", "fov": float(np.degrees(2 * np.arctan(320 / 300))), "fov_axis": "x",
        "to_world": transform, "film": film, "sampler": {"type": "independent"},
    }  # fmt: skip
    scene = {
        "type": "scene", "integrator": {"type": "path", "max_depth": 3}, "sky": {"type": "constant"},
        "cube": {"type": "cube", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}},
        "ball": {"type": "sphere", "center": [2.0, 0.5, 0.0]},
    }  # fmt: skip
    images = [
        np.array(llvm.render(llvm.load_dict(scene | {"sensor": sensor}), spp=256, seed=4))
        for sensor in (stock, opencv_sensor(camera, transform, film, llvm))
    ]
    assert llvm.variant() == LLVM_VARIANT
    # the same random numbers take the same paths but for rounding; a shift of 0.1 px would move edges by 10 %
    assert np.abs(images[0] - images[1]).mean() < 1e-3
    assert np.quantile(np.abs(images[0] - images[1]), 0.999) < 0.03


def stored(tmp_path, name, matrix=MATRIX, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0), field="distortion_coefficients", **f):
    path = tmp_path / name
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", matrix)
    storage.write(field, np.array(distortion))
    for key, value in {"image_width": 640, "image_height": 480, **f}.items():
        if value is not None:
            storage.write(key, value)
    storage.release()
    return path


@pytest.mark.parametrize("name", ["lens.yaml", "lens.json", "lens.yml"])
def test_files_of_opencv_are_read(tmp_path, name):
    read = read_calibration(stored(tmp_path, name, field="dist_coeffs"))
    assert (read.model, read.width_px, read.height_px, read.source) == ("pinhole", 640, 480, name)
    assert (read.focal_px, read.centre_px) == ((310.0, 312.0), (322.5, 236.0))
    assert read.distortion == (-0.2, 0.05, 0.0, 0.0, 0.0)


def test_fisheye_is_known_by_either_name(tmp_path):
    for i, extra in enumerate(({"distortion_model": "fisheye"}, {"distortion_model": "equidistant"})):
        path = stored(tmp_path, f"{i}.yaml", distortion=(-0.02, 0.004, 0.0, 0.0), **extra)
        assert read_calibration(path).model == "fisheye"
    assert read_calibration(stored(tmp_path, "s.yaml", distortion=(0.0,) * 4, fisheye_model=1)).model == "fisheye"


def test_camera_info_of_ros_and_plain_lists_are_read(tmp_path):
    ros = tmp_path / "ros.yaml"
    ros.write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [310.0, 0, 322.5, 0, 312.0, 236.0, 0, 0, 1]\ndistortion_model: plumb_bob\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.2, 0.05, 0, 0, 0]\n"
        "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    )
    plain = tmp_path / "plain.json"
    plain.write_text(
        json.dumps({"K": MATRIX.tolist(), "D": [-0.2, 0.05, 0, 0, 0], "image_width": 640, "image_height": 480})
    )
    fields = {"focal_px": (310.0, 312.0), "centre_px": (322.5, 236.0), "distortion": (-0.2, 0.05, 0.0, 0.0, 0.0)}
    for path in (ros, plain):
        read = read_calibration(path)
        assert {name: getattr(read, name) for name in fields} == fields


def test_errors_name_file_and_field(tmp_path):
    with pytest.raises(ImportFormatError, match=r"nothing.yaml: no such file"):
        read_calibration(tmp_path / "nothing.yaml")
    cases = {
        r"skew.yaml: camera_matrix must be \[fx 0 cx": {"matrix": MATRIX + np.eye(3, k=1)},
        r"flat.yaml: camera_matrix must contain 3 x 3 numbers, got 4": {"matrix": np.eye(2)},
        r"six.yaml: .*'distortion|six.yaml: .*distortion: a pinhole .* got 6": {"distortion": (0.0,) * 6},
        r"fish.yaml: .*a fisheye model must have 0 or 4 coefficients, got 5": {"distortion_model": "fisheye"},
        r"model.yaml: distortion_model must be one of .*, got 'kannala'": {"distortion_model": "kannala"},
        r"size.yaml: field image_width": {"image_width": None},
        r"zero.yaml: .*focal_px": {"matrix": np.diag([0.0, 1.0, 1.0])},
        r"name.yaml: field distortion_coefficients is missing \(also known as dist_coeffs": {"field": "lens"},
    }
    for message, changed in cases.items():
        with pytest.raises(ImportFormatError, match=message):
            read_calibration(stored(tmp_path, message.split(":")[0], **changed))
    texts = {
        "is too long; at most 1000000 bytes": "a: 1\n" * 300_000,
        "is not a readable YAML or JSON file": "hello",
        "camera_matrix.data must be a matrix": "camera_matrix:\n  data: word\ndist_coeffs: [0, 0, 0, 0]\n",
    }
    for message, text in texts.items():
        path = tmp_path / "text.yaml"
        path.write_text(text)
        with pytest.raises(ImportFormatError, match=f"text.yaml: {message}"):
            read_calibration(path)
    with pytest.raises(FieldError, match="0, 4, 5, 8, 12 or 14 coefficients, got 3"):
        calibration(distortion=(0.0,) * 3)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 500), junk=st.text(max_size=8))
def test_torn_files_give_an_error_that_names_them_or_are_whole(tmp_path, cut, junk):
    whole = stored(tmp_path, "whole.yaml").read_text()
    torn = tmp_path / "torn.yaml"
    torn.write_text(whole[:cut] + junk + whole[cut + 3 :], encoding="utf-8")
    message = "torn.yaml"
    try:
        read_calibration(torn)
    except FinrayError as error:
        message = str(error)
    assert "torn.yaml" in message


@pytest.mark.parametrize("brackets", [1_000, 100_000])
@pytest.mark.parametrize("start", ["camera_matrix: ", "%YAML:1.0\n---\ncamera_matrix: ", '{"camera_matrix": '])
def test_deep_nesting_is_refused_and_no_process_dies_of_it(tmp_path, brackets, start):
    path = tmp_path / "lens.yaml"
    path.write_text(start + "[" * brackets)
    with pytest.raises(ImportFormatError, match=r"lens\.yaml: "):
        read_calibration(path)
