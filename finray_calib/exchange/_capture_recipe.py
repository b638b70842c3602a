"""Recipes: how another lab's folder of presses is read, as a short TOML file.

A recipe says which files are the presses, where the image without contact is, which columns or arrays hold the contact,
the scale with its unit, and what was pressed. Those of public sets come with the program; a file of your own is read by
the same rules. Here are also the tables and arrays of labels that a recipe names.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Final, Literal
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from data_schemas import ImportFormatError, MissingPart, Model, explain
from data_schemas.storage import files_below, has_file, read_csv, read_json, read_toml_tables
from finray_calib.exchange._ball_presses import LARGEST_PIXEL_MM, MOST_PRESSES, read_npz, require_length
from finray_calib.sensing import ROW_AND_COLUMN, vote_on_circles

Floats = NDArray[np.float64]

RECIPES: Final = Path(__file__).parent / "recipes"
PRESS: Final = "{press}"
GROUP: Final = "{group}"

Pattern = Annotated[str, Field(min_length=1, max_length=300)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Quantity = Annotated[str, Field(min_length=1, max_length=100)] | Positive
"""A number, or the column of a table or the array of an npz file that holds it; ``center[0]`` is an entry of one."""
OfPress = dict[str, Positive] | Quantity
"""The same, or a number for each press by its name."""
Place = Annotated[float, Field(ge=0.0, le=1e6)]
PlaceOfPress = dict[str, Place] | Annotated[str, Field(min_length=1, max_length=100)] | Place
"""The same of a place, which may be 0."""
Corner = tuple[float, float]
Shape = tuple[int, int]


class RecipePresses(Model):
    """Which files are the presses."""

    files: Pattern = Field(
        description="path within the folder; {press} stands for the name of the press, * for any part of a file's name"
    )
    only: Pattern = Field(default="*", description="which of these presses are read: their names, * for any part")
    leave_out: tuple[str, ...] = Field(default=(), description="names of presses that are not to be read")


class RecipePicture(Model):
    """How the values of a picture are read."""

    channels: Literal["RGB", "BGR"] = Field(default="RGB", description="BGR: red and blue are exchanged in the files")
    encoding: Literal["linear", "unknown"] = "unknown"
    full_scale: Positive | None = Field(
        default=None, description="value of an OpenEXR image that is mapped to 65535, the largest stored value"
    )
    bit_depth: Literal[10, 12, 14, 16] | None = Field(
        default=None, description="bits of the camera's counts where files of 16 bits hold fewer, such as 12"
    )
    corners_px: tuple[Corner, Corner, Corner, Corner] | None = Field(
        default=None, description="corners of the gel: top left, top right, bottom left, bottom right (column, row)"
    )
    size_px: tuple[Annotated[int, Field(ge=16, le=8192)], Annotated[int, Field(ge=16, le=8192)]] | None = Field(
        default=None, description="width and height that the corners are stretched to"
    )

    @model_validator(mode="after")
    def _corners_have_a_size(self) -> "RecipePicture":
        if (self.corners_px is None) != (self.size_px is None):
            raise ValueError("corners_px and size_px go together: give both or leave both out")
        return self


class RecipeNoContact(Model):
    """Where the image without contact comes from: exactly one of these."""

    file: Pattern | None = Field(
        default=None,
        description="path within the folder; contains {press} if each press has its own file, or {group} if the "
        "presses of a folder share one file ({group} is the folder part of a press's name, such as ball in ball/3)",
    )
    repeat_file: Pattern | None = Field(default=None, description="a second image without contact")
    frames_before: Annotated[int, Field(ge=2, le=1000)] | None = Field(
        default=None, description="number of frames without contact at the beginning of each video"
    )
    median_of_presses: bool = Field(
        default=False, description="a substitute: the median of all presses, pixel by pixel"
    )
    far_pixels: bool = Field(
        default=False, description="a substitute: a smooth surface through the pixels far from the contact"
    )

    @model_validator(mode="after")
    def _one_source(self) -> "RecipeNoContact":
        given = (self.file is not None, self.frames_before is not None, self.median_of_presses, self.far_pixels)
        if sum(given) != 1:
            raise ValueError("give exactly one of file, frames_before, median_of_presses and far_pixels")
        if self.repeat_file is not None and self.file is None:
            raise ValueError("repeat_file needs file; give file too, or leave repeat_file out")
        return self


class RecipeCircle(Model):
    """Columns of the contact circle."""

    column_px: Quantity
    row_px: Quantity
    radius_px: Quantity


class RecipeContact(Model):
    """Where the contact is: exactly one of circle, outline, outline_px and search."""

    file: Pattern | None = Field(
        default=None,
        description="CSV table with one line for each press, or an npz or JSON file whose path has {press}",
    )
    press: str | None = Field(
        default=None, description="column of the table that names the press: its file, or its folder"
    )
    circle: RecipeCircle | None = None
    outline: tuple[str, ...] = Field(
        default=(), description="arrays of the npz file that hold corners (column, row); the contact is their hull"
    )
    outline_px: dict[str, tuple[Corner, ...]] = Field(
        default={}, description="name of the press -> corners (column, row)"
    )
    search: Literal["circle", "outline"] | None = Field(
        default=None, description="find it in the picture: the circle of a ball, or the region that changes most"
    )

    @model_validator(mode="after")
    def _one_source(self) -> "RecipeContact":
        given = (self.circle is not None, bool(self.outline), bool(self.outline_px), self.search is not None)
        if sum(given) != 1:
            raise ValueError("give exactly one of circle, outline, outline_px and search")
        if (self.circle is not None or self.outline) and self.file is None:
            raise ValueError("file: missing; the circle or outline is read from it")
        return self


class RecipeScale(Model):
    """How large a pixel is on the gel: exactly one of the two, and, if there is one, a length that proves it."""

    mm_per_px: Positive | None = None
    px_per_mm: Positive | None = None
    check_length_mm: Positive | None = None
    check_length_px: Quantity | None = Field(
        default=None, description="the length check_length_mm in pixels, in the labels or pictures"
    )

    @model_validator(mode="after")
    def _one_scale(self) -> "RecipeScale":
        if (self.mm_per_px is None) == (self.px_per_mm is None):
            raise ValueError("give mm_per_px or px_per_mm, one of the two")
        if (self.check_length_mm is None) != (self.check_length_px is None):
            raise ValueError("check_length_mm and check_length_px go together: give both or leave both out")
        return self

    @property
    def side_mm(self) -> float:
        """Side of a pixel, mm."""
        return self.mm_per_px if self.mm_per_px is not None else 1.0 / (self.px_per_mm or 1.0)


LengthUnit = Literal["mm", "cm", "m", "um"]
_Size = Literal["diameter_mm", "depth_mm", "position_mm"]


class RecipeIndenter(Model):
    """What was pressed in; sizes are numbers, or columns of the table (of this or, without one, of the contact's)."""

    file: Pattern | None = None
    press: str | None = None
    shape: Literal["ball", "cylinder", "cuboid", "mesh"]
    diameter_mm: Quantity | None = Field(
        default=None, description="diameter of a ball or cylinder; width of other shapes"
    )
    depth_mm: OfPress | None = Field(
        default=None, description="from first touch; a number, a column, or a number for each press: { name = 0.5 }"
    )
    depth_uncertainty_mm: Positive | None = Field(default=None, description="standard uncertainty of the depth")
    position_mm: PlaceOfPress | None = Field(default=None, description="place along the pad, from its base")
    position_uncertainty_mm: Positive | None = Field(default=None, description="standard uncertainty of the position")
    columns_in: LengthUnit | dict[_Size, LengthUnit] = Field(
        default="mm",
        description="unit of the columns and arrays that hold diameter, depth and position; if their units differ, "
        'the unit of each: { depth_mm = "m" }',
    )
    extruded_mm: Positive | None = Field(
        default=None,
        description="height of the solid that is extruded from the hull of the contact's outline and written as STL "
        "beside each capture, as the indenter of a design; its origin is the middle of the picture",
    )

    @model_validator(mode="after")
    def _uncertainties_have_a_value(self) -> "RecipeIndenter":
        for name in ("depth", "position"):
            if getattr(self, f"{name}_uncertainty_mm") is not None and getattr(self, f"{name}_mm") is None:
                raise ValueError(f"{name}_uncertainty_mm needs {name}_mm; give it too, or leave the uncertainty out")
        columns = [name for name in _SIZES if isinstance(getattr(self, name), str)]
        if self.columns_in != "mm" and not columns:
            raise ValueError("columns_in is a unit of columns, but [indenter] names none; leave columns_in out")
        for name in self.columns_in if isinstance(self.columns_in, dict) else ():
            if name not in columns:
                raise ValueError(
                    f"columns_in gives a unit for {name}, but [indenter] names no column for it; remove that unit "
                    f"(columns here: {', '.join(columns)}). A number in place of a column is in mm"
                )
        if self.extruded_mm is not None and self.shape != "mesh":
            raise ValueError(f'extruded_mm belongs to shape = "mesh", not to a {self.shape}; leave it out')
        return self

    def column_unit_mm(self, name: str) -> float:
        """Millimetres in a unit of the column of "diameter_mm", "depth_mm" or "position_mm"."""
        given = self.columns_in
        units = dict.fromkeys(_SIZES, given) if isinstance(given, str) else given
        return next((_COLUMN_UNITS_MM[unit] for size, unit in units.items() if size == name), 1.0)


_SIZES: Final[tuple[_Size, ...]] = ("diameter_mm", "depth_mm", "position_mm")
_COLUMN_UNITS_MM: Final = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3}


