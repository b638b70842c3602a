"""Labels that a recipe finds: in names, maps of depths, poses, arrays, tables of JSON, lines of the nearest time."""

import json
import tomllib

import cv2
import numpy as np
import pytest

from data_schemas import ImportFormatError
from finray_calib.exchange import Recipe, read_by_recipe, survey_folder
from tests.command_line.running import finray, succeed
from tests.exchange.ball_press_folders import eight_bits
from tests.exchange.recipe_folders import BALL_PX, CONTACT_PX, PLACES, grasp, write_video
from tests.exchange.test_other_layouts import PRESSES, SIXTEEN, UNTOUCHED, put


def pit(row, column):
    """Depths in mm of a ball of 46 px, at 0.1 mm a pixel, within the circle of its contact."""
    rows, columns = np.indices(UNTOUCHED.shape[:2])
    away = np.hypot(rows - row, columns - column)
    return 0.1 * np.maximum(np.sqrt(np.maximum(BALL_PX**2 - away**2, 0.0)) - np.sqrt(BALL_PX**2 - CONTACT_PX**2), 0.0)


DEEPEST_MM = 0.1 * (BALL_PX - np.sqrt(BALL_PX**2 - CONTACT_PX**2))


def told(text):
    """A recipe of a few lines, in which [picture], [contact], [indenter] and [force] may be missing."""
    said = tomllib.loads(text)
    return Recipe.model_validate(
        {"name": "t", "what": "t", **said, "indenter": {"shape": "ball"} | said.get("indenter", {})}
    )


def test_parts_of_a_name_are_numbers_and_name_other_files(tmp_path):
    for k, image in enumerate(PRESSES):
        shape, mm = ("ball", 9) if k < 3 else ("edge", 2)
        put(tmp_path / f"{shape}_{mm}" / f"run{k}_z-{k + 5}0p5_x{k}_f{100 * k}.5g.png", image)
        put(tmp_path / f"{shape}_{mm}" / f"rest{k}.png", UNTOUCHED)
        put(tmp_path / "rests" / f"{shape}_{mm}_{k}_{k + 5}0p5_{k}_{100 * k}.5.png", UNTOUCHED)
    recipe = told("""
        presses = { files = "{solid}_{width}/run{run}_z-{z}_x{x}_f{force}g.png" }
        no_contact = { file = "{solid}_{width}/rest{run}.png" }
        force = { column = "{force}", unit = "g" }
        [indenter]
        shape = { "ball*" = "ball", "edge*" = "cuboid" }
        radius_mm = "{width}"
        depth_mm = "{z}"
        position_mm = "{x}"
        columns_in = { depth_mm = "um", radius_mm = "cm" }
    """)
    found = read_by_recipe(tmp_path, recipe)
    assert not found.left_out
    assert next(iter(found.captures)) == "ball_9/run0_z-50p5_x0_f0.5"
    lacking = "an image without contact of each press"  # other words of the name may differ where these are the same
    assert all(lacking in {part.what for part in capture.missing} for capture in found.captures.values())
    every = recipe.no_contact.model_copy(update={"file": "rests/{solid}_{width}_{run}_{z}_{x}_{force}.png"})
    own = read_by_recipe(tmp_path, recipe.model_copy(update={"no_contact": every}))
    assert all(lacking not in {part.what for part in capture.missing} for capture in own.captures.values())
    told_of = [(c.indenter.shape, c.indenter.radius_mm, c.indenter.position_mm) for c in found.captures.values()]
    assert told_of == [("ball", 90, 0), ("ball", 90, 1), ("ball", 90, 2), ("cuboid", 20, 3), ("cuboid", 20, 4)]
    depths = [c.indenter.depth_mm for c in found.captures.values()]
    assert depths == pytest.approx([0.0505, 0.0605, 0.0705, 0.0805, 0.0905])
    # a gram weighs 9.80665 mN
    forces = [c.force_n for c in found.captures.values()]
    assert forces == pytest.approx([9.80665e-3 * (100 * k + 0.5) for k in range(5)])


def numbered(folder, ending=".png"):
    for k, image in enumerate(PRESSES):
        put(folder / f"{k}{ending}", image)
    put(folder / f"rest{ending}", UNTOUCHED)
    return folder


NUMBERED = 'presses = { files = "{press}.png", leave_out = ["rest"] }\nno_contact = { file = "rest.png" }\n'
MAPPED = NUMBERED + '[contact.depth_map]\nfile = "map{press}"\nvalue_mm = 1\n'


