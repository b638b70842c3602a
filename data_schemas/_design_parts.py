"""Parts of a finger's design: gel pad, indenter, the optical half and the mechanical half; mm, N, MPa.

The optical half is coating, light panels, mirror, camera and what closes the finger; the mechanical half is skeleton,
materials and fineness of the mesh.
"""

import math
from collections.abc import Iterable
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, model_validator

from data_schemas._model import Model
from data_schemas._plug_ins import (
    INDENTER_SHAPES,
    MATERIALS,
    PAD_SHAPES,
    PackagedPad,
    PackageName,
    Parameters,
    PlugIn,
    PlugInKind,
    find_plug_in,
    require_plug_in,
)
from data_schemas._units import AngleDeg, Fraction, LengthMm, PositionMm, RelativeUncertainty, WavelengthNm, WidthNm
from data_schemas.errors import FinrayError

RefractiveIndex = Annotated[float, Field(ge=1.0, le=2.5)]


class FromPackage(Model):
    """What another package may bring: its parameters, and which package that is."""

    parameters: Parameters = Field(default={})
    package: PackageName = None

    def _hold_package(self, kind: PlugInKind, name: str | None, ours: Iterable[str]) -> None:
        """Look up who brings a name that is not ours, unless a record or a design says it already."""
        if name is None or name in ours or self.package is not None:
            return
        try:
            object.__setattr__(self, "package", find_plug_in(kind, name, ours).source)
        except FinrayError as error:
            raise ValueError(str(error)) from None

    def _unused_here(self, name: str) -> dict[str, str]:
        """Return the fields that only what another package brings has."""
        why = f'it belongs to parts of other packages only, and "{name}" is one of finray; leave it out'
        return dict.fromkeys(("parameters", "package"), why)


class Film(Model):
    """Clear polyester (Mylar) sheet on the inner face of the gel."""

    thickness_mm: LengthMm = 0.1
    refractive_index: RefractiveIndex = 1.65


PAD_SHAPE_NAMES: Final = ("flat", "cylindrical", "ellipsoidal")


