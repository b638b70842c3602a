"""Folders of renders of any simulator, imported and compared by the command line alone."""

import json

import cv2
import numpy as np
import pytest

from data_schemas import ContactCircle, ImportFormatError, PhotometricErrorReport, SimulatedPress, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.exchange import press_request, read_by_recipe, read_recipe, read_renders
from finray_calib.exchange._set_files import exr_rgb
from finray_calib.sensing import outline_distance
from tests.command_line.running import finray, succeed
from tests.compare.test_tone_curve import RADIUS_PX, SHAPE, distance, pair
from tests.exchange.recipe_folders import write_fots

DEPTH_MM = np.maximum(1.0 - distance() ** 2, 0.0)


def write_render(folder, contact, no_contact, kind=".npy", depth=True, **description):
    folder.mkdir(parents=True)
    for name, image in (("contact", contact), ("no_contact", no_contact)):
        if kind == ".npy":
            np.save(folder / f"{name}.npy", image)
        else:
            cv2.imwrite(str(folder / f"{name}.png"), image[..., ::-1])
    if depth:
        np.save(folder / "depth.npy", DEPTH_MM)
    if description:
        (folder / "render.json").write_text(json.dumps(description))
    return folder


LINEAR = {"simulator": "made-up 1.0", "encoding": "linear", "channels": "RGB"}


def images(seed=0):
    press, capture = pair(seed)
    return press.contact, press.no_contact, capture


def test_from_a_folder_of_light_to_a_page_in_two_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    contact, no_contact, capture = images()
    write_render(tmp_path / "ball", contact, no_contact, **LINEAR, command="simulate ball", samples=64)
    write_record(capture, tmp_path / "ball.capture.json", provenance("pytest"))
    told = succeed("import render ball")
    assert "ball.press.json: 1 press, 160 x 120 px, linear light; rendered, made-up 1.0" in told
    succeed("compare ball.press.json ball.capture.json")
    report = read_record(tmp_path / "photometric-error.json", PhotometricErrorReport)
    assert report.headline_skill.estimate > 0.9
    assert report.tone_curve is not None
    assert any("rendered by: simulate ball" in note for note in report.notes)
    assert (tmp_path / "photometric-error.html").read_text().count('id="tone-curve-of-the-camera"') == 1
    again = finray("import render ball")
    assert again.status == 2
    assert "exists already" in again.err


def test_a_folder_of_presses_meets_a_folder_of_captures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for i, name in enumerate(("one", "two")):
        contact, no_contact, capture = images(i)
        write_render(tmp_path / "renders" / name, contact, no_contact, depth=False, **LINEAR)
        circle = ContactCircle(row_px=62.0, column_px=70.0, radius_px=RADIUS_PX)
        labelled = capture.model_copy(update={"contact_circle": circle, "name": name})
        write_record(labelled, tmp_path / "captures" / f"{name}.capture.json", provenance("pytest"))
    told = succeed("import render renders --capture captures")
    assert "renders.presses: 2 presses" in told
    assert "next: finray compare renders.presses captures\n" in told
    assert "next: finray compare one.press.json captures/one.capture.json\n" in succeed(
        "import render renders/one --capture captures"
    )
    press = read_record(tmp_path / "renders.presses" / "two.press.json", SimulatedPress)
    np.testing.assert_allclose(press.distance, distance(), atol=1e-5)
    assert "skill 0.9" in succeed("compare renders.presses captures")


def test_encoded_images_stay_encoded_and_rgb(tmp_path):
    _, _, capture = images()
    write_render(tmp_path / "p", capture.contact.astype(np.uint8), capture.no_contact.astype(np.uint8), ".png")
    press = read_renders(tmp_path / "p")["p"]
    assert press.encoding == "unknown"
    np.testing.assert_array_equal(press.contact, capture.contact)


