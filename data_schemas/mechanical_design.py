"""The mechanical half of a finger's design: skeleton, materials, fineness of the mesh; mm, N, MPa."""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from data_schemas.model import Model
from data_schemas.units import PositionMm

# unit -> what a number that is 1000 times too small, too large, or 10^6 times too large may have been given in
_MISTAKEN = {
    "mm": {1e3: "metres", 1e-3: "micrometres"},
    "MPa": {1e3: "GPa", 1e-3: "kPa", 1e-6: "Pa"},
}


def check_magnitude(value: float, low: float, high: float, unit: str) -> float:
    """Return a number that lies within bounds.

    Raises
    ------
    ValueError
        When it does not; the message names the unit that it seems to have been given in.
    """
    if low <= value <= high:
        return value
    meant = [(value * factor, name) for factor, name in _MISTAKEN[unit].items() if low <= value * factor <= high]
    hint = "".join(f"; it looks like a number in {name}: write {right:g}" for right, name in meant[:1])
    raise ValueError(f"{value:g} {unit} is outside {low:g} to {high:g} {unit}{hint}")


def _within(low: float, high: float, unit: str) -> AfterValidator:
    """Return the check of a number's magnitude."""
    return AfterValidator(lambda value: check_magnitude(value, low, high, unit))


def _field(unit: str, low: float, high: float) -> Any:
    """Return a field that carries unit and bounds into the JSON Schema."""
    return Field(json_schema_extra={"unit": unit, "minimum": low, "maximum": high}, allow_inf_nan=False)


SheetMm = Annotated[float, _field("mm", 0.02, 2.0), _within(0.02, 2.0, "mm")]
WallMm = Annotated[float, _field("mm", 0.2, 20.0), _within(0.2, 20.0, "mm")]
# of a skeleton, from a soft silicone to a stiff plastic
_SHEAR_MPA = (0.05, 1e3)
SizeMm = Annotated[float, _field("mm", 1.0, 500.0), _within(1.0, 500.0, "mm")]
SoftMpa = Annotated[float, _field("MPa", 0.01, 10.0), _within(0.01, 10.0, "MPa")]
StiffMpa = Annotated[float, _field("MPa", 50.0, 1e5), _within(50.0, 1e5, "MPa")]
OgdenMpa = Annotated[float, _field("MPa", -1e3, 1e3), _within(-1e3, 1e3, "MPa")]
PoissonRatio = Annotated[float, Field(ge=0.0, lt=0.5)]
BulkOverShear = Annotated[
    float,
    Field(ge=2.0, le=1e4, description="K / mu at small strain; the paper does not give it (20 is nu = 0.475)"),
]
Preset = Literal["coarse", "medium", "fine"]
RibAngleDeg = Annotated[float, Field(ge=-60.0, le=60.0, json_schema_extra={"unit": "deg"})]


class Backing(Model):
    """Semi-rigid plate on the outer side of the back fin, against twisting."""

    thickness_mm: WallMm = 0.8
    from_z_mm: PositionMm = Field(default=-5.0, description="below the hollow (about -4 mm) it joins the base plate")
    to_z_mm: PositionMm = 60.0

    @model_validator(mode="after")
    def _has_a_length(self) -> "Backing":
        if self.to_z_mm - self.from_z_mm < 1.0:
            raise ValueError(
                f"to_z_mm = {self.to_z_mm:g} mm must lie at least 1 mm above from_z_mm = {self.from_z_mm:g} mm"
            )
        return self


