"""Folders of wavelength-named TIFF images of other labs as band signals.

``bands.toml`` says what a person must say about such a folder before it can be reduced. Images are found by name, read,
and laid out as the RGGB mosaic that radiometry reduces; filters, camera response and lamp are nominal or measured.
"""

import glob
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandFolder,
    BandSignals,
    CameraSettings,
    CaptureSession,
    FilterWheelSettings,
    Frame,
    FrameType,
    ImageLayout,
    ImportedCamera,
    ImportFormatError,
    LampSettings,
    LightState,
    PaintPlan,
    RadiometryError,
    RigFile,
    SpectralCurve,
    Target,
    coverage_notes,
    digest_of_input,
)
from data_schemas.storage import (
    assumed_camera_response,
    halogen_lamp,
    read_bytes,
    read_camera_response,
    read_light,
    read_toml,
    tiff_image,
)
from finray_calib.exchange._lab_measurements import (
    curve_inside,
    filter_curves_of,
    one_channel,
    require_line,
    wheel_of,
)
from finray_calib.radiometry import band_signals, monochrome_bands

DESCRIPTION_NAME = "bands.toml"
HALOGEN = "planck-2856K"
Counts = NDArray[np.uint16]
# Row and column within the 2 x 2 cell where each layout keeps red, the green beside red, the green beside blue, blue.
_CELLS: dict[str, tuple[tuple[int, int], ...]] = {
    "Bayer RGGB": ((0, 0), (0, 1), (1, 0), (1, 1)),
    "Bayer BGGR": ((1, 1), (1, 0), (0, 1), (0, 0)),
    "Bayer GRBG": ((0, 1), (0, 0), (1, 1), (1, 0)),
    "Bayer GBRG": ((1, 0), (1, 1), (0, 0), (0, 1)),
}


@dataclass(frozen=True, slots=True)
class BandImage:
    """One file: what it shows, through which filter, for how long."""

    path: Path
    frame_type: FrameType
    filter_name: str | None
    exposure_s: float


def find_images(folder: Path, description: BandFolder) -> list[BandImage]:
    """Return the images that the description names, darks first, in the order of the names.

    Raises
    ------
    ImportFormatError
        A pattern leaves the folder or matches no file, two patterns match the same file, or `exposure_s.files` names
        a file that no pattern matches.
    """
    files, times = description.files, description.exposure_s
    names = [f.name for f in description.filters]

    def own_s(path: Path, exposure_s: float) -> float:
        return times.files.get(path.relative_to(folder).as_posix(), exposure_s)

    images = [
        BandImage(path, "dark", None, own_s(path, dark.exposure_s))
        for dark in description.darks
        for path in _matches(folder, "darks.files", dark.files, None)
    ]
    kinds: tuple[tuple[FrameType, str, list[str]], ...] = (
        ("white", "white", names),
        ("laser white", "laser_white", [description.excitation_filter]),
        ("reflectance", "reflectance", names),
        ("fluorescence", "fluorescence", names),
    )
    for frame_type, field, filters in kinds:
        time = getattr(times, field)
        for name in filters:
            exposure_s: float = time[name] if isinstance(time, dict) else time
            for path in _matches(folder, f"files.{field}", getattr(files, field), name):
                images.append(BandImage(path, frame_type, name, own_s(path, exposure_s)))
    _check_names(folder, images, times.files)
    return images


