"""Render a classic sensor: a plain gel over coloured lights, without and with something pressed into its coat."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import CHANNELS, CameraCalibration, ColouredLight, GelPad, PlainSensor, SimulateError
from data_schemas.storage import camera_response
from sim.optics._calibrated_camera import read_calibration
from sim.optics._optical_layout import CameraPose, PanelFrame
from sim.optics._path_rules import MAX_DEPTH, ROULETTE_DEPTH
from sim.optics._pixel_maps import join_triangles, lines_of_sight, pose_rays
from sim.optics._position_map import PositionMap
from sim.optics._refraction import GelFace
from sim.optics._render import known_variance, passes_of, stream_seed
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import (
    PANEL_RADIANCE_REL,
    coating,
    dark_box,
    diffuse,
    pose_sensor,
    shining_rectangle,
    surface_mesh,
    wall_texels,
)
from sim.surface_meshes import Surface, check_closed, gel_faces, pressed_height_mm, unpressed_design

CHANNEL_CENTRES_NM = (630.0, 525.0, 465.0)
"""Usual peaks of red, green and blue LEDs; the metal's reflectance is read there."""

USUAL_FWHM_NM = 25.0
"""Usual width of a coloured LED."""

# a white LED as two bells, of its blue die and of its phosphor: peak and full width in nm, power
_WHITE = ((450.0, 20.0, 0.25), (560.0, 120.0, 0.75))
_SPECTRUM_NM = np.arange(380.0, 781.0, 1.0)
_SIGMA_PER_FWHM = 1.0 / np.sqrt(8.0 * np.log(2.0))
# the dent of a ball of a few mm is round to this spacing in both directions
STEP_MM = 0.15
_WALLS = ("red", "green", "base", "tip")

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GelHeight:
    """Height of the coat above the inner face on a grid of the pad.

    Attributes
    ----------
    x_mm, z_mm
        Places across (nx,) and along (nz,) the pad, both edges included.
    height_mm
        Shape (nx, nz).
    """

    x_mm: Floats
    z_mm: Floats
    height_mm: Floats

    def faces(self) -> dict[str, Surface]:
        """Return the six closed faces of the gel."""
        faces = gel_faces(self.x_mm, self.height_mm, self.z_mm)
        check_closed(faces)
        return faces


@dataclass(frozen=True, slots=True)
class PlainRender:
    """Colour images (rows, columns, 3: red, green, blue) of the camera.

    Unit: what a panel of power 1 sends, seen by the channel that sees it best. ``*_variance`` is the variance of the
    mean of K independent passes, with K - 1 degrees of freedom: K is 16, 8, 4 or 2, as the paths divide.
    ``*_half_difference`` is half the difference of the means of their halves.
    """

    no_contact: NDArray[np.float32]
    contact: NDArray[np.float32]
    no_contact_variance: NDArray[np.float32]
    contact_variance: NDArray[np.float32]
    no_contact_half_difference: NDArray[np.float32]
    contact_half_difference: NDArray[np.float32]
    samples_per_pixel: int
    seed: int
    variant: str


