"""Classic sensors at the command line: listed, written, shown, rendered, and refused where they are no fingers."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from data_schemas import SensorFit, SimulatedPress, provenance
from data_schemas.storage import read_record, write_record
from finray_calib import render_sensor
from sim import SENSORS, preset_sensor, read_sensor
from tests.command_line.running import finray, succeed
from tests.simulate.drawn_sensor import captured

SMALL = "[camera]\nwidth_px = 16\nheight_px = 16\n"


@pytest.fixture
def design(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(f'preset = "gelsight-flat"\nname = "small sensor"\n{SMALL}')
    return path


def test_listed_and_written(tmp_path):
    listed = succeed("design list")
    assert all(name in listed for name in SENSORS)
    told = succeed(f"design init 9dtact --out {tmp_path}/mine.toml")
    assert told == f"{tmp_path}/mine.toml: the design, to be edited\nnext: finray design show {tmp_path}/mine.toml\n"
    shown = succeed(f"design show {tmp_path}/mine.toml --engine scalar")
    ready = succeed("design show 9dtact --engine scalar")
    assert shown == ready.replace("design show 9dtact", f"design show {tmp_path}/mine.toml")


def test_shown_with_origins_and_drawn(design, tmp_path):
    design.write_text(design.read_text() + '[uncertainty_rel]\n"pad.refractive_index" = 0.01\n')
    told = succeed(f"design show {design} --engine scalar --out {tmp_path}/view.png")
    assert told.startswith("small sensor: 100 % of the picture shows the coat")
    # 16 mm over 16 pixels, by the field of view
    assert "a pixel is      1.00" in told
    assert "paper      pad.refractive_index = 1.5403 (standard uncertainty 1.0 %)" in told
    assert "red light       at x = 0.0, y = -4.3, z = -12.6 mm from the middle, 9 x 6.3 mm" in told
    assert "Agarwal" in told
    assert cv2.imread(str(tmp_path / "view.png")).shape[1] == 1320
    outcome = finray(f"design show {design} --engine scalar --out {tmp_path}/view.html")
    assert outcome.status == 2
    assert "a drawing's name must end in .png" in outcome.err


def test_pictures_of_a_pad_that_nothing_touches(design, tmp_path):
    design.write_text(design.read_text() + "[indenter]\ndepth_mm = 0.0\n")
    succeed(f"simulate render {design} --engine scalar --samples 2 --images --out {tmp_path}/rest.press.json")
    assert (cv2.imread(str(tmp_path / "rest.optics/change-view.png")) > 0).all()
    lit = np.full((2, 3, 16, 16), 500.0)
    write_record(captured(lit, np.random.default_rng(1)), tmp_path / "rest.capture.json", provenance("pytest"))
    outcome = finray(f"compare {tmp_path}/rest.press.json {tmp_path}/rest.capture.json --out {tmp_path}/error.json")
    assert outcome.status == 2
    assert "'small sensor, press of 0 mm' is not pressed in; give the design the indenter and depth of" in outcome.err
    assert "Warning" not in outcome.err


def test_rendered_with_pictures(design, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = succeed("simulate render sensor.toml --engine scalar --samples 2 --images --seed 4")
    assert told.startswith(
        "sensor.press.json: rendered, classic sensor, scalar_rgb; shape of the pressed coat: elastic layer under a ball"
    )
    press = read_record(tmp_path / "sensor.press.json", SimulatedPress)
    assert press.sensor is not None
    assert press.sensor.name == "small sensor"
    assert press.provenance.seed == 4
    assert set(press.provenance.input_sha256) == {"sensor.toml"}
    assert {path.name for path in (tmp_path / "sensor.optics").iterdir()} == {
        "README.txt", "change-view.png", "contact-view.png", "images.exr", "no_contact-view.png",
    }  # fmt: skip
    again = render_sensor(tmp_path / "sensor.toml", seed=4, samples=2, engine="scalar")
    # a scalar variant draws its random numbers block by block, as its threads take them: not the same picture
    assert (again.sensor, again.name, again.label) == (press.sensor, press.name, press.label)
    assert again.contact.shape == press.contact.shape
    np.testing.assert_array_equal(again.distance, press.distance)
    outcome = finray("recolour sensor.press.json --white-balance 1:1:2 --out other.press.json")
    assert outcome.status == 2
    assert "is of a classic sensor, which has no paints, so it cannot be recoloured" in outcome.err


def test_a_height_map_is_rendered_and_named_as_an_input(design, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "coat.npy", np.full((500, 500), 0.3))
    design.write_text(f'{design.read_text()}[surface]\nfile = "coat.npy"\nstep_mm = 0.1\n')
    told = succeed("simulate render sensor.toml --engine scalar --samples 2")
    assert "coat from coat.npy" in told
    press = read_record(tmp_path / "sensor.press.json", SimulatedPress)
    assert {name.rpartition("/")[2] for name in press.provenance.input_sha256} == {"sensor.toml", "coat.npy"}


@pytest.mark.parametrize(
    "options", ["--paint red=a.json", "--level c", "--pose-response", "--surfaces a.json", "--denoise"]
)
def test_what_belongs_to_a_finger_is_refused(design, tmp_path, options):
    outcome = finray(f"simulate render {design} {options}")
    assert outcome.status == 2
    assert f"is a classic sensor; leave out {options.split()[0]}, supported only for painted fingers" in outcome.err
    assert list(tmp_path.iterdir()) == [design]


def test_the_library_takes_names_designs_and_files(design):
    small = preset_sensor("digit")
    small = small.model_copy(update={"camera": small.camera.model_copy(update={"width_px": 8, "height_px": 8})})
    assert render_sensor(small, samples=2, engine="scalar").contact.shape == (8, 8, 3)
    outcome = finray("design init nose")
    assert outcome.status == 2
    assert "there is no preset design 'nose'; valid names are flat-70x35" in outcome.err
    assert "gelsight-wedge" in outcome.err


def test_a_fitted_design_in_another_folder_finds_the_files_of_the_one_it_was_made_from(tmp_path, monkeypatch):
    """A relative file of a design starts at the design's own folder."""
    stored = Path(__file__).parents[1] / "schemas" / "frozen" / "SensorFit" / "v3" / "example.json"
    fit = read_record(stored, SensorFit)
    camera = fit.sensor.camera.model_copy(update={"calibration": "lens.yaml", "response": "camera.csv"})
    fit = fit.model_copy(update={"sensor": fit.sensor.model_copy(update={"camera": camera})})
    monkeypatch.setattr("finray_calib.fit_sensor", lambda *_, **__: fit)
    (tmp_path / "designs").mkdir()
    (tmp_path / "designs" / "sensor.toml").write_text('preset = "gelsight-flat"\n')
    monkeypatch.chdir(tmp_path)
    words = "simulate fit designs/sensor.toml --captures a.json --engine scalar --out"
    succeed(f"{words} fits/a.sensor.json")
    moved = read_sensor(tmp_path / "fits" / "a.fitted.toml").camera
    assert Path(moved.calibration) == tmp_path / "designs" / "lens.yaml"
    assert Path(moved.response) == tmp_path / "designs" / "camera.csv"
    succeed(f"{words} designs/a.sensor.json")
    beside = read_sensor(tmp_path / "designs" / "a.fitted.toml").camera
    assert (beside.calibration, beside.response) == ("lens.yaml", "camera.csv")
    outcome = finray(f"{words} a.txt")
    assert outcome.status == 2
    assert "must be a record: choose an --out that ends in .json" in outcome.err


