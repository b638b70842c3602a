"""Options that say which pictures show a calibration board, what was printed, and how well that is known."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data_schemas.tactile import CharucoBoard


def board_pictures(arguments: argparse.Namespace) -> "tuple[CharucoBoard, Path, list[Path]]":
    """Return the board, the picture of it on the pad, and the others, of files or of a session."""
    from data_schemas.errors import CompareError

    files: list[Path] = arguments.lens
    if len(files) == 1 and files[0].is_dir():
        if any(value is not None for value in (arguments.pad, arguments.plan, arguments.squares)):
            raise CompareError(f"{files[0]}: a session knows its pictures and its board; leave the other options out")
        return _session_pictures(files[0])
    if arguments.pad is None:
        raise CompareError("--pad: missing; give the picture of the board where the coat of the pad is")
    return _board(arguments), arguments.pad, _others(files, arguments.pad)


def _others(files: list[Path], pad: Path) -> list[Path]:
    """Return the pictures without that on the pad, which ``*.png`` gives once more; each counts once."""
    from data_schemas.errors import CompareError

    others = [file for file in files if file.resolve() != pad.resolve()]
    seen: set[Path] = set()
    for file in others:
        if file.resolve() in seen:
            raise CompareError(f"{file}: is given twice; a picture counts once, name each of them once")
        seen.add(file.resolve())
    return others


def _session_pictures(folder: Path) -> "tuple[CharucoBoard, Path, list[Path]]":
    """Return board and pictures of a tactile session: of each place that of the longest exposure that hardly clips."""
    from data_schemas.errors import CompareError
    from data_schemas.frame_files import read_frame
    from data_schemas.storage import read_record
    from data_schemas.tactile import TactileSession
    from rigs.capture.tactile_captures import MOST_SATURATED_FRACTION

    session = read_record(folder / "session.json", TactileSession)
    board = session.plan.board
    if board is None or not board.on_pad:
        raise CompareError(
            f"{folder}: its plan does not say that the first picture shows the board on the pad ([board], on_pad = "
            "true); give the pictures by name, and with --pad that of the board on the pad"
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
                f"{folder}: holds no picture of the board's first place, on the pad (was the session interrupted?): "
                "capture it again, or give the pictures by name, and with --pad that of the board on the pad"
            )
    return board, chosen[0], chosen[1:]


def _board(arguments: argparse.Namespace) -> "CharucoBoard":
    """Return the board of the plan or of the options."""
    from pydantic import ValidationError

    from data_schemas.errors import CompareError
    from data_schemas.faults import explain
    from data_schemas.storage import read_toml
    from data_schemas.tactile import CharucoBoard, TactilePlan

    given = {name: getattr(arguments, name) for name in ("squares", "square_mm", "marker_mm")}
    if arguments.plan is not None:
        if any(value is not None for value in given.values()):
            raise CompareError("--plan says what the board is; leave --squares, --square-mm and --marker-mm out")
        plan = read_toml(arguments.plan, TactilePlan)
        if plan.board is None:
            raise CompareError(f"{arguments.plan}: has no [board] table; add it, or give --squares and --square-mm")
        return plan.board
    missing = [f"--{name.replace('_', '-')}" for name, value in given.items() if value is None]
    if missing:
        raise CompareError(
            f"{', '.join(missing)}: missing, without the size of the printed squares no length is known; give them "
            "(mm), or --plan with a [board] table"
        )
    along, separator, across = given["squares"].partition("x")
    if not separator or not along.isdigit() or not across.isdigit():
        raise CompareError(f"--squares {given['squares']}: must be two whole numbers such as 7x5")
    try:
        return CharucoBoard(
            squares=(int(along), int(across)),
            square_mm=given["square_mm"],
            marker_mm=given["marker_mm"],
            dictionary=arguments.dictionary,
        )
    except ValidationError as error:
        raise CompareError(f"board: {explain(error, CharucoBoard)}") from None


def tolerances(arguments: argparse.Namespace, square_mm: float) -> tuple[float, float, float]:
    """Return u of the squares (relative), distance of the coat and its u (mm), if they are in range."""
    from math import isfinite

    from data_schemas.errors import CompareError

    u_mm: float | None = arguments.square_u_mm
    behind_mm, behind_u_mm = float(arguments.coat_behind_mm), float(arguments.coat_behind_u_mm)
    if u_mm is None:
        raise CompareError(
            "--square-u-mm: missing; measure all squares of a row with a calliper: its standard uncertainty (for "
            "'within 0.05 mm' 0.05 / sqrt(3)) over the number of squares is that of one"
        )
    if not 0.0 <= u_mm <= 0.1 * square_mm:
        raise CompareError(
            f"--square-u-mm {u_mm:g}: must be 0 to {0.1 * square_mm:g} mm, a tenth of a square of {square_mm:g} mm"
        )
    if not (isfinite(behind_mm) and abs(behind_mm) <= 100.0 and 0.0 <= behind_u_mm <= 100.0):
        raise CompareError(
            f"--coat-behind-mm {behind_mm:g}, --coat-behind-u-mm {behind_u_mm:g}: must be -100 to 100 mm, and 0 to "
            "100 mm"
        )
    return u_mm / square_mm, behind_mm, behind_u_mm
