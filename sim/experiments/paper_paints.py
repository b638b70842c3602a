"""The paper's statements on its red and green paint, side by side with measured stand-ins.

No measured spectrum of the paper's paints is public, and the paper prints no fitted numbers. What it does print
(Stokes shifts, reradiation "in the desired wavelength", the peak wavelength of its curve, the matching ColorChecker
patches) is computed here for measured materials of the same colour, in units that say what is counted.
"""

from collections.abc import Sequence

import numpy as np

from data_schemas.curves import DonaldsonMatrix
from data_schemas.errors import SimulateError
from data_schemas.paper_paints import PaperPaints
from sim.experiments.paint_stand_in import measure_stand_in
from sim.experiments.paint_stand_in_fits import LASER_NM
from sim.experiments.paper_statements import paper_statements

CAVEAT = (
    "Stand-ins, not the paper's paints: no measured spectrum of those is public. The paper prints no fitted "
    "parameters; what is fitted here is its equation. How far ours lets a paint leave its curve was learned from an "
    "orange ink, a yellow textile and two papers: on those the coverage shown is no independent test; the study that "
    "leaves each of them out is in benchmarks/."
)


def reproduce_paper_paints(
    red: Sequence[DonaldsonMatrix], green: Sequence[DonaldsonMatrix], rng: np.random.Generator
) -> PaperPaints:
    """Return the paper's statements on its paints beside those of measured stand-ins.

    Parameters
    ----------
    red, green
        Measured re-radiation matrices that stand for the red and the green paint, at least one of each; excitation
        over 380 to 450 nm and emission to 780 nm.
    rng
        Source of the noise of the bands and of all draws.

    Raises
    ------
    SimulateError
        A colour has no stand-in, a material is given twice, or a matrix does not cover the laser and the emission.
    """
    if not red or not green:
        raise SimulateError(
            "paper paints: give at least one measured re-radiation matrix for red and one for green "
            "(--red CSV --green CSV)"
        )
    names = [matrix.name for matrix in (*red, *green)]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise SimulateError(
            f"paper paints: material {twice[0]} is given twice; give each file once, for one colour, and materials "
            "different file names"
        )
    paints = (*(measure_stand_in(m, "red", rng) for m in red), *(measure_stand_in(m, "green", rng) for m in green))
    return PaperPaints(laser_nm=LASER_NM, stand_ins=paints, statements=paper_statements(paints), caveat=CAVEAT)
