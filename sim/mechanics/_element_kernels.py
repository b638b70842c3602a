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

The eigenvalues of the eight points are found side by side, in the last axis of arrays (..., 8), by vector instructions.
The compiler makes these of loops whose length is told at run time (it unrolls others first), over rows of one local
array (those of others might overlap).

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
_SQRT_HALF = math.sqrt(0.5)
_FIRST = np.array([0, 0, 1])
_SECOND = np.array([1, 2, 2])


def shape_gradients(local: FloatArray) -> FloatArray:
    """Return dN_a / dxi_j of the trilinear hexahedron at local points (m, 3), shape (m, 8, 3)."""
    factors = 1.0 + CORNERS[None] * local[:, None]
    x, y, z = (factors[..., j] for j in range(3))
    return np.stack([CORNERS[:, 0] * y * z, CORNERS[:, 1] * x * z, CORNERS[:, 2] * x * y], -1) / 8.0


_AT_GAUSS = shape_gradients(GAUSS_POINTS)
_AT_CENTRE = shape_gradients(np.zeros((1, 3)))[0]


@compiled
def _inverse(a: FloatArray, out: FloatArray) -> float:
    """Invert a 3 x 3 matrix and return its determinant."""
    out[0, 0], out[1, 1] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1], a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    out[0, 1], out[1, 0] = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2], a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    out[0, 2], out[2, 0] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1], a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    out[1, 2], out[2, 1] = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2], a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]
    out[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    det = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    scale = 1.0 / det
    for i in range(3):
        for m in range(3):
            out[i, m] *= scale
    return float(det)


@compiled
def _turn(work: FloatArray, p: int, q: int, r: int, points: int) -> None:
    """Turn the axes p and q of :func:`_principal_axes` so that c_pq becomes zero, where it is not small."""
    for k in range(points):
        off = work[2 + p + q, k]
        small = off * off <= _ROTATION_END * abs(work[p, k] * work[q, k])
        angle = (work[q, k] - work[p, k]) / (2.0 * (1.0 if small else off))
        t = (1.0 if angle >= 0.0 else -1.0) / (abs(angle) + math.sqrt(angle * angle + 1.0))
        t = 0.0 if small else t
        cos = 1.0 / math.sqrt(t * t + 1.0)
        sin = t * cos
        work[p, k] -= t * off
        work[q, k] += t * off
        work[2 + p + q, k] = off if small else 0.0
        crp, crq = work[2 + r + p, k], work[2 + r + q, k]
        work[2 + r + p, k] = cos * crp - sin * crq
        work[2 + r + q, k] = sin * crp + cos * crq
        for i in range(6, 15, 3):
            vip, viq = work[i + p, k], work[i + q, k]
            work[i + p, k] = cos * vip - sin * viq
            work[i + q, k] = sin * vip + cos * viq


@compiled
def _principal_axes(c: FloatArray, axes: FloatArray, points: int) -> None:
    """Replace the diagonals of symmetric 3 x 3 matrices by the eigenvalues, and fill the eigenvectors, by Jacobi.

    A matrix is given by its entries 00, 11, 22, 01, 02, 12, in (6, 8); column j of the vectors is axes[j::3], (9, 8).
    """
    work = np.empty((15, 8))
    for i in range(6):
        for k in range(points):
            work[i, k] = c[i, k]
    for i in range(9):
        for k in range(points):
            work[6 + i, k] = 1.0 if i % 4 == 0 else 0.0
    for _ in range(12):
        left = 0.0
        for k in range(points):
            a, b, d = work[0, k], work[1, k], work[2, k]
            left += 1.0 if work[3, k] ** 2 > _ROTATION_END * abs(a * b) else 0.0
            left += 1.0 if work[4, k] ** 2 > _ROTATION_END * abs(a * d) else 0.0
            left += 1.0 if work[5, k] ** 2 > _ROTATION_END * abs(b * d) else 0.0
        if left == 0.0:
            break
        _turn(work, 0, 1, 2, points)
        _turn(work, 0, 2, 1, points)
        _turn(work, 1, 2, 0, points)
    for k in range(points):
        for i in range(3):
            c[i, k] = work[i, k]
        for i in range(9):
            axes[i, k] = work[6 + i, k]


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
    mean = (math.log(stretch[0]) + math.log(stretch[1]) + math.log(stretch[2])) / 3.0
    for p in range((len(parameters) - 1) // 2):
        mu, alpha = parameters[1 + 2 * p], parameters[2 + 2 * p]
        total = 0.0
        for i in range(3):
            curve[i] = math.expm1(alpha * (math.log(stretch[i]) - mean))
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
    pressure_mpa: float,
    bulk_mpa: float,
    jacobian: FloatArray,
    stretch: FloatArray,
    first: FloatArray,
    second: FloatArray,
) -> None:
    """Add the derivatives of a volumetric energy U(J) with U' = pressure and U'' = bulk."""
    j = jacobian[0]
    for i in range(3):
        first[i] += pressure_mpa * j / stretch[i]
        for k in range(3):
            second[i, k] += (bulk_mpa * j + pressure_mpa) * j / (stretch[i] * stretch[k])
        second[i, i] -= pressure_mpa * j / (stretch[i] * stretch[i])


@compiled
def _less_negative(second: FloatArray, kept_share: float) -> None:
    """Multiply the negative eigenvalues of a symmetric 3 x 3 matrix by the share that is kept of them."""
    w, v = np.empty((6, 8)), np.empty((9, 8))
    for k in range(3):
        w[k, 0], w[3 + k, 0] = second[k, k], second[_FIRST[k], _SECOND[k]]
    _principal_axes(w, v, 1)
    if w[0, 0] >= 0.0 and w[1, 0] >= 0.0 and w[2, 0] >= 0.0:
        return
    for i in range(3):
        for j in range(3):
            second[i, j] = 0.0
            for k in range(3):
                second[i, j] += max(w[k, 0], kept_share * w[k, 0]) * v[3 * i + k, 0] * v[3 * j + k, 0]


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
def reference_gradients(x: FloatArray, gradients: FloatArray, volume: FloatArray) -> bool:
    """Fill dN_a / dX (8 points, 8 nodes or 11 with incompatible modes, 3) and the volumes of the points in mm^3.

    The gradients of the three incompatible modes are det J0 / det J xi_m J0^-T e_m, whose integral vanishes on any
    hexahedron, so that the patch test is passed (R. L. Taylor, P. J. Beresford, E. L. Wilson, 1976; J. C. Simo,
    F. Armero, R. L. Taylor, 1993).

    Returns
    -------
    bool
        False where the hexahedron is inside out at a Gauss point.
    """
    jacobian, inverse, centre = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    jacobian[:] = 0.0
    for a in range(8):
        for i in range(3):
            for j in range(3):
                jacobian[i, j] += x[a, i] * _AT_CENTRE[a, j]
    det_centre = _inverse(jacobian, centre)
    for q in range(8):
        jacobian[:] = 0.0
        for a in range(8):
            for i in range(3):
                for j in range(3):
                    jacobian[i, j] += x[a, i] * _AT_GAUSS[q, a, j]
        det = _inverse(jacobian, inverse)
        if not det > 0.0:
            return False
        volume[q] = det
        for a in range(8):
            for i in range(3):
                g = _AT_GAUSS[q, a, 0] * inverse[0, i]
                gradients[q, a, i] = g + _AT_GAUSS[q, a, 1] * inverse[1, i] + _AT_GAUSS[q, a, 2] * inverse[2, i]
        for m in range(gradients.shape[1] - 8):
            for i in range(3):
                gradients[q, 8 + m, i] = det_centre / det * GAUSS_POINTS[q, m] * centre[m, i]
    return True


@compiled
def _deformation(gradients: FloatArray, displacement: FloatArray, f: FloatArray) -> float:
    """Fill F = 1 + sum_a u_a (x) grad N_a and return its determinant."""
    for i in range(3):
        for j in range(3):
            s = 1.0 if i == j else 0.0
            for a in range(gradients.shape[0]):
                s += displacement[a, i] * gradients[a, j]
            f[i, j] = s
    det = f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]) - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
    return float(det + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]))


