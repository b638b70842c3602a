r"""What the certificate of a paint states: results with expanded uncertainty, and conformity.

The coverage interval holds 95 % of the posterior draws, symmetric in probability (JCGM 101). With its half width U and
the standard uncertainty u of the draws,

.. math:: U = (y_{97.5} - y_{2.5}) / 2, \quad k = U / u,

so that k follows from the draws and is not taken from a normal distribution.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Final

import numpy as np
from scipy.stats import norm

from data_schemas import (
    CERTIFIED,
    CertificateDetails,
    CertifiedName,
    CheckVerdict,
    Estimate,
    FinrayError,
    PaintCalibration,
    Reference,
)
from finray_calib.acceptance._conformity import ToleranceInterval

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
