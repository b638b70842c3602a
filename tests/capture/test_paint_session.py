import json
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    CaptureError,
    CaptureSession,
    ChecksumError,
    DeviceIdentity,
    Frame,
    PaintPlan,
    RecordError,
    RigFile,
    SaturatedError,
    Target,
    WrongPositionError,
    bayer_planes,
)
from data_schemas.storage import sha256_of
from rigs import Camera, FilterWheel, OpenRig, Operator, RawFrame, open_rig
from rigs.capture import SessionRequest, capture_paint_session, paint_steps, read_frame_of, read_session
from rigs.capture._journal import read_journal
from rigs.capture._paint_session import capture_with

Captured = tuple[Path, CaptureSession, list[tuple[int, int, str]]]


def region_of(counts: np.ndarray, plan: PaintPlan) -> np.ndarray:
    r = plan.region
    return counts[r.row_px : r.row_px + r.height_px, r.column_px : r.column_px + r.width_px]


def test_every_step_is_stored_at_every_exposure(captured: Captured) -> None:
    _, session, _ = captured
    number = Counter(frame.frame_type for frame in session.frames)
    assert {k: n for k, n in number.items() if k != "dark"} == {
        "white": 16,
        "laser white": 2,
        "reflectance": 16,
        "fluorescence": 16,
        "fluorescence repeat": 2,
        "room light": 2,
    }
    assert [f.sequence for f in session.frames] == list(range(len(session.frames)))
    assert 70 <= len(session.frames) <= 95


def test_darks_stand_before_and_after_for_every_exposure_used(captured: Captured) -> None:
    _, session, _ = captured
    kinds = [f.frame_type == "dark" for f in session.frames]
    first, last = kinds.index(False), len(kinds) - kinds[::-1].index(False)
    before, after = session.frames[:first], session.frames[last:]
    used = {f.exposure_s for f in session.frames[first:last]}
    assert not any(kinds[first:last])
    assert [f.exposure_s for f in before] == [f.exposure_s for f in after] == sorted(used)
    assert all(f.light == "off" and f.filter_name is None for f in before + after)


def test_all_checksums_verify_and_the_manifest_lists_every_file(captured: Captured) -> None:
    out, session, _ = captured
    lines = (out / "manifest-sha256.txt").read_text().splitlines()
    manifest = {name: digest for digest, name in (line.split("  ") for line in lines)}
    stored = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()} - {"manifest-sha256.txt"}
    assert set(manifest) == stored
    assert all(sha256_of(out / name) == digest for name, digest in manifest.items())
    assert {f.file: f.sha256 for f in session.frames}.items() <= manifest.items()


def test_nothing_in_the_region_saturates_and_the_metered_frames_are_bright(captured: Captured, plan: PaintPlan) -> None:
    out, session, _ = captured
    for frame in session.frames:
        assert frame.saturated_fraction == 0.0
        assert region_of(read_frame_of(out, frame), plan).max() < 1023
    white = [f for f in session.frames if f.frame_type in {"white", "laser white"}]
    for longest, shorter in zip(white[::2], white[1::2], strict=True):
        assert shorter.exposure_s == pytest.approx(longest.exposure_s / 4)
        # a ladder of factors of two leaves between half of the target and all of it above the black level
        peak = region_of(read_frame_of(out, longest), plan).max()
        assert 0.5 * 0.7 * (1023 - 16) < peak < 0.75 * 1023


def test_wheel_position_is_stored_before_and_after(captured: Captured) -> None:
    _, session, _ = captured
    slots = {f.name: f.slot for f in session.rig.filter_wheel.filters}
    for frame in session.frames:
        assert frame.slot_before == frame.slot_after
        if frame.frame_type == "room light":
            assert frame.slot_before is None
        if frame.filter_name is not None:
            assert frame.slot_before == slots[frame.filter_name]


def test_signal_grows_with_exposure(captured: Captured, plan: PaintPlan) -> None:
    out, session, _ = captured
    pair = [f for f in session.frames if f.frame_type == "white" and f.filter_name == "600"]
    signal = [bayer_planes(region_of(read_frame_of(out, f), plan))[..., 0].mean() - 16.0 for f in pair]
    # the lamp repeats within 0.2 % (3 standard deviations of a ratio: 0.85 %); the dark level adds below 0.3 DN of 100
    assert signal[0] / signal[1] == pytest.approx(pair[0].exposure_s / pair[1].exposure_s, rel=0.012)


