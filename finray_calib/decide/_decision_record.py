"""From a sweep of the light angle and photometric error reports to the stored decision.

With what the decided angle costs under the sweep's other objectives, and the decision as one sentence that an engineer
can act on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleObjective,
    AngleProposal,
    AngleStatement,
    DecideError,
    DecidingCapture,
    LightAngleDecision,
    LightAngleSweep,
    OtherObjective,
    PhotometricErrorReport,
)
from finray_calib.decide._capture_errors import CaptureErrors, capture_errors, require_one_finger
from finray_calib.decide._gaussian_process import condition, draw_normal, fit_kernel
from finray_calib.decide._light_angle import (
    CONFIDENCE,
    NEARBY_DEG,
    AngleDecision,
    AngleRisk,
    Proposal,
    Verdict,
    decide_angle,
    propose_capture,
    propose_render,
)

Floats = NDArray[np.float64]
OPTIMUM_DRAWS: Final = 2000
#: Ends of the 90 % interval: a disagreement, or an agreement, is claimed at 95 % probability each.
_LOW, _HIGH = 0.05, 0.95


@dataclass(frozen=True, slots=True)
class OtherOptimum:
    """Hold the optimum of one further objective, and what the decided angle loses under it.

    Attributes
    ----------
    name, unit : str
        Of the objective.
    best_deg : float
        Angle of greatest posterior mean of the utility, among the angles that the constraints allow.
    at_range_end : bool
        Whether that is an end of the sweep or of the allowed angles, so that a better one may lie beyond.
    values : tuple of (float, float)
        The objective itself, in its unit, at that angle and at the decided one.
    loss_rel, loss_low_rel, loss_high_rel : float
        Relative loss of utility at the decided angle: mean, 5 % and 95 % quantile.
    disagrees : bool or None
        True when the loss exceeds the tolerance with 95 % probability, False when it stays within it with 95 %
        probability, None when the sweep is too noisy to say.
    """

    name: str
    unit: str
    best_deg: float
    at_range_end: bool
    values: tuple[float, float]
    loss_rel: float
    loss_low_rel: float
    loss_high_rel: float
    disagrees: bool | None

    def __str__(self) -> str:
        """Say it in one sentence."""
        verdict = {True: "disagrees", False: "agrees", None: "cannot tell"}[self.disagrees]
        end = ", the end of what the sweep allows," if self.at_range_end else ""
        best, decided = (f"{value:.3g}" if self.unit == "1" else f"{value:.3g} {self.unit}" for value in self.values)
        return (
            f"{self.name} {verdict}: best at {self.best_deg:.0f} deg{end} with {best}, {decided} at the decided angle; "
            f"loss {self.loss_rel:.1%} ({self.loss_low_rel:.1%} to {self.loss_high_rel:.1%})"
        )


def other_optima(
    sweep: LightAngleSweep, decided_deg: float, tolerance_rel: float, rng: np.random.Generator
) -> tuple[OtherOptimum, ...]:
    """Return the optimum of each further objective of a sweep, in the order in which it stores them.

    Parameters
    ----------
    sweep : LightAngleSweep
        With or without further objectives.
    decided_deg : float
        Angle that was decided on the sweep's own objective.
    tolerance_rel : float
        Relative loss that does not matter.
    rng : numpy.random.Generator

    Returns
    -------
    tuple of OtherOptimum
        Empty for a sweep without further objectives.
    """
    allowed = None if sweep.constraints is None else sweep.constraints.allowed
    return tuple(
        other_optimum(sweep.angles_deg, objective, decided_deg, tolerance_rel, rng, allowed)
        for objective in sweep.other_objectives
    )


def other_optimum(
    angles_deg: Floats,
    objective: AngleObjective,
    decided_deg: float,
    tolerance_rel: float,
    rng: np.random.Generator,
    allowed: NDArray[np.bool_] | None = None,
) -> OtherOptimum:
    """Return where a further objective has its optimum, and what the decided angle loses under it.

    A Gaussian process (Matern-5/2) is fitted to the utility u, each repeat relative to its own mean, as in
    :func:`finray_calib.decide.decide_angle`; the loss is (max u - u(decided)) / max u over its joint draws
    on a grid of 1 deg, the maximum taken over allowed angles. For an objective that is better when smaller, u is its
    inverse, and the objective at the decided angle is 1 / (1 - loss) times its optimum.

    Parameters
    ----------
    angles_deg : ndarray, shape (A,)
        At least 4, increasing.
    objective : AngleObjective
        With at least 2 repeats.
    decided_deg : float
        Within the sweep.
    tolerance_rel : float
    rng : numpy.random.Generator
    allowed : ndarray of bool, shape (A,), optional
        Angles that meet the constraints; between two angles both must.

    Raises
    ------
    DecideError
        When there are too few angles or repeats, the decided angle lies outside the sweep, or no angle is allowed.
    """
    _check(angles_deg, objective, decided_deg, allowed)
    utility = objective.utility
    relative = utility / utility.mean(axis=0)
    means, repeats = relative.mean(axis=1), relative.shape[1]
    freedom = (len(means) - 1) * (repeats - 1)
    variance = np.full(len(means), float(((relative - means[:, None]) ** 2).sum()) / freedom / repeats)
    grid = np.linspace(angles_deg[0], angles_deg[-1], int(np.ceil(angles_deg[-1] - angles_deg[0])) + 1)
    curve = condition(fit_kernel(angles_deg, means, variance), angles_deg, means, variance, grid)
    draws = curve.mean + draw_normal(curve.covariance, OPTIMUM_DRAWS, rng)
    open_grid = np.ones(len(grid), dtype=np.bool_)
    if allowed is not None:
        # an angle between two others is allowed when both are: linear interpolation then stays at one
        open_grid = np.interp(grid, angles_deg, allowed.astype(np.float64)) > 1.0 - 1e-9
    decided = int(np.abs(grid - decided_deg).argmin())
    best = int(np.where(open_grid, curve.mean, -np.inf).argmax())
    top = np.maximum(draws[:, open_grid].max(axis=1), draws[:, decided])
    loss = 1.0 - draws[:, decided] / top
    low, high = np.quantile(loss, [_LOW, _HIGH]).tolist()
    scale = float(utility.mean())
    at_best, at_decided = (_natural(scale * float(curve.mean[k]), objective) for k in (best, decided))
    return OtherOptimum(
        name=objective.name,
        unit=objective.unit,
        best_deg=float(grid[best]),
        at_range_end=best in np.flatnonzero(open_grid)[[0, -1]].tolist(),
        values=(at_best, at_decided),
        loss_rel=float(loss.mean()),
        loss_low_rel=low,
        loss_high_rel=high,
        disagrees=True if low > tolerance_rel else (False if high <= tolerance_rel else None),
    )


def _natural(utility: float, objective: AngleObjective) -> float:
    """Return the objective in its own unit."""
    return utility if objective.larger_is_better else 1.0 / utility


def _check(
    angles_deg: Floats, objective: AngleObjective, decided_deg: float, allowed: NDArray[np.bool_] | None
) -> None:
    """Refuse what allows no statement."""
    count, repeats = objective.values.shape
    if count != len(angles_deg) or count < 4 or repeats < 2:
        raise DecideError(
            f"{objective.name} has {count} angles and {repeats} repeats for {len(angles_deg)} angles of the sweep; at "
            "least 4 angles with 2 repeats are needed. Simulate the sweep again with more of them."
        )
    if not angles_deg[0] <= decided_deg <= angles_deg[-1]:
        raise DecideError(
            f"The decided angle, {decided_deg:g} deg, lies outside the sweep ({angles_deg[0]:g} to {angles_deg[-1]:g} "
            "deg), where nothing is known of the other objectives. Simulate a wider sweep."
        )
    if allowed is not None and not allowed.any():
        raise DecideError(
            "No angle of the sweep meets the constraints (clipping, room for the panel). Move the panel, or allow a "
            "shorter exposure."
        )


TOLERANCE_REL = 0.02
#: Half-width of a central 95 % interval of a normal distribution, in standard deviations.
_BAND_QUANTILE = 1.959964
_ERROR_CURVE = "a random curve over the angle, with kinks or without, with a correlation length between 8 and 120 deg"


def decide(
    sweep: LightAngleSweep, reports: Sequence[PhotometricErrorReport], seed: int, narrow_sweep: bool = False
) -> LightAngleDecision:
    """Decide on the light angle; reports on captures correct the simulated curve and widen the decision.

    Parameters
    ----------
    sweep
        Objective over angle and repeat; where it holds constraints, only angles that meet them are chosen.
    reports
        Comparisons with captures, one for each; they carry the error of the sweep's own objective with covariance.
        Without any, the sim-to-real error has its prior and the decision is not validated.
    seed
        Seed of the posterior draws.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so.

    Raises
    ------
    DecideError
        The sweep allows no decision, a report carries no error of the objective or no angle, is on another finger, or
        two reports are on one capture.
    """
    of_finger = require_one_finger(sweep, reports)
    captures, left_out = capture_errors(sweep, reports)
    rng = np.random.default_rng(seed)
    allowed = None if sweep.constraints is None else sweep.constraints.allowed
    decision = decide_angle(
        sweep.angles_deg, sweep.values, rng, TOLERANCE_REL, captures, allowed, narrow_sweep=narrow_sweep
    )
    others = other_optima(sweep, decision.best_deg, TOLERANCE_REL, rng)
    next_render, next_capture = propose_render(decision), propose_capture(decision, captures)
    low_rel, discrepancy_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    scale = float(sweep.values.mean())
    curve = decision.simulated.posterior
    half, half_alone = _BAND_QUANTILE * decision.sd_rel, _BAND_QUANTILE * curve.standard_deviation
    return LightAngleDecision(
        objective=sweep.objective,
        angle_deg=decision.best_deg,
        angle_simulation_only_deg=decision.best_simulation_only_deg,
        verdict=decision.verdict,
        at_range_end=decision.at_range_end,
        sentence=decision_sentence(decision, captures.angles_deg, TOLERANCE_REL, next_render, next_capture, others),
        tolerance_rel=TOLERANCE_REL,
        validated=decision.validated,
        discrepancy_rel=discrepancy_rel,
        discrepancy_95_rel=(low_rel, high_rel),
        captures=_deciding_captures(decision, captures, scale),
        statement=_statement(decision.risk),
        statement_simulation_only=_statement(decision.simulation_only),
        grid_deg=curve.grid_deg,
        mean=scale * decision.mean_rel,
        low95=scale * (decision.mean_rel - half),
        high95=scale * (decision.mean_rel + half),
        mean_simulation_only=scale * curve.mean,
        low95_simulation_only=scale * (curve.mean - half_alone),
        high95_simulation_only=scale * (curve.mean + half_alone),
        next_render=_proposal(next_render),
        next_capture=_proposal(next_capture),
        other_objectives=tuple(_other(other) for other in others),
        notes=(*of_finger, *left_out, *_notes(sweep, decision, captures)),
    )


def _deciding_captures(decision: AngleDecision, captures: CaptureErrors, scale: float) -> tuple[DecidingCapture, ...]:
    """Return each capture with its error and its place beside the curve.

    The place is less the scale that the curve leaves open: the mean of t over the grid, or, for absolute ratios, the
    mean residual of the captures of one rig. Only the latter, which nobody knows, is taken off the error too.
    """
    if not captures.names:
        return ()
    grid_deg, discrepancy = decision.simulated.posterior.grid_deg, decision.discrepancy
    expected = np.interp(captures.angles_deg, grid_deg, discrepancy.shape_mean)
    offset = np.full(len(captures.names), discrepancy.mean.mean())
    if captures.scale_of is not None:
        for number in np.unique(captures.scale_of):
            members = captures.scale_of == number
            offset[members] = (captures.log_error - expected)[members].mean()
    log_shape = captures.log_error - offset
    log_error = captures.log_error if captures.scale_of is None else log_shape
    sd = np.sqrt(np.diag(discrepancy.noise))
    value = scale * np.interp(captures.angles_deg, grid_deg, decision.simulated.posterior.mean) * np.exp(-log_shape)
    return tuple(
        DecidingCapture(
            captured=name,
            light_angle_deg=float(captures.angles_deg[n]),
            light_angle_uncertainty_deg=float(captures.angle_sd_deg[n]),
            error_rel=float(np.expm1(log_error[n])),
            error_u_rel=float(sd[n]),
            value=float(value[n]),
            sd=float(value[n] * sd[n]),
        )
        for n, name in enumerate(captures.names)
    )


def _statement(risk: AngleRisk) -> AngleStatement:
    """Return the record of what is claimed."""
    return AngleStatement(
        p_within_5deg=risk.p_within_5deg,
        expected_regret=risk.expected_regret_rel,
        regret_95=risk.regret_95_rel,
        equivalent_deg=risk.equivalent_deg,
        p_within_tolerance=risk.p_within_tolerance,
    )


def _proposal(proposal: Proposal | None) -> AngleProposal | None:
    """Return the record of a proposal."""
    if proposal is None:
        return None
    return AngleProposal(angle_deg=proposal.angle_deg, gain_rel=proposal.gain_rel, noise_rel=proposal.noise_rel)


def _other(other: OtherOptimum) -> OtherObjective:
    """Return the record of another objective's optimum."""
    return OtherObjective(
        name=other.name,
        best_deg=other.best_deg,
        loss_rel=other.loss_rel,
        loss_90_rel=(other.loss_low_rel, other.loss_high_rel),
        disagrees=other.disagrees,
        statement=str(other),
    )


