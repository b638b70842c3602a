"""Taxim and gs_sdk folders become captures; nothing pickled is ever loaded; wrong folders are refused."""

import io
import json
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from data_schemas import ImportFormatError, NormalMapRecord, TactileCapture, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.exchange import read_ball_presses, read_circles, read_taxim
from finray_calib.exchange._ball_presses import read_npz, require_array
from finray_calib.sensing import BoardUncertainty, BoardView, normal_map_record, pixel_scale
from tests.capture.drivers.programs import others_python
from tests.command_line.running import finray, succeed
from tests.compare.board_scenes import BOARD, PINHOLE, board_views, pose_of, poses
from tests.exchange.ball_press_folders import (
    BALL_DIAMETER_MM,
    MM_PER_PX,
    eight_bits,
    presses,
    write_catalog,
    write_circles,
    write_taxim,
)
from tests.schemas.stored_files import write_sealed


def test_taxim_presses_keep_colour_order_place_and_size(tmp_path):
    found = read_taxim(write_taxim(tmp_path / "t"), BALL_DIAMETER_MM)
    assert len(found.captures) == 12
    for capture, press in zip(found.captures, presses(12), strict=True):
        # RGB as the lights are; in the file it is BGR
        assert np.array_equal(capture.contact, eight_bits(press.contact))
        circle = capture.contact_circle
        assert circle is not None
        assert (circle.row_px, circle.column_px, circle.radius_px) == (press.row_px, press.column_px, press.radius_px)
        assert (capture.encoding, capture.bit_depth, capture.exposure_s) == ("unknown", 8, None)
        assert capture.mm_per_px == MM_PER_PX
        assert 2.0 * capture.indenter.radius_mm == BALL_DIAMETER_MM
    assert found.assumed == ()


def test_the_ball_of_taxim_is_assumed_and_told(tmp_path):
    folder = write_taxim(tmp_path / "t")
    found = read_taxim(folder)
    assert found.captures[0].indenter.radius_mm == 2.0
    assert found.assumed == ("a ball of 4 mm diameter, as in Taxim's own folders",)


def test_pickled_parts_are_left_out_and_never_loaded(tmp_path):
    sprung = tmp_path / "sprung"
    folder = write_taxim(tmp_path / "t", trap=sprung)
    with np.load(folder / "dataPack.npz", allow_pickle=True) as file:
        file["names"]
    assert sprung.exists()  # the trap works
    sprung.unlink()
    found = read_taxim(folder, BALL_DIAMETER_MM)
    assert not sprung.exists()
    assert "dataPack.npz, 'names': pickled objects are never loaded" in found.left_out
    assert "shadowTable.npz: pickled objects are never loaded" in found.left_out
    assert any(line.startswith("polycalib.npz: ") for line in found.left_out)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"imgs": None}, "contains only the image without contact, but no presses"),
        ({"f0": None}, "'f0' is missing; the file contains img_size, imgs"),
        ({"f0": np.zeros((60, 80))}, "'f0' must be an array of finite numbers with 3 dimensions"),
        ({"f0": np.zeros((60, 80, 3))}, "'f0' must contain 8-bit colour images"),
        ({"f0": np.zeros((50, 80, 3), np.uint8)}, "press 1: the image has shape .* but the no-contact image"),
        ({"touch_radius": np.ones(3)}, "'imgs' has 12 images, each of which needs a centre"),
        (
            {"touch_radius": np.full(12, 30.0)},
            "press 1: the contact circle has a radius of 30 px, .* below the radius of the ball, 20 px",
        ),
        ({"touch_radius": np.full(12, np.nan)}, "'touch_radius' must be an array of finite numbers"),
        ({"touch_center": np.full((12, 2), 70.0)}, "row 70, column 70, lies outside the picture of 80 x 60 px"),
        ({"imgs": np.array([None, 1], dtype=object)}, "'imgs' is stored as pickled objects, which are never loaded"),
    ],
)
def test_wrong_data_packs_are_refused(tmp_path, changed, message):
    with pytest.raises(ImportFormatError, match=message):
        read_taxim(write_taxim(tmp_path / "t", **changed), BALL_DIAMETER_MM)


