"""Independent witnesses of a rig that presses: a known mass, a gauge block, the picture's scale, and the cell."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from data_schemas import AcceptanceReport, CheckPlan, PressLimits
from data_schemas.storage import read_record
from finray_calib.acceptance import judge_pressing
from rigs import ForceLimitError, RawFrame
from rigs.capture import OpenTactileRig
from rigs.capture._press_rounds import still_after
from tests.capture.test_check_press import Wrapped, changed, checked, lying, named, still_pad_axis
from tests.capture.test_check_press import practice as practice
from tests.command_line.running import finray

MASS = "rest_s = 10.0\n[known_mass]\nmass_kg = 0.2\nuncertainty_kg = 0.0002"


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "PASS"), (1.05, "FAIL"), (0.95, "FAIL"), (1.02, "UNDECIDED")])
def test_a_known_mass_judges_the_factor(practice: Path, monkeypatch, factor: float, verdict: str) -> None:
    """The mass that lies there is another one than the plan says, or none."""
    changed(practice, "check.toml", ("rest_s = 10.0", MASS))
    lying(monkeypatch, lambda opened: replace(opened, lay=lambda mass_kg: opened.lay(factor * mass_kg)))
    report, _ = checked(practice)
    found = named(report, "calibration holds")
    assert found.verdict == verdict, found
    assert found.value == pytest.approx(100 * (factor - 1.0), abs=0.05)
    # 0.1 % of the mass; noise, zero and form of the simulated cell are below 0.01 %
    assert found.sd == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("factor", [0.0, 0.1, 2.0])
def test_a_cell_that_does_not_feel_the_mass_moves_no_stage(practice: Path, monkeypatch, factor: float) -> None:
    """A dead cell, or a slope ten times too small, would let the stage press far beyond its limit."""
    changed(practice, "check.toml", ("rest_s = 10.0", MASS))
    lying(monkeypatch, lambda opened: replace(opened, lay=lambda mass_kg: opened.lay(factor * mass_kg)))
    report, status = checked(practice)
    assert status == 1
    assert (
        "N under the known mass, but the mass weighs 1.96 N, so a stage must not press with this load cell"
        in named(report, "load cell").evidence
    )
    assert "not tried" in named(report, "stage moves").evidence
    assert named(report, "calibration holds").verdict == "UNDECIDED"


def test_a_mass_of_the_calibration_passes_with_a_certificate_only(practice: Path) -> None:
    same = MASS.replace("0.2\n", "0.3\n")
    changed(practice, "check.toml", ("rest_s = 10.0", same))
    found = named(checked(practice)[0], "calibration holds")
    assert found.verdict == "UNDECIDED"
    assert "one of the masses that calibrated the cell" in found.evidence
    changed(practice, "check.toml", (same, f'{same}\ncertificate = "M 12"'))
    finray(f"check run {practice}/check.toml --rig {practice}/rig.toml --out {practice}/certified")
    report = read_record(practice / "certified/check.json", AcceptanceReport)
    assert named(report, "calibration holds").verdict == "PASS"
    assert "M 12" in named(report, "calibration holds").evidence


def test_a_light_mass_proves_little(practice: Path) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0", MASS.replace("0.2\n", "0.05\n").replace("0.0002", "0.00005")))
    found = named(checked(practice)[0], "calibration holds")
    assert (found.verdict, "less than 20 % of force_limit_n" in found.evidence) == ("UNDECIDED", True)


def test_a_mass_that_stays_on_the_cell_ends_all_that_moves(practice: Path, monkeypatch) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0", MASS))
    lying(monkeypatch, lambda opened: replace(opened, lay=lambda mass_kg: opened.lay(mass_kg) if mass_kg else None))
    report, status = checked(practice)
    assert status == 1
    assert "after the mass was taken off" in named(report, "load cell").evidence
    assert "not tried" in named(report, "stage moves").evidence


def test_a_mass_that_the_cell_cannot_bear_is_refused(practice: Path) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0", MASS.replace("0.2\n", "1.2\n")))
    outcome = finray(f"check run {practice}/check.toml --rig {practice}/rig.toml --out {practice}/out")
    assert outcome.status == 2
    assert re.search(r"mass_kg = 1\.2 kg weighs more than the 9\.8 N that the cell can bear", outcome.err)


ALL = """\
rest_s = 60.0
beside_mm = 4.0
mm_per_px = 0.0625
mm_per_px_u_rel = 0.002
[gauge_block]
thickness_mm = 3.0
uncertainty_mm = 0.005
[known_mass]
mass_kg = 0.2
uncertainty_kg = 0.0002
"""
"""The finger's camera has 320 px over 20 mm of the pad."""


