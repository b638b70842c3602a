"""Two fingers that grasp: balance and symmetry, what friction carries at most, and an object that turns into place.

What they are held against knows nothing of the object's balance: differences of whole equilibria, Coulomb's law for
two contacts, the geometry of a cuboid between parallel faces, and the same finger on a given path.
"""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import FingerDesign, NoEquilibriumError, SimulateError
from sim import preset_design
from sim.mechanics import STEPS, GraspTask, IndenterPath, PressSettings, facing_design, grasp_object, press_along
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._grasp import _Balance, _GrippingFinger, _Place, _Way, centre_of_mass_mm, least_resistance
from sim.mechanics._increments import Watch
from sim.mechanics._indenters import RigidIndenter
from sim.mechanics._rigid_bodies import Pose, RoundedBox, TriangleMesh, body_mesh

BALL = {"shape": "ball", "radius_mm": 10.0, "position_mm": 24.0, "friction": 0.5}
CUBOID = {"shape": "cuboid", "size_mm": (12.0, 14.0, 16.0), "position_mm": 24.0, "friction": 0.1}


@pytest.fixture(autouse=True)
def rough_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mesh half as finely as coarse: balance does not hang on it."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))


def held(indenter: dict[str, object]) -> FingerDesign:
    base = preset_design("baby-48x18")
    return FingerDesign.model_validate(base.model_dump() | {"indenter": base.indenter.model_dump() | indenter})


@pytest.mark.parametrize(("indenter", "allowed_rel"), [({**CUBOID, "friction": 0.0}, 0.02), (BALL, 0.05)])
def test_a_finger_answers_to_the_object_as_whole_equilibria_differ(
    indenter: dict[str, object], allowed_rel: float
) -> None:
    finger = _GrippingFinger(held(indenter), PressSettings("coarse"), Path(), Watch(None, 1))
    start = np.array([0.0, -0.8, 0.0, 0.0, 0.0, 0.0])
    finger.wrench(start)
    finger.keep(start)
    pose = np.array([0.05, -1.0, 0.05, 0.0, 0.0, 0.0])
    finger.wrench(pose)
    found = finger.stiffness()
    over_arm = np.array([1.0] * 3 + [1.0 / 10.0] * 3)  # forces in N beside torques in N mm, at the object's size
    for axis, step in ((0, 0.01), (1, 0.01), (2, 0.01), (3, 0.1), (4, 0.1), (5, 0.1)):
        move = np.zeros(6)
        move[axis] = step
        differed = over_arm * (finger.wrench(pose + move) - finger.wrench(pose - move)) / (2.0 * step)
        # the contact's edge moves in such long steps; and the limits of friction are renewed, which the answer leaves
        allowed = allowed_rel * np.abs(differed).max()
        assert np.abs(over_arm * found[:, axis] - differed).max() < allowed, (axis, over_arm * found[:, axis], differed)


def test_a_ball_between_equal_fingers_is_balanced_and_carried_until_friction_gives_out() -> None:
    task = GraspTask(1.0, 0.12, "tip", closing_increments=2, lifting_increments=3)
    design = held(BALL)
    grasp = grasp_object(design, task, PressSettings("coarse"))
    # the far finger is the near one turned by a half turn about z, and so is all that happens to it
    turned = grasp.far.force_n * [-1.0, -1.0, 1.0]
    weight = grasp.weight_n[:, None] * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(grasp.near.force_n + turned + weight, 0.0, atol=0.005)  # what a balance leaves
    np.testing.assert_allclose(grasp.near.force_n, grasp.far.force_n, atol=0.005)
    np.testing.assert_allclose(grasp.moves_mm[:, :2], 0.0, atol=1e-3)
    np.testing.assert_allclose(grasp.turns_deg, 0.0, atol=0.02)
    assert grasp.stiffness_n_per_mm > 0.0
    # flat contacts hold 2 mu N at most, of which 0.12 kg is 1.18; round ones a little else, as they tilt with the ball;
    # what is held is known to an eighth of a lifting increment, 0.05 N
    limit_n = 2.0 * 0.5 * 1.0
    assert grasp.lost
    assert 0.9 * limit_n < grasp.weight_n[-1] < 1.08 * limit_n
    # the near finger alone, its object led along the way that the balance found
    path = IndenterPath(
        grasp.near.motion.moves_mm, grasp.near.motion.turns_deg, np.ones(len(grasp.weight_n), dtype=np.int64)
    )
    led = press_along(design, path, PressSettings("coarse"))
    assert not led.unreached
    # friction settles to 1e-3 of the pushes in each of some ten increments, on another way of iterations
    np.testing.assert_allclose(led.force_n[-1], grasp.near.force_n[-1], atol=0.02)


def test_a_cuboid_that_stands_askew_turns_into_the_faces() -> None:
    askew_deg = 2.0
    design = held({**CUBOID, "rotation_deg": (askew_deg, 0.0, 0.0)})
    grasp = grasp_object(design, GraspTask(0.5, closing_increments=1), PressSettings("coarse"))
    assert grasp.force_n[-1] == pytest.approx(0.5, abs=0.003)
    # by symmetry the faces stay parallel, and the cuboid lies flat against both: 0.05 deg over its 8 mm are 7 um, and
    # the balance's 0.0025 N move the faces by less at their stiffness
    assert grasp.turns_deg[-1] == pytest.approx([-askew_deg, 0.0, 0.0], abs=0.05)
    # from edge to edge it is longer than from face to face: so much the fingers close before they meet it flat
    size_y, size_z, edge = 14.0, 16.0, 1.0
    tilt = np.radians(askew_deg)
    across = (size_y - 2 * edge) * np.cos(tilt) + (size_z - 2 * edge) * np.sin(tilt) + 2 * edge
    flat = (across - size_y) / 2.0
    # then 0.5 N sink in and bend the fingers, whose stiffness is 1.5 to 4 N/mm
    assert flat < grasp.closing_mm[-1] < flat + 0.4


