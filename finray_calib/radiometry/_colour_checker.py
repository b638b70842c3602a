"""Find a ColorChecker in a raw frame and measure its patches in linear camera values.

OpenCV's chart detector proposes where the chart lies, at several magnifications; what it proposes is kept only if
the colours of the 24 patches are those of a ColorChecker, either way up. The detector sees a
tone-mapped image; the patches are measured in linear values.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import RadiometryError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
ROWS, COLUMNS = 4, 6
PATCHES = ROWS * COLUMNS
# Shorter side that the detector works at (px): small charts need magnification, large ones the opposite.
SHORTER_SIDES_PX = (1000, 500, 2000)
DISPLAY_GAMMA = 2.2
WHITE_PERCENTILE = 99.5
# Of the patch that the detector marks, only the middle is measured: its corners are good to a few pixels.
MEASURED_SHARE = 0.6
# Below this a misplaced corner reaches the neighbouring patch: charts of 60 cells' width were read wrong by up to 27 %.
SMALLEST_PATCH_PIXELS = 14
LARGEST_CLIPPED_FRACTION = 1e-3
# Relative residual of a linear map from the patches to the reference colours. Charts in the right place and the right
# way round stay below 0.07 with the cameras and lights tried; turned or shifted by one patch they are above 0.9.
LARGEST_MISMATCH_REL = 0.15
# As good as it gets: no other magnification needs to be tried.
GOOD_MISMATCH_REL = 0.075


@dataclass(frozen=True, slots=True)
class ColourCheckerPatches:
    """Linear values of the 24 patches, from "dark skin" row by row to "black".

    Attributes
    ----------
    mean_dn, sd_dn
        (24, 3) mean and standard deviation over the pixels of a patch.
    pixels
        (24,) Bayer cells measured.
    corners_px
        (4, 2) corners of the chart (column, row) in Bayer cells, first the one beside "dark skin", then clockwise.
    mismatch_rel
        Relative residual of the linear map to the reference colours.
    """

    mean_dn: Floats
    sd_dn: Floats
    pixels: NDArray[np.int64]
    corners_px: Floats
    mismatch_rel: float


def linear_cells(counts: NDArray[np.uint16], dark_dn: Floats | float, full_scale_dn: int) -> Floats:
    """Return one linear RGB value per 2 x 2 cell of an RGGB frame, (H/2, W/2, 3) in DN; clipped cells are NaN.

    Parameters
    ----------
    counts
        (H, W) raw counts (DN).
    dark_dn
        Dark frame (H, W) or one level (DN).
    full_scale_dn
        Largest count (DN).
    """
    linear = np.where(counts >= full_scale_dn, np.nan, counts - dark_dn)
    green = (linear[0::2, 1::2] + linear[1::2, 0::2]) / 2
    return np.stack([linear[0::2, 0::2], green, linear[1::2, 1::2]], axis=-1)


def find_colour_checker(linear_rgb: Floats, reference: Floats) -> ColourCheckerPatches:
    """Find a ColorChecker Classic and measure its patches.

    Parameters
    ----------
    linear_rgb
        (H, W, 3) linear camera values (DN), NaN where clipped. The chart may be tilted and turned; its patches need
        about 10 cells a side.
    reference
        (24, 3) linear colours of the patches in any basis (such as XYZ), in the chart's order.

    Returns
    -------
    ColourCheckerPatches

    Raises
    ------
    RadiometryError
        No chart is found, or patches of the chart are clipped.
    """
    best: tuple[ColourCheckerPatches, Floats] | None = None
    for quads in _proposals(linear_rgb):
        for turned in (quads, quads[::-1]):  # the detector may read a chart upside down
            measured = _measure(linear_rgb, turned, reference)
            if measured is not None and (best is None or measured[0].mismatch_rel < best[0].mismatch_rel):
                best = measured
        if best is not None and best[0].mismatch_rel < GOOD_MISMATCH_REL:
            break
    if best is None or best[0].mismatch_rel > LARGEST_MISMATCH_REL:
        seen = "" if best is None else f" (the colours of the best candidate differ by {best[0].mismatch_rel:.0%})"
        raise RadiometryError(
            f"no ColorChecker is found in the frame of {linear_rgb.shape[0]} x {linear_rgb.shape[1]} cells{seen}: the "
            "whole chart must be in view and unshaded, its patches at least 10 cells (20 px) a side"
        )
    patches, clipped = best
    if clipped.max() > LARGEST_CLIPPED_FRACTION:
        numbers = ", ".join(str(n + 1) for n in np.flatnonzero(clipped > LARGEST_CLIPPED_FRACTION))
        raise RadiometryError(
            f"patches {numbers} of the ColorChecker are clipped (at most {LARGEST_CLIPPED_FRACTION:.1%} of a patch may "
            "be at full scale); use a shorter exposure"
        )
    return patches


def _proposals(linear_rgb: Floats) -> Iterator[Floats]:
    """Yield (24, 4, 2) corners (x, y) of the middle parts of the patches, as the detector sees them."""
    shown = _displayed(linear_rgb)
    shorter = min(shown.shape[:2])
    for side in SHORTER_SIDES_PX:
        scale = side / shorter
        size = (round(shown.shape[1] * scale), round(shown.shape[0] * scale))
        resized = cv2.resize(shown, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        detector = cv2.mcc.CCheckerDetector.create()
        parameters = detector.getDetectionParams()
        parameters.minImageSize = side  # else the detector magnifies by itself
        detector.setDetectionParams(parameters)
        detector.setColorChartType(cv2.mcc.MCC24)
        if detector.process(resized, 1):
            corners = np.asarray(detector.getBestColorChecker().getColorCharts(), dtype=np.float64)
            # Pixel centres: (x + 1/2) scales, not x.
            yield (corners.reshape(PATCHES, 4, 2) + 0.5) / scale - 0.5


def _displayed(linear_rgb: Floats) -> NDArray[np.uint8]:
    """Return an 8-bit BGR image: channels scaled to a common white, gamma 2.2; for detection only."""
    white = np.nanpercentile(linear_rgb.reshape(-1, 3), WHITE_PERCENTILE, axis=0)
    relative = np.nan_to_num(linear_rgb / np.maximum(white, 1e-9), nan=1.0)
    encoded = np.clip(relative, 0.0, 1.0) ** (1.0 / DISPLAY_GAMMA)
    return np.ascontiguousarray(np.rint(255.0 * encoded[..., ::-1]), dtype=np.uint8)


def _measure(linear_rgb: Floats, quads: Floats, reference: Floats) -> tuple[ColourCheckerPatches, Floats] | None:
    """Return the patches and their clipped fractions (24,); None if a patch is too small or outside the frame."""
    middle = quads.mean(axis=1, keepdims=True)
    measured = middle + MEASURED_SHARE * (quads - middle)
    values = [linear_rgb[_inside(quad, linear_rgb.shape[:2])] for quad in measured]
    if min(len(v) for v in values) < SMALLEST_PATCH_PIXELS:
        return None
    clipped = np.array([np.isnan(v).any(axis=1).mean() for v in values])
    # A patch that is clipped as a whole counts with the brightest value seen, so that the chart can still be told.
    brightest = np.nanmax(linear_rgb.reshape(-1, 3), axis=0)
    filled = [np.where(np.isnan(v), brightest, v) for v in values]
    mean_dn = np.array([v.mean(axis=0) for v in filled])
    mapped = mean_dn @ np.linalg.lstsq(mean_dn, reference, rcond=None)[0]
    patches = ColourCheckerPatches(
        mean_dn=mean_dn,
        sd_dn=np.array([v.std(axis=0) for v in filled]),
        pixels=np.array([len(v) for v in values]),
        corners_px=_chart_corners(middle[:, 0]),
        mismatch_rel=float(np.linalg.norm(mapped - reference) / np.linalg.norm(reference - reference.mean(axis=0))),
    )
    return patches, clipped


def _inside(quad: Floats, shape: tuple[int, ...]) -> Mask:
    """Return the mask (H, W) of the cells inside a quadrilateral given as (x, y)."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(quad).astype(np.int32), 1)
    return mask.astype(bool)


def _chart_corners(centers: Floats) -> Floats:
    """Return the corners of the 6 x 4 grid of cells around the patch centres, from a homography through them."""
    grid = np.array([[column + 0.5, row + 0.5] for row in range(ROWS) for column in range(COLUMNS)])
    homography, _ = cv2.findHomography(grid, centers)
    outer = np.array([[[0.0, 0.0], [COLUMNS, 0.0], [COLUMNS, ROWS], [0.0, ROWS]]])
    return np.asarray(cv2.perspectiveTransform(outer, homography)[0], dtype=np.float64)
