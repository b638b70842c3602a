"""Presses on a classic sensor, by its indenter, a height map or a mesh; and ball presses all over a pad, rendered.

To the ball presses a table of colour against slope, as Taxim uses it, is fitted: on the flat pad of a classic sensor,
or on the pad of a painted finger, brought into the plane of its pad.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, RectBivariateSpline, RegularGridInterpolator
from scipy.ndimage import map_coordinates

from data_schemas import CoatSurface, FingerDesign, Indenter, PlainSensor, SimulatedPress, SimulateError
from sim.experiments._painted_finger import PaintedFinger
from sim.experiments._rendered_press import camera_rgb
from sim.mechanics import press_layer, read_triangles, rigid_indenter
from sim.optics import (
    GelHeight,
    PixelMaps,
    Progress,
    RenderSettings,
    analytic_gel,
    pad_grid_mm,
    plain_sensor_integrator,
    plain_sensor_scene,
    render_plain_sensor,
    render_press,
    seen_places_mm,
    sensor_calibration,
    stream_seed,
)
from sim.surface_meshes import (
    FingerShape,
    contact_distance,
    contact_half_width_mm,
    gel_faces,
    height_over_pad_mm,
    imprinted_height_mm,
    pressed_height_mm,
    read_height_map,
    rest_height_mm,
    rest_shape,
)

Floats = NDArray[np.float64]

_FINEST_GRID = 1000
_THINNEST_GEL_MM = 0.05
_LARGEST_CLIFF_MM = 0.05
_ROUNDING_MM = 1e-9
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

    The body is pressed into an elastic layer of the pad's thickness, :func:`sim.mechanics.press_layer`; a [surface] is
    taken as it is. The depth counts from first touch. Where the pad is curved, the layer is that of its crown. A body
    is known at the places of the coat, 0.15 mm apart: a finer peak is blunted.

    Parameters
    ----------
    sensor
        The sensor.
    folder
        Where the files that the design names are.

    Raises
    ------
    SimulateError
        A file cannot be read, or what it holds does not fit the pad, or the body leaves no gel under it.
    """
    if sensor.surface is not None:
        return _given_coat(sensor, sensor.surface, folder)
    rest, design = analytic_gel(sensor, False), sensor.pressed_pad()
    if design.indenter.depth_mm == 0.0:
        return PressedCoat(rest, rest, np.full(rest.height_mm.shape, np.nan), "at rest")
    tool = _tool_mm(design, rest, folder)
    _require_under(tool, design)
    if (tool < rest.height_mm).all():
        raise SimulateError(
            f"the {design.indenter.shape} covers the pad from end to end and leaves no free gel; make the indenter "
            "smaller"
        )
    layer = press_layer(rest.height_mm - tool, rest.x_mm, rest.z_mm, sensor.pad.thickness_mm, sensor.gel_poisson_ratio)
    pressed = replace(rest, height_mm=rest.height_mm - layer.sunk_mm)
    files = () if design.indenter.file is None else (folder / design.indenter.file,)
    label = f"elastic layer under a {design.indenter.shape}"
    return PressedCoat(rest, pressed, _equal_circle(layer.pressure_rel > 0.0, rest), label, files)


def _tool_mm(design: FingerDesign, rest: GelHeight, folder: Path) -> Floats:
    """Return the lowest height of the indenter over each place of the pad, (nx, nz); inf where it is not."""
    indenter = design.indenter
    if not _is_by_formula(indenter):
        return _body_mm(design, rest, folder)
    across = rest.x_mm[:, None] - indenter.across_mm
    across = across if indenter.shape == "ball" else 0.0 * across
    offset, radius = np.hypot(across, rest.z_mm - indenter.position_mm), indenter.radius_mm
    under = np.where(offset < radius, -np.sqrt(np.maximum(radius**2 - offset**2, 0.0)), np.inf)
    first_touch = float((rest.height_mm - under).max())
    return np.asarray(under + first_touch - indenter.depth_mm)


