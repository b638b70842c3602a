"""What the simulation writes: a rendered press, a sweep of the light angle, what pressing takes, deformed surfaces.

The mechanics writes push, force and energy, increment by increment, and the surfaces that the optics renders.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._curves import SpectralCurve
from data_schemas._design import FingerDesign, PlainSensor
from data_schemas._design_parts import Indenter, Preset
from data_schemas._model import Model, Record
from data_schemas._units import AngleDeg, ArraySpec, Fraction

Image = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "3"))]
Distance = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column"), "contact half-width", allow_nan=True)]
Bands = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "band"), "W/m2/sr, relative")]
Chains = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "chain"), "W/m2/sr, relative")]
Floats = NDArray[np.float64]
Layers = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "layer"), "W/m2/sr, relative")]
PoseLayers = Annotated[
    NDArray[np.float32], ArraySpec("<f4", ("pose", "row", "column", "layer"), "W/m2/sr/mm, relative")
]
OfWalls = Annotated[Floats, ArraySpec("<f8", ("wall", "3"))]


class RenderedLight(Model):
    """Paints, LED and camera that the colours of a render rest on; what :mod:`sim.experiments` recolours.

    bands: spectral density of red emission, green emission and LED, unit integral. Rows of the tables are walls,
    columns bands: mean reflectance, and the share of the band's energy that the wall emits in its own band.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"walls": "wall"}

    walls: tuple[str, ...] = ("red", "green")
    bands: tuple[SpectralCurve, SpectralCurve, SpectralCurve]
    reflectance: OfWalls
    conversion: OfWalls
    response: tuple[SpectralCurve, SpectralCurve, SpectralCurve] = Field(
        description="response of the camera: red, green, blue"
    )
    white_balance: tuple[float, float, float] = Field(default=(1.0, 1.0, 1.0), description="gains, in camera_matrix")


class KnownInputs(Model):
    """What a render's colours and shape depend on and how sure that is; from it follow uncertainties of a comparison.

    Layers are the chains of a press, or its bands where chains do not stand apart. Draw d of an input multiplies the
    entry (camera channel, layer) of the matrix from layers to RGB by its factor; factors of different inputs multiply.
    One key is one source of draws: two presses with the same key share its draws, number by number.
    """

    dimension_of: ClassVar[Mapping[str, str]] = dict.fromkeys(("names", "keys", "evaluations", "sources"), "input")

    names: tuple[str, ...] = Field(description="such as 'red paint', 'green paint', 'camera response'")
    keys: tuple[str, ...] = Field(description="for each input, the origin of its draws, for example a checksum")
    evaluations: tuple[Literal["A", "B"], ...]
    sources: tuple[str, ...] = Field(description="where the uncertainty comes from, in plain words")
    factors: Annotated[NDArray[np.float32], ArraySpec("<f4", ("input", "draw", "3", "layer"))]


class PoseResponse(Model):
    """How the contact image changes with the indenter's pose: derivatives of its layers by central differences."""

    dimension_of: ClassVar[Mapping[str, str]] = {"names": "pose", "steps_mm": "pose"}

    names: tuple[Literal["depth_mm", "position_mm"], ...]
    steps_mm: tuple[float, ...] = Field(description="half of the interval over which the difference was taken")
    derivative: PoseLayers
    half_difference: PoseLayers = Field(description="half the difference of the derivatives of both halves")


