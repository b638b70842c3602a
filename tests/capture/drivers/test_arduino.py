"""The Arduino light against its real firmware in QEMU, recorded exchanges, and everything a line can say wrong."""

import ast
import io
import re
import time
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_schemas import CaptureError, LostError, RefusedError, TimedOutError, UnsafeError
from rigs.light_guard.guard_process import KEEP_ALIVE_S
from rigs.lights import arduino
from rigs.lights.arduino import (
    ASK_WITHIN_S,
    BAUD,
    FIRMWARE,
    MISSED_ANSWERS,
    ArduinoSwitch,
    Said,
    found,
    open_switch,
    parse,
)
from rigs.transports import SerialLink
from rigs.transports._serial_link import UsbSerialPort
from tests.capture.drivers.firmware_in_qemu import SOURCE, Tap, build, firmware_board
from tests.capture.drivers.serial_replay import TRANSCRIPTS, read_transcript, replayed

DEADLINE_S = 2.0
# Waits end within one poll of the port (0.02 s) of their deadline; the rest is for a busy machine.
LATE_S = 0.5
GREETING = [("host", b"?\nI\n"), ("device", b"OFF\nLASER 1.2\n")]


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def board(elf: Path) -> Iterator[Tap]:
    with firmware_board(elf) as tap:
        yield tap


def session(switch: ArduinoSwitch) -> None:
    """Use everything once."""
    assert switch.identity().firmware == "1.2"
    assert not switch.state(DEADLINE_S)
    switch.switch(True, DEADLINE_S)
    for _ in range(3):
        switch.keep_alive()
        time.sleep(0.2)  # as a guard does: the answer is there before the next word
    assert switch.state(DEADLINE_S)
    switch.switch(False, DEADLINE_S)
    assert not switch.state(DEADLINE_S)


def silence(switch: ArduinoSwitch) -> None:
    """Say nothing until the dead-man acts, and learn of it."""
    switch.switch(True, DEADLINE_S)
    time.sleep(1.2)
    with pytest.raises(LostError, match=r"the dead-man switched it off.*nothing for 0\.4 s"):
        switch.state(DEADLINE_S)
    assert not switch.state(DEADLINE_S)


def test_the_dead_man_acts_within_0_4_s_on_the_boards_own_clock_and_the_guard_speaks_five_times_meanwhile():
    source = SOURCE.read_text(encoding="utf-8")

    def number(pattern: str) -> int:
        found = re.search(pattern, source)
        assert found is not None, pattern
        return int(found[1])

    assert "clock / 256" in source  # (1 << CS12)
    tick_s = 256 * (number(r"OCR1A = (\d+);") + 1) / 16e6
    silence_s = number(r"#define SILENCE_LIMIT (\d+) ") * tick_s
    assert silence_s == pytest.approx(0.4)
    assert silence_s >= 5 * KEEP_ALIVE_S
    assert silence_s > ASK_WITHIN_S + KEEP_ALIVE_S  # an answer that is lost is not waited for so long
    assert f'"LASER {FIRMWARE[0]}.{FIRMWARE[1]}\\n"' in source


