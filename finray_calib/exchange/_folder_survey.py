"""What lies in a folder of another lab that no recipe reads yet, and the beginning of a recipe for it.

Names of columns, arrays and keys propose what they may hold; a proposal is a comment of the recipe, since a name may
mean something else. A unit is proposed only where the name states it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError, MissingExtraError
from data_schemas.storage import files_below, folder_at, read_json, read_text, toml_text
from finray_calib.exchange._capture_recipe import PLACEHOLDER
from finray_calib.exchange._set_files import (
    ARRAY_IN,
    TABLES,
    TEXTS_OF_NUMBERS,
    VIDEOS,
    ArrayFiles,
    exr_rgb,
    flat_entries,
    pixels_of,
    read_video,
    table_rows,
)


@dataclass(frozen=True, slots=True)
class FolderSurvey:
    """What a folder of files that no recipe reads yet holds, a line for each kind, and the start of a recipe for it."""

    lines: tuple[str, ...]
    recipe: str


_PICTURES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".exr", ".npy")
_NO_CONTACT: Final = re.compile(
    r"(^|[^a-z])(bg|background|baseline|blank|ref|rest|flat|empty|no_?contact|no_?touch|untouched|init)", re.I
)
_BEFORE: Final = re.compile(r"(^|[^a-z])(pre|before|free)(?![a-z])", re.I)
_AFTER: Final = re.compile(r"(^|[^a-z])(post|after)(?![a-z])", re.I)
_MAP: Final = re.compile("depth|height", re.I)
_TIME: Final = re.compile(r"(t|.*time.*|.*stamp.*|.*_m?s)", re.I)
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_GROUPS_SHOWN, _KEYS_SHOWN, _NAMED = 12, 16, 4
_WITH_PICTURES: Final = (*_PICTURES, *VIDEOS, ".npz")
_RUN_OF_DIGITS: Final = re.compile(r"\d+(?:\.\d+)?")
_NUMBER: Final = re.compile(r"[-+]?\.?\d|[-+]?(nan|inf)\b", re.I)
_MOST_SURVEYED = 20_000
_RECIPE_START: Final = """\
name = "mine"
what = "DESCRIBE: what was pressed, with which sensor, by whom"
# licence = "CC BY 4.0"

[presses]
files = {files}{chosen}

[picture]
channels = "RGB"              # "BGR" where red and blue are exchanged

[no_contact]
{no_contact}

[contact]                     # better: circle, outline or depth_map of the files below
search = "circle"{contact}

# [scale]
# mm_per_px = 0.05

[indenter]
shape = "ball"                # or cylinder, cuboid, mesh
{indenter}

