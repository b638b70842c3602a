"""All merged steps of a paint session, checked for what is missing or lost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, FrameType
from data_schemas.errors import RadiometryError
from finray_calib.radiometry.dark_levels import DarkLevel, ReadFrame, dark_levels
from finray_calib.radiometry.step_signals import (
    LARGEST_SATURATED_FRACTION,
    ExposureSignal,
    StepKey,
    StepSignal,
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
            f"session.plan.excitation_filter: {session.plan.excitation_filter!r} is none of the captured filters "
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
                f"session.frames: no '{kind}' frame through filter {name}; capture the session again with this filter"
            )
        if np.isnan(step.signal_dn_per_s).all():
            raise RadiometryError(
                f"{step.exposures[0].frame.file}: filter {name} is saturated in all channels and exposures ('{kind}', "
                f"{step.saturated_fraction.min():.1%} of the region at full scale, at most "
                f"{LARGEST_SATURATED_FRACTION:.2%} is allowed): capture again with a lower plan.target_fraction or "
                "a shorter exposure in plan.bracket"
            )
        found.append(step)
    return tuple(found)
