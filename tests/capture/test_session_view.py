"""A session in the live view: the session of `finray capture`, its questions, its light key, and views that come and go."""

import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from data_schemas import CaptureError, RegionOfInterest
from rigs import open_rig
from rigs.capture import SessionRequest, capture_paint_session, read_journal
from rigs.live_view import WatchedSession

PATIENCE_S = 120.0


def watched(rig, plan) -> WatchedSession:
    return WatchedSession("red", rig.camera, plan.region, takes_time=False)


@contextmanager
def person(session: WatchedSession, answer=lambda numbers: numbers.answers[0]):
    """Answer every question in a thread, as a view does; yield what was asked."""
    asked, stop = [], threading.Event()

    def look() -> None:
        after = 0
        while not stop.is_set():
            _, numbers = session.latest(after, 0.2)
            after = numbers.number
            if numbers.question and (not asked or asked[-1].question != numbers.question):
                asked.append(numbers)
                session.ask({"question": numbers.question, "answer": answer(numbers)})

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield asked
    finally:
        stop.set()
        thread.join(PATIENCE_S)


def request(session: WatchedSession, out) -> SessionRequest:
    return SessionRequest(out, "finray live", progress=session.progress, operator=session.operator, watch=session)


def test_a_session_in_the_view_is_that_of_capture(rig, plan, captured, tmp_path):
    """Same seed, same frames: the view looks and asks, and changes nothing."""
    session = watched(rig, plan)
    with person(session) as asked:
        made = capture_paint_session(rig, plan, request(session, tmp_path / "out"), mend=session.mend)
    _, before, _ = captured
    assert [(f.file, f.sha256, f.laser_dose_j) for f in made.frames] == [
        (f.file, f.sha256, f.laser_dose_j) for f in before.frames
    ]
    assert made.notes == before.notes
    _, numbers = session.latest(-1, 0.0)
    assert [a.headline for a in asked] == [
        "PUT IN THE SAMPLE", "SAMPLE + CHECKER", "PUT IN WHITE TILE", "SAMPLE + CHECKER", "PUT IN THE SAMPLE",
    ]  # fmt: skip
    assert (numbers.stored, numbers.left, numbers.time_left_s) == (len(made.frames), 0, 0.0)
    assert all(f.stored == f.planned > 0 for f in numbers.filters)
    assert {d.label.split(",")[0] for d in numbers.drifts} == {"white", "fluorescence repeat"}
    assert not (numbers.lamp or numbers.laser or numbers.question)
