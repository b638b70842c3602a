"""The page of a camera: quantities of EMVA Standard 1288 with expanded uncertainty, three figures, methods, limits."""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraCharacterisation, ChannelCharacterisation, Estimate, Resolvable, significant
from finray_calib.radiometry import sensitivity_threshold_e
from finray_calib.reports._methods import methods_part
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Light,
    Part,
    ReportPage,
    ReportTable,
    drawing,
    findings_section,
    light_of,
    limits_section,
    one_group,
    provenance_table,
    report_html,
)
from finray_calib.reports._plain_text import Json, percent, plain
from finray_calib.reports._style import CHANNELS, MUTED, legend_above, new_figure, styled, svg_text

Floats = NDArray[np.float64]
COVERAGE_FACTOR: Final = 2.0
LARGEST_LINEARITY_ERROR_REL: Final = 0.01
SMALLEST_CHI_SQUARE_P: Final = 1e-3
DECIBELS: Final = 20.0 / math.log(10.0)
"""Of a factor: decibels for each unit of its natural logarithm."""


def camera_page(camera: CameraCharacterisation) -> str:
    """Return the page of a camera as self-contained HTML.

    Parameters
    ----------
    camera
        A characterisation; one that was stored names its files at the end of the page.
    """
    verdict, light, sentence = _verdict(camera)
    origin = camera.provenance
    return report_html(
        ReportPage(
            verb="finray radiometry",
            title=camera.camera_name,
            lead="The camera by photon transfer, with the quantities of EMVA Standard 1288, release 4.0, that need no "
            "calibrated light source.",
            verdict=verdict,
            light=light,
            sentence=sentence,
            picture=drawing(photon_transfer_svg(camera), *_TRANSFER_WORDS),
            key_numbers=_key_numbers(camera),
            parts=(
                *findings_section((*_findings(camera), *camera.warnings)),
                Part("Quantities", Content(_UNCERTAINTY, tables=(_quantities(camera),), has_wide_tables=True)),
                Part("Figures", Content(picture_rows=((
                    drawing(snr_svg(camera), *_SNR_WORDS, is_small=True),
                    drawing(linearity_svg(camera), *_LINEARITY_WORDS, is_small=True),
                ),))),
                limits_section(_limits(camera), camera.notes),
                Part("Exposures", Content(tables=tuple(map(_levels, camera.channels))), is_detail=True),
                methods_part(_methods(camera), origin),
            ),
            command="" if origin is None else origin.command,
            origin=None if origin is None else provenance_table(origin),
            summary=_summary(camera),
        )
    )  # fmt: skip


_UNCERTAINTY: Final = (
    f"The number after \u00b1 is the expanded uncertainty U = {COVERAGE_FACTOR:g} u (coverage factor k = "
    f"{COVERAGE_FACTOR:g}, about 95 %). Where a quantity cannot be distinguished from zero, its upper limit with 95 % "
    f"confidence is given instead."
)
_TRANSFER_WORDS: Final = (
    "Temporal variance of a pixel against its mean above the dark mean, for every channel, with the line whose slope "
    "is the system gain.",
    "Photon transfer. Filled marks: exposures used for the line, up to 70 % of saturation. What to see: these marks "
    "lie on the line, and the variance falls where the channel saturates.",
)
_SNR_WORDS: Final = (
    "Signal-to-noise ratio of one pixel against its charge, for every channel, beside the linear camera model and an "
    "ideal sensor without noise of its own.",
    "Signal-to-noise ratio of one pixel. Grey line: the camera model; dashed: a sensor without noise of its own.",
)
_LINEARITY_WORDS: Final = (
    "Deviation of the signal from a line through exposure, in per cent, for every channel, with the band of the lamp's "
    "repeatability.",
    "Deviation from linearity, 5 to 95 % of saturation. Grey band: how well the light of one frame repeats (one "
    "standard deviation).",
)


