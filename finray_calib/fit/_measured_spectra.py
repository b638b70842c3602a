r"""A prior of emission curves learned from measured fluorophores, and its posterior in closed form.

A curve is one of a few prototypes of shape g, put at a place and stretched in wavenumber, with linear departures:

.. math:: f = a\left[g(u) + \sum_j z_j v_j(u) + s\,(g + \epsilon)\,d(\lambda) + r\,g\,e(\lambda) + t\,h(\lambda)\right],
          \quad u = (\nu - \nu_m) / W

with v the directions in which measured shapes of a prototype differ (and those of place and width between the points
of the grid), d a Gaussian process of amplitude s, e a re-absorbed blue edge and h a second dye of any shape. Prototype,
place, width, s in three sizes and t are discrete; everything else is normal, so that given them the bands are jointly
normal: the evidence of each of some thousand components is closed form. Choice of the shape and size of the departure
thereby belong to the interval. What is drawn is nowhere below zero: :mod:`finray_calib.fit._reported_spectrum`.

The height a is integrated out with a proper prior: without one a component that emits beyond the last filter explains
any signal with any height. Where a multiplies the departures' covariance it is its own estimate, iterated. Leaks, which
are log-normal, enter with their mean and covariance.

Prototypes are means of at least five measured curves each, the directions are those of all curves together: no single
curve can be read back.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._band_data import BandData, Reference, band_leak_sd, leak_slopes, tolerance_columns

Floats = NDArray[np.float64]

PROTOTYPES_FILE: Final = Path(__file__).with_name("measured_spectra.json")
LEAST_CURVES_OF_A_PROTOTYPE: Final = 5
_PLACE_STEP_KK, _LN_WIDTH_STEP = 0.25, 0.16
_LOWEST_KK = 13.7
_ABOVE_LASER_NM = 12.0
_WIDTH_REACH_SD = 2.0
_PROCESS_LENGTH_NM, _PROCESS_FLOOR = 14.0, 0.03
_DETAIL_LENGTH_NM, _DETAIL_SHARE = 5.0, 0.15
"""Part of the variance of the process that changes within a filter: vibronic detail, which smooth curves lack."""
_SIZES: Final = ((0.03, 0.45), (0.09, 0.35), (0.22, 0.2))
"""Size and prior share: most paints are near a learned shape and a few far from all, so that one size for all is too
wide for the most and too narrow for the few. Chosen on half of the fluorophores (docs/verification.md)."""
_SECOND_DYE: Final = ((0.0, 0.8), (0.3, 0.2))
_EDGE_SD = 0.25
_SECOND_RANK = 14
_KEPT = 600
_HEIGHT_AT_YIELD, _HEIGHT_SD_REL = 0.15, 1.5
_REFLECTANCE, _REFLECTANCE_SD = 0.2, 0.5
_FIRST_PASS_SIZE = 0.15
_NM_OF_KK = 1e4
_TAIL_REACH = 1.5
"""Of the tails beyond the learned positions, in widths; there they have fallen to 0.2 % of where they began."""


@dataclass(frozen=True)
class MeasuredSpectra:
    """What was learned of the shapes of emission curves.

    Attributes
    ----------
    u
        (U,) positions: wavenumber from the mode over the full width at half maximum; the blue side is positive.
    shapes
        (K, U) prototypes, peak 1.
    directions
        (J, U) departures of one standard deviation, common to all prototypes.
    members
        (K,) number of measured curves behind each prototype.
    ln_width_kk, ln_width_sd
        (K,) logarithm of the full width in wavenumber (1000 per cm): mean and standard deviation of each prototype.
    origin
        Where it was learned.
    """

    u: Floats
    shapes: Floats
    directions: Floats
    members: Floats
    ln_width_kk: Floats
    ln_width_sd: Floats
    origin: str

    @cached_property
    def share(self) -> Floats:
        """Prior share of each prototype."""
        return np.asarray((self.members + 1) / (self.members + 1).sum())


@lru_cache(maxsize=1)
def learned_spectra() -> MeasuredSpectra:
    """Return what the package ships."""
    return spectra_of(json.loads(PROTOTYPES_FILE.read_text(encoding="utf-8")))


def spectra_of(stored: Mapping[str, Any]) -> MeasuredSpectra:
    """Return prototypes from the content of their file."""
    first, last, count = stored["u"]
    arrays = {
        name: np.array(stored[name]) for name in ("shapes", "directions", "members", "ln_width_kk", "ln_width_sd")
    }
    return MeasuredSpectra(u=np.linspace(first, last, int(count)), origin=stored["origin"], **arrays)


@dataclass(frozen=True)
class Components:
    """The components of a prior above a laser.

    Attributes
    ----------
    prototype
        (C,) prototype of each.
    mode_kk, width_kk
        (C,) place and full width, 1000 per cm.
    ln_share
        (C,) logarithm of the prior share.
    curves
        (C, L) curves of peak 1.
    """

    spectra: MeasuredSpectra
    wavelength_nm: Floats
    laser_nm: float
    prototype: NDArray[np.int64]
    mode_kk: Floats
    width_kk: Floats
    ln_share: Floats
    curves: Floats

    def positions(self, chosen: NDArray[np.int64] | slice = slice(None)) -> Floats:
        """Return u of each component at each wavelength, (C, L)."""
        nu = _NM_OF_KK / self.wavelength_nm
        return np.asarray((nu - self.mode_kk[chosen, None]) / self.width_kk[chosen, None])

    def moved(self, chosen: NDArray[np.int64] | slice = slice(None)) -> Floats:
        """Return the directions of place and width, one standard deviation of the grid's cell each, (C, 2, L)."""
        u = self.positions(chosen)
        slope = _sampled(self._slopes, self.spectra.u, self.prototype[chosen], u) * self._above
        place = -slope / self.width_kk[chosen, None] * (_PLACE_STEP_KK / np.sqrt(12))
        return np.stack([place, -u * slope * (_LN_WIDTH_STEP / np.sqrt(12))], axis=1)

    def departures(self, chosen: NDArray[np.int64]) -> Floats:
        """Return all directions but those of the process and the second dye, (C, 3 + J, L)."""
        u, curves = self.positions(chosen), self.curves[chosen]
        learned = np.stack(
            [np.interp(u.ravel(), self.spectra.u, v, 0.0, 0.0).reshape(u.shape) for v in self.spectra.directions],
            axis=1,
        )
        edge = _EDGE_SD * curves / (1 + np.exp(np.clip((0.5 - u) / 0.12, -60, 60)))
        return np.concatenate([self.moved(chosen), learned * self._above, edge[:, None]], axis=1)

    @cached_property
    def _slopes(self) -> Floats:
        return np.gradient(self.spectra.shapes, self.spectra.u, axis=1)

    @cached_property
    def _above(self) -> Floats:
        return np.asarray((self.wavelength_nm >= self.laser_nm).astype(np.float64))

    @cached_property
    def process(self) -> Floats:
        """Factor (L, R) of the process of amplitude 1."""
        apart_nm = self.wavelength_nm[:, None] - self.wavelength_nm
        smooth, detail = (np.exp(-0.5 * (apart_nm / nm) ** 2) for nm in (_PROCESS_LENGTH_NM, _DETAIL_LENGTH_NM))
        roots, vectors = np.linalg.eigh((1 - _DETAIL_SHARE) * smooth + _DETAIL_SHARE * detail)
        large = roots > 1e-3 * roots[-1]
        return np.asarray(vectors[:, large] * np.sqrt(roots[large]))

    @cached_property
    def second(self) -> Floats:
        """Directions (R, L) of a second dye of height 1: the second moment of all components."""
        weighted = self.curves * np.sqrt(np.exp(self.ln_share))[:, None]
        roots, vectors = np.linalg.eigh(weighted.T @ weighted)
        return np.asarray((vectors[:, -_SECOND_RANK:] * np.sqrt(np.maximum(roots[-_SECOND_RANK:], 0.0))).T)


