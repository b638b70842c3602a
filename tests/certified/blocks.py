"""Blocks of hexahedra on a grid, for the checks of the mechanics."""

import numpy as np

from sim.mechanics import Block, FingerMesh
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._increments import Load, load_increments
from sim.mechanics._linear_solver import linear_solver


def uniaxial_stress_mpa(material, stretch):
    """Return the nominal stress of an incompressible Ogden material under uniaxial load, in closed form.

    P = sum 2 mu_p/alpha_p (lambda^(alpha_p - 1) - lambda^(-alpha_p/2 - 1)).
    """
    terms = zip(material.mu_mpa, material.alpha, strict=True)
    return sum(2.0 * m / a * (stretch ** (a - 1.0) - stretch ** (-a / 2.0 - 1.0)) for m, a in terms)


class GridBlock:
    """Hexahedra between three rising lists of coordinates, with the numbers of its nodes on the grid."""

    def __init__(self, x, y, z):
        shape = (len(x), len(y), len(z))
        self.nodes_mm = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3).astype(float)
        self.numbers = n = np.arange(len(self.nodes_mm)).reshape(shape)
        low, high = slice(None, -1), slice(1, None)
        base = [(low, low), (high, low), (high, high), (low, high)]
        corners = [n[a, b, c] for c in (low, high) for a, b in base]
        self.hexahedra = np.stack([c.ravel() for c in corners], -1)

    def top_quads(self):
        """Faces of the highest y, outward."""
        t = self.numbers[:, -1, :]
        return np.stack([t[:-1, :-1], t[:-1, 1:], t[1:, 1:], t[1:, :-1]], -1).reshape(-1, 4)

    def mesh(self, element, nodes_mm=None, ties=()):
        nodes = self.nodes_mm if nodes_mm is None else nodes_mm
        return FingerMesh(nodes, (Block("block", self.hexahedra, "material", element),), {}, {}, tuple(ties))


def unit_cells(*counts, size=(1.0, 1.0, 1.0)):
    return GridBlock(*(np.linspace(0.0, s, n + 1) for n, s in zip(counts, size, strict=True)))


def stretched(cells, length, growth):
    """Coordinates from 0 that grow like a hyperbolic sine: a family of meshes, each finer one finer everywhere."""
    return length * np.sinh(growth * np.linspace(0.0, 1.0, cells + 1)) / np.sinh(growth)


def assemble(mesh, material, terms=()):
    return Assembly(Elasticity(mesh, {"material": material}), terms)


def press(assembly, loading, stops=(1.0,), options=None, solver="auto"):
    """All equilibria of a load path."""
    return [
        i.equilibrium for i in load_increments(assembly, linear_solver(solver), Load(loading), stops, options=options)
    ]
