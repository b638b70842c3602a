"""The base of every model that crosses a file or the command line: frozen, and unknown keys are errors."""

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from data_schemas.provenance import Provenance

_NUMBERS: Final = {"float", "int"}
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
    """Refuse what is no number, although pydantic would make one of it."""
    if isinstance(value, bool | str | bytes):
        raise ValueError(f"must be a number, got {value!r}"[:120])
    return value


class Model(BaseModel):
    """Frozen pydantic model; an unknown or misspelt key is an error, never a silent default."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=False, validate_default=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Take truth values and texts for no numbers, and numbers and texts for no truth values."""
        strict: CoreSchema = _without_coercion(handler(source))
        return strict

    def idle_fields(self) -> dict[str, str]:
        """Return dotted paths of fields that other fields leave without effect, each with the reason.

        A stored record may hold them; in a file that a person writes they are refused.
        """
        return {
            f"{name}.{path}": why
            for name in type(self).model_fields
            if isinstance(part := getattr(self, name), Model)
            for path, why in part.idle_fields().items()
        }


class Record(Model):
    """A product of a stage: stored by :mod:`data_schemas.storage` with its kind, version and provenance.

    Attributes
    ----------
    schema_version
        Raised whenever the schema changes; see :mod:`data_schemas.record_versions`.
    written_by
        The command that writes the record, for whoever holds a file of an earlier version.
    other_kinds
        Kinds that a user may give in place of this one, each with the reason why it cannot serve.
    provenance
        Who, when, with what and from which inputs; filled by the storage when the record is written.
    """

    schema_version: ClassVar[int] = 1
    written_by: ClassVar[str] = "the command that wrote it"
    other_kinds: ClassVar[Mapping[str, str]] = {}
    provenance: Provenance | None = None
