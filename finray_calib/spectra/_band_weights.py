r"""From curves of filter, camera, lamp, white and laser to the weights that turn an emission curve into band values.

A band value is :math:`\int w_{bc}(\lambda) f(\lambda)\,d\lambda`, which a quadrature of few nodes evaluates. Inside the
pass band a Gauss rule of the measure :math:`\sum_c w_{bc}` (Stieltjes recursion, Golub and Welsch) has nodes common to
the band's channels, and each channel its own interpolatory weights. The blocking floor is a thousand times weaker but
forty times wider: its weights are projected on the cubic splines of a 10 nm grid that all bands share. Six nodes a band
and 41 shared ones replace 401 wavelengths; one rule for both parts would lose up to a fifth of a weak band.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import CurveError, FitError

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


class FilterSet(NamedTuple):
    """The filters of a wheel on a grid of wavelengths.

    Attributes
    ----------
    transmission
        (B, L) transmission T_b, 0 to 1, blocking floor included.
    excitation_band
        Index e of the filter that passes the laser.
    leak
        (B,) or one transmission 10^-OD outside the pass band, contained in `transmission` at all wavelengths.
    """

    transmission: ArrayLike
    excitation_band: int
    leak: ArrayLike = 0.0


def emission_weights(
    wavelength_nm: ArrayLike,
    filters: FilterSet,
    response: ArrayLike,
    lamp: ArrayLike,
    white_reflectance: ArrayLike,
    laser: ArrayLike,
    channel_weights: ArrayLike,
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
    filters
        B filters and which of them passes the laser.
    response
        (C, L) camera response Q_c, any common unit.
    lamp
        (L,) relative spectral power E of the white lamp.
    white_reflectance
        (L,) reflectance R of the white reference, 0 to 1.
    laser
        (L,) laser line s, any scale.
    channel_weights
        (C,) weights w_c of the channels in V; they sum to 1.

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
    excitation_band = filters.excitation_band
    wavelength, transmission, camera, light, white, line = _checked_curves(
        wavelength_nm, filters.transmission, response, lamp, white_reflectance, laser
    )
    share = _channel_shares(channel_weights, len(camera))
    quadrature = _trapezoid(wavelength)
    line = _unit_area("laser", line, quadrature)
    passed = transmission[:, None, :] * camera[None, :, :] * quadrature
    white_signal = _lit_white(passed @ (white * light))
    visible = _visible_laser(passed @ (white * line), white_signal, excitation_band, share)
    scale = 1.0 / (white_signal * visible)
    laser_nm = float(wavelength @ (line * quadrature))
    above = wavelength >= laser_nm
    bands = np.repeat(np.arange(len(transmission)), len(camera))
    floor = np.broadcast_to(np.asarray(filters.leak, dtype=np.float64), len(transmission)).copy()
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


BAND_NODES: Final = 6
GRID_STEP_NM: Final = 10.0
PASS_BAND_SHARE: Final = 1e-3
"""A wavelength belongs to the pass band where it exceeds the leak and this share of the band's largest weight."""


@dataclass(frozen=True, slots=True)
class BandQuadrature:
    """Nodes and weights of all rows (band-major) of :class:`EmissionWeights`.

    Attributes
    ----------
    nodes_nm
        (B, Q) Gauss nodes of each band, nm.
    in_band
        (N, Q) weights at the nodes of the row's band, nm.
    grid_nm
        (G,) shared grid, nm.
    out_of_band
        (N, G) weights of the remainder, nm.
    leaked
        (N, G) weights of the nominal leak, nm.
    """

    nodes_nm: FloatArray
    in_band: FloatArray
    grid_nm: FloatArray
    out_of_band: FloatArray
    leaked: FloatArray

    def __post_init__(self) -> None:
        for name in self.__slots__:
            object.__setattr__(self, name, read_only(getattr(self, name)))