def _body_mm(design: FingerDesign, rest: GelHeight, folder: Path) -> Floats:
    """Return the same of a body by its triangles."""
    body = rigid_indenter(design, folder)
    body.check_surface()
    corners = body.vertices_mm(-design.indenter.depth_mm)[body.surface.triangles]
    return np.nan_to_num(height_over_pad_mm(corners, rest.x_mm, rest.z_mm, "lowest"), nan=np.inf)


def _require_under(tool_mm: Floats, design: FingerDesign) -> None:
    """Check that an indenter leaves gel under it."""
    left_mm = float(tool_mm.min())
    if left_mm < _THINNEST_GEL_MM:
        most = design.indenter.depth_mm + left_mm - _THINNEST_GEL_MM
        raise SimulateError(
            f"indenter.depth_mm = {design.indenter.depth_mm:g} mm goes through the pad, but {_THINNEST_GEL_MM:g} mm of "
            f"gel must be left; reduce indenter.depth_mm to at most {max(most, 0.0):.3g} mm"
        )


def _is_by_formula(indenter: Indenter) -> bool:
    """Return whether the indenter is a ball, a cylinder straight across, or none: its shape is a formula."""
    is_straight = indenter.across_mm == 0.0 and not any(indenter.rotation_deg)
    return indenter.depth_mm == 0.0 or indenter.shape == "ball" or (indenter.shape == "cylinder" and is_straight)


def _imprinted(design: FingerDesign, rest: GelHeight, folder: Path) -> tuple[GelHeight, Floats]:
    """Return the coat with the body of a design in it, and the distance from the contact's middle."""
    tool = _body_mm(design, rest, folder)
    _require_under(tool, design)
    height = imprinted_height_mm(rest.height_mm, tool, rest.x_mm, rest.z_mm, design.pad.thickness_mm)
    return replace(rest, height_mm=height), _equal_circle(tool < rest.height_mm, rest)


_IMPRINT_STEP_MM = 0.2


def imprinted_shapes(design: FingerDesign, folder: Path = Path()) -> tuple[FingerShape, FingerShape] | None:
    """Return a finger without and with the imprint of a body that the analytic press does not know; None if it does.

    As :func:`sim.surface_meshes.imprinted_height_mm`: the body's own shape with a bulge around it, no mechanics. The
    finger does not bend, and the depth counts from first touch. A contact's distance is that from its middle in radii
    of the circle of its area.

    Parameters
    ----------
    design
        Finger and indenter.
    folder
        Where the indenter's file is.

    Raises
    ------
    SimulateError
        The indenter cannot be read, does not meet the pad, or goes through it.
    """
    if _is_by_formula(design.indenter):
        return None
    x, z = pad_grid_mm(design.pad, _IMPRINT_STEP_MM)
    gel = GelHeight(x, z, rest_height_mm(design, x[:, None], z[None, :]))
    pressed, distance = _imprinted(design, gel, folder)
    mirror = rest_shape(design).surfaces["mirror"]
    label = f"imprint of a {design.indenter.shape}, no mechanics"
    return (
        FingerShape(
            {**gel_faces(x, gel.height_mm, z), "mirror": mirror}, np.full(distance.size, np.nan), "at rest", True
        ),
        FingerShape({**gel_faces(x, pressed.height_mm, z), "mirror": mirror}, distance.ravel(), label, True),
    )