def test_with_all_witnesses_only_play_stays_open(practice: Path) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL), ("stops = 1", "stops = 3"))
    report, status = checked(practice)
    assert {r.name for r in report.results if r.verdict != "PASS"} == {"press axis turns without play"}
    assert len(report.results) == 25
    assert status == 0
    for name in ("X goes as far as sent", "Z goes as far as sent", "calibration holds"):
        found = named(report, name)
        assert abs(found.value) < 2.0 * found.sd, found
    for one in report.facts.force_stops:
        moving = one.moving
        assert moving.limit_n < moving.stopped_at_n <= moving.peak_n + 3.0 * one.noise_n < moving.unstopped_n
        # the limit is halfway between the forces, and the pad stiffens a little
        assert 0.2 < abs(moving.end_mm - moving.stood_mm) / moving.way_mm < 0.6, moving
    evidence = named(report, "force stops the stage").evidence
    assert re.search(
        r"a reading of [\d.]+ N passed [\d.]+ N, the stage stood [\d.]+ mm before the end of the move", evidence
    )


@pytest.mark.parametrize(
    ("changed_field", "words"),
    [
        ({"stopped_at_n": None}, "a move ended without a reading beyond its limit"),
        ({"stood_mm": None}, "the position of the stage was unknown"),
        ({"stood_mm": "end"}, "went to its end"),
    ],
)
def test_a_stop_within_a_move_says_its_force_and_its_place(
    practice: Path, changed_field: dict[str, object], words: str
) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL.replace("60.0", "10.0", 1)), ("stops = 1", "stops = 3"))
    report, _ = checked(practice)
    assert named(report, "force stops the stage").verdict == "PASS"
    first, *others = report.facts.force_stops
    given = {name: first.moving.end_mm if value == "end" else value for name, value in changed_field.items()}
    spoilt = first.model_copy(update={"moving": first.moving.model_copy(update=given)})
    facts = report.facts.model_copy(update={"force_stops": (spoilt, *others)})
    found = named(judge_pressing(facts, report.plan, report.rig), "force stops the stage")
    assert (found.verdict, words in found.evidence) == ("UNDECIDED", True), found


