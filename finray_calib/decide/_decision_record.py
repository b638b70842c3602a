"""From sweeps of the light angle and photometric error reports to the stored decision and its sentences.

The sentences say first what to do, then what is lost, and how sure that is. A decision also says what to observe next:
the next render and the next physical capture.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import (
    AngleProposal,
    AngleStatement,
    DecidedContact,
    DecideError,
    DecidingCapture,
    Indenter,
    LightAngleDecision,
    LightAngleSweep,
    OtherObjective,
    PhotometricErrorReport,
    percent,
)
from finray_calib.decide._capture_errors import UNSTATED_ANGLE_SD_DEG, CaptureErrors, capture_errors, require_one_finger
from finray_calib.decide._gaussian_process import knowledge_gradient
from finray_calib.decide._light_angle import (
    CONFIDENCE,
    NEARBY_DEG,
    AngleDecision,
    AngleRisk,
    Criterion,
    decide_contacts,
)
from finray_calib.decide._sim_to_real import MOVED_SD_DEG
from finray_calib.decide._swept_contacts import Aim, DecidedOn, OtherOptimum, decided_on, other_optima

Floats = NDArray[np.float64]
TOLERANCE_REL = 0.02
#: Half-width of a central 95 % interval of a normal distribution, in standard deviations.
_BAND_QUANTILE = 1.959964
_ERROR_CURVE = (
    f"the simulated curve is assumed to be shifted by some {MOVED_SD_DEG:g} deg (one standard deviation) and to have "
    "an error that varies randomly with the angle (correlation length 8 to 150 deg, with or without kinks, with edges "
    "of shadows and narrow reflections)"
)
#: Shape of what is looked at where the error of the normal is decided on.
FACET = "facet"
_ASSUMED_SIZE = (
    "3 %, with 95 % probability between 0.4 % and 21 %; with a probability of 1/2, it is proportionally smaller where "
    "the curve varies less with the angle than usual"
)


#: Standard uncertainty of the objective in a capture, where there is none to learn it from.
ASSUMED_CAPTURE_SD_REL = 0.01
#: A smaller expected rise of the objective is not worth an observation.
LEAST_GAIN_REL = 5e-4


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
    contact : int
        Number of the place to touch.
    """

    angle_deg: float
    gain_rel: float
    noise_rel: float
    contact: int = 0


