"""Where the contacts of imported presses are: a picture of all of them to check, and a list of circles to correct."""

import csv
import io
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import TactileCapture

Bytes = NDArray[np.uint8]
THUMBNAIL_PX = 240
MOST_SHOWN = 200
_COLUMNS = 7
_WHITE, _DARK = (255, 255, 255), (0, 0, 0)


def contacts_png(captures: Mapping[str, TactileCapture]) -> bytes:
    """Return thumbnails of the presses with their circle or outline as a PNG picture.

    Parameters
    ----------
    captures
        Name of the press -> capture; the first 200 are shown.
    """
    tiles = [_thumbnail(name, capture) for name, capture in list(captures.items())[:MOST_SHOWN]]
    height = max(tile.shape[0] for tile in tiles)
    columns = min(_COLUMNS, len(tiles))
    sheet = np.full((-(-len(tiles) // columns) * height, columns * THUMBNAIL_PX, 3), 255, np.uint8)
    for i, tile in enumerate(tiles):
        top, left = i // columns * height, i % columns * THUMBNAIL_PX
        sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    return cv2.imencode(".png", np.ascontiguousarray(sheet[..., ::-1]))[1].tobytes()


def circles_csv(captures: Mapping[str, TactileCapture]) -> str:
    """Return the circles of the presses, a line each: image, column_px, row_px, radius_px."""
    text = io.StringIO(newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("image", "column_px", "row_px", "radius_px"))
    for name, capture in captures.items():
        circle = capture.contact_circle
        if circle is not None:
            table.writerow((name, *(f"{v:.4g}" for v in (circle.column_px, circle.row_px, circle.radius_px))))
    return text.getvalue()


def _thumbnail(name: str, capture: TactileCapture) -> Bytes:
    """Return a small picture of a press with its contact and its name."""
    counts = capture.contact.astype(np.float64)
    top = np.maximum(np.percentile(counts, 99.5), 1.0)
    # values of light are shown as an eye sees them
    shown = np.clip(counts / top, 0.0, 1.0) ** (0.45 if capture.encoding == "linear" else 1.0)
    picture = np.repeat(shown, 3, axis=2) if shown.shape[2] == 1 else shown
    scale = THUMBNAIL_PX / picture.shape[1]
    size = (THUMBNAIL_PX, max(1, round(scale * picture.shape[0])))
    tile = np.ascontiguousarray(
        np.rint(255.0 * cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), dtype=np.uint8
    )
    circle, outline = capture.contact_circle, capture.contact_outline
    if circle is not None:
        centre = (round(scale * circle.column_px), round(scale * circle.row_px))
        for colour, width in ((_DARK, 3), (_WHITE, 1)):
            cv2.circle(tile, centre, max(1, round(scale * circle.radius_px)), colour, width, cv2.LINE_AA)
    elif outline is not None:
        corners = np.array([[[round(scale * p.column_px), round(scale * p.row_px)]] for p in outline], np.int32)
        for colour, width in ((_DARK, 3), (_WHITE, 1)):
            cv2.polylines(tile, [corners], True, colour, width, cv2.LINE_AA)
    for colour, width in ((_DARK, 3), (_WHITE, 1)):
        cv2.putText(tile, name[-34:], (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, width, cv2.LINE_AA)
    return tile
