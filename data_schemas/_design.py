"""The finger as a designer describes it (TOML), a classic tactile sensor beside it, and which finger a product is of.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from the base; mm.
The light angle is the angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it.

A classic sensor is a flat or domed gel pad over coloured light panels, with a camera straight below. The identity of
a finger is what its light depends on, part by part, as checksums.
"""

import difflib
import hashlib
import json
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, field_validator, model_validator

from data_schemas._design_parts import (
    Backing,
    Coating,
    Enclosure,
    Film,
    GelPad,
    Indenter,
    LightPanel,
    MechanicalMaterials,
    MeshPreset,
    Mirror,
    Skeleton,
    TactileCamera,
)
from data_schemas._model import Model, Record
from data_schemas._units import AngleDeg, Fraction, LengthMm, RelativeUncertainty

Origin = Literal["measured", "data sheet", "paper", "assumed"]
PAPER_VALUES: Final[dict[str, tuple[Any, ...]]] = {
    "pad.length_mm": (70.0, 48.0, 50.0),
    "pad.width_mm": (35.0, 18.0, 60.0, 50.0),
    "pad.film.thickness_mm": (0.1,),
    "camera.field_of_view_deg": (120.0,),
    "indenter.radius_mm": (10.0,),
    "skeleton.mirror_thickness_mm": (0.15,),
    "mechanics.skeleton.mu_mpa": ((6.279, 1.639),),
    "mechanics.skeleton.alpha": ((1.6663, -7.136),),
    "mechanics.gel.c10_mpa": (0.1333,),
    "mechanics.onyx.youngs_modulus_mpa": (2100.0,),
    "mechanics.onyx.poisson_ratio": (0.38,),
    "mechanics.mirror.youngs_modulus_mpa": (2800.0,),
    "mechanics.mirror.poisson_ratio": (0.4,),
    "mechanics.film.youngs_modulus_mpa": (5000.0,),
    "mechanics.film.poisson_ratio": (0.38,),
}
"""Field -> the values that the paper gives for its fingers; another value is not the paper's, whatever a file says."""


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
        description="where a number comes from; every number that is not listed is assumed, and so is one listed as "
        "'paper' whose value is not the paper's",
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

    @model_validator(mode="after")
    def _paper_numbers_are_the_paper_s(self) -> "FingerDesign":
        kept = {name: where for name, where in self.origin.items() if where != "paper" or self._is_of_paper(name)}
        if len(kept) < len(self.origin):
            object.__setattr__(self, "origin", kept)
        return self

    def _is_of_paper(self, field: str) -> bool:
        """Return whether a number is one that the paper gives."""
        value: Any = self
        for name in field.split("."):
            value = getattr(value, name, None)
        return value in PAPER_VALUES.get(field, ())

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
            metres = f"; pad.length_mm looks like a number in metres: write {1e3 * self.pad.length_mm:g}"
            raise ValueError(
                f"indenter.position_mm = {self.indenter.position_mm} mm must lie on the pad (0 to "
                f"{self.pad.length_mm} mm){metres if self.pad.length_mm < 1.0 else ''}"
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


Channel = Literal["red", "green", "blue"]
CHANNELS: tuple[Channel, ...] = ("red", "green", "blue")


class ColouredLight(Model):
    """A light panel beside and below the pad that shines in one channel of the picture."""

    channel: Channel
    azimuth_deg: AngleDeg = Field(
        default=0.0, description="where its light goes, seen along the pad: 0 along +z, 90 along +x"
    )
    angle_deg: AngleDeg = Field(
        default=40.0, description="of the panel's normal from the pad plane: 0 along the pad, 90 straight into it"
    )
    distance_mm: LengthMm = Field(default=14.0, description="of its centre from the axis through the pad's middle")
    depth_mm: LengthMm = Field(default=10.0, description="of its centre below the inner face")
    width_mm: LengthMm = 12.0
    height_mm: LengthMm = 4.0
    power_rel: Annotated[float, Field(gt=0.0, le=100.0)] = Field(default=1.0, description="radiance along the normal")
    beam_exponent: Annotated[float, Field(ge=1.0, le=50.0)] = Field(
        default=1.0, description="m of an intensity ~ cos^m of the angle from the normal; 1 is Lambertian"
    )

    @model_validator(mode="after")
    def _below_the_pad(self) -> "ColouredLight":
        reach_mm = self.height_mm / 2.0 * abs(float(np.cos(np.radians(self.angle_deg))))
        if reach_mm >= self.depth_mm:
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} mm puts an edge of the {self.channel} panel at the inner face or above "
                f"it; it must be more than {reach_mm:.3g} mm for a panel of this height and angle"
            )
        return self


