"""A demo of three small stages that store real records, any of which can be poisoned; run in processes by name."""

import json
import os
import resource
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from data_schemas import errors, provenance
from data_schemas.storage import sha256_of, tell, write_record
from finray_calib.demo import run_demo
from finray_calib.demo._run import Product, Stage
from tests.command_line.records import press


def settings(out: Path, seed: int = 1) -> dict[str, Any]:
    return {
        "out": str(out), "seed": seed, "command": "finray demo", "materials": {}, "sensor": None,
        "effort": {"probe_samples": 1}, "engine": {"variant": "none"},
    }  # fmt: skip


def stage(name: str, process: str, *inputs: str) -> Stage:
    function = "tests.command_line.small_demo:store"
    product = Product(f"{name}.json", "data_schemas._simulate:SimulatedPress", inputs)
    return Stage("simulate", f"stage {name}", function, {"name": name, "inputs": inputs}, (product,), process)


STAGES = (
    stage("one", "first"),
    stage("two", "first", "one.json"),
    stage("three", "second", "one.json", "two.json"),
)
REPORT = Stage("", "the report", "tests.command_line.small_demo:report", {}, (), "second")


def store(settings: Mapping[str, Any], name: str, inputs: list[str]) -> None:
    """Take the poison for this stage, if there is one; else store a record and note that it was computed."""
    out = Path(settings["out"])
    beside = out.with_name(f"{out.name}.{name}.poison")
    if beside.exists():
        poison = json.loads(beside.read_text())
        beside.unlink()
        take(**poison)
    tell([1, 1, f"stored {name}"])
    with out.with_name(f"{out.name}.computed").open("a") as file:
        file.write(f"{name} {os.getpid()}\n")
    origin = provenance("pytest", {i: sha256_of(out / i) for i in inputs}, settings["seed"])
    write_record(press(), out / f"{name}.json", origin)


def take(number: int = 0, memory_bytes: int = 0, hangs_s: float = 0.0, refuses: str = "") -> None:
    if number:
        os.kill(os.getpid(), number)
    if memory_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, resource.RLIM_INFINITY))
        bytearray(memory_bytes)
    if refuses:
        raise errors.RefusedError(refuses)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stdout.write("hangs\n")
    sys.stdout.flush()
    time.sleep(hangs_s)


def report(settings: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, str]:
    assert set(seconds) == {"simulate"}
    (Path(settings["out"]) / "report.html").write_text("all stages")
    return {"verdict": "done", "certainty": f"{seconds['simulate']:.3f} s"}


class Bar:
    """What a progress bar was told."""

    def __init__(self) -> None:
        self.told: list[tuple[str, int, int, str]] = []

    def __call__(self, title: str) -> "Bar":
        self._title = title
        return self

    def __enter__(self) -> Any:
        return lambda done, total, what: self.told.append((self._title, done, total, what))

    def __exit__(self, *_: object) -> None:
        pass


def run(out: Path, seed: int = 1, bar: Bar | None = None) -> tuple[dict[str, Any], list[str]]:
    """Run the small demo; return what it reports, and what it said."""
    said: list[str] = []
    return run_demo(settings(out, seed), bar or Bar(), said.append, STAGES, REPORT), said


def main(out: str) -> None:
    """Run it as a program, which tells the processes of its stages when one hangs."""
    run(Path(out))
