"""Decide which light angle is best, with what probability, and what a wrong choice would cost.

What choosing one angle risks follows from joint draws of the objective's curves, one for each place that is touched,
and the verdict from that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import DecideError
from finray_calib.decide._capture_errors import NO_CAPTURES, CaptureErrors
from finray_calib.decide._gaussian_process import CurvePrior, observations
from finray_calib.decide._pointed_curves import PointedPosterior, pointed_posterior
from finray_calib.decide._sim_to_real import Discrepancy, ErrorDraws, discrepancy_posterior

Floats = NDArray[np.float64]
Verdict = Literal["decided", "tie", "undecided", "needs captures"]
#: What is best for several places: the least loss on average over them, or the least loss at the worst of them.
Criterion = Literal["average", "worst"]

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


def verdict_of(rendered: AngleRisk, risk: AngleRisk, tolerance_rel: float, validated: bool) -> Verdict:
    """Return the first verdict that applies.

    "undecided": regret from render noise alone exceeds the tolerance. "needs captures": regret with the
    sim-to-real error does, or no capture has shown all of it. "tie": the loss is small over an interval wider than
    10 deg. Else "decided".

    Parameters
    ----------
    rendered, risk : AngleRisk
        With the noise of the renders alone, and with all that is not known.
    tolerance_rel : float
    validated : bool
        Whether captures see the whole sim-to-real error. A small loss that rests on the prior of it, or of the part
        that image with and without contact share, decides nothing.

    Returns
    -------
    str
    """
    if rendered.regret_95_rel > tolerance_rel:
        return "undecided"
    if risk.regret_95_rel > tolerance_rel or not validated:
        return "needs captures"
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
#: Noise below a millionth of the curve's mean counts as that: rounding, not information.
_LEAST_NOISE_REL = 1e-6
#: Prior of the simulated curve about its unknown mean, relative to it. Lambertian and mirror responses vary over tens
#: of degrees, edges of shadows over some.
_CURVE_PRIOR = CurvePrior(35.0, 0.8, 0.5, 1.0, np.geomspace(0.005, 8.0, 14))


@dataclass(frozen=True, slots=True)
class SweptContact:
    """Hold the objective over the angle at one place that is touched.

    Attributes
    ----------
    angles_deg : ndarray, shape (A,)
        At least 4, increasing.
    values : ndarray, shape (A, R)
        Positive objective; column r uses the same nuisance draw r at every angle. At least 2 columns, whose mean is
        wanted.
    allowed : ndarray of bool, shape (A,), optional
        Angles that meet the constraints; between two angles both must.
    scatter : ndarray, shape (D, A), optional
        Logarithm of the objective by each draw of the paints, but for a common level: the real paint is one draw, so
        that this is not averaged.
    weight_rel : float
        How often the place is touched, relative to others.
    """

    angles_deg: Floats
    values: Floats
    allowed: NDArray[np.bool_] | None = None
    scatter: Floats | None = None
    weight_rel: float = 1.0


@dataclass(frozen=True, slots=True)
class SimulatedCurve:
    """Hold the simulated objective over the angle, relative to its mean over the sweep.

    Attributes
    ----------
    noise_rel : float
        Standard deviation of one value about the curve, after the common scale of each repeat is removed.
    repeats : int
    posterior : PointedPosterior
        On a grid of 1 deg.
    """

    noise_rel: float
    repeats: int
    posterior: PointedPosterior

    @property
    def mean(self) -> Floats:
        """Expected curve, shape (G,)."""
        return np.asarray(self.posterior.mean[0])

    @property
    def log_slope_per_deg(self) -> Floats:
        """Derivative of the logarithm of the expected curve, shape (G,)."""
        return np.asarray(np.gradient(self.ln_mean, self.posterior.grid_deg))

    @property
    def ln_mean(self) -> Floats:
        """Logarithm of the expected curve, shape (G,)."""
        return np.asarray(np.log(np.maximum(self.mean, _LEAST_SHARE * self.mean.max())))


@dataclass(frozen=True, slots=True)
class ContactLosses:
    """Hold what each of C places loses, against the best angle of that place.

    Attributes
    ----------
    weights : ndarray, shape (C,)
        Sum to one.
    relative : ndarray, shape (C, G)
        Expected real curve over its own greatest value among the choices.
    loss_95_rel : ndarray, shape (C,)
        Loss at the chosen angle that is not exceeded with 95 % probability.
    average_deg, worst_deg : float
        Angles that are best on average over the places, and at the worst of them.
    tolerance_deg : tuple of (float, float)
        Angles around the chosen one between which the expected curves lose at most the tolerance more.
    """

    weights: Floats
    relative: Floats
    loss_95_rel: Floats
    average_deg: float
    worst_deg: float
    tolerance_deg: tuple[float, float]


@dataclass(frozen=True, slots=True)
class AngleDecision:
    """Hold the decision on one objective, at one place or over several.

    The value of an angle at one place is the curve over its greatest value there; over several, the weighted mean of
    these or their least, by the criterion. Regret is the loss of that value against the angle where it is greatest.

    Attributes
    ----------
    best_deg, best_simulation_only_deg : float
        Angle of the least expected regret with captures, and of the greatest value of the simulated curves.
    at_range_end : bool
        Whether the former is the first or last angle of the sweep, so that the optimum may lie outside.
    verdict : str
        "decided", "tie", "undecided" or "needs captures", see `verdict_of`.
    simulation_only : AngleRisk
        Risk of `best_simulation_only_deg` if the simulation were exact: noise of the renders, and draws of the paints.
    risk : AngleRisk
        Risk of `best_deg` on the real finger, with the sim-to-real error; the verdict rests on it.
    validated : bool
        Whether captures tell of that error; else it has its prior.
    curves : tuple of SimulatedCurve
        Of each place.
    discrepancy : Discrepancy
        Sim-to-real error of the curves; its prior without captures.
    error_mean : ndarray, shape (C, G)
        Its expected value at each place, with the unknown scale of the first rig; zero without captures.
    choices : ndarray of bool, shape (G,)
        Angles of the grid that may be chosen.
    mean_rel, sd_rel : ndarray, shape (G,)
        At one place, expected real curve relative to the mean of the simulated one over the sweep; over several, value
        of the expected real curves. With its standard deviation.
    simulation_only_mean_rel, simulation_only_sd_rel : ndarray, shape (G,)
        The same if the simulation were exact.
    contacts : ContactLosses
    value_mean : ndarray, shape (G,)
        Expected value of each angle over the joint draws.
    shown_by_capture : ndarray, shape (C, A, G + 1)
        Covariance of the value with what a capture would see of the sim-to-real error at each place and angle of the
        sweep, and last the variance of that.
    """

    best_deg: float
    best_simulation_only_deg: float
    at_range_end: bool
    verdict: Verdict
    simulation_only: AngleRisk
    risk: AngleRisk
    validated: bool
    curves: tuple[SimulatedCurve, ...]
    discrepancy: Discrepancy
    error_mean: Floats
    choices: NDArray[np.bool_]
    mean_rel: Floats
    sd_rel: Floats
    simulation_only_mean_rel: Floats
    simulation_only_sd_rel: Floats
    contacts: ContactLosses
    value_mean: Floats
    shown_by_capture: Floats

    @property
    def simulated(self) -> SimulatedCurve:
        """The simulated curve of the first place."""
        return self.curves[0]

    @property
    def grid_deg(self) -> Floats:
        """Angles of all curves, shape (G,)."""
        return self.simulated.posterior.grid_deg


def decide_angle(
    angles_deg: Floats,
    values: Floats,
    rng: np.random.Generator,
    tolerance_rel: float = 0.02,
    captures: CaptureErrors = NO_CAPTURES,
    allowed: NDArray[np.bool_] | None = None,
    draws: int = 4000,
) -> AngleDecision:
    """Decide on the angle that maximises an objective at one place.

    Parameters
    ----------
    angles_deg, values, allowed
        Of the one place, see `SweptContact`.
    rng, tolerance_rel, captures, draws
        See `decide_contacts`, also for the errors raised.

    Returns
    -------
    AngleDecision
    """
    contact = SweptContact(np.asarray(angles_deg, dtype=np.float64), np.asarray(values, dtype=np.float64), allowed)
    return decide_contacts([contact], rng, tolerance_rel, captures, "average", draws)


def decide_contacts(
    contacts: Sequence[SweptContact],
    rng: np.random.Generator,
    tolerance_rel: float = 0.02,
    captures: CaptureErrors = NO_CAPTURES,
    criterion: Criterion = "average",
    draws: int = 4000,
) -> AngleDecision:
    """Decide on the angle that is best over the places that are touched.

    The real curve is f exp(p - t): f a random curve through the means of the repeats, p one draw of the paints, t the
    sim-to-real error less its mean over the grid (see `discrepancy_posterior`). Valid for an objective sampled finely
    enough to see its peak (10 deg for the light angle), and for repeats whose mean is wanted: renders with different
    seeds. An error of shape that all repeats share does not average out: captures show it.

    Parameters
    ----------
    contacts : sequence of SweptContact
        Swept over the same angles.
    rng : numpy.random.Generator
    tolerance_rel : float
        Relative loss that does not matter.
    captures : CaptureErrors
        Simulated against captured objective.
    criterion : str
        "average" over the places by their weights, or "worst" of them.
    draws : int
        Joint curve draws.

    Returns
    -------
    AngleDecision

    Raises
    ------
    DecideError
        If a sweep has too few angles or repeats, unsorted angles or values that are not positive numbers, no angle is
        allowed at all places, or the tolerance is out of range.
    """
    curves = tuple(_checked_curve(contact, tolerance_rel) for contact in contacts)
    judge = _judge(contacts, curves, criterion, tolerance_rel)
    simulated = _simulated(judge, contacts, curves, draws, rng)
    discrepancy = _discrepancy(curves, captures)
    return _decision(judge, curves, simulated, discrepancy, discrepancy.draws(draws, rng))


def _discrepancy(curves: Sequence[SimulatedCurve], captures: CaptureErrors) -> Discrepancy:
    """Return the sim-to-real error of all places; the slope of a capture's curve tells what its angle's error does."""
    grid_deg = curves[0].posterior.grid_deg
    return discrepancy_posterior(captures, np.array([curve.ln_mean for curve in curves]), grid_deg)


@dataclass(frozen=True, slots=True)
class _Judge:
    """Values angles over places: weights (C,), criterion, angles (G,) that may be chosen, grid and tolerance."""

    weights: Floats
    criterion: Criterion
    choices: NDArray[np.bool_]
    grid_deg: Floats
    tolerance_rel: float

    def relative(self, curves: Floats) -> Floats:
        """Return curves (..., C, G) over their greatest values among the choices."""
        return np.asarray(curves / curves[..., self.choices].max(axis=-1, keepdims=True))

    def value(self, curves: Floats, criterion: Criterion | None = None) -> Floats:
        """Return the value (..., G) of each angle over the places."""
        relative = self.relative(curves)
        if (criterion or self.criterion) == "worst":
            return np.asarray(relative.min(axis=-2))
        return np.asarray(np.einsum("c,...cg->...g", self.weights, relative))

    def best(self, means: Floats, drawn: Floats | None, criterion: Criterion | None = None) -> int:
        """Return the index of the best choice for the expected curves (C, G).

        With draws (S, C, G) of the curves it is the one of the least expected regret over them.
        """
        expected = self.value(means, criterion)
        if drawn is not None:
            value = self.value(drawn, criterion)
            expected = (value / value[:, self.choices].max(axis=1, keepdims=True)).mean(axis=0)
        return int(np.where(self.choices, expected, -np.inf).argmax())

    def is_end(self, best: int) -> bool:
        """Return whether an angle is the first or last one."""
        return best in (0, self.grid_deg.size - 1)

    def risk(self, curves: Floats, best: int) -> AngleRisk:
        """Return the risk of an angle over drawn curves (S, C, G)."""
        return angle_risk(self.value(curves), self.grid_deg, best, self.tolerance_rel, self.choices)

    def losses(self, means: Floats, drawn: Floats, best: int, by_draws: Floats | None) -> ContactLosses:
        """Return what each place loses."""
        value, grid = self.value(means), self.grid_deg
        enough = self.choices & (value >= (1 - self.tolerance_rel) * value[best])
        low, high = next(ends for ends in _intervals(grid, enough) if ends[0] <= grid[best] <= ends[1])
        return ContactLosses(
            weights=self.weights,
            relative=self.relative(means),
            loss_95_rel=np.quantile(1 - self.relative(drawn)[..., best], CONFIDENCE, axis=0),
            average_deg=float(grid[self.best(means, by_draws, "average")]),
            worst_deg=float(grid[self.best(means, by_draws, "worst")]),
            tolerance_deg=(low, high),
        )


def _judge(
    contacts: Sequence[SweptContact], curves: Sequence[SimulatedCurve], criterion: Criterion, tolerance_rel: float
) -> _Judge:
    """Return what values the angles; only those that are allowed at all places may be chosen."""
    grid_deg = curves[0].posterior.grid_deg
    choices = np.all([open_angles(c.angles_deg, c.allowed, grid_deg) for c in contacts], axis=0)
    if not choices.any():
        raise DecideError(
            "No angle of the sweep meets the constraints (clipping, room for the panel). Move the panel, or allow a "
            "shorter exposure, and simulate the sweep again."
        )
    weights = np.array([contact.weight_rel for contact in contacts])
    return _Judge(weights / weights.sum(), criterion, choices, grid_deg, tolerance_rel)


def _band(judge: _Judge, means: Floats, drawn: Floats) -> tuple[Floats, Floats]:
    """Return expected curve and standard deviation (G,): of the one place, or of the value over several."""
    if len(means) > 1:
        return judge.value(means), np.asarray(judge.value(drawn).std(axis=0))
    return np.asarray(means[0]), np.asarray(drawn[:, 0].std(axis=0))


@dataclass(frozen=True, slots=True)
class _Simulated:
    """Expected curves (C, G), joint draws (S, C, G) with the paints, the best angle, and risk of the renders' noise."""

    means: Floats
    drawn: Floats
    best: int
    rendered: AngleRisk


