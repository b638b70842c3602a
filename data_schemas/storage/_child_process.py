"""Run functions in a process of its own, whose crash, kill or want of memory is an error here and nothing worse.

A function is named "module:function"; arguments, result and messages are JSON, and everything larger is a file. The
child tells its parent through a pipe; whatever else it or its libraries write goes to a log, to which Python's fault
handler writes where it was when it crashed. It never outlives its parent.
"""

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import json
import math
import os
import re
import resource
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Final, Self

from data_schemas import FinrayError, ProcessDiedError, errors

Json = Any
Hear = Callable[[Json], None]

GRACE_S: Final = 2.0
"""How long a child that is told to end may take to tidy up, before it is killed."""
OBJECTS_PER_COLLECTION: Final = 300_000
"""Loading packages makes few cycles: looking for them took a tenth of a short verb."""
_LOOK_S: Final = 0.25  # between looks at a child whose pipe a grandchild may keep open
_TELL_AGAIN_S: Final = 0.05
_DIE_WITH_PARENT: Final = 1  # PR_SET_PDEATHSIG of Linux
_MESSAGE_BYTES: Final = 1 << 16

_START: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[4]); "
    "from data_schemas.storage._child_process import serve; serve(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))"
)
#: Names of GNU's C library; it takes no larger first number.
_KEEPS_MEMORY: Final = {"MALLOC_MMAP_THRESHOLD_": str(32 << 20), "MALLOC_TRIM_THRESHOLD_": str(256 << 20)}
_IN_PLAIN_WORDS: Final = {
    signal.SIGSEGV: "it used memory that does not belong to it, which is a fault of a compiled library",
    signal.SIGBUS: "it accessed invalid memory, because a compiled library has a fault, or the disk or /dev/shm is "
    "full",
    signal.SIGILL: "a compiled library uses instructions that this processor does not have",
    signal.SIGFPE: "a compiled library divided by zero",
    signal.SIGABRT: "a compiled library aborted",
    signal.SIGTERM: "a person or the system asked it to end",
    signal.SIGINT: "somebody interrupted it",
    signal.SIGXCPU: "it used more processor time than is allowed",
}


