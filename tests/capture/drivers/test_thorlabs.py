"""Driver of the Thorlabs wheels against lewis' emulated FW212C, pylablib's driver, recordings and garbage."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_schemas import (
    BandPassFilter,
    CaptureError,
    FilterWheelSettings,
    LostError,
    RefusedError,
    TimedOutError,
    WrongPositionError,
)
from rigs import FilterWheel, TerminalOperator, open_wheel
from rigs.filter_wheels import thorlabs
from rigs.filter_wheels.thorlabs import Dialogue
from rigs.transports import Fault, SerialLink, fault_listener
from rigs.transports._serial_link import UsbSerialPort
from tests.capture.drivers.programs import free_port, others_python, require, wait_until
from tests.capture.drivers.serial_replay import TRANSCRIPTS, read_transcript, replayed
from tests.capture.drivers.thorlabs_wheel import EmulatedWheel, emulated_wheel

# Deadlines are kept to one poll (0.05 s); the rest is for a busy machine.
LATE_S = 1.0
MOVE_S = 10.0
SHORT_S = 2.5
PROMPT_MODES = pytest.mark.parametrize("prompt_after_move", [False, True], ids=["prompt at once", "prompt at the end"])


@pytest.fixture(scope="module")
def started() -> Iterator[EmulatedWheel]:
    with emulated_wheel() as wheel:
        yield wheel


@pytest.fixture
def device(started: EmulatedWheel) -> EmulatedWheel:
    started.reset()
    return started


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give up questions early: nobody mends the wheel in these tests."""
    monkeypatch.setattr(thorlabs, "RECOVERS_WITHIN_S", SHORT_S)


def wheel_settings(address: str, slots: range = range(1, 9)) -> FilterWheelSettings:
    return FilterWheelSettings(
        driver="thorlabs",
        address=address,
        filters=tuple(BandPassFilter(slot=k, name=f"filter {k}", center_nm=400.0 + 20.0 * k) for k in slots),
    )


@contextmanager
def opened(address: str, slots: range = range(1, 9)) -> Iterator[FilterWheel]:
    with open_wheel(wheel_settings(address, slots), TerminalOperator()) as wheel:
        yield wheel


@pytest.mark.rigs
def test_opening_asks_who_is_there_and_darkens_the_sensors(device: EmulatedWheel) -> None:
    device.control.put(pos=4)
    with opened(device.address) as wheel:
        identity = wheel.identity()
        assert (identity.vendor, identity.model, identity.firmware) == ("Thorlabs", "FW102C/FW212C", "1.04")
        assert (identity.role, identity.driver, identity.address) == ("filter wheel", "thorlabs", device.address)
        assert wheel.slots == tuple(range(1, 13))
        assert wheel.position() == 4
    assert (device.control.get("sensors"), device.control.get("speed")) == (0, 1)


@pytest.mark.rigs
@PROMPT_MODES
def test_a_move_ends_when_the_wheel_is_there(device: EmulatedWheel, prompt_after_move: bool) -> None:
    device.control.put(prompt_after_move=prompt_after_move)
    with opened(device.address) as wheel:
        for slot in (*range(1, 9), 3, 12, 6):
            wheel.go_to(slot, MOVE_S)
            assert device.control.get("pos") == slot
            assert wheel.position() == slot


@pytest.mark.rigs
def test_a_wheel_that_is_there_is_not_sent(device: EmulatedWheel) -> None:
    with opened(device.address) as wheel:
        device.control.put(pos=7)
        wheel.go_to(7, MOVE_S)
    assert device.control.get("target") == 1


@pytest.mark.rigs
def test_the_position_is_asked_afresh(device: EmulatedWheel) -> None:
    with opened(device.address) as wheel:
        wheel.go_to(5, MOVE_S)
        device.control.put(pos=6)
        assert wheel.position() == 6
        device.control.put(pos=0)
        assert wheel.position() is None


@pytest.mark.rigs
@PROMPT_MODES
def test_a_stuck_wheel_is_late(device: EmulatedWheel, prompt_after_move: bool) -> None:
    device.control.put(prompt_after_move=prompt_after_move)
    with opened(device.address) as wheel:
        device.control.put(stuck=True)
        began_s = time.monotonic()
        why = "it does not confirm the move" if prompt_after_move else "its last report is slot 1"
        with pytest.raises(
            TimedOutError, match=rf"did not reach slot 3 within 0.5 s \({why}\); check whether something"
        ):
            wheel.go_to(3, 0.5)
        assert time.monotonic() - began_s < 0.5 + LATE_S
        device.control.put(stuck=False)
        wheel.go_to(3, MOVE_S)
        assert device.control.get("pos") == 3


