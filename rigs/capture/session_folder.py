"""The folder of a session: what it must be before, the names of its frames, and the checksums at its end."""

import re
from pathlib import Path

from data_schemas.capture import RegionOfInterest
from data_schemas.errors import CaptureError
from data_schemas.rig import CameraSettings, RigFile
from data_schemas.storage import sha256_of, write_bytes
from rigs.capture.paint_session import MANIFEST_NAME
from rigs.capture.plan import SMALLEST_REGION_PX, Step


def require_empty(out: Path) -> None:
    """Refuse a folder that holds something, or a path that is no folder.

    Raises
    ------
    CaptureError
        It does.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise CaptureError(
            f"{out}: exists already and is not an empty folder; a capture never overwrites: choose another --out"
        )


def require_region_inside(region: RegionOfInterest, camera: CameraSettings) -> None:
    """Refuse a region that is empty or leaves the frame.

    Raises
    ------
    CaptureError
        It is or does.
    """
    for axis, extent, start, size, limit in (
        ("row_px", "height_px", region.row_px, region.height_px, camera.height_px),
        ("column_px", "width_px", region.column_px, region.width_px, camera.width_px),
    ):
        if not (SMALLEST_REGION_PX <= size <= limit - start):
            raise CaptureError(
                f"plan.region: {axis} = {start} with {extent} = {size} must hold at least {SMALLEST_REGION_PX} px and "
                f"end inside the frame; {axis} + {extent} may be at most {limit} px"
            )


def curve_files(rig: RigFile, rig_folder: Path) -> dict[str, str]:
    """Return name -> SHA-256 of the curve files that the rig file names."""
    named = [] if rig.camera.response == "assumed" else [rig.camera.response]
    if rig.simulated is not None and rig.simulated.material is not None:
        named.append(rig.simulated.material)
    return {name: sha256_of(rig_folder / name) for name in named}


def frame_file(number: int, step: Step, exposure_s: float) -> str:
    """Return ``frames/NNNN_<type>_<filter>_<exposure>us.tiff`` with plain characters only."""
    words = (step.frame_type, step.filter_name or "none")
    kind, filter_name = (re.sub(r"[^A-Za-z0-9.-]+", "-", word) for word in words)
    return f"frames/{number:04d}_{kind}_{filter_name}_{round(exposure_s * 1e6)}us.tiff"


def write_manifest(out: Path) -> None:
    """Write the checksums of all files of the session in the format of ``sha256sum --check``."""
    files = sorted(path for path in out.rglob("*") if path.is_file())
    lines = [f"{sha256_of(path)}  {path.relative_to(out).as_posix()}\n" for path in files]
    write_bytes(out / MANIFEST_NAME, "".join(lines).encode())
