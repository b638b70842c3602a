"""Which files of a folder are its presses, and what their names hold, by the patterns of a recipe.

Words in braces stand for parts of a name. Where the recipe takes one for a number, the name must hold a number there.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np

from data_schemas import ImportFormatError
from data_schemas.storage import files_below
from finray_calib.exchange._ball_presses import MOST_PRESSES
from finray_calib.exchange._capture_recipe import PLACEHOLDER, PRESS, SIZES, Recipe, composed, texts_of
from finray_calib.exchange._set_files import ARRAY_IN, file_inside, require_inside


class LeftOutError(Exception):
    """Why a press cannot be read; the others can."""


MOST_FILES = 200_000
_FILES_SHOWN: Final = 4
_LEAVE_OUT: Final = "presses.leave_out"


def named_presses(recipe: Recipe) -> dict[str, list[str]]:
    """Return key of the recipe -> presses that it names one by one."""
    found: dict[str, list[str]] = {_LEAVE_OUT: list(recipe.presses.leave_out)}
    for what in ("shape", *SIZES):
        if isinstance(of := getattr(recipe.indenter, what), dict):
            found[f"indenter.{what}"] = list(of)
    if recipe.contact is not None and recipe.contact.outline_px:
        found["contact.outline_px"] = list(recipe.contact.outline_px)
    return found


def is_named(press: str, name: str) -> bool:
    """Return whether a key of a table by names means a press: it is its name, or fits it where it has a *."""
    return press == name or ("*" in name and fnmatchcase(press, name))


@dataclass(frozen=True, slots=True)
class PressFile:
    """The picture of a press.

    Attributes
    ----------
    path
        Of its file, or of a picture in an array of one, ``set.npz::images[3]``.
    words
        Placeholder of presses.files -> what it stands for in the name; press and group are always there.
    """

    path: Path
    words: Mapping[str, str]

    def filled(self, pattern: str) -> str:
        """Return a text of the recipe with its placeholders replaced."""
        return PLACEHOLDER.sub(lambda found: self.words.get(found[1], found[0]), pattern)


_NUMBER_IN_A_NAME = r"[+-]?\d+(?:[.p]\d+)?(?:e[+-]?\d+)?"
#: Beside any text a number is whole: 0.75 of ball_d0.75mm, not its 5.
_BEGINS, _ENDS = r"(?<![\d.+-])(?<!\dp)(?<!\de)", r"(?!\d|[.p]\d|e[+-]?\d)"


def number_in_name(text: str) -> float | None:
    """Return a number of a file's name, such as -0.75, 0p75 or 1e-3; None where it is none, or not finite."""
    number = float(text.replace("p", ".")) if re.fullmatch(_NUMBER_IN_A_NAME, text) else np.inf
    return number if np.isfinite(number) else None


