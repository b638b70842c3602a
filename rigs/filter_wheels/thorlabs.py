"""Thorlabs FW102C (6 filters) and FW212C (12 filters) on their serial or USB port.

115200 baud, 8 data bits, no parity, 1 stop bit. A command ends with CR; the wheel repeats it, then says the value of a
query or an error, each ended by CR, then the prompt ``> ``. Whether the prompt of ``pos=n`` comes at once or after the
move is not documented, so a move is over only when the prompt has come and two polls of ``pos?`` name the slot.
"""

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final, TypeVar

from data_schemas import (
    BandPassFilter,
    CaptureError,
    DeviceIdentity,
    FilterWheelSettings,
    LostError,
    RefusedError,
    TimedOutError,
    WrongPositionError,
)
from rigs import FilterWheel, Operator
from rigs.filter_wheels._arrival import require_slot
from rigs.transports import RECOVERS_WITHIN_S, SerialLink, repeated, usb_serial_ports

T = TypeVar("T")

QUIET_S: Final = 0.1
"""Silence after which nothing of a former session is under way; a USB adapter holds bytes back for 16 ms."""

# The prompt's space is stripped with the next answer, so that a wheel without one is understood too.
_PROMPT: Final = b">"
_ERROR: Final = "Command error"


class Dialogue:
    """Commands and their answers over a link; after a failure it first finds its step again.

    Parameters
    ----------
    link
        Open link to the wheel.
    name
        Name and address of the wheel, for messages.
    """

    def __init__(self, link: SerialLink, name: str) -> None:
        self._link = link
        self._name = name
        self._in_step = False

    def lose_step(self) -> None:
        """Note that answers may no longer belong to their commands."""
        self._in_step = False

    def ask(self, keyword: str, end_s: float) -> str:
        """Return the value that the wheel says to ``keyword?``."""
        command = f"{keyword}?"
        said = self._exchange(command, end_s)
        if len(said) != 1:
            raise self._garbled(command, said)
        return said[0]

    def ask_number(self, keyword: str, end_s: float) -> int:
        """Return the whole number that the wheel says to ``keyword?``."""
        value = self.ask(keyword, end_s)
        if not re.fullmatch(r"\d{1,3}", value, re.ASCII):
            raise self._garbled(f"{keyword}?", [value])
        return int(value)

    def assign(self, keyword: str, value: int, end_s: float) -> None:
        """Say ``keyword=value`` and wait for the prompt."""
        command = f"{keyword}={value}"
        said = self._exchange(command, end_s)
        if said:
            raise self._garbled(command, said)

    def _exchange(self, command: str, end_s: float) -> list[str]:
        """Say a command; return the lines between its echo and the prompt."""
        if not self._in_step:
            self._find_step(end_s)
        self._in_step = False
        self._link.forget()  # an answer that came twice must not pass for this one's
        self._link.write(command.encode() + b"\r", end_s)
        frame = self._link.read_until(_PROMPT, end_s)[: -len(_PROMPT)]
        lines = [line.strip() for line in frame.decode("ascii", "replace").strip().split("\r")]
        if lines[0] != command:
            raise self._garbled(command, lines)
        self._in_step = True
        if lines[1:] and lines[1].startswith(_ERROR):
            raise RefusedError(
                f"{self._name}: refuses '{command}' ({lines[1].removeprefix(_ERROR).strip()}); check that it is an "
                "FW102C or FW212C, and that its position count is correct"
            )
        return lines[1:]

    def _find_step(self, end_s: float) -> None:
        """End a command that was cut off, and forget answers that still come: a bare CR provokes one prompt more."""
        self._link.write(b"\r", end_s)
        self._link.read_until(_PROMPT, end_s)
        self._link.drain(QUIET_S, end_s)

    def _garbled(self, command: str, said: list[str]) -> LostError:
        return LostError(
            f"{self._name}: answers '{command}' with {said!r}, which is not a valid answer; check the cable, that no "
            "other program uses the port, and that this port belongs to the wheel"
        )


BAUD: Final = 115200
ANSWER_S: Final = 1.0
"""Longest wait for an answer that moves nothing; a healthy wheel needs some milliseconds."""
MOVE_ANSWER_S: Final = 5.0
"""Longest wait for the answer to a move, which some wheels may give at its end."""
OPENS_WITHIN_S: Final = 3.0
POLL_S: Final = 0.05
REST_S: Final = 2.0
"""A wheel that says this long that it stands between start and target is at rest, not passing."""
DETECT_S: Final = 0.5

