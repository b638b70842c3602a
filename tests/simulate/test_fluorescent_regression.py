"""A box with fluorescent walls against its stored image, pixel by pixel, with both variances.

The stored file is ours: mean and variance of the mean of 64 renders of Mitsuba's box, lit by an LED, whose red and
green walls are fluorescent. ``python -m tests.simulate.test_fluorescent_regression`` makes it, anew only when the
physics is meant to change.
"""

from pathlib import Path

import numpy as np
import pytest

from sim.optics import choose_variant, open_renderer
from tests.simulate.test_mitsuba_scenes import cornell_box, renders
from tests.simulate.z_test import holm, z_test

REFERENCE = Path(__file__).parent / "fluorescent_box.npz"
REFERENCE_RUNS, RUNS, SAMPLES_PER_PIXEL = 64, 16, 64
LAMP_ROWS = 6
# columns: red-emission, green-emission and LED band coming in
MATRICES = {
    "red": np.array([[0.57, 0.12, 0.21], [0.0, 0.043, 0.0], [0.0, 0.0, 0.044]]),
    "green": np.array([[0.105, 0.0, 0.0], [0.0, 0.378, 0.24], [0.0, 0.0, 0.076]]),
}


def box_renders(matrices, seeds):
    from sim.optics._fluorescent_paths import fluorescent_bands

    scene = cornell_box(light=(0.0, 0.0, 20.0))
    integrator = fluorescent_bands(scene, matrices, max_depth=20)
    # without the rows that see the lamp, whose edge is brighter and noisier than all the rest
    return renders(scene, integrator, seeds, SAMPLES_PER_PIXEL)[:, LAMP_ROWS:]


def compared(matrices, first_seed):
    with np.load(REFERENCE) as stored:
        mean, variance = stored["mean"].astype(float), stored["variance"].astype(float)
    return z_test(box_renders(matrices, range(first_seed, first_seed + RUNS)), mean, variance, REFERENCE_RUNS)


@pytest.mark.renderer
def test_the_box_is_that_of_the_stored_image(llvm):
    """Holm over 1728 pixel values and over 3 channels: a right program fails with a chance under 0.1 %."""
    result = compared(MATRICES, 1000)
    assert result.rejected == 0
    assert (np.abs(result.z) > 0.0).mean() > 0.5


@pytest.mark.renderer
@pytest.mark.parametrize(
    ("wall", "entry", "channel"),
    [("red", (0, 2), 0), ("green", (1, 2), 1)],
    ids=["LED to red", "LED to green"],
)
def test_two_percent_of_one_number_is_found(llvm, wall, entry, channel):
    """No single pixel shows it at 2 % noise; the sum over the channel does. The other bands stay as they are."""
    changed = {name: matrix.copy() for name, matrix in MATRICES.items()}
    changed[wall][entry] *= 1.02
    result = compared(changed, 1000)
    assert result.rejected_channels >= 1
    assert np.argmax(np.abs(result.channel_z)) == channel


def test_a_wrong_pixel_is_found_and_noise_is_not():
    rng = np.random.default_rng(1)
    runs, reference = rng.normal(1.0, 0.1, (16, 24, 32, 3)), rng.normal(1.0, 0.1, (64, 24, 32, 3))
    mean, variance = reference.mean(axis=0), reference.var(axis=0, ddof=1) / 64
    assert z_test(runs, mean, variance, 64).rejected == 0
    runs[:, 3, 4, 1] += 0.4
    assert z_test(runs, mean, variance, 64).rejected_pixels == 1


def test_holm_steps_down():
    """Of p = .01 .04 .03 .005 at 5 % the smallest two are rejected (.005 <= .0125, .01 <= .0167)."""
    assert holm(np.array([0.01, 0.04, 0.03, 0.005]), 0.05).tolist() == [True, False, False, True]


if __name__ == "__main__":
    open_renderer(choose_variant("llvm"))
    made = box_renders(MATRICES, range(REFERENCE_RUNS))
    np.savez_compressed(
        REFERENCE,
        mean=made.mean(axis=0).astype(np.float32),
        variance=(made.var(axis=0, ddof=1) / REFERENCE_RUNS).astype(np.float32),
    )
