"""Tables of a fluorescent paint for the path tracers that change wavelength on the way."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from data_schemas.optical_design import LightPanel
from sim.optics.paint_bands import PaintOptics, led_band, led_upper_edge_nm

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
            raise SimulateError(
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
            f"paint {paint.name} has no absorption_rel: full spectra need to know what other wavelengths excite it"
        )
    edge, own, led = led_upper_edge_nm(light), paint.wavelength_nm, led_band(light)
    wavelength = np.unique(np.concatenate([own, [np.clip(edge, own[0], own[-1])], led.wavelength_nm]))
    emission = np.interp(wavelength, own, paint.emission_per_nm, left=0.0, right=0.0) * (wavelength >= edge)
    absorbed = np.interp(wavelength, own, paint.absorption_rel, left=0.0, right=0.0) * wavelength
    excitation = absorbed / np.trapezoid(
        np.interp(led.wavelength_nm, wavelength, absorbed) * led.density_per_nm, led.wavelength_nm
    )
    return FluorescentPaint(paint.name, wavelength, emission, excitation, np.interp(wavelength, own, paint.reflectance))
