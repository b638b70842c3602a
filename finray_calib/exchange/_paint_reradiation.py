r"""A paint's spectra as plain arrays, and its re-radiation as bispectral OpenEXR or as a matrix of camera and lights.

OpenEXR is after Fichet, Pacanowski and Wilkie 2021 (An OpenEXR Layout for Spectral Images, JCGT 10-3). A pixel holds
the paint's reradiation matrix on one wavelength axis: channel ``T.<l>nm`` is the diagonal, channel
``T.<in>nm.<out>nm`` with in < out what comes from one band and leaves in another; wavelengths have a decimal comma.
Values are bispectral radiance factors per emission band, as in measured Donaldson matrices.

The reduced matrix, camera RGB x lights, is JSON for renderers that know no spectra, one key per line. With s the
light's spectral power of unit area, Q_c the camera's response, rho the reflectance, f the emission per nm under the
laser and g the emitted energy relative to that under the laser:

.. math::
    R_c = \int \rho(\lambda) s(\lambda) Q_c(\lambda)\,d\lambda, \qquad
    F_c = \int s(\lambda_i) g(\lambda_i)
        \int_{\lambda_o > \lambda_i} f(\lambda_o) Q_c(\lambda_o)\,d\lambda_o\,d\lambda_i

A diffuse paint under the irradiance E then gives the camera signal (R_c + F_c) E / pi in units of the response. This
is exact for light that meets the paint once; light between paints needs their own columns (a second light).
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CurveError,
    ImportFormatError,
    MissingExtraError,
    PaintCalibration,
    Provenance,
    SpectralCurve,
    require_coverage,
)
from data_schemas.storage import parse_in_child, read_bytes
from finray_calib.spectra import trapezoidal_weights

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PaintSpectra:
    """Emission, relative absorption and reflectance of one paint with their uncertainties.

    The absorption counts photons; the bispectral radiance factor per nm of emission counts energy:
    ``D(out, in) = emission_per_nm(out) absorption_rel(in) in / laser_nm`` for out > in and zero elsewhere. Draw k of
    the emission belongs to draw k of the absorption.

    Attributes
    ----------
    name
        The paint.
    statement
        What the absorption rests on, in words.
    warnings
        What the fit warns of.
    laser_nm
        Excitation of the emission.
    wavelength_nm, emission_per_nm
        (L,) grid and posterior mean of the emission for excitation at the laser line, 1/nm.
    emission_draws_per_nm
        (N, L) posterior draws of the emission, 1/nm.
    excitation_nm, absorption_rel
        (E,) grid and posterior mean of the absorption of photons relative to that at the laser line.
    absorption_rel_draws
        (N, E) its posterior draws.
    reflectance_nm, reflectance, reflectance_sd
        (K,) increasing filter centres, non-fluorescent reflectance there (0..1) and its standard deviation.
    """

    name: str
    statement: str
    warnings: tuple[str, ...]
    laser_nm: float
    wavelength_nm: Floats
    emission_per_nm: Floats
    emission_draws_per_nm: Floats
    excitation_nm: Floats
    absorption_rel: Floats
    absorption_rel_draws: Floats
    reflectance_nm: Floats
    reflectance: Floats
    reflectance_sd: Floats

    def __post_init__(self) -> None:
        draws, sizes = len(self.emission_draws_per_nm), (len(self.wavelength_nm), len(self.excitation_nm))
        shapes: dict[str, tuple[int, ...]] = {
            "emission_per_nm": sizes[:1],
            "emission_draws_per_nm": (draws, sizes[0]),
            "absorption_rel": sizes[1:],
            "absorption_rel_draws": (draws, sizes[1]),
            "reflectance": (len(self.reflectance_nm),),
            "reflectance_sd": (len(self.reflectance_nm),),
        }
        for field, wanted in shapes.items():
            found = getattr(self, field).shape
            if found != wanted:
                raise CurveError(
                    f"paint '{self.name}': {field} has shape {found}, but must have shape {wanted} (draws of emission "
                    "and absorption are paired); run 'finray fit' again"
                )

    @property
    def excitation_rel_draws(self) -> Floats:
        """Posterior draws (N, E) of the energy emitted per incident energy, relative to that at the laser line."""
        return self.absorption_rel_draws * self.excitation_nm / self.laser_nm

    def reflectance_at(self, wavelength_nm: Floats) -> Floats:
        """Return the reflectance (0..1), linear between the filters and held beyond the outer ones."""
        return np.asarray(np.interp(wavelength_nm, self.reflectance_nm, self.reflectance))


def paint_spectra(paint: PaintCalibration) -> PaintSpectra:
    """Return the curves of a calibrated paint.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.

    Raises
    ------
    CurveError
        The draws of emission and absorption are not paired one to one.
    """
    reradiation = paint.reradiation
    centers_nm = np.array([f.center_nm for f in paint.optics.filters])
    order = np.argsort(centers_nm)
    return PaintSpectra(
        name=paint.paint_name,
        statement=reradiation.statement,
        warnings=paint.warnings,
        laser_nm=reradiation.laser_nm,
        wavelength_nm=paint.wavelength_nm,
        emission_per_nm=paint.emission_per_nm,
        emission_draws_per_nm=np.asarray(paint.emission_draws_per_nm, dtype=np.float64),
        excitation_nm=reradiation.excitation_nm,
        absorption_rel=reradiation.absorption_rel,
        absorption_rel_draws=np.asarray(reradiation.absorption_rel_draws, dtype=np.float64),
        reflectance_nm=centers_nm[order],
        reflectance=np.clip([r.estimate for r in paint.reflectance], 0.0, 1.0)[order],
        reflectance_sd=np.array([r.sd for r in paint.reflectance])[order],
    )


def readable_json(content: dict[str, Any]) -> str:
    """Return JSON text with objects indented and every list without objects inside on one line.

    Parameters
    ----------
    content
        Dicts, lists, texts, finite numbers, booleans and None.
    """
    return _text(content, 0) + "\n"


def _text(value: Any, depth: int) -> str:
    """Return a value, indented by its depth."""
    inner, outer = " " * (depth + 1), " " * depth
    if isinstance(value, dict) and value:
        rows = (f"{inner}{_plain(str(key))}: {_text(item, depth + 1)}" for key, item in value.items())
        return "{\n" + ",\n".join(rows) + f"\n{outer}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "[\n" + ",\n".join(inner + _text(item, depth + 1) for item in value) + f"\n{outer}]"
    return _plain(value)


def _plain(value: Any) -> str:
    """Return a value on one line; NaN has no place in JSON."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


