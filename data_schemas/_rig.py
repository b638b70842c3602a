"""The calibration rig as its owner describes it (TOML): camera, filter wheel, filters, lights, white reference.

Every device names its ``driver`` and, unless it is simulated, the ``address`` at which it is found.
``driver = "simulated"`` opens the simulated bench; the ``[simulated]`` table then says what is painted on it. What a
device says that it is, is its :class:`DeviceIdentity`.
"""

import difflib
import math
import re
from collections.abc import Callable, Mapping
from datetime import date, datetime
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from data_schemas._model import Model, Record
from data_schemas._plug_ins import require_address
from data_schemas._units import (
    ChargeE,
    ExposureS,
    FilterUncertaintyNm,
    Fraction,
    OpticalDensity,
    PositionMm,
    PowerMw,
    RelativeUncertainty,
    Seed,
    SignalDn,
    TypeBUncertainty,
    WavelengthNm,
    WidthNm,
)

# A band-pass of a catalogue: centre within 1.5 nm and width within 1 nm of nominal, evenly likely: 1.5 / sqrt(3) and
# 1 / sqrt(3), rounded up. A spectrophotometer's wavelength scale is good to 0.15 nm, and so is a certificate.
CATALOGUE_CENTER_NM, CATALOGUE_FWHM_NM, MEASURED_CURVE_NM = 0.9, 0.6, 0.15


def _where_none_is_given(catalogue_nm: float) -> Callable[[dict[str, Any]], float]:
    """Return the standard uncertainty (nm) of a filter's centre or width for a measured curve or a catalogue's data."""
    return lambda given: catalogue_nm if given.get("curve") is None else MEASURED_CURVE_NM


def _uncertainty_text(catalogue_nm: float) -> str:
    """Say which standard uncertainty holds where none is given."""
    return (
        f"standard uncertainty from a certificate; if left out: {catalogue_nm:g} nm with a catalogue's data only, "
        f"{MEASURED_CURVE_NM:g} nm with a measured curve"
    )


class BandPassFilter(Model):
    """One filter of the wheel; slots count from 1.

    Nominal transmission: ``peak 2^(-|2 (l - center) / fwhm|^(2 shape_order)) + 10^-OD``. A measured curve takes its
    place; centre and width are then labels, and shape and peak are not used.
    The fitter carries the standard uncertainties; those of centre and width shift and stretch a measured curve.
    """

    slot: Annotated[int, Field(ge=1, le=64)]
    name: str
    curve: str | None = Field(
        default=None,
        description="CSV file of the measured transmission (0 to 1) with the header wavelength_nm,transmission, over "
        "the range in which it is above the instrument's noise; its centre must lie within 5 nm of center_nm",
    )
    center_nm: WavelengthNm
    center_uncertainty_nm: FilterUncertaintyNm = Field(
        default_factory=_where_none_is_given(CATALOGUE_CENTER_NM), description=_uncertainty_text(CATALOGUE_CENTER_NM)
    )
    fwhm_nm: WidthNm = 10.0
    fwhm_uncertainty_nm: FilterUncertaintyNm = Field(
        default_factory=_where_none_is_given(CATALOGUE_FWHM_NM), description=_uncertainty_text(CATALOGUE_FWHM_NM)
    )
    shape_order: Annotated[float, Field(ge=1.0, le=10.0, description="1 Gaussian, 2 hard-coated flat top")] = 2.0
    peak_transmission: Annotated[float, Field(gt=0.0, le=1.0)] = 0.6
    blocking_od: OpticalDensity = Field(
        default=5.0,
        description="optical density of the lowest transmission; used alone outside the range of a measured curve",
    )
    blocking_uncertainty_od: Annotated[float, Field(ge=0.0, le=3.0, json_schema_extra={"unit": "1"})] = 0.2


def _driver_name(name: str) -> str:
    """Refuse what is no name of a driver."""
    if not re.fullmatch(DRIVER_NAME, name):
        raise ValueError(
            "must be the name of a driver, such as 'thorlabs' (at most 40 lower-case letters, digits and hyphens); a "
            "rig file cannot name a module, because it must not decide which code runs. Install the package that "
            "provides the driver"
        )
    return name


DRIVER_NAME = "[a-z0-9][a-z0-9-]{0,39}"
DriverName = Annotated[
    str,
    AfterValidator(_driver_name),
    Field(
        json_schema_extra={"pattern": f"^{DRIVER_NAME}$"},
        description="name of a driver of finray-calib, or of another installed package ('finray doctor' lists the "
        "latter)",
    ),
]
BayerPattern = Literal["RGGB"]


