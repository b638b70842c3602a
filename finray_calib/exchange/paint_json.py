"""A paint as one small, plain JSON object that explains itself: for programs that know nothing of finray."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.estimate import Estimate
from data_schemas.fit import PaintCalibration
from data_schemas.provenance import Provenance
from finray_calib.exchange.paint_spectra import PaintSpectra
from finray_calib.exchange.paint_text import QUANTITY
from finray_calib.exchange.readable_json import readable_json

Floats = NDArray[np.float64]
DIGITS = 6


def json_text(paint: PaintCalibration, spectra: PaintSpectra, origin: Provenance) -> str:
    """Return emission, absorption and reflectance with 68 % and 95 % limits, and the parameters, as JSON.

    Parameters
    ----------
    paint
        Record written by ``finray fit``.
    spectra
        Its curves.
    origin
        Provenance of the export.
    """
    low95, low68, high68, high95 = np.quantile(spectra.absorption_rel_draws, [0.025, 0.16, 0.84, 0.975], axis=0)
    content = {
        "what": "fluorescent paint: emission, absorption and reflectance with uncertainty",
        "paint": paint.paint_name,
        "family": paint.family_title,
        "family_choice": paint.family_choice,
        "warnings": list(paint.warnings),
        "model": "radiance factor per nm (energy): D(out, in) = emission_per_nm(out) * absorption_rel(in) * in / "
        "excitation_nm for out > in, else 0; reflectance is apart",
        "emission": {
            "quantity": QUANTITY,
            "excitation_nm": spectra.laser_nm,
            "wavelength_nm": _numbers(paint.wavelength_nm),
            "mean_per_nm": _numbers(paint.emission_per_nm),
            "low68_per_nm": _numbers(paint.emission_low68_per_nm),
            "high68_per_nm": _numbers(paint.emission_high68_per_nm),
            "low95_per_nm": _numbers(paint.emission_low95_per_nm),
            "high95_per_nm": _numbers(paint.emission_high95_per_nm),
        },
        "absorption": {
            "quantity": "photons absorbed relative to those at the laser line",
            "statement": spectra.statement,
            "excitation_nm": _numbers(spectra.excitation_nm),
            "mean_rel": _numbers(spectra.absorption_rel),
            "low68_rel": _numbers(low68),
            "high68_rel": _numbers(high68),
            "low95_rel": _numbers(low95),
            "high95_rel": _numbers(high95),
        },
        "reflectance": [
            {"center_nm": band.center_nm, "filter": band.name, **_estimate(value)}
            for band, value in zip(paint.optics.filters, paint.reflectance, strict=True)
        ],
        "parameters": {name: _estimate(value) for name, value in paint.parameters.items()},
        "energy_yield": _estimate(paint.energy_yield),
        "provenance": origin.model_dump(mode="json"),
    }
    return readable_json(content)


def _numbers(values: Floats) -> list[float]:
    """Return the values rounded to what any uncertainty here can use."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _estimate(value: Estimate) -> dict[str, Any]:
    """Return median, standard deviation and limits."""
    return value.model_dump(mode="json")
