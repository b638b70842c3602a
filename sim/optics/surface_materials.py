"""What the finger's surfaces are made of, as the renderer's materials: coating, gel, mirror, dark parts."""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.optical_design import Coating
from sim.optics.paint_bands import PaintBands

# evaporated aluminium, rounded handbook values: wavelength in nm, n, k
_ALUMINIUM = np.array(
    [
        [400.0, 0.490, 4.86],
        [450.0, 0.618, 5.47],
        [500.0, 0.769, 6.08],
        [550.0, 0.958, 6.69],
        [600.0, 1.200, 7.26],
        [650.0, 1.470, 7.79],
        [700.0, 1.830, 8.31],
    ]
)


def rgb(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return band values as the renderer's three channels."""
    return {"type": "rgb", "value": [float(v) for v in values]}


def diffuse(reflectance: float) -> dict[str, Any]:
    """Return a grey Lambertian material."""
    return {"type": "diffuse", "reflectance": rgb(np.full(3, reflectance))}


def gel_face(design: FingerDesign) -> dict[str, Any]:
    """Return the bare face of the gel; its index is that at the LED, whose light must find its way exactly.

    The painted bands see an index lower by up to 0.01, which moves what a pixel sees by less than 0.05 mm. A film on it
    is the integrator's matter (:meth:`sim.optics.paths.BandPaths.film_factor`): Mitsuba's own know none.
    """
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    return {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}


def metal(design: FingerDesign, bands: PaintBands, renderer: ModuleType) -> dict[str, Any]:
    """Return the coating of a finger, in bands or in full spectra."""
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    if not renderer.variant().endswith("_spectral"):
        return coating(design.coating, np.array([band.centroid_nm for band in bands.bands]), index)
    from sim.optics.fluorescent_spectrum import held_spectrum  # needs the variant set

    # the renderer's own spectra end in zero, and a metal of n = k = 0 is not a number
    eta, k = (held_spectrum(_ALUMINIUM[:, 0], _ALUMINIUM[:, column] / index) for column in (1, 2))
    return _blend(design.coating, eta, k)


def coating(coat: Coating, centroids_nm: NDArray[np.float64], index: float) -> dict[str, Any]:
    """Return the aluminium coating as seen from inside a gel of this index, for channels at these wavelengths."""
    # the renderer takes conductors to stand in vacuum; relative to gel, n and k are divided by its index
    eta, k = (rgb(np.interp(centroids_nm, _ALUMINIUM[:, 0], _ALUMINIUM[:, c]) / index) for c in (1, 2))
    return _blend(coat, eta, k)


def _blend(coat: Coating, eta: dict[str, Any], k: dict[str, Any]) -> dict[str, Any]:
    """Return the blend of rough metal and diffuse part."""
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": coat.roughness_alpha, "eta": eta, "k": k}
    blend = {
        "type": "blendbsdf",
        "weight": coat.diffuse_share,
        "metal": metal,
        "diffuse": diffuse(coat.diffuse_reflectance),
    }
    return {"type": "twosided", "coating": blend}


def mirror(design: FingerDesign) -> dict[str, Any]:
    """Return the mirror's material."""
    reflectance = rgb(np.full(3, design.mirror.reflectance))
    metal = {"type": "conductor", "material": "none", "specular_reflectance": reflectance}
    return {"type": "twosided", "metal": metal}
