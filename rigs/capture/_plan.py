"""The steps of a session, of paint or of a finger, in the order in which they are captured."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from data_schemas import (
    BandPassFilter,
    CameraSettings,
    CaptureError,
    FrameType,
    LightState,
    PaintPlan,
    PlannedPress,
    RecordError,
    RegionOfInterest,
    RigFile,
    TactileFrameType,
    TactilePlan,
    Target,
    explain,
)
from data_schemas.storage import finite_number, read_csv

SMALLEST_REGION_PX = 2


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to photograph: target, light and filter (None without filter: the wheel is swung out)."""

    frame_type: FrameType
    target: Target
    light: LightState
    filter_name: str | None
    slot: int | None
    tilt_deg: float = 0.0

    @property
    def label(self) -> str:
        """The step in words."""
        behind = f"through filter {self.filter_name}" if self.filter_name is not None else "without filter"
        tilted = f" tilted by {self.tilt_deg:g} deg" if self.tilt_deg else ""
        return f"{self.frame_type} ({self.target}{tilted}, {self.light}) {behind}"


def paint_steps(plan: PaintPlan, rig: RigFile) -> tuple[Step, ...]:
    """List the steps of a paint session after checking the plan against the rig.

    White under the lamp (all filters) and the laser (excitation filter), sample beside ColorChecker under room
    light, sample under the lamp and the laser (all filters), the tilted sample under the laser (two filters) when
    the plan asks for it. The ColorChecker stands between white and sample because metering runs through the steps
    backwards and dark frames need a closed box: then the operator swaps the target four times only, and the dark
    frames before and after see no room light. See :func:`with_repeat` for the order of the laser steps.

    Raises
    ------
    CaptureError
        The paint has no name, a filter is unknown, the excitation filter does not pass the laser line or is not in the
        plan, the region is empty or leaves the frame.
    """
    require_named("plan.paint_name", plan.paint_name)
    filters = planned_filters(plan.filters, rig)
    excitation = _excitation_filter(plan, rig, filters)
    require_region_inside(plan.region, rig.camera)
    metering_room_dn(plan.target_fraction, 2**rig.camera.bit_depth - 1, rig.camera.black_level_dn)
    return (
        *(Step("white", "white", "lamp", f.name, f.slot) for f in filters),
        Step("laser white", "white", "laser", excitation.name, excitation.slot),
        Step("room light", "sample beside ColorChecker", "room", None, None),
        *(Step("reflectance", "sample", "lamp", f.name, f.slot) for f in filters),
        *(Step("fluorescence", "sample", "laser", f.name, f.slot) for f in filters),
        *_tilted_steps(plan, filters),
    )


def require_named(field: str, name: str) -> None:
    """Refuse an empty name of what is captured: files and records are named after it."""
    if not name.strip():
        raise CaptureError(f"{field}: is empty; give a name, which files and records will carry")


def with_repeat(steps: tuple[Step, ...], excitation_filter: str, exposures_s: Mapping[Step, float]) -> tuple[Step, ...]:
    """Put the brightest emission first among the laser steps on the sample, and add it again as the last of them.

    What the paint loses between the two is bleaching. The brightest is the one with the shortest metered exposure
    behind a filter that blocks the laser. A session without such a filter stays as it is.

    Parameters
    ----------
    steps
        The steps of a session.
    excitation_filter
        Name of the filter that passes the laser.
    exposures_s
        Metered exposure (s) of every step.
    """
    laser = [step for step in steps if step.frame_type == "fluorescence"]
    emission = [step for step in laser if step.filter_name != excitation_filter]
    if not emission:
        return steps
    first = min(emission, key=lambda step: exposures_s[step])
    start = steps.index(laser[0])
    ordered = (first, *(s for s in laser if s != first), replace(first, frame_type="fluorescence repeat"))
    return (*steps[:start], *ordered, *steps[start + len(laser) :])


def _tilted_steps(plan: PaintPlan, filters: list[BandPassFilter]) -> tuple[Step, ...]:
    """Return the steps of the tilted sample under the laser."""
    if plan.second_tilt_deg is None or plan.second_tilt_filters is None:
        return ()
    known = {f.name: f for f in filters}
    lost = [name for name in plan.second_tilt_filters if name not in known]
    if lost:
        raise CaptureError(
            f"plan.second_tilt_filters: '{lost[0]}' is not among the filters of the plan ({', '.join(known)})"
        )
    return tuple(
        Step("tilted fluorescence", "sample", "laser", name, known[name].slot, plan.second_tilt_deg)
        for name in plan.second_tilt_filters
    )


