"""``finray sense``: sense with a tactile camera, from its scale over training presses to depth, normals and contact.

A printed ChArUco board gives the lens and the millimetres per pixel on the pad; ball presses teach the map that senses
a surface normal from a colour; the map senses other presses.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._run import (
    add_out,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    require_new,
)

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    from data_schemas import CharucoBoard, PixelScale, SensedPress, TactileCapture


SENSE_HELP = "sense with a tactile camera: its scale, a map trained on ball presses, and depth of other presses"


def add_sense(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its jobs."""
    parser = verbs.add_parser("sense", help=SENSE_HELP, description=SENSE_HELP)
    jobs = parser.add_subparsers(dest="job", metavar="JOB", title="jobs", required=True)
    _add_teach(jobs)
    _add_run(jobs)
    _add_scale(jobs)


DICTIONARY = "DICT_4X4_50"
PIXEL_SCALE_HELP = "calibrate the camera and measure millimetres per pixel on the pad, with a ChArUco board"
PIXEL_SCALE_DESCRIPTION = """\
Calibrate the lens and measure how many millimetres a pixel spans on the pad, along rows and along columns,
with standard uncertainty. It needs one picture of a ChArUco board that lies where the coat of the pad is, and
four or more (ten are good) with the board turned and tilted, all with the camera in its place in the
finger. Pictures through the mirror are recognised. Writes the record, and beside it the lens (FILE.lens.yaml)
for 'camera.calibration' of a design."""


