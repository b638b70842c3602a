"""A classic tactile sensor as a designer describes it (TOML): lights, gel, coat and camera, and what is pressed in.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from its base; mm. All angles
and places of lights and camera are told from the axis through the pad's middle, along the pad's normal.
"""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from data_schemas._design import FingerDesign, Origin, of_known_fields
from data_schemas._design_parts import Coating, GelPad, Indenter, PoissonRatio
from data_schemas._model import Model, Record
from data_schemas._units import (
    AngleDeg,
    Fraction,
    LengthMm,
    PositionMm,
    RelativeUncertainty,
    WavelengthNm,
    WidthNm,
)

Channel = Literal["red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")
MOST_LIGHTS = 48
TiltDeg = Annotated[float, Field(ge=-85.0, le=85.0, json_schema_extra={"unit": "deg"})]


class ColouredLight(Model):
    """A light panel or LED beside and below the pad; without its own spectrum it shines in the channels of its name."""

    channel: Literal["red", "green", "blue", "white"]
    azimuth_deg: AngleDeg = Field(
        default=0.0, description="direction of its light in the plane of the pad: 0 along +z, 90 along +x"
    )
    angle_deg: AngleDeg = Field(
        default=40.0, description="angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it"
    )
    turn_deg: AngleDeg = Field(
        default=0.0,
        description="turn of the panel's normal about the axis, away from the pad's middle, at an unchanged place",
    )
    distance_mm: Annotated[float, Field(ge=0.0, le=1000.0, json_schema_extra={"unit": "mm"})] = Field(
        default=14.0, description="distance of its centre from the axis through the pad's middle"
    )
    depth_mm: LengthMm = Field(default=10.0, description="depth of its centre below the inner face")
    width_mm: LengthMm = 12.0
    height_mm: LengthMm = 4.0
    power_rel: Annotated[float, Field(gt=0.0, le=100.0)] = Field(default=1.0, description="radiance along the normal")
    beam_exponent: Annotated[float, Field(ge=1.0, le=50.0)] = Field(
        default=1.0, description="m of an intensity ~ cos^m of the angle from the normal; 1 is Lambertian"
    )
    peak_wavelength_nm: WavelengthNm | None = Field(
        default=None, description="peak of the LED; used with a camera.response other than 'ideal', by default 630, "
                                  "525, "
        "465 nm by channel"
    )  # fmt: skip
    fwhm_nm: WidthNm | None = Field(default=None, description="width of its spectrum at half maximum, by default 25 nm")

    @model_validator(mode="after")
    def _below_the_pad(self) -> "ColouredLight":
        reach_mm = self.height_mm / 2.0 * abs(float(np.cos(np.radians(self.angle_deg))))
        if reach_mm >= self.depth_mm:
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} mm puts an edge of the {self.channel} panel at the inner face or above "
                f"it; it must be more than {reach_mm:.3g} mm for a panel of this height and angle"
            )
        return self

    @model_validator(mode="after")
    def _white_has_no_peak(self) -> "ColouredLight":
        for name in ("peak_wavelength_nm", "fwhm_nm"):
            if self.channel == "white" and getattr(self, name) is not None:
                raise ValueError(f"{name} belongs to a coloured LED; a white one has a fixed spectrum: leave it out")
        return self


class CameraBelow(Model):
    """Camera below the pad; by default it is on the axis and straight, columns run along +x, rows against z.

    It is turned about its own pinhole: by ``tilt_deg`` up to +z (the tip), then by ``pan_deg`` to +x, then rolled.
    """

    distance_mm: LengthMm = Field(default=40.0, description="distance of the pinhole below the inner face")
    across_mm: PositionMm = Field(default=0.0, description="distance of the pinhole from the axis, along +x")
    along_mm: PositionMm = Field(default=0.0, description="distance of the pinhole from the axis, along +z")
    tilt_deg: TiltDeg = Field(default=0.0, description="tilt of the line of sight from the pad's normal towards +z")
    pan_deg: TiltDeg = Field(default=0.0, description="turn of the line of sight from the pad's normal towards +x")
    roll_deg: AngleDeg = Field(default=0.0, description="turn of the picture about the line of sight")
    field_of_view_deg: Annotated[float, Field(ge=5.0, le=120.0, json_schema_extra={"unit": "deg"})] = Field(
        default=30.0, description="field of view over the width of the picture"
    )
    width_px: Annotated[int, Field(ge=8, le=4096)] = 160
    height_px: Annotated[int, Field(ge=8, le=4096)] = 160
    calibration: str | None = Field(
        default=None,
        description="OpenCV calibration (YAML or JSON) of the lens; without it, an ideal pinhole of this field of view",
    )
    response: str = Field(
        default="ideal",
        description="'ideal': each channel sees the lights of its name only, and white ones; 'assumed' (smooth "
        "stand-in curves) or a CSV file with the header wavelength_nm,red_percent,green_percent,blue_percent",
    )

    def unused_fields(self) -> dict[str, str]:
        """Return the field of view where a calibration tells it."""
        if self.calibration is None:
            return {}
        return {
            "field_of_view_deg": "camera.calibration already states where each pixel looks; leave out one of the two"
        }