@pytest.mark.parametrize("kind", [".png", ".npy", ".tif", ".npz"])
def test_a_map_of_depths_gives_contact_and_depth(tmp_path, kind):
    """The circle and depth of each made-up ball are known in closed form; the map is in other units and signs."""
    numbered(tmp_path)
    for k, place in enumerate(PLACES):
        depth = pit(*place)
        if kind == ".png":
            cv2.imwrite(str(tmp_path / f"map{k}.png"), np.rint(1000.0 * depth).astype(np.uint16))
        elif kind == ".tif":
            cv2.imwrite(str(tmp_path / f"map{k}.tif"), depth.astype(np.float32))
        elif kind == ".npy":
            np.save(tmp_path / f"map{k}.npy", 0.02 - depth / 1000.0)
    np.savez(
        tmp_path / "maps.npz", height=[7.0 - 1000.0 * pit(*place) for place in PLACES], rest=np.full((120, 160), 7)
    )
    np.save(tmp_path / "flat.npy", np.full((120, 160), 0.02))
    value, more = {".png": (1e-3, ""), ".tif": (1.0, ""), ".npy": (-1e3, 'rest_file = "flat.npy"'),
                   ".npz": (-1e-3, 'rest_file = "maps.npz::rest"')}[kind]  # fmt: skip
    name = "maps.npz::height[{press}]" if kind == ".npz" else "map{press}" + kind
    text = NUMBERED.replace("[]", "") + f'[contact.depth_map]\nfile = "{name}"\nvalue_mm = {value}\n{more}\n'
    text = text.replace('"{press}.png", leave_out', '"{press}.png", only = "[0-9]", leave_out')
    found = read_by_recipe(tmp_path, told(text + "[scale]\nmm_per_px = 0.1"))
    for (row, column), capture in zip(PLACES, found.captures.values(), strict=True):
        circle = capture.contact_circle
        assert (circle.row_px, circle.column_px) == pytest.approx((row, column), abs=0.05)
        # 1 % of the depth is not reached in the outer 0.5 % of the radius, nor in part of the pixels at the rim
        assert circle.radius_px == pytest.approx(CONTACT_PX, abs=0.5)
        assert capture.indenter.depth_mm == pytest.approx(DEEPEST_MM, abs=1e-3)
        assert capture.contact_told_by == "label"
    cuboids = told(text + '[indenter]\nshape = "cuboid"')
    for (row, column), capture in zip(PLACES, read_by_recipe(tmp_path, cuboids).captures.values(), strict=True):
        corners = np.array([(corner.row_px, corner.column_px) for corner in capture.contact_outline])
        assert np.hypot(*(corners - (row, column)).T) == pytest.approx(CONTACT_PX, abs=1.5)


@pytest.mark.parametrize(
    ("change", "text", "message"),
    [
        (lambda depth: depth[::2, ::2], "", r"map0\.npy: has 80 x 60 px, but the picture of 0 has 160 x 120 px; scale"),
        (lambda depth: np.where(depth > 0.1, np.nan, depth), "", r"map0\.npy: 5\.\d+ % of its values are NaN"),
        (lambda depth: -depth, "", r"nowhere above 0 .*; if the values fall as the gel is pressed in, value_mm"),
        (lambda depth: depth / 1000.0, "", r"contact\.depth_map: the median depth of 5 .* is 0\.000458 mm.*value_mm"),
        (lambda depth: np.dstack([depth, depth / 2.0]), "", r"one value per pixel, got shape \(120, 160, 2\)"),
        (lambda depth: depth, "least_depth_mm = 5.0", r"exceeds 5 mm in fewer than 3 pixels \(maximum 0\.458 mm\)"),
        (None, "", r"the map map0\.npy, which the recipe names, is missing"),
    ],
)  # fmt: skip
def test_a_map_that_cannot_be_is_refused_in_a_sentence(tmp_path, change, text, message):
    numbered(tmp_path)
    for k, place in enumerate(PLACES):
        if change is not None:
            np.save(tmp_path / f"map{k}.npy", change(pit(*place)))
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(tmp_path, told(MAPPED.replace('"map{press}"', '"map{press}.npy"') + text))


POSED = (
    NUMBERED
    + """
[indenter.pose]
file = "poses.csv"
press = "image"
unit = "m"
first_touch_mm = 50.0
along = [0, 1, 0]
base_mm = 10.0
axis = [0, 0, -1]
"""
)
BY_COLUMNS = 'x = "x"\ny = "y"\nz = "z"\nquaternion = { w = "qw", x = "qx", y = "qy", z = "qz" }\n'
BY_MATRIX = f"matrix = {json.dumps([f'm{k}' for k in range(16)])}\n"


def poses(folder, change=lambda row: row):
    """A tool that is turned by k times 3 deg about x, and pressed in by 0.3 mm and more, at 12 mm and more."""
    lines = [",".join(["image", "x", "y", "z", "qw", "qx", "qy", "qz", *(f"m{k}" for k in range(16))])]
    matrices = []
    for k in range(5):
        half = np.radians(3.0 * k) / 2.0
        place = (0.5, (12.0 + k) / 1000.0, (50.0 - 0.3 - 0.1 * k) / 1000.0)
        cosine, sine = np.cos(2.0 * half), np.sin(2.0 * half)
        matrix = [1, 0, 0, place[0], 0, cosine, -sine, place[1], 0, sine, cosine, place[2], 0, 0, 0, 1]
        lines.append(",".join(map(str, [f"{k}.png", *change([*place, np.cos(half), np.sin(half), 0, 0, *matrix])])))
        (folder / f"{k}.json").write_text(json.dumps({"T": np.reshape(matrix, (4, 4)).tolist()}))
        matrices.append(np.reshape(matrix, (4, 4)))
    np.savez(folder / "poses.npz", T=matrices)
    (folder / "poses.csv").write_text("\n".join(lines))
    return numbered(folder)


@pytest.mark.parametrize(
    ("file", "columns"),
    [
        ("poses.csv", BY_COLUMNS),
        ("poses.csv", BY_MATRIX),
        ("poses.npz", 'matrix = "T[{press}]"'),
        ("{press}.json", 'matrix = "T"'),
    ],
)
def test_poses_give_depth_place_and_tilt(tmp_path, file, columns):
    text = POSED + columns
    if file != "poses.csv":
        text = text.replace("poses.csv", file).replace('press = "image"\n', "")
    found = read_by_recipe(poses(tmp_path), told(text)).captures
    for k, capture in enumerate(found.values()):
        pose = capture.indenter
        assert (pose.depth_mm, pose.position_mm, pose.tilt_deg) == pytest.approx((0.3 + 0.1 * k, 2.0 + k, 3.0 * k))


