r"""Bleaching: the fading of the paint's emission under the laser.

The first laser filter is captured again as the last one. With F and R its signals and d their doses (J)

.. math:: k = \sum_c \omega_c \frac{\ln F_c - \ln R_c}{d_{Rc} - d_{Fc}}

is the relative loss per joule. A loss beyond three standard deviations is corrected, to the dose of the first laser
frame; a smaller one is not, and :math:`(k^2 + \sigma_k^2)` stays as a variance common to all bands. The excitation
filter shows reflected light, which does not fade.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import Bleaching, RadiometryError
from finray_calib.radiometry._session_steps import SessionSteps, signal_covariance

Floats = NDArray[np.float64]
RESOLVED_SD = 3.0
DISAGREEING_SD = 6.0
"""A filter and its own repeat that differ by more than this, and not as fading does, were not of one sample."""
LARGEST_FADING = 0.3
"""A paint that loses more between the first laser filter and the last is no sample to take a spectrum from."""


@dataclass(frozen=True, slots=True)
class BleachingTrend:
    """A bleaching record with what the covariance of the band signals needs.

    Attributes
    ----------
    record
        The trend.
    filter_index
        Index of the filter that was captured twice.
    dose_j
        (B, 3) laser dose of each filter and channel since the first laser frame; 0 for the excitation filter.
    log_weight
        (3,) weights of the channels' logarithms over their dose spans (1/J): k = log_weight @ (ln F - ln R).
    """

    record: Bleaching
    filter_index: int
    dose_j: Floats
    log_weight: Floats

    def correction(self) -> Floats:
        """Return the factors (B, 3) that refer the signals to the dose of the first laser frame; 1 if not resolved."""
        return np.asarray(np.exp(self.record.loss_per_j * self.dose_j * self.record.resolved))

    def unresolved_sd_rel(self) -> Floats:
        """Return the relative standard deviation (B, 3), common to all bands, of a trend that was not corrected."""
        size = np.hypot(self.record.loss_per_j, self.record.sd_per_j)
        return np.asarray(size * self.dose_j * (not self.record.resolved))


def bleaching_trend(steps: SessionSteps) -> BleachingTrend | None:
    """Return the bleaching of a session; None when no filter was captured twice with laser light between."""
    if steps.repeat is None:
        return None
    name = steps.repeat.exposures[0].frame.filter_name
    index = next((i for i, n in enumerate(steps.names) if n == name), None)
    if index is None:
        return None
    first = steps.fluorescence[index]
    span_j = steps.repeat.dose_j - first.dose_j
    f, r = first.signal_dn_per_s, steps.repeat.signal_dn_per_s
    good = (f > 0) & (r > 0)  # false for lost channels (NaN)
    good &= span_j > 0
    if not good.any():
        return None
    safe_f, safe_r = np.where(good, f, 1.0), np.where(good, r, 1.0)
    noise = np.where(good, first.noise_variance / safe_f**2 + steps.repeat.noise_variance / safe_r**2, np.inf)
    weight = np.where(good, span_j / noise, 0.0) / (span_j**2 / noise)[good].sum()
    loss_per_j = float(weight @ (np.log(safe_f) - np.log(safe_r)))
    covariance = signal_covariance((first, steps.repeat), steps.darks, steps.repeatability_rel)
    slope = np.concatenate([weight / safe_f, -weight / safe_r])
    sd_per_j = float(np.sqrt(slope @ covariance @ slope))
    start_j = min(e.frame.laser_dose_j for step in steps.fluorescence for e in step.exposures)
    dose_j = np.array([step.dose_j - start_j for step in steps.fluorescence])
    dose_j[steps.excitation] = 0.0
    return BleachingTrend(
        record=Bleaching(
            filter_name=steps.names[index],
            loss_per_j=loss_per_j,
            sd_per_j=sd_per_j,
            dose_span_j=float(span_j[good].mean()),
            resolved=loss_per_j > RESOLVED_SD * sd_per_j,
        ),
        filter_index=index,
        dose_j=dose_j,
        log_weight=weight,
    )


def refuse_other_repeat(trend: BleachingTrend, steps: SessionSteps) -> None:
    """Refuse a repeat that differs from its filter's first frames by more than six standard deviations, but by fading.

    Fading dims, by at most 30 % here, and all channels of a filter alike. What brightens, dims one channel, or dims by
    more is a sample that moved, a light that drifted, or a frame of something else.

    Raises
    ------
    RadiometryError
        The repeat disagrees.
    """
    record, repeat = trend.record, steps.repeat
    if repeat is None:
        return
    first = steps.fluorescence[trend.filter_index]
    f, r = first.signal_dn_per_s, repeat.signal_dn_per_s
    good = (f > 0) & (r > 0)
    ratio = np.log(np.where(good, r, 1.0) / np.where(good, f, 1.0))
    span_j = repeat.dose_j - first.dose_j
    slope = np.concatenate([np.diag(-1 / np.where(good, f, 1.0)), np.diag(1 / np.where(good, r, 1.0))], axis=1)
    covariance = slope @ signal_covariance((first, repeat), steps.darks, steps.repeatability_rel) @ slope.T
    apart_sd = np.where(good, np.abs(ratio + record.loss_per_j * span_j) / np.sqrt(np.diag(covariance)), 0.0)
    z = record.loss_per_j / record.sd_per_j
    faded = -float(np.expm1(-record.loss_per_j * record.dose_span_j))
    if z < -DISAGREEING_SD:
        why = f"the repeat is {-z:.0f} standard deviations brighter ({-faded:.1%}), and no light brightens a paint"
    elif apart_sd.max() > DISAGREEING_SD:
        why = (
            f"its channels changed differently, by {apart_sd.max():.0f} standard deviations, and fading dims all alike"
        )
    elif z > DISAGREEING_SD and faded > LARGEST_FADING:
        why = f"the repeat is {z:.0f} standard deviations and {faded:.0%} dimmer; at most {LARGEST_FADING:.0%} fades"
    else:
        return
    raise RadiometryError(
        f"filter {record.filter_name} and its own repeat disagree: {why}. Did sample, region or laser change during "
        "the session? Capture again, or give --accept-repeat to take the difference for fading"
    )


def bleaching_note(bleaching: Bleaching) -> str:
    """Say in one sentence what was found and what was done about it."""
    found = (
        f"bleaching through filter {bleaching.filter_name}: {100 * bleaching.loss_per_j:.3g} +- "
        f"{100 * bleaching.sd_per_j:.2g} % of the emission per joule, over {bleaching.dose_span_j:.3g} J"
    )
    if bleaching.resolved:
        return f"{found}; corrected to the first laser frame"
    return f"{found}; not resolved, not corrected, carried as an uncertainty common to all bands"
