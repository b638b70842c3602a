"""From curves of filter, camera, lamp, white and laser to the weights that turn an emission curve into band values."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.errors import CurveError, FitError

FloatArray = NDArray[np.float64]
_Scalar = TypeVar("_Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True)
class EmissionWeights:
    """Linear map from an emission curve and a reflectance to the normalised band values of the rig.

    y = emission @ f + rho * reflected_laser with f the bispectral radiance factor per nm of emission (nm^-1) and
    rho the reflectance at the laser line. The part of all light that passes a filter outside its pass band is
    also kept apart, because its blocking is known poorly: with m times the nominal leak

        y = [(emission + (m - 1) leaked_emission) @ f + rho (reflected_laser + (m - 1) leaked_laser)]
            / [1 + (m - 1) leaked_white]

    Rows are band-major: band 0 channels R, G, B, then band 1, and so on.

    Attributes
    ----------
    wavelength_nm
        (L,) grid, nm.
    emission
        (N, L) weights in nm, quadrature included.
    reflected_laser
        (N,) value of a perfect reflector of the laser, dimensionless.
    leaked_emission, leaked_laser, leaked_white
        (N, L), (N,), (N,) share of the leak in the emission weights, in the reflected laser and in the white
        signal under the lamp; no laser leaks in the excitation band, it passes.
    is_excitation
        (N,) True for the rows of the excitation band.
    band_index
        (N,) index of the band of each row.
    laser_nm
        Centroid of the laser line, nm.
    """

    wavelength_nm: FloatArray
    emission: FloatArray
    reflected_laser: FloatArray
    leaked_emission: FloatArray
    leaked_laser: FloatArray
    leaked_white: FloatArray
    is_excitation: NDArray[np.bool_]
    band_index: NDArray[np.int64]
    laser_nm: float

    def __post_init__(self) -> None:
        rows, length = self.emission.shape
        shapes: dict[str, tuple[int, ...]] = {"emission": (rows, length), "leaked_emission": (rows, length)}
        shapes |= dict.fromkeys(("reflected_laser", "leaked_laser", "leaked_white"), (rows,))
        shapes |= {"wavelength_nm": (length,), "is_excitation": (rows,), "band_index": (rows,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FitError(f"emission weights: '{name}' has shape {getattr(self, name).shape}, must be {shape}")
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def bands(self) -> int:
        """Number of bands."""
        return int(self.band_index[-1]) + 1


def emission_weights(
    wavelength_nm: ArrayLike,
    transmission: ArrayLike,
    response: ArrayLike,
    lamp: ArrayLike,
    white_reflectance: ArrayLike,
    laser: ArrayLike,
    excitation_band: int,
    channel_weights: ArrayLike,
    leak: ArrayLike = 0.0,
) -> EmissionWeights:
    """Return the weights of y_bc = (F_bc / W_bc) / V for a sample of emission f and laser reflectance rho.

    With D_bc = int R E T_b Q_c dl (white under the lamp) and V = sum_c w_c int R s T_e Q_c dl / D_ec (white
    under the laser through the excitation filter e)::

        y_bc = [ int f T_b Q_c dl + rho m_b int s T_b Q_c dl ] / D_bc / V

    Whole curves are integrated by the trapezoidal rule on the given grid; the value at a filter's centre is wrong
    by up to 5 %. No paint emits below its excitation: f counts from the laser's centroid upwards. The laser is
    scaled to unit area. Valid when the grid covers every filter's pass band and resolves the laser line (1 nm
    steps for a 2 nm line).

    Parameters
    ----------
    wavelength_nm
        (L,) increasing grid, nm.
    transmission
        (B, L) filter transmission T_b, 0 to 1, blocking floor included.
    response
        (C, L) camera response Q_c, any common unit.
    lamp
        (L,) relative spectral power E of the white lamp.
    white_reflectance
        (L,) reflectance R of the white reference, 0 to 1.
    laser
        (L,) laser line s, any scale.
    excitation_band
        Index e of the filter that passes the laser.
    channel_weights
        (C,) weights w_c of the channels in V; they sum to 1.
    leak
        (B,) or one transmission 10^-OD outside the pass band, contained in `transmission` at all wavelengths.

    Returns
    -------
    EmissionWeights
        Rows in band-major order, B * C of them.

    Raises
    ------
    CurveError
        When a curve has a wrong shape, is not finite or is negative, or the grid does not increase.
    FitError
        When the white signal of a band and channel is zero, the excitation band does not exist or passes no
        laser light, or the channel weights do not sum to 1.
    """
    wavelength, filters, camera, light, white, line = _checked_curves(
        wavelength_nm, transmission, response, lamp, white_reflectance, laser
    )
    share = _channel_shares(channel_weights, len(camera))
    quadrature = _trapezoid(wavelength)
    line = _unit_area("laser", line, quadrature)
    passed = filters[:, None, :] * camera[None, :, :] * quadrature
    white_signal = _lit_white(passed @ (white * light))
    visible = _visible_laser(passed @ (white * line), white_signal, excitation_band, share)
    scale = 1.0 / (white_signal * visible)
    laser_nm = float(wavelength @ (line * quadrature))
    above = wavelength >= laser_nm
    bands = np.repeat(np.arange(len(filters)), len(camera))
    floor = np.broadcast_to(np.asarray(leak, dtype=np.float64), len(filters)).copy()
    leaked = floor[:, None, None] * camera * quadrature
    leaked_laser = leaked @ line
    leaked_laser[excitation_band] = 0.0  # the laser passes this filter; what leaks beside it is lamp and emission
    return EmissionWeights(
        wavelength_nm=wavelength,
        emission=(passed * above * scale[..., None]).reshape(bands.size, -1),
        reflected_laser=((passed @ line) * scale).ravel(),
        leaked_emission=(leaked * above * scale[..., None]).reshape(bands.size, -1),
        leaked_laser=(leaked_laser * scale).ravel(),
        leaked_white=((leaked @ (white * light)) / white_signal).ravel(),
        is_excitation=bands == excitation_band,
        band_index=bands,
        laser_nm=laser_nm,
    )


def _checked_curves(
    wavelength_nm: ArrayLike,
    transmission: ArrayLike,
    response: ArrayLike,
    lamp: ArrayLike,
    white_reflectance: ArrayLike,
    laser: ArrayLike,
) -> tuple[FloatArray, ...]:
    """Return the curves as arrays on one increasing grid."""
    wavelength = _curve("wavelength_nm", wavelength_nm, 1, None)
    if wavelength.size < 2 or (np.diff(wavelength) <= 0).any():
        raise CurveError("wavelength_nm: must be two or more increasing wavelengths in nm")
    tables = (("transmission", transmission), ("response", response))
    curves = (("lamp", lamp), ("white_reflectance", white_reflectance), ("laser", laser))
    return (
        wavelength,
        *(_curve(name, values, 2, wavelength.size) for name, values in tables),
        *(_curve(name, values, 1, wavelength.size) for name, values in curves),
    )


def _lit_white(white_signal: FloatArray) -> FloatArray:
    """Return the signal of white per band and channel, refusing one without light."""
    if (white_signal <= 0).any():
        band, channel = np.argwhere(white_signal <= 0)[0]
        raise FitError(
            f"white signal of band {band}, channel {channel} is zero: lamp, white reference, filter and camera "
            "curves have no common wavelength; check their ranges in nm"
        )
    return white_signal


def _visible_laser(laser_white: FloatArray, white_signal: FloatArray, excitation_band: int, share: FloatArray) -> float:
    """Return V, the laser on white as the excitation filter's band sees it."""
    if not 0 <= excitation_band < len(white_signal):
        raise FitError(
            f"excitation_band: {excitation_band} does not exist, there are bands 0 to {len(white_signal) - 1}"
        )
    visible = float(share @ (laser_white[excitation_band] / white_signal[excitation_band]))
    if visible <= 0:
        raise FitError(f"excitation band {excitation_band} passes no laser light: check filter and laser curves")
    return visible


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return a view that cannot be written through; the caller's array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view


