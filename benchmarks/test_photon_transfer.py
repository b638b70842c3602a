"""Camera sessions: memory of a 500-frame session, and the running moments beside stacking all frames with numpy."""

import tracemalloc

import numpy as np
import pytest

from data_schemas import CameraPlan, CameraSession, Frame, RegionOfInterest
from finray_calib.radiometry import FrameStack, characterise_camera
from finray_calib.radiometry._camera_characterisation import CHANNELS
from tests.radiometry.camera_sessions import camera_session

HEIGHT_PX, WIDTH_PX = 1024, 1280
FRAMES = 500
LARGEST_MEMORY_BYTES = 500e6
STACK = 40


def tiled(counts: np.ndarray) -> np.ndarray:
    """Fill a whole frame with shifted copies of a small one, which is quicker than exposing it."""
    rows, columns = -(-HEIGHT_PX // counts.shape[0]), -(-WIDTH_PX // counts.shape[1])
    return np.tile(counts, (rows, columns))[:HEIGHT_PX, :WIDTH_PX]


@pytest.fixture(scope="module")
def whole_frames() -> tuple[CameraSession, dict[str, np.ndarray]]:
    """A session of 500 whole frames, of which only a small tile is kept."""
    # 16 levels, lit and dark, in pairs: 64 frames and two long darks; the rest are repeats
    made = camera_session(np.random.default_rng(1), side_px=256, repeats=(FRAMES - 66) // 2)
    whole = RegionOfInterest(row_px=0, column_px=0, height_px=HEIGHT_PX, width_px=WIDTH_PX)
    plan = CameraPlan.model_validate({**made.session.plan.model_dump(), "region": whole.model_dump()})
    return made.session.model_copy(update={"plan": plan}), made.frames


def test_500_frame_session_fits_500_mb(whole_frames):
    session, frames = whole_frames

    def read(frame: Frame) -> np.ndarray:
        return tiled(frames[frame.file])

    assert len(session.frames) == FRAMES
    tracemalloc.start()
    found = characterise_camera(session, read)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"\n{FRAMES} frames of {WIDTH_PX} x {HEIGHT_PX}: {peak / 1e6:.0f} MB at most")
    assert peak < LARGEST_MEMORY_BYTES
    assert found.channels[0].gain_e_per_dn.estimate == pytest.approx(2.0, rel=0.02)


@pytest.fixture(scope="module")
def stack() -> list[np.ndarray]:
    rng = np.random.default_rng(2)
    return [rng.integers(400, 600, (HEIGHT_PX, WIDTH_PX), dtype=np.uint16) for _ in range(STACK)]


@pytest.mark.benchmark(group=f"temporal variance of {STACK} frames of {WIDTH_PX} x {HEIGHT_PX}, four Bayer sites")
def test_running_moments(benchmark, stack):
    def run() -> float:
        running = FrameStack("benchmark", CHANNELS["RGGB"].values(), 1023)
        for frame in stack:
            running.add(frame)
        return running.statistics()[0].variance_dn2

    assert benchmark.pedantic(run, rounds=3) == pytest.approx((200**2 - 1) / 12, rel=0.01)


@pytest.mark.benchmark(group=f"temporal variance of {STACK} frames of {WIDTH_PX} x {HEIGHT_PX}, four Bayer sites")
def test_numpy_stack(benchmark, stack):
    def run() -> float:
        frames = np.stack(stack)
        sites = [frames[:, i::2, j::2] for i in (0, 1) for j in (0, 1)]
        variance = [site.var(axis=0, ddof=1).mean() - site.mean(axis=(1, 2)).var(ddof=1) for site in sites]
        spatial = [site.mean(axis=0).var(ddof=1) for site in sites]
        saturated = [np.mean(site >= 1023) for site in sites]
        return float(variance[0] + 0 * (spatial[0] + saturated[0]))

    assert benchmark.pedantic(run, rounds=3) == pytest.approx((200**2 - 1) / 12, rel=0.01)
