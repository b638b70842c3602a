r"""One paint measured in several sessions: their common band signals, with what differs from session to session.

.. math:: y_i = m \circ (1 + g_i + h_i) + e_i, \qquad
    g_i \sim N(0, \tau_g^2), \quad h_{ib} \sim N(0, \tau_h^2), \quad e_i \sim N(0, S_i)

with m what the sessions share, :math:`g_i` the level of session i (how the sample lies, laser against lamp, focus),
:math:`h_{ib}` what filter b has of its own in session i, common to its channels (homing of the wheel), and
:math:`S_i` the covariance of the session less the part of the white reference, :math:`u^2 y_i y_i^T`. That part is
common to all sessions: no repetition averages it away, it does not let sessions differ, and :math:`u^2 m m^T` is added
at the end. The same holds for what the fit itself knows of the rig (centres of filters, response, lamp).

Every session counts alike: weights by covariances would be drawn to low values, as relative errors of a large value
forgive more. Few sessions hardly tell :math:`\tau_g`. Both are integrated over their restricted likelihood and
half-Cauchy priors of 5 % and 1 %, and the variance of the common level is that of the normal with the same 95 %
interval as the mixture.

Sessions are taken as exchangeable draws of one rig, one paint and one way of working: what all of them share, such as a
filter that is another than stated, shows in none.

References
----------
Gelman, Prior distributions for variance parameters in hierarchical models, Bayesian Analysis 1 (2006) 515.
Patterson, Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58 (1971) 545.
"""

from collections.abc import Sequence
from pathlib import PurePath
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, Estimate, FitError, SessionScatter

Floats = NDArray[np.float64]

LEVEL_SCALE, FILTER_SCALE = 0.05, 0.01
"""Scales of the half-Cauchy priors of the relative standard deviations between sessions: of the level, of a filter.

That of the level decides how often the intervals of two or three sessions hold: for 0.95 at a scatter of 8 %.
"""
_SESSION_NAME: Final = "session.json"
"""Name of the record of a captured session in the origin of its band signals (of imported images there is none)."""
DEPARTS_P: Final = 0.001
TWO_SESSIONS: Final = (
    "two sessions hardly show how much sessions scatter, so the interval of the level is several times as wide as that "
    "of one session alone; a third session narrows it"
)
_LEVELS, _FILTERS = np.geomspace(3e-4, 1.0, 28), np.geomspace(3e-4, 0.3, 20)


def combine_sessions(sessions: Sequence[BandSignals]) -> tuple[BandSignals, SessionScatter]:
    """Return the band signals that several sessions of a paint share, and how the sessions differ.

    Parameters
    ----------
    sessions
        Band signals of one paint, of sessions on one rig: at least two. A value that is flagged in some of them rests
        on the others.

    Raises
    ------
    FitError
        One session alone, sessions of different paints, or of rigs that differ.
    """
    _refuse_unlike(sessions)
    usable = np.array([one.usable().ravel() for one in sessions])
    filters = np.repeat(np.arange(len(sessions[0].optics.filters)), 3)
    tile_rel = sessions[0].optics.white_reference.uncertainty_rel
    emission = _Common(
        np.array([one.fluorescence.ravel() for one in sessions]),
        np.array([one.fluorescence_covariance for one in sessions]), usable, filters, tile_rel,
    )  # fmt: skip
    reflected = _Common(
        np.array([one.reflectance.ravel() for one in sessions]),
        np.array([one.reflectance_covariance for one in sessions]), usable, filters, tile_rel,
    )  # fmt: skip
    scatter = emission.scatter()
    weights = np.mean([one.channel_weights for one in sessions], axis=0)
    first = sessions[0]
    return first.model_copy(
        update={
            "fluorescence": emission.values.reshape(-1, 3),
            "fluorescence_covariance": emission.covariance,
            "reflectance": reflected.values.reshape(-1, 3),
            "reflectance_covariance": reflected.covariance,
            "channel_weights": weights / weights.sum(),
            "flags": tuple(
                tuple("ok" if ok else flag for ok, flag in zip(row, flags, strict=True))
                for row, flags in zip(usable.any(axis=0).reshape(-1, 3), first.flags, strict=True)
            ),
            "saturated_fraction": np.max([one.saturated_fraction for one in sessions], axis=0),
            # readings of a table, with one each, have none
            "region_pixels": max(sum(one.region_pixels for one in sessions if one.region_pixels > 1), 1),
            "bleaching": None,
            "tilt_ratios": tuple(ratio for one in sessions for ratio in one.tilt_ratios),
            "provenance": None,
            "notes": (*_notes(scatter), *(f"session {i}: {n}" for i, s in enumerate(sessions, 1) for n in s.notes)),
        }
    ), scatter


