r"""Whether a sample emits at all: signal beyond reflected laser, leak and stray light, with their uncertainty.

A decision in the spirit of ISO 11843: the critical value is what simulated blanks exceed, and the detection limit is
the yield that exceeds it with 95 %. A blank is the session's own rig with a sample that reflects as this one does and
emits nothing,

.. math:: y = \frac{\rho (s + (m - 1) l)}{(1 + (m - 1) w)\, V(m_e)} + \rho A t + U k + e,
    \quad \ln m_b = \sigma z_0 + \sigma_b z_b

with rho the reflectance at the laser, s and l the reflected and the leaked laser, w the leak of white, m the multiplier
of each filter's leak (log-normal, in part common to all filters), V the laser's level over its nominal one with the
leak of the filter that passes it, t stray light that the laser makes, U the calibration and the filters' tolerances, e
the noise. Filters below the laser see no emission and are left out. The statistic is the largest over many shapes f of
emission of the generalised least squares

.. math:: t_f = a_f / \sigma(a_f), \qquad y = a_f A f + \rho \, E[y/\rho] + \epsilon

with rho free. A wrong white reference multiplies what a blank reflects, which the free rho takes up, so that it hides
no emission; it enters the limit, because it multiplies the yield too. Because the statistic is the largest of many,
and leaks are log-normal, no table of the normal distribution has its critical value: a threshold of 1.645 would call a
third of blanks emission.
"""

from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, BandUncertainty, EmissionDetection, Optics
from finray_calib.fit._band_data import BandData, band_leak_sd, band_values, leak_slopes
from finray_calib.fit._prior import EmissionPrior
from finray_calib.spectra import family_named

Floats = NDArray[np.float64]

FALSE_ALARM: Final = 0.01
"""Share of blanks that may be called emission."""
MISSED: Final = 0.05
"""Share of samples of the yield that is called the limit that may be missed."""
BLANKS: Final = 4000
"""The 99 % point of so many is good to a tenth of a standard deviation."""
_BATCH_SEED: Final = 11843
"""Blanks have randomness of their own: draws of the fit do not depend on them."""
_SHAPES_FWHM_NM: Final = (30.0, 50.0, 80.0)
_SHAPES_STEP_NM: Final = 5.0
_SHAPES_FAMILY: Final = "log_normal_wavenumber"
_BLUE_OF_FIRST_NM, _RED_OF_LAST_NM = 10.0, 20.0
"""How far beyond the outer filters' centres a paint's mode may lie for the limit to hold."""
_LEAST_REFLECTANCE: Final = 1e-6
STRAY_PER_NM: Final = 1e-6
"""Standard deviation of the light beside the laser's line, per nm, over the light in the line: the tail of a diode
laser, and what filters, lens and enclosure fluoresce. 0.03 % of the laser over the visible range; half of its variance
is common to all bands, half is of each band and channel. A tail of 5e-5 of the line's peak, 30 nm wide, shows behind
filters of 6 OD in how the channels share the leak, and was taken for emission without this. It grows with the stray
light that the rig file states, beyond the usual one, and does not shrink: that is relative to other light than the
laser's."""


@dataclass(frozen=True, slots=True)
class BlankModel:
    """What a sample without emission looks like on the rig of a session.

    Attributes
    ----------
    rows
        (K,) band values that count: usable, and not of a filter below the laser.
    mean
        (K,) expected values.
    covariance
        (K, K) of all that varies from blank to blank.
    per_reflectance
        (K,) expected value for a reflectance of 1 at the laser.
    reflectance_at_laser
        That of the sample.
    stray_per_nm
        Standard deviation of the light beside the laser's line over the light in the line, 1/nm.
    """

    rows: NDArray[np.int64]
    mean: Floats
    covariance: Floats
    per_reflectance: Floats
    reflectance_at_laser: float
    stray_per_nm: float


