"""No lane reads or writes outside a table, whatever it holds: a ray that met nothing carries coordinates never written.

Each look-up runs in a child process (an error is a segmentation fault), with the renderer's own bounds check on, for
this processor and for one without AVX-512: a cast of NaN gives 4294967295 there and 2147483648 here.
"""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.simulate.poisoned_lanes import LOOKUPS

HERE = Path(__file__).parents[2]
PROCESSORS = [[], ["x86-64-v3"]] if platform.machine() == "x86_64" else [[]]


@pytest.mark.renderer
@pytest.mark.parametrize("processor", PROCESSORS, ids=lambda processor: processor[0] if processor else "this-processor")
@pytest.mark.parametrize("lookup", LOOKUPS)
def test_poisoned_lanes_stay_inside_the_tables(llvm_choice, lookup, processor):
    child = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-m", "tests.simulate.poisoned_lanes", lookup, *processor],
        cwd=HERE,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert child.returncode == 0, child.stderr
    assert "out-of-bounds" not in child.stderr, child.stderr[:2000]
    assert child.stdout.endswith("ended well\n")
