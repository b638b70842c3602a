"""A light that never stays on: a process of its own holds its connection and switches off whatever becomes of us.

Three layers. (1) ``with light.lit():`` switches off however the block is left. (2) The guard process switches off when
this one dies or freezes. (3) A controller with a dead-man switches off when it hears nothing for about a second; lights
without one have two layers only.
"""

import contextlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Literal

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import LostError
from rigs.light_guard_client import SWITCH_DEADLINE_S, GuardClient

STATE_DEADLINE_S: Final = 2.0


class GuardedLight:
    """A light whose connection a guard process holds; open one with :func:`guarded_light`.

    Parameters
    ----------
    role, driver, address
        What the light is, the name of its driver and where its controller is.
    patience_s
        The light goes off when nothing is asked for so long in a lit block: the program hangs.
    """

    def __init__(self, role: Literal["laser", "lamp"], driver: str, address: str, patience_s: float = math.inf) -> None:
        # rigs.drivers names this module; the table of lights is looked up when it is there.
        from rigs.drivers import LIGHTS

        self._guard = GuardClient(role, LIGHTS[driver], address, patience_s)
        self._depth = 0

    def open(self) -> None:
        """Wait until the guard has opened the light and it is confirmed off.

        Raises
        ------
        CaptureError
            The light cannot be reached.
        UnsafeError
            The light is not confirmed off.
        """
        self._guard.open()

    def close(self) -> None:
        """End the guard; it switches off once more.

        Raises
        ------
        UnsafeError
            The light is not confirmed off.
        """
        self._guard.close()

    @property
    def guard_pid(self) -> int:
        """Process number of the guard."""
        return self._guard.pid

    @property
    def layers(self) -> int:
        """Independent means that switch the light off: 3, or 2 where the controller has no dead-man."""
        return 3 if self._guard.has_dead_man else 2

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about the light."""
        if self._guard.has_dead_man:
            return ()
        return (
            f"{self._guard.name}: this light has no dead-man, two layers only: it stays on when the computer hangs or "
            "its cable is pulled",
        )

    def identity(self) -> DeviceIdentity:
        """Ask the controller what it is."""
        return DeviceIdentity.model_validate(self._guard.ask("identity", STATE_DEADLINE_S))

    def state(self) -> bool:
        """Ask the controller whether the light is on."""
        return bool(self._guard.ask("state", STATE_DEADLINE_S))

    @contextmanager
    def lit(self) -> Iterator[None]:
        """Switch on for a ``with`` block; on is confirmed before it, off after it. In a lit block nothing changes.

        Raises
        ------
        LostError
            The guard process is gone; the light is confirmed off.
        UnsafeError
            The light is not confirmed off.
        """
        self._depth += 1
        try:
            if self._depth == 1:
                self._guard.ask("on", SWITCH_DEADLINE_S)
            yield
        except BaseException:
            # A lost guard means "off" here, and what left the block says more.
            with contextlib.suppress(LostError):
                self._leave()
            raise
        self._leave()

    def _leave(self) -> None:
        """Switch off at the end of the outermost block, also when Ctrl-C comes meanwhile."""
        self._depth -= 1
        if self._depth:
            return
        try:
            self._guard.switch_off()
        except KeyboardInterrupt:
            self._guard.switch_off()
            raise


@contextmanager
def guarded_light(
    role: Literal["laser", "lamp"], driver: str, address: str, patience_s: float = math.inf
) -> Iterator[GuardedLight]:
    """Open a light behind a guard process of its own, for a ``with`` block; it is off before and after.

    Parameters
    ----------
    role
        "laser" or "lamp", for messages.
    driver, address
        As in the rig file.
    patience_s
        The light goes off when nothing is asked for so long in a lit block.

    Raises
    ------
    CaptureError
        The light cannot be reached.
    UnsafeError
        The light is not confirmed off.
    """
    light = GuardedLight(role, driver, address, patience_s)
    try:
        light.open()
        yield light
    finally:
        light.close()
