"""Hexahedra of the gel pad and of the film, or the skin of adhesive, on its inner face and on the fin around it."""

import numpy as np

from data_schemas.design import FingerDesign
from sim.mechanics.mesh import Block, FingerMesh
from sim.mechanics.skeleton import BOND_MM
from sim.mechanics.structured_grid import divided, hexahedra_on_grid, quads_of_layer
from sim.surface_meshes.pressed_pad import rest_height_mm

_FEWEST_LAYERS = 2


def pad_mesh(design: FingerDesign, step_mm: float, layer_mm: float) -> FingerMesh:
    """Mesh gel and film; the nodes of the coated face lie on the designed shape.

    Parameters
    ----------
    design
        Finger.
    step_mm
        Largest edge along and across the pad.
    layer_mm
        Largest thickness of an element at the crown.

    Returns
    -------
    FingerMesh
        Blocks "gel", and "film" or "bond" under it; surfaces "coat", "inner" (gel against film or bond), "red",
        "green", "base", "tip" of the gel; node sets "coat" and "flange" (what lies on the front fin).
    """
    pad, flange = design.pad, design.skeleton.flange_mm
    half, length = pad.width_mm / 2.0, pad.length_mm
    x = divided([-half - flange, -half, half, half + flange], step_mm)
    z = divided([-flange, 0.0, length, length + flange], step_mm)
    share = divided([0.0, 1.0], layer_mm / pad.thickness_mm, _FEWEST_LAYERS)
    height = rest_height_mm(design, np.clip(x, -half, half)[:, None], np.clip(z, 0.0, length)[None, :])
    sheet_mm = BOND_MM if pad.film is None else pad.film.thickness_mm
    y = np.concatenate([np.full_like(height[:, None], -sheet_mm), height[:, None] * share[:, None]], axis=1)
    over_x, over_z = np.flatnonzero(np.abs(x) <= half), np.flatnonzero((z >= 0.0) & (z <= length))
    used = np.zeros(tuple(n - 1 for n in y.shape), dtype=np.bool_)
    used[:, 0] = True
    used[over_x[0] : over_x[-1], 1:, over_z[0] : over_z[-1]] = True
    grid = hexahedra_on_grid(np.stack(np.broadcast_arrays(x[:, None, None], y, z), axis=-1), used)
    in_sheet = grid.cells[:, 1] == 0
    under = grid.hexahedra[in_sheet]
    blocks = (
        Block("gel", grid.hexahedra[~in_sheet], "gel", "mean_dilatation"),
        Block("bond", under, "gel", "mean_dilatation")
        if pad.film is None
        else Block("film", under, "film", "incompatible_modes"),
    )
    gel = grid.numbers[over_x[0] : over_x[-1] + 1, 1:, over_z[0] : over_z[-1] + 1]
    # (sheet of node numbers whose first index crossed with the second points outward)
    sheets = {
        "coat": gel[:, -1].T,
        "inner": gel[:, 0],
        "red": gel[0].T,
        "green": gel[-1],
        "base": gel[:, :, 0].T,
        "tip": gel[:, :, -1],
    }
    surfaces = {
        name: quads_of_layer(sheet, np.ones((sheet.shape[0] - 1, sheet.shape[1] - 1), dtype=np.bool_))
        for name, sheet in sheets.items()
    }
    on_fin = (np.abs(x) >= half)[:, None] | (z <= 0.0) | (z >= length)
    sets = {"coat": np.unique(gel[:, -1]), "flange": np.unique(grid.numbers[:, 0, :][on_fin])}
    return FingerMesh(grid.nodes_mm, blocks, sets, surfaces, ())
