"""The known curves of a rig on one wavelength grid, and how band values move within the tolerances of its filters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import BandPassFilter, LaserSettings, Optics, SpectralCurve, half_maximum_nm
from finray_calib.spectra._band_weights import EmissionWeights, FilterSet, emission_weights, read_only

Floats = NDArray[np.float64]
WAVELENGTH_NM: Floats = np.arange(380.0, 781.0, 1.0)
WAVELENGTH_NM.flags.writeable = False
# Hat function of one grid step: its weights on a tenth of a step integrate a curve exactly as far as the emission is
# linear between grid points. The edge of a hard-coated filter is steeper than the grid.
_HAT_OFFSET_NM: Floats = np.linspace(-0.9, 0.9, 19)
_HAT: Floats = (1.0 - np.abs(_HAT_OFFSET_NM)) / 10.0


def filter_transmission(band: BandPassFilter, wavelength_nm: ArrayLike) -> Floats:
    """Return the nominal transmission of a filter: a pass band over its blocking floor (0..1).

    ``T = T_peak 2^(-|2 (l - center) / fwhm|^(2 p)) + 10^-OD``, with p = 1 a Gaussian and p = 2 the flat top of
    a hard-coated filter.
    """
    x = np.abs(2 * (np.asarray(wavelength_nm, dtype=float) - band.center_nm) / band.fwhm_nm)
    passed = band.peak_transmission * np.exp2(-(x ** (2 * band.shape_order)))
    return np.asarray(passed + 10.0**-band.blocking_od)


def measured_transmission(curve: SpectralCurve, blocking_od: float) -> Floats:
    """Return a measured transmission averaged over the steps of the grid, (L,): outside its range the floor 10^-OD.

    Where it falls below the floor the floor holds as well: blocking is known from the filter's data, not from the
    noise of a spectrophotometer.
    """
    fine_nm = WAVELENGTH_NM[:, None] + _HAT_OFFSET_NM
    inside = (fine_nm >= curve.wavelength_nm[0]) & (fine_nm <= curve.wavelength_nm[-1])
    return np.asarray(np.maximum(np.where(inside, curve(fine_nm), 0.0), 10.0**-blocking_od) @ _HAT)


def transmissions(optics: Optics) -> Floats:
    """Return the transmission of every filter on the grid, (B, L): the measured curve where there is one."""
    return np.array([_transmission(optics, band) for band in optics.filters])


def _transmission(optics: Optics, band: BandPassFilter) -> Floats:
    """Return the transmission of one filter on the grid, (L,)."""
    if band.name in optics.filter_curves:
        return measured_transmission(optics.filter_curves[band.name], band.blocking_od)
    return filter_transmission(band, WAVELENGTH_NM)


def laser_line(laser: LaserSettings, wavelength_nm: ArrayLike) -> Floats:
    """Return the relative spectrum of the laser: a Gaussian line of its full width at half maximum."""
    x = 2 * (np.asarray(wavelength_nm, dtype=float) - laser.wavelength_nm) / laser.fwhm_nm
    return np.asarray(2.0 ** (-(x**2)))


def weights_of(optics: Optics, channel_weights: ArrayLike) -> EmissionWeights:
    """Return the band weights of a rig on the 380-780 nm grid.

    Parameters
    ----------
    optics
        Curves stored with the band signals.
    channel_weights
        (3,) weights of the channels in the laser level V (sum 1).
    """
    grid = WAVELENGTH_NM
    names = [f.name for f in optics.filters]
    return emission_weights(
        grid,
        FilterSet(
            transmissions(optics),
            names.index(optics.excitation_filter),
            np.array([10.0**-f.blocking_od for f in optics.filters]),
        ),
        np.array([curve(grid) for curve in optics.camera_response]),
        optics.lamp(grid),
        np.full(grid.shape, optics.white_reference.reflectance),
        laser_line(optics.laser, grid),
        channel_weights,
    )


SECOND_RADIATION_CONSTANT_NM_K = 1.438776877e7


def lamp_response(optics: Optics, channel_weights: ArrayLike) -> Floats:
    r"""Return the relative change of each band value for one standard uncertainty of the lamp's temperature, (N,).

    Band values are referred to white under the lamp, filter by filter, and to the laser through the excitation filter,

    .. math:: \frac{d \ln y_{bc}}{dT} = -\left<g\right>_{bc} + \sum_c v_c \left<g\right>_{ec}, \qquad
              g = \frac{d \ln L}{dT} = \frac{c_2}{\lambda T^2}

    with the means over the white signal, and v the shares of the channels in the level of the laser. Valid for a lamp
    whose error is a tilt of its spectrum, as that of a temperature is (Wien's law, good to 1 % below 800 nm at 2856 K).

    Parameters
    ----------
    optics
        Curves with the lamp's temperature and its uncertainty.
    channel_weights
        (3,) weights of the channels in the laser level (sum 1).
    """
    grid = WAVELENGTH_NM
    response = np.array([curve(grid) for curve in optics.camera_response])
    white = transmissions(optics)[:, None, :] * response * optics.lamp(grid)
    slope = SECOND_RADIATION_CONSTANT_NM_K / (grid * optics.lamp_temperature_k**2)
    mean = (white @ slope) / white.sum(axis=2)
    excitation = [f.name for f in optics.filters].index(optics.excitation_filter)
    seen = response @ laser_line(optics.laser, grid) / white[excitation].sum(axis=1)
    share = np.asarray(channel_weights) * seen
    level = float(share @ mean[excitation] / share.sum())
    return np.asarray(optics.lamp_temperature_uncertainty_k * (level - mean).ravel())


def held_shares(optics: Optics) -> Floats:
    """Return the share of each band's weight over which the response or the lamp holds an end value, (B, 3)."""
    shares = []
    blocked = tuple(band.model_copy(update={"blocking_od": 12.0}) for band in optics.filters)
    for passed in transmissions(optics.model_copy(update={"filters": blocked})):
        lamp = optics.lamp.share_outside(WAVELENGTH_NM, passed)
        shares.append([np.hypot(c.share_outside(WAVELENGTH_NM, passed), lamp) for c in optics.camera_response])
    return np.array(shares)


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
