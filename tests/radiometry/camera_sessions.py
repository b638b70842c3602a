"""Synthetic camera sessions: frames of a sensor with known gain and noise under an even lamp."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_schemas import (
    BandPassFilter,
    CameraPlan,
    CameraSession,
    CameraSettings,
    FilterWheelSettings,
    Frame,
    FrameType,
    RegionOfInterest,
    RigFile,
    SimulatedBench,
)
from rigs.simulated.sensor import Sensor
from tests.radiometry.sessions import PAINT

GAIN_E_PER_DN, READ_NOISE_E, BLACK_LEVEL_DN, DARK_CURRENT_E_PER_S = 2.0, 7.0, 64.0, 40.0
PRNU_REL, DSNU_E, FULL_WELL_E = 0.01, 3.0, 7000.0
SENSOR = Sensor(
    bit_depth=12,
    black_level_dn=BLACK_LEVEL_DN,
    gain_e_per_dn=GAIN_E_PER_DN,
    read_noise_e=READ_NOISE_E,
    dark_current_e_per_s=DARK_CURRENT_E_PER_S,
    full_well_e=FULL_WELL_E,
    prnu_rel=PRNU_REL,
    dsnu_e=DSNU_E,
    seed=3,
)
# Even levels up to 1.15 of the full well in 20 ms; the long dark exposure resolves the dark current.
SATURATION_S = 0.02
EXPOSURES_S = tuple(float(t) for t in np.linspace(1.15 / 16, 1.15, 16) * SATURATION_S)
LONG_DARK_S = 5.0
# Frames of red, green and blue relative to the brightest.
EVEN_LIGHT = (1.0, 1.0, 1.0)


@dataclass
class SyntheticCameraSession:
    """A session record and the frames behind it."""

    session: CameraSession
    frames: dict[str, np.ndarray]

    def read(self, frame: Frame) -> np.ndarray:
        return self.frames[frame.file]

    def change(self, change: Callable[[Frame, np.ndarray], np.ndarray | None]) -> "SyntheticCameraSession":
        """Return the session with every frame replaced, or left out where `change` returns None."""
        changed = {f.file: change(f, self.frames[f.file].copy()) for f in self.session.frames}
        kept = {file: counts for file, counts in changed.items() if counts is not None}
        frames = tuple(f for f in self.session.frames if f.file in kept)
        return SyntheticCameraSession(self.session.model_copy(update={"frames": frames}), kept)


def camera_session(
    rng: np.random.Generator,
    sensor: Sensor = SENSOR,
    side_px: int = 64,
    repeats: int = 0,
    light: tuple[float, float, float] = EVEN_LIGHT,
    flicker_rel: float = 0.0,
    exposures_s: tuple[float, ...] = EXPOSURES_S,
) -> SyntheticCameraSession:
    """Expose pairs at every level, lit and dark, `repeats` more at the middle one, and a pair of long darks."""
    rate = np.empty((side_px, side_px))
    rate[0::2, 0::2], rate[1::2, 1::2] = light[0], light[2]
    rate[0::2, 1::2] = rate[1::2, 0::2] = light[1]
    rate *= FULL_WELL_E / SATURATION_S
    frames: list[Frame] = []
    stored: dict[str, np.ndarray] = {}

    def take(frame_type: FrameType, exposure_s: float, number: int) -> None:
        for _ in range(number):
            level = 0.0 if frame_type == "dark" else 1.0 + flicker_rel * rng.standard_normal()
            frame = _frame(len(frames), frame_type, exposure_s)
            frames.append(frame)
            stored[frame.file] = sensor.expose(level * rate, exposure_s, rng)

    middle = exposures_s[len(exposures_s) // 2 - 1]
    for exposure_s in exposures_s:
        take("white", exposure_s, 2 + repeats * (exposure_s == middle))
        take("dark", exposure_s, 2 + repeats * (exposure_s == middle))
    take("dark", LONG_DARK_S, 2)
    plan = CameraPlan(
        camera_name="c", region=RegionOfInterest(row_px=0, column_px=0, height_px=side_px, width_px=side_px)
    )
    return SyntheticCameraSession(CameraSession(plan=plan, rig=rig_of(sensor, side_px), frames=tuple(frames)), stored)


def rig_of(sensor: Sensor, side_px: int) -> RigFile:
    """Return a rig whose settings know only what a user knows: size and bits."""
    camera = CameraSettings(width_px=side_px, height_px=side_px, bit_depth=12)
    wheel = FilterWheelSettings(filters=(BandPassFilter(slot=1, name="532", center_nm=532.0),))
    return RigFile(name="r", camera=camera, filter_wheel=wheel, simulated=SimulatedBench(paint=PAINT))


def _frame(number: int, frame_type: FrameType, exposure_s: float) -> Frame:
    return Frame(
        sequence=number,
        file=f"frames/{number:04d}.tiff",
        frame_type=frame_type,
        target="white",
        light="off" if frame_type == "dark" else "lamp",
        filter_name=None,
        slot_before=None,
        slot_after=None,
        exposure_requested_s=exposure_s,
        exposure_s=exposure_s,
        captured_utc="2026-01-01T00:00:00+00:00",
        saturated_fraction=0.0,
        sha256="0" * 64,
    )