@pytest.mark.rigs
@PROMPT_MODES
@pytest.mark.parametrize("slip", [1, -2])
def test_a_lost_step_is_a_wrong_position(device: EmulatedWheel, prompt_after_move: bool, slip: int) -> None:
    device.control.put(prompt_after_move=prompt_after_move, slip=slip)
    with opened(device.address) as wheel:
        with pytest.raises(WrongPositionError, match=f"sent from slot 1 to slot 5, but stopped at slot {5 + slip};"):
            wheel.go_to(5, MOVE_S)
        assert wheel.position() == 5 + slip


@pytest.mark.rigs
def test_a_wheel_that_falls_back_is_late(device: EmulatedWheel) -> None:
    device.control.put(slip=-2)
    with opened(device.address) as wheel, pytest.raises(TimedOutError, match="its last report is slot 1"):
        wheel.go_to(3, 0.5)


@pytest.mark.rigs
def test_a_slot_beyond_the_wheel_is_refused_and_nothing_moves(device: EmulatedWheel) -> None:
    with opened(device.address) as wheel:
        for slot in (0, 13, -1):
            with pytest.raises(RefusedError, match=f"has no slot {slot} .its slots are 1 to 12."):
                wheel.go_to(slot, MOVE_S)
    assert (device.control.get("target"), device.control.get("pos")) == (1, 1)


@pytest.mark.rigs
def test_an_error_that_the_wheel_says(device: EmulatedWheel) -> None:
    with opened(device.address) as wheel:
        device.control.put(pcount=6)
        with pytest.raises(RefusedError, match=r"refuses 'pos=8' \(CMD_ARG_INVALID\)"):
            wheel.go_to(8, MOVE_S)
        assert wheel.position() == 1


@pytest.mark.rigs
def test_a_mute_wheel_times_out(device: EmulatedWheel, impatient: None) -> None:
    with opened(device.address) as wheel:
        device.control.put(mute=True)
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match=r"did not answer within .*nothing came.*check its power"):
            wheel.go_to(3, 0.4)
        assert time.monotonic() - began_s < 0.4 + LATE_S
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match=r"did not answer within (1|0\.9\d*) s .*\(tried \d times\)"):
            wheel.position()
        assert time.monotonic() - began_s < SHORT_S + LATE_S
        device.control.put(mute=False)
        assert wheel.position() == 1


@pytest.mark.rigs
def test_a_wheel_that_is_mute_from_the_start(device: EmulatedWheel) -> None:
    device.control.put(mute=True)
    with pytest.raises(TimedOutError, match="did not answer"), opened(device.address):
        pass


@pytest.mark.rigs
def test_a_garbled_answer_is_no_answer(device: EmulatedWheel, impatient: None) -> None:
    with opened(device.address) as wheel:
        device.control.put(garble=True)
        with pytest.raises(
            LostError, match=r"answers 'pos\?' with \['#os\?', '1'\], which is not a valid answer; check"
        ):
            wheel.position()
        device.control.put(garble=False)
        assert wheel.position() == 1


@pytest.mark.rigs
def test_a_late_answer_is_not_taken_for_the_next_one(device: EmulatedWheel) -> None:
    with opened(device.address) as wheel:
        device.control.put(late_s=0.6)
        with pytest.raises(TimedOutError, match="did not answer"):
            wheel.go_to(3, 0.3)
        # The answer "slot 1" to that question is still under way; meanwhile the wheel stands at 4.
        device.control.put(late_s=0.0, pos=4)
        assert wheel.position() == 4


@pytest.mark.rigs
def test_six_slots_do_not_hold_eight_filters(device: EmulatedWheel) -> None:
    device.control.put(pcount=6)
    what = r"has slots 1 to 6, but the rig file puts filter 7 in slot 7, filter 8 in slot 8; 8 filters need an FW212C"
    with pytest.raises(RefusedError, match=what), opened(device.address):
        pass
    with opened(device.address, range(1, 7)) as wheel:
        assert wheel.slots == (1, 2, 3, 4, 5, 6)
    what = "filter 7 in slot 7; correct the slot numbers"
    with pytest.raises(RefusedError, match=what), opened(device.address, range(3, 8)):
        pass


@pytest.mark.rigs
def test_a_count_that_no_wheel_has(device: EmulatedWheel) -> None:
    device.control.put(pcount=8)
    with pytest.raises(RefusedError, match=r"reports 8 slots, but only 6 \(FW102C\) or 12"), opened(device.address):
        pass


@pytest.mark.rigs
@pytest.mark.parametrize("setting", ["sensors", "speed"])
def test_a_setting_that_is_not_kept(device: EmulatedWheel, setting: str) -> None:
    told, kept = (0, 1) if setting == "sensors" else (1, 0)
    device.control.put(forgets=setting)
    what = f"the setting '{setting}={told}' was sent, but the wheel reports {setting} = {kept}"
    with pytest.raises(RefusedError, match=what), opened(device.address):
        pass