def test_fluorescence_appears_where_the_paint_emits(captured: Captured, plan: PaintPlan) -> None:
    out, session, _ = captured

    def rate(kind: str, name: str) -> float:
        frame = next(f for f in session.frames if f.frame_type == kind and f.filter_name == name)
        planes = bayer_planes(region_of(read_frame_of(out, frame), plan)) - 16.0
        return float(planes.mean((0, 1)).sum()) / frame.exposure_s

    emitted = {name: rate("fluorescence", name) / rate("white", name) for name in ("500", "600", "660")}
    assert emitted["600"] > 3 * emitted["660"]
    assert emitted["600"] > 10 * emitted["500"]


def test_brightest_emission_is_captured_first_and_again_at_the_end(captured: Captured) -> None:
    _, session, _ = captured
    laser = [f for f in session.frames if f.frame_type in {"fluorescence", "fluorescence repeat"}]
    assert [f.filter_name for f in laser[:2]] == [f.filter_name for f in laser[-2:]] == ["600", "600"]
    assert [f.frame_type == "fluorescence repeat" for f in laser] == [False] * 16 + [True] * 2
    assert [f.exposure_s for f in laser[:2]] == [f.exposure_s for f in laser[-2:]]
    assert [f.filter_name for f in laser[2:16:2]] == ["405", "450", "500", "532", "560", "630", "660"]


def test_laser_dose_is_power_times_time_on_the_sample(captured: Captured, rig: RigFile) -> None:
    out, session, _ = captured
    laser = [f for f in session.frames if f.frame_type in {"fluorescence", "fluorescence repeat"}]
    power_w = 1e-3 * rig.laser.power_mw
    for first, later in pairwise(laser):  # the laser stays on from the first of them to the last
        spent_j = power_w * (later.middle_s - first.middle_s)
        assert later.laser_dose_j - first.laser_dose_j == pytest.approx(spent_j, rel=1e-9)
    on_tile = [f.laser_dose_j for f in session.frames if f.frame_type in {"white", "laser white", "reflectance"}]
    assert len(set(on_tile)) == 1
    assert on_tile[0] > 0.0  # metering counts
    assert laser[0].laser_dose_j > on_tile[0]
    events = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    switches = [e for e in events if e["event"].startswith("laser")]
    shone = [
        (off["target"], off["sample_dose_j"] - on["sample_dose_j"], off["monotonic_s"] - on["monotonic_s"])
        for on, off in zip(switches[::2], switches[1::2], strict=True)
    ]
    for target, dose_j, time_s in shone:
        expected_j = power_w * time_s if target == "sample" else 0.0
        assert dose_j == pytest.approx(expected_j, abs=power_w * 1e-3)  # the journal rounds to milliseconds
    assert switches[-1]["sample_dose_j"] >= laser[-1].laser_dose_j


def test_sample_is_tilted_when_the_plan_asks_for_it(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    tilt = {"second_tilt_deg": 30.0, "second_tilt_filters": ("450", "600")}
    small = {"filters": ("450", "600"), "bracket": (1.0,), "darks_per_exposure": 1}
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, plan.model_copy(update=tilt | small), tmp_path)
    tilted = [f for f in session.frames if f.frame_type == "tilted fluorescence"]
    assert [(f.filter_name, f.tilt_deg) for f in tilted] == [("450", 30.0), ("600", 30.0)]
    assert {f.tilt_deg for f in session.frames if f.frame_type != "tilted fluorescence"} == {0.0, 30.0}
    assert all(f.tilt_deg == 0.0 for f in session.frames if f.light != "off" and f not in tilted)
    flat = {f.filter_name: f for f in session.frames if f.frame_type == "fluorescence"}
    for f in tilted:
        counts = [region_of(read_frame_of(tmp_path, x), plan).astype(float) - 16.0 for x in (flat[f.filter_name], f)]
        ratio = counts[1].sum() / f.exposure_s / (counts[0].sum() / flat[f.filter_name].exposure_s)
        # laser 0.3 % (two frames of 0.2 %), photon noise of 784 px of some 1 % each, dark current below 0.1 DN of 100
        assert ratio == pytest.approx(np.cos(np.radians(30.0)), rel=0.02)


