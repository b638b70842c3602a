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
(:func:`~finray_calib.radiometry._session_steps.signal_covariance`), plus what is common to all bands: the white
reference, the texture of paint and tile, and bleaching. A wrong gain of the camera cancels in every ratio.

The laser spot weighs the region unevenly, and the white tile has another texture than the sample, so that the ratio of
the two means depends on where the spot lies. Over K blocks with light shares e_k and deviations d_k (averaged over the
bands, because texture is common to them)

.. math:: \mathrm{var} = \frac{K}{K - 1} \sum_k e_k^2 \Bigl[(d_k - \bar d)^2 - n\Bigr]

with n the photon noise of a block. Valid when a block is wider than the texture; a slow gradient over the region
makes it larger than the truth.

Whether the paint is diffuse is tested where the sample was tilted once: with T the tilted and F the untilted sample
under the laser through the same filter,

.. math:: q = \frac{T / F}{\cos\theta}, \qquad \ln T - \ln F = \sum_c \omega_c (\ln T_c - \ln F_c)

A diffuse paint has q = 1: its irradiance falls with the cosine of the tilt, and its radiance is the same in all
directions.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, CaptureSession, Flag, Optics, TiltRatio, WhiteReference
from finray_calib.radiometry._session_steps import (
    BleachingTrend,
    SessionSteps,
    bleaching_note,
    bleaching_trend,
    captured_filters,
    channel_weights,
    laser_level,
    positive,
    refuse_other_repeat,
    session_steps,
    signal_covariance,
    signals_of,
)
from finray_calib.radiometry._step_signals import (
    ASSUMED_REPEATABILITY_REL,
    ReadFrame,
    StepSignal,
    complete_bayer_cells,
)

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
        Whether to use a repeat that differs from its filter in a way that fading cannot explain.

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
    cells = complete_bayer_cells(session.plan.region)
    ratios = tilt_ratios(steps, trend)
    tables = (steps.white, steps.reflectance, steps.fluorescence)
    return BandSignals(
        paint_name=session.plan.paint_name,
        optics=rig_optics(session),
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
            *_steadiness_notes(session, steps),
            f"texture of paint and white tile: {100 * y.texture_sd_rel:.2f} %, the same in every band",
            *_beyond_the_tile(steps),
            *([] if trend is None else [bleaching_note(trend.record)]),
            *map(tilt_note, ratios),
            *_untested_tilts(steps, ratios),
        ),
    )


def _steadiness_notes(session: CaptureSession, steps: SessionSteps) -> tuple[str, ...]:
    """Say how steady light and dark level were, as far as repeated exposures and dark frames show it."""
    percent = f"{100 * steps.repeatability_rel:.2f} % per exposure"
    light = (
        f"light repeatability is assumed: {percent}, because too few steps were exposed more than once"
        if steps.repeatability_rel == ASSUMED_REPEATABILITY_REL
        else f"light repeatability from exposure brackets: {percent}"
    )
    if not any(frame.frame_type == "dark" for frame in session.frames):
        return (light,)
    drift_dn = max(abs(level.drift_dn) for level in steps.darks.values())
    dark = "largest drift of the dark level, from earlier to later dark frames of one exposure"
    return light, f"{dark}: {drift_dn:.3f} DN"


