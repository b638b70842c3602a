"""The way to a load: equilibria at shares of it, with smaller increments where needed and predicted starts."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_schemas.errors import NoEquilibriumError
from sim.mechanics.assembly import Assembly, State
from sim.mechanics.linear_solver import SymmetricSolver
from sim.mechanics.newton import Equilibrium, NewtonOptions, Supports, find_equilibrium

_MODE_STEPS = 4  # element by element; the second one usually changes nothing any more
_MODES_SETTLED_REL = 1e-3  # of the energy; Newton's method does the rest
_MOST_ROUNDS = 12  # renewals of lagged forces; each takes the change down to about the coefficient of friction


@dataclass(frozen=True, slots=True)
class Increment:
    """An equilibrium on the way to the full load, with the share of the load that it carries."""

    fraction: float
    equilibrium: Equilibrium


Predictor = Callable[[State, float, float], State | None]
"""From the last equilibrium, its share of the load and the share aimed at: where to start the search, or nothing."""


class Extrapolation:
    """A predictor: the straight line through the last two equilibria."""

    def __init__(self) -> None:
        self._known: list[tuple[float, State]] = []

    def __call__(self, state: State, at: float, aim: float) -> State | None:
        """Return the state expected at the share `aim` of the load after the equilibrium `state` at the share `at`."""
        if not self._known or self._known[-1][0] != at:
            self._known = [*self._known[-1:], (at, state)]
        if len(self._known) < 2:
            return None
        (before, old), (_, new) = self._known
        further = (aim - at) / (at - before)
        return State(
            new.u_mm + further * (new.u_mm - old.u_mm),
            tuple(n + further * (n - o) for n, o in zip(new.modes, old.modes, strict=True)),
        )


def _allowed(assembly: Assembly, state: State, guess: State | None, supports: Supports) -> State | None:
    """Return a guess with the supports in their place, if no term forbids the way there and its energy is finite."""
    if guess is None:
        return None
    u = np.where(supports.fixed, supports.displacement_mm, guess.u_mm)
    there = State(u, guess.modes)
    if assembly.max_step(state, u - state.u_mm) < 1.0 or not math.isfinite(assembly.energy(there)):
        return None
    return _with_own_modes(assembly, there)


def _with_own_modes(assembly: Assembly, state: State) -> State:
    """Return a state with the incompatible modes that belong to its displacements, as nearly as a few steps tell.

    A guess from another mesh brings displacements only: bent elements are too stiff without their modes, and Newton's
    method goes astray on all unknowns. Steps of all elements together, as long as they lower the energy.
    """
    energy, still = assembly.energy(state), np.zeros_like(state.u_mm)
    for _ in range(_MODE_STEPS):
        assembly.assemble(state, project=False)
        there = state.moved(1.0, still, assembly.elasticity.mode_step(still))
        new = assembly.energy(there)
        if not new < energy:
            break
        state, fallen, energy = there, energy - new, new
        if fallen < _MODES_SETTLED_REL * abs(energy):
            break
    return state


def _settled(
    reached: Equilibrium,
    settle: Callable[[State], bool],
    assembly: Assembly,
    supports: Supports,
    solver: SymmetricSolver,
    options: NewtonOptions | None,
) -> Equilibrium:
    """Return the equilibrium at which nothing that terms have lagged changes any more."""
    for _ in range(_MOST_ROUNDS):
        if reached.failure or settle(reached.state):
            return reached
        further = find_equilibrium(assembly, reached.state, supports, solver, options)
        reached = replace(further, iterations=reached.iterations + further.iterations)
    return replace(reached, failure=f"friction and push have not settled in {_MOST_ROUNDS} rounds")


def load_increments(
    assembly: Assembly,
    solver: SymmetricSolver,
    loading: Callable[[float], Supports],
    stops: Sequence[float],
    start: State | None = None,
    begin: float = 0.0,
    shortest_share: float = 1.0 / 64.0,
    options: NewtonOptions | None = None,
    predict: Predictor | None = None,
    settle: Callable[[State], bool] | None = None,
    refuse: Callable[[State, float], str] | None = None,
) -> Iterator[Increment]:
    """Yield equilibria at the given shares of the load, and between them where smaller increments are needed.

    Parameters
    ----------
    assembly, solver, options
        See :func:`~sim.mechanics.newton.find_equilibrium`.
    loading
        Sets the terms (an indenter's place) for a share of the load and returns the supports at that share.
    stops
        Rising or falling shares at which equilibria are wanted.
    start, begin
        State and share to go on from; by default rest and 0.
    shortest_share
        Least increment, as a share of the way from one stop to the next.
    predict
        Where to start the search at a share of the load; by default the last two equilibria are extrapolated. Where
        that start is not allowed or leads nowhere, the search starts from the last equilibrium.
    settle
        Renews at an equilibrium what terms have lagged (friction) and tells whether it still is one; else the search
        goes on from there.
    refuse
        Tells why an equilibrium at a share of the load is none of this load's path (an indenter that has passed through
        the coat), or nothing; a smaller increment is tried then.

    Raises
    ------
    NoEquilibriumError
        When an increment of the least size finds no equilibrium; all increments before have been yielded.
    """
    state, at = start or assembly.at_rest(), begin
    predicted = predict or Extrapolation()
    for stop in stops:
        way = stop - at
        part = 1.0
        done = 0.0
        while done < 1.0:
            part = min(part, 1.0 - done)
            aim = stop if done + part >= 1.0 else stop - way * (1.0 - done - part)
            supports = loading(aim)
            guess = _allowed(assembly, state, predicted(state, at, aim), supports)
            reached = find_equilibrium(assembly, state if guess is None else guess, supports, solver, options)
            if reached.failure and guess is not None:
                reached = find_equilibrium(assembly, state, supports, solver, options)
            if settle is not None:
                reached = _settled(reached, settle, assembly, supports, solver, options)
            if refuse is not None and not reached.failure:
                reached = replace(reached, failure=refuse(reached.state, aim))
            if reached.failure:
                part /= 2.0
                if part < shortest_share:
                    raise NoEquilibriumError(
                        f"no equilibrium beyond {at:.4g} of the load: {reached.failure}. The increments up to there "
                        "are kept; try a finer mesh, smaller increments, or a smaller load"
                    )
                continue
            state, at, done = reached.state, aim, done + part
            part *= 2.0
            yield Increment(at, reached)
