"""Pictures of presses: where the contacts of a set are, with a list of circles to correct, and what a press senses."""

import csv
import io

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import SensedPress, TactileCapture
from finray_calib.reports._images import with_outline
from finray_calib.reports._style import new_figure, png_bytes, styled

Bytes = NDArray[np.uint8]
THUMBNAIL_PX = 240
MOST_SHOWN = 200
_COLUMNS = 7
_WHITE, _DARK = (255, 255, 255), (0, 0, 0)


class ContactSheet:
    """Small pictures of presses with their contact, and their circles, added one press after the other."""

    def __init__(self) -> None:
        self._tiles: list[Bytes] = []
        self._rows: list[tuple[str, ...]] = []

    def add(self, name: str, capture: TactileCapture) -> None:
        """Add a press; the first 200 are shown."""
        if len(self._tiles) < MOST_SHOWN:
            self._tiles.append(_thumbnail(name, capture))
        circle = capture.contact_circle
        if circle is not None:
            numbers = (f"{v:.4g}" for v in (circle.column_px, circle.row_px, circle.radius_px))
            self._rows.append((name, *numbers, capture.contact_told_by or "label"))

    def png(self) -> bytes:
        """Return the pictures as one PNG picture."""
        height = max(tile.shape[0] for tile in self._tiles)
        columns = min(_COLUMNS, len(self._tiles))
        sheet = np.full((-(-len(self._tiles) // columns) * height, columns * THUMBNAIL_PX, 3), 255, np.uint8)
        for i, tile in enumerate(self._tiles):
            top, left = i // columns * height, i % columns * THUMBNAIL_PX
            sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
        return cv2.imencode(".png", np.ascontiguousarray(sheet[..., ::-1]))[1].tobytes()

    def circles_csv(self) -> str:
        """Return the circles, a line each: image, column_px, row_px, radius_px, told_by."""
        text = io.StringIO(newline="")
        table = csv.writer(text, lineterminator="\n")
        table.writerows([("image", "column_px", "row_px", "radius_px", "told_by"), *self._rows])
        return text.getvalue()


def _thumbnail(name: str, capture: TactileCapture) -> Bytes:
    """Return a small picture of a press with its contact and its name."""
    picture = _shown(capture.contact.astype(np.float64), capture)
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


def _shown(values: NDArray[np.float64], capture: TactileCapture) -> NDArray[np.float64]:
    """Return values (H, W, 1 or 3) as an eye sees them, (H, W, 3), 0 to 1."""
    top = max(float(np.nanpercentile(values, 99.5)), 1e-9)
    shown = np.clip(np.nan_to_num(values, nan=top) / top, 0.0, 1.0) ** (0.45 if capture.encoding == "linear" else 1.0)
    return np.repeat(shown, 3, axis=2) if shown.shape[2] == 1 else shown


def sensed_png(sensed: SensedPress, capture: TactileCapture) -> bytes:
    """Return capture, normals and depth of a sensed press, each with the outline of its contact, as a PNG picture."""
    touched = sensed.contact.astype(np.bool_)
    rows, columns = touched.shape
    counts = capture.contact.astype(np.float64)
    seen = cv2.resize(_shown(counts, capture), (columns, rows), interpolation=cv2.INTER_AREA)
    normal = np.asarray(np.rint(255.0 * (0.5 + 0.5 * sensed.normal)), dtype=np.uint8)
    width_mm, height_mm = columns * sensed.mm_per_px, rows * sensed.mm_per_px
    extent = (0.0, width_mm, height_mm, 0.0)
    with styled():
        figure = new_figure(11.0, 0.9 + 3.3 * height_mm / width_mm)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for at, image, title in zip(
            axes[:2],
            (np.asarray(np.rint(255.0 * seen), dtype=np.uint8), normal),
            ("capture", "normal"),
            strict=True,
        ):
            at.imshow(with_outline(image, touched), extent=extent)
            at.set_title(title)
        drawn = axes[2].imshow(sensed.depth_mm, extent=extent, cmap="viridis")
        axes[2].contour(touched, levels=[0.5], colors="white", linewidths=1.2, extent=extent, origin="upper")
        axes[2].set_title("depth" if sensed.depth_u_mm is None else f"depth, u = {sensed.depth_u_mm:.2g} mm at a pixel")
        figure.colorbar(drawn, ax=axes[2], label="mm into the gel")
        axes[0].set_ylabel("mm")
        for at in axes:
            at.set_xlabel("mm")
            at.grid(visible=False)
        return png_bytes(figure)
