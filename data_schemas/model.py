"""The base of every model that crosses a file or the command line: frozen, and unknown keys are errors."""

from collections.abc import Mapping
from typing import ClassVar

from pydantic import BaseModel, ConfigDict

from data_schemas.provenance import Provenance


class Model(BaseModel):
    """Frozen pydantic model; an unknown or misspelt key is an error, never a silent default."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=False, validate_default=True)

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
