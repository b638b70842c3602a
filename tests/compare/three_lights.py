"""A sensor of closed form: Lambertian gel under three distant lights, one per colour, and balls pressed into it."""

import numpy as np

from finray_calib.sensing import CalibrationPress

SHAPE_PX = (60, 80)
BALL_PX = 20.0
LEVEL_DN = 100.0
# directions to the lights, a third of a turn apart, 45 deg above the gel
LIGHTS = np.array(
    [[np.cos(a) * np.sqrt(0.5), np.sin(a) * np.sqrt(0.5), np.sqrt(0.5)] for a in np.radians([0.0, 120.0, 240.0])]
)


def shaded(slopes):
    """Colours (..., 3) of a gel of these slopes (..., 2): level x (normal . light), brighter towards the right."""
    normal = np.concatenate([-slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    image = LEVEL_DN * np.maximum(normal @ LIGHTS.T, 0.0)
    falloff = 1.0 + 0.2 * np.linspace(-1.0, 1.0, image.shape[-2])
    return image * falloff[:, None]


def dent_slopes(row_px, column_px, radius_px, ball_px=BALL_PX, shape=SHAPE_PX):
    """Slopes (H, W, 2) of a flat gel with a ball in it; nothing bulges."""
    rows, columns = np.indices(shape, dtype=float)
    offset = np.stack([columns - column_px, rows - row_px], axis=-1)
    inside = (offset**2).sum(axis=-1) <= radius_px**2
    height = np.sqrt(np.maximum(ball_px**2 - (offset**2).sum(axis=-1), 1e-9))
    return np.where(inside[..., None], -offset / height[..., None], 0.0)


def ball_press(row_px, column_px, radius_px, noise_dn=0.0, rng=None, ball_px=BALL_PX):
    """A press of the ball with its circle."""
    images = [shaded(dent_slopes(row_px, column_px, radius_px, ball_px)), shaded(np.zeros((*SHAPE_PX, 2)))]
    if rng is not None:
        images = [image + noise_dn * rng.standard_normal(image.shape) for image in images]
    return CalibrationPress(images[0], images[1], row_px, column_px, radius_px, ball_px)


def ball_presses(count, seed=1, noise_dn=0.0):
    """Presses at random places and depths."""
    rng = np.random.default_rng(seed)
    return [
        ball_press(rng.uniform(12, 48), rng.uniform(12, 68), rng.uniform(8, 12), noise_dn, rng) for _ in range(count)
    ]
