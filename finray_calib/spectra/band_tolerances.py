"""How the band values of a rig move within the tolerances of its filters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.curves import SpectralCurve
from data_schemas.filter_curves import half_maximum_nm
from data_schemas.radiometry import Optics
from finray_calib.spectra.band_weights import read_only
from finray_calib.spectra.rig_curves import weights_of

Floats = NDArray[np.float64]
LN_10 = float(np.log(10.0))


@dataclass(frozen=True, slots=True)
class BandTolerances:
    """Change of the band weights per standard uncertainty of each filter's centre and width, and of its blocking.

    For the N rows of :class:`EmissionWeights`, band-major.

    Attributes
    ----------
    emission_shift
        (2, N, L) change of a row's emission weights for one standard uncertainty of its own filter's centre and
        width, the laser level V held.
    laser_shift
        (2, N) the same for the reflected laser.
    level_shift
        (2,) relative change of V for one standard uncertainty of the excitation filter's centre and width.
    blocking_sd
        (N,) standard deviation of ln(leak) of a row's filter around the common blocking.
    filter_names
        Name of each of the B filters.
    """

    emission_shift: Floats
    laser_shift: Floats
    level_shift: Floats
    blocking_sd: Floats
    filter_names: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("emission_shift", "laser_shift", "level_shift", "blocking_sd"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def tolerances_of(optics: Optics, channel_weights: ArrayLike) -> BandTolerances:
    """Return the tolerances of a rig by forward differences of one standard uncertainty.

    A measured transmission is shifted as a whole, and stretched about its centre, by the uncertainties of its filter.

    Valid while a tolerance is small against the filter's width: the response is taken as linear in it.

    Parameters
    ----------
    optics
        Nominal curves with the filters' uncertainties.
    channel_weights
        (3,) weights of the channels in V.
    """
    nominal = weights_of(optics, channel_weights)
    excitation = optics.excitation_filter
    emission, laser, level = [], [], []
    for field in ("center_nm", "fwhm_nm"):
        only = weights_of(_moved(optics, field, {excitation}), channel_weights)
        others = ~nominal.is_excitation
        ratio = float(only.emission[others].sum() / nominal.emission[others].sum())  # V_nominal / V_moved
        moved = weights_of(_moved(optics, field, {f.name for f in optics.filters}), channel_weights)
        emission.append(moved.emission / ratio - nominal.emission)
        laser.append(moved.reflected_laser / ratio - nominal.reflected_laser)
        level.append(1 / ratio - 1)
    blocking = np.array([LN_10 * f.blocking_uncertainty_od for f in optics.filters])
    names = tuple(f.name for f in optics.filters)
    return BandTolerances(np.array(emission), np.array(laser), np.array(level), blocking[nominal.band_index], names)


def _moved(optics: Optics, field: str, names: set[str]) -> Optics:
    """Return the optics with some filters moved by one standard uncertainty."""

    def move(band: BandPassFilter) -> BandPassFilter:
        uncertainty = band.center_uncertainty_nm if field == "center_nm" else band.fwhm_uncertainty_nm
        return band.model_copy(update={field: getattr(band, field) + uncertainty})

    curves = {
        f.name: _moved_curve(optics.filter_curves[f.name], f, field)
        for f in optics.filters
        if f.name in names & optics.filter_curves.keys()
    }
    return optics.model_copy(
        update={
            "filters": tuple(move(f) if f.name in names else f for f in optics.filters),
            "filter_curves": {**optics.filter_curves, **curves},
        }
    )


def _moved_curve(curve: SpectralCurve, band: BandPassFilter, field: str) -> SpectralCurve:
    """Return a measured transmission shifted or stretched about its centre by one standard uncertainty."""
    if field == "center_nm":
        moved_nm = curve.wavelength_nm + band.center_uncertainty_nm
    else:
        low_nm, high_nm = half_maximum_nm(curve)
        center_nm, stretch = 0.5 * (low_nm + high_nm), 1.0 + band.fwhm_uncertainty_nm / (high_nm - low_nm)
        moved_nm = center_nm + stretch * (curve.wavelength_nm - center_nm)
    return curve.model_copy(update={"wavelength_nm": moved_nm})
