"""How far the simulated objective is from the captured one, from photometric error reports, with covariance.

Only captures that validate the sweep count: they must be on its finger, since errors of another one say nothing about
its curve, and some reports are refused, left out or doubtful.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import DecideError, LightAngleSweep, ObjectiveError, PhotometricErrorReport, finger_identity
from finray_calib.compare import NO_DRIFT

#: Of an angle whose uncertainty nobody stated: a protractor held to a bracket.
UNSTATED_ANGLE_SD_DEG = 2.0
#: A capture further than this beyond the sweep says nothing about the curve inside it.
_BEYOND_DEG = 5.0
#: In the labels of renders whose walls emit alike whatever the light's angle is.
_PAPER_EMITTER = "level a"


@dataclass(frozen=True, slots=True)
class ValidatingCapture:
    """Hold what a report says of one capture.

    Attributes
    ----------
    name : str
        What was captured.
    angle_deg : float
        Of the light.
    stated_angle_sd_deg : float or None
        Its standard uncertainty, None where nobody stated it.
    error : ObjectiveError
        Of the sweep's objective.
    findings : tuple of str
        Of the checks before the comparison.
    contact : int
        Number of the sweep whose touch was captured.
    """

    name: str
    angle_deg: float
    stated_angle_sd_deg: float | None
    error: ObjectiveError
    findings: tuple[str, ...]
    contact: int

    @property
    def angle_sd_deg(self) -> float:
        """Standard uncertainty of the angle, assumed where nobody stated it."""
        return UNSTATED_ANGLE_SD_DEG if self.stated_angle_sd_deg is None else self.stated_angle_sd_deg


def captures_within(
    sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport], contacts: Sequence[int]
) -> tuple[list[ValidatingCapture], list[str]]:
    """Return the captures at angles of a sweep, and a note on each of the others; `contacts` numbers their touches.

    Raises
    ------
    DecideError
        A report carries no error of the objective or no angle, is on images that do not belong together or on a render
        by the paper's emitter, or two are on one capture.
    """
    _refuse_duplicates(reports)
    first, last = sweep.angles_deg[0], sweep.angles_deg[-1]
    kept, notes = [], []
    for capture in [_capture_of(report, contact) for report, contact in zip(reports, contacts, strict=True)]:
        if first - _BEYOND_DEG <= capture.angle_deg <= last + _BEYOND_DEG:
            kept.append(capture)
        else:
            notes.append(
                f"{capture.name} is left out and does not validate the decision, because its light was at "
                f"{capture.angle_deg:g} deg, outside the sweep ({first:g} to {last:g} deg)"
            )
    return kept, notes


def doubts(sweep: LightAngleSweep, captures: Sequence[ValidatingCapture]) -> list[str]:
    """Return what the comparisons' checks found, paints that a render does not name, and angles assumed uncertain."""
    notes = [f"{c.name}: {finding}" for c in captures for finding in c.findings if not finding.startswith(NO_DRIFT)]
    for colour, sha256 in sorted(sweep.paints.items()):
        without = [capture.name for capture in captures if sha256 not in capture.error.source]
        if without:
            notes.append(
                f"the reports on {', '.join(without)} do not name the {colour} paint of the sweep (SHA-256 {sha256}), "
                "so their renders may have another paint"
            )
    unstated = [capture.name for capture in captures if capture.stated_angle_sd_deg is None]
    if unstated:
        notes.append(
            f"the standard uncertainty of the light's angle is assumed to be {UNSTATED_ANGLE_SD_DEG:g} deg for these "
            f"captures, which state none: {', '.join(unstated)}"
        )
    return notes


def _refuse_duplicates(reports: Sequence[PhotometricErrorReport]) -> None:
    """Refuse two reports on one capture: it would count twice."""
    seen = set()
    for report in reports:
        key = (report.captured, report.light_angle_deg)
        if key in seen:
            raise DecideError(
                f"two reports are on the capture '{report.captured}', which would count twice. Give one report for "
                "each capture, and different captures different names"
            )
        seen.add(key)


