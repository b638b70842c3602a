"""Tactile sessions: presses on a finished finger. The rig is a camera alone; the finger brings its own light."""

from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field, model_validator

from data_schemas.capture import CurrentMa, IndenterPose, UncertaintyDeg, UncertaintyMm
from data_schemas.devices import CameraSettings, DeviceIdentity
from data_schemas.model import Model, Record
from data_schemas.units import AngleDeg, DurationS, ExposureS, Fraction, LengthMm, PositionMm, RelativeUncertainty

BRACKET_POWERS: Final = (4, 22)
"""Two to this power in microseconds: 16 us to 4.2 s, as rigs with Raspberry Pi cameras take it."""
MICROSECOND_S: Final = 1e-6

TactileFrameType = Literal["board", "no contact", "contact"]


class TactileRig(Record):
    """Rig of a tactile session (TOML): the finger's camera. There is no filter wheel and no laser to describe."""

    name: str
    camera: CameraSettings

    @model_validator(mode="after")
    def _camera_is_real(self) -> "TactileRig":
        if self.camera.driver == "simulated":
            raise ValueError(
                "camera.driver: the simulated bench holds no finger; name a real camera, or simulate a press with "
                "'finray simulate'"
            )
        return self


class PressIndenter(Model):
    """What is pressed into the pad."""

    shape: Literal["cylinder", "ball"]
    radius_mm: LengthMm


class PlannedPress(Model):
    """One press: where and how deep, with standard uncertainties."""

    depth_mm: Annotated[float, Field(ge=0.0, le=100.0, json_schema_extra={"unit": "mm"})]
    position_mm: PositionMm = Field(description="along the pad, from the base")
    tilt_deg: AngleDeg = Field(default=0.0, description="between the indenter's axis and the pad's normal")
    depth_uncertainty_mm: UncertaintyMm
    position_uncertainty_mm: UncertaintyMm
    tilt_uncertainty_deg: UncertaintyDeg | None = None

    def pose(self, indenter: PressIndenter) -> IndenterPose:
        """Return the pose of `indenter` in this press."""
        return IndenterPose(**indenter.model_dump(), **self.model_dump())


class CharucoBoard(Model):
    """The ChArUco board whose images calibrate the camera's geometry."""

    squares: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]] = Field(
        description="along the rows, along the columns"
    )
    square_mm: LengthMm
    marker_mm: LengthMm
    dictionary: str = Field(
        pattern=r"^DICT_((4X4|5X5|6X6|7X7)_(50|100|250|1000)|ARUCO_ORIGINAL)$", description="OpenCV's name of it"
    )
    images: Annotated[int, Field(ge=1, le=200)] = 10
    on_pad: bool = Field(
        default=False, description="the first place is flat where the coat of the pad is: it gives mm per pixel"
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

    kind: Literal["tactile"] = "tactile"
    name: str = Field(description="names the session's folder and its captures")
    design: str = Field(description="finger or sensor: its design file, or name and number")
    indenter: PressIndenter
    presses: tuple[PlannedPress, ...] = Field(default=(), description="asked of the operator one after another")
    poses_csv: str | None = Field(
        default=None,
        description="in place of 'presses': CSV file of poses that a stage reports, with their fields as header; "
        "relative to the plan",
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(default=1, description="of each press, retracted between")
    no_contact_images: Annotated[int, Field(ge=1, le=50)] = Field(default=2, description="before and after each press")
    exposures_s: tuple[ExposureS, ...] = Field(
        default=(), description="of every image; over MJPEG one, which is set at the camera's server"
    )
    bracket_powers: tuple[Annotated[int, Field(ge=0, le=31)], Annotated[int, Field(ge=0, le=31)]] | None = Field(
        default=None,
        description="in place of 'exposures_s': all powers of two of a microsecond from the first to the last that the "
        f"rig's camera allows, such as [{BRACKET_POWERS[0]}, {BRACKET_POWERS[1]}]",
    )
    led_current_ma: CurrentMa = Field(description="of the blue LED panel")
    light_angle_deg: AngleDeg = Field(description="measured: the panel's normal from the pad plane")
    light_angle_uncertainty_deg: UncertaintyDeg
    mm_per_px: LengthMm | None = Field(
        default=None, description="side of a raw pixel on the pad, as 'finray study pixel-scale' measures it"
    )
    mm_per_px_u_rel: RelativeUncertainty | None = Field(
        default=None, description="relative standard uncertainty; none: not known"
    )
    board: CharucoBoard | None = None

    @model_validator(mode="after")
    def _poses_come_once(self) -> "TactilePlan":
        if bool(self.presses) == (self.poses_csv is not None):
            raise ValueError("needs either [[presses]] tables or poses_csv, one of the two")
        return self

    @model_validator(mode="after")
    def _exposures_come_once(self) -> "TactilePlan":
        if bool(self.exposures_s) == (self.bracket_powers is not None):
            raise ValueError("needs either exposures_s or bracket_powers, one of the two")
        if len(set(self.exposures_s)) < len(self.exposures_s):
            raise ValueError("exposures_s: an exposure is listed twice; list each once")
        if self.bracket_powers is not None and self.bracket_powers[0] > self.bracket_powers[1]:
            raise ValueError("bracket_powers: the first must not exceed the last")
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
        description="number of the contact, from 1; of no-contact images that of the contact before them (0: none); of "
        "board images that of the board's place"
    )
    exposure_requested_s: ExposureS
    exposure_s: ExposureS | None = Field(description="none where the camera does not say")
    captured_utc: str
    captured_s: DurationS = Field(description="end of the exposure on the journal's monotonic clock")
    frame_id: int | None = None
    device_time_s: float | None = None
    settings: dict[str, str | float] = Field(default={}, description="as the camera reads them back, by name")
    attempts: Annotated[int, Field(ge=1, le=100)] = 1
    saturated_fraction: Fraction = Field(description="pixels with a value at full scale")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class TactileSession(Record):
    """A finished tactile session (a folder on disk): plan, rig, frames, and a ``TactileCapture`` of each contact."""

    schema_version: ClassVar[int] = 2
    written_by: ClassVar[str] = "'finray capture'"

    plan: TactilePlan
    rig: TactileRig
    presses: tuple[PlannedPress, ...] = Field(description="of the plan or of its poses_csv")
    frames: tuple[TactileFrame, ...]
    captures: tuple[str, ...] = Field(description="files of the tactile captures, in the order of the contacts")
    devices: tuple[DeviceIdentity, ...] = ()
    notes: tuple[str, ...] = ()
