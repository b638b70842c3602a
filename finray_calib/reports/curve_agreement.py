"""How well a fitted emission curve agrees with the true one, over the whole curve and not only its peak."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from finray_calib.reports.demo_results import PaintResult

COMPARED_NM = (470.0, 720.0)
STEP_NM = 1.0
SEEN_SHARE_OF_PEAK = 0.05
"""Coverage is counted where the truth exceeds this share of its peak; below it any band covers zero."""


@dataclass(frozen=True, slots=True)
class CurveAgreement:
    """Fit against truth.

    Attributes
    ----------
    error_rel
        ||fit - truth|| / ||truth|| over 470 to 720 nm.
    coverage_95_rel
        Share of the wavelengths where the truth exceeds 5 % of its peak at which the 95 % band holds it. Points
        along one curve err together: for one good fit this share can be far from 0.95.
    chi_square_p
        Probability of a chi-square at least as large as the fit's over all bands, if the model were right; None
        without degrees of freedom.
    """

    error_rel: float
    coverage_95_rel: float
    chi_square_p: float | None


def curve_agreement(paint: PaintResult) -> CurveAgreement:
    """Compare the fitted emission with the truth on a 1 nm grid inside the range of both curves."""
    calibration, truth = paint.calibration, paint.truth.emission
    low_nm = max(COMPARED_NM[0], truth.wavelength_nm[0], calibration.wavelength_nm[0])
    high_nm = min(COMPARED_NM[1], truth.wavelength_nm[-1], calibration.wavelength_nm[-1])
    grid_nm = np.arange(np.ceil(low_nm), high_nm + STEP_NM / 2, STEP_NM)
    true = truth(grid_nm)
    fit, low, high = (
        np.interp(grid_nm, calibration.wavelength_nm, curve)
        for curve in (
            calibration.emission_per_nm,
            calibration.emission_low95_per_nm,
            calibration.emission_high95_per_nm,
        )
    )
    freedom = calibration.degrees_of_freedom
    seen = true > SEEN_SHARE_OF_PEAK * true.max()
    covered = (low <= true) & (true <= high)
    return CurveAgreement(
        error_rel=float(np.linalg.norm(fit - true) / np.linalg.norm(true)),
        coverage_95_rel=float(covered[seen].mean()),
        chi_square_p=float(chi2.sf(calibration.chi_square, freedom)) if freedom > 0 else None,
    )