class CameraSettings(Model):
    """Bayer camera of the rig."""

    driver: DriverName = "simulated"
    address: str = Field(
        default="",
        description="aravis: camera name, serial number or IP address; gentl: path of the producer (.cti) and "
        "'#serial'; mjpeg: http://host:port/path; picamera2: number of the camera; indi: host:port/device; "
        "micro-manager: configuration file (.cfg); folder: folder of images; others: as their package says",
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
        "wavelength_nm,red_percent,green_percent,blue_percent; light beyond 780 nm is not counted, so that the camera "
        "needs an infrared cut filter",
    )

    @model_validator(mode="after")
    def _is_reachable(self) -> "CameraSettings":
        require_address(self.driver, self.address)
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

    driver: DriverName = "simulated"
    address: str = Field(
        default="",
        description="thorlabs: serial port (/dev/ttyUSB0) or pyserial URL; indi: host:port/device; "
        "alpaca: http://host:port/number",
    )
    model: str = "8-position wheel"
    filters: tuple[BandPassFilter, ...]

    @model_validator(mode="after")
    def _is_reachable(self) -> "FilterWheelSettings":
        require_address(self.driver, self.address)
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
                raise ValueError(f"{what} {twice[0]} is used by two filters; give each filter a different {what}")
        if not self.filters:
            raise ValueError("has no filters; add at least one [[filter_wheel.filters]] table")
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
        try:
            date.fromisoformat(value)
        except ValueError:
            raise ValueError("must be a date such as 2026-03-02, without quotes") from None
    return value


IsoDay = Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$"), BeforeValidator(_day_text)]


class OutsideLayer(Model):
    """Hardware outside the computer that switches a laser off, and when it was last seen to do so."""

    kind: Literal["interlock", "relay with pulse", "dead-man"] = Field(
        description="interlock: opening the box cuts the supply; relay with pulse: it opens unless it is pulsed; "
        "dead-man: the controller itself switches off when it receives no message"
    )
    tested_on: IsoDay = Field(description="day of the last test, with the laser on")
    test: Annotated[str, Field(min_length=10, max_length=200)] = Field(
        description="what was done in the test and what was seen"
    )


class LaserSettings(Model):
    """Excitation laser. The class and power are named so that nobody switches it on unknowingly."""

    driver: DriverName = "simulated"
    address: str = Field(default="", description=LIGHT_ADDRESS)
    wavelength_nm: WavelengthNm = 450.0
    fwhm_nm: WidthNm = 2.0
    power_mw: PowerMw = 4.5
    laser_class: Literal["1", "1M", "2", "2M", "3R", "3B", "4"] = Field(
        default="3R", description="hazard class as on its label (IEC 60825-1); never inferred from the power"
    )
    outside_layer: OutsideLayer | None = Field(
        default=None,
        description="what switches the laser off outside the computer; lasers of class 3R and above are switched "
        "on only with one, and the firmware behind the driver 'arduino' is one",
    )

    @model_validator(mode="after")
    def _real_laser_is_named(self) -> "LaserSettings":
        require_address(self.driver, self.address)
        if self.driver == "manual":
            raise ValueError(
                "driver: a laser cannot be switched by hand, because nothing would switch it off when the capture "
                "stops; give the driver of a controller, such as 'arduino'"
            )
        missing = {"wavelength_nm", "power_mw", "laser_class"} - self.model_fields_set
        if self.driver != "simulated" and missing:
            raise ValueError(
                f"{', '.join(sorted(missing))} must be given for a real laser, which is not switched on otherwise; "
                "read the missing values from the label of the laser"
            )
        return self


PLANCK = r"planck-(\d{4})K"
PLANCK_OR_CSV = r"(planck-\d{4}K|.+\.csv)"
USUAL_TEMPERATURE_K = 2856.0


