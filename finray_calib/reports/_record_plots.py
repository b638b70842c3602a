"""The drawing of each kind of record, for its method ``plot()``; notebooks show it, ``save`` stores it.

Drawings that have a page of their own are made beside it. Those of the paper's studies are made here: its emitter, two
lights, the light's angle, and its paints beside ours. Pictures of an illumination study have one row for each light or
level: what the camera sees, each band with contact.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from data_schemas import (
    BandFit,
    BandSignals,
    FingerDesign,
    FluorescentRendering,
    ForceComparison,
    LightAngleDecision,
    LightAngleIntensity,
    LightAngleSweep,
    MaterialFit,
    PaintCalibration,
    PaintMap,
    PaintStandIn,
    PaperPaints,
    PhotometricErrorReport,
    Record,
    RecordError,
    SimulatedPress,
    TactileCapture,
    TwoLights,
)
from data_schemas.storage import FIRST_RED, given_path, write_bytes, writing
from finray_calib.reports._comparison_figures import force_figure_png, material_fit_png, score_figure
from finray_calib.reports._finger_pictures import finger_png
from finray_calib.reports._fit_figures import draw_emission, paint_map_figure
from finray_calib.reports._images import display_white, png_bytes, to_display
from finray_calib.reports._style import (
    BLUE,
    CHANNELS,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    legend_above,
    new_figure,
    styled,
    svg_text,
)
from finray_calib.reports._style import png_bytes as figure_bytes


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
        file = given_path(path, "path")
        if file.suffix != self.suffix:
            raise RecordError(
                f"{file}: the name must end in {self.suffix}, because this drawing is {self.suffix[1:].upper()}"
            )
        with writing(file):
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
        raise RecordError(f"a record of the kind {type(record).__name__} cannot be drawn; these kinds can: {kinds}")
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
    axes.set(xlabel="centre of the filter (nm)", ylabel="fluorescence / white (1)")
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


_LEVEL_TITLES = {
    "a": "paper, as printed:\nproportional to distance",
    "a_inverse_square": "paper's idea,\ninverse square of distance",
    "b": "default: walls emit what\narriving light excites",
}
_LEVEL_LINES = {"a": (MUTED, "--"), "a_inverse_square": (ORANGE, "-."), "b": (INK, "-")}
_HEADROOM = 1.45


@styled()
def fluorescent_rendering_png(study: FluorescentRendering) -> bytes:
    """Draw the images of all levels, and below what their walls emit."""
    figure = new_figure(13.5, 9.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.75, 1.0), squeeze=False)[:, 0]
    last = len(study.levels) - 1
    draw_pictures(above, study, [_LEVEL_TITLES[level] for level in study.levels], [last] * len(study.levels), last)
    _wall_panels(below, study)
    explain_pictures(figure, study)
    return figure_bytes(figure, DOTS_PER_INCH)


def _wall_panels(figure: SubFigure, study: FluorescentRendering) -> None:
    """Draw emission of both walls along z at all levels, the red one at other angles, and the errors of the images."""
    panels = figure.subplots(1, 4)
    for w, wall in enumerate(study.walls):
        axes, scale = panels[w], study.wall_radiance_rel[-1, w].mean()
        for k, level in enumerate(study.levels):
            colour, dashes = _LEVEL_LINES[level]
            axes.plot(study.z_mm, study.wall_radiance_rel[k, w] / scale, dashes, color=colour,
                      label=_LEVEL_TITLES[level].split(":")[0].replace("\n", " "))  # fmt: skip
        axes.plot(
            study.z_mm, study.second_order_rel[w] / scale, ":", color=BLUE, label="part of it that other paint excites"
        )
        axes.set(title=f"{wall} wall emits", xlabel="z along, from the base (mm)")
        axes.set_ylim(0, _HEADROOM * float(study.wall_radiance_rel[:, w].max() / scale))
    panels[0].set_ylabel("relative to the baked mean")
    panels[0].legend(loc="upper right", fontsize=8)
    _angle_panel(panels[2], study)
    _error_panel(panels[3], study)


def _angle_panel(axes: Axes, study: FluorescentRendering) -> None:
    """Draw the baked emission of the red wall for several light angles."""
    shades = (SKY, BLUE, INK, ORANGE, VERMILLION)
    reference = study.wall_radiance_rel[-1, 0].mean()
    for k, angle in enumerate(study.angles_deg):
        axes.plot(study.z_mm, study.wall_by_angle_rel[k, 0] / reference, color=shades[k % len(shades)],
                  linestyle=("-", "--", "-.", ":", (0, (5, 1, 1, 1)))[k % 5], label=f"{angle:g} deg")  # fmt: skip
    axes.set(title="baked red wall by light angle", xlabel="z along, from the base (mm)", ylim=(0, None))
    axes.legend(loc="upper right", fontsize=8)


def _error_panel(axes: Axes, study: FluorescentRendering) -> None:
    """Draw how far the paper's emitter is from the bake in the image of the coat."""
    rows = [d for d in study.differences if d.state == "contact" and d.band != LED_BAND]
    names = [f"{d.band}, {'as printed' if d.level == 'a' else '1/d²'}" for d in rows]
    heights = [100.0 * d.shape_error_rel for d in rows]
    axes.bar(names, heights, color=[BAND_COLOURS[d.band] for d in rows],
             hatch=["" if d.level == "a" else "//" for d in rows], edgecolor="white")  # fmt: skip
    for k, (d, height) in enumerate(zip(rows, heights, strict=True)):
        axes.plot([k - 0.4, k + 0.4], 2 * [100.0 * d.noise_rel], color=INK, linewidth=1.5)
        axes.text(k, height, f"{height:.0f} %", ha="center", va="bottom", fontsize=9)
    axes.set(title=f"error on the coat, {study.block_px} px blocks\n(equal means; line: render noise)", ylabel="%")
    axes.tick_params(axis="x", labelrotation=30)
    axes.grid(visible=False, axis="x")


