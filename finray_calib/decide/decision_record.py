"""From a sweep of the light angle and photometric error reports to the stored decision."""

from collections.abc import Sequence

import numpy as np

from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import AngleProposal, AngleStatement, DecidingCapture, LightAngleDecision, OtherObjective
from data_schemas.simulate import LightAngleSweep
from finray_calib.decide.angle_risk import AngleRisk
from finray_calib.decide.capture_errors import CaptureErrors, capture_errors
from finray_calib.decide.decision_sentence import decision_sentence
from finray_calib.decide.finger_check import require_one_finger
from finray_calib.decide.light_angle import AngleDecision, decide_angle
from finray_calib.decide.other_objectives import OtherOptimum, other_optima
from finray_calib.decide.proposals import Proposal, propose_capture, propose_render

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
        captures=_captures(decision, captures, scale),
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


def _captures(decision: AngleDecision, captures: CaptureErrors, scale: float) -> tuple[DecidingCapture, ...]:
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
