"""Ask the user which of the devices that were found belong to the rig."""

import sys
from typing import TYPE_CHECKING

from finray_calib.cli.options import warn

if TYPE_CHECKING:
    from rigs.detect import FoundDevice
    from rigs.rig_template import Role


def chosen_devices() -> "dict[Role, FoundDevice]":
    """Return the devices that the user takes, by their role; none where nobody can be asked."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return {}
    from rigs.detect import detect

    warn("looking for devices ...")
    detection = detect()
    for note in detection.notes:
        warn(f"note: {note}")
    return choose(detection.devices)


def choose(devices: "tuple[FoundDevice, ...]") -> "dict[Role, FoundDevice]":
    """Offer each device for each role that it can have, until one is taken."""
    roles: dict[Role, str] = {"camera": "camera", "filter wheel": "filter wheel", "laser": "light", "lamp": "light"}
    chosen: dict[Role, FoundDevice] = {}
    for role, kind in roles.items():
        for device in devices:
            if device.kind != kind or device in chosen.values() or not _offered(role, device):
                continue
            chosen[role] = device
            break
    return chosen


def _offered(role: str, device: "FoundDevice") -> bool:
    """Ask whether a device is to be used; Enter means yes, the end of the input no."""
    sys.stderr.write(f"{role} found: {device.what} ({device.driver}, {device.address}); use it? [Y/n] ")
    sys.stderr.flush()
    answer = sys.stdin.readline()
    return bool(answer) and answer.strip().lower() in ("", "y", "yes")