# what else lies in the folder:
{rest}
"""


@dataclass
class _Kind:
    """Files whose names differ in their numbers only.

    Attributes
    ----------
    names
        Paths within the folder, in order.
    told
        What the first of them holds, in words.
    columns
        Columns, keys or arrays of the first -> shape of an array, or () of a number.
    is_table
        Whether it has a line for each press.
    cells
        Column of a table -> its cells.
    picture
        Shape of the first picture.
    """

    names: list[str]
    told: str = "not read"
    columns: dict[str, tuple[int, ...]] = field(default_factory=dict)
    is_table: bool = False
    cells: dict[str, list[str]] = field(default_factory=dict)
    picture: tuple[int, ...] = ()

    @property
    def suffix(self) -> str:
        """Kind of file."""
        return PurePosixPath(self.names[0]).suffix.lower()

    @property
    def stem(self) -> str:
        """Name of the first file."""
        return PurePosixPath(self.names[0]).stem


def survey_folder(folder: Path) -> FolderSurvey:
    """Say what a folder of another lab holds, and write the start of a recipe for it.

    Files whose names differ in their numbers only are one kind. Those with the most pictures are taken for the presses;
    a picture whose name says so, for the one without contact. What columns, arrays and parts of names may hold is
    proposed in comments, by their names.

    Parameters
    ----------
    folder
        Of the set, or a zip archive of it.

    Raises
    ------
    ImportFormatError
        There is no such folder, or no picture, video or array in it.
    """
    inside = folder_at(folder, ImportFormatError)
    if inside is None:
        raise ImportFormatError(f"{folder}: no such folder or zip archive; give the folder of the set")
    found: dict[str, list[str]] = {}
    for path in sorted(islice(files_below(inside), _MOST_SURVEYED)):
        name = path.relative_to(inside).as_posix()
        if not path.name.startswith("."):
            found.setdefault(_RUN_OF_DIGITS.sub("\0", name), []).append(name)  # no name of a file holds a NUL
    if not found:
        raise ImportFormatError(f"{folder}: contains no file; give the folder of the set")
    kinds = [_Kind(names) for names in sorted(found.values(), key=len, reverse=True)]
    if not any(kind.suffix in _WITH_PICTURES for kind in kinds):
        held = ", ".join(_printable(f"{len(kind.names)} x {_pattern(kind.names)}") for kind in kinds[:_NAMED])
        raise ImportFormatError(
            f"{folder}: contains no picture, video or array ({', '.join(_WITH_PICTURES)}), but {held}"
            f"{', ...' if len(kinds) > _NAMED else ''}; give the folder or archive that holds the images of the presses"
        )
    for kind in kinds[:_GROUPS_SHOWN]:
        _look(kind, inside / kind.names[0])
    lines = [_printable(f"{len(kind.names)} x {_pattern(kind.names)}: {kind.told}") for kind in kinds[:_GROUPS_SHOWN]]
    if len(kinds) > _GROUPS_SHOWN:
        lines.append(f"and {len(kinds) - _GROUPS_SHOWN} more kinds of files")
    # a recipe is UTF-8, and cannot name what is not
    return FolderSurvey(tuple(lines), _begun([k for k in kinds if not _SURROGATE.search(k.names[0])], lines))


def _begun(kinds: Sequence[_Kind], lines: Sequence[str]) -> str:
    """Return the start of a recipe."""
    pictures = [kind for kind in kinds if kind.suffix in (*_PICTURES, *VIDEOS)]
    touched = _touched(pictures)
    untouched = [name for kind in pictures if _NO_CONTACT.search(kind.stem) for name in kind.names]
    files, chosen = _pattern(touched[0].names) if touched else "{press}.png", ""
    stacks = [(kind, array) for kind in kinds for array, shape in kind.columns.items() if _is_stack(array, shape)]
    words = _words(touched[0].names) if touched else {}
    named = touched[0] if touched else _Kind([files])
    if len(touched) > 1 and len(touched[0].names) == 1:
        files, named = _without_numbers(touched)
    elif stacks and (not touched or len(touched[0].names) == 1):
        (holder, array), words = stacks[0], {}
        files = f"{holder.names[0]}{ARRAY_IN}{array}[{{press}}]"
        untouched += [
            f"{holder.names[0]}{ARRAY_IN}{other}"
            for other, shape in holder.columns.items()
            if _NO_CONTACT.search(other) and shape == holder.columns[array][1:]
        ]
    elif touched:
        chosen = _chosen(files, touched[0].names, pictures)
    presses = touched[0] if touched and ARRAY_IN not in files else _Kind([files])
    rest = "median_of_presses = true      # a substitute: better name a file"
    if presses.suffix in VIDEOS:
        rest = "frames_before = 10"
    elif around := _around(presses, words, pictures):
        rest = "\n".join(f"{field} = {toml_text(file)}" for field, file in around.items())
    elif untouched:
        rest = f"file = {toml_text(_rest_file(untouched, named, files))}"
    contact, indenter = _proposals(presses, words, kinds)
    return _RECIPE_START.format(
        files=toml_text(files),
        chosen=chosen,
        no_contact=rest,
        contact="".join(f"\n# {_printable(line)}" for line in contact),
        indenter="\n".join(f"# {_printable(line)}" for line in indenter),
        rest="\n".join(f"# {line}" for line in lines),
    )


def _without_numbers(touched: Sequence[_Kind]) -> tuple[str, _Kind]:
    """Return pattern and files of presses without numbers: one name in a folder for each, or names in one folder."""
    paths = [PurePosixPath(kind.names[0]) for kind in touched]
    first = paths[0]
    alike = [path for path in paths if path.name == first.name and path.parent.parent == first.parent.parent]
    if len(alike) > 1:
        return str(first.parent.parent / "{press}" / first.name), _Kind([str(path) for path in alike])
    return str(first.parent / f"{{press}}{first.suffix}"), touched[0]


def _touched(pictures: Sequence[_Kind]) -> Sequence[_Kind]:
    """Return the kinds that may show contact: of pictures from before and after something, those from between."""
    shown = [kind for kind in pictures if not (_NO_CONTACT.search(kind.stem) or _MAP.search(kind.stem))] or pictures
    if not any(_BEFORE.search(kind.stem) for kind in shown):
        return shown
    later = [kind for kind in shown if not _BEFORE.search(kind.stem)]
    return [kind for kind in later if not _AFTER.search(kind.stem)] or later or shown


def _around(presses: _Kind, words: Mapping[int, str], pictures: Sequence[_Kind]) -> dict[str, str]:
    """Return the patterns of the pictures before each press, and after it where those do not show the contact."""
    found = dict[str, str]()
    for name, when in (("file", _BEFORE), ("repeat_file", _AFTER)):
        for kind in pictures:
            if kind is not presses and len(kind.names) > 1 and when.search(kind.stem):
                file = _pattern_like(kind, presses, words)
                if set(PLACEHOLDER.findall(file)) == set(words.values()):
                    found.setdefault(name, file)
    return found if "file" in found else {}


def _is_stack(name: str, shape: tuple[int, ...]) -> bool:
    """Return whether an array holds pictures of several presses."""
    return len(shape) == 4 and shape[0] > 1 and shape[-1] in (1, 3) and not _NO_CONTACT.search(name)


def _rest_file(untouched: Sequence[str], presses: _Kind, files: str) -> str:
    """Return the picture without contact, or where each folder of presses holds one, the pattern of their paths."""
    first = PurePosixPath(untouched[0])
    own = {str(PurePosixPath(name).parent / first.name) for name in presses.names}
    return str(PurePosixPath(files).parent / first.name) if len(own) > 1 and own <= set(untouched) else untouched[0]


def _chosen(files: str, names: Sequence[str], pictures: Sequence[_Kind]) -> str:
    """Return the line that leaves out other pictures which the pattern of the presses fits, too."""
    before, marked, after = files.partition("{press}")
    if not marked:
        return ""
    presses = [name[len(before) : len(name) - len(after)] for name in names]
    others = [
        name[len(before) : len(name) - len(after)]
        for kind in pictures
        for name in kind.names
        if name not in names and name.startswith(before) and name.endswith(after) and len(name) > len(before + after)
    ]
    if not others:
        return ""
    for only in ("?" * len(presses[0]), "*[0-9]", "[0-9]*"):
        if all(fnmatchcase(name, only) for name in presses) and not any(fnmatchcase(name, only) for name in others):
            return f"\nonly = {toml_text(only)}"
    return f"\nleave_out = [{', '.join(map(toml_text, others))}]" if len(others) <= _KEYS_SHOWN else ""


#: What a column, array or key may hold, by what its name ends in, without its unit and index.
_ROLES: Final = {
    "radius_px": r"r|rad|radius|(contact|circle)_?r(adius)?",
    "column_px": r"x|cx|u|col|column|x_?c(ent(er|re))?|c(ent(er|re))?_?x",
    "row_px": r"y|cy|v|row|y_?c(ent(er|re))?|c(ent(er|re))?_?y",
    "diameter_mm": r".*(diam|diameter)|ball|sphere",
    "force": r"f|fz|f_?n|.*force(_?[zn])?|kraft|load",
    "depth_mm": r"d|z|.*depth|.*depths|tiefe|indentation|penetration",
}
_CIRCLE: Final = ("column_px", "row_px", "radius_px")
#: Told lines keep a # where those that propose are uncommented.
_INSTEAD: Final = "# or, in place of search:"
_UNIT: Final = re.compile(r"[_ .(\[]+(px|pixels?|mm|cm|um|m|mN|N|kg|g)[\])]?$")
_INDEX: Final = re.compile(r"\[(\d+)\]$")
_CENTRE: Final = re.compile(r"(.*[_.])?(cent(er|re)|centroid|xy|uv|position_px)", re.I)
_OF_POSE: Final = re.compile(r"(pos|pose|position|orientation|quat|quaternion|torque|rotation)([_.\[]|$)", re.I)


def _role(name: str, shape: tuple[int, ...] = ()) -> tuple[str, str]:
    """Return what a column or array may hold, "" where its name does not say, and the unit that it states."""
    index = _INDEX.search(name)
    bare = _INDEX.sub("", name)
    unit = _UNIT.search(bare)
    bare = bare[: unit.start()] if unit else bare
    told = unit[1] if unit else ""
    if index is not None and _CENTRE.fullmatch(bare):
        return {"0": "column_px", "1": "row_px"}.get(index[1], ""), told
    path, _, last = bare.lower().rpartition(".")
    if _OF_POSE.search(f"{path}.{last}"):
        return "", ""
    if re.search("force|wrench", f"{path}.{last}"):  # of a vector the part along the normal
        along = last == "z" or (last != "x" and last != "y" and (index is None or index[1] == "2"))
        return ("force" if along else ""), told
    if index is not None or len(shape) > 1:
        return "", ""
    return next((role for role, pattern in _ROLES.items() if re.fullmatch(pattern, last)), ""), told


def _proposals(presses: _Kind, words: Mapping[int, str], kinds: Sequence[_Kind]) -> tuple[list[str], list[str]]:
    """Return lines for [contact], and for [indenter] and [force], by the names of what the files hold."""
    contact, indenter = list[str](), list[str]()
    of_names = {f"{{{word}}}": _role_in_name(presses.names[0], k) for k, word in words.items()}
    _propose_numbers(indenter, of_names, [])
    for kind in kinds:
        file = _pattern_like(kind, presses, words)
        known = {*words.values(), *(["press"] if ARRAY_IN in presses.names[0] else [])}
        if kind is presses or not set(PLACEHOLDER.findall(file)) <= known:
            continue
        if kind.picture and _MAP.search(file) and PLACEHOLDER.search(file):
            contact += [_INSTEAD, "[contact.depth_map]", f"file = {toml_text(file)}"]
            contact.append('value_mm = "FILL IN"      # mm in 1 of its values; below 0 where they fall under pressure')
        at = [f"file = {toml_text(file)}"]
        if kind.is_table and presses.suffix not in VIDEOS:
            at.append(
                f"press = {toml_text(_press_column(kind, presses) or 'FILL IN: the column that names the press')}"
            )
        roles = {_entry(name, shape, kind): _role(name, shape) for name, shape in kind.columns.items()}
        circle = [next((name for name, (role, _) in roles.items() if role == part), "") for part in _CIRCLE]
        if all(circle):
            told = ", ".join(f"{part} = {toml_text(name)}" for part, name in zip(_CIRCLE, circle, strict=True))
            unsure = [name for name in circle if not roles[name][1].startswith("p")]
            contact += [_INSTEAD, *at, f"circle = {{ {told} }}"]
            contact += [f"# CHECK that {', '.join(unsure)} are in pixels: their names do not say"] if unsure else []
        _propose_numbers(indenter, roles, at)
        time = next((name for name in kind.columns if _TIME.fullmatch(name)), None)
        if presses.suffix in VIDEOS and kind.is_table and time is not None and "[force]" in indenter:
            indenter.append(
                f'frames = {{ time = {toml_text(time)}, unit = "s" }}  # CHECK the unit: or "ms", "us", "ns"'
            )
    if not any(line.startswith("diameter_mm") for line in indenter):
        indenter.insert(0, "diameter_mm = 4.0")
    return contact, indenter


def _propose_numbers(lines: list[str], roles: Mapping[str, tuple[str, str]], at: Sequence[str]) -> None:
    """Add lines for sizes and the force."""
    sizes = {role: name for name, (role, _) in roles.items() if role in ("diameter_mm", "depth_mm")}
    if sizes and not any(line.startswith("depth_mm") for line in lines):
        units = ", ".join(f'{role} = "{roles[name][1] or "FILL IN"}"' for role, name in sizes.items())
        unsure = [name for name in sizes.values() if not roles[name][1]]
        lines += [*at, *(f"{role} = {toml_text(name)}" for role, name in sizes.items())]
        lines.append(f"columns_in = {{ {units} }}")
        lines += [f'# FILL IN "mm", "cm", "m" or "um", which {", ".join(unsure)} does not say'] if unsure else []
    force = next((name for name, (role, _) in roles.items() if role == "force"), None)
    if force is not None and "[force]" not in lines:
        unit = roles[force][1]
        lines += ["[force]", *at, f"column = {toml_text(force)}"]
        lines.append(
            f"unit = {toml_text(unit)}"
            if unit
            else 'unit = "FILL IN"          # "N", "mN", "g" or "kg": the name does not say'
        )


def _entry(name: str, shape: tuple[int, ...], kind: _Kind) -> str:
    """Return the name of a number of one press: of an array of all presses, its entry."""
    if kind.suffix != ".npz" or not shape:
        return name
    if len(kind.names) > 1:  # of a vector the part along z, also of force and torque together
        return f"{name}[2]" if shape in ((3,), (6,)) else name
    return f"{name}[{{press}}]" if len(shape) == 1 else f"{name}[{{press}}, {min(2, shape[1] - 1)}]"


def _press_column(kind: _Kind, presses: _Kind) -> str:
    """Return the column whose cells name files of presses; "" where none does for half of its lines."""
    called = {part for name in presses.names for part in (PurePosixPath(name).name, PurePosixPath(name).stem)}
    called |= {number for name in presses.names for number in _RUN_OF_DIGITS.findall(PurePosixPath(name).stem)[-1:]}
    for column, cells in kind.cells.items():
        named = sum(PurePosixPath(cell.strip().replace("\\", "/")).name in called for cell in cells)
        if cells and 2 * named >= len(cells):
            return column
    return ""


def _printable(text: str) -> str:
    """Return a text in one line, with escapes for what cannot be shown."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _numbers(names: Sequence[str]) -> tuple[NDArray[Any], list[int]]:
    """Return the numbers in names (files, places), and the places that differ."""
    numbers = np.array([_RUN_OF_DIGITS.findall(name) for name in names])
    return numbers, [k for k in range(numbers.shape[1]) if len(set(numbers[:, k])) > 1]


