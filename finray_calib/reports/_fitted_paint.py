"""One fitted paint as every report shows it: band signals, calibration, and the truth where it is known.

How well a fitted emission curve agrees with the true one, over the whole curve and not only its peak, and every number
of a fit's report as plain JSON types.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, Estimate, FamilyResult, PaintCalibration, SpectralCurve
from finray_calib.reports._plain_text import Json, estimate_json

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PaintTruth:
    """What the bench really held; the fitter never saw it.

    Attributes
    ----------
    emission
        Emission for light at the laser line, bispectral radiance factor per nm, nm^-1.
    mode_nm, fwhm_nm
        Wavelength of its maximum and full width at half maximum, nm.
    energy_yield
        Emitted over incident energy, 0 to 1.
    kind
        "simulated paint of the paper's family" or "measured material FILE".
    """

    emission: SpectralCurve
    mode_nm: float
    fwhm_nm: float
    energy_yield: float
    kind: str

    @property
    def is_measured(self) -> bool:
        """Whether the truth is a measured material rather than a curve of the paper's family."""
        return self.kind.startswith("measured")

    @property
    def word(self) -> str:
        """What the reports call it."""
        return "measured" if self.is_measured else "true"


@dataclass(frozen=True, slots=True)
class FittedPaint:
    """One paint with its fit.

    Attributes
    ----------
    bands
        What was fitted.
    fit
        The calibration.
    label
        What sets this paint apart from others on the page, such as "red paint"; empty where it is alone.
    truth
        What the fit should have found, where it is known.
    """

    bands: BandSignals
    fit: PaintCalibration
    label: str = ""
    truth: PaintTruth | None = None

    @property
    def subject(self) -> str:
        """What a sentence calls the paint."""
        return f"the {self.label or 'paint'}"

    def titled(self, text: str) -> str:
        """Return a caption that begins with the paint where there are several."""
        return f"{self.label.capitalize()}: {text}" if self.label else text[:1].upper() + text[1:]

    @property
    def rests_on_measured_spectra(self) -> bool:
        """Whether the reported spectrum is that of the learned prior, and no family's."""
        return self.fit.spectrum_from not in ("", self.fit.family_title)

    @property
    def chosen(self) -> FamilyResult:
        """The family that is reported, or whose parameters stand beside the spectrum."""
        return next(family for family in self.fit.families if family.name == self.fit.family)

    @property
    def competing(self) -> tuple[FamilyResult, ...]:
        """All families but the paper's curve alone, which stands last and competes for no probability."""
        return self.fit.families[:-1]

    @property
    def paper(self) -> FamilyResult:
        """The paper's curve without discrepancy."""
        return self.fit.families[-1]


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


def fit_summary(paint: FittedPaint) -> Json:
    """Return every number of one fit, beside the truth where it is known.

    Parameters
    ----------
    paint
        The fitted paint.

    Returns
    -------
    dict
        Fractions are 0 to 1; other units are the suffix of the key. Not finite numbers are not yet null.
    """
    fit = paint.fit
    by_filter = [band.name for band in fit.optics.filters]
    return {
        "paint_name": fit.paint_name,
        **_truth(paint),
        "spectrum_from": fit.spectrum_source,
        "prior_shares": {name: share.model_dump(mode="json") for name, share in fit.prior_shares.items()},
        "between_sessions": None if fit.between_sessions is None else fit.between_sessions.model_dump(mode="json"),
        "family": fit.family,
        "family_choice": fit.family_choice,
        "families": {family.name: _family(family) for family in paint.competing},
        "paper_curve_alone": _family(paint.paper),
        "discrepancy": fit.discrepancy.model_dump(mode="json"),
        "parameters": _estimates(fit.parameters),
        "paper": _estimates(fit.paper),
        "prior": dict(fit.prior),
        "prior_sensitivity": {name: shift.model_dump() for name, shift in fit.prior_sensitivity.items()},
        "chi_square": fit.chi_square,
        "usable_values": fit.usable_values,
        "chi_square_per_band": {band.filter_name: band.chi_square for band in fit.bands},
        "bands": [band.model_dump(mode="json") for band in fit.bands],
        "band_integrals_per_nm": _estimates(dict(zip(by_filter, fit.band_integrals, strict=True))),
        "band_signals": _band_signals(paint),
        "reflectance": _estimates(dict(zip(by_filter, fit.reflectance, strict=True))),
        "absorption": _absorption(paint),
        "diagnostics": fit.diagnostics.model_dump(mode="json"),
        "warnings": list(fit.warnings),
    }


def _truth(paint: FittedPaint) -> Json:
    """Return mode, width and yield, and how the curves agree with the truth where it is known."""
    fit, truth = paint.fit, paint.truth
    mode, width = fit.parameters["mode_nm"], fit.parameters["fwhm_nm"]
    if truth is None:
        return {
            "mode_nm": estimate_json(mode),
            "fwhm_nm": estimate_json(width),
            "energy_yield": estimate_json(fit.energy_yield),
        }
    agreement, paper = curve_agreement(fit, truth.emission), paper_agreement(fit, truth.emission)
    return {
        "truth_kind": truth.kind,
        "mode_nm": estimate_json(mode, truth.mode_nm),
        "fwhm_nm": estimate_json(width, truth.fwhm_nm),
        "energy_yield": estimate_json(fit.energy_yield, truth.energy_yield),
        "curve_error_rel": agreement.error_rel,
        "curve_coverage_95": agreement.coverage_95_rel,
        "paper_curve_error_rel": paper.error_rel,
        "paper_curve_coverage_95": paper.coverage_95_rel,
    }


def _family(family: FamilyResult) -> Json:
    """Return what one family makes of the bands."""
    scores = family.model_dump(mode="json", exclude={"name", "quantities"})
    return {**_estimates(family.quantities), **scores}


def _estimates(values: Mapping[str, Estimate]) -> Json:
    """Return estimates with their 95 % intervals."""
    return {name: estimate_json(value) for name, value in values.items()}


def _absorption(paint: FittedPaint) -> Json:
    """Return what is known and believed of the absorption."""
    absorption = paint.fit.reradiation
    told = absorption.model_dump(
        mode="json",
        include={"laser_nm", "measured_at_nm", "prior_driven", "prior", "statement", "rejected_share"}
        | {"violating_share", "distinct_shapes"},
    )
    return {"stokes_shift_nm": estimate_json(absorption.stokes_shift_nm), **told}


def _band_signals(paint: FittedPaint) -> list[Json]:
    """Return measured and predicted signals, filter by filter; lists run over the red, green and blue channel."""
    fit, bands = paint.fit, paint.bands
    return [
        {
            "filter_name": band.name,
            "measured": fit.measured[i].tolist(),
            "measured_sd": fit.measured_sd[i].tolist(),
            "predicted": fit.predicted[i].tolist(),
            "predicted_sd": fit.predicted_sd[i].tolist(),
            "total_radiance_factor": bands.reflectance[i].tolist(),
            "flags": list(bands.flags[i]),
        }
        for i, band in enumerate(bands.optics.filters)
    ]
