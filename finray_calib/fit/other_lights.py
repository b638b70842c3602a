"""Sessions of one paint under several excitation lights, and the energy yields that they give."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from data_schemas.radiometry import BandSignals
from finray_calib.fit.absorption_fit import LARGEST_YIELD_SD_REL, ExcitationYield
from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.family_fits import fit_family
from finray_calib.fit.fit_options import FitOptions
from finray_calib.fit.measured_bands import band_data
from finray_calib.spectra.rig_curves import WAVELENGTH_NM

Floats = NDArray[np.float64]

_SMALLEST_YIELD_SD_REL: Final = 1e-4  # draws that all agree still measure no yield better than this
_ABOVE_EXCITATION_NM: Final = 20.0  # emission is compared between lights only beyond the longest light's own line


def refuse_unfit_lights(bands: BandSignals, other_lights: Sequence[BandSignals]) -> None:
    """Refuse other lights of another paint or at a wavelength that was given already.

    Raises
    ------
    FitError
        The sessions are not of one paint, or two have the same excitation.
    """
    for light in other_lights:
        if light.paint_name != bands.paint_name:
            raise FitError(
                f"other lights: a session is of paint {light.paint_name!r}, the first of {bands.paint_name!r}; give "
                "sessions of one paint (the paint_name of their plans)"
            )
    lights_nm = [light.optics.laser.wavelength_nm for light in (bands, *other_lights)]
    if len(set(lights_nm)) < len(lights_nm):
        raise FitError(
            f"other lights: two sessions have the same excitation ({', '.join(f'{nm:g}' for nm in lights_nm[1:])} nm "
            f"and the first at {lights_nm[0]:g} nm); give one session per light"
        )


def excited_emission(
    light: BandSignals, family: str, options: FitOptions, rng: np.random.Generator
) -> tuple[float, EmissionPosterior]:
    """Return the wavelength of another light, nm, and the emission that it excites."""
    return light.optics.laser.wavelength_nm, fit_family(band_data(light), family, options, rng)


def excitation_yields(curves_per_nm: Mapping[float, Floats]) -> list[ExcitationYield]:
    """Return the yield of each light, all counted over the same emission wavelengths.

    The area of the emission above the longest light. Alone, the laser's yield constrains nothing, however uncertain
    it is; beside others a light that is too uncertain is for the absorption fit to refuse.

    Parameters
    ----------
    curves_per_nm
        (N, L) emission draws by excitation wavelength, nm; the laser's first.
    """
    counted = max(curves_per_nm) + _ABOVE_EXCITATION_NM <= WAVELENGTH_NM
    largest = LARGEST_YIELD_SD_REL if len(curves_per_nm) == 1 else np.inf
    yields = []
    for excitation_nm, curves in curves_per_nm.items():
        area = curves[:, counted].sum(axis=1)
        sd_rel = float(np.clip(area.std() / area.mean(), _SMALLEST_YIELD_SD_REL, largest))
        yields.append(ExcitationYield(excitation_nm, float(area.mean()), sd_rel))
    return yields
