"""Recipes turn the folders of other labs into captures; what cannot be is refused with what to do."""

import gc
import json
import pickle
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_schemas import CompareError, ImportFormatError, IndenterPose, PlaceInImage, SimulatedPress, TactileCapture
from data_schemas.storage import read_record
from finray_calib.compare import predict_press, train_table
from finray_calib.exchange import (
    Recipe,
    outline_solid_stl,
    read_by_recipe,
    read_circles,
    read_recipe,
    recipe_names,
    with_sizes,
)
from finray_calib.exchange._press_labels import pickle_words
from finray_calib.sensing import _contact_place as contact_place
from finray_calib.sensing import contact_distance, find_contact_circle
from finray_calib.sensing._contact_place import _coarse
from sim import read_sensor
from sim.experiments import pressed_coat
from sim.mechanics import read_triangles
from tests.command_line.running import finray, succeed
from tests.exchange.ball_press_folders import Trap
from tests.exchange.recipe_folders import (
    BALL_PX,
    CONTACT_PX,
    PLACES,
    SHAPE_PX,
    dome,
    flat,
    grasp,
    save,
    soft_dome,
    write_balls,
    write_digit,
    write_edges,
    write_fots,
    write_video,
)

PICTURES = """\
name = "mine"
what = "presses of a ball"

[presses]
files = "{press}.png"
leave_out = ["rest"]

[no_contact]
file = "rest.png"

[indenter]
shape = "ball"
diameter_mm = 4.0
"""
PRISM = (
    PICTURES.replace('shape = "ball"\ndiameter_mm = 4.0', 'shape = "mesh"\nextruded_mm = 5.0')
    + "depth_mm = { a = 0.5, b = 1.0 }\ndepth_uncertainty_mm = 0.05\n[scale]\nmm_per_px = 0.1\n"
    + "[contact.outline_px]\na = [[20, 10], [60, 20], [40, 50]]\nb = [[20, 10], [60, 20], [40, 50]]\n"
)


def recipe(text):
    """A recipe of a few lines."""
    import tomllib

    return Recipe.model_validate(tomllib.loads(text))


def shipped(name, **sizes):
    """A recipe that comes with the program."""
    return with_sizes(read_recipe(name)[0], sizes.get("ball"), sizes.get("scale"))


@pytest.mark.parametrize("name", recipe_names())
def test_recipes_that_come_with_the_program_are_whole(name):
    assert read_recipe(name)[0].name == name


def test_circles_of_a_table_are_found_by_the_name_of_the_file(tmp_path):
    found = read_by_recipe(write_fots(tmp_path / "f"), shipped("fots-gelsight"))
    assert list(found.captures) == ["0001", "0002", "0003", "0004", "0005"]
    for (row, column), capture in zip(PLACES, found.captures.values(), strict=True):
        circle = capture.contact_circle
        assert (circle.row_px, circle.column_px, circle.radius_px) == (row, column, CONTACT_PX)
        assert (capture.contact_told_by, capture.no_contact_from) == ("label", "image")
        assert capture.mm_per_px == pytest.approx(1.0 / 19.58)
        assert 2.0 * capture.indenter.radius_mm == pytest.approx(4.70)
        assert {part.what for part in capture.missing} >= {"a second image without contact", "the force"}


def test_a_circle_larger_than_its_ball_leaves_the_press_out(tmp_path):
    folder = write_fots(tmp_path / "f")
    table = folder / "mlp_calib" / "csv" / "annotate.csv"
    table.write_text(table.read_text().replace(f"{int(CONTACT_PX)}\n", "47\n", 1))
    found = read_by_recipe(folder, shipped("fots-gelsight"))
    assert list(found.left_out.values()) == [["0001"]]
    assert "larger than the ball's 46.01 px" in next(iter(found.left_out))
    # a scale the wrong way round contradicts every circle
    with pytest.raises(ImportFormatError, match=r"none of the 5 presses can be read.*the scale is mm per px, not px"):
        read_by_recipe(folder, shipped("fots-gelsight", scale=0.9))


def test_contacts_that_nobody_drew_are_searched_for(tmp_path):
    found = read_by_recipe(write_digit(tmp_path / "f"), shipped("fots-digit", ball=2 * BALL_PX / 21.09))
    assert found.left_out == {"the recipe excludes it": ["0001"]}
    assert len(found.captures) == 8
    for name, capture in list(found.captures.items())[:3]:
        assert (capture.contact_told_by, capture.no_contact_from) == ("search", "median of presses")
        row, column = PLACES[int(name)]
        circle = capture.contact_circle
        assert np.hypot(circle.row_px - row, circle.column_px - column) < 0.2 * CONTACT_PX
        assert circle.radius_px == pytest.approx(CONTACT_PX, rel=0.2)


