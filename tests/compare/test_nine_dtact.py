import shutil

import cv2
import numpy as np
import pytest
from skimage.metrics import structural_similarity as scikit_image_ssim

from data_schemas import ImportFormatError
from finray_calib.compare import compare_press, disc
from finray_calib.exchange import nine_dtact_capture, nine_dtact_prediction
from finray_calib.exchange._nine_dtact import (
    DarkenedCircle,
    darkened_circle,
    load_depth_table,
    load_rectified_crop,
    predict_press,
    read_nine_dtact,
)

NO_CONTACT = np.full((60, 80, 3), 150, np.uint8)


def synthetic_press(radius_px=20.0):
    """Darken a disc by 10 DN and brighten its surround by 20 DN."""
    sample = NO_CONTACT + np.uint8(20)
    sample[disc((60, 80), (30.0, 45.0), radius_px)] = 140
    return sample


def test_the_circle_encloses_the_dark_disc_and_ignores_the_bright_halo():
    circle = darkened_circle(NO_CONTACT, synthetic_press())
    assert circle.center_px == pytest.approx((30, 45), abs=1)
    assert circle.radius_px == pytest.approx(20, abs=1)
    with pytest.raises(ImportFormatError, match=r"No pixel of the sample is darker .* by more than 3 DN"):
        darkened_circle(synthetic_press(), synthetic_press())


@pytest.mark.parametrize("width_px", [1, 2])
def test_a_few_dark_pixels_are_no_contact(width_px):
    # a circle of radius 0 would divide all distances by 0
    sample = NO_CONTACT.copy()
    sample[30, 45 : 45 + width_px] = 140
    with pytest.raises(ImportFormatError, match=r"has a radius below 1 px, .* there is no contact"):
        darkened_circle(NO_CONTACT, sample)


def test_the_prediction_darkens_by_the_level_of_the_cap_depth():
    # A table of 0.02 mm per grey level turns depth d into level 50 d, exactly, once entries 0 and 1 are replaced.
    table = 0.02 * np.arange(120.0)
    table[:2] = [-0.9, 0.7]
    prediction = predict_press(NO_CONTACT, DarkenedCircle((30, 45), 20), 0.1, 4.0, table)
    cap_mm = 4.0 - np.sqrt(4.0**2 - 2.0**2)
    assert prediction[30, 45] == pytest.approx([150 - 50 * cap_mm] * 3, rel=1e-12)
    depth_mm = np.sqrt(4.0**2 - 1.0**2) - np.sqrt(4.0**2 - 2.0**2)
    assert prediction[30, 55, 1] == pytest.approx(150 - 50 * depth_mm, rel=1e-12)
    outside = ~disc((60, 80), (30.0, 45.0), 20.0)
    assert (prediction[outside] == 150).all()
    with pytest.raises(ImportFormatError, match=r"radius of 4.000 mm, .* below the ball's radius, 4.000 mm"):
        predict_press(NO_CONTACT, DarkenedCircle((30, 45), 20), 0.2, 4.0, table)


@pytest.fixture
def sensor_copy(shared_data, tmp_path):
    return shutil.copytree(shared_data / "tactile" / "9dtact" / "sensor_1", tmp_path / "sensor_1")


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("number", "circle", "mm_per_px"),
    [(1, DarkenedCircle((188, 243), 67), 0.051015), (2, DarkenedCircle((176, 280), 60), 0.049995)],
)
def test_known_values_of_the_two_sensors(shared_data, number, circle, mm_per_px):
    folder = shared_data / "tactile" / "9dtact" / f"sensor_{number}"
    sensor = read_nine_dtact(folder)
    assert sensor.circle == circle
    # The known values have six decimals.
    assert sensor.mm_per_px == pytest.approx(mm_per_px, abs=5e-7)
    assert sensor.no_contact_rgb.shape == sensor.repeat_no_contact_rgb.shape == (345, 460, 3)
    bgr = cv2.imread(str(folder / "depth_calibration" / "rectify_crop_sample.png"))
    assert (sensor.sample_rgb == bgr[..., ::-1]).all()
    assert (load_rectified_crop(folder, "depth_calibration/ref.png") == sensor.no_contact_rgb).all()
    assert (load_rectified_crop(folder, "depth_calibration/sample.png") == sensor.sample_rgb).all()