def test_wrong_taxim_folders_are_refused(tmp_path):
    with pytest.raises(ImportFormatError, match="no such folder; give a Taxim calibration folder"):
        read_taxim(tmp_path / "none")
    folder = write_taxim(tmp_path / "t")
    for text, message in (("{", "cannot be read as JSON"), ('{"sensor": {}}', "KeyError"), ("[]", "TypeError")):
        (folder / "params.json").write_text(text)
        with pytest.raises(ImportFormatError, match=message):
            read_taxim(folder)
    (folder / "params.json").unlink()
    with pytest.raises(ImportFormatError, match=r"millimetres per pixel is not stated .*; give it with --mm-per-px"):
        read_taxim(folder)
    assert read_taxim(folder, BALL_DIAMETER_MM, 0.1).captures[0].mm_per_px == 0.1
    with pytest.raises(ImportFormatError, match=r"millimetres per pixel must be above 0 and at most 1 mm, got 7 mm"):
        read_taxim(folder, mm_per_px=7.0)
    with pytest.raises(ImportFormatError, match=r"the ball's diameter must be above 0 .* got -1 mm"):
        read_taxim(folder, -1.0, 0.1)


def test_npz_that_are_none(tmp_path):
    with pytest.raises(ImportFormatError, match="no such file, but the folder must contain it"):
        read_npz(tmp_path / "x.npz")
    for content in (b"", b"PK\x03\x04 torn", b"\x80\x04K\x01."):
        (tmp_path / "x.npz").write_bytes(content)
        with pytest.raises(ImportFormatError, match="cannot be read as npz"):
            read_npz(tmp_path / "x.npz")
    with (tmp_path / "x.npz").open("wb") as file:
        np.save(file, np.ones(3))
    with pytest.raises(ImportFormatError, match="cannot be read as npz"):
        read_npz(tmp_path / "x.npz")
    with pytest.raises(ImportFormatError, match="the file contains nothing"):
        require_array({}, (), "a", 1, tmp_path / "x.npz")


def npy(array):
    """The bytes of an npy file."""
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npy_header(shape):
    """An npy file of numbers that ends after its header."""
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def write_member(path, content):
    """An npz file whose 'a' holds these bytes, beside a text and an array in order."""
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.npy", content)
        file.writestr("b.npy", npy(np.ones(3)))
        file.writestr("readme.txt", "hello")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(np.ones(10))[:-20], "cannot be read as npz .*; copy it again, or have its owner save it again"),
        (npy_header((10**15,)), "cannot be read as npz .*at most 512 MB are allowed"),
        (npy_header((10**30,)), "cannot be read as npz .*at most 512 MB are allowed"),
        (npy_header((-5,)), r"cannot be read as npz .*\(-5,\) is not a valid shape"),
        (b"\x93NUMPY\x01\x00\x05\x00(((((", "cannot be read as npz"),
    ],
)
def test_damaged_arrays_are_refused_by_name_and_never_called_pickled(tmp_path, content, message):
    write_member(tmp_path / "x.npz", content)
    with pytest.raises(ImportFormatError, match=rf"x\.npz: {message}"):
        read_npz(tmp_path / "x.npz")


def test_every_damaged_byte_of_a_compressed_npz_is_refused_or_harmless(tmp_path):
    path = tmp_path / "x.npz"
    values = np.random.default_rng(1).normal(size=100)
    np.savez_compressed(path, a=values)
    content, refused = path.read_bytes(), 0
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            arrays, pickled = read_npz(path)
        except ImportFormatError as error:
            assert str(error).startswith(f"{path}: cannot be read as npz")  # noqa: PT017
            refused += 1
        else:  # a date, a comment or the member's name
            assert pickled == ()
            assert all(np.array_equal(array, values) for array in arrays.values())
    assert refused > 0.8 * len(content)  # the compressed array is 899 of the 1027 bytes


def test_members_that_are_no_arrays_are_left_out(tmp_path):
    write_member(tmp_path / "x.npz", b"hello")
    arrays, pickled = read_npz(tmp_path / "x.npz")
    assert (list(arrays), pickled) == (["b"], ())
    with pytest.raises(ImportFormatError, match=r"x\.npz: array 'a' is missing; the file contains b"):
        require_array(arrays, pickled, "a", 1, tmp_path / "x.npz")
    write_member(tmp_path / "x.npz", npy(np.array([None])))
    assert read_npz(tmp_path / "x.npz")[1] == ("a",)


