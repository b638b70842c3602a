"""Taking and storing the frames of a session, with what the devices read back and the laser light that fell.

Fluorescent paint bleaches with laser light: every frame tells the energy on the sample up to it.
"""

import math
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraSettings, CaptureError, Frame, RegionOfInterest, RigFile, SignalChangedError
from data_schemas.storage import write_frame
from rigs import Clock, OpenRig, RawFrame
from rigs.capture._exposure import CheckedCamera, CheckedFrame, saturated_fraction
from rigs.capture._filter_proof import LEAST_SIGNAL_FRACTION
from rigs.capture._journal import DISK_WITHIN_S, Journal, disk_hangs, not_written
from rigs.capture._plan import Step
from rigs.capture._resume import PROVEN_EVENT, Interrupted, is_compared, set_aside
from rigs.capture._session_folder import SessionWatch

BYTES_PER_PIXEL = 2
DARK_SHARE = 1e-3  # of full scale: by as much the black level of a rig file is off, and drifts in a session
SPACE_FACTOR = 1.1  # of the frames: room for TIFF headers, journal and record
MOST_WAITING = 4  # frames in memory that are not on the disk yet
LARGEST_CHANGE = 1.25
"""Factor by which the signal of a step may differ from its metering; lamps warm up by less, filters differ by more."""
SAME_SHARE = 0.05
"""By which a light differs that was put right: less than the change that ends a session, more than a warm lamp's."""
WRITE_WITHIN_S = 2.0 * DISK_WITHIN_S  # a frame, then its line of the journal


LINE_WIDTHS: Final = 2.0
"""Widths (FWHM) of a filter from its centre within which the laser's line may be seen through it."""
SAME_EXPOSURE_REL: Final = 1e-3
SAME_RATIO_REL: Final = 0.005
"""By which a ratio of two channels may change at one exposure. A filter's centre moves with temperature by 0.02 nm/K,
and 0.08 nm moved a ratio by more than 0.2 %; light that dims by 5 % on a response curved by 1 % moves it by less."""
MOST_CLIPPED: Final = 1e-4
"""Of the region: so many hot pixels, even if all were red, lift the mean of red by less than DARK_SHARE."""
LINEARITY_REL: Final = 0.01
"""The same at another exposure: by so much a check of the rig lets a camera's response be curved."""
COLOUR_SD: Final = 5.0
"""Standard deviations by noise: 300 ratios of a session are beyond it by chance once in 5,000 sessions."""
LEAST_WANDER_DN = 0.25  # rounding hides a dim channel's mean by so much

Rates = tuple[float, float, float]


class Metered(NamedTuple):
    """The rates (DN/s) that a step's metering found, and the exposure (s) that they come from."""

    rates: Rates
    exposure_s: float


