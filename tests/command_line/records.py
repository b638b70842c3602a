"""Small made-up records with known contents."""

from typing import Literal

import numpy as np

from data_schemas import FingerDesign, IndenterPose, KnownInputs, LightAngleSweep, SimulatedPress, TactileCapture

BEST_DEG = 35.0
Encoding = Literal["linear", "unknown"]


def press(encoding: Encoding = "linear", level: float = 1.0) -> SimulatedPress:
    """A dark strip across a smooth pad; `level` 0 is black."""
    rows, columns = np.mgrid[0:60, 0:80].astype(float)
    distance = np.abs(columns - 40.0) / 12.0
    pad = level * np.stack([1.0 + rows / 60, 2.0 - rows / 60, 1.0 + columns / 80], axis=2)
    contact = pad * (1 - 0.4 * np.exp(-(distance**2)))[..., None]
    return SimulatedPress(
        name="strip",
        label="made up",
        method="rendered" if encoding == "linear" else "table",
        encoding=encoding,
        no_contact=100 * pad,
        contact=100 * contact,
        distance=distance,
        variance=None,
        light_angle_deg=30.0,
        design=None,
    )


def with_known_camera(simulated: SimulatedPress) -> SimulatedPress:
    """The press without noise, its camera's response known to 1 %: enough for an error of the objective."""
    none = np.zeros_like(simulated.contact)
    factors = 1 + 0.01 * np.random.default_rng(3).standard_normal((1, 1000, 3, 1))
    return simulated.model_copy(
        update={
            "bands": ("red", "green", "blue"),
            "contact_bands": simulated.contact,
            "no_contact_bands": simulated.no_contact,
            "contact_half_difference": none,
            "no_contact_half_difference": none,
            "layer_matrix": np.eye(3),
            "known_inputs": KnownInputs(
                names=("camera response",),
                keys=("camera",),
                evaluations=("B",),
                sources=("stated",),
                factors=(factors * np.ones((1, 1, 1, 3))).astype(np.float32),
            ),
        }
    )


def capture_of(
    simulated: SimulatedPress, dn_per_unit: float, rows: slice = slice(None), encoding: Encoding = "linear"
) -> TactileCapture:
    """The capture that a press would give: black level 16 DN and noise of 1 DN."""
    rng = np.random.default_rng(1)

    def counts(image: np.ndarray) -> np.ndarray:
        noisy = 16.0 + dn_per_unit * image[rows] + rng.standard_normal(image[rows].shape)
        return np.rint(noisy).clip(0, 65535).astype(np.uint16)

    return TactileCapture(
        name="capture of the strip",
        contact=counts(simulated.contact),
        no_contact=counts(simulated.no_contact),
        repeat_no_contact=counts(simulated.no_contact),
        layout="RGB",
        encoding=encoding,
        bit_depth=16,
        black_level_dn=16.0,
        exposure_s=0.02,
        light_angle_deg=30.0,
        indenter=IndenterPose(shape="cylinder", radius_mm=10.0, depth_mm=1.5, position_mm=35.0),
        contact_circle=None,
        mm_per_px=None,
        source="test",
    )


def sweep(last_deg: float = 120.0) -> LightAngleSweep:
    """A clear hill with its top at 35 deg and 0.5 % noise."""
    angles_deg = np.arange(0.0, last_deg + 1, 10.0)
    hill = 0.4 + np.exp(-0.5 * ((angles_deg - BEST_DEG) / 20.0) ** 2)
    noise = np.random.default_rng(2).standard_normal((angles_deg.size, 6))
    return LightAngleSweep(
        name="hill",
        objective="brightness",
        label="made up",
        angles_deg=angles_deg,
        values=hill[:, None] * (1 + 0.005 * noise),
        basis=np.ones((angles_deg.size, 6, 2, 3)),
        bands=("red", "green", "blue"),
        probe_points_mm=np.zeros((2, 3)),
        design=FingerDesign(),
        paints={},
    )