def test_edges_become_outlines_and_their_length_proves_the_scale(tmp_path):
    folder = write_edges(tmp_path / "f")
    with pytest.raises(
        ImportFormatError,
        match=r"10 mm are 100 px in the labels, so a pixel is 0\.1 mm wide, but the scale gives 0\.0634 mm",
    ):
        read_by_recipe(folder, shipped("gs-sdk-edge"))
    right = shipped("gs-sdk-edge").scale.model_copy(update={"mm_per_px": 0.1})
    found = read_by_recipe(folder, shipped("gs-sdk-edge").model_copy(update={"scale": right}))
    assert list(found.captures) == ["10.000x10.000mm/0", "10.000x10.000mm/1"]
    assert list(found.left_out.values()) == [["10.000x10.000mm/2"]]
    capture = found.captures["10.000x10.000mm/0"]
    assert {(p.column_px, p.row_px) for p in capture.contact_outline} == {(30, 50), (130, 50), (130, 68), (30, 68)}
    distance = contact_distance(capture)
    assert distance[59, 80] < 0.15
    assert distance[48, 80] > 1.0 > distance[52, 80]
    assert capture.indenter.radius_mm == 5.0


def test_an_outline_on_one_line_is_left_out(tmp_path):
    folder = write_edges(tmp_path / "f")
    on_a_line = {f"rect{k}": [[30, 50], [60, 60], [90, 70]] for k in (1, 2)}
    np.savez(folder / "sensor_images" / "10.000x10.000mm" / "1" / "label.npz", line_length=100, **on_a_line)
    right = shipped("gs-sdk-edge").scale.model_copy(update={"mm_per_px": 0.1})
    found = read_by_recipe(folder, shipped("gs-sdk-edge").model_copy(update={"scale": right}))
    assert list(found.captures) == ["10.000x10.000mm/0"]
    assert found.left_out["all corners of its outline lie on one line"] == ["10.000x10.000mm/1"]


def test_balls_of_gs_sdk_have_the_diameter_of_the_catalog(tmp_path):
    found = read_by_recipe(write_balls(tmp_path / "f"), shipped("gs-sdk-balls"))
    assert list(found.captures) == ["6.000mm/0", "6.000mm/1"]
    capture = found.captures["6.000mm/1"]
    assert capture.indenter.radius_mm == 3.0
    assert (capture.contact_circle.row_px, capture.contact_circle.column_px) == PLACES[1]


def test_a_video_gives_contact_no_contact_and_its_repeat(tmp_path):
    write_video(tmp_path / "example_data" / "2023-12-16" / "golf_ball__t=0.avi", grasp())
    write_video(tmp_path / "example_data" / "2023-12-16" / "bolt__t=0.avi", grasp())
    plain = shipped("estimate-modulus")
    plain = plain.model_copy(update={"picture": plain.picture.model_copy(update={"corners_px": None, "size_px": None})})
    found = read_by_recipe(tmp_path, plain)
    assert list(found.captures) == ["golf_ball__t=0"]
    capture = found.captures["golf_ball__t=0"]
    np.testing.assert_allclose(capture.no_contact, flat(), atol=6)
    assert capture.repeat_no_contact is not None
    # the whole dent, not one of the frames on the way to it
    dent = (slice(45, 75), slice(65, 95))
    assert np.abs(capture.contact.astype(float) - grasp()[20])[dent].mean() < 2.0
    assert np.abs(grasp()[13] - grasp()[20])[dent].mean() > 4.0
    assert capture.force_n is None
    force_n = np.zeros(30)
    force_n[17:23] = 8.0
    np.save(tmp_path / "example_data" / "2023-12-16" / "golf_ball__t=0_forces.npy", force_n)
    assert read_by_recipe(tmp_path, plain).captures["golf_ball__t=0"].force_n == 8.0
    np.save(tmp_path / "example_data" / "2023-12-16" / "golf_ball__t=0_forces.npy", force_n[:5])
    with pytest.raises(
        ImportFormatError, match="has 5 forces for 30 frames, but must contain a finite number for each"
    ):
        read_by_recipe(tmp_path, plain)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_hold_of_a_load_cell_of_any_sign_and_rest_is_found(tmp_path, sign):
    """Many cells count compression as negative, and rest beside zero."""
    film = tmp_path / "example_data" / "2023-12-16" / "golf_ball__t=0.avi"
    write_video(film, grasp())
    force_n = np.full(30, -1.5 * sign)
    force_n[17:23] -= 8.0 * sign
    force = film.with_name("golf_ball__t=0_forces.npy")
    np.save(force, force_n)
    plain = shipped("estimate-modulus")
    plain = plain.model_copy(update={"picture": plain.picture.model_copy(update={"corners_px": None, "size_px": None})})
    if sign > 0.0:
        with pytest.raises(ImportFormatError, match=r"its force is -8 N, which is a pull; .* give a factor below 0"):
            read_by_recipe(tmp_path, plain)
        plain = plain.model_copy(update={"force": plain.force.model_copy(update={"factor": -1.0})})
    capture = read_by_recipe(tmp_path, plain).captures["golf_ball__t=0"]
    assert capture.force_n == pytest.approx(8.0)  # without contact there is no force: the cell's rest is its zero
    assert np.abs(capture.contact.astype(float) - capture.no_contact).max() > 20.0
    for values, message in ((np.full(30, 2.0), "nothing changes"), (np.eye(30)[3], "shows contact within the first")):
        np.save(force, values)
        with pytest.raises(ImportFormatError, match=message):
            read_by_recipe(tmp_path, plain)