def band_quadrature(weights: EmissionWeights) -> BandQuadrature:
    """Return the two-part rule of a rig.

    Valid for curves that a polynomial of degree 2 Q - 1 describes inside a pass band and a cubic spline with knots
    every 10 nm outside. For smooth emission 30 nm wide or wider the error is below 1e-3 of the band value; strong
    skews are kinked, and light that only leaks in is then right to a few per cent.

    Parameters
    ----------
    weights
        Weights of the rig on a fine grid.

    References
    ----------
    Golub, Welsch, Calculation of Gauss quadrature rules, Math. Comp. 23 (1969) 221-230.
    """
    wavelength = weights.wavelength_nm
    grid = np.arange(wavelength[0], wavelength[-1] + GRID_STEP_NM / 2, GRID_STEP_NM)
    cardinal = cardinal_splines(grid, wavelength)
    positions, in_band = [], np.zeros((len(weights.emission), BAND_NODES))
    remainder = weights.emission.copy()
    for band in range(weights.bands):
        rows = np.flatnonzero(weights.band_index == band)
        measure, leak = (part[rows].sum(axis=0) for part in (weights.emission, weights.leaked_emission))
        inside = measure - leak > np.maximum(leak, PASS_BAND_SHARE * measure.max())
        if inside.sum() <= BAND_NODES:  # the band lies below the laser: it sees emission through its leak only
            positions.append(np.full(BAND_NODES, weights.laser_nm))
            continue
        x = gauss_nodes(wavelength[inside], measure[inside], BAND_NODES)
        positions.append(x)
        in_band[rows] = weights.emission[np.ix_(rows, inside)] @ _lagrange(x, wavelength[inside])
        remainder[np.ix_(rows, inside)] = 0.0
    return BandQuadrature(np.array(positions), in_band, grid, remainder @ cardinal, weights.leaked_emission @ cardinal)


def cardinal_splines(grid: FloatArray, x: FloatArray) -> FloatArray:
    """Return the natural cubic splines that are 1 at one grid point and 0 at the others, at points within it, (L, G).

    Valid for an even grid.
    """
    count, step = grid.size, float(grid[1] - grid[0])
    value = np.eye(count)
    second = np.zeros((count, count))  # second derivative at each grid point of each spline; 0 at both ends
    inner = np.diag(np.full(count - 2, 4.0)) + np.diag(np.ones(count - 3), 1) + np.diag(np.ones(count - 3), -1)
    second[1:-1] = np.linalg.solve(inner, 6 / step**2 * np.diff(value, 2, axis=0))
    cell = np.clip(((x - grid[0]) / step).astype(int), 0, count - 2)
    right = ((x - grid[cell]) / step)[:, None]
    left = 1 - right
    bend = (left**3 - left) * second[cell] + (right**3 - right) * second[cell + 1]
    return np.asarray(left * value[cell] + right * value[cell + 1] + step**2 / 6 * bend)


def gauss_nodes(x: FloatArray, weight: FloatArray, count: int) -> FloatArray:
    """Return the nodes of the Gauss rule of the discrete measure sum_i weight_i delta(x - x_i), increasing.

    The rule is exact for polynomials of degree 2 count - 1. Needs more than `count` points of positive weight.
    """
    total = weight.sum()
    mean = float(weight @ x / total)
    scale = float(np.sqrt(weight @ (x - mean) ** 2 / total))
    t = (x - mean) / scale
    before, now, norm_before = np.zeros_like(t), np.ones_like(t), 1.0
    diagonal, off = [], []
    for _ in range(count):
        norm = float(weight @ now**2)
        diagonal.append(float(weight @ (t * now**2)) / norm)
        off.append(norm / norm_before)
        before, now = now, (t - diagonal[-1]) * now - (off[-1] if len(off) > 1 else 0.0) * before
        norm_before = norm
    beside = np.diag(np.sqrt(off[1:]), 1)
    return np.asarray(mean + scale * np.linalg.eigvalsh(np.diag(diagonal) + beside + beside.T))


def _lagrange(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Return the Lagrange polynomials of the nodes at (L,) points, (L, Q)."""
    columns = []
    for k, node in enumerate(nodes):
        others = np.delete(nodes, k)
        columns.append(np.prod((x[:, None] - others) / (node - others), axis=1))
    return np.stack(columns, axis=1)
