"""Materials of the finger: hyperelastic (Ogden, neo-Hooke), linear elastic, or of another package; their stability.

The paper prints its Ogden energy as sum mu_p/alpha_p (lambda_1^alpha_p + ...), but with its constants that gives a
negative initial shear modulus (-0.617 MPa). Here, as in Abaqus and CalculiX, the energy is
sum 2 mu_p/alpha_p^2 (...), with which the same table gives mu_0 = 7.918 MPa. For constants that belong to the printed
form use :func:`ogden_from_printed_form`.
"""

import math
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    MATERIALS,
    BulkOverShear,
    ElasticSolid,
    NeoHookeSolid,
    OgdenSolid,
    PlugIn,
    PoissonRatio,
    Rubber,
    SimulateError,
    numbers_of,
)
from sim.mechanics._element_kernels import GIVEN, GIVEN_OF_ELEMENT, OGDEN, ST_VENANT_KIRCHHOFF

FloatArray = NDArray[np.float64]

_STRETCHES = 200  # of the stability check: more change no verdict by over 1 % of the stretch


@dataclass(frozen=True, slots=True)
class Ogden:
    """Nearly incompressible Ogden material.

    psi = sum_p 2 mu_p/alpha_p^2 (sum_i (J^-1/3 lambda_i)^alpha_p - 3) + K/2 (J - 1)^2, initial shear modulus
    mu_0 = sum_p mu_p and K = (K/mu_0) mu_0.

    Parameters
    ----------
    mu_mpa, alpha
        Constants of each term.
    bulk_over_shear
        K/mu_0; the paper does not give it. 20 is a Poisson's ratio of 0.475.
    """

    mu_mpa: tuple[float, ...]
    alpha: tuple[float, ...]
    bulk_over_shear: BulkOverShear = 20.0

    def __post_init__(self) -> None:
        values = (*self.mu_mpa, *self.alpha, self.bulk_over_shear)
        if not self.mu_mpa or len(self.mu_mpa) != len(self.alpha) or not all(math.isfinite(v) for v in values):
            raise SimulateError(
                "an Ogden material needs as many finite alpha as mu_mpa and at least one of each, got mu_mpa = "
                f"{self.mu_mpa} and alpha = {self.alpha}"
            )
        if 0.0 in self.alpha:
            raise SimulateError("an Ogden material's alpha must not be 0; leave out terms with alpha = 0")
        if self.shear_modulus_mpa <= 0.0:
            raise SimulateError(
                f"the initial shear modulus by the Ogden constants must be positive, got {self.shear_modulus_mpa:.4g} "
                "MPa; if the constants have the form mu/alpha, convert them with ogden_from_printed_form"
            )
        if not 2.0 / 3.0 < self.bulk_over_shear <= 1e5:
            raise SimulateError(
                f"bulk_over_shear must be above 2/3 (Poisson's ratio 0) and at most 1e5, got {self.bulk_over_shear:g}"
            )

    @property
    def shear_modulus_mpa(self) -> float:
        """Initial shear modulus mu_0."""
        return sum(self.mu_mpa)

    @property
    def bulk_modulus_mpa(self) -> float:
        """Bulk modulus K."""
        return self.bulk_over_shear * self.shear_modulus_mpa

    @property
    def youngs_modulus_mpa(self) -> float:
        """Initial Young's modulus 9 K mu / (3 K + mu)."""
        k, mu = self.bulk_modulus_mpa, self.shear_modulus_mpa
        return 9.0 * k * mu / (3.0 * k + mu)

    @property
    def law(self) -> int:
        """Number of the law in the compiled elements."""
        return OGDEN

    @property
    def parameters(self) -> FloatArray:
        """Row of the compiled elements: K, mu_1, alpha_1, ... in MPa."""
        pairs = [value for pair in zip(self.mu_mpa, self.alpha, strict=True) for value in pair]
        return np.array([self.bulk_modulus_mpa, *pairs])


def neo_hooke(c10_mpa: float, bulk_over_shear: BulkOverShear = 20.0) -> Ogden:
    """Return the neo-Hookean material C10 (I1 - 3): one Ogden term with mu = 2 C10 and alpha = 2."""
    return Ogden((2.0 * c10_mpa,), (2.0,), bulk_over_shear)


def ogden_from_printed_form(
    mu_mpa: tuple[float, ...], alpha: tuple[float, ...], bulk_over_shear: BulkOverShear = 20.0
) -> Ogden:
    """Convert constants of psi = sum mu_p/alpha_p (...) to this module's form: mu -> mu alpha / 2."""
    return Ogden(tuple(m * a / 2.0 for m, a in zip(mu_mpa, alpha, strict=True)), alpha, bulk_over_shear)


