"""The arrays of any record as an xarray Dataset, with named dimensions, coordinates and units."""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from data_schemas import ArraySpec, MissingExtraError, Record, RecordError

if TYPE_CHECKING:
    from xarray import Dataset

CHANNELS = ("red", "green", "blue")
GRID_UNITS = "nm|deg|mm|s"


def record_dataset(record: Record) -> "Dataset":
    """Return the arrays of a record; numbers and words of it become attributes.

    Red, green and blue of a filter or a pixel lie along "channel"; another dimension of fixed length N without a name
    is "axis_N". An array along one dimension that is named after it (`wavelength_nm` along "wavelength", `grid_deg`) is
    its coordinate.

    Parameters
    ----------
    record
        Any record with arrays.

    Raises
    ------
    RecordError
        It holds no array.
    MissingExtraError
        xarray is not installed.
    """
    try:
        from xarray import Dataset
    except ImportError:
        raise MissingExtraError("to_xarray needs xarray: pip install 'finray-calib[netcdf]'") from None
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for name, field in type(record).model_fields.items():
        value = getattr(record, name)
        if not isinstance(value, np.ndarray):
            continue
        spec = _spec(field.annotation, field.metadata)
        dims = _dims(spec.dims if spec is not None else (), value.shape)
        attributes = {"units": spec.unit if spec is not None else "1"}
        if field.description:
            attributes["long_name"] = field.description
        is_grid = len(dims) == 1 and re.fullmatch(rf"({re.escape(dims[0])}s?|grid)_({GRID_UNITS})", name) is not None
        (coordinates if is_grid else variables)[name] = (dims, value, attributes)
        if "channel" in dims:
            coordinates["channel"] = (("channel",), np.array(CHANNELS), {})
    if not variables:
        raise RecordError(f"a {type(record).__name__} holds no array; its fields are plain numbers and words")
    return Dataset(variables, coords=coordinates, attrs=_attributes(record))


def _spec(annotation: Any, metadata: Iterable[Any] = ()) -> ArraySpec | None:
    """Return what is declared of an array, also of one that may be missing."""
    for item in (*metadata, *getattr(annotation, "__metadata__", ())):
        if isinstance(item, ArraySpec):
            return item
    return next((spec for inner in get_args(annotation) if (spec := _spec(inner)) is not None), None)


def _dims(names: tuple[str, ...], shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return one name for each dimension, no name twice."""
    found: list[str] = []
    for place, size in enumerate(shape):
        name = names[place] if place < len(names) else str(size)
        if name.isdigit():
            name = "channel" if name == "3" and found and found[-1] in {"filter", "column"} else f"axis_{name}"
        found.append(name if name not in found else f"{name}_{place}")
    return tuple(found)


def _attributes(record: Record) -> dict[str, Any]:
    """Return kind, numbers and words of a record, as netCDF attributes know them."""
    plain = {
        name: int(value) if isinstance(value, bool) else value
        for name in type(record).model_fields
        if isinstance(value := getattr(record, name), bool | int | float | str)
    }
    return {"kind": type(record).__name__, **plain}
