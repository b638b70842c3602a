"""Compiled hexahedra: energy, nodal forces and tangent of one element and of many.

Everything is computed in the principal frame of the deformation gradient F = sum_i lambda_i n_i (x) N_i, where an
isotropic energy psi(lambda_1, lambda_2, lambda_3) has a second derivative of nine modes only (R. W. Ogden, Non-Linear
Elastic Deformations, 1984, section 6.1.4; B. Smith et al., ACM Trans. Graph. 38, 12, 2019):

- stretch modes n_i (x) N_i, coupled by psi_ij;
- for each pair, (n_i (x) N_j + n_j (x) N_i) / sqrt 2 with (psi_i - psi_j) / (lambda_i - lambda_j);
- for each pair, (n_i (x) N_j - n_j (x) N_i) / sqrt 2 with (psi_i + psi_j) / (lambda_i + lambda_j).

A tangent without negative curvature follows by setting negative values of these modes to zero.

Laws take a row of parameters: ST_VENANT_KIRCHHOFF (bulk = 0, lambda, mu in MPa), OGDEN (bulk, mu_1, alpha_1, ...).
GIVEN is a law that another package brings: its energies were computed beforehand, at the stretches of
:func:`many_stretches`, and its row holds, of each element, the bulk modulus and of each point psi, psi_i, psi_ij.

Numba enters the mechanics here only. It renews a cached function when its own file changes, not when a function that
it calls does: a compiled function therefore calls only compiled functions of its own file.
"""

import math
from collections.abc import Callable
from typing import Final, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., object])

_REORDER = {"reassoc", "contract", "arcp", "nsz"}  # sums may be reordered; infinities and NaN keep their meaning


def compiled(function: Function) -> Function:
    """Compile a function of floats and arrays at its first call; it releases the interpreter's lock.

    Division by zero gives an infinity, as in numpy, and raises nothing.
    """
    dispatcher: Function = numba.njit(cache=True, nogil=True, fastmath=_REORDER, error_model="numpy")(function)
    return dispatcher


FloatArray = NDArray[np.float64]

ST_VENANT_KIRCHHOFF: Final = 0
OGDEN: Final = 1
GIVEN: Final = 2
GIVEN_OF_POINT: Final = 13
"""Numbers of a point of a given law: psi, three psi_i, nine psi_ij."""
GIVEN_OF_ELEMENT: Final = 1 + 8 * GIVEN_OF_POINT

CORNERS: Final = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], np.float64
)
"""Local coordinates of the eight nodes (order of Abaqus' C3D8)."""

GAUSS_POINTS: Final = CORNERS / math.sqrt(3.0)

_EQUAL = 1e-5  # relative difference of stretches below which the difference quotient becomes its limit
_ROTATION_END = 1e-32  # squared sine at which two axes need no further rotation
_TINY = 1e-300  # keeps the quotient of two zeros 0
_SQRT_HALF = math.sqrt(0.5)
_FIRST = np.array([0, 0, 1])
_SECOND = np.array([1, 2, 2])


def shape_gradients(local: FloatArray) -> FloatArray:
    """Return dN_a / dxi_j of the trilinear hexahedron at local points (m, 3), shape (m, 8, 3)."""
    factors = 1.0 + CORNERS[None] * local[:, None]
    x, y, z = (factors[..., j] for j in range(3))
    return np.stack([CORNERS[:, 0] * y * z, CORNERS[:, 1] * x * z, CORNERS[:, 2] * x * y], -1) / 8.0


# (8 nodes, 3, 8 points): the points come last in all arrays, so that one instruction serves all of them
_AT_GAUSS = np.ascontiguousarray(np.moveaxis(shape_gradients(GAUSS_POINTS), 0, -1))
_AT_CENTRE = np.ascontiguousarray(np.moveaxis(shape_gradients(np.zeros((8, 3))), 0, -1))


