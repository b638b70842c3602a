"""The certificate of a paint: one page as HTML that prints on A4, and the same page as PDF.

Both show the same `Certificate`: head, results with expanded uncertainty, spectrum with its band, traceability, budget,
method, conditions, decision rule, what it does not say, and a place to sign.
"""

import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data_schemas import (
    CERTIFIED,
    CaptureSession,
    CertificateDetails,
    CertifiedName,
    DeviceIdentity,
    Estimate,
    PaintCalibration,
    package_version,
)
from finray_calib.acceptance import NO_REFERENCE, CertifiedResult
from finray_calib.fit import BudgetRow
from finray_calib.reports._fit_figures import budget_figure, emission_readings
from finray_calib.reports._fit_statements import BUDGET_NAMES, budget_table
from finray_calib.reports._page import KeyNumber, Light, ReportTable, drawing, one_group, render_page
from finray_calib.reports._plain_text import (
    NO_VALUE,
    centre_text,
    decimals_for,
    fixed,
    percent,
    plain,
    probability,
    unbroken,
)
from finray_calib.reports._style import BLUE, HAIRLINE, MUTED, SKY, ReadableFigure, new_figure, readable, styled

TEMPLATE: Final = "certificate.html.j2"
SMALL_SHARE: Final = 0.03
"""Sources below it are one row: the budget is to stand on the sheet."""
NOT_RECORDED: Final = "not recorded"
PER_THOUSAND: Final = 1e3
SHOWN_NM: Final = (430.0, 760.0)
SIGNED: Final = ("Authorised by", "Signature", "Date")


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a certificate says.

    Attributes
    ----------
    paint_name, number, head
        The paint, the number, and rows of label and text.
    results, budget, instruments
        Tables; no budget where none was computed.
    budget_rows
        The budget's rows, for its picture.
    traceability, conformity
        One sentence each.
    key_numbers, light
        The first three results, and the light of all that were judged.
    authorised_by
        Who signs; empty where the laboratory does not say.
    statements
        Heading and text of the paragraphs.
    end
        The last line.
    """

    paint_name: str
    number: str
    head: tuple[tuple[str, str], ...]
    results: ReportTable
    budget: ReportTable | None
    budget_rows: tuple[BudgetRow, ...]
    instruments: ReportTable
    traceability: str
    conformity: str
    key_numbers: tuple[KeyNumber, ...]
    light: Light
    authorised_by: str
    statements: tuple[tuple[str, str], ...]
    end: str


def paint_certificate(
    paint: PaintCalibration,
    results: Sequence[CertifiedResult],
    details: CertificateDetails,
    sha256: str,
    issued_on: date,
    sessions: Sequence[CaptureSession] = (),
    budget: Sequence[BudgetRow] = (),
    lineage: str = "",
) -> Certificate:
    """Return what the certificate of a paint says.

    Parameters
    ----------
    paint, results, details
        The calibration, what is certified of it, and what the laboratory adds.
    sha256
        Of the file of the calibration.
    issued_on
        Day of issue.
    sessions
        Those that the paint was measured in, as far as they were found. Of several, none states date, devices and
        conditions for all.
    budget
        By source, where it was computed.
    lineage
        What was found of the files that the calibration was made from.
    """
    number = details.number or f"FR-{sha256[:12]}"
    session = sessions[0] if len(sessions) == 1 else None
    return Certificate(
        paint_name=paint.paint_name,
        number=number,
        head=_head(details, session, issued_on),
        results=_results(results),
        budget=budget_table(budget, {name: BUDGET_NAMES[name] for name in CERTIFIED}, least_share=SMALL_SHARE)
        if budget
        else None,
        budget_rows=tuple(row for row in budget if row.quantity in _SHORT),
        instruments=_instruments(paint, details, session),
        traceability=traceability_of(results, is_simulated=any(one.rig.is_simulated for one in sessions)),
        conformity=_conformity(results),
        key_numbers=tuple(_key_number(result) for result in results[:3]),
        light=_light(results),
        authorised_by=details.authorised_by,
        statements=(
            ("Method", _method(paint)),
            ("Conditions", _conditions(paint, details, session)),
            ("Uncertainty", _uncertainty(paint, has_budget=bool(budget))),
            ("Decision rule", _rule(results)),
            ("Limits of this certificate", _limits(paint)),
            ("Origin", f"{lineage} SHA-256 of the calibration {sha256}; finray-calib {package_version()}.".strip()),
        ),
        end=f"Certificate {number}. Not to be reproduced except in full. End of certificate.",
    )


_SHORT: Final[dict[CertifiedName, str]] = {
    "mode_nm": "maximum", "fwhm_nm": "width", "peak_per_nm": "peak", "energy_yield": "yield",
    "reflectance_at_laser": "reflectance",
}  # fmt: skip


def traceability_of(results: Sequence[CertifiedResult], *, is_simulated: bool = False) -> str:
    """Return what the results are traceable through, quantities with the same answer together."""
    alike: dict[str, list[str]] = {}
    for result in results:
        alike.setdefault(result.traceability, []).append(_SHORT[result.name])
    told = "; ".join(f"{', '.join(names)}: {text}" for text, names in alike.items())
    told = NO_REFERENCE if list(alike) == [NO_REFERENCE] else told
    return f"no paint was measured, because the rig is simulated; {told}" if is_simulated else told


def _head(details: CertificateDetails, session: CaptureSession | None, issued_on: date) -> tuple[tuple[str, str], ...]:
    """Return who measured what for whom, and when."""
    measured = NOT_RECORDED
    if session is not None and session.frames:
        days = sorted({frame.captured_utc[:10] for frame in session.frames})
        measured = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    return (
        ("Laboratory", ", ".join(filter(None, (details.laboratory, details.address))) or NOT_RECORDED),
        ("Customer", details.customer or NOT_RECORDED),
        ("Item", details.item or "not described beyond the name of the paint"),
        ("Measured (UTC)", measured),
        ("Issued", issued_on.isoformat()),
    )


def _results(results: Sequence[CertifiedResult]) -> ReportTable:
    """List value, expanded uncertainty, coverage factor and interval of each quantity."""
    columns = ["quantity", "value", "U", "k", "95 % coverage interval"]
    judged = any(result.limits is not None for result in results)
    rows = [(*_cells(result), *(_judged(result) if judged else ())) for result in results]
    return one_group("Results", (*columns, *(("limits", "conforms") if judged else ())), rows)


def _cells(result: CertifiedResult) -> tuple[str, ...]:
    """Return the cells of a result: U with two significant digits, all else to its last digit."""
    title = f"{result.title} ({result.unit or '1'})"
    if not result.is_measured:
        return (title, "not measured: mostly prior", NO_VALUE, NO_VALUE, NO_VALUE)
    decimals = decimals_for(result.expanded)
    value, expanded, low, high = (
        fixed(number, decimals) for number in (result.value, result.expanded, result.low95, result.high95)
    )
    return (title, value, expanded, f"{result.coverage_factor:.2f}", f"{low} to {high}")


def _judged(result: CertifiedResult) -> tuple[str, str]:
    """Return limits, and verdict with the probability of conformity."""
    if result.limits is None:
        return (NO_VALUE, NO_VALUE)
    low, high = result.limits.low, result.limits.high
    limits = " ".join(
        filter(None, (None if low is None else f"from {low:g}", None if high is None else f"to {high:g}"))
    )
    known = "" if result.p_conform is None else f", probability {probability(result.p_conform)}"
    return (limits, f"{result.verdict}{known}")


def _conformity(results: Sequence[CertifiedResult]) -> str:
    """Say what conforms."""
    judged = [result for result in results if result.verdict is not None]
    if not judged:
        return "No statement of conformity is made: no limits were given."
    return (
        "Conformity: "
        + "; ".join(f"{result.verdict}: {result.title.partition(',')[0].partition(':')[0]}" for result in judged)
        + "."
    )


_LIGHTS: Final[dict[str, Light]] = {"PASS": "good", "UNDECIDED": "care", "FAIL": "bad"}


def _light(results: Sequence[CertifiedResult]) -> Light:
    """Return the light of the worst verdict; none where nothing was judged."""
    lights = {_LIGHTS[result.verdict] for result in results if result.verdict is not None}
    return next((light for light in ("bad", "care", "good") if light in lights), "")


def _key_number(result: CertifiedResult) -> KeyNumber:
    """Return a result for the first screen: judged by its limits, or by whether it was measured."""
    _, value, expanded, _, between = _cells(result)
    title = result.title.partition(",")[0].partition(":")[0]
    if not result.is_measured:
        return KeyNumber(title, NO_VALUE, value, "care", "mostly prior")
    shown = f"{value} {result.unit}".rstrip()
    light: Light = "good" if result.verdict is None else _LIGHTS[result.verdict]
    reason = "measured" if result.verdict is None else _judged(result)[1]
    return KeyNumber(title, shown, f"U = {expanded}; 95 %: {between}", light, reason)


def _instruments(paint: PaintCalibration, details: CertificateDetails, session: CaptureSession | None) -> ReportTable:
    """List the parts of the rig with what the devices say they are, and the certificates that were recorded."""
    optics = paint.optics
    said: dict[str, DeviceIdentity] = {} if session is None else {device.role: device for device in session.devices}
    parts = {
        "camera": f"spectral response: {optics.camera_response[0].source}",
        "filter wheel": f"{len(optics.filters)} band-pass filters",
        "laser": f"{optics.laser.wavelength_nm:g} nm, {optics.laser.power_mw:g} mW",
        "lamp": optics.lamp.source,
    }
    rows = []
    for role, what in parts.items():
        device = said.get(role)
        words = () if device is None else (device.vendor, device.model, device.serial)
        rows.append((role, what, " ".join(filter(None, words)) or NOT_RECORDED, _held(details, role)))
    white = optics.white_reference
    rows.append((
        "white reference", f"reflectance {white.reflectance:g}, u = {100 * white.uncertainty_rel:g} %", NOT_RECORDED,
        _held(details, "white reference"),
    ))  # fmt: skip
    columns = ("instrument", "as the rig file describes it", "as the device reports it", "certificate")
    return one_group("Instruments and their certificates", columns, rows, is_words=True)


_REFERENCE_OF: Final = {"camera": "camera response", "filter wheel": "filters"}


def _held(details: CertificateDetails, role: str) -> str:
    """Return the certificates of a part."""
    held = [reference for reference in details.references if reference.of == _REFERENCE_OF.get(role, role)]
    return "; ".join(
        f"{reference.number}, {reference.issued_by}, {reference.calibrated_on}"
        + ("" if reference.valid_until is None else f" to {reference.valid_until}")
        for reference in held
    ) or "none recorded"  # fmt: skip


def _method(paint: PaintCalibration) -> str:
    """Say how it was measured."""
    optics = paint.optics
    bands = ", ".join(centre_text(band.center_nm) for band in optics.filters)
    return (
        f"A Bayer camera photographed the sample under a laser of {optics.laser.wavelength_nm:g} nm, and the white "
        f"reference under lamp and laser, through filters at {bands} nm. The emission is the Bayesian posterior of "
        f"{paint.usable_values} ratios of signals under {_basis(paint)}.{_sessions(paint)}"
    )


def _sessions(paint: PaintCalibration) -> str:
    """Say how the sessions differ that a paint's fit combines; nothing of a fit of one session."""
    if paint.between_sessions is None:
        return ""
    scatter = paint.between_sessions

    def told(of: Estimate) -> str:
        return f"{percent(of.estimate)} [{percent(of.low95)}, {percent(of.high95)}]"

    return (
        f" {len(scatter.session_levels_rel)} sessions were combined. Between sessions the level has a standard "
        f"deviation of {told(scatter.level_rel)}, and each filter a further one of {told(scatter.filter_rel)} (95 %); "
        "the uncertainties include both."
    )


