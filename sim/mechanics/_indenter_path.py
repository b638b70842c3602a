"""Move an indenter along a path: press, slide, shear, twist, roll and release, as a polyline of poses."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from data_schemas import MOST_INCREMENTS, FingerDesign, NoEquilibriumError, PathPose, SimulateError, explain
from data_schemas.storage import finite_number, read_csv
from sim.mechanics._assembly import Assembly, Elasticity, State
from sim.mechanics._finger_mesh import STEPS, finger_materials, finger_mesh, finger_ties
from sim.mechanics._increments import Extrapolation, Load, Watch, load_increments
from sim.mechanics._indenters import RigidIndenter, rigid_indenter
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._newton import NewtonOptions, Supports
from sim.mechanics._penalty_contact import (
    ContactMotion,
    SlidingContact,
    SlidingTouch,
    coat_points,
    penalty_mpa_per_mm,
)
from sim.mechanics._press import PressedFinger, PressHistory, PressSettings, press_finger
from sim.mechanics._rigid_bodies import Pose

FloatArray = NDArray[np.float64]

_AT_A_CORNER = 1e-9  # of an increment


@dataclass(frozen=True, slots=True)
class IndenterPath:
    """A polyline of poses from first touch, where the move and the turn are zero.

    Between two poses moves and rotation vectors change linearly. The turn is about the indenter's own middle (a mesh:
    its origin), after the move.

    Attributes
    ----------
    moves_mm
        Of the r poses, across the finger (x), along the pad's outward normal (y), along the finger (z), (r, 3).
    turns_deg
        Their rotation vectors, in the same axes, (r, 3).
    increments
        Equal steps that are wanted on the way to each pose, (r,).

    Raises
    ------
    SimulateError
        When there is no pose, or there are too many increments.
    """

    moves_mm: FloatArray
    turns_deg: FloatArray
    increments: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(self.increments)
        if not count or self.moves_mm.shape != (count, 3) or self.turns_deg.shape != (count, 3):
            raise SimulateError(
                "a path needs at least one pose, and for each pose three moves, three turns and a number of increments"
            )
        if (self.increments < 1).any() or self.increments.sum() > MOST_INCREMENTS:
            raise SimulateError(
                f"the path has {int(self.increments.sum())} increments, but must have at least 1 for each pose and at "
                f"most {MOST_INCREMENTS} in all"
            )

    @classmethod
    def through(cls, poses: Sequence[PathPose], increments: int) -> "IndenterPath":
        """Return the path through the poses of a design or a file.

        Parameters
        ----------
        poses
            One after the other.
        increments
            On the way to a pose that does not say how many.
        """
        return cls(
            np.array([(pose.across_mm, -pose.push_mm, pose.along_mm) for pose in poses]),
            np.array([(pose.turn_x_deg, pose.turn_y_deg, pose.turn_z_deg) for pose in poses]),
            np.array([pose.increments or increments for pose in poses], dtype=np.int64),
        )

    @property
    def total(self) -> int:
        """Increments in all."""
        return int(self.increments.sum())

    def at(self, share: float) -> tuple[FloatArray, FloatArray]:
        """Return the move (3,) in mm and the turn (3,) in deg after a share of all increments."""
        ends = np.concatenate([[0], np.cumsum(self.increments)])
        move_mm, turn_deg = (
            np.array([np.interp(share * self.total, ends, [0.0, *numbers]) for numbers in poses.T])
            for poses in (self.moves_mm, self.turns_deg)
        )
        return move_mm, turn_deg

    def whereabouts(self, share: float) -> str:
        """Return in words the increment that comes after a share of all increments, and the pose that it leads to."""
        step = min(math.floor(share * self.total + _AT_A_CORNER) + 1, self.total)
        pose = int(np.searchsorted(np.cumsum(self.increments), step)) + 1
        x, y, z = self.moves_mm[pose - 1] + 0.0
        turn = float(np.linalg.norm(self.turns_deg[pose - 1]))
        return (
            f"increment {step} of {self.total}, on the way to pose {pose} of {len(self.increments)} (push "
            f"{0.0 - y:.3g}, across {x:.3g}, along {z:.3g} mm, turn {turn:.3g} deg)"
        )

    def is_corner(self, share: float) -> bool:
        """Whether one of the poses is reached after a share of all increments."""
        return bool((np.abs(np.cumsum(self.increments) - share * self.total) < _AT_A_CORNER).any())


def read_path(path: Path) -> tuple[PathPose, ...]:
    """Return the poses of a CSV file: one a row, relative to first touch.

    Columns are the fields of :class:`~data_schemas.PathPose`; one that is left out takes its default.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    SimulateError
        When it cannot be read, a column is unknown, or a cell is not a number or out of its bounds.
    """
    header, rows = read_csv(path, "the poses of an indenter (CSV)", SimulateError, comments=True)
    known = tuple(PathPose.model_fields)
    allowed = f"the columns are {', '.join(known)}; a column that is left out counts as zero"
    unknown = [name for name in header if name not in known]
    if unknown:
        raise SimulateError(f"{path}: the column {unknown[0][:60]!r} is unknown; {allowed}")
    if not set(header) & set(known[:-1]):
        raise SimulateError(f"{path}: no column moves or turns the indenter; {allowed}")
    if not rows:
        raise SimulateError(f"{path}: contains no poses; write one row for each pose below the header")
    poses = []
    for line, cells in rows:
        if len(cells) < len(header):
            raise SimulateError(f"{path}, line {line}: has {len(cells)} columns, but the header has {len(header)}")
        numbers = {name: _number(path, line, name, cell) for name, cell in zip(header, cells, strict=False)}
        try:
            poses.append(PathPose.model_validate(numbers))
        except ValidationError as error:
            raise SimulateError(f"{path}, line {line}: {explain(error, PathPose)}") from None
    return tuple(poses)


def _number(path: Path, line: int, name: str, cell: str) -> float:
    """Return the number of a cell."""
    try:
        return finite_number(cell)
    except ValueError as error:
        raise SimulateError(f"{path}, line {line}, column {name}: {error}; give a decimal number") from error


def moved_pose(indenter: RigidIndenter, move_mm: FloatArray, turn_deg: FloatArray) -> Pose:
    """Return the pose of an indenter moved from first touch, and turned about its own middle by a rotation vector."""
    x, y, z = np.array(indenter.touching.position_mm) + move_mm
    turned = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix() @ indenter.touching.rotation
    return Pose((float(x), float(y), float(z)), turned)


class MovedIndenter(SlidingTouch):
    """The coat against an indenter that moves in any way, and what is kept of each increment."""

    def __init__(self, design: FingerDesign, settings: PressSettings, folder: Path) -> None:
        indenter, mesh = rigid_indenter(design, folder), finger_mesh(design, settings.preset)
        body = indenter.exact_body()
        self.indenter = indenter
        self._pad_mm = STEPS[settings.preset or design.mesh.preset].pad_mm
        eps = penalty_mpa_per_mm(design, self._pad_mm)
        points, ratio = coat_points(mesh.nodes_mm, mesh.surfaces["coat"], body), design.indenter.friction
        contact = SlidingContact(mesh.nodes_mm, points, body, indenter.touching, eps, ratio)
        super().__init__(mesh, contact)
        self._rows: list[tuple[FloatArray, ...]] = []

    def move(self, move_mm: FloatArray, turn_deg: FloatArray) -> Supports:
        """Put the indenter at a move and a turn from first touch, for an increment from where the last one ended."""
        self.sliding.restart(moved_pose(self.indenter, move_mm, turn_deg))
        return self.supports

    def keep(self, move_mm: FloatArray, turn_deg: FloatArray, state: State) -> None:
        """Keep what the contact does at an equilibrium."""
        u, contact = state.u_mm, self.sliding
        self._rows.append(
            (
                move_mm, turn_deg, np.array(contact.pose.position_mm), contact.torque_n_mm(u),
                contact.pressures_mpa(u), contact.shears_mpa(u), contact.slips_mm(u),
            )
        )  # fmt: skip

    def motion(self) -> ContactMotion:
        """Return what was kept."""
        return ContactMotion(*(np.array(values) for values in zip(*self._rows, strict=True)))

    def passed_through(self, state: State) -> str:
        """Return that an equilibrium is one behind the coat, or nothing.

        Nothing touches, though the undeformed coat would reach into the indenter by more than an element, which a round
        one between nodes explains; or the pressures pull the indenter in.
        """
        contact = self.sliding
        pushed = contact.pressures_mpa(state.u_mm)
        if pushed.any():
            behind = not float(contact.normal_force_n(state.u_mm)[1]) > 0.0
        else:
            behind = float(contact.gaps_mm(np.zeros_like(state.u_mm)).min()) < -self._pad_mm
        return "the indenter has passed through the coat" if behind else ""


def press_along(
    design: FingerDesign,
    path: IndenterPath,
    settings: PressSettings | None = None,
    *,
    folder: Path = Path(),
    progress: Callable[[int, int, str], None] | None = None,
) -> PressedFinger:
    """Move the design's indenter along a path from first touch, with Coulomb friction that follows stick and slip.

    Contact is the penalty on exact distances, see :class:`SlidingContact`; contact between ribs is not computed, and
    the result states from which increment on parts of the finger pass through each other.

    Parameters
    ----------
    design
        Finger, materials, indenter and ``indenter.friction``; ``indenter.depth_mm`` plays no part.
    path
        Where it goes.
    settings
        How it is computed; ``increments`` are those of the path, and ``contact`` may not be "barrier".
    folder
        Where the design stands.
    progress
        Called before each iteration and after each increment.

    Returns
    -------
    PressedFinger
        With its `motion`; ``depth_mm`` is the push at each increment, which a release takes back.

    Raises
    ------
    SimulateError
        When the barrier is asked for, not even the first increment finds an equilibrium, or nothing is ever touched.
    """
    settings = settings or PressSettings()
    if settings.contact == "barrier":
        raise SimulateError("--contact barrier is not supported with [[indenter.path]]; leave --contact out")
    watch = Watch(progress, path.total, settings.budget_s)
    touch = MovedIndenter(design, settings, folder)
    ties = finger_ties(design, touch.mesh, STEPS[settings.preset or design.mesh.preset].skeleton_mm)
    elasticity = Elasticity(touch.mesh, finger_materials(design), settings.threads)
    assembly = Assembly(elasticity, [touch.sliding, *ties])
    history = PressHistory(assembly, ties, touch)
    load = Load(
        at=lambda share: touch.move(*path.at(share)),
        settle=touch.settle if touch.sliding.friction_ratio > 0.0 else None,
        refuse=lambda state, share: touch.passed_through(state),
        accept=touch.accept,
    )
    total, unreached, reached = path.total, "", 0.0
    stops = [(k + 1) / total for k in range(total)]
    try:
        for step in load_increments(
            assembly,
            linear_solver(threads=settings.threads),
            load,
            stops,
            options=NewtonOptions(tell=watch.tell),
            predict=_StraightOn(path),
        ):
            reached = step.fraction
            touch.keep(*path.at(step.fraction), step.equilibrium.state)
            history.add(-float(path.at(step.fraction)[0][1]), step.equilibrium)
            done = step.fraction * total
            watch.reached(math.floor(done + _AT_A_CORNER), f"moved {done:.4g} of {total} increments")
    except NoEquilibriumError as stuck:
        unreached = f"{path.whereabouts(reached)}: {stuck}"
        if history.depth_mm is None:
            raise NoEquilibriumError(unreached) from stuck
    motion = _with_touch(touch.motion(), unreached)
    return replace(history.pressed(unreached), motion=motion, pressure_mpa=motion.pressure_mpa[-1])


def _with_touch(motion: ContactMotion, unreached: str) -> ContactMotion:
    """Return a motion that touches; refuse one on which nothing is ever touched, as there is no patch to draw."""
    if not motion.pressure_mpa.any():
        ended = f", and ended early: {unreached}" if unreached else ""
        raise SimulateError(
            f"the indenter touches no node of the coat at any increment of the path{ended}; push_mm counts from first "
            "touch and is positive into the pad: give a larger push_mm, or a finer [mesh] preset"
        )
    return motion


def press_as_designed(
    design: FingerDesign,
    settings: PressSettings | None = None,
    *,
    folder: Path = Path(),
    progress: Callable[[int, int, str], None] | None = None,
) -> PressedFinger:
    """Press along the design's path where it has one, else to its depth.

    Parameters
    ----------
    design, folder, progress
        See :func:`press_along` and :func:`~sim.mechanics.press_finger`.
    settings
        How it is computed; ``increments`` are those of a press to a depth, and of poses that do not say theirs.

    Raises
    ------
    SimulateError
        See there.
    """
    settings = settings or PressSettings()
    if not design.indenter.path:
        return press_finger(design, settings, folder=folder, progress=progress)
    path = IndenterPath.through(design.indenter.path, settings.increments)
    return press_along(design, path, settings, folder=folder, progress=progress)


class _StraightOn:
    """A predictor: the straight line through the last two equilibria, but not round a corner of the path."""

    def __init__(self, path: IndenterPath) -> None:
        self._path, self._line = path, Extrapolation()

    def __call__(self, state: State, at: float, aim: float) -> State | None:
        """Return the state expected at the share `aim` of the path, or nothing."""
        guess = self._line(state, at, aim)
        return None if self._path.is_corner(at) else guess
