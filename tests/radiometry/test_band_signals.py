"""Band signals against known light: bias, stated covariance, flags and refusals."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from data_schemas import CaptureSession, RadiometryError, RegionOfInterest
from finray_calib.radiometry import band_signals
from finray_calib.radiometry._band_signals import _steadiness_notes
from finray_calib.radiometry._session_steps import session_steps
from finray_calib.radiometry._step_signals import ASSUMED_REPEATABILITY_REL, region_channels
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session, read_frame_of
from tests.radiometry.sessions import (
    FILTERS,
    REGION,
    exact_white,
    expected,
    record,
    synthetic_session,
)

# Every statistical test below errs with this probability when the code is right.
ERROR_RATE = 1e-4


def test_region_takes_whole_bayer_cells():
    rows, columns = np.indices((12, 12))
    frame = (100 * rows + columns).astype(np.uint16)
    red, green, blue = region_channels(frame, RegionOfInterest(row_px=3, column_px=5, height_px=5, width_px=4))
    assert sorted(red) == [204, 206, 404, 406]
    assert sorted(green) == [205, 207, 304, 306, 405, 407, 504, 506]
    assert sorted(blue) == [305, 307, 505, 507]


@pytest.mark.parametrize(
    ("region", "message"),
    [
        (REGION.model_copy(update={"height_px": 0}), "0 x 48 px is empty or too small"),
        (REGION.model_copy(update={"width_px": 3}), "48 x 3 px is empty or too small"),
        (REGION.model_copy(update={"row_px": 40}), "rows 40 to 88 .* reach beyond the frame of 64 x 64 px"),
    ],
)
def test_region_that_is_no_region(region, message):
    with pytest.raises(RadiometryError, match=message):
        region_channels(np.zeros((64, 64), np.uint16), region)


SESSIONS = 60
KINDS = ("fluorescence", "reflectance")


@pytest.fixture(scope="module")
def whitened() -> dict[str, np.ndarray]:
    """Deviations from the truth of 60 sessions of the same light, whitened by the stated covariance, and by its
    diagonal alone."""
    rng = np.random.default_rng(20261121)
    truths = dict(zip(KINDS, expected(), strict=True))
    found: dict[str, list[np.ndarray]] = {f"{name} {how}": [] for name in KINDS for how in ("full", "diagonal")}
    for _ in range(SESSIONS):
        synthetic = synthetic_session(rng)
        bands = band_signals(exact_white(synthetic), synthetic.read)
        for name in KINDS:
            deviation = (getattr(bands, name) - truths[name]).ravel()
            covariance = getattr(bands, f"{name}_covariance")
            found[f"{name} full"].append(np.linalg.solve(np.linalg.cholesky(covariance), deviation))
            found[f"{name} diagonal"].append(deviation / np.sqrt(np.diag(covariance)))
    return {key: np.array(rows) for key, rows in found.items()}


@pytest.mark.parametrize("name", KINDS)
def test_stated_covariance_is_the_real_scatter(whitened, name):
    """Over 60 sessions of the same light, chi-square of the deviations with the stated covariance."""
    value = float((whitened[f"{name} full"] ** 2).sum())
    freedom = whitened[f"{name} full"].size
    # The repeatability is itself estimated from some 13 ratios a session: E[1 / s^2] exceeds 1 / sigma^2 by 15 %.
    assert stats.chi2.sf(value / 1.15, freedom) > ERROR_RATE
    assert stats.chi2.cdf(value, freedom) > ERROR_RATE
    # and a covariance that is 30 % too small would be found
    assert stats.chi2.sf(1.3 * value / 1.15, freedom) < ERROR_RATE


def sign_correlation(rows: np.ndarray) -> float:
    """Sum over all pairs of n r^2 with r the correlation of the signs; chi-square of so many degrees of freedom.

    Signs do not care that a session's estimated repeatability scales all its residuals.
    """
    signs = np.sign(rows)
    r = signs.T @ signs / len(rows)
    return len(rows) * float((r[np.triu_indices(len(r), 1)] ** 2).sum())


@pytest.mark.parametrize("name", KINDS)
def test_stated_correlations_are_the_real_ones(whitened, name):
    """Whitened by the stated covariance the values are uncorrelated; by its diagonal alone they are not."""
    number = whitened[f"{name} full"].shape[1]
    pairs = number * (number - 1) / 2
    assert stats.chi2.sf(sign_correlation(whitened[f"{name} full"]), pairs) > ERROR_RATE
    assert stats.chi2.sf(sign_correlation(whitened[f"{name} diagonal"]), pairs) < ERROR_RATE


def test_repeatability_is_found_from_the_brackets():
    bands = band_signals(*_parts(synthetic_session(np.random.default_rng(3), repeatability_rel=0.01)))
    note = next(n for n in bands.notes if "repeatability" in n)
    found = float(note.split(": ")[1].split(" %")[0])
    # 13 steps give the standard deviation to 20 %: 0.4 .. 2 is far outside chance
    assert 0.4 < found < 2.0


def test_steadiness_is_noted_only_where_it_was_measured():
    """Without brackets the light is assumed, and without dark frames their drift is unsaid."""
    synthetic = synthetic_session(np.random.default_rng(3), repeatability_rel=0.01)
    steps = session_steps(*_parts(synthetic))
    assert any("from exposure brackets" in note for note in _steadiness_notes(synthetic.session, steps))
    assert any(
        note.startswith("largest drift of the dark level") for note in _steadiness_notes(synthetic.session, steps)
    )
    lit = tuple(frame for frame in synthetic.session.frames if frame.frame_type != "dark")
    alone = synthetic.session.model_copy(update={"frames": lit})
    assumed = dataclasses.replace(steps, repeatability_rel=ASSUMED_REPEATABILITY_REL)
    (note,) = _steadiness_notes(alone, assumed)
    assert note.startswith("light repeatability is assumed: 0.50 % per exposure")


def _parts(synthetic) -> tuple[CaptureSession, object]:
    return synthetic.session, synthetic.read


def test_missing_step_and_missing_darks():
    rng = np.random.default_rng(1)
    lost = synthetic_session(
        rng, change=lambda f, _: [x for x in f if (x.frame_type, x.filter_name) != ("white", "600")]
    )
    with pytest.raises(RadiometryError, match=r"no 'white' frame through filter 600"):
        band_signals(*_parts(lost))
    undark = synthetic_session(rng, change=lambda f, _: [x for x in f if x.frame_type != "dark"])
    with pytest.raises(RadiometryError, match="no dark frames"):
        band_signals(*_parts(undark))
    darks = [x for x in synthetic_session(rng).session.frames if x.frame_type == "dark"]
    one = darks[0].exposure_s
    partial = synthetic_session(
        rng, change=lambda f, _: [x for x in f if x.frame_type != "dark" or x.exposure_s != one]
    )
    with pytest.raises(
        RadiometryError, match=r"no dark frame of .* s was captured; capture dark frames of the same exposure"
    ):
        band_signals(*_parts(partial))


def test_saturated_band_names_the_frame_and_what_to_do():
    def burn(frames, images):
        for f in frames:
            if (f.frame_type, f.filter_name) == ("fluorescence", "600"):
                images[f.file] = np.full((64, 64), 1023, np.uint16)
        return frames

    with pytest.raises(RadiometryError, match=r"\d{4}.tiff: filter 600 is saturated .* lower plan.target_fraction"):
        band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=burn)))


def test_one_saturated_channel_is_flagged_and_not_usable():
    def burn_blue(frames, images):
        for f in frames:
            if (f.frame_type, f.filter_name) == ("white", "450"):
                images[f.file][1::2, 1::2] = 1023
        return frames

    bands = band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=burn_blue)))
    assert bands.flags[0] == ("ok", "ok", "saturated")
    assert bands.saturated_fraction[0, 2] == 1.0
    assert not bands.usable()[0, 2]
    assert bands.usable().sum() == 11


def test_shorter_exposure_of_the_bracket_replaces_a_saturated_one():
    def burn_longest(frames, images):
        for f in frames:
            if (f.frame_type, f.filter_name) == ("white", "500"):
                longest = max(x.exposure_s for x in frames if x.frame_type == "white" and x.filter_name == "500")
                if f.exposure_s == longest:
                    images[f.file] = np.full((64, 64), 1023, np.uint16)
        return frames

    bands = band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=burn_longest)))
    truth, _ = expected()
    assert bands.flags[1] == ("ok", "ok", "ok")
    sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(-1, 3)[1]
    assert (np.abs(bands.fluorescence[1] - truth[1]) < stats.norm.isf(ERROR_RATE / 6) * sd).all()


def test_dark_white_is_weak():
    def dim(frames, images):
        for f in frames:
            if (f.frame_type, f.filter_name) == ("white", "660"):
                images[f.file][1::2, 1::2] = 16
        return frames

    bands = band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=dim)))
    assert bands.flags[3][2] == "weak"
    assert np.isfinite(bands.fluorescence_covariance).all()


def test_region_that_reaches_beyond_the_tile_is_told():
    def beside(frames, images):
        for f in frames:
            if f.frame_type == "white":
                images[f.file][:, 44:] = 20  # the last quarter of the region sees the ground
        return frames

    whole = band_signals(*_parts(synthetic_session(np.random.default_rng(1))))
    cut = band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=beside)))
    assert not [note for note in whole.notes if "beyond the tile" in note]
    assert len([note for note in cut.notes if "the region extends beyond the tile" in note]) == 1


def test_laser_that_misses_the_tile():
    def laser_off(frames, images):
        for f in frames:
            if f.frame_type == "laser white":
                images[f.file] = np.full((64, 64), 15, np.uint16)
        return frames

    with pytest.raises(RadiometryError, match="no signal through the excitation filter"):
        band_signals(*_parts(synthetic_session(np.random.default_rng(1), change=laser_off)))


def test_excitation_filter_that_was_not_captured():
    synthetic = synthetic_session(np.random.default_rng(2))
    plan = synthetic.session.plan.model_copy(update={"excitation_filter": "451"})
    with pytest.raises(RadiometryError, match=r"excitation_filter: '451' is not among the captured filters \(450, 500"):
        band_signals(synthetic.session.model_copy(update={"plan": plan}), synthetic.read)


def test_filters_of_the_plan_only():
    session = record(synthetic_session(np.random.default_rng(2)).session.frames)
    synthetic = synthetic_session(np.random.default_rng(2))
    plan = session.plan.model_copy(update={"filters": FILTERS[:3]})
    bands = band_signals(synthetic.session.model_copy(update={"plan": plan}), synthetic.read)
    assert [f.name for f in bands.optics.filters] == list(FILTERS[:3])


def test_session_of_the_simulated_rig_against_the_bench_physics(tmp_path):
    """The whole bench (uneven laser, texture, non-uniform pixels, leaks) against its own noise-free integrals."""
    from pathlib import Path

    from data_schemas.storage import camera_response
    from rigs.simulated import Bench

    rig = simulated_rig("red", seed=4, width_px=320, height_px=256)
    plan = paint_plan("red", rig.camera)
    out = tmp_path / "session"
    session = capture_paint_session(rig, plan, SessionRequest(out, "pytest"))
    bands = band_signals(session, lambda frame: read_frame_of(out, frame))

    bench = Bench(rig, Path(), camera_response("assumed", Path()))
    slots = [f.slot for f in rig.filter_wheel.filters]
    signal = {
        (what, light): np.array([bench.band_electrons_per_s(radiance, slot) for slot in slots])
        for light in ("lamp", "laser")
        for what, radiance in (
            ("white", rig.white_reference.reflectance * bench.lights[light]),
            ("sample", bench.sample_radiance(bench.lights[light])),
        )
    }
    level = signal["white", "laser"][1] / signal["white", "lamp"][1] @ bands.channel_weights
    truth = signal["sample", "laser"] / signal["white", "lamp"] / level
    usable = bands.usable()
    sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(-1, 3)
    z = (bands.fluorescence - truth)[usable] / sd[usable]
    assert usable.sum() >= 20
    assert np.abs(z).max() < stats.norm.isf(ERROR_RATE / usable.sum() / 2)
    # Under the laser the tile is some thousand times darker at 600 nm than at 450 nm: a plain ratio would divide by it.
    assert signal["white", "laser"][5].max() / signal["white", "laser"][1].max() < 1e-3
