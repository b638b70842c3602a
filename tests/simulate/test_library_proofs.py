"""Libraries that do not run here: their death is a sentence, told once, and the work goes on without them."""

import json
import os
import re
import shutil
import signal
import sys
from pathlib import Path

import pytest

from data_schemas import MissingExtraError, SimulateError
from sim import _library_proofs as library_proofs
from sim import proof_failure
from sim.mechanics import _contact_library as contact_library
from sim.mechanics import _press as press
from sim.mechanics import chosen_contact
from sim.mechanics._contact_library import contact_library_failure
from sim.optics import _renderer as variants

DYING = "tests.simulate.test_library_proofs"


def die(how: str, calls: str) -> None:
    """Note that it was called, and end the process or raise."""
    with Path(calls).open("a") as file:
        file.write("called\n")
    if how == "raise":
        raise SimulateError("gave nonsense")
    if how:
        os.kill(os.getpid(), signal.Signals[how])


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache/finray-calib/proofs"


@pytest.mark.parametrize(
    ("how", "failure", "made"),
    [
        ("", None, 1),
        ("SIGILL", "was ended by SIGILL (a compiled library uses instructions that this processor does not have)", 1),
        ("SIGKILL", "was killed (SIGKILL)", 2),  # want of memory goes by
        ("raise", "gave nonsense", 2),
    ],
)
def test_what_will_be_the_same_again_is_remembered(
    cache: Path, tmp_path: Path, how: str, failure: str | None, made: int
) -> None:
    calls = tmp_path / "calls"
    for _ in range(2):
        told = proof_failure(f"{DYING}:die", {"how": how, "calls": str(calls)}, ["json"])
        assert told is None if failure is None else str(told).startswith(failure)
    assert calls.read_text() == "called\n" * made
    assert len(list(cache.glob("*.json"))) == (made == 1)


def test_a_changed_library_is_tried_again(cache: Path, tmp_path: Path) -> None:
    calls, library = tmp_path / "calls", tmp_path / "library.so"
    for content in (b"first", b"second one", b"second one"):
        if not library.exists() or library.read_bytes() != content:
            library.write_bytes(content)
        assert proof_failure(f"{DYING}:die", {"how": "", "calls": str(calls)}, [str(library)]) is None
    assert calls.read_text() == "called\n" * 2
    assert len(list(cache.glob("*.json"))) == 2


@pytest.mark.parametrize("content", ["", "[]", '{"failure": 3}', "{", "\x00" * 100])
def test_a_broken_note_is_no_proof(cache: Path, tmp_path: Path, content: str) -> None:
    calls = tmp_path / "calls"
    for _ in range(2):
        assert proof_failure(f"{DYING}:die", {"how": "", "calls": str(calls)}, ["json"]) is None
        note = next(cache.glob("*.json"))
        if json.loads(note.read_text()) == {"failure": ""}:
            note.write_text(content)
    assert calls.read_text() == "called\n" * 2


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cache").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert proof_failure(f"{DYING}:die", {"how": "", "calls": str(tmp_path / "calls")}, ["json"]) is None


def test_another_processor_is_another_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    from llvmlite import binding

    here = library_proofs._name("json:loads", {}, ["json"])  # noqa: SLF001
    features = binding.get_host_cpu_features().flatten()
    other = type("Features", (), {"flatten": lambda self: features.replace("+sse2", "-sse2")})()
    monkeypatch.setattr(binding, "get_host_cpu_features", lambda: other)
    assert library_proofs._name("json:loads", {}, ["json"]) != here  # noqa: SLF001


@pytest.fixture
def no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(press, "contact_library_failure", lambda: "ipctk 9 does not run here")


@pytest.mark.usefixtures("no_library")
def test_without_the_library_only_the_barrier_is_refused() -> None:
    assert chosen_contact() == "penalty"
    with pytest.raises(MissingExtraError, match=r"^--contact barrier is not possible here: ipctk 9 does"):
        chosen_contact("barrier")


@pytest.mark.parametrize(
    ("installed", "message"),
    [
        ("1.6.1", "ipctk 1.6.1 does not run here: its trial was ended.*; version 1.6.0 runs on every x86-64 processor"),
        ("1.6.0", "ipctk 1.6.0 does not run here: its trial was ended.*; it needs an x86-64 processor with AVX2"),
    ],
)
def test_the_message_names_a_version_that_works(installed: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_library, "is_installed", lambda name: True)
    monkeypatch.setattr(contact_library, "version", lambda name: installed)
    monkeypatch.setattr(contact_library, "proof_failure", lambda *arguments: "was ended by SIGILL")
    contact_library_failure.cache_clear()
    try:
        told = contact_library_failure()
    finally:
        contact_library_failure.cache_clear()
    assert told is not None
    assert re.match(message, told)


@pytest.mark.rigs
def test_on_an_emulated_processor_without_avx_libraries_die_and_a_press_goes_on(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """QEMU's Nehalem has neither AVX nor AVX2, which the wheels of Mitsuba and ipctk use."""
    emulator = shutil.which("qemu-x86_64")
    if emulator is None or os.uname().machine != "x86_64":
        pytest.skip("QEMU ABSENT: apt-get install qemu-user; the death of a library was NOT seen")
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec {emulator} -cpu Nehalem {sys.executable} "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    variants.prove_variant.cache_clear()
    with pytest.raises(
        MissingExtraError, match=r"^Mitsuba does not run here, because the test picture was ended by SIGILL"
    ):
        variants.choose_variant("auto", libraries=[])
    contact_library_failure.cache_clear()
    try:
        assert "its trial was ended by SIGILL (a compiled library uses instructions" in str(contact_library_failure())
        assert chosen_contact() == "penalty"
        assert len(list(cache.glob("*.json"))) == 2
    finally:
        contact_library_failure.cache_clear()
        variants.prove_variant.cache_clear()
