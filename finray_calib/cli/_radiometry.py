"""``finray radiometry``: turn the frames of a session into band signals with covariance, or characterise a camera.

Band signals also come from elsewhere: ``finray import bands`` reduces images of another lab, ``finray import signals``
reads a table of numbers.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    file_name,
    input_digests,
    naming,
    number_within,
    require_new,
)

if TYPE_CHECKING:
    from data_schemas import BandSignals, CameraCharacterisation


HELP = "turn captured frames into one value per filter and channel, with covariance"
DESCRIPTION = """\
Correct a paint session for dark level and exposure, refer it to the white reference, and write one value per
filter and Bayer channel over the painted region: fluorescence (under the laser) and reflectance (under the
lamp), each with its full covariance and quality flags. A camera session becomes a camera characterisation, and
with --report a page after EMVA Standard 1288."""


def add_radiometry(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("radiometry", help=HELP, description=DESCRIPTION)
    parser.add_argument("session", type=Path, metavar="SESSION", help="folder written by 'finray capture'")
    add_out(parser, "PAINT.bands.json, CAMERA.camera.json")
    parser.add_argument(
        "--camera", type=Path, metavar="FILE", help="use the gain, read noise and black level of this characterisation"
    )
    parser.add_argument(
        "--pixels",
        action="store_true",
        help="also write PAINT.pixels.json: every pixel of the region behind each filter",
    )
    parser.add_argument(
        "--accept-repeat",
        action="store_true",
        help="treat a difference between a filter and its repeat as fading of the sample",
    )
    parser.add_argument(
        "--whole-frame",
        action="store_true",
        help="write every pixel of the frame, not only of the region (with --pixels only)",
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="PAGE",
        help="also write the page (HTML) of a camera session (for camera sessions only)",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Reduce what was captured and report."""
    from data_schemas import RadiometryError
    from rigs.capture import session_kind

    if arguments.whole_frame and not arguments.pixels:
        raise RadiometryError(
            "--whole-frame works only with --pixels, whose map it extends to the whole frame; add --pixels"
        )
    if session_kind(arguments.session) == "paint":
        if arguments.report is not None:
            raise RadiometryError(
                f"{arguments.session}: is a paint session, but --report is only for camera sessions; leave it out"
            )
        reduce_paint(
            arguments.session, arguments.out, arguments.camera, arguments.pixels, arguments.whole_frame,
            arguments.accept_repeat,
        )  # fmt: skip
        return
    if arguments.camera is not None or arguments.pixels or arguments.accept_repeat:
        raise RadiometryError(
            f"{arguments.session}: is a camera session, but --camera, --pixels and "
            "--accept-repeat are only for paint sessions; leave them out"
        )
    characterise(arguments.session, arguments.out, arguments.report)


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
    from data_schemas import CameraCharacterisation, RadiometryError, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.radiometry import bands_of_steps, pixel_signals, session_steps, with_camera
    from rigs.capture import SESSION_NAME, read_frame_of, read_session

    session = read_session(folder)
    if camera is not None:
        session = with_camera(session, read_record(camera, CameraCharacterisation))
    out = require_new(out or Path(f"{file_name(session.plan.paint_name)}.bands.json"), ".json")
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
        wrote(map_out, f"{int(mapped.usable.sum())} usable of {mapped.usable.size} pixels")
        give(usable_pixels=int(mapped.usable.sum()), pixels=mapped.usable.size)


def _report(bands: "BandSignals", out: Path) -> None:
    """Say what was written and what is wrong with it."""
    wrote(out, f"{len(bands.flags)} filters x 3 channels over {bands.region_pixels} px")
    flags = {band.name: list(row) for band, row in zip(bands.optics.filters, bands.flags, strict=True)}
    give(paint_name=bands.paint_name, region_px=bands.region_pixels, flags=flags, notes=bands.notes)
    suggest_command("finray fit", out)
    for band, row in zip(bands.optics.filters, bands.flags, strict=True):
        bad = [f"{name} {flag}" for name, flag in zip(("red", "green", "blue"), row, strict=True) if flag != "ok"]
        if bad:
            say(f"  filter {band.name}: {', '.join(bad)}")
    for note in bands.notes:
        say(f"  note: {note}")


