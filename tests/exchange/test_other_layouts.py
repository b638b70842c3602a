"""Sets and renders as laboratories store them: each is read, or refused in words that tell what to do."""

import json
import re
import tomllib
from functools import partial

import cv2
import numpy as np
import pytest

from data_schemas import CompareError, ContactCircle, ImportFormatError
from finray_calib.compare import compare_press
from finray_calib.exchange import Recipe, read_by_recipe, read_renders
from finray_calib.sensing import vote_on_circles
from tests.exchange.ball_press_folders import eight_bits
from tests.exchange.recipe_folders import CONTACT_PX, PLACES, dome, flat, grasp, write_video

PRESSES, UNTOUCHED = [eight_bits(dome(*place)) for place in PLACES], eight_bits(flat())
SIXTEEN = np.uint16(257)


def same(image):
    return image


def twelve_bits(image):
    return image.astype(np.uint16) * np.uint16(16)


def opaque(image):
    return np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])


def bordered(image, margin_px):
    return np.pad(image, ((margin_px, margin_px), (margin_px, margin_px), (0, 0)))


def put(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, image)
    elif path.suffix == ".heic":  # nothing here writes one
        path.write_bytes(b"\0\0\0\x18ftypheic")
    else:
        order = [2, 1, 0, 3][: image.shape[2]] if image.ndim == 3 else slice(None)
        assert cv2.imwrite(str(path), np.ascontiguousarray(image[..., order] if image.ndim == 3 else image))


def set_of(folder, files, rest, change=same, rest_change=None):
    """A folder whose presses and images without contact have these names, and labels by the stem of their files."""
    lines = ["file,x,y,r"]
    for k, (image, (row, column)) in enumerate(zip(PRESSES, PLACES, strict=True), start=1):
        name = files.format(k)
        put(folder / name, change(image))
        put(folder / rest.format(k), (rest_change or change)(UNTOUCHED))
        lines.append(f"{name.rsplit('/', 1)[-1].rsplit('.', 1)[0]},{column},{row},{CONTACT_PX}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n")
    return folder


def recipe_of(files, rest, **picture):
    circle = {"column_px": "x", "row_px": "y", "radius_px": "r"}
    return Recipe.model_validate(
        {
            "name": "t", "what": "t", "presses": {"files": files}, "no_contact": {"file": rest}, "picture": picture,
            "contact": {"file": "labels.csv", "press": "file", "circle": circle}, "indenter": {"shape": "ball"},
        }
    )  # fmt: skip


def assert_same_picture(found, image, name):
    """Equal to the last count; JPEG blurs the colours at edges, and a picture in another order would be 30 off."""
    if name.lower().endswith(".jpg"):
        assert np.abs(found.astype(float) - image).mean() < 2.0
    else:
        np.testing.assert_allclose(found, image, atol=1e-4)


@pytest.mark.parametrize(
    ("files", "rest", "change", "picture", "names", "bits"),
    [
        ("press {}.JPG", "no contact.JPG", same, {}, "press {press}.JPG", 8),
        ("p{}.png", "rest.png", same, {}, "p{press}.png", 8),
        ("p{}.png", "rest.png", opaque, {}, "p{press}.png", 8),
        ("p{}.png", "rest.png", twelve_bits, {"bit_depth": 12}, "p{press}.png", 12),
        ("p{}.npy", "rest.npy", same, {"channels": "RGB"}, "p{press}.npy", 8),
        ("p{}.tif", "rest.tiff", same, {}, "p{press}.tif", 8),
        ("p{}.tif", "rest.tif", twelve_bits, {"bit_depth": 12}, "p{press}.tif", 12),
        ("p{}.bmp", "rest.bmp", same, {}, "p{press}.bmp", 8),
        ("p{}.webp", "rest.webp", same, {}, "p{press}.webp", 8),
        ("a ball/p{}.png", "a ball/rest.png", same, {}, "{press}.png", 8),
    ],
)
def test_layouts_that_are_read(tmp_path, files, rest, change, picture, names, bits):
    folder = set_of(tmp_path / "set", files, rest, change)
    rest_pattern = "{group}/rest.png" if rest.startswith("a ball/") else rest
    recipe = recipe_of(names, rest_pattern, **picture)
    if names == "{press}.png":
        recipe = recipe.model_copy(
            update={"presses": recipe.presses.model_copy(update={"leave_out": ("a ball/rest",)})}
        )
    found = read_by_recipe(folder, recipe).captures
    assert len(found) == 5
    for capture, image, (row, column) in zip(found.values(), PRESSES, PLACES, strict=True):
        circle = capture.contact_circle
        assert (circle.row_px, circle.column_px, capture.bit_depth) == (row, column, bits)
        assert_same_picture(capture.contact, change(image)[..., :3], files)


