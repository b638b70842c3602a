"""A function in a process of its own: its result, its errors in the same words, and every way to die as one error."""

import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from data_schemas import NoEquilibriumError, ProcessDiedError, RefusedError
from data_schemas.storage import Child, call_in_child, is_child, memory_left

ROOT = Path(__file__).resolve().parents[2]
DYING = "tests.schemas.dying"


@pytest.fixture
def child() -> Iterator[Child]:
    with Child() as one:
        yield one


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def gone_within(pids: list[int], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while any(is_running(pid) for pid in pids):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def test_results_and_messages_come_back_from_one_process(child):
    heard: list[Any] = []
    first = child.call(f"{DYING}:add", {"a": 1.0, "b": 2.5}, hear=heard.append)
    second = child.call(f"{DYING}:add", {"a": 0.1, "b": 0.2}, hear=heard.append)
    assert (first["sum"], second["sum"]) == (3.5, 0.1 + 0.2)
    assert first["pid"] == second["pid"] == child.pid != os.getpid()
    assert heard == [{"adding": [1.0, 2.5]}, {"adding": [0.1, 0.2]}]
    assert not is_child()


def test_an_ended_child_leaves_no_file_open_and_can_be_called_again():
    at_first = sorted(os.listdir("/proc/self/fd"))
    child = Child()
    try:
        for _ in range(2):
            assert child.call(f"{DYING}:add", {"a": 1.0, "b": 2.5})["sum"] == 3.5
            child.end()
            assert sorted(os.listdir("/proc/self/fd")) == at_first
        with pytest.raises(ProcessDiedError):
            child.call(f"{DYING}:raise_signal", {"number": signal.SIGKILL})
        assert sorted(os.listdir("/proc/self/fd")) == at_first
    finally:
        child.end()


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        ("raise_signal", {"number": signal.SIGSEGV}, r"^was ended by SIGSEGV \(it used memory that does not belong"),
        ("read_address_zero", {}, r"^was ended by SIGSEGV \(it used memory"),
        ("raise_signal", {"number": signal.SIGILL}, r"^was ended by SIGILL \(a compiled library uses instructions"),
        pytest.param(
            "run_illegal_instruction", {}, r"^was ended by SIGILL \(a compiled library uses instructions that this",
            marks=pytest.mark.skipif(platform.machine() != "x86_64", reason="the bytes are those of x86"),
        ),
        ("raise_signal", {"number": signal.SIGABRT}, r"^was ended by SIGABRT \(a compiled library aborted\)"),
        ("raise_signal", {"number": signal.SIGKILL}, r"^was killed \(SIGKILL\) by a person, or by the"),
        ("raise_signal", {"number": signal.SIGTERM}, r"^was ended by SIGTERM \(a person or the system asked it"),
        ("leave", {}, r"^exited with status 7 before it had finished"),
        ("stumble", {}, r"^failed because of a fault in finray itself \(TypeError: a fault of ours\)$"),
    ],
)  # fmt: skip
def test_a_death_is_an_error_and_the_next_call_works(child, function, arguments, message):
    with pytest.raises(ProcessDiedError, match=message) as died:
        child.call(f"{DYING}:{function}", arguments)
    if function != "stumble":  # it lives on
        assert "it had taken 0." in str(died.value)
    assert child.call(f"{DYING}:add", {"a": 1.0, "b": 1.0})["sum"] == 2.0


def test_a_death_before_the_call_is_noticed_at_the_call(child):
    os.kill(child.pid, signal.SIGKILL)
    with pytest.raises(ProcessDiedError, match=r"was killed \(SIGKILL\)"):
        child.call(f"{DYING}:add", {"a": 1.0, "b": 1.0})


@pytest.mark.parametrize(
    ("kind", "known"), [("RefusedError", RefusedError), ("NoEquilibriumError", NoEquilibriumError)]
)
def test_errors_of_the_function_come_through_unchanged(child, kind, known):
    with pytest.raises(known) as raised:
        child.call(f"{DYING}:raise_named", {"kind": kind, "text": "wheel at 2 of 8: turn it"})
    assert type(raised.value) is known
    assert str(raised.value) == "wheel at 2 of 8: turn it"


def test_errors_of_the_operating_system_keep_their_file(child, tmp_path):
    with pytest.raises(FileNotFoundError) as raised:
        child.call(f"{DYING}:open_file", {"path": f"{tmp_path}/none"})
    assert (raised.value.filename, raised.value.strerror) == (f"{tmp_path}/none", "No such file or directory")


