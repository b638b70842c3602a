"""Filters, camera response and lamp of an imported folder of band images."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.curve_files import read_camera_response, read_filter_curve, read_table
from data_schemas.curves import SpectralCurve
from data_schemas.devices import FilterWheelSettings
from data_schemas.errors import CurveError
from data_schemas.filter_curves import half_maximum_nm
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.exchange.band_folder_file import BandFolder, ImportedFilter
from finray_calib.exchange.led_camera_json import read_light

DESCRIPTION_NAME = "bands.toml"
HALOGEN = "planck-2856K"
MONOCHROME_COLUMNS = ["wavelength_nm", "response_percent"]


def require_inside(folder: Path, description: BandFolder) -> None:
    """Refuse curve files outside of the folder, as for images: a folder from elsewhere must not read others.

    Raises
    ------
    CurveError
        A curve's path is absolute or leads out of the folder.
    """
    for name in named_files(description):
        if not (folder / name).resolve().is_relative_to(folder.resolve()):
            raise CurveError(f"{folder / DESCRIPTION_NAME}: {name!r} leads out of the folder; put the curve beside it")


def filter_curves_of(folder: Path, description: BandFolder) -> dict[str, SpectralCurve]:
    """Return the measured transmissions of the filters that name one, by the filter's name."""
    return {given.name: read_filter_curve(folder / given.curve) for given in description.filters if given.curve}


def wheel_of(folder: Path, description: BandFolder, curves: Mapping[str, SpectralCurve]) -> FilterWheelSettings:
    """Return the filters, with centre and width of their measured curves where they have one, as those of a wheel.

    Raises
    ------
    CurveError
        A curve holds no whole pass band, or two filters are the same.
    """
    try:
        filters = tuple(
            _filter(slot, given, curves.get(given.name)) for slot, given in enumerate(description.filters, 1)
        )
        return FilterWheelSettings(filters=filters)
    except ValidationError as error:
        fault = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CurveError(f"{folder / DESCRIPTION_NAME}, filters: {fault}; are all wavelengths in nm?") from None


def _filter(slot: int, given: ImportedFilter, curve: SpectralCurve | None) -> BandPassFilter:
    """Return a filter by its nominal values, or by centre and width of its measured curve."""
    known = given.model_dump(exclude_none=True)
    if curve is not None:
        low_nm, high_nm = half_maximum_nm(curve)
        known |= {"center_nm": 0.5 * (low_nm + high_nm), "fwhm_nm": high_nm - low_nm}
    return BandPassFilter.model_validate({"slot": slot, **known})


def response_of(folder: Path, description: BandFolder) -> tuple[SpectralCurve, SpectralCurve, SpectralCurve]:
    """Return the camera's response; three times the same for a monochrome camera."""
    camera = description.camera
    if camera.layout != "monochrome":
        return (
            assumed_camera_response()
            if camera.response == "assumed"
            else read_camera_response(folder / camera.response)
        )
    if camera.response == "assumed":
        one = SpectralCurve(
            name="monochrome", wavelength_nm=np.array([380.0, 780.0]), values=np.ones(2), source="assumed flat"
        )
    else:
        one = _monochrome_response(folder / camera.response)
    return one, one, one


def _monochrome_response(path: Path) -> SpectralCurve:
    """Read the response of a monochrome camera, 0..1."""
    header, table = read_table(path)
    if header != MONOCHROME_COLUMNS:
        raise CurveError(
            f"{path}: header is {','.join(header)[:80]}; a monochrome response needs {','.join(MONOCHROME_COLUMNS)}"
        )
    if (table[:, 1] < 0).any() or not table[:, 1].any():
        raise CurveError(f"{path}: response_percent must be 0 or more and somewhere above 0")
    try:
        return SpectralCurve(name="monochrome", wavelength_nm=table[:, 0], values=table[:, 1] / 100, source=path.name)
    except ValidationError as error:
        raise CurveError(f"{path}: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from None


def lamp_of(folder: Path, description: BandFolder) -> SpectralCurve:
    """Return the lamp's relative spectral power."""
    return halogen_lamp() if description.lamp == HALOGEN else read_light(folder / description.lamp)


def named_files(description: BandFolder) -> list[str]:
    """Return the names of the description and of the curve files that it refers to."""
    named = [f.curve for f in description.filters]
    named.append(None if description.camera.response == "assumed" else description.camera.response)
    named.append(None if description.lamp == HALOGEN else description.lamp)
    return [DESCRIPTION_NAME, *(name for name in named if name is not None)]
