"""``finray doctor``: each poisoned machine gets its line, and the doctor itself never dies."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from finray_calib.cli._demo import line_of
from finray_calib.demo import Finding, check_machine
from finray_calib.demo import _machine_checks as machine_checks
from finray_calib.demo._machine_checks import CHECKS, Check

ROOT = Path(__file__).resolve().parents[2]
BUSY_S = 120.0  # a machine that runs other tests is slower than a user's


def finding(name: str) -> Finding:
    """Look at one part of this machine as it is poisoned."""
    (found,) = check_machine(BUSY_S, tuple(check for check in CHECKS if check.name == name))
    return found


def fake_module(folder: Path, name: str, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(code)
    monkeypatch.setattr(sys, "path", [os.fspath(folder), *sys.path])


DIES = "import os, signal\nos.kill(os.getpid(), signal.SIGILL)\n"


@pytest.mark.renderer
def test_this_machine_is_told_on_one_screen():
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-P", "-m", "finray_calib.cli.main", "doctor"], capture_output=True, text=True, timeout=BUSY_S,
        env={**os.environ, "PYTHONPATH": os.fspath(ROOT)}, check=False,
    )  # fmt: skip
    assert time.monotonic() - start < 60.0  # 15 s on a machine that does nothing else
    lines = done.stdout.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    for check in CHECKS:
        assert re.search(rf"^  (good|note|bad)  ?{check.name} ", done.stdout, re.MULTILINE), done.stdout
    assert (done.returncode, done.stderr) == (int("  bad " in done.stdout), "")
    assert ("This machine can run the demo." in lines) == (done.returncode == 0)


@pytest.mark.renderer
def test_a_machine_without_llvm_renders_by_the_scalar_variant(monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    found = finding("renderer")
    assert found.state == "note"
    assert re.search(
        r"without compiler, scalar_rgb: fewer paths, more noise; /nowhere/libLLVM\.so: the test picture", found.found
    )
    assert "apt-get install libllvm19" in found.mend


def test_a_contact_library_for_another_processor_is_told(tmp_path, monkeypatch):
    fake_module(tmp_path / "fake", "ipctk", DIES, monkeypatch)
    found = finding("contact")
    assert found.state == "note"
    assert "SIGILL (a compiled library uses instructions that this processor does not have)" in found.found
    assert "pip install" in found.mend


def test_a_compiler_that_dies_is_told_and_nothing_else_dies(tmp_path, monkeypatch):
    fake_module(tmp_path / "fake", "numba", DIES, monkeypatch)
    states = {found.name: found for found in check_machine(BUSY_S, tuple(c for c in CHECKS if c.name != "renderer"))}
    assert len(states) == len(CHECKS) - 1
    assert states["compiler"].state == "bad"
    assert "SIGILL" in states["compiler"].found
    assert states["disk"].state == "good"


def unwritable_folder(tmp_path: Path) -> Path:
    """Return a folder that even root cannot write to."""
    if os.geteuid() == 0:
        return Path("/proc")
    tmp_path.chmod(0o555)
    return tmp_path


def test_caches_that_cannot_be_written_are_told(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", os.fspath(unwritable_folder(tmp_path)))
    found = finding("caches")
    assert found.state == "bad"
    assert re.search(r"finray-calib cannot be written to: \w.*; Numba stores its compiled functions there", found.found)
    assert found.mend == "export NUMBA_CACHE_DIR=/a/folder/that/you/may/write"


def test_a_renderers_cache_that_cannot_be_written_is_a_note(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", os.fspath(tmp_path))
    monkeypatch.setenv("HOME", os.fspath(unwritable_folder(tmp_path)))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if os.geteuid() != 0:
        monkeypatch.setenv("NUMBA_CACHE_DIR", "/tmp")
    found = finding("caches")
    assert found.state == "note"
    assert ".drjit cannot be written to" in found.found


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 kB that is full."""
    folder = tmp_path / "small"
    folder.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "none", folder], capture_output=True, check=False
    ).returncode:
        pytest.skip("a full disk needs a file system of its own, which this user may not mount")
    (folder / "full").write_bytes(bytes(1 << 16))
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)


def test_a_full_disk_is_told(small_disk, monkeypatch):
    monkeypatch.chdir(small_disk)
    found = finding("disk")
    assert found.state == "bad"
    assert "small cannot be written to: no space left on device" in found.found
    assert found.mend.startswith("work in another folder, or see how full this disk is: df -h ")


