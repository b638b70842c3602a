"""Acceptance of a rig: plan, facts and verdicts."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from data_schemas._capture import (
    FilterProof,
    LoadCellCalibration,
    PressDevice,
    RegionOfInterest,
    TactileRig,
    UncertaintyMm,
    UncertaintyN,
)
from data_schemas._model import Model, Record
from data_schemas._rig import DeviceIdentity, ForceN, RigFile
from data_schemas._units import DurationS, ExposureS, Fraction, PositionMm, Seed, SignalDn

CheckVerdict = Literal["PASS", "FAIL", "UNDECIDED", "ERROR"]
LightLayer = Literal["block", "guard", "dead-man"]
Witness = Literal["its own connection", "a new connection", "the camera", "a photodiode"]
Section = Literal[
    "opening", "handshake", "wheel", "dark frames", "filters", "revisits", "exposures", "warm-up", "stray light",
    "trigger latency", "light off", "closing", "reconnect", "load cell", "stage", "touch", "stops", "force limit",
]  # fmt: skip
RateDnPerS = Annotated[float, Field(gt=0.0, le=65535.0, json_schema_extra={"unit": "DN/s"})]
LimitDn = Annotated[float, Field(gt=0.0, le=65535.0, json_schema_extra={"unit": "DN"})]
LimitRel = Annotated[float, Field(gt=0.0, le=1.0, json_schema_extra={"unit": "1"})]
"""No rig keeps a limit of 0, and every rig one above 1."""
PixelShift = Annotated[float, Field(gt=0.0, le=100.0, json_schema_extra={"unit": "px"})]
StageMm = Annotated[float, Field(gt=0.0, le=10.0, json_schema_extra={"unit": "mm"})]
SettlingS = Annotated[float, Field(gt=0.0, le=7200.0, json_schema_extra={"unit": "s"})]
PositiveS = Annotated[float, Field(gt=0.0, le=60.0, json_schema_extra={"unit": "s"})]


class AnswerLimits(Model):
    """Largest allowed times of answers, of any rig."""

    handshake_s: PositiveS = Field(
        default=2.0, description="longest time for one answer of a device about its identity and state"
    )
    frame_overhead_s: PositiveS = Field(
        default=1.0, description="longest time until a frame has arrived, beyond its exposure"
    )
    reconnect_s: PositiveS = Field(
        default=45.0, description="longest time until all devices answer again after they were closed"
    )


class CheckLimits(AnswerLimits):
    """Largest allowed values; a check passes when its value is inside with 95 % confidence."""

    move_s: PositiveS = Field(default=5.0, description="longest of the moves of the wheel")
    revisit_rel: LimitRel = Field(
        default=0.01,
        description="largest RMS change of the white signal after the wheel has left the filter and come back",
    )
    pixel_shift_px: PixelShift = Field(
        default=0.5, description="largest RMS shift of the picture after the wheel has left the filter and come back"
    )
    black_level_dn: LimitDn = Field(
        default=2.0, description="largest difference of the dark level from black_level_dn of the rig file"
    )
    read_noise_rel: LimitRel = Field(
        default=0.25, description="largest difference of the read noise from read_noise_e, relative to read_noise_e"
    )
    dark_rate_dn_per_s: RateDnPerS = Field(
        default=2.0, description="largest growth of the dark level with the exposure: dark current and leaking light"
    )
    exposure_ratio_rel: LimitRel = Field(
        default=0.01,
        description="largest deviation of the signals at 2 t and 4 t from 2 and 4 times the signal at t, relative to "
        "these multiples",
    )
    lamp_drift_rel: LimitRel = Field(
        default=0.01, description="largest change of the lamp from the first to the last round of white frames"
    )
    lamp_settles_s: SettlingS = Field(
        default=60.0, description="longest time after switching on until the lamp stays within lamp_drift_rel"
    )
    stray_light_rel: LimitRel = Field(
        default=0.001, description="most laser light seen of the white tile through a filter that blocks the laser, "
        "relative to the filter that passes the laser"
    )  # fmt: skip
    latency_s: PositiveS = Field(
        default=0.5, description="longest time from the request of an exposure until light is collected"
    )
    light_off_s: PositiveS = Field(
        default=1.0, description="longest time from a mishap until the laser is off, for each safety layer"
    )


class CheckPlan(Record):
    """Plan of an acceptance check (TOML): where to look, how often, and what is allowed."""

    schema_version: ClassVar[int] = 5

    kind: Literal["check"] = "check"
    check_name: str = Field(description="name of the check, and of the report's folder")
    filters: tuple[str, ...] | None = Field(
        default=None, description="names of the filters to check; all of the rig if left out"
    )
    region: RegionOfInterest = Field(description="evenly lit part of the white tile")
    target_fraction: Annotated[float, Field(gt=0.1, lt=0.95)] = Field(
        default=0.7, description="brightest pixel of the region as a fraction of full scale"
    )
    wheel_moves: Annotated[int, Field(ge=0, le=1000)] = Field(default=20, description="random moves")
    revisits: Annotated[int, Field(ge=0, le=100)] = Field(
        default=20, description="how often the wheel leaves its brightest filter and comes back"
    )
    texture_is_of_the_tile: bool = Field(
        default=False,
        description="a printed pattern with far more contrast than dust and stains is in view, so that a shift of the "
        "picture can be seen; false: the check does not judge whether it stays in place",
    )
    darks_per_exposure: Annotated[int, Field(ge=2, le=100)] = 6
    longest_dark_s: ExposureS = Field(default=1.0, description="exposure of the longest dark frames")
    exposure_rounds: Annotated[int, Field(ge=4, le=100)] = Field(
        default=6, description="how often each of the exposures t, 2 t and 4 t is taken"
    )
    warm_up_s: Annotated[float, Field(ge=0.0, le=7200.0, json_schema_extra={"unit": "s"})] = Field(
        default=180.0, description="how long the lamp is watched after it is switched on; 0: not at all"
    )
    latency_tries: Annotated[int, Field(ge=0, le=100)] = Field(
        default=8, description="exposures during which the lamp is switched on; 0: none"
    )
    light_off_repeats: Annotated[int, Field(ge=1, le=20)] = Field(
        default=3, description="number of deliberate mishaps for each safety layer"
    )
    seed: Seed = Field(default=1, description="seed of the random moves")
    photodiode: str | None = Field(
        default=None,
        min_length=1,
        description="serial port (/dev/ttyACM1) or pyserial URL of a photodiode that sees the laser and confirms that "
        "it is off; left out: the camera does this",
    )
    limits: CheckLimits = CheckLimits()

    @model_validator(mode="after")
    def _filters_once(self) -> "CheckPlan":
        twice = sorted({n for n in self.filters or () if (self.filters or ()).count(n) > 1})
        if twice:
            raise ValueError(f"filters: {twice[0]!r} is named twice; name each filter once")
        return self


class PressLimits(AnswerLimits):
    """Largest allowed values of a rig that presses; a check passes when its value is inside with 95 % confidence.

    Names without a section are those of the rig file.
    """

    calibration_age_days: Annotated[float, Field(gt=0.0, le=3660.0, json_schema_extra={"unit": "d"})] = Field(
        default=365.0, description="largest age of the load cell's calibration: a year, as is usual in laboratories"
    )
    linearity_rel: LimitRel = Field(
        default=0.01,
        description="largest deviation of the calibration from its straight line, relative to its heaviest mass",
    )
    cell_noise_rel: LimitRel = Field(
        default=0.0125, description="largest noise of a reading, relative to force_limit_n; a session refuses more"
    )
    cell_drift_rel: LimitRel = Field(
        default=0.02,
        description="largest change of the zero at rest, relative to force_limit_n: a fifth of what ends a session",
    )
    zero_return_rel: LimitRel = Field(
        default=0.02, description="largest change of the cell's zero by a press, relative to force_limit_n"
    )
    cell_gap_s: PositiveS = Field(
        default=0.25, description="longest time between two readings: half of the usual silent_s of a rig file"
    )
    cell_rate_rel: LimitRel = Field(
        default=0.2, description="largest difference between the readings per second and rate_hz, relative to rate_hz"
    )
    stage_overhead_s: PositiveS = Field(
        default=1.0, description="longest time that a move takes beyond distance / speed"
    )
    stage_report_mm: StageMm = Field(
        default=0.01, description="largest distance of the reported position from the one that was asked for"
    )
    touch_repeat_mm: StageMm = Field(
        default=0.05,
        description="largest standard deviation of the position of touch over returns, and its largest shift by stops",
    )
    backlash_mm: StageMm = Field(
        default=0.05,
        description="largest play: difference between positions in the pad reached from above and from below"
        ", found from the force",
    )
    halt_s: PositiveS = Field(
        default=1.0, description="longest time from a request to stop until the stage is seen at rest"
    )
    factor_rel: LimitRel = Field(
        default=0.02,
        description="largest difference between the calibrated force of a known mass and its weight, relative to the "
        "weight",
    )
    scale_rel: LimitRel = Field(
        default=0.01,
        description="largest difference between a travel, by camera or gauge block, and the commanded travel, "
        "relative to the latter",
    )


class KnownMass(Model):
    """A mass that a person lays on the load cell during the check; preferably not one of those that calibrated it."""

    mass_kg: Annotated[float, Field(gt=0.0, le=100.0, json_schema_extra={"unit": "kg"})]
    uncertainty_kg: Annotated[float, Field(gt=0.0, le=1.0, json_schema_extra={"unit": "kg"})] = Field(
        description="standard uncertainty of the mass"
    )
    certificate: str | None = Field(default=None, description="certificate of the mass; none: not recorded")


class GaugeBlock(Model):
    """A flat block that a person lays on the pad between two touches."""

    thickness_mm: Annotated[float, Field(gt=0.0, le=50.0, json_schema_extra={"unit": "mm"})]
    uncertainty_mm: Annotated[float, Field(gt=0.0, le=1.0, json_schema_extra={"unit": "mm"})] = Field(
        description="standard uncertainty of the thickness, including how far the block's weight dents the pad"
    )


class TactileCheckPlan(Record):
    """Plan of an acceptance check (TOML) of a rig whose stage presses: where, how hard, how often, what is allowed."""

    schema_version: ClassVar[int] = 2

    kind: Literal["tactile check"] = "tactile check"
    check_name: str = Field(description="name of the check, and of the report's folder")
    position_mm: PositionMm = Field(description="position along the pad, from the base, at which the check presses")
    beside_mm: Annotated[float, Field(gt=0.0, le=50.0, json_schema_extra={"unit": "mm"})] = Field(
        default=2.0, description="how far the stage goes to either side of the position before it returns"
    )
    deepest_mm: Annotated[float, Field(gt=0.0, le=20.0, json_schema_extra={"unit": "mm"})] = Field(
        default=1.0, description="depth in the pad that the check never exceeds"
    )
    force_limit_n: ForceN | None = Field(
        default=None,
        description="force that the check does not plan to exceed, and at which the stage stops; left out: half of "
        "force_limit_n of the rig file",
    )
    returns: Annotated[int, Field(ge=4, le=100)] = Field(
        default=12, description="how often the stage returns to the position and touches, from either side in turn"
    )
    stops: Annotated[int, Field(ge=1, le=20)] = Field(
        default=3, description="how often the stage is stopped for each reason"
    )
    rest_s: Annotated[float, Field(ge=10.0, le=3600.0, json_schema_extra={"unit": "s"})] = Field(
        default=60.0, description="how long the load cell is read while nothing touches it"
    )
    exposure_s: ExposureS = Field(default=0.01, description="exposure of the camera's frames")
    known_mass: KnownMass | None = Field(
        default=None,
        description="mass to lay on the load cell; left out: none at hand, and the cell's scale factor stays undecided",
    )
    gauge_block: GaugeBlock | None = Field(
        default=None,
        description="block to lay on the pad; left out: none at hand, and the scale of the press axis stays undecided",
    )
    mm_per_px: Annotated[float, Field(gt=0.0, le=1.0, json_schema_extra={"unit": "mm/px"})] | None = Field(
        default=None,
        description="size of a raw pixel on the pad, by a scale or grid that was laid on it; left out: not known, and "
        "the scale of the pad axis stays undecided",
    )
    mm_per_px_u_rel: LimitRel | None = Field(
        default=None, description="relative standard uncertainty of mm_per_px; required with it"
    )
    limits: PressLimits = PressLimits()

    @model_validator(mode="after")
    def _scale_has_an_uncertainty(self) -> "TactileCheckPlan":
        if (self.mm_per_px is None) != (self.mm_per_px_u_rel is None):
            raise ValueError("mm_per_px and mm_per_px_u_rel must be given together; give both, or leave both out")
        return self


class Handshake(Model):
    """What a device said of itself, and how long each request took."""

    role: Literal["camera", "filter wheel", "laser", "lamp", "stage", "load cell"]
    driver: str = Field(description="name of the driver in the rig file")
    identity: DeviceIdentity | PressDevice | None
    durations_s: tuple[DurationS, ...]
    error: str | None = None


class WheelMove(Model):
    """One move; `arrived_slot` is read again after it."""

    from_slot: int | None
    to_slot: int
    arrived_slot: int | None
    duration_s: DurationS


class PictureShift(Model):
    """Shift between two pictures of the white tile, in pixels of the raw frame, with its standard uncertainty.

    Noise and differences between neighbouring cells are not counted as texture. Dust and stains wider than a cell are,
    and pull the shift to zero. Where what is left is too faint, `sd_px` is None and the shift says nothing.
    """

    row_px: float
    column_px: float
    sd_px: Annotated[float, Field(ge=0.0)] | None = Field(
        description=("standard uncertainty of row_px and of column_px; None: the picture has no texture")
    )


class Revisit(Model):
    """Relative change of the white signal between two frames, without and with a move away and back between them."""

    still_rel: float
    moved_rel: float
    still_px: PictureShift | None = Field(default=None, description="shift of the picture between the same two frames")
    moved_px: PictureShift | None = None


class DarkFrames(Model):
    """Dark frames of one exposure time, reduced to the region."""

    exposure_s: ExposureS
    means_dn: tuple[float, ...] = Field(min_length=2, description="mean count of each frame")
    noise_dn: SignalDn = Field(description="temporal standard deviation of a pixel, from differences of frames")
    at_zero_fraction: Fraction = Field(description="share of counts that are 0, where noise is cut off")
    pixels: Annotated[int, Field(ge=1)]


class ExposureLevel(Model):
    """White frames of one exposure time and dark frames of the same, reduced to the region."""

    exposure_s: ExposureS = Field(description="exposure as the camera reads it back")
    white_dn: tuple[float, ...] = Field(min_length=4)
    dark_dn: tuple[float, ...] = Field(min_length=4)


class WarmUp(Model):
    """The lamp after it was switched on, and the dark level before and after it was on."""

    filter_name: str
    times_s: tuple[DurationS, ...] = Field(description="middle of each exposure, after the lamp was confirmed on")
    white_dn: tuple[float, ...] = Field(description="mean of the region above the black level of the rig file")
    dark_before_dn: tuple[float, ...] = Field(min_length=4, description="mean of each dark frame")
    dark_after_dn: tuple[float, ...] = Field(min_length=4)


class BlockedLight(Model):
    """The white tile under the laser behind one filter; "dark" is the same with the laser off."""

    filter_name: str
    level: ExposureLevel


class StrayLight(Model):
    """Laser light on the white tile behind the filter that passes it, and behind those that block it."""

    passed: BlockedLight | None = None
    blocked: tuple[BlockedLight, ...] = ()
    missing: str | None = Field(default=None, description="why this cannot be observed on this rig")


class LatencyTry(Model):
    """One exposure during which the light was switched on; times after the request of the exposure."""

    on_earliest_s: float = Field(description="when the command to switch the light on was sent")
    on_latest_s: float = Field(description="when its controller had confirmed that it is on")
    lit_share: float = Field(description="signal relative to an exposure during which the light is on all the time")
    lit_share_sd: Annotated[float, Field(ge=0.0)]


class TriggerLatency(Model):
    """Exposures during which a light of the rig was switched on."""

    light: Literal["lamp"] = "lamp"
    exposure_s: ExposureS | None = None
    tries: tuple[LatencyTry, ...] = ()
    missing: str | None = Field(default=None, description="why it cannot be measured on this rig")


class LightOff(Model):
    """Mishaps that one safety layer of the laser had to meet.

    The laser went off between `earliest_s` and `latest_s` after each mishap. A mishap after which it was still on
    when the watch ended has no latest time and is counted in `still_on`.
    """

    layer: LightLayer
    missing: str | None = Field(default=None, description="why the layer does not exist or could not be watched")
    witness: Witness | None = None
    earliest_s: tuple[DurationS, ...] = ()
    latest_s: tuple[DurationS, ...] = ()
    still_on: Annotated[int, Field(ge=0)] = 0
    watched_s: DurationS = 0.0
    error: str | None = None


class DiodeLevels(Model):
    """What a photodiode read before the mishaps, of its full scale: beam closed by hand, laser off, laser on."""

    closed_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        description="mean level with the laser on and off while a person held the beam closed; None: nobody closed it"
    )
    closed_sd_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        description="standard deviation of one reading with the beam closed"
    )
    off_rel: Annotated[float, Field(ge=0.0)] = Field(description="mean with the laser off by its controller")
    on_rel: Annotated[float, Field(ge=0.0)] = Field(description="mean with the laser on")
    threshold_rel: Annotated[float, Field(ge=0.0)] = Field(description="readings below this level count as dark")
    readings: Annotated[int, Field(ge=1)] = Field(
        description="this many readings in a row below threshold_rel count as off"
    )
    sees_pulses: bool = Field(
        description="each reading covers all the time since the one before, so that no pulse is missed"
    )
    off_sd_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None, description="standard deviation of one reading with the laser off; None: not recorded"
    )
    on_again_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None, description="mean with the laser on when the beam was open again; None: nobody closed it"
    )
    reported_lit_closed: bool = Field(
        default=False,
        description="the controller reported the laser on before and after the reading with the beam closed",
    )


class SightLevels(Model):
    """What the camera saw of the laser before the mishaps: mean counts of the region at one exposure."""

    exposure_s: ExposureS
    on_dn: SignalDn = Field(description="behind the filter that passes the laser, with the laser on")
    off_dn: SignalDn = Field(description="behind that filter, with the laser off by its controller")
    off_sd_dn: Annotated[float, Field(ge=0.0)] = Field(description="standard deviation of such means")
    blocked_filter: str | None = Field(description="a filter that blocks the laser; None: there is none")
    blocked_on_dn: SignalDn | None = Field(description="behind the filter that blocks the laser, with the laser on")
    blocked_off_dn: SignalDn | None = Field(description="behind the filter that blocks the laser, with the laser off")
    threshold_dn: SignalDn = Field(description="frames below this mean count as dark")


class CheckFacts(Model):
    """What the devices did, without judgement; only the filters are judged here, because that needs the frames."""

    handshakes: tuple[Handshake, ...] = ()
    moves: tuple[WheelMove, ...] = ()
    darks: tuple[DarkFrames, ...] = ()
    filter_proof: FilterProof | None = None
    revisit_filter: str | None = None
    revisits: tuple[Revisit, ...] = ()
    levels: tuple[ExposureLevel, ...] = ()
    white_span_s: DurationS = Field(
        default=0.0, description="time from the first to the last white frame of the levels"
    )
    frame_overheads_s: tuple[DurationS, ...] = Field(
        default=(), description="time that each frame of the levels took beyond its exposure"
    )
    warm_up: WarmUp | None = None
    stray_light: StrayLight | None = None
    latency: TriggerLatency | None = None
    reconnect_s: DurationS | None = Field(
        default=None,
        description="time from closing all devices until the last of them answered after it was opened again",
    )
    reconnected: tuple[DeviceIdentity, ...] = Field(
        default=(), description="identities that the devices reported after they were opened again"
    )
    light_off: tuple[LightOff, ...] = ()
    diode: DiodeLevels | None = Field(
        default=None, description="what the photodiode recorded to confirm that the laser is off; None: there was none"
    )
    sight: SightLevels | None = Field(
        default=None,
        description="what the camera recorded to confirm that the laser is off; None: it was not used for this",
    )
    errors: dict[Section, str] = Field(default={}, description="the error that ended a section early, by section")


class CellAtRest(Model):
    """Readings of the load cell while nothing touches it."""

    readings: Annotated[int, Field(ge=2)]
    span_s: DurationS = Field(description="time from the first to the last reading")
    longest_gap_s: DurationS = Field(description="longest time between two readings")
    noise_n: UncertaintyN = Field(description="standard deviation of one reading within a twelfth of the time")
    means_n: tuple[float, ...] = Field(
        min_length=5,
        description="mean reading in each twelfth of the time, minus that of the empty cell at its calibration",
    )
    jumps: Annotated[int, Field(ge=0)] = Field(
        default=0, description="readings far beyond the noise of their neighbours, which are left out: a bit was lost"
    )


class LaidMass(Model):
    """A known mass on the load cell, by its calibration; empty before, between and after."""

    forces_n: tuple[float, ...] = Field(
        min_length=2, description="mean reading with the mass on the cell, minus that without force"
    )
    zeros_n: tuple[float, ...] = Field(
        min_length=3, description="mean reading of the empty cell, minus that of the empty cell at its calibration"
    )
    noise_n: UncertaintyN = Field(description="standard uncertainty of each mean by noise")


class BlockTouches(Model):
    """Touches of the pad, and of a block that lies on it, at one position along the pad."""

    pad_mm: tuple[float, ...] = Field(min_length=2, description="position of the press axis at each touch of the pad")
    block_mm: tuple[float, ...] = Field(min_length=2, description="the same on the block")
    touch_uncertainty_mm: UncertaintyMm = Field(description="largest standard uncertainty of a touch")


class StageMoves(Model):
    """All moves of one axis that ended where they should, by what the controller reports."""

    axis: str
    moves: Annotated[int, Field(ge=1)]
    longest_overhead_s: DurationS = Field(description="longest time of a move beyond distance / speed")
    furthest_off_mm: Annotated[float, Field(ge=0.0)] = Field(
        description="largest distance of the reported position from the one that was asked for"
    )


class CheckedTouch(Model):
    """One return to the position along the pad, and the press there: all positions are commands, all forces felt."""

    side: Literal["base", "tip"] = Field(description="side from which the stage returned to the position along the pad")
    touch_mm: float = Field(description="position of the press axis at which the pad is touched")
    touch_uncertainty_mm: UncertaintyMm
    from_above_n: float = Field(description="settled force at the turning position, reached by a move into the pad")
    from_below_n: float = Field(description="settled force at the same position, reached by a move out of the pad")
    deeper_n: float = Field(description="settled force one step deeper")
    deeper_mm: Annotated[float, Field(gt=0.0)] = Field(description="length of that step")
    noise_n: UncertaintyN = Field(description="standard uncertainty of each force by noise")
    relaxed_n: float = Field(description="loss of force at the turning position while the stage was at rest")
    zero_shift_n: float = Field(description="zero after the press minus that before")


class StageStop(Model):
    """One move away from the pad that was stopped on its way."""

    reason: Literal["request", "silent cell"]
    stood_after_s: DurationS = Field(
        description="time from the request, or from the last reading, until the stage was seen at rest"
    )
    start_mm: float
    end_mm: float = Field(description="where the move would have ended")
    stood_mm: float | None = Field(description="position at rest that it reported; None: its position was unknown then")
    still_after_s: DurationS | None = Field(
        default=None,
        description="time until the cell's force showed no more motion; None: it could not be measured, or was not "
        "requested",
    )
    still_sd_s: DurationS | None = Field(default=None, description="standard uncertainty of that time")
    unseen_creep_rel: Annotated[float, Field(ge=0.0)] | None = Field(
        default=None,
        description="speed at which the stage could creep without the cell noticing, relative to the speed of the "
        "move; None: not known",
    )


class MovingStop(Model):
    """One slow move towards the pad that a force limit stopped, through depths that steps had measured before."""

    limit_n: ForceN
    way_mm: Annotated[float, Field(gt=0.0)] = Field(description="length of the move, had it not been stopped")
    unstopped_n: float = Field(description="settled force at the end of the move, as reached in steps before")
    peak_n: float = Field(description="largest force that the cell reported until the stage was at rest, and after")
    stopped_at_n: float | None = Field(
        default=None,
        description="first reading beyond the limit, which stopped the move; None: no reading was beyond it",
    )
    end_mm: float | None = Field(default=None, description="where the move would have ended; None: not recorded")
    stood_mm: float | None = Field(
        default=None, description="position of the press axis once it was at rest; None: it was unknown"
    )


class ForceStop(Model):
    """One press that a force limit ended."""

    limit_n: ForceN
    peak_n: float = Field(
        description="largest force that the cell reported until the stage was at rest, and after that"
    )
    noise_n: UncertaintyN = Field(description="standard deviation of one reading")
    stiffness_n_per_mm: Annotated[float, Field(gt=0.0)] = Field(
        description="stiffness in the last step before the stop"
    )
    step_mm: Annotated[float, Field(gt=0.0)] = Field(description="longest step towards the pad")
    moving: MovingStop | None = Field(
        default=None, description="a stop in the middle of a later move; None: there was no room for such a move"
    )


class PressFacts(Model):
    """What stage, load cell and camera of a rig that presses did, without judgement."""

    handshakes: tuple[Handshake, ...] = ()
    frame_overheads_s: tuple[DurationS, ...] = ()
    calibration: LoadCellCalibration | None = None
    calibration_age_days: float | None = Field(
        default=None, description="age of the calibration on the day of the check"
    )
    at_rest: CellAtRest | None = None
    laid: LaidMass | None = None
    block: BlockTouches | None = None
    moves: tuple[StageMoves, ...] = ()
    touches: tuple[CheckedTouch, ...] = ()
    dents_px: tuple[float, ...] = Field(
        default=(),
        description="column of the contact in the camera's picture, alternately towards base and tip; empty: not seen",
    )
    stops: tuple[StageStop, ...] = ()
    after_stops: tuple[CheckedTouch, ...] = Field(default=(), description="touches after all stops")
    force_stops: tuple[ForceStop, ...] = ()
    reconnect_s: DurationS | None = Field(
        default=None,
        description="time from closing all devices until the last of them answered after it was opened again",
    )
    reconnected: tuple[DeviceIdentity | PressDevice, ...] = Field(
        default=(), description="identities that the devices reported after they were opened again"
    )
    errors: dict[Section, str] = Field(default={}, description="the error that ended a section early, by section")


class CheckResult(Model):
    """One check: the value with its standard uncertainty against the limit."""

    section: Section
    name: str
    what: str
    value: float | None = Field(description="None where nothing was measured, or the result is not a number")
    unit: str
    sd: Annotated[float, Field(ge=0.0)] | None = Field(description="standard uncertainty of the value, in its unit")
    low: float | None = Field(description="lowest allowed value; None where there is none")
    high: float | None = Field(description="highest allowed value; None where there is none")
    limit: str = Field(description="what is allowed, in words")
    p_conform: Fraction | None = Field(
        default=None,
        description="probability that the quantity lies within its limits (JCGM 106); None without a number",
    )
    verdict: CheckVerdict
    evidence: str


class AcceptanceReport(Record):
    """The outcome of an acceptance check of a rig: one result for each check, and the facts they follow from."""

    schema_version: ClassVar[int] = 12
    written_by: ClassVar[str] = "'finray check run'"
    plan: CheckPlan | TactileCheckPlan = Field(discriminator="kind")
    rig: RigFile | TactileRig
    facts: CheckFacts | PressFacts
    results: tuple[CheckResult, ...]
    verdict: CheckVerdict = Field(
        description="the worst verdict of the checks: FAIL, else ERROR, else UNDECIDED, else PASS"
    )
    notes: tuple[str, ...] = ()
