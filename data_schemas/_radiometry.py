"""What radiometry makes of sessions: band signals of a paint, which the fitter reads, and a camera's characterisation.

With the plan of a camera's photon-transfer session, and the description of a folder of another lab's band images. The
characterisation's quantities are those of EMVA Standard 1288, release 4.0. Quantum efficiency needs a calibrated
detector and is not part of it. The standard gives its gain K in DN/e; here it is e/DN, as in the rig file.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._capture import Frame, RegionOfInterest
from data_schemas._curves import SpectralCurve, check_named_curves
from data_schemas._model import Estimate, Model, Record
from data_schemas._rig import (
    BandPassFilter,
    BandUncertainty,
    CameraSettings,
    DeviceIdentity,
    LaserSettings,
    RigFile,
    WhiteReference,
)
from data_schemas._units import (
    AngleDeg,
    ArraySpec,
    ChargeE,
    EnergyJ,
    ExposureS,
    FilterUncertaintyNm,
    OpticalDensity,
    RelativeUncertainty,
    SignalDn,
    WavelengthNm,
    WidthNm,
)

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Flag = Literal["ok", "weak", "saturated"]
ASYMMETRY = 1e-6
"""Of correlations: far above rounding, far below what a fit could feel."""
LEAST_EIGENVALUE = 1e-9
"""Of correlations. What all values share is some per cent of them, and their own noise never a millionth of that."""


class Optics(Model):
    """The known curves of the rig, as used for every band integral."""

    filters: tuple[BandPassFilter, ...]
    excitation_filter: str
    laser: LaserSettings
    lamp: SpectralCurve
    lamp_temperature_k: Annotated[float, Field(gt=0.0)] = Field(
        default=2856.0, description="colour temperature of the lamp, for which its uncertainty is stated"
    )
    lamp_temperature_uncertainty_k: Annotated[float, Field(ge=0.0)] = Field(
        default=50.0,
        description="standard uncertainty of the lamp's temperature; 50 K where an older version did not state it",
    )
    white_reference: WhiteReference
    band_uncertainty: BandUncertainty = Field(
        default=BandUncertainty(),
        description="uncertainties of each band value besides the noise of its frames; the defaults where an older "
        "version did not state them",
    )
    camera_response: tuple[SpectralCurve, SpectralCurve, SpectralCurve]
    filter_curves: dict[str, SpectralCurve] = Field(
        default={}, description="measured transmission of each filter that names a curve, by the filter's name"
    )

    @model_validator(mode="after")
    def _curves_are_those_of_the_filters(self) -> "Optics":
        check_named_curves(self.filters, self.filter_curves)
        return self

    @model_validator(mode="after")
    def _excitation_filter_exists(self) -> "Optics":
        names = [f.name for f in self.filters]
        if self.excitation_filter not in names:
            raise ValueError(
                f"excitation_filter {self.excitation_filter!r} is not one of the filters ({', '.join(names)})"
            )
        return self


class Bleaching(Model):
    """Loss of emission by the laser's light: ``-d ln F / d dose`` from the first laser filter and its repeat."""

    filter_name: str
    loss_per_j: float = Field(description="relative loss per joule of laser light on the sample", allow_inf_nan=False)
    sd_per_j: Annotated[float, Field(ge=0.0)]
    dose_span_j: EnergyJ = Field(description="dose between the first frames and their repeat")
    resolved: bool = Field(
        description="whether the loss exceeds three standard deviations. If so, it was corrected (to the dose of the "
        "first laser frame). Otherwise nothing was corrected and the trend is part of the covariance"
    )


