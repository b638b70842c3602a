"""The device part of an acceptance check: facts on the simulated rig, and one faulty device at a time."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from data_schemas import (
    BadFrameError,
    CaptureError,
    CheckFacts,
    CheckPlan,
    LaserSettings,
    LostError,
    RefusedError,
    RigFile,
    TimedOutError,
    UnsafeError,
    WrongPositionError,
)
from rigs import OpenRig, RawFrame, open_rig, paint_plan
from rigs.capture import _check_light as light_witness
from rigs.capture import _check_session as check_session
from rigs.capture import check_filters, record_facts
from rigs.capture import light_off_time as laser_watch
from rigs.capture._check_light import CameraWatch, Reading, find_sight
from rigs.capture._check_session import CheckFrames, _Recorder
from rigs.capture._exposure import REPLAY_DRIVER, shine
from rigs.capture.light_off_time import (
    ConnectionWatch,
    Holder,
    _kill,
    after_exception,
    after_kill,
    can_be_asked_anew,
    make_off,
)
from rigs.light_guard import LightLostError
from tests.capture.drivers.firmware_in_qemu import build, firmware_board
from tests.capture.drivers.indi_server import PANEL, IndiServer

Change = Callable[[OpenRig], OpenRig]


@pytest.fixture(scope="module")
def plan(rig: RigFile) -> CheckPlan:
    return CheckPlan(
        check_name="lab", region=paint_plan("red", rig.camera).region, wheel_moves=5, revisits=2, warm_up_s=4.0
    )


@dataclass
class Device:
    """A device of which some parts are replaced."""

    device: Any
    replaced: dict[str, Any] = field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:
        return self.replaced[name] if name in self.replaced else getattr(self.device, name)


def raising(error: Exception, after: int = 0) -> Callable[..., Any]:
    """Return what raises from the call after so many."""
    calls = iter(range(after))

    def act(*_: object) -> None:
        if next(calls, None) is None:
            raise error

    return act


def facts_of(rig: RigFile, plan: CheckPlan, monkeypatch: pytest.MonkeyPatch, change: Change) -> CheckFacts:
    """Record the facts of the simulated rig with a changed device."""

    @contextmanager
    def changed(*given: Any) -> Iterator[OpenRig]:
        with open_rig(*given) as opened:
            yield change(opened)

    monkeypatch.setattr(check_session, "open_rig", changed)
    return record_facts(rig, plan, Path())[0]


def test_facts_of_the_simulated_rig(rig: RigFile, plan: CheckPlan) -> None:
    calls: list[tuple[int, int, str]] = []
    facts, _ = record_facts(rig, plan, Path(), lambda *call: calls.append(call))
    assert facts.errors == {}
    assert [hand.role for hand in facts.handshakes] == ["camera", "filter wheel", "laser", "lamp"]
    assert all(hand.identity is not None and len(hand.durations_s) == 3 for hand in facts.handshakes)
    assert len(facts.moves) == 5
    assert all(move.from_slot != move.to_slot == move.arrived_slot for move in facts.moves)
    assert facts.filter_proof is not None
    assert facts.filter_proof.verdict == "confirmed"
    assert facts.revisit_filter in {f.name for f in rig.filter_wheel.filters}
    assert len(facts.revisits) == 2
    # two frames of 0.2 % each and shot noise of the small region, five standard deviations
    assert all(abs(value) < 0.02 for one in facts.revisits for value in (one.still_rel, one.moved_rel))
    assert [dark.exposure_s for dark in facts.darks] == [rig.camera.shortest_exposure_s, 0.5, 1.0]
    first, second, third = (level.exposure_s for level in facts.levels)
    assert (second, third) == pytest.approx((2 * first, 4 * first))
    block, guard, dead_man = facts.light_off
    assert (block.layer, block.latest_s, block.still_on) == ("block", (0.0, 0.0, 0.0), 0)
    assert {guard.missing, dead_man.missing} == {"the simulated rig has no guard process"}
    assert [done for done, total, _ in calls] == list(range(14))
    assert {total for _, total, _ in calls} == {14}


def test_moves_are_those_of_the_seed(rig: RigFile, plan: CheckPlan) -> None:
    def targets(seed: int) -> list[int]:
        quick = CheckPlan.model_validate({**plan.model_dump(), "seed": seed, "revisits": 0})
        return [move.to_slot for move in record_facts(rig, quick, Path())[0].moves]

    assert targets(1) == targets(1) != targets(2)


def test_one_filter_allows_no_move_and_no_revisit(rig: RigFile, plan: CheckPlan) -> None:
    facts, _ = record_facts(rig, plan.model_copy(update={"filters": ("405",)}), Path())
    assert (facts.revisits, facts.errors) == ((), {})
    assert facts.moves == ()  # the wheel stands there already


def test_wheel_that_slips_is_recorded_where_it_stands(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        def slip(slot: int, deadline_s: float) -> None:
            opened.wheel.go_to(slot % 8 + 1, deadline_s)
            raise WrongPositionError("wheel: rests elsewhere")

        return replace(opened, wheel=Device(opened.wheel, {"go_to": slip}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert len(facts.moves) == 5
    assert all(move.arrived_slot == move.to_slot % 8 + 1 for move in facts.moves)
    assert "rests elsewhere" in facts.errors["filters"]
    assert facts.light_off[0].latest_s == (0.0, 0.0, 0.0)  # the next sections go on


def test_wheel_that_falls_silent_keeps_the_moves_before(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        silent = raising(LostError("wheel: gone"), after=17)  # metering makes the first 15 moves

        def go_to(slot: int, deadline_s: float) -> None:
            silent()
            opened.wheel.go_to(slot, deadline_s)

        return replace(opened, wheel=Device(opened.wheel, {"go_to": go_to}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert len(facts.moves) == 2
    assert facts.errors["wheel"] == "wheel: gone"


def test_another_device_at_the_second_opening_is_seen(rig, plan, monkeypatch):
    openings: list[int] = []

    def change(opened: OpenRig) -> OpenRig:
        openings.append(1)
        other = opened.camera.identity().model_copy(update={"serial": "another"})
        return (
            replace(opened, camera=Device(opened.camera, {"identity": lambda: other})) if len(openings) > 1 else opened
        )

    facts = facts_of(rig, plan, monkeypatch, change)
    assert facts.reconnect_s is not None
    assert facts.reconnected[0].serial == "another"
    assert [hand.identity for hand in facts.handshakes][1:] == list(facts.reconnected[1:])
    assert len(facts.frame_overheads_s) == 2 * 3 * plan.exposure_rounds
    assert facts.white_span_s > 0.0


def test_mute_device_is_an_error_of_its_own_handshake(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        return replace(opened, lamp=Device(opened.lamp, {"identity": raising(LostError("lamp: gone"))}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert [hand.error for hand in facts.handshakes] == [None, None, None, "lamp: gone"]
    assert facts.errors == {"reconnect": "lamp: gone"}


def test_camera_that_fails_ends_its_sections_only(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        return replace(opened, camera=Device(opened.camera, {"expose": raising(RefusedError("camera: no"))}))

    facts = facts_of(rig, plan, monkeypatch, change)
    lost = ("dark frames", "warm-up", "filters", "revisits", "exposures", "stray light")
    assert facts.errors == dict.fromkeys(lost, "camera: no")
    assert len(facts.moves) == 5
    assert facts.light_off[0].latest_s


def test_a_filter_that_cannot_be_metered_is_no_fault_of_lamp_or_wheel(rig, plan, monkeypatch):
    last = check_filters(plan, rig)[-1]

    def change(opened: OpenRig) -> OpenRig:
        def expose(*given: float) -> RawFrame:
            if opened.wheel.position() == last.slot:
                raise RefusedError("camera: no")
            return opened.camera.expose(*given)

        return replace(opened, camera=Device(opened.camera, {"expose": expose}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert facts.errors["filters"] == "camera: no"
    assert "wheel" not in facts.errors
    assert len(facts.moves) == 5
    assert all(move.arrived_slot == move.to_slot for move in facts.moves)


def test_exchanged_filters_are_seen(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        slots = {2: 6, 6: 2}  # 450 and 600 nm
        wheel = opened.wheel

        def position() -> int | None:
            at = wheel.position()
            return None if at is None else slots.get(at, at)

        def go_to(slot: int, deadline_s: float) -> None:
            wheel.go_to(slots.get(slot, slot), deadline_s)

        return replace(opened, wheel=Device(wheel, {"position": position, "go_to": go_to}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert facts.filter_proof is not None
    assert facts.filter_proof.verdict == "contradicted"
    assert "450" in facts.filter_proof.text
    assert "600" in facts.filter_proof.text


def darkened(frame: RawFrame) -> RawFrame:
    return replace(frame, counts=np.full_like(frame.counts, 16))


def test_dark_white_tile_is_an_error_that_says_so(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        def expose(*given: float) -> RawFrame:
            return darkened(opened.camera.expose(*given))

        return replace(opened, camera=Device(opened.camera, {"expose": expose}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert set(facts.errors) == {"revisits", "exposures"}
    assert "the white tile gives only 0 DN" in facts.errors["revisits"]
    assert facts.filter_proof is not None
    assert facts.filter_proof.verdict == "cannot tell"


def test_lamp_too_bright_for_a_quarter_of_the_exposure(rig: RigFile, plan: CheckPlan) -> None:
    camera = rig.camera.model_copy(update={"shortest_exposure_s": 0.0008})
    facts, _ = record_facts(rig.model_copy(update={"camera": camera}), plan, Path())
    assert "but a quarter is below the camera's shortest exposure" in facts.errors["exposures"]


@pytest.mark.parametrize("driver", ["simulated", REPLAY_DRIVER])
def test_a_frame_that_is_there_too_soon_is_an_error_but_from_a_folder(
    rig: RigFile, plan: CheckPlan, driver: str
) -> None:
    number, band = count(), rig.filter_wheel.filters[0]
    as_driven = rig.model_copy(update={"camera": rig.camera.model_copy(update={"driver": driver})})
    with open_rig(rig, Path()) as opened:
        first = opened.camera.expose(0.5, 10.0)

        def expose(exposure_s: float, deadline_s: float) -> RawFrame:
            one = next(number)
            counts = np.roll(first.counts, one)
            return replace(first, counts=counts, frame_id=one, exposure_s=exposure_s, exposure_requested_s=exposure_s)

        at_once = replace(opened, camera=Device(opened.camera, {"expose": expose}))
        frames = CheckFrames(at_once, as_driven, plan, [band])
        soon = pytest.raises(CaptureError, match="but its frame arrived") if driver == "simulated" else nullcontext()
        with soon:
            frames.dark_frames()


def test_light_that_stays_on_ends_the_check(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        @contextmanager
        def lit() -> Iterator[None]:
            opened.lamp.bench_state.lamp = True
            yield  # and never off

        return replace(opened, lamp=Device(opened.lamp, {"lit": lit}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert (
        "lamp: still reports that it is on at the end of this part of the check; pull its plug"
        in facts.errors["warm-up"]
    )
    assert (
        facts.errors["filters"] == facts.errors["revisits"] == facts.errors["light off"] == "not tried: the lamp is on"
    )
    assert facts.light_off == ()


def test_light_that_cannot_be_asked_ends_the_check(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        return replace(opened, laser=Device(opened.laser, {"state": raising(LostError("laser: gone"))}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert facts.handshakes[2].error == "laser: gone"
    assert facts.errors["warm-up"] == "not tried: a light does not report whether it is off (laser: gone)"


def test_unsafe_laser_ends_the_check(rig, plan, monkeypatch):
    def change(opened: OpenRig) -> OpenRig:
        return replace(opened, laser=Device(opened.laser, {"lit": raising(UnsafeError("laser: NOT CONFIRMED OFF"))}))

    facts = facts_of(rig, plan, monkeypatch, change)
    assert facts.errors == {
        "stray light": "laser: NOT CONFIRMED OFF",
        **dict.fromkeys(("trigger latency", "light off", "reconnect"), "not tried: a light is not confirmed off"),
    }
    assert facts.light_off == ()


def test_laser_that_stays_dark_or_lit(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        dark = replace(opened, laser=Device(opened.laser, {"state": lambda: False}))
        with pytest.raises(CaptureError, match="reports that it is off right after it was switched on"):
            after_exception(dark, 1)
        lit = replace(opened, laser=Device(opened.laser, {"state": lambda: True}))
        found = after_exception(lit, 2)
        assert (found.still_on, found.latest_s) == (2, ())


def test_rig_that_does_not_open_or_close_is_reported(rig, plan, monkeypatch):
    @contextmanager
    def shut(*_: object) -> Iterator[OpenRig]:
        raise LostError("camera: not there")
        yield

    monkeypatch.setattr(check_session, "open_rig", shut)
    facts, notes = record_facts(rig, plan, Path())
    assert notes == ()
    assert facts.errors.pop("opening") == "camera: not there"
    sections = (*check_session.WITH_OPEN_RIG, "reconnect")
    assert facts.errors == dict.fromkeys(sections, "not tried: the rig could not be opened")

    @contextmanager
    def stuck(*given: Any) -> Iterator[OpenRig]:
        with open_rig(*given) as opened:
            yield opened
        raise UnsafeError("laser: NOT CONFIRMED OFF")

    monkeypatch.setattr(check_session, "open_rig", stuck)
    facts, _ = record_facts(rig, plan, Path())
    assert facts.errors["closing"] == "laser: NOT CONFIRMED OFF"
    assert facts.errors["light off"] == "not tried: a light is not confirmed off"
    assert len(facts.light_off) == 1  # the block was tried before


def test_plan_must_fit_the_rig(rig: RigFile, plan: CheckPlan) -> None:
    with pytest.raises(CaptureError, match="the rig has no filter '999'"):
        check_filters(plan.model_copy(update={"filters": ("999",)}), rig)
    with pytest.raises(CaptureError, match=r"plan\.filters: is empty"):
        check_filters(plan.model_copy(update={"filters": ()}), rig)
    region = plan.region.model_copy(update={"row_px": 1000})
    with pytest.raises(CaptureError, match="outside the frame"):
        check_filters(plan.model_copy(update={"region": region}), rig)


class TestCameraWatch:
    """The camera as the witness of the laser, on the simulated bench."""

    def test_the_camera_sees_the_laser_go_on_and_off(self, rig, plan, monkeypatch):
        with open_rig(rig, Path()) as opened:
            frames = CheckFrames(opened, rig, plan, check_filters(plan, rig))
            sight = find_sight(opened, rig, frames)
            assert sight is not None
            assert sight.exposure_s <= 0.05
            # behind the filter that blocks it the laser is as good as off; what stays unseen follows from noise
            assert (sight.blocked_filter, abs(sight.blocked_on_dn - sight.blocked_off_dn) < 2.0) == ("405", True)
            assert 0.4 < sight.threshold_dn - sight.off_dn < 0.01 * (sight.on_dn - sight.off_dn)
            assert opened.wheel.position() == 2  # the filter that passes 450 nm

            @contextmanager
            def camera_alone(settings: object, folder: object) -> Iterator[Any]:
                yield opened.camera

            monkeypatch.setattr(light_witness, "open_camera", camera_alone)
            with CameraWatch(rig, Path(), frames, sight).open() as watch:
                assert watch.look().on is False
                with opened.laser.lit():
                    seen = watch.look()
                assert seen.on is True
                assert seen.end_s >= seen.start_s
                assert watch.look().on is False

                def faint(exposure_s: float, deadline_s: float) -> RawFrame:
                    raw = opened.camera.expose(exposure_s, deadline_s)
                    return replace(raw, counts=raw.counts + np.uint16(0.05 * (sight.on_dn - sight.off_dn)))

                dimmed = Device(opened.camera, {"expose": faint})
                monkeypatch.setattr(light_witness, "open_camera", lambda *_: nullcontext(dimmed))
                with CameraWatch(rig, Path(), frames, sight).open() as watch:
                    assert watch.look().on is True  # a twentieth of the laser's light is not off
                torn = raising(BadFrameError("camera: torn"))
                monkeypatch.setattr(
                    light_witness, "open_camera", lambda *_: nullcontext(Device(None, {"expose": torn}))
                )
                with CameraWatch(rig, Path(), frames, sight).open() as watch:
                    assert watch.look().on is None

    def test_the_wheel_is_turned_before_the_laser_is_lit(self, rig, plan):
        """It may be turned by hand."""
        lit: list[bool] = []
        with open_rig(rig, Path()) as opened:
            opened.wheel.go_to(7, 20.0)

            def go_to(slot: int, deadline_s: float) -> None:
                lit.append(opened.laser.state())
                opened.wheel.go_to(slot, deadline_s)

            watched = replace(opened, wheel=Device(opened.wheel, {"go_to": go_to}))
            assert find_sight(watched, rig, CheckFrames(watched, rig, plan, check_filters(plan, rig))) is not None
        assert len(lit) >= 3
        assert not any(lit)

    def test_no_sight_without_a_filter_light_or_camera(self, rig, plan):
        with open_rig(rig, Path()) as opened:
            frames = CheckFrames(opened, rig, plan, check_filters(plan, rig))
            green = rig.model_copy(update={"laser": LaserSettings(wavelength_nm=520.0)})
            assert find_sight(opened, green, frames) is None
            blind = replace(opened, camera=Device(opened.camera, {"expose": raising(RefusedError("camera: no"))}))
            assert find_sight(blind, rig, CheckFrames(blind, rig, plan, check_filters(plan, rig))) is None

            def expose(*given: float) -> RawFrame:
                return darkened(opened.camera.expose(*given))

            black = replace(opened, camera=Device(opened.camera, {"expose": expose}))
            assert find_sight(black, rig, CheckFrames(black, rig, plan, check_filters(plan, rig))) is None

            def count_nothing(*given: float) -> RawFrame:
                raw = opened.camera.expose(*given)
                return replace(raw, counts=np.zeros_like(raw.counts))

            # no laser, and a camera without noise and black level
            zero = replace(opened, camera=Device(opened.camera, {"expose": count_nothing}))
            level = rig.model_copy(update={"camera": rig.camera.model_copy(update={"black_level_dn": 0.0})})
            assert find_sight(zero, level, CheckFrames(zero, level, plan, check_filters(plan, level))) is None
            with shine(opened, "off"):
                pass  # nothing was left on


def test_who_can_be_asked_anew() -> None:
    def laser(driver: str, address: str) -> LaserSettings:
        given = {"driver": driver, "address": address, "wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": "3R"}
        return LaserSettings.model_validate(given)

    assert can_be_asked_anew(laser("indi", "127.0.0.1:7624/Panel"))
    assert can_be_asked_anew(laser("arduino", "socket://127.0.0.1:5"))
    assert not can_be_asked_anew(laser("arduino", "/dev/ttyACM0"))


def nobody(port_address: str) -> LaserSettings:
    return LaserSettings(driver="arduino", address=port_address, wavelength_nm=450.0, power_mw=4.5, laser_class="3R")


def test_laser_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laser_watch, "OFF_WITHIN_S", 0.2)
    laser = nobody("/dev/no-such-port")
    assert ConnectionWatch(laser).look().on is None
    with pytest.raises(UnsafeError, match="NOT CONFIRMED OFF after its safety layers were tried"):
        make_off(laser)
    with pytest.raises(UnsafeError, match="pull its plug before anyone opens the box"):
        after_kill(laser, "guard", ConnectionWatch(laser), 1)


def test_hazardous_laser_without_a_layer_outside_the_computer_is_not_lit_to_test_the_others() -> None:
    laser = nobody("x").model_copy(update={"driver": "indi", "address": "127.0.0.1:1/Panel"})
    with pytest.raises(RefusedError, match="a class 3R laser is switched on only if hardware outside"):
        after_kill(laser, "guard", ConnectionWatch(laser), 1)


def test_holder_that_cannot_hold_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rigs.capture.light_off_time.make_off", lambda laser: None)
    laser = nobody("/dev/no-such-port")
    with pytest.raises(CaptureError, match=r"that should keep it on answered: laser at /dev/no-such-port"):
        after_kill(laser, "guard", ConnectionWatch(laser), 1)
    monkeypatch.setattr("rigs.capture.light_off_time.START_WITHIN_S", 0.0)
    with pytest.raises(TimedOutError, match="did not answer within 0 s"):
        after_kill(laser, "guard", ConnectionWatch(laser), 1)


POLLING = """
import os, time
print("on", flush=True)
while True:
    time.sleep(0.005)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system keeps no process on one core")
