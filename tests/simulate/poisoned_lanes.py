"""Child process of test_poisoned_lanes.py: look-ups of lanes that hold NaN, infinities and numbers without an integer.

python -m tests.simulate.poisoned_lanes LOOKUP [PROCESSOR]
"""

import ctypes
import sys
from pathlib import Path

import drjit as dr
import numpy as np

from data_schemas.design import FingerDesign
from sim.optics.position_map import PositionMap
from sim.optics.variants import choose_variant, open_renderer
from sim.surface_meshes.finger_shape import bent, rest_shape

LANES, REPEATS = 24_000, 25
POISON = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 4.3e9, -1.0, 0.5], dtype=np.float32)


def compile_for(processor):
    """Compile for another processor than this one: what a cast of NaN gives depends on it."""
    library = ctypes.CDLL(str(Path(dr.__file__).with_name("libdrjit-core.so")))
    set_target = library["_Z19jit_llvm_set_targetPKcS0_j"]
    set_target.argtypes, set_target.restype = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32], None
    set_target(processor.encode(), b"", 8)


def position_map(renderer, drawn):
    """Points of a bent face at poisoned coordinates."""
    face = PositionMap.of(bent(rest_shape(FingerDesign()), 80.0).surfaces["inner"])
    assert not face.is_plane
    return list(face.in_renderer(renderer)(drawn(), drawn()))


def main(lookup, processor=None):
    renderer = open_renderer(choose_variant("llvm"))
    if processor is not None:
        compile_for(processor)
    # the renderer's own check of every gather and scatter: it writes "out-of-bounds" to standard error
    dr.set_flag(dr.JitFlag.Debug, True)
    rng = np.random.default_rng(5)

    def drawn():
        return renderer.Float(rng.choice(POISON, LANES))

    for _ in range(REPEATS):
        # a plain list: the renderer evaluates no tuple with names, and says nothing
        found = LOOKUPS[lookup](renderer, drawn)
        assert type(found) is list
        dr.eval(found)
        dr.sync_thread()
    sys.stdout.write("ended well\n")


LOOKUPS = {found.__name__: found for found in (position_map,)}

if __name__ == "__main__":
    main(*sys.argv[1:])
