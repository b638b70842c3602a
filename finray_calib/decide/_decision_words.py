"""A decision on the light angle in plain sentences: what to do first, then what is lost, and how sure that is."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas import DecidedContact, Indenter
from finray_calib.decide._light_angle import CONFIDENCE, NEARBY_DEG, AngleDecision, Criterion
from finray_calib.decide._next_observation import Proposal
from finray_calib.decide._other_objectives import OtherOptimum

Floats = NDArray[np.float64]


def headline(
    decision: AngleDecision, contacts: Sequence[DecidedContact], criterion: Criterion, tolerance_rel: float
) -> str:
    """Return the first sentence: where to mount the light, what is lost, and for which touches that is so.

    Parameters
    ----------
    decision : AngleDecision
    contacts : sequence of DecidedContact
        What was touched.
    criterion : str
        What was minimised over the touches.
    tolerance_rel : float
        Loss that does not matter, which gives the tolerance of the angle.
    """
    one = f"For one place only, {_at(contacts[0])}: " if len(contacts) == 1 else ""
    if decision.at_range_end:
        start = "The" if not one else f"{one}the"
        return (
            f"{start} best angle found, {decision.best_deg:.0f} deg, is the end of the sweep, so that a better one may "
            "lie beyond it: simulate a wider sweep before the light is mounted."
        )
    verb = "mount" if one else "Mount"
    angle = f"{one}{verb} the light at {mounting_angle(decision)} deg"
    if one:
        return (
            f"{angle}; between these angles the touch is at most {percent(tolerance_rel)} less bright than at the best."
        )
    losses = [contact.loss_rel for contact in contacts]
    worst = contacts[int(np.argmax(losses))]
    average = float(np.dot([contact.weight_share for contact in contacts], losses))
    span, most = span_of(contacts), percent(max(losses))
    if criterion == "worst":
        return (
            f"{angle}: the brightness of the touch is at most {most} below the best at any of the {span}, and "
            f"{percent(average)} on average."
        )
    return (
        f"{angle}: the brightness of the touch is on average {percent(average)} below the best at the {span}, and at "
        f"most {most} ({_at(worst)})."
    )


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


def outside(contacts: Sequence[DecidedContact], indenter: Indenter) -> str:
    """Return what the decision says nothing about.

    Parameters
    ----------
    contacts : sequence of DecidedContact
        What was touched.
    indenter : Indenter
        Of the first of them.
    """
    places = sorted({contact.position_mm for contact in contacts})
    across = sorted({contact.across_mm for contact in contacts})
    depths = sorted({contact.depth_mm for contact in contacts})
    shapes = sorted({contact.shape for contact in contacts})
    size = f" of {indenter.radius_mm:g} mm radius" if shapes in (["cylinder"], ["ball"]) else ""
    along = f"{places[0]:g} to {places[-1]:g} mm" if len(places) > 1 else f"{places[0]:g} mm"
    beside = "on the middle line" if across == [0.0] else f"{across[0]:g} to {across[-1]:g} mm from the middle line"
    deep = f"{depths[0]:g} mm" if len(depths) == 1 else f"{depths[0]:g} to {depths[-1]:g} mm"
    return (
        f"It holds for touches at {along} along the pad, {beside}, {deep} deep, by a {' or '.join(shapes)}{size}; "
        "other places, depths and objects were not simulated."
    )


def decision_sentence(
    decision: AngleDecision,
    captures_deg: Floats,
    tolerance_rel: float,
    next_render: Proposal | None = None,
    next_capture: Proposal | None = None,
    others: Sequence[OtherOptimum] = (),
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
    others : sequence of OtherOptimum
        Other objectives; those that disagree are named.
    contacts : sequence of DecidedContact
        Of several, the one to capture is named.

    Returns
    -------
    str
    """
    parts = [_ground(decision, captures_deg), _odds(decision, tolerance_rel)]
    if decision.verdict == "tie":
        ranges = " or ".join(f"{low:.0f} to {high:.0f} deg" for low, high in decision.risk.equivalent_deg)
        parts.append(f"Any angle from {ranges} will do.")
    if decision.verdict == "undecided" and not decision.at_range_end:
        parts.append("The renders are still too noisy to choose; more repeats or samples will help.")
        if next_render is not None:
            parts.append(f"Render {next_render.angle_deg:.0f} deg next.")
    if next_capture is not None and (decision.verdict == "needs captures" or not captures_deg.size):
        where = f", {_at(contacts[next_capture.contact])}" if len(contacts) > 1 else ""
        parts.append(f"Capture next with the light at {next_capture.angle_deg:.0f} deg{where}.")
    parts += [
        f"{other.name[:1].upper()}{other.name[1:]} would choose {other.best_deg:.0f} deg and loses "
        f"{percent(other.loss_rel)} here."
        for other in others
        if other.disagrees
    ]
    return " ".join(parts)


def _ground(decision: AngleDecision, captures_deg: Floats) -> str:
    """Say what the choice rests on: captures, or an assumed sim-to-real error."""
    low_rel, amplitude_rel, high_rel = decision.discrepancy.amplitude_quantiles_rel
    if not captures_deg.size:
        return (
            "So says the simulation; no capture has checked it, and it is not decided before one does. An error of "
            f"{percent(amplitude_rel)} (95 %: {percent(low_rel)} to {percent(high_rel)}) at each angle is assumed."
        )
    angles = [f"{angle:.0f}" for angle in sorted(set(captures_deg.tolist()))]
    listed = " and ".join([*([", ".join(angles[:-1])] if len(angles) > 1 else []), angles[-1]])
    number = "A capture" if captures_deg.size == 1 else f"{captures_deg.size} captures"
    enough = "" if decision.verdict in {"decided", "tie"} else ", which is not enough to decide"
    return (
        f"{number} at {listed} deg {'is' if captures_deg.size == 1 else 'are'} in this{enough}: the simulation is off "
        f"by some {percent(amplitude_rel)} at an angle. Without them it would be "
        f"{decision.best_simulation_only_deg:.0f} deg."
    )


def _odds(decision: AngleDecision, tolerance_rel: float) -> str:
    """Say what may be lost against another angle, and with what probability."""
    risk = decision.risk
    return (
        f"Another angle may be better by {percent(risk.expected_regret_rel)} on average and by at most "
        f"{percent(risk.regret_95_rel)} with {percent(CONFIDENCE)} probability; that it is better by no more than "
        f"{percent(tolerance_rel)} has a probability of {risk.p_within_tolerance:.2f}, and that the best angle lies "
        f"within {NEARBY_DEG:.0f} deg one of {risk.p_within_5deg:.2f}."
    )


def _at(contact: DecidedContact) -> str:
    """Return where the pad is touched."""
    beside = f" and {contact.across_mm:g} mm beside its middle" if contact.across_mm else ""
    return f"{contact.position_mm:g} mm from the base{beside}"


def percent(fraction: float) -> str:
    """Return a fraction as per cent with two significant digits."""
    return f"{float(f'{100 * fraction:.2g}'):g} %"
