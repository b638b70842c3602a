"""Paint map: the emission of a paint pixel by pixel, and how uniform the paint is."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.capture import RegionOfInterest
from data_schemas.estimate import Estimate
from data_schemas.model import Model, Record
from data_schemas.units import Fraction

Floats32 = NDArray[np.float32]
Floats = NDArray[np.float64]
PlainMap = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), allow_nan=True)]
MapNm = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), "nm", allow_nan=True)]
MapPerNm = Annotated[Floats32, ArraySpec("<f4", ("row", "column"), "1/nm", allow_nan=True)]
BlockMap = Annotated[Floats, ArraySpec("<f8", ("block row", "block column"), allow_nan=True)]
BlockMapNm = Annotated[Floats, ArraySpec("<f8", ("block row", "block column"), "nm", allow_nan=True)]
MappedQuantity = Literal["mode_nm", "peak_per_nm", "energy_yield"]


class PaintSpread(Model):
    """How much one quantity of the paint differs from pixel to pixel, in the unit of the quantity.

    The noise of the pixels is subtracted, and so is the pull of the prior: a noisy camera does not make a paint look
    uneven, and a strong prior does not make it look even.
    """

    estimate: float = Field(description="median over the pixels")
    sd: Annotated[float, Field(ge=0.0)] = Field(description="robust standard deviation between pixels, without noise")
    high: Annotated[float, Field(ge=0.0)] = Field(
        description="the same if the pixels' noise were 10 % less than stated"
    )
    noise_share: Fraction = Field(description="share of the noise in the scatter of the pixels (variance)")
    resolved: bool = Field(description="the paint's part exceeds what a 10 % error of the stated noise could feign")
    pixels: Annotated[int, Field(ge=0)] = Field(description="pixels counted: those that the prior does not dominate")


class PaintSpot(Model):
    """A block of pixels whose yield departs from the paint's median."""

    row_px: int = Field(description="centre of the block in the raw frame")
    column_px: int
    deviation_rel: float = Field(description="yield over the median, minus 1")
    deviation_sd_rel: float
    mode_shift_nm: float = Field(description="mode minus the median")


class PaintMap(Record):
    """Emission of every raw pixel, fitted from the bands that its own Bayer channel sees.

    The bands are first divided, filter by filter and channel by channel, by what the region's signal exceeds the
    region's family curve: calibration errors and the paint's departure from the family are common to all pixels.
    The map shows how pixels differ from the region; ``region`` holds its values, whose uncertainty all pixels share.
    Standard deviations hold what differs between pixels. Those of width, peak and yield are relative: 95 % limits
    are value * exp(+-1.96 sd / value). NaN where a pixel could not be fitted. The reflectance at the laser is linear
    in the signals and may scatter below 0.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray fit --map'"

    paint_name: str
    family: str
    area: RegionOfInterest = Field(description="what the maps cover, in pixels of the raw frame")
    mode_nm: MapNm
    mode_sd_nm: MapNm
    fwhm_nm: MapNm
    fwhm_sd_nm: MapNm
    peak_per_nm: MapPerNm
    peak_sd_per_nm: MapPerNm
    energy_yield: PlainMap
    energy_yield_sd: PlainMap
    shape_name: str = Field(description="the family's own parameter: kappa or ln_asymmetry")
    shape_value: PlainMap
    shape_sd: PlainMap
    reflectance_at_laser: PlainMap
    reflectance_at_laser_sd: PlainMap
    chi_square: PlainMap = Field(description="squared residuals of the bands in standard deviations, prior left out")
    bands_used: Annotated[NDArray[np.uint8], ArraySpec("|u1", ("row", "column"))]
    converged: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("row", "column"))]
    region: dict[str, Estimate] = Field(description="the region's fit: centre of the prior, error common to all pixels")
    prior_sd: dict[str, float] = Field(description="prior of a pixel around the region's fit")
    prior_in_words: str
    band_factor: Annotated[Floats, ArraySpec("<f8", ("filter", "3"), allow_nan=True)] = Field(
        description="region's signal over its family curve; NaN where a filter and channel is not used"
    )
    fitted_pixels: Annotated[int, Field(ge=1)]
    unusable_pixels: Annotated[int, Field(ge=0)] = Field(description="masked, or fewer than four usable bands")
    unconverged_pixels: Annotated[int, Field(ge=0)]
    uniformity: dict[MappedQuantity, PaintSpread]
    block_px: Annotated[int, Field(ge=2)] = Field(description="side of a block")
    block_mode_nm: BlockMapNm = Field(description="median over a block; NaN with too few pixels")
    block_mode_sd_nm: BlockMapNm
    block_energy_yield: BlockMap
    block_energy_yield_sd: BlockMap
    worst_spots: tuple[PaintSpot, ...] = Field(description="blocks whose yield departs most, worst first")

    @model_validator(mode="after")
    def _sizes_agree(self) -> "PaintMap":
        check_dimensions(self)
        rows, columns = self.chi_square.shape
        if (self.area.height_px, self.area.width_px) != (rows, columns):
            raise ValueError(
                f"area is {self.area.height_px} x {self.area.width_px} px but the maps have {rows} x {columns}"
            )
        return self