def _verdict(camera: CameraCharacterisation) -> tuple[str, Light, str]:
    """Return whether the linear camera model holds, its light, and a sentence."""
    bent = [c.channel for c in camera.channels if c.chi_square_p < SMALLEST_CHI_SQUARE_P]
    if bent:
        return "The camera model does not hold", "bad", (
            f"The noise of {_listed(bent)} does not grow with the signal as that of photons does; read the "
            "findings below."
        )  # fmt: skip
    grows = "The noise of every channel grows with the signal as that of photons does"
    if _findings(camera) or camera.warnings:
        return "The camera model holds, with remarks", "care", f"{grows}; read the findings below."
    return "The camera model holds", "good", f"{grows}, and the signal with the exposure."


def _findings(camera: CameraCharacterisation) -> tuple[str, ...]:
    """Return what the record does not warn of itself."""
    return tuple(
        f"{c.channel}: the signal departs from a line through exposure by {percent(c.linearity_error_rel.estimate)} on "
        f"average, more than {percent(LARGEST_LINEARITY_ERROR_REL)}: switch off any gamma of the camera, or use lower "
        "counts"
        for c in camera.channels
        if _is_bent(c)
    )


def _is_bent(channel: ChannelCharacterisation) -> bool:
    error = channel.linearity_error_rel
    return error.resolved and error.estimate > LARGEST_LINEARITY_ERROR_REL


def _listed(names: Sequence[str]) -> str:
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"


def _key_numbers(camera: CameraCharacterisation) -> tuple[KeyNumber, ...]:
    """Return gain and dark noise of the channel with most pixels, and the largest linearity error."""
    main = max(camera.channels, key=lambda c: c.pixels)
    worst = max(camera.channels, key=lambda c: c.linearity_error_rel.estimate)
    fits = main.chi_square_p >= SMALLEST_CHI_SQUARE_P
    gain, noise, error = system_gain(main), main.read_noise_e, worst.linearity_error_rel
    bent = f"{100 * error.estimate:.2g}" if error.resolved else expanded(error, 100.0)
    return (
        KeyNumber("System gain K", f"{gain.estimate:.4g} DN/e", f"{main.channel}: {expanded(gain)} DN/e",
                  light_of(fits), "from a line that fits" if fits else "the line does not fit"),
        KeyNumber("Temporal dark noise", f"{noise.estimate:.3g} e" if noise.resolved else f"{expanded(noise)} e",
                  f"{main.channel}: {expanded(noise)} e, without rounding", light_of(noise.resolved),
                  "resolved" if noise.resolved else "rounding hides it"),
        KeyNumber("Linearity error", f"{bent} %",
                  f"{worst.channel}, the largest: {expanded(error, 100.0)} %",
                  light_of(not _is_bent(worst)), f"limit {percent(LARGEST_LINEARITY_ERROR_REL)}"),
    )  # fmt: skip


def system_gain(channel: ChannelCharacterisation) -> Estimate:
    """Return the system gain of the standard (DN/e), the reciprocal of the record's."""
    gain = channel.gain_e_per_dn
    return _scaled(gain, 1.0 / gain.estimate**2, 1.0 / gain.estimate)


def _scaled(value: Estimate, factor: float, estimate: float) -> Estimate:
    """Return an estimate whose ends lie as far from it as those of another, times a factor."""
    low, high = (factor * (value.estimate - value.low95), factor * (value.high95 - value.estimate))
    sd = factor * value.sd
    return Estimate(estimate=estimate, sd=sd, low68=estimate - sd, high68=estimate + sd,
                    low95=estimate - low, high95=estimate + high)  # fmt: skip


