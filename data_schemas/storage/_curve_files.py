"""CSV files of spectral curves and re-radiation matrices, and the curves that a rig or design refers to by name.

Comment lines start with #; there is one header row.

* camera response: ``wavelength_nm,red_percent,green_percent,blue_percent``
* filter: ``wavelength_nm,transmission`` (0 to 1)
* re-radiation matrix: first column ``emission_nm``, then one column per excitation wavelength in nm (header
  numbers); entries are the bispectral radiance factor per emission band, the diagonal is reflectance.

By name: the tungsten lamp and the stand-in camera response.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandPassFilter, CurveError, DonaldsonMatrix, FieldError, LampSettings, SpectralCurve
from data_schemas.storage._foreign_files import finite_number, read_csv, read_text

Floats = NDArray[np.float64]
CAMERA_COLUMNS = ["wavelength_nm", "red_percent", "green_percent", "blue_percent"]
FILTER_COLUMNS = ["wavelength_nm", "transmission"]
CHANNELS = ("red", "green", "blue")
FIRST_STOKES_NM = 15.0
LARGEST_CHANNEL_RATIO = 30.0
# A column holds all light that one excitation wavelength makes: at most what falls in, with a fifth for noise and for
# the geometry, in which a glossy sample looks brighter than a white one.
LARGEST_ENERGY_OUT = 1.2
# Decimal wavelengths are read with rounding errors; a real difference of steps is far larger.
STEP_TOLERANCE_NM = 1e-6
LARGEST_REFLECTANCE = 1.2
LARGEST_RESPONSE_PERCENT = 1000.0
ALLOW_REFLECTANCE = "# allow: reflectance above 1.2"


def read_table(path: Path) -> tuple[list[str], Floats]:
    """Read a CSV file: header names and an array of numbers (rows, columns).

    Raises
    ------
    CurveError
        The file is missing, has no rows, a row of another length, or something that is not a finite number.
    """
    header, rows = read_csv(path, "a CSV file", CurveError, comments=True, other_marks=True)
    if len(rows) < 2:
        raise CurveError(f"{path}: must have a header row and at least two rows of numbers")
    return header, np.array([_row(path, n, cells, len(header)) for n, cells in rows])


def _row(path: Path, number: int, cells: list[str], columns: int) -> list[float]:
    """Parse one row of finite numbers."""
    if len(cells) != columns:
        raise CurveError(
            f"{path}, line {number}: has {len(cells)} columns, but the header has {columns}; correct the row"
        )
    try:
        return [finite_number(cell) for cell in cells]
    except ValueError as error:
        raise CurveError(f"{path}, line {number}: {error}; correct or remove the row, or measure it again") from None


def read_camera_response(path: Path) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Read the red, green and blue response of a camera (sensor and Bayer filter together), 0..1."""
    header, table = read_table(path)
    if header != CAMERA_COLUMNS:
        raise CurveError(
            f"{path}: the header is {','.join(header)[:80]}, but a camera response needs {','.join(CAMERA_COLUMNS)}"
        )
    if (table[:, 1:] < 0).any():
        raise CurveError(
            f"{path}: a camera response is negative, but must be at least 0 (per cent of full scale); correct the row"
        )
    if table[:, 1:].max() > LARGEST_RESPONSE_PERCENT:
        raise CurveError(
            f"{path}: the largest camera response is {table[:, 1:].max():.4g} per cent, but at most "
            f"{LARGEST_RESPONSE_PERCENT:g} per cent is allowed; correct the row, or scale all columns by the same "
            "factor"
        )
    if empty := [name for name, column in zip(CAMERA_COLUMNS[1:], table[:, 1:].T, strict=True) if not column.any()]:
        raise CurveError(
            f"{path}: column '{empty[0]}' is 0 in all rows, but a colour camera needs a response in each channel; "
            "correct the column"
        )
    peaks = table[:, 1:].max(axis=0)
    if (
        peaks.max() > LARGEST_CHANNEL_RATIO * np.sort(peaks)[1]
        or peaks.min() * LARGEST_CHANNEL_RATIO < np.sort(peaks)[1]
    ):
        told = ", ".join(f"{name} {peak:g} %" for name, peak in zip(CHANNELS, peaks, strict=True))
        raise CurveError(
            f"{path}: the channels peak at {told}, but no colour camera has one channel that is more than "
            f"{LARGEST_CHANNEL_RATIO:g} times larger or smaller than the others; give all three in per cent of the "
            "same full scale"
        )
    red, green, blue = (_curve(path, name, table[:, 0], table[:, i + 1] / 100) for i, name in enumerate(CHANNELS))
    return red, green, blue