FIRST_NM, LAST_NM, BAND_NM = 380.0, 780.0, 10.0
LAYOUT_VERSION = "1.0"
VERSION_ATTRIBUTE = "spectralLayoutVersion"
# A hundred samples per band square: the diagonal edge of the emission cuts through the squares.
_SAMPLES_PER_BAND = 10
_WAVELENGTH = r"((?:\d+,?\d*|,\d+)(?:[eE][-+]?\d+)?)nm"
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
                f"{path}: pixel row {row_px}, column {column_px} lies outside the image of {pixels.shape[0]} x "
                f"{pixels.shape[1]} px"
            )
        excitation_nm, emission_nm = (float(text.replace(",", ".")) for text in (match[1], match[2] or match[1]))
        found[excitation_nm, emission_nm] = float(pixels[row_px, column_px])
    axis_nm = np.unique([excitation_nm for excitation_nm, _ in found])
    if len(found) == len(axis_nm) or len(axis_nm) < 2:
        raise ImportFormatError(
            f"{path}: has no bispectral channels T.<in>nm.<out>nm; give a bispectral image in the format of Fichet et "
            "al. 2021"
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
        raise MissingExtraError(
            "OpenEXR images need the OpenEXR package; install it with pip install 'finray-calib[exr]'"
        ) from None


CHANNELS = ("red", "green", "blue")
ASSUMED_PEAK_NM, ASSUMED_FWHM_NM = 450.0, 20.0
# Of a Gaussian of this half span nothing that matters is left outside: 2^-36.
_HALF_SPAN_FWHM = 3.0
_STEP_NM = 0.5
CameraResponse = tuple[SpectralCurve, SpectralCurve, SpectralCurve]


@dataclass(frozen=True, slots=True)
class LedCameraMatrix:
    """Camera signal per irradiance of each light, rows red, green, blue, columns the lights (3, lights).

    Attributes
    ----------
    reflected, reflected_sd
        By reflectance; the filters' reflectances count as independent.
    fluorescent, fluorescent_sd
        By fluorescence, over the paired draws of emission and absorption.
    white
        Signal of a perfect white diffuser: divide by it for a radiance factor per channel.
    notes
        Where a curve ends too early and its end value is held.
    """

    lights: tuple[str, ...]
    reflected: Floats
    reflected_sd: Floats
    fluorescent: Floats
    fluorescent_sd: Floats
    white: Floats
    notes: tuple[str, ...]


def assumed_led() -> SpectralCurve:
    """Return a Gaussian stand-in for a blue LED: 450 nm, FWHM 20 nm."""
    half_nm = _HALF_SPAN_FWHM * ASSUMED_FWHM_NM
    offset_nm = np.arange(-half_nm, half_nm + _STEP_NM / 2, _STEP_NM)
    return SpectralCurve(
        name=f"LED, {ASSUMED_PEAK_NM:g} nm, FWHM {ASSUMED_FWHM_NM:g} nm",
        wavelength_nm=ASSUMED_PEAK_NM + offset_nm,
        values=np.exp2(-((2 * offset_nm / ASSUMED_FWHM_NM) ** 2)),
        source="assumed",
    )


def led_camera_matrix(
    spectra: PaintSpectra, lights: Sequence[SpectralCurve], response: CameraResponse
) -> LedCameraMatrix:
    """Return how much of each light's irradiance a camera sees return in R, G and B.

    Parameters
    ----------
    spectra
        Curves of the paint.
    lights
        Relative spectral power of each light (energy per nm), any scale.
    response
        Camera response per channel (signal per energy), in the caller's unit.

    Raises
    ------
    CurveError
        Absorption, emission or response misses more than 20 % of a light or of the emission.
    """
    columns = [_one_light(spectra, light, response) for light in lights]

    def beside(field: str) -> Floats:
        return np.hstack([getattr(column, field) for column in columns])

    return LedCameraMatrix(
        lights=tuple(name for column in columns for name in column.lights),
        reflected=beside("reflected"),
        reflected_sd=beside("reflected_sd"),
        fluorescent=beside("fluorescent"),
        fluorescent_sd=beside("fluorescent_sd"),
        white=beside("white"),
        notes=tuple(dict.fromkeys(note for column in columns for note in column.notes)),
    )


def _one_light(spectra: PaintSpectra, light: SpectralCurve, response: CameraResponse) -> LedCameraMatrix:
    """Return the matrix of one light."""
    grid_nm = np.union1d(_fine(light.wavelength_nm), spectra.wavelength_nm)
    inside = (grid_nm >= light.wavelength_nm[0]) & (grid_nm <= light.wavelength_nm[-1])
    weight = trapezoidal_weights(grid_nm) * np.where(inside, light(grid_nm), 0.0)
    weight = weight / weight.sum()
    seen = np.array([curve(grid_nm) for curve in response])
    # A filter's reflectance moves the interpolated curve linearly: one hat function per filter.
    hats = np.array([np.interp(grid_nm, spectra.reflectance_nm, unit) for unit in np.eye(len(spectra.reflectance_nm))])
    shares = (seen * weight) @ hats.T
    fluorescent = _fluorescent(spectra, grid_nm, weight, seen)
    return LedCameraMatrix(
        lights=(f"{light.name} ({light.source})",),
        reflected=(shares @ spectra.reflectance)[:, None],
        reflected_sd=np.sqrt(shares**2 @ spectra.reflectance_sd**2)[:, None],
        fluorescent=fluorescent.mean(axis=0)[:, None],
        fluorescent_sd=fluorescent.std(axis=0, ddof=1)[:, None],
        white=(seen @ weight)[:, None],
        notes=_notes(spectra, light, response),
    )


def _fluorescent(spectra: PaintSpectra, grid_nm: Floats, weight: Floats, seen: Floats) -> Floats:
    """Return F_c of every draw, (draws, 3); nothing is emitted at or below the excitation."""
    lit = weight > 0
    axis_nm = spectra.wavelength_nm
    emitted = np.array([np.interp(grid_nm, axis_nm, row, left=0, right=0) for row in spectra.emission_draws_per_nm])
    absorbed = np.array([np.interp(grid_nm[lit], spectra.excitation_nm, row) for row in spectra.excitation_rel_draws])
    parts = []
    for channel in seen:
        signal = emitted * channel
        steps = np.diff(grid_nm) * (signal[:, 1:] + signal[:, :-1]) / 2
        above = np.zeros_like(signal)  # integral over all that is emitted beyond each wavelength
        above[:, :-1] = np.cumsum(steps[:, ::-1], axis=1)[:, ::-1]
        parts.append((above[:, lit] * absorbed) @ weight[lit])
    return np.stack(parts, axis=1)


def _notes(spectra: PaintSpectra, light: SpectralCurve, response: CameraResponse) -> tuple[str, ...]:
    """Check that the curves cover the light and the emission; return what is held."""
    absorption = SpectralCurve(
        name="absorption", wavelength_nm=spectra.excitation_nm, values=spectra.absorption_rel, source=spectra.name
    )
    emitted = np.maximum(spectra.emission_per_nm, 0.0)
    checks = [require_coverage(absorption, light.wavelength_nm, light.values, light.name)]
    for curve in response:
        checks.append(require_coverage(curve, light.wavelength_nm, light.values, light.name))
        checks.append(require_coverage(curve, spectra.wavelength_nm, emitted, "the emission"))
    return tuple(note for note in checks if note is not None)


def _fine(wavelength_nm: Floats) -> Floats:
    """Return a grid that holds the given wavelengths and steps of at most 0.5 nm."""
    even = np.arange(wavelength_nm[0], wavelength_nm[-1], _STEP_NM)
    return np.union1d(even, wavelength_nm)


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
            "the standard deviations include the paint's uncertainty, but not that of light and camera response",
            "reflectance is interpolated between the filters",
        ],
        "provenance": origin.model_dump(mode="json"),
    }
    return readable_json(content)


def _rows(values: Floats) -> list[list[float]]:
    """Return a matrix as lists, rounded to six digits."""
    return [[float(f"{value:.6g}") for value in row] for row in values]
