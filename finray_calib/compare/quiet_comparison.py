"""A comparison over blocks of pixels, just large enough that noise does not rule its headline."""

import numpy as np

from data_schemas.capture import TactileCapture
from finray_calib.compare.blocks import largest_block_px
from finray_calib.compare.comparison import Comparison, prepare_comparison, require_contact
from finray_calib.compare.input_draws import inputs_of
from finray_calib.compare.prepared_images import PreparedImages
from finray_calib.compare.regions import contact_regions

LARGEST_HEADLINE_NOISE = 0.01
"""Standard deviation of the headline skill from noise alone, from which on pixels are averaged over blocks."""


def quiet_comparison(images: PreparedImages, capture: TactileCapture) -> tuple[PreparedImages, Comparison]:
    """Return images and sums over the smallest blocks that keep noise from ruling the headline.

    Raises
    ------
    CompareError
        Contact changes nothing in a region beyond noise, however large the blocks.
    """
    linear, side, largest = capture.encoding == "linear", 1, largest_block_px(images.distance)
    while True:
        blocked = images if side == 1 else images.blocked(side)
        captured, distance = blocked.captured, blocked.distance
        inputs = None
        if linear:
            inputs = inputs_of(blocked.layers, capture, captured.no_contact, captured.repeat, np.isfinite(distance))
        regions = contact_regions(distance)
        comparison = prepare_comparison(blocked.layers, captured, regions, inputs, linear, linear, demand_contact=False)
        if side >= largest or comparison.headline_noise <= LARGEST_HEADLINE_NOISE:
            require_contact(comparison)
            return blocked, comparison
        side *= 2
