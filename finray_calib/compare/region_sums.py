"""Sums over one region from which the squared errors of all candidates follow, for images and for their gradients."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.blocks import block_mean
from finray_calib.compare.capture_noise import CaptureNoise
from finray_calib.compare.image_gradient import NOISE_EXCESS, gradient_variance, image_gradient
from finray_calib.compare.render_layers import RenderLayers
from finray_calib.compare.squared_error import NoiseCovariance, SquaredError, noise_covariance, squared_error

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
LEAST_SIGNAL = 3.0
"""A contact signal below this many standard deviations of its noise is none."""


@dataclass(frozen=True, slots=True)
class Captured:
    """Hold the captured images (H, W, 3), NaN where clipped, and the camera's noise."""

    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    noise: CaptureNoise

    def variance(self, image: Floats) -> Floats:
        """Return the noise variance of one of the images."""
        return self.noise.variance(image)

    def blocked(self, side_px: int) -> "Captured":
        """Return the means over blocks of pixels, whose noise is less; a block with a missing pixel is missing."""
        repeat = None if self.repeat is None else block_mean(self.repeat, side_px)
        noise = CaptureNoise(self.noise.offset / side_px**2, self.noise.slope / side_px**2)
        return Captured(block_mean(self.contact, side_px), block_mean(self.no_contact, side_px), repeat, noise)


@dataclass(frozen=True, slots=True)
class RegionSums:
    """Hold everything a region's rows are formed from; arrays have three channels.

    Attributes
    ----------
    where : ndarray of bool, shape (H, W)
        The pixels; of gradients both directions enter.
    pixels : int
        Their number, of gradients times two.
    simulation : SquaredError
        Of the render.
    no_contact_square, product, contact_square : ndarray, shape (3,)
        Sums of B^2, B D and D^2 without noise: the contact signal follows from them for every drift of D.
    floor : ndarray, shape (3,), or None
        Sum of (B' - B)^2 without noise.
    level : ndarray, shape (3,)
        Sum of D; of gradients that of B, which they are relative to.
    noise : NoiseCovariance
    floor_noise_sd : ndarray, shape (3,)
    per_pixel : Mapping of str to ndarray (P, 3)
        Squared "error", "signal" and "floor" of each pixel at the best values, noise taken out, and its "level".
    """

    where: Bools
    pixels: int
    simulation: SquaredError
    no_contact_square: Floats
    product: Floats
    contact_square: Floats
    floor: Floats | None
    level: Floats
    noise: NoiseCovariance
    floor_noise_sd: Floats
    per_pixel: Mapping[str, Floats]

    @property
    def told(self) -> Bools:
        """Channels (3,) whose contact signal stands out of its noise."""
        return np.asarray(self.signal(np.ones(1))[0] > LEAST_SIGNAL * np.sqrt(self.noise.signal))

    def signal(self, drift: Floats) -> Floats:
        """Return the contact signal, sum of (B - g D)^2, for factors g on the capture: (draws, 3)."""
        g = drift[:, None]
        return np.asarray(self.no_contact_square - 2.0 * g * self.product + g**2 * self.contact_square)


def image_sums(
    layers: RenderLayers, captured: Captured, used: Bools, exposure_k: float, pose_names: tuple[str, ...]
) -> RegionSums:
    """Return the sums of the images themselves over the `used` pixels."""
    repeat = captured.repeat
    values = _PixelValues(
        contact=captured.contact[used],
        no_contact=captured.no_contact[used],
        repeat=None if repeat is None else repeat[used],
        contact_variance=captured.variance(captured.contact)[used],
        no_contact_variance=captured.variance(captured.no_contact)[used],
        repeat_variance=None if repeat is None else captured.variance(repeat)[used],
    )
    halves = layers.halves("contact", used, pose_names)
    render_variance = exposure_k**2 * layers.contact_variance[used]
    return _sums(used, halves, values, exposure_k, layers.matrix, render_variance, captured.contact[used], 1.0)


