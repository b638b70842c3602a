"""A stage behind a controller with GRBL 1.1 or grblHAL: absolute jogs, cancelled to stop, places proven by reports.

Written after GRBL's documents "interface", "commands" and "jogging". Each line waits for its ``ok`` (send and response;
nothing here needs the buffers that character counting would fill), and no move is queued behind another: whoever pulls
the cable or kills the program leaves a stage that drives to the end of one move. Moves are jogs in machine coordinates
(``$J=G21G90G53``): no mode of the controller changes them, one beyond its own soft limits is refused without alarm, and
a jog cancel holds and forgets them with their place kept. A place counts as known from homing (or a person's word)
until the controller restarts, raises an alarm or is lost.
"""

import contextlib
import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from data_schemas import (
    CaptureError,
    LostError,
    PressDevice,
    RefusedError,
    StageSettings,
    TimedOutError,
    UnsafeError,
    WrongPositionError,
)
from rigs.transports import SerialLink, usb_serial_ports

BAUD: Final = 115200
RESET: Final = b"\x18"
JOG_CANCEL: Final = b"\x85"
"""A feed hold of a jog that also forgets it; grblHAL (2026) ignores the plain feed hold ``!`` in a jog."""
HOLD_AFTER_S: Final = 0.25
STANDING: Final = ("Idle", "Hold:0", "Alarm", "Door:0", "Door:1")
GREET_WITHIN_S: Final = 3.0
"""Boot loader of a board that restarts when its port is opened."""
ANSWER_WITHIN_S: Final = 1.0
"""A report comes within 20 ms, by the documents; a busy computer adds to it."""
ASK_EVERY_S: Final = 0.05
ASK_AGAIN_S: Final = 0.4
"""A question is not asked again before: GRBL passes over the second, and a slow controller falls behind."""
STOP_WITHIN_S: Final = 3.0
START_WITHIN_S: Final = 0.5
TAKEN_WITHIN_S: Final = 2.0
"""Until a line is answered; grblHAL's simulator reads a byte every few milliseconds."""
MOVE_MARGIN_S: Final = 5.0
INCH_MM: Final = 25.4
BOARD_VENDORS: Final = ("2341", "2a03", "1a86", "0403", "10c4")
"""USB vendors of Arduino's boards and of the serial chips on most controllers."""
_BANNER: Final = re.compile(r"Grbl(?:HAL)? (\S+)", re.IGNORECASE)
_ALARMS: Final = {
    1: "a limit switch was hit",
    2: "the end of a move lies beyond the controller's soft limits",
    3: "it was reset while it moved",
    4: "the probe input was in the wrong state",
    5: "the probe touched nothing",
    6: "homing was reset",
    7: "a door was opened while it homed",
    8: "homing could not clear a limit switch; raise its pull-off or check the wiring",
    9: "homing found no limit switch; check the switches and the controller's travel",
    10: "homing found no second switch of a double axis",
}
_ERRORS: Final = {
    2: "a number has the wrong format",
    3: "it does not know this command",
    5: "homing is switched off in it ($22)",
    8: "it is not idle",
    9: "it is locked by an alarm, or moves",
    11: "the line was too long",
    13: "its door is open",
    15: "the end of the move lies beyond its own travel ($130 to $132)",
    16: "a jog command holds a word that is not allowed in it",
    20: "it does not know this word",
    22: "a speed is missing",
    33: "the end of the move is not valid",
}


class Report(NamedTuple):
    """A status report: the state's word, its number after the colon, and the machine coordinates (mm)."""

    state: str
    substate: str
    places_mm: dict[str, float]


