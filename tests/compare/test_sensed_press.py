"""Sensing a press: depth, normals and contact are those of the ball, with an uncertainty that holds them."""

import numpy as np
import pytest

from data_schemas import (
    CompareError,
    ContactCircle,
    IndenterPose,
    NormalMapRecord,
    SensedPress,
    TactileCapture,
    provenance,
)
from data_schemas.storage import read_record, write_record
from finray_calib.sensing import normal_map_record, sense_press, surface_triangles
from finray_calib.sensing._normal_map import filled_slopes
from tests.command_line.running import finray, succeed
from tests.compare.three_lights import BALL_PX, SHAPE_PX, ball_presses

MM_PER_PX = 0.1


def capture_of(press, name):
    """A press as an 8-bit capture."""
    counts = [np.clip(np.rint(i), 0, 255).astype(np.uint16) for i in (press.contact, press.no_contact)]
    return TactileCapture(
        name=name,
        contact=counts[0],
        no_contact=counts[1],
        repeat_no_contact=None,
        layout="RGB",
        encoding="unknown",
        bit_depth=8,
        black_level_dn=0.0,
        exposure_s=None,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=BALL_PX * MM_PER_PX, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=press.row_px, column_px=press.column_px, radius_px=press.radius_px),
        mm_per_px=MM_PER_PX,
        source="closed form",
    )


@pytest.fixture(scope="module")
def presses():
    return ball_presses(44, seed=5, noise_dn=0.7)


@pytest.fixture(scope="module")
def taught(presses):
    return normal_map_record([capture_of(p, f"p{k}") for k, p in enumerate(presses[:24])], "map", 1)


def height_mm(press):
    """Of the ball's cap inside its circle."""
    return MM_PER_PX * (BALL_PX - np.sqrt(BALL_PX**2 - press.radius_px**2))


def test_depths_lie_within_their_uncertainty(presses, taught):
    """20 presses that did not teach: of 2 u (95 %) fewer than 16 hold the depth with a chance of 0.003."""
    held, off = 0, []
    for k, press in enumerate(presses[24:]):
        sensed = sense_press(taught, capture_of(press, f"q{k}"))
        held += abs(sensed.deepest_mm - height_mm(press)) <= 2.0 * sensed.deepest_u_mm
        off.append(sensed.deepest_mm / height_mm(press) - 1.0)
        assert sensed.is_of_teaching is False
    assert held >= 16
    # and the uncertainty is no larger than three times what it stands for
    rms = np.sqrt(np.mean(np.square(off)))
    assert rms < np.sqrt(np.mean(taught.held_out_height_error_rel**2)) < 3.0 * rms


def test_the_depth_of_a_pixel_is_as_sure_as_it_says(presses, taught):
    errors = []
    rows, columns = np.indices(SHAPE_PX)
    for k, press in enumerate(presses[24:34]):
        sensed = sense_press(taught, capture_of(press, f"q{k}"))
        away = np.hypot(rows - press.row_px, columns - press.column_px)
        cap = MM_PER_PX * np.sqrt(BALL_PX**2 - np.minimum(away, press.radius_px) ** 2)
        left = (sensed.depth_mm - cap)[away <= press.radius_px]
        errors.append(left - left.mean())
    rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert 0.4 < rms / sensed.depth_u_mm < 1.6


def absolute_errors(presses, taught):
    """Sensed less true depth over u at pixels in the contacts, their level as it is."""
    rows, columns = np.indices(SHAPE_PX)
    found = []
    for k, press in enumerate(presses):
        sensed = sense_press(taught, capture_of(press, f"q{k}"))
        away = np.hypot(rows - press.row_px, columns - press.column_px)
        cap = MM_PER_PX * np.sqrt(BALL_PX**2 - np.minimum(away, press.radius_px) ** 2)
        true = cap - MM_PER_PX * np.sqrt(BALL_PX**2 - press.radius_px**2)
        found.append((sensed.depth_mm - true)[away <= press.radius_px] / sensed.depth_u_mm)
    return found


