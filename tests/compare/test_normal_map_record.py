"""From captures of ball presses to a stored normal map and back; captures that do not belong together are refused."""

import numpy as np
import pytest

from data_schemas import CompareError, ContactCircle, IndenterPose, NormalMapRecord, TactileCapture, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.sensing import fit_normal_map, normal_map_of, normal_map_record, require_matching_capture
from finray_calib.sensing._normal_map_fit import calibration_press
from tests.compare.three_lights import BALL_PX, ball_press, ball_presses

MM_PER_PX = 0.05
COUNT = 14


def capture_of(press, name="press"):
    """A capture of a press in linear counts of 12 bit."""

    def counts(image):
        return np.rint(16.0 * image + 64.0).astype(np.uint16)

    return TactileCapture(
        name=name,
        contact=counts(press.contact),
        no_contact=counts(press.no_contact),
        repeat_no_contact=None,
        layout="RGB",
        encoding="linear",
        bit_depth=12,
        black_level_dn=64.0,
        exposure_s=0.01,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=BALL_PX * MM_PER_PX, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=press.row_px, column_px=press.column_px, radius_px=press.radius_px),
        mm_per_px=MM_PER_PX,
        source="closed form",
    )


@pytest.fixture(scope="module")
def captures():
    return [capture_of(press, f"press {k}") for k, press in enumerate(ball_presses(COUNT), start=1)]


def bayer(capture):
    """The same picture from a sensor with four samples for each of its pixels."""

    def mosaic(rgb):
        plane = np.repeat(np.repeat(rgb, 2, axis=0), 2, axis=1)
        channel = np.tile(np.array([[0, 1], [1, 2]]), (rgb.shape[0], rgb.shape[1]))
        return np.take_along_axis(plane, channel[..., None], axis=-1)

    circle = capture.contact_circle
    return capture.model_copy(
        update={
            "layout": "Bayer RGGB",
            "contact": mosaic(capture.contact),
            "no_contact": mosaic(capture.no_contact),
            "mm_per_px": MM_PER_PX / 2.0,
            "contact_circle": ContactCircle(
                row_px=2.0 * circle.row_px + 0.5,
                column_px=2.0 * circle.column_px + 0.5,
                radius_px=2.0 * circle.radius_px,
            ),
        }
    )


def test_a_stored_map_senses_as_the_fitted_one(captures, tmp_path):
    record = normal_map_record(captures, "map", seed=1)
    write_record(record, tmp_path / "m.json", provenance("pytest"))
    again = normal_map_of(read_record(tmp_path / "m.json", NormalMapRecord))
    presses = [calibration_press(capture) for capture in captures]
    fitted = fit_normal_map(presses, seed=1)
    slopes = [m.slopes(presses[0].contact, presses[0].no_contact) for m in (again, fitted)]
    assert np.array_equal(*slopes)
    assert (record.presses, record.width_px, record.height_px, record.mm_per_px) == (COUNT, 80, 60, MM_PER_PX)
    assert np.median(record.held_out_explained_rel) > 0.95
    assert record.notes == ("closed form",)


def test_a_bayer_sensor_gives_the_same_map(captures):
    one, other = (normal_map_record(c, "m", seed=1) for c in (captures, [bayer(c) for c in captures]))
    assert np.allclose(one.coefficients, other.coefficients)
    assert other.mm_per_px == one.mm_per_px


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"contact_circle": None},
            "press 2: a normal map is trained only on presses of a ball .* this press is by a ball without a",
        ),
        ({"mm_per_px": None}, "press 2: mm_per_px is missing"),
        ({"encoding": "unknown"}, "press 2 has encoding unknown, but press 1 has linear"),
        ({"bit_depth": 14}, "press 2 has bit_depth 14, but press 1 has 12"),
        ({"mm_per_px": 0.06}, "press 2 has 0.06 mm per px, but press 1 has 0.05"),
        (
            {"indenter": IndenterPose(shape="cylinder", radius_mm=1.0, depth_mm=None, position_mm=None)},
            "this press is by a cylinder with a contact circle",
        ),
    ],
)
def test_captures_that_do_not_belong_together_are_refused(captures, change, message):
    changed = [captures[0], captures[1].model_copy(update=change), *captures[2:]]
    with pytest.raises(CompareError, match=message):
        normal_map_record(changed, "m", seed=1)


def test_a_press_whose_middle_lies_outside_the_picture_is_refused():
    presses = ball_presses(COUNT)
    presses[3] = ball_press(-4.0, 40.0, 11.0)
    beside = [capture_of(press, f"press {k}") for k, press in enumerate(presses, start=1)]
    with pytest.raises(CompareError, match=r"press 4: the middle of the contact circle, row -4, .* outside the pic"):
        normal_map_record(beside, "m", seed=1)
    # half in view is enough
    presses[3] = ball_press(0.0, 40.0, 11.0)
    inside = [capture_of(press, f"press {k}") for k, press in enumerate(presses, start=1)]
    assert np.isfinite(normal_map_record(inside, "m", seed=1).held_out_height_error_rel).all()


def test_a_press_that_is_given_twice_is_refused(captures):
    twice = [*captures, captures[3].model_copy(update={"name": "again"})]
    with pytest.raises(CompareError, match=r"press 4 and again are the same image, .* give each press only once"):
        normal_map_record(twice, "m", seed=1)


def test_a_map_senses_its_own_encoding_only(captures):
    record = normal_map_record(captures, "map", seed=1)
    require_matching_capture(record, captures[0])
    with pytest.raises(CompareError, match="has unknown values, but the normal map 'map' was trained on linear values"):
        require_matching_capture(record, captures[0].model_copy(update={"encoding": "unknown"}))
    with pytest.raises(CompareError, match="slopes and depths would be wrong; fit the map"):
        require_matching_capture(record, captures[0].model_copy(update={"mm_per_px": 1.1 * MM_PER_PX}))


def test_no_capture_is_too_few():
    with pytest.raises(CompareError, match="at least 12 ball presses, got 0"):
        normal_map_record([], "m", seed=1)