def _basis(paint: PaintCalibration) -> str:
    """Return what the spectrum rests on."""
    return f"a {paint.spectrum_from}" if paint.spectrum_from.startswith("prior") else f"the family {paint.family_title}"


def _conditions(paint: PaintCalibration, details: CertificateDetails, session: CaptureSession | None) -> str:
    """Say under which conditions."""
    told = "Temperature and humidity were not recorded."
    if details.conditions:
        told = f"As the laboratory states: {details.conditions}."
    if session is None:
        return f"{told} No single session of the frames was found."
    region = session.plan.region
    dose = max((frame.laser_dose_j for frame in session.frames), default=0.0)
    proof = "not proven" if session.filter_proof is None else session.filter_proof.verdict
    return (
        f"{told} {len(session.frames)} frames of a region of {region.width_px} x {region.height_px} px; laser dose on "
        f"the sample {dose:.3g} J; filters in their slots, judged by the frames: {proof}."
    )


def _uncertainty(paint: PaintCalibration, has_budget: bool) -> str:
    """Say what U and k are, and what the uncertainty of band values was stated to be."""
    stated = paint.optics.band_uncertainty
    told = (
        "U is half of the interval that holds 95 % of the posterior draws, symmetric in probability (JCGM 101), and k "
        "is U divided by their standard deviation."
    )
    budget = (
        "The budget holds standard uncertainties (k = 1): sensitivity of the posterior mean times the standard "
        "uncertainty of each source (GUM 5.1.2), and the rest comes from the prior."
    )
    assumed = (
        "A budget by source was not requested. Besides the noise of the frames, U includes the relative standard "
        f"uncertainties of the rig file: {percent(stated.calibration_rel)} for the calibration of each filter, "
        f"{percent(stated.response_rel)} for each channel's response, and for stray light "
        f"{percent(stated.stray_light_rel)} of the largest band value of all filters but the laser's."
    )
    return f"{told} {budget if has_budget else assumed}"