def test_the_level_of_the_depth_is_in_its_uncertainty(presses, taught):
    """Depths from the frame of the picture, of 20 presses that did not teach: 2 u hold them in nine of ten pixels."""
    errors = absolute_errors(presses[24:], taught)
    held = np.mean(np.abs(np.concatenate(errors)) <= 2.0)
    assert held >= 0.90
    # the shape alone, as before, would claim more than it holds
    without = taught.model_copy(update={"held_out_level_mm": np.zeros(1)})
    level_mm = float(np.sqrt(np.mean(taught.held_out_level_mm**2)))
    assert level_mm > 0.0
    sensed = sense_press(taught, capture_of(presses[30], "q"))
    assert sensed.depth_u_mm >= np.hypot(np.sqrt(np.mean(taught.held_out_depth_rms_mm**2)), level_mm) - 1e-12
    assert sensed.depth_u_mm >= sense_press(without, capture_of(presses[30], "q")).depth_u_mm


def test_an_unsure_scale_is_in_the_uncertainty_of_the_largest_depth(presses):
    """Every capture states a scale that is 5 % too large: the depth goes as its square."""
    found = []
    for factor, u_rel in ((1.0, None), (1.05, 0.05)):
        update = {"mm_per_px": factor * MM_PER_PX, "mm_per_px_u_rel": u_rel}
        captures = [capture_of(p, f"p{k}").model_copy(update=update) for k, p in enumerate(presses[:25])]
        found.append(sense_press(normal_map_record(captures[:24], "map", 1), captures[24]))
    right, wrong = found
    off_mm = wrong.deepest_mm - right.deepest_mm
    assert off_mm == pytest.approx(0.1025 * right.deepest_mm, rel=0.2)  # and the steeper sides of a smaller ball
    # what is added to the uncertainty is that error, to first order
    assert np.sqrt(wrong.deepest_u_mm**2 - (1.1 * right.deepest_u_mm) ** 2) == pytest.approx(off_mm, rel=0.2)
    assert any("whose standard uncertainty of 5 % changes them together by twice as much" in n for n in wrong.notes)
    assert not any("one scale" in note for note in right.notes)


def test_normals_and_contact_are_those_of_the_ball(presses, taught):
    press = presses[30]
    sensed = sense_press(taught, capture_of(press, "q"), contact_depth_mm=0.05)
    np.testing.assert_allclose(np.linalg.norm(sensed.normal, axis=-1), 1.0, atol=1e-6)
    row, column = round(press.row_px), round(press.column_px)
    right, left = (sensed.normal[row, column + s * round(0.6 * press.radius_px), 0] for s in (1, -1))
    assert right > 0.1
    assert left < -0.1
    radius_px = np.sqrt(BALL_PX**2 - (BALL_PX - (height_mm(press) - 0.05) / MM_PER_PX) ** 2)
    assert sensed.contact_area_mm2 == pytest.approx(np.pi * (radius_px * MM_PER_PX) ** 2, rel=0.35)
    triangles, vertices = surface_triangles(sensed)
    assert (len(triangles), len(vertices)) == (2 * 59 * 79, 60 * 80)
    assert vertices[:, 2].min() == pytest.approx(-sensed.deepest_mm)
    first = vertices[triangles[0]]
    assert np.cross(first[1] - first[0], first[2] - first[0])[2] > 0.0
    # a dent seen as a bump: the normals are those of the surface z = depth, z towards the camera
    slope_rows, slope_columns = np.gradient(sensed.depth_mm.astype(float), MM_PER_PX)
    steep = sensed.depth_mm > 0.5 * sensed.deepest_mm
    for axis, slope in enumerate((slope_columns, slope_rows)):
        assert np.corrcoef(-slope[steep], sensed.normal[..., axis][steep])[0, 1] > 0.9