class GelPad(FromPackage):
    """A gel pad; sizes are always length x width, the thickness is that of the crown in the middle.

    Shapes of the coated face: flat; cylindrical with its axis along the pad; a section of an ellipsoid with its
    centre under the middle of the pad; or one that another package brings (:class:`PadShape`). Another shape of our own
    is one more case of :meth:`drop_mm`, the height function that mesh and optics take, and of its curvature below; the
    mould's STEP file has a case of its own.
    """

    shape: str = Field(
        default="flat", description=f"{', '.join(PAD_SHAPE_NAMES)}, or one that another package provides"
    )
    length_mm: LengthMm = 70.0
    width_mm: LengthMm = 35.0
    thickness_mm: LengthMm = 6.0
    radius_mm: LengthMm | None = Field(default=None, description="radius of a cylindrical pad")
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
        self._hold_package(PAD_SHAPES, self.shape, PAD_SHAPE_NAMES)
        needs = {"cylindrical": "radius_mm", "ellipsoidal": "semi_axes_mm"}
        for shape, name in needs.items():
            if (getattr(self, name) is not None) != (self.shape == shape):
                if self.shape == shape:
                    raise ValueError(f'{name} is missing, but shape = "{shape}" needs it')
                raise ValueError(f'{name} is supported only for shape = "{shape}", but shape is "{self.shape}"')
        half_width, half_length = self.width_mm / 2.0, self.length_mm / 2.0
        if self.radius_mm is not None and self.radius_mm <= half_width:
            raise ValueError(
                f"radius_mm = {self.radius_mm:g} mm must be more than half the width of the pad ({half_width:g} mm)"
            )
        if self.semi_axes_mm is not None:
            a, _, c = self.semi_axes_mm
            if (half_width / a) ** 2 + (half_length / c) ** 2 >= 1.0:
                raise ValueError(
                    f"semi_axes_mm: an ellipsoid of {a:g} mm across and {c:g} mm along does not cover the corners of "
                    f"a pad of {self.length_mm:g} x {self.width_mm:g} mm; (width/2a)^2 + (length/2c)^2 must be below 1"
                )
        if self.shape not in PAD_SHAPE_NAMES:
            return self._checked_outside()
        edge_mm = self.thickness_mm - self.drop_mm(half_width, half_length)
        if edge_mm <= 0.0:
            raise ValueError(
                f"thickness_mm = {self.thickness_mm:g} mm leaves no gel at the corners of the pad, where its face "
                f"lies {self.thickness_mm - edge_mm:.3g} mm below the crown; make the pad thicker or its radii larger"
            )
        return self

    def _checked_outside(self) -> "GelPad":
        """Return the pad after a check of the shape that a package brings, where that package is installed here."""
        try:
            shape = PackagedPad(require_plug_in(PAD_SHAPES, self.shape, self.package, PAD_SHAPE_NAMES))
        except FinrayError:  # a record of elsewhere is read all the same; who computes with it is told
            return self
        try:
            shape.check(self.length_mm, self.width_mm, self.thickness_mm, self.parameters)
        except FinrayError as error:
            raise ValueError(str(error)) from None
        return self

    def _outside(self) -> "PackagedPad":
        """Return the shape that a package brings."""
        return PackagedPad(require_plug_in(PAD_SHAPES, self.shape, self.package, PAD_SHAPE_NAMES))

    def unused_fields(self) -> dict[str, str]:
        """Return what only shapes of other packages have."""
        return super().unused_fields() | (self._unused_here(self.shape) if self.shape in PAD_SHAPE_NAMES else {})

    def drop_mm(self, x_mm: ArrayLike, z_from_middle_mm: ArrayLike) -> Any:
        """Return how far the undeformed coated face lies below its crown, shape of the broadcast arguments.

        Cylinder: r - sqrt(r^2 - x^2). Ellipsoid: b (1 - sqrt(1 - (x/a)^2 - (z/c)^2)). Inside the pad only.

        Raises
        ------
        SimulateError
            The shape is one of another package, which is not installed, of another version, or fails.
        """
        x, z = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(z_from_middle_mm, dtype=np.float64))
        if self.shape not in PAD_SHAPE_NAMES:
            return self._outside().drop_mm(x, z, self.parameters)
        if self.radius_mm is not None:
            return self.radius_mm - np.sqrt(self.radius_mm**2 - x**2)
        if self.semi_axes_mm is not None:
            a, b, c = self.semi_axes_mm
            return b * (1.0 - np.sqrt(1.0 - (x / a) ** 2 - (z / c) ** 2))
        return np.zeros(x.shape)

    def most_curvature_per_mm(self) -> float:
        """Return a bound of the second derivative of :meth:`drop_mm`, along any direction, over the whole pad.

        Cylinder: r^2 / (r^2 - x^2)^1.5 at the side. Ellipsoid: b / min(a, c)^2 / (1 - (x/a)^2 - (z/c)^2)^1.5 at a
        corner.
        """
        half_width, half_length = self.width_mm / 2.0, self.length_mm / 2.0
        if self.shape not in PAD_SHAPE_NAMES:
            return self._outside().most_curvature_per_mm(half_width, half_length, self.parameters)
        if self.radius_mm is not None:
            return float(self.radius_mm**2 / (self.radius_mm**2 - half_width**2) ** 1.5)
        if self.semi_axes_mm is not None:
            a, b, c = self.semi_axes_mm
            return float(b / min(a, c) ** 2 / (1.0 - (half_width / a) ** 2 - (half_length / c) ** 2) ** 1.5)
        return 0.0

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index by Cauchy's n = A + B / wavelength^2 through index and Abbe number.

        Valid over the visible range, 380 to 780 nm.
        """
        b_nm2 = (self.refractive_index - 1.0) / self.abbe_number / (486.1**-2 - 656.3**-2)
        return self.refractive_index + b_nm2 * (wavelength_nm**-2 - 589.3**-2)


# below it not even a fine mesh has a patch
LEAST_DEPTH_MM = 0.02


LARGEST_MOVE_MM = 200.0
LARGEST_TURN_DEG = 720.0
MOST_INCREMENTS = 1000

MoveMm = Annotated[float, Field(ge=-LARGEST_MOVE_MM, le=LARGEST_MOVE_MM, json_schema_extra={"unit": "mm"})]
TurnDeg = Annotated[float, Field(ge=-LARGEST_TURN_DEG, le=LARGEST_TURN_DEG, json_schema_extra={"unit": "deg"})]


class PathPose(Model):
    """One pose of an indenter on its path, from first touch: where its middle is, and how it is turned about that.

    The turn is a rotation vector about the middle (a mesh: the origin), after the move: x across the pad, y its outward
    normal, z along it. From one pose to the next, moves and rotation vectors change linearly.
    """

    across_mm: MoveMm = Field(default=0.0, description="move along x, across the pad")
    push_mm: MoveMm = Field(
        default=0.0, description="push into the pad, along its normal; below 0 the indenter has left the coat"
    )
    along_mm: MoveMm = Field(default=0.0, description="move along z, along the pad from its base")
    turn_x_deg: TurnDeg = 0.0
    turn_y_deg: TurnDeg = Field(default=0.0, description="turn about the pad's normal")
    turn_z_deg: TurnDeg = 0.0
    increments: Annotated[int, Field(ge=1, le=MOST_INCREMENTS)] | None = Field(
        default=None, description="number of equal steps on the way to this pose; none: as many as the command takes"
    )


INDENTER_SHAPE_NAMES: Final = ("cylinder", "ball", "cuboid", "mesh")


class Indenter(FromPackage):
    """A rigid body that is pressed in from the coat, along the pad's normal, from where it first touches.

    A cylinder without ends (its axis across the pad, along x), a ball, a cuboid with rounded edges, a closed triangle
    mesh in its own axes, or a body that another package brings. ``rotation_deg`` turns it about x, then y, then z.
    """

    shape: str = Field(
        default="cylinder", description=f"{', '.join(INDENTER_SHAPE_NAMES)}, or one that another package provides"
    )
    radius_mm: LengthMm = Field(default=10.0, description="radius of a cylinder or a ball")
    size_mm: tuple[LengthMm, LengthMm, LengthMm] | None = Field(
        default=None, description="size of a cuboid: across the pad, along its normal, along the pad"
    )
    edge_radius_mm: LengthMm = Field(default=1.0, description="radius of a cuboid's edges and corners")
    file: str | None = Field(default=None, description="file of a mesh: closed STL in mm; relative to the design")
    depth_mm: Annotated[float, Field(ge=0.0, le=20.0, json_schema_extra={"unit": "mm"})] = Field(
        default=1.5, description=f"0 without a press, else at least {LEAST_DEPTH_MM:g} mm"
    )
    position_mm: PositionMm = Field(default=35.0, description="place of its middle (a mesh: its origin) along the pad")
    across_mm: PositionMm = Field(
        default=0.0, description="distance of its middle (a mesh: its origin) from the middle line"
    )
    rotation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = (0.0, 0.0, 0.0)
    friction: Annotated[float, Field(ge=0.0, le=2.0, json_schema_extra={"unit": "1"})] = Field(
        default=0.0, description="Coulomb's coefficient between indenter and coat"
    )
    path: tuple[PathPose, ...] = Field(
        default=(),
        max_length=MOST_INCREMENTS,
        description="poses that a press by finite elements moves through, in place of depth_mm",
    )

    @model_validator(mode="after")
    def _path_is_not_too_long(self) -> "Indenter":
        total = sum(pose.increments or 1 for pose in self.path)
        if total > MOST_INCREMENTS:
            raise ValueError(f"path: the poses have {total} increments, but at most {MOST_INCREMENTS} are allowed")
        return self

    @model_validator(mode="after")
    def _shape_is_complete(self) -> "Indenter":
        self._hold_package(INDENTER_SHAPES, self.shape, INDENTER_SHAPE_NAMES)
        for shape, name in (("cuboid", "size_mm"), ("mesh", "file")):
            if (getattr(self, name) is not None) != (self.shape == shape):
                if self.shape == shape:
                    raise ValueError(f'{name} is missing, but shape = "{shape}" needs it')
                raise ValueError(f'{name} is supported only for shape = "{shape}", but shape is "{self.shape}"')
        if 0.0 < self.depth_mm < LEAST_DEPTH_MM:
            raise ValueError(
                f"depth_mm = {self.depth_mm:g} mm is less than the {LEAST_DEPTH_MM:g} mm that the finest mesh "
                f"resolves; it looks like a number in metres, so write {1000.0 * self.depth_mm:g}"
            )
        if self.size_mm is not None and 2.0 * self.edge_radius_mm > min(self.size_mm):
            raise ValueError(
                f"edge_radius_mm = {self.edge_radius_mm:g} mm must be at most half the cuboid's least size, "
                f"{min(self.size_mm) / 2.0:g} mm"
            )
        return self

    @property
    def is_packaged(self) -> bool:
        """Whether another package brings its shape."""
        return self.shape not in INDENTER_SHAPE_NAMES

    @property
    def pose_shape(self) -> Literal["cylinder", "ball", "cuboid", "mesh"]:
        """Its shape as captures tell it, which know a body of any other shape as a mesh."""
        known: dict[str, Literal["cylinder", "ball", "cuboid", "mesh"]]
        known = {"cylinder": "cylinder", "ball": "ball", "cuboid": "cuboid"}
        return known.get(self.shape, "mesh")

    def plug_in(self) -> PlugIn:
        """Return who brings its shape, where that is no shape of ours.

        Raises
        ------
        SimulateError
            No package does, or one of another version than the design holds.
        """
        return require_plug_in(INDENTER_SHAPES, self.shape, self.package, INDENTER_SHAPE_NAMES)

    def unused_fields(self) -> dict[str, str]:
        """Return the sizes of other shapes."""
        of_shapes = {"radius_mm": ("cylinder", "ball"), "edge_radius_mm": ("cuboid",)}
        return ({} if self.is_packaged else self._unused_here(self.shape)) | {
            name: f'it belongs to a {" or a ".join(shapes)}, not to shape = "{self.shape}"; omit it, or change shape'
            for name, shapes in of_shapes.items()
            if self.shape not in shapes
        }


class Coating(Model):
    """Aluminium-flake coating on the touched face: a blend of a rough conductor and a diffuse part."""

    roughness_alpha: Annotated[float, Field(gt=0.0, le=1.0, description="GGX alpha")] = 0.25
    diffuse_share: Fraction = 0.35
    diffuse_reflectance: Fraction = 0.6


class LightPanel(Model):
    """Blue LED panel outside the gel, below the inner face."""

    angle_deg: AngleDeg = 30.0
    azimuth_deg: AngleDeg = Field(
        default=0.0, description="direction of its light in the plane of the pad: 0 along +z, 90 along +x"
    )
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
        description="exponent m: intensity ~ cos^m of the angle from the normal; 1 is Lambertian, and the half angle "
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
    base_yz_mm: tuple[PositionMm, PositionMm] | None = Field(
        default=None,
        description="y and z where its line meets the pad's base; by default -20, 0 for a pad of 70 x 35 mm, scaled "
        "with the pad's size",
    )
    tip_yz_mm: tuple[PositionMm, PositionMm] | None = Field(
        default=None,
        description="y and z where its line meets the pad's tip; by default -4.5, 70 for a pad of 70 x 35 mm, scaled",
    )
    overhang_mm: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})] = Field(
        default=4.0, description="how far the mirror reaches beyond both places"
    )
    side_overhang_mm: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})] = Field(
        default=1.0, description="how far the mirror reaches beyond the pad at each side"
    )

    @model_validator(mode="after")
    def _behind_the_pad(self) -> "Mirror":
        for name in ("base_yz_mm", "tip_yz_mm"):
            place = getattr(self, name)
            if place is not None and place[0] >= 0.0:
                raise ValueError(f"{name}: y must be negative (behind the inner face, y = 0 mm), got {place[0]:g} mm")
        if self.base_yz_mm is not None and self.tip_yz_mm is not None and self.tip_yz_mm[1] <= self.base_yz_mm[1]:
            raise ValueError(
                f"tip_yz_mm: z = {self.tip_yz_mm[1]:g} mm must be greater than z = {self.base_yz_mm[1]:g} mm of "
                "base_yz_mm"
            )
        return self


class TactileCamera(Model):
    """Camera at the base that sees the pad through the mirror."""

    position_mm: tuple[PositionMm, PositionMm, PositionMm] | None = Field(
        default=None,
        description="x, y, z of the pinhole; by default 0, -15, -2 for a pad of 70 x 35 mm, scaled with the pad's size",
    )
    aim_deg: Annotated[float, Field(ge=-80.0, le=80.0, json_schema_extra={"unit": "deg"})] = Field(
        default=14.0, description="angle of the line of sight behind the mirror, from the pad's normal towards the tip"
    )
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
    def _outside_the_gel(self) -> "TactileCamera":
        if self.position_mm is not None and self.position_mm[1] >= 0.0:
            raise ValueError(
                "position_mm: y must be negative (outside the gel, whose inner face is y = 0 mm), got "
                f"{self.position_mm[1]:g} mm"
            )
        return self

    @model_validator(mode="after")
    def _whole_bayer_cells(self) -> "TactileCamera":
        if self.width_px % 2 or self.height_px % 2:
            raise ValueError(
                f"width_px and height_px must be even, because Bayer cells are 2 x 2 pixels, got {self.width_px} x "
                f"{self.height_px}"
            )
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return the field of view where a calibration tells it."""
        if self.calibration is None:
            return {}
        return {
            "field_of_view_deg": "camera.calibration already states where each pixel looks; leave out one of the two"
        }


