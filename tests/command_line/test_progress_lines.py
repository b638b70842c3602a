"""How far a long command is, where its output goes to a file."""

import itertools

import pytest

from finray_calib.cli import _output as options


@pytest.mark.parametrize(("seconds_each", "lines"), [(1.0, 0), (5.0, 2), (30.0, 9)])
def test_a_log_file_gets_a_line_now_and_then(monkeypatch, capsys, seconds_each, lines):
    clock = itertools.count(step=seconds_each)
    monkeypatch.setattr(options.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(options, "LOG_INTERVAL_S", 20.0)
    with options.progress_bar("simulate") as progress:
        for done in range(1, 10):
            progress(done, 9, "pressed")
    told = capsys.readouterr().err.splitlines()
    assert len(told) == lines
    assert all(line.startswith("simulate: pressed (") and line.endswith(" of 9)") for line in told)
