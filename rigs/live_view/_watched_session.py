"""A capture session that is watched: its newest frame with its numbers, its questions, and the key that darkens it.

The session is the one of :mod:`rigs.capture` and runs in the main thread; views read from here and answer its
questions, and may come and go. It gets its devices behind wrappers that see what they deliver. Calls of camera and
wheel are made in a thread of their own: the key for light off need not wait for an exposure, the frame under way is
thrown away, and no light is lit again before a person says so.
"""

import math
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CameraSettings,
    CaptureError,
    LaserSettings,
    RegionOfInterest,
    Target,
)
from rigs import OpenRig, RawFrame, TerminalOperator
from rigs.capture import SessionWatch, Step
from rigs.light_guard import LightLostError, is_hazardous
from rigs.live_view._live_server import BINS, live_picture
from rigs.live_view._watched_devices import (
    DarkenedCalls,
    HandsOnBench,
    LightRole,
    WatchedCamera,
    WatchedLight,
    WatchedWheel,
)

T = TypeVar("T")
DARK_WITHIN_S: Final = 1.0
"""A session that does not leave its light so soon after the key is ended as by Ctrl-C."""
LEAST_FRAMES: Final = 3
"""Timed before a time is said that is left."""
REFERENCE_SIGNAL: Final = 0.05
"""Share of full scale from which on a frame is a reference for drift: below it, the black level decides."""
REFERENCES: Final = {"white": "tile lamp", "laser white": "tile laser", "fluorescence repeat": "repeat"}
"""Kinds of frames that are seen again, in words that fit a narrow screen."""
TARGET_HEADLINES: Final[Mapping[Target, str]] = {
    "white": "PUT IN WHITE TILE",
    "sample": "PUT IN THE SAMPLE",
    "sample beside ColorChecker": "SAMPLE + CHECKER",
}


@dataclass(frozen=True, slots=True)
class Drift:
    """By how much the light of a reference differs from its first frame.

    Attributes
    ----------
    label
        What was seen: step and filter.
    change_rel
        Rate (DN/s) over that of the first frame of the same step and exposure, less one: black level and linearity of
        the camera are not in it.
    uncertainty_rel
        Its standard uncertainty from photon and read noise; the light's own flicker is not in it.
    """

    label: str
    change_rel: float
    uncertainty_rel: float


@dataclass(frozen=True, slots=True)
class FilterCount:
    """Frames of one filter: stored, planned (0 before metering is done), and the lowest signal to noise of a pixel."""

    name: str
    stored: int
    planned: int
    least_snr: float


@dataclass(frozen=True, slots=True)
class SessionNumbers:
    """What a view shows of a session.

    Attributes
    ----------
    number
        Grows with every change.
    headline, text
        What to do next, or what is being done, in a few large words and in a sentence.
    question, answers
        Number of the question that waits for a person and the words that answer it; 0 and none where nobody is asked.
    phase, done, total
        Part of the session and how far it is.
    stored, left
        Frames on the disk and frames still to be taken; the latter is known from the end of metering on (-1 before).
    time_left_s
        Without the time that a person takes; -1 while it is not known.
    frame
        What was exposed last.
    exposure_s, brightest_fraction, saturated_fraction, histogram
        Of that frame; the last three within the region of the plan.
    snr
        Signal to noise of one pixel of the brightest colour, from gain and read noise of the rig file.
    filter_name, lamp, laser
        The filter in the beam, and the lights as the devices report them; a light that is not confirmed off counts as
        on.
    kept_off
        Whether the lights stay off until a person says that they may be lit.
    drifts, filters
        Of the references, and of the filters of the session.
    repeated, retaken, lights_lost, repairs
        Exchanges that were repeated, frames that were taken again, lights that were lost, repairs by a person.
    told
        What was noted last: a fault, a refused frame, a proof.
    ended
        How the session ended; empty while it runs.
    """

    number: int = 0
    headline: str = "STARTING"
    text: str = "the devices are being opened"
    question: int = 0
    answers: tuple[str, ...] = ()
    phase: str = ""
    done: int = 0
    total: int = 0
    stored: int = 0
    left: int = -1
    time_left_s: float = -1.0
    frame: str = ""
    exposure_s: float = 0.0
    brightest_fraction: float = 0.0
    saturated_fraction: float = 0.0
    histogram: tuple[int, ...] = (0,) * BINS
    snr: float = 0.0
    filter_name: str = "none"
    lamp: bool = False
    laser: bool = False
    kept_off: bool = False
    drifts: tuple[Drift, ...] = ()
    filters: tuple[FilterCount, ...] = ()
    repeated: int = 0
    retaken: int = 0
    lights_lost: int = 0
    repairs: int = 0
    told: str = ""
    ended: str = ""


