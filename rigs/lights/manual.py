"""A lamp with a switch that only the operator can reach."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError, RefusedError, UnsafeError
from rigs.protocols import LightSwitch, Operator


class ManualSwitch:
    """The switch of a lamp in the operator's hand; deadlines do not hold for people.

    Parameters
    ----------
    operator
        Who switches.
    """

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._confirmed: bool | None = None

    @property
    def has_dead_man(self) -> bool:
        """Nothing switches this lamp off by itself."""
        return False

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
            raise RefusedError("lamp: nobody has confirmed whether it is on or off; have it switched off first")
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
            "laser: cannot be switched by hand, nothing would switch it off when the capture stops; connect it to a "
            "controller (drivers arduino, indi, alpaca)"
        )
    yield ManualSwitch(operator)