class LampSettings(Model):
    """White lamp: its relative spectrum and how well that is known."""

    driver: DriverName = "simulated"
    address: str = Field(default="", description=LIGHT_ADDRESS)
    spectrum: str = Field(
        default="planck-2856K",
        description="relative spectral irradiance on the sample: planck-2856K, or another temperature of a tungsten "
        "lamp, or a CSV file (wavelength_nm,power_rel) beside the rig file, as a spectrometer measured it",
        json_schema_extra={"pattern": PLANCK_OR_CSV},
    )
    temperature_uncertainty_k: Annotated[float, Field(ge=0.0, le=500.0)] = Field(
        default=50.0,
        description="standard uncertainty of the lamp's colour temperature in kelvin (for a measured spectrum: of its "
        "tilt, as a temperature); 50 K (5 % in the ratio of 450 to 600 nm) for a lamp known by its label only",
    )

    @property
    def temperature_k(self) -> float:
        """Colour temperature, K; of a measured spectrum the usual one, at which its tilt counts."""
        found = re.fullmatch(PLANCK, self.spectrum)
        return float(found[1]) if found else USUAL_TEMPERATURE_K

    @model_validator(mode="after")
    def _spectrum_is_known(self) -> "LampSettings":
        if not re.fullmatch(PLANCK_OR_CSV, self.spectrum) or not 1500.0 <= self.temperature_k <= 9999.0:
            raise ValueError(
                f"spectrum: {self.spectrum!r} is not supported; give planck-2856K (or another temperature, from 1500 "
                "to 9999 K), or the name of a CSV file (wavelength_nm,power_rel) with the measured spectrum"
            )
        return self

    @model_validator(mode="after")
    def _is_reachable(self) -> "LampSettings":
        require_address(self.driver, self.address)
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


class WhiteReference(Model):
    """Diffuse white tile with its reflectance (spectrally flat) and standard uncertainty."""

    reflectance: Fraction = 0.98
    uncertainty_rel: RelativeUncertainty = 0.005


class BandUncertainty(Model):
    """Relative standard uncertainties of band values besides the noise of frames; smaller only where measured."""

    calibration_rel: TypeBUncertainty = Field(default=0.01, description="error of each filter, common to its channels")
    response_rel: TypeBUncertainty = Field(default=0.003, description="error of a channel's response in a filter band")
    stray_light_rel: TypeBUncertainty = Field(
        default=0.003,
        description="light that bypasses the filters: error of each band value (sample over white), relative to the "
        "largest band value but that of the laser's filter",
    )


class HiddenPaint(Model):
    """A paper-family paint on the simulated bench; its numbers are the truth the fitter does not see."""

    name: str
    mode_nm: WavelengthNm
    fwhm_nm: WidthNm
    asinh_skewness: Annotated[float, Field(ge=-6.0, le=6.0)]
    energy_yield: Fraction = Field(description="emitted over incident energy at the laser line")
    absorption_peak_nm: WavelengthNm
    reflectance_at_laser: Fraction = 0.05
    reflectance_long_wavelength: Fraction = 0.75
    bleaching_per_j: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "1/J"})] = Field(
        default=0.0, description="relative loss of emission per joule of laser light on the sample"
    )


class FaultSizes(NamedTuple):
    """Sizes that a practice fault can have.

    Attributes
    ----------
    unit
        Of the size, as it is written.
    value, low, high
        Size where none is written, and the smallest and largest allowed.
    """

    unit: str
    value: float
    low: float
    high: float


PRACTICE_FAULTS: Final[Mapping[str, FaultSizes]] = {
    "slipping wheel": FaultSizes("%", 30.0, 0.1, 90.0),
    "dirty filter": FaultSizes("%", 30.0, 0.1, 90.0),
    "drifting laser": FaultSizes("%", 40.0, 0.1, 90.0),
    "bleaching paint": FaultSizes("%", 20.0, 0.1, 90.0),
    "lamp ageing": FaultSizes("K", 200.0, 1.0, 500.0),
    "focus shift": FaultSizes("px", 2.0, 0.1, 20.0),
    "stray light": FaultSizes("DN/s", 10.0, 0.01, 1000.0),
    "lost message": FaultSizes("%", 5.0, 1.0, 50.0),
    "unplugged camera": FaultSizes("frames", 20.0, 0.0, 10000.0),
}
"""Name of each fault that has a size -> its sizes; docs/reference/practice-faults.md says of what the size is."""
EXCHANGED_FILTERS: Final = "exchanged filters"
USUAL_PAIR: Final = ("500", "532")


class PracticeFault(NamedTuple):
    """A fault to practise on.

    Attributes
    ----------
    name
        One of :data:`PRACTICE_FAULTS`, or "exchanged filters".
    value
        Its size, in the unit of its name; 1 for exchanged filters.
    pair
        Names of the filters that are exchanged.
    """

    name: str
    value: float = 1.0
    pair: tuple[str, str] = ("", "")


