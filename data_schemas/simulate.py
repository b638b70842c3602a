"""What the simulation writes: a rendered press, or a sweep of the light angle."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.curves import SpectralCurve
from data_schemas.design import FingerDesign
from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg, Fraction

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
    """Paints, LED and camera that the colours of a render rest on; what :mod:`sim.experiments.recolour` starts from.

    bands: spectral density of red emission, green emission and LED, unit integral. Rows of the tables are walls,
    columns bands: mean reflectance, and the share of the band's energy that the wall emits in its own band.
    """

    walls: tuple[str, ...] = ("red", "green")
    bands: tuple[SpectralCurve, SpectralCurve, SpectralCurve]
    reflectance: OfWalls
    conversion: OfWalls
    response: tuple[SpectralCurve, SpectralCurve, SpectralCurve] = Field(description="of the camera: red, green, blue")
    white_balance: tuple[float, float, float] = Field(default=(1.0, 1.0, 1.0), description="gains, in camera_matrix")

    @model_validator(mode="after")
    def _tables_agree(self) -> "RenderedLight":
        check_dimensions(self, {"walls": "wall"})
        return self


class KnownInputs(Model):
    """What a render's colours and shape depend on and how sure that is; from it follow uncertainties of a comparison.

    Layers are the chains of a press, or its bands where chains do not stand apart. Draw d of an input multiplies the
    entry (camera channel, layer) of the matrix from layers to RGB by its factor; factors of different inputs multiply.
    One key is one source of draws: two presses with the same key share its draws, number by number.
    """

    names: tuple[str, ...] = Field(description="such as 'red paint', 'green paint', 'camera response'")
    keys: tuple[str, ...] = Field(description="of each input: what its draws rest on, for example a checksum")
    evaluations: tuple[Literal["A", "B"], ...]
    sources: tuple[str, ...] = Field(description="where the uncertainty comes from, in plain words")
    factors: Annotated[NDArray[np.float32], ArraySpec("<f4", ("input", "draw", "3", "layer"))]

    @model_validator(mode="after")
    def _lengths_agree(self) -> "KnownInputs":
        check_dimensions(self, {"names": "input", "keys": "input", "evaluations": "input", "sources": "input"})
        return self


class PoseResponse(Model):
    """How the contact image changes with the indenter's pose: derivatives of its layers by central differences."""

    names: tuple[Literal["depth_mm", "position_mm"], ...]
    steps_mm: tuple[float, ...] = Field(description="the difference was taken over twice this")
    derivative: PoseLayers
    half_difference: PoseLayers = Field(description="half the difference of the derivatives of both halves")

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PoseResponse":
        check_dimensions(self, {"names": "pose", "steps_mm": "pose"})
        return self


class SimulatedPress(Record):
    """Contact and no-contact images in the camera's linear RGB, or a simple prediction in encoded values.

    distance is the distance from the contact's centre in units of its half-width (radius), NaN off the pad:
    the contact patch is distance <= 1. Band images and the camera matrix are stored with a render, so that a
    new yield, white balance or camera needs no new render: RGB = camera_matrix @ bands. A render that kept the light
    of each chain of fluorescence apart ("led>green>red": green emission turned into red) holds it in ``*_chains``;
    chains below half a per cent of their band were left out. A recoloured press keeps the chains as they were rendered,
    with ``rendered_light``; all its other images are those of ``shown_light``.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate'"

    name: str
    label: str = Field(description="how the images came about, for example 'rendered, level b, llvm_ad_rgb'")
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
        default=None, description="half the difference of the two independent halves that the layers are the mean of"
    )
    contact_half_difference: Layers | None = None
    layer_matrix: Annotated[Floats, ArraySpec("<f8", ("3", "layer"))] | None = Field(
        default=None, description="from layers (chains, or bands without them) to the RGB of the images"
    )
    known_inputs: KnownInputs | None = None
    pose_response: PoseResponse | None = None
    rendered_light: RenderedLight | None = None
    shown_light: RenderedLight | None = None
    camera_matrix: Annotated[Floats, ArraySpec("<f8", ("3", "band"))] | None = None
    light_angle_deg: AngleDeg | None
    design: FingerDesign | None
    paints: dict[str, str] = Field(default={}, description="colour -> SHA-256 of the paint calibration")
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _images_agree(self) -> "SimulatedPress":
        check_dimensions(self, {"bands": "band", "chains": "chain"})
        return self


class AngleObjective(Model):
    """A further objective over the light angle; as many repeats as it was measured with."""

    name: str
    meaning: str
    unit: str
    larger_is_better: bool
    values: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat"))]

    @model_validator(mode="after")
    def _positive(self) -> "AngleObjective":
        if not (self.values > 0.0).all():
            raise ValueError(f"{self.name}: values must be positive, the least is {self.values.min():g} {self.unit}")
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

    clipped_share: Annotated[Floats, ArraySpec("<f8", ("angle",), "1")] = Field(
        description="of the pixels of the pressed coat with a channel at full scale, at that angle's exposure"
    )
    clipped_limit_share: Fraction
    exposure_rel: Annotated[Floats, ArraySpec("<f8", ("angle",), "1")] = Field(
        description="exposure time, relative to the shortest of the sweep, that brings the coat to its level"
    )
    in_the_way: tuple[str, ...] = Field(description="per angle, what the panel passes through; empty: it fits")

    @property
    def allowed(self) -> NDArray[np.bool_]:
        """Which angles meet all constraints, (angle,)."""
        fits = np.array([not name for name in self.in_the_way], dtype=np.bool_)
        return np.asarray(fits & (self.clipped_share < self.clipped_limit_share))

    @model_validator(mode="after")
    def _lengths_agree(self) -> "AngleConstraints":
        check_dimensions(self, {"in_the_way": "angle"})
        return self


NARROWEST_SWEEP_DEG = 4.0
_STEPS_OF_A_PAIR = 2


def look_like_radians(angles_deg: Sequence[float] | Floats) -> bool:
    """Return whether angles span less than 4 deg in more than two steps, as a sweep given in radians does."""
    angles = np.asarray(angles_deg, dtype=np.float64)
    return len(angles) > _STEPS_OF_A_PAIR + 1 and float(np.ptp(angles)) < NARROWEST_SWEEP_DEG


def narrow_sweep_text(angles_deg: Sequence[float] | Floats) -> str:
    """Say why a narrow sweep is refused, and how to have it all the same."""
    first, last = float(np.min(angles_deg)), float(np.max(angles_deg))
    return (
        f"{len(angles_deg)} angles of the light from {first:g} to {last:g} deg span less than {NARROWEST_SWEEP_DEG:g} "
        f"deg: in radians that would be {np.degrees(first):.0f} to {np.degrees(last):.0f} deg. Give the angles in "
        "degrees, or --narrow-sweep if they are meant so"
    )


class LightAngleSweep(Record):
    """A named objective at probe points beside the indenter, over the angle of the blue panel.

    ``values[:, r]`` shares every random draw (paint, noise seed) across angles, so that a common scale cannot
    change the ranking of angles.
    """

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray simulate --angles'"

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
        lists = {} if self.constraints is None else {"constraints.clipped_share": "angle"}
        check_dimensions(self, {"bands": "band", **lists})
        for objective in self.other_objectives:
            if len(objective.values) != len(self.angles_deg):
                raise ValueError(
                    f"{objective.name} has {len(objective.values)} angles, the sweep has {len(self.angles_deg)}"
                )
        return self