class RecipeForce(Model):
    """Where the force is: of videos one number for each frame, in a CSV or npy file that holds {press}."""

    file: Pattern = Field(description="path within the folder; for pictures, a table, or an npz or JSON file for each")
    press: str | None = Field(default=None, description="column of the table that names the press; for pictures")
    column: str | None = Field(default=None, description="column or array that holds the force; leave out for npy")
    factor: float = Field(default=1.0, description="newtons per unit of the file")


def composed(text: str) -> str:
    """Return a text with each letter in one part, as people type it."""
    return normalize("NFC", text)


def _composed_words(value: object) -> Any:
    """Return what a recipe says with the letters of its names in one part, as those of the files."""
    if isinstance(value, str):
        return composed(value)
    if isinstance(value, dict):
        return {composed(key): _composed_words(inner) for key, inner in value.items()}
    return [_composed_words(inner) for inner in value] if isinstance(value, list) else value


class Recipe(Model):
    """How a folder of presses is read."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    what: str = Field(description="what the data set is, where it comes from and what it holds")
    licence: str | None = None
    presses: RecipePresses
    picture: RecipePicture = RecipePicture()
    no_contact: RecipeNoContact
    contact: RecipeContact | None = None
    scale: RecipeScale | None = None
    indenter: RecipeIndenter
    force: RecipeForce | None = None
    lacks: tuple[MissingPart, ...] = Field(default=(), description="what else the data set lacks")

    @model_validator(mode="before")
    @classmethod
    def _names_are_composed(cls, given: object) -> Any:
        return _composed_words(given)

    @model_validator(mode="after")
    def _solid_has_an_outline_in_mm(self) -> "Recipe":
        has_outline = self.contact is not None and self.contact.circle is None and self.contact.search != "circle"
        if self.indenter.extruded_mm is not None and not (has_outline and self.scale is not None):
            raise ValueError(
                "indenter.extruded_mm needs an outline of the contact in mm: give [contact] outline, outline_px or "
                'search = "outline", and [scale]'
            )
        return self


def recipe_names() -> tuple[str, ...]:
    """Return the names of the recipes that come with the program."""
    return tuple(sorted(path.stem for path in RECIPES.glob("*.toml")))


def read_recipe(name_or_file: str) -> tuple[Recipe, Path]:
    """Return a recipe and its file, by the name of one that comes with the program, or from a TOML file.

    Raises
    ------
    ImportFormatError
        There is none of that name, or the file says something that a recipe has not, with what is allowed.
    """
    path = RECIPES / f"{name_or_file}.toml" if name_or_file in recipe_names() else Path(name_or_file)
    if not path.is_file():
        raise ImportFormatError(
            f"{name_or_file}: there is neither a recipe of this name nor such a file; give one of the recipes "
            f"{', '.join(recipe_names())}, or write a TOML file (docs/how-to/import-captures.md shows one)"
        )
    tables = read_toml_tables(path, "a recipe (TOML)", ImportFormatError)
    try:
        return Recipe.model_validate(tables), path
    except ValidationError as error:
        raise ImportFormatError(f"{path}: {explain(error, Recipe)}") from None


def with_sizes(recipe: Recipe, ball_diameter_mm: float | None, mm_per_px: float | None) -> Recipe:
    """Return the recipe with the ball's diameter and the scale that the user gives.

    Raises
    ------
    ImportFormatError
        One of them is not above zero or too large to be meant.
    """
    if ball_diameter_mm is not None:
        require_length(ball_diameter_mm, "the ball's diameter", "--ball-diameter-mm")
        recipe = recipe.model_copy(
            update={"indenter": recipe.indenter.model_copy(update={"diameter_mm": float(ball_diameter_mm)})}
        )
    if mm_per_px is not None:
        require_length(mm_per_px, "millimetres per pixel", "--mm-per-px", LARGEST_PIXEL_MM)
        check = {} if recipe.scale is None else recipe.scale.model_dump(include={"check_length_mm", "check_length_px"})
        recipe = recipe.model_copy(update={"scale": RecipeScale(mm_per_px=mm_per_px, **check)})
    return recipe


_MEMBER = re.compile(r"^(?P<name>.+?)(?:\[(?P<index>\d+)\])?$")
PICKLED = (".pkl", ".pickle")


class LeftOutError(Exception):
    """Why a press cannot be read; the others can."""


def pickle_words(path: Path) -> str:
    """Return why a pickled file is not opened, and the lines that convert it outside of the program."""
    return (
        "is pickled, and opening it could run code of an unknown author, so it is never opened; if you trust "
        "its owner, convert it in a Python of your own: import numpy, pathlib, pickle; values = "
        f"pickle.loads(pathlib.Path('{path.name}').read_bytes()); numpy.save('{path.stem}.npy', "
        "numpy.array(values, dtype=float)), and name the .npy file in the recipe"
    )


@dataclass(frozen=True, slots=True)
class LabelTable:
    """Hold the lines of a CSV table by the path that names a press, and by its last part.

    Folders before it may be those of another machine, so that the last part is enough, where one line only has it.
    """

    columns: list[str]
    by_path: dict[str, list[dict[str, str]]]
    by_last: dict[str, list[dict[str, str]]]

    def row(self, name: str, file: Path, last_parts: Mapping[str, bool]) -> dict[str, str] | None:
        """Return the line that names a press or its file in the folder, by last parts only where it alone has them.

        Raises
        ------
        LeftOutError
            Several lines that differ do.
        """
        sole = [part for part, is_sole in last_parts.items() if is_sole]
        paths = (name, name + file.suffix, composed(file.as_posix()))
        for table, keys in ((self.by_path, paths), (self.by_last, sole), (self.by_last, last_parts)):
            rows = next((table[key] for key in keys if key in table), [])
            if len(rows) > 1:
                raise LeftOutError("several lines of the table name this press, with different values")
            if rows and keys is not last_parts:
                return dict.fromkeys(self.columns, "") | rows[0]
        return None


def last_parts_of(files: Mapping[str, Path]) -> dict[str, dict[str, bool]]:
    """Return press -> what a line may call it without the folders before, and whether that is said of it alone.

    That is its file, its name, and the stem of its file where the name is in it; of ``{press}/image.png`` all presses
    would be called "image.png".
    """
    called: dict[str, tuple[str, ...]] = {}
    for name, path in files.items():
        last, stem = PurePosixPath(name).name, composed(path.stem)
        called[name] = (composed(path.name), last, *((stem,) if last in stem else ()))
    presses = Counter(part for parts in called.values() for part in enumerate(parts))
    return {name: {part: presses[k, part] == 1 for k, part in enumerate(parts)} for name, parts in called.items()}


def read_label_table(path: Path, press: str) -> LabelTable:
    """Read a table whose column `press` names the press, its file or its folder."""
    columns, rows = read_csv(path, "a CSV file", ImportFormatError, skip_space=True)
    if press not in columns:
        raise ImportFormatError(f"{path}: has no column '{press}' that names the press; it has {', '.join(columns)}")
    table = LabelTable(columns, {}, {})
    for _, cells in rows:
        row = dict(zip(columns, cells, strict=False))
        named = PurePosixPath(composed(row.get(press, "").strip().replace("\\", "/")))
        # what follows the last dot of "press_1.5" is not a kind of file
        last = {named.name, named.stem} if not named.suffix[1:].isdigit() else {named.name}
        keyed = [(table.by_path, named.as_posix()), *((table.by_last, key) for key in last)]
        for found, key in keyed:
            lines = found.setdefault(key, [])
            if row not in lines:
                lines.append(row)
    return table


def label_column(path: Path, column: str | None) -> list[str]:
    """Return the cells of a column."""
    columns, rows = read_csv(path, "a CSV file of forces", ImportFormatError, skip_space=True)
    if column not in columns:
        raise ImportFormatError(f"{path}: has no column '{column}'; it has {', '.join(columns)}: correct force.column")
    at = columns.index(column)
    return [cells[at] if at < len(cells) else "" for _, cells in rows]


def label_array(arrays: Mapping[str, NDArray[Any]], pickled: tuple[str, ...], name: str, path: Path) -> NDArray[Any]:
    """Return an array of numbers."""
    if name in pickled:
        raise ImportFormatError(f"{path}: '{name}' {pickle_words(Path(name))}")
    if name not in arrays:
        raise ImportFormatError(f"{path}: array '{name}' is missing; it holds {', '.join(sorted(arrays)) or 'nothing'}")
    return arrays[name]


def label_entry(path: Path, value: str) -> float:
    """Return an array of one number, or one entry of it; what is no number in a JSON file leaves its press out."""
    member = _MEMBER.match(value)
    name, index = (member["name"], member["index"]) if member is not None else (value, None)
    at = 0 if index is None else int(index)
    if path.suffix.lower() == ".json":
        return _json_number(path, name, None if index is None else at)
    arrays, pickled = read_npz(path)
    array = label_array(arrays, pickled, name, path).ravel()
    if at >= array.size or (index is None and array.size != 1) or not np.isfinite(array[at]):
        raise ImportFormatError(f"{path}: '{value}' must be one finite number; '{name}' holds {array.size} numbers")
    return float(array[at])


def _json_number(path: Path, name: str, at: int | None) -> float:
    """Return a number of a JSON object by its key, of inner objects outer.inner, or the entry `at` of a list."""
    whole = read_json(path, "labels (JSON)", ImportFormatError, any_number=True)
    if not isinstance(whole, dict):
        raise ImportFormatError(f"{path}: must be one object {{ ... }} with the labels of its press")
    found: dict[str, Any] = {}
    for key, value in (inside := list(whole.items())):  # grows while it is read
        found[key] = value
        inside += [(f"{key}.{inner}", of) for inner, of in value.items()] if isinstance(value, dict) else []
    if name not in found:
        raise ImportFormatError(f"{path}: '{name}' is missing; it holds {', '.join(sorted(found)) or 'nothing'}")
    values = found[name] if found[name] and isinstance(found[name], list) else [found[name]]
    if (at is None and len(values) != 1) or (at or 0) >= len(values):
        raise ImportFormatError(f"{path}: '{name}' has entries 0 to {len(values) - 1}; name one, such as {name}[0]")
    number = values[at or 0]
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not np.isfinite(float(number)):
        raise LeftOutError(f"its '{name}' is not a finite number")
    return float(number)


MOST_FILES = 200_000
_FORMS: Final = ("NFC", "NFD")
_FILES_SHOWN: Final = 4
_LEAVE_OUT: Final = "presses.leave_out"


def named_presses(recipe: Recipe) -> dict[str, list[str]]:
    """Return key of the recipe -> presses that it names one by one."""
    found: dict[str, list[str]] = {_LEAVE_OUT: list(recipe.presses.leave_out)}
    for what in ("depth_mm", "position_mm"):
        if isinstance(of := getattr(recipe.indenter, what), dict):
            found[f"indenter.{what}"] = list(of)
    if recipe.contact is not None and recipe.contact.outline_px:
        found["contact.outline_px"] = list(recipe.contact.outline_px)
    return found


def press_files(folder: Path, recipe: Recipe) -> Iterator[tuple[str, Path]]:
    """Return name and file of every press, in the order of their names, numbers by value."""
    pattern = recipe.presses.files
    if pattern.count(PRESS) != 1:
        raise ImportFormatError(
            f"recipe '{recipe.name}': presses.files = \"{pattern}\" must contain {PRESS} exactly once: it stands for "
            f"the name of the press"
        )
    _require_inside(pattern)
    parts = re.split(r"(\{press\}|\*)", pattern)
    words = {PRESS: "(.+)", "*": "[^/]*"}
    wanted = re.compile("".join(words.get(part, re.escape(composed(part))) for part in parts))
    found: dict[str, Path] = {}
    for number, path in enumerate(files_below(folder)):
        if number > MOST_FILES:
            raise ImportFormatError(f"{folder}: holds more than {MOST_FILES} files; give a subfolder of it")
        match = wanted.fullmatch(composed(path.relative_to(folder).as_posix()))
        if path.name.startswith("._"):
            continue  # what macOS writes beside a file on other disks
        if match is not None and fnmatchcase(match[1], recipe.presses.only):
            if not path.resolve().is_relative_to(folder.resolve()):
                raise ImportFormatError(f"{path}: leads out of the folder; copy the file into it")
            if match[1] in found:
                raise ImportFormatError(
                    f"{found[match[1]]} and {path.relative_to(folder)} are both press '{match[1]}' by presses.files "
                    f"of the recipe '{recipe.name}' ({pattern}); move one away, or let {PRESS} cover what differs"
                )
            found[match[1]] = path
    if not found:
        raise ImportFormatError(
            f"{folder}: no file in it matches presses.files of the recipe '{recipe.name}' ({pattern}); give the folder "
            f"above, or correct presses.files (upper and lower case count){_seen(folder)}"
        )
    ordered = sorted(found, key=lambda name: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", name)])
    if len(ordered) > MOST_PRESSES:
        raise ImportFormatError(f"{folder}: holds {len(ordered)} presses; give a folder of at most {MOST_PRESSES}")
    for name in ordered:
        yield name, found[name]


def _seen(folder: Path) -> str:
    """Return some names of a folder's files."""
    names = [path.relative_to(folder).as_posix() for path in islice(files_below(folder), _FILES_SHOWN)]
    return f"; the folder holds, for example, {', '.join(sorted(names))}" if names else "; the folder holds no file"


