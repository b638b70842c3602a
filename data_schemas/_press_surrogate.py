"""A finger that answers presses in milliseconds, and the presses that taught it."""

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_schemas._design import FingerDesign
from data_schemas._design_parts import Indenter, Preset
from data_schemas._model import Model, Record
from data_schemas._units import ArraySpec

Floats = NDArray[np.float64]
PerIncrement = NDArray[np.float64]

OfForces = Annotated[NDArray[np.float32], ArraySpec("<f4", ("coat unknown", "coat unknown"), "mm/N")]
Range = tuple[float, float]


class PressFamily(Model):
    """Presses that a surrogate answers: cylinders and balls, frictionless, by size, place, turn and depth."""

    radius_mm: Range
    position_mm: Range = Field(description="along the pad")
    across_mm: Range
    turn_deg: Range = Field(description="turn of a cylinder about the pad's normal")
    depth_mm: Range

    def outside(self, indenter: Indenter) -> str:
        """Return what of an indenter is not in the family, with what is; nothing where all of it is."""
        flat = indenter.shape == "ball" or indenter.rotation_deg[2] == 0.0
        told = {
            f'shape = "{indenter.shape}"; it was trained on "cylinder" and "ball"': indenter.shape
            in ("cylinder", "ball"),
            f"friction = {indenter.friction:g}; it was trained on presses without friction": indenter.friction == 0.0,
            "path; it was trained on presses along the pad's normal": not indenter.path,
            f"rotation_deg = {list(indenter.rotation_deg)} deg; it was trained on cylinders that lie flat": flat,
        }
        sizes = [name for name in type(self).model_fields if name != "turn_deg"]
        numbers = {name: (getattr(indenter, name), getattr(self, name), "mm") for name in sizes}
        turn_deg = 0.0 if indenter.shape == "ball" else indenter.rotation_deg[1]
        for name, (value, (low, high), unit) in (
            numbers | {"rotation_deg[1]": (turn_deg, self.turn_deg, "deg")}
        ).items():
            told[f"{name} = {value:g} {unit}; it was trained on {low:g} to {high:g} {unit}"] = low <= value <= high
        return next((f"indenter.{what}" for what, holds in told.items() if not holds), "")

    def features(self, indenter: Indenter) -> Floats:
        """Return the features of a press, (6,): see :class:`PressSurrogate`."""
        ball = indenter.shape == "ball"
        values = (indenter.position_mm, indenter.across_mm, np.log(indenter.radius_mm), indenter.rotation_deg[1])
        bounds = np.array([self.position_mm, self.across_mm, np.log(self.radius_mm), self.turn_deg])
        place = (2.0 * np.array(values) - bounds.sum(axis=1)) / np.ptp(bounds, axis=1)
        place[3] = 0.0 if ball else place[3]
        return np.array([*place, 2.0 * indenter.depth_mm / self.depth_mm[1] - 1.0, 1.0 if ball else -1.0])

    def evenly(self, unit: Floats) -> Floats:
        """Return the features (q, 6) of presses over the whole family, pushes too, for numbers (q, 6) from 0 to 1."""
        places: Floats = 2.0 * unit - 1.0
        least = 2.0 * self.depth_mm[0] / self.depth_mm[1] - 1.0
        places[:, 4], places[:, 5] = least + (1.0 - least) * unit[:, 4], np.where(unit[:, 5] < 0.5, -1.0, 1.0)
        places[:, 3] *= places[:, 5] < 0.0
        return places


class TaughtKernel(Model):
    """Covariance exp(-d^2 / 2) + linear_rel (1 + x . y) of a Gaussian process, d by the lengths; times a variance."""

    lengths: Annotated[Floats, ArraySpec("<f8", ("feature",))] = Field(
        description="correlation lengths of the kernel, in half widths of the family"
    )
    linear_rel: Annotated[float, Field(ge=0.0)]
    noise_rel: Annotated[float, Field(gt=0.0)] = Field(description="variance that does not depend on the features")
    variance_rel: Annotated[float, Field(ge=0.0)]