class CameraBelow(Model):
    """Pinhole camera on the axis through the pad's middle that looks straight at it.

    Columns of the picture run along +x, rows against z, as the camera sees the pad.
    """

    distance_mm: LengthMm = Field(default=40.0, description="of the pinhole below the inner face")
    field_of_view_deg: Annotated[float, Field(ge=5.0, le=120.0, json_schema_extra={"unit": "deg"})] = Field(
        default=30.0, description="over the width of the picture"
    )
    width_px: Annotated[int, Field(ge=8, le=4096)] = 160
    height_px: Annotated[int, Field(ge=8, le=4096)] = 160


def _three_lights() -> tuple[ColouredLight, ...]:
    """Return three lights a third of a turn apart."""
    return tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in zip(CHANNELS, (0.0, 120.0, -120.0), strict=True))


class PlainSensor(Record):
    """A classic sensor without fluorescence: every number is an assumption unless its user knows better.

    The gel's index is that at 589 nm in all channels: over the visible range it differs by 0.01.
    """

    name: str = "plain-20x20"
    pad: GelPad = GelPad(length_mm=20.0, width_mm=20.0, thickness_mm=4.0)
    coating: Coating = Coating(diffuse_share=0.8)
    walls: Literal["dark", "clear"] = Field(default="dark", description="sides of the gel: black-painted, or bare gel")
    wall_reflectance: Fraction = Field(default=0.05, description="of dark walls")
    box_reflectance: Fraction = Field(default=0.04, description="of the housing")
    lights: tuple[ColouredLight, ...] = Field(default_factory=_three_lights, min_length=1, max_length=3)
    camera: CameraBelow = CameraBelow()
    indenter: Indenter = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0)

    @model_validator(mode="after")
    def _one_light_per_channel(self) -> "PlainSensor":
        channels = [light.channel for light in self.lights]
        if len(set(channels)) < len(channels):
            raise ValueError(f"lights: one panel per channel, got {', '.join(channels)}")
        return self

    @model_validator(mode="after")
    def _press_is_possible(self) -> "PlainSensor":
        self.pressed_pad()
        return self

    def pressed_pad(self) -> FingerDesign:
        """Return pad and indenter as a design whose coated face the analytic press can shape.

        Raises
        ------
        ValueError
            When the indenter lies beside the pad.
        """
        return FingerDesign(pad=self.pad, coating=self.coating, indenter=self.indenter)

    def middle_mm(self) -> NDArray[np.float64]:
        """Return the middle of the inner face, shape (3,)."""
        return np.array([0.0, 0.0, self.pad.length_mm / 2.0])


#: Fields that are no part of the finger: what is varied or set in a session, how finely it is computed, and words.
_LEFT_OUT: Final = {
    "light": {"angle_deg"},
    "second_light": {"angle_deg"},
    # a sweep sees its probe points along the normal of the pad: of the camera it has the response only
    "camera": {
        "width_px",
        "height_px",
        "bit_depth",
        "field_of_view_deg",
        "calibration",
        "response_at_led_uncertainty_rel",
    },
    "indenter": {"depth_mm"},
}
VERSION: Final = 2
"""Of what is hashed: another field of a part, or another way to hash, is another version. Version 1 left out fields at
their default, so that after a change of a default different fingers could look alike."""
_PARTS: Final = (
    "pad", "coating", "light", "second_light", "enclosure", "mirror", "camera", "indenter", "skeleton", "mechanics",
)  # fmt: skip


class FingerIdentity(Model):
    """A finger with its indenter, without the angle of its light and the depth of the press."""

    version: int = Field(default=1, description="of what is hashed; parts of two versions cannot be compared")
    name: str
    depth_mm: float = Field(description="of the press; another depth is another press of the same finger")
    parts: dict[str, str] = Field(description="part of the design -> SHA-256 of its values")

    def differs_in(self, other: "FingerIdentity") -> tuple[str, ...]:
        """Return the parts that are not those of another finger."""
        names = sorted(self.parts.keys() | other.parts.keys())
        return tuple(name for name in names if self.parts.get(name) != other.parts.get(name))


def finger_identity(design: FingerDesign) -> FingerIdentity:
    """Return which finger a design describes; names, origins, materials in words and meshes do not count.

    All values count, those at their default too. Files count by their name: an STL of an indenter that was changed and
    kept its name is not noticed.
    """
    parts = {}
    for name in _PARTS:
        part = getattr(design, name)
        given: Any = None if part is None else part.model_dump(mode="json")
        if given is not None:
            given = {key: value for key, value in given.items() if key not in _LEFT_OUT.get(name, set())}
        parts[name] = hashlib.sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()
    return FingerIdentity(version=VERSION, name=design.name, depth_mm=design.indenter.depth_mm, parts=parts)
