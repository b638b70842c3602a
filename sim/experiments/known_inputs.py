"""How sure the colours of a render are: draws of both paints and of the camera, as factors on its layers."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from data_schemas.fit import PaintCalibration
from data_schemas.simulate import KnownInputs
from sim.experiments.painted_finger import COLOURS, PaintedFinger, response_matrix
from sim.optics.chain_images import conversion_gains, steps
from sim.optics.paint_bands import BAND_NAMES, PaintBands, paint_bands

Floats = NDArray[np.float64]
DRAWS = 1000
"""Of each input; a standard deviation is then known to 2 %."""

# a calibration whose draws mostly break the conservation of energy says nothing about a real paint
_LARGEST_UNPHYSICAL_SHARE = 0.5


def known_inputs(
    finger: PaintedFinger,
    calibrations: Mapping[str, PaintCalibration],
    paint_sha256: Mapping[str, str],
    chains: Sequence[str],
    draws: int = DRAWS,
) -> KnownInputs:
    """Return draws of what decides the colours: paints with a calibration, and the camera's response.

    A chain's light is proportional to each conversion on its way, and channel c sees its last band with the response
    R[c, band]; so the matrix from chains to RGB of draw d is that of the best values times
    (R_d / R_0)[c, band] * product over steps of (K_d / K_0). Paints are drawn from their posterior without the draws
    that break the conservation of energy. The camera's factors are log-normal with mean 1: the scale of each channel's
    curve, and on top of it each channel's response in the LED's band.

    Parameters
    ----------
    finger
        Paints at their posterior means.
    calibrations, paint_sha256
        "red" and "green", where calibrated: the fits and the checksums of their files.
    chains
        Chains of the render, in its order.
    draws
        Draws of each input.

    Raises
    ------
    SimulateError
        More than half the draws of a paint return more light than they get.
    """
    mean = paint_bands(finger.paints["red"], finger.paints["green"], finger.design.light)
    names, keys, evaluations, sources, factors = [], [], [], [], []
    for colour in COLOURS:
        if colour in calibrations:
            key = paint_sha256.get(colour, calibrations[colour].paint_name)
            names.append(f"{colour} paint")
            keys.append(key)
            evaluations.append("A")
            sources.append(f"posterior of {calibrations[colour].paint_name}")
            factors.append(_paint_factors(finger, colour, calibrations[colour], mean, chains, draws, _rng(key)))
    camera_key = "; ".join(f"{c.source} +- {c.uncertainty_rel:g}" for c in finger.response)
    at_led = finger.design.camera.response_at_led_uncertainty_rel
    camera_key += f"; at the LED +- {at_led:g}"
    return KnownInputs(
        names=(*names, "camera response"),
        keys=(*keys, camera_key),
        evaluations=(*_evaluations(evaluations), "B"),
        sources=(*sources, f"{finger.response[0].source}; at the LED stated as {at_led:.0%}"),
        factors=np.array([*factors, _camera_factors(finger, chains, draws, _rng(camera_key))], dtype=np.float32),
    )


def _evaluations(names: Sequence[str]) -> tuple[Literal["A"], ...]:
    """Return one "A" per paint."""
    return tuple("A" for _ in names)


def _rng(key: str) -> np.random.Generator:
    """Return the generator of an input: the same key gives the same draws in every render."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little"))


def _paint_factors(
    finger: PaintedFinger,
    colour: str,
    calibration: PaintCalibration,
    mean: PaintBands,
    chains: Sequence[str],
    draws: int,
    rng: np.random.Generator,
) -> Floats:
    """Return factors (draw, 3, chain) of one paint."""
    best = response_matrix(finger.response, mean)
    found: list[Floats] = []
    tried, emission = 0, calibration.emission_draws_per_nm
    while len(found) < draws:
        tried += 1
        if tried - len(found) > max(20, _LARGEST_UNPHYSICAL_SHARE * tried):
            raise SimulateError(
                f"more than half the posterior draws of {calibration.paint_name} return more light than the paint "
                "gets; check the white reference of its session"
            )
        paint = replace(finger.paints[colour], emission_per_nm=np.maximum(emission[rng.integers(len(emission))], 0.0))
        try:
            bands = paint_bands(**{**finger.paints, colour: paint}, light=finger.design.light)
        except SimulateError:
            continue
        gains = conversion_gains(mean.conversion, bands.conversion)
        response = response_matrix(finger.response, bands)
        # a channel that is blind to a band stays so
        change = np.divide(response, best, out=np.ones_like(best), where=best > 0.0)
        found.append(_of_chains(change, chains, gains))
    return np.array(found)


def _of_chains(response: Floats, chains: Sequence[str], gains: Mapping[tuple[str, str], float]) -> Floats:
    """Return factors (3, chain): of the last band's response, times the gains on the chain's way."""
    last = [BAND_NAMES.index(chain.rsplit(">", 1)[-1]) for chain in chains]
    gain = np.array([np.prod([gains[step] for step in steps(chain)]) for chain in chains])
    return np.asarray(response[:, last] * gain)


def _camera_factors(finger: PaintedFinger, chains: Sequence[str], draws: int, rng: np.random.Generator) -> Floats:
    """Return factors (draw, 3, chain) of the camera."""
    scale = _log_normal(np.array([curve.uncertainty_rel for curve in finger.response]), draws, rng)
    at_led = _log_normal(np.full(3, finger.design.camera.response_at_led_uncertainty_rel), draws, rng)
    is_led = np.array([chain.rsplit(">", 1)[-1] == "led" for chain in chains])
    return scale[..., None] * np.where(is_led, at_led[..., None], 1.0)


def _log_normal(sd_rel: Floats, draws: int, rng: np.random.Generator) -> Floats:
    """Return factors (draw, n) of mean 1 and these standard deviations."""
    sigma = np.sqrt(np.log1p(sd_rel**2))
    return np.asarray(np.exp(sigma * rng.standard_normal((draws, len(sd_rel))) - 0.5 * sigma**2))
