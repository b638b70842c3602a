"""Sums over one region from which the squared errors of all candidates follow, for images and for their gradients.

A simulated press is held as layers L: images whose sums, weighted by m (paints, camera, pose) and an exposure factor k,
are the render k m . L. Its squared error to the capture D, summed over pixels, is k^2 m'A m - 2 k m'b + d with sums A,
b, d that are formed once, so that every draw of the inputs costs a few products. A comes from the product of two
independent halves of the render, and the noise variance of the capture is taken out of d: what is left is the squared
error of the noise-free images.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, KnownInputs, SimulatedPress
from finray_calib.compare._image_noise import (
    NOISE_EXCESS,
    CaptureNoise,
    block_mean,
    gradient_variance,
    has_gradient,
    image_gradient,
)
from finray_calib.compare._regions import pixels_within

Floats = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class RenderLayers:
    """Hold both states of a render as two independent halves of layers.

    RGB = matrix @ layers. The product of the halves has no noise of its own in the mean, so squared errors taken from
    it are those of the noise-free render. A press that is no render has its three channels as layers and no noise.

    Attributes
    ----------
    contact, no_contact : ndarray, shape (H, W, L)
        Mean of the halves.
    contact_half, no_contact_half : ndarray, shape (H, W, L)
        Half the difference of the halves.
    pose, pose_half : ndarray, shape (N, H, W, L)
        Derivatives of the contact layers, per mm; N may be 0.
    pose_names : tuple of str
    matrix : ndarray, shape (3, L)
    inputs : KnownInputs or None
        Draws of what decides the matrix.
    rest_noise : ndarray, shape (H, W, 3), or None
        Of a press that begins from the captured image without contact: factor on the variance of that image's noise,
        which the contact image holds as well. None: it holds none.
    """

    contact: Image
    no_contact: Image
    contact_half: Image
    no_contact_half: Image
    pose: Image
    pose_half: Image
    pose_names: tuple[str, ...]
    names: tuple[str, ...]
    matrix: Floats
    inputs: KnownInputs | None
    rest_noise: Floats | None = None

    @property
    def contact_variance(self) -> Floats:
        """Variance (H, W, 3) of the contact render."""
        if not self.contact_half.any():
            return np.zeros((*self.contact_half.shape[:2], 3))
        return self.rgb(self.contact_half) ** 2

    @property
    def no_contact_variance(self) -> Floats:
        """Variance (H, W, 3) of the render without contact."""
        return self.rgb(self.no_contact_half) ** 2

    def rgb(self, layers: Image) -> Floats:
        """Return matrix @ layers as (H, W, 3)."""
        if np.array_equal(self.matrix, np.eye(3)):  # the product would give the same digits, later
            return layers.astype(np.float64)
        return np.asarray(layers.astype(np.float64) @ self.matrix.T)

    @property
    def without_noise(self) -> "RenderLayers":
        """The same layers as if both halves were their mean: nothing is taken out of squared errors."""
        dark, still = np.zeros_like(self.contact_half), np.zeros_like(self.pose_half)
        return replace(self, contact_half=dark, no_contact_half=dark, pose_half=still)

    def blocked(self, side_px: int) -> "RenderLayers":
        """Return the means over blocks of pixels."""
        contact = block_mean(self.contact, side_px)
        pose, pose_half = (
            np.array([block_mean(image, side_px) for image in images]).reshape(-1, *contact.shape)
            for images in (self.pose, self.pose_half)
        )
        return replace(
            self,
            contact=contact,
            no_contact=block_mean(self.no_contact, side_px),
            contact_half=block_mean(self.contact_half, side_px),
            no_contact_half=block_mean(self.no_contact_half, side_px),
            pose=pose,
            pose_half=pose_half,
            rest_noise=None if self.rest_noise is None else block_mean(self.rest_noise, side_px),
        )

    def at(self, where: NDArray[np.bool_]) -> "RenderLayers":
        """Return the same at some pixels (H, W) only, as images of a single row."""
        states = ("contact", "no_contact", "contact_half", "no_contact_half")
        images = {name: getattr(self, name)[where][None] for name in states}
        poses = {name: getattr(self, name)[:, where][:, None] for name in ("pose", "pose_half")}
        rest_noise = None if self.rest_noise is None else self.rest_noise[where][None]
        return replace(self, **images, **poses, rest_noise=rest_noise)

    def halves(self, state: str, where: NDArray[np.bool_], pose_names: tuple[str, ...] = ()) -> tuple[Floats, Floats]:
        """Return both halves (pixels, L (1 + N)) of "contact" or "no_contact" at some pixels.

        The layers are followed by their derivatives to each of `pose_names` (of the contact only).
        """
        mean, half = (
            (self.contact, self.contact_half) if state == "contact" else (self.no_contact, self.no_contact_half)
        )
        poses = [self.pose_names.index(name) for name in pose_names]
        places = np.flatnonzero(where)
        means, differences = (
            np.concatenate([image.reshape(len(where.ravel()), -1)[places] for image in images], axis=1)
            for images in ((mean, *(self.pose[n] for n in poses)), (half, *(self.pose_half[n] for n in poses)))
        )
        means = means.astype(np.float64)
        return means + differences, means - differences


def render_layers(press: SimulatedPress) -> RenderLayers:
    """Return the layers of a stored press: its chains, else its bands, else its channels.

    Raises
    ------
    CompareError
        If a value is not finite.
    """
    contact, no_contact, matrix = press.contact, press.no_contact, np.eye(3)
    halves = (press.contact_half_difference, press.no_contact_half_difference)
    with_halves = press.layer_matrix is not None and halves[0] is not None and halves[1] is not None
    if with_halves:
        contact = _first(press.contact_chains, press.contact_bands, press.contact)
        no_contact = _first(press.no_contact_chains, press.no_contact_bands, press.no_contact)
        matrix = np.asarray(press.layer_matrix)
    dark = np.zeros_like(contact)
    pose = press.pose_response if with_halves else None
    none = np.zeros((0, *contact.shape), dtype=np.float32)
    layers = RenderLayers(
        contact=contact,
        no_contact=no_contact,
        contact_half=_first(halves[0] if with_halves else None, dark),
        no_contact_half=_first(halves[1] if with_halves else None, dark),
        pose=none if pose is None else pose.derivative,
        pose_half=none if pose is None else pose.half_difference,
        pose_names=() if pose is None else pose.names,
        names=(press.chains or press.bands) if with_halves else ("red", "green", "blue"),
        matrix=matrix,
        inputs=press.known_inputs if with_halves else None,
    )
    if not all(np.isfinite(image).all() for image in (layers.contact, layers.no_contact, layers.pose)):
        raise CompareError(
            f"{press.name} contains values that are not finite, because the render failed; simulate the press again"
        )
    return layers


def _first(*images: Image | None) -> Image:
    """Return the first image that is there."""
    return next(image for image in images if image is not None)


@dataclass(frozen=True, slots=True)
class SquaredError:
    """Hold the sums over the pixels of one region; C channels, L layers.

    Attributes
    ----------
    quadratic : ndarray, shape (L, L)
        Symmetrised sum of products of both halves.
    linear : ndarray, shape (C, L)
        Sum of layers times capture.
    constant : ndarray, shape (C,)
        Sum of squares of the capture without its noise.
    """

    quadratic: Floats
    linear: Floats
    constant: Floats

    def __call__(self, weights: Floats, exposure: Floats, drift: Floats) -> Floats:
        """Return squared errors (draws, C), noise removed; small ones may come out negative.

        Parameters
        ----------
        weights : ndarray, shape (draws, C, L)
        exposure : ndarray, shape (draws,)
            Factor on the render.
        drift : ndarray, shape (draws,)
            Factor on the capture.
        """
        k, g = exposure[:, None], drift[:, None]
        squares = np.einsum("dcl,dcl->dc", weights @ self.quadratic, weights)
        return np.asarray(
            k**2 * squares - 2.0 * k * g * np.einsum("dcl,cl->dc", weights, self.linear) + g**2 * self.constant
        )


def squared_error(halves: tuple[Floats, Floats], captured: Floats, variance: Floats) -> SquaredError:
    """Form the sums over pixels.

    Parameters
    ----------
    halves : two ndarrays, shape (P, L)
        Layers of the independent halves of a render.
    captured : ndarray, shape (P, C)
    variance : ndarray, shape (P, C)
        Noise variance of the capture's images in the difference of both.
    """
    first, second = halves
    product = first.T @ second
    return SquaredError(
        quadratic=(product + product.T) / 2.0,
        linear=captured.T @ ((first + second) / 2.0),
        constant=(captured**2 - variance).sum(axis=0),
    )


@dataclass(frozen=True, slots=True)
class NoiseCovariance:
    """What noise does to the squared error and to the contact signal of each channel; arrays of shape (C,)."""

    error: Floats
    signal: Floats
    both: Floats

    def draw(self, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return joint normal deviations (draws, C) of error and signal."""
        error_sd = np.sqrt(self.error)
        shared = np.divide(self.both, error_sd, out=np.zeros_like(error_sd), where=error_sd > 0.0)
        own = np.sqrt(np.maximum(self.signal - shared**2, 0.0))
        one, other = rng.standard_normal((2, draws, len(error_sd)))
        return one * error_sd, one * shared + other * own


