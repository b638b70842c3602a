"""A camera session becomes the sensor behind it; intervals cover; what cannot be characterised is refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from data_schemas import (
    CameraCharacterisation,
    CameraSettings,
    Estimate,
    Frame,
    PhotonTransferCurve,
    RadiometryError,
    provenance,
)
from data_schemas.storage import read_record, write_record
from finray_calib.radiometry import characterise_camera
from finray_calib.radiometry._camera_characterisation import _saturation
from finray_calib.radiometry._photon_transfer import normal_estimate
from tests.radiometry.camera_sessions import (
    BLACK_LEVEL_DN,
    DARK_CURRENT_E_PER_S,
    DSNU_E,
    EXPOSURES_S,
    FULL_WELL_E,
    GAIN_E_PER_DN,
    LONG_DARK_S,
    PRNU_REL,
    READ_NOISE_E,
    SENSOR,
    SyntheticCameraSession,
    camera_session,
)

# Every comparison with the truth below is at 5 standard deviations: a false alarm in 1.7 million, the seeds are fixed.
SIGMAS = 5.0


@pytest.fixture(scope="module")
def session() -> SyntheticCameraSession:
    return camera_session(np.random.default_rng(1), side_px=192, repeats=14, flicker_rel=0.002)


@pytest.fixture(scope="module")
def found(session: SyntheticCameraSession) -> CameraCharacterisation:
    return characterise_camera(session.session, session.read)


def agrees(estimate: Estimate, truth: float, largest_sd: float) -> bool:
    return abs(estimate.estimate - truth) < SIGMAS * estimate.sd and estimate.sd < largest_sd


def test_every_channel_finds_the_sensor(found: CameraCharacterisation) -> None:
    assert [c.channel for c in found.channels] == ["red", "green", "blue"]
    assert [c.pixels for c in found.channels] == [96 * 96, 2 * 96 * 96, 96 * 96]
    assert found.warnings == ()
    for c in found.channels:
        assert agrees(c.gain_e_per_dn, GAIN_E_PER_DN, 0.01 * GAIN_E_PER_DN)
        assert agrees(c.read_noise_e, READ_NOISE_E, 0.01 * READ_NOISE_E)
        assert agrees(c.read_noise_dn, READ_NOISE_E / GAIN_E_PER_DN, 0.01 * READ_NOISE_E)
        assert agrees(c.black_level_dn, BLACK_LEVEL_DN, 0.05)
        assert agrees(c.dark_current_e_per_s, DARK_CURRENT_E_PER_S, 0.3)
        assert agrees(c.dsnu_dn, DSNU_E / GAIN_E_PER_DN, 0.03)
        assert agrees(c.prnu_rel, PRNU_REL, 0.0005)
        # the light is even: the whole of the differences is the sensor's
        assert agrees(c.flat_nonuniformity_rel, PRNU_REL, 0.0003)
        assert c.prnu_rel.resolved
        assert c.chi_square_p > 1e-3


def test_saturation_lies_between_the_levels_beside_it(found: CameraCharacterisation) -> None:
    full_well_dn = FULL_WELL_E / GAIN_E_PER_DN + BLACK_LEVEL_DN
    for c in found.channels:
        assert c.saturation_dn is not None
        assert c.full_well_e is not None
        assert c.snr_max is not None
        assert c.dynamic_range is not None
        # pixels of 1 % more and of 1 % less sensitivity clip around the full well, so the variance falls before it
        assert 0.9 * full_well_dn < c.saturation_dn.estimate < full_well_dn
        assert c.saturation_dn.low95 < 0.97 * full_well_dn < c.saturation_dn.high95
        assert agrees(c.full_well_e, 0.97 * FULL_WELL_E, 0.05 * FULL_WELL_E)
        assert c.snr_max.estimate == pytest.approx(np.sqrt(c.full_well_e.estimate), rel=1e-12)
        threshold_e = np.hypot(READ_NOISE_E, GAIN_E_PER_DN / np.sqrt(12)) + 0.5
        expected = c.full_well_e.estimate / threshold_e
        assert c.dynamic_range.estimate == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("gain", "gain_sd"), [(0.5, 0.05), (2.0, 0.2)])
def test_the_dynamic_range_is_as_uncertain_as_draws_of_what_it_is_made_of(gain: float, gain_sd: float) -> None:
    """A gain known to 10 % is in well and threshold alike; the draws take nothing as linear."""
    rng, count = np.random.default_rng(0), 100_000
    levels = SimpleNamespace(lit=[SimpleNamespace(mean_dn=mean_dn) for mean_dn in (3000.0, 3900.0, 4000.0, 4090.0)])
    transfer = SimpleNamespace(gain_e_per_dn=normal_estimate(gain, gain_sd), read_noise_dn=normal_estimate(2.0, 0.05))
    found = _saturation(levels, 2, 64.0, transfer).dynamic_range
    e_per_dn, noise_dn = rng.normal(gain, gain_sd, count), rng.normal(2.0, 0.05, count)
    charge_dn = rng.uniform(3905.0, 4095.0, count) - 64.0  # as wide as from the level below to that above
    drawn = charge_dn * e_per_dn / (np.sqrt(noise_dn**2 + 1.0 / 12.0) * e_per_dn + 0.5)
    assert found is not None
    # terms of second order, of a gain of 10 %
    assert found.sd / found.estimate == pytest.approx(drawn.std() / drawn.mean(), rel=0.03)


def test_lamp_and_linearity(found: CameraCharacterisation) -> None:
    # one exposure repeats within 0.2 %; 30 differences tell it to 13 %
    assert found.light_repeatability_rel == pytest.approx(0.002, rel=SIGMAS * 0.13)
    for c in found.channels:
        # the lamp alone gives 0.2 % / sqrt(2) * 0.8 per level
        assert not c.linearity_error_rel.resolved
        assert c.linearity_error_rel.high95 < 0.003
        assert c.linearity_lowest_rel < 0 < c.linearity_highest_rel


def test_bent_camera_is_found_nonlinear(session: SyntheticCameraSession) -> None:
    def bend(frame: Frame, counts: np.ndarray) -> np.ndarray:
        signal = counts.astype(float) - BLACK_LEVEL_DN
        return np.rint(np.clip(signal * (1 - 0.05 * signal / 3500) + BLACK_LEVEL_DN, 0, 4095)).astype(np.uint16)

    bent = session.change(bend)
    found = characterise_camera(bent.session, bent.read)
    assert all(c.linearity_error_rel.resolved for c in found.channels)
    assert all(0.003 < c.linearity_error_rel.estimate < 0.05 for c in found.channels)


def test_curve_is_stored_with_the_levels_that_were_used(found: CameraCharacterisation, tmp_path: Path) -> None:
    for c in found.channels:
        signal = c.curve.mean_dn - c.curve.dark_mean_dn
        assert c.saturation_dn is not None
        top_dn = c.saturation_dn.estimate - BLACK_LEVEL_DN
        assert c.curve.in_line.tolist() == (signal <= 0.7 * top_dn).tolist()
        assert np.isfinite(c.curve.deviation_rel).sum() >= 10
        assert c.curve.saturated_fraction[0] == 0.0
    path = write_record(found, tmp_path / "camera.json", provenance("pytest"))
    again = read_record(path, CameraCharacterisation)
    assert again.channels[1].gain_e_per_dn == found.channels[1].gain_e_per_dn
    np.testing.assert_array_equal(again.channels[2].curve.deviation_rel, found.channels[2].curve.deviation_rel)


def test_curve_of_unequal_lengths_is_refused(found: CameraCharacterisation) -> None:
    curve = dict(found.channels[0].curve)
    with pytest.raises(ValidationError, match="'mean_dn' has 3 entries along 'level', but 'exposure_s' has 16"):
        PhotonTransferCurve.model_validate({**curve, "mean_dn": np.ones(3)})


def test_settings_take_the_measured_numbers(found: CameraCharacterisation) -> None:
    before = CameraSettings(width_px=640, model="kept")
    after = found.applied_to(before)
    assert after.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=0.01)
    assert after.read_noise_e == pytest.approx(READ_NOISE_E, rel=0.02)
    assert after.black_level_dn == pytest.approx(BLACK_LEVEL_DN, abs=0.05)
    measured = {"gain_e_per_dn", "read_noise_e", "black_level_dn"}
    assert after.model_dump(exclude=measured) == before.model_dump(exclude=measured)
    estimates = [c.gain_e_per_dn for c in found.channels]
    weights = [1 / e.sd**2 for e in estimates]
    assert after.gain_e_per_dn == pytest.approx(np.average([e.estimate for e in estimates], weights=weights))


SESSIONS, SIDE_PX = 100, 64
# Binomial limits for 3 x 100 nearly independent intervals of 95 %: 4 standard deviations, a false alarm in 16 000.
COVERED = 0.95 + 4.0 * np.sqrt(0.95 * 0.05 / (3 * SESSIONS)) * np.array([-1, 1])


def test_intervals_cover() -> None:
    hits: dict[str, list[bool]] = {}
    for seed in range(SESSIONS):
        rng, sensor = np.random.default_rng([20, seed]), replace(SENSOR, seed=seed)
        made = camera_session(rng, sensor, SIDE_PX, repeats=4, flicker_rel=0.002, exposures_s=EXPOSURES_S[:12])
        for c in characterise_camera(made.session, made.read).channels:
            for name, estimate, truth in (
                ("gain", c.gain_e_per_dn, GAIN_E_PER_DN),
                ("read noise", c.read_noise_e, READ_NOISE_E),
                ("black level", c.black_level_dn, BLACK_LEVEL_DN),
                ("dark current", c.dark_current_e_per_s, DARK_CURRENT_E_PER_S),
                ("DSNU", c.dsnu_dn, DSNU_E / GAIN_E_PER_DN),
                ("PRNU", c.prnu_rel, PRNU_REL),
            ):
                hits.setdefault(name, []).append(estimate.low95 <= truth <= estimate.high95)
    shares = {name: float(np.mean(each)) for name, each in hits.items()}
    assert all(COVERED[0] < share < COVERED[1] for share in shares.values()), shares


def test_clean_camera_gets_upper_limits() -> None:
    clean = replace(SENSOR, prnu_rel=0.0, dsnu_e=0.0, dark_current_e_per_s=0.0)
    made = camera_session(np.random.default_rng(30), clean, 128, repeats=6)
    resolved = 0
    for c in characterise_camera(made.session, made.read).channels:
        for limit, largest in (
            (c.dark_current_e_per_s, 0.1),
            (c.dsnu_dn, 0.6),
            (c.prnu_rel, 0.005),
        ):
            assert 0.0 < limit.high95 < largest
            assert limit.resolved == (limit.low95 > 0.0)
            resolved += limit.resolved
    # each of the nine is taken for resolved by chance in 2.5 % of all runs: three or more in 0.12 %
    assert resolved <= 2


# What a user should know.


def test_camera_that_never_saturates_is_reported() -> None:
    made = camera_session(np.random.default_rng(31), light=(1.0, 1.0, 0.3))
    found = characterise_camera(made.session, made.read)
    assert found.channels[2].saturation_dn is None
    assert any(w.startswith("blue: no exposure saturates") for w in found.warnings)
    assert agrees(found.channels[2].gain_e_per_dn, GAIN_E_PER_DN, 0.1)


def test_low_black_level_coarse_counts_and_white_balance_are_reported() -> None:
    low = camera_session(np.random.default_rng(32), replace(SENSOR, black_level_dn=4.0))
    assert any("of the dark counts are 0" in w for w in characterise_camera(low.session, low.read).warnings)
    coarse = camera_session(np.random.default_rng(33), replace(SENSOR, read_noise_e=0.5, dark_current_e_per_s=0.0))
    warnings = characterise_camera(coarse.session, coarse.read).warnings
    assert any("the dark variance is below 0.24 DN^2" in w for w in warnings)

    def balance(frame: Frame, counts: np.ndarray) -> np.ndarray:
        counts[1::2, 1::2] = np.minimum(1.5 * (counts[1::2, 1::2] - BLACK_LEVEL_DN) + BLACK_LEVEL_DN, 4095)
        return counts

    balanced = camera_session(np.random.default_rng(34), side_px=128).change(balance)
    warnings = characterise_camera(balanced.session, balanced.read).warnings
    assert any("the channels differ in gain (red" in w and "white balance" in w for w in warnings)


def test_bent_photon_transfer_is_reported_and_widens_intervals(session: SyntheticCameraSession) -> None:
    def gamma(frame: Frame, counts: np.ndarray) -> np.ndarray:
        return np.rint(4095 * (counts / 4095) ** 0.6).astype(np.uint16)

    bent = session.change(gamma)
    found = characterise_camera(bent.session, bent.read)
    assert any("variance against mean is not a straight line" in w for w in found.warnings)
    straight = characterise_camera(session.session, session.read)
    ratio = [
        a.gain_e_per_dn.sd / a.gain_e_per_dn.estimate / (b.gain_e_per_dn.sd / b.gain_e_per_dn.estimate)
        for a, b in zip(found.channels, straight.channels, strict=True)
    ]
    assert min(ratio) > 2.0


# What is refused.


def darkless(frame: Frame, counts: np.ndarray) -> np.ndarray | None:
    return None if frame.frame_type == "dark" else counts


def darkless_at_one_exposure(frame: Frame, counts: np.ndarray) -> np.ndarray | None:
    return None if frame.frame_type == "dark" and frame.exposure_s == EXPOSURES_S[4] else counts


def few_levels(frame: Frame, counts: np.ndarray) -> np.ndarray | None:
    return counts if frame.exposure_s in (*EXPOSURES_S[:9], LONG_DARK_S) else None


def saturated(frame: Frame, counts: np.ndarray) -> np.ndarray:
    return np.full_like(counts, 4095) if frame.frame_type == "white" else counts


def nan(frame: Frame, counts: np.ndarray) -> np.ndarray:
    return np.where(np.arange(counts.size).reshape(counts.shape) == 77, np.nan, counts)


def frozen(frame: Frame, counts: np.ndarray) -> np.ndarray:
    return np.full_like(counts, 64 + (frame.frame_type == "white") * int(1e5 * frame.exposure_s))


def short(frame: Frame, counts: np.ndarray) -> np.ndarray:
    return counts[:-4] if frame.sequence == 1 else counts


def only_the_first_of_each(frame: Frame, counts: np.ndarray) -> np.ndarray | None:
    return counts if frame.sequence % 2 == 0 else None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            darkless,
            r"dark frames are missing at 0\.0014375 s, .* \(16 of 16 exposures lack them\); capture dark",
        ),
        (darkless_at_one_exposure, r"dark frames are missing at 0\.0071875 s \(1 of 16 exposures lack them\)"),
        (few_levels, r"has flat frames at only 9 exposures, but at least 10 exposures are needed; raise plan\.levels"),
        (saturated, r"red channel: only 0 of 16 exposures give unsaturated counts at 0 % to 70 % .*16 are saturated"),
        (nan, r"white frames of 0\.0014375 s: frame 1 contains NaN"),
        (frozen, r"red channel: the frames of \d+ of \d+ exposures are identical \(variance 0 DN\^2\)"),
        (short, r"white frames of 0\.0014375 s: frame 2 has 60 x 64 px, but the frames before it have 64 x 64 px"),
        (
            only_the_first_of_each,
            r"white frames of 0\.0014375 s: has 1 frame, but at least 2 frames of the same exposure",
        ),
    ],
)
def test_session_that_cannot_be_characterised(
    change: Callable[[Frame, np.ndarray], np.ndarray | None], message: str
) -> None:
    made = camera_session(np.random.default_rng(40)).change(change)
    with pytest.raises(RadiometryError, match=message):
        characterise_camera(made.session, made.read)


def test_levels_that_leave_out_the_linear_range_are_refused() -> None:
    exposures_s = (*(float(t) for t in np.linspace(1e-5, 4e-4, 12)), 0.01, 0.024, 0.026)
    made = camera_session(np.random.default_rng(41), exposures_s=exposures_s)
    with pytest.raises(
        RadiometryError, match=r"red channel: only 0 of 15 exposures give unsaturated counts at 5 % to 95 %"
    ):
        characterise_camera(made.session, made.read)
