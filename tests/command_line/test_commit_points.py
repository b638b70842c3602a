"""Verbs of several files, killed at every call that touches a file: a rerun completes, and nothing is harmed or left.

The whole, with every verb and with errors of the system, is ``python -m benchmarks.commit_points``.
"""

from pathlib import Path

import pytest

from tests.command_line.verb_faults import Command, Tries, replaying
from tests.documentation.example_records import example_results

DECIDE = Command(
    "decide {lab}/sweep.json --photometric-error {lab}/report.json --out {{o}}/d.json",
    "d.json",
    ("finray_calib.decide._decision_record:decide", "finray_calib.reports._decision_page:decision_page"),
)
FIT = Command(
    "fit {lab}/bands.json --out {{o}}/red.paint.json --report {{e}}/red.html",
    "red.paint.json",
    ("finray_calib.fit._paint_calibration:calibrate_paint", "finray_calib.reports._fit_page:paint_report"),
)
RADIOMETRY = Command(
    "radiometry {lab}/session --pixels --out {{o}}/red.bands.json",
    "red.bands.json",
    (
        "finray_calib.radiometry._session_steps:session_steps",
        "finray_calib.radiometry._band_signals:bands_of_steps",
        "finray_calib.radiometry._pixel_signals:pixel_signals",
    ),
)


@pytest.mark.parametrize("command", [DECIDE, FIT, RADIOMETRY], ids=["decide", "fit --report", "radiometry --pixels"])
def test_killed_at_any_call_nothing_is_half_stored_and_a_rerun_completes(lab: Path, tmp_path, monkeypatch, command):
    monkeypatch.setattr("os.fsync", lambda handle: None)  # a point as well, but no power fails here
    monkeypatch.setattr(
        "finray_calib.fit._paint_calibration.calibrate_paint", lambda *_: example_results().paints["red"].calibration
    )
    there = Command(command.words.format(lab=lab), command.commit, command.replayed)
    with replaying(there.replayed):
        ended = Tries(there, tmp_path).try_all([None], every=2)
    assert ended["kill, half set named"] >= 1  # so that a rerun had something to put right
    assert ended["kill, whole"] >= 1
