"""From a stored sweep and reports to the stored decision."""

import numpy as np
import pytest

from data_schemas.errors import DecideError
from finray_calib.compare.comparison_record import compare_press
from finray_calib.decide.decision_record import decide
from tests.command_line.records import capture_of
from tests.command_line.records import press as press_record
from tests.command_line.records import sweep as sweep_record


def report(error_rel, sd_rel=0.0):
    plain = compare_press(press_record(), capture_of(press_record(), 50.0), 1)
    return plain.model_copy(update={"objective_error_rel": error_rel, "objective_error_sd_rel": sd_rel})


def test_reports_enter_as_a_root_mean_square():
    sweep = sweep_record()
    assert decide(sweep, [], 1).discrepancy_rel is None
    assert not decide(sweep, [], 1).validated
    both = decide(sweep, [report(0.03), report(-0.04, 0.03)], 1)
    assert both.discrepancy_rel == pytest.approx(np.sqrt((0.03**2 + 0.04**2 + 0.03**2) / 2))
    assert both.validated
    assert (both.high95 - both.low95 > both.high95_simulation_only - both.low95_simulation_only).all()


def test_report_on_encoded_values_cannot_drive_a_decision():
    with pytest.raises(DecideError, match="carries no brightness error"):
        decide(sweep_record(), [report(None, None)], 1)
