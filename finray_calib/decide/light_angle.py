"""Decide which light angle is best, with what probability, and what a wrong choice would cost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import DecideError
from finray_calib.decide.angle_risk import (
    AngleRisk,
    Verdict,
    angle_risk,
    discrepancy_covariance,
    verdict_of,
)
from finray_calib.decide.decision_sentence import decision_sentence
from finray_calib.decide.gaussian_process import CurvePosterior, Matern52, condition, draw_normal, fit_kernel

_LEAST_ANGLES = 4
_LEAST_REPEATS = 2
#: Half-width of a central 95 % interval of a normal distribution, in standard deviations.
_BAND_QUANTILE = 1.959964


@dataclass(frozen=True, slots=True)
class AngleDecision:
    """Hold the decision on one objective.

    Attributes
    ----------
    objective_name : str
    best_deg : float
        Angle of greatest posterior mean.
    at_range_end : bool
        Whether that is the first or last angle of the sweep, so that the optimum may lie outside.
    verdict : str
        "decided", "tie", "undecided" or "model-limited", see `verdict_of`.
    validated : bool
        Whether a sim-to-real error entered.
    simulation_only : AngleRisk
        Risk if the simulation were exact: only the noise of the renders.
    with_discrepancy : AngleRisk or None
        Risk with the sim-to-real error; None if not validated.
    tolerance_rel : float
        Relative loss that does not matter.
    discrepancy_rel : float or None
        Relative sim-to-real error of the objective, one standard deviation.
    noise_rel : float
        Standard deviation of one value about the curve, relative to the mean, after the common scale of each
        repeat is removed.
    kernel : Matern52
        Length scale and relative amplitude of the fitted curve.
    grid_deg, mean, low, high : ndarray, shape (G,)
        Curve with its pointwise 95 % band in the unit of the values, without sim-to-real error.
    sentence : str
        The decision in plain English with its numbers.
    """

    objective_name: str
    best_deg: float
    at_range_end: bool
    verdict: Verdict
    validated: bool
    simulation_only: AngleRisk
    with_discrepancy: AngleRisk | None
    tolerance_rel: float
    discrepancy_rel: float | None
    noise_rel: float
    kernel: Matern52
    grid_deg: NDArray[np.float64]
    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    sentence: str


def decide_angle(
    angles_deg: NDArray[np.float64],
    values: NDArray[np.float64],
    objective_name: str,
    rng: np.random.Generator,
    tolerance_rel: float = 0.02,
    discrepancy_rel: float | None = None,
    draws: int = 4000,
) -> AngleDecision:
    """Decide on the angle that maximises an objective.

    Each repeat is divided by its own mean over the angles, which removes the scale that all its values share.
    The remaining scatter is pooled, a Gaussian process (Matern-5/2) is fitted to the means, and its joint
    draws on a grid of 1 deg give the probability that the optimum is near and the relative regret
    (max f - f(best)) / max f. A sim-to-real error adds to each draw the curve times a Gaussian process of that
    amplitude (Matern-5/2, length 35 deg) from which the mean over the grid is removed, because a common scale
    cannot change the ranking.

    See `verdict_of` for the rules of the verdict.

    Valid for a smooth objective sampled finely enough to see its peak (10 deg for the light angle), and for
    repeats whose mean is wanted: renders with different seeds, or draws of the paint posterior shared by all
    angles. An error of shape that all repeats share does not average out and belongs in `discrepancy_rel`.

    Parameters
    ----------
    angles_deg : ndarray, shape (A,)
        At least 4, increasing.
    values : ndarray, shape (A, R)
        Positive objective; column r uses the same nuisance draw r at every angle. At least 2 columns.
    objective_name : str
    rng : numpy.random.Generator
    tolerance_rel : float
        Relative loss that does not matter.
    discrepancy_rel : float, optional
        Relative sim-to-real error of the objective, one standard deviation, from a comparison with captures.
    draws : int
        Joint curve draws.

    Returns
    -------
    AngleDecision

    Raises
    ------
    DecideError
        If the sweep has too few angles or repeats, unsorted angles, values that are not positive numbers, or a
        tolerance or sim-to-real error is out of range.
    """
    angles, table = np.asarray(angles_deg, dtype=np.float64), np.asarray(values, dtype=np.float64)
    _check(angles, table, tolerance_rel, discrepancy_rel)
    fit = _fitted_curve(angles, table)
    posterior, best = fit.posterior, fit.best
    curves = posterior.mean + draw_normal(posterior.covariance, draws, rng)
    simulation_only = angle_risk(curves, posterior.grid_deg, best, tolerance_rel)
    with_discrepancy = None
    if discrepancy_rel is not None:
        curves = curves + draw_normal(discrepancy_covariance(posterior, discrepancy_rel), draws, rng)
        with_discrepancy = angle_risk(curves, posterior.grid_deg, best, tolerance_rel)
    return _decision(
        objective_name, float(table.mean()), fit, simulation_only, with_discrepancy, tolerance_rel, discrepancy_rel
    )


@dataclass(frozen=True, slots=True)
class _FittedCurve:
    """Hold the fitted curve, relative to its mean, and the index of its best angle."""

    noise_rel: float
    kernel: Matern52
    posterior: CurvePosterior
    best: int


def _fitted_curve(angles_deg: NDArray[np.float64], values: NDArray[np.float64]) -> _FittedCurve:
    """Return the curve relative to its mean, on a grid of 1 deg."""
    relative = values / values.mean(axis=0)
    means = relative.mean(axis=1)
    repeats = values.shape[1]
    # One degree of freedom per repeat went into its scale, one per angle into its mean.
    freedom = (len(angles_deg) - 1) * (repeats - 1)
    noise_variance = float(((relative - means[:, None]) ** 2).sum()) / freedom
    variances = np.full(len(angles_deg), noise_variance / repeats)
    kernel = fit_kernel(angles_deg, means, variances)
    steps = int(np.ceil(angles_deg[-1] - angles_deg[0]))
    grid = np.linspace(angles_deg[0], angles_deg[-1], steps + 1)
    posterior = condition(kernel, angles_deg, means, variances, grid)
    return _FittedCurve(float(np.sqrt(noise_variance)), kernel, posterior, int(posterior.mean.argmax()))


def _decision(
    objective_name: str,
    scale: float,
    fit: _FittedCurve,
    simulation_only: AngleRisk,
    with_discrepancy: AngleRisk | None,
    tolerance_rel: float,
    discrepancy_rel: float | None,
) -> AngleDecision:
    """Return the decision with its verdict and sentence, and the curve in the unit of the values."""
    grid_deg, mean = fit.posterior.grid_deg, fit.posterior.mean
    half_band = _BAND_QUANTILE * fit.posterior.standard_deviation
    best_deg = float(grid_deg[fit.best])
    at_range_end = fit.best in (0, len(grid_deg) - 1)
    # an optimum at the end of the sweep may lie outside it: no risk inside the range says anything
    verdict: Verdict = "undecided" if at_range_end else verdict_of(simulation_only, with_discrepancy, tolerance_rel)
    risk = with_discrepancy or simulation_only
    return AngleDecision(
        objective_name=objective_name,
        best_deg=best_deg,
        at_range_end=at_range_end,
        verdict=verdict,
        validated=with_discrepancy is not None,
        simulation_only=simulation_only,
        with_discrepancy=with_discrepancy,
        tolerance_rel=tolerance_rel,
        discrepancy_rel=discrepancy_rel,
        noise_rel=fit.noise_rel,
        kernel=fit.kernel,
        grid_deg=grid_deg,
        mean=scale * mean,
        low=scale * (mean - half_band),
        high=scale * (mean + half_band),
        sentence=decision_sentence(best_deg, risk, verdict, at_range_end, tolerance_rel, discrepancy_rel),
    )


def _check(
    angles_deg: NDArray[np.float64],
    values: NDArray[np.float64],
    tolerance_rel: float,
    discrepancy_rel: float | None,
) -> None:
    """Refuse a sweep that does not allow a decision."""
    if angles_deg.ndim != 1 or len(angles_deg) < _LEAST_ANGLES:
        raise DecideError(
            f"The sweep has {angles_deg.size} angles; at least {_LEAST_ANGLES} are needed to see a peak. Render more "
            "angles."
        )
    if not (np.diff(angles_deg) > 0).all():
        raise DecideError(
            f"The angles must increase and occur once each, got {angles_deg.tolist()} deg. Sort them and put repeats "
            "of an angle side by side in one row of values."
        )
    if values.ndim != 2 or len(values) != len(angles_deg) or values.shape[1] < _LEAST_REPEATS:
        raise DecideError(
            f"The values have shape {values.shape} for {len(angles_deg)} angles; expected (angles, repeats) with at "
            f"least {_LEAST_REPEATS} repeats, which show the noise. Render again with another seed."
        )
    if not (np.isfinite(values) & (values > 0)).all():
        row = int(np.argwhere(~(np.isfinite(values) & (values > 0)))[0, 0])
        raise DecideError(
            f"The objective at {angles_deg[row]:g} deg is not a positive number: {values[row].tolist()}. Relative "
            "losses need positive values; check that render, or leave the angle out."
        )
    if not 0 < tolerance_rel < 1:
        raise DecideError(f"The tolerance must be a relative loss between 0 and 1, got {tolerance_rel}; 0.02 is 2 %.")
    if discrepancy_rel is not None and not 0 <= discrepancy_rel < 1:
        raise DecideError(
            f"The sim-to-real error must be relative and between 0 and 1, got {discrepancy_rel}. An error as large as "
            "the objective supports no decision; improve the simulation first."
        )