def _words(names: Sequence[str]) -> dict[int, str]:
    """Return place of a number that differs -> its word: press, or where several do, the letters in front of it."""
    _, differ = _numbers(names)
    if len(differ) < 2:
        return dict.fromkeys(differ, "press")
    between = _RUN_OF_DIGITS.split(names[0])
    words: dict[int, str] = {}
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    for k in differ[:26]:
        front = re.search(r"([a-z]+)[^a-z/]*$", between[k].lower())
        taken = {*words.values(), "group", "press"}
        own = front is not None and front[1] not in taken
        words[k] = front[1] if front is not None and own else next(letter for letter in letters if letter not in taken)
    return words


def _role_in_name(name: str, place: int) -> tuple[str, str]:
    """Return what a number in a name may be, by the letters in front of it and the unit behind it."""
    between = _RUN_OF_DIGITS.split(name)
    front = re.search(r"([a-z]+)[^a-z/]*$", between[place].lower())
    unit = re.match(r"_?(px|mm|cm|um|mN|N|kg|g)(?![a-z])", between[place + 1])
    role = _role(front[1])[0] if front else ""
    numbers = ("diameter_mm", "depth_mm", "force") if unit else ("depth_mm", "force")  # ball_3 is no ball of 3 mm
    return (role if role in numbers else ""), unit[1] if unit else ""


