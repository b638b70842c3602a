"""What pressing a finger takes: push, force and energy, increment by increment."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.design import FingerDesign
from data_schemas.mechanical_design import Preset
from data_schemas.model import Model, Record

PerIncrement = NDArray[np.float64]
Torque = Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "N mm"})]
ContactKind = Literal["penalty", "barrier"]
PartOfEnergy = Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N mm", allow_nan=True)]


class VariedPress(Model):
    """The same press of a design with one number changed, or the first part of it."""

    field: str = Field(description="dotted path of the number in the design; of a list, all its numbers")
    change_rel: Annotated[float, Field(gt=-1.0, description="its change over its value in the design")]
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")]
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="along the pad's normal"
    )
    failure: str = Field(default="", description="why there are no forces, or why the push ended early")

    @model_validator(mode="after")
    def _lengths_agree(self) -> "VariedPress":
        check_dimensions(self)
        return self


class PressSensitivities(Model):
    """How the force of a press answers to numbers of the design, changed one at a time."""

    preset: Preset
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="of the design as it is, on this mesh"
    )
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N")] = Field(
        description="along the pad's normal, of the design as it is"
    )
    varied: tuple[VariedPress, ...]

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PressSensitivities":
        check_dimensions(self)
        return self


class PressMechanics(Record):
    """Force against push of one finger under a rigid indenter; the surfaces stand in a record of their own."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate'"

    name: str
    label: str = Field(description="engine and mesh, for example 'finite elements, coarse mesh, 38676 unknowns'")
    preset: Preset
    mesh_excess_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None,
        description="by how much this preset's force exceeds that of an infinitely fine mesh, as extrapolated for the "
        "70 x 35 finger; None in older versions",
    )
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")] = Field(
        description="push of the indenter from first touch"
    )
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "N")] = Field(
        description="force on the indenter: across the finger, along the pad's normal, along the finger"
    )
    energy_n_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "N mm", allow_nan=True)] = Field(
        description="energy that is stored: strain, ties and contact; NaN where another program's results do not tell "
        "it. Records without contact_energy_n_mm hold with the barrier also that of its drive and the last friction"
    )
    contact_energy_n_mm: PartOfEnergy | None = Field(default=None, description="of the energy, that of the contact")
    friction_work_n_mm: PartOfEnergy | None = Field(
        default=None, description="work lost to friction from first touch on; each increment's last force on its slip"
    )
    iterations: Annotated[NDArray[np.int64], ArraySpec("<i8", ("increment",))]
    largest_pressure_mpa: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "MPa"})] = Field(
        description="at one point of the coat; a value of the mesh where the patch is not several elements wide"
    )
    unreached: str = Field(description="why the push ended early; empty when it did not")
    wanted_force_n: Annotated[float, Field(gt=0.0, json_schema_extra={"unit": "N"})] | None = Field(
        default=None, description="of a press to a force, in place of design.indenter.depth_mm; None of one to a depth"
    )
    slip_torque_per_friction_n_mm: Torque | None = Field(
        default=None,
        description="torque about the pad's normal at which the object begins to turn at the last increment, over "
        "Coulomb's coefficient, by the frictionless pressures there; None with friction, or in older versions",
    )
    tipping_torque_n_mm: Torque | None = Field(
        default=None, description="torque about the finger's long axis that the normal forces alone hold then"
    )
    design: FingerDesign
    sensitivities: PressSensitivities | None = Field(
        default=None, description="presses of the design with one number changed; none unless asked for"
    )
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PressMechanics":
        check_dimensions(self)
        return self


class PressIncrement(Record):
    """The state of a finger at one increment of a press, from which the press can go on."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate --only mechanics'"

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
        default=None, description="of the STL of a mesh of the user; None without one, or in older versions"
    )
    iterations: Annotated[NDArray[np.int64], ArraySpec("<i8", ("increment",))]
    nodes_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("node", "3"), "mm")] = Field(
        description="of the mesh at rest, by which it is known again"
    )
    displacement_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("node", "3"), "mm")]
    modes_mm: Annotated[NDArray[np.float64], ArraySpec("<f8", ("hexahedron", "3", "3"), "mm")] = Field(
        description="incompatible modes of the hexahedra that have them, in the order of the mesh's blocks"
    )
    design: FingerDesign

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PressIncrement":
        check_dimensions(self)
        return self
