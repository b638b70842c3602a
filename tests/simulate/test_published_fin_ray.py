"""Short twin of benchmarks/published_fin_ray.py: the steel finger with and without ribs, against a frame of beams."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.published_fin_ray import (
    BACK_DEG,
    BASE_MM,
    FREE_BACK_MM,
    FREE_FRONT_MM,
    POISSON,
    PRESSES,
    RIBS_BACK_MM,
    RIBS_FRONT_MM,
    WIDTH_MM,
    RigidRibs,
    SteelFinger,
    press,
    steel_mesh,
)

NO_RIBS = PRESSES[2].finger


def beam_stiffness(finger: SteelFinger, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the (6, 6) matrix of a straight Euler-Bernoulli beam in the plane (y, z): y, z and turn at each end."""
    length = float(np.linalg.norm(end - start))
    (c, s), e = (end - start) / length, 1e3 * finger.youngs_modulus_gpa
    ea, ei = e * WIDTH_MM * finger.thickness_mm / length, e * WIDTH_MM * finger.thickness_mm**3 / 12.0 / length**3
    own = np.zeros((6, 6))
    own[np.ix_([0, 3], [0, 3])] = ea * np.array([[1, -1], [-1, 1]])
    bend = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
    scale = np.array([1.0, length, 1.0, length])
    own[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = ei * bend * np.outer(scale, scale)
    turn = np.kron(np.eye(2), np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
    return np.asarray(turn.T @ own @ turn)


def frame_stiffness_n_per_mm(finger: SteelFinger) -> float:
    """Return force over displacement under the cylinder of the finger without ribs, small, by three beams.

    Unknowns: place and turn of the front plate under the cylinder, and of its upper end, which carries the rigid tip
    and so the upper end of the back plate.
    """
    along = np.array([math.sin(math.radians(BACK_DEG - 90.0)), math.cos(math.radians(BACK_DEG - 90.0))])
    base, foot = np.zeros(2), np.array([-BASE_MM, 0.0])
    under, top = np.array([0.0, finger.height_mm]), np.array([0.0, FREE_FRONT_MM])
    back_top = foot + FREE_BACK_MM * along
    whole = np.zeros((6, 6))
    whole[:3, :3] += beam_stiffness(finger, base, under)[3:, 3:]
    whole += beam_stiffness(finger, under, top)
    arm = back_top - top
    carried = np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]], [0.0, 0.0, 1.0]])
    whole[3:, 3:] += carried.T @ beam_stiffness(finger, foot, back_top)[3:, 3:] @ carried
    return float(1.0 / np.linalg.inv(whole)[0, 0])


def test_the_ribs_derivatives_agree_with_finite_differences() -> None:
    random = np.random.default_rng(3)
    nodes, pairs = random.uniform(-10.0, 10.0, (6, 3)), np.array([[0, 1], [2, 4], [4, 5]])
    ribs, u, step = RigidRibs(nodes, pairs), random.normal(0.0, 0.5, (6, 3)), 1e-6
    slopes = np.zeros((18, 19))
    for k, direction in enumerate(np.eye(18).reshape(18, 6, 3)):
        ends = u + step * direction, u - step * direction
        slopes[k, 0] = (ribs.energy(ends[0]) - ribs.energy(ends[1])) / (2.0 * step)
        slopes[k, 1:] = ((ribs.gradient(ends[0]) - ribs.gradient(ends[1])) / (2.0 * step)).ravel()
    gradient = ribs.gradient(u).ravel()
    # central differences at 1e-6 mm of energies near 1e4 N mm: rounding of about 1e-6 N against thousands
    assert slopes[:, 0] == pytest.approx(gradient, abs=1e-8 * np.abs(gradient).max() + 1e-3)
    matrix = ribs.hessian(u, project=False).toarray()
    assert np.abs(slopes[:, 1:] - matrix).max() < 1e-7 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(ribs.hessian(u, project=True).toarray()).min() > -1e-9 * np.abs(matrix).max()


@pytest.mark.parametrize("offset_mm", [0.0, 4.0])
def test_ribs_join_the_hinges_that_the_source_gives(offset_mm: float) -> None:
    finger = SteelFinger(hinge_offset_mm=offset_mm)
    mesh, pairs = steel_mesh(finger, across=1)
    assert len(pairs) == 2 * len(RIBS_FRONT_MM)
    back, front = mesh.nodes_mm[pairs[:4, 0]], mesh.nodes_mm[pairs[:4, 1]]
    assert front[:, 2] == pytest.approx(RIBS_FRONT_MM)
    assert front[:, 1] == pytest.approx(-offset_mm if offset_mm else 0.0, abs=finger.thickness_mm + 1e-9)
    from_base = np.linalg.norm(back[:, 1:] - [-BASE_MM, 0.0], axis=1)
    # the hinge lies on the plate's inner face, its length is given along the outer one
    assert from_base == pytest.approx(RIBS_BACK_MM, abs=finger.thickness_mm)


def test_a_small_push_without_ribs_meets_the_stiffness_of_a_frame_of_beams() -> None:
    depth = 0.5
    pressed = press(NO_RIBS, (depth,), step_mm=4.0, across=2)
    of_beams = frame_stiffness_n_per_mm(NO_RIBS) * depth
    # a plate is stiffer than its beam, at most by 1 / (1 - nu^2) where it cannot bend across; 3 % for the finite push,
    # the mesh and the cylinder that sinks in by micrometres
    assert 0.97 * of_beams < np.linalg.norm(pressed.force_n) < 1.03 * of_beams / (1.0 - POISSON**2)


def test_the_finger_without_ribs_is_as_stiff_as_measured() -> None:
    case = PRESSES[2]
    force = np.linalg.norm(press(case.finger, case.at_mm[:2], step_mm=6.0, across=1).force_n, axis=1)
    runs = np.array(case.measured_n)[:, :2]
    # the plate's thickness, known to 5 %, makes 15 % of the force
    assert np.all((force > 0.85 * runs.min(axis=0)) & (force < 1.15 * runs.max(axis=0)))


def test_ribs_keep_their_length_and_friction_turns_the_force_as_measured() -> None:
    case = PRESSES[0]
    free, rough = (press(replace(case.finger, friction=mu), (10.0,), step_mm=6.0, across=1) for mu in (0.0, 0.4))
    assert 0.0 < rough.rib_stretch_mm < 0.01
    angle = [np.degrees(np.arctan2(p.force_n[0, 2], p.force_n[0, 1])) for p in (free, rough)]
    # measured at 10 mm: -10 and -13 deg, towards the base; full slip would turn it by atan 0.4 = 22 deg
    assert angle[1] < np.mean(case.measured_deg, axis=0)[1] < angle[0]
    assert 0.0 < angle[0] - angle[1] < 22.5
