"""How well one light angle lets a tactile camera tell the direction of a surface: arithmetic on tables of colours.

A facet with slopes g = (g_x, g_z) over the pad's plane has the normal n ~ (-g_x, 1, -g_z). Signals are electrons per
pixel; whoever calls brings the exposure.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError

Floats = NDArray[np.float64]

#: Of the polynomial from colour and place to slopes: 56 terms of five variables, enough for the bend of both.
POLYNOMIAL_DEGREE: Final = 3


def normal_sigma_deg(jacobian_e: Floats, variance_e2: Floats) -> Floats:
    r"""Return the least standard deviation with which one pixel tells the direction of a normal (Cramer-Rao bound).

    .. math:: F = J^T \mathrm{diag}(1 / v) J, \qquad \sigma = \sqrt{\mathrm{tr} F^{-1} / 2}

    Valid for independent normal noise of the channels and a facet near the plane, where a slope is an angle. It holds
    brightness and the separation of colours together: three channels that change alike tell nothing.

    Parameters
    ----------
    jacobian_e
        Derivatives of the channels by both slopes, (..., channel, 2), in e.
    variance_e2
        Variance of each channel, (..., channel), in e^2.

    Returns
    -------
    array
        Standard deviation per direction in deg, (...); infinite where the colours determine no slope.

    Raises
    ------
    CompareError
        When shapes do not fit each other or a variance is not positive.

    References
    ----------
    S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 3.7.
    """
    if jacobian_e.shape != (*variance_e2.shape, 2) or not (variance_e2 > 0.0).all():
        raise CompareError(
            f"the Fisher information needs derivatives (..., channel, 2) and positive variances (..., channel); got "
            f"{jacobian_e.shape} and {variance_e2.shape}, least variance {variance_e2.min():g} e^2. Check the table"
        )
    information = np.einsum("...ci,...c,...cj->...ij", jacobian_e, 1.0 / variance_e2, jacobian_e)
    a, b, c = information[..., 0, 0], information[..., 1, 1], information[..., 0, 1]
    determinant = a * b - c * c
    # a dozen roundings leave a singular matrix slightly off zero
    regular = determinant > 16.0 * np.finfo(np.float64).eps * np.maximum(a * b, np.finfo(np.float64).tiny)
    trace = np.divide(a + b, determinant, out=np.full(a.shape, np.inf), where=regular)
    return np.asarray(np.degrees(np.sqrt(trace / 2.0)))


def held_out_normal_error_deg(
    signals: Floats,
    places_mm: Floats,
    slopes: Floats,
    folds: int = 3,
    degree: int = POLYNOMIAL_DEGREE,
    taught: Floats | None = None,
) -> Floats:
    r"""Return the angle between true and estimated normals at places that the calibration has not seen.

    Points fall into folds in turn. For each fold the polynomial (R, G, B, x, z) -> (g_x, g_z) is fitted by least
    squares to all facets of the other folds and applied to the facets of this one, as a tactile sensor that was
    calibrated with presses elsewhere. Noise is in the signals, in the calibration as in the judgement.

    Parameters
    ----------
    signals
        (point, facet, frame, channel), any linear unit: frames are independent repeats of the camera's noise.
    places_mm
        (x, z) of the points, (point, 2).
    slopes
        True slopes of the facets, (facet, 2).
    folds
        At least 2, at most the number of points.
    degree
        Of the polynomial.
    taught
        Signals of the same points on the finger that was calibrated, in the same shape; by default it is this one.

    Returns
    -------
    array
        Angle in deg, (point, facet, frame).

    Raises
    ------
    CompareError
        When shapes do not fit each other, or the calibration has fewer rows than the polynomial has terms.
    """
    _check_table(signals, places_mm, slopes, folds, degree)
    if taught is not None and taught.shape != signals.shape:
        raise CompareError(f"the calibrated finger has signals {taught.shape}, this one {signals.shape}: give the same")
    points, facets, frames, _ = signals.shape
    place = np.broadcast_to(places_mm[:, None, None], (points, facets, frames, 2))
    inputs = np.concatenate([signals, place], axis=-1)
    teaching = inputs if taught is None else np.concatenate([taught, place], axis=-1)
    truth = np.broadcast_to(slopes[None, :, None], (points, facets, frames, 2))
    found = np.empty(truth.shape)
    for held_out, others in _folds(points, folds):
        seen = teaching[others].reshape(-1, inputs.shape[-1])
        centre, spread = seen.mean(axis=0), seen.std(axis=0)
        # a variable that does not vary tells nothing, and must not be divided by zero
        scale = np.where(spread > 0.0, spread, 1.0)
        terms = _monomials((seen - centre) / scale, degree)
        weights = np.linalg.lstsq(terms, truth[others].reshape(-1, 2), rcond=None)[0]
        asked = (inputs[held_out].reshape(-1, inputs.shape[-1]) - centre) / scale
        found[held_out] = (_monomials(asked, degree) @ weights).reshape(-1, facets, frames, 2)
    return angle_between_deg(found, truth)


def angle_between_deg(slopes: Floats, other_slopes: Floats) -> Floats:
    """Return the angle between the normals of slopes (..., 2) and (..., 2) in deg, (...)."""
    a, b = (np.concatenate([-g[..., :1], np.ones((*g.shape[:-1], 1)), -g[..., 1:]], axis=-1) for g in (
        slopes, other_slopes))  # fmt: skip
    # exact for small angles, where the cosine is not
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (a * b).sum(axis=-1))))


def uniformity(luminance: Floats) -> float:
    """Return the 5 % over the 95 % quantile of the luminance without contact: 1 where all places are equally bright.

    Raises
    ------
    CompareError
        When there is no place, or one without light.
    """
    if luminance.size == 0 or not (luminance > 0.0).all():
        raise CompareError(
            f"the uniformity needs positive luminances of at least one place, got {luminance.size} with the least "
            f"{luminance.min(initial=np.inf):g}. Check the light panel"
        )
    low, high = np.quantile(luminance, [0.05, 0.95])
    return float(low / high)


def _folds(points: int, folds: int) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Yield which points are held out and which are not."""
    fold = np.arange(points) % folds
    for k in range(folds):
        yield fold == k, fold != k


def _monomials(inputs: Floats, degree: int) -> Floats:
    """Return all products of up to `degree` of the variables, (row, term)."""
    columns = [np.ones(len(inputs))]
    for order in range(1, degree + 1):
        for chosen in combinations_with_replacement(range(inputs.shape[1]), order):
            columns.append(np.prod(inputs[:, chosen], axis=1))
    return np.stack(columns, axis=1)


def _check_table(signals: Floats, places_mm: Floats, slopes: Floats, folds: int, degree: int) -> None:
    """Refuse a table that allows no calibration."""
    if signals.ndim != 4 or places_mm.shape != (signals.shape[0], 2) or slopes.shape != (signals.shape[1], 2):
        raise CompareError(
            f"a calibration table needs signals (point, facet, frame, channel), places (point, 2) and slopes (facet, "
            f"2); got {signals.shape}, {places_mm.shape} and {slopes.shape}"
        )
    variables = signals.shape[3] + 2
    terms = len(_monomials(np.zeros((1, variables)), degree)[0])
    points = signals.shape[0]
    if not 2 <= folds <= points:
        raise CompareError(f"held-out points need 2 to {points} folds for {points} points, got {folds}")
    rows = (points - -(-points // folds)) * signals.shape[1] * signals.shape[2]
    if rows < terms:
        raise CompareError(
            f"the calibration has {rows} rows for {terms} terms of a polynomial of degree {degree}; take more points, "
            "facets or frames, or a smaller degree"
        )
