"""The truth behind a simulated rig: what a calibration of it should find."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from data_schemas.curves import SpectralCurve
from data_schemas.rig import RigFile
from rigs.simulated.bench import sample_matrix

Floats = NDArray[np.float64]
TRUTH_NM: Floats = np.arange(470.0, 781.0)


@dataclass(frozen=True, slots=True)
class BenchTruth:
    """What a calibration of the simulated bench should find; for reports and tests only.

    Attributes
    ----------
    emission
        Emission per nm for light at the laser line (nm^-1), 470 to 780 nm in 1 nm steps.
    mode_nm, fwhm_nm
        Maximum and full width at half maximum of that emission (nm).
    energy_yield
        Emitted over incident energy at the laser line, up to 780 nm.
    absorption
        Photons that light of other wavelengths makes the paint emit, relative to the laser line.
    reflectance
        Non-fluorescent reflectance.
    reflectance_at_laser
        Its value at the laser line.
    """

    emission: SpectralCurve
    mode_nm: float
    fwhm_nm: float
    energy_yield: float
    absorption: SpectralCurve
    reflectance: SpectralCurve
    reflectance_at_laser: float


def bench_truth(rig: RigFile, folder: Path) -> BenchTruth:
    """Return the truth behind a simulated rig; never used by capture, radiometry or fit.

    Mode and width of a hidden paint come from a cubic spline through its fine grid, those of a measured material
    from the monotone cubic (PCHIP) through its bands, whose maximum always lies on a measured wavelength.
    """
    matrix = sample_matrix(rig, folder)
    column = matrix.emission_at(rig.laser.wavelength_nm)
    hidden = rig.simulated is not None and rig.simulated.paint is not None
    through = (CubicSpline if hidden else PchipInterpolator)(column.wavelength_nm, column.values)
    fine_nm = np.linspace(TRUTH_NM[0], TRUTH_NM[-1], 100 * (len(TRUTH_NM) - 1) + 1)
    values = through(fine_nm)
    above = fine_nm[values >= 0.5 * values.max()]
    counted = column.wavelength_nm <= TRUTH_NM[-1]
    # emitted energy over the excitation's wavelength counts photons, as far as the emission keeps its shape
    photons = np.trapezoid(matrix.radiance_factor_per_nm, matrix.emission_nm, axis=0) / matrix.excitation_nm
    at_laser = np.interp(rig.laser.wavelength_nm, matrix.excitation_nm, photons)
    return BenchTruth(
        emission=SpectralCurve(
            name=column.name, wavelength_nm=TRUTH_NM, values=through(TRUTH_NM), source=column.source
        ),
        mode_nm=float(fine_nm[values.argmax()]),
        fwhm_nm=float(above[-1] - above[0]),
        energy_yield=float(np.trapezoid(column.values[counted], column.wavelength_nm[counted])),
        absorption=SpectralCurve(
            name=f"{column.name}, absorption",
            wavelength_nm=matrix.excitation_nm,
            values=photons / at_laser,
            source=column.source,
        ),
        reflectance=matrix.reflectance,
        reflectance_at_laser=float(matrix.reflectance(rig.laser.wavelength_nm)),
    )
