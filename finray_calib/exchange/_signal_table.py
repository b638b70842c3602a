r"""Tables of band signals that were measured by other means, as the record that a fit reads.

A photodiode behind filters, a spectrometer, numbers of a paper, the camera of another group: one row for each filter
(and colour channel), in any unit. With F the paint under the laser, W the white reference under the lamp, S the paint
under the lamp and V the white reference under the laser through the laser's filter e, all without their dark reading D,

.. math:: y_{bc} = \frac{F_{bc} / W_{bc}}{\sum_c w_c V_c / W_{ec}}, \qquad \rho_{bc} = R_w \frac{S_{bc}}{W_{bc}}

as :mod:`finray_calib.radiometry` defines them. The stated standard uncertainties are propagated to first order; a dark
reading is common to its row, the white reference to all rows. A factor of all readings under one light, or of all
readings of one row, cancels.

Without white under the laser the level of y is unknown. Who needs the shape of the emission only states a yield to
assume; the name of the paint then says that it is assumed. Without paint under the lamp a reflectance is anywhere from
0 to 1. A spectrometer that measures spectral radiance needs no lamp, because W follows from the filters' curves.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    BandSignals,
    BandUncertainty,
    FieldError,
    Flag,
    ImportedFilter,
    ImportFormatError,
    LampSettings,
    LaserSettings,
    Optics,
    RigFile,
    SpectralCurve,
    WhiteReference,
    coverage_notes,
)
from data_schemas.storage import (
    assumed_camera_response,
    camera_response,
    given_path,
    lamp_curve,
    read_camera_response,
    read_filter_curves,
    read_toml,
)
from finray_calib.exchange._lab_measurements import (
    CHANNELS,
    FILTER_DATA,
    READINGS,
    SignalRow,
    SignalTable,
    curve_inside,
    filter_curves_of,
    one_channel,
    read_signal_cells,
    require_line,
    wheel_of,
)
from finray_calib.radiometry import (
    LaserLevel,
    Readings,
    fluorescence_of_readings,
    level_of_readings,
    reflectance_of_readings,
)
from finray_calib.spectra import WAVELENGTH_NM, rig_emission_weights, transmissions

Floats = NDArray[np.float64]
_GREEN: Final = 1  # the column of a detector of one channel, as of a monochrome camera
# The mean of 1/W is 1 % off where W is 10 standard deviations, which is a tenth of the standard deviation of 1/W.
LEAST_WHITE_SNR: Final = 10.0
# A glossy sample looks brighter than a white one, but not by more.
LARGEST_REFLECTANCE: Final = 1.2
# Of light sent back under the lamp, fluorescence with it; a number above is in per cent.
LARGEST_RADIANCE_FACTOR: Final = 5.0
UNKNOWN_REFLECTANCE, UNKNOWN_REFLECTANCE_SD = 0.5, 12**-0.5  # all values from 0 to 1 are equally likely
# By which a spectrum was integrated: exact but for the scale of wavelengths of a spectrometer.
_EXACT: Final = {
    "center_uncertainty_nm": 0.15,
    "fwhm_uncertainty_nm": 0.15,
    "blocking_od": 12.0,
    "blocking_uncertainty_od": 0.0,
}


@dataclass(frozen=True, slots=True)
class SignalOptions:
    """What a table of band signals does not hold; what a rig file states is used where nothing is given here.

    Attributes
    ----------
    paint_name
        Name of the paint; that of the table's file where it is None.
    laser_nm, laser_fwhm_nm
        Wavelength and full width of the laser, nm.
    lamp
        "planck-2856K" (or another temperature of a tungsten lamp), or a CSV file (wavelength_nm,power_rel).
    response
        CSV file of the detector's response: wavelength_nm,response_percent for one channel; for three channels as of a
        camera. Without it one channel is flat, and three are those of the rig's camera, or assumed.
    white_reflectance, white_uncertainty_rel
        Reflectance of the white reference (0 to 1) and its relative standard uncertainty.
    calibrated
        Whether the readings are spectral radiance times each filter's transmission, integrated over wavelength, as of a
        calibrated spectrometer: they need no white under the lamp.
    assumed_yield
        Yield (emitted over incident energy) that is assumed where the white reference under the laser was not measured.
    """

    paint_name: str | None = None
    laser_nm: float | None = None
    laser_fwhm_nm: float | None = None
    lamp: str | None = None
    response: Path | None = None
    white_reflectance: float | None = None
    white_uncertainty_rel: float | None = None
    calibrated: bool = False
    assumed_yield: float | None = None


def import_signal_table(
    table: Path, rig: Path | None = None, options: SignalOptions | None = None
) -> tuple[BandSignals, list[Path]]:
    """Read a table of band signals.

    Of one channel the green column of the record holds the signals; red and blue are flagged "weak" and never used.

    Parameters
    ----------
    table
        CSV file; columns are separated by commas, tabs or semicolons.
    rig
        Rig file with the filters that the table names, and with laser, lamp, white reference and uncertainties.
    options
        What the table does not hold.

    Returns
    -------
    BandSignals, list of Path
        The signals, and every file that was read.

    Raises
    ------
    ImportFormatError
        A column or cell is wrong or missing, or no filter passes the laser.
    RecordError, CurveError
        The rig file, an option or a curve is wrong.
    """
    options = _checked(options)
    read = read_signal_cells(table)
    if options.calibrated and "channel" in read.header:
        raise ImportFormatError(
            f"{table}: has the column 'channel', but a calibrated spectrometer has one channel; remove the column, or "
            "leave out --calibrated"
        )
    known = None if rig is None else read_toml(rig, RigFile)
    files = [table, *([] if rig is None else [rig])]
    try:
        optics, notes = _optics(read, known, rig, options, files)
    except FieldError as error:
        raise ImportFormatError(f"{table}: {error}") from None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _bands(read, optics, options, notes), files
    except FieldError:  # a covariance that is not positive definite
        raise ImportFormatError(
            f"{table}: the standard uncertainties of single values are too small beside those that all values share "
            "(of the white reference and of the readings at the laser's filter); correct the columns that end in _sd"
        ) from None


def _checked(options: SignalOptions | None) -> SignalOptions:
    """Return the options with paths for files; refuse what no setting of a rig refuses."""
    if options is None:
        return SignalOptions()
    if not isinstance(options, SignalOptions):
        raise ImportFormatError(
            "options: must be None or a SignalOptions, such as SignalOptions(laser_nm=450.0), got "
            f"{type(options).__name__}"
        )
    energy_yield: Any = options.assumed_yield
    is_number, name = isinstance(energy_yield, Real) and not isinstance(energy_yield, bool), options.paint_name
    if energy_yield is not None and not (is_number and 0.0 < energy_yield <= 1.0):
        raise ImportFormatError(
            f"--assume-yield: must be a number above 0 and at most 1 (emitted / incident energy), got {energy_yield!r}"
        )
    if not isinstance(name, str | None):
        raise ImportFormatError(f"--paint-name: must be text, got type {type(name).__name__}")
    response = None if options.response is None else given_path(options.response, "--response")
    if options.calibrated and response is not None:
        raise ImportFormatError(
            "--response is given with --calibrated, but readings of a calibrated spectrometer hold no response of the "
            "detector; leave one of them out"
        )
    lamp = None if options.lamp is None else str(given_path(options.lamp, "--lamp"))
    return replace(options, response=response, lamp=lamp)


@contextmanager
def _naming_options(**options: str) -> Iterator[None]:
    """Name the option in place of the setting that it replaces, in errors of a setting."""
    try:
        yield
    except FieldError as error:
        told = re.sub(r"^'?(\w+)'?", lambda found: options.get(found[1], found[0]), str(error))
        raise ImportFormatError(told) from None


def _optics(
    table: SignalTable, rig: RigFile | None, rig_path: Path | None, options: SignalOptions, files: list[Path]
) -> tuple[Optics, list[str]]:
    """Return the curves of filters, lights and detector, and notes on them; add the files that are read."""
    folder = Path() if rig_path is None else rig_path.parent
    laser = _laser(table, rig, options)
    if table.describes_filters:
        filters, curves = _described_filters(table, options, files)
    else:
        filters = _named_filters(table, rig, rig_path, options)
    filters, excitation = _with_excitation(table, filters, rig, laser)
    if not table.describes_filters:
        curves = read_filter_curves(filters, folder)
        files += [folder / band.curve for band in filters if band.curve is not None]
    stated, lamp_folder = LampSettings() if rig is None else rig.lamp, folder if options.lamp is None else Path()
    if options.lamp is not None:
        with _naming_options(spectrum="--lamp"):
            stated = LampSettings(spectrum=options.lamp, temperature_uncertainty_k=stated.temperature_uncertainty_k)
    lamp = lamp_curve(stated, lamp_folder)
    files += [lamp_folder / stated.spectrum] if stated.spectrum.endswith(".csv") else []
    response, note = _response(table, rig, folder, options, files)
    # where white follows from the curves, no lamp was used
    no_lamp = options.calibrated and not table.has("white_lamp")
    optics = Optics(
        filters=filters,
        excitation_filter=excitation,
        laser=laser,
        lamp=lamp,
        lamp_temperature_k=stated.temperature_k,
        lamp_temperature_uncertainty_k=0.0 if no_lamp else stated.temperature_uncertainty_k,
        white_reference=_white(rig, options),
        band_uncertainty=BandUncertainty() if rig is None else rig.band_uncertainty,
        camera_response=response,
        filter_curves=curves,
    )
    return optics, [*note, *coverage_notes(filters, curves, (*response, lamp))]


def _laser(table: SignalTable, rig: RigFile | None, options: SignalOptions) -> LaserSettings:
    """Return the laser of the options, or of the rig."""
    if options.laser_nm is None and rig is None:
        raise ImportFormatError(
            f"{table.path}: the wavelength of the laser is not known; give --rig RIG, or --laser-nm (nm)"
        )
    stated = LaserSettings() if rig is None else rig.laser
    with _naming_options(wavelength_nm="--laser-nm", fwhm_nm="--laser-fwhm-nm"):
        laser = LaserSettings(
            wavelength_nm=stated.wavelength_nm if options.laser_nm is None else options.laser_nm,
            fwhm_nm=stated.fwhm_nm if options.laser_fwhm_nm is None else options.laser_fwhm_nm,
            power_mw=stated.power_mw,
            laser_class=stated.laser_class,
        )
    require_line(table.path, laser)
    return laser


def _white(rig: RigFile | None, options: SignalOptions) -> WhiteReference:
    """Return the white reference of the options, or of the rig."""
    stated = WhiteReference() if rig is None else rig.white_reference
    given = {"reflectance": options.white_reflectance, "uncertainty_rel": options.white_uncertainty_rel}
    with _naming_options(reflectance="--white-reflectance", uncertainty_rel="--white-uncertainty-rel"):
        return WhiteReference(**{**stated.model_dump(), **{k: v for k, v in given.items() if v is not None}})


def _named_filters(
    table: SignalTable, rig: RigFile | None, rig_path: Path | None, options: SignalOptions
) -> tuple[BandPassFilter, ...]:
    """Return the filters of the rig that the rows name, in the order of the wheel."""
    if rig is None or options.calibrated:
        why = "no rig file is given" if rig is None else "--calibrated needs the transmission of the integrals"
        raise ImportFormatError(
            f"{table.path}: has no column that describes the filters, but {why}; add the columns center_nm and fwhm_nm "
            f"(nm), or curve (a CSV file){', or give --rig RIG' if rig is None else ''}"
        )
    known = {band.name: band for band in rig.filter_wheel.filters}
    for row in table.rows:
        if row.filter_name not in known:
            raise ImportFormatError(
                f"{table.path}, line {row.line}, column 'filter': '{row.filter_name[:60]}' is not a filter of "
                f"{rig_path}; valid names are {', '.join(known)}. Correct the name, or add the columns center_nm and "
                "fwhm_nm (nm)"
            )
    return tuple(sorted((known[name] for name in table.names), key=lambda band: band.slot))


def _described_filters(
    table: SignalTable, options: SignalOptions, files: list[Path]
) -> tuple[tuple[BandPassFilter, ...], dict[str, SpectralCurve]]:
    """Return the filters that the table describes, by increasing wavelength, and their measured curves."""
    given = []
    for name in table.names:
        rows = [row for row in table.rows if row.filter_name == name]
        data = _one_description(table.path, rows)
        try:
            given.append(ImportedFilter(**({"name": name} | (_EXACT if options.calibrated else {}) | data)))
        except FieldError as error:
            raise ImportFormatError(f"{table.path}, line {rows[0].line}: {error}") from None
    files += [curve_inside(table.path, one.curve) for one in given if one.curve is not None]
    curves = filter_curves_of(table.path.parent, given)
    found = sorted(wheel_of(table.path, given, curves).filters, key=lambda band: (band.center_nm, band.name))
    peak = {"peak_transmission": 1.0} if options.calibrated else {}
    return tuple(band.model_copy(update={"slot": slot, **peak}) for slot, band in enumerate(found, 1)), curves


def _one_description(path: Path, rows: Sequence[SignalRow]) -> dict[str, Any]:
    """Return what the rows of one filter say of it; an empty cell says nothing, and no two may differ."""
    data: dict[str, Any] = {}
    for row in rows:
        told = {name: row.numbers[name] for name in FILTER_DATA if name in row.numbers}
        for name, value in (*told.items(), *([("curve", row.curve)] if row.curve else [])):
            if data.setdefault(name, value) != value:
                raise ImportFormatError(
                    f"{path}, line {row.line}, column '{name}': is {value}, but {data[name]} in another row of filter "
                    f"'{row.filter_name}'; give the same value in all its rows"
                )
    return data


def _with_excitation(
    table: SignalTable, filters: tuple[BandPassFilter, ...], rig: RigFile | None, laser: LaserSettings
) -> tuple[tuple[BandPassFilter, ...], str]:
    """Return the filters with the one that passes the laser, which the rig may add, and its name."""

    def off_nm(band: BandPassFilter) -> float:
        return abs(band.center_nm - laser.wavelength_nm)

    of_rig = () if rig is None or table.describes_filters else rig.filter_wheel.filters
    for bands in (filters, of_rig):
        passing = [band for band in bands if off_nm(band) <= 0.5 * (band.fwhm_nm + laser.fwhm_nm)]
        if passing:
            found = min(passing, key=off_nm)
            every = filters if found in filters else (*filters, found)
            return tuple(sorted(every, key=lambda band: band.slot)), found.name
    raise ImportFormatError(
        f"{table.path}: no filter passes the laser at {laser.wavelength_nm:g} nm; correct the laser's wavelength, or "
        "add a row for the filter that passes it (without readings if none were taken)"
    )


def _response(
    table: SignalTable, rig: RigFile | None, folder: Path, options: SignalOptions, files: list[Path]
) -> tuple[tuple[SpectralCurve, SpectralCurve, SpectralCurve], list[str]]:
    """Return the response of the detector's channels, three times the same for one channel, and a note on it."""
    files += [] if options.response is None else [options.response]
    if len(table.channels) == 1:
        said = "the response of the detector is assumed to be flat within each filter"
        return one_channel(options.response), [] if options.calibrated or options.response else [said]
    if options.response is not None:
        return read_camera_response(options.response), []
    if rig is None or rig.camera.response == "assumed":
        return assumed_camera_response(), ["the camera response is assumed"]
    files.append(folder / rig.camera.response)
    return camera_response(rig.camera.response, folder), []


