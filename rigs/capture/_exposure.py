"""Checked exposures: metered, taken again when refused, and refused when a read-back is not as asked.

Of a rig: wheel in place before and after, lights as planned, a new frame with the settings asked for. Of a finger's
camera: a new frame of the right size and exposure. Frames that are refused, and cameras that are lost or late, are
taken again a bounded number of times. Metering finds the longest exposure of a ladder of factor-of-two steps that keeps
the brightest pixels in range.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BadFrameError,
    CameraSettings,
    CaptureError,
    FrameSizeError,
    LightState,
    LostError,
    RefusedError,
    SaturatedError,
    TimedOutError,
    WrongPositionError,
)
from rigs import Camera, OpenRig, RawFrame
from rigs.capture._journal import beginning, lost_since
from rigs.capture._plan import Step, metering_room_dn
from rigs.light_guard import LightLostError

WHEEL_DEADLINE_S = 20.0
CAMERA_DEADLINE_MARGIN_S = 5.0
CAMERA_EXPOSURES = 2  # drivers discard the frame that was under way when the exposure changed
# Cameras set exposures in multiples of a line time; more than this is a setting that was not taken.
EXPOSURE_TOLERANCE_REL = 0.05

LightName = Literal["lamp", "laser"]


@dataclass(frozen=True, slots=True)
class CheckedFrame:
    """A raw frame with what was read back beside it.

    Attributes
    ----------
    raw
        The frame.
    slot_before, slot_after
        Position of the wheel.
    lights_before, lights_after
        Lights that were on.
    attempts
        Exposures it took.
    delivered_s
        When the camera had delivered it (s, monotonic).
    """

    raw: RawFrame
    slot_before: int | None
    slot_after: int | None
    lights_before: tuple[LightName, ...]
    lights_after: tuple[LightName, ...]
    attempts: int
    delivered_s: float


@contextmanager
def shine(opened: OpenRig, light: LightState) -> Iterator[None]:
    """Keep the planned light on for a ``with`` block and check that only this one is on."""
    device = {"lamp": opened.lamp, "laser": opened.laser}.get(light)
    with nullcontext() if device is None else device.lit():
        _require_lights(opened, light)
        yield


RELIGHTS: Final = 3
"""How often in a row a light that was lost is lit anew, without anything done between."""
RELIGHT_PAUSE_S: Final = 1.0


def under_light(
    opened: OpenRig,
    light: LightState,
    tasks: deque[Callable[[], None]],
    on_fault: Callable[[str], None],
    around: Callable[[], AbstractContextManager[None]] = nullcontext,
    must_ask: bool = False,
) -> None:
    """Do tasks with the planned light on; after a light that was lost it is lit anew, and the task is done again.

    Parameters
    ----------
    opened, light
        The rig and the light that is on.
    tasks
        What to do, in order; a task may add others at the end.
    on_fault
        Called with a text when the light was lost.
    around
        Entered before the light is switched on, and left after it is off.
    must_ask
        Whether the light harms eyes, so that it is lit anew only when the operator says that the box is closed: it may
        have been lost because somebody opened it.

    Raises
    ------
    LightLostError
        The light was lost again and again, or the operator did not allow it, or could not be asked; it is off.
    """
    lost, began = 0, beginning()
    while tasks:
        try:
            with around(), shine(opened, light):
                if lost:
                    lost_since(began)  # the pause and the new guard too; nothing is counted twice
                while tasks:
                    began = beginning()
                    tasks[0]()
                    tasks.popleft()
                    lost = 0
        except LightLostError as error:
            lost += 1
            on_fault(f"light '{light}' was lost: {error}")
            if not tasks:  # it went as the block was left, and nothing is left to do in its light
                return
            if lost > RELIGHTS:
                raise
            lost_since(began)
            if not must_ask:
                time.sleep(RELIGHT_PAUSE_S)
            elif not opened.operator.allows(
                f"The {light} went off without a command and stays off ({error}). Find the cause first: was "
                f"the box opened? Is it closed now, does everybody wear goggles, and may the {light} be lit "
                "again?"
            ):
                raise LightLostError(
                    f"{light}: went off or stopped answering ({error}). It is off now, and is lit again only if a "
                    "person at the terminal says that the box is closed; find out why it went off, close the box, "
                    "then continue the capture with --resume"
                ) from error
            else:
                began = beginning()  # the time of a person is no fault's


class CheckedCamera:
    """The camera of a rig behind its wheel and lights: everything that can be read back is checked.

    Parameters
    ----------
    opened, settings
        The rig and what its file says about the camera.
    on_refusal
        Called with a text for every frame that is refused and taken again.
    on_frame
        Called with the words of the step, the frame and the step for every frame that is accepted.
    """

    def __init__(
        self,
        opened: OpenRig,
        settings: CameraSettings,
        on_refusal: Callable[[str], None] = lambda text: None,
        on_frame: Callable[[str, RawFrame, Step], None] = lambda label, raw, step: None,
    ) -> None:
        self._opened, self._settings, self._on_refusal, self._on_frame = opened, settings, on_refusal, on_frame
        self._frames = NewFrames(opened.camera, settings)
        self._slot_of_header: dict[str, int] = {}
        self._header_of_slot: dict[int, str] = {}

    def expose(self, step: Step, exposure_s: float) -> CheckedFrame:
        """Turn the wheel to the filter of `step` and take a frame; four attempts at most.

        A refused frame is taken again, and so is one that did not come: a camera that is lost or late is connected
        again by its next exposure. A wheel that is lost or at another slot is sent anew; one that is late once only,
        since it may be stuck.

        Raises
        ------
        WrongPositionError
            The wheel is or was at another slot.
        BadFrameError, FrameSizeError, LostError
            Every attempt failed.
        LightLostError
            The planned light is off.
        CaptureError
            Another light is on, or the camera used another exposure.
        """

        def once(attempt: int) -> CheckedFrame:
            return self._once(step, exposure_s, attempt)

        checked = within_attempts(once, self._on_refusal, f"{step.label}, {exposure_s:g} s")[0]
        self._on_frame(step.label, checked.raw, step)
        return checked

    def _once(self, step: Step, exposure_s: float, attempt: int) -> CheckedFrame:
        """Take one frame and check it."""
        opened = self._opened
        if step.slot is not None and opened.wheel.position() != step.slot:
            opened.wheel.go_to(step.slot, WHEEL_DEADLINE_S)
        slot_before, lights_before = _require_slot(opened, step, "before"), _require_lights(opened, step.light)
        raw = self._frames.expose(exposure_s, CAMERA_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S)
        delivered_s = opened.clock.monotonic_s()
        slot_after, lights_after = _require_slot(opened, step, "after"), _require_lights(opened, step.light)
        self._require_as_asked(raw, step, exposure_s)
        self._frames.require_new(raw)
        self._require_own_header(raw, step)
        return CheckedFrame(raw, slot_before, slot_after, lights_before, lights_after, attempt, delivered_s)

    def _require_as_asked(self, raw: RawFrame, step: Step, exposure_s: float) -> None:
        """Refuse another exposure or frame size than was asked for."""
        asked = (self._settings.height_px, self._settings.width_px)
        shape = raw.counts.shape
        if len(shape) == 3:
            raise RefusedError(
                f"camera: delivers colour pictures ({shape[2]} values a pixel), but filtered sessions need raw Bayer "
                "counts; choose a raw pixel format, or another driver"
            )
        if shape != asked:
            raise FrameSizeError(
                f"camera: delivered a frame of {' x '.join(map(str, shape))} px, but the rig file states "
                f"{asked[0]} x {asked[1]} px (height x width); correct the rig file"
            )
        # a camera that does not read its exposure back says NaN, which is within nothing
        if not abs(raw.exposure_s / exposure_s - 1.0) <= EXPOSURE_TOLERANCE_REL:
            raise RefusedError(
                f"camera: an exposure of {exposure_s:g} s was requested for {step.label}, but the camera reads back "
                f"{raw.exposure_s:g} s (a difference of up to {100 * EXPOSURE_TOLERANCE_REL:.0f} % is allowed); "
                "correct shortest_exposure_s and longest_exposure_s in the rig file"
            )

    def _require_own_header(self, raw: RawFrame, step: Step) -> None:
        """Refuse a header that names one filter at two slots, or two at one: it tells another wheel, or an old move."""
        header = str(raw.settings.get("filter_header", ""))
        if not header or step.slot is None:
            return
        slot = self._slot_of_header.setdefault(header, step.slot)
        name = self._header_of_slot.setdefault(step.slot, header)
        if slot == step.slot and name == header:
            return
        before = f"as at slot {slot}" if slot != step.slot else f"where it stated '{name}' before"
        raise RefusedError(
            f"camera: the frame's FILTER header states '{header}' at slot {step.slot}, {before}; the camera takes "
            f"this header from the wheel '{raw.settings.get('active_filter', 'unknown')}'. Set the camera's "
            "ACTIVE_DEVICES to the wheel in use, and give each slot a different name"
        )


NOISY_SHARE: Final = 0.05
"""Of the pixels: where more are above or below both of their neighbours, two equal frames are one."""


def _is_noisy(counts: NDArray[np.uint16]) -> bool:
    """Return whether a frame shows noise, by pixels beyond both of the next ones of their colour in the row."""
    wide = counts.astype(np.int64)
    before, after = wide[:, 2:-2] - wide[:, :-4], wide[:, 2:-2] - wide[:, 4:]
    return bool(before.size) and float((before * after > 0).mean()) > NOISY_SHARE


def _digest(raw: RawFrame) -> bytes:
    return blake2b(np.ascontiguousarray(raw.counts).data, digest_size=16).digest()


REPLAY_DRIVER: Final = "folder"
CHANGED_SHARE: Final = 0.2
"""By which the mean signals of two frames differ where a camera that is one frame late can be distinguished."""
CHANGED_OF_FULL_SCALE: Final = 0.002
"""By which they differ at least: 2 DN of 10 bits, by which a check of the rig lets its dark level drift."""


class NewFrames:
    """The frames of a camera, none of which was delivered before.

    A camera that delivers an earlier frame as a new one may be one frame late from then on. Each frame is then exposed
    twice, with all else as it is, and the first one is thrown away, until one of those is seen to show what was asked
    for: it resembles the frame after it, and that one differs from the frame before.

    Parameters
    ----------
    camera, settings
        The open camera, and what the rig file says about it: a folder of images that is replayed has no image to throw
        away.
    """

    def __init__(self, camera: Camera, settings: CameraSettings) -> None:
        self._camera, self._is_replay = camera, settings.driver == REPLAY_DRIVER
        self._black_dn = settings.black_level_dn
        self._least_change_dn = CHANGED_OF_FULL_SCALE * (2**settings.bit_depth - 1)
        self._last: RawFrame | None = None
        self._delivered: set[bytes] = set()
        self._may_be_late, self._calls = False, 0
        self._thrown: RawFrame | None = None

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Take a frame; a camera that is late counts as lost, for its next exposure begins with a new connection.

        Raises
        ------
        LostError
            The camera is lost or late.
        """
        self._thrown = None
        self._calls += 1
        if self._may_be_late:
            self._thrown = self._exposed(exposure_s, deadline_s)
            self._delivered.add(_digest(self._thrown))
        return self._exposed(exposure_s, deadline_s)

    def _exposed(self, exposure_s: float, deadline_s: float) -> RawFrame:
        try:
            return self._camera.expose(exposure_s, deadline_s)
        except TimedOutError as error:
            raise LostError(str(error)) from error

    def require_new(self, raw: RawFrame) -> None:
        """Refuse a frame that was delivered before.

        Raises
        ------
        BadFrameError
            It has the number and time of the last one, or its payload: where there are none, and where noise would
            make two frames differ, whatever their numbers; or the payload of any noisy frame before.
        """
        digest = _digest(raw)
        if self._was_last(raw) or (digest in self._delivered and _is_noisy(raw.counts)):
            self._may_be_late = not self._is_replay
            raise BadFrameError(
                "camera: delivered the same frame twice, so its stream has stopped or is late, or a server sends a "
                "still picture instead of the camera's; each exposure is made twice until frames arrive in time"
            )
        # after a call that failed, a late camera shows what that one asked for
        if self._last is not None and self._calls == 1 and self._is_in_time(raw, self._last):
            self._may_be_late = False
        self._calls = 0
        if not self._is_replay:
            self._delivered.add(digest)
        self._last = raw

    def _was_last(self, raw: RawFrame) -> bool:
        """Whether it is the last frame once more."""
        if (last := self._last) is None:
            return False
        is_numbered = raw.frame_id is not None or raw.device_time_s is not None
        if is_numbered and (raw.frame_id, raw.device_time_s) == (last.frame_id, last.device_time_s):
            return True
        # two frames of one value each may well be equal, in the dark but for a few bright pixels, or without any noise
        return np.array_equal(raw.counts, last.counts) and (
            _is_noisy(raw.counts) if is_numbered else bool(raw.counts.min() < raw.counts.max())
        )

    def _is_in_time(self, raw: RawFrame, last: RawFrame) -> bool:
        """Whether the frame that was thrown away shows what was asked for, and not what was before."""
        if self._thrown is None:
            return False
        now, before, thrown = (float(one.counts.mean()) - self._black_dn for one in (raw, last, self._thrown))
        is_other = abs(now - before) > max(CHANGED_SHARE * max(now, before), self._least_change_dn)
        return is_other and abs(thrown - now) < 0.25 * abs(now - before)


