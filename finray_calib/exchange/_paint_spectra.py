"""What every export of a paint is made of: its curves as plain arrays, and JSON that people can read.

Such JSON has one key per line, and lists of plain values on one line.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import CurveError, PaintCalibration

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PaintSpectra:
    """Emission, relative absorption and reflectance of one paint with their uncertainties.

    The absorption counts photons; the bispectral radiance factor per nm of emission counts energy:
    ``D(out, in) = emission_per_nm(out) absorption_rel(in) in / laser_nm`` for out > in and zero elsewhere. Draw k of
    the emission belongs to draw k of the absorption.

    Attributes
    ----------
    name
        The paint.
    statement
        What the absorption rests on, in words.
    warnings
        What the fit warns of.
    laser_nm
        Excitation of the emission.
    wavelength_nm, emission_per_nm
        (L,) grid and posterior mean of the emission for excitation at the laser line, 1/nm.
    emission_draws_per_nm
        (N, L) posterior draws of the emission, 1/nm.
    excitation_nm, absorption_rel
        (E,) grid and posterior mean of the absorption of photons relative to that at the laser line.
    absorption_rel_draws
        (N, E) its posterior draws.
    reflectance_nm, reflectance, reflectance_sd
        (K,) increasing filter centres, non-fluorescent reflectance there (0..1) and its standard deviation.
    """

    name: str
    statement: str
    warnings: tuple[str, ...]
    laser_nm: float
    wavelength_nm: Floats
    emission_per_nm: Floats
    emission_draws_per_nm: Floats
    excitation_nm: Floats
    absorption_rel: Floats
    absorption_rel_draws: Floats
    reflectance_nm: Floats
    reflectance: Floats
    reflectance_sd: Floats

    def __post_init__(self) -> None:
        draws, sizes = len(self.emission_draws_per_nm), (len(self.wavelength_nm), len(self.excitation_nm))
        shapes: dict[str, tuple[int, ...]] = {
            "emission_per_nm": sizes[:1],
            "emission_draws_per_nm": (draws, sizes[0]),
            "absorption_rel": sizes[1:],
            "absorption_rel_draws": (draws, sizes[1]),
            "reflectance": (len(self.reflectance_nm),),
            "reflectance_sd": (len(self.reflectance_nm),),
        }
        for field, wanted in shapes.items():
            found = getattr(self, field).shape
            if found != wanted:
                raise CurveError(
                    f"paint '{self.name}': {field} has shape {found}, wanted {wanted} (draws of emission and "
                    "absorption are paired); run 'finray fit' again"
                )

    @property
    def excitation_rel(self) -> Floats:
        """Energy emitted per incident energy relative to that at the laser line, posterior mean (E,)."""
        return self.absorption_rel * self.excitation_nm / self.laser_nm

    @property
    def excitation_rel_draws(self) -> Floats:
        """Posterior draws (N, E) of :attr:`excitation_rel`."""
        return self.absorption_rel_draws * self.excitation_nm / self.laser_nm

    def reflectance_at(self, wavelength_nm: Floats) -> Floats:
        """Return the reflectance (0..1), linear between the filters and held beyond the outer ones."""
        return np.asarray(np.interp(wavelength_nm, self.reflectance_nm, self.reflectance))


def paint_spectra(paint: PaintCalibration) -> PaintSpectra:
    """Return the curves of a calibrated paint.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.

    Raises
    ------
    CurveError
        The draws of emission and absorption are not paired one to one.
    """
    reradiation = paint.reradiation
    centers_nm = np.array([f.center_nm for f in paint.optics.filters])
    order = np.argsort(centers_nm)
    return PaintSpectra(
        name=paint.paint_name,
        statement=reradiation.statement,
        warnings=paint.warnings,
        laser_nm=reradiation.laser_nm,
        wavelength_nm=paint.wavelength_nm,
        emission_per_nm=paint.emission_per_nm,
        emission_draws_per_nm=np.asarray(paint.emission_draws_per_nm, dtype=np.float64),
        excitation_nm=reradiation.excitation_nm,
        absorption_rel=reradiation.absorption_rel,
        absorption_rel_draws=np.asarray(reradiation.absorption_rel_draws, dtype=np.float64),
        reflectance_nm=centers_nm[order],
        reflectance=np.clip([r.estimate for r in paint.reflectance], 0.0, 1.0)[order],
        reflectance_sd=np.array([r.sd for r in paint.reflectance])[order],
    )


def readable_json(content: dict[str, Any]) -> str:
    """Return JSON text with objects indented and every list without objects inside on one line.

    Parameters
    ----------
    content
        Dicts, lists, texts, finite numbers, booleans and None.
    """
    return _text(content, 0) + "\n"


def _text(value: Any, depth: int) -> str:
    """Return a value, indented by its depth."""
    inner, outer = " " * (depth + 1), " " * depth
    if isinstance(value, dict) and value:
        rows = (f"{inner}{_plain(str(key))}: {_text(item, depth + 1)}" for key, item in value.items())
        return "{\n" + ",\n".join(rows) + f"\n{outer}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "[\n" + ",\n".join(inner + _text(item, depth + 1) for item in value) + f"\n{outer}]"
    return _plain(value)


def _plain(value: Any) -> str:
    """Return a value on one line; NaN has no place in JSON."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
