"""Made-up pairs of a render and a capture, right and spoilt in known ways; real and rendered pairs where they exist."""

import re

import numpy as np
import pytest

from data_schemas import CompareError, IndenterPose, SimulatedPress, TactileCapture
from finray_calib.compare import find_mismatches
from finray_calib.compare._mismatch import Finding, better_order, require_no_mismatch, tone_curve
from finray_calib.exchange import nine_dtact_capture, nine_dtact_prediction
from tests.compare.three_lights import dent_slopes, shaded

BLACK_DN, DN_PER_UNIT, BITS = 64.0, 900.0, 12


def coloured_press(rng, grey=False):
    """Light from three sides over a pad with a strip of contact; `grey` gives all channels the same."""
    rows, columns = np.mgrid[0:120, 0:160].astype(float)
    red, green, blue = 0.25 + 0.8 * columns / 160, 0.9 - 0.7 * columns / 160, 0.5 + 2.0 * rows / 120
    pad = np.stack([blue, blue, blue] if grey else [red, green, blue], axis=2)
    distance = np.abs(columns - rng.uniform(60, 100)) / 12.0
    contact = pad * (1 - np.array([0.3, -0.2, 0.4]) * np.exp(-(distance**2))[..., None])
    return SimulatedPress(
        name="strip", label="made up", method="rendered", encoding="linear", no_contact=pad, contact=contact,
        distance=distance, variance=None, light_angle_deg=30.0, design=None,
    )  # fmt: skip


def counts(image, rng):
    noisy = (
        BLACK_DN + DN_PER_UNIT * image + rng.normal(0, 2, image.shape) + np.sqrt(image) * rng.normal(0, 5, image.shape)
    )
    return np.rint(noisy).clip(0, 2**BITS - 1).astype(np.uint16)


def capture_of(press, rng):
    """The capture: the render with errors of its own (a shading of 10 %), and a repeat that drifted by 1 %."""
    shading = 1 + 0.1 * np.cos(np.arange(160) / 25)[None, :, None]
    contact, no_contact = press.contact * shading, press.no_contact * shading
    return TactileCapture(
        name="capture", contact=counts(contact, rng), no_contact=counts(no_contact, rng),
        repeat_no_contact=counts(1.01 * no_contact, rng), layout="RGB", encoding="linear", bit_depth=BITS,
        black_level_dn=BLACK_DN, exposure_s=0.02, light_angle_deg=30.0,
        indenter=IndenterPose(shape="cylinder", radius_mm=10.0, depth_mm=1.5, position_mm=35.0), contact_circle=None,
        mm_per_px=None, source="test",
    )  # fmt: skip


IMAGES = ("contact", "no_contact", "repeat_no_contact")


def edited(capture, change, *names):
    return capture.model_copy(update={name: change(getattr(capture, name)) for name in names or IMAGES})


def brighter(factor):
    return lambda dn: np.rint(BLACK_DN + factor * (dn - BLACK_DN)).clip(0, 2**BITS - 1).astype(np.uint16)


def encoded(dn):
    full = 2**BITS - 1 - BLACK_DN
    return np.rint(BLACK_DN + full * (np.clip(dn - BLACK_DN, 0, None) / full) ** 0.45).astype(np.uint16)


def reverse(dn):
    return dn[..., ::-1].copy()