def _require_slot(opened: OpenRig, step: Step, when: str) -> int | None:
    """Return the wheel's position after checking that it is the one of the step; None when it is swung out.

    A wheel that the operator swung out of the beam still counts its slots.
    """
    if step.slot is None:
        return None
    position = opened.wheel.position()
    if position is None:
        raise LostError(
            f"filter wheel: reports no slot {when} the exposure of {step.label}, but slot {step.slot} is needed. The "
            "wheel is moving or was reconnected; check whether it turns, and check its cable"
        )
    if position != step.slot:
        raise WrongPositionError(
            f"filter wheel: reports slot {position} {when} the exposure of {step.label}, but slot {step.slot} is "
            "needed. The wheel slipped or is not where the operator left it; home the wheel and start again"
        )
    return position


def _require_lights(opened: OpenRig, planned: LightState) -> tuple[LightName, ...]:
    """Return the lights that are on after checking that it is the planned one alone."""
    states: dict[LightName, bool] = {"lamp": opened.lamp.state(), "laser": opened.laser.state()}
    for name, on in states.items():
        if on != (name == planned):
            raise (CaptureError if on else LightLostError)(
                f"{name}: reports that it is {('on' if on else 'off')}, but this step needs the state '{planned}'; "
                f"check the connection, switch and interlock of the {name}"
            )
    return tuple(name for name, on in states.items() if on)


