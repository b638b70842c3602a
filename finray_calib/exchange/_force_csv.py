"""Measured force over displacement from a CSV file (comment lines start with #, one header row, units in its names)."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, CurveError, ImportFormatError
from data_schemas.storage import read_table
from finray_calib.force import MeasuredForce

NEEDED: Final = ("displacement_mm", "force_n")
#: Of the range of displacements: less is the jitter of a gauge.
_BACK_REL: Final = 0.05
OPTIONAL: Final = ("force_uncertainty_n", "displacement_uncertainty_mm")


def read_force_csv(path: Path) -> MeasuredForce:
    """Read a measured loading curve.

    Rows in the order of the measurement, loading only. Columns in any order: displacement_mm of the indenter along the
    pad's normal and force_n that pushes it back; if known, force_uncertainty_n and displacement_uncertainty_mm
    (standard uncertainties, independent between rows).

    Raises
    ------
    ImportFormatError
        The file is missing or no table of finite numbers, or a column is missing, doubled or unknown.
    CompareError
        There are too few points, an uncertainty is negative, the force pulls, or the indenter goes back.
    """
    try:
        header, table = read_table(path)
    except CurveError as error:
        raise ImportFormatError(str(error)) from None
    # a byte order mark that came under a comment
    header = [name.removeprefix("\ufeff").lower() for name in header]
    allowed = f"needed are {', '.join(NEEDED)}, allowed also {', '.join(OPTIONAL)}"
    unknown = [name for name in header if name not in {*NEEDED, *OPTIONAL}]
    if unknown:
        raise ImportFormatError(f"{path}: column '{unknown[0][:60]}' is unknown; {allowed}; mm and N, commas between")
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise ImportFormatError(f"{path}: has no column '{missing[0]}'; {allowed}")
    if len(set(header)) < len(header):
        raise ImportFormatError(f"{path}: a column appears twice; {allowed}")
    columns = dict(zip(header, table.T, strict=True))
    _require_loading(path, columns["displacement_mm"])
    return MeasuredForce(
        path.name,
        columns["displacement_mm"],
        columns["force_n"],
        columns.get("force_uncertainty_n"),
        columns.get("displacement_uncertainty_mm"),
    )


def _require_loading(path: Path, displacement_mm: NDArray[np.float64]) -> None:
    """Refuse rows in which the indenter goes back: rubber pushes less on the way out."""
    deepest = np.maximum.accumulate(displacement_mm)
    back = np.flatnonzero(deepest - displacement_mm > _BACK_REL * np.ptp(displacement_mm))
    if back.size:
        row = int(back[0])
        raise CompareError(
            f"{path}: in row {row + 1} under the header the displacement is {displacement_mm[row]:g} mm after "
            f"{deepest[row]:g} mm: the indenter goes back, and unloading pushes less than loading. Leave out the rows "
            "of unloading; if all rows are of loading, sort them by displacement_mm"
        )