def _notes(sweep: LightAngleSweep, decision: AngleDecision, captures: CaptureErrors) -> tuple[str, ...]:
    """Say what the decision rests on."""
    light = sweep.design.light
    notes = [
        *sweep.notes,
        f"the panel sits at x, y, z = {', '.join(f'{p:g}' for p in light.position_mm)} mm and the mirror reflects "
        f"{sweep.design.mirror.reflectance:.0%}: the best angle depends on both and on the probe points",
        f"scatter of one value about the curve: {decision.simulated.noise_rel:.1%}, of render noise and paint draws "
        "together; both are averaged over the repeats",
    ]
    if not decision.choices.all():
        notes.append("angles at which pixels clip or the panel does not fit were left out of the choice")
    if not captures.names:
        notes.append(
            "no capture shows how far the finger differs from the simulation; until one does, the error is taken to be "
            f"{_ERROR_CURVE} and an assumed size (10 %, 95 % between 2.5 % and 39 %). The odds are as good as this "
            "assumption"
        )
    else:
        compared = (
            "relative to the no-contact image of each capture, so an error that contact and no-contact image share is "
            "not seen"
            if captures.scale_of is None
            else "by exposure and LED current, up to one unknown scale for each rig"
        )
        notes.append(
            f"captures are compared {compared}; how the sim-to-real error depends on the angle elsewhere is "
            f"{_ERROR_CURVE}, whose size (prior: 10 %, 95 % between 2.5 % and 39 %) the captures tell; they see the "
            "image beside the indenter, the sweep its probe points"
        )
        notes += _unseen_channels(sweep)
    return tuple(notes)


