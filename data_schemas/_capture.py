"""Capture plans, what a capture session stores, and tactile captures.

A paint session photographs a paint through the filters of the rig. A tactile session holds presses on a finished
finger: its rig is a camera alone, for the finger brings its own light.
"""

from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from data_schemas._curves import SpectralCurve, check_named_curves
from data_schemas._model import Model, Record
from data_schemas._rig import (
    CameraSettings,
    DeviceIdentity,
    ForceN,
    LoadCellSettings,
    RigFile,
    SimulatedFinger,
    StageSettings,
)
from data_schemas._units import (
    AngleDeg,
    ArraySpec,
    DurationS,
    EnergyJ,
    ExposureS,
    Fraction,
    LengthMm,
    PositionMm,
    RelativeUncertainty,
    SignalDn,
)

LightState = Literal["off", "lamp", "laser", "room"]
Target = Literal["white", "sample", "sample beside ColorChecker"]
FrameType = Literal[
    "dark",
    "white",
    "reflectance",
    "fluorescence",
    "laser white",
    "room light",
    "fluorescence repeat",
    "tilted fluorescence",
]
Encoding = Literal["linear", "unknown"]
PixelLayout = Literal["RGB", "Bayer RGGB"]


UncertaintyMm = Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})]
UncertaintyDeg = Annotated[float, Field(ge=0.0, le=90.0, json_schema_extra={"unit": "deg"})]
CurrentMa = Annotated[float, Field(gt=0.0, le=1e5, json_schema_extra={"unit": "mA"})]


class RegionOfInterest(Model):
    """Rectangle of the painted (and white) area in pixels of the raw frame."""

    row_px: Annotated[int, Field(ge=0)]
    column_px: Annotated[int, Field(ge=0)]
    height_px: Annotated[int, Field(ge=0)]
    width_px: Annotated[int, Field(ge=0)]


class PaintPlan(Record):
    """Plan of a paint session (TOML): which paint, where it lies in the frame, how to expose."""

    kind: Literal["paint"] = "paint"
    paint_name: str
    filters: tuple[str, ...] | None = Field(
        default=None, description="names in capture order; all filters of the rig if left out"
    )
    excitation_filter: str = Field(default="450", description="the filter that passes the laser line")
    region: RegionOfInterest
    target_fraction: Annotated[float, Field(gt=0.1, lt=0.95)] = Field(
        default=0.7, description="brightest pixel of the region as a fraction of full scale"
    )
    bracket: tuple[Annotated[float, Field(gt=0.0, le=1.0)], ...] = Field(
        default=(1.0, 0.25), min_length=1, description="exposures of each step, as multiples of the metered exposure"
    )
    darks_per_exposure: Annotated[int, Field(ge=1, le=50)] = 2
    second_tilt_deg: Annotated[float, Field(ge=5.0, le=75.0, json_schema_extra={"unit": "deg"})] | None = Field(
        default=None,
        description=(
            "second angle between the laser beam and the sample's normal (the first is 0): tests whether the paint "
            "is diffuse; if it is left out, the sample is not tilted"
        ),
    )
    second_tilt_filters: tuple[str, str] | None = Field(
        default=None, description="the two filters of the tilted sample, such as the two brightest of the paint"
    )

    @model_validator(mode="after")
    def _filters_once(self) -> "PaintPlan":
        for field, names in (("filters", self.filters or ()), ("second_tilt_filters", self.second_tilt_filters or ())):
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise ValueError(f"{field}: {twice[0]!r} is named twice; name each filter once")
        return self

    @model_validator(mode="after")
    def _tilt_is_whole(self) -> "PaintPlan":
        if (self.second_tilt_deg is None) != (self.second_tilt_filters is None):
            raise ValueError(
                "second_tilt_deg and second_tilt_filters must be given together; give both or leave both out"
            )
        return self