class _Signals(NamedTuple):
    """Values (B, C), their covariance over the flattened index, and which can be used."""

    values: Floats
    covariance: Floats
    usable: NDArray[np.bool_]


def _bands(table: SignalTable, optics: Optics, options: SignalOptions, notes: list[str]) -> BandSignals:
    """Return the record."""
    notes = [f"from the table {table.path.name}; laser dose unknown", *notes]
    readings = None if "fluorescence" in table.header else _readings(table, optics, options, notes)
    if readings is None and (lone := next(filter(table.has, READINGS), None)) is not None:
        raise ImportFormatError(
            f"{table.path}: has readings in the column '{lone}' beside 'fluorescence', whose values are already "
            "referred to the white reference; remove them, and give the paint under the lamp as 'reflectance'"
        )
    rho = _reflectance(table, readings, optics, notes)
    if readings is None:
        weights, y, measured = _given_weights(table, optics), _given_ratios(table, "fluorescence", optics), True
        _require_less_reflected(table, y, weights, optics)
    else:
        _require_less_than_white(table, readings, optics)
        level, y = _fluorescence(table, readings, optics, options, notes)
        weights, measured = level.weights, level.is_measured
    if not all(np.isfinite(part).all() for part in (*y, *rho)):
        raise ImportFormatError(
            f"{table.path}: the ratios of the readings are too large or too small to be computed with; check for a "
            "white reference that is nearly 0"
        )
    three = len(table.channels) == len(CHANNELS)
    return BandSignals(
        paint_name=(options.paint_name or table.path.stem) + ("" if measured else ", yield assumed"),
        optics=optics,
        fluorescence=_in_channels(np.where(y.usable, y.values, 0.0)),
        fluorescence_covariance=_covariance_in_channels(y.covariance, y.usable),
        reflectance=_in_channels(np.where(y.usable, rho.values, 0.0)),
        reflectance_covariance=_covariance_in_channels(rho.covariance, y.usable),
        channel_weights=weights if three else np.eye(3)[_GREEN],
        flags=tuple(_three_flags(row) for row in y.usable),
        saturated_fraction=np.zeros((len(optics.filters), 3)),
        region_pixels=1,
        notes=tuple(notes),
    )


