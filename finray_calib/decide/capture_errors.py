"""How far the simulated objective is from the captured one, from photometric error reports, with covariance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import ObjectiveError, PhotometricErrorReport
from data_schemas.simulate import LightAngleSweep
from finray_calib.decide.validating_captures import ValidatingCapture, captures_within, doubts

Floats = NDArray[np.float64]

#: No exposure, LED and camera repeat better than this; it also keeps a covariance of few draws regular.
LEAST_SD_REL = 1e-3
#: Two captures closer than this say nothing about the shape of the curve.
_APART_DEG = 2.0


@dataclass(frozen=True, slots=True)
class CaptureErrors:
    """Hold log errors of the simulated objective at the angles of captures.

    Attributes
    ----------
    names : tuple of str
        What was captured.
    angles_deg, angle_sd_deg : ndarray, shape (N,)
        Angle of the light and its standard uncertainty.
    log_error : ndarray, shape (N,)
        ln(simulated / captured) of the objective.
    covariance : ndarray, shape (N, N)
        Of the log errors, without what the uncertainty of the angles adds.
    scale_of : ndarray of int, shape (N,), or None
        Captures of one number share an unknown common scale (exposure, LED power, gain). None: none is unknown,
        because every error is relative to the no-contact image of its own capture.
    """

    names: tuple[str, ...]
    angles_deg: Floats
    angle_sd_deg: Floats
    log_error: Floats
    covariance: Floats
    scale_of: NDArray[np.int64] | None


#: What is known without captures.
NO_CAPTURES = CaptureErrors((), np.empty(0), np.empty(0), np.empty(0), np.empty((0, 0)), None)


def objective_log_error(log_ratio: Floats, channel_share: Floats) -> Floats:
    """Return the log error of an objective that is a weighted sum of three channels.

    e = -ln(sum_c q_c exp(-r_c)), with the log ratios r_c = ln(simulated / captured) and the shares q_c of the simulated
    objective, which sum to 1.

    Parameters
    ----------
    log_ratio : ndarray, shape (D, 3)
        Draws.
    channel_share : ndarray, shape (3,)

    Returns
    -------
    ndarray, shape (D,)
    """
    return np.asarray(-np.log(np.exp(-log_ratio) @ channel_share))


def capture_errors(
    sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport]
) -> tuple[CaptureErrors, tuple[str, ...]]:
    """Return what reports say about a sweep's objective, and notes on what was left out or assumed.

    Where two captures of one rig at different angles carry exposure and LED current, absolute ratios are compared, up
    to a common scale of the rig; captures without are then left out. Else each error is relative to the no-contact
    image of its own capture. Captures more than 5 deg beyond the sweep are left out. Reports of one source share their
    draws, so their covariance is that of the draws; others are independent.

    Parameters
    ----------
    sweep : LightAngleSweep
        Gives the share of each channel in the objective.
    reports : sequence of PhotometricErrorReport
        One for each capture.

    Returns
    -------
    CaptureErrors
    tuple of str

    Raises
    ------
    DecideError
        A report carries no error of the objective or no angle, is on images that do not belong together, or two are on
        one capture.
    """
    captures, notes = captures_within(sweep, reports)
    groups = _absolute_groups(captures)
    used = [capture for capture in captures if not groups or _scale_key(capture.error) in groups]
    if not used:
        return NO_CAPTURES, tuple(notes)
    notes += _notes_on_scales(captures, groups) + doubts(sweep, used)
    draws = [_log_error_draws(sweep, capture, bool(groups)) for capture in used]
    return CaptureErrors(
        names=tuple(capture.name for capture in used),
        angles_deg=np.array([capture.angle_deg for capture in used]),
        angle_sd_deg=np.array([capture.angle_sd_deg for capture in used]),
        log_error=np.array([d.mean() for d in draws]),
        covariance=_covariance(draws, [capture.error.source for capture in used]),
        scale_of=np.array([groups.index(_scale_key(capture.error)) for capture in used]) if groups else None,
    ), tuple(notes)


def _notes_on_scales(captures: Sequence[ValidatingCapture], groups: Sequence[tuple[str, str] | None]) -> list[str]:
    """Return which captures the scales of absolute ratios leave out, or that there is no such scale."""
    if groups:
        return [
            f"{capture.name} is left out: the other captures are compared by exposure and LED current, and it has none "
            "or no other capture of its rig beside it"
            for capture in captures
            if _scale_key(capture.error) not in groups
        ]
    if _spread_deg([capture.angle_deg for capture in captures if _is_exposed(capture.error)]) < _APART_DEG:
        return []
    return [
        "exposures and LED currents are known at several angles but not compared: the reports do not name one rig "
        "with one set of paints"
    ]


def _scale_key(error: ObjectiveError) -> tuple[str, str] | None:
    """Return what captures with one common scale of absolute ratios share: rig and paints; None where not known."""
    return (error.rig, error.source) if error.rig is not None and _is_exposed(error) else None


def _is_exposed(error: ObjectiveError) -> bool:
    """Return whether exposure and LED current are known."""
    return error.log_exposure_draws is not None


def _spread_deg(angles_deg: Sequence[float]) -> float:
    """Return how far angles lie apart."""
    return max(angles_deg, default=0.0) - min(angles_deg, default=0.0)


def _absolute_groups(captures: Sequence[ValidatingCapture]) -> list[tuple[str, str] | None]:
    """Return the keys of the scales with absolute ratios at two or more angles; None is never among them."""
    angles_deg: dict[tuple[str, str], list[float]] = {}
    for capture in captures:
        key = _scale_key(capture.error)
        if key is not None:
            angles_deg.setdefault(key, []).append(capture.angle_deg)
    return [key for key, found in angles_deg.items() if _spread_deg(found) >= _APART_DEG]


def _log_error_draws(sweep: LightAngleSweep, capture: ValidatingCapture, absolute: bool) -> Floats:
    """Return the draws (D,) of the log error of the sweep's objective."""
    error, ratio = capture.error, capture.error.log_ratio_draws
    if absolute and error.log_exposure_draws is not None:
        ratio = ratio - error.log_exposure_draws[:, None]
    return objective_log_error(ratio, _channel_share(sweep, capture.angle_deg))


def _channel_share(sweep: LightAngleSweep, angle_deg: float) -> Floats:
    """Return the shares (3,) of the channels in the simulated objective at an angle; those at the end beyond it."""
    if sweep.channels is None:
        return np.full(3, 1 / 3)
    share = np.array([np.interp(angle_deg, sweep.angles_deg, c) for c in sweep.channels.mean(axis=1).T])
    return np.asarray(share / share.sum())


def _covariance(draws: Sequence[Floats], sources: Sequence[str]) -> Floats:
    """Return the covariance (N, N) of the means of quantities whose draws are shared within a source."""
    covariance = np.diag(np.full(len(draws), LEAST_SD_REL**2))
    for i, first in enumerate(draws):
        for j, second in enumerate(draws):
            if i == j or (sources[i] == sources[j] and first.shape == second.shape):
                covariance[i, j] += float(((first - first.mean()) * (second - second.mean())).mean())
    return covariance