def _rule(results: Sequence[CertifiedResult]) -> str:
    """Say how conformity is decided."""
    if all(result.limits is None for result in results):
        return "No rule is needed, because no limits were given and no statement of conformity is made."
    return (
        "PASS where the probability that the quantity lies within the customer's limits is at least 95 % (JCGM 106, "
        "guarded acceptance), FAIL where it is at most 5 %, UNDECIDED between."
    )


def _limits(paint: PaintCalibration) -> str:
    """Say what the certificate does not know."""
    laser = f"{paint.optics.laser.wavelength_nm:g} nm"
    prior = [name for name, share in paint.prior_shares.items() if share.mostly_prior and name != "stokes_shift_nm"]
    told = [
        f"The results hold for the coat that was measured, for light at {laser}, and for a diffuse paint; other coats "
        "of the tin may differ by more than U, and ageing is not included."
    ]
    if prior:
        told.append(f"Determined mostly by the prior, and so not certified: {', '.join(prior)}.")
    told += [f"Warning: {warning}." for warning in paint.warnings]
    return " ".join(told)


@styled()
def _spectrum(paint: PaintCalibration) -> ReadableFigure:
    """Draw the spectrum for the page."""
    figure = new_figure(5.6, 2.2)
    axes = figure.subplots()
    _draw_spectrum(axes, paint)
    return readable(figure, axes, emission_readings(paint))


