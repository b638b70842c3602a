"""Worker processes of Dask: started on this machine, or those of a scheduler elsewhere.

On one machine a scheduler and single-threaded workers start by themselves, talk over the loopback interface by TLS with
a certificate made for this run, and end with the study. Workers elsewhere must run the same sources of finray and see
the folder of the study: what does not is refused, or left out where it comes later.
"""

import importlib
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

from data_schemas import MissingExtraError, SimulateError, code_digest, provenance

T = TypeVar("T")
P = TypeVar("P")
Outcome = str | None

MEMORY_PER_WORKER_BYTES: Final = 2 * 2**30
"""A worker may take this much; a medium mesh with friction takes 1.2 GB."""

WAIT_FOR_SCHEDULER_S: Final = 600.0
"""A scheduler that went away is waited for as long as this: a restart takes seconds, a lost machine hours."""

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
    folder
        Of the study, which workers elsewhere must see.
    unfit
        Address -> why nothing more is given to this worker.
    """

    client: Any
    address: str | None = None
    folder: Path | None = None
    unfit: dict[str, str] = field(default_factory=dict)

    def count(self) -> int:
        """Return how many there are now, at least one: those that are not there yet are waited for."""
        return max(1, len(self.client.nthreads()) - len(self.unfit))

    def submit(self, compute: Callable[[T, P], Outcome], task: T, point: P) -> Any:
        """Give a point to a worker; return its future, whose result may be :class:`Unfit`."""
        if self.address is None:
            return self.client.submit(compute, task, point, pure=False)
        chosen = {}
        if self.unfit:
            fit = [address for address in self.client.nthreads() if address not in self.unfit]
            if not fit:
                raise SimulateError(f"--scheduler {self.address}: {_unfit_words(self.unfit)}")
            chosen = {"workers": fit}
        return self.client.submit(
            _on_fit_worker, compute, task, point, code_digest(), self.folder, pure=False, **chosen
        )

    def require_fit(self) -> None:
        """Ask each worker that is there whether it runs the same code and sees the folder.

        Raises
        ------
        SimulateError
            One does not; the message names it.
        """
        with _token_in(self.folder) as token:
            found = self.client.run(_fault, code_digest(), token, on_error="return")
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
        tell(f"the scheduler {self.address} went away; waiting for it, {WAIT_FOR_SCHEDULER_S / 60:g} minutes at most")
        deadline = time.monotonic() + WAIT_FOR_SCHEDULER_S
        with suppress(Exception):  # it is lost in any case
            self.client.close(timeout=5)
        distributed = importlib.import_module("distributed")
        while time.monotonic() < deadline:
            try:
                self.client = distributed.Client(self.address, timeout="10s")
            except (OSError, ValueError):
                time.sleep(0.5)
                continue
            self.unfit.clear()
            return True
        return False


def _unfit_words(unfit: Mapping[str, str]) -> str:
    """Say which workers do not fit, and what to do."""
    told = "; ".join(f"worker {address} {reason}" for address, reason in list(unfit.items())[:5])
    more = f"; and {len(unfit) - 5} more" if len(unfit) > 5 else ""
    return f"{told}{more}. Install the finray of this computer there and mount the folder under its path, or stop them"


def _on_fit_worker(
    compute: Callable[[T, P], Outcome], task: T, point: P, digest: str, folder: Path | None
) -> Outcome | Unfit:
    """Compute a point, in a worker elsewhere, unless the worker does not fit."""
    fault = _fault(digest, folder)
    if fault is None:
        return compute(task, point)
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
        raise MissingExtraError(f"design studies need Dask: pip install 'finray-calib[sim]' ({error})") from error
    with dask.config.set(dict(_SETTINGS)):
        if scheduler is not None:
            # what it would log with a traceback is said here in a sentence
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            try:
                workers = Workers(distributed.Client(scheduler, timeout="10s"), scheduler, folder)
            except (OSError, ValueError) as error:
                raise SimulateError(
                    f"--scheduler {scheduler}: no Dask scheduler answers there ({error}); start one with 'dask "
                    "scheduler', or leave it out to compute on this machine"
                ) from error
            try:
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
            distributed.Client(cluster) as client,
        ):
            yield Workers(client)