def test_fitted_to_a_capture(design, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    design.write_text(design.read_text().replace("= 16", "= 40"))
    press = render_sensor(design, seed=2, samples=64, engine="scalar")
    light = 300.0 * np.moveaxis([press.no_contact, press.contact], -1, 1) / np.mean(press.no_contact)
    capture = captured(light, np.random.default_rng(1))
    exact = capture.indenter.model_copy(update={"depth_uncertainty_mm": None, "position_uncertainty_mm": None})
    write_record(capture.model_copy(update={"indenter": exact}), tmp_path / "a.json", provenance("a test", {}))
    told = succeed("simulate fit sensor.toml --captures a.json --engine scalar --samples 64")
    assert told.startswith("sensor.sensor.json: 'small sensor' fitted to 1 captures, 49 blocks of each picture\n")
    assert "the poses of the presses count as exactly known" in told
    assert "only products of the gain with powers are determined" in told
    fit = read_record(tmp_path / "sensor.sensor.json", SensorFit)
    assert set(fit.provenance.input_sha256) == {"sensor.toml", "a.json"}
    assert {number.name for number in fit.numbers} >= {"lights.0.power_rel", "picture.gain"}
    assert read_sensor(tmp_path / "sensor.fitted.toml").name == "small sensor, fitted"
    for options, why in (
        ("--samples 3", "--samples 3: must be an even whole number"),
        ("--free pad.nose", "--free pad.nose: must be the dotted path of a positive number"),
        ("--paint red=a.json", "give both red=FILE and green=FILE"),
    ):
        outcome = finray(f"simulate fit sensor.toml --captures a.json --out b.sensor.json --engine scalar {options}")
        assert outcome.status == 2
        assert why in outcome.err
