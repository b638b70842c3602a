"""Recipes: how another lab's folder of presses is read, as a short TOML file.

A recipe says which files are the presses, where the image without contact is, which parts of a name, columns or arrays
hold the contact, the scale with its unit, and what was pressed. Those of public sets come with the program; a file of
your own is read by the same rules.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from data_schemas import ImportFormatError, MissingPart, Model, TactileCapture, explain
from data_schemas.storage import read_toml_tables
from finray_calib.exchange._ball_presses import LARGEST_PIXEL_MM, require_length
from finray_calib.sensing import ROW_AND_COLUMN, vote_on_circles

Floats = NDArray[np.float64]

RECIPES: Final = Path(__file__).parent / "recipes"
PRESS: Final = "{press}"
GROUP: Final = "{group}"
#: Stands for a part of a file's name; what it stood for may be a number, or part of another file's name.
PLACEHOLDER: Final = re.compile(r"\{([a-z_][a-z0-9_]*)\}")

Pattern = Annotated[str, Field(min_length=1, max_length=300)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
AboveZero = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Quantity = Annotated[str, Field(min_length=1, max_length=100)] | Positive
"""A number, or what holds it: a part of the press's name (``{depth}``), the column of a table, the key of a JSON file,
or the array of an npz file; ``center[0]`` and ``centers[{press}, 0]`` are entries of one."""
Finite = Annotated[str, Field(min_length=1, max_length=100)] | Annotated[float, Field(allow_inf_nan=False)]
"""The same of a pose, which may be 0 or below."""
OfPress = dict[str, Positive] | Quantity
"""A quantity, or a number for each press by its name, in which * may stand for any part."""
Place = Annotated[float, Field(ge=0.0, le=1e6)]
PlaceOfPress = dict[str, Place] | Annotated[str, Field(min_length=1, max_length=100)] | Place
"""The same of a place on the pad, which may be 0."""
LengthUnit = Literal["mm", "cm", "m", "um"]
Corner = tuple[float, float]
Direction = tuple[float, float, float]
Shape = tuple[int, int]


class RecipePresses(Model):
    """Which files are the presses."""

    files: Pattern = Field(
        description="path within the folder; {press} stands for the name of the press, {depth} or any other word for a "
        "part that other keys use, * for any part of a file's name; set.npz::images[{press}] is an array of pictures"
    )
    only: Pattern = Field(default="*", description="which of these presses are read: their names, * for any part")
    leave_out: tuple[str, ...] = Field(default=(), description="names of presses that are not to be read")


class RecipePicture(Model):
    """How the values of a picture are read."""

    channels: Literal["RGB", "BGR"] = Field(default="RGB", description="BGR: red and blue are exchanged in the files")
    encoding: Literal["linear", "unknown"] = "unknown"
    full_scale: Positive | None = Field(
        default=None,
        description="value of an OpenEXR image, or of fractions in an array, that becomes 65535, the largest",
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
            raise ValueError("only one of corners_px and size_px is given; give both or neither")
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
            raise ValueError("repeat_file is given without file; give file too, or leave repeat_file out")
        return self


class RecipeNearest(Model):
    """By which time a line of a table belongs to a press."""

    column: str = Field(description="column of the table that holds the time")
    to: Annotated[str, Field(pattern=f"^{PLACEHOLDER.pattern}$")] = Field(
        description="time of the press in its name, such as {stamp}"
    )
    within: AboveZero = Field(description="how far both may be apart, in units of the column")
    factor: AboveZero = Field(default=1.0, description="units of the column in one unit of the name's time")


class RecipeLabels(Model):
    """Where the numbers of a table, of another one, or of an npz or JSON file are."""

    file: Pattern | None = Field(
        default=None,
        description="table (CSV, a JSON list, JSON lines) with one line for each press, or an npz or JSON file; its "
        "path may have {press}",
    )
    press: str | None = Field(
        default=None, description="column of the table that names the press: its file, or its folder"
    )
    nearest: RecipeNearest | None = Field(default=None, description="in place of press: the line of the nearest time")


class RecipeDepthMap(Model):
    """A map of depths or heights for each press, in the pixels of its picture."""

    file: Pattern = Field(description="path within the folder: PNG, TIFF, OpenEXR, npy, or FILE.npz::ARRAY")
    value_mm: Annotated[float, Field(ge=-1e6, le=1e6)] = Field(
        description="millimetres in 1 of the file's values; below 0 where values fall as the gel is pressed in"
    )
    rest_file: Pattern | None = Field(
        default=None, description="the map without contact, which is subtracted; without it, untouched gel is at 0"
    )
    least_depth_mm: Positive | None = Field(
        default=None, description="the contact is where the map is deeper; by default 1 % of its largest depth"
    )

    @model_validator(mode="after")
    def _values_have_a_size(self) -> "RecipeDepthMap":
        if self.value_mm == 0.0:
            raise ValueError("value_mm must not be 0; give how many mm a value of 1 in the file stands for")
        return self


class RecipeCircle(Model):
    """Columns of the contact circle."""

    column_px: Quantity
    row_px: Quantity
    radius_px: Quantity


class RecipeBox(Model):
    """Sides of a box around the contact, each by its name, as files differ in their order."""

    left_px: Finite
    top_px: Finite
    right_px: Finite | None = None
    bottom_px: Finite | None = None
    width_px: Finite | None = None
    height_px: Finite | None = None

    @model_validator(mode="after")
    def _has_one_size(self) -> "RecipeBox":
        ends, sizes = (self.right_px, self.bottom_px), (self.width_px, self.height_px)
        if sorted((sum(part is not None for part in ends), sum(part is not None for part in sizes))) != [0, 2]:
            raise ValueError("give either right_px and bottom_px, or width_px and height_px")
        return self


class RecipeContact(RecipeLabels):
    """Where the contact is: exactly one of circle, box, outline, outline_px, depth_map and search."""

    circle: RecipeCircle | None = None
    box: RecipeBox | None = Field(default=None, description="around the circle of a ball, else the contact itself")
    outline: tuple[str, ...] = Field(
        default=(), description="arrays of the npz file that hold corners (column, row); the contact is their hull"
    )
    outline_px: dict[str, Annotated[tuple[Corner, ...], Field(min_length=3)]] = Field(
        default={}, description="name of the press -> corners (column, row)"
    )
    depth_map: RecipeDepthMap | None = None
    search: Literal["circle", "outline"] | None = Field(
        default=None, description="find it in the picture: the circle of a ball, or the region that changes most"
    )

    @model_validator(mode="after")
    def _one_source(self) -> "RecipeContact":
        given = (self.circle, self.box, self.outline, self.outline_px, self.depth_map, self.search)
        if sum(bool(source) for source in given) != 1:
            raise ValueError("give exactly one of circle, box, outline, outline_px, depth_map and search")
        parts = self.circle or self.box
        named = parts is not None and all(
            value is None or isinstance(value, float) or PLACEHOLDER.fullmatch(value) for _, value in parts
        )
        if (parts is not None or self.outline) and self.file is None and not named:
            raise ValueError("file is missing; name the file from which the circle, box or outline is read")
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
            raise ValueError("give exactly one of mm_per_px and px_per_mm")
        if (self.check_length_mm is None) != (self.check_length_px is None):
            raise ValueError("only one of check_length_mm and check_length_px is given; give both or neither")
        return self

    @property
    def side_mm(self) -> float:
        """Side of a pixel, mm."""
        return self.mm_per_px if self.mm_per_px is not None else 1.0 / (self.px_per_mm or 1.0)


_Size = Literal["diameter_mm", "radius_mm", "depth_mm", "position_mm"]
_Shape = Literal["ball", "cylinder", "cuboid", "mesh"]


class RecipeQuaternion(Model):
    """Columns of the four parts of a rotation, each by its name: no order is taken for granted."""

    w: Finite = Field(description="the real part, the cosine of half the angle")
    x: Finite
    y: Finite
    z: Finite


class RecipePose(RecipeLabels):
    """Where the indenter was: its depth, its place along the pad and its tilt follow from it."""

    x: Finite | None = None
    y: Finite | None = None
    z: Finite | None = None
    quaternion: RecipeQuaternion | None = None
    matrix: Annotated[tuple[Finite, ...], Field(min_length=16, max_length=16)] | str | None = Field(
        default=None,
        description="in place of x, y, z and quaternion: 16 columns row by row, the place in the fourth of each row; "
        "or an array of 4 x 4",
    )
    unit: LengthUnit = Field(description="unit of the place")
    normal: Direction = Field(default=(0.0, 0.0, 1.0), description="direction out of the gel, in the pose's axes")
    axis: Direction = Field(default=(0.0, 0.0, 1.0), description="the indenter's axis, in its own axes")
    first_touch_mm: float | None = Field(
        default=None, description="place along the normal at first touch; the depth is counted from it"
    )
    along: Direction | None = Field(default=None, description="direction along the pad from its base")
    base_mm: float = Field(default=0.0, description="place of the pad's base along it")

    @model_validator(mode="after")
    def _is_whole(self) -> "RecipePose":
        placed = sum(part is not None for part in (self.x, self.y, self.z))
        if (self.matrix is None) != (placed == 3) or (self.matrix is not None and self.quaternion is not None):
            raise ValueError("give either x, y and z (with quaternion if there is one), or matrix alone")
        if not all(any(way) for way in (self.normal, self.axis, self.along or self.normal)):
            raise ValueError("normal, axis and along must not be [0, 0, 0]; give a direction")
        return self


class RecipeIndenter(RecipeLabels):
    """What was pressed in; sizes are numbers, or columns of the table (of this or, without one, of the contact's)."""

    shape: _Shape | dict[str, _Shape] = Field(
        description='one for all, or for each press by its name: { "ball*" = "ball", "edge*" = "cuboid" }'
    )
    diameter_mm: OfPress | None = Field(
        default=None, description="diameter of a ball or cylinder; width of other shapes"
    )
    radius_mm: OfPress | None = Field(default=None, description="half of it, in its place")
    depth_mm: OfPress | None = Field(
        default=None, description="from first touch; a number, a column, or a number for each press: { name = 0.5 }"
    )
    depth_uncertainty_mm: Positive | None = Field(default=None, description="standard uncertainty of the depth")
    position_mm: PlaceOfPress | None = Field(default=None, description="place along the pad, from its base")
    position_uncertainty_mm: Positive | None = Field(default=None, description="standard uncertainty of the position")
    columns_in: LengthUnit | dict[_Size, LengthUnit] = Field(
        default="mm",
        description="unit of the parts of names, columns and arrays that hold diameter, depth and position; if their "
        'units differ, the unit of each: { depth_mm = "m" }',
    )
    pose: RecipePose | None = Field(default=None, description="gives depth, position and tilt where they are not given")
    extruded_mm: Positive | None = Field(
        default=None,
        description="height of the solid that is extruded from the hull of the contact's outline and written as STL "
        "beside each capture, as the indenter of a design; its origin is the middle of the picture",
    )

    @model_validator(mode="after")
    def _uncertainties_have_a_value(self) -> "RecipeIndenter":
        if self.diameter_mm is not None and self.radius_mm is not None:
            raise ValueError("diameter_mm and radius_mm are both given; leave one of them out")
        for name in ("depth", "position"):
            known = getattr(self, f"{name}_mm") is not None or self.pose is not None
            if getattr(self, f"{name}_uncertainty_mm") is not None and not known:
                raise ValueError(
                    f"{name}_uncertainty_mm is given without {name}_mm; give {name}_mm too, or leave the uncertainty "
                    "out"
                )
        columns = [name for name in SIZES if isinstance(getattr(self, name), str)]
        if self.columns_in != "mm" and not columns:
            raise ValueError(
                "columns_in gives the unit of columns, but [indenter] names no columns; leave columns_in out"
            )
        for name in self.columns_in if isinstance(self.columns_in, dict) else ():
            if name not in columns:
                raise ValueError(
                    f"columns_in gives a unit for {name}, but [indenter] names columns only for {', '.join(columns)}; "
                    f"remove the unit of {name} (a number is always in mm)"
                )
        shapes = set(self.shape.values()) if isinstance(self.shape, dict) else {self.shape}
        if self.extruded_mm is not None and shapes != {"mesh"}:
            others = " or ".join(sorted(shapes - {"mesh"}))
            raise ValueError(
                f'extruded_mm is supported only for shape = "mesh", not for a {others}; leave extruded_mm out'
            )
        return self

    def column_unit_mm(self, name: str) -> float:
        """Millimetres in a unit of the column of "diameter_mm", "radius_mm", "depth_mm" or "position_mm"."""
        given = self.columns_in
        units = dict.fromkeys(SIZES, given) if isinstance(given, str) else given
        return next((COLUMN_UNITS_MM[unit] for size, unit in units.items() if size == name), 1.0)


SIZES: Final[tuple[_Size, ...]] = ("diameter_mm", "radius_mm", "depth_mm", "position_mm")
COLUMN_UNITS_MM: Final = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3}