def test_a_gs_sdk_folder_without_all_labels(tmp_path):
    found = read_ball_presses(write_catalog(tmp_path / "g", 3, labelled=2), MM_PER_PX)
    assert [c.name for c in found.captures] == ["4.000mm/0", "4.000mm/1"]
    assert found.left_out == ("4.000mm/2: has no label.npz and so no contact circle",)
    for capture, press in zip(found.captures, presses(3), strict=False):
        assert np.array_equal(capture.contact, eight_bits(press.contact))
        assert capture.contact_circle is not None
        assert capture.contact_circle.column_px == press.column_px
        assert 2.0 * capture.indenter.radius_mm == BALL_DIAMETER_MM


def test_plain_images_with_circles(tmp_path):
    found = read_ball_presses(write_circles(tmp_path / "c"), MM_PER_PX, BALL_DIAMETER_MM)
    circle = found.captures[1].contact_circle
    assert circle is not None
    assert circle.row_px == presses(2)[1].row_px
    with pytest.raises(ImportFormatError, match=r"the ball's diameter is not stated .*; give it with --ball-diam"):
        read_ball_presses(tmp_path / "c", MM_PER_PX)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("catalog.csv", "folder\nx\n", "must name the columns experiment_reldir, but experiment_reldir is missing"),
        ("catalog.csv", "experiment_reldir\n../up\n", "line 2: '../up' must be a path within the folder"),
        ("catalog.csv", "experiment_reldir\n/etc\n", "must be a path within the folder"),
        ("catalog.csv", "experiment_reldir\nC:\\x\n", "must be a path within the folder"),
        ("catalog.csv", "experiment_reldir\nnone\n", "contains no labelled press"),
        ("catalog.csv", b"\xff\xfe\x00", "cannot be read as UTF-8 text"),
        (
            "catalog.csv",
            'experiment_reldir\n"4.000mm/0\n',
            r"catalog\.csv, line 2: cannot be read as CSV \(unexpected end",
        ),
        ("catalog.csv", '"experiment_reldir\n4.000mm/0\n', r"catalog\.csv, line 2: .* close or remove the quotation"),
        ("catalog.csv", "experiment_reldir,diameter(mm)\n4.000mm/0,four\n", "line 2: .* must be a number in mm"),
        ("catalog.csv", "experiment_reldir,diameter(mm)\n4.000mm/0,0\n", "must be above 0 .* got 0 mm"),
        ("4.000mm/0/gelsight.png", b"", "is neither PNG nor JPEG"),
        ("background.png", b"", "is neither PNG nor JPEG"),
    ],
)
def test_wrong_gs_sdk_folders_are_refused(tmp_path, file, content, message):
    folder = write_catalog(tmp_path / "g", 1)
    (folder / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ImportFormatError, match=message):
        read_ball_presses(folder, MM_PER_PX)


def test_what_is_missing_or_disagrees_is_refused(tmp_path):
    folder = write_catalog(tmp_path / "g", 1)
    with pytest.raises(ImportFormatError, match="the catalog states a ball of 4 mm, but --ball-diameter-mm is 5 mm"):
        read_ball_presses(folder, MM_PER_PX, 5.0)
    np.savez(folder / "4.000mm/0/label.npz", center=[1.0, 2.0, 3.0], radius=1.0)
    with pytest.raises(ImportFormatError, match=r"'center' must be \(x, y\)"):
        read_ball_presses(folder, MM_PER_PX)
    (folder / "catalog.csv").unlink()
    with pytest.raises(ImportFormatError, match=r"neither catalog\.csv .* nor circles\.csv"):
        read_ball_presses(folder, MM_PER_PX)
    (folder / "background.png").unlink()
    with pytest.raises(ImportFormatError, match=r"background\.png"):
        read_ball_presses(folder, MM_PER_PX)
    with pytest.raises(ImportFormatError, match=r"no such folder; give a folder with background\.png"):
        read_ball_presses(tmp_path / "none", MM_PER_PX)
    bare = write_catalog(tmp_path / "b", 1, diameters=False)
    (bare / "4.000mm/0/gelsight.png").unlink()
    with pytest.raises(ImportFormatError, match=r"gelsight.png: no such file"):
        read_ball_presses(bare, MM_PER_PX, BALL_DIAMETER_MM)