def propose_render(decision: AngleDecision) -> Proposal | None:
    """Return the angle to render next, as many repeats as the sweep has; None where it would change nothing.

    Valid for repeats with the same draws as those of the sweep, so that they share its scale.
    """
    simulated = decision.simulated
    curve = simulated.posterior
    noise_rel = simulated.noise_rel / float(np.sqrt(simulated.repeats))
    noise_variance = np.full(curve.grid_deg.size, noise_rel**2)
    response = (decision.mean_rel / simulated.mean)[:, None] * curve.covariance
    choices = decision.choices
    mean = decision.mean_rel[choices]
    gains = knowledge_gradient(mean, response[choices], np.diag(curve.covariance), noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    return None if gain_rel < LEAST_GAIN_REL else Proposal(float(curve.grid_deg[best]), gain_rel, noise_rel)


def propose_capture(decision: AngleDecision, captures: CaptureErrors) -> Proposal | None:
    """Return the place and the angle of the sweep to capture next; None where it would change nothing.

    A capture shows what captures of its kind see of the sim-to-real error at its place and angle (see `ErrorDraws`),
    with the noise of the captures so far (median; 1 % and 2 deg without any). How the value of each angle moves with
    that is taken from the joint draws, to first order; that a capture also tells the amplitude of the error is not
    counted.
    """
    sd_rel, angle_sd_deg = ASSUMED_CAPTURE_SD_REL, UNSTATED_ANGLE_SD_DEG
    if captures.names:
        sd_rel = float(np.sqrt(np.median(np.diag(captures.covariance))))
        angle_sd_deg = float(np.median(captures.angle_sd_deg))
    shown, choices = decision.shown_by_capture, decision.choices
    places, angles, _ = shown.shape
    swept_deg = decision.simulated.posterior.seen.angles_deg
    slopes = [np.interp(swept_deg, decision.grid_deg, curve.log_slope_per_deg) for curve in decision.curves]
    noise_variance = sd_rel**2 + (np.ravel(slopes) * angle_sd_deg) ** 2
    flat = shown.reshape(places * angles, -1)
    mean = decision.value_mean[choices]
    gains = knowledge_gradient(mean, flat[:, :-1][:, choices].T, flat[:, -1], noise_variance)
    best = int(gains.argmax())
    gain_rel = float(gains[best] / mean.max())
    if gain_rel < LEAST_GAIN_REL:
        return None
    place, angle = divmod(best, angles)
    return Proposal(float(swept_deg[angle]), gain_rel, float(np.sqrt(noise_variance[best])), place)


def decide(
    sweeps: LightAngleSweep | Sequence[LightAngleSweep],
    reports: Sequence[PhotometricErrorReport],
    seed: int,
    narrow_sweep: bool = False,
    weights: Sequence[float] | None = None,
    criterion: Criterion = "average",
    aim: Aim | None = None,
) -> LightAngleDecision:
    """Decide on the light angle; reports on captures correct the simulated curves and state how sure they are.

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
    aim
        "brightness" of the touches, or expected error of the sensed "normal" at places along the pad; None: the latter
        where a sweep holds it and neither reports nor weights are given.

    Raises
    ------
    DecideError
        The sweeps allow no decision or do not belong together, a report carries no error of the objective or no angle,
        is on another finger, or two reports are on one capture.
    """
    for name, choice, allowed in (("criterion", criterion, get_args(Criterion)), ("aim", aim, (None, *get_args(Aim)))):
        if choice not in allowed:
            raise DecideError(f"{name}={choice!r} is unknown; it is one of {', '.join(map(repr, allowed))}")
    swept = [sweeps] if isinstance(sweeps, LightAngleSweep) else list(sweeps)
    on = decided_on(swept, weights, narrow_sweep, aim, bool(reports))
    of_finger, of_sweep = require_one_finger(swept, reports)
    captures, left_out = capture_errors(swept, reports, of_sweep)
    rng = np.random.default_rng(seed)
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small
        decision = decide_contacts(on.contacts, rng, TOLERANCE_REL, captures, criterion)
        others = other_optima(on, decision, TOLERANCE_REL, rng)
        next_render = propose_render(decision) if len(on.contacts) == 1 else None
        next_capture = propose_capture(decision, captures) if on.aim == "brightness" else None
    decided = _contacts(swept, on, decision)
    first = headline(decision, decided, TOLERANCE_REL, on.aim)
    then = decision_sentence(decision, captures.angles_deg, TOLERANCE_REL, next_render, next_capture, decided)
    told = [first, *_within(decision, decided), then, *_other_sentences(others, on.aim)]
    told.append(outside(decided, [sweep.design.indenter for sweep in swept], on.aim))
    # over several touches the curve is a share of the best
    scale = float(swept[0].values.mean()) if len(on.contacts) == 1 else 1.0
    return LightAngleDecision(
        objective=on.objective,
        aim=on.aim,
        headline=first,
        sentence=" ".join(told),
        tolerance_rel=TOLERANCE_REL,
        criterion=criterion,
        contacts=decided,
        **_choice(decision),
        captures=_deciding_captures(decision, captures, scale),
        **_certainty(decision),
        **_curves(decision, scale),
        next_render=_proposal(next_render, decided),
        next_capture=_proposal(next_capture, decided),
        other_objectives=tuple(_other(other) for other in others),
        notes=(*of_finger, *left_out, *_notes(swept, on, decision, captures)),
    )


def _choice(decision: AngleDecision) -> dict[str, Any]:
    """Return the fields that say which angle is chosen."""
    return {
        "angle_deg": decision.best_deg,
        "angle_simulation_only_deg": decision.best_simulation_only_deg,
        "verdict": decision.verdict,
        "at_range_end": decision.at_range_end,
        "tolerance_deg": decision.contacts.tolerance_deg,
        "angle_average_deg": decision.contacts.average_deg,
        "angle_worst_deg": decision.contacts.worst_deg,
        "contact_value": decision.contacts.relative,
    }


def _certainty(decision: AngleDecision) -> dict[str, Any]:
    """Return the fields that say how sure the decision is."""
    low_rel, discrepancy_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    return {
        "validated": decision.validated,
        "discrepancy_rel": discrepancy_rel,
        "discrepancy_95_rel": (low_rel, high_rel),
        "statement": _statement(decision.risk),
        "statement_simulation_only": _statement(decision.simulation_only),
    }


def _curves(decision: AngleDecision, scale: float) -> dict[str, Any]:
    """Return the fields that hold the curve over the angle, corrected by captures and by simulation only."""
    real = _band(decision.mean_rel, decision.sd_rel, scale)
    alone = _band(decision.simulation_only_mean_rel, decision.simulation_only_sd_rel, scale)
    names = ("mean", "low95", "high95")
    return {
        "grid_deg": decision.grid_deg,
        **dict(zip(names, real, strict=True)),
        **dict(zip((f"{name}_simulation_only" for name in names), alone, strict=True)),
    }


def _band(mean_rel: Floats, sd_rel: Floats, scale: float) -> tuple[Floats, Floats, Floats]:
    """Return a curve and the ends of its 95 % band."""
    half = _BAND_QUANTILE * sd_rel
    return scale * mean_rel, scale * (mean_rel - half), scale * (mean_rel + half)


def _contacts(sweeps: Sequence[LightAngleSweep], on: DecidedOn, decision: AngleDecision) -> tuple[DecidedContact, ...]:
    """Return each touch or place and what it loses."""
    losses = decision.contacts
    best = int(np.abs(decision.grid_deg - decision.best_deg).argmin())
    own = np.where(decision.choices, losses.relative, -np.inf).argmax(axis=1)
    is_touch = on.aim == "brightness"
    indenter = sweeps[0].design.indenter
    what = [(sweep.name, sweep.design.indenter) for sweep in sweeps]
    if not is_touch:  # facets all across the pad, which nothing touches
        what = [(sweeps[0].name, indenter.model_copy(update={"position_mm": mm})) for mm in on.places_mm]
    return tuple(
        DecidedContact(
            sweep=name,
            shape=touch.shape if is_touch else FACET,
            position_mm=touch.position_mm,
            across_mm=touch.across_mm if is_touch else 0.0,
            depth_mm=touch.depth_mm if is_touch else 0.0,
            weight_share=float(losses.weights[n]),
            best_deg=float(decision.grid_deg[own[n]]),
            loss_rel=max(0.0, 1.0 - float(losses.relative[n, best])),
            loss_95_rel=float(losses.loss_95_rel[n]),
        )
        for n, (name, touch) in enumerate(what)
    )


def _deciding_captures(decision: AngleDecision, captures: CaptureErrors, scale: float) -> tuple[DecidingCapture, ...]:
    """Return each capture with its error and its place beside the curve.

    The place is less the scale that the curve leaves open: the mean of t over the grid, or, for absolute ratios, the
    mean residual of the captures of one rig. Only the latter, which nobody knows, is taken off the error too.
    """
    if not captures.names:
        return ()
    level = decision.error_mean.mean(axis=1)
    expected = _at_captures(decision, captures, decision.error_mean - level[:, None])
    offset = level[captures.contact]
    if captures.scale_of is not None:
        for number in np.unique(captures.scale_of):
            members = captures.scale_of == number
            offset[members] = (captures.log_error - expected)[members].mean()
    log_shape = captures.log_error - offset
    log_error = captures.log_error if captures.scale_of is None else log_shape
    sd = np.sqrt(np.diag(decision.discrepancy.noise))
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
        cost_rel=other.cost_rel,
        statement=str(other),
    )


