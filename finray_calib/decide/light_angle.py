"""Decide which light angle is best, with what probability, and what a wrong choice would cost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import DecideError
from data_schemas.simulate import look_like_radians, narrow_sweep_text
from finray_calib.decide.angle_risk import AngleRisk, Verdict, angle_risk, verdict_of
from finray_calib.decide.capture_errors import NO_CAPTURES, CaptureErrors
from finray_calib.decide.discrepancy import Discrepancy, discrepancy_posterior
from finray_calib.decide.gaussian_process import CurvePosterior, Matern52, condition, draw_normal, fit_kernel

Floats = NDArray[np.float64]

_LEAST_ANGLES = 4
_LEAST_REPEATS = 2
#: Where the expected curve is below this share of its maximum, its logarithm is not followed further down.
_LEAST_SHARE = 0.01


@dataclass(frozen=True, slots=True)
class SimulatedCurve:
    """Hold the simulated objective over the angle, relative to its mean over the sweep.

    Attributes
    ----------
    noise_rel : float
        Standard deviation of one value about the curve, after the common scale of each repeat is removed.
    repeats : int
    kernel : Matern52
        Length scale and relative amplitude of the curve.
    posterior : CurvePosterior
        On a grid of 1 deg.
    """

    noise_rel: float
    repeats: int
    kernel: Matern52
    posterior: CurvePosterior

    @property
    def log_slope_per_deg(self) -> Floats:
        """Derivative of the logarithm of the expected curve, shape (G,)."""
        mean = self.posterior.mean
        return np.asarray(np.gradient(np.log(np.maximum(mean, _LEAST_SHARE * mean.max())), self.posterior.grid_deg))


@dataclass(frozen=True, slots=True)
class AngleDecision:
    """Hold the decision on one objective.

    Attributes
    ----------
    best_deg, best_simulation_only_deg : float
        Angle of the greatest expected real curve, and of the greatest expected simulated one.
    at_range_end : bool
        Whether the former is the first or last angle of the sweep, so that the optimum may lie outside.
    verdict : str
        "decided", "tie", "undecided" or "model-limited", see `verdict_of`.
    simulation_only : AngleRisk
        Risk of `best_simulation_only_deg` if the simulation were exact: only the noise of the renders.
    risk : AngleRisk
        Risk of `best_deg` on the real finger, with the sim-to-real error; the verdict rests on it.
    validated : bool
        Whether captures tell of that error; else it has its prior.
    simulated : SimulatedCurve
    discrepancy : Discrepancy
        Sim-to-real error of the curve; its prior without captures.
    choices : ndarray of bool, shape (G,)
        Angles of the grid that may be chosen.
    mean_rel, sd_rel : ndarray, shape (G,)
        Expected real curve on the grid of the simulated one, relative to that one's mean over the sweep, and its
        standard deviation.
    """

    best_deg: float
    best_simulation_only_deg: float
    at_range_end: bool
    verdict: Verdict
    simulation_only: AngleRisk
    risk: AngleRisk
    validated: bool
    simulated: SimulatedCurve
    discrepancy: Discrepancy
    choices: NDArray[np.bool_]
    mean_rel: Floats
    sd_rel: Floats


def decide_angle(
    angles_deg: Floats,
    values: Floats,
    rng: np.random.Generator,
    tolerance_rel: float = 0.02,
    captures: CaptureErrors = NO_CAPTURES,
    allowed: NDArray[np.bool_] | None = None,
    draws: int = 4000,
    narrow_sweep: bool = False,
) -> AngleDecision:
    """Decide on the angle that maximises an objective.

    Each repeat is divided by its own mean over the angles, which removes the scale that all its values share. The
    remaining scatter is pooled, a Gaussian process (Matern-5/2) is fitted to the means, and its joint draws f on a
    grid of 1 deg give the probability that the optimum is near and the relative regret (max f - f(best)) / max f.
    The curve that is decided on is f exp(-t), t the sim-to-real error less its mean over the grid: what captures tell
    of it, and its prior without any (see `discrepancy_posterior`). Its expected value is that of f times exp(-E t): the
    spread of t is left out, because E exp(-t) would favour angles for being far from any capture. See `verdict_of` for
    the rules of the verdict.

    Valid for a smooth objective sampled finely enough to see its peak (10 deg for the light angle), and for
    repeats whose mean is wanted: renders with different seeds, or draws of the paint posterior shared by all
    angles. An error of shape that all repeats share does not average out: captures show it.

    Parameters
    ----------
    angles_deg : ndarray, shape (A,)
        At least 4, increasing.
    values : ndarray, shape (A, R)
        Positive objective; column r uses the same nuisance draw r at every angle. At least 2 columns.
    rng : numpy.random.Generator
    tolerance_rel : float
        Relative loss that does not matter.
    captures : CaptureErrors
        Simulated against captured objective.
    allowed : ndarray of bool, shape (A,), optional
        Angles that meet the constraints; between two angles both must.
    draws : int
        Joint curve draws.
    narrow_sweep : bool
        Whether angles that span less than 4 deg in more than two steps are meant so, and are not radians.

    Returns
    -------
    AngleDecision

    Raises
    ------
    DecideError
        If the sweep has too few angles or repeats, unsorted angles, angles that look like radians, values that are not
        positive numbers, no allowed angle, or the tolerance is out of range.
    """
    angles, table = np.asarray(angles_deg, dtype=np.float64), np.asarray(values, dtype=np.float64)
    _check(angles, table, tolerance_rel)
    if look_like_radians(angles) and not narrow_sweep:
        raise DecideError(narrow_sweep_text(angles))
    simulated = _simulated_curve(angles, table)
    curve = simulated.posterior
    slope = np.interp(captures.angles_deg, curve.grid_deg, simulated.log_slope_per_deg)
    discrepancy = discrepancy_posterior(captures, slope, curve.grid_deg)
    choices = _choices(angles, allowed, curve.grid_deg)
    curves = curve.mean + draw_normal(curve.covariance, draws, rng)
    alone = _best(curve.mean, choices)
    simulation_only = angle_risk(curves, curve.grid_deg, alone, tolerance_rel, choices)
    mean, sd = _real_curve(curve, discrepancy)
    best = _best(mean, choices)
    curves *= np.exp(-discrepancy.shape_draws(draws, rng))
    risk = angle_risk(curves, curve.grid_deg, best, tolerance_rel, choices)
    validated = bool(captures.names)
    at_range_end = best in (0, len(curve.grid_deg) - 1)
    return AngleDecision(
        best_deg=float(curve.grid_deg[best]),
        best_simulation_only_deg=float(curve.grid_deg[alone]),
        at_range_end=at_range_end,
        # an optimum at the end of the sweep may lie outside it: no risk inside the range says anything
        verdict="undecided" if at_range_end else verdict_of(simulation_only, risk, tolerance_rel, validated),
        simulation_only=simulation_only,
        risk=risk,
        validated=validated,
        simulated=simulated,
        discrepancy=discrepancy,
        choices=choices,
        mean_rel=mean,
        sd_rel=sd,
    )


def _simulated_curve(angles_deg: Floats, values: Floats) -> SimulatedCurve:
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
    return SimulatedCurve(
        float(np.sqrt(noise_variance)), repeats, kernel, condition(kernel, angles_deg, means, variances, grid)
    )


def _choices(angles_deg: Floats, allowed: NDArray[np.bool_] | None, grid_deg: Floats) -> NDArray[np.bool_]:
    """Return which angles of the grid may be chosen: between two angles of the sweep both must be allowed."""
    if allowed is None:
        return np.ones(grid_deg.size, dtype=np.bool_)
    if not allowed.any():
        raise DecideError(
            "No angle of the sweep meets the constraints (clipping, room for the panel). Move the panel, or allow a "
            "shorter exposure, and simulate the sweep again."
        )
    share = np.interp(grid_deg, angles_deg, allowed.astype(np.float64))
    return np.asarray(share > 1 - 1e-9)


def _best(mean: Floats, choices: NDArray[np.bool_]) -> int:
    """Return the index of the greatest mean among the choices."""
    return int(np.where(choices, mean, -np.inf).argmax())


def _real_curve(curve: CurvePosterior, discrepancy: Discrepancy) -> tuple[Floats, Floats]:
    """Return expected value and standard deviation (G,) of the simulated curve times exp(-t), t of zero mean."""
    ratio = np.exp(-discrepancy.shape_mean)
    sd = np.hypot(curve.standard_deviation, curve.mean * discrepancy.shape_sd)
    return curve.mean * ratio, np.asarray(sd * ratio)


def _check(
    angles_deg: NDArray[np.float64],
    values: NDArray[np.float64],
    tolerance_rel: float,
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