def test_bgr_arrays_are_turned(tmp_path):
    contact, no_contact, _ = images()
    write_render(tmp_path / "p", contact[..., ::-1], no_contact[..., ::-1], **{**LINEAR, "channels": "BGR"})
    np.testing.assert_array_equal(read_renders(tmp_path / "p")["p"].contact, contact.astype(np.float32))


def test_the_distance_of_a_disc_is_that_of_its_circle():
    rows, columns = np.mgrid[:200, :200]
    away = np.hypot(rows - 100, columns - 90) / 40.0
    found = outline_distance(away <= 1.0)
    # pixels make the outline, and with it the half-width, uncertain by one of them in forty
    np.testing.assert_allclose(found, away, atol=1.0 / 40.0, rtol=1.0 / 40.0)
    assert (outline_distance(np.ones((4, 4), dtype=bool)) == 0.0).all()


def test_a_mask_says_where_the_contact_is(tmp_path):
    contact, no_contact, _ = images()
    folder = write_render(tmp_path / "p", contact, no_contact, depth=False, **LINEAR)
    cv2.imwrite(str(folder / "contact_mask.png"), (255 * (distance() <= 1.0)).astype(np.uint8))
    press = read_renders(folder)["p"]
    np.testing.assert_allclose(press.distance, distance(), atol=1.0 / RADIUS_PX, rtol=1.0 / RADIUS_PX)
    cv2.imwrite(str(folder / "contact_mask.png"), np.zeros(SHAPE, dtype=np.uint8))
    with pytest.raises(ImportFormatError, match="must have the size of the images, with white pixels"):
        read_renders(folder)


def _spoil(folder, what):
    contact = np.load(folder / "contact.npy")
    if what == "no untouched image":
        (folder / "no_contact.npy").unlink()
    elif what == "different formats":
        (folder / "no_contact.npy").unlink()
        cv2.imwrite(str(folder / "no_contact.png"), np.zeros((*SHAPE, 3), np.uint8))
    elif what == "no encoding":
        (folder / "render.json").write_text('{"channels": "RGB"}')
    elif what == "no order":
        (folder / "render.json").write_text('{"encoding": "linear"}')
    elif what == "another size":
        np.save(folder / "no_contact.npy", contact[:-2])
    elif what == "negative":
        np.save(folder / "contact.npy", -contact)
    elif what == "nowhere":
        (folder / "depth.npy").unlink()
    elif what == "flat":
        np.save(folder / "depth.npy", np.zeros(SHAPE))
    elif what == "pickled":
        np.save(folder / "contact.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    elif what == "unknown word":
        (folder / "render.json").write_text('{"encoding": "gamma"}')


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("no untouched image", r"no_contact .* is missing beside contact; render the untouched gel"),
        ("different formats", r"contact\.npy and no_contact\.png have different formats"),
        ("no encoding", r'npy files do not state it; write "encoding": "linear"'),
        ("no order", r"the order of the channels is unknown"),
        ("another size", r"is 160 x 120 px, but no_contact\.npy is 160 x 118 px; render both with one camera"),
        ("negative", r"expected finite numbers of at least 0 and shape \(rows, columns, 3\)"),
        ("nowhere", r"the place of the contact is missing, but a score needs it"),
        ("flat", r"expected finite depths in mm .* of shape \(120, 160\)"),
        ("pickled", r"Pickled files are not supported"),
        ("unknown word", r"render\.json: .*encoding"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, what, message):
    contact, no_contact, _ = images()
    folder = write_render(tmp_path / "p", contact, no_contact, **LINEAR)
    _spoil(folder, what)
    with pytest.raises(ImportFormatError, match=message):
        read_renders(folder)


def test_no_folder_and_an_empty_one(tmp_path):
    with pytest.raises(ImportFormatError, match="no such folder"):
        read_renders(tmp_path / "nowhere")
    with pytest.raises(ImportFormatError, match="contains no file contact"):
        read_renders(tmp_path)


def test_captures_without_a_circle_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    contact, no_contact, capture = images()
    write_render(tmp_path / "ball", contact, no_contact, **LINEAR)
    write_record(capture, tmp_path / "ball.capture.json", provenance("pytest"))
    refused = finray("import render ball --capture ball.capture.json")
    assert refused.status == 2
    assert "holds no capture with a contact circle" in refused.err


def test_openexr_is_light(tmp_path):
    exr = pytest.importorskip("OpenEXR")
    contact, no_contact, _ = images()
    (tmp_path / "p").mkdir()
    for name, image in (("contact", contact), ("no_contact", no_contact)):
        channels = {c: np.ascontiguousarray(image[..., i], dtype=np.float32) for i, c in enumerate("RGB")}
        header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
        with exr.File(header, channels) as file:
            file.write(str(tmp_path / "p" / f"{name}.exr"))
    np.save(tmp_path / "p" / "depth.npy", DEPTH_MM)
    press = read_renders(tmp_path / "p")["p"]
    assert press.encoding == "linear"
    np.testing.assert_allclose(press.contact, contact.astype(np.float32))
    grey = {"Y": np.ones(SHAPE, dtype=np.float32)}
    (tmp_path / "p" / "contact.exr").unlink()
    with exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, grey) as file:
        file.write(str(tmp_path / "p" / "contact.exr"))
    with pytest.raises(ImportFormatError, match="must have the channels R, G and B, got Y"):
        read_renders(tmp_path / "p")


