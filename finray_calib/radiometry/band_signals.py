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

The covariance is :math:`J C J^T` with the Jacobian J of these formulas and the covariance C of all signals
(:mod:`~finray_calib.radiometry.signal_covariance`), plus what is common to all bands: the white reference, the
texture of paint and tile, and bleaching. A wrong gain of the camera cancels in every ratio.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession
from data_schemas.radiometry import BandSignals, Flag, Optics
from finray_calib.radiometry.bleaching import BleachingTrend, bleaching_note, bleaching_trend, refuse_other_repeat
from finray_calib.radiometry.dark_levels import ReadFrame
from finray_calib.radiometry.diffuse_test import tilt_note, tilt_ratios
from finray_calib.radiometry.laser_level import channel_weights, laser_level, positive
from finray_calib.radiometry.region import whole_cells
from finray_calib.radiometry.session_steps import SessionSteps, captured_filters, session_steps, signals_of
from finray_calib.radiometry.signal_covariance import signal_covariance
from finray_calib.radiometry.step_signals import StepSignal
from finray_calib.radiometry.uniformity import texture_variance_rel

Floats = NDArray[np.float64]
SMALLEST_WHITE_SNR = 30.0
# No lamp that is fit for this work falls off by half within the region; a block beyond the tile's edge is darker still.
SMALLEST_BLOCK_REL = 0.5


@dataclass(frozen=True, slots=True)
class _Values:
    """Values over the flattened (filter, channel) index, their covariance, and the sd of texture in them."""

    values: Floats
    covariance: Floats
    texture_sd_rel: float


def band_signals(session: CaptureSession, read: ReadFrame) -> BandSignals:
    """Turn a paint session into fluorescence and reflectance per filter and channel, with covariance.

    Frames are read one at a time; memory does not grow with their number.

    Parameters
    ----------
    session
        A finished paint session.
    read
        Returns the raw counts of a frame of the session (checks its checksum).

    Raises
    ------
    RadiometryError
        A step, a dark frame or a whole band is missing or saturated, the region is empty, or a filter and its own
        repeat disagree.
    """
    return bands_of_steps(session, session_steps(session, read))


def bands_of_steps(session: CaptureSession, steps: SessionSteps, accept_repeat: bool = False) -> BandSignals:
    """Return the band signals of a session whose steps are merged already (:func:`session_steps`).

    Parameters
    ----------
    session, steps
        A finished paint session and its merged steps.
    accept_repeat
        Whether a repeat that disagrees with its filter as no fading does is taken all the same.

    Raises
    ------
    RadiometryError
        No channel sees the laser on the white reference, or a filter and its own repeat disagree.
    """
    weights = channel_weights(steps)
    trend = bleaching_trend(steps)
    if trend is not None and not accept_repeat:
        refuse_other_repeat(trend, steps)
    y = _fluorescence(steps, weights, trend, session.rig.white_reference.uncertainty_rel)
    rho = _reflectance(steps, session)
    cells = whole_cells(session.plan.region)
    ratios = tilt_ratios(steps, trend)
    tables = (steps.white, steps.reflectance, steps.fluorescence)
    return BandSignals(
        paint_name=session.plan.paint_name,
        optics=optics_of(session),
        fluorescence=y.values.reshape(-1, 3),
        fluorescence_covariance=y.covariance,
        reflectance=rho.values.reshape(-1, 3),
        reflectance_covariance=rho.covariance,
        channel_weights=weights,
        flags=_flags(*tables),
        saturated_fraction=np.max([[s.saturated_fraction for s in table] for table in tables], axis=0),
        region_pixels=cells.height_px * cells.width_px,
        bleaching=None if trend is None else trend.record,
        tilt_ratios=ratios,
        notes=(
            *session.notes,
            f"light repeatability from exposure brackets: {100 * steps.repeatability_rel:.2f} % per exposure",
            f"largest dark drift from before to after: {max(abs(d.drift_dn) for d in steps.darks.values()):.3f} DN",
            f"texture of paint and white tile: {100 * y.texture_sd_rel:.2f} % of every band alike",
            *_beyond_the_tile(steps),
            *([] if trend is None else [bleaching_note(trend.record)]),
            *map(tilt_note, ratios),
        ),
    )


def optics_of(session: CaptureSession) -> Optics:
    """Return the known curves of the rig for the captured filters."""
    names = captured_filters(session)
    filters = tuple(f for f in session.rig.filter_wheel.filters if f.name in names)
    return Optics(
        filters=filters,
        excitation_filter=session.plan.excitation_filter,
        laser=session.rig.laser,
        lamp=session.lamp,
        white_reference=session.rig.white_reference,
        camera_response=session.camera_response,
        filter_curves={f.name: session.filter_curves[f.name] for f in filters if f.curve is not None},
    )


def _flags(*tables: tuple[StepSignal, ...]) -> tuple[tuple[Flag, Flag, Flag], ...]:
    """Flag each filter and channel: saturated, weak (white, the first table, too dim to divide by) or ok."""
    lost = np.logical_or.reduce([np.isnan(signals_of(table)) for table in tables])
    noise = np.array([step.noise_variance for step in tables[0]])
    weak = ~(signals_of(tables[0]) > SMALLEST_WHITE_SNR * np.sqrt(noise))
    rows: list[tuple[Flag, Flag, Flag]] = []
    for b in range(len(lost)):
        one: list[Flag] = ["saturated" if lost[b, c] else "weak" if weak[b, c] else "ok" for c in range(3)]
        rows.append((one[0], one[1], one[2]))
    return tuple(rows)


