"""Serial link over pseudo-terminals of the operating system and over TCP."""

import ast
import errno
import io
import os
import pty
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from data_schemas import CaptureError, LostError, RefusedError, TimedOutError
from rigs.transports import SerialLink, usb_serial_ports
from rigs.transports._serial_link import LONGEST_ANSWER_BYTES
from tests.capture.drivers.programs import free_port

# Deadlines are kept to one poll (0.02 s); the rest is for a busy machine.
LATE_S = 0.5


@contextmanager
def terminal() -> Iterator[tuple[int, str]]:
    """Open a pseudo-terminal: the device's end, and the path of the host's end."""
    device, host = pty.openpty()
    path = os.ttyname(host)
    os.close(host)
    try:
        yield device, path
    finally:
        os.close(device)


@contextmanager
def tcp_line() -> Iterator[tuple[socket.socket, SerialLink]]:
    """Open a link over TCP: the device's end, and the link."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 9600, "wheel") as link,
        server.accept()[0] as device,
    ):
        yield device, link


def soon(duration_s: float = 5.0) -> float:
    return time.monotonic() + duration_s


def test_bytes_go_both_ways_and_what_follows_the_terminator_stays() -> None:
    with terminal() as (device, path), SerialLink(path, 115200, "wheel") as link:
        link.write(b"pos?\r", soon())
        assert os.read(device, 64) == b"pos?\r"
        os.write(device, b"pos?\r3\r> next> ")
        assert link.read_until(b"> ", soon()) == b"pos?\r3\r> "
        assert link.read_until(b"> ", soon()) == b"next> "


def test_the_transcript_holds_every_byte() -> None:
    notes = io.StringIO()
    with terminal() as (device, path), SerialLink(path, 9600, "wheel", notes) as link:
        link.write(b"?\r", soon())
        os.write(device, b"OFF\n")
        link.read_until(b"\n", soon())
    # The answer may come in pieces, one line each.
    host, *pieces = notes.getvalue().splitlines()
    assert host == "host b'?\\r'"
    assert all(piece.startswith("device ") for piece in pieces)
    assert b"".join(ast.literal_eval(piece.removeprefix("device ")) for piece in pieces) == b"OFF\n"


@pytest.mark.parametrize(("said", "heard"), [(b"", "nothing came"), (b"pos", "only b'pos' came")])
def test_silence_ends_at_the_deadline(said: bytes, heard: str) -> None:
    with terminal() as (device, path), SerialLink(path, 9600, "wheel") as link:
        os.write(device, said)
        began_s = time.monotonic()
        # a busy machine takes some of the 0.2 s before the wait begins
        with pytest.raises(TimedOutError, match=rf"wheel at {path}: did not answer within 0\.[12]\d* s \({heard}\)"):
            link.read_until(b"> ", began_s + 0.2)
        assert 0.2 <= time.monotonic() - began_s < 0.2 + LATE_S


def test_a_device_that_drips_bytes_is_late() -> None:
    with terminal() as (device, path), SerialLink(path, 9600, "wheel") as link:
        stop = threading.Event()

        def drip() -> None:
            # Faster than the link waits for a byte.
            while not stop.wait(0.005):
                os.write(device, b"x")

        thread = threading.Thread(target=drip)
        thread.start()
        try:
            began_s = time.monotonic()
            with pytest.raises(TimedOutError, match=r"did not answer within 0.2 s \(only b'xx"):
                link.read_until(b"> ", began_s + 0.2)
            assert time.monotonic() - began_s < 0.2 + LATE_S
        finally:
            stop.set()
            thread.join()


def test_an_endless_answer_is_no_answer() -> None:
    with tcp_line() as (device, link):
        device.sendall(b"#" * (LONGEST_ANSWER_BYTES + 1))
        with pytest.raises(LostError, match=r"sends more than 4096 bytes without .* check that this port"):
            link.read_until(b"> ", soon())


def test_drain_forgets_what_was_said_before() -> None:
    with terminal() as (device, path), SerialLink(path, 9600, "wheel") as link:
        os.write(device, b"old> rest")
        link.read_until(b"> ", soon())
        os.write(device, b" and more")
        assert link.drain(0.05, soon()) == b"rest and more"
        os.write(device, b"new> ")
        assert link.read_until(b"> ", soon()) == b"new> "


def test_drain_ends_at_the_deadline_where_the_device_never_falls_silent() -> None:
    with terminal() as (device, path), SerialLink(path, 9600, "wheel") as link:
        os.write(device, b"chatter")
        with pytest.raises(TimedOutError, match=r"does not stop sending \(such as b'chatter'\)"):
            link.drain(10.0, soon(0.1))


def test_a_port_that_takes_no_bytes_times_out() -> None:
    with terminal() as (_, path), SerialLink(path, 9600, "wheel") as link:
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match="accepts no more bytes"):
            link.write(b"x" * 10**6, began_s + 0.2)
        assert time.monotonic() - began_s < 0.2 + LATE_S


def test_an_unplugged_port_is_lost_and_closes_quietly() -> None:
    device, host = pty.openpty()
    with SerialLink(os.ttyname(host), 9600, "wheel") as link:
        os.close(host)
        os.close(device)
        with pytest.raises(LostError, match=r"the connection broke .* plug the cable in again"):
            link.read_until(b"> ", soon())
        with pytest.raises(LostError, match="the connection broke"):
            link.write(b"pos?\r", soon())
        with pytest.raises(LostError, match="the connection broke"):
            link.drain(0.0, soon())


def test_a_closed_tcp_connection_is_lost() -> None:
    with tcp_line() as (device, link):
        device.close()
        with pytest.raises(LostError, match=r"wheel at socket://.*: the connection broke \(.*disconnected"):
            link.read_until(b"> ", soon())


def test_nothing_at_the_address() -> None:
    with pytest.raises(LostError, match=r"wheel at /dev/ttyNONE: cannot be opened .* 'finray rig detect'"):
        SerialLink("/dev/ttyNONE", 9600, "wheel")
    with pytest.raises(LostError, match="cannot be opened"):
        SerialLink(f"socket://127.0.0.1:{free_port()}", 9600, "wheel")


def test_a_port_with_another_name_is_named_or_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a replug: by its link under by-id and by its serial number it is found again, by its old name it is not."""
    usb = ListPortInfo(str(tmp_path / "ttyACM0"))
    usb.description, usb.vid, usb.pid, usb.serial_number = "Arduino Uno", 0x2341, 0x0043, "8593"
    usb.hwid = usb.usb_info()
    monkeypatch.setattr(list_ports, "comports", lambda *_: [usb])
    monkeypatch.setattr(list_ports, "grep", lambda text: (one for one in [usb] if text in one.hwid))
    by_id = tmp_path / "by-id"
    addresses = (str(by_id), "hwgrep://SER=8593", usb.device)
    for address in addresses:
        usb.device = str(tmp_path / "ttyACM0")
        with terminal() as (_, path):
            os.symlink(path, usb.device)
            os.symlink(usb.device, by_id)
            link = SerialLink(address, 9600, "lamp")
        usb.device, old = str(tmp_path / "ttyACM1"), usb.device
        os.unlink(old)
        by_id.unlink()
        with terminal() as (device, path), link:
            os.symlink(path, usb.device)
            os.symlink(usb.device, by_id)
            if address == old:
                with pytest.raises(LostError, match=r"ttyACM0: cannot .*ttyACM1 \(Arduino Uno\).*/dev/serial/by-id/"):
                    link.reopen()
            else:
                link.reopen()
                link.write(b"?", soon())
                assert os.read(device, 8) == b"?"
        for name in (usb.device, by_id):
            os.unlink(name)