def read_filter_curve(path: Path) -> SpectralCurve:
    """Read the measured transmission of a filter, 0..1.

    Raises
    ------
    CurveError
        The file is no such curve, or a value is not a transmission.
    """
    header, table = read_table(path)
    if header != FILTER_COLUMNS:
        raise CurveError(
            f"{path}: the header is {','.join(header)[:80]}, but a filter needs {','.join(FILTER_COLUMNS)}"
        )
    transmission = table[:, 1]
    if transmission.min() < 0 or not 0 < transmission.max() <= 1:
        raise CurveError(
            f"{path}: the transmission runs from {transmission.min():g} to {transmission.max():g}, but must be 0 to 1 "
            "with at least one value above 0; divide by 100 if it is in per cent"
        )
    return _curve(path, path.stem, table[:, 0], transmission)


def read_filter_curves(filters: Iterable[BandPassFilter], folder: Path) -> dict[str, SpectralCurve]:
    """Read the measured transmissions that filters name, by the filter's name.

    Parameters
    ----------
    filters
        Those without a curve are passed over.
    folder
        Where relative paths start.
    """
    return {band.name: read_filter_curve(folder / band.curve) for band in filters if band.curve is not None}


def _curve(path: Path, name: str, wavelength_nm: Floats, values: Floats) -> SpectralCurve:
    """Build a curve and report its faults with the name of the file."""
    try:
        return SpectralCurve(name=name, wavelength_nm=wavelength_nm, values=values, source=path.name)
    except FieldError as error:
        raise CurveError(f"{path}: {error.without_field}") from None


def read_donaldson_matrix(path: Path) -> DonaldsonMatrix:
    """Read a measured re-radiation matrix and separate its diagonal (reflectance) from its fluorescence.

    Emission is kept only where it is at least 15 nm above the excitation (Stokes side): nearer to the
    diagonal the measured bands overlap, and below it the entries are noise. Negative noise is kept.

    A reflectance above :data:`LARGEST_REFLECTANCE` is refused: such a matrix is in per cent. A comment line
    ``# allow: reflectance above 1.2`` in the file lets it pass, for what sends light back (retroreflectors).

    Raises
    ------
    CurveError
        The file is not a matrix of finite numbers, a wavelength axis does not increase within 200 to 2500 nm, or
        the emission steps are uneven: entries are per emission band, whose width is the step.
    """
    header, table = read_table(path)
    if header[0] != "emission_nm":
        raise CurveError(f"{path}: the first column is '{header[0]}', but a re-radiation matrix needs 'emission_nm'")
    try:
        excitation = np.array([finite_number(name) for name in header[1:]])
    except ValueError:
        raise CurveError(
            f"{path}: the header must contain only excitation wavelengths in nm after 'emission_nm', but "
            "one entry is not a number"
        ) from None
    emission, values = table[:, 0], table[:, 1:]
    try:
        for axis, name in ((emission, "emission"), (excitation, "excitation")):
            SpectralCurve(name=name, wavelength_nm=axis, values=axis, source=path.name)
        band_nm = _even_step_nm(path, emission)
        stokes_nm = emission[:, None] - excitation[None, :]
        diagonal = np.array([_diagonal(emission, excitation, values, e) for e in emission])
        _require_reflectance(path, emission, values)
        known = np.isfinite(diagonal)
        _require_energy(path, excitation, np.where(stokes_nm >= FIRST_STOKES_NM, values, 0.0), emission, diagonal)
        return DonaldsonMatrix(
            name=path.stem,
            emission_nm=emission,
            excitation_nm=excitation,
            radiance_factor_per_nm=np.where(stokes_nm >= FIRST_STOKES_NM, values, 0.0) / band_nm,
            reflectance=SpectralCurve(
                name=f"{path.stem}, reflectance",
                wavelength_nm=emission[known],
                values=np.clip(diagonal[known], 0.0, None),
                source=path.name,
            ),
            source=path.name,
        )
    except FieldError as error:
        raise CurveError(f"{path}: {error.without_field}") from None