def _readings(table: SignalTable, optics: Optics, options: SignalOptions, notes: list[str]) -> Readings:
    """Return the readings without their dark; say which filters cannot be used."""
    dark = np.nan_to_num(table.column("dark", optics.filters))
    value = {name: table.column(name, optics.filters) - dark for name in READINGS[:-1]}
    sd = {name: np.nan_to_num(table.column(f"{name}_sd", optics.filters)) for name in READINGS[:-1]}
    notes += _without_dark(table)
    computed = options.calibrated and not table.has("white_lamp")
    if computed:
        value["white_lamp"] = _white_of_curves(optics, len(table.channels))
    elif not table.has("white_lamp"):
        raise ImportFormatError(
            f"{table.path}: has no reading in the column 'white_lamp' (white reference under the lamp), without which "
            "the filters' transmissions do not cancel; add the readings, or give --calibrated if the readings are "
            "integrals of spectral radiance over each filter's transmission, as a calibrated spectrometer gives them"
        )
    dark_sd = np.nan_to_num(table.column("dark_sd", optics.filters))
    white = value["white_lamp"]
    noise = np.hypot(sd["white_lamp"], 0.0 if computed else dark_sd)
    good = np.isfinite(white) & (white > 0) & (white >= LEAST_WHITE_SNR * noise)
    readings = Readings(value, sd, dark_sd, good, computed)
    notes += _unused(table, readings, optics)
    if not readings.usable.any():
        raise ImportFormatError(
            f"{table.path}: {notes[-1]}, and no other filter can be used; give the readings of paint_laser and "
            "white_lamp in each row"
        )
    return readings


