"""Frames of a finray session as ROS 2 messages: published by a node, or written to a bag without ROS.

    python session_to_ros2.py SESSION                 a node; needs ROS 2 (rclpy and the message packages)
    python session_to_ros2.py SESSION --bag FOLDER    a bag for `ros2 bag play`; needs pip install rosbags

Topics: /finray/image_raw (sensor_msgs/Image: raw counts with their Bayer pattern), /finray/camera_info
(sensor_msgs/CameraInfo) and, where the presses of a tactile session hold a force, /finray/wrench
(geometry_msgs/WrenchStamped). A message is a plain dictionary of its fields here, so that both ways fill it alike.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from data_schemas import TactileCapture, TactileSession
from data_schemas.storage import read_record
from finray_calib.exchange import SessionFrames, read_session_frames

IMAGE, INFO, WRENCH = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "geometry_msgs/msg/WrenchStamped"
TOPICS = {IMAGE: "/finray/image_raw", INFO: "/finray/camera_info", WRENCH: "/finray/wrench"}
INNER = {
    "header": "std_msgs/msg/Header",
    "stamp": "builtin_interfaces/msg/Time",
    "roi": "sensor_msgs/msg/RegionOfInterest",
    "wrench": "geometry_msgs/msg/Wrench",
    **dict.fromkeys(("force", "torque"), "geometry_msgs/msg/Vector3"),
}
FRAME_ID = "finray_camera"
PAD = "finray_pad"
Message = tuple[str, int, dict[str, Any]]  # type, time in ns since 1970, fields


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    """Return the fields of a std_msgs/Header."""
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": frame_id}


def image(counts: np.ndarray, pattern: str, bit_depth: int, stamp_ns: int) -> dict[str, Any]:
    """Return the fields of a sensor_msgs/Image: rows one after another, little-endian, 16 bits a sample.

    Counts are moved up to fill 16 bits, because the encodings of sensor_msgs know no 10 or 12 bits; the shift is
    exact, so counts >> (16 - bit_depth) gives them back.
    """
    rows, columns = counts.shape[:2]
    samples = 1 if counts.ndim == 2 else counts.shape[2]
    shifted = np.left_shift(counts.astype("<u2"), 16 - bit_depth).astype("<u2")
    return {
        "header": header(stamp_ns, FRAME_ID),
        "height": rows,
        "width": columns,
        "encoding": f"bayer_{pattern.lower()}16" if samples == 1 else "rgb16",
        "is_bigendian": 0,
        "step": columns * samples * 2,
        "data": np.ascontiguousarray(shifted).view(np.uint8).reshape(-1),
    }


def camera_info(rows: int, columns: int, stamp_ns: int) -> dict[str, Any]:
    """Return the fields of a sensor_msgs/CameraInfo of a camera that is not calibrated: its matrices are zero."""
    return {
        "header": header(stamp_ns, FRAME_ID),
        "height": rows,
        "width": columns,
        "distortion_model": "",
        "d": np.zeros(0),
        "k": np.zeros(9),
        "r": np.zeros(9),
        "p": np.zeros(12),
        "binning_x": 1,
        "binning_y": 1,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def wrench(force_n: float, stamp_ns: int) -> dict[str, Any]:
    """Return the fields of a geometry_msgs/WrenchStamped: the force along z, into the pad; no torque is measured."""
    none = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"header": header(stamp_ns, PAD), "wrench": {"force": none | {"z": force_n}, "torque": none}}


def messages(session: SessionFrames) -> Iterator[Message]:
    """Yield the messages of a session in the order of their times."""
    first_ns = round(1e9 * session.first.start_unix_s)
    forces = forces_of(session)
    for frame in sorted(session.frames, key=lambda frame: frame.start_s):
        counts = session.counts(frame)
        stamp_ns = first_ns + round(1e9 * frame.start_s)  # by the clock that never steps, where the record holds it
        yield IMAGE, stamp_ns, image(counts, session.camera.bayer_pattern, session.camera.bit_depth, stamp_ns)
        yield INFO, stamp_ns, camera_info(*counts.shape[:2], stamp_ns)
        force_n = forces.pop(frame.facts.get("place"), None) if frame.frame_type == "contact" else None
        if force_n is not None:
            yield WRENCH, stamp_ns, wrench(force_n, stamp_ns)


def forces_of(session: SessionFrames) -> dict[Any, float]:
    """Return number of the press -> its force, of the presses of a tactile session that hold one."""
    if session.kind != "tactile":
        return {}
    stored = read_record(session.folder / "session.json", TactileSession)
    captures = [read_record(session.folder / file, TactileCapture) for file in stored.captures]
    return {place: one.force_n for place, one in enumerate(captures, 1) if one.force_n is not None}


def filled(kind: str, fields: dict[str, Any], make: Any) -> Any:
    """Return a message of rosbags with its fields; `make` is the store's table of message types."""
    inner = {name: filled(INNER[name], v, make) if isinstance(v, dict) else v for name, v in fields.items()}
    return make[kind](**inner)


def write_bag(session: SessionFrames, out: Path) -> int:
    """Write a bag that must be new; return the number of its messages."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, count = get_typestore(Stores.ROS2_HUMBLE), 0
    with Writer(out, version=9) as writer:
        topics = {kind: writer.add_connection(topic, kind, typestore=store) for kind, topic in TOPICS.items()}
        for kind, stamp_ns, fields in messages(session):
            message = filled(kind, fields, store.types)
            writer.write(topics[kind], stamp_ns, store.serialize_cdr(message, kind))
            count += 1
    return count


def publish(session: SessionFrames) -> None:
    """Publish a session once, in its own time."""
    import rclpy
    from rosidl_runtime_py import set_message_fields
    from rosidl_runtime_py.utilities import get_message

    rclpy.init()
    node = rclpy.create_node("finray_session")
    publishers = {kind: node.create_publisher(get_message(kind), topic, 10) for kind, topic in TOPICS.items()}
    begun_s, first_ns = time.monotonic(), None
    for kind, stamp_ns, fields in messages(session):
        first_ns = stamp_ns if first_ns is None else first_ns
        time.sleep(max(begun_s + 1e-9 * (stamp_ns - first_ns) - time.monotonic(), 0.0))
        message, data = get_message(kind)(), fields.pop("data", None)
        set_message_fields(message, {n: v.tolist() if hasattr(v, "tolist") else v for n, v in fields.items()})
        if data is not None:
            message.data.frombytes(data.tobytes())  # a list of numbers would take seconds
        publishers[kind].publish(message)
    node.destroy_node()
    rclpy.shutdown()


def main() -> None:
    """Publish, or write a bag."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("--bag", type=Path, metavar="FOLDER", help="write a bag in place of publishing")
    asked = parser.parse_args()
    session = read_session_frames(asked.session)
    if asked.bag is None:
        publish(session)
    else:
        print(f"{asked.bag}: {write_bag(session, asked.bag)} messages")


if __name__ == "__main__":
    main()
