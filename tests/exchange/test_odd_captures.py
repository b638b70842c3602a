"""Folders as labs have them, with what is wrong in them: refused or told, never a number on another scale."""

import os
import struct
import sys
import tempfile
import tomllib
import unicodedata

import cv2
import numpy as np
import pytest

from data_schemas import ImportFormatError
from data_schemas.storage._array_files import parse_file
from finray_calib.exchange import Recipe, read_by_recipe, survey_folder
from finray_calib.exchange._set_files import ArrayFiles, map_of, orientation, pixels_of
from tests.command_line.running import finray, succeed
from tests.exchange.recipe_folders import BALLS, flat, grasp, repicture, save, turned_jpeg, write_lab, write_video

DEEP = "has 8 bits, colour, but .*{} has 16 bits, colour, so their values cannot be compared"


def read(folder, text=BALLS):
    """Read a folder by a recipe of a few lines."""
    return read_by_recipe(folder, Recipe.model_validate(tomllib.loads(text)))


def deep(image):
    return image.astype(np.uint16) * 257


def clear(image):
    alpha = np.full((*image.shape[:2], 1), 255, dtype=np.uint8)
    alpha[:40] = 0
    return np.concatenate([image, alpha], axis=2)


def opaque(image):
    return np.concatenate([image, np.full((*image.shape[:2], 1), 255, dtype=np.uint8)], axis=2)


def test_the_folder_without_a_fault_is_read_and_its_rest_is_no_press(tmp_path):
    found = read(write_lab(tmp_path / "f"))
    assert list(found.captures) == ["p0", "p1", "p2", "p3"]
    assert found.left_out == {"its image with contact equals the image without contact in every pixel": ["rest"]}


@pytest.mark.parametrize(
    ("change", "which", "message"),
    [
        (deep, "rest.png", DEEP.format("rest.png")),
        (deep, "p2.png", "p2.png has 16 bits, colour, .*rest.png has 8 bits, colour"),
        (
            lambda image: image[..., 1],
            "p*.png",
            "p0.png has 8 bits, grey, .*rest.png has 8 bits, colour.* map of depths",
        ),
        (clear, "p*.png", "p0.png: 33 % of its pixels are transparent.*, or render it opaque"),
        (lambda image: image[::2, ::2], "rest.png", r"different sizes \(160 x 120, 80 x 60 px\)"),
    ],
)
def test_pictures_that_mean_different_light_are_refused(tmp_path, change, which, message):
    folder = repicture(write_lab(tmp_path / "f"), change, which)
    with pytest.raises(ImportFormatError, match=message):
        read(folder)


@pytest.mark.parametrize(("change", "bits", "scale"), [(opaque, 8, 1), (deep, 16, 257), (lambda i: i[..., 1], 8, 1)])
def test_pictures_of_one_kind_keep_their_values(tmp_path, change, bits, scale):
    plain = read(write_lab(tmp_path / "plain")).captures["p1"]
    capture = read(repicture(write_lab(tmp_path / "f"), change)).captures["p1"]
    assert capture.bit_depth == bits
    np.testing.assert_array_equal(capture.contact[..., 1], plain.contact[..., 1].astype(int) * scale)


@pytest.mark.parametrize(("turned", "which"), [(6, "*.png"), (3, "rest.png")])
def test_pictures_that_viewers_turn_are_refused(tmp_path, turned, which):
    folder = write_lab(tmp_path / "f")
    repicture(folder, lambda image: turned_jpeg(image, 1), ending=".jpg")
    assert len(read(folder, BALLS.replace(".png", ".jpg")).captures) == 4
    repicture(folder, lambda image: turned_jpeg(image, turned), which.replace(".png", ".jpg"), ".jpg")
    with pytest.raises(ImportFormatError, match=rf"turned or mirrored \(EXIF orientation {turned}\)"):
        read(folder, BALLS.replace(".png", ".jpg"))