@pytest.mark.rigs
class TestFirmware:
    @pytest.mark.parametrize("exchange", [session, silence])
    def test_exchange_is_the_recorded_one(self, board, exchange):
        """To record anew, write `spoken` to the file."""
        spoken = io.StringIO()
        with SerialLink(board.address, BAUD, "laser", spoken) as link:
            exchange(ArduinoSwitch(link, "laser", board.address))
        recorded = read_transcript(TRANSCRIPTS / f"arduino_{exchange.__name__}.txt")
        spoken.seek(0)
        said = {who: b"".join(text for speaker, text in recorded if speaker == who) for who in ("host", "device")}
        heard = {"host": b"", "device": b""}
        for line in spoken:
            who, text = line.split(" ", 1)
            heard[who] += ast.literal_eval(text)
        assert heard == said, spoken.getvalue()

    def test_dead_man_needs_a_valid_command(self, board):
        with open_switch(board.address, "laser", None) as switch:
            switch.switch(True, DEADLINE_S)
            on_s = board.times("device", b"ON")[-1]
            while not board.times("device", b"TRIP") and time.monotonic() < on_s + 3.0:
                board.say(b"\x00noise\n")
                time.sleep(0.1)
        assert board.times("device", b"ERR")
        # The board obeyed up to 0.05 s before its answer came through QEMU's port.
        assert 0.39 - 0.05 <= board.times("device", b"TRIP")[0] - on_s <= 1.0
        assert not board.state()

    @pytest.mark.parametrize("line", [b"L", b"L2", b"L11", b"l1", b"L1 ", b"1", b"K1", b"??", b"L1\x00", b"\xffL1"])
    def test_other_lines_change_nothing(self, board, line):
        began_s = time.monotonic()
        board.say(line + b"\n")
        board.when("device", b"ERR", began_s)
        assert not board.state()

    def test_line_ends_of_terminals_are_taken(self, board):
        began_s = time.monotonic()
        board.say(b"\r\nL0\r\n")
        board.when("device", b"OFF", began_s)
        assert not board.times("device", b"ERR")

    def test_half_a_command_of_a_killed_host_does_not_switch_on(self, board):
        board.say(b"L1")
        with open_switch(board.address, "laser", None) as switch:
            assert not switch.state(DEADLINE_S)
        assert board.times("device", b"ERR")


class TestRecorded:
    @pytest.mark.parametrize("exchange", [session, silence])
    def test_every_byte_is_spoken_as_recorded(self, exchange):
        """Asserted by the exchange itself, and by `replayed` of what the host says."""
        with (
            replayed(read_transcript(TRANSCRIPTS / f"arduino_{exchange.__name__}.txt")) as address,
            open_switch(address, "laser", None) as switch,
        ):
            exchange(switch)


def with_board(*spoken: tuple[str, bytes]) -> "list[tuple[str, bytes]]":
    return [*GREETING, *spoken]


class TestOpening:
    def test_board_that_resets_says_its_banner_late(self):
        with (
            replayed([("host", b"?\nI\n"), ("device", b"\x00\xfeLASER 1.2\n"), ("device", b"LASER 1.2\n")]) as address,
            open_switch(address, "lamp", None) as switch,
        ):
            assert switch.has_dead_man

    def test_board_that_missed_the_first_question_is_asked_again(self, monkeypatch):
        """Asserted by `replayed`: the host must say all that stands here, and no more."""
        monkeypatch.setattr(arduino, "RESET_WITHIN_S", 0.2)
        with (
            replayed([("host", b"?\nI\n?\nI\n"), ("device", b"OFF\nLASER 1.7\n")]) as address,
            open_switch(address, "laser", None),
        ):
            pass

    @pytest.mark.parametrize(
        ("answer", "error", "match"),
        [
            (b"LASER 2.0\n", RefusedError, r"runs firmware 2\.0, but .* needs 1\.2 or a later 1\.x.*; flash"),
            (b"LASER 1.1\n", RefusedError, r"runs firmware 1\.1, but .* whose dead-man acts within 0\.4 s; flash"),
            (b"ERR\n", RefusedError, r"sends b'ERR\\n', but does not state its firmware; flash"),
            (b"Command error CMD_NOT_DEFINED\n", RefusedError, "or correct the address"),
            (b"", TimedOutError, "sent nothing within .* s; check the cable"),
        ],
    )
    def test_something_else_answers(self, answer, error, match, monkeypatch):
        monkeypatch.setattr(arduino, "RESET_WITHIN_S", 0.2)
        asked = b"?\nI\n" if answer.startswith(b"LASER") else b"?\nI\n?\nI\n"
        with (
            replayed([("host", asked[:4]), ("device", answer), ("host", asked[4:])]) as address,
            pytest.raises(error, match=match),
            open_switch(address, "laser", None),
        ):
            pytest.fail("opened")

    def test_boards_are_found(self, monkeypatch):
        with replayed(with_board(("host", b"I\n"), ("device", b"LASER 1.2\n"))) as address:
            ports = [
                UsbSerialPort("/dev/none", "a filter wheel", "0403:6001"),
                UsbSerialPort("/dev/none", "a board that is away", "2341:0043"),
                UsbSerialPort(address, "Arduino Uno", "2341:0043"),
            ]
            monkeypatch.setattr(arduino, "usb_serial_ports", lambda: ports)
            assert found() == [(address, "light with dead-man, firmware 1.2")]