def test_memory_is_limited_and_told():
    with pytest.raises(
        ProcessDiedError,
        match=r"^ran out of memory \(its limit is 0\.5 GiB more than it had at the start\) after it had taken 0",
    ):
        call_in_child(f"{DYING}:take_memory", {"gib": 1.0}, memory_bytes=1 << 29)
    assert call_in_child(f"{DYING}:take_memory", {"gib": 0.25}, memory_bytes=1 << 29) == 1 << 28


def test_time_is_limited():
    start = time.monotonic()
    with pytest.raises(ProcessDiedError, match=r"^took longer than 1 s"):
        call_in_child(f"{DYING}:wait", {"seconds": 60.0, "ignore_interrupts": True}, time_s=1.0)
    assert time.monotonic() - start < 30.0


def test_what_it_writes_goes_to_its_log_with_the_place_of_a_crash(child, tmp_path, capfd):
    log = tmp_path / "stage.log"
    child.call(f"{DYING}:write_and_warn", {}, log=log)
    with pytest.raises(ProcessDiedError, match="SIGSEGV"):
        child.call(f"{DYING}:read_address_zero", {}, log=log)
    with pytest.raises(ProcessDiedError, match="fault in finray itself"):
        child.call(f"{DYING}:stumble", {}, log=log)
    text = log.read_text()
    assert "to standard output\n" in text
    assert "from a library\n" in text
    assert "UserWarning: a warning" in text
    assert "Fatal Python error: Segmentation fault" in text
    assert "in read_address_zero" in text
    assert "TypeError: a fault of ours" in text
    assert capfd.readouterr() == ("", "")


def test_limits_of_threads_are_passed_on(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert call_in_child(f"{DYING}:environment", {"name": "NUMBA_NUM_THREADS"}) == "1"
    assert call_in_child(f"{DYING}:environment", {"name": "PYTHONFAULTHANDLER"}) == "1"


def test_a_file_of_the_users_folder_is_not_imported(tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')")
    monkeypatch.chdir(tmp_path)
    assert call_in_child(f"{DYING}:add", {"a": 1.0, "b": 1.0})["sum"] == 2.0


def parent_and_its_children(ignore_interrupts: bool) -> "tuple[subprocess.Popen[str], list[int]]":
    code = f"from {DYING} import main_waiting_for_a_child; main_waiting_for_a_child({ignore_interrupts})"
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.fspath(ROOT)},
    )  # fmt: skip
    assert parent.stdout is not None
    return parent, [int(word) for word in parent.stdout.readline().split()]


@pytest.mark.parametrize("ignore_interrupts", [False, True])
def test_ctrl_c_ends_the_parent_its_child_and_its_childs_child(ignore_interrupts):
    parent, pids = parent_and_its_children(ignore_interrupts)
    assert len(pids) == 2
    assert all(is_running(pid) for pid in pids)
    parent.send_signal(signal.SIGINT)
    _, said = parent.communicate(timeout=30.0)
    assert "KeyboardInterrupt" in said
    assert gone_within(pids, 5.0)


def test_a_killed_parent_leaves_no_child():
    parent, pids = parent_and_its_children(ignore_interrupts=True)
    parent.kill()
    parent.communicate(timeout=30.0)
    assert gone_within(pids[:1], 5.0)
    os.kill(pids[1], signal.SIGKILL)  # of the child's child nobody knows any more


def test_a_stopped_parent_stops_its_child_and_goes_on_with_it():
    parent, pids = parent_and_its_children(ignore_interrupts=False)
    parent.send_signal(signal.SIGTSTP)
    deadline = time.monotonic() + 10.0
    while (_state(parent.pid), _state(pids[0])) != ("T", "T"):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    parent.send_signal(signal.SIGCONT)
    while _state(pids[0]) != "S":
        assert time.monotonic() < deadline
        time.sleep(0.02)
    parent.send_signal(signal.SIGINT)
    parent.communicate(timeout=30.0)
    assert gone_within(pids, 5.0)


def test_free_memory_is_some_of_the_machines():
    left, total = memory_left()
    kib = re.search(r"MemTotal:\s+(\d+) kB\n", Path("/proc/meminfo").read_text())
    swap = re.search(r"SwapTotal:\s+(\d+) kB\n", Path("/proc/meminfo").read_text())
    assert 0 < left <= total <= 1024 * (int(kib[1]) + int(swap[1]))


def _state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