def test_marks_of_png_files_and_of_both_byte_orders_are_read():
    little = b"II*\0\x08\0\0\0" + struct.pack("<HHHIHH", 1, 0x0112, 3, 1, 8, 0)
    assert orientation(b"\x89PNG\r\n\x1a\n" + b"\0\0\0\x1aeXIf" + little) == 8
    assert orientation(b"\x89PNG\r\n\x1a\n") == 1
    assert orientation(b"\xff\xd8\xff\xe1\0\x10Exif\0\0XX") == 1


@pytest.mark.parametrize("prefix", [b"", b"Exif\0\0"])
def test_marks_of_webp_files_are_read(tmp_path, prefix):
    """The container's chunk is named EXIF and holds the bare TIFF; some writers keep the six bytes of JPEG before."""
    folder = write_lab(tmp_path / "f")
    repicture(folder, lambda image: image, ending=".webp")
    text = BALLS.replace(".png", ".webp")
    assert len(read(folder, text).captures) == 4
    exif = prefix + b"II*\0\x08\0\0\0" + struct.pack("<HHHIHHI", 1, 0x0112, 3, 1, 6, 0, 0)
    content = (folder / "rest.webp").read_bytes()
    body = content[12:] + b"EXIF" + struct.pack("<I", len(exif)) + exif
    (folder / "rest.webp").write_bytes(b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body)
    with pytest.raises(ImportFormatError, match="EXIF orientation 6"):
        read(folder, text)


def test_letters_of_two_parts_and_hidden_files_of_macos_are_read(tmp_path):
    names = ["Größe 1", "Öl über 2", "ball nr. 3", "ß 4"]
    folder = write_lab(tmp_path / "f", names)
    for path in list(folder.glob("*.png")):
        path.rename(folder / unicodedata.normalize("NFD", path.name))
    (folder / "._ß 4.png").write_bytes(b"\0\5\x16\7")
    found = read(folder)
    assert sorted(found.captures) == sorted(names)
    assert found.captures["Größe 1"].contact_circle is not None


@pytest.mark.parametrize(
    ("column", "value", "recipe", "message"),
    [
        ("depth", 0.00045, 'depth_mm = "depth"\n', r"median depth of 4 presses is 0\.00045 mm, .* columns_in = \"m\""),
        (
            "depth",
            450,
            'depth_mm = "depth"\n',
            r"450 mm, but ball diameter and contact circles give about 0\.458 mm.* = \"um\"",
        ),
        ("depth", -0.45, 'depth_mm = "depth"\n', r"is below 0 in the table, .* z = COLUMN.* \[indenter\.pose\]"),
        ("depth", 0, 'depth_mm = "depth"\n', r"its depth, from first touch, is 0 mm in the table, but must be above 0"),
        ("depth", "0,45", 'depth_mm = "depth"\n', r"depth of p0 must be a number, got '0,45'; write it with a decimal"),
        ("depth", "", 'depth_mm = "depth"\n', r"must be a number, got ''; .* name the press in presses\.leave_out"),
        ("d", -9, 'diameter_mm = "d"\n', r"its diameter is -9 mm in the table"),
    ],
)
def test_lengths_that_cannot_be_are_refused(tmp_path, column, value, recipe, message):
    text = BALLS.replace("diameter_mm = 9.2\n", recipe if "diameter" in recipe else f"diameter_mm = 9.2\n{recipe}")
    with pytest.raises(ImportFormatError, match=message):
        read(write_lab(tmp_path / "f", columns={column: value}), text)


@pytest.mark.parametrize(("unit", "value"), [("m", 0.00045), ("um", 450), ("cm", 0.045), ("mm", 0.45)])
def test_columns_may_be_in_other_units(tmp_path, unit, value):
    text = BALLS + f'depth_mm = "depth"\ncolumns_in = "{unit}"\n'
    found = read(write_lab(tmp_path / "f", columns={"depth": value}), text)
    assert found.captures["p0"].indenter.depth_mm == pytest.approx(0.45)
    assert found.captures["p0"].indenter.radius_mm == 4.6  # a number of the recipe itself is in mm


