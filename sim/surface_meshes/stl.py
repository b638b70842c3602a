"""Triangles as binary STL, the format that printers' slicers read."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError

_HEADER_BYTES = 80
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_bytes(triangles: NDArray[np.int64], vertices_mm: NDArray[np.float64], title: str) -> bytes:
    """Return a binary STL file, in mm.

    Parameters
    ----------
    triangles
        Vertex numbers (m, 3), counter-clockwise seen from outside.
    vertices_mm
        Shape (n, 3).
    title
        Text of the header: up to 80 ASCII characters that do not begin with "solid".

    Raises
    ------
    SimulateError
        When the title begins with "solid", by which readers know the text format, or is not ASCII or too long.
    """
    if title.startswith("solid") or not title.isascii() or len(title) > _HEADER_BYTES:
        raise SimulateError(
            f"the title of an STL file must be up to {_HEADER_BYTES} ASCII characters that do not begin with 'solid', "
            f"got {title!r}"
        )
    corners = vertices_mm[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(triangles), dtype=_RECORD)
    records["normal"] = normals / np.where(lengths > 0.0, lengths, 1.0)
    records["corners"] = corners
    header = title.encode("ascii").ljust(_HEADER_BYTES)
    return b"".join([header, np.array(len(triangles), dtype="<u4").tobytes(), records.tobytes()])