def _refuse_unlike(sessions: Sequence[BandSignals]) -> None:
    """Refuse what are no repeats of one paint on one rig."""
    if not sessions:
        raise FitError("no band signals are given; give those of one session, or of several sessions of one paint")
    if len(sessions) < 2:
        raise FitError("combined sessions: only one session is given, but at least two are needed")
    first = sessions[0]
    for number, one in enumerate(sessions[1:], start=2):
        if one.paint_name != first.paint_name:
            raise FitError(
                f"session {number} is of paint {one.paint_name!r}, but the first is of paint {first.paint_name!r}; "
                "give sessions of one paint, and fit other paints separately. If all are of one paint, give it one "
                "name: paint_name in the plans, or --paint-name where 'finray import signals' read tables"
            )
        unlike = [
            name for name in type(first.optics).model_fields
            if _as_text(getattr(one.optics, name)) != _as_text(getattr(first.optics, name))
        ]  # fmt: skip
        if "laser" in unlike and one.optics.laser.wavelength_nm != first.optics.laser.wavelength_nm:
            raise FitError(
                f"session {number} was excited at {one.optics.laser.wavelength_nm:g} nm, but the first at "
                f"{first.optics.laser.wavelength_nm:g} nm; give a session under another light with --other-light"
            )
        if unlike:
            raise FitError(
                f"session {number} was captured with a rig whose {unlike[0]} differs from that of the first session, "
                "but only sessions of one rig can be combined, because they share the errors of the rig; capture all "
                "sessions with one rig file"
            )
    _refuse_twice(sessions)


def _refuse_twice(sessions: Sequence[BandSignals]) -> None:
    """Refuse the same session given twice: two sessions never agree in every bit of their noise.

    Reduced once more with other options, one session has other values; it is then known by the file of its session.
    """
    values = [one.fluorescence.tobytes() + one.reflectance.tobytes() for one in sessions]
    for number, value in enumerate(values):
        if value in values[:number]:
            raise FitError(
                f"session {number + 1} contains the same values as session {values.index(value) + 1}, so it would "
                "count twice and make the intervals too narrow; give each session once"
            )
    files = [_session_files(one) for one in sessions]
    for number, file in enumerate(files):
        earlier = next((other for other in range(number) if file & files[other]), None)
        if earlier is not None:
            raise FitError(
                f"sessions {earlier + 1} and {number + 1} were reduced from the same captured session, which would "
                "count twice and make the intervals too narrow; give each session once, reduced in one way"
            )


def _session_files(bands: BandSignals) -> set[str]:
    """Return the SHA-256 of the records of captured sessions behind band signals."""
    inputs = {} if bands.provenance is None else bands.provenance.input_sha256
    return {digest for name, digest in inputs.items() if PurePath(name).name == _SESSION_NAME}


def _as_text(part: object) -> str:
    """Return what two equal parts of the optics have in common."""
    if isinstance(part, tuple):
        return " ".join(map(_as_text, part))
    if isinstance(part, dict):
        return " ".join(f"{name} {_as_text(value)}" for name, value in sorted(part.items()))
    dump = getattr(part, "model_dump_json", None)
    return str(part) if dump is None else str(dump())


