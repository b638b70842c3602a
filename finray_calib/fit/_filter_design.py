r"""Which emission filters a rig should have, and which filter would tell most beside those that a session had.

Sets are screened by a linear estimate. With curves f of the learned prior, unit norm, mean m and covariance S, seen by
filters w_h through the rig's own lamp and camera with noise N,

.. math:: \hat f = m + S A^T (A S A^T + N)^{-1} (A f - A m), \qquad
          e = \mathrm{mean}\,\frac{\|\hat f - f\|}{\|f\|}

and slots are exchanged one at a time over the whole catalogue, from several starts, until no exchange helps (Fedorov).
The estimate ranks; its numbers are two to three times those of the fit. What is told is therefore the error of whole
fits of paints that were drawn from the prior, with the chosen filters and with those of the rig, pair by pair.

After a session the covariance is that of the posterior, and one filter h with noise n takes from it

.. math:: 1 - \frac{\mathrm{tr}\,V'}{\mathrm{tr}\,V} = \frac{\|V w_h\|^2}{(w_h^T V w_h + n)\,\mathrm{tr}\,V}

Valid for paints like those that were learned, and for filters that are as the catalogue says.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import BandPassFilter, BandUncertainty, FitError, Optics, PaintCalibration, SpectralCurve
from finray_calib.fit._band_data import LARGEST_LEAK_OF_WHITE, BandData, band_values
from finray_calib.fit._measured_spectra import band_errors, components_of, learned_spectra, random_paints
from finray_calib.fit._prior import EmissionPrior
from finray_calib.fit._reported_spectrum import fit_spectrum
from finray_calib.spectra import (
    WAVELENGTH_NM,
    EmissionWeights,
    band_tolerances,
    lamp_response,
    rig_emission_weights,
)

Floats = NDArray[np.float64]

JUDGED_NM: Final = (470.0, 720.0)
"""Where errors count."""
SCREENED_PAINTS: Final = 400
STARTS: Final = 8
_SWEEPS: Final = 4
_GRID_STEP: Final = 4  # of the curves while sets are screened, nm
_NOISE_REL: Final = 0.003
_FIT_DRAWS: Final = 200
_RESAMPLES: Final = 2000
_LASER_APART_NM: Final = 12.0
STOCK_CENTRES_NM: Final = tuple(float(nm) for nm in range(450, 721, 10))
STOCK_WIDTHS_NM: Final = (10.0, 25.0, 40.0)
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class CatalogueFilter:
    """A filter that can be bought.

    Attributes
    ----------
    centre_nm, width_nm
        Centre and full width at half maximum, nm.
    peak_transmission
        0 to 1.
    """

    centre_nm: float
    width_nm: float
    peak_transmission: float


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """The chosen filters with their errors beside those of the rig.

    Attributes
    ----------
    filters
        All filters of the designed rig, the one at the laser and kept ones too.
    kept
        Names of those that the rig has already.
    screened_rel, screened_rig_rel
        Mean relative error of the linear estimate, of the designed and of the rig's own set.
    errors, errors_rig
        (n,) relative error of the whole fit of each simulated paint.
    median_ratio, mean_ratio
        Designed over the rig's own: the ratio and its 95 % interval (paired bootstrap over paints).
    """

    filters: tuple[BandPassFilter, ...]
    kept: tuple[str, ...]
    screened_rel: float
    screened_rig_rel: float
    errors: Floats
    errors_rig: Floats
    median_ratio: tuple[float, float, float]
    mean_ratio: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class NextFilter:
    """A filter that a session did not have.

    Attributes
    ----------
    filter
        Of the catalogue.
    reduction_rel
        Share of the variance of the curve that it is expected to take away.
    """

    filter: CatalogueFilter
    reduction_rel: float


def stock_catalogue() -> tuple[CatalogueFilter, ...]:
    """Return plain filters at stock centres, every 10 nm from 450 to 720 nm, 10, 25 and 40 nm wide."""
    return tuple(CatalogueFilter(c, w, 0.6 if w <= 10 else 0.9) for c in STOCK_CENTRES_NM for w in STOCK_WIDTHS_NM)


_MOST_SLOTS: Final = 64
"""As a rig file numbers them."""
_COLUMNS: Final = {"centre_nm": (200.0, 2000.0), "width_nm": (1.0, 500.0), "peak_transmission": (1e-3, 1.0)}


def filter_catalogue(
    header: Sequence[str], rows: Sequence[tuple[int, Sequence[str]]], origin: str
) -> tuple[CatalogueFilter, ...]:
    """Return the filters of a catalogue: columns centre_nm, width_nm and peak_transmission (0 to 1), one a row.

    Parameters
    ----------
    header
        Names of the columns.
    rows
        Line and cells of each row.
    origin
        The file that they were read from, for errors.

    Raises
    ------
    FitError
        A column is lacking, there is no row, or a value is not a number in its range.
    """
    if lacking := [name for name in _COLUMNS if name not in header]:
        raise FitError(
            f"{origin}: the column {', '.join(lacking)} is missing; a catalogue must have the columns "
            f"{', '.join(_COLUMNS)}"
        )
    if not rows:
        raise FitError(
            f"{origin}: holds no filter; give one filter in each row, with the columns {', '.join(_COLUMNS)}"
        )
    places = [header.index(name) for name in _COLUMNS]
    return tuple(CatalogueFilter(*_numbers(f"{origin}, line {line}", cells, places)) for line, cells in rows)


def _numbers(where: str, cells: Sequence[str], places: Sequence[int]) -> list[float]:
    """Return centre, width and transmission of a row."""
    found = []
    for (name, (low, high)), place in zip(_COLUMNS.items(), places, strict=True):
        text = cells[place] if place < len(cells) else ""
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not low <= value <= high:
            raise FitError(f"{where}: {name} is {text!r}, but must be a number from {low:g} to {high:g}")
        found.append(value)
    return found


def design_filters(
    optics: Optics,
    catalogue: Sequence[CatalogueFilter],
    number: int | None = None,
    keep_nm: Sequence[float] = (),
    paints: int = 40,
    seed: int = 0,
    progress: Progress = lambda done, total, what: None,
) -> FilterDesign:
    """Choose the filters of a rig that give the smallest expected error of the emission curve.

    Parameters
    ----------
    optics
        The rig's laser, lamp, camera and present filters.
    catalogue
        What can be bought.
    number
        Filters altogether, the one at the laser and kept ones too; by default as many as the rig has.
    keep_nm
        Centres of filters of the rig that must stay, nm.
    paints
        How many paints are fitted with either set; 0 fits none.
    seed
        Of paints, starts and noise.
    progress
        Called with (done, total, text).

    Raises
    ------
    FitError
        A kept centre is none of the rig's, or the catalogue or the number leave no choice.
    """
    kept = _kept(optics, keep_nm)
    wanted = (len(optics.filters) if number is None else number) - len(kept)
    offered = _other_than(kept, [f for f in catalogue if _usable(f, optics)])
    most = min(len(kept) + len(offered), _MOST_SLOTS)
    if not 1 <= wanted <= most - len(kept):
        raise FitError(
            f"design: the number of filters must be {len(kept) + 1} to {most} (--number), but "
            f"{wanted + len(kept)} were requested; {len(kept)} are kept, {len(offered)} others of the catalogue "
            f"pass no laser light, and a rig has {_MOST_SLOTS} slots at most"
        )
    rng = np.random.default_rng(seed)
    with threadpool_limits(limits=1, user_api="blas"):
        screen = _Screen.of(optics, kept, offered, rng)
        chosen, screened = screen.exchanged(wanted, rng, progress)
        new = tuple(_as_filter(offered[i], optics, slot) for slot, i in enumerate(chosen, len(kept) + 1))
        filters = tuple(sorted((*kept, *new), key=lambda f: f.center_nm))
        filters = tuple(f.model_copy(update={"slot": slot}) for slot, f in enumerate(filters, 1))
        designed = optics.model_copy(update={"filters": filters, "filter_curves": _curves_of(optics, kept)})
        pair = fitted_errors((designed, optics), paints, rng, progress)
    return FilterDesign(
        filters=filters,
        kept=tuple(f.name for f in kept),
        screened_rel=screened,
        screened_rig_rel=screen.error_of_rig(optics),
        errors=pair[0],
        errors_rig=pair[1],
        median_ratio=paired_ratio(pair[0], pair[1], np.median, rng),
        mean_ratio=paired_ratio(pair[0], pair[1], np.mean, rng),
    )


def next_filters(paint: PaintCalibration, catalogue: Sequence[CatalogueFilter]) -> tuple[NextFilter, ...]:
    """Rank the filters of a catalogue by how much variance of a fitted curve each would remove, best first.

    Parameters
    ----------
    paint
        The calibration.
    catalogue
        What can be bought; filters that pass laser light are left out.
    """
    offered = [f for f in catalogue if _usable(f, paint.optics)]
    judged = _judged()
    curves = np.array([np.interp(WAVELENGTH_NM, paint.wavelength_nm, draw) for draw in paint.emission_draws_per_nm])
    apart = (curves - curves.mean(axis=0))[:, judged]
    total = float((apart**2).sum() / len(apart))
    rows = _best_rows(paint.optics, tuple(_as_filter(f, paint.optics, 1) for f in offered))
    seen = curves @ rows.T
    brightest = float(seen.mean(axis=0).max())
    found = []
    for candidate, values in zip(offered, seen.T, strict=True):
        own = values - values.mean()
        noise = _noise_variance(values.mean(), brightest, paint.optics.band_uncertainty)
        gain = apart.T @ own / len(own)
        reduction = float(gain @ gain / (own @ own / len(own) + noise) / max(total, 1e-300))
        found.append(NextFilter(candidate, min(reduction, 1.0)))
    return tuple(sorted(found, key=lambda one: -one.reduction_rel))


def fitted_errors(
    rigs: Sequence[Optics], paints: int, rng: np.random.Generator, progress: Progress = lambda done, total, what: None
) -> tuple[Floats, ...]:
    """Return the relative error (n,) of the fitted curve of the same paints on each rig.

    Parameters
    ----------
    rigs
        Optics of each rig, with the same laser.
    paints
        How many are drawn from the prior.
    rng
        Of paints and noise.
    progress
        Called with (done, total, text).
    """
    spectra, sd = learned_spectra(), EmissionPrior().ln_blocking_sd
    known = [(*_known_rig(optics), optics.band_uncertainty) for optics in rigs]
    weights, judged = known[0][0], _judged()
    curves = random_paints(components_of(spectra, weights.wavelength_nm, weights.laser_nm), paints, rng)
    found: list[list[float]] = [[] for _ in rigs]
    for number, curve in enumerate(curves):
        progress(number, paints, "fits of simulated paints")
        reflectance, own = float(rng.uniform(0.03, 0.4)), int(rng.integers(1 << 31))
        for errors, rig in zip(found, known, strict=True):
            data = _measured(rig, curve, reflectance, np.random.default_rng(own))
            fitted = fit_spectrum(data, spectra, sd, _FIT_DRAWS, np.random.default_rng(own)).curves.mean(axis=0)
            errors.append(float(np.linalg.norm((fitted - curve)[judged]) / np.linalg.norm(curve[judged])))
    return tuple(np.array(errors) for errors in found)


def paired_ratio(
    first: Floats, second: Floats, of: Callable[[Floats], float], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Return the ratio of a statistic of paired errors with its 95 % interval by bootstrap; NaN without any.

    Parameters
    ----------
    first, second
        (n,) errors of the same paints.
    of
        The statistic.
    rng
        Of the resamples.
    """
    if first.size == 0:
        return (np.nan, np.nan, np.nan)
    rows = rng.integers(first.size, size=(_RESAMPLES, first.size))
    ratios = [of(first[row]) / of(second[row]) for row in rows]
    low, high = np.quantile(ratios, [0.025, 0.975])
    return float(of(first) / of(second)), float(low), float(high)