def noise_covariance(
    error: Floats, signal: Floats, render_variance: Floats, of_error: Floats, of_signal: Floats, of_both: Floats
) -> NoiseCovariance:
    """Return variances and covariance of noise-corrected sums of (S - D)^2 and (B - D)^2.

    With the error e = S - D and the signal s = B - D of the noise-free images and variances v of their noise, which is
    normal and independent between pixels: var sum (S-D)^2 = sum 4 e^2 v_e + 2 v_e^2, and with the independent halves
    of the render 2 v_S^2 more; cov = sum 4 e s v_es + 2 v_es^2. e^2, s^2 and e s are replaced by what is measured
    without the noise's share, no square below zero, so the variances are rather too large than too small.

    Parameters
    ----------
    error, signal : ndarray, shape (P, C)
        S - D and B - D as measured.
    render_variance : ndarray, shape (P, C)
        v_S, of the render's own noise.
    of_error, of_signal, of_both : ndarray, shape (P, C)
        Variances of the noise of the captured images in e and in s, and their covariance: v_D, v_B + v_D and v_D,
        where S holds no noise of B.
    """
    e = render_variance + of_error
    clean_error = np.maximum(error**2 - e, 0.0)
    clean_signal = np.maximum(signal**2 - of_signal, 0.0)
    return NoiseCovariance(
        error=(4.0 * clean_error * e + 2.0 * e**2 + 2.0 * render_variance**2).sum(axis=0),
        signal=(4.0 * clean_signal * of_signal + 2.0 * of_signal**2).sum(axis=0),
        both=(4.0 * (error * signal - of_both) * of_both + 2.0 * of_both**2).sum(axis=0),
    )


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