def colour_change(now: Metered, before: Metered, camera: CameraSettings, pixels: int) -> tuple[float, float]:
    r"""Return by how much the ratio of two channels changed, relative to what is allowed the most, and what is allowed.

    .. math:: y = |\ln(r_a / m_a) - \ln(r_b / m_b)|, \quad
              y_\text{max} = y_0 + \sum_{c = a, b} \frac{d_c}{m_c}
              + 5 \sqrt{\sum_{c = a, b} \frac{u^2(r_c)}{r_c^2} + \frac{u^2(m_c)}{m_c^2}}

    with the rates r now and m at metering, their photon and read noise u, what the dark level may be off d, and
    linearity y0. A channel that is not above all of that is left out.

    Parameters
    ----------
    now, before
        Rates of red, green and blue, and their exposures.
    camera
        Gain, read noise and full scale.
    pixels
        Of the region: a quarter of them are red, half green, a quarter blue.

    Returns
    -------
    tuple of float
        Change and what is allowed, relative (1).
    """
    full_dn = 2**camera.bit_depth - 1
    wander_dn = max(DARK_SHARE * full_dn, LEAST_WANDER_DN)
    level = DARK_SHARE * full_dn * abs(1.0 / now.exposure_s - 1.0 / before.exposure_s)
    dark = level + wander_dn / min(now.exposure_s, before.exposure_s)
    is_same = abs(now.exposure_s / before.exposure_s - 1.0) <= SAME_EXPOSURE_REL
    channels: list[tuple[float, float, float]] = []
    for share, rate, rate_before in zip((0.25, 0.5, 0.25), now.rates, before.rates, strict=True):
        variance = sum(
            (max(r * t, 0.0) / camera.gain_e_per_dn + (camera.read_noise_e / camera.gain_e_per_dn) ** 2 + 1 / 12)
            / (share * pixels * max(r * t, 1e-9) ** 2)
            for r, t in ((rate, now.exposure_s), (rate_before, before.exposure_s))
        )
        if min(rate, rate_before) > dark and COLOUR_SD * math.sqrt(variance) < 1.0:
            channels.append((math.log(rate / rate_before), dark / min(rate, rate_before), variance))
    worst = (0.0, math.inf)
    for (a, dark_a, var_a), (b, dark_b, var_b) in combinations(channels, 2):
        allowed = (SAME_RATIO_REL if is_same else LINEARITY_REL) + dark_a + dark_b
        allowed += COLOUR_SD * math.sqrt(var_a + var_b)
        if abs(a - b) / allowed >= worst[0] / worst[1]:
            worst = abs(a - b), allowed
    return worst


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame to take; its number in the session is known beforehand, so that a resumed session finds it."""

    sequence: int
    step: Step
    exposure_s: float


def numbered(wanted: Iterable[tuple[Step, float]], first: int = 0) -> list[Shot]:
    """Return steps and exposures (s) as shots, counted from `first`."""
    return [Shot(number, step, exposure_s) for number, (step, exposure_s) in enumerate(wanted, first)]


class FrameStore:
    """Takes the frames of one session and stores them with what the devices read back; a ``with`` block.

    A frame is written and hashed while the wheel moves on to the next filter; the block ends when all are on disk.

    Parameters
    ----------
    opened, rig
        The rig, as opened devices and as its file describes it.
    region
        Where saturation counts.
    out, journal
        The session's folder and journal.
    interrupted
        What is done already, when a session is resumed; its frames are not taken again.
    watch
        Sees every frame that is accepted.
    """

    def __init__(
        self,
        opened: OpenRig,
        rig: RigFile,
        region: RegionOfInterest,
        out: Path,
        journal: Journal,
        interrupted: Interrupted | None = None,
        watch: SessionWatch | None = None,
    ):
        self._opened, self._out, self._journal = opened, out, journal
        seen = SessionWatch() if watch is None else watch
        self.camera = CheckedCamera(opened, rig.camera, lambda text: journal.append("refused", text=text), seen.frame)
        self.region = (
            slice(region.row_px, region.row_px + region.height_px),
            slice(region.column_px, region.column_px + region.width_px),
        )
        self.full_scale_dn = 2**rig.camera.bit_depth - 1
        self.dose = LaserDose(rig.laser.power_mw, opened.clock, 0.0 if interrupted is None else interrupted.dose_j)
        self._frame_bytes = BYTES_PER_PIXEL * rig.camera.width_px * rig.camera.height_px
        self._frames = {} if interrupted is None else dict(interrupted.frames)
        self._unproven: set[int] = set()
        self._black_dn, self._settings = rig.camera.black_level_dn, rig.camera
        self._passing_laser = frozenset(
            band.name
            for band in rig.filter_wheel.filters
            if abs(band.center_nm - rig.laser.wavelength_nm) <= LINE_WIDTHS * band.fwhm_nm
        )
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="frame-writer")
        self._waiting: list[Future[None]] = []

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The stored frames in the order of their numbers; complete after the ``with`` block."""
        return tuple(frame for _, frame in sorted(self._frames.items()))

    def set_aside(self) -> int:
        """Move all frames so far out of the way, so that they are taken again; return how many they were."""
        self._wait(0)
        count = len(self._frames)
        self._frames.clear()
        self._unproven.clear()
        set_aside(self._out, set())
        return count

    @property
    def has_unproven(self) -> bool:
        """Whether frames that nothing is compared with have not been followed by one that is: dark ones, room light."""
        return bool(self._unproven)

    def prove(self) -> None:
        """Note that a lit frame was as metered: what was taken before it counts."""
        self._unproven.clear()
        self._journal.append(PROVEN_EVENT)

    def take_back(self) -> set[int]:
        """Move the frames that are not proven out of the way; return their numbers, to be taken again."""
        self._wait(0)
        taken_back, self._unproven = self._unproven, set()
        for number in taken_back:
            self._frames.pop(number, None)
        set_aside(self._out, {frame.file for frame in self._frames.values()})
        return taken_back

    def rates(self, counts: NDArray[np.uint16], exposure_s: float) -> Rates:
        """Return the mean rates of the region above the black level (DN/s), red, green, blue."""
        rows, columns = self.region
        rows, columns = slice(rows.start & ~1, rows.stop), slice(columns.start & ~1, columns.stop)
        part = counts[rows, columns].astype(np.float64) - self._black_dn
        green = 0.5 * (part[0::2, 1::2].mean() + part[1::2, 0::2].mean())
        red, blue = part[0::2, 0::2].mean(), part[1::2, 1::2].mean()
        return float(red) / exposure_s, float(green) / exposure_s, float(blue) / exposure_s

    def visible_dn_per_s(self, exposure_s: float) -> float:
        """Return the rate that is clearly seen in a frame (DN/s)."""
        return float(LEAST_SIGNAL_FRACTION * self.full_scale_dn / exposure_s)

    def are_same(self, now: Rates, before: Rates, exposure_s: float) -> bool:
        """Return whether two rates (DN/s) agree, but for light that repeats and a black level that is a little off."""
        dark_dn_per_s = DARK_SHARE * self.full_scale_dn / exposure_s
        return all(abs(a - b) <= SAME_SHARE * b + dark_dn_per_s for a, b in zip(now, before, strict=True))

    def require_as_metered(self, step: Step, raw: RawFrame, metered: Metered | None) -> None:
        """Refuse a frame whose signal is not that of its step's metering, or is light in the dark.

        A rate is as uncertain as the black level over the exposure: the shorter one limits what is seen.

        Raises
        ------
        SignalChangedError
            It is not.
        """
        now = self.rates(raw.counts, raw.exposure_s)
        if metered is None:
            if max(now) > self.visible_dn_per_s(raw.exposure_s):
                raise SignalChangedError(
                    f"camera: {step.label} gives {max(now):.3g} DN/s with all lights off, but at most "
                    f"{self.visible_dn_per_s(raw.exposure_s):.3g} DN/s are allowed; close the box, and check that all "
                    "lights are off"
                )
            return
        visible_dn_per_s = self.visible_dn_per_s(min(raw.exposure_s, metered.exposure_s))
        for name, rate, before in zip(("red", "green", "blue"), now, metered.rates, strict=True):
            is_alike = before > 0.0 and 1 / LARGEST_CHANGE < rate / before < LARGEST_CHANGE
            # a channel that was too dim for a ratio is compared by its difference
            if not is_alike if before > visible_dn_per_s else rate - before > visible_dn_per_s:
                raise SignalChangedError(
                    f"camera: {step.label} gives {rate:.3g} DN/s in {name}, but gave {before:.3g} DN/s at metering, a "
                    f"change beyond the allowed factor of {LARGEST_CHANGE:g}, so the wheel slipped, the light changed "
                    "or something moved; correct the cause, then continue or resume (all steps are metered again)"
                )

    def require_same_colour(self, step: Step, raw: RawFrame, metered: Metered) -> None:
        """Refuse a frame of its metering's exposure whose channels stand in another ratio than there.

        Light that only dims keeps the ratios; a part of another filter in the beam changes them.

        Raises
        ------
        SignalChangedError
            They do, by more than noise, dark level and linearity allow.
        """
        # by what was asked for: a camera that rounds exposures rounds those of the metering alike
        asked_s = raw.exposure_requested_s
        # a longer one may be saturated, and a wrong black level of the rig file changes the ratios of any other
        is_other = abs(asked_s / metered.exposure_s - 1.0) > SAME_EXPOSURE_REL
        is_clipped = saturated_fraction(raw.counts[self.region], self.full_scale_dn) > MOST_CLIPPED
        if is_other or is_clipped:
            return
        now = Metered(self.rates(raw.counts, raw.exposure_s), asked_s)
        changed = self.other_colour(step, now, metered)
        if changed is not None:
            raise SignalChangedError(
                f"camera: {step.label} shows a different colour than at metering. The ratio of two of its channels "
                f"changed by {changed}, which a light that only dims does not cause; the wheel stopped between two "
                "filters, other light came in, or the dark level drifted. Home the wheel, close the box, let the "
                "camera warm up, then continue or resume (all steps are metered again)"
            )

    def other_colour(self, step: Step, now: Metered, before: Metered) -> str | None:
        """Return by how much a ratio of two channels changed beyond what is allowed; None where none did.

        Where the laser itself passes the filter nothing is compared: its wavelength drifts, and the ratios with it.
        """
        if step.light == "laser" and step.filter_name in self._passing_laser:
            return None
        rows, columns = self.region
        pixels = (rows.stop - rows.start) * (columns.stop - columns.start)
        change, allowed = colour_change(now, before, self._settings, pixels)
        return f"{100 * change:.2g} % (at most {100 * allowed:.2g} % is allowed)" if change > allowed else None

    def missing(self, shots: Iterable[Shot]) -> list[Shot]:
        """Return the shots that are still to be taken, after checking that the disk can hold them.

        Raises
        ------
        CaptureError
            There is not enough space.
        """
        left = [shot for shot in shots if shot.sequence not in self._frames]
        require_space(self._out, len(left) * self._frame_bytes)
        return left

    def take(self, shot: Shot, check: Callable[[RawFrame], None] = lambda raw: None) -> None:
        """Take one frame; write it and note it in the journal while the next one is prepared.

        Parameters
        ----------
        shot
            What to take.
        check
            Raises when the frame must not be stored: what is in the journal is not taken again at a resumption.
        """
        checked = self.camera.expose(shot.step, shot.exposure_s)
        check(checked.raw)
        middle_s = max(checked.delivered_s - 0.5 * checked.raw.exposure_s, 0.0)
        dose_j = self.dose.energy_j(self._opened.clock.monotonic_s() - middle_s)
        self._wait(MOST_WAITING - 1)
        self._waiting.append(self._writer.submit(self._write, shot, checked, middle_s, dose_j))
        if is_compared(shot.step.light):
            self._unproven.clear()
        else:
            self._unproven.add(shot.sequence)

    def _write(self, shot: Shot, checked: CheckedFrame, middle_s: float, dose_j: float) -> None:
        """Write a frame, then its line of the journal."""
        raw, step = checked.raw, shot.step
        file = _frame_file(shot.sequence, step, raw.exposure_s)
        try:
            sha256 = write_frame(self._out / file, raw.counts, f"{step.label}, {raw.exposure_s:g} s")
        except OSError as error:
            raise not_written(self._out / file, error, self._out) from None
        frame = Frame(
            sequence=shot.sequence,
            file=file,
            frame_type=step.frame_type,
            target=step.target,
            light=step.light,
            filter_name=step.filter_name,
            slot_before=checked.slot_before,
            slot_after=checked.slot_after,
            lights_before=checked.lights_before,
            lights_after=checked.lights_after,
            exposure_requested_s=raw.exposure_requested_s,
            exposure_s=raw.exposure_s,
            captured_utc=raw.captured_utc,
            middle_s=middle_s,
            frame_id=raw.frame_id,
            device_time_s=raw.device_time_s,
            settings=dict(raw.settings),
            attempts=checked.attempts,
            laser_dose_j=dose_j,
            tilt_deg=step.tilt_deg,
            saturated_fraction=saturated_fraction(raw.counts[self.region], self.full_scale_dn),
            sha256=sha256,
        )
        self._journal.append("frame", **frame.model_dump())
        self._frames[shot.sequence] = frame

    def _wait(self, most: int) -> None:
        """Wait until at most so many frames are waiting; an error of the writer comes out here."""
        while len(self._waiting) > most:
            oldest = self._waiting.pop(0)
            wait((oldest,), WRITE_WITHIN_S)
            if (failed := self._failure(oldest)) is not None:
                raise failed

    def _failure(self, written: Future[None]) -> BaseException | None:
        """Return why a frame is not on the disk by now; None where it is."""
        if not written.done() or written.cancelled():
            return disk_hangs(self._out, self._out)
        return written.exception()

    def __enter__(self) -> "FrameStore":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        hangs = bool(wait(self._waiting, WRITE_WITHIN_S).not_done)
        self._writer.shutdown(wait=not hangs, cancel_futures=True)
        if error is None:
            self._wait(0)
            return
        unwritten = [failed for waiting in self._waiting if (failed := self._failure(waiting)) is not None]
        if unwritten and isinstance(error, CaptureError):
            raise type(error)(f"{error}. Besides: {unwritten[0]}") from error
        if unwritten:
            error.add_note(str(unwritten[0]))


