"""Taxim folders of ours: against Taxim's published port, against their own presses, and what is refused."""

import json
import subprocess

import numpy as np
import pytest

from data_schemas import FingerDesign, SimulateError, provenance
from data_schemas.storage import write_record
from finray_calib.exchange import FEWEST_PRESSES, read_taxim, taxim_files
from finray_calib.exchange._taxim_export import BINS, fit_shading_table
from sim import design_toml
from tests.capture.drivers.programs import others_python
from tests.command_line.running import finray, succeed
from tests.documentation.example_records import example_results
from tests.exchange.taxim_presses import BALL_MM, MM_PER_PX, SHAPE_PX, closed_form_presses

PRESSES = 32
SENSOR = "[camera]\nwidth_px = 32\nheight_px = 32\nfield_of_view_deg = 26.0\n[pad]\nlength_mm = 20.0\nwidth_mm = 20.0\n"
PORT_WITHIN_S = 120


@pytest.fixture(scope="module")
def presses():
    return closed_form_presses(PRESSES)


@pytest.fixture(scope="module")
def folder(presses, tmp_path_factory):
    out = tmp_path_factory.mktemp("taxim")
    for name, content in taxim_files(presses, 1, {})[0].items():
        (out / name).write_bytes(content)
    return out


def dn_per_unit(folder):
    return json.loads((folder / "params.json").read_text())["finray"]["dn_per_unit_radiance"]


def skill(picture, truth, nothing, region):
    """Share of the change of colour that a picture explains."""
    return 1.0 - ((picture - truth)[region] ** 2).sum() / ((nothing - truth)[region] ** 2).sum()


def test_the_table_gives_the_colours_of_the_closed_form(presses):
    table = fit_shading_table(presses, 100.0, seed=1)
    assert table.explained.shape == (12,)
    # Lambertian gel under distant lights is what the table can hold; the rest is the polynomial's and the ridge's
    assert table.explained.min() > 0.97
    assert 25.0 < table.steepest_deg < 60.0
    # a slope of 20 deg to the right, in the middle of the picture: red light comes from the left
    i, j = int(np.radians(20.0) / (0.5 * np.pi / (BINS - 1))), int(np.pi / (2.0 * np.pi / (BINS - 1)))
    x, y = SHAPE_PX[1] / 2.0, SHAPE_PX[0] / 2.0
    at = np.array([x * x, y * y, x * y, x, y, 1.0])
    tilt = np.radians(20.0)
    expected = 100.0 * (np.sqrt(0.5) * (np.cos(tilt) - np.sin(tilt)) - np.sqrt(0.5))
    assert table.red[i, j] @ at == pytest.approx(expected, abs=0.08 * abs(expected))
    assert (table.red[0] == 0.0).all()
    assert np.array_equal(table.green[BINS - 1], table.green[BINS - 2])


def test_fewer_presses_than_needed_are_refused(presses):
    with pytest.raises(SimulateError, match=f"at least {FEWEST_PRESSES} presses, got 23"):
        fit_shading_table(presses.only(range(23)), 100.0, seed=1)


def test_our_import_reads_our_export(folder, presses):
    found = read_taxim(folder, 2.0 * BALL_MM)
    assert "shadowTable.npz: pickled objects are never loaded" in found.left_out
    for k, capture in enumerate(found.captures):
        expected = np.rint(presses.contacts[k] * dn_per_unit(folder))
        assert np.array_equal(capture.contact, np.clip(expected, 0, 255))
        circle = capture.contact_circle
        assert circle is not None
        assert (circle.row_px, circle.column_px) == (presses.row_px[k], presses.column_px[k])
    assert found.captures[0].mm_per_px == MM_PER_PX


def test_files_are_those_of_the_format_and_the_same_again(folder, presses):
    assert sorted(p.name for p in folder.iterdir()) == [
        "dataPack.npz", "gelmap.npy", "params.json", "polycalib.npz", "real_bg.npy", "shadowTable.npz",
    ]  # fmt: skip
    with np.load(folder / "polycalib.npz") as file:
        assert {n: file[n].shape for n in file.files} == {"bins": (), **{f"grad_{c}": (125, 125, 6) for c in "rgb"}}
    gel = np.load(folder / "gelmap.npy")
    assert np.allclose(gel * MM_PER_PX, 4.0)
    for name, content in taxim_files(presses, 1, {})[0].items():
        assert (folder / name).read_bytes() == content


