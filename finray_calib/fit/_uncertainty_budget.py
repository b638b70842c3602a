r"""Which source of uncertainty makes how much of the variance of a fitted paint: a budget that adds up to all of it.

With y = mu(x) + n, n normal of covariance N, the posterior is a mixture of components c: a shape of the learned prior,
a size of the departure, a second dye or none. Its mean of a quantity q follows a change d of the bands inside the
components, and by their weights, which the data decide:

.. math:: E[q|y+d] = \sum_c w_c(y+d)\,(\bar q_c + G d), \qquad
    \ln w_c(y+d) = \ln w_c(y) - d^T S_c^{-1}(y - m_c) - \tfrac12 d^T S_c^{-1} d + \mathrm{const}

with m_c and S_c of the bands that the component predicts, and the gain inside the components

.. math:: G = E_c[\mathrm{Cov}(q, \mu\,|\,y, c)]\, N^{-1}

For small d that is the exact derivative Cov(q, mu | y) N^-1, whatever the prior. N is a sum over independent sources,
and a source makes the variance of that mean over its own errors (GUM 5.1.2; where weights move, GUM supplement 1):

.. math:: \mathrm{Var}(q|y) = \sum_s \mathrm{Var}_{d \sim N(0, \Sigma_s)} E[q|y+d] + \mathrm{rest}, \qquad
    N = \sum_s \Sigma_s

The rest is what no measurement with these filters would know: the prior. In a linear model it is
:math:`\|P^{1/2}(g - A^T G^T)\|^2`, of which every part of the prior, independent of the others, has its own term. The
departure of a paint from the shapes that were learned is one of them (model discrepancy), taken for each component of
the posterior.

Large errors move weight to components that the posterior hardly holds. These are drawn too, and w_c(y) is their
evidence, not the share of draws that met them; a component counts as far as its draws conserve energy.

Limits: N and the height that scales a departure are those of the bands which were measured, and all components share
one gain. Where sources that move the weights make more than all of the variance together, they are reduced in
proportion, so that the rest is never below zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import EXTRAPOLATION_UNCERTAINTY_REL, BandSignals, FitError, PaintCalibration, percent
from finray_calib.fit._band_data import BandData, band_data
from finray_calib.fit._measured_spectra import ScoredSpectra, height_prior, learned_spectra, scored_components
from finray_calib.fit._prior import EmissionPrior
from finray_calib.fit._reported_spectrum import (
    FEWEST_CONSERVING,
    MEASURED_SPECTRA_TITLE,
    SpectrumPosterior,
    conserves,
    conserving_draws,
    draw_components,
    draw_spectra,
)
from finray_calib.spectra import curve_quantities, extrapolated_shares

Floats = NDArray[np.float64]

BUDGETED: Final = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield", "reflectance_at_laser", "stokes_shift_nm")
DRAWS: Final = 20_000
"""Of the posterior."""
_LEAST_DRAWS: Final = 20
_LEAST_WEIGHT: Final = 1e-7
"""Components that hardly any draw meets decide what large errors do, since these move weight to them: each above this
weight is drawn so often at least, and counts by its weight, not by its draws."""
_SHIFTS: Final = 2000
"""Errors drawn of each source, moved and scaled to mean zero and unit covariance: a linear model has no scatter."""
_SAME_SD: Final = 0.25
"""A refit may leave the record's median by so many of its standard deviations."""
SHARED_BY_ALL: Final = "errors common to all values: laser level, texture of the region, bleaching"
MODEL_DISCREPANCY: Final = "departure of the paint from the shapes that were learned"
PRIOR: Final = "prior of the spectrum: what the filters do not measure"
PRIOR_OF_ABSORPTION: Final = "prior of the absorption, and other lights"
Evaluation = Literal["A", "B", "prior"]


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """What one source contributes to the uncertainty of one quantity.

    Attributes
    ----------
    quantity
        Name of the quantity, with its unit.
    source, size
        What it is, and how large it was taken to be.
    evaluation
        A: from the scatter of frames; B: stated in the rig file or assumed; prior: believed before the measurement.
    standard_uncertainty
        In the unit of the quantity, k = 1.
    share
        Of the variance; those of a quantity add up to 1.
    """

    quantity: str
    source: str
    size: str
    evaluation: Evaluation
    standard_uncertainty: float
    share: float


