"""Pictures of an illumination study, one row for each light or level: what the camera sees, each band with contact."""

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from data_schemas.illumination import FluorescentRendering, TwoLights
from finray_calib.reports.images import display_white, to_display
from finray_calib.reports.style import BLUE, GREEN, VERMILLION

BAND_TITLES = {"red": "red emission", "green": "green emission", "led": "blue light (LED)"}
BAND_COLOURS = {"red": VERMILLION, "green": GREEN, "led": BLUE}
LED_BAND = "led"
DOTS_PER_INCH = 110
_BRIGHT_PERCENTILE = 99.0
_MEDIAN_PX = 3
_ABOUT_PICTURES = (
    "{name}. Pictures: base at the left, tip at the right; camera pictures white-balanced; bands as the square root of "
    "radiance, one scale per column;\n3 x 3 px median against render noise, for the eye only (numbers are from the "
    "images themselves)."
)


def draw_pictures(
    figure: SubFigure,
    study: FluorescentRendering | TwoLights,
    titles: Sequence[str],
    balanced_by: Sequence[int],
    scaled_by: int,
) -> None:
    """Draw the camera's pictures without and with contact, and each band with contact, in one row per title.

    Parameters
    ----------
    figure
        Where to draw.
    study
        Holds the images, one alternative for each row.
    titles
        Beside the rows.
    balanced_by
        Row that each row's camera pictures are white-balanced by.
    scaled_by
        Row whose brightness scales each column of bands.
    """
    panels = figure.subplots(len(titles), 2 + len(study.bands))
    for row, title in enumerate(titles):
        _camera_images(panels[row, :2], study, row, balanced_by[row])
        for axes, band in zip(panels[row, 2:], study.bands, strict=True):
            _band_image(axes, study, row, scaled_by, band)
        panels[row, 0].set_ylabel(title, rotation=0, ha="right", va="center")
    columns = ["camera, no contact", "camera, contact", *(f"{BAND_TITLES[band]}, contact" for band in study.bands)]
    for axes, column in zip(panels[0], columns, strict=True):
        axes.set_title(column, fontweight="bold")


def explain_pictures(figure: Figure, study: FluorescentRendering | TwoLights) -> None:
    """Say below the figure how to read its pictures."""
    figure.supxlabel(_ABOUT_PICTURES.format(name=study.design.name), x=0.01, ha="left", fontsize=9)


def _camera_images(
    panels: NDArray[np.object_], study: FluorescentRendering | TwoLights, row: int, balanced_by: int
) -> None:
    """Draw the camera's pictures without and with contact, white-balanced by the coat without contact of one row."""
    matrix = study.camera_matrix
    white = display_white((study.no_contact_bands[balanced_by] @ matrix.T)[study.on_coat])
    for axes, bands in zip(panels, (study.no_contact_bands[row], study.contact_bands[row]), strict=True):
        _picture(axes)
        axes.imshow(to_display(_calm(bands) @ matrix.T, white, linear=True))


def _band_image(axes: Axes, study: FluorescentRendering | TwoLights, row: int, scaled_by: int, band: str) -> None:
    """Draw one band with contact, on the scale of one row."""
    k = study.bands.index(band)
    brightest = np.percentile(study.contact_bands[scaled_by, ..., k][study.on_coat], _BRIGHT_PERCENTILE)
    _picture(axes)
    axes.imshow(
        np.sqrt(np.clip(_calm(study.contact_bands[row])[..., k] / brightest, 0.0, 1.0)), cmap="inferno", vmin=0, vmax=1
    )


def _calm(bands: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return bands without single bright pixels."""
    return np.stack([cv2.medianBlur(np.ascontiguousarray(b), _MEDIAN_PX) for b in np.moveaxis(bands, -1, 0)], axis=-1)


def _picture(axes: Axes) -> None:
    """Take ticks and frame away."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.grid(visible=False)
