"""The reference integrators on scenes with known answers: Mitsuba's own box, a disk over a plane, a white furnace."""

import numpy as np
import pytest

from tests.simulate.z_test import z_test

pytestmark = pytest.mark.renderer

RUNS = 16


def cornell_box(columns=32, rows=24, light=None):
    """Return Mitsuba's box without a reconstruction filter, so that pixels are independent."""
    import mitsuba as mi

    box = mi.cornell_box()
    box["sensor"]["film"].update(width=columns, height=rows, rfilter={"type": "box"})
    if light is not None:
        box["light"]["emitter"]["radiance"]["value"] = list(light)
    return mi.load_dict(box)


def renders(scene, integrator, seeds, samples_per_pixel):
    import mitsuba as mi

    return np.array(
        [mi.render(scene, integrator=integrator, seed=s, spp=samples_per_pixel).numpy() for s in seeds], dtype=float
    )


def assert_equal_images(ours, stock):
    """No pixel and no channel differs; Holm keeps the chance of a false alarm under 0.1 %."""
    result = z_test(ours, stock.mean(axis=0), stock.var(axis=0, ddof=1) / len(stock), len(stock))
    assert result.rejected == 0
    # the noise is judged rightly: where there is light the scores have the spread of one (1700 of them: +- 0.02, the
    # three channels of a pixel being much alike +- 0.03)
    assert 0.9 < result.z[stock.var(axis=0) > 0.0].std() < 1.1
    assert (stock.std(axis=0, ddof=1).mean() / np.sqrt(len(stock))) < 0.05 * stock.mean()


def test_the_box_without_paint_is_that_of_the_stock_tracer(llvm):
    from sim.optics._fluorescent_paths import fluorescent_bands

    scene = cornell_box()
    stock = llvm.load_dict({"type": "path", "max_depth": 12, "rr_depth": 6})
    ours = fluorescent_bands(scene, {}, max_depth=12)
    assert_equal_images(renders(scene, ours, range(RUNS), 64), renders(scene, stock, range(100, 100 + RUNS), 64))


def test_paint_that_only_reflects_is_the_surface_it_replaces(llvm):
    from sim.optics._fluorescent_paths import fluorescent_bands

    scene = cornell_box()
    stock = llvm.load_dict({"type": "path", "max_depth": 12, "rr_depth": 6})
    walls = {"red": [0.570068, 0.0430135, 0.0443706], "green": [0.105421, 0.37798, 0.076425]}
    ours = fluorescent_bands(scene, {name: np.diag(values) for name, values in walls.items()}, max_depth=12)
    assert_equal_images(renders(scene, ours, range(RUNS), 64), renders(scene, stock, range(100, 100 + RUNS), 64))


def test_the_box_without_paint_in_full_spectra(spectral):
    from tests.simulate.spectral_paths import fluorescent_spectrum

    scene = cornell_box()
    stock = spectral.load_dict({"type": "path", "max_depth": 12, "rr_depth": 6})
    ours = fluorescent_spectrum(scene, {}, np.array([400.0, 700.0]), np.ones(2), max_depth=12)
    assert_equal_images(renders(scene, ours, range(RUNS), 64), renders(scene, stock, range(100, 100 + RUNS), 64))


@pytest.mark.parametrize("painted", [False, True])
def test_a_disk_lights_a_plane_as_in_the_closed_form(llvm, painted):
    """E = pi L R^2 / (R^2 + h^2) below the centre of a coaxial disk; radiance = M E / pi. Three standard errors."""
    import mitsuba as mi

    from sim.optics._fluorescent_paths import fluorescent_bands
    from tests.simulate import painted_scenes as ps

    matrix = np.array([[0.5, 0.1, 0.2], [0.0, 0.4, 0.1], [0.0, 0.0, 0.3]]) if painted else np.diag([0.5, 0.4, 0.3])
    radius, height, light = 2.0, 3.0, np.array([1.0, 2.0, 4.0])
    down = mi.ScalarTransform4f().translate([0, 0, height]).rotate([1, 0, 0], 180).scale(radius)
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale(50.0),
                "bsdf": {"type": "diffuse", "id": "plane", "reflectance": ps.rgb(0.5, 0.4, 0.3)},
            },
            "disk": {
                "type": "disk",
                "to_world": down,
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "area", "radiance": ps.rgb(*light)},
            },
        }
    )
    integrator = fluorescent_bands(scene, {"plane": matrix} if painted else {})
    numbers = ps.sampler(3, 200_000)
    ray = ps.rays([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], numbers)
    mean, error = ps.estimate(ps.traced(scene, integrator, ray, numbers))
    exact = matrix @ light * radius**2 / (radius**2 + height**2)
    assert (np.abs(mean - exact) <= 3.0 * error).all()
    assert (error < 2e-3 * exact).all()


def test_glass_and_paint_vanish_in_a_white_furnace(llvm):
    """Where every surface returns all it gets, radiance is one everywhere, also through glass (n^2 cancels).

    Depth 400 cuts less than 1e-4 of the light (below the standard error asked for).
    """
    import drjit as dr
    import mitsuba as mi

    from sim.optics._fluorescent_paths import fluorescent_bands
    from tests.simulate import painted_scenes as ps

    scene = mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "constant", "radiance": ps.rgb(1.0, 1.0, 1.0)},
            "glass": {"type": "cube", "bsdf": {"type": "dielectric", "int_ior": 1.41, "ext_ior": 1.0}},
            "body": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().rotate([1, 1, 0], 30).scale(0.4),
                "bsdf": {"type": "diffuse", "id": "paint"},
            },
        }
    )
    white = np.array([[0.6, 0.1, 0.3], [0.3, 0.5, 0.2], [0.1, 0.4, 0.5]])
    assert np.allclose([white.sum(axis=0), white.sum(axis=1)], 1.0)
    integrator = fluorescent_bands(scene, {"paint": white}, max_depth=400, roulette_depth=50)
    numbers = ps.sampler(4, 20_000)
    spread = 0.3 * mi.warp.square_to_uniform_disk(numbers.next_2d())
    ray = ps.rays([0.2, 0.1, -3.0], dr.normalize(mi.Vector3f(spread.x, spread.y, 1.0)), numbers)
    mean, error = ps.estimate(ps.traced(scene, integrator, ray, numbers))
    assert (np.abs(mean - 1.0) <= 3.0 * error + 1e-4).all()
    assert (error < 0.01).all()
