"""Band signals: what radiometry makes of a paint session, and what the fitter reads."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas.arrays import ArraySpec
from data_schemas.curves import SpectralCurve
from data_schemas.model import Model, Record
from data_schemas.rig import BandPassFilter, LaserSettings, WhiteReference

Floats = NDArray[np.float64]
Flag = Literal["ok", "weak", "saturated"]


class Optics(Model):
    """The known curves of the rig, as used for every band integral."""

    filters: tuple[BandPassFilter, ...]
    excitation_filter: str
    laser: LaserSettings
    lamp: SpectralCurve
    white_reference: WhiteReference
    camera_response: tuple[SpectralCurve, SpectralCurve, SpectralCurve]

    @model_validator(mode="after")
    def _excitation_filter_exists(self) -> "Optics":
        names = [f.name for f in self.filters]
        if self.excitation_filter not in names:
            raise ValueError(
                f"excitation_filter {self.excitation_filter!r} is none of the filters ({', '.join(names)})"
            )
        return self


class BandSignals(Record):
    """One value per filter x Bayer channel (red, green, blue) over the painted region, with full covariance.

    fluorescence
        ``(F / W) / V``: sample under the laser over white under the lamp, both through the same filter and
        channel, relative to the laser irradiance ``V = sum_c w_c (white under the laser / white under the
        lamp)`` through the excitation filter. A plain ratio to white under the laser would divide by nothing
        at 500-660 nm.
    reflectance
        Sample over white, both under the lamp, times the white reference's reflectance: the total radiance
        factor under that lamp; it includes fluorescence that the lamp excites.
    The covariances are over the flattened (filter, channel) index, filter-major.
    """

    paint_name: str
    optics: Optics
    fluorescence: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    fluorescence_covariance: Annotated[Floats, ArraySpec("<f8", ("signal", "signal"))]
    reflectance: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    reflectance_covariance: Annotated[Floats, ArraySpec("<f8", ("signal", "signal"))]
    channel_weights: Annotated[Floats, ArraySpec("<f8", ("3",))]
    flags: tuple[tuple[Flag, Flag, Flag], ...]
    saturated_fraction: Annotated[Floats, ArraySpec("<f8", ("filter", "3"))]
    region_pixels: Annotated[int, Field(ge=1)]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _sizes_agree(self) -> "BandSignals":
        n = len(self.optics.filters)
        for name in ("fluorescence", "reflectance", "saturated_fraction"):
            if getattr(self, name).shape != (n, 3):
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, wanted filters x channels = ({n}, 3)")
        for name in ("fluorescence_covariance", "reflectance_covariance"):
            if getattr(self, name).shape != (3 * n, 3 * n):
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, wanted ({3 * n}, {3 * n})")
        if len(self.flags) != n:
            raise ValueError(f"flags has {len(self.flags)} rows for {n} filters")
        return self

    def usable(self) -> NDArray[np.bool_]:
        """Return the (filter, channel) mask of values the fitter may use."""
        return np.array([[flag == "ok" for flag in row] for row in self.flags])