def characterise(folder: Path, out: Path | None, page: Path | None = None) -> None:
    """Write the characterisation of a camera, and its page if one is asked for.

    Parameters
    ----------
    folder
        Folder of the camera session.
    out
        Where to write; a name after the camera if None.
    page
        Where to write the page, if anywhere.
    """
    from data_schemas import RadiometryError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.radiometry import characterise_camera
    from rigs.capture import SESSION_NAME, read_camera_session, read_frame_of

    session = read_camera_session(folder)
    out = require_new(out or Path(f"{file_name(session.plan.camera_name)}.camera.json"), ".json")
    page = None if page is None else require_new(page, ".html")
    with progress_bar("radiometry"), naming(RadiometryError, folder):
        camera = characterise_camera(session, lambda frame: read_frame_of(folder, frame))
    origin = provenance(command_line(), input_digests([folder / SESSION_NAME]))
    with ProductSet(out) as products:
        if page is not None:
            from finray_calib.reports import camera_page

            products.add(page, camera_page(camera.model_copy(update={"provenance": origin})).encode())
        write_record(camera, out, origin, products)
    _report_camera(camera, out)
    if page is not None:
        wrote(page, "the camera after EMVA Standard 1288")
        suggest_file(page)


def _report_camera(camera: "CameraCharacterisation", out: Path) -> None:
    """Say the main numbers of every channel."""
    wrote(out, f"camera '{camera.camera_name}'")
    give(camera_name=camera.camera_name, channels=camera.channels, warnings=camera.warnings, notes=camera.notes)
    suggest_command("finray radiometry SESSION --camera", out)
    for channel in camera.channels:
        gain, read, full = channel.gain_e_per_dn, channel.read_noise_e, channel.full_well_e
        noise = f"{read.estimate:.3g} +- {read.sd:.2g} e" if read.resolved else f"below {read.high95:.3g} e"
        well = "not reached" if full is None else f"{full.estimate:.4g} e"
        bend = channel.linearity_error_rel
        most = 100 * (bend.estimate if bend.resolved else bend.high95)  # one that is not resolved is below its limit
        say(
            f"  {channel.channel}: gain {gain.estimate:.4g} +- {gain.sd:.2g} e/DN, read noise {noise}, "
            f"full well {well}, linear within {most:.2g} %"
        )
    for label, texts in (("warning", camera.warnings), ("note", camera.notes)):
        for text in texts:
            say(f"  {label}: {text}")


BANDS_HELP = "import a folder of wavelength-named TIFF images of a paint"
BANDS_DESCRIPTION = """\
Reduce TIFF images that another lab took of a paint through band-pass filters (paint and white reference under
the lamp, paint and white reference under the laser) to band signals for 'finray fit'. The folder must hold a
bands.toml that says which image shows what, and what camera, filters and laser were used: see
docs/how-to/import-band-images.md."""


def add_bands_format(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("bands", help=BANDS_HELP, description=BANDS_DESCRIPTION)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="holds bands.toml and the images")
    add_out(parser, "PAINT.bands.json")
    parser.set_defaults(run=run_bands)


def run_bands(arguments: argparse.Namespace) -> None:
    """Import and report."""
    import_bands(arguments.folder, arguments.out)


def import_bands(folder: Path, out: Path | None) -> None:
    """Reduce a folder of band images, store the band signals and say what is in them."""
    from data_schemas import RadiometryError, provenance
    from data_schemas.storage import write_record
    from finray_calib.exchange import import_band_folder

    if out is not None:
        require_new(out, ".json")
    with naming(RadiometryError, folder):
        bands, digests = import_band_folder(folder)
    out = require_new(out or Path(f"{file_name(bands.paint_name)}.bands.json"), ".json")
    inputs = {(folder / name).as_posix(): digest for name, digest in digests.items()}
    write_record(bands, out, provenance(command_line(), inputs))
    usable = int(bands.usable().sum())
    wrote(out, f"{len(bands.flags)} filters, {usable} usable values over {bands.region_pixels} px")
    give(paint_name=bands.paint_name, filters=len(bands.flags), usable_values=usable, region_px=bands.region_pixels,
         notes=bands.notes)  # fmt: skip
    suggest_command("finray fit", out)
    for note in bands.notes:
        say(f"  note: {note}")


SIGNALS_HELP = "import a table (CSV) of a paint's band signals, measured by other means"
SIGNALS_DESCRIPTION = """\
Turn a table of numbers (of a photodiode behind filters, a spectrometer, a paper, another camera) into band signals for
'finray fit'. One row for each filter, in any unit: the paint and the white reference under the laser and under the
lamp, each with its standard uncertainty. Columns are separated by commas, tabs or semicolons. --template writes an
empty table. What the columns mean, and what is not measured without one of them:
docs/reference/tables-of-band-signals.md."""