def require_space(folder: Path, needed_bytes: int) -> None:
    """Refuse to start what the disk cannot hold.

    Raises
    ------
    CaptureError
        There is not enough free space.
    """
    free_bytes, needed_bytes = _free_bytes(folder), round(SPACE_FACTOR * needed_bytes)
    if free_bytes < needed_bytes:
        raise CaptureError(
            f"{folder}: the frames need {needed_bytes / 1e6:.0f} MB, but only {free_bytes / 1e6:.0f} MB are "
            "free; free space or choose another --out"
        )


def space_warning(folder: Path, least_bytes: int, most_bytes: int) -> str | None:
    """Return what to say before metering, which tells how many frames there are, of a disk that may be too full.

    Parameters
    ----------
    folder
        Of the session; it need not be there yet.
    least_bytes, most_bytes
        What its frames take.

    Raises
    ------
    CaptureError
        There is not even space for the least.
    """
    free_bytes = _free_bytes(folder)
    least_bytes, most_bytes = round(SPACE_FACTOR * least_bytes), round(SPACE_FACTOR * most_bytes)
    if free_bytes >= most_bytes:
        return None
    text = (
        f"{folder}: the frames need {least_bytes / 1e6:.0f} to {most_bytes / 1e6:.0f} MB, but only "
        f"{free_bytes / 1e6:.0f} MB are free; free space or choose another --out"
    )
    if free_bytes < least_bytes:
        raise CaptureError(text)
    return text