def _simulated(
    judge: _Judge,
    contacts: Sequence[SweptContact],
    curves: Sequence[SimulatedCurve],
    draws: int,
    rng: np.random.Generator,
) -> _Simulated:
    """Return what the simulation says if it were exact."""
    means = np.array([curve.mean for curve in curves])
    drawn = np.stack([curve.posterior.draws(draws, rng)[:, 0] for curve in curves], axis=1)
    rendered = judge.risk(drawn, best := judge.best(means, None))
    return _Simulated(means, drawn * np.exp(_paint_draws(contacts, judge.grid_deg, draws, rng)), best, rendered)


def _decision(
    judge: _Judge,
    curves: tuple[SimulatedCurve, ...],
    simulated: _Simulated,
    discrepancy: Discrepancy,
    errors: ErrorDraws,
) -> AngleDecision:
    """Return the decision on the real curve: by the least expected regret over draws where captures tell of it."""
    captured = discrepancy.captures > 0
    # without captures nothing is known of the error's sign
    error_mean = errors.whole.mean(axis=0) if captured else np.zeros_like(simulated.means)
    # a scale common to all angles cannot change the ranking
    real_means = simulated.means * np.exp(error_mean.mean(axis=1, keepdims=True) - error_mean)
    drawn = simulated.drawn * np.exp(errors.whole.mean(axis=2, keepdims=True) - errors.whole)
    by_draws = drawn if captured else None
    risk = judge.risk(drawn, best := judge.best(real_means, by_draws))
    at_end = judge.is_end(best)
    verdict = verdict_of(simulated.rendered, risk, judge.tolerance_rel, captured and discrepancy.hidden is None)
    mean_rel, sd_rel = _band(judge, real_means, drawn)
    simulation_only_mean_rel, simulation_only_sd_rel = _band(judge, simulated.means, simulated.drawn)
    return AngleDecision(
        best_deg=float(judge.grid_deg[best]),
        best_simulation_only_deg=float(judge.grid_deg[simulated.best]),
        at_range_end=at_end,
        # an optimum at the end of the sweep may lie outside it: no risk inside the range says anything
        verdict="undecided" if at_end else verdict,
        simulation_only=judge.risk(simulated.drawn, simulated.best),
        risk=risk,
        validated=captured,
        curves=curves,
        discrepancy=discrepancy,
        error_mean=error_mean,
        choices=judge.choices,
        mean_rel=mean_rel,
        sd_rel=sd_rel,
        simulation_only_mean_rel=simulation_only_mean_rel,
        simulation_only_sd_rel=simulation_only_sd_rel,
        contacts=judge.losses(real_means, drawn, best, by_draws),
        value_mean=judge.value(drawn).mean(axis=0),
        shown_by_capture=_shown_by_capture(judge, curves[0].posterior.seen.angles_deg, errors.seen, drawn),
    )