@compiled
def _inverses(a: FloatArray, out: FloatArray, det: FloatArray) -> None:
    """Fill the inverses (3, 3, 8) and determinants (8,) of 3 x 3 matrices (3, 3, 8)."""
    for i in range(3):
        for j in range(3):
            r, s, t, u = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            for q in range(8):
                out[i, j, q] = a[r, t, q] * a[s, u, q] - a[r, u, q] * a[s, t, q]
    for q in range(8):
        det[q] = a[0, 0, q] * out[0, 0, q] + a[0, 1, q] * out[1, 0, q] + a[0, 2, q] * out[2, 0, q]
    out /= det


@compiled
def _turn(c: FloatArray, v: FloatArray, p: int, q: int, r: int) -> None:
    """Turn away c_pq of symmetric 3 x 3 matrices c (3, 3, 8), side by side, and turn their axes v with them."""
    for k in range(8):
        off, gap = c[p, q, k], c[q, q, k] - c[p, p, k]
        root = abs(gap) + math.sqrt(gap * gap + 4.0 * off * off) + _TINY
        t = (2.0 * off if gap >= 0.0 else -2.0 * off) / root
        cos = 1.0 / math.sqrt(t * t + 1.0)
        sin = t * cos
        c[p, p, k] -= t * off
        c[q, q, k] += t * off
        c[p, q, k] = c[q, p, k] = 0.0
        crp, crq = c[r, p, k], c[r, q, k]
        c[r, p, k] = c[p, r, k] = cos * crp - sin * crq
        c[r, q, k] = c[q, r, k] = sin * crp + cos * crq
        for i in range(3):
            vip, viq = v[i, p, k], v[i, q, k]
            v[i, p, k] = cos * vip - sin * viq
            v[i, q, k] = sin * vip + cos * viq


@compiled
def _jacobi(c: FloatArray, v: FloatArray) -> None:
    """Fill eigenvectors v (columns) of symmetric matrices c (3, 3, 8), whose diagonals become the eigenvalues."""
    v[:] = 0.0
    for i in range(3):
        v[i, i] = 1.0
    for _ in range(12):
        most = 0.0
        for q in range(8):
            for i, j in ((0, 1), (0, 2), (1, 2)):
                most = max(most, c[i, j, q] * c[i, j, q] - _ROTATION_END * abs(c[i, i, q] * c[j, j, q]))
        if most <= 0.0:
            break
        _turn(c, v, 0, 1, 2)
        _turn(c, v, 0, 2, 1)
        _turn(c, v, 1, 2, 0)


@compiled
def given_energy(parameters: FloatArray, first: FloatArray, second: FloatArray) -> float:
    """Return psi in MPa and fill psi_i and psi_ij of a law that was evaluated before, from its row."""
    for i in range(3):
        first[i] = parameters[2 + i]
        for j in range(3):
            second[i, j] = parameters[5 + 3 * i + j]
    return float(parameters[1])


