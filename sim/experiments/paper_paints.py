"""The paper's statements on its red and green paint, side by side with measured stand-ins.

No measured spectrum of the paper's paints is public, and the paper prints no fitted numbers. What it does print
(Stokes shifts, reradiation "in the desired wavelength", the peak wavelength of its curve, the matching ColorChecker
patches) is computed here for measured materials of the same colour, in units that say what is counted.
"""

from collections.abc import Callable, Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from data_schemas.curves import DonaldsonMatrix, SpectralCurve
from data_schemas.errors import SimulateError
from data_schemas.reradiation import (
    ColourPatch,
    CurveFit,
    PaintStandIn,
    PaperPaints,
    PaperStatement,
    Reradiation,
    Verdict,
)
from finray_calib.fit.absorption_fit import AbsorptionPrior, ExcitationYield, fit_absorption
from finray_calib.spectra.absorption import photon_yield
from finray_calib.spectra.emission_families import EmissionFamily, family_named
from finray_calib.spectra.skew_cauchy import SkewCauchy

Floats = NDArray[np.float64]
Colour = Literal["red", "green"]
LASER_NM = 450.0
FILTER_CENTER_NM = (405.0, 450.0, 500.0, 532.0, 560.0, 600.0, 630.0, 660.0)
FILTER_FWHM_NM = 10.0
PRINTED_STOKES_SHIFT_NM: Final[dict[Colour, float]] = {"red": 100.0, "green": 50.0}
PRINTED_PATCH: Final[dict[Colour, str]] = {"red": "Red", "green": "Green"}
PRINTED_BAND = (0.02, 0.05)
PAPER_FAMILY, OUR_FAMILY = "zheng2014", "log_normal_wavenumber"

GRID_NM: Floats = np.arange(380.0, 781.0)
GRID_NM.flags.writeable = False
MATRIX_STEP_NM = 10.0
"""Steps of the measured matrices: maxima are known to this."""
PLATEAU_SHARE = 0.9
"""Neighbouring excitations of the measured matrices differ by some 5 % of noise: above this all is maximum."""
LIGHTS_NM = (LASER_NM, 405.0, 470.0, 500.0)
YIELD_SD_REL = 0.05
DRAWS = 200
FIRST_STOKES_NM = 20.0
"""Nearer to the diagonal, reflected light spills into the emission bands."""
SHAPE_EXCITATION_NM = (380.0, 450.0)
"""Excitations whose emission is averaged to its shape: it does not depend on the excitation, and noise halves."""
STRIP_NM = (10.0, 60.0)
"""The strip beyond the emission's maximum in which yields are compared."""
CALIBRATION_REL, FLOOR_REL = 0.01, 0.003
"""Assumed errors of the filter bands: of the value, and of the brightest band."""
GOOD_FIT_REL = 0.10
MODE_TOLERANCE_NM = 3.0
CAVEAT = (
    "Stand-ins, not the paper's paints: no measured spectrum of those is public. The paper prints no fitted "
    "parameters; what is fitted here is its equation."
)


def reproduce_paper_paints(
    red: Sequence[DonaldsonMatrix], green: Sequence[DonaldsonMatrix], rng: np.random.Generator
) -> PaperPaints:
    """Return the paper's statements on its paints beside those of measured stand-ins.

    Parameters
    ----------
    red, green
        Measured re-radiation matrices that stand for the red and the green paint, at least one of each; excitation
        over 380 to 450 nm and emission to 780 nm.
    rng
        Source of the draws of our absorption.

    Raises
    ------
    SimulateError
        A colour has no stand-in, or a matrix does not cover the laser and the emission.
    """
    if not red or not green:
        raise SimulateError(
            "paper paints: give at least one measured re-radiation matrix for red and one for green "
            "(--red CSV --green CSV)"
        )
    paints = (*(measure_stand_in(m, "red", rng) for m in red), *(measure_stand_in(m, "green", rng) for m in green))
    return PaperPaints(laser_nm=LASER_NM, stand_ins=paints, statements=paper_statements(paints), caveat=CAVEAT)


