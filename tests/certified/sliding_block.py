"""A block that a wide plate is pressed into and dragged over, with the barrier and its friction."""

from typing import NamedTuple

import numpy as np

from sim.mechanics._assembly import Assembly, State
from sim.mechanics._increments import Load, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from sim.surface_meshes import boundary_quads, split_quads
from tests.certified.barrier_contact import Barrier, BarrierContact, DrivenContact, Obstacle
from tests.certified.blocks import assemble, unit_cells

GEL = neo_hooke(0.1333, 20.0)
REACH_MM = 0.02


class Dragged(NamedTuple):
    """An increment of the way; the contact is still at it."""

    share: float
    state: State
    contact: BarrierContact
    assembly: Assembly


def plate(height_mm, reference):
    """A rigid triangle far wider than the block, its face down."""
    corners = np.array([[-40.0, height_mm, -40.0], [80.0, height_mm, -40.0], [0.0, height_mm, 80.0]])
    return Obstacle(corners, np.array([[0, 1, 2]]), reference)


def block_under_a_plate(ratio, project=True):
    block = unit_cells(3, 2, 3, size=(6.0, 3.0, 6.0))
    reference = len(block.nodes_mm)
    nodes = np.vstack([block.nodes_mm, [0.0, 3.0, 0.0]])
    surface = split_quads(boundary_quads(block.hexahedra).quads, block.nodes_mm)
    barrier = Barrier(REACH_MM, 0.27, ratio)
    contact = BarrierContact(nodes, surface, plate(3.0 + REACH_MM, reference), barrier, project=project)
    return block, nodes, contact


def drag(ratio, stops, met_mm=1e-4):
    """Press a plate into a block by 0.1 mm times the share up to 1, then drag it along x by the rest in mm."""
    block, nodes, contact = block_under_a_plate(ratio)
    held = Supports.at_rest(len(nodes), block.numbers[:, 0].ravel())
    driven = DrivenContact(contact, held, len(nodes) - 1, met_mm)
    assembly = assemble(block.mesh("mean_dilatation", nodes), GEL, driven.terms)

    def loading(share):
        fixed = driven.push(0.1 * min(share, 1.0)).fixed
        move = np.zeros_like(nodes)
        move[-1, 0] = max(share - 1.0, 0.0)
        return Supports(fixed, move)

    for step in load_increments(assembly, linear_solver(), Load(loading, driven.settle, accept=driven.accept), stops):
        yield Dragged(step.fraction, step.equilibrium.state, contact, assembly)