SPOILT = {
    "contact in BGR": (
        lambda c: edited(c, reverse, "contact"), "refuse", "channel order", r"no-contact image when read as BGR",
    ),
    "all in BGR": (
        lambda c: edited(c, reverse), "refuse", "channel order", r"fits the render when read as BGR .*OpenCV's is BGR",
    ),
    "contact one third brighter": (
        lambda c: edited(c, brighter(4 / 3), "contact"), "refuse", "exposure", r"is 1\.3\d\d times as bright",
    ),
    "contact a tenth brighter": (
        lambda c: edited(c, brighter(1.1), "contact"), "warn", "exposure", r"is 1\.\d\d\d times as bright",
    ),
    "contact of two bits less": (
        lambda c: edited(c, brighter(0.25), "contact"),
        "refuse", "exposure", r"2 to the power -2, as between .* bit depth",
    ),
    "encoded": (
        lambda c: edited(c, encoded), "refuse", "encoding", r"to the power 0\.[45]\d .* it went through a tone curve",
    ),
    "black level left in": (
        lambda c: edited(c, lambda dn: dn + np.uint16(1400)).model_copy(update={"bit_depth": 14}),
        "refuse", "encoding", r"a constant of 1\d\d\d DN on top of linear light explains it better: check",
    ),
    "clipped below full scale": (
        lambda c: edited(c, lambda dn: np.minimum(dn, 1023)), "refuse", "levels",
        r"are exactly 1023 DN, which suggests data of 10 bit, .* full scale is recorded as 4095 DN \(12 bit\)",
    ),
    "counts above full scale": (
        lambda c: c.model_copy(update={"bit_depth": 10}),
        "refuse", "levels", r"above the full scale of 10 bit \(1023 DN\)",
    ),
    "shifted up": (
        lambda c: edited(c, lambda dn: dn * np.uint16(16)).model_copy(
            update={"bit_depth": 16, "black_level_dn": 16 * BLACK_DN}
        ),
        "warn", "levels", r"multiples of 16 DN only, .* clipped at 65520 DN are not recognised",
    ),
    "black level too high": (
        lambda c: c.model_copy(update={"black_level_dn": 900.0}), "refuse", "levels",
        r"below the recorded black level of 900 DN: light cannot be negative",
    ),
}  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_right_pairs_raise_no_alarm(seed):
    rng = np.random.default_rng(seed)
    press = coloured_press(rng)
    assert find_mismatches(press, capture_of(press, rng)) == ()


@pytest.mark.parametrize("case", SPOILT)
def test_spoilt_pairs_are_found_with_their_evidence(case):
    spoil, severity, about, text = SPOILT[case]
    for seed in range(4):
        rng = np.random.default_rng([seed, 1])
        press = coloured_press(rng)
        findings = find_mismatches(press, spoil(capture_of(press, rng)))
        found = [f for f in findings if f.about == about]
        assert found, f"{case}, seed {seed}: nothing found"
        assert found[0].severity == severity
        with pytest.raises(CompareError, match=text):
            require_no_mismatch([Finding("refuse", found[0].about, found[0].text)])
    if severity == "refuse":
        with pytest.raises(CompareError, match="the images do not belong together: "):
            require_no_mismatch(findings)
    else:
        require_no_mismatch(findings)


def test_a_gain_between_the_images_of_the_render_is_not_called_one_of_the_capture():
    rng = np.random.default_rng(0)
    press = coloured_press(rng)
    capture = capture_of(press, rng)
    (finding,) = find_mismatches(press.model_copy(update={"contact": 1.1 * press.contact}), capture)
    assert (finding.severity, finding.about) == ("warn", "exposure")
    assert re.search(
        r"the contact image of capture is (0\.99\d|1\.00\d) times as bright as its no-contact image in \w+, but that "
        r"of the render is 1\.(09|10)\d times as bright .*; render both images with the same exposure",
        finding.text,
    )


def test_a_grey_sensor_does_not_show_its_channel_order():
    rng = np.random.default_rng(0)
    press = coloured_press(rng, grey=True)
    capture = capture_of(press, rng)
    assert find_mismatches(press, edited(capture, reverse, "contact")) == ()


def test_too_little_to_judge_by_is_no_finding():
    rng = np.random.default_rng(0)
    press = coloured_press(rng)
    capture = capture_of(press, rng)
    nowhere = press.model_copy(update={"distance": np.full_like(press.distance, np.nan)})
    assert find_mismatches(nowhere, edited(capture, reverse)) == ()
    contact_everywhere = press.model_copy(update={"distance": 0 * press.distance})
    assert find_mismatches(contact_everywhere, edited(capture, brighter(1.5), "contact")) == ()
    without_repeat = capture.model_copy(update={"repeat_no_contact": None, "black_level_dn": 0.0})
    assert [f.severity for f in find_mismatches(press, without_repeat)] in ([], ["warn"])


def test_images_of_different_size_are_refused():
    rng = np.random.default_rng(0)
    press = coloured_press(rng)
    capture = edited(capture_of(press, rng), lambda dn: dn[:100])
    with pytest.raises(
        CompareError, match="strip has 160 x 120 px, but capture has 160 x 100 px; simulate with the camera"
    ):
        find_mismatches(press, capture)


