"""From the frames of a tactile session to the tactile capture of each contact."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import CaptureError, RecordError
from data_schemas.frame_files import read_frame
from data_schemas.tactile import PlannedPress, TactileFrame, TactilePlan, TactileRig
from rigs.capture.tactile_plan import press_of

Triple = tuple[TactileFrame, TactileFrame, TactileFrame]
MOST_SATURATED_FRACTION = 1e-3
"""A glint may saturate; a larger clipped part hides the press."""


def capture_file(contact: int) -> str:
    """Return the name of the record of a contact (from 1)."""
    return f"press-{contact:03d}.json"


def tactile_capture(
    folder: Path,
    plan: TactilePlan,
    rig: TactileRig,
    press: PlannedPress,
    contact: int,
    frames: Sequence[TactileFrame],
) -> TactileCapture:
    """Return the images of one contact: those of the longest exposure at which hardly anything saturates.

    The no-contact image is the last one before, its repeat the first one after the contact.

    Parameters
    ----------
    folder
        Folder of the session.
    plan, rig, press
        What was captured with what.
    contact
        Number of the contact, from 1.
    frames
        All frames of the session.

    Raises
    ------
    CaptureError
        A frame of the contact is missing.
    ChecksumError
        A frame was changed.
    """
    triples = _triples(frames, contact)
    bracket_s = tuple(sorted(triples))
    if not bracket_s:
        raise CaptureError(f"{folder}: holds no whole set of frames of contact {contact}; capture it again")
    shown, before, after = _best(triples)
    images = [_image(folder, frame) for frame in (shown, before, after)]
    raw = images[0].shape[2] == 1
    read_black_dn = shown.settings.get("black_level_dn", rig.camera.black_level_dn)
    return TactileCapture(
        name=f"{plan.name}, press {press_of(contact, plan.repeats) + 1}, contact {contact}",
        contact=images[0],
        no_contact=images[1],
        repeat_no_contact=images[2],
        layout="Bayer RGGB" if raw else "RGB",
        encoding="linear" if raw else "unknown",
        bit_depth=rig.camera.bit_depth,
        black_level_dn=float(read_black_dn) if raw else 0.0,
        exposure_s=shown.exposure_s,
        light_angle_deg=plan.light_angle_deg,
        light_angle_uncertainty_deg=plan.light_angle_uncertainty_deg,
        led_current_ma=plan.led_current_ma,
        exposure_bracket_s=bracket_s if len(bracket_s) > 1 else (),
        indenter=press.pose(plan.indenter),
        contact_circle=None,
        mm_per_px=plan.mm_per_px,
        mm_per_px_u_rel=plan.mm_per_px_u_rel,
        rig=f"{rig.name}, {rig.camera.driver} {rig.camera.address}, {plan.design}",
        source=f"tactile session '{folder.resolve().name}', {plan.design}, camera {rig.camera.driver}, frame "
        f"{shown.sequence} at {shown.captured_utc}",
    )


def clipping_notes(frames: Sequence[TactileFrame], contacts: int) -> tuple[str, ...]:
    """Name the contacts that are clipped even at the shortest exposure of the session."""
    notes = []
    for contact in range(1, contacts + 1):
        clipped = max(frame.saturated_fraction for frame in _best(_triples(frames, contact)))
        if clipped > MOST_SATURATED_FRACTION:
            notes.append(
                f"contact {contact}: {100 * clipped:.1f} % of an image is clipped at the shortest exposure; "
                "comparisons leave these pixels out: add shorter exposures, or dim the LEDs"
            )
    return tuple(notes)


def _best(triples: dict[float, Triple]) -> Triple:
    """Return the images of the longest exposure at which hardly anything saturates, else of the shortest one."""
    good = [
        asked_s
        for asked_s, images in triples.items()
        if max(frame.saturated_fraction for frame in images) <= MOST_SATURATED_FRACTION
    ]
    return triples[max(good) if good else min(triples)]


def _triples(frames: Sequence[TactileFrame], contact: int) -> dict[float, Triple]:
    """Return contact, no contact before and no contact after for each exposure that was asked for."""

    def of(frame_type: str, place: int) -> dict[float, list[TactileFrame]]:
        found: dict[float, list[TactileFrame]] = {}
        for frame in frames:
            if (frame.frame_type, frame.place) == (frame_type, place):
                found.setdefault(frame.exposure_requested_s, []).append(frame)
        return found

    shown, before, after = of("contact", contact), of("no contact", contact - 1), of("no contact", contact)
    return {t: (shown[t][0], before[t][-1], after[t][0]) for t in shown.keys() & before.keys() & after.keys()}


def _image(folder: Path, frame: TactileFrame) -> NDArray[np.uint16]:
    """Return a stored frame as (rows, columns, samples)."""
    path = folder / frame.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError(f"{path}: leads out of the session's folder; frames must be plain files inside it")
    image = read_frame(path, frame.sha256)
    return image[..., None] if image.ndim == 2 else image