def _notes(
    sweeps: Sequence[LightAngleSweep], on: DecidedOn, decision: AngleDecision, captures: CaptureErrors
) -> tuple[str, ...]:
    """Say what the decision rests on."""
    sweep, light = sweeps[0], sweeps[0].design.light
    notes = [
        *dict.fromkeys(note for swept in sweeps for note in swept.notes),
        f"the panel sits at x, y, z = {', '.join(f'{p:g}' for p in light.position_mm)} mm and the mirror reflects "
        f"{100 * sweep.design.mirror.reflectance:.0f} %: the best angle depends on both and on the probe points",
        f"scatter of one value about the curve: {100 * max(c.noise_rel for c in decision.curves):.1f} % from "
        "render noise, which is averaged over the repeats. The scatter between paint draws is not averaged, "
        "because the real paint is one of them",
    ]
    if on.aim == "normal":
        notes.append(
            "the error of the sensed normal is computed on facets of the undeformed pad, by a map fitted at other "
            "places. The real finger is assumed to differ from it by as large a factor as it does from the simulated "
            "brightness"
        )
    exposed = next((swept.constraints for swept in sweeps if swept.constraints is not None), None)
    if exposed is not None:
        longer = float(np.interp(decision.best_deg, sweep.angles_deg, exposed.exposure_rel))
        notes.append(f"this angle needs an exposure {longer:.2g} times as long as the shortest of the sweep")
    if not decision.choices.all():
        notes.append("angles at which pixels clip or the panel does not fit were left out of the choice")
    notes.append(_note_on_error(captures))
    if captures.names and sweep.channels is None:
        notes.append(
            "the sweep was written by an older version without its channels, so red, green and blue count equally"
        )
    if len(on.contacts) > 1:
        notes.append(
            "the sim-to-real errors at two places share a part of their variance. How much has not been measured, so "
            "all shares from 10 to 90 % are taken to be equally likely. Errors from edges of shadows and from "
            "reflections are assumed to be the same at all places"
        )
    return tuple(notes)