def test_the_exponent_of_a_power_is_found():
    light = np.random.default_rng(0).uniform(0.1, 1, (500, 3))
    curve = tone_curve(light, 200 * light**0.45)
    assert curve.exponent == pytest.approx(0.45, abs=1e-12)
    assert not curve.offset_fits_better
    line = tone_curve(light, 200 * light + 100)
    assert line.offset_fits_better
    assert line.offset_dn == pytest.approx(100)
    assert tone_curve(light, 5 + light[::-1]) is None
    assert tone_curve(np.full((50, 3), 3.0), np.full((50, 3), 4.0)) is None


def test_an_exchange_of_two_channels_is_named():
    light = np.random.default_rng(0).uniform(0.1, 1, (500, 3)) * [1.0, 3.0, 9.0]
    for order in ([1, 0, 2], [2, 1, 0], [1, 2, 0]):
        found = better_order(light, 7 * light[:, order], 0.01)
        # reading the exchanged channels in this order gives the first image back
        assert found.order == "".join("RGB"[order.index(c)] for c in range(3))
        assert found.clear
    assert better_order(light, 7 * light, 0.01) is None


@pytest.mark.shared_data
@pytest.mark.parametrize("number", [1, 2])
def test_real_pairs_raise_no_alarm_and_their_exposure_is_watched(shared_data, number):
    """9DTact is grey: its channel order cannot be told, and its curve is unknown; its levels can."""
    folder = shared_data / "tactile" / "9dtact"
    press = nine_dtact_prediction(folder / f"sensor_{number}", folder / f"sensor_{3 - number}")
    capture = nine_dtact_capture(folder / f"sensor_{number}")
    assert find_mismatches(press, capture) == ()
    for factor, severity in ((1.25, "refuse"), (0.8, "refuse")):
        contact = np.rint(factor * capture.contact).clip(0, 254).astype(np.uint16)
        findings = find_mismatches(press, capture.model_copy(update={"contact": contact}))
        assert [(f.severity, f.about) for f in findings if f.about == "exposure"] == [(severity, "exposure")]


def one_colour(image, channel=slice(None)):
    return np.repeat(image[..., channel].reshape(*image.shape[:2], -1).mean(axis=-1, keepdims=True), 3, axis=-1)


def opaque_blue(image):
    return np.concatenate([image[..., :2], np.full_like(image[..., :1], image.mean())], axis=-1)


SHADED_CENTRE_PX, SHADED_RADIUS_PX = (60.0, 80.0), 18.0
#: What a render holds in place of colour -> change of both images, severity and words of the finding.
NO_COLOUR = {
    "mean": (one_colour, "refuse", r"the render ball is grey where .* the capture capture has colours there \(9\d %\)"),
    "red alone": (lambda image: one_colour(image, slice(0, 1)), "refuse", r"is grey where it is pressed"),
    "tinted": (lambda image: one_colour(image) * [1.0, 0.8, 0.6], "refuse", r"is grey where it is pressed"),
    "BGR": (lambda image: image[..., ::-1], "refuse", r"are read as BGR \(correlation [01]\.\d\d; as RGB 0\.[01]"),
    "transparency": (opaque_blue, "warn", r"blue of the render ball hardly changes .* transparency or depth"),
}  # fmt: skip