class WatchedSession(SessionWatch):
    """What views show of one session, and how they answer it; all of it may be called from any thread.

    Parameters
    ----------
    name
        Of the paint, camera or finger.
    camera
        What the rig file says about the camera.
    region
        Of the plan; the whole frame when left out.
    takes_time
        Whether an exposure takes its time; on the simulated rig it takes none.
    has_lights
        Whether the session switches lights; that of a finger does not.
    laser
        What the rig file says about the laser; one that harms eyes is lit again by two acts only.
    """

    def __init__(
        self,
        name: str,
        camera: CameraSettings,
        region: RegionOfInterest | None,
        takes_time: bool = True,
        has_lights: bool = True,
        laser: LaserSettings | None = None,
    ) -> None:
        self.name, self.operator = name, ViewOperator(self)
        self._laser = laser
        self._camera, self._full = camera, 2**camera.bit_depth - 1
        whole = RegionOfInterest(row_px=0, column_px=0, height_px=camera.height_px, width_px=camera.width_px)
        self.region = region or whole
        self._time, self._has_lights = _TimeLeft(takes_time), has_lights
        self._changed = threading.Condition()
        self._picture: NDArray[np.uint8] = np.zeros((2, 2), np.uint8)
        self._numbers = SessionNumbers()
        self._answer: str | None = None
        self._asked = self._presses = 0
        self._shining: set[LightRole] = set()
        self._kept_off = False
        self._main = threading.main_thread().ident
        self._references: dict[tuple[str, float], tuple[float, float]] = {}
        self._drifts: dict[str, Drift] = {}
        self._calls: DarkenedCalls | None = None
        # by number: a frame that is taken again replaces the one before
        self._stored: dict[int, str] = {}
        self._resumed = 0
        self._resumed_of: Counter[str] = Counter()
        self._planned: Counter[str] = Counter()
        self._least_snr: dict[str, float] = {}

    # ------------------------------------------------------------------ what views read and ask
    @property
    def frame_size(self) -> tuple[int, int]:
        """Rows and columns of a raw frame."""
        return self._camera.height_px, self._camera.width_px

    def latest(self, after: int, timeout_s: float = 5.0) -> tuple[NDArray[np.uint8], SessionNumbers]:
        """Return the newest picture (h, w), 0 to 255, and the numbers; wait for a change behind number `after`."""
        with self._changed:
            self._changed.wait_for(lambda: self._numbers.number > after, timeout_s)
            return self._picture, self._numbers

    def facts(self) -> dict[str, Any]:
        """Return what a page needs beside the numbers."""
        region = self.region
        return {
            "name": self.name,
            "frame_height": self._camera.height_px,
            "frame_width": self._camera.width_px,
            "region": [region.row_px, region.column_px, region.height_px, region.width_px],
        }

    def ask(self, command: dict[str, Any]) -> None:
        """Do what a view asks for.

        Parameters
        ----------
        command
            ``{"lamp": False}``: lights off; ``{"question": number, "answer": word}``; ``{"end": True}``.

        Raises
        ------
        CaptureError
            It asks for something else, or answers a question that is not asked now.
        """
        match command:
            case {"lamp": False}:
                self.darken()
            case {"question": int(question), "answer": str(word)}:
                self._take_answer(question, word)
            case {"end": True}:
                self.end()
            case _:
                raise CaptureError(
                    f"live view: the command {str(command)[:80]} is not valid; a session takes only lamp (false), "
                    "question and answer, or end (true)"
                )

    def darken(self) -> None:
        """Have all lights off at once, and keep them off until a person allows them."""
        with self._changed:
            if not self._has_lights:
                self._publish(told="this view cannot switch the finger's own light: switch it off at the finger")
                return
            self._kept_off, self._presses = True, self._presses + 1
            self._publish(kept_off=True, told="you switched the light off: no light goes on again until you confirm it")
            if self._shining:
                insist = threading.Timer(DARK_WITHIN_S, self._insist, (self._presses,))
                insist.daemon = True
                insist.start()

    def end(self) -> None:
        """End the session as Ctrl-C does: light off, what is stored stays and can be resumed."""
        with self._changed:
            if self._numbers.ended or self._main is None:
                return
            self._publish(told="ending: the light goes off")
        signal.pthread_kill(self._main, signal.SIGINT)

    def has_ended(self, words: str) -> None:
        """Say how the session ended."""
        with self._changed:
            self._publish(ended=words, headline="DONE" if words.startswith("done") else "ENDED", text=words)

    def _take_answer(self, question: int, word: str) -> None:
        with self._changed:
            if question != self._numbers.question or word not in self._numbers.answers:
                raise CaptureError("live view: this question is no longer open; read what the view shows now")
            self._answer = word
            self._changed.notify_all()

    def _insist(self, press: int) -> None:
        """End a session whose light shines on after the key."""
        with self._changed:
            is_late = self._shining and self._kept_off and press == self._presses
        if is_late:
            self.end()

    def _publish(self, **changes: Any) -> None:
        with self._changed:
            self._numbers = replace(self._numbers, number=self._numbers.number + 1, **changes)
            self._changed.notify_all()

    # ------------------------------------------------------------------ what the session tells
    def ask_person(self, headline: str, text: str, answers: tuple[str, ...] = ("done",)) -> str:
        """Show a question in all views until one of them answers; return the answer."""
        with self._changed:
            before = self._numbers.headline, self._numbers.text
            self._asked, self._answer = self._asked + 1, None
            self._publish(headline=headline, text=text, question=self._asked, answers=answers)
            began_s = time.monotonic()
            try:
                self._changed.wait_for(lambda: self._answer is not None)
            finally:
                self._time.waited_s += time.monotonic() - began_s
                self._publish(headline=before[0], text=before[1], question=0, answers=())
            return self._answer or ""

    def mend(self, what: str) -> bool:
        """Have something mended; return whether it is done."""
        text = f"{what}. The lights are off. Repair the fault and close the box, or end here."
        is_mended = self.ask_person("MEND THE RIG", text, ("done", "end")) == "done"
        if is_mended:
            self._publish(headline="METERING", text="all steps are metered again", phase="metering", done=0)
        return is_mended

    def progress(self, done: int, total: int, what: str) -> None:
        """Learn how far the session is; a message that counts nothing is only told."""
        if done == 0:
            self._publish(told=what)
            return
        phase = what.partition(":")[0]
        self._publish(headline=phase.upper(), text=f"{done} of {total}: {what}", phase=phase, done=done, total=total)

    def devices(self, opened: OpenRig) -> OpenRig:
        """Return the devices behind what sees and darkens them; on the simulated rig, too, a person is asked."""
        calls = self._calls = DarkenedCalls(self)
        hands = opened.operator
        return replace(
            opened,
            camera=WatchedCamera(opened.camera, calls),
            wheel=WatchedWheel(opened.wheel, calls),
            lamp=WatchedLight(opened.lamp, "lamp", self),
            laser=WatchedLight(opened.laser, "laser", self),
            operator=hands if hands is self.operator else HandsOnBench(self.operator, hands),
        )

    def left(self) -> None:
        """Have no call of camera or wheel begin any more, and wait for the one that runs, at most for its deadline.

        The devices are closed after this: a driver must not be closed while one of its calls runs.
        """
        if self._calls is not None and not self._calls.finish():
            self._publish(told="a device has not answered in time; plug it in again before you resume")

    def noted(self, event: str, what: Mapping[str, Any]) -> None:
        """Count what the journal says."""
        with self._changed:
            now = self._numbers
            match event:
                case "frame":
                    is_lit = what.get("light", "off") != "off"
                    self._stored[int(what["sequence"])] = str(what.get("filter_name") or "") if is_lit else ""
                    self._publish(stored=self._resumed + len(self._stored), filters=self._filters())
                case "resume":
                    self._resumed, self._resumed_of = int(what["frames"]), Counter(what.get("filters", {}))
                    self._publish(stored=self._resumed)
                case "fault":
                    times = now.repeated + int(what["times"])
                    self._publish(repeated=times, told=f"repeated: {what['device']}: {what['what']}")
                case "refused":
                    self._publish(retaken=now.retaken + 1, told=f"taken again: {what['text']}")
                case "light lost":
                    self._publish(lights_lost=now.lights_lost + 1, told=str(what["text"]))
                case "repair":
                    self._publish(repairs=now.repairs + 1)
                case "set aside":
                    self._resumed = 0
                    for of_frames in (self._stored, self._resumed_of, self._least_snr, self._references, self._drifts):
                        of_frames.clear()
                    self._publish(stored=0, drifts=(), filters=self._filters())
                case "filter proof":
                    self._publish(told=f"filters {what['verdict']}: {what['text']}")

    def expects(self, shots: Sequence[tuple[str | None, float]]) -> None:
        """Learn filter and exposure (s) of the frames that are still to be taken."""
        with self._changed:
            self._time.expect([exposure_s for _, exposure_s in shots])
            self._planned = self._stored_of() + Counter(name for name, _ in shots if name is not None)
            self._publish(left=self._time.frames_left, filters=self._filters())

    def frame(self, label: str, raw: RawFrame, step: Step | None = None) -> None:
        """Show a frame and what its numbers say."""
        counts = raw.counts if raw.counts.ndim == 2 else raw.counts.max(axis=2)
        region = self.region
        row, column = region.row_px & ~1, region.column_px & ~1
        seen = counts[row : region.row_px + region.height_px, column : region.column_px + region.width_px]
        signal_dn, noise_dn, pixels = _brightest_site(seen, self._camera)
        snr = max(signal_dn, 0.0) / noise_dn
        picture = live_picture(counts, self._full, self._camera.black_level_dn)
        with self._changed:
            self._picture = picture
            self._time.took(raw.exposure_requested_s)
            if step is not None and not bool((seen >= self._full).any()):
                uncertainty_rel = 1.0 / max(snr * math.sqrt(pixels), 1e-9)
                self._compare(step, raw.exposure_s, signal_dn, uncertainty_rel)
                if step.light != "off" and step.filter_name is not None and self._time.frames_left >= 0:
                    self._least_snr[step.filter_name] = min(self._least_snr.get(step.filter_name, math.inf), snr)
            self._publish(
                frame=label,
                exposure_s=raw.exposure_s if math.isfinite(raw.exposure_s) else raw.exposure_requested_s,
                brightest_fraction=float(np.quantile(seen, 0.999)) / self._full,
                saturated_fraction=float((seen >= self._full).mean()),
                histogram=tuple(int(n) for n in np.histogram(seen, bins=BINS, range=(0, self._full + 1))[0]),
                snr=snr,
                filter_name="none" if step is None or step.filter_name is None else step.filter_name,
                left=self._time.frames_left,
                time_left_s=self._time.left_s(),
                drifts=tuple(self._drifts.values()),
                filters=self._filters(),
            )

    def _compare(self, step: Step, exposure_s: float, signal_dn: float, uncertainty_rel: float) -> None:
        """Compare a reference, or the fluorescence that is repeated, with its first frame of the same exposure."""
        rate_dn_per_s = signal_dn / exposure_s
        is_white = step.target == "white" and step.light in ("lamp", "laser")
        if not is_white and step.frame_type not in ("fluorescence", "fluorescence repeat"):
            return
        if signal_dn < REFERENCE_SIGNAL * self._full:
            return
        key = step.label.replace("fluorescence repeat", "fluorescence"), exposure_s
        first = self._references.setdefault(key, (rate_dn_per_s, uncertainty_rel))
        if first[0] == rate_dn_per_s or step.frame_type == "fluorescence":
            return
        kind = REFERENCES.get(step.frame_type, step.frame_type)
        uncertainty = math.hypot(first[1], uncertainty_rel)
        label = f"{kind} {step.filter_name or 'no filter'}"
        self._drifts[kind] = Drift(label, rate_dn_per_s / first[0] - 1.0, uncertainty)

    def _stored_of(self) -> "Counter[str]":
        return self._resumed_of + Counter(name for name in self._stored.values() if name)

    def _filters(self) -> tuple[FilterCount, ...]:
        stored = self._stored_of()
        names = dict.fromkeys((*self._planned, *stored))
        return tuple(FilterCount(n, stored[n], self._planned[n], self._least_snr.get(n, 0.0)) for n in names)

    # ------------------------------------------------------------------ the lights
    @property
    def must_go_dark(self) -> bool:
        """Whether a light shines that was switched off by hand."""
        return self._kept_off and bool(self._shining)

    def wait_for(self, call: "Future[Any]", timeout_s: float | None = None) -> None:
        """Wait for a call of a device, or for the key for light off while a light shines."""
        with self._changed:
            self._changed.wait_for(lambda: call.done() or self.must_go_dark, timeout_s)

    def wake(self) -> None:
        """Have those look who wait."""
        with self._changed:
            self._changed.notify_all()

    def allow_light(self) -> None:
        """Let lights be lit again."""
        with self._changed:
            self._kept_off = False
            self._publish(kept_off=False)

    def require_allowed(self, role: LightRole) -> None:
        """Ask before a light is lit that was switched off by hand.

        Raises
        ------
        CaptureError
            The person ends the session.
        """
        if not self._kept_off:
            return
        text = f"You switched the light off, and it stays off. Is the box closed, and may the {role} be lit again?"
        is_allowed = self.ask_person("THE LIGHT IS OFF", text, ("done", "end")) == "done"
        if not is_allowed or (role == "laser" and not self.goggles_are_on()):
            raise CaptureError(f"{role}: was switched off by hand and is not lit again; the session ends as you asked")
        self.allow_light()

    def goggles_are_on(self) -> bool:
        """Return whether a person confirms class and goggles before a laser that harms eyes is lit again.

        It has an answer of its own: the key that answered the question before does nothing here.
        """
        laser = self._laser
        if laser is None or not is_hazardous(laser):
            return True
        text = (
            f"Laser of class {laser.laser_class}, {laser.wavelength_nm:g} nm, {laser.power_mw:g} mW. Does everybody "
            f"here wear goggles for {laser.wavelength_nm:g} nm?"
        )
        return self.ask_person(f"CLASS {laser.laser_class} LASER", text, ("goggles", "end")) == "goggles"

    def reports(self, role: LightRole, is_on: bool) -> None:
        """Learn what a light reports."""
        if getattr(self._numbers, role) != is_on:
            self._publish(**{role: is_on})

    @contextmanager
    def shining(self, role: LightRole) -> Iterator[None]:
        """Count a light as shining for a ``with`` block, which the key for light off ends."""
        with self._changed:
            self._shining.add(role)
            self._publish(**{role: True})
        try:
            if self.must_go_dark:
                raise LightLostError(f"{role}: was switched off by hand in the view")
            yield
        finally:
            with self._changed:  # from here on it goes off: nothing may interrupt that
                self._shining.discard(role)