@styled()
def two_lights_png(study: TwoLights) -> bytes:
    """Draw the images with one panel and with two, and below how even the light is."""
    figure = new_figure(13.5, 8.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.25, 1.0), squeeze=False)[:, 0]
    draw_pictures(above, study, [name.replace(", ", ",\n") for name in study.lights], (0, 1), 0)
    _evenness_panels(below, study)
    explain_pictures(figure, study)
    return figure_bytes(figure, DOTS_PER_INCH)


def _evenness_panels(figure: SubFigure, study: TwoLights) -> None:
    """Draw each band along the pad with one panel and two, and the variation over the coat."""
    *along, variation = figure.subplots(1, 4)
    for axes, band in zip(along, study.bands, strict=False):
        k = study.channels.index(band)
        for name, dashes, values in zip(study.lights, ("--", "-"), study.along_rel, strict=True):
            axes.semilogy(study.z_mm, values[k], dashes, color=BAND_COLOURS[band], label=name)
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set(title=f"{BAND_TITLES[band]} along the pad", xlabel="z along, from the base (mm)")
        axes.legend(loc="best", fontsize=8)
    along[0].set_ylabel("mean over the width, relative to the\nmean with one panel (log scale)")
    _variation_panel(variation, study)


def _variation_panel(axes: Axes, study: TwoLights) -> None:
    """Draw the variation of each band over the whole coat and its middle, with one panel and two."""
    width = 0.2
    of = {(u.lights, u.channel): u for u in study.uniformity}
    for n, (name, hatch) in enumerate(zip(study.lights, ("", "//"), strict=True)):
        for m, (part, alpha) in enumerate((("variation_rel", 0.45), ("middle_variation_rel", 1.0))):
            at = np.arange(len(study.bands)) + (2 * m + n - 1.5) * width
            axes.bar(at, [getattr(of[name, b], part) for b in study.bands], width, hatch=hatch, alpha=alpha,
                     color=[BAND_COLOURS[b] for b in study.bands], edgecolor="white",
                     label=f"{name.split(',')[0]}, {('whole coat', 'middle 70 %')[m]}")  # fmt: skip
    axes.set_xticks(np.arange(len(study.bands)), [BAND_TITLES[b].split(" ")[0] for b in study.bands])
    axes.set(title="variation over the coat (sd / mean)\npale: whole coat, full: middle 70 %;\nhatched: two panels")
    axes.grid(visible=False, axis="x")


_FIRST_BAR, _NEXT_BAR, _TOP = 1.05, 0.07, 1.2