def test_session_behind_the_laser_filter_alone_has_no_repeat(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    small = plan.model_copy(update={"filters": ("450",), "bracket": (1.0,), "darks_per_exposure": 1})
    with open_rig(rig, Path()) as opened:
        session = capture(opened, rig, small, tmp_path)
    assert "fluorescence repeat" not in {f.frame_type for f in session.frames}


def test_stored_session_reads_back_equal(captured: Captured) -> None:
    out, session, _ = captured
    stored = read_session(out)
    assert stored.frames == session.frames
    assert stored.plan == session.plan
    assert stored.provenance is not None
    assert stored.provenance.command == "finray capture"
    assert stored.provenance.seed == 1
    np.testing.assert_array_equal(stored.lamp.values, session.lamp.values)


def test_journal_tells_start_steps_frames_and_stop(captured: Captured) -> None:
    out, session, _ = captured
    events = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    count = Counter(e["event"] for e in events)
    switches = {"laser on": 4, "laser off": 4}  # tile and sample, metered and captured
    once = dict.fromkeys(("start", "filter proof", "frames proven", "session", "stop"), 1)
    assert count == once | {"step": 26, "frame": len(session.frames)} | switches
    assert events[0]["event"] == "start"
    assert (events[-1]["event"], events[-1]["outcome"]) == ("stop", "done")
    times = [e["monotonic_s"] for e in events]
    assert times == sorted(times)


def test_progress_counts_up_within_each_phase(captured: Captured) -> None:
    _, _, calls = captured
    # long exposures are told beside them, as "metering fluorescence (sample, laser) through filter 450: 4 s"
    phases = {text.split(":")[0] for _, _, text in calls if "through filter" not in text.split(":")[0]}
    assert phases == {
        "metering",
        "dark frames before",
        "frames",
        "dark frames after",
        "check of the dark frames in light",
    }
    for phase in phases:
        counts = [(done, total) for done, total, text in calls if text.startswith(f"{phase}:")]
        assert counts == [(n + 1, len(counts)) for n in range(len(counts))]


# Faults: each fake wraps a simulated device and misbehaves once.


@dataclass
class FaultyCamera:
    camera: Camera
    fault: str
    after: int
    taken: int = 0

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        self.taken += 1
        frame = self.camera.expose(exposure_s, deadline_s)
        if self.taken <= self.after:
            return frame
        if self.fault == "lost":
            raise CaptureError("camera: connection lost")
        if self.fault == "exposure":
            return replace(frame, exposure_s=0.5 * frame.exposure_s)
        return replace(frame, counts=frame.counts[:-2])


@dataclass
class SlippingWheel:
    wheel: FilterWheel
    slips_at_reading: int
    readings: int = 0

    @property
    def slots(self) -> tuple[int, ...]:
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self) -> int | None:
        self.readings += 1
        position = self.wheel.position()
        return 7 if self.readings >= self.slips_at_reading and position is not None else position

    def go_to(self, slot: int, deadline_s: float) -> None:
        self.wheel.go_to(slot, deadline_s)


class StuckLight:
    def __init__(self, on: bool):
        self.on = on

    def identity(self) -> DeviceIdentity:
        return DeviceIdentity(role="laser", driver="stuck")

    def state(self) -> bool:
        return self.on

    @contextmanager
    def lit(self) -> Iterator[None]:
        yield


def capture(opened: OpenRig, rig: RigFile, plan: PaintPlan, out: Path) -> CaptureSession:
    return capture_with(opened, rig, plan, paint_steps(plan, rig), SessionRequest(out, "finray capture"))


def last_event(out: Path) -> dict[str, object]:
    return dict(read_journal(out)[-1])


