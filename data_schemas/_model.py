"""The base of every model that crosses a file or the command line: frozen, and unknown keys are errors.

With the estimate, one number with its uncertainty, :class:`PropagatedDraws`, what a function of the user makes of
posterior draws, and plain-language explanations of what is wrong with a record.
"""

import difflib
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from data_schemas._lazy_exports import call_record_method
from data_schemas._provenance import Provenance
from data_schemas._record_text import array_text, formatted_interval, interval_text, record_html, record_text
from data_schemas._units import check_dimensions
from data_schemas.errors import FieldError, RecordError

if TYPE_CHECKING:
    from xarray import Dataset

Floats = NDArray[np.float64]
_NUMBERS: Final = {"float", "int"}
_PLAIN_VALUES: Final = frozenset({float, int, bool, str, type(None)})
# Where pydantic's schema of a type holds those of its parts.
_PARTS: Final = ("schema", "fields", "items_schema", "choices", "keys_schema", "values_schema", "model_fields")


def _without_coercion(schema: Any) -> Any:
    """Return pydantic's schema of a type with numbers that take numbers only, and truth values that take these only."""
    if isinstance(schema, list | tuple):
        return type(schema)(_without_coercion(part) for part in schema)
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") in _NUMBERS:
        return core_schema.no_info_before_validator_function(_number, schema)
    if schema.get("type") == "bool":
        return {**schema, "strict": True}
    if "type" not in schema:  # names of fields
        return {name: _without_coercion(part) for name, part in schema.items()}
    return {**schema, **{part: _without_coercion(schema[part]) for part in _PARTS if part in schema}}


def _number(value: Any) -> Any:
    """Refuse what is not a number, although pydantic would make one of it."""
    if isinstance(value, bool | str | bytes):
        raise ValueError(f"must be a number, got {value!r}"[:120])
    if isinstance(value, Estimate | PropagatedDraws):  # float() would take the median, in whatever unit
        raise ValueError(
            f"must be a number, got {value} with an uncertainty; give its .estimate in the unit of the field"
        )
    return value


class _Size(str):
    """A text that stands for itself where a value is shown."""

    __slots__ = ()
    __repr__ = str.__str__


if TYPE_CHECKING:
    _MadeInPython = BaseModel
else:

    class _Type(type(BaseModel)):
        """Says what is wrong with the values of a model that is made in Python as of one that is read from a file."""

        def __call__(cls, *given: Any, **values: Any) -> Any:
            try:
                return super().__call__(*given, **values)
            except ValidationError as refused:
                told = explain(refused, cls)
            raise FieldError(told)

    class _MadeInPython(BaseModel, metaclass=_Type):
        """The same as pydantic's base in all else."""


