r"""Two fingers of a gripper that close on a free rigid object, which finds its own place, and then carry its weight.

.. math:: W_1(q, s) + W_2(q, s) + W_g = 0, \qquad \tfrac12 (N_1 + N_2) = N

q is the move and the turn of the object (six numbers), s how far each finger has closed since both touched it, W_1 and
W_2 the forces and torques of the fingers on it, N the force that they close with. A finger is in equilibrium for every
q and s, and answers to a change of them through its own stiffness, factorised as an increment begins and ends. Newton's
method on these seven unknowns, then Broyden's; a step costs one equilibrium of each finger, from a start that is nearly
right.

Axes are those of the near finger: x across it, y its pad's outward normal, z along it. The far finger faces it, turned
by 180 deg about z. Jaws move along y, without giving way; nothing else touches the object; motions are slow.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import constants
from scipy.optimize import minimize

from data_schemas import FingerDesign, NoEquilibriumError, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity, State
from sim.mechanics._derivatives import StableEquilibrium
from sim.mechanics._finger_mesh import STEPS, finger_materials, finger_ties
from sim.mechanics._increments import Load, Watch, load_increments
from sim.mechanics._indenter_path import MovedIndenter, moved_pose
from sim.mechanics._indenters import PackagedBody, RigidIndenter
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._newton import Equilibrium, NewtonOptions
from sim.mechanics._press import PressedFinger, PressHistory, PressSettings, touch_areas_mm2

FloatArray = NDArray[np.float64]

#: Where the weight pulls, in the axes of the near finger: a gripper that points down, lies on its side, or stands.
DOWN: Final = {"tip": (0.0, 0.0, 1.0), "side": (1.0, 0.0, 0.0), "near": (0.0, -1.0, 0.0)}
Down = Literal["tip", "side", "near"]

HALF_TURN: Final = np.array([-1.0, -1.0, 1.0])
"""The half turn about z that takes one finger to the other, on vectors (3,): its own inverse."""

_LONGEST_CLOSING_MM: Final = 0.4  # of an increment, so that the object turns little in it
_LEAST_FIRST: Final = 1e-3  # of it: the least first closing
_LOOSE_MM: Final = 5.0  # of closing without touch: the object has left the fingers
_GRIPS_REL: Final = 0.1  # of the closing force: before, the object may still turn freely, and the closing is given
_BALANCED_REL: Final = 5e-3  # of the closing force: friction of each finger is known to 1e-3 of its pushes
_MOST_STEPS: Final = 15
_PATIENCE: Final = 5  # steps that together must win something
_LONGEST_MM, _LONGEST_DEG = 1.0, 5.0  # of a step
_TURN_DEG, _MOVE_MM = 1e-5, 1e-6  # for differences: so short that hardly a point begins to touch
_FREE_REL: Final = 1e-4  # of the largest stiffness: what gives way more than this is held by nothing
_LEAST_SHARE: Final = 1.0 / 8.0  # of an increment


@dataclass(frozen=True, slots=True)
class Grasp:
    """Two fingers and what they hold, at k increments.

    Attributes
    ----------
    near, far
        Each finger with the motion of the object as it sees it; forces and torques are on the object, in that finger's
        axes.
    closing_mm
        How far each finger has closed since both touched the object, (k,).
    force_n
        That they close with: mean of both along y, (k,).
    weight_n
        Of the object, as far as it is carried, (k,).
    moves_mm, turns_deg
        Of the object from where both fingers touch it: move (k, 3) and rotation vector (k, 3) about its middle (a mesh:
        its origin), in the axes of the near finger.
    unbalanced_n
        Size of the force that is left over on the object, (k,).
    stiffness_n_per_mm
        Least resistance to a move of the object at the last increment, turns left free, or to a turn at half the pad's
        width: below zero it is squeezed out or tips over at the least touch, zero where a direction is free. How
        its weight's torque turns with it is left out.
    lost
        Why the fingers do not close or carry as asked; empty when they do.
    """

    near: PressedFinger
    far: PressedFinger
    closing_mm: FloatArray
    force_n: FloatArray
    weight_n: FloatArray
    moves_mm: FloatArray
    turns_deg: FloatArray
    unbalanced_n: FloatArray
    stiffness_n_per_mm: float
    lost: str


@dataclass(frozen=True, slots=True)
class GraspTask:
    """The force and the weight that two fingers have to hold.

    Attributes
    ----------
    force_n
        That they close with.
    mass_kg
        Of the object, which is carried once they have closed; 0: no weight.
    down
        Where the weight pulls: "tip" (along the fingers), "side" (across them), "near" (into the near finger).
    closing_increments, lifting_increments
        Steps that are wanted.
    """

    force_n: float
    mass_kg: float = 0.0
    down: Down = "tip"
    closing_increments: int = 4
    lifting_increments: int = 4

    def __post_init__(self) -> None:
        if not 0.0 < self.force_n < np.inf:
            raise SimulateError(f"the fingers must close with a finite force above 0 N, got {self.force_n:g} N")
        if min(self.closing_increments, self.lifting_increments) < 1:
            raise SimulateError("a grasp needs at least 1 increment to close and 1 to lift")
        if self.down not in DOWN:
            raise SimulateError(f"down must be one of {', '.join(DOWN)}, got {self.down!r}")
        if not 0.0 <= self.mass_kg < np.inf:
            raise SimulateError(f"the object's mass must be finite and 0 kg or more, got {self.mass_kg:g} kg")

    @property
    def weight_n(self) -> float:
        """Weight of the object."""
        return self.mass_kg * constants.g

    @property
    def steps(self) -> list[tuple[float, float]]:
        """Closing force and carried weight at the end of each increment, in N."""
        closing = [(self.force_n * (k + 1) / self.closing_increments, 0.0) for k in range(self.closing_increments)]
        if self.mass_kg == 0.0:
            return closing
        count = self.lifting_increments
        return closing + [(self.force_n, self.weight_n * (k + 1) / count) for k in range(count)]


def facing_design(design: FingerDesign) -> FingerDesign:
    """Return the design as the facing finger sees it: the same finger, its indenter turned by 180 deg about z."""
    x, y, z = design.indenter.rotation_deg
    turned = (x, y, z - 180.0 if z > 0.0 else z + 180.0)
    there = {"rotation_deg": turned, "across_mm": -design.indenter.across_mm}
    return design.model_copy(update={"indenter": design.indenter.model_copy(update=there)})


def centre_of_mass_mm(indenter: RigidIndenter) -> FloatArray:
    """Return the middle of a homogeneous object from its origin, in its own axes (3,); a body of ours has it there."""
    if indenter.body is not None and not isinstance(indenter.body, PackagedBody):
        return np.zeros(3)
    corners = indenter.surface.vertices_mm[indenter.surface.triangles]
    volumes = np.einsum("ti,ti->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    return np.asarray(volumes @ corners.sum(axis=1) / 4.0 / volumes.sum())


class _GrippingFinger:
    """One finger: its equilibrium for any pose of the object, its force and torque on it, and how these change.

    Moves, turns, forces and torques are in the finger's own axes.
    """

    def __init__(self, design: FingerDesign, settings: PressSettings, folder: Path, watch: Watch) -> None:
        self.touch = MovedIndenter(design, settings, folder)
        mesh = self.touch.mesh
        ties = finger_ties(design, mesh, STEPS[settings.preset or design.mesh.preset].skeleton_mm)
        self._assembly = Assembly(
            Elasticity(mesh, finger_materials(design), settings.threads), [self.touch.sliding, *ties]
        )
        self._solver, self._options = linear_solver(threads=settings.threads), NewtonOptions(tell=watch.tell)
        self._history = PressHistory(self._assembly, ties, self.touch)
        self._kept = self._assembly.with_own_pressures(self._assembly.at_rest())
        self._found: Equilibrium | None = None
        self._at, self._answers = np.zeros(6), np.zeros((6, *self._kept.u_mm.shape))

    def wrench(self, pose: FloatArray) -> FloatArray:
        """Find the equilibrium at a pose (move in mm, turn in deg) and return force and torque on the object, (6,).

        Raises
        ------
        NoEquilibriumError
            There is none.
        """
        begin = self._kept if self._found is None else self._found.state
        guess = State(begin.u_mm + np.tensordot(pose - self._at, self._answers, 1), begin.modes, begin.pressures_mpa)
        settle = self.touch.settle if self.touch.sliding.friction_ratio > 0.0 else None
        load = Load(
            at=lambda _: self.touch.move(pose[:3], pose[3:]),
            settle=settle,
            refuse=lambda state, _: self.touch.passed_through(state),
        )
        found = load_increments(
            self._assembly, self._solver, load, [1.0], (0.0, begin), 1.0, self._options, lambda *_: guess
        )
        try:
            self._found, self._at = next(iter(found)).equilibrium, pose
        except NoEquilibriumError as stuck:
            if not stuck.reason:  # the time is up
                raise
            raise NoEquilibriumError(
                f"no equilibrium of a finger was found ({stuck.reason}); close with less force"
            ) from stuck
        return self._on_object(self._found.state.u_mm)

    def _on_object(self, u: FloatArray) -> FloatArray:
        return np.concatenate([self.touch.sliding.force_n(u), self.touch.sliding.torque_n_mm(u)])

    def stiffness(self) -> FloatArray:
        """Return d(force, torque) / d(move in mm, turn in deg), (6, 6), at the last equilibrium.

        The limits of friction stay as they are.
        """
        if self._found is None:
            raise SimulateError("a finger has a stiffness only at an equilibrium, but none was found")
        state, contact = self._found.state, self.touch.sliding
        # forces nearly cancel in the answer: on an edge the whole second derivative counts
        contact.curvature = True
        try:
            stable = StableEquilibrium(self._assembly, self.touch.supports, state, self._solver)
        except NoEquilibriumError as snaps:
            raise NoEquilibriumError("a rib of a finger is about to snap; close with less force") from snaps
        finally:
            contact.curvature = False
        here, found = contact.pose, np.zeros((6, 6))
        for k, step in enumerate(np.diag([_MOVE_MM] * 3 + [_TURN_DEG] * 3)):
            poses = [moved_pose(self.touch.indenter, *np.split(self._at + way * step, 2)) for way in (-1.0, 1.0)]
            pulls = []
            for pose in poses:
                contact.follow(pose)
                pulls.append(contact.gradient(state.u_mm))
            contact.follow(here)
            answer = stable.moved_mm((pulls[1] - pulls[0]) / 2.0)
            wrenches = []
            for pose, way in zip(poses, (-1.0, 1.0), strict=True):
                contact.follow(pose)
                wrenches.append(self._on_object(state.u_mm + way * answer))
            contact.follow(here)
            found[:, k] = (wrenches[1] - wrenches[0]) / (2.0 * step[k])
            self._answers[k] = answer / step[k]
        return found

    def forget(self) -> None:
        """Go back to the last increment that was kept."""
        self._found = None
        self._answers[:] = 0.0

    def keep(self, pose: FloatArray) -> None:
        """Keep the last equilibrium, found at a pose, as an increment."""
        if self._found is None:
            raise SimulateError("only an equilibrium can be kept, but none was found")
        self._kept = self._found.state
        self.touch.keep(pose[:3], pose[3:], self._kept)
        self._history.add(-float(pose[1]), self._found)
        self.touch.accept(self._kept)

    def pressed(self, unreached: str) -> PressedFinger:
        """Return the increments that were kept."""
        motion = self.touch.motion()
        return replace(self._history.pressed(unreached), motion=motion, pressure_mpa=motion.pressure_mpa[-1])


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the object is, in the axes of the near finger, and how far the fingers have closed."""

    object: FloatArray  # move in mm, turn in deg (6,)
    closing_mm: float

    def moved(self, step: FloatArray) -> "tuple[_Place, FloatArray]":
        """Return the place after a step of the seven unknowns, shortened to what is looked at as small, and that."""
        most = max(np.abs(step[[0, 1, 2, 6]]).max() / _LONGEST_MM, np.abs(step[3:6]).max() / _LONGEST_DEG, 1.0)
        step = step / most
        return _Place(self.object + step[:6], self.closing_mm + float(step[6])), step

    def seen(self, turned: FloatArray) -> FloatArray:
        """Return the pose (6,) as a finger sees it that is turned by a diagonal (3,)."""
        pose = self.object * np.tile(turned, 2)
        pose[1] -= self.closing_mm
        return pose


