"""Does the contact image show a touch? What a drift of light or camera explains is none, however bright."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.region_sums import LEAST_SIGNAL, Captured
from finray_calib.compare.regions import Region
from finray_calib.compare.tiles import MINIMUM_TILES, tile_indices, tile_side_px

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

OFF_CONTACT = 3.0
"""Half-widths from the contact from which on a touch changes the light but smoothly."""
#: Of the level: what is left of a change that is a drift exactly, by rounding.
_ROUNDING_REL = 1e-9
_SAME_LEVEL_REL = 0.005
#: Standard deviations that drifts have: of a gain, of its change over half the picture, of stray light relative to the
#: level, and of a shift. They only matter where the pixels tell little.
_GAIN_REL, _UNEVEN_REL, _STRAY_REL, _SHIFT_PX = 0.2, 0.05, 0.05, 1.0


def require_touch(captured: Captured, distance: Floats, region: Region, used: Mask, channel_weights: Floats) -> None:
    """Refuse a contact image that differs from the no-contact image as a drift does, and not where it is touched.

    Per channel, contact - no contact is explained as far as possible by a change of gain (even, or varying linearly
    over the picture), stray light, and a shift of the camera of about a pixel:

        D - B = (a + b x + c y) B + d + e dB/dx + f dB/dy,

    by least squares (with what drifts are likely as prior) over the pad further than 3 half-widths from the contact;
    over all of it where that is too little. What is left must be larger in the region than off it, by three standard
    errors of tiles. A local change that a repeat of the no-contact image shows as well is for the row of the floor to
    tell.

    Parameters
    ----------
    captured
        The images; pixels with NaN are left out.
    distance
        (H, W) from the contact's centre in half-widths, NaN off the pad.
    region, used
        The region of the headline and its usable pixels.
    channel_weights
        (3,) of squares.

    Raises
    ------
    CompareError
        Nothing is left in the region that a drift does not explain.
    """
    finite = np.isfinite(captured.contact).all(axis=2) & np.isfinite(captured.no_contact).all(axis=2)
    if captured.repeat is not None:
        finite &= np.isfinite(captured.repeat).all(axis=2)
    terms, whole = _drift_terms(captured.no_contact)
    pad, where = finite & whole & np.isfinite(distance), used & finite & whole
    off = pad & (distance > OFF_CONTACT)
    has_surround = int(off.sum()) >= MINIMUM_TILES * terms.shape[-1] and _tiles(off) >= MINIMUM_TILES
    fitted = off if has_surround else pad | where
    if not where.any() or int(fitted.sum()) <= terms.shape[-1]:
        return
    touched = _left_over(captured, captured.contact, terms, fitted, channel_weights)
    level = float((captured.no_contact[fitted] ** 2 @ channel_weights).mean())
    found = float(touched[where].mean())
    noise = _standard_error(touched, where)
    background = 0.0
    if has_surround:
        background = float(touched[off].mean())
        noise = float(np.hypot(noise, _standard_error(touched, off))) if _tiles(where) >= MINIMUM_TILES else noise
    if not found - background > LEAST_SIGNAL * noise or found <= _ROUNDING_REL**2 * level:
        repeat = 0.0
        if captured.repeat is not None:
            repeat = float(_left_over(captured, captured.repeat, terms, fitted, channel_weights)[where].mean())
        raise CompareError(_in_words(captured, fitted, region, found, background, repeat, level))


def _drift_terms(no_contact: Floats) -> tuple[Floats, Mask]:
    """Return what a drift may add, (H, W, C, 6), and where it is known."""
    height, width = no_contact.shape[:2]
    across = np.linspace(-1.0, 1.0, width)[None, :, None]
    down = np.linspace(-1.0, 1.0, height)[:, None, None]
    along_y, along_x = np.gradient(no_contact, axis=(0, 1))
    terms = np.stack(
        [no_contact, across * no_contact, down * no_contact, np.ones_like(no_contact), along_x, along_y], axis=-1
    )
    return terms, np.isfinite(terms).all(axis=(2, 3))


def _left_over(captured: Captured, image: Floats, terms: Floats, fitted: Mask, weights: Floats) -> Floats:
    """Return the weighted squares (H, W) of what a drift does not explain, without what the camera's noise adds."""
    b = captured.no_contact
    squares = np.zeros(b.shape[:2])
    variance = captured.variance(image) + captured.variance(b)
    for channel in range(b.shape[2]):
        design, change = terms[..., channel, :], image[..., channel] - b[..., channel]
        left = change - design @ _drift(design[fitted], change[fitted])
        squares += weights[channel] * (left**2 - variance[..., channel])
    return squares


def _drift(design: Floats, change: Floats) -> Floats:
    """Return the factors (6,) of the drift's terms; what the pixels do not tell stays near zero, not far out."""
    level = float(np.sqrt((design[:, 0] ** 2).mean()))
    likely = np.array([_GAIN_REL, _UNEVEN_REL, _UNEVEN_REL, _STRAY_REL * level, _SHIFT_PX, _SHIFT_PX])
    scaled = design * likely
    plain = np.linalg.lstsq(scaled, change, rcond=None)[0]
    noise = float(((change - scaled @ plain) ** 2).mean())
    normal = scaled.T @ scaled + noise * np.eye(len(likely))
    return np.asarray(np.linalg.lstsq(normal, scaled.T @ change, rcond=None)[0] * likely)


def _tiles(mask: Mask) -> int:
    """Return the number of tiles of a mask."""
    return 0 if int(mask.sum()) < MINIMUM_TILES else int(tile_indices(mask, tile_side_px(mask)).max()) + 1


def _standard_error(squares: Floats, mask: Mask) -> float:
    """Return the standard error of the mean over a mask, by its tiles; by its pixels where these are few."""
    values = squares[mask]
    if len(values) < 2:
        return 0.0
    if len(values) < MINIMUM_TILES:
        return float(values.std(ddof=1) / np.sqrt(len(values)))
    tiles = tile_indices(mask, tile_side_px(mask))
    counts = np.bincount(tiles)
    means = np.bincount(tiles, weights=values) / counts
    share = counts / counts.sum()
    spread = float((share**2 * (means - values.mean()) ** 2).sum()) * len(means) / max(len(means) - 1, 1)
    return float(np.sqrt(spread))


def _in_words(
    captured: Captured, fitted: Mask, region: Region, found: float, background: float, repeat: float, level: float
) -> str:
    """Say what the images show instead of a touch."""
    ratio = captured.contact[fitted].sum(axis=0) / captured.no_contact[fitted].sum(axis=0)
    left, off, again = (float(np.sqrt(max(v, 0.0) / level)) for v in (found, background, repeat))
    seen = [f"beyond that it changes the region by {left:.2%} of the level", f"elsewhere by {off:.2%}"]
    if captured.repeat is not None:
        seen.append(f"a repeat of the no-contact image by {again:.2%}")
    brighter = ""
    if np.abs(ratio - 1.0).max() > _SAME_LEVEL_REL:
        brighter = f", {', '.join(f'{r:.3f}' for r in ratio)} times as bright in red, green, blue,"
    return (
        f"the contact image shows no touch in the region '{region.name}': it differs from the no-contact "
        f"image{brighter} as a drift of the light or of the camera does ({'; '.join(seen)}; root mean squares without "
        "noise). Check that it is the contact image and that the region lies on the contact, press deeper, or keep "
        "light, exposure and camera steady between the images"
    )
