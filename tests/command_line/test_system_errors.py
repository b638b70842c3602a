"""What the operating system refuses is told in sentences: what, where, what to do; never as ``[Errno 28]``."""

import errno
import os
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest

from data_schemas import CameraSettings, FilterWheelSettings, FinrayError, system_words
from data_schemas.storage import ProductSet, write_bytes
from finray_calib.cli import main as command
from rigs import TerminalOperator, open_rig_camera, open_rig_laser, open_rig_wheel, paper_rig
from tests.capture.drivers.programs import free_port
from tests.command_line.running import finray

FINRAY = [sys.executable, "-m", "finray_calib.cli.main"]


def test_words_of_the_system_have_no_number() -> None:
    assert system_words(OSError(errno.ENOSPC, "No space left on device")) == "no space left on device"
    named = OSError(errno.ENOENT, "No such file or directory", "/dev/ttyUSB0")
    twice = OSError(f"could not open port: {named}")
    assert system_words(twice) == "could not open port: No such file or directory: '/dev/ttyUSB0'"
    assert system_words(TimeoutError()) == "it took too long"
    assert system_words(ConnectionResetError()) == "the other end closed the connection"
    assert system_words(BlockingIOError()) == "BlockingIOError"
    assert system_words(termios.error(errno.EIO, "Input/output error")) == "input/output error"
    assert system_words(ValueError("XML is broken")) == "XML is broken"


@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_file_that_the_disk_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OSError, match="No space left on device") as raised:
        write_bytes(tmp_path / "rig.toml", b"name")
    assert raised.value.filename == str(tmp_path / "rig.toml")
    with pytest.raises(OSError, match="No space left on device") as raised, ProductSet(tmp_path / "paint.json") as kept:
        kept.add(tmp_path / "paint.json", b"{}")
    assert raised.value.filename == str(tmp_path / "paint.json")
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "this computer: no space left on device; free space on the disk"),
        (errno.EPIPE, "this computer: broken pipe; a process that finray talked to has ended"),
        (errno.EMFILE, "this computer: too many open files; allow more open files with 'ulimit -n 4096'"),
        (errno.ENOTSUP, "this computer: operation not supported; 'finray doctor' lists what this computer lacks"),
    ],
)
def test_an_error_without_a_file_says_what_to_do(monkeypatch: pytest.MonkeyPatch, number: int, said: str) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("finray_calib.cli._rig.require_new", refuse)
    outcome = finray("rig init")
    assert outcome.status == command.USER_MISTAKE
    assert outcome.err.startswith(f"finray rig: error: {said}")


def ended(arguments: str, folder: Path, **streams: object) -> subprocess.CompletedProcess[bytes]:
    command_line = [*FINRAY, *arguments.split()]
    return subprocess.run(command_line, cwd=folder, stdin=subprocess.DEVNULL, timeout=120, check=False, **streams)  # type: ignore[call-overload, no-any-return]


@pytest.mark.parametrize("arguments", ["rig init", "--version"])
def test_output_that_finds_no_space(tmp_path: Path, arguments: str) -> None:
    with Path("/dev/full").open("wb") as full:
        ran = ended(arguments, tmp_path, stdout=full, stderr=subprocess.PIPE)
    assert ran.returncode == command.USER_MISTAKE
    assert ran.stderr.decode().splitlines() == [
        f"finray {arguments.split()[0]}: error: standard output cannot be written: no space left on device; send the "
        "output to another file, or to the terminal. Files already written are complete"
    ]


def test_output_that_nobody_reads(tmp_path: Path) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        ran = ended("rig init", tmp_path, stdout=theirs, stderr=subprocess.PIPE)
    finally:
        os.close(theirs)
    assert ran.returncode == command.USER_MISTAKE
    (line,) = ran.stderr.decode().splitlines()
    assert "standard output cannot be written: the program that read it has ended (such as 'head' behind" in line
    assert (tmp_path / "rig.toml").exists()


def test_a_log_without_space_ends_nothing(tmp_path: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        ran = ended("rig show none.toml", tmp_path, stdout=subprocess.PIPE, stderr=full)
        assert ran.returncode == command.USER_MISTAKE
        ran = ended("rig init", tmp_path, stdout=subprocess.PIPE, stderr=full)
    assert ran.returncode == 0


def test_streams_that_are_closed_do_no_harm(tmp_path: Path) -> None:
    close_all = f"exec {' '.join(FINRAY)} rig init <&- >&- 2>&-"
    ran = subprocess.run(["/bin/sh", "-c", close_all], cwd=tmp_path, timeout=120, check=False)
    assert ran.returncode == 0
    assert (tmp_path / "rig.toml").read_text(encoding="utf-8").startswith("# A calibration rig.")


CLOSED = f"127.0.0.1:{free_port()}"


def wheel(driver: str, address: str) -> Callable[[], object]:
    filters = paper_rig({}).filter_wheel.filters
    rig = paper_rig({}).model_copy(
        update={"filter_wheel": FilterWheelSettings(driver=driver, address=address, filters=filters)}
    )
    return lambda: open_rig_wheel(rig, Path(), TerminalOperator()).__enter__()


def camera(driver: str, address: str) -> Callable[[], object]:
    rig = paper_rig({}).model_copy(update={"camera": CameraSettings(driver=driver, address=address, bit_depth=8)})
    return lambda: open_rig_camera(rig, Path()).__enter__()


def laser(driver: str, address: str) -> Callable[[], object]:
    settings = paper_rig({}).laser.model_copy(update={"driver": driver, "address": address})
    rig = paper_rig({}).model_copy(update={"laser": settings})
    return lambda: open_rig_laser(rig, Path()).__enter__()


@pytest.mark.parametrize(
    ("opening", "said"),
    [
        (wheel("thorlabs", "/dev/none"), "cannot be opened .*check cable and power"),
        (wheel("thorlabs", f"socket://{CLOSED}"), "cannot be opened .*check cable and power"),
        (wheel("indi", f"{CLOSED}/Wheel"), r"nothing listens at .*\(connection refused\); start indiserver"),
        (wheel("indi", "none.invalid/Wheel"), r"nothing listens at none.invalid:7624 \(.*start indiserver"),
        (wheel("alpaca", f"http://{CLOSED}/0"), r"no answer from .*\(connection refused\); start the Alpaca"),
        (camera("mjpeg", f"http://{CLOSED}/stream"), r"cannot be reached \(connection refused\); start the cam"),
        (laser("arduino", "/dev/none"), "cannot be opened .*check cable and power"),
        (laser("indi", f"{CLOSED}/Panel"), r"nothing listens at .*\(connection refused\); start indiserver"),
    ],
)
def test_devices_out_of_reach_are_told_in_words(opening: Callable[[], object], said: str) -> None:
    with pytest.raises(FinrayError, match=said) as raised:
        opening()
    assert "Errno" not in str(raised.value)
