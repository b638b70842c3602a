"""The devices of a rig in bluesky's own RunEngine, with the light behind its real guard processes."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import bluesky.plan_stubs as bps
import bluesky.plans as bp
import event_model
import numpy as np
import pytest
from bluesky import RunEngine
from bluesky.protocols import Movable, Readable, Stoppable, Triggerable
from bluesky.utils import FailedStatus, RunEngineInterrupted

from data_schemas import (
    BadFrameError,
    CaptureError,
    LaserSettings,
    MissingExtraError,
    RefusedError,
    RigFile,
    UnsafeError,
)
from rigs import AbsentOperator, Light, OpenRig, RawFrame, open_rig, rig_locked, simulated_rig
from rigs.cameras._genicam import ANSWER_S, TRANSFER_S
from rigs.light_guard import GuardedLight, LightLostError, guarded_light
from rigs.ophyd_devices import OphydRig, RigLight, ophyd_rig
from tests.capture.drivers import file_switch
from tests.capture.drivers.light_owner import guards
from tests.capture.drivers.programs import wait_until

Plan = Generator[Any, Any, Any]
OFF_WITHIN_S = 2.0
EXPOSURE_S = 0.05
FLUORESCENT = 6  # slot of the filter at 600 nm, where the red paint shines


@pytest.fixture(scope="module")
def engine() -> Iterator[RunEngine]:
    """Return bluesky's engine; a process has one."""
    engine = RunEngine(context_managers=[])
    yield engine
    engine.loop.call_soon_threadsafe(engine.loop.stop)


@pytest.fixture(scope="module")
def rig() -> RigFile:
    return simulated_rig("red", width_px=160, height_px=128)


@pytest.fixture
def documents(engine: RunEngine) -> Iterator[list[tuple[str, dict[str, Any]]]]:
    """Return the documents that the engine emits, each judged by the event model."""
    found: list[tuple[str, dict[str, Any]]] = []

    def see(name: str, document: dict[str, Any]) -> None:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(
            event_model.sanitize_doc(document) if name == "event" else document
        )
        found.append((name, document))

    token = engine.subscribe(see)
    yield found
    engine.unsubscribe(token)


@pytest.fixture
def devices(engine: RunEngine, rig: RigFile) -> Iterator[OphydRig]:
    with ophyd_rig(rig, Path()) as opened:
        yield opened


def events(documents: list[tuple[str, dict[str, Any]]]) -> list[dict[str, Any]]:
    return [document["data"] for name, document in documents if name == "event"]


def test_they_keep_the_protocols_of_bluesky(devices: OphydRig) -> None:
    assert isinstance(devices.camera, Readable)
    assert isinstance(devices.camera, Triggerable)
    assert isinstance(devices.wheel, Movable)
    for light in (devices.laser, devices.lamp):
        assert isinstance(light, Movable)
        assert isinstance(light, Stoppable)


def test_count_takes_frames_with_what_was_read_back(
    engine: RunEngine, devices: OphydRig, documents: list[tuple[str, dict[str, Any]]]
) -> None:
    def plan() -> Plan:
        yield from bps.mv(devices.wheel, 3, devices.camera.exposure_s, EXPOSURE_S)
        yield from bp.count([devices.camera, devices.wheel, devices.lamp], 2)

    engine(plan())
    taken = events(documents)
    assert len(taken) == 2
    for data in taken:
        assert (data["wheel-slot"], data["wheel-filter_name"], data["lamp-is_on"]) == (3, "500", False)
        assert data["camera-exposed_s"] == EXPOSURE_S
        assert data["camera-frame"].shape == (128, 160)
        assert data["camera-mean_dn"] == pytest.approx(np.mean(data["camera-frame"]))
    assert not np.array_equal(taken[0]["camera-frame"], taken[1]["camera-frame"])
    descriptor = next(document for name, document in documents if name == "descriptor")
    assert descriptor["configuration"]["camera"]["data"]["camera-exposure_s"] == EXPOSURE_S
    assert descriptor["data_keys"]["camera-frame"]["dtype_numpy"] == "<u2"
    assert documents[-1][1]["exit_status"] == "success"