class TiltRatio(Model):
    """Signal of the tilted over the untilted sample through one filter, over the cosine of the tilt.

    1 for a diffuse paint: its irradiance falls with the cosine, its radiance is the same in all directions.
    """

    filter_name: str
    tilt_deg: AngleDeg
    cosine_factor: float
    sd: Annotated[float, Field(ge=0.0)]
    diffuse: bool = Field(description="whether 1 lies within two standard deviations")


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
    The covariances are over the flattened (filter, channel) index, filter-major; :attr:`notes` list what they hold.
    """

    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray radiometry'"

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
    bleaching: Bleaching | None = Field(
        default=None, description="fading of the sample; none when no filter was captured twice"
    )
    tilt_ratios: tuple[TiltRatio, ...] = Field(default=(), description="test of a diffuse paint, if it was captured")
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _sizes_agree(self) -> "BandSignals":
        n = len(self.optics.filters)
        for name in ("fluorescence", "reflectance", "saturated_fraction"):
            if getattr(self, name).shape != (n, 3):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}, but must have shape (filters, channels) = ({n}, 3)"
                )
        for name in ("fluorescence_covariance", "reflectance_covariance"):
            if getattr(self, name).shape != (3 * n, 3 * n):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}, but must have shape ({3 * n}, {3 * n})"
                )
        if len(self.flags) != n:
            raise ValueError(f"flags has {len(self.flags)} rows, but must have one for each of the {n} filters")
        return self

    @model_validator(mode="after")
    def _covariances_are_possible(self) -> "BandSignals":
        kept = np.flatnonzero(self.usable().ravel())
        for name in ("fluorescence_covariance", "reflectance_covariance"):
            _require_covariance(name, getattr(self, name)[np.ix_(kept, kept)])
        return self

    def usable(self) -> NDArray[np.bool_]:
        """Return the (filter, channel) mask of values the fitter may use."""
        return np.array([[flag == "ok" for flag in row] for row in self.flags])

    def at_excitation(self) -> NDArray[np.bool_]:
        """Return the (filter,) mask of the filter at the laser line, which shows reflected laser light."""
        return np.array([band.name == self.optics.excitation_filter for band in self.optics.filters])


def _require_covariance(name: str, covariance: Floats) -> None:
    """Refuse a covariance of usable values that no measurement can have: zero, not finite, or not positive definite."""
    variance = np.diagonal(covariance)
    if not np.isfinite(covariance).all():
        raise ValueError(f"{name} contains NaN or infinite values; give every usable value a finite variance")
    if not (variance > 0).all():
        raise ValueError(
            f"{name} has a variance of {variance.min():g} for a usable value, but it must be above 0, because every "
            "usable value has noise; give the variance (photon and read noise at least), or flag the value as weak"
        )
    sd = np.sqrt(variance)
    correlation = covariance / np.outer(sd, sd)
    if np.abs(correlation - correlation.T).max(initial=0.0) > ASYMMETRY:
        raise ValueError(f"{name} is not symmetric; give C_ij and C_ji the same value")
    least = float(np.linalg.eigvalsh((correlation + correlation.T) / 2).min(initial=1.0))
    if least < LEAST_EIGENVALUE:
        raise ValueError(
            f"{name} is not positive definite over the usable values, so some combination of values would have no "
            f"noise (the least eigenvalue of the correlations is {least:.2g}, but must be at least "
            f"{LEAST_EIGENVALUE:g}); give every value a variance of its own"
        )


class PixelSignals(Record):
    """Fluorescence of every raw pixel behind every filter, in its own Bayer channel.

    fluorescence
        ``(F / W) / V`` as in :class:`BandSignals`, with the laser's level at the pixel: V of the region times the
        profile of the laser spot there. The weights of a region's channel hold for its pixels. NaN where the white
        is too dim, an exposure is lost, or the laser does not reach.
    fluorescence_sd
        What differs from pixel to pixel: photon and read noise, quantisation, dark offset, profile. What the
        pixels share is `common_sd_rel`. The white tile's own texture stays in the map.
    profile
        Laser over lamp irradiance relative to the region's mean, smoothed.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {"optics.filters": "filter"}
    schema_version: ClassVar[int] = 6
    written_by: ClassVar[str] = "'finray radiometry --pixels'"

    paint_name: str
    optics: Optics
    area: RegionOfInterest = Field(description="area of the arrays, in pixels of the raw frame")
    fluorescence: Annotated[Floats32, ArraySpec("<f4", ("filter", "row", "column"), allow_nan=True)]
    fluorescence_sd: Annotated[Floats32, ArraySpec("<f4", ("filter", "row", "column"), allow_nan=True)]
    channel: Annotated[NDArray[np.uint8], ArraySpec("|u1", ("row", "column"))] = Field(
        description="0 red, 1 green, 2 blue"
    )
    usable: Annotated[NDArray[np.bool_], ArraySpec("|b1", ("row", "column"))] = Field(
        description="the laser's profile is known and at least four filters have a value"
    )
    profile: Annotated[Floats32, ArraySpec("<f4", ("row", "column"), allow_nan=True)]
    profile_sd_rel: Annotated[Floats32, ArraySpec("<f4", ("row", "column"), allow_nan=True)]
    common_sd_rel: Annotated[Floats, ArraySpec("<f8", ("filter", "3"), allow_nan=True)] = Field(
        description="standard deviation of the region's value, common to all pixels of a filter and channel"
    )
    channel_weights: Annotated[Floats, ArraySpec("<f8", ("3",))]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _sizes_agree(self) -> "PixelSignals":
        rows, columns = self.channel.shape
        if (self.area.height_px, self.area.width_px) != (rows, columns):
            raise ValueError(
                f"area is {self.area.height_px} x {self.area.width_px} px, but the arrays have {rows} x {columns} px; "
                "the sizes must be equal"
            )
        if self.channel.size and self.channel.max() > 2:
            # compiled functions take it as an index and check none
            raise ValueError(
                f"channel contains {self.channel.max()}, but only 0 (red), 1 (green) and 2 (blue) are supported"
            )
        return self