class SimulatedPress(Record):
    """Contact and no-contact images in the camera's linear RGB, or a simple prediction in encoded values.

    distance is the distance from the contact's centre in units of its half-width (radius), NaN off the pad:
    the contact patch is distance <= 1. Band images and the camera matrix are stored with a render, so that a
    new yield, white balance or camera needs no new render: RGB = camera_matrix @ bands. A render that kept the light
    of each chain of fluorescence apart ("led>green>red": green emission turned into red) holds it in ``*_chains``;
    chains below half a per cent of their band were left out. A recoloured press keeps the chains as they were rendered,
    with ``rendered_light``; all its other images are those of ``shown_light``.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"bands": "band", "chains": "chain"}
    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray simulate render'"

    name: str
    label: str = Field(description="how the images were made, for example 'rendered, level b, llvm_ad_rgb'")
    method: Literal["rendered", "table"]
    encoding: Literal["linear", "unknown"]
    no_contact: Image
    contact: Image
    distance: Distance
    variance: Image | None = Field(description="variance of the contact image from render noise")
    no_contact_bands: Bands | None = None
    contact_bands: Bands | None = None
    contact_bands_variance: Bands | None = None
    bands: tuple[str, ...] = ()
    no_contact_chains: Chains | None = None
    contact_chains: Chains | None = None
    chains: tuple[str, ...] = ()
    no_contact_half_difference: Layers | None = Field(
        default=None, description="half the difference of two independent halves, whose mean is stored in the layers"
    )
    contact_half_difference: Layers | None = None
    layer_matrix: Annotated[Floats, ArraySpec("<f8", ("3", "layer"))] | None = Field(
        default=None, description="matrix from layers (chains, or bands without them) to the RGB of the images"
    )
    known_inputs: KnownInputs | None = None
    pose_response: PoseResponse | None = None
    rendered_light: RenderedLight | None = None
    shown_light: RenderedLight | None = None
    camera_matrix: Annotated[Floats, ArraySpec("<f8", ("3", "band"))] | None = None
    light_angle_deg: AngleDeg | None
    design: FingerDesign | None
    sensor: PlainSensor | None = Field(
        default=None, description="design of a classic sensor, which has no finger's design"
    )
    paints: dict[str, str] = Field(default={}, description="colour -> SHA-256 of the paint calibration")
    notes: tuple[str, ...] = ()

    @property
    def indenter(self) -> Indenter | None:
        """What is pressed in; None where no design tells it, or a height map or mesh stands in its place."""
        if self.design is not None:
            return self.design.indenter
        return None if self.sensor is None or self.sensor.surface is not None else self.sensor.indenter


class AngleObjective(Model):
    """A further objective over the light angle; as many repeats as it was measured with."""

    name: str
    meaning: str
    unit: str
    larger_is_better: bool
    values: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat"))]
    place_values: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat", "place"))] | None = Field(
        default=None,
        description="values at places along the pad, which a decision prefers to brightness; None where there are none",
    )
    places_mm: Annotated[Floats, ArraySpec("<f8", ("place",), "mm")] | None = Field(
        default=None, description="distances of these places from the base"
    )

    @model_validator(mode="after")
    def _positive(self) -> "AngleObjective":
        least = min(float(v.min()) for v in (self.values, self.place_values) if v is not None)
        if not least > 0.0:
            raise ValueError(f"{self.name}: values must be positive, but the smallest is {least:g} {self.unit}")
        if (self.place_values is None) != (self.places_mm is None):
            raise ValueError(
                f"{self.name}: place_values and places_mm must be given together; give both or leave both out"
            )
        return self

    @property
    def utility(self) -> Floats:
        """What is largest at the best angle: the values, or their inverse where smaller is better."""
        return self.values if self.larger_is_better else np.asarray(1.0 / self.values)


class AngleConstraints(Model):
    """What an angle must meet besides being good: no clipped pixels, and room for the panel.

    Where the exposure is chosen anew for each angle so that it clips no more, the first is met by construction, and
    ``exposure_rel`` is its price.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"in_the_way": "angle"}

    clipped_share: Annotated[Floats, ArraySpec("<f8", ("angle",), "1")] = Field(
        description="share of the pixels of the pressed coat with a channel at full scale, at that angle's exposure"
    )
    clipped_limit_share: Fraction
    exposure_rel: Annotated[Floats, ArraySpec("<f8", ("angle",), "1")] = Field(
        description="exposure time, relative to the shortest of the sweep, that brings the coat to its level"
    )
    in_the_way: tuple[str, ...] = Field(
        description="for each angle, the parts that would be in the way of the panel; empty where it fits"
    )

    @property
    def allowed(self) -> NDArray[np.bool_]:
        """Which angles meet all constraints, (angle,)."""
        fits = np.array([not name for name in self.in_the_way], dtype=np.bool_)
        return np.asarray(fits & (self.clipped_share < self.clipped_limit_share))