@compiled
def stretch_energy(
    law: int, parameters: FloatArray, stretch: FloatArray, first: FloatArray, second: FloatArray, curve: FloatArray
) -> float:
    """Return psi in MPa without the volumetric part and fill psi_i and psi_ij; `curve` (3,) is work space."""
    for i in range(3):
        first[i] = 0.0
        for j in range(3):
            second[i, j] = 0.0
    energy = 0.0
    if law == GIVEN:
        return given_energy(parameters, first, second)
    if law == ST_VENANT_KIRCHHOFF:
        lame, shear = parameters[1], parameters[2]
        trace = 0.5 * ((stretch[0] ** 2 - 1.0) + (stretch[1] ** 2 - 1.0) + (stretch[2] ** 2 - 1.0))
        energy = 0.5 * lame * trace * trace
        for i in range(3):
            strain = 0.5 * (stretch[i] ** 2 - 1.0)
            energy += shear * strain * strain
            stress = lame * trace + 2.0 * shear * strain
            first[i] = stretch[i] * stress
            second[i, i] = stress + 2.0 * shear * stretch[i] ** 2
            for j in range(3):
                second[i, j] += lame * stretch[i] * stretch[j]
        return float(energy)
    logs = (math.log(stretch[0]), math.log(stretch[1]), math.log(stretch[2]))
    mean = (logs[0] + logs[1] + logs[2]) / 3.0
    for p in range((len(parameters) - 1) // 2):
        mu, alpha = parameters[1 + 2 * p], parameters[2 + 2 * p]
        total = 0.0
        for i in range(3):
            curve[i] = math.expm1(alpha * (logs[i] - mean))
            total += curve[i]
        energy += 2.0 * mu / (alpha * alpha) * total
        third = total / 3.0
        for i in range(3):
            first[i] += 2.0 * mu / alpha * (curve[i] - third)
            for j in range(3):
                second[i, j] -= 2.0 * mu / 3.0 * (1.0 + curve[i] + curve[j] - third)
            second[i, i] += 2.0 * mu * (1.0 + curve[i])
    for i in range(3):
        second[i, i] -= first[i]
        for j in range(3):
            second[i, j] /= stretch[i] * stretch[j]
    for i in range(3):
        first[i] /= stretch[i]
    return float(energy)


@compiled
def _add_volumetric(
    pressure_mpa: float, bulk_mpa: float, j: float, stretch: FloatArray, first: FloatArray, second: FloatArray
) -> None:
    """Add the derivatives of a volumetric energy U(J) with U' = pressure and U'' = bulk."""
    for i in range(3):
        first[i] += pressure_mpa * j / stretch[i]
        for k in range(3):
            second[i, k] += (bulk_mpa * j + pressure_mpa) * j / (stretch[i] * stretch[k])
        second[i, i] -= pressure_mpa * j / (stretch[i] * stretch[i])


@compiled
def _less_negative(second: FloatArray, shear: FloatArray, kept_share: float, work: FloatArray, v: FloatArray) -> None:
    """Multiply the negative values of all modes by the share that is kept of them; work space of (3, 3, 8) each."""
    work[:] = second
    _jacobi(work, v)
    for q in range(8):
        for k in range(6):
            shear[k, q] = max(shear[k, q], kept_share * shear[k, q])
        if work[0, 0, q] >= 0.0 and work[1, 1, q] >= 0.0 and work[2, 2, q] >= 0.0:
            continue
        for i in range(3):
            for j in range(3):
                second[i, j, q] = 0.0
                for k in range(3):
                    kept = max(work[k, k, q], kept_share * work[k, k, q])
                    second[i, j, q] += kept * v[i, k, q] * v[j, k, q]


@compiled
def _shear_modes(stretch: FloatArray, first: FloatArray, second: FloatArray, shear: FloatArray) -> None:
    """Fill the values of the three symmetric and the three antisymmetric shear modes, shape (6,)."""
    for k in range(3):
        i, j = _FIRST[k], _SECOND[k]
        gap = stretch[i] - stretch[j]
        if abs(gap) > _EQUAL * stretch[i]:
            shear[k] = (first[i] - first[j]) / gap
        else:
            shear[k] = 0.5 * (second[i, i] + second[j, j]) - second[i, j]
        shear[3 + k] = (first[i] + first[j]) / (stretch[i] + stretch[j])


@compiled
def _map_gradients(x: FloatArray, shapes: FloatArray, jacobian: FloatArray) -> None:
    """Fill dX_i / dxi_j (3, 3, 8) of nodes (8, 3) and shapes' gradients (8, 3, 8)."""
    jacobian[:] = 0.0
    for a in range(8):
        for i in range(3):
            for j in range(3):
                for q in range(8):
                    jacobian[i, j, q] += x[a, i] * shapes[a, j, q]


@compiled
def reference_gradients(x: FloatArray, gradients: FloatArray, volume: FloatArray) -> bool:
    """Fill dN_a / dX (8 nodes or 11 with incompatible modes, 3, 8 points) and the volumes of the points in mm^3.

    The gradients of the three incompatible modes are det J0 / det J xi_m J0^-T e_m, whose integral vanishes on any
    hexahedron, so that the patch test is passed (R. L. Taylor, P. J. Beresford, E. L. Wilson, 1976; J. C. Simo,
    F. Armero, R. L. Taylor, 1993).

    Returns
    -------
    bool
        False where the hexahedron is inside out at a Gauss point.
    """
    jacobian, inverse = np.empty((3, 3, 8)), np.empty((3, 3, 8))
    _map_gradients(x, _AT_GAUSS, jacobian)
    _inverses(jacobian, inverse, volume)
    for a in range(8):
        for i in range(3):
            for q in range(8):
                g = _AT_GAUSS[a, 0, q] * inverse[0, i, q]
                gradients[a, i, q] = g + _AT_GAUSS[a, 1, q] * inverse[1, i, q] + _AT_GAUSS[a, 2, q] * inverse[2, i, q]
    if len(gradients) > 8:
        det_centre = np.empty(8)
        _map_gradients(x, _AT_CENTRE, jacobian)
        _inverses(jacobian, inverse, det_centre)
        for m in range(len(gradients) - 8):
            for i in range(3):
                for q in range(8):
                    gradients[8 + m, i, q] = det_centre[q] / volume[q] * GAUSS_POINTS[q, m] * inverse[m, i, q]
    return bool(volume.min() > 0.0)


@compiled
def _deformations(gradients: FloatArray, displacement: FloatArray, f: FloatArray, jacobians: FloatArray) -> bool:
    """Fill F = 1 + sum_a u_a (x) grad N_a of the points (3, 3, 8) and det F (8,); False where one is not positive."""
    for i in range(3):
        for j in range(3):
            f[i, j] = 1.0 if i == j else 0.0
    for a in range(len(gradients)):
        for i in range(3):
            for j in range(3):
                for q in range(8):
                    f[i, j, q] += displacement[a, i] * gradients[a, j, q]
    for q in range(8):
        det = f[0, 0, q] * (f[1, 1, q] * f[2, 2, q] - f[1, 2, q] * f[2, 1, q])
        det -= f[0, 1, q] * (f[1, 0, q] * f[2, 2, q] - f[1, 2, q] * f[2, 0, q])
        jacobians[q] = det + f[0, 2, q] * (f[1, 0, q] * f[2, 1, q] - f[1, 1, q] * f[2, 0, q])
    return bool(jacobians.min() > 0.0)


@compiled
def _principal_frames(
    f: FloatArray, stretch: FloatArray, material: FloatArray, spatial: FloatArray, c: FloatArray
) -> None:
    """Fill stretches (8, 3) and principal directions N and n = F N / lambda (columns) of the points' F (3, 3, 8).

    The directions are (3, 3, 8); c is work space of that shape.
    """
    for i in range(3):
        for j in range(3):
            for q in range(8):
                c[i, j, q] = f[0, i, q] * f[0, j, q] + f[1, i, q] * f[1, j, q] + f[2, i, q] * f[2, j, q]
    _jacobi(c, material)
    for k in range(3):
        for q in range(8):
            c[k, k, q] = math.sqrt(c[k, k, q])
            stretch[q, k] = c[k, k, q]
        for i in range(3):
            for q in range(8):
                s = f[i, 0, q] * material[0, k, q] + f[i, 1, q] * material[1, k, q] + f[i, 2, q] * material[2, k, q]
                spatial[i, k, q] = s / c[k, k, q]


@compiled
def _principal_gradients(gradients: FloatArray, material: FloatArray, out: FloatArray) -> None:
    """Fill the components N_j . grad N_a (nodes, 3, 8) of the points' gradients (nodes, 3, 8)."""
    for a in range(len(gradients)):
        for j in range(3):
            for q in range(8):
                s = material[0, j, q] * gradients[a, 0, q] + material[1, j, q] * gradients[a, 1, q]
                out[a, j, q] = s + material[2, j, q] * gradients[a, 2, q]


@compiled
def _pulled(pull: FloatArray, spatial: FloatArray, along: FloatArray, weight: FloatArray, out: FloatArray) -> None:
    """Fill the sums over the points of weight_q pull_j n_ij (N_j . grad N_a), forces (3 nodes,), from `pull` (3, 8)."""
    by_axes = np.empty((3, 3, 8))
    for i in range(3):
        for j in range(3):
            for q in range(8):
                by_axes[i, j, q] = weight[q] * pull[j, q] * spatial[i, j, q]
    for a in range(len(along)):
        for i in range(3):
            total = 0.0
            for j in range(3):
                for q in range(8):
                    total += by_axes[i, j, q] * along[a, j, q]
            out[3 * a + i] = total


@compiled
def _moduli(second: FloatArray, shear: FloatArray, spatial: FloatArray, out: FloatArray) -> None:
    """Fill the second derivatives A_ijkl of V psi by F, of pairs i <= k in space and j and l along N, (6, 3, 3, 8).

    With a = (s + t) / 2 and b = (s - t) / 2 of the symmetric and antisymmetric shear modes,
    A_ijkj = psi_jj n_ij n_kj + sum_m a_jm n_im n_km, and else A_ijkl = psi_jl n_ij n_kl + b_jl n_il n_kj.
    `second` (3, 3, 8) and `shear` (6, 8) are times V.
    """
    pair = 0
    for i in range(3):
        for k in range(i, 3):
            for j in range(3):
                m, n = (j + 1) % 3, (j + 2) % 3
                # a pair of axes is numbered by the third one
                to_m, to_n = 2 - n, 2 - m
                for q in range(8):
                    i_j, i_m, i_n = spatial[i, j, q], spatial[i, m, q], spatial[i, n, q]
                    k_j, k_m, k_n = spatial[k, j, q], spatial[k, m, q], spatial[k, n, q]
                    both_m, turn_m = 0.5 * shear[to_m, q], 0.5 * shear[3 + to_m, q]
                    both_n, turn_n = 0.5 * shear[to_n, q], 0.5 * shear[3 + to_n, q]
                    sheared = (both_m + turn_m) * i_m * k_m + (both_n + turn_n) * i_n * k_n
                    out[pair, j, j, q] = second[j, j, q] * i_j * k_j + sheared
                    out[pair, j, m, q] = second[j, m, q] * i_j * k_m + (both_m - turn_m) * i_m * k_j
                    out[pair, j, n, q] = second[j, n, q] * i_j * k_n + (both_n - turn_n) * i_n * k_j
            pair += 1


@compiled
def _weigh(moduli: FloatArray, along: FloatArray, out: FloatArray) -> None:
    """Fill sum_l A_ijkl (N_l . grad N_b) of the points, (6 pairs i <= k times nodes b, 3, 8)."""
    nodes = len(along)
    for p in range(6):
        for b in range(nodes):
            for q in range(8):
                x, y, z = along[b, 0, q], along[b, 1, q], along[b, 2, q]
                first = moduli[p, 0, 0, q] * x + moduli[p, 0, 1, q] * y + moduli[p, 0, 2, q] * z
                second = moduli[p, 1, 0, q] * x + moduli[p, 1, 1, q] * y + moduli[p, 1, 2, q] * z
                third = moduli[p, 2, 0, q] * x + moduli[p, 2, 1, q] * y + moduli[p, 2, 2, q] * z
                out[nodes * p + b, 0, q], out[nodes * p + b, 1, q], out[nodes * p + b, 2, q] = first, second, third


@compiled
def _by_unknowns(blocks: FloatArray, tangent: FloatArray) -> None:
    """Fill the tangent (3 nodes, 3 nodes) from (nodes, 6 pairs i <= k times nodes)."""
    nodes = len(blocks)
    for a in range(nodes):
        for b in range(nodes):
            x, y, z = 3 * a, 3 * a + 1, 3 * a + 2
            tangent[x, 3 * b], tangent[x, 3 * b + 1] = blocks[a, b], blocks[a, nodes + b]
            tangent[x, 3 * b + 2], tangent[y, 3 * b] = blocks[a, 2 * nodes + b], blocks[b, nodes + a]
            tangent[y, 3 * b + 1], tangent[y, 3 * b + 2] = blocks[a, 3 * nodes + b], blocks[a, 4 * nodes + b]
            tangent[z, 3 * b], tangent[z, 3 * b + 1] = blocks[b, 2 * nodes + a], blocks[b, 4 * nodes + a]
            tangent[z, 3 * b + 2] = blocks[a, 5 * nodes + b]


@compiled
def _linear_volumes(
    bulk_mpa: float, volume: FloatArray, jacobians: FloatArray, fields: FloatArray, volume_strain: FloatArray
) -> float:
    """Return K/2 times the integral of the square of v/V - 1, projected on four fields.

    The fields (4, 8) are 1, xi, eta and zeta at the points, made orthogonal over the element; of each,
    `volume_strain` (4, 2) receives the integral of its square and the coefficient.
    """
    energy = 0.0
    for m in range(4):
        for q in range(8):
            fields[m, q] = 1.0 if m == 0 else GAUSS_POINTS[q, m - 1]
        for n in range(m):
            shared = 0.0
            for q in range(8):
                shared += volume[q] * fields[m, q] * fields[n, q]
            for q in range(8):
                fields[m, q] -= shared / volume_strain[n, 0] * fields[n, q]
        weight, change = 0.0, 0.0
        for q in range(8):
            weight += volume[q] * fields[m, q] * fields[m, q]
            change += volume[q] * fields[m, q] * (jacobians[q] - 1.0)
        volume_strain[m, 0], volume_strain[m, 1] = weight, change / weight
        energy += 0.5 * bulk_mpa * change * change / weight
    return energy


@compiled
def _add_held(
    bulk_mpa: float,
    held_mpa: FloatArray,
    volume_strain: FloatArray,
    swelling: FloatArray,
    force: FloatArray,
    tangent: FloatArray,
) -> None:
    """Add to forces and tangent what the pressures K (v/V - 1) are beyond those held, and their rate."""
    for m in range(len(held_mpa)):
        beyond, rate = bulk_mpa * volume_strain[m, 1] - held_mpa[m], bulk_mpa / volume_strain[m, 0]
        for r in range(len(force)):
            force[r] += beyond * swelling[m, r]
            scaled = rate * swelling[m, r]
            for s in range(len(force)):
                tangent[r, s] += scaled * swelling[m, s]


@compiled
def hexahedron(
    x: FloatArray,
    displacement: FloatArray,
    law: int,
    parameters: FloatArray,
    mean_dilatation: bool,
    held_mpa: FloatArray,
    level: int,
    kept_share: float,
    force: FloatArray,
    tangent: FloatArray,
    swelling: FloatArray,
    volume_strain: FloatArray,
) -> float:
    """Return the energy of one hexahedron in N mm; infinity where it is inside out.

    Parameters
    ----------
    x
        Nodes at rest in mm, shape (8, 3).
    displacement
        Of the nodes and, behind them, of the incompatible modes in mm, shape (8, 3) or (11, 3).
    law, parameters
        See the module.
    mean_dilatation
        Whether the volumetric energy K/2 (v/V - 1)^2 V uses the whole element's volume (J. C. Nagtegaal, D. M. Parks,
        J. R. Rice, 1974).
    held_mpa
        Pressure p that weighs the second derivative of the volume in the tangent, in place of K (v/V - 1), which
        differs from it before the equilibrium: of the element with the mean dilatation (1,); else the coefficients of
        four fields, linear in the element, on which v/V - 1 is projected (4,), because eight pressures would lock nine
        modes and swing from point to point; or none (0,): the energy of each point's volume, and its tangent. The
        force is always that of K (v/V - 1).
    level
        0 energy only, 1 forces and tangent.
    kept_share
        Share of the negative curvature of each point that the tangent keeps: 1 all, as it is; 0 none.
    force, tangent
        Filled: (3 nodes,) in N, (3 nodes, 3 nodes) in N/mm.
    swelling, volume_strain
        Filled for each pressure that is held: dv/du (1, 24) or (4, 33) in mm^2, at level 0 not; V in mm^3 and v/V - 1,
        (1, 2) or (4, 2). Of the linear fields f: sum f dv, sum f^2 V, and the ratio of sum f (v - V) to that.
    """
    nodes = displacement.shape[0]
    gradients, volume, f, jacobians = np.empty((nodes, 3, 8)), np.empty(8), np.empty((3, 3, 8)), np.empty(8)
    if not reference_gradients(x, gradients, volume) or not _deformations(gradients, displacement, f, jacobians):
        return math.inf
    total, deformed = volume.sum(), (volume * jacobians).sum()
    bulk = parameters[0]
    linear, fields, energy = not mean_dilatation and len(held_mpa) > 0, np.ones((4, 8)), 0.0
    if mean_dilatation:
        energy = 0.5 * bulk * (deformed / total - 1.0) * (deformed - total)
        volume_strain[0, 0], volume_strain[0, 1] = total, deformed / total - 1.0
    elif linear:
        energy = _linear_volumes(bulk, volume, jacobians, fields, volume_strain)
    stretch, first, second, shear, curve = np.empty((8, 3)), np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(3)
    material, spatial, work = np.empty((3, 3, 8)), np.empty((3, 3, 8)), np.empty((3, 3, 8))
    pull, swell, seconds, shears = np.empty((3, 8)), np.empty((3, 8)), np.empty((3, 3, 8)), np.empty((6, 8))
    _principal_frames(f, stretch, material, spatial, work)
    for q in range(8):
        row = parameters[GIVEN_OF_POINT * q :] if law == GIVEN else parameters
        energy += volume[q] * stretch_energy(law, row, stretch[q], first, second, curve)
        if bulk > 0.0 and len(held_mpa) > 0:
            pressure = 0.0
            for m in range(len(held_mpa)):
                pressure += held_mpa[m] * fields[m, q]
            _add_volumetric(pressure, 0.0, jacobians[q], stretch[q], first, second)
        elif bulk > 0.0:
            own = bulk * (jacobians[q] - 1.0)
            energy += 0.5 * own * (jacobians[q] - 1.0) * volume[q]
            _add_volumetric(own, bulk, jacobians[q], stretch[q], first, second)
        if level == 0:
            continue
        _shear_modes(stretch[q], first, second, shear)
        for i in range(3):
            pull[i, q], swell[i, q] = first[i], jacobians[q] / stretch[q, i]
            shears[i, q], shears[3 + i, q] = volume[q] * shear[i], volume[q] * shear[3 + i]
            for j in range(3):
                seconds[i, j, q] = volume[q] * second[i, j]
    if level == 0:
        return float(energy)
    if kept_share < 1.0:
        _less_negative(seconds, shears, kept_share, f, work)
    along, weighted, blocks = np.empty((nodes, 3, 8)), np.empty((6 * nodes, 3, 8)), np.empty((nodes, 6 * nodes))
    _principal_gradients(gradients, material, along)
    _pulled(pull, spatial, along, volume, force)
    for m in range(len(held_mpa)):
        _pulled(swell, spatial, along, volume * fields[m], swelling[m])
    moduli = np.empty((6, 3, 3, 8))
    _moduli(seconds, shears, spatial, moduli)
    _weigh(moduli, along, weighted)
    np.dot(along.reshape(nodes, 24), weighted.reshape(6 * nodes, 24).T, blocks)
    _by_unknowns(blocks, tangent)
    _add_held(bulk, held_mpa, volume_strain, swelling, force, tangent)
    return float(energy)


@compiled
def _invert_in_place(a: FloatArray) -> None:
    """Invert a symmetric matrix by Gauss and Jordan, without pivoting."""
    size = len(a)
    for p in range(size):
        pivot = 1.0 / a[p, p]
        a[p, p] = 1.0
        for s in range(size):
            a[p, s] *= pivot
        for r in range(size):
            if r != p:
                factor = a[r, p]
                a[r, p] = 0.0
                for s in range(size):
                    a[r, s] -= factor * a[p, s]


@compiled
def _condense(
    whole: FloatArray, whole_force: FloatArray, work: FloatArray, solved: FloatArray, out: FloatArray
) -> None:
    """Eliminate the nine incompatible modes: out[:24] = [K, f] = [K_uu, f_u] - K_ua K_aa^-1 [K_au, f_a].

    `solved` (9, 25) receives K_aa^-1 [K_au, f_a]; `work` is (9, 25).
    """
    inverse, right = np.empty((9, 9)), work
    inverse[:] = whole[24:, 24:]
    right[:, :24] = whole[24:, :24]
    right[:, 24] = whole_force[24:]
    _invert_in_place(inverse)
    np.dot(inverse, right, solved)
    np.dot(right.T, solved, out)
    for r in range(24):
        for s in range(24):
            out[r, s] = whole[r, s] - out[r, s]
        out[r, 24] = whole_force[r] - out[r, 24]


@compiled
def _gather(
    x: FloatArray, u: FloatArray, corners: NDArray[np.int64], modes: FloatArray, rest: FloatArray, out: FloatArray
) -> None:
    """Fill an element's nodes at rest (8, 3), and their displacements with its modes behind them (8 or 11, 3)."""
    for i in range(3):
        for a in range(8):
            rest[a, i], out[a, i] = x[corners[a], i], u[corners[a], i]
        for m in range(len(modes)):
            out[8 + m, i] = modes[m, i]


@compiled
def many_hexahedra(
    x: FloatArray,
    u: FloatArray,
    corners: NDArray[np.int64],
    modes: FloatArray,
    law: int,
    parameters: FloatArray,
    held_mpa: FloatArray,
    level: int,
    kept_share: float,
    energy: FloatArray,
    force: FloatArray,
    tangent: FloatArray,
    solved: FloatArray,
    mode_force: FloatArray,
    swelling: FloatArray,
    volume_strain: FloatArray,
) -> None:
    """Fill energies (m,), forces (m, 24) and tangents (m, 24, 24) of hexahedra (m, 8) of a mesh.

    With `modes` of shape (m, 3, 3) the elements have incompatible modes, which are eliminated: `solved` (m, 9, 25) and
    `mode_force` (m, 9) are filled; with modes of shape (m, 0, 3) they use the mean dilatation. The pressures `held_mpa`
    (m, p), `swelling` (m, p, 24 or 33) and `volume_strain` (m, p, 2) are those of :func:`hexahedron`.
    """
    extra = modes.shape[1]
    nodes = 8 + extra
    here, displacement = np.empty((8, 3)), np.empty((nodes, 3))
    work, condensed = np.empty((9, 25)), np.empty((25, 25))
    whole_force, whole = np.empty(3 * nodes), np.empty((3 * nodes, 3 * nodes))
    for e in range(len(corners)):
        _gather(x, u, corners[e], modes[e], here, displacement)
        energy[e] = hexahedron(
            here,
            displacement,
            law,
            parameters[GIVEN_OF_ELEMENT * e :] if law == GIVEN else parameters,
            extra == 0,
            held_mpa[e],
            level,
            kept_share,
            whole_force,
            whole,
            swelling[e],
            volume_strain[e],
        )
        if level == 0 or not energy[e] < math.inf:
            continue
        if extra == 0:
            force[e] = whole_force
            tangent[e] = whole
            continue
        mode_force[e] = whole_force[24:]
        _condense(whole, whole_force, work, solved[e], condensed)
        force[e] = condensed[:24, 24]
        tangent[e] = condensed[:24, :24]


@compiled
def many_stretches(
    x: FloatArray, u: FloatArray, corners: NDArray[np.int64], modes: FloatArray, stretches: FloatArray
) -> None:
    """Fill the principal stretches (m, 8, 3) at the points of hexahedra (m, 8), as :func:`hexahedron` finds them.

    Of an element that is inside out, at rest or now, they are 1: its energy is infinite whatever they are.
    """
    nodes = 8 + modes.shape[1]
    here, displacement = np.empty((8, 3)), np.empty((nodes, 3))
    gradients, volume, f, jacobians = np.empty((nodes, 3, 8)), np.empty(8), np.empty((3, 3, 8)), np.empty(8)
    material, spatial, work = np.empty((3, 3, 8)), np.empty((3, 3, 8)), np.empty((3, 3, 8))
    for e in range(len(corners)):
        _gather(x, u, corners[e], modes[e], here, displacement)
        stretches[e] = 1.0
        if reference_gradients(here, gradients, volume) and _deformations(gradients, displacement, f, jacobians):
            _principal_frames(f, stretches[e], material, spatial, work)
