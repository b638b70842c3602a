r"""Test of a diffuse paint: the sample is tilted once, and its signal should fall with the cosine.

.. math:: q = \frac{T / F}{\cos\theta}, \qquad \ln T - \ln F = \sum_c \omega_c (\ln T_c - \ln F_c)

with T the tilted and F the untilted sample under the laser through the same filter. A diffuse paint has q = 1: its
irradiance falls with the cosine of the tilt, and its radiance is the same in all directions.
"""

import math

import numpy as np

from data_schemas.radiometry import TiltRatio
from finray_calib.radiometry.bleaching import BleachingTrend
from finray_calib.radiometry.session_steps import SessionSteps
from finray_calib.radiometry.signal_covariance import signal_covariance
from finray_calib.radiometry.step_signals import StepSignal

# A sample is set with a protractor or a wedge; this is what a careful person reaches.
TILT_UNCERTAINTY_DEG = 0.5
DIFFUSE_WITHIN_SD = 2.0


def tilt_ratios(steps: SessionSteps, trend: BleachingTrend | None) -> tuple[TiltRatio, ...]:
    """Return the ratio to the cosine for each filter of the tilted sample; empty when it was not captured.

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
            ratios.append(
                _ratio(steps, steps.fluorescence[index], tilted, None if index == steps.excitation else trend)
            )
    return tuple(ratios)


def _ratio(steps: SessionSteps, flat: StepSignal, tilted: StepSignal, trend: BleachingTrend | None) -> TiltRatio:
    """Compare one filter's tilted and untilted signals."""
    f, t = flat.signal_dn_per_s, tilted.signal_dn_per_s
    good = (f > 0) & (t > 0)
    f, t = np.where(good, f, 1.0), np.where(good, t, 1.0)
    noise = np.where(good, flat.noise_variance / f**2 + tilted.noise_variance / t**2, np.inf)
    weight = 1 / noise / max((1 / noise).sum(), np.finfo(float).tiny)
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
    verdict = "agrees with a diffuse paint" if ratio.diffuse else "the paint is not diffuse, as the model assumes"
    return (
        f"sample tilted by {ratio.tilt_deg:g} deg, filter {ratio.filter_name}: {ratio.cosine_factor:.3f} +- "
        f"{ratio.sd:.3f} of the cosine law; {verdict}"
    )
