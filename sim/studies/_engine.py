"""Run the points of a study in worker processes of Dask, on this machine or on a cluster's scheduler.

On one machine a scheduler and single-threaded workers start by themselves, talk over the loopback interface by TLS with
a certificate made for this run, and end with the study. A point is stored by its worker as soon as it is computed, so
that whatever ends the study, the same command goes on with what is missing.
"""

import importlib
import itertools
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any, Final, Protocol, TypeVar

from data_schemas import FinrayError, MissingExtraError, SimulateError, StudyFailure, StudyPoint
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


class Numbered(Protocol):
    """Something that is computed by itself and known by its number."""

    @property
    def number(self) -> int:
        """Its number."""
        ...


T = TypeVar("T")
P = TypeVar("P", bound=Numbered)
Progress = Callable[[int, int, str], None]
Outcome = str | None

MEMORY_PER_WORKER_BYTES: Final = 2 * 2**30
"""A worker may take this much; a medium mesh with friction takes 1.2 GB."""

POINTS_IN_FLIGHT_PER_WORKER: Final = 4
"""So many points are given to the scheduler at a time for each worker: a million must not wait in its memory."""

_SETTINGS: Final[Mapping[str, Any]] = {
    # a solve may hold the interpreter for minutes, in which a worker cannot say that it lives
    "distributed.scheduler.worker-ttl": None,
    # what a dead worker had is tried again here, one by one
    "distributed.scheduler.allowed-failures": 0,
    # a worker that takes more than its share of memory is ended before the machine has none left
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.admin.tick.limit": "10m",
}


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
        with _client(min(workers or most_workers(), len(todo)), scheduler) as client:
            steps = _Steps(len(presses) + len(todo), progress)
            broken = {
                press_file(task, point.design): reason
                for point, reason in _each(client, _try_press, task, list(presses.values()), steps, "press of point ")
                if reason is not None
            }
            whole = [point for point in todo if press_file(task, point.design) not in broken]
            failed = {p.number: f"its press: {broken[press_file(task, p.design)]}" for p in todo if p not in whole}
            for point, reason in _each(client, _try_point, task, whole, steps, "point "):
                if reason is not None:
                    failed[point.number] = reason
    found = {point.number: stored_point(task, point) for point in points if point.number not in failed}
    kept = [record for record in found.values() if record is not None]
    return kept, [StudyFailure(number=p.number, changes=p.changes, reason=failed[p.number])
                  for p in points if p.number in failed]  # fmt: skip


def most_workers() -> int:
    """Return how many workers this machine has cores and free memory for, at least one."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return cores
    return max(1, min(cores, free // MEMORY_PER_WORKER_BYTES))


class _Steps:
    """How far a study is."""

    def __init__(self, of: int, progress: Progress | None) -> None:
        self._done, self._of, self._progress = 0, of, progress

    def done(self, what: str) -> None:
        """Count one task."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._of, what)


def _each(
    client: Any,
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
    window = POINTS_IN_FLIGHT_PER_WORKER * max(1, len(client.scheduler_info()["workers"]))
    died: list[P] = []
    for point, outcome, has_died in _ended(client, compute, task, points, window):
        if has_died:
            died.append(point)
            continue
        yield point, outcome
        steps.done(f"{what}{point.number}")
    for point, outcome, has_died in _ended(client, compute, task, died, 1):
        yield point, _DIED_TWICE if has_died else outcome
        steps.done(f"{what}{point.number}")


def each_computed(
    compute: Callable[[T, P], Outcome],
    task: T,
    jobs: Sequence[P],
    what: str,
    where: tuple[int | None, str | None] = (None, None),
    progress: Progress | None = None,
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
    """
    if not jobs:
        return
    workers, scheduler = where
    with _client(min(workers or most_workers(), len(jobs)), scheduler) as client:
        yield from _each(client, compute, task, jobs, _Steps(len(jobs), progress), what)


_DIED_TWICE = "its worker process died twice: a crash of a compiled library, or too little memory"


def _ended(
    client: Any,
    compute: Callable[[T, P], Outcome],
    task: T,
    points: Sequence[P],
    window: int,
) -> Iterator[tuple[P, Outcome, bool]]:
    """Yield each point with why it failed and whether its worker died, as they end; a window of them is in flight."""
    distributed = importlib.import_module("distributed")
    running: dict[str, P] = {}
    waiting, ended = iter(points), distributed.as_completed()
    while True:
        for point in itertools.islice(waiting, window - len(running)):
            future = client.submit(compute, task, point, pure=False)
            running[future.key] = point
            ended.add(future)
        if not running:
            return
        try:
            future = next(ended)
            error = future.exception()
            outcome = None if error is not None else future.result()
        except CancelledError as lost:  # Dask cancels what it has given to a scheduler that is gone
            raise SimulateError(
                "the Dask scheduler went away in the middle; what is finished is kept: start the scheduler and its "
                "workers again, and give the same command, which continues with what is missing"
            ) from lost
        point = running.pop(future.key)
        if error is None:
            yield point, outcome, False
        else:
            yield point, f"{type(error).__name__}: {error}", type(error).__name__ == "KilledWorker"


def _try_press(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Press, in a worker; return why it failed."""
    try:
        compute_press(task, point.design)
    except FinrayError as error:
        return str(error)
    return None


def _try_point(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Compute a point, in a worker; return why it failed."""
    try:
        compute_point(task, point)
    except FinrayError as error:
        return str(error)
    return None


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Connect to a scheduler, or start one with workers on this machine."""
    try:
        dask, distributed = importlib.import_module("dask"), importlib.import_module("distributed")
    except ImportError as error:
        raise MissingExtraError(f"design studies need Dask: pip install 'finray-calib[sim]' ({error})") from error
    with dask.config.set(dict(_SETTINGS)):
        if scheduler is not None:
            try:
                client = distributed.Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                raise SimulateError(
                    f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one with 'dask "
                    "scheduler', or leave it out to compute on this machine"
                ) from error
            with client:
                yield client
            return
        with (
            distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                protocol="tls://",
                security=distributed.Security.temporary(),
                dashboard_address="127.0.0.1:0",
                memory_limit="auto",
                silence_logs=logging.CRITICAL,
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            yield client