@dataclass(frozen=True, slots=True)
class _Balance:
    """The object in balance between the fingers."""

    place: _Place
    closing_n: float
    weight_n: float
    unbalanced_n: float
    stiffness: FloatArray


class _Gripper:
    """Both fingers and the object between them."""

    def __init__(
        self, design: FingerDesign, task: GraspTask, settings: PressSettings, folder: Path, watch: Watch
    ) -> None:
        self.force_n, self.down = task.force_n, task.down
        self.turned = (np.ones(3), HALF_TURN)
        designs = (design, facing_design(design))
        self.fingers = tuple(_GrippingFinger(one, settings, folder, watch) for one in designs)
        self._middle = centre_of_mass_mm(self.fingers[0].touch.indenter)
        # turns count by what they move at half the pad's width
        self._arm_mm = design.pad.width_mm / 2.0
        self._scale = np.array([1.0] * 3 + [np.degrees(1.0 / self._arm_mm)] * 3 + [1.0])

    def unbalance(self, place: _Place, weight_n: float) -> tuple[FloatArray, float]:
        """Return what is left over on the object at a place, force (3,) and torque over the arm (3,) in N.

        With the closing force there.
        """
        found, closing = np.zeros(6), 0.0
        for finger, turned in zip(self.fingers, self.turned, strict=True):
            wrench = finger.wrench(place.seen(turned))
            closing += float(wrench[1]) / 2.0
            found += wrench * np.tile(turned, 2)
        weight = weight_n * np.array(DOWN[self.down])
        found += np.concatenate([weight, np.cross(self.fingers[0].touch.sliding.pose.rotation @ self._middle, weight)])
        found[3:] /= self._arm_mm
        return found, closing

    def stiffness(self) -> FloatArray:
        """Return the derivative (7, 7) of what is left over, and of the closing force, by pose and closing."""
        found = np.zeros((7, 7))
        for finger, turned in zip(self.fingers, self.turned, strict=True):
            signs, own = np.tile(turned, 2), finger.stiffness()
            found[:6, :6] += signs[:, None] * own * signs
            found[:6, 6] -= signs * own[:, 1]
            found[6, :6] += own[1] * signs / 2.0
            found[6, 6] -= own[1, 1] / 2.0
        found[3:6] /= self._arm_mm
        return found

    def step(self, stiffness: FloatArray, left: FloatArray, closes: bool) -> FloatArray:
        """Return Newton's step (7,), with or without a change of the closing; what nothing holds stays where it is."""
        count = 7 if closes else 6
        scaled = (stiffness * self._scale)[:count, :count]
        found = np.zeros(7)
        found[:count] = np.linalg.lstsq(scaled, -left[:count], rcond=_FREE_REL)[0] * self._scale[:count]
        return found

    def settle(self, place: _Place, force_n: float, weight_n: float, closes: bool) -> _Balance:
        """Return the balance of the object near a place, with the closing that gives the force, or with that closing.

        Raises
        ------
        NoEquilibriumError
            Where it finds none.
        """
        allowed = _BALANCED_REL * self.force_n
        sizes: list[float] = []
        stiffness, before, step = np.zeros((7, 7)), np.zeros(7), np.zeros(7)
        while len(sizes) < _MOST_STEPS and (
            len(sizes) <= _PATIENCE or min(sizes[-_PATIENCE:]) < 0.9 * min(sizes[:-_PATIENCE])
        ):
            found, closing = self.unbalance(place, weight_n)
            left = np.append(found, closing - force_n if closes else 0.0)
            sizes.append(float(np.abs(left).max()))
            if sizes[-1] <= allowed:
                return _Balance(place, closing, weight_n, float(np.linalg.norm(left[:3])), self.stiffness())
            if len(sizes) % _PATIENCE == 1:
                stiffness = self.stiffness()
            else:
                # slip gives way more than the limits of friction tell before it: learn from what the step did
                scaled = step / self._scale
                missed = left - before - stiffness @ step
                stiffness = stiffness + np.outer(missed, scaled / self._scale) / float(scaled @ scaled)
            before = left
            place, step = place.moved(self.step(stiffness, left, closes))
        raise NoEquilibriumError(
            f"the object reaches no equilibrium in {len(sizes)} steps, because the largest residual force is "
            f"{min(sizes):.2g} N and at most {allowed:.2g} N are allowed (a torque counts divided by {self._arm_mm:g} "
            "mm); give more friction or closing force, or less mass"
        )

    def least_resistance_n_per_mm(self, balance: _Balance) -> float:
        """Return :func:`least_resistance` at a balance, turns at half the pad's width."""
        return least_resistance(-(balance.stiffness * self._scale)[:6, :6])

    def keep(self, balance: _Balance) -> None:
        """Keep an increment."""
        for finger, turned in zip(self.fingers, self.turned, strict=True):
            finger.keep(balance.place.seen(turned))

    def forget(self) -> None:
        """Go back to the last increment that was kept."""
        for finger in self.fingers:
            finger.forget()