def measure_stand_in(matrix: DonaldsonMatrix, colour: Colour, rng: np.random.Generator) -> PaintStandIn:
    """Read off a measured matrix what the paper states for a paint.

    Raises
    ------
    SimulateError
        The matrix does not cover the laser and the emission, or does not emit.
    """
    emission = _emission(matrix)
    absorption = _absorption(matrix, emission)
    peak_nm = float(emission.wavelength_nm[emission.values.argmax()])
    absorbed_nm = float(absorption.wavelength_nm[absorption.values.argmax()])
    largest = float(absorption.values.max())
    plateau_nm = absorption.wavelength_nm[absorption.values >= PLATEAU_SHARE * largest]
    fine = _fine(emission)
    patches = _colour_patches(matrix.reflectance, PRINTED_PATCH[colour])
    return PaintStandIn(
        colour=colour,
        material=matrix.name,
        source=matrix.source,
        emission=emission,
        absorption=absorption,
        emission_peak_nm=peak_nm,
        absorption_peak_nm=absorbed_nm,
        stokes_shift_nm=peak_nm - absorbed_nm,
        stokes_shift_low_nm=peak_nm - float(plateau_nm[-1]),
        stokes_shift_high_nm=peak_nm - float(plateau_nm[0]),
        printed_stokes_shift_nm=PRINTED_STOKES_SHIFT_NM[colour],
        absorption_edge_nm=_edge_nm(absorption),
        laser_absorption_factor=1 / largest,
        filter_bands={
            f"{nm:g}": float(value)
            for nm, value in zip(FILTER_CENTER_NM, _band_means(fine) * MATRIX_STEP_NM, strict=True)
        },
        energy_yield=float(np.trapezoid(fine, GRID_NM)),
        photon_yield=float(photon_yield(fine, GRID_NM, LASER_NM)),
        printed_patch=patches[0],
        closest_patch=patches[1],
        fits=tuple(
            _fit(f, s, emission) for f in (PAPER_FAMILY, OUR_FAMILY) for s in ("whole spectrum", "filter bands")
        ),
        absorption_fit=_fit(PAPER_FAMILY, "whole spectrum", absorption),
        one_laser=_our_absorption(fine, absorption, LIGHTS_NM[:1], matrix.reflectance, rng),
        several_lights=_our_absorption(fine, absorption, LIGHTS_NM, matrix.reflectance, rng),
    )


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


def _our_absorption(
    emission_per_nm: Floats,
    absorption: SpectralCurve,
    lights_nm: Sequence[float],
    reflectance: SpectralCurve,
    rng: np.random.Generator,
) -> Reradiation:
    """Return our posterior of the absorption from the measured yields under some lights."""
    yields = [ExcitationYield(nm, float(absorption(nm)) * nm / LASER_NM, YIELD_SD_REL) for nm in lights_nm]
    draws = np.tile(emission_per_nm, (DRAWS, 1))
    return fit_absorption(draws, GRID_NM, LASER_NM, yields, AbsorptionPrior(), rng, reflectance)


def _fine(emission: SpectralCurve) -> Floats:
    """Return the emission on the fine grid: monotone cubic between samples, nothing below the first Stokes light."""
    curve = PchipInterpolator(emission.wavelength_nm, emission.values, extrapolate=False)
    return np.asarray(np.where(GRID_NM > LASER_NM, np.nan_to_num(curve(GRID_NM)), 0.0))


def _band_means(fine: Floats) -> Floats:
    """Return the mean of a curve on the fine grid over each filter's Gaussian pass band, (8,)."""
    z = 2 * (GRID_NM - np.array(FILTER_CENTER_NM)[:, None]) / FILTER_FWHM_NM
    passed = np.exp2(-(z**2))
    return np.asarray(passed @ fine / passed.sum(axis=1))


