"""Methods of a result as a paper would tell them, written from the records, with the works that they rest on.

A sentence stands only where the record says that it was so; a work is listed only where the text cites it.
"""

import re
from collections.abc import Sequence
from typing import Final

from data_schemas import (
    LightAngleDecision,
    LightAngleSweep,
    PhotometricErrorReport,
    Provenance,
    StudyResult,
    percent,
)
from finray_calib.reports import _comparison_statements as compared
from finray_calib.reports import _fit_statements as fitted
from finray_calib.reports._fitted_paint import FittedPaint
from finray_calib.reports._page import Content, Part
from finray_calib.reports._plain_text import centre_text

WORKS: Final = {
    "Andersson et al., 2020": "P. Andersson et al., FLIP: a difference evaluator for alternating images, Proc. ACM "
    "Comput. Graph. Interact. Tech. 3 (2020) 15.",
    "ASME V&V 20, 2009": "ASME V&V 20-2009, Standard for verification and validation in computational fluid dynamics "
    "and heat transfer.",
    "EMVA 1288, 2021": "EMVA Standard 1288, release 4.0 Linear, Standard for characterization of image sensors and "
    "cameras, European Machine Vision Association, 2021.",
    "Foreman-Mackey et al., 2013": "D. Foreman-Mackey, D. W. Hogg, D. Lang, J. Goodman, emcee: the MCMC hammer, Publ. "
    "Astron. Soc. Pac. 125 (2013) 306-312.",
    "Frazier et al., 2009": "P. Frazier, W. Powell, S. Dayanik, The knowledge-gradient policy for correlated normal "
    "beliefs, INFORMS J. Comput. 21 (2009) 599-613.",
    "Gilks and Berzuini, 2001": "W. R. Gilks, C. Berzuini, Following a moving target: Monte Carlo inference for "
    "dynamic Bayesian models, J. R. Stat. Soc. B 63 (2001) 127-146.",
    "JCGM 101, 2008": "JCGM 101:2008, Propagation of distributions using a Monte Carlo method.",
    "JCGM 106, 2012": "JCGM 106:2012, The role of measurement uncertainty in conformity assessment.",
    "Kennedy and O'Hagan, 2001": "M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. "
    "B 63 (2001) 425-464.",
    "Rasmussen and Williams, 2006": "C. E. Rasmussen, C. K. I. Williams, Gaussian processes for machine learning, MIT "
    "Press, 2006.",
    "Sharma et al., 2005": "G. Sharma, W. Wu, E. N. Dalal, The CIEDE2000 color-difference formula, Color Res. Appl. 30 "
    "(2005) 21-30.",
    "Vehtari et al., 2021": "A. Vehtari et al., Rank-normalization, folding, and localization: an improved R-hat, "
    "Bayesian Anal. 16 (2021) 667-718.",
    "Vehtari et al., 2024": "A. Vehtari, D. Simpson, A. Gelman, Y. Yao, J. Gabry, Pareto smoothed importance sampling, "
    "J. Mach. Learn. Res. 25 (2024) 1-58.",
    "Wang et al., 2004": "Z. Wang et al., Image quality assessment: from error visibility to structural similarity, "
    "IEEE Trans. Image Process. 13 (2004) 600-612.",
    "Zheng et al., 2014": "Y. Zheng, I. Sato, Y. Sato, Spectra estimation of fluorescent and reflective scenes by "
    "using ordinary illuminants, ECCV 2014.",
}
"""Each work by the way it is cited."""

_CITED = re.compile(r"\(((?:[^()]+, (?:19|20)\d\d)(?:; [^()]+, (?:19|20)\d\d)*)\)")


def cited(text: str) -> tuple[str, ...]:
    """Return the works that a text cites, in the order of the list."""
    named = {work for group in _CITED.findall(text) for work in group.split("; ")}
    return tuple(full for work, full in WORKS.items() if work in named)


