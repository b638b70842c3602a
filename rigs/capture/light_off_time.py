"""How long the laser stays on after a mishap, for each of its safety layers."""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from data_schemas.check import LightLayer, LightOff
from data_schemas.devices import LaserSettings
from data_schemas.errors import CaptureError, TimedOutError
from rigs.capture.laser_watch import LaserWatch, make_off
from rigs.light_guard import require_outside_layer
from rigs.open_rig import OpenRig

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


def after_exception(opened: OpenRig, repeats: int) -> LightOff:
    """Raise an exception in the block that lights the laser; ask the controller when the block is left.

    Raises
    ------
    CaptureError
        The laser does not go on.
    UnsafeError
        It is not confirmed off.
    """
    latest_s, still_on = [], 0
    for _ in range(repeats):
        start_s = opened.clock.monotonic_s()
        try:
            with opened.laser.lit():
                if not opened.laser.state():
                    raise CaptureError("laser: reads back off in the block that lights it; check interlock and key")
                start_s = opened.clock.monotonic_s()
                raise MishapError
        except MishapError:
            is_on = opened.laser.state()
        if is_on:
            still_on += 1
        else:
            latest_s.append(opened.clock.monotonic_s() - start_s)
    return LightOff(
        layer="block",
        witness="its own connection",
        earliest_s=(0.0,) * len(latest_s),
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
        try:
            with _holding(laser) as holder:
                killed_s = time.monotonic()
                _kill(holder, layer)
                earliest, latest = _watch(watch, killed_s)
        finally:
            make_off(laser)
        if latest is not None:
            earliest_s.append(earliest)
            latest_s.append(latest)
    return LightOff(
        layer=layer,
        witness=watch.witness,
        earliest_s=tuple(earliest_s),
        latest_s=tuple(latest_s),
        still_on=repeats - len(latest_s),
        watched_s=WATCHED_S,
    )


def _kill(holder: Holder, layer: LightLayer) -> None:
    """Kill the holder; for the dead-man all three, stopped first so that none can switch off in another's place."""
    pids = (holder.watch_pid, holder.guard_pid, holder.process.pid)
    if layer == "guard":
        holder.process.kill()
        return
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for pid in pids:
            os.kill(pid, number)


def _watch(watch: LaserWatch, killed_s: float) -> tuple[float, float | None]:
    """Return between which times after the kill (s) the laser went off; no latest one when it did not."""
    earliest_s = 0.0
    while time.monotonic() - killed_s < WATCHED_S:
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
        [sys.executable, "-P", "-m", "rigs.capture.laser_holder", laser.driver, laser.address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        try:
            said = _first_line(process)
            if not said.startswith("ON "):
                raise CaptureError(f"laser: the program that was to hold it on says: {said or 'nothing, and ends'}")
            guard_pid, watch_pid = map(int, said.split()[1:])
            yield Holder(process, guard_pid, watch_pid)
        finally:
            process.kill()


def _first_line(process: "subprocess.Popen[str]") -> str:
    """Return the first line that the program says."""
    if process.stdout is None or not select.select([process.stdout], [], [], START_WITHIN_S)[0]:
        raise TimedOutError(f"laser: the program that was to hold it on said nothing for {START_WITHIN_S:g} s")
    return process.stdout.readline().strip()
