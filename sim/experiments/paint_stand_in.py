"""What a measured re-radiation matrix says about a paint: emission under the laser, absorption, yields."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from data_schemas.curves import DonaldsonMatrix, SpectralCurve
from data_schemas.errors import SimulateError
from data_schemas.paper_paints import ColourPatch, PaintColour, PaintStandIn
from finray_calib.fit.colour_match import patch_colours
from finray_calib.fit.family_choice import DEFAULT_FAMILY
from finray_calib.fit.paint_calibration import PAPER_FAMILY
from finray_calib.spectra.absorption import photon_yield
from sim.experiments.paint_stand_in_fits import (
    GRID_NM,
    LASER_NM,
    absorption_from,
    band_means,
    fit_bands,
    fit_whole_spectrum,
)

Floats = NDArray[np.float64]
PRINTED_STOKES_SHIFT_NM: Final[dict[PaintColour, float]] = {"red": 100.0, "green": 50.0}
PRINTED_PATCH: Final[dict[PaintColour, str]] = {"red": "Red", "green": "Green"}
PLATEAU_SHARE = 0.9
"""Neighbouring excitations of the measured matrices differ by some 5 % of noise: above this all is maximum."""
LIGHTS_NM = (LASER_NM, 405.0, 470.0, 500.0)
FIRST_STOKES_NM = 20.0
"""Nearer to the diagonal, reflected light spills into the emission bands."""
SHAPE_EXCITATION_NM = (380.0, 450.0)
"""Excitations whose emission is averaged to its shape: it does not depend on the excitation, and noise halves."""
STRIP_NM = (10.0, 60.0)
"""The strip beyond the emission's maximum in which yields are compared."""
BAND_NM = 10.0


def measure_stand_in(matrix: DonaldsonMatrix, colour: PaintColour, rng: np.random.Generator) -> PaintStandIn:
    """Read off a measured matrix what the paper states for a paint, and fit what a rig would see of it.

    Parameters
    ----------
    matrix
        Excitation over 380 to 450 nm and emission from 470 to 780 nm.
    colour
        Which of the paper's paints it stands for.
    rng
        Source of the noise of the bands and of all draws.

    Raises
    ------
    SimulateError
        The matrix does not cover the laser and the emission, or does not emit.
    """
    emission = _emission(matrix)
    absorption = _absorption(matrix, emission)
    peak_nm = _maximum_nm(emission)
    largest = float(absorption.values.max())
    plateau_nm = absorption.wavelength_nm[absorption.values >= PLATEAU_SHARE * largest]
    fine = _fine(emission)
    printed, closest = _patches(matrix.reflectance, PRINTED_PATCH[colour])
    paper, ours = fit_bands(fine, emission, float(matrix.reflectance(LASER_NM)), rng)
    bands = {f"{nm:g}": value * BAND_NM for nm, value in band_means(fine).items()}
    return PaintStandIn(
        colour=colour,
        material=matrix.name,
        source=matrix.source,
        emission=emission,
        absorption=absorption,
        emission_peak_nm=peak_nm,
        absorption_peak_nm=_maximum_nm(absorption),
        stokes_shift_nm=peak_nm - _maximum_nm(absorption),
        stokes_shift_low_nm=peak_nm - float(plateau_nm[-1]),
        stokes_shift_high_nm=peak_nm - float(plateau_nm[0]),
        printed_stokes_shift_nm=PRINTED_STOKES_SHIFT_NM[colour],
        absorption_edge_nm=_edge_nm(absorption),
        laser_absorption_factor=1 / largest,
        filter_bands=bands,
        energy_yield=float(np.trapezoid(fine, GRID_NM)),
        photon_yield=float(photon_yield(fine, GRID_NM, LASER_NM)),
        printed_patch=printed,
        closest_patch=closest,
        paper_curve=fit_whole_spectrum(PAPER_FAMILY, emission),
        our_curve=fit_whole_spectrum(DEFAULT_FAMILY, emission),
        absorption_curve=fit_whole_spectrum(PAPER_FAMILY, absorption),
        paper_fit=paper.record,
        our_fit=ours.record,
        one_laser=absorption_from(ours.draws_per_nm, absorption, LIGHTS_NM[:1], matrix.reflectance, rng),
        several_lights=absorption_from(ours.draws_per_nm, absorption, LIGHTS_NM, matrix.reflectance, rng),
    )


def _maximum_nm(curve: SpectralCurve) -> float:
    """Return the sample at the maximum, nm."""
    return float(curve.wavelength_nm[curve.values.argmax()])


