"""Paint maps beside a loop of scipy's least squares, in the same run; time and memory at 1.3 MP.

Both are counted in pixels per second of processor time: maps run on all cores, the loop on one.
"""

import resource
import time

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.drawn_paints import nominal_optics
from finray_calib.fit import map_pixels
from finray_calib.fit._pixel_maps import pixel_problem
from finray_calib.spectra import rig_emission_weights
from tests.fit.pixel_scenes import SPREAD, PixelScene, center_of, scene, whole_rule

FAMILIES = ("zheng2014", "log_normal_wavenumber")
ROWS, COLUMNS = 1024, 1280
SCIPY_PIXELS, ROUNDS = 300, 3
LEAST_RATIO = 300
LONGEST_S, LARGEST_MB = 15.0, 2000.0
TILE = 64
"""Rows and columns that are simulated; the frame repeats them."""


def frame(name: str) -> PixelScene:
    """A 1.3 MP frame: paint of uneven thickness and mode, 1 % noise."""
    rng = np.random.default_rng(1)
    truth = np.tile(center_of(name), (TILE * TILE, 1))
    truth[:, 2] += 0.2 * rng.standard_normal(len(truth))
    truth[:, 0] += 2.0 * rng.standard_normal(len(truth))
    small = scene(name, nominal_optics(), truth, rng, rows=TILE)
    repeat = (ROWS // TILE, COLUMNS // TILE)
    fields = {
        key: np.tile(value, (1,) * (value.ndim - 2) + repeat)
        for key, value in dict(small.pixels).items()
        if isinstance(value, np.ndarray) and value.shape[-2:] == (TILE, TILE)
    }
    area = small.pixels.area.model_copy(update={"height_px": ROWS, "width_px": COLUMNS})
    pixels = type(small.pixels).model_validate({**dict(small.pixels), **fields, "area": area})
    return PixelScene(name, small.optics, truth, pixels, small.region)


def scipy_rate(made: PixelScene) -> float:
    """Pixels per processor second of scipy (MINPACK): same priors and bands, Gauss nodes as a product, same start."""
    problem, _ = pixel_problem(made.region, rig_emission_weights(made.optics, made.pixels.channel_weights), SPREAD)
    curve = made.region.family.curves
    nodes, weights = whole_rule(problem)
    precision = np.sqrt(problem.precision)
    chosen = np.random.default_rng(2).integers((0, 0), (TILE, TILE), (SCIPY_PIXELS, 2))
    start = time.process_time()
    for row, column in chosen:
        y = made.pixels.fluorescence[:, row, column].astype(float)
        sd = made.pixels.fluorescence_sd[:, row, column].astype(float)
        c = made.pixels.channel[row, column]

        def residual(theta, y=y, sd=sd, c=c):
            mu = weights[c] @ curve(theta[None, :4], nodes)[0] + theta[4] * problem.laser[c]
            return np.concatenate([(mu - y) / sd, (theta - problem.mean) * precision])

        least_squares(residual, problem.mean, method="lm", x_scale=1 / precision)
    return SCIPY_PIXELS / (time.process_time() - start)


@pytest.mark.parametrize("name", FAMILIES)
def test_pixels_per_second(name, record_property):
    made = frame(name)
    map_pixels(made.pixels, made.region, SPREAD)  # compiled code is loaded, or made once
    seconds, processor, rivals = [], [], []
    for _ in range(ROUNDS):
        start, spent = time.perf_counter(), time.process_time()
        found = map_pixels(made.pixels, made.region, SPREAD)
        seconds.append(time.perf_counter() - start)
        processor.append(time.process_time() - spent)
        rivals.append(scipy_rate(made))
    clock_s, rival = float(np.median(seconds)), float(np.median(rivals))
    rate = found.mode_nm.size / float(np.median(processor))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    for key, value in (("ratio", rate / rival), ("seconds", clock_s), ("peak_mb", peak_mb)):
        record_property(key, value)
    print(
        f"\n{name}: {found.mode_nm.size} pixels in {clock_s:.1f} s; per processor second {rate:.0f}, "
        f"scipy {rival:.0f}; ratio {rate / rival:.0f}; largest memory {peak_mb:.0f} MB"
    )
    assert found.unconverged_pixels < 1e-3 * found.mode_nm.size
    assert rate / rival > LEAST_RATIO
    assert clock_s < LONGEST_S
    assert peak_mb < LARGEST_MB
