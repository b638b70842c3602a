"""A camera session on the simulated rig: what is stored, what is refused, and the sensor that comes back out of it."""

import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import (
    CameraPlan,
    CameraSession,
    CaptureError,
    DeviceIdentity,
    RecordError,
    RegionOfInterest,
    RigFile,
    SaturatedError,
)
from data_schemas.storage import sha256_of
from finray_calib.radiometry import characterise_camera
from rigs import Camera, RawFrame, open_rig, paint_plan, simulated_rig
from rigs._open_rig import DARK_CURRENT_E_PER_S, DARK_OFFSET_SD_E, FULL_WELL_MARGIN, PIXEL_NONUNIFORMITY_REL
from rigs.capture import (
    SessionRequest,
    camera_step,
    capture_camera_session,
    capture_paint_session,
    read_camera_session,
    read_frame_of,
    read_session,
    session_kind,
)
from rigs.capture._camera_session import (
    camera_times,
    capture_camera_with,
    level_exposures_s,
    level_notes,
    saturation_exposures_s,
)
from rigs.capture._journal import LEAST_HEALING_S, HealingTimeError
from rigs.transports import Fault, report_fault
from tests.command_line.running import finray, succeed

SIDE_PX = 72
PLAN = CameraPlan(
    camera_name="demo camera",
    filter_name="532",
    region=RegionOfInterest(row_px=92, column_px=124, height_px=SIDE_PX, width_px=SIDE_PX),
    repeats=6,
)
TOML = f"""kind = "camera"
camera_name = "demo camera"
filter_name = "532"
repeats = 0
[region]
row_px = 92
column_px = 124
height_px = {SIDE_PX}
width_px = {SIDE_PX}
"""
Captured = tuple[Path, CameraSession, list[tuple[int, int, str]]]


@pytest.fixture(scope="module")
def rig() -> RigFile:
    return simulated_rig("red", width_px=320, height_px=256)


@pytest.fixture(scope="module")
def captured(rig: RigFile, tmp_path_factory: pytest.TempPathFactory) -> Captured:
    out = tmp_path_factory.mktemp("session") / "camera"
    calls: list[tuple[int, int, str]] = []
    session = capture_camera_session(
        rig, PLAN, SessionRequest(out, "finray capture", progress=lambda *call: calls.append(call))
    )
    return out, session, calls


def changed(**fields: object) -> CameraPlan:
    return CameraPlan.model_validate({**PLAN.model_dump(), **fields})


def test_every_flat_exposure_has_its_darks_and_one_level_is_repeated(captured: Captured) -> None:
    _, session, _ = captured
    number = {kind: Counter(f.exposure_s for f in session.frames if f.frame_type == kind) for kind in ("white", "dark")}
    longest = {PLAN.longest_exposure_s: 2}
    assert number["dark"] == number["white"] | longest
    assert sorted(number["white"].values()) == [2] * (len(number["white"]) - 1) + [2 + PLAN.repeats]
    assert 12 <= len(number["white"]) <= 36
    assert {(f.target, f.filter_name) for f in session.frames} == {("white", "532")}
    assert {(f.frame_type, f.light) for f in session.frames} == {("white", "lamp"), ("dark", "off")}
    assert all(f.slot_before == f.slot_after == 4 for f in session.frames)


@pytest.mark.parametrize("share", [0.3, 0.4, 0.5])
def test_a_sensor_that_stops_below_full_scale_is_told_from_light_that_changed(
    tmp_path: Path, monkeypatch, share
) -> None:
    """It was refused for a wheel that slipped; a lamp that dims by half is refused as before."""
    rig = simulated_rig("red", width_px=320, height_px=256)
    monkeypatch.setattr("rigs._open_rig.FULL_WELL_MARGIN", share)
    with pytest.raises(
        CaptureError,
        match=r"counts stop at \d+ DN, below full scale \(1023 DN\)\. .*check bit_depth, or raise the gain",
    ) as told:
        capture_camera_session(rig, PLAN, SessionRequest(tmp_path / "s", "pytest"))
    stops_dn = int(str(told.value).partition("counts stop at ")[2].partition(" ")[0])
    assert stops_dn == pytest.approx(share * 1024 + rig.camera.black_level_dn, rel=0.1)


