"""An hour of presses for any tactile sensor: balls, and twelve solids to print, each at a stated place, depth and turn.

Balls teach a map from colour to slope and test it with other balls; the solids hold what a ball does not: flat faces,
straight and round edges, corners, a ridge, a hole, a texture. Each is a flat round back of 20 mm diameter that carries
one shape, as an STL file in mm that slicers print and that a design takes as its indenter: the shape looks along -y,
and its first touch is in the plane y = 0.
"""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, PlainSensor, RecordError
from sim.surface_meshes import stl_bytes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BACK_RADIUS_MM: Final = 10.0
BACK_MM: Final = (6.0, 14.0)
"""The back reaches from the first to the second height above the first touch."""
LARGEST_MM: Final = 12.0
LEAST_MM: Final = 4.0
"""Largest extent of a solid's shape; below the second its details are smaller than what is printed."""
FLAT_MM: Final = 0.3
"""Printed edges are no sharper: ridges and points end in flats of this width, and the rims of flat faces are cut so."""
DEPTHS_REL: Final = (0.1, 0.2)
DEEPEST_MM: Final = 1.0
"""Depths are these shares of the gel's thickness, the larger one at most this."""
BALLS_MM: Final = (4.0, 6.0, 8.0)
"""Diameters of usual bearing balls; the middle one teaches, the others test."""
SHARE_OF_PAD: Final = 0.6
PLACES_REL: Final = ((-0.7, -0.6), (0.7, -0.6), (0.0, -0.1), (-0.7, 0.6), (0.7, 0.6), (0.0, 0.7))
"""Where balls are pressed, along and across, in halves of the room that a press leaves."""
TURNS_DEG: Final = (0.0, 30.0)
"""Solids are turned by these about the pad's normal, in turn."""