@pytest.mark.parametrize(
    ("layers", "taken"),
    [
        (("", "albedo.", "variance."), ""),
        (("ViewLayer.Combined.",), "ViewLayer.Combined."),
        (("contact.", "no_contact.", "variance."), None),
    ],
)
def test_of_the_layers_of_an_openexr_image_the_picture_is_taken(tmp_path, layers, taken):
    exr = pytest.importorskip("OpenEXR")
    images = {layer: np.full((*SHAPE, 3), 0.1 * k, dtype=np.float32) for k, layer in enumerate(layers, 1)}
    channels = {
        f"{n}{c}": np.ascontiguousarray(image[..., i]) for n, image in images.items() for i, c in enumerate("RGB")
    }
    channels["ViewLayer.Normal.X"] = np.ones(SHAPE, dtype=np.float32)
    with exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, channels) as file:
        file.write(str(tmp_path / "x.exr"))
    if taken is None:
        with pytest.raises(ImportFormatError, match=r"several layers of R, G and B \(contact, no_contact, variance\)"):
            exr_rgb(tmp_path / "x.exr")
    else:
        np.testing.assert_array_equal(exr_rgb(tmp_path / "x.exr"), images[taken])


def test_a_press_is_asked_for_without_its_contact_and_bayer_counts_are_refused(tmp_path):
    capture = read_by_recipe(write_fots(tmp_path / "f"), read_recipe("fots-gelsight")[0]).captures["0002"]
    asked = press_request(capture, with_contact=False)
    assert asked.keys() == {"no_contact.png", "press.json"}
    told = json.loads(asked["press.json"])
    assert told["contact_circle"] == {"row_px": 45.0, "column_px": 60.0, "radius_px": 20.0}
    assert (told["encoding"], told["indenter"]["radius_mm"]) == ("encoded", 2.35)
    deep = capture.model_copy(update={"bit_depth": 12, "black_level_dn": 64.0, "contact": capture.contact + 1000})
    taught = press_request(deep, with_contact=True)
    image = cv2.imdecode(np.frombuffer(taught["contact.png"], np.uint8), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_array_equal(image, capture.contact + 1000 - 64)
    plane = capture.contact[..., :1]
    bayer = capture.model_copy(update={"layout": "Bayer RGGB", "contact": plane, "no_contact": plane})
    with pytest.raises(
        ImportFormatError, match="contains Bayer RGGB counts, but simulators of colour images need a capture in RGB"
    ):
        press_request(bayer, with_contact=False)