class Enclosure(Model):
    """What closes the finger: cloth on the sides, the printed base; both dark."""

    cloth_reflectance: Fraction = 0.04
    base_reflectance: Fraction = 0.05
    panel_reflectance: Fraction = Field(default=0.05, description="reflectance of the light panels themselves")
    cloth_clearance_mm: LengthMm = Field(
        default=8.0, description="distance of the cloth around finger, lights and camera"
    )


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
    hint = "".join(f"; it looks like a number in {name}, so write {right:g}" for right, name in meant[:1])
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
    from_z_mm: PositionMm = Field(
        default=-5.0, description="z where the backing begins; below the hollow (about -4 mm) it joins the base plate"
    )
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
        default=None,
        description="width of the fins; by default that of the mirror (pad + 2 mm), a gap of 0.5 mm and the ribs",
    )
    tip_starts_mm: SizeMm | None = Field(
        default=None, description="z where the hollow ends and the solid tip begins; by default just past the mirror"
    )
    tip_length_mm: SizeMm = 6.0
    base_thickness_mm: SizeMm = Field(default=6.0, description="thickness of the base plate under the camera")
    front_fin_thickness_mm: WallMm = 1.6
    back_fin_thickness_mm: WallMm = 1.6
    flange_mm: WallMm = Field(
        default=1.0,
        description="how far the film (or, without one, a skin of adhesive) reaches beyond the pad on all sides, where "
        "it is glued on the front fin; the fin's window is as large as the pad",
    )
    rib_count: Annotated[int, Field(ge=0, le=40)] = 6
    rib_spacing_mm: SizeMm | None = Field(
        default=None,
        description="distance between the ribs' centres along the front fin; by default evenly spread from base to tip",
    )
    rib_thickness_mm: WallMm = 1.2
    rib_width_mm: WallMm = Field(
        default=3.0, description="width of the rib at each side of the hollow, across the finger"
    )
    rib_angle_deg: RibAngleDeg = Field(
        default=0.0, description="angle from the pad's normal; positive when the rib rises towards its back"
    )
    mirror_thickness_mm: SheetMm = 0.15
    backing: Backing | None = Field(default=None, description="plate on the back fin; without this table there is none")

    @model_validator(mode="after")
    def _ribs_stand_apart(self) -> "Skeleton":
        # the cosine: the spacing runs along the fin, the thickness across the rib
        needed = self.rib_thickness_mm / math.cos(math.radians(self.rib_angle_deg))
        if self.rib_spacing_mm is not None and self.rib_count > 1 and self.rib_spacing_mm <= needed:
            raise ValueError(
                f"rib_spacing_mm = {self.rib_spacing_mm:g} mm makes the ribs overlap; it must be more than "
                f"rib_thickness_mm / cos(rib_angle_deg) = {needed:.3g} mm"
            )
        return self

    def unused_fields(self) -> dict[str, str]:
        """Return the fields of ribs that are not there."""
        without = {"rib_spacing_mm": 2, "rib_thickness_mm": 1, "rib_angle_deg": 1}
        return super().unused_fields() | {
            name: f"it needs rib_count = {needed} or more, but rib_count is {self.rib_count}; leave it out, or add ribs"
            for name, needed in without.items()
            if self.rib_count < needed
        }