def _given_coat(sensor: PlainSensor, surface: CoatSurface, folder: Path) -> PressedCoat:
    """Take the coat from a height map or mesh."""
    path = folder / surface.file
    step = surface.step_mm or 0.0
    largest = max(sensor.pad.length_mm, sensor.pad.width_mm)
    finest = max(step, largest / _FINEST_GRID)
    x, z = pad_grid_mm(sensor.pad, min(0.15, finest)) if step else pad_grid_mm(sensor.pad)
    undeformed = rest_height_mm(sensor.pressed_pad(), x[:, None], z[None, :])
    if path.suffix.lower() == ".stl":
        vertices, triangles = read_triangles(path, "the coat as a mesh (surface.file, STL)")
        height = height_over_pad_mm(vertices[triangles], x, z, "highest")
        if np.isnan(height).any():
            raise SimulateError(
                f"{path}: covers only {100 * np.isfinite(height).mean():.0f} % of the pad, but a mesh of the coat must "
                f"cover all of it, x = {x[0]:g} to {x[-1]:g} mm and z = 0 to {z[-1]:g} mm in the axes of the pad"
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
            f"{what} reaches down to {lowest:.4g} mm above the inner face, but at least {_THINNEST_GEL_MM:g} mm of gel "
            "must be left; check unit_mm, and whether surface.holds is depth or height"
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
    # a map of the pad's size may end inside it by rounding
    ends = [np.clip(own, on[0], on[-1]) for own, on in zip(grid, (across, along), strict=True)]
    x, z = (np.where(np.abs(own - end) < _ROUNDING_MM, end, own) for own, end in zip(grid, ends, strict=True))
    # rows run against z
    read = RegularGridInterpolator((across, along), values[::-1].T, bounds_error=False, fill_value=np.nan)
    found = read(np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1))
    known = np.isfinite(found)
    if not known.any():
        raise SimulateError(
            f"{path}: the map does not lie on the pad; correct surface.position_mm and surface.across_mm"
        )
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
            f"{path}: the map ends on the pad with a step of {cliff:.3g} mm, but at most {_LARGEST_CLIFF_MM:g} mm is "
            "allowed; give a map that covers the pad, or a map whose border is undeformed"
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


DEPTHS_REL = (0.1, 0.2, 0.3)
"""Depths of the presses in thicknesses of the pad, one after the other."""

_STEP_MM = 0.1
# from here on a ball is a hole with vertical sides
_DEEPEST_IN_RADII = 0.9
# steps of the golden section in two dimensions (the plastic number): even, and never on a line
_PLASTIC = 1.32471795724474602596
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class BallPresses:
    """Renders of ball presses in the plane of the undeformed pad, one pixel being `mm_per_px` everywhere.

    Attributes
    ----------
    no_contact
        (H, W, 3) linear colours without contact.
    contacts
        (press, H, W, 3).
    slopes
        (press, H, W, 2) of the coat where the pixel sees it: d depth / d place along columns and along rows, NaN off
        the pad.
    distance
        (press, H, W) from the contact's centre in units of its half-width, NaN off the pad.
    row_px, column_px, radius_px
        (press,) contact circles.
    ball_radius_mm, thickness_mm, mm_per_px
        Of the ball, of the pad, of a pixel.
    label
        What was rendered.
    """

    no_contact: NDArray[np.float32]
    contacts: NDArray[np.float32]
    slopes: Floats
    distance: Floats
    row_px: Floats
    column_px: Floats
    radius_px: Floats
    ball_radius_mm: float
    thickness_mm: float
    mm_per_px: float
    label: str

    def only(self, chosen: Sequence[int]) -> "BallPresses":
        """Return some of the presses."""
        arrays = ("contacts", "slopes", "distance", "row_px", "column_px", "radius_px")
        return replace(self, **{name: getattr(self, name)[list(chosen)] for name in arrays})


def planned_presses(pad_design: FingerDesign, ball_radius_mm: float, count: int) -> list[FingerDesign]:
    """Spread presses of a ball evenly over a flat pad, at depths of 0.1, 0.2 and 0.3 thicknesses in turn.

    Parameters
    ----------
    pad_design
        The pad; its own indenter does not matter.
    ball_radius_mm
        Radius of the ball.
    count
        Number of presses.

    Raises
    ------
    SimulateError
        When the pad is curved (Taxim takes all slope for contact), or ball and pad do not fit together.
    """
    pad = pad_design.pad
    if pad.shape != "flat":
        raise SimulateError(
            f"pad.shape = {pad.shape!r} cannot be exported, because Taxim's table treats every slope as contact, also "
            "that of a curved pad at rest; export a flat pad"
        )
    deepest = max(DEPTHS_REL) * pad.thickness_mm
    margin = float(np.sqrt(2.0 * ball_radius_mm * deepest - min(deepest, ball_radius_mm) ** 2))
    room = np.array([pad.width_mm, pad.length_mm]) / 2.0 - margin
    if deepest > _DEEPEST_IN_RADII * ball_radius_mm or room.min() <= 0.0:
        raise SimulateError(
            f"a ball of {ball_radius_mm:g} mm radius does not fit a pad of {pad.length_mm:g} x {pad.width_mm:g} x "
            f"{pad.thickness_mm:g} mm; its radius must be above {deepest / _DEEPEST_IN_RADII:.3g} mm, and its largest "
            f"contact (half-width {margin:.3g} mm) must leave room on the pad"
        )
    designs = []
    for k in range(count):
        across, along = room * (2.0 * ((0.5 + (k + 1) * np.array([_PLASTIC**-1, _PLASTIC**-2])) % 1.0) - 1.0)
        ball = Indenter(
            shape="ball",
            radius_mm=ball_radius_mm,
            depth_mm=DEPTHS_REL[k % len(DEPTHS_REL)] * pad.thickness_mm,
            position_mm=float(pad.length_mm / 2.0 + along),
            across_mm=float(across),
        )
        designs.append(pad_design.model_copy(update={"indenter": ball}))
    return designs