def least_resistance(stiffness: FloatArray) -> float:
    """Return the least that resists a move of the object, its turns free, or a turn where that is below zero.

    Parameters
    ----------
    stiffness : ndarray, shape (6, 6)
        Resistance to moves and turns, jaws held, turns scaled to be alike. What is below 1e-4 of it counts as zero.
    """
    least_resolved = _FREE_REL * float(np.abs(stiffness).max())
    tips = float(np.linalg.eigvalsh((stiffness[3:, 3:] + stiffness[3:, 3:].T) / 2.0).min())
    if tips < -least_resolved:
        return tips
    turns = np.linalg.pinv(stiffness[3:, 3:], rcond=_FREE_REL)
    moves = stiffness[:3, :3] - stiffness[:3, 3:] @ turns @ stiffness[3:, :3]
    least = float(np.linalg.eigvalsh((moves + moves.T) / 2.0).min())
    return least if abs(least) > least_resolved else 0.0


class _Way:
    """The way to a grasp: balances at closings and weights that are near enough to each other.

    Parameters
    ----------
    gripper
        Fingers and object.
    """

    def __init__(self, gripper: _Gripper) -> None:
        self._gripper = gripper
        self.kept: list[_Balance] = []
        self._longest_mm = _LONGEST_CLOSING_MM

    def towards(self, force_n: float, weight_n: float) -> None:
        """Go on until the fingers close with a force and carry a weight.

        Raises
        ------
        NoEquilibriumError
            Where the object is lost on the way.
        """
        share = 1.0
        while True:
            try:
                done = self._increment(force_n, weight_n, share)
            except NoEquilibriumError:
                self._gripper.forget()
                share, self._longest_mm = share / 2.0, self._longest_mm / 2.0
                if share < _LEAST_SHARE:
                    raise
                continue
            if done:
                return
            share = min(1.0, 2.0 * share)
            self._longest_mm = min(_LONGEST_CLOSING_MM, 2.0 * self._longest_mm)

    def _increment(self, force_n: float, weight_n: float, share: float) -> bool:
        """Find and keep the next balance; return whether it is the last one."""
        gripper = self._gripper
        if not self.kept:
            return self._touch(force_n)
        last = self.kept[-1]
        if last.closing_n <= _GRIPS_REL * gripper.force_n:
            self._close_loosely(last)
            return False
        more_n, lifted_n = share * (force_n - last.closing_n), share * (weight_n - last.weight_n)
        left = np.append(lifted_n * np.array(DOWN[gripper.down]), [0.0, 0.0, 0.0, -more_n])
        step = gripper.step(last.stiffness, left, closes=True)
        # force, weight and closing go on together, by no longer a closing than is looked at as small
        part = min(1.0, self._longest_mm / max(abs(float(step[6])), 1e-12))
        wanted_n, carried_n = last.closing_n + part * more_n, last.weight_n + part * lifted_n
        self._keep(gripper.settle(last.place.moved(part * step)[0], wanted_n, carried_n, closes=True))
        return part == share == 1.0

    def _touch(self, force_n: float) -> bool:
        """Close for the first time, by so little that the force is not passed; return False."""
        while True:
            first = self._gripper.settle(_Place(np.zeros(6), self._longest_mm), 0.0, 0.0, closes=False)
            if first.closing_n <= force_n or self._longest_mm < _LONGEST_CLOSING_MM * _LEAST_FIRST:
                self._keep(first)
                return False
            self._gripper.forget()
            self._longest_mm /= 2.0

    def _close_loosely(self, last: _Balance) -> None:
        """Close by a way, where the object may still turn freely between the fingers."""
        touched_mm = max((balance.place.closing_mm for balance in self.kept if balance.closing_n > 0.0), default=0.0)
        if last.place.closing_mm - touched_mm > _LOOSE_MM:
            raise NoEquilibriumError(
                "the object has slipped out from between the fingers; put it nearer to the middle of the pad "
                "(indenter.across_mm, position_mm), or give it friction"
            )
        step = np.zeros(7)
        step[6] = self._longest_mm
        step[:6] = self._gripper.step(last.stiffness, last.stiffness[:, 6] * self._longest_mm, closes=False)[:6]
        self._keep(self._gripper.settle(last.place.moved(step)[0], 0.0, last.weight_n, closes=False))

    def _keep(self, balance: _Balance) -> None:
        self._gripper.keep(balance)
        self.kept.append(balance)


