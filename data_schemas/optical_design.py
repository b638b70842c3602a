"""The optical half of a finger's design: coating, light panels, mirror, camera, and what closes the finger."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from data_schemas.model import Model
from data_schemas.units import AngleDeg, Fraction, LengthMm, PositionMm, RelativeUncertainty, WavelengthNm, WidthNm


class Coating(Model):
    """Aluminium-flake coating on the touched face: a blend of a rough conductor and a diffuse part."""

    roughness_alpha: Annotated[float, Field(gt=0.0, le=1.0, description="GGX alpha")] = 0.25
    diffuse_share: Fraction = 0.35
    diffuse_reflectance: Fraction = 0.6


class LightPanel(Model):
    """Blue LED panel outside the gel, below the inner face."""

    angle_deg: AngleDeg = 30.0
    position_mm: tuple[PositionMm, PositionMm, PositionMm] = (0.0, -10.0, -1.0)
    width_mm: LengthMm = 20.0
    height_mm: LengthMm = 4.0
    peak_wavelength_nm: WavelengthNm = 450.0
    fwhm_nm: WidthNm = 20.0
    power_rel: Annotated[float, Field(gt=0.0, le=100.0)] = Field(
        default=1.0, description="radiance along the normal, relative to the other panel"
    )
    beam_exponent: Annotated[float, Field(ge=1.0, le=50.0)] = Field(
        default=1.0,
        description="m of an intensity ~ cos^m of the angle from the normal; 1 is Lambertian, and the half angle "
        "of the beam is acos(0.5^(1/m)): 60, 45 and 33 deg for m = 1, 2 and 4",
    )

    @model_validator(mode="after")
    def _outside_the_gel(self) -> "LightPanel":
        if self.position_mm[1] >= 0.0:
            raise ValueError(
                f"position_mm: y must be negative (outside the gel, whose inner face is y = 0 mm), got "
                f"{self.position_mm[1]} mm"
            )
        return self


class Mirror(Model):
    """Flexible mirror on the back beam, slightly convex."""

    reflectance: Fraction = 0.88
    radius_mm: Annotated[float, Field(gt=50.0, le=1e6, json_schema_extra={"unit": "mm"})] = 400.0


class TactileCamera(Model):
    """Camera at the base that sees the pad through the mirror."""

    field_of_view_deg: Annotated[float, Field(ge=20.0, le=150.0, json_schema_extra={"unit": "deg"})] = 120.0
    width_px: Annotated[int, Field(ge=64, le=4096)] = 640
    height_px: Annotated[int, Field(ge=48, le=4096)] = 480
    bit_depth: Literal[8, 10, 12, 14, 16] = 10
    calibration: str | None = Field(
        default=None,
        description="OpenCV calibration (YAML or JSON: camera_matrix, distortion, pinhole or fisheye); without it, "
        "an ideal pinhole of this field of view",
    )
    response_at_led_uncertainty_rel: RelativeUncertainty = Field(
        default=0.3, description="standard uncertainty of the response of each channel in the LED's band"
    )
    response: str = Field(
        default="assumed",
        description="'assumed' (smooth stand-in curves) or a CSV file with the header "
        "wavelength_nm,red_percent,green_percent,blue_percent",
    )

    @model_validator(mode="after")
    def _whole_bayer_cells(self) -> "TactileCamera":
        if self.width_px % 2 or self.height_px % 2:
            raise ValueError(
                f"width_px and height_px must be even (Bayer cells), got {self.width_px} x {self.height_px}"
            )
        return self

    def idle_fields(self) -> dict[str, str]:
        """Return the field of view where a calibration tells it."""
        if self.calibration is None:
            return {}
        return {"field_of_view_deg": "camera.calibration tells where each pixel looks; leave one of them out"}


class Enclosure(Model):
    """What closes the finger: cloth on the sides, the printed base; both dark."""

    cloth_reflectance: Fraction = 0.04
    base_reflectance: Fraction = 0.05