def render_plain_sensor(
    sensor: PlainSensor,
    renderer: ModuleType,
    seed: int = 0,
    samples_per_pixel: int = 64,
    *,
    gels: tuple[GelHeight, GelHeight] | None = None,
    folder: Path = Path(),
) -> PlainRender:
    """Render a classic sensor without and with contact, both with the same random numbers.

    Parameters
    ----------
    sensor
        The sensor.
    renderer
        From :func:`sim.optics.open_renderer`. A scalar variant meets the panels by chance only and is noisy.
    seed
        Random seed, >= 0.
    samples_per_pixel
        Paths per pixel, an even number >= 2, in as many passes as it divides into: 16, 8, 4 or 2.
    gels
        The gel without and with contact; by default the indenter is pressed in analytically.
    folder
        Where the files that the design names are.

    Raises
    ------
    SimulateError
        When samples_per_pixel is odd or below 2, when the pad has a film, or when a scalar variant meets a light that
        is not Lambertian.
    """
    if samples_per_pixel < 2 or samples_per_pixel % 2:
        raise SimulateError(
            f"samples_per_pixel must be an even number of at least 2 (two independent halves), got {samples_per_pixel}"
        )
    passes = passes_of(samples_per_pixel)
    images, variances, halves = [], [], []
    for gel in gels or (analytic_gel(sensor, False), analytic_gel(sensor, True)):
        scene = plain_sensor_scene(sensor, renderer, gel=gel, folder=folder)
        integrator = plain_sensor_integrator(scene, sensor, renderer, gel=gel, folder=folder)
        of_pass = np.array(
            [
                renderer.render(
                    scene, integrator=integrator, spp=samples_per_pixel // passes, seed=stream_seed(seed, k)
                )
                for k in range(passes)
            ],
            dtype=np.float64,
        )
        images.append(of_pass.mean(axis=0).astype(np.float32))
        both = of_pass.reshape(2, passes // 2, *of_pass.shape[1:]).mean(axis=1)
        halves.append((0.5 * (both[0] - both[1])).astype(np.float32))
        variances.append(known_variance((of_pass.var(axis=0, ddof=1) / passes).astype(np.float32)))
    return PlainRender(
        images[0], images[1], variances[0], variances[1], halves[0], halves[1], samples_per_pixel, seed,
        renderer.variant(),
    )  # fmt: skip


def plain_sensor_scene(
    sensor: PlainSensor,
    renderer: ModuleType,
    pressed: bool = True,
    *,
    gel: GelHeight | None = None,
    folder: Path = Path(),
) -> Any:
    """Build the renderer's scene of a classic sensor; its own integrator is Mitsuba's ``path``.

    Parameters
    ----------
    sensor
        The sensor.
    renderer
        Open Mitsuba module.
    pressed
        Whether the indenter is in the gel.
    gel
        The gel, in place of the analytic press.
    folder
        Where the files that the design names are.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    SimulateError
        When the pad has a film.
    """
    if sensor.pad.film is not None:
        raise SimulateError("pad.film: a film on the inner face is not supported in plain sensors; leave it out")
    gel = gel or analytic_gel(sensor, pressed)
    surfaces, index = gel.faces(), sensor.pad.refractive_index
    glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    paint = _paint(sensor, gel, renderer)
    metal = coating(sensor.coating, np.array(CHANNEL_CENTRES_NM), index, paint)
    frames = [light_frame(sensor, light) for light in sensor.lights]
    extent = _extent_mm(sensor, surfaces, frames)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": ROULETTE_DEPTH},
        "coat": surface_mesh(renderer, "coat", surfaces["coat"], metal, smooth=True),
        "inner": surface_mesh(renderer, "inner", surfaces["inner"], glass),
        "sensor": pose_sensor(sensor_pose(sensor), renderer, sensor_calibration(sensor, folder)),
        "box": dark_box(extent, sensor.box_reflectance, renderer, sensor.box_clearance_mm),
    }
    for name in _WALLS:
        clear = sensor.walls == "clear"
        surface = surfaces[name] if clear else surfaces[name].reversed()
        scene[name] = surface_mesh(renderer, name, surface, glass if clear else diffuse(sensor.wall_reflectance))
    colours = light_colours(sensor, folder)
    for k, (frame, light) in enumerate(zip(frames, sensor.lights, strict=True)):
        radiance = PANEL_RADIANCE_REL * light.power_rel * colours[k]
        scene[f"panel{k}"] = shining_rectangle(frame, radiance, renderer, sensor.panel_reflectance)
    return renderer.load_dict(scene)


def plain_sensor_integrator(
    scene: Any,
    sensor: PlainSensor,
    renderer: ModuleType,
    pressed: bool = True,
    *,
    gel: GelHeight | None = None,
    folder: Path = Path(),
) -> Any:
    """Return what renders a plain sensor's scene: panels connected through the inner face where the variant can.

    Raises
    ------
    SimulateError
        When a scalar variant meets a light that is not Lambertian.
    """
    if renderer.variant() == SCALAR_VARIANT:
        _require_lambertian_lights(sensor)
        return scene.integrator()
    from sim.optics._band_paths import coloured_integrator  # these need the variant set
    from sim.optics._panel_light import Panel

    pad = sensor.pad
    inner = PositionMap.of((gel or analytic_gel(sensor, pressed)).faces()["inner"], "inner face")
    face = GelFace(inner, pad.width_mm, pad.length_mm, pad.refractive_index)
    share = 1.0 / len(sensor.lights)
    panels = [Panel(light_frame(sensor, light), light, share) for light in sensor.lights]
    dark = _WALLS if sensor.walls == "dark" else ()
    return coloured_integrator(scene, panels, light_colours(sensor, folder), face, dark, sensor.wall_reflectance)


