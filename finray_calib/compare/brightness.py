"""The sweep's objective as seen in an image: brightness beside the indenter, simulated against captured."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import Interval, ObjectiveError
from data_schemas.errors import CompareError
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.input_draws import Drawn, Inputs
from finray_calib.compare.stopping_rule import ends

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
# The paper reads "a point near the indenter": a ring from the edge of the contact to half a half-width beyond.
RING = (1.0, 1.5)
STORED_DRAWS = 500


@dataclass(frozen=True, slots=True)
class BrightnessDraws:
    """Hold draws (draws, 3) of ln(k simulated / captured) per channel, and of the exposure factor k (draws,)."""

    log_ratio: Floats
    exposure: Floats

    def error_rel(self, captured_share: Floats) -> Floats:
        """Return draws (draws,) of simulated / captured - 1 of the white-balanced brightness.

        `captured_share` (3,) is the captured brightness of each channel over its own no-contact level.
        """
        return np.asarray(np.exp(self.log_ratio) @ captured_share / captured_share.sum() - 1.0)


def ring_of(distance: Floats, usable: Bools) -> Bools:
    """Return the usable pixels 1 to 1.5 contact half-widths from the indenter.

    Parameters
    ----------
    distance : ndarray, shape (H, W)
        From the contact's centre in half-widths, NaN off the pad.
    usable : ndarray of bool, shape (H, W)

    Raises
    ------
    CompareError
        There is none.
    """
    ring = usable & (distance >= RING[0]) & (distance <= RING[1])
    if not ring.any():
        raise CompareError(
            f"no usable pixel lies {RING[0]:g} to {RING[1]:g} contact half-widths from the indenter: the press is too "
            "near the edge of the image, or the image is clipped there"
        )
    return ring


def brightness_draws(
    comparison: Comparison, inputs: Inputs, ring: Bools, drawn: Drawn, rng: np.random.Generator | None
) -> BrightnessDraws:
    """Return the brightness beside the indenter for draws; noise of the pixels varies where there is a generator.

    Parameters
    ----------
    comparison, inputs
        Both sides and what is uncertain.
    ring : ndarray of bool, shape (H, W)
    drawn
        Draws of the inputs.
    rng
        Generator of the noise.
    """
    draws = len(drawn.log_drift)
    exposure = comparison.exposure_of(drawn.matrix, rng)
    first, second = comparison.layers.halves("contact", ring, inputs.pose_names)
    simulated = exposure[:, None] * (drawn.weights @ ((first + second) / 2.0).mean(axis=0))
    contact = comparison.captured.contact
    captured = drawn.drift[:, None] * contact[ring].mean(axis=0)
    if rng is not None:
        count = ring.sum()
        captured_sd = np.sqrt(comparison.captured.variance(contact)[ring].mean(axis=0) / count)
        render_sd = comparison.best_exposure * np.sqrt(comparison.layers.contact_variance[ring].mean(axis=0) / count)
        captured = captured + captured_sd * rng.standard_normal((draws, 3))
        simulated = simulated + render_sd * rng.standard_normal((draws, 3))
    return BrightnessDraws(np.log(np.maximum(simulated, 1e-300) / np.maximum(captured, 1e-300)), exposure)


def captured_share(comparison: Comparison, ring: Bools, pad: Bools) -> Floats:
    """Return the captured brightness of the ring per channel, over the pad's level without contact, (3,)."""
    captured = comparison.captured
    usable = pad & np.isfinite(captured.no_contact).all(axis=2)
    return np.asarray(captured.contact[ring].mean(axis=0) / captured.no_contact[usable].mean(axis=0))


def objective_error(
    comparison: Comparison,
    inputs: Inputs,
    ring: Bools,
    share: Floats,
    capture: TactileCapture,
    rng: np.random.Generator,
) -> ObjectiveError:
    """Return the record of the error of the sweep's objective, with draws that reports can share."""
    draws = brightness_draws(comparison, inputs, ring, inputs.draw(STORED_DRAWS, rng, paired=True), rng)
    error = draws.error_rel(share)
    low, high = ends(error)
    known = comparison.layers.inputs
    exposed = capture.exposure_s is not None and capture.led_current_ma is not None
    log_exposure = None
    if exposed:
        log_exposure = np.log(draws.exposure / ((capture.exposure_s or 1.0) * (capture.led_current_ma or 1.0)))
    return ObjectiveError(
        error_rel=Interval(estimate=float(np.median(error)), low95=float(low), high95=float(high)),
        log_ratio_draws=draws.log_ratio,
        log_exposure_draws=log_exposure,
        source="; ".join(known.keys) if known is not None else "no input with a known uncertainty",
        rig=capture.rig,
    )
