"""How a sensor senses: geometry of its camera, millimetres per pixel on the pad, and the map from colour to normal.

A camera is described as OpenCV's models do, by intrinsic matrix and lens distortion. The pixel scale holds along both
directions of the picture, with uncertainty. The normal map is what calibration presses taught. The fit of a sensor
tells which numbers of its design its pictures determine.
"""

from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._capture import CharucoBoard, Encoding
from data_schemas._design import FingerDesign, PlainSensor
from data_schemas._model import Estimate, Model, Record
from data_schemas._units import ArraySpec, LengthMm, RelativeUncertainty

DistortionModel = Literal["pinhole", "fisheye"]
PINHOLE_COEFFICIENTS: Final = (0, 4, 5, 8, 12, 14)
FISHEYE_COEFFICIENTS: Final = (0, 4)

Pixels = Annotated[float, Field(allow_inf_nan=False, json_schema_extra={"unit": "px"})]
FocalPx = Annotated[float, Field(gt=0.0, allow_inf_nan=False, json_schema_extra={"unit": "px"})]
Coefficient = Annotated[float, Field(allow_inf_nan=False)]


class CameraCalibration(Model):
    """Focal lengths, principal point and distortion of one camera at one picture size.

    Pixel centres have whole coordinates, as in OpenCV: the picture reaches from -0.5 to width - 0.5. Pinhole: x'' =
    distorted(X/Z, Y/Z), u = fx x'' + cx. Fisheye: theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8) for the angle
    theta from the axis, which may exceed 90 deg.
    """

    model: DistortionModel
    width_px: Annotated[int, Field(ge=2, le=32768)]
    height_px: Annotated[int, Field(ge=2, le=32768)]
    focal_px: tuple[FocalPx, FocalPx] = Field(description="fx, fy")
    centre_px: tuple[Pixels, Pixels] = Field(description="cx, cy")
    distortion: tuple[Coefficient, ...] = Field(
        default=(), description="pinhole: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1..s4 [tx ty]]]]; fisheye: k1 k2 k3 k4"
    )
    source: str = Field(description="name of the file with the numbers")

    @model_validator(mode="after")
    def _coefficients_fit_the_model(self) -> "CameraCalibration":
        allowed = PINHOLE_COEFFICIENTS if self.model == "pinhole" else FISHEYE_COEFFICIENTS
        if len(self.distortion) not in allowed:
            raise ValueError(
                f"distortion: a {self.model} model must have {', '.join(map(str, allowed[:-1]))} or {allowed[-1]} "
                f"coefficients, got {len(self.distortion)}"
            )
        return self


Scale = Annotated[float, Field(gt=0.0, allow_inf_nan=False, json_schema_extra={"unit": "mm/px"})]
LARGEST_WIDENED_FACTOR = 1000.0
OffsetMm = Annotated[float, Field(ge=-100.0, le=100.0, json_schema_extra={"unit": "mm"})]
OffsetUMm = Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})]


class LocalScale(Model):
    """Scale at one place of the picture: lengths on the pad that one pixel along a row and along a column spans.

    ``mean_mm_per_px`` is the root of the area of a pixel on the pad: what a radius or a blur is converted with.
    Uncertainties are relative standard ones.
    """

    column_px: float
    row_px: float
    along_x_mm_per_px: Scale
    along_y_mm_per_px: Scale
    mean_mm_per_px: Scale
    along_x_u_rel: RelativeUncertainty
    along_y_u_rel: RelativeUncertainty
    mean_u_rel: RelativeUncertainty


class ScaleRange(Model):
    """Least and greatest scale over a part of the picture."""

    along_x_low_mm_per_px: Scale
    along_x_high_mm_per_px: Scale
    along_y_low_mm_per_px: Scale
    along_y_high_mm_per_px: Scale


class ScaleContribution(Model):
    """One line of the budget of the mean scale at the middle of the board."""

    input: str
    u_rel: RelativeUncertainty


class BoardResidual(Model):
    """How well one picture of the board fits."""

    file: str
    corners: Annotated[int, Field(ge=1)]
    rms_px: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "px"})]
    mirrored: bool = False


