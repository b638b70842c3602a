"""How far the simulated objective is from the captured one, from photometric error reports, with covariance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import ObjectiveError, PhotometricErrorReport
from data_schemas.errors import DecideError
from data_schemas.simulate import LightAngleSweep
from finray_calib.compare.checked_comparison import NO_DRIFT

Floats = NDArray[np.float64]

#: Of an angle whose uncertainty nobody stated: a protractor held to a bracket.
UNSTATED_ANGLE_SD_DEG = 2.0
#: No exposure, LED and camera repeat better than this; it also keeps a covariance of few draws regular.
LEAST_SD_REL = 1e-3
#: Two captures closer than this say nothing about the shape of the curve.
_APART_DEG = 2.0
#: A capture further than this beyond the sweep says nothing about the curve inside it.
_BEYOND_DEG = 5.0

Known = tuple[PhotometricErrorReport, ObjectiveError]


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
    _refuse_duplicates(reports)
    known, notes = _within_sweep(sweep, [(report, _error_of(report)) for report in reports])
    groups = _absolute_groups(known)
    used = [(report, error) for report, error in known if not groups or _scale_key(error) in groups]
    if not used:
        return NO_CAPTURES, tuple(notes)
    notes += [
        f"{report.captured} is left out: the other captures are compared by exposure and LED current, and it has none "
        "or no other capture of its rig beside it"
        for report, _ in known
        if all(report is not kept for kept, _ in used)
    ]
    if not groups and _spread_deg([_angle_deg(report) for report, error in known if _is_exposed(error)]) >= _APART_DEG:
        notes.append(
            "exposures and LED currents are known at several angles but not compared: the reports do not name one rig "
            "with one set of paints"
        )
    notes += _doubts(sweep, used)
    angles_deg = np.array([report.light_angle_deg for report, _ in used], dtype=np.float64)
    unstated = [report.captured for report, _ in used if report.light_angle_uncertainty_deg is None]
    if unstated:
        notes.append(
            f"angle of the light, standard uncertainty assumed {UNSTATED_ANGLE_SD_DEG:g} deg: {', '.join(unstated)}"
        )
    draws = [_log_error_draws(sweep, a, error, bool(groups)) for a, (_, error) in zip(angles_deg, used, strict=True)]
    sources = [error.source for _, error in used]
    return CaptureErrors(
        names=tuple(report.captured for report, _ in used),
        angles_deg=angles_deg,
        angle_sd_deg=np.array([_angle_sd_deg(report) for report, _ in used]),
        log_error=np.array([d.mean() for d in draws]),
        covariance=_covariance(draws, sources),
        scale_of=np.array([groups.index(_scale_key(error)) for _, error in used]) if groups else None,
    ), tuple(notes)


def _refuse_duplicates(reports: Sequence[PhotometricErrorReport]) -> None:
    """Refuse two reports on one capture: it would count twice."""
    seen = set()
    for report in reports:
        key = (report.captured, report.light_angle_deg)
        if key in seen:
            raise DecideError(
                f"two reports are on the capture '{report.captured}': the same capture would count twice. Give one "
                "report for each capture; two different captures need different names"
            )
        seen.add(key)


def _error_of(report: PhotometricErrorReport) -> ObjectiveError:
    """Return the error of the objective, or refuse a report without, or on images that do not belong together."""
    if report.forced_mismatch:
        raise DecideError(
            f"the report on {report.captured} was made despite a mismatch, so its brightness error says nothing about "
            f"the simulation ({'; '.join(report.findings)}): mend the capture and compare again, or leave it out"
        )
    if report.objective_error is None and report.values == "linear light":
        raise DecideError(
            f"the report on {report.captured} carries no brightness error, because the render holds no draws of its "
            "paints and camera: render it with 'finray simulate --paint' and compare again"
        )
    if report.objective_error is None:
        raise DecideError(
            f"the report on {report.captured} carries no brightness error, because its values are "
            f"'{report.values}': give a report on a capture in linear light (raw frames)"
        )
    if report.light_angle_deg is None:
        raise DecideError(
            f"the report on {report.captured} names no angle of the light, so it says nothing about the curve: write "
            "light_angle_deg (-180 to 180 deg) into the capture and compare again"
        )
    return report.objective_error


def _within_sweep(sweep: LightAngleSweep, known: Sequence[Known]) -> tuple[list[Known], list[str]]:
    """Return the reports on captures at angles of the sweep, and a note on each of the others."""
    first, last = sweep.angles_deg[0], sweep.angles_deg[-1]
    kept, notes = [], []
    for report, error in known:
        angle_deg = _angle_deg(report)
        if first - _BEYOND_DEG <= angle_deg <= last + _BEYOND_DEG:
            kept.append((report, error))
        else:
            notes.append(
                f"{report.captured} is left out: its light stood at {angle_deg:g} deg, outside the sweep ({first:g} to "
                f"{last:g} deg), so the decision is not validated by it"
            )
    return kept, notes


def _doubts(sweep: LightAngleSweep, used: Sequence[Known]) -> list[str]:
    """Return what the checks of the comparisons found, and paints of the sweep that a render does not name."""
    notes = [
        f"{report.captured}: {finding}"
        for report, _ in used
        for finding in report.findings
        if not finding.startswith(NO_DRIFT)
    ]
    for colour, sha256 in sorted(sweep.paints.items()):
        without = [report.captured for report, error in used if sha256 not in error.source]
        if without:
            notes.append(
                f"the {colour} paint of the sweep (SHA-256 {sha256}) is not named by the reports on "
                f"{', '.join(without)}: their renders may have another paint"
            )
    return notes


def _scale_key(error: ObjectiveError) -> tuple[str, str] | None:
    """Return what captures with one common scale of absolute ratios share: rig and paints; None where not known."""
    return (error.rig, error.source) if error.rig is not None and _is_exposed(error) else None


def _is_exposed(error: ObjectiveError) -> bool:
    """Return whether exposure and LED current are known."""
    return error.log_exposure_draws is not None


def _spread_deg(angles_deg: Sequence[float]) -> float:
    """Return how far angles lie apart."""
    return max(angles_deg, default=0.0) - min(angles_deg, default=0.0)


def _absolute_groups(known: Sequence[Known]) -> list[tuple[str, str] | None]:
    """Return the keys of the scales with absolute ratios at two or more angles; None is never among them."""
    angles_deg: dict[tuple[str, str], list[float]] = {}
    for report, error in known:
        key = _scale_key(error)
        if key is not None:
            angles_deg.setdefault(key, []).append(_angle_deg(report))
    return [key for key, found in angles_deg.items() if _spread_deg(found) >= _APART_DEG]


def _angle_deg(report: PhotometricErrorReport) -> float:
    """Return the angle, which `_error_of` has looked for."""
    return np.nan if report.light_angle_deg is None else report.light_angle_deg


def _angle_sd_deg(report: PhotometricErrorReport) -> float:
    """Return the standard uncertainty of the angle."""
    stated = report.light_angle_uncertainty_deg
    return UNSTATED_ANGLE_SD_DEG if stated is None else stated


def _log_error_draws(sweep: LightAngleSweep, angle_deg: float, error: ObjectiveError, absolute: bool) -> Floats:
    """Return the draws (D,) of the log error of the sweep's objective."""
    ratio = error.log_ratio_draws
    if absolute and error.log_exposure_draws is not None:
        ratio = ratio - error.log_exposure_draws[:, None]
    return objective_log_error(ratio, _channel_share(sweep, angle_deg))


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
