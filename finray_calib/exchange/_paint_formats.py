"""The formats in which a calibrated paint leaves finray: the register of all, and those that are text or netCDF.

Text are CSV with intervals, the spectrum file of Mitsuba, one small, plain JSON object that explains itself to programs
that know nothing of finray, and an IES TM-27-14 file (.spdx) by way of a spectral distribution of colour-science. The
posterior leaves as netCDF in the layout of ArviZ InferenceData: it opens with ``arviz.from_netcdf``.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import Estimate, MissingExtraError, PaintCalibration, Provenance, SpectralCurve, provenance
from finray_calib.exchange._paint_reradiation import (
    CameraResponse,
    PaintSpectra,
    led_camera_json,
    paint_spectra,
    readable_json,
)

if TYPE_CHECKING:
    from colour import SpectralDistribution
    from xarray import Dataset


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
        f"quantity: {QUANTITY}, for excitation at {laser_nm:g} nm; its integral is emitted / incident energy",
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
    return _lines((*origin_lines(paint, origin), *reflectance), (",".join(CSV_COLUMNS), *rows))


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
    return _lines(lines, (f"{wavelength_nm:g} {value:.7g}" for wavelength_nm, value in pairs))


def _lines(comments: tuple[str, ...], rows: tuple[str, ...] | Iterator[str]) -> str:
    """Join comment lines (a line break inside one would end it) and rows."""
    return "".join(f"# {' '.join(line.split())}\n" for line in comments) + "".join(f"{row}\n" for row in rows)


Floats = NDArray[np.float64]
DIGITS = 6


def json_text(paint: PaintCalibration, spectra: PaintSpectra, origin: Provenance) -> str:
    """Return emission, absorption and reflectance with 68 % and 95 % limits, and the parameters, as JSON.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    spectra
        Its curves.
    origin
        Provenance of the export.
    """
    low95, low68, high68, high95 = np.quantile(spectra.absorption_rel_draws, [0.025, 0.16, 0.84, 0.975], axis=0)
    content = {
        "what": "fluorescent paint: emission, absorption and reflectance with uncertainty",
        "paint": paint.paint_name,
        "family": paint.family_title,
        "family_choice": paint.family_choice,
        "warnings": list(paint.warnings),
        "model": "radiance factor per nm (energy): D(out, in) = emission_per_nm(out) * absorption_rel(in) * in / "
        "excitation_nm for out > in, else 0; reflectance is listed separately",
        "emission": {
            "quantity": QUANTITY,
            "excitation_nm": spectra.laser_nm,
            "wavelength_nm": _numbers(paint.wavelength_nm),
            "mean_per_nm": _numbers(paint.emission_per_nm),
            "low68_per_nm": _numbers(paint.emission_low68_per_nm),
            "high68_per_nm": _numbers(paint.emission_high68_per_nm),
            "low95_per_nm": _numbers(paint.emission_low95_per_nm),
            "high95_per_nm": _numbers(paint.emission_high95_per_nm),
        },
        "absorption": {
            "quantity": "photons absorbed relative to those at the laser line",
            "statement": spectra.statement,
            "excitation_nm": _numbers(spectra.excitation_nm),
            "mean_rel": _numbers(spectra.absorption_rel),
            "low68_rel": _numbers(low68),
            "high68_rel": _numbers(high68),
            "low95_rel": _numbers(low95),
            "high95_rel": _numbers(high95),
        },
        "reflectance": [
            {"center_nm": band.center_nm, "filter": band.name, **_estimate(value)}
            for band, value in zip(paint.optics.filters, paint.reflectance, strict=True)
        ],
        "parameters": {name: _estimate(value) for name, value in paint.parameters.items()},
        "energy_yield": _estimate(paint.energy_yield),
        "provenance": origin.model_dump(mode="json"),
    }
    return readable_json(content)


def _numbers(values: Floats) -> list[float]:
    """Return the values rounded to what any uncertainty here can use."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _estimate(value: Estimate) -> dict[str, Any]:
    """Return median, standard deviation and limits."""
    return value.model_dump(mode="json")


def as_spectral_distribution(paint: PaintCalibration) -> "SpectralDistribution":
    """Return the mean emission as ``colour.SpectralDistribution`` (1/nm on a grid in nm).

    Parameters
    ----------
    paint
        Record written by ``finray fit``. The class holds no uncertainty.
    """
    from colour import SpectralDistribution

    pairs = dict(zip(paint.wavelength_nm.tolist(), paint.emission_per_nm.tolist(), strict=True))
    return SpectralDistribution(pairs, name=f"emission of {paint.paint_name}")