def test_depth_and_diameter_may_be_in_different_units(tmp_path):
    folder = write_lab(tmp_path / "f", columns={"depth": 0.00045, "d": 9.2})
    text = BALLS.replace("diameter_mm = 9.2\n", 'diameter_mm = "d"\ndepth_mm = "depth"\n')
    with pytest.raises(ImportFormatError, match=r'write columns_in = \{ depth_mm = "m" \} below'):
        read(folder, text)
    pose = read(folder, f'{text}columns_in = {{ depth_mm = "m" }}\n').captures["p0"].indenter
    assert (pose.depth_mm, pose.radius_mm) == pytest.approx((0.45, 4.6))
    with pytest.raises(
        ValueError,
        match=r"unit for position_mm, but \[indenter\] names columns only for dia",
    ):
        read(folder, f'{text}columns_in = {{ position_mm = "m" }}\n')


def test_depths_without_a_circle_are_held_against_what_gels_can_be(tmp_path):
    text = BALLS.split("[contact]")[0] + '[indenter]\nshape = "cuboid"\ndepth_mm = "depth"\nfile = "labels.csv"\n'
    text += 'press = "image"\n'
    assert read(write_lab(tmp_path / "good", columns={"depth": 0.8}), text).captures["p0"].indenter.depth_mm == 0.8
    with pytest.raises(ImportFormatError, match=r"0\.0008 mm, but 0\.01 to 30 mm are allowed.*columns_in = \"m\""):
        read(write_lab(tmp_path / "f", columns={"depth": 0.0008}), text)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "px_per_mm = 10.0",
            "mm_per_px = 10.0",
            r"a pixel is 10 mm wide, .* 1 mm .*perhaps px_per_mm = 10 was meant",
        ),
        ("px_per_mm = 10.0", "px_per_mm = 0.1", r"a pixel is 10 mm wide, .*perhaps mm_per_px = 0\.1 was meant"),
        ("9.2", "0.0092", r"larger than the ball's 0\.046 px"),
        ('"x", row_px = "y"', '"y", row_px = "x"', r"row and column seem to be exchanged\. .* presses change more"),
        ('"rest.png"', '"rest.png"\nrepeat_file = "rest.png"', r"are equal in every pixel"),
        (
            "[scale]",
            "[picture]\nfull_scale = 1.0\n[scale]",
            r"full_scale is supported only for OpenEXR images .* but p0\.png contains whole",
        ),
        ("9.2", '9.2\ncolumns_in = "m"', r"columns_in gives the unit of columns, but \[indenter\] names no columns"),
    ],
)
def test_a_recipe_with_one_number_wrong_is_refused(tmp_path, old, new, message):
    folder = write_lab(tmp_path / "f")
    with pytest.raises((ImportFormatError, ValueError), match=message):
        read(folder, BALLS.replace(old, new))


@pytest.mark.parametrize(
    ("full_scale", "message"),
    [(1.0, None), (0.01, r"100 % of its values lie above picture\.full_scale = 0\.01"), (65535.0, "fill only 0.2")],
)
def test_half_floats_are_read_by_a_full_scale_that_suits_them(tmp_path, full_scale, message):
    exr = pytest.importorskip("OpenEXR")
    folder = write_lab(tmp_path / "f")
    light = {}
    for path in sorted(folder.glob("*.png")):
        light[path.stem] = (cv2.imread(str(path))[..., ::-1] / 255.0 * 0.6).astype(np.float16)
        channels = {name: np.ascontiguousarray(light[path.stem][..., c]) for c, name in enumerate("RGB")}
        with exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, channels) as file:
            file.write(str(path.with_suffix(".exr")))
        path.unlink()
    text = BALLS.replace(".png", ".exr") + f'[picture]\nencoding = "linear"\nfull_scale = {full_scale}\n'
    if message is not None:
        with pytest.raises(ImportFormatError, match=message):
            read(folder, text)
        return
    capture = read(folder, text).captures["p1"]
    np.testing.assert_allclose(capture.contact / 65535.0, light["p1"].astype(float), atol=0.5 / 65535.0 + 1e-9)
    (folder / "rest.exr").unlink()
    save(folder / "rest.png", flat())
    with pytest.raises(
        ImportFormatError, match=r"full_scale is supported only for OpenEXR images .* but rest\.png contains"
    ):
        read(folder, text.replace("rest.exr", "rest.png"))