def _pattern(names: Sequence[str], words: Mapping[int, str] | None = None) -> str:
    """Return the pattern of names that differ in their numbers."""
    numbers, differ = _numbers(names)
    words = _words(names) if words is None else words
    between = _RUN_OF_DIGITS.split(names[0])
    held = [f"{{{words[k]}}}" if k in differ and k in words else numbers[0, k] for k in range(numbers.shape[1])]
    return "".join(part + number for part, number in zip(between, [*held, ""], strict=True))


def _pattern_like(kind: _Kind, presses: _Kind, words: Mapping[int, str]) -> str:
    """Return the pattern of a kind of files by the words of the presses, where both hold the same numbers."""
    (own, places), (theirs, of_presses) = _numbers(kind.names), _numbers(presses.names)
    if places and len(places) == len(of_presses) and np.array_equal(own[:, places], theirs[:, of_presses]):
        return _pattern(kind.names, dict(zip(places, words.values(), strict=True)))
    return _pattern(kind.names)


def _look(kind: _Kind, path: Path) -> None:
    """Note what the first file of a kind holds; what cannot be read says why not."""
    try:
        kind.told = _content(kind, path)
    except (ImportFormatError, MissingExtraError) as why:
        kind.told = str(why).removeprefix(f"{path}: ")