def _sampled(table: Floats, u: Floats, prototype: NDArray[np.int64], at: Floats) -> Floats:
    """Return rows of a table (K, U) interpolated at (C, L) positions; 0 outside."""
    step = u[1] - u[0]
    place = (at - u[0]) / step
    inside = (place >= 0) & (place <= u.size - 1)
    cell = np.clip(place.astype(np.int64), 0, u.size - 2)
    right = place - cell
    row = prototype[:, None]
    return np.where(inside, (1 - right) * table[row, cell] + right * table[row, cell + 1], 0.0)


@lru_cache(maxsize=4)
def _components(spectra_key: int, laser_nm: float, wavelengths: bytes) -> Components:
    spectra, grid = _continued(_KNOWN[spectra_key]), np.frombuffer(wavelengths)
    highest = _NM_OF_KK / (laser_nm + _ABOVE_LASER_NM)
    places = np.arange(_LOWEST_KK, highest, _PLACE_STEP_KK)
    prototype, mode, width, ln_share = [], [], [], []
    for k, (centre, sd) in enumerate(zip(spectra.ln_width_kk, spectra.ln_width_sd, strict=True)):
        steps = np.arange(-int(_WIDTH_REACH_SD * sd / _LN_WIDTH_STEP), int(_WIDTH_REACH_SD * sd / _LN_WIDTH_STEP) + 1)
        ln_prior = -0.5 * (steps * _LN_WIDTH_STEP / sd) ** 2
        ln_prior -= np.log(np.exp(ln_prior).sum() * places.size) - np.log(spectra.share[k])
        prototype.append(np.full(steps.size * places.size, k))
        mode.append(np.tile(places, steps.size))
        width.append(np.repeat(np.exp(centre + steps * _LN_WIDTH_STEP), places.size))
        ln_share.append(np.repeat(ln_prior, places.size))
    which, modes, widths = np.concatenate(prototype), np.concatenate(mode), np.concatenate(width)
    u = (_NM_OF_KK / grid - modes[:, None]) / widths[:, None]
    curves = _sampled(spectra.shapes, spectra.u, which, u) * (grid >= laser_nm)
    return Components(spectra, grid, laser_nm, which, modes, widths, np.concatenate(ln_share), curves)


