"""Labels of presses: parts of their names, lines of a table, entries of npz and JSON files, as a recipe says.

What holds for one press is read here: numbers with their units, poses, outlines and maps of depths. A press whose label
is missing or cannot be is left out.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError, IndenterPose
from data_schemas.storage import finite_number, has_file, read_csv, read_json
from finray_calib.exchange._capture_recipe import (
    COLUMN_UNITS_MM,
    PLACEHOLDER,
    SIZES,
    OfPress,
    PlaceOfPress,
    Quantity,
    Recipe,
    RecipeContact,
    RecipeDepthMap,
    RecipeLabels,
    RecipeNearest,
    RecipePose,
    composed,
)
from finray_calib.exchange._press_files import LeftOutError, PressFile, is_named, named_file, number_in_name
from finray_calib.exchange._set_files import ARRAY_IN, TEXTS_OF_NUMBERS, ArrayFiles, file_of, map_of, table_rows

Floats = NDArray[np.float64]
Corners = NDArray[np.float32]

_MEMBER = re.compile(r"^(?P<name>.*?)(?:\[(?P<index>\d+(?:\s*,\s*\d+)*)\])?$")
_COMMA_NUMBER: Final = re.compile(r"^([+-]?\d+),(\d+)$")
PICKLED = (".pkl", ".pickle")


def pickle_words(path: Path) -> str:
    """Return why a pickled file is not opened, and the lines that convert it outside of the program."""
    return (
        "is a pickle file, which is never opened because it could run code of an unknown author. If you trust its "
        "author, convert it in your own Python: import numpy, pathlib, pickle; values = "
        f"pickle.loads(pathlib.Path('{path.name}').read_bytes()); numpy.save('{path.stem}.npy', numpy.array(values, "
        "dtype=float)), and name the .npy file in the recipe"
    )


Named = TypeVar("Named")


@dataclass(frozen=True, slots=True)
class LabelTable:
    """Hold the lines of a table by the path that names a press, and by its last part.

    Folders before it may be those of another machine, so that the last part is enough, where one line only has it.
    """

    columns: list[str]
    rows: list[dict[str, str]]
    by_path: dict[str, list[dict[str, str]]]
    by_last: dict[str, list[dict[str, str]]]
    by_end: dict[str, list[dict[str, str]]]
    _times: dict[str, Floats] = field(default_factory=dict)

    def row(self, name: str, file: Path, last_parts: Mapping[str, bool]) -> dict[str, str] | None:
        """Return the line that names a press or its file in the folder, by last parts only where it alone has them.

        Raises
        ------
        LeftOutError
            Several lines that differ do.
        """
        sole = [part for part, is_sole in last_parts.items() if is_sole]
        paths = (name, name + file.suffix, composed(file.as_posix()))
        ends = [part for part in sole if "/" in part]
        for table, keys in (
            (self.by_path, paths),
            (self.by_end, ends),
            (self.by_last, sole),
            (self.by_last, last_parts),
        ):
            rows = next((table[key] for key in keys if key in table), [])
            if len(rows) > 1:
                raise LeftOutError("several rows of the table name this press, with different values")
            if rows and keys is not last_parts:
                return dict.fromkeys(self.columns, "") | rows[0]
        return None

    def nearest(self, path: Path, to: RecipeNearest, value: float) -> dict[str, str]:
        """Return the line whose time is nearest to that of a press.

        Raises
        ------
        LeftOutError
            None is near enough.
        """
        if to.column not in self._times:
            try:
                self._times[to.column] = np.array([finite_number(row.get(to.column, "")) for row in self.rows])
            except ValueError as error:
                raise ImportFormatError(f"{path}: every {to.column} must be a number; {error}") from None
        apart = np.abs(self._times[to.column] - value * to.factor)
        if not apart.size or apart.min() > to.within:
            raise LeftOutError(f"no row of {path.name} lies within {to.within:g} of the time of the press")
        return dict.fromkeys(self.columns, "") | self.rows[int(np.argmin(apart))]


def last_parts_of(files: Mapping[str, Path]) -> dict[str, dict[str, bool]]:
    """Return press -> what a line may call it without the folders before, and whether that is said of it alone.

    That is its file, its name, and the stem of its file where the name is in it; of ``{press}/image.png`` all presses
    would be called "image.png", and are told apart by folders, the most of them first.
    """
    called: dict[str, tuple[str, ...]] = {}
    for name, path in files.items():
        last, stem = PurePosixPath(name).name, composed(path.stem)
        called[name] = (composed(path.name), last, *((stem,) if last in stem else ()))
    presses = Counter(part for parts in called.values() for part in enumerate(parts))
    ends = {name: _ends(PurePosixPath(composed(path.as_posix()))) for name, path in files.items()}
    presses_of_end = Counter(end for of_press in ends.values() for end in of_press)
    return {
        name: {part: presses[k, part] == 1 for k, part in enumerate(parts)}
        | {end: presses_of_end[end] == 1 for end in ends[name]}
        for name, parts in called.items()
    }


def _ends(path: PurePosixPath) -> list[str]:
    """Return a path without its first folders, the longest first, down to the file in its last folder."""
    parts = [part for part in path.parts if part != "/"]
    return ["/".join(parts[k:]) for k in range(len(parts) - 1)]


def read_label_table(path: Path, press: str, is_name: bool = True) -> LabelTable:
    """Read a table whose column `press` names the press, its file or its folder, or holds a time."""
    columns, rows = table_rows(path, [press] if is_name else [])
    if press not in columns:
        raise ImportFormatError(
            f"{path}: has no column '{press}' that {('names the press' if is_name else 'holds the time')}; its columns "
            f"are {', '.join(columns)}"
        )
    table = LabelTable(columns, rows, {}, {}, {})
    for row in rows if is_name else ():
        text = composed(row.get(press, "").strip().replace("\\", "/"))
        keyed = list[tuple[dict[str, list[dict[str, str]]], str]]()
        # spreadsheets of some countries turn a press 1.5 into 1,5
        for named in map(PurePosixPath, dict.fromkeys([text, _COMMA_NUMBER.sub(r"\1.\2", text)])):
            # what follows the last dot of "press_1.5" is not a kind of file
            last = {named.name, named.stem} if not named.suffix[1:].isdigit() else {named.name}
            keyed += [(table.by_path, named.as_posix()), *((table.by_last, key) for key in last)]
            keyed += [(table.by_end, end) for end in _ends(named)]
        for found, key in keyed:
            lines = found.setdefault(key, [])
            if row not in lines:
                lines.append(row)
    return table


def label_column(path: Path, column: str | None) -> list[str]:
    """Return the cells of a column."""
    columns, rows = read_csv(path, "a CSV file of forces", ImportFormatError, skip_space=True, other_marks=True)
    if column not in columns:
        raise ImportFormatError(
            f"{path}: has no column '{column}'; its columns are {', '.join(columns)}. Correct force.column"
        )
    at = columns.index(column)
    return [cells[at] if at < len(cells) else "" for _, cells in rows]


def label_entry(path: Path, value: str, files: ArrayFiles, of_matrix: bool = False) -> float:
    """Return an array of one number, or one entry of it; what is no number in a JSON file leaves its press out.

    Entry k is that of the only axis longer than 1; `of_matrix`, of 4 x 4 numbers row by row.
    """
    member = _MEMBER.match(value)
    name, index = (member["name"], member["index"]) if member is not None else (value, None)
    at = [] if index is None else [int(part) for part in index.split(",")]
    if path.suffix.lower() == ".json":
        return _json_number(path, name, at, of_matrix)
    array = files.array(path, name)
    long = tuple(size for size in array.shape if size > 1)
    if len(at) < 2 and (len(long) < 2 or (of_matrix and long == (4, 4))):
        array = array.ravel()
    if (
        len(at or [0]) != array.ndim
        or any(k >= size for k, size in zip(at or [0], array.shape, strict=True))
        or (index is None and array.size != 1)
        or not (of_matrix or np.isfinite(array[tuple(at or [0])]))
    ):
        raise ImportFormatError(
            f"{path}: '{value}' is not one finite number; '{name}' contains {array.size} numbers"
            + (
                f" of shape {array.shape}, of which one must be named by its index along each axis, from 0"
                if array.ndim > 1
                else ""
            )
        )
    if not np.isfinite(array[tuple(at or [0])]):  # of a matrix: the track was lost
        raise LeftOutError(f"its '{name}' is not finite")
    return float(array[tuple(at or [0])])


def _json_number(path: Path, name: str, at: Sequence[int], of_matrix: bool) -> float:
    """Return a number of a JSON object by its key, of inner objects outer.inner, or the entry `at` of a list."""
    whole = read_json(path, "labels (JSON)", ImportFormatError, any_number=True)
    if not isinstance(whole, dict):
        raise ImportFormatError(
            f"{path}: is not one object {{ ... }} with the labels of its press; if it is a list with an object for "
            "each press, give as press the key that names the press"
        )
    found: dict[str, Any] = {}
    for key, value in (inside := list(whole.items())):  # grows while it is read
        found[key] = value
        inside += [(f"{key}.{inner}", of) for inner, of in value.items()] if isinstance(value, dict) else []
    if name not in found:
        raise ImportFormatError(
            f"{path}: '{name}' is missing; the file contains {', '.join(sorted(found)[:40]) or 'nothing'}"
        )
    value = found[name]
    if value == []:
        raise LeftOutError(f"its '{name}' is not a finite number")
    if len(at) == 1 and isinstance(value, list) and all(isinstance(row, list) and row for row in value):
        if of_matrix or len(value) == 1 or all(len(row) == 1 for row in value):
            value = [entry for row in value for entry in row]  # row by row
        else:
            raise ImportFormatError(
                f"{path}: '{name}' is a list of lists, so an entry needs two indices, such as {name}[0, 0]"
            )
    for k in at or ([0] if isinstance(value, list) and value else []):
        entries = value if isinstance(value, list) else [value]
        if k >= len(entries) or (not at and len(entries) > 1):
            raise ImportFormatError(
                f"{path}: '{name}' has entries 0 to {len(entries) - 1}, but the recipe names none of these; name one, "
                f"such as {name}[0]"
            )
        value = entries[k]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(float(value)):
        raise LeftOutError(f"its '{name}' is not a finite number")
    return float(value)


def _of_name(name: str, table: Mapping[str, Named]) -> Named | None:
    """Return what a table by names says of a press: under its own name, else under the first that fits it."""
    return table.get(name, next((value for key, value in table.items() if is_named(name, key)), None))


@dataclass
class PressLabels:
    """Read what a recipe says of presses: numbers, poses, outlines and maps of depths.

    Attributes
    ----------
    folder, recipe
        Of the set.
    files
        Name of a press -> its file.
    arrays
        Reads files of arrays.
    made_of
        Gets the files that are read.
    """

    folder: Path
    recipe: Recipe
    files: Mapping[str, PressFile]
    arrays: ArrayFiles
    made_of: set[Path]
    _last_parts: dict[str, dict[str, bool]] = field(init=False)
    _tables: dict[tuple[Path, str], LabelTable] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        leave_out = self.recipe.presses.leave_out
        self._last_parts = last_parts_of({n: press.path for n, press in self.files.items() if n not in leave_out})

    def number(self, name: str, labels: RecipeLabels, value: Quantity, of_matrix: bool = False) -> float:
        """Return a number of a press: as it stands in the recipe, in its name, or in a table, npz or JSON file."""
        if isinstance(value, float):
            return value
        if (word := PLACEHOLDER.fullmatch(value)) is not None:
            text = self.files[name].words[word[1]]
            if (number := number_in_name(text)) is None:
                raise LeftOutError(f"its name has {value} = '{text}', which is not a number such as 0.75 or 0p75")
            return number
        if labels.file is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no file is named that contains '{value}'; add the key file to "
                "[contact], or to [indenter] for a number of the indenter"
            )
        path = named_file(self.folder, labels.file, self.files[name])
        kind = path.suffix.lower()
        if kind in PICKLED:
            raise ImportFormatError(f"{path}: {pickle_words(path)}")
        of_table = labels.press is not None or labels.nearest is not None
        of_numbers = not of_table and value.startswith("[") and kind in TEXTS_OF_NUMBERS
        if kind in (".npz", ".npy") or of_numbers or (kind == ".json" and not of_table):
            if not has_file(path):
                raise LeftOutError(f"the file {path.name}, which the recipe names, is missing")
            self.made_of.add(path)
            return label_entry(path, self.files[name].filled(value), self.arrays, of_matrix)
        return self._of_table(name, labels, path, self.files[name].filled(value), of_matrix)

    def _of_table(self, name: str, labels: RecipeLabels, path: Path, column: str, of_matrix: bool) -> float:
        """Return a number of the line of a press."""
        key = labels.nearest.column if labels.nearest is not None else labels.press
        if key is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': 'press' is missing next to file = \"{labels.file}\"; name "
                "the column that names the press of each row (in a file for each press, or one without a header, "
                'name entries in place of columns, such as "[0]" and "[{press}, 0]")'
            )
        if (path, key) not in self._tables:
            self._tables[path, key] = read_label_table(path, key, labels.nearest is None)
        table = self._tables[path, key]
        self.made_of.add(path)
        if labels.nearest is not None:
            row: dict[str, str] | None = table.nearest(
                path, labels.nearest, self.number(name, labels, labels.nearest.to)
            )
        else:
            row = table.row(name, file_of(self.files[name].path).relative_to(self.folder), self._last_parts[name])
        if row is None:
            array, count = ARRAY_IN in self.recipe.presses.files, f"{len(self.files)}"
            if array and name == "0" and table.row(count, Path(count), {}) is not None:
                raise ImportFormatError(
                    f"{path}: the rows in '{key}' are numbered from 1, but entries of arrays are numbered from 0; copy "
                    "the file and subtract 1 from each row number"
                )
            raise LeftOutError(f"no row of {path.name} names this press")
        if of_matrix and column not in row and (member := _MEMBER.match(column)) and member["index"]:
            k = int(member["index"])  # JSON holds rows of a matrix, or all of it
            column = f"{member['name']}[{k // 4}][{k % 4}]"
        if column not in row:
            raise ImportFormatError(
                f"{path}: has no column '{column}'; its columns are {', '.join(row)}. Correct the recipe "
                f"'{self.recipe.name}'"
            )
        try:
            return finite_number(row[column])
        except ValueError:
            raise ImportFormatError(
                f"{path}: {column} of {name} must be a number, got {row[column]!r}; write it with a decimal point, or "
                "name the press in presses.leave_out"
            ) from None

    def of_indenter(self, labels: RecipeLabels) -> RecipeLabels:
        """Return where numbers of the indenter are: what names no file has that of the indenter, or the contact's."""
        named = (labels, self.recipe.indenter, self.recipe.contact)
        return next((where for where in named if where is not None and where.file is not None), labels)

    def size(self, name: str, what: str) -> float | None:
        """Return diameter, radius, depth or position of the indenter, mm."""
        indenter = self.recipe.indenter
        value: PlaceOfPress | OfPress | None = getattr(indenter, what)
        if isinstance(value, dict):
            return _of_name(name, value)
        if value is None or isinstance(value, float):
            return value
        return self.number(name, self.of_indenter(indenter), value) * indenter.column_unit_mm(what)

    def pose(self, name: str) -> IndenterPose:
        """Return what was pressed in, how deep, where and how tilted."""
        indenter = self.recipe.indenter
        shape = indenter.shape
        if isinstance(shape, dict):
            named = _of_name(name, shape)
            if named is None:
                raise LeftOutError("indenter.shape of the recipe gives no shape for its name")
            shape = named
        diameter_mm, radius_mm, depth_mm, position_mm = (self.size(name, what) for what in SIZES)
        above_zero("diameter", diameter_mm)
        above_zero("radius", radius_mm)
        by_pose = (None, None, None) if indenter.pose is None else self._by_pose(name, indenter.pose)
        depth_mm = by_pose[0] if depth_mm is None else depth_mm
        position_mm = by_pose[1] if position_mm is None else position_mm
        above_zero("depth, from first touch,", depth_mm, _FALLS if indenter.depth_mm is not None else _IS_POSED)
        return IndenterPose(
            shape=shape,
            radius_mm=diameter_mm / 2.0 if diameter_mm is not None else radius_mm,
            depth_mm=depth_mm,
            position_mm=position_mm,
            tilt_deg=by_pose[2],
            depth_uncertainty_mm=None if depth_mm is None else indenter.depth_uncertainty_mm,
            position_uncertainty_mm=None if position_mm is None else indenter.position_uncertainty_mm,
        )

    def _by_pose(self, name: str, pose: RecipePose) -> tuple[float | None, float | None, float | None]:
        """Return depth and place along the pad in mm, and tilt in degrees, as far as a pose tells them."""
        labels = self.of_indenter(pose)

        def numbers(values: Iterable[Quantity | None], of_matrix: bool = False) -> Floats:
            return np.array([self.number(name, labels, value, of_matrix) for value in values if value is not None])

        rotation: Floats | None = None
        if pose.matrix is not None:
            entries = [f"{pose.matrix}[{k}]" for k in range(16)] if isinstance(pose.matrix, str) else pose.matrix
            if isinstance(pose.matrix, str) and pose.matrix.endswith("]"):  # an array of all presses
                entries = [f"{pose.matrix[:-1]}, {row}, {column}]" for row in range(4) for column in range(4)]
            whole = numbers(entries, isinstance(pose.matrix, str)).reshape(4, 4)
            rotation, place = whole[:3, :3], whole[:3, 3]
            _require_rigid(name, whole)
        else:
            place = numbers((pose.x, pose.y, pose.z))
            if pose.quaternion is not None:
                quaternion = pose.quaternion
                rotation = _rotation(name, *numbers((quaternion.w, quaternion.x, quaternion.y, quaternion.z)))
        place_mm = place * COLUMN_UNITS_MM[pose.unit]
        normal = np.array(pose.normal) / np.linalg.norm(pose.normal)
        tilt_deg = None
        if rotation is not None:
            axis = rotation @ (np.array(pose.axis) / np.linalg.norm(pose.axis))
            tilt_deg = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(axis, normal)), abs(axis @ normal))))
        along = None if pose.along is None else np.array(pose.along) / np.linalg.norm(pose.along)
        return (
            None if pose.first_touch_mm is None else float(pose.first_touch_mm - place_mm @ normal),
            None if along is None else float(place_mm @ along - pose.base_mm),
            tilt_deg,
        )

    def hull(self, name: str, contact: RecipeContact) -> Corners:
        """Return the hull of all corners that the label holds, (corners, 2): column, row."""
        path = named_file(self.folder, contact.file or "", self.files[name])
        if not has_file(path):
            raise LeftOutError(f"the file {path.name}, which the recipe names, is missing")
        self.made_of.add(path)
        corners = [self.arrays.array(path, part) for part in contact.outline]
        if any(part.ndim != 2 or part.shape[1] != 2 for part in corners):
            raise ImportFormatError(
                f"{path}: the corners must be an array of shape (n, 2), column and row; correct contact.outline"
            )
        points = np.concatenate(corners).astype(np.float32)
        if len(np.unique(points, axis=0)) < 3 or not np.isfinite(points).all():
            raise LeftOutError("its outline has fewer than 3 different corners, or corners that are not finite numbers")
        hull = np.asarray(cv2.convexHull(points)[:, 0], dtype=np.float32)
        if len(hull) < 3:
            raise LeftOutError("all corners of its outline lie on one line")
        return hull

    def depths_mm(self, name: str, source: RecipeDepthMap, shape: tuple[int, ...]) -> Floats:
        """Return how deep each pixel of the stored picture of this shape is pressed in, mm.

        Raises
        ------
        LeftOutError
            Its file is missing.
        ImportFormatError
            Its size is another, or some values are no numbers.
        """
        maps = []
        for pattern in (source.file, *([] if source.rest_file is None else [source.rest_file])):
            path = named_file(self.folder, pattern, self.files[name])
            if not has_file(file_of(path)):
                raise LeftOutError(f"the map {file_of(path).name}, which the recipe names, is missing")
            self.made_of.add(file_of(path))
            maps.append(map_of(path, self.arrays))
            if maps[-1].shape != shape[:2]:
                raise ImportFormatError(
                    f"{path}: has {maps[-1].shape[1]} x {maps[-1].shape[0]} px, but the picture of {name} has "
                    f"{shape[1]} x {shape[0]} px; scale the map to the size of its picture"
                )
        return (maps[0] - (maps[1] if len(maps) > 1 else 0.0)) * source.value_mm