TACTILE_FAULTS: Final[Mapping[str, FaultSizes]] = {
    "stuck cell": FaultSizes("s", 20.0, 0.0, 10000.0),
    "silent cell": FaultSizes("s", 20.0, 0.0, 10000.0),
    "drifting cell": FaultSizes("mN/s", 20.0, 0.1, 1000.0),
    "lost steps": FaultSizes("%", 5.0, 0.1, 90.0),
    "wandering cell": FaultSizes("counts", 60.0, 1.0, 100000.0),
    "humming cell": FaultSizes("counts", 200.0, 1.0, 100000.0),
    "lost bits": FaultSizes("readings", 1000.0, 10.0, 1e7),
}
"""The same of a simulated finger with stage and load cell."""


def practice_fault(text: str, faults: Mapping[str, FaultSizes] = PRACTICE_FAULTS) -> PracticeFault:
    """Return the fault that a text names: ``"stray light"``, ``"stray light, 10 DN/s"``.

    Raises
    ------
    ValueError
        There is no such fault, or none of this size.
    """
    name, _, size = (part.strip() for part in text.partition(","))
    if name == EXCHANGED_FILTERS and faults is PRACTICE_FAULTS:
        pair = tuple(part.strip() for part in size.split(" and ")) if size else USUAL_PAIR
        if len(pair) != 2 or pair[0] == pair[1] or not all(pair):
            raise ValueError(
                f"'{name}' needs the names of two different filters, such as '{name}, {' and '.join(USUAL_PAIR)}'"
            )
        return PracticeFault(name, pair=(pair[0], pair[1]))
    if name not in faults:
        known = (*faults, EXCHANGED_FILTERS) if faults is PRACTICE_FAULTS else tuple(faults)
        near = difflib.get_close_matches(name, known, 1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'? Valid" if near else "valid"
        raise ValueError(f"'{name}' is not a practice fault; {hint} names are {', '.join(known)}")
    sizes = faults[name]
    if not size:
        return PracticeFault(name, sizes.value)
    number, _, unit = size.partition(" ")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if unit.strip() != sizes.unit or not sizes.low <= value <= sizes.high:
        raise ValueError(
            f"the size of '{name}' must be a number from {sizes.low:g} to {sizes.high:g}, a space and the unit, such "
            f"as '{name}, {sizes.value:g} {sizes.unit}'"
        )
    return PracticeFault(name, value)


def _is_a_practice_fault(text: str) -> str:
    """Refuse what names no practice fault."""
    practice_fault(text)
    return text


class SimulatedBench(Model):
    """What the simulated bench holds; ignored by real drivers."""

    seed: Seed = 1
    practice_fault: Annotated[str, AfterValidator(_is_a_practice_fault)] | None = Field(
        default=None,
        description=f"a fault to practise on, with its size if it is not the usual one, such as 'stray light' or "
        f"'stray light, 10 DN/s': {', '.join((*PRACTICE_FAULTS, EXCHANGED_FILTERS))}; none where it is left out",
    )
    paint: HiddenPaint | None = None
    material: str | None = Field(default=None, description="CSV file of a measured re-radiation matrix")

    @property
    def fault(self) -> PracticeFault | None:
        """The fault to practise on."""
        return None if self.practice_fault is None else practice_fault(self.practice_fault)

    @model_validator(mode="after")
    def _one_sample(self) -> "SimulatedBench":
        if (self.paint is None) == (self.material is None):
            raise ValueError("needs exactly one of 'paint' (hidden parameters) and 'material' (a CSV file)")
        return self


StageAxis = Literal["X", "Y", "Z"]
SpeedMmPerS = Annotated[float, Field(gt=0.0, le=100.0, json_schema_extra={"unit": "mm/s"})]
StepMm = Annotated[float, Field(ge=0.002, le=0.5, json_schema_extra={"unit": "mm"})]
ForceN = Annotated[float, Field(gt=0.0, le=1000.0, json_schema_extra={"unit": "N"})]


class StageSettings(Model):
    """Stage that drives an indenter into the pad; every place is an absolute machine coordinate in mm."""

    driver: DriverName = "simulated"
    address: str = Field(default="", description="grbl: serial port (/dev/ttyUSB0) or pyserial URL; simulated: none")
    model: str = ""
    press_axis: StageAxis = Field(default="Z", description="axis along the pad's normal")
    pad_axis: StageAxis = Field(default="X", description="axis along the pad")
    into_pad: Literal[-1, 1] = Field(default=-1, description="sign of the press axis for moves into the pad")
    from_base: Literal[-1, 1] = Field(default=1, description="sign of the pad axis for moves away from the base")
    base_mm: PositionMm = Field(description="position of the pad axis with the indenter over the pad's base")
    clear_mm: PositionMm = Field(
        description="position of the press axis at which nothing touches, anywhere along the pad"
    )
    press_travel_mm: tuple[PositionMm, PositionMm] = Field(
        description="lowest and highest position of the press axis; the end in the pad is the deepest allowed"
    )
    pad_travel_mm: tuple[PositionMm, PositionMm] = Field(description="lowest and highest position of the pad axis")
    homing: Literal["switches", "by hand"] = Field(
        description="switches: the stage finds its zero by itself; by hand: a person brings it to its zero and "
        "confirms it"
    )
    step_mm: StepMm = Field(
        default=0.05,
        description="longest step towards the pad, and so the longest way that a stage moves on if it cannot "
        "be stopped",
    )
    touch_step_mm: StepMm = Field(default=0.02, description="step of the search for the touch")
    press_speed_mm_per_s: SpeedMmPerS = Field(default=0.5, description="speed of steps towards the pad")
    travel_speed_mm_per_s: SpeedMmPerS = Field(default=5.0, description="speed of moves away from the pad and along it")
    position_uncertainty_mm: Annotated[float, Field(gt=0.0, le=1.0, json_schema_extra={"unit": "mm"})] = Field(
        default=0.02,
        description="standard uncertainty of the distance between two positions: screw, backlash, lost steps",
    )

    @property
    def deepest_mm(self) -> float:
        """The end of the press axis' travel that lies in the pad."""
        return self.press_travel_mm[self.into_pad > 0]

    @model_validator(mode="after")
    def _is_reachable(self) -> "StageSettings":
        require_address(self.driver, self.address)
        return self

    @model_validator(mode="after")
    def _travel_makes_sense(self) -> "StageSettings":
        if self.press_axis == self.pad_axis:
            raise ValueError(f"press_axis and pad_axis are both {self.press_axis}, but must be different axes")
        for name, (low, high) in (("press_travel_mm", self.press_travel_mm), ("pad_travel_mm", self.pad_travel_mm)):
            if low >= high:
                raise ValueError(f"{name}: {low:g} mm must be below {high:g} mm; write the lower position first")
        if self.touch_step_mm > self.step_mm:
            raise ValueError(
                f"touch_step_mm = {self.touch_step_mm:g} mm must not exceed step_mm = {self.step_mm:g} mm, the longest "
                "step towards the pad"
            )
        low, high = self.press_travel_mm
        if not low <= self.clear_mm <= high or self.clear_mm == self.deepest_mm:
            raise ValueError(
                f"clear_mm = {self.clear_mm:g} mm must lie within press_travel_mm ({low:g} to {high:g} mm), but not "
                f"at the end that lies in the pad ({self.deepest_mm:g} mm)"
            )
        return self


class LoadCellSettings(Model):
    """Load cell under the finger or behind the indenter."""

    driver: DriverName = "simulated"
    address: str = Field(default="", description="hx711: serial port (/dev/ttyACM0) or pyserial URL; simulated: none")
    model: str = ""
    capacity_n: ForceN = Field(description="largest force that the cell can bear")
    force_limit_n: ForceN = Field(description="force at which the stage always stops, independent of the plan")
    calibration: str = Field(
        default="load-cell.json",
        description="record that 'finray rig calibrate-cell' writes; relative to the rig file",
    )
    rate_hz: Literal[10, 80] = Field(default=80, description="readings a second, by the RATE pin of the HX711")
    silent_s: Annotated[float, Field(ge=0.05, le=2.0, json_schema_extra={"unit": "s"})] = Field(
        default=0.5, description="the stage stops when the cell sends no new reading for this time"
    )
    settle_s: Annotated[float, Field(ge=0.1, le=60.0, json_schema_extra={"unit": "s"})] = Field(
        default=3.0, description="longest wait for a force to settle; a change that remains counts as uncertainty"
    )

    @model_validator(mode="after")
    def _limits_make_sense(self) -> "LoadCellSettings":
        require_address(self.driver, self.address)
        if self.force_limit_n > self.capacity_n:
            raise ValueError(
                f"force_limit_n = {self.force_limit_n:g} N must not exceed capacity_n = {self.capacity_n:g} N"
            )
        if self.silent_s * self.rate_hz < 4.0:
            raise ValueError(
                f"silent_s = {self.silent_s:g} s is too short for four readings at {self.rate_hz} Hz; give at least "
                f"{4.0 / self.rate_hz:g} s"
            )
        return self


def _is_a_tactile_fault(text: str) -> str:
    """Refuse what names no practice fault of a stage or a load cell."""
    practice_fault(text, TACTILE_FAULTS)
    return text


class SimulatedFinger(Model):
    r"""Compliant finger, stage and load cell to practise on; its numbers are the truth that a session does not see.

    Force at the indentation d: ``k1 d + k2 d^2``, and a share of it more that relaxes with 0.5 s.
    """

    seed: Seed = 1
    surface_mm: PositionMm = Field(default=-6.0, description="position at which the press axis touches the pad")
    stiffness_n_per_mm: Annotated[float, Field(gt=0.0, le=1e3)] = 1.5
    stiffening_n_per_mm2: Annotated[float, Field(ge=0.0, le=1e3)] = 0.8
    relaxing_share: Fraction = 0.05
    cell_n_per_count: Annotated[float, Field(gt=0.0, le=1.0)] = 4.7e-6
    noise_counts: Annotated[int, Field(ge=1, le=100000)] = Field(default=60, description="standard deviation")
    practice_fault: Annotated[str, AfterValidator(_is_a_tactile_fault)] | None = Field(
        default=None, description=f"a fault to practise on, with its size if not the usual: {', '.join(TACTILE_FAULTS)}"
    )

    @property
    def fault(self) -> PracticeFault | None:
        """The fault to practise on."""
        return None if self.practice_fault is None else practice_fault(self.practice_fault, TACTILE_FAULTS)


class RigFile(Record):
    """A whole rig."""

    schema_version: ClassVar[int] = 6

    name: str
    camera: CameraSettings = CameraSettings()
    filter_wheel: FilterWheelSettings
    laser: LaserSettings = LaserSettings()
    lamp: LampSettings = LampSettings()
    white_reference: WhiteReference = WhiteReference()
    band_uncertainty: BandUncertainty = BandUncertainty()
    simulated: SimulatedBench | None = None

    @model_validator(mode="after")
    def _simulated_needs_a_bench(self) -> "RigFile":
        drivers = (self.camera.driver, self.filter_wheel.driver, self.laser.driver, self.lamp.driver)
        if 0 < drivers.count("simulated") < len(drivers):
            raise ValueError(
                "simulated and real devices cannot be mixed in one rig, because the simulated bench does not see "
                "what real devices do; give camera, filter_wheel, laser and lamp all a real driver, or all the "
                "driver 'simulated'"
            )
        if "simulated" in drivers and self.simulated is None:
            raise ValueError("the table [simulated] is missing; simulated devices need it, with a paint or a material")
        return self

    @model_validator(mode="after")
    def _exchanged_filters_are_there(self) -> "RigFile":
        fault = None if self.simulated is None else self.simulated.fault
        known = [band.name for band in self.filter_wheel.filters]
        lost = [] if fault is None else [name for name in fault.pair if name and name not in known]
        if lost:
            raise ValueError(
                f"simulated.practice_fault: no filter is named '{lost[0]}'; valid names are {', '.join(known)}"
            )
        return self

    @model_validator(mode="after")
    def _one_address_each(self) -> "RigFile":
        laser, lamp = ((light.driver, light.address) for light in (self.laser, self.lamp))
        if laser == lamp and self.laser.address:
            raise ValueError(
                f"laser and lamp have the same driver '{laser[0]}' and address {laser[1]}, but one switch cannot "
                "control both; correct one of them"
            )
        wheel = self.filter_wheel
        for role, light in (("laser", self.laser), ("lamp", self.lamp)):
            if (wheel.driver, light.driver) == ("thorlabs", "arduino") and wheel.address == light.address:
                raise ValueError(
                    f"filter_wheel and {role} have the same address, {wheel.address}, but a serial port connects only "
                    "one device; correct one of the addresses"
                )
        return self

    @property
    def is_simulated(self) -> bool:
        """Whether the simulated bench stands in for all devices."""
        return self.camera.driver == "simulated"
