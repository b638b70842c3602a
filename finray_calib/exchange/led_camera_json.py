"""The reduced reradiation matrix as JSON, and the light spectra it is made for."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas.curve_files import read_table
from data_schemas.curves import SpectralCurve
from data_schemas.errors import CurveError
from data_schemas.provenance import Provenance
from finray_calib.exchange.led_camera_matrix import CHANNELS, CameraResponse, led_camera_matrix
from finray_calib.exchange.paint_spectra import PaintSpectra
from finray_calib.exchange.readable_json import readable_json

Floats = NDArray[np.float64]
LIGHT_COLUMNS = ["wavelength_nm", "power_rel"]


def read_light(path: Path) -> SpectralCurve:
    """Read the relative spectral power (energy per nm) of a light: CSV with wavelength_nm,power_rel.

    Raises
    ------
    CurveError
        The file is not such a table, a value is negative, or all are zero.
    """
    header, table = read_table(path)
    if header != LIGHT_COLUMNS:
        raise CurveError(f"{path}: header is {','.join(header)[:80]}; a light needs {','.join(LIGHT_COLUMNS)}")
    power = table[:, 1]
    if (power < 0).any() or not power.any():
        raise CurveError(f"{path}: power_rel must be 0 or more and somewhere above 0; correct or remove the rows")
    try:
        return SpectralCurve(name=path.stem, wavelength_nm=table[:, 0], values=power, source=path.name)
    except ValidationError as error:
        raise CurveError(f"{path}: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from None


def led_camera_json(
    spectra: PaintSpectra, lights: Sequence[SpectralCurve], response: CameraResponse, origin: Provenance
) -> str:
    """Return the reduced reradiation matrix (camera RGB x lights) with uncertainty as JSON.

    Parameters
    ----------
    spectra
        Curves of the paint.
    lights
        Relative spectral power of each light.
    response
        Camera response, red, green, blue.
    origin
        Provenance of the export.
    """
    matrix = led_camera_matrix(spectra, lights, response)
    total_sd = np.hypot(matrix.reflected_sd, matrix.fluorescent_sd)
    content = {
        "what": "reduced reradiation matrix: camera signal of a diffuse paint per irradiance of each light, times pi",
        "paint": spectra.name,
        "rows": list(CHANNELS),
        "columns": list(matrix.lights),
        "unit": "response of the camera per energy; divide by 'white' for the radiance factor of each channel",
        "white": _rows(matrix.white),
        "reflected": _rows(matrix.reflected),
        "reflected_sd": _rows(matrix.reflected_sd),
        "fluorescent": _rows(matrix.fluorescent),
        "fluorescent_sd": _rows(matrix.fluorescent_sd),
        "total": _rows(matrix.reflected + matrix.fluorescent),
        "total_sd": _rows(total_sd),
        "camera_response": [
            {"channel": curve.name, "source": curve.source, "uncertainty_rel": curve.uncertainty_rel}
            for curve in response
        ],
        "absorption": spectra.statement,
        "warnings": list(spectra.warnings),
        "notes": [
            *matrix.notes,
            "the standard deviations hold the paint's uncertainty, not that of light and camera response",
            "reflectance is interpolated between the filters",
        ],
        "provenance": origin.model_dump(mode="json"),
    }
    return readable_json(content)


def _rows(values: Floats) -> list[list[float]]:
    """Return a matrix as lists, rounded to six digits."""
    return [[float(f"{value:.6g}") for value in row] for row in values]