def _kept(optics: Optics, keep_nm: Sequence[float]) -> tuple[BandPassFilter, ...]:
    """Return the filters of the rig that stay: the one at the laser, and those of the given centres."""
    centres = [f.center_nm for f in optics.filters]
    for nm in keep_nm:
        if nm not in centres:
            raise FitError(
                f"design: no filter of the rig is centred at {nm:g} nm, so it cannot be kept; the filters of the rig "
                f"are centred at {', '.join(f'{c:g}' for c in centres)} nm"
            )
    return tuple(f for f in optics.filters if f.center_nm in keep_nm or f.name == optics.excitation_filter)


def _usable(candidate: CatalogueFilter, optics: Optics) -> bool:
    """Whether a filter lies above the laser and passes none of its light."""
    return candidate.centre_nm - candidate.width_nm > optics.laser.wavelength_nm + _LASER_APART_NM


def _name(candidate: CatalogueFilter) -> str:
    """Return what a catalogue's filter is called in the rig."""
    return f"{candidate.centre_nm:g}/{candidate.width_nm:g}"


def _other_than(kept: Sequence[BandPassFilter], offered: Sequence[CatalogueFilter]) -> list[CatalogueFilter]:
    """Return filters of names that are not taken by those that stay, the first of each name: a wheel tells by name."""
    taken = {f.name for f in kept}
    first = {_name(f): f for f in reversed(offered)}
    return [f for f in offered if f is first[_name(f)] and _name(f) not in taken]