T = TypeVar("T")
RETAKEN: Final = (BadFrameError, FrameSizeError, LostError, WrongPositionError, TimedOutError)
"""What another attempt may mend. A device that is late again is stuck."""
ATTEMPTS: Final = 4
"""Exposures before a frame that is refused every time ends the capture."""


def within_attempts(once: Callable[[int], T], on_refusal: Callable[[str], None], what: str) -> tuple[T, int]:
    """Return what `once` returns and how many attempts it took, four at most.

    Parameters
    ----------
    once
        Called with the number of the attempt, from 1.
    on_refusal
        Called with a text for every attempt that is repeated.
    what
        What is exposed, for the texts.

    Raises
    ------
    BadFrameError, FrameSizeError, LostError, WrongPositionError
        Every attempt failed.
    TimedOutError
        Two attempts were late.
    HealingTimeError
        Faults have held the session up for longer than it stated.
    """
    attempt = late = 0
    while True:
        attempt, began = attempt + 1, beginning()
        try:
            return once(attempt), attempt
        except LightLostError:
            raise  # another attempt in the dark mends nothing
        except RETAKEN as error:
            late += isinstance(error, TimedOutError)
            if late > 1 or attempt == ATTEMPTS:
                raise type(error)(f"{error} ({attempt} attempts at {what})") from error
            on_refusal(f"{what}, attempt {attempt}: {error}")
            lost_since(began)