def test_a_label_is_of_one_press_only(tmp_path):
    """Where names repeat in folders, or end in a number behind a dot, none gets the label of another."""
    for name in ("A/001", "B/001", "press_1", "press_1.5"):
        save(tmp_path / f"{name}.png", grasp()[20])
    save(tmp_path / "rest.png", flat())
    text = PICTURES.replace("[indenter]\n", CIRCLE).replace('"r"', "8.0")
    lines = {"A/001.png": 40, "B/001.png": 100, "press_1.5": 50, "press_1": 60}
    (tmp_path / "t.csv").write_text("n,x,r\n" + "".join(f"{name},{x},8\n" for name, x in lines.items()))
    found = read_by_recipe(tmp_path, recipe(text)).captures
    columns = {name: capture.contact_circle.column_px for name, capture in found.items()}
    assert columns == {"A/001": 40.0, "B/001": 100.0, "press_1": 60.0, "press_1.5": 50.0}
    (tmp_path / "t.csv").write_text("n,x,r\n/there/001.png,40,8\n/here/001.png,100,8\npress_1,60,8\n")
    read = read_by_recipe(tmp_path, recipe(text))
    assert list(read.captures) == ["press_1"]
    assert any(
        "several rows of the table" in why and names == ["A/001", "B/001"] for why, names in read.left_out.items()
    )