def error_variance(layers: RenderLayers, captured: Captured, exposure_k: float) -> Floats:
    """Return the variance (H, W, 3) of the noise of render minus capture; of a clipped pixel that of no light."""
    variance = captured.variance(np.nan_to_num(captured.contact)) + exposure_k**2 * layers.contact_variance
    if layers.rest_noise is None:
        return variance
    return variance + exposure_k**2 * layers.rest_noise * captured.variance(np.nan_to_num(captured.no_contact))


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
    contact, no_contact = (pixels_within(image, used) for image in (captured.contact, captured.no_contact))
    repeat = None if captured.repeat is None else pixels_within(captured.repeat, used)
    v_d, v_b = captured.variance(contact), captured.variance(no_contact)
    of_rest = 0.0 if layers.rest_noise is None else exposure_k**2 * pixels_within(layers.rest_noise, used)
    values = _PixelValues(
        contact=contact,
        no_contact=no_contact,
        repeat=repeat,
        contact_variance=v_d,
        no_contact_variance=v_b,
        repeat_variance=None if repeat is None else captured.variance(repeat),
        error_variance=v_d + of_rest * v_b,
        shared_variance=v_d + np.sqrt(of_rest) * v_b,
    )
    halves = layers.halves("contact", used, pose_names)
    half = layers.contact_half.reshape(used.size, -1).take(np.flatnonzero(used), axis=0)
    render_variance = exposure_k**2 * layers.rgb(half) ** 2
    return _sums(used, halves, values, exposure_k, layers.matrix, render_variance, contact, 1.0)


