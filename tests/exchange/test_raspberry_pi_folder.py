"""``finray import raspberry-pi``: folders of raw and processed images as rpicam-still writes them."""

import json
import shutil

import cv2
import numpy as np
import pytest
import tifffile

from data_schemas import ImportFormatError, TactileCapture
from data_schemas.storage import read_record
from finray_calib.exchange import RaspberryPiOptions, raspberry_pi_capture, read_tuning
from finray_calib.radiometry import parse_tuning
from finray_calib.sensing import rgb_image
from tests.command_line.running import finray, succeed
from tests.radiometry.libcamera_documents import metadata, version_2

PRESS = """\
name = "ball on pad"
light_angle_deg = 30.0
[indenter]
shape = "ball"
radius_mm = 4.0
[contact_circle]
row_px = 20.0
column_px = 30.0
radius_px = 10.0
"""
NAMES = ("contact", "no_contact", "repeat_no_contact")
TUNING = parse_tuning(version_2())
CAMERA = {name: np.array([0.2, 0.15, 0.1]) * (1 + 0.2 * n) for n, name in enumerate(NAMES)}


def write_dng(path, counts, pattern=(2, 1, 1, 0), white_dn=1023, **options):
    """The layout of rpicam-apps: a small RGB thumbnail whose SubIFD is the colour filter array."""
    with tifffile.TiffWriter(path) as file:
        file.write(np.zeros((8, 8, 3), np.uint8), photometric="rgb", subifds=1)
        tags = [
            (33421, "H", 2, (2, 2), True),
            (33422, "B", 4, bytes(pattern), True),
            (50717, "I", 1, white_dn, True),
        ]
        file.write(counts, photometric=32803, extratags=tags, **options)


def bgg_r_counts(rgb):
    """A uniform BGGR frame of 10 bits with a black level of 64 DN."""
    cell = np.array([[rgb[2], rgb[1]], [rgb[1], rgb[0]]])
    return np.rint(64 + 1024 * np.tile(cell, (20, 30))).astype(np.uint16)


def press_folder(folder):
    folder.mkdir()
    (folder / "press.toml").write_text(PRESS)
    for name in NAMES:
        (folder / f"{name}.json").write_text(json.dumps(metadata()))
    return folder


@pytest.fixture
def raw_folder(tmp_path):
    folder = press_folder(tmp_path / "raw")
    for name, rgb in CAMERA.items():
        write_dng(folder / f"{name}.dng", bgg_r_counts(rgb))
    return folder


@pytest.fixture
def processed_folder(tmp_path):
    folder = press_folder(tmp_path / "png")
    for name, rgb in CAMERA.items():
        linear = np.array(metadata()["ColourCorrectionMatrix"]).reshape(3, 3) @ (rgb * [2.0, 1.0, 1.5])
        codes = np.rint(255 * np.interp(linear, TUNING.tone_curve[:, 0], TUNING.tone_curve[:, 1]))
        cv2.imwrite(str(folder / f"{name}.png"), np.full((40, 60, 3), codes[::-1], np.uint8))
    return folder


def test_raw_counts_stay_as_they_are(raw_folder):
    capture = raspberry_pi_capture(raw_folder, RaspberryPiOptions())
    assert (capture.encoding, capture.layout, capture.bit_depth, capture.black_level_dn) == (
        "linear", "Bayer RGGB", 10, 64.0
    )  # fmt: skip
    assert capture.exposure_s == pytest.approx(0.01, rel=1e-12)
    # BGGR begins with red one row and one column later: the circle moves with the frame.
    assert capture.contact.shape == (38, 58, 1)
    assert (capture.contact_circle.row_px, capture.contact_circle.column_px) == (19.0, 29.0)
    for name, rgb in CAMERA.items():
        seen = rgb_image(getattr(capture, name), capture)
        np.testing.assert_allclose(seen / 1024, np.broadcast_to(rgb, seen.shape), atol=0.5 / 1024)


def test_a_raw_tiff_needs_its_order_and_bits(raw_folder):
    for name, rgb in CAMERA.items():
        (raw_folder / f"{name}.dng").unlink()
        tifffile.imwrite(raw_folder / f"{name}.tiff", bgg_r_counts(rgb))
    with pytest.raises(ImportFormatError, match=r"contact.tiff: .*a TIFF does not state them"):
        raspberry_pi_capture(raw_folder, RaspberryPiOptions())
    with pytest.raises(ImportFormatError, match=r"values up to \d+ DN, but 8 bits allow at most 255 DN"):
        raspberry_pi_capture(raw_folder, RaspberryPiOptions(bayer_order="BGGR", bit_depth=8))
    capture = raspberry_pi_capture(raw_folder, RaspberryPiOptions(bayer_order="BGGR", bit_depth=10))
    seen = rgb_image(capture.contact, capture)
    np.testing.assert_allclose(seen / 1024, np.broadcast_to(CAMERA["contact"], seen.shape), atol=0.5 / 1024)


