"""Memory of the reduction of a long session: 500 frames of 1280 x 1024 px in less than 500 MB resident.

The frames are 1.3 GB; holding them, or their per-pixel sums as floats, would show. ``make bench`` runs it.
"""

from pathlib import Path

from tests.radiometry.many_frames import reduce_apart, write_session

FRAMES = 500
LARGEST_RESIDENT_MB = 500.0


def test_500_frames_are_reduced_in_500_mb(benchmark, tmp_path: Path) -> None:
    write_session(tmp_path, FRAMES, 1280, 1024)
    found = benchmark.pedantic(reduce_apart, args=(tmp_path,), rounds=1, iterations=1)
    benchmark.extra_info.update(found)
    assert found["frames"] == FRAMES
    assert found["pixels"] == 1280 * 1024
    assert found["peak_mb"] < LARGEST_RESIDENT_MB