class TranslucentLayer(Model):
    """White, translucent gel before a dark backing: where it is squeezed thinner, more of the dark shows through.

    Its reflectance is that of Kubelka and Munk for the local thickness; it takes the same share of the gel everywhere.
    """

    thickness_mm: LengthMm = Field(default=1.0, description="thickness at rest, as part of the pad's thickness")
    scattering_length_mm: LengthMm = Field(
        default=0.5, description="1 / S, where S is the scattering coefficient of Kubelka and Munk"
    )
    absorption_length_mm: Annotated[float, Field(gt=0.0, le=1e6, json_schema_extra={"unit": "mm"})] = Field(
        default=100.0, description="1 / K, where K is the absorption coefficient of Kubelka and Munk"
    )
    backing_reflectance: Fraction = 0.03

    def reflectance(self, thickness_mm: NDArray[np.floating]) -> NDArray[np.float64]:
        r"""Return the diffuse reflectance of the layer before its backing.

        .. math:: R = \frac{1 - R_g (a - b \coth b S t)}{a - R_g + b \coth b S t}, \quad
                  a = 1 + K / S, \; b = \sqrt{a^2 - 1}

        Valid for diffuse light and lateral changes slower than a thickness; light that spreads sideways is left out.

        Parameters
        ----------
        thickness_mm
            Local thickness t > 0.

        References
        ----------
        P. Kubelka, F. Munk, Ein Beitrag zur Optik der Farbanstriche, 1931.
        """
        a = 1.0 + self.scattering_length_mm / self.absorption_length_mm
        b = np.sqrt(a * a - 1.0)
        depth = np.maximum(np.asarray(thickness_mm, dtype=np.float64), 0.0) / self.scattering_length_mm
        tanh = np.tanh(b * depth)
        # both sides times tanh: it stands for a thickness of 0 too
        ground = self.backing_reflectance
        return np.asarray((tanh - ground * (a * tanh - b)) / ((a - ground) * tanh + b))


class SensorCoat(Coating):
    """What the camera sees of the touched face: a blend of metal flake and diffuse paint, coloured or translucent."""

    diffuse_reflectance_rgb: tuple[Fraction, Fraction, Fraction] | None = Field(
        default=None,
        description="reflectance of a coloured paint, per channel; without it, diffuse_reflectance in all channels",
    )
    translucent: TranslucentLayer | None = Field(default=None, description="a translucent layer in place of the paint")

    def unused_fields(self) -> dict[str, str]:
        """Return what a colour, a translucent layer or a wholly diffuse coat leaves without effect."""
        idle = super().unused_fields()
        layer = self.translucent is not None
        if layer and self.diffuse_reflectance_rgb is not None:
            idle["diffuse_reflectance_rgb"] = (
                "coating.translucent already has its own reflectance; leave out one of the two"
            )
        if layer or self.diffuse_reflectance_rgb is not None:
            other = "translucent" if layer else "diffuse_reflectance_rgb"
            idle["diffuse_reflectance"] = f"coating.{other} already states the reflectance; leave out one of the two"
        if self.diffuse_share == 1.0:
            idle["roughness_alpha"] = "a coat of diffuse_share = 1 holds no metal; leave it out, or lower the share"
        return idle


