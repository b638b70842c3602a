"""Photometric error report: how far a render is from a capture, beside doing nothing and repeating."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_schemas.arrays import ArraySpec
from data_schemas.model import Model, Record


class Interval(Model):
    """Point estimate with a 95 % interval."""

    estimate: float
    low95: float
    high95: float


class ErrorRow(Model):
    """One row of the table: a candidate image against the captured contact image in one region."""

    candidate: Literal["do nothing", "simulation", "floor"]
    skill: Interval = Field(description="1 - squared error relative to that of the no-contact image")
    skill_per_channel: tuple[float | None, float | None, float | None] = Field(
        description="None where contact does not change the channel"
    )
    relative_rms: tuple[float, float, float] | None = Field(description="None where values are not linear light")
    psnr_db: float | None = Field(description="None for identical images")
    ssim: float | None = Field(
        description="mean of the SSIM map over the region; for comparison with papers; None without a complete window"
    )


class RegionError(Model):
    """All rows for one region."""

    region: str
    factor: float = Field(description="region size in contact half-widths")
    pixels: int
    clipped_fraction: float
    rows: tuple[ErrorRow, ...]


class PhotometricErrorReport(Record):
    """Comparison of one simulated press with one tactile capture.

    The headline is the skill score over the contact patch dilated to twice its half-width: 0 is doing nothing,
    the floor row is what a repeat of the no-contact image costs, and no score above it says anything.
    """

    simulated: str
    captured: str
    label: str
    values: Literal["linear light", "encoded values, encoding unknown"]
    block_px: Annotated[int, Field(ge=1, description="images were averaged over blocks of this side")]
    headline_region: str
    headline_skill: Interval
    regions: tuple[RegionError, ...]
    ssim_full_frame: dict[str, float | None]
    ssim_settings: str
    exposure_factor: float | None = Field(description="one factor for all channels; None when not fitted")
    exposure_factor_sd: float | None
    channel_weights: tuple[float, float, float]
    objective_error_rel: Annotated[float, Field(ge=-1e3, le=1e3)] | None = Field(
        description="simulated minus captured brightness beside the indenter, relative, after the exposure factor"
    )
    objective_error_sd_rel: Annotated[float, Field(ge=0.0, le=1e3)] | None
    light_angle_deg: float | None
    error_map: Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column"), allow_nan=True)]
    withheld: tuple[str, ...] = Field(default=(), description="figures that are not given, and why")
    notes: tuple[str, ...] = ()
