"""Elements that must not lock: a bending rib, and Cook's membrane of a nearly incompressible material."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp

from sim.mechanics import Ogden
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from tests.certified.blocks import assemble, press, unit_cells

TPU = Ogden((6.279, 1.639), (1.6663, -7.136))


def bending_force_n(cells_each_way, element="incompatible_modes"):
    """Force on the end of a rib of 10 x 2 x 2 mm that is shifted by 3 mm across."""
    cells = unit_cells(*cells_each_way, size=(10.0, 2.0, 2.0))
    assembly = assemble(cells.mesh(element), TPU)
    end = cells.numbers[-1].ravel()
    fixed = Supports.at_rest(assembly.count, cells.numbers[0].ravel()).fixed
    fixed[end, 1] = True

    def loading(fraction):
        move = np.zeros((assembly.count, 3))
        move[end, 1] = 3.0 * fraction
        return Supports(fixed, move)

    return press(assembly, loading, (0.5, 1.0))[-1].gradient_n[end, 1].sum()


def test_a_rib_of_a_few_elements_bends_like_a_fine_one():
    fine = bending_force_n((48, 8, 6))
    assert bending_force_n((24, 6, 4)) == pytest.approx(fine, rel=0.04)
    # CalculiX 2.20 on 12 x 3 x 3 of its C3D8I, the same element at small strain
    coarse = bending_force_n((12, 3, 3))
    assert coarse == pytest.approx(0.4782, rel=1e-3)
    # even one element through the thickness; mean dilatation is half as stiff there and unfit
    assert bending_force_n((12, 1, 1)) == pytest.approx(fine, rel=0.04)


class DeadLoad:
    """Forces on nodes (n, 3) that keep their direction, times a factor."""

    def __init__(self, force_n):
        self.force_n, self.factor = force_n, 0.0

    def energy(self, u):
        return -self.factor * float((self.force_n * u).sum())

    def gradient(self, u):
        return -self.factor * self.force_n

    def hessian(self, u, project):
        return sp.coo_array((u.size, u.size))

    def max_step(self, u, du):
        return 1.0


def cook_mm(n):
    """Rise of the loaded corner of Cook's membrane: 48 x 44..60 mm, mu = 80.194 MPa, K = 5000 mu, 100 N per mm."""
    cells = unit_cells(n, n, 1)
    s, t = cells.nodes_mm[:, 0], cells.nodes_mm[:, 1]
    x = np.stack([48.0 * s, 44.0 * s + t * (44.0 - 28.0 * s), cells.nodes_mm[:, 2]], 1)
    edge = cells.numbers[-1]
    force = np.zeros_like(x)
    for low, high in pairwise(edge):
        force[np.concatenate([low, high]), 1] += 0.25 / n
    load = DeadLoad(100.0 * force)
    assembly = assemble(cells.mesh("mean_dilatation", x), neo_hooke(40.097, 5000.0), [load])
    fixed = Supports.at_rest(assembly.count, cells.numbers[0].ravel()).fixed
    fixed[:, 2] = True

    def loading(fraction):
        load.factor = fraction
        return Supports(fixed, np.zeros_like(x))

    return press(assembly, loading, (0.5, 1.0))[-1].state.u_mm[edge[-1, 0], 1]


def test_cooks_membrane_does_not_lock():
    coarse, fine = cook_mm(16), cook_mm(64)
    assert coarse == pytest.approx(fine, rel=0.02)
