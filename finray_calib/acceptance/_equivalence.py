r"""Are two tins of a paint equivalent within a margin: two one-sided tests.

Two tins are equivalent in a quantity when their true difference :math:`\delta` lies within :math:`\pm D`, the margin.
That is shown, with at most 5 % risk of saying so wrongly, when the 90 % interval of the difference lies within
:math:`\pm D` (Schuirmann 1987); the tins are different when the interval lies outside. All else is undecided: not to
have seen a difference is no equivalence. Several quantities must all be shown, which needs no correction; a spectrum
is a quantity at each of its wavelengths.

With two coats or more of each tin, fitted one by one on one rig, the interval is that of Welch,

.. math:: d \pm t_{0.95, \nu} \sqrt{s_A^2 / n_A + s_B^2 / n_B}

with s the scatter between coats, which holds what differs from coat to coat and from session to session; what the rig
does to both alike cancels. A prior pulls every estimate towards itself, and so two tins towards each other: the
difference is divided by :math:`1 - w`, where w is the share of the prior's variance that the measurement left. With one
coat of a tin, the interval is that of all differences of the posterior draws. It knows nothing of other coats.

References
----------
Schuirmann, Journal of Pharmacokinetics and Biopharmaceutics 15 (1987) 657-680. Berger and Hsu, Statistical Science 11
(1996) 283-319: all must be shown.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from data_schemas import CERTIFIED, CheckVerdict, FinrayError, Optics, PaintCalibration
from finray_calib.spectra import curve_quantities

Floats = NDArray[np.float64]
ComparedQuantity = Literal["mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser", "spectrum"]

RISK: Final = 0.05
LARGEST_PRIOR_SHARE: Final = 0.5
"""Of the prior's variance that a measurement may leave: beyond it a quantity is mostly prior."""
QUANTILES: Final = 400
"""Of a normal distribution, in the place of draws."""
SPECTRUM_TITLE: Final = "Spectrum, relative to the peak of the first tin"
ONE_COAT: Final = (
    "posterior draws of one coat: errors that the rig makes on both tins in the same way are counted twice, and the "
    "differences between coats of a tin are not counted at all; measure two coats or more of each tin"
)


@dataclass(frozen=True, slots=True)
class Equivalence:
    """The difference of two tins in one quantity, second minus first, in its unit.

    Attributes
    ----------
    name, title, unit
        The quantity.
    margin
        Largest difference that is allowed, D.
    difference, low90, high90
        Estimate and 90 % interval.
    verdict
        PASS: equivalent; FAIL: different; UNDECIDED: neither is shown.
    basis
        What the interval rests on, and what it does not know.
    """

    name: ComparedQuantity
    title: str
    unit: str
    margin: float
    difference: float
    low90: float
    high90: float
    verdict: CheckVerdict
    basis: str


def tins_are_equivalent(
    first: Sequence[PaintCalibration], second: Sequence[PaintCalibration], margins: Mapping[ComparedQuantity, float]
) -> tuple[Equivalence, ...]:
    """Compare two tins of a paint, each by the calibrations of its coats.

    Parameters
    ----------
    first, second
        One calibration for each coat, all of one rig.
    margins
        Quantity -> largest difference that is allowed, in its unit; of the spectrum as a share of the peak.

    Raises
    ------
    FinrayError
        No margin or one that is not above 0, no coat, coats of different rigs, spectra on different wavelengths, or a
        calibration whose draws cannot be trusted.
    """
    _check(first, second, margins)
    return tuple(_compare(first, second, name, margin) for name, margin in margins.items())


def _check(
    first: Sequence[PaintCalibration], second: Sequence[PaintCalibration], margins: Mapping[ComparedQuantity, float]
) -> None:
    """Refuse what cannot be compared."""
    if not first or not second:
        raise FinrayError("each tin needs the calibration of at least one coat; give calibrations of both tins")
    if not margins:
        raise FinrayError("no margin is given; state how far the tins may differ and still be equivalent")
    for name, margin in margins.items():
        if not (margin > 0.0 and np.isfinite(margin)):
            raise FinrayError(f"margin of {name}: {margin:g} must be a number above 0, in the unit of the quantity")
    one = first[0]
    for other in (*first, *second):
        if not other.diagnostics.trusted:
            raise FinrayError(f"'{other.paint_name}': the draws of this fit cannot be trusted; measure or fit it again")
        if _in_text(other.optics) != _in_text(one.optics):
            raise FinrayError(
                f"'{other.paint_name}' and '{one.paint_name}': the records describe different rigs, but errors of a "
                "rig cancel only if both tins are measured on the same rig"
            )
        if not np.array_equal(other.wavelength_nm, one.wavelength_nm):
            raise FinrayError(
                f"'{other.paint_name}': is not tabulated at the wavelengths of the other coats; fit all coats with "
                "the same version of finray"
            )


@dataclass(frozen=True, slots=True)
class _Difference:
    """Difference of two tins with its standard uncertainty and degrees of freedom, each (L,)."""

    centre: Floats
    sd: Floats
    freedom: Floats
    basis: str

    def interval(self, risk: float) -> tuple[Floats, Floats]:
        """Return both ends of the interval that has this risk on either side, each (L,)."""
        half = student.ppf(1.0 - risk, self.freedom) * self.sd
        return self.centre - half, self.centre + half


