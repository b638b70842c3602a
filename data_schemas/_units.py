"""Fields of records: numbers with bounds and unit, and arrays of checked shape, dtype and finiteness.

Every number that crosses a file carries its bounds and its unit into the JSON Schema. One mechanical system: mm, N,
MPa, s. Angles in degrees, wavelengths in nm, camera signals in DN (raw counts) or e (electrons). Ratios (``Fraction``,
``RelativeUncertainty``) are 0..1 and never per cent.

An array is declared as ``Annotated[NDArray[np.float64], ArraySpec("f8", ("filter", "channel"), unit="DN/s")]``. In
Python it is a read-only numpy array; in a stored record it is a nested list when small, else a reference into the
record's ``.npz`` file (see :mod:`data_schemas.storage._records`). Dimensions of the same name must agree within a
model, which its base class checks (:func:`check_dimensions`).
"""

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema


def _unit(unit: str, **bounds: Any) -> Any:
    """Return a pydantic field with bounds and the unit as JSON Schema keyword."""
    return Field(json_schema_extra={"unit": unit}, allow_inf_nan=False, **bounds)


WavelengthNm = Annotated[float, _unit("nm", ge=200.0, le=2500.0)]
WidthNm = Annotated[float, _unit("nm", gt=0.0, le=1000.0)]
LengthMm = Annotated[float, _unit("mm", gt=0.0, le=1000.0)]
PositionMm = Annotated[float, _unit("mm", ge=-1000.0, le=1000.0)]
AngleDeg = Annotated[float, _unit("deg", ge=-180.0, le=180.0)]
ExposureS = Annotated[float, _unit("s", gt=0.0, le=3600.0)]
DurationS = Annotated[float, _unit("s", ge=0.0)]
EnergyJ = Annotated[float, _unit("J", ge=0.0)]
PowerMw = Annotated[float, _unit("mW", gt=0.0, le=1e5)]
SignalDn = Annotated[float, _unit("DN", ge=0.0, le=65535.0)]
ChargeE = Annotated[float, _unit("e", ge=0.0)]
Fraction = Annotated[float, _unit("1", ge=0.0, le=1.0)]
RelativeUncertainty = Annotated[float, _unit("1", ge=0.0, le=10.0)]
FilterUncertaintyNm = Annotated[float, _unit("nm", ge=0.0, le=10.0)]
TypeBUncertainty = Annotated[float, _unit("1", ge=1e-4, le=0.2)]
OpticalDensity = Annotated[float, _unit("1 (10^-OD)", ge=0.0, le=12.0)]
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]