def _shown_by_capture(judge: _Judge, angles_deg: Floats, errors: Floats, drawn: Floats) -> Floats:
    """Return how the value moves with what a capture sees at each place and angle (C, A, G + 1), over draws."""
    at = np.abs(judge.grid_deg - angles_deg[:, None]).argmin(axis=1)
    shown = errors[..., at] - errors[..., at].mean(axis=0)
    value = judge.value(drawn)
    covariance = np.einsum("sca,sg->cag", shown, value - value.mean(axis=0), optimize=True) / len(value)
    return np.concatenate([covariance, shown.var(axis=0)[..., None]], axis=2)


def _paint_draws(contacts: Sequence[SweptContact], grid_deg: Floats, draws: int, rng: np.random.Generator) -> Floats:
    """Return draws (draws, C, G) of the log objective about that of the mean paint: one paint for all places.

    Multivariate Student's, of as many degrees of freedom as the scatter of a few posterior draws leaves.
    """
    found = np.zeros((draws, len(contacts), grid_deg.size))
    most = max((0 if contact.scatter is None else len(contact.scatter) for contact in contacts), default=0)
    if most < _LEAST_REPEATS:
        return found
    normals = rng.standard_normal((draws, most)) / np.sqrt(rng.chisquare(most - 1, (draws, 1)))
    for number, contact in enumerate(contacts):
        if contact.scatter is not None:
            about_mean = contact.scatter - contact.scatter.mean(axis=0)
            on_grid = np.array([np.interp(grid_deg, contact.angles_deg, row) for row in about_mean])
            found[:, number] = normals[:, : len(on_grid)] @ on_grid
    return found