def _require_reflectance(path: Path, emission_nm: Floats, values: Floats) -> None:
    """Refuse a matrix of which an entry returns more light than matter does, unless the file says that it is meant."""
    largest = float(values.max())
    if largest <= LARGEST_REFLECTANCE or ALLOW_REFLECTANCE in read_text(path, "a CSV file", CurveError):
        return
    at_nm = float(emission_nm[np.unravel_index(int(values.argmax()), values.shape)[0]])
    raise CurveError(
        f"{path}: the reflectance is {largest:.4g} at {at_nm:g} nm, but at most {LARGEST_REFLECTANCE:g} is allowed; "
        f"divide by 100 if the matrix is in per cent, or add the line '{ALLOW_REFLECTANCE}' if this is intended"
    )


def _require_energy(path: Path, excitation_nm: Floats, emitted: Floats, emission_nm: Floats, diagonal: Floats) -> None:
    """Refuse a matrix that sends out more light than falls in; `diagonal` is its reflectance at the emission axis."""
    reflected = np.interp(excitation_nm, emission_nm, np.nan_to_num(diagonal), left=0.0, right=0.0)
    # more than this is allowed by the file itself: what sends light back to where it came from, whatever it emits
    counted = np.where(reflected > LARGEST_REFLECTANCE, 0.0, np.maximum(reflected, 0.0))
    out = emitted.sum(axis=0) + counted
    worst = int(out.argmax())
    if out[worst] > LARGEST_ENERGY_OUT:
        raise CurveError(
            f"{path}: at {excitation_nm[worst]:g} nm the matrix returns {out[worst]:.3g} times the light that it "
            f"receives ({emitted.sum(axis=0)[worst]:.3g} by fluorescence), but at most {LARGEST_ENERGY_OUT:g} is "
            "allowed, which leaves a fifth for noise. Entries must be fractions per emission band; divide by 100 if "
            "they are in per cent"
        )


def _even_step_nm(path: Path, emission_nm: Floats) -> float:
    """Return the step of the emission axis (nm)."""
    steps_nm = np.diff(emission_nm)
    if np.ptp(steps_nm) > STEP_TOLERANCE_NM:
        raise CurveError(
            f"{path}: emission_nm steps range from {steps_nm.min():g} to {steps_nm.max():g} nm, but must be equal "
            f"(within {STEP_TOLERANCE_NM:g} nm), because entries are per emission band; give the matrix on evenly "
            "spaced emission wavelengths"
        )
    return float(np.median(steps_nm))


def _diagonal(emission: Floats, excitation: Floats, values: Floats, wavelength_nm: float) -> float:
    """Return the entry with equal emission and excitation wavelength, or NaN where there is none."""
    column = np.flatnonzero(excitation == wavelength_nm)
    row = np.flatnonzero(emission == wavelength_nm)
    return float(values[row[0], column[0]]) if len(column) else float("nan")


SECOND_RADIATION_CONSTANT_NM_K = 1.438776877e7
LAMP_TEMPERATURE_K = 2856.0
NORMALISED_AT_NM = 560.0
BELL_CENTER_NM = (610.0, 535.0, 460.0)
BELL_SD_NM = (40.0, 36.0, 30.0)
BLUE_LEAK_REL = (0.010, 0.012, 0.0)
INFRARED_CUT_NM = 690.0
INFRARED_CUT_WIDTH_NM = 8.0