class Model(_MadeInPython):
    """Frozen pydantic model; an unknown or misspelt key is an error, never a silent default.

    Raises
    ------
    FieldError
        When it is made with a value that is not allowed; the message names field, value and what is allowed.
    pydantic.ValidationError
        In its place by ``model_validate`` and ``model_validate_json``.

    Attributes
    ----------
    dimension_of
        Field that is no array (dots lead into inner models) -> the dimension of its arrays along which it runs.
    """

    dimension_of: ClassVar[Mapping[str, str]] = {}
    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=False, validate_default=True, defer_build=True
    )

    @model_validator(mode="after")
    def _dimensions_agree(self) -> Self:
        """Refuse arrays and lists that run along one dimension and differ in length."""
        check_dimensions(self, self.dimension_of)
        return self

    def __eq__(self, other: object) -> bool:
        """Return whether all fields are equal, NaN to NaN; pydantic's own comparison fails on arrays."""
        if type(self) is not type(other):
            return NotImplemented
        return self is other or _equal(self.__dict__, other.__dict__)

    def __hash__(self) -> int:
        """Return a hash that equal models share; of an array its shape alone counts."""
        return _hash(self)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, which are not checked; a name that is no field is refused.

        Raises
        ------
        RecordError
            There is no field of a name in `update`.
        """
        if unknown := sorted(set(update or ()) - set(type(self).model_fields)):
            raise RecordError(
                f"{type(self).__name__} has no field {unknown[0]!r}; valid names are "
                f"{', '.join(sorted(type(self).model_fields))}"
            )
        return super().model_copy(update=update, deep=deep)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Self:
        copied = super().__deepcopy__(memo)
        _make_read_only(copied.__dict__)
        return copied

    def __setstate__(self, state: dict[Any, Any]) -> None:
        super().__setstate__(state)
        _make_read_only(self.__dict__)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Take truth values and texts for no numbers, and numbers and texts for no truth values."""
        strict: CoreSchema = _without_coercion(handler(source))
        return strict

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Show the size of an array, not its values."""
        for name, value in super().__repr_args__():
            yield name, _Size(array_text(value)) if isinstance(value, np.ndarray) else value

    def unused_fields(self) -> dict[str, str]:
        """Return dotted paths of fields that other fields leave without effect, each with the reason.

        A stored record may hold them; in a file that a person writes they are refused.
        """
        return {
            f"{name}.{path}": why
            for name in type(self).model_fields
            if isinstance(part := getattr(self, name), Model)
            for path, why in part.unused_fields().items()
        }


def _make_read_only(value: object) -> None:
    """Make the arrays of a copy read-only, as they are in every model."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, Mapping):
        for entry in value.values():
            _make_read_only(entry)
    elif isinstance(value, tuple | list) and value and not isinstance(value[0], float | int | str):
        for entry in value:
            _make_read_only(entry)