def _add_scale(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the job."""
    parser = jobs.add_parser("scale", help=PIXEL_SCALE_HELP, description=PIXEL_SCALE_DESCRIPTION)
    parser.add_argument(
        "lens", type=Path, nargs="+", metavar="PICTURE",
        help="pictures of the board turned and tilted, or one tactile session whose plan has [board] on_pad = true",
    )  # fmt: skip
    parser.add_argument(
        "--pad", type=Path, metavar="PICTURE", help="picture of the board lying where the coat of the pad is"
    )
    parser.add_argument(
        "--plan", type=Path, metavar="TOML", help="tactile plan whose [board] table describes the printed board"
    )
    parser.add_argument("--squares", metavar="NxM", help="number of squares along and across, for example 7x5")
    parser.add_argument("--square-mm", type=float, metavar="MM", help="measured side of a printed square in mm")
    parser.add_argument("--marker-mm", type=float, metavar="MM", help="side of a marker")
    parser.add_argument(
        "--dictionary", metavar="NAME", help=f"OpenCV dictionary of the board's markers (default: {DICTIONARY})"
    )
    parser.add_argument(
        "--square-u-mm", type=float, metavar="MM", help="standard uncertainty in mm of the side of a square; required"
    )
    parser.add_argument(
        "--coat-behind-mm", type=float, default=0.0, metavar="MM",
        help="distance in mm from the printed face back to the coat, as seen from the camera; a negative value puts "
             "the coat in front of the face (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--coat-behind-u-mm",
        type=float,
        default=0.0,
        metavar="MM",
        help="standard uncertainty in mm of --coat-behind-mm (default: 0)",
    )
    parser.add_argument(
        "--lens-model", choices=("fisheye", "pinhole"), help="lens model (default: the model that fits better)"
    )
    parser.add_argument(
        "--monochrome", action="store_true", help="read 16-bit pictures as grey values, not as Bayer counts"
    )
    add_out(parser, "pixel-scale.json")
    add_seed(parser)
    parser.set_defaults(run=run_pixel_scale)


def run_pixel_scale(arguments: argparse.Namespace) -> None:
    """Calibrate, store and report."""
    from data_schemas import CompareError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import calibration_yaml, read_board_picture
    from finray_calib.sensing import BoardUncertainty, find_board, pixel_scale, require_plausible

    out = require_new(arguments.out or Path("pixel-scale.json"), ".json")
    lens_file = require_new(out.with_suffix(".lens.yaml"))
    board, pad, others = board_pictures(arguments)
    require_plausible(board)
    declared = BoardUncertainty(*tolerances(arguments, board.square_mm))
    files = [pad, *others]
    pictures = {str(path): read_board_picture(path, arguments.monochrome) for path in files}
    sizes = {picture.shape for picture in pictures.values()}
    if len(sizes) > 1:
        raise CompareError(
            f"the pictures have different sizes (rows, columns), {sorted(sizes)}; give pictures of one camera at one "
            "size"
        )
    views = [find_board(pictures[str(pad)], board, str(pad))]
    for path in others:
        try:
            views.append(find_board(pictures[str(path)], board, str(path)))
        except CompareError as error:
            warn(f"left out: {error}")
    height, width = next(iter(sizes))
    record = pixel_scale(
        views[0], views[1:], (width, height), board, declared, arguments.seed, arguments.lens_model, pictures
    )
    inputs = input_digests([*files, *([arguments.plan] if arguments.plan else [])])
    with ProductSet(out) as products:
        products.add(lens_file, calibration_yaml(record.calibration))
        write_record(record, out, provenance(command_line(), inputs, arguments.seed), products)
    lens = f"{record.calibration.model} lens from {len(record.lens_pictures)} pictures"
    wrote(out, f"{lens}, corners to {record.corner_sd_px:.2f} px")
    wrote(lens_file, "the lens, for 'camera.calibration' of a design")
    say(_in_words(record))
    middle = record.middle
    give(mm_per_px=middle.mean_mm_per_px, mm_per_px_u_rel=middle.mean_u_rel, corner_sd_px=record.corner_sd_px,
         notes=record.notes)  # fmt: skip
    suggest_command("finray sense teach PRESSES --scale", out)


def _in_words(record: "PixelScale") -> str:
    """Return what the user wants to know at once."""
    middle, over = record.middle, record.over_board
    u_middle = sorted(((line.u_rel, line.input) for line in record.budget), reverse=True)
    lines = [
        f"  at column {middle.column_px:.0f}, row {middle.row_px:.0f} (middle of the board on the pad), standard "
        "uncertainty u:",
        f"    along x  {middle.along_x_mm_per_px:.5g} mm/px, u = {100 * middle.along_x_u_rel:.2f} %",
        f"    along y  {middle.along_y_mm_per_px:.5g} mm/px, u = {100 * middle.along_y_u_rel:.2f} %",
        f"    mean     {middle.mean_mm_per_px:.5g} mm/px, u = {100 * middle.mean_u_rel:.2f} % "
        f"({', '.join(f'{name} {100 * u:.2f} %' for u, name in u_middle)})",
        f"  over the board {over.along_x_low_mm_per_px:.4g} to {over.along_x_high_mm_per_px:.4g} mm/px along x, "
        f"{over.along_y_low_mm_per_px:.4g} to {over.along_y_high_mm_per_px:.4g} mm/px along y",
        f"  in a plan: mm_per_px = {middle.mean_mm_per_px:.5g}, mm_per_px_u_rel = {middle.mean_u_rel:.2g}",
        *(f"  note: {note}" for note in record.notes),
    ]
    return "\n".join(lines)


def board_pictures(arguments: argparse.Namespace) -> "tuple[CharucoBoard, Path, list[Path]]":
    """Return the board, the picture of it on the pad, and the others, of files or of a session."""
    from data_schemas import CompareError

    files: list[Path] = arguments.lens
    if len(files) == 1 and files[0].is_dir():
        if any(value is not None for value in (arguments.pad, arguments.plan, *_of_the_board(arguments).values())):
            raise CompareError(
                f"{files[0]}: is a session, which already contains its pictures and its board; leave out --pad, "
                "--plan, --squares, --square-mm, --marker-mm and --dictionary, or give the pictures by name"
            )
        return _session_pictures(files[0])
    if arguments.pad is None:
        raise CompareError("--pad is missing; give the picture of the board lying where the coat of the pad is")
    return _board(arguments), arguments.pad, _others(files, arguments.pad)


def _of_the_board(arguments: argparse.Namespace) -> "dict[str, str | float | None]":
    """Return what the options say of the printed board; None where they say nothing."""
    return {name: getattr(arguments, name) for name in ("squares", "square_mm", "marker_mm", "dictionary")}


def _others(files: list[Path], pad: Path) -> list[Path]:
    """Return the pictures without that on the pad, which ``*.png`` gives once more; each counts once."""
    from data_schemas import CompareError

    others = [file for file in files if file.resolve() != pad.resolve()]
    seen: set[Path] = set()
    for file in others:
        if file.resolve() in seen:
            raise CompareError(f"{file}: is given twice; give each picture once")
        seen.add(file.resolve())
    return others


def _session_pictures(folder: Path) -> "tuple[CharucoBoard, Path, list[Path]]":
    """Return board and pictures of a tactile session: of each place that of the longest exposure that hardly clips."""
    from data_schemas import CompareError, TactileSession
    from data_schemas.storage import read_frame, read_record
    from rigs.capture import MOST_SATURATED_FRACTION

    if not (folder / "session.json").exists():
        raise CompareError(
            f"{folder}: contains no tactile session (session.json is missing); give a folder that 'finray capture' "
            "wrote, or pictures of the board and, with --pad, the picture of the board on the pad"
        )
    session = read_record(folder / "session.json", TactileSession)
    board = session.plan.board
    if board is None or not board.on_pad:
        raise CompareError(
            f"{folder}: the plan of this session does not state that the first picture shows the board on the pad "
            "([board], on_pad = true); give the pictures by name and, with --pad, the picture of the board on the pad"
        )
    chosen: list[Path] = []
    for place in range(1, board.images + 1):
        frames = [f for f in session.frames if (f.frame_type, f.place) == ("board", place)]
        frames.sort(key=lambda frame: frame.exposure_requested_s)
        good = [frame for frame in frames if frame.saturated_fraction <= MOST_SATURATED_FRACTION]
        if frames:
            frame = good[-1] if good else frames[0]
            read_frame(folder / frame.file, frame.sha256)
            chosen.append(folder / frame.file)
        elif place == 1:
            raise CompareError(
                f"{folder}: the picture of the board on the pad is missing, perhaps because the session was "
                "interrupted; capture the session again, or give the pictures by name and, with --pad, the picture "
                "of the board on the pad"
            )
    return board, chosen[0], chosen[1:]


def _board(arguments: argparse.Namespace) -> "CharucoBoard":
    """Return the board of the plan or of the options."""
    from data_schemas import CharucoBoard, CompareError, FieldError, TactilePlan
    from data_schemas.storage import read_toml

    given = _of_the_board(arguments)
    if arguments.plan is not None:
        if any(value is not None for value in given.values()):
            raise CompareError(
                "--plan already describes the board; leave --squares, --square-mm, --marker-mm and --dictionary out"
            )
        plan = read_toml(arguments.plan, TactilePlan)
        if plan.board is None:
            raise CompareError(
                f"{arguments.plan}: has no [board] table; add the table, or give --squares, "
                "--square-mm and --marker-mm instead of --plan"
            )
        return plan.board
    needed = ("squares", "square_mm", "marker_mm")
    missing = [f"--{name.replace('_', '-')}" for name in needed if given[name] is None]
    if missing:
        raise CompareError(
            f"{', '.join(missing)}: missing, but needed to measure lengths; give the number of squares and the sides "
            "of squares and markers (mm), or --plan with a [board] table"
        )
    along, separator, across = arguments.squares.partition("x")
    if not separator or not along.isdecimal() or not across.isdecimal():
        raise CompareError(f"--squares {arguments.squares}: must be two whole numbers such as 7x5")
    try:
        return CharucoBoard(
            squares=(int(along), int(across)),
            square_mm=arguments.square_mm,
            marker_mm=arguments.marker_mm,
            dictionary=arguments.dictionary or DICTIONARY,
        )
    except FieldError as error:
        raise CompareError(f"board: {error}") from None


def tolerances(arguments: argparse.Namespace, square_mm: float) -> tuple[float, float, float]:
    """Return u of the squares (relative), distance of the coat and its u (mm), if they are in range."""
    from math import isfinite

    from data_schemas import CompareError

    u_mm: float | None = arguments.square_u_mm
    behind_mm, behind_u_mm = float(arguments.coat_behind_mm), float(arguments.coat_behind_u_mm)
    if u_mm is None:
        raise CompareError(
            "--square-u-mm is missing; measure all squares of a row at once with a calliper, and give the calliper's "
            "standard uncertainty in mm (0.05 / sqrt(3) for 'within 0.05 mm') divided by the number of squares"
        )
    if not 0.0 <= u_mm <= 0.1 * square_mm:
        raise CompareError(
            f"--square-u-mm {u_mm:g}: must be 0 to {0.1 * square_mm:g} mm, a tenth of a square of {square_mm:g} mm"
        )
    if not (isfinite(behind_mm) and abs(behind_mm) <= 100.0 and 0.0 <= behind_u_mm <= 100.0):
        raise CompareError(
            f"--coat-behind-mm {behind_mm:g}, --coat-behind-u-mm {behind_u_mm:g}: the first must be -100 to 100 mm, "
            "the second 0 to 100 mm"
        )
    return u_mm / square_mm, behind_mm, behind_u_mm


NORMAL_MAP_HELP = "fit the map from colour to surface normal to captures of ball presses"
NORMAL_MAP_DESCRIPTION = """\
Fit the map from change of colour (and place in the picture) to surface normal, as a tactile sensor uses it, to
at least 12 captures of ball presses with a known contact circle, and score it on random halves of them that it
has not seen. 'finray import taxim' and 'finray import ball-presses' make such captures; those of
'finray capture' get their circles from --circles."""


def _add_teach(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the job."""
    parser = jobs.add_parser("teach", help=NORMAL_MAP_HELP, description=NORMAL_MAP_DESCRIPTION)
    parser.add_argument(
        "captures", type=Path, nargs="+", metavar="PRESSES",
        help="tactile captures of ball presses, or folders or zip archives of NAME.capture.json",
    )  # fmt: skip
    parser.add_argument(
        "--circles", type=Path, metavar="CSV",
        help="contact circles (CSV), with the columns image (file name of the capture), column_px, row_px and "
             "radius_px",
    )  # fmt: skip
    parser.add_argument(
        "--scale", type=Path, metavar="FILE",
        help="scale in mm per pixel that 'finray sense scale' measured, instead of the scale that the captures state",
    )  # fmt: skip
    add_out(parser, "normal-map.json")
    add_seed(parser)
    parser.set_defaults(run=run_normal_map)


def run_normal_map(arguments: argparse.Namespace) -> None:
    """Fit, store and report."""
    from data_schemas import CompareError, TactileCapture, provenance
    from data_schemas.storage import read_record, write_record
    from finray_calib.sensing import normal_map_record, require_ball_press

    out = require_new(arguments.out or Path("normal-map.json"), ".json")
    files = _files(arguments.captures)
    captures = _circled([read_record(path, TactileCapture) for path in files], files, arguments.circles)
    captures = _scaled(captures, arguments.scale)
    for path, capture in zip(files, captures, strict=True):
        with naming(CompareError, path):
            require_ball_press(capture)
    others = "" if len(files) == 1 else f" and {len(files) - 1} more"
    with naming(CompareError, Path(f"{files[0]}{others}")):
        record = normal_map_record(captures, out.name.removesuffix(".json"), arguments.seed)
    inputs = [*files, *(path for path in (arguments.circles, arguments.scale) if path)]
    write_record(record, out, provenance(command_line(), input_digests(inputs), arguments.seed))
    splits = len(record.held_out_angle_deg)
    wrote(out, f"normal map of {record.presses} presses, {record.width_px} x {record.height_px} px")
    give(
        presses=record.presses, width_px=record.width_px, height_px=record.height_px,
        held_out_explained_rel=record.held_out_explained_rel, held_out_angle_deg=record.held_out_angle_deg,
        held_out_depth_rms_mm=record.held_out_depth_rms_mm,
    )  # fmt: skip
    suggest_command("finray sense run", out, "CAPTURE")
    say(f"  on presses it has not seen ({splits} random halves: median [least, most])")
    say(
        f"  explains {_spread(record.held_out_explained_rel, 3)} of the squared slopes; a map without any "
        "information scores 0"
    )
    say(f"  mean angle of its normals {_spread(record.held_out_angle_deg, 1)} deg")
    if record.held_out_depth_rms_mm is not None and record.held_out_height_error_rel is not None:
        off = float((record.held_out_height_error_rel**2).mean() ** 0.5)
        say(
            f"  rms error of the depth inside the contact {_spread(record.held_out_depth_rms_mm, 3)} mm; the "
            "height from rim to"
        )
        say(
            f"  middle is wrong by {100 * off:.1f} % rms, {100 * record.held_out_height_error_rel.mean():+.1f} % "
            "on average"
        )


def _circled(captures: "list[TactileCapture]", files: list[Path], circles: Path | None) -> "list[TactileCapture]":
    """Give captures the contact circles of a file."""
    from data_schemas import CompareError
    from finray_calib.exchange import read_circles

    if circles is None:
        return captures
    found = read_circles(circles)
    names = [path.name for path in files]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise CompareError(
            f"{circles}: two captures have the name {twice}, so the file does not say whose circle it holds; rename "
            "one of these captures, in its folder and in the column 'image'"
        )
    missing = [path.name for path in files if path.name not in found]
    if missing:
        raise CompareError(
            f"{circles}: the circle of {missing[0]} is missing; add a row for it, or leave that capture out"
        )
    return [
        capture.model_copy(
            update={"contact_circle": found[path.name].circle, "contact_told_by": found[path.name].source}
        )
        for capture, path in zip(captures, files, strict=True)
    ]


def _scaled(captures: "list[TactileCapture]", scale: Path | None) -> "list[TactileCapture]":
    """Give captures the mean scale of a file, at the middle of the board on the pad."""
    from data_schemas import CompareError, PixelScale
    from data_schemas.storage import read_record
    from finray_calib.sensing import with_measured_scale

    if scale is None:
        return captures
    found = read_record(scale, PixelScale)
    with naming(CompareError, scale):
        return [with_measured_scale(capture, found) for capture in captures]


def _spread(values: "NDArray[float64]", digits: int) -> str:
    """Return median and range in words."""
    import numpy as np

    return f"{np.median(values):.{digits}f} [{values.min():.{digits}f}, {values.max():.{digits}f}]"


def _files(places: list[Path]) -> list[Path]:
    """Return the files of captures: those that are given, and those of folders."""
    from data_schemas import CompareError
    from data_schemas.storage import files_in, folder_at

    found: list[Path] = []
    for place in places:
        folder = folder_at(place, CompareError)
        inner = [place] if folder is None else files_in(folder, ".capture.json")
        if not inner:
            raise CompareError(f"{place}: contains no capture (NAME.capture.json); import presses, or give their files")
        found += inner
    return found


RUN_HELP = "sense a press: depth, normals and contact, with uncertainty, a picture and a mesh"
RUN_DESCRIPTION = """\
Sense depth, normals and contact of a capture by a map that 'finray sense teach' wrote. Writes the record, and beside it
a picture (FILE.png) and the surface of the gel as a mesh (FILE.stl, mm). The uncertainty is that of
presses that the map was not trained on. The command warns when the map was trained on this press, because the result
then proves nothing."""


def _add_run(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the job."""
    parser = jobs.add_parser("run", help=RUN_HELP, description=RUN_DESCRIPTION)
    parser.add_argument("map", type=Path, metavar="MAP", help="record of 'finray sense teach'")
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="tactile capture of another press")
    parser.add_argument(
        "--contact-depth-mm", type=float, metavar="MM",
        help="smallest depth in mm at which a pixel counts as touched (default: a tenth of the largest depth, but at "
             "least 3 sd)",
    )  # fmt: skip
    parser.add_argument(
        "--mirrored", action="store_true",
        help="the camera sees the gel in one mirror, as in a GelSight Fin Ray finger; the mesh, whose y then runs "
             "against the rows, is otherwise the mirror image of such a gel",
    )  # fmt: skip
    add_out(parser, "CAPTURE.sensed.json")
    parser.set_defaults(run=run_sense)


def run_sense(arguments: argparse.Namespace) -> None:
    """Sense, store and report."""
    from data_schemas import CompareError, NormalMapRecord, TactileCapture, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.reports import sensed_png
    from finray_calib.sensing import sense_press, surface_triangles
    from sim.surface_meshes import stl_bytes

    place: Path = arguments.capture
    name = place.name.removesuffix(".json").removesuffix(".capture")
    out = require_new(arguments.out or Path(f"{file_name(name)}.sensed.json"), ".json")
    picture, mesh = require_new(out.with_suffix(".png")), require_new(out.with_suffix(".stl"))
    normal_map, capture = read_record(arguments.map, NormalMapRecord), read_record(place, TactileCapture)
    with naming(CompareError, arguments.map, place):
        sensed = sense_press(normal_map, capture, arguments.contact_depth_mm)
    origin = provenance(command_line(), input_digests([arguments.map, place]))
    with ProductSet(out) as products:
        products.add(picture, sensed_png(sensed, capture))
        surface = surface_triangles(sensed, arguments.mirrored)
        products.add(mesh, stl_bytes(*surface, "gel surface, mm, from finray sense"))
        write_record(sensed, out, origin, products)
    _report_sensed(sensed)
    wrote(out, "what was sensed")
    wrote(picture, "depth, normals and contact")
    wrote(mesh, "the surface of the gel, mm")
    names = ("deepest_mm", "deepest_u_mm", "contact_area_mm2", "contact_area_u_mm2", "is_of_teaching", "notes")
    give(name=sensed.name, is_training_capture=sensed.is_of_teaching, **{name: getattr(sensed, name) for name in names})
    suggest_file(picture)


def _report_sensed(sensed: "SensedPress") -> None:
    """Say what was sensed; warn where it proves nothing."""
    u = "u not known" if sensed.deepest_u_mm is None else f"u = {sensed.deepest_u_mm:.2g} mm"
    area_u = "u not known" if sensed.contact_area_u_mm2 is None else f"u = {sensed.contact_area_u_mm2:.2g} mm2"
    say(f"{sensed.name}: deepest {sensed.deepest_mm:.3g} mm ({u})")
    say(f"  contact, deeper than {sensed.contact_depth_mm:.2g} mm: {sensed.contact_area_mm2:.3g} mm2 ({area_u})")
    for note in sensed.notes:
        say(f"  note: {note}")
    if sensed.is_of_teaching:
        warn(
            f"{sensed.name} is a training press of the map '{sensed.normal_map}', so its result proves nothing about "
            "other presses"
        )
