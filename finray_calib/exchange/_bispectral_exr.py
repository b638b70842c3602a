"""Bispectral OpenEXR after Fichet, Pacanowski and Wilkie 2021 (An OpenEXR Layout for Spectral Images, JCGT 10-3).

A pixel holds the paint's reradiation matrix on one wavelength axis: channel ``T.<l>nm`` is the diagonal, channel
``T.<in>nm.<out>nm`` with in < out what comes from one band and leaves in another; wavelengths have a decimal comma.
Values are bispectral radiance factors per emission band, as in measured Donaldson matrices.
"""

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError, MissingExtraError, Provenance
from data_schemas.storage import parse_in_child, read_bytes
from finray_calib.exchange._paint_spectra import PaintSpectra

Floats = NDArray[np.float64]
FIRST_NM, LAST_NM, BAND_NM = 380.0, 780.0, 10.0
LAYOUT_VERSION = "1.0"
VERSION_ATTRIBUTE = "spectralLayoutVersion"
# A hundred samples per band square: the diagonal edge of the emission cuts through the squares.
_SAMPLES_PER_BAND = 10
_WAVELENGTH = r"(\d*,?\d*(?:[eE][-+]?\d+)?)nm"
_CHANNEL = re.compile(rf"^T\.{_WAVELENGTH}(?:\.{_WAVELENGTH})?$")


@dataclass(frozen=True, slots=True)
class BandMatrix:
    """Bispectral radiance factor per band (emission, excitation) on one axis of band centres.

    The diagonal is reflectance with the little that is re-emitted inside the band; below it all is zero.
    """

    wavelength_nm: Floats
    radiance_factor: Floats


def band_matrix(spectra: PaintSpectra) -> BandMatrix:
    """Return the reradiation matrix of a paint per 10 nm band, 380 to 780 nm, mean over the paired draws.

    M(out, in) = mean over the excitation band of the integral over the emission band of D, so that a column sums to
    the energy returned per energy that arrives in the band.

    Parameters
    ----------
    spectra
        Curves of the paint.
    """
    centers_nm = np.arange(FIRST_NM, LAST_NM + BAND_NM / 2, BAND_NM)
    offset_nm = ((np.arange(_SAMPLES_PER_BAND) + 0.5) / _SAMPLES_PER_BAND - 0.5) * BAND_NM
    fine_nm = (centers_nm[:, None] + offset_nm).ravel()
    axis_nm = spectra.wavelength_nm
    emission = np.array([np.interp(fine_nm, axis_nm, row, left=0, right=0) for row in spectra.emission_draws_per_nm])
    excitation = np.array([np.interp(fine_nm, spectra.excitation_nm, row) for row in spectra.excitation_rel_draws])
    # Samples of the same place count half: the edge out = in runs through them.
    above = np.heaviside(fine_nm[:, None] - fine_nm[None, :], 0.5)
    fine = emission.T @ excitation / len(emission) * above
    bands = len(centers_nm)
    squares = fine.reshape(bands, _SAMPLES_PER_BAND, bands, _SAMPLES_PER_BAND)
    per_band = squares.mean(axis=(1, 3)) * BAND_NM
    return BandMatrix(centers_nm, per_band + np.diag(spectra.reflectance_at(centers_nm)))


def exr_bytes(spectra: PaintSpectra, origin: Provenance) -> bytes:
    """Return a 1 x 1 pixel bispectral OpenEXR image of the mean reradiation matrix.

    The layout holds no uncertainty; the comment says so.

    Parameters
    ----------
    spectra
        Curves of the paint.
    origin
        Provenance of the export.

    Raises
    ------
    MissingExtraError
        The OpenEXR package is not installed.
    """
    open_exr = _open_exr()
    matrix = band_matrix(spectra)
    channels = {
        _channel_name(matrix.wavelength_nm, row, column): np.full((1, 1), value, dtype=np.float32)
        for (row, column), value in np.ndenumerate(matrix.radiance_factor)
        if row >= column
    }
    comments = (
        f"reradiation matrix of fluorescent paint {spectra.name}; radiance factor per {BAND_NM:g} nm emission band",
        spectra.statement,
        *(f"warning: {warning}" for warning in spectra.warnings),
        "missing here: uncertainty (export netcdf or json)",
        f"made by {origin.command} (finray-calib {origin.package_version}, {origin.created_utc})",
        *(f"from {name}, SHA-256 {digest}" for name, digest in origin.input_sha256.items()),
    )
    header = {
        "compression": open_exr.ZIP_COMPRESSION,
        "type": open_exr.scanlineimage,
        VERSION_ATTRIBUTE: LAYOUT_VERSION,
        "EV": 0.0,
        "comments": "; ".join(comments),
    }
    with TemporaryDirectory() as folder:
        file = Path(folder) / "paint.exr"
        open_exr.File(header, channels).write(str(file))
        return file.read_bytes()