def gradient_sums(
    layers: RenderLayers, captured: Captured, used: Bools, exposure_k: float, pose_names: tuple[str, ...]
) -> RegionSums | None:
    """Return the same of the gradients of (image - its no-contact image), both directions together.

    The no-contact image becomes zero and the capture grad (D - B). A drift g of the capture multiplies grad (D - B);
    the change (g - 1) grad B of the pad's own gradient, below 1 % of it, is left out. None where no pixel has all its
    neighbours.
    """
    b, v_b = captured.no_contact, captured.variance(captured.no_contact)
    signal = image_gradient(captured.contact - b)
    repeat = None if captured.repeat is None else image_gradient(captured.repeat - b)
    whole = used & np.isfinite(signal).all(axis=(0, 3))
    if repeat is not None:
        whole &= np.isfinite(repeat).all(axis=(0, 3))
    if not whole.any():
        return None
    d = _at(signal, whole)
    variance = _at(gradient_variance(captured.variance(captured.contact) + v_b), whole)
    values = _PixelValues(d, np.zeros_like(d), None, variance, np.zeros_like(d), None)
    if captured.repeat is not None and repeat is not None:
        more = _at(gradient_variance(captured.variance(captured.repeat) + v_b), whole)
        values = replace(values, repeat=_at(repeat, whole), repeat_variance=more)
    render_variance = exposure_k**2 * gradient_variance(layers.contact_variance + layers.no_contact_variance)
    halves = _gradient_halves(layers, whole, pose_names)
    level = np.concatenate([b[whole]] * 2)
    excess = NOISE_EXCESS
    return _sums(whole, halves, values, exposure_k, layers.matrix, _at(render_variance, whole), level, excess)


@dataclass(frozen=True, slots=True)
class _PixelValues:
    """Captured values (P, 3) and the variances of their noise."""

    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    contact_variance: Floats
    no_contact_variance: Floats
    repeat_variance: Floats | None


def _sums(
    where: Bools,
    halves: tuple[Floats, Floats],
    values: _PixelValues,
    exposure_k: float,
    matrix: Floats,
    render_variance: Floats,
    level: Floats,
    noise_excess: float,
) -> RegionSums:
    """Form all sums from pixel lists."""
    d, b, v_d, v_b = values.contact, values.no_contact, values.contact_variance, values.no_contact_variance
    layers = matrix.shape[1]
    first, second = (exposure_k * half[:, :layers] @ matrix.T for half in halves)
    error, signal = (first + second) / 2.0 - d, b - d
    noise = noise_covariance(error, signal, render_variance, v_d, v_b)
    per_pixel = {"error": (first - d) * (second - d) - v_d, "signal": signal**2 - v_b - v_d, "level": level}
    floor, floor_sd = None, np.zeros(d.shape[1])
    if values.repeat is not None and values.repeat_variance is not None:
        # of gradients the repeat is already a difference, and b is zero without noise
        v = values.repeat_variance + v_b
        per_pixel["floor"] = (values.repeat - b) ** 2 - v
        floor = per_pixel["floor"].sum(axis=0)
        clean = np.maximum(per_pixel["floor"], 0.0)
        floor_sd = np.sqrt(noise_excess * (4.0 * clean * v + 2.0 * v**2).sum(axis=0))
    return RegionSums(
        where=where,
        pixels=len(d),
        simulation=squared_error(halves, d, v_d),
        no_contact_square=(b**2 - v_b).sum(axis=0),
        product=(b * d).sum(axis=0),
        contact_square=(d**2 - v_d).sum(axis=0),
        floor=floor,
        level=level.sum(axis=0),
        noise=NoiseCovariance(noise.error * noise_excess, noise.signal * noise_excess, noise.both * noise_excess),
        floor_noise_sd=floor_sd,
        per_pixel=per_pixel,
    )


def _at(gradient: Floats, where: Bools) -> Floats:
    """Return both directions at some pixels, one after the other: (2 P, C)."""
    return np.concatenate([gradient[0][where], gradient[1][where]])


def _gradient_halves(layers: RenderLayers, where: Bools, pose_names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Return both halves of the gradients of contact minus no contact, and of the pose derivatives."""
    mean = layers.contact - layers.no_contact
    half = layers.contact_half - layers.no_contact_half
    poses = [layers.pose_names.index(name) for name in pose_names]
    means, differences = (
        np.concatenate([_at(image_gradient(image), where) for image in (first, *(more[n] for n in poses))], axis=1)
        for first, more in ((mean, layers.pose), (half, layers.pose_half))
    )
    return means + differences, means - differences
