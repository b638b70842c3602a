"""Render a classic sensor: a plain gel over coloured light panels, without and with an indenter in it."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import CHANNELS, ColouredLight, PlainSensor, SimulateError
from sim.optics._optical_layout import PanelFrame
from sim.optics._path_rules import MAX_DEPTH, ROULETTE_DEPTH
from sim.optics._position_map import PositionMap
from sim.optics._refraction import GelFace
from sim.optics._render import stream_seed
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import PANEL_RADIANCE_REL, band_film, coating, dark_box, diffuse, shining_rectangle, surface_mesh
from sim.surface_meshes import Surface, check_closed, gel_faces, pressed_height_mm, without_press

CHANNEL_CENTRES_NM = (630.0, 525.0, 465.0)
"""Usual peaks of red, green and blue LEDs; the metal's reflectance is read there."""

# the dent of a ball of a few mm is round to this spacing in both directions
_STEP_MM = 0.15
_WALLS = ("red", "green", "base", "tip")


@dataclass(frozen=True, slots=True)
class PlainRender:
    """Colour images (rows, columns, 3: red, green, blue) in units of a panel's radiance, columns along +x, rows -z.

    ``*_variance`` is the variance of the mean of two independent halves.
    """

    no_contact: NDArray[np.float32]
    contact: NDArray[np.float32]
    no_contact_variance: NDArray[np.float32]
    contact_variance: NDArray[np.float32]
    samples_per_pixel: int
    seed: int
    variant: str


def render_plain_sensor(
    sensor: PlainSensor, renderer: ModuleType, seed: int = 0, samples_per_pixel: int = 64
) -> PlainRender:
    """Render a classic sensor without and with its indenter, both with the same random numbers.

    Parameters
    ----------
    sensor
        The sensor.
    renderer
        From :func:`sim.optics.open_renderer`. A scalar variant meets the panels by chance only and is noisy.
    seed
        Random seed, >= 0.
    samples_per_pixel
        Paths per pixel, an even number >= 2: two independent halves are rendered.

    Raises
    ------
    SimulateError
        When samples_per_pixel is odd or below 2, or when the pad has a film.
    """
    if samples_per_pixel < 2 or samples_per_pixel % 2:
        raise SimulateError(
            f"samples_per_pixel must be an even number of at least 2 (two independent halves), got {samples_per_pixel}"
        )
    images, variances = [], []
    for pressed in (False, True):
        scene = plain_sensor_scene(sensor, renderer, pressed)
        integrator = plain_sensor_integrator(scene, sensor, renderer, pressed)
        halves = [
            np.array(
                renderer.render(scene, integrator=integrator, spp=samples_per_pixel // 2, seed=stream_seed(seed, half)),
                dtype=np.float32,
            )
            for half in (0, 1)
        ]
        images.append(np.float32(0.5) * (halves[0] + halves[1]))
        variances.append(np.float32(0.25) * (halves[0] - halves[1]) ** 2)
    return PlainRender(images[0], images[1], variances[0], variances[1], samples_per_pixel, seed, renderer.variant())


def plain_sensor_scene(sensor: PlainSensor, renderer: ModuleType, pressed: bool = True) -> Any:
    """Build the renderer's scene of a classic sensor; its own integrator is Mitsuba's ``path``.

    Parameters
    ----------
    sensor
        The sensor.
    renderer
        Open Mitsuba module.
    pressed
        Whether the indenter is in the gel.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    SimulateError
        When the pad has a film.
    """
    if sensor.pad.film is not None:
        raise SimulateError("pad.film: plain sensors are rendered without a film on the inner face; leave it out")
    surfaces = _gel(sensor, pressed)
    index = sensor.pad.refractive_index
    glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    metal = coating(sensor.coating, np.array(CHANNEL_CENTRES_NM), index)
    frames = [light_frame(sensor, light) for light in sensor.lights]
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": ROULETTE_DEPTH},
        "coat": surface_mesh(renderer, "coat", surfaces["coat"], metal, smooth=True),
        "inner": surface_mesh(renderer, "inner", surfaces["inner"], glass),
        "sensor": _camera(sensor, renderer),
        "box": dark_box(_extent_mm(sensor, surfaces, frames), sensor.box_reflectance, renderer),
    }
    for name in _WALLS:
        clear = sensor.walls == "clear"
        surface = surfaces[name] if clear else surfaces[name].reversed()
        scene[name] = surface_mesh(renderer, name, surface, glass if clear else diffuse(sensor.wall_reflectance))
    colours = _colours(sensor)
    for k, (frame, light) in enumerate(zip(frames, sensor.lights, strict=True)):
        radiance = PANEL_RADIANCE_REL * light.power_rel * colours[k]
        scene[f"panel{k}"] = shining_rectangle(frame, radiance, renderer)
    return renderer.load_dict(scene)