def _without_dark(table: SignalTable) -> list[str]:
    """Say of which filters no dark reading is subtracted."""
    if not table.has("dark"):
        return ["no dark readings: the readings are taken as they are, without the light of the dark subtracted"]
    rows = [row for row in table.rows if "dark" not in row.numbers and not row.numbers.keys().isdisjoint(READINGS)]
    names = ", ".join(dict.fromkeys(row.filter_name for row in rows))
    return [f"no dark reading of filters {names}: their readings are taken as they are"] if rows else []


def _unused(table: SignalTable, readings: Readings, optics: Optics) -> list[str]:
    """Say which filters and channels cannot be used, and why."""
    told = []
    for b, band in enumerate(optics.filters):
        for c, channel in enumerate(table.channels):
            if readings.usable[b, c]:
                continue
            why = f"its white under the lamp is not above {LEAST_WHITE_SNR:g} standard uncertainties"
            if not np.isfinite(readings.value["white_lamp"][b, c]):
                why = "it has no reading of the white reference under the lamp"
            if not np.isfinite(readings.value["paint_laser"][b, c]):
                why = "it has no reading of the paint under the laser"
            told.append(f"filter {band.name}{' ' + channel if channel else ''} is not used, because {why}")
    return told


def _white_of_curves(optics: Optics, channels: int) -> Floats:
    """Return what a white reference under the lamp would give, (B, C), from the curves alone."""
    lit = optics.white_reference.reflectance * optics.lamp(WAVELENGTH_NM)
    response = np.array([curve(WAVELENGTH_NM) for curve in optics.camera_response[:channels]])
    return np.asarray((transmissions(optics)[:, None, :] * response * lit).sum(axis=2))