def test_a_move_that_no_force_stops_fails(practice: Path, monkeypatch) -> None:
    """Between steps nothing is to be seen of it; the move ends where steps have led before, and no deeper."""
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL.replace("60.0", "10.0", 1)), ("stops = 1", "stops = 3"))
    strongest_n = [0.0]

    def deaf(opened: OpenTactileRig) -> OpenTactileRig:
        stage, cell = opened.stage, opened.load_cell

        def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            way_mm = to_mm - stage.places_mm()[axis]
            try:
                stage.move(axis, to_mm, speed_mm_per_s, watch)
            except ForceLimitError:
                if way_mm < -0.051:  # longer than a step, into the pad
                    stage.move(axis, to_mm, speed_mm_per_s, lambda: cell.read(0.5))
                raise

        def read(deadline_s: float):
            reading = cell.read(deadline_s)
            if opened.stage.state.load_kg == 0.0:
                strongest_n[0] = max(strongest_n[0], opened.stage.state.force_n())
            return reading

        return replace(opened, stage=Wrapped(stage, move=move), load_cell=Wrapped(cell, read=read))

    lying(monkeypatch, deaf)
    report, status = checked(practice)
    found = named(report, "force stops the stage")
    assert (found.verdict, status) == ("FAIL", 1), found
    assert strongest_n[0] < 1.4  # the stop between steps is tried at 1.25 N, the check's limit is 2.5 N


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass_kg = 0.2", "mass_kg = 0.3", "the check 'calibration holds' did not confirm"),
        ("stops = 3", "stops = 1", "1 stops are too few"),
        (
            "stops = 3",
            "stops = 3\nforce_limit_n = 0.6",
            "in some or all tries the move was too short",
        ),
    ],
)
def test_a_stop_within_a_move_needs_room_repeats_and_a_cell_that_is_right(
    practice: Path, old: str, new: str, words: str
) -> None:
    plan = ALL.replace("60.0", "10.0", 1)
    changed(practice, "check.toml", ("rest_s = 10.0\n", plan), ("stops = 1", "stops = 3"))
    changed(practice, "check.toml", (old, new))
    found = named(checked(practice)[0], "force stops the stage")
    assert found.verdict == "UNDECIDED"
    assert words in found.evidence, found.evidence


def too_far(axis: str, factor: float):
    """Return a spoiler: the stage goes farther along an axis than it counts."""

    def spoil(opened: OpenTactileRig) -> OpenTactileRig:
        stage = opened.stage

        def move(one: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            scale = factor if one == axis else 1.0
            stage.move(one, scale * to_mm, speed_mm_per_s, watch)

        def places_mm() -> dict[str, float] | None:
            true = stage.places_mm()
            return None if true is None else {**true, axis: true[axis] / factor}

        return replace(opened, stage=Wrapped(stage, move=move, places_mm=places_mm))

    return spoil


def camera(expose: Callable[[Callable[..., RawFrame], list[RawFrame]], RawFrame]):
    """Return a spoiler: the camera's frames are others."""

    def spoil(opened: OpenTactileRig) -> OpenTactileRig:
        taken: list[RawFrame] = []

        def changed_frame(exposure_s: float, deadline_s: float) -> RawFrame:
            return expose(lambda: opened.camera.expose(exposure_s, deadline_s), taken)

        return replace(opened, camera=Wrapped(opened.camera, expose=changed_frame))

    return spoil


def one_frame(true: Callable[[], RawFrame], taken: list[RawFrame]) -> RawFrame:
    """Repeat the first frame for ever."""
    taken.append(true())
    return taken[0]


def every_fourth(true: Callable[[], RawFrame], taken: list[RawFrame]) -> RawFrame:
    """Repeat each frame three times, so that a stack has no noise."""
    taken.append(true())
    return taken[(len(taken) - 1) // 4 * 4]


def capped(true: Callable[[], RawFrame], taken: list[RawFrame]) -> RawFrame:
    """Show darkness with noise."""
    frame = true()
    noise = np.random.default_rng(len(taken)).normal(16.0, 1.5, frame.counts.shape)
    taken.append(frame)
    return replace(frame, counts=np.clip(noise.round(), 0, 1023).astype(np.uint16))


@pytest.mark.parametrize(
    ("spoil", "name", "verdict"),
    [
        (too_far("X", 1.02), "X goes as far as sent", "FAIL"),
        (too_far("X", 0.98), "X goes as far as sent", "FAIL"),
        (too_far("Z", 1.02), "Z goes as far as sent", "FAIL"),
        (too_far("Z", 0.98), "Z goes as far as sent", "FAIL"),
        (still_pad_axis, "X goes as far as sent", "UNDECIDED"),
        (camera(one_frame), "X goes as far as sent", "UNDECIDED"),
        (camera(every_fourth), "X goes as far as sent", "UNDECIDED"),
        (camera(capped), "X goes as far as sent", "UNDECIDED"),
        (lambda opened: replace(opened, lay_block=lambda mm: True), "Z goes as far as sent", "UNDECIDED"),
        (lambda opened: replace(opened, lay_block=lambda mm: False), "Z goes as far as sent", "UNDECIDED"),
        (lambda opened: replace(opened, lay_block=lambda mm: opened.lay_block(0.95 * mm)), "Z goes as far as sent",
         "FAIL"),
    ],
    ids=["X too far", "X too short", "Z too far", "Z too short", "X stays", "one frame", "repeats", "lens cap",
         "no block", "nobody", "other block"],
)  # fmt: skip
def test_a_stage_that_goes_otherwise_than_it_counts(practice: Path, monkeypatch, spoil, name, verdict) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL.replace("60.0", "10.0", 1)))
    lying(monkeypatch, spoil)
    report, _ = checked(practice)
    found = named(report, name)
    assert found.verdict == verdict, found
    assert named(report, f"{name[0]} reports its position").verdict == "UNDECIDED"