def methods_part(paragraphs: Sequence[str], origin: Provenance | None = None) -> Part:
    """Return the section of the methods, with its list of works, folded at first."""
    made = () if origin is None else (f"Computed with finray-calib {origin.package_version}{_made_with(origin)}.",)
    told = (*paragraphs, *made)
    works = Part("References", Content(points=cited(" ".join(told))))
    lead = "Written from the records of this page. It may be copied into a paper."
    return Part("Methods, for a paper", Content(lead, remarks=told, parts=(works,)), is_detail=True)


def _made_with(origin: Provenance) -> str:
    """Return processor, renderer and seed, as far as the record knows them."""
    renderer = f", renderer {origin.renderer}" if origin.renderer else ""
    return f"{renderer}{'' if origin.seed is None else f', seed {origin.seed}'}"


def fit_methods(paint: FittedPaint) -> tuple[str, ...]:
    """Return how the emission of a paint was measured and inferred, and what came out."""
    fit, bands = paint.fit, paint.bands
    optics = fit.optics
    centres = ", ".join(centre_text(band.center_nm) for band in optics.filters)
    white, stated = optics.white_reference, optics.band_uncertainty
    is_table = bands.region_pixels == 1  # a region has four or more: readings of another detector
    taken, averaged = (
        ("measured by other means", "The readings were imported from a table")
        if is_table
        else ("photographed raw", f"Dark-subtracted frames were averaged over {bands.region_pixels} pixels")
    )
    measured = (
        f"The sample \u201c{fit.paint_name}\u201d was {taken} under a laser at "
        f"{optics.laser.wavelength_nm:g} nm through {len(optics.filters)} band-pass filters (centres {centres} nm), "
        f"beside a white reference of reflectance {white.reflectance:g} (standard uncertainty "
        f"{percent(white.uncertainty_rel)}). {averaged}; "
        f"{fit.usable_values} of {bands.usable().size} ratios of filter and channel to the white reference entered the "
        f"fit, with relative standard uncertainties of {percent(stated.calibration_rel)} for the calibration of each "
        f"filter, {percent(stated.response_rel)} for each channel's response and "
        f"{percent(stated.stray_light_rel)} of the brightest filter for stray light."
    )
    model = _emission_model(paint)
    rank = "" if fit.diagnostics.chain is None else " Convergence was judged by R-hat (Vehtari et al., 2021)."
    sampled = f"The posterior was sampled: {_sampling(paint)}{rank}"
    return (measured, f"{model} {sampled}", f"{fitted.paint_sentence(paint)} Brackets: 95 % intervals.")


def _emission_model(paint: FittedPaint) -> str:
    """Say what curve the emission was taken to be."""
    fit = paint.fit
    if paint.rests_on_measured_spectra:
        return f"The spectrum was inferred under a {fit.spectrum_from}, learned from measured emission spectra."
    source = " (Zheng et al., 2014)" if fit.family == "zheng2014" else ""
    return (
        f"The spectrum was modelled by the family \u201c{fit.family_title}\u201d{source} with a smooth random "
        f"departure of {percent(fit.discrepancy.amplitude_rel)} and a correlation length of "
        f"{fit.discrepancy.length_nm:g} nm (Kennedy and O'Hagan, 2001)."
    )


_SAMPLERS: Final = {
    "importance sampling": "importance sampling with Pareto smoothing (Vehtari et al., 2024)",
    "adapted importance sampling": "adapted importance sampling with Pareto smoothing (Vehtari et al., 2024)",
    "resample-move": "importance sampling followed by moves of its draws (Gilks and Berzuini, 2001)",
    "emcee": "an affine-invariant ensemble of chains (Foreman-Mackey et al., 2013)",
}


def _sampling(paint: FittedPaint) -> str:
    """Say how the posterior was drawn, and whether the draws were trusted."""
    found = paint.fit.diagnostics
    beside = ""
    if found.chain is not None and found.method != "emcee":
        beside = ", with ensemble chains as an independent check (Foreman-Mackey et al., 2013)"
    kept = "met" if fitted.is_trusted(found) else "did NOT meet"
    return f"by {_SAMPLERS[found.method]}{beside}; the draws {kept} their criteria."