NARROWEST_SWEEP_DEG = 4.0
_STEPS_OF_A_PAIR = 2


def look_like_radians(angles_deg: Sequence[float] | Floats) -> bool:
    """Return whether angles span less than 4 deg in more than two steps, as a sweep given in radians does."""
    angles = np.asarray(angles_deg, dtype=np.float64)
    return len(angles) > _STEPS_OF_A_PAIR + 1 and float(np.ptp(angles)) < NARROWEST_SWEEP_DEG


def narrow_sweep_text(angles_deg: Sequence[float] | Floats) -> str:
    """Say why a narrow sweep is refused, and how to allow it."""
    first, last = float(np.min(angles_deg)), float(np.max(angles_deg))
    return (
        f"{len(angles_deg)} angles of the light from {first:g} to {last:g} deg span less than {NARROWEST_SWEEP_DEG:g} "
        f"deg, which suggests radians ({np.degrees(first):.0f} to {np.degrees(last):.0f} deg). Give the angles in "
        "degrees, or add --narrow-sweep if they already are"
    )


class LightAngleSweep(Record):
    """A named objective at probe points beside the indenter, over the angle of the blue panel.

    ``values[:, r]`` shares every random draw (paint, noise seed) across angles, so that a common scale cannot
    change the ranking of angles.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"bands": "band", "constraints.clipped_share": "angle"}
    schema_version: ClassVar[int] = 5
    written_by: ClassVar[str] = "'finray simulate sweep'"

    name: str
    objective: str = Field(description="name and meaning of the objective")
    label: str
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    values: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat"))]
    channels: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat", "3"))] | None = Field(
        default=None,
        description="red, green and blue of the objective, whose mean is values; None in sweeps of older versions",
    )
    basis: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat", "probe", "band"))]
    bands: tuple[str, ...]
    probe_points_mm: Annotated[Floats, ArraySpec("<f8", ("probe", "3"), "mm")]
    other_objectives: tuple[AngleObjective, ...] = ()
    constraints: AngleConstraints | None = None
    design: FingerDesign
    paints: dict[str, str]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "LightAngleSweep":
        for objective in self.other_objectives:
            if len(objective.values) != len(self.angles_deg):
                raise ValueError(
                    f"{objective.name} has values for {len(objective.values)} angles, but the sweep has "
                    f"{len(self.angles_deg)} angles; the numbers must be equal"
                )
        return self


PerIncrement = NDArray[np.float64]
Torque = Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "N mm"})]
ContactKind = Literal["penalty", "barrier"]
PartOfEnergy = Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N mm", allow_nan=True)]


class VariedPress(Model):
    """The same press of a design with one number changed, or the first part of it."""

    field: str = Field(description="dotted path of the number in the design; for a list, all its numbers")
    change_rel: Annotated[
        float, Field(gt=-1.0, description="change of the number, relative to its value in the design")
    ]
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")]
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="force along the pad's normal"
    )
    failure: str = Field(default="", description="why there are no forces, or why the push ended early")


class ForceSlope(Model):
    """Derivative of a press's force by one number of its design, at each increment."""

    field: str = Field(description="dotted path of the number in the design; for a list, all its numbers together")
    ln_force_per_ln_number: Annotated[PerIncrement, ArraySpec("<f8", ("increment",))] = Field(
        description="d ln F / d ln x, of the force along the pad's normal"
    )