def _equal(one: object, other: object) -> bool:
    """Return whether two values are equal: arrays in shape and every value, NaN to NaN, tuples by their entries."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)):
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc" and other.dtype.kind in "fc")
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_equal(value, other[key]) for key, value in one.items())
    if isinstance(one, tuple | list) and type(one) is type(other):
        if len(one) != len(other):
            return False
        if _PLAIN_VALUES.issuperset(map(type, one)) and _PLAIN_VALUES.issuperset(map(type, other)) and one == other:
            return True  # at the speed of the interpreter's own comparison; only NaN needs the next line too
        return all(map(_equal, one, other))
    return bool(one == other or (one != one and other != other))


def _hash(value: object) -> int:
    """Return a hash of a value of a model: the same for values that :func:`_equal` calls equal."""
    if isinstance(value, np.ndarray):
        return hash(value.shape)
    if isinstance(value, Mapping):
        return hash(frozenset((key, _hash(entry)) for key, entry in value.items()))
    if isinstance(value, tuple | list):
        return hash(tuple(map(_hash, value)))
    if isinstance(value, BaseModel):  # the origin too, whose own hash fails on its dictionaries
        return hash((type(value), _hash(value.__dict__)))
    return 0 if value != value else hash(value)


class Record(Model):
    """A product of a stage: stored by :mod:`data_schemas.storage._records` with its kind, version and provenance.

    Attributes
    ----------
    schema_version
        Raised whenever the schema changes; see :mod:`data_schemas.storage._records`.
    written_by
        The command that writes the record, for whoever holds a file of an earlier version.
    other_kinds
        Kinds that a user may give in place of this one, each with the reason why it cannot serve.
    shown
        Fields and properties that its text shows, in this order; without any, the first few numbers and words.
    provenance
        Who, when, with what and from which inputs; filled by the storage when the record is written.
    """

    schema_version: ClassVar[int] = 1
    written_by: ClassVar[str] = "the command that wrote it"
    other_kinds: ClassVar[Mapping[str, str]] = {}
    shown: ClassVar[tuple[str, ...]] = ()
    provenance: Provenance | None = None

    def __repr__(self) -> str:
        return record_text(self)

    def __str__(self) -> str:
        return record_text(self)

    def _repr_html_(self) -> str:
        return record_html(self)

    def plot(self) -> Any:
        """Return a drawing of the record, which notebooks show and ``save(path)`` stores.

        Raises
        ------
        RecordError
            There is no drawing of this kind of record; or ``finray_calib`` was not imported.
        """
        return call_record_method(self, "plot")

    def to_xarray(self) -> "Dataset":
        """Return the arrays of the record with their dimensions, coordinates and units (an ``xarray.Dataset``).

        Raises
        ------
        RecordError
            The record holds no array; or ``finray_calib`` was not imported.
        MissingExtraError
            xarray is not installed.
        """
        data: Dataset = call_record_method(self, "to_xarray")
        return data


class Estimate(Model):
    """Posterior summary of one number: median, standard deviation and equal-tailed intervals.

    Its text is the median with the 95 % interval, ``0.231 [0.210, 0.252]``; with a format such as ``f"{yield:.1f}"``
    each of the three numbers has it, and a width such as ``f"{yield:>30}"`` is that of the whole text. ``float``
    returns the median alone.
    """

    estimate: float
    sd: Annotated[float, Field(ge=0.0)]
    low68: float
    high68: float
    low95: float
    high95: float

    def __str__(self) -> str:
        return interval_text(self.estimate, self.low95, self.high95)

    def __repr__(self) -> str:
        return str(self)

    def __format__(self, form: str) -> str:
        return formatted_interval((self.estimate, self.low95, self.high95), form, "", str(self))

    def __float__(self) -> float:
        return self.estimate

    def to_numpy(self) -> Floats:
        """Return the median as an array of no dimension, as `float` does: plots ask for it."""
        return np.asarray(float(self))


class Quantity(Estimate):
    """An estimate with its unit: ``598.0 [589.8, 605.2] nm``.

    ``float`` refuses it, unless it is a pure number: arrays of such numbers would mix their units. ``estimate`` is the
    median, in the unit.
    """

    unit: str

    @classmethod
    def of(cls, value: Estimate, unit: str) -> "Quantity":
        """Return an estimate with a unit."""
        return cls(**{name: getattr(value, name) for name in Estimate.model_fields}, unit=unit)

    def __str__(self) -> str:
        return interval_text(self.estimate, self.low95, self.high95, self.unit)

    def __format__(self, form: str) -> str:
        return formatted_interval((self.estimate, self.low95, self.high95), form, self.unit, str(self))

    def __float__(self) -> float:
        if self.unit in ("", "1"):
            return self.estimate
        raise TypeError(
            f"{self} cannot become a plain number, because its unit, {self.unit}, would be lost; write .estimate for "
            f"the median in {self.unit}"
        )


@dataclass(frozen=True, slots=True, repr=False)
class PropagatedDraws:
    """What a function made of each posterior draw.

    Attributes
    ----------
    draws
        (N, ...) what the function returned for draw 1 to N, in its own unit.
    """

    draws: Floats

    @property
    def estimate(self) -> Any:
        """Median over the draws: a number, or an array of the shape that the function returns."""
        return np.median(self.draws, axis=0)

    @property
    def sd(self) -> Any:
        """Standard deviation over the draws, shaped as `estimate`."""
        return self.draws.std(axis=0, ddof=1)

    @property
    def low95(self) -> Any:
        """Lower end of the equal-tailed 95 % interval, shaped as `estimate`."""
        return np.quantile(self.draws, 0.025, axis=0)

    @property
    def high95(self) -> Any:
        """Upper end of the equal-tailed 95 % interval, shaped as `estimate`."""
        return np.quantile(self.draws, 0.975, axis=0)

    def as_estimate(self) -> Estimate:
        """Return the summary of a function that returns one number.

        Raises
        ------
        RecordError
            The function returns an array.
        """
        if self.draws.ndim != 1:
            raise RecordError(
                f"an estimate must be one number, but the function returned arrays of shape {self.draws.shape[1:]}; "
                "use estimate, sd, low95 and high95, which are arrays of this shape"
            )
        low95, low68, estimate, high68, high95 = np.quantile(self.draws, [0.025, 0.16, 0.5, 0.84, 0.975])
        sd = float(self.draws.std(ddof=1))
        return Estimate(estimate=estimate, sd=sd, low68=low68, high68=high68, low95=low95, high95=high95)

    def __format__(self, form: str) -> str:
        return format(self.as_estimate(), form) if form else str(self)

    def __float__(self) -> float:
        return self.as_estimate().estimate

    def __repr__(self) -> str:
        if self.draws.ndim == 1:
            return interval_text(float(self.estimate), float(self.low95), float(self.high95))
        return f"PropagatedDraws: {len(self.draws)} draws of shape {self.draws.shape[1:]}; see estimate, low95, high95"


def propagate_draws(draws: Floats, function: Callable[[Floats], ArrayLike]) -> PropagatedDraws:
    """Call a function once for each draw.

    Parameters
    ----------
    draws
        (N, ...) posterior draws, N at least 2.
    function
        Takes one draw; returns a number or an array, of the same shape each time.

    Raises
    ------
    RecordError
        What was given is no function, or it returned different shapes, or what is not a finite number.
    """
    if not callable(function):
        raise RecordError(f"expected a function of an emission, such as numpy.max, got {type(function).__name__}")
    _require_one_argument(function)
    made = [np.asarray(function(draw)) for draw in draws]
    shapes = {one.shape for one in made}
    if len(shapes) != 1 or any(one.dtype.kind not in "fuib" for one in made):
        found = ", ".join(sorted({f"{one.dtype} of shape {one.shape}" for one in made}))
        raise RecordError(
            f"the function must return a number, or an array of the same shape, for every draw, but it returned {found}"
        )
    values = np.array(made, dtype=np.float64)
    if not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).reshape(len(values), -1).any(axis=1).sum())
        raise RecordError(
            f"the function returned NaN or an infinite value for {bad} of {len(values)} draws, so no interval can be "
            "given; make it return a finite number for every emission, even where a draw is slightly below 0"
        )
    return PropagatedDraws(values)


def _require_one_argument(function: Callable[[Floats], ArrayLike]) -> None:
    """Refuse a function that cannot be called with one emission alone."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # compiled functions may have none
        return
    try:
        signature.bind(None)
    except TypeError:
        raise RecordError(
            f"the function takes {signature}, but is called with one argument, a draw of the emission; give a "
            "function of one argument, such as lambda emission_per_nm: f(emission_per_nm, wavelength_nm)"
        ) from None


