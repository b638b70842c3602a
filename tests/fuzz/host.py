"""Runs mutated files through readers, each in a forked process of its own that is watched; results are lines of JSON.

Started as a program: it imports once, makes the examples once, and forks for every case that it reads from standard
input (``{"reader": name, "seed": number}``).
"""

import contextlib
import faulthandler
import hashlib
import importlib
import io
import json
import os
import random
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, Self

HANGS_S = 20.0
"""Of processor time; the clock may run longer on a busy machine."""
CLOCK_S = 240.0
PREPARES_S = 900.0
MOST_MEMORY_BYTES = 1 << 30
REFUSED, ACCEPTED = "refused", "accepted"
FAULTS = ("traceback", "crash", "hang", "memory")


class Host:
    """The forking process, from the side of a test or a benchmark."""

    def __init__(self) -> None:
        root = Path(__file__).resolve().parents[2]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.host"],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(30)
        self._process.stdout.close()

    def run(self, reader: str, seed: int) -> dict[str, Any]:
        """Return what came of one mutation of one reader's example."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"reader": reader, "seed": seed}) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the host itself has ended"
        return dict(json.loads(answer))


def serve() -> None:
    """Read cases, write results."""
    import cv2
    import pydantic  # noqa: F401 - what every reader needs is imported once
    import scipy.optimize  # noqa: F401
    import tifffile  # noqa: F401

    from tests.fuzz.examples import READERS

    cv2.setNumThreads(1)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    readers = {reader.name: reader for reader in READERS}
    examples = Path(mkdtemp(prefix="finray-fuzz-"))
    try:
        for line in sys.stdin:
            case = json.loads(line)
            reader = readers[case["reader"]]
            example = examples / reader.name.replace(" ", "-").replace("/", "-")
            if not example.exists():
                _prepare(reader, example)
            answers.write(json.dumps(_case(reader, example, case["seed"])) + "\n")
            answers.flush()
    finally:
        shutil.rmtree(examples, ignore_errors=True)


def _prepare(reader: Any, example: Path) -> None:
    """Make a reader's example and import what the reader needs, so that no case pays for it; nothing is run here."""
    found = _in_fork(lambda: _make(reader, example), PREPARES_S)
    assert found["outcome"] == "made", f"{reader.name}: {found}"
    for name in found["modules"]:
        with contextlib.suppress(Exception):
            importlib.import_module(name)


def _make(reader: Any, example: Path) -> dict[str, Any]:
    example.mkdir()
    before = set(sys.modules)
    reader.make(example)
    reader.run(example)
    for made in example.glob("out*"):
        shutil.rmtree(made) if made.is_dir() else made.unlink()
    return {"outcome": "made", "text": "", "modules": [name for name in sys.modules if name not in before]}


def _case(reader: Any, example: Path, seed: int) -> dict[str, Any]:
    """Mutate one file of the example in place, run the reader on it, and put the file back."""
    from tests.fuzz.mutations import mutated

    rng = random.Random(f"{reader.name} {seed}")
    files = sorted({p for pattern in reader.files for p in example.glob(pattern) if p.is_file()})
    path = rng.choice(files)
    original = path.read_bytes()
    mutation = mutated(original, path.suffix, rng)
    kept = {path: original}
    path.write_bytes(mutation.content)
    sealed = path
    if path.suffix == ".npz" and (record := path.with_name(f"{path.name.split('.')[0]}.json")).is_file():
        kept[record] = record.read_bytes()
        sealed = record
    # else the checksums alone would refuse it; sealing writes a doubled key once
    if rng.random() < 0.8 and mutation.kind != "doubled key":
        with contextlib.suppress(Exception):
            _trust(sealed, path)
    try:
        found = _in_fork(lambda: _run(reader, example))
    finally:
        for file, content in kept.items():
            file.write_bytes(content)
        for made in example.glob("out*"):
            shutil.rmtree(made) if made.is_dir() else made.unlink()
    same = mutation.content == original
    if same and found["outcome"] == ACCEPTED:
        found["outcome"] = "unchanged"
    what = {"reader": reader.name, "seed": seed, "file": path.name, "mutation": mutation.kind, "words": mutation.words}
    return {**what, **found}


def _trust(record: Path, changed: Path) -> None:
    """Give a record the checksums that its changed content, or its changed array file, has now."""
    from tests.schemas.stored_files import seal_again

    if changed != record:
        envelope = json.loads(record.read_text())
        envelope["array_file"]["sha256"] = hashlib.sha256(changed.read_bytes()).hexdigest()
        record.write_text(json.dumps(envelope))
    if record.suffix == ".json":
        seal_again(record)


def _run(reader: Any, example: Path) -> dict[str, Any]:
    """Run a reader as the command line does: its errors and those of the system are refusals."""
    from data_schemas import FinrayError
    from tests.fuzz.examples import Refused

    warnings.simplefilter("ignore")
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            reader.run(example)
        except (FinrayError, OSError, Refused) as error:
            text = " ".join(str(error).split())
            return {"outcome": REFUSED if text else "traceback", "text": text[:300]}
        except BaseException:
            return {"outcome": "traceback", "text": traceback.format_exc()[-1500:]}
    return {"outcome": ACCEPTED, "text": ""}


def _in_fork(run: Any, clock_s: float = 0.0) -> dict[str, Any]:
    """Return what a function returns in a forked process, or how that process ended."""
    clock_s = clock_s or CLOCK_S
    receive, send = os.pipe()
    # what a fork shares from the start; getrusage would count the largest that this process, or its parent, ever had
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    base = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon:"))
    started = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.close(receive)
        faulthandler.disable()  # a crash is an answer here, and no news for the screen
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (int(HANGS_S), int(HANGS_S) + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _limit_memory(4 * MOST_MEMORY_BYTES)
        try:
            answer = run()
        except BaseException:
            answer = {"outcome": "traceback", "text": traceback.format_exc()[-1500:]}
        from data_schemas.storage._array_files import end_child

        with contextlib.suppress(BaseException):
            end_child()
        os.write(send, json.dumps(answer).encode())
        os._exit(0)
    os.close(send)
    content = b""
    while select.select([receive], [], [], max(0.0, started + clock_s - time.monotonic()))[0]:
        part = os.read(receive, 65536)
        if not part:
            break
        content += part
    else:
        os.killpg(pid, signal.SIGKILL)
    os.close(receive)
    _, status, usage = os.wait4(pid, 0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
    late = time.monotonic() - started >= clock_s
    return _judged(content, os.waitstatus_to_exitcode(status), usage, base, time.monotonic() - started, late)


def _judged(content: bytes, status: int, usage: Any, base_kib: int, wall_s: float, late: bool) -> dict[str, Any]:
    """Return the outcome with what it took."""
    took = {
        "cpu_s": round(usage.ru_utime + usage.ru_stime, 3),
        "wall_s": round(wall_s, 3),
        "memory_mb": round(max(usage.ru_maxrss - base_kib, 0) / 1024, 1),
    }
    if late or status in (-signal.SIGXCPU, -signal.SIGKILL) or took["cpu_s"] > HANGS_S:
        return {"outcome": "hang", "text": f"status {status}", **took}
    if status != 0 or not content:
        return {"outcome": "crash", "text": f"status {status}", **took}
    answer = json.loads(content)
    if took["memory_mb"] > MOST_MEMORY_BYTES / 2**20:
        return {"outcome": "memory", "text": answer.get("text", ""), **took}
    return {**answer, **took}


def _limit_memory(more_bytes: int) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGESIZE") + more_bytes
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


if __name__ == "__main__":
    serve()