def expanded(value: Estimate | None, factor: float = 1.0) -> str:
    """Return a value with its expanded uncertainty, two digits of it; an upper limit where it is not resolved."""
    if value is None:
        return "not reached"
    if isinstance(value, Resolvable) and not value.resolved:
        return f"below {factor * value.high95:.2g}"
    uncertainty = factor * COVERAGE_FACTOR * value.sd
    decimals = max(1 - math.floor(math.log10(uncertainty)), 0) if uncertainty > 0 else 4
    return f"{factor * value.estimate:.{decimals}f} \u00b1 {uncertainty:.{decimals}f}"


def _told(value: Estimate | None, factor: float, name: str) -> str:
    """Return a quantity of the table; one that an older version did not take is "not measured"."""
    return "not measured" if value is None and name in OF_LINES else expanded(value, factor)


def in_decibels(value: Estimate | None) -> Estimate | None:
    """Return a ratio in decibels."""
    if value is None:
        return None
    return _scaled(value, DECIBELS / value.estimate, DECIBELS * math.log(value.estimate))


def _threshold(channel: ChannelCharacterisation) -> Estimate:
    return sensitivity_threshold_e(channel.gain_e_per_dn, channel.read_noise_dn)


def dsnu_e(channel: ChannelCharacterisation) -> Resolvable:
    """Return the dark signal non-uniformity in electrons."""
    gain, dsnu = channel.gain_e_per_dn, channel.dsnu_dn
    factor = gain.estimate
    sd = math.hypot(factor * dsnu.sd, dsnu.estimate * gain.sd)
    estimate = factor * dsnu.estimate

    def away(end: str) -> float:
        of_dsnu, of_gain = (getattr(value, end) - value.estimate for value in (dsnu, gain))
        return math.hypot(factor * of_dsnu, dsnu.estimate * of_gain)

    ends = {end: max(estimate - away(end), 0.0) if end.startswith("low") else estimate + away(end)
            for end in ("low68", "high68", "low95", "high95")}  # fmt: skip
    return Resolvable(estimate=estimate, sd=sd, resolved=dsnu.resolved, **ends)


Quantity = Callable[[ChannelCharacterisation], Estimate | None]
QUANTITIES: Final[tuple[tuple[str, str, str, Quantity, float], ...]] = (
    ("System gain K", "DN/e", "system_gain_dn_per_e", system_gain, 1.0),
    ("Its reciprocal", "e/DN", "gain_e_per_dn", lambda c: c.gain_e_per_dn, 1.0),
    ("Temporal dark noise, without rounding", "e", "dark_noise_e", lambda c: c.read_noise_e, 1.0),
    ("The same in counts", "DN", "dark_noise_dn", lambda c: c.read_noise_dn, 1.0),
    ("Dark level at exposure zero", "DN", "black_level_dn", lambda c: c.black_level_dn, 1.0),
    ("Dark current, from the mean", "e/s", "dark_current_e_per_s", lambda c: c.dark_current_e_per_s, 1.0),
    ("Count at saturation", "DN", "saturation_dn", lambda c: c.saturation_dn, 1.0),
    ("Saturation capacity", "e", "saturation_capacity_e", lambda c: c.full_well_e, 1.0),
    ("Absolute sensitivity threshold", "e", "sensitivity_threshold_e", _threshold, 1.0),
    ("Largest signal-to-noise ratio", "", "snr_max", lambda c: c.snr_max, 1.0),
    ("The same in decibels", "dB", "snr_max_db", lambda c: in_decibels(c.snr_max), 1.0),
    ("Dynamic range", "", "dynamic_range", lambda c: c.dynamic_range, 1.0),
    ("The same in decibels", "dB", "dynamic_range_db", lambda c: in_decibels(c.dynamic_range), 1.0),
    ("Linearity error, 5 to 95 % of saturation", "%", "linearity_error_percent",
     lambda c: c.linearity_error_rel, 100.0),
    ("DSNU", "DN", "dsnu_dn", lambda c: c.dsnu_dn, 1.0),
    ("The same in electrons", "e", "dsnu_e", dsnu_e, 1.0),
    ("DSNU of rows", "DN", "dsnu_rows_dn", lambda c: c.dsnu_rows_dn, 1.0),
    ("DSNU of columns", "DN", "dsnu_columns_dn", lambda c: c.dsnu_columns_dn, 1.0),
    ("DSNU of pixels", "DN", "dsnu_pixels_dn", lambda c: c.dsnu_pixels_dn, 1.0),
    ("PRNU from pixel to pixel, high-pass", "%", "prnu_percent", lambda c: c.prnu_rel, 100.0),
    ("PRNU from row to row, high-pass", "%", "prnu_rows_percent", lambda c: c.prnu_rows_rel, 100.0),
    ("PRNU from column to column, high-pass", "%", "prnu_columns_percent", lambda c: c.prnu_columns_rel, 100.0),
    ("Non-uniformity with lamp, lens and tile", "%", "flat_nonuniformity_percent",
     lambda c: c.flat_nonuniformity_rel, 100.0),
)  # fmt: skip
"""What it is, unit, name in the page's data, where it comes from, and factor to the unit."""
OF_LINES: Final = frozenset(
    ("dsnu_rows_dn", "dsnu_columns_dn", "dsnu_pixels_dn", "prnu_rows_percent", "prnu_columns_percent")
)
"""What records of an older version lack."""