def _note_on_error(captures: CaptureErrors) -> str:
    """Say what is assumed of the sim-to-real error, and how captures tell of it."""
    if not captures.names:
        return (
            f"no capture shows how far the finger differs from the simulation. Until one does, {_ERROR_CURVE}. The "
            f"size of this error is assumed ({_ASSUMED_SIZE}). The stated probabilities average over all these errors. "
            "If a finger has only one kind of error, the probabilities for this finger are mostly higher; only "
            "captures can show which errors a finger has"
        )
    compared = (
        "relative to the no-contact image of each capture, so an error that both images share is not seen. "
        "Such captures are assumed to show, with a probability of 1/2, almost none of the simulation's error and "
        "otherwise any share of it, so they never decide alone"
        if captures.scale_of is None
        else "by exposure and LED current, up to one unknown scale for each rig"
    )
    return (
        f"captures are compared {compared}. At other angles {_ERROR_CURVE}. The captures determine the size of this "
        f"error (prior: {_ASSUMED_SIZE}). Captures show the image beside the indenter, while the sweep evaluates its "
        "probe points"
    )


def headline(
    decision: AngleDecision, contacts: Sequence[DecidedContact], tolerance_rel: float, aim: Aim = "brightness"
) -> str:
    """Return the first sentence: where to mount the light, what is lost, and for which touches that is so.

    Parameters
    ----------
    decision : AngleDecision
    contacts : sequence of DecidedContact
        What was touched.
    tolerance_rel : float
        Loss that does not matter, which gives the tolerance of the angle.
    aim : str
        What was decided on.
    """
    only = f"For one place only ({_at(contacts[0])}), " if len(contacts) == 1 else ""
    if decision.at_range_end:
        return (
            f"{only or 'For this finger, '}the best angle found, {decision.best_deg:.0f} deg, is the end of the sweep: "
            "simulate a wider sweep before the light is mounted."
        )
    is_decided = decision.verdict in {"decided", "tie"}
    now = "" if is_decided else f"{'for' if only else 'For'} now, "
    angle = f"{only}{now}{'mount' if only or now else 'Mount'} the light at {mounting_angle(decision)} deg"
    simulated = "" if decision.validated else "as simulated, "
    best = f"{decision.best_deg:.0f} deg"
    if only:
        return (
            f"{angle}: {simulated}the touch is expected to be at most {percent(tolerance_rel)} less bright than at "
            f"{best}."
        )
    angle = f"{angle}. At {best}, {simulated}"
    losses, span = np.array([contact.loss_rel for contact in contacts]), span_of(contacts)
    weights = [contact.weight_share for contact in contacts]
    if aim == "normal":
        above = above_best(losses)
        return (
            f"{angle}at each of the {span} the error of the sensed normal is at most {percent(above.max())} larger "
            f"than at that place's best angle, and {percent(float(above @ weights))} on average over them."
        )
    touched = f"the touch at each of the {span}" if " places " in span else f"each of the {span}"
    return (
        f"{angle}{touched} is at most {percent(losses.max())} less bright than at its own best angle, and "
        f"{percent(float(losses @ weights))} on average over them."
    )


