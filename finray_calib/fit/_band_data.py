r"""Normalised band values of one region, ready to fit, and the directions in which the rig's imperfections move them.

.. math:: y = \mu(\theta) + U k + e, \quad k \sim N(0, I), \quad e \sim N(0, S)

One column of U per band for each of: its calibration, its blocking, its filter's centre and its filter's width. The
imperfections k are integrated out analytically, :math:`y \sim N(\mu, S + U U^T)`.

U is fixed before sampling: the calibration columns from the measured values, the others at a reference fit. Were U to
move with the model, a model that cannot follow the data could buy likelihood by predicting too much, because relative
errors of a large prediction forgive everything; an orange ink came out at four times its true yield. For errors of 1 %
that are common to the three channels of a band the bias of taking them at the data is 3e-4.

White reference and lamp move all bands together, a lamp off by 50 K those in the red by 6 %. At a fixed curve they
would pull yields down, so the family's posterior takes both as shares of what each theta predicts:

.. math:: y \sim N\bigl(\mu, S + U U^T + \textstyle\sum_k (g_k \mu)(g_k \mu)^T\bigr)

with :math:`g_k` the relative change of each value for one standard uncertainty; two directions forgive little.

A filter's own leak is log-normal, and where it decides what the fit believes, no fixed column can stand for it: such
leaks are sampled beside the shape, and their columns are empty.

.. math:: m_b = e^{\ln m + \sigma_b z_b}, \quad z_b \sim N(0, 1)

A measured region also has errors that its photon noise does not know: calibration, channel response, stray light.
"""

from copy import copy
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import EXTRAPOLATION_UNCERTAINTY_REL, BandSignals, FitError, read_only
from finray_calib.spectra import (
    BandQuadrature,
    BandTolerances,
    EmissionWeights,
    band_quadrature,
    band_tolerances,
    extrapolated_shares,
    lamp_response,
    rig_emission_weights,
)

FloatArray = NDArray[np.float64]

DECISIVE_RATIO = 0.5
"""A leak that moves the bands by more than this, in standard deviations of all else, is sampled."""

MOST_SAMPLED_LEAKS = 4

_BLOCKING, _CURVATURE = 1, 4  # of the blocks of U: calibration, blocking, centre, width, curvature of the blocking


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the filters' tolerances act.

    Attributes
    ----------
    curve
        (L,) emission on the weights' grid, nm^-1.
    reflected_laser
        Reflectance at the laser line.
    leak
        (N,) multiplier of each row's nominal leak.
    sampled_leaks
        Bands whose own leak is a parameter.
    """

    curve: FloatArray
    reflected_laser: float
    leak: FloatArray
    sampled_leaks: tuple[int, ...] = ()


def band_values(
    curves: FloatArray, reflected_laser: FloatArray, weights: EmissionWeights, blocking: FloatArray | float = 1.0
) -> FloatArray:
    """Return the band values (n, N) of emission curves on the full wavelength grid.

    The value is that of :class:`EmissionWeights` with m = `blocking` times the nominal leak.

    Parameters
    ----------
    curves
        (n, L) emission on the weights' grid, nm^-1.
    reflected_laser
        (n,) reflectance at the laser line.
    weights
        Weights of the rig.
    blocking
        Multiplier of the nominal leak: one, (n,), or (n, N) of each row.
    """
    reflectance = np.asarray(reflected_laser)[:, None]
    more = np.asarray(blocking, dtype=np.float64) - 1
    more = more if more.ndim == 2 else np.broadcast_to(more, len(curves))[:, None]
    leaked = curves @ weights.leaked_emission.T + reflectance * weights.leaked_laser
    mu = curves @ weights.emission.T + reflectance * weights.reflected_laser + more * leaked
    return np.asarray(mu / weights.divisor(more))


def calibration_columns(y: FloatArray, weights: EmissionWeights, band_calibration_rel: float) -> FloatArray:
    """Return one column per band, (N, B): a relative error common to the channels of a band.

    Parameters
    ----------
    y
        (N,) measured band values.
    weights
        Weights of the rig.
    band_calibration_rel
        Relative standard uncertainty of each band's calibration.
    """
    return _per_band(band_calibration_rel * y, weights)


def tolerance_columns(reference: Reference, weights: EmissionWeights, tolerances: BandTolerances) -> FloatArray:
    """Return the columns of the filters' blocking, centre, width and curvature of the blocking, (N, 4 B).

    Empty where a leak is sampled.
    """
    curve, reflected_laser = reference.curve, reference.reflected_laser
    mu = band_values(curve[None], np.array([reflected_laser]), weights, reference.leak[None])[0]
    slopes = leak_slopes(curve, reflected_laser, mu, weights, reference.leak)
    slopes[:, list(reference.sampled_leaks)] = 0.0
    sd = band_leak_sd(tolerances.blocking_sd, weights)
    columns = [sd * slopes]
    excitation = int(weights.band_index[np.argmax(weights.is_excitation)])
    for kind in range(2):
        own = tolerances.emission_shift[kind] @ curve + reflected_laser * tolerances.laser_shift[kind]
        moved = _per_band(own, weights)
        moved[:, excitation] -= tolerances.level_shift[kind] * mu
        columns.append(moved)
    # the leak is log-normal: what is left of it beside its mean and its linear part has this standard deviation
    columns.append(sd**2 / np.sqrt(2) * slopes)
    return np.concatenate(columns, axis=1)


def leak_slopes(
    curve: FloatArray, reflected_laser: float, mu: FloatArray, weights: EmissionWeights, leak: FloatArray
) -> FloatArray:
    """Return d mu / d ln(leak) of each filter, (N, B): the excitation filter's moves all values, by the laser's level.

    Parameters
    ----------
    curve, reflected_laser
        Emission (L,), nm^-1, and reflectance at the laser.
    mu
        (N,) their band values.
    weights
        Weights of the rig.
    leak
        (N,) multiplier of each row's nominal leak.
    """
    leaked = weights.leaked_emission @ curve + reflected_laser * weights.leaked_laser
    own = _per_band(leak * leaked / weights.divisor(leak - 1), weights)
    return np.asarray(own - mu[:, None] * weights.divisor_slopes(leak))


def band_leak_sd(leak_sd: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return the standard deviation of ln(leak) of each filter, (B,), from that of each row's."""
    return leak_sd[np.searchsorted(weights.band_index, np.arange(weights.bands))]


