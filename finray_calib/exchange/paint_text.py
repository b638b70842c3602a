"""A paint's emission as text: CSV with its intervals, and the spectrum file of Mitsuba."""

from collections.abc import Iterator

import numpy as np

from data_schemas.fit import PaintCalibration
from data_schemas.provenance import Provenance

CSV_COLUMNS = (
    "wavelength_nm",
    "emission_per_nm",
    "low68_per_nm",
    "high68_per_nm",
    "low95_per_nm",
    "high95_per_nm",
)
QUANTITY = "bispectral radiance factor per nm of emission (energy), unit 1/nm"


def origin_lines(paint: PaintCalibration, origin: Provenance) -> tuple[str, ...]:
    """Return which paint this is, what the numbers mean and where they come from, one statement per line."""
    laser_nm = paint.optics.laser.wavelength_nm
    return (
        f"paint: {paint.paint_name}",
        f"quantity: {QUANTITY}, for excitation at {laser_nm:g} nm; its integral is emitted over incident energy",
        f"family: {paint.family_title}; {paint.family_choice}",
        *(f"warning: {warning}" for warning in paint.warnings),
        f"made by: {origin.command} (finray-calib {origin.package_version}, {origin.created_utc})",
        *(f"from: {name}, SHA-256 {digest}" for name, digest in origin.input_sha256.items()),
    )


def csv_text(paint: PaintCalibration, origin: Provenance) -> str:
    """Return the emission with its pointwise 68 % and 95 % limits as CSV; comment lines start with #.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    origin
        Provenance of the export.
    """
    columns = (
        paint.wavelength_nm,
        paint.emission_per_nm,
        paint.emission_low68_per_nm,
        paint.emission_high68_per_nm,
        paint.emission_low95_per_nm,
        paint.emission_high95_per_nm,
    )
    reflectance = (
        f"reflectance at {band.center_nm:g} nm: {value.estimate:.4g}, sd {value.sd:.2g}"
        for band, value in zip(paint.optics.filters, paint.reflectance, strict=True)
    )
    rows = (",".join(f"{value:.7g}" for value in row) for row in np.column_stack(columns))
    return _text((*origin_lines(paint, origin), *reflectance), (",".join(CSV_COLUMNS), *rows))


def mitsuba_text(paint: PaintCalibration, origin: Provenance) -> str:
    """Return the mean emission as pairs of wavelength (nm) and value, as Mitsuba's ``spectrum`` plugin reads it.

    Under the irradiance E (W/m2) at the laser line a diffuse paint emits the spectral radiance E / pi times this
    curve (W/(m2 sr nm)). Mitsuba holds no uncertainty; the header says so.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    origin
        Provenance of the export.
    """
    lines = (
        *origin_lines(paint, origin),
        "use: radiance of the paint in W/(m2 sr nm) = irradiance at the excitation in W/m2 / pi x this curve",
        "missing here: uncertainty (export csv, json or netcdf), reflectance, dependence on excitation (export exr)",
    )
    pairs = zip(paint.wavelength_nm, np.maximum(paint.emission_per_nm, 0.0), strict=True)
    return _text(lines, (f"{wavelength_nm:g} {value:.7g}" for wavelength_nm, value in pairs))


def _text(comments: tuple[str, ...], rows: tuple[str, ...] | Iterator[str]) -> str:
    """Join comment lines (a line break inside one would end it) and rows."""
    return "".join(f"# {' '.join(line.split())}\n" for line in comments) + "".join(f"{row}\n" for row in rows)
