"""How stiff fingers are in bending and twist, and whether their order depends on dimensions that are assumed."""

from typing import ClassVar, Literal

from pydantic import Field

from data_schemas.design import FingerDesign
from data_schemas.model import Model, Record

Measure = Literal["bending_n_per_mm", "sideways_n_per_mm", "pad_n_per_mm", "twist_n_mm_per_deg"]


class StiffnessRow(Model):
    """One finger with one dimension changed; values are secants at the study's loads."""

    design: str
    changed: str = Field(description="field of the design that differs from it; empty for the design itself")
    change_rel: float = Field(default=0.0, description="its change over its value in the design")
    bending_n_per_mm: float | None = Field(default=None, description="force at the tip, away from the pad's side")
    sideways_n_per_mm: float | None = Field(default=None, description="force at the tip across the finger")
    pad_n_per_mm: float | None = Field(default=None, description="force under the middle of the pad, along its normal")
    twist_n_mm_per_deg: float | None = Field(default=None, description="turn of the tip end about the long axis")
    slip_torque_per_friction_n_mm: float | None = Field(
        default=None,
        description="torque about the pad's normal at which a gripped cylinder begins to turn, over Coulomb's "
        "coefficient; of designs as they are",
    )
    tipping_torque_n_mm: float | None = Field(
        default=None,
        description="torque about the finger's long axis that the gripping force alone holds; of designs as they are",
    )
    grip_failure: str = Field(default="", description="why there are no torques of a design as it is; empty else")
    failure: str = Field(default="", description="why there are no values: the changed parts do not fit, or stuck")


class StiffnessOrder(Model):
    """Whether two fingers keep their order in one measure."""

    measure: Measure
    stiffer: str
    softer: str
    ratio: float = Field(description="stiffer over softer, as designed")
    smallest_ratio: float = Field(description="with the same dimension changed in both by the same share")
    at: str = Field(description="the change at which the ratio is smallest; empty for none")
    independent_ratio: float = Field(description="softest of the stiffer over stiffest of the softer, of all changes")
    note: str = ""


class FingerStiffness(Record):
    """Stiffnesses of some designs, and of each with its assumed dimensions changed one at a time."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray study finger-stiffness'"

    label: str
    designs: tuple[FingerDesign, ...]
    tip_force_n: float
    pad_force_n: float
    twist_deg: float
    grip_force_n: float | None = Field(
        default=None, description="of a cylinder of 20 mm across the middle of the pad; None in older versions"
    )
    share: float = Field(description="of a dimension, by which it is changed up and down")
    rows: tuple[StiffnessRow, ...]
    orders: tuple[StiffnessOrder, ...]
    notes: tuple[str, ...] = ()