def _quantities(camera: CameraCharacterisation) -> ReportTable:
    """List every quantity of every channel."""
    rows = [
        (words if not unit else f"{words} ({unit})", *(_told(found(c), factor, name) for c in camera.channels))
        for words, unit, name, found, factor in QUANTITIES
    ]
    rows += [
        ("Lowest and highest deviation from linearity (%)",
         *(f"{100 * c.linearity_lowest_rel:+.2f} to {100 * c.linearity_highest_rel:+.2f}" for c in camera.channels)),
        ("Pixels", *(str(c.pixels) for c in camera.channels)),
        ("Chi-square of the line, degrees of freedom",
         *(f"{c.chi_square:.1f}, {c.degrees_of_freedom}" for c in camera.channels)),
    ]  # fmt: skip
    columns = ("quantity", *(c.channel for c in camera.channels))
    return one_group("Every quantity with its expanded uncertainty", columns, rows)


def _summary(camera: CameraCharacterisation) -> Json:
    """Return every number of the page."""

    def numbers(value: Estimate | None, factor: float) -> Json | None:
        if value is None:
            return None
        told = {"estimate": factor * value.estimate, "expanded_uncertainty": factor * COVERAGE_FACTOR * value.sd,
                "low95": factor * value.low95, "high95": factor * value.high95}  # fmt: skip
        return {**told, "resolved": value.resolved} if isinstance(value, Resolvable) else told

    channels = {
        c.channel: {name: numbers(found(c), factor) for _, _, name, found, factor in QUANTITIES}
        for c in camera.channels
    }
    rest = {"camera": camera.camera_name, "filter": camera.filter_name, "coverage_factor": COVERAGE_FACTOR}
    found: Json = plain({**rest, "channels": channels, "warnings": list(camera.warnings)})
    return found


def _levels(channel: ChannelCharacterisation) -> ReportTable:
    """List the exposures of one channel."""
    curve = channel.curve
    rows = [
        (f"{1e3 * curve.exposure_s[i]:.4g}", f"{curve.mean_dn[i]:.2f}", f"{curve.variance_dn2[i]:.3f}",
         f"{curve.dark_mean_dn[i]:.2f}", f"{curve.dark_variance_dn2[i]:.3f}",
         significant(100 * float(curve.saturated_fraction[i]), 2), "yes" if curve.in_line[i] else "no")
        for i in range(len(curve.exposure_s))
    ]  # fmt: skip
    columns = ("exposure (ms)", "mean (DN)", "variance (DN\u00b2)", "dark mean (DN)", "dark variance (DN\u00b2)",
               "at full scale (%)", "in the line")  # fmt: skip
    return one_group(f"{channel.channel}: mean and temporal variance at every exposure", columns, rows)