_IDENTITY: Final = re.compile(r"THORLABS (FW\d{3}\S*)(?:.*version (\S+))?", re.IGNORECASE)


class ThorlabsWheel:
    """A wheel over its dialogue; :func:`open_wheel` makes it.

    Every exchange is repeated within its deadline, since positions and settings are absolute. After any fault the port
    is opened anew where need be, and the wheel is proven again: the same wheel, with the same slots and settings.

    Parameters
    ----------
    link
        Open link to the wheel.
    address
        Serial port or URL.

    Raises
    ------
    RefusedError
        The device is not such a wheel, or does not keep a setting.
    LostError, TimedOutError
        It does not answer, or not as such a wheel does.
    """

    def __init__(self, link: SerialLink, address: str) -> None:
        self._link, self._address, self._name = link, address, _name(address)
        self._dialogue = Dialogue(link, self._name)
        self._identity: DeviceIdentity | None = None
        self._slots: tuple[int, ...] = ()
        self._failures, self._is_proven = 0, False
        self._within(_in(OPENS_WITHIN_S), lambda end_s: None)

    def identity(self) -> DeviceIdentity:
        """Ask the wheel what it is."""
        return self._within(_in(RECOVERS_WITHIN_S), lambda end_s: _identity(self._dialogue, self._address, end_s))

    @property
    def slots(self) -> tuple[int, ...]:
        """Numbers of the slots: 1 to 6 or 1 to 12, as the wheel said when it was opened."""
        return self._slots

    def position(self) -> int | None:
        """Ask the wheel which slot is in the beam; None when it names none that exists.

        It has no word for "moving": what it says during a move is not known.
        """
        reported = self._within(_in(RECOVERS_WITHIN_S), lambda end_s: self._ask_number("pos", end_s))
        return reported if reported in self._slots else None

    def go_to(self, slot: int, deadline_s: float) -> None:
        """Move until two polls report `slot`; at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            The wheel has no such slot, and nothing moved; or another wheel answers than before.
        TimedOutError
            It did not report the slot, or did not answer, before the deadline.
        WrongPositionError
            It rests at a slot that is neither the one it left nor the one asked for.
        LostError
            The connection broke, or answers were garbled, until the deadline.
        """
        require_slot(slot, self._slots, self._name)
        arrived, last = self._within(_in(deadline_s), lambda end_s: self._move(slot, deadline_s, end_s))
        if not arrived:
            raise self._overdue(slot, deadline_s, f"its last report is slot {last}")

    def _within(self, end_s: float, exchange: Callable[[float], T]) -> T:
        """Return what an exchange returns, repeated after faults; before the first and after each, prove the wheel."""

        def attempt(end_s: float) -> T:
            if not self._is_proven:
                self._prove(end_s)
            result = exchange(end_s)
            self._failures = 0
            return result

        return repeated(attempt, end_s, self._name, after_fault=self._doubt)

    def _doubt(self) -> None:
        """Note that an exchange failed."""
        self._failures, self._is_proven = self._failures + 1, False

    def _prove(self, end_s: float) -> None:
        """See that the same wheel answers, with its slots; set and read back what it may have lost."""
        # A line that stays silent may be broken without telling, as one to a serial server.
        if self._link.is_broken or self._failures > 1:
            self._link.reopen()
        self._dialogue.lose_step()
        identity = _identity(self._dialogue, self._address, end_s)
        count = self._ask_number("pcount", end_s)
        if count not in (6, 12):
            raise RefusedError(
                f"{self._name}: reports {count} slots, but only 6 (FW102C) or 12 (FW212C) are possible; set "
                "its position count with the maker's program"
            )
        slots = tuple(range(1, count + 1))
        if (self._identity or identity, self._slots or slots) != (identity, slots):
            raise RefusedError(
                f"{self._name}: another wheel answers now ({identity.model}, {count} slots); connect the wheel with "
                "which the session began"
            )
        self._identity, self._slots = identity, slots
        # The infra-red sensors would light the sample while the wheel rests.
        self._keep("sensors", 0, end_s)
        self._keep("speed", 1, end_s)
        self._is_proven = True

    def _ask_number(self, keyword: str, end_s: float) -> int:
        return self._dialogue.ask_number(keyword, min(end_s, _in(ANSWER_S)))

    def _move(self, slot: int, deadline_s: float, end_s: float) -> tuple[bool, int]:
        """Send the wheel to a slot; return whether it arrived, and its last report."""
        start = self._ask_number("pos", end_s)
        if start != slot:
            try:
                self._dialogue.assign("pos", slot, min(end_s, _in(MOVE_ANSWER_S)))
            except TimedOutError as error:
                raise self._overdue(slot, deadline_s, "it does not confirm the move") from error
        return self._follow(slot, start, end_s)

    def _follow(self, slot: int, start: int, end_s: float) -> tuple[bool, int]:
        """Poll until two reports in a row name `slot`, or the time is up; return whether they did, and the last."""
        seen, since_s, polls = start, time.monotonic(), 0
        while time.monotonic() < end_s:
            reported = self._ask_number("pos", end_s)
            if reported != seen:
                seen, since_s, polls = reported, time.monotonic(), 0
            polls += 1
            if seen == slot and polls == 2:
                return True, slot
            if seen not in (slot, start) and time.monotonic() - since_s > REST_S:
                raise WrongPositionError(
                    f"{self._name}: was sent from slot {start} to slot {slot}, but stopped at slot {seen}; check "
                    "whether a filter or cable rubs, switch the wheel off and on, and capture again"
                )
            if end_s - time.monotonic() < 2.0 * POLL_S:
                # What is left is too short for an answer.
                break
            time.sleep(POLL_S)
        return False, seen

    def _overdue(self, slot: int, deadline_s: float, why: str) -> TimedOutError:
        return TimedOutError(
            f"{self._name}: did not reach slot {slot} within {deadline_s:g} s ({why}); check whether something "
            "blocks the wheel, and check its power supply"
        )

    def _keep(self, setting: str, value: int, end_s: float) -> None:
        """Change a setting and see that it is kept."""
        self._dialogue.assign(setting, value, min(end_s, _in(ANSWER_S)))
        kept = self._ask_number(setting, end_s)
        if kept != value:
            raise RefusedError(
                f"{self._name}: the setting '{setting}={value}' was sent, but the wheel reports {setting} = {kept}; "
                "switch the wheel off and on"
            )