class Frame(Model):
    """One stored raw frame: what was asked, what the devices read back, and the file's checksum."""

    sequence: Annotated[int, Field(ge=0)]
    file: str = Field(pattern=r"^frames/[A-Za-z0-9_.-]+\.tiff$")
    frame_type: FrameType
    target: Target
    light: LightState
    filter_name: str | None
    slot_before: int | None
    slot_after: int | None
    exposure_requested_s: ExposureS
    exposure_s: ExposureS
    captured_utc: str
    middle_s: DurationS = Field(default=0.0, description="middle of the exposure on the journal's monotonic clock")
    laser_dose_j: EnergyJ = Field(
        default=0.0,
        description="laser light that fell on the sample from the start of the session to the middle of this exposure: "
        "power x time with the laser on and the sample in view, metering included",
    )
    frame_id: int | None = Field(default=None, description="the camera's own number of the frame; it may start over")
    device_time_s: float | None = Field(default=None, description="the camera's own time of the frame")
    lights_before: tuple[Literal["lamp", "laser"], ...] = Field(
        default=(), description="lights that reported to be on before the exposure"
    )
    lights_after: tuple[Literal["lamp", "laser"], ...] = Field(
        default=(), description="lights that reported to be on after the exposure"
    )
    settings: dict[str, str | float] = Field(
        default={}, description="other settings as the camera reads them back, by name (gain, pixel format)"
    )
    attempts: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="number of exposures that this frame needed; more than one where frames were refused"
    )
    tilt_deg: AngleDeg = Field(default=0.0, description="angle between the laser beam and the sample's normal")
    saturated_fraction: Fraction = Field(description="share of the pixels of the region at full scale")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class FilterProof(Model):
    """Whether the frames themselves show the filters that the wheel claims."""

    others_in_place: ClassVar[str] = "the others are where they should be"
    """In the text of a proof that cannot distinguish some filters, where it does distinguish others."""

    verdict: Literal["confirmed", "contradicted", "cannot tell"]
    text: str

    @property
    def shows_turns(self) -> bool:
        """Whether frames at two slots at least differ as their filters do: a wheel that stays shows no such frames."""
        return self.verdict == "confirmed" or (self.verdict == "cannot tell" and self.others_in_place in self.text)


class CaptureSession(Record):
    """A finished paint session: plan, rig, response curves and the list of frames (a folder on disk)."""

    schema_version: ClassVar[int] = 7
    written_by: ClassVar[str] = "'finray capture'"
    shown: ClassVar[tuple[str, ...]] = ("plan.paint_name", "plan.excitation_filter", "rig.name")

    plan: PaintPlan
    rig: RigFile
    camera_response: tuple[SpectralCurve, SpectralCurve, SpectralCurve]
    filter_curves: dict[str, SpectralCurve] = Field(
        default={}, description="measured transmission of each filter that names a curve, by the filter's name"
    )
    lamp: SpectralCurve
    frames: tuple[Frame, ...]
    devices: tuple[DeviceIdentity, ...] = Field(default=(), description="identity of the devices, as they report it")
    filter_proof: FilterProof | None = Field(
        default=None,
        description="whether the filters are in their slots, judged from the white frames under the lamp and from the "
        "laser's line",
    )
    white_rates_dn_per_s: tuple[tuple[float, float, float], ...] = Field(
        default=(), description="red, green, blue rates of the white tile behind each filter: the session's fingerprint"
    )
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _curves_are_those_of_the_filters(self) -> "CaptureSession":
        check_named_curves(self.rig.filter_wheel.filters, self.filter_curves)
        return self


class IndenterPose(Model):
    """What was pressed, where and how deep; the circle or strip it touches. Uncertainties are standard ones."""

    shape: Literal["cylinder", "ball", "cuboid", "mesh"]
    radius_mm: LengthMm | None = Field(description="radius, or half the width where it is not round; none: not known")
    depth_mm: Annotated[float, Field(ge=0.0, json_schema_extra={"unit": "mm"})] | None
    position_mm: PositionMm | None = Field(description="place along the pad, from the base")
    tilt_deg: AngleDeg | None = Field(
        default=None, description="angle between the indenter's axis and the pad's normal"
    )
    depth_uncertainty_mm: UncertaintyMm | None = None
    position_uncertainty_mm: UncertaintyMm | None = None
    tilt_uncertainty_deg: UncertaintyDeg | None = None


class ContactCircle(Model):
    """Contact region of a ball in pixels of the image."""

    row_px: float
    column_px: float
    radius_px: Annotated[float, Field(gt=0.0)]


class PlaceInImage(Model):
    """A place in the image; the centre of the first pixel is 0, 0."""

    row_px: float
    column_px: float


class MissingPart(Model):
    """What a capture lacks, and what is lost by it."""

    what: str
    lost: str


SignedN = Annotated[float, Field(ge=-1000.0, le=1000.0, json_schema_extra={"unit": "N"})]
UncertaintyN = Annotated[float, Field(ge=0.0, le=1000.0, json_schema_extra={"unit": "N"})]
NO_CERTIFICATE: Final = "not traceable: no certificate of the masses recorded"


