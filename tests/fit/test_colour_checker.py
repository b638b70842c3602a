from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest

from data_schemas import CaptureSession, FitError, Frame, Optics
from data_schemas.storage import (
    assumed_camera_response,
    halogen_lamp,
    planck_relative,
    read_camera_response,
    read_donaldson_matrix,
)
from finray_calib.compare import ciede2000
from finray_calib.fit import colour_checker_reflectance, patch_colours
from finray_calib.fit._colour_checker import MATCH_UNCERTAINTY_REL, match_colour, match_uncertainty_rel, reflectance_sd
from finray_calib.spectra import WAVELENGTH_NM, filter_transmission
from rigs import paint_plan, simulated_rig
from rigs.simulated import Bench

PATCHES = patch_colours()
FRAME = Frame(
    sequence=0, file="frames/0000.tiff", frame_type="room light", target="sample beside ColorChecker", light="room",
    filter_name=None, slot_before=None, slot_after=None, exposure_requested_s=0.1, exposure_s=0.1,
    captured_utc="2026-01-01T00:00:00+00:00", saturated_fraction=0.0, sha256="0" * 64,
)  # fmt: skip
PEAK_DN = 700.0


def camera_rgb(radiance, response=None):
    curves = response or assumed_camera_response()
    return radiance @ np.array([curve(WAVELENGTH_NM) for curve in curves]).T


def test_patch_colours_are_those_of_colour_science():
    """The package integrates each spectrum by itself (ASTM E308 practice); ours sums at 1 nm."""
    for n, sd in enumerate(colour.SDS_COLOURCHECKERS["BabelColor Average"].values()):
        with colour.utilities.suppress_warnings(colour_runtime_warnings=True):  # it tells of aligning the curves
            theirs = colour.sd_to_XYZ(sd, illuminant=colour.SDS_ILLUMINANTS["D65"]) / 100
        # E308 interpolates the 10 nm samples by a smooth curve, ours by straight lines: less than 0.5 % of white.
        np.testing.assert_allclose(PATCHES.xyz[n], theirs, atol=0.005)


def test_a_patch_matches_itself_and_the_distances_are_ciede2000():
    rgb = camera_rgb(PATCHES.reflectance * planck_relative(WAVELENGTH_NM, 5000.0))
    for n in (1, 13, 14, 18):
        match = match_colour(rgb, rgb[n])
        assert match.paint_delta_e.argmin() == n
        # The camera's own error on that patch, which a 3 x 3 matrix leaves.
        assert match.paint_delta_e[n] < 3.0
    # With a camera whose channels are the observer's there is no camera error, and a mixture's distance is exact.
    mixed = 0.5 * (PATCHES.xyz[14] + PATCHES.xyz[15])
    match = match_colour(PATCHES.xyz, mixed)
    assert match.camera_delta_e.max() < 1e-4  # rounding of the matrix fit, magnified where a patch is nearly black
    white_xy = PATCHES.white_xyz[:2] / PATCHES.white_xyz.sum()
    lab, patch_lab = colour.XYZ_to_Lab(mixed, white_xy), colour.XYZ_to_Lab(PATCHES.xyz, white_xy)
    np.testing.assert_allclose(match.paint_delta_e, ciede2000(np.broadcast_to(lab, (24, 3)), patch_lab), atol=1e-6)


@pytest.mark.shared_data
@pytest.mark.parametrize("camera", ["assumed", "imx219"])
@pytest.mark.parametrize("glows", [False, True])
def test_the_stated_uncertainty_covers_four_measured_materials(shared_data, camera, glows):
    """Relative RMS error of the matched patch's curve over its stated standard uncertainty: root mean square near 1."""
    spectra = shared_data / "spectra"
    response = (
        assumed_camera_response() if camera == "assumed" else read_camera_response(spectra / "cameras/imx219.csv")
    )
    light = planck_relative(WAVELENGTH_NM, 5000.0)
    errors, scores, at_filters = [], [], []
    bands = simulated_rig("red").filter_wheel.filters
    passed = np.array([filter_transmission(band, WAVELENGTH_NM) for band in bands])
    passed /= passed.sum(axis=1, keepdims=True)
    for path in sorted((spectra / "materials").glob("*.csv")):
        matrix = read_donaldson_matrix(path)
        truth, excitation = matrix.reflectance(WAVELENGTH_NM), matrix.excitation_nm
        light_at_excitation = np.interp(excitation, WAVELENGTH_NM, light)
        emitted = matrix.radiance_factor_per_nm @ light_at_excitation * np.diff(excitation)[0]
        radiance = truth * light + glows * np.interp(WAVELENGTH_NM, matrix.emission_nm, emitted)
        match = match_colour(camera_rgb(PATCHES.reflectance * light, response), camera_rgb(radiance, response))
        closest = PATCHES.reflectance[match.paint_delta_e.argmin()]
        errors.append(np.linalg.norm(closest - truth) / np.linalg.norm(truth))
        scores.append(errors[-1] / match_uncertainty_rel(match))
        at_filters.append(passed @ (closest - truth) / reflectance_sd(match))
    assert len(errors) == 4
    assert max(scores) < 2.0
    assert np.sqrt(np.mean(np.square(scores))) < 1.0
    # 32 values, 8 to a curve and so far from independent; two outside is what was measured (94 to 100 %).
    assert (np.abs(at_filters) < 1.96).mean() > 0.9
    if not glows:  # the errors that the 30 % were read off: .13 to .36
        assert min(errors) == pytest.approx(0.14, abs=0.01)
        assert max(errors) == pytest.approx(0.36, abs=0.01)
        assert np.sqrt(np.mean(np.square(errors))) < MATCH_UNCERTAINTY_REL