def test_three_processes_are_stopped_at_once_beside_other_work() -> None:
    """None of them ran in between: the kernel counts how often each was given a core, and stopping them takes one."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    tries, at_once = 12, 0
    try:
        for _ in range(tries):
            held = [subprocess.Popen([sys.executable, "-c", POLLING], stdout=subprocess.PIPE) for _ in range(3)]
            for one in held:
                assert one.stdout is not None
                assert one.stdout.readline() == b"on\n"
            at_once += _kill(Holder(held[0], held[1].pid, held[2].pid), "dead-man")
            for one in held:
                assert one.wait(5.0) == -signal.SIGKILL
                one.stdout.close()
    finally:
        for one in busy:
            one.kill()
            one.wait()
    assert at_once >= tries // 2  # 295 of 300 as measured; of two tries in a row one is enough


def test_a_process_that_was_taken_off_its_core_meanwhile_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    stop = os.kill

    def slow(pid: int, number: int) -> None:
        stop(pid, number)
        if number == signal.SIGSTOP:
            time.sleep(1e-5)  # shorter than any limit of time

    held = [subprocess.Popen([sys.executable, "-c", POLLING], stdout=subprocess.PIPE) for _ in range(3)]
    with ExitStack() as stack:
        for one in held:
            stack.enter_context(one)
        monkeypatch.setattr("rigs.capture.light_off_time.os.kill", slow)
        assert not _kill(Holder(held[0], held[1].pid, held[2].pid), "dead-man")


def test_a_guard_that_ends_between_the_stops_leaves_no_process_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A watch that stays stopped never switches off, and holds the laser's port."""
    send = os.kill
    with ExitStack() as stack:
        held = [stack.enter_context(subprocess.Popen([sys.executable, "-c", POLLING])) for _ in range(3)]
        stack.callback(lambda: [one.kill() for one in held])
        holder, watch, guard = held

        def ending(pid: int, number: int) -> None:
            send(pid, number)
            if pid == watch.pid and number == signal.SIGSTOP:
                guard.kill()
                guard.wait(5.0)

        monkeypatch.setattr("rigs.capture.light_off_time.os.kill", ending)
        with pytest.raises(CaptureError, match="its guard or watch ended before the check killed it"):
            _kill(Holder(holder, watch.pid, guard.pid), "dead-man")
        assert [watch.wait(5.0), holder.wait(5.0)] == [-signal.SIGKILL] * 2


