from finray_calib.decide.angle_risk import AngleRisk
from finray_calib.decide.decision_sentence import decision_sentence


def test_a_decision_reads_as_one_sentence():
    risk = AngleRisk(0.93, 0.00304, 0.0161, ((27.0, 34.0),))
    assert decision_sentence(30.0, risk, "decided", False, 0.02, None) == (
        "30 deg: true optimum within 5 deg with probability 0.93; expected loss 0.3 %, at most 1.6 % with 95 % "
        "probability; 27-34 deg are equivalent within 2 %; not validated against a capture."
    )


def test_several_intervals_and_small_numbers():
    risk = AngleRisk(0.5, 0.000374, 0.0012, ((3.0, 8.0), (60.0, 75.0)))
    assert decision_sentence(5.0, risk, "tie", False, 0.025, 0.1) == (
        "5 deg: true optimum within 5 deg with probability 0.50; expected loss 0.037 %, at most 0.12 % with 95 % "
        "probability; 3-8 deg and 60-75 deg are equivalent within 2.5 %; a tie, any of these angles will do; a "
        "sim-to-real error of 10 % is included."
    )


def test_what_is_missing_is_said():
    risk = AngleRisk(0.4, 0.05, 0.999, ())
    assert decision_sentence(90.0, risk, "undecided", True, 0.02, None) == (
        "90 deg: true optimum within 5 deg with probability 0.40; expected loss 5 %, at most 100 % with 95 % "
        "probability; no angle is within 2 % of the best with 95 % probability; the best angle is at the end of the "
        "sweep, so the optimum may lie outside it: widen the sweep; not validated against a capture."
    )
