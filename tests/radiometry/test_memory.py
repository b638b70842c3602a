"""Small twin of benchmarks/test_radiometry_memory.py: memory does not grow with the number of frames."""

from pathlib import Path

from tests.radiometry.many_frames import reduce_apart, write_session


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    peaks_mb = []
    for frames in (28, 112):
        folder = tmp_path / str(frames)
        write_session(folder, frames, 640, 512)
        found = reduce_apart(folder)
        assert found["frames"] == frames
        peaks_mb.append(found["peak_mb"])
    # 84 more frames are 55 MB as counts; the peak of one process differs by a few MB from run to run.
    assert peaks_mb[1] - peaks_mb[0] < 15.0
