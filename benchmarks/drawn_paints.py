"""Paints drawn from the prior of a model and measured on rigs that are not quite as stated."""

from dataclasses import dataclass, replace

import numpy as np

from data_schemas import BandPassFilter, BandSignals, Optics
from data_schemas.storage import assumed_camera_response, halogen_lamp
from finray_calib.fit import BandData, Discrepancy, EmissionPrior
from finray_calib.fit._band_data import band_values
from finray_calib.fit._filter_design import _known_rig
from finray_calib.fit._measured_spectra import (
    _PROCESS_FLOOR,
    _SECOND_DYE,
    _SIZES,
    Components,
    band_errors,
    components_of,
    height_prior,
    learned_spectra,
)
from finray_calib.fit._prior import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM
from finray_calib.spectra import WAVELENGTH_NM, EmissionFamily, photon_yield, rig_emission_weights
from rigs import simulated_rig

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
NOISE_REL = 0.002


@dataclass(frozen=True)
class DrawnPaint:
    """A paint of the prior with its measurement: theta, emission curve, rig errors in prior sd, band signals."""

    theta: np.ndarray
    curve: np.ndarray
    imperfections: np.ndarray
    bands: BandSignals


def nominal_optics() -> Optics:
    """Return the paper's eight filters with a Bayer camera and a halogen lamp, as the rig file states them."""
    rig = simulated_rig("red")
    return Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        band_uncertainty=rig.band_uncertainty,
        camera_response=assumed_camera_response(),
    )


def drawn_paint(
    family: EmissionFamily, discrepancy: Discrepancy, prior: EmissionPrior, rng: np.random.Generator
) -> DrawnPaint:
    """Draw a paint and measure it.

    Every filter is off its stated centre, width and blocking within its uncertainty; calibration, channel response and
    stray light are off as the rig states them, and so is the lamp's temperature; 0.2 % noise.
    """
    nominal = nominal_optics()
    count = len(nominal.filters)
    imperfections = rng.standard_normal((4, count))  # calibration, blocking, centre, width
    weights = rig_emission_weights(_real(nominal, imperfections, rng.standard_normal()), CHANNEL_WEIGHTS)
    joint = prior.of(family, with_blocking=True)
    theta = joint.draw(1, rng)[0]
    signed = _with_discrepancy(family, theta, discrepancy, rng) * (weights.laser_nm <= WAVELENGTH_NM)
    reflected, blocking = np.exp(theta[-2:])
    mu = band_values(signed[None], np.array([reflected]), weights, blocking)[0]
    stated = nominal.band_uncertainty
    stray = stated.stray_light_rel * mu[~weights.is_excitation].max() * rng.standard_normal(mu.size)
    calibration = 1 + stated.calibration_rel * imperfections[0, weights.band_index]
    response, noise = (1 + rel * rng.standard_normal(mu.size) for rel in (stated.response_rel, NOISE_REL))
    y = mu * calibration * response * noise + stray
    bands = BandSignals(
        paint_name="prior draw",
        optics=nominal,
        fluorescence=y.reshape(-1, 3),
        fluorescence_covariance=np.diag((NOISE_REL * y) ** 2 + 1e-16),
        reflectance=np.full((count, 3), 0.5),
        reflectance_covariance=1e-4 * np.eye(3 * count),
        channel_weights=np.array(CHANNEL_WEIGHTS),
        flags=(("ok", "ok", "ok"),) * count,
        saturated_fraction=np.zeros((count, 3)),
        region_pixels=10_000,
    )
    return DrawnPaint(theta, np.maximum(signed, 0.0), imperfections.ravel(), bands)


