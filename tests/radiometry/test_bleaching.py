"""Bleaching and tilt: trends put into sessions of known light are found, corrected or carried."""

import numpy as np
import pytest
from scipy import stats

from data_schemas import RadiometryError
from finray_calib.radiometry import band_signals, bands_of_steps, bleaching_trend, session_steps
from tests.radiometry.sessions import FILTERS, SIGNALS, TILT_DEG, exact_white, expected, synthetic_session

ERROR_RATE = 1e-4
EMISSION = SIGNALS["fluorescence"][2]
REPEAT = [("fluorescence repeat", "600", EMISSION)]
# Laser frames of filters 500, 600 and 660 follow the two of 450; the repeat comes 6 frames of 0.01 J after the first.
SESSIONS = 25


def faded(rng, loss_per_j):
    """A session with a repeat, and the truth at the dose of the first laser frame."""
    synthetic = synthetic_session(rng, extra=REPEAT, loss_per_j=loss_per_j)
    truth = expected()[0]
    first_j = min(f.laser_dose_j for f in synthetic.session.frames if f.frame_type == "fluorescence")
    truth[1:] *= np.exp(-loss_per_j * first_j)
    return synthetic, truth


@pytest.mark.parametrize(("loss_per_j", "resolved"), [(0.0, False), (4.0, True)])
def test_trend_is_recovered_and_its_interval_covers(loss_per_j, resolved):
    rng = np.random.default_rng(7)
    z, chi2, freedom, corrected = [], 0.0, 0, 0
    for _ in range(SESSIONS):
        synthetic, truth = faded(rng, loss_per_j)
        bands = band_signals(exact_white(synthetic), synthetic.read)
        found = bands.bleaching
        assert found is not None
        assert found.filter_name == "600"
        assert found.dose_span_j == pytest.approx(0.04, rel=0.05)  # the exposures' weights shift it a little
        z.append((found.loss_per_j - loss_per_j) / found.sd_per_j)
        corrected += found.resolved
        deviation = (bands.fluorescence - truth).ravel()
        chi2 += deviation @ np.linalg.solve(bands.fluorescence_covariance, deviation)
        freedom += deviation.size
        verb = "corrected to the first" if found.resolved else "not significant"
        assert any(note.startswith("bleaching through filter 600") and verb in note for note in bands.notes)
    # Beyond 3 sd of a sd from 14 ratios lies 1 % of Student's t: more than three of 25 have a probability of 1e-4.
    assert corrected == SESSIONS if resolved else corrected <= 3
    # The repeatability is estimated in each session from 14 ratios, which widens z to Student's t of 14 degrees.
    assert stats.chi2.sf(float(np.square(z).sum()) / 1.17, SESSIONS) > ERROR_RATE
    assert stats.chi2.sf(4 * float(np.square(z).sum()), SESSIONS) < ERROR_RATE  # half of the sd would be seen
    # Corrected bands are right within their covariance; an unresolved trend may only widen it.
    assert stats.chi2.sf(chi2 / 1.17, freedom) > ERROR_RATE


def test_uncorrected_bands_would_be_wrong():
    synthetic, truth = faded(np.random.default_rng(1), 4.0)
    repeats = [f for f in synthetic.session.frames if f.frame_type != "fluorescence repeat"]
    bands = band_signals(synthetic.session.model_copy(update={"frames": tuple(repeats)}), synthetic.read)
    assert bands.bleaching is None
    # filter 660 comes four frames after the first emission: exp(-4 / J x 0.05 J) of it is left
    assert bands.fluorescence[3, 0] / truth[3, 0] == pytest.approx(np.exp(-4.0 * 0.06), rel=0.03)


def test_unresolved_trend_is_common_to_the_bands():
    synthetic, _ = faded(np.random.default_rng(3), 0.0)
    session = exact_white(synthetic)
    repeated = band_signals(session, synthetic.read)
    once = tuple(f for f in session.frames if f.frame_type != "fluorescence repeat")
    alone = band_signals(session.model_copy(update={"frames": once}), synthetic.read)
    trend = bleaching_trend(session_steps(session, synthetic.read))
    assert trend is not None
    size = np.hypot(trend.record.loss_per_j, trend.record.sd_per_j)
    added = repeated.fluorescence_covariance[9, 6] - alone.fluorescence_covariance[9, 6]  # red of 660 and of 600
    lever = trend.dose_j[3, 0] * trend.dose_j[2, 0] * repeated.fluorescence[3, 0] * repeated.fluorescence[2, 0]
    # the light's repeatability differs a little between the two, by the ratio of the repeat's bracket
    assert added == pytest.approx(size**2 * lever, rel=0.1)
    assert not trend.dose_j[0].any()  # reflected laser light does not fade


