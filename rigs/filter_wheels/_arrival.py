"""When a move of a wheel behind a server is over, and which slots a wheel has: the same for INDI and Alpaca."""

import time
from collections.abc import Sequence
from typing import Final

from data_schemas import BandPassFilter, RefusedError, WrongPositionError

POLLS_THERE: Final = 2


class Arrival:
    """Whether a wheel has arrived at a slot, from the polls on its way.

    Parameters
    ----------
    name
        Name and address of the wheel, for messages.
    slot
        Where it was sent.
    elsewhere_s
        A wheel that names one other slot for so long (s) rests there and is not on its way any more.
    """

    def __init__(self, name: str, slot: int, elsewhere_s: float) -> None:
        self._name = name
        self._slot = slot
        self._elsewhere_s = elsewhere_s
        self._polls_there = 0
        self._elsewhere: int | None = None
        self._elsewhere_since_s = 0.0

    def sees(self, at: int | None) -> bool:
        """Take the slot of one poll (None: moving); return whether the wheel has arrived.

        Raises
        ------
        WrongPositionError
            It rests at another slot.
        """
        self._polls_there = self._polls_there + 1 if at == self._slot else 0
        if at is None or at == self._slot:
            self._elsewhere = None
            return self._polls_there == POLLS_THERE
        now_s = time.monotonic()
        if at != self._elsewhere:
            # Some wheels name the slots that they pass.
            self._elsewhere, self._elsewhere_since_s = at, now_s
        if now_s - self._elsewhere_since_s > self._elsewhere_s:
            raise WrongPositionError(
                f"{self._name}: was sent to slot {self._slot}, but stopped at slot {at}; check whether a filter or "
                "cable rubs, switch the wheel off and on, and capture again"
            )
        return False


def require_slot(slot: int, slots: Sequence[int], name: str) -> None:
    """Refuse a slot that a wheel does not have.

    Raises
    ------
    RefusedError
        It has no such slot.
    """
    if slot not in slots:
        raise RefusedError(f"{name}: has no slot {slot} ({_reach(slots)}); correct the slot numbers in the rig file")


def require_slots(filters: Sequence[BandPassFilter], slots: Sequence[int], name: str) -> None:
    """Refuse a rig whose filters do not fit into a wheel.

    Raises
    ------
    RefusedError
        A filter is in a slot that the wheel does not have.
    """
    beyond = [f"{optic.name} in slot {optic.slot}" for optic in filters if optic.slot not in slots]
    if beyond:
        remedy = "name a wheel with more slots" if len(filters) > len(slots) else "correct the slot numbers"
        raise RefusedError(f"{name}: {_reach(slots)}, but the rig file puts {', '.join(beyond)}; {remedy}")


def _reach(slots: Sequence[int]) -> str:
    return f"its slots are {slots[0]} to {slots[-1]}" if slots else "it offers no slot at all"
