"""``finray design show`` and ``finray simulate --only optics`` on small pictures."""

import cv2
import numpy as np
import OpenEXR
import pytest

from data_schemas import SimulatedPress, TactileCapture, provenance
from data_schemas.storage import read_record, write_record
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
    ("options", "message"),
    [
        ("--denoise", "--denoise makes pictures, which --only optics writes"),
        ("--only optics --angles 0:90:30", "--angles writes no images"),
    ],
)
def test_options_that_exclude_each_other(design, options, message):
    outcome = finray(f"simulate {design} --paint red=r.json --paint green=g.json {options}")
    assert outcome.status == 2
    assert message in outcome.err


def test_optics_writes_record_capture_and_images(design, paints, tmp_path):
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    run = f"simulate {design} {files} --only optics --engine scalar --samples 2 --seed 3 --out {tmp_path}/a.press.json"
    told = succeed(run)
    assert "a.capture.json: raw counts of 10 bit" in told
    assert "camera response at the LED uncertain by 30%" in told
    press = read_record(tmp_path / "a.press.json", SimulatedPress)
    capture = read_record(tmp_path / "a.capture.json", TactileCapture)
    assert capture.contact.shape == (96, 128, 1)
    assert capture.source == f"simulated: {press.label}"
    assert any("camera response at the LED" in note for note in press.notes)
    folder = tmp_path / "a.optics"
    with OpenEXR.File(str(folder / "bands.exr"), separate_channels=True) as file:
        bands = {name: channel.pixels for name, channel in file.channels().items()}
        red = sum(image for name, image in bands.items() if name.startswith("contact.") and name.endswith(">red"))
    np.testing.assert_allclose(red, press.contact_bands[..., 0], rtol=1e-5)
    assert (folder / "contact-view.png").exists()
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
    run = f"simulate {design} {files} --surfaces {tmp_path}/early.surfaces.json --engine scalar --samples 2"
    succeed(f"{run} --out {tmp_path}/early.press.json")
    press = read_record(tmp_path / "early.press.json", SimulatedPress)
    assert press.name == "small finger, press of 0.75 mm"
    assert press.design is not None
    assert press.design.indenter == early != finger.indenter