def test_a_plan_over_all_filters_sees_the_lamp_and_leaves_it_off(
    engine: RunEngine, devices: OphydRig, documents: list[tuple[str, dict[str, Any]]]
) -> None:
    def plan() -> Plan:
        yield from bps.mv(devices.camera.exposure_s, EXPOSURE_S)
        yield from bps.mv(devices.lamp, True)
        yield from bp.list_scan([devices.camera, devices.lamp], devices.wheel, [1, 5, 8])

    engine(plan())
    taken = events(documents)
    assert [data["wheel-slot"] for data in taken] == [1, 5, 8]
    assert all(data["lamp-is_on"] for data in taken)
    # the lamp is a warm one, the black level 16 DN
    assert 16.0 < taken[0]["camera-mean_dn"] < taken[1]["camera-mean_dn"]
    assert not devices.lamp.state()


def test_the_placed_paint_shines_under_the_laser(
    engine: RunEngine, devices: OphydRig, documents: list[tuple[str, dict[str, Any]]]
) -> None:
    def plan() -> Plan:
        yield from bps.mv(devices.target, "sample")
        yield from bps.mv(devices.camera.exposure_s, 2.0, devices.wheel, FLUORESCENT)
        yield from bp.count([devices.camera, devices.target])
        yield from bps.mv(devices.laser, True)
        yield from bp.count([devices.camera, devices.target])

    engine(plan())
    dark, lit_up = events(documents)
    assert dark["target-in_view"] == lit_up["target-in_view"] == "sample"
    # the paint of the practice rig gives 50 DN and more within 2 s; noise of a mean of 20,480 pixels is below 0.1 DN
    assert lit_up["camera-mean_dn"] > dark["camera-mean_dn"] + 10.0


def test_an_unknown_target_is_refused(engine: RunEngine, devices: OphydRig) -> None:
    with pytest.raises(FailedStatus) as raised:
        engine(bps.mv(devices.target, "finger"))
    assert re.search("'finger' is not valid; valid targets are white, sample", str(raised.value.__cause__))


def lit(devices: OphydRig, then: Callable[[], Plan]) -> Plan:
    """Return a plan that lights the laser and checks that it shines."""
    yield from bps.mv(devices.laser, True, devices.wheel, FLUORESCENT, devices.camera.exposure_s, EXPOSURE_S)
    assert devices.laser.state()
    yield from then()


def fails() -> Plan:
    yield from bps.null()
    raise ValueError("a plan's own mistake")


@pytest.mark.parametrize("end", ["it ends", "it raises"])
def test_the_laser_is_off_when_its_plan_has_ended(engine: RunEngine, devices: OphydRig, end: str) -> None:
    if end == "it raises":
        with pytest.raises(ValueError, match="a plan's own mistake"):
            engine(lit(devices, fails))
    else:
        engine(lit(devices, bps.null))
    assert not devices.laser.state()


@contextmanager
def guarded_rig(rig: RigFile, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[OphydRig, GuardedLight]]:
    """Open the simulated rig with a laser that is a file behind real guard processes."""
    file_switch.install(monkeypatch)

    with guarded_light("laser", "indi", str(folder)) as light:

        @contextmanager
        def opening(*asked: Any) -> Iterator[OpenRig]:
            with open_rig(*asked) as opened:
                yield replace(opened, laser=light)

        monkeypatch.setattr("rigs.ophyd_devices.open_rig", opening)
        with ophyd_rig(rig, Path()) as devices:
            yield devices, light