def test_a_block_that_nobody_takes_away_ends_all_moves(practice: Path, monkeypatch) -> None:
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL.replace("60.0", "10.0", 1)))
    moved_after: list[str] = []
    refused: list[float] = []

    def kept(opened: OpenTactileRig) -> OpenTactileRig:
        def lay_block(thickness_mm: float) -> bool:
            if thickness_mm == 0.0:
                refused.append(thickness_mm)
                return False
            return opened.lay_block(thickness_mm)

        def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            if refused:
                moved_after.append(axis)
            opened.stage.move(axis, to_mm, speed_mm_per_s, watch)

        return replace(opened, lay_block=lay_block, stage=Wrapped(opened.stage, move=move))

    lying(monkeypatch, kept)
    report, status = checked(practice)
    assert (len(refused), moved_after, status) == (1, [], 1)
    assert "nobody has confirmed that the block was taken off" in named(report, "touches").evidence
    assert "nobody confirmed that the stage may move" in named(report, "devices come back").evidence
    assert named(report, "Z goes as far as sent").verdict == "PASS"  # what was measured before stays


def test_a_block_that_is_touched_behind_the_pad_fails(practice: Path) -> None:
    """A direction that is the wrong way round has the right length."""
    changed(practice, "check.toml", ("rest_s = 10.0\n", ALL.replace("60.0", "10.0", 1)))
    report, _ = checked(practice)
    assert named(report, "Z goes as far as sent").verdict == "PASS"
    block = report.facts.block
    behind = block.model_copy(update={"pad_mm": block.block_mm, "block_mm": block.pad_mm})
    facts = report.facts.model_copy(update={"block": behind})
    found = named(judge_pressing(facts, report.plan, report.rig), "Z goes as far as sent")
    assert found.verdict == "FAIL"
    assert found.value == pytest.approx(-200.0, abs=1.0)


def test_a_block_without_room_is_refused(practice: Path) -> None:
    thick = ALL.replace("60.0", "10.0", 1).replace("thickness_mm = 3.0", "thickness_mm = 5.8")
    changed(practice, "check.toml", ("rest_s = 10.0\n", thick))
    report, _ = checked(practice)
    assert re.search(r"leaves only 0\.(19[5-9]|2|20[0-5]) mm below clear_mm", named(report, "touches").evidence)


def test_a_stage_that_creeps_on_after_it_reports_its_stop_fails(practice: Path, monkeypatch) -> None:
    """It says that it stands, and drives on: the controller's word alone would pass."""

    def creeping(opened: OpenTactileRig) -> OpenTactileRig:
        stage, state = opened.stage, opened.stage.state

        def move(axis: str, to_mm: float, speed_mm_per_s: float, watch: Callable[[], None]) -> None:
            state.moving = None
            try:
                stage.move(axis, to_mm, speed_mm_per_s, watch)
            except BaseException:
                begun_mm, began_s = state.counted_mm[axis], state.clock.elapsed_s
                told.append(begun_mm)

                def on() -> None:
                    state.counted_mm[axis] = begun_mm + speed_mm_per_s * (state.clock.elapsed_s - began_s)

                state.moving = on
                raise

        def places_mm() -> dict[str, float] | None:
            true = stage.places_mm()
            return true if state.moving is None or true is None else {**true, "Z": told[-1]}

        told: list[float] = []
        return replace(opened, stage=Wrapped(stage, move=move, places_mm=places_mm))

    changed(practice, "check.toml", ("rest_s = 10.0\n", "rest_s = 10.0\n[limits]\nhalt_s = 0.5\n"))
    lying(monkeypatch, creeping)
    report, _ = checked(practice)
    assert named(report, "stage stops on request").verdict == "FAIL"
    assert named(report, "stage stops at a silent cell").verdict in ("FAIL", "UNDECIDED")


