"""Pictures on a GPU hold the light of those by LLVM. Collected by `make test-gpu` only."""

import pytest

from benchmarks.gpu_pictures import compared, pictures

WIDTH_PX, SEEDS = 160, 8
LARGEST_ERROR_REL = {"b": 0.01, "c": 0.02}
"""More noise than this would hide a difference; 8 seeds leave 1.1 % at level c."""

pytestmark = pytest.mark.renderer


@pytest.mark.parametrize(("level", "samples"), [("b", 256), ("c", 1024)])
def test_the_gpu_gives_the_light_of_llvm(gpu, level, samples):
    """Welch's t between seeds, for each band and 5 mm of the coat; Holm's step rejects at 1 %."""
    found = compared(*(pictures(engine, level, WIDTH_PX, samples, SEEDS) for engine in ("llvm", "cuda")))
    assert not found["rejected"], found
    assert found["strips"] >= 3 * 8
    assert max(found["standard_error"].values()) < LARGEST_ERROR_REL[level], found