DEADLINE_EXPOSURES: Final = 3.0
"""A camera that runs freely may have to end one exposure before it begins the one asked for."""


class TactileCamera:
    """A camera behind checks of what it delivers.

    Parameters
    ----------
    camera, settings
        The open camera and what the rig file says about it.
    one_exposure
        Whether the session needs one exposure time only, so that a camera may leave it unknown.
    on_refusal
        Called with a text for every frame that is refused and taken again.
    """

    def __init__(
        self, camera: Camera, settings: CameraSettings, one_exposure: bool, on_refusal: Callable[[str], None]
    ) -> None:
        self._frames, self._settings, self._one_exposure = NewFrames(camera, settings), settings, one_exposure
        self._on_refusal = on_refusal

    def expose(self, exposure_s: float) -> tuple[RawFrame, int]:
        """Return a frame and how many attempts it took, four at most.

        Raises
        ------
        BadFrameError, FrameSizeError, LostError
            Every attempt failed.
        RefusedError
            The camera used another exposure, or delivers what a tactile capture cannot hold.
        """
        return within_attempts(lambda attempt: self._once(exposure_s), self._on_refusal, f"{exposure_s:g} s")

    def _once(self, exposure_s: float) -> RawFrame:
        """Take one frame and check it."""
        raw = self._frames.expose(exposure_s, DEADLINE_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S)
        if not math.isfinite(raw.exposure_s):
            if not self._one_exposure:
                raise RefusedError(
                    "camera: does not report its exposure time, so all images of a bracket would have the same "
                    "exposure; give only one exposure in exposures_s, as set at the camera's server"
                )
        elif abs(raw.exposure_s / exposure_s - 1.0) > EXPOSURE_TOLERANCE_REL:
            raise RefusedError(
                f"camera: an exposure of {exposure_s:g} s was requested, but the camera reads back {raw.exposure_s:g} "
                f"s (a difference of up to {100 * EXPOSURE_TOLERANCE_REL:.0f} % is allowed); correct the exposures of "
                "the plan or the limits of the rig"
            )
        self._require_images(raw)
        self._frames.require_new(raw)
        return raw

    def _require_images(self, raw: RawFrame) -> None:
        """Refuse what is neither a Bayer frame nor an RGB picture of the rig's size and bit depth."""
        asked = (self._settings.height_px, self._settings.width_px)
        counts, pixels = raw.counts, str(raw.settings.get("pixel_format", ""))
        if counts.shape not in (asked, (*asked, 3)):
            raise FrameSizeError(
                f"camera: delivered a frame of {' x '.join(map(str, counts.shape))}, but the rig file states "
                f"{asked[0]} x {asked[1]} px (height x width); correct the rig file"
            )
        if pixels.lower().startswith("mono"):
            raise RefusedError(
                f"camera: delivers {pixels}, but a tactile capture needs colours (Bayer RGGB or RGB); use a colour "
                "camera"
            )
        if int(counts.max()) >= 2**self._settings.bit_depth:
            raise RefusedError(
                f"camera: delivered a count of {counts.max()} DN, more than camera.bit_depth = "
                f"{self._settings.bit_depth} allows ({2**self._settings.bit_depth - 1} DN); correct the rig file"
            )


