"""How long the laser stays on after a mishap, for each of its safety layers.

Who sees whether it is on while its guard holds its connection is a witness of :mod:`rigs.capture._check_light`, or a
new connection. The victim of the mishap is this module started as ``python -m rigs.capture.light_off_time DRIVER
ADDRESS``: it keeps the laser on behind its guard and says ``ON`` and the process numbers of guard and watch. It ends,
and the laser goes off, when its standard input closes (whoever started it is gone), at the latest after 10 s.
"""

import os
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Final, NamedTuple

from data_schemas import (
    CaptureError,
    FinrayError,
    LaserSettings,
    LightLayer,
    LightOff,
    TimedOutError,
    UnsafeError,
    Witness,
)
from rigs import LightSwitch, OpenRig, driver_module, find_driver
from rigs.capture._check_light import SEEING, LaserWatch, Reading, require_seen
from rigs.light_guard import GuardedLight, LightLostError, require_outside_layer

ASK_WITHIN_S: Final = 1.0
ASK_EVERY_S: Final = 0.02
OFF_WITHIN_S: Final = 5.0


class ConnectionWatch:
    """A new connection to the laser's controller as the witness; one is made for every look.

    Parameters
    ----------
    laser
        Driver and address.
    quiet_s
        Pause before every look. A dead-man counts a question as a sign of life: it is asked seldom.
    """

    witness: Witness = "a new connection"

    def __init__(self, laser: LaserSettings, quiet_s: float = ASK_EVERY_S) -> None:
        self._laser, self._quiet_s = laser, quiet_s

    def look(self) -> Reading:
        """Ask the controller, if a connection is to be had.

        A dead-man that is asked while it counts starts anew: when the answer is "off", it was off at the first word
        of the connection, which is then the end of the look.
        """
        time.sleep(self._quiet_s)
        start_s = time.monotonic()
        try:
            with _open_switch(self._laser) as switch:
                on = bool(switch.state(ASK_WITHIN_S))
                answered_s = time.monotonic()
                asked_dead_man = bool(switch.has_dead_man) and self._quiet_s > ASK_EVERY_S
        except CaptureError:
            return Reading(start_s, time.monotonic(), None)
        return Reading(start_s, start_s if asked_dead_man and not on else answered_s, on)


def can_be_asked_anew(laser: LaserSettings) -> bool:
    """Whether a second connection tells the state without changing it: opening a serial port resets most boards."""
    return laser.driver in ("indi", "alpaca") or laser.address.startswith("socket://")


def _open_switch(laser: LaserSettings) -> AbstractContextManager[LightSwitch]:
    """Return the laser's switch over a connection of its own, without a guard, for a ``with`` block."""
    switch: AbstractContextManager[LightSwitch]
    switch = driver_module(find_driver("light", laser.driver)).open_switch(laser.address, "laser", None)
    return switch


def make_off(laser: LaserSettings) -> None:
    """Switch the laser off over a connection of our own, trying for some seconds.

    Raises
    ------
    UnsafeError
        It is not confirmed off.
    """
    end_s = time.monotonic() + OFF_WITHIN_S
    while True:
        try:
            with _open_switch(laser) as switch:
                switch.switch(False, ASK_WITHIN_S)
                return
        except CaptureError as error:
            if time.monotonic() > end_s:
                raise UnsafeError(
                    f"laser at {laser.address}: NOT CONFIRMED OFF after its safety layers were tried; pull "
                    f"its plug before anyone opens the box. The cause: {error}"
                ) from error
        time.sleep(ASK_EVERY_S)


WATCHED_S: Final = 5.0
"""A layer that takes longer has failed."""
START_WITHIN_S: Final = 40.0


class MishapError(Exception):
    """Stands for whatever may go wrong while the laser is on."""


class Holder(NamedTuple):
    """A program that holds the laser on, and the guard and the watch of its laser."""

    process: "subprocess.Popen[str]"
    guard_pid: int
    watch_pid: int


