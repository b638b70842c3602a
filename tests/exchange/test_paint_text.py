"""CSV, JSON, Mitsuba and TM-27 files against the programs that read them."""

import json

import colour
import numpy as np
import pytest

from data_schemas.storage import read_table
from finray_calib.exchange import as_spectral_distribution
from finray_calib.exchange._paint_formats import CSV_COLUMNS, csv_text, json_text, mitsuba_text, spdx_bytes

# Six or seven significant digits are written.
ROUNDING_REL = 1e-5
# Mitsuba and its spectra are single precision.
SINGLE_REL = 1e-5


def test_csv_holds_mean_and_limits(paint, origin, tmp_path):
    (tmp_path / "p.csv").write_text(csv_text(paint, origin))
    header, table = read_table(tmp_path / "p.csv")
    assert header == list(CSV_COLUMNS)
    np.testing.assert_allclose(table[:, 0], paint.wavelength_nm)
    for column, field in enumerate(("", "_low68", "_high68", "_low95", "_high95"), 1):
        np.testing.assert_allclose(table[:, column], getattr(paint, f"emission{field}_per_nm"), rtol=ROUNDING_REL)


def test_csv_header_says_what_and_whence(paint, origin):
    header = [line for line in csv_text(paint, origin).splitlines() if line.startswith("#")]
    text = "\n".join(header)
    assert "unit 1/nm, for excitation at 450 nm" in text
    assert f"red.paint.json, SHA-256 {'ab' * 32}" in text
    assert paint.warnings[0] in text
    assert len([line for line in header if "reflectance at" in line]) == len(paint.reflectance)


def test_a_line_break_in_a_name_stays_inside_the_comment(paint, origin, tmp_path):
    renamed = paint.model_copy(update={"paint_name": "red\n450 1.0"})
    (tmp_path / "p.csv").write_text(csv_text(renamed, origin))
    assert len(read_table(tmp_path / "p.csv")[1]) == len(paint.wavelength_nm)


def test_json_is_plain_and_complete(paint, spectra, origin):
    text = json_text(paint, spectra, origin)
    loaded = json.loads(text)
    np.testing.assert_allclose(loaded["emission"]["mean_per_nm"], paint.emission_per_nm, rtol=ROUNDING_REL)
    np.testing.assert_allclose(loaded["absorption"]["mean_rel"], spectra.absorption_rel, rtol=ROUNDING_REL)
    assert loaded["parameters"]["mode_nm"]["low95"] == paint.parameters["mode_nm"].low95
    assert [r["center_nm"] for r in loaded["reflectance"]] == [f.center_nm for f in paint.optics.filters]
    assert loaded["provenance"]["input_sha256"] == origin.input_sha256
    assert len(text) < 100_000  # small enough to mail


def test_mitsuba_loads_and_evaluates_the_spectrum(paint, origin, tmp_path):
    mi = pytest.importorskip("mitsuba")
    before = mi.variant()
    mi.set_variant("scalar_spectral")
    try:
        file = tmp_path / "p.spd"
        file.write_text(mitsuba_text(paint, origin))
        texture = mi.load_dict({"type": "spectrum", "filename": str(file)})
        interaction = mi.SurfaceInteraction3f()
        at_nm = [480.5, 600.0, 613.3, 700.0]
        interaction.wavelengths = at_nm
        found = np.array(texture.eval(interaction))
    finally:
        if before is not None:
            mi.set_variant(before)
    np.testing.assert_allclose(found, np.interp(at_nm, paint.wavelength_nm, paint.emission_per_nm), rtol=SINGLE_REL)


def test_mitsuba_header_says_what_is_missing(paint, origin):
    assert "# missing here: uncertainty" in mitsuba_text(paint, origin)


def test_colour_holds_the_emission(paint):
    distribution = as_spectral_distribution(paint)
    assert isinstance(distribution, colour.SpectralDistribution)
    np.testing.assert_array_equal(distribution.wavelengths, paint.wavelength_nm)
    np.testing.assert_array_equal(distribution.values, paint.emission_per_nm)
    assert paint.paint_name in distribution.name


def test_colour_reads_the_spdx_file_back(paint, origin, tmp_path):
    (tmp_path / "p.spdx").write_bytes(spdx_bytes(paint, origin))
    read = colour.SpectralDistribution_IESTM2714(str(tmp_path / "p.spdx")).read()
    np.testing.assert_array_equal(read.wavelengths, paint.wavelength_nm)
    np.testing.assert_allclose(read.values, paint.emission_per_nm, rtol=1e-11)  # twelve digits are written
    assert "missing here: uncertainty" in read.header.comments
    assert read.header.manufacturer == "unknown"
    assert read.spectral_quantity == "other"
