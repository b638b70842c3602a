"""From sweeps of the light angle and photometric error reports to the stored decision."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleProposal,
    AngleStatement,
    DecidedContact,
    DecidingCapture,
    LightAngleDecision,
    LightAngleSweep,
    OtherObjective,
    PhotometricErrorReport,
)
from finray_calib.decide._capture_errors import CaptureErrors, capture_errors, require_one_finger
from finray_calib.decide._decision_words import decision_sentence, headline, outside
from finray_calib.decide._light_angle import AngleDecision, AngleRisk, Criterion, decide_contacts
from finray_calib.decide._next_observation import Proposal, propose_capture, propose_render
from finray_calib.decide._other_objectives import OtherOptimum, other_optima
from finray_calib.decide._sim_to_real import COMMON_SHARE
from finray_calib.decide._swept_contacts import swept_contacts

Floats = NDArray[np.float64]
TOLERANCE_REL = 0.02
#: Half-width of a central 95 % interval of a normal distribution, in standard deviations.
_BAND_QUANTILE = 1.959964
_ERROR_CURVE = (
    "a random curve over the angle, with kinks or without, with a correlation length between 8 and 150 deg, with edges "
    "of shadows and narrow reflections"
)


def decide(
    sweeps: LightAngleSweep | Sequence[LightAngleSweep],
    reports: Sequence[PhotometricErrorReport],
    seed: int,
    narrow_sweep: bool = False,
    weights: Sequence[float] | None = None,
    criterion: Criterion = "average",
) -> LightAngleDecision:
    """Decide on the light angle; reports on captures correct the simulated curves and tell how sure they are.

    Parameters
    ----------
    sweeps
        Objective over angle and repeat, of one touch or of each of several touches of one finger; where they hold
        constraints, only angles that meet them everywhere are chosen.
    reports
        Comparisons with captures, one for each; they carry the error of the sweep's own objective with covariance.
        Without any, the sim-to-real error has its prior and the decision is not validated.
    seed
        Seed of the posterior draws.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so.
    weights
        How often each touch occurs; None: all alike.
    criterion
        "average": the least loss on average over the touches; "worst": the least loss at the worst of them.

    Raises
    ------
    DecideError
        The sweeps allow no decision or do not belong together, a report carries no error of the objective or no angle,
        is on another finger, or two reports are on one capture.
    """
    swept = [sweeps] if isinstance(sweeps, LightAngleSweep) else list(sweeps)
    contacts = swept_contacts(swept, weights, narrow_sweep)
    of_finger, of_sweep = require_one_finger(swept, reports)
    captures, left_out = capture_errors(swept, reports, of_sweep)
    rng = np.random.default_rng(seed)
    decision = decide_contacts(contacts, rng, TOLERANCE_REL, captures, criterion)
    others = other_optima(swept[0], decision.best_deg, TOLERANCE_REL, rng)
    next_render = propose_render(decision) if len(swept) == 1 else None
    next_capture = propose_capture(decision, captures)
    decided = _contacts(swept, decision)
    first = headline(decision, decided, criterion, TOLERANCE_REL)
    then = decision_sentence(decision, captures.angles_deg, TOLERANCE_REL, next_render, next_capture, others, decided)
    # over several touches the curve is a share of the best
    scale = float(swept[0].values.mean()) if len(swept) == 1 else 1.0
    real = _band(decision.mean_rel, decision.sd_rel, scale)
    alone = _band(decision.simulation_only_mean_rel, decision.simulation_only_sd_rel, scale)
    low_rel, discrepancy_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    return LightAngleDecision(
        objective=swept[0].objective,
        angle_deg=decision.best_deg,
        angle_simulation_only_deg=decision.best_simulation_only_deg,
        verdict=decision.verdict,
        at_range_end=decision.at_range_end,
        headline=first,
        sentence=f"{first} {then} {outside(decided, swept[0].design.indenter)}",
        tolerance_rel=TOLERANCE_REL,
        tolerance_deg=decision.contacts.tolerance_deg,
        criterion=criterion,
        contacts=decided,
        angle_average_deg=decision.contacts.average_deg,
        angle_worst_deg=decision.contacts.worst_deg,
        contact_value=decision.contacts.relative,
        validated=decision.validated,
        discrepancy_rel=discrepancy_rel,
        discrepancy_95_rel=(low_rel, high_rel),
        captures=_deciding_captures(decision, captures, scale),
        statement=_statement(decision.risk),
        statement_simulation_only=_statement(decision.simulation_only),
        grid_deg=decision.grid_deg,
        mean=real[0],
        low95=real[1],
        high95=real[2],
        mean_simulation_only=alone[0],
        low95_simulation_only=alone[1],
        high95_simulation_only=alone[2],
        next_render=_proposal(next_render, decided),
        next_capture=_proposal(next_capture, decided),
        other_objectives=tuple(_other(other) for other in others),
        notes=(*of_finger, *left_out, *_notes(swept, decision, captures)),
    )


def _band(mean_rel: Floats, sd_rel: Floats, scale: float) -> tuple[Floats, Floats, Floats]:
    """Return a curve and the ends of its 95 % band."""
    half = _BAND_QUANTILE * sd_rel
    return scale * mean_rel, scale * (mean_rel - half), scale * (mean_rel + half)


def _contacts(sweeps: Sequence[LightAngleSweep], decision: AngleDecision) -> tuple[DecidedContact, ...]:
    """Return each touch and what it loses."""
    losses = decision.contacts
    best = int(np.abs(decision.grid_deg - decision.best_deg).argmin())
    own = np.where(decision.choices, losses.relative, -np.inf).argmax(axis=1)
    return tuple(
        DecidedContact(
            sweep=sweep.name,
            shape=sweep.design.indenter.shape,
            position_mm=sweep.design.indenter.position_mm,
            across_mm=sweep.design.indenter.across_mm,
            depth_mm=sweep.design.indenter.depth_mm,
            weight_share=float(losses.weights[n]),
            best_deg=float(decision.grid_deg[own[n]]),
            loss_rel=max(0.0, 1.0 - float(losses.relative[n, best])),
            loss_95_rel=float(losses.loss_95_rel[n]),
        )
        for n, sweep in enumerate(sweeps)
    )


def _deciding_captures(decision: AngleDecision, captures: CaptureErrors, scale: float) -> tuple[DecidingCapture, ...]:
    """Return each capture with its error and its place beside the curve.

    The place is less the scale that the curve leaves open: the mean of t over the grid, or, for absolute ratios, the
    mean residual of the captures of one rig. Only the latter, which nobody knows, is taken off the error too.
    """
    if not captures.names:
        return ()
    discrepancy = decision.discrepancy
    expected = _at_captures(decision, captures, discrepancy.shape_means)
    offset = discrepancy.visible.mean.mean(axis=1)[captures.contact]
    if captures.scale_of is not None:
        for number in np.unique(captures.scale_of):
            members = captures.scale_of == number
            offset[members] = (captures.log_error - expected)[members].mean()
    log_shape = captures.log_error - offset
    log_error = captures.log_error if captures.scale_of is None else log_shape
    sd = np.sqrt(np.diag(discrepancy.noise))
    simulated = _at_captures(decision, captures, np.array([curve.mean for curve in decision.curves]))
    value = scale * simulated * np.exp(-log_shape)
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


def _at_captures(decision: AngleDecision, captures: CaptureErrors, curves: Floats) -> Floats:
    """Return curves (C, G) at the angle and place of each capture, (N,)."""
    at = zip(captures.contact, captures.angles_deg, strict=True)
    return np.array([np.interp(angle, decision.grid_deg, curves[contact]) for contact, angle in at])


def _statement(risk: AngleRisk) -> AngleStatement:
    """Return the record of what is claimed."""
    return AngleStatement(
        p_within_5deg=risk.p_within_5deg,
        expected_regret=risk.expected_regret_rel,
        regret_95=risk.regret_95_rel,
        equivalent_deg=risk.equivalent_deg,
        p_within_tolerance=risk.p_within_tolerance,
    )


def _proposal(proposal: Proposal | None, contacts: Sequence[DecidedContact]) -> AngleProposal | None:
    """Return the record of a proposal."""
    if proposal is None:
        return None
    return AngleProposal(
        angle_deg=proposal.angle_deg,
        gain_rel=proposal.gain_rel,
        noise_rel=proposal.noise_rel,
        position_mm=contacts[proposal.contact].position_mm,
    )


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


def _notes(sweeps: Sequence[LightAngleSweep], decision: AngleDecision, captures: CaptureErrors) -> tuple[str, ...]:
    """Say what the decision rests on."""
    sweep, light = sweeps[0], sweeps[0].design.light
    notes = [
        *dict.fromkeys(note for swept in sweeps for note in swept.notes),
        f"the panel sits at x, y, z = {', '.join(f'{p:g}' for p in light.position_mm)} mm and the mirror reflects "
        f"{sweep.design.mirror.reflectance:.0%}: the best angle depends on both and on the probe points",
        f"scatter of one value about the curve: {max(c.noise_rel for c in decision.curves):.1%}, of render noise, "
        "which is averaged over the repeats; the scatter of the paint draws is kept: the real paint is one of them",
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
            f"not seen: it keeps its prior, assumed to be {COMMON_SHARE:.0%} of the variance"
            if captures.scale_of is None
            else "by exposure and LED current, up to one unknown scale for each rig"
        )
        notes.append(
            f"captures are compared {compared}; how the sim-to-real error depends on the angle elsewhere is "
            f"{_ERROR_CURVE}, whose size (prior: 10 %, 95 % between 2.5 % and 39 %) the captures tell; they see the "
            "image beside the indenter, the sweep its probe points"
        )
        notes += _unseen_channels(sweep)
    if len(sweeps) > 1:
        notes.append(
            "between places the error is alike by a share that nobody measured: 10 to 90 % of its variance, all alike "
            "likely; edges and reflections are those of one camera and shared"
        )
    return tuple(notes)


def _unseen_channels(sweep: LightAngleSweep) -> list[str]:
    """Say when the sweep does not know the shares of its channels."""
    if sweep.channels is not None:
        return []
    return ["the sweep was written by an older version without its channels: red, green and blue count alike"]
