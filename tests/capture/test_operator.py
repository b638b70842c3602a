"""The person at the terminal: what counts as an answer, on a pseudo-terminal and without one."""

import os
import pty
import select
import subprocess
import sys
import time

import pytest

ASK = """
import sys, time
from rigs import TerminalOperator
sys.stderr.write("begun")
sys.stderr.flush()
time.sleep(float(sys.argv[1]))
print("allowed" if TerminalOperator().allows("May the laser be lit?") else "not allowed", flush=True)
"""
DO = """
import sys, time
from rigs import TerminalOperator
sys.stderr.write("begun")
sys.stderr.flush()
time.sleep(0.5)
TerminalOperator().do("Close the box.")
print("went on", flush=True)
"""
QUESTION = b"anything else counts as no. "


def read_until(terminal: int, wanted: bytes) -> bytes:
    """What the program writes to its terminal, up to a text; a minute is for a computer that is busy."""
    said, end_s = b"", time.monotonic() + 60.0
    while wanted not in said and select.select([terminal], [], [], max(end_s - time.monotonic(), 0.0))[0]:
        try:
            said += os.read(terminal, 4096)
        except OSError:  # the program has ended
            break
    return said


def answered(keys: bytes, typed_ahead: bytes = b"") -> bytes:
    """What the program says after keys were pressed at its question, and others before it."""
    ours, theirs = pty.openpty()
    try:
        wait_s = "0.5" if typed_ahead else "0"
        with subprocess.Popen([sys.executable, "-c", ASK, wait_s], stdin=theirs, stdout=theirs, stderr=theirs):
            os.close(theirs)
            before = read_until(ours, b"begun")
            os.write(ours, typed_ahead)
            before += read_until(ours, QUESTION)
            assert b"May the laser be lit?" in before
            os.write(ours, keys)
            return read_until(ours, b"allowed")
    finally:
        os.close(ours)


@pytest.mark.parametrize("keys", [b"yes\n", b" YES \n"])
def test_only_yes_allows_a_light(keys: bytes) -> None:
    said = answered(keys)
    assert b"allowed" in said
    assert b"not allowed" not in said


@pytest.mark.parametrize("keys", [b"\n", b"y\n", b"no\n", b"\x04"], ids=["Enter", "y", "no", "end of input"])
def test_anything_else_does_not(keys: bytes) -> None:
    assert b"not allowed" in answered(keys)


def test_keys_pressed_before_the_question_do_not_count() -> None:
    assert b"not allowed" in answered(b"\n", typed_ahead=b"yes\n")


def test_enter_pressed_before_an_instruction_does_not_acknowledge_it() -> None:
    """Or the laser would go on while hands are in the box."""
    ours, theirs = pty.openpty()
    try:
        with subprocess.Popen([sys.executable, "-c", DO], stdin=theirs, stdout=theirs, stderr=theirs) as child:
            os.close(theirs)
            read_until(ours, b"begun")
            os.write(ours, b"\n\n")
            assert b"Press Enter when done. " in read_until(ours, b"Press Enter when done. ")
            with pytest.raises(subprocess.TimeoutExpired):
                child.wait(1.0)
            os.write(ours, b"\n")
            assert b"went on" in read_until(ours, b"went on")
    finally:
        os.close(ours)


def test_nobody_is_asked_without_a_terminal() -> None:
    ran = subprocess.run([sys.executable, "-c", ASK, "0"], input=b"yes\n", capture_output=True, timeout=60, check=True)
    assert ran.stdout == b"not allowed\n"
    assert QUESTION not in ran.stderr