def _as_filter(candidate: CatalogueFilter, optics: Optics, slot: int) -> BandPassFilter:
    """Return a catalogue's filter as the rig would hold it: blocking and uncertainties of the rig's first filter."""
    like = next(f for f in optics.filters if f.name != optics.excitation_filter)
    return BandPassFilter(
        slot=slot,
        name=_name(candidate),
        center_nm=candidate.centre_nm,
        fwhm_nm=candidate.width_nm,
        peak_transmission=candidate.peak_transmission,
        center_uncertainty_nm=like.center_uncertainty_nm,
        fwhm_uncertainty_nm=like.fwhm_uncertainty_nm,
        shape_order=like.shape_order,
        blocking_od=like.blocking_od,
        blocking_uncertainty_od=like.blocking_uncertainty_od,
    )


def _curves_of(optics: Optics, kept: Sequence[BandPassFilter]) -> dict[str, SpectralCurve]:
    """Return the measured transmissions of filters that stay."""
    return {f.name: optics.filter_curves[f.name] for f in kept if f.name in optics.filter_curves}


def _channel_weights(optics: Optics) -> Floats:
    """Return the weights of the channels in the level of the laser: as they see it."""
    seen = np.array([float(curve(optics.laser.wavelength_nm)) for curve in optics.camera_response])
    return np.asarray(seen / seen.sum())