def after_exception(opened: OpenRig, repeats: int, watch: LaserWatch | None = None) -> LightOff:
    """Raise an exception in the block that lights the laser; ask the controller when the block is left.

    A watch that sees the light is asked too, where there is one: it must see the laser on before, and off after.

    Raises
    ------
    LightLostError
        The laser does not go on, or went off by itself.
    UnsafeError
        It is not confirmed off.
    """
    earliest_s, latest_s, still_on = list[float](), list[float](), 0
    for _ in range(repeats):
        start_s = opened.clock.monotonic_s()
        try:
            with opened.laser.lit():
                if not opened.laser.state():
                    raise LightLostError(
                        "laser: reports that it is off right after it was switched on; check interlock and key"
                    )
                if watch is not None:
                    require_seen(watch, opened.clock.monotonic_s)
                start_s = opened.clock.monotonic_s()
                raise MishapError
        except MishapError:
            is_on = opened.laser.state()
        asked_s = opened.clock.monotonic_s() - start_s
        earliest, latest = (0.0, asked_s) if watch is None else _watch(watch, start_s, opened.clock.monotonic_s)
        if is_on or latest is None:
            still_on += 1
        else:
            earliest_s.append(earliest)
            latest_s.append(latest)
    if watch is not None:  # one that went blind in the last mishap has seen it go off, too
        with opened.laser.lit():
            require_seen(watch, opened.clock.monotonic_s)
    return LightOff(
        layer="block",
        witness="its own connection" if watch is None else watch.witness,
        earliest_s=tuple(earliest_s),
        latest_s=tuple(latest_s),
        still_on=still_on,
    )


def after_kill(laser: LaserSettings, layer: LightLayer, watch: LaserWatch, repeats: int) -> LightOff:
    """Kill who holds the laser (layer "guard"), or all three processes ("dead-man"), and watch; off in any case then.

    Nothing else may have the laser open.

    Raises
    ------
    CaptureError
        The laser does not go on, or must not, or the witness fails.
    UnsafeError
        The laser is not confirmed off in the end.
    """
    require_outside_layer(laser)
    earliest_s: list[float] = []
    latest_s: list[float] = []
    for _ in range(repeats):
        for _ in range(_MOST_TRIES):
            try:
                with _holding(laser) as holder:
                    require_seen(watch)
                    killed_s = time.monotonic()
                    at_once = _kill(holder, layer)
                    earliest, latest = _watch(watch, killed_s)
            finally:
                make_off(laser)
            if at_once:
                break
        else:
            raise CaptureError(
                f"laser at {laser.address}: its three processes could not be stopped at the same time in "
                f"{_MOST_TRIES} tries, so one of them may switch the laser off before the dead-man does; close other "
                f"programs and run the check again"
            )
        if latest is not None:
            earliest_s.append(earliest)
            latest_s.append(latest)
    if watch.witness in SEEING:  # one that went blind in the last mishap has seen it go off, too
        try:
            with _holding(laser):
                require_seen(watch)
        finally:
            make_off(laser)
    return LightOff(
        layer=layer,
        witness=watch.witness,
        earliest_s=tuple(earliest_s),
        latest_s=tuple(latest_s),
        still_on=repeats - len(latest_s),
        watched_s=WATCHED_S,
    )


_AT_ONCE_S = 1e-4
"""Where they cannot be kept on one core. One that runs in between needs about as long to see that another was stopped
and to say "off"."""
_MOST_TRIES = 10


def _kill(holder: Holder, layer: LightLayer) -> bool:
    """Kill the holder; for the dead-man all three, stopped first so that none can switch off in another's place.

    Return whether none of them can have run between the first stop and the last. On one core with this process that is
    known: this process was never taken off it, however long it took.

    Raises
    ------
    CaptureError
        One of them had ended by itself.
    """
    pids = (holder.watch_pid, holder.guard_pid, holder.process.pid)
    if layer == "guard":
        holder.process.kill()
        return True
    try:
        with _on_one_core(pids) as are_together:
            began_s, switches = time.monotonic(), _switches()
            try:
                for pid in pids:
                    os.kill(pid, signal.SIGSTOP)
                switched, took_s = _switches() - switches, time.monotonic() - began_s
                for pid in pids:
                    os.kill(pid, signal.SIGKILL)
            except BaseException:  # one left stopped could not switch off, and would hold the port
                for pid in pids:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                raise
    except ProcessLookupError:
        raise CaptureError(
            "laser: its guard or watch ended before the check killed it; find out why, then check again"
        ) from None
    return switched == 0 if are_together else took_s < _AT_ONCE_S


