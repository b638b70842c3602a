"""What to fit to the band signals of a paint, and how."""

from dataclasses import dataclass, field

from finray_calib.fit.discrepancy import PAINT_DISCREPANCY, Discrepancy
from finray_calib.fit.emission import FitSettings
from finray_calib.fit.prior import EmissionPrior


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What to fit and how.

    Attributes
    ----------
    family
        Name of the family to report; None lets the bands choose, see :mod:`finray_calib.fit.family_choice`.
    discrepancy
        How far the paint may leave the family.
    prior
        Prior of the quantities common to all families.
    settings
        Size of the sampling.
    check_by_emcee
        Whether to sample the reported posterior again with emcee, as an independent check.
    """

    family: str | None = None
    discrepancy: Discrepancy = PAINT_DISCREPANCY
    prior: EmissionPrior = field(default_factory=EmissionPrior)
    settings: FitSettings = field(default_factory=FitSettings)
    check_by_emcee: bool = False