def test_a_press_that_a_catalog_lists_twice_is_refused(tmp_path):
    folder = write_catalog(tmp_path / "f")
    with (folder / "catalog.csv").open("a") as file:
        file.write(f"4.000mm/1,{BALL_DIAMETER_MM:.3f}\n")  # line 3 writes it with a backslash
    with pytest.raises(ImportFormatError, match=r"catalog\.csv, line 5: the press 4\.000mm/1 is listed twice"):
        read_ball_presses(folder, MM_PER_PX, BALL_DIAMETER_MM)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("a.png,1,x,3", "line 2: row_px must be a number, got 'x'"),
        ("a.png,1,inf,3", "row_px must be a number"),
        ("a.png,1,2", "radius_px must be a number, got ''"),
        ("a.png,1,2,0", "line 2: radius_px = 0 must be above 0"),
        ("a.png,1,2,3\na.png,1,2,3", "line 3: a.png already has a circle"),
        ('a.png,1,2,3\n"b.png,1,2,3', "line 3: cannot be read as CSV"),
        ("a.png,1,2,3\n" * 2001, "lists 2001 presses, but at most 2000 can be read"),
        ("a" * 140_000 + ",1,2,3", r"line 2: cannot be read as CSV \(field larger than field limit"),
    ],
)
def test_wrong_circles_are_refused(tmp_path, line, message):
    path = tmp_path / "circles.csv"
    path.write_text(f"image,column_px,row_px,radius_px\n{line}\n")
    with pytest.raises(ImportFormatError, match=message):
        read_circles(path)