@pytest.mark.parametrize(
    ("files", "names", "rest", "message"),
    [
        (
            "p{}.PNG",
            "p{press}.png",
            "rest.PNG",
            r"upper and lower case count\); the folder holds, for example, .*p[1-5]\.PNG",
        ),
        (
            "p{}.bmp",
            "p{press}.bmp",
            "rest.heic",
            r"rest\.heic: is neither .* such as with 'mogrify -format png \*\.heic'",
        ),
        ("p{}.npy", "p{press}.npy", "rest.npy", r'does not state the order of its channels; write channels = "RGB"'),
    ],
)
def test_layouts_that_are_refused(tmp_path, files, names, rest, message):
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(set_of(tmp_path / "set", files, rest), recipe_of(names, rest))


@pytest.fixture
def captures(tmp_path):
    return dict(read_by_recipe(set_of(tmp_path / "set", "{}.png", "rest.png"), recipe_of("{press}.png", "rest.png",
                )).captures)  # fmt: skip


def renders_of(folder, ending=".png", change=same, common=False):
    for k, image in enumerate(PRESSES, start=1):
        put(folder / f"{k}" / f"contact{ending}", change(image))
        put(folder / ("" if common else f"{k}") / f"no_contact{ending}", change(UNTOUCHED))
    return folder


@pytest.mark.parametrize(
    ("change", "common", "ending"),
    [(same, True, ".png"), (same, False, ".PNG"), (same, False, ".jpg"), (opaque, False, ".png"),
     (lambda image: image * SIXTEEN, False, ".png")],
)  # fmt: skip
def test_renders_that_are_read(tmp_path, captures, change, common, ending):
    found = read_renders(renders_of(tmp_path / "r", ending, change, common), captures)
    assert found.keys() == {"1", "2", "3", "4", "5"}
    for image, press in zip(PRESSES, found.values(), strict=True):
        assert_same_picture(press.contact, image, ending)
        assert_same_picture(press.no_contact, UNTOUCHED, ending)


def test_renders_that_do_not_fit_their_captures_are_refused_with_what_to_do(tmp_path, captures):
    deep = {name: c.model_copy(update={"bit_depth": 16}) for name, c in captures.items()}
    for change, of, message in (
        (lambda image: image[::2, ::2], captures, r"the images are 80 x 60 px, but the capture 1 has 160 x 120 px"),
        (same, deep, r"has 8 bits, but the capture has 16; write pictures of 16 bits"),
        (
            same,
            {f"press {k}": c for k, c in captures.items()},
            r"such as 1.* the name of a capture.*\(press 1, press 2, ",
        ),
    ):
        folder = renders_of(tmp_path / message[:9], change=change)
        with pytest.raises(ImportFormatError, match=message):
            read_renders(folder, of)


def bayer(capture):
    """The capture as a sensor of twice the side counts it, in linear light."""
    planes = {}
    for what in ("contact", "no_contact"):
        image = getattr(capture, what)
        planes[what] = np.zeros((2 * image.shape[0], 2 * image.shape[1], 1), np.uint16)
        for (row, column), channel in {(0, 0): 0, (0, 1): 1, (1, 0): 1, (1, 1): 2}.items():
            planes[what][row::2, column::2, 0] = image[..., channel]
    circle = capture.contact_circle
    larger = ContactCircle(
        row_px=2 * circle.row_px + 0.5, column_px=2 * circle.column_px + 0.5, radius_px=2 * circle.radius_px
    )
    return capture.model_copy(update={**planes, "layout": "Bayer RGGB", "encoding": "linear", "contact_circle": larger})