class RecipeFrames(Model):
    """When the frames of a video were taken, by the clock of a table of forces, which begins with the first."""

    time: str = Field(description="column of the table that holds the time")
    unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="unit of the column")
    first: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        default=None, description="time of the first frame in the column, where that is not the first line"
    )
    per_s: AboveZero | None = Field(default=None, description="frames in a second, in place of the times in the video")

    @property
    def unit_s(self) -> float:
        """Seconds in a unit of the column."""
        return {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[self.unit]


class RecipeForce(RecipeLabels):
    """Where the force is: of videos also one number for each frame, or with its time, in a CSV or npy file."""

    column: str | None = Field(
        default=None, description="column or array that holds the force, or {force} of a name; leave out for npy"
    )
    unit: Literal["N", "mN", "g", "kg"] = Field(default="N", description="unit of the column; g and kg weigh as much")
    factor: float = Field(default=1.0, description="in place of unit: newtons per unit of the file")
    frames: RecipeFrames | None = Field(default=None, description="matches lines of a table to frames by their times")

    @model_validator(mode="after")
    def _has_a_source(self) -> "RecipeForce":
        if self.file is None and PLACEHOLDER.fullmatch(self.column or "") is None:
            raise ValueError(
                'file is missing; give file, or the part of the name that is the force, such as column = "{force}"'
            )
        if self.unit != "N" and self.factor != 1.0:
            raise ValueError("unit and factor are both given; leave one of them out")
        return self

    @property
    def is_of_press(self) -> bool:
        """Whether a press has one force, by its name or by its line of a table, also where it is a video."""
        return self.file is None or self.press is not None or self.nearest is not None

    @property
    def newtons(self) -> float:
        """Newtons per unit of the file."""
        return self.factor * _FORCE_UNITS_N[self.unit]


_FORCE_UNITS_N: Final = {"N": 1.0, "mN": 1e-3, "g": 9.80665e-3, "kg": 9.80665}


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
    def _names_hold_what_is_used(self) -> "Recipe":
        known = {PRESS[1:-1], GROUP[1:-1], *PLACEHOLDER.findall(self.presses.files)}
        parts = (self.no_contact, self.contact, self.scale, self.indenter, self.force)
        used = {word for text in texts_of([part.model_dump() for part in parts if part is not None])
                for word in PLACEHOLDER.findall(text)}  # fmt: skip
        if unknown := sorted(used - known):
            raise ValueError(
                f"the recipe uses {{{unknown[0]}}}, but presses.files gives only "
                f"{', '.join(f'{{{word}}}' for word in sorted(known - {GROUP[1:-1]}))}; correct the recipe"
            )
        return self

    @model_validator(mode="after")
    def _solid_has_an_outline_in_mm(self) -> "Recipe":
        has_outline = self.contact is not None and self.contact.circle is None and self.contact.search != "circle"
        if self.indenter.extruded_mm is not None and not (has_outline and self.scale is not None):
            raise ValueError(
                "indenter.extruded_mm needs the outline of the contact in mm, but the recipe gives no outline or no "
                'scale; give [contact] with outline, outline_px or search = "outline", and give [scale]'
            )
        return self


def texts_of(value: object) -> Iterator[str]:
    """Yield all texts of nested tables."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list | tuple):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from texts_of(inner)


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
            f"{name_or_file}: is neither the name of a recipe nor an existing file; give one of the recipes "
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
            update={
                "indenter": recipe.indenter.model_copy(
                    update={"diameter_mm": float(ball_diameter_mm), "radius_mm": None}
                )
            }
        )
    if mm_per_px is not None:
        require_length(mm_per_px, "millimetres per pixel", "--mm-per-px", LARGEST_PIXEL_MM)
        check = {} if recipe.scale is None else recipe.scale.model_dump(include={"check_length_mm", "check_length_px"})
        recipe = recipe.model_copy(update={"scale": RecipeScale(mm_per_px=mm_per_px, **check)})
    return recipe


#: A ball that is pressed in by d touches over a circle whose cap is d high in a rigid pad, and half as high in a thick
#: soft one; with a drawn circle and the play of a stage both agree to this factor.
_DEPTH_FACTOR = 5.0
#: The same of one press, for a radius that is off by 30 %.
_DOUBTFUL_DEPTHS: Final = (1.0 / 1.7, 2.0 * 1.7)
_UNITS: Final = {1e-3: '"m"', 0.1: '"cm"', 1e3: '"um"'}
#: Without a circle: depths in mm that a gel can have.
_DEPTHS_MM: Final = (0.01, 30.0)


def cap_mm(capture: TactileCapture) -> float | None:
    """Return the height of a ball's cap over its contact circle, mm; None where ball, circle or scale is not known."""
    pose, circle = capture.indenter, capture.contact_circle
    if pose.shape != "ball" or not pose.radius_mm or circle is None or capture.mm_per_px is None:
        return None
    touching_mm = min(circle.radius_px * capture.mm_per_px, pose.radius_mm)
    return pose.radius_mm - float(np.sqrt(pose.radius_mm**2 - touching_mm**2))


def contradicts_depth(capture: TactileCapture) -> bool:
    """Return whether a circle is one that a ball at its depth leaves neither in a rigid pad nor in a soft one."""
    height_mm, depth_mm = cap_mm(capture), capture.indenter.depth_mm
    if not height_mm or depth_mm is None:
        return False
    return not _DOUBTFUL_DEPTHS[0] <= depth_mm / height_mm <= _DOUBTFUL_DEPTHS[1]


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
            f"recipe '{recipe.name}', scale: with {given} = {number:g} a pixel is {scale.side_mm:.4g} mm wide, but it "
            f"must be at most {LARGEST_PIXEL_MM:g} mm wide; perhaps {other} = {number:g} was meant"
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
    others = [n for n in SIZES if n != "depth_mm" and isinstance(getattr(recipe.indenter, n), str)]
    if others:  # their columns may be in mm all the same
        unit = f"{{ depth_mm = {unit} }}"
    told, remedy = "indenter.depth_mm", f"If the column is in another unit, write columns_in = {unit} below [indenter]"
    if recipe.indenter.depth_mm is None:
        by_map = recipe.contact is not None and recipe.contact.depth_map is not None
        told = "contact.depth_map" if by_map else "indenter.pose"
        remedy = "If its values are in another unit, correct " + ("value_mm" if by_map else "unit and first_touch_mm")
    raise ImportFormatError(
        f"recipe '{recipe.name}', {told}: the median depth of {len(depths)} presses is {middle_mm:.3g} mm, {why}. "
        f"{remedy}; otherwise correct the depths, the scale or the ball's diameter"
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
            f"correct the labels, or turn the pictures to suit them: corners_px = {turned} and size_px = [{columns}, "
            f"{rows}] below [picture]"
        )
    raise ImportFormatError(
        f"recipe '{recipe.name}', contact.circle: {said} seem to be exchanged. {vote.against} of {vote.presses} "
        f"presses change more (median: {vote.median_ratio:.2g} times as much) at the exchanged circle, and "
        f"{vote.right} change more at the circle as given; {remedy}"
    )
