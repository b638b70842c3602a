"""A folder of Raspberry Pi images of one press becomes a tactile capture.

The folder holds ``contact``, ``no_contact`` and, if there is one, ``repeat_no_contact``: all raw (DNG as
``rpicam-still --raw`` writes it, or 16-bit TIFF) or all processed (8-bit PNG or JPEG). Beside each image lies its
metadata under the same name (``contact.json``), and ``press.toml`` says what was pressed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas.bayer import FIRST_RED, BayerOrder, rggb_frame
from data_schemas.capture import ContactCircle, IndenterPose, PixelLayout, TactileCapture
from data_schemas.errors import ImportFormatError
from data_schemas.faults import explain
from data_schemas.foreign_files import read_json, read_toml_tables
from data_schemas.model import Model
from data_schemas.units import AngleDeg, LengthMm
from finray_calib.exchange.raspberry_pi_images import (
    PROCESSED_SUFFIXES,
    RAW_SUFFIXES,
    BitDepth,
    ProcessedImage,
    RawImage,
    read_image,
)
from finray_calib.radiometry.lens_shading import shading_gains
from finray_calib.radiometry.libcamera_tuning import LibcameraTuning
from finray_calib.radiometry.raspberry_pi import processed_signal, raw_signal
from finray_calib.radiometry.raspberry_pi_settings import CaptureSettings, capture_settings, require_same_settings

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
class ImportOptions:
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


def tactile_capture(folder: Path, options: ImportOptions) -> TactileCapture:
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
                f"{folder}: holds no image '{name}' ({', '.join((*RAW_SUFFIXES, *PROCESSED_SUFFIXES))}); a press needs "
                "'contact' and 'no_contact'"
            )
    settings = {path.name: capture_settings(_metadata(path), path.name) for path in paths.values()}
    require_same_settings(settings)
    images = {name: read_image(path, options.bayer_order, options.bit_depth) for name, path in paths.items()}
    one = settings[paths["contact"].name]
    raw = {name: image for name, image in images.items() if isinstance(image, RawImage)}
    processed = {name: image for name, image in images.items() if isinstance(image, ProcessedImage)}
    if raw and processed:
        raise ImportFormatError(f"{folder}: mixes raw and processed images; give all of one press in one format")
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


def _from_raw(raw: dict[str, RawImage], settings: CaptureSettings, options: ImportOptions, folder: Path) -> _Linear:
    """Keep raw counts as they are where one black level tells all; else store the linear signal on 16 bits."""
    kinds = {(image.order, image.bit_depth, image.counts.shape) for image in raw.values()}
    if len(kinds) > 1:
        raise ImportFormatError(f"{folder}: its images differ in Bayer order, bits or size: {sorted(map(str, kinds))}")
    black_level_rel = settings.black_level_rel
    if black_level_rel is None and options.tuning is not None:
        black_level_rel = options.tuning.black_level_rel
    if black_level_rel is None:
        raise ImportFormatError(
            f"{folder}: neither metadata (SensorBlackLevels) nor a tuning file says the black level; give --tuning"
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


def _gains(settings: CaptureSettings, options: ImportOptions, shape: tuple[int, ...]) -> Floats:
    """Return the lens-shading gains of a frame."""
    if options.tuning is None or options.tuning.shading is None:
        raise ImportFormatError("flattening the lens shading needs a tuning file with rpi.alsc tables; give --tuning")
    if settings.temperature_k is None:
        raise ImportFormatError("metadata: has no ColourTemperature, which the lens-shading tables need")
    return shading_gains(options.tuning.shading, settings.temperature_k, (shape[0], shape[1]))


def _from_processed(
    processed: dict[str, ProcessedImage], settings: CaptureSettings, options: ImportOptions, folder: Path
) -> _Linear:
    """Estimate linear light from processed images and say how well it is known."""
    if options.tuning is None:
        raise ImportFormatError(
            f"{folder}: its images are processed (PNG or JPEG), so their encoding cannot be known without the tuning "
            "file that the camera used; give --tuning, or capture raw (rpicam-still --raw)"
        )
    sizes = {image.codes.shape for image in processed.values()}
    if len(sizes) > 1:
        raise ImportFormatError(f"{folder}: its images differ in size: {sorted(sizes)} (rows, columns, channels)")
    estimates = {
        name: processed_signal(image.codes, options.tuning, settings, options.undo_colour, image.compressed)
        for name, image in processed.items()
    }
    worst_rel = float(np.nanmax([e.typical_uncertainty_rel() for e in estimates.values()]))
    statement = f"linear estimate from 8 bits, typical standard uncertainty {worst_rel:.1%} of the value; " + "; ".join(
        estimates["contact"].steps
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
        raise ImportFormatError(f"{folder}: holds {names}; keep one image of each name, raw if there is one")
    return found[0] if found else None


def _metadata(image: Path) -> dict[str, Any]:
    """Read the metadata beside an image."""
    path = image.with_suffix(".json")
    if not path.exists():
        raise ImportFormatError(
            f"{image}: has no metadata beside it ({path.name}), so nothing says whether exposure and white balance "
            "were locked; write it with rpicam-still --metadata"
        )
    metadata = read_json(path, "what rpicam-still --metadata wrote", ImportFormatError)
    if not isinstance(metadata, dict):
        raise ImportFormatError(f"{path}: is a {type(metadata).__name__}; metadata is one JSON object per image")
    return metadata


def _press(folder: Path) -> PressDescription:
    """Read what was pressed."""
    path = folder / PRESS_NAME
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
