"""What a machine needs to run the demo, each checked in a process of its own, so that a crash is a result as well.

Every ``check_*`` function runs in such a process and returns what it found as JSON: "good"; "note" where the demo runs
without it, slower or with less; "bad" where it does not run; and the command that mends it.
"""

import os
import platform
import re
import shlex
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import Final, Literal

from data_schemas import FinrayError, ProcessDiedError
from data_schemas.storage import Child

State = Literal["good", "note", "bad"]
Found = dict[str, str]

LIMIT_S: Final = 13.0
"""For all checks together; starting and ending takes another second."""
AT_ONCE: Final = 3
OLDEST_PYTHON: Final = (3, 11)
MEMORY_BYTES: Final = 1_500_000_000  # the demo's peak, measured, and a little
DISK_BYTES: Final = 420_000_000
LINE: Final = 80
_SIM_PACKAGES: Final = "pip install --upgrade 'finray-calib[sim]'"


@dataclass(frozen=True, slots=True)
class Check:
    """A part of the machine that is looked at.

    Attributes
    ----------
    name
        What is looked at.
    function
        "module:function" that looks.
    if_dead
        What it means where that function's process dies.
    mend
        What helps then.
    """

    name: str
    function: str
    if_dead: State
    mend: str


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found: its state, in words, and the command that mends it ("" where nothing is to be done)."""

    name: str
    state: State
    found: str
    mend: str


_HERE: Final = "finray_calib.demo._machine_checks"
CHECKS: Final = (
    Check("Python", f"{_HERE}:check_python", "bad", "install finray-calib again, into a new virtual environment"),
    Check("processor", f"{_HERE}:check_processor", "note", ""),
    Check("renderer", f"{_HERE}:check_renderer", "bad", "sudo apt-get install libllvm19"),
    Check("contact", f"{_HERE}:check_contact", "note", _SIM_PACKAGES),
    Check("solver", f"{_HERE}:check_solver", "bad", "pip uninstall pypardiso mkl   (SciPy's solver takes over)"),
    Check("compiler", f"{_HERE}:check_compiler", "bad", "pip install --upgrade --force-reinstall numba llvmlite"),
    Check("memory", f"{_HERE}:check_memory", "note", ""),
    Check("disk", f"{_HERE}:check_disk", "bad", "work in a folder on a disk that responds"),
    Check("caches", f"{_HERE}:check_caches", "bad", "export XDG_CACHE_HOME=/a/folder/that/you/may/write"),
    Check("serial ports", f"{_HERE}:check_serial_ports", "note", ""),
    Check("drivers", f"{_HERE}:check_drivers", "note", "pip uninstall the package whose driver crashes"),
)


def check_machine(limit_s: float = LIMIT_S, checks: tuple[Check, ...] = CHECKS) -> Iterator[Finding]:
    """Run all checks, some of them at the same time, and yield their findings in the order of the checks.

    Parameters
    ----------
    limit_s
        For all checks; one that has not answered by then is reported so.
    checks
        What to look at.
    """
    deadline_s = time.monotonic() + limit_s
    running, end_all = set[Child](), threading.Event()

    def look(check: Check) -> Finding:
        left_s = deadline_s - time.monotonic()
        if end_all.is_set() or left_s <= 0.0:
            return _unanswered(check, limit_s)
        with Child() as child:
            running.add(child)
            try:
                found = child.call(check.function, {}, time_s=left_s)
                return Finding(check.name, found["state"], found["found"], found["mend"])
            except ProcessDiedError as died:
                if time.monotonic() >= deadline_s:
                    return _unanswered(check, limit_s)
                return Finding(check.name, check.if_dead, f"its trial {died}", check.mend)
            except (FinrayError, OSError) as error:
                return Finding(check.name, check.if_dead, str(error), check.mend)
            finally:
                running.discard(child)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        try:
            yield from pool.map(look, checks)
        finally:  # also when the reader of these findings is interrupted
            end_all.set()
            for child in tuple(running):
                child.kill()


def _unanswered(check: Check, limit_s: float) -> Finding:
    """Return the finding of a check that took too long."""
    again = "run 'finray doctor' again when the machine is less busy"
    return Finding(check.name, "note", f"no answer within {limit_s:.0f} s", again)


def _good(found: str) -> Found:
    return {"state": "good", "found": found, "mend": ""}


def _note(found: str, mend: str = "") -> Found:
    return {"state": "note", "found": found, "mend": mend}


def _bad(found: str, mend: str) -> Found:
    return {"state": "bad", "found": found, "mend": mend}


def check_python() -> Found:
    """Look at the interpreter, its environment and the packages that finray-calib requires."""
    said = f"{platform.python_version()} at {sys.executable}"
    if sys.version_info < OLDEST_PYTHON:
        return _bad(said, "install Python 3.11 or newer, and finray-calib with it: make PYTHON=python3.12 demo")
    lacking = [why for text in _requirements() if (why := _lacking(text))]
    if lacking:
        return _bad(f"{said}; {', '.join(lacking)}", "pip install --upgrade finray-calib")
    return _good(said)


def _requirements() -> list[str]:
    """Return what finray-calib requires without extras, on every machine."""
    try:
        return [text for text in metadata.requires("finray-calib") or () if ";" not in text]
    except metadata.PackageNotFoundError:
        return []


def _lacking(requirement: str) -> str | None:
    """Return in words that a package is missing or too old, or None."""
    name, _, oldest = requirement.partition(">=")
    try:
        there = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"{name} is missing"
    return f"{name} {there} is older than {oldest}" if _numbers(there) < _numbers(oldest) else None


def _numbers(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version."""
    match = re.match(r"\d+(\.\d+)*", version)
    return tuple(map(int, match[0].split("."))) if match else ()


