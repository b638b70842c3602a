"""Figure of the panel's angle: brightness of the probes over it, with and without the mirror. PNG bytes."""

import numpy as np
from matplotlib.axes import Axes

from data_schemas.illumination import LightAngleIntensity
from finray_calib.reports.illumination_pictures import BAND_TITLES, DOTS_PER_INCH, LED_BAND
from finray_calib.reports.style import BLUE, CHANNELS, INK, MUTED, ORANGE, VERMILLION, new_figure, png_bytes, styled

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
    return png_bytes(figure, DOTS_PER_INCH)


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