def _switches() -> int:
    """Return how often this thread was taken off its core, or left it, so far."""
    usage = resource.getrusage(resource.RUSAGE_THREAD if sys.platform == "linux" else resource.RUSAGE_SELF)
    return usage.ru_nvcsw + usage.ru_nivcsw


def _threads(pid: int) -> list[str]:
    """Return the threads of a process, by their numbers."""
    try:
        return os.listdir(f"/proc/{pid}/task")
    except FileNotFoundError:
        raise ProcessLookupError from None


@contextmanager
def _on_one_core(pids: Sequence[int]) -> Iterator[bool]:
    """Keep the processes on one core with this one for a ``with`` block, so that none runs while this one does.

    Yield whether the system lets us. They are made to wait for their turn when they wake (SCHED_BATCH): a stop wakes
    them, and would let them take the core at once.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield False
        return
    ours = os.sched_getaffinity(0)
    core = {min(ours)}
    try:
        for thread in (*(int(thread) for pid in pids for thread in _threads(pid)), 0):
            try:
                os.sched_setaffinity(thread, core)
                if thread:
                    os.sched_setscheduler(thread, os.SCHED_BATCH, os.sched_param(0))
            except ProcessLookupError:
                raise
            except OSError:
                continue
        time.sleep(ASK_EVERY_S)  # whoever has rested is not interrupted at once
        now = [int(thread) for pid in pids for thread in _threads(pid)]
        yield all(os.sched_getaffinity(thread) == core for thread in (*now, 0))
    finally:
        os.sched_setaffinity(0, ours)


def _watch(
    watch: LaserWatch, killed_s: float, now_s: Callable[[], float] = time.monotonic
) -> tuple[float, float | None]:
    """Return between which times after the kill (s) the laser went off; no latest one when it did not."""
    earliest_s = 0.0
    while now_s() - killed_s < WATCHED_S:
        reading = watch.look()
        if reading.on is False:
            return earliest_s, max(reading.end_s - killed_s, earliest_s)
        if reading.on:
            earliest_s = max(reading.start_s - killed_s, 0.0)
    return earliest_s, None


@contextmanager
def _holding(laser: LaserSettings) -> Iterator[Holder]:
    """Run a program of its own that holds the laser on for a ``with`` block."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "rigs.capture.light_off_time", laser.driver, laser.address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        try:
            said = _first_line(process)
            if not said.startswith("ON "):
                raise CaptureError(
                    f"laser: the program that should keep it on answered: {said or 'nothing, and ended'}"
                )
            guard_pid, watch_pid = map(int, said.split()[1:])
            yield Holder(process, guard_pid, watch_pid)
        finally:
            process.kill()


def _first_line(process: "subprocess.Popen[str]") -> str:
    """Return the first line that the program says."""
    if process.stdout is None or not select.select([process.stdout], [], [], START_WITHIN_S)[0]:
        raise TimedOutError(f"laser: the program that should keep it on did not answer within {START_WITHIN_S:g} s")
    return process.stdout.readline().strip()


LONGEST_S: Final = 10.0


def main(arguments: list[str]) -> int:
    """Hold the laser that the arguments name."""
    driver, address = arguments
    try:
        light = GuardedLight("laser", driver, address)
        try:
            light.open()
            with light.lit():
                sys.stdout.write(f"ON {light.guard_pid} {light.watch_pid}\n")
                sys.stdout.flush()
                select.select([sys.stdin], [], [], LONGEST_S)
        finally:
            light.close()
    except FinrayError as error:
        sys.stdout.write(f"{' '.join(str(error).split())}\n")
        sys.stdout.flush()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
