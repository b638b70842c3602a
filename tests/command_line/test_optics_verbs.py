"""``finray design show`` and ``finray simulate render --images`` on small pictures."""

import cv2
import numpy as np
import OpenEXR
import pytest

from data_schemas import SimulatedPress, TactileCapture, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.cli import current_spelling
from sim import read_design
from sim.surface_meshes import pressed_shape, rest_shape, store_shapes
from tests.command_line.running import finray, succeed


@pytest.fixture
def design(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text('preset = "flat-70x35"\nname = "small finger"\n[camera]\nwidth_px = 128\nheight_px = 96\n')
    return path


def test_view_is_told_and_drawn(design, tmp_path):
    told = succeed(f"design show {design} --engine scalar --out {tmp_path}/view.png")
    assert told.startswith("small finger: the camera sees 9")
    assert "px/mm" in told
    picture = cv2.imread(str(tmp_path / "view.png"))
    # the finger above, its camera's view below
    assert picture.shape[1] == 1320
    assert picture.shape[0] > 1500
    again = finray(f"design show {design} --engine scalar --out {tmp_path}/view.png")
    assert again.status == 2
    assert "view.png: exists already" in again.err


def test_a_preset_is_shown_by_its_name():
    assert succeed("design show flat-70x35 --engine scalar").startswith("flat-70x35: the camera sees 9")


def test_parts_that_do_not_fit_are_told_before_anything_is_shown(design, tmp_path):
    design.write_text(design.read_text() + "[skeleton]\nrib_count = 40\nrib_thickness_mm = 1.8\n")
    for out in ("", f" --out {tmp_path}/view.png"):
        outcome = finray(f"design show {design} --engine scalar{out}")
        assert outcome.status == 2
        assert outcome.out == ""
        assert f"{design}: " in outcome.err
        assert "overlap or nearly touch" in outcome.err
    assert not (tmp_path / "view.png").exists()


def test_camera_that_sees_nothing_and_missing_calibration_are_told(design, tmp_path):
    text = design.read_text()
    design.write_text(text + 'calibration = "lens.yaml"\n')
    outcome = finray(f"design show {design} --engine scalar")
    assert outcome.status == 2
    assert "lens.yaml: no such file; give the path of an OpenCV calibration" in outcome.err
    # a principal point far off the picture: all pixels look past the mirror
    (tmp_path / "lens.yaml").write_text(
        "image_width: 128\nimage_height: 96\ncamera_matrix: [900, 0, 4000, 0, 900, 48, 0, 0, 1]\n"
        "distortion_coefficients: [0, 0, 0, 0]\n"
    )
    outcome = finray(f"design show {design} --engine scalar")
    assert outcome.status == 2
    assert "the camera does not see the coated face" in outcome.err
    assert "camera.calibration (lens.yaml)" in outcome.err


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ("{design} {paints}", "render {design} {paints}"),
        ("{design} {paints} --only optics --denoise", "render {design} {paints} --denoise --images"),
        ("--only=mechanics {design} --increments 2", "press {design} --increments 2"),
        ("{design} --only mechanics", "press {design}"),
        ("{design} {paints} --angles 0:90:30", "sweep {design} {paints} --angles 0:90:30"),
        ("{design} --angles=0:90:30", "sweep {design} --angles=0:90:30"),
    ],
)
def test_an_earlier_spelling_says_what_to_type_now(before, now, capsys):
    names = {"design": "a/my.toml", "paints": "--paint red=r.json --paint green=g.json"}
    assert current_spelling(f"simulate {before.format(**names)}".split()) == f"simulate {now.format(**names)}".split()
    assert (
        f"will be removed in the next one; type finray simulate {now.format(**names)} instead\n"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("words", ["", "fit a.json --map", "simulate", "simulate --help", "simulate press d.toml"])
def test_a_spelling_of_now_is_left_alone(words, capsys):
    assert current_spelling(words.split()) == words.split()
    assert capsys.readouterr().err == ""


def test_an_earlier_spelling_does_the_same_and_is_stored_as_spelled_now(design, paints, tmp_path, monkeypatch):
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    rest = f"{design} {files} --engine scalar --samples 2 --seed 3 --out"
    told = finray(f"simulate {rest} {tmp_path}/before.press.json")
    assert told.status == 0
    assert told.err.startswith(
        "this spelling is from an earlier version and will be removed in the next one; type finray sim"
    )
    succeed(f"simulate render {rest} {tmp_path}/now.press.json")
    before, now = (read_record(tmp_path / f"{name}.press.json", SimulatedPress) for name in ("before", "now"))
    np.testing.assert_array_equal(before.contact, now.contact)
    assert before.provenance.input_sha256 == now.provenance.input_sha256


def test_a_mistyped_job_is_told(design):
    outcome = finray(f"simulate presss {design}")
    assert outcome.status == 2
    assert "invalid choice: 'presss' (choose from" in outcome.err


def test_surfaces_are_rendered_with_the_design_beside_them(paints, tmp_path):
    small = "[camera]\nwidth_px = 64\nheight_px = 48\n[indenter]\ndepth_mm = 0.5\n"
    (tmp_path / "d.toml").write_text(f'preset = "baby-48x18"\nname = "small"\n{small}')
    succeed(f"simulate press {tmp_path}/d.toml --increments 1 --out {tmp_path}/d.press.json")
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    how = f"{files} --engine scalar --samples 2"
    succeed(f"simulate render {tmp_path}/d.surfaces.json {how} --out {tmp_path}/alone.press.json")
    surfaces = f"--surfaces {tmp_path}/d.surfaces.json"
    succeed(f"simulate render {tmp_path}/d.toml {surfaces} {how} --out {tmp_path}/both.press.json")
    alone, both = (read_record(tmp_path / f"{name}.press.json", SimulatedPress) for name in ("alone", "both"))
    np.testing.assert_array_equal(alone.contact, both.contact)
    assert alone.design == both.design
    (tmp_path / "d.mechanics.json").unlink()
    refused = finray(f"simulate render {tmp_path}/d.surfaces.json {how} --out {tmp_path}/no.press.json")
    assert refused.status == 2
    assert "stored in d.mechanics.json, but d.mechanics.json is missing from the folder" in refused.err


def test_optics_writes_record_capture_and_images(design, paints, tmp_path):
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    run = (
        f"simulate render {design} {files} --images --engine scalar --samples 2 --seed 3 --out {tmp_path}/a.press.json"
    )
    told = succeed(run)
    assert "a.capture.json: 10-bit raw counts" in told
    assert "camera response to the LED: uncertain by 30 %" in told
    press = read_record(tmp_path / "a.press.json", SimulatedPress)
    capture = read_record(tmp_path / "a.capture.json", TactileCapture)
    assert capture.contact.shape == (96, 128, 1)
    assert capture.source == f"simulated: {press.label}"
    assert any("camera response to the LED" in note for note in press.notes)
    folder = tmp_path / "a.optics"
    with OpenEXR.File(str(folder / "bands.exr"), separate_channels=True) as file:
        bands = {name: channel.pixels for name, channel in file.channels().items()}
        red = sum(image for name, image in bands.items() if name.startswith("contact.") and name.endswith(">red"))
    np.testing.assert_allclose(red, press.contact_bands[..., 0], rtol=1e-5)
    assert {p.name for p in folder.glob("contact-view*")} >= {"contact-view.png", "contact-view-pi.png"}
    again = finray(run)
    assert again.status == 2
    assert "a.press.json: exists already" in again.err


def test_render_of_stored_surfaces_has_the_push_that_they_had(design, paints, tmp_path):
    finger = read_design(design)
    early = finger.indenter.model_copy(update={"depth_mm": 0.75})
    pressed = pressed_shape(finger.model_copy(update={"indenter": early}))
    surfaces = store_shapes(rest_shape(finger), pressed, "ended early", push_mm=0.75)
    write_record(surfaces, tmp_path / "early.surfaces.json", provenance("test", {}, 1))
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    run = f"simulate render {design} {files} --surfaces {tmp_path}/early.surfaces.json --engine scalar --samples 2"
    succeed(f"{run} --out {tmp_path}/early.press.json")
    press = read_record(tmp_path / "early.press.json", SimulatedPress)
    assert press.name == "small finger, press of 0.75 mm"
    assert press.design is not None
    assert press.design.indenter == early != finger.indenter