def _limits(camera: CameraCharacterisation) -> tuple[str, ...]:
    """Say what the numbers do not know."""
    return (
        "Quantum efficiency, responsivity, and threshold and saturation in photons are not known: they need a light "
        "source of known irradiance.",
        "The light is the rig's own lamp on the white tile. It is not as even as the standard asks for, so "
        "the non-uniformity without high-pass includes lamp, lens and tile. The high-pass removes these, and with them "
        "all that changes slowly from row to row or column to column: PRNU leaves it out.",
        _of_lines(camera),
        "There are no spectrograms and no counts of defect pixels.",
        f"The light of one exposure repeats within {percent(camera.light_repeatability_rel)} (one standard deviation, "
        "with drift). A smaller linearity error cannot be seen.",
        "The exposure times are those that the camera reports: an offset of its shutter shows in the "
        "linearity line, but a proportional error cannot be seen.",
        "The temperature of the sensor was not recorded. Dark current doubles every 6 to 10 degrees, and the numbers "
        "hold for these settings of the camera.",
        "Saturation lies between two exposures: its interval reaches from one to the other.",
    )


def _of_lines(camera: CameraCharacterisation) -> str:
    """Say what is separated in the fixed pattern."""
    if any(c.dsnu_rows_dn is None for c in camera.channels):
        return (
            "Rows, columns and pixels are not separated, because an older version made this record: run 'finray "
            "radiometry' again on the camera session."
        )
    return (
        "Rows and columns are those of one channel: every second row and column of a Bayer sensor. Their uncertainties "
        "assume that rows and columns of this region are normally distributed."
    )


def _methods(camera: CameraCharacterisation) -> tuple[str, ...]:
    """Return how the camera was characterised."""
    first = camera.channels[0]
    behind = (
        "without a filter" if camera.filter_name is None else f"through the filter \u201c{camera.filter_name}\u201d"
    )
    model = f" (model {camera.camera.model})" if camera.camera.model else ""
    pixels = ", ".join(f"{c.pixels} {c.channel}" for c in camera.channels)
    return (
        f"The camera \u201c{camera.camera_name}\u201d{model} was characterised by photon transfer (EMVA 1288, 2021): "
        f"raw frames of an evenly lit white tile {behind} at {len(first.curve.exposure_s)} exposures, with dark frames "
        f"of the same exposures. Pixels of the region: {pixels}. Exposure was varied by its time, at constant light.",
        "The system gain is the slope of the temporal variance against the mean, by least squares with weights of the "
        "fitted line, up to 70 % of saturation. The dark noise is its intercept without the variance of rounding "
        "(1/12 DN\u00b2). Saturation is where the variance is largest. The linearity error is the mean absolute "
        "deviation from a line with relative weights between 5 and 95 % of saturation. DSNU and PRNU are spatial "
        "standard deviations of mean images without the temporal noise left in them, the high-pass by second "
        "differences along rows and columns. Rows, columns and pixels of the mean dark image are separated by the "
        "variances of its row means, column means and residuals, those of PRNU by second differences of row and "
        "column means.",
        f"Uncertainties are those of the noise of the frames; U = {COVERAGE_FACTOR:g} u. A line that does not fit "
        f"(chi-square probability below {SMALLEST_CHI_SQUARE_P:g}) widens them.",
    )


def _mark(channel: str) -> tuple[str, str]:
    """Return marker and colour of a channel."""
    return next(((marker, colour) for name, marker, colour in CHANNELS if name == channel), ("o", MUTED))


