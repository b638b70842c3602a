"""Absorption of a paint from the emission that its lights excite, and what its reradiation matrix leaves in doubt."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import SpectralCurve
from data_schemas.estimate import Estimate
from data_schemas.radiometry import BandSignals
from data_schemas.reradiation import Reradiation
from finray_calib.fit.absorption_fit import fit_absorption
from finray_calib.fit.absorption_prior import AbsorptionPrior
from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.other_lights import excitation_yields
from finray_calib.spectra.reradiation_matrix import reradiation_matrix
from finray_calib.spectra.rig_curves import WAVELENGTH_NM

Floats = NDArray[np.float64]


def paint_absorption(
    bands: BandSignals,
    drawn: Floats,
    reflected: tuple[Estimate, ...],
    lights: Sequence[tuple[float, EmissionPosterior]],
    rng: np.random.Generator,
) -> Reradiation:
    """Return the absorption: prior-driven with one light, constrained by the yields of several.

    Parameters
    ----------
    bands
        Band signals under the first light.
    drawn
        (N, L) emission draws under it, nm^-1.
    reflected
        Reflectance at each filter.
    lights
        Excitation wavelength of each other light, nm, and the emission under it.
    rng
        Of the draws of the absorption.
    """
    laser_nm = bands.optics.laser.wavelength_nm
    yields = excitation_yields({laser_nm: drawn, **{nm: p.curve_draws.curves for nm, p in lights}})
    least = _reflected_curve(bands, reflected, "low95")
    return fit_absorption(drawn, WAVELENGTH_NM, laser_nm, yields, AbsorptionPrior(), rng, least)


def matrix_warnings(
    bands: BandSignals, drawn: Floats, reflected: tuple[Estimate, ...], reradiation: Reradiation
) -> tuple[str, ...]:
    """Return what is doubtful about the matrix that absorption, emission draws and reflectance make together."""
    mean, sd = _reflected_curve(bands, reflected), _reflected_curve(bands, reflected, "sd")
    return reradiation_matrix(drawn, WAVELENGTH_NM, reradiation, mean, bands.paint_name, sd).warnings


def _reflected_curve(
    bands: BandSignals, reflected: tuple[Estimate, ...], quantity: Literal["estimate", "sd", "low95"] = "estimate"
) -> SpectralCurve:
    """Return the reflectance (or its standard uncertainty or lower 95 % limit) between the filters' centres."""
    pairs = sorted((f.center_nm, getattr(r, quantity)) for f, r in zip(bands.optics.filters, reflected, strict=True))
    nm, values = np.array(pairs).T
    return SpectralCurve(name="reflectance", wavelength_nm=nm, values=values, source="filters of the session")