def _require_less_than_white(table: SignalTable, readings: Readings, optics: Optics) -> None:
    """Refuse paint that reflects more of the laser than white does: the readings have two units."""
    e = _excitation(optics)
    paint, white = readings.value["paint_laser"][e], readings.value["white_laser"][e]
    sd = np.hypot(readings.sd["paint_laser"][e], LARGEST_REFLECTANCE * readings.sd["white_laser"][e])
    # false where one was not measured
    more = np.flatnonzero((white > 0) & (paint > LARGEST_REFLECTANCE * white + 3 * sd))
    if more.size:
        c = int(more[0])
        raise ImportFormatError(
            f"{table.path}, filter '{optics.excitation_filter}': the paint reads {paint[c]:g} under the laser, more "
            f"than {LARGEST_REFLECTANCE:g} times the {white[c]:g} of the white reference, but no paint reflects more "
            "of the laser than white does; give paint_laser and white_laser in the same unit (of the same exposure "
            "time, amplification and laser power)"
        )


def _require_less_reflected(table: SignalTable, y: _Signals, weights: Floats, optics: Optics) -> None:
    """Refuse ratios by which the paint reflects more of the laser than white does: they are in per cent."""
    e, n = _excitation(optics), weights.size
    used = np.where(y.usable[e], weights, 0.0)
    block = slice(n * e, n * (e + 1))
    reflected, sd = float(used @ y.values[e]), float(np.sqrt(used @ y.covariance[block, block] @ used))
    if reflected > LARGEST_REFLECTANCE + 3 * sd:
        raise ImportFormatError(
            f"{table.path}, filter '{optics.excitation_filter}': the paint is {reflected:g} times as bright as white "
            f"under the laser, but at most {LARGEST_REFLECTANCE:g} times is allowed; give 'fluorescence' as a fraction "
            "instead of per cent, and referred to white under the laser"
        )


