"""Formats of captures that packages outside the tree bring: each one file, named by an entry point.

An entry point of the group ``finray_calib.import_formats`` names a format, and its value is a module with
``read_capture(folder)`` (:class:`ImportFormat`). The module is imported when somebody asks for its format.
"""

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final, Protocol

from data_schemas import FinrayError, ImportFormatError, TactileCapture
from data_schemas.storage import digest_as_read

GROUP: Final = "finray_calib.import_formats"
HOW_TO: Final = "docs/how-to/import-captures.md"


class ImportFormat(Protocol):
    """What the module of a format has."""

    def read_capture(self, folder: Path) -> TactileCapture:
        """Return the capture of one press from a folder, whose files are read by :mod:`data_schemas.storage`."""
        ...


def capture_by_package(name: str, folder: Path) -> TactileCapture:
    """Read a capture by a format of another package.

    Parameters
    ----------
    name
        The format's, as its entry point has it.
    folder
        Of one press.

    Raises
    ------
    ImportFormatError
        No package, or several, offer the format; its module cannot be imported, lacks ``read_capture`` or fails; what
        it returns is no capture, or is of no file that was read by :mod:`data_schemas.storage`.
    """
    entry = _entry_of(name)
    if not folder.is_dir():
        raise ImportFormatError(f"{folder}: no such folder; give the folder of one press")
    try:
        capture = _module_of(entry).read_capture(folder)
    except (FinrayError, OSError):
        raise
    except (Exception, SystemExit) as error:  # a mistake of the format's author is not its user's
        raise ImportFormatError(
            f"{folder}: {_label(entry)} fails ({type(error).__name__}: {error}); {_update(entry)}"
        ) from error
    if not isinstance(capture, TactileCapture):
        raise ImportFormatError(
            f"{folder}: {_label(entry)} returns a {type(capture).__name__}, where a data_schemas.TactileCapture is "
            f"needed; {_update(entry)}"
        )
    if not any(digest_as_read(file) is not None for file in folder.rglob("*")):
        raise ImportFormatError(
            f"{folder}: {_label(entry)} read no file of it by data_schemas.storage (read_bytes, read_npy, "
            f"tiff_image), so that the record could not name what it was made from; {_update(entry)}"
        )
    return capture


def _entry_of(name: str) -> EntryPoint:
    """Return the only entry point of a name."""
    offered = tuple(entry_points(group=GROUP))
    found = [entry for entry in offered if entry.name == name]
    if not found:
        known = ", ".join(sorted({_label(entry) for entry in offered})) or "none"
        raise ImportFormatError(
            f"no installed package brings the format '{name}'; there are: {known}. Correct the name, or install the "
            f"package that brings it ({HOW_TO})"
        )
    if len(found) > 1:
        packages = sorted(_package(entry) for entry in found)
        raise ImportFormatError(
            f"format '{name}' is offered by {' and by '.join(packages)}, and finray cannot know which one you mean; "
            f"uninstall one of "
            "them, or ask its author for another name"
        )
    return found[0]


def _module_of(entry: EntryPoint) -> ImportFormat:
    """Return the module of a format, which has all that one must have."""
    try:
        module = import_module(entry.value)
    except (Exception, SystemExit) as error:  # whatever a module does when it is imported
        raise ImportFormatError(
            f"{_label(entry)} cannot be imported ({type(error).__name__}: {error}); {_update(entry)}"
        ) from error
    if not callable(getattr(module, "read_capture", None)):
        raise ImportFormatError(
            f"{_label(entry)} lacks the function read_capture(folder) in its module {entry.value}; {_update(entry)}"
        )
    format_module: ImportFormat = module
    return format_module


def _package(entry: EntryPoint) -> str:
    return "a package without a name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def _label(entry: EntryPoint) -> str:
    return f"format '{entry.name}' of package {_package(entry)}"


def _update(entry: EntryPoint) -> str:
    name = "PACKAGE" if entry.dist is None else entry.dist.name
    return f"update it (pip install --upgrade {name}), or tell its author ({HOW_TO})"