ChannelName = Literal["red", "green", "blue", "mono"]
FEWEST_LEVELS = 10


class CameraPlan(Record):
    """Plan of a camera session (TOML): flat frames of the white tile from dark to beyond saturation, and darks."""

    kind: Literal["camera"] = "camera"
    camera_name: str = Field(description="name of the camera, for the session's folder and the characterisation")
    filter_name: str | None = Field(
        default=None,
        description=("filter in the beam; if it is left out, the wheel must report that no filter is in the beam"),
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
        default=5.0,
        description="longest exposure of any frame; the last dark frames use it to resolve the dark current",
    )


class CameraSession(Record):
    """A finished camera session: plan, rig and the list of frames (a folder on disk).

    Frames of type "white" show the tile under the lamp, frames of type "dark" the closed box. Those of one type and
    exposure time form a stack of two or more.
    """

    schema_version: ClassVar[int] = 7
    written_by: ClassVar[str] = "'finray capture'"

    plan: CameraPlan
    rig: RigFile
    frames: tuple[Frame, ...]
    devices: tuple[DeviceIdentity, ...] = Field(default=(), description="identity of the devices, as they report it")
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


class ChannelCharacterisation(Model):
    """What photon transfer says about one Bayer channel (or the whole of a monochrome sensor)."""

    channel: ChannelName
    pixels: Annotated[int, Field(ge=1)]
    gain_e_per_dn: Estimate
    read_noise_e: Resolvable
    read_noise_dn: Resolvable
    black_level_dn: Estimate = Field(description="mean dark count at exposure zero")
    dark_current_e_per_s: Resolvable = Field(description="dark current from the mean of the dark frames")
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
    dsnu_rows_dn: Resolvable | None = Field(
        default=None,
        description="the part of DSNU that whole rows of the channel share; none: an older version did not separate it",
    )
    dsnu_columns_dn: Resolvable | None = Field(default=None, description="the part of DSNU that whole columns share")
    dsnu_pixels_dn: Resolvable | None = Field(default=None, description="the part of DSNU of single pixels")
    prnu_rel: Resolvable = Field(
        description="photo response non-uniformity from pixel to pixel: second differences remove uneven light, and "
        "with it whole rows and columns"
    )
    prnu_rows_rel: Resolvable | None = Field(
        default=None, description="PRNU of whole rows, from one row to the next; none: not separated"
    )
    prnu_columns_rel: Resolvable | None = Field(default=None, description="PRNU of whole columns")
    flat_nonuniformity_rel: Resolvable = Field(
        description="PRNU of EMVA 1288 without high-pass: sensor, lens, lamp and tile together"
    )
    chi_square: float = Field(description="chi-square of the photon transfer line")
    degrees_of_freedom: int
    chi_square_p: float
    curve: PhotonTransferCurve


class CameraCharacterisation(Record):
    """A camera characterised by photon transfer; :meth:`applied_to` gives the rest of the chain its numbers."""

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray radiometry'"

    camera_name: str
    camera: CameraSettings = Field(description="settings of the camera in the rig file")
    filter_name: str | None
    channels: tuple[ChannelCharacterisation, ...] = Field(min_length=1)
    light_repeatability_rel: RelativeUncertainty = Field(
        description="relative scatter of one exposure; includes drift of the lamp"
    )
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


ImageLayout = Literal["monochrome", "RGB", "Bayer RGGB", "Bayer BGGR", "Bayer GRBG", "Bayer GBRG"]
Pattern = Annotated[str, Field(min_length=1, description="file name below the folder; {filter} and * are filled in")]
ExposurePerFilter = ExposureS | dict[str, ExposureS]


class ImportedCamera(Model):
    """The camera that took the images; values must be proportional to light above the black level."""

    encoding: Literal["linear"] = Field(description="images that went through a gamma or tone curve cannot be reduced")
    layout: ImageLayout
    bit_depth: Literal[8, 10, 12, 14, 16]
    left_aligned_bits: Annotated[int, Field(ge=0, le=8)] = Field(
        default=0, description="bits by which the values are shifted up in the file (12 bit stored as 16: 4)"
    )
    black_level_dn: SignalDn = Field(default=0.0, description="used where no dark frames are given")
    black_level_uncertainty_dn: SignalDn = 0.5
    gain_e_per_dn: Annotated[float, Field(gt=0.0, le=1e4, json_schema_extra={"unit": "e/DN"})]
    read_noise_e: ChargeE
    response: str = Field(
        default="assumed",
        description="CSV: wavelength_nm,red_percent,green_percent,blue_percent, or wavelength_nm,response_percent of a "
        "monochrome camera; assumed: smooth stand-in curves, flat for a monochrome camera; light beyond 780 nm is not "
        "counted, so that the camera needs an infrared cut filter",
    )

    @model_validator(mode="after")
    def _values_fit_the_file(self) -> "ImportedCamera":
        if self.bit_depth + self.left_aligned_bits > 16:
            raise ValueError(
                f"bit_depth = {self.bit_depth} and left_aligned_bits = {self.left_aligned_bits} together exceed the 16 "
                "bits of an image file; give the bits of a raw count as bit_depth (12 for 12 bit stored as 16)"
            )
        if self.black_level_dn >= 2**self.bit_depth - 1:
            raise ValueError(
                f"black_level_dn = {self.black_level_dn:g} is not below full scale, which is {2**self.bit_depth - 1} "
                f"DN at bit_depth = {self.bit_depth}; give the raw counts without light"
            )
        return self


