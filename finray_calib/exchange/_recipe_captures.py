"""Folders of presses read by a recipe: every press becomes a tactile capture that says what its source lacks.

Nothing pickled is ever opened. A press whose label or image is missing or cannot be is left out, and told; a folder in
which that is so of all presses is refused.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CompareError,
    ContactCircle,
    ImportFormatError,
    IndenterPose,
    MissingPart,
    PlaceInImage,
    TactileCapture,
)
from data_schemas.storage import finite_number, folder_at, has_file, read_npy
from finray_calib.exchange._ball_presses import SourcedCircle, read_npz
from finray_calib.exchange._capture_recipe import (
    PICKLED,
    PRESS,
    LabelTable,
    LeftOutError,
    OfPress,
    PlaceOfPress,
    Quantity,
    Recipe,
    above_zero,
    label_array,
    label_column,
    label_entry,
    last_parts_of,
    named_file,
    named_presses,
    pickle_words,
    press_files,
    read_label_table,
    refuse_misspelt,
    require_circles_on_contacts,
    require_possible_depths,
    require_possible_scale,
)
from finray_calib.exchange._picture_files import (
    CONVERT_VIDEO,
    begins_early,
    exr_steps,
    frame_of,
    in_colour,
    longest_hold,
    motion_jpeg_frames,
    pixels_of,
    require_alike,
    small_frame,
)
from finray_calib.sensing import (
    changes_elsewhere,
    contact_distance,
    find_contact_circle,
    find_contact_outline,
    misplaced_circle,
)

Counts = NDArray[np.uint16]
Floats = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

VIDEO: Final = ".avi"
_REASONS_SHOWN: Final = 5
#: Presses that the median stands on, spread over the set: of more it hardly changes, and they fill the memory.
MOST_IN_MEDIAN = 51
#: A scale that its own check length contradicts by more than this is not the scale.
SCALE_TOLERANCE_REL = 0.1
#: Pixels this far from the contact, in half-widths, give the smooth surface that stands for no contact.
FAR_HALF_WIDTHS = 1.6
_SURFACE_DEGREE = 3
_MEDIAN_LOSES = "the median of the presses is used instead and still contains weak contacts: small errors are not seen"
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
        if absent := [name for name in names_of if name not in reader.files]:
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
            f"{folder}: none of its {len(reader.files)} presses can be read by the recipe '{recipe.name}': "
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
    files: dict[str, Path] = field(init=False)
    _last_parts: dict[str, dict[str, bool]] = field(init=False)
    _found: dict[str, dict[str, Any]] = field(init=False, default_factory=dict)
    _made_of: set[Path] = field(init=False, default_factory=set)
    _pictures: dict[Path, NDArray[Any]] = field(init=False, default_factory=dict)
    _median: Counts | None = field(init=False, default=None)
    _median_of: set[Path] = field(init=False, default_factory=set)
    _tables: dict[tuple[Path, str], "LabelTable"] = field(init=False, default_factory=dict)
    _depths: dict[str, tuple[float, float | None]] = field(init=False, default_factory=dict)
    _elsewhere: dict[str, dict[str, float]] = field(init=False, default_factory=dict)
    _shape: tuple[int, int] = field(init=False, default=(0, 0))

    def __post_init__(self) -> None:
        require_possible_scale(self.recipe)
        self.files = dict(press_files(self.folder, self.recipe))
        read = {name: path for name, path in self.files.items() if name not in self.recipe.presses.leave_out}
        self._last_parts = last_parts_of(read)
        for name in self.circles:
            if name not in self.files:
                raise ImportFormatError(f"--circles: {name} is not a press of {self.folder}; correct the line")
        refuse_misspelt(self.folder, self.recipe, self.files)

    @property
    def made_of(self) -> tuple[Path, ...]:
        """Files that the last capture was made of."""
        return tuple(sorted(self._made_of))

    def capture(self, name: str) -> TactileCapture:
        """Return the capture of a press."""
        self._made_of.clear()
        force_n = None
        if self.files[name].suffix.lower() == VIDEO:
            images, force_n = self._video(name)
        else:
            if self.recipe.no_contact.frames_before is not None:
                raise ImportFormatError(
                    f"recipe '{self.recipe.name}': no_contact.frames_before is for Motion-JPEG videos (.avi), and "
                    f"{self.files[name].name} is not one; {CONVERT_VIDEO}; or name the image without contact of a "
                    "picture as no_contact.file"
                )
            force_n = self._picture_force(name)
            self._pictures.clear()
            images = [self._picture(self.files[name]), *self._without_contact(name)]
            require_alike(self._pictures)
            if self.recipe.no_contact.file is not None and np.array_equal(images[0], images[1]):
                raise LeftOutError("its image is the one without contact")
            if self.recipe.no_contact.repeat_file is not None and np.array_equal(images[0], images[-1]):
                raise ImportFormatError(
                    f"recipe '{self.recipe.name}': no_contact.repeat_file of {name} is its image with contact, "
                    "pixel by pixel; name a second picture without contact, or leave it out"
                )
        if any(image.shape != images[0].shape for image in images):
            sizes = ", ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
            raise ImportFormatError(
                f"{self.files[name]}: its image and those without contact have different sizes ({sizes} px); "
                "all must come from one camera at one size"
            )
        capture = self._placed(name, self._unplaced(name, images, force_n))
        if self.recipe.no_contact.far_pixels:
            capture = _with_far_surface(capture)
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
            indenter=self._pose(name),
            contact_circle=None,
            mm_per_px=None if recipe.scale is None else recipe.scale.side_mm,
            source=recipe.what,
            no_contact_from="median of presses" if recipe.no_contact.median_of_presses else "image",
            force_n=force_n,
            licence=recipe.licence,
        )

    def note_numbers(self, name: str, capture: TactileCapture) -> None:
        """Keep the depth, which is checked over all presses."""
        pose, circle = capture.indenter, capture.contact_circle
        if pose.depth_mm is not None:
            cap_mm = None
            if pose.shape == "ball" and pose.radius_mm and circle is not None and capture.mm_per_px is not None:
                touching_mm = min(circle.radius_px * capture.mm_per_px, pose.radius_mm)
                cap_mm = pose.radius_mm - float(np.sqrt(pose.radius_mm**2 - touching_mm**2))
            self._depths[name] = (pose.depth_mm, cap_mm)

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
                lengths_px.append(self._quantity(name, contact.file, contact.press, scale.check_length_px))
            except LeftOutError:
                continue
        if not lengths_px:
            return
        shown_px = float(np.median(lengths_px))
        if not shown_px > 0.0:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', scale: check_length_px is {shown_px:g} px in the labels, and must be "
                "above 0"
            )
        ratio = shown_px * scale.side_mm / scale.check_length_mm
        if abs(ratio - 1.0) > SCALE_TOLERANCE_REL:
            right = scale.check_length_mm / shown_px
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', scale: {scale.check_length_mm:g} mm are {shown_px:.4g} px in the "
                f"labels, so a pixel is {right:.4g} mm, not {scale.side_mm:.4g} mm; check whether mm per px and px "
                "per mm are exchanged"
            )

    def _is_deep(self, name: str) -> bool:
        """Return whether the values of a press go beyond 8 bits."""
        path = self.files[name]
        if path.suffix.lower() == VIDEO:
            return False
        return path.suffix.lower() == ".exr" or self._pictures[path].dtype == np.uint16

    def _bits(self, name: str) -> Literal[8, 10, 12, 14, 16]:
        """Return the bits of a press's counts."""
        bits, path = self.recipe.picture.bit_depth, self.files[name]
        if bits is None:
            return 16 if self._is_deep(name) else 8
        if path.suffix.lower() == ".exr" or not self._is_deep(name):
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': picture.bit_depth = {bits} belongs to pictures of 16 bits, and "
                f"{path.name} is not one; leave it out"
            )
        largest, file = max((int(picture.max()), file) for file, picture in self._pictures.items())
        if largest >= 2**bits:
            raise ImportFormatError(
                f"{file}: its largest value is {largest}, and counts of picture.bit_depth = {bits} end at "
                f"{2**bits - 1}; they must be right-aligned: divide those of a left-aligned camera by "
                f"{2 ** (16 - bits)}, or correct bit_depth"
            )
        return bits

    def _picture(self, path: Path) -> Counts:
        """Return a picture as counts (H, W, 3) in RGB order, stretched where the recipe says so."""
        self._made_of.add(path)
        if path.suffix.lower() == ".exr":
            full = self.recipe.picture.full_scale
            if full is None:
                raise ImportFormatError(
                    f"recipe '{self.recipe.name}': picture.full_scale is missing; state which value of "
                    f"{path.name} becomes the largest of 65535 steps"
                )
            self._pictures[path] = exr_steps(path, full)
            return self._arranged(self._pictures[path])
        if self.recipe.picture.full_scale is not None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': picture.full_scale belongs to OpenEXR images, and {path.name} is not "
                "one; leave it out"
            )
        if path.suffix.lower() == ".npy" and "channels" not in self.recipe.picture.model_fields_set:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': {path.name} does not state the order of its channels; write "
                'channels = "RGB" or "BGR" (as OpenCV reads pictures) below [picture]'
            )
        self._pictures[path] = pixels_of(path)
        return self._arranged(in_colour(self._pictures[path]))

    def _arranged(self, image: NDArray[Any]) -> Counts:
        """Return an image (H, W, 3) in the order and at the corners that the recipe gives."""
        picture = self.recipe.picture
        if picture.channels == "BGR":
            image = image[..., ::-1]
        if picture.corners_px is not None and picture.size_px is not None:
            width, height = picture.size_px
            corners = [[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]]
            seen, wanted = (np.array(places, dtype=np.float32) for places in (picture.corners_px, corners))
            turned = cv2.getPerspectiveTransform(seen, wanted)
            image = cv2.warpPerspective(np.ascontiguousarray(image), turned, picture.size_px, flags=cv2.INTER_AREA)
        return np.ascontiguousarray(image).astype(np.uint16)

    def _without_contact(self, name: str) -> list[Counts]:
        """Return the images without contact, two where there is a repeat; none where it comes from far pixels."""
        source = self.recipe.no_contact
        if source.median_of_presses:
            if self._median is None:
                left_out = set(self.recipe.presses.leave_out)
                files = [path for name, path in self.files.items() if name not in left_out]
                step = -(-len(files) // MOST_IN_MEDIAN)
                pictures = [self._picture(path) for path in files[::step]]
                if len({picture.shape for picture in pictures}) > 1 or len(pictures) < 3:
                    raise ImportFormatError(
                        f"{self.folder}: a median needs at least 3 presses of one size, got {len(pictures)}; take "
                        "images without contact"
                    )
                self._median = np.median(pictures, axis=0).astype(np.uint16)
                self._median_of = set(files[::step])
            self._made_of |= self._median_of
            return [self._median]
        found = []
        for pattern, needed in ((source.file, True), (source.repeat_file, False)):
            if pattern is None:
                continue
            path = named_file(self.folder, pattern, name)
            if has_file(path):
                found.append(self._picture(path))
            elif needed:
                raise LeftOutError(f"the image without contact, {pattern}, is missing")
        if len(found) == 2 and np.array_equal(found[0], found[1]):
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no_contact.repeat_file and no_contact.file of {name} are one picture, "
                "pixel by pixel, which would show a camera without noise; name a second picture, or leave it out"
            )
        return found

    def _video(self, name: str) -> tuple[list[Counts], float | None]:
        """Return contact, no contact and its repeat of a video, and the force at the contact image."""
        before = self.recipe.no_contact.frames_before
        if before is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no_contact.frames_before is missing; state how many frames of "
                "a video are without contact"
            )
        path = self.files[name]
        self._made_of.add(path)
        frames = motion_jpeg_frames(path)
        if len(frames) <= before:
            raise LeftOutError(f"the video has {len(frames)} frames, and the first {before} are without contact")
        first = small_frame(frame_of(frames[0], path))
        force = self._force(name, len(frames))
        if force is None:
            strength = np.array([np.abs(small_frame(frame_of(frame, path)) - first).mean() for frame in frames])
        else:  # many load cells count compression as negative, or rest beside zero
            strength = np.abs(force - np.median(force[:before]))
        if not strength.max() > 0.0:
            raise LeftOutError("nothing changes in its video")
        held = longest_hold(strength)
        if held < before or begins_early(strength, before, 0 if force is None else 1):
            raise LeftOutError(
                f"its video shows contact within the first {before} frames, which should be without contact"
            )
        images = [frame_of(frames[i], path) for i in (held, 0, before - 1)]
        return [self._arranged(image) for image in images], None if force is None else float(force[held])

    def _force(self, name: str, frames: int) -> Floats | None:
        """Return the force of each frame, N; None where there is no file."""
        source = self.recipe.force
        if source is None:
            return None
        path = named_file(self.folder, source.file, name)
        if path.suffix.lower() in PICKLED:
            raise ImportFormatError(f"{path}: {pickle_words(path)}")
        if not has_file(path):
            return None
        self._made_of.add(path)
        try:
            values = (
                np.array([finite_number(cell) for cell in label_column(path, source.column)])
                if path.suffix.lower() == ".csv"
                else read_npy(path, "forces (npy)", ImportFormatError).astype(np.float64).ravel()
            )
        except ValueError as error:
            raise ImportFormatError(f"{path}: every force must be a finite number: {error}") from None
        if len(values) != frames or not np.isfinite(values).all():
            raise ImportFormatError(
                f"{path}: holds {len(values)} forces, the video {frames} frames; one finite number for each is needed"
            )
        return np.asarray(values * source.factor)

    def _picture_force(self, name: str) -> float | None:
        """Return the force of a press that is a picture, N."""
        source = self.recipe.force
        if source is None:
            return None
        if source.column is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}', force.column: missing; name the column, array or key of the force"
            )
        return self._quantity(name, source.file, source.press, source.column) * source.factor

    def _pose(self, name: str) -> IndenterPose:
        """Return what was pressed in, how deep and where."""
        indenter = self.recipe.indenter
        diameter_mm, depth_mm, position_mm = (
            self._of_indenter(name, of) for of in ("diameter_mm", "depth_mm", "position_mm")
        )
        above_zero("diameter", diameter_mm)
        above_zero("depth, from first touch,", depth_mm)
        return IndenterPose(
            shape=indenter.shape,
            radius_mm=None if diameter_mm is None else diameter_mm / 2.0,
            depth_mm=depth_mm,
            position_mm=position_mm,
            depth_uncertainty_mm=None if depth_mm is None else indenter.depth_uncertainty_mm,
            position_uncertainty_mm=None if position_mm is None else indenter.position_uncertainty_mm,
        )

    def _of_indenter(self, name: str, what: str) -> float | None:
        """Return diameter, depth or position of the indenter."""
        indenter, contact = self.recipe.indenter, self.recipe.contact
        value: PlaceOfPress | OfPress | None = getattr(indenter, what)
        if isinstance(value, dict):
            return value.get(name)
        if value is None or isinstance(value, float):
            return value
        file, press = indenter.file, indenter.press
        if file is None and contact is not None:
            file, press = contact.file, contact.press
        return self._quantity(name, file, press, value) * indenter.column_unit_mm(what)

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
                self._quantity(name, contact.file, contact.press, value)
                for value in (contact.circle.column_px, contact.circle.row_px, contact.circle.radius_px)
            )
            if radius <= 0.0:
                raise LeftOutError(f"its circle has a radius of {radius:g} px; it must be above 0")
            return self._with_circle(capture, ContactCircle(row_px=row, column_px=column, radius_px=radius), "label")
        if contact.search is not None:
            placed = self._searched(capture, contact.search)
            fields = ("contact_circle", "contact_outline", "contact_told_by")
            self._found[name] = {name_of: getattr(placed, name_of) for name_of in fields}
            return placed
        places = contact.outline_px.get(name) if contact.outline_px else self._hull(name)
        if places is None:
            raise LeftOutError("the recipe gives no outline for this press")
        corners = tuple(PlaceInImage(column_px=float(c), row_px=float(r)) for c, r in places)
        return capture.model_copy(update={"contact_outline": corners, "contact_told_by": "label"})

    def _searched(self, capture: TactileCapture, what: Literal["circle", "outline"]) -> TactileCapture:
        """Return the capture with the contact that a search finds."""
        if what == "circle":
            return self._with_circle(capture, find_contact_circle(capture, _ball_px(capture)).circle, "search")
        corners = find_contact_outline(capture)
        return capture.model_copy(update={"contact_outline": corners, "contact_told_by": "search"})

    def _with_circle(self, capture: TactileCapture, circle: ContactCircle, by: str) -> TactileCapture:
        """Return the capture with a circle that can be."""
        rows, columns = capture.contact.shape[:2]
        if not (0.0 <= circle.row_px < rows and 0.0 <= circle.column_px < columns):
            raise LeftOutError(
                f"its circle's centre, row {circle.row_px:g}, column {circle.column_px:g}, lies outside the picture of "
                f"{columns} x {rows} px; check whether row and column are exchanged"
            )
        ball_px = _ball_px(capture)
        if ball_px is not None and circle.radius_px > ball_px:
            raise LeftOutError(
                f"a contact circle of {circle.radius_px:g} px radius is larger than the ball's {ball_px:.4g} px; check "
                "that the scale is mm per px, not px per mm, and that the ball's size is its diameter"
            )
        return capture.model_copy(update={"contact_circle": circle, "contact_told_by": by})

    def _hull(self, name: str) -> NDArray[np.float32]:
        """Return the hull of all corners that the label holds, (corners, 2): column, row."""
        contact = self.recipe.contact
        path = named_file(self.folder, (contact.file if contact is not None else None) or "", name)
        if not has_file(path):
            raise LeftOutError(f"the file {path.name}, which its recipe names, is missing")
        self._made_of.add(path)
        arrays, pickled = read_npz(path)
        corners = [
            label_array(arrays, pickled, part, path) for part in (contact.outline if contact is not None else ())
        ]
        if any(part.ndim != 2 or part.shape[1] != 2 for part in corners):
            raise ImportFormatError(f"{path}: corners must be of shape (n, 2), column and row; correct contact.outline")
        points = np.concatenate(corners).astype(np.float32) if corners else np.zeros((0, 2), dtype=np.float32)
        if len(np.unique(points, axis=0)) < 3 or not np.isfinite(points).all():
            raise LeftOutError("its outline has fewer than 3 corners, or some that are not numbers")
        return np.asarray(cv2.convexHull(points)[:, 0], dtype=np.float32)

    def _quantity(self, name: str, file: str | None, press: str | None, value: Quantity) -> float:
        """Return a number of a press: as it stands in the recipe, or in a table, npz or JSON file."""
        if isinstance(value, float):
            return value
        if file is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': no file is named for '{value}'; add the key file to [contact], or to "
                "[indenter] for a number of the indenter"
            )
        path = named_file(self.folder, file, name)
        if path.suffix.lower() in PICKLED:
            raise ImportFormatError(f"{path}: {pickle_words(path)}")
        if path.suffix.lower() in (".npz", ".json"):
            if not has_file(path):
                raise LeftOutError(f"the file {path.name}, which its recipe names, is missing")
            self._made_of.add(path)
            return label_entry(path, value)
        if press is None:
            raise ImportFormatError(
                f"recipe '{self.recipe.name}': 'press' is missing next to file = \"{file}\"; name "
                "the column that holds the press of each line (a file for each press must be npz or JSON)"
            )
        table = self._tables.get((path, press)) or read_label_table(path, press)
        self._tables[path, press] = table
        self._made_of.add(path)
        row = table.row(name, self.files[name].relative_to(self.folder), self._last_parts[name])
        if row is None:
            raise LeftOutError(f"no line of {path.name} names this press")
        if value not in row:
            raise ImportFormatError(
                f"{path}: has no column '{value}'; it has {', '.join(row)}: correct the recipe '{self.recipe.name}'"
            )
        try:
            return finite_number(row[value])
        except ValueError:
            raise ImportFormatError(
                f"{path}: {value} of {name} must be a number, got {row[value]!r}; write it with a decimal point, or "
                "name the press in presses.leave_out"
            ) from None

    def _missing(self, capture: TactileCapture) -> tuple[MissingPart, ...]:
        """Return what the capture lacks, and what is lost by it."""
        source = self.recipe.no_contact
        common = source.file is not None and PRESS not in source.file
        lacks = (
            (capture.repeat_no_contact is None, "a second image without contact", "how much of an error is noise"),
            (common, "an image without contact of each press", "drift and wear of the gel cannot be separated"),
            (source.median_of_presses, "an image without contact", _MEDIAN_LOSES),
            (source.far_pixels, "an image without contact", _SURFACE_LOSES),
            (capture.contact_told_by == "search", "a drawn contact", "found by a search: its size is known to 20 %"),
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


def _with_far_surface(capture: TactileCapture) -> TactileCapture:
    """Return the capture with a smooth surface through its far pixels in the place of a no-contact image."""
    distance = contact_distance(capture)
    if distance is None:
        raise LeftOutError("the place of its contact is not known, and so neither are the pixels far from it")
    rows, columns = distance.shape
    y, x = np.mgrid[:rows, :columns] / max(rows, columns) - 0.5
    powers = [(i, j) for i in range(_SURFACE_DEGREE + 1) for j in range(_SURFACE_DEGREE + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    values = np.log(np.maximum(capture.contact.astype(np.float64), 0.5))
    far = (distance > FAR_HALF_WIDTHS) & (capture.contact < 2**capture.bit_depth - 1).all(axis=-1)
    if far.mean() < 0.1:
        raise LeftOutError("less than a tenth of the picture is far from its contact: give an image without contact")
    surface = np.exp(terms @ np.linalg.lstsq(terms[far], values[far], rcond=None)[0])
    limited = np.clip(np.rint(surface), 0.0, 2**capture.bit_depth - 1).astype(np.uint16)
    return capture.model_copy(update={"no_contact": limited, "no_contact_from": "pixels far from the contact"})