def plain_sensor_integrator(scene: Any, sensor: PlainSensor, renderer: ModuleType, pressed: bool = True) -> Any:
    """Return what renders a plain sensor's scene: panels connected through the inner face where the variant can."""
    if renderer.variant() == SCALAR_VARIANT:
        return scene.integrator()
    from sim.optics._band_paths import coloured_integrator  # these need the variant set
    from sim.optics._panel_light import Panel

    pad = sensor.pad
    inner = PositionMap.of(_gel(sensor, pressed)["inner"], "inner face")
    face = GelFace(inner, pad.width_mm, pad.length_mm, pad.refractive_index)
    share = 1.0 / len(sensor.lights)
    panels = [Panel(light_frame(sensor, light), light, share) for light in sensor.lights]
    dark = _WALLS if sensor.walls == "dark" else ()
    return coloured_integrator(scene, panels, _colours(sensor), face, dark, sensor.wall_reflectance)


def light_frame(sensor: PlainSensor, light: ColouredLight) -> PanelFrame:
    """Return the rectangle of a light: it stands behind the pad's middle, against the way its light goes."""
    azimuth, angle = np.radians(light.azimuth_deg), np.radians(light.angle_deg)
    onward, across = (
        np.array([np.sin(azimuth), 0.0, np.cos(azimuth)]),
        np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)]),
    )
    normal = np.cos(angle) * onward + np.array([0.0, np.sin(angle), 0.0])
    centre = sensor.middle_mm() - light.distance_mm * onward - np.array([0.0, light.depth_mm, 0.0])
    half_along = np.cross(normal, across) * light.height_mm / 2.0
    return PanelFrame(centre, across * light.width_mm / 2.0, half_along, normal)


def _gel(sensor: PlainSensor, pressed: bool) -> dict[str, Surface]:
    """Return the closed faces of the gel."""
    design = sensor.pressed_pad()
    design = design if pressed else without_press(design)
    pad = sensor.pad
    x, z = (
        np.linspace(low, low + size, int(np.ceil(size / _STEP_MM)) + 1)
        for low, size in ((-pad.width_mm / 2.0, pad.width_mm), (0.0, pad.length_mm))
    )
    faces = gel_faces(x, pressed_height_mm(design, x, z), z)
    check_closed(faces)
    return faces


def _colours(sensor: PlainSensor) -> NDArray[np.float64]:
    """Return the channel of each light as a colour, shape (light, 3)."""
    return np.eye(3)[[CHANNELS.index(light.channel) for light in sensor.lights]]


def _extent_mm(sensor: PlainSensor, surfaces: dict[str, Surface], frames: list[PanelFrame]) -> NDArray[np.float64]:
    """Return points (n, 3) that the housing must hold."""
    camera = sensor.middle_mm() - np.array([0.0, sensor.camera.distance_mm, 0.0])
    edges = [f.centre_mm + s * f.half_across_mm + t * f.half_along_mm for f in frames for s in (-1, 1) for t in (-1, 1)]
    return np.concatenate([surfaces["coat"].vertices_mm, surfaces["inner"].vertices_mm, [camera], edges])


def _camera(sensor: PlainSensor, renderer: ModuleType) -> dict[str, Any]:
    """Return the camera below the pad, columns along +x and rows against z."""
    # the renderer's cameras look along z with x to the left and y up
    to_world = np.eye(4)
    to_world[:3, :3] = np.column_stack([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    to_world[:3, 3] = sensor.middle_mm() - np.array([0.0, sensor.camera.distance_mm, 0.0])
    return {
        "type": "perspective",
        "fov": sensor.camera.field_of_view_deg,
        "fov_axis": "x",
        "near_clip": 0.1,
        "to_world": renderer.ScalarTransform4f(to_world),
        "film": band_film(sensor.camera.width_px, sensor.camera.height_px),
        "sampler": {"type": "independent", "sample_count": 16},
    }