@pytest.mark.rigs
def test_another_device_is_refused(device: EmulatedWheel) -> None:
    device.control.put(idn="THORLABS SC10 VERSION 1.07")
    what = r"identifies itself as 'THORLABS SC10 VERSION 1\.07', but a Thorlabs FW102C or FW212C"
    with pytest.raises(RefusedError, match=what), opened(device.address):
        pass


@pytest.mark.rigs
def test_a_value_that_is_no_number(device: EmulatedWheel, impatient: None) -> None:
    with opened(device.address) as wheel:
        device.control.put(pos="three")
        with pytest.raises(LostError, match=r"answers 'pos\?' with \['three'\]"):
            wheel.position()


@pytest.mark.rigs
def test_a_wheel_that_lost_its_power_is_proven_again(device: EmulatedWheel) -> None:
    """Back at slot 1 with its sensors lit, as after a restart; one answer was lost meanwhile."""
    faults: list[Fault] = []
    with opened(device.address) as wheel:
        wheel.go_to(5, MOVE_S)
        device.control.put(pos=1, sensors=1, speed=0, late_s=1.4)
        threading.Timer(0.2, lambda: device.control.put(late_s=0.0)).start()
        with fault_listener(faults.append):
            wheel.go_to(7, MOVE_S)
        assert (device.control.get("pos"), device.control.get("sensors"), device.control.get("speed")) == (7, 0, 1)
    assert [(fault.device, fault.attempt) for fault in faults] == [(f"filter wheel at {device.address}", 1)]
    assert "did not answer within 1 s" in faults[0].what


@pytest.mark.rigs
def test_another_wheel_after_a_fault_is_refused(device: EmulatedWheel, tmp_path: Path) -> None:
    with opened(device.address) as wheel:
        device.control.put(garble=True)
        threading.Timer(0.2, lambda: device.control.put(garble=False, pcount=6)).start()
        with pytest.raises(RefusedError, match=r"another wheel answers now \(FW102C/FW212C, 6 slots\)"):
            wheel.go_to(3, MOVE_S)


@pytest.mark.rigs
def test_a_cable_that_is_pulled_and_plugged_in_again(device: EmulatedWheel, tmp_path: Path) -> None:
    with serial_port(device, tmp_path) as (port, cable), opened(str(port)) as wheel:
        wheel.go_to(2, MOVE_S)
        cable.kill()
        cable.wait()
        again = ExitStack()
        back = threading.Timer(0.7, lambda: again.enter_context(serial_port(device, tmp_path)))
        back.start()
        wheel.go_to(6, MOVE_S)
        back.join()
        with again:
            assert wheel.position() == device.control.get("pos") == 6


@pytest.mark.rigs
def test_an_unplugged_wheel_is_lost() -> None:
    with emulated_wheel() as device:
        with opened(device.address) as wheel:
            device.stop()
            for _ in range(2):
                with pytest.raises(LostError, match=r"the connection broke|cannot be opened"):
                    wheel.go_to(3, 1.0)
        with pytest.raises(LostError, match="cannot be opened"), opened(device.address):
            pass


ASK_PYLABLIB = """
import sys
from pylablib.devices.Thorlabs.serial import FW
wheel = FW(sys.argv[1])
print(wheel.get_position(), wheel.get_sensor_mode(), wheel.get_speed_mode(), wheel.get_pcount())
wheel.close()
"""


@pytest.mark.rigs
def test_pylablib_sees_the_wheel_where_it_was_sent(device: EmulatedWheel) -> None:
    """pylablib is GPL: it runs in an environment and process of its own."""
    python = others_python("pylablib")
    for slot in (3, 8):
        with opened(device.address) as wheel:
            wheel.go_to(slot, MOVE_S)
        asked = subprocess.run(
            [python, "-c", ASK_PYLABLIB, device.address], capture_output=True, text=True, timeout=60, check=True
        )
        assert asked.stdout.split() == [str(slot), "off", "high", "12"]


@pytest.mark.rigs
def test_detection_lists_wheels_and_nothing_else(device: EmulatedWheel, monkeypatch: pytest.MonkeyPatch) -> None:
    addresses = [device.address, f"socket://127.0.0.1:{free_port()}"]
    ports = [UsbSerialPort(address, "FT232R USB UART", "0403:6001") for address in addresses]
    monkeypatch.setattr(thorlabs, "usb_serial_ports", lambda: ports)
    assert thorlabs.found() == [(device.address, "Thorlabs FW102C/FW212C filter wheel, firmware 1.04")]
    device.control.put(idn="THORLABS SC10 VERSION 1.07")
    assert thorlabs.found() == []


