"""Sessions of one paint become one: what they share, what differs between them, and how well both are known."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from data_schemas import FitError, PaintCalibration, TiltRatio, provenance
from data_schemas.storage import read_record, write_record
from finray_calib import fit_paint
from finray_calib.fit import combine_sessions, outlying_session_warnings
from rigs import simulated_rig
from rigs.simulated import bench_truth
from tests.schemas.freeze import ORIGIN

LEVEL, FILTER, NOISE, TILE = 0.03, 0.01, 0.003, 0.005


@pytest.fixture
def session(red_bands):
    """One session: noise-free signals of the bench times a level and what each filter has of its own; noise."""
    y = red_bands.fluorescence.ravel()
    noise = np.hypot(NOISE * y, 2e-4 * np.abs(y).max())

    def made(rng, level=LEVEL, of_filter=FILTER, tile=0.0):
        own = 1 + level * rng.standard_normal() + of_filter * np.repeat(rng.standard_normal(y.size // 3), 3)
        seen = y * own * (1 + tile) + noise * rng.standard_normal(y.size)
        covariance = np.diag(noise**2) + TILE**2 * np.outer(seen, seen)
        return red_bands.model_copy(update={"fluorescence": seen.reshape(-1, 3), "fluorescence_covariance": covariance})

    return made


def with_white_reference_known_to(u_rel, bands):
    """Return a session as it would be with a white reference of another uncertainty, which is common to all."""
    y = bands.fluorescence.ravel()
    covariance = bands.fluorescence_covariance + (u_rel**2 - TILE**2) * np.outer(y, y)
    white = bands.optics.white_reference.model_copy(update={"uncertainty_rel": u_rel})
    optics = bands.optics.model_copy(update={"white_reference": white})
    return bands.model_copy(update={"fluorescence_covariance": covariance, "optics": optics})


@pytest.fixture
def level_of(red_bands):
    """Level of band signals relative to the truth, from the bright values, and its standard deviation."""
    y = red_bands.fluorescence.ravel()
    along = np.where(y > 0.3 * y.max(), 1 / y, 0.0)
    along /= along @ y
    return lambda bands: (
        along @ bands.fluorescence.ravel() - 1, np.sqrt(along @ bands.fluorescence_covariance @ along)
    )  # fmt: skip


@pytest.mark.parametrize(("number", "level"), [(3, 0.01), (3, 0.05), (5, 0.03)])
def test_the_interval_of_the_common_level_holds_the_truth(session, level_of, number, level):
    """60 sets each; a true coverage of 0.92 or more fails once in a thousand below 48 of 60."""
    rng = np.random.default_rng([7, number])
    inside = 0
    for _ in range(60):
        tile = TILE * rng.standard_normal()
        together, _ = combine_sessions([session(rng, level, level / 3, tile) for _ in range(number)])
        off, sd = level_of(together)
        inside += abs(off) < 1.96 * sd
    assert inside >= 48


def test_tables_of_readings_have_no_pixels_together_either(session):
    """Reports tell readings of a table by their one pixel; two of them were "photographed over 2 pixels"."""
    rng = np.random.default_rng(1)
    for pixels, together in (((1, 1), 1), ((1, 1, 1, 1), 1), ((64, 16), 80)):
        sessions = [session(rng).model_copy(update={"region_pixels": number}) for number in pixels]
        assert combine_sessions(sessions)[0].region_pixels == together


def test_the_tilts_of_all_sessions_are_kept(session):
    """The first session alone would hide that a later one tested whether the paint is diffuse."""
    rng = np.random.default_rng(6)
    tilt = TiltRatio(filter_name="600", tilt_deg=30.0, cosine_factor=0.8, sd=0.01, diffuse=False)
    plain, tilted = session(rng), session(rng).model_copy(update={"tilt_ratios": (tilt,)})
    assert combine_sessions([plain, tilted])[0].tilt_ratios == (tilt,)


def test_two_sessions_hold_their_level_as_often_as_stated_at_the_largest_scatter(session, level_of):
    """Levels that scatter by 8 %: the mean of two does not depend on how far they are apart, and the interval does."""
    rng, largest, held = np.random.default_rng(9), 0.08, []
    for share in (np.arange(12) + 0.5) / 12:
        apart = largest * np.sqrt(2) * norm.ppf((1 + share) / 2)
        together, _ = combine_sessions([session(rng, 0.0, 0.0, apart / 2), session(rng, 0.0, 0.0, -apart / 2)])
        _, sd = level_of(together)
        held.append(2 * norm.cdf(1.96 * sd / (largest / np.sqrt(2))) - 1)
        assert any("a third session narrows it" in note for note in together.notes)
    # 0.95 by a prior of 5 %; 0.91 by one of 3 %
    assert np.mean(held) > 0.93


def test_the_scatter_between_sessions_is_found_where_there_are_many(session):
    rng = np.random.default_rng(3)
    _, scatter = combine_sessions([session(rng) for _ in range(12)])
    assert scatter.level_rel.low95 < LEVEL < scatter.level_rel.high95
    assert scatter.filter_rel.low95 < FILTER < scatter.filter_rel.high95
    assert scatter.level_rel.high95 < 0.08
    assert np.mean(scatter.session_levels_rel) == pytest.approx(0.0, abs=0.01)
    assert scatter.departing == ()


def test_no_repetition_averages_away_what_is_common(session, level_of):
    """Twenty sessions that scatter by nothing but noise: the white reference's 0.5 % stays."""
    rng = np.random.default_rng(5)
    together, _ = combine_sessions([session(rng, 0.0, 0.0) for _ in range(20)])
    _, sd = level_of(together)
    assert TILE <= sd < 1.2 * TILE