@compiled
def _principal_frames(
    f: FloatArray, stretch: FloatArray, material: FloatArray, spatial: FloatArray, points: int
) -> None:
    """Fill stretches (8, 3) and the principal directions N (columns) and n = F N / lambda (columns), (8, 3, 3)."""
    c, axes = np.empty((6, 8)), np.empty((9, 8))
    for q in range(8):
        for m in range(3):
            i, k = _FIRST[m], _SECOND[m]
            c[m, q] = f[q, 0, m] * f[q, 0, m] + f[q, 1, m] * f[q, 1, m] + f[q, 2, m] * f[q, 2, m]
            c[3 + m, q] = f[q, 0, i] * f[q, 0, k] + f[q, 1, i] * f[q, 1, k] + f[q, 2, i] * f[q, 2, k]
    _principal_axes(c, axes, points)
    for q in range(8):
        for k in range(3):
            stretch[q, k] = math.sqrt(c[k, q])
            for i in range(3):
                material[q, i, k] = axes[3 * i + k, q]
                s = f[q, i, 0] * axes[k, q] + f[q, i, 1] * axes[3 + k, q] + f[q, i, 2] * axes[6 + k, q]
                spatial[q, i, k] = s / stretch[q, k]


@compiled
def _mode_rows(gradients: FloatArray, material: FloatArray, spatial: FloatArray, rows: FloatArray) -> None:
    """Fill the derivatives of the nine modes by the nodal displacements, shape (9, 3 nodes)."""
    for a in range(gradients.shape[0]):
        g0 = gradients[a, 0] * material[0, 0] + gradients[a, 1] * material[1, 0] + gradients[a, 2] * material[2, 0]
        g1 = gradients[a, 0] * material[0, 1] + gradients[a, 1] * material[1, 1] + gradients[a, 2] * material[2, 1]
        g2 = gradients[a, 0] * material[0, 2] + gradients[a, 1] * material[1, 2] + gradients[a, 2] * material[2, 2]
        for c in range(3):
            n0, n1, n2 = spatial[c, 0], spatial[c, 1], spatial[c, 2]
            r = 3 * a + c
            rows[0, r], rows[1, r], rows[2, r] = n0 * g0, n1 * g1, n2 * g2
            rows[3, r], rows[6, r] = _SQRT_HALF * (n0 * g1 + n1 * g0), _SQRT_HALF * (n0 * g1 - n1 * g0)
            rows[4, r], rows[7, r] = _SQRT_HALF * (n0 * g2 + n2 * g0), _SQRT_HALF * (n0 * g2 - n2 * g0)
            rows[5, r], rows[8, r] = _SQRT_HALF * (n1 * g2 + n2 * g1), _SQRT_HALF * (n1 * g2 - n2 * g1)


