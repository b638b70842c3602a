"""Photons of fluorescence, counted one by one forwards from the lamp, against the integrator that works backwards.

The count follows whole photons: each has one wavelength, is reflected, absorbed or (by the paint's quantum yield)
emitted again, by its own random numbers, with the renderer's geometry only. It knows no throughput, no matrix F and no
weight of the integrators.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from data_schemas import SimulateError
from tests.simulate.spectral_paths import FluorescentPaint

pytestmark = pytest.mark.renderer

GREY = 0.5
HALF_PLATE = 0.8
PHOTONS = 300_000
RAYS = 120_000
LAMP_HALF = 0.3
# plates face each other: green emission reaches the red plate, and the other way round
WALLS = {"red": ((-0.9, 0.0, 0.0), (0, 1, 0), 90.0), "green": ((0.9, 0.0, 0.0), (0, 1, 0), -90.0)}


def room():
    """Return a grey cube with two painted plates on opposite sides and a lamp at the ceiling that shines down."""
    import mitsuba as mi

    from tests.simulate import painted_scenes as ps

    grey = {"type": "diffuse", "reflectance": GREY}
    scene = {"type": "scene", "cube": {"type": "cube", "flip_normals": True, "bsdf": grey}}
    for k, (name, (centre, axis, degrees)) in enumerate(WALLS.items()):
        place = mi.ScalarTransform4f().translate(centre).rotate(axis, degrees).scale(HALF_PLATE)
        # the renderer makes equal BSDFs one, whatever their ids; the paint's table replaces this reflectance
        bsdf = {"type": "diffuse", "reflectance": 0.1 + 0.1 * k, "id": name}
        scene[f"plate {name}"] = {"type": "rectangle", "to_world": place, "bsdf": bsdf}
    down = mi.ScalarTransform4f().translate([0, 0, 0.95]).rotate([1, 0, 0], 180).scale(LAMP_HALF)
    scene["lamp panel"] = {
        "type": "rectangle",
        "to_world": down,
        "bsdf": {"type": "diffuse", "reflectance": 0.0, "id": "lamp"},
        "emitter": {"type": "area", "radiance": ps.spectrum(ps.LED_PER_NM)},
    }
    return mi.load_dict(scene)


@dataclass
class Count:
    """Photons at each plate: absorbed by the dye, emitted by it, and the wavelengths of the emitted ones."""

    absorbed: dict[str, int]
    emitted: dict[str, int]
    emitted_nm: dict[str, list]


def counted(scene, rng, photons=PHOTONS):
    """Follow photons from the lamp until each is lost; nothing is weighted."""
    import mitsuba as mi

    from tests.simulate import painted_scenes as ps

    def drawn(density, size):
        cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0)])
        return np.interp(rng.random(size), cumulative / cumulative[-1], ps.WAVELENGTH_NM)

    wavelength = drawn(ps.LED_PER_NM * ps.WAVELENGTH_NM, photons)
    corner = rng.uniform(-LAMP_HALF, LAMP_HALF, (2, photons))
    position = np.array([corner[0], corner[1], np.full(photons, 0.95)])
    normal = np.tile([[0.0], [0.0], [-1.0]], photons)
    count = Count(dict.fromkeys(WALLS, 0), dict.fromkeys(WALLS, 0), {name: [] for name in WALLS})
    bsdfs = {shape.bsdf().id(): mi.BSDFPtr(shape.bsdf()) for shape in scene.shapes()}
    while wavelength.size:
        ray = mi.Ray3f(
            mi.Point3f(*(position + 1e-5 * normal).astype(np.float32)),
            mi.Vector3f(*lambertian(normal, rng).astype(np.float32)),
        )
        si = scene.ray_intersect(ray)
        position, normal = si.p.numpy().astype(float), si.n.numpy().astype(float)
        bsdf = si.bsdf()
        chance = rng.random(wavelength.size)
        front = (si.wi.z > 0).numpy()
        stays = chance < GREY
        for name in WALLS:
            here = front & (bsdf == bsdfs[name]).numpy()
            reflected = np.interp(wavelength, ps.WAVELENGTH_NM, ps.REFLECTANCE[name])
            into_dye = reflected + np.interp(wavelength, ps.WAVELENGTH_NM, ps.absorptance(name))
            absorbed = here & (chance >= reflected) & (chance < into_dye)
            emitted = absorbed & (rng.random(wavelength.size) < ps.QUANTUM_YIELD)
            wavelength[emitted] = drawn(ps.PHOTON_EMISSION_PER_NM[name], int(emitted.sum()))
            count.absorbed[name] += int(absorbed.sum())
            count.emitted[name] += int(emitted.sum())
            count.emitted_nm[name].append(wavelength[emitted])
            stays = np.where(here, (chance < reflected) | emitted, stays)
        stays &= front & ~(bsdf == bsdfs["lamp"]).numpy() & si.is_valid().numpy()
        position, normal, wavelength = position[:, stays], normal[:, stays], wavelength[stays]
    return count


def lambertian(normal, rng):
    """Return directions with the density cos / pi about the normals: a unit vector on the sphere on top of each."""
    z, turn = rng.uniform(-1.0, 1.0, normal.shape[1]), rng.uniform(0.0, 2.0 * np.pi, normal.shape[1])
    r = np.sqrt(1.0 - z * z)
    direction = normal + np.array([r * np.cos(turn), r * np.sin(turn), z])
    return direction / np.linalg.norm(direction, axis=0)


def plate_photons(scene, paints, name, density, value, arriving, seed):
    """Return photons at a plate per photon of the lamp and their standard error, by the integrator under test.

    The integral over wavelength of `value` times the photons per nm that arrive at the plate, or leave it. Each ray
    has its own four wavelengths, drawn from `density`.
    """
    import mitsuba as mi

    from tests.simulate import painted_scenes as ps
    from tests.simulate.spectral_paths import fluorescent_spectrum

    integrator = fluorescent_spectrum(scene, paints, ps.WAVELENGTH_NM, ps.LED_PER_NM, max_depth=60)
    numbers, rng = ps.sampler(seed, RAYS), np.random.default_rng(seed)
    wavelength = inverted(density, rng.random((4, RAYS)))
    probability_per_nm = np.interp(wavelength, ps.WAVELENGTH_NM, density)
    (x, _, _), _, _ = WALLS[name]
    at, spread = numbers.next_2d(), mi.warp.square_to_cosine_hemisphere(numbers.next_2d())
    away = mi.Vector3f(-np.sign(x) * spread.z, spread.x, spread.y)
    point = mi.Point3f(x, (2 * at.x - 1) * HALF_PLATE, (2 * at.y - 1) * HALF_PLATE) + 1e-4 * away
    ray = ps.rays(point, away if arriving else -away, numbers, [mi.Float(w.astype(np.float32)) for w in wavelength])
    radiance = ps.traced(scene, integrator, ray, numbers)
    lamp = np.trapezoid(ps.LED_PER_NM * ps.WAVELENGTH_NM, ps.WAVELENGTH_NM) * (2.0 * LAMP_HALF) ** 2
    photons = (2.0 * HALF_PLATE) ** 2 * wavelength / lamp * np.interp(wavelength, ps.WAVELENGTH_NM, value)
    mean, error = ps.estimate((radiance * photons / probability_per_nm).mean(axis=0, keepdims=True))
    return float(mean[0]), float(error[0])


def inverted(density_per_nm, uniform):
    """Return wavelengths with a density that is linear within each nanometre, by inverting its integral finely."""
    from tests.simulate import painted_scenes as ps

    fine = np.linspace(ps.WAVELENGTH_NM[0], ps.WAVELENGTH_NM[-1], 40_001)
    density = np.interp(fine, ps.WAVELENGTH_NM, density_per_nm)
    cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0)])
    return np.interp(uniform * cumulative[-1], cumulative, fine)


def normalised(density):
    from tests.simulate import painted_scenes as ps

    return density / np.trapezoid(density, ps.WAVELENGTH_NM)


def test_photons_of_the_paint_are_neither_made_nor_lost(spectral):
    """Emitted over absorbed is the quantum yield, and count and integrator agree on both numbers at both plates.

    Six comparisons at four standard errors: a right program fails with a chance of 0.04 %.
    """
    from tests.simulate import painted_scenes as ps

    scene = room()
    paints = {name: ps.fluorescent_paint(name) for name in WALLS}
    count = counted(scene, np.random.default_rng(11))
    for seed, name in enumerate(WALLS):
        absorbed, emitted = count.absorbed[name], count.emitted[name]
        assert emitted <= absorbed
        spread = np.sqrt(absorbed * ps.QUANTUM_YIELD * (1.0 - ps.QUANTUM_YIELD))
        assert abs(emitted - ps.QUANTUM_YIELD * absorbed) < 4.0 * spread

        dye = ps.absorptance(name)
        where_light_is = 0.6 * ps.LED_PER_NM + 0.4 * normalised(dye)
        ours, error = plate_photons(scene, paints, name, where_light_is, dye, True, 10 * seed)
        agrees(ours, error, absorbed)

        emission, everywhere = ps.PHOTON_EMISSION_PER_NM[name], np.ones(ps.WAVELENGTH_NM.size)
        # what leaves the plate in the LED's band was reflected, not emitted: both terms hold it, and it cancels
        leaving, error_leaving = plate_photons(
            scene, paints, name, spread_out(emission), everywhere, False, 10 * seed + 1
        )
        reflected, error_reflected = plate_photons(
            scene, paints, name, spread_out(emission), ps.REFLECTANCE[name], True, 10 * seed + 2
        )
        agrees(leaving - reflected, np.hypot(error_leaving, error_reflected), emitted)


def spread_out(emission_per_nm):
    from tests.simulate import painted_scenes as ps

    return 0.5 * emission_per_nm + 0.3 * normalised(np.ones(ps.WAVELENGTH_NM.size)) + 0.2 * ps.LED_PER_NM


def agrees(ours, error, photons):
    """Compare the integrator's photons with a count; the count of a Poisson process has the variance of its mean."""
    assert abs(ours - photons / PHOTONS) < 4.0 * np.hypot(error, np.sqrt(photons) / PHOTONS)
    assert error < 0.02 * ours


def test_a_paint_that_makes_photons_is_refused():
    w = np.array([400.0, 450.0, 600.0, 700.0])
    with pytest.raises(SimulateError, match=r"paint red returns 2\.120 photons per photon at 450 nm"):
        FluorescentPaint("red", w, np.array([0.0, 0.0, 0.01, 0.0]), np.array([0.0, 1.0, 0.0, 0.0]), np.full(4, 0.5))