def _fluorescence(
    steps: SessionSteps, weights: Floats, trend: BleachingTrend | None, white_uncertainty_rel: float
) -> _Values:
    """Return y by first-order propagation; NaN signals become 0 (flagged)."""
    f, w = np.nan_to_num(signals_of(steps.fluorescence)).ravel(), positive(signals_of(steps.white)).ravel()
    v, w_e = np.nan_to_num(steps.laser_white.signal_dn_per_s), w.reshape(-1, 3)[steps.excitation]
    level = laser_level(steps, weights)
    correction = np.ones(len(f)) if trend is None else trend.correction().ravel()
    y = correction * f / w / level
    to_w = np.diag(-y / w)
    to_w[:, 3 * steps.excitation : 3 * steps.excitation + 3] += np.outer(y / level, weights * v / w_e**2)
    jacobian = [np.diag(correction / w / level), to_w, np.outer(-y / level, weights / w_e)]
    sources = [*steps.fluorescence, *steps.white, steps.laser_white]
    unresolved = np.zeros(len(y))
    if trend is not None and steps.repeat is not None:
        unresolved = trend.unresolved_sd_rel().ravel() * y
        if trend.record.resolved:
            _add_trend(jacobian, steps, trend, y)
            sources.append(steps.repeat)
    to_signals = np.concatenate(jacobian, axis=1)
    signals = signal_covariance(sources, steps.darks, steps.repeatability_rel)
    texture = _texture_variance_rel(steps, steps.fluorescence, True)
    common = (white_uncertainty_rel**2 + texture) * np.outer(y, y) + np.outer(unresolved, unresolved)
    return _Values(y, to_signals @ signals @ to_signals.T + common, float(np.sqrt(texture)))


def _add_trend(jacobian: list[Floats], steps: SessionSteps, trend: BleachingTrend, y: Floats) -> None:
    """Add how the corrected y follows the two measurements of the trend: F in place, the repeat as a new block."""
    lever_j = trend.dose_j.ravel() * y
    first = positive(steps.fluorescence[trend.filter_index].signal_dn_per_s)
    again = positive(steps.repeat.signal_dn_per_s) if steps.repeat is not None else first
    block = slice(3 * trend.filter_index, 3 * trend.filter_index + 3)
    jacobian[0][:, block] += np.outer(lever_j, trend.log_weight / first)
    jacobian.append(np.outer(-lever_j, trend.log_weight / again))


def _reflectance(steps: SessionSteps, session: CaptureSession) -> _Values:
    """Return the total radiance factor by first-order propagation."""
    white = session.rig.white_reference
    s, w = np.nan_to_num(signals_of(steps.reflectance)).ravel(), positive(signals_of(steps.white)).ravel()
    rho = white.reflectance * s / w
    jacobian = np.concatenate([np.diag(white.reflectance / w), np.diag(-rho / w)], axis=1)
    signals = signal_covariance((*steps.reflectance, *steps.white), steps.darks, steps.repeatability_rel)
    texture = _texture_variance_rel(steps, steps.reflectance, False)
    common = (white.uncertainty_rel**2 + texture) * np.outer(rho, rho)
    return _Values(rho, jacobian @ signals @ jacobian.T + common, float(np.sqrt(texture)))


def _beyond_the_tile(steps: SessionSteps) -> tuple[str, ...]:
    """Say when a part of the region is so dark on the white tile that it probably lies beside it."""
    blocks = np.sum([step.block_dn_per_s for step in steps.white], axis=(0, 2))
    dimmest_rel = float(blocks.min() / blocks.max())
    if dimmest_rel >= SMALLEST_BLOCK_REL:
        return ()
    return (
        f"the darkest of {len(blocks)} blocks of the region has {dimmest_rel:.0%} of the brightest one's light on the "
        "white tile: the region reaches beyond the tile or the light, and all values are biased; correct plan.region",
    )


def _texture_variance_rel(steps: SessionSteps, sample: tuple[StepSignal, ...], under_laser: bool) -> float:
    """Return the relative variance of texture in the ratio of the sample to the white tile."""
    blocks = np.array([_block_ratio(s, w) for s, w in zip(sample, steps.white, strict=True)])  # (B, K, 3)
    noise = np.array(
        [
            s.noise_variance / positive(s.signal_dn_per_s) ** 2 + w.noise_variance / positive(w.signal_dn_per_s) ** 2
            for s, w in zip(sample, steps.white, strict=True)
        ]
    )
    light = steps.white[steps.excitation].block_dn_per_s.sum(axis=1)
    if under_laser:
        light = steps.laser_white.block_dn_per_s.sum(axis=1)
        blocks = blocks / _profile(steps)[None, :, None]
    number = blocks.shape[1]
    values = np.moveaxis(blocks, 1, 0).reshape(number, -1)
    return texture_variance_rel(values, number * np.nan_to_num(noise, nan=np.inf).ravel(), np.maximum(light, 0.0))


def _block_ratio(sample: StepSignal, white: StepSignal) -> Floats:
    """Return sample over white per block (K, 3); NaN where a channel is lost or dark."""
    usable = np.isfinite(sample.signal_dn_per_s) & (white.signal_dn_per_s > 0)
    below = np.where(usable & (white.block_dn_per_s > 0), white.block_dn_per_s, np.nan)
    return np.asarray(sample.block_dn_per_s / below)


def _profile(steps: SessionSteps) -> Floats:
    """Return the laser over the lamp per block (K,), from the channel that sees the laser best."""
    best = int(np.argmax(channel_weights(steps)))
    return _block_ratio(steps.laser_white, steps.white[steps.excitation])[:, best]
