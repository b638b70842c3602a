"""Run the points of a study in worker processes of Dask, on this machine or on a cluster's scheduler.

A point is stored by its worker as soon as it is computed, so that whatever ends the study, the same command goes on
with what is missing.

On one machine a scheduler and single-threaded workers start by themselves, talk over the loopback interface by TLS with
a certificate made for this run, and end with the study. Workers elsewhere must run the same sources of finray and see
the folder of the study: what does not is refused, or left out where it comes later.
"""

import functools
import importlib
import logging
import os
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from data_schemas import (
    FinrayError,
    MissingExtraError,
    SimulateError,
    StudyFailure,
    StudyPoint,
    code_digest,
    provenance,
    why_failed,
)
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
Q = TypeVar("Q")
R = TypeVar("R")
Progress = Callable[[int, int, str], None]
Outcome = str | None

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
    files = {point.number: press_file(task, point.design) for point in todo}
    presses = {file: point for point in todo if (file := files[point.number]) and not has_press(task, file)}
    failed: dict[int, str] = {}
    if todo:
        with open_workers(min(workers or most_workers(), len(todo)), scheduler, task.folder) as computing:
            steps = _Steps(len(presses) + len(todo), progress)
            broken = {
                files[point.number]: reason
                for point, reason in _each(
                    computing, _try_press, task, list(presses.values()), steps, "press of point "
                )
                if reason is not None
            }
            failed = {n: f"its press: {broken[file]}" for n, file in files.items() if file in broken}
            whole = [point for point in todo if point.number not in failed]
            for point, reason in _each(computing, _try_point, task, whole, steps, "point "):
                if reason is not None:
                    failed[point.number] = reason
    whole = [point for point in points if point.number not in failed]
    found = when_seen(functools.partial(stored_point, task), whole, task.folder / POINTS)
    kept = [record for record in found.values() if record is not None]
    failed |= {number: not_seen(task.folder) for number, record in found.items() if record is None}
    return kept, [StudyFailure(number=p.number, changes=p.changes, reason=failed[p.number])
                  for p in points if p.number in failed]  # fmt: skip


def when_seen(
    stored: Callable[[P], R | None], jobs: Sequence[P], folder: Path, wait_s: float | None = None
) -> dict[int, R | None]:
    """Return what is stored of jobs that workers have ended, by number; None of what is not seen.

    A network file system may show a file that was written elsewhere up to a minute later; it is waited for.

    Parameters
    ----------
    stored
        Returns what is stored of a job, None where nothing is.
    jobs
        What was computed.
    folder
        Where it is stored.
    wait_s
        Longest wait; by default :data:`WAIT_FOR_FILES_S`.
    """
    found = {job.number: stored(job) for job in jobs}
    deadline = time.monotonic() + (WAIT_FOR_FILES_S if wait_s is None else wait_s)
    while (missing := [job for job in jobs if found[job.number] is None]) and time.monotonic() < deadline:
        time.sleep(1.0)
        with suppress(OSError):  # reading the folder asks the file server again
            os.listdir(folder)
        found |= {job.number: stored(job) for job in missing}
    return found


WAIT_FOR_FILES_S: Final = 60.0
"""NFS keeps what it knows of a folder for as long as this."""

MEMORY_PER_WORKER_BYTES: Final = 2 * 2**30
"""A worker may take this much; a medium mesh with friction takes 1.2 GB."""

WAIT_FOR_SCHEDULER_S: Final = 600.0
"""Time to wait for a scheduler that no longer answers: it restarts in seconds; to replace its machine takes hours."""

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