@styled()
def photon_transfer_svg(camera: CameraCharacterisation) -> str:
    """Draw temporal variance against mean above dark, with the line of every channel."""
    figure = new_figure(5.0, 3.5)
    axes = figure.subplots()
    for c in camera.channels:
        marker, colour = _mark(c.channel)
        curve = c.curve
        signal_dn, variance = curve.mean_dn - curve.dark_mean_dn, curve.variance_dn2 - curve.dark_variance_dn2
        used = curve.in_line
        axes.plot(signal_dn[used], variance[used], marker, color=colour, markersize=5, label=c.channel)
        axes.plot(signal_dn[~used], variance[~used], marker, color=colour, markersize=5, markerfacecolor="none")
        ends = np.array([0.0, float(signal_dn.max())])
        axes.plot(ends, ends / c.gain_e_per_dn.estimate, color=colour, linewidth=0.9)
    axes.set(xlabel="mean above dark (DN)", ylabel="variance above dark (DN\u00b2)", xlim=(0, None))
    axes.set_ylim(0, 1.25 * max(float(np.max(c.curve.variance_dn2)) for c in camera.channels))
    legend_above(figure, axes, len(camera.channels))
    return svg_text(figure)


@styled()
def snr_svg(camera: CameraCharacterisation) -> str:
    """Draw the signal-to-noise ratio against the charge, beside the camera model and an ideal sensor."""
    figure = new_figure(4.6, 3.4)
    axes = figure.subplots()
    highest_e = 1.0
    for c in camera.channels:
        marker, colour = _mark(c.channel)
        signal_dn = c.curve.mean_dn - c.curve.dark_mean_dn
        below = np.arange(signal_dn.size) <= int(np.argmax(c.curve.variance_dn2))  # clipping hides noise beyond
        seen = below & (signal_dn > 0) & (c.curve.variance_dn2 > 0)
        charge_e = c.gain_e_per_dn.estimate * signal_dn[seen]
        axes.plot(charge_e, signal_dn[seen] / np.sqrt(c.curve.variance_dn2[seen]), marker, color=colour, markersize=4.5,
                  label=c.channel)  # fmt: skip
        highest_e = max(highest_e, float(charge_e.max()))
    main = max(camera.channels, key=lambda c: c.pixels)
    charge_e = np.geomspace(1.0, highest_e, 200)
    axes.plot(charge_e, model_snr(main, charge_e), color=MUTED, linewidth=1.2, label=f"model, {main.channel}")
    axes.plot(charge_e, np.sqrt(charge_e), "--", color=MUTED, linewidth=0.9, label="ideal")
    axes.set(xscale="log", yscale="log", xlabel="charge (e)", ylabel="signal-to-noise ratio")
    legend_above(figure, axes, 3)
    return svg_text(figure)


def model_snr(channel: ChannelCharacterisation, charge_e: Floats) -> Floats:
    r"""Return the signal-to-noise ratio of the linear camera model.

    .. math:: \mathrm{SNR} = \mu_e / \sqrt{\sigma_d^2 + \sigma_q^2 / K^2 + \mu_e}, \quad \sigma_q^2 = 1/12
    """
    rounding_e2 = channel.gain_e_per_dn.estimate**2 / 12.0
    found: Floats = charge_e / np.sqrt(channel.read_noise_e.estimate**2 + rounding_e2 + charge_e)
    return found


@styled()
def linearity_svg(camera: CameraCharacterisation) -> str:
    """Draw the deviation from the linearity line against exposure."""
    figure = new_figure(4.6, 3.4)
    axes = figure.subplots()
    band = 100 * camera.light_repeatability_rel
    axes.axhspan(-band, band, facecolor=MUTED, alpha=0.2, linewidth=0)
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    for c in camera.channels:
        marker, colour = _mark(c.channel)
        axes.plot(1e3 * c.curve.exposure_s, 100 * c.curve.deviation_rel, marker + "-", color=colour, markersize=4.5,
                  linewidth=0.8, label=c.channel)  # fmt: skip
    axes.set(xlabel="exposure (ms)", ylabel="deviation from the line (%)")
    legend_above(figure, axes, len(camera.channels))
    return svg_text(figure)