class Child:
    """A process that runs functions one after the other, each named "module:function".

    Starting takes an interpreter and imports: start it while something else computes, and call it later. Where it
    dies in a call, the next call starts it anew.

    Parameters
    ----------
    imports
        Modules that the child imports at once, while it waits for its first call.
    keeps_memory
        Whether freed memory of large arrays stays with the child for the next ones, where the C library is GNU's. Work
        that forms many images then saves the time in which the system clears their pages.
    """

    def __init__(self, imports: Sequence[str] = (), keeps_memory: bool = False) -> None:
        self._imports = tuple(imports)
        self._settings = _KEEPS_MEMORY if keeps_memory else {}
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    @property
    def pid(self) -> int | None:
        """Process number, or None after its end."""
        return None if self._process is None else self._process.pid

    def call(
        self,
        function: str,
        arguments: Mapping[str, Json],
        *,
        log: Path | None = None,
        hear: Hear | None = None,
        time_s: float | None = None,
        memory_bytes: int | None = None,
    ) -> Json:
        """Run a function in the child and return its result.

        Parameters
        ----------
        function
            "module:function".
        arguments
            Its keyword arguments, as JSON.
        log
            File to which all that the child writes is appended; kept in memory only by default.
        hear
            Called with each message that the function sends by :func:`tell`.
        time_s
            After this time the child is killed.
        memory_bytes
            Address space that the function may take beyond what the child has when the call begins.

        Raises
        ------
        FinrayError
            What the function raised, of the same kind and in the same words.
        OSError
            What the operating system told the function.
        ProcessDiedError
            The child died, ran out of memory or time, or failed by a fault of its own. The text is what follows a
            name, such as "was ended by SIGSEGV (...)": the caller says in front what it was doing.
        KeyboardInterrupt
            Ctrl-C; the child has ended, too.
        """
        if self._process is None:
            self._start()
        job = {
            "function": function,
            "arguments": dict(arguments),
            "log": None if log is None else os.fspath(log.absolute()),
            "memory_bytes": memory_bytes,
        }
        deadline_s = None if time_s is None else time.monotonic() + time_s
        kills_before = _kills_for_want_of_memory()
        try:
            with stopping_together([self]):
                self._send(job)
                answer = self._listen(hear, deadline_s)
        except BaseException:
            self.end()
            raise
        if answer is None:
            late = deadline_s is not None and time.monotonic() >= deadline_s
            raise ProcessDiedError(self._death(f"took longer than {time_s:g} s" if late else "", kills_before, log))
        if "result" in answer:
            return answer["result"]
        if answer.get("kind") == "MemoryError":
            self.end()
        raise _error_of(answer)

    def end(self) -> None:
        """End the child and what it has started: by an interrupt, and by force when that takes too long."""
        if self._process is None:
            self._early_log.close()
            return
        try:
            self._jobs.close()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGINT)
            _has_ended(self._process.pid, GRACE_S)
        finally:  # also when Ctrl-C is pressed again
            self._reap()
            self._early_log.close()

    def kill(self, by: signal.Signals = signal.SIGKILL) -> None:
        """Kill the child from another thread than the one that calls it, which gets a ProcessDiedError.

        An interrupt in place of the kill lets it tidy up.
        """
        if (process := self._process) is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, by)

    def _start(self) -> None:
        """Start the interpreter; it imports and waits."""
        self._early_log = tempfile.TemporaryFile()  # noqa: SIM115 - what is written before the first call
        jobs, self_jobs = os.pipe()
        self_messages, messages = os.pipe()
        path = json.dumps(sys.path)
        try:
            # -P: a file of the user's folder must not stand in for a module of ours
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _START, str(jobs), str(messages), str(os.getpid()), path],
                stdin=subprocess.DEVNULL,
                stdout=self._early_log,
                stderr=self._early_log,
                pass_fds=(jobs, messages),
                process_group=0,
                env={**self._settings, **os.environ, "PYTHONFAULTHANDLER": "1"},
            )
        except BaseException:
            self._early_log.close()
            raise
        finally:
            os.close(jobs)
            os.close(messages)
        self._jobs = os.fdopen(self_jobs, "wb", buffering=0)
        self._messages, self._unread = self_messages, b""
        self._inherited_bytes, self._seen_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, 0
        self._send({"imports": self._imports})

    def _send(self, job: Json) -> None:
        """Send a line; a child that is gone is noticed by who listens."""
        with contextlib.suppress(BrokenPipeError):
            self._jobs.write(json.dumps(job).encode() + b"\n")

    def _listen(self, hear: Hear | None, deadline_s: float | None) -> dict[str, Json] | None:
        """Pass messages on until the answer, which is returned; None when the child died or is late."""
        while True:
            if self._process is not None:
                self._seen_bytes = _peak_bytes(self._process.pid) or self._seen_bytes
            while b"\n" in self._unread:
                line, self._unread = self._unread.split(b"\n", 1)
                message = json.loads(line)
                if "told" not in message:
                    return dict(message)
                if hear is not None:
                    hear(message["told"])
            if deadline_s is not None and time.monotonic() >= deadline_s:
                return None
            if select.select([self._messages], [], [], _LOOK_S)[0]:
                content = os.read(self._messages, _MESSAGE_BYTES)
            elif self._process is not None and _has_ended(self._process.pid):
                content = b""
            else:
                continue
            if not content:
                return None
            self._unread += content

    def _reap(self) -> tuple[int, int]:
        """Kill what is left of the child and its own children; return its exit status and peak memory in bytes."""
        process, self._process = self._process, None
        if process is None:
            return 0, 0
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        os.close(self._messages)
        self._jobs.close()
        # the system counts what this process had when it started the child as the child's own
        peak_bytes = usage.ru_maxrss * 1024
        return process.returncode, peak_bytes if peak_bytes > self._inherited_bytes else self._seen_bytes

    def _death(self, cause: str, kills_before: int, log: Path | None) -> str:
        """Reap the dead child and return in words how it died, with what memory, and where its log is."""
        if self._process is not None and not cause:
            _has_ended(self._process.pid, GRACE_S)
        status, peak_bytes = self._reap()
        if not cause:
            cause = _cause(status, _kills_for_want_of_memory() > kills_before)
        memory = f"; it had taken {peak_bytes / 2**30:.2f} GiB of memory" if peak_bytes else ""
        self._early_log.seek(0)
        if log is not None:
            with contextlib.suppress(OSError), log.open("ab") as file:
                file.write(self._early_log.read() + f"The process {cause}{memory}\n".encode())
        self._early_log.close()
        return f"{cause}{memory}"


