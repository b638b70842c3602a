"""Choose a Mitsuba variant that really runs here, and open it: the one door to the renderer.

LLVM 15 and 16 load and then abort the whole process at the first compiled kernel, so a library is taken only after a
child process has rendered a small picture with it. A GPU is taken only when asked for and after the same proof. The
renderer's own writer makes OpenEXR images of single precision, so that no further package is needed.
"""

import functools
import importlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import MissingExtraError, SimulateError, note_renderer
from sim import is_installed, proof_failure

LLVM_VARIANT = "llvm_ad_rgb"
SCALAR_VARIANT = "scalar_rgb"
CUDA_VARIANT = "cuda_ad_rgb"
MINIMUM_LLVM_MAJOR = 17
MISSING_NOTE = "rendering needs Mitsuba, which is in the extra 'sim': pip install 'finray-calib[sim]'"
GPU_NOTE = "the GPU variants need an NVIDIA driver with CUDA and OptiX; use 'auto' to render on the processor"
INSTALL_NOTE = "install LLVM 17 or newer to render faster and with less noise (Debian: apt-get install libllvm19)"

ABSENT = "needs a library that this system lacks: "
"""Between "the test picture" and the library's name, where a proof failed without it."""
_LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
_PROOF = "sim.optics._renderer:render_proof_picture"
_PROOF_TIMEOUT_S = 120.0
_THREADS_OF_EXR_WRITER = 2
_LIBRARY_PATTERNS = (
    (Path(sys.prefix), "llvm/**/libLLVM*.so*"),
    (Path("/usr/lib"), "llvm-*/lib/libLLVM*.so*"),
    (Path("/usr/lib"), "*-linux-gnu/libLLVM*.so*"),
    (Path("/usr/lib64"), "libLLVM*.so*"),
    (Path("/usr/local/lib"), "libLLVM*.so*"),
    (Path("/opt/homebrew/opt"), "llvm*/lib/libLLVM*.dylib"),
)
_MODULES = ("mitsuba", "drjit")

Preference = Literal["auto", "llvm", "scalar", "cuda"]


@dataclass(frozen=True, slots=True)
class RendererChoice:
    """The variant to render with, the LLVM library behind it, a note for the user, and whether it is second choice."""

    variant: str
    llvm_library: str | None
    note: str
    fell_back: bool = False


def choose_variant(
    prefer: Preference = "auto", libraries: Sequence[str] | None = None, spectral: bool = False
) -> RendererChoice:
    """Return a Mitsuba variant that is proven to work on this machine.

    Parameters
    ----------
    prefer
        "auto" takes LLVM when it works and the scalar variant otherwise; "llvm" insists; "scalar" needs no LLVM;
        "cuda" insists on the GPU, which "auto" never takes.
    libraries
        Paths of LLVM libraries to try in this order; by default the one named by ``DRJIT_LIBLLVM_PATH``, else
        those of the system from the newest version down.
    spectral
        True for full spectra (the reference of level c), False for three bands.

    Returns
    -------
    RendererChoice
        A proven library is also put into ``DRJIT_LIBLLVM_PATH`` so that Dr.Jit loads this one and no other.

    Raises
    ------
    MissingExtraError
        When the renderer is not installed or does not run, or LLVM or a GPU is demanded and none passes the proof.
    """
    if not is_installed("mitsuba"):
        raise MissingExtraError(MISSING_NOTE)
    llvm, scalar, cuda = (
        name.replace("_rgb", "_spectral") if spectral else name for name in (LLVM_VARIANT, SCALAR_VARIANT, CUDA_VARIANT)
    )
    if prefer == "scalar":
        _require_scalar(scalar)
        return RendererChoice(scalar, None, "scalar variant, as requested")
    if prefer == "cuda":
        failure = prove_variant(cuda)
        if failure is not None:
            raise MissingExtraError(f"a renderer on the GPU was requested, but {failure}; {GPU_NOTE}")
        return RendererChoice(cuda, None, "compiled for the GPU")
    failures = []
    for path in find_llvm_libraries() if libraries is None else libraries:
        failure = prove_llvm_library(path)
        if failure is None:
            os.environ[_LIBRARY_VARIABLE] = path
            return RendererChoice(llvm, path, f"compiled with {Path(path).name}")
        failures.append(f"{path}: {failure}")
    tried = "; ".join(failures) if failures else f"no LLVM library of version >= {MINIMUM_LLVM_MAJOR} was found"
    if prefer == "llvm":
        raise MissingExtraError(f"a renderer with LLVM was requested, but {tried}; {INSTALL_NOTE}")
    _require_scalar(scalar)
    return RendererChoice(scalar, None, f"{tried}; {INSTALL_NOTE}", fell_back=True)


def install_command(library: str) -> str:
    """Return how Debian and Ubuntu install one of the system's libraries: libatomic.so.1 is in libatomic1."""
    name, _, version = library.partition(".so.")
    return f"sudo apt-get install {name}{version.partition('.')[0]}"


def _require_scalar(variant: str) -> None:
    """Refuse where not even the variant that needs nothing else runs, such as on processors without AVX."""
    failure = prove_variant(variant)
    if failure is None:
        return
    _, is_absent, library = failure.partition(ABSENT)
    if is_absent:
        raise MissingExtraError(
            f"Mitsuba does not run here, because {library} is missing on this system; install the package that "
            f"contains it ({install_command(library)}), then try again"
        )
    raise MissingExtraError(
        f"Mitsuba does not run here, because {failure} (its wheels for x86-64 need a processor with AVX). Render on "
        "another computer; capture, radiometry, fit, compare and decide do not need Mitsuba"
    )