def decisive_leaks(imperfections: FloatArray, rest: FloatArray, bands: int) -> tuple[int, ...]:
    r"""Return the bands whose own leak must be sampled, in order: at most four, those of the largest ratio.

    .. math:: r_b = \sqrt{c_b^T C_b^{-1} c_b} > 0.5

    with c_b the band's blocking column and C_b the covariance of all else. A smaller ratio leaves the leak as it was
    believed to be, and its linear column is good enough.

    Parameters
    ----------
    imperfections
        (K, 5 B) all columns of U, none sampled.
    rest
        (K, K) covariance of the measurement and the discrepancy.
    bands
        Number of bands B.
    """
    ratios = {}
    for band in range(bands):
        own = imperfections[:, blocking_column(band, bands)]
        if own.any():
            others = np.delete(imperfections, [blocking_column(band, bands), _CURVATURE * bands + band], axis=1)
            ratios[band] = float(np.sqrt(own @ np.linalg.solve(rest + others @ others.T, own)))
    decisive = [band for band, ratio in ratios.items() if ratio > DECISIVE_RATIO]
    return tuple(sorted(sorted(decisive, key=lambda band: -ratios[band])[:MOST_SAMPLED_LEAKS]))


def blocking_column(band: int, bands: int) -> int:
    """Return the column of U that holds a band's blocking."""
    return _BLOCKING * bands + band


def _per_band(values: FloatArray, weights: EmissionWeights) -> FloatArray:
    """Return (N,) values as one column per band, (N, B)."""
    return np.asarray(values[:, None] * (weights.band_index[:, None] == np.arange(weights.bands)))


LEAST_BANDS = 4
"""Fewest bands with a usable channel: a mode, a width, a skewness and a height need as many."""

_ASYMMETRY_REL = 1e-6  # of the two standard deviations: far above rounding, far below what a fit could feel