@contextmanager
def open_wheel(settings: FilterWheelSettings, operator: Operator) -> Iterator[FilterWheel]:
    """Open the wheel of a rig for a ``with`` block: sensors dark at rest, high speed, all filters reachable.

    Raises
    ------
    RefusedError
        The port or the device is not what the rig file says, or the wheel has too few slots for the filters.
    LostError, TimedOutError
        The wheel cannot be reached or does not answer.
    """
    name = _name(settings.address)
    with SerialLink(settings.address, BAUD, "filter wheel") as link:
        wheel = ThorlabsWheel(link, settings.address)
        _require_slots(settings.filters, wheel.slots, name)
        yield wheel


def found() -> list[tuple[str, str]]:
    """Return address and description of the wheels that answer on serial ports behind USB."""
    wheels = []
    for port in usb_serial_ports():
        try:
            with SerialLink(port.address, BAUD, "filter wheel") as link:
                wheel = _identity(Dialogue(link, _name(port.address)), port.address, _in(DETECT_S))
        except CaptureError:
            continue
        wheels.append((port.address, f"Thorlabs {wheel.model} filter wheel, firmware {wheel.firmware}"))
    return wheels


def _identity(dialogue: Dialogue, address: str, end_s: float) -> DeviceIdentity:
    """Ask who is there, and refuse any other device."""
    said = dialogue.ask("*idn", min(end_s, _in(ANSWER_S)))
    match = _IDENTITY.fullmatch(said)
    if match is None:
        raise RefusedError(
            f"{_name(address)}: identifies itself as '{said}', but a Thorlabs FW102C or FW212C is expected; "
            "correct address or driver of filter_wheel in the rig file"
        )
    return DeviceIdentity(
        role="filter wheel",
        driver="thorlabs",
        address=address,
        vendor="Thorlabs",
        model=match[1],
        firmware=match[2] or "",
    )


def _require_slots(filters: Sequence[BandPassFilter], slots: Sequence[int], name: str) -> None:
    """Refuse a rig whose filters do not fit into the wheel."""
    beyond = [f"{optic.name} in slot {optic.slot}" for optic in filters if optic.slot not in slots]
    if beyond:
        remedy = "correct the slot numbers"
        if len(filters) > len(slots):
            remedy = f"{len(filters)} filters need an FW212C (12 slots), or two sessions"
        raise RefusedError(f"{name}: has slots 1 to {slots[-1]}, but the rig file puts {', '.join(beyond)}; {remedy}")


def _name(address: str) -> str:
    return f"filter wheel at {address}"


def _in(duration_s: float) -> float:
    """Return the reading of the monotonic clock in so many seconds."""
    return time.monotonic() + duration_s
