"""``bands.toml``: what a person must say about a folder of wavelength-named TIFF images before it can be reduced."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from data_schemas.band_pass_filter import FilterUncertaintyNm
from data_schemas.capture import RegionOfInterest
from data_schemas.devices import LaserSettings
from data_schemas.model import Model, Record
from data_schemas.rig import WhiteReference
from data_schemas.units import ChargeE, ExposureS, OpticalDensity, SignalDn, WavelengthNm, WidthNm

Layout = Literal["monochrome", "RGB", "Bayer RGGB", "Bayer BGGR", "Bayer GRBG", "Bayer GBRG"]
Pattern = Annotated[str, Field(min_length=1, description="file name below the folder; {filter} and * are filled in")]
ExposurePerFilter = ExposureS | dict[str, ExposureS]


class ImportedCamera(Model):
    """The camera that took the images; values must be proportional to light above the black level."""

    encoding: Literal["linear"] = Field(description="images that went through a gamma or tone curve cannot be reduced")
    layout: Layout
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
        "monochrome camera; assumed: smooth stand-in curves, flat for a monochrome camera",
    )


class ImportedFilter(Model):
    """One band-pass filter, by its nominal values or by a measured curve (CSV: wavelength_nm,transmission)."""

    name: Annotated[str, Field(min_length=1)]
    center_nm: WavelengthNm | None = None
    fwhm_nm: WidthNm | None = None
    curve: str | None = None
    center_uncertainty_nm: FilterUncertaintyNm | None = Field(
        default=None, description="standard uncertainty; left out: that of a measured curve or of a catalogue's data"
    )
    fwhm_uncertainty_nm: FilterUncertaintyNm | None = None
    blocking_od: OpticalDensity = 4.0
    blocking_uncertainty_od: Annotated[float, Field(ge=0.0, le=3.0, json_schema_extra={"unit": "1"})] = 0.3

    @model_validator(mode="after")
    def _known_by_one_way(self) -> "ImportedFilter":
        nominal = (self.center_nm is not None, self.fwhm_nm is not None)
        if self.curve is None and not all(nominal):
            raise ValueError(f"filter {self.name!r} needs center_nm and fwhm_nm, or curve (a CSV file)")
        if self.curve is not None and any(nominal):
            raise ValueError(f"filter {self.name!r}: curve and center_nm or fwhm_nm contradict each other; give one")
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
                    f"{field} = {getattr(self, field)!r} must hold {{filter}}, the place of the filter's name"
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
    """Description of a folder of band images (TOML)."""

    paint_name: Annotated[str, Field(min_length=1)]
    excitation_filter: str = Field(description="name of the filter that passes the laser line")
    camera: ImportedCamera
    region: RegionOfInterest
    laser: LaserSettings = LaserSettings()
    lamp: str = Field(
        default="planck-2856K", description="or a CSV file (wavelength_nm,power_rel) of its relative spectral power"
    )
    white_reference: WhiteReference = WhiteReference()
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
                f"excitation_filter {self.excitation_filter!r} is none of the filters ({', '.join(names)})"
            )
        for field in ("white", "reflectance", "fluorescence"):
            times = getattr(self.exposure_s, field)
            missing = [n for n in names if isinstance(times, dict) and n not in times]
            if missing:
                raise ValueError(f"exposure_s.{field}: filter {missing[0]!r} is missing; give a time for each filter")
        return self
