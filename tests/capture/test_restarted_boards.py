"""Whole sessions in which the board of a light restarts, or its port comes back under another name.

The board is a twin of ``rigs/lights/firmware/laser.c`` on a pseudo-terminal, which lights the simulated bench; the
guard and the watch are processes of their own, as in a laboratory. Each frame carries what was true while it was
exposed.
"""

import contextlib
import math
import os
import pty
import re
import select
import signal
import threading
import time
import tty
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from data_schemas import CaptureError, CaptureSession, LampSettings, LostError, RefusedError
from rigs import RawFrame, driver_notes, inspect_rig, open_rig, paint_plan, paper_rig, simulated_rig
from rigs.capture import SessionRequest, paint_steps, read_interrupted
from rigs.capture._paint_session import capture_with
from rigs.light_guard import guarded_light
from rigs.light_guard._reconnecting_light import ReconnectingLight
from rigs.lights.arduino import open_switch
from rigs.transports import SerialLink, port_advice, usb_serial_ports
from tests.capture.drivers import file_switch
from tests.capture.test_lying_devices import LyingCamera, wrong

DEAD_MAN_S = 0.4
BANNER = b"LASER 1.2\n"


class LightBoard:
    """An Arduino with the light's firmware: opening its port restarts it, and its boot loader is deaf for a while.

    Parameters
    ----------
    folder
        Stands for ``/dev``: the port is ``ttyACM0`` there, and its lasting name is ``by-id``.
    lights
        Called with the state of pin 8 when it changes.
    boot_s
        From a reset until the firmware speaks.
    """

    def __init__(self, folder: Path, lights: Callable[[bool], None], boot_s: float) -> None:
        self.by_id, self.restarts, self.heard = folder / "by-id", 0, list[bytes]()
        self._folder, self._lights, self._boot_s = folder, lights, boot_s
        self._is_on = self._is_open = False
        self._deaf_until_s = self._held_until_s = 0.0
        self._signed_s, self._line, self._cut_at = time.monotonic(), b"", -1
        self.late_by_s, self._answers = 0.0, list[tuple[float, bytes]]()  # math.inf: they are lost
        self._turn, self._over = threading.Lock(), threading.Event()
        self.plug("ttyACM0")
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def plug(self, name: str) -> None:
        """Appear as a port of this name."""
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port, self._is_open = self._folder / name, False
        self.port.symlink_to(os.ttyname(slave))
        self.by_id.symlink_to(self.port)
        os.close(slave)
        self._is_plugged = True

    def pull(self) -> None:
        """Lose cable and power."""
        with self._turn:
            self._is_plugged = False
            self._set(False)
            self.port.unlink()
            self.by_id.unlink()
            os.close(self._master)

    def brown_out(self) -> None:
        """Restart, at once."""
        with self._turn:
            self._restart()

    def brown_out_in_answer(self, after_bytes: int) -> None:
        """Restart in the middle of the next answer."""
        with self._turn:
            self._cut_at = after_bytes

    def hold(self, duration_s: float) -> None:
        """Do nothing for a while: what comes meanwhile is answered later, as behind an adapter that stalls."""
        self._held_until_s = time.monotonic() + duration_s

    @property
    def is_on(self) -> bool:
        return self._is_on

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        if self._is_plugged:
            self.pull()

    def _restart(self) -> None:
        self._set(False)
        self.restarts += 1
        self._line, self._deaf_until_s = b"", time.monotonic() + self._boot_s

    def _set(self, on: bool) -> None:
        self._is_on = on
        self._lights(on)

    def _work(self) -> None:
        while not self._over.wait(0.002):
            with self._turn:
                if self._is_plugged and time.monotonic() > self._held_until_s:
                    self._tick(time.monotonic())

    def _tick(self, now_s: float) -> None:
        while self._answers and self._answers[0][0] <= now_s:
            with contextlib.suppress(OSError):
                os.write(self._master, self._answers.pop(0)[1])
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        found = poll.poll(0)
        happened = found[0][1] if found else 0
        was_open, self._is_open = self._is_open, not happened & select.POLLHUP
        if self._is_open and not was_open:
            self._restart()  # DTR
        data = os.read(self._master, 256) if happened & select.POLLIN else b""
        if self._deaf_until_s:
            if now_s < self._deaf_until_s:
                return  # the boot loader takes what comes
            self._deaf_until_s = 0.0
            self._say(BANNER)
        if self._is_on and now_s - self._signed_s > DEAD_MAN_S:
            self._set(False)
            self._say(b"TRIP\n")
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            self.heard.append(line)
            if line and not self._deaf_until_s:
                self._obey(line, now_s)

    def _obey(self, line: bytes, now_s: float) -> None:
        if line not in (b"L1", b"L0", b"K", b"?", b"I"):
            self._say(b"ERR\n")
            return
        self._signed_s = now_s
        if line in (b"L1", b"L0"):
            self._set(line == b"L1")
        answer = BANNER if line == b"I" else b"ON\n" if self._is_on else b"OFF\n"
        if self._cut_at < 0:
            self._say(answer)
            return
        self._say(answer[: self._cut_at])
        self._cut_at = -1
        self._restart()

    def _say(self, data: bytes) -> None:
        if self._is_open and self.late_by_s < math.inf:
            self._answers.append((time.monotonic() + self.late_by_s, data))