@dataclass(frozen=True, slots=True)
class LinearElastic:
    """Linear elastic material at small strain and any rotation (St. Venant-Kirchhoff).

    psi = lambda/2 (tr E)^2 + mu E : E with the Green-Lagrange strain E. It softens under strong compression (tangent
    modulus lost at a stretch of 1/sqrt 3): for stiff parts only.
    """

    youngs_modulus_mpa: float
    poisson_ratio: PoissonRatio

    def __post_init__(self) -> None:
        if not (math.isfinite(self.youngs_modulus_mpa) and self.youngs_modulus_mpa > 0.0):
            raise SimulateError(f"a Young's modulus must be finite and above 0 MPa, got {self.youngs_modulus_mpa}")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise SimulateError(f"a Poisson's ratio must be above -1 and below 0.5, got {self.poisson_ratio}")

    @property
    def shear_modulus_mpa(self) -> float:
        """Shear modulus E / (2 + 2 nu)."""
        return self.youngs_modulus_mpa / (2.0 + 2.0 * self.poisson_ratio)

    @property
    def bulk_modulus_mpa(self) -> float:
        """Bulk modulus E / (3 - 6 nu)."""
        return self.youngs_modulus_mpa / (3.0 - 6.0 * self.poisson_ratio)

    @property
    def law(self) -> int:
        """Number of the law in the compiled elements."""
        return ST_VENANT_KIRCHHOFF

    @property
    def parameters(self) -> FloatArray:
        """Row of the compiled elements: 0, lambda, mu in MPa."""
        mu = self.shear_modulus_mpa
        return np.array([0.0, self.bulk_modulus_mpa - 2.0 / 3.0 * mu, mu])