class CoatSurface(Model):
    """The pressed coat as a height map or mesh, in place of the indenter.

    A map is an array (NPY) or a grey picture (PNG, 8 or 16 bit) as the camera sees the pad: columns along +x, the first
    row at the greatest z. A mesh (STL, mm, axes of the pad) is met from outside along the pad's normal.
    """

    file: str = Field(description="NPY, PNG or STL; relative to the design")
    holds: Literal["depth", "height"] = Field(
        default="depth",
        description="what a map holds: how far the coat lies below its place at rest, or its height above the "
        "inner face",
    )
    step_mm: Annotated[float, Field(gt=0.0, le=10.0, json_schema_extra={"unit": "mm"})] | None = Field(
        default=None, description="distance between neighbouring rows and columns of a map"
    )
    unit_mm: Annotated[float, Field(gt=0.0, le=1000.0, json_schema_extra={"unit": "mm"})] | None = Field(
        default=None,
        description="unit of a map's numbers, such as 0.001 for micrometres; by default 1 for NPY; a PNG needs it",
    )
    position_mm: PositionMm | None = Field(
        default=None, description="place of a map's middle along the pad; by default the pad's middle"
    )
    across_mm: PositionMm = Field(default=0.0, description="distance of a map's middle from the middle line")

    @model_validator(mode="after")
    def _kind_of_file(self) -> "CoatSurface":
        suffix = self.file.lower()[-4:]
        if suffix not in (".npy", ".png", ".stl"):
            raise ValueError(f"file = {self.file!r} must end in .npy, .png (height map) or .stl (mesh)")
        if suffix != ".stl" and self.step_mm is None:
            raise ValueError("step_mm is missing: a height map must say how far its neighbours lie apart, in mm")
        if suffix == ".png" and self.unit_mm is None:
            raise ValueError("unit_mm is missing: a picture must say how many mm one grey level is, such as 0.001")
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return the fields of a map where a mesh is given."""
        if not self.file.lower().endswith(".stl"):
            return {}
        why = "it belongs to a height map, but an STL file holds mm in the axes of the pad; leave it out"
        return dict.fromkeys(("holds", "step_mm", "unit_mm", "position_mm", "across_mm"), why)


def _three_lights() -> tuple[ColouredLight, ...]:
    """Return three lights a third of a turn apart."""
    return tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in zip(CHANNELS, (0.0, 120.0, -120.0), strict=True))


class PlainSensor(Record):
    """A classic sensor without fluorescence: every number is an assumption unless ``origin`` says otherwise.

    The gel's index is that at 589 nm in all channels: over the visible range it differs by 0.01.
    """

    schema_version: ClassVar[int] = 5

    name: str = "plain-20x20"
    pad: GelPad = GelPad(length_mm=20.0, width_mm=20.0, thickness_mm=4.0)
    coating: SensorCoat = SensorCoat(diffuse_share=0.8)
    gel_poisson_ratio: PoissonRatio = Field(
        default=0.49, description="Poisson's ratio of the gel; silicones have more than 0.47"
    )
    walls: Literal["dark", "clear"] = Field(default="dark", description="sides of the gel: black-painted, or bare gel")
    wall_reflectance: Fraction = Field(default=0.05, description="reflectance of dark walls")
    box_reflectance: Fraction = Field(default=0.04, description="reflectance of the housing")
    box_clearance_mm: LengthMm = Field(default=8.0, description="distance of the housing around gel, lights and camera")
    panel_reflectance: Fraction = Field(default=0.05, description="reflectance of the lights themselves")
    lights: tuple[ColouredLight, ...] = Field(default_factory=_three_lights, min_length=1, max_length=MOST_LIGHTS)
    camera: CameraBelow = CameraBelow()
    indenter: Indenter = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0)
    surface: CoatSurface | None = Field(default=None, description="the pressed coat, in place of the indenter")
    source: str = Field(default="", description="where the numbers that are not assumed come from, in words")
    origin: dict[str, Origin] = Field(
        default={}, description="where a number comes from (lights.width_mm: that of all lights); assumed if not listed"
    )
    uncertainty_rel: dict[str, RelativeUncertainty] = Field(
        default={},
        description="relative standard uncertainty of a number; it is shown, but no computation uses it",
    )

    @field_validator("origin", "uncertainty_rel")
    @classmethod
    def _known_fields(cls, told: dict[str, Any]) -> dict[str, Any]:
        return of_known_fields(cls, told)

    @model_validator(mode="after")
    def _layer_in_the_pad(self) -> "PlainSensor":
        layer = self.coating.translucent
        if layer is not None and layer.thickness_mm > self.pad.thickness_mm:
            raise ValueError(
                f"coating.translucent.thickness_mm = {layer.thickness_mm:g} mm is part of the gel; it must be at most "
                f"pad.thickness_mm = {self.pad.thickness_mm:g} mm"
            )
        return self

    @model_validator(mode="after")
    def _press_is_possible(self) -> "PlainSensor":
        self.pressed_pad()
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return also what a surface, clear walls or an ideal camera leaves without effect."""
        idle = super().unused_fields()
        idle["indenter.path"] = "a classic sensor's indenter is pressed along the pad's normal, by depth_mm"
        if self.surface is not None:
            idle["indenter"] = "[surface] and [indenter] both state the pressed shape; leave out one of the two tables"
        if self.walls == "clear":
            idle["wall_reflectance"] = 'walls = "clear" have no reflectance; leave it out'
        return idle

    def pressed_pad(self) -> FingerDesign:
        """Return pad and indenter as a design whose coated face the analytic press can shape.

        Raises
        ------
        ValueError
            When the indenter lies beside the pad.
        """
        return FingerDesign(pad=self.pad, indenter=self.indenter)

    def middle_mm(self) -> NDArray[np.float64]:
        """Return the middle of the inner face, shape (3,)."""
        return np.array([0.0, 0.0, self.pad.length_mm / 2.0])