def test_a_render_has_the_size_in_which_a_capture_of_bayer_counts_is_compared(tmp_path, captures):
    counted = {name: bayer(capture) for name, capture in captures.items()}
    folder = renders_of(tmp_path / "r")
    for k in counted:
        (folder / k / "render.json").write_text('{"encoding": "linear"}')
    found = read_renders(folder, counted)["1"]
    assert compare_press(found, counted["1"], seed=1).headline_skill.estimate > 0.99
    with pytest.raises(ImportFormatError, match=r"images are 320 x 240 px, but the capture 1 has 160 x 120 px"):
        read_renders(renders_of(tmp_path / "full", change=lambda image: image.repeat(2, 0).repeat(2, 1)), counted)


def times(images, factor, **fields):
    """A render or capture whose values are so many times as large."""
    kind = images.contact.dtype
    scaled = {what: (getattr(images, what) * float(factor)).astype(kind) for what in ("contact", "no_contact")}
    return images.model_copy(update={**scaled, **fields})


@pytest.mark.parametrize(
    ("of_render", "of_capture", "bits", "is_compared"),
    [
        (1, 1, 8, True),
        (16, 16, 12, True),
        # a render in the units of the capture, and dim: its brightest part is at 178 of 4095
        (1, 5, 12, True),
        # 9.8 times too bright is to be scored, and so is 9.8 times too dim
        (1, 1 / 9.8, 8, True),
        (1 / 9.8, 1, 8, True),
        # a perfect render of 8 bits had a skill of -43 beside its capture of 16 bits, without a word
        (1, 4, 10, False),
        (1, 16, 12, False),
        (1, 257, 16, False),
        (257, 64, 14, False),
        (257, 16, 12, False),
        (257, 1, 8, False),
        (1 / 255, 1, 8, False),
        (1 / 255, 257, 16, False),
    ],
)
def test_encoded_values_on_two_scales_are_not_compared(tmp_path, captures, of_render, of_capture, bits, is_compared):
    press = times(read_renders(renders_of(tmp_path / "r"), captures)["1"], of_render)
    capture = times(captures["1"], of_capture, bit_depth=bits)
    if is_compared:
        assert np.isfinite(compare_press(press, capture, seed=1).headline_skill.estimate)
        return
    with pytest.raises(
        CompareError, match=rf"at [\d.e+-]+, but those of 1 are at .*; write the render .* have {bits} bits"
    ):
        compare_press(press, capture, seed=1)


def test_images_that_are_black_without_contact_are_compared(tmp_path, captures):
    press, capture = read_renders(renders_of(tmp_path / "r"), captures)["1"], captures["1"]
    change = np.maximum(press.contact - press.no_contact, 0.0)
    dark = press.model_copy(update={"contact": change, "no_contact": np.zeros_like(change)})
    seen = np.minimum(change + 2.0, 255.0).astype(np.uint16)
    lit = capture.model_copy(update={"contact": seen, "no_contact": np.full_like(seen, 2)})
    # the 2 DN that the render lacks are an error, and no other scale
    assert 0.5 < compare_press(dark, lit, seed=1).headline_skill.estimate < 1.0


def grey(image):
    return image[..., 1]


def test_a_grey_render_is_compared_with_light_that_is_white_up_to_noise_but_not_with_colours(tmp_path, captures):
    found = read_renders(renders_of(tmp_path / "r", change=grey), captures)["1"]
    with pytest.raises(CompareError, match=r"1 is grey, but the capture 1 has colours; render in colour"):
        compare_press(found, captures["1"], seed=1)
    unchanged = found.model_copy(update={"contact": found.no_contact})
    assert compare_press(unchanged, captures["1"], seed=1).headline_skill.estimate == pytest.approx(0.0, abs=1e-9)
    rng = np.random.default_rng(1)
    white = {}
    for what in ("contact", "no_contact"):
        image = getattr(captures["1"], what)[..., 1:2].astype(int)
        white[what] = np.clip(image + rng.integers(-1, 2, (*image.shape[:2], 3)), 0, 255).astype(np.uint16)
    assert compare_press(found, captures["1"].model_copy(update=white), seed=1).headline_skill.estimate > 0.9


