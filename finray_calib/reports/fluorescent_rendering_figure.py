"""Figure of the emitter of the painted walls: the paper's rules beside what arriving light excites. PNG bytes."""

from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from data_schemas.illumination import FluorescentRendering
from finray_calib.reports.illumination_pictures import (
    BAND_COLOURS,
    DOTS_PER_INCH,
    LED_BAND,
    draw_pictures,
    explain_pictures,
)
from finray_calib.reports.style import BLUE, INK, MUTED, ORANGE, SKY, VERMILLION, new_figure, png_bytes, styled

_LEVEL_TITLES = {
    "a": "paper, as printed:\nproportional to distance",
    "a_inverse_square": "paper's idea,\ninverse square of distance",
    "b": "baked: walls emit what\narriving light excites",
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
    return png_bytes(figure, DOTS_PER_INCH)


def _wall_panels(figure: SubFigure, study: FluorescentRendering) -> None:
    """Draw emission of both walls along z at all levels, the red one at other angles, and the errors of the images."""
    panels = figure.subplots(1, 4)
    for w, wall in enumerate(study.walls):
        axes, scale = panels[w], study.wall_radiance_rel[-1, w].mean()
        for k, level in enumerate(study.levels):
            colour, dashes = _LEVEL_LINES[level]
            axes.plot(study.z_mm, study.wall_radiance_rel[k, w] / scale, dashes, color=colour,
                      label=_LEVEL_TITLES[level].split(":")[0].replace("\n", " "))  # fmt: skip
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