class PressSensitivities(Model):
    """How the force of a press depends on numbers of the design: by derivatives, or by presses with one changed."""

    preset: Preset
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="depths of the unchanged design, on this mesh"
    )
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="force along the pad's normal, of the unchanged design"
    )
    varied: tuple[VariedPress, ...] = Field(
        description="presses with one number changed: for numbers without a derivative; in older versions for "
        "all numbers"
    )
    slopes: tuple[ForceSlope, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PressSensitivities":
        for slope in self.slopes:
            if len(slope.ln_force_per_ln_number) != len(self.depth_mm):
                raise ValueError(
                    f"{slope.field} has {len(slope.ln_force_per_ln_number)} derivatives, but must have one for each "
                    f"of the {len(self.depth_mm)} increments of the press"
                )
        return self


PerPoint = NDArray[np.float64]


class PressMotion(Model):
    """An indenter on its path: poses, torque, and what the contact does at each point of the coat that it touched.

    The points are the sampling points of the coat's faces that touch at one increment at least. Areas by counting them
    are known to about a row of them along the patch's edge.
    """

    moves_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "mm")] = Field(
        description="moves of the indenter's middle from first touch: across the finger, along the pad's outward "
        "normal, along the finger"
    )
    turns_deg: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "deg")] = Field(
        description="rotation vector from first touch, about the indenter's middle, in the same axes"
    )
    origins_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "mm")] = Field(
        description="where the indenter's middle is, the point that torques are about"
    )
    torque_n_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "N mm")] = Field(
        description="torque on the indenter, about its middle at that increment"
    )
    patch_mm2: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm2")] = Field(
        description="area at rest of the coat that touches"
    )
    stuck_mm2: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm2")] = Field(
        description="part of the patch that has not slipped in the increment"
    )
    friction: Annotated[float, Field(ge=0.0, description="Coulomb's coefficient")]
    points_mm: Annotated[PerPoint, ArraySpec("<f8", ("point", "3"), "mm")] = Field(
        description="positions of the points in the undeformed pad"
    )
    point_areas_mm2: Annotated[PerPoint, ArraySpec("<f8", ("point",), "mm2")]
    pressure_mpa: Annotated[PerPoint, ArraySpec("<f8", ("increment", "point"), "MPa")] = Field(
        description="pressure on the area at rest; 0 where the point does not touch"
    )
    shear_mpa: Annotated[PerPoint, ArraySpec("<f8", ("increment", "point", "3"), "MPa")] = Field(
        description="shear by friction, on the indenter"
    )
    slip_mm: Annotated[PerPoint, ArraySpec("<f8", ("increment", "point"), "mm")] = Field(
        description="slip of the coat over the indenter in the increment; 0 where it sticks or does not touch"
    )


class SurrogateBars(Model):
    """How far the answers of a taught surrogate may be from the finite elements that taught it."""

    level_share: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        description="share of presses whose error the bars should contain"
    )
    presses: Annotated[int, Field(gt=0)] = Field(description="number of training presses")
    limit_rel: Annotated[float, Field(gt=0.0)] = Field(
        description="largest error bar, relative to the force or to the surface's displacement; above it "
        "finite elements compute the press"
    )
    force_bar_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="error bar of the force along the pad's normal"
    )
    surface_bar_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="error bar of the coat: root mean square of the distance of its nodes from their true positions"
    )


