"""Bispectral OpenEXR: colour-science's sample file as oracle of the layout, energy as truth of the numbers."""

import re
import sys
from pathlib import Path

import colour
import numpy as np
import pytest
from colour.io.fichet2021 import PATTERN_FICHET2021, match_groups_to_nm

from data_schemas import ImportFormatError, MissingExtraError
from data_schemas.storage import read_table
from finray_calib.exchange import read_bispectral_exr
from finray_calib.exchange._paint_reradiation import band_matrix, exr_bytes
from tests.exchange.conftest import LASER_NM, absorption, emission, reflectance

OpenEXR = pytest.importorskip("OpenEXR")
SAMPLE = Path(colour.__path__[0]) / "io" / "tests" / "resources" / "BiSpectral.exr"


@pytest.fixture
def written(spectra, origin, tmp_path):
    file = tmp_path / "p.exr"
    file.write_bytes(exr_bytes(spectra, origin))
    return file


@pytest.fixture(scope="module")
def sample():
    if not SAMPLE.is_file():
        pytest.skip("this colour-science ships no BiSpectral.exr: the layout was NOT compared with its sample")
    return SAMPLE


def test_reader_reads_the_sample_of_measured_materials(sample, shared_data):
    """Its checkerboard shows two materials whose matrices are published as tables: per band, rows emission."""
    found = []
    for row_px, column_px in ((0, 0), (0, 15), (15, 0), (15, 15)):
        matrix = read_bispectral_exr(sample, row_px, column_px)
        np.testing.assert_array_equal(matrix.wavelength_nm, np.arange(380.0, 781.0, 10.0))
        matches = []
        for name in ("postit_yellow_3m", "postit_pink_3m"):
            header, table = read_table(shared_data / "spectra" / "materials" / f"{name}.csv")
            columns = [header.index(f"{nm:g}") for nm in matrix.wavelength_nm]
            rows = np.isin(table[:, 0], matrix.wavelength_nm)
            truth = np.tril(np.maximum(table[rows][:, columns], 0.0))
            matches.append(np.allclose(matrix.radiance_factor, truth, atol=1e-6))  # the tables hold six decimals
        found.append(matches)
    yellow, pink = [True, False], [False, True]
    assert found in ([yellow, pink, pink, yellow], [pink, yellow, yellow, pink])


def test_same_names_and_attributes_as_the_sample(sample, written):
    theirs, ours = OpenEXR.File(str(sample), True), OpenEXR.File(str(written), True)
    # R, G, B of the sample are a preview for viewers, which the layout leaves free
    assert set(ours.channels()) == {name for name in theirs.channels() if name not in "RGB"}
    for name in ("spectralLayoutVersion", "EV", "compression", "type"):
        assert name in ours.header()
        assert type(ours.header()[name]) is type(theirs.header()[name])
    assert ours.header()["spectralLayoutVersion"] == theirs.header()["spectralLayoutVersion"]
    assert {c.pixels.dtype for c in ours.channels().values()} == {np.dtype(np.float32)}


def test_colour_parses_every_name(written):
    pattern = re.compile(rf"^T\.*{PATTERN_FICHET2021}(?:\.*{PATTERN_FICHET2021})?$")
    for name in OpenEXR.File(str(written), True).channels():
        match = pattern.match(name)
        assert match is not None, name
        excitation_nm = match_groups_to_nm(match[1], match[3], match[4])
        emission_nm = match_groups_to_nm(match[5], match[7], match[8]) if match[5] else excitation_nm
        assert 380 <= excitation_nm <= emission_nm <= 780


def test_round_trip(spectra, written):
    read, made = read_bispectral_exr(written), band_matrix(spectra)
    np.testing.assert_array_equal(read.wavelength_nm, made.wavelength_nm)
    np.testing.assert_allclose(read.radiance_factor, made.radiance_factor, rtol=1e-6, atol=1e-9)  # single precision


def test_columns_hold_the_energy(spectra):
    matrix = band_matrix(spectra)
    fine_nm = np.arange(380.0, 785.0, 0.05)
    for column in (7, 14, 18, 21):
        center_nm = matrix.wavelength_nm[column]
        inside = np.arange(center_nm - 5, center_nm + 5, 0.05)
        beyond = [np.trapezoid(emission(fine_nm) * (fine_nm > x), fine_nm) for x in inside]
        truth = np.mean(absorption(inside) * inside / LASER_NM * beyond)
        returned = matrix.radiance_factor[:, column].sum() - reflectance(center_nm)
        # ten samples per band of curves that turn over 12 nm and more: 1 / (24 12^2) of the second derivative
        np.testing.assert_allclose(returned, truth, rtol=5e-3)


def test_nothing_above_the_diagonal(spectra):
    assert not np.triu(band_matrix(spectra).radiance_factor, 1).any()


def test_header_says_what_it_is(written):
    comments = OpenEXR.File(str(written)).header()["comments"]
    assert "radiance factor per 10 nm emission band" in comments
    assert "missing here: uncertainty" in comments
    assert "SHA-256" in comments
    assert "warning: made-up warning" in comments


def write(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: np.ones((1, 1), np.float32) for name in channels}).write(str(path))


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (["T.400,0nm", "T.410,0nm"], "has no bispectral channels T.<in>nm.<out>nm"),
        (["Y"], "has no bispectral channels"),
        (
            ["T.400,0nm", "T.410,0nm", "T.420,0nm", "T.400,0nm.410,0nm"],
            "excitation 400 nm and emission 420 nm is missing",
        ),
        (["T.nm", "T.,nm", "T.e5nm"], "has no bispectral channels"),
    ],
)
def test_incomplete_images_are_refused(tmp_path, channels, message):
    write(tmp_path / "x.exr", channels)
    with pytest.raises(ImportFormatError, match=message):
        read_bispectral_exr(tmp_path / "x.exr")


def test_foreign_and_missing_files_are_refused(tmp_path, written):
    (tmp_path / "x.exr").write_bytes(b"no image")
    with pytest.raises(ImportFormatError, match="cannot be read as OpenEXR"):
        read_bispectral_exr(tmp_path / "x.exr")
    with pytest.raises(ImportFormatError, match="no such file"):
        read_bispectral_exr(tmp_path / "y.exr")
    with pytest.raises(ImportFormatError, match="row 0, column 5 lies outside the image of 1 x 1 px"):
        read_bispectral_exr(written, 0, 5)


def test_missing_package_is_named(spectra, origin, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'finray-calib\[exr\]'"):
        exr_bytes(spectra, origin)
