"""A press on a classic sensor: the coat by its indenter, by a height map or by a mesh, rendered as a record."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from data_schemas import CoatSurface, PlainSensor, SimulatedPress, SimulateError
from sim.mechanics import read_triangles, rigid_indenter
from sim.optics import (
    GelHeight,
    analytic_gel,
    pad_grid_mm,
    render_plain_sensor,
    seen_places_mm,
    sensor_calibration,
)
from sim.surface_meshes import (
    check_analytic_press,
    contact_distance,
    height_over_pad_mm,
    imprinted_height_mm,
    read_height_map,
    rest_height_mm,
)

Floats = NDArray[np.float64]

_FINEST_GRID = 1000
_THINNEST_GEL_MM = 0.05
_LARGEST_CLIFF_MM = 0.05
# of the deepest place; shallower ones are noise of a map as likely as contact
_CONTACT_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class PressedCoat:
    """The gel of a classic sensor without and with contact.

    Attributes
    ----------
    rest, pressed
        On one grid.
    distance
        From the contact's centre in units of its half-width, (nx, nz); the contact is where it is <= 1. Where no
        formula knows the contact, it is the circle of equal area about its middle.
    label
        Where the shape comes from, in words.
    files
        What was read.
    """

    rest: GelHeight
    pressed: GelHeight
    distance: Floats
    label: str
    files: tuple[Path, ...] = ()


def pressed_coat(sensor: PlainSensor, folder: Path = Path()) -> PressedCoat:
    """Return the coat of a sensor with what its design presses in.

    A ball and a cylinder along x are pressed in by the analytic press, other bodies by the imprint of
    :func:`sim.surface_meshes.imprinted_height_mm`; a [surface] is taken as it is.

    Parameters
    ----------
    sensor
        The sensor.
    folder
        Where the files that the design names are.

    Raises
    ------
    SimulateError
        A file cannot be read, or what it holds does not fit the pad.
    """
    if sensor.surface is not None:
        return _given_coat(sensor, sensor.surface, folder)
    design = sensor.pressed_pad()
    indenter = design.indenter
    by_formula = indenter.shape == "ball" or (
        indenter.shape == "cylinder" and indenter.across_mm == 0.0 and not any(indenter.rotation_deg)
    )
    if by_formula or indenter.depth_mm == 0.0:
        check_analytic_press(design)
        rest, pressed = (analytic_gel(sensor, state) for state in (False, True))
        distance = contact_distance(design, rest.x_mm[:, None], rest.z_mm[None, :])
        return PressedCoat(rest, pressed, distance, "analytic press" if indenter.depth_mm else "at rest")
    return _imprint(sensor, folder)


def _imprint(sensor: PlainSensor, folder: Path) -> PressedCoat:
    """Press a rigid body of any shape in."""
    design = sensor.pressed_pad()
    rest = analytic_gel(sensor, False)
    body = rigid_indenter(design, folder)
    vertices = body.vertices_mm(-design.indenter.depth_mm)
    tool = height_over_pad_mm(vertices[body.surface.triangles], rest.x_mm, rest.z_mm, "lowest")
    _require_gel(np.where(np.isnan(tool), np.inf, tool), "indenter.depth_mm presses it in so far that it")
    height = imprinted_height_mm(rest.height_mm, tool, rest.x_mm, rest.z_mm, sensor.pad.thickness_mm)
    pressed = replace(rest, height_mm=height)
    distance = _equal_circle(np.nan_to_num(tool, nan=np.inf) < rest.height_mm, rest)
    files = () if design.indenter.file is None else (folder / design.indenter.file,)
    return PressedCoat(rest, pressed, distance, f"imprint of a {design.indenter.shape}", files)


def _given_coat(sensor: PlainSensor, surface: CoatSurface, folder: Path) -> PressedCoat:
    """Take the coat from a height map or mesh."""
    path = folder / surface.file
    step = surface.step_mm or 0.0
    largest = max(sensor.pad.length_mm, sensor.pad.width_mm)
    x, z = pad_grid_mm(sensor, min(0.15, max(step, largest / _FINEST_GRID))) if step else pad_grid_mm(sensor)
    undeformed = rest_height_mm(sensor.pressed_pad(), x[:, None], z[None, :])
    if path.suffix.lower() == ".stl":
        vertices, triangles = read_triangles(path, "the coat as a mesh (surface.file, STL)")
        height = height_over_pad_mm(vertices[triangles], x, z, "highest")
        if np.isnan(height).any():
            raise SimulateError(
                f"{path}: covers {np.isfinite(height).mean():.0%} of the pad; a mesh of the coat must cover all of it, "
                f"x = {x[0]:g} to {x[-1]:g} mm and z = 0 to {z[-1]:g} mm in the axes of the pad"
            )
    else:
        height = _mapped(sensor, surface, path, (x, z), undeformed)
    _require_gel(height, f"{path}: the coat")
    depth = undeformed - height
    touched = depth > _CONTACT_SHARE * max(float(depth.max()), 0.0)
    rest = GelHeight(x, z, undeformed)
    label = f"coat from {path.name}"
    return PressedCoat(rest, replace(rest, height_mm=height), _equal_circle(touched, rest), label, (path,))


def _require_gel(height_mm: Floats, what: str) -> None:
    """Check that a coat leaves gel everywhere."""
    lowest = float(height_mm.min())
    if lowest < _THINNEST_GEL_MM:
        raise SimulateError(
            f"{what} comes to {lowest:.4g} mm above the inner face; at least {_THINNEST_GEL_MM:g} mm of gel must be "
            "left (is it in mm? see unit_mm, and holds: depth or height)"
        )


def _mapped(
    sensor: PlainSensor, surface: CoatSurface, path: Path, grid: tuple[Floats, Floats], undeformed: Floats
) -> Floats:
    """Return the height of the coat by a map, (nx, nz); the coat at rest outside it."""
    values = read_height_map(path) * (surface.unit_mm or 1.0)
    rows, columns = values.shape
    step = surface.step_mm or 0.0
    middle = sensor.pad.length_mm / 2.0 if surface.position_mm is None else surface.position_mm
    across = surface.across_mm + (np.arange(columns) - (columns - 1) / 2.0) * step
    along = middle + (np.arange(rows) - (rows - 1) / 2.0) * step
    x, z = grid
    # rows run against z
    read = RegularGridInterpolator((across, along), values[::-1].T, bounds_error=False, fill_value=np.nan)
    found = read(np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1))
    known = np.isfinite(found)
    if not known.any():
        raise SimulateError(f"{path}: the map lies beside the pad; see surface.position_mm and surface.across_mm")
    height = np.where(known, found if surface.holds == "height" else undeformed - found, undeformed)
    _require_no_cliff(path, known, np.where(known, undeformed - height, 0.0))
    return np.asarray(height)


def _require_no_cliff(path: Path, known: NDArray[np.bool_], depth_mm: Floats) -> None:
    """Check that a map that ends on the pad ends at the height of the coat at rest."""
    cliff = 0.0
    for axis in (0, 1):
        border = np.diff(known.astype(np.int8), axis=axis) != 0
        step = np.abs(np.diff(depth_mm, axis=axis))
        cliff = max(cliff, float(step[border].max(initial=0.0)))
    if cliff > _LARGEST_CLIFF_MM:
        raise SimulateError(
            f"{path}: the map ends on the pad with a step of {cliff:.3g} mm; at most {_LARGEST_CLIFF_MM:g} mm is "
            "allowed: give a map that covers the pad, or one whose rim lies at rest"
        )


def _equal_circle(touched: NDArray[np.bool_], gel: GelHeight) -> Floats:
    """Return the distance from the middle of a contact in units of the radius of the circle of its area."""
    if not touched.any():
        return np.full(touched.shape, np.nan)
    x, z = np.meshgrid(gel.x_mm, gel.z_mm, indexing="ij")
    cell = float((gel.x_mm[1] - gel.x_mm[0]) * (gel.z_mm[1] - gel.z_mm[0]))
    radius = np.sqrt(touched.sum() * cell / np.pi)
    return np.asarray(np.hypot(x - x[touched].mean(), z - z[touched].mean()) / radius)


def simulate_sensor_press(
    sensor: PlainSensor, folder: Path, renderer: ModuleType, seed: int, samples_per_pixel: int
) -> tuple[SimulatedPress, tuple[Path, ...]]:
    """Render the contact and no-contact image of a classic sensor.

    Parameters
    ----------
    sensor
        The sensor, with what is pressed in.
    folder
        Where the files that the design names are.
    renderer
        From :func:`sim.optics.open_renderer`.
    seed, samples_per_pixel
        Random seed, paths per pixel (an even number).

    Returns
    -------
    press
        Linear RGB; the unit is that of :class:`sim.optics.PlainRender`.
    files
        What was read of the coat.

    Raises
    ------
    SimulateError
        The coat cannot be made, see :func:`pressed_coat`, or the camera does not see it.
    """
    coat = pressed_coat(sensor, folder)
    places = seen_places_mm(sensor, coat.pressed, renderer, sensor_calibration(sensor, folder))
    at = RegularGridInterpolator((coat.rest.x_mm, coat.rest.z_mm), coat.distance, bounds_error=False)
    seen = np.isfinite(places[..., 0])
    distance = np.full(seen.shape, np.nan, dtype=np.float32)
    inside = [np.clip(places[seen][:, k], grid[0], grid[-1]) for k, grid in enumerate((coat.rest.x_mm, coat.rest.z_mm))]
    distance[seen] = at(np.stack(inside, axis=-1))
    render = render_plain_sensor(
        sensor, renderer, seed, samples_per_pixel, gels=(coat.rest, coat.pressed), folder=folder
    )
    pressed = f"press of {sensor.indenter.depth_mm:g} mm" if sensor.surface is None else coat.label
    press = SimulatedPress(
        name=f"{sensor.name}, {pressed}",
        label=f"rendered, classic sensor, {render.variant}",
        method="rendered",
        encoding="linear",
        no_contact=render.no_contact,
        contact=render.contact,
        distance=distance,
        variance=render.contact_variance,
        light_angle_deg=None,
        design=None,
        sensor=sensor,
        notes=(f"shape of the pressed coat: {coat.label}",),
    )
    return press, coat.files