def call_in_child(
    function: str,
    arguments: Mapping[str, Json],
    *,
    time_s: float | None = None,
    memory_bytes: int | None = None,
) -> Json:
    """Run one function in a process of its own with limits of time (s) and memory (bytes); see :meth:`Child.call`."""
    with Child() as child:
        return child.call(function, arguments, time_s=time_s, memory_bytes=memory_bytes)


_channel: int | None = None
_telling = threading.Lock()


def is_child() -> bool:
    """Return whether this process was started by :class:`Child`."""
    return _channel is not None


def tell(message: Json) -> None:
    """Send a message to the parent; in a process that is no child it goes nowhere."""
    if _channel is not None:
        _write({"told": message})


def progress_sender() -> Callable[[int, int, str], None]:
    """Return what sends ``[done, total, what]`` to the parent, a few times a second at most."""
    last_s = -math.inf

    def progress(done: int, total: int, what: str) -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= _TELL_AGAIN_S or done == total:
            last_s = time.monotonic()
            tell([done, total, what])

    return progress


def serve(jobs: int, messages: int, parent: int) -> None:
    """Be a child: import, then run what is asked for until the parent closes the pipe."""
    global _channel
    _channel = messages
    for pipe in (jobs, messages):
        os.set_inheritable(pipe, False)
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits that it is ignored
    _die_with(parent)
    faulthandler.enable(file=2)  # by number: what descriptor 2 is when the process dies, the log of a job
    try:
        with os.fdopen(jobs, encoding="utf-8") as lines:
            for name in json.loads(lines.readline() or "{}").get("imports", ()):
                with contextlib.suppress(ImportError):  # who needs it will say so
                    importlib.import_module(name)
            for line in lines:
                _write(_run(json.loads(line)))
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGINT)
    sys.stdout.flush()
    sys.stderr.flush()
    # libraries that crash while they take themselves down have done their work
    os._exit(0)


