"""Normal distributions of the directions from which light reaches the coating, fitted to light paths."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CELLS_ACROSS, CELLS_ALONG = 12, 24
ROUTES = 4
"""One mirror; mirror and outside of the gel; both and the mirror again; all others, such as through an end."""

NUMBERS = 12
"""Of a route in a cell: chance, mean and its change across and along, Cholesky factor, and two zeros: three packets."""

_FEWEST_PATHS = 12
# the distribution is wider than what was learned: it must cover the panel's corners, which fewer light paths met
_WIDENING = 1.3
_LEAST_SPREAD = 0.01
# weight of the prior "no change within a cell" against the spread of the light paths over it
_STIFFNESS = 0.01
# a route's chance follows the root of its light: weak routes pass the faces by chance, so that each needs more paths
_BALANCE = 0.5


def fit_lobes(uv: Floats, slopes: Floats, light: Floats, route: NDArray[np.integer[Any]]) -> Floats:
    """Fit a normal distribution of slopes, whose mean is linear in the place, per cell of the coating and route.

    Parameters
    ----------
    uv
        Where light arrived, texture coordinates of the coating, shape (n, 2).
    slopes
        From where, shape (n, 2).
    light
        How much, shape (n,).
    route
        Number of the route, shape (n,).

    Returns
    -------
    array
        Shape (CELLS_ACROSS * CELLS_ALONG, ROUTES, 12): chance; mean slopes; their change over the cell across, along;
        Cholesky factor (00, 10, 11); two zeros. Routes that fewer than 12 paths took have chance zero.
    """
    uv, slopes, light, route, corner = _shared_with_neighbours(uv, slopes, light, route)
    cell = (corner[:, 0] * CELLS_ALONG + corner[:, 1]) * ROUTES + route
    count = CELLS_ACROSS * CELLS_ALONG * ROUTES

    def summed(values: Floats) -> Floats:
        return np.asarray(np.bincount(cell, weights=light * values, minlength=count), dtype=np.float64)

    terms = np.column_stack([np.ones(len(uv)), uv * (CELLS_ACROSS, CELLS_ALONG) - corner - 0.5])
    total = summed(terms[:, 0])
    known = (np.bincount(cell, minlength=count) >= _FEWEST_PATHS) & (total > 0.0)
    gram = np.array([[summed(a * b) for b in terms.T] for a in terms.T]).transpose(2, 0, 1)
    gram += (_STIFFNESS * total)[:, None, None] * np.diag([0.0, 1.0, 1.0])
    moments = np.array([[summed(a * b) for b in slopes.T] for a in terms.T]).transpose(2, 0, 1)
    mean = np.zeros_like(moments)
    mean[known] = np.linalg.solve(gram[known], moments[known])
    rest = slopes - np.einsum("ni,nij->nj", terms, mean[cell])
    covariance = np.array([[summed(a * b) for b in rest.T] for a in rest.T]).transpose(2, 0, 1)
    covariance *= _WIDENING**2 / np.where(known, total, 1.0)[:, None, None]
    factor = np.linalg.cholesky(covariance + _LEAST_SPREAD**2 * np.eye(2))
    chance = np.where(known, total, 0.0).reshape(-1, ROUTES) ** _BALANCE
    chance /= np.where(chance.any(axis=1), chance.sum(axis=1), 1.0)[:, None]
    numbers = [chance.ravel(), *mean.reshape(count, 6).T, *factor[:, (0, 1, 1), (0, 0, 1)].T]
    return np.column_stack([*numbers, *np.zeros((NUMBERS - len(numbers), count))]).reshape(-1, ROUTES, NUMBERS)


def _shared_with_neighbours(
    uv: Floats, slopes: Floats, light: Floats, route: NDArray[np.integer[Any]]
) -> tuple[Floats, Floats, Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Return the same with the cell of each path; paths of the rarer routes count in the cells around theirs too."""
    corner = np.floor(uv * (CELLS_ACROSS, CELLS_ALONG)).astype(np.int64)
    row, shift = [np.arange(len(uv))], [np.zeros((len(uv), 2), dtype=np.int64)]
    rare = np.flatnonzero(route > 0)
    for step in ((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)):
        row.append(rare)
        shift.append(np.full((len(rare), 2), step))
    rows, corners = np.concatenate(row), corner[np.concatenate(row)] + np.concatenate(shift)
    inside = ((corners >= 0) & (corners < (CELLS_ACROSS, CELLS_ALONG))).all(axis=1)
    kept = rows[inside]
    return uv[kept], slopes[kept], light[kept], route[kept].astype(np.int64), corners[inside]
