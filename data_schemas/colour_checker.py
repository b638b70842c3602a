"""Reflectance of a paint after the ColorChecker patch that looks most like it in room light."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_schemas.arrays import ArraySpec
from data_schemas.curves import SpectralCurve
from data_schemas.estimate import Estimate
from data_schemas.model import Model

Floats = NDArray[np.float64]
Patches = Annotated[Floats, ArraySpec("<f8", ("24", "3"), "DN")]
DeltaE = Annotated[float, Field(ge=0.0, description="CIEDE2000", json_schema_extra={"unit": "1"})]


class PatchDistance(Model):
    """How different the paint looks from one patch."""

    patch: str
    delta_e: DeltaE


class ColourCheckerMatch(Model):
    """The paint's colour in the room-light frame, matched to the closest of the 24 patches.

    patches
        All patches, closest first.
    reflectance
        Measured reflectance of the closest patch; its relative uncertainty is that of such a match, as a share of the
        root mean square of the paint's curve.
    reflectance_sd
        The same as a standard uncertainty of the paint's reflectance, equal at all wavelengths.
    at_filters
        The curve averaged over each filter's pass band, with `reflectance_sd`.
    camera_median_delta_e, camera_largest_delta_e
        CIEDE2000 between a patch and its prediction by a camera matrix fitted to the other 23.
    patch_mean_dn, patch_sd_dn, paint_mean_dn
        Linear camera values (dark level removed): mean and standard deviation over the pixels of each patch, and the
        mean over the painted region.
    corners_px
        Corners of the chart (column, row) in pixels of the raw frame, first the one beside "dark skin".
    """

    patches: tuple[PatchDistance, ...] = Field(min_length=24, max_length=24)
    reflectance: SpectralCurve
    reflectance_sd: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "1"})]
    at_filters: tuple[Estimate, ...]
    camera_median_delta_e: DeltaE
    camera_largest_delta_e: DeltaE
    patch_mean_dn: Patches
    patch_sd_dn: Patches
    paint_mean_dn: Annotated[Floats, ArraySpec("<f8", ("3",), "DN")]
    corners_px: Annotated[Floats, ArraySpec("<f8", ("4", "2"), "px")]
    frame_file: str
    statement: str
