"""The journal on a disk that is full, in a folder that is taken, and before anything began."""

import json
import os
import threading
import time
from pathlib import Path

import pytest

from data_schemas import CaptureError, LostError, UnsafeError
from rigs import SystemClock
from rigs.capture import JOURNAL_NAME, read_journal
from rigs.capture import _journal as journal_module
from rigs.capture._journal import Journal, fault_notes, faults_noted
from rigs.transports import Fault, repeated, report_fault


def full_disk(handle: object) -> None:
    raise OSError(28, "No space left on device")


def test_full_disk_is_a_capture_error_that_tells_the_way_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Journal(tmp_path, SystemClock()) as journal:
        journal.append("start")
        with monkeypatch.context() as patch:
            patch.setattr(journal_module.os, "fsync", full_disk)
            with pytest.raises(CaptureError, match=r"journal\.jsonl: cannot be written \(No space left.*--resume"):
                journal.append("frame")


def test_disk_that_hangs_keeps_nobody_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A network folder whose server is gone neither takes a line nor refuses it; a light may be on meanwhile."""
    back = threading.Event()
    with Journal(tmp_path, SystemClock()) as journal:
        journal.append("start")
        with monkeypatch.context() as patch:
            patch.setattr(journal_module, "DISK_WITHIN_S", 0.2)
            patch.setattr(journal_module.os, "fsync", lambda handle: back.wait(30.0))
            began_s = time.monotonic()
            with pytest.raises(CaptureError, match=r"journal\.jsonl: the disk does not respond.* 0\.2 s.*--resume"):
                journal.append("frame")
            assert time.monotonic() - began_s < 5.0
        back.set()
    assert [line["event"] for line in read_journal(tmp_path)] == ["start", "frame", "stop"]
    with pytest.raises(CaptureError, match="is closed"):  # by a thread that the disk held back
        journal.append("frame")


def test_what_ended_the_capture_is_not_hidden_by_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A light that is not confirmed off is told, whatever the disk says."""
    journal = Journal(tmp_path, SystemClock())
    journal.append("start")

    def capture() -> None:
        with journal:
            monkeypatch.setattr(journal_module.os, "fsync", full_disk)
            raise UnsafeError("laser: NOT CONFIRMED OFF")

    with pytest.raises(UnsafeError, match="NOT CONFIRMED OFF"):
        capture()


def test_capture_that_ends_before_its_first_line_leaves_no_journal(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="early"), Journal(tmp_path, SystemClock()):
        raise ValueError("early")
    assert not (tmp_path / JOURNAL_NAME).exists()
    with Journal(tmp_path, SystemClock()) as journal:
        journal.append("start")
    assert [line["event"] for line in read_journal(tmp_path)] == ["start", "stop"]


def test_folder_that_is_taken_meanwhile_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The other capture gives its journal its name between our look and our lock: ours must not replace it."""
    flock = journal_module.fcntl.flock

    def late(handle: object, operation: int) -> None:
        (tmp_path / JOURNAL_NAME).write_text(json.dumps({"event": "start"}) + "\n")
        flock(handle, operation)  # type: ignore[arg-type]

    monkeypatch.setattr(journal_module.fcntl, "flock", late)
    with pytest.raises(CaptureError, match="exists already, so another capture writes into this folder"):
        Journal(tmp_path, SystemClock())
    assert read_journal(tmp_path) == [{"event": "start"}]


def test_every_line_is_on_the_disk_before_the_next_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsync, synced = os.fsync, []

    def counted(handle: int) -> None:
        synced.append(len((tmp_path / JOURNAL_NAME).read_text()) if (tmp_path / JOURNAL_NAME).exists() else 0)
        fsync(handle)

    monkeypatch.setattr(journal_module.os, "fsync", counted)
    with Journal(tmp_path, SystemClock()) as journal:
        journal.append("start")
        first = len(synced)
        journal.append("frame", number=1)
        assert len(synced) == first + 1
        assert synced[-1] == len((tmp_path / JOURNAL_NAME).read_text())


def test_port_that_stays_away_leaves_few_lines_that_count_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an exchange the first, second, fourth, eighth fault and so on, and the last; the next one begins anew."""
    monkeypatch.setattr("rigs.transports._repeated_exchange.PAUSE_S", 0.0)
    tries = 0

    def lost(end_s: float) -> None:
        nonlocal tries
        tries += 1
        if tries not in (101, 104):
            raise LostError("wheel at /dev/ttyUSB0: cannot be opened")

    with Journal(tmp_path, SystemClock()) as journal, faults_noted(journal, tmp_path):
        for _ in range(2):
            repeated(lost, time.monotonic() + 60.0, "wheel at /dev/ttyUSB0")
    faults = [line for line in read_journal(tmp_path) if line["event"] == "fault"]
    assert [(line["attempt"], line["times"]) for line in faults] == [
        (1, 1), (2, 1), (4, 2), (8, 4), (16, 8), (32, 16), (64, 32), (100, 36), (1, 1), (2, 1),
    ]  # fmt: skip
    assert "102 messages to devices were repeated (wheel at /dev/ttyUSB0 102)" in fault_notes(tmp_path)[0]


def test_counted_faults_stand_before_what_followed_them(tmp_path: Path) -> None:
    """An hour later a frame is stored: the faults before it must not look like faults of that moment, or after it."""

    class Stepped(SystemClock):
        at_s = 0.0

        def monotonic_s(self) -> float:
            return self.at_s

        def utc(self) -> str:
            return f"{self.at_s:g} s"

    clock, heard = Stepped(), list[str]()
    with (
        Journal(tmp_path, clock, told=lambda event, what: heard.append(event)) as journal,
        faults_noted(journal, tmp_path),
    ):
        for attempt in range(1, 8):
            clock.at_s = float(attempt)
            report_fault(Fault("lamp at /dev/ttyACM0", "does not answer", attempt, 0.1))
        clock.at_s = 3600.0
        journal.append("frame")
    lines = [(line["event"], line["monotonic_s"], line["utc"], line.get("times")) for line in read_journal(tmp_path)]
    assert lines == [
        ("fault", 1.0, "1 s", 1),
        ("fault", 2.0, "2 s", 1),
        ("fault", 4.0, "4 s", 2),
        ("fault", 7.0, "7 s", 3),
        ("frame", 3600.0, "3600 s", None),
        ("stop", 3600.0, "3600 s", None),
    ]
    assert heard == ["fault", "fault", "fault", "fault", "frame", "stop"]


def test_faults_before_an_error_are_counted_too(tmp_path: Path) -> None:
    def capture() -> None:
        with Journal(tmp_path, SystemClock()) as journal, faults_noted(journal, tmp_path):
            report_fault(Fault("lamp at /dev/ttyACM0", "does not answer", 3, 0.5))
            raise UnsafeError("NOT CONFIRMED OFF")

    with pytest.raises(UnsafeError):
        capture()
    assert [line["event"] for line in read_journal(tmp_path)] == ["fault", "stop"]