def _draw_spectrum(axes: Axes, paint: PaintCalibration) -> None:
    """Draw the emission with the bands for 95 % of each wavelength and of the whole curve."""
    x = paint.wavelength_nm
    low, high = paint.emission_low95_simultaneous_per_nm, paint.emission_high95_simultaneous_per_nm
    if low is not None and high is not None:
        for limit, label in ((low, "95 %, whole curve"), (high, None)):
            axes.plot(x, PER_THOUSAND * limit, color=MUTED, linewidth=0.8, linestyle="--", label=label)
    axes.fill_between(
        x, PER_THOUSAND * paint.emission_low95_per_nm, PER_THOUSAND * paint.emission_high95_per_nm, facecolor=SKY,
        edgecolor=BLUE, linewidth=0.5, alpha=0.4, label="95 %, each wavelength",
    )  # fmt: skip
    axes.plot(x, PER_THOUSAND * paint.emission_per_nm, color=BLUE, linewidth=1.4, label="mean")
    for number, band in enumerate(paint.optics.filters):
        if SHOWN_NM[0] < band.center_nm < SHOWN_NM[1]:
            axes.axvspan(band.center_nm - band.fwhm_nm / 2, band.center_nm + band.fwhm_nm / 2, ymax=0.05,
                         facecolor=HAIRLINE, edgecolor=MUTED, linewidth=0.5,
                         label="filters" if number == len(paint.optics.filters) - 1 else None)  # fmt: skip
    axes.set(xlim=SHOWN_NM, ylim=(0, None))
    axes.set_xlabel("wavelength (nm)", fontsize=8)
    axes.set_ylabel("emission (10$^{-3}$ nm$^{-1}$)", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.legend(loc="upper left", fontsize=8)


def certificate_page(certificate: Certificate, paint: PaintCalibration) -> str:
    """Return a certificate as a self-contained HTML page that is read without script and prints on one sheet.

    Parameters
    ----------
    certificate
        What it says.
    paint
        The calibration, for the spectrum.
    """
    return render_page(
        TEMPLATE,
        certificate=certificate,
        screen={
            "verdict": certificate.conformity,
            "light": certificate.light,
            "sentence": f"{certificate.traceability[:1].upper()}{certificate.traceability[1:]}.",
            "picture": drawing(
                _spectrum(paint),
                f"Emission spectrum of {paint.paint_name} with its 95 % bands",
                "Emission of the paint; shaded: the filters through which the camera saw it.",
            ),
            "key_numbers": certificate.key_numbers,
        },
        budget_picture=drawing(
            budget_figure(certificate.budget_rows, SMALL_SHARE, height_in=3.4),
            "Budget as bars of 100 %: the shares of the table",
            "One bar for each quantity; the parts are the sources.",
        )
        if certificate.budget_rows
        else None,
        signed=SIGNED,
        summary=plain({
            "number": certificate.number,
            "paint": certificate.paint_name,
            "results": [list(row) for row in certificate.results.groups[0].rows],
            "traceability": certificate.traceability,
        }),
    )  # fmt: skip


SHEET_IN: Final = (8.27, 11.69)
"""A4."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.07, 0.93, 0.955, 0.06
_SIZES_PT: Final = (7.5, 7.0, 6.5, 6.0)
"""Of the letters. The largest size is taken that fits on one sheet; the smallest may take several sheets."""


def certificate_pdf(certificate: Certificate, paint: PaintCalibration) -> bytes:
    """Return a certificate as PDF in A4, on one sheet where its texts allow; equal input gives equal bytes.

    Parameters
    ----------
    certificate
        What it says.
    paint
        The calibration, for the spectrum.
    """
    with styled():
        sheets = [_Sheets(size) for size in _SIZES_PT]
        laid = next((one for one in sheets if len(_lay_out(one, certificate, paint).pages) == 1), sheets[-1])
        buffer = io.BytesIO()
        with PdfPages(buffer, metadata={"CreationDate": None, "Title": f"Certificate {certificate.number}"}) as pdf:
            for number, page in enumerate(laid.pages, 1):
                of = f"Certificate {certificate.number}"
                foot = f"{of}, page {number} of {len(laid.pages)}. {certificate.end.removeprefix(f'{of}. ')}"
                page.text(_LEFT, 0.03, foot, fontsize=6.5, color=MUTED, parse_math=False)
                pdf.savefig(page)
    return buffer.getvalue()


_WIDTHS: Final = {
    "quantity": 3.2, "95 % coverage interval": 1.8, "limits": 1.5, "conforms": 2.0, "source": 3.2,
    "size (evaluation)": 2.8, "k": 0.6,
}  # fmt: skip
"""Of columns that are not as wide as the others."""


class _Sheets:
    """Sheets that are written from top to bottom with letters of one size."""

    def __init__(self, size_pt: float):
        self.size_pt = size_pt
        self.pages: list[Figure] = []
        self._turn()

    def _turn(self) -> None:
        """Take a new sheet."""
        self.pages.append(Figure(figsize=SHEET_IN))
        self._y = _TOP

    def _line_height(self, size_pt: float) -> float:
        """Return the height of a line as a share of the sheet."""
        return 1.35 * size_pt / (72 * SHEET_IN[1])

    def room(self, height_share: float) -> float:
        """Take room of a height, on the next sheet where this one has none, and return its lower edge."""
        if self._y - height_share < _BOTTOM:
            self._turn()
        self._y -= height_share
        return self._y

    def line(self, text: str, x_share: float = _LEFT, factor: float = 1.0, weight: str = "normal") -> None:
        """Write one line."""
        size = factor * self.size_pt
        self.pages[-1].text(
            x_share, self.room(self._line_height(size)), text, fontsize=size, weight=weight, parse_math=False
        )

    def paragraph(self, text: str, weight: str = "normal") -> None:
        """Write a text over the width of the sheet."""
        for part in textwrap.wrap(
            unbroken(text), self._letters((_RIGHT - _LEFT) * (0.93 if weight == "bold" else 1.0))
        ):
            self.line(part, weight=weight)

    def _letters(self, width: float) -> int:
        """Return how many letters stand in a share of the sheet's width."""
        return max(int(width * SHEET_IN[0] * 72 / (0.56 * self.size_pt)), 6)

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[float]) -> None:
        """Write a table with columns of the given shares of the width; cells are wrapped."""
        total = sum(widths)
        lefts = [_LEFT + (_RIGHT - _LEFT) * sum(widths[:i]) / total for i in range(len(widths))]
        letters = [self._letters((_RIGHT - _LEFT) * width / total - 0.008) for width in widths]
        height = self._line_height(self.size_pt)
        for number, row in enumerate((columns, *rows)):
            cells = [textwrap.wrap(unbroken(cell), most) or [""] for cell, most in zip(row, letters, strict=True)]
            low = self.room(height * max(map(len, cells)) + 0.25 * height)
            top = low + height * (max(map(len, cells)) - 1) + 0.25 * height
            for left, lines in zip(lefts, cells, strict=True):
                for i, text in enumerate(lines):
                    self.pages[-1].text(left, top - i * height, text, fontsize=self.size_pt, parse_math=False,
                                        weight="bold" if number == 0 else "normal")  # fmt: skip
            self.rule(low - 0.1 * height)

    def rule(self, y_share: float | None = None) -> None:
        """Draw a line over the width."""
        y = self.room(0.004) if y_share is None else y_share
        self.pages[-1].add_artist(Line2D((_LEFT, _RIGHT), (y, y), color=HAIRLINE, linewidth=0.6))

    def axes(self, height_share: float) -> Axes:
        """Return axes over the width."""
        low = self.room(height_share + 0.03)
        return self.pages[-1].add_axes((_LEFT + 0.05, low + 0.03, _RIGHT - _LEFT - 0.05, height_share))


