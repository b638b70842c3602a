"""The INDI wheel against INDI's simulator, and against its drivers of real wheels with their faults."""

import asyncio
import queue
import threading
import time
from collections.abc import Iterator

import pytest

from data_schemas import LostError, RefusedError, TimedOutError, WrongPositionError
from rigs import FilterWheel, TerminalOperator
from rigs.filter_wheels import Arrival, indi, require_slot, require_slots
from rigs.filter_wheels.indi import open_wheel
from rigs.transports import Fault, IndiClient, fault_listener
from tests.capture.drivers.indi_server import REAL_WHEELS, WHEEL, IndiServer
from tests.capture.drivers.programs import require_module
from tests.capture.drivers.rig_excerpts import wheel_settings
from tests.capture.drivers.serial_replay import TRANSCRIPTS, read_transcript, replayed

RECORDED = read_transcript(TRANSCRIPTS / "indi_filter_wheel.txt")
OPERATOR = TerminalOperator()
MANUAL = "Manual Filter"
MOVE_S = 20.0


def replayed_wheel(address: str) -> str:
    return f"{address.removeprefix('socket://')}/{WHEEL}"


def until_the_move(**answers: bytes) -> list[tuple[str, bytes]]:
    """The recorded exchange up to the answer to the move, with other words in that answer."""
    at = next(i for i, (who, said) in enumerate(RECORDED) if who == "host" and b"newNumberVector" in said) + 1
    said = RECORDED[at][1]
    for old, new in answers.items():
        said = said.replace(f'state="{old}"'.encode(), b'state="' + new + b'"')
    return [*RECORDED[:at], ("device", said)]


def test_the_recorded_wheel_is_moved_and_read_back() -> None:
    with (
        replayed(RECORDED) as address,
        open_wheel(wheel_settings(replayed_wheel(address)), OPERATOR) as wheel,
    ):
        assert wheel.slots == tuple(range(1, 9))
        wheel.go_to(3, 5.0)
        assert wheel.position() == 3
        assert (wheel.identity().role, wheel.identity().model) == ("filter wheel", WHEEL)


def test_an_alert_is_a_refusal() -> None:
    with (
        replayed(until_the_move(Ok=b"Alert")) as address,
        open_wheel(wheel_settings(replayed_wheel(address)), OPERATOR) as wheel,
        pytest.raises(RefusedError, match=r"refuses to move to slot 3 .*Setting current filter to slot 3"),
    ):
        wheel.go_to(3, 5.0)


def test_a_wheel_that_never_ends_its_move_is_late() -> None:
    with (
        replayed(until_the_move(Ok=b"Busy")) as address,
        open_wheel(wheel_settings(replayed_wheel(address)), OPERATOR) as wheel,
        pytest.raises(TimedOutError, match=r"did not move to slot 3 within 0\.[23] s"),
    ):
        wheel.go_to(3, 0.3)