@pytest.mark.parametrize(
    ("rest_change", "kind"), [(grey, "8 bits, grey"), (twelve_bits, "16 bits, colour")], ids=["grey", "16 bits"]
)
def test_a_render_whose_two_images_differ_in_kind_is_refused(tmp_path, captures, rest_change, kind):
    folder = renders_of(tmp_path / "r")
    put(folder / "1" / "no_contact.png", rest_change(UNTOUCHED))
    with pytest.raises(ImportFormatError, match=rf"contact.png has 8 bits, colour, .*no_contact.png has {kind}, so"):
        read_renders(folder, captures)


def test_a_line_that_calls_by_what_all_presses_have_in_common_names_none(tmp_path):
    for k, image in enumerate(PRESSES, start=1):
        put(tmp_path / f"{k}" / "image.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    recipe = recipe_of("{press}/image.png", "rest.png")
    for called in ("image", "image.png"):
        (tmp_path / "labels.csv").write_text(f"file,x,y,r\n{called},80,60,20\n")
        with pytest.raises(ImportFormatError, match=r"none of the 5 presses .*: no row of labels.csv names this press"):
            read_by_recipe(tmp_path, recipe)
    (tmp_path / "labels.csv").write_text("file,x,y,r\n1/image.png,80,60,20\n/elsewhere/2,80,60,20\n")
    assert list(read_by_recipe(tmp_path, recipe).captures) == ["1", "2"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (same, r"picture.bit_depth = 12 is supported only for 16-bit pictures, but p1.png is not a 16-bit picture"),
        (
            lambda image: image * SIXTEEN,
            r"png: its largest value is \d{5}, but .* = 12 allows at most 4095; .* by 16,",
        ),
    ],
    ids=["8 bits", "left-aligned"],
)
def test_counts_that_are_not_of_the_stated_bits_are_refused(tmp_path, change, message):
    folder = set_of(tmp_path, "p{}.png", "rest.png", change)
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(folder, recipe_of("p{press}.png", "rest.png", bit_depth=12))


def test_two_files_of_one_press_are_refused(tmp_path):
    folder = set_of(tmp_path, "p{}.png", "rest.png")
    put(folder / "p1.jpg", PRESSES[1])
    with pytest.raises(ImportFormatError, match=r"p1\.(png|jpg) and p1\.(png|jpg) are both press '1' by presses.files"):
        read_by_recipe(folder, recipe_of("p{press}.*", "rest.png"))


ARRANGED = {
    "row and column": lambda row, column: (column, row),
    "left and right": lambda row, column: (row, 159 - column),
    "top and bottom": lambda row, column: (119 - row, column),
    "left and right as well as top and bottom": lambda row, column: (119 - row, 159 - column),
}


@pytest.mark.parametrize("margin_px", [0, 24], ids=["whole picture", "gel in a picture"])
@pytest.mark.parametrize("exchanged", ARRANGED)
def test_labels_of_pictures_that_are_arranged_otherwise_are_refused_and_the_remedy_reads_them(
    tmp_path, exchanged, margin_px
):
    folder = set_of(tmp_path / "set", "p{}.png", "rest.png", partial(bordered, margin_px=margin_px))
    of_right = [(40.0, 50.0), (35.0, 110.0), (90.0, 120.0), (85.0, 30.0), (30.0, 70.0)]
    lines = ["file,x,y,r"]
    for k, place in enumerate(of_right, start=1):
        put(folder / f"p{k}.png", bordered(eight_bits(dome(*place)), margin_px))
        row, column = ARRANGED[exchanged](*place)
        lines.append(f"p{k},{column},{row},{CONTACT_PX}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n")
    near, right, bottom = margin_px, margin_px + 159, margin_px + 119
    of_gel = {"corners_px": [(near, near), (right, near), (near, bottom), (right, bottom)], "size_px": (160, 120)}
    with pytest.raises(ImportFormatError, match=rf"{exchanged} seem to be exchanged") as why:
        read_by_recipe(folder, recipe_of("p{press}.png", "rest.png", **(of_gel if margin_px else {})))
    if exchanged == "row and column":
        assert "exchange column_px and row_px" in str(why.value)
        return
    corners, size = re.search(r"corners_px = (\[\[.*\]\]) and size_px = (\[.*?\])", str(why.value)).groups()
    turned = recipe_of("p{press}.png", "rest.png", corners_px=json.loads(corners), size_px=json.loads(size))
    for capture, place in zip(read_by_recipe(folder, turned).captures.values(), of_right, strict=True):
        rows, columns = (slice(None, None, -1 if what in exchanged else 1) for what in ("top", "left"))
        assert_same_picture(capture.contact, eight_bits(dome(*place))[rows, columns], "p.png")