@dataclass(frozen=True, slots=True)
class UncertaintySource:
    """A source of uncertainty of the bands.

    Attributes
    ----------
    name, size, evaluation
        As of :class:`BudgetRow`.
    root
        (K, M) root of its covariance over the usable bands.
    """

    name: str
    size: str
    evaluation: Evaluation
    root: Floats


@dataclass(frozen=True, slots=True)
class ComponentDraws:
    """Draws of the posterior in which a component may be met more often than its weight asks for.

    Attributes
    ----------
    values
        (n, Q) quantities.
    bands
        (n, K) values of the usable bands that the paint gives without any error.
    component
        (n,) component of each.
    weight
        (n,) of each; they add up to 1.
    """

    values: Floats
    bands: Floats
    component: NDArray[np.int64]
    weight: Floats


def uncertainty_budget(bands: BandSignals, paint: PaintCalibration, seed: int = 0) -> tuple[BudgetRow, ...]:
    r"""Return the budget of a fitted paint, by quantity and source, whose shares add up to 1 for each quantity.

    .. math:: u_s = \sqrt{G \Sigma_s G^T}, \qquad \sum_s u_s^2 = u^2

    Valid for a paint that rests on the prior learned from measured spectra. Standard uncertainties are k = 1; the
    quantity's own is that of the record.

    Parameters
    ----------
    bands
        The band signals that it was fitted to.
    paint
        Its calibration.
    seed
        Of the draws.

    Raises
    ------
    FitError
        The paint rests on a family of curves, or these band signals do not give it.
    """
    if paint.spectrum_from != MEASURED_SPECTRA_TITLE:
        raise FitError(
            f"'{paint.paint_name}': the spectrum comes from {paint.spectrum_source}, but a budget needs the prior "
            "learned from measured spectra; fit the paint without --family and --no-discrepancy"
        )
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small
        return _budget(bands, band_data(bands), paint, np.random.default_rng(seed))


def _budget(
    bands: BandSignals, data: BandData, paint: PaintCalibration, rng: np.random.Generator
) -> tuple[BudgetRow, ...]:
    """Return the budget."""
    fitted = scored_components(data, learned_spectra(), EmissionPrior().ln_blocking_sd)
    raw = draw_spectra(fitted, DRAWS, rng)
    drawn = conserving_draws(raw, data)
    quantities = quantity_draws(drawn.curves, drawn.reflectance_at_laser, data)
    _require_same(quantities, paint)
    sources = budget_sources(bands, data, fitted)
    variance, made = source_shares(component_draws(raw, fitted, data, rng), fitted, sources)
    shares = {name: (float(variance[i]), made[:, i]) for i, name in enumerate(quantities)}
    departures = _departure_variances(drawn, fitted, rng)
    rows = [
        row
        for name, found in shares.items()
        for row in _rows(name, paint.parameters[name].sd, sources, found, departures.get(name, 0.0))
    ]
    return (*rows, *_stokes_rows(paint, [row for row in rows if row.quantity == "mode_nm"]))


def quantity_draws(curves: Floats, reflectance: Floats, data: BandData) -> dict[str, Floats]:
    """Return the draws (n,) of each quantity, from curves (n, L) and reflectances (n,)."""
    found = curve_quantities(curves, data.weights.wavelength_nm)
    return {
        "mode_nm": found.mode_nm,
        "fwhm_nm": found.fwhm_nm,
        "peak_per_nm": found.peak_per_nm,
        "energy_yield": found.energy_yield,
        "reflectance_at_laser": reflectance,
    }