def test_links_that_lead_out_of_the_folder_are_refused(tmp_path):
    folder = tmp_path / "set"
    save(tmp_path / "secret.png", flat())
    save(folder / "a.png", grasp()[20])
    (folder / "rest.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(ImportFormatError, match=r"rest\.png: points outside the folder; copy the file into the folder"):
        read_by_recipe(folder, recipe(PICTURES))


def test_the_gel_is_cut_out_at_its_corners(tmp_path):
    frames = [np.zeros((*SHAPE_PX, 3)) + 20.0 for _ in range(14)]
    for k, frame in enumerate(frames):
        frame[30:90, 40:120] = [100.0 + (60.0 if k > 11 else 0.0), 80.0, 60.0]
    write_video(tmp_path / "example_data" / "2023-12-16" / "golf_ball_1.avi", frames)
    cut = {"corners_px": ((40, 30), (119, 30), (40, 89), (119, 89)), "size_px": (80, 60)}
    plain = shipped("estimate-modulus")
    found = read_by_recipe(
        tmp_path, plain.model_copy(update={"picture": plain.picture.model_copy(update=cut), "contact": None})
    )
    contact = found.captures["golf_ball_1"].contact
    assert contact.shape == (60, 80, 3)
    np.testing.assert_allclose(contact[10:50, 10:70].mean(axis=(0, 1)), [160, 80, 60], atol=4)


def test_photographs_in_linear_light_get_a_surface_for_their_rest(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")  # noqa: N806
    rows, columns = np.mgrid[:600, :600] / 600.0
    light = np.stack([0.1 + 0.1 * columns, 0.2 - 0.05 * rows, 0.3 + 0.0 * rows], axis=-1)
    touched = light.copy()
    touched[250:350, 250:350] *= 0.5
    folder = tmp_path / "target_settings" / "flatgel" / "imgs"
    folder.mkdir(parents=True)
    channels = {name: np.ascontiguousarray(touched[..., c], dtype=np.float16) for c, name in enumerate("RGB")}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(
        str(folder / "tri0u.exr")
    )
    found = read_by_recipe(tmp_path, shipped("tactile-optical-simulation"))
    capture = found.captures["tri0u"]
    assert (capture.encoding, capture.bit_depth, capture.no_contact_from) == (
        "linear",
        16,
        "pixels far from the contact",
    )
    np.testing.assert_allclose(capture.no_contact / 65535.0 * 0.75, light, rtol=0.01)


def test_nothing_pickled_is_opened_and_the_lines_that_convert_it_are_told(tmp_path):
    sprung = tmp_path / "sprung"
    folder = write_edges(tmp_path / "f", labelled=1)
    np.savez(
        folder / "sensor_images" / "10.000x10.000mm" / "0" / "label.npz",
        allow_pickle=True,
        rect1=np.array([Trap(sprung)], dtype=object),
        rect2=np.zeros((4, 2)),
    )
    with pytest.raises(ImportFormatError, match="'rect1' is stored as pickled objects, which are never loaded; have"):
        read_by_recipe(folder, shipped("gs-sdk-edge"))
    write_video(tmp_path / "v" / "example_data" / "2023-12-16" / "golf_ball_1.avi", grasp())
    (tmp_path / "v" / "example_data" / "2023-12-16" / "golf_ball_1_forces.pkl").write_bytes(pickle.dumps(Trap(sprung)))
    plain = shipped("estimate-modulus")
    pickled = plain.model_copy(
        update={"force": plain.force.model_copy(update={"file": "example_data/2023-12-16/{press}_forces.pkl"})}
    )
    with pytest.raises(ImportFormatError, match="is never opened because it could run code of an unknown author"):
        read_by_recipe(tmp_path / "v", pickled)
    assert not sprung.exists()


def test_the_lines_that_convert_a_pickle_do_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("forces.pkl").write_bytes(pickle.dumps([0.0, 1.5]))
    code = pickle_words(Path("forces.pkl")).split("in your own Python: ")[1].split(", and name")[0]
    exec(code, {})
    assert np.load("forces.npy").tolist() == [0.0, 1.5]


CIRCLE = '[contact]\nfile = "t.csv"\npress = "n"\ncircle = {column_px = "x", row_px = 9, radius_px = 9}\n[indenter]\n'


@pytest.mark.parametrize(
    ("change", "of_contact", "message"),
    [
        (('file = "rest.png"', 'file = "other.png"'), None, "the image without contact, other.png, is missing"),
        (
            ('"{press}.png"', '"{press}.tiff"'),
            None,
            r"no file in the folder matches presses.files of the recipe 'mine' "
            r"\(\{press\}.tiff\)",
        ),
        (('"{press}.png"', '"../{press}.png"'), None, "must be a path within the folder"),
        (('"{press}.png"', '"a.png"'), None, r"must contain \{press\}, .* exactly once"),
        (("[indenter]\n", CIRCLE), ('press = "n"\n', ""), "'press' is missing next to file"),
        (
            ("[indenter]\n", CIRCLE),
            ('= "x"', '= "y"'),
            "t.csv: has no column 'y'; its columns are n, x, r. Correct the recipe",
        ),
        (("[indenter]\n", CIRCLE), ('"n"', '"m"'), "has no column 'm' that names the press"),
        (("[indenter]\n", CIRCLE), ('= "x"', '= "r"'), "r of a must be a number, got 'wide'"),
        (
            ("[indenter]\n", CIRCLE),
            ("row_px = 9", "row_px = 999"),
            "outside the picture of 160 x 120 px or in pixel 0, 0; check the",
        ),
        (("[indenter]\n", CIRCLE), ("t.csv", "t.pkl"), "t.pkl: is a pickle file"),
        (('file = "rest.png"', "frames_before = 3"), None, r"for videos \(\.avi, .*\), but a\.png is not a video"),
        (
            ("[indenter]\n", CIRCLE),
            ("t.csv", "{press}.npz"),
            r"the file a\.npz, which the recipe names, is missing",
        ),
    ],
)
def test_what_a_recipe_and_a_folder_contradict_is_told(tmp_path, change, of_contact, message):
    save(tmp_path / "a.png", grasp()[20])
    save(tmp_path / "rest.png", flat())
    (tmp_path / "t.csv").write_text("n,x,r\na.png,80,wide\n")
    text = PICTURES.replace(*change).replace(*(of_contact or ("", "")))
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(tmp_path, recipe(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PICTURES.replace('file = "rest.png"', "median_of_presses = true\nfar_pixels = true"), "exactly one of file"),
        (PICTURES + "[scale]\nmm_per_px = 0.1\npx_per_mm = 10\n", "exactly one of mm_per_px and px_per_mm"),
        (PICTURES + "[scale]\nmm_per_px = 0.1\ncheck_length_mm = 10\n", "only one of check_length_mm and"),
        (PICTURES + "[contact]\nsearch = 'circle'\noutline = ['a']\n", "exactly one of circle, box, outline"),
        (PICTURES + "[contact]\noutline = ['a']\n", "file is missing"),
        (PICTURES + "[picture]\nsize_px = [100, 100]\n", "only one of corners_px and size_px is given"),
        (PICTURES.replace("shape =", "form ="), "form"),
        (PICTURES.replace('shape = "ball"', 'shape = "orb"'), "'indenter.shape': must be 'ball', 'cylinder', 'cuboid'"),
        (PICTURES + "depth_uncertainty_mm = 0.1\n", "depth_uncertainty_mm is given without depth_mm"),
        (PICTURES + "extruded_mm = 5.0\n", 'extruded_mm is supported only for shape = "mesh", not for a ball'),
        (PRISM.replace("[scale]\nmm_per_px = 0.1\n", ""), "extruded_mm needs the outline of the contact in mm"),
        (PRISM.replace("b = [[20, 10], [60, 20], [40, 50]]", "b = [[20, 10], [60, 20]]"), r"outline_px.*at least 3"),
        (PICTURES.replace("file = \"rest.png\"", "far_pixels = true\nrepeat_file = 'x'"), "repeat_file is given"),
    ],
)  # fmt: skip
def test_recipes_that_contradict_themselves_are_refused(tmp_path, text, message):
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(ImportFormatError, match=message):
        read_recipe(str(tmp_path / "r.toml"))


def test_names_and_sizes_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(
        ImportFormatError,
        match="is neither the name of a recipe nor an existing file; give one of the recipes estimate-modulus",
    ):
        read_recipe("gelslim")
    with pytest.raises(ImportFormatError, match="no such folder or zip archive; give the folder that the recipe"):
        read_by_recipe(tmp_path / "nowhere", recipe(PICTURES))
    with pytest.raises(ImportFormatError, match=r"the ball's diameter must be above 0 .* got -1 mm"):
        with_sizes(recipe(PICTURES), -1.0, None)
    (tmp_path / "rest.png").write_bytes(b"no picture")
    save(tmp_path / "a.png", flat())
    with pytest.raises(ImportFormatError, match=r"rest\.png: is neither PNG nor JPEG"):
        read_by_recipe(tmp_path, recipe(PICTURES))
    save(tmp_path / "rest.png", flat((60, 80)))
    with pytest.raises(ImportFormatError, match=r"different sizes \(160 x 120, 80 x 60 px\)"):
        read_by_recipe(tmp_path, recipe(PICTURES))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"RIFF\0\0\0\0WAVE", "cannot be decoded as a video; convert the video with 'ffmpeg"),
        (b"RIFF\x04\0\0\0AVI ", "has 0 frames"),
        (b"RIFF\x10\0\0\0AVI 00dc\x04\0\0\0abcd", "cannot be decoded as a video"),
    ],
)
def test_files_that_are_no_motion_jpeg_are_refused(tmp_path, content, message):
    (tmp_path / "example_data" / "2023-12-16").mkdir(parents=True)
    (tmp_path / "example_data" / "2023-12-16" / "golf_ball_1.avi").write_bytes(content)
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(tmp_path, shipped("estimate-modulus"))


