"""Spectral curves that a rig or design refers to by name: the tungsten lamp and the stand-in camera response."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.curve_files import read_camera_response
from data_schemas.curves import SpectralCurve

Floats = NDArray[np.float64]
SECOND_RADIATION_CONSTANT_NM_K = 1.438776877e7
LAMP_TEMPERATURE_K = 2856.0
NORMALISED_AT_NM = 560.0
BELL_CENTER_NM = (610.0, 535.0, 460.0)
BELL_SD_NM = (40.0, 36.0, 30.0)
BLUE_LEAK_REL = (0.010, 0.012, 0.0)
INFRARED_CUT_NM = 690.0
INFRARED_CUT_WIDTH_NM = 8.0


def planck_relative(wavelength_nm: Floats, temperature_k: float) -> Floats:
    r"""Return the relative spectral radiance of a black body, 1 at 560 nm.

    .. math:: L(\lambda) \propto \lambda^{-5} / (\exp(c_2 / (\lambda T)) - 1)

    Parameters
    ----------
    wavelength_nm
        Wavelength in vacuum (nm), any shape.
    temperature_k
        Temperature (K).

    Returns
    -------
    ndarray
        Radiance per nm relative to that at 560 nm, same shape.
    """

    def radiance(x_nm: Floats) -> Floats:
        return (x_nm / NORMALISED_AT_NM) ** -5 / np.expm1(SECOND_RADIATION_CONSTANT_NM_K / (x_nm * temperature_k))

    return radiance(wavelength_nm) / radiance(np.array(NORMALISED_AT_NM))


def halogen_lamp() -> SpectralCurve:
    """Return the relative spectral irradiance of the lamp: Planck at 2856 K, 1 at 560 nm, 360 to 800 nm."""
    wavelength_nm = np.arange(360.0, 801.0)
    return SpectralCurve(
        name="tungsten halogen lamp",
        wavelength_nm=wavelength_nm,
        values=planck_relative(wavelength_nm, LAMP_TEMPERATURE_K),
        source="Planck radiator at 2856 K",
    )


def assumed_camera_response() -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return smooth stand-in curves of a Bayer camera (red, green, blue) with an infrared-cut filter.

    Response means signal per unit spectral radiance (power, not photons), relative. At 450 nm red passes 1.0 % of
    what blue passes and green 7.7 %, most of it the tail of its own bell. Good for planning and for simulated rigs; no
    real camera is calibrated by it.
    """
    wavelength_nm = np.arange(380.0, 781.0, 2.0)
    infrared_cut = 1.0 / (1.0 + np.exp((wavelength_nm - INFRARED_CUT_NM) / INFRARED_CUT_WIDTH_NM))
    bells = [
        np.exp(-0.5 * ((wavelength_nm - center) / sd) ** 2)
        for center, sd in zip(BELL_CENTER_NM, BELL_SD_NM, strict=True)
    ]
    red, green, blue = (
        SpectralCurve(
            name=name,
            wavelength_nm=wavelength_nm,
            values=(bell + leak * bells[2]) * infrared_cut,
            uncertainty_rel=0.1,
            source="assumed",
        )
        for name, bell, leak in zip(("red", "green", "blue"), bells, BLUE_LEAK_REL, strict=True)
    )
    return red, green, blue


def camera_response(name: str, folder: Path) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return the red, green and blue response that a rig or design file names.

    Parameters
    ----------
    name
        "assumed" (stand-in curves) or the path of a CSV file.
    folder
        Where a relative path starts.
    """
    return assumed_camera_response() if name == "assumed" else read_camera_response(folder / name)