def test_a_session_with_another_filter_is_named_and_others_are_not(session):
    rng = np.random.default_rng(11)
    sessions = [session(rng) for _ in range(6)]
    y = sessions[3].fluorescence.copy()
    y[4] *= 0.6
    sessions[3] = sessions[3].model_copy(update={"fluorescence": y})
    _, scatter = combine_sessions(sessions)
    assert scatter.departing == (4,)
    assert outlying_session_warnings(scatter)[0].startswith("session 4 differs from the other sessions")


@pytest.mark.parametrize(("level", "named"), [(0.0, ()), (0.08, (6,)), (-0.08, (6,))])
def test_a_session_of_another_level_is_named_whatever_the_white_reference_is_known_to(session, level, named):
    """Sessions that scatter by 0.2 %, all under one white reference that is 2 % wrong: no two differ by its error."""
    rng = np.random.default_rng(13)
    sessions = [session(rng, 0.002, 0.0, 0.02) for _ in range(5)]
    sessions.append(session(rng, 0.0, 0.0, 1.02 * (1 + level) - 1))
    _, scatter = combine_sessions([with_white_reference_known_to(0.02, one) for one in sessions])
    assert scatter.departing == named


def test_the_common_values_lie_among_those_of_the_sessions_however_their_channels_disagree(session, red_bands):
    """Weights by covariances would put them below all: colours that differ by 10 % where 0.3 % is stated."""
    rng = np.random.default_rng(8)
    sessions = []
    for one in [session(rng) for _ in range(3)]:
        y = one.fluorescence * (1 + 0.1 * rng.standard_normal((1, 3)))
        covariance = one.fluorescence_covariance + 0.02**2 * np.outer(y, y)
        sessions.append(one.model_copy(update={"fluorescence": y, "fluorescence_covariance": covariance}))
    together, _ = combine_sessions(sessions)
    bright = red_bands.fluorescence > 0.3 * red_bands.fluorescence.max()
    seen = np.array([one.fluorescence[bright] for one in sessions])
    assert (seen.min(axis=0) < together.fluorescence[bright]).all()
    assert (together.fluorescence[bright] < seen.max(axis=0)).all()


def test_a_value_that_one_session_lost_rests_on_the_others(session, red_bands):
    rng = np.random.default_rng(2)
    sessions = [session(rng) for _ in range(3)]
    flags = [list(row) for row in sessions[0].flags]
    flags[4][0] = "saturated"
    broken = sessions[0].fluorescence.copy()
    broken[4, 0] = 99.0
    sessions[0] = sessions[0].model_copy(update={"flags": tuple(map(tuple, flags)), "fluorescence": broken})
    together, scatter = combine_sessions(sessions)
    assert together.flags[4][0] == "ok"
    assert together.fluorescence[4, 0] == pytest.approx(red_bands.fluorescence[4, 0], rel=0.15)
    assert abs(scatter.session_levels_rel[0]) < 0.2


def test_one_session_reduced_in_two_ways_is_refused(session):
    """Other values, as by another characterisation of the camera, of the same frames."""
    rng = np.random.default_rng(1)

    def reduced_from(bands, digest):
        inputs = {"lab/session/session.json": digest, "lab/camera.json": "c" * 64}
        return bands.model_copy(update={"provenance": ORIGIN.model_copy(update={"input_sha256": inputs})})

    one, two = session(rng), session(rng)
    combine_sessions([reduced_from(one, "a" * 64), reduced_from(two, "b" * 64)])
    with pytest.raises(
        FitError, match="sessions 1 and 2 were reduced from the same captured session, which would count"
    ):
        combine_sessions([reduced_from(one, "a" * 64), reduced_from(two, "a" * 64)])


def test_sessions_that_are_no_repeats_are_refused(session):
    rng = np.random.default_rng(1)
    one, two = session(rng), session(rng)
    with pytest.raises(FitError, match="only one session is given, but at least two are needed"):
        combine_sessions([one])
    with pytest.raises(
        FitError, match=r"session 2 is of paint 'other', but the first is of paint .*; give sessions .* --paint-name"
    ):
        combine_sessions([one, two.model_copy(update={"paint_name": "other"})])
    laser = two.optics.laser.model_copy(update={"wavelength_nm": 405.0})
    with pytest.raises(
        FitError, match=r"excited at 405 nm, but the first at .*; give a session under another light with --other-light"
    ):
        combine_sessions([one, two.model_copy(update={"optics": two.optics.model_copy(update={"laser": laser})})])
    white = two.optics.white_reference.model_copy(update={"reflectance": 0.9})
    optics = two.optics.model_copy(update={"white_reference": white})
    with pytest.raises(FitError, match=r"session 2 .* with a rig whose white_reference differs from that of the first"):
        combine_sessions([one, two.model_copy(update={"optics": optics})])


def test_a_paint_of_three_sessions_is_one_calibration_that_holds_the_truth_and_their_scatter(session, tmp_path):
    rng = np.random.default_rng(4)
    sessions = [session(rng) for _ in range(3)]
    alone, together = fit_paint(sessions[0]), fit_paint(sessions)
    truth = bench_truth(simulated_rig("red", seed=3), Path())
    low, high = together.energy_yield.low95, together.energy_yield.high95
    assert low < truth.energy_yield < high
    mode = together.parameters["mode_nm"]
    assert mode.low95 < truth.mode_nm < mode.high95
    assert alone.paint_name == together.paint_name
    assert alone.between_sessions is None
    scatter = combine_sessions(sessions)[1]
    path = write_record(together, tmp_path / "paint.json", provenance("finray fit"))
    assert read_record(path, PaintCalibration).between_sessions == scatter
    assert f"between_sessions_level_rel: {scatter.level_rel}" in str(together)
    assert fit_paint([sessions[0]]).energy_yield == alone.energy_yield