class LoadCellCalibration(Record):
    r"""Slope of a load cell from known masses, with its deviations from a straight line.

    .. math:: m g = s (c - c_0)

    All means weigh the same (their common noise); what masses and gravity leave open goes into the slope's
    uncertainty.
    """

    schema_version: ClassVar[int] = 1
    written_by: ClassVar[str] = "'finray rig calibrate-cell'"
    shown: ClassVar[tuple[str, ...]] = ("cell", "slope_n_per_count", "slope_uncertainty_n_per_count", "traceability")

    cell: str = Field(description="rig, driver and address")
    calibrated_utc: str
    certificate: str | None = Field(default=None, description="certificate of the masses; none: not recorded")
    gravity_m_per_s2: Annotated[float, Field(ge=9.7, le=9.9, json_schema_extra={"unit": "m/s^2"})]
    gravity_uncertainty_m_per_s2: Annotated[float, Field(ge=0.0, le=0.1, json_schema_extra={"unit": "m/s^2"})]
    masses_kg: tuple[Annotated[float, Field(ge=0.0, le=1000.0, json_schema_extra={"unit": "kg"})], ...] = Field(
        description="masses in the order in which they lay on the cell, loading and unloading"
    )
    mass_uncertainty_rel: RelativeUncertainty = Field(description="standard uncertainty, shared by all masses")
    counts: tuple[float, ...] = Field(description="mean count of each load")
    counts_uncertainties: tuple[float, ...] = Field(description="standard uncertainty of each mean")
    slope_n_per_count: float
    slope_uncertainty_n_per_count: Annotated[float, Field(ge=0.0)]
    linearity_n: UncertaintyN = Field(description="largest distance of a mean from the straight line")
    hysteresis_n: UncertaintyN = Field(description="largest difference of one mass between loading and unloading")
    noise_n: UncertaintyN = Field(description="standard deviation of one reading")
    drift_n_per_s: float = Field(description="drift of the empty cell, from the first to the last mass")
    readings: Annotated[int, Field(ge=2)] = Field(description="number of readings of each mean")

    @property
    def traceability(self) -> str:
        """The certificate of the masses, or that there is none."""
        return self.certificate or NO_CERTIFICATE

    @property
    def form_uncertainty_n(self) -> float:
        """Standard uncertainty (N) by the form of the curve: linearity and half the hysteresis, both uniform."""
        return float(np.hypot(self.linearity_n, 0.5 * self.hysteresis_n) / np.sqrt(3.0))

    @model_validator(mode="after")
    def _means_are_complete(self) -> "LoadCellCalibration":
        if not len(self.masses_kg) == len(self.counts) == len(self.counts_uncertainties) >= 3:
            raise ValueError(
                "masses_kg, counts and counts_uncertainties must have the same number of entries, at least 3"
            )
        if self.slope_n_per_count == 0.0:
            raise ValueError("slope_n_per_count is 0, so no force could be read; calibrate the load cell again")
        return self


class MeasuredPress(Model):
    """What stage and load cell measured of one contact; uncertainties are standard ones."""

    contact: Annotated[int, Field(ge=1)]
    ended_by: Literal["depth", "force"] = Field(description="whether the press ended at its depth or at its force")
    touch_mm: PositionMm = Field(
        description="machine coordinate of the press axis at first touch, as found with the load cell"
    )
    touch_uncertainty_mm: UncertaintyMm
    depth_mm: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})]
    depth_uncertainty_mm: UncertaintyMm
    force_n: SignedN = Field(description="force of the press: mean of the forces before and after the images")
    force_uncertainty_n: UncertaintyN
    relaxed_n: SignedN = Field(description="by how much the force fell while the images were taken")
    zero_shift_n: SignedN | None = Field(
        default=None, description="shift of the load cell's zero, measured after the indenter was taken away"
    )
    point_depths_mm: tuple[float, ...] = Field(default=(), description="depths of the steps since first touch")
    point_forces_n: tuple[float, ...] = ()
    point_uncertainties_n: tuple[float, ...] = ()


class PressDevice(Model):
    """What a stage or a load cell says it is; empty where it does not say."""

    role: Literal["stage", "load cell"]
    driver: str
    address: str = ""
    model: str = ""
    firmware: str = ""


