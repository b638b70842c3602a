"""A simulated press as layers: images whose weighted sums are the render for every paint, camera and pose."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from data_schemas.simulate import KnownInputs, SimulatedPress
from finray_calib.compare.blocks import block_mean

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

    @property
    def contact_variance(self) -> Floats:
        """Variance (H, W, 3) of the contact render."""
        return self.rgb(self.contact_half) ** 2

    @property
    def no_contact_variance(self) -> Floats:
        """Variance (H, W, 3) of the render without contact."""
        return self.rgb(self.no_contact_half) ** 2

    def rgb(self, layers: Image) -> Floats:
        """Return matrix @ layers as (H, W, 3)."""
        return np.asarray(layers.astype(np.float64) @ self.matrix.T)

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
        )

    def halves(self, state: str, where: NDArray[np.bool_], pose_names: tuple[str, ...] = ()) -> tuple[Floats, Floats]:
        """Return both halves (pixels, L (1 + N)) of "contact" or "no_contact" at some pixels.

        The layers are followed by their derivatives to each of `pose_names` (of the contact only).
        """
        mean, half = (
            (self.contact, self.contact_half) if state == "contact" else (self.no_contact, self.no_contact_half)
        )
        poses = [self.pose_names.index(name) for name in pose_names]
        means = np.concatenate([mean[where], *(self.pose[n][where] for n in poses)], axis=1).astype(np.float64)
        differences = np.concatenate([half[where], *(self.pose_half[n][where] for n in poses)], axis=1)
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
        raise CompareError(f"{press.name} holds values that are not finite: the render failed; simulate again")
    return layers


def _first(*images: Image | None) -> Image:
    """Return the first image that is there."""
    return next(image for image in images if image is not None)
