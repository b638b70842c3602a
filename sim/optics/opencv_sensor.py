"""The renderer's camera whose rays come from an OpenCV calibration, for every integrator and every variant."""

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from data_schemas.camera_calibration import CameraCalibration
from sim.optics.opencv_camera import ray_table, require_same_shape

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
        From :func:`sim.optics.variants.open_renderer`.

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
        """Looks along the rays of a :class:`sim.optics.opencv_camera.RayTable`, in OpenCV's axes."""

        def __init__(self, props: Any) -> None:
            rays = np.array(props["rays"], dtype=np.float32)
            super().__init__(props)
            self.m_needs_sample_3 = False  # a pinhole has no aperture to sample
            # the renderer's texture unit would round the weights of a spline to 8 bit on a GPU
            self.rays = mi.Texture2f(mi.TensorXf(rays), False)
            texels = np.array(rays.shape[1::-1], dtype=np.float64)
            film = self.film()
            size, crop, offset = (np.array(v) for v in (film.size(), film.crop_size(), film.crop_offset()))
            # position on the cropped film -> on the film -> in the texture, as RayTable.texture_place
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