@pytest.mark.shared_data
@pytest.mark.parametrize("number", [1, 2])
def test_the_shipped_depth_table_follows_from_circle_scale_and_ball(shared_data, number):
    """Mean cap depth of the pixels at each whole grey level of darkening: the maker's own definition."""
    sensor = read_nine_dtact(shared_data / "tactile" / "9dtact" / f"sensor_{number}")
    darkening = np.maximum(sensor.no_contact_rgb.astype(int) - sensor.sample_rgb, 0).sum(axis=2)
    rows, columns = np.indices(darkening.shape)
    distance_px = np.hypot(rows - sensor.circle.center_px[0], columns - sensor.circle.center_px[1])
    inside = distance_px < sensor.circle.radius_px
    edge_mm = sensor.circle.radius_px * sensor.mm_per_px
    height_mm = np.sqrt(16 - (distance_px * inside * sensor.mm_per_px) ** 2) - np.sqrt(16 - edge_mm**2)
    expected = [height_mm[inside & (darkening == 3 * n)].mean() for n in range(1, len(sensor.depth_table_mm))]
    assert sensor.depth_table_mm[1:] == pytest.approx(expected, abs=1e-9)
    assert sensor.depth_table_mm[0] < 0


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("scene", "table", "skill_contact", "skill_halo", "ceiling_loss", "ssim_contact"),
    [(1, 2, 0.963, 0.662, 0.002, 0.975), (2, 1, 0.959, 0.587, 0.047, 0.987)],
)
def test_transferred_tables_score_as_published(
    shared_data, scene, table, skill_contact, skill_halo, ceiling_loss, ssim_contact
):
    """The table of one sensor predicts the press of the other: inside the contact well, around it not."""
    folder = shared_data / "tactile" / "9dtact"
    prediction = nine_dtact_prediction(folder / f"sensor_{scene}", folder / f"sensor_{table}")
    capture = nine_dtact_capture(folder / f"sensor_{scene}")
    report = compare_press(prediction, capture, seed=0)
    assert report.block_px == 1
    assert report.exposure_factor is None
    assert report.channel_weights == (1.0, 1.0, 1.0)
    contact, halo = ({row.candidate: row for row in region.rows} for region in report.regions)
    # The published values have three decimals; a rim of one pixel more or less moves the last one.
    assert contact["simulation"].skill.estimate == pytest.approx(skill_contact, abs=1e-3)
    assert halo["simulation"].skill.estimate == pytest.approx(skill_halo, abs=1e-3)
    assert contact["floor"].skill.estimate == pytest.approx(1 - ceiling_loss, abs=1e-3)
    for rows in (contact, halo):
        assert rows["do nothing"].skill.estimate == rows["do nothing"].skill.high95 == 0
        for row in (rows["simulation"], rows["floor"]):
            assert row.skill.low95 < row.skill.estimate < row.skill.high95
            assert row.relative_rms is row.difference_gradient_rms_per_px is row.chromaticity_rms is None
    # The published similarity is that of scikit-image's 8-bit default window, so it judges the prediction itself.
    eight_bit = np.clip(np.round(prediction.contact), 0, 255).astype(np.uint8)
    sample = capture.contact.astype(np.uint8)
    _, default_map = scikit_image_ssim(eight_bit, sample, channel_axis=-1, full=True)
    assert default_map.mean(axis=2)[prediction.distance <= 1.0].mean() == pytest.approx(ssim_contact, abs=1e-3)
    # Full-frame similarity cannot tell: explaining 96 % of the contact moves it by about a hundredth.
    assert abs(report.ssim_full_frame["simulation"] - report.ssim_full_frame["do nothing"]) < 0.015


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["depth_calibration/rectify_crop_ref.png", "camera_calibration/row_index.npy"])
def test_a_missing_file_is_named(sensor_copy, name):
    (sensor_copy / name).unlink()
    with pytest.raises(ImportFormatError, match=rf"{name}: no such file"):
        read_nine_dtact(sensor_copy)