def component_draws(
    drawn: SpectrumPosterior, fitted: ScoredSpectra, data: BandData, rng: np.random.Generator
) -> ComponentDraws:
    """Return draws of the posterior and more of its rare components, those left out that emit too many photons.

    Parameters
    ----------
    drawn, fitted
        Draws of the posterior, with those that emit too many photons, and the posterior.
    data
        Band values of the region.
    rng
        Source of all randomness.
    """
    weight = fitted.scored.weight
    met = np.bincount(drawn.components, minlength=weight.size)
    more = np.where(weight > _LEAST_WEIGHT, np.maximum(_LEAST_DRAWS - met, 0), 0)
    rare = np.repeat(np.arange(weight.size), more)
    curves, both, bands = draw_components(fitted, rare, rng)
    curves, bands = np.concatenate([drawn.curves, curves]), np.concatenate([drawn.band_draws, bands])
    reflectance = np.concatenate([drawn.reflectance_at_laser, both[:, 1]])
    component = np.concatenate([drawn.components, rare])
    good, posterior = conserves(curves, reflectance, data), drawn.components.size
    if good[:posterior].sum() < min(FEWEST_CONSERVING, posterior):
        good[:] = True
    share = (weight / np.maximum(met + more, 1))[component[good]]
    values = quantity_draws(curves[good], reflectance[good], data)
    return ComponentDraws(np.stack(list(values.values()), axis=1), bands[good], component[good], share / share.sum())


def _require_same(quantities: Mapping[str, Floats], paint: PaintCalibration) -> None:
    """Refuse band signals that give another calibration."""
    for name in ("mode_nm", "fwhm_nm", "energy_yield"):
        stored, again = paint.parameters[name], quantities[name]
        if abs(float(np.median(again)) - stored.estimate) > _SAME_SD * stored.sd:
            raise FitError(
                f"'{paint.paint_name}': these band signals do not reproduce this calibration ({name} is "
                f"{float(np.median(again)):.6g}, but {stored.estimate:.6g} in the record), so no budget can be made "
                "from them; give the band signals to which the calibration was fitted, or fit them again if an "
                "earlier version did"
            )


def budget_sources(bands: BandSignals, data: BandData, fitted: ScoredSpectra) -> tuple[UncertaintySource, ...]:
    """Return the sources of the bands' uncertainty; their covariances add up to that of the likelihood.

    Parameters
    ----------
    bands, data
        The band signals, and the same as data of the likelihood.
    fitted
        The posterior, which knows the filters' columns.
    """
    kept, optics, stated = data.kept, bands.optics, bands.optics.band_uncertainty
    y, filters = data.y.ravel()[kept], bands.optics.filters
    usual = bands.fluorescence_covariance[np.ix_(kept, kept)]
    beside = data.covariance[np.ix_(kept, kept)] - usual  # channel response, ends of curves, stray light: diagonal
    most = 1 / float(y @ np.linalg.solve(usual, y))  # more of y y^T would leave no positive semidefinite covariance
    tile = min(data.tile_uncertainty_rel**2, most) * np.outer(y, y)
    level = fitted.rig.data.level[kept]
    common = most * np.outer(y, y) - tile
    white_at_fit = min(data.tile_uncertainty_rel, most**0.5) * level[:, None]
    relative = np.hypot(stated.response_rel, EXTRAPOLATION_UNCERTAINTY_REL * extrapolated_shares(optics)).ravel()[kept]
    response = np.minimum((relative * y) ** 2, np.diag(beside))
    count, lamp = data.weights.bands, data.lamp_response_rel is not None
    calibration, rest = np.split(fitted.columns, [count], axis=1)
    lit, rest = np.split(rest, [int(lamp)], axis=1)
    tolerances = count if data.tolerances is not None else 0
    centre, width, leak = np.split(rest, [tolerances, 2 * tolerances], axis=1)

    def largest(field: str) -> float:
        return max(float(getattr(band, field)) for band in filters)

    noise = float(np.median(np.sqrt(np.diag(usual - tile - common)) / np.maximum(np.abs(y), 1e-300)))
    white = data.tile_uncertainty_rel
    shared = max(most - white**2, 0.0) ** 0.5
    return (
        UncertaintySource("noise of the frames", f"{100 * noise:.1f} % of a value (median)", "A",
                          _root(usual - tile - common)),
        UncertaintySource(SHARED_BY_ALL, f"{100 * shared:.1f} %", "A", _root(common)),
        UncertaintySource("white reference", f"{100 * white:.1f} %", "B", white_at_fit),
        UncertaintySource("calibration of each filter", percent(data.band_calibration_rel), "B", calibration),
        UncertaintySource("centres of the filters", f"at most {largest('center_uncertainty_nm'):g} nm", "B", centre),
        UncertaintySource("widths of the filters", f"at most {largest('fwhm_uncertainty_nm'):g} nm", "B", width),
        UncertaintySource("leak of the filters", f"at most {largest('blocking_uncertainty_od'):g} OD", "B", leak),
        UncertaintySource("camera response", f"{percent(stated.response_rel)} of each channel", "B",
                          _diagonal(response)),
        UncertaintySource("stray light", f"{percent(stated.stray_light_rel)} of the brightest filter", "B",
                          _diagonal(np.diag(beside) - response)),
        UncertaintySource("colour temperature of the lamp", f"{optics.lamp_temperature_uncertainty_k:g} K", "B", lit),
    )  # fmt: skip