def _capture_of(report: PhotometricErrorReport, contact: int) -> ValidatingCapture:
    """Return the capture of a report on a touch.

    Raises
    ------
    DecideError
        It has no error or angle, its images do not belong together, or its render is not one of the sweep's level.
    """
    if _PAPER_EMITTER in report.label:
        raise DecideError(
            f"the report on {report.captured} belongs to a render of level a ('{report.label}'), whose walls emit the "
            "same at every angle of the light, so its error cannot validate a sweep of level b. Simulate the press "
            "with --level b (the default) and compare again, or leave the report out"
        )
    if report.forced_mismatch:
        raise DecideError(
            f"the report on {report.captured} was made despite a mismatch ({'; '.join(report.findings)}), so its "
            "brightness error is not that of the simulation; correct the capture and compare again, or leave the "
            "report out"
        )
    if report.relative:
        raise DecideError(
            f"the report on {report.captured} is relative, so it judges how the image changes by contact, but not the "
            "illumination of the render, on which the decision depends. Compare again without --relative, or leave "
            "the report out"
        )
    if report.objective_error is None and (report.values == "linear light" or report.tone_curve is not None):
        raise DecideError(
            f"the report on {report.captured} contains no brightness error, because the render has no draws of its "
            "paints and camera; render the press with 'finray simulate render --paint' and compare again"
        )
    if report.objective_error is None:
        raise DecideError(
            f"the report on {report.captured} contains no brightness error, because its values are '{report.values}' "
            "on both sides; render the press in linear light ('finray simulate render') and compare again"
        )
    if report.light_angle_deg is None:
        raise DecideError(
            f"the report on {report.captured} does not state the angle of the light, so it cannot be placed on the "
            "curve; write light_angle_deg (-180 to 180 deg) into the capture and compare again"
        )
    return ValidatingCapture(
        report.captured,
        report.light_angle_deg,
        report.light_angle_uncertainty_deg,
        report.objective_error,
        report.findings,
        contact,
    )


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
    contact_of : ndarray of int, shape (N,), or None
        Number of the place that was touched. None: there is one place.
    """

    names: tuple[str, ...]
    angles_deg: Floats
    angle_sd_deg: Floats
    log_error: Floats
    covariance: Floats
    scale_of: NDArray[np.int64] | None
    contact_of: NDArray[np.int64] | None = None

    @property
    def contact(self) -> NDArray[np.int64]:
        """Number of the place of each capture, shape (N,)."""
        return np.zeros(self.angles_deg.size, dtype=np.int64) if self.contact_of is None else self.contact_of


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
    sweeps: Sequence[LightAngleSweep], reports: Sequence[PhotometricErrorReport], contacts: Sequence[int]
) -> tuple[CaptureErrors, tuple[str, ...]]:
    """Return what reports say about the objective of sweeps, and notes on what was left out or assumed.

    Where two captures of one rig at different angles carry exposure and LED current, absolute ratios are compared, up
    to a common scale of the rig; captures without are then left out. Else each error is relative to the no-contact
    image of its own capture. Captures more than 5 deg beyond the sweep are left out. Reports of one source share their
    draws, so their covariance is that of the draws; others are independent.

    Parameters
    ----------
    sweeps : sequence of LightAngleSweep
        One of each touch; they give the share of each channel in the objective.
    reports : sequence of PhotometricErrorReport
        One for each capture.
    contacts : sequence of int
        Number of the sweep that each report belongs to.

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
    captures, notes = captures_within(sweeps[0], reports, contacts)
    groups = _absolute_groups(captures)
    used = [capture for capture in captures if not groups or _scale_key(capture.error) in groups]
    if not used:
        return NO_CAPTURES, tuple(notes)
    notes += _notes_on_scales(captures, groups) + doubts(sweeps[0], used)
    draws = [_log_error_draws(sweeps[capture.contact], capture, bool(groups)) for capture in used]
    return CaptureErrors(
        names=tuple(capture.name for capture in used),
        angles_deg=np.array([capture.angle_deg for capture in used]),
        angle_sd_deg=np.array([capture.angle_sd_deg for capture in used]),
        log_error=np.array([d.mean() for d in draws]),
        covariance=_covariance(draws, [capture.error.source for capture in used]),
        scale_of=np.array([groups.index(_scale_key(capture.error)) for capture in used]) if groups else None,
        contact_of=np.array([capture.contact for capture in used], dtype=np.int64),
    ), tuple(notes)


