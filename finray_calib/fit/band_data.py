"""Normalised band values of one region, ready to fit."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.nuisances import Reference, calibration_columns, tolerance_columns
from finray_calib.spectra.band_quadrature import BandQuadrature, band_quadrature
from finray_calib.spectra.band_tolerances import BandTolerances
from finray_calib.spectra.band_weights import EmissionWeights, read_only

FloatArray = NDArray[np.float64]

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
    quadrature
        Few-node rule of the weights.

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
    quadrature: BandQuadrature = field(init=False)

    def __post_init__(self) -> None:
        rows = self.weights.band_index.size
        if self.y.size != rows or self.usable.shape != self.y.shape or self.covariance.shape != (rows, rows):
            raise FitError(
                f"band data: y {self.y.shape}, usable {self.usable.shape} and covariance {self.covariance.shape} do "
                f"not fit the rig's {rows} band values; y and usable must be bands x channels"
            )
        bands = int(self.usable.any(axis=1).sum())
        if bands < LEAST_BANDS:
            raise FitError(
                f"band data: only {bands} bands have a usable channel, at least {LEAST_BANDS} are needed; "
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
                "band data: the covariance is not positive definite over the usable entries; give every band "
                "value a variance of its own (read noise at least)"
            ) from None
        for name in ("y", "covariance", "usable"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        object.__setattr__(self, "quadrature", band_quadrature(self.weights))

    def without_band(self, band: int) -> "BandData":
        """Return the data with one band left out.

        Raises
        ------
        FitError
            When fewer than four bands remain.
        """
        usable = self.usable.copy()
        usable[band] = False
        return replace(self, usable=usable)

    @property
    def kept(self) -> NDArray[np.int64]:
        """Rows of the usable entries in band-major order."""
        return np.flatnonzero(self.usable.ravel())

    @property
    def leak_sd(self) -> FloatArray:
        """Standard deviation of ln(leak) of each row's filter around the common one, (N,)."""
        return np.zeros(self.y.size) if self.tolerances is None else self.tolerances.blocking_sd

    @property
    def leak_mean(self) -> FloatArray:
        """Mean over median of each row's own leak, (N,): a log-normal's mean lies above its median."""
        return np.asarray(np.exp(self.leak_sd**2 / 2))

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