class _TimeLeft:
    """Exposures that are left, and what else a frame takes, measured while nobody is asked."""

    def __init__(self, takes_time: bool) -> None:
        self._share = 1.0 if takes_time else 0.0
        self.waited_s = 0.0
        self.frames_left, self._taken = -1, 0
        self._exposure_left_s = self._exposed_s = self._began_s = 0.0

    def expect(self, exposures_s: Sequence[float]) -> None:
        self.frames_left, self._taken, self._exposure_left_s = len(exposures_s), 0, sum(exposures_s)
        self._began_s, self.waited_s, self._exposed_s = time.monotonic(), 0.0, 0.0

    def took(self, exposure_s: float) -> None:
        if self.frames_left > 0:
            self.frames_left, self._taken = self.frames_left - 1, self._taken + 1
            self._exposure_left_s, self._exposed_s = self._exposure_left_s - exposure_s, self._exposed_s + exposure_s

    def left_s(self) -> float:
        """Return the time that is left without that of a person; -1 while it is not known."""
        if self.frames_left < 0 or (self.frames_left > 0 and self._taken < LEAST_FRAMES):
            return -1.0
        if self.frames_left == 0:
            return 0.0
        spent_s = time.monotonic() - self._began_s - self.waited_s - self._share * self._exposed_s
        return self._share * self._exposure_left_s + self.frames_left * max(spent_s, 0.0) / self._taken


