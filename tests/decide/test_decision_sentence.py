from types import SimpleNamespace

import numpy as np

from finray_calib.decide._decision_record import OtherOptimum, decision_sentence
from finray_calib.decide._light_angle import AngleRisk, Proposal

NONE = np.empty(0)


ALONE = AngleRisk(0.97, 0.0001, 0.003, (), 1.0)


def decision(best_deg, risk, verdict, at_range_end=False, alone=ALONE, alone_deg=0.0, validated=False):
    """Only what a sentence reads."""
    return SimpleNamespace(
        validated=validated,
        best_deg=best_deg,
        best_simulation_only_deg=alone_deg,
        risk=risk,
        simulation_only=alone,
        verdict=verdict,
        at_range_end=at_range_end,
        discrepancy=SimpleNamespace(amplitude_quantiles_rel=(0.04, 0.1, 0.3)),
    )


def test_a_decision_reads_as_one_sentence():
    risk = AngleRisk(0.93, 0.00304, 0.0161, ((27.0, 34.0),), 0.96)
    found = decision_sentence(decision(30.0, risk, "model-limited"), NONE, 0.02, None, Proposal(70.0, 0.01, 0.02))
    assert found == (
        "30 deg: within 2 % of the best with probability 0.96, true optimum within 5 deg with 0.93; expected loss "
        "0.3 %, at most 1.6 % with 95 % probability; 27-34 deg are equivalent within 2 %; not decided, only captures "
        "can tell how far the finger differs from the simulation; not validated against a capture, a sim-to-real error "
        "of 10 % (95 %: 4 % to 30 %) is assumed; if the simulation were exact, at most 0.3 %; next: capture at 70 deg."
    )


def test_captures_are_shown_beside_what_the_simulation_alone_says():
    risk = AngleRisk(0.5, 0.000374, 0.0012, ((3.0, 8.0), (60.0, 75.0)), 0.99)
    alone = AngleRisk(0.9, 0.0001, 0.00044, (), 1.0)
    found = decision_sentence(decision(5.0, risk, "tie", False, alone, 9.0, True), np.array([70.0, 10, 40]), 0.025)
    assert found == (
        "5 deg: within 2.5 % of the best with probability 0.99, true optimum within 5 deg with 0.50; expected loss "
        "0.037 %, at most 0.12 % with 95 % probability; 3-8 deg and 60-75 deg are equivalent within 2.5 %; a tie, any "
        "of these angles will do; 3 captures at 10, 40 and 70 deg included, with a sim-to-real error of 10 %; by "
        "simulation alone 9 deg, at most 0.044 %."
    )


def test_a_model_limited_decision_asks_for_a_capture_and_names_who_disagrees():
    risk = AngleRisk(0.5, 0.01, 0.03, (), 0.85)
    other = OtherOptimum("normal error", "deg", 55.0, 2.0, 3.0, 0.31, 0.2, 0.4, True)
    found = decision_sentence(
        decision(20.0, risk, "model-limited", False, risk, 20.0, True),
        np.array([30.0]),
        0.02,
        Proposal(45.0, 0.01, 0.02),
        Proposal(70.0, 0.01, 0.02),
        [other],
    )
    assert found.endswith(
        "so more renders will not decide; a capture at 30 deg included, with a sim-to-real error of 10 %; by "
        "simulation alone 20 deg, at most 3 %; next: capture at 70 deg; normal error would choose 55 deg and "
        "loses 31 % here."
    )


def test_an_undecided_one_asks_for_a_render():
    risk = AngleRisk(0.4, 0.05, 0.1, (), 0.3)
    found = decision_sentence(decision(40.0, risk, "undecided"), NONE, 0.02, Proposal(45.0, 0.01, 0.02))
    assert "undecided, more renders are needed; not validated against a capture, a sim-to-real error of 10 %" in found
    assert found.endswith("next: render 45 deg.")


def test_what_is_missing_is_said():
    risk = AngleRisk(0.4, 0.05, 0.999, (), 0.3)
    # a render inside a sweep that is too narrow is not asked for
    next_render = Proposal(85.0, 0.01, 0.02)
    assert decision_sentence(decision(90.0, risk, "undecided", True), NONE, 0.02, next_render) == (
        "90 deg: within 2 % of the best with probability 0.30, true optimum within 5 deg with 0.40; expected loss 5 %, "
        "at most 100 % with 95 % probability; no angle is within 2 % of the best with 95 % probability; the best angle "
        "is at the end of the sweep, so the optimum may lie outside it: widen the sweep; not validated against a "
        "capture, a sim-to-real error of 10 % (95 %: 4 % to 30 %) is assumed; if the simulation were exact, at most "
        "0.3 %."
    )