def read_image(path: Path, camera: ImportedCamera) -> Counts:
    """Return an image as an RGGB mosaic of counts (DN).

    A monochrome image stays as it is: all four sites of a cell are the same channel. Of an RGB image each site keeps
    its own channel. An odd last row or column is left out.

    Raises
    ------
    ImportFormatError
        The file is no single image of the declared layout, not 8 or 16 bits deep, or brighter than its bit depth.
    """
    stored = tiff_image(read_bytes(path, "a band image (TIFF)", ImportFormatError), path, ImportFormatError)
    wanted = 3 if camera.layout == "RGB" else 2
    if stored.ndim != wanted or (wanted == 3 and stored.shape[2] != 3) or stored.dtype not in (np.uint8, np.uint16):
        raise ImportFormatError(
            f"{path}: contains {stored.dtype} of shape {stored.shape}, but camera.layout = '{camera.layout}' needs "
            f"one 8- or 16-bit image of {('rows x columns x 3' if wanted == 3 else 'rows x columns')} per file"
        )
    counts: Counts = stored.astype(np.uint16) >> np.uint16(camera.left_aligned_bits)
    full_scale_dn = 2**camera.bit_depth - 1
    if counts.max() > full_scale_dn:
        raise ImportFormatError(
            f"{path}: the brightest value is {counts.max()} DN, above the {full_scale_dn} DN of camera.bit_depth = "
            f"{camera.bit_depth}; correct bit_depth, or left_aligned_bits if the values are shifted up in the file"
        )
    return _mosaic(counts, camera.layout)


def _mosaic(counts: Counts, layout: ImageLayout) -> Counts:
    """Return the counts with red, green, green, blue at the sites of an RGGB cell."""
    rows, columns = counts.shape[0] & ~1, counts.shape[1] & ~1
    even = counts[:rows, :columns]
    if layout == "monochrome":
        return even
    mosaic = np.empty((rows, columns), dtype=np.uint16)
    for site, cell in enumerate(_CELLS["Bayer RGGB"]):
        if layout == "RGB":
            mosaic[cell[0] :: 2, cell[1] :: 2] = even[cell[0] :: 2, cell[1] :: 2, (0, 1, 1, 2)[site]]
        else:
            row, column = _CELLS[layout][site]
            mosaic[cell[0] :: 2, cell[1] :: 2] = even[row::2, column::2]
    return mosaic


def _matches(folder: Path, field: str, pattern: str, filter_name: str | None) -> list[Path]:
    """Return the files below the folder that a pattern names."""
    parts = PurePosixPath(pattern)
    if parts.is_absolute() or ".." in parts.parts:
        raise ImportFormatError(
            f"bands.toml, {field} = {pattern!r}: points outside the folder; name only files in {folder}"
        )
    filled = pattern.replace("{filter}", glob.escape(filter_name or ""))
    found = sorted(path for path in folder.glob(filled) if path.is_file())
    if not found:
        through = "" if filter_name is None else f", filter {filter_name}"
        raise ImportFormatError(
            f"{folder}: no file matches {filled!r} ({field}{through}); correct bands.toml or add the image"
        )
    return found


def _check_names(folder: Path, images: list[BandImage], timed: dict[str, float]) -> None:
    """Refuse a file that stands for two things, and an exposure time of a file that is not used."""
    seen: dict[Path, BandImage] = {}
    for image in images:
        other = seen.setdefault(image.path, image)
        if other is not image:
            raise ImportFormatError(
                f"{image.path}: the patterns of bands.toml name this image as {_words(other)} and as {_words(image)}; "
                "change the patterns so that each image matches only one (for example '{filter}nm.tif' instead of "
                "'{filter}*')"
            )
    used = {path.relative_to(folder).as_posix() for path in seen}
    unused = sorted(set(timed) - used)
    if unused:
        raise ImportFormatError(
            f"bands.toml, exposure_s.files: no pattern matches the file {unused[0]!r}; correct the file name"
        )


def _words(image: BandImage) -> str:
    """Say what an image stands for."""
    return f"'{image.frame_type}'" + ("" if image.filter_name is None else f" through filter {image.filter_name}")


Floats = NDArray[np.float64]
_BELOW_BLACK_SD = 5.0  # one channel in some million is so far off by chance
_ROUNDING_DN = 0.5  # by which rounded counts without noise may lie below what they count
_SCENE: Mapping[str, tuple[Target, LightState]] = {
    "dark": ("white", "off"),
    "white": ("white", "lamp"),
    "laser white": ("white", "laser"),
    "reflectance": ("sample", "lamp"),
    "fluorescence": ("sample", "laser"),
}