def find_llvm_libraries() -> list[str]:
    """Return the LLVM libraries worth a proof: the preset one, else version >= 17 from the newest down."""
    preset = os.environ.get(_LIBRARY_VARIABLE)
    if preset:
        return [preset]
    found: dict[str, int] = {}
    for root, pattern in _LIBRARY_PATTERNS:
        for path in root.glob(pattern):
            library = path.resolve()
            version = re.match(r"libLLVM(?:-|\.so\.|\.)?(\d+)", library.name)
            if version and library.is_file() and int(version.group(1)) >= MINIMUM_LLVM_MAJOR:
                found[str(library)] = int(version.group(1))
    return sorted(found, key=lambda path: (-found[path], path))


def prove_llvm_library(path: str) -> str | None:
    """Render a small picture in a child process with this library; None when it worked, else the reason."""
    return prove_variant(LLVM_VARIANT, path)


@functools.cache
def prove_variant(variant: str, llvm_library: str | None = None) -> str | None:
    """Render a small picture in a child process with this variant; None when it worked, else the reason.

    Proofs are remembered, but for a GPU's: its driver can change without any file of ours.
    """
    arguments = {"variant": variant} | ({} if llvm_library is None else {"llvm_library": llvm_library})
    files = (*_MODULES, *([] if llvm_library is None else [llvm_library]))
    failure = proof_failure(_PROOF, arguments, files, _PROOF_TIMEOUT_S, remember="cuda" not in variant)
    return None if failure is None else f"the test picture {failure}"


def render_proof_picture(variant: str, llvm_library: str | None = None) -> None:
    """Render a small picture with a variant, in a process that has not rendered yet.

    Raises
    ------
    SimulateError
        When the renderer raises, or the picture is empty.
    """
    if llvm_library is not None:
        os.environ[_LIBRARY_VARIABLE] = llvm_library
    try:
        mitsuba = importlib.import_module("mitsuba")
        mitsuba.set_variant(variant)
        scene = mitsuba.cornell_box()
        scene["sensor"]["film"].update(width=8, height=8)
        mean = float(mitsuba.TensorXf(mitsuba.render(mitsuba.load_dict(scene), spp=2)).numpy().mean())
    except Exception as error:
        if (library := absent_library(error)) is not None:
            raise SimulateError(f"{ABSENT}{library}") from error
        raise SimulateError(f"failed ({type(error).__name__}: {' '.join(str(error).split())[:200]})") from error
    if not 0.0 < mean < 1e6:
        raise SimulateError("is empty")


def absent_library(error: BaseException | None) -> str | None:
    """Return the name of the system's library that an import did not find, or None.

    Dr.Jit meets the failed import with an error of another kind, so that the errors before it are looked at, too.
    """
    while error is not None:
        found = re.match(r"(lib[\w.+-]+\.so[\d.]*): cannot open shared object file", str(error))
        if found is not None:
            return found[1]
        error = error.__cause__ or error.__context__
    return None


def open_renderer(choice: RendererChoice, threads: int | None = None) -> ModuleType:
    """Import Mitsuba, set the chosen variant and limit its threads.

    Parameters
    ----------
    choice
        From :func:`choose_variant`.
    threads
        Number of worker threads; by default the processors this process may use.

    Returns
    -------
    module
        ``mitsuba`` with the variant set.
    """
    mitsuba = importlib.import_module("mitsuba")
    drjit = importlib.import_module("drjit")
    if mitsuba.variant() != choice.variant:
        mitsuba.set_variant(choice.variant)
    note_renderer(choice.variant)
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    drjit.set_thread_count(threads if threads is not None else available)
    return mitsuba


def check_variant(colours: str, what: str) -> None:
    """Check that the variant that is set has these colours ("rgb" or "spectral") and runs integrators in Python.

    Raises
    ------
    MissingExtraError
        In a scalar variant, where integrators written in Python do not run.
    SimulateError
        When the variant has other colours.
    """
    variant = str(importlib.import_module("mitsuba").variant())
    if "scalar" in variant:
        raise MissingExtraError(
            f"the reference integrators (level c) do not run in {variant}; open the renderer with LLVM or a GPU "
            "(Debian: apt-get install libllvm19)"
        )
    if not variant.endswith(f"_{colours}"):
        raise SimulateError(f"{what} need a {colours} variant of the renderer, but {variant} is set")


def exr_image(channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, str]) -> bytes:
    """Return channels as one OpenEXR image of scan lines, losslessly compressed (PIZ).

    Parameters
    ----------
    channels
        Values (rows, columns) by name; a dot separates a layer from its channel. Stored as 32-bit floats.
    attributes
        Further fields of the header: text only, for the renderer's writer makes doubles of all numbers.
    """
    mitsuba = importlib.import_module("mitsuba")
    if mitsuba.variant() is None:
        mitsuba.set_variant(SCALAR_VARIANT)  # images are the same in all variants
    values = np.stack([np.asarray(channel, dtype=np.float32) for channel in channels.values()], axis=-1)
    image = mitsuba.Bitmap(values, mitsuba.Bitmap.PixelFormat.MultiChannel, list(channels))
    header = image.metadata()
    for name, text in attributes.items():
        header[name] = text
    stream = mitsuba.MemoryStream()
    with _at_least_two_threads():
        image.write(stream, mitsuba.Bitmap.FileFormat.OpenEXR)
    return bytes(stream.raw_buffer())


@contextmanager
def _at_least_two_threads() -> Iterator[None]:
    """Give the renderer a second thread where the machine has one core: its EXR writer waits for one forever."""
    drjit = importlib.import_module("drjit")
    count = drjit.thread_count()
    if count < _THREADS_OF_EXR_WRITER:
        drjit.set_thread_count(_THREADS_OF_EXR_WRITER)
    try:
        yield
    finally:
        drjit.set_thread_count(count)
