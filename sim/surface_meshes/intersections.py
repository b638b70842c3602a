"""Find surfaces that pass through each other or through themselves."""

from collections.abc import Mapping
from itertools import combinations_with_replacement

import ipctk
import numpy as np

from data_schemas.errors import SimulateError
from sim.surface_meshes.surface import Surface, weld


def check_no_intersections(surfaces: Mapping[str, Surface], body: str = "gel") -> None:
    """Check that no triangle of a body passes through another one.

    Light inside a body that overlaps itself takes ways that no real body has, without any error in the renderer.

    Raises
    ------
    SimulateError
        When triangles cross; the message names the surfaces.
    """
    if not _cross(surfaces):
        return
    # welded edges belong to both surfaces of a pair, so that neighbours count as one
    for first, second in combinations_with_replacement(surfaces, 2):
        if _cross({name: surfaces[name] for name in (first, second)}):
            what = f"surface {first} passes through {'itself' if first == second else f'surface {second}'}"
            raise SimulateError(
                f"the {body} intersects itself: {what}; a deformation this large needs a finer mesh or a smaller press"
            )


def _cross(surfaces: Mapping[str, Surface]) -> bool:
    """Tell whether any edge of the surfaces passes through any of their triangles."""
    vertices, triangles, _ = weld(surfaces)
    vertices = np.asfortranarray(vertices)
    mesh = ipctk.CollisionMesh(vertices, ipctk.edges(triangles), triangles)
    return bool(ipctk.has_intersections(mesh, vertices))