@pytest.mark.parametrize("end", ["it ends", "it raises", "its device fails"])
def test_the_guarded_laser_is_off_when_its_plan_has_ended(
    engine: RunEngine, rig: RigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    def seen_on() -> Plan:
        yield from bps.null()
        assert (tmp_path / "on").exists()
        if end == "it raises":
            yield from fails()
        if end == "its device fails":
            yield from bps.mv(devices.wheel, 99)

    with guarded_rig(rig, tmp_path, monkeypatch) as (devices, _):
        if end == "it ends":
            engine(lit(devices, seen_on))
        else:
            with pytest.raises((ValueError, FailedStatus)):
                engine(lit(devices, seen_on))
        assert not (tmp_path / "on").exists()
    assert not guards(str(tmp_path))


def test_a_pause_switches_off_and_going_on_lights_again(
    engine: RunEngine, rig: RigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[bool] = []

    def pausing() -> Plan:
        yield from bps.checkpoint()
        yield from bps.pause()
        found.append((tmp_path / "on").exists())

    with guarded_rig(rig, tmp_path, monkeypatch) as (devices, _):
        with pytest.raises(RunEngineInterrupted):
            engine(lit(devices, pausing))
        assert not (tmp_path / "on").exists()
        engine.resume()
        assert found == [True]
        assert not (tmp_path / "on").exists()


@pytest.mark.parametrize("how", ["abort", "stop", "halt"])
def test_a_paused_plan_that_is_given_up_leaves_the_laser_off(
    engine: RunEngine, rig: RigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    with guarded_rig(rig, tmp_path, monkeypatch) as (devices, _):
        with pytest.raises(RunEngineInterrupted):
            engine(lit(devices, bps.pause))
        getattr(engine, how)()
        assert not (tmp_path / "on").exists()


def pauses(devices: OphydRig, seen: list[bool]) -> Plan:
    """Return a plan that reads the laser and pauses; what it sees of it when it goes on is added to `seen`."""
    yield from bps.checkpoint()
    yield from bps.read(devices.laser)
    yield from bps.checkpoint()
    yield from bps.pause()
    seen.append(devices.laser.state())


def interrupted(engine: RunEngine, plan: Plan) -> None:
    with pytest.raises(RunEngineInterrupted):
        engine(plan)


@pytest.mark.parametrize("end", ["it ends", "it raises", "it is given up in a pause"])
def test_going_on_lights_no_laser_that_an_earlier_plan_had_lit(engine: RunEngine, devices: OphydRig, end: str) -> None:
    seen: list[bool] = []
    if end == "it ends":
        engine(lit(devices, bps.null))
    elif end == "it raises":
        with pytest.raises(ValueError, match="a plan's own mistake"):
            engine(lit(devices, fails))
    else:
        interrupted(engine, lit(devices, lambda: pauses(devices, seen)))
        engine.abort()
    interrupted(engine, pauses(devices, seen))
    engine.resume()
    assert seen == [False]


def switch_off(laser: RigLight) -> Plan:
    yield from bps.mv(laser, False)


def end_stage(laser: RigLight) -> Plan:
    yield from bps.unstage(laser, wait=True)


@pytest.mark.parametrize("by", [switch_off, bps.stop, end_stage])
def test_going_on_lights_no_laser_that_the_plan_itself_had_switched_off(
    engine: RunEngine, devices: OphydRig, by: Callable[[RigLight], Plan]
) -> None:
    seen: list[bool] = []

    def plan() -> Plan:
        yield from bps.stage(devices.laser)
        yield from bps.mv(devices.laser, True)
        yield from by(devices.laser)
        yield from pauses(devices, seen)

    interrupted(engine, plan())
    engine.resume()
    assert seen == [False]


def test_a_second_pause_of_a_plan_lights_again_too(engine: RunEngine, devices: OphydRig) -> None:
    seen: list[bool] = []

    def twice() -> Plan:
        yield from pauses(devices, seen)
        yield from pauses(devices, seen)

    interrupted(engine, lit(devices, twice))
    with pytest.raises(RunEngineInterrupted):
        engine.resume()
    assert not devices.laser.state()
    engine.resume()
    assert seen == [True, True]


class Asked(AbsentOperator):
    """A person who gives the next of the answers to each question."""

    def __init__(self, *answers: bool) -> None:
        super().__init__()
        self.answers, self.questions = list(answers), []

    def allows(self, question: str) -> bool:
        self.questions.append(question)
        return self.answers.pop(0)


def substituting(monkeypatch: pytest.MonkeyPatch, **parts: Any) -> None:
    """Have the simulated rig opened with other parts."""

    @contextmanager
    def opening(*asked: Any) -> Iterator[OpenRig]:
        with open_rig(*asked) as opened:
            yield replace(opened, **parts)

    monkeypatch.setattr("rigs.ophyd_devices.open_rig", opening)


def of_class(rig: RigFile, laser_class: str) -> RigFile:
    return rig.model_copy(update={"laser": rig.laser.model_copy(update={"laser_class": laser_class})})


def test_a_laser_that_harms_eyes_is_lit_again_only_after_asking(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    person, seen = Asked(False, True), []
    substituting(monkeypatch, operator=person)
    with ophyd_rig(of_class(rig, "3B"), Path()) as devices:
        interrupted(engine, lit(devices, lambda: pauses(devices, seen)))
        assert person.questions == []
        with pytest.raises(LightLostError, match="by a pause, and is switched on again only after a person"):
            engine.resume()
        assert not devices.laser.state()
        assert engine.state == "paused"
        engine.resume()
    assert seen == [True]
    assert len(person.questions) == 2
    assert "Is the box closed" in person.questions[0]


def test_nobody_is_asked_about_a_laser_that_harms_nobody(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    substituting(monkeypatch, operator=Asked())
    with ophyd_rig(of_class(rig, "2"), Path()) as devices:
        interrupted(engine, lit(devices, lambda: pauses(devices, seen)))
        engine.resume()
    assert seen == [True]


class Faulty:
    """A light that may go off by itself, and that may not be confirmed off."""

    def __init__(self, goes_off: bool) -> None:
        self.is_on, self.goes_off, self.times_lit = False, goes_off, 0

    def state(self) -> bool:
        return self.is_on

    @contextmanager
    def lit(self) -> Iterator[None]:
        self.is_on, self.times_lit = True, self.times_lit + 1
        yield
        if not self.goes_off:
            raise UnsafeError("laser: NOT CONFIRMED OFF; pull its plug")
        self.is_on = False


@contextmanager
def told_at_the_end(rig: RigFile) -> Iterator[OphydRig]:
    """Open the rig; the end of its block must say that a light is not confirmed off."""
    with ExitStack() as block:
        yield block.enter_context(ophyd_rig(rig, Path()))
        with pytest.raises(UnsafeError, match="NOT CONFIRMED OFF"):
            block.close()


def test_a_laser_that_is_not_confirmed_off_is_told_and_never_lit_again(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = Faulty(goes_off=False)
    substituting(monkeypatch, laser=light)
    with told_at_the_end(rig) as devices:
        engine(bps.mv(devices.laser, True))  # the engine only logs it
        for value in (True, False):
            with pytest.raises(FailedStatus) as raised:
                engine(bps.mv(devices.laser, value))
            assert isinstance(raised.value.__cause__, UnsafeError)
    assert light.times_lit == 1


def test_a_pause_with_a_laser_that_is_not_confirmed_off_ends_the_plan(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[bool] = []
    substituting(monkeypatch, laser=Faulty(goes_off=False))
    with told_at_the_end(rig) as devices:
        with pytest.raises(UnsafeError, match="NOT CONFIRMED OFF"):
            engine(lit(devices, lambda: pauses(devices, seen)))
        assert engine.state == "idle"
    assert seen == []


def test_a_laser_that_went_off_by_itself_is_not_taken_for_lit(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    light, person = Faulty(goes_off=True), Asked(False, True)
    substituting(monkeypatch, laser=light, operator=person)
    with ophyd_rig(of_class(rig, "3B"), Path()) as devices:

        def lost() -> Plan:
            light.is_on = False
            yield from bps.mv(devices.laser, True)

        for plan, told in (
            (lit(devices, lost), "went off without a command"),
            (bps.mv(devices.laser, True), "was lost, and is switched on again only after a person"),
        ):
            with pytest.raises(FailedStatus) as raised:
                engine(plan)
            assert told in str(raised.value.__cause__)
        assert light.times_lit == 1
        engine(lit(devices, bps.null))
    assert light.times_lit == 2
    assert not light.is_on


def test_a_guard_that_dies_ends_the_plan_with_the_laser_off(
    engine: RunEngine, rig: RigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with guarded_rig(rig, tmp_path, monkeypatch) as (devices, light):

        def struck() -> Plan:
            os.kill(light.guard_pid, signal.SIGKILL)
            yield from bp.count([devices.camera])

        with pytest.raises(FailedStatus) as raised:
            engine(lit(devices, struck))
        assert "the guard process has ended" in str(raised.value.__cause__)
        assert not (tmp_path / "on").exists()


PROGRAM = """
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
import bluesky.plan_stubs as bps
from bluesky import RunEngine
import rigs.ophyd_devices as ours
from rigs import Driver, offered, open_rig, simulated_rig
from rigs.light_guard import guarded_light
from tests.capture.drivers import file_switch
offered("light")["indi"] = (Driver("light", "indi", file_switch.__name__),)

@contextmanager
def opening(*asked):
    with open_rig(*asked) as opened, guarded_light("laser", "indi", sys.argv[1]) as light:
        yield replace(opened, laser=light)

ours.open_rig = opening
RE = RunEngine()
with ours.ophyd_rig(simulated_rig("red", width_px=64, height_px=64), Path()) as devices:
    def plan():
        yield from bps.mv(devices.laser, True)
        print("ON", flush=True)
        yield from bps.sleep(60.0)
    RE(plan())
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_laser_is_off_soon_after_the_program_is_killed_or_frozen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    file_switch.install(monkeypatch)  # the guard's environment
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)], stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ON\n"
            assert (tmp_path / "on").exists()
            process.send_signal(number)
            wait_until(lambda: not (tmp_path / "on").exists(), "the end of the light", OFF_WITHIN_S)
        finally:
            process.kill()
    wait_until(lambda: not guards(str(tmp_path)), "the end of the guard")


def test_a_laser_without_outside_layer_is_refused(
    engine: RunEngine, rig: RigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file_switch.install(monkeypatch)
    settings = LaserSettings(driver="indi", address=str(tmp_path), wavelength_nm=450.0, power_mw=4.5, laser_class="3B")
    with guarded_light("laser", "indi", str(tmp_path), laser=settings) as light:

        @contextmanager
        def opening(*asked: Any) -> Iterator[OpenRig]:
            with open_rig(*asked) as opened:
                yield replace(opened, laser=light)

        monkeypatch.setattr("rigs.ophyd_devices.open_rig", opening)
        with ophyd_rig(rig, Path()) as devices, pytest.raises(FailedStatus) as raised:
            engine(bps.mv(devices.laser, True))
        assert isinstance(raised.value.__cause__, RefusedError)
        assert not (tmp_path / "on").exists()


def test_a_frame_during_which_a_light_changes_is_not_used(
    engine: RunEngine, rig: RigFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Flickering:
        """A lamp that comes on while the camera exposes."""

        def __init__(self, lamp: Light) -> None:
            self._lamp, self.asked = lamp, 0
            self.identity, self.lit = lamp.identity, lamp.lit

        def state(self) -> bool:
            self.asked += 1
            return self.asked > 1

    @contextmanager
    def opening(*asked: Any) -> Iterator[OpenRig]:
        with open_rig(*asked) as opened:
            yield replace(opened, lamp=Flickering(opened.lamp))

    monkeypatch.setattr("rigs.ophyd_devices.open_rig", opening)
    with ophyd_rig(rig, Path()) as devices, pytest.raises(FailedStatus) as raised:
        engine(bp.count([devices.camera]))
    assert isinstance(raised.value.__cause__, BadFrameError)
    assert "'lamp': False" in str(raised.value.__cause__)
    assert "'lamp': True" in str(raised.value.__cause__)


def test_a_camera_has_time_to_throw_the_first_frame_of_a_new_exposure_away(
    engine: RunEngine, rig: RigFile, documents: list[tuple[str, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a capture: a camera that has no time for it keeps a frame that was exposed as before."""

    @contextmanager
    def opening(*asked: Any) -> Iterator[OpenRig]:
        with open_rig(*asked) as opened:

            class Slow:
                def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
                    thrown_away = opened.camera.expose(exposure_s, deadline_s)
                    is_in_time = deadline_s > 2 * (exposure_s + TRANSFER_S) + ANSWER_S
                    return thrown_away if is_in_time else replace(thrown_away, exposure_s=EXPOSURE_S)

            yield replace(opened, camera=Slow())

    def plan(devices: OphydRig) -> Plan:
        yield from bps.mv(devices.camera.exposure_s, 20.0)
        yield from bp.count([devices.camera])

    monkeypatch.setattr("rigs.ophyd_devices.open_rig", opening)
    with ophyd_rig(rig, Path()) as devices:
        engine(plan(devices))
    assert [data["camera-exposed_s"] for data in events(documents)] == [20.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda devices: bps.mv(devices.wheel, 99), "has no slot 99"),
        (
            lambda devices: bps.mv(devices.camera.exposure_s, 31.0),
            r"exposure_s = 31 s is outside the range of the rig file; 0\.0001 to 30 s are allowed",
        ),
    ],
)
def test_impossible_wishes_end_the_plan(
    engine: RunEngine, devices: OphydRig, change: Callable[[OphydRig], Plan], message: str
) -> None:
    def plan() -> Plan:
        yield from change(devices)
        yield from bps.trigger(devices.camera, wait=True)

    with pytest.raises(FailedStatus) as raised:
        engine(plan())
    assert isinstance(raised.value.__cause__, CaptureError)
    assert re.search(message, str(raised.value.__cause__))


def test_a_rig_in_use_is_not_opened_twice(engine: RunEngine) -> None:
    rig = simulated_rig("red", width_px=64, height_px=64)
    real = rig.model_copy(update={"camera": rig.camera.model_copy(update={"driver": "mjpeg", "address": "x"})})
    with rig_locked(real), pytest.raises(CaptureError, match="is in use by another capture"), ophyd_rig(real, Path()):
        pass


WITHOUT = """
import sys
sys.modules.update(dict.fromkeys({hidden!r}))
from data_schemas import MissingExtraError
try:
    import rigs.ophyd_devices
except MissingExtraError as error:
    print(error)
"""


def test_missing_package_names_the_extra() -> None:
    program = WITHOUT.format(hidden=["ophyd_async"])
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "pip install 'finray-calib[bluesky]'" in done.stdout
    assert MissingExtraError.__name__ not in done.stderr


def test_without_an_engine_it_says_what_to_do(tmp_path: Path) -> None:
    program = (
        "from pathlib import Path\nfrom rigs import simulated_rig\nfrom rigs.ophyd_devices import ophyd_rig\n"
        "with ophyd_rig(simulated_rig('red'), Path()):\n    pass"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "RefusedError: bluesky: there is no RunEngine yet; create it before the devices" in done.stderr


def test_a_wheel_that_is_turned_by_hand_asks_its_operator(engine: RunEngine, rig: RigFile) -> None:
    operator = AbsentOperator()
    with ophyd_rig(rig, Path(), operator) as devices:
        engine(bps.mv(devices.wheel, 2))
        assert devices.wheel.position() == 2