_Scalar = TypeVar("_Scalar", bound=np.generic)
_JSON_TYPE = {"f": "number", "u": "integer", "i": "integer", "b": "boolean"}


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """What an array field must be.

    Attributes
    ----------
    dtype
        Numpy dtype string the values are converted to; a conversion that loses information is refused.
    dims
        Name of each dimension; an all-digit name is a fixed length.
    unit
        Unit of the values, written into the JSON Schema.
    allow_nan
        Whether NaN marks a missing value; otherwise all values must be finite.
    """

    dtype: str
    dims: tuple[str, ...]
    unit: str = "1"
    allow_nan: bool = False

    def validate(self, value: Any) -> NDArray[Any]:
        """Return `value` as a read-only array of the declared dtype and shape."""
        if isinstance(value, list):
            value = _nan_for_none(value, truths=np.dtype(self.dtype).kind == "b")
        array = np.asarray(value)
        if array.dtype.kind == "b" and np.dtype(self.dtype).kind != "b":
            raise ValueError("must be numbers, got true or false values")
        if array.dtype.kind not in "fuib":
            raise ValueError(f"must be numbers, got {array.dtype}")
        target = np.dtype(self.dtype)
        if array.dtype != target:
            converted = array.astype(target)
            if target.kind in "uib" and not np.array_equal(converted, array):
                raise ValueError(f"contains values that {target} cannot represent")
            array = converted
        if array.ndim != len(self.dims):
            raise ValueError(f"must have {len(self.dims)} dimensions ({', '.join(self.dims)}), got {array.ndim}")
        for name, size in zip(self.dims, array.shape, strict=True):
            if name.isdigit() and size != int(name):
                raise ValueError(f"must have shape ({', '.join(self.dims)}), got {array.shape}")
        if target.kind == "f" and not self.allow_nan and not np.isfinite(array).all():
            raise ValueError(f"must be finite, got {int((~np.isfinite(array)).sum())} NaN or infinite values")
        array = np.array(array, order="C", copy=True) if array.flags.writeable else array
        array.flags.writeable = False
        return array

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self.validate,
            serialization=core_schema.plain_serializer_function_ser_schema(_to_lists, when_used="json"),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Describe the stored form: nested lists, or a reference into the array file."""
        items: dict[str, Any] = {"type": _JSON_TYPE[np.dtype(self.dtype).kind]}
        if self.allow_nan:
            items = {"anyOf": [items, {"type": "null"}]}
        for name in reversed(self.dims):
            items = {"type": "array", "items": items}
            if name.isdigit():
                items |= {"minItems": int(name), "maxItems": int(name)}
        reference = {
            "type": "object",
            "properties": {
                "array": {"type": "string"},
                "shape": {"type": "array", "items": {"type": "integer"}},
                "dtype": {"const": self.dtype},
            },
            "required": ["array", "shape", "dtype"],
            "additionalProperties": False,
        }
        return {"anyOf": [items, reference], "unit": self.unit, "dimensions": list(self.dims)}


def check_dimensions(record: BaseModel, lists: Mapping[str, str]) -> None:
    """Refuse a record two of whose fields disagree on the length of a dimension of the same name.

    Parameters
    ----------
    record
        Its array fields carry an :class:`ArraySpec`; those that are None are left out.
    lists
        Field that is no array (dots lead into inner models) -> the dimension that it runs along; None is left out.

    Raises
    ------
    ValueError
        Two lengths differ; the message names both fields.
    """
    lengths = [(field, name, len(held)) for field, name in lists.items() if (held := _at(record, field)) is not None]
    seen: dict[str, tuple[int, str]] = {}
    for field, name, size in (*lengths, *_array_lengths(record)):
        length, owner = seen.setdefault(name, (size, field))
        if length != size:
            raise ValueError(
                f"'{field}' has {size} {('entry' if size == 1 else 'entries')} along '{name}', but '{owner}' has "
                f"{length}; the numbers must be equal"
            )


def _at(record: BaseModel, path: str) -> Any:
    """Return the value at a dotted path, None where the path leads through None."""
    value: Any = record
    for name in path.split("."):
        value = None if value is None else getattr(value, name)
    return value


def _array_lengths(record: BaseModel) -> Iterator[tuple[str, str, int]]:
    """Yield (field, dimension, length) of every array of a record."""
    for field, dims in _arrays_of(type(record)).items():
        array = getattr(record, field)
        if array is not None:
            yield from ((field, name, size) for name, size in zip(dims, array.shape, strict=True))


@functools.cache
def _arrays_of(model: type[BaseModel]) -> Mapping[str, tuple[str, ...]]:
    """Return array field -> names of its dimensions."""
    found = {}
    for field, info in model.model_fields.items():
        # the spec of an optional array stands inside the union
        inner = (m for part in get_args(info.annotation) for m in getattr(part, "__metadata__", ()))
        for spec in (m for m in (*info.metadata, *inner) if isinstance(m, ArraySpec)):
            found[field] = spec.dims
    return found


def _nan_for_none(value: Any, truths: bool) -> Any:
    """Replace None (how JSON stores NaN) by NaN in nested lists, where truth values are not numbers."""
    if isinstance(value, list):
        return [_nan_for_none(v, truths) for v in value]
    if isinstance(value, bool) and not truths:
        raise ValueError(f"must be numbers, got {value}")
    return np.nan if value is None else value


def _to_lists(array: NDArray[Any]) -> Any:
    """Return nested lists with None for NaN."""
    lists = array.tolist()
    return _none_for_nan(lists) if array.dtype.kind == "f" and np.isnan(array).any() else lists


def _none_for_nan(value: Any) -> Any:
    """Replace NaN by None in nested lists."""
    if isinstance(value, list):
        return [_none_for_nan(v) for v in value]
    return None if value != value else value


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return a view that cannot be written through; the caller's array stays writable."""
    view = array.view()
    view.flags.writeable = False
    return view


def bayer_planes(raw: NDArray[np.uint16] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the red, green (mean of its two pixels) and blue planes of an RGGB mosaic.

    Parameters
    ----------
    raw
        Mosaic of even height and width, shape (2h, 2w).

    Returns
    -------
    ndarray
        Shape (h, w, 3), half resolution, in the unit of `raw`.
    """
    values = np.asarray(raw, dtype=np.float64)
    green = 0.5 * (values[0::2, 1::2] + values[1::2, 0::2])
    return np.stack([values[0::2, 0::2], green, values[1::2, 1::2]], axis=-1)