@pytest.mark.rigs
class TestKilled:
    """Layers that act when processes are killed: the real firmware in QEMU, and INDI's light panel."""

    def test_guard_and_dead_man_of_the_firmware(self, tmp_path):
        with firmware_board(build(tmp_path)) as board:
            laser = nobody(board.address)
            guard = after_kill(laser, "guard", ConnectionWatch(laser), 2)
            assert (guard.still_on, guard.witness) == (0, "a new connection")
            assert len(guard.latest_s) == 2
            assert max(guard.latest_s) < 1.0
            assert not board.times("device", b"TRIP")  # the guard was first
            start_s = time.monotonic()
            dead_man = after_kill(laser, "dead-man", ConnectionWatch(laser, quiet_s=0.95), 2)
            assert dead_man.still_on == 0
            # nobody else switched it off; a try that is made again, as not all were stopped at once, trips too
            assert len(board.times("device", b"TRIP", after_s=start_s)) >= len(dead_man.latest_s) == 2
            # the quicker of two: a connection that a busy machine refuses or is late with costs a second look
            assert 0.95 <= min(dead_man.latest_s) < 1.1
            assert not board.state()

    def test_processes_that_cannot_be_stopped_at_once_prove_no_dead_man(self, tmp_path, monkeypatch):
        monkeypatch.setattr("rigs.capture.light_off_time._switches", count(1).__next__)
        monkeypatch.setattr("rigs.capture.light_off_time._MOST_TRIES", 2)
        with firmware_board(build(tmp_path)) as board:
            laser = nobody(board.address)
            with pytest.raises(CaptureError, match="could not be stopped at the same time in 2 tries"):
                after_kill(laser, "dead-man", ConnectionWatch(laser, quiet_s=0.95), 1)
            assert not board.state()

    def test_a_layer_that_does_nothing_is_still_on_and_made_off(self, tmp_path, monkeypatch):
        class Blind:
            witness = "the camera"

            def look(self) -> Reading:
                time.sleep(0.05)
                return Reading(time.monotonic(), time.monotonic(), True)

        monkeypatch.setattr("rigs.capture.light_off_time.WATCHED_S", 0.5)
        with firmware_board(build(tmp_path)) as board:
            laser = nobody(board.address)
            found = after_kill(laser, "guard", Blind(), 1)
            assert (found.still_on, found.latest_s) == (1, ())
            assert not board.state()

    def test_guard_of_the_indi_panel(self, tmp_path):
        with IndiServer(tmp_path, {"indi_simulator_lightpanel": PANEL}) as server:
            panel = {"driver": "indi", "address": server.address(PANEL), "laser_class": "2"}
            laser = nobody("x").model_copy(update=panel)
            found = after_kill(laser, "guard", ConnectionWatch(laser), 2)
            assert found.still_on == 0
            assert max(found.latest_s) < 1.0
            assert ConnectionWatch(laser).look().on is False