def above_best(loss_rel: Floats) -> Floats:
    """Return by how much an error is above its best, from the loss of its inverse."""
    return np.asarray(1.0 / (1.0 - loss_rel) - 1.0)


def _within(decision: AngleDecision, contacts: Sequence[DecidedContact]) -> list[str]:
    """Return what the angles within the tolerance cost, which the first sentence of one place says itself."""
    if decision.at_range_end or len(contacts) == 1:
        return []
    return [f"Angles within this tolerance are expected to cost at most {percent(TOLERANCE_REL)} more."]


def mounting_angle(decision: AngleDecision) -> str:
    """Return the angle with the lesser of the two sides of its tolerance, as in '33 ± 6'."""
    low, high = decision.contacts.tolerance_deg
    side = min(decision.best_deg - low, high - decision.best_deg)
    return f"{decision.best_deg:.0f} \u00b1 {side:.0f}"


def span_of(contacts: Sequence[DecidedContact]) -> str:
    """Return how many touches there are, and where."""
    places = sorted({contact.position_mm for contact in contacts})
    along = f"from {places[0]:g} to {places[-1]:g} mm" if len(places) > 1 else f"at {places[0]:g} mm"
    if len(places) == len(contacts):
        return f"{len(contacts)} places {along}"
    return f"{len(contacts)} touches {along}"


def outside(contacts: Sequence[DecidedContact], indenters: Sequence[Indenter], aim: Aim = "brightness") -> str:
    """Return what the decision says nothing about.

    Parameters
    ----------
    contacts : sequence of DecidedContact
        What was touched.
    indenters : sequence of Indenter
        That touched it.
    aim : str
        What was decided on.
    """
    places = sorted({contact.position_mm for contact in contacts})
    if aim == "normal":
        return (
            f"The answer holds for facets of the undeformed pad at {places[0]:g} to {places[-1]:g} mm, tilted by up to "
            "20 deg; shadows of the object that is touched are left out."
        )
    across = sorted({contact.across_mm for contact in contacts})
    depths = sorted({contact.depth_mm for contact in contacts})
    shapes = sorted({contact.shape for contact in contacts})
    radii = sorted({indenter.radius_mm for indenter in indenters})
    wide = f"{radii[0]:g} mm" if len(radii) == 1 else f"{radii[0]:g} to {radii[-1]:g} mm"
    size = f" of {wide} radius" if shapes in (["cylinder"], ["ball"]) else ""
    along = f"{places[0]:g} to {places[-1]:g} mm" if len(places) > 1 else f"{places[0]:g} mm"
    away = f"{across[0]:g} to {across[-1]:g} mm" if len(across) > 1 else f"{across[0]:g} mm"
    beside = "on the middle line" if across == [0.0] else f"{away} from the middle line"
    deep = f"{depths[0]:g} mm" if len(depths) == 1 else f"{depths[0]:g} to {depths[-1]:g} mm"
    return (
        f"The answer holds for touches at {along} along the pad, {beside}, {deep} deep, by a {' or '.join(shapes)}"
        f"{size}; other places, depths and objects were not simulated."
    )


