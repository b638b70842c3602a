"""A paint's posterior as netCDF in the layout of ArviZ InferenceData: opens with ``arviz.from_netcdf``."""

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import MissingExtraError, PaintCalibration, Provenance, provenance
from finray_calib.exchange._paint_spectra import PaintSpectra, paint_spectra

if TYPE_CHECKING:
    from xarray import Dataset


Floats = NDArray[np.float64]
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
        xarray or h5netcdf is not installed.
    """
    try:
        import_module(ENGINE)  # without it xarray fails later and less clearly
        from xarray import DataTree
    except ImportError:
        raise MissingExtraError(
            "export to netcdf needs xarray and h5netcdf: pip install 'finray-calib[netcdf]'"
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
        raise MissingExtraError("to_inferencedata needs ArviZ and xarray: pip install arviz xarray") from None
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