def _require_inside(pattern: str) -> None:
    """Refuse a path that leaves the folder."""
    inner = PurePosixPath(pattern)
    if inner.is_absolute() or ".." in inner.parts or "\\" in pattern:
        raise ImportFormatError(f"recipe: {pattern!r} must be a path within the folder, with / between its parts")


def named_file(folder: Path, pattern: str, press: str) -> Path:
    """Return the path of a press; a link that leads out of the folder is refused."""
    _require_inside(pattern)
    inner = pattern.replace(PRESS, press).replace(GROUP, PurePosixPath(press).parent.as_posix())
    # macOS stores letters such as an umlaut in two parts, other systems in one
    path = next((found for form in _FORMS if has_file(found := folder / normalize(form, inner))), folder / inner)
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ImportFormatError(f"{path}: leads out of the folder; copy the file into it")
    return path


def refuse_misspelt(folder: Path, recipe: Recipe, files: Collection[str]) -> None:
    """Refuse a table by names that misses a press and names one that is not there: it is misspelt.

    Raises
    ------
    ImportFormatError
        There is one.
    """
    read = [name for name in files if name not in recipe.presses.leave_out]
    for where, names in named_presses(recipe).items():
        unknown = [name for name in names if name not in files and fnmatchcase(name, recipe.presses.only)]
        missing = [name for name in read if name not in names]
        if where != _LEAVE_OUT and unknown and missing:
            raise ImportFormatError(
                f"recipe '{recipe.name}': {where} names '{unknown[0]}', which is not a press of {folder}, but does "
                f"not name '{missing[0]}', which is one; correct the name, as {recipe.presses.files} gives it"
            )