def _continued(spectra: MeasuredSpectra) -> MeasuredSpectra:
    """Return the spectra with tails beyond the learned positions, as a Gaussian of the width of the curve falls.

    A mean of paints with two maxima has not died out at the last position; cut there, it would put a step of up
    to a third of its peak into the spectrum.
    """
    step = spectra.u[1] - spectra.u[0]
    beyond = step * np.arange(1, round(_TAIL_REACH / step) + 1)
    fall = np.exp2(-4 * beyond**2)

    def with_tails(table: Floats) -> Floats:
        return np.concatenate([table[:, :1] * fall[::-1], table, table[:, -1:] * fall], axis=1)

    u = np.concatenate([spectra.u[0] - beyond[::-1], spectra.u, spectra.u[-1] + beyond])
    return replace(spectra, u=u, shapes=with_tails(spectra.shapes), directions=with_tails(spectra.directions))


_KNOWN: dict[int, MeasuredSpectra] = {}


def components_of(spectra: MeasuredSpectra, wavelength_nm: Floats, laser_nm: float) -> Components:
    """Return the components of a prior on a grid above a laser."""
    _KNOWN[id(spectra)] = spectra
    return _components(id(spectra), laser_nm, np.ascontiguousarray(wavelength_nm).tobytes())


@dataclass(frozen=True)
class Rig:
    """The bands as a linear map at the mean leak, and what is uncertain beside the paint.

    emission (K, L), laser (K,) of the usable rows; fixed (K, K) covariance, calibration (K, B) columns.
    """

    data: BandData
    leak_factor: float
    ln_blocking_sd: float
    y: Floats = field(init=False)
    emission: Floats = field(init=False)
    laser: Floats = field(init=False)

    def __post_init__(self) -> None:
        kept, w = self.data.kept, self.data.weights
        more, white = self._mean_leak()
        object.__setattr__(self, "y", self.data.y.ravel()[kept])
        object.__setattr__(self, "emission", ((w.emission + more[:, None] * w.leaked_emission) / white[:, None])[kept])
        object.__setattr__(self, "laser", ((w.reflected_laser + more * w.leaked_laser) / white)[kept])

    def _mean_leak(self) -> tuple[Floats, Floats]:
        more = self.leak_factor * self.data.leak_mean - 1
        return more, self.data.weights.divisor(more)

    def _values(self, curve: Floats, reflectance: float) -> Floats:
        """Return the values of a paint at the mean leak, (N,)."""
        more, divisor = self._mean_leak()
        w = self.data.weights
        nominal = w.emission @ curve + reflectance * w.reflected_laser
        leaked = w.leaked_emission @ curve + reflectance * w.leaked_laser
        return np.asarray((nominal + more * leaked) / divisor)

    def at(self, curve: Floats, reflectance: float) -> "Rig":
        """Return the rig whose errors common to all values are shares of those of this paint."""
        return replace(self, data=self.data.at(self._values(curve, reflectance)))

    @property
    def laser_alone(self) -> float:
        """Reflectance at the laser if the paint did not emit: of the bands that pass it, else of the prior."""
        lit = self.data.weights.is_excitation[self.data.kept] & (self.laser > 0)
        if not lit.any():
            return _REFLECTANCE
        return float(np.clip(self.laser[lit] @ self.y[lit] / (self.laser[lit] ** 2).sum(), 1e-3, 1.0))

    def columns(self, curve: Floats, reflectance: float) -> Floats:
        """Return the columns of what is uncertain beside noise and paint, calibration first, (K, M)."""
        data, w, kept = self.data, self.data.weights, self.data.kept
        found = [data.imperfections()]
        if data.lamp_response_rel is not None:
            found.append((data.lamp_response_rel * data.level)[kept, None])
        if data.tolerances is not None:
            leak = self.leak_factor * data.leak_mean
            every = tolerance_columns(Reference(curve, reflectance, leak), w, data.tolerances)
            found.append(every[kept, w.bands : 3 * w.bands])
            slopes = leak_slopes(curve, reflectance, self._values(curve, reflectance), w, leak)[kept]
            ln = self.ln_blocking_sd**2 + np.diag(band_leak_sd(data.leak_sd, w) ** 2)
            roots, vectors = np.linalg.eigh(slopes @ np.expm1(ln) @ slopes.T)
            large = roots > 1e-12 * max(float(roots[-1]), np.finfo(float).tiny)
            found.append(vectors[:, large] * np.sqrt(roots[large]))
        return np.concatenate(found, axis=1)