class MaterialLaw(Protocol):
    """What the module of a material has: the strain energy of an isotropic rubber that keeps its volume.

    The elements evaluate it at the stretches without their change of volume, J^-1/3 lambda_i, and add K/2 (J - 1)^2
    themselves, so that any energy W(lambda_1, lambda_2, lambda_3) may be given, also one for incompressible rubber.
    """

    def energy_mpa(self, stretches: FloatArray, **parameters: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return W, its gradient and its second derivative by the stretches.

        Called for many points together and, with threads, for several parts of the mesh at once: it must keep nothing.

        Parameters
        ----------
        stretches
            Principal stretches (n, 3), above 0.
        **parameters
            Of the design's ``mechanics.gel.parameters`` or ``mechanics.skeleton.parameters``.

        Returns
        -------
        tuple
            W (n,), dW/dlambda_i (n, 3) and d2W/dlambda_i dlambda_j (n, 3, 3), in MPa; W is 0 at rest, and does not
            depend on the order of the stretches.
        """
        ...


class PackagedMaterial:
    r"""Nearly incompressible material whose law another package brings.

    .. math:: \psi = W(\bar\lambda_1, \bar\lambda_2, \bar\lambda_3) + \frac K2 (J - 1)^2, \qquad
        \bar\lambda_i = J^{-1/3} \lambda_i

    Parameters
    ----------
    plug_in
        Who brings it.
    module
        Its functions.
    parameters
        Of the law.
    bulk_over_shear
        K/mu_0, with mu_0 = (W_1 + W_11 - W_12) / 2 at rest.

    Raises
    ------
    SimulateError
        The law does not keep its contract: see :func:`check_material_law`.
    """

    law = GIVEN

    def __init__(
        self, plug_in: PlugIn, module: MaterialLaw, parameters: dict[str, float], bulk_over_shear: BulkOverShear
    ) -> None:
        self._plug_in, self._energy, self._given = plug_in, module.energy_mpa, dict(parameters)
        plug_in.check_parameters(self._energy, parameters, 1)
        _, first, second = self._at(np.ones((1, 3)))
        self.shear_modulus_mpa = float(first[0, 0] + second[0, 0, 0] - second[0, 0, 1]) / 2.0
        if not self.shear_modulus_mpa > 0.0:
            raise SimulateError(
                f"the initial shear modulus of {self.name} must be positive, got {self.shear_modulus_mpa:.4g} MPa; "
                "correct the parameters"
            )
        self.bulk_modulus_mpa = bulk_over_shear * self.shear_modulus_mpa
        self.parameters = np.array([self.bulk_modulus_mpa])
        _check_derivatives(self._at, plug_in, self.shear_modulus_mpa)

    @property
    def youngs_modulus_mpa(self) -> float:
        """Initial Young's modulus 9 K mu / (3 K + mu)."""
        k, mu = self.bulk_modulus_mpa, self.shear_modulus_mpa
        return 9.0 * k * mu / (3.0 * k + mu)

    @property
    def name(self) -> str:
        """What it is, with its constants."""
        constants = ", ".join(f"{name} = {value:g}" for name, value in self._given.items())
        return f"{self._plug_in.label} ({constants or 'no parameters'})"

    def _at(self, stretches: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return W and its derivatives as the package gives them, checked for their shape."""
        given: Any = self._plug_in.call(lambda: self._energy(stretches, **self._given))
        if not isinstance(given, tuple) or len(given) != 3:
            raise self._plug_in.refusal(
                "must return a tuple of energy, gradient and second derivative from energy_mpa, but does not"
            )
        n = len(stretches)
        names = (("the energy", (n,)), ("its gradient", (n, 3)), ("its second derivative", (n, 3, 3)))
        energy, first, second = (
            numbers_of(self._plug_in, name, value, shape) for (name, shape), value in zip(names, given, strict=True)
        )
        return energy, first, second

    def log_derivatives(self, logs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        r"""Return psi without its volumetric part, and its derivatives by the logarithms (n, 3) of the stretches.

        P g and P H P, with g_i = W_i lambda_i, H_ij = W_ij lambda_i lambda_j + delta_ij g_i and P = 1 - 1/3 without
        the change of volume.
        """
        keep = np.eye(3) - 1.0 / 3.0
        bar = np.exp(logs @ keep)
        energy, first, second = self._at(bar)
        slope = bar * first
        curve = second * bar[:, :, None] * bar[:, None, :] + np.eye(3) * slope[:, None, :]
        return energy, slope @ keep, keep @ curve @ keep

    def rows(self, stretches: FloatArray) -> FloatArray:
        """Return rows of compiled elements with stretches (m, 8, 3), one after the other: K, and psi, psi_i, psi_ij."""
        flat = stretches.reshape(-1, 3)
        energy, slope, curve = self.log_derivatives(np.log(flat))
        first = slope / flat
        second = (curve - np.eye(3) * slope[:, None, :]) / (flat[:, :, None] * flat[:, None, :])
        out = np.empty((len(stretches), GIVEN_OF_ELEMENT))
        out[:, 0] = self.bulk_modulus_mpa
        points = np.concatenate([energy[:, None], first, second.reshape(-1, 9)], axis=1)
        out[:, 1:] = points.reshape(len(stretches), -1)
        return out.ravel()


_STATES = 200  # of the check, over stretches that keep the volume
_STEP = 1e-6  # relative: central differences then miss by 1e-9 of the modulus
_MISS_REL = 1e-5  # of the modulus, at stretches of 1/2 to 2


def _check_derivatives(at: Any, plug_in: PlugIn, shear_mpa: float) -> None:
    """Refuse an energy whose gradient and second derivative are not its own, or that depends on the order."""
    logs = np.random.default_rng(0).uniform(-math.log(2.0), math.log(2.0), (_STATES, 3))
    stretch = np.exp(logs - logs.mean(axis=1, keepdims=True))
    energy, first, second = at(stretch)
    rest = float(at(np.ones((1, 3)))[0][0])
    scale = shear_mpa * np.maximum(1.0, np.abs(second).max(axis=(1, 2)) / shear_mpa)
    by_energy, by_gradient = np.empty_like(first), np.empty_like(second)
    for i in range(3):
        step = np.zeros(3)
        step[i] = _STEP
        high, low = at(stretch + step), at(stretch - step)
        by_energy[:, i] = (high[0] - low[0]) / (2.0 * _STEP)
        by_gradient[:, :, i] = (high[1] - low[1]) / (2.0 * _STEP)
    turned = [np.abs(at(stretch[:, list(order)])[0] - energy) for order in permutations(range(3))]
    faults = (
        ("an energy at rest that is not 0 MPa", np.full(_STATES, abs(rest))),
        ("a gradient that does not belong to the energy", np.abs(by_energy - first).max(axis=1)),
        ("a second derivative that is not symmetric", np.abs(second - second.transpose(0, 2, 1)).max(axis=(1, 2))),
        ("a second derivative that does not belong to the gradient", np.abs(by_gradient - second).max(axis=(1, 2))),
        ("an energy that depends on the order of the stretches", np.max(turned, axis=0)),
    )
    for fault, off in faults:
        worst = int(np.argmax(off / scale))
        if off[worst] > _MISS_REL * scale[worst]:
            shown = ", ".join(f"{value:.3f}" for value in stretch[worst])
            raise plug_in.refusal(f"gives {fault}: off by {off[worst]:.3g} MPa at the stretches {shown}")


def check_material_law(law: MaterialLaw, **parameters: float) -> None:
    """Check that a material keeps its contract, as a press does that uses it: for the tests of its package.

    Its energy is finite and 0 at rest, the gradient is the energy's and the second derivative the gradient's, at 200
    states of stretches 1/2 to 2 that keep the volume; it is symmetric, does not depend on the order of the stretches,
    and is stable (Drucker) in uniaxial, planar and equibiaxial load from 0.4 to 2.5.

    Parameters
    ----------
    law
        The module, or an object with its functions.
    **parameters
        As the design gives them.

    Raises
    ------
    SimulateError
        It does not; the message says what is wrong, and where.
    """
    plug_in = PlugIn(MATERIALS, getattr(law, "__name__", type(law).__name__), "")
    check_stability(PackagedMaterial(plug_in, law, parameters, 20.0))


Material = Ogden | LinearElastic | PackagedMaterial


def material_of(solid: Rubber | ElasticSolid, field: str = "") -> Material:
    """Return the engine's material of a solid of the design, which stands in a field of it.

    Raises
    ------
    SimulateError
        Its constants, or the law that another package brings, make it unstable; or the package is not installed, of
        another version, or fails.
    """
    if isinstance(solid, ElasticSolid):
        return LinearElastic(solid.youngs_modulus_mpa, solid.poisson_ratio)
    try:
        rubber = _rubber_of(solid)
        if not isinstance(solid, NeoHookeSolid) or solid.law is not None:
            check_stability(rubber)
    except SimulateError as fault:
        raise SimulateError(f"{field}: {fault}" if field else str(fault)) from fault
    return rubber


def _rubber_of(solid: Rubber) -> "Ogden | PackagedMaterial":
    """Return the engine's material of a rubber."""
    if solid.law is not None:
        plug_in = solid.plug_in()
        law: Any = plug_in.load()
        return PackagedMaterial(plug_in, law, solid.parameters, getattr(solid, "bulk_over_shear", 20.0))
    if isinstance(solid, NeoHookeSolid):
        return neo_hooke(solid.c10_mpa, solid.bulk_over_shear)
    if isinstance(solid, OgdenSolid):
        return Ogden(solid.mu_mpa, solid.alpha, solid.bulk_over_shear)
    raise SimulateError(f"a {type(solid).__name__} is not a material of the engine")


def _log_hessians(material: "Ogden | PackagedMaterial", logs: FloatArray) -> FloatArray:
    """Return the Hessians (n, 3, 3) of the incompressible energy by the logarithms (3, n) of the stretches."""
    if isinstance(material, PackagedMaterial):
        return material.log_derivatives(logs.T)[2]
    terms = zip(material.mu_mpa, material.alpha, strict=True)
    curve = sum((2.0 * m * np.exp(a * logs) for m, a in terms), np.zeros_like(logs))
    return np.asarray(np.eye(3) * curve.T[:, None, :])


_FREE = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]])  # logarithms of the first two stretches, volume kept