class PixelScale(Record):
    """A calibrated lens, the plane of the pad from a board on it, and the scale between both.

    ``covariance`` is that of the lens (fx, fy, cx, cy, distortion) and the board's place (rotation vector, translation
    in mm), in this order; every ``u_rel`` follows from it, the board's tolerance and where the coat lies.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray sense scale'"

    board: CharucoBoard
    square_u_rel: RelativeUncertainty = Field(description="standard uncertainty of the side of a square, as declared")
    coat_behind_board_mm: OffsetMm = Field(
        default=0.0, description="distance from the printed face to the coat, away from the camera; as declared"
    )
    coat_behind_board_u_mm: OffsetUMm = Field(default=0.0, description="standard uncertainty, as declared")
    calibration: CameraCalibration
    place: tuple[float, float, float, float, float, float] = Field(
        description="place of the board on the pad: rotation vector (rad) and translation (mm) from board to camera"
    )
    covariance: Annotated[NDArray[np.float64], ArraySpec("<f8", ("parameter", "parameter"))]
    widened_factor: Annotated[float, Field(ge=1.0, le=LARGEST_WIDENED_FACTOR)] = Field(
        default=1.0,
        description="factor on the standard deviations of the covariance, where resampled pictures scatter more",
    )
    corner_sd_px: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "px"})]
    degrees_of_freedom: Annotated[int, Field(ge=1)]
    pad_picture: BoardResidual
    lens_pictures: tuple[BoardResidual, ...]
    middle: LocalScale = Field(description="scale at the middle of the board on the pad")
    over_board: ScaleRange = Field(description="scale over the part of the picture that the board on the pad covers")
    budget: tuple[ScaleContribution, ...]
    resampled_u_rel: RelativeUncertainty = Field(
        description="standard uncertainty of the mean scale at the middle, from resampled pictures and corners; to "
        "compare with that of the covariance"
    )
    map_columns_px: Annotated[NDArray[np.float64], ArraySpec("<f8", ("map_column",), "px")]
    map_rows_px: Annotated[NDArray[np.float64], ArraySpec("<f8", ("map_row",), "px")]
    map_mm_per_px: Annotated[NDArray[np.float64], ArraySpec("<f8", ("map_row", "map_column", "3"), "mm/px", True)] = (
        Field(description="along x, along y, mean; NaN where the picture does not see the plane")
    )
    map_u_rel: Annotated[NDArray[np.float64], ArraySpec("<f8", ("map_row", "map_column", "3"), "1", True)]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PixelScale":
        expected = 4 + len(self.calibration.distortion) + 6
        if self.covariance.shape[0] != expected:
            raise ValueError(
                f"covariance has {self.covariance.shape[0]} rows, but must have {expected}, one for each "
                "number of the lens and its place"
            )
        return self


Floats = NDArray[np.float64]


class NormalMapRecord(Record):
    """A polynomial from change of colour and place in the picture to the slope of the gel, with its held-out score.

    Terms as :func:`finray_calib.sensing.polynomial_terms` orders them. A Bayer capture counts as one pixel
    per 2 x 2 cell. Scores are over random halves of the presses: the share of the squared slopes that the map explains
    on the half that did not teach it, and the mean angle of its normals.
    """

    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray sense teach'"

    name: str
    degree: Annotated[int, Field(ge=1, le=6)]
    coefficients: Annotated[Floats, ArraySpec("<f8", ("term", "2"), "mm/mm")]
    lowest_change_rel: Annotated[Floats, ArraySpec("<f8", ("3",))]
    highest_change_rel: Annotated[Floats, ArraySpec("<f8", ("3",))]
    height_px: Annotated[int, Field(ge=1)]
    width_px: Annotated[int, Field(ge=1)]
    mm_per_px: LengthMm
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None, description="relative standard uncertainty, as the captures state it; none: not known"
    )
    encoding: Encoding = Field(
        description="encoding of the captures that the map was trained on; it senses captures of the same encoding only"
    )
    presses: Annotated[int, Field(ge=1)]
    held_out_explained_rel: Annotated[Floats, ArraySpec("<f8", ("split",))]
    held_out_angle_deg: Annotated[Floats, ArraySpec("<f8", ("split",), "deg")]
    held_out_depth_rms_mm: Annotated[Floats, ArraySpec("<f8", ("press",), "mm")] | None = Field(
        default=None,
        description="for each press, RMS error of the depth inside its circle after its mean is removed, by a map "
        "trained without this press (on five sixths of the presses); none: not measured",
    )
    held_out_height_error_rel: Annotated[Floats, ArraySpec("<f8", ("press",))] | None = Field(
        default=None,
        description="relative error of the height from the rim to the middle, for each press, by the same maps",
    )
    held_out_level_mm: Annotated[Floats, ArraySpec("<f8", ("ring",), "mm")] | None = Field(
        default=None,
        description="mean depth, relative to the border of the picture, in a ring 2.5 to 3.5 radii from the contact, "
        "where the gel should be flat; for each press with this ring in view, by maps trained without it; "
        "none: not known",
    )
    training_sha256: tuple[str, ...] = Field(
        default=(), description="SHA-256 of the contact images that it was trained on; none: not known"
    )
    notes: tuple[str, ...] = ()


class SensedPress(Record):
    """What a normal map senses in one capture: depth, normals and contact, one value per pixel of the colour image.

    Depth is positive into the gel and counts from the median over the frame of the picture. The contact is where it
    exceeds ``contact_depth_mm``. Normals have components along columns, along rows and towards the camera, which sees a
    dent as a bump.
    """

    written_by: ClassVar[str] = "'finray sense run'"

    name: str
    normal_map: str
    mm_per_px: LengthMm
    depth_mm: Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column"), "mm")]
    normal: Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "3"), "1")]
    contact: Annotated[NDArray[np.uint8], ArraySpec("<u1", ("row", "column"))]
    depth_u_mm: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm"})] | None = Field(
        description="standard uncertainty of the depth at one pixel, including that of its zero level; none: the map "
        "does not hold it"
    )
    contact_depth_mm: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "mm"})]
    deepest_mm: float = Field(description="largest depth")
    deepest_u_mm: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm"})] | None = Field(
        description="standard uncertainty of the largest depth, including that of its zero level"
    )
    contact_area_mm2: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm2"})]
    contact_area_u_mm2: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm2"})] | None = Field(
        description="standard uncertainty, from that of the depth alone"
    )
    outside_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        description="share of the contact's pixels whose change of colour occurs in no training press"
    )
    clipped_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        description="share of the contact's pixels that are clipped"
    )
    is_of_teaching: bool | None = Field(
        description="whether the map was trained on this press; none: the map does not state it"
    )
    notes: tuple[str, ...] = ()


Determined = Literal[
    "determined", "partly determined", "not determined by these pictures", "the renders are too noisy to tell"
]


class FittedNumber(Model):
    """A number of a sensor before and after its pictures were seen; ``posterior`` is that of ``draws``."""

    name: str = Field(description="field of the design, or a number of the picture, the paint, the camera or a press")
    unit: str
    prior: Estimate = Field(description="value before the pictures were used, from the design")
    prior_origin: str = Field(description="where the prior's width comes from")
    posterior: Estimate
    left_of_prior_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="posterior / prior standard deviation, of the logarithm where the number is positive"
    )
    verdict: Determined = Field(
        description="how much of the prior's width is left: below a half, below nine tenths, or more; where the "
        "renders are too noisy, do not rely on the posterior"
    )


class LayerBrightness(Model):
    """What one light, or one chain of fluorescence, adds to the channel that sees it best, over what was predicted."""

    layer: str
    channel: Literal["red", "green", "blue"]
    over_design_rel: Estimate = Field(
        description="product of the camera's gain, powers, yields and response, relative to that of the design"
    )


class SensorFit(Record):
    """Posterior of the numbers of a sensor, from a few captures of it and its design.

    ``draws`` are joint: a product or ratio of two numbers is known better than either, where the pictures tell only
    that. The discrepancy is the size of a smooth relative error that the model cannot explain.
    """

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray simulate fit'"

    name: str
    label: str = Field(description="method by which the pictures were predicted")
    finger: FingerDesign | None = Field(default=None, description="the finger's design, from which the priors come")
    sensor: PlainSensor | None = Field(default=None, description="the classic sensor, from which the priors come")
    captures: tuple[str, ...] = Field(description="names of the captures")
    numbers: tuple[FittedNumber, ...]
    draws: Annotated[NDArray[np.float64], ArraySpec("<f8", ("draw", "number"))] = Field(
        description="draws of the posterior; columns in the order of numbers, each in its unit"
    )
    brightness: tuple[LayerBrightness, ...]
    not_told_apart: tuple[str, ...] = Field(
        description="combinations of numbers of which more than half of the prior's width is left"
    )
    discrepancy_rel: Estimate = Field(description="smooth error of the model, standard deviation over the picture")
    correlation_length_rel: Annotated[float, Field(gt=0.0)] = Field(
        description="correlation length of the smooth error, relative to the longer side of the pad's picture; "
        "chosen, not fitted"
    )
    independent_rel: Estimate = Field(description="independent error of each block, in addition to the known noise")
    residual_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="rms of the residuals, relative to the picture's mean"
    )
    emulator_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        description="rms by which a render at the fitted numbers differs from the emulator that was fitted; this "
        "difference is subtracted before the last fit; none where no number is checked by a render of "
        "its own"
    )
    blocks: Annotated[int, Field(ge=1)] = Field(description="number of blocks of each picture and channel")
    trusted: bool = Field(description="the search has converged, and no number lies far outside its prior")
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _one_draw_of_each(self) -> "SensorFit":
        if self.draws.shape[1] != len(self.numbers):
            raise ValueError(
                f"draws has {self.draws.shape[1]} columns, but must have one for each of the "
                f"{len(self.numbers)} numbers"
            )
        if (self.finger is None) == (self.sensor is None):
            raise ValueError("exactly one of finger and sensor must be given")
        return self
