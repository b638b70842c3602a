"""The re-radiation (Donaldson) matrix of a paint from paired draws of its emission and its absorption."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import DonaldsonMatrix, SpectralCurve
from data_schemas.errors import CurveError
from data_schemas.reradiation import Reradiation
from finray_calib.spectra.absorption import photon_yield
from finray_calib.spectra.band_weights import read_only

Floats = NDArray[np.float64]
ENERGY_TOLERANCE_REL = 1e-9
TWO_SIDED_SD = 1.96
_ENERGY = (
    "at {count} of {total} excitation wavelengths (worst {worst_nm:g} nm: {emitted:.3f} emitted, {reflected:.3f} "
    "reflected) the paint gives back more energy than it gets; check the calibration of emission and reflectance"
)
_PHOTONS = (
    "under the laser at {laser_nm:g} nm each absorbed photon makes {worst:.2f} photons or more; at most 1 is possible: "
    "check the calibration of emission and reflectance"
)


@dataclass(frozen=True, slots=True)
class ReradiationMatrix:
    """Mean and spread of a rank-one re-radiation matrix.

    Attributes
    ----------
    mean
        Rows are emission, columns excitation; reflectance stands apart.
    sd_per_nm
        (emission, excitation) standard deviation over the draws, nm^-1.
    warnings
        In words, where the mean breaks conservation of energy or photons.
    """

    mean: DonaldsonMatrix
    sd_per_nm: Floats
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd_per_nm", read_only(self.sd_per_nm))


def reradiation_matrix(
    emission_draws_per_nm: Floats,
    emission_nm: Floats,
    absorption: Reradiation,
    reflectance: SpectralCurve,
    name: str,
) -> ReradiationMatrix:
    r"""Return mean and standard deviation of the re-radiation matrix of a paint.

    .. math:: D(\lambda_o, \lambda_i) = e(\lambda_o)\, \frac{a(\lambda_i)}{a(\lambda_L)}\,
       \frac{\lambda_i}{\lambda_L} \;\; \text{for } \lambda_o > \lambda_i, \text{ else } 0

    D counts energy, a counts photons: hence the ratio of wavelengths. Each draw has rank one above its diagonal
    (the emission's shape does not depend on the excitation); the mean keeps what emission and absorption have in
    common. Measured materials keep a share of 0.946 to 0.998 of their squared entries in rank one.

    Parameters
    ----------
    emission_draws_per_nm
        (N, L) emission under the laser, nm^-1.
    emission_nm
        (L,) increasing grid, nm.
    absorption
        Its N draws belong to the emission draws one to one.
    reflectance
        Non-fluorescent reflectance (the diagonal), 0 to 1.
    name
        Of the paint.

    Returns
    -------
    ReradiationMatrix
        Mean, standard deviation and warnings.

    Raises
    ------
    CurveError
        The draws are not paired or do not fit the grid.
    """
    draws = absorption.absorption_rel_draws
    if emission_draws_per_nm.shape != (len(draws), emission_nm.size):
        raise CurveError(
            f"re-radiation matrix of {name}: emission draws have shape {emission_draws_per_nm.shape}, must be "
            f"({len(draws)} draws of the absorption, {emission_nm.size} wavelengths in nm): pair them one to one"
        )
    excitation_nm, laser_nm = absorption.excitation_nm, absorption.laser_nm
    excited = draws * (excitation_nm / laser_nm)
    stokes = emission_nm[:, None] > excitation_nm
    mean = emission_draws_per_nm.T @ excited / len(draws)
    second_moment = (emission_draws_per_nm**2).T @ excited**2 / len(draws)
    sd = np.sqrt(np.maximum(second_moment - mean**2, 0.0))
    matrix = DonaldsonMatrix(
        name=name,
        emission_nm=emission_nm,
        excitation_nm=excitation_nm,
        radiance_factor_per_nm=np.where(stokes, mean, 0.0),
        reflectance=reflectance,
        source=f"{name}: emission and absorption draws, rank one",
    )
    photons = photon_yield(emission_draws_per_nm, emission_nm, laser_nm)
    warnings = (*_energy_warnings(matrix), *_photon_warnings(photons, float(reflectance(laser_nm)), laser_nm))
    return ReradiationMatrix(matrix, np.where(stokes, sd, 0.0), warnings)


def emitted_energy(matrix: DonaldsonMatrix) -> Floats:
    """Return emitted over incident energy at each excitation: the integral of its column, dimensionless (E,)."""
    return np.asarray(np.trapezoid(matrix.radiance_factor_per_nm, matrix.emission_nm, axis=0))


def emitted_photons(matrix: DonaldsonMatrix) -> Floats:
    """Return emitted over incident photons at each excitation: the integral of D out/in, dimensionless (E,)."""
    photons = matrix.radiance_factor_per_nm * matrix.emission_nm[:, None] / matrix.excitation_nm
    return np.asarray(np.trapezoid(photons, matrix.emission_nm, axis=0))


def rank_one_share(block: Floats) -> float:
    """Return the share of the squared entries of a block that its best rank-one matrix holds, s_1^2 / sum s_i^2."""
    singular = np.linalg.svd(block, compute_uv=False)
    return float(singular[0] ** 2 / (singular**2).sum())


def _energy_warnings(matrix: DonaldsonMatrix) -> tuple[str, ...]:
    """Say where reflected and emitted energy exceed the incident energy."""
    emitted, reflected = emitted_energy(matrix), matrix.reflectance(matrix.excitation_nm)
    excess = emitted + reflected - 1
    broken = excess > ENERGY_TOLERANCE_REL
    if not broken.any():
        return ()
    worst = int(excess.argmax())
    return (
        _ENERGY.format(
            count=int(broken.sum()),
            total=excess.size,
            worst_nm=matrix.excitation_nm[worst],
            emitted=emitted[worst],
            reflected=reflected[worst],
        ),
    )


def _photon_warnings(photons: Floats, reflectance_at_laser: float, laser_nm: float) -> tuple[str, ...]:
    """Say when more photons leave than were absorbed, beyond the spread of the draws."""
    absorbed = max(1 - reflectance_at_laser, ENERGY_TOLERANCE_REL)
    low = float(photons.mean() - TWO_SIDED_SD * photons.std()) / absorbed
    return (_PHOTONS.format(laser_nm=laser_nm, worst=low),) if low > 1 + ENERGY_TOLERANCE_REL else ()