def render_ball_presses(
    sensor: PlainSensor,
    renderer: ModuleType,
    ball_radius_mm: float,
    count: int,
    seed: int = 0,
    samples_per_pixel: int = 64,
    progress: Progress | None = None,
    folder: Path = Path(),
) -> BallPresses:
    """Render ball presses on a plain sensor, all with the same random numbers.

    The balls leave the dent and bulge of the analytic press, whose slopes are exact, not those of an elastic layer: a
    table of colour against slope serves both. The camera looks straight at the pad: its picture is that of the pad's
    plane up to 0.2 % of a distance.

    Parameters
    ----------
    sensor
        The sensor; its own indenter does not matter.
    renderer
        From :func:`sim.optics.open_renderer`.
    ball_radius_mm, count
        As in :func:`planned_presses`, with its refusals.
    seed, samples_per_pixel
        Random seed, paths per pixel.
    progress
        Called after each picture.
    folder
        Where the files that the design names are.

    Raises
    ------
    SimulateError
        See above, and as :func:`sim.optics.plain_sensor_scene` does; or when the camera does not look straight at the
        pad through an ideal pinhole.
    """
    _require_straight_camera(sensor)
    designs = planned_presses(sensor.pressed_pad(), ball_radius_mm, count)
    images = []
    for step, design in enumerate([None, *designs]):
        pressed = design is not None
        now = sensor.model_copy(update={"indenter": design.indenter}) if design is not None else sensor
        scene = plain_sensor_scene(now, renderer, pressed, folder=folder)
        integrator = plain_sensor_integrator(scene, now, renderer, pressed, folder=folder)
        image = renderer.render(scene, integrator=integrator, spp=samples_per_pixel, seed=stream_seed(seed, 0))
        images.append(np.array(image, dtype=np.float32))
        if progress is not None:
            progress(step + 1, count + 1, f"press {step}" if pressed else "no contact")
    maps = [_seen(sensor, design) for design in designs]
    scale = mm_per_px(sensor)
    camera = sensor.camera
    z_middle = sensor.pad.length_mm / 2.0
    indenters = [design.indenter for design in designs]
    return BallPresses(
        no_contact=images[0],
        contacts=np.stack(images[1:]),
        slopes=np.stack([slopes for slopes, _ in maps]),
        distance=np.stack([distance for _, distance in maps]),
        row_px=np.array([camera.height_px / 2.0 - 0.5 - (i.position_mm - z_middle) / scale for i in indenters]),
        column_px=np.array([camera.width_px / 2.0 - 0.5 + i.across_mm / scale for i in indenters]),
        radius_px=np.array([float(contact_half_width_mm(design)) / scale for design in designs]),
        ball_radius_mm=ball_radius_mm,
        thickness_mm=sensor.pad.thickness_mm,
        mm_per_px=scale,
        label=f"{sensor.name}, rendered with {samples_per_pixel} paths per pixel ({renderer.variant()})",
    )


def _require_straight_camera(sensor: PlainSensor) -> None:
    """Check that a picture is that of the pad's plane."""
    camera = sensor.camera
    turned = [name for name in ("across_mm", "along_mm", "tilt_deg", "pan_deg", "roll_deg") if getattr(camera, name)]
    if camera.calibration is not None:
        turned.append("calibration")
    if turned:
        raise SimulateError(
            f"camera.{turned[0]} is not supported, because Taxim's pictures are those of a camera that looks straight "
            f"at the middle of the pad through an ideal pinhole; leave out {', '.join(turned)}"
        )