def most_workers() -> int:
    """Return how many workers this machine has cores and free memory for, at least one."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        return cores
    return max(1, min(cores, free // MEMORY_PER_WORKER_BYTES))


@dataclass(frozen=True, slots=True)
class Unfit:
    """A worker that cannot compute for this study, and why."""

    address: str
    reason: str


@dataclass(slots=True)
class Workers:
    """What computes the points of a study.

    Attributes
    ----------
    client
        Of Dask.
    address
        Of a scheduler elsewhere; None for workers of this machine.
    token
        File in the folder of the study, which workers elsewhere must see.
    unfit
        Address -> why nothing more is given to this worker, as long as it is there.
    """

    client: Any
    address: str | None = None
    token: Path | None = None
    unfit: dict[str, str] = field(default_factory=dict)

    def count(self) -> int:
        """Return how many there are now, at least one: those that are not there yet are waited for."""
        return max(1, len(self._fit()))

    def submit(self, compute: Callable[[T, Q], Outcome], task: T, point: Q, tell: Callable[[str], None]) -> Any:
        """Give a point to a worker; return its future, whose result may be :class:`Unfit`.

        Which workers are chosen is a wish: what they cannot take any more goes to any other, of which an unfit one
        gives it back.
        """
        if self.address is None:
            return self.client.submit(compute, task, point, pure=False)
        fit = self._wait_for_fit(tell)
        chosen = {"workers": fit, "allow_other_workers": True} if self.unfit and fit else {}
        return self.client.submit(_on_fit_worker, compute, task, point, code_digest(), self.token, pure=False, **chosen)

    def _fit(self) -> list[str]:
        """Return the addresses of the workers that are there and not known to be unfit; forget those that left."""
        there = self.client.nthreads()
        self.unfit = {address: reason for address, reason in self.unfit.items() if address in there}
        return [address for address in there if address not in self.unfit]

    def _wait_for_fit(self, tell: Callable[[str], None]) -> list[str]:
        """Return the workers that may be fit, which are waited for while only unfit ones are there.

        Raises
        ------
        SimulateError
            None came.
        """
        deadline, is_told = time.monotonic() + WAIT_FOR_SCHEDULER_S, False
        while not (fit := self._fit()) and self.unfit:
            if time.monotonic() > deadline:
                raise SimulateError(f"--scheduler {self.address}: {_unfit_words(self.unfit)}")
            if not is_told:
                tell(
                    f"none of the connected workers can be used; waiting for others, {WAIT_FOR_SCHEDULER_S / 60:g} "
                    "minutes at most"
                )
                is_told = True
            time.sleep(0.5)
        return fit

    def require_fit(self) -> None:
        """Ask each worker that is there whether it runs the same code and sees the folder.

        Raises
        ------
        SimulateError
            One does not; the message names it.
        """
        found = self.client.run(_fault, code_digest(), self.token, on_error="return")
        faults = {
            address: f"cannot run finray ({type(fault).__name__}: {fault})" if isinstance(fault, Exception) else fault
            for address, fault in found.items()
            if fault is not None
        }
        if faults:
            raise SimulateError(f"--scheduler {self.address}: {_unfit_words(faults)}")

    def reached_again(self, tell: Callable[[str], None]) -> bool:
        """Wait for a scheduler elsewhere that went away; return whether it is there again."""
        if self.address is None:
            return False
        tell(
            f"the scheduler {self.address} does not answer any more; waiting for it, {WAIT_FOR_SCHEDULER_S / 60:g} "
            "minutes at most"
        )
        deadline = time.monotonic() + WAIT_FOR_SCHEDULER_S
        with suppress(Exception):  # it is lost in any case
            self.client.close(timeout=5)
        while time.monotonic() < deadline:
            try:
                self.client = _client_of(self.address)
            except (OSError, ValueError):
                time.sleep(0.5)
                continue
            self.unfit.clear()
            return True
        return False


def _client_of(scheduler: Any, timeout: str = "10s") -> Any:
    """Return a client of a scheduler or cluster, which leaves the default of the user's own Dask as it is."""
    return importlib.import_module("distributed").Client(scheduler, timeout=timeout, set_as_default=False)


def _unfit_words(unfit: Mapping[str, str]) -> str:
    """Say which workers do not fit, and what to do."""
    told = "; ".join(f"worker {address} {reason}" for address, reason in list(unfit.items())[:5])
    more = f"; and {len(unfit) - 5} more" if len(unfit) > 5 else ""
    return (
        f"{told}{more}. Install the finray of this computer there and mount the folder under the same path, or stop "
        "these workers"
    )


REFUSAL_S: Final = 1.0
"""An unfit worker gives points back as slowly as this: Dask lets idle workers take those that wait for busy ones."""


def _on_fit_worker(
    compute: Callable[[T, Q], Outcome], task: T, point: Q, digest: str, token: Path | None
) -> Outcome | Unfit:
    """Compute a point, in a worker elsewhere, unless the worker does not fit."""
    fault = _fault(digest, token)
    if fault is None:
        return compute(task, point)
    time.sleep(REFUSAL_S)
    return Unfit(importlib.import_module("distributed").get_worker().address, fault)


def _fault(digest: str, seen: Path | None) -> str | None:
    """Return why this process cannot compute for a study with other code or another file system; None: it can."""
    if code_digest() != digest:
        return f"runs other code ({provenance('').code}) than this computer"
    if seen is not None and not seen.exists():
        return f"does not see {seen.parent if seen.name.startswith(_TOKEN) else seen}"
    return None


_TOKEN: Final = ".seen-by-workers-"


@contextmanager
def _token_in(folder: Path | None) -> Iterator[Path | None]:
    """Put a file into the folder of a study, so that another folder of the same path is not taken for it."""
    if folder is None:
        yield None
        return
    with tempfile.NamedTemporaryFile(prefix=_TOKEN, dir=folder) as token:
        yield Path(token.name)


