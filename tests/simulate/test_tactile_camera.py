"""Raw counts of a rendered press, its capture, and the spread of its colours."""

import numpy as np
import pytest

from data_schemas import FingerDesign, SimulatedPress, SimulateError
from data_schemas._design_parts import TactileCamera
from finray_calib.compare import compare_press
from finray_calib.sensing import rgb_image
from sim.experiments import simulated_capture
from sim.experiments._optics_products import BandImages, camera_capture, colour_spread

DESIGN = FingerDesign(camera=TactileCamera(width_px=256, height_px=192, response_at_led_uncertainty_rel=0.2))
MATRIX = np.array([[1.0, 0.0, 0.05], [0.0, 1.0, 0.2], [0.0, 0.1, 1.0]])
SIGMAS = 5.0


def press(**changed):
    row, column = np.mgrid[:96, :128].astype(np.float32)
    bands = np.stack([0.2 + 0.001 * row, 0.3 + 0.001 * column, np.ones_like(row)], -1)
    touched = bands * (1.0 - 0.3 * np.exp(-((row - 48) ** 2 + (column - 64) ** 2) / 800.0))[..., None].astype("f4")
    rgb = {name: (b @ MATRIX.T).astype(np.float32) for name, b in (("no_contact", bands), ("contact", touched))}
    values = {
        "name": "press", "label": "rendered, level b, test", "method": "rendered", "encoding": "linear", **rgb,
        "distance": np.hypot(row - 48, column - 64) / np.float32(20.0), "variance": np.full_like(bands, 1e-6),
        "no_contact_bands": bands, "contact_bands": touched, "bands": ("red", "green", "led"),
        "camera_matrix": MATRIX, "light_angle_deg": 30.0, "design": DESIGN,
    }  # fmt: skip
    return SimulatedPress(**{**values, **changed})


def test_capture_is_the_press_in_counts():
    simulated = press()
    capture = simulated_capture(simulated, seed=3)
    assert capture.contact.shape == (192, 256, 1)
    assert (capture.bit_depth, capture.black_level_dn, capture.light_angle_deg) == (10, 16.0, 30.0)
    for state in ("contact", "no_contact"):
        dn, rgb = rgb_image(getattr(capture, state), capture), getattr(simulated, state)
        scale = np.sum(dn * rgb, axis=(0, 1)) / np.sum(rgb.astype(float) ** 2, axis=(0, 1))
        # one exposure for all channels; fixed pattern 0.5 % and shot noise average over 12 288 cells
        np.testing.assert_allclose(scale / scale[1], 1.0, atol=2e-3)
        assert np.abs(dn / scale - rgb).mean() < 0.05
    assert 0.6 * 1023 < np.percentile(capture.no_contact, 99.0) < 0.75 * 1023
    assert (capture.repeat_no_contact != capture.no_contact).mean() > 0.5
    again, other = simulated_capture(simulated, seed=3), simulated_capture(simulated, seed=4)
    np.testing.assert_array_equal(capture.contact, again.contact)
    assert (capture.contact != other.contact).mean() > 0.5


def test_capture_can_be_compared_with_the_press_it_came_from():
    simulated = press()
    report = compare_press(simulated, simulated_capture(simulated, seed=5), 1)
    assert report.values == "linear light"
    # the sensor's noise is all that lies between the two: the render explains nearly all that the contact changes
    assert report.headline_skill.estimate > 0.95


