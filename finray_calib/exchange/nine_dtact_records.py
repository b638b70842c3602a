"""9DTact calibration folders as records: a tactile capture, and a table prediction carried over from another sensor."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import ContactCircle, IndenterPose, TactileCapture
from data_schemas.simulate import SimulatedPress
from finray_calib.exchange.nine_dtact_folder import NineDTactSensor, read_nine_dtact
from finray_calib.exchange.nine_dtact_table import predict_press

TABLE_LABEL = "table, not rendered"


def tactile_capture(folder: Path) -> TactileCapture:
    """Read a sensor folder of 9DTact (ball press, no contact, repeat of no contact) as a tactile capture.

    The images are camera-encoded 8-bit values whose transfer curve nobody recorded: ``encoding`` is "unknown".
    """
    sensor = read_nine_dtact(folder)
    return TactileCapture(
        name=_name(folder),
        contact=sensor.sample_rgb.astype(np.uint16),
        no_contact=sensor.no_contact_rgb.astype(np.uint16),
        repeat_no_contact=sensor.repeat_no_contact_rgb.astype(np.uint16),
        layout="RGB",
        encoding="unknown",
        bit_depth=8,
        black_level_dn=0.0,
        exposure_s=None,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=sensor.ball_radius_mm, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(
            row_px=float(sensor.circle.center_px[0]),
            column_px=float(sensor.circle.center_px[1]),
            radius_px=float(sensor.circle.radius_px),
        ),
        mm_per_px=sensor.mm_per_px,
        source=f"9DTact calibration folder '{folder.name}' (MIT licence, (c) Changyi Lin)",
    )


def table_prediction(folder: Path, other: Path) -> SimulatedPress:
    """Predict the ball press of `folder` with the darkening-to-depth table of the sensor in `other`.

    The prediction darkens the no-contact image inside the contact circle only: it knows no optics and no
    mechanics, and is the baseline that a rendered press has to beat.
    """
    sensor, donor = read_nine_dtact(folder), read_nine_dtact(other)
    predicted = predict_press(
        sensor.no_contact_rgb, sensor.circle, sensor.mm_per_px, sensor.ball_radius_mm, donor.depth_table_mm
    )
    return SimulatedPress(
        name=f"{_name(folder)}, table of {other.name}",
        label=TABLE_LABEL,
        method="table",
        encoding="unknown",
        no_contact=sensor.no_contact_rgb.astype(np.float32),
        contact=np.asarray(predicted, dtype=np.float32),
        distance=_distance(sensor),
        variance=None,
        light_angle_deg=None,
        design=None,
        notes=(f"depth table carried over from {other.name}; nothing is rendered",),
    )


def _name(folder: Path) -> str:
    """Name a capture after its folder."""
    return f"9DTact {folder.resolve().name}"


def _distance(sensor: NineDTactSensor) -> NDArray[np.float32]:
    """Return the distance of each pixel from the circle's centre in radii."""
    rows, columns = np.indices(sensor.sample_rgb.shape[:2])
    row, column = sensor.circle.center_px
    distance: NDArray[np.float64] = np.hypot(rows - row, columns - column) / sensor.circle.radius_px
    return distance.astype(np.float32)