def _fluorescence(
    table: SignalTable, readings: Readings, optics: Optics, options: SignalOptions, notes: list[str]
) -> tuple[LaserLevel, _Signals]:
    """Return the level of the laser and the signals referred to it."""
    e = _excitation(optics)
    level = level_of_readings(readings, e)
    if level is not None and options.assumed_yield is not None:
        raise ImportFormatError(f"--assume-yield has no effect, because {table.path} has 'white_laser'; leave it out")
    if level is None:
        _require_unmeasured(table, readings, optics, options)
        level = _assumed_level(readings, optics, options.assumed_yield or 0.0)
        notes.append(
            "the white reference under the laser was not measured (white_laser): the shape of the emission is "
            "measured, but its yield, peak and the reflectance at the laser follow from an assumed yield of about "
            f"{options.assumed_yield:g}"
        )
        if not level.value > 0.0:
            raise ImportFormatError(
                f"{table.path}: the emission has no area, so that no level gives it the assumed yield; give readings "
                "of paint_laser of two or more filters beside the laser's, at least one of them above the dark"
            )
    else:
        _require_known_level(table, readings, level, optics)
    y, covariance = fluorescence_of_readings(readings, e, level, optics.white_reference)
    return level, _Signals(y, covariance, readings.usable)


def _require_known_level(table: SignalTable, readings: Readings, level: LaserLevel, optics: Optics) -> None:
    """Refuse a level of the laser that is too uncertain to divide by, as white under the lamp may not be."""
    e = _excitation(optics)
    sd = np.hypot(np.nan_to_num(readings.sd["white_laser"][e]), readings.dark_sd[e])
    sd_rel = float(np.linalg.norm(level.weights * sd / readings.white[e])) / level.value
    if sd_rel > 1 / LEAST_WHITE_SNR:
        raise ImportFormatError(
            f"{table.path}, filter '{optics.excitation_filter}': the level of the laser is known to "
            f"{100 * sd_rel:.3g} %, but must be known to {100 / LEAST_WHITE_SNR:g} % or better, because all values are "
            "divided by it; give the mean of more readings of white_laser"
        )


