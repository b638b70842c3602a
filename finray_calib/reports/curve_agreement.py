"""How well a fitted emission curve agrees with the true one, over the whole curve and not only its peak."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import SpectralCurve
from data_schemas.fit import PaintCalibration

Floats = NDArray[np.float64]

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
    """

    error_rel: float
    coverage_95_rel: float


def curve_agreement(fit: PaintCalibration, truth: SpectralCurve) -> CurveAgreement:
    """Compare the reported emission with the truth on a 1 nm grid inside the range of both curves."""
    curves = (fit.emission_per_nm, fit.emission_low95_per_nm, fit.emission_high95_per_nm)
    return _agreement(fit.wavelength_nm, curves, truth)


def paper_agreement(fit: PaintCalibration, truth: SpectralCurve) -> CurveAgreement:
    """Compare the paper's curve without discrepancy, the last of the families, in the same way."""
    curves = (fit.family_emission_per_nm[-1], fit.family_low95_per_nm[-1], fit.family_high95_per_nm[-1])
    return _agreement(fit.wavelength_nm, curves, truth)


def _agreement(wavelength_nm: Floats, curves: tuple[Floats, Floats, Floats], truth: SpectralCurve) -> CurveAgreement:
    """Compare a mean curve and its lower and upper 95 % limits with the truth."""
    low_nm = max(COMPARED_NM[0], truth.wavelength_nm[0], wavelength_nm[0])
    high_nm = min(COMPARED_NM[1], truth.wavelength_nm[-1], wavelength_nm[-1])
    grid_nm = np.arange(np.ceil(low_nm), high_nm + STEP_NM / 2, STEP_NM)
    true = truth(grid_nm)
    mean, low, high = (np.interp(grid_nm, wavelength_nm, curve) for curve in curves)
    seen = true > SEEN_SHARE_OF_PEAK * true.max()
    covered = (low <= true) & (true <= high)
    return CurveAgreement(
        error_rel=float(np.linalg.norm(mean - true) / np.linalg.norm(true)),
        coverage_95_rel=float(covered[seen].mean()),
    )