@pytest.mark.parametrize("after", [3, 12, 70])  # while metering with the laser, with the lamp, and while storing
def test_lights_go_off_when_the_camera_fails_in_the_middle(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, after: int
) -> None:
    with open_rig(rig, Path()) as opened:
        broken = replace(opened, camera=FaultyCamera(opened.camera, "lost", after))
        with pytest.raises(CaptureError, match="connection lost") as failure:
            capture(broken, rig, plan, tmp_path / "out")
        # the traceback is still alive here: a light must not wait for the garbage collector
        assert failure.tb is not None
        assert not opened.lamp.state()
        assert not opened.laser.state()
    assert last_event(tmp_path / "out")["outcome"] == "CaptureError: camera: connection lost"
    with pytest.raises(RecordError, match=r"was not finished \(session\.json is missing\)"):
        read_session(tmp_path / "out")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (
            "exposure",
            r"s was requested for fluorescence .* the camera reads back .* \(a difference of up to 5 % is allowed\)",
        ),
        ("shape", r"frame of 126 x 160 px, but the rig file states 128 x 160 px"),
    ],
)
def test_frame_that_is_not_what_was_asked_is_refused(
    rig: RigFile, plan: PaintPlan, tmp_path: Path, fault: str, message: str
) -> None:
    with open_rig(rig, Path()) as opened, pytest.raises(CaptureError, match=message):
        capture(replace(opened, camera=FaultyCamera(opened.camera, fault, 0)), rig, plan, tmp_path)


# readings: 1 decides whether to move, 2 is before the exposure, 3 after it
@pytest.mark.parametrize(("reading", "when"), [(2, "before"), (3, "after")])
def test_wheel_that_slips_is_noticed(rig: RigFile, plan: PaintPlan, tmp_path: Path, reading: int, when: str) -> None:
    """It is sent again; a wheel that slips every time ends the session."""
    with (
        open_rig(rig, Path()) as opened,
        pytest.raises(WrongPositionError, match=r"reports slot 7 before the exposure .*slot 8 is needed.*4 attempts"),
    ):
        capture(replace(opened, wheel=SlippingWheel(opened.wheel, reading)), rig, plan, tmp_path)
    refused = [line["text"] for line in read_journal(tmp_path) if line["event"] == "refused"]
    assert len(refused) == 3
    assert f"reports slot 7 {when} the exposure of" in refused[0]