@pytest.mark.shared_data
def test_a_pickled_array_is_refused(sensor_copy):
    path = sensor_copy / "depth_calibration" / "Pixel_to_Depth.npy"
    np.save(path, np.array([{"depth": 1.0}], dtype=object), allow_pickle=True)
    with pytest.raises(ImportFormatError, match=r"Pixel_to_Depth.npy: is not .* Pickled files are not supported"):
        read_nine_dtact(sensor_copy)


@pytest.mark.shared_data
def test_a_broken_image_or_map_is_refused(sensor_copy):
    camera = sensor_copy / "camera_calibration"
    image = sensor_copy / "depth_calibration" / "rectify_crop_sample.png"
    original = image.read_bytes()
    cv2.imwrite(str(image), np.zeros((345, 459, 3), np.uint8))
    with pytest.raises(ImportFormatError, match=r"345 x 460 px, got uint8 of shape \(345, 459, 3\)"):
        read_nine_dtact(sensor_copy)
    image.write_bytes(b"not a picture")
    with pytest.raises(ImportFormatError, match=r"rectify_crop_sample.png: is neither PNG nor JPEG"):
        read_nine_dtact(sensor_copy)
    image.write_bytes(original)
    np.save(camera / "row_index.npy", np.full((480, 640), 480, np.int32))
    with pytest.raises(ImportFormatError, match=r"row_index.npy: expected 480 x 640 integer .* from 0 to 479"):
        read_nine_dtact(sensor_copy)


@pytest.mark.shared_data
def test_a_broken_position_or_crop_is_refused(sensor_copy):
    path = sensor_copy / "camera_calibration" / "position_scale.npy"
    np.save(path, np.array([240.0, 327.0]))
    with pytest.raises(ImportFormatError, match=r"position_scale.npy: expected three positive numbers"):
        read_nine_dtact(sensor_copy)
    np.save(path, np.array([100.0, 327.0, 0.05]))
    with pytest.raises(ImportFormatError, match=r"345 x 460 px around row 100, column 327 extends beyond the image"):
        read_nine_dtact(sensor_copy)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 an archive", b"\x93NUMPY\x01\x00"])
def test_a_file_that_is_no_array_is_refused(tmp_path, content):
    path = tmp_path / "Pixel_to_Depth.npy"
    path.write_bytes(content)
    with pytest.raises(ImportFormatError, match=r"not a plain numeric .npy file"):
        load_depth_table(path)


def test_a_table_of_words_or_one_that_does_not_grow_is_refused(tmp_path):
    path = tmp_path / "Pixel_to_Depth.npy"
    np.save(path, np.array(["deep", "deeper"]))
    with pytest.raises(
        ImportFormatError, match=r"Pixel_to_Depth.npy: is not a plain numeric .npy file .contains <U6, not real numbers"
    ):
        load_depth_table(path)
    np.save(path, np.array([-0.9, 0.1, 0.3, 0.2]))
    with pytest.raises(ImportFormatError, match="one finite depth in mm per grey level, increasing from entry 1 on"):
        load_depth_table(path)


@pytest.mark.parametrize(
    "table", [[0.0, -0.3, -0.1, 0.2], [0.0, -0.1, 0.0, 0.2], [np.nan, 0.1, 0.2, 0.3], [0.0, 0.1, 0.2, np.inf]]
)
def test_a_table_of_depths_that_no_press_has_is_refused(tmp_path, table):
    path = tmp_path / "Pixel_to_Depth.npy"
    np.save(path, np.array(table))
    with pytest.raises(ImportFormatError, match=r"one finite depth in mm per grey level, .* above 0 mm from entry 2"):
        load_depth_table(path)
