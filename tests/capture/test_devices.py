from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from data_schemas import BandPassFilter, CaptureError, CurveError, RigFile
from rigs import OpenRig, open_rig, simulated_rig
from rigs.simulated import BenchState, SimulatedClock, SimulatedFilterWheel


def with_response(rig: RigFile, file: str) -> RigFile:
    return rig.model_copy(update={"camera": rig.camera.model_copy(update={"response": file})})


def write_response(path: Path, first_nm: int, last_nm: int) -> None:
    rows = [f"{x},30,40,50" for x in range(first_nm, last_nm + 1)]
    path.write_text("wavelength_nm,red_percent,green_percent,blue_percent\n" + "\n".join(rows) + "\n")


def signal(opened: OpenRig, exposure_s: float = 0.002) -> float:
    return float(opened.camera.expose(exposure_s, 10.0).counts.mean())


def test_clock_runs_only_with_the_devices(rig: RigFile) -> None:
    clock = SimulatedClock(start=datetime(2026, 1, 2, tzinfo=UTC), elapsed_s=61.5)
    assert clock.utc() == "2026-01-02T00:01:01.500+00:00"
    with open_rig(rig, Path()) as opened:
        start_s = opened.clock.monotonic_s()
        opened.camera.expose(2.0, 10.0)
        assert opened.clock.monotonic_s() - start_s == pytest.approx(2.02)


