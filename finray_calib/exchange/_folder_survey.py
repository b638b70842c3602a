"""What lies in a folder of another lab that no recipe reads yet, and the beginning of a recipe for it."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from data_schemas import ImportFormatError
from data_schemas.storage import files_below, folder_at, read_json
from finray_calib.exchange._set_files import (
    TABLES,
    VIDEOS,
    ArrayFiles,
    exr_rgb,
    flat_entries,
    pixels_of,
    table_rows,
    video_frames,
)


@dataclass(frozen=True, slots=True)
class FolderSurvey:
    """What a folder of files that no recipe reads yet holds, a line for each kind, and the start of a recipe for it."""

    lines: tuple[str, ...]
    recipe: str


_PICTURES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".exr", ".npy")
_NO_CONTACT: Final = re.compile(r"(^|[^a-z])(bg|background|ref|rest|flat|empty|no_?contact|no_?touch|init)", re.I)
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_GROUPS_SHOWN, _KEYS_SHOWN = 12, 16
_RUN_OF_DIGITS: Final = re.compile(r"\d+(?:\.\d+)?")
_MOST_SURVEYED = 20_000
_RECIPE_START: Final = """\
name = "mine"
what = "DESCRIBE: what was pressed, with which sensor, by whom"
# licence = "CC BY 4.0"

[presses]
files = {files}

[picture]
channels = "RGB"              # "BGR" where red and blue are exchanged

[no_contact]
{no_contact}

[contact]                     # better: circle, outline or depth_map of the files below
search = "circle"

# [scale]
# mm_per_px = 0.05

[indenter]
shape = "ball"                # or cylinder, cuboid, mesh
# diameter_mm = 4.0
# depth_mm = "{{depth}}"        # a part of the name, or a column

# what else lies in the folder:
{rest}
"""


def survey_folder(folder: Path) -> FolderSurvey:
    """Say what a folder of another lab holds, and write the start of a recipe for it.

    Files whose names differ in their numbers only are one kind. Those with the most pictures are taken for the presses;
    a picture whose name says so, for the one without contact. Nothing else is guessed.

    Parameters
    ----------
    folder
        Of the set, or a zip archive of it.

    Raises
    ------
    ImportFormatError
        There is no such folder, or no file in it.
    """
    inside = folder_at(folder, ImportFormatError)
    if inside is None:
        raise ImportFormatError(f"{folder}: no such folder or zip archive; give the folder of the set")
    kinds: dict[str, list[str]] = {}
    for path in sorted(islice(files_below(inside), _MOST_SURVEYED)):
        name = path.relative_to(inside).as_posix()
        if not path.name.startswith("."):
            kinds.setdefault(_RUN_OF_DIGITS.sub("#", name), []).append(name)
    if not kinds:
        raise ImportFormatError(f"{folder}: holds no file; give the folder of the set")
    ordered = sorted(kinds.values(), key=len, reverse=True)
    lines = [
        _printable(f"{len(names)} x {_pattern(names)}: {_content(inside / names[0])}")
        for names in ordered[:_GROUPS_SHOWN]
    ]
    if len(ordered) > _GROUPS_SHOWN:
        lines.append(f"and {len(ordered) - _GROUPS_SHOWN} more kinds of files")
    kinds_read = (*_PICTURES, *VIDEOS)
    # a recipe is UTF-8, and cannot name what is not
    pictures = [n for n in ordered if Path(n[0]).suffix.lower() in kinds_read and not _SURROGATE.search(n[0])]
    touched = [names for names in pictures if not _NO_CONTACT.search(Path(names[0]).stem)] or pictures
    untouched = [names[0] for names in pictures if _NO_CONTACT.search(Path(names[0]).stem)]
    files = _pattern(touched[0]) if touched else "{press}.png"
    if len(touched) > 1 and len(touched[0]) == 1:  # names without numbers
        first = Path(touched[0][0])
        files = (first.parent / f"{{press}}{first.suffix}").as_posix()
    rest = "median_of_presses = true      # a substitute: better name a file"
    if Path(files).suffix.lower() in VIDEOS:
        rest = "frames_before = 10"
    elif untouched:
        rest = f"file = {_toml(untouched[0])}"
    return FolderSurvey(
        tuple(lines),
        _RECIPE_START.format(files=_toml(files), no_contact=rest, rest="\n".join(f"# {line}" for line in lines)),
    )


def _toml(text: str) -> str:
    """Return a text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _printable(text: str) -> str:
    """Return a text in one line, with escapes for what cannot be shown."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _pattern(names: Sequence[str]) -> str:
    """Return the pattern of names that differ in their numbers: {press}, or {a}, {b}, ... where several do."""
    numbers = np.array([_RUN_OF_DIGITS.findall(name) for name in names])
    between = _RUN_OF_DIGITS.split(names[0])
    differ = [k for k in range(numbers.shape[1]) if len(set(numbers[:, k])) > 1]
    words = dict.fromkeys(differ, "press")
    if len(differ) > 1:
        words = dict(zip(differ, "abcdefghijklmnopqrstuvwxyz", strict=False))
    held = [f"{{{words[k]}}}" if k in words else numbers[0, k] for k in range(numbers.shape[1])]
    return "".join(part + number for part, number in zip(between, [*held, ""], strict=True))


def _content(path: Path) -> str:
    """Return what a file of a set holds, in words; what cannot be read says why not."""
    kind = path.suffix.lower()
    try:
        whole = read_json(path, "labels", ImportFormatError, any_number=True) if kind == ".json" else None
        if isinstance(whole, dict) and not any(isinstance(of, list) for of in whole.values()):
            keys = [key for key, _ in islice(flat_entries(whole), _KEYS_SHOWN)]
            return f"object of {len(whole)} keys: {', '.join(keys)}"
        if kind in (".csv", ".tsv", *TABLES, ".json"):
            columns, rows = table_rows(path)
            more = ", ..." if len(columns) > _KEYS_SHOWN else ""
            return f"table of {len(rows)} lines: {', '.join(columns[:_KEYS_SHOWN])}{more}"
        if kind in (".npz", ".npy"):
            arrays, pickled = ArrayFiles().of(path)
            shown = [f"{name} {array.shape} {array.dtype}".strip() for name, array in arrays.items()]
            return "arrays: " + ", ".join([*shown, *(f"{name} (pickled, never read)" for name in pickled)])
        if kind in VIDEOS:
            return f"video of {len(video_frames(path))} frames"
        if kind in _PICTURES:
            picture = exr_rgb(path) if kind == ".exr" else pixels_of(path)
            colours = "grey" if picture.shape[2] == 1 else "colour"
            return f"picture of {picture.shape[1]} x {picture.shape[0]} px, {picture.dtype}, {colours}"
    except ImportFormatError as why:
        return str(why).removeprefix(f"{path}: ")
    return "not read"
