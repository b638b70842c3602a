"""Run the points of a study in worker processes of Dask, on this machine or on a cluster's scheduler.

A point is stored by its worker as soon as it is computed, so that whatever ends the study, the same command goes on
with what is missing.
"""

import importlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol, TypeVar

from data_schemas import FinrayError, SimulateError, StudyFailure, StudyPoint
from data_schemas.storage import clear_leftovers
from sim.studies._point import (
    POINTS,
    PRESSES,
    PlannedPoint,
    StudyTask,
    compute_point,
    compute_press,
    has_press,
    press_file,
    stored_point,
)
from sim.studies._workers import Outcome, Unfit, Workers, most_workers, open_workers


class Numbered(Protocol):
    """Something that is computed by itself and known by its number."""

    @property
    def number(self) -> int:
        """Its number."""
        ...


T = TypeVar("T")
P = TypeVar("P", bound=Numbered)
Progress = Callable[[int, int, str], None]

POINTS_IN_FLIGHT_PER_WORKER: Final = 4
"""So many points are given to the scheduler at a time for each worker: a million must not wait in its memory."""


def run_study(
    task: StudyTask,
    points: Sequence[PlannedPoint],
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> tuple[list[StudyPoint], list[StudyFailure]]:
    """Compute what a study still lacks; return all its points, and those that failed.

    Presses that several points share are computed first, once each.

    Parameters
    ----------
    task
        What all points need.
    points
        From :func:`sim.studies.study_points`.
    workers
        Worker processes on this machine; by default as many as it has cores and memory for.
    scheduler
        Address of a running Dask scheduler, such as tcp://10.0.0.5:8786, whose workers see `task.folder` under the same
        path; no workers are started here then.
    progress
        Called with tasks done, tasks in all, and what was done.

    Raises
    ------
    SimulateError
        The folder holds points of another plan, or the scheduler does not answer.
    MissingExtraError
        Dask is not installed.
    """
    for folder in (POINTS, PRESSES):  # the last point of a run that was killed may be whole already
        clear_leftovers(task.folder / folder)
    todo = [point for point in points if stored_point(task, point) is None]
    presses = {file: point for point in todo if (file := press_file(task, point.design)) and not has_press(task, file)}
    failed: dict[int, str] = {}
    if todo:
        with open_workers(min(workers or most_workers(), len(todo)), scheduler, task.folder) as computing:
            steps = _Steps(len(presses) + len(todo), progress)
            broken = {
                press_file(task, point.design): reason
                for point, reason in _each(
                    computing, _try_press, task, list(presses.values()), steps, "press of point "
                )
                if reason is not None
            }
            whole = [point for point in todo if press_file(task, point.design) not in broken]
            failed = {p.number: f"its press: {broken[press_file(task, p.design)]}" for p in todo if p not in whole}
            for point, reason in _each(computing, _try_point, task, whole, steps, "point "):
                if reason is not None:
                    failed[point.number] = reason
    found = {point.number: stored_point(task, point) for point in points if point.number not in failed}
    kept = [record for record in found.values() if record is not None]
    failed |= {number: f"was computed, but is not in {task.folder}: {_NOT_SEEN}" for number, record in found.items()
               if record is None}  # fmt: skip
    return kept, [StudyFailure(number=p.number, changes=p.changes, reason=failed[p.number])
                  for p in points if p.number in failed]  # fmt: skip


class _Steps:
    """How far a study is."""

    def __init__(self, of: int, progress: Progress | None) -> None:
        self._done, self._of, self._progress = 0, of, progress

    def done(self, what: str) -> None:
        """Count one task."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._of, what)

    def note(self, what: str) -> None:
        """Tell what happened besides."""
        if self._progress is not None:
            self._progress(self._done, self._of, what)


_NOT_SEEN = "a worker stored it where this computer does not see it; workers must see the folder under the same path"


def _each(
    workers: Workers,
    compute: Callable[[T, P], Outcome],
    task: T,
    points: Sequence[P],
    steps: _Steps,
    what: str,
) -> Iterator[tuple[P, Outcome]]:
    """Yield each point with why it failed, or None, as they end.

    A worker that dies takes with it what was given to it. These points are tried again one by one: the one that kills
    its worker alone is at fault.
    """
    died: list[P] = []
    for point, outcome, has_died in _ended(workers, compute, task, points, steps):
        if has_died:
            died.append(point)
            continue
        yield point, outcome
        steps.done(f"{what}{point.number}")
    for point, outcome, has_died in _ended(workers, compute, task, died, steps, is_one_by_one=True):
        yield point, _DIED_TWICE if has_died else outcome
        steps.done(f"{what}{point.number}")


def each_computed(
    compute: Callable[[T, P], Outcome],
    task: T,
    jobs: Sequence[P],
    what: str,
    where: tuple[int | None, str | None] = (None, None),
    progress: Progress | None = None,
    folder: Path | None = None,
) -> Iterator[tuple[P, Outcome]]:
    """Yield each of some numbered jobs with why it failed, or None, as worker processes end them.

    Parameters
    ----------
    compute
        Computes a job in a worker and keeps what it finds; returns why it failed.
    task
        What all jobs need.
    jobs
        What is to be computed; no worker is started for none.
    what
        Words before a job's number in what `progress` is told.
    where
        Worker processes on this machine, and the address of a scheduler, as of :func:`run_study`.
    progress
        Called with jobs done, jobs in all, and what was done.
    folder
        Which the workers of a scheduler must see.
    """
    if not jobs:
        return
    workers, scheduler = where
    with open_workers(min(workers or most_workers(), len(jobs)), scheduler, folder) as computing:
        yield from _each(computing, compute, task, jobs, _Steps(len(jobs), progress), what)


_DIED_TWICE = "its worker process died twice: a crash of a compiled library, or too little memory"


def _ended(
    workers: Workers,
    compute: Callable[[T, P], Outcome],
    task: T,
    points: Sequence[P],
    steps: _Steps,
    is_one_by_one: bool = False,
) -> Iterator[tuple[P, Outcome, bool]]:
    """Yield each point with why it failed and whether its worker died, as they end; a window of them is in flight.

    Where a scheduler elsewhere goes away, those in flight are given to it again once it is back.
    """
    as_completed = importlib.import_module("distributed").as_completed
    running: dict[str, P] = {}
    waiting, ended = deque(points), as_completed()
    while True:
        try:
            window = 1 if is_one_by_one else POINTS_IN_FLIGHT_PER_WORKER * workers.count()
            while waiting and len(running) < window:
                future = workers.submit(compute, task, waiting[0])
                running[future.key] = waiting.popleft()
                ended.add(future)
            if not running:
                return
            future = next(ended)
            error = future.exception()
            outcome = None if error is not None else future.result()
        except (CancelledError, OSError) as lost:  # Dask cancels what it has given to a scheduler that is gone
            if not workers.reached_again(steps.note):
                raise SimulateError(_WENT_AWAY) from lost
            waiting.extendleft(reversed(running.values()))
            running, ended = {}, as_completed()
            continue
        point = running.pop(future.key)
        if isinstance(outcome, Unfit):
            steps.note(f"worker {outcome.address} is left out: it {outcome.reason}")
            workers.unfit[outcome.address] = outcome.reason
            waiting.appendleft(point)
        elif error is None:
            yield point, outcome, False
        else:
            yield point, f"{type(error).__name__}: {error}", type(error).__name__ == "KilledWorker"


_WENT_AWAY = (
    "the Dask scheduler went away in the middle and did not come back; what is finished is kept: start the scheduler "
    "and its workers again, and give the same command, which continues with what is missing"
)


def _try_press(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Press, in a worker; return why it failed."""
    try:
        compute_press(task, point.design)
    except FinrayError as error:
        file = press_file(task, point.design)
        # after a restart of the scheduler another worker may have ended the same press in between
        return None if file is not None and has_press(task, file) else str(error)
    return None


def _try_point(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Compute a point, in a worker; return why it failed."""
    try:
        compute_point(task, point)
    except FinrayError as error:
        return None if _is_stored(task, point) else str(error)
    return None


def _is_stored(task: StudyTask, point: PlannedPoint) -> bool:
    """Return whether another worker has stored a point in between, as after a restart of the scheduler."""
    with suppress(FinrayError):
        return stored_point(task, point) is not None
    return False