@dataclass
class DisturbedCamera(LyingCamera):
    """The camera of the bench, at some of whose exposures something happens."""

    acts: dict[int, Callable[[], None]] = field(default_factory=dict)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        self.acts.get(self.taken + 1, lambda: None)()
        return super().expose(exposure_s, deadline_s)


class Bench:
    """A simulated rig whose light of a name is an Arduino's."""

    def __init__(self, folder: Path, name: str, boot_s: float) -> None:
        self.rig = simulated_rig("red", width_px=64, height_px=64)
        self.plan = paint_plan("red", self.rig.camera).model_copy(
            update={"filters": ("450", "532", "600"), "bracket": (1.0, 0.25), "darks_per_exposure": 1}
        )
        self.folder, self.name, self.boot_s = folder, name, boot_s
        self.resumes: list[str] = []

    def capture(self, address: str, acts: Callable[[LightBoard], dict[int, Callable[[], None]]]) -> CaptureSession:
        """Capture a session, and resume it by hand where it ends."""
        out, interrupted = self.folder / "s", None
        with ExitStack() as stack:
            opened = stack.enter_context(open_rig(self.rig, Path()))
            board = LightBoard(self.folder, lambda on: setattr(opened.camera.state, self.name, on), self.boot_s)
            stack.callback(board.close)
            light = stack.enter_context(guarded_light(self.name, "arduino", str(self.folder / address)))
            changed = replace(opened, camera=DisturbedCamera(opened, "", 0, acts=acts(board)), **{self.name: light})
            for _ in range(4):
                try:
                    request = SessionRequest(out, "pytest")
                    steps = paint_steps(self.plan, self.rig)
                    return capture_with(changed, self.rig, self.plan, steps, request, interrupted=interrupted)
                except CaptureError as error:
                    self.resumes.append(str(error))
                    interrupted = read_interrupted(out)
        raise AssertionError(self.resumes)


# The exposure before which the board restarts, and after how many bytes of its next answer; at once where that is -1.
@pytest.mark.parametrize(
    ("name", "boot_s", "restarts"),
    [
        ("lamp", 0.0, {9: 2, 18: -1, 33: 1, 50: 0}),
        ("laser", 0.05, {4: 1, 12: 2, 27: -1, 47: 0}),
        ("lamp", 1.2, {6: -1, 40: 2}),
    ],
)
def test_a_board_that_restarts_leaves_no_wrong_frame_and_needs_nobody(
    tmp_path: Path, name: str, boot_s: float, restarts: dict[int, int]
) -> None:
    boards = list[LightBoard]()

    def acts(board: LightBoard) -> dict[int, Callable[[], None]]:
        boards.append(board)
        return {
            at: board.brown_out if after < 0 else partial(board.brown_out_in_answer, after)
            for at, after in restarts.items()
        }

    bench = Bench(tmp_path, name, boot_s)
    session = bench.capture("by-id", acts)
    assert wrong(session) == []
    assert bench.resumes == []
    assert boards[0].restarts > len(restarts)  # opening the port restarts it too


