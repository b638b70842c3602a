"""Registration against known maps, on images without texture: shades of bumps, another gain, tone and vignetting."""

import cv2
import numpy as np
import pytest

from data_schemas import CompareError, SimulatedPress
from finray_calib.compare import CheckOptions, compare_checked, register_press
from finray_calib.compare._registration import move_press, register, scaled_map, warp_image
from tests.command_line.records import capture_of
from tests.command_line.records import press as press_record

SHAPE = (240, 320)
EVERYWHERE = np.ones(SHAPE, bool)


def shaded(rng, place=None):
    """Three lights on bumps and a ridge, smooth everywhere; `place` (rows, columns) is where it is looked at."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float) if place is None else place
    center_row, center_column, angle = rng.uniform(90, 150), rng.uniform(110, 210), rng.uniform(0, np.pi)
    height = 30 * np.exp(-(((rows - center_row) / 35) ** 2 + ((columns - center_column) / 35) ** 2))
    across = (rows - 60) * np.cos(angle) + (columns - 100) * np.sin(angle)
    height += 12 * np.exp(-((across / 14) ** 2) - ((rows - 100) ** 2 + (columns - 160) ** 2) / 120**2)
    for row, column in rng.uniform([15, 15], [SHAPE[0] - 15, SHAPE[1] - 15], (5, 2)):
        height += 8 * np.exp(-(((rows - row) / 16) ** 2 + ((columns - column) / 24) ** 2))
    by_row, by_column = np.gradient(height)
    norm = np.sqrt(1 + by_row**2 + by_column**2)
    lights = [(0.0, 0.8), (0.5, 0.2), (-0.3, -0.4)]
    light = np.stack([(0.6 + a * by_row + b * by_column) / norm for a, b in lights], axis=2)
    return np.clip(light, 0.02, None)


def drift(rng, size_px):
    """A map of about `size_px`: shift, a little turn and scale about the middle."""
    turn = cv2.getRotationMatrix2D(
        (SHAPE[1] / 2, SHAPE[0] / 2), rng.uniform(-0.2, 0.2) * size_px, 1 + rng.uniform(-0.003, 0.003) * size_px
    )
    turn[:, 2] += size_px * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
    return turn


def seen_through(to_render, seed, noise=0.004):
    """The capture: the scene of the render where the map says, with other gains, a tone, vignetting and noise."""
    rng = np.random.default_rng([seed, 1])
    columns, rows = np.meshgrid(np.arange(SHAPE[1], dtype=float), np.arange(SHAPE[0], dtype=float))
    place = (to_render[1, 0] * columns + to_render[1, 1] * rows + to_render[1, 2],
             to_render[0, 0] * columns + to_render[0, 1] * rows + to_render[0, 2])  # fmt: skip
    image = shaded(np.random.default_rng(seed), place)
    radius = np.hypot(rows - SHAPE[0] / 2, columns - SHAPE[1] / 2) / (SHAPE[1] / 2)
    image = (np.array([1.2, 0.9, 1.1]) * image) ** 0.9 * (1 - 0.1 * radius**2)[..., None]
    return 800 * (image + noise * rng.standard_normal(image.shape))


def apart_px(first, second):
    """Root mean square over the frame of how far two maps are apart."""
    columns, rows = np.meshgrid(np.linspace(0, SHAPE[1] - 1, 9), np.linspace(0, SHAPE[0] - 1, 7))
    places = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)])
    return float(np.sqrt((((first - second) @ places) ** 2).sum(axis=0).mean()))


def test_known_drifts_are_found():
    errors, before = [], []
    for seed in range(8):
        true = drift(np.random.default_rng([seed, 2]), size_px=4.0)
        found = register(shaded(np.random.default_rng(seed)), seen_through(true, seed))
        errors.append(apart_px(found.to_render, true))
        before.append(apart_px(np.eye(2, 3), true))
        assert found.significant
    # Affine ECC on plain gradients reached 0.9 px on such images of 640 x 480 px; none may get worse.
    assert np.median(errors) <= 1.0
    assert (np.array(errors) < before).all()


def test_pictures_that_agree_are_left_alone():
    """Other gain, tone and vignetting alone would give an affine map of some pixels, which explains next to nothing."""
    for seed in range(4):
        found = register(shaded(np.random.default_rng(seed)), seen_through(np.eye(2, 3), seed))
        assert not found.significant
        assert found.move_px == 0


def test_pixels_that_are_missing_do_not_matter():
    true = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, -2.0]])
    capture = seen_through(true, 3)
    plain = register(shaded(np.random.default_rng(3)), capture)
    capture[40:60, 250:290] = np.nan
    found = register(shaded(np.random.default_rng(3)), capture, EVERYWHERE)
    assert apart_px(found.to_render, plain.to_render) < 0.2


def test_what_cannot_be_trusted_is_rejected_with_reasons():
    rng = np.random.default_rng(0)
    flat = np.full((*SHAPE, 3), 100.0)
    for other in (flat + rng.standard_normal(flat.shape), flat):
        # what to do depends on what was asked for: see the test of what is said about a failed registration
        with pytest.raises(
            CompareError, match=r"registration (failed: the pictures have too few|is rejected because )"
        ):
            register(shaded(rng), other)
    far = np.array([[1.0, 0.0, 26.0], [0.0, 1.0, 0.0]])
    with pytest.raises(
        CompareError, match=r"the render would move by up to [23]\d\.\d px, but at most 12 px are allowed"
    ):
        register(shaded(np.random.default_rng(1)), seen_through(far, 1))
    large = cv2.getRotationMatrix2D((160, 120), 8.0, 1.08)
    with pytest.raises(
        CompareError,
        match=r"scale would change to 1\.\d\d\d .* at most 5 % is allowed; the render would turn .* at most 5 deg are",
    ):
        register(shaded(np.random.default_rng(1)), seen_through(large, 1))
    with pytest.raises(
        CompareError, match=r"the correlation of the gradients is only 0\.\d\d, but must be at least 0\.85"
    ):
        register(shaded(np.random.default_rng(1)), seen_through(np.eye(2, 3), 1, noise=0.3))
    with pytest.raises(CompareError, match=r"only 0\.0 % of the picture is usable .* at least 5 %"):
        register(shaded(rng), np.full((*SHAPE, 3), np.nan))
    with pytest.raises(
        CompareError, match="a render of 320 x 240 px cannot be registered to a capture of 320 x 200 px"
    ):
        register(shaded(rng), shaded(rng)[:200])


def test_a_coarse_grid_is_off_by_half_a_pixel():
    """Pixel 0 of a grid of 2 x 2 blocks lies at 0.5 of the fine one: a map that turns must not shift because of it."""
    turn = cv2.getRotationMatrix2D((0.0, 0.0), 2.0, 1.1)
    fine = scaled_map(turn, 2.0)
    coarse = np.array([7.0, 3.0, 1.0])
    moved = turn @ coarse
    assert fine @ np.array([2 * 7 + 0.5, 2 * 3 + 0.5, 1.0]) == pytest.approx(2 * moved + 0.5, abs=1e-12)
    assert scaled_map(fine, 0.5) == pytest.approx(turn, abs=1e-12)
    # leaving the half pixel out would be wrong by this much here
    assert np.abs(fine[:, 2] - 2 * turn[:, 2]).max() > 0.02


def test_a_warp_shows_the_place_it_says():
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    true = np.array([[1.01, 0.004, 2.3], [-0.004, 1.01, -1.7]])
    plane = warp_image(0.5 * columns - 0.25 * rows, true)
    expected = 0.5 * (true[0] @ [columns[120, 100], 120, 1]) - 0.25 * (true[1] @ [columns[120, 100], 120, 1])
    # OpenCV places its window to 1/32 px
    assert plane[120, 100] == pytest.approx(expected, abs=0.75 / 32)
    assert np.isnan(plane[0]).all()
    linear = warp_image(0.5 * columns - 0.25 * rows, true, cv2.INTER_LINEAR)
    assert np.isnan(plane).sum() > np.isnan(linear).sum() > 0
    whole = warp_image(np.dstack([rows, columns]), np.eye(2, 3))
    assert (whole[3:-4, 3:-4] == np.dstack([rows, columns])[3:-4, 3:-4]).all()


def test_a_missing_pixel_takes_out_its_window_only():
    image = np.ones((*SHAPE, 3))
    image[100, 150, 1] = np.nan
    gone = np.isnan(warp_image(image, np.array([[1.0, 0, 0.5], [0, 1, 0.5]]))).all(axis=2)
    inside = gone[10:-10, 10:-10]
    assert inside.sum() == 64
    assert gone[96:104, 146:154].all()


def test_a_press_is_moved_with_everything_in_it():
    press = press_record()
    press = press.model_copy(update={"variance": np.full_like(press.contact, 4.0)})
    shift = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 0.0]])
    moved = move_press(press, shift)
    assert moved.contact[20, 30] == pytest.approx(press.contact[20, 33], rel=1e-6)
    assert moved.no_contact.min() > 0
    assert moved.variance == pytest.approx(press.variance, rel=1e-6)
    assert moved.distance[20, 30] == pytest.approx(press.distance[20, 33], rel=1e-6)
    # where Lanczos' window leaves the render no region may look
    assert np.isnan(moved.distance[:, -6:]).all()
    assert np.isfinite(moved.contact).all()


def test_a_drift_is_told_and_mended_when_asked():
    press, shift = detailed_press(), np.array([[1.0, 0.0, -4.0], [0.0, 1.0, 2.5]])
    capture = capture_of(press, 50.0)
    drifted = move_press(press, shift)
    found, state = register_press(drifted, capture)
    assert state == "no contact"
    assert found.to_render[:, 2] == pytest.approx([4.0, -2.5], abs=0.3)
    assert not register_press(press, capture)[0].significant
    off, _ = compare_checked(drifted, capture, 1)
    assert any("the camera has drifted, as the images with no contact show: the render lies" in f for f in off.findings)
    mended, shown = compare_checked(drifted, capture, 1, CheckOptions(registered=True))
    assert shown is not drifted
    assert any("the render was moved" in f for f in mended.findings)
    # the render is the capture's own scene: in place it explains nearly all, 4.7 px beside it much less
    assert off.headline_skill.estimate < 0.9 < 0.98 < mended.headline_skill.estimate


def test_registration_that_was_asked_for_and_fails_is_an_error_else_a_finding():
    press = press_record()
    capture = capture_of(press, 50.0)
    noise = np.random.default_rng(0).integers(1000, 9000, capture.contact.shape).astype(np.uint16)
    spoilt = capture.model_copy(update={"contact": noise, "no_contact": noise})
    with pytest.raises(
        CompareError, match=r"on the images with no contact: registration .* on the images with contact: "
    ):
        register_press(press, spoilt)
    flat = press.model_copy(
        update={"no_contact": 0 * press.no_contact + 50, "contact": 50 * press.contact / press.contact}
    )
    with pytest.raises(CompareError, match="on the images with no contact"):
        compare_checked(flat, capture, 1, CheckOptions(registered=True, despite_mismatch=True))


def test_what_to_do_about_a_failed_registration_is_said_once_and_fits_the_command():
    press = press_record()
    capture = capture_of(press, 50.0)
    flat = press.model_copy(
        update={"no_contact": 0 * press.no_contact + 50, "contact": 50 * press.contact / press.contact}
    )
    report, _ = compare_checked(flat, capture, 1, CheckOptions(despite_mismatch=True))
    (told,) = [finding for finding in report.findings if "it is not known whether the camera" in finding]
    assert told.count("registration") == 2
    assert told.count("Check that the render") == told.count("ChArUco") == 1
    assert "--register" not in told
    detailed = detailed_press()
    far, seen = move_press(detailed, np.array([[1.0, 0.0, 26.0], [0.0, 1.0, 0.0]])), capture_of(detailed, 50.0)
    for rendered, captured, reason in (
        (flat, capture, "failed: the pictures have"),
        (far, seen, "is rejected because "),
    ):
        with pytest.raises(CompareError, match=rf"registration {reason}.*, or compare without --register$") as refused:
            compare_checked(rendered, captured, 1, CheckOptions(registered=True, despite_mismatch=True))
        assert str(refused.value).count("Check that the render") == 1


@pytest.mark.parametrize("registered", [False, True])
def test_a_prediction_from_the_captures_own_picture_tells_no_drift(registered):
    press = press_record("unknown")
    capture = capture_of(press, 50.0, encoding="unknown")
    own = capture.no_contact - np.float32(capture.black_level_dn)
    predicted = press.model_copy(update={"no_contact": own, "contact": own * (press.contact / press.no_contact)})
    report, shown = compare_checked(predicted, capture, 1, CheckOptions(registered=registered))
    assert shown is predicted
    (told,) = [finding for finding in report.findings if "drift" in finding]
    assert "begins from the capture's own image without contact" in told
    assert "px" not in told


def test_a_mismatch_is_refused_or_told():
    press = press_record()
    capture = capture_of(press, 50.0)
    swapped = capture.model_copy(update={"contact": capture.contact[..., ::-1].copy()})
    with pytest.raises(
        CompareError, match=r"do not belong together: the contact image .* as BGR much better than as RGB"
    ):
        compare_checked(press, swapped, 1)
    report, _ = compare_checked(press, swapped, 1, CheckOptions(despite_mismatch=True))
    assert any(f.startswith("channel order: ") for f in report.findings)
    assert report.forced_mismatch
    assert not compare_checked(press, capture, 1, CheckOptions(despite_mismatch=True))[0].forced_mismatch


def detailed_press():
    """A strip of contact on a pad with shades and edges all over, as a real picture has."""
    columns = np.arange(SHAPE[1], dtype=float)
    distance = np.broadcast_to(np.abs(columns - 150.0) / 25.0, SHAPE)
    pad = 100 * shaded(np.random.default_rng(5))
    return SimulatedPress(
        name="strip", label="made up", method="rendered", encoding="linear", no_contact=pad,
        contact=pad * (1 - 0.4 * np.exp(-(distance**2)))[..., None], distance=distance, variance=None,
        light_angle_deg=30.0, design=None,
    )  # fmt: skip
