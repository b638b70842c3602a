r"""Band signals with covariance from the steps of a paint session.

With F the sample under the laser, W the white reference under the lamp, S the sample under the lamp and V_c
the white reference under the laser through the excitation filter e (all linear, DN/s):

.. math::
    y_{bc} = \frac{F_{bc} / W_{bc}}{V}, \qquad V = \sum_c w_c \frac{V_c}{W_{ec}}, \qquad
    \rho_{bc} = R_w \frac{S_{bc}}{W_{bc}}

Under the laser the white reference sends almost nothing through the 500-660 nm filters, so y is referred to
the white under the *lamp* in the same filter, and to the laser only where the white reflects it. The pixel
non-uniformity and the overall transmission of each filter cancel; an uneven laser spot cancels as long as
the paint is uniform over the region.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, FrameType
from data_schemas.errors import RadiometryError
from data_schemas.radiometry import BandSignals, Flag, Optics
from finray_calib.radiometry.region import region_channels
from finray_calib.radiometry.step_signals import (
    LARGEST_SATURATED_FRACTION,
    ReadFrame,
    StepKey,
    StepSignal,
    dark_levels,
    step_signals,
)

Floats = NDArray[np.float64]
SMALLEST_WHITE_SNR = 30.0
# The repeatability of lamp and laser is never taken as better than this: a handful of log ratios cannot show it.
SMALLEST_REPEATABILITY_REL = 5e-4


@dataclass(frozen=True, slots=True)
class _Table:
    """Signals of one frame type over (filter, channel): value, noise variance, shares of the exposures per filter."""

    signal: Floats
    variance: Floats
    shares: tuple[Floats, ...]
    saturated: Floats


def band_signals(session: CaptureSession, read: ReadFrame) -> BandSignals:
    """Turn a paint session into fluorescence and reflectance per filter and channel, with covariance.

    Parameters
    ----------
    session
        A finished paint session.
    read
        Returns the raw counts of a frame of the session (checks its checksum).

    Raises
    ------
    RadiometryError
        A step, a dark frame or a whole band is missing or saturated, or the region is empty.
    """
    names = [f.name for f in session.rig.filter_wheel.filters if _is_planned(session, f.name)]
    darks = dark_levels(session, read)
    if not darks:
        raise RadiometryError("session.frames: no dark frames; capture darks before and after the session")
    steps = step_signals(session, read, darks)
    white, lamp, laser = (_table(session, steps, kind, names) for kind in ("white", "reflectance", "fluorescence"))
    if session.plan.excitation_filter not in names:
        raise RadiometryError(
            f"session.plan.excitation_filter: {session.plan.excitation_filter!r} is none of the captured filters "
            f"({', '.join(names)})"
        )
    excitation = names.index(session.plan.excitation_filter)
    laser_white = _table(session, steps, "laser white", [session.plan.excitation_filter])
    repeatability = _repeatability_rel(steps)
    flags = _flags(white, lamp, laser)
    weights = _channel_weights(laser_white, white, excitation)
    y, y_covariance = _fluorescence(laser, white, laser_white, weights, excitation, repeatability)
    reference = session.rig.white_reference
    y_covariance += reference.uncertainty_rel**2 * np.outer(y, y)
    rho, rho_covariance = _reflectance(lamp, white, reference.reflectance, repeatability)
    rho_covariance += reference.uncertainty_rel**2 * np.outer(rho, rho)
    drift = max(abs(d.drift_dn) for d in darks.values())
    return BandSignals(
        paint_name=session.plan.paint_name,
        optics=_optics(session, names),
        fluorescence=y.reshape(-1, 3),
        fluorescence_covariance=y_covariance,
        reflectance=rho.reshape(-1, 3),
        reflectance_covariance=rho_covariance,
        channel_weights=weights,
        flags=flags,
        saturated_fraction=np.maximum(np.maximum(white.saturated, lamp.saturated), laser.saturated),
        region_pixels=_region_pixels(session, read),
        notes=(
            *session.notes,
            f"light repeatability from exposure brackets: {100 * repeatability:.2f} % per exposure",
            f"largest dark drift from before to after: {drift:.3f} DN",
        ),
    )


def _is_planned(session: CaptureSession, name: str) -> bool:
    """Return whether a filter of the wheel is part of the plan."""
    return session.plan.filters is None or name in session.plan.filters


def _region_pixels(session: CaptureSession, read: ReadFrame) -> int:
    """Return the number of raw pixels in the region."""
    return sum(c.size for c in region_channels(read(session.frames[0]), session.plan.region))


def _optics(session: CaptureSession, names: list[str]) -> Optics:
    """Return the known curves of the rig for the captured filters."""
    return Optics(
        filters=tuple(f for f in session.rig.filter_wheel.filters if f.name in names),
        excitation_filter=session.plan.excitation_filter,
        laser=session.rig.laser,
        lamp=session.lamp,
        white_reference=session.rig.white_reference,
        camera_response=session.camera_response,
    )


def _table(session: CaptureSession, steps: dict[StepKey, StepSignal], kind: FrameType, names: list[str]) -> _Table:
    """Collect one frame type over the filters; a missing step or a wholly saturated band is an error."""
    rows = []
    for name in names:
        step = steps.get((kind, name))
        if step is None:
            raise RadiometryError(
                f"session.frames: no '{kind}' frame through filter {name}; capture the session again with this filter"
            )
        if np.isnan(step.signal_dn_per_s).all():
            frame = next(f for f in session.frames if f.frame_type == kind and f.filter_name == name)
            raise RadiometryError(
                f"{frame.file}: filter {name} is saturated in all channels and exposures ('{kind}', "
                f"{step.saturated_fraction.min():.1%} of the region at full scale, at most "
                f"{LARGEST_SATURATED_FRACTION:.2%} is allowed): capture again with a lower plan.target_fraction or "
                "a shorter exposure in plan.bracket"
            )
        rows.append(step)
    return _Table(
        signal=np.array([r.signal_dn_per_s for r in rows]),
        variance=np.array([r.variance for r in rows]),
        shares=tuple(r.shares for r in rows),
        saturated=np.array([r.saturated_fraction for r in rows]),
    )


def _repeatability_rel(steps: dict[StepKey, StepSignal]) -> float:
    """Return the relative repeatability of one exposure (lamp or laser), from the log ratios of brackets."""
    ratios = np.array([r for s in steps.values() for r in s.log_ratios])
    noise = np.array([v for s in steps.values() for v in s.log_ratio_noise_variance])
    bright = noise < (0.01) ** 2  # dim steps would only add photon noise
    if bright.sum() < 3:
        return 0.005  # too few brackets to tell: assume half a per cent
    excess = float(np.mean(ratios[bright] ** 2 - noise[bright])) / 2
    return float(np.sqrt(max(excess, SMALLEST_REPEATABILITY_REL**2)))


def _flags(*tables: _Table) -> tuple[tuple[Flag, Flag, Flag], ...]:
    """Flag each filter and channel: saturated, weak (white too dim to divide by) or ok."""
    white = tables[0]
    lost = np.logical_or.reduce([np.isnan(t.signal) for t in tables])
    weak = ~(white.signal > SMALLEST_WHITE_SNR * np.sqrt(white.variance))
    rows: list[tuple[Flag, Flag, Flag]] = []
    for b in range(len(white.signal)):
        one: list[Flag] = ["saturated" if lost[b, c] else "weak" if weak[b, c] else "ok" for c in range(3)]
        rows.append((one[0], one[1], one[2]))
    return tuple(rows)


def _channel_weights(laser_white: _Table, white: _Table, excitation: int) -> Floats:
    """Return inverse-variance weights (sum 1) of the channels for the laser level V."""
    v, w = laser_white.signal[0], white.signal[excitation]
    relative = laser_white.variance[0] / v**2 + white.variance[excitation] / w**2
    good = np.isfinite(relative) & (v > 0) & (w > 0)
    weight = np.where(good, 1 / np.where(good, relative * (v / w) ** 2, 1.0), 0.0)
    if weight.sum() == 0:
        raise RadiometryError(
            "the white reference under the laser gives no signal through the excitation filter: is the laser on the "
            "tile, and does plan.excitation_filter name the filter of the laser line?"
        )
    return np.asarray(weight / weight.sum())


def _step_covariance(table: _Table, repeatability: float) -> Floats:
    """Return the covariance of a table's signals: noise on the diagonal, and each exposure's own light level."""
    signal = np.nan_to_num(table.signal)
    n = signal.size
    covariance = np.diag(np.nan_to_num(table.variance).ravel())
    for b in range(len(signal)):
        block = slice(3 * b, 3 * b + 3)
        common = table.shares[b].T @ table.shares[b]
        covariance[block, block] += repeatability**2 * common * np.outer(signal[b], signal[b])
    return covariance.reshape(n, n)


def _fluorescence(
    laser: _Table, white: _Table, laser_white: _Table, weights: Floats, excitation: int, repeatability: float
) -> tuple[Floats, Floats]:
    """Return y (n,) and its covariance (n, n) by first-order propagation; NaN signals become 0 (flagged)."""
    f, w = np.nan_to_num(laser.signal).ravel(), _safe(white.signal).ravel()
    v_c, w_e = np.nan_to_num(laser_white.signal[0]), _safe(white.signal[excitation])
    level = float((weights * v_c / w_e).sum())
    y = f / w / level
    n = len(y)
    to_f, to_w = np.diag(1 / (w * level)), np.diag(-y / w)
    to_v = np.outer(-y / level, weights / w_e)
    to_w[:, 3 * excitation : 3 * excitation + 3] += np.outer(-y / level, -weights * v_c / w_e**2)
    covariance = np.zeros((n, n))
    for jacobian, table in ((to_f, laser), (to_w, white), (to_v, laser_white)):
        covariance += jacobian @ _step_covariance(table, repeatability) @ jacobian.T
    return y, covariance


def _reflectance(lamp: _Table, white: _Table, reference: float, repeatability: float) -> tuple[Floats, Floats]:
    """Return the total radiance factor (n,) and its covariance (n, n)."""
    s, w = np.nan_to_num(lamp.signal).ravel(), _safe(white.signal).ravel()
    rho = reference * s / w
    to_s, to_w = np.diag(reference / w), np.diag(-rho / w)
    covariance = to_s @ _step_covariance(lamp, repeatability) @ to_s.T
    return rho, covariance + to_w @ _step_covariance(white, repeatability) @ to_w.T


def _safe(signal: Floats) -> Floats:
    """Replace unusable (NaN, zero or negative) denominators by 1; their entries carry a flag."""
    return np.where(np.isfinite(signal) & (signal > 0), signal, 1.0)