def check_processor() -> Found:
    """Look at the cores that this process may use, and at the vector instructions of the processor."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    machine = platform.machine()
    said = f"{cores} core{'s' if cores > 1 else ''}, {machine}"
    if machine not in ("x86_64", "AMD64"):
        return _good(said)
    # it asks the processor itself, where /proc/cpuinfo may be another machine's
    features = import_module("llvmlite.binding").get_host_cpu_features()
    if not features.get("avx2"):
        return _note(f"{said}, without AVX2: compiled packages may stop with SIGILL", "use a processor made after 2014")
    return _good(f"{said}, AVX2, {'AVX-512' if features.get('avx512f') else 'no AVX-512'}")


def check_renderer() -> Found:
    """Render a small picture as the demo would."""
    variants = import_module("sim.optics._renderer")
    try:
        version = metadata.version("mitsuba")
    except metadata.PackageNotFoundError:
        return _bad("Mitsuba is not installed: no rendering and no demo", _SIM_PACKAGES)
    scalar = variants.prove_variant(variants.SCALAR_VARIANT)
    if scalar is not None:
        library = scalar.partition(variants.ABSENT)[2]
        mend = variants.install_command(library) if library else _SIM_PACKAGES
        return _bad(f"Mitsuba {version} does not run: {scalar}", mend)
    choice = variants.choose_variant()
    if not choice.fell_back:
        return _good(f"Mitsuba {version}, {choice.note}")
    why = choice.note.rpartition("; ")[0]
    return _note(
        f"Mitsuba {version} without compiler, {choice.variant}: fewer paths, more noise; {why}",
        "sudo apt-get install libllvm19   (and unset DRJIT_LIBLLVM_PATH, if it is set)",
    )


def check_contact() -> Found:
    """Use the library by which surfaces collide."""
    try:
        version = metadata.version("ipctk")
    except metadata.PackageNotFoundError:
        return _note("ipctk is not installed: no contact among ribs", _SIM_PACKAGES)
    library = import_module("sim.mechanics._contact_library")
    failure = library.contact_library_failure()
    if failure is not None:
        return _note(failure.partition(";")[0], f"pip install ipctk=={library.WORKING_VERSION}")
    return _good(f"ipctk {version}")


def check_solver() -> Found:
    """Solve a small system of equilibrium."""
    import numpy as np
    import scipy.sparse as sp

    try:
        solvers = import_module("sim.mechanics._linear_solver")
    except ModuleNotFoundError as missing:
        return _bad(f"{missing.name} is not installed: no presses by finite elements", _SIM_PACKAGES)
    solver = solvers.linear_solver()
    solver.factorise(sp.csr_array(np.diag([2.0, 4.0, 8.0])), 0)
    if not np.allclose(solver.solve(np.array([2.0, 4.0, 8.0])), 1.0, atol=1e-12):
        return _bad(f"{type(solver).__name__} gives a wrong solution", _SIM_PACKAGES)
    if type(solver).__name__ == "Pardiso":
        return _good(f"MKL PARDISO, pypardiso {metadata.version('pypardiso')}")
    found = "SuperLU of SciPy: presses take several times as long as with MKL's PARDISO"
    return _note(found, "pip install pypardiso") if platform.machine() == "x86_64" else _good(found)


def check_compiler() -> Found:
    """Run a small function that Numba compiles."""
    import numba

    if numba.njit(lambda x: x + 1.0)(1.0) != 2.0:
        return _bad(f"Numba {numba.__version__} computes 1 + 1 wrongly", "pip install --force-reinstall numba llvmlite")
    return _good(f"Numba {numba.__version__}, {numba.config.NUMBA_NUM_THREADS} threads")


def check_memory() -> Found:
    """Look at the memory that is left, for the machine and for this process's control group."""
    from data_schemas.storage import memory_left

    left, whole = memory_left()
    said = f"{left / 2**30:.1f} of {whole / 2**30:.1f} GiB free"
    if left >= MEMORY_BYTES:
        return _good(said)
    return _bad(f"{said}; the demo takes {MEMORY_BYTES / 1e9:.1f} GB", "close other programs, or add swap space")