def add_signals_format(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser("signals", help=SIGNALS_HELP, description=SIGNALS_DESCRIPTION)
    parser.add_argument("table", type=Path, nargs="?", metavar="TABLE", help="table of band signals (CSV)")
    parser.add_argument("--rig", type=Path, metavar="RIG", help="rig file (TOML): filters, lights, white reference")
    parser.add_argument("--template", action="store_true", help="write an empty table with the rig's filters, and stop")
    parser.add_argument(
        "--channels", type=int, choices=[1, 3], help="channels of the detector, of --template only (default: 1)"
    )
    parser.add_argument("--paint-name", metavar="NAME", help="name of the paint (default: name of the table)")
    parser.add_argument("--laser-nm", type=float, metavar="NM", help="wavelength of the laser, instead of the rig's")
    parser.add_argument(
        "--laser-fwhm-nm", type=float, metavar="NM",
        help="full width at half maximum of the laser, instead of the rig's (default without a rig: 2 nm)",
    )  # fmt: skip
    parser.add_argument(
        "--lamp", metavar="LAMP",
        help="spectrum of the lamp, instead of the rig's: planck-2856K, or a CSV file (wavelength_nm,power_rel) "
        "(default without a rig: planck-2856K)",
    )  # fmt: skip
    parser.add_argument(
        "--response", type=Path, metavar="CSV",
        help="response of the detector: wavelength_nm,response_percent, or of three channels "
        "wavelength_nm,red_percent,green_percent,blue_percent (default: flat; of three channels that of the rig)",
    )  # fmt: skip
    parser.add_argument(
        "--white-reflectance", type=float, metavar="R", help="reflectance of the white reference, instead of the rig's"
    )
    parser.add_argument(
        "--white-uncertainty-rel", type=float, metavar="U",
        help="relative standard uncertainty of that reflectance, instead of the rig's",
    )  # fmt: skip
    parser.add_argument(
        "--calibrated", action="store_true",
        help="the readings are integrals of spectral radiance over each filter's transmission (of a calibrated "
        "spectrometer), which need no white reference under the lamp",
    )  # fmt: skip
    parser.add_argument(
        "--assume-yield", dest="assumed_yield", type=number_within("a yield", (0.0, 1.0), above=True), metavar="Y",
        help="assume this yield (emitted over incident energy) where the white reference was not measured under the "
        "laser, so that only the shape of the emission is measured; the paint's name then says so",
    )  # fmt: skip
    add_out(parser, "PAINT.bands.json, with --template signals.csv")
    parser.set_defaults(run=run_signals)


def run_signals(arguments: argparse.Namespace) -> None:
    """Import and report, or write an empty table."""
    from data_schemas import ImportFormatError, provenance
    from data_schemas.storage import write_record
    from finray_calib.exchange import SignalOptions, import_signal_table

    if arguments.template:
        _write_template(arguments)
        return
    if arguments.channels is not None:
        raise ImportFormatError("--channels works only with --template, whose rows it sets; leave it out")
    if arguments.table is None:
        raise ImportFormatError("TABLE is missing; give the table (CSV), or --template for an empty one")
    if arguments.out is not None:
        require_new(arguments.out, ".json")
    options = SignalOptions(**{name: getattr(arguments, name) for name in _OF_READINGS})
    bands, files = import_signal_table(arguments.table, arguments.rig, options)
    out = require_new(arguments.out or Path(f"{file_name(bands.paint_name)}.bands.json"), ".json")
    write_record(bands, out, provenance(command_line(), input_digests(files)))
    usable = int(bands.usable().sum())
    through = bands.optics.excitation_filter
    wrote(out, f"{len(bands.flags)} filters, {usable} usable values; filter {through} passes the laser")
    give(paint_name=bands.paint_name, filters=len(bands.flags), usable_values=usable, excitation_filter=through,
         notes=bands.notes)  # fmt: skip
    suggest_command("finray fit", out)
    for note in bands.notes:
        say(f"  note: {note}")


_OF_READINGS: Final = {
    "paint_name": "--paint-name",
    "laser_nm": "--laser-nm",
    "laser_fwhm_nm": "--laser-fwhm-nm",
    "lamp": "--lamp",
    "response": "--response",
    "white_reflectance": "--white-reflectance",
    "white_uncertainty_rel": "--white-uncertainty-rel",
    "calibrated": "--calibrated",
    "assumed_yield": "--assume-yield",
}
"""Options by their names in SignalOptions."""


def _write_template(arguments: argparse.Namespace) -> None:
    """Write an empty table."""
    from data_schemas import ImportFormatError
    from data_schemas.storage import write_bytes
    from finray_calib.exchange import signal_template

    if arguments.table is not None:
        raise ImportFormatError(
            f"{arguments.table}: --template reads no table, but writes an empty one; give its name with --out"
        )
    for name, option in _OF_READINGS.items():
        if getattr(arguments, name) not in (None, False):
            raise ImportFormatError(f"{option} has no effect on an empty table; leave it out")
    text = signal_template(arguments.rig, arguments.channels or 1)
    out = require_new(arguments.out or Path("signals.csv"))
    write_bytes(out, text.encode())
    wrote(out, "an empty table of band signals: fill it in")
    give(columns=next(line for line in text.splitlines() if not line.startswith("#")).split(","))
    suggest_command("finray import signals", out, *([] if arguments.rig is None else ["--rig", arguments.rig]))
