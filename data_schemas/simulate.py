"""What the simulation writes: a rendered press, or a sweep of the light angle."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec, check_dimensions
from data_schemas.curves import SpectralCurve
from data_schemas.design import FingerDesign
from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg

Image = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "3"))]
Distance = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column"), "contact half-width", allow_nan=True)]
Bands = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "band"), "W/m2/sr, relative")]
Chains = Annotated[NDArray[np.float32], ArraySpec("<f4", ("row", "column", "chain"), "W/m2/sr, relative")]
Floats = NDArray[np.float64]
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


class SimulatedPress(Record):
    """Contact and no-contact images in the camera's linear RGB, or a simple prediction in encoded values.

    distance is the distance from the contact's centre in units of its half-width (radius), NaN off the pad:
    the contact patch is distance <= 1. Band images and the camera matrix are stored with a render, so that a
    new yield, white balance or camera needs no new render: RGB = camera_matrix @ bands. A render that kept the light
    of each chain of fluorescence apart ("led>green>red": green emission turned into red) holds it in ``*_chains``;
    chains below half a per cent of their band were left out. A recoloured press keeps the chains as they were rendered,
    with ``rendered_light``; all its other images are those of ``shown_light``.
    """

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


class LightAngleSweep(Record):
    """A named objective at probe points beside the indenter, over the angle of the blue panel.

    ``values[:, r]`` shares every random draw (paint, noise seed) across angles, so that a common scale cannot
    change the ranking of angles.
    """

    name: str
    objective: str = Field(description="name and meaning of the objective")
    label: str
    angles_deg: Annotated[Floats, ArraySpec("<f8", ("angle",), "deg")]
    values: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat"))]
    basis: Annotated[Floats, ArraySpec("<f8", ("angle", "repeat", "probe", "band"))]
    bands: tuple[str, ...]
    probe_points_mm: Annotated[Floats, ArraySpec("<f8", ("probe", "3"), "mm")]
    design: FingerDesign
    paints: dict[str, str]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _lengths_agree(self) -> "LightAngleSweep":
        check_dimensions(self, {"bands": "band"})
        return self
