"""Methods of records that rooms above this one bring: plots, exports, draws through a function.

The ground knows their names only. Who provides one registers where it lives, as text, so that nothing is loaded before
a method is called.
"""

from importlib import import_module
from typing import Any

_homes: dict[str, str] = {}


def register_record_methods(**homes: str) -> None:
    """Say where methods of records live: method name -> ``"package:function"``; the function takes the record first."""
    _homes.update(homes)


def call_record_method(record: object, method: str, *arguments: Any, **options: Any) -> Any:
    """Call a registered method of a record and return its result.

    Raises
    ------
    RecordError
        Nothing has registered the method: the package that brings it is not imported.
    """
    from data_schemas.errors import RecordError

    if method not in _homes:
        raise RecordError(
            f"{type(record).__name__}.{method}(): comes with the package finray_calib, which is not imported; write "
            "'import finray_calib' first"
        )
    module, _, function = _homes[method].partition(":")
    return getattr(import_module(module), function)(record, *arguments, **options)