@pytest.mark.rigs
@pytest.mark.timeout(2 * PORT_WITHIN_S)
def test_the_published_port_renders_our_sensor(folder, presses, tmp_path):
    python = others_python("taxim[jax-cpu]")
    if subprocess.run(
        [python, "-c", "import taxim"], capture_output=True, timeout=PORT_WITHIN_S, check=False
    ).returncode:
        pytest.skip(
            "TAXIM ABSENT: pip install 'taxim[jax-cpu]==1.4.1' into that environment; NOT compared with its port"
        )
    unseen = closed_form_presses(3, seed=9)
    radius_mm = unseen.radius_px * MM_PER_PX
    depth_mm = BALL_MM - np.sqrt(BALL_MM**2 - radius_mm**2)
    np.savez(tmp_path / "w.npz", row=unseen.row_px, column=unseen.column_px, depth_mm=depth_mm, ball_mm=BALL_MM)
    script = __file__.replace("test_taxim_export", "render_with_taxim")
    run = [python, script, str(folder), str(tmp_path / "w.npz")]
    done = subprocess.run(run, capture_output=True, text=True, timeout=PORT_WITHIN_S, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    pictures = 255.0 * np.load(tmp_path / "w.npz.pictures.npy")
    nothing = presses.no_contact * dn_per_unit(folder)
    for k, picture in enumerate(pictures):
        truth = unseen.contacts[k] * dn_per_unit(folder)
        # where Taxim keeps the ball's shape, only polynomial, ridge and 8 bits remain
        assert skill(picture, truth, nothing, unseen.distance[k] <= 0.7) > 0.99
        # it rounds off the part above 0.4 of the depth (contact_scale); measured 0.76 to 0.80
        assert skill(picture, truth, nothing, unseen.distance[k] <= 1.0) > 0.7
        # away from the contact nothing changes; the port smooths the background by a few tenths of a DN
        assert np.abs(picture - nothing)[unseen.distance[k] > 4.0].mean() < 1.5
        red_for_blue = picture[..., ::-1]
        assert skill(red_for_blue, truth, nothing, unseen.distance[k] <= 0.7) < 0.5


def test_the_verb_writes_a_folder(presses, tmp_path, monkeypatch):
    """The renders are those of the closed form: rendering has its own test."""
    asked = {}

    def rendered(sensor, renderer, ball_radius_mm, count, seed, samples, progress, folder):
        asked.update(name=sensor.name, ball_radius_mm=ball_radius_mm, count=count, seed=seed, samples=samples)
        return presses

    monkeypatch.setattr("sim.experiments._sensor_press.render_ball_presses", rendered)
    monkeypatch.setattr("finray_calib.cli._export.open_engine", lambda preference: None)
    (tmp_path / "s.toml").write_text(SENSOR)
    options = f"--presses 30 --ball-diameter-mm 3 --samples 8 --seed 5 --out {tmp_path}/o"
    said = succeed(f"export taxim {tmp_path}/s.toml {options}")
    assert asked == {"name": "plain-20x20", "ball_radius_mm": 1.5, "count": 30, "seed": 5, "samples": 8}
    assert f"Taxim calibration folder of {PRESSES} presses" in said
    made = json.loads((tmp_path / "o/params.json").read_text())["finray"]
    assert made["provenance"]["seed"] == 5
    assert finray(f"export taxim {tmp_path}/s.toml --out {tmp_path}/o").status == 2


def test_with_paints_a_finger_is_rendered(presses, tmp_path, monkeypatch):
    """The renders are those of the closed form here too."""
    asked = {}

    def rendered(finger, *amounts):
        asked.update(name=finger.design.name, paints=sorted(finger.paints), amounts=amounts[:4])
        return presses

    monkeypatch.setattr("sim.experiments._sensor_press.render_finger_presses", rendered)
    monkeypatch.setattr("finray_calib.cli._export.open_engine", lambda preference: None)
    (tmp_path / "f.toml").write_text(design_toml(FingerDesign()))
    paints = example_results().paints
    for colour, paint in paints.items():
        write_record(paint.calibration, tmp_path / f"{colour}.json", provenance("pytest"))
    named = " ".join(f"--paint {colour}={tmp_path}/{colour}.json" for colour in paints)
    succeed(f"export taxim {tmp_path}/f.toml {named} --out {tmp_path}/o")
    assert asked == {"name": "fin-ray-70x35", "paints": ["green", "red"], "amounts": (2.0, 48, 1, 64)}
    made = json.loads((tmp_path / "o/params.json").read_text())["finray"]
    assert f"{tmp_path}/red.json" in made["provenance"]["input_sha256"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("taxim", "needs exactly one sensor or finger; run 'finray export taxim SENSOR.toml'"),
        ("taxim f.toml --paint red=a.json", "no such file"),
        ("x.json --format csv --paint red=a.json", "--paint: supported only for a Taxim folder"),
        ("taxim s.toml --format csv", "--format is only for paints"),
        ("taxim s.toml --dialect abaqus", "--dialect: supported only for a deck"),
        ("taxim s.toml --presses 0", "must be a whole number from 1"),
        # refused before the sensor is read, let alone rendered
        ("taxim none.toml --presses 23", "--presses 23: a shading table needs at least 24 presses"),
        ("taxim s.toml --ball-diameter-mm x", "must be a number of mm above 0"),
        ("taxim none.toml", "none.toml: no such file"),
        ("x.json --format csv --presses 9", "--presses: supported only for a Taxim folder"),
        ("capture-request", "needs exactly one design"),
        ("capture-request d.toml --format csv", "--format is only for paints"),
        ("capture-request d.toml --samples 3", "--samples: supported only for a Taxim folder"),
    ],
)
def test_mistakes_end_with_status_2(arguments, message):
    outcome = finray(f"export {arguments}")
    assert outcome.status == 2
    assert message in outcome.err