def spdx_bytes(paint: PaintCalibration, origin: Provenance) -> bytes:
    """Return the mean emission as an IES TM-27-14 XML file.

    The layout has no field for uncertainty nor a quantity for a radiance factor: the quantity is "other" and the
    comments say what it is and what is missing.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    origin
        Provenance of the export.
    """
    from colour import SpectralDistribution_IESTM2714

    missing = "missing here: uncertainty (export csv, json or netcdf)"
    with TemporaryDirectory() as folder:
        file = Path(folder) / "paint.spdx"
        distribution = SpectralDistribution_IESTM2714(
            str(file),
            data=as_spectral_distribution(paint),
            spectral_quantity="other",
            reflection_geometry="other",
            transmission_geometry="other",
            bandwidth_FWHM=float(paint.wavelength_nm[1] - paint.wavelength_nm[0]),
            bandwidth_corrected=True,
        )
        header = distribution.header
        header.description = f"emission of fluorescent paint {paint.paint_name}"
        header.document_creator = f"finray-calib {origin.package_version}"
        header.document_creation_date = origin.created_utc
        header.comments = "; ".join((*origin_lines(paint, origin), missing))
        for unknown in ("manufacturer", "catalog_number", "unique_identifier", "laboratory"):
            setattr(header, unknown, "unknown")
        for unknown in ("measurement_equipment", "report_number", "report_date"):
            setattr(header, unknown, "unknown")
        distribution.write()
        return file.read_bytes()


CHANNELS = ("red", "green", "blue")
REPLICATES = 1000
ENGINE: Final = "h5netcdf"
BAND_DIMENSIONS = ("filter", "channel")


def netcdf_bytes(paint: PaintCalibration, spectra: PaintSpectra, origin: Provenance, rng: np.random.Generator) -> bytes:
    """Return the posterior, the prior, the data and replicated data as one netCDF file of several groups.

    Groups: ``posterior`` and ``prior`` (sampled parameters by name), ``posterior_predictive`` (fluorescence,
    drawn from a normal of the stored mean and standard deviation: correlations between bands are not in the
    record), ``observed_data``, ``constant_data`` (which values the fit used, filters), ``sample_stats``
    (diagnostics per parameter), and ``emission_posterior`` (the curves with their own paired draws). There is
    one chain: the draws are of one merged sample.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    spectra
        Its curves.
    origin
        Provenance of the export; its command and input hashes become attributes.
    rng
        Source of the replicated data.

    Raises
    ------
    MissingExtraError
        xarray, h5netcdf or h5py is not installed.
    """
    try:
        for package in (ENGINE, "h5py"):  # without them xarray fails later and less clearly
            import_module(package)
        from xarray import DataTree
    except ImportError:
        raise MissingExtraError(
            "export to netcdf needs xarray, h5netcdf and h5py; install them with pip install 'finray-calib[netcdf]'"
        ) from None
    with TemporaryDirectory() as folder:
        file = Path(folder) / "paint.nc"
        DataTree.from_dict(_groups(paint, spectra, origin, rng)).to_netcdf(file, engine=ENGINE)
        return file.read_bytes()


def inference_data(paint: PaintCalibration, seed: int = 1) -> Any:
    """Return the same groups as an ``arviz.InferenceData``, for the record's method ``to_inferencedata()``.

    Parameters
    ----------
    paint
        Record of a fit.
    seed
        Of the replicated data.

    Raises
    ------
    MissingExtraError
        ArviZ or xarray is not installed.
    """
    try:
        import_module("xarray")
        arviz = import_module("arviz")
    except ImportError:
        raise MissingExtraError(
            "to_inferencedata needs ArviZ and xarray; install them with pip install arviz xarray"
        ) from None
    origin = paint.provenance or provenance("finray_calib, from Python")
    groups = _groups(paint, paint_spectra(paint), origin, np.random.default_rng(seed))
    return arviz.InferenceData(**groups)


def _groups(
    paint: PaintCalibration, spectra: PaintSpectra, origin: Provenance, rng: np.random.Generator
) -> "dict[str, Dataset]":
    """Return group -> data set, with its attributes."""
    groups = {
        "posterior": _parameters(paint, paint.draws),
        "prior": _parameters(paint, paint.prior_draws),
        "posterior_predictive": _replicated(paint, rng),
        "observed_data": _dataset(paint, {"fluorescence": (BAND_DIMENSIONS, paint.measured)}),
        "constant_data": _constants(paint),
        "sample_stats": _diagnostics(paint),
        "emission_posterior": _curves(paint, spectra),
    }
    for dataset in groups.values():
        dataset.attrs |= _attributes(paint, origin)
    return groups


def _attributes(paint: PaintCalibration, origin: Provenance) -> dict[str, str]:
    """Return the attributes of a group: ArviZ's own names where it has one."""
    return {
        "created_at": origin.created_utc,
        "inference_library": "finray-calib",
        "inference_library_version": origin.package_version,
        "paint": paint.paint_name,
        "family": paint.family_title,
        "warnings": "; ".join(paint.warnings),
        "command": origin.command,
        "inputs": "; ".join(f"{name} SHA-256 {digest}" for name, digest in origin.input_sha256.items()),
    }


