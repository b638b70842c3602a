"""Declared contact regions, which of their pixels may enter a metric, and the tiles that may be resampled.

The score of a simulation depends strongly on the region it is taken over, so a region is always named and
its size factor travels with it. The default set should hold the contact itself (factor 1) and its surround
(factor 2): around an indenter the gel bulges, and only a mechanical model can explain that halo. Square tiles of a
region are its units where neighbouring pixels share their error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError

PATCH, DILATED = "contact patch", "contact patch dilated 2x"
FACTORS = {PATCH: 1.0, DILATED: 2.0}
"""The default set; the last region holds the others and is the headline's."""


@dataclass(frozen=True, slots=True)
class Region:
    """Name a set of pixels to compare.

    Attributes
    ----------
    name : str
        What the region is, for the report ("contact", "contact and halo").
    mask : ndarray of bool, shape (H, W)
        True inside the region; stored as a read-only copy.
    factor : float
        Size of the region in units of the contact's own radius or half-width.

    Raises
    ------
    CompareError
        If the mask is not a two-dimensional boolean array or is empty.
    """

    name: str
    mask: NDArray[np.bool_]
    factor: float

    def __post_init__(self) -> None:
        mask = np.array(self.mask)
        if mask.ndim != 2 or mask.dtype != np.bool_:
            raise CompareError(
                f"Region '{self.name}': the mask must be a boolean array (height, width), got {mask.dtype} "
                f"of shape {mask.shape}. Pass a comparison such as distance <= 2."
            )
        if not mask.any():
            raise CompareError(f"Region '{self.name}' is empty. Check its centre, size and the image shape.")
        mask.flags.writeable = False
        object.__setattr__(self, "mask", mask)


def disc(shape: tuple[int, int], center_px: tuple[float, float], radius_px: float) -> NDArray[np.bool_]:
    """Return the pixels of a disc: (row - row_0)^2 + (column - column_0)^2 <= radius^2.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the image, px.
    center_px : (float, float)
        Row and column of the centre, px; it may lie between pixels or outside the image.
    radius_px : float
        Radius, px.

    Returns
    -------
    ndarray of bool, shape (H, W)

    Raises
    ------
    CompareError
        If no pixel of the image lies in the disc.
    """
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    mask = (rows - center_px[0]) ** 2 + (columns - center_px[1]) ** 2 <= radius_px**2
    if not mask.any():
        raise CompareError(
            f"The disc of radius {radius_px} px around row {center_px[0]}, column {center_px[1]} has no pixel "
            f"in an image of {shape[0]} x {shape[1]} px. Give the centre as (row, column)."
        )
    return np.asarray(mask)


def strip_from_distance(distance_in_half_widths: NDArray[np.float64], factor: float) -> NDArray[np.bool_]:
    """Return the pixels of a contact strip: distance <= factor.

    Parameters
    ----------
    distance_in_half_widths : ndarray of float, shape (H, W)
        Distance of the pad point seen by each pixel from the contact's centre line, in units of the contact's
        half-width; NaN where the pixel does not see the pad.
    factor : float
        Half-width of the strip in units of the contact's half-width.

    Returns
    -------
    ndarray of bool, shape (H, W)

    Raises
    ------
    CompareError
        If no pixel lies in the strip.
    """
    # A comparison with NaN is False, so pixels outside the pad drop out.
    mask = np.asarray(distance_in_half_widths <= factor)
    if not mask.any():
        raise CompareError(
            f"No pixel lies within {factor} half-widths of the contact line. Check that the pad is in view and "
            "that the distance is given in half-widths of the contact."
        )
    return mask


def contact_regions(distance_in_half_widths: NDArray[np.float64]) -> list[Region]:
    """Return the default set of regions around a contact, see :func:`strip_from_distance`."""
    masks = {name: strip_from_distance(distance_in_half_widths, factor) for name, factor in FACTORS.items()}
    return [Region(name, mask, FACTORS[name]) for name, mask in masks.items()]


def usable_pixels(mask: NDArray[np.bool_], *images: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the pixels of a mask that are finite in every channel of every image.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
    *images : ndarray, shape (H, W, C)
        Images of one common shape.

    Returns
    -------
    ndarray of bool, shape (H, W)

    Raises
    ------
    CompareError
        If shapes differ, or no pixel is usable.
    """
    shape = images[0].shape
    if len(shape) != 3 or any(image.shape != shape for image in images):
        shapes = ", ".join(str(image.shape) for image in images)
        raise CompareError(
            f"All images must have the same shape (height, width, channels), got {shapes}. Register and crop the "
            "render to the grid of the capture first."
        )
    if mask.shape != shape[:2]:
        raise CompareError(
            f"The region mask has shape {mask.shape} but the images are {shape[0]} x {shape[1]} px. Make the "
            "region for this image size."
        )
    usable = mask.copy()
    for image in images:
        # a finite sum tells that all of its terms are finite, at a small part of the time of a look at each
        if not np.isfinite(image.sum()):
            usable &= np.isfinite(sum(np.moveaxis(image, 2, 0)))
    if not usable.any():
        raise CompareError(
            f"None of the {int(mask.sum())} pixels of the region is usable: all are clipped or not finite. "
            "Capture again with a shorter exposure or choose another region."
        )
    return usable


def pixels_within(image: NDArray[np.float64], region: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the pixels of a region as a list, (P, C), row by row: image[region], several times faster.

    Parameters
    ----------
    image : ndarray, shape (H, W, C)
    region : ndarray of bool, shape (H, W)
    """
    return np.asarray(image.reshape(-1, image.shape[2]).take(np.flatnonzero(region), axis=0))


def every_channel(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where flags (H, W, C) hold in every channel, (H, W): flags.all(axis=2), ten times faster."""
    held = flags[..., 0]
    for channel in range(1, flags.shape[2]):
        held = held & flags[..., channel]
    return held


#: Fewer tiles cannot show how an error varies over a region; with 12 the spread itself is known to about 20 %.
MINIMUM_TILES = 12
LARGEST_TILE_PX = 16


def tile_indices(mask: NDArray[np.bool_], tile_px: int) -> NDArray[np.intp]:
    """Return the number of the tile that each pixel of a mask lies in.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        Not empty.
    tile_px : int
        Side of a tile, px; the first tile starts at the corner of the mask's bounding box.

    Returns
    -------
    ndarray of int, shape (P,)
        0 ... G - 1 without gaps, for the P pixels in the order of ``image[mask]``.
    """
    rows, columns = np.nonzero(mask)
    row_tile = (rows - rows.min()) // tile_px
    column_tile = (columns - columns.min()) // tile_px
    number = row_tile * (int(column_tile.max()) + 1) + column_tile
    # tiles without a pixel are skipped
    rank = np.cumsum(np.bincount(number) > 0) - 1
    return np.asarray(rank[number], dtype=np.intp)


def tile_side_px(mask: NDArray[np.bool_]) -> int:
    """Return the largest tile side that still gives enough tiles, halving from `LARGEST_TILE_PX`.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)

    Returns
    -------
    int
        Side, px.

    Raises
    ------
    CompareError
        If the mask has fewer pixels than the least number of tiles.
    """
    pixels = int(mask.sum())
    if pixels < MINIMUM_TILES:
        raise CompareError(
            f"The region has only {pixels} usable pixels, but an interval needs at least {MINIMUM_TILES}. Use a larger "
            "region or a larger image."
        )
    side = LARGEST_TILE_PX
    while side > 1 and int(tile_indices(mask, side).max()) + 1 < MINIMUM_TILES:
        side //= 2
    return side