def paint_of_the_learned_prior(rng: np.random.Generator) -> tuple[np.ndarray, float, BandData, float]:
    """Return a paint of the learned prior: curve of 0 or more, reflectance, measured data, and sd of ln(blocking).

    The truth is a draw of what the fit believes, cut at zero, its values one of the fit's own likelihood.
    """
    optics = nominal_optics()
    weights, empty = _known_rig(optics)
    parts, ln_blocking_sd = components_of(learned_spectra(), WAVELENGTH_NM, weights.laser_nm), 0.5
    while True:
        curve, reflectance = _paint_and_reflectance(parts, rng)
        if photon_yield(curve[None], WAVELENGTH_NM, weights.laser_nm)[0] <= 1 - reflectance:
            break
    leak = empty.leak_mean * np.exp(ln_blocking_sd**2 / 2)
    mu = band_values(curve[None], np.array([reflectance]), weights, leak[None])[0]
    stated = optics.band_uncertainty
    stray = stated.stray_light_rel * np.abs(mu[~weights.is_excitation & empty.usable.ravel()]).max()
    covariance = np.diag((np.hypot(NOISE_REL, stated.response_rel) * mu) ** 2 + stray**2)
    exact = replace(empty, y=mu.reshape(empty.y.shape), covariance=covariance)
    y = mu.copy()
    y[exact.kept] += band_errors(exact, curve, reflectance, ln_blocking_sd, rng)
    return curve, reflectance, replace(exact, y=y.reshape(empty.y.shape)), ln_blocking_sd


def _paint_and_reflectance(parts: Components, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return curve, cut at zero, and reflectance of one draw of the learned prior."""
    share, above = np.exp(parts.ln_share), parts.wavelength_nm >= parts.laser_nm
    chosen = rng.choice(share.size, 1, p=share / share.sum())
    (size, second) = (rng.choice(*np.transpose(table)[:1], p=np.transpose(table)[1]) for table in (_SIZES, _SECOND_DYE))
    own, departures = parts.curves[chosen[0]], parts.departures(chosen)[0]
    process = parts.process @ rng.standard_normal(parts.process.shape[1])
    curve = own + rng.standard_normal(len(departures)) @ departures + size * (own + _PROCESS_FLOOR) * above * process
    curve += second * rng.standard_normal(len(parts.second)) @ parts.second
    mean, precision = height_prior(parts, chosen)
    both = np.full(2, -1.0)
    while (both <= 0).any():
        both = mean[0] + rng.standard_normal(2) / np.sqrt(precision[0])
    return both[0] * np.maximum(curve, 0.0), float(both[1])


def _real(nominal: Optics, imperfections: np.ndarray, hotter: float) -> Optics:
    """Return the rig as it is, its lamp hotter by that many of its standard uncertainties."""

    def off(band: BandPassFilter, z: np.ndarray) -> BandPassFilter:
        change = {
            "blocking_od": band.blocking_od - band.blocking_uncertainty_od * z[1],
            "center_nm": band.center_nm + band.center_uncertainty_nm * z[2],
            "fwhm_nm": band.fwhm_nm + band.fwhm_uncertainty_nm * z[3],
        }
        return band.model_copy(update=change)

    filters = (off(band, z) for band, z in zip(nominal.filters, imperfections.T, strict=True))
    lamp = halogen_lamp(nominal.lamp_temperature_k + hotter * nominal.lamp_temperature_uncertainty_k)
    return nominal.model_copy(update={"filters": tuple(filters), "lamp": lamp})


def _with_discrepancy(
    family: EmissionFamily, theta: np.ndarray, discrepancy: Discrepancy, rng: np.random.Generator
) -> np.ndarray:
    """Return a curve of the family with a drawn discrepancy, as the model has it: negative where the curve is 0."""
    shape = family.curves(theta[None], WAVELENGTH_NM)[0]
    roots, directions = np.linalg.eigh(discrepancy.smooth_kernel(WAVELENGTH_NM, WAVELENGTH_NM))
    relative = directions @ (np.sqrt(np.maximum(roots, 0)) * rng.standard_normal(roots.size))
    width = np.exp(theta[1])
    edge = 1 / (1 + np.exp((WAVELENGTH_NM - theta[0] + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)))
    relative += discrepancy.reabsorption_rel * rng.standard_normal() * edge
    return shape + (shape + discrepancy.floor_rel * np.exp(theta[2])) * relative