def _require_unmeasured(table: SignalTable, readings: Readings, optics: Optics, options: SignalOptions) -> None:
    """Refuse a white reference under the laser that is not above 0, and none without a yield to assume in its place."""
    e = _excitation(optics)
    white = readings.value["white_laser"][e]
    where = f"{table.path}, filter '{optics.excitation_filter}'"
    if np.isfinite(white).any() and readings.white_is_good[e].any():
        raise ImportFormatError(
            f"{where}: the white reference under the laser reads {np.nanmax(white):g} without its dark, but must be "
            "above 0; correct white_laser or dark"
        )
    if options.assumed_yield is None:
        missing = "white_lamp" if np.isfinite(white).any() else "white_laser"
        raise ImportFormatError(
            f"{where}: has no usable reading in the column '{missing}', without which the level of the laser, and so "
            "the yield of the paint, is not known; add the reading, or give --assume-yield Y (emitted over incident "
            "energy, such as 0.2) if you need only the shape of the emission: the paint's name then says so"
        )


def _assumed_level(readings: Readings, optics: Optics, energy_yield: float) -> LaserLevel:
    """Return the level of the laser at which the emission, joined between the filters, has this yield."""
    usable, three = readings.usable, readings.usable.shape[1] == len(CHANNELS)
    columns = list(range(len(CHANNELS))) if three else [_GREEN]
    at_laser = np.array([optics.camera_response[c](optics.laser.wavelength_nm) for c in columns])
    weights = np.eye(len(columns))[int(at_laser.argmax())]
    known = rig_emission_weights(optics, weights if three else np.eye(3)[_GREEN])
    ratio = np.where(usable, readings.value["paint_laser"], 0.0) / readings.white
    per_nm = ratio / known.emission.sum(axis=1).reshape(-1, 3)[:, columns]
    emission = [
        (band.center_nm, max(float(per_nm[b][usable[b]].mean()), 0.0))
        for b, band in enumerate(optics.filters)
        if b != _excitation(optics) and usable[b].any()
    ]
    centers_nm, values = np.array(sorted(emission)).reshape(-1, 2).T
    level = float(np.trapezoid(values, centers_nm)) / energy_yield
    return LaserLevel(weights, level)


def _given_ratios(table: SignalTable, name: str, optics: Optics) -> _Signals:
    """Return values that the table holds as ratios to the white reference."""
    values, sd = table.column(name, optics.filters), table.column(f"{name}_sd", optics.filters)
    usable = np.isfinite(values)
    flat = np.nan_to_num(values).ravel()
    common = optics.white_reference.uncertainty_rel**2 * np.outer(flat, flat)
    return _Signals(np.nan_to_num(values), np.diag(np.nan_to_num(sd).ravel() ** 2) + common, usable)


