"""The elastic energy of a mesh: its gradient and tangent, with the incompatible modes eliminated in each element."""

import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.element_kernels import OGDEN, many_hexahedra
from sim.mechanics.materials import Material
from sim.mechanics.mesh import Block, FingerMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Modes = tuple[FloatArray, ...]
"""Incompatible modes of each block in mm: (m, 3, 3), or (m, 0, 3) for elements that have none."""

_TOGETHER = 256  # elements of one call: their tangents (1.2 MB) stay in the cache


@dataclass(frozen=True, slots=True)
class ElementMatrices:
    """Forces (m, 24) in N and tangents (m, 24, 24) in N/mm of some elements of one block."""

    block: int
    elements: slice
    force: FloatArray
    tangent: FloatArray


class Elasticity:
    """Elastic energy of the blocks of a mesh with their materials.

    Elements: mean dilatation (Q1P0) for nearly incompressible gel, at least two through a thickness that bends;
    incompatible modes (nine, eliminated in the element) for ribs and films. The displacement u (n, 3) and the modes
    are unknowns side by side; Newton's step of both is that of the system in u alone from :meth:`matrices`, and
    :meth:`mode_step` for the modes.

    Parameters
    ----------
    mesh
        Mesh at rest.
    materials
        Material of each name that the blocks use.
    threads
        Threads that evaluate elements; results do not depend on it.

    Raises
    ------
    SimulateError
        When a block's material is not given, or cannot be used with its element.
    """

    def __init__(self, mesh: FingerMesh, materials: Mapping[str, Material], threads: int = 1) -> None:
        self.mesh = mesh
        self.count = len(mesh.nodes_mm)
        self.cells: tuple[IntArray, ...] = tuple(np.ascontiguousarray(b.hexahedra, np.int64) for b in mesh.blocks)
        self._nodes = np.ascontiguousarray(mesh.nodes_mm, np.float64)
        self._materials = [_material_of(block, materials) for block in mesh.blocks]
        self._threads = threads
        mode_counts = [3 if b.element == "incompatible_modes" else 0 for b in mesh.blocks]
        self._solved = [np.zeros((len(c) if m else 0, 9, 25)) for c, m in zip(self.cells, mode_counts, strict=True)]
        self._mode_force = [np.zeros((len(s), 9)) for s in self._solved]
        self._energies = [np.zeros(len(c)) for c in self.cells]
        # displacements and modes that the energies belong to
        self._evaluated: tuple[FloatArray, ...] = ()
        self.no_modes: Modes = tuple(np.zeros((len(c), m, 3)) for c, m in zip(self.cells, mode_counts, strict=True))

    def energy(self, u: FloatArray, modes: Modes) -> float:
        """Return the elastic energy in N mm; infinity where an element is inside out."""
        if not self._is_evaluated(u, modes):
            for _ in self._evaluate(u, modes, 0):
                pass
        return math.fsum(float(e.sum()) for e in self._energies)

    def _is_evaluated(self, u: FloatArray, modes: Modes) -> bool:
        """Whether the energies of the last evaluation, of whatever level, are those of this state."""
        asked = (u, *modes)
        return len(asked) == len(self._evaluated) and all(map(np.array_equal, asked, self._evaluated))

    def matrices(self, u: FloatArray, modes: Modes, project: bool = False) -> Iterator[ElementMatrices]:
        """Yield forces and tangents by u with the modes eliminated, a part of the elements at a time.

        With `project` the tangent of each element has no negative curvature. The arrays are used again after the next
        step of the iteration. Where an element is inside out (see :meth:`energy`) its arrays mean nothing.
        """
        return self._evaluate(u, modes, 2 if project else 1)

    def energy_of_blocks(self) -> dict[str, float]:
        """Return the energy in N mm of each block at the last evaluation."""
        return {b.name: float(e.sum()) for b, e in zip(self.mesh.blocks, self._energies, strict=True)}

    def mode_step(self, du: FloatArray) -> Modes:
        """Return Newton's step of the modes that belongs to the step du (n, 3), from the last :meth:`matrices`."""
        steps = []
        for cells, solved, rest in zip(self.cells, self._solved, self.no_modes, strict=True):
            if not len(solved):
                steps.append(rest)
                continue
            local = du[cells].reshape(-1, 24)
            steps.append(-(np.einsum("eij,ej->ei", solved[:, :, :24], local) + solved[:, :, 24]).reshape(-1, 3, 3))
        return tuple(steps)

    def mode_work_n_mm(self) -> float:
        """Return sum f_a . K_aa^-1 f_a over the modes: by what the energy's slope lies below that of u alone."""
        pairs = zip(self._mode_force, self._solved, strict=True)
        return float(sum(np.einsum("ei,ei->", f, s[:, :, 24]) for f, s in pairs))

    def mode_residual_n(self) -> float:
        """Return the norm of the forces on the modes at the last :meth:`matrices`."""
        return math.sqrt(sum(float((f**2).sum()) for f in self._mode_force))

    def _evaluate(self, u: FloatArray, modes: Modes, level: int) -> Iterator[ElementMatrices]:
        jobs = [
            (block, slice(start, min(start + _TOGETHER, len(cells))))
            for block, cells in enumerate(self.cells)
            for start in range(0, len(cells), _TOGETHER)
        ]
        room = _TOGETHER if level else 0
        buffers = [(np.empty((room, 24)), np.empty((room, 24, 24))) for _ in range(self._threads)]
        displacement = np.ascontiguousarray(u, np.float64)

        def evaluate(number: int) -> ElementMatrices:
            block, part = jobs[number]
            force, tangent = buffers[number % self._threads]
            size = part.stop - part.start
            out = ElementMatrices(block, part, force[:size], tangent[:size])
            self._evaluate_part(displacement, modes[block], level, out)
            return out

        self._evaluated = ()
        if self._threads == 1:
            yield from map(evaluate, range(len(jobs)))
        else:
            with ThreadPoolExecutor(self._threads) as pool:
                for first in range(0, len(jobs), self._threads):
                    yield from pool.map(evaluate, range(first, min(first + self._threads, len(jobs))))
        self._evaluated = (displacement.copy(), *(m.copy() for m in modes))

    def _evaluate_part(self, u: FloatArray, modes: FloatArray, level: int, out: ElementMatrices) -> None:
        block, part, material = out.block, out.elements, self._materials[out.block]
        many_hexahedra(
            self._nodes,
            u,
            self.cells[block][part],
            modes[part],
            material.law,
            material.parameters,
            level,
            self._energies[block][part],
            out.force,
            out.tangent,
            self._solved[block][part],
            self._mode_force[block][part],
        )


def _material_of(block: Block, materials: Mapping[str, Material]) -> Material:
    """Return the material of a block."""
    if block.material not in materials:
        raise SimulateError(
            f"block {block.name} is of material {block.material}, which is not among {', '.join(sorted(materials))}"
        )
    material = materials[block.material]
    if block.element == "mean_dilatation" and material.law != OGDEN:
        raise SimulateError(
            f"block {block.name} asks for mean dilatation with the linear elastic material {block.material}; that "
            "element is for Ogden and neo-Hookean materials: use incompatible_modes"
        )
    return material