def grasp_object(
    design: FingerDesign,
    task: GraspTask,
    settings: PressSettings | None = None,
    *,
    folder: Path = Path(),
    progress: Callable[[int, int, str], None] | None = None,
) -> Grasp:
    """Close two fingers on the design's indenter as a free object, and let them carry its weight.

    The fingers close from where both touch the object, until they push with the wanted force, and hold that force while
    the weight grows from zero: until then something else carries it. Contact is the penalty with Coulomb friction and a
    history of stick and slip, see :class:`~sim.mechanics.SlidingContact`.

    Parameters
    ----------
    design
        Both fingers, and the object: ``indenter`` without its ``depth_mm``.
    task
        The force and the weight that they have to hold.
    settings
        How it is computed; ``increments`` and ``contact`` are not used.
    folder
        Where the design stands.
    progress
        Called before each iteration and after each increment.

    Returns
    -------
    Grasp
        Up to where the object is lost, if it is.

    Raises
    ------
    SimulateError
        When the indenter has a path, a weight has no friction to carry it, or the object is lost at first touch.
    """
    if design.indenter.path:
        raise SimulateError(
            f"indenter.path: has {len(design.indenter.path)} poses, but a grasped object moves freely; leave "
            "[[indenter.path]] out of the design"
        )
    if task.mass_kg > 0.0 and task.down != "near" and design.indenter.friction == 0.0:
        raise SimulateError(
            "indenter.friction = 0 cannot hold a weight that pulls along or across the fingers; set indenter.friction, "
            "the coefficient between object and coat, or leave --mass out"
        )
    settings = settings or PressSettings()
    steps = task.steps
    watch = Watch(progress, len(steps), settings.budget_s)
    gripper = _Gripper(design, task, settings, folder, watch)
    way, lost = _Way(gripper), ""
    for number, (force_n, weight_n) in enumerate(steps, 1):
        try:
            way.towards(force_n, weight_n)
        except NoEquilibriumError as stuck:
            if not way.kept:
                raise
            lost = str(stuck)
            break
        watch.reached(number, f"closed with {force_n:.3g} N, {weight_n:.3g} N of weight carried")
    return _as_grasp(gripper, way.kept, lost)