class TactileCapture(Record):
    """Images of one press: contact, no contact and a repeat of no contact, with everything needed to compare.

    Images are raw counts (DN). Layout "Bayer RGGB" has shape (H, W, 1); "RGB" has (H, W, 3). With encoding
    "unknown" the values went through an unknown camera curve and are not proportional to light.
    """

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray capture'"

    name: str
    contact: Annotated[NDArray[np.uint16], ArraySpec("<u2", ("row", "column", "sample"), "DN")]
    no_contact: Annotated[NDArray[np.uint16], ArraySpec("<u2", ("row", "column", "sample"), "DN")]
    repeat_no_contact: Annotated[NDArray[np.uint16], ArraySpec("<u2", ("row", "column", "sample"), "DN")] | None
    layout: PixelLayout
    encoding: Encoding
    bit_depth: Literal[8, 10, 12, 14, 16]
    black_level_dn: SignalDn
    exposure_s: ExposureS | None
    light_angle_deg: AngleDeg | None
    indenter: IndenterPose
    contact_circle: ContactCircle | None
    mm_per_px: LengthMm | None
    source: str
    rig: str | None = Field(
        default=None, description="name of the rig; levels of captures of one rig may be compared across light angles"
    )
    light_angle_uncertainty_deg: UncertaintyDeg | None = Field(default=None, description="standard uncertainty")
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None, description="relative standard uncertainty of mm_per_px; none: not known"
    )
    led_current_ma: CurrentMa | None = Field(default=None, description="current of the blue LED panel")
    exposure_bracket_s: tuple[ExposureS, ...] = Field(
        default=(),
        description="all exposures of the press, including this one; the session holds the frames of the others",
    )
    contact_outline: tuple[PlaceInImage, ...] | None = Field(
        default=None, description="corners of the contact region where it is not a circle, in order"
    )
    contact_told_by: Literal["label", "search"] | None = Field(
        default=None,
        description="origin of the contact region. label: given with the capture or by the recipe; search: found in "
        "the picture by the program; none: not known",
    )
    no_contact_from: Literal["image", "median of presses", "pixels far from the contact"] = Field(
        default="image", description="origin of the no-contact image; everything but 'image' is a substitute"
    )
    force_n: Annotated[float, Field(ge=-1000.0, le=1000.0, json_schema_extra={"unit": "N"})] | None = Field(
        default=None, description="force of the press at the contact image"
    )
    force_uncertainty_n: UncertaintyN | None = Field(default=None, description="standard uncertainty; none: not known")
    press: MeasuredPress | None = Field(
        default=None, description="what the stage recorded; none where no stage pressed"
    )
    load_cell: LoadCellCalibration | None = Field(default=None, description="how the force was calibrated")
    licence: str | None = Field(
        default=None, description="licence under which the images were published; none: not known"
    )
    missing: tuple[MissingPart, ...] = Field(default=(), description="what the source of the capture lacks")

    @model_validator(mode="after")
    def _images_agree(self) -> "TactileCapture":
        if self.contact_outline is not None and self.contact_circle is not None:
            raise ValueError("contact_outline and contact_circle are both given; leave one of them out")
        if self.contact_outline is not None and len(self.contact_outline) < 3:
            raise ValueError(f"contact_outline must have at least 3 corners, got {len(self.contact_outline)}")
        samples = {"RGB": 3, "Bayer RGGB": 1}[self.layout]
        if self.contact.shape[2] != samples:
            raise ValueError(
                f"layout {self.layout} needs {samples} sample(s) per pixel, but the images have {self.contact.shape[2]}"
            )
        rows, columns = self.contact.shape[:2]
        if self.layout != "RGB" and (rows % 2 or columns % 2):
            raise ValueError(
                f"layout {self.layout} needs even numbers of rows and columns (2 x 2 cells), got {rows} x {columns}"
            )
        return self


BRACKET_POWERS: Final = (4, 22)
"""Two to this power in microseconds: 16 us to 4.2 s, as rigs with Raspberry Pi cameras take it."""
MICROSECOND_S: Final = 1e-6

TactileFrameType = Literal["board", "no contact", "contact"]