VIDEO = """\
name = "grasps"
what = "grasps of a ball"
[presses]
files = "{press}.avi"
[no_contact]
frames_before = 10
[indenter]
shape = "ball"
[force]
file = "{press}.csv"
column = "force"
"""


def with_dropped_frames(path, dropped):
    """A video of variable rate: chunks without content stand for frames that are shown again."""
    content = path.read_bytes()
    at, number, body = content.index(b"movi") + 4, 0, b""
    while at < len(content):
        stop = at + 8 + struct.unpack("<I", content[at + 4 : at + 8])[0]
        stop += stop % 2 != at % 2
        body += b"00dc\0\0\0\0" if number in dropped else content[at:stop]
        at, number = stop, number + 1
    movie = b"LIST" + struct.pack("<I", len(body) + 4) + b"movi" + body
    path.write_bytes(b"RIFF" + struct.pack("<I", len(movie) + 4) + b"AVI " + movie)


def test_a_video_with_dropped_frames_keeps_its_time(tmp_path):
    write_video(tmp_path / "g.avi", grasp())
    force = np.interp(np.arange(30), [12, 16, 24, 28], [0.0, 5.0, 5.0, 0.0])
    (tmp_path / "g.csv").write_text("force\n" + "".join(f"{f}\n" for f in force))
    whole = read(tmp_path, VIDEO).captures["g"]
    with_dropped_frames(tmp_path / "g.avi", {2, 3, 4, 5})
    found = read(tmp_path, VIDEO).captures["g"]
    np.testing.assert_array_equal(found.contact, whole.contact)
    np.testing.assert_array_equal(found.repeat_no_contact, whole.repeat_no_contact)
    assert found.force_n == whole.force_n == pytest.approx(5.0)


def test_frames_that_already_show_contact_are_no_rest(tmp_path):
    write_video(tmp_path / "g.avi", grasp())
    text = VIDEO.split("[force]")[0].replace("frames_before = 10", "frames_before = 16")
    with pytest.raises(ImportFormatError, match="shows contact within the first 16 frames"):
        read(tmp_path, text)
    (tmp_path / "g.mp4").write_bytes((tmp_path / "g.avi").read_bytes())
    # the frames decide what a video is, not its name
    assert len(read(tmp_path, VIDEO.split("[force]")[0].replace(".avi", ".mp4")).captures) == 1


@pytest.mark.parametrize("noise_dn", [1.0, 3.0])
def test_noise_and_one_wrong_force_are_no_early_contact(tmp_path, noise_dn):
    """The mean change from the first frame is a noise floor that small contacts do not pass three times over."""
    rng = np.random.default_rng(1)
    frames = [np.clip(f + rng.normal(0.0, noise_dn, f.shape), 0, 255).round().astype(np.uint8) for f in grasp()]
    write_video(tmp_path / "g.avi", frames)
    found = read(tmp_path, VIDEO.split("[force]")[0]).captures["g"]
    assert found.contact_circle is not None or found.contact is not None
    force = np.interp(np.arange(len(frames)), [12, 16, 24, 28], [0.0, 5.0, 5.0, 0.0])
    force[4] = 2.0
    (tmp_path / "g.csv").write_text("force\n" + "\n".join(f"{f:.3f}" for f in force) + "\n")
    assert read(tmp_path, VIDEO).captures["g"].force_n == pytest.approx(5.0)
    with pytest.raises(ImportFormatError, match="shows contact within the first 17 frames"):
        read(tmp_path, VIDEO.split("[force]")[0].replace("frames_before = 10", "frames_before = 17"))


def test_names_of_a_recipe_may_have_letters_in_two_parts(tmp_path):
    """As they are copied from a file manager of macOS."""
    folder = write_lab(tmp_path / "f", ["Größe 1", "Öl über 2"])
    text = BALLS.replace("[no_contact]", 'leave_out = ["Größe 1"]\n[no_contact]')
    assert sorted(read(folder, unicodedata.normalize("NFD", text)).captures) == ["Öl über 2"]