@styled()
def light_angle_png(study: LightAngleIntensity) -> bytes:
    """Draw the brightness of both probes over the light angle: blue light above, painted bands below."""
    figure = new_figure(11.5, 8.2)
    panels = figure.subplots(2, len(study.probes), sharex=True, sharey="row")
    for p, probe in enumerate(study.probes):
        x, y, z = study.probe_points_mm[p]
        panels[0, p].set_title(f"{probe}\n(x = {x:g}, y = {y:.1f}, z = {z:.1f} mm)", loc="left", fontweight="bold")
        _blue_panel(panels[0, p], study, p)
        _paint_panel(panels[1, p], study, p)
        panels[1, p].set_xlabel("light angle: panel's normal from the pad plane (deg)")
    panels[0, 0].set_ylabel("blue light,\nrelative to each curve's highest")
    panels[1, 0].set_ylabel("painted bands with mirror,\nrelative to each curve's highest")
    for axes in (*panels[0], panels[1, 0]):
        axes.legend(loc="lower left")
    figure.supxlabel(
        f"{study.design.name}; panel's centre {study.led_depth_mm:g} mm below the inner face; its normal is along the "
        "pad at 0 deg and away from it below. Lines: means; small marks: single repeats.\n"
        "Bars above: where the smooth curve through a mean is highest, with 95 % limits (jackknife over "
        f"{study.radiance_rel.shape[2]} repeats of {study.samples} paths).",
        x=0.01, ha="left", fontsize=9,
    )  # fmt: skip
    return figure_bytes(figure, DOTS_PER_INCH)


def _blue_panel(axes: Axes, study: LightAngleIntensity, probe: int) -> None:
    """Draw blue light over the angle with and without mirror, the analytic cosine, and the maxima."""
    led = study.bands.index(LED_BAND)
    for m, (mirror, colour, marker) in enumerate(zip(study.mirrors, (BLUE, ORANGE), ("o", "s"), strict=True)):
        _curve(axes, study, (m, probe, led), colour, marker, mirror, _FIRST_BAR + _NEXT_BAR * m)
    fine = np.linspace(study.angles_deg[0], study.angles_deg[-1], 241)
    elevation = study.elevation_deg[probe]
    axes.plot(fine, np.maximum(np.cos(np.radians(fine - elevation)), 0.0), ":", color=INK,
              label=f"direct light alone: cos(angle - {elevation:.0f} deg)")  # fmt: skip
    axes.axvline(
        study.printed_angle_deg,
        color=VERMILLION,
        linewidth=1.2,
        linestyle="--",
        label=f"paper: best at {study.printed_angle_deg:g} deg",
    )
    axes.axvline(90.0, color=MUTED, linewidth=0.8, label="panel faces straight into the pad")
    axes.set_ylim(0, _TOP)


def _paint_panel(axes: Axes, study: LightAngleIntensity, probe: int) -> None:
    """Draw the painted bands over the angle, with the mirror."""
    for n, (band, marker, colour) in enumerate(CHANNELS[:2]):
        _curve(
            axes,
            study,
            (0, probe, study.bands.index(band)),
            colour,
            marker,
            BAND_TITLES[band],
            _FIRST_BAR + _NEXT_BAR * n,
        )
    axes.axvline(study.printed_angle_deg, color=VERMILLION, linewidth=1.2, linestyle="--")
    axes.set_ylim(0, _TOP)


def _curve(
    axes: Axes,
    study: LightAngleIntensity,
    which: tuple[int, int, int],
    colour: str,
    marker: str,
    label: str,
    height: float,
) -> None:
    """Draw mean and repeats of one curve over its highest value, and its maximum with limits at a height above it."""
    mirror, probe, band = which
    values = study.radiance_rel[mirror, :, :, probe, band]
    mean = values.mean(axis=1)
    axes.plot(study.angles_deg, values / mean.max(), marker, color=colour, markersize=2.2, alpha=0.4)
    axes.plot(study.angles_deg, mean / mean.max(), "-", color=colour, marker=marker, markersize=4, label=label)
    names = study.mirrors[mirror], study.probes[probe], study.bands[band]
    top = next(t for t in study.maxima if (t.mirror, t.probe, t.band) == names)
    axes.plot([top.low95_deg, top.high95_deg], [height, height], color=colour, linewidth=3)
    axes.plot(top.angle_deg, height, "|", color=colour, markersize=9, markeredgewidth=2)
    axes.text(top.high95_deg + 2, height, f"{top.angle_deg:.0f} deg", color=colour, fontsize=9, va="center",
              bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8}, zorder=5)  # fmt: skip


