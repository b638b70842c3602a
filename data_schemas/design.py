"""The finger as a designer describes it (TOML): pad, indenter, light panel, mirror, coating, camera, skeleton.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from the base; mm.
The light angle is the angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it.
"""

import difflib
from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, Field, field_validator, model_validator

from data_schemas.mechanical_design import Backing, MechanicalMaterials, MeshPreset, Skeleton
from data_schemas.model import Model, Record
from data_schemas.units import (
    AngleDeg,
    Fraction,
    LengthMm,
    PositionMm,
    RelativeUncertainty,
    WavelengthNm,
    WidthNm,
)

Origin = Literal["measured", "data sheet", "paper", "assumed"]
RefractiveIndex = Annotated[float, Field(ge=1.0, le=2.5)]


class Film(Model):
    """Clear polyester (Mylar) sheet on the inner face of the gel."""

    thickness_mm: LengthMm = 0.1
    refractive_index: RefractiveIndex = 1.65


class GelPad(Model):
    """A gel pad; sizes are always length x width, the thickness is that of the crown in the middle.

    Shapes of the coated face: flat; cylindrical with its axis along the pad; a section of an ellipsoid with its
    centre under the middle of the pad. More shapes as ``crown_drops``.
    """

    shape: Literal["flat", "cylindrical", "ellipsoidal"] = "flat"
    length_mm: LengthMm = 70.0
    width_mm: LengthMm = 35.0
    thickness_mm: LengthMm = 6.0
    radius_mm: LengthMm | None = Field(default=None, description="of a cylindrical pad")
    semi_axes_mm: tuple[LengthMm, LengthMm, LengthMm] | None = Field(
        default=None, description="a (across the pad), b (through it), c (along it) of an ellipsoidal pad"
    )
    refractive_index: RefractiveIndex = Field(default=1.41, description="at 589 nm")
    abbe_number: Annotated[float, Field(ge=10.0, le=200.0)] = Field(
        default=50.0, description="(n - 1) / (n at 486 nm - n at 656 nm): how the index falls with wavelength"
    )
    film: Film | None = Field(default=None, description="sheet on the inner face; none without this table")

    @model_validator(mode="after")
    def _shape_is_complete(self) -> "GelPad":
        needs = {"cylindrical": "radius_mm", "ellipsoidal": "semi_axes_mm"}
        for shape, name in needs.items():
            if (getattr(self, name) is not None) != (self.shape == shape):
                state = "missing" if self.shape == shape else f"given for a {self.shape} pad"
                raise ValueError(f'{name} is {state}; it belongs to shape = "{shape}" and only to that')
        half_width, half_length = self.width_mm / 2.0, self.length_mm / 2.0
        if self.radius_mm is not None and self.radius_mm <= half_width:
            raise ValueError(
                f"radius_mm = {self.radius_mm:g} mm must be more than half the width of the pad ({half_width:g} mm)"
            )
        if self.semi_axes_mm is not None:
            a, _, c = self.semi_axes_mm
            if (half_width / a) ** 2 + (half_length / c) ** 2 >= 1.0:
                raise ValueError(
                    f"semi_axes_mm: an ellipsoid of {a:g} mm across and {c:g} mm along does not cover the corners of a "
                    f"pad of {self.length_mm:g} x {self.width_mm:g} mm; needs (width/2a)^2 + (length/2c)^2 < 1"
                )
        edge_mm = self.thickness_mm - self.drop_mm(half_width, half_length)
        if edge_mm <= 0.0:
            raise ValueError(
                f"thickness_mm = {self.thickness_mm:g} mm leaves no gel at the corners, where the face lies "
                f"{self.thickness_mm - edge_mm:.3g} mm below the crown; make the pad thicker or its radii larger"
            )
        return self

    def drop_mm(self, x_mm: ArrayLike, z_from_middle_mm: ArrayLike) -> Any:
        """Return how far the undeformed coated face lies below its crown, shape of the broadcast arguments.

        Cylinder: r - sqrt(r^2 - x^2). Ellipsoid: b (1 - sqrt(1 - (x/a)^2 - (z/c)^2)). Inside the pad only.
        """
        x, z = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(z_from_middle_mm, dtype=np.float64))
        if self.radius_mm is not None:
            return self.radius_mm - np.sqrt(self.radius_mm**2 - x**2)
        if self.semi_axes_mm is not None:
            a, b, c = self.semi_axes_mm
            return b * (1.0 - np.sqrt(1.0 - (x / a) ** 2 - (z / c) ** 2))
        return np.zeros(x.shape)

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index by Cauchy's n = A + B / wavelength^2 through index and Abbe number.

        Valid over the visible range, 380 to 780 nm.
        """
        b_nm2 = (self.refractive_index - 1.0) / self.abbe_number / (486.1**-2 - 656.3**-2)
        return self.refractive_index + b_nm2 * (wavelength_nm**-2 - 589.3**-2)


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


class Indenter(Model):
    """A rigid body that is pressed in from the coat, along the pad's normal, from where it first touches.

    A cylinder without ends (its axis across the pad, along x), a ball, a cuboid with rounded edges, or a closed
    triangle mesh in its own axes. ``rotation_deg`` turns it about x, then y, then z.
    """

    shape: Literal["cylinder", "ball", "cuboid", "mesh"] = "cylinder"
    radius_mm: LengthMm = Field(default=10.0, description="of a cylinder or a ball")
    size_mm: tuple[LengthMm, LengthMm, LengthMm] | None = Field(
        default=None, description="of a cuboid: across the pad, along its normal, along it"
    )
    edge_radius_mm: LengthMm = Field(default=1.0, description="of a cuboid's edges and corners")
    file: str | None = Field(default=None, description="of a mesh: closed STL in mm; relative to the design")
    depth_mm: Annotated[float, Field(ge=0.0, le=20.0, json_schema_extra={"unit": "mm"})] = 1.5
    position_mm: PositionMm = Field(default=35.0, description="of its middle (a mesh: its origin) along the pad")
    across_mm: PositionMm = Field(default=0.0, description="of its middle (a mesh: its origin) from the middle line")
    rotation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = (0.0, 0.0, 0.0)
    friction: Annotated[float, Field(ge=0.0, le=2.0, json_schema_extra={"unit": "1"})] = Field(
        default=0.0, description="Coulomb's coefficient between indenter and coat"
    )

    @model_validator(mode="after")
    def _shape_is_complete(self) -> "Indenter":
        for shape, name in (("cuboid", "size_mm"), ("mesh", "file")):
            if (getattr(self, name) is not None) != (self.shape == shape):
                state = "missing" if self.shape == shape else f"given for a {self.shape}"
                raise ValueError(f'{name} is {state}; it belongs to shape = "{shape}" and only to that')
        if self.size_mm is not None and 2.0 * self.edge_radius_mm > min(self.size_mm):
            raise ValueError(
                f"edge_radius_mm = {self.edge_radius_mm:g} mm must be at most half the cuboid's least size, "
                f"{min(self.size_mm) / 2.0:g} mm"
            )
        return self

    def idle_fields(self) -> dict[str, str]:
        """Return the sizes of other shapes."""
        of_shapes = {"radius_mm": ("cylinder", "ball"), "edge_radius_mm": ("cuboid",)}
        return {
            name: f'it is of a {" or a ".join(shapes)}, not of shape = "{self.shape}"; leave it out, or change shape'
            for name, shapes in of_shapes.items()
            if self.shape not in shapes
        }


class FingerDesign(Record):
    """Everything the simulation needs to know of a finger apart from the paints."""

    name: str = "fin-ray-70x35"
    pad: GelPad = GelPad(film=Film())
    coating: Coating = Coating()
    light: LightPanel = LightPanel()
    second_light: LightPanel | None = Field(default=None, description="a further panel, for example at the tip")
    enclosure: Enclosure = Enclosure()
    mirror: Mirror = Mirror()
    camera: TactileCamera = TactileCamera()
    indenter: Indenter = Indenter()
    skeleton: Skeleton = Skeleton(backing=Backing())
    mechanics: MechanicalMaterials = MechanicalMaterials()
    mesh: MeshPreset = MeshPreset()
    materials: dict[str, str] = Field(
        default={
            "gel": "XP-565 silicone 15 : 1 catalyst : 3 phenyl trimethicone (Silicones Inc., Lotioncrafter)",
            "coating": "35 um aluminium flake FM/6500 (Schlenk Offset) in silicone, airbrushed",
            "film": "Mylar sheet",
            "mirror": "PET-G sheet of 0.15 mm, mirrored",
            "red paint": "Liquitex BASICS fluorescent red in A-564 silicone adhesive",
            "green paint": "Liquitex BASICS fluorescent green in A-564 silicone adhesive",
            "light": "Chanzon blue LED",
            "sides": "laser-cut dark cloth",
            "base": "Onyx (Markforged)",
        },
        description="what the parts are made of, in words; the numbers above are what is computed with",
    )
    origin: dict[str, Origin] = Field(
        default={
            "pad.length_mm": "paper",
            "pad.width_mm": "paper",
            "pad.film.thickness_mm": "paper",
            "camera.field_of_view_deg": "paper",
            "indenter.radius_mm": "paper",
            "skeleton.mirror_thickness_mm": "paper",
            "mechanics.skeleton.mu_mpa": "paper",
            "mechanics.skeleton.alpha": "paper",
            "mechanics.gel.c10_mpa": "paper",
            **{
                f"mechanics.{part}.{name}": "paper"
                for part in ("onyx", "mirror", "film")
                for name in ("youngs_modulus_mpa", "poisson_ratio")
            },
        },
        description="where a number comes from; every number that is not listed is assumed",
    )
    uncertainty_rel: dict[str, RelativeUncertainty] = Field(
        default={},
        description="standard uncertainty of a number over its value; the force of a press is compared with it",
    )

    @field_validator("origin", "uncertainty_rel")
    @classmethod
    def _known_fields(cls, origin: dict[str, Any]) -> dict[str, Any]:
        known = [path for path in _field_paths(cls) if not path.startswith("provenance.")]
        for name in origin:
            if name not in known:
                near = difflib.get_close_matches(name, known, cutoff=0.5)
                hint = f"did you mean {' or '.join(near)}?" if near else f"fields are {', '.join(known)}"
                raise ValueError(f"'{name}' is no field of the design; {hint}")
        return origin

    def idle_fields(self) -> dict[str, str]:
        """Return also what the finger has no part for."""
        idle = super().idle_fields()
        if self.pad.film is None:
            idle["mechanics.film"] = "the pad has no film; add the table [pad.film], or leave it out"
        return idle

    @property
    def lights(self) -> tuple[LightPanel, ...]:
        """The panels of the finger."""
        return (self.light,) if self.second_light is None else (self.light, self.second_light)

    @model_validator(mode="after")
    def _pad_on_the_fin(self) -> "FingerDesign":
        width, ribs = self.skeleton.width_mm, self.skeleton.rib_width_mm
        if width is not None and self.pad.width_mm + 2.0 * ribs >= width:
            raise ValueError(
                f"skeleton.width_mm = {width:g} mm: the pad (pad.width_mm = {self.pad.width_mm:g} mm) and a rib of "
                f"rib_width_mm = {ribs:g} mm at each side are wider than the fin"
            )
        return self

    @model_validator(mode="after")
    def _one_led_spectrum(self) -> "FingerDesign":
        for name in ("peak_wavelength_nm", "fwhm_nm"):
            if self.second_light is not None and getattr(self.light, name) != getattr(self.second_light, name):
                raise ValueError(f"second_light.{name} must equal light.{name}: both panels share one LED band")
        return self

    @model_validator(mode="after")
    def _press_on_the_pad(self) -> "FingerDesign":
        if not 0.0 <= self.indenter.position_mm <= self.pad.length_mm:
            raise ValueError(
                f"indenter.position_mm = {self.indenter.position_mm} mm must lie on the pad (0 to "
                f"{self.pad.length_mm} mm)"
            )
        if abs(self.indenter.across_mm) > self.pad.width_mm / 2.0:
            raise ValueError(
                f"indenter.across_mm = {self.indenter.across_mm:g} mm must lie on the pad "
                f"(-{self.pad.width_mm / 2.0:g} to {self.pad.width_mm / 2.0:g} mm)"
            )
        return self


def _field_paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the dotted paths of all numbers and choices of a nested model."""
    for name, field in model.model_fields.items():
        inner = next(
            (
                kind
                for kind in (field.annotation, *get_args(field.annotation))
                if isinstance(kind, type) and issubclass(kind, BaseModel)
            ),
            None,
        )
        if inner is not None:
            yield from _field_paths(inner, f"{prefix}{name}.")
        elif prefix:
            yield prefix + name