def test_a_link_under_by_id_is_not_advised_where_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    usb = ListPortInfo("/dev/ttyACM1")
    usb.description, usb.vid, usb.pid = "Arduino Uno", 0x2341, 0x0043
    monkeypatch.setattr(list_ports, "comports", lambda *_: [usb])
    with pytest.raises(LostError, match=r"USB ports are there now: /dev/ttyACM1 \(Arduino Uno\)$"):
        SerialLink("/dev/serial/by-id/usb-NONE", 9600, "lamp")


def test_an_address_that_is_none() -> None:
    with pytest.raises(
        RefusedError, match=r"wheel at gopher://x: is not an address of a serial port .*socket://host:4001"
    ):
        SerialLink("gopher://x", 9600, "wheel")


def test_a_port_opens_once() -> None:
    with (
        terminal() as (_, path),
        SerialLink(path, 9600, "wheel"),
        pytest.raises(RefusedError, match="another program has the port open"),
    ):
        SerialLink(path, 9600, "wheel")


def test_a_port_of_another_group(monkeypatch: pytest.MonkeyPatch) -> None:
    # The tests may run as root, who may open everything: pyserial's own error stands in.
    def forbid(*_: object, **__: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial, "serial_for_url", forbid)
    with pytest.raises(RefusedError, match="your user has no permission to open this port; join its group"):
        SerialLink("/dev/ttyUSB0", 9600, "wheel")


def test_only_ports_behind_usb_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    usb, board = ListPortInfo("/dev/ttyUSB0"), ListPortInfo("/dev/ttyS0")
    usb.description, usb.vid, usb.pid = "FT232R USB UART", 0x0403, 0x6001
    monkeypatch.setattr(list_ports, "comports", lambda: [board, usb])
    assert usb_serial_ports() == [("/dev/ttyUSB0", "FT232R USB UART", "0403:6001")]


@settings(max_examples=60, deadline=None)
@given(pieces=st.lists(st.binary(max_size=40), max_size=5), terminator=st.sampled_from([b">", b"\r\n"]))
def test_whatever_comes_an_answer_ends_in_its_terminator(pieces: list[bytes], terminator: bytes) -> None:
    with terminal() as (device, path), SerialLink(path, 115200, "wheel") as link:
        for piece in pieces:
            os.write(device, piece)
        said = b"".join(pieces)
        began_s = time.monotonic()
        try:
            answer = link.read_until(terminator, began_s + 0.05)
        except CaptureError:
            assert terminator not in said
        else:
            assert answer == said[: said.index(terminator) + len(terminator)]
        assert time.monotonic() - began_s < 0.05 + LATE_S