def _as_grasp(gripper: _Gripper, kept: list[_Balance], lost: str) -> Grasp:
    """Return what was kept."""
    near, far = (finger.pressed(lost) for finger in gripper.fingers)
    poses = np.array([balance.place.object for balance in kept])
    return Grasp(
        near=near,
        far=far,
        closing_mm=np.array([balance.place.closing_mm for balance in kept]),
        force_n=np.array([balance.closing_n for balance in kept]),
        weight_n=np.array([balance.weight_n for balance in kept]),
        moves_mm=poses[:, :3],
        turns_deg=poses[:, 3:],
        unbalanced_n=np.array([balance.unbalanced_n for balance in kept]),
        stiffness_n_per_mm=gripper.least_resistance_n_per_mm(kept[-1]),
        lost=lost,
    )


def contact_forces_n(pressed: PressedFinger) -> tuple[FloatArray, FloatArray]:
    """Return where a pressed contact pushes, places on the coat at rest (k, 3), and how hard, (k,) in N.

    The pressures times their areas, made to add up to the size of the force on the indenter; places at rest: the
    patch's own stretch, a few per cent, is left out.
    """
    pushes = pressed.pressure_mpa * touch_areas_mm2(pressed)
    touching = pushes > 0.0
    whole = float(pushes.sum())
    if whole <= 0.0:
        raise SimulateError("no torque can be computed, because nothing presses on the coat; press deeper")
    return pressed.touch_mm[touching], pushes[touching] * float(np.linalg.norm(pressed.force_n[-1])) / whole