def _lay_out(sheets: _Sheets, certificate: Certificate, paint: PaintCalibration) -> _Sheets:
    """Write a certificate on sheets."""
    sheets.line(f"Calibration certificate {certificate.number}", factor=1.9, weight="bold")
    sheets.room(0.006)
    sheets.line(f"Fluorescent paint: {certificate.paint_name}", factor=1.4)
    sheets.room(0.004)
    sheets.table(("", ""), certificate.head, (1, 5))
    sheets.room(0.006)
    sheets.paragraph(f"{certificate.traceability[:1].upper()}{certificate.traceability[1:]}.", weight="bold")
    sheets.paragraph(certificate.conformity)
    for table in filter(None, (certificate.results, certificate.budget, certificate.instruments)):
        sheets.room(0.008)
        sheets.line(unbroken(table.caption), factor=1.1, weight="bold")
        widths = [_WIDTHS.get(column, 1.0) for column in table.columns]
        rows = [[cell if isinstance(cell, str) else cell.text for cell in row] for row in table.groups[0].rows]
        sheets.table(table.columns, rows, widths)
        if table is certificate.results:
            _draw_spectrum(sheets.axes(0.12), paint)
    for heading, text in certificate.statements:
        sheets.room(0.005)
        sheets.line(heading, weight="bold")
        sheets.paragraph(text)
    sheets.room(0.02)
    sheets.table(SIGNED, ((certificate.authorised_by, "", ""),), (1, 1, 1))
    return sheets
