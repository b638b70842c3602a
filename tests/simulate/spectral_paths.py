"""The same paths with four wavelengths each in place of three bands: what bands are measured against.

The loop is that of :mod:`sim.optics._fluorescent_paths`, in an ``*_ad_spectral`` variant. At paint each wavelength, on
its own, is either reflected or replaced by an excitation wavelength; light met later is read at the new wavelength,
while the film still develops with the old one, so ``specfilm`` works unchanged.

Why it is done so (what went wrong with a fixed probability of 0.6 to fluoresce, one decision for all four wavelengths):

- A reflection kept with probability 0.4 and roulette 0.8 multiplies the second moment of the weight by
  rho^2 / (0.4 * 0.8) per bounce, 1.47 to 1.66 for a red paint of rho = 0.69 to 0.73 at 650-700 nm. Above one the
  variance of the radiance is infinite: usual runs read low by several of their own standard errors, and now and then
  one path of 200 000 carries a quarter of the sum. Here the probability of reflection is at least
  rho, so that factor is rho^2 / p <= rho < 1 and every moment is finite.
- One decision for four wavelengths cannot fit all of them: rho and the emission differ between them. Paint is
  Lambertian, so nothing ties the decisions together.
- The excitation wavelength is drawn from a density with the paint's excitation in it, by cells that are
  never drawn where their probability is zero: weights are bounded, no end of an inverse distribution divides them.
- The rare non-finite pixel did not come from the paint. The aluminium's n and k ended at 700 nm, where the renderer's
  ``irregular`` spectrum falls to zero, and Fresnel's formula with n = k = 0 is 0 / 0 at exactly normal incidence (and a
  wrong reflectance of one elsewhere). Spectra of a scene therefore hold their ends, see
  :func:`sim.optics._scene.extended_spectrum`.
  (With multiple importance sampling there is a second source, once in 2^23 draws: a direction exactly in the painted
  surface, whose density is 0; such paths end, see :mod:`sim.optics._fluorescent_paths`.)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImpossibleFingerError, LightPanel, SimulateError
from sim.optics import PaintOptics
from sim.optics._fluorescent_paths import PanelLight, fluorescent_integrator, painted_bsdfs
from sim.optics._paint_bands import led_band, led_upper_edge_nm
from sim.optics._path_rules import MAX_DEPTH, ROULETTE_DEPTH, LookupTable, cell_at
from sim.optics._renderer import check_variant
from sim.optics._scene import RENDERED_NM

# a paint fitted to data may exceed photon balance by rounding only
_BALANCE_TOLERANCE = 1e-9
_FINE_STEP_NM = 0.1


@dataclass(frozen=True, slots=True)
class FluorescentPaint:
    """A Lambertian paint with reradiation matrix F(lo, li) = emission_per_nm(lo) * excitation_rel(li), rank one.

    Between the wavelengths the tables are linear; outside, emission and excitation are zero and reflectance holds its
    end values. ``F`` is energy per nm at lo for energy at li. With quantum yield Q, absorptance a and the photons'
    emission density n, emission_per_nm = n(lo) / lo and excitation_rel = Q a(li) li.
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    emission_per_nm: NDArray[np.float64]
    excitation_rel: NDArray[np.float64]
    reflectance: NDArray[np.float64]

    def __post_init__(self) -> None:
        curves = (self.wavelength_nm, self.emission_per_nm, self.excitation_rel, self.reflectance)
        if len({c.shape for c in curves}) != 1 or self.wavelength_nm.ndim != 1 or self.wavelength_nm.size < 2:
            raise SimulateError(
                f"paint {self.name}: wavelength_nm, emission_per_nm, excitation_rel and reflectance must be equally "
                f"long lists of at least 2 values, got shapes {[c.shape for c in curves]}"
            )
        if not all(np.isfinite(c).all() for c in curves) or (np.diff(self.wavelength_nm) <= 0.0).any():
            raise SimulateError(f"paint {self.name}: all values must be finite and wavelength_nm must increase")
        if any((c < 0.0).any() for c in curves):
            raise SimulateError(f"paint {self.name}: emission_per_nm, excitation_rel and reflectance must be >= 0")
        photons = self.reflectance + self.photon_yield()
        worst = int(np.argmax(photons))
        if photons[worst] > 1.0 + _BALANCE_TOLERANCE:
            raise ImpossibleFingerError(
                f"paint {self.name} returns {photons[worst]:.3f} photons per photon at "
                f"{self.wavelength_nm[worst]:g} nm (reflected and emitted; at most 1); lower its emission_per_nm, "
                "excitation_rel or reflectance"
            )

    def photon_yield(self) -> NDArray[np.float64]:
        """Return the photons emitted per incident photon at each wavelength: excitation / li * integral em lo dlo."""
        fine = self.fine_nm()
        emitted = np.trapezoid(np.interp(fine, self.wavelength_nm, self.emission_per_nm) * fine, fine)
        return np.asarray(self.excitation_rel * emitted / self.wavelength_nm)

    def fine_nm(self) -> NDArray[np.float64]:
        """Return wavelengths fine enough to integrate products of the tables."""
        low, high = self.wavelength_nm[[0, -1]]
        return np.linspace(low, high, int(np.ceil((high - low) / _FINE_STEP_NM)) + 1)

    def at(self, wavelength_nm: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return emission_per_nm, excitation_rel and reflectance at other wavelengths."""
        own = self.wavelength_nm
        return (
            np.interp(wavelength_nm, own, self.emission_per_nm, left=0.0, right=0.0),
            np.interp(wavelength_nm, own, self.excitation_rel, left=0.0, right=0.0),
            np.interp(wavelength_nm, own, self.reflectance),
        )


def fluorescent_paint(paint: PaintOptics, light: LightPanel) -> FluorescentPaint:
    """Return a calibrated paint for full spectra, with the same conversion as :func:`paint_bands` gives the bands.

    F(lo, li) = emission(lo) a(li) li / (mean of a(l) l over the LED), the emission kept above the LED's upper edge.

    Raises
    ------
    SimulateError
        When the paint has no absorption, or when it would return more photons than it gets.
    """
    if paint.absorption_rel is None:
        raise SimulateError(
            f"paint {paint.name} has no absorption_rel: full spectra need it, to know how other wavelengths "
            "excite the paint; give absorption_rel"
        )
    edge, own, led = led_upper_edge_nm(light), paint.wavelength_nm, led_band(light)
    wavelength = np.unique(np.concatenate([own, [np.clip(edge, own[0], own[-1])], led.wavelength_nm]))
    emission = np.interp(wavelength, own, paint.emission_per_nm, left=0.0, right=0.0) * (wavelength >= edge)
    absorbed = np.interp(wavelength, own, paint.absorption_rel, left=0.0, right=0.0) * wavelength
    excitation = absorbed / np.trapezoid(
        np.interp(led.wavelength_nm, wavelength, absorbed) * led.density_per_nm, led.wavelength_nm
    )
    return FluorescentPaint(paint.name, wavelength, emission, excitation, np.interp(wavelength, own, paint.reflectance))


# shares of the excitation wavelengths drawn where the lights shine and where paints emit; the rest after the
# excitation alone, which bounds every weight
_SHARE_AT_LIGHTS, _SHARE_AT_EMISSION = 0.5, 0.2
# light that excites is taken to be this much brighter than light that is reflected, at most: it decides noise only
_BRIGHTER_AT_EXCITATION = 10.0
_CELLS = int(RENDERED_NM[1] - RENDERED_NM[0])


class SpectralCarrier:
    """Throughput of a path's four wavelengths."""

    def __init__(self, paints: Sequence[FluorescentPaint], lights_per_nm: NDArray[np.float64]) -> None:
        tables = [_paint_tables(paint, paints, lights_per_nm) for paint in paints]
        self.surface, self.choice, self.excitation = (
            LookupTable(np.concatenate([t[k] for t in tables]), mi) for k in range(3)
        )
        self.lights = LookupTable(lights_per_nm[:, None], mi)
        self.yields = LookupTable(np.array([[np.trapezoid(_on_grid(p)[1])] for p in paints]), mi)

    def start(self) -> Any:
        """Return full throughput."""
        return mi.Spectrum(1)

    def received(self, carried: Any, light: Any) -> Any:
        """Return the light that arrives at each wavelength of the film."""
        return carried * light

    def scattered(self, carried: Any, weight: Any) -> Any:
        """Return the throughput after a surface."""
        return carried * weight

    def largest(self, carried: Any) -> Any:
        """Return the largest throughput of the wavelengths."""
        return dr.max(carried)

    def panel_light(self, si: Any, radiance: Any) -> Any:
        """Return radiance times the power per nm of the lights at the path's wavelengths."""
        light = mi.Spectrum(0)
        for k in range(len(light)):
            position = dr.clip(si.wavelengths[k] - RENDERED_NM[0], 0.0, _CELLS - 1e-3)
            cell = cell_at(position, _CELLS)
            low, high = (self.lights.row(cell + j) for j in (0, 1))
            light[k] = radiance * dr.lerp(low, high, position - cell)
        return light

    def reradiated(self, carried: Any, si: Any, sampler: Any, paint: Any, painted: Any) -> Any:
        """Reflect each wavelength or replace it by an excitation wavelength; return the throughput."""
        decisions, places = sampler.next_1d(painted), sampler.next_1d(painted)
        wavelengths, weights = mi.Spectrum(si.wavelengths), mi.Spectrum(1)
        count = len(wavelengths)
        for k in range(count):
            wavelengths[k], weights[k] = self._event(
                wavelengths[k], paint, painted, _rotated(decisions, k / count), _rotated(places, k / count)
            )
        si.wavelengths = dr.select(painted, wavelengths, si.wavelengths)
        return dr.select(painted, carried * weights, carried)

    def _event(self, wavelength_nm: Any, paint: Any, painted: Any, decision: Any, place: Any) -> tuple[Any, Any]:
        """Return the next wavelength and its weight, where one decision and one place have been drawn."""
        position = dr.clip(wavelength_nm - RENDERED_NM[0], 0.0, _CELLS - 1e-3)
        cell = cell_at(position, _CELLS)
        row = self.surface.row(paint * _CELLS + cell, painted)
        within = position - cell
        reflectance, emission = dr.lerp(row.x, row.y, within), dr.lerp(row.z, row.w, within)
        fluorescence = emission * self.yields.row(paint, painted)
        share = reflectance / (reflectance + _BRIGHTER_AT_EXCITATION * fluorescence)
        # at least the reflectance itself, so that the second moment of a chain of reflections shrinks
        p_reflect = dr.select(fluorescence > 0, dr.maximum(share, reflectance), 1.0)
        reflects = decision < p_reflect

        scaled = dr.minimum(place * _CELLS, _CELLS - 1e-3)
        drawn = cell_at(scaled, _CELLS)
        rest = scaled - drawn
        choice = self.choice.row(paint * _CELLS + drawn, painted)
        kept = rest < choice.x
        rest = dr.select(kept, rest / choice.x, (rest - choice.x) / (1 - choice.x))
        drawn = dr.select(kept, drawn, cell_at(choice.y, _CELLS))
        excitation = self.excitation.row(paint * _CELLS + drawn, painted)
        weight = emission * dr.lerp(excitation.x, excitation.y, rest) * excitation.z / (1 - p_reflect)
        return (
            dr.select(reflects, wavelength_nm, RENDERED_NM[0] + mi.Float(drawn) + rest),
            dr.select(reflects, reflectance / p_reflect, weight),
        )


def fluorescent_spectrum(
    scene: Any,
    paints: Mapping[str, FluorescentPaint],
    light_wavelength_nm: NDArray[np.float64],
    light_power_rel: NDArray[np.float64],
    max_depth: int = MAX_DEPTH,
    roulette_depth: int = ROULETTE_DEPTH,
    panels: PanelLight | None = None,
) -> Any:
    """Return the integrator of path-wise fluorescence in full spectra.

    Parameters
    ----------
    scene
        Scene of a spectral variant.
    paints
        By id of the painted surfaces or of their BSDF; a table replaces the reflectance of its BSDF. Empty
        without paint.
    light_wavelength_nm, light_power_rel
        Where the scene's lights shine, shape (n,) each, >= 0: a hint that lowers the noise, and with `panels` their
        power per nm.
    max_depth, roulette_depth
        Longest path, and from where on paths end by chance.
    panels
        LED panels of a finger, connected through its inner face, see :func:`fluorescent_integrator`.

    Raises
    ------
    SimulateError
        When the variant is not a spectral variant or when no surface has one of the ids.
    """
    check_variant("spectral", "full spectra")
    grid = np.linspace(*RENDERED_NM, _CELLS + 1)
    lights = np.interp(grid, light_wavelength_nm, light_power_rel, left=0.0, right=0.0)
    bsdfs = painted_bsdfs(scene, list(paints))
    tables = list(paints.values()) or [FluorescentPaint("none", grid, *np.zeros((3, grid.size)))]
    return fluorescent_integrator(SpectralCarrier(tables, lights), bsdfs, max_depth, roulette_depth, panels)


def _on_grid(paint: FluorescentPaint) -> tuple[NDArray[np.float64], ...]:
    """Return emission, excitation and reflectance at whole nanometres."""
    return paint.at(np.linspace(*RENDERED_NM, _CELLS + 1))


def _paint_tables(
    paint: FluorescentPaint, paints: Sequence[FluorescentPaint], lights_per_nm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return per cell of 1 nm: (reflectance, emission) at both ends; (share kept, alias); (excitation, 1 / density)."""
    emission, excitation, reflectance = _on_grid(paint)
    others = np.sum([_on_grid(p)[0] for p in paints], axis=0)
    density = np.zeros(_CELLS)
    plain = 1.0 - _SHARE_AT_LIGHTS - _SHARE_AT_EMISSION
    for share, favoured in (
        (plain, np.ones(_CELLS + 1)),
        (_SHARE_AT_LIGHTS, lights_per_nm),
        (_SHARE_AT_EMISSION, others),
    ):
        cells = _cell_means(excitation) * _cell_means(favoured)
        if cells.sum() > 0.0:
            density += share * cells / cells.sum()
    if density.sum() == 0.0:
        density[:] = 1.0
    density /= density.sum()
    kept, alias = _alias_table(density)
    inverse = np.divide(1.0, density, out=np.zeros(_CELLS), where=density > 0.0)
    surface = np.column_stack([reflectance[:-1], reflectance[1:], emission[:-1], emission[1:]])
    drawn = np.column_stack([excitation[:-1], excitation[1:], inverse, np.zeros(_CELLS)])
    return surface, np.column_stack([kept, alias]), drawn


def _cell_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((values[1:] + values[:-1]) / 2.0)


def _alias_table(probability: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Walker's alias table (Vose 1991): cell k is kept with kept[k], else replaced by alias[k]."""
    scaled = probability * probability.size
    kept, alias = np.ones(probability.size), np.arange(probability.size, dtype=np.float64)
    small, large = list(np.flatnonzero(scaled < 1.0)), list(np.flatnonzero(scaled >= 1.0))
    while small and large:
        low, high = small.pop(), large[-1]
        kept[low], alias[low] = scaled[low], high
        scaled[high] -= 1.0 - scaled[low]
        if scaled[high] < 1.0:
            small.append(large.pop())
    return kept, alias


def _rotated(sample: Any, by: float) -> Any:
    """Return a uniform sample moved round the unit interval."""
    moved = sample + by
    return dr.select(moved >= 1, moved - 1, moved)