def planned_filters(names: tuple[str, ...] | None, rig: RigFile) -> list[BandPassFilter]:
    """Return the filters of a plan in its order; None names all of the rig.

    Raises
    ------
    CaptureError
        The plan names none, or one that the rig does not have.
    """
    known = {f.name: f for f in rig.filter_wheel.filters}
    names = tuple(known) if names is None else names
    if not names:
        raise CaptureError(
            "plan.filters: is empty; name at least one filter, or leave plan.filters out to use all filters of the rig"
        )
    for name in names:
        if name not in known:
            raise CaptureError(f"plan.filters: the rig has no filter '{name}'; its filters are {', '.join(known)}")
    return [known[name] for name in names]


def _excitation_filter(plan: PaintPlan, rig: RigFile, filters: list[BandPassFilter]) -> BandPassFilter:
    """Return the filter that passes the laser line."""
    chosen = next((f for f in filters if f.name == plan.excitation_filter), None)
    if chosen is None:
        raise CaptureError(
            f"plan.excitation_filter: '{plan.excitation_filter}' is not among the filters of the plan "
            f"({', '.join(f.name for f in filters)})"
        )
    off_nm = abs(chosen.center_nm - rig.laser.wavelength_nm)
    if off_nm > 0.5 * chosen.fwhm_nm:
        raise CaptureError(
            f"plan.excitation_filter: filter '{chosen.name}' passes {chosen.center_nm - 0.5 * chosen.fwhm_nm:g} to "
            f"{chosen.center_nm + 0.5 * chosen.fwhm_nm:g} nm, so it blocks the laser at {rig.laser.wavelength_nm:g} "
            "nm; name the filter that passes the laser"
        )
    return chosen


def metering_room_dn(target_fraction: float, full_scale_dn: int, black_level_dn: float) -> float:
    """Return the counts of light (DN) that metering aims at: what the target leaves above the black level.

    Raises
    ------
    CaptureError
        The black level alone reaches the target.
    """
    room_dn = target_fraction * full_scale_dn - black_level_dn
    if room_dn <= 0.0:
        raise CaptureError(
            f"camera.black_level_dn = {black_level_dn:g} DN must be below target_fraction = {target_fraction:g} of "
            f"full scale ({full_scale_dn} DN), else no exposure can be metered; correct black_level_dn in the rig "
            "file, or raise target_fraction in the plan"
        )
    return room_dn


def require_region_inside(region: RegionOfInterest, camera: CameraSettings) -> None:
    """Refuse a region that is empty or leaves the frame.

    Raises
    ------
    CaptureError
        It is or does.
    """
    for axis, extent, start, size, limit in (
        ("row_px", "height_px", region.row_px, region.height_px, camera.height_px),
        ("column_px", "width_px", region.column_px, region.width_px, camera.width_px),
    ):
        if size < SMALLEST_REGION_PX:
            raise CaptureError(
                f"plan.region.{extent}: {size} px is too small; {SMALLEST_REGION_PX} to {limit} px are allowed"
            )
        if start + size > limit:
            raise CaptureError(
                f"plan.region: {axis} = {start} with {extent} = {size} ends at pixel {start + size}, outside the "
                f"frame; {axis} + {extent} may be at most {limit} px"
            )


MOST_PRESSES = 10_000


@dataclass(frozen=True, slots=True)
class TactileShot:
    """One frame to take; frames of the same type and place are taken without the operator's hands between."""

    sequence: int
    frame_type: TactileFrameType
    place: int
    exposure_s: float

    @property
    def group(self) -> tuple[str, int]:
        """What must be done by hand before it: type and place."""
        return self.frame_type, self.place

    @property
    def label(self) -> str:
        """The frame in words."""
        return f"{self.frame_type} {self.place}, {self.exposure_s:.3g} s"