def _require_lambertian_lights(sensor: PlainSensor) -> None:
    """Check that Mitsuba's own integrator, which knows no beams, can render the lights."""
    if any(light.beam_exponent != 1.0 for light in sensor.lights):
        raise SimulateError(
            f"lights.beam_exponent: {SCALAR_VARIANT} supports only Lambertian lights (beam_exponent = 1); install LLVM "
            "17 or newer, or set beam_exponent to 1"
        )


def light_frame(sensor: PlainSensor, light: ColouredLight) -> PanelFrame:
    """Return the rectangle of a light: it lies behind the pad's middle, opposite to the direction of its light.

    ``turn_deg`` turns it about an axis along the pad's normal through its own centre.
    """
    azimuth, angle = np.radians(light.azimuth_deg), np.radians(light.angle_deg)
    behind = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    turned = azimuth + np.radians(light.turn_deg)
    onward = np.array([np.sin(turned), 0.0, np.cos(turned)])
    across = np.array([np.cos(turned), 0.0, -np.sin(turned)])
    normal = np.cos(angle) * onward + np.array([0.0, np.sin(angle), 0.0])
    centre = sensor.middle_mm() - light.distance_mm * behind - np.array([0.0, light.depth_mm, 0.0])
    half_along = np.cross(normal, across) * light.height_mm / 2.0
    return PanelFrame(centre, across * light.width_mm / 2.0, half_along, normal)


def sensor_pose(sensor: PlainSensor) -> CameraPose:
    """Return where the camera of a classic sensor stands and how it is turned."""
    camera = sensor.camera
    tilt, pan, roll = (np.radians(angle) for angle in (camera.tilt_deg, camera.pan_deg, camera.roll_deg))
    forward = np.array([np.sin(pan) * np.cos(tilt), np.cos(pan) * np.cos(tilt), np.sin(tilt)])
    level = np.array([np.cos(pan), -np.sin(pan), 0.0])
    below = np.cross(forward, level)
    half = float(np.tan(np.radians(camera.field_of_view_deg) / 2.0))
    return CameraPose(
        centre_mm=sensor.middle_mm() + np.array([camera.across_mm, -camera.distance_mm, camera.along_mm]),
        forward=forward,
        right=np.cos(roll) * level + np.sin(roll) * below,
        down=np.cos(roll) * below - np.sin(roll) * level,
        tan_half_width=half,
        tan_half_height=half * camera.height_px / camera.width_px,
        columns_px=camera.width_px,
        rows_px=camera.height_px,
    )


def sensor_calibration(sensor: PlainSensor, folder: Path) -> CameraCalibration | None:
    """Return the calibration of the sensor's lens, if its design names one."""
    name = sensor.camera.calibration
    return None if name is None else read_calibration(folder / name)


def light_colours(sensor: PlainSensor, folder: Path = Path()) -> Floats:
    r"""Return what each channel of the camera sees of each light, shape (light, 3).

    With an ideal response a light counts fully in the channel of its name, a white one in all. Otherwise
    :math:`c_k = \int S r_k \, d\lambda / \max r`, S of unit energy: a bell of the light's peak and width, or of a
    white LED.

    Parameters
    ----------
    sensor
        Lights and camera.
    folder
        Where the file of a response is.
    """
    if sensor.camera.response == "ideal":
        names = [CHANNELS if light.channel == "white" else (light.channel,) for light in sensor.lights]
        return np.array([[float(channel in seen) for channel in CHANNELS] for seen in names])
    curves = camera_response(sensor.camera.response, folder)
    response = np.stack(
        [np.interp(_SPECTRUM_NM, curve.wavelength_nm, curve.values, left=0.0, right=0.0) for curve in curves]
    )
    return np.asarray(np.stack([response @ _spectrum(light) for light in sensor.lights]) / response.max())


def _spectrum(light: ColouredLight) -> Floats:
    """Return the share of a light's power in each nanometre."""
    if light.channel == "white":
        bells: tuple[tuple[float, float, float], ...] = _WHITE
    else:
        peak = light.peak_wavelength_nm or CHANNEL_CENTRES_NM[CHANNELS.index(light.channel)]
        bells = ((peak, light.fwhm_nm or USUAL_FWHM_NM, 1.0),)
    power = np.zeros_like(_SPECTRUM_NM)
    for peak, fwhm, share in bells:
        bell = np.exp(-0.5 * ((_SPECTRUM_NM - peak) / (fwhm * _SIGMA_PER_FWHM)) ** 2)
        power += share * bell / max(float(bell.sum()), np.finfo(float).tiny)
    return power


