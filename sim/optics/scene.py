"""Mitsuba scenes of the finger: gel, coating, painted walls, mirror, dark box, light panel, camera (mm).

The three channels of the renderer are the bands red emission, green emission, LED. Radiance is relative to that
of the light panel.
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign, LightPanel
from sim.optics.finger_view import MirrorShape, Window, camera_pose, mirror_shape
from sim.optics.gel_surfaces import Surface, check_closed, gel_surfaces
from sim.optics.paint_bands import PaintBands
from sim.optics.refracted_light import panel_frame

PANEL_RADIANCE_REL = 1.0
BOX_REFLECTANCE = 0.04
PANEL_REFLECTANCE = 0.05
MAX_DEPTH = 30
ROULETTE_DEPTH = 6

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
_MIRROR_ROWS = 241
_BOX_CLEARANCE_MM = 8.0


def finger_scene(
    design: FingerDesign,
    bands: PaintBands,
    renderer: ModuleType,
    emission: Mapping[str, NDArray[np.float64]] | None = None,
    sensor: Mapping[str, Any] | None = None,
) -> Any:
    """Build the renderer's scene of one finger.

    Parameters
    ----------
    design
        Finger; the indenter of the design is pressed in.
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
        When the gel's surfaces are open or face inward.
    """
    surfaces = gel_surfaces(design)
    check_closed(surfaces)
    glass = {"type": "dielectric", "int_ior": design.pad.refractive_index, "ext_ior": 1.0}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": ROULETTE_DEPTH},
        "coat": _mesh(renderer, "coat", surfaces["coat"], _coating(design, bands), smooth=True),
        "mirror": _mesh(renderer, "mirror", _mirror_surface(mirror_shape(design)), _mirror(design), smooth=True),
        "panel": panel_shape(design.light, renderer),
        "box": _box(design, renderer),
        "sensor": dict(sensor) if sensor is not None else camera_sensor(design, renderer),
    }
    for name in ("inner", "base", "tip"):
        scene[name] = _mesh(renderer, name, surfaces[name], glass)
    for name in ("red", "green"):
        paint = {"type": "diffuse", "reflectance": _rgb(bands.reflectance[name])}
        emitter = None if emission is None else wall_emitter(emission[name], renderer)
        scene[name] = _mesh(renderer, name, surfaces[name].reversed(), paint, emitter=emitter)
    return renderer.load_dict(scene)


def wall_emitter(radiance: NDArray[np.float64], renderer: ModuleType) -> dict[str, Any]:
    """Return an area emitter whose radiance is a (along z, up the wall, 3) map.

    A texture, never a mesh attribute: with one, emitter sampling returns nearly nothing.
    """
    texels = wall_texels(radiance, renderer)
    bitmap = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
    return {"type": "area", "radiance": bitmap}


def wall_texels(radiance: NDArray[np.float64], renderer: ModuleType) -> Any:
    """Return a (along z, up the wall, 3) map as the renderer's texture data."""
    return renderer.TensorXf(np.ascontiguousarray(radiance, dtype=np.float32))


def panel_shape(light: LightPanel, renderer: ModuleType) -> dict[str, Any]:
    """Return the light panel: a Lambertian rectangle that shines on the side of its normal."""
    frame = panel_frame(light)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = frame.half_across_mm, frame.half_along_mm
    matrix[:3, 2], matrix[:3, 3] = frame.normal, frame.centre_mm
    return {
        "type": "rectangle",
        "to_world": renderer.ScalarTransform4f(matrix),
        "bsdf": {"type": "diffuse", "reflectance": _rgb(np.full(3, PANEL_REFLECTANCE))},
        "emitter": {"type": "area", "radiance": _rgb(np.array([0.0, 0.0, PANEL_RADIANCE_REL]))},
    }