def _checked_curve(contact: SweptContact, tolerance_rel: float) -> SimulatedCurve:
    """Return the curve of a sweep that allows a decision."""
    _check(contact.angles_deg, contact.values, tolerance_rel)
    return simulated_curve(contact.angles_deg, contact.values)


def simulated_curve(angles_deg: Floats, values: Floats) -> SimulatedCurve:
    """Return the curve relative to its mean, on a grid of 1 deg."""
    relative = values / values.mean(axis=0)
    means = relative.mean(axis=1)
    repeats = values.shape[1]
    # One degree of freedom per repeat went into its scale, one per angle into its mean.
    freedom = (len(angles_deg) - 1) * (repeats - 1)
    noise_variance = float(((relative - means[:, None]) ** 2).sum()) / freedom
    variance = max(noise_variance / repeats, _LEAST_NOISE_REL**2)
    steps = int(np.ceil(angles_deg[-1] - angles_deg[0]))
    grid = np.linspace(angles_deg[0], angles_deg[-1], steps + 1)
    size = len(angles_deg)
    seen = observations(angles_deg, means, variance * np.eye(size), np.ones((size, 1)))
    return SimulatedCurve(float(np.sqrt(noise_variance)), repeats, pointed_posterior(_CURVE_PRIOR, seen, grid))


