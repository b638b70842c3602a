"""What the driver uses of picamera2, after its source and the metadata tables of its manual: no Raspberry Pi is here.

It follows picamera2 where that matters: a raw buffer is bytes with padding, controls set while stopped hold from the
first frame, controls set while running hold a few frames later, exposures come in lines, and the time stamp is that of
the first pixel's readout.
"""

import threading
import time
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

LINE_US = 19
PADDING_VALUES = 16


class Sensor:
    """What is in front of the camera and how it misbehaves; one for all cameras of a test."""

    def __init__(self) -> None:
        self.order, self.size, self.bit_depth = "BGGR", (98, 66), 10  # width x height
        self.container_bits = 10
        self.scene: Any = lambda exposure_s: np.full((self.size[1], self.size[0]), 64 + 1e4 * exposure_s)
        self.frames_late = 0  # until controls hold
        self.keeps: dict[str, Any] = {}  # what reads back whatever was asked
        self.lacks: tuple[str, ...] = ()
        self.answers_format: str | None = None
        self.silent = self.broken = self.cannot_start = False
        self.cameras = [{"Model": "imx219", "Location": 2, "Rotation": 180, "Id": "/base/i2c/imx219@10", "Num": 0}]
        self.hangs: threading.Event | None = None  # until it is set
        self.log: list[str] = []


class Job:
    def __init__(self, camera: "Picamera2") -> None:
        self._camera = camera

    def get_result(self, timeout: float | None = None) -> "Request":
        sensor = self._camera.sensor
        if sensor.broken:
            raise RuntimeError("Camera frontend has timed out!")
        if sensor.silent:
            time.sleep(timeout or 0.0)
            raise TimeoutError
        return Request(self._camera)


class Request:
    def __init__(self, camera: "Picamera2") -> None:
        self._camera = camera
        self._metadata, self._counts = camera.next_frame()
        camera.held += 1
        assert camera.held <= camera.buffers, "requests must be released"

    def get_metadata(self) -> dict[str, Any]:
        return self._metadata

    def make_array(self, name: str) -> np.ndarray:
        assert name == "raw"
        shift = 16 - self._camera.sensor.bit_depth if self._camera.sensor.container_bits == 16 else 0
        values = np.pad(self._counts << shift, ((0, 0), (0, PADDING_VALUES)), constant_values=0xFFFF)
        return values.astype("<u2").view(np.uint8)

    def release(self) -> None:
        self._camera.held -= 1


class Picamera2:
    sensor = Sensor()

    @staticmethod
    def global_camera_info() -> list[dict[str, Any]]:
        return Picamera2.sensor.cameras

    def __init__(self, camera_num: int = 0) -> None:
        if Picamera2.sensor.keeps.get("in use"):
            raise RuntimeError("Camera __init__ sequence did not complete.")
        self.held, self.buffers, self.started = 0, 0, False
        self._asked: dict[str, Any] = {"ExposureTime": 9977, "AnalogueGain": 8.0, "ColourGains": (2.1, 1.4)}
        self._held: list[dict[str, Any]] = []

    @property
    def sensor_modes(self) -> list[dict[str, Any]]:
        s = self.sensor
        width, height = s.size
        unpacked = f"S{s.order}{s.bit_depth}"
        return [
            {"format": f"{unpacked}_CSI2P", "unpacked": unpacked, "bit_depth": s.bit_depth, "size": (width, height)},
            {"format": f"S{s.order}8", "unpacked": f"S{s.order}8", "bit_depth": 8, "size": (width, height)},
            {"format": "MJPEG"},
        ]

    camera_properties: ClassVar = {"Model": "imx219", "PixelArraySize": (3280, 2464)}
    camera_controls: ClassVar = {
        "ExposureTime": (75, 11_766_829, 20_000),
        "AnalogueGain": (1.0, 10.666667, 1.0),
        "FrameDurationLimits": (47_183, 11_767_556, 33_333),
    }

    def create_still_configuration(self, raw: dict[str, Any], buffer_count: int, queue: bool) -> dict[str, Any]:
        return {"main": {"format": "BGR888"}, "raw": dict(raw), "buffer_count": buffer_count, "queue": queue}

    def configure(self, config: dict[str, Any]) -> None:
        s = self.sensor
        answered = s.answers_format or f"S{s.order}{s.container_bits}"
        self._config = config | {
            "raw": config["raw"] | {"format": answered, "stride": 2 * (s.size[0] + PADDING_VALUES)}
        }
        self.buffers = config["buffer_count"]

    def camera_configuration(self) -> dict[str, Any]:
        return self._config

    def start(self) -> None:
        if self.sensor.cannot_start:
            raise RuntimeError("Failed to start camera: Input/output error")
        self.started = True
        self.sensor.log.append("start")

    def stop(self) -> None:
        if self.sensor.hangs is not None:
            self.sensor.hangs.wait(30.0)
        self.started = False

    def close(self) -> None:
        assert self.held == 0, "requests must be released"
        self.sensor.log.append("close")

    def set_controls(self, controls: dict[str, Any]) -> None:
        assert controls["AeEnable"] is False
        assert controls["AwbEnable"] is False
        self._held = [self._asked] * self.sensor.frames_late
        self._asked = dict(controls)
        self.sensor.log.append(f"set {controls['ExposureTime']} us")

    def capture_request(self, wait: bool = True) -> Job:
        assert self.started
        assert wait is False, "a wait without a deadline"
        return Job(self)

    def cancel_all_and_flush(self) -> None:
        self.sensor.log.append("cancel")

    def next_frame(self) -> tuple[dict[str, Any], np.ndarray]:
        """The metadata of one frame as the manual prints it, and its counts; the first frame is older than the call."""
        s = self.sensor
        asked = self._held.pop() if self._held else self._asked
        lines = max(round(asked["ExposureTime"] / LINE_US), 1)
        exposure_us = s.keeps.get("ExposureTime", lines * LINE_US)
        time.sleep(min(1e-6 * exposure_us, 0.05))
        counts = np.clip(s.scene(exposure_us * 1e-6), 0, 2**s.bit_depth - 1).astype(np.uint16)
        metadata = {
            "AeState": 0,
            "AnalogueGain": s.keeps.get("AnalogueGain", asked["AnalogueGain"]),
            "ColourCorrectionMatrix": (1.8, -0.6, -0.2, -0.4, 1.9, -0.5, 0.0, -0.8, 1.8),
            "ColourGains": s.keeps.get("ColourGains", asked["ColourGains"]),
            "ColourTemperature": 4000,
            "DigitalGain": 1.0,
            "ExposureTime": exposure_us,
            "FrameDuration": max(47_183, exposure_us + 500),
            "Lux": 112.3,
            "ScalerCrop": (0, 0, 3280, 2464),
            "SensorBlackLevels": (4096, 4096, 4096, 4096),
            "SensorTimestamp": time.monotonic_ns() - s.keeps.get("age_ns", 0),
        }
        return {name: value for name, value in metadata.items() if name not in s.lacks}, counts


def module() -> ModuleType:
    """A module ``picamera2`` with a new sensor."""
    Picamera2.sensor = Sensor()
    stand_in = ModuleType("picamera2")
    stand_in.Picamera2 = Picamera2  # type: ignore[attr-defined]
    return stand_in
