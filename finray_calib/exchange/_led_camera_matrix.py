r"""The reduced reradiation matrix of a paint as JSON: camera RGB x lights, for renderers that know no spectra.

With s the light's spectral power of unit area, Q_c the camera's response, rho the reflectance, f the emission per nm
under the laser and g the emitted energy relative to that under the laser:

.. math::
    R_c = \int \rho(\lambda) s(\lambda) Q_c(\lambda)\,d\lambda, \qquad
    F_c = \int s(\lambda_i) g(\lambda_i)
        \int_{\lambda_o > \lambda_i} f(\lambda_o) Q_c(\lambda_o)\,d\lambda_o\,d\lambda_i

A diffuse paint under the irradiance E then gives the camera signal (R_c + F_c) E / pi in units of the response. This
is exact for light that meets the paint once; light between paints needs their own columns (a second light).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import Provenance, SpectralCurve, require_coverage
from finray_calib.exchange._paint_spectra import PaintSpectra, readable_json

Floats = NDArray[np.float64]
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
    weight = _trapezoid(grid_nm) * np.where(inside, light(grid_nm), 0.0)
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


def _trapezoid(wavelength_nm: Floats) -> Floats:
    """Return the trapezoidal weights of a grid, nm."""
    step_nm = np.diff(wavelength_nm)
    return np.concatenate([step_nm[:1], step_nm[1:] + step_nm[:-1], step_nm[-1:]]) / 2


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