# -- recorded and made-up exchanges, without the emulator


def test_the_recorded_session() -> None:
    # lewis' emulated FW212C: opened, sent from slot 1 to slot 5, asked where it is.
    with replayed(read_transcript(TRANSCRIPTS / "thorlabs_fw212c.txt")) as address, opened(address) as wheel:
        wheel.go_to(5, MOVE_S)
        assert wheel.position() == 5


def test_what_a_former_session_left_behind_is_forgotten() -> None:
    # "po" was typed and never ended; the answer to an earlier "pos?" is still under way.
    spoken = [("device", b"pos?\r3\r> "), ("host", b"\r"), ("device", b"po\rCommand error CMD_NOT_DEFINED\r> ")]
    spoken += [("host", b"*idn?\r"), ("device", b"*idn?\rTHORLABS FW102C/FW212C Filter Wheel version 1.04\r> ")]
    with replayed(spoken) as address, SerialLink(address, thorlabs.BAUD, "filter wheel") as link:
        said = Dialogue(link, "filter wheel").ask("*idn", time.monotonic() + MOVE_S)
    assert said == "THORLABS FW102C/FW212C Filter Wheel version 1.04"


class Chatter:
    """A link on which anything may come."""

    def __init__(self, said: bytes) -> None:
        self._said = said

    def write(self, data: bytes, end_s: float) -> None:
        """Nothing hears it."""

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        answer, found, self._said = self._said.partition(terminator)
        if not found:
            raise TimedOutError("filter wheel: did not answer")
        return answer + found

    def drain(self, quiet_s: float, end_s: float) -> bytes:
        return b""

    def forget(self) -> None:
        """Nothing has come but what answers."""


LIKE_AN_ANSWER = st.lists(
    st.sampled_from([b"pos?", b"pos=3", b"\r", b"> ", b">", b"3", b"-1", b"\xb2", b"Command error", b" CMD_", b"\n"]),
    max_size=12,
).map(b"".join)


@settings(max_examples=300, deadline=None)
@given(said=st.binary(max_size=60) | LIKE_AN_ANSWER)
def test_whatever_is_said_an_answer_or_a_declared_error_comes(said: bytes) -> None:
    dialogue = Dialogue(Chatter(b"> " + said), "filter wheel")  # type: ignore[arg-type]
    for _ in range(3):
        try:
            value = dialogue.ask_number("pos", 0.0)
        except (LostError, TimedOutError, RefusedError):
            continue
        assert b"pos?" in said
        assert str(value).encode() in said


@settings(max_examples=300, deadline=None)
@given(said=st.binary(max_size=60) | LIKE_AN_ANSWER)
def test_whatever_is_said_an_order_is_confirmed_by_its_echo_alone(said: bytes) -> None:
    dialogue = Dialogue(Chatter(b"> " + said), "filter wheel")  # type: ignore[arg-type]
    try:
        dialogue.assign("pos", 3, 0.0)
    except CaptureError as error:
        assert isinstance(error, LostError | TimedOutError | RefusedError)  # noqa: PT017
    else:
        assert said.split(b">")[0].strip() == b"pos=3"


# -- the emulator behind a pseudo-terminal, as /dev/ttyUSB0 is


@contextmanager
def serial_port(device: EmulatedWheel, folder: Path) -> Iterator[tuple[Path, subprocess.Popen[bytes]]]:
    """Put the emulated wheel behind a pseudo-terminal for a ``with`` block."""
    socat, port = require("socat", package="socat"), folder / "ttyFW"
    cable = subprocess.Popen([socat, f"pty,raw,echo=0,link={port}", f"tcp:127.0.0.1:{device.port}"])
    try:
        wait_until(port.exists, "the pseudo-terminal of socat")
        yield port, cable
    finally:
        cable.kill()
        cable.wait()


@pytest.mark.rigs
def test_a_serial_port(device: EmulatedWheel, tmp_path: Path, impatient: None) -> None:
    with serial_port(device, tmp_path) as (port, cable):
        # A former session died in the middle of a command, and nobody read the answer to the one before.
        left = os.open(port, os.O_RDWR | os.O_NOCTTY)
        os.write(left, b"pos?\rpo")
        os.close(left)
        with opened(str(port)) as wheel:
            for slot in (2, 7, 12):
                wheel.go_to(slot, MOVE_S)
                assert device.control.get("pos") == slot
            with pytest.raises(RefusedError, match="another program has the port open"), opened(str(port)):
                pass
            cable.send_signal(signal.SIGKILL)
            cable.wait()
            with pytest.raises(LostError, match="the connection broke"):
                wheel.position()
        with pytest.raises(LostError, match="cannot be opened"), opened(str(port)):
            pass
