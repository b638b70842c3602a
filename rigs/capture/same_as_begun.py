"""What must be as it was when an interrupted session goes on: the curve files and the camera."""

from typing import Any

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import CaptureError
from rigs.capture.resume import Interrupted


def require_same_inputs(interrupted: Interrupted, inputs: dict[str, str]) -> None:
    """Refuse to go on with other curves than the session began with.

    Raises
    ------
    CaptureError
        A curve file changed.
    """
    before: dict[str, str] = interrupted.start["inputs"]
    changed = sorted(name for name in before.keys() | inputs.keys() if before.get(name) != inputs.get(name))
    if changed:
        raise CaptureError(
            f"{changed[0]}: changed since the session began; restore the file, or capture the session again"
        )


def require_same_camera(interrupted: Interrupted, camera: DeviceIdentity) -> None:
    """Refuse to go on with another camera than the session began with: an address may have another behind it now.

    Raises
    ------
    CaptureError
        Another camera answers; sessions of old versions do not say which it was.
    """
    before = interrupted.start.get("camera")
    if before is not None and _named(before) != _named(camera.model_dump()):
        raise CaptureError(
            f"camera: {_named(camera.model_dump())} answers now; the session began with {_named(before)}: connect that "
            "one, or capture the session again"
        )


def _named(camera: Any) -> str:
    """Return a camera in words; a new firmware does not make it another."""
    said = camera if isinstance(camera, dict) else {}
    return f"{said.get('vendor', '')} {said.get('model', '')} (serial '{said.get('serial', '')}')".strip()
