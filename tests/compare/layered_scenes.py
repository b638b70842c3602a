"""Layers and captures of a small scene, made for single parts of a comparison."""

import numpy as np

from finray_calib.compare._image_noise import NO_NOISE
from finray_calib.compare._region_sums import Captured, RenderLayers

SHAPE = (48, 64)
EVERYWHERE = np.ones(SHAPE, bool)
MATRIX = np.array([[0.9, 0.1, 0.05], [0.2, 0.8, 0.1], [0.02, 0.1, 1.2]])


def layers_of(contact, no_contact, matrix=MATRIX, noise=None, pose=None, names=("red", "green", "led"), inputs=None):
    """Return layers; `noise` holds half the differences of both states, `pose` derivatives by name."""
    dark = np.zeros(np.shape(contact), np.float32)
    contact_half, no_contact_half = noise or (dark, dark)
    derivatives = np.array(list((pose or {}).values()), np.float32).reshape(-1, *np.shape(contact))
    return RenderLayers(
        contact=np.asarray(contact, np.float32),
        no_contact=np.asarray(no_contact, np.float32),
        contact_half=np.asarray(contact_half, np.float32),
        no_contact_half=np.asarray(no_contact_half, np.float32),
        pose=derivatives,
        pose_half=np.zeros_like(derivatives),
        pose_names=tuple(pose or {}),
        names=names,
        matrix=matrix,
        inputs=inputs,
    )


def smooth_layers():
    """Return layers (H, W, 3) without and with a press that changes each of them otherwise."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] / 48.0
    base = np.stack([1.0 + 0.3 * columns, 0.8 + 0.2 * rows, 1.2 - 0.2 * columns], axis=-1)
    bump = np.exp(-(((rows - 0.5) / 0.2) ** 2))[..., None] * np.array([0.5, -0.3, 0.35])
    return base.astype(np.float32).astype(float), (base * (1.0 - bump)).astype(np.float32).astype(float)


def captured_of(contact, no_contact, repeat=None, noise=NO_NOISE):
    return Captured(np.asarray(contact, float), np.asarray(no_contact, float), repeat, noise)