def camera_sensor(design: FingerDesign, renderer: ModuleType, window: Window | None = None) -> dict[str, Any]:
    """Return the camera at the base, one pixel per Bayer cell; with a window, only these pixels."""
    pose = camera_pose(design)
    crop = {} if window is None else window.film_crop()
    return {
        "type": "perspective",
        "fov": float(np.degrees(2.0 * np.arctan(pose.tan_half_width))),
        "fov_axis": "x",
        "near_clip": 0.1,
        "to_world": renderer.ScalarTransform4f().look_at(
            origin=pose.centre_mm.tolist(),
            target=(pose.centre_mm + pose.forward).tolist(),
            up=(-pose.down).tolist(),
        ),
        "film": band_film(pose.columns_px, pose.rows_px) | crop,
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


def _rgb(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return band values as the renderer's three channels."""
    return {"type": "rgb", "value": [float(v) for v in values]}


def _coating(design: FingerDesign, bands: PaintBands) -> dict[str, Any]:
    """Return the aluminium coating as seen from inside the gel."""
    centroids = [band.centroid_nm for band in bands.bands]
    # the renderer takes conductors to stand in vacuum; relative to gel, n and k are divided by its index
    eta, k = (np.interp(centroids, _ALUMINIUM[:, 0], _ALUMINIUM[:, c]) / design.pad.refractive_index for c in (1, 2))
    metal = {
        "type": "roughconductor",
        "distribution": "ggx",
        "alpha": design.coating.roughness_alpha,
        "eta": _rgb(eta),
        "k": _rgb(k),
    }
    diffuse = {"type": "diffuse", "reflectance": _rgb(np.full(3, design.coating.diffuse_reflectance))}
    blend = {"type": "blendbsdf", "weight": design.coating.diffuse_share, "metal": metal, "diffuse": diffuse}
    return {"type": "twosided", "coating": blend}


def _mirror(design: FingerDesign) -> dict[str, Any]:
    """Return the mirror's material."""
    reflectance = _rgb(np.full(3, design.mirror.reflectance))
    metal = {"type": "conductor", "material": "none", "specular_reflectance": reflectance}
    return {"type": "twosided", "metal": metal}


def _mirror_surface(mirror: MirrorShape) -> Surface:
    """Triangulate the convex mirror."""
    s = np.linspace(-mirror.half_length_mm, mirror.half_length_mm, _MIRROR_ROWS)
    sag = s**2 / (2.0 * mirror.radius_mm)
    yz = mirror.apex_yz_mm + s[:, None] * mirror.tangent_yz - sag[:, None] * mirror.normal_yz
    x = np.array([-mirror.half_width_mm, mirror.half_width_mm])
    left, right = (np.column_stack([np.full(s.size, v), yz]) for v in x)
    k = np.arange(s.size - 1)
    n = s.size
    triangles = np.concatenate([np.column_stack([k, k + 1, n + k + 1]), np.column_stack([k, n + k + 1, n + k])])
    uv = np.column_stack([np.repeat([0.0, 1.0], n), np.tile(np.linspace(0.0, 1.0, n), 2)])
    return Surface(np.concatenate([left, right]), triangles, uv)


def _box(design: FingerDesign, renderer: ModuleType) -> dict[str, Any]:
    """Return the dark box around everything."""
    mirror, camera = mirror_shape(design), camera_pose(design).centre_mm
    ends = mirror.apex_yz_mm + np.array([[-1.0], [1.0]]) * mirror.half_length_mm * mirror.tangent_yz
    panel = np.array(design.light.position_mm)
    reach = np.hypot(design.light.width_mm, design.light.height_mm) / 2.0
    low = np.min([[-design.pad.width_mm / 2.0, *ends.min(0)], camera, panel - reach], axis=0) - _BOX_CLEARANCE_MM
    top = [design.pad.width_mm / 2.0, 1.5 * design.pad.thickness_mm, design.pad.length_mm]
    high = np.max([top, [0.0, *ends.max(0)], panel + reach], axis=0) + _BOX_CLEARANCE_MM
    transform = renderer.ScalarTransform4f().translate(((low + high) / 2.0).tolist())
    return {
        "type": "cube",
        "to_world": transform @ renderer.ScalarTransform4f().scale(((high - low) / 2.0).tolist()),
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": _rgb(np.full(3, BOX_REFLECTANCE))},
    }


def _mesh(
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
    parameters["vertex_positions"] = np.ascontiguousarray(surface.vertices_mm, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(surface.triangles, dtype=np.uint32).ravel()
    parameters["vertex_texcoords"] = np.ascontiguousarray(surface.uv, dtype=np.float32).ravel()
    parameters.update()
    if smooth:
        mesh.recompute_vertex_normals()
    return mesh