@pytest.mark.parametrize(("hazard", "goes_on"), [("3R", False), ("4", False), ("2M", True)])
def test_a_hazardous_laser_that_went_out_is_not_lit_by_the_next_layer(
    rig: RigFile, plan: CheckPlan, monkeypatch: pytest.MonkeyPatch, hazard: str, goes_on: bool
) -> None:
    """Somebody may have opened the box: the layers after it would light the laser again."""
    labelled = rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": hazard})})
    lit = raising(LightLostError("laser: did not come on; it is confirmed off"))
    facts = facts_of(
        labelled, plan, monkeypatch, lambda opened: replace(opened, laser=Device(opened.laser, {"lit": lit}))
    )
    assert facts.errors["stray light"].startswith("laser: did not come on")
    assert facts.errors["light off"].startswith(
        "laser: did not come on" if goes_on else "not tried: the laser went off without a command"
    )
    assert bool(facts.light_off) == goes_on  # what the layers without the rig recorded


@pytest.mark.parametrize(("hazard", "tried"), [("3R", ["guard"]), ("2M", ["guard", "dead-man"])])
def test_a_hazardous_laser_that_failed_in_a_layer_is_not_lit_by_the_next_one(
    rig: RigFile, plan: CheckPlan, monkeypatch: pytest.MonkeyPatch, hazard: str, tried: list[str]
) -> None:
    """Its holder says that it was lost, in words only: another process lit it."""
    begun: list[str] = []

    def after_kill(laser: LaserSettings, layer: str, *_: object) -> NoReturn:
        begun.append(layer)
        raise CaptureError("laser: the program that should keep it on answered: the guard process has ended")

    monkeypatch.setattr("rigs.capture._check_session.after_kill", after_kill)
    monkeypatch.setattr("rigs.capture._check_session.can_be_asked_anew", lambda laser: True)
    labelled = rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": hazard})})
    recorder = _Recorder(labelled, plan, Path(), check_filters(plan, labelled), lambda *_: None)
    monkeypatch.setattr(recorder, "_has_dead_man", True)
    guard, dead_man = recorder._without_rig()  # noqa: SLF001 - the bench has no guard that could be lost
    assert begun == tried
    assert "the guard process has ended" in str(guard.error)
    assert ("not lit again until a person has found the cause" in str(dead_man.error)) == (hazard == "3R")
