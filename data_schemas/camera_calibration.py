"""The geometry of a camera as OpenCV's models describe it: intrinsic matrix and lens distortion."""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from data_schemas.model import Model

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
    source: str = Field(description="file that the numbers come from")

    @model_validator(mode="after")
    def _coefficients_fit_the_model(self) -> "CameraCalibration":
        allowed = PINHOLE_COEFFICIENTS if self.model == "pinhole" else FISHEYE_COEFFICIENTS
        if len(self.distortion) not in allowed:
            raise ValueError(
                f"distortion: a {self.model} model has {', '.join(map(str, allowed[:-1]))} or {allowed[-1]} "
                f"coefficients, got {len(self.distortion)}"
            )
        return self
