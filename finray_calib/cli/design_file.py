"""The design file that a command is given."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data_schemas.design import FingerDesign


def read_design(path: Path) -> "FingerDesign":
    """Read a finger's design (TOML).

    Raises
    ------
    RecordError
        See :func:`~data_schemas.storage.read_toml`; of the name of a ready-made finger it says how to write its file.
    """
    from data_schemas.design import FingerDesign
    from data_schemas.errors import RecordError
    from data_schemas.storage import read_toml
    from sim.presets import PRESETS

    if path.name == str(path) and path.name in PRESETS and not path.exists():
        raise RecordError(f"{path}: no such file; write it first: finray design init {path}, then give {path}.toml")
    return read_toml(path, FingerDesign)
