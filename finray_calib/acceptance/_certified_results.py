r"""What the certificate of a paint states: results with expanded uncertainty, conformity, and budget by source.

The coverage interval holds 95 % of the posterior draws, symmetric in probability (JCGM 101). With its half width U and
the standard uncertainty u of the draws,

.. math:: U = (y_{97.5} - y_{2.5}) / 2, \quad k = U / u,

so that k follows from the draws and is not taken from a normal distribution.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from typing import Final

import numpy as np
from scipy.stats import norm

from data_schemas import (
    CERTIFIED,
    BandSignals,
    CertificateDetails,
    CertifiedName,
    CheckVerdict,
    Estimate,
    FinrayError,
    Optics,
    PaintCalibration,
    PaintWithoutEmission,
    Reference,
)
from finray_calib.acceptance._conformity import ToleranceInterval
from finray_calib.fit import calibrate_paint

_EMISSION_REFERENCES: Final[tuple[Reference, ...]] = ("white reference", "filters", "lamp")
NO_REFERENCE: Final = "not traceable: no reference certificate recorded"
CONFORMS_FROM: Final = 0.95
_QUANTILES_SD: Final = tuple(float(norm.ppf(level)) for level in (0.025, 0.16, 0.5, 0.84, 0.975))
"""Of a normal distribution, where a record holds those of the draws."""


@dataclass(frozen=True, slots=True)
class CertifiedResult:
    """One quantity of a certificate, in its unit.

    Attributes
    ----------
    name, title, unit
        The quantity.
    value, u
        Median of the draws and their standard deviation.
    low95, high95
        Coverage interval for 95 %.
    is_measured
        Whether the measurement, and not the prior, decides it: less than half of the prior's variance is left.
    traceability
        The certificates that it rests on, or that there are none.
    limits, p_conform, verdict
        The limits of the laboratory with the probability of conformity; None where it states none.
    """

    name: CertifiedName
    title: str
    unit: str
    value: float
    u: float
    low95: float
    high95: float
    is_measured: bool
    traceability: str
    limits: ToleranceInterval | None
    p_conform: float | None
    verdict: CheckVerdict | None

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U: half of the coverage interval."""
        return 0.5 * (self.high95 - self.low95)

    @property
    def coverage_factor(self) -> float:
        """U over the standard uncertainty."""
        return self.expanded / self.u


def certified_results(
    paint: PaintCalibration, details: CertificateDetails, measured_on: date | None
) -> tuple[CertifiedResult, ...]:
    """Return the results of a certificate.

    Parameters
    ----------
    paint
        The calibration.
    details
        References and limits of the laboratory.
    measured_on
        Day of the capture, on which a reference must have been valid; None where it is not known.

    Raises
    ------
    FinrayError
        The draws of the calibration cannot be trusted, or a quantity does not vary over them.
    """
    if not paint.diagnostics.trusted:
        raise FinrayError(
            f"'{paint.paint_name}': the draws of this fit cannot be trusted, so no uncertainty can be certified; look "
            "at its page ('finray fit --report') and measure or fit again"
        )
    references = valid_references(details, measured_on)
    return tuple(_result(paint, details, name, references) for name in CERTIFIED)


def _result(
    paint: PaintCalibration, details: CertificateDetails, name: CertifiedName, references: Mapping[Reference, str]
) -> CertifiedResult:
    """Return the result of one quantity."""
    title, unit = CERTIFIED[name]
    found = paint.parameters[name]
    if not found.sd > 0.0:
        raise FinrayError(f"'{paint.paint_name}': {name} has no uncertainty in this record; fit the paint again")
    is_measured = name not in paint.mostly_prior
    given = next((limits for limits in details.limits if limits.quantity == name), None)
    limits = None if given is None else ToleranceInterval(given.low, given.high)
    p_conform = None if limits is None or not is_measured else conformity_of(found, limits)
    return CertifiedResult(
        name=name,
        title=title,
        unit=unit,
        value=found.estimate,
        u=found.sd,
        low95=found.low95,
        high95=found.high95,
        is_measured=is_measured,
        traceability=_traceability(name, references, has_any=bool(details.references)),
        limits=limits,
        p_conform=p_conform,
        verdict=None if limits is None else _verdict(p_conform),
    )


