"""The devices of a tactile rig, opened and locked: the cell before the stage, which never moves without it."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from data_schemas import PressDevice, RefusedError, TactileRig
from rigs import (
    Camera,
    Clock,
    LoadCell,
    Operator,
    Stage,
    SystemClock,
    TerminalOperator,
    device_locked,
    open_camera,
    open_load_cell,
    open_stage,
)


@dataclass(frozen=True, slots=True)
class OpenTactileRig:
    """Opened devices of a tactile rig.

    Attributes
    ----------
    stage, load_cell
        None where a person presses.
    lay
        Lays a mass (kg) on the cell: the simulated one at once, on a real one a person is asked.
    lay_block
        Lays a block of a thickness (mm) on the pad, or takes it off (0), and returns whether that was done.
    """

    camera: Camera | None
    stage: Stage | None
    load_cell: LoadCell | None
    operator: Operator
    clock: Clock
    lay: Callable[[float], None] = lambda mass_kg: None
    lay_block: Callable[[float], bool] = lambda thickness_mm: False

    def camera_there(self) -> Camera:
        """Return the camera, which was opened."""
        if self.camera is None:
            raise RefusedError("camera: it could not be opened; check its address in the rig file and its cable")
        return self.camera

    def press_devices(self) -> tuple[PressDevice, ...]:
        """Return what stage and load cell say they are."""
        return tuple(device.identity() for device in (self.stage, self.load_cell) if device is not None)


@contextmanager
def open_tactile_rig(
    rig: TactileRig,
    folder: Path,
    operator: Operator | None = None,
    only: Literal["camera", "stage", "load cell", "stage and load cell"] | None = None,
) -> Iterator[OpenTactileRig]:
    """Open and lock camera, stage and load cell for a ``with`` block; opening a stage stops whatever it was doing.

    Parameters
    ----------
    rig
        The rig file's content.
    folder
        Where relative paths in it start.
    operator
        Who presses, or is asked; a person at the terminal when left out.
    only
        What to open; all when left out.

    Raises
    ------
    CaptureError
        A device cannot be reached, or another capture uses it.
    """
    if rig.is_simulated:
        yield _open_finger(rig)
        return
    hands = operator or TerminalOperator()

    def lay(mass_kg: float) -> None:
        hands.do(f"Lay {1e3 * mass_kg:g} g on the load cell, gently." if mass_kg else "Take everything off the cell.")

    def lay_block(thickness_mm: float) -> bool:
        what = f"Lay the block of {thickness_mm:g} mm flat on the pad under the indenter"
        what = what if thickness_mm else "Take the block off the pad"
        return hands.allows(f"The stage stands. {what}, and take your hands away. Is that done?")

    with ExitStack() as stack:
        parts = {"camera": rig.camera, "stage": rig.stage, "load cell": rig.load_cell}
        wanted = {role: part for role, part in parts.items() if part is not None and (only is None or role in only)}
        for role, part in wanted.items():
            stack.enter_context(device_locked(role, part.driver, part.address))
        # the cell before the stage: what moves is never open without what stops it
        cell = stack.enter_context(open_load_cell(rig.load_cell)) if rig.load_cell and "load cell" in wanted else None
        camera = stack.enter_context(open_camera(rig.camera, folder)) if "camera" in wanted else None
        stage = stack.enter_context(open_stage(rig.stage)) if rig.stage and "stage" in wanted else None
        yield OpenTactileRig(camera, stage, cell, hands, SystemClock(), lay, lay_block)


def _open_finger(rig: TactileRig) -> OpenTactileRig:
    """Put the simulated devices of a tactile rig over one finger."""
    # Imported here so that a rig of real devices never loads the simulation.
    from rigs.simulated import FingerCamera, FingerOperator, FingerState, SimulatedLoadCell, SimulatedStage

    if rig.simulated is None or rig.load_cell is None:
        raise RefusedError(f"rig '{rig.name}': a simulated finger needs its [simulated] and [load_cell] tables")
    state, seed = FingerState(rig), rig.simulated.seed

    def lay(mass_kg: float) -> None:
        state.load_kg = mass_kg

    def lay_block(thickness_mm: float) -> bool:
        state.block_mm = thickness_mm
        return True

    return OpenTactileRig(
        FingerCamera(state, rig.camera, np.random.default_rng([seed, 2])),
        SimulatedStage(state),
        SimulatedLoadCell(state, rig.load_cell, np.random.default_rng([seed, 3])),
        FingerOperator(state),
        state.clock,
        lay,
        lay_block,
    )
