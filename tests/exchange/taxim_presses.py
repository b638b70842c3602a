"""Ball presses on the sensor of closed form, as the renderer would give them."""

import numpy as np

from sim.experiments import BallPresses
from tests.compare.three_lights import LEVEL_DN, dent_slopes, shaded

SHAPE_PX = (96, 128)
MM_PER_PX = 0.1
BALL_MM = 2.0
UNIT = 1.0 / LEVEL_DN


def closed_form_presses(count, seed=1):
    """Presses at random places and depths, 0.4 to 0.8 mm."""
    rng = np.random.default_rng(seed)
    row, column = rng.uniform(20, 76, count), rng.uniform(20, 108, count)
    depth_mm = rng.uniform(0.4, 0.8, count)
    radius = np.sqrt(2.0 * BALL_MM * depth_mm - depth_mm**2) / MM_PER_PX
    slopes = np.stack(
        [dent_slopes(*circle, BALL_MM / MM_PER_PX, SHAPE_PX) for circle in zip(row, column, radius, strict=True)]
    )
    rows, columns = np.indices(SHAPE_PX)
    distance = np.hypot(rows - row[:, None, None], columns - column[:, None, None]) / radius[:, None, None]
    return BallPresses(
        no_contact=(UNIT * shaded(np.zeros((*SHAPE_PX, 2)))).astype(np.float32),
        contacts=np.stack([UNIT * shaded(s) for s in slopes]).astype(np.float32),
        slopes=slopes,
        distance=distance,
        row_px=row,
        column_px=column,
        radius_px=radius,
        ball_radius_mm=BALL_MM,
        thickness_mm=4.0,
        mm_per_px=MM_PER_PX,
        label="closed form",
    )