def _fit(family_name: str, seen: Literal["whole spectrum", "filter bands"], measured: SpectralCurve) -> CurveFit:
    """Fit a family by least squares to all samples, or to the eight filter bands.

    The seam of this study: a calibration by :func:`finray_calib.fit.paint_calibration.calibrate_paint` of a simulated
    session goes here once it is as quick; least squares answers what the equation can do, not how sure the fit is.
    """
    family = family_named(family_name)
    if seen == "whole spectrum":
        x = measured.wavelength_nm
        y = measured.values / measured.values.max()
        theta = _least_squares(family, lambda t: family.curves(t[None], x)[0] * (y != 0) - y, measured)
    else:
        emitting = np.array(FILTER_CENTER_NM) > LASER_NM + FIRST_STOKES_NM
        bands = _band_means(_fine(measured))[emitting] / measured.values.max()
        sd = np.hypot(CALIBRATION_REL * bands, FLOOR_REL * bands.max())
        theta = _least_squares(
            family, lambda t: (_band_means(family.curves(t[None], GRID_NM)[0])[emitting] - bands) / sd, measured
        )
    theta[2] += np.log(measured.values.max())
    fitted = family.curves(theta[None], measured.wavelength_nm)[0] * (measured.values != 0)
    parameters = dict(zip(family.parameter_names, map(float, theta), strict=True))
    if family.name == PAPER_FAMILY:
        paper = SkewCauchy.from_mode(theta[0], theta[1], theta[3], theta[2])
        parameters |= {"location_nm": paper.location_nm, "scale_nm": paper.scale_nm, "skewness": paper.skewness}
    return CurveFit(
        family=family.title,
        seen=seen,
        parameters=parameters,
        mode_nm=float(theta[0]),
        fwhm_nm=float(np.exp(theta[1])),
        curve=SpectralCurve(
            name=family.title,
            wavelength_nm=GRID_NM,
            values=family.curves(theta[None], GRID_NM)[0],
            source=f"least squares, {seen}",
        ),
        residual_rel=float(np.linalg.norm(fitted - measured.values) / np.linalg.norm(measured.values)),
    )


def _least_squares(family: EmissionFamily, residual: Callable[[Floats], Floats], measured: SpectralCurve) -> Floats:
    """Return the parameters of a curve of maximum about 1 with the least residual, from starts of both skews."""
    peak_nm = float(measured.wavelength_nm[measured.values.argmax()])
    low = [320.0, np.log(10.0), -3.0, *(p.low for p in family.own)]
    high = [780.0, np.log(400.0), 3.0, *(p.high for p in family.own)]
    starts = [[peak_nm, np.log(50.0), 0.0, *(side * 0.3 for _ in family.own)] for side in (-1, 1)]
    scales = [10.0, 0.2, 0.2, *(1.0 for _ in family.own)]
    fits = [least_squares(residual, start, bounds=(low, high), x_scale=scales) for start in starts]
    return np.asarray(min(fits, key=lambda fit: float(fit.cost)).x)


def _colour_patches(reflectance: SpectralCurve, printed: str) -> tuple[ColourPatch, ColourPatch]:
    """Return the distance of the patch that the paper names and of the closest patch of the ColorChecker."""
    import colour  # takes seconds to load

    x = reflectance.wavelength_nm
    norm = np.linalg.norm(reflectance.values)
    errors = {
        name.capitalize(): float(
            np.linalg.norm(np.interp(x, patch.wavelengths, patch.values) - reflectance.values) / norm
        )
        for name, patch in colour.SDS_COLOURCHECKERS["BabelColor Average"].items()
    }
    closest = min(errors, key=lambda name: errors[name])
    return ColourPatch(name=printed, error_rel=errors[printed]), ColourPatch(name=closest, error_rel=errors[closest])


def paper_statements(paints: Sequence[PaintStandIn]) -> tuple[PaperStatement, ...]:
    """Return each of the paper's statements with what the stand-ins say, the verdict, and why they differ."""
    return (
        *(_stokes_statement(colour, [p for p in paints if p.colour == colour]) for colour in PRINTED_STOKES_SHIFT_NM),
        *_reradiation_statements(paints),
        _excitation_statement(paints),
        _peak_statement(paints),
        *_family_statements(paints),
        *(_patch_statement(colour, [p for p in paints if p.colour == colour]) for colour in PRINTED_PATCH),
        PaperStatement(
            subject="diffuse paint",
            paper="outgoing radiance is the same for any incident direction",
            ours="-",
            verdict="cannot be tested",
            why="the measured matrices hold one geometry; a capture at two tilts would test it",
        ),
    )