def test_the_centre_of_mass_of_an_stl_lies_in_its_volume() -> None:
    box = body_mesh(RoundedBox((3.0, 4.0, 5.0), 0.5), 0.01, 10.0)
    moved = TriangleMesh(box.vertices_mm + np.array([1.0, -2.0, 3.0]), box.triangles)
    assert centre_of_mass_mm(RigidIndenter(None, moved, Pose((0.0, 0.0, 0.0)))) == pytest.approx([1.0, -2.0, 3.0])


def test_the_far_finger_sees_the_object_turned_by_a_half_turn() -> None:
    design = held({**BALL, "across_mm": 2.0, "rotation_deg": (10.0, -20.0, 30.0)})
    seen = facing_design(design)
    assert seen.indenter.across_mm == -2.0
    assert seen.indenter.rotation_deg == (10.0, -20.0, -150.0)
    assert facing_design(seen) == design


@pytest.mark.parametrize(
    ("force_n", "mass_kg", "said"), [(0.0, 0.0, "above 0 N"), (np.nan, 0.0, "above 0 N"), (1.0, -1.0, "0 kg or more")]
)
def test_a_task_that_cannot_be_is_refused(force_n: float, mass_kg: float, said: str) -> None:
    with pytest.raises(SimulateError, match=said):
        GraspTask(force_n, mass_kg)


def test_fingers_that_may_take_no_time_say_so() -> None:
    with pytest.raises(NoEquilibriumError, match=r"budget of 0\.2 s"):
        grasp_object(held(BALL), GraspTask(1.0), PressSettings("coarse", budget_s=0.2))


class FormulaGripper:
    """Fingers whose closing force is 0.5 N/mm of closing and a part of the weight, and hold the object stiffly."""

    def __init__(self, of_weight: float) -> None:
        self.force_n, self.down, self._of_weight = 1.0, "tip", of_weight

    def step(self, stiffness: np.ndarray, left: np.ndarray, closes: bool) -> np.ndarray:
        closing = -left[6] / 0.5 - self._of_weight * left[2] / 0.5 if closes else 0.0
        return np.array([0.0] * 6 + [closing])

    def settle(self, place: _Place, force_n: float, weight_n: float, closes: bool) -> _Balance:
        closing_mm = (force_n - self._of_weight * weight_n) / 0.5 if closes else place.closing_mm
        closing_n = 0.5 * closing_mm + self._of_weight * weight_n
        return _Balance(_Place(place.object, closing_mm), closing_n, weight_n, 0.0, np.zeros((7, 7)))

    def keep(self, balance: _Balance) -> None: ...

    def forget(self) -> None: ...


@pytest.mark.parametrize("of_weight", [0.5, -0.5])
def test_the_closing_force_is_held_while_the_weight_grows(of_weight: float) -> None:
    way = _Way(FormulaGripper(of_weight))
    way.towards(1.0, 0.0)
    closed = len(way.kept)
    way.towards(1.0, 0.6)
    assert way.kept[-1].weight_n == pytest.approx(0.6)
    assert [balance.closing_n for balance in way.kept[closed:]] == pytest.approx([1.0] * (len(way.kept) - closed))
    closings = np.array([balance.place.closing_mm for balance in way.kept])
    assert closings[-1] == pytest.approx((1.0 - of_weight * 0.6) / 0.5)
    assert np.abs(np.diff(closings)).max() <= 0.4 + 1e-9
    assert max(balance.closing_n for balance in way.kept) <= 1.0 + 1e-9


def test_an_object_that_has_left_the_fingers_ends_the_closing() -> None:
    class Empty(FormulaGripper):
        def settle(self, place: _Place, force_n: float, weight_n: float, closes: bool) -> _Balance:
            return _Balance(place, 0.0, weight_n, 0.0, np.zeros((7, 7)))

    with pytest.raises(NoEquilibriumError, match="has slipped out from between the fingers"):
        _Way(Empty(0.0)).towards(1.0, 0.0)


@pytest.mark.parametrize(
    ("moves", "turns", "coupling", "least"),
    [
        ((2.0, 3.0, 4.0), (1.0, 1.0, 1.0), 0.0, 2.0),
        ((2.0, 3.0, 4.0), (1.0, -0.5, 1.0), -0.3, -0.5),  # it tips over, though every move is resisted
        ((2.0, 3.0, 0.1), (1.0, 1.0, 1.0), 0.5, 0.1 - 0.5**2),  # it rolls out
        ((2.0, 3.0, -1e-9), (1.0, 1.0, 1.0), 0.0, 0.0),  # a way that is free
    ],
)
def test_the_least_resistance_tells_what_slips_out_or_tips_over(
    moves: tuple[float, ...], turns: tuple[float, ...], coupling: float, least: float
) -> None:
    whole = np.diag([*moves, *turns])
    whole[2, 4] = whole[4, 2] = coupling
    assert least_resistance(whole) == pytest.approx(least)