def _parameters(paint: PaintCalibration, draws: Floats) -> "Dataset":
    """Return draws (draw, parameter) as one variable per parameter over (chain, draw)."""
    from xarray import Dataset

    variables = {name: (("chain", "draw"), draws[None, :, i]) for i, name in enumerate(paint.sampled)}
    return Dataset(variables, coords={"chain": [0], "draw": np.arange(len(draws))})


def _dataset(paint: PaintCalibration, variables: dict[str, Any], **coordinates: Any) -> "Dataset":
    """Return variables over (filter, channel), with the filters named."""
    from xarray import Dataset

    names = [band.name for band in paint.optics.filters]
    return Dataset(variables, coords={"filter": names, "channel": list(CHANNELS), **coordinates})


def _replicated(paint: PaintCalibration, rng: np.random.Generator) -> "Dataset":
    """Return replicated band values: prediction and measurement noise, each value on its own."""
    sd = np.hypot(paint.predicted_sd, paint.measured_sd)
    draws = paint.predicted + sd * rng.standard_normal((1, REPLICATES, *sd.shape))
    variables = {"fluorescence": (("chain", "draw", *BAND_DIMENSIONS), draws)}
    return _dataset(paint, variables, chain=[0], draw=np.arange(REPLICATES))


def _constants(paint: PaintCalibration) -> "Dataset":
    """Return what the fit knew of the bands."""
    return _dataset(
        paint,
        {
            "usable": (BAND_DIMENSIONS, paint.usable.astype(np.int8)),
            "fluorescence_sd": (BAND_DIMENSIONS, paint.measured_sd),
            "center_nm": (("filter",), [band.center_nm for band in paint.optics.filters]),
            "fwhm_nm": (("filter",), [band.fwhm_nm for band in paint.optics.filters]),
        },
    )


def _diagnostics(paint: PaintCalibration) -> "Dataset":
    """Return the diagnostics: those per parameter as variables if emcee ran, single numbers as attributes."""
    from xarray import Dataset

    stored = paint.diagnostics.model_dump(exclude={"maxima"})
    chain = stored.pop("chain") or {}
    per_parameter = {"map_estimate": paint.map_estimate, **{k: v for k, v in chain.items() if isinstance(v, dict)}}
    single = {**stored, **{f"chain_{k}": v for k, v in chain.items() if not isinstance(v, dict)}}
    return Dataset(
        {
            name: (("parameter",), [float(values.get(p, np.nan)) for p in paint.sampled])
            for name, values in per_parameter.items()
        },
        coords={"parameter": list(paint.sampled)},
        attrs={key: _attribute(value) for key, value in single.items()},
    )


def _attribute(value: Any) -> Any:
    """Return a value as netCDF attributes know it: no booleans, NaN for what could not be estimated."""
    if value is None:
        return np.nan
    return int(value) if isinstance(value, bool) else value


def _curves(paint: PaintCalibration, spectra: PaintSpectra) -> "Dataset":
    """Return the paired draws of emission and absorption, and the reflectance."""
    from xarray import Dataset

    draws = np.arange(len(spectra.emission_draws_per_nm))
    names = [band.name for band in paint.optics.filters]
    return Dataset(
        {
            "emission_per_nm": (("chain", "draw", "wavelength_nm"), spectra.emission_draws_per_nm[None]),
            "absorption_rel": (("chain", "draw", "excitation_nm"), spectra.absorption_rel_draws[None]),
            "reflectance": (("filter",), [value.estimate for value in paint.reflectance]),
            "reflectance_sd": (("filter",), [value.sd for value in paint.reflectance]),
        },
        coords={
            "chain": [0],
            "draw": draws,
            "filter": names,
            "wavelength_nm": spectra.wavelength_nm,
            "excitation_nm": spectra.excitation_nm,
        },
        attrs={"statement": spectra.statement},
    )


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What some formats need beside the paint: lights and camera of the reduced matrix, seed of replicated data."""

    lights: Sequence[SpectralCurve]
    response: CameraResponse
    seed: int


def _csv(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return csv_text(paint, origin).encode()


def _json(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return json_text(paint, paint_spectra(paint), origin).encode()


def _netcdf(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return netcdf_bytes(paint, paint_spectra(paint), origin, np.random.default_rng(options.seed))


def _spdx(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return spdx_bytes(paint, origin)


def _mitsuba(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return mitsuba_text(paint, origin).encode()


def _rgb_reradiation(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    return led_camera_json(paint_spectra(paint), options.lights, options.response, origin).encode()


def _exr(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange._paint_reradiation import exr_bytes

    return exr_bytes(paint_spectra(paint), origin)


PaintFormat = Callable[[PaintCalibration, Provenance, ExportOptions], bytes]
PAINT_FORMATS: dict[str, PaintFormat] = {
    "csv": _csv,
    "json": _json,
    "netcdf": _netcdf,
    "spdx": _spdx,
    "mitsuba": _mitsuba,
    "rgb-reradiation": _rgb_reradiation,
    "exr": _exr,
}
