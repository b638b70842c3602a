"""From tactile captures of ball presses to a stored normal map, and back to the map that senses."""

from collections.abc import Sequence

import numpy as np

from data_schemas.capture import ContactCircle, TactileCapture
from data_schemas.errors import CompareError
from data_schemas.sensing import NormalMapRecord
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.normal_map import NormalMap
from finray_calib.compare.normal_map_fit import CalibrationPress, fit_normal_map, held_out_score

# scales of one camera differ by rounding only
_SAME_SCALE_REL = 1e-6
# a scale that was measured twice
_NEAR_SCALE_REL = 0.02


def normal_map_record(captures: Sequence[TactileCapture], name: str, seed: int) -> NormalMapRecord:
    """Fit a normal map to captures of ball presses, with its score on presses it has not seen.

    Parameters
    ----------
    captures
        At least 12 of one camera, each with a contact circle, a ball's radius and mm per px.
    name
        Of the map.
    seed
        Of the choice of pixels and of the random halves.

    Raises
    ------
    CompareError
        When captures lack what is needed, do not belong together, or are too few.
    """
    presses = [calibration_press(capture) for capture in captures]
    if captures:
        _check_together(captures)
    fitted = fit_normal_map(presses, seed)
    score = held_out_score(presses, seed)
    first = captures[0]
    return NormalMapRecord(
        name=name,
        degree=fitted.degree,
        coefficients=fitted.coefficients,
        lowest_change_rel=fitted.low,
        highest_change_rel=fitted.high,
        height_px=fitted.shape_px[0],
        width_px=fitted.shape_px[1],
        mm_per_px=_scale_mm(first) * _cell_px(first),
        mm_per_px_u_rel=first.mm_per_px_u_rel,
        encoding=first.encoding,
        presses=len(presses),
        held_out_explained_rel=score.explained,
        held_out_angle_deg=score.angle_deg,
        notes=tuple(sorted({capture.source for capture in captures})),
    )


def normal_map_of(record: NormalMapRecord) -> NormalMap:
    """Return the map of a record."""
    return NormalMap(
        coefficients=record.coefficients,
        degree=record.degree,
        low=record.lowest_change_rel,
        high=record.highest_change_rel,
        shape_px=(record.height_px, record.width_px),
    )


def check_senses(record: NormalMapRecord, capture: TactileCapture) -> None:
    """Refuse to apply a map to a capture of another encoding or scale.

    Raises
    ------
    CompareError
        When the capture's encoding or scale is not that of the map's calibration presses.
    """
    if record.encoding != capture.encoding:
        raise CompareError(
            f"{capture.name} holds {capture.encoding} values, the normal map '{record.name}' was taught by "
            f"{record.encoding} ones: fit it to presses of the same camera settings"
        )
    if capture.mm_per_px is not None:
        scale_mm = capture.mm_per_px * _cell_px(capture)
        if not np.isclose(scale_mm, record.mm_per_px, rtol=_NEAR_SCALE_REL, atol=0.0):
            raise CompareError(
                f"{capture.name} has {scale_mm:.4g} mm per pixel, the normal map '{record.name}' "
                f"{record.mm_per_px:.4g}: slopes and depths would be wrong; fit the map to presses at this distance, "
                "or where the capture states a planned scale give the measured one (--scale)"
            )


def calibration_press(capture: TactileCapture) -> CalibrationPress:
    """Return the press of a capture with its circle in pixels of its colour image (a Bayer cell is one pixel).

    Raises
    ------
    CompareError
        When the capture is not of a ball, or its circle or scale is missing.
    """
    circle = require_ball_press(capture)
    cell = _cell_px(capture)
    return CalibrationPress(
        contact=rgb_image(capture.contact, capture),
        no_contact=rgb_image(capture.no_contact, capture),
        row_px=(circle.row_px + 0.5) / cell - 0.5,
        column_px=(circle.column_px + 0.5) / cell - 0.5,
        radius_px=circle.radius_px / cell,
        ball_radius_px=capture.indenter.radius_mm / _scale_mm(capture) / cell,
    )


def require_ball_press(capture: TactileCapture) -> ContactCircle:
    """Return the contact circle of a capture that can teach a normal map.

    Raises
    ------
    CompareError
        When the capture is not of a ball, or its circle or scale is missing.
    """
    circle = capture.contact_circle
    if capture.indenter.shape != "ball" or circle is None:
        raise CompareError(
            f"{capture.name}: a normal map is taught by presses of a ball with a known contact circle; this is a "
            f"{capture.indenter.shape} {'without' if circle is None else 'with'} one"
        )
    _scale_mm(capture)
    return circle


def _scale_mm(capture: TactileCapture) -> float:
    """Return mm per raw pixel."""
    if capture.mm_per_px is None:
        raise CompareError(f"{capture.name}: mm_per_px is missing, so the ball's size in pixels is not known; add it")
    return capture.mm_per_px


def _cell_px(capture: TactileCapture) -> int:
    """Return the raw pixels along the side of a pixel of the colour image."""
    return 1 if capture.layout == "RGB" else 2


def _check_together(captures: Sequence[TactileCapture]) -> None:
    """Refuse captures of different cameras or settings."""
    first = captures[0]
    for capture in captures[1:]:
        for field in ("encoding", "layout", "bit_depth"):
            one, other = getattr(first, field), getattr(capture, field)
            if one != other:
                raise CompareError(
                    f"{capture.name} has {field} {other}, {first.name} {one}: a normal map is taught by captures of "
                    "one camera with one setting"
                )
        if not np.isclose(_scale_mm(capture), _scale_mm(first), rtol=_SAME_SCALE_REL, atol=0.0):
            raise CompareError(
                f"{capture.name} has {_scale_mm(capture):g} mm per px, {first.name} {_scale_mm(first):g}: a normal map "
                "is taught by captures of one camera at one distance"
            )