@dataclass(frozen=True, slots=True)
class PrintedSolid:
    """A solid to print.

    Attributes
    ----------
    name
        Of its file.
    what
        Its shape and sizes in words.
    shows
        What it tests.
    vertices_mm, triangles
        Closed surface (n, 3), (m, 3), counter-clockwise seen from outside.
    """

    name: str
    what: str
    shows: str
    vertices_mm: Floats
    triangles: Integers

    @property
    def volume_mm3(self) -> float:
        """Volume within the surface, by the divergence theorem."""
        a, b, c = np.moveaxis(self.vertices_mm[self.triangles], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    @property
    def stl(self) -> bytes:
        """Return the STL file, mm."""
        return stl_bytes(self.triangles, self.vertices_mm, f"{self.name}: {self.what}"[:80])


@dataclass(frozen=True, slots=True)
class ProtocolPress:
    """One press: its folder's name, what is pressed, where, how deep, turned by how much, and what it is for."""

    name: str
    indenter: str
    diameter_mm: float | None
    position_mm: float
    across_mm: float
    depth_mm: float
    turn_deg: float
    purpose: str


@dataclass(frozen=True, slots=True)
class PressProtocol:
    """The solids that suit a pad, and the presses in their order."""

    sensor: str
    pad_mm: tuple[float, float, float]
    extent_mm: float
    solids: tuple[PrintedSolid, ...]
    presses: tuple[ProtocolPress, ...]

    def table_csv(self) -> str:
        """Return the presses as CSV, a line for each folder of pictures: each press, and the same press once more."""
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(
            ["press", "indenter", "diameter_mm", "position_mm", "across_mm", "depth_mm", "turn_deg", "repeat_of"]
        )
        for press in self.presses:
            diameter = "" if press.diameter_mm is None else f"{press.diameter_mm:g}"
            sizes = [f"{v:g}" for v in (press.position_mm, press.across_mm, press.depth_mm, press.turn_deg)]
            for name, repeat_of in ((press.name, ""), (f"{press.name}-again", press.name)):
                table.writerow([name, press.indenter, diameter, *sizes, repeat_of])
        return text.getvalue()


def press_protocol(sensor: FingerDesign | PlainSensor) -> PressProtocol:
    """Return the presses and solids that suit a sensor's pad.

    Six presses of the ball of 6 mm at six places and two depths, for a map to be taught; one each of a smaller and a
    larger ball, which it has not seen; and one of each solid, in the middle of the pad.

    Parameters
    ----------
    sensor
        A finger or a classic sensor; its pad's length, width and thickness count.

    Raises
    ------
    RecordError
        The pad is too small for solids whose details can be printed.
    """
    pad = sensor.pad
    size = min(pad.length_mm, pad.width_mm)
    extent = min(LARGEST_MM, float(np.floor(2.0 * SHARE_OF_PAD * size) / 2.0))
    if extent < LEAST_MM:
        raise RecordError(
            f"pad: {pad.length_mm:g} x {pad.width_mm:g} mm is too small, because it leaves room only for solids of "
            f"{extent:g} mm, whose details cannot be printed; the pad must be at least {LEAST_MM / SHARE_OF_PAD:.2g} "
            "mm long and wide"
        )
    shallow, deep = (
        round(min(share * pad.thickness_mm, share / DEPTHS_REL[1] * DEEPEST_MM), 2) for share in DEPTHS_REL
    )
    solids = protocol_solids(extent)
    small, taught, large = BALLS_MM
    balls = [(taught, *place) for place in PLACES_REL] + [(small, 0.35, 0.1), (large, -0.35, 0.1)]
    presses = [
        ProtocolPress(
            f"ball-{k + 1:02d}",
            f"ball of {diameter:g} mm",
            diameter,
            round(pad.length_mm / 2.0 + along * (pad.length_mm - diameter) / 2.0, 1),
            round(across * (pad.width_mm - diameter) / 2.0, 1),
            min((shallow, deep)[k % 2], diameter / 4.0),
            0.0,
            "teach" if diameter == taught else "test",
        )
        for k, (diameter, along, across) in enumerate(balls)
    ]
    presses += [
        ProtocolPress(
            f"solid-{k + 1:02d}-{solid.name}",
            solid.name,
            None,
            round(pad.length_mm / 2.0, 1),
            0.0,
            deep,
            TURNS_DEG[k % len(TURNS_DEG)],
            "test",
        )
        for k, solid in enumerate(solids)
    ]
    return PressProtocol(sensor.name, (pad.length_mm, pad.width_mm, pad.thickness_mm), extent, solids, tuple(presses))


def protocol_solids(extent_mm: float = LARGEST_MM) -> tuple[PrintedSolid, ...]:
    """Return the twelve solids.

    Parameters
    ----------
    extent_mm
        Largest extent E of their shapes across the pad, mm.
    """
    e, cut = extent_mm, FLAT_MM
    third, half = e / 3.0, e / 2.0
    ridge = half / 2.0
    rod, dot, pitch = e / 4.0, 0.12 * e, 0.3 * e
    return (
        _solid("disc", f"flat disc, diameter {2 * third:.3g} mm", "a flat face and a round edge",
               _flat(_circle(third), third)),
        _solid("square", f"flat square, side {2 * third:.3g} mm", "straight edges and right angles",
               _flat(_rectangle(third, third), third)),
        _solid("triangle", f"flat triangle, side {e * 0.75:.3g} mm", "sharp corners",
               _flat(_polygon(3, e * 0.75 / np.sqrt(3.0)), e * 0.75 / np.sqrt(12.0))),
        _solid("hexagon", f"flat hexagon, {2 * third:.3g} mm across its corners", "obtuse corners",
               _flat(_polygon(6, third), third * np.sqrt(0.75))),
        _solid("cross", f"flat cross, {e:.3g} mm long, arms {e / 4.0:.3g} mm wide", "inner corners, narrow arms",
               _flat(_cross(half, e / 8.0), e / 8.0)),
        _solid("ring", f"flat ring, {2 * third:.3g} mm outside, {third:.3g} mm inside, {BORE_MM:g} mm deep",
               "a hole: gel that is touched all around and not inside", _ring(third, third / 2.0)),
        _solid("cone", f"cone of 90 deg with a tip {cut:g} mm wide", "one slope in all directions",
               _frustum(_circle(third), third, third - cut / 2.0)),
        _solid("pyramid", f"square pyramid of 90 deg with a tip {cut:g} mm wide", "one slope in four directions",
               _frustum(_rectangle(third, third), third, third - cut / 2.0)),
        _solid("ridge", f"ridge of 90 deg, {e:.3g} mm long, {cut:g} mm wide at its top", "a line",
               [(_rectangle(half, cut / 2.0 + rise), rise) for rise in (ridge, 0.0)]),
        _solid("rod", f"lying cylinder, radius {rod:.3g} mm, {e:.3g} mm long", "curved in one direction",
               _lying(half, rod)),
        _solid("dots", f"nine round dots, radius {dot:.3g} mm, {pitch:.3g} mm apart",
               "resolution: contacts close to each other", _relief(half, _dots(pitch, dot), 60)),
        _solid("waves", f"waves, {e / 4.0:.3g} mm long, {e / 20.0:.3g} mm from crest to trough", "a texture",
               _relief(half, _waves(e / 4.0, e / 40.0), 60)),
    )  # fmt: skip


BORE_MM: Final = 2.0
_AROUND: Final = 240
"""Corners of each outline: a circle of 4 mm radius lies within 0.4 um of them."""
Ring = tuple[Floats, Floats | float]


def _solid(name: str, what: str, shows: str, rings: Sequence[Ring]) -> PrintedSolid:
    """Close rings of corners, from the shape's foot to its top, with the back."""
    foot = rings[0][0]
    back = BACK_RADIUS_MM * foot / np.linalg.norm(foot, axis=1, keepdims=True)
    stacked = [(back, BACK_MM[1]), (back, BACK_MM[0]), (foot, BACK_MM[0]), *rings]
    corners = np.stack([np.column_stack([xz[:, 0], np.broadcast_to(y, len(xz)), xz[:, 1]]) for xz, y in stacked])
    count, around = corners.shape[:2]
    ends = corners[[0, -1]].mean(axis=1)
    vertices = np.vstack([corners.reshape(-1, 3), ends])
    here = np.arange(around)
    following = np.roll(here, -1)
    sides = []
    for k in range(count - 1):
        a, b, c, d = k * around + here, k * around + following, (k + 1) * around + following, (k + 1) * around + here
        sides += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    first, last = len(vertices) - 2, len(vertices) - 1
    top = (count - 1) * around
    caps = [
        np.column_stack([following, here, np.full(around, first)]),
        np.column_stack([top + here, top + following, np.full(around, last)]),
    ]
    solid = PrintedSolid(name, what, shows, vertices, np.concatenate([*sides, *caps]).astype(np.int64))
    if solid.volume_mm3 < 0.0:
        return PrintedSolid(name, what, shows, vertices, solid.triangles[:, ::-1])
    return solid


def _circle(radius_mm: float) -> Floats:
    """Return the corners of a circle."""
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def _along(corners: Floats) -> Floats:
    """Return points along a closed polygon, its corners among them."""
    each = _AROUND // len(corners)
    share = (np.arange(each) / each)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


def _polygon(corners: int, radius_mm: float) -> Floats:
    """Return the outline of a regular polygon by the radius of its corners."""
    angle = np.pi / 2.0 + 2.0 * np.pi * np.arange(corners) / corners
    return _along(radius_mm * np.column_stack([np.cos(angle), np.sin(angle)]))


def _rectangle(half_x_mm: float, half_z_mm: float) -> Floats:
    """Return the outline of a rectangle."""
    return _along(np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * [half_x_mm, half_z_mm])


def _cross(long_mm: float, narrow_mm: float) -> Floats:
    """Return the outline of a cross by half the length and half the width of its arms."""
    arm = np.array([[long_mm, -narrow_mm], [long_mm, narrow_mm], [narrow_mm, narrow_mm]])
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
    return _along(np.concatenate([arm @ np.linalg.matrix_power(quarter, k) for k in range(4)]))


def _flat(outline: Floats, inner_mm: float) -> list[Ring]:
    """Return a flat face whose rim is cut at 45 deg where the outline comes nearest to its middle."""
    return [(outline, FLAT_MM), (outline * (1.0 - FLAT_MM / inner_mm), 0.0)]


def _ring(outer_mm: float, inner_mm: float) -> list[Ring]:
    """Return a flat ring around a hole."""
    radii = ((outer_mm, FLAT_MM), (outer_mm - FLAT_MM, 0.0), (inner_mm + FLAT_MM, 0.0), (inner_mm, FLAT_MM))
    return [*((_circle(radius), y) for radius, y in radii), (_circle(inner_mm), BORE_MM)]


def _frustum(outline: Floats, half_mm: float, rise_mm: float) -> list[Ring]:
    """Return a shape that narrows by 45 deg to a small flat."""
    return [(outline, rise_mm), (outline * (FLAT_MM / 2.0 / half_mm), 0.0)]


def _lying(half_length_mm: float, radius_mm: float) -> list[Ring]:
    """Return a lying cylinder, up to where its sides stand at 60 deg."""
    top = np.arcsin(FLAT_MM / 2.0 / radius_mm)
    angles = np.linspace(np.pi / 3.0, top, 60)
    heights = radius_mm * (np.cos(top) - np.cos(angles))
    return [(_rectangle(half_length_mm, radius_mm * np.sin(a)), y) for a, y in zip(angles, heights, strict=True)]


def _relief(half_mm: float, height_mm: Callable[[Floats, Floats], Floats], steps: int) -> list[Ring]:
    """Return a square face of a height that varies, as square rings around its middle."""
    outline = _rectangle(half_mm, half_mm)
    rings = [outline * share for share in np.linspace(1.0, 1.0 / steps, steps)]
    return [(ring, height_mm(ring[:, 0], ring[:, 1])) for ring in rings]


def _dots(pitch_mm: float, radius_mm: float) -> Callable[[Floats, Floats], Floats]:
    """Return the height of nine caps that rise by 0.6 of their radius."""
    rise = 0.6 * radius_mm

    def height_mm(x: Floats, z: Floats) -> Floats:
        x, z = (v - pitch_mm * np.clip(np.round(v / pitch_mm), -1.0, 1.0) for v in (x, z))
        squared = radius_mm**2 - x**2 - z**2
        return np.asarray(np.minimum(radius_mm - np.sqrt(np.maximum(squared, 0.0)), rise))

    return height_mm


def _waves(length_mm: float, amplitude_mm: float) -> Callable[[Floats, Floats], Floats]:
    """Return the height of waves along the pad."""

    def height_mm(x: Floats, z: Floats) -> Floats:
        del x
        return np.asarray(amplitude_mm * (1.0 - np.cos(2.0 * np.pi * z / length_mm)))

    return height_mm