def _unseen_channels(sweep: LightAngleSweep) -> list[str]:
    """Say when the sweep does not know the shares of its channels."""
    if sweep.channels is not None:
        return []
    return ["the sweep was written by an older version without its channels: red, green and blue count alike"]


_CONSEQUENCE: dict[Verdict, str] = {
    "tie": "a tie, any of these angles will do",
    "undecided": "undecided, more renders are needed",
    "model-limited": "the sim-to-real error exceeds the advantage, so more renders will not decide",
}
_UNPROVEN = "not decided, only captures can tell how far the finger differs from the simulation"


def decision_sentence(
    decision: AngleDecision,
    captures_deg: NDArray[np.float64],
    tolerance_rel: float,
    next_render: Proposal | None = None,
    next_capture: Proposal | None = None,
    others: Sequence[OtherOptimum] = (),
) -> str:
    """Return a decision in plain English with its numbers, with captures and without, and what to do next.

    Parameters
    ----------
    decision : AngleDecision
    captures_deg : ndarray, shape (N,)
        Angles of the captures in it; none: not validated.
    tolerance_rel : float
        Relative loss that does not matter.
    next_render, next_capture : Proposal, optional
        Said where the verdict asks for it.
    others : sequence of OtherOptimum
        Other objectives; those that disagree are named.

    Returns
    -------
    str
    """
    parts = [*_claim(decision.best_deg, decision.risk, tolerance_rel)]
    if decision.at_range_end:
        parts.append("the best angle is at the end of the sweep, so the optimum may lie outside it: widen the sweep")
    elif decision.verdict == "model-limited" and not decision.validated:
        parts.append(_UNPROVEN)
    elif decision.verdict in _CONSEQUENCE:
        parts.append(_CONSEQUENCE[decision.verdict])
    parts += _captures_in_words(decision, captures_deg)
    # inside a sweep that is too narrow no render helps
    if next_render is not None and decision.verdict == "undecided" and not decision.at_range_end:
        parts.append(f"next: render {next_render.angle_deg:.0f} deg")
    if next_capture is not None and (decision.verdict == "model-limited" or not len(captures_deg)):
        parts.append(f"next: capture at {next_capture.angle_deg:.0f} deg")
    parts += [
        f"{other.name} would choose {other.best_deg:.0f} deg and loses {_percent(other.loss_rel)} here"
        for other in others
        if other.disagrees
    ]
    return "; ".join(parts) + "."


