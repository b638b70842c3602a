r"""A paint as a slab that absorbs, scatters and fluoresces, by transport of photons between thin slices.

The truth behind benchmarks of the fit, which knows nothing of layers. Photons fly straight until they collide; between
slices of a homogeneous slab the probability of the first collision follows from the exponential integral E3 (isotropic
emission and scattering), not from the two fluxes of Kubelka and Munk:

.. math:: P_{ij} = \frac{E_3(g) - E_3(g + \tau_i) - E_3(g + \tau_j) + E_3(g + \tau_i + \tau_j)}{2 \tau_i}

with tau the optical thickness of a slice and g that of what lies between. Collisions absorb or scatter; what the dye
absorbs it emits again with its quantum yield, wherever it comes from, so that light which the paint absorbs again is
followed to the end. Base and inside of the surface reflect diffusely.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import expn

Floats = NDArray[np.float64]
NM: Floats = np.arange(360.0, 801.0, 5.0)
SLICES = 32  # thin ones at the surface: the source is flat within a slice
LAST_MAXIMUM_REL = 0.3


@dataclass(frozen=True)
class Layer:
    """What is drawn of a paint beside its dye; thicknesses are optical ones of the whole slab."""

    scattering: float
    scattering_slope: float
    dye: float
    base: float
    backing: float
    quantum_yield: float
    outside: float
    inside: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Layer":
        """Return a layer from thin to saturated, on black to white, matt or glossy."""
        glossy = rng.random() < 0.5
        return cls(
            scattering=float(np.exp(rng.normal(np.log(8.0), 0.8))),
            scattering_slope=float(rng.uniform(0.0, 2.0)),
            dye=float(np.exp(rng.normal(np.log(6.0), 1.0))),
            base=float(np.exp(rng.normal(np.log(0.1), 0.8))),
            backing=float(rng.uniform(0.1, 0.95)),
            quantum_yield=float(rng.uniform(0.2, 0.95)),
            outside=0.04 if glossy else 0.0,
            inside=0.55 if glossy else 0.0,
        )


@dataclass(frozen=True)
class Paint:
    """Re-radiation and reflectance of a layer on :data:`NM`.

    Attributes
    ----------
    matrix_per_nm
        (M, X) energy emitted per nm at M over energy incident at X.
    reflectance
        (X,) reflected elastically.
    """

    matrix_per_nm: Floats
    reflectance: Floats


def transport(optical: float, albedo: float, backing: float, inside: float) -> tuple[Floats, Floats, Floats]:
    """Return what becomes of photons of one wavelength.

    Returns
    -------
    tuple
        (N, N + 2) expected collisions in each slice, then hits of backing and surface, of photons that start
        isotropically in each slice; (N + 2,) the same of diffuse light that enters; (N + 2,) shares of what leaves, of
        photons from each slice and, last, of light that enters.
    """
    n, edges = SLICES, optical * (np.arange(SLICES + 1) / SLICES) ** 2
    tau = np.diff(edges)
    e3 = expn(3, np.abs(edges[:, None] - edges))
    flights = np.zeros((n + 2, n + 2))  # slices, backing (emits up), surface (emits down)
    apart = e3[:-1, :-1] - e3[1:, :-1] - e3[:-1, 1:] + e3[1:, 1:]
    flights[:n, :n] = np.abs(apart) / (2 * tau[:, None])
    flights[np.arange(n), np.arange(n)] = 1 - (0.5 - np.diag(e3, 1)) / tau
    flights[:n, n] = (e3[1:, n] - e3[:-1, n]) / (2 * tau)
    flights[:n, n + 1] = (e3[:-1, 0] - e3[1:, 0]) / (2 * tau)
    flights[n, :n], flights[n + 1, :n] = 2 * tau * flights[:n, n] * 2, 2 * tau * flights[:n, n + 1] * 2
    flights[n, n + 1] = flights[n + 1, n] = 2 * e3[0, n]
    goes_on = np.concatenate([np.full(n, albedo), [backing, inside]])
    visits = np.linalg.solve(np.eye(n + 2) - flights * goes_on, flights)  # expected arrivals after any start
    leaves = visits[:, n + 1] * (1 - inside)
    return visits[:n], visits[n + 1], np.append(leaves[:n], leaves[n + 1])


def paint(layer: Layer, absorbed: Floats, emitted: Floats) -> Paint:
    """Return re-radiation and reflectance of a layer.

    Parameters
    ----------
    layer
        What holds the dye.
    absorbed
        (L,) absorption of the dye on :data:`NM`, maximum 1.
    emitted
        (L,) its emission in energy per nm, any height.
    """
    dye = layer.dye * absorbed
    scattering = layer.scattering * (NM / 550.0) ** -layer.scattering_slope
    base = layer.base * (NM / 550.0) ** -2.0
    total = dye + scattering + base
    photons = emitted * NM
    photons = photons / np.trapezoid(photons, NM)
    moved = [transport(t, s / t, layer.backing, layer.inside) for t, s in zip(total, scattering, strict=True)]
    by_dye = (dye / total)[:, None]
    reflectance = layer.outside + (1 - layer.outside) * np.array([m[2][-1] for m in moved])
    first = (1 - layer.outside) * np.array([m[1][:SLICES] for m in moved]) * by_dye  # (X, N)
    again = np.array([m[0][:, :SLICES] for m in moved]) * by_dye[:, :, None]  # (M, N, N)
    out = np.array([m[2][:-1] for m in moved])  # (M, N)
    step = np.gradient(NM)
    back = layer.quantum_yield * np.einsum("m,mij->ij", photons * step, again)
    source = layer.quantum_yield * first @ np.linalg.inv(np.eye(SLICES) - back)
    matrix = photons[:, None] * (out @ source.T) * (NM[None, :] / NM[:, None])
    return Paint(np.where(NM[:, None] > NM[None, :], matrix, 0.0), reflectance)


def stokes_shifts_nm(nm: Floats, excitation: Floats, emission: Floats) -> tuple[float, float]:
    """Return emission mode minus last absorption maximum (of at least 0.3 of the largest), and minus the largest."""
    fine = np.arange(nm[0], nm[-1] + 0.5, 1.0)
    absorbed, emitted = (np.maximum(PchipInterpolator(nm, c)(fine), 0.0) for c in (excitation, emission))
    mode = float(fine[emitted.argmax()])
    top = absorbed.max()
    inner = (absorbed[1:-1] >= absorbed[:-2]) & (absorbed[1:-1] > absorbed[2:]) & (fine[1:-1] < mode)
    tops = fine[1:-1][inner & (absorbed[1:-1] >= LAST_MAXIMUM_REL * top)]
    largest = float(fine[absorbed.argmax()])
    return mode - (float(tops[-1]) if tops.size else largest), mode - largest