def mm_per_px(sensor: PlainSensor) -> float:
    """Return the side of a pixel on the coat in the middle of the picture: the gel makes it look nearer."""
    camera = sensor.camera
    reach = camera.distance_mm + sensor.pad.thickness_mm / sensor.pad.refractive_index
    return float(2.0 * np.tan(np.radians(camera.field_of_view_deg) / 2.0) / camera.width_px * reach)


def surface_of(design: FingerDesign) -> RectBivariateSpline:
    """Return the height of the pressed coat as a smooth function of x and z, mm."""
    x, z = pad_grid_mm(design.pad, _STEP_MM)
    return RectBivariateSpline(x, z, pressed_height_mm(design, x, z))


def _seen(sensor: PlainSensor, design: FingerDesign) -> tuple[Floats, Floats]:
    """Return slopes (H, W, 2) and contact distance (H, W) of the points of the coat that the pixels see."""
    camera, pad = sensor.camera, sensor.pad
    half = np.tan(np.radians(camera.field_of_view_deg) / 2.0) * 2.0 / camera.width_px
    columns = (np.arange(camera.width_px) + 0.5 - camera.width_px / 2.0) * half
    rows = (np.arange(camera.height_px) + 0.5 - camera.height_px / 2.0) * half
    air = np.stack(np.meshgrid(columns, -rows, indexing="xy"), axis=-1)
    # Snell at the flat inner face; tangents of the angle from the pad's normal
    sine = np.linalg.norm(air, axis=-1) / np.sqrt(1.0 + (air**2).sum(axis=-1)) / pad.refractive_index
    shrunk = sine / np.sqrt(1.0 - sine**2) / np.maximum(np.linalg.norm(air, axis=-1), np.finfo(float).tiny)
    gel, entry = air * shrunk[..., None], air * camera.distance_mm
    surface = surface_of(design)
    height = np.full(air.shape[:2], pad.thickness_mm)
    for _ in range(_ROUNDS):
        x, z = np.moveaxis(entry + gel * height[..., None], -1, 0)
        z = z + pad.length_mm / 2.0
        height = surface.ev(x, z)
    on_pad = (np.abs(x) <= pad.width_mm / 2.0) & (z >= 0.0) & (z <= pad.length_mm)
    # the depth is what the height lacks; rows run against z
    slopes = np.stack([-surface.ev(x, z, dx=1), surface.ev(x, z, dy=1)], axis=-1)
    return np.where(on_pad[..., None], slopes, np.nan), np.where(on_pad, contact_distance(design, x, z), np.nan)


# a pad that fewer pixels see is not a picture
_FEWEST_PIXELS = 100