def test_two_commands_lead_from_a_folder_to_scores(tmp_path, monkeypatch):
    write_fots(tmp_path / "fots")
    monkeypatch.chdir(tmp_path)
    said = succeed("import captures fots --recipe fots-gelsight --predict-from 3 --out set")
    assert "lacks a second image without contact" in said
    assert "finray compare set set" in said
    circles = read_circles(tmp_path / "set" / "circles.csv")
    assert (circles["0002"].circle.row_px, circles["0002"].circle.column_px) == PLACES[1]
    assert (tmp_path / "set" / "contacts.png").read_bytes().startswith(b"\x89PNG")
    press = read_record(tmp_path / "set" / "0002.press.json", SimulatedPress)
    assert "trained on 3 other presses: 0001, 0003, 0005" in press.notes
    made_of = {path.rsplit("/", 1)[-1] for path in press.provenance.input_sha256}
    assert made_of >= {"0001.png", "0002.png", "0003.png", "0005.png", "0000.png", "annotate.csv"}
    assert "0004.png" not in made_of
    assert finray("compare set set --out scores").status == 0
    summary = json.loads((tmp_path / "scores" / "summary.json").read_text())["record"]
    skills = {pair["name"]: pair["skill"]["estimate"] for pair in summary["pairs"]}
    assert skills.keys() == {"0002", "0004"}
    assert min(skills.values()) > 0.9
    # what was corrected by hand stands in the place of the table
    lines = (tmp_path / "set" / "circles.csv").read_text().replace("0002,60,45,20", "0002,61,45,21")
    (tmp_path / "mine.csv").write_text(lines)
    succeed("import captures fots --recipe fots-gelsight --circles mine.csv --out again")
    capture = read_record(tmp_path / "again" / "0002.capture.json", TactileCapture)
    assert (capture.contact_circle.column_px, capture.contact_circle.radius_px) == (61.0, 21.0)
    (tmp_path / "mine.csv").write_text("image,column_px,row_px,radius_px\n77,1,1,1\n")
    for words, message in (
        ("fots --recipe fots-gelsight --circles mine.csv", "77 is not a press of fots"),
        ("", "give FOLDER and --recipe NAME|FILE. The recipes that come with finray are estimate-modulus"),
        ("fots --recipe fots-gelsight --predict-from 5", "must be 1 to 4 for 5 presses"),
    ):
        failed = finray(f"import captures {words} --out no")
        assert failed.status == 2
        assert message in failed.err
    assert "fots-gelsight" in succeed("import captures --list")


def test_one_capture_at_a_time_is_in_memory(tmp_path):
    """Each is handed on and forgotten before the next is read; it is read again when it is asked for."""
    seen, alive = [], []

    def take(name, capture, files):
        gc.collect()
        alive.append(sum(ref() is not None for ref in seen))
        seen.append(weakref.ref(capture))
        assert {file.name for file in files} == {f"{name}.png", "0000.png", "annotate.csv"}

    found = read_by_recipe(write_fots(tmp_path / "f"), shipped("fots-gelsight"), take=take)
    assert (list(found.captures), len(found.captures)) == ([f"000{k}" for k in range(1, 6)], 5)
    assert max(alive) <= 1  # the one before, at most
    assert found.captures["0003"].contact_circle.row_px == PLACES[2][0]
    with pytest.raises(KeyError):
        found.captures["0099"]


def test_the_median_does_not_use_what_is_left_out(tmp_path):
    """Three dark pictures that the recipe leaves out would drag the median of six down."""
    folder = write_digit(tmp_path / "f")
    plain = shipped("fots-digit", ball=2 * BALL_PX / 21.09)
    for k in range(90, 99):
        save(folder / "mlp_calib" / "digit" / f"00{k}.png", 0.1 * flat())
    names = tuple(f"00{k}" for k in range(90, 99))
    chosen = plain.model_copy(update={"presses": plain.presses.model_copy(update={"leave_out": names})})
    found = read_by_recipe(folder, chosen)
    assert float(np.median(found.captures["0000"].no_contact)) == pytest.approx(float(np.median(flat())), abs=3.0)
    assert found.left_out["the recipe excludes it"] == list(names)