def check_stability(material: "Ogden | PackagedMaterial", stretches: tuple[float, float] = (0.4, 2.5)) -> None:
    """Check Drucker's stability of the incompressible material in uniaxial, planar and equibiaxial load.

    Over the range, the Hessian of psi(l1, l2, 1/(l1 l2)) by the logarithms of l1 and l2 must be positive definite.

    Raises
    ------
    SimulateError
        Naming the mode of loading and the stretch nearest to 1 at which stability is lost.
    """
    log_stretch = np.linspace(math.log(stretches[0]), math.log(stretches[1]), _STRETCHES)
    for name, second in (("uniaxial", -0.5), ("planar", 0.0), ("equibiaxial", 1.0)):
        logs = np.stack([log_stretch, second * log_stretch, -(1.0 + second) * log_stretch])
        hessians = _FREE @ _log_hessians(material, logs) @ _FREE.T
        unstable = (hessians[:, 0, 0] <= 0.0) | (np.linalg.det(hessians) <= 0.0)
        if unstable.any():
            at = math.exp(min(log_stretch[unstable], key=abs))
            if isinstance(material, Ogden):
                known = f"material mu_mpa = {material.mu_mpa}, alpha = {material.alpha}"
                convention = " and their convention (see ogden_from_printed_form)"
            else:
                known, convention = material.name, ""
            raise SimulateError(
                f"the {known} is unstable (Drucker) under {name} load at a stretch of {at:.3g}, but must be stable "
                f"from {stretches[0]:g} to {stretches[1]:g}. Check the signs of the constants{convention}"
            )