def _notes(scatter: SessionScatter) -> tuple[str, ...]:
    """Say how the sessions differ."""

    def percent(of: Estimate) -> str:
        return f"{100 * of.estimate:.1f} % [{100 * of.low95:.1f}, {100 * of.high95:.1f}]"

    levels = ", ".join(f"{100 * level:+.1f} %" for level in scatter.session_levels_rel)
    return (
        f"{len(scatter.session_levels_rel)} sessions combined; between sessions the level has a standard deviation of "
        f"{percent(scatter.level_rel)}, and a single filter, in addition, of {percent(scatter.filter_rel)} (95 %); "
        f"levels of the sessions: {levels}",
        *((TWO_SESSIONS,) if len(scatter.session_levels_rel) == 2 else ()),
        *outlying_session_warnings(scatter),
    )


def outlying_session_warnings(scatter: SessionScatter) -> tuple[str, ...]:
    """Return a warning for each session that differs from the others by more than they scatter."""
    return tuple(
        f"session {number} differs from the other sessions by more than these differ from each other (p < "
        f"{DEPARTS_P:g}): look at its frames, or leave it out and state that you did"
        for number in scatter.departing
    )


class _Common:
    """What sessions share of one quantity: its values (N,), their covariance, and the posterior of the scatter."""

    def __init__(
        self, y: Floats, covariances: Floats, usable: NDArray[np.bool_], filters: NDArray[np.int64], tile_rel: float
    ):
        without_tile = np.array(
            [_without_tile(c, np.where(u, v, 0.0), tile_rel, u) for c, v, u in zip(covariances, y, usable, strict=True)]
        )
        self._all = (y, without_tile, usable, filters)
        self._kept = np.flatnonzero(usable.any(axis=0))
        self._y, self._usable = np.where(usable, y, 0.0)[:, self._kept], usable[:, self._kept]
        self._mean = self._y.sum(axis=0) / self._usable.sum(axis=0)
        block = np.ix_(self._kept, self._kept)
        self._own = [c[block] for c in without_tile]
        self._outer = np.outer(self._mean, self._mean)
        same = np.equal.outer(filters[self._kept], filters[self._kept])
        self._of_filter = self._outer * same
        self._integrate()
        self.values, self.covariance = y[0].copy(), covariances[0].copy()
        self.covariance[self._kept, :] = self.covariance[:, self._kept] = 0.0
        self.values[self._kept] = self._mean
        self.covariance[block] = self._covariance + tile_rel**2 * np.outer(self._mean, self._mean)

    def _integrate(self) -> None:
        """Average over the two standard deviations."""
        levels, filters = (one.ravel() for one in np.meshgrid(_LEVELS, _FILTERS, indexing="ij"))
        ln_likelihood = self._ln_likelihood(levels, filters)
        # the grids are even in the logarithm: its density has one more factor of the standard deviation
        ln_prior = np.log(levels * filters) - np.log1p((levels / LEVEL_SCALE) ** 2)
        ln_weight = ln_likelihood + ln_prior - np.log1p((filters / FILTER_SCALE) ** 2)
        weight = np.exp(ln_weight - ln_weight.max())
        weight /= weight.sum()
        self._level, self._filter = (_of_grid(values, weight) for values in (levels, filters))
        share = self._usable / self._usable.sum(axis=0)
        shares = np.einsum("in,im->nm", share, share)
        noise = np.einsum("in,im,inm->nm", share, share, np.array(self._own))
        of_filter = noise + float(weight @ filters**2) * shares * self._of_filter
        along = self._mean / (self._mean @ self._mean)
        fixed = float(along @ of_filter @ along)
        of_level = float(along @ (shares * self._outer) @ along)
        wider = _variance_of_interval(fixed + of_level * levels**2, weight) - fixed
        self._covariance = of_filter + wider / of_level * shares * self._outer

    def _ln_likelihood(self, levels: Floats, filters: Floats) -> Floats:
        """Return the restricted log likelihood (G,) of pairs of standard deviations."""
        number = self._mean.size
        precision, weighted = np.zeros((levels.size, number, number)), np.zeros((levels.size, number))
        ln_likelihood, inverses = np.zeros(levels.size), []
        more = levels[:, None, None] ** 2 * self._outer + filters[:, None, None] ** 2 * self._of_filter
        for own, y, usable in zip(self._own, self._y, self._usable, strict=True):
            rows = np.flatnonzero(usable)
            total = (own + more)[:, rows[:, None], rows]
            inverse = np.linalg.inv(total)
            ln_likelihood -= np.linalg.slogdet(total)[1] / 2
            precision[:, rows[:, None], rows] += inverse
            weighted[:, rows] += inverse @ y[rows]
            inverses.append((rows, inverse))
        means = np.linalg.solve(precision, weighted[..., None])[..., 0]
        ln_likelihood -= np.linalg.slogdet(precision)[1] / 2
        for y, (rows, inverse) in zip(self._y, inverses, strict=True):
            left = y[rows] - means[:, rows]
            ln_likelihood -= np.einsum("gi,gij,gj->g", left, inverse, left) / 2
        return ln_likelihood

    def scatter(self) -> SessionScatter:
        """Return how the sessions differ; who departs is judged by the others alone, from three sessions on."""
        square = self._mean**2
        levels = [
            float(y @ self._mean / (square @ usable)) - 1 for y, usable in zip(self._y, self._usable, strict=True)
        ]
        number = len(self._y)
        departing = [i + 1 for i in range(number) if number > 2 and self._departs(i)]
        return SessionScatter(
            level_rel=self._level,
            filter_rel=self._filter,
            session_levels_rel=tuple(levels),
            departing=tuple(departing),
        )

    def _departs(self, one: int) -> bool:
        """Whether a session lies outside of what the others predict of it, at the upper ends of their scatter.

        An error of the white reference is common to it and to them, and cancels.
        """
        from scipy.special import chdtrc  # here, as every fit would load it

        others = [i for i in range(len(self._y)) if i != one]
        rest = _Common(self._all[0][others], self._all[1][others], self._all[2][others], self._all[3], tile_rel=0.0)
        rows = np.intersect1d(np.flatnonzero(self._all[2][one]), rest._kept)
        block, mean = np.ix_(rows, rows), rest.values[rows]
        same = np.equal.outer(self._all[3][rows], self._all[3][rows])
        scatter = np.outer(mean, mean) * (rest._level.high95**2 + rest._filter.high95**2 * same)
        left = self._all[0][one][rows] - mean
        misfit = float(left @ np.linalg.solve(self._all[1][one][block] + rest.covariance[block] + scatter, left))
        return bool(chdtrc(rows.size, misfit) < DEPARTS_P)