def _verdict(holds: Sequence[bool]) -> Verdict:
    """Join the verdicts of several stand-ins."""
    if all(holds):
        return "holds"
    return "holds in part" if any(holds) else "does not hold"


def _each(paints: Sequence[PaintStandIn], text: Callable[[PaintStandIn], str]) -> str:
    """Name every stand-in with its value."""
    return "; ".join(f"{paint.material} {text(paint)}" for paint in paints)


def _percent(value_rel: float, digits: int = 0) -> str:
    """Return a share as per cent."""
    return f"{100 * value_rel:.{digits}f} %"


def _stokes_statement(colour: Colour, paints: Sequence[PaintStandIn]) -> PaperStatement:
    """Compare the Stokes shift: maximum of emission minus maximum of absorption."""
    printed = PRINTED_STOKES_SHIFT_NM[colour]
    near = [abs(p.stokes_shift_nm - printed) <= MATRIX_STEP_NM for p in paints]
    on_plateau = [p.stokes_shift_low_nm <= printed <= p.stokes_shift_high_nm for p in paints]
    edges = ", ".join(f"{p.emission_peak_nm - p.absorption_edge_nm:.0f}" for p in paints)
    return PaperStatement(
        subject=f"Stokes shift, {colour} paint",
        paper=f"{printed:.0f} nm, chosen by hand from reflectance data",
        ours=_each(
            paints,
            lambda p: (
                f"{p.stokes_shift_nm:.0f} nm between the maxima ({p.stokes_shift_low_nm:.0f} to "
                f"{p.stokes_shift_high_nm:.0f} nm on the plateau)"
            ),
        ),
        verdict="holds in part" if any(on_plateau) and not all(near) else _verdict(near),
        why=f"absorption is a plateau flat within {_percent(1 - PLATEAU_SHARE)}, so that its maximum, and with it the "
        f"shift, is ill-defined; what acts is its red edge, only {edges} nm below the emission's peak. One laser at "
        f"{LASER_NM:.0f} nm measures neither",
    )


def _reradiation_statements(paints: Sequence[PaintStandIn]) -> tuple[PaperStatement, PaperStatement]:
    """Compare "a reflectance of 2 to 5 %": as the value of one band, and as the share of light that is emitted."""
    low, high = PRINTED_BAND
    brightest = [max(p.filter_bands, key=lambda nm: p.filter_bands[nm]) for p in paints]
    values = [p.filter_bands[nm] for p, nm in zip(paints, brightest, strict=True)]
    at = dict(zip((p.material for p in paints), zip(values, brightest, strict=True), strict=True))
    printed = f"{_percent(low)} to {_percent(high)} in the desired wavelength"
    return (
        PaperStatement(
            subject="reradiation, read as one 10 nm band",
            paper=printed,
            ours=_each(paints, lambda p: f"{_percent(at[p.material][0], 1)} at {at[p.material][1]} nm"),
            verdict=_verdict([low <= value <= high for value in values]),
            why="the brightest filter band of measured materials holds a few per cent; strong paints hold more",
        ),
        PaperStatement(
            subject="reradiation, read as share of the light",
            paper=printed,
            ours=_each(
                paints, lambda p: f"{_percent(p.energy_yield)} of the energy, {_percent(p.photon_yield)} of the photons"
            ),
            verdict=_verdict([low <= p.energy_yield <= high for p in paints]),
            why="a band of 10 nm holds a fraction of an emission 50 nm wide and more; a renderer that takes 2 to 5 % "
            f"for all emitted light makes the paint {min(p.energy_yield for p in paints) / high:.0f} to "
            f"{max(p.energy_yield for p in paints) / low:.0f} times too dark",
        ),
    )