def render_finger_presses(
    finger: PaintedFinger,
    ball_radius_mm: float,
    count: int,
    seed: int = 0,
    samples_per_pixel: int = 64,
    progress: Progress | None = None,
) -> BallPresses:
    """Render ball presses on a finger; pictures are rectified by what each pixel sees of the pad at rest.

    Columns run along the pad from its base, rows across it from the red wall to the green one; a pixel's side is the
    square root of the area of pad that a pixel of the camera sees in the mean. Parts of the pad that the camera does
    not see are black, and teach nothing. Colours are balanced so that the pad is grey without contact in the mean.

    Parameters
    ----------
    finger
        Design, paints, camera and renderer; the design's own indenter does not matter.
    ball_radius_mm, count
        As in :func:`sim.experiments._sensor_press.planned_presses`, with its refusals.
    seed, samples_per_pixel
        Random seed, the same for all presses; paths per pixel.
    progress
        Called after each press.

    Raises
    ------
    SimulateError
        See above, as :func:`sim.optics.render_press` does, or when the camera hardly sees the pad.
    """
    pictures, no_contact, maps = [], np.empty(0), []
    designs = planned_presses(finger.design, ball_radius_mm, count)
    how = RenderSettings("b", seed, samples_per_pixel)
    plane: _PadPlane | None = None
    for step, design in enumerate(designs, start=1):
        render = render_press(design, finger.paints, finger.renderer, how, calibration=finger.calibration)
        matrix = replace(finger, design=design).camera_matrix(render.bands)
        if plane is None:
            plane = _PadPlane(design, render.no_contact_maps)
            no_contact = plane.rectified(camera_rgb(render.no_contact_bands, matrix))
        pictures.append(plane.rectified(camera_rgb(render.contact_bands, matrix)))
        maps.append(plane.seen(design, render.contact_maps))
        if progress is not None:
            progress(step, count, f"press {step}")
    if plane is None:
        raise SimulateError(f"count must be at least 1 press, got {count}")
    scale, pad = plane.mm_per_px, finger.design.pad
    # 8 bits would leave nothing of red and green beside blue
    levels = no_contact[plane.is_seen].mean(axis=0)
    gains = levels.max() / levels
    indenters = [design.indenter for design in designs]
    return BallPresses(
        no_contact=(gains * no_contact).astype(np.float32),
        contacts=(gains * np.stack(pictures)).astype(np.float32),
        slopes=np.stack([slopes for slopes, _ in maps]),
        distance=np.stack([distance for _, distance in maps]),
        row_px=np.array([(i.across_mm + pad.width_mm / 2.0) / scale - 0.5 for i in indenters]),
        column_px=np.array([i.position_mm / scale - 0.5 for i in indenters]),
        radius_px=np.array([float(contact_half_width_mm(design)) / scale for design in designs]),
        ball_radius_mm=ball_radius_mm,
        thickness_mm=pad.thickness_mm,
        mm_per_px=scale,
        label=f"{finger.design.name}, rendered with {samples_per_pixel} paths per pixel, in the plane of its pad, "
        f"colours times {', '.join(f'{gain:.3g}' for gain in gains)} (grey without contact)",
    )


class _PadPlane:
    """The pad at rest as a grid of square pixels, and where in the camera's picture each of them is seen."""

    def __init__(self, design: FingerDesign, at_rest: PixelMaps) -> None:
        place = at_rest.coat_mm(design)
        seen = np.isfinite(place).all(axis=-1)
        if seen.sum() < _FEWEST_PIXELS:
            raise SimulateError(
                f"camera: only {int(seen.sum())} pixels see the pad, but at least {_FEWEST_PIXELS} are needed; give "
                "the camera more pixels or turn it towards the pad"
            )
        pad = design.pad
        self.mm_per_px = side = float(np.sqrt(pad.length_mm * pad.width_mm / seen.sum()))
        rows, columns = np.indices((round(pad.width_mm / side), round(pad.length_mm / side)))
        wanted = np.stack([(columns + 0.5) * side, (rows + 0.5) * side - pad.width_mm / 2.0], axis=-1)
        pixel = LinearNDInterpolator(place[seen], np.argwhere(seen).astype(np.float64))(wanted)
        self.is_seen = np.isfinite(pixel[..., 0])
        self._at = np.nan_to_num(np.moveaxis(pixel, -1, 0))

    def rectified(self, image: NDArray[np.float32]) -> Floats:
        """Return an image (H, W, 3) of the camera in the pad's plane; black where the camera does not see the pad."""
        channels = np.moveaxis(image.astype(np.float64), -1, 0)
        sampled = [map_coordinates(channel, self._at, order=1, mode="nearest") for channel in channels]
        return np.where(self.is_seen[..., None], np.stack(sampled, axis=-1), 0.0)

    def seen(self, design: FingerDesign, maps: PixelMaps) -> tuple[Floats, Floats]:
        """Return slopes (H, W, 2) and contact distance (H, W) of the points of the coat that the pixels see."""
        at = np.rint(self._at).astype(np.int64)
        z, x = np.moveaxis(maps.coat_mm(design)[at[0], at[1]], -1, 0)
        surface = surface_of(design)
        known = np.isfinite(x) & self.is_seen
        x, z = np.where(known, x, 0.0), np.where(known, z, 0.0)
        slopes = np.stack([-surface.ev(x, z, dy=1), -surface.ev(x, z, dx=1)], axis=-1)
        return np.where(known[..., None], slopes, np.nan), np.where(known, contact_distance(design, x, z), np.nan)