def test_a_lamp_that_dims_during_metering_is_no_sensor_that_stops(tmp_path: Path) -> None:
    rig = simulated_rig("red", width_px=320, height_px=256)

    @dataclass
    class Dimming:
        camera: Camera
        seen: bool = False

        def identity(self) -> DeviceIdentity:
            return self.camera.identity()

        def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
            raw = self.camera.expose(exposure_s, deadline_s)
            black_dn = rig.camera.black_level_dn
            signal = raw.counts.astype(float) - black_dn
            if self.seen:
                return replace(raw, counts=np.round(0.5 * signal + black_dn).clip(0).astype(np.uint16))
            self.seen = bool(signal.mean() > 0.1 * 1023)
            return raw

    with open_rig(rig, Path()) as opened, pytest.raises(CaptureError, match="the wheel slipped, the light changed"):
        capture_camera_with(
            replace(opened, camera=Dimming(opened.camera)),
            rig,
            PLAN,
            camera_step(PLAN, rig),
            SessionRequest(tmp_path / "s", "pytest"),
        )


def test_levels_go_up_and_down_so_that_lamp_drift_cancels(captured: Captured) -> None:
    _, session, _ = captured
    flats = [f.exposure_s for f in session.frames if f.frame_type == "white"][: -PLAN.repeats]
    up = flats[: len(flats) // 2]
    assert up == sorted(up)
    assert flats == up + up[::-1]


def test_levels_reach_from_dark_to_beyond_saturation_of_every_channel(captured: Captured) -> None:
    out, session, _ = captured
    longest = max((f for f in session.frames if f.frame_type == "white"), key=lambda f: f.exposure_s)
    region = read_frame_of(out, longest)[92 : 92 + SIDE_PX, 124 : 124 + SIDE_PX]
    assert all(np.mean(region[i::2, j::2] == 1023) > 0.9 for i in (0, 1) for j in (0, 1))
    shortest = min((f for f in session.frames if f.frame_type == "white"), key=lambda f: f.exposure_s)
    assert read_frame_of(out, shortest)[92 : 92 + SIDE_PX, 124 : 124 + SIDE_PX].mean() < 16 + 0.12 * 1007


def test_characterisation_finds_the_simulated_sensor(captured: Captured, rig: RigFile) -> None:
    out, session, _ = captured
    found = characterise_camera(session, lambda frame: read_frame_of(out, frame))
    for c in found.channels:
        for estimate, truth in (
            (c.gain_e_per_dn, rig.camera.gain_e_per_dn),
            (c.read_noise_e, rig.camera.read_noise_e),
            (c.black_level_dn, rig.camera.black_level_dn),
            (c.dark_current_e_per_s, DARK_CURRENT_E_PER_S),
            (c.dsnu_dn, DARK_OFFSET_SD_E / rig.camera.gain_e_per_dn),
            (c.prnu_rel, PIXEL_NONUNIFORMITY_REL),
        ):
            # five standard deviations: a false alarm in 1.7 million runs, and the seed is fixed
            assert abs(estimate.estimate - truth) < 5 * estimate.sd
        # tile and lamp are uneven by 1.5 % and more, which the pixels' own non-uniformity must not see
        assert c.flat_nonuniformity_rel.estimate > 1.5 * PIXEL_NONUNIFORMITY_REL
        assert c.full_well_e is not None
        well_e = c.full_well_e.estimate
        assert 0.85 < well_e / (rig.camera.gain_e_per_dn * 1007) < FULL_WELL_MARGIN
    used = found.applied_to(rig.camera)
    assert used.gain_e_per_dn == pytest.approx(rig.camera.gain_e_per_dn, rel=0.03)


def test_session_reads_back_with_its_checksums(captured: Captured) -> None:
    out, session, calls = captured
    stored = read_camera_session(out)
    assert (stored.plan, stored.frames, stored.notes) == (PLAN, session.frames, session.notes)
    assert stored.provenance is not None
    assert (stored.provenance.command, stored.provenance.seed) == ("finray capture", 1)
    lines = (out / "manifest-sha256.txt").read_text().splitlines()
    manifest = {name: digest for digest, name in (line.split("  ") for line in lines)}
    assert set(manifest) == {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()} - {
        "manifest-sha256.txt"
    }
    assert all(sha256_of(out / name) == digest for name, digest in manifest.items())
    events = Counter(json.loads(line)["event"] for line in (out / "journal.jsonl").read_text().splitlines())
    once = dict.fromkeys(("start", "levels", "frames proven", "session", "stop"), 1)
    assert events == once | {"frame": len(session.frames), "note": len(session.notes)}
    assert {text.split(":")[0] for _, _, text in calls} == {"flat frames", "dark frames"}
    assert len(calls) == len(session.frames)


def test_kind_of_a_folder_is_told(captured: Captured, rig: RigFile, tmp_path: Path) -> None:
    out, _, _ = captured
    assert session_kind(out) == "camera"
    with pytest.raises(RecordError, match="contains a camera session, but a capture session is needed"):
        read_session(out)
    paint = paint_plan("red", rig.camera).model_copy(update={"filters": ("450",), "bracket": (1.0,)})
    capture_paint_session(rig, paint, SessionRequest(tmp_path / "paint", "finray capture"))
    assert session_kind(tmp_path / "paint") == "paint"
    with pytest.raises(RecordError, match="contains a capture session, but a camera session is needed"):
        read_camera_session(tmp_path / "paint")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such folder; give the folder that 'finray capture' wrote"),
        ("", "cannot be read as JSON"),
        ("[]", "contains no record of a known kind, but a capture session or a camera session is needed"),
        ('{"kind": "BandSignals"}', "contains band signals, but a capture session or a camera session is needed"),
    ],
)
def test_folder_of_no_kind_is_refused(tmp_path: Path, content: str | None, message: str) -> None:
    folder = tmp_path / "session"
    if content is not None:
        folder.mkdir()
        (folder / "session.json").write_text(content)
    with pytest.raises(RecordError, match=message):
        session_kind(folder)