#: Numbers of tables are often rounded to two digits.
_NORM_TOLERANCE: Final = 0.02


def _rotation(name: str, w: float, x: float, y: float, z: float) -> Floats:
    """Return the rotation (3, 3) of a quaternion of norm 1."""
    norm = float(np.sqrt(w * w + x * x + y * y + z * z))
    if norm == 0.0:
        raise LeftOutError("its quaternion is 0, 0, 0, 0, which is not a rotation")
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise ImportFormatError(
            f"the quaternion of {name} has a norm of {norm:.4g}, but the norm of a rotation is 1; check the columns of "
            "indenter.pose.quaternion"
        )
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _require_rigid(name: str, matrix: Floats) -> None:
    """Refuse a matrix that is no rotation and shift, or whose rows are columns."""
    turn = matrix[:3, :3]
    if not turn.any():
        raise LeftOutError("the rotation part of its matrix is all 0")
    odd = np.abs(turn @ turn.T - np.eye(3)).max() > 2 * _NORM_TOLERANCE or np.linalg.det(turn) < 0.0
    # nothing is rounded in the last row; in another order it holds the place, which may be some 1e-3 m
    if odd or np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise ImportFormatError(
            f"indenter.pose.matrix of {name} is not a rotation with a shift. The rotation must have three rows of norm "
            "1 at right angles, and the last row must be [0, 0, 0, 1]; check the order of the columns"
        )


_FALLS: Final = (
    "; if the column falls as the gel is pressed in, write z = COLUMN, x = 0, y = 0, unit and first_touch_mm = 0 below "
    "[indenter.pose] in place of depth_mm"
)
_IS_POSED: Final = "; check first_touch_mm, and that normal points out of the gel"


def above_zero(what: str, value_mm: float | None, remedy_below: str = "") -> None:
    """Leave out a press of which a table says a length that none has.

    Raises
    ------
    LeftOutError
        It is not above 0.
    """
    if value_mm is not None and not value_mm > 0.0:
        remedy = remedy_below if value_mm < 0.0 else ""
        told = "below 0" if remedy == _FALLS else f"{value_mm:g} mm"  # one sentence for all presses
        raise LeftOutError(f"its {what} is {told} in the table, but must be above 0{remedy}")


def pushing(force_n: float) -> float:
    """Return the force of a contact in N, or leave out a press whose force pulls by more than a cell's zero is off.

    Raises
    ------
    LeftOutError
        It does.
    """
    if force_n < -0.1:
        raise LeftOutError(
            f"its force is {force_n:g} N, which is a pull; if the file counts a push as negative, give a factor below 0"
        )
    return force_n