class TaughtPress(Record):
    """A press by finite elements that teaches a surrogate, kept so that teaching can continue."""

    written_by: ClassVar[str] = "'finray simulate teach'"

    preset: Preset
    design: FingerDesign
    depth_mm: Annotated[PerIncrement, ArraySpec("<f8", ("increment",), "mm")]
    force_n: Annotated[PerIncrement, ArraySpec("<f8", ("increment", "3"), "N")]
    displacement_mm: Annotated[NDArray[np.float32], ArraySpec("<f4", ("increment", "node", "3"), "mm")]
    sound: Annotated[int, Field(ge=0)] = Field(description="number of increments before parts pass through each other")
    unreached: str = Field(description="why the push ended early; empty when it did not")
    processor_s: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "s"})]


class PressSurrogate(Record):
    """A finger that answers presses of a family in milliseconds: condensed to its coat, the remainder learned.

    Features are the place along and across, the logarithm of the radius, the turn, the depth and the shape (-1 a
    cylinder, 1 a ball), each from -1 to 1 over the family. Samples are increments of the presses that taught it.
    """

    written_by: ClassVar[str] = "'finray simulate teach'"

    name: str
    label: str
    preset: Preset
    design: FingerDesign = Field(description="the finger; its indenter is ignored")
    family: PressFamily
    compliance_mm_per_n: OfForces = Field(
        description="displacements of the coat's nodes by forces on them, for the finger at rest"
    )
    shapes: Annotated[NDArray[np.float32], ArraySpec("<f4", ("shape", "unknown"))] = Field(
        description="orthonormal displacements of all nodes"
    )
    shape_compliance_mm_per_n: Annotated[NDArray[np.float32], ArraySpec("<f4", ("shape", "coat unknown"), "mm/N")]
    shapes_rest_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="share of displacement away from the coat that the shapes do not describe"
    )
    presses: Annotated[int, Field(gt=0)] = Field(description="number of training presses, by finite elements")
    sample_press: Annotated[NDArray[np.int64], ArraySpec("<i8", ("sample",))]
    sample_features: Annotated[Floats, ArraySpec("<f8", ("sample", "feature"))]
    modes: Annotated[NDArray[np.float32], ArraySpec("<f4", ("mode", "unknown"))] = Field(
        description="orthonormal modes of the displacement that the condensation does not describe"
    )
    amplitudes_rel: Annotated[Floats, ArraySpec("<f8", ("sample", "mode"))] = Field(
        description="amplitudes of the modes, relative to the push"
    )
    modes_rest_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="share of the samples that the modes do not describe"
    )
    force_rest_rel: Annotated[Floats, ArraySpec("<f8", ("sample", "3"))] = Field(
        description="force that the condensation does not describe, relative to its force along the normal"
    )
    surface_kernel: TaughtKernel
    force_kernel: TaughtKernel
    level_share: Annotated[float, Field(gt=0.0, lt=1.0)]
    surface_bar_rel: Annotated[float, Field(gt=0.0)] = Field(
        description="ratio of an error bar to the standard deviation of the process plus the floor, found on left-out "
        "presses; each increment is weighted by the part of the family that lies nearest to it"
    )
    surface_floor_rel: Annotated[float, Field(ge=0.0)] = Field(
        description="floor of the standard deviation: a share of its median over left-out presses, chosen so that the "
        "error bars are as narrow as possible over the family"
    )
    force_bar_rel: Annotated[float, Field(gt=0.0)]
    force_floor_rel: Annotated[float, Field(ge=0.0)]
    left_out_surface_rel: Annotated[Floats, ArraySpec("<f8", ("sample",))] = Field(
        description="error of the coat / displacement of the coat, with the sample's press left out of the training"
    )
    left_out_force_rel: Annotated[Floats, ArraySpec("<f8", ("sample",))]
    crossed_features: Annotated[Floats, ArraySpec("<f8", ("crossed", "feature"))] | None = Field(
        default=None,
        description="features of increments whose parts pass through each other or that found no equilibrium, "
        "near which the surrogate is not used; None if there are none",
    )
    processor_s: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "s"})] = Field(
        description="processor time of the training"
    )