def test_flattened_and_unequal_black_levels_are_stored_on_a_pedestal(raw_folder):
    for name in NAMES:
        (raw_folder / f"{name}.json").write_text(json.dumps(metadata(SensorBlackLevels=[4096, 4096, 4096, 2048])))
    capture = raspberry_pi_capture(raw_folder, RaspberryPiOptions())
    assert (capture.bit_depth, capture.black_level_dn) == (16, 1024.0)
    contact, before = (rgb_image(i, capture)[0, 0] for i in (capture.contact, capture.no_contact))
    truth = CAMERA["contact"] + [0, 0, 1 / 32], CAMERA["no_contact"] + [0, 0, 1 / 32]
    # One scale for all images and channels; half a count of 1024 in values of 0.1 and more.
    np.testing.assert_allclose(contact / before, truth[0] / truth[1], rtol=0.01)
    np.testing.assert_allclose(contact / contact[1], truth[0] / truth[0][1], rtol=0.01)
    flat = raspberry_pi_capture(raw_folder, RaspberryPiOptions(tuning=TUNING, flatten_shading=True))
    middle, corner = (rgb_image(flat.contact, flat)[at] for at in ((10, 15), (0, 0)))
    assert corner[1] > 1.5 * middle[1]
    assert "lens shading flattened" in flat.source


def test_processed_images_become_estimates_with_a_stated_uncertainty(processed_folder):
    capture = raspberry_pi_capture(processed_folder, RaspberryPiOptions(tuning=TUNING, undo_colour=True))
    assert (capture.encoding, capture.layout, capture.bit_depth) == ("linear", "RGB", 16)
    seen = {name: rgb_image(getattr(capture, name), capture)[0, 0] for name in NAMES}
    for name in NAMES[1:]:
        # Half a code of 255 is up to 2 % of a linear value here, a mixture of channels twice that.
        np.testing.assert_allclose(seen[name] / seen["contact"], CAMERA[name] / CAMERA["contact"], rtol=0.05)
    assert "typical standard uncertainty" in capture.source
    assert "ce_enable" in capture.source
    plain = raspberry_pi_capture(processed_folder, RaspberryPiOptions(tuning=TUNING))
    assert "colour matrix" not in plain.source


def test_the_command_stores_a_record_with_the_digests_of_its_inputs(processed_folder, tmp_path):
    tuning = tmp_path / "imx219.json"
    tuning.write_text(json.dumps(version_2()).replace("]}]}", "]},]}"))  # shipped files have such commas
    out = tmp_path / "ball.capture.json"
    said = succeed(f"import raspberry-pi {processed_folder} --tuning {tuning} --undo-colour --out {out}")
    assert "ball on pad, 60 x 40 px, encoding linear" in said
    assert "typical standard uncertainty" in said
    capture = read_record(out, TactileCapture)
    assert capture.indenter.depth_mm is None
    names = capture.provenance.input_sha256
    assert any(name.endswith("contact.json") for name in names)
    assert any(name.endswith("imx219.json") for name in names)
    assert finray(f"import raspberry-pi {processed_folder} --out {tmp_path}/x.json").status == 2


def spoil(folder, kind):
    contact = folder / "contact.dng"
    match kind:
        case "auto exposure":
            (folder / "contact.json").write_text(json.dumps(metadata(AeEnable=True)))
        case "auto white balance":
            (folder / "no_contact.json").write_text(json.dumps(metadata(AwbEnable=True)))
        case "exposure changed":
            (folder / "no_contact.json").write_text(json.dumps(metadata(ExposureTime=20_000)))
        case "no metadata":
            (folder / "contact.json").unlink()
        case "metadata broken":
            (folder / "contact.json").write_text("{")
        case "metadata list":
            (folder / "contact.json").write_text("[]")
        case "no contact image":
            contact.unlink()
        case "two contact images":
            shutil.copy(contact, folder / "contact.png")
        case "metadata too deep":
            (folder / "contact.json").write_text("[" * 100_000)
        case "no press":
            (folder / "press.toml").unlink()
        case "press broken":
            (folder / "press.toml").write_text("name =")
        case "press incomplete":
            (folder / "press.toml").write_text(PRESS.replace("radius_mm = 4.0\n", ""))
        case "mixed":
            contact.unlink()
            cv2.imwrite(str(folder / "contact.png"), np.zeros((40, 60, 3), np.uint8))
        case "sizes differ":
            write_dng(contact, np.full((20, 20), 100, np.uint16))
        case "no raw page":
            tifffile.imwrite(contact, np.zeros((8, 8, 3), np.uint8), photometric="rgb")
        case "not a DNG":
            contact.write_bytes(b"no image")
        case "odd pattern":
            write_dng(contact, np.full((40, 60), 100, np.uint16), pattern=(0, 0, 1, 2))
        case "odd white level":
            write_dng(contact, np.full((40, 60), 100, np.uint16), white_dn=1000)
        case "no black level":
            for name in NAMES:
                (folder / f"{name}.json").write_text(json.dumps(metadata(SensorBlackLevels=None)))


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("auto exposure", r"contact.dng: auto exposure was on"),
        ("auto white balance", r"no_contact.dng: auto white balance was on"),
        ("exposure changed", r"ExposureTime is 0.01 s in contact.dng, but 0.02 s in no_contact.dng"),
        ("no metadata", r"contact.dng: the metadata file contact.json is missing"),
        ("metadata broken", r"contact.json: cannot be read as JSON"),
        ("metadata too deep", r"contact.json: cannot be read as JSON"),
        ("metadata list", r"contact.json: must be a JSON object"),
        ("no contact image", r"the image 'contact' \(.dng"),
        ("two contact images", r"contains contact.dng and contact.png, but .*; keep one"),
        ("no press", r"press.toml: no such file; write it with a name and an \[indenter\]"),
        ("press broken", r"press.toml: cannot be read as TOML"),
        ("press incomplete", r"press.toml: 'indenter.radius_mm': is missing"),
        ("mixed", r"contains both raw and processed images"),
        ("sizes differ", r"differ in Bayer order, bits or size"),
        ("no raw page", r"contains no colour filter array \(Bayer\) image"),
        ("not a DNG", r"cannot be read as DNG .*; check that the file is complete"),
        ("odd pattern", r"Bayer pattern \[0, 0, 1, 2\] of an image .* is not supported"),
        ("odd white level", r"white level of 1000 DN is not supported; it must be 2\^bits - 1"),
        ("no black level", r"neither metadata \(SensorBlackLevels\) nor a tuning file states the black level"),
    ],
)
def test_what_cannot_be_trusted_is_refused(raw_folder, kind, message):
    spoil(raw_folder, kind)
    with pytest.raises(ImportFormatError, match=message):
        raspberry_pi_capture(raw_folder, RaspberryPiOptions())


