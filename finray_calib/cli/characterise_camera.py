"""``finray radiometry`` on a camera session: the characterisation of the camera."""

from pathlib import Path

from data_schemas.camera import CameraCharacterisation
from data_schemas.errors import RadiometryError
from data_schemas.provenance import provenance
from data_schemas.storage import write_record
from finray_calib.cli.options import command_line, file_name, input_digests, naming, progress_bar, require_new, say
from finray_calib.radiometry.camera_characterisation import characterise_camera
from rigs.capture.read_session import read_camera_session, read_frame_of
from rigs.capture.session_folder import SESSION_NAME


def characterise(folder: Path, out: Path | None) -> None:
    """Write the characterisation of a camera.

    Parameters
    ----------
    folder
        Folder of the camera session.
    out
        Where to write; a name after the camera if None.
    """
    session = read_camera_session(folder)
    out = require_new(out or Path(f"{file_name(session.plan.camera_name)}.camera.json"))
    with progress_bar("radiometry"), naming(RadiometryError, folder):
        camera = characterise_camera(session, lambda frame: read_frame_of(folder, frame))
    write_record(camera, out, provenance(command_line(), input_digests([folder / SESSION_NAME])))
    _report_camera(camera, out)


def _report_camera(camera: CameraCharacterisation, out: Path) -> None:
    """Say the main numbers of every channel."""
    say(f"{out}: camera '{camera.camera_name}'")
    for channel in camera.channels:
        gain, read, full = channel.gain_e_per_dn, channel.read_noise_e, channel.full_well_e
        noise = f"{read.estimate:.3g} +- {read.sd:.2g} e" if read.resolved else f"below {read.high95:.3g} e"
        well = "not reached" if full is None else f"{full.estimate:.4g} e"
        say(
            f"  {channel.channel}: gain {gain.estimate:.4g} +- {gain.sd:.2g} e/DN, read noise {noise}, "
            f"full well {well}, linear within {100 * channel.linearity_error_rel.estimate:.2g} %"
        )
    for label, texts in (("warning", camera.warnings), ("note", camera.notes)):
        for text in texts:
            say(f"  {label}: {text}")