def _curve(name: str, values: ArrayLike, dimensions: int, length: int | None) -> FloatArray:
    """Return checked values: right shape, finite, not negative."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != dimensions or (length is not None and array.shape[-1] != length):
        wanted = f"{dimensions} dimension(s)" + ("" if length is None else f" and {length} wavelengths")
        raise CurveError(f"{name}: shape {array.shape} is wrong, must have {wanted}")
    if not (np.isfinite(array) & (array >= 0)).all():
        raise CurveError(f"{name}: {int((~(array >= 0)).sum())} values are negative or not finite; must be 0 or more")
    return array


def _channel_shares(channel_weights: ArrayLike, channels: int) -> FloatArray:
    """Return the checked weights of the channels."""
    share = _curve("channel_weights", channel_weights, 1, channels)
    if abs(share.sum() - 1) > 1e-9:  # rounding of decimals written by hand is far below
        raise FitError(f"channel_weights: sum is {share.sum():g}, must be 1")
    return share


def _trapezoid(wavelength_nm: FloatArray) -> FloatArray:
    """Return the trapezoidal weights of a grid, nm."""
    step = np.diff(wavelength_nm)
    weights = np.zeros_like(wavelength_nm)
    weights[:-1] += step / 2
    weights[1:] += step / 2
    return weights


def _unit_area(name: str, curve: FloatArray, quadrature: FloatArray) -> FloatArray:
    """Return the curve divided by its area."""
    area = float(curve @ quadrature)
    if area <= 0:
        raise CurveError(f"{name}: area is zero on the grid; check its wavelength range in nm")
    return curve / area