def _claim(best_deg: float, risk: AngleRisk, tolerance_rel: float) -> tuple[str, ...]:
    """Return angle, probabilities, loss and equivalent angles."""
    intervals = " and ".join(f"{low:.0f}-{high:.0f} deg" for low, high in risk.equivalent_deg)
    return (
        f"{best_deg:.0f} deg: within {_percent(tolerance_rel)} of the best with probability "
        f"{risk.p_within_tolerance:.2f}, true optimum within {NEARBY_DEG:.0f} deg with {risk.p_within_5deg:.2f}",
        f"expected loss {_percent(risk.expected_regret_rel)}, at most {_percent(risk.regret_95_rel)} with "
        f"{_percent(CONFIDENCE)} probability",
        f"{intervals} are equivalent within {_percent(tolerance_rel)}"
        if intervals
        else f"no angle is within {_percent(tolerance_rel)} of the best with {_percent(CONFIDENCE)} probability",
    )


def _captures_in_words(decision: AngleDecision, captures_deg: NDArray[np.float64]) -> tuple[str, ...]:
    """Return what captures changed, or what is assumed because there are none."""
    low_rel, amplitude_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    alone = _percent(decision.simulation_only.regret_95_rel)
    if not len(captures_deg):
        return (
            f"not validated against a capture, a sim-to-real error of {_percent(amplitude_rel)} (95 %: "
            f"{_percent(low_rel)} to {_percent(high_rel)}) is assumed; if the simulation were exact, at most {alone}",
        )
    angles = [f"{angle:.0f}" for angle in sorted(set(captures_deg.tolist()))]
    listed = " and ".join([*([", ".join(angles[:-1])] if len(angles) > 1 else []), angles[-1]])
    number = "a capture" if len(captures_deg) == 1 else f"{len(captures_deg)} captures"
    return (
        f"{number} at {listed} deg included, with a sim-to-real error of {_percent(amplitude_rel)}",
        f"by simulation alone {decision.best_simulation_only_deg:.0f} deg, at most {alone}",
    )


def _percent(fraction: float) -> str:
    """Return a fraction as per cent with two significant digits."""
    return f"{float(f'{100 * fraction:.2g}'):g} %"