@pytest.mark.parametrize(("mirrored", "handedness"), [(False, 1.0), (True, -1.0)])
def test_the_mesh_is_the_gel_and_not_its_mirror_image(presses, taught, mirrored, handedness):
    """A camera's right, down and ahead are right-handed, and ahead leads out of the gel; one mirror reverses that."""
    sensed = sense_press(taught, capture_of(presses[30], "q"))
    triangles, vertices = surface_triangles(sensed, mirrored=mirrored)
    grid = vertices.reshape(*sensed.depth_mm.shape, 3)
    along_columns, along_rows = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    out = np.array([0.0, 0.0, 1.0])  # where a dent is below 0
    assert np.sign(np.linalg.det([along_columns * [1, 1, 0], along_rows * [1, 1, 0], out])) == handedness
    corners = vertices[triangles]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0).all()


def test_a_press_that_taught_is_told_and_clipped_pixels_are_filled(presses, taught):
    own = capture_of(presses[0], "under another name")
    assert sense_press(taught, own).is_of_teaching
    assert "the map 'map' was trained on this press" in sense_press(taught, own).notes[0]
    bright = own.contact.copy()
    row, column = round(presses[0].row_px), round(presses[0].column_px)
    bright[row - 3 : row + 3, column - 3 : column + 3] = 255
    clipped = sense_press(taught, own.model_copy(update={"contact": bright}))
    assert clipped.clipped_share > 0.01
    assert any("are clipped and take their slope from their neighbours" in note for note in clipped.notes)
    substitute = own.model_copy(update={"no_contact_from": "median of presses"})
    assert any("is a substitute (median of presses)" in note for note in sense_press(taught, substitute).notes)
    slopes = np.full((20, 20, 2), 0.3)
    slopes[5:9, 5:9] = np.nan
    np.testing.assert_allclose(filled_slopes(slopes), 0.3)
    assert (filled_slopes(np.full((4, 4, 2), np.nan)) == 0.0).all()


def test_a_map_of_an_earlier_version_knows_no_uncertainty(presses, taught):
    old = {"held_out_depth_rms_mm": None, "held_out_height_error_rel": None, "training_sha256": ()}
    sensed = sense_press(taught.model_copy(update=old), capture_of(presses[30], "q"))
    assert (sensed.depth_u_mm, sensed.deepest_u_mm, sensed.contact_area_u_mm2, sensed.is_of_teaching) == (None,) * 4
    assert sum("train the map again" in note for note in sensed.notes) == 2


def test_what_cannot_be_sensed_is_refused(presses, taught):
    capture = capture_of(presses[30], "q")
    with pytest.raises(CompareError, match="senses no depth beyond its uncertainty"):
        sense_press(taught, capture.model_copy(update={"contact": capture.no_contact}))
    with pytest.raises(CompareError, match=r"above 0 and below the largest depth, .* got 9 mm"):
        sense_press(taught, capture, contact_depth_mm=9.0)


def test_teach_and_run_lead_from_presses_to_depth(presses, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for k, press in enumerate(presses[:14]):
        write_record(capture_of(press, f"p{k}"), tmp_path / "set" / f"p{k:02d}.capture.json", provenance("pytest"))
    write_record(capture_of(presses[30], "other"), tmp_path / "other.capture.json", provenance("pytest"))
    said = succeed("sense teach set --out map.json")
    assert "the height from rim to" in said
    assert len(read_record(tmp_path / "map.json", NormalMapRecord).training_sha256) == 14
    said = succeed("sense run map.json other.capture.json")
    assert "deepest" in said
    assert read_record(tmp_path / "other.sensed.json", SensedPress).is_of_teaching is False
    assert (tmp_path / "other.sensed.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "other.sensed.stl").read_bytes()) == 84 + 50 * 2 * 59 * 79
    own = finray("sense run map.json set/p00.capture.json")
    assert own.status == 0
    assert "p0 is a training press of the map 'map', so its result proves nothing about other presses" in own.err
    (tmp_path / "empty").mkdir()
    nothing = finray("sense teach empty --out none.json")
    assert (nothing.status, "contains no capture (NAME.capture.json); import presses" in nothing.err) == (2, True)
    # the spelling of an earlier version
    before = finray("study normal-map set --out again.json")
    assert before.status == 0
    assert "type finray sense teach set --out again.json instead" in before.err