def comparison_methods(report: PhotometricErrorReport) -> tuple[str, ...]:
    """Return how a simulated touch was scored against a capture, and what came out."""
    row = compared.row_of(compared.headline(report), "simulation")
    compared_with = (
        f"The simulated touch \u201c{report.simulated}\u201d ({report.label}) was compared with the capture "
        f"\u201c{report.captured}\u201d {compared.grid_phrase(report)} in {report.values}. "
        f"{compared.exposure_sentence(report)} The skill is 1 minus the ratio of the squared error of the "
        "simulation to that of an image of the untouched pad in its place, summed over channels and pixels of the "
        f"region \u201c{report.headline_region}\u201d ({compared.headline(report).pixels} pixels)."
    )
    others = _other_metrics(report, row is not None and row.ciede2000_mean is not None)
    covers = compared.coverage(report)
    if report.monte_carlo is not None:
        covers += f" The intervals come from {report.monte_carlo.draws} draws of all inputs together (JCGM 101, 2008)."
    parts = ""
    if report.validation:
        parts = " The level was validated part by part (ASME V&V 20, 2009)."
    return (compared_with, f"{covers}{others}{parts}", compared.simulation_sentence(report))


def _other_metrics(report: PhotometricErrorReport, has_colour: bool) -> str:
    """Return the further metrics that the report holds, with their sources."""
    rows = [row for region in report.regions for row in region.rows]
    named = ["SSIM (Wang et al., 2004)"]
    named += ["CIEDE2000 (Sharma et al., 2005)"] if has_colour else []
    named += ["FLIP (Andersson et al., 2020)"] if any(row.flip_mean is not None for row in rows) else []
    return f" Also given: {', '.join(named)}."


def decision_methods(decision: LightAngleDecision, sweep: LightAngleSweep) -> tuple[str, ...]:
    """Return how the light angle was decided, and what came out."""
    angles, tolerance = sweep.angles_deg, percent(decision.tolerance_rel)
    several = len(decision.contacts)
    places = f", for touches at {several} places" if several > 1 else ""
    swept = (
        f"The light angle was chosen for: {decision.objective.rstrip('.')}{places}. It was rendered at {len(angles)} "
        f"angles from {min(angles):g} to {max(angles):g} deg with {sweep.values.shape[1]} repeats that share their "
        "random draws. Gaussian processes through the renders (Rasmussen and Williams, 2006) gave the distribution of "
        f"the best angle and of the loss at every other; angles that lose at most {tolerance} with 95 % probability "
        "count as equivalent."
    )
    if decision.validated:
        count = len(decision.captures)
        real = f"The difference between simulation and finger was learned from {count} capture{'s' * (count > 1)}"
    else:
        real = "No capture was used; a difference between simulation and finger was assumed"
    if decision.discrepancy_rel is not None:
        real += f" ({percent(decision.discrepancy_rel)} as one standard deviation)"
    real += " and propagated as a random curve (Kennedy and O'Hagan, 2001)." if decision.discrepancy_rel else "."
    if decision.next_render is not None or decision.next_capture is not None:
        real += " The next render and capture to add were chosen by knowledge gradient (Frazier et al., 2009)."
    return (swept, real, decision.sentence)


def study_methods(result: StudyResult) -> tuple[str, ...]:
    """Return what a design study varied and measured."""
    points, names = result.points, dict.fromkeys(metric.name for row in result.points for metric in row.metrics)
    meanings = {metric.name: metric for row in points for metric in row.metrics}
    told = "; ".join(f"{name} ({meanings[name].unit}): {meanings[name].meaning.rstrip('.')}" for name in names)
    failed = f"; {len(result.failures)} more could not be computed" if result.failures else ""
    return (
        f"The design was varied in {', '.join(result.varied)}: {len(points)} designs were computed{failed}. "
        f"For each design these were computed: {told}. Intervals (95 %) come from independent renders of one "
        "design.",
    )


def check_methods(guard_factor: float) -> tuple[str, ...]:
    """Return how a rig was judged."""
    return (
        "Each device was exercised and each quantity compared with the limit that the plan declares. A check passed "
        f"where the value was inside the limit by at least {guard_factor:g} standard uncertainties, failed where it "
        "was outside by at least as much, and was undecided between: a guard band for 95 % (JCGM 106, 2012).",
    )