def _without_tile(covariance: Floats, y: Floats, tile_rel: float, usable: NDArray[np.bool_]) -> Floats:
    """Return the covariance of values less what the white reference has in it, where it can hold that part."""
    less = covariance - tile_rel**2 * np.outer(y, y)
    rows = np.flatnonzero(usable)
    least = np.linalg.eigvalsh(less[np.ix_(rows, rows)]).min()
    return less if least > 0 else covariance


def _variance_of_interval(variances: Floats, weight: Floats) -> float:
    """Return the variance of the normal with the 95 % interval of a mixture of normals around 0."""
    from scipy.optimize import brentq
    from scipy.special import ndtr, ndtri  # both here, because every fit would load them, and most are of one session

    sd = np.sqrt(variances)
    tail = brentq(lambda q: float(weight @ ndtr(-q / sd)) - 0.025, 0.0, 60 * sd.max())
    return float(tail / -ndtri(0.025)) ** 2


def _of_grid(values: Floats, weight: Floats) -> Estimate:
    """Return the summary of a distribution on a grid of the logarithm."""
    places, index = np.unique(values, return_inverse=True)
    mass = np.bincount(index, weight)
    ln_quantiles = np.interp([0.025, 0.16, 0.5, 0.84, 0.975], np.cumsum(mass) - mass / 2, np.log(places))
    low95, low68, median, high68, high95 = map(float, np.exp(ln_quantiles))
    sd = float(np.sqrt(weight @ (values - weight @ values) ** 2))
    return Estimate(estimate=median, sd=sd, low68=low68, high68=high68, low95=low95, high95=high95)
