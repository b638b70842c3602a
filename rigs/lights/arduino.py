"""A laser or lamp on an Arduino with the firmware of ``rigs/lights/firmware``, whose dead-man switches it off.

Lines of ASCII at 9600 baud, each one word. Every line from the host has one answer; ``TRIP`` comes unasked when the
dead-man acts, and ``LASER 1.2`` also at every reset, which opening the port of most boards causes.
"""

import contextlib
import math
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from data_schemas import CaptureError, DeviceIdentity, LostError, RefusedError, TimedOutError, UnsafeError
from rigs import SwitchOffCommand
from rigs.transports import SerialLink, repeated, usb_serial_ports

if TYPE_CHECKING:
    from rigs import Operator


BAUD: Final = 9600
Word = Literal["ON", "OFF", "ERR", "TRIP", "LASER"]
_WORDS: Final[dict[bytes, Word]] = {b"ON": "ON", b"OFF": "OFF", b"ERR": "ERR", b"TRIP": "TRIP", b"LASER": "LASER"}
LINE: Final = re.compile(rb"(?:(ON|OFF|ERR|TRIP)|(LASER) (\d{1,3}\.\d{1,3}))\r?\n")


class WentOffError(LostError):
    """The light is off by itself: asking again would hide it."""


class GarbledError(LostError):
    """A line that the firmware never says."""


class Said(NamedTuple):
    """One line of the firmware; `version` of a ``LASER`` line."""

    word: Word
    version: str = ""


def parse(line: bytes, name: str) -> Said:
    """Return what a line of the controller `name` says.

    Raises
    ------
    LostError
        No firmware of ours says this.
    """
    match = LINE.fullmatch(line)
    if match is None:
        raise GarbledError(
            f"{name}: sends {line[:32]!r}, which the light's firmware never sends; check the cable, the ground "
            f"between board and computer and the speed ({BAUD} baud), and that no other program uses the port"
        )
    return Said(_WORDS[match[1] or match[2]], (match[3] or b"").decode())


HAS_DEAD_MAN: Final = True
FIRMWARE: Final = (1, 2)
"""Major version that is spoken here, and the first minor one with a dead-man of 0.4 s."""
ASK_WITHIN_S: Final = 0.25
"""An answer takes 5 ms on the wire and 45 ms through an emulated port; the dead-man waits longer than this."""
GREET_AGAIN_S: Final = 0.5
IDENTITY_WITHIN_S: Final = 1.5
RESET_WITHIN_S: Final = 2.5
"""Start of a board's boot loader until the firmware speaks."""
QUIET_S: Final = 0.1
LATE_S: Final = 1.0
"""An answer that is later than this counts as lost: an adapter or a busy computer delays it by less."""
PROOF_WITHIN_S: Final = 1.5
"""Until the word of the dead-man, which acts after 0.4 s, is here: the rest is for a busy computer."""
MISSED_ANSWERS: Final = 10
"""Keep-alives in a row without an answer before the controller counts as mute."""
BOARD_VENDORS: Final = ("2341", "2a03", "1a86")
"""USB vendors of Arduino's own boards and of the serial chip on most copies."""


