"""A closed cube of fluorescent paint that glows evenly: L = (1 - M)^-1 L_e in bands, whatever the cube's size."""

import numpy as np
import pytest

pytestmark = pytest.mark.renderer

# green paint excites red paint, so that orders of fluorescence are in it
MATRIX = np.array([[0.55, 0.12, 0.21], [0.0, 0.24, 0.0], [0.0, 0.0, 0.06]])
EMITTED = np.array([0.0, 0.1, 1.0])
SEEDS, RAYS = 8, 60_000


def furnace(matrix, max_depth=60):
    from sim.optics._fluorescent_paths import fluorescent_bands
    from tests.simulate import painted_scenes as ps

    scene = ps.painted_cavity(ps.rgb(*EMITTED))
    integrator = fluorescent_bands(scene, {"paint": matrix}, max_depth)
    return np.concatenate(
        [
            ps.traced(scene, integrator, ps.rays([0.1, -0.2, 0.3], None, numbers), numbers)
            for numbers in (ps.sampler(seed, RAYS) for seed in range(SEEDS))
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    "matrix",
    [MATRIX, np.array([[0.3, 0.0, 0.0], [0.2, 0.45, 0.30], [0.1, 0.0, 0.05]]), np.diag([0.7, 0.3, 0.1])],
    ids=["red", "green", "no fluorescence"],
)
def test_bands_equal_the_closed_form(llvm, matrix):
    """Three standard errors in each of nine numbers: a right program fails with a chance of 2.4 % over all seeds."""
    from tests.simulate.painted_scenes import estimate

    samples = furnace(matrix)
    assert np.isfinite(samples).all()
    mean, error = estimate(samples)
    exact = np.linalg.solve(np.eye(3) - matrix, EMITTED)
    assert (np.abs(mean - exact) <= 3.0 * error + 1e-12).all()
    assert (error <= 0.002 * exact + 1e-12).all()


def test_a_changed_matrix_is_noticed(llvm):
    """The test can fail: 1 % of one conversion is 20 standard errors."""
    from tests.simulate.painted_scenes import estimate

    mean, error = estimate(furnace(MATRIX * [[1.0, 1.0, 1.01], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]))
    exact = np.linalg.solve(np.eye(3) - MATRIX, EMITTED)
    assert (mean[0] - exact[0]) / error[0] > 5.0
