"""``finray radiometry`` on a paint session: band signals and, if asked for, the map of all pixels."""

from pathlib import Path

from data_schemas.camera import CameraCharacterisation
from data_schemas.capture import CaptureSession
from data_schemas.errors import RadiometryError
from data_schemas.product_set import ProductSet
from data_schemas.provenance import provenance
from data_schemas.radiometry import BandSignals
from data_schemas.storage import read_record, write_record
from finray_calib.cli.options import command_line, file_name, input_digests, naming, progress_bar, require_new, say
from finray_calib.radiometry.band_signals import bands_of_steps
from finray_calib.radiometry.pixel_signals import pixel_signals
from finray_calib.radiometry.session_steps import session_steps
from rigs.capture.read_session import read_frame_of, read_session
from rigs.capture.session_folder import SESSION_NAME


def reduce_paint(
    folder: Path, out: Path | None, camera: Path | None, pixels: bool, whole_frame: bool, accept_repeat: bool = False
) -> None:
    """Write the band signals of a paint session and, if asked for, the map of its pixels.

    Parameters
    ----------
    folder
        Folder of the session.
    out
        Where to write; a name after the paint if None.
    camera
        Characterisation of the camera whose gain, read noise and black level are used, if any.
    pixels, whole_frame
        Whether to write the map of the region's pixels, and whether it covers the whole frame.
    accept_repeat
        Whether a filter and its own repeat may disagree.
    """
    session = _with_camera(read_session(folder), camera)
    out = require_new(out or Path(f"{file_name(session.plan.paint_name)}.bands.json"))
    stem = out.name.removesuffix(".json").removesuffix(".bands")
    map_out = require_new(out.with_name(f"{stem}.pixels.json")) if pixels else None
    inputs = [folder / SESSION_NAME, *([] if camera is None else [camera])]
    origin = provenance(command_line(), input_digests(inputs))
    with progress_bar("radiometry"), naming(RadiometryError, folder):
        steps = session_steps(session, lambda frame: read_frame_of(folder, frame))
        bands = bands_of_steps(session, steps, accept_repeat)
        if map_out is not None:
            mapped = pixel_signals(session, lambda frame: read_frame_of(folder, frame), steps, bands, whole_frame)
    with ProductSet(out) as products:
        if map_out is not None:
            write_record(mapped, map_out, origin, products)
        write_record(bands, out, origin, products)
    _report(bands, out)
    if map_out is not None:
        say(f"{map_out}: {int(mapped.usable.sum())} usable of {mapped.usable.size} pixels")


def _with_camera(session: CaptureSession, path: Path | None) -> CaptureSession:
    """Give the session the gain, read noise and black level of a characterised camera."""
    if path is None:
        return session
    measured = read_record(path, CameraCharacterisation)
    camera = measured.applied_to(session.rig.camera)
    note = (
        f"camera characterisation '{measured.camera_name}' used: gain {camera.gain_e_per_dn:.4g} e/DN, read noise "
        f"{camera.read_noise_e:.3g} e, black level {camera.black_level_dn:.4g} DN"
    )
    rig = session.rig.model_copy(update={"camera": camera})
    return session.model_copy(update={"rig": rig, "notes": (*session.notes, note)})


def _report(bands: BandSignals, out: Path) -> None:
    """Say what was written and what is wrong with it."""
    say(f"{out}: {len(bands.flags)} filters x 3 channels over {bands.region_pixels} px")
    for band, row in zip(bands.optics.filters, bands.flags, strict=True):
        bad = [f"{name} {flag}" for name, flag in zip(("red", "green", "blue"), row, strict=True) if flag != "ok"]
        if bad:
            say(f"  filter {band.name}: {', '.join(bad)}")
    for note in bands.notes:
        say(f"  note: {note}")
