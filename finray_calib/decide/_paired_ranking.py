"""Rank choices by draws of their values that belong to each other, and say which differences are real: paints."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, FingerDesign, PaintChoice, PaintPairRow, PropagatedDraws, interval_text

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairedRanking:
    """Choices in the order of their mean, and what tells them apart.

    Attributes
    ----------
    order
        Numbers of the choices, the least mean first.
    above_best
        Draws of each choice less those of the best, (choice, draw), in the order given.
    half_widths
        Of each difference's interval, (choice, choice): all intervals hold together with the level.
    told_apart
        Whether the difference of two choices leaves its interval, (choice, choice).
    best_share
        Share of the draws in which a choice is the least, ties divided, (choice,).
    """

    order: NDArray[np.int64]
    above_best: Floats
    half_widths: Floats
    told_apart: NDArray[np.bool_]
    best_share: Floats


#: Of all intervals together.
LEVEL: Final = 0.95


def rank_by_draws(values: Floats) -> PairedRanking:
    r"""Rank choices, the least first, and find the differences that are real.

    .. math:: |\bar d_{ij}| > c\, s_{ij}, \qquad
        c = \text{the } \lceil (n + 1) L \rceil\text{-th of } \max_{i<j} |d_{ij} - \bar d_{ij}| / s_{ij}

    over the n draws of all differences d. All intervals hold together with the level L = 0.95: of equal choices,
    however many, none is told apart more often than in 1 - L of all cases. Valid where the deviation of the means from
    the truth is one of the draws' kind, as those of a posterior are.

    Parameters
    ----------
    values
        (choice, draw), smaller is better; a draw is the same state of the world for all choices.

    Raises
    ------
    CompareError
        With less than two choices, with too few draws for the level of 95 %, or when a value is not finite.

    References
    ----------
    J. L. Montiel Olea, M. Plagborg-Moller, Simultaneous confidence bands: theory, implementation, and an application to
    SVARs, Journal of Applied Econometrics 34 (2019) 1-17.
    """
    least = ceil(LEVEL / (1.0 - LEVEL) - 1e-9)
    if values.ndim != 2 or len(values) < 2 or values.shape[1] < least or not np.isfinite(values).all():
        raise CompareError(
            f"a ranking needs finite values (choice, draw) of at least 2 choices and {least} draws for a level of "
            f"{LEVEL:g}; got an array of shape {values.shape}. Give more draws or choices"
        )
    mean = values.mean(axis=1)
    order = np.argsort(mean, kind="stable")
    difference = values[:, None] - values[None, :]
    centre, spread = difference.mean(axis=2), difference.std(axis=2, ddof=1)
    scaled = np.abs(difference - centre[..., None]) / np.where(spread > 0.0, spread, 1.0)[..., None]
    largest = np.sort(scaled[np.triu_indices(len(values), 1)].max(axis=0))
    rank = min(ceil((len(largest) + 1) * LEVEL - 1e-9), len(largest))
    half_widths = largest[rank - 1] * spread
    is_least = values == values.min(axis=0)
    return PairedRanking(
        order,
        values - values[order[0]],
        half_widths,
        np.abs(centre) > half_widths,
        (is_least / is_least.sum(axis=0)).mean(axis=1),
    )


def paint_choice(
    design: FingerDesign,
    pairs: Sequence[tuple[str, str]],
    normal_error_deg: Floats,
    separation_deg: Floats,
    exposure_rel: Floats,
    notes: Sequence[str] = (),
) -> PaintChoice:
    """Return the ranking of pairs of paints as a record.

    Parameters
    ----------
    design
        The finger.
    pairs
        Names of the paints on the red and on the green wall.
    normal_error_deg, separation_deg
        Draws, (pair, draw).
    exposure_rel
        Exposure time relative to the shortest, (pair,).
    notes
        What the numbers rest on.

    Raises
    ------
    CompareError
        With less than two pairs or too few draws.
    """
    ranking = rank_by_draws(normal_error_deg)
    best = int(ranking.order[0])
    rows = tuple(
        PaintPairRow(
            red=pairs[k][0],
            green=pairs[k][1],
            normal_error_deg=PropagatedDraws(normal_error_deg[k]).as_estimate(),
            above_best_deg=PropagatedDraws(ranking.above_best[k]).as_estimate(),
            is_worse=bool(ranking.told_apart[k, best]),
            best_share=float(ranking.best_share[k]),
            separation_deg=float(separation_deg[k].mean()),
            exposure_rel=float(exposure_rel[k]),
        )
        for k in ranking.order
    )
    return PaintChoice(
        name=f"{design.name}, paints",
        sentence=_paint_sentence(rows),
        paints=tuple(dict.fromkeys(paint for pair in pairs for paint in pair)),
        pairs=rows,
        normal_error_draws_deg=normal_error_deg[ranking.order],
        design=design,
        notes=tuple(notes),
    )


def _paint_sentence(rows: Sequence[PaintPairRow]) -> str:
    """Say which pair to take, how good it is, and which are as good."""
    best, others = rows[0], rows[1:]
    error = best.normal_error_deg
    told = interval_text(error.estimate, error.low95, error.high95, "deg")
    alike = [row for row in others if not row.is_worse]
    if not alike:
        rest = "Every other pair is worse."
    elif len(alike) == len(others):
        rest = "No other pair is shown to be worse: choose by other reasons, or measure the paints better."
    else:
        names = "; ".join(f"{row.red} and {row.green}" for row in alike[:_MOST_NAMED])
        more = f"; and {len(alike) - _MOST_NAMED} more" if len(alike) > _MOST_NAMED else ""
        rest = f"Not shown to be worse: {names}{more}. The other pairs are."
    return (
        f"Paint the red wall with {best.red} and the green wall with {best.green}: the expected error of the sensed "
        f"normal is {told}. {rest}"
    )


_MOST_NAMED = 3
