"""Mitsuba scenes of the finger: gel, coating, painted walls, mirror, dark box, light panel, camera (mm).

The three channels of the renderer are the bands red emission, green emission, LED. Radiance is relative to that of the
light panel. The surfaces' materials, such as the coating and the mirror, are made here too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraCalibration, Coating, FingerDesign, ImpossibleFingerError, LightPanel
from sim.optics._calibrated_camera import opencv_sensor
from sim.optics._optical_layout import CameraPose, PanelFrame, Window, camera_pose, panel_frame
from sim.optics._paint_bands import PaintBands
from sim.optics._path_rules import MAX_DEPTH, ROULETTE_DEPTH, aligned
from sim.surface_meshes import GEL_FACES, FingerShape, Surface

PANEL_RADIANCE_REL = 1.0


@dataclass(frozen=True, slots=True)
class LoadedScene:
    """A finger's scene as the renderer has loaded it, with what it was made of.

    Attributes
    ----------
    scene
        From :func:`finger_scene`; in a scalar variant its walls must carry emitters to be lit.
    design, shape, bands, renderer
        As in the scene.
    """

    scene: Any
    design: FingerDesign
    shape: FingerShape
    bands: PaintBands
    renderer: ModuleType


def finger_scene(
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    sensor: Mapping[str, Any] | None = None,
) -> Any:
    """Build the renderer's scene of one finger.

    Parameters
    ----------
    design
        Materials, lights and camera.
    shape
        Surfaces of the finger, at rest or deformed; lights and camera stay on the base.
    bands
        Band reflectances of the paints.
    renderer
        Open Mitsuba module.
    emission
        Emitted radiance of the walls "red" and "green", shape (along z, up the wall, 3 bands) at texel centres;
        dark walls without it.
    sensor
        Sensor dictionary; the finger's camera by default.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    SimulateError
        When a light panel lies in the gel or behind the inner face.
    """
    for light in design.lights:
        check_outside_the_gel(light, shape)
    surfaces = shape.surfaces
    glass = gel_face(design)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": ROULETTE_DEPTH},
        "coat": surface_mesh(renderer, "coat", surfaces["coat"], metal(design, bands, renderer), smooth=True),
        "mirror": surface_mesh(renderer, "mirror", surfaces["mirror"], mirror(design), smooth=True),
        "inner": surface_mesh(renderer, "inner", surfaces["inner"], glass, smooth=True),
        "box": _box(design, shape, renderer),
        "sensor": dict(sensor) if sensor is not None else camera_sensor(design, renderer),
    }
    for number, light in enumerate(design.lights):
        scene[f"panel{number}"] = panel_shape(light, renderer, design.enclosure.panel_reflectance)
    for name in ("base", "tip"):
        scene[name] = surface_mesh(renderer, name, surfaces[name], glass)
    for name in ("red", "green"):
        paint = {"type": "diffuse", "reflectance": rgb(bands.reflectance[name])}
        emitter = None if emission is None else wall_emitter(emission[name], renderer)
        scene[name] = surface_mesh(renderer, name, surfaces[name].reversed(), paint, emitter=emitter)
    dark = {"type": "twosided", "dark": diffuse(design.enclosure.base_reflectance)}
    for name in surfaces.keys() - {*GEL_FACES, "mirror"}:
        scene[name] = surface_mesh(renderer, name, surfaces[name], dark)
    return renderer.load_dict(scene)


def check_outside_the_gel(light: LightPanel, shape: FingerShape) -> None:
    """Check that every corner of a panel lies on the air side of the inner face.

    Raises
    ------
    SimulateError
        When a corner lies behind the nearest part of the inner face: in the gel, or beyond it.
    """
    frame, inner = panel_frame(light), shape.surfaces["inner"]
    a, b, c = (inner.vertices_mm[inner.triangles[:, k]] for k in range(3))
    centres, normals = (a + b + c) / 3.0, np.cross(b - a, c - a)
    for across in (-1.0, 1.0):
        for along in (-1.0, 1.0):
            corner = frame.centre_mm + across * frame.half_across_mm + along * frame.half_along_mm
            nearest = np.argmin(((centres - corner) ** 2).sum(axis=1))
            if (corner - centres[nearest]) @ normals[nearest] <= 0.0:
                place = ", ".join(f"{v:.1f}" for v in corner)
                raise ImpossibleFingerError(
                    f"the light panel at position_mm = {list(light.position_mm)}, angle_deg = {light.angle_deg:g} has "
                    f"a corner at ({place}) mm, behind the gel's inner face ({shape.label}); move it to smaller y"
                )


def wall_emitter(radiance: NDArray[np.float64], renderer: ModuleType) -> dict[str, Any]:
    """Return an area emitter whose radiance is a (along z, up the wall, 3) map.

    A texture, never a mesh attribute: with one, emitter sampling returns nearly nothing.
    """
    texels = wall_texels(radiance, renderer)
    bitmap = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
    return {"type": "area", "radiance": bitmap}


def wall_texels(radiance: NDArray[np.float64], renderer: ModuleType) -> Any:
    """Return a (along z, up the wall, 3) map as the renderer's texture data."""
    return renderer.TensorXf(aligned(radiance))