def gradient_sums(
    layers: RenderLayers, captured: Captured, regions: Sequence[Bools], exposure_k: float, pose_names: tuple[str, ...]
) -> list[RegionSums | None]:
    """Return the same of the gradients of (image - its no-contact image), both directions together, for every region.

    The no-contact image becomes zero and the capture grad (D - B). A drift g of the capture multiplies grad (D - B);
    the change (g - 1) grad B of the pad's own gradient, below 1 % of it, is left out. None where no pixel has all its
    neighbours.
    """
    b, v_b = captured.no_contact, captured.variance(captured.no_contact)
    signal = image_gradient(captured.contact - b)
    repeat = None if captured.repeat is None else image_gradient(captured.repeat - b)
    v_d = captured.variance(captured.contact)
    variance = gradient_variance(v_d + v_b)
    of_error, of_both = (variance, variance)
    if layers.rest_noise is not None:  # the noise of b is in the contact image of both sides
        of_rest = exposure_k**2 * layers.rest_noise
        of_error, of_both = gradient_variance(v_d + of_rest * v_b), gradient_variance(v_d + np.sqrt(of_rest) * v_b)
    of_repeat = None if captured.repeat is None else gradient_variance(captured.variance(captured.repeat) + v_b)
    of_render = exposure_k**2 * gradient_variance(layers.contact_variance + layers.no_contact_variance)
    halves = _half_gradients(layers, pose_names)
    found: list[RegionSums | None] = []
    for whole in _gradient_places(captured, regions):
        if whole is None:
            found.append(None)
            continue
        d, v = _at(signal, whole), _at(variance, whole)
        values = _PixelValues(
            d, np.zeros_like(d), None, v, np.zeros_like(d), None, *(_at(i, whole) for i in (of_error, of_both))
        )
        if repeat is not None and of_repeat is not None:
            values = replace(values, repeat=_at(repeat, whole), repeat_variance=_at(of_repeat, whole))
        means, differences = (np.concatenate([_at(g, whole) for g in of], axis=1) for of in halves)
        both = means + differences, means - differences
        level, render_variance = np.concatenate([pixels_within(b, whole)] * 2), _at(of_render, whole)
        found.append(_sums(whole, both, values, exposure_k, layers.matrix, render_variance, level, NOISE_EXCESS))
    return found


def _gradient_places(captured: Captured, regions: Sequence[Bools]) -> list[Bools | None]:
    """Return the pixels of every region whose captured gradients are known; None where there is none."""
    images = (captured.contact, captured.no_contact, captured.repeat)
    known = has_gradient(*(image for image in images if image is not None))
    places = [used & known for used in regions]
    return [place if place.any() else None for place in places]


@dataclass(frozen=True, slots=True)
class _PixelValues:
    """Captured values (P, 3), the variances of their noise, and what it adds to S - D and shares with B - D."""

    contact: Floats
    no_contact: Floats
    repeat: Floats | None
    contact_variance: Floats
    no_contact_variance: Floats
    repeat_variance: Floats | None
    error_variance: Floats
    shared_variance: Floats


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
    v_e = values.error_variance
    noise = noise_covariance(error, signal, render_variance, v_e, v_d + v_b, values.shared_variance)
    per_pixel = {"error": (first - d) * (second - d) - v_e, "signal": signal**2 - v_b - v_d, "level": level}
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
        simulation=squared_error(halves, d, v_e),
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
    return np.concatenate([pixels_within(way, where) for way in gradient])


def _half_gradients(layers: RenderLayers, pose_names: tuple[str, ...]) -> tuple[list[Floats], list[Floats]]:
    """Return gradients of the mean and half the difference of both halves: contact minus no contact, and of poses."""
    mean = layers.contact - layers.no_contact
    half = layers.contact_half - layers.no_contact_half
    poses = [layers.pose_names.index(name) for name in pose_names]
    return (
        [image_gradient(image) for image in (mean, *(layers.pose[n] for n in poses))],
        [image_gradient(image) for image in (half, *(layers.pose_half[n] for n in poses))],
    )
