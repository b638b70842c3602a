"""Merging the exposures of a step, and the covariance of merged signals, against known noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from finray_calib.radiometry import session_steps, signal_covariance
from finray_calib.radiometry._session_steps import signals_of
from finray_calib.radiometry._step_signals import (
    DarkLevel,
    ExposureSignal,
    dark_levels,
    light_repeatability_rel,
    merge_exposures,
    thermal_levels_dn,
)
from tests.radiometry.sessions import SIGNALS, frame, synthetic_session

ERROR_RATE = 1e-4


def exposure(signal: float, noise: float, exposure_s: float, saturated: float = 0.0, dose_j: float = 0.0):
    record = frame(0, "frames/0000.tiff", "white", "450", exposure_s).model_copy(update={"laser_dose_j": dose_j})
    three = np.ones(3)
    return ExposureSignal(
        record, signal * three, noise * three, 0 * three, saturated * three, signal * np.ones((16, 3))
    )


def test_exposures_are_weighted_by_inverse_variance():
    step = merge_exposures([exposure(100.0, 1.0, 1.0), exposure(103.0, 4.0, 0.25)], 0.0)
    assert step.signal_dn_per_s == pytest.approx((100.0 + 103.0 / 4) / 1.25)
    assert step.noise_variance == pytest.approx(1 / (1 + 1 / 4))


def test_repeatability_levels_the_weights():
    """Where the light's own repeatability outweighs photon noise, two exposures are as good as each other."""
    step = merge_exposures([exposure(100.0, 1e-4, 1.0), exposure(100.0, 4e-4, 0.25)], 0.01)
    assert step.shares[:, 0] == pytest.approx([0.5, 0.5], abs=1e-4)  # 1 against 1.0003
    covariance = signal_covariance([step], {}, 0.01)
    assert covariance[0, 0] == pytest.approx(100.0**2 * 1e-4 / 2 + 1.25e-4, rel=1e-6)
    assert covariance[0, 1] == pytest.approx(100.0**2 * 1e-4 / 2, rel=1e-4)


def test_saturated_exposures_are_left_out_and_a_lost_channel_is_nan():
    long, short = exposure(90.0, 1.0, 1.0, saturated=0.01), exposure(100.0, 4.0, 0.25)
    step = merge_exposures([long, short], 0.0)
    assert step.signal_dn_per_s == pytest.approx(100.0)
    assert step.noise_variance == pytest.approx(4.0)
    lost = merge_exposures([long, replace(short, saturated_fraction=np.array([0.0, 0.0, 0.5]))], 0.0)
    assert np.isnan(lost.signal_dn_per_s).tolist() == [False, False, True]
    assert np.isfinite(signal_covariance([lost], {}, 0.01)).all()


def test_dose_of_a_step_follows_the_weights():
    step = merge_exposures([exposure(1.0, 1.0, 1.0, dose_j=2.0), exposure(1.0, 3.0, 0.25, dose_j=6.0)], 0.0)
    assert step.dose_j == pytest.approx(0.75 * 2.0 + 0.25 * 6.0)


def test_dark_error_is_shared_by_the_steps_of_one_exposure_time():
    level = DarkLevel(np.full(3, 16.0), np.array([0.01, 0.02, 0.03]), 0.0, 0.2, 0.005)
    darks = {1.0: level, 0.25: replace(level, drift_variance_dn2=0.0)}
    one = merge_exposures([exposure(100.0, 1.0, 1.0)], 0.0)
    other = merge_exposures([exposure(50.0, 1.0, 1.0)], 0.0)
    short = merge_exposures([exposure(70.0, 1.0, 0.25)], 0.0)
    covariance = signal_covariance([one, other, short], darks, 0.0).reshape(3, 3, 3, 3)
    assert covariance[0, :, 1].diagonal() == pytest.approx([0.015, 0.025, 0.035])  # level and drift
    assert covariance[0, 0, 1, 2] == pytest.approx(0.005)  # the drift moves all channels
    assert covariance[0, 0, 2, 0] == 0.0  # another exposure time has a dark level of its own
    assert covariance[2, 1, 2, 1] == pytest.approx(1.0 + 0.02 / 0.25**2)


def test_stated_covariance_of_steps_with_one_exposure_time_is_the_real_one():
    """Dim light, one exposure time: a third of each variance is the dark level's, common to all filters."""
    rng = np.random.default_rng(11)
    sessions, signals, stated = 150, [], np.zeros((4, 4))
    for _ in range(sessions):
        synthetic = synthetic_session(rng, repeatability_rel=0.0, exposure_s=2e-3)
        steps = session_steps(synthetic.session, synthetic.read)
        signals.append(signals_of(steps.fluorescence)[:, 0])
        stated += signal_covariance(steps.fluorescence, steps.darks, 0.0)[::3, ::3] / sessions
    deviation = np.array(signals) - SIGNALS["fluorescence"][:, 0]
    whitened = np.linalg.solve(np.linalg.cholesky(stated), deviation.T)
    chi2 = float((whitened**2).sum())
    assert ERROR_RATE < stats.chi2.sf(chi2, whitened.size) < 1 - ERROR_RATE
    correlation = np.corrcoef(deviation.T)[np.triu_indices(4, 1)]
    predicted = stated / np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    # The mean of the six correlations of 150 sessions has a standard error of some 0.06.
    assert correlation.mean() == pytest.approx(predicted[np.triu_indices(4, 1)].mean(), abs=0.2)
    assert predicted[0, 1] > 0.25


def test_dark_current_brings_noise_and_drift_is_told_from_chance():
    assert thermal_levels_dn({2.0: 16.5, 1.0: 16.2, 0.1: 16.3}) == pytest.approx({2.0: 0.2, 1.0: 0.0, 0.1: 0.0})
    synthetic = synthetic_session(np.random.default_rng(2))

    def later(frames, images, shift):
        darks = [f for f in frames if f.frame_type == "dark"]
        for f in darks[len(darks) // 2 :]:
            images[f.file] = images[f.file] + np.uint16(shift)

    quiet = dark_levels(synthetic.session, synthetic.read)
    later(synthetic.session.frames, synthetic.frames, 3)
    drifting = dark_levels(synthetic.session, synthetic.read)
    for exposure_s, level in drifting.items():
        assert level.drift_dn == pytest.approx(quiet[exposure_s].drift_dn + 3.0)
        assert level.drift_variance_dn2 == pytest.approx(
            3.0**2 / 12, rel=0.15
        )  # the means of 576 px scatter by 0.06 DN
        assert quiet[exposure_s].drift_variance_dn2 < 0.01


def test_few_or_dim_brackets_leave_the_repeatability_assumed():
    pair = [exposure(100.0, 1e-4, 1.0), exposure(101.0, 1e-4, 0.25)]
    assert light_repeatability_rel({("white", "450"): pair}) == 0.005
    three = {("white", str(n)): pair for n in range(3)}
    assert light_repeatability_rel(three) == pytest.approx(np.log(1.01) / np.sqrt(2), rel=1e-3)
    same = {("white", str(n)): [pair[0], exposure(100.0, 1e-4, 0.25)] for n in range(3)}
    assert light_repeatability_rel(same) == 5e-4