class TactileRig(Record):
    """Rig of a tactile session (TOML): the finger's camera and, if it presses by itself, stage and load cell."""

    schema_version: ClassVar[int] = 3

    name: str
    camera: CameraSettings
    stage: StageSettings | None = Field(
        default=None, description=("stage that presses; without this table a person presses")
    )
    load_cell: LoadCellSettings | None = Field(
        default=None, description="load cell that stops the stage; a stage needs one"
    )
    simulated: SimulatedFinger | None = Field(
        default=None, description="settings of the simulated bench; real drivers ignore them"
    )

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated finger stands in for all devices."""
        return self.camera.driver == "simulated"

    @model_validator(mode="after")
    def _devices_fit(self) -> "TactileRig":
        if (self.stage is None) != (self.load_cell is None):
            raise ValueError(
                "stage and load_cell must be given together, because nothing would stop a stage that presses without "
                "a load cell; describe both, or leave both out"
            )
        named = [self.camera.driver] + [part.driver for part in (self.stage, self.load_cell) if part is not None]
        if 0 < named.count("simulated") < len(named):
            raise ValueError(
                "simulated and real devices cannot be mixed in one rig; give all devices a real driver, "
                "or all the driver 'simulated'"
            )
        if self.is_simulated and (self.stage is None or self.simulated is None):
            raise ValueError(
                "camera.driver is 'simulated', so the tables [simulated], [stage] and [load_cell] of a simulated "
                "finger are needed; 'finray rig init --preset simulated-finger' writes them. To simulate a press "
                "without a rig, run 'finray simulate render'"
            )
        if self.stage is not None and self.load_cell is not None and self.stage.address == self.load_cell.address != "":
            raise ValueError(
                f"stage and load_cell have the same address, {self.stage.address}, but a serial port connects only "
                "one device; correct one of the addresses"
            )
        return self


class PressIndenter(Model):
    """What is pressed into the pad."""

    shape: Literal["cylinder", "ball"]
    radius_mm: LengthMm


class PlannedPress(Model):
    """One press: where and how deep, with standard uncertainties."""

    depth_mm: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})]
    position_mm: PositionMm = Field(description="place along the pad, from the base")
    tilt_deg: AngleDeg = Field(default=0.0, description="angle between the indenter's axis and the pad's normal")
    depth_uncertainty_mm: UncertaintyMm
    position_uncertainty_mm: UncertaintyMm
    tilt_uncertainty_deg: UncertaintyDeg | None = None
    force_limit_n: ForceN | None = Field(
        default=None,
        description="force at which the stage stops and the session ends; if it is left out, the limit of the rig file",
    )
    until_force_n: ForceN | None = Field(
        default=None, description="press until this force; depth_mm is then the depth that must not be exceeded"
    )

    @model_validator(mode="after")
    def _forces_in_order(self) -> "PlannedPress":
        if None not in (self.until_force_n, self.force_limit_n) and self.until_force_n >= self.force_limit_n:  # type: ignore[operator]
            raise ValueError(
                f"until_force_n = {self.until_force_n:g} N must be below force_limit_n = {self.force_limit_n:g} N"
            )
        return self

    def pose(self, indenter: PressIndenter) -> IndenterPose:
        """Return the pose of `indenter` in this press."""
        return IndenterPose(**indenter.model_dump(), **self.model_dump(exclude={"force_limit_n", "until_force_n"}))


class CharucoBoard(Model):
    """The ChArUco board whose images calibrate the camera's geometry."""

    squares: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]] = Field(
        description="number of squares along the rows, and along the columns"
    )
    square_mm: LengthMm
    marker_mm: LengthMm
    dictionary: str = Field(
        pattern=r"^DICT_((4X4|5X5|6X6|7X7)_(50|100|250|1000)|ARUCO_ORIGINAL)$",
        description="name of the markers' dictionary in OpenCV",
    )
    images: Annotated[int, Field(ge=1, le=200)] = 10
    on_pad: bool = Field(
        default=False,
        description=("true: in the first image the board lies flat where the pad's coat is, which gives mm per pixel"),
    )

    @model_validator(mode="after")
    def _marker_fits_its_square(self) -> "CharucoBoard":
        if self.marker_mm >= self.square_mm:
            raise ValueError(
                f"marker_mm = {self.marker_mm:g} mm must be smaller than square_mm = {self.square_mm:g} mm"
            )
        return self


