"""Front doors of packages that load what is asked for, when it is asked for.

A package lists what it offers once, as imports below ``if TYPE_CHECKING:`` in its ``__init__``. Readers, editors and
type checkers see ordinary imports; a program that needs one name loads one module, not all that the package needs.
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