def read_bispectral_exr(path: Path, row_px: int = 0, column_px: int = 0) -> BandMatrix:
    """Read the reradiation matrix of one pixel of a bispectral OpenEXR image.

    Parameters
    ----------
    path
        The image.
    row_px, column_px
        The pixel.

    Raises
    ------
    MissingExtraError
        The OpenEXR package is not installed.
    ImportFormatError
        The file cannot be read, is no bispectral image, lacks a channel, or the pixel lies outside.
    """
    found = {}
    for name, pixels in exr_pixels(path).items():
        match = _CHANNEL.match(name)
        if match is None:
            continue  # the layout allows an RGB preview and others beside the spectral channels
        if not (0 <= row_px < pixels.shape[0] and 0 <= column_px < pixels.shape[1]):
            raise ImportFormatError(
                f"{path}: pixel row {row_px}, column {column_px} lies outside of the {pixels.shape[0]} x "
                f"{pixels.shape[1]} px"
            )
        excitation_nm, emission_nm = (float(text.replace(",", ".")) for text in (match[1], match[2] or match[1]))
        found[excitation_nm, emission_nm] = float(pixels[row_px, column_px])
    axis_nm = np.unique([excitation_nm for excitation_nm, _ in found])
    if len(found) == len(axis_nm) or len(axis_nm) < 2:
        raise ImportFormatError(
            f"{path}: holds no channels T.<in>nm.<out>nm; give a bispectral image after Fichet et al. 2021"
        )
    matrix = np.zeros((len(axis_nm), len(axis_nm)))
    for column, excitation_nm in enumerate(axis_nm):
        for row, emission_nm in enumerate(axis_nm[column:], column):
            if (excitation_nm, emission_nm) not in found:
                raise ImportFormatError(
                    f"{path}: the channel of excitation {excitation_nm:g} nm and emission {emission_nm:g} nm is "
                    "missing; every pair with emission at or above the excitation is needed"
                )
            matrix[row, column] = found[excitation_nm, emission_nm]
    return BandMatrix(axis_nm, matrix)


def _channel_name(wavelength_nm: Floats, row: int, column: int) -> str:
    """Return the name of the channel of an emission row and excitation column."""
    excitation, emission = (f"{wavelength_nm[i]:.6f}nm".replace(".", ",") for i in (column, row))
    return f"T.{excitation}" if row == column else f"T.{excitation}.{emission}"


def exr_pixels(path: Path) -> dict[str, NDArray[Any]]:
    """Return the channels of an image, or say why it cannot be read."""
    _open_exr()
    content = read_bytes(path, "an OpenEXR image", ImportFormatError)
    return parse_in_child(f"{__name__}:exr_channels", content, path, "OpenEXR", ImportFormatError)[1]


def exr_channels(content: bytes, where: str) -> tuple[None, dict[str, NDArray[Any]]]:
    """Return the channels of an OpenEXR image; it runs in a child process, for the reader is C++ and files lie."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "image.exr"
        file.write_bytes(content)
        try:
            with _open_exr().File(str(file), separate_channels=True) as image:
                return None, {name: np.array(channel.pixels) for name, channel in image.channels().items()}
        except (RuntimeError, ValueError, TypeError) as error:
            raise ImportFormatError(f"{where}: cannot be read as OpenEXR ({error})") from None


def _open_exr() -> ModuleType:
    """Return the OpenEXR package."""
    try:
        return import_module("OpenEXR")
    except ImportError:
        raise MissingExtraError("OpenEXR images need the OpenEXR package: pip install 'finray-calib[exr]'") from None