def _compare(
    first: Sequence[PaintCalibration], second: Sequence[PaintCalibration], name: ComparedQuantity, margin: float
) -> Equivalence:
    """Compare the tins in one quantity."""
    if name == "spectrum":
        return _spectra(first, second, margin)
    title, unit = CERTIFIED[name]
    share = max((p.prior_shares[name].share for p in (*first, *second) if name in p.prior_shares), default=0.0)
    if _has_coats(first, second):
        found = _welch(*(np.array([[coat.parameters[name].estimate] for coat in tin]) for tin in (first, second)))
        kept = 1.0 - min(share, LARGEST_PRIOR_SHARE)
        centre, low, high = (float(x[0]) / kept for x in (found.centre, *found.interval(RISK)))
        basis = found.basis
    else:
        pairs = _draws(second, name)[None] - _draws(first, name)[:, None]
        low, centre, high = map(float, np.quantile(pairs, [RISK, 0.5, 1 - RISK]))
        basis = ONE_COAT
    verdict = _verdict(low, high, margin)
    if share > LARGEST_PRIOR_SHARE:
        verdict, basis = "UNDECIDED", "mostly prior: the measurement hardly constrains this quantity"
    return Equivalence(name, title, unit, margin, centre, low, high, verdict, basis)


def _in_text(optics: Optics) -> str:
    """Return optics as text, equal where they are."""
    return json.dumps(optics.model_dump(mode="python"), default=lambda array: array.tolist(), sort_keys=True)


def _has_coats(first: Sequence[PaintCalibration], second: Sequence[PaintCalibration]) -> bool:
    """Whether both tins have several coats, whose scatter can be seen."""
    return min(len(first), len(second)) >= 2


def _draws(tin: Sequence[PaintCalibration], name: ComparedQuantity) -> Floats:
    """Return draws of a quantity over the coats of a tin; of the reflectance normal quantiles."""
    if name == "reflectance_at_laser":
        levels = norm.ppf((np.arange(QUANTILES) + 0.5) / QUANTILES)
        return np.concatenate([coat.parameters[name].estimate + coat.parameters[name].sd * levels for coat in tin])
    curves = [curve_quantities(coat.emission_draws_per_nm, coat.wavelength_nm) for coat in tin]
    return np.concatenate([np.asarray(getattr(found, name)) for found in curves])


def _welch(first: Floats, second: Floats) -> _Difference:
    """Return the difference of the means of (n, L) values of the coats of each tin."""
    squares = [tin.var(axis=0, ddof=1) / len(tin) for tin in (first, second)]
    total = squares[0] + squares[1]
    parts = squares[0] ** 2 / (len(first) - 1) + squares[1] ** 2 / (len(second) - 1)
    freedom = np.divide(total**2, parts, out=np.ones_like(total), where=parts > 0)
    basis = f"scatter between {len(first)} and {len(second)} coats; errors that the rig makes on all of them cancel"
    return _Difference(second.mean(axis=0) - first.mean(axis=0), np.sqrt(total), freedom, basis)


def _verdict(low: float, high: float, margin: float) -> CheckVerdict:
    """Return the verdict of a 90 % interval."""
    if -margin < low and high < margin:
        return "PASS"
    return "FAIL" if low > margin or high < -margin else "UNDECIDED"


def _spectra(first: Sequence[PaintCalibration], second: Sequence[PaintCalibration], margin: float) -> Equivalence:
    """Compare whole spectra: equivalent where they are at every wavelength, different where they are at one of them.

    The risk of the latter is divided among the wavelengths (Bonferroni).
    """
    peak = float(np.mean([coat.emission_per_nm.max() for coat in first]))
    if _has_coats(first, second):
        found = _welch(*(np.array([coat.emission_per_nm for coat in tin]) / peak for tin in (first, second)))
    else:
        curves = [np.concatenate([coat.emission_draws_per_nm for coat in tin]) / peak for tin in (first, second)]
        variance = sum((c.var(axis=0, ddof=1) for c in curves), np.zeros(curves[0].shape[1]))
        centre = curves[1].mean(axis=0) - curves[0].mean(axis=0)
        found = _Difference(centre, np.sqrt(variance), np.full_like(variance, np.inf), ONE_COAT)
    low, high = found.interval(RISK)
    surely_low, surely_high = found.interval(RISK / found.centre.size)
    verdict: CheckVerdict = "PASS" if bool(((low > -margin) & (high < margin)).all()) else "UNDECIDED"
    verdict = "FAIL" if bool(((surely_low > margin) | (surely_high < -margin)).any()) else verdict
    worst = int(np.maximum(np.abs(low), np.abs(high)).argmax())
    return Equivalence(
        name="spectrum",
        title=SPECTRUM_TITLE,
        unit="",
        margin=margin,
        difference=float(found.centre[worst]),
        low90=float(low[worst]),
        high90=float(high[worst]),
        verdict=verdict,
        basis=f"worst at {first[0].wavelength_nm[worst]:g} nm; {found.basis}",
    )
