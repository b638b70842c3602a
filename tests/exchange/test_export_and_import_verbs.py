"""``finray export`` and ``finray import bands`` as a user types them."""

import json

import numpy as np
import pytest

from data_schemas import BandSignals, PaintCalibration, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.cli._export import SUFFIXES
from finray_calib.exchange import PAINT_FORMATS, import_band_folder
from finray_calib.spectra import WAVELENGTH_NM, rig_emission_weights
from tests.command_line.running import finray, succeed
from tests.exchange.band_folders import EXPOSURE_S, edit, write_folder

MODE_NM, FWHM_NM, YIELD, REFLECTED = 597.0, 48.0, 0.3, 0.08
MONOCHROME_WEIGHTS = (0.0, 1.0, 0.0)


@pytest.fixture
def stored(paint, tmp_path):
    return write_record(paint, tmp_path / "red.paint.json", provenance("pytest"))


def test_the_two_lists_of_formats_agree():
    assert list(SUFFIXES) == list(PAINT_FORMATS)


@pytest.mark.parametrize("name", list(SUFFIXES))
def test_every_format_is_written_once(stored, tmp_path, name):
    out = tmp_path / f"x{SUFFIXES[name]}"
    assert f"{out}: paint 'fluorescent red' as {name}" in succeed(f"export {stored} --format {name} --out {out}")
    content = out.read_bytes()
    assert len(content) > 1000
    again = finray(f"export {stored} --format {name} --out {out}")
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err
    assert out.read_bytes() == content
    assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith((".", "x"))) == [out.name]


def test_default_name_and_provenance(stored, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    succeed(f"export {stored} --format csv")
    text = (tmp_path / "fluorescent-red.csv").read_text()
    assert "made by: finray export" in text
    assert "red.paint.json, SHA-256" in text


def test_two_lights_and_a_camera(stored, tmp_path):
    for center_nm in (450, 520):
        rows = "".join(f"{x},{np.exp(-(((x - center_nm) / 10) ** 2)):.6f}\n" for x in range(420, 561))
        (tmp_path / f"led{center_nm}.csv").write_text("wavelength_nm,power_rel\n" + rows)
    (tmp_path / "camera.csv").write_text("wavelength_nm,red_percent,green_percent,blue_percent\n380,1,1,1\n780,1,1,1\n")
    leds = f"--led {tmp_path}/led450.csv --led {tmp_path}/led520.csv --camera-response {tmp_path}/camera.csv"
    succeed(f"export {stored} --format rgb-reradiation {leds} --out {tmp_path}/m.json")
    loaded = json.loads((tmp_path / "m.json").read_text())
    assert loaded["columns"] == ["led450 (led450.csv)", "led520 (led520.csv)"]
    assert np.array(loaded["fluorescent"]).shape == (3, 2)
    # a flat response sees the same in all channels
    assert len({tuple(row) for row in loaded["fluorescent"]}) == 1
    assert f"{tmp_path}/led520.csv" in loaded["provenance"]["input_sha256"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--format csv --led x.csv", "are only for --format rgb-reradiation; leave them out for csv"),
        ("--format rgb-reradiation --led x.csv", "x.csv: no such file"),
        ("--format obj", "invalid choice: 'obj'"),
    ],
)
def test_mistakes_end_with_status_2(stored, tmp_path, arguments, message):
    outcome = finray(f"export {stored} {arguments} --out {tmp_path}/x.json")
    assert outcome.status == 2
    assert message in outcome.err
    assert not (tmp_path / "x.json").exists()


def test_a_record_of_another_kind_is_refused(tmp_path):
    bands, _ = import_band_folder(write_folder(tmp_path / "f", "RGB"))
    write_record(bands, tmp_path / "b.json", provenance("pytest"))
    outcome = finray(f"export {tmp_path}/b.json --format csv --out {tmp_path}/x.csv")
    assert outcome.status == 2
    assert "contains band signals, but a paint calibration is needed" in outcome.err


def test_import_writes_band_signals(tmp_path):
    folder = write_folder(tmp_path / "f", "monochrome")
    said = succeed(f"import bands {folder} --out {tmp_path}/o.bands.json")
    assert "5 filters, 5 usable values over 1600 px" in said
    assert "note: no dark frames" in said
    bands = read_record(tmp_path / "o.bands.json", BandSignals)
    assert bands.provenance is not None
    assert f"{folder}/laser/600nm.tif" in bands.provenance.input_sha256
    assert finray(f"import bands {folder} --out {tmp_path}/o.bands.json").status == 2


def test_import_mistakes_end_with_status_2(tmp_path):
    folder = write_folder(tmp_path / "f", "monochrome")
    edit(folder, "height_px = 40", "height_px = 2")
    outcome = finray(f"import bands {folder} --out {tmp_path}/o.json")
    assert outcome.status == 2
    assert outcome.err.startswith(f"finray import: error: {folder}: bands.toml: region: 2 x 40 px")


def test_monochrome_import_is_accepted_by_the_fit(tmp_path):
    """A paint of known emission, seen by a monochrome camera through five filters: the interval holds its mode."""
    optics = import_band_folder(write_folder(tmp_path / "probe", "monochrome"))[0].optics
    weights = rig_emission_weights(optics, MONOCHROME_WEIGHTS)
    bell = np.exp2(-((2 * (WAVELENGTH_NM - MODE_NM) / FWHM_NM) ** 2))
    emission_per_nm = YIELD * bell / bell.sum()
    values = (weights.emission @ emission_per_nm + REFLECTED * weights.reflected_laser).reshape(-1, 3)[:, 1]
    # exposed so long that the brightest band under the laser is as bright as the white tile under the lamp
    folder = write_folder(tmp_path / "f", "monochrome", fluorescence=values / values.max())
    edit(folder, f"fluorescence = {EXPOSURE_S}", f"fluorescence = {EXPOSURE_S / values.max():.9g}")
    succeed(f"import bands {folder} --out {tmp_path}/b.json")
    succeed(f"fit {tmp_path}/b.json --seed 1 --out {tmp_path}/p.json")
    mode = read_record(tmp_path / "p.json", PaintCalibration).parameters["mode_nm"]
    assert mode.low95 < MODE_NM < mode.high95
    assert mode.high95 - mode.low95 < 40