RATE_HZ = 80.0
TIMES_S = np.arange(240) / RATE_HZ


@pytest.mark.parametrize(
    ("stands_s", "drives", "expected"),
    [(1.1, 0.0, 0.1), (1.5, 0.0, 0.5), (3.0, 0.0, 2.0), (1.1, 1.0, None)],
    ids=["soon", "late", "never", "left the pad"],
)
def test_when_the_force_falls_no_more(stands_s: float, drives: float, expected: float | None) -> None:
    """A force that falls by 0.1 N/s until the stage stands; asked at 1 s."""
    forces_n = 0.5 - 0.1 * np.minimum(TIMES_S, stands_s)
    forces_n = np.where(TIMES_S > 2.0, forces_n * (1.0 - drives), forces_n)
    forces_n = forces_n + 3e-4 * np.random.default_rng(4).standard_normal(TIMES_S.size)
    found = still_after(TIMES_S, forces_n, 1.0, 3e-4, RATE_HZ)
    if expected is None:
        assert found is None
        return
    value_s, sd_s, creep_rel = found
    assert abs(value_s - expected) < 2.0 * sd_s
    assert 0.05 < sd_s < 0.2
    assert 0.0 < creep_rel < 0.2 or stands_s == 3.0


LISTENED_S = np.arange(round((1.0 + 5.0) * RATE_HZ)) / RATE_HZ
"""A move of 1 s, then the 1 s that a stage may need to stop and the 4 s beyond that the check listens."""


@pytest.mark.parametrize("share", [0.5, 0.9, 1.3, 2.0, 5.0])
def test_a_creep_beyond_what_the_row_says_is_felt(share: float) -> None:
    """The stage stops 0.1 s after it was asked, and creeps on at a share of the speed that stays unseen."""
    noise_n = 3e-4 * np.random.default_rng(6).standard_normal(LISTENED_S.size)

    def force_n(creep_rel: float) -> np.ndarray:
        after_s = np.maximum(LISTENED_S - 1.1, 0.0)
        return 0.5 - 0.1 * (np.minimum(LISTENED_S, 1.1) + creep_rel * after_s) + noise_n

    stands = still_after(LISTENED_S, force_n(0.0), 1.0, 3e-4, RATE_HZ)
    assert stands is not None
    unseen_rel = stands[2]
    assert unseen_rel < 0.025
    creeps = still_after(LISTENED_S, force_n(share * unseen_rel), 1.0, 3e-4, RATE_HZ)
    assert creeps is not None
    later_s = creeps[0] - stands[0]
    assert later_s < 0.1 if share < 1.0 else later_s > 0.5


def test_a_force_that_never_fell_tells_nothing() -> None:
    forces_n = 0.5 + 3e-4 * np.random.default_rng(5).standard_normal(TIMES_S.size)
    assert still_after(TIMES_S, forces_n, 1.0, 3e-4, RATE_HZ) is None


@pytest.mark.parametrize("bad", ["0.0", "-0.1", "inf", "nan", "1e9"])
def test_limits_that_mean_nothing_are_refused(bad: str) -> None:
    for limits in (PressLimits, type(CheckPlan.model_fields["limits"].default)):
        for name in limits.model_fields:
            with pytest.raises(ValidationError, match=name):
                limits.model_validate({name: float(bad)})
