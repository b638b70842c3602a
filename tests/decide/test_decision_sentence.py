"""The sentences of a decision: what to do first, then how sure that is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import DecidedContact, Indenter
from finray_calib.decide._decision_record import (
    _ASSUMED_SIZE,
    Proposal,
    _other_sentences,
    decision_sentence,
    headline,
    outside,
)
from finray_calib.decide._light_angle import AngleRisk
from finray_calib.decide._sim_to_real import PRIOR_ERROR_LOG_SD, PRIOR_ERROR_REL
from finray_calib.decide._swept_contacts import OtherOptimum

NONE = np.empty(0)
RISK = AngleRisk(0.5, 0.0304, 0.0161, (), 0.96)


def decision(best_deg=30.0, verdict="needs captures", risk=RISK, at_range_end=False, validated=False):
    """Only what a sentence reads."""
    return SimpleNamespace(
        validated=validated,
        best_deg=best_deg,
        best_simulation_only_deg=9.0,
        risk=risk,
        verdict=verdict,
        at_range_end=at_range_end,
        contacts=SimpleNamespace(tolerance_deg=(best_deg - 6, best_deg + 9)),
        discrepancy=SimpleNamespace(amplitude_quantiles_rel=(0.04, 0.1, 0.3)),
    )


def touches(*losses, across_mm=0.0, depth_mm=1.5):
    return [
        DecidedContact(
            sweep=f"place {n}",
            shape="cylinder",
            position_mm=8.0 + 4 * n,
            across_mm=across_mm,
            depth_mm=depth_mm,
            weight_share=1 / len(losses),
            best_deg=30.0,
            loss_rel=loss,
            loss_95_rel=0.3,
        )
        for n, loss in enumerate(losses)
    ]


def test_the_first_sentence_says_what_to_do_and_for_which_touches():
    found = headline(decision(33.0), touches(0.02, 0.1, 0.06), 0.02)
    assert found == (
        "For now, mount the light at 33 \u00b1 6 deg. At 33 deg, as simulated, the touch at each of the 3 places from "
        "8 to 16 mm is at most 10 % less bright than at its own best angle, and 6 % on average over them."
    )
    found = headline(decision(33.0, validated=True), touches(0.02, 0.1, 0.06), 0.02)
    assert "6 deg. At 33 deg, the touch at each of the 3 places" in found
    pair = [touches(0.0, 0.0)[0], touches(0.05, 0.05, depth_mm=3.0)[0]]
    assert (
        "as simulated, each of the 2 touches at 8 mm is at most 5 % less bright than at its own best angle, and 2.5 % "
        "on average over them."
    ) in headline(decision(), pair, 0.02)


def test_one_sweep_is_for_one_place_only():
    found = headline(decision(44.0), touches(0.0, across_mm=3.0), 0.02)
    assert found == (
        "For one place only (8 mm from the base and 3 mm beside its middle), for now, mount the light at 44 \u00b1 6 "
        "deg: as simulated, the touch is expected to be at most 2 % less bright than at 44 deg."
    )


@pytest.mark.parametrize("losses", [(0.0,), (0.0, 0.1)])
def test_an_angle_at_the_end_of_the_sweep_is_not_to_be_mounted(losses):
    found = headline(decision(90.0, "undecided", at_range_end=True), touches(*losses), 0.02)
    assert "the best angle found, 90 deg, is the end of the sweep: simulate a wider sweep before" in found
    assert found.startswith("For one place only (8 mm" if len(losses) == 1 else "For this finger, ")


def test_what_lies_outside_is_said():
    assert outside(touches(0.0, 0.0), [Indenter()] * 2) == (
        "The answer holds for touches at 8 to 12 mm along the pad, on the middle line, 1.5 mm deep, by a cylinder of "
        "10 mm radius; "
        "other places, depths and objects were not simulated."
    )
    assert "along the pad, 3 mm from the middle line, 1.5" in outside(touches(0.0, across_mm=3.0), [Indenter()])
    wide = [*touches(0.0), *touches(0.0, across_mm=3.0, depth_mm=3.0)]
    assert "at 8 mm along the pad, 0 to 3 mm from the middle line, 1.5 to 3 mm deep" in outside(wide, [Indenter()] * 2)
    sizes = [Indenter(radius_mm=radius_mm) for radius_mm in (8.0, 4.0)]
    assert "by a cylinder of 4 to 8 mm radius; other places" in outside(touches(0.0, 0.0), sizes)


def test_what_is_assumed_of_the_error_is_what_the_prior_says():
    low, high = 100 * PRIOR_ERROR_REL * np.exp([-1.96 * PRIOR_ERROR_LOG_SD, 1.96 * PRIOR_ERROR_LOG_SD])
    told = f"{100 * PRIOR_ERROR_REL:.2g} %, with 95 % probability between {low:.1f} % and {high:.0f} %"
    assert told == _ASSUMED_SIZE.split(";")[0]


def test_without_captures_nothing_is_decided_and_the_next_one_is_named():
    found = decision_sentence(decision(), NONE, 0.02, None, Proposal(70.0, 0.01, 0.02))
    assert found == (
        "This is the simulation's answer; no capture has checked it, and it stays undecided until one does. It is "
        "assumed that the real curve over the angle may be shifted by some 5 deg and be off by 10 % (95 %: 4 % to "
        "30 %) at each angle. With a probability of 0.96 no other angle is better by more than 2 %, with 0.95 none by "
        "more than 1.6 %, and with 0.50 "
        "the best angle lies within 5 deg. Capture next with the light at 70 deg."
    )


def test_of_several_places_the_one_to_capture_is_named():
    proposal = Proposal(70.0, 0.01, 0.02, contact=1)
    found = decision_sentence(decision(), NONE, 0.02, None, proposal, touches(0.0, 0.1))
    assert found.endswith("Capture next with the light at 70 deg, 12 mm from the base.")


def test_captures_are_named_with_what_they_changed():
    tie = AngleRisk(0.5, 0.000374, 0.0012, ((3.0, 18.0),), 0.99)
    found = decision_sentence(decision(5.0, "tie", tie, validated=True), np.array([70.0, 10, 40]), 0.025)
    assert found.startswith(
        "3 captures at 10, 40 and 70 deg are included: the simulation is off by some 10 % at an angle. Without them "
        "the choice would be 9 deg."
    )
    assert found.endswith("Any angle from 3 to 18 deg is suitable.")
    found = decision_sentence(decision(20.0, validated=True), np.array([30.0]), 0.02, None, Proposal(70.0, 0.01, 0.02))
    assert found.startswith("A capture at 30 deg is included, which is not enough to decide: the simulation is off")
    assert found.endswith("Capture next with the light at 70 deg.")


def test_what_others_would_have_chosen_is_said_with_its_cost():
    other = OtherOptimum("normal error", "deg", 55.0, False, (2.0, 3.0), 0.31, 0.2, 0.4, True, 0.2)
    agrees = replace(other, disagrees=False)
    assert _other_sentences([other, agrees], "brightness") == [
        "Normal error would have chosen 55 deg, with 20 % less brightness."
    ]
    # an inverse that is 20 % less is an error that is a quarter larger
    assert _other_sentences([other], "normal") == [
        "Normal error would have chosen 55 deg, where the error of the normal is 25 % larger."
    ]


def test_a_decision_on_the_normal_tells_the_error_and_its_places():
    found = headline(decision(-25.0), touches(0.02, 0.2), 0.02, "normal")
    assert found == (
        "For now, mount the light at -25 \u00b1 6 deg. At -25 deg, as simulated, at each of the 2 places from 8 to "
        "12 mm the error of the sensed normal is at most 25 % larger than at that place's best angle, and "
        "14 % on average over them."
    )
    assert outside(touches(0.0, 0.0), [Indenter()], "normal") == (
        "The answer holds for facets of the undeformed pad at 8 to 12 mm, tilted by up to 20 deg; shadows of the "
        "object that is touched are left out."
    )


def test_noisy_renders_ask_for_more_of_them():
    found = decision_sentence(decision(40.0, "undecided"), NONE, 0.02, Proposal(45.0, 0.01, 0.02))
    assert found.endswith(
        "The renders are still too noisy to choose; more repeats or samples will help. Render 45 deg next."
    )
    # a render inside a sweep that is too narrow is not asked for
    ended = decision_sentence(decision(90.0, "undecided", at_range_end=True), NONE, 0.02, Proposal(45.0, 0.01, 0.02))
    assert "Render" not in ended
