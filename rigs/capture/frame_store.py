"""Taking and storing the frames of a session, with what the devices read back."""

import re
from pathlib import Path

from data_schemas.capture import Frame, RegionOfInterest
from data_schemas.rig import RigFile
from data_schemas.storage import write_frame
from rigs.capture.exchange import expose_checked
from rigs.capture.exposure import saturated_fraction
from rigs.capture.journal import Journal
from rigs.capture.laser_dose import LaserDose
from rigs.capture.plan import Step
from rigs.open_rig import OpenRig


class FrameStore:
    """Takes the frames of one session and stores them with what the devices read back.

    Parameters
    ----------
    opened, rig
        The rig, as opened devices and as its file describes it.
    region
        Where saturation counts.
    out, journal
        The session's folder and journal.
    """

    def __init__(self, opened: OpenRig, rig: RigFile, region: RegionOfInterest, out: Path, journal: Journal):
        self._opened, self._camera, self._out, self._journal = opened, rig.camera, out, journal
        self.region = (
            slice(region.row_px, region.row_px + region.height_px),
            slice(region.column_px, region.column_px + region.width_px),
        )
        self.full_scale_dn = 2**rig.camera.bit_depth - 1
        self.dose = LaserDose(rig.laser.power_mw, opened.clock)
        self.frames: list[Frame] = []

    def take(self, step: Step, exposure_s: float) -> None:
        """Take one frame, write it and note it in the journal."""
        checked = expose_checked(self._opened, self._camera, step, exposure_s)
        number, raw = len(self.frames), checked.raw
        middle_ago_s = 0.5 * raw.exposure_s
        file = _frame_file(number, step, raw.exposure_s)
        frame = Frame(
            sequence=number,
            file=file,
            frame_type=step.frame_type,
            target=step.target,
            light=step.light,
            filter_name=step.filter_name,
            slot_before=checked.slot_before,
            slot_after=checked.slot_after,
            exposure_requested_s=raw.exposure_requested_s,
            exposure_s=raw.exposure_s,
            captured_utc=raw.captured_utc,
            middle_s=max(self._opened.clock.monotonic_s() - middle_ago_s, 0.0),
            laser_dose_j=self.dose.energy_j(middle_ago_s),
            tilt_deg=step.tilt_deg,
            saturated_fraction=saturated_fraction(raw.counts[self.region], self.full_scale_dn),
            sha256=write_frame(self._out / file, raw.counts, f"{step.label}, {raw.exposure_s:g} s"),
        )
        self.frames.append(frame)
        self._journal.append("frame", **frame.model_dump())


def _frame_file(number: int, step: Step, exposure_s: float) -> str:
    """Return ``frames/NNNN_<type>_<filter>_<exposure>us.tiff`` with plain characters only."""
    words = (step.frame_type, step.filter_name or "none")
    kind, filter_name = (re.sub(r"[^A-Za-z0-9.-]+", "-", word) for word in words)
    return f"frames/{number:04d}_{kind}_{filter_name}_{round(exposure_s * 1e6)}us.tiff"
