"""The six sampled parameters of a paint and the band values they predict."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.spectra.skew_cauchy import from_mode_parameters, skew_cauchy

PARAMETER_NAMES: Final = ("mode_nm", "ln_fwhm_nm", "kappa", "ln_peak_per_nm", "ln_reflected_laser", "ln_blocking")
"""Order of the columns of every theta: kappa = asinh(skewness), the last two are ln rho and ln m."""

FloatArray = NDArray[np.float64]


def emission_curves(theta: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Return the emission curves f(l) of parameter rows.

    Parameters
    ----------
    theta
        (n, 6) parameters in the order of PARAMETER_NAMES.
    wavelength_nm
        (L,) wavelengths, nm.

    Returns
    -------
    numpy.ndarray
        (n, L) bispectral radiance factor per nm of emission, nm^-1.
    """
    paper = (column[:, None] for column in from_mode_parameters(*theta[:, :4].T))
    return skew_cauchy(wavelength_nm, *paper)