RIGHT_PLACES = [(40.0, 50.0), (35.0, 110.0), (90.0, 120.0), (85.0, 30.0), (30.0, 58.0)]


def labelled_set(folder, mirrored):
    """Five presses, those of these numbers with labels that are mirrored left and right."""
    set_of(folder, "p{}.png", "rest.png")
    lines = ["file,x,y,r"]
    for k, (row, column) in enumerate(RIGHT_PLACES, start=1):
        put(folder / f"p{k}.png", eight_bits(dome(row, column)))
        lines.append(f"p{k},{159 - column if k in mirrored else column},{row},{CONTACT_PX}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_the_majority_of_the_presses_decides_whether_labels_are_mirrored(tmp_path):
    recipe = recipe_of("p{press}.png", "rest.png")
    with pytest.raises(
        ImportFormatError,
        match=r"left and right seem to be exchanged\. 4 of 5 presses .*, and 1 change more at the circle as",
    ):
        read_by_recipe(labelled_set(tmp_path / "four", {1, 2, 3, 4}), recipe)
    # the median of three presses, two of them with wrong labels of their own, does not refuse a set that may be right
    found = read_by_recipe(labelled_set(tmp_path / "two", {1, 2}), recipe).captures
    odd = {name for name, c in found.items() if any(part.what == "a circle on the contact" for part in c.missing)}
    assert odd == {"1", "2"}
    assert any(
        re.search(r"1 changes \d.* with left and right exchanged: correct", part.lost) for part in found["1"].missing
    )


def test_presses_that_show_nothing_do_not_say_that_labels_are_right(tmp_path):
    """Noise alone has as much in both places, and none more than anywhere: it counted as a change where it is said."""
    folder = labelled_set(tmp_path / "set", {1, 2, 3, 4, 5})
    rng = np.random.default_rng(0)
    for path in sorted(folder.glob("p*.png"))[:2]:
        put(path, np.clip(np.rint(UNTOUCHED + rng.normal(0.0, 1.0, UNTOUCHED.shape)), 0, 255).astype(np.uint8))
    with pytest.raises(
        ImportFormatError,
        match=r"left and right seem to be exchanged\. 3 of 3 presses .*, and 0 change more at the circle as",
    ):
        read_by_recipe(folder, recipe_of("p{press}.png", "rest.png"))


@pytest.mark.parametrize(
    ("ratios", "told"),
    [
        # a few odd ones among many that change as much in both places
        ([3.0] * 3 + [1.0] * 497, None),
        ([3.0] * 3 + [0.9] * 20, None),
        # as many as of a real set (9 against, 3 for, of 42), whose labels were mirrored
        ([3.0] * 9 + [1.0] * 30 + [0.5] * 3, (12, 9, 3, 3.0)),
        # those near the mirror axis say nothing
        ([2.0, 3.0, 4.0] + [None] * 497, (3, 3, 0, 3.0)),
        ([2.0, 3.0, 4.0, 1.0, 1.0, 1.0, 1.0], (3, 3, 0, 3.0)),
    ],
)
def test_a_few_odd_presses_among_many_undecided_do_not_refuse_a_set(ratios, told):
    vote = vote_on_circles([{} if r is None else {"left and right": r} for r in ratios])
    assert (vote and (vote.presses, vote.against, vote.right, vote.median_ratio)) == told


LABELLED = """
[contact]
file = "{press}.json"
circle = { column_px = "contact.x", row_px = "contact.y", radius_px = "r[0]" }

[force]
file = "FORCE"
column = "Fz"
factor = 1e-3
"""


@pytest.mark.parametrize("of", ["table", "json", "no column", "no press"])
def test_a_json_file_for_each_picture_and_a_table_of_forces_are_read(tmp_path, of):
    folder = set_of(tmp_path / "set", "p{}.png", "rest.png")
    for k, (row, column) in enumerate(RIGHT_PLACES, start=1):
        put(folder / f"p{k}.png", eight_bits(dome(row, column)))
        said = {"contact": {"x": column, "y": row, "by": "hand"}, "r": [CONTACT_PX], "Fz": 100.0 * k, "id": "a"}
        (folder / f"{k}.json").write_text(json.dumps(said))
    (folder / "force.csv").write_text("name,Fz\n" + "".join(f"p{k}.png,{100 * k}\n" for k in range(1, 6)))
    text = LABELLED.replace("FORCE", "{press}.json" if of == "json" else "force.csv")
    text = text.replace('column = "Fz"\n', "") if of == "no column" else text
    text += 'press = "name"\n' if of == "table" else ""
    recipe = recipe_of("p{press}.png", "rest.png").model_dump(exclude_defaults=True)
    recipe = Recipe.model_validate({**recipe, **tomllib.loads(text)})
    if of.startswith("no "):
        missing = r"force\.column is missing" if of == "no column" else r"'press' is missing .* name entries"
        with pytest.raises(ImportFormatError, match=missing):
            read_by_recipe(folder, recipe)
        return
    captures = read_by_recipe(folder, recipe).captures
    for k, (row, column) in enumerate(RIGHT_PLACES, start=1):
        assert captures[f"{k}"].force_n == pytest.approx(0.1 * k)
        circle = captures[f"{k}"].contact_circle
        assert (circle.row_px, circle.column_px, circle.radius_px) == (row, column, CONTACT_PX)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (None, r"^the file 2\.json, which the recipe names, is missing$"),
        ("null", "^its 'Fz' is not a finite number$"),
        ('"1.5"', "^its 'Fz' is not a finite number$"),
        ("true", "^its 'Fz' is not a finite number$"),
        ("NaN", "^its 'Fz' is not a finite number$"),
        ("-Infinity", "^its 'Fz' is not a finite number$"),
        ("1e999", "^its 'Fz' is not a finite number$"),
        ("[]", "^its 'Fz' is not a finite number$"),
        ("[[1, 2]]", "^its 'Fz' is not a finite number$"),
        ('{"mean": 1}', "^its 'Fz' is not a finite number$"),
    ],
)
def test_a_press_whose_json_label_holds_no_number_is_left_out_as_one_without_a_label(tmp_path, said, message):
    folder = labelled_set(tmp_path / "set", set())
    for k, (row, column) in enumerate(RIGHT_PLACES, start=1):
        text = json.dumps({"contact": {"x": column, "y": row}, "r": [CONTACT_PX], "Fz": 1.0})
        (folder / f"{k}.json").write_text(text.replace("1.0}", f"{said}}}") if k == 2 else text)
    if said is None:
        (folder / "2.json").unlink()
    recipe = recipe_of("p{press}.png", "rest.png").model_dump(exclude_defaults=True)
    found = read_by_recipe(
        folder, Recipe.model_validate({**recipe, **tomllib.loads(LABELLED.replace("FORCE", "{press}.json"))})
    )
    ((why, names),) = found.left_out.items()
    assert re.search(message, why)
    assert names == ["2"]
    assert list(found.captures) == ["1", "3", "4", "5"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[{"Fz": 1.0}]', r"1\.json: is not one object \{ \.\.\. \} with the labels of its press"),
        ('{"Fz": 1.0, "r": 5}', r"1\.json: 'contact\.x' is missing; the file contains Fz, r$"),
        (
            '{"Fz": [1.0, 2.0]}',
            r"1\.json: 'Fz' has entries 0 to 1, but the recipe names none of these; name one, such as Fz\[0\]$",
        ),
    ],
)
def test_a_json_label_of_another_form_is_refused_with_what_it_holds(tmp_path, text, message):
    folder = labelled_set(tmp_path / "set", set())
    (folder / "1.json").write_text(text)
    recipe = recipe_of("p{press}.png", "rest.png").model_dump(exclude_defaults=True)
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(
            folder, Recipe.model_validate({**recipe, **tomllib.loads(LABELLED.replace("FORCE", "{press}.json"))})
        )


