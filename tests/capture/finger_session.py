"""A tactile session on the picamera2 stand-in: plan, rig, operator and what the sensor sees."""

from itertools import count
from pathlib import Path

import numpy as np

from data_schemas import TactilePlan, TactileRig, TactileSession
from data_schemas.storage import read_toml
from rigs.capture import SessionRequest, capture_tactile_session

WIDTH_PX, HEIGHT_PX = 96, 64
PLAN = """\
kind = "tactile"
name = "finger 3, ball"
design = "finger 3"
exposures_s = [0.01]
no_contact_images = 2
led_current_ma = 20.0
light_angle_deg = 30.0
light_angle_uncertainty_deg = 0.5
mm_per_px = 0.1
[indenter]
shape = "ball"
radius_mm = 4.0
[[presses]]
depth_mm = 1.0
position_mm = 35.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1
tilt_uncertainty_deg = 0.3
[[presses]]
depth_mm = 1.5
position_mm = 40.0
tilt_deg = 5.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1
"""
RIG = f"""\
name = "finger on a Pi"
[camera]
driver = "picamera2"
address = "0"
width_px = {WIDTH_PX}
height_px = {HEIGHT_PX}
bit_depth = 10
"""


SEEDS = count(1)
"""A camera of the same noise twice is one that delivers an old frame."""


class Hands:
    """An operator who notes what is asked and does something at it."""

    def __init__(self, act=lambda text: None) -> None:
        self.asked, self._act = [], act

    def do(self, text: str) -> None:
        self.asked.append(text)
        self._act(text)


def plan_of(folder: Path, text: str = PLAN) -> TactilePlan:
    path = folder / "tactile.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, TactilePlan)


def rig_of(folder: Path, text: str = RIG) -> TactileRig:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, TactileRig)


def capture(folder: Path, plan: TactilePlan, rig: TactileRig, hands: Hands, **asked) -> TactileSession:
    return capture_tactile_session(
        rig, plan, plan.presses, SessionRequest(folder / "out", "pytest", rig_folder=folder, operator=hands, **asked)
    )


def scene(sensor, contact: bool):
    """Light proportional to the exposure above the black level; a contact brightens the middle by half."""
    width, height = sensor.size
    rng = np.random.default_rng(next(SEEDS))

    def counts(exposure_s: float) -> np.ndarray:
        light = np.full((height, width), 2e4)
        light[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4] *= 1.5 if contact else 1.0
        return 64 + exposure_s * light + rng.normal(0, 1, light.shape)

    return counts


def pressing(sensor) -> Hands:
    def act(text: str) -> None:
        sensor.scene = scene(sensor, contact=text.startswith("Press"))

    return Hands(act)
