"""The four families of emission curves behind one interface."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.errors import FitError
from finray_calib.spectra.family_kernels import (
    GAUSSIAN_MIXTURE,
    LOG_NORMAL,
    SKEW_CAUCHY,
    SKEW_T,
    curves,
    shape_table,
)

FloatArray = NDArray[np.float64]

COMMON_PARAMETERS: Final = ("shape_mode_nm", "ln_shape_fwhm_nm", "ln_shape_peak_per_nm")
"""First parameters of every family; of the mixture they describe its first component."""


@dataclass(frozen=True, slots=True)
class ShapeParameter:
    """A parameter that only one family has: a normal prior, truncated.

    Attributes
    ----------
    name
        Name, dimensionless unless it ends in a unit.
    mean, sd
        Of the normal before truncation.
    low, high
        Truncation.
    meaning
        In words.
    """

    name: str
    mean: float
    sd: float
    low: float
    high: float
    meaning: str


@dataclass(frozen=True, slots=True)
class EmissionFamily:
    """A parametric family of emission curves.

    Attributes
    ----------
    name
        Name on the command line and in records.
    title
        Name in figures.
    code
        Number of the family in :mod:`finray_calib.spectra.family_kernels`.
    own
        The family's own parameters, after :data:`COMMON_PARAMETERS`.
    """

    name: str
    title: str
    code: int
    own: tuple[ShapeParameter, ...]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters in order."""
        return (*COMMON_PARAMETERS, *(p.name for p in self.own))

    def curves(self, theta: ArrayLike, wavelength_nm: ArrayLike) -> FloatArray:
        """Return the emission curves of parameter rows, nm^-1.

        Parameters
        ----------
        theta
            (n, >= D) parameters in the order of :attr:`parameter_names`; further columns are ignored.
        wavelength_nm
            (L,) wavelengths, nm.

        Returns
        -------
        numpy.ndarray
            (n, L), in the unit of the peak.
        """
        rows = np.ascontiguousarray(theta, dtype=np.float64)
        grid_nm = np.ascontiguousarray(wavelength_nm, dtype=np.float64).view()
        grid_nm.flags.writeable = False  # one signature, compiled once, for stored and for new grids
        return np.asarray(curves(self.code, rows, tables(), grid_nm))


_KAPPA = ShapeParameter("kappa", 0.0, 1.5, -6.0, 6.0, "asinh of the skewness omega; positive: red tail")
_LN_TAIL = ShapeParameter(
    "ln_tail", float(np.log(4.0)), 0.7, -0.5, 4.0, "logarithm of the degrees of freedom; 0 is the paper's curve"
)
_ASYMMETRY = ShapeParameter(
    "ln_asymmetry", 0.35, 0.2, -1.5, 1.5, "logarithm of red over blue half width in wavenumber; measured 0.30 to 0.47"
)
_SHIFT = ShapeParameter("shift_nm", 35.0, 20.0, 5.0, 120.0, "second component's centre minus the first's")
_WIDTH_RATIO = ShapeParameter("ln_width_ratio", 0.3, 0.3, -1.0, 1.5, "second width over the first's, logarithm")
_HEIGHT_RATIO = ShapeParameter("ln_height_ratio", -1.0, 0.8, -6.0, 1.5, "second height over the first's, logarithm")

FAMILIES: Final = {
    family.name: family
    for family in (
        EmissionFamily("zheng2014", "skew-Cauchy (the paper's)", SKEW_CAUCHY, (_KAPPA,)),
        EmissionFamily("skew_t", "skew-t", SKEW_T, (_KAPPA, _LN_TAIL)),
        EmissionFamily("log_normal_wavenumber", "log-normal in wavenumber", LOG_NORMAL, (_ASYMMETRY,)),
        EmissionFamily("gaussian_mixture", "two Gaussians", GAUSSIAN_MIXTURE, (_SHIFT, _WIDTH_RATIO, _HEIGHT_RATIO)),
    )
}


def family_named(name: str) -> EmissionFamily:
    """Return a family by its name.

    Raises
    ------
    FitError
        There is no such family.
    """
    if name not in FAMILIES:
        raise FitError(f"family: {name!r} is unknown; the families are {', '.join(FAMILIES)}")
    return FAMILIES[name]


@lru_cache(maxsize=1)
def tables() -> FloatArray:
    """Return the shape table of the skew families, read-only."""
    table = np.asarray(shape_table())
    table.flags.writeable = False
    return table