def planned_presses(plan: TactilePlan, folder: Path) -> tuple[PlannedPress, ...]:
    """Return the presses of a plan, from its own tables or from its file of poses.

    Parameters
    ----------
    plan
        The plan.
    folder
        Where its relative paths start.

    Raises
    ------
    RecordError
        The file of poses is missing, is no CSV, or a pose is incomplete or out of range.
    """
    if plan.poses_csv is None:
        return plan.presses
    path = folder / plan.poses_csv
    header, rows = read_csv(path, "the poses that poses_csv of the plan names, relative to the plan", RecordError)
    if not 0 < len(rows) <= MOST_PRESSES:
        raise RecordError(
            f"{path}: contains {len(rows)} poses, but must contain 1 to {MOST_PRESSES} rows below the header "
            f"{','.join(PlannedPress.model_fields)}"
        )
    return tuple(_pose(path, line, header, cells) for line, cells in rows)


def _pose(path: Path, line: int, header: list[str], cells: list[str]) -> PlannedPress:
    """Read one row; an empty cell is a value that is not given."""
    if len(cells) != len(header):
        raise RecordError(f"{path}, line {line}: has {len(cells)} columns, but the header has {len(header)}")
    texts = {name: cell.strip() for name, cell in zip(header, cells, strict=True) if cell.strip()}
    try:
        return PlannedPress.model_validate({name: _value(text) for name, text in texts.items()})
    except ValidationError as error:
        raise RecordError(f"{path}, line {line}: {explain(error, PlannedPress)}") from None


def _value(text: str) -> float | str:
    """Return a cell as a number, where it is one."""
    try:
        return finite_number(text)
    except ValueError:
        return text


def tactile_shots(plan: TactilePlan, camera: CameraSettings, presses: int) -> tuple[TactileShot, ...]:
    """List the frames of a session: board, no contact, then for each contact its images and those of no contact.

    Every image is taken at every exposure, shortest first.

    Parameters
    ----------
    plan, camera
        The plan and the camera of the rig.
    presses
        How many presses there are; each is repeated ``plan.repeats`` times.

    Raises
    ------
    CaptureError
        An exposure is out of the camera's range.
    """
    exposures_s = plan.bracket_s(camera)
    allowed = f"{camera.shortest_exposure_s:g} to {camera.longest_exposure_s:g} s"
    if not exposures_s:
        raise CaptureError(
            f"plan.bracket_powers: none of the exposures is within the rig's range of {allowed}; change the powers"
        )
    outside = [t for t in exposures_s if not camera.shortest_exposure_s <= t <= camera.longest_exposure_s]
    if outside:
        raise CaptureError(
            f"plan.exposures_s: {outside[0]:g} s is outside the rig's range of {allowed}; correct the exposure"
        )
    groups: list[tuple[TactileFrameType, int, int]] = []
    if plan.board is not None:
        groups += [("board", place, 1) for place in range(1, plan.board.images + 1)]
    groups.append(("no contact", 0, plan.no_contact_images))
    for contact in range(1, presses * plan.repeats + 1):
        groups += [("contact", contact, 1), ("no contact", contact, plan.no_contact_images)]
    wanted = [(kind, place, t) for kind, place, times in groups for _ in range(times) for t in exposures_s]
    return tuple(TactileShot(number, *what) for number, what in enumerate(wanted))


def press_of(contact: int, repeats: int) -> int:
    """Return the index (from 0) of the press that a contact (from 1) belongs to."""
    return (contact - 1) // repeats


def instruction(shot: TactileShot, plan: TactilePlan, presses: tuple[PlannedPress, ...]) -> str:
    """Return what the operator must do before a group of frames."""
    if shot.frame_type == "board" and plan.board is not None:
        if plan.board.on_pad and shot.place == 1:
            return (
                "Lay the ChArUco board flat where the coat of the pad is, with its printed face to the camera (place "
                f"1 of {plan.board.images})."
            )
        return (
            f"Hold the ChArUco board still and in view (place {shot.place} of {plan.board.images}); turn and tilt it "
            "differently at each place."
        )
    if shot.frame_type == "no contact":
        if shot.place == 0:
            return f"Set the blue LEDs to {plan.led_current_ma:g} mA and make sure that nothing touches the pad."
        return "Take the indenter away from the pad."
    press, indenter = presses[press_of(shot.place, plan.repeats)], plan.indenter
    tilted = f", tilted by {press.tilt_deg:g} deg" if press.tilt_deg else ""
    return (
        f"Press {shot.place} of {len(presses) * plan.repeats}: {indenter.shape} of radius {indenter.radius_mm:g} mm, "
        f"{press.depth_mm:g} mm deep at {press.position_mm:g} mm along the pad{tilted}. Hold it there."
    )
