"""The digital twin: a valid finger as built, a repeat with its render noise, and notes on the camera's curves."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import Coating, CurveError, FingerDesign, LightPanel, SpectralCurve, bayer_planes
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import assumed_camera_response
from sim.experiments import FingerScene, PaintedFinger
from sim.experiments import _light_angle as light_angle
from sim.experiments import _optics_products as digital_twin
from sim.experiments import _optics_products as tactile_camera
from sim.experiments import _rendered_press as press
from sim.optics import FIRST_CHAINS, ProbePaths, paint_bands

DESIGN = FingerDesign(camera=TactileCamera(width_px=128, height_px=96))
SIGMAS = 5.0


def finger(paints, first_nm=380.0):
    """A finger whose camera curves begin at `first_nm`; no renderer is called."""
    kept = [c.wavelength_nm >= first_nm for c in assumed_camera_response()]
    red, green, blue = (
        SpectralCurve(name=c.name, wavelength_nm=c.wavelength_nm[k], values=c.values[k], source="camera.csv")
        for c, k in zip(assumed_camera_response(), kept, strict=True)
    )
    return PaintedFinger(DESIGN, paints, (red, green, blue), SimpleNamespace())


def test_finger_as_built_differs_from_its_design():
    built = digital_twin.as_built_design(FingerDesign())
    assert built.light.angle_deg == 33.0
    assert built.coating.roughness_alpha == pytest.approx(0.275)
    assert built.coating.diffuse_share == pytest.approx(0.385)
    assert (built.pad, built.camera, built.indenter) == (
        FingerDesign().pad,
        FingerDesign().camera,
        FingerDesign().indenter,
    )


def test_finger_as_built_keeps_every_bound():
    extreme = FingerDesign(coating=Coating(roughness_alpha=0.95, diffuse_share=1.0), light=LightPanel(angle_deg=179.0))
    built = digital_twin.as_built_design(extreme)
    assert (built.coating.roughness_alpha, built.coating.diffuse_share) == (1.0, 1.0)
    assert built.light.angle_deg == -178.0  # 182 deg
    assert FingerDesign.model_validate(built.model_dump()) == built


def test_repeat_differs_like_a_second_render():
    bands = np.full((80, 90, 3), 10.0, np.float32)
    rng = np.random.default_rng(5)
    # as a render estimates it: a quarter of the squared difference of two halves, each of variance 2 x 0.04
    halves = rng.normal(0.0, np.sqrt(2 * 0.04), (2, *bands.shape))
    variance = (0.25 * (halves[0] - halves[1]) ** 2).astype(np.float32)
    difference = tactile_camera.repeat_render(bands, variance, rng).astype(float) - bands
    count = difference.size
    # the square of a difference is 0.08 chi-square(1), whose standard deviation is sqrt(2) times its mean
    assert np.mean(difference**2) == pytest.approx(2 * 0.04, rel=SIGMAS * np.sqrt(2 / count))
    assert abs(difference.mean()) < SIGMAS * np.sqrt(2 * 0.04 / count)
    for other in (difference[1:], difference[:, 1:]):
        here = difference[: other.shape[0], : other.shape[1]]
        assert abs(np.mean(here * other)) < SIGMAS * 2 * 0.04 / np.sqrt(other.size)


def test_repeat_of_dark_pixels_keeps_mean_and_variance_and_is_never_negative():
    """Salt and pepper: one half of the render found light and the other none, which is the darkest noise can be."""
    rng = np.random.default_rng(1)
    for half, other in ((2.0, 0.0), (2.0, 0.1), (2.0, 0.4)):
        mean, variance = (half + other) / 2.0, 0.25 * (half - other) ** 2
        bands = np.full((200, 300, 3), mean, np.float32)
        repeat = tactile_camera.repeat_render(bands, np.full_like(bands, variance), rng)
        assert repeat.dtype == np.float32
        assert repeat.min() >= 0.0
        difference = repeat.astype(float) - mean
        # 180 000 draws; cut off at zero, the first mean would be 0.2 of a unit too high, 70 standard errors
        assert abs(difference.mean()) < SIGMAS * np.sqrt(2.0 * variance / difference.size)
        fourth = np.mean((difference**2 - 2.0 * variance) ** 2)
        assert abs(np.mean(difference**2) - 2.0 * variance) <= SIGMAS * np.sqrt(fourth / difference.size) + 1e-5
    black = np.zeros((4, 4, 3), np.float32)
    np.testing.assert_array_equal(tactile_camera.repeat_render(black, black, rng), black)


FLAT = np.ones((96, 128, 3), np.float32)


def captured(monkeypatch, paints, variance, image=FLAT):
    """Capture a twin whose render has this image and variance in every band."""
    render = SimpleNamespace(
        bands=paint_bands(paints["red"], paints["green"], DESIGN.light),
        no_contact_bands=image,
        contact_bands=image,
        no_contact_variance=np.float32(variance) * FLAT,
    )
    given = []

    def rendered(design, paints, renderer, settings, **_):
        given.append(settings)
        return render

    monkeypatch.setattr(digital_twin, "render_press", rendered)
    twin = digital_twin.capture_twin(finger(paints), 30.0, seed=3, samples_per_pixel=2)
    assert [settings.common_random_numbers for settings in given] == [False]
    return [bayer_planes(image[..., 0]) - 16.0 for image in (twin.no_contact, twin.repeat_no_contact)]


def test_floor_of_the_twin_holds_the_noise_of_its_render(monkeypatch, paints):
    spread = {}
    for noise_rel in (0.0, 0.05):
        first, repeat = captured(monkeypatch, paints, noise_rel**2)
        spread[noise_rel] = np.var(repeat / repeat.mean((0, 1)) - first / first.mean((0, 1)), axis=(0, 1))
    matrix = finger(paints).camera_matrix(paint_bands(paints["red"], paints["green"], DESIGN.light))
    share = (matrix**2).sum(axis=1) / matrix.sum(axis=1) ** 2
    # 12 288 cells: the standard error of a variance is 1.3 %, on top of the sensor's own noise that is taken off
    np.testing.assert_allclose(spread[0.05] - spread[0.0], 2 * 0.05**2 * share, rtol=0.1)


def test_floor_of_a_dark_twin_is_not_brighter_than_its_image(monkeypatch, paints):
    """Beside a bright stripe, which sets the exposure, the halves of the render disagree by all that they hold."""
    image, variance = 0.1 * FLAT, 0.01 * FLAT
    image[:8], variance[:8] = 1.0, 0.0
    first, repeat = (counts[8:] for counts in captured(monkeypatch, paints, variance, image))
    difference = repeat.mean((0, 1)) / first.mean((0, 1)) - 1.0
    # the LED's drift in both, and a relative noise of 1.4 per cell, whose mean cut off at zero would be 0.2 too high
    error = np.sqrt(2.0) * np.hypot(digital_twin.LED_DRIFT_REL, np.sqrt(1.0 / repeat[..., 0].size))
    assert (np.abs(difference) < 3.0 * error).all()


def test_curves_that_begin_late_are_noted_in_both_records(monkeypatch, paints):
    # below 440 nm lies Phi(-10 / 8.49) = 12 % of an LED of 450 nm and 20 nm FWHM, below 444 nm 24 %
    late = finger(paints, first_nm=440.0)
    flat = np.ones((96, 128, 3), np.float32)
    bands = paint_bands(paints["red"], paints["green"], DESIGN.light)
    render = SimpleNamespace(
        bands=bands, label="flat", no_contact_bands=flat, contact_bands=flat, contact_variance=flat,
        contact_maps=SimpleNamespace(contact_distance=np.ones((96, 128))), contact_label="flat", chains_apart=False,
        chains=FIRST_CHAINS, no_contact_half_difference=0.0 * flat, contact_half_difference=0.0 * flat,
    )  # fmt: skip
    swept = SimpleNamespace(
        bands=bands, label="flat", angles_deg=np.arange(4.0), radiance_rel=np.ones((4, 2, 2, 3)),
        probe_points_mm=np.zeros((2, 3)),
    )  # fmt: skip
    monkeypatch.setattr(press, "render_press", lambda *arguments, **options: render)
    monkeypatch.setattr(light_angle, "sweep_light_angle", lambda *_, **__: swept)
    for record in (
        press.simulate_press(FingerScene(late), press.Rendering(samples_per_pixel=2), {}),
        light_angle.light_angle_sweep(late, {}, [0.0, 1.0, 2.0, 3.0], ProbePaths(2, 2, 1), {}),
    ):
        held = [note for note in record.notes if "its end value is used" in note]
        assert len(held) == 3
        assert held[0].startswith("camera response: red covers only 440 to 780 nm; outside, where 1")
        assert "the led band" in held[0]


def test_curves_that_miss_a_band_are_refused(paints):
    bands = paint_bands(paints["red"], paints["green"], DESIGN.light)
    with pytest.raises(CurveError, match=r"curve 'red' covers only 444 to 780 nm, and 2\d % .* the led band"):
        finger(paints, first_nm=444.0).camera_matrix(bands)
    assert finger(paints).coverage_notes(bands) == ()
