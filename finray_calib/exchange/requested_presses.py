"""The presses that a capture request asks for: places and depths that suit a design's pad."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import RecordError

BALL_PRESSES: Final = 18

_BALL_DEPTHS_REL = (0.1, 0.2, 0.3)
_PRESS_DEPTHS_REL = (1.0 / 3.0, 2.0 / 3.0, 1.0)
_LARGEST_BALL_MM = 4.0
# the contact circle of the deepest press stays this far inside what is seen of the pad
_RIM_MM = 0.5
_ACROSS_REL = (-0.6, 0.0, 0.6)


@dataclass(frozen=True, slots=True)
class PlannedView:
    """What the camera is planned to see of the pad: from where to where, and how large a raw pixel is there."""

    along_mm: tuple[float, float]
    across_mm: tuple[float, float]
    mm_per_px: float
    mm_per_px_u_rel: float


@dataclass(frozen=True, slots=True)
class Press:
    """One press: how deep, where along the pad from its base, and how far across from its middle line."""

    depth_mm: float
    position_mm: float
    across_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class IndenterPresses:
    """Presses of one indenter."""

    shape: str
    radius_mm: float
    presses: Sequence[Press]


def ball_presses(design: FingerDesign, view: PlannedView) -> IndenterPresses:
    """Return presses of a ball that suits the pad, all over what the camera sees; depths are shares of its thickness.

    Raises
    ------
    RecordError
        What is seen of the pad is too small for a ball.
    """
    pad = design.pad
    deepest = max(_BALL_DEPTHS_REL) * pad.thickness_mm
    radius = min(_LARGEST_BALL_MM, pad.width_mm / 4.0)
    rim = float(np.sqrt(2.0 * radius * deepest - deepest**2)) + _RIM_MM if deepest < radius else np.inf
    base, tip = max(0.0, view.along_mm[0]), min(pad.length_mm, view.along_mm[1])
    half = min(pad.width_mm / 2.0, -view.across_mm[0], view.across_mm[1])
    if 2.0 * rim >= min(tip - base, 2.0 * half):
        raise RecordError(
            f"pad: {pad.length_mm:g} x {pad.width_mm:g} x {pad.thickness_mm:g} mm, of which "
            f"{max(tip - base, 0.0):.1f} x {max(2.0 * half, 0.0):.1f} mm are seen, leaves no room for presses of a "
            f"ball of {radius:g} mm radius to {deepest:g} mm; a normal map cannot be asked for"
        )
    reach_mm = half - rim
    columns = BALL_PRESSES // len(_ACROSS_REL)
    along = np.linspace(base + rim, tip - rim, columns)
    presses = [
        # neither along nor across do all presses of one depth stand in line
        Press(_BALL_DEPTHS_REL[(i + j) % len(_BALL_DEPTHS_REL)] * pad.thickness_mm, float(z), share * reach_mm)
        for i, z in enumerate(along)
        for j, share in enumerate(_ACROSS_REL)
    ]
    return IndenterPresses("ball", radius, presses)


def indenter_presses(design: FingerDesign) -> IndenterPresses:
    """Return presses of the design's own indenter at its place, up to its depth.

    Raises
    ------
    RecordError
        The indenter is none that a tactile plan knows, or does not press.
    """
    indenter = design.indenter
    if indenter.shape not in ("cylinder", "ball") or indenter.depth_mm <= 0.0:
        raise RecordError(
            f"indenter.shape = {indenter.shape!r}, depth_mm = {indenter.depth_mm:g} mm: a capture request needs a "
            "cylinder or a ball that is pressed in; change the design's indenter"
        )
    presses = [Press(share * indenter.depth_mm, indenter.position_mm) for share in _PRESS_DEPTHS_REL]
    return IndenterPresses(indenter.shape, indenter.radius_mm, presses)
