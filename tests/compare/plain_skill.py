"""The skill as its formula is written, pixel by pixel: the reference for the sums that a comparison forms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError
from finray_calib.compare._comparison import channel_weights
from finray_calib.compare._regions import pixels_within, usable_pixels


@dataclass(frozen=True, slots=True)
class SkillScore:
    """Hold the skill of one simulation over one region.

    Attributes
    ----------
    skill : float
        1 explains the whole contact signal, 0 is doing nothing, below 0 is worse than nothing.
    per_channel_skill : ndarray, shape (C,)
        The same for each channel alone; NaN for a channel that contact does not change at all.
    weights : ndarray, shape (C,)
        Weight of each channel's squared error in `skill`.
    pixels_used, pixels_left_out : int
        Pixels of the region that entered, and that did not because a value was not finite.
    """

    skill: float
    per_channel_skill: NDArray[np.float64]
    weights: NDArray[np.float64]
    pixels_used: int
    pixels_left_out: int


def skill_score(
    simulated: NDArray[np.float64],
    captured: NDArray[np.float64],
    no_contact: NDArray[np.float64],
    mask: NDArray[np.bool_],
    weights: NDArray[np.float64] | None = None,
    exposure_k: float = 1.0,
) -> SkillScore:
    """Return the share of the contact signal that a simulation explains.

    E = 1 - sum_c w_c sum_p (k S - D)^2 / sum_c w_c sum_p (B - D)^2

    with simulation S, capture D, no-contact image B, over the pixels p of the region and the channels c. With
    S = B and k = 1 it is exactly 0. It is a statement about linear light; on encoded images it is a
    similarity of code values only. It depends on the region, which belongs beside the number.

    Parameters
    ----------
    simulated, captured, no_contact : ndarray, shape (H, W, C)
        Registered images in one unit; pixels that are not finite in any of them are left out.
    mask : ndarray of bool, shape (H, W)
    weights : ndarray, shape (C,), optional
        Per-channel weights; default `channel_weights`, ones for the plain pooled score.
    exposure_k : float
        Factor on the simulation, see :mod:`finray_calib.compare._comparison`.

    Returns
    -------
    SkillScore

    Raises
    ------
    CompareError
        If shapes or weights are wrong, no pixel is usable, or contact changes no weighted channel.

    References
    ----------
    The mean-squared-error skill score of A. H. Murphy, Monthly Weather Review 116 (1988) 2417, with the
    no-contact image as reference forecast.
    """
    simulation, capture, background = (np.asarray(i, dtype=np.float64) for i in (simulated, captured, no_contact))
    used = usable_pixels(mask, simulation, capture, background)
    channel_weight = channel_weights(background, used) if weights is None else weights
    real = pixels_within(capture, used)
    residual, change = exposure_k * pixels_within(simulation, used) - real, pixels_within(background, used) - real
    error, signal = (np.einsum("pc,pc->c", image, image) for image in (residual, change))
    if not channel_weight @ signal > 0:
        raise CompareError(
            "The capture equals the no-contact image over the whole region, so there is no contact signal to "
            "explain. Check that the two files differ and that the region covers the contact."
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        per_channel = np.where(signal > 0, 1 - error / signal, np.nan)
    pixels = int(used.sum())
    skill = float(1 - (channel_weight @ error) / (channel_weight @ signal))
    return SkillScore(skill, per_channel, channel_weight, pixels, int(mask.sum()) - pixels)
