"""The finger or classic sensor as a designer describes it (TOML), and which finger a product is of.

Axes: x across the pad, y from the inner (camera side) face into the gel, z along the pad from the base; mm.
The light angle is the angle of the panel's normal from the pad plane: 0 along the pad, 90 straight into it. All
angles and places of a classic sensor's lights and camera are told from the axis through its pad's middle, along the
pad's normal.

The identity of a finger is what its light depends on, part by part, as checksums.
"""

import difflib
import hashlib
import json
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Final, Literal, get_args

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
    PoissonRatio,
    Skeleton,
    TactileCamera,
)
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
            idle["mechanics.film"] = "the pad has no film; add the table [pad.film], or leave [mechanics.film] out"
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
                f"skeleton.width_mm = {width:g} mm is too narrow; it must be more than the pad (pad.width_mm = "
                f"{self.pad.width_mm:g} mm) and a rib at each side (rib_width_mm = {ribs:g} mm) together"
            )
        return self

    @model_validator(mode="after")
    def _one_led_spectrum(self) -> "FingerDesign":
        others = [("second_light", self.second_light)] if self.second_light is not None else []
        others += [(f"further_lights (entry {k})", light) for k, light in enumerate(self.further_lights, start=1)]
        for name in ("peak_wavelength_nm", "fwhm_nm"):
            for panel, light in others:
                if getattr(self.light, name) != getattr(light, name):
                    raise ValueError(f"{panel}.{name} must equal light.{name}, because all panels share one LED band")
        return self

    @model_validator(mode="after")
    def _press_on_the_pad(self) -> "FingerDesign":
        if not 0.0 <= self.indenter.position_mm <= self.pad.length_mm:
            metres = f"; pad.length_mm looks like a number in metres, so write {1e3 * self.pad.length_mm:g}"
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
    """Return the notes on fields, such as where their numbers come from.

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
                f"'{name}' = {told[name]:g}: a relative standard uncertainty must be at most 1; write 0.05 for 5 %"
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
    "light": {"angle_deg"},  # a sweep turns the first panel only
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
VERSION: Final = 4
"""Of what is hashed: another field of a part, or another way to hash, is another version. Version 1 left out fields at
their default, so that after a change of a default different fingers could look alike; version 2 knew the place of the
mirror by the pad's size only, and at most two panels; version 3 left out the angle of the second panel."""
_PARTS: Final = (
    "pad", "coating", "light", "second_light", "further_lights", "enclosure", "mirror", "camera", "indenter",
    "skeleton", "mechanics",
)  # fmt: skip


class FingerIdentity(Model):
    """A finger with its indenter, without the angle of its first light and the depth of the press."""

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
        default=1.0, description="exponent m: intensity ~ cos^m of the angle from the normal; 1 is Lambertian"
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
                f"depth_mm = {self.depth_mm:g} mm is too small, because an edge of the {self.channel} panel would "
                f"touch or cross the inner face; it must be more than {reach_mm:.3g} mm for a panel of this height "
                "and angle"
            )
        return self

    @model_validator(mode="after")
    def _white_has_no_peak(self) -> "ColouredLight":
        for name in ("peak_wavelength_nm", "fwhm_nm"):
            if self.channel == "white" and getattr(self, name) is not None:
                raise ValueError(f"{name} is not supported for a white LED, whose spectrum is fixed; leave {name} out")
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
            idle["roughness_alpha"] = (
                "a coat of diffuse_share = 1 contains no metal; leave the field out, or lower the share"
            )
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
            raise ValueError(f"file = {self.file!r} must end in .npy or .png (height map), or in .stl (mesh)")
        if suffix != ".stl" and self.step_mm is None:
            raise ValueError("step_mm is missing; a height map needs the distance between neighbouring points in mm")
        if suffix == ".png" and self.unit_mm is None:
            raise ValueError("unit_mm is missing; a picture needs the height of one grey level in mm, such as 0.001")
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return the fields of a map where a mesh is given."""
        if not self.file.lower().endswith(".stl"):
            return {}
        why = "it belongs to a height map, but an STL file is already in mm and in the axes of the pad; leave it out"
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
                f"coating.translucent.thickness_mm = {layer.thickness_mm:g} mm must be at most pad.thickness_mm = "
                f"{self.pad.thickness_mm:g} mm, because the layer is part of the gel"
            )
        return self

    @model_validator(mode="after")
    def _press_is_possible(self) -> "PlainSensor":
        self.pressed_pad()
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return also what a surface, clear walls or an ideal camera leaves without effect."""
        idle = super().unused_fields()
        idle["indenter.path"] = (
            "a classic sensor's indenter is pressed along the pad's normal, by depth_mm; leave indenter.path out"
        )
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