def slip_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, friction: float) -> float:
    r"""Return the torque about the pad's normal at which a pressed object begins to turn on the pad.

    T = mu min_c sum_i N_i |r_i - c|, in the plane across the normal (x, z).

    Coulomb's law with the frictionless normal forces N_i, taken to stay as they are while the object slides, on all
    of the patch at once, as a rigid body about the centre c that holds least (limit analysis: with c the friction
    forces add up to nothing, a pure torque). The pad's own shear before that, and the change of the pressures by
    friction, are left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,): see :func:`contact_forces_n`.
    friction
        Coulomb's coefficient mu between object and coat.

    Raises
    ------
    SimulateError
        When the coefficient is negative.
    """
    if not 0.0 <= friction < np.inf:
        raise SimulateError(f"friction must be a finite coefficient of 0 or more (Coulomb), got {friction:g}")
    flat = places_mm[:, [0, 2]]

    def torque(centre: FloatArray) -> float:
        return float(forces_n @ np.linalg.norm(flat - centre, axis=1))

    start = forces_n @ flat / forces_n.sum()
    return friction * float(minimize(torque, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun)


def frictionless_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, width_mm: float) -> float:
    """Return the torque about the finger's long axis that normal forces alone can hold: T = N (w / 2 - |x|).

    x is where their resultant N acts across the finger. An object that turns about that axis shifts the resultant
    towards the pad's edge and tips over it there; the finger's own twist (see
    :meth:`sim.mechanics.LoadedFinger.twist`) is left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,).
    width_mm
        Of the pad.
    """
    whole = float(forces_n.sum())
    return whole * (width_mm / 2.0 - abs(float(forces_n @ places_mm[:, 0]) / whole))