def _free_bytes(folder: Path) -> int:
    """Return the free space of the disk that holds a folder, or will hold it."""
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    disk = shutil.disk_usage(there)
    return disk.free if disk.total else sys.maxsize  # what is no disk, such as /proc, states no size


def _frame_file(number: int, step: Step, exposure_s: float) -> str:
    """Return ``frames/NNNN_<type>_<filter>_<exposure>us.tiff`` with plain characters only."""
    words = (step.frame_type, step.filter_name or "none")
    kind, filter_name = (re.sub(r"[^A-Za-z0-9.-]+", "-", word) for word in words)
    return f"frames/{number:04d}_{kind}_{filter_name}_{round(exposure_s * 1e6)}us.tiff"


WELL_SEEN: Final = (0.1, 0.6)
"""Of full scale: mean signal of a frame that shows by itself whether it was exposed as asked."""


def checks_in_light(
    steps: Iterable[Step], beside: Step, metered: Mapping[Step, Rates], exposures_s: Iterable[float], full_scale_dn: int
) -> list[tuple[Step, float]]:
    """Return lit steps and exposures (s) that show whether the camera still is as it was metered: shortest and longest.

    They are steps with the target that is in place; under the lamp if it gives a good signal, for a laser bleaches.

    Parameters
    ----------
    steps
        The steps of the session.
    beside
        The step whose target is in place.
    metered
        Rates of the steps (DN/s).
    exposures_s
        Exposures that may be taken (s).
    full_scale_dn
        Largest count of the camera (DN).
    """
    low_dn, high_dn = (share * full_scale_dn for share in WELL_SEEN)
    here = [s for s in steps if (s.target, s.tilt_deg) == (beside.target, beside.tilt_deg) and s.slot is not None]
    for light in ("lamp", "laser"):
        seen = [
            (exposure_s, step)
            for exposure_s in sorted(exposures_s)
            for step in here
            if step.light == light and low_dn < exposure_s * max(metered[step]) < high_dn
        ]
        if seen:
            ends = dict((seen[0], seen[-1]))
            return [(step, exposure_s) for exposure_s, step in ends.items()]
    return []