def test_a_port_that_comes_back_under_another_name_is_found_by_its_link(tmp_path: Path) -> None:
    bench, renaming = Bench(tmp_path, "lamp", 0.5), list[threading.Timer]()

    def acts(board: LightBoard) -> dict[int, Callable[[], None]]:
        def replug() -> None:
            board.pull()
            renaming.append(threading.Timer(1.0, board.plug, ["ttyACM1"]))
            renaming[0].start()

        return {14: replug}

    session = bench.capture("by-id", acts)
    renaming[0].join()
    assert not (tmp_path / "ttyACM0").exists()
    assert wrong(session) == []
    assert bench.resumes == []


class TestTwoBoardsOfOneKind:
    """Laser and lamp run the same firmware, and after a replug each has the name of the other's port."""

    @staticmethod
    def boards(folder: Path, monkeypatch: pytest.MonkeyPatch, numbers: tuple[str | None, ...]) -> list[LightBoard]:
        """Plug in boards with serial numbers, as ttyACM0 and so on."""
        boards, ports = list[LightBoard](), list[ListPortInfo]()
        for number, serial in enumerate(numbers):
            place = folder / f"board{number}"
            place.mkdir()
            boards.append(LightBoard(place, lambda on: None, 0.0))
            (folder / f"ttyACM{number}").symlink_to(boards[-1].port)
            usb = ListPortInfo(os.path.realpath(boards[-1].port))
            usb.description, usb.vid, usb.pid, usb.serial_number = "Arduino Uno", 0x2341, 0x0043, serial
            ports.append(usb)
        monkeypatch.setattr(list_ports, "comports", lambda *_: list(ports))
        return boards

    @staticmethod
    def swap(folder: Path) -> None:
        """Exchange the names of the ports."""
        first, second = folder / "ttyACM0", folder / "ttyACM1"
        first.rename(folder / "away")
        second.rename(first)
        (folder / "away").rename(second)

    def test_the_other_one_is_never_lit(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        lamp, laser = self.boards(tmp_path, monkeypatch, ("L-1", "L-2"))
        light = ReconnectingLight(partial(open_switch, str(tmp_path / "ttyACM0"), "lamp"), "lamp")
        with closing(lamp), closing(laser), closing(light):
            light.same().switch(True, 1.0)
            assert lamp.is_on
            light.close()
            self.swap(tmp_path)
            with pytest.raises(
                RefusedError, match=r"lamp: another board answers now .*'L-2', but 'L-1' before.*by-id/"
            ):
                light.same().switch(True, 1.0)
            assert not laser.is_on
            assert b"L1" not in laser.heard
            self.swap(tmp_path)
            light.same().switch(True, 1.0)
            assert lamp.is_on

    def test_a_link_opens_no_other_board_again(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        boards = self.boards(tmp_path, monkeypatch, ("L-1", "L-2"))
        with closing(boards[0]), closing(boards[1]), SerialLink(str(tmp_path / "ttyACM0"), 9600, "wheel") as link:
            link.reopen()
            self.swap(tmp_path)
            for _ in range(2):
                with pytest.raises(RefusedError, match=r"wheel at .*ttyACM0: another board .*'L-2', but 'L-1' before"):
                    link.reopen()
                with pytest.raises(LostError):
                    link.write(b"?", time.monotonic() + 1.0)
            assert boards[1].heard == []
            self.swap(tmp_path)
            link.reopen()
            assert link.board_serial == "L-1"

    def test_a_port_whose_serial_number_is_not_known_yet_is_tried_again(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """While the system still learns what was plugged in, it lists no serial number."""
        (board,) = self.boards(tmp_path, monkeypatch, ("L-1",))
        with closing(board), SerialLink(str(tmp_path / "ttyACM0"), 9600, "wheel") as link:
            with monkeypatch.context() as patch:
                patch.setattr(list_ports, "comports", lambda *_: [])
                with pytest.raises(LostError, match=r"wheel at .*: the serial number of its board .*was 'L-1' before"):
                    link.reopen()
            link.reopen()
            assert link.board_serial == "L-1"

    def test_one_board_with_two_interfaces_is_one_board(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Both ports have its serial number, or none; its links under by-id differ where they are there."""
        boards = self.boards(tmp_path, monkeypatch, ("L-1", "L-1"))
        for number, port in enumerate(list_ports.comports()):
            port.location = f"1-1.4:1.{2 * number}"
            monkeypatch.setattr("rigs.transports._serial_link.LASTING_NAMES", f"{tmp_path}/by-id/")
        second = os.path.realpath(tmp_path / "ttyACM1")
        with closing(boards[0]), closing(boards[1]):
            (tmp_path / "by-id").mkdir()
            (tmp_path / "by-id" / "usb-L-1-if02").symlink_to(second)
            assert re.search(r"or a restart; write .*/by-id/usb-L-1-if02 into the rig file$", port_advice(second))
            # links that differ tell ports apart, wherever the boards are
            (tmp_path / "by-id" / "usb-L-1-if00").symlink_to(os.path.realpath(tmp_path / "ttyACM0"))
            for port in list_ports.comports():
                port.location = None
            assert usb_serial_ports()[1].address == str(tmp_path / "by-id" / "usb-L-1-if02")

    def test_two_boards_without_links_are_warned_of(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        boards = self.boards(tmp_path, monkeypatch, (None, None))
        for constant in ("LASTING_NAMES", "SOCKET_NAMES"):
            monkeypatch.setattr(f"rigs.transports._serial_link.{constant}", f"{tmp_path}/none/")
        with closing(boards[0]), closing(boards[1]):
            advice = port_advice(os.path.realpath(tmp_path / "ttyACM1"))
            assert re.search(r"2 boards here .* apart; there are no links .* always in the same order$", advice)

    @pytest.mark.parametrize(
        ("numbers", "folder", "text"),
        [
            (("L-1", "L-2"), "by-id", r"replug or a restart; write .*/by-id/two into the rig file$"),
            ((None, None), "by-path", r"2 boards here \(Arduino Uno\) have no serial .*; write .*/by-path/two into"),
            (("0001", "0001"), "by-path", r"2 boards here .* tell them apart; write .*/by-path/two into"),
        ],
    )
    def test_what_tells_them_apart_is_found_and_advised(
        self,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        numbers: tuple[str | None, ...],
        folder: str,
        text: str,
    ) -> None:
        boards = self.boards(tmp_path, monkeypatch, numbers)
        port = os.path.realpath(tmp_path / "ttyACM1")
        for name, constant in (("by-id", "LASTING_NAMES"), ("by-path", "SOCKET_NAMES")):
            (tmp_path / name).mkdir()
            (tmp_path / name / "two").symlink_to(port)
            monkeypatch.setattr(f"rigs.transports._serial_link.{constant}", f"{tmp_path / name}/")
        with closing(boards[0]), closing(boards[1]):
            assert [one.address for one in usb_serial_ports()][-1] == str(tmp_path / folder / "two")
            assert re.search(text, port_advice(port))
            assert not port_advice(str(tmp_path / folder / "two"))
            assert bool(port_advice(str(tmp_path / "by-id" / "two"))) == (folder == "by-path")
            lamp = LampSettings(driver="arduino", address=port)
            rig = paper_rig({})
            laser = rig.laser.model_copy(update={"address": os.path.realpath(tmp_path / "ttyACM0")})
            camera = rig.camera.model_copy(update={"driver": "folder"})
            rig = rig.model_copy(update={"lamp": lamp, "laser": laser, "camera": camera})
            assert any(re.search(text, note) for note in driver_notes(rig))
            shown = next(part for part in inspect_rig(rig, tmp_path) if part.title.startswith("lamp"))
            assert any(re.search(text, warning) for warning in shown.warnings)

    def test_a_new_guard_lights_no_other_board(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """In the dark the guard is killed, and the connection lost; each time another board is there."""
        file_switch.install(monkeypatch)
        for what in ("guard", "connection"):
            address = tmp_path / what
            address.mkdir()
            (address / "serial").write_text("L-1")
            with guarded_light("lamp", "indi", str(address)) as light:
                assert not light.state()
                (address / "serial").write_text("L-2")
                if what == "guard":
                    os.kill(light.guard_pid, signal.SIGKILL)
                else:
                    (address / "refuse_state").touch()
                    threading.Timer(1.0, (address / "refuse_state").unlink).start()
                with pytest.raises(RefusedError, match="another board answers now"), light.lit():
                    pytest.fail("lit")
                assert not (address / "on").exists()
                (address / "serial").write_text("L-1")
                with light.lit():
                    assert (address / "on").exists()


@pytest.mark.parametrize("held_s", [0.4, 0.7])
def test_late_answers_answer_no_later_question(tmp_path: Path, held_s: float) -> None:
    """A silence of 0.1 s counted as proof that all had come: from then on each answer was that to an earlier question.

    The light was "on" where it was off, its "off" was confirmed by the answer to an earlier one, and no session went
    on without a person.
    """
    board = LightBoard(tmp_path, lambda on: None, 0.0)
    with closing(board), open_switch(str(board.by_id), "lamp") as switch:
        assert not switch.state(1.0)
        board.hold(held_s)
        assert not switch.state(2.0)  # asked again and again until an answer comes
        for _ in range(3):
            assert not switch.state(1.0)
            switch.switch(True, 1.0)
            assert switch.state(1.0)
            switch.switch(False, 1.0)


def test_a_line_that_is_always_late_says_nothing_wrong(tmp_path: Path) -> None:
    """A silence that is shorter than the time between two questions is no proof that both were answered.

    The light was "on" where it was off. Errors are no fault here: no answer comes as soon as it must.
    """
    board, said = LightBoard(tmp_path, lambda on: None, 0.0), list[str]()
    with closing(board), open_switch(str(board.by_id), "lamp") as switch:
        assert not switch.state(1.0)
        board.late_by_s = 0.55
        for _ in range(2):
            with contextlib.suppress(CaptureError):
                switch.switch(True, 1.0)
            time.sleep(DEAD_MAN_S + 0.1)
            for _ in range(2):
                assert not board.is_on
                with contextlib.suppress(CaptureError):
                    said.append("on" if switch.state(2.0) else "off")
            with contextlib.suppress(CaptureError):
                switch.switch(False, 1.0)
                said.append("on" if board.is_on else "off")
    assert "on" not in said


def test_a_board_that_answers_again_is_in_step_again(tmp_path: Path) -> None:
    """Each question that was lost made the next answer look late, so that no later question was ever answered."""
    board = LightBoard(tmp_path, lambda on: None, 0.0)
    with closing(board), open_switch(str(board.by_id), "lamp") as switch:
        assert not switch.state(1.0)
        board.late_by_s = math.inf
        with pytest.raises(CaptureError, match="did not answer"):
            switch.state(2.0)
        board.late_by_s = 0.0
        assert not switch.state(2.0)
        switch.switch(True, 0.5)
        assert switch.state(0.5)
        switch.switch(False, 0.5)
        assert not board.is_on
