"""Tuning files in the layouts of libcamera, with round numbers; no shipped file is copied."""

from typing import Any

import numpy as np

GAMMA = 1 / 2.2


def algorithms(contrast_adapts: bool = True, table_shape: tuple[int, int] = (12, 16)) -> dict[str, Any]:
    """The algorithms that matter, and one that does not."""
    knots = np.linspace(0, 1, 33)
    curve = np.column_stack([65535 * knots, 65535 * knots**GAMMA]).ravel()
    rows, columns = table_shape
    luminance = 1.0 + np.add.outer(np.linspace(-1, 1, rows) ** 2, np.linspace(-1, 1, columns) ** 2)
    cells = rows * columns
    return {
        "rpi.black_level": {"black_level": 4096},
        "rpi.lux": {"reference_gain": 1.0},
        "rpi.alsc": {
            "luminance_strength": 0.5,
            "luminance_lut": luminance.ravel().tolist(),
            "calibrations_Cr": [{"ct": 3000, "table": [1.2] * cells}, {"ct": 5000, "table": [1.6] * cells}],
            "calibrations_Cb": [{"ct": 4000, "table": np.linspace(1, 2, cells).tolist()}],
        },
        "rpi.contrast": {"ce_enable": int(contrast_adapts), "gamma_curve": curve.tolist()},
        "rpi.ccm": {
            "ccms": [
                {"ct": 3000, "ccm": [2.0, -0.6, -0.4, -0.5, 2.0, -0.5, -0.2, -0.8, 2.0]},
                {"ct": 5000, "ccm": [1.6, -0.4, -0.2, -0.3, 1.6, -0.3, 0.0, -0.6, 1.6]},
            ]
        },
    }


def version_2(contrast_adapts: bool = True, table_shape: tuple[int, int] = (12, 16)) -> dict[str, Any]:
    """Layout "version 2.0": a list of one-entry tables."""
    entries = [{name: parameters} for name, parameters in algorithms(contrast_adapts, table_shape).items()]
    return {"version": 2.0, "target": "pisp" if table_shape == (32, 32) else "bcm2835", "algorithms": entries}


def metadata(**changes: Any) -> dict[str, Any]:
    """What rpicam-still writes about an image with locked settings; None removes a control."""
    table = {
        "SensorBlackLevels": [4096, 4096, 4096, 4096],
        "ExposureTime": 10_000,
        "AnalogueGain": 1.0,
        "DigitalGain": 1.0,
        "ColourGains": [2.0, 1.5],
        "ColourTemperature": 4000,
        "ColourCorrectionMatrix": [1.8, -0.5, -0.3, -0.4, 1.8, -0.4, -0.1, -0.7, 1.8],
        "AeState": 0,
        "Lux": 400.0,
    }
    return {name: value for name, value in (table | changes).items() if value is not None}
