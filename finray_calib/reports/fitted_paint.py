"""One fitted paint as every report shows it: band signals, calibration, and the truth where it is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import SpectralCurve
from data_schemas.fit import FamilyResult, PaintCalibration
from data_schemas.radiometry import BandSignals

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PaintTruth:
    """What the bench really held; the fitter never saw it.

    Attributes
    ----------
    emission
        Emission for light at the laser line, bispectral radiance factor per nm, nm^-1.
    mode_nm, fwhm_nm
        Wavelength of its maximum and full width at half maximum, nm.
    energy_yield
        Emitted over incident energy, 0 to 1.
    kind
        "hidden paper-family paint" or "measured material FILE".
    """

    emission: SpectralCurve
    mode_nm: float
    fwhm_nm: float
    energy_yield: float
    kind: str

    @property
    def is_measured(self) -> bool:
        """Whether the truth is a measured material rather than a curve of the paper's family."""
        return self.kind.startswith("measured")

    @property
    def word(self) -> str:
        """What the reports call it."""
        return "measured" if self.is_measured else "true"


@dataclass(frozen=True, slots=True)
class FittedPaint:
    """One paint with its fit.

    Attributes
    ----------
    bands
        What was fitted.
    fit
        The calibration.
    label
        What sets this paint apart from others on the page, such as "red paint"; empty where it is alone.
    truth
        What the fit should have found, where it is known.
    """

    bands: BandSignals
    fit: PaintCalibration
    label: str = ""
    truth: PaintTruth | None = None

    @property
    def subject(self) -> str:
        """What a sentence calls the paint."""
        return f"the {self.label or 'paint'}"

    def titled(self, text: str) -> str:
        """Return a caption that begins with the paint where there are several."""
        return f"{self.label.capitalize()}: {text}" if self.label else text[:1].upper() + text[1:]

    @property
    def chosen(self) -> FamilyResult:
        """The family that is reported."""
        return next(family for family in self.fit.families if family.name == self.fit.family)

    @property
    def competing(self) -> tuple[FamilyResult, ...]:
        """All families but the paper's curve alone, which stands last and competes for no probability."""
        return self.fit.families[:-1]

    @property
    def paper(self) -> FamilyResult:
        """The paper's curve without discrepancy."""
        return self.fit.families[-1]

    @property
    def paper_emission_per_nm(self) -> Floats:
        """Posterior mean of the paper's curve without discrepancy, nm^-1."""
        return np.asarray(self.fit.family_emission_per_nm[-1])
