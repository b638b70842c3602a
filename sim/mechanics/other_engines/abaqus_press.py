"""A finger that Abaqus has pressed: its results file on the mesh of the deck."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import ImportFormatError
from data_schemas.mechanical_design import Preset
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.finger_mesh import finger_mesh
from sim.mechanics.indenters import rigid_indenter
from sim.mechanics.other_engines.calculix_results import NodalField
from sim.mechanics.other_engines.deck_push import finger_push
from sim.mechanics.pressed_finger import PressedFinger
from sim.mechanics.signed_distances import Body

FloatArray = NDArray[np.float64]

_SAME_TIME = 1e-6


def pressed_by_abaqus(
    design: FingerDesign, fields: Sequence[NodalField], preset: Preset | None = None
) -> PressedFinger:
    """Return the press of a deck of :func:`~sim.mechanics.other_engines.deck_push.finger_deck` from Abaqus' results.

    The push is that of the indenter's reference node. Pressures are those of the deck's linear penalty at the depth by
    which faces of the coat lie inside the exact indenter; the file holds no energies and no iterations (NaN and 0).

    Parameters
    ----------
    design, preset
        As they went into the deck.
    fields
        Of :func:`sim.mechanics.other_engines.abaqus_results.read_fil`.

    Raises
    ------
    ImportFormatError
        When nodes or the indenter's reference node are missing: the file is of another mesh, or of other requests.
    """
    preset = preset or design.mesh.preset
    mesh = finger_mesh(design, preset)
    push = finger_push(design, preset, 1)
    count = len(mesh.nodes_mm)
    reference = count + len(push.indenter.nodes_mm) + 1
    times = sorted({f.step_fraction for f in fields if f.step_fraction > 0.0})
    moved = np.stack([_of_nodes(fields, "U", t, np.arange(1, count + 1), preset) for t in times])
    depth_mm = -np.array([_of_nodes(fields, "U", t, np.array([reference]), preset)[0, 1] for t in times])
    reaction = np.array([_of_nodes(fields, "RF", t, np.array([reference]), preset)[0] for t in times])
    indenter = rigid_indenter(design)
    body = cast(Body, indenter.body)  # a push has been made of it
    pose = indenter.pose(float(depth_mm[-1]))
    coat = PenaltyContact(mesh.nodes_mm, mesh.surfaces["coat"], body, pose, push.stiffness_mpa_per_mm)
    return PressedFinger(
        mesh=mesh,
        depth_mm=depth_mm,
        force_n=-reaction,
        energy_n_mm=np.full(len(times), np.nan),
        displacement_mm=moved,
        iterations=np.zeros(len(times), dtype=np.int64),
        modes_mm=(),
        pressure_mpa=coat.pressures_mpa(moved[-1]),
        touch_mm=coat.points_mm(np.zeros_like(moved[-1])),
        unreached="" if times[-1] > 1.0 - _SAME_TIME else f"the results end at {times[-1]:.4g} of the step",
        contact="faceted rigid indenter; contact surface to surface by penalty; ribs do not see each other",
    )


def _of_nodes(
    fields: Sequence[NodalField], name: str, time: float, wanted: NDArray[np.int64], preset: Preset
) -> FloatArray:
    """Return the values (k, 3) of some nodes at a time."""
    for field in fields:
        if field.name != name or field.step_fraction != time:
            continue
        order = np.argsort(field.nodes)
        at = np.searchsorted(field.nodes, wanted, sorter=order)
        found = order[np.minimum(at, len(order) - 1)]
        if (field.nodes[found] == wanted).all():
            return field.values[found]
    raise ImportFormatError(
        f"the results hold no {name} of the nodes {wanted[0]} to {wanted[-1]} at step time {time:g}; they must be of "
        f"a deck of this design on the {preset} mesh, with its output requests: finray export deck "
        "DESIGN --dialect abaqus"
    )