@pytest.mark.parametrize(
    ("change", "columns", "message"),
    [
        (lambda row: [*row[:3], *(2 * q for q in row[3:7]), *row[7:]], BY_COLUMNS, r"quaternion of 0 has a norm of 2,"),
        (lambda row: [*row[:7], *np.reshape(row[7:], (4, 4)).T.ravel()], BY_MATRIX, r"of 0 is not a rotation .* order"),
        (lambda row: [1000 * row[0], 1000 * row[1], 1000 * row[2], *row[3:]], BY_COLUMNS, r"from first touch, is -4"),
        (lambda row: ["nan", *row[1:]], BY_COLUMNS, r"poses\.csv: x of 0 must be a number, got 'nan'"),
    ],
)  # fmt: skip
def test_poses_that_cannot_be_are_refused_in_a_sentence(tmp_path, change, columns, message):
    with pytest.raises(ImportFormatError, match=message):
        read_by_recipe(poses(tmp_path, change), told(POSED + columns))


STACKED = """
presses = { files = "SET::images[{press}]" }
picture = { channels = "RGB" }
no_contact = { file = "SET::rest" }
[contact]
file = "set.npz"
circle = { column_px = "labels[{press}, 1]", row_px = "labels[{press}, 0]", radius_px = "radius[{press}]" }
"""


