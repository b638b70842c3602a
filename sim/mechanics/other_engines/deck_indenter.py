"""The indenter of a deck: the part of its surface that can touch, as quadrilaterals."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.signed_distances import Body, Cylinder, Pose, RoundedBox, Sphere

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FACET_DEG: Final = 1.5
"""Turn from one facet to the next: chords leave a radius of 10 mm by 10 (1 - cos 0.75 deg) = 0.9 um."""

_REACH_DEG = 80.0  # from the underside, on all round sides
_BALL_REACH_DEG = 60.0  # a ball pushed in by half its radius; further round, a grid of two turns is squeezed
_BALL_FACET_DEG = 3.0  # facets of a ball count squared; at most 8.4 um inside a radius of 10 mm
_FLAT_MM = 10.0  # a flat stretch is divided too, lest facets be needles


@dataclass(frozen=True, slots=True)
class IndenterSurface:
    """Facets of an indenter towards the pad, outward.

    Attributes
    ----------
    nodes_mm
        Corners (n, 3) at first touch.
    quads
        Facets (m, 4).
    inward
        Unit vectors (n, 3) into the body.
    chord_error_mm
        How far the middles of the facets lie inside the true surface at most.
    """

    nodes_mm: FloatArray
    quads: IntArray
    inward: FloatArray
    chord_error_mm: float


def deepest_ball_mm(radius_mm: float) -> float:
    """Return how deep a ball can be pushed before the gel reaches the rim of its facets."""
    return radius_mm * (1.0 - math.cos(math.radians(_BALL_REACH_DEG)))


def indenter_surface(body: Body, pose: Pose, across_mm: float) -> IndenterSurface:
    """Return the facets of a cylinder, a ball or a rounded cuboid around the direction of the push.

    Each is a box with rounded edges: a ball has no flat part, a cylinder one along its axis only.

    Parameters
    ----------
    body, pose
        The indenter at first touch; it is pushed along -y of the finger.
    across_mm
        Length of an endless cylinder.

    Raises
    ------
    SimulateError
        When the body is of another kind.
    """
    edge_mm, flat_mm, drop_mm, arcs_deg, step_deg = _rounded(body, across_mm)
    turns, shifts = zip(
        *(_profile(f, arc, step_deg) for f, arc in zip(flat_mm, arcs_deg, strict=True)),
        strict=True,
    )
    outward = np.stack(
        np.broadcast_arrays(np.tan(turns[0])[:, None], np.array(-1.0), np.tan(turns[1])[None, :]), axis=-1
    )
    outward = outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    middle = np.stack(np.broadcast_arrays(shifts[0][:, None], np.array(-drop_mm), shifts[1][None, :]), axis=-1)
    # the body's own axes: the push is along -y of a body that is not turned
    points = (middle + edge_mm * outward).reshape(-1, 3) @ pose.rotation.T + np.array(pose.position_mm)
    number = np.arange(len(points)).reshape(outward.shape[:2])
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    inside, _, _ = pose.distances(body, points[quads].mean(axis=1))
    return IndenterSurface(points, quads, -outward.reshape(-1, 3) @ pose.rotation.T, -float(inside.min()))


def _rounded(body: Body, across_mm: float) -> tuple[float, tuple[float, float], float, tuple[float, float], float]:
    """Return edge radius, flat half sizes along x and z, depth of the flat, arcs along x and z, and facets in deg."""
    if isinstance(body, Sphere):
        return body.radius_mm, (0.0, 0.0), 0.0, (_BALL_REACH_DEG, _BALL_REACH_DEG), _BALL_FACET_DEG
    if isinstance(body, Cylinder) and not np.isfinite(body.half_length_mm):
        return body.radius_mm, (across_mm / 2.0, 0.0), 0.0, (0.0, _REACH_DEG), FACET_DEG
    if isinstance(body, RoundedBox):
        x, y, z = (half - body.edge_radius_mm for half in body.half_sizes_mm)
        return body.edge_radius_mm, (x, z), y, (_REACH_DEG, _REACH_DEG), 2.0 * _BALL_FACET_DEG
    raise SimulateError(
        f"a deck holds an indenter of shape cylinder, ball or cuboid, not {type(body).__name__}; give one of these, or "
        "press it in with the engine in process"
    )


def _profile(flat_mm: float, arc_deg: float, step_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return turn in rad and shift in mm of the points along one direction: arc, flat part, arc."""
    arc = np.radians(np.linspace(0.0, arc_deg, round(arc_deg / step_deg) + 1))
    pieces = int(np.ceil(2.0 * flat_mm / _FLAT_MM))
    flat = np.linspace(-flat_mm, flat_mm, pieces + 1) if pieces else np.zeros(1)
    turn = np.concatenate([-arc[:0:-1], np.zeros(len(flat)), arc[1:]])
    shift = np.concatenate([np.full(len(arc) - 1, -flat_mm), flat, np.full(len(arc) - 1, flat_mm)])
    return turn, shift
