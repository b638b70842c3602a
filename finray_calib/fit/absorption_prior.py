"""What is believed about the absorption and the Stokes shift of a fluorescent paint before they are measured."""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.normal_distribution import normal_cdf, normal_quantile

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class AbsorptionPrior:
    """What is believed about the absorption of a fluorescent paint before it is measured.

    Attributes
    ----------
    stokes_mean_nm, stokes_sd_nm
        Stokes shift, normal cut to above 0: eight measured paints, inks, textiles and papers lie within 20 to 50 nm.
    absorbance_median_factor, ln_absorbance_sd
        Absorbance of the layer at its maximum; the median 1 absorbs nine tenths of the light.
    red_half_width_median_nm, ln_red_half_width_sd
        Half width at half maximum of the absorbance towards the red.
    blue_half_width_median_nm, ln_blue_half_width_sd
        The same towards the blue, where vibronic bands and further dyes widen it.
    blue_floor_low_rel, blue_floor_high_rel
        The logarithm of the floor in the far blue is uniform between these.
    deviation_rel, deviation_length_nm
        Smooth departure of real absorption from the family. Best fits of the family to whole measured excitation
        spectra leave 0.04 to 0.10; fits to a few lights leave more.

    Raises
    ------
    FitError
        A median, width or length is not positive, or the floor's limit is above 1.
    """

    stokes_mean_nm: float = 35.0
    stokes_sd_nm: float = 15.0
    absorbance_median_factor: float = 1.0
    ln_absorbance_sd: float = 0.8
    red_half_width_median_nm: float = 20.0
    ln_red_half_width_sd: float = 0.4
    blue_half_width_median_nm: float = 60.0
    ln_blue_half_width_sd: float = 0.7
    blue_floor_low_rel: float = 0.02
    blue_floor_high_rel: float = 0.5
    deviation_rel: float = 0.12
    deviation_length_nm: float = 20.0

    def __post_init__(self) -> None:
        wrong = [f.name for f in fields(self) if not getattr(self, f.name) > 0]
        if wrong:
            raise FitError(f"absorption prior: {wrong[0]} is {getattr(self, wrong[0]):g}, it must be above 0")
        if not self.blue_floor_low_rel <= self.blue_floor_high_rel <= 1:
            raise FitError(
                f"absorption prior: the blue floor runs from {self.blue_floor_low_rel:g} to "
                f"{self.blue_floor_high_rel:g}, it must increase and end at 1 or below"
            )

    @cached_property
    def in_words(self) -> dict[str, str]:
        """Prior of each parameter with its origin."""
        return {
            "stokes_shift_nm": f"normal({self.stokes_mean_nm:g}, {self.stokes_sd_nm:g}) nm above 0; eight measured "
            "materials lie within 20 to 50 nm",
            "peak_absorbance": f"log-normal, median {self.absorbance_median_factor:g}, sd of the logarithm "
            f"{self.ln_absorbance_sd:g}; from thin to saturated layers",
            "red_half_width_nm": f"log-normal, median {self.red_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_red_half_width_sd:g}; four open materials",
            "blue_half_width_nm": f"log-normal, median {self.blue_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_blue_half_width_sd:g}; four open materials",
            "blue_floor": f"log-uniform {self.blue_floor_low_rel:g} to {self.blue_floor_high_rel:g}; four open "
            "materials",
            "deviation": f"smooth Gaussian process of ln a, sd {self.deviation_rel:g}, length "
            f"{self.deviation_length_nm:g} nm; four open materials",
        }

    def stokes_density(self, shift_nm: Floats) -> Floats:
        """Return the prior density of Stokes shifts up to a factor; 0 for shifts not above 0."""
        z = (shift_nm - self.stokes_mean_nm) / self.stokes_sd_nm
        return np.where(shift_nm > 0, np.exp(-0.5 * z**2), 0.0)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return (count,) Stokes shifts in nm, and (4, count) absorbance, half widths (red, blue, nm) and floor."""
        below = normal_cdf(-self.stokes_mean_nm / self.stokes_sd_nm)
        shift = self.stokes_mean_nm + self.stokes_sd_nm * normal_quantile(below + (1 - below) * rng.random(count))
        medians = (self.absorbance_median_factor, self.red_half_width_median_nm, self.blue_half_width_median_nm)
        spreads = (self.ln_absorbance_sd, self.ln_red_half_width_sd, self.ln_blue_half_width_sd)
        shape = [m * np.exp(s * rng.standard_normal(count)) for m, s in zip(medians, spreads, strict=True)]
        span = np.log(self.blue_floor_high_rel / self.blue_floor_low_rel)
        return shift, np.array([*shape, self.blue_floor_low_rel * np.exp(span * rng.random(count))])
