"""Every number of a fit's report as plain JSON types."""

from collections.abc import Mapping

from data_schemas.estimate import Estimate
from data_schemas.fit import FamilyResult
from finray_calib.reports.curve_agreement import curve_agreement, paper_agreement
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.plain_json import Json, estimate_json


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
