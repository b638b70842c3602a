"""Drawing of a finger design: cut along its middle and seen from its front, with the camera's view below."""

from pathlib import Path

from matplotlib.figure import Figure, SubFigure

from data_schemas.design import FingerDesign
from finray_calib.reports.camera_view_figure import draw_camera_view_on
from finray_calib.reports.finger_front_view import draw_front
from finray_calib.reports.finger_outline import FingerOutline, finger_outline
from finray_calib.reports.finger_side_view import draw_side
from finray_calib.reports.style import new_figure, png_bytes, styled
from sim.experiments.camera_view import CameraView

_PAGE_IN, _CAMERA_VIEW_IN = 11.0, 4.8
# titles and axes of both views
_TITLES_IN = 2.0


@styled()
def finger_page_png(view: CameraView, folder: Path | None = None) -> bytes:
    """Return the drawing of a finger with its camera's view below, as PNG bytes.

    Without the folder where the design stands, the mesh of an indenter is not drawn.

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    finger = finger_outline(view.design, folder)
    figure = new_figure(_PAGE_IN, finger.views_in + _TITLES_IN + _CAMERA_VIEW_IN)
    rows = figure.add_gridspec(2, 1, height_ratios=(finger.views_in + _TITLES_IN, _CAMERA_VIEW_IN))
    _draw_finger(figure.add_subfigure(rows[0]), finger)
    draw_camera_view_on(figure.add_subfigure(rows[1]), view)
    return png_bytes(figure)


@styled()
def finger_png(design: FingerDesign, folder: Path | None = None) -> bytes:
    """Return the drawing of a finger as PNG bytes: cut along its middle, and from its front, on one scale.

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    finger = finger_outline(design, folder)
    figure = new_figure(_PAGE_IN, finger.views_in + _TITLES_IN)
    _draw_finger(figure, finger)
    return png_bytes(figure)


def _draw_finger(figure: Figure | SubFigure, finger: FingerOutline) -> None:
    """Draw both views of a finger."""
    low, high = finger.side_mm
    side, front = figure.subplots(2, 1, sharex=True, height_ratios=(high - low, 2.0 * finger.front_mm))
    ends, inch = finger.bounds_mm, finger.inch_mm
    side.set(xlim=(ends[0][2] - 0.8 * inch, ends[1][2] + inch), ylim=(low, high))
    front.set_ylim(-finger.front_mm, finger.front_mm)
    draw_side(side, finger)
    draw_front(front, finger)
    figure.suptitle(f"{finger.design.name} (mm): z along the pad from its base, y along its outward normal, x across")
    for axes in (side, front):
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.tick_params(labelbottom=True)
