"""Captures that validate a sweep: which reports speak about its curve, which are refused, left out or doubtful."""

from collections.abc import Sequence
from dataclasses import dataclass

from data_schemas.compare import ObjectiveError, PhotometricErrorReport
from data_schemas.errors import DecideError
from data_schemas.simulate import LightAngleSweep
from finray_calib.compare.checked_comparison import NO_DRIFT

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
    """

    name: str
    angle_deg: float
    stated_angle_sd_deg: float | None
    error: ObjectiveError
    findings: tuple[str, ...]

    @property
    def angle_sd_deg(self) -> float:
        """Standard uncertainty of the angle, assumed where nobody stated it."""
        return UNSTATED_ANGLE_SD_DEG if self.stated_angle_sd_deg is None else self.stated_angle_sd_deg


def captures_within(
    sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport]
) -> tuple[list[ValidatingCapture], list[str]]:
    """Return the captures at angles of a sweep, and a note on each of the others.

    Raises
    ------
    DecideError
        A report carries no error of the objective or no angle, is on images that do not belong together or on a render
        by the paper's emitter, or two are on one capture.
    """
    _refuse_duplicates(reports)
    first, last = sweep.angles_deg[0], sweep.angles_deg[-1]
    kept, notes = [], []
    for capture in [_capture_of(report) for report in reports]:
        if first - _BEYOND_DEG <= capture.angle_deg <= last + _BEYOND_DEG:
            kept.append(capture)
        else:
            notes.append(
                f"{capture.name} is left out: its light stood at {capture.angle_deg:g} deg, outside the sweep "
                f"({first:g} to {last:g} deg), so the decision is not validated by it"
            )
    return kept, notes


def doubts(sweep: LightAngleSweep, captures: Sequence[ValidatingCapture]) -> list[str]:
    """Return what the comparisons' checks found, paints that a render does not name, and angles assumed uncertain."""
    notes = [f"{c.name}: {finding}" for c in captures for finding in c.findings if not finding.startswith(NO_DRIFT)]
    for colour, sha256 in sorted(sweep.paints.items()):
        without = [capture.name for capture in captures if sha256 not in capture.error.source]
        if without:
            notes.append(
                f"the {colour} paint of the sweep (SHA-256 {sha256}) is not named by the reports on "
                f"{', '.join(without)}: their renders may have another paint"
            )
    unstated = [capture.name for capture in captures if capture.stated_angle_sd_deg is None]
    if unstated:
        notes.append(
            f"angle of the light, standard uncertainty assumed {UNSTATED_ANGLE_SD_DEG:g} deg: {', '.join(unstated)}"
        )
    return notes


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


def _capture_of(report: PhotometricErrorReport) -> ValidatingCapture:
    """Return the capture of a report.

    Raises
    ------
    DecideError
        It has no error or angle, its images do not belong together, or its render is not one of the sweep's level.
    """
    if _PAPER_EMITTER in report.label:
        raise DecideError(
            f"the report on {report.captured} is of a render by level a ('{report.label}'), the sweep is of level b: "
            "walls of level a emit alike at every angle of the light, so their error says nothing about the curve. "
            "Simulate the press with --level b (the default) and compare again, or leave the report out"
        )
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
    return ValidatingCapture(
        report.captured,
        report.light_angle_deg,
        report.light_angle_uncertainty_deg,
        report.objective_error,
        report.findings,
    )
