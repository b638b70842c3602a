"""The finger as a designer describes it (TOML), and which finger a product is of.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from the base; mm.
The light angle is the angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it.

The identity of a finger is what its light depends on, part by part, as checksums.
"""

import difflib
import hashlib
import json
from collections.abc import Iterator
from typing import Any, ClassVar, Final, Literal, get_args

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
from data_schemas._units import RelativeUncertainty

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


MOST_FURTHER_LIGHTS: Final = 46


class FingerDesign(Record):
    """Everything the simulation needs to know of a finger apart from the paints."""

    schema_version: ClassVar[int] = 4
    shown: ClassVar[tuple[str, ...]] = (
        "pad.length_mm", "pad.width_mm", "pad.thickness_mm", "light.angle_deg", "indenter.shape", "indenter.depth_mm",
    )  # fmt: skip

    name: str = "fin-ray-70x35"
    pad: GelPad = GelPad(film=Film())
    coating: Coating = Coating()
    light: LightPanel = LightPanel()
    second_light: LightPanel | None = Field(default=None, description="a further panel, for example at the tip")
    further_lights: tuple[LightPanel, ...] = Field(
        default=(), max_length=MOST_FURTHER_LIGHTS, description="more panels"
    )
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
        description="what the parts are made of, in words; the program computes with the numbers above",
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
        description="relative standard uncertainty of a number, for comparisons with a measured force",
    )

    @field_validator("origin", "uncertainty_rel")
    @classmethod
    def _known_fields(cls, origin: dict[str, Any]) -> dict[str, Any]:
        return of_known_fields(cls, origin)

    def unused_fields(self) -> dict[str, str]:
        """Return also what the finger has no part for."""
        idle = super().unused_fields()
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
        second = () if self.second_light is None else (self.second_light,)
        return (self.light, *second, *self.further_lights)

    def packaged_parts(self) -> tuple[str, ...]:
        """Return what other packages bring: ``mechanics.gel.law = "yeoh" of my-rubbers 0.1``."""
        gel, skeleton = self.mechanics.gel, self.mechanics.skeleton
        named = (
            ("pad.shape", self.pad.shape, self.pad.package),
            ("indenter.shape", self.indenter.shape, self.indenter.package),
            ("mechanics.gel.law", gel.law, gel.package),
            ("mechanics.skeleton.law", skeleton.law, skeleton.package),
        )
        return tuple(f'{field} = "{name}" of {package}' for field, name, package in named if package is not None)

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
        others = [("second_light", self.second_light)] if self.second_light is not None else []
        others += [(f"further_lights (entry {k})", light) for k, light in enumerate(self.further_lights, start=1)]
        for name in ("peak_wavelength_nm", "fwhm_nm"):
            for panel, light in others:
                if getattr(self.light, name) != getattr(light, name):
                    raise ValueError(f"{panel}.{name} must equal light.{name}: all panels share one LED band")
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


def of_known_fields(model: type[BaseModel], told: dict[str, Any]) -> dict[str, Any]:
    """Return what is told of fields, such as where their numbers come from.

    Raises
    ------
    ValueError
        One is not a field of a part of the design; the message names what is near. Or an uncertainty is above 1.
    """
    known = [path for path in _field_paths(model) if not path.startswith("provenance.")]
    for name in told:
        if name not in known:
            near = difflib.get_close_matches(name, known, cutoff=0.5)
            hint = f"did you mean {' or '.join(near)}?" if near else f"fields are {', '.join(known)}"
            raise ValueError(f"'{name}' is not a field of the design; {hint}")
        if isinstance(told[name], float) and told[name] > 1.0:
            raise ValueError(
                f"'{name}' = {told[name]:g}: is a relative standard uncertainty, so at most 1 is allowed; write "
                "0.05 for 5 %"
            )
    return told


def _field_paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the dotted paths of all numbers and choices of a nested model; of a list, those of its entries."""
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
        elif prefix or field.annotation in (float, int):
            yield prefix + name


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
        "position_mm",
        "aim_deg",
        "response_at_led_uncertainty_rel",
    },
    "indenter": {"depth_mm", "path"},
}
VERSION: Final = 3
"""Of what is hashed: another field of a part, or another way to hash, is another version. Version 1 left out fields at
their default, so that after a change of a default different fingers could look alike; version 2 knew the place of the
mirror by the pad's size only, and at most two panels."""
_PARTS: Final = (
    "pad", "coating", "light", "second_light", "further_lights", "enclosure", "mirror", "camera", "indenter",
    "skeleton", "mechanics",
)  # fmt: skip


class FingerIdentity(Model):
    """A finger with its indenter, without the angle of its light and the depth of the press."""

    version: int = Field(
        default=1,
        description="version of the rules for hashing; parts that were hashed by different versions cannot be compared",
    )
    name: str
    depth_mm: float = Field(description="depth of the press; another depth is another press of the same finger")
    parts: dict[str, str] = Field(description="part of the design -> SHA-256 of its values")

    def differs_in(self, other: "FingerIdentity") -> tuple[str, ...]:
        """Return the parts that are not those of another finger."""
        names = sorted(self.parts.keys() | other.parts.keys())
        return tuple(name for name in names if self.parts.get(name) != other.parts.get(name))


def finger_identity(design: FingerDesign) -> FingerIdentity:
    """Return which finger a design describes; names, origins, materials in words and meshes do not count.

    All values count, those at their default too, but for what only parts of other packages have. Files count by their
    name: an STL of an indenter that was changed and kept its name is not noticed.
    """
    parts = {}
    for name in _PARTS:
        part = getattr(design, name)
        if isinstance(part, tuple):
            given: Any = [one.model_dump(mode="json") for one in part]
        else:
            given = None if part is None else part.model_dump(mode="json")
        if isinstance(given, dict):
            given = {key: value for key, value in given.items() if key not in _LEFT_OUT.get(name, set())}
        parts[name] = hashlib.sha256(json.dumps(_without_packages(given), sort_keys=True).encode()).hexdigest()
    return FingerIdentity(version=VERSION, name=design.name, depth_mm=design.indenter.depth_mm, parts=parts)


def _without_packages(given: Any) -> Any:
    """Leave out the fields of other packages' parts where there are none: such a finger is the one it was before."""
    if isinstance(given, dict):
        empty = {key for key in ("law", "parameters", "package") if not given.get(key)}
        return {key: _without_packages(value) for key, value in given.items() if key not in empty}
    return given