def shaded_pair(values, change=lambda image: image, rest_moved_px=0, *, sensor=lambda light: light, strength=1.0):
    """A ball under three coloured lights that are white together, so that only the touch shows colours.

    `change` is what the render holds of them, `sensor` what the camera sees before its noise.
    """
    slopes = strength * dent_slopes(*SHADED_CENTRE_PX, SHADED_RADIUS_PX, 46.0, (120, 160))
    texture = 1.0 + 0.15 * np.cos(np.arange(160) / 3.0)[None, :, None]
    light = [texture * shaded(of) for of in (slopes, np.zeros_like(slopes))]
    rows, columns = np.indices((120, 160))
    rng = np.random.default_rng(1)
    linear = values == ("linear", "linear")
    counted = [sensor(12.0 * image if linear else 255.0 * (image / 160.0) ** 0.45) for image in light]
    counted = [np.rint(image + rng.normal(0.0, 1.0, image.shape)).clip(0).astype(np.uint16) for image in counted]
    capture = TactileCapture(
        name="capture", contact=counted[0], no_contact=counted[1], repeat_no_contact=None, layout="RGB",
        encoding=values[1], bit_depth=12 if linear else 8, black_level_dn=0.0, exposure_s=None, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=4.6, depth_mm=None, position_mm=None), contact_circle=None,
        mm_per_px=None, source="test",
    )  # fmt: skip
    rendered = [255.0 * (image / 160.0) ** 0.45 for image in light] if values[0] == "unknown" else light
    rendered = [change(image).astype(np.float32) for image in rendered]
    away = np.hypot(rows - SHADED_CENTRE_PX[0], columns - SHADED_CENTRE_PX[1]) / SHADED_RADIUS_PX
    press = SimulatedPress(
        name="ball", label="made up", method="rendered", encoding=values[0], contact=rendered[0],
        no_contact=np.roll(rendered[1], rest_moved_px, axis=1), distance=away, variance=None, light_angle_deg=None,
        design=None,
    )  # fmt: skip
    return press, capture


VALUES = [("linear", "unknown"), ("linear", "linear"), ("unknown", "unknown")]


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("held", NO_COLOUR)
def test_what_a_render_holds_in_place_of_colour_is_told_by_its_change(values, held):
    assert find_mismatches(*shaded_pair(values)) == ()
    change, severity, text = NO_COLOUR[held]
    (finding,) = find_mismatches(*shaded_pair(values, change))
    assert finding.severity == severity
    assert re.search(text, finding.text)


@pytest.mark.parametrize("values", VALUES)
def test_a_rest_of_another_pose_is_told_and_an_idle_render_is_not(values):
    (finding,) = find_mismatches(*shaded_pair(values, rest_moved_px=8))
    assert finding.severity == "warn"
    assert re.search(r"the two images of the render ball differ unevenly, by \d+\.\d % .* one pose", finding.text)
    press, capture = shaded_pair(values)
    blank = press.model_copy(update={"contact": press.no_contact})
    assert find_mismatches(blank, capture) == ()


def seen_white(image, level_dn):
    """One white light from the right."""
    one = one_colour(image, slice(0, 1))
    return level_dn * one / one.mean()


@pytest.mark.parametrize("strength", [0.1, 0.2, 0.4, 1.0])
@pytest.mark.parametrize("level_dn", [20.0, 40.0, 80.0])
@pytest.mark.parametrize("values", VALUES)
def test_a_grey_sensor_has_no_colours_to_miss_however_weak_the_press(values, level_dn, strength):
    """Noise that each channel has for itself looks like colour; it refused such a render from 2 % of change down."""
    press, capture = shaded_pair(
        values, lambda image: one_colour(image, slice(0, 1)),
        sensor=lambda image: seen_white(image, level_dn), strength=strength,
    )  # fmt: skip
    assert find_mismatches(press, capture) == ()


@pytest.mark.parametrize("values", VALUES)
def test_a_channel_that_holds_noise_alone_is_not_missed_in_a_render(values):
    """A lamp without blue: 2 DN of stray light, whose noise is as large as what others change by."""

    def without_blue(image):
        return np.concatenate([image[..., :2], np.full_like(image[..., :1], 2.0)], axis=-1)

    press, capture = shaded_pair(values, without_blue, sensor=without_blue)
    assert [f.text for f in find_mismatches(press, capture) if f.about == "change by contact"] == []


def test_where_nothing_shows_the_noise_a_grey_render_is_told_but_not_refused():
    press, capture = shaded_pair(VALUES[1], one_colour)
    press = press.model_copy(update={"distance": np.minimum(press.distance, 2.5)})
    (finding,) = find_mismatches(press, capture)
    assert (finding.severity, finding.about) == ("warn", "change by contact")
    # with a repeat it is known again
    repeated = capture.model_copy(update={"repeat_no_contact": shaded_pair(VALUES[1])[1].no_contact + np.uint16(1)})
    findings = find_mismatches(press, repeated)
    assert ("refuse", "change by contact") in [(f.severity, f.about) for f in findings]