def planck_relative(wavelength_nm: Floats, temperature_k: float) -> Floats:
    r"""Return the relative spectral radiance of a black body, 1 at 560 nm.

    .. math:: L(\lambda) \propto \lambda^{-5} / (\exp(c_2 / (\lambda T)) - 1)

    Parameters
    ----------
    wavelength_nm
        Wavelength in vacuum (nm), any shape.
    temperature_k
        Temperature (K).

    Returns
    -------
    ndarray
        Radiance per nm relative to that at 560 nm, same shape.
    """

    def radiance(x_nm: Floats) -> Floats:
        return (x_nm / NORMALISED_AT_NM) ** -5 / np.expm1(SECOND_RADIATION_CONSTANT_NM_K / (x_nm * temperature_k))

    return radiance(wavelength_nm) / radiance(np.array(NORMALISED_AT_NM))


def halogen_lamp(temperature_k: float = LAMP_TEMPERATURE_K) -> SpectralCurve:
    """Return the relative spectral irradiance of a tungsten lamp: Planck, 1 at 560 nm, 360 to 800 nm."""
    wavelength_nm = np.arange(360.0, 801.0)
    return SpectralCurve(
        name="tungsten halogen lamp",
        wavelength_nm=wavelength_nm,
        values=planck_relative(wavelength_nm, temperature_k),
        source=f"Planck radiator at {temperature_k:g} K",
    )


LIGHT_COLUMNS = ["wavelength_nm", "power_rel"]


def read_light(path: Path) -> SpectralCurve:
    """Read the relative spectral power (energy per nm) of a light: CSV with wavelength_nm,power_rel.

    Raises
    ------
    CurveError
        The file is not such a table, a value is negative, or all are zero.
    """
    header, table = read_table(path)
    if header != LIGHT_COLUMNS:
        raise CurveError(f"{path}: the header is {','.join(header)[:80]}, but a light needs {','.join(LIGHT_COLUMNS)}")
    power = table[:, 1]
    if (power < 0).any() or not power.any():
        raise CurveError(
            f"{path}: power_rel must be at least 0 in every row and above 0 in one or more; correct or remove rows"
        )
    try:
        return SpectralCurve(name=path.stem, wavelength_nm=table[:, 0], values=power, source=path.name)
    except FieldError as error:
        raise CurveError(f"{path}: {error.without_field}") from None


def lamp_curve(lamp: LampSettings, folder: Path) -> SpectralCurve:
    """Return the relative spectrum of a rig's lamp: Planck at its temperature, or as its file says.

    Parameters
    ----------
    lamp
        The lamp in the rig file.
    folder
        Where a relative path of its file starts.

    Raises
    ------
    CurveError
        The file is missing or no spectrum of a light.
    """
    if lamp.spectrum.endswith(".csv"):
        return read_light(folder / lamp.spectrum)
    return halogen_lamp(lamp.temperature_k)


def assumed_camera_response() -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return smooth stand-in curves of a Bayer camera (red, green, blue) with an infrared-cut filter.

    Response means signal per unit spectral radiance (power, not photons), relative. At 450 nm red passes 1.0 % of
    what blue passes and green 7.7 %, most of it the tail of its own bell. Good for planning and for simulated rigs; no
    real camera is calibrated by it.
    """
    wavelength_nm = np.arange(380.0, 781.0, 2.0)
    infrared_cut = 1.0 / (1.0 + np.exp((wavelength_nm - INFRARED_CUT_NM) / INFRARED_CUT_WIDTH_NM))
    bells = [
        np.exp(-0.5 * ((wavelength_nm - center) / sd) ** 2)
        for center, sd in zip(BELL_CENTER_NM, BELL_SD_NM, strict=True)
    ]
    red, green, blue = (
        SpectralCurve(
            name=name,
            wavelength_nm=wavelength_nm,
            values=(bell + leak * bells[2]) * infrared_cut,
            uncertainty_rel=0.1,
            source="assumed",
        )
        for name, bell, leak in zip(("red", "green", "blue"), bells, BLUE_LEAK_REL, strict=True)
    )
    return red, green, blue


def camera_response(name: str, folder: Path) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return the red, green and blue response that a rig or design file names.

    Parameters
    ----------
    name
        "assumed" (stand-in curves) or the path of a CSV file.
    folder
        Where a relative path starts.
    """
    return assumed_camera_response() if name == "assumed" else read_camera_response(folder / name)
