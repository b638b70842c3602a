"""A new paint, camera and white balance on a rendered press: a stored press recoloured, and its product alone.

Beside numpy's einsum. A press holds two pictures and its noise; only the arithmetic is timed, not reading and writing.
Times are those of the processor, all threads together: what the clock shows where nothing else runs.
"""

import time
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fluorescence_levels import paints
from data_schemas import FingerDesign, SimulatedPress
from data_schemas.storage import assumed_camera_response
from sim.experiments import recoloured
from sim.experiments._painted_finger import response_matrix
from sim.experiments._rendered_press import light_record
from sim.optics import chain_matrix, conversion_gains, mix_chains, paint_bands

CHAINS = ("led>red", "led>green", "led", "led>green>red", "led>red>red", "led>green>green")
BEFORE = {"red": np.array([0.01, 0.2, 0.3]), "green": np.array([0.0, 0.01, 0.25])}
AFTER = {name: 1.1 * values for name, values in BEFORE.items()}
BALANCE = np.array([[1.4], [1.0], [1.8]])
GROUP = "new yield, camera and white balance, 640 x 480, six chains (to stay under 50 ms)"


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    return np.random.default_rng(5).random((480, 640, 6)).astype(np.float32)


@pytest.fixture(scope="module")
def press(images) -> SimulatedPress:
    """A press of random chains."""
    design = FingerDesign()
    bands, response = paint_bands(*paints().values(), design.light), assumed_camera_response()
    pixels = np.ascontiguousarray(images[..., :3])
    return SimulatedPress(
        name="press",
        label="made up",
        method="rendered",
        encoding="linear",
        no_contact=pixels,
        contact=pixels,
        distance=pixels[..., 0],
        variance=pixels,
        no_contact_bands=pixels,
        contact_bands=pixels,
        contact_bands_variance=pixels,
        bands=("red", "green", "led"),
        no_contact_chains=images,
        contact_chains=images,
        chains=CHAINS,
        rendered_light=light_record(bands, response),
        camera_matrix=response_matrix(response, bands),
        light_angle_deg=30.0,
        design=design,
    )


def weights() -> np.ndarray:
    return BALANCE * (np.eye(3) @ chain_matrix(CHAINS, conversion_gains(BEFORE, AFTER)))


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_one_picture(benchmark, images):
    benchmark(lambda: mix_chains(images, weights()))


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_both_pictures_and_noise_of_a_press(benchmark, press):
    brighter = {name: replace(p, emission_per_nm=1.1 * p.emission_per_nm) for name, p in paints().items()}
    benchmark(lambda: recoloured(press, brighter, assumed_camera_response(), (1.4, 1.0, 1.8)))


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_one_picture_by_einsum_in_double_precision(benchmark, images):
    benchmark(lambda: np.einsum("mn,ijn->ijm", weights(), images.astype(np.float64)))