def _emission(matrix: DonaldsonMatrix) -> SpectralCurve:
    """Return the emission under the laser: its shape averaged over excitations, its size that of the laser's column."""
    rows, columns = matrix.emission_nm, matrix.excitation_nm
    low_nm, high_nm = SHAPE_EXCITATION_NM
    averaged = (columns >= low_nm) & (columns <= high_nm)
    if not averaged.any() or columns[-1] < LASER_NM or rows[0] > LASER_NM + FIRST_STOKES_NM or rows[-1] < GRID_NM[-1]:
        raise SimulateError(
            f"{matrix.source}: covers excitation {columns[0]:g} to {columns[-1]:g} nm and emission {rows[0]:g} to "
            f"{rows[-1]:g} nm; needed are excitations within {low_nm:g} to {high_nm:g} nm and up to the laser at "
            f"{LASER_NM:g} nm, and emission from {LASER_NM + FIRST_STOKES_NM:g} to {GRID_NM[-1]:g} nm"
        )
    seen = rows >= LASER_NM + FIRST_STOKES_NM
    shape = np.where(seen, matrix.radiance_factor_per_nm[:, averaged].mean(axis=1), 0.0)
    total = matrix.emission_at(LASER_NM).values[seen].sum()
    if not (total > 0 and shape.sum() > 0):
        raise SimulateError(f"{matrix.source}: no emission above the laser at {LASER_NM:g} nm; is it fluorescent?")
    return SpectralCurve(
        name=f"{matrix.name}, emission", wavelength_nm=rows, values=shape * (total / shape.sum()), source=matrix.source
    )


def _absorption(matrix: DonaldsonMatrix, emission: SpectralCurve) -> SpectralCurve:
    """Return the photons absorbed at each excitation relative to the laser, from the light in a red strip."""
    rows, columns = matrix.emission_nm[:, None], matrix.excitation_nm
    peak_nm = rows[emission.values.argmax(), 0]
    strip = (rows >= peak_nm + STRIP_NM[0]) & (rows <= peak_nm + STRIP_NM[1]) & (rows >= columns + FIRST_STOKES_NM)
    expected = (emission.values[:, None] * strip).sum(axis=0)
    light = (matrix.radiance_factor_per_nm * strip).sum(axis=0)
    known = expected > 0
    if not (known.any() and np.interp(LASER_NM, columns, np.where(known, light, 0.0)) > 0):
        raise SimulateError(
            f"{matrix.source}: no emission {STRIP_NM[0]:g} to {STRIP_NM[1]:g} nm above the peak at {peak_nm:g} nm "
            f"under the laser at {LASER_NM:g} nm, so that absorption cannot be read off; is it fluorescent?"
        )
    photons = light[known] / expected[known] / columns[known]
    return SpectralCurve(
        name=f"{matrix.name}, absorption",
        wavelength_nm=columns[known],
        values=photons / np.interp(LASER_NM, columns[known], photons),
        source=matrix.source,
    )


def _edge_nm(absorption: SpectralCurve) -> float:
    """Return where absorption falls to half its maximum towards the red, between samples, nm."""
    x, share = absorption.wavelength_nm, absorption.values / absorption.values.max()
    last = int(np.flatnonzero(share >= 0.5)[-1])
    if last == len(x) - 1:
        return float(x[-1])
    return float(np.interp(0.5, share[[last + 1, last]], x[[last + 1, last]]))


def _fine(emission: SpectralCurve) -> Floats:
    """Return the emission on the fine grid: monotone cubic between samples, nothing below the first Stokes light."""
    curve = PchipInterpolator(emission.wavelength_nm, emission.values, extrapolate=False)
    return np.asarray(np.where(GRID_NM > LASER_NM, np.nan_to_num(curve(GRID_NM)), 0.0))


def _patches(reflectance: SpectralCurve, printed: str) -> tuple[ColourPatch, ColourPatch]:
    """Return the distance of the patch that the paper names and of the closest patch of the ColorChecker."""
    patches, x = patch_colours(), reflectance.wavelength_nm
    norm = np.linalg.norm(reflectance.values)
    errors = {
        name.capitalize(): float(np.linalg.norm(np.interp(x, GRID_NM, values) - reflectance.values) / norm)
        for name, values in zip(patches.names, patches.reflectance, strict=True)
    }
    closest = min(errors, key=lambda name: errors[name])
    return ColourPatch(name=printed, error_rel=errors[printed]), ColourPatch(name=closest, error_rel=errors[closest])