def _notes_on_scales(captures: Sequence[ValidatingCapture], groups: Sequence[tuple[str, str] | None]) -> list[str]:
    """Return which captures the scales of absolute ratios leave out, or that there is no such scale."""
    if groups:
        return [
            f"{capture.name} is left out: the other captures are compared by exposure and LED current, and it states "
            f"none, or it is the only capture of its rig"
            for capture in captures
            if _scale_key(capture.error) not in groups
        ]
    if _spread_deg([capture.angle_deg for capture in captures if _is_exposed(capture.error)]) < _APART_DEG:
        return []
    return [
        "exposures and LED currents are known at several angles but were not compared, because the "
        "reports do not name one rig with one set of paints"
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


#: Depths this near are one press: what is typed into two files.
_SAME_DEPTH_MM = 1e-6


def require_one_finger(
    sweeps: Sequence[LightAngleSweep], reports: Sequence[PhotometricErrorReport]
) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Refuse reports on another finger or touch than the sweeps', and return notes and the sweep of each report.

    The angle of the light is what a sweep varies, the depth of the press what a session varies: neither makes another
    finger, but another depth is told.

    Returns
    -------
    tuple of str
        What cannot be told.
    tuple of int
        Number of the sweep that each report belongs to.

    Raises
    ------
    DecideError
        A report is on another finger, or with another light or indenter.
    """
    notes: list[str] = []
    found = []
    for report in reports:
        number, told = _sweep_of(sweeps, report)
        found.append(number)
        notes += told
    return tuple(notes), tuple(found)


def _sweep_of(sweeps: Sequence[LightAngleSweep], report: PhotometricErrorReport) -> tuple[int, list[str]]:
    """Return the number of the sweep that a report belongs to, and notes on what cannot be told."""
    owns = [finger_identity(sweep.design) for sweep in sweeps]
    first = owns[0]
    if report.finger is None:
        return 0, [
            f"the report on {report.captured} does not say which finger was rendered (an older version wrote the "
            f"report, or the press has no design), so it was not checked whether it is '{first.name}'; compare again, "
            "with a press that has a design, to have it checked"
        ]
    if report.finger.version != first.version:
        return 0, [
            f"the report on {report.captured} identifies its finger '{report.finger.name}' by the rules of another "
            f"version of finray, so it was not checked whether it is '{first.name}'; compare again to have it checked"
        ]
    others = [report.finger.differs_in(own) for own in owns]
    pushed_mm = report.finger.depth_mm
    number = min(range(len(owns)), key=lambda k: (len(others[k]), abs(pushed_mm - owns[k].depth_mm)))
    own, other = owns[number], others[number]
    if other:
        raise DecideError(
            f"the report on {report.captured} is on the finger '{report.finger.name}', but the sweep "
            f"'{sweeps[number].name}' is on the finger '{own.name}', which differs in {', '.join(other)}, and the "
            "error of one finger does not apply to another. Simulate and compare the capture with the sweep's design, "
            "or leave the report out"
        )
    if abs(pushed_mm - own.depth_mm) <= _SAME_DEPTH_MM:
        return number, []
    return number, [
        f"the render compared with {report.captured} was pressed {pushed_mm:g} mm deep, and the sweep "
        f"{own.depth_mm:g} mm: its error belongs to another depth"
    ]