def test_a_median_of_an_even_number_is_rounded(tmp_path):
    """Halves that are cut off would darken the picture without contact by a quarter of a step on average."""
    folder = write_digit(tmp_path / "f")
    found = read_by_recipe(folder, shipped("fots-digit", ball=2 * BALL_PX / 21.09))
    files = sorted((folder / "mlp_calib" / "digit").glob("*.png"))
    pictures = [cv2.imread(str(file))[..., ::-1] for file in files if file.stem != "0001"]
    assert len(pictures) == 8
    difference = found.captures["0000"].no_contact - np.median(pictures, axis=0)
    assert np.isin(difference, [-0.5, 0.0, 0.5]).all()
    assert abs(difference.mean()) < 0.01  # by the rule of even numbers; cut off it is some -0.2


def test_the_source_of_a_circle_is_kept(tmp_path, monkeypatch):
    """Circles that were searched for stay searched for, also when they come back by --circles."""
    write_digit(tmp_path / "digit")
    monkeypatch.chdir(tmp_path)
    options = f"digit --recipe fots-digit --ball-diameter-mm {2 * BALL_PX / 21.09}"
    assert finray(f"import captures {options} --out set").status == 0
    lines = (tmp_path / "set" / "circles.csv").read_text().splitlines()
    assert lines[0] == "image,column_px,row_px,radius_px,source"
    assert all(line.endswith(",search") for line in lines[1:])
    (tmp_path / "mine.csv").write_text("\n".join([*lines[:2], "0002,60,45,20,label", *lines[3:]]))
    assert finray(f"import captures {options} --circles mine.csv --out again").status == 0
    told = [read_record(tmp_path / "again" / f"000{k}.capture.json", TactileCapture) for k in (0, 2)]
    assert [capture.contact_told_by for capture in told] == ["search", "label"]
    assert [any(part.what == "a drawn contact" for part in capture.missing) for capture in told] == [True, False]
    for column in ("source", "told_by"):  # the column's name now, and before
        (tmp_path / "mine.csv").write_text(f"image,column_px,row_px,radius_px,{column}\n0001,60,45,20,hearsay\n")
        failed = finray(f"import captures {options} --circles mine.csv --out no")
        assert f"mine.csv, line 2: {column} must be 'label' or 'search', got 'hearsay'" in failed.err


def test_presses_whose_names_give_one_file_name_are_all_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a b", "a+b", "a,b"):
        save(tmp_path / "set" / f"{name}.png", dome(60.0, 80.0))
    save(tmp_path / "set" / "rest.png", flat())
    (tmp_path / "mine.toml").write_text(PICTURES)
    succeed("import captures set --recipe mine.toml --out out")
    stored = sorted(path.name for path in (tmp_path / "out").glob("*.capture.json"))
    assert stored == ["a+b.capture.json", "a-b-2.capture.json", "a-b.capture.json"]
    names = {read_record(tmp_path / "out" / file, TactileCapture).name for file in stored}
    assert names == {"a b", "a+b", "a,b"}


def test_a_press_that_taught_is_not_predicted_under_another_name(tmp_path, monkeypatch):
    """0001 teaches; 0002 is the same picture."""
    folder = write_fots(tmp_path / "fots")
    presses = folder / "mlp_calib" / "gelsight"
    (presses / "0002.png").write_bytes((presses / "0001.png").read_bytes())
    monkeypatch.chdir(tmp_path)
    outcome = finray("import captures fots --recipe fots-gelsight --predict-from 1 --out set")
    assert outcome.status == 0
    assert "0002: has the same image as a training press of the table, so it is not predicted" in outcome.err
    assert sorted(p.name for p in (tmp_path / "set").glob("*.press.json")) == [f"000{k}.press.json" for k in (3, 4, 5)]
    captures = read_by_recipe(folder, shipped("fots-gelsight")).captures
    with pytest.raises(
        CompareError,
        match=r"0002: the table was trained on this contact image \(training presses: 0001\), so the table",
    ):
        predict_press(train_table([captures["0001"]]), captures["0002"])


def test_the_scale_that_the_user_gives_meets_the_check_length_too():
    plain = read_recipe("gs-sdk-edge")[0]
    given = with_sizes(plain, None, 0.5)
    assert given.scale.mm_per_px == 0.5
    assert (given.scale.check_length_mm, given.scale.check_length_px) == (
        plain.scale.check_length_mm, plain.scale.check_length_px,
    )  # fmt: skip
    assert given.scale.check_length_mm is not None