def import_band_folder(folder: Path) -> tuple[BandSignals, dict[str, str]]:
    """Reduce a folder of band images and its ``bands.toml`` to band signals, with the arithmetic of paint sessions.

    Of a monochrome camera the green column holds the signals; red and blue are flagged "weak" and never used.

    Parameters
    ----------
    folder
        Holds ``bands.toml``, the images and the curves that it names.

    Returns
    -------
    BandSignals, dict
        The signals, and file name below the folder -> SHA-256 of every file that was used.

    Raises
    ------
    ImportFormatError
        ``bands.toml`` or an image is missing, or an image is not what the description says.
    RecordError
        A field of ``bands.toml`` is wrong.
    CurveError
        A curve file is unusable.
    RadiometryError
        The images cannot be reduced: saturated bands, missing darks, an empty region.
    """
    if folder.is_file():
        raise ImportFormatError(f"{folder}: is a file; give the folder of the images, which holds {DESCRIPTION_NAME}")
    if not (folder / DESCRIPTION_NAME).exists():
        raise ImportFormatError(
            f"{folder}: {DESCRIPTION_NAME}, which tells what each image shows, is missing; write it as "
            "docs/how-to/import-band-images.md shows"
        )
    description = read_toml(folder / DESCRIPTION_NAME, BandFolder)
    require_inside(folder, description)
    images = find_images(folder, description)
    _check_darks(images)
    frames = [_frame(n, image) for n, image in enumerate(images)]
    paths = {frame.file: image.path for frame, image in zip(frames, images, strict=True)}
    shape = _common_shape(images, description)
    black: dict[str, Floats] = {}
    if not description.darks:
        for frame, level_dn in _black_frames(description, images):
            frames.append(frame)
            black[frame.file] = np.full(shape, level_dn)

    def read(frame: Frame) -> Any:
        if frame.file in black:
            return black[frame.file]
        return read_image(paths[frame.file], description.camera)

    session = _session(folder, description, tuple(frames))
    names = {stored: path.relative_to(folder).as_posix() for stored, path in paths.items()}
    try:
        bands = band_signals(session, read)
    except RadiometryError as error:
        raise RadiometryError(_of_the_folder(str(error), names)) from None
    notes = [_of_the_folder(note, names) for note in bands.notes]
    if black:  # the frames that stand in for darks differ by the declared uncertainty, which is no drift that was seen
        notes = [note for note in notes if not note.startswith("largest drift of the dark level")]
    bands = bands.model_copy(update={"notes": tuple(notes)})
    used = [*names.values(), *named_files(description)]
    digests = {name: digest_of_input(folder / name) for name in used}
    return (monochrome_bands(bands) if description.camera.layout == "monochrome" else bands), digests


_WORDS_OF_A_SESSION = (
    (
        "capture again with a lower plan.target_fraction or a shorter exposure in plan.bracket",
        "add an image of a shorter exposure to the folder, and its time to exposure_s.files",
    ),
    (r"^(session\.)?plan\.", f"{DESCRIPTION_NAME}: "),
    (r"(?<![\w./-])(session\.)?plan\.(\w+)", rf"\2 in {DESCRIPTION_NAME}"),
)
"""What an error of a session says -> what it says of a folder of images, which has neither plan nor frames."""


def _of_the_folder(text: str, names: Mapping[str, str]) -> str:
    """Return what radiometry says with the fields of the description and the images' own names."""
    for said, instead in _WORDS_OF_A_SESSION:
        text = re.sub(said, instead, text)
    for stored, name in names.items():  # last, because an image may be named plan.tif
        text = text.replace(stored, name)
    return text


def _frame(sequence: int, image: BandImage) -> Frame:
    """Return the frame record of an image; what the folder does not tell keeps a neutral value."""
    target, light = _SCENE[image.frame_type]
    return Frame(
        sequence=sequence,
        file=f"frames/{sequence:05d}-{re.sub('[^A-Za-z0-9_.-]', '-', image.path.name)}.tiff",
        frame_type=image.frame_type,
        target=target,
        light=light,
        filter_name=image.filter_name,
        slot_before=None,
        slot_after=None,
        exposure_requested_s=image.exposure_s,
        exposure_s=image.exposure_s,
        captured_utc="unknown",
        saturated_fraction=0.0,
        sha256="0" * 64,  # of no stored frame: the images are inputs, whose digests stand in the provenance
    )