def _best_rows(optics: Optics, filters: Sequence[BandPassFilter]) -> Floats:
    """Return the weights (H, L) of filters in the channel that sees most of each band and least leak."""
    at_laser = next(f for f in optics.filters if f.name == optics.excitation_filter)
    names = [f"{i}" for i in range(len(filters))]
    every = (at_laser, *(f.model_copy(update={"name": n}) for f, n in zip(filters, names, strict=True)))
    curves = {at_laser.name: optics.filter_curves[at_laser.name]} if at_laser.name in optics.filter_curves else {}
    weights = rig_emission_weights(
        optics.model_copy(update={"filters": every, "filter_curves": curves}), _channel_weights(optics)
    )
    leak = weights.leaked_white.reshape(len(every), -1)
    rows = weights.emission.reshape(len(every), leak.shape[1], -1)
    return np.asarray(rows[np.arange(1, len(every)), leak[1:].argmin(axis=1)])


def _noise_variance(values: Floats | float, brightest: Floats | float, stated: BandUncertainty) -> Floats:
    """Return the variance of band values: calibration and response of each, and stray light of the brightest."""
    relative = np.hypot(stated.calibration_rel, stated.response_rel)
    return np.asarray((relative * np.asarray(values)) ** 2 + (stated.stray_light_rel * np.asarray(brightest)) ** 2)


def _judged() -> NDArray[np.bool_]:
    low, high = JUDGED_NM
    return np.asarray((low <= WAVELENGTH_NM) & (high >= WAVELENGTH_NM))