def detect_emission(bands: BandSignals, data: BandData, prior: EmissionPrior, seed: int) -> EmissionDetection:
    """Decide whether a sample emits, and state the yield that the session would have found.

    Valid for emission whose mode lies between the outer filters of the session (the limit names the range) and for
    filters whose blocking is known as well as their data say. Emission beyond the last filter is not looked for.

    Parameters
    ----------
    bands
        Band signals of the sample.
    data
        The same as data of the likelihood.
    prior
        Knows how uncertain the blocking common to all filters is.
    seed
        Of the blanks.

    Returns
    -------
    EmissionDetection
        Verdict, statistic, threshold and limit of the yield.

    References
    ----------
    ISO 11843-3, Capability of detection, part 3: critical value from repeated basic states.
    """
    blank = blank_model(bands, data, prior.ln_blocking_sd)
    modes_nm, shapes = _shapes(data, prior)
    signals = data.weights.emission[blank.rows] @ shapes.T
    weights, sd = _estimators(blank, signals)
    found = (weights @ data.y.ravel()[blank.rows]) / sd
    drawn = draw_blanks(data, blank, prior.ln_blocking_sd, BLANKS, np.random.default_rng([seed, _BATCH_SEED]))
    scores = (drawn @ weights.T) / sd
    largest = scores.max(axis=1)
    threshold = float(np.quantile(largest, 1 - FALSE_ALARM))
    low_nm, high_nm = _range_nm(bands, data)
    covered = (modes_nm >= low_nm) & (modes_nm <= high_nm)
    limits = sd * _seen_from_sd(threshold, -np.quantile(scores, MISSED, axis=0), data.tile_uncertainty_rel)
    measured = bool(found.max() > threshold)
    return EmissionDetection(
        verdict="emission measured" if measured else "no emission",
        statistic_sd=float(found.max()),
        threshold_sd=threshold,
        blanks_above=float((largest >= found.max()).mean()),
        blanks=BLANKS,
        false_alarm=FALSE_ALARM,
        yield_limit=None if measured else min(float(limits[covered].max(initial=0.0)), 1.0),
        limit_low_nm=low_nm,
        limit_high_nm=high_nm,
    )


def _seen_from_sd(threshold: float, missed_sd: Floats, tile_uncertainty_rel: float) -> Floats:
    r"""Return the smallest yields (F,), in their standard deviations, that exceed the threshold with 1 - MISSED.

    .. math:: a = t + \sqrt{q^2 + (1.645\,u\,a)^2}

    with q the reach of the scatter of blanks below their mean and u the uncertainty of the white reference, which the
    yield is proportional to; infinite where that could be nothing.
    """
    common = 1.0 - (NormalDist().inv_cdf(1 - MISSED) * tile_uncertainty_rel) ** 2
    if common <= 0:
        return np.full(missed_sd.shape, np.inf)
    root = np.sqrt(threshold**2 - common * (threshold**2 - missed_sd**2))
    return np.asarray((threshold + root) / common)


def blank_model(bands: BandSignals, data: BandData, ln_blocking_sd: float) -> BlankModel:
    """Return expected band values and covariance of a blank that reflects the laser as the sample does.

    A log-normal leak has mean exp(s^2 / 2); two leaks m_i, m_j have the covariance E[m_i] E[m_j] (exp(c_ij) - 1) with
    c_ij that of their logarithms: the common one, and the own one within a filter. Values are linear in m but for the
    leak of white, in the band and in the laser's level, which is taken to first order at its mean.
    """
    weights, centers = data.weights, np.array([f.center_nm for f in bands.optics.filters])
    seen = bands.at_excitation() | (centers > weights.laser_nm)
    rows = data.kept[seen[weights.band_index[data.kept]]]
    leak_mean = np.exp(0.5 * (ln_blocking_sd**2 + data.leak_sd**2))
    dark = np.zeros(weights.wavelength_nm.size)
    reflected = band_values(dark[None], np.ones(1), weights, leak_mean[None])[0]
    per_reflectance = reflected[rows]
    reflectance = _reflectance(data, rows, per_reflectance)
    spread = reflectance * leak_slopes(dark, 1.0, reflected, weights, leak_mean)[rows]
    ln_covariance = ln_blocking_sd**2 + np.diag(band_leak_sd(data.leak_sd, weights) ** 2)
    covariance = data.covariance_without_tile(rows) + spread @ np.expm1(ln_covariance) @ spread.T
    mean = reflectance * per_reflectance
    stray_per_nm = allowed_stray_per_nm(bands.optics)
    columns = _imperfections(data, rows, mean, reflectance, stray_per_nm)
    return BlankModel(rows, mean, covariance + columns @ columns.T, per_reflectance, reflectance, stray_per_nm)


def allowed_stray_per_nm(optics: Optics) -> float:
    """Return the standard deviation (1/nm) of the light beside the laser's line, over the light in the line."""
    usual_rel, stated_rel = BandUncertainty().stray_light_rel, optics.band_uncertainty.stray_light_rel
    return STRAY_PER_NM * max(stated_rel / usual_rel, 1.0)