@dataclass(frozen=True, slots=True)
class BandData:
    """Normalised band values of one region or pixel, ready to fit.

    Attributes
    ----------
    y
        (B, C) normalised band values, dimensionless; may be NaN where not usable.
    covariance
        (B C, B C) measurement covariance of y in band-major order, without the calibration error.
    usable
        (B, C) False for saturated or lost entries.
    weights
        Weights of the rig with B C rows.
    band_calibration_rel
        Relative standard uncertainty of each band's calibration, common to its channels.
    tolerances
        Tolerances of the filters' centre, width and blocking; perfectly known filters when None.
    lamp_response_rel
        (B C,) relative change of each value for one standard uncertainty of the lamp; a perfectly known one when None.
    tile_uncertainty_rel
        Relative standard uncertainty of the white reference, which `covariance` holds as common to all values.
    quadrature
        Few-node rule of the weights.
    level
        (B C,) values of which the errors of lamp and white reference are shares: the measured ones, until :meth:`at`.

    Raises
    ------
    FitError
        When shapes disagree, usable values are not finite, fewer than four bands are usable, or the
        covariance is not symmetric positive definite.
    """

    y: FloatArray
    covariance: FloatArray
    usable: NDArray[np.bool_]
    weights: EmissionWeights
    band_calibration_rel: float = 0.01
    tolerances: BandTolerances | None = None
    lamp_response_rel: FloatArray | None = None
    tile_uncertainty_rel: float = 0.0
    quadrature: BandQuadrature = field(init=False)
    level: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        rows = self.weights.band_index.size
        if self.y.size != rows or self.usable.shape != self.y.shape or self.covariance.shape != (rows, rows):
            raise FitError(
                f"band data: y has shape {self.y.shape}, usable {self.usable.shape} and covariance "
                f"{self.covariance.shape}, which does not fit the {rows} band values of the rig; y and usable must "
                "have shape (bands, channels)"
            )
        bands = int(self.usable.any(axis=1).sum())
        if bands < LEAST_BANDS:
            raise FitError(
                f"band data: only {bands} bands have a usable channel, but at least {LEAST_BANDS} are needed; "
                "repeat the saturated or lost bands"
            )
        if not np.isfinite(self.y[self.usable]).all():
            raise FitError("band data: usable band values are NaN or infinite; mark them as not usable")
        if not 0 <= self.band_calibration_rel < 1:
            raise FitError(
                f"band data: band_calibration_rel {self.band_calibration_rel:g} must be 0 or more and below 1"
            )
        kept = self.usable.ravel()
        measured = self.covariance[np.ix_(kept, kept)]
        if not (np.isfinite(measured).all() and _is_symmetric(measured)):
            raise FitError("band data: the covariance must be finite and symmetric over the usable entries")
        try:
            np.linalg.cholesky(measured)
        except np.linalg.LinAlgError:
            raise FitError(
                "band data: the covariance is not positive definite over the usable entries; give every band value "
                "its own variance (at least the read noise)"
            ) from None
        for name in ("y", "covariance", "usable"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        object.__setattr__(self, "quadrature", band_quadrature(self.weights))
        object.__setattr__(self, "level", read_only(np.nan_to_num(self.y.ravel())))

    @property
    def kept(self) -> NDArray[np.int64]:
        """Rows of the usable entries in band-major order."""
        return np.flatnonzero(self.usable.ravel())

    @property
    def leak_sd(self) -> FloatArray:
        """Standard deviation of ln(leak) of each row's filter around the common one, (N,)."""
        return np.zeros(self.y.size) if self.tolerances is None else self.tolerances.blocking_sd

    @property
    def common_rel(self) -> FloatArray:
        """Relative change of each value for one standard uncertainty of white reference and lamp, (2, N).

        0 of what is perfectly known, and of a white reference whose part the covariance does not hold.
        """
        tile = self.tile_uncertainty_rel if self._holds_tile(self.kept) else 0.0
        lamp = 0.0 if self.lamp_response_rel is None else self.lamp_response_rel
        return np.stack([np.full(self.y.size, tile), np.broadcast_to(lamp, self.y.size)])

    @property
    def leak_mean(self) -> FloatArray:
        """Mean over median of each row's own leak, (N,): a log-normal's mean lies above its median."""
        return np.asarray(np.exp(self.leak_sd**2 / 2))

    def at(self, level: FloatArray) -> "BandData":
        """Return the data with errors that are common to all values as shares of `level` (N,), which a fit predicts.

        For the learned prior: a family's fit takes them at each of its curves.

        As shares of the measured values, whose own errors they then follow, they pull the fitted level down (Peelle's
        puzzle): by 4 % for a white reference known to 10 %, a lamp to 50 K, filters to 1 % and values to 0.5 %.

        R. W. Peelle, 1987; G. D'Agostini, Nucl. Instrum. Methods A 346 (1994) 306.
        """
        rows, kept = np.ix_(self.kept, self.kept), self.level[self.kept]
        covariance = self.covariance.copy()
        if self._holds_tile(self.kept):
            change = np.outer(level[self.kept], level[self.kept]) - np.outer(kept, kept)
            covariance[rows] += self.tile_uncertainty_rel**2 * change
        found = copy(self)
        object.__setattr__(found, "covariance", read_only(covariance))
        object.__setattr__(found, "level", read_only(level))
        return found

    def _holds_tile(self, rows: NDArray[np.int64]) -> bool:
        """Whether the covariance of some usable rows stays positive definite without the white reference's part."""
        level = self.level[rows]
        share = level @ np.linalg.solve(self.covariance[np.ix_(rows, rows)], level)
        return self.tile_uncertainty_rel**2 * float(share) < 1

    def covariance_without_tile(self, rows: NDArray[np.int64]) -> FloatArray:
        r"""Return the covariance (K, K) of some usable rows without the white reference's part, u^2 y y^T.

        A wrong white reference multiplies all values alike. A covariance that does not hold that part, because it
        would no longer be positive definite without it, is returned as it is.
        """
        covariance, level = self.covariance[np.ix_(rows, rows)], self.level[rows]
        if not self._holds_tile(rows):
            return covariance
        return covariance - self.tile_uncertainty_rel**2 * np.outer(level, level)

    def imperfections(self, reference: Reference | None = None) -> FloatArray:
        """Return the imperfection columns U of the usable rows, (K, M).

        Parameters
        ----------
        reference
            The emission at which the filters' tolerances act; calibration errors alone when None.
        """
        y = np.nan_to_num(self.y.ravel())
        columns = [calibration_columns(y, self.weights, self.band_calibration_rel)]
        if reference is not None and self.tolerances is not None:
            columns.append(tolerance_columns(reference, self.weights, self.tolerances))
        return np.concatenate(columns, axis=1)[self.kept]


def _is_symmetric(covariance: FloatArray) -> bool:
    """Whether C_ij and C_ji agree, relative to sqrt(C_ii C_jj)."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return bool((np.abs(covariance - covariance.T) <= _ASYMMETRY_REL * np.outer(sd, sd)).all())


# Where more of a channel's white signal is leak, the channel measures the filter's blocking and not its band: a floor
# that is nowhere as flat as its optical density says.
LARGEST_LEAK_OF_WHITE: Final = 0.1


def band_data(bands: BandSignals) -> BandData:
    """Return the data of the likelihood for the band signals of a region.

    Raises
    ------
    FitError
        Fewer than four usable bands, or values that are not numbers.
    """
    weights = rig_emission_weights(bands.optics, bands.channel_weights)
    in_band = weights.leaked_white.reshape(-1, 3) <= LARGEST_LEAK_OF_WHITE
    return BandData(
        y=bands.fluorescence,
        covariance=bands.fluorescence_covariance + _channel_covariance(bands),
        usable=bands.usable() & in_band,
        weights=weights,
        band_calibration_rel=bands.optics.band_uncertainty.calibration_rel,
        tolerances=band_tolerances(bands.optics, bands.channel_weights),
        lamp_response_rel=lamp_response(bands.optics, bands.channel_weights),
        tile_uncertainty_rel=bands.optics.white_reference.uncertainty_rel,
    )


def _channel_covariance(bands: BandSignals) -> FloatArray:
    """Return the variances of channel response, held ends of curves, and stray light.

    Stray light is relative to the brightest emission band. Where a curve holds its end value, that share of the
    band's weight carries a relative uncertainty of 0.5.
    """
    y, usable = bands.fluorescence, bands.usable()
    emission = usable & ~bands.at_excitation()[:, None]
    brightest = float(np.abs(y[emission]).max()) if emission.any() else 0.0
    stated = bands.optics.band_uncertainty
    relative = np.hypot(stated.response_rel, EXTRAPOLATION_UNCERTAINTY_REL * extrapolated_shares(bands.optics))
    return np.diag(((relative * y) ** 2 + (stated.stray_light_rel * brightest) ** 2).ravel())
