"""A new paint, camera and white balance on a rendered finger: by one matrix product, beside numpy's einsum."""

import numpy as np
import pytest

from sim.optics.chain_images import chain_matrix, conversion_gains, mix

CHAINS = ("led>red", "led>green", "led", "led>green>red", "led>red>red", "led>green>green")
BEFORE = {"red": np.array([0.01, 0.2, 0.3]), "green": np.array([0.0, 0.01, 0.25])}
AFTER = {name: 1.1 * values for name, values in BEFORE.items()}
BALANCE = np.array([[1.4], [1.0], [1.8]])
GROUP = "new yield, camera and white balance, 640 x 480, six chains (to stay under 50 ms)"


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    return np.random.default_rng(5).random((480, 640, 6)).astype(np.float32)


def weights() -> np.ndarray:
    return BALANCE * (np.eye(3) @ chain_matrix(CHAINS, conversion_gains(BEFORE, AFTER)))


@pytest.mark.benchmark(group=GROUP)
def test_finray(benchmark, images):
    benchmark(lambda: mix(images, weights()))


@pytest.mark.benchmark(group=GROUP)
def test_einsum_in_double_precision(benchmark, images):
    benchmark(lambda: np.einsum("mn,ijn->ijm", weights(), images.astype(np.float64)))