def test_an_ok_at_another_slot_is_no_arrival(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver says Ok, and to both questions that follow that the wheel rests at slot 1."""
    monkeypatch.setattr(indi, "ELSEWHERE_S", 0.0)
    at = next(i for i, (who, said) in enumerate(RECORDED) if who == "host" and b"newNumberVector" in said) + 1
    elsewhere = [(who, said.replace(b"\n3\n", b"\n1\n")) for who, said in RECORDED[at : at + 5]]
    with (
        replayed([*RECORDED[:at], *elsewhere]) as address,
        open_wheel(wheel_settings(replayed_wheel(address)), OPERATOR) as wheel,
        pytest.raises(WrongPositionError, match="was sent to slot 3, but stopped at slot 1"),
    ):
        wheel.go_to(3, 5.0)


def test_arrival_is_two_polls_in_a_row_or_rest_elsewhere() -> None:
    arrival = Arrival("wheel", 4, elsewhere_s=0.03)
    assert [arrival.sees(at) for at in (4, None, 4, 3, 4, 4)] == [False, False, False, False, False, True]
    assert not arrival.sees(3)
    time.sleep(0.04)
    with pytest.raises(WrongPositionError, match="wheel: was sent to slot 4, but stopped at slot 3"):
        arrival.sees(3)


def test_slots_that_a_wheel_lacks_are_refused() -> None:
    require_slot(6, range(1, 7), "wheel")
    with pytest.raises(RefusedError, match=r"wheel: has no slot 7 \(its slots are 1 to 6\)"):
        require_slot(7, range(1, 7), "wheel")
    with pytest.raises(RefusedError, match="it offers no slot at all"):
        require_slot(1, (), "wheel")
    filters = wheel_settings("h/W", count=8).filters
    require_slots(filters, range(1, 9), "wheel")
    with pytest.raises(RefusedError, match="F7 in slot 7, F8 in slot 8; name a wheel with more slots"):
        require_slots(filters, range(1, 7), "wheel")
    with pytest.raises(RefusedError, match="F8 in slot 8; correct the slot numbers"):
        require_slots(filters[-1:], range(1, 7), "wheel")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[IndiServer]:
    drivers = {"indi_simulator_wheel": WHEEL, "indi_manual_wheel": MANUAL, **REAL_WHEELS}
    with IndiServer(tmp_path_factory.mktemp("indi"), drivers) as running:
        for device in REAL_WHEELS.values():
            running.put(device, "SIMULATION.ENABLE=On")
        yield running


@pytest.fixture
def wheel(server: IndiServer) -> Iterator[FilterWheel]:
    with open_wheel(wheel_settings(server.address(WHEEL), count=8), OPERATOR) as opened:
        yield opened


@pytest.mark.rigs
def test_all_slots_are_reached_in_the_wheels_own_time(wheel: FilterWheel) -> None:
    for slot in wheel.slots:
        began_s = time.monotonic()
        wheel.go_to(slot, MOVE_S)
        # INDI's simulator takes half a second a move; the rest is for a busy machine.
        assert 0.4 < time.monotonic() - began_s < 2.0
        assert wheel.position() == slot


@pytest.mark.rigs
@pytest.mark.parametrize("slot", [0, 9, -1])
def test_a_bad_slot_is_refused_before_anything_moves(wheel: FilterWheel, slot: int) -> None:
    before = wheel.position()
    with pytest.raises(RefusedError, match=f"has no slot {slot} .its slots are 1 to 8."):
        wheel.go_to(slot, MOVE_S)
    assert wheel.position() == before


@pytest.mark.rigs
def test_the_drivers_own_alert_carries_its_text(server: IndiServer) -> None:
    with IndiClient(server.address(WHEEL), "filter wheel", "FILTER_SLOT") as client:
        end_s = time.monotonic() + 5.0
        client.ready(end_s)
        with pytest.raises(RefusedError, match="valid range of filter is from 1 to 8"):
            client.change("Number", "FILTER_SLOT", {"FILTER_SLOT_VALUE": "9"}, end_s)


@pytest.mark.rigs
def test_a_rig_with_more_filters_than_slots_is_refused(server: IndiServer) -> None:
    with (
        pytest.raises(RefusedError, match="its slots are 1 to 5, but the rig file puts F6 in slot 6"),
        open_wheel(wheel_settings(server.address(MANUAL), count=8), OPERATOR),
    ):
        pass


@pytest.mark.rigs
def test_a_stuck_wheel_is_late_and_its_position_unknown(server: IndiServer) -> None:
    """Nobody confirms the change at INDI's wheel that is turned by hand."""
    with open_wheel(wheel_settings(server.address(MANUAL)), OPERATOR) as wheel:
        began_s = time.monotonic()
        with pytest.raises(TimedOutError, match=r"did not move to slot 3 .*Please change filter"):
            wheel.go_to(3, 0.5)
        assert time.monotonic() - began_s < 1.5
        assert wheel.position() is None
        with pytest.raises(TimedOutError, match="cannot move to slot 1, because an earlier move has not ended"):
            wheel.go_to(1, 0.5)


@pytest.mark.rigs
def test_the_late_ok_of_a_move_does_not_answer_the_next(server: IndiServer) -> None:
    """Optec's driver takes seconds a move: asked for 5 on the way to 3, it says Ok at 3."""
    with open_wheel(wheel_settings(server.address("Optec IFW")), OPERATOR) as wheel:
        with pytest.raises(TimedOutError, match="did not move to slot 3"):
            wheel.go_to(3, 0.5)
        began_s = time.monotonic()
        wheel.go_to(5, MOVE_S)
        assert wheel.position() == 5
        # At least the rest of the first move and some of its own went by.
        assert time.monotonic() - began_s > 2.0


@pytest.mark.rigs
@pytest.mark.parametrize("device", ["Quantum Wheel", "QHYCFW2"])
def test_moves_in_a_row_each_end_at_their_slot(server: IndiServer, device: str) -> None:
    with open_wheel(wheel_settings(server.address(device)), OPERATOR) as wheel:
        for slot in (3, 5, 1, 4, 2):
            wheel.go_to(slot, MOVE_S)
            assert wheel.position() == slot
        with pytest.raises(RefusedError, match="has no slot 8"):
            wheel.go_to(8, MOVE_S)


@pytest.mark.rigs
def test_a_wheel_that_answers_every_move_with_an_alert(server: IndiServer) -> None:
    with open_wheel(wheel_settings(server.address("TruTech Wheel")), OPERATOR) as wheel:
        with pytest.raises(RefusedError, match=r"refuses to move to slot 3 .*Sending command select filter failed"):
            wheel.go_to(3, MOVE_S)
        assert wheel.position() is None


@pytest.mark.rigs
def test_a_disconnected_driver_is_connected_again_and_its_slot_unknown(server: IndiServer, wheel: FilterWheel) -> None:
    """What a restarted driver says of its slot is not seen by anybody: only a move makes it known again."""
    faults: list[Fault] = []
    wheel.go_to(2, MOVE_S)
    server.put(WHEEL, "CONNECTION.DISCONNECT=On")
    with fault_listener(faults.append):
        assert wheel.position() is None
    assert "the driver withdrew FILTER_SLOT" in faults[0].what
    wheel.go_to(2, MOVE_S)
    assert wheel.position() == 2


@pytest.mark.rigs
def test_a_mute_server_is_late_and_a_killed_one_lost_until_it_is_back(server: IndiServer, wheel: FilterWheel) -> None:
    with server.frozen(), pytest.raises(TimedOutError, match="did not report FILTER_SLOT"):
        wheel.go_to(2, 0.3)
    moving = threading.Thread(target=wheel.go_to, args=(6, 30.0))
    moving.start()
    time.sleep(0.2)
    server.kill()
    with pytest.raises(LostError, match="nothing listens at"):
        open_wheel(wheel_settings(server.address(WHEEL)), OPERATOR).__enter__()
    server.start()
    moving.join()
    assert wheel.position() == 6


@pytest.mark.rigs
def test_another_client_sees_the_same_moves(server: IndiServer, wheel: FilterWheel) -> None:
    """indipyclient, an independent client, hears of the slot that was asked for, and moves it where we then see it."""
    require_module("indipyclient", "indipyclient")
    from indipyclient.queclient import QueClient

    orders: queue.Queue[object] = queue.Queue()
    events: queue.Queue[object] = queue.Queue()
    client = QueClient(orders, events, "127.0.0.1", server.port)
    thread = threading.Thread(target=lambda: asyncio.run(client.asyncrun()))
    thread.start()
    try:
        end_s = time.monotonic() + MOVE_S

        def seen_at(slot: int) -> None:
            while time.monotonic() < end_s:
                event = events.get(timeout=MOVE_S)
                if getattr(event, "devicename", None) == WHEEL and getattr(event, "vectorname", None) == "FILTER_SLOT":
                    vector = event.snapshot[WHEEL]["FILTER_SLOT"]  # type: ignore[attr-defined]
                    if vector.state == "Ok" and float(vector["FILTER_SLOT_VALUE"]) == slot:
                        return
            pytest.fail(f"indipyclient never saw slot {slot}")

        wheel.go_to(7, MOVE_S)
        seen_at(7)
        orders.put((WHEEL, "FILTER_SLOT", {"FILTER_SLOT_VALUE": 2}))
        seen_at(2)
        assert wheel.position() == 2
    finally:
        orders.put(None)
        thread.join(MOVE_S)
