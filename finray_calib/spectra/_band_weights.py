r"""From curves of filter, camera, lamp, white and laser to the weights that turn an emission curve into band values.

A band value is :math:`\int w_{bc}(\lambda) f(\lambda)\,d\lambda`, which a quadrature of few nodes evaluates. Inside
the pass band a Gauss rule of the measure :math:`\sum_c w_{bc}` (Stieltjes recursion, Golub and Welsch) has nodes
common to the band's channels, and each channel its own interpolatory weights. The blocking floor is a thousand times
weaker but forty times wider: its weights are projected on the cubic splines of a 10 nm grid that all bands share. Six
nodes a band and 41 shared ones replace 401 wavelengths; one rule for both parts would lose up to a fifth of a weak
band.

The known curves of a rig are laid on one wavelength grid, and band values move within the tolerances of its filters.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import (
    BandPassFilter,
    CurveError,
    FitError,
    LaserSettings,
    Optics,
    SpectralCurve,
    half_maximum_nm,
    read_only,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EmissionWeights:
    """Linear map from an emission curve and a reflectance to the normalised band values of the rig.

    y = emission @ f + rho * reflected_laser with f the bispectral radiance factor per nm of emission (nm^-1) and
    rho the reflectance at the laser line. The part of all light that passes a filter outside its pass band is
    also kept apart, because its blocking is known poorly: with m times the nominal leak

        y = [(emission + (m - 1) leaked_emission) @ f + rho (reflected_laser + (m - 1) leaked_laser)]
            / [1 + (m - 1) leaked_white] / V(m)
        V(m) = sum level_share / [1 + (m - 1) leaked_white]

    V is the level of the laser over its nominal one, with the excitation filter's m: the lamp's light that leaks
    through that filter adds to the white signal to which the laser is referred, and so moves all values. Rows are
    band-major: band 0 channels R, G, B, then band 1, and so on.

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
    level_share
        (N,) share of each row in the level of the laser (sum 1), 0 outside the excitation band.
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
    level_share: FloatArray
    is_excitation: NDArray[np.bool_]
    band_index: NDArray[np.int64]
    laser_nm: float

    def __post_init__(self) -> None:
        rows, length = self.emission.shape
        shapes: dict[str, tuple[int, ...]] = {"emission": (rows, length), "leaked_emission": (rows, length)}
        shapes |= dict.fromkeys(("reflected_laser", "leaked_laser", "leaked_white", "level_share"), (rows,))
        shapes |= {"wavelength_nm": (length,), "is_excitation": (rows,), "band_index": (rows,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FitError(
                    f"emission weights: '{name}' has shape {getattr(self, name).shape}, but must have {shape}"
                )
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def bands(self) -> int:
        """Number of bands."""
        return int(self.band_index[-1]) + 1

    def divisor(self, more: FloatArray) -> FloatArray:
        """Return what divides the values, (..., N): white under the lamp times V, over the nominal ones.

        Parameters
        ----------
        more
            m - 1 of each row's filter, (..., N), or of all filters, (..., 1).
        """
        white = 1 + more * self.leaked_white
        return np.asarray(white * (self.level_share / white).sum(axis=-1, keepdims=True))

    def divisor_slopes(self, leak: FloatArray) -> FloatArray:
        """Return d ln(divisor) / d ln(m) of each filter's leak, (N, B).

        Parameters
        ----------
        leak
            (N,) m of each row's filter.
        """
        white = 1 + (leak - 1) * self.leaked_white
        slope = leak * self.leaked_white / white
        level = self.level_share / white
        slopes = slope[:, None] * (self.band_index[:, None] == np.arange(self.bands))
        slopes[:, self.band_index[np.argmax(self.is_excitation)]] -= float(level @ slope / level.sum())
        return np.asarray(slopes)


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
    quadrature = trapezoidal_weights(wavelength)
    line = _unit_area("laser", line, quadrature)
    passed = transmission[:, None, :] * camera[None, :, :] * quadrature
    white_signal = _lit_white(passed @ (white * light))
    visible = _visible_laser(passed @ (white * line), white_signal, excitation_band, share)
    scale = 1.0 / (white_signal * visible)
    laser_nm = float(wavelength @ (line * quadrature))
    above = wavelength >= laser_nm
    reflected_laser = (passed @ line) * scale
    level_share = np.zeros_like(reflected_laser)
    level_share[excitation_band] = share * (passed @ (white * line))[excitation_band] * scale[excitation_band]
    bands = np.repeat(np.arange(len(transmission)), len(camera))
    floor = np.broadcast_to(np.asarray(filters.leak, dtype=np.float64), len(transmission)).copy()
    leaked = floor[:, None, None] * camera * quadrature
    leaked_laser = leaked @ line
    leaked_laser[excitation_band] = 0.0  # the laser passes this filter; what leaks beside it is lamp and emission
    return EmissionWeights(
        wavelength_nm=wavelength,
        emission=(passed * above * scale[..., None]).reshape(bands.size, -1),
        reflected_laser=reflected_laser.ravel(),
        leaked_emission=(leaked * above * scale[..., None]).reshape(bands.size, -1),
        leaked_laser=(leaked_laser * scale).ravel(),
        leaked_white=((leaked @ (white * light)) / white_signal).ravel(),
        level_share=level_share.ravel(),
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
        raise CurveError("wavelength_nm: must be two or more wavelengths in nm, in increasing order")
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
            f"white signal of band {band}, channel {channel} is zero, because lamp, white reference, filter and "
            "camera curves have no common wavelength; check their ranges in nm"
        )
    return white_signal


def _visible_laser(laser_white: FloatArray, white_signal: FloatArray, excitation_band: int, share: FloatArray) -> float:
    """Return V, the laser on white as the excitation filter's band sees it."""
    if not 0 <= excitation_band < len(white_signal):
        raise FitError(
            f"excitation_band: {excitation_band} does not exist; valid bands are 0 to {len(white_signal) - 1}"
        )
    visible = float(share @ (laser_white[excitation_band] / white_signal[excitation_band]))
    if visible <= 0:
        raise FitError(f"excitation band {excitation_band} passes no laser light; check filter and laser curves")
    return visible


def _curve(name: str, values: ArrayLike, dimensions: int, length: int | None) -> FloatArray:
    """Return checked values: right shape, finite, not negative."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != dimensions or (length is not None and array.shape[-1] != length):
        wanted = f"{dimensions} dimension(s)" + ("" if length is None else f" and {length} wavelengths")
        raise CurveError(f"{name}: has shape {array.shape}, but must have {wanted}")
    if not (np.isfinite(array) & (array >= 0)).all():
        raise CurveError(
            f"{name}: {int((~(array >= 0)).sum())} values are negative or not finite, but all must be "
            "finite and 0 or more"
        )
    return array


def _channel_shares(channel_weights: ArrayLike, channels: int) -> FloatArray:
    """Return the checked weights of the channels."""
    share = _curve("channel_weights", channel_weights, 1, channels)
    if abs(share.sum() - 1) > 1e-9:  # rounding of decimals written by hand is far below
        raise FitError(f"channel_weights: the weights sum to {share.sum():g}, but must sum to 1")
    return share


def trapezoidal_weights(wavelength_nm: FloatArray) -> FloatArray:
    """Return the weights of the trapezoidal rule on a grid, nm."""
    step = np.diff(wavelength_nm, prepend=wavelength_nm[0], append=wavelength_nm[-1])
    return np.asarray((step[:-1] + step[1:]) / 2)


def _unit_area(name: str, curve: FloatArray, quadrature: FloatArray) -> FloatArray:
    """Return the curve divided by its area."""
    area = float(curve @ quadrature)
    if area <= 0:
        raise CurveError(f"{name}: the area under the curve is zero on the grid; check the wavelength range in nm")
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
    every 10 nm outside. For smooth emission 30 nm wide or wider the error is below 1e-3 of the band value; a strongly
    skewed curve has a kink, and its light from outside the pass band is then right to a few per cent only.

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


def rig_emission_weights(optics: Optics, channel_weights: ArrayLike) -> EmissionWeights:
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


def extrapolated_shares(optics: Optics) -> Floats:
    """Return the share of each band's weight over which the response or the lamp was not measured, (B, 3)."""
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


def band_tolerances(optics: Optics, channel_weights: ArrayLike) -> BandTolerances:
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
    nominal = rig_emission_weights(optics, channel_weights)
    excitation = optics.excitation_filter
    emission, laser, level = [], [], []
    for field in ("center_nm", "fwhm_nm"):
        only = rig_emission_weights(_moved(optics, field, {excitation}), channel_weights)
        others = ~nominal.is_excitation
        ratio = float(only.emission[others].sum() / nominal.emission[others].sum())  # V_nominal / V_moved
        moved = rig_emission_weights(_moved(optics, field, {f.name for f in optics.filters}), channel_weights)
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