def decision_sentence(
    decision: AngleDecision,
    captures_deg: Floats,
    tolerance_rel: float,
    next_render: Proposal | None = None,
    next_capture: Proposal | None = None,
    contacts: Sequence[DecidedContact] = (),
) -> str:
    """Return what follows the first sentence: how sure the choice is, why, and what to do next.

    Parameters
    ----------
    decision : AngleDecision
    captures_deg : ndarray, shape (N,)
        Angles of the captures in it; none: not validated.
    tolerance_rel : float
        Relative loss that does not matter.
    next_render, next_capture : Proposal, optional
        Said where the verdict asks for it.
    contacts : sequence of DecidedContact
        Of several, the one to capture is named.

    Returns
    -------
    str
    """
    parts = [_ground(decision, captures_deg), _odds(decision, tolerance_rel)]
    if decision.verdict == "tie":
        ranges = " or ".join(f"{low:.0f} to {high:.0f} deg" for low, high in decision.risk.equivalent_deg)
        parts.append(f"Any angle from {ranges} is suitable.")
    if decision.verdict == "undecided" and not decision.at_range_end:
        parts.append("The renders are still too noisy to choose; more repeats or samples will help.")
        if next_render is not None:
            parts.append(f"Render {next_render.angle_deg:g} deg next.")
    if next_capture is not None and (decision.verdict == "needs captures" or not captures_deg.size):
        where = f", {_at(contacts[next_capture.contact])}" if len(contacts) > 1 else ""
        parts.append(f"Capture next with the light at {next_capture.angle_deg:g} deg{where}.")
    return " ".join(parts)


def _other_sentences(others: Sequence[OtherOptimum], aim: Aim) -> list[str]:
    """Say what each objective that disagrees would have chosen, and what that costs."""
    told = []
    for other in others:
        if other.disagrees:
            cost = (
                f"with {percent(other.cost_rel)} less brightness"
                if aim == "brightness"
                else f"where the error of the normal is {percent(float(above_best(np.array(other.cost_rel))))} larger"
            )
            name = f"{other.name[:1].upper()}{other.name[1:]}"
            told.append(f"{name} would have chosen {other.best_deg:.0f} deg, {cost}.")
    return told


def _ground(decision: AngleDecision, captures_deg: Floats) -> str:
    """Say what the choice rests on: captures, or an assumed sim-to-real error."""
    low_rel, amplitude_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    if not captures_deg.size:
        return (
            "This is the simulation's answer; no capture has checked it, and it stays undecided until one does. It "
            "is assumed that "
            f"the real curve over the angle may be shifted by some {MOVED_SD_DEG:g} deg and be off by "
            f"{percent(amplitude_rel)} (95 %: {percent(low_rel)} to {percent(high_rel)}) at each angle."
        )
    angles = [f"{angle:.0f}" for angle in sorted(set(captures_deg.tolist()))]
    listed = " and ".join([*([", ".join(angles[:-1])] if len(angles) > 1 else []), angles[-1]])
    number = "A capture" if captures_deg.size == 1 else f"{captures_deg.size} captures"
    enough = "" if decision.verdict in {"decided", "tie"} else ", which is not enough to decide"
    return (
        f"{number} at {listed} deg {'is' if captures_deg.size == 1 else 'are'} included{enough}: the "
        f"simulation is off by some {percent(amplitude_rel)} at an angle. Without "
        f"{'it' if captures_deg.size == 1 else 'them'} the choice would be "
        f"{decision.best_simulation_only_deg:.0f} deg."
    )


def _odds(decision: AngleDecision, tolerance_rel: float) -> str:
    """Say what may be lost against another angle, and with what probability."""
    risk = decision.risk
    return (
        f"With a probability of {risk.p_within_tolerance:.2f} no other angle is better by more than "
        f"{percent(tolerance_rel)}, with {CONFIDENCE:.2f} none by more than {percent(risk.regret_95_rel)}, and with "
        f"{risk.p_within_5deg:.2f} the best angle lies within {NEARBY_DEG:.0f} deg."
    )


def _at(contact: DecidedContact) -> str:
    """Return where the pad is touched."""
    beside = f" and {contact.across_mm:g} mm beside its middle" if contact.across_mm else ""
    return f"{contact.position_mm:g} mm from the base{beside}"
