"""The table of every region: how far each candidate is from the capture."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import RegionError
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.error_rows import ComparedRegion, error_row
from finray_calib.compare.input_draws import Drawn
from finray_calib.compare.linear_image import full_scale_dn
from finray_calib.compare.photometric_error import ErrorDraws
from finray_calib.compare.shown_candidates import ShownCandidate

Floats = NDArray[np.float64]
CHROMATICITY_DRAWS = 100


def region_records(
    comparison: Comparison,
    draws: ErrorDraws,
    candidates: dict[str, ShownCandidate],
    clipped: NDArray[np.bool_],
    capture: TactileCapture,
    conditioned: Drawn | None,
) -> tuple[RegionError, ...]:
    """Return the table of every region.

    Parameters
    ----------
    comparison, draws
        Both sides, and the draws of every region.
    candidates
        The images by name.
    clipped : ndarray of bool, shape (H, W)
        Where a captured image is at full scale.
    capture
        Tells encoding and full scale.
    conditioned
        Draws of the inputs, for the interval of the simulation's chromaticity; without them it has no width.
    """
    weights = None if conditioned is None else _drawn_weights(comparison, conditioned)
    records = []
    for i, (region, used) in enumerate(zip(comparison.regions, comparison.used, strict=True)):
        compared = _compared(comparison, draws, capture, i)
        drawn = {} if weights is None else {"simulation": _drawn_images(comparison, weights, used)}
        records.append(
            RegionError(
                region=region.name,
                factor=region.factor,
                pixels=int(used.sum()),
                clipped_fraction=float(clipped[region.mask].mean()),
                rows=tuple(error_row(name, c, compared, drawn.get(name)) for name, c in candidates.items()),
            )
        )
    return tuple(records)


def _compared(comparison: Comparison, draws: ErrorDraws, capture: TactileCapture, i: int) -> ComparedRegion:
    """Return what the rows of region `i` share."""
    captured = comparison.captured
    return ComparedRegion(
        captured=captured.contact,
        captured_variance=captured.variance(captured.contact),
        used=comparison.used[i],
        result=draws.regions[i],
        best=None if draws.whole is None else draws.whole[i],
        channel_weights=comparison.channel_weights,
        data_range_dn=full_scale_dn(capture),
        linear=capture.encoding == "linear",
        is_headline=i == len(comparison.regions) - 1,
        told=comparison.sums[i].told,
    )


def _drawn_weights(comparison: Comparison, drawn: Drawn) -> Floats:
    """Return the weights of the render's layers at the level of the capture, (draws, 3, L), for the first draws."""
    return (comparison.exposure_of(drawn.matrix)[:, None, None] * drawn.weights)[:CHROMATICITY_DRAWS]


def _drawn_images(comparison: Comparison, weights: Floats, used: NDArray[np.bool_]) -> Floats:
    """Return the render at the pixels of a region, (draws, P, 3)."""
    poses = () if comparison.inputs is None else comparison.inputs.pose_names
    first, second = comparison.layers.halves("contact", used, poses)
    return np.asarray(np.einsum("dcl,pl->dpc", weights, (first + second) / 2.0))
