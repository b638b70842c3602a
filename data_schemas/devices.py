"""The devices of a rig: what its file says of camera, filter wheel, laser and lamp, and what they say they are."""

from datetime import date, datetime
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.model import Model
from data_schemas.units import ChargeE, ExposureS, PowerMw, SignalDn, WavelengthNm, WidthNm

CameraDriver = Literal["simulated", "aravis", "gentl", "mjpeg", "picamera2", "indi", "micro-manager", "folder"]
WheelDriver = Literal["simulated", "thorlabs", "indi", "alpaca", "manual"]
LaserDriver = Literal["simulated", "arduino", "indi", "alpaca"]
LampDriver = Literal["simulated", "arduino", "indi", "alpaca", "manual"]
NO_ADDRESS = ("simulated", "manual")
"""Drivers without a device of their own."""

BayerPattern = Literal["RGGB"]


def _require_address(driver: str, address: str) -> None:
    """Refuse a driver without an address, and an address that nothing would use."""
    if driver in NO_ADDRESS and address:
        raise ValueError(f"address: driver '{driver}' has none; leave it out")
    if driver not in NO_ADDRESS and not address:
        raise ValueError(f"address: driver '{driver}' needs one, such as 'finray rig detect' prints")


class CameraSettings(Model):
    """Bayer camera of the rig."""

    driver: CameraDriver = "simulated"
    address: str = Field(
        default="",
        description="aravis: camera name, serial number or IP address; gentl: path of the producer (.cti) and "
        "'#serial'; mjpeg: http://host:port/path; picamera2: number of the camera; indi: host:port/device; "
        "micro-manager: configuration file (.cfg); folder: folder of images",
    )
    model: str = "CM3-U3-13Y3C-CS"
    width_px: Annotated[int, Field(ge=64, le=8192, multiple_of=2)] = 1280
    height_px: Annotated[int, Field(ge=64, le=8192, multiple_of=2)] = 1024
    bit_depth: Literal[8, 10, 12, 14, 16] = 10
    bayer_pattern: BayerPattern = "RGGB"
    black_level_dn: SignalDn = 16.0
    gain_e_per_dn: Annotated[float, Field(gt=0.0, le=1e4, json_schema_extra={"unit": "e/DN"})] = 6.5
    gain_db: Annotated[float, Field(ge=0.0, le=60.0, json_schema_extra={"unit": "dB"})] = Field(
        default=0.0, description="amplification that the driver sets and reads back, where the camera has one"
    )
    read_noise_e: ChargeE = 9.0
    shortest_exposure_s: ExposureS = 1e-4
    longest_exposure_s: ExposureS = 30.0
    response: str = Field(
        default="assumed",
        description="'assumed' (smooth stand-in curves) or a CSV file with the header "
        "wavelength_nm,red_percent,green_percent,blue_percent",
    )

    @model_validator(mode="after")
    def _is_reachable(self) -> "CameraSettings":
        _require_address(self.driver, self.address)
        return self

    @model_validator(mode="after")
    def _exposures_in_order(self) -> "CameraSettings":
        if self.longest_exposure_s <= self.shortest_exposure_s:
            raise ValueError(
                f"longest_exposure_s = {self.longest_exposure_s:g} s must exceed shortest_exposure_s = "
                f"{self.shortest_exposure_s:g} s"
            )
        return self


class FilterWheelSettings(Model):
    """Filter wheel and what is in its slots."""

    driver: WheelDriver = "simulated"
    address: str = Field(
        default="",
        description="thorlabs: serial port (/dev/ttyUSB0) or pyserial URL; indi: host:port/device; "
        "alpaca: http://host:port/number",
    )
    model: str = "8-position wheel"
    filters: tuple[BandPassFilter, ...]

    @model_validator(mode="after")
    def _is_reachable(self) -> "FilterWheelSettings":
        _require_address(self.driver, self.address)
        return self

    @model_validator(mode="after")
    def _no_duplicates(self) -> "FilterWheelSettings":
        columns: dict[str, list[str]] = {
            "name": [f.name for f in self.filters],
            "slot": [str(f.slot) for f in self.filters],
            "center_nm": [f"{f.center_nm:g}" for f in self.filters],
        }
        for what, values in columns.items():
            twice = sorted({v for v in values if values.count(v) > 1})
            if twice:
                raise ValueError(f"{what} {twice[0]} stands in two filters; list each filter once, with its own {what}")
        if not self.filters:
            raise ValueError("lists no filter; give at least one [[filter_wheel.filters]] table")
        return self


LIGHT_ADDRESS = (
    "arduino: serial port (/dev/ttyACM0) or pyserial URL; indi: host:port/device; alpaca: http://host:port/switch/0/1 "
    "(device and switch number) or http://host:port/covercalibrator/0"
)


def _day_text(value: object) -> object:
    """Return a day of a TOML file as text; text must be a day."""
    if isinstance(value, date) and not isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, str):
        date.fromisoformat(value)
    return value


IsoDay = Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$"), BeforeValidator(_day_text)]


class OutsideLayer(Model):
    """Hardware outside the computer that switches a laser off, and when it was last seen to do so."""

    kind: Literal["interlock", "relay with pulse", "dead-man"] = Field(
        description="interlock: opening the box cuts the supply; relay with pulse: it opens unless it is pulsed; "
        "dead-man: the controller itself switches off when it hears nothing"
    )
    tested_on: IsoDay = Field(description="day of the last test, with the laser on")
    test: Annotated[str, Field(min_length=10, max_length=200)] = Field(description="what was done and what was seen")


class LaserSettings(Model):
    """Excitation laser. The class and power are named so that nobody switches it on unknowingly."""

    driver: LaserDriver = "simulated"
    address: str = Field(default="", description=LIGHT_ADDRESS)
    wavelength_nm: WavelengthNm = 450.0
    fwhm_nm: WidthNm = 2.0
    power_mw: PowerMw = 4.5
    laser_class: Literal["1", "1M", "2", "2M", "3R", "3B", "4"] = Field(
        default="3R", description="hazard class as on its label (IEC 60825-1); never inferred from the power"
    )
    outside_layer: OutsideLayer | None = Field(
        default=None,
        description="what switches it off outside the computer; class 3R and above go on only with one, which the "
        "driver 'arduino' brings in its firmware",
    )

    @model_validator(mode="after")
    def _real_laser_is_named(self) -> "LaserSettings":
        _require_address(self.driver, self.address)
        missing = {"wavelength_nm", "power_mw", "laser_class"} - self.model_fields_set
        if self.driver != "simulated" and missing:
            raise ValueError(
                f"a real laser is switched on only when the rig file states its {', '.join(sorted(missing))}; read "
                "them from its label"
            )
        return self


class LampSettings(Model):
    """White lamp of known relative spectrum."""

    driver: LampDriver = "simulated"
    address: str = Field(default="", description=LIGHT_ADDRESS)
    spectrum: Literal["planck-2856K"] = Field(
        default="planck-2856K",
        description="relative spectral irradiance on the sample (tungsten halogen lamp)",
    )

    @model_validator(mode="after")
    def _is_reachable(self) -> "LampSettings":
        _require_address(self.driver, self.address)
        return self


class DeviceIdentity(Model):
    """What a device says it is; empty where it does not say."""

    role: Literal["camera", "filter wheel", "laser", "lamp"]
    driver: str
    address: str = ""
    vendor: str = ""
    model: str = ""
    serial: str = ""
    firmware: str = ""
