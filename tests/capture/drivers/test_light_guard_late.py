"""A light that is slow to answer, or comes on late, while its owner or its guard goes away."""

import gc
import os
import signal
import socket
import time
from pathlib import Path

import pytest

from data_schemas import LostError
from rigs.light_guard import guarded_light, watch
from rigs.light_guard._reconnecting_light import (
    LATE_ON_S,
    RETRY_FOR_S,
    HungUpError,
    ReconnectingLight,
    channel,
    receive,
)
from rigs.light_guard.guard_process import LOOK_ALONE_S, LOOK_EVERY_S
from tests.capture.drivers import file_switch
from tests.capture.drivers.light_owner import guards, start_owner, the_guard
from tests.capture.drivers.programs import wait_until

# Of the 5 s that "on" may take and the 2 s of a state: what is given up at once is off long before. The guard needs
# some hundredths of a second; the rest is for a busy machine.
AT_ONCE_S = 1.0
LATE_BY_S = 1.0  # of file_switch


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the address of a light in a file."""
    file_switch.install(monkeypatch)
    return tmp_path


def is_off_at_once(folder: Path, since_s: float) -> None:
    wait_until(lambda: not (folder / "on").exists(), "the light to go off")
    assert time.monotonic() - since_s < AT_ONCE_S
    wait_until(lambda: not guards(str(folder)), "the end of the guard")
    assert not (folder / "on").exists()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_owner_goes_away_while_on_is_not_confirmed(folder, number):
    (folder / "slow_on").touch()
    with start_owner(folder) as process:
        try:
            wait_until((folder / "on").exists, "the light to go on")
            os.kill(process.pid, number)
            is_off_at_once(folder, time.monotonic())
        finally:
            process.kill()


def test_guard_is_told_to_end_while_on_is_not_confirmed(folder):
    (folder / "slow_on").touch()
    with start_owner(folder) as process:
        try:
            wait_until((folder / "on").exists, "the light to go on")
            began_s = time.monotonic()
            os.kill(the_guard(str(folder)), signal.SIGTERM)
            is_off_at_once(folder, began_s)
            assert "the guard process has ended (it received SIGTERM)" in process.stdout.readline()
        finally:
            process.kill()


def test_ctrl_c_while_on_is_not_confirmed(folder):
    (folder / "slow_on").touch()
    with start_owner(folder) as process:
        try:
            wait_until((folder / "on").exists, "the light to go on")
            began_s = time.monotonic()
            process.send_signal(signal.SIGINT)
            is_off_at_once(folder, began_s)
            assert process.stdout.readline() == "interrupted\n"
        finally:
            process.kill()


def test_owner_is_killed_while_the_light_is_slow_to_say_its_state(folder):
    with start_owner(folder, "asks") as process:
        try:
            assert process.stdout.readline() == "ON\n"
            (folder / "slow_state").touch()
            wait_until(lambda: not (folder / "slow_state").exists(), "the question")
            process.kill()
            is_off_at_once(folder, time.monotonic())
        finally:
            process.kill()


@pytest.mark.parametrize("victim", ["owner", "guard"])
def test_on_that_is_carried_out_after_everybody_has_gone(folder, victim):
    """As a server does that is slow: "off" finds the light off, and then the "on" before it takes effect."""
    assert LATE_BY_S < LATE_ON_S
    (folder / "late_on").write_text(f"{LATE_BY_S}")
    with start_owner(folder) as process:
        try:
            wait_until((folder / "asked").exists, "the question")
            asked_s = time.monotonic()
            if victim == "owner":
                process.kill()
                wait_until(lambda: not guards(str(folder)), "the end of the guard")
            else:
                os.kill(the_guard(str(folder)), signal.SIGKILL)
                assert "switched off without it" in process.stdout.readline()
            assert time.monotonic() - asked_s > LATE_BY_S
            wait_until(lambda: not (folder / "on").exists(), "the light to be off")
        finally:
            process.kill()
    time.sleep(max(asked_s + LATE_BY_S + 0.5 - time.monotonic(), 0.0))
    assert not (folder / "on").exists()


def test_on_that_is_carried_out_later_still_is_seen(folder):
    """Later than "off" is repeated for those who wait: the guard stays for a while, without an owner."""
    late_s = LATE_ON_S + 1.5
    assert late_s < LATE_ON_S + LOOK_ALONE_S
    (folder / "late_on").write_text(f"{late_s}")
    with start_owner(folder) as process:
        try:
            wait_until((folder / "asked").exists, "the question")
            asked_s = time.monotonic()
            process.kill()
            wait_until((folder / "on").exists, "the light to come on late")
            assert time.monotonic() - asked_s > LATE_ON_S
            wait_until(lambda: not (folder / "on").exists(), "the light to be off", 2 * LOOK_EVERY_S)
        finally:
            process.kill()


# On a busy computer the guard takes more than a second to end, and its owner confirms "off" without it.
CAME_ON = r"on although nothing had switched it on.*(confirmed that the light is off|is confirmed off)"


def test_light_that_comes_on_in_the_dark_is_switched_off_and_told(folder):
    with guarded_light("laser", "indi", str(folder)) as light:
        assert not light.state()
        (folder / "on").touch()
        wait_until(lambda: not (folder / "on").exists(), "the light to be off", AT_ONCE_S)
        with pytest.raises(LostError, match=CAME_ON):
            light.state()


def test_dark_light_that_cannot_be_asked_for_a_while_is_asked_again(folder):
    with guarded_light("laser", "indi", str(folder)) as light:
        (folder / "refuse_state").touch()
        time.sleep(2 * LOOK_EVERY_S)
        (folder / "refuse_state").unlink()
        assert not light.state()


def test_guard_that_hears_nonsense_ends_in_the_dark(folder):
    def work(light):
        with light.lit():
            light._guard._channel.send(b'{"no": "time"}')  # noqa: SLF001 - nothing of ours says this
            wait_until(lambda: not guards(str(folder)), "the end of the guard")

    with guarded_light("laser", "indi", str(folder)) as light:
        with pytest.raises(LostError, match=r"KeyError.*lease_s.*confirmed that the light is off"):
            work(light)
        assert not (folder / "on").exists()


@pytest.mark.parametrize("packet", [b"{", b"[]", b"\xff", b"9" * 5000])
def test_a_packet_that_is_no_message_ends_the_talk(packet):
    ours, theirs = channel()
    with ours, theirs:
        theirs.send(packet)
        with pytest.raises(HungUpError):
            receive(ours, time.monotonic() + 1.0)


def test_a_light_that_was_closed_says_so(folder):
    with guarded_light("laser", "indi", str(folder)) as light:
        pass
    with pytest.raises(LostError, match="the guard process has ended"):
        light.state()
    with pytest.raises(LostError, match="the guard process has ended"), light.lit():
        pytest.fail("lit")


def test_a_light_that_is_not_open_has_no_switch():
    with pytest.raises(LostError, match="laser: the connection is closed"):
        ReconnectingLight(lambda: file_switch.open_switch("", "laser", None), "laser").switch.keep_alive()


def test_guard_without_owner_goes_on_trying_after_it_shouted(folder):
    """A server that comes back may come back lit: the guard is the only one left."""
    with start_owner(folder) as process:
        assert process.stdout.readline() == "ON\n"
        (folder / "refuse_off").write_text("1000000")
        process.kill()
        process.wait()
    time.sleep(RETRY_FOR_S + AT_ONCE_S)
    assert (folder / "on").exists()
    assert guards(str(folder))
    (folder / "refuse_off").write_text("0")
    is_off_at_once(folder, time.monotonic())


class Missing:
    """Another process as the watch sees it."""

    descriptors: tuple[int, ...] = ()

    def __init__(self, pid, state):
        self.pid, self._state = pid, state

    def missing(self):
        return self._state


def test_successor_is_started_also_where_the_stopped_guard_ends_before_it_is_killed(monkeypatch, capfd):
    """The watch is the last that could see to the light: nothing may end it before it has a successor."""

    def gone(pid, number):
        raise ProcessLookupError(3, "No such process")

    states = {11: "is gone", os.getppid(): "was stopped"}
    started = []
    monkeypatch.setattr(watch, "OtherProcess", lambda pid: Missing(pid, states[pid]))
    monkeypatch.setattr(os, "kill", gone)
    monkeypatch.setattr(os, "execv", lambda program, words: started.append(words))
    ours, its_own = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours:
        try:
            watch.main([str(its_own.detach()), "11", "laser at a port", "python", "alone"])
        finally:
            gc.enable()  # the watch runs without it
    assert started == [["python", "alone"]]
    assert "the stopped guard process could not be ended (No such process)" in capfd.readouterr().err
