"""The printed parts of a finger and the mould of its pad as files for slicers (STL) and CAD programs (STEP)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from data_schemas.design import FingerDesign
from finray_calib.exchange.step_file import step_bytes
from sim.mechanics.pad_mould import mould_sizes, mould_solid
from sim.mechanics.printed_parts import Part, mould_stl, part_solid, part_stl
from sim.surface_meshes.solid import Solid

PrintFormat = Literal["stl", "step"]


@dataclass(frozen=True, slots=True)
class PrintablePart:
    """One part: its size across, along the pad's normal and along the finger, what to know of it, files by format."""

    name: str
    size_mm: tuple[float, float, float]
    note: str
    files: dict[PrintFormat, bytes]


def printable_parts(
    design: FingerDesign,
    formats: Sequence[PrintFormat] = ("stl", "step"),
    one_piece: bool = False,
    lining_mm: float | None = None,
) -> tuple[PrintablePart, ...]:
    """Return what a finger is printed from, in mm and in the finger's axes, so that the parts fit together.

    Skeleton and base plate are prints of their own, because the base is stiffer; so is the backing, where there is one.
    Each part is one closed body. Equal designs give equal bytes.

    Parameters
    ----------
    design
        Finger.
    formats
        "stl": triangles. "step": planes, and the exact cylinder or ellipsoid on the bottom of the mould; curved fins
        are strips of 1 mm, 0.3 um from their curve, in both.
    one_piece
        Skeleton and base plate as one body, for a finger that is printed of one material.
    lining_mm
        Sheet laid on the bottom of the mould; by default 0.1 mm, and none in an ellipsoidal mould.

    Raises
    ------
    SimulateError
        When the parts do not fit together, or a lining is given to an ellipsoidal mould.
    """
    names: list[Part] = ["skeleton_and_base"] if one_piece else ["skeleton", "base_plate"]
    if design.skeleton.backing is not None:
        names.append("backing")
    parts = [_part(name, part_solid(design, name), partial(part_stl, design, name), design, formats) for name in names]
    sizes = mould_sizes(design, lining_mm)
    as_stl = partial(mould_stl, design, sizes.wall_mm, sizes.floor_mm, sizes.lining_mm)
    note = f"lay a sheet of {sizes.lining_mm:g} mm on its bottom" if sizes.lining_mm else ""
    return (*parts, _part("mould", mould_solid(design, sizes), as_stl, design, formats, note))


def _part(
    name: str,
    solid: Solid,
    as_stl: Callable[[], bytes],
    design: FingerDesign,
    formats: Sequence[PrintFormat],
    note: str = "",
) -> PrintablePart:
    """Return a part with its files."""
    files: dict[PrintFormat, bytes] = {}
    if "stl" in formats:
        files["stl"] = as_stl()
    if "step" in formats:
        files["step"] = step_bytes(solid, f"{name} of {design.name}")
    x, y, z = np.ptp(solid.corners_mm, axis=0)
    return PrintablePart(name, (float(x), float(y), float(z)), note, files)