def test_light_is_on_inside_the_block_only(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        dark = signal(opened)
        with opened.lamp.lit():
            assert opened.lamp.state()
            assert not opened.laser.state()
            assert signal(opened, 0.1) > 1.5 * dark
        assert not opened.lamp.state()
        with pytest.raises(RuntimeError, match="in the block"), opened.laser.lit():
            raise RuntimeError("in the block")
        assert not opened.laser.state()
        assert signal(opened) == pytest.approx(dark, abs=0.5)  # DN; 20480 pixels with 1.4 DN of noise


def test_room_light_comes_with_the_open_box(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        assert opened.wheel.position() == 1
        dark = signal(opened)
        opened.operator.place("sample beside ColorChecker")
        assert opened.wheel.position() is None
        assert signal(opened) > dark + 5
        with pytest.raises(CaptureError, match=r"swung out of the beam and cannot go to slot 2"):
            opened.wheel.go_to(2, 10.0)


def test_wheel_goes_the_shorter_way_within_its_deadline() -> None:
    state = BenchState(clock=SimulatedClock(), slot=1)
    wheel = SimulatedFilterWheel(tuple(range(1, 9)), state)
    wheel.go_to(8, 0.5)
    assert wheel.position() == 8
    with pytest.raises(CaptureError, match=r"needs 1\.6 s to reach slot 4, but the deadline is 1 s"):
        wheel.go_to(4, 1.0)
    with pytest.raises(CaptureError, match=r"has no slot 9, only 1, 2, 3"):
        wheel.go_to(9, 1.0)
    assert wheel.position() == 8


def test_exposure_beyond_the_deadline_is_refused(rig: RigFile) -> None:
    with (
        open_rig(rig, Path()) as opened,
        pytest.raises(CaptureError, match=r"exposure of 2 s cannot be done within the deadline of 1 s"),
    ):
        opened.camera.expose(2.0, 1.0)


def test_lamp_repeats_within_its_tolerance(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened, opened.lamp.lit():
        opened.wheel.go_to(6, 10.0)
        frames = [opened.camera.expose(0.002, 10.0).counts[50:78, 66:94].astype(float) - 16.0 for _ in range(40)]
    red = np.array([frame[0::2, 0::2].mean() for frame in frames])
    # 196 pixels of about 3600 e each add 0.12 % of shot noise to 0.2 %; the spread of 40 has a relative sd of 11 %
    assert 0.0012 < red.std() / red.mean() < 0.0036


def test_same_seed_gives_the_same_frame(rig: RigFile) -> None:
    frames = []
    for _ in range(2):
        with open_rig(rig, Path()) as opened, opened.lamp.lit():
            frames.append(opened.camera.expose(0.01, 10.0).counts)
    np.testing.assert_array_equal(*frames)


def test_assumed_response_is_labelled_and_leaks_a_little_blue(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        red, green, blue = opened.camera_response
        assert opened.notes == ()
    assert {red.source, green.source, blue.source} == {"assumed"}
    assert [float(c.wavelength_nm[c.values.argmax()]) for c in (red, green, blue)] == pytest.approx(
        [610, 535, 460], abs=3
    )
    assert 0.005 < red(450.0) / blue(450.0) < 0.02


def test_measured_response_is_read_and_held_ends_are_noted(rig: RigFile, tmp_path: Path) -> None:
    write_response(tmp_path / "camera.csv", 400, 700)
    with open_rig(with_response(rig, "camera.csv"), tmp_path) as opened:
        assert opened.camera_response[1](500.0) == pytest.approx(0.4)
        assert len(opened.notes) == 3
        assert all("its end value is used" in note and "filter 405" in note for note in opened.notes)


def test_response_that_misses_a_filter_is_refused(rig: RigFile, tmp_path: Path) -> None:
    write_response(tmp_path / "narrow.csv", 420, 700)
    with (
        pytest.raises(CurveError, match=r"covers only 420 to 700 nm, and 100 % of the weight of filter 405"),
        open_rig(with_response(rig, "narrow.csv"), tmp_path),
    ):
        pass


def test_filter_beyond_the_assumed_response_is_refused(rig: RigFile) -> None:
    wheel = rig.filter_wheel
    infrared = BandPassFilter(slot=1, name="850", center_nm=850.0)
    beyond = rig.model_copy(update={"filter_wheel": wheel.model_copy(update={"filters": (infrared,)})})
    with pytest.raises(CurveError, match=r"covers only 380 to 780 nm"), open_rig(beyond, Path()):
        pass


def test_measured_material_can_lie_on_the_bench(tmp_path: Path) -> None:
    header = "emission_nm," + ",".join(str(x) for x in range(400, 600, 50))
    rows = [f"{e}," + ",".join("0.04" if e > x + 20 else "0.5" for x in range(400, 600, 50)) for e in (400, 500, 600)]
    (tmp_path / "sheet.csv").write_text("\n".join([header, *rows]) + "\n")
    rig = simulated_rig("sheet.csv", width_px=64, height_px=64)
    with open_rig(rig, tmp_path) as opened:
        opened.operator.place("sample")
        opened.wheel.go_to(6, 10.0)
        dark = signal(opened, 0.1)
        with opened.laser.lit():
            assert signal(opened, 0.1) > dark + 1  # DN; the noise of the mean of 4096 pixels is 0.02


def test_sample_is_dosed_while_the_laser_shines_on_it(rig: RigFile) -> None:
    state = BenchState(clock=SimulatedClock(), slot=1, laser_power_mw=5.0)
    state.advance(10.0)
    state.laser = True
    state.advance(10.0)
    assert state.sample_dose_j == 0.0  # the tile is in view
    state.target = "sample"
    state.advance(2.0)
    assert state.sample_dose_j == pytest.approx(0.010)
    assert state.clock.elapsed_s == 22.0


def test_tilted_sample_gets_less_of_the_laser(rig: RigFile) -> None:
    with open_rig(rig, Path()) as opened:
        opened.operator.place("sample")
        opened.wheel.go_to(6, 10.0)
        dark = signal(opened, 0.01)
        with opened.laser.lit():
            flat = signal(opened, 0.01) - dark
            opened.operator.tilt(60.0)
            tilted = signal(opened, 0.01) - dark
    # means of 20480 px: noise of 0.01 DN of 1 and rounding, and 0.3 % of light
    assert tilted / flat == pytest.approx(0.5, rel=0.03)