class Skeleton(Model):
    """Two fins, joined by ribs at both sides of a hollow, between a base plate and a solid tip.

    The front fin is a frame around the pad's window, the back fin a plate that carries the mirror; the back fin
    follows the mirror. The paper gives none of these dimensions but the thickness of the mirror.
    """

    width_mm: SizeMm | None = Field(
        default=None, description="of the fins; by default the mirror (pad + 2 mm), a gap of 0.5 mm and the ribs"
    )
    tip_starts_mm: SizeMm | None = Field(
        default=None, description="z where the hollow ends and the solid tip begins; by default just past the mirror"
    )
    tip_length_mm: SizeMm = 6.0
    base_thickness_mm: SizeMm = Field(default=6.0, description="of the base plate under the camera")
    front_fin_thickness_mm: WallMm = 1.6
    back_fin_thickness_mm: WallMm = 1.6
    flange_mm: WallMm = Field(
        default=1.0,
        description="how far the film (or, without one, a skin of adhesive) reaches beyond the pad on all sides, where "
        "it is glued on the front fin; the fin's window is as large as the pad",
    )
    rib_count: Annotated[int, Field(ge=0, le=40)] = 6
    rib_spacing_mm: SizeMm | None = Field(
        default=None, description="between centres, along the front fin; by default even from base to tip"
    )
    rib_thickness_mm: WallMm = 1.2
    rib_width_mm: WallMm = Field(default=3.0, description="across the finger, of the rib at each side of the hollow")
    rib_angle_deg: RibAngleDeg = Field(default=0.0, description="from the pad's normal; positive when the back is up")
    mirror_thickness_mm: SheetMm = 0.15
    backing: Backing | None = Field(default=None, description="none without this table")

    @model_validator(mode="after")
    def _ribs_stand_apart(self) -> "Skeleton":
        # the cosine: the spacing runs along the fin, the thickness across the rib
        needed = self.rib_thickness_mm / math.cos(math.radians(self.rib_angle_deg))
        if self.rib_spacing_mm is not None and self.rib_count > 1 and self.rib_spacing_mm <= needed:
            raise ValueError(
                f"rib_spacing_mm = {self.rib_spacing_mm:g} mm makes the ribs overlap: it must be more than "
                f"rib_thickness_mm / cos(rib_angle_deg) = {needed:.3g} mm"
            )
        return self

    def idle_fields(self) -> dict[str, str]:
        """Return the fields of ribs that are not there."""
        without = {"rib_spacing_mm": 2, "rib_thickness_mm": 1, "rib_angle_deg": 1}
        return super().idle_fields() | {
            name: f"it needs rib_count = {needed} or more, which is {self.rib_count}; leave it out, or add ribs"
            for name, needed in without.items()
            if self.rib_count < needed
        }


class OgdenSolid(Model):
    """Ogden rubber: energy sum of 2 mu_i / alpha_i^2 (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3), mu0 = sum of mu_i.

    Constants of the form mu_i / alpha_i (...) become these by mu_i alpha_i / 2. The paper prints that other form, with
    which its constants give mu0 = -0.617 MPa, an unstable solid; in the form here they give 7.918 MPa.
    """

    mu_mpa: tuple[OgdenMpa, ...] = (6.279, 1.639)
    alpha: tuple[float, ...] = (1.6663, -7.136)
    bulk_over_shear: BulkOverShear = 20.0

    @model_validator(mode="after")
    def _terms_are_complete(self) -> "OgdenSolid":
        if len(self.mu_mpa) != len(self.alpha) or not self.mu_mpa or 0.0 in self.alpha:
            raise ValueError(
                f"mu_mpa and alpha need one value per term and no alpha of 0, got {list(self.mu_mpa)} MPa and "
                f"{list(self.alpha)}"
            )
        if sum(self.mu_mpa) <= 0.0:
            raise ValueError(
                f"mu_mpa: the initial shear modulus, their sum, is {sum(self.mu_mpa):g} MPa and must be positive; "
                "constants of the form mu / alpha (...) must be multiplied by alpha / 2"
            )
        try:
            check_magnitude(sum(self.mu_mpa), *_SHEAR_MPA, "MPa")
        except ValueError as outside:
            raise ValueError(f"mu_mpa: the initial shear modulus, their sum: {outside}") from None
        return self


class NeoHookeSolid(Model):
    """Neo-Hookean rubber: energy C10 (I1 - 3), initial shear modulus 2 C10."""

    c10_mpa: SoftMpa = 0.1333
    bulk_over_shear: BulkOverShear = 20.0


class ElasticSolid(Model):
    """Linear elastic solid (St. Venant-Kirchhoff at large rotations)."""

    youngs_modulus_mpa: StiffMpa
    poisson_ratio: PoissonRatio


class MechanicalMaterials(Model):
    """What the parts are made of, by the paper's table; it gives the gel's constants as those of PDMS."""

    skeleton: OgdenSolid = OgdenSolid()
    gel: NeoHookeSolid = NeoHookeSolid()
    onyx: ElasticSolid = ElasticSolid(youngs_modulus_mpa=2100.0, poisson_ratio=0.38)
    mirror: ElasticSolid = ElasticSolid(youngs_modulus_mpa=2800.0, poisson_ratio=0.4)
    film: ElasticSolid = ElasticSolid(youngs_modulus_mpa=5000.0, poisson_ratio=0.38)


class MeshPreset(Model):
    """How finely the finger is meshed: pad of about 2 mm, 1 mm, or the paper's 0.4 mm."""

    preset: Preset = "coarse"
