"""Figures of the paper's optical experiments: emitter of the walls, second panel, angle of the panel. PNG bytes."""

import io

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from data_schemas.illumination import FluorescentRendering, LightAngleIntensity, TwoLights
from finray_calib.reports.images import display_white, to_display
from finray_calib.reports.style import (
    BLUE,
    CHANNELS,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    new_figure,
    styled,
)

Floats = NDArray[np.float64]

LEVEL_TITLES = {
    "a": "paper, as printed:\nproportional to distance",
    "a_inverse_square": "paper's idea,\ninverse square of distance",
    "b": "baked: walls emit what\narriving light excites",
}
BAND_TITLES = {"red": "red emission", "green": "green emission", "led": "blue light (LED)"}
BAND_COLOURS = {"red": VERMILLION, "green": GREEN, "led": BLUE}
_LEVEL_LINES = {"a": (MUTED, "--"), "a_inverse_square": (ORANGE, "-."), "b": (INK, "-")}
_DOTS_PER_INCH = 110
_BRIGHT_PERCENTILE = 99.0
_LED = "led"
_MEDIAN_PX = 3
_HEADROOM = 1.45
_FIRST_BAR, _NEXT_BAR, _TOP = 1.05, 0.07, 1.2
_ABOUT_PICTURES = (
    "{name}. Pictures: base at the left, tip at the right; camera pictures white-balanced; bands as the square root of "
    "radiance, one scale per column;\n3 x 3 px median against render noise, for the eye only (numbers are from the "
    "images themselves)."
)


@styled()
def fluorescent_rendering_png(study: FluorescentRendering) -> bytes:
    """Draw the images of all levels, and below what their walls emit."""
    figure = new_figure(13.5, 9.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.75, 1.0), squeeze=False)[:, 0]
    panels = above.subplots(len(study.levels), 5)
    for row, level in enumerate(study.levels):
        _camera_images(panels[row, :2], study, row, len(study.levels) - 1)
        for axes, band in zip(panels[row, 2:], study.bands, strict=True):
            _band_image(axes, study, row, len(study.levels) - 1, band)
        panels[row, 0].set_ylabel(LEVEL_TITLES[level], rotation=0, ha="right", va="center")
    _column_titles(panels[0], ["camera, no contact", "camera, contact", *_contact_titles(study.bands)])
    _wall_panels(below, study)
    _about(figure, study)
    return _png(figure)


@styled()
def two_lights_png(study: TwoLights) -> bytes:
    """Draw the images with one panel and with two, and below how even the light is."""
    figure = new_figure(13.5, 8.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.25, 1.0), squeeze=False)[:, 0]
    panels = above.subplots(2, 5)
    for row, name in enumerate(study.lights):
        _camera_images(panels[row, :2], study, row, row)
        for axes, band in zip(panels[row, 2:], study.bands, strict=True):
            _band_image(axes, study, row, 0, band)
        panels[row, 0].set_ylabel(name.replace(", ", ",\n"), rotation=0, ha="right", va="center")
    _column_titles(panels[0], ["camera, no contact", "camera, contact", *_contact_titles(study.bands)])
    _evenness_panels(below, study)
    _about(figure, study)
    return _png(figure)


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
    return _png(figure)


def _about(figure: Figure, study: FluorescentRendering | TwoLights) -> None:
    """Say below the figure how to read its pictures."""
    figure.supxlabel(_ABOUT_PICTURES.format(name=study.design.name), x=0.01, ha="left", fontsize=9)


def _contact_titles(bands: tuple[str, ...]) -> list[str]:
    """Return the titles of the columns of bands."""
    return [f"{BAND_TITLES[band]}, contact" for band in bands]


def _column_titles(panels: NDArray[np.object_], titles: list[str]) -> None:
    """Put titles over the first row of images."""
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontweight="bold")


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


def _wall_panels(figure: SubFigure, study: FluorescentRendering) -> None:
    """Draw emission of both walls along z at all levels, the red one at other angles, and the errors of the images."""
    panels = figure.subplots(1, 4)
    for w, wall in enumerate(study.walls):
        axes, scale = panels[w], study.wall_radiance_rel[-1, w].mean()
        for k, level in enumerate(study.levels):
            colour, dashes = _LEVEL_LINES[level]
            axes.plot(study.z_mm, study.wall_radiance_rel[k, w] / scale, dashes, color=colour,
                      label=LEVEL_TITLES[level].split(":")[0].replace("\n", " "))  # fmt: skip
        axes.plot(study.z_mm, study.second_order_rel[w] / scale, ":", color=BLUE, label="of it, excited by other paint")
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
    rows = [d for d in study.differences if d.state == "contact" and d.band != _LED]
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


def _evenness_panels(figure: SubFigure, study: TwoLights) -> None:
    """Draw each band along the pad with one panel and two, and the variation over the coat."""
    panels = figure.subplots(1, 4)
    for axes, band in zip(panels, study.bands, strict=False):
        k = study.channels.index(band)
        for name, dashes, values in zip(study.lights, ("--", "-"), study.along_rel, strict=True):
            axes.semilogy(study.z_mm, values[k], dashes, color=BAND_COLOURS[band], label=name)
        axes.set(title=f"{BAND_TITLES[band]} along the pad", xlabel="z along, from the base (mm)")
        axes.legend(loc="best", fontsize=8)
    panels[0].set_ylabel("mean over the width, relative to the\nmean with one panel (log scale)")
    width, axes = 0.2, panels[3]
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


def _blue_panel(axes: Axes, study: LightAngleIntensity, probe: int) -> None:
    """Draw blue light over the angle with and without mirror, the analytic cosine, and the maxima."""
    led = study.bands.index(_LED)
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


def _png(figure: Figure) -> bytes:
    """Return the bytes of a figure; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()