def test_a_disk_with_too_little_space_is_told(monkeypatch):
    monkeypatch.setattr(machine_checks, "DISK_BYTES", 10**18)
    found = machine_checks.check_disk()
    assert found["state"] == "bad"
    assert re.search(r"GB free in /.*; the demo takes 1000000000000 MB", found["found"])


def test_a_machine_with_too_little_memory_is_told(monkeypatch):
    monkeypatch.setattr("data_schemas.storage.memory_left", lambda: (2**30, 2**31))
    assert machine_checks.check_memory()["found"] == "1.0 of 2.0 GiB free; the demo takes 1.5 GB"
    assert machine_checks.check_memory()["state"] == "bad"
    monkeypatch.undo()
    monkeypatch.setattr("data_schemas.storage.memory_left", lambda: (2**29, 2**30))
    assert machine_checks.check_memory()["found"].startswith("0.5 of 1.0 GiB free")


def test_packages_that_are_missing_or_old_are_told(monkeypatch):
    monkeypatch.setattr(machine_checks, "_requirements", lambda: ["numpy>=999.1", "no-such-package>=1.0", "scipy>=1.0"])
    found = machine_checks.check_python()
    assert found["state"] == "bad"
    assert re.search(r"numpy [\d.]+ is older than 999\.1, no-such-package is missing$", found["found"])


def test_an_installation_without_renderer_is_told(monkeypatch):
    version = machine_checks.metadata.version

    def without(name: str) -> str:
        if name in ("mitsuba", "ipctk"):
            raise machine_checks.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(machine_checks.metadata, "version", without)
    for check, state in ((machine_checks.check_renderer, "bad"), (machine_checks.check_contact, "note")):
        found = check()
        assert found["state"] == state
        assert "is not installed" in found["found"]
        assert found["mend"] == "pip install --upgrade 'finray-calib[sim]'"


def test_a_serial_port_that_may_not_be_opened_is_told(tmp_path, monkeypatch):
    link = machine_checks.import_module("rigs.transports._serial_link")
    port = tmp_path / "ttyUSB0"
    port.touch()
    monkeypatch.setattr(link, "usb_serial_ports", lambda: [link.UsbSerialPort(str(port), "adapter", "0403:6001")])
    assert machine_checks.check_serial_ports() == {"state": "good", "found": str(port), "mend": ""}
    monkeypatch.setattr(machine_checks.os, "access", lambda path, mode: False)
    found = machine_checks.check_serial_ports()
    assert (found["state"], found["found"]) == ("note", f"your user has no permission to open {port}")
    assert re.search(r"^sudo usermod --append --groups \w+ \w+ {3}\(then log in again\)$|^log in again", found["mend"])


def test_a_check_that_hangs_dies_or_raises_is_a_line():
    here = "tests.command_line.poisoned_machine"
    names = ("hangs", "dies", "raises", "stumbles", "is_good")
    checks = tuple(Check(name, f"{here}:{name}", "bad", f"mend what {name}") for name in names)
    start = time.monotonic()
    found = {finding.name: finding for finding in check_machine(20.0, checks)}
    assert time.monotonic() - start < 60.0
    assert list(found) == list(names)
    assert (found["hangs"].state, found["hangs"].found) == ("note", "no answer within 20 s")
    assert found["dies"].found.startswith("its trial was ended by SIGILL (a compiled library uses instructions")
    assert (found["raises"].state, found["raises"].found) == ("bad", "the library cannot be used")
    stumbled = "its trial failed because of a fault in finray itself (ZeroDivisionError: division by zero)"
    assert stumbled in found["stumbles"].found
    assert found["dies"].mend == "mend what dies"
    assert (found["is_good"].state, found["is_good"].mend) == ("good", "")


def test_a_doctor_that_is_interrupted_leaves_nothing_behind(tmp_path):
    code = (
        "from finray_calib.demo._machine_checks import Check, check_machine\n"
        "import sys\n"
        "print('looks', flush=True)\n"
        "list(check_machine(600.0, (Check('x', 'tests.command_line.poisoned_machine:hangs', 'bad', ''),) * 2))\n"
    )
    doctor = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.fspath(ROOT)},
    )  # fmt: skip
    assert doctor.stdout is not None
    doctor.stdout.readline()
    time.sleep(2.0)
    start = time.monotonic()
    doctor.send_signal(signal.SIGINT)
    doctor.communicate(timeout=60.0)
    assert time.monotonic() - start < 30.0


def test_long_findings_are_wrapped_under_their_own_column():
    lines = line_of(Finding("disk", "bad", "word " * 40, "df -h")).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("  bad  disk          word")
    assert lines[1].startswith(" " * 21 + "word")
    assert lines[-1] == " " * 21 + "-> df -h"