@pytest.mark.parametrize("factor", [1, 4, 7])
def test_a_circle_in_a_large_picture_is_found_in_small_ones(factor, monkeypatch):
    """Pictures of 160, 640 and 1120 px width: the same circle, and never more than 640 px are searched."""
    row, column = PLACES[2]
    small = np.clip(soft_dome(row, column, np.random.default_rng(3)), 0, 254)
    size = (SHAPE_PX[1] * factor, SHAPE_PX[0] * factor)
    images = [cv2.resize(image, size, interpolation=cv2.INTER_CUBIC) for image in (small, flat())]
    counts = [np.clip(np.rint(image), 0, 254).astype(np.uint16) for image in images]
    capture = TactileCapture(
        name="large", contact=counts[0], no_contact=counts[1], repeat_no_contact=None, layout="RGB",
        encoding="unknown", bit_depth=8, black_level_dn=0.0, exposure_s=None, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=None, depth_mm=None, position_mm=None), contact_circle=None,
        mm_per_px=None, source="closed form",
    )  # fmt: skip
    searched = []

    def spied(signal, *rest, **more):
        searched.append(signal.shape)
        return _coarse(signal, *rest, **more)

    monkeypatch.setattr(contact_place, "_coarse", spied)
    found = find_contact_circle(capture).circle
    assert max(max(shape[:2]) for shape in searched) <= 640
    radius = CONTACT_PX * factor
    assert abs(found.radius_px - radius) < 0.2 * radius
    assert np.hypot((found.row_px + 0.5) / factor - row, (found.column_px + 0.5) / factor - column) < 0.2 * CONTACT_PX


@pytest.mark.parametrize(
    ("shape", "radius_px", "ball_px"), [((240, 320), 60.0, 300.0), ((240, 320), 70.0, 270.0), ((720, 1300), 15.0, 25.0)]
)
def test_the_circle_of_a_ball_is_found_that_is_large_or_small_in_its_picture(shape, radius_px, ball_px):
    """Of more than the picture's height; and of so few pixels that blocks of three would show too few of them."""
    rng, (row, column) = np.random.default_rng(1), (shape[0] / 2.0, shape[1] / 2.0 + 20.0)
    y, x = np.indices(shape)
    slopes = np.stack([x - column, column - x, y - row], axis=-1) / ball_px
    tilted = 0.8 * np.where(np.hypot(x - column, y - row)[..., None] < radius_px, slopes, 0.0)
    images = [120.0 * (1.0 + change) + rng.normal(0.0, 1.0, (*shape, 3)) for change in (tilted, 0.0)]
    capture = TactileCapture(
        name="ball", contact=np.rint(images[0]).astype(np.uint16), no_contact=np.rint(images[1]).astype(np.uint16),
        repeat_no_contact=None, layout="RGB", encoding="unknown", bit_depth=8, black_level_dn=0.0, exposure_s=None,
        light_angle_deg=None, indenter=IndenterPose(shape="ball", radius_mm=None, depth_mm=None, position_mm=None),
        contact_circle=None, mm_per_px=None, source="closed form",
    )  # fmt: skip
    found = find_contact_circle(capture, ball_px).circle
    # as near as in the other tests; a rim that is smoothed over some pixels ends outside so small a circle
    assert np.hypot(found.row_px - row, found.column_px - column) < 0.2 * radius_px
    assert abs(found.radius_px - radius_px) < max(0.2 * radius_px, 8.0)


@pytest.mark.parametrize("made", ["white noise", "JPEG", "no noise"])
def test_a_picture_without_contact_has_no_circle(made):
    """Two pictures of one scene that differ by their noise alone; 20 of each kind, none with a circle."""
    rng = np.random.default_rng(7)

    def picture():
        image = np.clip(np.rint(flat() + (0.0 if made == "no noise" else rng.normal(0.0, 2.0, flat().shape))), 0, 255)
        if made == "JPEG":
            image = cv2.imdecode(cv2.imencode(".jpg", image.astype(np.uint8))[1], cv2.IMREAD_COLOR)
        return image.astype(np.uint16)

    for _ in range(1 if made == "no noise" else 20):
        capture = TactileCapture(
            name="nothing", contact=picture(), no_contact=picture(), repeat_no_contact=None, layout="RGB",
            encoding="unknown", bit_depth=8, black_level_dn=0.0, exposure_s=None, light_angle_deg=None,
            indenter=IndenterPose(shape="ball", radius_mm=None, depth_mm=None, position_mm=None), contact_circle=None,
            mm_per_px=None, source="made up",
        )  # fmt: skip
        with pytest.raises(CompareError, match="its picture changes with contact no more than noise does"):
            find_contact_circle(capture)


def test_an_outline_outside_the_image_has_no_distance(tmp_path):
    capture = read_by_recipe(write_fots(tmp_path / "f"), shipped("fots-gelsight")).captures["0001"]
    far = tuple(PlaceInImage(row_px=900.0 + k, column_px=900.0 - k * k) for k in range(3))
    moved = capture.model_copy(update={"contact_circle": None, "contact_outline": far})
    with pytest.raises(
        Exception, match="encloses no pixel of the image of 160 x 120 px; check whether rows and columns are exchanged"
    ):
        contact_distance(moved)
    assert contact_distance(capture.model_copy(update={"contact_circle": None})) is None


