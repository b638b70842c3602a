"""Folders of presses read by a recipe: every press becomes a tactile capture that says what its source lacks.

Nothing pickled is ever opened. A press whose label or image is missing or cannot be is left out, and told; a folder in
which that is so of all presses is refused.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CompareError,
    ContactCircle,
    ImportFormatError,
    MissingPart,
    PlaceInImage,
    TactileCapture,
)
from data_schemas.storage import finite_number, folder_at, has_file, read_npy
from finray_calib.exchange._ball_presses import SourcedCircle
from finray_calib.exchange._capture_recipe import (
    PLACEHOLDER,
    PRESS,
    Recipe,
    RecipeContact,
    RecipeDepthMap,
    RecipeFrames,
    cap_mm,
    contradicts_depth,
    require_circles_on_contacts,
    require_possible_depths,
    require_possible_scale,
)
from finray_calib.exchange._press_files import (
    LeftOutError,
    PressFile,
    is_named,
    named_file,
    named_presses,
    press_files,
    refuse_misspelt,
)
from finray_calib.exchange._press_labels import PICKLED, PressLabels, label_column, pickle_words, pushing
from finray_calib.exchange._render_files import LEAST_DEPTH_SHARE
from finray_calib.exchange._set_files import (
    CONVERT_VIDEO,
    VIDEOS,
    ArrayFiles,
    Video,
    begins_early,
    exr_rgb,
    file_of,
    frame_of,
    in_colour,
    largest_within,
    longest_hold,
    pixels_of,
    read_video,
    require_alike,
    small_frame,
    steps_of,
    stretched,
)
from finray_calib.sensing import (
    changes_elsewhere,
    contact_of_depths,
    find_contact_circle,
    find_contact_outline,
    misplaced_circle,
    with_far_surface,
)

Counts = NDArray[np.uint16]
Floats = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

_REASONS_SHOWN: Final = 5
#: Logarithm of the ratio of sides up to which a box is one around a circle: 1.3, as drawn boxes differ.
_MOST_OBLONG: Final = 0.27
#: Share of a box that may lie beyond the picture: contacts at its border do.
_MOST_BEYOND: Final = 0.25
_ENDS_OR_SIZES: Final = "; check the order of the four numbers, and whether the last two are edges or sizes"
#: Lines of a table within the time of a video: fewer are in another unit of time.
_LEAST_FORCES: Final = 3
#: Gel beside a contact rises, or stays; a map whose untouched values are not 0 exceeds any small depth everywhere.
_MOST_IN_CONTACT: Final = 0.98
#: Presses that the median stands on, spread over the set: of more it hardly changes, and they fill the memory.
MOST_IN_MEDIAN = 51
#: A scale that its own check length contradicts by more than this is not the scale.
SCALE_TOLERANCE_REL = 0.1
_MEDIAN_LOSES = "the median of the presses is used instead and still contains weak contacts, which hide small errors"
_DOUBTFUL = "the circle found contradicts the ball and the depth; look at the circle, and correct it by --circles"
_SURFACE_LOSES = "a smooth surface through far pixels is used instead; texture of the gel counts as contact"


@dataclass(frozen=True, slots=True)
class RecipeCaptures:
    """What a folder gave.

    Attributes
    ----------
    captures
        Name of the press -> its capture, read from the folder again each time it is asked for: a large set does not
        fit into memory.
    left_out
        Why presses were left out -> their names.
    """

    captures: Mapping[str, TactileCapture]
    left_out: dict[str, list[str]]


Take = Callable[[str, TactileCapture, tuple[Path, ...]], None]


def read_by_recipe(
    folder: Path,
    recipe: Recipe,
    circles: Mapping[str, SourcedCircle] | None = None,
    progress: Progress | None = None,
    take: Take | None = None,
) -> RecipeCaptures:
    """Read all presses of a folder, one after the other.

    Parameters
    ----------
    folder
        Of the set, or a zip archive of it.
    recipe
        How it is read.
    circles
        Name of a press -> circle that stands in the place of what the recipe says.
    progress
        Called with number, count and name before each press.
    take
        Called with name, capture and the files that it was made of, before the next one is read.

    Raises
    ------
    ImportFormatError
        There is no such folder or no press in it, a file, column or array is not what the recipe says, or the check
        length contradicts the scale.
    """
    inside = folder_at(folder, ImportFormatError)
    if inside is None:
        raise ImportFormatError(
            f"{folder}: no such folder or zip archive; give the folder that the recipe '{recipe.name}' describes"
        )
    reader = _Folder(inside, recipe, dict(circles or {}))
    read: list[str] = []
    excluded = [name for name in recipe.presses.leave_out if name in reader.files]
    left_out = {"the recipe excludes it": excluded} if excluded else {}
    for where, names_of in named_presses(recipe).items():
        if absent := [name for name in names_of if not any(is_named(press, name) for press in reader.files)]:
            left_out[f"{where} of the recipe names it, but the folder has no such press"] = absent
    names = [name for name in reader.files if name not in recipe.presses.leave_out]
    for number, name in enumerate(names):
        if progress is not None:
            progress(number, len(names), name)
        try:
            capture = reader.capture(name)
        except (LeftOutError, CompareError) as why:
            left_out.setdefault(str(why), []).append(name)
            continue
        read.append(name)
        reader.note_numbers(name, capture)
        if take is not None:
            take(name, capture, reader.made_of)
    if not read:
        raise ImportFormatError(
            f"{folder}: none of the {len(reader.files)} presses can be read by the recipe '{recipe.name}'. Reasons: "
            f"{'; '.join(islice(left_out, _REASONS_SHOWN))}"
        )
    reader.check_numbers(read)
    return RecipeCaptures(_ReadAgain(reader, read), left_out)


class _ReadAgain(Mapping[str, TactileCapture]):
    """Captures by name, each read when it is asked for."""

    def __init__(self, reader: "_Folder", names: Sequence[str]) -> None:
        self._reader, self._names = reader, dict.fromkeys(names)

    def __getitem__(self, name: str) -> TactileCapture:
        if name not in self._names:
            raise KeyError(name)
        return self._reader.capture(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass
class _Folder:
    """Read presses of one folder; pictures that several need are read once."""

    folder: Path
    recipe: Recipe
    circles: dict[str, SourcedCircle]
    files: dict[str, PressFile] = field(init=False)
    _labels: PressLabels = field(init=False)
    _arrays: ArrayFiles = field(init=False, default_factory=ArrayFiles)
    _found: dict[str, dict[str, Any]] = field(init=False, default_factory=dict)
    _made_of: set[Path] = field(init=False, default_factory=set)
    _pictures: dict[Path, NDArray[Any]] = field(init=False, default_factory=dict)
    _median: Counts | None = field(init=False, default=None)
    _median_of: set[Path] = field(init=False, default_factory=set)
    _depths: dict[str, tuple[float, float | None]] = field(init=False, default_factory=dict)
    _elsewhere: dict[str, dict[str, float]] = field(init=False, default_factory=dict)
    _shape: tuple[int, int] = field(init=False, default=(0, 0))

    def __post_init__(self) -> None:
        require_possible_scale(self.recipe)
        self.files = dict(press_files(self.folder, self.recipe, self._arrays.count))
        self._labels = PressLabels(self.folder, self.recipe, self.files, self._arrays, self._made_of)
        for name in self.circles:
            if name not in self.files:
                raise ImportFormatError(
                    f"--circles: {name} is not a press of {self.folder}; correct the row of its circle"
                )
        refuse_misspelt(self.folder, self.recipe, self.files)

    @property
    def made_of(self) -> tuple[Path, ...]:
        """Files that the last capture was made of."""
        return tuple(sorted(self._made_of))

    def capture(self, name: str) -> TactileCapture:
        """Return the capture of a press."""
        self._made_of.clear()
        path = self.files[name].path
        if path.suffix.lower() in VIDEOS:
            images, force_n = self._video(name)
        else:
            if self.recipe.no_contact.frames_before is not None:
                raise ImportFormatError(
                    f"recipe '{self.recipe.name}': no_contact.frames_before is supported only for videos "
                    f"({', '.join(VIDEOS)}), but {path.name} is not a video; {CONVERT_VIDEO}; or give no_contact.file"
                )
            force_n = self._picture_force(name)
            self._pictures.clear()
            images = [self._picture(path), *self._without_contact(name)]
            require_alike(self._pictures)
            if self.recipe.no_contact.file is not None and np.array_equal(images[0], images[1]):
                raise LeftOutError("its image with contact equals the image without contact in every pixel")
            if self.recipe.no_contact.repeat_file is not None and np.array_equal(images[0], images[-1]):
                raise ImportFormatError(
                    f"recipe '{self.recipe.name}': no_contact.repeat_file of {name} equals the image with contact in "
                    "every pixel; name a second image without contact, or leave repeat_file out"
                )
        if any(image.shape != images[0].shape for image in images):
            sizes = ", ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
            raise ImportFormatError(
                f"{path}: the images with and without contact have different sizes ({sizes} px); all must come from "
                "one camera at one size"
            )
        capture = self._placed(name, self._unplaced(name, images, force_n))
        if self.recipe.no_contact.far_pixels:
            capture = with_far_surface(capture)
        return capture.model_copy(update={"missing": self._missing(capture)})

    def _unplaced(self, name: str, images: list[Counts], force_n: float | None) -> TactileCapture:
        """Return the capture of contact, no contact and repeat; where the contact is, is not known yet."""
        recipe = self.recipe
        return TactileCapture(
            name=name,
            contact=images[0],
            no_contact=images[1] if len(images) > 1 else images[0],
            repeat_no_contact=images[2] if len(images) > 2 else None,
            layout="RGB",
            encoding=recipe.picture.encoding,
            bit_depth=self._bits(name),
            black_level_dn=0.0,
            exposure_s=None,
            light_angle_deg=None,
            indenter=self._labels.pose(name),
            contact_circle=None,
            mm_per_px=None if recipe.scale is None else recipe.scale.side_mm,
            source=recipe.what,
            no_contact_from="median of presses" if recipe.no_contact.median_of_presses else "image",
            force_n=force_n,
            licence=recipe.licence,
        )

    def note_numbers(self, name: str, capture: TactileCapture) -> None:
        """Keep the depth, which is checked over all presses."""
        if capture.indenter.depth_mm is not None:
            self._depths[name] = (capture.indenter.depth_mm, cap_mm(capture))

    def check_numbers(self, names: Sequence[str]) -> None:
        """Refuse numbers that contradict each other over all presses: scale, depths, places of circles."""
        self._check_scale(names)
        require_possible_depths(self.recipe, self._depths)
        require_circles_on_contacts(self.recipe, self._elsewhere, self._shape)

    def _check_scale(self, names: Sequence[str]) -> None:
        """Refuse a scale that the check length contradicts."""
        scale, contact = self.recipe.scale, self.recipe.contact
        if scale is None or scale.check_length_px is None or scale.check_length_mm is None or contact is None:
            return
        lengths_px = []
        for name in names:
            try:
                lengths_px.append(self._labels.number(name, contact, scale.check_length_px))
            except LeftOutError:
                continue
        if not lengths_px:
            return
        shown_px = float(np.median(lengths_px))
        if not shown_px > 0.0:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', scale: check_length_px must be above 0, got {shown_px:g} px in labels"
            )
        ratio = shown_px * scale.side_mm / scale.check_length_mm
        if abs(ratio - 1.0) > SCALE_TOLERANCE_REL:
            right = scale.check_length_mm / shown_px
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', scale: {scale.check_length_mm:g} mm are {shown_px:.4g} px in the "
                f"labels, so a pixel is {right:.4g} mm wide, but the scale gives {scale.side_mm:.4g} mm; check whether "
                "mm per px and px per mm are exchanged"
            )

    def _is_deep(self, name: str) -> bool:
        """Return whether the values of a press go beyond 8 bits."""
        path = self.files[name].path
        if path.suffix.lower() in VIDEOS:
            return False
        return path.suffix.lower() == ".exr" or self._pictures[path].dtype == np.uint16

    def _bits(self, name: str) -> Literal[8, 10, 12, 14, 16]:
        """Return the bits of a press's counts."""
        bits, path = self.recipe.picture.bit_depth, self.files[name].path
        if bits is None:
            return 16 if self._is_deep(name) else 8
        if path.suffix.lower() == ".exr" or not self._is_deep(name):
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': picture.bit_depth = {bits} is supported only for 16-bit pictures, but "
                f"{path.name} is not a 16-bit picture; leave bit_depth out"
            )
        largest, file = max((int(picture.max()), file) for file, picture in self._pictures.items())
        if largest >= 2**bits:
            raise ImportFormatError(
                f"{file}: its largest value is {largest}, but picture.bit_depth = {bits} allows at most {2**bits - 1}; "
                f"divide left-aligned values by {2 ** (16 - bits)}, or correct bit_depth"
            )
        return bits

    def _picture(self, path: Path) -> Counts:
        """Return a picture as counts (H, W, 3) in RGB order, stretched where the recipe says so."""
        self._made_of.add(file_of(path))
        full = self.recipe.picture.full_scale
        is_array = file_of(path).suffix.lower() in (".npy", ".npz")
        if is_array and "channels" not in self.recipe.picture.model_fields_set:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': {path.name} does not state the order of its channels; write "
                'channels = "RGB" or "BGR" (as OpenCV reads pictures) below [picture]'
            )
        stored = exr_rgb(path) if path.suffix.lower() == ".exr" else pixels_of(path, self._arrays)
        of_light = stored.dtype.kind == "f"
        if of_light and full is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': picture.full_scale is missing; give the value of {path.name} that "
                "becomes the largest count, 65535"
            )
        if not of_light and full is not None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': picture.full_scale is supported only for OpenEXR images and arrays of "
                f"fractions, but {path.name} contains whole numbers; leave full_scale out"
            )
        self._pictures[path] = stored if full is None else steps_of(stored, path, full)
        return self._arranged(in_colour(self._pictures[path]))

    def _arranged(self, image: NDArray[Any]) -> Counts:
        """Return an image (H, W, 3) in the order and at the corners that the recipe gives."""
        picture = self.recipe.picture
        if picture.channels == "BGR":
            image = image[..., ::-1]
        return np.ascontiguousarray(stretched(image, picture.corners_px, picture.size_px)).astype(np.uint16)

    def _without_contact(self, name: str) -> list[Counts]:
        """Return the images without contact, two where there is a repeat; none where it comes from far pixels."""
        source = self.recipe.no_contact
        if source.median_of_presses:
            if self._median is None:
                left_out = set(self.recipe.presses.leave_out)
                files = [press.path for name, press in self.files.items() if name not in left_out]
                step = -(-len(files) // MOST_IN_MEDIAN)
                pictures = [self._picture(path) for path in files[::step]]
                if len({picture.shape for picture in pictures}) > 1 or len(pictures) < 3:
                    raise ImportFormatError(
                        f"{self.folder}: a median needs at least 3 presses of one size, but the {len(pictures)} "
                        "pictures are too few or differ in size; take images without contact"
                    )
                self._median = np.rint(np.median(pictures, axis=0)).astype(np.uint16)
                self._median_of = {file_of(path) for path in files[::step]}
            self._made_of |= self._median_of
            return [self._median]
        found = []
        for pattern, needed in ((source.file, True), (source.repeat_file, False)):
            if pattern is None:
                continue
            path = named_file(self.folder, pattern, self.files[name])
            if has_file(file_of(path)):
                found.append(self._picture(path))
            elif needed:
                raise LeftOutError(f"the image without contact, {pattern}, is missing")
        if len(found) == 2 and np.array_equal(found[0], found[1]):
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no_contact.repeat_file and no_contact.file of {name} are equal in every "
                "pixel, so the camera would seem to have no noise; name a second image, or leave repeat_file out"
            )
        return found

    def _video(self, name: str) -> tuple[list[Counts], float | None]:
        """Return contact, no contact and its repeat of a video, and the force at the contact image."""
        before = self.recipe.no_contact.frames_before
        if before is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no_contact.frames_before is missing; give the number of frames without "
                "contact at the start of each video"
            )
        path = self.files[name].path
        self._made_of.add(path)
        video = read_video(path)
        frames = video.frames
        if len(frames) <= before:
            raise LeftOutError(f"its video has {len(frames)} frames, but needs more than the {before} without contact")
        first = small_frame(frame_of(frames[0], path))
        force = self._force(name, video)
        if force is None:
            strength = np.array([np.abs(small_frame(frame_of(frame, path)) - first).mean() for frame in frames])
        else:  # many load cells count compression as negative, or rest beside zero
            force -= np.median(force[:before])
            strength = np.abs(force)
        if not strength.max() > 0.0:
            raise LeftOutError("nothing changes in its video")
        self._pictures.clear()
        held = longest_hold(strength)
        if held < before or begins_early(strength, before, 0 if force is None else 1):
            raise LeftOutError(
                f"its video shows contact within the first {before} frames, which should be without contact"
            )
        images = [frame_of(frames[i], path) for i in (held, 0, before - 1)]
        self._pictures[path] = images[0]
        force_n = self._picture_force(name) if force is None else pushing(float(force[held]))
        return [self._arranged(image) for image in images], force_n

    def _force(self, name: str, video: Video) -> Floats | None:
        """Return the force of each frame, N; None where there is no file of frames."""
        source = self.recipe.force
        if source is None or source.file is None or source.is_of_press:
            return None
        path = named_file(self.folder, source.file, self.files[name])
        if path.suffix.lower() in PICKLED:
            raise ImportFormatError(f"{path}: {pickle_words(path)}")
        if not has_file(path):
            return None
        self._made_of.add(path)
        frames = len(video.frames)
        try:
            if source.frames is not None:
                return self._force_by_time(name, video, path, source.frames) * source.newtons
            values = (
                np.array([finite_number(cell) for cell in label_column(path, source.column)])
                if path.suffix.lower() == ".csv"
                else read_npy(path, "forces (npy)", ImportFormatError).astype(np.float64).ravel()
            )
        except ValueError as error:
            raise ImportFormatError(f"{path}: every force must be a finite number; {error}") from None
        if len(values) != frames or not np.isfinite(values).all():
            raise ImportFormatError(
                f"{path}: has {len(values)} forces for {frames} frames, but must contain a finite number for each; "
                "below [force], match by time with frames = { time = COLUMN }, or name presses by press = COLUMN"
            )
        return np.asarray(values * source.newtons)

    def _force_by_time(self, name: str, video: Video, path: Path, source: RecipeFrames) -> Floats:
        """Return the force at the time of each frame, between those of a table, in its unit."""
        column = None if self.recipe.force is None else self.recipe.force.column
        times, values = (
            np.array([finite_number(cell) for cell in label_column(path, of)]) for of in (source.time, column)
        )
        taken_s = video.times_s if source.per_s is None else np.arange(len(video.frames)) / source.per_s
        if taken_s is None:
            raise ImportFormatError(
                f"{self.files[name].path}: contains no frame times; give per_s (frames per second) below [force.frames]"
            )
        if not times.size or not (np.diff(times) > 0.0).all():
            raise ImportFormatError(f"{path}: times in {source.time} must increase; sort them, one row for each time")
        first = times[0] if source.first is None else source.first
        since_s = (times - first) * source.unit_s
        apart_s = float(np.median(np.diff(since_s))) if since_s.size > 1 else 0.0  # recordings end within a sample
        outside = taken_s[0] < since_s[0] - apart_s or taken_s[-1] > since_s[-1] + apart_s
        if outside or ((since_s >= taken_s[0]) & (since_s <= taken_s[-1])).sum() < _LEAST_FORCES:
            raise ImportFormatError(
                f"{path}: its {len(since_s)} forces cover {since_s[0]:.4g} to {since_s[-1]:.4g} s after the first "
                f"frame, but the frames 0 to {taken_s[-1]:.4g} s; correct unit, first and per_s below [force.frames]"
            )
        return np.asarray(np.interp(taken_s, since_s, values))

    def _picture_force(self, name: str) -> float | None:
        """Return the force of a press that has one, N."""
        source = self.recipe.force
        if source is None or (self.files[name].path.suffix.lower() in VIDEOS and not source.is_of_press):
            return None
        if source.column is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': force.column is missing; name the column, array or key of the force"
            )
        return pushing(self._labels.number(name, source, source.column) * source.newtons)

    def _placed(self, name: str, capture: TactileCapture) -> TactileCapture:
        """Return the capture with its contact."""
        contact = self.recipe.contact
        circle = self.circles.get(name)
        if circle is not None:
            return self._with_circle(capture, circle.circle, circle.source)
        if name in self._found:  # a search takes long, and finds the same again
            return capture.model_copy(update=self._found[name])
        if contact is None:
            return capture
        if contact.circle is not None:
            column, row, radius = (
                self._labels.number(name, contact, value)
                for value in (contact.circle.column_px, contact.circle.row_px, contact.circle.radius_px)
            )
            if radius <= 0.0:
                raise LeftOutError(f"its circle has a radius of {radius:g} px, but the radius must be above 0")
            return self._with_circle(capture, ContactCircle(row_px=row, column_px=column, radius_px=radius), "label")
        if contact.box is not None:
            return self._boxed(name, capture, contact)
        if contact.search is not None:
            placed = self._searched(capture, contact.search)
            fields = ("contact_circle", "contact_outline", "contact_told_by")
            self._found[name] = {name_of: getattr(placed, name_of) for name_of in fields}
            return placed
        if contact.depth_map is not None:
            return self._by_map(name, capture, contact.depth_map)
        places = contact.outline_px.get(name) if contact.outline_px else self._labels.hull(name, contact)
        if places is None:
            raise LeftOutError("the recipe gives no outline for this press")
        corners = tuple(PlaceInImage(column_px=float(c), row_px=float(r)) for c, r in places)
        return capture.model_copy(update={"contact_outline": corners, "contact_told_by": "label"})

    def _boxed(self, name: str, capture: TactileCapture, contact: RecipeContact) -> TactileCapture:
        """Return the capture with the circle in a box, or the box where it is no ball that was pressed in."""
        sides = {side: value for side, value in contact.box or () if value is not None}
        left, top, right, bottom = (self._labels.number(name, contact, value) for value in sides.values())
        if "width_px" in sides:
            right, bottom = left + right, top + bottom
        width_px, height_px = right - left, bottom - top
        if not (width_px > 0.0 and height_px > 0.0):
            raise LeftOutError(f"its box has no width or no height{_ENDS_OR_SIZES}")
        rows, columns = capture.contact.shape[:2]
        beyond = max(-left / width_px, (right - columns) / width_px, -top / height_px, (bottom - rows) / height_px)
        if beyond > _MOST_BEYOND:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', contact.box: the box of {name}, column {left:g}, row {top:g} to column "
                f"{right:g}, row {bottom:g}, reaches too far out of the {columns} x {rows} px picture{_ENDS_OR_SIZES}"
            )
        if capture.indenter.shape == "ball":
            if abs(np.log(width_px / height_px)) > _MOST_OBLONG:
                raise LeftOutError(f"its box is too oblong for the circle of a ball{_ENDS_OR_SIZES}")
            circle = ContactCircle(
                row_px=(top + bottom) / 2.0, column_px=(left + right) / 2.0, radius_px=(width_px + height_px) / 4.0
            )
            return self._with_circle(capture, circle, "label")
        corners = tuple(PlaceInImage(column_px=c, row_px=r) for r in (top, bottom) for c in (left, right))
        ordered = (corners[0], corners[1], corners[3], corners[2])
        return capture.model_copy(update={"contact_outline": ordered, "contact_told_by": "label"})

    def _searched(self, capture: TactileCapture, what: Literal["circle", "outline"]) -> TactileCapture:
        """Return the capture with the contact that a search finds."""
        if what == "circle":
            return self._with_circle(capture, find_contact_circle(capture, _ball_px(capture)).circle, "search")
        corners = find_contact_outline(capture)
        return capture.model_copy(update={"contact_outline": corners, "contact_told_by": "search"})

    def _with_circle(self, capture: TactileCapture, circle: ContactCircle, by: str) -> TactileCapture:
        """Return the capture with a circle that can be."""
        rows, columns = capture.contact.shape[:2]
        inside = 0.0 <= circle.row_px < rows and 0.0 <= circle.column_px < columns
        if not inside or max(circle.row_px, circle.column_px) < 1.0:  # the latter in mm or m, as it seems
            raise LeftOutError(
                f"its circle's centre, row {circle.row_px:g}, column {circle.column_px:g}, lies outside the picture of "
                f"{columns} x {rows} px or in pixel 0, 0; check the unit (px), and whether row and column are exchanged"
            )
        ball_px = _ball_px(capture)
        if ball_px is not None and circle.radius_px > ball_px:
            raise LeftOutError(
                f"a contact circle of {circle.radius_px:g} px radius is larger than the ball's {ball_px:.4g} px; check "
                "that the scale is mm per px, not px per mm, and that the ball's size is its diameter"
            )
        return capture.model_copy(update={"contact_circle": circle, "contact_told_by": by})

    def _by_map(self, name: str, capture: TactileCapture, source: RecipeDepthMap) -> TactileCapture:
        """Return the capture with the contact and the greatest depth of a map."""
        path = self.files[name].path
        stored = self._pictures[path].shape if path in self._pictures else capture.contact.shape
        measured, picture = self._labels.depths_mm(name, source, stored), self.recipe.picture
        deepest = largest_within(measured, picture.corners_px)
        depths = stretched(measured, picture.corners_px, picture.size_px)
        if not deepest > 0.0:
            raise LeftOutError(
                f"its depth map is nowhere above 0 ({depths.min():.3g} to {deepest:.3g} mm); if the values fall as the "
                "gel is pressed in, value_mm must be below 0"
            )
        least = source.least_depth_mm or LEAST_DEPTH_SHARE * deepest
        share = float((depths > least).mean())
        if share > _MOST_IN_CONTACT:
            raise LeftOutError(
                f"its depth map exceeds {least:.3g} mm in {100 * share:.3g} % of the picture, which is too much for a "
                "contact. If the map holds heights, name the map without contact as rest_file; if the whole picture is "
                "pressed in, give least_depth_mm"
            )
        circle, corners = contact_of_depths(depths, least) if share > 0.0 else (None, ())
        if len(corners) < 3:
            raise LeftOutError(
                f"its depth map exceeds {least:.3g} mm in fewer than 3 pixels (maximum {deepest:.3g} mm)"
            )
        pose = capture.indenter
        if pose.depth_mm is None:
            known_mm = self.recipe.indenter.depth_uncertainty_mm
            pose = pose.model_copy(update={"depth_mm": deepest, "depth_uncertainty_mm": known_mm})
        told = capture.model_copy(update={"indenter": pose})
        if circle is not None and pose.shape == "ball":
            return self._with_circle(told, circle, "label")
        return told.model_copy(update={"contact_outline": corners, "contact_told_by": "label"})

    def _missing(self, capture: TactileCapture) -> tuple[MissingPart, ...]:
        """Return what the capture lacks, and what is lost by it."""
        source = self.recipe.no_contact
        words, own = (set(PLACEHOLDER.findall(text)) for text in (self.recipe.presses.files, source.file or ""))
        common = source.file is not None and PRESS not in source.file and not words <= own
        searched = capture.contact_told_by == "search"
        lacks = (
            (capture.repeat_no_contact is None, "a second image without contact", "how much of an error is noise"),
            (common, "an image without contact of each press", "drift and wear of the gel cannot be separated"),
            (source.median_of_presses, "an image without contact", _MEDIAN_LOSES),
            (source.far_pixels, "an image without contact", _SURFACE_LOSES),
            (searched, "a drawn contact", "found by a search: its size is known to 20 %"),
            (searched and contradicts_depth(capture), "a circle that suits its depth", _DOUBTFUL),
            (capture.contact_told_by is None, "where the contact is", "the simulated side must give the region"),
            (capture.indenter.radius_mm is None, "the indenter's size", "slopes and depth have no scale"),
            (capture.mm_per_px is None, "the scale, mm per px", "depth has no scale"),
            (capture.indenter.depth_mm is None, "the depth of the press", "simulate to the contact's size instead"),
            (capture.force_n is None, "the force", "stiffness of the gel cannot be checked"),
            (capture.encoding == "unknown", "exposure and tone curve", "values are not proportional to light"),
        )
        told = [MissingPart(what=what, lost=lost) for is_missing, what, lost in lacks if is_missing]
        if capture.contact_told_by == "label" and capture.name not in self._elsewhere:
            self._elsewhere[capture.name], self._shape = changes_elsewhere(capture), capture.contact.shape[:2]
        return (*told, *self.recipe.lacks, *misplaced_circle(capture.name, self._elsewhere.get(capture.name, {})))


def _ball_px(capture: TactileCapture) -> float | None:
    """Return the radius of the ball in pixels where both are known."""
    pose = capture.indenter
    if pose.shape != "ball" or pose.radius_mm is None or capture.mm_per_px is None:
        return None
    return pose.radius_mm / capture.mm_per_px