class ImportedFilter(Model):
    """One band-pass filter, by its nominal values or by a measured curve (CSV: wavelength_nm,transmission)."""

    name: Annotated[str, Field(min_length=1)]
    center_nm: WavelengthNm | None = None
    fwhm_nm: WidthNm | None = None
    curve: str | None = None
    center_uncertainty_nm: FilterUncertaintyNm | None = Field(
        default=None,
        description=("standard uncertainty; if it is left out, that of a measured curve or of a catalogue's data"),
    )
    fwhm_uncertainty_nm: FilterUncertaintyNm | None = None
    blocking_od: OpticalDensity = 4.0
    blocking_uncertainty_od: Annotated[float, Field(ge=0.0, le=3.0, json_schema_extra={"unit": "1"})] = 0.3

    @model_validator(mode="after")
    def _known_by_one_way(self) -> "ImportedFilter":
        nominal = (self.center_nm is not None, self.fwhm_nm is not None)
        if self.curve is None and not all(nominal):
            raise ValueError(
                f"filter {self.name!r} has neither a curve nor both center_nm and fwhm_nm; give curve (a "
                "CSV file), or the two numbers"
            )
        if self.curve is not None and any(nominal):
            raise ValueError(
                f"filter {self.name!r} has a curve as well as center_nm or fwhm_nm, which could contradict it; give "
                "either the curve or the two numbers"
            )
        return self


class ImageFiles(Model):
    """Where the images are: file names below the folder, with {filter} for a filter's name and * for anything."""

    white: Pattern = Field(description="white reference under the lamp, through each filter")
    reflectance: Pattern = Field(description="paint under the lamp, through each filter")
    fluorescence: Pattern = Field(description="paint under the laser, through each filter")
    laser_white: Pattern = Field(description="white reference under the laser, through the excitation filter")

    @model_validator(mode="after")
    def _filter_is_named(self) -> "ImageFiles":
        for field in ("white", "reflectance", "fluorescence"):
            if "{filter}" not in getattr(self, field):
                raise ValueError(
                    f"{field} = {getattr(self, field)!r} must contain {{filter}}, which stands for the filter's name"
                )
        return self


class Exposures(Model):
    """Exposure times (s): one number, or one per filter by its name; `files` says single files, and wins."""

    white: ExposurePerFilter
    reflectance: ExposurePerFilter
    fluorescence: ExposurePerFilter
    laser_white: ExposureS
    files: dict[str, ExposureS] = Field(default_factory=dict)


class DarkFrames(Model):
    """Dark frames of one exposure time."""

    exposure_s: ExposureS
    files: Pattern


class BandFolder(Record):
    """Description of a folder of another lab's band images (bands.toml)."""

    schema_version: ClassVar[int] = 2
    paint_name: Annotated[str, Field(min_length=1)]
    excitation_filter: str = Field(description="name of the filter that passes the laser line")
    camera: ImportedCamera
    region: RegionOfInterest
    laser: LaserSettings = LaserSettings()
    lamp: str = Field(
        default="planck-2856K", description="or a CSV file (wavelength_nm,power_rel) of its relative spectral power"
    )
    white_reference: WhiteReference = WhiteReference()
    band_uncertainty: BandUncertainty = BandUncertainty()
    filters: Annotated[tuple[ImportedFilter, ...], Field(min_length=1)]
    files: ImageFiles
    exposure_s: Exposures
    darks: tuple[DarkFrames, ...] = ()

    @model_validator(mode="after")
    def _filters_agree(self) -> "BandFolder":
        names = [f.name for f in self.filters]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"filters: {twice[0]!r} is listed twice; list each filter once")
        if self.excitation_filter not in names:
            raise ValueError(
                f"excitation_filter {self.excitation_filter!r} is not one of the filters ({', '.join(names)})"
            )
        for field in ("white", "reflectance", "fluorescence"):
            times = getattr(self.exposure_s, field)
            missing = [n for n in names if isinstance(times, dict) and n not in times]
            if missing:
                raise ValueError(
                    f"exposure_s.{field}: the time for filter {missing[0]!r} is missing; give a time for each filter"
                )
        return self