def _given_weights(table: SignalTable, optics: Optics) -> Floats:
    """Return the weights of the channels in the level of the laser, from the row of the laser's filter."""
    if len(table.channels) == 1:
        return np.ones(1)
    weights = table.column("laser_weight", optics.filters)[_excitation(optics)]
    # sums of numbers that were written with three digits
    if not np.isfinite(weights).all() or abs(weights.sum() - 1) > 0.005:
        raise ImportFormatError(
            f"{table.path}, filter '{optics.excitation_filter}': laser_weight must be given for red, green and blue, "
            "with sum 1: the weights of the channels in the level of the laser to which 'fluorescence' is referred"
        )
    return np.asarray(weights / weights.sum())


def _reflectance(table: SignalTable, readings: Readings | None, optics: Optics, notes: list[str]) -> _Signals:
    """Return the total radiance factor under the lamp; where it was not measured, anything from 0 to 1."""
    shape = (len(optics.filters), len(table.channels))
    if table.has("reflectance"):
        found = _given_ratios(table, "reflectance", optics)
    elif readings is not None and table.has("paint_lamp"):
        if readings.white_is_computed:
            raise ImportFormatError(
                f"{table.path}: has readings in the column 'paint_lamp', but none of the white reference under the "
                "lamp to refer them to; add 'white_lamp', or give the ratio in the column 'reflectance'"
            )
        found = _Signals(*reflectance_of_readings(readings, optics.white_reference))
    else:
        found = _Signals(np.zeros(shape), np.zeros((shape[0] * shape[1],) * 2), np.zeros(shape, dtype=bool))
    most = float(found.values[found.usable].max(initial=0.0))
    if most > LARGEST_RADIANCE_FACTOR:
        raise ImportFormatError(
            f"{table.path}: the reflectance under the lamp is {most:g}, but at most {LARGEST_RADIANCE_FACTOR:g} times "
            "that of white is allowed; give fractions instead of per cent, and paint_lamp and white_lamp in the same "
            "unit"
        )
    if not found.usable.any():
        notes.append(
            "the paint under the lamp was not measured (paint_lamp or reflectance): its reflectance is not known, and "
            "counts as anything from 0 to 1"
        )
    unknown = ~found.usable
    covariance = found.covariance * np.outer(found.usable, found.usable)
    covariance += np.diag(unknown.ravel() * UNKNOWN_REFLECTANCE_SD**2)
    return _Signals(np.where(unknown, UNKNOWN_REFLECTANCE, found.values), covariance, found.usable)


def _excitation(optics: Optics) -> int:
    """Return the index of the filter that passes the laser."""
    return [band.name for band in optics.filters].index(optics.excitation_filter)


def _in_channels(values: Floats) -> Floats:
    """Return (B, C) values in the three columns of the record."""
    if values.shape[1] == len(CHANNELS):
        return values
    three = np.zeros((len(values), len(CHANNELS)))
    three[:, _GREEN] = values[:, 0]
    return three


def _covariance_in_channels(covariance: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Return a covariance over the three columns of the record; what is not used has a variance of 1."""
    n, channels = usable.shape
    place = np.arange(n * channels) if channels == len(CHANNELS) else len(CHANNELS) * np.arange(n) + _GREEN
    kept = usable.ravel()
    three = np.eye(len(CHANNELS) * n)
    three[np.ix_(place[kept], place[kept])] = covariance[np.ix_(kept, kept)]
    return three


def _three_flags(usable: NDArray[np.bool_]) -> tuple[Flag, Flag, Flag]:
    """Return the flags of a filter; channels that a detector does not have are weak."""
    told: list[Flag] = ["ok" if good else "weak" for good in usable]
    return (told[0], told[1], told[2]) if len(told) == len(CHANNELS) else ("weak", told[0], "weak")