def test_an_ambiguous_match_is_less_certain():
    match = match_colour(PATCHES.xyz, PATCHES.xyz[15])
    assert match_uncertainty_rel(match) == MATCH_UNCERTAINTY_REL
    distances = np.full(24, 50.0)
    distances[[10, 15]] = 20.0, 24.9
    one, other = PATCHES.reflectance[[10, 15]]
    expected = np.hypot(0.30, 0.5 * np.linalg.norm(one - other) / np.linalg.norm(one))
    assert match_uncertainty_rel(replace(match, paint_delta_e=distances)) == pytest.approx(expected, rel=1e-12)


@pytest.fixture(scope="module")
def room() -> tuple[CaptureSession, np.ndarray, Optics]:
    """The simulated bench's room-light frame: sample beside a ColorChecker of another maker's spectra."""
    rig = simulated_rig("red", width_px=640, height_px=512)
    response = assumed_camera_response()
    mean = Bench(rig, Path(), response).electrons_per_s("sample beside ColorChecker", "room", None)
    noisy = np.random.default_rng(4).normal(PEAK_DN * mean / mean.max() + rig.camera.black_level_dn, 3.0)
    session = CaptureSession(
        plan=paint_plan("red", rig.camera), rig=rig, camera_response=response, lamp=halogen_lamp(), frames=(FRAME,)
    )
    optics = Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        camera_response=response,
    )
    return session, np.clip(np.rint(noisy), 0, 1023).astype(np.uint16), optics


def test_a_session_gives_the_reflectance_of_the_closest_patch(room):
    session, counts, optics = room
    match = colour_checker_reflectance(session, lambda frame: counts, optics)
    assert match.patches[0].delta_e <= match.patches[1].delta_e <= match.patches[-1].delta_e
    assert len(match.at_filters) == len(optics.filters)
    for estimate, band in zip(match.at_filters, optics.filters, strict=True):
        # The mean over a 10 nm band leaves the value at its centre only where the curve bends: 3 % at red's edge.
        assert estimate.estimate == pytest.approx(float(match.reflectance(band.center_nm)), rel=0.05)
        assert estimate.sd == match.reflectance_sd
        assert 0 <= estimate.low95 <= estimate.low68 <= estimate.estimate <= estimate.high68 <= estimate.high95 <= 1
    # The chart on the bench and the one matched with are different measurements: a few units of the camera's error.
    assert match.camera_median_delta_e < 4.0
    assert match.patches[0].patch in match.statement
    assert "30 %" in match.statement or match.reflectance.uncertainty_rel > MATCH_UNCERTAINTY_REL
    # corners in raw pixels: the chart lies on the right half of the 640 x 512 frame
    assert match.corners_px[:, 0].min() > 360
    assert match.corners_px[:, 0].max() < 640


def test_darks_of_the_same_exposure_replace_the_black_level(room):
    session, counts, optics = room
    dark = FRAME.model_copy(update={"frame_type": "dark", "light": "off", "file": "frames/0001.tiff", "sequence": 1})
    raised = session.model_copy(update={"frames": (FRAME, dark)})
    frames = {FRAME.file: counts + np.uint16(30), dark.file: np.full_like(counts, 46)}
    one = colour_checker_reflectance(raised, lambda frame: frames[frame.file], optics)
    other = colour_checker_reflectance(session, lambda frame: counts, optics)
    np.testing.assert_allclose(one.patch_mean_dn, other.patch_mean_dn, rtol=1e-12)


def test_a_shorter_exposure_is_used_when_the_paint_is_clipped(room):
    session, counts, optics = room
    long = FRAME.model_copy(update={"file": "frames/0001.tiff", "exposure_s": 0.4, "exposure_requested_s": 0.4})
    both = session.model_copy(update={"frames": (long, FRAME)})
    frames = {FRAME.file: counts, long.file: np.minimum(4 * (counts - np.uint16(16)) + 16, 1023).astype(np.uint16)}
    assert colour_checker_reflectance(both, lambda frame: frames[frame.file], optics).frame_file == FRAME.file
    only_long = session.model_copy(update={"frames": (long,)})
    with pytest.raises(FitError, match=r"no room-light frame can be used; .*0001.tiff: .*clipped"):
        colour_checker_reflectance(only_long, lambda frame: frames[frame.file], optics)
    region = session.plan.region
    bright = counts.copy()
    bright[region.row_px : region.row_px + region.height_px, region.column_px :] = 1023
    with pytest.raises(FitError, match=r"the painted region is clipped in 100.0 % of its cells"):
        colour_checker_reflectance(session, lambda frame: bright, optics)


def test_a_session_without_room_light_is_refused(room):
    session, counts, optics = room
    with pytest.raises(FitError, match=r"the 'room light' frame is missing; capture the sample beside a ColorChecker"):
        colour_checker_reflectance(session.model_copy(update={"frames": ()}), lambda frame: counts, optics)
