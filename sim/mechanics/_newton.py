"""Equilibrium by Newton's method with a line search on the energy, softened where a gel hardly changes its volume."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics._assembly import Assembly, State
from sim.mechanics._linear_solver import SymmetricSolver, least_curvature, refined, stays_definite

FloatArray = NDArray[np.float64]

_SUFFICIENT = 1e-4  # share of the linear decrease of energy that a step must reach (Armijo)
_NOISE = 1e-13  # relative rounding of a sum of energies; differences below say nothing
_SHORTEST = 1e-4  # share of a step below which the line search gives up
_TRIES_NEARER, _WORTH_A_TRY = (
    3,
    1.05,
)  # for a better share than the first acceptable one, if that far from what was tried
# where a step has lowered the residual by this factor, the tangent changes little: the factors are used again
_NEARLY_LINEAR = 0.3
# and where this share of the forces is out of balance at most: else places come to touch or part, and the rate of these
# solutions is that of their number
_NEARLY_BALANCED = 0.05
# a factorisation takes the time of 10 and 14 solutions with a product at 39 000 and 142 000 unknowns, about as their
# root: two thirds of that are spent at most on avoiding one, since some solutions fail
_REFINEMENTS_PER_ROOT = 0.03
_FEWEST_REFINEMENTS = 4
# a step of which less than this share is taken was led astray by what hardly resists, a rib that begins to fold: the
# next tangent resists that more, so that everything else goes its whole way
_LED_ASTRAY = 0.3
_BOLDER = 3.0  # by which what hardly resists may then go further than it went
_STIFFER, _SOFTER = 4.0, 0.2  # by what this changes when a step was short again, or whole
# shares of each point's negative curvature that are taken away, until the tangent is positive definite; the next step
# tries with less, and below the least share with the exact tangent
_REMOVED, _REMOVED_LESS, _LEAST_REMOVED = (0.3, 1.0), 1.0 / 3.0, 0.1
# a search wanders where the least residual of so many steps is not so much below that of all before, and above such a
# share of the first one: below it, something soft goes a long way, and a smaller increment leads there too
_WANDERS_AFTER, _NEARER, _FAR = 8, 0.5, 1e-3
_ARRIVING = 0.1  # of the residual before: a step that leaves no more is one of Newton's last ones
_OVERSHOOT = 4.0  # the energy may rise this many times more than foreseen while supports move
# an exact tangent that was positive definite so near, in edges of an element, is not factorised again at the
# equilibrium; or, up to the second way, where a few of Lanczos' steps see no soft shape: further off, shapes change by
# too much for so few
_CLOSE_BY, _NEAR = 1e-3, 0.05
# a saddle is left along its negative curvature: by the first of these ways, in edges of an element, that lowers the
# energy, doubled while it falls
_FIRST_WAYS = (1e-2, 1e-3, 1e-4, 1e-5)
_MOST_SADDLES = 10  # that one search leaves
_UNSTABLE = (
    "the search could not leave an unstable equilibrium (in one deformation shape the stiffness is {:.2g} times that "
    "without the terms of negative curvature): a rib or a film may buckle there, and the force may change"
)
_UNTESTED = "it could not be tested whether an equilibrium is stable: a rib or a film may buckle there"


@dataclass(frozen=True, slots=True)
class Supports:
    """Unknowns that are prescribed: which (n, 3), and their displacement (n, 3) in mm."""

    fixed: NDArray[np.bool_]
    displacement_mm: FloatArray

    @classmethod
    def at_rest(cls, count: int, nodes: NDArray[np.int64]) -> "Supports":
        """Hold some of `count` nodes in place."""
        fixed = np.zeros((count, 3), dtype=bool)
        fixed[nodes] = True
        return cls(fixed, np.zeros((count, 3)))


@dataclass(frozen=True, slots=True)
class NewtonOptions:
    """When an equilibrium is reached or given up.

    Parameters
    ----------
    residual_rel
        Norm of the unbalanced forces over that of the reactions and of the terms' forces (contact, ties, loads).
    force_floor_n
        Least force that the residual is compared with: an unloaded body has no reactions.
    step_floor_mm
        A Newton step below this ends the search too: rounding allows no better.
    longest_step_mm
        Steps are shortened to this.
    iterations
        At most.
    patience
        Iterations after which the search is given up unless its last step lowered the residual to a tenth.
    stalled_after
        Steps that together must reach the length of one whole step, or the search is given up; 0: never. A smaller
        increment is cheaper than steps that short.
    tell
        Told before each factorisation how far the search is; what it raises ends the search.
    stable
        Whether a result is tested for being a least energy, and the search goes on from it where it is none.
    """

    residual_rel: float = 1e-6
    force_floor_n: float = 1e-2
    step_floor_mm: float = 1e-10
    longest_step_mm: float = 8.0
    iterations: int = 50
    patience: int = 50
    stalled_after: int = 8
    tell: Callable[[str], None] | None = None
    stable: bool = True


@dataclass(frozen=True, slots=True)
class Equilibrium:
    """What Newton's method reached.

    Attributes
    ----------
    state
        Last state.
    gradient_n
        Derivative of the energy by each unknown (n, 3): at the supports, the force that they exert.
    energy_n_mm
        Whole energy.
    residuals_n
        Norm of the unbalanced forces at the start and after each iteration.
    failure
        Why it is no equilibrium; empty when it is one.
    iterations
        Newton steps that were solved for.
    unstable
        That it is no least energy and could not be left; empty where the tangent is positive definite, or not tested.
    factors, definite_within_mm
        Version of the matrix' pattern whose exact factors the solver holds, -1: none, and how far from here, at most,
        the exact tangent was found positive definite. A search that goes on from here begins with them.
    """

    state: State
    gradient_n: FloatArray
    energy_n_mm: float
    residuals_n: tuple[float, ...]
    failure: str = ""
    iterations: int = 0
    unstable: str = ""
    factors: int = -1
    definite_within_mm: float = math.inf


class _Search:
    """One search for an equilibrium."""

    def __init__(
        self,
        assembly: Assembly,
        supports: Supports,
        solver: SymmetricSolver,
        options: NewtonOptions,
        after: Equilibrium | None = None,
    ) -> None:
        self.assembly, self.supports, self.solver, self.options = assembly, supports, solver, options
        self.residuals: list[float] = []
        self.removals: list[float] = []  # of the tangents that belong to them
        self.solved = 0
        self.ahead: _Ahead | None = None
        self.shares: list[float] = []
        self.taken = 1.0  # of the last step, the share of what the terms allowed
        self.bar_n = 0.0  # what the residual must reach
        self.removed = 0.0  # of each point's negative curvature, the share that the tangent at hand does without
        self.goes_on = after is not None
        # version of the pattern whose factors the solver holds
        self.factors = -1 if after is None else after.factors
        # way from where the exact tangent was last found positive definite
        self.definite_within_mm = math.inf if after is None else after.definite_within_mm
        self.has_factorised = False  # an exact tangent of the terms as they are in this search
        self.saddles, self.since = 0, 0  # that were left, and what was solved for until the last of them
        self.unstable = ""
        self._least_damping = 0.0  # below which damping ends
        self.damping_n_per_mm = 0.0  # added to each unknown's own stiffness

    def run(self, state: State) -> Equilibrium:
        energy = self.assembly.energy(state)
        if not math.isfinite(energy):
            why = "at the start an element is inside out, or a term is not defined"
            return self._result(state, np.zeros_like(state.u_mm), energy, why)
        if not state.pressures_mpa:
            state = self.assembly.with_own_pressures(state)
        while True:
            gradient, of_terms = self._assembled(state)
            remaining = np.where(self.supports.fixed, self.supports.displacement_mm - state.u_mm, 0.0)
            moving = bool(remaining.any())
            ended = self._settled(gradient, of_terms) and not moving
            if not ended:
                if why := self.given_up():
                    return self._result(state, gradient, energy, why)
                self._tell()
                found, ended, why = self._step(state, energy, gradient, remaining, moving)
            if ended:
                found = self._off_a_saddle(state)
                if found is None:
                    return self._result(self.assembly.with_own_pressures(state), gradient, energy)
            elif found is None and self.removed == 1.0:
                return self._result(state, gradient, energy, why)
            else:
                less = self.removed * _REMOVED_LESS
                self.removed = 1.0 if found is None else less if less >= _LEAST_REMOVED else 0.0
            if found is not None:
                self.definite_within_mm += float(np.abs(found[0].u_mm - state.u_mm).max())
                state, energy = found

    def _assembled(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return the gradient and its part of the terms, and fill the matrix, where a trial has not yet done so."""
        ahead, self.ahead = self.ahead, None
        if ahead is not None and ahead.state is state and self.removed == 0.0:
            return ahead.gradient_n, ahead.of_terms_n
        return self.assembly.assemble(state, self.removed)

    def _step(
        self, state: State, energy: float, gradient: FloatArray, remaining: FloatArray, moving: bool
    ) -> tuple[tuple[State, float] | None, bool, str]:
        """Return the next state and its energy or nothing, whether the search has ended, and why nothing was found."""
        try:
            du, rise = self._solved_step(state, gradient, remaining, moving)
        except SimulateError as failed:
            return None, False, str(failed)
        self.removals[-1] = self.removed
        is_whole = self.damping_n_per_mm == 0.0
        if not moving and is_whole and np.abs(du).max() <= self.options.step_floor_mm:
            return None, True, ""
        found = self._line_search(state, energy, du, rise, moving) if np.isfinite(du).all() else None
        if found is None:
            return None, False, "the line search found no lower energy"
        self._damp(du, rise, moving)
        if not moving and self.taken < 1.0:
            there = replace(found[0], modes=self.assembly.elasticity.relaxed(found[0].u_mm, found[0].modes))
            found = there, self.assembly.energy(there)
        return found, False, ""

    def _damp(self, du: FloatArray, rise: float, moving: bool) -> None:
        """Choose the damping of the next step (K. Levenberg, 1944) by the share of this one that was taken.

        What a shortened step follows has the stiffness k = -rise / du^2, and with k / share added would have gone as
        far as it went.
        """
        share = self.taken
        if moving or share >= 1.0:
            self.damping_n_per_mm *= _SOFTER if self.damping_n_per_mm > self._least_damping else 0.0
        elif share < _LED_ASTRAY:
            stiffness = abs(rise) / max(_dot(du.ravel(), du.ravel()), 1e-300)
            if self.damping_n_per_mm == 0.0:
                self.damping_n_per_mm = stiffness / (_BOLDER * share)
                self._least_damping = stiffness
            else:
                self.damping_n_per_mm *= _STIFFER

    def _result(self, state: State, gradient: FloatArray, energy: float, failure: str = "") -> Equilibrium:
        found = Equilibrium(state, gradient, energy, tuple(self.residuals), failure, self.solved, self.unstable)
        return replace(found, factors=self.factors, definite_within_mm=self.definite_within_mm)

    def given_up(self) -> str:
        """Return why the search is not gone on with, or nothing."""
        since = self.solved - self.since
        arriving = len(self.residuals) > 1 and self.residuals[-1] <= _ARRIVING * self.residuals[-2]
        if since >= self.options.iterations or (since >= self.options.patience and not arriving):
            return f"no equilibrium after {self.solved} iterations"
        last = self.shares[-self.options.stalled_after :] if self.options.stalled_after else []
        if last and len(last) == self.options.stalled_after and sum(last) < 1.0:
            return f"the last {len(last)} of {self.solved} steps add up to only {sum(last):.2g} of one full step"
        # where negative curvature is taken away, a search leaves a saddle, and residuals rise before they fall
        counted = [r for r, removed in zip(self.residuals, self.removals, strict=True) if removed == 0.0]
        before, lately = counted[:-_WANDERS_AFTER], counted[-_WANDERS_AFTER:]
        near = max(_NEARER * min(before, default=math.inf), _FAR * self.residuals[0])
        if self.options.stalled_after and len(before) >= _WANDERS_AFTER - 1 and min(lately) > near:
            return (
                f"the forces are {min(lately):.2g} N out of balance after {self.solved} iterations, no closer than "
                "before"
            )
        return ""

    def _tell(self) -> None:
        """Tell how far the search is."""
        if self.options.tell is not None:
            unbalanced = f"out of balance by {self.residuals[-1]:.2g} N, {self.bar_n:.1g} N allowed"
            self.options.tell(f"iteration {self.solved + 1}, {unbalanced}")

    def _settled(self, gradient: FloatArray, of_terms: FloatArray) -> bool:
        fixed = self.supports.fixed
        residual = _norm(gradient[~fixed])
        self.residuals.append(residual)
        self.removals.append(self.removed)
        forces = _norm(gradient[fixed]), _norm(of_terms)
        unbalanced = max(residual, self.assembly.elasticity.mode_residual_n())
        self.bar_n = self.options.residual_rel * max(*forces, self.options.force_floor_n)
        return bool(unbalanced <= self.bar_n)

    def _solved_step(
        self, state: State, gradient: FloatArray, remaining: FloatArray, moving: bool
    ) -> tuple[FloatArray, float]:
        """Return du (n, 3) and the linear change of the energy, by a tangent that is positive definite.

        As little as makes it so is taken away of the negative curvature of each point. Newton's step by an indefinite
        tangent goes to a saddle of the energy, where a rib stands that would buckle; a multiple of the unit matrix
        added would hold the soft bending of the whole finger more than the rib. Supports that move go by what remains
        of their way, and what is returned is then by how much the energy may rise.

        Raises
        ------
        SimulateError
            When the tangent without negative curvature is singular.
        """
        fixed, matrix, elasticity = self.supports.fixed.ravel(), self.assembly.matrix, self.assembly.elasticity
        prescribed = remaining.ravel()
        self.solved += 1
        while True:
            right = np.where(fixed, 0.0, -gradient.ravel())
            if moving:
                stiffness = matrix.values.copy()
                right = np.where(fixed, prescribed, right - matrix.times(prescribed))
            matrix.values[matrix.indptr[:-1]] += self.damping_n_per_mm
            matrix.constrain(fixed)
            du = None if moving or self.removed > 0.0 else self._with_old_factors(right)
            if du is None and not self._factorised():
                self.removed = next(share for share in _REMOVED if share > self.removed)
                gradient, _ = self.assembly.assemble(state, self.removed)
                continue
            du = self.solver.solve(right) if du is None else du
            slope = _dot(gradient.ravel(), du) - elasticity.mode_work_n_mm()
            if moving:
                matrix.values[:] = stiffness
                slope = abs(slope) + 0.5 * abs(_dot(du, matrix.times(du)))
            return du.reshape(-1, 3), slope

    def _factorised(self) -> bool:
        """Factorise the constrained tangent in the matrix, if it is definite or can be made so by no less curvature."""
        matrix = self.assembly.matrix
        self.factors = -1
        if self.removed == 1.0:
            self.solver.factorise(matrix.upper(), matrix.version)
        elif not self.solver.factorise_definite(matrix.upper(), matrix.version):
            return False
        if self.removed == 0.0:
            self.factors = matrix.version
            self.definite_within_mm = 0.0 if self.damping_n_per_mm == 0.0 else math.inf
            self.has_factorised = True
        return True

    def _off_a_saddle(self, state: State) -> tuple[State, float] | None:
        """Return a state beside an equilibrium that is none of least energy, and its energy; else nothing.

        Positive definite is the tangent by u alone, with the modes and pressures eliminated and, of friction, the
        forces that hold the contact as they are.
        """
        self.unstable = ""
        seen = self.has_factorised and self._definite_within(_CLOSE_BY)
        if not self.options.stable or seen or self._stays_definite():
            return None
        self.removed = self.damping_n_per_mm = 0.0
        matrix = self.assembly.matrix
        self.assembly.assemble(state)
        matrix.constrain(self.supports.fixed.ravel())
        if self._factorised():
            return None
        self._tell()
        self.solved += 1
        exact = matrix.upper().copy()
        curvature, way = math.nan, None
        for self.removed in _REMOVED:
            self.assembly.assemble(state, self.removed)
            matrix.constrain(self.supports.fixed.ravel())
            if self.solver.factorise_definite(matrix.upper(), matrix.version):
                curvature, way = least_curvature(exact, matrix.upper(), self.solver)
                break
        self.removed = 0.0
        if way is not None and curvature >= 0.0:
            return None
        found = None
        if way is not None and self.saddles < _MOST_SADDLES:
            found = self._downwards(state, np.where(self.supports.fixed, 0.0, way.reshape(-1, 3)))
        self.saddles, self.since = self.saddles + 1, self.solved
        self.shares.clear()
        self.removals = [1.0] * len(self.residuals)
        if found is None:
            self.unstable = _UNTESTED if way is None else _UNSTABLE.format(curvature)
        return found

    def _definite_within(self, elements: float) -> bool:
        """Tell whether an exact tangent was positive definite nearer than some elements' edges."""
        return self.definite_within_mm <= elements * self.assembly.elasticity.element_mm

    def _stays_definite(self) -> bool:
        """Tell whether the tangent at hand is exact and still as positive definite as when it was last factorised."""
        matrix = self.assembly.matrix
        if self.removed > 0.0 or self.factors != matrix.version or not self._definite_within(_NEAR):
            return False
        matrix.constrain(self.supports.fixed.ravel())
        return stays_definite(matrix.times, self.solver, len(matrix.indptr) - 1)

    def _downwards(self, state: State, way: FloatArray) -> tuple[State, float] | None:
        """Return the state of least merit M, at held pressures, along a way (n, 3) or back, and its energy, or nothing.

        M falls with the square of what is gone: both senses are tried, the better one is followed. Where the energy of
        a nearly incompressible body falls too, it is followed no further than both do; where only M falls, the energy
        does so in the search that follows, with the pressures.
        """
        elasticity = self.assembly.elasticity
        self.assembly.assemble(state)
        energy, held = self.assembly.energy(state), state.pressures_mpa
        merit = energy + elasticity.excess_n_mm(held)
        noise = _NOISE * (sum(map(abs, elasticity.energy_of_blocks().values())) + abs(energy) + abs(merit))
        way = way / max(float(np.abs(way).max()), 1e-300)
        step = elasticity.mode_step(way)

        def trial(size_mm: float) -> _Trial:
            there = state.moved(size_mm, way, step)
            if self.assembly.max_step(state, size_mm * way) < 1.0:
                return _Trial(size_mm, math.inf, there, math.inf)
            new = self.assembly.energy(there)
            return _Trial(size_mm, new + elasticity.excess_n_mm(held) if new < math.inf else new, there, new)

        falling = None
        for first in _FIRST_WAYS:
            size_mm = first * elasticity.element_mm
            best = min(trial(size_mm), trial(-size_mm), key=lambda tried: tried.merit_n_mm)
            if best.merit_n_mm < merit - noise:
                falling = falling or best
                if best.energy_n_mm < energy - noise:
                    falling = best
                    break
        if falling is None:
            return None
        highest = energy if falling.energy_n_mm < energy else math.inf
        while abs(2.0 * falling.share) <= self.options.longest_step_mm:
            further = trial(2.0 * falling.share)
            if not (further.merit_n_mm < falling.merit_n_mm and further.energy_n_mm < highest):
                break
            falling = further
        return falling.state, falling.energy_n_mm

    def _with_old_factors(self, right: FloatArray) -> FloatArray | None:
        """Return the solution to what Newton's method needs, if the last step was nearly linear.

        What it needs (Eisenstat and Walker 1996, their second choice): no more digits than the step before has won
        twice, since the next residual is quadratic in this one, and no more than a tenth of what is still to be done.
        """
        matrix, last = self.assembly.matrix, max(self.residuals[-1], 1e-300)
        if self.factors != matrix.version or last > _NEARLY_BALANCED / self.options.residual_rel * self.bar_n:
            return None
        if len(self.residuals) > 1:
            won = last / max(self.residuals[-2], 1e-300)
        elif self.goes_on:
            won = 0.0
        else:
            return None
        if won > _NEARLY_LINEAR:
            return None
        needed = min(max(0.1 * self.bar_n / last, won**2, 1e-8), 1e-3)
        most = max(_FEWEST_REFINEMENTS, round(_REFINEMENTS_PER_ROOT * math.sqrt(right.size)))
        return refined(matrix.times, self.solver, right, needed, most)

    def _line_search(
        self, state: State, energy: float, du: FloatArray, rise: float, moving: bool
    ) -> tuple[State, float] | None:
        """Return the state at an acceptable share of the step and its energy, or none.

        What must fall is M of :class:`~sim.mechanics._assembly.Elasticity`, with the step's own pressures.
        """
        elasticity = self.assembly.elasticity
        step = elasticity.mode_step(du)
        pressures, softer = elasticity.full_step_pressures_mpa(du, step)
        merit, rise = energy + elasticity.excess_n_mm(pressures), rise + softer
        if not moving and rise > _NOISE * abs(energy):
            return None
        share = min(1.0, self.options.longest_step_mm / max(float(np.abs(du).max()), 1e-300))
        share *= self.assembly.max_step(state, share * du)
        whole = share
        noise = _NOISE * (sum(map(abs, elasticity.energy_of_blocks().values())) + abs(energy) + abs(merit))
        foreseen = self.taken == 1.0 and self.removed == 0.0 and not moving

        def trial(share: float) -> _Trial:
            there = state.moved(share, du, step)
            if share == 1.0 and moving:
                there.u_mm[self.supports.fixed] = self.supports.displacement_mm[self.supports.fixed]
            if share == 1.0 and foreseen:
                there = there.towards(pressures, 1.0)
                self.ahead = _Ahead(there, *self.assembly.assemble(there))
            new = self.assembly.energy(there)
            return _Trial(share, new + elasticity.excess_n_mm(pressures) if new < math.inf else new, there, new)

        refused = None
        while share > _SHORTEST:
            tried = trial(share)
            allowed = _OVERSHOOT * rise if moving else _SUFFICIENT * share * rise
            if tried.merit_n_mm <= merit + allowed + noise:
                if refused is not None and not moving:
                    tried = _nearer_to_least(trial, merit, rise, tried, refused)
                elif self.removed > 0.0 and share == 1.0 and not moving:
                    tried = self._further(trial, tried, noise, state, du)
                self.shares.append(tried.share)
                self.taken = min(1.0, tried.share / whole)
                if self.ahead is not None and tried.state is self.ahead.state:
                    return tried.state, tried.energy_n_mm
                return tried.state.towards(pressures, tried.share), tried.energy_n_mm
            refused = tried
            # minimum of the parabola through both energies and the slope, kept between a tenth and a half
            curve = tried.merit_n_mm - merit - share * rise
            best = -0.5 * rise * share**2 / curve if not moving and 0.0 < curve < math.inf else 0.5 * share
            share = min(max(best, 0.1 * share), 0.5 * share)
        return None

    def _further(
        self, trial: Callable[[float], "_Trial"], found: "_Trial", noise: float, state: State, du: FloatArray
    ) -> "_Trial":
        """Return the best of a whole step and twice, four times ... as much of it, as long as the merit falls.

        A tangent without negative curvature also resists the shapes that leave a saddle: a step holds a part only of
        what the energy allows them.
        """
        longest = float(np.abs(du).max())
        while 2.0 * found.share * longest <= self.options.longest_step_mm:
            share = 2.0 * found.share
            if self.assembly.max_step(state, share * du) < 1.0:
                break
            tried = trial(share)
            if not tried.merit_n_mm < found.merit_n_mm - noise:
                break
            found = tried
        return found