class GrblStage:
    """The axes behind one controller.

    Parameters
    ----------
    link
        The open serial port.
    settings
        The stage of the rig file.

    Raises
    ------
    TimedOutError
        Nothing that calls itself GRBL answers.
    """

    def __init__(self, link: SerialLink, settings: StageSettings) -> None:
        self._link, self._settings = link, settings
        self._name = f"stage at {settings.address}"
        self._is_known, self._is_unanswered, self._offset_mm = False, False, {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self._drives = "was not told to move"
        self._numbers: dict[int, float] = {}
        self._firmware = self._reset(GREET_WITHIN_S)
        self._numbers = self._read_settings()

    def identity(self) -> PressDevice:
        """Return what the controller said when it was opened."""
        return PressDevice(
            role="stage",
            driver="grbl",
            address=self._settings.address,
            model=self._settings.model or "GRBL controller",
            firmware=self._firmware,
        )

    def places_mm(self) -> dict[str, float] | None:
        """Ask where the axes stand; None while that is unknown: not homed, restarted, in alarm, or its count jumped."""
        report = self._report(time.monotonic() + ANSWER_WITHIN_S)
        if report.state == "Alarm":
            self._is_known = False
        return report.places_mm if self._is_known else None

    def counted_mm(self) -> dict[str, float]:
        """Ask for the controller's count, whether or not it is true."""
        report = self._report(time.monotonic() + ANSWER_WITHIN_S)
        if report.state != "Idle":
            raise RefusedError(f"{self._name}: is in state {report.state}; home it, or unlock it by hand ($X)")
        return report.places_mm

    def trust_places(self) -> dict[str, float]:
        """Take the controller's count for true."""
        places = self.counted_mm()
        self._is_known = True
        return places

    def home(self, deadline_s: float, watch: Callable[[], None]) -> None:
        """Run the controller's homing cycle; it answers no question meanwhile."""
        self._is_known = False
        end_s = time.monotonic() + deadline_s
        self._drives = "may continue to home: all axes drive to their switches"
        try:
            self._link.write(b"$H\n", end_s)
            while True:
                watch()
                line = self._line_now()
                if line == "ok":
                    break
                if line is None and time.monotonic() > end_s:
                    raise TimedOutError(f"{self._name}: did not home within {deadline_s:g} s; check its switches")
        except BaseException as error:
            # a feed hold does nothing while it homes
            if not self._halt():
                raise self._unsafe(error) from error
            raise
        self._wait_for(("Idle",), time.monotonic() + STOP_WITHIN_S)
        self._is_known = True

    def move(self, axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
        """Move one axis; see :class:`rigs.Stage`."""
        start_mm = self._start_of(axis, to_mm)
        deadline_s = abs(to_mm - start_mm) / speed_mm_per_s + MOVE_MARGIN_S
        self._drives = f"may continue to {axis} = {to_mm:.3f} mm, the end of its move"
        try:
            line = f"$J=G21G90G53{axis}{to_mm:.3f}F{60.0 * speed_mm_per_s:.2f}\n"
            self._is_unanswered = True
            self._link.write(line.encode(), time.monotonic() + ANSWER_WITHIN_S)
            self._follow(axis, to_mm, time.monotonic() + deadline_s, watch)
        except BaseException as error:
            try:
                self.stop()
            except UnsafeError as worse:
                raise worse from error
            raise

    def stop(self) -> None:
        """Cancel the jog, hold if it still moves, and reset once it stands: its place is kept. Else reset at once."""
        was_unanswered = self._is_unanswered
        try:
            end_s = time.monotonic() + STOP_WITHIN_S
            state = self._stand(end_s)
            late_s = time.monotonic() + START_WITHIN_S
            while self._is_unanswered and time.monotonic() < late_s:
                state = self._stand(end_s)
            if was_unanswered:
                # the move began after it was cancelled
                state = self._stand(end_s)
            before = self._report(time.monotonic() + ANSWER_WITHIN_S).places_mm
            self._reset(STOP_WITHIN_S)
            after = self._report(time.monotonic() + ANSWER_WITHIN_S)
            # a controller whose supply broke down greets in the same way, and counts from 0
            stayed = all(abs(after.places_mm[a] - at_mm) <= self._tolerance_mm(a) for a, at_mm in before.items())
            self._is_known &= state != "Alarm" and after.state == "Idle" and stayed
        except CaptureError as error:
            self._is_known = False
            if not self._halt():
                raise self._unsafe(error) from error

    def _unsafe(self, error: BaseException) -> UnsafeError:
        """Return what to say of a stage that is not seen to stop: how far it may drive."""
        return UnsafeError(
            f"{self._name}: NOT SEEN TO STOP: {error}. It {self._drives}; switch its motors off before anyone "
            "touches it"
        )

    def _tolerance_mm(self, axis: str) -> float:
        """Return one step of the motor, and the rounding of a report."""
        return 0.001 + 1.0 / self._numbers.get(100 + "XYZ".index(axis), 250.0)

    def _stand(self, end_s: float) -> str:
        """Cancel the jog, hold if that does not help, and return the state when it stands."""
        self._link.write(JOG_CANCEL, end_s)
        try:
            return self._wait_for(STANDING, min(time.monotonic() + HOLD_AFTER_S, end_s))
        except TimedOutError:
            self._link.write(b"!", end_s)
            return self._wait_for(STANDING, end_s)

    def _start_of(self, axis: str, to_mm: float) -> float:
        """Return where an axis stands, if it may move to a place."""
        low_mm, high_mm = self._settings.press_travel_mm
        if axis == self._settings.pad_axis:
            low_mm, high_mm = self._settings.pad_travel_mm
        elif axis != self._settings.press_axis:
            raise RefusedError(
                f"{self._name}: has no axis {axis}; the rig file has press_axis = {self._settings.press_axis} and "
                f"pad_axis = {self._settings.pad_axis}"
            )
        if not low_mm <= to_mm <= high_mm:
            raise RefusedError(
                f"{self._name}: {axis} = {to_mm:.3f} mm lies outside its travel of {low_mm:g} to {high_mm:g} mm in "
                "the rig file, so nothing moved; correct the plan, or the travel"
            )
        places = self.places_mm()
        if places is None:
            raise RefusedError(f"{self._name}: its position is unknown; home it first")
        return places[axis]

    def _follow(self, axis: str, to_mm: float, end_s: float, watch: Callable[[], None]) -> None:
        """Return when two reports in a row say that the axis stands at its end."""
        tolerance_mm = self._tolerance_mm(axis)
        asked_s = heard_s = taken_s = time.monotonic()
        is_taken, is_asked, arrivals = False, True, 0
        self._link.write(b"?", end_s)
        while arrivals < 2:
            watch()
            now_s = time.monotonic()
            if now_s > end_s:
                raise TimedOutError(
                    f"{self._name}: {axis} did not arrive at {to_mm:.3f} mm in time; check motor and switches"
                )
            if now_s - heard_s > ANSWER_WITHIN_S or (not is_taken and now_s - taken_s > TAKEN_WITHIN_S):
                raise TimedOutError(f"{self._name}: did not answer in time while it moved; check its cable and supply")
            line = self._line_now()
            if line == "ok":
                is_taken, taken_s = True, now_s
            elif line is not None and (report := self._parsed(line)) is not None:
                heard_s, at_mm = now_s, report.places_mm[axis]
                is_there = report.state == "Idle" and abs(at_mm - to_mm) <= tolerance_mm
                arrivals = arrivals + 1 if is_there and is_taken else 0
                if report.state not in ("Idle", "Jog", "Run"):
                    self._is_known = False
                    raise LostError(
                        f"{self._name}: is in state {report.state} in the middle of a move; check the "
                        "controller, then home the stage"
                    )
                if report.state == "Idle" and is_taken and not is_there and now_s - taken_s > START_WITHIN_S:
                    raise WrongPositionError(
                        f"{self._name}: {axis} was sent to {to_mm:.3f} mm, but stands at {at_mm:.3f} mm; check its "
                        "motor"
                    )
                is_asked = False
            # a question whose answer nobody waits for would answer the next one
            if arrivals < 2 and now_s - asked_s > (ASK_AGAIN_S if is_asked else ASK_EVERY_S):
                self._link.write(b"?", end_s)
                is_asked, asked_s = True, now_s

    def _halt(self) -> bool:
        """Reset without asking, over a new connection if the old one broke; return whether the controller answered.

        Raises
        ------
        UnsafeError
            Another board has the controller's address now: that one is not reset, and nothing can be said of ours.
        """
        self._is_known = False
        end_s = time.monotonic() + GREET_WITHIN_S
        while time.monotonic() < end_s:
            try:
                if self._link.is_broken:
                    self._link.reopen()
                self._reset(GREET_WITHIN_S)
                return True
            except RefusedError as error:
                raise self._unsafe(error) from error
            except (LostError, TimedOutError):
                time.sleep(0.05)
        return False

    def _reset(self, within_s: float) -> str:
        """Reset, and return the version with which the controller greets."""
        # a board that starts anew because its port was opened does not hear the first one
        for wait_s, quiet_s in ((1.0, 0.05), (within_s - 1.0, 0.3)):
            end_s = time.monotonic() + wait_s
            self._link.write(RESET, end_s)
            while time.monotonic() < end_s:
                with contextlib.suppress(TimedOutError):
                    line = self._link.read_until(b"\n", min(end_s, time.monotonic() + 0.02)).decode("ascii", "replace")
                    if match := _BANNER.match(line.strip()):
                        self._is_unanswered = False
                        self._link.drain(quiet_s, time.monotonic() + ANSWER_WITHIN_S)
                        return match[1]
        raise TimedOutError(
            f"{self._name}: no GRBL controller answered within {within_s:g} s; check the cable, the address ('finray "
            "rig detect') and its power"
        )

    def _read_settings(self) -> dict[int, float]:
        """Return the controller's numbered settings."""
        end_s = time.monotonic() + GREET_WITHIN_S
        self._link.write(b"$$\n", end_s)
        numbers: dict[int, float] = {}
        while True:
            line = self._link.read_until(b"\n", end_s).decode("ascii", "replace").strip()
            if line == "ok":
                return numbers
            if match := re.fullmatch(r"\$(\d+)=(-?\d+(?:\.\d+)?)(?: .*)?", line):
                numbers[int(match[1])] = float(match[2])
            elif line.startswith("error:"):
                raise RefusedError(f"{self._name}: {_in_words(line)}")

    def _report(self, end_s: float) -> Report:
        """Ask for a status report, again where none comes; one that was asked for before is not taken for it."""
        while self._line_now() is not None:
            pass
        while True:
            self._link.write(b"?", end_s)
            again_s = time.monotonic() + ASK_AGAIN_S
            while time.monotonic() < min(again_s, end_s):
                line = self._line_now()
                if line is not None and (report := self._parsed(line)) is not None:
                    return report
            if time.monotonic() >= end_s:
                raise TimedOutError(f"{self._name}: does not report its position; check its cable and power")

    def _wait_for(self, states: tuple[str, ...], end_s: float) -> str:
        """Return the first of the states that is reported."""
        while True:
            report = self._report(end_s)
            for state in states:
                if state in (report.state, f"{report.state}:{report.substate}"):
                    return state
            if time.monotonic() > end_s:
                raise TimedOutError(f"{self._name}: is still in state {report.state}; check the controller")
            time.sleep(ASK_EVERY_S)

    def _line_now(self) -> str | None:
        """Return a line that has come; None where none has. What changes everything is raised.

        Raises
        ------
        LostError
            The controller restarted.
        RefusedError
            It refuses a command, or raised an alarm.
        """
        try:
            line = self._link.read_until(b"\n", time.monotonic()).decode("ascii", "replace").strip()
        except TimedOutError:
            return None
        if _BANNER.match(line):
            self._is_known = False
            raise LostError(f"{self._name}: the controller restarted, so its position is unknown; home it again")
        self._is_unanswered &= line != "ok" and not line.startswith("error:")
        if line.startswith(("ALARM:", "error:")):
            self._is_known &= not line.startswith("ALARM:")
            raise RefusedError(f"{self._name}: {_in_words(line)}")
        return line

    def _parsed(self, line: str) -> Report | None:
        """Return the report in a line; None where it is none."""
        if not (line.startswith("<") and line.endswith(">")):
            return None
        state, *fields = line[1:-1].split("|")
        named = dict(field.partition(":")[::2] for field in fields)
        unit_mm = INCH_MM if self._numbers.get(13, 0.0) == 1.0 else 1.0
        try:
            axes = {
                key: dict(zip("XYZ", (unit_mm * float(n) for n in named[key].split(",")), strict=False))
                for key in ("MPos", "WPos", "WCO")
                if key in named
            }
            self._offset_mm = axes.get("WCO", self._offset_mm)
            places = axes.get("MPos") or {axis: at + self._offset_mm[axis] for axis, at in axes["WPos"].items()}
        except (KeyError, ValueError):
            return None  # torn on the way; the next one tells
        return Report(state.partition(":")[0], state.partition(":")[2], places) if len(places) == 3 else None


def _in_words(line: str) -> str:
    """Return an error or alarm of the controller in words."""
    kind, _, number = line.partition(":")
    known = _ALARMS if kind == "ALARM" else _ERRORS
    words = known.get(int(number), "see its documents") if number.isdecimal() else "see its documents"
    if kind == "ALARM":
        return f"alarm {number} ({words}); the position is unknown now. Free the stage by hand, then home it again"
    return f"refuses a command with error {number} ({words})"


@contextmanager
def open_stage(settings: StageSettings) -> Iterator[GrblStage]:
    """Open the controller for a ``with`` block; whatever it was doing is stopped."""
    with SerialLink(settings.address, BAUD, "stage") as link:
        yield GrblStage(link, settings)


def found() -> list[tuple[str, str]]:
    """Return the ports at which GRBL reports a place, and its version if it greets: boards restart when one is opened.

    Only a status report is asked for, which no state of the controller forbids and which changes nothing.
    """
    stages = []
    for port in usb_serial_ports():
        if port.usb_id.split(":")[0] not in BOARD_VENDORS:
            continue
        with contextlib.suppress(CaptureError), SerialLink(port.address, BAUD, "stage") as link:
            if (firmware := _version_behind(link)) is not None:
                stages.append((port.address, f"GRBL {firmware}".strip()))
    return stages


def _version_behind(link: SerialLink) -> str | None:
    """Return the version with which a controller greeted, empty without a greeting; None where no place is reported."""
    end_s, asked_s, firmware = time.monotonic() + GREET_WITHIN_S, -math.inf, ""
    while time.monotonic() < end_s:
        if time.monotonic() - asked_s > ASK_AGAIN_S:
            link.write(b"?", end_s)
            asked_s = time.monotonic()
        with contextlib.suppress(TimedOutError):
            line = link.read_until(b"\n", min(end_s, time.monotonic() + ASK_EVERY_S)).decode("ascii", "replace").strip()
            if match := _BANNER.match(line):
                firmware = match[1]
            elif re.fullmatch(r"<\w+(?::\d+)?\|[MW]Pos:[-\d.,]+.*>", line):
                return firmware
    return None