@dataclass(frozen=True)
class _Scored:
    """Components with their height and reflectance given the bands."""

    chosen: NDArray[np.int64]
    size: Floats
    second: Floats
    height: Floats  # (n, 2) mean of height and reflectance
    scale: Floats  # (n,) height that the departures in the covariance have
    precision: Floats  # (n, 2, 2) of both
    inverse: Floats  # (n, K, K) of the covariance of the bands
    weight: Floats
    ln_evidence: float


@dataclass(frozen=True)
class ScoredSpectra:
    """The posterior as a mixture of normal components, before it is drawn from.

    Attributes
    ----------
    rig, parts, bands
        The bands as a linear map, all components, and their band values at height 1.
    scored
        The components that count.
    columns
        (K, M) what is uncertain beside noise and paint.
    """

    rig: "Rig"
    parts: Components
    bands: Floats
    scored: "_Scored"
    columns: Floats

    def directions(self, place: int) -> Floats:
        """Return every direction in which the curve of a scored component may depart, (Q, L), nm^-1."""
        which, scored, parts = self.scored.chosen[place], self.scored, self.parts
        v = [
            parts.departures(scored.chosen[place : place + 1])[0],
            scored.size[place] * (parts.process * _above(parts)).T * (parts.curves[which] + _PROCESS_FLOOR),
            scored.second[place] * parts.second,
        ]
        return np.asarray(np.concatenate(v) * scored.scale[place])

    @property
    def shape_directions(self) -> int:
        """How many of the directions, the first, are the prior's shape; the others are the paint's own departure."""
        return 3 + len(self.parts.spectra.directions)

    @property
    def noise(self) -> Floats:
        """Covariance (K, K) of all that is uncertain in the bands beside the paint."""
        kept = self.rig.data.kept
        return np.asarray(self.rig.data.covariance[np.ix_(kept, kept)] + self.columns @ self.columns.T)

    def evidence_derivatives(self, places: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return the slope (n, K) and curvature (n, K, K) of the ln evidence of scored components along the bands.

        The evidence is normal in the bands, at the height of the departures: :math:`-S^{-1}(y - m)`, :math:`-S^{-1}`.
        """
        scored, rig = self.scored, self.rig
        lit = np.broadcast_to(rig.laser, (len(places), rig.laser.size))
        design, inverse = np.stack([self.bands[scored.chosen[places]], lit], axis=2), scored.inverse[places]
        residual = rig.y - (design @ scored.height[places][..., None])[..., 0]
        explained = inverse @ design
        of_both = np.linalg.solve(scored.precision[places], explained.transpose(0, 2, 1))
        return -(inverse @ residual[..., None])[..., 0], np.asarray(explained @ of_both - inverse)


def scored_components(data: BandData, spectra: MeasuredSpectra, ln_blocking_sd: float) -> ScoredSpectra:
    """Return the components with their weights given the bands; parameters as of `fit_spectrum`."""
    leaks = bool((data.weights.leaked_laser > 0).any() or (data.weights.leaked_emission > 0).any())
    sd = ln_blocking_sd if leaks else 0.0
    rig = Rig(data, float(np.exp(sd**2 / 2)), sd)
    parts = components_of(spectra, data.weights.wavelength_nm, data.weights.laser_nm)
    bands = parts.curves @ rig.emission.T
    seen = np.flatnonzero(bands.max(axis=1) > 1e-6 * bands.max())
    first = _first_pass(rig, parts, bands, seen)
    best = first.chosen[np.argsort(-first.weight)[:_KEPT]]
    curve = (first.weight * np.maximum(first.height[:, 0], 0.0)) @ parts.curves[first.chosen]
    reflectance = max(float(first.weight @ first.height[:, 1]), 1e-3)
    rig = rig.at(curve, reflectance)
    columns = rig.columns(curve, reflectance)
    second = _second_pass(rig, parts, bands, best, columns, first)
    return ScoredSpectra(rig, parts, bands, second, columns)


def prior_curves(parts: Components, count: int, rng: np.random.Generator) -> Floats:
    """Return curves drawn from the prior, without the smaller departures, (count, L), nm^-1."""
    share = np.exp(parts.ln_share)
    chosen = rng.choice(share.size, count, p=share / share.sum())
    mean, precision = height_prior(parts, chosen)
    height = np.abs(mean[:, 0] + rng.standard_normal(count) / np.sqrt(precision[:, 0]))
    return np.asarray(parts.curves[chosen] * height[:, None])


_LEAST_HEIGHT_REL = 0.05
_SEEN_BELOW_NM = 690.0


def random_paints(parts: Components, count: int, rng: np.random.Generator) -> Floats:
    """Return paints drawn from the whole prior, departures and second dyes too, (count, L), nm^-1.

    Only those that filters up to 700 nm can see: the maximum lies below 690 nm, and the height is no twentieth of the
    mean.

    Parameters
    ----------
    parts
        Components of the prior.
    count
        Number of paints.
    rng
        Source of all randomness.
    """
    share = np.exp(parts.ln_share)
    found: list[Floats] = []
    above, seen = _above(parts)[:, 0], parts.wavelength_nm < _SEEN_BELOW_NM
    sizes, seconds = (np.array(table) for table in (_SIZES, _SECOND_DYE))
    while len(found) < count:
        chosen = rng.choice(share.size, 1, p=share / share.sum())
        own, departures = parts.curves[chosen[0]], parts.departures(chosen)[0]
        size, second = rng.choice(sizes[:, 0], p=sizes[:, 1]), rng.choice(seconds[:, 0], p=seconds[:, 1])
        curve = own + rng.standard_normal(len(departures)) @ departures
        process = parts.process @ rng.standard_normal(parts.process.shape[1])
        curve = curve + size * (own + _PROCESS_FLOOR) * above * process
        curve = np.maximum(curve + second * rng.standard_normal(len(parts.second)) @ parts.second, 0.0)
        mean, precision = height_prior(parts, chosen)
        height = mean[0, 0] + rng.standard_normal() / np.sqrt(precision[0, 0])
        if height > _LEAST_HEIGHT_REL * mean[0, 0] and curve[seen].max(initial=0.0) == curve.max():
            found.append(height * curve)
    return np.array(found).reshape(-1, parts.wavelength_nm.size)


def band_errors(
    data: BandData, curve: Floats, reflectance: float, ln_blocking_sd: float, rng: np.random.Generator
) -> Floats:
    """Return one draw (K,) of all errors of the usable bands of a known paint: noise, calibration, filters, lamp.

    Parameters
    ----------
    data
        The rig, with the exact values of the paint.
    curve, reflectance
        Emission (L,), nm^-1, and reflectance at the laser of the paint.
    ln_blocking_sd
        Uncertainty of the filters' blocking, as the logarithm of a multiplier around 1.
    rng
        Source of all randomness.
    """
    rig = Rig(data, float(np.exp(ln_blocking_sd**2 / 2)), ln_blocking_sd).at(curve, reflectance)
    columns = rig.columns(curve, reflectance)
    noise = np.linalg.cholesky(rig.data.covariance[np.ix_(data.kept, data.kept)])
    drawn = columns @ rng.standard_normal(columns.shape[1]) + noise @ rng.standard_normal(len(noise))
    return np.asarray(drawn)


def height_prior(parts: Components, chosen: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return mean and precision (n, 2) of height and reflectance of chosen components."""
    area = parts.curves[chosen].sum(axis=1) * (parts.wavelength_nm[1] - parts.wavelength_nm[0])
    height = _HEIGHT_AT_YIELD / np.maximum(area, 1e-12)
    mean = np.stack([height, np.full(height.size, _REFLECTANCE)], axis=1)
    sd = np.stack([_HEIGHT_SD_REL * height, np.full(height.size, _REFLECTANCE_SD)], axis=1)
    return mean, sd**-2


def _scored(
    rig: Rig,
    parts: Components,
    bands: Floats,
    chosen: NDArray[np.int64],
    departures: Floats,
    rest: Floats,
    ln_prior: Floats,
    height: Floats,
) -> tuple[Floats, tuple[Floats, Floats, Floats, Floats]]:
    """Return ln evidence (n,); height and reflectance (n, 2), the departures' height, precision, inverse covariance."""
    mean, precision = height_prior(parts, chosen)
    design = np.stack([bands[chosen], np.broadcast_to(rig.laser, bands[chosen].shape)], axis=2)
    found = np.stack([height, height], axis=1)
    for _ in range(2):
        scale = np.maximum(found[:, 0], 1e-3 * mean[:, 0])
        inverse = np.linalg.inv(rest + (scale**2)[:, None, None] * departures)
        weighted = inverse @ design
        information = design.transpose(0, 2, 1) @ weighted + np.eye(2) * precision[:, None, :]
        right = weighted.transpose(0, 2, 1) @ rig.y + precision * mean
        found = np.asarray(np.linalg.solve(information, right[..., None])[..., 0])
    residual = rig.y - (design @ found[..., None])[..., 0]
    ln = -0.5 * np.einsum("ni,nij,nj->n", residual, inverse, residual) + 0.5 * np.linalg.slogdet(inverse)[1]
    ln += -0.5 * (precision * (found - mean) ** 2).sum(axis=1) + 0.5 * np.log(precision).sum(axis=1)
    ln += -0.5 * np.linalg.slogdet(information)[1] + ln_prior - 0.5 * rig.y.size * np.log(2 * np.pi)
    return np.where(found[:, 0] > 0, ln, -np.inf), (found, scale, information, np.asarray(inverse))


def _first_pass(rig: Rig, parts: Components, bands: Floats, seen: NDArray[np.int64]) -> _Scored:
    """Score all components with one coarse size of the departure."""
    own = bands[seen]
    centre = (rig.emission @ parts.wavelength_nm) / np.maximum(rig.emission.sum(axis=1), 1e-300)
    near = np.exp(-0.5 * ((centre[:, None] - centre) / (2 * _PROCESS_LENGTH_NM)) ** 2)
    floor = own + _PROCESS_FLOOR * rig.emission.sum(axis=1)
    departures = _FIRST_PASS_SIZE**2 * floor[:, :, None] * near * floor[:, None, :]
    moved = parts.moved(seen) @ rig.emission.T
    departures = departures + np.einsum("nqi,nqj->nij", moved, moved)
    # without the leaks of the laser a weak paint's best components are those that explain the leak
    columns = rig.columns(np.zeros(parts.wavelength_nm.size), rig.laser_alone)
    # as a share of the measured values the white reference's error would pull the level down, where shapes do not fit
    covariance = rig.data.covariance_without_tile(rig.data.kept)
    rest = covariance + columns @ columns.T
    emitting = ~rig.data.weights.is_excitation[rig.data.kept]
    height = np.abs(rig.y[emitting]).max() / np.maximum(own[:, emitting].max(axis=1), 1e-12)
    ln, normal = _scored(rig, parts, bands, seen, departures, rest, parts.ln_share[seen], height)
    ones = np.ones(seen.size)
    return _Scored(seen, ones, 0 * ones, *normal, *_weights(ln))


def _weights(ln: Floats) -> tuple[Floats, float]:
    top = float(ln.max())
    weight = np.exp(ln - top)
    return weight / weight.sum(), float(np.log(weight.sum()) + top)


def _second_pass(
    rig: Rig, parts: Components, bands: Floats, best: NDArray[np.int64], columns: Floats, first: _Scored
) -> _Scored:
    """Score the best components with every size of the departure, without and with a second dye."""
    rigid = parts.departures(best) @ rig.emission.T
    smooth = np.matmul(rig.emission * (parts.curves[best] + _PROCESS_FLOOR)[:, None, :], parts.process * _above(parts))
    other = parts.second @ rig.emission.T
    fixed = np.einsum("nqi,nqj->nij", rigid, rigid)
    process, dye = smooth @ smooth.transpose(0, 2, 1), other.T @ other
    departures, ln_prior, sizes, seconds = [], [], [], []
    for size, size_share in _SIZES:
        for second, second_share in _SECOND_DYE:
            departures.append(fixed + size**2 * process + second**2 * dye)
            ln_prior.append(parts.ln_share[best] + np.log(size_share * second_share))
            sizes.append(np.full(best.size, size))
            seconds.append(np.full(best.size, second))
    times = len(departures)
    heights = dict(zip(first.chosen.tolist(), first.height[:, 0], strict=True))
    height = np.tile(np.maximum([heights[c] for c in best.tolist()], 1e-9), times)
    covariance = rig.data.covariance[np.ix_(rig.data.kept, rig.data.kept)] + columns @ columns.T
    every = np.tile(best, times)
    ln, normal = _scored(
        rig, parts, bands, every, np.concatenate(departures), covariance, np.concatenate(ln_prior), height
    )
    return _Scored(every, np.concatenate(sizes), np.concatenate(seconds), *normal, *_weights(ln))


def _above(parts: Components) -> Floats:
    return np.asarray((parts.wavelength_nm >= parts.laser_nm).astype(np.float64))[:, None]