#: A ball that is pressed in by d touches over a circle whose cap is d high in a rigid pad, and half as high in a thick
#: soft one; with a drawn circle and the play of a stage both agree to this factor.
_DEPTH_FACTOR = 5.0
_UNITS: Final = {1e-3: '"m"', 0.1: '"cm"', 1e3: '"um"'}
#: Without a circle: depths in mm that a gel can have.
_DEPTHS_MM: Final = (0.01, 30.0)


def require_possible_scale(recipe: Recipe) -> None:
    """Refuse a pixel of more than a millimetre: no sensor of this kind has one, and inverted scales do.

    Raises
    ------
    ImportFormatError
        The scale of the recipe says so.
    """
    scale = recipe.scale
    if scale is not None and scale.side_mm > LARGEST_PIXEL_MM:
        given, other = ("mm_per_px", "px_per_mm") if scale.mm_per_px is not None else ("px_per_mm", "mm_per_px")
        number = scale.mm_per_px if scale.mm_per_px is not None else scale.px_per_mm
        raise ImportFormatError(
            f"recipe '{recipe.name}', scale: with {given} = {number:g} a pixel is {scale.side_mm:.4g} mm wide, and at "
            f"most {LARGEST_PIXEL_MM:g} mm are allowed; perhaps it should be {other} = {number:g}"
        )


