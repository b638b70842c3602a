"""Raw Bayer counts of a DNG: plain ones by the TIFF reader, packed and compressed ones by LibRaw (rawpy)."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from data_schemas import BadFrameError, MissingExtraError
from data_schemas.storage import FIRST_RED, BayerOrder, parse_in_child, require_decoded_size

COLOUR_FILTER_ARRAY: Final = 32803
ORDER_OF_PATTERN: Final[dict[str, BayerOrder]] = {
    "".join(str("RGB".index(colour)) for colour in order): order for order in FIRST_RED
}


@dataclass(frozen=True, slots=True)
class DngImage:
    """What a DNG holds.

    Attributes
    ----------
    counts
        (H, W) raw counts (DN) of the active area.
    order
        Colours of its first 2 x 2 pixels, row by row.
    white_dn
        Count of full scale; 0 where the file does not say it.
    """

    counts: NDArray[np.uint16]
    order: BayerOrder
    white_dn: int


def read_dng(content: bytes, path: Path) -> DngImage:
    """Read the raw counts of a DNG; `path` says where `content` is from, for messages.

    Raises
    ------
    BadFrameError
        It is broken, holds no raw image, or one of another pattern than 2 x 2 Bayer.
    MissingExtraError
        It is packed or compressed, which needs rawpy.
    """
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            raw = [p for top in file.pages for p in (top, *(top.pages or ())) if p.photometric == COLOUR_FILTER_ARRAY]
            tags = raw[0].tags if raw else None
            plain = None if tags is None else _plain_counts(raw[0])
            pattern = b"" if tags is None else bytes(tags.valueof("CFAPattern", b""))
            white_dn = 0 if tags is None else int(np.ravel(tags.valueof("WhiteLevel", 0))[0])
    except Exception as error:  # of a broken file the TIFF reader raises nearly anything
        raise BadFrameError(f"{path}: cannot be read as DNG ({error}); is the file complete?") from error
    if tags is None:
        raise BadFrameError(f"{path}: holds no colour filter array (Bayer) image; is it a raw DNG?")
    counts, sites = (plain, list(pattern)) if plain is not None else _by_libraw(content, path)
    order = ORDER_OF_PATTERN.get("".join(map(str, sites)))
    if order is None or counts.ndim != 2:
        raise BadFrameError(
            f"{path}: Bayer pattern {sites} of an image of shape {counts.shape} is not understood; known are "
            f"{', '.join(FIRST_RED)} (red 0, green 1, blue 2)"
        )
    return DngImage(counts, order, white_dn)


def _plain_counts(page: Any) -> NDArray[np.uint16] | None:
    """Return the active area of an uncompressed page of one or two whole bytes a count; None of another."""
    require_decoded_size(page)
    if page.compression != 1 or page.bitspersample not in (8, 16) or np.dtype(page.dtype).kind != "u":
        return None
    counts = np.asarray(page.asarray(), dtype=np.uint16)
    top, left, bottom, right = page.tags.valueof("ActiveArea") or (0, 0, *counts.shape[:2])
    return counts[top:bottom, left:right]


def _by_libraw(content: bytes, path: Path) -> tuple[NDArray[np.uint16], list[int]]:
    """Return counts and the colours of the first 2 x 2 pixels (red 0, green 1, blue 2)."""
    try:
        import rawpy  # the child needs it; without it there is no need for one
    except ImportError as error:
        raise MissingExtraError(
            f"{path}: reading a packed or compressed DNG needs rawpy ({error}); install it with pip install "
            "'finray-calib[dng]'"
        ) from None
    del rawpy
    value, arrays = parse_in_child(f"{__name__}:unpacked_dng", content, path, "DNG", BadFrameError)
    return arrays["counts"], list(value)


def unpacked_dng(content: bytes, where: str) -> tuple[list[int], dict[str, NDArray[np.uint16]]]:
    """Decode a packed or compressed DNG by LibRaw; it runs in a child process, for LibRaw is C++ and files lie."""
    import rawpy

    try:
        with rawpy.imread(io.BytesIO(content)) as raw:
            counts = np.array(raw.raw_image_visible, dtype=np.uint16)
            colours = raw.color_desc.decode()  # "RGBG": LibRaw tells the two greens apart
            sites = ["RGB".find(colours[site]) for site in np.ravel(raw.raw_colors_visible[:2, :2])]
    except (rawpy.LibRawError, ValueError, TypeError) as error:
        raise BadFrameError(f"{where}: cannot be read as DNG ({error}); is the file complete?") from error
    return sites, {"counts": counts}