def check_disk() -> Found:
    """Look at the space here and in the folder of temporary files, by writing a little there."""
    here = Path.cwd()
    free = os.statvfs(here)
    said = f"{free.f_bavail * free.f_frsize / 1e9:.1f} GB free in {here}"
    for folder in (here, Path(tempfile.gettempdir())):
        if (why := _cannot_write(folder)) is not None:
            return _bad(
                f"{folder} cannot be written to: {why}",
                f"work in another folder, or see how full this disk is: df -h {_quoted(folder)}",
            )
    if free.f_bavail * free.f_frsize < DISK_BYTES:
        return _bad(f"{said}; the demo takes {DISK_BYTES / 1e6:.0f} MB", "delete something, or work on another disk")
    return _good(said)


def check_caches() -> Found:
    """Look at the folders in which Numba and the renderer keep compiled code."""
    import numba

    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    numbas = Path(numba.config.CACHE_DIR or home / "finray-calib")
    renderers = Path.home() / ".drjit"
    for folder, what in ((numbas, "Numba"), (renderers, "the renderer")):
        if (why := _cannot_write(folder)) is None:
            continue
        if folder == renderers:
            return _note(
                f"{folder} cannot be written to: {why}; {what} is compiled again each time",
                f"chmod u+rwx {_quoted(folder)}",
            )
        mend = "export NUMBA_CACHE_DIR=/a/folder/that/you/may/write"
        return _bad(f"{folder} cannot be written to: {why}; {what} stores its compiled functions there", mend)
    return _good(f"{_short(numbas)} (Numba), {_short(renderers)} (renderer)")


def _cannot_write(folder: Path) -> str | None:
    """Return why nothing can be written into a folder, which need not exist yet; None when it can."""
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    try:
        with tempfile.NamedTemporaryFile(dir=there, prefix=".finray-doctor-") as file:
            file.write(bytes(1 << 16))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return None


def check_serial_ports() -> Found:
    """Look at the serial ports behind USB and whether this user may open them; none is opened."""
    ports = import_module("rigs.transports._serial_link").usb_serial_ports()
    closed = [port.address for port in ports if not os.access(port.address, os.R_OK | os.W_OK)]
    if closed:
        return _note(f"your user has no permission to open {', '.join(closed)}", _way_in(Path(closed[0])))
    if not ports:
        return _good("no serial port on USB (needed for a real rig only)")
    return _good(", ".join(port.address for port in ports))


def check_drivers() -> Found:
    """Look at what other packages bring, drivers and others: each must be importable, whole and of one name."""
    from data_schemas import INDENTER_SHAPES, MATERIALS, PAD_SHAPES, find_plug_in, plug_ins
    from finray_calib.compare import METRICS
    from finray_calib.exchange import IMPORT_FORMATS
    from rigs import driver_module, drivers_of_other_packages, find_driver

    others = drivers_of_other_packages()
    parts = [
        one for kind in (IMPORT_FORMATS, MATERIALS, INDENTER_SHAPES, PAD_SHAPES, METRICS) for one in plug_ins(kind)
    ]
    wrong = []
    for part in parts:
        try:
            find_plug_in(part.kind, part.name).load()
        except FinrayError as error:
            wrong.append(str(error))
    for driver in others:
        try:
            driver_module(find_driver(driver.kind, driver.name))
        except FinrayError as error:
            wrong.append(str(error))
    if wrong:
        found, _, mend = wrong[0].partition("; ")
        return _note(found, mend)
    drivers = [f"{driver.kind} {driver.label}" for driver in others]
    named = ", ".join([*drivers, *(f"{part.kind.noun} {part.name} ({part.source})" for part in parts)])
    return _good(named or "those of finray-calib; no other installed package adds one")


def _way_in(port: Path) -> str:
    """Return the command that lets this user open a serial port."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(port.stat().st_gid), pwd.getpwuid(os.getuid()).pw_name
    except (OSError, KeyError):
        return f"ls -l {_quoted(port)}   (its owner and group may open it)"
    if user in group.gr_mem:
        return f"log in again, because you are in the group {group.gr_name} only since your last login"
    return f"sudo usermod --append --groups {group.gr_name} {shlex.quote(user)}   (then log in again)"


def _short(folder: Path) -> str:
    """Return a folder with ~ for the user's own."""
    home = Path.home()
    return f"~/{folder.relative_to(home)}" if folder.is_relative_to(home) else str(folder)


def _quoted(path: Path) -> str:
    return shlex.quote(os.fspath(path))