def _brightest_site(counts: NDArray[np.uint16], camera: CameraSettings) -> tuple[float, float, int]:
    r"""Return signal and noise (DN) of one pixel of the brightest Bayer site of a region, and how many it has.

    .. math:: \sigma^2 = S / K + (\sigma_r / K)^2 + 1/12
    """
    sites = [counts[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    signal_dn = max(float(site.mean()) for site in sites) - camera.black_level_dn
    gain = camera.gain_e_per_dn
    noise = max(signal_dn, 0.0) / gain + (camera.read_noise_e / gain) ** 2 + 1.0 / 12.0
    return signal_dn, math.sqrt(noise), sites[0].size


class ViewOperator(TerminalOperator):
    """A person who is asked in the views of a session."""

    def __init__(self, session: WatchedSession) -> None:
        super().__init__()
        self._session, self._headline = session, ""

    def place(self, target: Target) -> None:
        """Have `target` put in view; nothing is asked when it is there already."""
        self._headline = TARGET_HEADLINES[target]
        super().place(target)
        self._headline = ""

    def swing_wheel_out(self) -> None:
        """Have the filter wheel swung out of the beam."""
        self._headline = "SWING WHEEL OUT"
        super().swing_wheel_out()
        self._headline = ""

    def tilt(self, angle_deg: float) -> None:
        """Have the sample tilted."""
        self._headline = "TURN THE SAMPLE"
        super().tilt(angle_deg)
        self._headline = ""

    def do(self, instruction: str) -> None:
        """Show an instruction until a view says that it is done."""
        self._session.ask_person(self._headline or "YOUR HANDS PLEASE", instruction)

    def allows(self, question: str) -> bool:
        """Ask a question that only "yes" answers with yes, and before a laser that harms eyes the one of its goggles.

        Lights that were switched off by hand may be lit then.
        """
        is_allowed = self._session.ask_person("YES OR NO?", question, ("yes", "no")) == "yes"
        is_allowed = is_allowed and self._session.goggles_are_on()
        if is_allowed:
            self._session.allow_light()
        return is_allowed
