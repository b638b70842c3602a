"""No lane reads or writes outside a table, whatever it holds: a ray that met nothing carries coordinates never written.

The look-ups run in a child process (an error is a segmentation fault), with the renderer's own bounds check on, for
this processor and for one without AVX-512: a cast of NaN gives 4294967295 there and 2147483648 here.
"""

import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sim.optics._path_rules import EventLog, LookupTable, Tally, cell_at
from sim.optics._position_map import cell_and_fraction

HERE = Path(__file__).parents[2]
OTHER_PROCESSOR = [("rgb", "x86-64-v3"), ("spectral", "x86-64-v3")] if platform.machine() == "x86_64" else []


@pytest.mark.renderer
@pytest.mark.parametrize("arguments", [("rgb",), ("spectral",), ("paths",), *OTHER_PROCESSOR], ids=" ".join)
def test_poisoned_lanes_stay_inside_the_tables(llvm_choice, arguments):
    child = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-m", "tests.simulate.poisoned_lanes", *arguments],
        cwd=HERE,
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert child.returncode == 0, child.stderr
    assert "out-of-bounds" not in child.stderr, child.stderr[:2000]
    assert child.stdout.endswith("ended well\n")


@pytest.mark.renderer
def test_every_float_has_a_cell_and_every_number_a_row(llvm):
    places = [np.nan, np.inf, -np.inf, 1e30, -1e30, -0.5, 0.0, 0.99, 1.0, 4.0, 4.99, 5.0]
    cells = np.array(cell_at(llvm.Float(places), 5))
    np.testing.assert_array_equal(cells, [0, 4, 0, 4, 0, 0, 0, 0, 1, 4, 4, 4])
    table = LookupTable(np.arange(10.0).reshape(5, 2), llvm)
    row = table.row(llvm.UInt32([0, 4, 5, 2**31, 2**32 - 1]), llvm.Bool([True, True, True, True, False]))
    np.testing.assert_array_equal(np.array(row), [[0, 8, 8, 8, 0], [1, 9, 9, 9, 0]])
    tally = Tally(3, llvm)
    tally.add(llvm.Float([1, 2, 4, 8, np.nan]), llvm.UInt32([0, 2, 3, 2**32 - 1, 1]), llvm.Bool([True] * 4 + [False]))
    np.testing.assert_array_equal(np.array(tally.sums), [1, 0, 2])


@pytest.mark.renderer
@pytest.mark.parametrize("length", [1, 3, 8])
def test_a_log_keeps_what_has_room_and_counts_all(llvm, length):
    log = EventLog(length, 1, 1, llvm)
    numbers = llvm.UInt32([7, 8, 9, 2**32 - 1])
    log.add([numbers, llvm.Float(numbers) / 2.0], llvm.Bool([True, False, True, True]))
    assert int(log.count[0]) == 3
    whole, halves = log.rows()
    kept = min(length, 3)
    assert len(whole) == len(halves) == kept
    assert len(set(whole.tolist())) == kept
    assert set(whole.tolist()) <= {7, 9, 2**32 - 1}
    np.testing.assert_array_equal(halves, (whole.astype(np.float32) / 2.0).astype(np.float32))


def test_the_same_map_in_numpy_has_a_cell_for_every_float():
    places = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, -0.1, 0.0, 0.99, 1.0])
    cells, _ = cell_and_fraction(places, 5)
    np.testing.assert_array_equal(cells, [0, 4, 0, 4, 0, 0, 0, 4, 4])


@pytest.mark.renderer
def test_a_table_is_read_by_one_kernel_wherever_its_numbers_lie(llvm):
    """A kernel that depends on the place of an array misses the disk cache by chance: seconds at every start."""
    import drjit as dr

    kernels = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for offset in (0, 1, 4, 8):
            memory = np.zeros(400 + offset, dtype=np.float32)
            place = memory[offset:].reshape(100, 4)
            place[:] = np.arange(100.0)[:, None]
            row = LookupTable(place, llvm).row(dr.arange(llvm.UInt32, 7))
            assert np.array_equal(np.array(row)[0], np.arange(7.0))
            kernels |= {kernel["hash"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT}
    assert len(kernels) == 1
