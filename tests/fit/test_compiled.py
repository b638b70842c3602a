"""Machine code that was just compiled and machine code from the cache give the same numbers, to the last digit."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FITS = """
import hashlib
import numpy as np
from finray_calib.fit._prior import PAINT_DISCREPANCY
from finray_calib.fit._emission import fit_emission
from finray_calib.fit._prior import EmissionPrior
from finray_calib.spectra._band_weights import emission_weights
from finray_calib.spectra._emission_families import FAMILIES
from tests.fit.conftest import ClosedFormRig
from tests.fit.synthetic_bands import QUICK, orange, simulate

weights = emission_weights(**ClosedFormRig().sampled(np.arange(380.0, 781.0)))
data, _ = simulate(orange(), weights, np.random.default_rng(11), discrepancy=PAINT_DISCREPANCY)
for family in FAMILIES.values():
    found = fit_emission(data, family, EmissionPrior(), PAINT_DISCREPANCY, QUICK, np.random.default_rng(12))
    print(family.name, hashlib.sha256(found.draws.tobytes() + found.curve_draws.curves.tobytes()).hexdigest())
"""


def fits(cache: Path) -> str:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", FITS], env=environment, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_a_cached_fit_equals_the_one_that_compiled(tmp_path: Path) -> None:
    compiled = fits(tmp_path)
    assert list(tmp_path.rglob("*.nbi")), "nothing was cached: the second fit compiles as well"
    assert fits(tmp_path) == compiled