LARGEST_NUMBER_OF_FAULTS = 5
PLAIN = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list in brackets, such as [1.0, 2.0]"),
    **dict.fromkeys(("dict_type", "model_type"), "must be a table with a value for each of its keys"),
    "string_type": "must be text in quotes",
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false, without quotes"),
    "too_short": "must have more entries, at least {min_length}",
    "too_long": "must have fewer entries, at most {max_length}",
    "string_too_short": "must not be empty",
    "greater_than": "must be above {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be below {lt}",
    "less_than_equal": "must be at most {le}",
    "multiple_of": "must be a multiple of {multiple_of}",
    "literal_error": "must be {expected}",
    "finite_number": "must be a finite number",
}
"""Kind of fault -> what it is in words that need no programming language."""
OF_A_UNION = re.compile(r"(function-\w+|dict|tuple|list|literal)\[.*\]|constrained-(float|int|str)")
"""What pydantic puts into a location for the member of a union that it tried, which is no field."""
PURE_NUMBER = re.compile(r"1( \(.*\))?")
OUT_OF_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Return one line per fault: the field, what is wrong, what is allowed (with its unit).

    Parameters
    ----------
    error
        What pydantic raised when it validated `model`.
    model
        The model that was validated.
    """
    # A default that follows from another field has no fault of its own where that field is wrong.
    faults = [fault for fault in error.errors() if fault["type"] != "default_factory_not_called"]
    lines = [_fault(fault, model) for fault in faults[:LARGEST_NUMBER_OF_FAULTS]]
    if len(faults) > LARGEST_NUMBER_OF_FAULTS:
        more = len(faults) - LARGEST_NUMBER_OF_FAULTS
        lines.append(f"and {more} more fault{'' if more == 1 else 's'}")
    return "; ".join(lines)


def _fault(fault: Any, model: type[BaseModel]) -> str:
    """Explain one fault."""
    location = [str(part) for part in fault["loc"]]
    field = _path(fault["loc"])
    message = str(fault["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    if fault["type"] == "extra_forbidden":
        known = sorted(_fields_at(model, location[:-1]) - {"provenance"})
        near = difflib.get_close_matches(location[-1], known, 1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'? Known" if near else "known"
        return f"'{field}': unknown key; {hint} keys are {', '.join(known)}"
    if fault["type"] == "missing":
        return f"'{field}': is missing and must be given"
    if fault["type"] in PLAIN:
        bounds = fault.get("ctx", {})
        message = PLAIN[fault["type"]].format_map(
            {name: f"{bound:g}" if isinstance(bound, float) else bound for name, bound in bounds.items()}
        )
    unit = _unit_at(model, location)
    if unit is not None and PURE_NUMBER.fullmatch(unit):
        unit = None
    given = fault.get("input")
    number = f"{given:g} " if isinstance(given, float) else f"{given} "
    is_told = message.endswith(repr(given)) or message.startswith((repr(given), number))
    shown = f", got {given!r}" if isinstance(given, str | int | float | bool) and not is_told else ""
    fault_text, semicolon, remedy = message.partition("; ")
    place = f"'{field}'{f' (in {unit})' if unit else ''}: " if field else ""
    hint = f"; correct it, and give it in {unit}" if unit and fault["type"] in OUT_OF_BOUNDS else ""
    return f"{place}{fault_text[:1].lower()}{fault_text[1:]}{shown}{semicolon}{remedy}{hint}"


def _path(location: tuple[str | int, ...]) -> str:
    """Return ``filters (entry 1).center_nm``: people count from one."""
    named = [part for part in location if isinstance(part, int) or not OF_A_UNION.fullmatch(part)]
    path = "".join(f" (entry {part + 1})" if isinstance(part, int) else f".{part}" for part in named)
    return path.removeprefix(".")


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the pydantic models inside an annotation (unions, tuples, dicts)."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for inner in get_args(annotation) for m in _models_in(inner)]


def _fields_at(model: type[BaseModel], location: list[str]) -> set[str]:
    """Return the field names allowed at a location inside a model."""
    models = [model]
    for part in location:
        fields = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        inner = [n for annotation in fields for n in _models_in(annotation)]
        models = inner or models
    return {name for m in models for name in m.model_fields}


def _unit_at(model: type[BaseModel], location: list[str]) -> str | None:
    """Return the unit of the field at a location, or of its entries, or None."""
    models = [model]
    unit = None
    for part in location:
        for m in models:
            if part in m.model_fields:
                unit = _unit_of(m.model_fields[part])
        models = [
            n for m in models if part in m.model_fields for n in _models_in(m.model_fields[part].annotation)
        ] or models
    return unit


def _unit_of(field: FieldInfo) -> str | None:
    """Return the unit that a field or, in a tuple, all its entries are declared with."""
    extra = field.json_schema_extra
    if isinstance(extra, dict) and "unit" in extra:
        return str(extra["unit"])
    units = {_unit_of(part) for part in _fields_in(field.annotation)}
    return units.pop() if len(units) == 1 else None


def _fields_in(annotation: Any) -> list[FieldInfo]:
    """Return the pydantic fields inside an annotation (unions, tuples)."""
    if isinstance(annotation, FieldInfo):
        return [annotation]
    return [field for inner in get_args(annotation) for field in _fields_in(inner)]
