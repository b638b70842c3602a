"""Materials of the finger: hyperelastic (Ogden, neo-Hooke) and linear elastic, with conversions and a stability check.

The paper prints its Ogden energy as sum mu_p/alpha_p (lambda_1^alpha_p + ...), but with its constants that gives a
negative initial shear modulus (-0.617 MPa). Here, as in Abaqus and CalculiX, the energy is
sum 2 mu_p/alpha_p^2 (...), with which the same table gives mu_0 = 7.918 MPa. For constants that belong to the printed
form use :func:`ogden_from_printed_form`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import BulkOverShear, PoissonRatio, SimulateError
from sim.mechanics._element_kernels import OGDEN, ST_VENANT_KIRCHHOFF

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
                f"an Ogden material needs as many finite alpha as mu_mpa, got {self.mu_mpa} and {self.alpha}"
            )
        if 0.0 in self.alpha:
            raise SimulateError("an Ogden material's alpha must not be 0; leave such a term out")
        if self.shear_modulus_mpa <= 0.0:
            raise SimulateError(
                f"the Ogden constants give an initial shear modulus of {self.shear_modulus_mpa:.4g} MPa, which must be "
                "positive; are they of the form mu/alpha? Then convert them with ogden_from_printed_form"
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
            raise SimulateError(f"a Young's modulus must be above 0 MPa, got {self.youngs_modulus_mpa}")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise SimulateError(f"a Poisson's ratio must lie between -1 and 0.5, got {self.poisson_ratio}")

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


Material = Ogden | LinearElastic


def check_stability(material: Ogden, stretches: tuple[float, float] = (0.4, 2.5)) -> None:
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
        curve = sum(
            (2.0 * m * np.exp(a * logs) for m, a in zip(material.mu_mpa, material.alpha, strict=True)),
            np.zeros_like(logs),
        )
        unstable = (curve[0] + curve[2] <= 0.0) | ((curve[0] + curve[2]) * (curve[1] + curve[2]) - curve[2] ** 2 <= 0.0)
        if unstable.any():
            at = math.exp(min(log_stretch[unstable], key=abs))
            raise SimulateError(
                f"the material mu_mpa = {material.mu_mpa}, alpha = {material.alpha} is unstable (Drucker) under "
                f"{name} load at a stretch of {at:.3g}; it must be stable from {stretches[0]:g} to {stretches[1]:g}. "
                "Check the signs of the constants and their convention (see ogden_from_printed_form)"
            )
