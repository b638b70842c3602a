r"""All merged steps of a paint session, checked for what is missing or lost: covariance of signals, and bleaching.

The covariance holds what each step has of its own, and what steps share. The level of the laser is taken on the white
reference, referred to the lamp.

Bleaching is the fading of the paint's emission under the laser. The first laser filter is captured again as the last
one. With F and R its signals and d their doses (J)

.. math:: k = \sum_c \omega_c \frac{\ln F_c - \ln R_c}{d_{Rc} - d_{Fc}}

is the relative loss per joule. A loss beyond three standard deviations is corrected, to the dose of the first laser
frame; a smaller one is not, and :math:`(k^2 + \sigma_k^2)` stays as a variance common to all bands. The excitation
filter shows reflected light, which does not fade.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import Bleaching, CaptureSession, FrameType, RadiometryError, percent
from finray_calib.radiometry._step_signals import (
    LARGEST_SATURATED_FRACTION,
    DarkLevel,
    ExposureSignal,
    ReadFrame,
    StepKey,
    StepSignal,
    dark_levels,
    exposure_signals,
    light_repeatability_rel,
    mean_log_ratio,
    merge_exposures,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SessionSteps:
    """Merged signals of a session; the tuples run along the captured filters.

    Attributes
    ----------
    names
        Names of the captured filters, in the order of the wheel.
    excitation
        Index of the filter that passes the laser.
    white, reflectance, fluorescence
        White under the lamp, sample under the lamp, sample under the laser.
    laser_white
        White under the laser through the excitation filter.
    repeat
        The first laser filter again at the end, if it was captured.
    tilted
        The tilted sample under the laser, if it was captured.
    darks
        Dark levels by exposure time asked for (s).
    repeatability_rel
        Repeatability of the light of one frame.
    """

    names: tuple[str, ...]
    excitation: int
    white: tuple[StepSignal, ...]
    reflectance: tuple[StepSignal, ...]
    fluorescence: tuple[StepSignal, ...]
    laser_white: StepSignal
    repeat: StepSignal | None
    tilted: tuple[StepSignal, ...]
    darks: dict[float, DarkLevel]
    repeatability_rel: float


def session_steps(session: CaptureSession, read: ReadFrame) -> SessionSteps:
    """Reduce every frame of a session, one at a time, and merge the exposures of each step.

    Raises
    ------
    RadiometryError
        A step, a dark frame or a whole band is missing or saturated, or the region is empty.
    """
    names = captured_filters(session)
    if session.plan.excitation_filter not in names:
        raise RadiometryError(
            f"session.plan.excitation_filter: {session.plan.excitation_filter!r} is not among the captured filters "
            f"({', '.join(names)})"
        )
    darks = dark_levels(session, read)
    grouped = exposure_signals(session, read, darks)
    repeatability_rel = light_repeatability_rel(grouped, _fading_per_j(grouped, session.plan.excitation_filter))
    steps = {key: merge_exposures(exposures, repeatability_rel) for key, exposures in grouped.items()}
    return SessionSteps(
        names=names,
        excitation=names.index(session.plan.excitation_filter),
        white=_of_type(steps, "white", names),
        reflectance=_of_type(steps, "reflectance", names),
        fluorescence=_of_type(steps, "fluorescence", names),
        laser_white=_of_type(steps, "laser white", (session.plan.excitation_filter,))[0],
        repeat=next((step for (kind, _), step in steps.items() if kind == "fluorescence repeat"), None),
        tilted=tuple(step for (kind, _), step in steps.items() if kind == "tilted fluorescence"),
        darks=darks,
        repeatability_rel=repeatability_rel,
    )


def captured_filters(session: CaptureSession) -> tuple[str, ...]:
    """Return the names of the filters of the plan in the order of the wheel."""
    planned = session.plan.filters
    return tuple(f.name for f in session.rig.filter_wheel.filters if planned is None or f.name in planned)


def signals_of(steps: tuple[StepSignal, ...]) -> Floats:
    """Return the merged signals (DN/s), shape (steps, 3); NaN where every exposure is saturated."""
    return np.array([step.signal_dn_per_s for step in steps])


def _fading_per_j(grouped: dict[StepKey, list[ExposureSignal]], excitation_filter: str) -> dict[StepKey, float]:
    """Return a first estimate of the loss per joule for every step that shows emission under the laser."""
    repeat = next((exposures[0] for (kind, _), exposures in grouped.items() if kind == "fluorescence repeat"), None)
    if repeat is None or repeat.frame.filter_name is None:
        return {}
    first = grouped.get(("fluorescence", repeat.frame.filter_name))
    ratio = mean_log_ratio(first[0], repeat) if first else None
    span_j = repeat.frame.laser_dose_j - first[0].frame.laser_dose_j if first else 0.0
    if ratio is None or span_j <= 0:
        return {}
    return {key: -ratio[0] / span_j for key in grouped if "fluorescence" in key[0] and key[1] != excitation_filter}


def _of_type(steps: dict[StepKey, StepSignal], kind: FrameType, names: tuple[str, ...]) -> tuple[StepSignal, ...]:
    """Return the steps of one type over the filters; a missing step or a wholly saturated band is an error."""
    found = []
    for name in names:
        step = steps.get((kind, name))
        if step is None:
            raise RadiometryError(
                f"session.frames: has no '{kind}' frame through filter {name}; capture the session again with this "
                "filter"
            )
        if np.isnan(step.signal_dn_per_s).all():
            raise RadiometryError(
                f"{step.exposures[0].frame.file}: filter {name} is saturated in all channels and exposures ('{kind}', "
                f"{100 * step.saturated_fraction.min():.1f} % of the region at full scale, but at most "
                f"{100 * LARGEST_SATURATED_FRACTION:.2f} % is allowed); capture again with a lower "
                "plan.target_fraction or a shorter exposure in plan.bracket"
            )
        found.append(step)
    return tuple(found)


def signal_covariance(steps: Sequence[StepSignal], darks: dict[float, DarkLevel], repeatability_rel: float) -> Floats:
    r"""Return the covariance of the merged signals of some steps.

    .. math:: C = \mathrm{diag}(n) + \sum_j u_j u_j^T

    with one column u for each error that several signals share: the light level of one frame (common to its
    channels), the dark level of one exposure time (per channel, common to all steps that use it), and the dark
    drift at one exposure time (common to channels and steps). Lost signals (NaN) have zeros.

    Parameters
    ----------
    steps
        M steps.
    darks
        Dark levels by exposure time asked for (s).
    repeatability_rel
        Relative standard deviation of the light level of one frame.

    Returns
    -------
    ndarray
        (3 M, 3 M) in (DN/s)^2, step-major.
    """
    noise = np.array([np.nan_to_num(step.noise_variance) for step in steps])
    columns = [*_light_columns(steps, repeatability_rel), *_dark_columns(steps, darks)]
    shared = np.array([column.ravel() for column in columns]).reshape(len(columns), noise.size)
    return np.asarray(np.diag(noise.ravel()) + shared.T @ shared)


def _light_columns(steps: Sequence[StepSignal], repeatability_rel: float) -> list[Floats]:
    """Return one (M, 3) column per frame: its light level."""
    columns = []
    for k, step in enumerate(steps):
        for share in step.shares:
            column = np.zeros((len(steps), 3))
            column[k] = repeatability_rel * share * np.nan_to_num(step.signal_dn_per_s)
            columns.append(column)
    return columns


def _dark_columns(steps: Sequence[StepSignal], darks: dict[float, DarkLevel]) -> list[Floats]:
    """Return four (M, 3) columns per exposure time: the dark level of each channel, and the drift."""
    columns = []
    for exposure_s, dark in darks.items():
        slope = np.zeros((len(steps), 3))  # change of the signals for 1 DN of this dark level
        for k, step in enumerate(steps):
            for share, exposure in zip(step.shares, step.exposures, strict=True):
                if exposure.frame.exposure_requested_s == exposure_s:
                    slope[k] -= share / exposure.frame.exposure_s
        if slope.any():
            columns += [slope * np.sqrt(dark.noise_variance) * (np.arange(3) == c) for c in range(3)]
            columns.append(slope * np.sqrt(dark.drift_variance_dn2))
    return columns


def channel_weights(steps: SessionSteps) -> Floats:
    """Return inverse-variance weights (3,), sum 1, of the channels for the laser level V.

    Raises
    ------
    RadiometryError
        No channel sees the laser on the white reference.
    """
    laser, lamp = steps.laser_white, steps.white[steps.excitation]
    v, w = laser.signal_dn_per_s, lamp.signal_dn_per_s
    good = (v > 0) & (w > 0)  # false for lost channels (NaN)
    v, w = np.where(good, v, 1.0), np.where(good, w, 1.0)
    variance = (laser.noise_variance / v**2 + lamp.noise_variance / w**2) * (v / w) ** 2
    weight = np.where(good, 1 / np.where(good, variance, 1.0), 0.0)
    if weight.sum() == 0:
        raise RadiometryError(
            "the white reference under the laser gives no signal through the excitation filter; check that the laser "
            "is on the tile, and that plan.excitation_filter names the filter of the laser line"
        )
    return np.asarray(weight / weight.sum())


def laser_level(steps: SessionSteps, weights: Floats) -> float:
    """Return V = sum_c w_c (white under the laser / white under the lamp) through the excitation filter."""
    lamp = positive(steps.white[steps.excitation].signal_dn_per_s)
    return float((weights * np.nan_to_num(steps.laser_white.signal_dn_per_s) / lamp).sum())


def positive(signal: Floats) -> Floats:
    """Replace unusable (NaN, zero or negative) denominators by 1; their entries carry a flag."""
    return np.where(np.isfinite(signal) & (signal > 0), signal, 1.0)


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
        why = (
            f"the repeat is {-z:.0f} standard deviations brighter ({-100 * faded:.1f} %), but light does not "
            "brighten a paint"
        )
    elif apart_sd.max() > DISAGREEING_SD:
        why = (
            f"its channels changed differently, by {apart_sd.max():.0f} standard deviations, and fading dims all "
            f"channels by the same share"
        )
    elif z > DISAGREEING_SD and faded > LARGEST_FADING:
        why = (
            f"the repeat is {z:.0f} standard deviations and {100 * faded:.0f} % dimmer, which is more than a paint "
            f"fades (at most {100 * LARGEST_FADING:.0f} %)"
        )
    else:
        return
    raise RadiometryError(
        f"filter {record.filter_name} and its repeat disagree: {why}. The sample, the region or the laser may have "
        "changed during the session; capture again, or give --accept-repeat to treat the difference as fading"
    )


def bleaching_note(bleaching: Bleaching) -> str:
    """Say in one sentence what was found and what was done about it."""
    found = (
        f"bleaching through filter {bleaching.filter_name}: {100 * bleaching.loss_per_j:.3g} +- "
        f"{percent(bleaching.sd_per_j)} of the emission per joule of laser light, over "
        f"{bleaching.dose_span_j:.3g} J"
    )
    if bleaching.resolved:
        return f"{found}; all bands are corrected to the first laser frame"
    return f"{found}; not significant, so it is not corrected, but counted as an uncertainty common to all bands"
