"""Camera sessions: the plan of a photon-transfer capture, what it stores, and the camera characterisation made of it.

The quantities are those of EMVA Standard 1288, release 4.0. Quantum efficiency needs a calibrated detector and is
not part of it. The standard gives its gain K in DN/e; here it is e/DN, as in the rig file.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._arrays import ArraySpec, check_dimensions
from data_schemas._capture import Frame, RegionOfInterest
from data_schemas._model import Estimate, Model, Record
from data_schemas._rig import CameraSettings, DeviceIdentity, RigFile
from data_schemas._units import ExposureS, RelativeUncertainty

Floats = NDArray[np.float64]
ChannelName = Literal["red", "green", "blue", "mono"]
FEWEST_LEVELS = 10


class CameraPlan(Record):
    """Plan of a camera session (TOML): flat frames of the white tile from dark to beyond saturation, and darks."""

    kind: Literal["camera"] = "camera"
    camera_name: str = Field(description="names the session's folder and the characterisation")
    filter_name: str | None = Field(
        default=None, description="filter in the beam; left out: none, the wheel must read that it is out of the beam"
    )
    region: RegionOfInterest = Field(description="evenly lit part of the white tile")
    levels: Annotated[int, Field(ge=FEWEST_LEVELS, le=200)] = Field(
        default=12, description="exposures up to saturation of each channel, evenly spaced"
    )
    frames_per_level: Annotated[int, Field(ge=2, le=20)] = 2
    repeats: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=16, description="further flat frames at half saturation and as many dark ones, for PRNU and DSNU"
    )
    longest_exposure_s: ExposureS = Field(
        default=5.0, description="of any frame; the last dark frames use it to resolve the dark current"
    )


class CameraSession(Record):
    """A finished camera session: plan, rig and the list of frames (a folder on disk).

    Frames of type "white" show the tile under the lamp, frames of type "dark" the closed box. Those of one type and
    exposure time form a stack of two or more.
    """

    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray capture'"

    plan: CameraPlan
    rig: RigFile
    frames: tuple[Frame, ...]
    devices: tuple[DeviceIdentity, ...] = Field(default=(), description="what the devices said they are")
    notes: tuple[str, ...] = ()


class Resolvable(Estimate):
    """Estimate of a quantity that cannot be negative.

    When it cannot be told from zero (`resolved` is false), `low95` is 0 and `high95` the upper limit with 95 %
    confidence.
    """

    resolved: bool


class PhotonTransferCurve(Model):
    """Mean and temporal variance of one channel at every exposure, in order of exposure.

    `in_line` marks the levels behind gain and read noise (up to 70 % of saturation), `deviation_rel` is the
    deviation from the linearity line over 5 to 95 % of saturation (NaN outside).
    """

    exposure_s: Annotated[Floats, ArraySpec("<f8", ("level",), "s")]
    mean_dn: Annotated[Floats, ArraySpec("<f8", ("level",), "DN")]
    variance_dn2: Annotated[Floats, ArraySpec("<f8", ("level",), "DN^2")]
    dark_mean_dn: Annotated[Floats, ArraySpec("<f8", ("level",), "DN")]
    dark_variance_dn2: Annotated[Floats, ArraySpec("<f8", ("level",), "DN^2")]
    saturated_fraction: Annotated[Floats, ArraySpec("<f8", ("level",))]
    in_line: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("level",))]
    deviation_rel: Annotated[Floats, ArraySpec("<f8", ("level",), allow_nan=True)]

    @model_validator(mode="after")
    def _lengths_agree(self) -> "PhotonTransferCurve":
        check_dimensions(self)
        return self


class ChannelCharacterisation(Model):
    """What photon transfer says about one Bayer channel (or the whole of a monochrome sensor)."""

    channel: ChannelName
    pixels: Annotated[int, Field(ge=1)]
    gain_e_per_dn: Estimate
    read_noise_e: Resolvable
    read_noise_dn: Resolvable
    black_level_dn: Estimate = Field(description="mean dark count at exposure zero")
    dark_current_e_per_s: Resolvable = Field(description="from the mean of the dark frames")
    saturation_dn: Estimate | None = Field(
        description="mean count where the variance is largest; its 95 % interval reaches to the exposures beside it; "
        "this and the next three are none when no exposure saturates"
    )
    full_well_e: Estimate | None = Field(description="charge at saturation")
    snr_max: Estimate | None = Field(description="square root of the full well")
    dynamic_range: Estimate | None = Field(description="full well over the smallest detectable charge")
    linearity_error_rel: Resolvable = Field(
        description="mean absolute deviation of the signal from a line through exposure, 5 to 95 % of saturation"
    )
    linearity_lowest_rel: float = Field(description="most negative deviation")
    linearity_highest_rel: float = Field(description="most positive deviation")
    dsnu_dn: Resolvable = Field(description="dark signal non-uniformity")
    prnu_rel: Resolvable = Field(
        description="photo response non-uniformity from pixel to pixel: second differences remove uneven light, and "
        "with it whole rows and columns"
    )
    flat_nonuniformity_rel: Resolvable = Field(
        description="PRNU of EMVA 1288 without high-pass: sensor, lens, lamp and tile together"
    )
    chi_square: float = Field(description="of the photon transfer line")
    degrees_of_freedom: int
    chi_square_p: float
    curve: PhotonTransferCurve


class CameraCharacterisation(Record):
    """A camera characterised by photon transfer; :meth:`applied_to` gives the rest of the chain its numbers."""

    schema_version: ClassVar[int] = 3
    written_by: ClassVar[str] = "'finray radiometry'"

    camera_name: str
    camera: CameraSettings = Field(description="as the rig file described it")
    filter_name: str | None
    channels: tuple[ChannelCharacterisation, ...] = Field(min_length=1)
    light_repeatability_rel: RelativeUncertainty = Field(description="of one exposure; includes drift of the lamp")
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def applied_to(self, camera: CameraSettings) -> CameraSettings:
        """Return a copy of `camera` with the measured gain, read noise and black level.

        Each is the mean over the channels with weights 1/sd^2: they share one amplifier and converter.
        """
        measured = {
            name: _weighted_mean([getattr(channel, name) for channel in self.channels])
            for name in ("gain_e_per_dn", "read_noise_e", "black_level_dn")
        }
        return CameraSettings.model_validate({**camera.model_dump(), **measured})


def _weighted_mean(estimates: list[Estimate]) -> float:
    """Return the inverse-variance mean of independent estimates."""
    weights = np.array([1.0 / max(e.sd, np.finfo(np.float64).tiny ** 0.25) ** 2 for e in estimates])
    return float(np.average([e.estimate for e in estimates], weights=weights))