def require_possible_depths(recipe: Recipe, depths: Mapping[str, tuple[float, float | None]]) -> None:
    """Refuse depths that are in another unit than millimetres, by the circles of balls or by what a gel can be.

    Parameters
    ----------
    recipe
        Named in the message.
    depths
        Name of the press -> its depth and the height of its circle's cap where ball, scale and circle are known, mm.

    Raises
    ------
    ImportFormatError
        The median of the presses is too far off.
    """
    if not depths:
        return
    ratios = [depth / cap for depth, cap in depths.values() if cap is not None and cap > 0.0]
    middle_mm = float(np.median([depth for depth, _ in depths.values()]))
    if ratios:
        ratio = float(np.median(ratios))
        if 1.0 / _DEPTH_FACTOR <= ratio <= _DEPTH_FACTOR:
            return
        why = f"but ball diameter and contact circles give about {middle_mm / ratio:.3g} mm"
    elif _DEPTHS_MM[0] <= middle_mm <= _DEPTHS_MM[1]:
        return
    else:
        ratio = middle_mm / 1.0
        why = f"but {_DEPTHS_MM[0]:g} to {_DEPTHS_MM[1]:g} mm are allowed"
    unit = next((name for factor, name in _UNITS.items() if 1 / 3 < ratio / factor < 3), '"m", "cm" or "um"')
    others = [n for n in _SIZES if n != "depth_mm" and isinstance(getattr(recipe.indenter, n), str)]
    if others:  # their columns may be in mm all the same
        unit = f"{{ depth_mm = {unit} }}"
    raise ImportFormatError(
        f"recipe '{recipe.name}', indenter.depth_mm: the median depth of {len(depths)} presses is {middle_mm:.3g} mm, "
        f"{why}. If the column is in another unit, write columns_in = {unit} below [indenter]; else correct the "
        "depths, the scale or the ball's diameter"
    )