def open_angles(angles_deg: Floats, allowed: NDArray[np.bool_] | None, grid_deg: Floats) -> NDArray[np.bool_]:
    """Return which angles of the grid may be chosen: between two angles of the sweep both must be allowed."""
    if allowed is None:
        return np.ones(grid_deg.size, dtype=np.bool_)
    share = np.interp(grid_deg, angles_deg, allowed.astype(np.float64))
    return np.asarray(share > 1 - 1e-9)


def _check(
    angles_deg: NDArray[np.float64],
    values: NDArray[np.float64],
    tolerance_rel: float,
) -> None:
    """Refuse a sweep that does not allow a decision."""
    if angles_deg.ndim != 1 or len(angles_deg) < _LEAST_ANGLES:
        raise DecideError(
            f"The sweep has only {angles_deg.size} angles, but at least {_LEAST_ANGLES} are needed to see a peak. "
            "Render more angles."
        )
    if not (np.diff(angles_deg) > 0).all():
        raise DecideError(
            f"The angles must be strictly increasing, got {angles_deg.tolist()} deg. Sort them and put all repeats of "
            "one angle into one row."
        )
    if values.ndim != 2 or len(values) != len(angles_deg) or values.shape[1] < _LEAST_REPEATS:
        raise DecideError(
            f"The values have shape {values.shape} for {len(angles_deg)} angles, but must have shape (angles, repeats) "
            f"with at least {_LEAST_REPEATS} repeats, which show the noise. Render again with another seed."
        )
    if not (np.isfinite(values) & (values > 0)).all():
        row = int(np.argwhere(~(np.isfinite(values) & (values > 0)))[0, 0])
        raise DecideError(
            f"The values of the objective must be finite and positive, but are {values[row].tolist()} at "
            f"{angles_deg[row]:g} deg. Check the render at this angle, or leave the angle out."
        )
    if not 0 < tolerance_rel < 1:
        raise DecideError(f"The tolerance must be a relative loss between 0 and 1, got {tolerance_rel}; 0.02 is 2 %.")
