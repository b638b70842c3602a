"""A light whose state is a file, to do to a guard what no emulated board does: refuse, lie, hang, crash.

The address is a folder. ``on`` exists while the light is on; ``refuse_off`` holds how many off commands fail, ``lies``
makes them return without effect, ``refuse_keep_alive`` makes keep-alives fail, ``refuse_state`` the state and
``refuse_opening`` the opening; ``slow_on`` makes the confirmation of "on" wait, ``late_on`` lets it fail and happen
later, after the seconds that it holds, ``slow_state`` holds back the state, and ``hang`` makes a keep-alive hang where
no alarm wakes it; ``serial`` holds the serial number of its board; ``line_port`` holds a port of this computer for the
words of "off". Without it the watch's line is a pipe to a shell that removes ``on``.
"""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from data_schemas import DeviceIdentity, LostError, RefusedError, UnsafeError
from rigs import Driver, Operator, SwitchOffCommand, offered

# Ends when nobody holds the other end of its pipe any more.
LINE = """
exec 3<&0
while read -r word <&3; do
  refusals=$(cat "$0/refuse_off" 2>/dev/null || echo 0)
  [ "$word" = off ] && [ "$refusals" -eq 0 ] && [ ! -e "$0/lies" ] && rm -f "$0/on"
done &
"""


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the place of INDI's lights, here and in the guard."""
    monkeypatch.setitem(offered("light"), "indi", (Driver("light", "indi", __name__),))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


HAS_DEAD_MAN = False


class FileSwitch:
    has_dead_man = HAS_DEAD_MAN

    def __init__(self, folder: Path, line: int) -> None:
        self.folder, self._line = folder, line

    def identity(self) -> DeviceIdentity:
        number = self.folder / "serial"
        serial = number.read_text() if number.exists() else ""
        return DeviceIdentity(role="laser", driver="indi", address=str(self.folder), model="file", serial=serial)

    def switch(self, on: bool, deadline_s: float) -> None:
        if on:
            if (self.folder / "refuse_on").exists():
                (self.folder / "on").touch()  # the command arrived, its confirmation did not
                raise RuntimeError("a driver's own mistake")
            if (late := self.folder / "late_on").exists():
                # As a server does whose client has gone: no process of ours can stop it.
                subprocess.Popen(
                    ["sh", "-c", 'sleep $1; touch "$0"', str(self.folder / "on"), late.read_text()],
                    start_new_session=True,
                )
                (self.folder / "asked").touch()
                time.sleep(deadline_s)
            (self.folder / "on").touch()
            if (self.folder / "slow_on").exists():
                time.sleep(deadline_s)
            return
        refusals = self.folder / "refuse_off"
        if refusals.exists() and (left := int(refusals.read_text())) > 0:
            refusals.write_text(str(left - 1))
            raise UnsafeError("the file does not go away")
        if not (self.folder / "lies").exists():
            (self.folder / "on").unlink(missing_ok=True)

    def state(self, deadline_s: float) -> bool:
        if (self.folder / "refuse_state").exists():
            raise LostError("the folder is away")
        if (self.folder / "slow_state").exists():
            (self.folder / "slow_state").unlink()
            time.sleep(deadline_s)
        return (self.folder / "on").exists()

    def off_words(self) -> SwitchOffCommand:
        if (port := self.folder / "line_port").exists():
            return SwitchOffCommand(b"\noff\n", ("127.0.0.1", int(port.read_text())))
        return SwitchOffCommand(b"\noff\n", self._line)

    def prove_dead_man(self, deadline_s: float) -> None:
        raise RefusedError("a file has no dead-man")

    def keep_alive(self) -> None:
        if (self.folder / "hang").exists():
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
            time.sleep(30.0)
        if (self.folder / "refuse_keep_alive").exists():
            raise LostError("nobody hears the keep-alive")


@contextmanager
def open_switch(address: str, role: str, operator: Operator | None) -> Iterator[FileSwitch]:
    if (Path(address) / "refuse_opening").exists():
        raise RefusedError("the file may not be opened; change its mode")
    theirs, ours = os.pipe()
    try:
        subprocess.run(["sh", "-c", LINE, address], stdin=theirs, check=True, start_new_session=True)
        yield FileSwitch(Path(address), ours)
    finally:
        os.close(theirs)
        os.close(ours)
