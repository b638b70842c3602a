"""What is loaded when it is asked for, and not before: the exports of a package, and methods of records.

A package lists what it offers once, as imports below ``if TYPE_CHECKING:`` in its ``__init__``. Readers, editors and
type checkers see ordinary imports; a program that needs one name loads one module, not all that the package needs.

Packages above this one add methods to records: plots, exports, draws through a function. This package knows their names
only. Who provides one registers where it lives, as text.
"""

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_exports(package: str, file: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package (PEP 562).

    Parameters
    ----------
    package, file
        ``__name__`` and ``__file__`` of the package.
    """

    @cache
    def homes() -> dict[str, str]:
        block = next(node for node in ast.parse(Path(file).read_bytes()).body if isinstance(node, ast.If))
        imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes()[name]), name)

    return load


_homes: dict[str, str] = {}


def register_record_methods(**homes: str) -> None:
    """State where records' methods are: method name -> ``"package:function"``; the function takes the record first."""
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
            f"{type(record).__name__}.{method}() is part of the package finray_calib, which is not imported; write "
            "'import finray_calib' first"
        )
    module, _, function = _homes[method].partition(":")
    return getattr(import_module(module), function)(record, *arguments, **options)