class LaserDose:
    """Meter of the laser energy on the sample: power x time with the laser on and the sample in view.

    Parameters
    ----------
    power_mw
        Power of the laser (mW).
    clock
        Its monotonic time is used.
    before_j
        Energy that fell on the sample before (J), in the interrupted part of a resumed session.
    """

    def __init__(self, power_mw: float, clock: Clock, before_j: float = 0.0):
        self._power_w, self._clock = 1e-3 * power_mw, clock
        self._energy_j = before_j
        self._on_since_s: float | None = None

    @contextmanager
    def shining(self) -> Iterator[None]:
        """Count the time of a ``with`` block."""
        self._on_since_s = self._clock.monotonic_s()
        try:
            yield
        finally:
            self._energy_j, self._on_since_s = self.energy_j(), None

    def energy_j(self, ago_s: float = 0.0) -> float:
        """Return the energy (J) until `ago_s` seconds before now, a moment within the running block if there is one."""
        if self._on_since_s is None:
            return self._energy_j
        return self._energy_j + self._power_w * max(self._clock.monotonic_s() - ago_s - self._on_since_s, 0.0)


def colour_notes(frames: Iterable[Frame]) -> tuple[str, ...]:
    """Return what must be known of a camera that says of itself that it sees no colours."""
    formats = sorted({str(frame.settings.get("pixel_format", "")) for frame in frames})
    mono = [name for name in formats if name.lower().startswith("mono")]
    if not mono:
        return ()
    return (
        f"camera: its frames are {', '.join(mono)}, but radiometry reads them as Bayer RGGB, so red, green and blue "
        "will have the same response, and only the filters separate wavelengths; for a colour camera, choose its raw "
        "Bayer pixel format",
    )