def require_circles_on_contacts(recipe: Recipe, changes: Mapping[str, Mapping[str, float]], shape: Shape) -> None:
    """Refuse circles whose presses change more at the circles of pictures that are arranged otherwise.

    Raises
    ------
    ImportFormatError
        The majority of the presses that can tell says so.
    """
    vote = vote_on_circles(tuple(changes.values()))
    if vote is None:
        return
    said = vote.exchanged
    remedy = "exchange column_px and row_px"
    if said != ROW_AND_COLUMN:
        rows, columns = shape
        # corners that the recipe has belong to the picture as it is stored, those of whole pictures to this one
        corners = recipe.picture.corners_px or ((0, 0), (columns - 1, 0), (0, rows - 1), (columns - 1, rows - 1))
        exchanged = ("left" in said) + 2 * ("top" in said)
        turned = [[*corners[k ^ exchanged]] for k in range(4)]
        remedy = (
            f"correct the labels, or turn the pictures to suit them: corners_px = {turned} and "
            f"size_px = [{columns}, {rows}] below [picture]"
        )
    raise ImportFormatError(
        f"recipe '{recipe.name}', contact.circle: {vote.against} of {vote.presses} presses change more (median: "
        f"{vote.median_ratio:.2g} times as much) where their circles would be with {said} exchanged; {vote.right} "
        f"change more where their circles are now: {remedy}"
    )


def above_zero(what: str, value_mm: float | None) -> None:
    """Leave out a press of which a table says a length that none has.

    Raises
    ------
    LeftOutError
        It is not above 0.
    """
    if value_mm is not None and not value_mm > 0.0:
        raise LeftOutError(f"its {what} is {value_mm:g} mm in the table; it must be above 0")
