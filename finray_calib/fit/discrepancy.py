r"""How far a real paint may leave its family: a multiplicative Gaussian process.

.. math::
    f(\lambda) = s(\lambda) + (s(\lambda) + \epsilon\,s_{peak})\,d(\lambda), \qquad
    d \sim GP\left(0,\; a^2 e^{-(\lambda-\lambda')^2 / 2 \ell^2} + r^2 e(\lambda) e(\lambda')\right)

with s the curve of the family. The share :math:`\epsilon` of the peak lets a paint emit where the family has died
out. The rank-one part is re-absorption: a thick paint absorbs the blue edge of its own light, by an unknown
fraction of order r that falls from 1 to 0 around the blue half-maximum (the logistic e). Without a discrepancy the
intervals of every family are far too narrow on measured paint.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError

FloatArray = NDArray[np.float64]

EDGE_OFFSET_FWHM = 0.5
EDGE_WIDTH_FWHM = 0.12
"""The re-absorbed edge: a logistic centred half a full width below the mode, 0.12 full widths wide."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Hyper-parameters of the discrepancy.

    Attributes
    ----------
    amplitude_rel
        Standard deviation a of the relative discrepancy; 0 for none.
    length_nm
        Correlation length, nm.
    floor_rel
        Share of the peak that the relative discrepancy also acts on.
    reabsorption_rel
        Standard deviation r of the re-absorbed fraction at the blue edge.
    origin
        Where the numbers come from.

    Raises
    ------
    FitError
        When a number is out of its range.
    """

    amplitude_rel: float
    length_nm: float
    floor_rel: float
    reabsorption_rel: float
    origin: str

    def __post_init__(self) -> None:
        for name in ("amplitude_rel", "floor_rel", "reabsorption_rel"):
            if not 0 <= getattr(self, name) < 1:
                raise FitError(f"discrepancy: {name} {getattr(self, name):g} must be a share of 0 or more and below 1")
        if not 2 <= self.length_nm <= 200:
            raise FitError(f"discrepancy: length_nm {self.length_nm:g} nm must lie between 2 and 200 nm")

    @property
    def acts(self) -> bool:
        """Whether there is any discrepancy."""
        return self.amplitude_rel > 0 or self.reabsorption_rel > 0

    def smooth_kernel(self, one_nm: FloatArray, other_nm: FloatArray) -> FloatArray:
        """Return a^2 exp(-(l - l')^2 / (2 length^2)) between two sets of wavelengths, nm."""
        apart = (one_nm[:, None] - other_nm) / self.length_nm
        return np.asarray(self.amplitude_rel**2 * np.exp(-0.5 * apart**2))


PAINT_DISCREPANCY = Discrepancy(
    0.12,
    12.0,
    0.1,
    0.1,
    "measured re-radiation matrices of an orange ink, a yellow textile and two papers: see the leave-one-material-out "
    "study in benchmarks/",
)
"""What measured paints, inks, papers and textiles ask for with the default family."""

NO_DISCREPANCY = Discrepancy(0.0, 12.0, 0.0, 0.0, "none: the curve is taken to be exactly of the family")
