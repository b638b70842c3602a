"""What the fit of a region tells its pixels, and how far a pixel may lie from it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from data_schemas.estimate import Estimate
from data_schemas.fit import PaintCalibration
from finray_calib.fit.pixel_curves import SHAPES
from finray_calib.fit.prior import BLOCKING, OWN_LEAK, REFLECTED_LASER
from finray_calib.spectra.band_tolerances import LN_10
from finray_calib.spectra.emission_families import FAMILIES, EmissionFamily, family_named

Floats = NDArray[np.float64]

LEAST_SIGNAL_SD: Final = 3.0
"""A filter and channel whose region signal is weaker than this holds nothing that its factor could be taken from."""
_QUANTITIES = ("mode_nm", "fwhm_nm", "peak_per_nm")


@dataclass(frozen=True, slots=True)
class PixelSpread:
    """How far a pixel may lie from the region's fit, before it is looked at: one paint from one tin.

    Attributes
    ----------
    mode_sd_nm, ln_fwhm_sd
        Thick layers re-absorb their blue edge, which moves the mode by a few nm and the width by some per cent.
    ln_peak_sd
        Height follows the thickness: bare spots to double layers.
    own_factor
        Of the family's own parameter, times the sd of its prior for an unknown paint.

    Raises
    ------
    FitError
        When one is not positive.
    """

    mode_sd_nm: float = 5.0
    ln_fwhm_sd: float = 0.1
    ln_peak_sd: float = 1.0
    own_factor: float = 0.25

    def __post_init__(self) -> None:
        if not min(self.mode_sd_nm, self.ln_fwhm_sd, self.ln_peak_sd, self.own_factor) > 0:
            raise FitError(f"pixel spread: every width must be positive, got {self}")

    def of(self, family: EmissionFamily) -> Floats:
        """Return the standard deviations of a family's four parameters, (4,)."""
        return np.array([self.mode_sd_nm, self.ln_fwhm_sd, self.ln_peak_sd, self.own_factor * family.own[0].sd])


@dataclass(frozen=True, slots=True)
class RegionFit:
    """What the fit of the region tells its pixels.

    Attributes
    ----------
    family
        Family of four parameters.
    theta
        (5,) mode, ln FWHM, ln peak and own parameter at the posterior's maximum, and the reflectance at the laser.
    theta_sd
        (4,) posterior standard deviations of the shape.
    leak
        (B,) multiplier of each filter's nominal leak.
    signal
        (B, 3) band signals of the region, NaN where they give no factor.
    quantities
        Region's mode_nm, fwhm_nm, peak_per_nm, energy_yield and reflectance_at_laser.
    """

    family: EmissionFamily
    theta: Floats
    theta_sd: Floats
    leak: Floats
    signal: Floats
    quantities: dict[str, Estimate]


def region_fit(paint: PaintCalibration) -> RegionFit:
    """Return what a paint calibration tells the pixels of its region.

    Raises
    ------
    FitError
        The family has more than four parameters.
    """
    family = family_named(paint.family)
    if len(family.parameter_names) != SHAPES:
        small = " or ".join(name for name, f in FAMILIES.items() if len(f.parameter_names) == SHAPES)
        raise FitError(
            f"paint map: family {family.name} has {len(family.parameter_names)} parameters, but the bands of one pixel "
            f"carry {SHAPES}; choose {small} ('finray fit --family') and map with that fit"
        )
    best, sds = paint.map_estimate, dict(zip(paint.sampled, paint.draws.std(axis=0), strict=True))
    shape = [best[name] for name in family.parameter_names]
    firm = paint.usable & (paint.measured > LEAST_SIGNAL_SD * paint.measured_sd)
    quantities = {name: paint.parameters[name] for name in (*_QUANTITIES, "reflectance_at_laser")}
    return RegionFit(
        family=family,
        theta=np.array([*shape, np.exp(best[REFLECTED_LASER])]),
        theta_sd=np.array([sds[name] for name in family.parameter_names]),
        leak=np.exp(best.get(BLOCKING, 0.0) + _own_ln_leak(paint)),
        signal=np.where(firm, paint.measured, np.nan),
        quantities={**quantities, "energy_yield": paint.energy_yield},
    )


def _own_ln_leak(paint: PaintCalibration) -> Floats:
    """Return ln(leak of each filter over the common one), (B,): as fitted where it was sampled, else of its mean."""
    sd = np.array([LN_10 * f.blocking_uncertainty_od for f in paint.optics.filters])
    z = [paint.map_estimate.get(OWN_LEAK.format(f.name)) for f in paint.optics.filters]
    return np.array([s * s / 2 if own is None else s * own for s, own in zip(sd, z, strict=True)])