@dataclass(frozen=True)
class _Screen:
    """Paints of the prior and what each filter of the catalogue sees of them; kept filters come first."""

    curves: Floats  # (n, L) unit norm, on the coarse judged grid
    rows: Floats  # (H, full L) weights
    seen: Floats  # (n, H)
    full: Floats  # (n, full L)
    kept: int
    stated: BandUncertainty

    @classmethod
    def of(
        cls,
        optics: Optics,
        kept: Sequence[BandPassFilter],
        offered: Sequence[CatalogueFilter],
        rng: np.random.Generator,
    ) -> "_Screen":
        """Draw the paints and let every filter see them."""
        parts = components_of(learned_spectra(), WAVELENGTH_NM, optics.laser.wavelength_nm)
        curves, judged = random_paints(parts, SCREENED_PAINTS, rng), _judged()
        full = curves / np.linalg.norm(curves[:, judged], axis=1, keepdims=True)
        stay = [f for f in kept if f.center_nm > optics.laser.wavelength_nm + _LASER_APART_NM]
        rows = _best_rows(optics, (*stay, *(_as_filter(f, optics, 1) for f in offered)))
        return cls(full[:, judged][:, ::_GRID_STEP], rows, full @ rows.T, full, len(stay), optics.band_uncertainty)

    def error(self, chosen: Sequence[int]) -> float:
        """Return the mean relative error of a set of offered filters, with those that stay."""
        return self._error(self.seen[:, [*range(self.kept), *(self.kept + i for i in chosen)]])

    def squared(self, chosen: Sequence[int]) -> float:
        """Return the mean squared relative error of a set, but for what no set changes; it takes microseconds."""
        own = [*range(self.kept), *(self.kept + i for i in chosen)]
        among, explained = self.moments
        return -float(np.trace(np.linalg.solve(among[np.ix_(own, own)], explained[np.ix_(own, own)])))

    @cached_property
    def moments(self) -> tuple[Floats, Floats]:
        """Second moments (H, H) of what all filters see, with noise, and of what they tell about the curves."""
        y, f = self.seen - self.seen.mean(axis=0), self.curves - self.curves.mean(axis=0)
        noise = _noise_variance(self.seen, self.seen.max(axis=1, keepdims=True), self.stated).mean(axis=0)
        told = y.T @ f / len(y)
        return y.T @ y / len(y) + np.diag(noise), told @ told.T

    def error_of_rig(self, optics: Optics) -> float:
        """Return the mean relative error of a rig's own filters."""
        laser_nm = optics.laser.wavelength_nm
        own = [f for f in optics.filters if f.center_nm > laser_nm + _LASER_APART_NM]
        return self._error(self.full @ _best_rows(optics, own).T)

    def _error(self, seen: Floats) -> float:
        y, f = seen - seen.mean(axis=0), self.curves - self.curves.mean(axis=0)
        noise = _noise_variance(seen, seen.max(axis=1, keepdims=True), self.stated).mean(axis=0)
        gain = np.linalg.solve(y.T @ y / len(y) + np.diag(noise), y.T @ f / len(y))
        # noise of the bands adds its own, equal for all paints
        error = ((f - y @ gain) ** 2).sum(axis=1) + float(noise @ (gain**2).sum(axis=1))
        return float(np.sqrt(error / (self.curves**2).sum(axis=1)).mean())

    def exchanged(self, wanted: int, rng: np.random.Generator, progress: Progress) -> tuple[tuple[int, ...], float]:
        """Return the best set of several starts, each exchanged slot by slot until nothing helps."""
        offered, found = self.seen.shape[1] - self.kept, []
        for start in range(STARTS):
            progress(start, STARTS, "sets of filters")
            chosen = [int(i) for i in rng.choice(offered, wanted, replace=False)]
            found.append(self._settled(chosen, self.squared, _SWEEPS))
        best = self._settled(min(found, key=self.error), self.error, 1)
        return tuple(sorted(best)), self.error(best)

    def _settled(self, chosen: Sequence[int], judge: Callable[[Sequence[int]], float], sweeps: int) -> list[int]:
        """Exchange one slot at a time for the best filter, until a sweep changes nothing."""
        now = list(chosen)
        for _ in range(sweeps):
            before = list(now)
            for slot in range(len(now)):
                rest = now[:slot] + now[slot + 1 :]
                others = [i for i in range(self.seen.shape[1] - self.kept) if i not in rest]
                now[slot] = min(others, key=lambda i: judge([*rest, i]))
            if now == before:
                break
        return now


def _known_rig(optics: Optics) -> tuple[EmissionWeights, BandData]:
    """Return the weights of a rig, and data of it whose values are still to come."""
    channels = _channel_weights(optics)
    weights = rig_emission_weights(optics, channels)
    rows = weights.band_index.size
    usable = (weights.leaked_white <= LARGEST_LEAK_OF_WHITE).reshape(weights.bands, -1)
    data = BandData(
        y=np.ones((weights.bands, rows // weights.bands)),
        covariance=np.eye(rows),
        usable=usable,
        weights=weights,
        band_calibration_rel=optics.band_uncertainty.calibration_rel,
        tolerances=band_tolerances(optics, channels),
        lamp_response_rel=lamp_response(optics, channels),
        tile_uncertainty_rel=optics.white_reference.uncertainty_rel,
    )
    return weights, data


def _measured(
    rig: tuple[EmissionWeights, BandData, BandUncertainty], curve: Floats, reflectance: float, rng: np.random.Generator
) -> BandData:
    """Return what a rig that is as uncertain as stated measures of a paint."""
    weights, empty, stated = rig
    mu = band_values(curve[None], np.array([reflectance]), weights, empty.leak_mean[None])[0]
    emission = ~weights.is_excitation & empty.usable.ravel()
    relative = np.hypot(_NOISE_REL, stated.response_rel) * mu
    variance = relative**2 + (stated.stray_light_rel * float(mu[emission].max())) ** 2

    def covariance(values: Floats) -> Floats:
        return np.asarray(np.diag(variance) + empty.tile_uncertainty_rel**2 * np.outer(values, values))

    exact = replace(empty, y=mu.reshape(empty.y.shape), covariance=covariance(mu))
    y = mu.copy()
    y[empty.kept] += band_errors(exact, curve, reflectance, EmissionPrior().ln_blocking_sd, rng)
    return replace(exact, y=y.reshape(empty.y.shape), covariance=covariance(y))
