"""The IPC Toolkit (ipctk), by which surfaces collide: whether it runs on this machine.

Wheels of ipctk 1.6.1 for CPython 3.12 and newer use AVX-512 whatever the processor has, all of them AVX2, and there is
none for Linux on ARM. One that does not run ends the process at its import or first use; :func:`contact_library`
therefore imports it only once a child process has pressed two blocks with it.
"""

import importlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType

import numpy as np

from data_schemas import MissingExtraError, SimulateError
from sim import is_installed, proof_failure

WORKING_VERSION = "1.6.0"
"""The newest release whose wheels run, for every Python, on all x86-64 processors with AVX2."""
_PROOF = "sim.mechanics._contact_library:press_two_blocks"
_TIME_S = 60.0
_on_trial = False  # in the child that tries the library


def contact_library() -> ModuleType:
    """Return the module ipctk.

    Raises
    ------
    MissingExtraError
        When it is missing or does not run here.
    """
    failure = None if _on_trial else contact_library_failure()
    if failure is not None:
        raise MissingExtraError(f"barrier contact is not possible: {failure}")
    return importlib.import_module("ipctk")


@cache
def contact_library_failure() -> str | None:
    """Return None where ipctk runs on this machine, else in words why not and what to do."""
    if not is_installed("ipctk"):
        return (
            "ipctk is not installed; install it with pip install 'finray-calib[sim]' (on Linux for ARM there is no "
            "wheel of ipctk)"
        )
    failure = proof_failure(_PROOF, {}, ["ipctk"], _TIME_S)
    if failure is None:
        return None
    installed = _version()
    remedy = f"version {WORKING_VERSION} runs on every x86-64 processor with AVX2: pip install ipctk=={WORKING_VERSION}"
    if installed == WORKING_VERSION:
        remedy = "it needs an x86-64 processor with AVX2"
    return f"ipctk {installed} does not run here: its trial {failure}; {remedy}"


def _version() -> str:
    """Return the installed version."""
    try:
        return version("ipctk")
    except PackageNotFoundError:
        return "of unknown version"


def press_two_blocks() -> None:
    """Use all of the library that a press uses, on two tetrahedra, one sliding over the other.

    Raises
    ------
    SimulateError
        When the second does not push the first away.
    """
    global _on_trial
    _on_trial = True
    from sim.mechanics._barrier_contact import Barrier, BarrierContact
    from sim.mechanics._colliding_surfaces import Obstacle

    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, -1.0, 0.3]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    mirrored = np.array([[0.1, 0.3, 0.1], [0.9, 1.3, 0.1], [0.1, 1.3, 0.9], [0.0, 1.5, 0.0]])
    nodes = np.concatenate([corners, [[0.1, 0.3, 0.1]]])
    contact = BarrierContact(nodes, triangles, Obstacle(mirrored, triangles, 4), Barrier(0.02, 0.3, 0.5))
    contact.restart()
    down = np.zeros_like(nodes)
    down[4] = (0.0, -0.29, 0.0)
    share = contact.max_step(np.zeros_like(nodes), down)
    contact.settle(down)
    aside = down + np.array([[0.0, 0.0, 0.0]] * 4 + [[0.001, 0.0, 0.0]])
    curved = contact.hessian(aside, True)
    if not (share > 0.5 and contact.energy(aside) > 0.0 and contact.force_n(aside)[1] > 0.0 and curved.nnz > 0):
        raise SimulateError("gave a wrong contact")