def panel_shape(light: LightPanel, renderer: ModuleType, reflectance: float) -> dict[str, Any]:
    """Return the light panel: a Lambertian rectangle that shines on the side of its normal."""
    radiance = np.array([0.0, 0.0, PANEL_RADIANCE_REL * light.power_rel])
    return shining_rectangle(panel_frame(light), radiance, renderer, reflectance)


def shining_rectangle(
    frame: PanelFrame, radiance: NDArray[np.float64], renderer: ModuleType, reflectance: float
) -> dict[str, Any]:
    """Return a Lambertian rectangle of the given channels."""
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = frame.half_across_mm, frame.half_along_mm
    matrix[:3, 2], matrix[:3, 3] = frame.normal, frame.centre_mm
    return {
        "type": "rectangle",
        "to_world": renderer.ScalarTransform4f(matrix),
        "bsdf": diffuse(reflectance),
        "emitter": {"type": "area", "radiance": rgb(radiance)},
    }


def camera_sensor(
    design: FingerDesign,
    renderer: ModuleType,
    calibration: CameraCalibration | None = None,
    window: Window | None = None,
) -> dict[str, Any]:
    """Return the camera at the base, one pixel per Bayer cell; with a window, only these pixels.

    An ideal pinhole of the design's field of view, or the calibrated camera in its place.
    """
    return pose_sensor(camera_pose(design), renderer, calibration, window)


def pose_sensor(
    pose: CameraPose,
    renderer: ModuleType,
    calibration: CameraCalibration | None = None,
    window: Window | None = None,
) -> dict[str, Any]:
    """Return a camera in a pose: an ideal pinhole, or the calibrated camera; with a window, only these pixels."""
    film = band_film(pose.columns_px, pose.rows_px) | ({} if window is None else window.film_crop())
    # the renderer's cameras look along z with x to the left and y up
    to_world = np.eye(4)
    to_world[:3] = np.column_stack([-pose.right, -pose.down, pose.forward, pose.centre_mm])
    transform = renderer.ScalarTransform4f(to_world)
    if calibration is not None:
        return opencv_sensor(calibration, transform, film, renderer)
    return {
        "type": "perspective",
        "fov": float(np.degrees(2.0 * np.arctan(pose.tan_half_width))),
        "fov_axis": "x",
        "near_clip": 0.1,
        "to_world": transform,
        "film": film,
        "sampler": {"type": "independent", "sample_count": 16},
    }


def band_film(columns_px: int, rows_px: int) -> dict[str, Any]:
    """Return a film of raw band values without a reconstruction filter: pixels stay independent."""
    return {
        "type": "hdrfilm",
        "width": columns_px,
        "height": rows_px,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }


def _box(design: FingerDesign, shape: FingerShape, renderer: ModuleType) -> dict[str, Any]:
    """Return the dark cloth around everything."""
    corners = [s.vertices_mm for s in shape.surfaces.values()] + [camera_pose(design).centre_mm[None, :]]
    for light in design.lights:
        reach = np.hypot(light.width_mm, light.height_mm) / 2.0
        corners += [np.array([light.position_mm]) + side * reach for side in (-1.0, 1.0)]
    enclosure = design.enclosure
    return dark_box(np.concatenate(corners), enclosure.cloth_reflectance, renderer, enclosure.cloth_clearance_mm)


def dark_box(
    points_mm: NDArray[np.float64], reflectance: float, renderer: ModuleType, clearance_mm: float
) -> dict[str, Any]:
    """Return a box around points, seen from inside."""
    low, high = points_mm.min(axis=0) - clearance_mm, points_mm.max(axis=0) + clearance_mm
    transform = renderer.ScalarTransform4f().translate(((low + high) / 2.0).tolist())
    return {
        "type": "cube",
        "to_world": transform @ renderer.ScalarTransform4f().scale(((high - low) / 2.0).tolist()),
        "flip_normals": True,
        "bsdf": diffuse(reflectance),
    }


