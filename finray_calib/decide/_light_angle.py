"""Decide which light angle is best, with what probability, and what a wrong choice would cost.

What choosing one angle risks follows from joint draws of the objective's curve, and the verdict from that. The same
draws tell where one more observation helps most (the knowledge gradient, exact for normal beliefs): the next render
and the next physical capture.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from data_schemas import DecideError, look_like_radians, narrow_sweep_text
from finray_calib.decide._capture_errors import NO_CAPTURES, UNSTATED_ANGLE_SD_DEG, CaptureErrors
from finray_calib.decide._gaussian_process import (
    CurvePosterior,
    Discrepancy,
    Matern52,
    condition,
    discrepancy_posterior,
    draw_normal,
    fit_kernel,
)

Floats = NDArray[np.float64]
Verdict = Literal["decided", "tie", "undecided", "model-limited"]

#: Two angles closer than this count as the same choice.
NEARBY_DEG = 5.0
#: Probability with which regret stays below its bound, and with which an equivalent angle is within tolerance.
CONFIDENCE = 0.95
#: A set of equivalent angles wider than this leaves the choice to the mechanical designer.
WIDE_SET_DEG = 10.0


@dataclass(frozen=True, slots=True)
class AngleRisk:
    """Hold what choosing one angle risks.

    Attributes
    ----------
    p_within_5deg : float
        Probability that the true optimum lies within 5 deg of the chosen angle.
    expected_regret_rel, regret_95_rel : float
        Loss of the objective against its true maximum, relative to that maximum: its mean, and the bound it
        stays below with 95 % probability.
    equivalent_deg : tuple of (float, float)
        Intervals of angles whose loss is within the tolerance with 95 % probability; may be empty.
    p_within_tolerance : float
        Probability that the loss of the chosen angle is within the tolerance. Where the curve is flat this is the
        probability that counts: the optimum may lie anywhere on a plateau.
    """

    p_within_5deg: float
    expected_regret_rel: float
    regret_95_rel: float
    equivalent_deg: tuple[tuple[float, float], ...]
    p_within_tolerance: float


def angle_risk(
    curves: Floats, grid_deg: Floats, best: int, tolerance_rel: float, allowed: NDArray[np.bool_] | None = None
) -> AngleRisk:
    """Return the risk of choosing one grid angle.

    For each drawn curve f the regret is (max f - f(best)) / max f. Valid for curves with a positive maximum.

    Parameters
    ----------
    curves : ndarray, shape (S, G)
        Joint draws of the curve.
    grid_deg : ndarray, shape (G,)
    best : int
        Index of the chosen angle.
    tolerance_rel : float
        Relative loss that does not matter.
    allowed : ndarray of bool, shape (G,), optional
        Angles that may be chosen at all; the optimum and the equivalent angles are among them.

    Returns
    -------
    AngleRisk
    """
    open_ = np.ones(grid_deg.size, dtype=np.bool_) if allowed is None else allowed
    choices = curves[:, open_]
    optimum_deg = grid_deg[open_][choices.argmax(axis=1)]
    highest = choices.max(axis=1)
    regret = 1 - curves[:, best] / highest
    equivalent = (curves >= (1 - tolerance_rel) * highest[:, None]).mean(axis=0) >= CONFIDENCE
    return AngleRisk(
        # The grid step need not be a binary fraction, so the limit gets a rounding margin.
        p_within_5deg=float((np.abs(optimum_deg - grid_deg[best]) <= NEARBY_DEG + 1e-9).mean()),
        expected_regret_rel=float(regret.mean()),
        regret_95_rel=float(np.quantile(regret, CONFIDENCE)),
        equivalent_deg=_intervals(grid_deg, equivalent & open_),
        p_within_tolerance=float((regret <= tolerance_rel).mean()),
    )


def verdict_of(simulation_only: AngleRisk, risk: AngleRisk, tolerance_rel: float, validated: bool) -> Verdict:
    """Return the first verdict that applies.

    "undecided": regret from render noise alone exceeds the tolerance. "model-limited": regret with the
    sim-to-real error does, or no capture has shown that error. "tie": the loss is small over an interval wider than
    10 deg. Else "decided".

    Parameters
    ----------
    simulation_only, risk : AngleRisk
        Without and with the sim-to-real error.
    tolerance_rel : float
    validated : bool
        Whether captures tell of the sim-to-real error. A small loss that rests on its prior decides nothing.

    Returns
    -------
    str
    """
    if simulation_only.regret_95_rel > tolerance_rel:
        return "undecided"
    if risk.regret_95_rel > tolerance_rel or not validated:
        return "model-limited"
    widest_deg = max((high - low for low, high in risk.equivalent_deg), default=0.0)
    return "tie" if widest_deg > WIDE_SET_DEG else "decided"


def _intervals(grid_deg: Floats, member: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return first and last angle of each run of True."""
    edges = np.diff(np.concatenate([[0], member.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple((float(grid_deg[a]), float(grid_deg[b])) for a, b in zip(starts, stops, strict=True))


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
    alone = _best_choice(curve.mean, choices)
    simulation_only = angle_risk(curves, curve.grid_deg, alone, tolerance_rel, choices)
    mean, sd = _real_curve(curve, discrepancy)
    best = _best_choice(mean, choices)
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


def _best_choice(mean: Floats, choices: NDArray[np.bool_]) -> int:
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


def expected_maximum_gain(intercepts: Floats, slopes: Floats) -> float:
    """Return E[max_i(a_i + b_i Z)] - max_i a_i for a standard normal Z.

    The maximum of the lines is piecewise linear and convex. With its lines in order of slope and the points c_i where
    line i gives way to line i + 1, the gain is sum_i (b_{i+1} - b_i) f(-|c_i|), f(z) = phi(z) + z Phi(z). Exact.

    Parameters
    ----------
    intercepts, slopes : ndarray, shape (G,)

    Returns
    -------
    float
        In the unit of the intercepts; never negative.

    References
    ----------
    P. Frazier, W. Powell, S. Dayanik, The knowledge-gradient policy for correlated normal beliefs, INFORMS J. Comput.
    21 (2009), 599-613, algorithm 1.
    """
    order = np.lexsort((intercepts, slopes))
    lines: list[tuple[float, float]] = []
    gives_way: list[float] = []
    for a, b in zip(intercepts[order].tolist(), slopes[order].tolist(), strict=True):
        while lines:
            last_a, last_b = lines[-1]
            if b > last_b:
                crossing = (last_a - a) / (b - last_b)
                if not gives_way or crossing > gives_way[-1]:
                    gives_way.append(crossing)
                    break
            # the last line is nowhere above both of its neighbours
            lines.pop()
            if gives_way:
                gives_way.pop()
        lines.append((a, b))
    steps = np.diff([b for _, b in lines])
    distance = -np.abs(gives_way)
    return float((steps * (norm.pdf(distance) + distance * norm.cdf(distance))).sum())


def knowledge_gradient(mean: Floats, response: Floats, observed_variance: Floats, noise_variance: Floats) -> Floats:
    """Return how much the best expected value is expected to rise when each candidate is observed once.

    Observing candidate j moves the expected values by response[:, j] / sqrt(v_j + n_j) times a standard normal.

    Parameters
    ----------
    mean : ndarray, shape (G,)
        Expected values among which the best is chosen.
    response : ndarray, shape (G, C)
        Covariance of each value with the quantity that candidate j observes.
    observed_variance, noise_variance : ndarray, shape (C,)
        Variance of that quantity before the observation, and of the observation itself.

    Returns
    -------
    ndarray, shape (C,)
        In the unit of the mean.
    """
    sd = np.sqrt(np.maximum(observed_variance, 0) + noise_variance)
    return np.array([expected_maximum_gain(mean, slopes) for slopes in (response / sd).T])


#: Standard uncertainty of the objective in a capture, where there is none to learn it from.
ASSUMED_CAPTURE_SD_REL = 0.01
#: A smaller expected rise of the objective is not worth an observation.
LEAST_GAIN_REL = 1e-4


@dataclass(frozen=True, slots=True)
class Proposal:
    """Hold the best angle for one more observation.

    Attributes
    ----------
    angle_deg : float
    gain_rel : float
        Expected rise of the greatest expected objective, relative to it.
    noise_rel : float
        Assumed standard uncertainty of the observation.
    """

    angle_deg: float
    gain_rel: float
    noise_rel: float


def propose_render(decision: AngleDecision) -> Proposal | None:
    """Return the angle to render next, as many repeats as the sweep has; None where it would change nothing.

    Valid for repeats with the same draws as those of the sweep, so that they share its scale.
    """
    simulated = decision.simulated
    curve = simulated.posterior
    noise_rel = simulated.noise_rel / np.sqrt(simulated.repeats)
    noise_variance = np.full(len(curve.grid_deg), noise_rel**2)
    response = np.exp(-decision.discrepancy.shape_mean)[:, None] * curve.covariance
    return _most_helpful(decision, response, np.diag(curve.covariance), noise_variance)


def propose_capture(decision: AngleDecision, captures: CaptureErrors) -> Proposal | None:
    """Return the angle to capture next; None where it would change nothing.

    A capture shows the sim-to-real error at its angle, with the noise of the captures so far (median; 1 % and 2 deg
    without any). That it also tells the amplitude of that error is not counted.
    """
    sd_rel, angle_sd_deg = ASSUMED_CAPTURE_SD_REL, UNSTATED_ANGLE_SD_DEG
    if captures.names:
        sd_rel = float(np.sqrt(np.median(np.diag(captures.covariance))))
        angle_sd_deg = float(np.median(captures.angle_sd_deg))
    noise_variance = sd_rel**2 + (decision.simulated.log_slope_per_deg * angle_sd_deg) ** 2
    discrepancy = decision.discrepancy
    response = -decision.mean_rel[:, None] * discrepancy.shape_response
    return _most_helpful(decision, response, np.diag(discrepancy.covariance), noise_variance)


def _most_helpful(
    decision: AngleDecision, response: Floats, observed_variance: Floats, noise_variance: Floats
) -> Proposal | None:
    """Return the candidate of the grid with the greatest knowledge gradient."""
    choices = decision.choices
    mean = decision.mean_rel[choices]
    gains = knowledge_gradient(mean, response[choices], observed_variance, noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    if gain_rel < LEAST_GAIN_REL:
        return None
    grid_deg = decision.simulated.posterior.grid_deg
    return Proposal(float(grid_deg[best]), gain_rel, float(np.sqrt(noise_variance[best])))
