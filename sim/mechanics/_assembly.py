"""What is in equilibrium: the elastic mesh and further energies, assembled into one gradient and one sparse matrix.

Incompatible modes are eliminated in each element.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics._element_kernels import OGDEN, ST_VENANT_KIRCHHOFF, compiled, many_hexahedra, many_stretches
from sim.mechanics._linear_solver import UpperBlocks
from sim.mechanics._materials import Material, PackagedMaterial
from sim.mechanics._mesh import Block, FingerMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


Modes = tuple[FloatArray, ...]
"""Incompatible modes of each block in mm: (m, 3, 3), or (m, 0, 3) for elements that have none."""

Pressures = tuple[FloatArray, ...]
"""Pressures p of each block in MPa, positive in tension: of its elements (m, 1), linear in them (m, 4), or none held
(m, 0)."""

_TOGETHER = 256  # elements of one call: their tangents (1.2 MB) stay in the cache


@dataclass(frozen=True, slots=True)
class ElementMatrices:
    """Forces (m, 24) in N and tangents (m, 24, 24) in N/mm of some elements of one block."""

    block: int
    elements: slice
    force: FloatArray
    tangent: FloatArray


@compiled
def add_forces(cells: IntArray, forces: FloatArray, out: FloatArray) -> None:
    """Add forces (m, 3 k) of cells (m, k) to those of the nodes (n, 3)."""
    for e in range(len(cells)):
        for a in range(cells.shape[1]):
            for i in range(3):
                out[cells[e, a], i] += forces[e, 3 * a + i]


class Elasticity:
    """Elastic energy of the blocks of a mesh with their materials.

    Of elements with mean dilatation, constant, and of others of Ogden's law whose K/mu is above 20, linear, the
    pressure p is an unknown of the iteration, eliminated in the element (J. C. Simo, R. L. Taylor, K. S. Pister, 1985):
    at the equilibrium p = K (v/V - 1), which is projected on these fields. A pressure of each of eight points would
    lock: in bent ribs of K/mu = 2400 it swung by eight shear moduli from point to point, and no equilibrium was found.
    A step of u with the matrix at hand leads to p^ = K (theta + dtheta), with theta = v/V - 1 and dtheta its linear
    change. Along the step, with p^ held,

        M = sum V (W_shear + p^ theta + rho/2 (theta - p^/K)^2) + other energies,  rho = min(K, 20 mu)

    falls where the energy, K/2 theta^2 in place of the last two, allows only steps of (mu/K)^(1/2): a step keeps the
    volume to first order, and K times the square of what it changes to second order is large. With rho = K both are
    the same but for a constant. Exact for any K; measured up to K/mu = 10,000.

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

    Attributes
    ----------
    element_mm
        Typical edge of an element, the length that searches go by.

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
        # K and rho of each block
        self._moduli = [_volumetric_moduli_mpa(m) for m in self._materials]
        # a tangent by the energy alone where nothing is nearly incompressible
        held = [
            1 if not m else 4 if law.law == OGDEN and k > _POINTS_UP_TO * law.shear_modulus_mpa else 0
            for m, law, (k, _) in zip(mode_counts, self._materials, self._moduli, strict=True)
        ]
        self._swelling = [
            np.zeros((len(c), p, 24 + 3 * m)) for c, p, m in zip(self.cells, held, mode_counts, strict=True)
        ]
        self._volume_strain = [np.zeros((len(c), p, 2)) for c, p in zip(self.cells, held, strict=True)]
        self.element_mm = _median_edge_mm(self._nodes, self.cells)
        # displacements and modes that the energies belong to, and whether exact tangents were evaluated there
        self._evaluated: tuple[FloatArray, ...] = ()
        self._has_tangents = False
        self.no_modes: Modes = tuple(np.zeros((len(c), m, 3)) for c, m in zip(self.cells, mode_counts, strict=True))

    def energy(self, u: FloatArray, modes: Modes) -> float:
        """Return the elastic energy in N mm; infinity where an element is inside out."""
        if not self._is_evaluated(u, modes):
            for _ in self._evaluate(u, modes, self.no_pressure, 0):
                pass
        return math.fsum(float(e.sum()) for e in self._energies)

    def has_tangents(self, u: FloatArray, modes: Modes) -> bool:
        """Whether the last evaluation was that of the exact :meth:`matrices` of this state."""
        return self._has_tangents and self._is_evaluated(u, modes)

    def _is_evaluated(self, u: FloatArray, modes: Modes) -> bool:
        """Whether the energies of the last evaluation, of whatever level, are those of this state."""
        asked = (u, *modes)
        return len(asked) == len(self._evaluated) and all(map(np.array_equal, asked, self._evaluated))

    @property
    def no_pressure(self) -> Pressures:
        """No pressure in any element."""
        return tuple(np.zeros(strain.shape[:2]) for strain in self._volume_strain)

    def pressures_mpa(self, u: FloatArray, modes: Modes) -> Pressures:
        """Return K (v/V - 1) where pressures are held; the pressure, where u is an equilibrium."""
        self.energy(u, modes)
        return tuple(k * strain[..., 1] for (k, _), strain in zip(self._moduli, self._volume_strain, strict=True))

    def full_step_pressures_mpa(self, du: FloatArray, step: Modes) -> tuple[Pressures, float]:
        """Return p^ of a step du (n, 3) and its modes from the last :meth:`matrices`, and by what M's slope is more.

        More than the energy's, by sum V (K - rho) dtheta^2.
        """
        found, slope = [], 0.0
        for cells, modes, swelling, strain, (k, rho) in zip(
            self.cells, step, self._swelling, self._volume_strain, self._moduli, strict=True
        ):
            if not swelling.shape[1]:
                found.append(np.zeros(strain.shape[:2]))
                continue
            local = np.concatenate([du[cells].reshape(-1, 24), modes.reshape(len(cells), -1)], axis=1)
            change = np.einsum("epi,ei->ep", swelling, local) / strain[..., 0]
            found.append(k * (strain[..., 1] + change))
            slope += (k - rho) * float((strain[..., 0] * change**2).sum())
        return tuple(found), slope

    def excess_n_mm(self, held: Pressures) -> float:
        """Return by what M lies above the energy at the last evaluation, with the pressures p^ held."""
        whole = 0.0
        for pressure, strain, (k, rho) in zip(held, self._volume_strain, self._moduli, strict=True):
            if rho < k:
                volume, theta = strain[..., 0], strain[..., 1]
                soft = 0.5 * rho * (theta - pressure / k) ** 2
                whole += float((volume * (pressure * theta + soft - 0.5 * k * theta**2)).sum())
        return whole

    def matrices(
        self, u: FloatArray, modes: Modes, removed_share: float = 0.0, pressures: Pressures = ()
    ) -> Iterator[ElementMatrices]:
        """Yield forces and tangents by u with the modes eliminated, a part of the elements at a time.

        The pressures weigh the volume's curvature in the tangent; by default those that u gives. Of each point's
        negative curvature `removed_share` is taken away: with 1 no element has any. The arrays are used again after the
        next step of the iteration. Where an element is inside out (see :meth:`energy`) its arrays mean nothing.
        """
        return self._evaluate(u, modes, pressures or self.pressures_mpa(u, modes), 1, 1.0 - removed_share)

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

    def relaxed(self, u: FloatArray, modes: Modes) -> Modes:
        """Return modes nearer to those that belong to u: Newton's steps, of each element as long as its energy falls.

        A step of all unknowns is shortened for the worst element; the modes of needles in a folding rib are that. After
        the first step, only elements with a share in what there is to win go on.
        """
        pairs = enumerate(modes)
        return tuple(self._relaxed_block(block, u, own.copy()) if own.shape[1] else own for block, own in pairs)

    def _relaxed_block(self, block: int, u: FloatArray, modes: FloatArray) -> FloatArray:
        """Move a block's modes (m, 3, 3) in place, and return them."""
        left = np.arange(len(modes))
        for _ in range(_RELAXATIONS):
            before, step, gain = self._alone(block, u, left, modes[left])
            worth = gain > _WORTH_RELAXING_REL * gain.max(initial=0.0)
            left, before, step = left[worth], before[worth], step[worth]
            share, open_ = np.ones(len(left)), np.arange(len(left))
            for _ in range(_RELAXATIONS):
                tried = modes[left[open_]] + share[open_, None, None] * step[open_]
                falls = self._energies_alone(block, u, left[open_], tried) <= before[open_]
                modes[left[open_[falls]]] = tried[falls]
                open_ = open_[~falls]
                share[open_] *= _RELAXED_LESS
                if not len(open_):
                    break
        return modes

    def _energies_alone(self, block: int, u: FloatArray, elements: IntArray, modes: FloatArray) -> FloatArray:
        """Return the energies (k,) of some elements of a block with modes (k, 3, 3)."""
        none = np.zeros(self._volume_strain[block][elements].shape[:2])
        return self._some(block, u, elements, modes, none, 0)[0]

    def _alone(
        self, block: int, u: FloatArray, elements: IntArray, modes: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return energies (k,), steps (k, 3, 3) of the modes alone, and by how much these steps may lower them."""
        found = []
        for part in np.array_split(np.arange(len(elements)), max(1, len(elements) // _TOGETHER)):
            held = np.zeros((len(part), self._volume_strain[block].shape[1]))
            if held.size:
                strain = self._some(block, u, elements[part], modes[part], held, 0)[3]
                held = self._moduli[block][0] * strain[..., 1]
            energy, solved, force, _ = self._some(block, u, elements[part], modes[part], held, 1)
            found.append((energy, -solved[:, :, 24].reshape(-1, 3, 3), 0.5 * (force * solved[:, :, 24]).sum(axis=1)))
        energies, steps, gains = (np.concatenate(columns) for columns in zip(*found, strict=True))
        return energies, steps, gains

    def _some(
        self, block: int, u: FloatArray, elements: IntArray, modes: FloatArray, held: FloatArray, level: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return energies, solved systems and forces of the modes and volume strains of some elements of a block."""
        count, room = len(elements), len(elements) if level else 0
        energy, force, tangent = np.empty(count), np.empty((room, 24)), np.empty((room, 24, 24))
        solved, mode_force = np.zeros((room, 9, 25)), np.zeros((room, 9))
        strain = np.zeros((count, *self._volume_strain[block].shape[1:]))
        swelling = np.zeros((count, *self._swelling[block].shape[1:]))
        out = (energy, force, tangent, solved, mode_force, swelling, strain)
        self._evaluate_some(block, self.cells[block][elements], u, modes, held, 1.0 if level else None, out)
        return energy, solved, mode_force, strain

    def mode_work_n_mm(self) -> float:
        """Return sum f_a . K_aa^-1 f_a over the modes: by what the energy's slope lies below that of u alone."""
        pairs = zip(self._mode_force, self._solved, strict=True)
        return float(sum(np.einsum("ei,ei->", f, s[:, :, 24]) for f, s in pairs))

    def mode_residual_n(self) -> float:
        """Return the norm of the forces on the modes at the last :meth:`matrices`."""
        return math.sqrt(sum(float((f**2).sum()) for f in self._mode_force))

    def _evaluate(
        self, u: FloatArray, modes: Modes, held: Pressures, level: int, kept: float = 1.0
    ) -> Iterator[ElementMatrices]:
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
            self._evaluate_part(displacement, modes[block], held[block], level, kept, out)
            return out

        self._evaluated = ()
        if self._threads == 1:
            yield from map(evaluate, range(len(jobs)))
        else:
            with ThreadPoolExecutor(self._threads) as pool:
                for first in range(0, len(jobs), self._threads):
                    yield from pool.map(evaluate, range(first, min(first + self._threads, len(jobs))))
        self._evaluated = (displacement.copy(), *(m.copy() for m in modes))
        self._has_tangents = level > 0 and kept == 1.0

    def _evaluate_part(
        self, u: FloatArray, modes: FloatArray, held: FloatArray, level: int, kept: float, out: ElementMatrices
    ) -> None:
        block, part = out.block, out.elements
        filled = (
            self._energies[block][part],
            out.force,
            out.tangent,
            self._solved[block][part],
            self._mode_force[block][part],
            self._swelling[block][part],
            self._volume_strain[block][part],
        )
        share = kept if level else None
        self._evaluate_some(block, self.cells[block][part], u, modes[part], held[part], share, filled)

    def _evaluate_some(
        self,
        block: int,
        cells: IntArray,
        u: FloatArray,
        modes: FloatArray,
        held: FloatArray,
        kept: float | None,
        filled: tuple[FloatArray, ...],
    ) -> None:
        """Fill what :func:`many_hexahedra` fills, of elements (k, 8) of a block; energies only without `kept`."""
        material = self._materials[block]
        parameters = material.parameters
        if isinstance(material, PackagedMaterial):
            stretches = np.empty((len(cells), 8, 3))
            many_stretches(self._nodes, u, cells, modes, stretches)
            parameters = material.rows(stretches)
        level, share = (0, 1.0) if kept is None else (1, kept)
        many_hexahedra(self._nodes, u, cells, modes, material.law, parameters, held, level, share, *filled)


_SEARCH_BULK_OVER_SHEAR = 20.0
_POINTS_UP_TO = 20.0  # K/mu up to which elements with modes have a pressure of each point
_RELAXATIONS, _RELAXED_LESS = 3, 0.25  # steps of the modes alone, tries of each, and by what these are shortened
_WORTH_RELAXING_REL = 1e-4  # of the most that an element may win


def _median_edge_mm(nodes_mm: FloatArray, cells: Sequence[IntArray]) -> float:
    """Return the median over all hexahedra of the geometric mean of three edges at one corner."""
    corners = nodes_mm[np.concatenate([np.empty((0, 8), np.int64), *cells])]
    edges = np.linalg.norm(corners[:, [1, 3, 4]] - corners[:, :1], axis=2)
    return float(np.median(np.cbrt(edges.prod(axis=1)))) if len(edges) else 1.0


def _volumetric_moduli_mpa(material: Material) -> tuple[float, float]:
    """Return K and the rho of the line search."""
    bulk = material.bulk_modulus_mpa
    return bulk, min(bulk, _SEARCH_BULK_OVER_SHEAR * material.shear_modulus_mpa)


def _material_of(block: Block, materials: Mapping[str, Material]) -> Material:
    """Return the material of a block."""
    if block.material not in materials:
        raise SimulateError(
            f"block {block.name} has the material {block.material}, but the known materials are "
            f"{', '.join(sorted(materials))}"
        )
    material = materials[block.material]
    if block.element == "mean_dilatation" and material.law == ST_VENANT_KIRCHHOFF:
        raise SimulateError(
            f"block {block.name} asks for mean dilatation, which is only for Ogden and neo-Hookean materials, but "
            f"{block.material} is linear elastic; use incompatible_modes"
        )
    return material


class Term(Protocol):
    """An energy of the nodes' displacement u (n, 3) in mm beside the elastic one: contact, friction at fixed lag, ties.

    A node of the mesh that no element uses is a rigid body's position: terms may move it like any other.
    """

    def energy(self, u: FloatArray) -> float:
        """Return the energy in N mm; infinity where u is not allowed."""
        ...

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return its derivative in N, shape (n, 3): minus the force on the nodes."""
        ...

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return its second derivative in N/mm, symmetric (3 n, 3 n), unknown 3 node + axis.

        With `project` without negative curvature. Explicit zeros reserve their place, so that a matrix whose entries
        come and go need not be analysed again.
        """
        ...

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return the largest share (0, 1] of the step du (n, 3) from u that is allowed."""
        ...


@dataclass(frozen=True, slots=True)
class State:
    """Displacement of the nodes (n, 3) and incompatible modes of the elements in mm, and pressures of the elements.

    Without pressures, of a stored state, they are those that the displacement gives.
    """

    u_mm: FloatArray
    modes: Modes
    pressures_mpa: Pressures = ()

    def moved(self, share: float, du: FloatArray, step: Modes) -> "State":
        """Return the state a share of a step further; the pressures stay."""
        return State(
            self.u_mm + share * du,
            tuple(m + share * d for m, d in zip(self.modes, step, strict=True)),
            self.pressures_mpa,
        )

    def towards(self, pressures: Pressures, share: float) -> "State":
        """Return the state with its pressures a share of the way to others."""
        pairs = zip(self.pressures_mpa, pressures, strict=True)
        return State(self.u_mm, self.modes, tuple(p + share * (q - p) for p, q in pairs))


_SAME_PRESSURE_REL = 1e-3  # of the greatest; an equilibrium's own pressures miss the last step's by its square


class _Kept(NamedTuple):
    """The last exact tangents of the elements, as values of the matrix of a version, and their gradient (n, 3)."""

    version: int
    pressures_mpa: Pressures
    tangents: FloatArray
    gradient: FloatArray

    def is_of(self, state: State, version: int) -> bool:
        """Whether the pressures of a state are these and a matrix has these places."""
        if version != self.version or len(self.pressures_mpa) != len(state.pressures_mpa):
            return False
        pairs = zip(self.pressures_mpa, state.pressures_mpa, strict=True)
        return all(np.abs(p - q).max(initial=0.0) <= _SAME_PRESSURE_REL * np.abs(p).max(initial=0.0) for p, q in pairs)


class Assembly:
    """Elastic mesh and further terms, whose sum of energies is to be least.

    Parameters
    ----------
    elasticity
        The elastic mesh.
    terms
        Further energies.
    """

    def __init__(self, elasticity: Elasticity, terms: Sequence[Term] = ()) -> None:
        self.elasticity = elasticity
        self.terms: tuple[Term, ...] = tuple(terms)
        self.count = elasticity.count
        self.matrix = UpperBlocks(self.count, elasticity.cells)
        self._slots_of(self.matrix.version)
        self._kept = _Kept(-1, (), np.empty(0), np.empty((0, 3)))

    def _slots_of(self, version: int) -> None:
        self._version = version
        self._slots = [self.matrix.slots(cells) for cells in self.elasticity.cells]

    def at_rest(self) -> State:
        """Return the undeformed state."""
        return State(np.zeros((self.count, 3)), self.elasticity.no_modes, self.elasticity.no_pressure)

    def with_own_pressures(self, state: State) -> State:
        """Return a state with the pressures that its displacement gives: those of an equilibrium."""
        return replace(state, pressures_mpa=self.elasticity.pressures_mpa(state.u_mm, state.modes))

    def energy(self, state: State) -> float:
        """Return the whole energy in N mm; infinity where it is not defined."""
        energy = 0.0
        for term in self.terms:
            energy += term.energy(state.u_mm)
            if energy == math.inf:
                return energy
        return energy + self.elasticity.energy(state.u_mm, state.modes)

    def assemble(self, state: State, removed_share: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Fill :attr:`matrix` and return the gradient without the modes, and its part of the terms, in N, (n, 3).

        The tangent does without `removed_share` of each point's negative curvature; where that is above 0, terms do
        without all of theirs.
        """
        gradient = self._of_elements(state, removed_share)
        of_terms = np.zeros((self.count, 3))
        for term in self.terms:
            of_terms += term.gradient(state.u_mm)
            self.matrix.add_sparse(term.hessian(state.u_mm, removed_share > 0.0))
        return gradient + of_terms, of_terms

    def _of_elements(self, state: State, removed_share: float) -> FloatArray:
        """Fill the matrix by the elements alone and return their gradient (n, 3), from before where only terms changed.

        Terms do so where they renew what they have lagged. The tangent may then weigh curvature by pressures that the
        equilibrium's own have replaced since: Newton's method takes that.
        """
        kept, exact = self._kept, removed_share == 0.0
        if exact and kept.is_of(state, self.matrix.version) and self.elasticity.has_tangents(state.u_mm, state.modes):
            self.matrix.values[:] = kept.tangents
            return kept.gradient.copy()
        if self._version != self.matrix.version:
            self._slots_of(self.matrix.version)
        self.matrix.clear()
        gradient = np.zeros((self.count, 3))
        for part in self.elasticity.matrices(state.u_mm, state.modes, removed_share, state.pressures_mpa):
            cells = self.elasticity.cells[part.block][part.elements]
            self.matrix.add_cells(cells, self._slots[part.block][part.elements], part.tangent)
            add_forces(cells, part.force, gradient)
        if exact:
            self._kept = _Kept(self.matrix.version, state.pressures_mpa, self.matrix.values.copy(), gradient.copy())
        return gradient

    def max_step(self, state: State, du: FloatArray) -> float:
        """Return the largest share of the step du (n, 3) that all terms allow."""
        return min([1.0, *(term.max_step(state.u_mm, du) for term in self.terms)])