class Rubber(FromPackage):
    """A nearly incompressible solid, whose law of strain energy another package may bring.

    ``law`` then names it, and ``parameters`` its constants; the constants of our own law have no effect.
    """

    law: str | None = Field(
        default=None, description="material law of another package, by its name; none: the law of this table"
    )

    @model_validator(mode="after")
    def _law_is_installed(self) -> "Rubber":
        self._hold_package(MATERIALS, self.law, ())
        return self

    def plug_in(self) -> PlugIn:
        """Return who brings its law, where that is not our own.

        Raises
        ------
        SimulateError
            No package does, or one of another version than the design holds.
        """
        return require_plug_in(MATERIALS, str(self.law), self.package)

    def unused_fields(self) -> dict[str, str]:
        """Return the constants of our own law where another one holds, or what only other laws have."""
        if self.law is None:
            return self._unused_here("its own law")
        own = set(type(self).model_fields) - set(Rubber.model_fields) - {"bulk_over_shear"}
        return dict.fromkeys(sorted(own), f'it belongs to the built-in law, not to law = "{self.law}"; leave it out')


class OgdenSolid(Rubber):
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
                "mu_mpa and alpha must have the same number of terms, at least 1, and no alpha may be 0; got "
                f"{list(self.mu_mpa)} MPa and {list(self.alpha)}"
            )
        if sum(self.mu_mpa) <= 0.0:
            raise ValueError(
                "mu_mpa: the initial shear modulus (the sum of the terms) must be positive, but is "
                f"{sum(self.mu_mpa):g} MPa; if the constants are those of an energy with the prefactor mu / alpha, "
                "multiply each mu by alpha / 2"
            )
        try:
            check_magnitude(sum(self.mu_mpa), *_SHEAR_MPA, "MPa")
        except ValueError as outside:
            raise ValueError(f"mu_mpa: the initial shear modulus (the sum of the terms) of {outside}") from None
        return self


class NeoHookeSolid(Rubber):
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