def test_names_that_only_leaves_out_are_not_misspelt(tmp_path):
    folder = write_lab(tmp_path / "f")
    text = BALLS.replace("[no_contact]", 'only = "p[01]"\n[no_contact]')
    text = text.rstrip() + "\n"
    assert len(read(folder, text + "depth_mm = { p0 = 0.5, p2 = 0.4, p3 = 0.4 }\n").captures) == 2


def test_a_repeat_that_is_the_contact_is_refused(tmp_path):
    folder = write_lab(tmp_path / "f")
    with pytest.raises(ImportFormatError, match="repeat_file of p0 equals the image with contact"):
        read(folder, BALLS.replace('"rest.png"', '"rest.png"\nrepeat_file = "{press}.png"'))


def test_what_some_presses_lack_is_told_with_their_number(tmp_path, monkeypatch):
    """Before, what the first press had counted for all."""
    folder = write_lab(tmp_path / "f")
    (tmp_path / "r.toml").write_text(BALLS + "depth_mm = { p0 = 0.5, p2 = 0.4 }\n")
    monkeypatch.chdir(tmp_path)
    said = succeed(f"import captures {folder} --recipe r.toml --out set")
    assert "lacks the depth of the press (2 of 4 presses: p1, p3): simulate to the contact's size instead" in said
    assert "lacks the force: stiffness" in said


def test_a_stack_and_a_map_of_a_turned_tiff_are_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tag = [(0x0112, "H", 1, 6, True)]
    tifffile.imwrite(tmp_path / "t.tif", np.zeros((48, 64, 3), np.uint8), photometric="rgb", extratags=tag)
    tifffile.imwrite(tmp_path / "m.tif", np.zeros((48, 64), np.float32), extratags=tag)
    with pytest.raises(ImportFormatError, match="orientation 6"):
        pixels_of(tmp_path / "t.tif::[0]")
    with pytest.raises(ImportFormatError, match="orientation 6"):
        map_of(tmp_path / "m.tif", ArrayFiles())


def test_a_map_of_one_channel_with_nan_is_not_called_colours(tmp_path):
    np.save(tmp_path / "m.npy", np.array([[[np.nan], [1.0]], [[2.0], [3.0]]]))
    with pytest.raises(ImportFormatError, match="25 % of its values are NaN or infinite"):
        map_of(tmp_path / "m.npy", ArrayFiles())


@pytest.mark.parametrize("inner", ["set.npz::a/rest.png", "set.npz::rest.png"])
def test_a_link_behind_the_mark_of_an_array_does_not_lead_out(tmp_path, inner):
    folder = write_lab(tmp_path / "f")
    save(tmp_path / "outside.png", flat())
    (folder / inner).parent.mkdir(exist_ok=True)
    (folder / inner).symlink_to(tmp_path / "outside.png")
    with pytest.raises(ImportFormatError, match="points outside the folder"):
        read(folder, BALLS.replace('"rest.png"', f'"{inner}"'))


def test_names_with_a_number_sign_are_surveyed(tmp_path):
    folder = write_lab(tmp_path / "f", ["p#", "p1", "p2", "p3"])
    assert survey_folder(folder).lines[0].startswith("3 x p{press}.png: picture of ")


def test_what_a_missing_package_reads_is_told_in_a_survey(tmp_path, monkeypatch):
    folder = write_lab(tmp_path / "f")
    (folder / "light.exr").write_bytes(b"any")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    told = survey_folder(folder).lines
    assert any(line.startswith("1 x light.exr: OpenEXR images need the OpenEXR package") for line in told)
    assert any("picture of " in line for line in told)


def test_a_table_in_a_text_file_is_surveyed_as_a_table_and_numbers_as_numbers(tmp_path):
    folder = write_lab(tmp_path / "f")
    (folder / "log.txt").write_text("press\tforce_n\np1\t1.5\np2\t2.5\n")
    (folder / "plain.txt").write_text("1.5 -2\n3 4\n")
    told = survey_folder(folder).lines
    assert "1 x log.txt: table of 2 lines: press, force_n" in told
    assert "1 x plain.txt: numbers without names: 2 x 2" in told