def test_the_led_drifts_from_image_to_image():
    flat, drift_rel, runs = np.ones((96, 128, 3), np.float32), 0.02, 60
    bands = BandImages(flat, flat, np.zeros_like(flat))
    levels = []
    for seed in range(runs):
        taken = camera_capture(
            bands, MATRIX, DESIGN, seed, light_angle_deg=30.0, name="a", source="b", led_drift_rel=drift_rel
        )
        levels.append([float(i.mean()) - 16.0 for i in (taken.contact, taken.no_contact, taken.repeat_no_contact)])
    # noise of 49 152 pixels is 1e-4 of a level, below what 60 runs tell of its spread
    spread = np.std(levels, axis=0, ddof=1) / np.mean(levels, axis=0)
    np.testing.assert_allclose(spread, drift_rel, rtol=SIGMAS / np.sqrt(2 * runs))
    correlation = np.corrcoef(np.transpose(levels))[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(runs)


def test_a_simulated_capture_knows_no_uncertainty_of_its_pose():
    assert simulated_capture(press(), seed=1).indenter.depth_uncertainty_mm is None


def test_light_below_zero_by_less_than_its_noise_is_no_light():
    """The walls' smoothed light may dip below zero where it is dark: such a pixel is captured as a black one is."""
    below, black = press().contact_bands.copy(), press().contact_bands.copy()
    below[:20], black[:20] = -1e-3, 0.0
    dark, none = (simulated_capture(press(contact_bands=bands), seed=6) for bands in (below, black))
    np.testing.assert_array_equal(dark.contact, none.contact)


def test_what_is_no_render_has_no_capture():
    with pytest.raises(SimulateError, match="press has no finger design"):
        simulated_capture(press(design=None), seed=1)
    with pytest.raises(SimulateError, match="contains encoded values, but only"):
        simulated_capture(press(encoding="unknown"), seed=1)
    with pytest.raises(SimulateError, match="image without contact is black"):
        simulated_capture(press(no_contact_bands=np.zeros((96, 128, 3), np.float32)), seed=1)
    bare = press(contact_bands=None, camera_matrix=None, bands=(), no_contact_bands=None)
    with pytest.raises(
        SimulateError, match="no band images, but only a rendered press, which has them, can be captured"
    ):
        simulated_capture(bare, seed=1)
    with pytest.raises(
        SimulateError, match="contains no band images, but only a rendered press, which has them, records"
    ):
        colour_spread(bare, seed=1)


def test_colours_spread_by_the_share_of_led_light():
    simulated = press()
    spread = colour_spread(simulated, seed=2, draws=20_000)
    seen = np.isfinite(simulated.distance)
    mean = simulated.contact_bands[seen].astype(float).mean(axis=0)
    share = MATRIX[:, 2] * mean[2] / (MATRIX @ mean)
    np.testing.assert_allclose(spread.led_share, share)
    # relative error of a standard deviation from 20 000 draws of a slightly skewed law: about 0.6 %
    np.testing.assert_allclose(spread.sd_rel, 0.2 * share, rtol=SIGMAS * 0.006)
    both = 0.2 * np.hypot(share[:2], share[2])
    np.testing.assert_allclose(spread.ratio_sd_rel, both, rtol=0.1)  # first order in 0.2
    assert "uncertain by 20 %. LED light makes up" in str(spread)


def test_colours_of_a_finger_without_contact_are_those_of_the_pixels_that_see_its_coat():
    """No pixel has a distance from a contact then: all shares were NaN, and the notes of the record said so."""
    simulated = press()
    untouched = press(distance=np.full((96, 128), np.nan, np.float32))
    seen = np.isfinite(simulated.distance)
    assert str(colour_spread(untouched, seed=2, coat=seen)) == str(colour_spread(simulated, seed=2))
    with pytest.raises(SimulateError, match="press has no contact, so its record does not state which pixels see"):
        colour_spread(untouched, seed=2)


def test_spectral_images_integrate_to_the_bands(paints):
    from sim.experiments._optics_products import band_densities_per_nm, spectral_grid_nm
    from sim.optics import paint_bands

    bands = paint_bands(paints["red"], paints["green"], DESIGN.light)
    grid = spectral_grid_nm(bands)
    assert 450.0 in grid
    assert (np.diff(grid) == 20.0).all()
    fine = np.arange(380.0, 780.0, 0.25)
    integral = np.trapezoid(band_densities_per_nm(bands, fine), fine, axis=0)
    # the tables' steps of 0.5 and 5 nm resampled to 0.25 nm, and edges where a band begins at once
    np.testing.assert_allclose(integral, 1.0, atol=5e-3)
    assert len(grid) < 25
