"""A rigid body pressed into a flat elastic layer that is bonded to a rigid plane: the gel of a classic sensor.

Small strains, no friction, no sides: what a layer sinks under a pressure p is a convolution, u(k) = G(k) p(k) by
wavelength, and contact is the pressure p >= 0 for which no part of the layer reaches into the body.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2, rfftfreq

from data_schemas import SimulateError

Floats = NDArray[np.float64]

#: Free layer beside the grid, in thicknesses, where a pressure's trace falls by e^-6; a thick layer, whose trace falls
#: with distance as a half-space's does, gets at most so many sizes of the grid.
_MARGIN, _LARGEST_MARGIN = 3.0, 2.0
#: Beyond this k h the layer is a half-space to all digits.
_HALF_SPACE: Final = 20.0
#: Of the deepest place: rms by which touching parts of layer and body still differ.
_TOLERANCE: Final = 1e-4
_MOST_STEPS: Final = 1000
_TINY: Final = float(np.finfo(float).tiny)


@dataclass(frozen=True, slots=True)
class PressedLayer:
    """A layer with a body in it.

    Attributes
    ----------
    sunk_mm
        How far the face has moved towards the base, (nx, nz); below zero where it bulges.
    pressure_rel
        Contact pressure over the shear modulus, (nx, nz); above zero where body and layer touch.
    force_mm2
        Normal force over the shear modulus.
    """

    sunk_mm: Floats
    pressure_rel: Floats
    force_mm2: float


def layer_compliance(k_per_mm: Floats, thickness_mm: float, poisson_ratio: float) -> Floats:
    """Return how far, in mm, a layer sinks under a pressure of one wavelength and one shear modulus.

    With s = k h: G = (1 - nu) / k [(3 - 4 nu) sinh 2s - 2s] / [(3 - 4 nu) cosh 2s + 2 s^2 + 5 - 12 nu + 8 nu^2], the
    Navier equations with a face free of shear and a bonded base. For k h above 20 it is the half-space's (1 - nu) / k;
    at k = 0 it is h (1 - 2 nu) / (2 - 2 nu), the layer that cannot move sideways.

    Parameters
    ----------
    k_per_mm
        Wavenumbers, 2 pi over the wavelength; any shape.
    thickness_mm, poisson_ratio
        Of the layer.

    Returns
    -------
    array
        mm, of the shape of ``k_per_mm``.

    Notes
    -----
    Plane strain, with sin k x in one direction, holds for any direction: the layer is isotropic.
    """
    nu, s = poisson_ratio, np.minimum(k_per_mm * thickness_mm, _HALF_SPACE)
    upper = (3.0 - 4.0 * nu) * np.sinh(2.0 * s) - 2.0 * s
    lower = (3.0 - 4.0 * nu) * np.cosh(2.0 * s) + 2.0 * s**2 + 5.0 - 12.0 * nu + 8.0 * nu**2
    confined = thickness_mm * (1.0 - 2.0 * nu) / (2.0 - 2.0 * nu)
    found = np.divide((1.0 - nu) * upper, k_per_mm * lower, out=np.full_like(k_per_mm, confined), where=k_per_mm > 0.0)
    return np.where(k_per_mm * thickness_mm > _HALF_SPACE, (1.0 - nu) / np.maximum(k_per_mm, 1e-300), found)


def press_layer(
    wanted_mm: Floats, x_mm: Floats, z_mm: Floats, thickness_mm: float, poisson_ratio: float
) -> PressedLayer:
    """Return a layer with a rigid body in it.

    The pressure p >= 0 is that with u >= wanted everywhere and u = wanted where p > 0, by conjugate gradients whose
    directions begin anew when the contact changes (Polonsky and Keer, Wear 231, 1999), on a periodic grid with free
    layer beside the pad.

    Parameters
    ----------
    wanted_mm
        How far below the undeformed face the body reaches at each place, (nx, nz); -inf where there is no body.
    x_mm, z_mm
        Places (nx,) and (nz,), evenly spaced.
    thickness_mm, poisson_ratio
        Of the layer.

    Raises
    ------
    SimulateError
        Contact was not found, which points to a body of needles finer than the grid.
    """
    steps = tuple(float(grid[1] - grid[0]) for grid in (x_mm, z_mm))
    extent = max(step * size for size, step in zip(wanted_mm.shape, steps, strict=True))
    margin = min(_MARGIN * thickness_mm, _LARGEST_MARGIN * extent)
    shape = tuple(
        next_fast_len(size + int(np.ceil(margin / step)), real=True)
        for size, step in zip(wanted_mm.shape, steps, strict=True)
    )
    kx, kz = 2.0 * np.pi * np.fft.fftfreq(shape[0], steps[0]), 2.0 * np.pi * rfftfreq(shape[1], steps[1])
    compliance = layer_compliance(np.hypot(kx[:, None], kz[None, :]), thickness_mm, poisson_ratio)

    def sunk(pressure: Floats) -> Floats:
        return np.asarray(irfft2(rfft2(pressure) * compliance, s=shape))

    wanted = np.full(shape, -np.inf)
    wanted[: wanted_mm.shape[0], : wanted_mm.shape[1]] = wanted_mm
    pressure = _contact_pressure(wanted, sunk, thickness_mm, max(steps))
    cut = np.s_[: wanted_mm.shape[0], : wanted_mm.shape[1]]
    return PressedLayer(sunk(pressure)[cut], pressure[cut], float(pressure.sum() * steps[0] * steps[1]))


def _contact_pressure(wanted: Floats, sunk: Callable[[Floats], Floats], thickness_mm: float, step_mm: float) -> Floats:
    """Return the pressure under which the layer follows the body where they touch, over the shear modulus."""
    deepest = float(wanted.max())
    pressure = np.maximum(wanted, 0.0) / thickness_mm
    if not deepest > 0.0:
        return pressure
    direction, before, goes_on = np.zeros_like(pressure), 1.0, 0.0
    for _ in range(_MOST_STEPS):
        gap = sunk(pressure) - wanted
        touched = pressure > 0.0
        error = float((gap[touched] ** 2).sum())
        enters = ~touched & (gap < 0.0)
        if error <= touched.sum() * (_TOLERANCE * deepest) ** 2 and not (gap[enters] < -_TOLERANCE * deepest).any():
            return pressure
        direction = np.where(touched, gap + goes_on * error / before * direction, 0.0)
        before = max(error, _TINY)
        along = sunk(direction)
        work = float((along[touched] * direction[touched]).sum())
        step = float((gap[touched] * direction[touched]).sum()) / max(work, _TINY)
        pressure = np.where(touched, np.maximum(pressure - step * direction, 0.0), 0.0)
        enters &= pressure == 0.0
        pressure[enters] -= step * gap[enters]
        goes_on = 0.0 if enters.any() else 1.0
    raise SimulateError(
        f"the contact of the indenter with the gel was not found in {_MOST_STEPS} steps; check whether the indenter "
        f"has points that are finer than {step_mm:.2g} mm"
    )