Counts = NDArray[np.uint16]
BRIGHTEST_PERCENTILE = 99.9
SATURATED_STEPS_DOWN = 3
# A signal below this share of full scale is mostly noise: it guides the next guess but decides nothing.
TRUSTED_SIGNAL_FRACTION = 0.05
LONG_EXPOSURE_S = 2.0
"""From here on metering says that it exposes: a person would think that it hangs."""


def exposure_ladder(shortest_s: float, longest_s: float) -> tuple[float, ...]:
    """Return the exposures (s) that captures use: the shortest times powers of two, up to the longest.

    Few distinct exposures mean few dark frames.
    """
    rungs = math.floor(math.log2(longest_s / shortest_s) + 1e-9) + 1 if longest_s > shortest_s else 1
    return tuple(shortest_s * 2.0**k for k in range(rungs))


def rung_at_or_below(ladder: tuple[float, ...], exposure_s: float) -> float:
    """Return the longest exposure of the ladder (s) that is not longer than `exposure_s`, at least the first."""
    tolerance = 1.0 + 1e-9  # 0.25 of a rung must find the rung two below despite rounding
    return max((rung for rung in ladder if rung <= exposure_s * tolerance), default=ladder[0])


def brightest_dn(counts: Counts) -> float:
    """Return the 99.9 percentile (DN) of the brightest of the four Bayer sites of a region."""
    sites = [counts[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    return max(float(np.percentile(site, BRIGHTEST_PERCENTILE)) for site in sites)


def saturated_fraction(counts: Counts, full_scale_dn: int) -> float:
    """Return the share of pixels (0..1) at full scale."""
    return float(np.mean(counts >= full_scale_dn))


def meter_exposure(
    take: Callable[[float], Counts],
    ladder: tuple[float, ...],
    full_scale_dn: int,
    black_level_dn: float,
    target_fraction: float,
    what: str,
    first_guess_s: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> float:
    """Find the longest exposure of the ladder with which nothing in the metered region is too bright.

    The 99.9 percentile of the brightest Bayer site stays at or below `target_fraction` of full scale, and no
    pixel saturates. The search brackets the answer and predicts the next rung from the signal, which is
    proportional to the exposure.

    Parameters
    ----------
    take
        Takes a frame with an exposure (s) and returns the counts of the metered region (DN), shape (h, w).
    ladder
        Allowed exposures (s), increasing.
    full_scale_dn, black_level_dn
        Largest count and count without light (DN).
    target_fraction
        Largest brightness as a fraction of full scale.
    what
        Filter and light in words, for the message.
    first_guess_s
        Where to start (s), such as the exposure of a similar step; the middle of the ladder if left out.
    tell
        Called with a text before every long exposure, for whoever waits.

    Returns
    -------
    float
        Exposure (s), one of the ladder.

    Raises
    ------
    SaturatedError
        Even the shortest exposure is too bright.
    CaptureError
        The black level alone reaches the target.
    """
    room_dn = metering_room_dn(target_fraction, full_scale_dn, black_level_dn)
    fits, fails = -1, len(ladder)
    guess = len(ladder) // 2 if first_guess_s is None else ladder.index(rung_at_or_below(ladder, first_guess_s))
    while fails - fits > 1:
        rung = min(max(guess, fits + 1), fails - 1)
        if ladder[rung] >= LONG_EXPOSURE_S:
            tell(
                f"metering {what}: the exposure is now {ladder[rung]:.3g} s, because the signal is low; the "
                f"rig file allows at most {ladder[-1]:.3g} s"
            )
        counts = take(ladder[rung])
        peak_dn = brightest_dn(counts)
        signal_dn = max(peak_dn - black_level_dn, 1.0)
        rungs_up = math.floor(math.log2(room_dn / signal_dn))
        if counts.max() >= full_scale_dn or peak_dn > target_fraction * full_scale_dn:
            fails = rung
            guess = rung - SATURATED_STEPS_DOWN if peak_dn >= full_scale_dn else rung + min(rungs_up, -1)
        else:
            fits = rung
            guess = rung + max(rungs_up, 1)
            if signal_dn >= TRUSTED_SIGNAL_FRACTION * full_scale_dn:
                fails = min(fails, rung + max(rungs_up, 0) + 1)
    if fits < 0:
        raise SaturatedError(
            f"{what}: the region is brighter than {100 * target_fraction:.0f} % of full scale ({full_scale_dn} DN) "
            f"even at the shortest exposure (the camera allows {ladder[0]:g} to {ladder[-1]:g} s); dim the light, "
            "close the aperture or raise target_fraction"
        )
    return ladder[fits]


def require_ready(opened: OpenRig, steps: Sequence[Step]) -> None:
    """Check the open devices against the steps: slots exist, lights are off.

    Raises
    ------
    CaptureError
        The wheel lacks a slot, or a light is on.
    """
    lost = sorted({step.slot for step in steps if step.slot is not None} - set(opened.wheel.slots))
    if lost:
        raise CaptureError(
            f"filter wheel: has no slot {lost[0]}, only {', '.join(map(str, opened.wheel.slots))}; correct the slots "
            "in the rig file, or split the plan into sessions with fewer filters"
        )
    for name, light in (("lamp", opened.lamp), ("laser", opened.laser)):
        if light.state():
            raise CaptureError(
                f"{name}: is on although nothing has switched it on; switch it off and check its controller"
            )