class PressMechanics(Record):
    """Force against push of one finger under a rigid indenter; the surfaces stand in a record of their own."""

    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray simulate press'"

    name: str
    label: str = Field(description="engine and mesh, for example 'finite elements, coarse mesh, 38676 unknowns'")
    preset: Preset
    mesh_excess_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None,
        description="relative amount by which this preset's force exceeds that of an infinitely fine mesh, as "
        "extrapolated for the 70 x 35 finger; None in older versions",
    )
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="push of the indenter from first touch"
    )
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "N")] = Field(
        description="force on the indenter: across the finger, along the pad's normal, along the finger"
    )
    energy_n_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N mm", allow_nan=True)] = Field(
        description="energy that is stored: strain, ties and contact; NaN where another program's results do not "
        "hold it. In records without contact_energy_n_mm, presses with barrier contact also include the energy of its "
        "drive and the last friction"
    )
    contact_energy_n_mm: PartOfEnergy | None = Field(
        default=None, description="part of the energy that is stored in the contact"
    )
    friction_work_n_mm: PartOfEnergy | None = Field(
        default=None,
        description="work lost to friction from first touch on: in each increment, the last force times the slip",
    )
    iterations: Annotated[NDArray[np.int64], ArraySpec("<i8", ("increment",))]
    largest_pressure_mpa: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "MPa"})] = Field(
        description="pressure at one point of the coat; where the patch is not several elements wide, it depends "
        "on the mesh"
    )
    unreached: str = Field(description="why the push ended early; empty when it did not")
    wanted_force_n: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "N"})] | None = Field(
        default=None,
        description="force up to which the indenter was pressed (--force), in place of design.indenter.depth_mm; None "
        "for a press to a depth",
    )
    slip_torque_per_friction_n_mm: Torque | None = Field(
        default=None,
        description="torque about the pad's normal at which the object begins to turn at the last increment, divided "
        "by Coulomb's coefficient, from the frictionless pressures there; None with friction, or in older versions",
    )
    tipping_torque_n_mm: Torque | None = Field(
        default=None,
        description="torque about the finger's long axis that the normal forces alone resist at that increment",
    )
    design: FingerDesign
    sensitivities: PressSensitivities | None = Field(
        default=None, description="sensitivities of the force to numbers of the design; none unless they were requested"
    )
    motion: PressMotion | None = Field(
        default=None, description="motion of an indenter on a path, whose pushes need not rise; None for a plain press"
    )
    surrogate: SurrogateBars | None = Field(
        default=None, description="error bars of a press by a surrogate; None where finite elements computed it"
    )
    notes: tuple[str, ...] = ()


class PressIncrement(Record):
    """The state of a finger at one increment of a press, from which the press can continue."""

    schema_version: ClassVar[int] = 8
    written_by: ClassVar[str] = "'finray simulate press'"

    preset: Preset
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="push from first touch, of this and all increments before"
    )
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "N")]
    energy_n_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N mm")]
    contact_energy_n_mm: PartOfEnergy | None = None
    friction_work_n_mm: PartOfEnergy | None = None
    contact: ContactKind | None = Field(default=None, description="None in increments of older versions")
    indenter_sha256: str | None = Field(
        default=None, description="SHA-256 of the STL of the user's mesh; None without one, or in older versions"
    )
    iterations: Annotated[NDArray[np.int64], ArraySpec("<i8", ("increment",))]
    nodes_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("node", "3"), "mm")] = Field(
        description="nodes of the mesh at rest, by which the mesh is recognised"
    )
    displacement_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("node", "3"), "mm")]
    modes_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("hexahedron", "3", "3"), "mm")] = Field(
        description="incompatible modes of the hexahedra that have them, in the order of the mesh's blocks"
    )
    unstable: str = Field(
        default="",
        description="the first push at which the equilibrium may be unstable, in words; empty where the search found "
        "none, or in increments of older versions",
    )
    parts_touch_from_mm: float | None = Field(
        default=None,
        description="push at the first increment where contact between parts of the finger acted in addition to the "
        "penalty contact of the indenter; None where there was none, or in increments of older versions",
    )
    points_per_side: Annotated[int, Field(gt=0)] | None = Field(
        default=None,
        description="points along a side of each face of the coat at which penalty contact acts; None with barrier "
        "contact, or in increments of older versions, where it acted at 2",
    )
    points_on_border: bool | None = Field(
        default=None,
        description="whether some of these points lie on the border of the coat; None with barrier contact, or in "
        "increments of older versions, where none did",
    )
    design: FingerDesign