@compiled
def _weigh_rows(
    rows: FloatArray, volume_mm3: FloatArray, second: FloatArray, shear: FloatArray, out: FloatArray
) -> None:
    """Multiply the nine modes by their stiffness and the volume of the point."""
    dv = volume_mm3[0]
    for i in range(3):
        a, b, c = dv * second[i, 0], dv * second[i, 1], dv * second[i, 2]
        for r in range(rows.shape[1]):
            out[i, r] = a * rows[0, r] + b * rows[1, r] + c * rows[2, r]
    for k in range(6):
        s = dv * shear[k]
        for r in range(rows.shape[1]):
            out[3 + k, r] = s * rows[3 + k, r]


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
    gradients, volume, f, jacobians = np.empty((8, nodes, 3)), np.empty(8), np.empty((8, 3, 3)), np.empty(8)
    if not reference_gradients(x, gradients, volume):
        return math.inf
    deformed = 0.0
    for q in range(8):
        jacobians[q] = _deformation(gradients[q], displacement, f[q])
        if not jacobians[q] > 0.0:
            return math.inf
        deformed += volume[q] * jacobians[q]
    total = volume.sum()
    bulk = parameters[0]
    shared = bulk * (deformed / total - 1.0)
    energy = 0.5 * shared * (deformed - total) if mean_dilatation else 0.0
    if mean_dilatation:
        volume_strain[0, 0], volume_strain[0, 1] = total, deformed / total - 1.0
    first, second, shear, curve = np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(3)
    material, spatial, stretches, fields = np.empty((8, 3, 3)), np.empty((8, 3, 3)), np.empty((8, 3)), np.empty((4, 8))
    rows, weighted, dilation = np.empty((72, 3 * nodes)), np.empty((72, 3 * nodes)), np.zeros(3 * nodes)
    linear = not mean_dilatation and len(held_mpa) > 0
    if linear:
        energy += _linear_volumes(bulk, volume, jacobians, fields, volume_strain)
    if linear and level > 0:
        swelling[:] = 0.0
    force[:] = 0.0
    _principal_frames(f, stretches, material, spatial, len(x))
    for q in range(8):
        stretch = stretches[q]
        row = parameters[GIVEN_OF_POINT * q :] if law == GIVEN else parameters
        energy += volume[q] * stretch_energy(law, row, stretch, first, second, curve)
        if bulk > 0.0:
            own = bulk * (jacobians[q] - 1.0)
            if mean_dilatation:
                _add_volumetric(held_mpa[0], 0.0, jacobians[q:], stretch, first, second)
            elif linear:
                pressure = 0.0
                for m in range(4):
                    pressure += held_mpa[m] * fields[m, q]
                _add_volumetric(pressure, 0.0, jacobians[q:], stretch, first, second)
            else:
                energy += 0.5 * own * (jacobians[q] - 1.0) * volume[q]
                _add_volumetric(own, bulk, jacobians[q:], stretch, first, second)
        if level == 0:
            continue
        here = rows[9 * q : 9 * q + 9]
        _mode_rows(gradients[q], material[q], spatial[q], here)
        for i in range(3):
            pull, swell = volume[q] * first[i], volume[q] * jacobians[q] / stretch[i]
            for r in range(3 * nodes):
                force[r] += pull * here[i, r]
                dilation[r] += swell * here[i, r]
        if linear:
            for m in range(4):
                for r in range(3 * nodes):
                    swelling[m, r] += fields[m, q] * dilation[r]
            dilation[:] = 0.0
        _shear_modes(stretch, first, second, shear)
        if kept_share < 1.0:
            _less_negative(second, kept_share)
            for k in range(6):
                shear[k] = max(shear[k], kept_share * shear[k])
        _weigh_rows(here, volume[q:], second, shear, weighted[9 * q : 9 * q + 9])
    if level > 0:
        np.dot(rows.T, weighted, tangent)
        if mean_dilatation:
            swelling[0] = dilation
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
        for a in range(8):
            for i in range(3):
                here[a, i] = x[corners[e, a], i]
                displacement[a, i] = u[corners[e, a], i]
        for m in range(extra):
            for i in range(3):
                displacement[8 + m, i] = modes[e, m, i]
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
    gradients, volume, f = np.empty((8, nodes, 3)), np.empty(8), np.empty((8, 3, 3))
    material, spatial = np.empty((8, 3, 3)), np.empty((8, 3, 3))
    for e in range(len(corners)):
        for a in range(8):
            for i in range(3):
                here[a, i] = x[corners[e, a], i]
                displacement[a, i] = u[corners[e, a], i]
        for a in range(8, nodes):
            for i in range(3):
                displacement[a, i] = modes[e, a - 8, i]
        stretches[e] = 1.0
        if not reference_gradients(here, gradients, volume):
            continue
        right_way_out = 0
        for q in range(8):
            right_way_out += _deformation(gradients[q], displacement, f[q]) > 0.0
        if right_way_out == 8:
            _principal_frames(f, stretches[e], material, spatial, len(here))
