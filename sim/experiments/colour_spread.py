"""How sure the colours of a rendered press are: the camera's response at the LED is known poorly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from data_schemas.simulate import SimulatedPress
from sim.experiments.tactile_camera import press_design

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ColourSpread:
    """How far the camera's unknown response at the LED moves the colours of the pad.

    Attributes
    ----------
    response_uncertainty_rel
        Standard uncertainty of each channel's response in the LED's band, independent of each other.
    led_share
        Share of the LED's band in red, green and blue over the coat, (3,).
    sd_rel
        Relative standard deviation of the mean red, green and blue over the coat, (3,).
    ratio_sd_rel
        Relative standard deviation of red / blue and green / blue, which is the picture's colour, (2,).
    """

    response_uncertainty_rel: float
    led_share: Floats
    sd_rel: Floats
    ratio_sd_rel: Floats

    def __str__(self) -> str:
        """Say it in one line."""
        shares, sds, ratios = (
            [f"{v:.0%}" for v in values] for values in (self.led_share, self.sd_rel, self.ratio_sd_rel)
        )
        return (
            f"camera response at the LED uncertain by {self.response_uncertainty_rel:.0%}: red, "
            f"green, blue hold {', '.join(shares)} LED light and are uncertain by {', '.join(sds)}; red / blue by "
            f"{ratios[0]}, green / blue by {ratios[1]}"
        )


def colour_spread(press: SimulatedPress, seed: int, draws: int = 400) -> ColourSpread:
    """Return the spread of the colours from draws of the camera matrix; nothing is rendered.

    The response of each channel in the LED's band is multiplied by a log-normal factor of mean 1 and of the
    standard deviation camera.response_at_led_uncertainty_rel of the design.

    Parameters
    ----------
    press
        A rendered press, with its bands and camera matrix.
    seed
        Of the draws.
    draws
        Number of draws; with 400 a standard deviation is known to 4 %.

    Raises
    ------
    SimulateError
        When the press holds no bands or no design.
    """
    design = press_design(press)
    bands, matrix = press.contact_bands, press.camera_matrix
    if bands is None or matrix is None or "led" not in press.bands:
        raise SimulateError(f"{press.name} holds no band images: only a rendered press tells what its colours rest on")
    mean = bands[np.isfinite(press.distance)].astype(np.float64).mean(axis=0)
    led, uncertainty = press.bands.index("led"), design.camera.response_at_led_uncertainty_rel
    sigma = np.sqrt(np.log1p(uncertainty**2))
    factors = np.exp(sigma * np.random.default_rng([seed, 2]).standard_normal((draws, 3)) - 0.5 * sigma**2)
    from_led, total = matrix[:, led] * mean[led], matrix @ mean
    colours = total + (factors - 1.0) * from_led
    ratios = colours[:, :2] / colours[:, 2:]
    return ColourSpread(
        response_uncertainty_rel=uncertainty,
        led_share=from_led / total,
        sd_rel=colours.std(axis=0, ddof=1) / total,
        ratio_sd_rel=ratios.std(axis=0, ddof=1) / ratios.mean(axis=0),
    )
