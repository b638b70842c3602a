"""A synthetic press with known contact signal, shared by the tests of this folder."""

import numpy as np

from finray_calib.compare import disc

CENTER_PX = (40.0, 50.0)
RADIUS_PX = 20.0
SHAPE = (80, 100)


def press(rng, noise_dn=1.0):
    """Return no-contact image, capture, contact mask: a bump that dims each channel, plus noise."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ramp = 100 + 0.3 * columns + 0.2 * rows
    no_contact = np.stack([ramp, 0.5 * ramp, 0.1 * ramp], axis=-1)
    distance = np.hypot(rows - CENTER_PX[0], columns - CENTER_PX[1]) / RADIUS_PX
    bump = 0.3 * np.exp(-(distance**2))
    captured = no_contact * (1 - bump[..., None]) + noise_dn * rng.standard_normal(no_contact.shape)
    return no_contact, captured, disc(SHAPE, CENTER_PX, RADIUS_PX)