FRESH_OFF = (("host", b"L0\n"), ("device", b"OFF\n"))
"""The first "off" of a connection is said at once, and again when the board is silent: only the second is believed."""


class TestFaults:
    @pytest.mark.parametrize("answer", [b"OFF\n", b"ERR\n"])
    def test_does_not_switch_on(self, answer):
        asked = (("host", b"?\nI\n"), ("device", b"OFF\nLASER 1.2\n"), ("host", b"?\n"), ("device", b"OFF\n"))
        with (
            replayed(with_board(("host", b"L1\n"), ("device", answer), *asked)) as address,
            open_switch(address, "laser", None) as switch,
            pytest.raises(RefusedError, match="does not switch on"),
        ):
            switch.switch(True, DEADLINE_S)

    def test_an_answer_to_an_earlier_question_is_none_to_on(self):
        """An adapter that says a piece twice used to end the session at its next light."""
        asked = (("host", b"?\nI\n"), ("device", b"ON\nON\nLASER 1.2\n"), ("host", b"?\n"), ("device", b"ON\n"))
        with (
            replayed(with_board(("host", b"?\n"), ("device", b"OFF\nOFF\n"), ("host", b"L1\n"), *asked)) as address,
            open_switch(address, "laser", None) as switch,
        ):
            assert not switch.state(DEADLINE_S)
            switch.switch(True, DEADLINE_S)

    @pytest.mark.parametrize("answer", [b"ON\n", b"ERR\n", b"", b"O\xff\n", b"LASER 1.2\n"])
    def test_off_is_not_confirmed(self, answer):
        with (
            replayed(with_board(*FRESH_OFF, ("host", b"L0\n"), ("device", answer))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            began_s = time.monotonic()
            with pytest.raises(UnsafeError, match=r"NOT CONFIRMED OFF.*dead-man acts within 0\.5 s.*cannot be read"):
                switch.switch(False, 0.3)
            assert time.monotonic() - began_s < 0.3 + LATE_S

    def test_trip_before_off_is_no_fault(self):
        with (
            replayed(
                with_board(
                    *FRESH_OFF, ("host", b"L0\n"), ("device", b"TRIP\nOFF\n"), ("host", b"?\n"), ("device", b"OFF\n")
                )
            ) as address,
            open_switch(address, "laser", None) as switch,
        ):
            switch.switch(False, DEADLINE_S)
            assert not switch.state(DEADLINE_S)

    def test_the_answer_to_a_keep_alive_does_not_confirm_off(self):
        with (
            replayed(
                with_board(("host", b"K\nL0\n"), ("device", b"OFF\nON\n"), ("host", b"L0\n"), ("device", b"ON\n"))
            ) as address,
            open_switch(address, "laser", None) as switch,
        ):
            switch.keep_alive()
            with pytest.raises(UnsafeError, match="answers ON to the command to switch off"):
                switch.switch(False, DEADLINE_S)

    def test_after_a_missed_answer_questions_and_answers_match_again(self):
        spoken = with_board(
            ("host", b"?\n?\nI\n"), ("device", b"ON\nON\nLASER 1.2\n"), ("host", b"?\n"), ("device", b"OFF\n")
        )
        with replayed(spoken) as address, open_switch(address, "laser", None) as switch:
            with pytest.raises(TimedOutError, match="did not answer"):
                switch.state(0.1)
            assert not switch.state(DEADLINE_S), "the two late ONs are not the answer"

    @pytest.mark.parametrize(
        ("answer", "match"),
        [
            (b"TRIP\nOFF\n", "the dead-man switched it off"),
            (b"OFF\n", "reports OFF although it was switched on"),
            (b"LASER 1.2\n", "the board restarted, which switches the light off"),
        ],
    )
    def test_keep_alive_finds_the_light_off(self, answer, match):
        with (
            replayed(with_board(("host", b"K\n"), ("device", answer))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            switch.keep_alive()
            time.sleep(0.1)
            with pytest.raises(LostError, match=match):
                switch.keep_alive()

    def test_answers_that_are_lost_or_garbled_are_passed_over_but_not_for_long(self):
        """The light would go off for each: the next answer tells the same, and the dead-man acts by itself."""
        spoken = [("host", b"K\n"), ("device", b"O"), ("host", b"K\n"), ("device", b"ON\n"), ("host", b"K\n")]
        spoken += [("host", b"K\n"), ("device", b"ON\n"), ("host", b"K\n")]
        with replayed(with_board(*spoken)) as address, open_switch(address, "laser", None) as switch:
            for _ in range(5):
                switch.keep_alive()
                time.sleep(0.1)
        garbled = [("host", b"K\n"), ("device", b"\x80\x81\n")] * MISSED_ANSWERS
        with replayed(with_board(*garbled)) as address, open_switch(address, "laser", None) as switch:
            for _ in range(MISSED_ANSWERS):
                switch.keep_alive()
                time.sleep(0.05)
            with pytest.raises(TimedOutError, match="answered none of the last 10 keep-alives"):
                switch.keep_alive()

    def test_a_question_that_was_damaged_on_its_way_is_asked_again(self):
        """The firmware answers ERR to it, which says nothing of the light: a lit one used to count as off."""
        again = [("host", b"?\nI\n"), ("device", b"ON\nLASER 1.2\n"), ("host", b"?\n"), ("device", b"ON\n")]
        spoken = with_board(("host", b"?\n"), ("device", b"ERR\n"), *again)
        with replayed(spoken) as address, open_switch(address, "laser", None) as switch:
            assert switch.state(DEADLINE_S)
        spoken = with_board(("host", b"?\n"), ("device", b"ERR\n"))
        with (
            replayed(spoken) as address,
            open_switch(address, "laser", None) as switch,
            pytest.raises(LostError, match=r"answers ERR to '\?', so the question was damaged on its way; check"),
        ):
            switch.state(0.1)

    def test_an_answer_to_an_earlier_question_is_no_identity(self):
        again = [("host", b"I\n"), ("device", b"LASER 1.2\n")] * 2
        spoken = with_board(("host", b"I\n"), ("device", b"ON\n"), *again)
        with replayed(spoken) as address, open_switch(address, "laser", None) as switch:
            assert switch.identity().firmware == "1.2"

    def test_a_keep_alive_that_was_damaged_on_its_way_leaves_the_light_on(self):
        damaged = [("host", b"K\n"), ("device", b"ERR\n")]
        with (
            replayed(with_board(*damaged, ("host", b"K\n"), ("device", b"ON\n"), ("host", b"K\n"))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            for _ in range(3):
                switch.keep_alive()
                time.sleep(0.1)
        with replayed(with_board(*damaged * MISSED_ANSWERS)) as address, open_switch(address, "laser", None) as switch:
            for _ in range(MISSED_ANSWERS):
                switch.keep_alive()
                time.sleep(0.05)
            with pytest.raises(TimedOutError, match="answered none of the last 10 keep-alives"):
                switch.keep_alive()

    def test_mute_board_is_noticed(self):
        with (
            replayed(with_board(("host", b"K\n" * MISSED_ANSWERS))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            for _ in range(MISSED_ANSWERS):
                switch.keep_alive()
            with pytest.raises(TimedOutError, match="answered none of the last 10 keep-alives"):
                switch.keep_alive()

    def test_identity_is_asked_afresh(self):
        with (
            replayed(with_board(("host", b"I\n"), ("device", b"LASER 1.4\n"))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            assert switch.identity().firmware == "1.4"

    def test_identity_after_a_lost_answer_leaves_no_answer_for_the_next_question(self):
        spoken = [("host", b"K\nK\n"), ("device", b"ON\n"), *[("host", b"I\n"), ("device", b"LASER 1.2\n")] * 2]
        with (
            replayed(with_board(*spoken, ("host", b"?\n"), ("device", b"ON\n"))) as address,
            open_switch(address, "laser", None) as switch,
        ):
            switch.keep_alive()
            switch.keep_alive()  # the first was not answered
            assert switch.identity().firmware == "1.2"
            assert switch.state(DEADLINE_S)


SILENCE = "nothing more came"


class LineOf:
    """A link at which some bytes wait and then nothing comes."""

    board_serial = ""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def write(self, data: bytes, end_s: float) -> None:
        pass

    def drain(self, quiet_s: float, end_s: float) -> bytes:
        return b""

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        line, found_it, self.data = self.data.partition(terminator)
        if not found_it:
            raise TimedOutError(SILENCE)
        return line + terminator


class Chatter(LineOf):
    """A link at which the same line comes again and again."""

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        assert time.monotonic() < end_s + LATE_S, "read on beyond the deadline"
        return self.data


def test_finding_the_step_on_a_line_that_never_falls_silent_ends_at_the_deadline():
    switch = ArduinoSwitch(LineOf(b"LASER 1.2\n"), "laser", "a port")
    switch._link = Chatter(b"OFF\n")  # noqa: SLF001 - after a good start
    switch.keep_alive()
    with pytest.raises(LostError, match="reports OFF"):
        switch.keep_alive()  # from here on answers may belong to other commands
    with pytest.raises(UnsafeError, match=r"NOT CONFIRMED OFF.*does not stop sending; check that this port"):
        switch.switch(False, 0.2)


class SlowOff(LineOf):
    """A link at which "off" comes late and then nothing; it notes until when it is waited for."""

    ends_s: tuple[float, ...] = ()

    def read_until(self, terminator: bytes, end_s: float) -> bytes:
        self.ends_s += (end_s,)
        time.sleep(0.3)
        return super().read_until(terminator, end_s)


def test_asking_for_the_state_after_a_doubtful_on_takes_no_second_deadline():
    switch, link = ArduinoSwitch(LineOf(b"LASER 1.2\n"), "laser", "a port"), SlowOff(b"OFF\n")
    switch._link = link  # noqa: SLF001 - after a good start
    began_s = time.monotonic()
    with pytest.raises(TimedOutError, match=SILENCE):
        switch.switch(True, 0.4)
    assert len(link.ends_s) == 2
    assert max(link.ends_s) < began_s + 0.4 + 0.1  # 0.3 s more with a deadline of its own


WORDS = st.sampled_from([b"ON\n", b"OFF\n", b"ERR\n", b"TRIP\n", b"LASER 1.2\n", b"\n"])


@given(line=st.one_of(st.binary(max_size=20), WORDS))
def test_any_line_is_a_word_or_lost(line):
    try:
        said = parse(line, "laser")
    except LostError:
        return
    assert isinstance(said, Said)
    assert line.rstrip(b"\r\n") == " ".join(filter(None, said)).encode()


@given(data=st.lists(st.one_of(st.binary(max_size=6), WORDS), max_size=12).map(b"".join))
def test_whatever_comes_only_declared_errors_leave_the_driver(data):
    switch = ArduinoSwitch(LineOf(b"LASER 1.2\n"), "laser", "a port")
    switch._link = LineOf(data)  # noqa: SLF001 - after a good start
    try:
        with mock.patch.object(arduino, "IDENTITY_WITHIN_S", 0.0):
            switch.keep_alive()
            is_on = switch.state(0.0)
            switch.keep_alive()
            switch.switch(False, DEADLINE_S)
            identity = switch.identity()
    except CaptureError as error:
        said = str(error)
    else:
        said = SILENCE
        assert is_on in (True, False)
        assert identity.role == "laser"
    assert said == SILENCE or said.startswith("laser at a port")