class TactilePlan(Record):
    """Plan of a tactile session (TOML): which finger, what is pressed where, how to expose, how the finger is lit."""

    schema_version: ClassVar[int] = 2

    kind: Literal["tactile"] = "tactile"
    name: str = Field(description="name of the session, for its folder and its captures")
    design: str = Field(description="finger or sensor: its design file, or name and number")
    indenter: PressIndenter
    presses: tuple[PlannedPress, ...] = Field(
        default=(), description="presses, which the operator is asked to do one after another"
    )
    poses_csv: str | None = Field(
        default=None,
        description="in place of 'presses': a CSV file of poses that a stage reports, with the keys of [[presses]] as "
        "header; relative to the plan",
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="number of repeats of each press; the indenter is retracted between them"
    )
    no_contact_images: Annotated[int, Field(ge=1, le=50)] = Field(
        default=2, description="number of images before and after each press"
    )
    exposures_s: tuple[ExposureS, ...] = Field(
        default=(),
        description="exposures of every image; over MJPEG write one, the exposure set at the camera's server",
    )
    bracket_powers: tuple[Annotated[int, Field(ge=0, le=31)], Annotated[int, Field(ge=0, le=31)]] | None = Field(
        default=None,
        description="in place of 'exposures_s': exposures of 2^n microseconds for all n from the first to the last "
        f"number, where the rig's camera allows them, such as [{BRACKET_POWERS[0]}, {BRACKET_POWERS[1]}]",
    )
    led_current_ma: CurrentMa = Field(description="current of the blue LED panel")
    light_angle_deg: AngleDeg = Field(description="measured angle of the panel's normal from the pad plane")
    light_angle_uncertainty_deg: UncertaintyDeg
    mm_per_px: LengthMm | None = Field(
        default=None, description="side of a raw pixel on the pad, as 'finray sense scale' measures it"
    )
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None, description="relative standard uncertainty; none: not known"
    )
    board: CharucoBoard | None = None

    @model_validator(mode="after")
    def _poses_come_once(self) -> "TactilePlan":
        if bool(self.presses) == (self.poses_csv is not None):
            raise ValueError("exactly one of [[presses]] tables and poses_csv must be given")
        return self

    @model_validator(mode="after")
    def _exposures_come_once(self) -> "TactilePlan":
        if bool(self.exposures_s) == (self.bracket_powers is not None):
            raise ValueError("exactly one of exposures_s and bracket_powers must be given")
        if len(set(self.exposures_s)) < len(self.exposures_s):
            raise ValueError("exposures_s: an exposure is listed twice; list each once")
        if self.bracket_powers is not None and self.bracket_powers[0] > self.bracket_powers[1]:
            raise ValueError("bracket_powers: the first power must not be greater than the last")
        return self

    def bracket_s(self, camera: CameraSettings) -> tuple[float, ...]:
        """Return the exposures (s), increasing; of a bracket those that the rig's camera allows."""
        if self.bracket_powers is None:
            return tuple(sorted(self.exposures_s))
        first, last = self.bracket_powers
        powers_s = (2**power * MICROSECOND_S for power in range(first, last + 1))
        return tuple(t for t in powers_s if camera.shortest_exposure_s <= t <= camera.longest_exposure_s)


class TactileFrame(Model):
    """One stored frame: what was asked, what the camera read back, and the file's checksum."""

    sequence: Annotated[int, Field(ge=0)]
    file: str = Field(pattern=r"^frames/[A-Za-z0-9_.-]+\.tiff$")
    frame_type: TactileFrameType
    place: Annotated[int, Field(ge=0)] = Field(
        description="number of the contact, counted from 1. For a no-contact image the number of the "
        "contact before it (0 if none), for a board image the number of the board's place"
    )
    exposure_requested_s: ExposureS
    exposure_s: ExposureS | None = Field(description="as the camera reports it; none where it does not")
    captured_utc: str
    captured_s: DurationS = Field(description="end of the exposure on the journal's monotonic clock")
    frame_id: int | None = None
    device_time_s: float | None = None
    settings: dict[str, str | float] = Field(
        default={}, description="other settings as the camera reads them back, by name"
    )
    attempts: Annotated[int, Field(ge=1, le=100)] = 1
    saturated_fraction: Fraction = Field(description="share of the pixels with a value at full scale")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class TactileSession(Record):
    """A finished tactile session (a folder on disk): plan, rig, frames, and a ``TactileCapture`` of each contact."""

    schema_version: ClassVar[int] = 4
    written_by: ClassVar[str] = "'finray capture'"

    plan: TactilePlan
    rig: TactileRig
    presses: tuple[PlannedPress, ...] = Field(description="presses of the plan or of its poses_csv")
    frames: tuple[TactileFrame, ...]
    captures: tuple[str, ...] = Field(description="files of the tactile captures, in the order of the contacts")
    devices: tuple[DeviceIdentity, ...] = ()
    press_devices: tuple[PressDevice, ...] = Field(
        default=(), description="identity of stage and load cell, if a stage did the pressing"
    )
    measured: tuple[MeasuredPress, ...] = Field(
        default=(), description="what was recorded of each contact, if a stage did the pressing"
    )
    load_cell: LoadCellCalibration | None = None
    notes: tuple[str, ...] = ()