class _Ahead(NamedTuple):
    """What is assembled already of the state that a whole step leads to, whose energy comes with it.

    Where steps are whole, the next one is likely to be so too: its energy alone would cost half of what this does.
    """

    state: State
    gradient_n: FloatArray
    of_terms_n: FloatArray


class _Trial(NamedTuple):
    """A share of a step: what must fall there (:meth:`_Search._line_search`), the state and its energy."""

    share: float
    merit_n_mm: float
    state: State
    energy_n_mm: float


def _nearer_to_least(
    trial: Callable[[float], _Trial], merit: float, slope: float, found: _Trial, refused: _Trial
) -> _Trial:
    """Return the best share between an acceptable and a refused one: an energy costs a tenth of a step or less.

    Each try is at the minimum of the cubic through both and the start, whose slope is known.
    """
    for _ in range(_TRIES_NEARER):
        share = _least_of_cubic(
            slope, (found.share, found.merit_n_mm - merit), (refused.share, refused.merit_n_mm - merit)
        )
        if not _WORTH_A_TRY * found.share < share < refused.share / _WORTH_A_TRY:
            break
        tried = trial(share)
        found, refused = (tried, refused) if tried.merit_n_mm < found.merit_n_mm else (found, tried)
    return found


def _least_of_cubic(slope: float, near: tuple[float, float], far: tuple[float, float]) -> float:
    """Return where a t + b t^2 + c t^3 is least, through two points (t, value); the middle where that is nowhere."""
    (s, at_s), (t, at_t) = near, far
    b_s, b_t = (at_s - slope * s) / s**2, (at_t - slope * t) / t**2
    c = (b_t - b_s) / (t - s)
    b = b_s - c * s
    root = b * b - 3.0 * slope * c
    if not (math.isfinite(at_t) and root >= 0.0 and b + math.sqrt(root) > 0.0):
        return 0.5 * (s + t)
    return -slope / (b + math.sqrt(root))


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return a . b without BLAS, which would wake a thread of its own for long vectors and let it spin."""
    return float(np.einsum("i,i->", a, b))


def _norm(vector: FloatArray) -> float:
    """Return the length of an array of any shape."""
    return math.sqrt(_dot(vector.ravel(), vector.ravel()))


def find_equilibrium(
    assembly: Assembly,
    start: State,
    supports: Supports,
    solver: SymmetricSolver,
    options: NewtonOptions | None = None,
    after: Equilibrium | None = None,
) -> Equilibrium:
    """Find the least energy near a state, with prescribed displacements.

    Newton's method on displacements, incompatible modes and the pressures of nearly incompressible elements; each step
    must lower the energy (Armijo), in which the change of volume counts softly; one by a tangent without negative
    curvature goes on as long as it falls; one that has to be shortened goes near to the least energy along it, the
    modes of each element then follow by themselves, and what hardly resisted is damped in the next step. Where the
    exact tangent has negative curvature, as in buckling, as much of that of each point is taken away as makes it
    positive definite, and all of it after a step that lowered nothing. A result is tested for being a least energy: its
    tangent is factorised, or compared with a factorised one near by. A saddle is left along its negative curvature, to
    the side of lower energy, and the search goes on from there. The tangent is that of the energy with friction's
    limits held, so that it is symmetric: stable means that nothing moves by itself while they stay; the curvature of an
    indenter times how deep it sinks in is left out where its contact leaves it out. Supports that are not yet where
    they shall be move there in the first step, or in several where that turns an element inside out or a term allows
    less.

    Parameters
    ----------
    assembly, start, supports, solver, options
        What is in equilibrium, where the search begins, what is held, what solves, and when it ends.
    after
        The equilibrium that `start` is, found with this solver, when terms have changed a little since.

    Returns
    -------
    Equilibrium
        Check its `failure`: it is empty for an equilibrium.
    """
    return _Search(assembly, supports, solver, options or NewtonOptions(), after).run(start)