def _black_frames(description: BandFolder, images: list[BandImage]) -> list[tuple[Frame, float]]:
    """Return dark frames made of the declared black level: two per exposure time, apart by its uncertainty.

    Radiometry reads half the difference d of before and after as a rectangular uncertainty d / sqrt(3).
    """
    spread_dn = np.sqrt(3.0) * description.camera.black_level_uncertainty_dn
    frames: list[tuple[Frame, float]] = []
    for side in (-1.0, 1.0):
        for exposure_s in sorted({image.exposure_s for image in images}):
            image = BandImage(Path(), "dark", None, exposure_s)
            level_dn = description.camera.black_level_dn + side * spread_dn
            frames.append((_frame(len(images) + len(frames), image), level_dn))
    return frames


def _check_darks(images: list[BandImage]) -> None:
    """Refuse dark frames that miss an exposure time in use."""
    dark_s = {image.exposure_s for image in images if image.frame_type == "dark"}
    for image in images:
        if dark_s and image.exposure_s not in dark_s:
            raise ImportFormatError(
                f"{image.path}: was exposed for {image.exposure_s:g} s, but the dark frames were exposed for "
                f"{', '.join(f'{s:g}' for s in sorted(dark_s))} s; add a [[darks]] table of "
                f"{image.exposure_s:g} s, or remove all [[darks]] tables and give camera.black_level_dn"
            )


def _common_shape(images: list[BandImage], description: BandFolder) -> tuple[int, ...]:
    """Return the shape of all images (px), read one at a time; refuse images of different sizes."""
    first: tuple[int, ...] = ()
    for image in images:
        counts = read_image(image.path, description.camera)
        shape = counts.shape
        first = first or shape
        if shape != first:
            raise ImportFormatError(
                f"{image.path}: is {shape[0]} x {shape[1]} px, but {images[0].path.name} is {first[0]} x {first[1]} "
                "px; take all images with the same camera settings"
            )
        if not description.darks:
            _require_not_below_black(image.path, counts, description)
    return first


