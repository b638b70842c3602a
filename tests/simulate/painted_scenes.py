"""Paints in photons, painted scenes of the renderer, and rays sent into them without a camera."""

import drjit as dr
import mitsuba as mi
import numpy as np

from tests.simulate.spectral_paths import FluorescentPaint

WAVELENGTH_NM = np.arange(380.0, 781.0, 1.0)
QUANTUM_YIELD = 0.55
LED_PER_NM = np.exp(-0.5 * ((WAVELENGTH_NM - 450.0) / 8.5) ** 2)
LED_PER_NM /= np.trapezoid(LED_PER_NM, WAVELENGTH_NM)


def skew_cauchy(location_nm, scale_nm, skewness):
    x = (WAVELENGTH_NM - location_nm) / scale_nm
    return (np.arctan(skewness * x) / np.pi + 0.5) / (1.0 + x * x)


PHOTON_EMISSION_PER_NM = {"red": skew_cauchy(596.0, 16.0, 2.5), "green": skew_cauchy(508.0, 13.0, 2.5)}
PHOTON_EMISSION_PER_NM = {k: v / np.trapezoid(v, WAVELENGTH_NM) for k, v in PHOTON_EMISSION_PER_NM.items()}
REFLECTANCE = {
    "red": 0.04 + 0.69 / (1.0 + np.exp(-(WAVELENGTH_NM - 605.0) / 14.0)),
    "green": 0.06 + 0.25 * np.exp(-0.5 * ((WAVELENGTH_NM - 530.0) / 35.0) ** 2),
}


def absorptance(name):
    shape = skew_cauchy(*{"red": (500.0, 45.0, -1.0), "green": (462.0, 28.0, -1.0)}[name])
    return np.minimum(0.8 * shape / shape.max(), 0.999 - REFLECTANCE[name])


def fluorescent_paint(name):
    """Return a paint of known quantum yield: F(lo, li) = n(lo) / lo * Q a(li) li."""
    return FluorescentPaint(
        name,
        WAVELENGTH_NM,
        PHOTON_EMISSION_PER_NM[name] / WAVELENGTH_NM,
        QUANTUM_YIELD * absorptance(name) * WAVELENGTH_NM,
        REFLECTANCE[name],
    )


def rgb(*values):
    return {"type": "rgb", "value": list(values)}


def spectrum(values, wavelength_nm=WAVELENGTH_NM):
    """Return a spectrum that is zero outside its wavelengths, as lights are."""
    return {
        "type": "irregular",
        "wavelengths": ", ".join(f"{w:.9g}" for w in wavelength_nm),
        "values": ", ".join(f"{v:.9g}" for v in values),
    }


def painted_cavity(radiance):
    """Return a closed cube of BSDF "paint" that glows evenly; a cube, because the sphere's facets lose 0.3 %."""
    wall = {"type": "diffuse", "reflectance": 0.5, "id": "paint"}
    cube = {"type": "cube", "flip_normals": True, "bsdf": wall, "emitter": {"type": "area", "radiance": radiance}}
    return mi.load_dict({"type": "scene", "cube": cube})


def sampler(seed, count):
    made = mi.load_dict({"type": "independent"})
    made.seed(seed, count)
    return made


def rays(origin, direction, numbers, wavelengths=None):
    """Return rays of one set of wavelengths; `direction` None draws them over the sphere."""
    if direction is None:
        direction = mi.warp.square_to_uniform_sphere(numbers.next_2d())
    made = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
    if wavelengths is not None:
        made.wavelengths = mi.Spectrum(*[w if isinstance(w, mi.Float) else float(w) for w in wavelengths])
    return made


def traced(scene, integrator, ray, numbers):
    """Return radiance (channels, rays) as float64."""
    radiance, _, further = integrator.sample(scene, numbers, ray, None, mi.Bool(True))
    dr.eval(radiance)
    assert not further
    return radiance.numpy().astype(np.float64)


def estimate(values):
    """Return mean and standard error of samples (channels, n)."""
    return values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(values.shape[1])


def furnace_radiance_per_nm(paint, wavelength_nm, source_per_nm):
    """Return the radiance in a closed cavity of paint that also glows evenly: L = (S + em A) / (1 - rho).

    A = integral of ex L = integral(ex S / (1 - rho)) / (1 - integral(ex em / (1 - rho))), which solves
    L = S + rho L + em integral(ex L) for any shape of the cavity.
    """
    emission, excitation, reflectance = paint.at(wavelength_nm)
    left = 1.0 - reflectance
    gain = np.trapezoid(excitation * emission / left, wavelength_nm)
    absorbed = np.trapezoid(excitation * source_per_nm / left, wavelength_nm) / (1.0 - gain)
    return np.asarray((source_per_nm + emission * absorbed) / left)