def _run(job: dict[str, Json]) -> Json:
    """Run one function; return what is sent back."""
    if job["log"] is not None:
        log = os.open(job["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        for standard in (1, 2):
            os.dup2(log, standard)
        os.close(log)
    if job["memory_bytes"] is not None:
        _limit_memory(job["memory_bytes"])
    try:
        module, name = job["function"].split(":")
        return {"result": getattr(importlib.import_module(module), name)(**job["arguments"])}
    except FinrayError as error:
        known = next(k.__name__ for k in type(error).__mro__ if getattr(errors, k.__name__, None) is k)
        return {"kind": known, "text": str(error)}
    except MemoryError:
        _free_to_speak()
        traceback.print_exc()
        return {"kind": "MemoryError", "limit_bytes": job["memory_bytes"], "peak_bytes": _peak_bytes()}
    except OSError as error:
        traceback.print_exc()
        return {"kind": "OSError", "errno": error.errno, "text": error.strerror or str(error), "file": error.filename}
    except Exception as error:
        traceback.print_exc()
        return {"kind": "fault", "text": f"{type(error).__name__}: {error}"}
    finally:
        sys.stdout.flush()
        sys.stderr.flush()


def _error_of(answer: dict[str, Json]) -> Exception:
    """Return the error that a child told of."""
    kind = str(answer["kind"])
    if kind == "OSError":
        if answer["errno"] is None:
            return OSError(answer["text"])
        return OSError(answer["errno"], answer["text"], answer["file"])
    if kind == "MemoryError":
        limit = answer["limit_bytes"]
        allowed = "" if limit is None else f" (its limit is {limit / 2**30:.2g} GiB more than it had at the start)"
        return ProcessDiedError(f"ran out of memory{allowed} after it had taken {answer['peak_bytes'] / 2**30:.2f} GiB")
    if kind == "fault":
        return ProcessDiedError(f"failed because of a fault in finray itself ({answer['text']})")
    error: FinrayError = getattr(errors, kind)(answer["text"])
    return error


def _cause(status: int, killed_for_memory: bool) -> str:
    """Return in plain words how a process of this exit status (negative: a signal) ended."""
    if status >= 0:
        return f"exited with status {status} before it had finished"
    try:
        number = signal.Signals(-status)
    except ValueError:
        return f"was ended by signal {-status}"
    if number is not signal.SIGKILL:
        plain = _IN_PLAIN_WORDS.get(number)
        return f"was ended by {number.name}" + (f" ({plain})" if plain else "")
    if killed_for_memory:
        return "was killed (SIGKILL) by the system for lack of memory"
    return "was killed (SIGKILL) by a person, or by the system for lack of memory"


def _kills_for_want_of_memory() -> int:
    """Return how many processes this system has killed for lack of memory since it started; 0 where unknown."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/vmstat").read_text(encoding="ascii").splitlines():
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    return 0


def _has_ended(pid: int, within_s: float = 0.0) -> bool:
    """Return whether a child of ours ends within some seconds; it stays to be reaped."""
    deadline_s = time.monotonic() + within_s
    while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() >= deadline_s:
            return False
        time.sleep(0.005)
    return True


@contextlib.contextmanager
def stopping_together(children: Sequence[Child]) -> Iterator[None]:
    """Let Ctrl-Z stop children, too, and ``fg`` let them continue: each is in a process group of its own.

    Parameters
    ----------
    children
        Those that are at work; threads may be calling them. In another thread than the main one this does nothing, as
        signals come to the main one only.
    """
    usual = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTSTP) == signal.SIG_DFL
    if not children or not usual:
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        for child in children:
            child.kill(signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
        for child in children:
            child.kill(signal.SIGCONT)

    signal.signal(signal.SIGTSTP, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, signal.SIG_DFL)


def _write(message: Json) -> None:
    """Write a line to the parent, whole though threads tell at once."""
    if _channel is None:
        return
    content = json.dumps(message).encode() + b"\n"
    with _telling:
        while content:
            content = content[os.write(_channel, content) :]


def _die_with(parent: int) -> None:
    """Have the system kill this process when the thread that started it ends."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def memory_left() -> tuple[int, int]:
    """Return free and total memory in bytes: of the machine, or of this process's control group where that is less.

    Swap space counts as free, and so does what the group only caches of files.

    Raises
    ------
    OSError
        The system does not say, as other systems than Linux.
    """
    kib = dict(re.findall(r"^(\w+):\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"), re.MULTILINE))
    left = 1024 * (int(kib["MemAvailable"]) + int(kib["SwapFree"]))
    total = 1024 * (int(kib["MemTotal"]) + int(kib["SwapTotal"]))
    with contextlib.suppress(OSError, ValueError, TypeError):
        folder = Path("/sys/fs/cgroup")
        limit = int((folder / "memory.max").read_text(encoding="ascii"))
        cached = re.search(r"^inactive_file (\d+)$", (folder / "memory.stat").read_text(encoding="ascii"), re.MULTILINE)
        taken = int((folder / "memory.current").read_text(encoding="ascii")) - (0 if cached is None else int(cached[1]))
        left, total = min(left, limit - taken), min(total, limit)
    return left, total


def _limit_memory(memory_bytes: int) -> None:
    """Limit the address space to what is taken now and some bytes more."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * os.sysconf("SC_PAGESIZE") + memory_bytes, hard))


def _free_to_speak() -> None:
    """Lift the limit of memory, so that what happened can be told."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _peak_bytes(process: int | str = "self") -> int:
    """Return the most memory that a living process has had; 0 where the system does not tell."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path(f"/proc/{process}/status").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    return 0