def _require_not_below_black(path: Path, counts: Counts, description: BandFolder) -> None:
    """Refuse an image whose mean lies further below the declared black level than noise and uncertainty reach."""
    camera, region = description.camera, description.region
    rows = slice(region.row_px, region.row_px + region.height_px)
    inside = counts[rows, region.column_px : region.column_px + region.width_px]
    sites = [inside[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    if not all(site.size for site in sites):  # beyond the frame, which radiometry refuses
        return
    lowest = min(sites, key=lambda site: float(site.mean()))
    noise_dn = np.hypot(
        camera.black_level_uncertainty_dn, camera.read_noise_e / camera.gain_e_per_dn / np.sqrt(lowest.size)
    )
    if lowest.mean() < camera.black_level_dn - _BELOW_BLACK_SD * noise_dn - _ROUNDING_DN:
        raise ImportFormatError(
            f"{path}: a channel's mean in the region is {lowest.mean():.1f} DN, below camera.black_level_dn = "
            f"{camera.black_level_dn:g} DN by more than its uncertainty ({camera.black_level_uncertainty_dn:g} DN) "
            "and the noise allow; correct black_level_dn (raw counts without light), "
            "or replace the image"
        )


def _session(folder: Path, description: BandFolder, frames: tuple[Frame, ...]) -> CaptureSession:
    """Return the folder as the paint session that radiometry reduces; it is never stored."""
    camera = description.camera
    filter_curves = filter_curves_of(folder, description.filters)
    wheel = wheel_of(folder / DESCRIPTION_NAME, description.filters, filter_curves)
    _require_passes_laser(folder, description, wheel)
    response, lamp = response_of(folder, description), lamp_of(folder, description)
    # Constructed, not validated: a rig wants drivers or a simulated bench, and an imported folder has neither.
    rig = RigFile.model_construct(
        name=f"imported from {folder.resolve().name}",
        camera=CameraSettings(
            bit_depth=camera.bit_depth,
            black_level_dn=camera.black_level_dn,
            gain_e_per_dn=camera.gain_e_per_dn,
            read_noise_e=camera.read_noise_e,
            response=camera.response,
        ),
        filter_wheel=wheel,
        laser=description.laser,
        lamp=LampSettings(),
        white_reference=description.white_reference,
        band_uncertainty=description.band_uncertainty,
        simulated=None,
        provenance=None,
    )
    return CaptureSession.model_construct(
        provenance=None,
        plan=PaintPlan(
            paint_name=description.paint_name,
            filters=tuple(f.name for f in description.filters),
            excitation_filter=description.excitation_filter,
            region=description.region,
        ),
        rig=rig,
        camera_response=response,
        filter_curves=filter_curves,
        lamp=lamp,
        frames=frames,
        notes=_notes(folder, description, max(frame.exposure_s for frame in frames))
        + coverage_notes(wheel.filters, filter_curves, (*response, lamp)),
    )


def _require_passes_laser(folder: Path, description: BandFolder, wheel: FilterWheelSettings) -> None:
    """Refuse a source that is no line, and an excitation filter whose band does not hold the line."""
    chosen = next(one for one in wheel.filters if one.name == description.excitation_filter)
    low_nm, high_nm = chosen.center_nm - 0.5 * chosen.fwhm_nm, chosen.center_nm + 0.5 * chosen.fwhm_nm
    laser = description.laser
    require_line(folder / DESCRIPTION_NAME, laser)
    if not low_nm - 0.5 * laser.fwhm_nm <= laser.wavelength_nm <= high_nm + 0.5 * laser.fwhm_nm:
        raise ImportFormatError(
            f"{folder / DESCRIPTION_NAME}: excitation_filter '{chosen.name}' passes {low_nm:g} to {high_nm:g} nm, but "
            f"laser.wavelength_nm is {laser.wavelength_nm:g} nm; name the filter that passes the laser, or correct the "
            "wavelength"
        )


def _notes(folder: Path, description: BandFolder, longest_s: float) -> tuple[str, ...]:
    """Say what a reader of the signals must know of their origin."""
    notes = [f"imported from {folder.resolve().name} ({description.camera.layout}); laser dose unknown"]
    if not description.darks:
        notes.append(
            f"no dark frames: black level {description.camera.black_level_dn:g} DN with standard uncertainty "
            f"{description.camera.black_level_uncertainty_dn:g} DN, as declared; the dark current of exposures of up "
            f"to {longest_s:g} s is not subtracted"
        )
    if description.camera.response == "assumed":
        notes.append("the camera response is assumed")
    return tuple(notes)


def require_inside(folder: Path, description: BandFolder) -> None:
    """Refuse curve files outside of the folder, as for images: a folder from elsewhere must not read others.

    Raises
    ------
    CurveError
        A curve's path is absolute or leads out of the folder.
    """
    for name in named_files(description):
        curve_inside(folder / DESCRIPTION_NAME, name)


def response_of(folder: Path, description: BandFolder) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return the camera's response; three times the same for a monochrome camera."""
    camera = description.camera
    if camera.layout != "monochrome":
        return (
            assumed_camera_response()
            if camera.response == "assumed"
            else read_camera_response(folder / camera.response)
        )
    return one_channel(None if camera.response == "assumed" else folder / camera.response)


def lamp_of(folder: Path, description: BandFolder) -> SpectralCurve:
    """Return the lamp's relative spectral power."""
    return halogen_lamp() if description.lamp == HALOGEN else read_light(folder / description.lamp)


def named_files(description: BandFolder) -> list[str]:
    """Return the names of the description and of the curve files that it refers to."""
    named = [f.curve for f in description.filters]
    named.append(None if description.camera.response == "assumed" else description.camera.response)
    named.append(None if description.lamp == HALOGEN else description.lamp)
    return [DESCRIPTION_NAME, *(name for name in named if name is not None)]
