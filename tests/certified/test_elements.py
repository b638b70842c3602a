"""Hexahedra: derivatives, patch test, rigid rotation, uniaxial closed forms."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_schemas import SimulateError
from sim.mechanics import LinearElastic, Ogden
from sim.mechanics._assembly import Elasticity
from sim.mechanics._element_kernels import CORNERS, OGDEN, hexahedron, stretch_energy
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import NewtonOptions, Supports
from tests.certified.blocks import assemble, press, uniaxial_stress_mpa, unit_cells

TPU = Ogden((6.279, 1.639), (1.6663, -7.136))
GEL = neo_hooke(0.1333)
FILM = LinearElastic(1500.0, 0.38)
KERNELS = {
    "mean dilatation, neo-Hooke": ("mean_dilatation", GEL),
    "mean dilatation, Ogden": ("mean_dilatation", TPU),
    "incompatible modes, Ogden": ("incompatible_modes", TPU),
    "incompatible modes, neo-Hooke": ("incompatible_modes", GEL),
    "incompatible modes, linear elastic": ("incompatible_modes", FILM),
}
each_kernel = pytest.mark.parametrize(("element", "material"), KERNELS.values(), ids=KERNELS.keys())


def evaluate(x, v, element, material, kept=1.0, held_mpa=None):
    """Energy, force and tangent, with the pressures that the displacement gives if none are held."""
    mean = element == "mean_dilatation"
    size, held = (24, 1) if mean else (33, 4 if material.law == OGDEN else 0)
    force, tangent = np.zeros(size), np.zeros((size, size))
    swelling, strain = np.zeros((held, size)), np.zeros((held, 2))
    u = v.reshape(-1, 3).copy()

    def energy(level, held):
        law, numbers = material.law, material.parameters
        return hexahedron(x, u, law, numbers, mean, held, level, kept, force, tangent, swelling, strain)

    energy(0, np.zeros(held))
    own = material.bulk_modulus_mpa * strain[:, 1]
    return energy(1, own if held_mpa is None else np.broadcast_to(held_mpa, held).copy()), force, tangent


def distorted(rng, element):
    x = 0.5 * (CORNERS + 1) + 0.08 * rng.standard_normal((8, 3))
    v = 0.1 * rng.standard_normal(24 if element == "mean_dilatation" else 33)
    v[24:] *= 0.5
    return x, v


@each_kernel
def test_force_and_tangent_are_the_derivatives(element, material):
    x, v = distorted(np.random.default_rng(0), element)
    _, force, tangent = evaluate(x, v, element, material)
    # central differences: 1e-6 mm leaves about 1e-9 of rounding and truncation
    steps = 1e-6 * np.eye(len(v))
    low = [evaluate(x, v - s, element, material) for s in steps]
    high = [evaluate(x, v + s, element, material) for s in steps]
    by_energy = np.array([h[0] - b[0] for h, b in zip(high, low, strict=True)]) / 2e-6
    by_force = np.stack([h[1] - b[1] for h, b in zip(high, low, strict=True)], 1) / 2e-6
    assert np.abs(by_energy - force).max() <= 1e-7 * np.abs(force).max()
    assert np.abs(by_force - tangent).max() <= 1e-7 * np.abs(tangent).max()


@each_kernel
def test_eliminating_the_modes_keeps_the_derivative(element, material):
    # at modes without force, the condensed tangent is the derivative of the condensed force
    mesh = unit_cells(1, 1, 1).mesh(element)
    elasticity = Elasticity(mesh, {"material": material})
    u = 0.05 * np.random.default_rng(1).standard_normal((8, 3))

    def relaxed(u):
        modes = elasticity.no_modes
        for _ in range(8):
            part = next(iter(elasticity.matrices(u, modes)))
            step = elasticity.mode_step(np.zeros_like(u))
            modes = tuple(m + d for m, d in zip(modes, step, strict=True))
        return part.force[0].copy(), part.tangent[0].copy()

    _, tangent = relaxed(u)
    columns = [(relaxed(u + s)[0] - relaxed(u - s)[0]) / 2e-6 for s in 1e-6 * np.eye(24).reshape(24, 8, 3)]
    order = elasticity.cells[0][0]
    unknowns = (3 * order[:, None] + np.arange(3)).ravel()
    found = np.stack(columns, 1)[:, unknowns]
    assert np.abs(found - tangent).max() <= 1e-7 * np.abs(tangent).max()


@each_kernel
def test_projection_takes_away_negative_curvature_only(element, material):
    x, v = distorted(np.random.default_rng(0), element)
    exact, less, projected = (evaluate(x, v, element, material, kept)[2] for kept in (1.0, 0.7, 0.0))
    scale = np.abs(exact).max()
    # a share of it, that share of the way
    np.testing.assert_allclose(less, 0.7 * exact + 0.3 * projected, atol=1e-12 * scale)
    assert np.linalg.eigvalsh(projected).min() >= -1e-12 * scale
    assert np.linalg.eigvalsh(projected - exact).min() >= -1e-12 * scale
    at_rest = [evaluate(x, 0.0 * v, element, material, kept)[2] for kept in (1.0, 0.0)]
    assert at_rest[1] == pytest.approx(at_rest[0], abs=1e-12 * scale)


def test_an_element_turned_inside_out_has_infinite_energy():
    x = 0.5 * (CORNERS + 1)
    u = np.zeros((8, 3))
    u[CORNERS[:, 1] > 0, 1] = -1.2
    assert evaluate(x, u.ravel(), "mean_dilatation", GEL)[0] == math.inf
    assert evaluate(x * [1.0, 1.0, -1.0], np.zeros(24), "mean_dilatation", GEL)[0] == math.inf


@each_kernel
def test_rigid_rotation_costs_nothing(element, material):
    mesh = unit_cells(2, 2, 2).mesh(element)
    assembly = assemble(mesh, material)
    turn = Rotation.from_rotvec([0.7, -1.9, 0.4]).as_matrix()
    state = assembly.at_rest()
    state.u_mm[:] = mesh.nodes_mm @ turn.T - mesh.nodes_mm + [5.0, -3.0, 11.0]
    stiffness = material.bulk_modulus_mpa
    # rounding of coordinates near 11 mm, in strain, times the stiffness
    assert assembly.energy(state) <= 1e-24 * stiffness
    assert np.abs(assembly.assemble(state)[0]).max() <= 1e-13 * stiffness


@each_kernel
def test_patch_of_distorted_elements_takes_uniform_strain(element, material):
    rng = np.random.default_rng(0)
    cells = unit_cells(3, 3, 3)
    x = cells.nodes_mm.copy()
    inner = ((x > 1e-9) & (x < 1 - 1e-9)).all(1)
    x[inner] += 0.06 * rng.standard_normal((inner.sum(), 3))
    strain = np.array([[0.15, 0.08, -0.05], [0.03, -0.10, 0.04], [-0.06, 0.02, 0.12]])
    fixed = np.repeat(~inner[:, None], 3, axis=1)
    assembly = assemble(cells.mesh(element, x), material)

    def loading(fraction):
        return Supports(fixed, fraction * x @ strain.T)

    reached = press(assembly, loading, options=NewtonOptions(residual_rel=1e-12))[-1]
    assert reached.state.u_mm == pytest.approx(x @ strain.T, abs=1e-13)
    # uniform stress: the energy is that of one point times the volume
    first, second, work = np.empty(3), np.empty((3, 3)), np.empty(3)
    stretch = np.linalg.svd(np.eye(3) + strain, compute_uv=False)
    psi = stretch_energy(material.law, material.parameters, stretch, first, second, work)
    psi += 0.5 * material.parameters[0] * (stretch.prod() - 1) ** 2
    assert reached.energy_n_mm == pytest.approx(psi, rel=1e-12)


@pytest.mark.parametrize("element", ["mean_dilatation", "incompatible_modes"])
@pytest.mark.parametrize("material", [TPU, GEL], ids=["Ogden", "neo-Hooke"])
@pytest.mark.parametrize("stretch", [2.0, 0.6])
def test_uniaxial_stress_of_the_closed_form(element, material, stretch):
    # the closed form is incompressible: at K/mu = 20000 compressibility changes the stress by under 0.01 %
    stiff = Ogden(material.mu_mpa, material.alpha, 20000.0)
    cells = unit_cells(1, 1, 1)
    assembly = assemble(cells.mesh(element), stiff)
    x = cells.nodes_mm
    fixed = x == 0.0
    top = x[:, 2] == 1.0
    fixed[top, 2] = True

    def loading(fraction):
        move = np.zeros_like(x)
        move[top, 2] = fraction * (stretch - 1.0)
        return Supports(fixed, move)

    # one element with modes, pressed to 0.6, is softer by 0.15 % as an hourglass: uniform stress
    # is then no least energy of it (P. Wriggers, S. Reese, Comput. Methods Appl. Mech. Eng. 135, 1996, 201)
    options = NewtonOptions(stable=element == "mean_dilatation")
    force = press(assembly, loading, np.linspace(0.1, 1.0, 10), options=options)[-1].gradient_n[top, 2].sum()
    assert force == pytest.approx(float(uniaxial_stress_mpa(stiff, np.array(stretch))), rel=1e-3)


def test_nearly_equal_stretches_take_the_limit():
    # the difference quotient and its limit meet at the switch
    x = 0.5 * (CORNERS + 1)
    tangents = []
    for gap in (0.9e-5, 1.1e-5):
        u = x * [0.1, 0.1 * (1 + gap), -0.1]
        tangents.append(evaluate(x, u.ravel(), "mean_dilatation", TPU)[2])
    # the tangents differ by the strain step of 2e-7 and 1e-10 of the limit
    assert np.abs(tangents[1] - tangents[0]).max() <= 1e-6 * np.abs(tangents[0]).max()


def test_threads_change_nothing():
    mesh = unit_cells(9, 9, 9).mesh("incompatible_modes")
    u = 0.01 * np.random.default_rng(4).standard_normal(mesh.nodes_mm.shape)
    results = []
    for threads in (1, 2):
        elasticity = Elasticity(mesh, {"material": TPU}, threads)
        parts = [(p.force.copy(), p.tangent.copy()) for p in elasticity.matrices(u, elasticity.no_modes)]
        results.append([np.concatenate(a) for a in zip(*parts, strict=True)] + [elasticity.mode_step(u)[0]])
    for one, two in zip(*results, strict=True):
        assert np.array_equal(one, two)


def test_energy_of_each_block():
    mesh = unit_cells(2, 1, 1).mesh("mean_dilatation")
    elasticity = Elasticity(mesh, {"material": GEL})
    whole = elasticity.energy(0.1 * mesh.nodes_mm, elasticity.no_modes)
    assert elasticity.energy_of_blocks() == {"block": pytest.approx(whole)}
    assert whole == pytest.approx(0.5 * GEL.bulk_modulus_mpa * (1.1**3 - 1) ** 2)


def test_materials_must_fit():
    cells = unit_cells(1, 1, 1)
    with pytest.raises(SimulateError, match="the material material, but the known materials are gel"):
        Elasticity(cells.mesh("mean_dilatation"), {"gel": GEL})
    with pytest.raises(SimulateError, match=r"block block asks for mean dilatation.*use incompatible_modes"):
        Elasticity(cells.mesh("mean_dilatation"), {"material": FILM})