class ArduinoSwitch:
    """The bare switch of a light on an Arduino.

    Parameters
    ----------
    link
        The open serial port.
    role, address
        What the light is and where, for messages and the identity.

    Raises
    ------
    RefusedError
        Something else answers, or a firmware of another major version.
    TimedOutError
        Nothing answers.
    """

    has_dead_man: Final = HAS_DEAD_MAN

    def __init__(self, link: SerialLink, role: Literal["laser", "lamp"], address: str) -> None:
        self._link, self._role, self._address = link, role, address
        self._name = f"{role} at {address}"
        self._unanswered = self._missed = 0
        self._marks: list[float] = []  # when each "I" was sent that is not answered yet
        self._out_of_step = self._is_fresh = False
        self._require_version(self._greet())

    def identity(self) -> DeviceIdentity:
        """Ask the controller who it is."""
        said = self._asked("I", IDENTITY_WITHIN_S, wanted="LASER")
        return DeviceIdentity(
            role=self._role,
            driver="arduino",
            address=self._address,
            model="light with dead-man",
            serial=self._link.board_serial,
            firmware=said.version,
        )

    def switch(self, on: bool, deadline_s: float) -> None:
        """Switch, and return when the controller's answer confirms it; at most `deadline_s` seconds.

        Raises
        ------
        RefusedError
            On was asked for and the controller stays off.
        UnsafeError
            Off was asked for and is not confirmed.
        """
        end_s = time.monotonic() + deadline_s
        if on:
            if self._exchange("L1", end_s).word == "ON":
                return
            # The answer may be that to an earlier command. "On" is never repeated, but the state may be asked for.
            self._out_of_step = True
            if self._exchange("?", end_s).word != "ON":
                raise RefusedError(f"{self._name}: does not switch on; flash its firmware again and check the board")
            return
        try:
            answer = self._exchange("L0", end_s).word
        except CaptureError as error:
            raise UnsafeError(self._unconfirmed(str(error))) from error
        if answer != "OFF":
            raise UnsafeError(self._unconfirmed(f"it answers {answer} to the command to switch off"))

    def state(self, deadline_s: float) -> bool:
        """Ask the controller afresh whether the light is on.

        Raises
        ------
        LostError
            The dead-man has switched the light off since the last exchange.
        """
        return self._asked("?", deadline_s).word == "ON"

    def off_words(self) -> SwitchOffCommand:
        """Return the off command; the line feed before it ends what is half said on the same line."""
        return SwitchOffCommand(b"\nL0\n", self._link.descriptor())

    def prove_dead_man(self, deadline_s: float) -> None:
        """Switch on and say nothing until the board tells that its dead-man has switched off.

        Raises
        ------
        RefusedError
            It did not.
        """
        self.switch(True, deadline_s)
        end_s = time.monotonic() + PROOF_WITHIN_S
        try:
            with self._in_step():
                while parse(self._link.read_until(b"\n", end_s), self._name).word != "TRIP":
                    pass
        except TimedOutError as error:
            raise RefusedError(
                f"{self._name}: its dead-man did not switch it off within {PROOF_WITHIN_S:g} s of silence. Do not use "
                "it; flash rigs/lights/firmware again, and check the board"
            ) from error

    def keep_alive(self) -> None:
        """Tell the controller that the host lives, and take in its earlier answers without waiting.

        Raises
        ------
        LostError
            The light is off: the dead-man acted, or the board restarted.
        TimedOutError
            The controller has not answered the last keep-alives.
        """
        with self._in_step():
            self._missed += bool(self._unanswered)
            while self._unanswered:
                try:
                    said = self._hear(time.monotonic(), tell_trip=True)
                except TimedOutError:
                    break
                except GarbledError:  # the next answer tells the same
                    self._unanswered -= 1
                    continue
                if said.word == "ERR":  # a damaged keep-alive changes nothing
                    continue
                if said.word != "ON":
                    raise WentOffError(
                        f"{self._name}: reports {said.word} although it was switched on; check the board"
                    )
                self._missed = 0
            if self._missed >= MISSED_ANSWERS:
                raise TimedOutError(
                    f"{self._name}: answered none of the last {MISSED_ANSWERS} keep-alives; check cable and board"
                )
            # One that was lost on the way is not waited for; a question finds its step first.
            self._out_of_step |= self._unanswered > 0
            self._unanswered = 0
            self._send("K", time.monotonic() + ASK_WITHIN_S)

    def _greet(self) -> Said:
        """Find out who is there, also when opening the port has reset the board; what it said before is forgotten."""
        heard: list[bytes] = []
        # Two lines: "?" ends what a former program may have left half said, and no boot loader takes either for an
        # order. An open port that did not reset the board answers at once; otherwise the banner comes after a while.
        for wait_s in (RESET_WITHIN_S, GREET_AGAIN_S):
            end_s = time.monotonic() + wait_s
            self._link.write(b"?\nI\n", end_s)
            with contextlib.suppress(TimedOutError):
                while True:
                    line = self._link.read_until(b"\n", end_s)
                    heard.append(line)
                    if (match := LINE.fullmatch(line)) and match[2]:
                        self._is_fresh = True  # more may come; "off" need not wait for the silence after it
                        return parse(line, self._name)
        if heard:
            raise RefusedError(
                f"{self._name}: sends {heard[-1][:32]!r}, but does not state its firmware; flash "
                "rigs/lights/firmware to the board, or correct the address"
            )
        raise TimedOutError(
            f"{self._name}: sent nothing within {RESET_WITHIN_S + GREET_AGAIN_S:g} s; check the cable and the address "
            "('finray rig detect'), and that the board runs rigs/lights/firmware"
        )

    def _require_version(self, said: Said) -> None:
        major, minor = (int(number) for number in said.version.split("."))
        if major != FIRMWARE[0] or minor < FIRMWARE[1]:
            raise RefusedError(
                f"{self._name}: runs firmware {said.version}, but this version of finray needs "
                f"{FIRMWARE[0]}.{FIRMWARE[1]} "
                f"or a later {FIRMWARE[0]}.x, whose dead-man acts within 0.4 s; flash rigs/lights/firmware to the "
                "board"
            )

    def _asked(self, question: str, deadline_s: float, wanted: Word | None = None) -> Said:
        """Return the answer to a question, repeated after faults but for those that switched the light off."""

        def attempt(end_s: float) -> Said:
            said = self._exchange(question, end_s, last_s=last_s, tell_trip=True, wanted=wanted)
            if said.word not in ((wanted,) if wanted else ("ON", "OFF")):
                self._out_of_step = True
                raise GarbledError(
                    f"{self._name}: answers {said.word} to '{question}', so the question was damaged on its way; check "
                    "the cable, and the ground between board and computer"
                )
            return said

        last_s = time.monotonic() + deadline_s
        return repeated(attempt, last_s, self._name, attempt_s=ASK_WITHIN_S, final=(WentOffError,))

    def _exchange(
        self, command: str, end_s: float, *, last_s: float = 0.0, tell_trip: bool = False, wanted: Word | None = None
    ) -> Said:
        """Send a command and return what answers it, not what answers an earlier command.

        To be in step again may last until `last_s`, where that is later than `end_s`.
        """
        if self._is_fresh and command == "L0":  # at once, and once more after the silence
            self._link.write(b"L0\n", end_s)
            with contextlib.suppress(TimedOutError):  # its answer is no answer to the next command
                self._link.read_until(b"\n", min(end_s, time.monotonic() + ASK_WITHIN_S))
        if self._is_fresh:
            self._link.drain(QUIET_S, max(end_s, time.monotonic() + RESET_WITHIN_S))
            self._unanswered, self._is_fresh = 0, False
            end_s = max(end_s, time.monotonic() + ASK_WITHIN_S)
        if self._out_of_step:
            # The command goes out before its step is found, so that "off" loses no time; all can be repeated. The
            # answer to a second "I" would be taken for that to the first.
            if command != "I":
                self._link.write(command.encode() + b"\n", end_s)
            self._find_step(end_s, max(end_s, last_s))
            end_s = max(end_s, min(time.monotonic() + ASK_WITHIN_S, last_s))
        self._send(command, end_s)
        with self._in_step():
            while True:
                said = self._hear(end_s, tell_trip, wanted)
                if self._unanswered == 0:
                    return said

    def _find_step(self, end_s: float, last_s: float) -> None:
        """Ask who is there, and pass over all that comes until the answer: nothing earlier can come after it.

        Where such a question was not answered before, it may have been lost, or the answer may be its own. Then
        silence must do: until that to the last question would be here if it were as late. A shorter silence would not
        show it: a line that is always late would answer each later question with the answer to an earlier one.
        """
        self._link.write(b"I\n", end_s)
        now_s = time.monotonic()
        self._marks = [*(asked_s for asked_s in self._marks if now_s - asked_s < LATE_S), now_s]
        quiet_s = math.inf
        while self._marks:
            try:
                line = self._link.read_until(b"\n", min(end_s, quiet_s))
            except TimedOutError:
                if end_s < quiet_s:
                    raise
                break
            now_s = time.monotonic()
            if (match := LINE.fullmatch(line)) and match[2]:
                late_s = now_s - self._marks.pop(0)
                if self._marks:
                    end_s, quiet_s = last_s, max(self._marks[-1] + min(late_s, LATE_S), now_s) + QUIET_S
            elif now_s > end_s:
                raise TimedOutError(f"{self._name}: does not stop sending; check that this port belongs to the light")
        self._marks.clear()
        self._unanswered = 0
        self._out_of_step = False

    def _send(self, command: str, end_s: float) -> None:
        self._link.write(command.encode() + b"\n", end_s)
        self._unanswered += 1

    @contextmanager
    def _in_step(self) -> Iterator[None]:
        """Note when answers may no longer belong to their commands."""
        try:
            yield
        except CaptureError:
            self._out_of_step = True
            raise

    def _hear(self, end_s: float, tell_trip: bool, wanted: Word | None = None) -> Said:
        """Return the next answer; lines that come unasked are told as what they mean."""
        while True:
            said = parse(self._link.read_until(b"\n", end_s), self._name)
            if said.word == "TRIP":
                if tell_trip:
                    raise WentOffError(
                        f"{self._name}: the dead-man switched it off, because the board had received nothing for 0.4 "
                        f"s; close other programs, check the cable, and repeat the command"
                    )
                continue
            if said.word == "LASER" and wanted != "LASER":
                raise WentOffError(
                    f"{self._name}: the board restarted, which switches the light off; check its power supply and cable"
                )
            self._unanswered -= 1
            return said

    def _unconfirmed(self, why: str) -> str:
        return (
            f"{self._name}: NOT CONFIRMED OFF: {why}. Its dead-man acts within 0.5 s of the last message that the "
            f"board receives, but that cannot be read back: pull the plug of the light before anyone opens the box"
        )


@contextmanager
def open_switch(
    address: str, role: Literal["laser", "lamp"], operator: "Operator | None" = None
) -> Iterator[ArduinoSwitch]:
    """Open the light's controller for a ``with`` block."""
    with SerialLink(address, BAUD, role) as link:
        yield ArduinoSwitch(link, role, address)


def found() -> list[tuple[str, str]]:
    """Return the boards that answer as a light: address and what each is. Opening a port resets most boards."""
    lights = []
    for port in usb_serial_ports():
        if port.usb_id.split(":")[0] not in BOARD_VENDORS:
            continue
        with contextlib.suppress(CaptureError), open_switch(port.address, "laser") as switch:
            lights.append((port.address, f"light with dead-man, firmware {switch.identity().firmware}"))
    return lights