def _content(kind: _Kind, path: Path) -> str:
    """Return what a file of a set holds, in words."""
    suffix = kind.suffix
    whole = read_json(path, "labels", ImportFormatError, any_number=True) if suffix == ".json" else None
    if isinstance(whole, dict) and not any(
        isinstance(of, list) and of and isinstance(of[0], dict) for of in whole.values()
    ):
        keys = [key for key, _ in flat_entries(whole)]
        kind.columns = dict.fromkeys(keys, ())
        return f"object of {len(whole)} keys: {', '.join(keys[:_KEYS_SHOWN])}"
    if suffix in (".csv", ".tsv", *TABLES, ".json"):
        return _table(kind, path)
    if suffix in (".npz", ".npy"):
        arrays, pickled = ArrayFiles().of(path)
        kind.columns = {name: array.shape for name, array in arrays.items()}
        kind.picture = arrays[""].shape if suffix == ".npy" and arrays and arrays[""].ndim in (2, 3) else ()
        shown = [f"{name} {array.shape} {array.dtype}".strip() for name, array in arrays.items()]
        return "arrays: " + ", ".join([*shown, *(f"{name} (pickled, never read)" for name in pickled)])
    if suffix in TEXTS_OF_NUMBERS:
        if not _is_of_numbers(path):
            return _table(kind, path)
        lines, places = ArrayFiles().of(path)[0][""].shape
        return f"numbers without names: {lines} x {places}"
    if suffix in VIDEOS:
        return f"video of {len(read_video(path).frames)} frames"
    if suffix in (".tif", ".tiff") and len(pages := ArrayFiles().of(path)[0][""]) > 1:
        kind.columns = {"": (*pages.shape[:3], 3)}
        return f"pictures: {len(pages)} of {pages.shape[2]} x {pages.shape[1]} px, {pages.dtype}"
    if suffix in _PICTURES:
        picture = exr_rgb(path) if suffix == ".exr" else pixels_of(path)
        kind.picture = picture.shape
        colours = "grey" if picture.shape[2] == 1 else "colour"
        return f"picture of {picture.shape[1]} x {picture.shape[0]} px, {picture.dtype}, {colours}"
    return "not read"


def _is_of_numbers(path: Path) -> bool:
    """Return whether the first line of a text that says something begins with a number."""
    lines = (line.strip() for line in read_text(path, "a text", ImportFormatError).splitlines())
    first = next((line for line in lines if line), "#")
    return first.startswith("#") or _NUMBER.match(first) is not None


def _table(kind: _Kind, path: Path) -> str:
    """Return what a table holds, in words."""
    columns, rows = table_rows(path)
    if kind.suffix in TEXTS_OF_NUMBERS and all(map(_RUN_OF_DIGITS.fullmatch, columns)):
        return f"numbers without names: {len(rows) + 1} x {len(columns)}"
    kind.columns, kind.is_table = dict.fromkeys(columns, ()), True
    kind.cells = {column: [row.get(column, "") for row in rows] for column in columns}
    more = ", ..." if len(columns) > _KEYS_SHOWN else ""
    return f"table of {len(rows)} lines: {', '.join(columns[:_KEYS_SHOWN])}{more}"