def test_light_that_does_not_obey_is_noticed(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    with open_rig(rig, Path()) as opened:
        with pytest.raises(CaptureError, match=r"laser: reports that it is off, but this step needs the state 'laser'"):
            capture(replace(opened, laser=StuckLight(on=False)), rig, plan, tmp_path / "a")
        with pytest.raises(CaptureError, match=r"lamp: reports that it is on, but this step needs the state 'laser'"):
            capture(replace(opened, lamp=StuckLight(on=True)), rig, plan, tmp_path / "b")


@dataclass
class CountingOperator:
    inner: Operator
    placed: Target = "sample"
    swaps: int = 0

    def place(self, target: Target) -> None:
        self.swaps += target != self.placed
        self.placed = target
        self.inner.place(target)


def test_operator_swaps_the_target_four_times(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    with open_rig(rig, Path()) as opened:
        opened.operator.place("sample")
        operator = CountingOperator(opened.operator)
        small = plan.model_copy(update={"filters": ("450",), "bracket": (1.0,), "darks_per_exposure": 1})
        capture(replace(opened, operator=operator), rig, small, tmp_path)
        assert operator.swaps == 4


def test_second_capture_into_the_same_folder_is_refused(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_text("{}\n")
    with open_rig(rig, Path()) as opened, pytest.raises(CaptureError, match=r"journal\.jsonl: exists already.*--out"):
        capture(opened, rig, plan, tmp_path)
    assert (tmp_path / "journal.jsonl").read_text() == "{}\n"


def test_too_bright_light_names_filter_and_limits(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    slow = rig.model_copy(
        update={"camera": rig.camera.model_copy(update={"shortest_exposure_s": 0.01, "longest_exposure_s": 0.1})}
    )
    with pytest.raises(
        SaturatedError, match=r"reflectance \(sample, lamp\) through filter 660.*allows 0\.01 to 0\.08 s"
    ):
        capture_paint_session(slow, plan, SessionRequest(tmp_path, "finray capture"))


def test_folder_that_is_not_empty_is_refused(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(CaptureError, match=r"is not an empty folder"):
        capture_paint_session(rig, plan, SessionRequest(tmp_path, "finray capture"))
    with pytest.raises(CaptureError, match=r"is not an empty folder"):
        capture_paint_session(rig, plan, SessionRequest(tmp_path / "note.txt", "finray capture"))
    assert [p.name for p in tmp_path.iterdir()] == ["note.txt"]


def test_curve_files_are_hashed_and_notes_kept(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    rows = [f"{x},30,40,50" for x in range(400, 701)]
    file = tmp_path / "camera.csv"
    file.write_text("wavelength_nm,red_percent,green_percent,blue_percent\n" + "\n".join(rows) + "\n")
    measured = rig.model_copy(update={"camera": rig.camera.model_copy(update={"response": "camera.csv"})})
    small = plan.model_copy(update={"filters": ("450",), "bracket": (1.0,), "darks_per_exposure": 1})
    capture_paint_session(measured, small, SessionRequest(tmp_path / "out", "finray capture", rig_folder=tmp_path))
    stored = read_session(tmp_path / "out")
    assert stored.provenance is not None
    assert stored.provenance.input_sha256 == {"camera.csv": sha256_of(file)}
    assert "filter 405" in stored.notes[0]
    assert '"event": "note"' in (tmp_path / "out" / "journal.jsonl").read_text()


def test_reading_what_is_no_session_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"contains no capture session"):
        read_session(tmp_path)
    with pytest.raises(RecordError, match=r"no such folder"):
        read_session(tmp_path / "nowhere")


def test_frame_that_was_changed_or_leads_outside_is_refused(captured: Captured, tmp_path: Path) -> None:
    out, session, _ = captured
    frame = session.frames[0]
    (tmp_path / "in" / "frames").mkdir(parents=True)
    copy = tmp_path / "in" / frame.file
    content = (out / frame.file).read_bytes()
    copy.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(ChecksumError, match="SHA-256 differs"):
        read_frame_of(tmp_path / "in", frame)
    copy.unlink()
    copy.symlink_to(out / frame.file)
    with pytest.raises(RecordError, match="points outside the session's folder"):
        read_frame_of(tmp_path / "in", frame)


def test_file_names_are_plain(captured: Captured) -> None:
    _, session, _ = captured
    pattern = re.compile(
        r"frames/\d{4}_(dark|white|laser-white|room-light|reflectance|fluorescence(-repeat)?)_(none|\d+)_\d+us\.tiff"
    )
    frames: tuple[Frame, ...] = session.frames
    assert all(pattern.fullmatch(frame.file) for frame in frames)


@dataclass
class HandTurnedWheel:
    """Remembers which lights were on when it was turned."""

    wheel: FilterWheel
    opened: OpenRig
    lit_while_turned: list[bool] = field(default_factory=list)

    @property
    def slots(self) -> tuple[int, ...]:
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self) -> int | None:
        return self.wheel.position()

    def go_to(self, slot: int, deadline_s: float) -> None:
        self.lit_while_turned.append(self.opened.laser.state() or self.opened.lamp.state())
        self.wheel.go_to(slot, deadline_s)


def test_wheel_turned_by_hand_is_turned_in_the_dark(rig: RigFile, plan: PaintPlan, tmp_path: Path) -> None:
    real = {"camera": "aravis", "filter_wheel": "manual", "laser": "arduino", "lamp": "manual"}
    named = {
        name: getattr(rig, name).model_copy(update={"driver": driver, "address": "" if driver == "manual" else "here"})
        for name, driver in real.items()
    }
    by_hand = rig.model_copy(update=named)
    small = plan.model_copy(update={"filters": ("450", "600"), "bracket": (1.0,), "darks_per_exposure": 1})
    with open_rig(rig, Path()) as opened:
        wheel = HandTurnedWheel(opened.wheel, opened)
        capture(replace(opened, wheel=wheel), by_hand, small, tmp_path)
    assert len(wheel.lit_while_turned) > 4
    assert not any(wheel.lit_while_turned)