def test_odd_names_write_no_lines_of_their_own_into_a_recipe(tmp_path):
    folder = write_lab(tmp_path / "f", ["p😀_1", "p😀_2", "p😀_3", "p😀_4"])
    for name in (b"x\nforce = 1\n.png", b"\xff1.png"):
        (tmp_path / "plain").write_bytes(b"none")
        os.rename(tmp_path / "plain", os.path.join(os.fsencode(folder), name))
    found = survey_folder(folder)
    tables = tomllib.loads(found.recipe.encode().decode())
    assert "force" not in found.recipe.replace("\\nforce", "")
    assert all(line.isprintable() for line in found.lines)
    assert tables["presses"]["files"] == "p😀_{press}.png"


@pytest.mark.parametrize(
    ("press", "before", "after", "expected"),
    [
        ("p{}.png", "p{}_pre.png", "p{}_post.png", ("p{press}.png", "p{press}_pre.png", "p{press}_post.png")),
        ("p{}_touch.png", "p{}_free.png", None, ("p{press}_touch.png", "p{press}_free.png", None)),
        ("p{}_post.png", "p{}_pre.png", None, ("p{press}_post.png", "p{press}_pre.png", None)),
        ("p{}/on.png", "p{}/before.png", "p{}/after.png", ("p{press}/on.png", "p{press}/before.png",
                                                           "p{press}/after.png")),
    ],
)  # fmt: skip
def test_pictures_before_and_after_a_press_are_those_without_contact(tmp_path, press, before, after, expected):
    rng = np.random.default_rng(0)
    for k in range(12):  # numbers of one and of two digits
        save(tmp_path / press.format(k), grasp()[20])
        for name in filter(None, (before, after)):
            save(tmp_path / name.format(k), flat() + rng.integers(0, 2, flat().shape))
    found = Recipe.model_validate(tomllib.loads(survey_folder(tmp_path).recipe))
    assert (found.presses.files, found.no_contact.file, found.no_contact.repeat_file) == expected
    captures = read_by_recipe(tmp_path, found.model_copy(update={"contact": None})).captures
    assert list(captures) == [str(k) for k in range(12)]
    assert all((c.repeat_no_contact is None) == (after is None) for c in captures.values())


def test_a_folder_without_pictures_begins_no_recipe(tmp_path, monkeypatch):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "forces.csv").write_text("press,force\n1,2\n")
    (tmp_path / "set" / "notes.pdf").write_bytes(b"none")
    monkeypatch.chdir(tmp_path)
    failed = finray("import captures set")
    assert failed.status == 2
    assert "set: contains no picture, video or array (.png, " in failed.err
    assert "but 1 x forces.csv, 1 x notes.pdf; give the folder" in failed.err
    assert not (tmp_path / "set.recipe.toml").exists()


def test_contacts_by_outline_leave_no_empty_table_of_circles(tmp_path, monkeypatch):
    write_lab(tmp_path / "set")
    circle = 'file = "labels.csv"\npress = "image"\ncircle = { column_px = "x", row_px = "y", radius_px = "r" }'
    assert circle in BALLS
    (tmp_path / "r.toml").write_text(BALLS.replace(circle, 'search = "outline"'))
    monkeypatch.chdir(tmp_path)
    outcome = finray("import captures set --recipe r.toml --out found")
    assert outcome.status == 0
    assert "circles.csv is not written, because no press has a circle" in outcome.out
    assert "found/contacts.png, give the corners of wrong ones as outline_px below [contact]" in outcome.err
    assert not (tmp_path / "found" / "circles.csv").exists()


def where_files_go(content, where):
    """A parser that says where it would write."""
    return tempfile.gettempdir(), {}


def test_what_a_parser_writes_lies_where_its_parent_removes_it(tmp_path):
    before = tempfile.gettempdir()
    (tmp_path / "content").write_bytes(b"")
    answer = parse_file(f"{__name__}:where_files_go", str(tmp_path), "f")
    assert answer["value"] == str(tmp_path)
    assert tempfile.gettempdir() == before