def _diagonal(variance: Floats) -> Floats:
    """Return the root of a diagonal covariance."""
    return np.diag(np.sqrt(np.maximum(variance, 0.0)))


def _root(covariance: Floats) -> Floats:
    """Return a root of a positive semidefinite matrix; rounding below zero counts as zero."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def source_shares(
    drawn: ComponentDraws, fitted: ScoredSpectra, sources: tuple[UncertaintySource, ...]
) -> tuple[Floats, Floats]:
    """Return the variance (Q,) of quantities and the share (S, Q) of it that each source of the bands makes.

    Parameters
    ----------
    drawn, fitted
        Draws of the posterior; the bands' covariance and the evidence of components.
    sources
        Of the bands.
    """
    variance = drawn.weight @ (drawn.values - drawn.weight @ drawn.values) ** 2
    # by its name: a source's errors do not depend on which others there are
    seeds = [np.random.default_rng(list(source.name.encode())) for source in sources]
    errors = [_standardised(rng, s.root.shape[1]) @ s.root.T for rng, s in zip(seeds, sources, strict=True)]
    made = np.array([means.var(axis=0) for means in moved_means(drawn, fitted, errors)])
    shares = made / np.maximum(variance, 1e-300)
    return variance, shares / np.maximum(shares.sum(axis=0), 1.0)


def moved_means(drawn: ComponentDraws, fitted: ScoredSpectra, errors: Sequence[Floats]) -> list[Floats]:
    """Return the posterior means (M, Q) of quantities, had the bands been off by errors (M, K) more, for each errors.

    The components' means follow, and so do their weights; the other parameters as of :func:`source_shares`.
    """
    order = np.argsort(drawn.component, kind="stable")
    places, start, count = np.unique(drawn.component[order], return_index=True, return_counts=True)
    values, bands, weight = drawn.values[order], drawn.bands[order], drawn.weight[order]
    means, centres = (np.add.reduceat(of, start) / count[:, None] for of in (values, bands))
    inside, apart = values - np.repeat(means, count, axis=0), bands - np.repeat(centres, count, axis=0)
    # a single draw shows no covariance: its component's weight goes to the others
    freedom = weight * np.repeat(np.where(count > 1, count / np.maximum(count - 1, 1), 0.0), count)
    alike = max(float(weight[np.repeat(count > 1, count)].sum()), 1e-300)
    gain = np.linalg.solve(fitted.noise, apart.T @ (freedom[:, None] * inside)) / alike
    ln_weight = np.log(np.add.reduceat(weight, start))
    slope, curvature = fitted.evidence_derivatives(places)
    found = []
    for error in errors:
        squares = (error[:, :, None] * error[:, None, :]).reshape(len(error), -1)
        ln = ln_weight + error @ slope.T + 0.5 * squares @ curvature.reshape(places.size, -1).T
        moved = np.exp(ln - ln.max(axis=1, keepdims=True))
        found.append(np.asarray(moved @ means / moved.sum(axis=1, keepdims=True) + error @ gain))
    return found


def _standardised(rng: np.random.Generator, columns: int) -> Floats:
    """Return normal numbers (n, columns) whose mean and covariance are exactly those of the distribution."""
    drawn = rng.standard_normal((_SHIFTS, columns))
    drawn -= drawn.mean(axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(drawn.T @ drawn / _SHIFTS), drawn.T).T)


def _departure_variances(drawn: SpectrumPosterior, fitted: ScoredSpectra, rng: np.random.Generator) -> dict[str, float]:
    """Return the variance that the paint's own departure makes of each quantity of the curve.

    A departure d drawn from its prior moves the curve by d - X G A d with the gain G of its component, and the quantity
    by half of its difference between the two sides of a draw.
    """
    own = fitted.shape_directions
    moved = np.zeros_like(drawn.curves)
    for place in np.unique(drawn.components):
        rows = np.flatnonzero(drawn.components == place)
        v = fitted.directions(int(place))
        z = rng.standard_normal((rows.size, len(v) - own))
        moved[rows] = z @ (v[own:] - _followed(fitted, int(place), v, v[own:] @ fitted.rig.emission.T))
    more, less = (np.maximum(drawn.curves + sign * moved, 0.0) for sign in (1.0, -1.0))
    grid = fitted.parts.wavelength_nm
    above, below = (curve_quantities(curves, grid) for curves in (more, less))
    names = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield")
    return {name: float(np.mean((0.5 * (getattr(above, name) - getattr(below, name))) ** 2)) for name in names}


def _followed(fitted: ScoredSpectra, place: int, directions: Floats, seen: Floats) -> Floats:
    """Return the curves (n, L) that the estimate of a component follows, for changes (n, K) of the bands."""
    rig, parts, which = fitted.rig, fitted.parts, fitted.scored.chosen[place]
    variance = height_prior(parts, np.array([which]))[1][0] ** -1
    curves = np.concatenate([np.sqrt(variance[0]) * parts.curves[which][None], directions])
    bands = np.concatenate([curves @ rig.emission.T, np.sqrt(variance[1]) * rig.laser[None]])
    solved = np.linalg.solve(bands.T @ bands + fitted.noise, seen.T)
    return np.asarray((bands[:-1] @ solved).T @ curves)


def _rows(
    name: str, sd: float, sources: tuple[UncertaintySource, ...], found: tuple[float, Floats], departure: float
) -> list[BudgetRow]:
    """Return the rows of one quantity: sources of the bands, then what is left, the model's part of it first."""
    variance, shares = found
    left = max(1.0 - float(shares.sum()), 0.0)
    model = min(departure / max(variance, 1e-300), left)
    every = [*((s.name, s.size, s.evaluation, float(v)) for s, v in zip(sources, shares, strict=True))]
    every.append((MODEL_DISCREPANCY, "three sizes, averaged", "prior", model))
    every.append((PRIOR, "learned from measured spectra", "prior", left - model))
    return [BudgetRow(name, source, size, kind, sd * max(v, 0.0) ** 0.5, v) for source, size, kind, v in every]


def _stokes_rows(paint: PaintCalibration, mode: list[BudgetRow]) -> list[BudgetRow]:
    """Return the rows of the Stokes shift: it follows the mode as its draws do, and the rest is the absorption."""
    shift = paint.reradiation.stokes_shift_draws_nm
    grid, curves = paint.wavelength_nm, paint.emission_draws_per_nm[: shift.size]
    modes = curve_quantities(np.maximum(curves, 0.0), grid).mode_nm
    through = float(np.corrcoef(modes, shift)[0, 1] ** 2) if modes.std() > 0 and shift.std() > 0 else 0.0
    sd = paint.reradiation.stokes_shift_nm.sd
    every = [(row.source, row.size, row.evaluation, through * row.share) for row in mode]
    every.append((PRIOR_OF_ABSORPTION, "see the Stokes shift's statement", "prior", 1.0 - through))
    return [BudgetRow("stokes_shift_nm", *row[:3], sd * max(row[3], 0.0) ** 0.5, row[3]) for row in every]