def _excitation_statement(paints: Sequence[PaintStandIn]) -> PaperStatement:
    """Check that the emission depends on the excitation."""

    def change(paint: PaintStandIn) -> tuple[float, float]:
        x, y = paint.absorption.wavelength_nm, paint.absorption.values
        inside = (x >= 380.0) & (x <= paint.emission_peak_nm)
        return float(y[inside].min()), float(y[inside].max())

    spreads = {p.material: change(p) for p in paints}
    green_nm = next(p.emission_peak_nm for p in paints if p.colour == "green")
    red = [p for p in paints if p.colour == "red"]
    excited = _each(red, lambda p: f"{float(p.absorption(green_nm)):.2f}")
    return PaperStatement(
        subject="dependence on the excitation",
        paper="reradiation depends on the incident excitation wavelength",
        ours="absorption relative to 450 nm, 380 nm to the emission's peak: "
        + _each(paints, lambda p: "{:.2f} to {:.2f}".format(*spreads[p.material])),
        verdict=_verdict([high - low > GOOD_FIT_REL for low, high in spreads.values()]),
        why=f"so green light of {green_nm:.0f} nm also excites red paint (relative to 450 nm: {excited}), which a "
        "light source in place of the paint leaves out",
    )


def _peak_statement(paints: Sequence[PaintStandIn]) -> PaperStatement:
    """Check that lambda_0 is the peak wavelength."""
    shifts = {p.material: p.fits[0].mode_nm - p.fits[0].parameters["location_nm"] for p in paints}
    return PaperStatement(
        subject="lambda_0 of the curve",
        paper="is the peak wavelength",
        ours="peak minus lambda_0: " + _each(paints, lambda p: f"{shifts[p.material]:+.1f} nm"),
        verdict=_verdict([abs(shift) <= MODE_TOLERANCE_NM for shift in shifts.values()]),
        why="the skew moves the maximum by up to 0.35 widths gamma; only a symmetric curve peaks at lambda_0",
    )


def _family_statements(paints: Sequence[PaintStandIn]) -> tuple[PaperStatement, ...]:
    """Check how well the four-parameter curve describes emission and absorption."""

    def errors(number: int) -> Callable[[PaintStandIn], str]:
        return lambda p: f"{_percent(p.fits[number].residual_rel)} ({_percent(p.fits[number + 2].residual_rel)})"

    def good(values: Sequence[float]) -> Verdict:
        return _verdict([value <= GOOD_FIT_REL for value in values])

    paper = "spectra that are not very spiky follow the skew-Cauchy curve"
    ours = "error of the curve (of a log-normal in wavenumber): "
    return (
        PaperStatement(
            subject="emission curve, whole spectrum seen",
            paper=paper,
            ours=ours + _each(paints, errors(0)),
            verdict=good([p.fits[0].residual_rel for p in paints]),
            why="with all wavelengths measured the equation describes the core; its tails are too heavy",
        ),
        PaperStatement(
            subject="emission curve, eight filter bands seen",
            paper=paper + "; fitted by hand to eight bands",
            ours=ours + _each(paints, errors(1)),
            verdict=good([p.fits[1].residual_rel for p in paints]),
            why="between and beyond the bands the tails decide, and eight bands do not hold them; no equation alone "
            "knows how far a real paint leaves it, so that a fit must carry that as uncertainty",
        ),
        PaperStatement(
            subject="absorption curve",
            paper=paper,
            ours="error: " + _each(paints, lambda p: _percent(p.absorption_fit.residual_rel)),
            verdict=good([p.absorption_fit.residual_rel for p in paints]),
            why="absorption of strong paint is a plateau (all light is absorbed) with a steep red edge",
        ),
    )


def _patch_statement(colour: Colour, paints: Sequence[PaintStandIn]) -> PaperStatement:
    """Compare the reflectance with the ColorChecker patch that the paper names."""
    named = [p.closest_patch.name == p.printed_patch.name for p in paints]
    testable = colour == "red" or any(named)
    return PaperStatement(
        subject=f"reflectance, {colour} paint",
        paper=f"very similar to the ColorChecker patch {PRINTED_PATCH[colour]}",
        ours=_each(
            paints,
            lambda p: (
                f"closest {p.closest_patch.name}, off by {_percent(p.closest_patch.error_rel)}"
                + (
                    ""
                    if p.closest_patch == p.printed_patch
                    else f"; {p.printed_patch.name} by {_percent(p.printed_patch.error_rel)}"
                )
            ),
        ),
        verdict=("holds in part" if any(named) else "does not hold") if testable else "cannot be tested",
        why="even the closest of 24 patches misses the measured reflectance by far more than a measurement: measure it"
        if testable
        else "the stand-ins fluoresce green but look yellow by daylight; even their closest patch misses by far",
    )