def conformity_of(found: Estimate, limits: ToleranceInterval) -> float:
    r"""Return the probability that a quantity keeps its limits, from its median and intervals.

    .. math:: P(\eta \le T) = \Phi(z(T))

    with z linear between the quantiles that the record holds (2.5, 16, 50, 84 and 97.5 %) and beyond them: exact there
    for any distribution, and everywhere for a normal one.

    Parameters
    ----------
    found
        Median and intervals.
    limits
        In the unit of the quantity.
    """
    points = (found.low95, found.low68, found.estimate, found.high68, found.high95)

    def below(value: float) -> float:
        if not np.isfinite(value):
            return float(value > 0.0)
        first = min(max(int(np.searchsorted(points, value, side="right")) - 1, 0), len(points) - 2)
        width = points[first + 1] - points[first]
        if width <= 0.0:  # a quantity at the end of its range
            return float(value >= points[first])
        share = (value - points[first]) / width
        return float(norm.cdf(_QUANTILES_SD[first] + share * (_QUANTILES_SD[first + 1] - _QUANTILES_SD[first])))

    low, high = limits.edges
    return max(below(high) - below(low), 0.0)


def _verdict(p_conform: float | None) -> CheckVerdict:
    """Return the verdict of a probability of conformity; what was not measured is not decided."""
    if p_conform is None:
        return "UNDECIDED"
    if p_conform >= CONFORMS_FROM:
        return "PASS"
    return "FAIL" if p_conform <= 1.0 - CONFORMS_FROM else "UNDECIDED"


def valid_references(details: CertificateDetails, measured_on: date | None) -> dict[Reference, str]:
    """Return part -> certificate, of the references that were valid on the day of the measurement.

    One that was calibrated after that day, or had expired, does not count; where the day is not known none does that
    has a last day.
    """
    found: dict[Reference, str] = {}
    for held in details.references:
        ends = None if held.valid_until is None else date.fromisoformat(held.valid_until)
        if measured_on is None and ends is not None:
            continue
        if measured_on is not None and not date.fromisoformat(held.calibrated_on) <= measured_on <= (ends or date.max):
            continue
        found[held.of] = f"{held.number} ({held.issued_by})"
    return found


def _traceability(name: CertifiedName, references: Mapping[Reference, str], *, has_any: bool) -> str:
    """Return what a quantity is traceable through, or what it lacks."""
    needed = ("white reference",) if name == "reflectance_at_laser" else _EMISSION_REFERENCES
    lacking = [of for of in needed if of not in references]
    if not has_any:
        return NO_REFERENCE
    if lacking:
        return f"not traceable: no certificate valid on the day of the measurement for {', '.join(lacking)}"
    return "traceable through " + "; ".join(f"{of}: {references[of]}" for of in needed)


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """What one source adds to the expanded uncertainty of each quantity.

    Attributes
    ----------
    source, size
        What it is, and how large the record says that it is.
    evaluation
        A: from the scatter of frames; B: stated in the rig file or assumed.
    shares
        Share of U^2 that goes where the source alone is taken away.
    """

    source: str
    size: str
    evaluation: str
    shares: dict[CertifiedName, float]


@dataclass(frozen=True, slots=True)
class Budget:
    """The budget by source.

    Attributes
    ----------
    rows
        The sources that the record names.
    resolved_share
        Two standard errors of a share, from the scatter over the repeats: a smaller share is not told from none.
    """

    rows: tuple[BudgetRow, ...]
    resolved_share: float


NOISE_LEFT: Final = 0.1
"""Of the frames' standard uncertainty, where it is taken away: a fit needs some."""
REPEATS: Final = 4
"""Fits of each case, each with its own draws, whose scatter says how well a share is known."""
Progress = Callable[[int, int, str], None]


