"""The presses and the frames of a tactile session, in the order in which they are captured."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from data_schemas.devices import CameraSettings
from data_schemas.errors import CaptureError, RecordError
from data_schemas.faults import explain
from data_schemas.foreign_files import finite_number, read_csv
from data_schemas.tactile import PlannedPress, TactileFrameType, TactilePlan

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
            f"{path}: holds {len(rows)} poses; give 1 to {MOST_PRESSES} rows below the header "
            f"{','.join(PlannedPress.model_fields)}"
        )
    return tuple(_pose(path, line, header, cells) for line, cells in rows)


def _pose(path: Path, line: int, header: list[str], cells: list[str]) -> PlannedPress:
    """Read one row; an empty cell is a value that is not given."""
    if len(cells) != len(header):
        raise RecordError(f"{path}, line {line}: has another number of columns than the header")
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
        raise CaptureError(f"plan.bracket_powers: none of its exposures is within {allowed}, which the rig allows")
    outside = [t for t in exposures_s if not camera.shortest_exposure_s <= t <= camera.longest_exposure_s]
    if outside:
        raise CaptureError(f"plan.exposures_s: {outside[0]:g} s is out of range; the rig allows {allowed}")
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
                f"Lay the ChArUco board flat where the coat of the pad is, printed face to the camera; place 1 of "
                f"{plan.board.images}."
            )
        return (
            f"Hold the ChArUco board in view, still; place {shot.place} of {plan.board.images}, each turned and tilted "
            "otherwise."
        )
    if shot.frame_type == "no contact":
        if shot.place == 0:
            return f"Set the blue LEDs to {plan.led_current_ma:g} mA and see that nothing touches the pad."
        return "Take the indenter away from the pad."
    press, indenter = presses[press_of(shot.place, plan.repeats)], plan.indenter
    tilted = f", tilted by {press.tilt_deg:g} deg" if press.tilt_deg else ""
    return (
        f"Press {shot.place} of {len(presses) * plan.repeats}: {indenter.shape} of radius {indenter.radius_mm:g} mm, "
        f"{press.depth_mm:g} mm deep at {press.position_mm:g} mm along the pad{tilted}. Hold it there."
    )