def rig_optics(session: CaptureSession) -> Optics:
    """Return the known curves of the rig for the captured filters."""
    names = captured_filters(session)
    filters = tuple(f for f in session.rig.filter_wheel.filters if f.name in names)
    return Optics(
        filters=filters,
        excitation_filter=session.plan.excitation_filter,
        laser=session.rig.laser,
        lamp=session.lamp,
        lamp_temperature_k=session.rig.lamp.temperature_k,
        lamp_temperature_uncertainty_k=session.rig.lamp.temperature_uncertainty_k,
        white_reference=session.rig.white_reference,
        band_uncertainty=session.rig.band_uncertainty,
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
        f"the darkest of {len(blocks)} blocks of the region has only {100 * dimmest_rel:.0f} % of the light of the "
        "brightest block on the white tile, so the region extends beyond the tile or the light, and all values are "
        "biased; correct plan.region",
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


# A band whose blocks are noisier than this says nothing about texture.
LARGEST_BLOCK_NOISE_REL = 0.05


def texture_variance_rel(values: Floats, noise_variance_rel: Floats, light: Floats) -> float:
    """Return the relative variance of the region's mean due to texture, common to all bands.

    Parameters
    ----------
    values
        (K, N) value of each block and band, any unit; NaN columns are left out.
    noise_variance_rel
        (N,) relative noise variance of one block's value.
    light
        (K,) light on each block, any unit.
    """
    mean = values.mean(axis=0)
    good = np.isfinite(values).all(axis=0) & (mean > 0) & (noise_variance_rel < LARGEST_BLOCK_NOISE_REL**2)
    if len(values) < 2 or not good.any():
        return 0.0
    weight = 1 / np.maximum(noise_variance_rel[good], np.finfo(float).tiny)
    deviation = (values[:, good] / mean[good] - 1) @ weight / weight.sum()
    share = light / light.sum()
    scatter = (deviation - share @ deviation) ** 2 - 1 / weight.sum()
    blocks = len(values)
    return max(float((share**2 * scatter).sum()) * blocks / (blocks - 1), 0.0)


# A sample is set with a protractor or a wedge; this is what a careful person reaches.
TILT_UNCERTAINTY_DEG = 0.5
DIFFUSE_WITHIN_SD = 2.0


def tilt_ratios(steps: SessionSteps, trend: BleachingTrend | None) -> tuple[TiltRatio, ...]:
    """Return the ratio to the cosine for each filter of the tilted sample; empty when it was not captured.

    A filter of which no channel has a signal both with and without the tilt is left out.

    Parameters
    ----------
    steps
        Steps of the session.
    trend
        Bleaching between the untilted and the tilted frames; corrected or carried as for the bands.
    """
    ratios = []
    for tilted in steps.tilted:
        name = tilted.exposures[0].frame.filter_name
        if name in steps.names:
            index = steps.names.index(name)
            flat = steps.fluorescence[index]
            if _both_seen(flat, tilted).any():
                ratios.append(_tilt_ratio(steps, flat, tilted, None if index == steps.excitation else trend))
    return tuple(ratios)


def _both_seen(flat: StepSignal, tilted: StepSignal) -> NDArray[np.bool_]:
    """Return which channels (3,) have a signal without and with the tilt; a saturated one (NaN) has none."""
    return np.asarray((flat.signal_dn_per_s > 0) & (tilted.signal_dn_per_s > 0))


def _tilt_ratio(steps: SessionSteps, flat: StepSignal, tilted: StepSignal, trend: BleachingTrend | None) -> TiltRatio:
    """Compare one filter's tilted and untilted signals."""
    f, t = flat.signal_dn_per_s, tilted.signal_dn_per_s
    good = _both_seen(flat, tilted)
    f, t = np.where(good, f, 1.0), np.where(good, t, 1.0)
    noise = np.where(good, flat.noise_variance / f**2 + tilted.noise_variance / t**2, np.inf)
    weight = 1 / noise / (1 / noise).sum()
    covariance = signal_covariance((flat, tilted), steps.darks, steps.repeatability_rel)
    slope = np.concatenate([-weight / f, weight / t])
    tilt_deg = tilted.exposures[0].frame.tilt_deg
    tilt, uncertainty = math.radians(tilt_deg), math.radians(TILT_UNCERTAINTY_DEG)
    variance = float(slope @ covariance @ slope) + (math.tan(tilt) * uncertainty) ** 2
    ln_ratio = float(weight @ (np.log(t) - np.log(f)))
    if trend is not None:
        between_j, record = float(weight @ (tilted.dose_j - flat.dose_j)), trend.record
        ln_ratio += record.loss_per_j * between_j * record.resolved
        variance += (record.sd_per_j * between_j) ** 2
        variance += (record.loss_per_j * between_j * (not record.resolved)) ** 2
    factor = math.exp(ln_ratio) / math.cos(tilt)
    sd = factor * math.sqrt(variance)
    return TiltRatio(
        filter_name=str(tilted.exposures[0].frame.filter_name),
        tilt_deg=tilt_deg,
        cosine_factor=factor,
        sd=sd,
        diffuse=abs(factor - 1.0) <= DIFFUSE_WITHIN_SD * sd,
    )


def tilt_note(ratio: TiltRatio) -> str:
    """Say in one sentence whether a filter agrees with a diffuse paint."""
    verdict = (
        "agrees with a diffuse paint" if ratio.diffuse else "the paint is not diffuse, but the model assumes that it is"
    )
    return (
        f"sample tilted by {ratio.tilt_deg:g} deg, filter {ratio.filter_name}: {ratio.cosine_factor:.3f} +- "
        f"{ratio.sd:.3f} of the cosine law; {verdict}"
    )


def _untested_tilts(steps: SessionSteps, ratios: tuple[TiltRatio, ...]) -> Iterator[str]:
    """Yield a sentence for each filter whose tilted frames give no ratio."""
    compared = {ratio.filter_name for ratio in ratios}
    for frame in (tilted.exposures[0].frame for tilted in steps.tilted):
        if frame.filter_name in set(steps.names) - compared:
            yield (
                f"sample tilted by {frame.tilt_deg:g} deg, filter {frame.filter_name}: not compared with the cosine "
                "law, because no channel has an unsaturated signal above the dark level both with and without the tilt"
            )


# The sites of a 2 x 2 cell that count as red, green and blue: one, two and one pixel of the same channel.
MONOCHROME_SHARES = (0.25, 0.5, 0.25)
_GREEN = 1


def monochrome_bands(bands: BandSignals) -> BandSignals:
    """Merge the three pixel groups of a monochrome camera into the green column; red and blue become "weak"."""
    filters = len(bands.flags)
    merge = np.zeros((3 * filters, 3 * filters))
    for b in range(filters):
        merge[3 * b + _GREEN, 3 * b : 3 * b + 3] = MONOCHROME_SHARES
    unused = np.diag(np.tile([1.0, 0.0, 1.0], filters))  # a variance for columns that hold nothing

    def values(of: Floats) -> Floats:
        return (merge @ of.ravel()).reshape(filters, 3)

    def covariance(of: Floats) -> Floats:
        merged = merge @ of @ merge.T
        return np.asarray((merged + merged.T) / 2 + unused)

    return bands.model_copy(
        update={
            "fluorescence": values(bands.fluorescence),
            "fluorescence_covariance": covariance(bands.fluorescence_covariance),
            "reflectance": values(bands.reflectance),
            "reflectance_covariance": covariance(bands.reflectance_covariance),
            "saturated_fraction": values(bands.saturated_fraction),
            "channel_weights": np.array([0.0, 1.0, 0.0]),
            "flags": tuple(("weak", _worst_flag(row), "weak") for row in bands.flags),
        }
    )


def _worst_flag(row: tuple[Flag, Flag, Flag]) -> Flag:
    """Return the worst of the flags of a band."""
    return "saturated" if "saturated" in row else "weak" if "weak" in row else "ok"


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings of any detector by filter and channel, (B, C), without their dark, in any unit.

    Attributes
    ----------
    value, sd
        Paint and white reference under laser and lamp, and their standard uncertainties, by the names "paint_laser",
        "white_laser", "paint_lamp" and "white_lamp"; NaN where nothing was measured.
    dark_sd
        Standard uncertainty of the dark that the readings of a filter and channel share.
    white_is_good
        Whether the white under the lamp is bright enough to divide by.
    white_is_computed
        Whether it follows from known curves, and so holds no dark.
    """

    value: dict[str, Floats]
    sd: dict[str, Floats]
    dark_sd: Floats
    white_is_good: NDArray[np.bool_]
    white_is_computed: bool = False

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Whether there is a ratio of paint under the laser to white under the lamp."""
        return self.white_is_good & np.isfinite(self.value["paint_laser"])

    @property
    def white(self) -> Floats:
        """White under the lamp; 1 where it is not good."""
        return np.where(self.white_is_good, self.value["white_lamp"], 1.0)


@dataclass(frozen=True, slots=True)
class LaserLevel:
    """Level V of the laser, and the weights (C,) of the channels in it, sum 1; measured or assumed."""

    weights: Floats
    value: float
    is_measured: bool = False


# Readings that are stated as exact would otherwise have all the weight.
_LEAST_RATIO_SD_REL = 1e-6


def level_of_readings(readings: Readings, excitation: int) -> LaserLevel | None:
    """Return the level of the laser with inverse-variance weights of the channels; None where no white was read.

    Parameters
    ----------
    readings
        Readings without their dark.
    excitation
        Index of the filter that passes the laser.
    """
    v, w = np.nan_to_num(readings.value["white_laser"][excitation]), readings.white[excitation]
    good = readings.white_is_good[excitation] & (v > 0)
    if not good.any():
        return None
    v_sd, w_sd = (readings.sd[name][excitation] for name in ("white_laser", "white_lamp"))
    v = np.where(good, v, 1.0)
    sd_rel = np.maximum(np.hypot(v_sd / v, w_sd / w), _LEAST_RATIO_SD_REL)
    weight = np.where(good, (w / v / sd_rel) ** 2, 0.0)
    weight /= weight.sum()
    return LaserLevel(weight, float(weight @ (v / w)), True)


def fluorescence_of_readings(
    readings: Readings, excitation: int, level: LaserLevel, white: WhiteReference
) -> tuple[Floats, Floats]:
    """Return y (B, C) and its covariance (B C, B C) by first-order propagation; 0 where not usable.

    Parameters
    ----------
    readings, excitation
        See :func:`level_of_readings`.
    level
        Level of the laser; an assumed one has no noise, and is uncertain by the white reference.
    white
        White reference, whose uncertainty is common to all values.
    """
    usable, sd = readings.usable, readings.sd
    w, w_e = readings.white.ravel(), readings.white[excitation]
    f, v = np.where(usable, readings.value["paint_laser"], 0.0).ravel(), readings.value["white_laser"][excitation]
    y = f / w / level.value
    to_f, to_w, to_v = np.diag(1 / w / level.value), np.diag(-y / w), np.zeros((y.size, w_e.size))
    block = slice(w_e.size * excitation, w_e.size * (excitation + 1))
    if level.is_measured:
        to_v = np.outer(-y / level.value, level.weights / w_e)
        to_w[:, block] += np.outer(y / level.value, level.weights * np.nan_to_num(v) / w_e**2)
    to_dark = -to_f - (0.0 if readings.white_is_computed else to_w)
    to_dark[:, block] -= to_v
    shares = (
        to_f * sd["paint_laser"].ravel(),
        to_w * sd["white_lamp"].ravel(),
        to_v * sd["white_laser"][excitation],
        to_dark * readings.dark_sd.ravel(),
        white.uncertainty_rel * y[:, None],
    )
    return y.reshape(usable.shape), np.sum([part @ part.T for part in shares], axis=0)


def reflectance_of_readings(readings: Readings, white: WhiteReference) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the total radiance factor (B, C), its covariance (B C, B C), and where it was measured; 0 elsewhere.

    Parameters
    ----------
    readings
        Readings without their dark.
    white
        White reference, whose uncertainty is common to all values.
    """
    usable, sd = readings.white_is_good & np.isfinite(readings.value["paint_lamp"]), readings.sd
    w, s = readings.white.ravel(), np.where(usable, readings.value["paint_lamp"], 0.0).ravel()
    rho = white.reflectance * s / w
    # a dark that is too large lowers paint and white by as much
    parts = (white.reflectance * sd["paint_lamp"].ravel(), rho * sd["white_lamp"].ravel(),
             (rho - white.reflectance) * readings.dark_sd.ravel())  # fmt: skip
    own = np.sum([(part / w) ** 2 for part in parts], axis=0)
    return rho.reshape(usable.shape), np.diag(own) + white.uncertainty_rel**2 * np.outer(rho, rho), usable
