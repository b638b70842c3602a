"""The drawing of each kind of record, for its method ``plot()``; notebooks show it, ``save`` stores it."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_schemas import (
    BandSignals,
    FingerDesign,
    FluorescentRendering,
    ForceComparison,
    LightAngleDecision,
    LightAngleIntensity,
    LightAngleSweep,
    PaintCalibration,
    PaintMap,
    PaperPaints,
    PhotometricErrorReport,
    Record,
    RecordError,
    SimulatedPress,
    TactileCapture,
    TwoLights,
)
from data_schemas.storage import FIRST_RED, write_bytes
from finray_calib.reports._comparison_figures import force_figure_png, score_figure
from finray_calib.reports._finger_pictures import finger_png
from finray_calib.reports._fit_figures import draw_emission, paint_map_figure
from finray_calib.reports._images import display_white, png_bytes, to_display
from finray_calib.reports._study_figures import (
    fluorescent_rendering_png,
    light_angle_png,
    paper_paints_png,
    two_lights_png,
)
from finray_calib.reports._style import BLUE, CHANNELS, SKY, legend_above, new_figure, styled, svg_text


@dataclass(frozen=True, slots=True)
class RecordPlot:
    """A drawing of a record; a notebook shows it.

    Attributes
    ----------
    content
        The file: SVG text or PNG, in bytes.
    suffix
        ".svg" or ".png".
    """

    content: bytes
    suffix: str

    def __repr__(self) -> str:
        return f"a drawing ({self.suffix[1:].upper()}); save(path) stores it, a notebook shows it"

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        if self.suffix == ".svg":
            return {"image/svg+xml": self.content.decode("utf-8")}
        return {"image/png": self.content}

    def save(self, path: "str | Path") -> Path:
        """Store the drawing in a new file and return its path.

        Raises
        ------
        RecordError
            The file exists already, or its name does not end as the drawing needs it.
        """
        file = Path(path)
        if file.suffix != self.suffix:
            raise RecordError(
                f"{file}: this drawing is {self.suffix[1:].upper()}; choose a name that ends in {self.suffix}"
            )
        write_bytes(file, self.content)
        return file


def plot_record(record: Record) -> RecordPlot:
    """Return the drawing of a record.

    Raises
    ------
    RecordError
        There is no drawing of this kind; the message lists those that there are.
    """
    draw = _DRAWINGS.get(type(record))
    if draw is None:
        kinds = ", ".join(sorted(kind.__name__ for kind in _DRAWINGS))
        raise RecordError(f"there is no drawing of a {type(record).__name__}; there are drawings of {kinds}")
    drawn = draw(record)
    return RecordPlot(drawn.encode(), ".svg") if isinstance(drawn, str) else RecordPlot(drawn, ".png")


@styled()
def _bands(bands: BandSignals) -> str:
    """Draw the fluorescence of each filter and channel with twice its standard uncertainty."""
    figure = new_figure(5.4, 3.5)
    axes = figure.subplots()
    centers_nm = [band.center_nm for band in bands.optics.filters]
    sd = np.sqrt(np.diag(bands.fluorescence_covariance)).reshape(bands.fluorescence.shape)
    for column, (name, marker, colour) in enumerate(CHANNELS):
        place = np.add(centers_nm, 2.0 * (column - 1))
        shown = bands.usable()[:, column]
        values, bars = bands.fluorescence[shown, column], 2.0 * sd[shown, column]
        axes.errorbar(place[shown], values, bars, fmt=marker, color=colour, label=name)
    axes.set(xlabel="centre of the filter (nm)", ylabel="fluorescence over white (1)")
    legend_above(figure, axes, 3)
    return svg_text(figure)


@styled()
def _sweep(sweep: LightAngleSweep) -> str:
    """Draw every repeat of the objective over the angle, and their mean."""
    figure = new_figure(5.4, 3.5)
    axes = figure.subplots()
    axes.plot(sweep.angles_deg, sweep.values, color=SKY, linewidth=0.8)
    axes.plot(sweep.angles_deg, sweep.values.mean(axis=1), color=BLUE, marker="o", label="mean of the repeats")
    axes.set(xlabel="angle of the light (deg)", ylabel="objective (1)")
    legend_above(figure, axes, 1)
    return svg_text(figure)


@styled()
def _decision(decision: LightAngleDecision) -> str:
    """Draw the curve that was decided on with its 95 % band, and the angle."""
    figure = new_figure(5.4, 3.5)
    axes = figure.subplots()
    axes.fill_between(decision.grid_deg, decision.low95, decision.high95, color=SKY, alpha=0.35, label="95 % band")
    axes.plot(decision.grid_deg, decision.mean, color=BLUE, label="expected")
    axes.axvline(decision.angle_deg, color="black", linestyle="--", label=f"decided: {decision.angle_deg:.0f} deg")
    axes.set(xlabel="angle of the light (deg)", ylabel="objective (1)")
    legend_above(figure, axes, 3)
    return svg_text(figure)


def _press(press: SimulatedPress) -> bytes:
    """Return the image without and with contact side by side, as a screen shows it."""
    pair = np.concatenate([press.no_contact, press.contact], axis=1)
    white = display_white(press.no_contact[np.isfinite(press.distance)])
    return png_bytes(to_display(pair, white, linear=press.encoding == "linear"))


def _capture(capture: TactileCapture) -> bytes:
    """Return the image without and with contact side by side; of a Bayer frame one pixel for each square of four."""
    pair = [_rgb(image, capture) for image in (capture.no_contact, capture.contact)]
    white = display_white(pair[0].reshape(-1, 3))
    return png_bytes(to_display(np.concatenate(pair, axis=1), white, linear=capture.encoding == "linear"))


def _rgb(image: np.ndarray[Any, Any], capture: TactileCapture) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the (H, W, 3) values of a capture above its black level."""
    values = np.maximum(image.astype(np.float64) - (capture.black_level_dn or 0.0), 0.0)
    order = re.sub("Bayer ", "", capture.layout)
    if order not in FIRST_RED:
        return values[..., ::-1] if order == "BGR" else np.broadcast_to(values, (*values.shape[:2], 3))
    row, column = FIRST_RED[order]
    frame = values[..., 0]
    green = 0.5 * (frame[row::2, 1 - column :: 2] + frame[1 - row :: 2, column::2])
    return np.stack([frame[row::2, column::2], green, frame[1 - row :: 2, 1 - column :: 2]], axis=2)


_DRAWINGS: Mapping[type[Record], Callable[[Any], str | bytes]] = {
    BandSignals: _bands,
    FingerDesign: finger_png,
    FluorescentRendering: fluorescent_rendering_png,
    ForceComparison: force_figure_png,
    LightAngleDecision: _decision,
    LightAngleIntensity: light_angle_png,
    LightAngleSweep: _sweep,
    PaintCalibration: lambda fit: draw_emission(fit).svg,
    PaintMap: paint_map_figure,
    PaperPaints: paper_paints_png,
    PhotometricErrorReport: score_figure,
    SimulatedPress: _press,
    TactileCapture: _capture,
    TwoLights: two_lights_png,
}