def test_the_tuning_file_gives_the_black_level_that_metadata_lacks(raw_folder):
    spoil(raw_folder, "no black level")
    assert raspberry_pi_capture(raw_folder, RaspberryPiOptions(tuning=TUNING)).black_level_dn == 64.0


def test_flattening_needs_tables_and_a_colour_temperature(raw_folder):
    with pytest.raises(ImportFormatError, match=r"needs a tuning file with rpi.alsc tables; give --tuning"):
        raspberry_pi_capture(raw_folder, RaspberryPiOptions(flatten_shading=True))
    for name in NAMES:
        (raw_folder / f"{name}.json").write_text(json.dumps(metadata(ColourTemperature=None)))
    with pytest.raises(ImportFormatError, match=r"ColourTemperature is missing, but the lens-shading tables need it"):
        raspberry_pi_capture(raw_folder, RaspberryPiOptions(tuning=TUNING, flatten_shading=True))


def test_processed_images_need_a_tuning_and_one_size(processed_folder):
    with pytest.raises(
        ImportFormatError, match=r"tone curve of processed images .* unknown without the camera's tuning"
    ):
        raspberry_pi_capture(processed_folder, RaspberryPiOptions())
    cv2.imwrite(str(processed_folder / "contact.png"), np.zeros((20, 20, 3), np.uint8))
    with pytest.raises(ImportFormatError, match=r"the images differ in size"):
        raspberry_pi_capture(processed_folder, RaspberryPiOptions(tuning=TUNING))
    cv2.imwrite(str(processed_folder / "contact.png"), np.zeros((20, 20), np.uint16))
    with pytest.raises(ImportFormatError, match=r"contact.png: .* must be .* got uint16 of shape \(20, 20\)"):
        raspberry_pi_capture(processed_folder, RaspberryPiOptions(tuning=TUNING))


def test_tiffs_that_are_no_bayer_counts_are_refused(raw_folder):
    (raw_folder / "contact.dng").unlink()
    options = RaspberryPiOptions(bayer_order="RGGB", bit_depth=10)
    tifffile.imwrite(raw_folder / "contact.tif", np.zeros((8, 8, 3), np.uint8), photometric="rgb")
    with pytest.raises(
        ImportFormatError, match=r"contact.tif: is uint8 of shape \(8, 8, 3\), but raw Bayer counts must be"
    ):
        raspberry_pi_capture(raw_folder, options)
    (raw_folder / "contact.tif").write_bytes(b"no image")
    with pytest.raises(ImportFormatError, match=r"contact.tif: cannot be read as TIFF"):
        raspberry_pi_capture(raw_folder, options)


def test_tuning_files_that_are_none_are_refused(tmp_path):
    path = tmp_path / "imx219.json"
    with pytest.raises(ImportFormatError, match=r"imx219.json: no such file"):
        read_tuning(path)
    path.write_text("{")
    with pytest.raises(ImportFormatError, match=r"imx219.json: cannot be read as JSON"):
        read_tuning(path)
    path.write_text("{}")
    with pytest.raises(ImportFormatError, match=r"imx219.json: tuning: contains no 'rpi.' algorithm"):
        read_tuning(path)
