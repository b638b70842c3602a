"""A light that only the operator switches, without a guard: off at the start, after every block and at the end."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final

from data_schemas.devices import DeviceIdentity
from rigs.protocols import Light, LightSwitch

SWITCH_DEADLINE_S: Final = 5.0


class PlainLight:
    """A light over its bare switch.

    Parameters
    ----------
    switch
        The switch of an open controller.
    """

    def __init__(self, switch: LightSwitch) -> None:
        self._switch = switch

    def identity(self) -> DeviceIdentity:
        """Return what the controller says it is."""
        return self._switch.identity()

    def state(self) -> bool:
        """Ask the controller whether the light is on."""
        return self._switch.state(SWITCH_DEADLINE_S)

    @contextmanager
    def lit(self) -> Iterator[None]:
        """Switch on for a ``with`` block."""
        try:
            self._switch.switch(True, SWITCH_DEADLINE_S)
            yield
        finally:
            self._switch.switch(False, SWITCH_DEADLINE_S)


@contextmanager
def plain_light(opening: AbstractContextManager[LightSwitch]) -> Iterator[Light]:
    """Open a switch and return its light for a ``with`` block."""
    with opening as switch:
        switch.switch(False, SWITCH_DEADLINE_S)
        try:
            yield PlainLight(switch)
        finally:
            switch.switch(False, SWITCH_DEADLINE_S)