def test_a_prism_has_a_depth_of_each_press_and_is_written_as_a_solid(tmp_path):
    for name in ("a", "b", "rest"):
        save(tmp_path / f"{name}.png", flat() if name == "rest" else dome(60.0, 80.0))
    found = read_by_recipe(tmp_path, recipe(PRISM))
    poses = [capture.indenter for capture in found.captures.values()]
    assert [(p.depth_mm, p.depth_uncertainty_mm) for p in poses] == [(0.5, 0.05), (1.0, 0.05)]
    (tmp_path / "prism.stl").write_bytes(outline_solid_stl(found.captures["a"], 5.0))
    vertices, triangles = read_triangles(tmp_path / "prism.stl", "a prism")
    corners = vertices[triangles]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    # half of |40 x 10, 20 x 40| pixels; positive where facets look outwards
    assert volume == pytest.approx(0.5 * (40 * 40 - 20 * 10) * 0.01 * 5.0, rel=1e-6)
    # the picture's middle is the origin, its columns run along x, its rows against z
    np.testing.assert_allclose(corners[..., 0].min(), (20 - 79.5) * 0.1, rtol=1e-6)
    np.testing.assert_allclose(corners[..., 2].max(), -(10 - 59.5) * 0.1, rtol=1e-6)
    np.testing.assert_allclose((corners[..., 1].min(), corners[..., 1].max()), (0.0, 5.0))


@pytest.mark.parametrize("key", ["depth_mm = { a = 0.5, bb = 1.0 }", "depth_mm = { a = 0.5, b = 1.0, c = 2.0 }"])
def test_a_misspelt_press_is_refused_and_one_that_is_not_there_is_told(tmp_path, key):
    for name in ("a", "b", "rest"):
        save(tmp_path / f"{name}.png", flat() if name == "rest" else dome(60.0, 80.0))
    text = PRISM.replace("depth_mm = { a = 0.5, b = 1.0 }", key)
    if "bb" in key:
        named = r"indenter\.depth_mm names 'bb', but .* no such press, and the press 'b' is not named"
        with pytest.raises(ImportFormatError, match=named):
            read_by_recipe(tmp_path, recipe(text))
        return
    found = read_by_recipe(tmp_path, recipe(text.replace('leave_out = ["rest"]', 'leave_out = ["rest", "tset"]')))
    assert {why: names for why, names in found.left_out.items() if "no such press" in why} == {
        "indenter.depth_mm of the recipe names it, but the folder has no such press": ["c"],
        "presses.leave_out of the recipe names it, but the folder has no such press": ["tset"],
    }


def test_presses_are_in_the_order_of_their_whole_numbers_and_a_raised_digit_is_text(tmp_path):
    """\u00b2 counts as a digit for Python, but is no number."""
    for name in ("10\u00b2", "10", "9", "rest"):
        save(tmp_path / f"{name}.png", flat() if name == "rest" else dome(60.0, 80.0))
    found = read_by_recipe(tmp_path, recipe(PICTURES + "position_mm = 0.0\n"))
    assert list(found.captures) == ["9", "10", "10\u00b2"]


def test_a_press_at_the_base_of_the_pad_has_the_position_0(tmp_path):
    for name in ("a", "rest"):
        save(tmp_path / f"{name}.png", flat() if name == "rest" else dome(60.0, 80.0))
    found = read_by_recipe(tmp_path, recipe(PICTURES + "position_mm = 0.0\n"))
    assert found.captures["a"].indenter.position_mm == 0.0
    (tmp_path / "r.toml").write_text(PICTURES + "depth_mm = 0.0\n")
    with pytest.raises(ImportFormatError, match=r"depth_mm.* above 0"):
        read_recipe(str(tmp_path / "r.toml"))


def test_a_design_presses_that_prism_where_the_picture_shows_it(tmp_path):
    for name in ("a", "rest"):
        save(tmp_path / f"{name}.png", flat() if name == "rest" else dome(60.0, 80.0))
    capture = read_by_recipe(tmp_path, recipe(PRISM)).captures["a"]
    (tmp_path / "prism.stl").write_bytes(outline_solid_stl(capture, 5.0))
    (tmp_path / "d.toml").write_text(
        'kind = "sensor"\npreset = "gelsight-flat"\nname = "flat"\n[indenter]\nshape = "mesh"\nfile = "prism.stl"\n'
        "depth_mm = 0.5\nposition_mm = 10.0\n"
    )
    coat = pressed_coat(read_sensor(tmp_path / "d.toml"), tmp_path)
    sunk = coat.rest.height_mm - coat.pressed.height_mm
    x, z = np.meshgrid(coat.rest.x_mm, coat.rest.z_mm, indexing="ij")
    # the outline's corners are (20, 10), (60, 20), (40, 50) px: its middle is 40 px, 26.7 px
    middle = (40 - 79.5) * 0.1, 10.0 - (80 / 3 - 59.5) * 0.1
    inside = np.hypot(x - middle[0], z - middle[1]) < 0.5
    np.testing.assert_allclose(sunk[inside], 0.5, atol=1e-3)  # of the contact that the layer is solved for
    deep = sunk > 0.4
    assert (x[deep].mean(), z[deep].mean()) == pytest.approx(middle, abs=0.15)
