"""A folder of Raspberry Pi images of one press becomes a tactile capture.

The folder holds ``contact``, ``no_contact`` and, if there is one, ``repeat_no_contact``: all raw (DNG as
``rpicam-still --raw`` writes it, or 16-bit TIFF) or all processed (8-bit PNG or JPEG). Beside each image lies its
metadata under the same name (``contact.json``), and ``press.toml`` says what was pressed. libcamera's tuning file is
read where one is given.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    AngleDeg,
    BadFrameError,
    ContactCircle,
    ImportFormatError,
    IndenterPose,
    LengthMm,
    Model,
    PixelLayout,
    TactileCapture,
    explain,
)
from data_schemas.storage import (
    FIRST_RED,
    LARGEST_TOML_BYTES,
    BayerOrder,
    parse_json,
    read_bytes,
    read_json,
    read_toml_tables,
    rggb_frame,
)
from finray_calib.radiometry import (
    CaptureSettings,
    LibcameraTuning,
    capture_settings,
    parse_tuning,
    processed_signal,
    raw_signal,
    require_same_settings,
    shading_gains,
)
from rigs.cameras import read_content, read_dng, read_picture, read_plain_counts

BitDepth = Literal[8, 10, 12, 14, 16]
BIT_DEPTHS: tuple[BitDepth, ...] = (8, 10, 12, 14, 16)
RAW_SUFFIXES = (".dng", ".tiff", ".tif")
PROCESSED_SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class RawImage:
    """Raw Bayer counts (H, W) with the order of the colours and the bits of a count."""

    counts: NDArray[np.uint16]
    order: BayerOrder
    bit_depth: BitDepth


@dataclass(frozen=True, slots=True)
class ProcessedImage:
    """Encoded red, green and blue (H, W, 3) of a PNG or JPEG."""

    codes: NDArray[np.uint8]
    compressed: bool


def read_image(path: Path, order: BayerOrder | None, bit_depth: BitDepth | None) -> RawImage | ProcessedImage:
    """Read one image.

    Parameters
    ----------
    path
        DNG, TIFF, PNG or JPEG.
    order, bit_depth
        Bayer order and bits of a 16-bit TIFF, which cannot tell them; a DNG says them itself.

    Raises
    ------
    ImportFormatError
        The file is unreadable, or what its values mean cannot be known.
    MissingExtraError
        A packed, compressed or coded DNG needs rawpy.
    """
    if path.suffix.lower() == ".dng":
        return _read_dng(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_bayer_tiff(path, order, bit_depth)
    bgr = read_picture(path, "a processed image (PNG, JPEG)", ImportFormatError)
    if bgr.dtype != np.uint8 or bgr.ndim != 3 or bgr.shape[2] != 3:
        raise ImportFormatError(
            f"{path}: a processed image must be an 8-bit colour PNG or JPEG, got {bgr.dtype} of shape {bgr.shape}"
        )
    return ProcessedImage(np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8), path.suffix.lower() != ".png")


def read_tuning(path: Path) -> LibcameraTuning:
    """Read a libcamera tuning file.

    Raises
    ------
    ImportFormatError
        The file is missing, is not JSON, or is no Raspberry Pi tuning.
    """
    content = read_bytes(
        path, "the tuning file of the camera (libcamera's .json)", ImportFormatError, LARGEST_TOML_BYTES
    )
    # libcamera's own parser allows a comma after the last entry, and shipped files have some.
    document = parse_json(re.sub(rb",(\s*+[}\]])", rb"\1", content), path, ImportFormatError)
    try:
        return parse_tuning(document)
    except ImportFormatError as error:
        raise ImportFormatError(f"{path}: {error}") from None


def _read_dng(path: Path) -> RawImage:
    """Read a DNG, which says the order of its colours and its bits."""
    try:
        image = read_dng(read_content(path), path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from error
    depths = [bits for bits in BIT_DEPTHS if 2**bits - 1 == image.white_dn]
    if not depths:
        raise ImportFormatError(
            f"{path}: a white level of {image.white_dn} DN is not supported; it must be 2^bits - 1 for {BIT_DEPTHS} "
            "bits"
        )
    return RawImage(image.counts, image.order, depths[0])


def _read_bayer_tiff(path: Path, order: BayerOrder | None, bit_depth: BitDepth | None) -> RawImage:
    """Read Bayer counts of a TIFF, which says neither the order of its colours nor its bits."""
    if order is None or bit_depth is None:
        raise ImportFormatError(
            f"{path}: the Bayer order and bit depth must be given, because a TIFF does not state them; add "
            "--bayer-order and --bit-depth, or use the DNG"
        )
    try:
        counts = read_plain_counts(path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from error
    if int(counts.max()) >= 2**bit_depth:
        raise ImportFormatError(
            f"{path}: contains values up to {counts.max()} DN, but {bit_depth} bits allow at most {2**bit_depth - 1} "
            "DN; correct --bit-depth"
        )
    return RawImage(counts, order, bit_depth)


Floats = NDArray[np.float64]
Counts = NDArray[np.uint16]
IMAGES = ("contact", "no_contact", "repeat_no_contact")
PRESS_NAME = "press.toml"
# Room below zero for noise (raw) and for colours outside the camera's gamut (processed).
PEDESTAL_DN = 1024
CLIPPED_DN = 65535


class PressDescription(Model):
    """What was pressed, where and how deep (``press.toml``)."""

    name: str
    indenter: IndenterPose
    light_angle_deg: AngleDeg | None = None
    contact_circle: ContactCircle | None = None
    mm_per_px: LengthMm | None = None


@dataclass(frozen=True, slots=True)
class RaspberryPiOptions:
    """How to read a folder.

    Attributes
    ----------
    tuning
        Tuning file of the camera; needed for processed images and for lens shading.
    undo_colour
        Undo colour matrix and white balance of processed images.
    flatten_shading
        Flatten the lens shading of raw images with the tuning's tables.
    bayer_order, bit_depth
        Of 16-bit TIFFs, which cannot tell them.
    """

    tuning: LibcameraTuning | None = None
    undo_colour: bool = False
    flatten_shading: bool = False
    bayer_order: BayerOrder | None = None
    bit_depth: BitDepth | None = None


@dataclass(frozen=True, slots=True)
class _Linear:
    """Images as they are stored: counts by name, and what they mean."""

    counts: dict[str, Counts]
    layout: PixelLayout
    bit_depth: BitDepth
    black_level_dn: float
    statement: str


def raspberry_pi_capture(folder: Path, options: RaspberryPiOptions) -> TactileCapture:
    """Read a folder of Raspberry Pi images of one press as a tactile capture with encoding "linear".

    Parameters
    ----------
    folder
        Holds the images, their metadata and ``press.toml``.
    options
        How to read them.

    Raises
    ------
    ImportFormatError
        A file is missing or unreadable, something was automatic or changed between the images, or the meaning of
        the values cannot be known.
    """
    press = _press(folder)
    paths = {name: path for name in IMAGES if (path := _image_path(folder, name)) is not None}
    for name in IMAGES[:2]:
        if name not in paths:
            raise ImportFormatError(
                f"{folder}: the image '{name}' ({', '.join((*RAW_SUFFIXES, *PROCESSED_SUFFIXES))}) is missing; a "
                "press needs 'contact' and 'no_contact'"
            )
    settings = {path.name: capture_settings(_metadata(path), path.name) for path in paths.values()}
    require_same_settings(settings)
    images = {name: read_image(path, options.bayer_order, options.bit_depth) for name, path in paths.items()}
    one = settings[paths["contact"].name]
    raw = {name: image for name, image in images.items() if isinstance(image, RawImage)}
    processed = {name: image for name, image in images.items() if isinstance(image, ProcessedImage)}
    if raw and processed:
        raise ImportFormatError(
            f"{folder}: contains both raw and processed images; give all images of one press in one format"
        )
    linear = _from_raw(raw, one, options, folder) if raw else _from_processed(processed, one, options, folder)
    circle = press.contact_circle
    if raw and circle is not None:
        row, column = FIRST_RED[raw["contact"].order]
        circle = circle.model_copy(update={"row_px": circle.row_px - row, "column_px": circle.column_px - column})
    return TactileCapture(
        name=press.name,
        contact=linear.counts["contact"],
        no_contact=linear.counts["no_contact"],
        repeat_no_contact=linear.counts.get("repeat_no_contact"),
        layout=linear.layout,
        encoding="linear",
        bit_depth=linear.bit_depth,
        black_level_dn=linear.black_level_dn,
        exposure_s=one.exposure_s,
        light_angle_deg=press.light_angle_deg,
        indenter=press.indenter,
        contact_circle=circle,
        mm_per_px=press.mm_per_px,
        source=f"Raspberry Pi folder '{folder.resolve().name}', analogue gain {one.analogue_gain_factor:g}: "
        + linear.statement,
    )


def _from_raw(
    raw: dict[str, RawImage], settings: CaptureSettings, options: RaspberryPiOptions, folder: Path
) -> _Linear:
    """Keep raw counts as they are where one black level tells all; else store the linear signal on 16 bits."""
    kinds = {(image.order, image.bit_depth, image.counts.shape) for image in raw.values()}
    if len(kinds) > 1:
        raise ImportFormatError(
            f"{folder}: the images differ in Bayer order, bits or size ({sorted(map(str, kinds))}); capture all "
            "images of a press with the same settings"
        )
    black_level_rel = settings.black_level_rel
    if black_level_rel is None and options.tuning is not None:
        black_level_rel = options.tuning.black_level_rel
    if black_level_rel is None:
        raise ImportFormatError(
            f"{folder}: neither metadata (SensorBlackLevels) nor a tuning file states the black level; give --tuning"
        )
    frames = {name: rggb_frame(image.counts, image.order) for name, image in raw.items()}
    bit_depth = raw["contact"].bit_depth
    gains = _gains(settings, options, frames["contact"].shape) if options.flatten_shading else None
    if gains is None and np.ptp(black_level_rel) == 0:
        counts = {name: frame[..., None] for name, frame in frames.items()}
        black_dn = float(black_level_rel[0]) * 2**bit_depth
        return _Linear(counts, "Bayer RGGB", bit_depth, black_dn, "raw counts, unchanged")
    signals = {n: raw_signal(f, bit_depth, black_level_rel, gains)[..., None] for n, f in frames.items()}
    flattened = "" if gains is None else ", lens shading flattened with the tuning's tables"
    return _Linear(_stored(signals), "Bayer RGGB", 16, PEDESTAL_DN, f"raw counts, black level removed{flattened}")


def _gains(settings: CaptureSettings, options: RaspberryPiOptions, shape: tuple[int, ...]) -> Floats:
    """Return the lens-shading gains of a frame."""
    if options.tuning is None or options.tuning.shading is None:
        raise ImportFormatError("flattening the lens shading needs a tuning file with rpi.alsc tables; give --tuning")
    if settings.temperature_k is None:
        raise ImportFormatError(
            "metadata: ColourTemperature is missing, but the lens-shading tables need it; leave out --flatten-shading"
        )
    return shading_gains(options.tuning.shading, settings.temperature_k, (shape[0], shape[1]))


def _from_processed(
    processed: dict[str, ProcessedImage], settings: CaptureSettings, options: RaspberryPiOptions, folder: Path
) -> _Linear:
    """Estimate linear light from processed images and say how well it is known."""
    if options.tuning is None:
        raise ImportFormatError(
            f"{folder}: the tone curve of processed images (PNG or JPEG) is unknown without the camera's tuning file; "
            "give --tuning, or capture raw (rpicam-still --raw)"
        )
    sizes = {image.codes.shape for image in processed.values()}
    if len(sizes) > 1:
        raise ImportFormatError(
            f"{folder}: the images differ in size ({sorted(sizes)}: rows, columns, channels); capture all images of a "
            "press with the same settings"
        )
    estimates = {
        name: processed_signal(image.codes, options.tuning, settings, options.undo_colour, image.compressed)
        for name, image in processed.items()
    }
    worst_rel = float(np.nanmax([e.typical_uncertainty_rel() for e in estimates.values()]))
    statement = (
        f"linear estimate from 8 bits, typical standard uncertainty {100 * worst_rel:.1f} % of the value; "
        + "; ".join(estimates["contact"].steps)
    )
    return _Linear(_stored({n: e.values_rel for n, e in estimates.items()}), "RGB", 16, PEDESTAL_DN, statement)


def _stored(signals: dict[str, Floats]) -> dict[str, Counts]:
    """Scale signals of one press by one factor to 16-bit counts on a pedestal; NaN becomes clipped."""
    largest = max(float(np.nanmax(signal, initial=0.0)) for signal in signals.values())
    scale = (CLIPPED_DN - 1 - PEDESTAL_DN) / (largest or 1.0)
    stored = {}
    for name, signal in signals.items():
        counts = np.clip(np.rint(PEDESTAL_DN + scale * signal), 0, CLIPPED_DN - 1)
        stored[name] = np.where(np.isnan(signal), CLIPPED_DN, counts).astype(np.uint16)
    return stored


def _image_path(folder: Path, name: str) -> Path | None:
    """Return the image of this name, or None; two of them are a mistake."""
    found = [p for s in (*RAW_SUFFIXES, *PROCESSED_SUFFIXES) if (p := folder / f"{name}{s}").is_file()]
    if len(found) > 1:
        names = " and ".join(p.name for p in found)
        raise ImportFormatError(
            f"{folder}: contains {names}, but only one image of each name is allowed; keep one of "
            "them, the raw one if there is one"
        )
    return found[0] if found else None


def _metadata(image: Path) -> dict[str, Any]:
    """Read the metadata beside an image."""
    path = image.with_suffix(".json")
    if not path.exists():
        raise ImportFormatError(
            f"{image}: the metadata file {path.name} is missing beside it, so it is unknown whether exposure and "
            "white balance were locked; write it with rpicam-still --metadata"
        )
    metadata = read_json(path, "what rpicam-still --metadata wrote", ImportFormatError)
    if not isinstance(metadata, dict):
        raise ImportFormatError(
            f"{path}: must be a JSON object with the metadata of an image; write it with rpicam-still --metadata"
        )
    return metadata


def _press(folder: Path) -> PressDescription:
    """Read what was pressed."""
    path = folder / PRESS_NAME
    if folder.is_file():
        raise ImportFormatError(f"{folder}: is a file; give the folder of one press, with its images and {PRESS_NAME}")
    if not path.exists():
        raise ImportFormatError(
            f"{path}: no such file; write it with a name and an [indenter] table (shape, radius_mm, depth_mm)"
        )
    table = read_toml_tables(path, "a TOML file with a name and an [indenter] table", ImportFormatError)
    if isinstance(table.get("indenter"), dict):
        table["indenter"] = {"depth_mm": None, "position_mm": None, **table["indenter"]}  # TOML has no null
    try:
        return PressDescription.model_validate(table)
    except ValidationError as error:
        raise ImportFormatError(f"{path}: {explain(error, PressDescription)}") from None
