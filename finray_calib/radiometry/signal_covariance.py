"""Covariance of the signals of several steps: what each has of its own, and what they share."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from finray_calib.radiometry.dark_levels import DarkLevel
from finray_calib.radiometry.step_signals import StepSignal

Floats = NDArray[np.float64]


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
