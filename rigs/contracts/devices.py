"""The contracts of cameras, wheels, lights, stages and load cells, and the suites that run them on ``--rig``."""

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from data_schemas import (
    CameraSettings,
    CaptureError,
    FilterWheelSettings,
    LoadCellSettings,
    RefusedError,
    StageSettings,
)
from rigs import Camera, FilterWheel, Light, LoadCell, RawFrame, Stage, TerminalOperator
from rigs.capture import CAMERA_DEADLINE_MARGIN_S, EXPOSURE_TOLERANCE_REL, WHEEL_DEADLINE_S

LATE_FRAME_S = 1.0
"""How much later than its deadline an exchange may end: one register exchange, and a busy computer."""
USUAL_EXPOSURE_S = 0.01
LONG_EXPOSURE_S = 2.0
ENCODED = ("mjpeg",)
"""Drivers of cameras whose exposure is not in our hands and whose frames are pictures."""


class CameraContract:
    """Tests of a camera."""

    @pytest.fixture
    def exposures_s(self, camera_settings: CameraSettings) -> tuple[float, float]:
        """Return two exposures that the camera can do."""
        shortest_s, longest_s = camera_settings.shortest_exposure_s, camera_settings.longest_exposure_s
        first_s = min(max(USUAL_EXPOSURE_S, shortest_s), 0.5 * longest_s)
        return first_s, 2.0 * first_s

    def test_it_says_what_it_is(self, camera: Camera, camera_settings: CameraSettings) -> None:
        """Its identity is not empty; of a stream only its address need be known."""
        identity = camera.identity()
        assert identity.role == "camera"
        assert identity.driver
        assert identity.model or (camera_settings.driver in ENCODED and identity.address)

    def test_frames_have_the_shape_and_bits_of_the_rig_file(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """Counts are unsigned, of the stated size, and never above full scale."""
        counts = _exposed(camera, exposures_s[0]).counts
        assert counts.shape[:2] == (camera_settings.height_px, camera_settings.width_px)
        assert counts.ndim == (3 if camera_settings.driver in ENCODED else 2)
        assert counts.dtype == np.uint16
        assert counts.max() < 2**camera_settings.bit_depth

    def test_exposure_is_read_back(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """Every frame tells the exposure that was asked for and the one that was used, also after a change."""
        _require_exposure(camera_settings)
        for exposure_s in (*exposures_s, exposures_s[0]):
            frame = _exposed(camera, exposure_s)
            assert frame.exposure_requested_s == exposure_s
            assert frame.exposure_s == pytest.approx(exposure_s, rel=EXPOSURE_TOLERANCE_REL)

    def test_every_frame_is_new(self, camera: Camera, exposures_s: tuple[float, float]) -> None:
        """Number and device time differ from frame to frame; where there are none, the counts do, unless constant."""
        frames = [_exposed(camera, exposures_s[0]) for _ in range(3)]
        for last, frame in pairwise(frames):
            if frame.frame_id is not None or frame.device_time_s is not None:
                assert (frame.frame_id, frame.device_time_s) != (last.frame_id, last.device_time_s)
            else:
                assert frame.counts.min() == frame.counts.max() or not np.array_equal(frame.counts, last.counts)

    def test_impossible_exposure_is_refused_and_the_next_is_not(
        self, camera: Camera, camera_settings: CameraSettings, exposures_s: tuple[float, float]
    ) -> None:
        """An exposure out of range ends in RefusedError, never in a frame with another exposure."""
        _require_exposure(camera_settings)
        with pytest.raises(RefusedError):
            camera.expose(-1.0, CAMERA_DEADLINE_MARGIN_S)
        assert _exposed(camera, exposures_s[0]).exposure_s == pytest.approx(exposures_s[0], rel=EXPOSURE_TOLERANCE_REL)

    def test_deadline_is_kept(self, camera: Camera, camera_settings: CameraSettings) -> None:
        """A frame that cannot be there in time is not waited for, and the camera can be used again afterwards."""
        exposure_s = min(LONG_EXPOSURE_S, camera_settings.longest_exposure_s)
        deadline_s = 0.25 * exposure_s
        began_s = time.monotonic()
        try:
            camera.expose(exposure_s, deadline_s)
        except CaptureError:
            assert time.monotonic() - began_s < deadline_s + LATE_FRAME_S
        else:  # emulated cameras need not take the time
            assert time.monotonic() - began_s < deadline_s
        end_s = time.monotonic() + exposure_s + 2.0 * CAMERA_DEADLINE_MARGIN_S
        while True:
            try:
                frame = _exposed(camera, exposure_s)
            except CaptureError:
                if time.monotonic() > end_s:
                    raise
            else:
                break
        if camera_settings.driver not in ENCODED:
            assert frame.exposure_s == pytest.approx(exposure_s, rel=EXPOSURE_TOLERANCE_REL)


def _exposed(camera: Camera, exposure_s: float) -> RawFrame:
    return camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)


def _require_exposure(settings: CameraSettings) -> None:
    if settings.driver in ENCODED:
        pytest.skip(f"driver {settings.driver}: the camera sets its exposure by itself; it can be neither set nor read")


class TestCamera(CameraContract):
    """The camera of the rig file that ``--rig`` names."""


LATE_MOVE_S = 1.0
"""How much later than its deadline a move may be given up: one exchange, and a busy computer."""
TOO_SHORT_S = 0.001
"""No wheel with a motor moves, and no serial port answers, in so little time (s)."""


class FilterWheelContract:
    """Tests of a filter wheel; they turn it through all of its slots."""

    def test_it_says_what_it_is(self, wheel: FilterWheel) -> None:
        """Its identity is not empty."""
        identity = wheel.identity()
        assert identity.role == "filter wheel"
        assert identity.driver
        assert identity.model

    def test_it_has_the_slots_of_the_rig_file(self, wheel: FilterWheel, wheel_settings: FilterWheelSettings) -> None:
        """Its slots count upwards from 1 or more and hold every filter."""
        assert list(wheel.slots) == sorted(set(wheel.slots))
        assert min(wheel.slots) >= 1
        assert {optic.slot for optic in wheel_settings.filters} <= set(wheel.slots)

    def test_position_is_a_slot_or_unknown(self, wheel: FilterWheel) -> None:
        """What it reports before anybody moved it is one of its slots, or nothing."""
        assert wheel.position() in (None, *wheel.slots)

    def test_every_slot_is_reached_and_read_twice(self, wheel: FilterWheel) -> None:
        """After each move, also to where it stands, two readings name the slot."""
        for slot in (*wheel.slots, wheel.slots[-1], wheel.slots[0]):
            wheel.go_to(slot, WHEEL_DEADLINE_S)
            assert (wheel.position(), wheel.position()) == (slot, slot)

    def test_slot_that_it_lacks_is_refused_before_it_moves(self, wheel: FilterWheel) -> None:
        """Neither 0 nor the number after the last slot moves it."""
        wheel.go_to(wheel.slots[1], WHEEL_DEADLINE_S)
        for slot in (0, -1, wheel.slots[-1] + 1):
            with pytest.raises(RefusedError, match=f"no (slot|filter in slot) {slot}"):
                wheel.go_to(slot, WHEEL_DEADLINE_S)
            assert wheel.position() == wheel.slots[1]

    def test_deadline_is_kept_and_a_late_arrival_is_not_taken_for_the_next(self, wheel: FilterWheel) -> None:
        """A move that is given up raises at once; the next one ends at its own slot."""
        if wheel.identity().driver == "manual":
            pytest.skip("a wheel turned by hand: deadlines do not hold for people")
        wheel.go_to(wheel.slots[0], WHEEL_DEADLINE_S)
        began_s = time.monotonic()
        with pytest.raises(CaptureError):
            wheel.go_to(wheel.slots[len(wheel.slots) // 2], TOO_SHORT_S)
        assert time.monotonic() - began_s < TOO_SHORT_S + LATE_MOVE_S
        assert wheel.position() in (None, *wheel.slots)
        wheel.go_to(wheel.slots[1], WHEEL_DEADLINE_S)
        assert (wheel.position(), wheel.position()) == (wheel.slots[1], wheel.slots[1])


class TestFilterWheel(FilterWheelContract):
    """The filter wheel of the rig file that ``--rig`` names."""


CYCLES = 3


class DisturbanceError(Exception):
    """What goes wrong in a block."""


class LightContract:
    """Tests of a light; they switch it on for moments."""

    @pytest.fixture
    def switch_off_behind(self) -> Callable[[], None] | None:
        """Return what switches the light off without the driver; None where nothing can."""
        return None

    def test_it_says_what_it_is(self, light: Light) -> None:
        """Its identity is not empty."""
        identity = light.identity()
        assert identity.role in ("laser", "lamp")
        assert identity.driver

    def test_it_is_off_when_opened(self, light: Light) -> None:
        """Nobody asked for light yet."""
        assert light.state() is False

    def test_on_and_off_are_confirmed(self, light: Light) -> None:
        """It is on inside each block and off after it."""
        for _ in range(CYCLES):
            with light.lit():
                assert light.state() is True
            assert light.state() is False

    def test_exception_leaves_it_off(self, light: Light) -> None:
        """However a block ends, the light is off, and the exception is not swallowed."""
        for kind in (DisturbanceError, KeyboardInterrupt):
            with pytest.raises(kind), light.lit():
                raise kind
            assert light.state() is False

    def test_state_is_asked_afresh(self, light: Light, switch_off_behind: Callable[[], None] | None) -> None:
        """A light that somebody else switched off is not reported on."""
        if switch_off_behind is None:
            pytest.skip("this test has no means of switching this light off other than its driver")
        with light.lit():
            assert light.state() is True
            switch_off_behind()
            assert light.state() is False


class TestLaser(LightContract):
    """The laser of the rig file that ``--rig`` names."""

    @pytest.fixture
    def light(self, laser: Light) -> Light:
        """Return the laser."""
        return laser


class TestLamp(LightContract):
    """The lamp of the rig file that ``--rig`` names."""

    @pytest.fixture
    def light(self, lamp: Light) -> Light:
        """Return the lamp."""
        return lamp


HOMING_S = 60.0
SMALL_MOVES = 4
"""Long steps into the pad from where nothing touches: clear_mm must be farther from it than so many."""
LATE_STOP_S = 4.0
"""How much later than its cause a stop may be seen, beyond the way that was left."""

FILTER_READINGS = 4
"""Of a load cell, until its amplifier shows all of a change."""


def _require_zero(stage: Stage) -> None:
    """Skip the test unless a person at the terminal says that the stage is at its zero."""
    where = ", ".join(f"{axis} {at_mm:.3f} mm" for axis, at_mm in sorted(stage.counted_mm().items()))
    if not TerminalOperator().allows(
        f"The stage reports its position as {where}. The test moves it by the positions of the rig file, and a wrong "
        "zero drives the indenter into the bench. Have you brought the stage to the zero from which the rig file "
        "counts positions, and is the way to clear_mm free?"
    ):
        pytest.skip(
            "NOT TESTED: nobody confirmed that the stage is at its zero, so it did not move; bring it there, run "
            "pytest with -s in a terminal, and type yes when asked"
        )


class StageContract:
    """Tests of a stage; they home it, and move its press axis a few steps from where nothing touches.

    Every move towards the pad is one step at the speed of presses, and the load cell is read while anything moves.
    """

    @pytest.fixture
    def guard(self) -> Callable[[], None]:
        """Return what is called while the stage moves; it raises when the load cell feels something."""
        raise NotImplementedError("give a fixture `guard` that reads the load cell, as TestStage does")

    @pytest.fixture
    def homed(self, stage: Stage, stage_settings: StageSettings, guard: Callable[[], None]) -> Stage:
        """Return the stage with its places known, clear of the pad."""
        if stage.places_mm() is None:
            if stage_settings.homing == "by hand":
                _require_zero(stage)
                stage.trust_places()
            else:
                stage.home(HOMING_S, guard)
        self.go(stage, stage_settings, 0, guard)
        return stage

    def go(self, stage: Stage, settings: StageSettings, steps: int, guard: Callable[[], None]) -> float:
        """Move to some long steps into the pad from where nothing touches; return the place."""
        axis, to_mm = settings.press_axis, settings.clear_mm + settings.into_pad * steps * settings.step_mm
        places = stage.places_mm()
        if places is None:
            raise RefusedError("stage: its position is unknown; home it")
        at_mm = places[axis]
        while settings.into_pad * (to_mm - at_mm) > settings.step_mm:
            at_mm += settings.into_pad * settings.step_mm
            stage.move(axis, at_mm, settings.press_speed_mm_per_s, guard)
            for _ in range(FILTER_READINGS):  # before the next step, so that no two are unfelt
                guard()
        is_away = settings.into_pad * (to_mm - at_mm) < 0.0
        stage.move(axis, to_mm, settings.travel_speed_mm_per_s if is_away else settings.press_speed_mm_per_s, guard)
        return to_mm

    def test_it_says_what_it_is(self, stage: Stage) -> None:
        """Its identity is not empty."""
        identity = stage.identity()
        assert identity.role == "stage"
        assert identity.driver

    def test_its_place_is_unknown_before_it_is_homed(
        self, stage: Stage, stage_settings: StageSettings, guard: Callable[[], None]
    ) -> None:
        """A stage that was only opened moves nowhere."""
        if stage.places_mm() is not None:
            pytest.skip("an earlier test has homed the stage")
        with pytest.raises(RefusedError):
            stage.move(stage_settings.press_axis, stage_settings.clear_mm, stage_settings.press_speed_mm_per_s, guard)

    def test_it_arrives_and_comes_back(
        self, homed: Stage, stage_settings: StageSettings, guard: Callable[[], None]
    ) -> None:
        """Each place is reported within the uncertainty of the rig file, also after going back and forth."""
        for steps in (1, SMALL_MOVES, 2, 0, SMALL_MOVES, 0):
            to_mm = self.go(homed, stage_settings, steps, guard)
            places = homed.places_mm()
            assert places is not None
            assert places[stage_settings.press_axis] == pytest.approx(
                to_mm, abs=2.0 * stage_settings.position_uncertainty_mm
            )

    def test_travel_is_kept_before_it_moves(
        self, homed: Stage, stage_settings: StageSettings, guard: Callable[[], None]
    ) -> None:
        """A place beyond the travel of the rig file is refused, and nothing moves."""
        before = homed.places_mm()
        beyond_mm = stage_settings.deepest_mm + stage_settings.into_pad
        with pytest.raises(RefusedError):
            homed.move(stage_settings.press_axis, beyond_mm, stage_settings.travel_speed_mm_per_s, guard)
        assert homed.places_mm() == before

    def test_what_the_watch_raises_stops_it(
        self, homed: Stage, stage_settings: StageSettings, guard: Callable[[], None]
    ) -> None:
        """It is told, the stage stands, and it can go on, at once or after it was homed again."""
        for kind in (CaptureError, KeyboardInterrupt):

            def watch(kind: type[BaseException] = kind) -> None:
                raise kind("the contract stops the stage")

            began_s = time.monotonic()
            with pytest.raises(kind):
                homed.move(
                    stage_settings.press_axis,
                    stage_settings.clear_mm + stage_settings.into_pad * stage_settings.step_mm,
                    stage_settings.press_speed_mm_per_s,
                    watch,
                )
            assert time.monotonic() - began_s < LATE_STOP_S
            first = homed.places_mm()
            assert first == homed.places_mm()
            if first is not None:
                self.go(homed, stage_settings, 0, guard)


class LoadCellContract:
    """Tests of a load cell; nothing may touch it."""

    def test_it_says_what_it_is(self, load_cell: LoadCell) -> None:
        """Its identity is not empty."""
        identity = load_cell.identity()
        assert identity.role == "load cell"
        assert identity.driver

    def test_readings_come_at_their_rate(self, load_cell: LoadCell, load_cell_settings: LoadCellSettings) -> None:
        """Each is later than the one before, and there are as many as the rig file says, within a third."""
        readings = [load_cell.read(load_cell_settings.silent_s) for _ in range(2 * load_cell_settings.rate_hz)]
        assert all(sooner.at_s < later.at_s for sooner, later in pairwise(readings))
        rate_hz = (len(readings) - 1) / (readings[-1].at_s - readings[0].at_s)
        assert rate_hz == pytest.approx(load_cell_settings.rate_hz, rel=1 / 3)

    def test_it_is_not_stuck(self, load_cell: LoadCell, load_cell_settings: LoadCellSettings) -> None:
        """Counts scatter, as those of every amplifier of 24 bits do."""
        counts = [load_cell.read(load_cell_settings.silent_s).counts for _ in range(load_cell_settings.rate_hz)]
        assert len(set(counts)) > len(counts) // 4

    def test_deadline_is_kept(self, load_cell: LoadCell) -> None:
        """What cannot come in time is not waited for, and the next reading comes."""
        began_s = time.monotonic()
        try:
            load_cell.read(TOO_SHORT_S)
        except CaptureError:
            assert time.monotonic() - began_s < TOO_SHORT_S + LATE_MOVE_S
        load_cell.read(1.0)


class TestStage(StageContract):
    """The stage of the rig file that ``--rig`` names."""

    @pytest.fixture
    def guard(self, stage_guard: Callable[[], None]) -> Callable[[], None]:
        """Return what reads the load cell of the rig file."""
        return stage_guard


class TestLoadCell(LoadCellContract):
    """The load cell of the rig file that ``--rig`` names."""