@pytest.mark.parametrize(
    ("ending", "message"),
    [
        (".h5", r"numpy\.save\(f'\{k\}\.npy', image\) for k, image in enumerate\(h5py\.File\('1\.h5'\)\['NAME'\]\)\]$"),
        (".webp", r"such as with 'mogrify -format png \*\.webp'"),
        (".heic", r"such as with 'mogrify -format png \*\.heic'"),
        # 'mogrify -format png *.png' would write over the originals
        (
            ".png",
            r"1\.png: is neither .*; its content does not match its file extension, so copy .*$",
        ),
        (
            ".JPG",
            r"1\.JPG: is neither .*; its content does not match its file extension, so copy .*$",
        ),
        (".mp4", r"no_contact\.frames_before is missing; give the number of frames without contact at the start of"),
    ],
)
def test_stacks_and_other_pictures_are_refused_with_what_converts_them(tmp_path, ending, message):
    folder = set_of(tmp_path / "set", "p{}.png", "rest.png")
    (folder / f"1{ending}").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(folder, recipe_of(f"{{press}}{ending}", "rest.png"))


def filmed(folder, kind="mp4", code="mp4v", rate_hz=25.0, clock_s=1700000000.0):
    """A grasp of 30 frames, and its force at 80 Hz by a clock of its own: 1 N in a second from the first frame on."""
    video = cv2.VideoWriter(str(folder / f"a.{kind}"), cv2.VideoWriter_fourcc(*code), rate_hz, (160, 120))
    for frame in grasp():
        video.write(eight_bits(frame)[..., ::-1].copy())
    video.release()
    since_s = np.arange(0.0, 30.0 / rate_hz, 1.0 / 80.0)
    # nothing before the contact, so that the held frame is that of the largest force
    force_n = np.where(since_s < 12.0 / rate_hz, 0.0, np.where(since_s < 24.0 / rate_hz, 5.0 + since_s, 0.0))
    lines = [f"{clock_s + t:.4f},{f:.5f}" for t, f in zip(since_s, force_n, strict=True)]
    (folder / "a.csv").write_text("\n".join(["t,fz", *lines]))
    return folder