@pytest.mark.parametrize("case", ["no span", "other filter", "lost"])
def test_repeat_that_says_nothing_is_ignored(case):
    def change(frames, images):
        for i, f in enumerate(frames):
            if f.frame_type == "fluorescence repeat":
                if case == "other filter":
                    frames[i] = f.model_copy(update={"filter_name": "700"})
                if case == "lost":
                    images[f.file] = np.full((64, 64), 1023, np.uint16)
            if case == "no span":
                frames[i] = frames[i].model_copy(update={"laser_dose_j": 0.0})
        return frames

    synthetic = synthetic_session(np.random.default_rng(1), extra=REPEAT, change=change)
    assert band_signals(synthetic.session, synthetic.read).bleaching is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.array([1.3, 1.3, 1.3]), r"repeat is \d+ standard deviations brighter \((29|30)\.\d %\)"),
        (np.array([0.7, 1.0, 1.0]), r"its channels changed differently, by \d+ standard deviations"),
        (np.array([0.5, 0.5, 0.5]), r"repeat is \d+ standard deviations and 50 % dimmer"),
    ],
)
def test_a_repeat_that_no_fading_explains_is_refused(change, message):
    other = [("fluorescence repeat", "600", EMISSION * change)]
    synthetic = synthetic_session(np.random.default_rng(4), extra=other)
    with pytest.raises(RadiometryError, match=rf"filter 600 and its repeat disagree: .*{message}.*--accept-repeat"):
        band_signals(synthetic.session, synthetic.read)
    steps = session_steps(synthetic.session, synthetic.read)
    assert bands_of_steps(synthetic.session, steps, accept_repeat=True).bleaching is not None


@pytest.mark.parametrize(("factor", "diffuse"), [(1.0, True), (0.9, False)])
def test_tilted_sample_is_compared_with_the_cosine(factor, diffuse):
    cosine = np.cos(np.radians(TILT_DEG))
    tilted = [
        ("tilted fluorescence", FILTERS[b], factor * cosine * SIGNALS["fluorescence"][b]) for b in (0, 2)
    ]  # the filter of the laser and one of the emission
    synthetic = synthetic_session(np.random.default_rng(5), extra=tilted)
    bands = band_signals(synthetic.session, synthetic.read)
    assert [r.filter_name for r in bands.tilt_ratios] == ["450", "600"]
    for ratio in bands.tilt_ratios:
        assert ratio.tilt_deg == TILT_DEG
        # half a degree of tilt is 0.5 % at 30 degrees, two exposures on either side another 0.2 %
        assert 0.005 < ratio.sd < 0.007
        assert abs(ratio.cosine_factor - factor) < stats.norm.isf(ERROR_RATE / 2) * ratio.sd
        assert ratio.diffuse is diffuse
    verdict = "agrees with a diffuse paint" if diffuse else "not diffuse"
    assert sum(verdict in note for note in bands.notes) == 2


@pytest.mark.parametrize("loss_per_j", [0.0, 4.0])
def test_tilt_knows_of_bleaching(loss_per_j):
    tilted = ("tilted fluorescence", "600", np.cos(np.radians(TILT_DEG)) * EMISSION)
    rng = np.random.default_rng(8)
    synthetic = synthetic_session(rng, extra=[*REPEAT, tilted], loss_per_j=loss_per_j)
    bands = band_signals(synthetic.session, synthetic.read)
    (ratio,) = bands.tilt_ratios
    assert abs(ratio.cosine_factor - 1.0) < stats.norm.isf(ERROR_RATE / 2) * ratio.sd
    assert ratio.sd > 0.006  # the trend's uncertainty over 0.06 J is added


@pytest.mark.parametrize("counts_dn", [1023, 0])
def test_tilted_frames_without_a_signal_give_no_ratio(counts_dn):
    """Saturated or dark in all channels, they say nothing of the paint: no ratio of 1 / cos 30 deg = 1.155."""

    def lost(frames, images):
        for one in frames:
            if (one.frame_type, one.filter_name) == ("tilted fluorescence", "600"):
                images[one.file][:] = counts_dn
        return frames

    cosine = np.cos(np.radians(TILT_DEG))
    tilted = [("tilted fluorescence", FILTERS[b], cosine * SIGNALS["fluorescence"][b]) for b in (0, 2)]
    synthetic = synthetic_session(np.random.default_rng(5), extra=tilted, change=lost)
    bands = band_signals(synthetic.session, synthetic.read)
    assert [r.filter_name for r in bands.tilt_ratios] == ["450"]
    assert any("filter 600: not compared with the cosine law" in note for note in bands.notes)
    assert not any("not diffuse" in note for note in bands.notes)


def test_without_tilted_frames_there_is_no_ratio():
    synthetic = synthetic_session(np.random.default_rng(5))
    assert band_signals(synthetic.session, synthetic.read).tilt_ratios == ()