def uncertainty_budget(
    bands: BandSignals, paint: PaintCalibration, seed: int, progress: Progress = lambda done, total, what: None
) -> Budget:
    r"""Fit the paint again with one source taken away at a time and compare the uncertainties.

    .. math:: s_i = 1 - U_{\text{without } i}^2 / U^2

    The shares need not add to 1: what is left rests on the prior of the spectrum between the filters and on sources
    that the fit always assumes (calibration of bands and channels, stray light). It takes about half a minute.

    Parameters
    ----------
    bands
        The band signals of the paint.
    paint
        Its calibration.
    seed
        With which it was fitted.
    progress
        Called with (done, total, text).

    Raises
    ------
    FinrayError
        The band signals do not give this calibration.
    """
    cases = _without_sources(bands)
    signals = [bands, *(case[3] for case in cases)]
    squared = np.empty((REPEATS, len(signals), len(CERTIFIED)))
    for repeat, number in np.ndindex(REPEATS, len(signals)):
        progress(repeat * len(signals) + number, REPEATS * len(signals), f"budget, repeat {repeat + 1}")
        fitted = calibrate_paint(signals[number], seed + repeat)
        if repeat == number == 0:
            _require_same(fitted, paint)
        squared[repeat, number] = _expanded_squared(fitted)
    shares = 1.0 - squared[:, 1:].mean(axis=0) / squared[:, 0].mean(axis=0)
    scatter = (1.0 - squared[:, 1:] / squared[:, :1]).var(axis=0, ddof=1)
    rows = tuple(
        BudgetRow(source, size, evaluation, dict(zip(CERTIFIED, map(float, row), strict=True)))
        for (source, size, evaluation, _), row in zip(cases, shares, strict=True)
    )
    return Budget(rows, resolved_share=2.0 * float(np.sqrt(np.nanmean(scatter) / REPEATS)))


def _expanded_squared(fitted: PaintCalibration | PaintWithoutEmission) -> list[float]:
    """Return U^2 of each quantity; nothing is known of a spectrum that is no longer found."""
    if isinstance(fitted, PaintWithoutEmission):
        return [np.nan] * len(CERTIFIED)
    return [(0.5 * (fitted.parameters[name].high95 - fitted.parameters[name].low95)) ** 2 for name in CERTIFIED]


def _require_same(fitted: PaintCalibration | PaintWithoutEmission, paint: PaintCalibration) -> None:
    """Refuse band signals that give another calibration; another processor changes the last digits only."""
    if isinstance(fitted, PaintCalibration):
        names = ("mode_nm", "fwhm_nm", "energy_yield")
        pairs = [(fitted.parameters[name], paint.parameters[name]) for name in names]
        if all(abs(one.estimate - other.estimate) <= 0.1 * other.sd for one, other in pairs):
            return
    raise FinrayError(
        f"'{paint.paint_name}': these band signals and the recorded seed do not give this calibration again, so they "
        "hold no budget of it; give the band signals that it was fitted to, fitted with the options' defaults"
    )


def _without_sources(bands: BandSignals) -> list[tuple[str, str, str, BandSignals]]:
    """Return source, its size, how it was evaluated, and the band signals without it."""
    optics = bands.optics
    kept = [i for i, usable in enumerate(bands.usable().ravel()) if usable]
    signal, variance = bands.fluorescence.ravel()[kept], np.diag(bands.fluorescence_covariance)[kept]
    noise = float(np.median(np.sqrt(variance) / np.maximum(np.abs(signal), 1e-300)))
    calm = bands.model_copy(update={"fluorescence_covariance": NOISE_LEFT**2 * bands.fluorescence_covariance})

    def largest(field: str) -> float:
        return max(float(getattr(band, field)) for band in optics.filters)

    def without(**filter_fields: float) -> BandSignals:
        filters = tuple(band.model_copy(update=filter_fields) for band in optics.filters)
        return _with_optics(bands, optics.model_copy(update={"filters": filters}))

    lamp_k = optics.lamp_temperature_uncertainty_k
    still = _with_optics(bands, optics.model_copy(update={"lamp_temperature_uncertainty_k": 0.0}))
    return [
        ("frames: noise, light level, dark level, texture", f"{noise:.2g} of the signal (median)", "A", calm),
        ("centres of the filters", f"at most {largest('center_uncertainty_nm'):g} nm", "B",
         without(center_uncertainty_nm=0.0)),
        ("widths of the filters", f"at most {largest('fwhm_uncertainty_nm'):g} nm", "B",
         without(fwhm_uncertainty_nm=0.0)),
        ("blocking of the filters", f"at most {largest('blocking_uncertainty_od'):g} OD", "B",
         without(blocking_uncertainty_od=0.0)),
        ("colour temperature of the lamp", f"{lamp_k:g} K", "B", still),
    ]  # fmt: skip


def _with_optics(bands: BandSignals, optics: Optics) -> BandSignals:
    """Return band signals seen through other optics."""
    return bands.model_copy(update={"optics": optics})