FILMED = """
name = "t"
what = "t"
presses = {{ files = "{{press}}.{}" }}
no_contact = {{ frames_before = 10 }}
indenter = {{ shape = "ball" }}
force = {{ file = "{{press}}.csv", column = "fz", frames = {{ time = "t"{} }} }}
"""


@pytest.mark.parametrize(
    ("kind", "code", "rate_hz", "per_s"),
    [("mp4", "mp4v", 25.0, ""), ("avi", "MJPG", 20.0, ""), ("mp4", "mp4v", 25.0, ", per_s = 25")],
)
def test_forces_of_another_clock_are_those_at_the_times_of_the_frames(tmp_path, kind, code, rate_hz, per_s):
    text = FILMED.format(kind, per_s)
    (capture,) = read_by_recipe(
        filmed(tmp_path, kind, code, rate_hz), Recipe.model_validate(tomllib.loads(text))
    ).captures.values()
    middle_s = (12 + 23) // 2 / rate_hz
    # the held frame is the middle one of those with force, give or take one
    assert capture.force_n - 5.0 == pytest.approx(middle_s, abs=1.01 / rate_hz)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            ', unit = "ms"',
            r"its 96 forces cover 0 to 0\.001187 s after the first frame, but the frames 0 to 1\.16 s",
        ),
        (", per_s = 10", r"the frames 0 to 2\.9 s; correct unit, first and per_s below \[force\.frames\]"),
        (", first = 1700000001.0", r"its 96 forces cover -1 to 0\.1875 s after the first frame"),
        (
            "",
            r"its 96 forces cover 0 to 1188 s after the first frame, but the frames 0 to 1\.16 s",
        ),  # of milliseconds
    ],
)
def test_forces_of_another_time_than_the_frames_are_refused(tmp_path, more, message):
    filmed(tmp_path)
    if not more:
        lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
        text = "\n".join(["t,fz", *(f"{1e3 * (float(t) - 1.7e9):.1f},{force}" for t, force in lines)])
        (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(tmp_path, Recipe.model_validate(tomllib.loads(FILMED.format("mp4", more))))


def test_a_video_without_times_needs_the_rate_of_its_frames(tmp_path):
    filmed(tmp_path)
    write_video(tmp_path / "a.avi", grasp())
    with pytest.raises(ImportFormatError, match=r"a\.avi: contains no frame times; give per_s"):
        read_by_recipe(tmp_path, Recipe.model_validate(tomllib.loads(FILMED.format("avi", ""))))


BOXES = {
    "box": 'left_px = "b[0]", top_px = "b[1]", width_px = "b[2]", height_px = "b[3]"',
    "ends": 'left_px = "e[0]", top_px = "e[1]", right_px = "e[2]", bottom_px = "e[3]"',
    # ends taken for sizes
    "wrong": 'left_px = "e[0]", top_px = "e[1]", width_px = "e[2]", height_px = "e[3]"',
}


@pytest.mark.parametrize("shape", ["ball", "cuboid"])
@pytest.mark.parametrize("kind", list(BOXES))
def test_a_box_is_around_the_circle_of_a_ball_or_is_the_contact(tmp_path, shape, kind):
    lines = []
    for k, (image, (row, column)) in enumerate(zip(PRESSES, PLACES, strict=True)):
        put(tmp_path / f"{k}.png", image)
        left, top = column - CONTACT_PX, row - CONTACT_PX
        sizes = [left, top, 2.0 * CONTACT_PX, 2.0 * CONTACT_PX]
        lines.append({"file": f"{k}.png", "b": sizes, "e": [left, top, left + sizes[2], top + sizes[3]]})
    put(tmp_path / "rest.png", UNTOUCHED)
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, lines)))
    text = f"""
        name = "t"
        what = "t"
        presses = {{ files = "{{press}}.png", only = "?" }}
        no_contact = {{ file = "rest.png" }}
        contact = {{ file = "a.jsonl", press = "file", box = {{ {BOXES[kind]} }} }}
        indenter = {{ shape = "{shape}" }}
    """
    recipe = Recipe.model_validate(tomllib.loads(text))
    if kind == "wrong":
        with pytest.raises(ImportFormatError, match=r"the box of 2, .*, and whether the last two are edges or sizes"):
            read_by_recipe(tmp_path, recipe)
        return
    for capture, (row, column) in zip(read_by_recipe(tmp_path, recipe).captures.values(), PLACES, strict=True):
        if shape == "ball":
            assert capture.contact_circle == ContactCircle(row_px=row, column_px=column, radius_px=CONTACT_PX)
            continue
        corners = {(c.column_px - column, c.row_px - row) for c in capture.contact_outline}
        assert corners == {(a, b) for a in (-CONTACT_PX, CONTACT_PX) for b in (-CONTACT_PX, CONTACT_PX)}


@pytest.mark.parametrize(("depth_mm", "is_doubtful"), [(0.25, True), (0.9, False), (2.0, False), (3.0, True)])
def test_a_found_circle_that_its_depth_contradicts_is_told(tmp_path, depth_mm, is_doubtful):
    """The search finds 26 px of this made-up press of a ball of 46 px: 0.8 mm in a rigid pad, 1.6 mm in a soft one."""
    for k, image in enumerate(PRESSES):
        put(tmp_path / f"{k}.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    text = f"""
        name = "t"
        what = "t"
        presses = {{ files = "{{press}}.png", only = "?" }}
        no_contact = {{ file = "rest.png" }}
        contact = {{ search = "circle" }}
        scale = {{ mm_per_px = 0.1 }}
        indenter = {{ shape = "ball", radius_mm = 4.6, depth_mm = {{ "0" = {depth_mm}, "*" = 0.9 }} }}
    """
    found = read_by_recipe(tmp_path, Recipe.model_validate(tomllib.loads(text))).captures
    doubtful = [n for n, c in found.items() if any(part.what == "a circle that suits its depth" for part in c.missing)]
    assert doubtful == (["0"] if is_doubtful else [])