def surface_mesh(
    renderer: ModuleType,
    name: str,
    surface: Surface,
    bsdf: Mapping[str, Any],
    emitter: Mapping[str, Any] | None = None,
    smooth: bool = False,
) -> Any:
    """Return a renderer mesh of a surface; only smooth ones get interpolated normals."""
    properties = renderer.Properties()
    properties["mesh_bsdf"] = renderer.load_dict(dict(bsdf))
    if emitter is not None:
        properties["mesh_emitter"] = renderer.load_dict(dict(emitter))
    properties["face_normals"] = not smooth
    mesh = renderer.Mesh(
        name,
        len(surface.vertices_mm),
        len(surface.triangles),
        props=properties,
        has_vertex_normals=smooth,
        has_vertex_texcoords=True,
    )
    parameters = renderer.traverse(mesh)
    parameters["vertex_positions"] = aligned(surface.vertices_mm).ravel()
    parameters["faces"] = np.ascontiguousarray(surface.triangles, dtype=np.uint32).ravel()
    parameters["vertex_texcoords"] = aligned(surface.uv).ravel()
    parameters.update()
    if smooth:
        mesh.recompute_vertex_normals()
    return mesh


# evaporated aluminium, rounded handbook values: wavelength in nm, n, k
_ALUMINIUM = np.array(
    [
        [400.0, 0.490, 4.86],
        [450.0, 0.618, 5.47],
        [500.0, 0.769, 6.08],
        [550.0, 0.958, 6.69],
        [600.0, 1.200, 7.26],
        [650.0, 1.470, 7.79],
        [700.0, 1.830, 8.31],
    ]
)


def rgb(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return band values as the renderer's three channels."""
    return {"type": "rgb", "value": [float(v) for v in values]}


def diffuse(reflectance: float) -> dict[str, Any]:
    """Return a grey Lambertian material."""
    return {"type": "diffuse", "reflectance": rgb(np.full(3, reflectance))}


def gel_face(design: FingerDesign) -> dict[str, Any]:
    """Return the bare face of the gel; its index is that at the LED, whose light must find its way exactly.

    The painted bands see an index lower by up to 0.01, which moves what a pixel sees by less than 0.05 mm. A film on it
    is the integrator's matter (:meth:`sim.optics._band_paths.BandPaths.film_factor`): Mitsuba's own know none.
    """
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}


def metal(design: FingerDesign, bands: PaintBands, renderer: ModuleType) -> dict[str, Any]:
    """Return the coating of a finger, in bands or in full spectra."""
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    if not renderer.variant().endswith("_spectral"):
        return coating(design.coating, np.array([band.centroid_nm for band in bands.bands]), index)
    # the renderer's own spectra end in zero, and a metal of n = k = 0 is not a number
    eta, k = (extended_spectrum(_ALUMINIUM[:, 0], _ALUMINIUM[:, column] / index) for column in (1, 2))
    return _blend(design.coating, eta, k)


RENDERED_NM = (360.0, 830.0)
"""Wavelengths the renderer can draw."""


def extended_spectrum(wavelength_nm: NDArray[np.float64], values: NDArray[np.float64]) -> dict[str, Any]:
    """Return a curve as the renderer's spectrum, with its end values held over all rendered wavelengths.

    The renderer's own spectra are zero outside their range; a metal with n = k = 0 is then not a number.
    """
    inner = (wavelength_nm > RENDERED_NM[0]) & (wavelength_nm < RENDERED_NM[1])
    grid = np.concatenate([RENDERED_NM[:1], wavelength_nm[inner], RENDERED_NM[1:]])
    held = np.interp(grid, wavelength_nm, values)
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{w:.9g}" for w in grid),
        "values": ", ".join(f"{v:.9g}" for v in held),
    }


def coating(
    coat: Coating, centroids_nm: NDArray[np.float64], index: float, paint: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the aluminium coating as seen from inside a gel of this index, for channels at these wavelengths.

    Its diffuse part is the coat's grey, or another paint.
    """
    # the renderer takes conductors to stand in vacuum; relative to gel, n and k are divided by its index
    eta, k = (rgb(np.interp(centroids_nm, _ALUMINIUM[:, 0], _ALUMINIUM[:, c]) / index) for c in (1, 2))
    return _blend(coat, eta, k, paint)


def _blend(
    coat: Coating, eta: dict[str, Any], k: dict[str, Any], paint: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the blend of rough metal and diffuse part."""
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": coat.roughness_alpha, "eta": eta, "k": k}
    blend = {
        "type": "blendbsdf",
        "weight": coat.diffuse_share,
        "metal": metal,
        "diffuse": diffuse(coat.diffuse_reflectance) if paint is None else dict(paint),
    }
    return {"type": "twosided", "coating": blend}


def mirror(design: FingerDesign) -> dict[str, Any]:
    """Return the mirror's material."""
    reflectance = rgb(np.full(3, design.mirror.reflectance))
    metal = {"type": "conductor", "material": "none", "specular_reflectance": reflectance}
    return {"type": "twosided", "metal": metal}
