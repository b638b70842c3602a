"""Other paints, another camera or white balance on a stored render: by arithmetic, no path is traced again."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, KnownInputs, RenderedLight, SimulatedPress, SimulateError
from sim.experiments._painted_finger import CameraResponse, response_matrix
from sim.experiments._rendered_press import CAMERA_NOTE, SHAPE_NOTE, colour_notes, light_record
from sim.optics import (
    BAND_NAMES,
    FIRST_CHAINS,
    PaintBands,
    PaintOptics,
    SpectralBand,
    chain_matrix,
    conversion_gains,
    mix_chains,
    paint_bands,
    require_near_bands,
    require_same_reflectance,
    require_small_reemission,
)

Floats = NDArray[np.float64]
Image = NDArray[np.float32]
Gains = tuple[float, float, float]
WhiteBalance = Gains | Literal["pad"]
"""Gains of red, green and blue; or "pad": those that make the mean of the untouched pad grey, green kept."""

_RECOLOURED = ", recoloured"
WHITE_BALANCE_NOTE = "white balance (red:green:blue): "


def recoloured(
    press: SimulatedPress,
    paints: Mapping[str, PaintOptics] | None = None,
    response: CameraResponse | None = None,
    white_balance: WhiteBalance | None = None,
    paint_sha256: Mapping[str, str] | None = None,
) -> SimulatedPress:
    """Return a press as other paints, another camera or another white balance would show it.

    RGB = diag(white balance) C W chains: the light of a chain is proportional to every conversion on its way, W holds
    their changes, C the camera's response over the bands. Equal to a new render with the same seed as far as the
    reflectances of the walls, and of the coating at the bands' centroids, are equal. The noise of a band is scaled
    with the light of its first chain; ``contact_bands_variance`` stays that of the render, like the chains.

    Parameters
    ----------
    press
        A press rendered by level a or b in a compiled variant; of any render, camera and white balance can be changed.
    paints
        New optics of "red" and "green"; those that the press shows without it.
    response
        New camera; that which the press shows without it.
    white_balance
        New gains; those that the press shows without it.
    paint_sha256
        Checksums of the new paints' files, for the record.

    Raises
    ------
    SimulateError
        When the press is no render or holds no chains, when a reflectance, a band's place or a conversion changes too
        much to do without a new render, or when a gain is not positive.
    CurveError
        When the response misses more than 20 % of a band.
    """
    rendered, shown, design = _lights(press)
    if paints is None:
        bands = stored_bands(shown)
    else:
        bands = paint_bands(paints["red"], paints["green"], design.light)
        _require_chains(press, stored_bands(rendered), bands)
    growth = _growth(press, stored_bands(rendered), bands)
    camera = shown.response if response is None else response
    to_rgb = response_matrix(camera, bands)
    gains = _gains(shown.white_balance if white_balance is None else white_balance, press, to_rgb @ growth)
    notes = press.notes if paints is None else tuple(n for n in press.notes if n.startswith(SHAPE_NOTE))
    kept = [note for note in notes if not note.startswith((CAMERA_NOTE, WHITE_BALANCE_NOTE))]
    balance = [] if gains == (1.0, 1.0, 1.0) else [WHITE_BALANCE_NOTE + ":".join(f"{g:.4g}" for g in gains)]
    return press.model_copy(
        update={
            **_images(press, growth, np.array(gains)[:, None] * to_rgb),
            "label": press.label.removesuffix(_RECOLOURED) + _RECOLOURED,
            "layer_matrix": np.array(gains)[:, None] * to_rgb @ growth,
            "known_inputs": _still_known(press.known_inputs, paints is not None, response is not None),
            "shown_light": light_record(bands, camera, gains),
            "paints": press.paints if paint_sha256 is None else dict(paint_sha256),
            "notes": (*dict.fromkeys([*colour_notes(camera, bands), *kept]), *balance),
        }
    )


def _still_known(known: KnownInputs | None, other_paints: bool, other_camera: bool) -> KnownInputs | None:
    """Return the inputs whose draws still hold: another camera sees a draw of a paint otherwise too."""
    if known is None or other_camera:
        return None
    kept = [i for i, name in enumerate(known.names) if not (other_paints and name.endswith("paint"))]
    if not kept:
        return None
    fields = {
        field: tuple(getattr(known, field)[i] for i in kept) for field in ("names", "keys", "evaluations", "sources")
    }
    return known.model_copy(update={**fields, "factors": known.factors[kept]})


def stored_bands(rendered: RenderedLight) -> PaintBands:
    """Return the bands that a stored render was made with; what was cut of the emission is not known any more."""
    red, green, led = (SpectralBand(curve.wavelength_nm, curve.values) for curve in rendered.bands)
    reflectance, conversion = (
        dict(zip(rendered.walls, table, strict=True)) for table in (rendered.reflectance, rendered.conversion)
    )
    return PaintBands((red, green, led), reflectance, conversion, {})


def _lights(press: SimulatedPress) -> tuple[RenderedLight, RenderedLight, FingerDesign]:
    """Return the light that a press was rendered with and the one that it shows."""
    if press.rendered_light is None or press.design is None or _layers(press)[0] is None:
        raise SimulateError(
            f"{press.name} ({press.label}) does not hold the light that it was rendered with; only a press rendered by "
            "'finray simulate render' of this version can be recoloured: render it again"
        )
    return press.rendered_light, press.shown_light or press.rendered_light, press.design


def _layers(press: SimulatedPress) -> tuple[Image | None, Image | None]:
    """Return what all images are sums of: chains, or bands where chains do not stand apart."""
    if press.chains:
        return press.no_contact_chains, press.contact_chains
    return press.no_contact_bands, press.contact_bands


def _require_chains(press: SimulatedPress, before: PaintBands, after: PaintBands) -> None:
    """Refuse other paints where they need a new render."""
    if not press.chains:
        raise SimulateError(
            f"{press.name} ({press.label}) does not hold each chain of fluorescence apart, which other paints need; "
            "render with --level b in a compiled variant (--engine llvm), or change camera and white balance only"
        )
    require_same_reflectance(before.reflectance, after.reflectance)
    require_near_bands(before.bands, after.bands)
    require_small_reemission(press.chains, conversion_gains(before.conversion, after.conversion))


def _growth(press: SimulatedPress, before: PaintBands, after: PaintBands) -> Floats:
    """Return W (3 bands, layer) with bands = W @ layers."""
    if not press.chains:
        return np.eye(len(BAND_NAMES))
    return chain_matrix(press.chains, conversion_gains(before.conversion, after.conversion))


def _gains(white_balance: WhiteBalance, press: SimulatedPress, layers_to_rgb: Floats) -> Gains:
    """Return the gains of red, green and blue."""
    if white_balance == "pad":
        pad, layers = np.isfinite(press.distance), _layers(press)[0]
        means = np.zeros(3)
        if pad.any() and layers is not None:
            # row by row: one product of all pixels is spread over threads, see sim.optics._paint_bands
            of_rows = np.matmul(pad[:, None, :].astype(np.float32), layers)[:, 0]
            means = layers_to_rgb @ of_rows.sum(axis=0, dtype=np.float64)
        if not (means > 0.0).all():
            raise SimulateError(f"{press.name}: the pad without contact is black or not seen; give three gains")
        gains = means[BAND_NAMES.index("green")] / means
    else:
        gains = np.array(white_balance, dtype=np.float64)
    if gains.shape != (3,) or not np.isfinite(gains).all() or (gains <= 0.0).any():
        raise SimulateError(f"white balance needs three positive gains (red, green, blue), got {white_balance}")
    red, green, blue = gains.tolist()
    return red, green, blue


def _images(press: SimulatedPress, growth: Floats, matrix: Floats) -> dict[str, Image | Floats]:
    """Return bands and pictures of both states and the noise; each in one pass over its pixels."""
    images: dict[str, Image | Floats] = {"camera_matrix": matrix}
    for state, layers in zip(("no_contact", "contact"), _layers(press), strict=True):
        if layers is not None:
            both = mix_chains(layers, np.concatenate([growth, matrix @ growth]))
            images[f"{state}_bands"], images[state] = both[..., :3], both[..., 3:]
    if press.contact_bands_variance is not None:
        # the variance of the render, scaled with the square of each band's first chain
        first = [press.chains.index(chain) if press.chains else k for k, chain in enumerate(FIRST_CHAINS)]
        images["variance"] = mix_chains(press.contact_bands_variance, (matrix * np.diag(growth[:, first])) ** 2)
    return images
