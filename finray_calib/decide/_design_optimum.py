"""Judge the designs of a search: which is best, what it gains, which differences are real, what could still be gained.

Numbers are losses: logarithms of positive numbers, with the sign that makes less better. A difference of losses is then
a ratio, and their sum weighs 1 % of one objective like 1 % of another.

Choices that a list holds, such as pairs of paints, are ranked by draws of their values that belong to each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import (
    CompareError,
    DesignGain,
    DesignObjective,
    DesignOptimum,
    DesignParameter,
    DesignRole,
    EvaluatedDesign,
    FingerDesign,
    MainEffect,
    OptimisedDesign,
    PaintChoice,
    PaintPairRow,
    PropagatedDraws,
    interval_text,
)
from finray_calib.decide._design_emulator import (
    DesignEmulator,
    emulator_ensemble,
    fit_emulator,
    joint_draws,
    main_effect,
    near_front,
    screening_designs,
)

Floats = NDArray[np.float64]

#: A design is not on the front where another one is as good in all and better by this in one objective.
TOLERANCE_REL: Final = 0.01
#: Probability beyond which a difference of two designs is called real, on one side.
REAL: Final = 0.975
_DRAWS: Final = 960
_FAR: Final = 2.0
_FRONT_DRAWS: Final = 240
#: Designs all over the box, and about the chosen one, that might be better than it.
_ALL_OVER, _ABOUT = 128, 128
_ABOUT_SD: Final = 0.08
_LEVELS: Final = 17
#: Emulators of an ensemble that main effects are drawn from: one in so many.
_EVERY: Final = 6
_AVERAGED: Final = 32


@dataclass(frozen=True)
class DesignSearch:
    """What a search computed, in order.

    Attributes
    ----------
    objectives, parameters
        K and D of them.
    places
        Of the designs within the limits, (N, D) from 0 to 1; the start first, the chosen one last.
    changes
        Values of the parameters of each.
    roles, evaluated
        Of each.
    """

    objectives: tuple[DesignObjective, ...]
    parameters: tuple[DesignParameter, ...]
    places: Floats
    changes: tuple[dict[str, float], ...]
    roles: tuple[DesignRole, ...]
    evaluated: tuple[EvaluatedDesign, ...]

    @property
    def usable(self) -> NDArray[np.int64]:
        """Numbers from 0 of the designs that could be evaluated, (M,)."""
        return np.array([k for k, one in enumerate(self.evaluated) if not one.failure], dtype=np.int64)

    @property
    def losses(self) -> Floats:
        """Losses of the designs that could be evaluated, (M, K)."""
        rows = [[self.evaluated[k].values[one.name] for one in self.objectives] for k in self.usable]
        return losses(np.array(rows), self.objectives)

    @property
    def most_told(self) -> Floats:
        """Greatest losses that the emulators are told, (K,): twice as far above the median as the best lies below it.

        A design that hides the light has a loss many times that far: lengths and noise of an emulator that follows it
        no longer tell good designs apart. The start, which gains are counted from, is always told. Infinite with
        several objectives, as the front reaches to designs that are poor in one.
        """
        seen = self.losses
        if seen.shape[1] > 1:
            return np.full(seen.shape[1], np.inf)
        middle = np.median(seen, axis=0)
        return np.asarray(np.maximum(middle + _FAR * (middle - seen.min(axis=0)), seen[0]))

    def emulators(self, before: Sequence[DesignEmulator], is_fitted_again: bool = True) -> tuple[DesignEmulator, ...]:
        """Return an emulator of each objective's loss; where it is not fitted again, lengths and noise stay.

        Parameters
        ----------
        before
            Emulators of fewer designs, from which to start; may be empty.
        is_fitted_again
            Whether lengths and noise are fitted again.
        """
        inputs = self.places[self.usable]
        found = []
        for k, column in enumerate(np.minimum(self.losses, self.most_told).T):
            last = before[k] if before else None
            if last is None or is_fitted_again:
                found.append(fit_emulator(inputs, column, last))
            else:
                found.append(DesignEmulator(inputs, column, last.ln_parameters))
        return tuple(found)

    @property
    def screen_best(self) -> int:
        """Number from 0 of the best design of the screen, as computed: what a search by chance alone would take."""
        total = self.losses.sum(axis=1)
        return min((total[row], int(k)) for row, k in enumerate(self.usable) if self.roles[k] == "screen")[1]


@dataclass(frozen=True, slots=True)
class JudgedDesigns:
    """What a search knows of its designs.

    Attributes
    ----------
    limits
        95 % interval of the losses of the designs, (2, N, K).
    p_front
        Probability that no design within the limits is as good in every objective and better by the tolerance in one,
        (N,).
    apart
        1 where a design is really worse than the chosen one, -1 where it is really better, 0 elsewhere, (N, K).
    gain_draws
        Losses of the start and of the best of the screening less those of the chosen design, (2, draws, K).
    regret_draws
        Sum of the losses of the chosen design less the least one within the limits, (draws,).
    """

    limits: Floats
    p_front: Floats
    apart: NDArray[np.int64]
    gain_draws: Floats
    regret_draws: Floats


def losses(values: Floats, objectives: Sequence[DesignObjective]) -> Floats:
    """Return the losses (N, K) of positive numbers (N, K): their logarithms, with the sign that makes less better."""
    signs = np.array([-1.0 if objective.larger_is_better else 1.0 for objective in objectives])
    return np.asarray(signs * np.log(values))


def values_of(lost: Floats, objectives: Sequence[DesignObjective]) -> Floats:
    """Return the numbers (N, K) whose losses are given."""
    signs = np.array([-1.0 if objective.larger_is_better else 1.0 for objective in objectives])
    return np.asarray(np.exp(signs * lost))


def gain_rel(difference: Floats | float, objective: DesignObjective) -> Floats:
    """Return a gain, relative to what it is compared with, of a difference of losses; positive is better."""
    found = np.expm1(difference) if objective.larger_is_better else -np.expm1(-np.asarray(difference))
    return np.asarray(found)


def judge_designs(
    ensembles: Sequence[Sequence[DesignEmulator]], inputs: Floats, compared: tuple[int, int, int], seed: int
) -> JudgedDesigns:
    """Judge computed designs by joint draws of what the emulators know of them and of all others.

    Valid where the emulators' priors hold; random numbers that all designs share are part of what was computed, so that
    a confirmation with others is needed beside it.

    Parameters
    ----------
    ensembles
        Of each objective, on its losses.
    inputs
        Computed designs (N, D), from 0 to 1.
    compared
        Numbers from 0 of the start, of the best of the screening and of the chosen design.
    seed
        Of draws and of the designs that are compared with.
    """
    rng = np.random.default_rng([seed, len(inputs)])
    start, screen, chosen = compared
    about = inputs[chosen] + rng.normal(0.0, _ABOUT_SD, (_ABOUT, inputs.shape[1]))
    others = np.concatenate([screening_designs(inputs.shape[1], _ALL_OVER, seed + 1), np.clip(about, 0.0, 1.0)])
    at = np.concatenate([inputs, others])
    draws = np.stack([joint_draws(ensemble, at, _DRAWS, rng) for ensemble in ensembles], axis=-1)
    own = draws[:, : len(inputs)]
    total = draws.sum(axis=-1)
    above = own - own[:, chosen][:, None]
    worse, better = (above > 0.0).mean(axis=0), (above < 0.0).mean(axis=0)
    on_front = [near_front(one[: len(inputs)], one, np.log1p(TOLERANCE_REL)) for one in draws[: _FRONT_DRAWS * 4 : 4]]
    return JudgedDesigns(
        np.quantile(own, [0.025, 0.975], axis=0),
        np.mean(on_front, axis=0),
        (worse > REAL).astype(np.int64) - (better > REAL),
        np.stack([above[:, start], above[:, screen]]),
        np.asarray(total[:, chosen] - total.min(axis=1)),
    )


def design_gains(
    judged: JudgedDesigns, seen: Floats, objectives: Sequence[DesignObjective], confirmed: Floats | None
) -> tuple[DesignGain, ...]:
    """Return the gains of the chosen design: as computed, as the emulator knows, and as confirmed.

    Parameters
    ----------
    judged
        By :func:`judge_designs`.
    seen
        Computed losses of the start, the best of the screening and the chosen design, (3, K).
    objectives
        K of them.
    confirmed
        The same with other random numbers, (seed, 3, K), at least three of them; None: not confirmed.
    """
    found = []
    against: tuple[Literal["start", "best of the screen"], ...] = ("start", "best of the screen")
    for k, objective in enumerate(objectives):
        for row, name in enumerate(against):
            drawn = gain_rel(np.quantile(judged.gain_draws[row, :, k], [0.025, 0.5, 0.975]), objective)
            own = float(gain_rel(seen[row, k] - seen[2, k], objective))
            mean, limits = (None, None) if confirmed is None else _confirmed(confirmed[:, (row, 2), k], objective)
            found.append(
                DesignGain(
                    objective=objective.name,
                    against=name,
                    seen_rel=own,
                    expected_rel=float(drawn[1]),
                    expected_95_rel=(float(drawn[0]), float(drawn[2])),
                    confirmed_rel=mean,
                    confirmed_95_rel=limits,
                    shrinkage_rel=None if mean is None else own - mean,
                )
            )
    return tuple(found)


def _confirmed(pair: Floats, objective: DesignObjective) -> tuple[float, tuple[float, float]]:
    """Return mean and 95 % limits (Student's t) of the gain between losses (seed, 2)."""
    difference = pair[:, 0] - pair[:, 1]
    half = student_t.ppf(0.975, len(difference) - 1) * difference.std(ddof=1) / np.sqrt(len(difference))
    low, mean, high = (float(gain_rel(difference.mean() + k * half, objective)) for k in (-1.0, 0.0, 1.0))
    return mean, (low, high)


def main_effects(
    ensembles: Sequence[Sequence[DesignEmulator]],
    objectives: Sequence[DesignObjective],
    parameters: Sequence[DesignParameter],
    seed: int,
) -> tuple[MainEffect, ...]:
    """Return how each objective goes with each parameter, all others averaged over their limits, with 95 % limits.

    Values are those of the geometric mean: exp of the mean of ln.
    """
    rng = np.random.default_rng([seed, 2])
    levels = np.linspace(0.0, 1.0, _LEVELS)
    others = screening_designs(len(parameters), _AVERAGED, seed + 2)
    found = []
    for ensemble, objective in zip(ensembles, objectives, strict=True):
        sign = -1.0 if objective.larger_is_better else 1.0
        for column, parameter in enumerate(parameters):
            values = np.exp(sign * main_effect(ensemble[::_EVERY], column, levels, others, rng))
            low, mean, high = np.quantile(values, [0.025, 0.5, 0.975], axis=0).tolist()
            found.append(
                MainEffect(
                    objective=objective.name,
                    parameter=parameter.field,
                    at=tuple((parameter.low + levels * (parameter.high - parameter.low)).tolist()),
                    mean=tuple(mean),
                    low95=tuple(low),
                    high95=tuple(high),
                )
            )
    return tuple(found)


def design_optimum(
    searched: DesignSearch, confirmed: Floats | None, seed: int, notes: Sequence[str] = ()
) -> DesignOptimum:
    """Return the outcome of a search as a record.

    Parameters
    ----------
    searched
        The designs, the chosen one last.
    confirmed
        Losses of start, best of the screening and chosen design with other random numbers, (seed, 3, K), or None.
    seed
        Of the draws.
    notes
        What the numbers rest on.
    """
    objectives, usable = searched.objectives, searched.usable
    emulators = searched.emulators(())
    ensembles = [emulator_ensemble(one, np.random.default_rng([seed, k])) for k, one in enumerate(emulators)]
    last, screen = len(searched.roles) - 1, searched.screen_best
    compared = tuple(int(np.flatnonzero(usable == k)[0]) for k in (0, screen, last))
    judged = judge_designs(ensembles, searched.places[usable], (compared[0], compared[1], compared[2]), seed)
    gains = design_gains(judged, searched.losses[list(compared)], objectives, confirmed)
    regret = -np.expm1(-judged.regret_draws)
    most = float(np.quantile(judged.regret_draws, 0.95))
    best = searched.evaluated[last]
    return DesignOptimum(
        name=f"{best.design.name}, optimised",
        sentence=_sentence(searched, gains, most),
        objectives=objectives,
        parameters=searched.parameters,
        designs=_rows(searched, judged),
        chosen=last + 1,
        screen_best=screen + 1,
        gains=gains,
        regret_rel=float(regret.mean()),
        regret_95_rel=float(-np.expm1(-most)),
        unexplained_rel={o.name: e.left_out_error_rel for e, o in zip(emulators, objectives, strict=True)},
        tolerance_rel=TOLERANCE_REL,
        effects=main_effects(ensembles, objectives, searched.parameters, seed),
        start=searched.evaluated[0].design,
        design=best.design.model_copy(update={"name": f"{best.design.name}-optimised"}),
        processor_s=sum(one.processor_s for one in searched.evaluated),
        notes=tuple(notes),
    )


def _rows(searched: DesignSearch, judged: JudgedDesigns) -> tuple[OptimisedDesign, ...]:
    """Return all designs with what is known of them."""
    of_usable = {int(k): row for row, k in enumerate(searched.usable)}
    names = [one.name for one in searched.objectives]
    lost, most = searched.losses, searched.most_told
    rows = []
    for k, (role, changes, found) in enumerate(zip(searched.roles, searched.changes, searched.evaluated, strict=True)):
        row = of_usable.get(k)
        apart = np.zeros(len(names), dtype=np.int64) if row is None else judged.apart[row]
        limits = None if row is None else values_of(_limits_of(judged, lost, most, row), searched.objectives)
        rows.append(
            OptimisedDesign(
                number=k + 1,
                role=role,
                changes=changes,
                values={name: found.values[name] for name in names if name in found.values},
                failure=found.failure,
                expected_95={} if limits is None else dict(zip(names, _ends(limits), strict=True)),
                p_front=None if row is None else float(judged.p_front[row]),
                better_than_chosen=tuple(n for n, a in zip(names, apart, strict=True) if a < 0),
                worse_than_chosen=tuple(n for n, a in zip(names, apart, strict=True) if a > 0),
            )
        )
    return tuple(rows)


def _limits_of(judged: JudgedDesigns, lost: Floats, most: Floats, row: int) -> Floats:
    """Return the limits (2, K) of a design's losses; beyond what emulators are told, up to the computed loss."""
    low, high = judged.limits[:, row]
    return np.array([low, np.where(lost[row] > most, np.maximum(high, lost[row]), high)])


def _ends(limits: Floats) -> list[tuple[float, float]]:
    """Return the lower and the upper end of intervals (2, K)."""
    return [(float(min(pair)), float(max(pair))) for pair in limits.T]


def _sentence(searched: DesignSearch, gains: Sequence[DesignGain], most: float) -> str:
    """Say what to build, what it gains, and what could still be gained: at `most` this difference of losses."""
    changes = ", ".join(f"{name} {value:.4g}" for name, value in searched.changes[-1].items())
    against_start = [gain for gain in gains if gain.against == "start"]
    told = "; ".join(_gain_words(gain) for gain in against_start)
    is_better = any(_limits(gain)[0] > 0.0 for gain in against_start)
    build = f"Build the finger with {changes}: {told}"
    if not is_better:
        build = f"Keep the starting design: the best design found ({changes}) is not shown to be better: {told}"
    first, *others = searched.objectives
    better_rel = float(-np.expm1(-most) if others else gain_rel(most, first))
    whole = " in all objectives together (product of their ratios)" if others else ""
    return (
        f"{build}. With 95 % probability no design within the limits is better by more "
        f"than {100 * better_rel:.1f} %{whole}, according to the emulator."
    )


def _limits(gain: DesignGain) -> tuple[float, float]:
    """Return the interval of a gain: the confirmed one, else the emulator's."""
    return gain.expected_95_rel if gain.confirmed_95_rel is None else gain.confirmed_95_rel


def _gain_words(gain: DesignGain) -> str:
    """Say what is gained in one objective against the start, as far as it is confirmed."""
    value, limits, how = gain.expected_rel, gain.expected_95_rel, "by the emulator, not confirmed"
    if gain.confirmed_rel is not None and gain.confirmed_95_rel is not None:
        value, limits, how = gain.confirmed_rel, gain.confirmed_95_rel, "with other seeds and contact places"
    real = "" if limits[0] > 0.0 or limits[1] < 0.0 else ", no significant difference"
    word = "better" if value >= 0.0 else "worse"
    low, high = (100 * end for end in (sorted(abs(end) for end in limits) if real == "" else limits))
    return f"{gain.objective} {100 * abs(value):.1f} % {word} than the start ({low:.1f} to {high:.1f} %, {how}{real})"


@dataclass(frozen=True, slots=True)
class PairedRanking:
    """Choices in the order of their mean, and which of them are distinguishable.

    Attributes
    ----------
    order
        Numbers of the choices, the least mean first.
    above_best
        Draws of each choice less those of the best, (choice, draw), in the order given.
    half_widths
        Of each difference's interval, (choice, choice): all intervals hold together with the level.
    distinguishable
        Whether the difference of two choices leaves its interval, (choice, choice).
    best_share
        Share of the draws in which a choice is the least, ties divided, (choice,).
    """

    order: NDArray[np.int64]
    above_best: Floats
    half_widths: Floats
    distinguishable: NDArray[np.bool_]
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
            f"a ranking at a level of {LEVEL:g} needs an array of finite values of shape (choices, draws) with at "
            f"least 2 choices and {least} draws, got an array of shape {values.shape}"
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
            is_worse=bool(ranking.distinguishable[k, best]),
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
        rest = "No other pair is shown to be worse: choose for other reasons, or measure the paints better."
    else:
        names = "; ".join(f"{row.red} and {row.green}" for row in alike[:_MOST_NAMED])
        more = f"; and {len(alike) - _MOST_NAMED} more" if len(alike) > _MOST_NAMED else ""
        rest = f"Not shown to be worse: {names}{more}. All other pairs are shown to be worse."
    return (
        f"Paint the red wall with {best.red} and the green wall with {best.green}: the expected error of the sensed "
        f"normal is {told}. {rest}"
    )


_MOST_NAMED = 3
