"""A check of a rig beside devices that answer correctly and lie: no row that a lie could falsify passes.

Rows that it cannot falsify (identity, the devices' own times) are left out. So are those that this small plan leaves
UNDECIDED on an honest rig too: exposure ratios, and whether the lamp is steady. All others pass there, so that a row
which is left UNDECIDED is so because of the lie.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_schemas import CheckPlan, CheckResult
from finray_calib.acceptance import judge
from rigs import OpenRig, RawFrame, open_rig, paint_plan, simulated_rig
from rigs.capture import _check_session as check_session
from rigs.capture import record_facts
from tests.capture.test_check_session import Device

Change = Callable[[OpenRig], OpenRig]
RIG = simulated_rig("red", width_px=64, height_px=64)
PLAN = CheckPlan(
    check_name="lab", region=paint_plan("red", RIG.camera).region, wheel_moves=8, revisits=6, warm_up_s=4.0
)

METERED = 15
"""Moves of a check until all filters are metered."""
CHECKED_MOVE = 20
"""Of the moves of a check, the first of which bring each filter into the beam to be metered."""
DARK = ("dark level", "dark rate", "read noise")
WHEEL = ("wheel arrives", "wheel moves in time", "wheel repeats optically", "filters in their slots")


def wheel(kind: str) -> Change:
    """Return a wheel that says that it is at the slot that was asked for.

    It is absent, one slot farther, or stays where it is at one of the moves that are checked.
    """

    def change(opened: OpenRig) -> OpenRig:
        said, moves = list[int](), [0]

        def go_to(slot: int, deadline_s: float) -> None:
            said[:] = [slot]
            moves[0] += 1
            if kind == "farther" or (kind == "stays once" and moves[0] != CHECKED_MOVE):
                opened.wheel.go_to(slot % 8 + 1 if kind == "farther" else slot, deadline_s)

        def position() -> int | None:
            here = opened.wheel.position()
            return here if here is None or not said else said[0]

        return replace(opened, wheel=Device(opened.wheel, {"go_to": go_to, "position": position}))

    return change


def light(name: str, kind: str) -> Change:
    """Return a light that says of itself what was asked for: it stays on, is on from the beginning, or never."""

    def change(opened: OpenRig) -> OpenRig:
        said, state = [False], opened.camera.state  # type: ignore[attr-defined]

        @contextmanager
        def lit() -> Iterator[None]:
            said[0] = True
            setattr(state, name, kind != "never on")
            try:
                yield
            finally:
                said[0] = False

        setattr(state, name, kind == "always on")
        return replace(opened, **{name: Device(getattr(opened, name), {"lit": lit, "state": lambda: said[0]})})

    return change


def camera(kind: str) -> Change:
    """Return a camera that numbers its frames anew and delivers old ones, or exposes for half of what it says."""

    def change(opened: OpenRig) -> OpenRig:
        taken, laser_slots = list[RawFrame](), set[int | None]()

        def expose(exposure_s: float, deadline_s: float) -> RawFrame:
            is_dark = not (opened.lamp.state() or opened.laser.state())
            if opened.laser.state():
                laser_slots.add(opened.wheel.position())
            late = kind == "halves later" and len(laser_slots) > 1
            halved = late or kind == "halves all" or (kind == "halves in the dark" and is_dark)
            raw = opened.camera.expose(0.5 * exposure_s if halved else exposure_s, deadline_s)
            number = len(taken)
            now = replace(
                raw, exposure_requested_s=exposure_s, exposure_s=exposure_s, frame_id=number, device_time_s=number
            )
            taken.append(now)
            if number and (kind == "always the first frame" or (kind == "every other frame is old" and number % 2)):
                return replace(now, counts=taken[0 if kind == "always the first frame" else -2].counts)
            return now

        return replace(opened, camera=Device(opened.camera, {"expose": expose}))

    return change


def dimmed(raw: RawFrame, factor: float) -> RawFrame:
    """Return a frame with another light level."""
    black = RIG.camera.black_level_dn
    return replace(raw, counts=np.round(black + factor * (raw.counts - float(black))).astype(raw.counts.dtype))


def lamp_that_changes(level: Callable[[int], float]) -> Change:
    """Return a lamp whose level follows from the moves of the wheel."""

    def change(opened: OpenRig) -> OpenRig:
        moves = [0]

        def go_to(slot: int, deadline_s: float) -> None:
            moves[0] += 1
            opened.wheel.go_to(slot, deadline_s)

        def expose(exposure_s: float, deadline_s: float) -> RawFrame:
            raw = opened.camera.expose(exposure_s, deadline_s)
            return dimmed(raw, level(moves[0])) if opened.lamp.state() else raw

        return replace(
            opened,
            wheel=Device(opened.wheel, {"go_to": go_to}),
            camera=Device(opened.camera, {"expose": expose}),
        )

    return change


def checked(change: Change, monkeypatch: pytest.MonkeyPatch) -> dict[str, CheckResult]:
    """Return the results of a check by the names of its rows."""

    @contextmanager
    def changed(*given: Any) -> Iterator[OpenRig]:
        with open_rig(*given) as opened:
            yield change(opened)

    monkeypatch.setattr(check_session, "open_rig", changed)
    facts, notes = record_facts(RIG, PLAN, Path())
    return {one.name: one for one in judge(facts, PLAN, RIG, notes).results}


def verdicts(change: Change, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Return the verdicts of a check by the names of its rows."""
    return {name: one.verdict for name, one in checked(change, monkeypatch).items()}