def test_from_a_taxim_folder_to_a_normal_map(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_taxim(tmp_path / "t", trap=tmp_path / "sprung")
    said = succeed("import taxim t")
    assert "t.captures: 12 captures, 80 x 60 px, encoding unknown" in said
    assert "left out: shadowTable.npz" in said
    assert "assumed: a ball of 4 mm diameter" in said
    files = " ".join(str(p) for p in sorted((tmp_path / "t.captures").glob("*.json")))
    said = succeed(f"sense teach {files} --out map.json")
    assert "map.json: normal map of 12 presses, 80 x 60 px" in said
    record = read_record(tmp_path / "map.json", NormalMapRecord)
    assert np.median(record.held_out_explained_rel) > 0.9  # six presses teach each half
    assert record.encoding == "unknown"
    again = finray("import taxim t")
    assert again.status == 2
    assert "exists already" in again.err
    few = finray(f"sense teach {files.split()[0]} --out few.json")
    assert few.status == 2
    assert f"{files.split()[0]}: a normal map needs" in few.err
    assert "needs at least 12 ball presses, got 1" in few.err


def test_ball_presses_of_the_command_line(tmp_path):
    folder = write_catalog(tmp_path / "g", 2, labelled=1)
    said = succeed(f"import ball-presses {folder} --mm-per-px {MM_PER_PX} --out {tmp_path}/o")
    assert "1 capture, 80 x 60 px" in said
    assert "left out: 4.000mm/1: has no label.npz" in said
    capture = read_record(tmp_path / "o/press-001.capture.json", TactileCapture)
    assert capture.provenance is not None
    assert f"{folder}/catalog.csv" in capture.provenance.input_sha256
    assert finray(f"import ball-presses {folder} --out {tmp_path}/p").status == 2


def test_circles_for_captures_that_have_none(tmp_path):
    folder = write_taxim(tmp_path / "t")
    succeed(f"import taxim {folder} --out {tmp_path}/o")
    files = sorted((tmp_path / "o").glob("*.json"))
    lines = ["image,column_px,row_px,radius_px"]
    for file, press in zip(files, presses(12), strict=True):
        body = json.loads(file.read_text())
        body["record"]["contact_circle"] = None
        write_sealed(file, body)
        lines.append(f"{file.name},{press.column_px},{press.row_px},{press.radius_px}")
    named = " ".join(map(str, files))
    outcome = finray(f"sense teach {named} --out {tmp_path}/m.json")
    assert outcome.status == 2
    assert f"{files[0]}: " in outcome.err
    assert "press 1: a normal map is trained only on presses of a ball with a known contact circle" in outcome.err
    (tmp_path / "circles.csv").write_text("\n".join(lines[:-1]) + "\n")
    outcome = finray(f"sense teach {named} --circles {tmp_path}/circles.csv --out {tmp_path}/m.json")
    assert outcome.status == 2
    assert "circles.csv: the circle of press-012.capture.json is missing" in outcome.err
    (tmp_path / "circles.csv").write_text("\n".join(lines) + "\n")
    assert "12 presses" in succeed(f"sense teach {named} --circles {tmp_path}/circles.csv --out {tmp_path}/m.json")


def test_a_circle_is_not_given_to_two_captures_of_one_name(tmp_path):
    """Sessions number their contacts alike: each has its press-001.json."""
    for session in ("one", "two"):
        write_taxim(tmp_path / f"{session}.taxim")
        succeed(f"import taxim {tmp_path}/{session}.taxim --out {tmp_path}/{session}")
    (tmp_path / "circles.csv").write_text("image,column_px,row_px,radius_px\npress-001.capture.json,40,30,12\n")
    files = " ".join(f"{tmp_path}/{session}/press-001.capture.json" for session in ("one", "two"))
    outcome = finray(f"sense teach {files} --circles {tmp_path}/circles.csv --out {tmp_path}/m.json")
    assert outcome.status == 2
    assert "two captures have the name press-001.capture.json" in outcome.err


def test_the_measured_scale_takes_the_place_of_the_stated_one(tmp_path):
    """A board straight in front of an ideal camera of the presses' size: mm per px is distance over focal length."""
    rng = np.random.default_rng(1)
    lens = np.array([50.0, 50.0, 39.5, 29.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    distance_mm = 50.0 * 1.1 * MM_PER_PX
    shrunk = BOARD.model_copy(update={"square_mm": 0.2, "marker_mm": 0.14})
    share = 0.2 / BOARD.square_mm
    poses_mm = [pose_of([0.0, 0.0, 0.0], (0.0, 0.0, distance_mm / share)), *poses("pinhole", PINHOLE, rng, 8)[1:]]
    views = [
        BoardView(view.name, view.places_mm * share, view.pixels)
        for view in board_views("pinhole", lens, poses_mm, rng, noise_px=0.005)
    ]
    scale = pixel_scale(views[0], views[1:], (80, 60), shrunk, BoardUncertainty(0.002), 1, "pinhole")
    write_record(scale, tmp_path / "scale.json", provenance("pytest"))
    succeed(f"import taxim {write_taxim(tmp_path / 't')} --out {tmp_path}/o")
    files = " ".join(map(str, sorted((tmp_path / "o").glob("*.json"))))
    succeed(f"sense teach {files} --scale {tmp_path}/scale.json --out {tmp_path}/m.json")
    taught = read_record(tmp_path / "m.json", NormalMapRecord)
    assert taught.mm_per_px == pytest.approx(1.1 * MM_PER_PX, rel=5 * scale.middle.mean_u_rel)
    assert taught.mm_per_px_u_rel == pytest.approx(scale.middle.mean_u_rel)
    assert taught.provenance is not None
    assert f"{tmp_path}/scale.json" in taught.provenance.input_sha256
    other = scale.model_copy(update={"calibration": scale.calibration.model_copy(update={"width_px": 640})})
    write_record(other, tmp_path / "other.json", provenance("pytest"))
    outcome = finray(f"sense teach {files} --scale {tmp_path}/other.json --out {tmp_path}/n.json")
    assert outcome.status == 2
    assert "was measured on pictures of 640 x 60 px" in outcome.err


def test_an_image_that_is_none_is_refused(tmp_path):
    folder = write_circles(tmp_path / "c", 1)
    (folder / "0.png").write_bytes((folder / "circles.csv").read_bytes())
    with pytest.raises(ImportFormatError, match=r"0\.png: is neither PNG nor JPEG"):
        read_ball_presses(folder, MM_PER_PX, BALL_DIAMETER_MM)


@pytest.mark.rigs
@pytest.mark.timeout(1200)
def test_real_presses_of_a_gelsight_teach_a_map(tmp_path):
    """The 48 presses that Taxim's port ships (MIT): the score on unseen ones that the how-to states."""
    python = others_python("taxim[jax-cpu]")
    where = "import importlib.util as u; s = u.find_spec('taxim'); print(s.submodule_search_locations[0] if s else '')"
    found = subprocess.run([python, "-c", where], capture_output=True, text=True, check=True).stdout.strip()
    if not found:
        pytest.skip("TAXIM ABSENT: pip install 'taxim[jax-cpu]==1.4.1' into that environment; NO real presses tested")
    captures = read_taxim(Path(found) / "calib" / "gelsight").captures
    assert len(captures) == 48
    record = normal_map_record(captures, "GelSight", seed=1)
    # measured 0.950 [0.929, 0.956] and 5.5 [5.2, 6.2] deg; other random halves move it by less than 0.02 and 0.5 deg
    assert np.median(record.held_out_explained_rel) == pytest.approx(0.95, abs=0.02)
    assert np.median(record.held_out_angle_deg) == pytest.approx(5.5, abs=0.5)