Counts = Annotated[NDArray[np.int64], ArraySpec("<i8", ("part",))]


class FingerSurfaces(Record):
    """Triangle meshes of a finger's parts, one after the other, in mm in the axes of the undeformed pad.

    Part k owns the next ``vertex_counts[k]`` vertices and ``triangle_counts[k]`` triangles, whose corners are counted
    within the part. Names and texture coordinates are those of :class:`sim.surface_meshes.FingerShape`.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"parts": "part"}
    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate press'"

    name: str
    label: str = Field(description="origin of the shape, for example 'at rest'")
    push_mm: float | None = Field(
        default=None, description="push of the indenter from first touch; none where it is not known"
    )
    parts: tuple[str, ...]
    vertex_counts: Counts
    triangle_counts: Counts
    vertices_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "3"), "mm")]
    rest_vertices_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "3"), "mm")] = Field(
        description="the same vertices without contact"
    )
    uv: Annotated[NDArray[np.float64], ArraySpec("<f8", ("vertex", "2"))]
    triangles: Annotated[NDArray[np.int64], ArraySpec("<i8", ("triangle", "3"))]
    contact_distance: Annotated[
        NDArray[np.float64], ArraySpec("<f8", ("coat vertex",), "contact half-width", allow_nan=True)
    ] = Field(
        description="distance from the contact for each vertex of the coat; the contact is where it is at most 1, "
        "NaN without contact"
    )

    @model_validator(mode="after")
    def _counts_add_up(self) -> "FingerSurfaces":
        for counted, rows in (("vertex", self.vertices_mm), ("triangle", self.triangles)):
            counts: Counts = getattr(self, f"{counted}_counts")
            if (counts < 0).any() or counts.sum() != len(rows):
                raise ValueError(
                    f"{counted}_counts must not be negative and must add up to the {len(rows)} {counted} rows, but "
                    f"add up to {counts.sum()}; the record is corrupted, so compute the press again"
                )
        return self


class ObjectGrasp(Record):
    """Two facing fingers that close on a free rigid object and carry its weight; each finger has records of its own.

    Axes are those of the near finger: across it, along its pad's outward normal, along it. The far finger faces it,
    turned by 180 deg about the third axis.
    """

    written_by: ClassVar[str] = "'finray simulate grasp'"

    name: str
    label: str
    preset: Preset
    design: FingerDesign = Field(description="design of both fingers; its indenter is the object")
    wanted_force_n: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "N"})] = Field(
        description="closing force, as the mean over both fingers"
    )
    mass_kg: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "kg"})] = Field(description="of the object")
    weight_n: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "N"})] = Field(
        description="weight of the object, at standard gravity"
    )
    down: Literal["tip", "side", "near"] = Field(
        description="where the weight pulls: along the fingers to the tip, across them, or into the near finger"
    )
    closing_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="distance that each finger has moved since both touched the object"
    )
    closing_force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="mean of both fingers' forces along the direction of closing"
    )
    carried_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="part of the weight that the fingers carry"
    )
    moves_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "mm")] = Field(
        description="move of the object's middle (a mesh: its origin) since both fingers touched it"
    )
    turns_deg: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "deg")] = Field(
        description="rotation vector of the object about its middle"
    )
    unbalanced_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="size of the unbalanced force on the object"
    )
    stiffness_n_per_mm: Annotated[float, Field(json_schema_extra={"unit": "N/mm"})] = Field(
        description="least resistance to a move or turn of the object at the last increment (a turn counts as a move "
        "at half the pad's width); negative: the slightest push squeezes it out or tips it over; 0: it can move "
        "freely in some direction"
    )
    lost: str = Field(description="why the fingers did not reach the requested force or weight; empty when they did")
    notes: tuple[str, ...] = ()