@pytest.mark.parametrize("kind", ["npz", "fractions", "npy", "tif"])
def test_arrays_of_pictures_are_read(tmp_path, kind):
    labels = {"labels": PLACES, "radius": np.full(5, CONTACT_PX)}
    pictures = {"images": np.stack(PRESSES), "rest": UNTOUCHED}
    if kind == "fractions":  # as PyTorch stores them
        pictures = {name: np.moveaxis(of, -1, -3).astype(np.float32) / 255.0 for name, of in pictures.items()}
    np.savez(tmp_path / "set.npz", **labels, **(pictures if kind in ("npz", "fractions") else {}))
    text = STACKED
    if kind == "npy":
        np.save(tmp_path / "stack.npy", np.stack([*PRESSES, UNTOUCHED]))
    elif kind == "tif":
        cv2.imwritemulti(str(tmp_path / "stack.tif"), [image[..., ::-1].copy() for image in (*PRESSES, UNTOUCHED)])
    if kind in ("npy", "tif"):
        text = text.replace("SET::images", f"stack.{kind}::").replace("SET::rest", f"stack.{kind}::[5]")
        text = text.replace('[{press}]" }\npicture', '[{press}]", leave_out = ["5"] }\npicture')
    if kind == "fractions":
        text = text.replace('"RGB" }', '"RGB", full_scale = 1.0 }')
    found = read_by_recipe(tmp_path, told(text.replace("SET", "set.npz"))).captures
    for image, (row, column), capture in zip(PRESSES, PLACES, found.values(), strict=True):
        np.testing.assert_array_equal(capture.contact, image * (SIXTEEN if kind == "fractions" else 1))
        assert (capture.contact_circle.row_px, capture.contact_circle.column_px) == (row, column)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("set.npz::images[{press}]", "set.npz::photos[{press}]"),
            r"array 'photos' is missing; the file contains images",
        ),
        (
            ("set.npz::images[{press}]", "set.npz::radius[{press}]"),
            r"'radius' of shape \(5,\) is not an array",
        ),
        (("set.npz::images[{press}]", "set.npz::images"), r"must contain \{press\}, .* exactly once"),
        (("set.npz::images[{press}]", "set.npz::{press}"), r"must end in the name of an array and \[\{press\}\]"),
        (("[{press}, 1]", "[{press}, 2]"), r"'labels\[0, 2\]' is not one finite number; .* of shape \(5, 2\)"),
        (("[{press}, 1]", "[{frame}, 1]"), r"uses \{frame\}, but presses\.files gives only \{press\}"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_in_a_sentence(tmp_path, change, message):
    np.savez(tmp_path / "set.npz", images=np.stack(PRESSES), rest=UNTOUCHED, labels=PLACES, radius=np.ones(5))
    with pytest.raises((ImportFormatError, ValueError), match=message):
        read_by_recipe(tmp_path, told(STACKED.replace("SET", "set.npz").replace(*change)))


@pytest.mark.parametrize("kind", ["lines.jsonl", "list.json", "whole.json"])
def test_tables_of_json_with_inner_keys_are_read(tmp_path, kind):
    said = [
        {"file": {"name": f"{k}.png"}, "at": [column, row], "r": CONTACT_PX} for k, (row, column) in enumerate(PLACES)
    ]
    text = {"lines.jsonl": "\n".join(map(json.dumps, said)), "list.json": json.dumps(said),
            "whole.json": json.dumps({"version": 1, "presses": said, "tags": ["a"]})}[kind]  # fmt: skip
    (numbered(tmp_path) / kind).write_text(text)
    circle = 'circle = { column_px = "at[0]", row_px = "at[1]", radius_px = "r" }'
    found = read_by_recipe(
        tmp_path, told(NUMBERED + f'[contact]\nfile = "{kind}"\npress = "file.name"\n{circle}')
    ).captures
    assert [(c.contact_circle.row_px, c.contact_circle.column_px) for c in found.values()] == PLACES


@pytest.mark.parametrize(("mark", "point"), [(";", ","), (";", "."), ("\t", "."), ("\t", ","), (",", ".")])
def test_tables_with_other_marks_are_read(tmp_path, mark, point):
    """As spreadsheets of countries with decimal commas export them."""
    lines = ["image,x,y,r", *(f"{k}.png,{column:.2f},{row:.2f},20.5" for k, (row, column) in enumerate(PLACES))]
    other = [lines[0].replace(",", mark), *(line.replace(",", mark).replace(".png", "#") for line in lines[1:])]
    text = "\n".join([other[0], *(line.replace(".", point).replace("#", ".png") for line in other[1:])])
    (numbered(tmp_path) / "t.csv").write_text(text)
    circle = 'circle = { column_px = "x", row_px = "y", radius_px = "r" }'
    found = read_by_recipe(tmp_path, told(NUMBERED + f'[contact]\nfile = "t.csv"\npress = "image"\n{circle}')).captures
    circles = [c.contact_circle for c in found.values()]
    assert [(c.row_px, c.column_px, c.radius_px) for c in circles] == [(*place, 20.5) for place in PLACES]


@pytest.mark.parametrize("names", [["0,5", "1,5"], ["0.5", "1.5"]])
def test_a_comma_in_the_name_of_a_press_is_no_decimal_mark(tmp_path, names):
    for name, image in zip(names, PRESSES, strict=False):
        put(tmp_path / f"{name}.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    (tmp_path / "t.csv").write_text("press;z\n0,5;0,25\n1,5;0,75\n")
    text = """
        presses = { files = "{press}.png", leave_out = ["rest"] }
        no_contact = { file = "rest.png" }
        indenter = { shape = "ball", file = "t.csv", press = "press", depth_mm = "z" }
    """
    found = read_by_recipe(tmp_path, told(text)).captures
    assert {name: capture.indenter.depth_mm for name, capture in found.items()} == dict(
        zip(names, (0.25, 0.75), strict=True)
    )


@pytest.mark.parametrize("others", ["0.7", "2,500"])
def test_commas_between_tabs_are_no_decimal_marks_where_they_may_part_thousands(tmp_path, others):
    rows = f"0\t{others}\n1\t1,250\n2\t{others}\n3\t{others}\n"
    (numbered(tmp_path) / "t.csv").write_text(f"press\tz\n{rows}")
    text = NUMBERED + 'indenter = { shape = "ball", file = "t.csv", press = "press", depth_mm = "z" }'
    with pytest.raises(
        ImportFormatError, match=r"z of \d must be a number, got '\d,\d+'; write it with a decimal point"
    ):
        read_by_recipe(tmp_path, told(text))


def test_the_force_of_the_nearest_time_is_taken_and_a_distant_one_is_not(tmp_path):
    for k, image in enumerate(PRESSES):
        put(tmp_path / f"{k + 1}250000000.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    rows = [f"{t / 10:.1f},{t / 100:.2f}" for t in range(10, 50)]  # ends at 4.9 s; the last picture is of 5.25 s
    (tmp_path / "wrench.csv").write_text("\n".join(["t,fz", *rows]))
    found = read_by_recipe(
        tmp_path,
        told("""
            presses = { files = "{stamp}.png", leave_out = ["rest"] }
            no_contact = { file = "rest.png" }
            [force]
            file = "wrench.csv"
            column = "fz"
            nearest = { column = "t", to = "{stamp}", factor = 1e-9, within = 0.06 }
        """),
    )
    assert [c.force_n for c in found.captures.values()] == pytest.approx([0.12, 0.22, 0.32, 0.42], abs=0.011)
    assert found.left_out["no row of wrench.csv lies within 0.06 of the time of the press"] == ["5250000000"]


def test_a_coded_video_is_read_as_a_motion_jpeg_one(tmp_path):
    video = cv2.VideoWriter(str(tmp_path / "a.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (160, 120))
    for frame in grasp():
        video.write(eight_bits(frame)[..., ::-1].copy())
    video.release()
    text = 'presses = { files = "{press}.mp4" }\nno_contact = { frames_before = 10 }'
    (capture,) = read_by_recipe(tmp_path, told(text)).captures.values()
    # coded with loss and half the colour resolution
    assert np.abs(capture.contact - eight_bits(grasp()[20]).astype(float)).mean() < 3.0
    assert np.abs(capture.no_contact - UNTOUCHED.astype(float)).mean() < 3.0
    (tmp_path / "a.mp4").write_bytes(b"\0" * 5000)
    with pytest.raises(ImportFormatError, match=r"a\.mp4: cannot be decoded as a video; convert the video with 'ff"):
        read_by_recipe(tmp_path, told(text))


def begun(folder, *filled):
    """The recipe that a survey begins, with its proposals taken up and what it asks for filled in."""
    said = survey_folder(folder).recipe
    lines = [line.removeprefix("# ") for line in said.partition("\n# what else")[0].splitlines()]
    text = "\n".join(line for line in lines if not line.startswith(("[scale]", "mm_per_px", "licence")))
    for ours, theirs in filled:
        assert ours in text
        text = text.replace(ours, theirs)
    return Recipe.model_validate(tomllib.loads(text))


def test_a_begun_recipe_proposes_what_names_of_files_say(tmp_path):
    for k, image in enumerate(PRESSES):
        put(tmp_path / f"ball4mm_z0.{k + 1}_f{k + 2}.5N.png", image)
    put(tmp_path / "background.png", UNTOUCHED)
    found = read_by_recipe(tmp_path, begun(tmp_path, ("FILL IN", "mm"))).captures
    assert [c.indenter.radius_mm for c in found.values()] == [2.0] * len(PRESSES)
    assert [c.indenter.depth_mm for c in found.values()] == pytest.approx([0.1 * (k + 1) for k in range(len(PRESSES))])
    assert [c.force_n for c in found.values()] == pytest.approx([k + 2.5 for k in range(len(PRESSES))])


def test_numbers_behind_one_letter_get_words_of_their_own(tmp_path):
    for k in range(2):
        for m in range(2):
            put(tmp_path / f"b{k}_{m}.png", PRESSES[2 * k + m])
    put(tmp_path / "rest.png", UNTOUCHED)
    assert 'files = "b{b}_{a}.png"' in survey_folder(tmp_path).recipe
    assert len(read_by_recipe(tmp_path, begun(tmp_path)).captures) == 4


def test_a_begun_recipe_proposes_arrays_by_name_and_shape(tmp_path):
    force = np.array([[9.0, 9.0, k + 1.5] for k in range(len(PRESSES))])
    np.savez(tmp_path / "set.npz", images=np.stack(PRESSES), background=UNTOUCHED, force=force,
             depth_um=np.arange(len(PRESSES)) * 100.0 + 200.0)  # fmt: skip
    found = read_by_recipe(tmp_path, begun(tmp_path, ("FILL IN", "mN"))).captures
    assert [c.indenter.depth_mm for c in found.values()] == pytest.approx([0.2 + 0.1 * k for k in range(len(PRESSES))])
    assert [c.force_n for c in found.values()] == pytest.approx([1e-3 * (k + 1.5) for k in range(len(PRESSES))])


def test_a_begun_recipe_proposes_columns_and_says_which_units_are_not_known(tmp_path):
    rows = [f"{k}.png,{column},{row},20.5,{0.2 + 0.1 * k}" for k, (row, column) in enumerate(PLACES)]
    (numbered(tmp_path) / "t.csv").write_text("\n".join(["file,x,y,radius_px,z", *rows]))
    put(tmp_path / "0_depth.png", UNTOUCHED)
    begins = survey_folder(tmp_path).recipe
    assert "# # CHECK that x, y are in pixels: their names do not say" in begins
    assert '# # FILL IN "mm", "cm", "m" or "um", which z does not say' in begins
    recipe = begun(tmp_path, ("FILL IN", "mm"), ('search = "circle"\n', ""))
    assert recipe.presses.only == "?"  # neither the rest nor the other picture
    found = read_by_recipe(tmp_path, recipe).captures
    circles = [c.contact_circle for c in found.values()]
    assert [(c.row_px, c.column_px, c.radius_px) for c in circles] == [(*place, 20.5) for place in PLACES]
    assert [c.indenter.depth_mm for c in found.values()] == pytest.approx([0.2 + 0.1 * k for k in range(len(PLACES))])


def test_a_begun_recipe_takes_names_of_numbers_without_those_that_only_end_in_one(tmp_path):
    """Seventeen others are too many to be left out one by one."""
    for k in range(18):
        put(tmp_path / f"{k}.png", PRESSES[k % len(PRESSES)])
    for k in range(17):
        put(tmp_path / f"Kugel_{k:02d}.png", UNTOUCHED)
    put(tmp_path / "rest.png", UNTOUCHED)
    recipe = begun(tmp_path)
    assert recipe.presses.only == "[0-9]*"
    assert list(read_by_recipe(tmp_path, recipe).captures) == [f"{k}" for k in range(18)]


def test_a_begun_recipe_names_the_rest_of_each_folder_and_maps_of_depth(tmp_path):
    for k, image in enumerate(PRESSES):
        folder = tmp_path / f"ball_{k % 2}"
        put(folder / f"gel_{k}.png", image)
        put(folder / "ref.png", UNTOUCHED)
        np.save(folder / f"gel_{k}_depth.npy", np.zeros(UNTOUCHED.shape[:2]))
    recipe = begun(tmp_path, ('search = "circle"\n', ""), ('"FILL IN"', "1.0"))
    assert recipe.no_contact.file == "ball_{ball}/ref.png"
    assert recipe.contact.depth_map.file == "ball_{ball}/gel_{gel}_depth.npy"


def test_a_begun_recipe_takes_folders_without_numbers_for_the_presses(tmp_path):
    for name, image in zip(("ball", "cube", "edge"), PRESSES, strict=False):
        put(tmp_path / name / "contact.png", image)
        put(tmp_path / name / "no_contact.png", UNTOUCHED)
    recipe = begun(tmp_path)
    assert (recipe.presses.files, recipe.no_contact.file) == ("{press}/contact.png", "{press}/no_contact.png")
    assert list(read_by_recipe(tmp_path, recipe).captures) == ["ball", "cube", "edge"]


def test_a_folder_without_a_recipe_is_described_and_the_recipe_that_is_begun_reads_it(tmp_path, monkeypatch):
    for k, image in enumerate(PRESSES):
        put(tmp_path / "set" / f"ball_{k % 2}" / f"p{k}_z0.{k}.png", image)
    put(tmp_path / "set" / "background.png", UNTOUCHED)
    (tmp_path / "set" / "labels.csv").write_text("image,x,y\np0_z0.0.png,1,2\n")
    np.savez(tmp_path / "set" / "more.npz", forces=np.arange(5.0), odd=np.array([{}], dtype=object))
    (tmp_path / "set" / "about.json").write_text('{"sensor": {"px_per_mm": 10}}')
    (tmp_path / "set" / "broken.jpg").write_bytes(b"none")
    monkeypatch.chdir(tmp_path)
    said = succeed("import captures set")
    assert "5 x ball_{ball}/p{p}_z{z}.png: picture of 160 x 120 px, uint8, colour" in said
    assert "1 x labels.csv: table of 1 lines: image, x, y" in said
    assert "1 x more.npz: arrays: forces (5,) float64, odd (pickled, never read)" in said
    assert "1 x about.json: object of 1 keys: sensor.px_per_mm" in said
    assert "1 x broken.jpg: is neither PNG nor JPEG" in said
    assert "background.png" in (tmp_path / "set.recipe.toml").read_text()
    # a warning says that the contacts were found by a search
    assert finray("import captures set --recipe set.recipe.toml --out found").status == 0
    assert len(list((tmp_path / "found").glob("*.capture.json"))) == 5
    assert "exists already" in finray("import captures set").err
    failed = finray("import captures nowhere --out new.toml")
    assert (failed.status, "nowhere: no such folder or zip archive" in failed.err) == (2, True)


def of_arrays(folder, depth, **arrays):
    np.savez(numbered(folder) / "l.npz", **arrays)
    text = f'[indenter]\nfile = "l.npz"\ndepth_mm = "{depth}"\n'
    return read_by_recipe(folder, told(NUMBERED + text)).captures


def test_an_entry_of_an_array_of_rows_needs_the_index_of_each_axis(tmp_path):
    rows = np.arange(1.0, 11.0).reshape(5, 2)
    with pytest.raises(
        ImportFormatError, match=r"'c\[0\]' is not one .* of shape \(5, 2\), of which one must be named"
    ):
        of_arrays(tmp_path, "c[{press}]", c=rows)
    assert of_arrays(tmp_path, "c[{press}, 0]", c=rows)["1"].indenter.depth_mm == 3.0
    assert of_arrays(tmp_path, "c[{press}]", c=rows[:, :1])["1"].indenter.depth_mm == 3.0
    poses(tmp_path)
    text = POSED.replace("poses.csv", "poses.npz").replace('press = "image"\n', "") + 'matrix = "T"\n'
    with pytest.raises(ImportFormatError, match=r"'T\[0\]' is not one finite number; 'T' contains 80 numbers of shape"):
        read_by_recipe(tmp_path, told(text))


def test_a_transposed_matrix_in_metres_is_refused(tmp_path):
    """Its place, of some millimetres, is then in the last row."""
    poses(tmp_path, lambda row: [*row[:7], *np.diag([1, 1, 1, 1])[:3].ravel(), 0.0, 0.012, 0.003, 1])
    with pytest.raises(ImportFormatError, match=r"matrix of 0 is not a rotation .* must be \[0, 0, 0, 1\]"):
        read_by_recipe(tmp_path, told(POSED + BY_MATRIX))


@pytest.mark.parametrize("columns", [BY_COLUMNS, BY_MATRIX])
def test_a_lost_track_leaves_its_press_out(tmp_path, columns):
    poses(tmp_path, lambda row: [*row[:3], *np.zeros(20)] if row[1] == 0.014 else row)
    found = read_by_recipe(tmp_path, told(POSED + columns))
    assert list(found.captures) == ["0", "1", "3", "4"]
    assert [(why.split(" ")[-1], names) for why, names in found.left_out.items()][1:] in (
        [("rotation", ["2"])],
        [("0", ["2"])],
    )


def test_a_matrix_of_json_lines_and_constants_of_a_pose_are_read(tmp_path):
    poses(tmp_path)
    matrices = [json.loads((tmp_path / f"{k}.json").read_text())["T"] for k in range(5)]
    lines = [json.dumps({"image": f"{k}.png", "T": matrix}) for k, matrix in enumerate(matrices)]
    (tmp_path / "poses.jsonl").write_text("\n".join(lines))
    text = POSED.replace("poses.csv", "poses.jsonl") + 'matrix = "T"\n'
    assert read_by_recipe(tmp_path, told(text)).captures["4"].indenter.tilt_deg == pytest.approx(12.0)
    last = [*(f"m{k}" for k in range(12)), 0.0, 0.0, 0.0, 1.0]
    found = read_by_recipe(tmp_path, told(POSED + f"matrix = {json.dumps(last)}\n")).captures
    assert found["4"].indenter.tilt_deg == pytest.approx(12.0)


@pytest.mark.parametrize("files", ["{press}{depth}mm.png", "{side}{depth}mm.png", "*{depth}mm.png"])
def test_a_number_beside_any_text_is_read_whole(tmp_path, files):
    for k, image in enumerate(PRESSES):
        put(tmp_path / f"{'abcde'[k]}_d{k + 1}.75mm.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    text = (
        f'presses = {{ files = "{files}" }}\nno_contact = {{ file = "rest.png" }}\n[indenter]\ndepth_mm = "{{depth}}"'
    )
    found = read_by_recipe(tmp_path, told(text)).captures.values()
    assert sorted(c.indenter.depth_mm for c in found) == [1.75, 2.75, 3.75, 4.75, 5.75]


def test_a_number_of_a_name_is_finite_and_group_may_be_a_word_of_it(tmp_path):
    for k, image in enumerate(PRESSES):
        put(tmp_path / "ball" / f"{['1e400', '2', '3', '4', '5'][k]}.png", image)
    put(tmp_path / "ball" / "rest.jpg", UNTOUCHED)
    found = read_by_recipe(
        tmp_path,
        told("""
            presses = { files = "{group}/{depth}.png" }
            no_contact = { file = "{group}/rest.jpg" }
            indenter = { depth_mm = "{depth}" }
        """),
    )
    assert [c.indenter.depth_mm for c in found.captures.values()] == [2.0, 3.0, 4.0, 5.0]
    assert list(found.left_out.values()) == [["ball/1e400"]]


def test_the_own_name_of_a_press_goes_before_a_star(tmp_path):
    text = NUMBERED + 'indenter = { shape = { "*" = "ball", "1" = "mesh" }, depth_mm = { "*" = 0.5, "1" = 0.9 } }'
    found = read_by_recipe(numbered(tmp_path), told(text)).captures
    assert [(c.indenter.shape, c.indenter.depth_mm) for c in found.values()][:3] == [
        ("ball", 0.5), ("mesh", 0.9), ("ball", 0.5)]  # fmt: skip


def test_a_table_of_nothing_but_meshes_may_be_extruded():
    text = NUMBERED + 'contact = { search = "outline" }\nscale = { mm_per_px = 0.1 }\n[indenter]\nextruded_mm = 3\n'
    assert told(text + 'shape = { "*" = "mesh" }').indenter.extruded_mm == 3
    with pytest.raises(ValueError, match="not for a ball; leave extruded_mm out"):
        told(text + 'shape = { "1" = "ball", "*" = "mesh" }')


def test_times_of_ros_in_nanoseconds_are_compared(tmp_path):
    (numbered(tmp_path) / "t.csv").write_text("t,z\n" + "".join(f"{k}000000100,{k + 1}\n" for k in range(5)))
    nearest = 'nearest = { column = "t", to = "{press}", factor = 1e9, within = 2e6 }'
    text = NUMBERED + f'[indenter]\nfile = "t.csv"\ndepth_mm = "z"\n{nearest}\n'
    assert read_by_recipe(tmp_path, told(text)).captures["3"].indenter.depth_mm == 4.0
    with pytest.raises(ValueError, match=r"nearest\.to"):
        told(text.replace('"{press}", f', '"t{press}", f'))


def test_an_empty_list_of_json_leaves_its_press_out(tmp_path):
    for k in range(5):
        (tmp_path / f"{k}.json").write_text(json.dumps({"centre": [] if k == 2 else [80, 60], "r": CONTACT_PX}))
    circle = 'circle = { column_px = "centre[0]", row_px = "centre[1]", radius_px = "r" }'
    found = read_by_recipe(numbered(tmp_path), told(NUMBERED + f'[contact]\nfile = "{{press}}.json"\n{circle}'))
    assert found.left_out["its 'centre' is not a finite number"] == ["2"]


def test_heights_without_a_map_at_rest_are_no_depths(tmp_path):
    numbered(tmp_path)
    for k, place in enumerate(PLACES):
        np.save(tmp_path / f"map{k}.npy", 5.0 - pit(*place))
    with pytest.raises(
        ImportFormatError, match=r"exceeds 0\.05 mm in 100 % of the picture, .* If the map holds heights, name"
    ):
        read_by_recipe(tmp_path, told(MAPPED.replace("map{press}", "map{press}.npy")))


@pytest.mark.parametrize("ending", [".png", ".avi"])
def test_the_greatest_depth_of_a_map_is_that_of_its_pixels_between_the_corners(tmp_path, ending):
    """The deepest of all lies beside the gel, and a point of one pixel is not found again by a stretch to half."""
    depths = 0.2 * (pit(60, 80) > 0.0)
    depths[61, 81], depths[5, 5] = 0.7, 3.0
    np.save(tmp_path / "map.npy", depths)
    text = NUMBERED
    if ending == ".avi":
        write_video(tmp_path / "g.avi", grasp())
        text = 'presses = { files = "{press}.avi" }\nno_contact = { frames_before = 10 }\n'
    else:
        numbered(tmp_path)
    text += "[picture]\ncorners_px = [[20, 20], [139, 20], [20, 99], [139, 99]]\nsize_px = [60, 40]\n"
    text += '[contact.depth_map]\nfile = "map.npy"\nvalue_mm = 1\n'
    found = read_by_recipe(tmp_path, told(text)).captures
    assert {capture.indenter.depth_mm for capture in found.values()} == {0.7}


def test_the_force_in_the_name_of_a_video_is_taken(tmp_path):
    write_video(tmp_path / "a_2.5N.avi", grasp())
    text = 'presses = { files = "a_{f}N.avi" }\nno_contact = { frames_before = 10 }\nforce = { column = "{f}" }'
    (capture,) = read_by_recipe(tmp_path, told(text)).captures.values()
    assert capture.force_n == 2.5


def test_a_log_gives_each_video_one_force(tmp_path):
    for name in ("a", "b"):
        write_video(tmp_path / f"{name}.avi", grasp())
    (tmp_path / "log.csv").write_text("Versuch;Kraft [N]\r\na;2,5\r\nb;0,75\r\n")
    text = """
        presses = { files = "{press}.avi" }
        no_contact = { frames_before = 10 }
        force = { file = "log.csv", press = "Versuch", column = "Kraft [N]" }
    """
    found = read_by_recipe(tmp_path, told(text)).captures
    assert {name: capture.force_n for name, capture in found.items()} == {"a": 2.5, "b": 0.75}
    with pytest.raises(ImportFormatError, match=r"log\.csv: has 2 forces for 30 frames, .* name presses by press ="):
        read_by_recipe(tmp_path, told(text.replace('press = "Versuch", ', "")))


def test_a_table_that_counts_from_1_is_not_that_of_an_array_which_counts_from_0(tmp_path):
    np.savez(tmp_path / "set.npz", images=np.stack([eight_bits(image) for image in PRESSES]))
    put(tmp_path / "rest.png", eight_bits(UNTOUCHED))
    lines = [f"{k + 1},0.{k + 1}" for k in range(len(PRESSES))]
    (tmp_path / "t.csv").write_text("\n".join(["n,d", *lines]))
    recipe = told("""
        presses = { files = "set.npz::images[{press}]" }
        picture = { channels = "RGB" }
        no_contact = { file = "rest.png" }
        indenter = { shape = "ball", file = "t.csv", press = "n", depth_mm = "d" }
    """)
    with pytest.raises(ImportFormatError, match=r"t\.csv: the rows in 'n' are numbered from 1, .* subtract 1"):
        read_by_recipe(tmp_path, recipe)


def test_circles_in_metres_and_forces_that_pull_leave_their_press_out(tmp_path):
    lines = [f"{k},{0.001 * k},0.0007,15,{-0.5 if k else 0.5}" for k in range(len(PRESSES))]
    (numbered(tmp_path) / "t.csv").write_text("\n".join(["n,x,y,r,f", *lines]))
    circle = '[contact]\nfile = "t.csv"\npress = "n"\ncircle = { column_px = "x", row_px = "y", radius_px = "r" }\n'
    force = '[force]\nfile = "t.csv"\npress = "n"\ncolumn = "f"\n'
    with pytest.raises(ImportFormatError, match=r"in pixel 0, 0; check the unit \(px\)"):
        read_by_recipe(tmp_path, told(NUMBERED + circle))
    found = read_by_recipe(tmp_path, told(NUMBERED + force))
    assert list(found.captures) == ["0"]
    assert (
        "its force is -0.5 N, which is a pull; if the file counts a push as negative, give a factor below 0"
        in found.left_out
    )
    assert len(read_by_recipe(tmp_path, told(NUMBERED + force + "factor = -1\n")).captures) == len(PRESSES) - 1


def test_a_depth_that_falls_as_the_gel_is_pressed_in_is_the_z_of_a_pose(tmp_path):
    """As the refusal of a negative depth says."""
    (numbered(tmp_path) / "t.csv").write_text("n,z\n" + "".join(f"{k},{-0.2 - 0.1 * k}\n" for k in range(len(PRESSES))))
    text = NUMBERED + '[indenter]\nshape = "ball"\nfile = "t.csv"\npress = "n"\n'
    with pytest.raises(ImportFormatError, match=r"is below 0 in the table, but must be above 0; if the column falls"):
        read_by_recipe(tmp_path, told(text + 'depth_mm = "z"'))
    pose = '[indenter.pose]\nz = "z"\nx = 0\ny = 0\nunit = "mm"\nfirst_touch_mm = 0\n'
    found = read_by_recipe(tmp_path, told(text + pose)).captures
    assert [c.indenter.depth_mm for c in found.values()] == pytest.approx([0.2 + 0.1 * k for k in range(len(PRESSES))])


@pytest.mark.parametrize("ending", [".txt", ".csv", ".dat"])
def test_numbers_without_names_are_read_by_their_places(tmp_path, ending):
    """As numpy.savetxt writes them: one file of all presses, and one for each."""
    mark = "," if ending == ".csv" else " "
    for k, (row, column) in enumerate(PLACES):
        (tmp_path / f"at_{k}{ending}").write_text(f"# column row\n{column:.4e}{mark}{row:.4e}\n")
    lines = [f"20.5{mark}{0.2 + 0.1 * k}" for k in range(len(PLACES))]
    (numbered(tmp_path) / f"all{ending}").write_text("\n".join(lines))
    contact = (
        f'[contact]\nfile = "at_{{press}}{ending}"\ncircle = {{ column_px = "[0]", row_px = "[1]", radius_px = 20 }}\n'
    )
    text = NUMBERED + contact + f'[indenter]\nshape = "ball"\nfile = "all{ending}"\ndepth_mm = "[{{press}}, 1]"'
    found = read_by_recipe(tmp_path, told(text)).captures.values()
    assert [(c.contact_circle.row_px, c.contact_circle.column_px) for c in found] == PLACES
    assert [c.indenter.depth_mm for c in found] == pytest.approx([0.2 + 0.1 * k for k in range(len(PLACES))])
    for words, message in (("1 2\n3\n", "lines of equally many numbers"), ("x,y\n1,2\n", "'x' is not a finite number")):
        (tmp_path / f"all{ending}").write_text(words)
        with pytest.raises(ImportFormatError, match=message):
            read_by_recipe(tmp_path, told(text))


def test_a_table_of_paths_from_elsewhere_names_presses_that_share_their_file_name(tmp_path):
    for k, image in enumerate(PRESSES[:4]):
        put(tmp_path / "raw" / f"day{k // 2}" / f"press{k % 2}" / "gel.png", image)
    put(tmp_path / "rest.png", UNTOUCHED)
    lines = [f"..\\raw\\day{k // 2}\\press{k % 2}\\gel.png,{0.3 + 0.1 * k}" for k in range(4)]
    text = """
        presses = { files = "raw/day{day}/press{number}/gel.png" }
        no_contact = { file = "rest.png" }
        indenter = { shape = "ball", file = "t.csv", press = "path", depth_mm = "z" }
    """
    for ours in (lines, [line.replace("..\\raw\\", "") for line in lines]):
        (tmp_path / "t.csv").write_text("\n".join(["path,z", *ours]))
        found = read_by_recipe(tmp_path, told(text)).captures
        assert [c.indenter.depth_mm for c in found.values()] == pytest.approx([0.3, 0.4, 0.5, 0.6])
    # of another day, or of no day: not those of a press that only shares the end
    (tmp_path / "t.csv").write_text("path,z\npress0/gel.png,0.3\nday9/press1/gel.png,0.4\n")
    with pytest.raises(ImportFormatError, match=r"none of the 4 presses can be read"):
        read_by_recipe(tmp_path, told(text))
