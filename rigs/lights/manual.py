"""A lamp that only the operator switches, without a guard: off at the start, after every block and at the end."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final, Literal

from data_schemas import CaptureError, DeviceIdentity, RefusedError, UnsafeError
from rigs import Light, LightSwitch, Operator

HAS_DEAD_MAN: Final = False


class ManualSwitch:
    """The switch of a lamp in the operator's hand; deadlines do not hold for people.

    Parameters
    ----------
    operator
        Who switches.
    """

    has_dead_man: Final = HAS_DEAD_MAN

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._confirmed: bool | None = None

    def identity(self) -> DeviceIdentity:
        """Return that a person switches the lamp."""
        return DeviceIdentity(role="lamp", driver="manual")

    def switch(self, on: bool, deadline_s: float) -> None:
        """Have the lamp switched; nobody is asked when the operator's last word was the same.

        Raises
        ------
        UnsafeError
            Off was asked for and nobody can confirm it.
        CaptureError
            On was asked for and nobody can answer.
        """
        if self._confirmed is on:
            return
        self._confirmed = None
        try:
            self._operator.do(f"Switch the lamp {'on' if on else 'off'}.")
        except CaptureError as error:
            if on:
                raise
            raise UnsafeError(f"lamp: nobody confirms that it is off ({error}); switch it off by hand") from error
        self._confirmed = on

    def state(self, deadline_s: float) -> bool:
        """Return what the operator confirmed last.

        Raises
        ------
        RefusedError
            Nothing was confirmed yet.
        """
        if self._confirmed is None:
            raise RefusedError("lamp: nobody has confirmed whether it is on or off; switch it off first")
        return self._confirmed

    def keep_alive(self) -> None:
        """Nothing: a hand-switched lamp hears nothing."""


@contextmanager
def open_switch(address: str, role: Literal["laser", "lamp"], operator: Operator) -> Iterator[LightSwitch]:
    """Return the switch of a lamp for a ``with`` block.

    Raises
    ------
    RefusedError
        The light is a laser.
    """
    if role == "laser":
        raise RefusedError(
            "laser: cannot be switched by hand, because nothing would switch it off when the capture stops; "
            "connect it to a controller (drivers arduino, indi, alpaca)"
        )
    yield ManualSwitch(operator)


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