CASES: dict[str, tuple[Change, tuple[str, ...]]] = {
    "wheel absent": (wheel("absent"), (*WHEEL, "stray light", "laser off after an exception")),
    "wheel one slot farther": (wheel("farther"), (*WHEEL, "stray light")),
    "wheel stays at a checked move": (wheel("stays once"), ("wheel arrives",)),
    "lamp stays on": (light("lamp", "stays on"), (*WHEEL, "dark level stays", "stray light")),
    "lamp always on": (
        light("lamp", "always on"),
        ("dark level", "dark rate", *WHEEL, "dark level stays", "stray light"),
    ),
    "lamp never on": (light("lamp", "never on"), (*WHEEL, "dark level stays")),
    "laser stays on": (light("laser", "stays on"), ("stray light", "laser off after an exception")),
    "laser always on": (light("laser", "always on"), ("stray light", "laser off after an exception")),
    "laser never on": (light("laser", "never on"), ("stray light", "laser off after an exception")),
    "camera halves all": (camera("halves all"), DARK),
    "camera halves in the dark": (camera("halves in the dark"), DARK),
    "camera halves from the second filter under the laser": (camera("halves later"), ("stray light",)),
    "camera always the first frame": (
        camera("always the first frame"),
        (*DARK, *WHEEL, "dark level stays", "stray light", "laser off after an exception"),
    ),
    "camera every other frame is old": (
        camera("every other frame is old"),
        (*DARK, *WHEEL, "dark level stays", "stray light", "laser off after an exception"),
    ),
}


@pytest.fixture(scope="module")
def found_honest() -> dict[str, str]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        return verdicts(lambda opened: opened, monkeypatch)


def test_no_row_fails_on_an_honest_rig(found_honest: dict[str, str]) -> None:
    assert {name for name, verdict in found_honest.items() if verdict in ("FAIL", "ERROR")} == set()


@pytest.mark.parametrize("lie", CASES)
def test_no_row_that_a_lie_falsifies_passes(
    monkeypatch: pytest.MonkeyPatch, found_honest: dict[str, str], lie: str
) -> None:
    change, rows = CASES[lie]
    assert {row: found_honest.get(row) for row in rows} == dict.fromkeys(rows, "PASS")  # a misspelt one is None
    found = verdicts(change, monkeypatch)
    assert [row for row in rows if found.get(row) == "PASS"] == []


@pytest.mark.parametrize("fall", [0.0, 0.01])
def test_a_lamp_that_changes_after_the_metering_is_not_blamed_on_the_wheel(
    monkeypatch: pytest.MonkeyPatch, fall: float
) -> None:
    """It is dimmer from the first checked move on, or falls from move to move: by more than 10 % in the end."""
    found = checked(
        lamp_that_changes(lambda moves: 1.0 if moves <= METERED else 0.88 - fall * (moves - METERED - 4)), monkeypatch
    )
    assert found["wheel arrives"].verdict == "UNDECIDED"
    assert "all 8 moves arrived" in found["wheel arrives"].evidence
    assert "(see wheel moves)" in found["wheel arrives"].evidence
    assert "lamp: the white tile is 0.8" in found["wheel moves"].evidence


def test_one_frame_of_another_level_is_a_fault_of_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    found = verdicts(lamp_that_changes(lambda moves: 0.5 if moves == CHECKED_MOVE else 1.0), monkeypatch)
    assert found["wheel arrives"] == "FAIL"
