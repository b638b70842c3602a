"""How far the scale scatters when pictures of the board are drawn with replacement, and what that asks for."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from data_schemas.pixel_scale import LARGEST_WIDENED_FACTOR
from finray_calib.compare.board_corners import BoardView
from finray_calib.compare.board_plane import Declared, fitted_plane
from finray_calib.compare.lens_calibration import POSE, LensCalibration, adjust, project
from finray_calib.compare.pixel_scale import ScaleDraws, scales_only

Floats = NDArray[np.float64]

RESAMPLINGS = 60
"""Standard deviations from as many are good to a tenth."""
#: Resampled pictures scatter by up to this factor more by chance; beyond it corners of one picture err together.
_SCATTER_FACTOR = 1.5


def resampled_scatter_rel(
    views: Sequence[BoardView], found: LensCalibration, declared: Declared, middle_px: Floats, rng: np.random.Generator
) -> float:
    """Return the relative scatter of the mean scale over pictures drawn with replacement.

    The picture of the pad is one of a kind: its corners get the residuals of its own corners, drawn with replacement.

    Parameters
    ----------
    views
        The board on the pad, then in other places.
    found
        Lens and places that all of them give.
    declared
        Tolerances that no picture shows.
    middle_px
        (2,) where on the pad the scale is asked for.
    rng
        Of the drawing.

    Raises
    ------
    CompareError
        Without one or two of the pictures the lens is not determined.
    """
    pad, count = views[0], len(views) - 1
    fitted = _fitted_pixels(found, pad)
    errors = pad.pixels - fitted
    # residuals are smaller than errors by what the pose took
    errors *= np.sqrt(errors.size / max(errors.size - POSE, 1))
    values = []
    for _ in range(RESAMPLINGS):
        drawn = BoardView(pad.name, pad.places_mm, fitted + errors[rng.integers(len(errors), size=len(errors))])
        weights = np.concatenate([[1], np.bincount(rng.integers(count, size=count), minlength=count)]).astype(float)
        kept = weights > 0
        chosen = [drawn, *(view for view, keep in zip(views[1:], kept[1:], strict=True) if keep)]
        try:
            again = adjust(
                chosen, (found.width_px, found.height_px), found.model, found.lens, found.poses[kept], weights[kept]
            )
        except CompareError:
            continue
        values.append(float(np.log(scales_only(fitted_plane(again, declared), middle_px[None])[0, 2])))
    usable = np.array([v for v in values if np.isfinite(v)])
    if len(usable) < RESAMPLINGS // 2:
        raise CompareError(
            "the lens rests on too few pictures: without one or two of them it is not determined. Take more, with the "
            "board tilted in several directions"
        )
    # quantiles: a draw of few alike pictures may lie far out
    low, high = np.quantile(usable, [0.1587, 0.8413])
    return float(high - low) / 2.0


def _fitted_pixels(found: LensCalibration, pad: BoardView) -> Floats:
    """Return where the corners of the first view should be."""
    places = np.column_stack([pad.places_mm, np.zeros(len(pad.places_mm))])
    return project(found.model, found.lens, found.poses[0], places)[0]


def widened_factor(resampled_u_rel: float, at_middle: ScaleDraws) -> float:
    """Return the factor on the covariance's standard deviations that resampling asks for.

    Raises
    ------
    CompareError
        The factor is larger than can be stated.
    """
    parts = at_middle.parts_rel
    of_covariance = float(np.hypot(parts["corners of the board on the pad"][0, 2], parts["lens"][0, 2]))
    # corners without any error leave nothing to widen
    ratio = resampled_u_rel / of_covariance if of_covariance > 0.0 else 1.0
    if ratio > LARGEST_WIDENED_FACTOR:
        raise CompareError(
            f"the scale scatters {ratio:.0f} times as much when pictures are drawn with replacement as independent "
            f"corners allow; up to {LARGEST_WIDENED_FACTOR:g} times can be stated: the lens rests on one or two of the "
            "pictures, or the board was not rigid. Take more pictures"
        )
    return ratio if ratio > _SCATTER_FACTOR else 1.0
