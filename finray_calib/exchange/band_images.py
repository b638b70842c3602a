"""Images of a band folder: found by name, read, and laid out as the RGGB mosaic that radiometry reduces."""

import glob
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import FrameType
from data_schemas.errors import ImportFormatError
from data_schemas.foreign_files import read_bytes
from data_schemas.frame_files import tiff_image
from finray_calib.exchange.band_folder_file import BandFolder, ImportedCamera, Layout

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
    images = [
        BandImage(path, "dark", None, dark.exposure_s)
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
                own_s = times.files.get(path.relative_to(folder).as_posix(), exposure_s)
                images.append(BandImage(path, frame_type, name, own_s))
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
            f"{path}: holds {stored.dtype} of shape {stored.shape}; camera.layout = '{camera.layout}' needs one 8- or "
            f"16-bit image of {'rows x columns x 3' if wanted == 3 else 'rows x columns'} per file"
        )
    counts: Counts = stored.astype(np.uint16) >> np.uint16(camera.left_aligned_bits)
    full_scale_dn = 2**camera.bit_depth - 1
    if counts.max() > full_scale_dn:
        raise ImportFormatError(
            f"{path}: the brightest value is {counts.max()} DN, above the {full_scale_dn} DN of camera.bit_depth = "
            f"{camera.bit_depth}; correct bit_depth, or left_aligned_bits if the values are shifted up in the file"
        )
    return _mosaic(counts, camera.layout)


def _mosaic(counts: Counts, layout: Layout) -> Counts:
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
        raise ImportFormatError(f"bands.toml, {field} = {pattern!r}: leads out of the folder; name files in {folder}")
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
                f"{image.path}: is both {_words(other)} and {_words(image)}; make the patterns of bands.toml tell them "
                "apart (for example '{filter}nm.tif' instead of '{filter}*')"
            )
    used = {path.relative_to(folder).as_posix() for path in seen}
    unused = sorted(set(timed) - used)
    if unused:
        raise ImportFormatError(
            f"bands.toml, exposure_s.files: no pattern matches {unused[0]!r}; correct the file name"
        )


def _words(image: BandImage) -> str:
    """Say what an image stands for."""
    return f"'{image.frame_type}'" + ("" if image.filter_name is None else f" through filter {image.filter_name}")