# Plans and light that do not allow a session.


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"filter_name": "533"}, r"plan\.filter_name: the rig has no filter '533'; its filters are 405, 450"),
        (
            {"region": {"row_px": 200, "column_px": 0, "height_px": 60, "width_px": 60}},
            r"plan\.region: row_px = 200 with height_px = 60 .* row_px \+ height_px may be at most 256 px",
        ),
        (
            {"region": {"row_px": 0, "column_px": 0, "height_px": 60, "width_px": 1}},
            r"plan\.region\.width_px: 1 px is too small; 2 to 320 px are allowed",
        ),
    ],
)
def test_plan_that_does_not_fit_the_rig(rig: RigFile, fields: dict[str, object], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        camera_step(changed(**fields), rig)


def test_folder_that_is_not_empty_is_refused(rig: RigFile, tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(CaptureError, match="is not an empty folder, and a capture never overwrites"):
        capture_camera_session(rig, PLAN, SessionRequest(tmp_path, "finray capture"))


def test_light_that_is_too_bright_or_too_dim(rig: RigFile, tmp_path: Path) -> None:
    def with_camera(**fields: float) -> RigFile:
        return rig.model_copy(update={"camera": rig.camera.model_copy(update=fields)})

    with pytest.raises(
        CaptureError,
        match=r"saturates in 0\.00\d+ s, so the shortest exposure must be at most 0\.00\d+ s, but is 0\.003 s",
    ):
        capture_camera_session(
            with_camera(shortest_exposure_s=0.003), PLAN, SessionRequest(tmp_path / "a", "finray capture")
        )
    with pytest.raises(CaptureError, match=r"needs 0\.00\d+ s to saturate, but at most 0\.004 s are allowed; brighten"):
        capture_camera_session(rig, changed(longest_exposure_s=0.004), SessionRequest(tmp_path / "b", "finray capture"))
    with pytest.raises(SaturatedError, match=r"white \(white, lamp\) through filter 532: the region is brighter"):
        capture_camera_session(
            with_camera(shortest_exposure_s=0.02), PLAN, SessionRequest(tmp_path / "c", "finray capture")
        )


def test_levels_of_three_channels(rig: RigFile) -> None:
    counts = np.zeros((8, 8), np.uint16)
    counts[0::2, 0::2], counts[1::2, 1::2] = 16 + 100, 16
    counts[0::2, 1::2] = counts[1::2, 0::2] = 16 + 500
    saturation_s = saturation_exposures_s(counts, 0.01, rig.camera)
    assert saturation_s == pytest.approx({"red": 0.1007, "green": 0.02014, "blue": 20.14})
    levels_s = np.array(level_exposures_s(saturation_s, PLAN, rig.camera))
    assert (np.diff(levels_s) > 0).all()
    assert np.sum(levels_s < 1.16 * 0.02014) == 12
    assert np.sum(levels_s < 1.16 * 0.1007) >= 20
    assert levels_s.max() == PLAN.longest_exposure_s
    assert level_notes(saturation_s, PLAN, rig.camera) == (
        "blue does not saturate within 5 s; use a lamp or filter with more blue light",
    )
    even = dict.fromkeys(("red", "green", "blue"), 0.02)
    assert len(level_exposures_s(even, PLAN, rig.camera)) == 12
    assert level_notes(even, PLAN, rig.camera) == ()


# Devices: no filter in the beam, and a camera that fails.


@dataclass
class LostCamera:
    camera: Camera
    frames_left: int

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        self.frames_left -= 1
        if self.frames_left < 0:
            raise CaptureError("camera: connection lost")
        return self.camera.expose(exposure_s, deadline_s)


def test_without_a_filter_nothing_is_said_of_the_slot(rig: RigFile, tmp_path: Path) -> None:
    # without a filter the lamp saturates this camera fast
    quick = rig.model_copy(update={"camera": rig.camera.model_copy(update={"shortest_exposure_s": 1e-6})})
    bare = changed(filter_name=None, repeats=0)
    step = camera_step(bare, quick)
    with open_rig(quick, Path()) as opened:
        session = capture_camera_with(opened, quick, bare, step, SessionRequest(tmp_path / "out", "finray capture"))
    assert {f.filter_name for f in session.frames} == {None}
    assert {f.slot_before for f in session.frames} == {None}
    through = capture_camera_session(quick, changed(repeats=0), SessionRequest(tmp_path / "filter", "finray capture"))
    # a filter passes 60 % of some 10 nm of the 300 nm that the camera sees
    brightest = [max(f.exposure_s for f in s.frames if f.frame_type == "white") for s in (session, through)]
    assert brightest[0] < 0.1 * brightest[1]


@pytest.mark.parametrize("frames", [3, 30, 70])  # while metering, in the lit frames, in the dark ones
def test_camera_that_fails_leaves_the_lamp_off_and_no_session(rig: RigFile, tmp_path: Path, frames: int) -> None:
    out = tmp_path / "out"
    with open_rig(rig, Path()) as opened:
        broken = replace(opened, camera=LostCamera(opened.camera, frames))
        with pytest.raises(CaptureError, match="connection lost"):
            capture_camera_with(broken, rig, PLAN, camera_step(PLAN, rig), SessionRequest(out, "finray capture"))
        assert not opened.lamp.state()
    last = json.loads((out / "journal.jsonl").read_text().splitlines()[-1])
    assert last["outcome"] == "CaptureError: camera: connection lost"
    with pytest.raises(RecordError, match=r"was not finished \(session\.json is missing\)"):
        session_kind(out)


def test_faults_may_cost_what_the_session_stated(rig: RigFile, tmp_path: Path) -> None:
    """Of a session of more than ten minutes that is more than the least time."""
    plan = changed(levels=60, frames_per_level=10)
    stated_s = camera_times(plan, rig).healing_s
    assert stated_s > LEAST_HEALING_S
    faults: list[float] = []

    class Repeating(LostCamera):
        def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
            faults.append(stated_s / 5.5)
            report_fault(Fault("camera", "did not answer", 1, faults[-1]))
            return super().expose(exposure_s, deadline_s)

    with open_rig(rig, Path()) as opened:
        broken = replace(opened, camera=Repeating(opened.camera, 100))
        with pytest.raises(HealingTimeError, match=f"but at most {stated_s:.0f} s are allowed"):
            capture_camera_with(broken, rig, plan, camera_step(plan, rig), SessionRequest(tmp_path / "out", "pytest"))
    assert len(faults) == 6


# The command.


@pytest.fixture
def files(rig: RigFile, tmp_path: Path) -> Path:
    from rigs import write_rig

    write_rig(rig, tmp_path / "rig.toml")
    (tmp_path / "plan.toml").write_text(TOML)
    return tmp_path


def test_command_captures_by_the_kind_of_the_plan(files: Path) -> None:
    said = succeed(f"capture {files}/plan.toml --rig {files}/rig.toml --out {files}/session")
    session = read_camera_session(files / "session")
    assert said.startswith("this takes about ")  # the time that it takes
    assert f"\n{files}/session: {len(session.frames)} frames of 'demo camera'\n" in said
    assert all(f"  note: {note}\n" in said for note in session.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"camera"', '"tactil"', "'kind' must be one of 'paint', 'camera', 'tactile', but is 'tactil'"),
        ('"532"', '"533"', "plan.toml: plan.filter_name: the rig has no filter '533'"),
        ("repeats = 0", "levels = 9", "'levels': must be at least 10, got 9"),
        ("repeats = 0", "repeat = 0", "'repeat': unknown key; did you mean 'repeats'?"),
        ("repeats = 0", "repeats 0", "cannot be read as TOML"),
    ],
)
def test_command_explains_a_wrong_plan(files: Path, old: str, new: str, message: str) -> None:
    (files / "plan.toml").write_text(TOML.replace(old, new))
    outcome = finray(f"capture {files}/plan.toml --rig {files}/rig.toml --out {files}/session")
    assert outcome.status == 2
    assert message in outcome.err
    assert not (files / "session").exists()