def draw_blanks(
    data: BandData, blank: BlankModel, ln_blocking_sd: float, number: int, rng: np.random.Generator
) -> Floats:
    """Return the band values (number, K) of simulated blanks; leaks are log-normal as they are believed to be."""
    rows, weights = blank.rows, data.weights
    own = rng.standard_normal((number, weights.bands))[:, weights.band_index] * data.leak_sd
    more = np.exp(ln_blocking_sd * rng.standard_normal((number, 1)) + own) - 1
    rho = blank.reflectance_at_laser
    reflected = weights.reflected_laser + more * weights.leaked_laser
    values = (rho * reflected / weights.divisor(more))[:, rows]
    columns = _imperfections(data, rows, blank.mean, rho, blank.stray_per_nm)
    values += rng.standard_normal((number, columns.shape[1])) @ columns.T
    noise = np.linalg.cholesky(data.covariance_without_tile(rows))
    return np.asarray(values + rng.standard_normal((number, rows.size)) @ noise.T)


def _reflectance(data: BandData, rows: NDArray[np.int64], per_reflectance: Floats) -> float:
    """Return the reflectance at the laser, from the laser's filter; without it 1, the most that a blank reflects."""
    at_laser = data.weights.is_excitation[rows]
    if not at_laser.any():
        return 1.0
    brightest = int(np.where(at_laser, per_reflectance, -np.inf).argmax())
    return max(float(data.y.ravel()[rows][brightest] / per_reflectance[brightest]), _LEAST_REFLECTANCE)


def _imperfections(
    data: BandData, rows: NDArray[np.int64], mean: Floats, reflectance: float, stray_per_nm: float
) -> Floats:
    """Return the columns (K, M) of calibration, white reference, stray light, and each filter, at a blank."""
    weights = data.weights
    per_band = np.equal.outer(weights.band_index[rows], np.arange(weights.bands))
    stray = stray_per_nm / np.sqrt(2) * reflectance * weights.emission[rows].sum(axis=1)
    tile = data.tile_uncertainty_rel * mean[:, None]
    columns = [data.band_calibration_rel * mean[:, None] * per_band, tile, stray[:, None], np.diag(stray)]
    if data.tolerances is not None:
        excitation = int(weights.band_index[np.argmax(weights.is_excitation)])
        for kind in range(2):
            moved = reflectance * data.tolerances.laser_shift[kind][rows, None] * per_band
            moved[:, excitation] -= data.tolerances.level_shift[kind] * mean
            columns.append(moved)
    return np.concatenate(columns, axis=1)


def _shapes(data: BandData, prior: EmissionPrior) -> tuple[Floats, Floats]:
    """Return the modes (F,) and curves (F, L) of emission of a yield of 1 that are looked for."""
    family, grid = family_named(_SHAPES_FAMILY), data.weights.wavelength_nm
    modes_nm = np.arange(prior.mode_low_nm, prior.mode_high_nm + _SHAPES_STEP_NM / 2, _SHAPES_STEP_NM)
    theta = np.array(
        [[mode, np.log(fwhm), 0.0, *(p.mean for p in family.own)] for mode in modes_nm for fwhm in _SHAPES_FWHM_NM]
    )
    curves = np.where(grid > data.weights.laser_nm, family.curves(theta, grid), 0.0)
    return np.repeat(modes_nm, len(_SHAPES_FWHM_NM)), curves / np.trapezoid(curves, grid, axis=1)[:, None]


def _estimators(blank: BlankModel, signals: Floats) -> tuple[Floats, Floats]:
    """Return the least squares weights (F, K) of the yield of each shape, the reflectance free, and their sd (F,)."""
    precision = np.linalg.inv(blank.covariance)
    laser = precision @ blank.per_reflectance
    clean = precision - np.outer(laser, laser) / (blank.per_reflectance @ laser)
    weighted = clean @ signals
    information = (signals * weighted).sum(axis=0)
    return (weighted / information).T, 1 / np.sqrt(information)


def _range_nm(bands: BandSignals, data: BandData) -> tuple[float, float]:
    """Return the modes between which the limit holds, nm: about those of the usable filters above the laser."""
    laser_nm = data.weights.laser_nm
    seen = data.usable.any(axis=1) & ~bands.at_excitation()
    centers = [f.center_nm for f, used in zip(bands.optics.filters, seen, strict=True) if used]
    above = [c for c in centers if c > laser_nm] or [laser_nm]
    return max(min(above) - _BLUE_OF_FIRST_NM, laser_nm), max(above) + _RED_OF_LAST_NM