@contextmanager
def open_workers(count: int, scheduler: str | None = None, folder: Path | None = None) -> Iterator[Workers]:
    """Connect to a scheduler, or start one with workers on this machine.

    Parameters
    ----------
    count
        Worker processes on this machine.
    scheduler
        Address of a running scheduler; none are started here then.
    folder
        Of the study.

    Raises
    ------
    SimulateError
        The scheduler does not answer, or a worker of it runs other code or does not see the folder.
    MissingExtraError
        Dask is not installed.
    """
    try:
        dask, distributed = importlib.import_module("dask"), importlib.import_module("distributed")
    except ImportError as error:
        raise MissingExtraError(
            f"design studies need Dask, which is not installed ({error}); install it with pip install "
            "'finray-calib[sim]'"
        ) from error
    with dask.config.set(dict(_SETTINGS)):
        if scheduler is not None:
            # what it would log with a traceback is said here in a sentence
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            try:
                workers = Workers(_client_of(scheduler), scheduler)
            except (OSError, ValueError) as error:
                raise SimulateError(
                    f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one with 'dask "
                    "scheduler', or leave --scheduler out to compute on this machine"
                ) from error
            try:
                with _token_in(folder) as workers.token:  # for the whole run: workers that come later look too
                    workers.require_fit()
                    yield workers
            finally:
                workers.client.close()
            return
        with (
            distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                host="127.0.0.1",
                protocol="tls://",
                security=distributed.Security.temporary(),
                dashboard_address="127.0.0.1:0",
                memory_limit="auto",
                silence_logs=logging.CRITICAL,
            ) as cluster,
            _client_of(cluster, "30s") as client,
        ):
            yield Workers(client)


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


def not_seen(folder: Path) -> str:
    """Say that something was computed and is not seen, and what to do."""
    return (
        f"a worker has computed and stored it, but this computer does not see it in {folder} after "
        f"{WAIT_FOR_FILES_S:g} s. Check that the workers see this folder under the same path, then give the same "
        "command again, which continues with what is missing"
    )


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
    waiting, ended = deque(points), as_completed(loop=workers.client.loop)
    while True:
        try:
            window = 1 if is_one_by_one else POINTS_IN_FLIGHT_PER_WORKER * workers.count()
            while waiting and len(running) < window:
                future = workers.submit(compute, task, waiting[0], steps.note)
                running[future.key] = waiting.popleft()
                ended.add(future)
            if not running:
                return
            future = next(ended)
            error = future.exception()
            outcome = None if error is not None else future.result()
        except (CancelledError, OSError) as lost:  # Dask cancels what it has given to a scheduler that is gone
            if not workers.reached_again(steps.note):
                raise SimulateError(_ENDED_HERE if workers.address is None else _WENT_AWAY) from lost
            waiting.extendleft(reversed(running.values()))
            running, ended = {}, as_completed(loop=workers.client.loop)
            continue
        point = running.pop(future.key)
        if isinstance(outcome, Unfit):
            if outcome.address not in workers.unfit:
                steps.note(f"worker {outcome.address} is left out: it {outcome.reason}")
            workers.unfit[outcome.address] = outcome.reason
            waiting.appendleft(point)
        elif error is None:
            yield point, outcome, False
        else:
            yield point, f"{type(error).__name__}: {error}", type(error).__name__ == "KilledWorker"


_ENDED_HERE = (
    "the worker processes of this machine ended before their work was done; what was finished is kept: give the same "
    "command again, which computes the rest (with fewer --workers if memory was short)"
)
_WENT_AWAY = (
    "the Dask scheduler stopped answering before the work was done; what was finished is kept: start the scheduler "
    "and its workers again, and give the same command again, which computes the rest"
)


def _try_press(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Press, in a worker; return why it failed."""
    try:
        compute_press(task, point.design)
    except FinrayError as error:
        file = press_file(task, point.design)
        # after a restart of the scheduler another worker may have ended the same press in between
        return None if file is not None and has_press(task, file) else why_failed(error)
    return None


def _try_point(task: StudyTask, point: PlannedPoint) -> Outcome:
    """Compute a point, in a worker; return why it failed."""
    try:
        compute_point(task, point)
    except FinrayError as error:
        return None if _is_stored(task, point) else why_failed(error)
    return None


def _is_stored(task: StudyTask, point: PlannedPoint) -> bool:
    """Return whether another worker has stored a point in between, as after a restart of the scheduler."""
    with suppress(FinrayError):
        return stored_point(task, point) is not None
    return False