def _expressions(recipe: Recipe, pattern: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Return what names of files must fit: with numbers where the recipe wants them, and with any text there."""
    said = (recipe.no_contact, recipe.contact, recipe.scale, recipe.indenter, recipe.force)
    texts = texts_of([part.model_dump() for part in said if part is not None])
    # literal texts at even places, words and * between them
    parts = re.split(r"(\{[a-z_][a-z0-9_]*\}|\*)", pattern)
    numbers = {found[1] for text in texts if (found := PLACEHOLDER.fullmatch(text)) is not None}
    made = []
    for wanted in (numbers, set[str]()):
        seen, whole = set[str](), ""
        for k, part in enumerate(parts):
            word = part[1:-1] if PLACEHOLDER.fullmatch(part) else ""
            if word in seen:
                whole += f"(?P={word})"
            elif word:
                text = _NUMBER_IN_A_NAME if word in wanted else ".+" if part == PRESS else "[^/]+?"
                begins = _BEGINS if word in numbers and k > 1 and not parts[k - 1] else ""
                ends = _ENDS if word in numbers and k + 2 < len(parts) and not parts[k + 1] else ""
                whole += f"{begins}(?P<{word}>{text}){ends}"
            else:
                whole += "[^/]*" if part == "*" else re.escape(composed(part))
            seen |= {word} - {""}
        made.append(re.compile(whole))
    return made[0], made[1]


def press_files(folder: Path, recipe: Recipe, count: Callable[[Path, str], int]) -> Iterator[tuple[str, PressFile]]:
    """Return name and file of every press, in the order of their names, whole numbers by value.

    Parameters
    ----------
    folder
        Of the set.
    recipe
        How it is read.
    count
        Gives the number of pictures in an array of a file.
    """
    pattern, _, array = recipe.presses.files.partition(ARRAY_IN)
    if PLACEHOLDER.search(recipe.presses.files) is None or recipe.presses.files.count(PRESS) > 1:
        raise ImportFormatError(
            f"recipe '{recipe.name}': presses.files = \"{recipe.presses.files}\" must contain {PRESS}, the name of the "
            "press, exactly once, or other words for parts of the name, such as {depth}"
        )
    if array and not re.fullmatch(r"[^\[\]/{}]*\[\{press\}\]", array):
        raise ImportFormatError(
            f"recipe '{recipe.name}': presses.files = \"{recipe.presses.files}\" must end in the name of an array and "
            f"[{PRESS}], such as {pattern}{ARRAY_IN}images[{PRESS}], or for npy and TIFF files in [{PRESS}] alone, "
            f"such as {pattern}{ARRAY_IN}[{PRESS}]"
        )
    require_inside(pattern)
    strict, loose = _expressions(recipe, pattern)
    found: dict[str, PressFile] = {}
    for number, path in enumerate(files_below(folder)):
        if number > MOST_FILES:
            raise ImportFormatError(
                f"{folder}: contains more than {MOST_FILES} files, which is too many; give a subfolder"
            )
        inner = composed(path.relative_to(folder).as_posix())
        match = None if path.name.startswith("._") else strict.fullmatch(inner) or loose.fullmatch(inner)
        if match is None:  # "._" is what macOS writes beside a file on other disks
            continue
        for name, press in _presses_of(path, match, array.partition("[")[0] if array else None, count):
            if not fnmatchcase(name, recipe.presses.only):
                continue
            if not path.resolve().is_relative_to(folder.resolve()):
                raise ImportFormatError(f"{path}: points outside the folder; copy the file into the folder")
            if name in found:
                raise ImportFormatError(
                    f"{found[name].path} and {path.relative_to(folder)} are both press '{name}' by presses.files of "
                    f"the recipe '{recipe.name}' ({recipe.presses.files}); move one of the files away, or let {PRESS} "
                    "cover the part of the names that differs"
                )
            found[name] = press
    yield from _ordered(folder, recipe, found)


def _presses_of(
    path: Path, match: re.Match[str], array: str | None, count: Callable[[Path, str], int]
) -> Iterator[tuple[str, PressFile]]:
    """Return the presses of a file: one, or those of an array in it."""
    words = match.groupdict()
    if array is not None:
        above = "/".join(words.values())
        for index in range(count(path, array)):
            inner = path.with_name(f"{path.name}{ARRAY_IN}{array}[{index}]")
            yield (
                f"{above}/{index}" if above else f"{index}",
                PressFile(inner, {"group": above, **words, "press": f"{index}"}),
            )
        return
    name = words.get("press") or match.string[match.start(1) : max(match.end(word) for word in words)]
    yield name, PressFile(path, {"press": name, "group": PurePosixPath(name).parent.as_posix(), **words})


def _ordered(folder: Path, recipe: Recipe, found: Mapping[str, PressFile]) -> Iterator[tuple[str, PressFile]]:
    """Return the presses in the order of their names; refuse none, and too many."""
    if not found:
        raise ImportFormatError(
            f"{folder}: no file in the folder matches presses.files of the recipe '{recipe.name}' "
            f"({recipe.presses.files}); give the parent folder, or correct presses.files (upper and lower case count)"
            + _seen(folder)
        )
    # digits stand at the odd places
    ordered = sorted(found, key=lambda name: [int(p) if k % 2 else p for k, p in enumerate(re.split(r"(\d+)", name))])
    if len(ordered) > MOST_PRESSES:
        raise ImportFormatError(
            f"{folder}: contains {len(ordered)} presses, but at most {MOST_PRESSES} are supported; give a smaller "
            "folder"
        )
    for name in ordered:
        yield name, found[name]


def _seen(folder: Path) -> str:
    """Return some names of a folder's files."""
    names = [path.relative_to(folder).as_posix() for path in islice(files_below(folder), _FILES_SHOWN)]
    return f"; the folder holds, for example, {', '.join(sorted(names))}" if names else "; the folder holds no file"


def named_file(folder: Path, pattern: str, press: PressFile) -> Path:
    """Return the path of a press's file; a link that leads out of the folder is refused."""
    require_inside(pattern)
    return file_inside(folder, press.filled(pattern))


def refuse_misspelt(folder: Path, recipe: Recipe, files: Collection[str]) -> None:
    """Refuse a table by names that misses a press and names one that is not there: it is misspelt.

    Raises
    ------
    ImportFormatError
        There is one.
    """
    read = [name for name in files if name not in recipe.presses.leave_out]
    for where, names in named_presses(recipe).items():
        unknown = [
            name
            for name in names
            if not any(is_named(press, name) for press in files) and fnmatchcase(name, recipe.presses.only)
        ]
        missing = [press for press in read if not any(is_named(press, name) for name in names)]
        if where != _LEAVE_OUT and unknown and missing:
            raise ImportFormatError(
                f"recipe '{recipe.name}': {where} names '{unknown[0]}', but {folder} has no such press, and the press "
                f"'{missing[0]}' is not named; correct the name to match presses.files ({recipe.presses.files})"
            )