PERCENT = 100.0
BAND_NM = 10.0
EMISSION_SHOWN_NM = (460.0, 740.0)
ABSORPTION_SHOWN_NM = (340.0, 780.0)
PRINTED_BAND_PERCENT = (2.0, 5.0)
RESOLUTION_DPI = 110
ABSORPTION_HEADROOM = 1.75
SHIFT_HEIGHT = 0.77
LINE_HEIGHT = 0.07
_TITLES = (
    "What it emits under a {laser:.0f} nm laser",
    "What it absorbs (photons), relative to {laser:.0f} nm",
)
_WHY = (
    "Why they differ: eight bands do not determine an emission between and beyond them. The paper's curve is "
    "taken to be exact, and its 95 % band is far too\nnarrow; our model lets the paint differ from its curve "
    "by a stated amount. 2 to 5 % is one 10 nm band, not all emitted light. Absorption is a plateau: where "
    "its\nmaximum lies, and with it the Stokes shift, is ill-defined, and one laser does not measure it "
    "(grey). Stand-ins, not the paper's own paints."
)


@styled()
def paper_paints_png(study: PaperPaints) -> bytes:
    """Draw emission (left) and absorption (right) of every stand-in and return the bytes of a PNG image.

    Equal records give equal bytes: the image holds no date and no version.
    """
    figure = new_figure(11.5, 3.3 * len(study.stand_ins) + 1.9)
    panels = figure.subplots(len(study.stand_ins), 2, squeeze=False)
    for (left, right), paint in zip(panels, study.stand_ins, strict=True):
        _emission_panel(left, paint)
        _absorption_panel(right, paint, study.laser_nm)
        name = paint.material.replace("_", " ")
        left.set_ylabel(f"{name}\n(stands for the {paint.colour} paint)\n\nradiance factor per 10 nm (%)")
        right.set_ylabel("absorption (1 at the laser)")
    for axes, title in zip(panels[0], _TITLES, strict=True):
        axes.set_title(title.format(laser=study.laser_nm), loc="left", fontweight="bold")
    for axes in panels[-1]:
        axes.set_xlabel("wavelength (nm)")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    figure.legend(*panels[0, 1].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    figure.supxlabel(_WHY, x=0.01, ha="left", fontsize=9)
    return figure_bytes(figure, RESOLUTION_DPI)


def _emission_panel(axes: Axes, paint: PaintStandIn) -> None:
    """Draw the measured emission, what the eight filters see of it, and both fits to those bands."""
    low, high = PRINTED_BAND_PERCENT
    axes.axhspan(low, high, facecolor=ORANGE, alpha=0.25, linewidth=0, label="paper: reradiation 2 to 5 %")
    per_band = PERCENT * BAND_NM
    measured = paint.emission
    axes.plot(measured.wavelength_nm, per_band * measured.values, "o", color=INK, markersize=3.5, label="measured")
    axes.plot(
        [float(nm) for nm in paint.filter_bands],
        [PERCENT * value for value in paint.filter_bands.values()],
        "s",
        markersize=9,
        markerfacecolor="none",
        markeredgecolor=INK,
        label="what the filters see",
    )
    _posterior(axes, paint.paper_fit, VERMILLION, "--", "paper's curve from the filters, 95 %")
    _posterior(axes, paint.our_fit, BLUE, "-", "ours from the filters, 95 %")
    highest = max(measured.values.max(), paint.paper_fit.mean_per_nm.max(), paint.our_fit.high95_per_nm.max())
    axes.set(xlim=EMISSION_SHOWN_NM, ylim=(0, 1.35 * max(per_band * float(highest), high)))
    _mark_location(axes, paint.paper_fit)
    lines = (
        (VERMILLION, f"paper: {_judged(paint.paper_fit)}"),
        (BLUE, f"ours: {_judged(paint.our_fit)}"),
        (INK, f"all emitted light: {PERCENT * paint.energy_yield:.0f} % of the energy"),
    )
    _write(axes, lines)


def _posterior(axes: Axes, fit: BandFit, colour: str, dashes: str, label: str) -> None:
    """Draw the mean and the 95 % band of a fit to the filter bands."""
    scale = PERCENT * BAND_NM
    axes.fill_between(
        fit.wavelength_nm, scale * fit.low95_per_nm, scale * fit.high95_per_nm, color=colour, alpha=0.25, linewidth=0
    )
    axes.plot(fit.wavelength_nm, scale * fit.mean_per_nm, dashes, color=colour, label=label)


def _judged(fit: BandFit) -> str:
    """Say how far a fit is off and whether it knows."""
    error, held = PERCENT * fit.residual_rel, PERCENT * fit.covered_share
    return f"error {error:.0f} %, its 95 % band holds {held:.0f} % of the measured"


def _write(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    """Write lines of (colour, text) into the upper right corner."""
    for row, (colour, text) in enumerate(lines):
        height = 0.97 - LINE_HEIGHT * row
        axes.text(0.98, height, text, transform=axes.transAxes, ha="right", va="top", fontsize=9, color=colour)


def _mark_location(axes: Axes, fit: BandFit) -> None:
    """Mark the paper's lambda_0, which is called the peak, on the wavelength axis."""
    location_nm = fit.parameters["location_nm"].estimate
    axes.plot(
        [location_nm, location_nm],
        [0, 0.12],
        color=VERMILLION,
        linewidth=2.5,
        transform=axes.get_xaxis_transform(),
        label=r"paper's $\lambda_0$, called the peak",
    )


def _absorption_panel(axes: Axes, paint: PaintStandIn, laser_nm: float) -> None:
    """Draw the measured absorption, our bands from one and from several lights, and the paper's maximum."""
    several, one = paint.several_lights, paint.one_laser
    lights = ", ".join(f"{nm:.0f}" for nm in sorted(several.measured_at_nm))
    axes.fill_between(
        one.excitation_nm, one.low95, one.high95, facecolor=HAIRLINE, alpha=0.8, linewidth=0,
        label="ours, 95 %: the laser alone (prior)",
    )  # fmt: skip
    axes.fill_between(
        several.excitation_nm, several.low95, several.high95, facecolor=SKY, alpha=0.5, edgecolor=BLUE,
        linestyle=":", label=f"ours, 95 %: {lights} nm",
    )  # fmt: skip
    measured = paint.absorption
    axes.plot(measured.wavelength_nm, measured.values, "o", color=INK, markersize=3.5, label="measured")
    emission = paint.emission.values / paint.emission.values.max()
    axes.plot(paint.emission.wavelength_nm, emission, ":", color=GREEN, label="its emission, scaled")
    axes.axvline(laser_nm, color=MUTED, linewidth=1.0)
    top = ABSORPTION_HEADROOM * max(1.0, float(measured.values.max()))
    axes.set(xlim=ABSORPTION_SHOWN_NM, ylim=(0, top))
    axes.text(laser_nm - 3, 0.02 * top, "laser", color=MUTED, fontsize=9, ha="right", va="bottom")
    _printed_shift(axes, paint, SHIFT_HEIGHT * top)


def _printed_shift(axes: Axes, paint: PaintStandIn, height: float) -> None:
    """Draw the printed Stokes shift as an arrow from the emission's peak to where the paper puts the absorption's."""
    peak_nm, shift_nm = paint.emission_peak_nm, paint.printed_stokes_shift_nm
    axes.annotate(
        "",
        (peak_nm - shift_nm, height),
        (peak_nm, height),
        arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0},
    )
    axes.plot([], [], color=VERMILLION, label="paper: Stokes shift")
    axes.axvline(peak_nm - shift_nm, ymax=SHIFT_HEIGHT, color=VERMILLION, linewidth=1.0, linestyle="--")
    low, high = paint.stokes_shift_low_nm, paint.stokes_shift_high_nm
    lines = (
        (VERMILLION, f"paper: Stokes shift {shift_nm:.0f} nm"),
        (INK, f"measured: {paint.stokes_shift_nm:.0f} nm"),
        (INK, f"({low:.0f} to {high:.0f} nm if counted from an end of the absorption plateau)"),
    )
    _write(axes, lines)


_DRAWINGS: Mapping[type[Record], Callable[[Any], str | bytes]] = {
    BandSignals: _bands,
    FingerDesign: finger_png,
    FluorescentRendering: fluorescent_rendering_png,
    ForceComparison: force_figure_png,
    LightAngleDecision: _decision,
    LightAngleIntensity: light_angle_png,
    LightAngleSweep: _sweep,
    MaterialFit: material_fit_png,
    PaintCalibration: lambda fit: draw_emission(fit).svg,
    PaintMap: paint_map_figure,
    PaperPaints: paper_paints_png,
    PhotometricErrorReport: score_figure,
    SimulatedPress: _press,
    TactileCapture: _capture,
    TwoLights: two_lights_png,
}