def pad_grid_mm(pad: GelPad, step_mm: float = STEP_MM) -> tuple[Floats, Floats]:
    """Return places across (nx,) and along (nz,) a pad, at most a step apart, both edges included."""
    across, along = (
        np.linspace(low, low + size, int(np.ceil(size / step_mm)) + 1)
        for low, size in ((-pad.width_mm / 2.0, pad.width_mm), (0.0, pad.length_mm))
    )
    return across, along


def analytic_gel(sensor: PlainSensor, pressed: bool) -> GelHeight:
    """Return the gel at rest, or with the indenter pressed in by :func:`sim.surface_meshes.pressed_height_mm`."""
    design = sensor.pressed_pad()
    x, z = pad_grid_mm(sensor.pad)
    return GelHeight(x, z, pressed_height_mm(design if pressed else unpressed_design(design), x, z))


def seen_places_mm(
    sensor: PlainSensor, gel: GelHeight, renderer: ModuleType, calibration: CameraCalibration | None = None
) -> Floats:
    """Return the place of the coat that the centre of each pixel sees, (rows, columns, 2: x, z), NaN where none is.

    Parameters
    ----------
    sensor, gel
        Camera, walls and index; the gel as it is.
    renderer
        From :func:`sim.optics.open_renderer`.
    calibration
        Of the camera; without it the ideal pinhole of the design.

    Raises
    ------
    SimulateError
        When no pixel sees the coat.
    """
    pose = sensor_pose(sensor)
    rays = pose_rays(pose, calibration)
    mesh = join_triangles(gel.faces())
    clear = ("inner", *_WALLS) if sensor.walls == "clear" else ("inner",)
    origin = np.broadcast_to(pose.centre_mm, rays.shape).reshape(-1, 3)
    triangle, barycentric, _ = lines_of_sight(
        mesh, origin, rays.reshape(-1, 3), sensor.pad.refractive_index, renderer, clear
    )
    on_coat = (triangle >= 0) & (mesh.owner[triangle] == mesh.names.index("coat"))
    if not on_coat.any():
        raise SimulateError(
            "the camera does not see the coat; check camera.distance_mm, across_mm, along_mm, tilt_deg and pan_deg"
        )
    places = np.full((len(triangle), 2), np.nan)
    places[on_coat] = mesh.at(mesh.corners, triangle[on_coat], barycentric[on_coat])[:, [0, 2]]
    return places.reshape(*rays.shape[:2], 2)


def _paint(sensor: PlainSensor, gel: GelHeight, renderer: ModuleType) -> Mapping[str, Any] | None:
    """Return the diffuse part of the coat where it is coloured or translucent; None: grey."""
    coat = sensor.coating
    if coat.translucent is None:
        if coat.diffuse_reflectance_rgb is None:
            return None
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(coat.diffuse_reflectance_rgb)}}
    at_rest = _resampled(analytic_gel(sensor, False), gel.x_mm, gel.z_mm)
    layer_mm = coat.translucent.thickness_mm * gel.height_mm / at_rest
    texels = _resampled(GelHeight(gel.x_mm, gel.z_mm, layer_mm), _centres(gel.x_mm), _centres(gel.z_mm))
    reflectance = np.repeat(coat.translucent.reflectance(texels).T[..., None], 3, axis=-1)
    bitmap = {
        "type": "bitmap", "data": wall_texels(reflectance, renderer), "raw": True, "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }  # fmt: skip
    return {"type": "diffuse", "reflectance": bitmap}


def _centres(edges: Floats) -> Floats:
    """Return the middles between neighbours."""
    return 0.5 * (edges[1:] + edges[:-1])


def _resampled(gel: GelHeight, x_mm: Floats, z_mm: Floats) -> Floats:
    """Return values on another grid (nx, nz), linear in both directions."""
    along_x = np.stack([np.interp(x_mm, gel.x_mm, column) for column in gel.height_mm.T], axis=-1)
    return np.stack([np.interp(z_mm, gel.z_mm, row) for row in along_x])


def _extent_mm(sensor: PlainSensor, surfaces: Mapping[str, Surface], frames: list[PanelFrame]) -> Floats:
    """Return points (n, 3) that the housing must hold."""
    edges = [f.centre_mm + s * f.half_across_mm + t * f.half_along_mm for f in frames for s in (-1, 1) for t in (-1, 1)]
    camera = sensor_pose(sensor).centre_mm
    return np.concatenate([surfaces["coat"].vertices_mm, surfaces["inner"].vertices_mm, [camera], edges])
