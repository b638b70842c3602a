"""The candidates as a screen would show them, and how different people see them: CIEDE2000 and FLIP.

Candidates are doing nothing, the render, and a perfect render seen on the repeat; each is formed once, and what the
capture brings to every candidate as well. Colour differences are for displayed images only: a photometric error belongs
in linear light. The pointwise arithmetic of CIEDE2000 is compiled; powers and angles stay with numpy, which forms
several at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, TactileCapture
from finray_calib.compare._comparison import Comparison
from finray_calib.compare._region_sums import Captured
from finray_calib.compare._regions import pixels_within, usable_pixels
from finray_calib.compare._structural_similarity import StructuralSimilarity, similarity_of_all_scales
from finray_calib.sensing import full_scale_dn
from finray_calib.spectra import compiled

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
SSIM_SETTINGS = (
    "Wang 2004 on the compared values: sigma 1.5, 11 x 11, K1 0.01, K2 0.03, population covariance, no border"
)


@dataclass(frozen=True, slots=True)
class ShownCandidate:
    """Hold what a candidate is as an image, formed once for all regions.

    Attributes
    ----------
    image : ndarray, shape (H, W, 3)
    variance : ndarray, shape (H, W, 3)
        Of its noise.
    similarity : StructuralSimilarity
        To the capture, as the images are: noise lowers it.
    ms_ssim : float or None
        None for small images.
    flip : float
        Mean over the headline region.
    colour_difference : ndarray, shape (H, W)
        CIEDE2000 to the capture as displayed; NaN outside the headline region.
    """

    image: Floats
    variance: Floats
    similarity: StructuralSimilarity
    ms_ssim: float | None
    flip: float
    colour_difference: Floats


def shown_candidates(comparison: Comparison, capture: TactileCapture) -> dict[str, ShownCandidate]:
    """Return the candidates by name, at the level of the capture."""
    layers, captured, k = comparison.layers, comparison.captured, comparison.best_exposure
    images = {
        "do nothing": (captured.no_contact, captured.variance(captured.no_contact)),
        "simulation": (k * layers.rgb(layers.contact), k**2 * layers.contact_variance),
    }
    if captured.repeat is not None:
        variance = captured.variance(captured.repeat) + captured.variance(captured.no_contact)
        images["floor"] = (captured.contact + captured.repeat - captured.no_contact, variance)
    display = _Display.of(captured, [image for image, _ in images.values()], comparison.used[-1], capture)
    return {name: _shown(*image, captured.contact, display, capture) for name, image in images.items()}


def _shown(
    image: Floats, variance: Floats, contact: Floats, display: "_Display", capture: TactileCapture
) -> ShownCandidate:
    """Return a candidate with its likeness to the captured contact image."""
    similarity, ms_ssim = similarity_of_all_scales(image, contact, full_scale_dn(capture))
    flip, differences = display.likeness(image)
    colour_difference = np.full(display.headline.shape, np.nan)
    colour_difference[display.headline] = differences
    return ShownCandidate(image, variance, similarity, ms_ssim, flip, colour_difference)


@dataclass(frozen=True, slots=True)
class _Display:
    """Show images around the headline region, and hold what the captured contact image looks like there.

    Attributes
    ----------
    headline : ndarray of bool, shape (H, W)
    near : tuple of slice
        Rows and columns that reach as far beyond the region as FLIP's filters do.
    finite : ndarray of bool, shape (h, w, 1)
        Pixels there that are finite in every image; the others are shown black.
    white_dn : float
    linear : bool
    lab : ndarray, shape (P, 3)
        Of the capture at the pixels of the region.
    perceived : PerceivedImage
        The capture.
    """

    headline: Bools
    near: tuple[slice, slice]
    finite: Bools
    white_dn: float
    linear: bool
    lab: Floats
    perceived: "PerceivedImage"

    @classmethod
    def of(cls, captured: Captured, images: list[Floats], headline: Bools, capture: TactileCapture) -> "_Display":
        """Return the display of a capture and of the candidates' images."""
        linear, near = capture.encoding == "linear", _around(headline, _filters(PIXELS_PER_DEGREE).reach_px)
        white_dn = display_white_dn(captured.no_contact) if linear else full_scale_dn(capture)
        seen = np.isfinite(sum((image[near] for image in images), captured.contact[near]))
        finite = np.asarray(seen.all(axis=2, keepdims=True), dtype=np.bool_)
        srgb, where = _displayed(captured.contact[near], finite, white_dn, linear), headline[near]
        lab, perceived = srgb_to_lab(pixels_within(srgb, where)), perceived_image(srgb, where)
        return cls(headline, near, finite, white_dn, linear, lab, perceived)

    def likeness(self, image: Floats) -> tuple[float, Floats]:
        """Return the mean FLIP of an image to the capture, and CIEDE2000 (P,) of the region's pixels."""
        srgb, where = _displayed(image[self.near], self.finite, self.white_dn, self.linear), self.headline[self.near]
        flip = flip_errors(self.perceived, perceived_image(srgb, where)).mean(dtype=np.float64)
        return float(flip), ciede2000(srgb_to_lab(pixels_within(srgb, where)), self.lab)


def _displayed(image: Floats, finite: Bools, white_dn: float, linear: bool) -> Floats:
    """Return an image as displayed, black where pixels are missing."""
    return displayed_image(np.where(finite, image, 0.0), white_dn, linear)


def full_frame_ssim(candidates: Mapping[str, ShownCandidate]) -> dict[str, float | None]:
    """Return the full-frame SSIM of each candidate, for comparison with papers."""
    means = {name: candidate.similarity.mean for name, candidate in candidates.items()}
    return {name: mean if np.isfinite(mean) else None for name, mean in means.items()}


#: Shown as white: the brightest half per cent of the no-contact image may clip, as a photographer would expose.
WHITE_PERCENTILE = 99.5


def display_white_dn(no_contact: Floats) -> float:
    """Return the level that is shown as white: the 99.5th percentile of all channels of the no-contact capture.

    One level for all images of a comparison and all channels: neither an error of exposure nor one of colour is hidden.

    Parameters
    ----------
    no_contact : ndarray, shape (H, W, 3)
        Linear light, black level removed; pixels that are not finite do not count.

    Raises
    ------
    CompareError
        The level is not positive.
    """
    white_dn = float(np.nanpercentile(no_contact, WHITE_PERCENTILE)) if np.isfinite(no_contact).any() else 0.0
    if not white_dn > 0:
        raise CompareError(
            f"The no-contact image is too dark to be shown, because {WHITE_PERCENTILE} % of it lies at or below "
            f"{white_dn:g} DN above the black level; check the light and the black level of the capture"
        )
    return white_dn


def displayed_image(image: Floats, white_dn: float, linear: bool) -> Floats:
    """Return sRGB in 0..1: linear light over white through the curve of IEC 61966-2-1, encoded values over white as is.

    The channels are taken for the primaries of sRGB, which a raw camera's are not: differences of displayed images are
    for people's eyes. Values outside are clipped; NaN stays NaN.

    Parameters
    ----------
    image : ndarray, shape (H, W, 3)
    white_dn : float
        Level shown as white: `display_white_dn` for linear light, full scale for encoded values.
    linear : bool

    Raises
    ------
    CompareError
        The white level is not positive.
    """
    if not white_dn > 0:
        raise CompareError(
            f"The white level must be positive, got {white_dn} DN; give the full scale, such as 255 for 8 bit"
        )
    share = np.clip(image / white_dn, 0.0, 1.0)
    if not linear:
        return np.asarray(share)
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)


#: A 0.7 m wide screen of 3840 pixels seen from 0.7 m: the default of FLIP's makers.
PIXELS_PER_DEGREE = 67.0
Perceived = NDArray[np.float32]
#: sRGB's primaries and D65 with the digits of FLIP's makers, as shares of white.
_FLIP_XYZ = np.array(
    [[10135552 / 2, 8788810 / 2, 4435075 / 2], [2613072, 8788810, 887015], [1425312 / 6, 8788810 / 6, 70074185 / 6]]
)
_FLIP_RATIO = _FLIP_XYZ / _FLIP_XYZ.sum(axis=1)[:, None]
_FLIP_TO_RGB = np.linalg.inv(_FLIP_RATIO)
#: What the eye resolves: (weight, width in deg^2) of Gaussians for grey, red to green, and yellow to blue.
_CONTRAST_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_FEATURE_DEG = 0.082
_COLOUR_POWER, _FEATURE_POWER = 0.7, 0.5
#: Up to this share of the largest difference of colour, errors take this share of the scale.
_SMALL_SHARE, _SMALL_ERRORS = 0.4, 0.95


@dataclass(frozen=True, slots=True)
class PerceivedImage:
    """Hold how an eye perceives some pixels of a displayed image.

    Attributes
    ----------
    colour : ndarray, shape (3, P)
        L*, and a* and b* times L* / 100, of the image as far as the eye resolves it.
    detail : ndarray, shape (2, P)
        Strength of edges and of points.
    """

    colour: Perceived
    detail: Perceived


@dataclass(frozen=True, slots=True)
class _Filters:
    """Hold separable kernels: (share, kernel) of each opponent channel, and smooth, slope and curvature of features."""

    opponents: tuple[tuple[tuple[float, Perceived], ...], ...]
    features: tuple[Perceived, Perceived, Perceived]

    @property
    def reach_px(self) -> int:
        """Nothing farther away enters a pixel."""
        return max(len(kernel) // 2 for kernel in (self.opponents[2][0][1], *self.features))


@lru_cache(maxsize=4)
def _filters(pixels_per_deg: float) -> _Filters:
    """Return the filters of an eye at this distance."""
    widest = max(width for parts in _CONTRAST_SENSITIVITY for _, width in parts)
    reach = int(np.ceil(3.0 * np.sqrt(widest / (2.0 * np.pi**2)) * pixels_per_deg))
    square = (np.arange(-reach, reach + 1) / pixels_per_deg) ** 2
    opponents = []
    for parts in _CONTRAST_SENSITIVITY:
        bells = [np.exp(-(np.pi**2) * square / width) for _, width in parts]
        # over the plane a bell adds up to the square of its sum along a line
        sums = [w * np.sqrt(np.pi / b) * bell.sum() ** 2 for (w, b), bell in zip(parts, bells, strict=True)]
        shares = [float(one / sum(sums)) for one in sums]
        opponents.append(tuple((s, (b / b.sum()).astype(np.float32)) for s, b in zip(shares, bells, strict=True)))
    sigma = 0.5 * _FEATURE_DEG * pixels_per_deg
    x = np.arange(-np.ceil(3.0 * sigma), np.ceil(3.0 * sigma) + 1.0)
    bell = np.exp(-(x**2) / (2.0 * sigma**2))
    kernels = (bell, -x * bell, ((x / sigma) ** 2 - 1.0) * bell)
    smooth, slope, curvature = (
        (np.where(k > 0.0, k / k[k > 0.0].sum(), k / max(-k[k < 0.0].sum(), 1e-300))).astype(np.float32)
        for k in kernels
    )
    return _Filters(tuple(opponents), (smooth, slope, curvature))


def perceived_image(srgb: Floats, where: Bools, pixels_per_deg: float = PIXELS_PER_DEGREE) -> PerceivedImage:
    """Return how an eye perceives some pixels of a displayed image, after FLIP.

    Parameters
    ----------
    srgb : ndarray, shape (H, W, 3)
        0..1 and finite.
    where : ndarray of bool, shape (H, W)
    pixels_per_deg : float
        Of visual angle.
    """
    filters, places = _filters(pixels_per_deg), np.flatnonzero(where)

    def filtered(plane: Perceived, across: Perceived, along: Perceived) -> Perceived:
        whole = cv2.sepFilter2D(plane, -1, across, along, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(whole.ravel()[places], dtype=np.float32)

    planes = np.array(np.moveaxis(srgb, 2, 0), dtype=np.float32, order="C")
    light = np.where(planes <= 0.04045, planes / 12.92, ((planes + 0.055) / 1.055) ** 2.4)
    x, y, z = np.tensordot(_FLIP_RATIO.astype(np.float32), light, axes=1)
    seen = [
        np.sum([share * filtered(plane, kernel, kernel) for share, kernel in parts], axis=0, dtype=np.float32)
        for plane, parts in zip((y, x - y, y - z), filters.opponents, strict=True)
    ]
    light = np.clip(_FLIP_TO_RGB.astype(np.float32) @ np.stack([seen[1] + seen[0], seen[0], seen[0] - seen[2]]), 0, 1)
    smooth, slope, curvature = filters.features
    detail = [np.hypot(filtered(y, k, smooth), filtered(y, smooth, k)) for k in (slope, curvature)]
    return PerceivedImage(_perceived_colour(light), np.stack(detail))


def _perceived_colour(light: NDArray[np.floating]) -> Perceived:
    """Return L*, and a* and b* times L* / 100 (Hunt), of linear RGB (3, P) in 0..1."""
    ratios = _FLIP_RATIO.astype(light.dtype) @ light
    f = np.where(ratios > (6 / 29) ** 3, np.cbrt(ratios), ratios * ((29 / 6) ** 2 / 3) + 4 / 29)
    lightness = 116 * f[1] - 16
    a, b = 500 * (f[0] - f[1]), 200 * (f[1] - f[2])
    return np.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b]).astype(np.float32)


def _colour_distance(first: Perceived, second: Perceived) -> Perceived:
    """Return the HyAB distance of perceived colours (3, P), raised to FLIP's power."""
    apart = np.abs(first - second)
    return np.asarray((apart[0] + np.hypot(apart[1], apart[2])) ** _COLOUR_POWER, dtype=np.float32)


_GREEN, _BLUE = (np.array(primary)[:, None] for primary in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
_LARGEST_DISTANCE: Final = float(_colour_distance(_perceived_colour(_GREEN), _perceived_colour(_BLUE))[0])


def flip_errors(reference: PerceivedImage, test: PerceivedImage) -> Perceived:
    r"""Return the LDR-FLIP of each pixel, 0 (no visible difference) to 1.

    .. math:: \Delta E = (\Delta E_c)^{1 - \Delta E_f}, \quad
              \Delta E_f = \Big(\tfrac{1}{\sqrt 2} \max(|\Delta e|, |\Delta p|)\Big)^{1/2}

    with the difference of colour E_c, HyAB to the power 0.7 brought to 0..1, and those of edges e and points p.
    Computed in single precision, as the makers' program is: means over regions agree to 1e-6.

    Parameters
    ----------
    reference, test : PerceivedImage
        Of the same pixels; the capture is the reference.

    Returns
    -------
    ndarray, shape (P,)

    References
    ----------
    P. Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3 (2020) 15.
    """
    colour, bend = _colour_distance(reference.colour, test.colour), _SMALL_SHARE * _LARGEST_DISTANCE
    beyond = _SMALL_ERRORS + (colour - bend) / (_LARGEST_DISTANCE - bend) * (1.0 - _SMALL_ERRORS)
    error = np.where(colour < bend, colour * (_SMALL_ERRORS / bend), beyond)
    detail = (np.abs(reference.detail - test.detail).max(axis=0) / np.sqrt(np.float32(2.0))) ** _FEATURE_POWER
    return np.asarray(error ** (1 - detail), dtype=np.float32)


def flip_mean(
    reference_srgb: Floats, test_srgb: Floats, mask: NDArray[np.bool_], pixels_per_deg: float = PIXELS_PER_DEGREE
) -> float:
    """Return the mean LDR-FLIP over a region, 0 (no visible difference) to 1, see `flip_errors`.

    A pixel that is not finite in one image is black in both, so that it adds no difference of its own.

    Parameters
    ----------
    reference_srgb, test_srgb : ndarray, shape (H, W, 3)
        Displayed images in 0..1, see `displayed_image`; the capture is the reference.
    mask : ndarray of bool, shape (H, W)
    pixels_per_deg : float
        Of visual angle.

    Raises
    ------
    CompareError
        If shapes differ or no pixel is usable.
    """
    used = usable_pixels(mask, reference_srgb, test_srgb)
    near = _around(used, _filters(pixels_per_deg).reach_px)
    finite = np.isfinite(reference_srgb[near] + test_srgb[near]).all(axis=2, keepdims=True)
    seen = [
        perceived_image(np.where(finite, image[near], 0.0), used[near], pixels_per_deg)
        for image in (reference_srgb, test_srgb)
    ]
    return float(flip_errors(*seen).mean(dtype=np.float64))


def _around(mask: Bools, reach_px: int) -> tuple[slice, slice]:
    """Return the rows and columns of a mask's bounding box with a border."""
    sides = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(s[0]) - reach_px, 0), int(s[-1]) + reach_px + 1) for s in sides)
    return rows, columns


#: IEC 61966-2-1, rounded as in the standard.
_SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
#: D65 of the 2 degree observer from its chromaticity (0.3127, 0.3290).
_WHITE_XYZ = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
_TO_RATIO = _SRGB_TO_XYZ / _WHITE_XYZ[:, None]
#: Pixels worked at once, one plane for each quantity: some twenty of them stay in the processor's cache.
_CHUNK_PX = 8192


def srgb_to_lab(srgb: Floats) -> Floats:
    """Convert sRGB to CIE L*a*b* under D65 for the 2 degree observer.

    The sRGB curve is inverted, the linear light goes through the matrix of IEC 61966-2-1 to XYZ, then
    L* = 116 f(Y/Yn) - 16, a* = 500 (f(X/Xn) - f(Y/Yn)), b* = 200 (f(Y/Yn) - f(Z/Zn)). Valid for encoded sRGB,
    not for linear camera channels.

    Parameters
    ----------
    srgb : ndarray, shape (..., 3)
        Encoded sRGB, 0..1.

    Returns
    -------
    ndarray, shape (..., 3)
        L*, a*, b*.

    Raises
    ------
    CompareError
        If the last axis is not three channels or a value lies outside 0..1.

    References
    ----------
    IEC 61966-2-1:1999; CIE 15:2018.
    """
    encoded = np.asarray(srgb, dtype=np.float64)
    if encoded.shape[-1:] != (3,):
        raise CompareError(f"an sRGB image must have three channels on the last axis, got shape {encoded.shape}")
    if not ((encoded >= 0) & (encoded <= 1)).all():
        raise CompareError(
            f"sRGB values must lie between 0 and 1, got {encoded.min():g} to {encoded.max():g}; divide 8-bit values by "
            "255"
        )
    lab = np.empty(encoded.shape)
    flat, result = encoded.reshape(-1, 3), lab.reshape(-1, 3)
    for start in range(0, len(flat), _CHUNK_PX):
        chunk = slice(start, start + _CHUNK_PX)
        result[chunk] = np.transpose(_lab_planes(_planes(flat[chunk])))
    return lab


def ciede2000(first_lab: Floats, second_lab: Floats) -> Floats:
    """Return the CIEDE2000 colour difference, parametric factors all 1.

    dE = sqrt((dL'/S_L)^2 + (dC'/S_C)^2 + (dH'/S_H)^2 + R_T (dC'/S_C)(dH'/S_H)). Meant for small differences;
    beyond about 5 units it is a rank, not a distance.

    Parameters
    ----------
    first_lab, second_lab : ndarray, shape (..., 3)
        CIE L*, a*, b*; two shapes that broadcast.

    Returns
    -------
    ndarray, shape (...)

    References
    ----------
    G. Sharma, W. Wu, E. N. Dalal, Color Research and Application 30 (2005) 21.
    """
    first, second = np.broadcast_arrays(
        np.asarray(first_lab, dtype=np.float64), np.asarray(second_lab, dtype=np.float64)
    )
    one, other = first.reshape(-1, 3), second.reshape(-1, 3)
    result = np.empty(len(one))
    for start in range(0, len(one), _CHUNK_PX):
        chunk = slice(start, start + _CHUNK_PX)
        result[chunk] = _difference(_planes(one[chunk]), _planes(other[chunk]))
    return result.reshape(first.shape[:-1])


def _planes(pixels: Floats) -> Floats:
    """Return a copy of a list of pixels as planes (3, pixels)."""
    return np.array(pixels.T, order="C")


def _lab_planes(srgb: Floats) -> Floats:
    """Return L*, a*, b* of sRGB planes."""
    ratios = np.empty_like(srgb)
    white_ratios(srgb, ((srgb + 0.055) / 1.055) ** 2.4, _TO_RATIO, ratios)
    lab_of_ratios(ratios, np.cbrt(ratios))
    return ratios


def _difference(first: Floats, second: Floats) -> Floats:
    """Return the CIEDE2000 difference of L*, a*, b* planes, which are used up."""
    chroma = np.empty((2, first.shape[1]))
    stretched_red_green(first, second, chroma)
    hues = np.stack([np.arctan2(lab[2], lab[1]) for lab in (first, second)])
    hue_difference_and_mean(hues, chroma)
    half_difference, mean = hues
    from_blue = (np.rad2deg(mean) - 275) / 25
    turn = np.sin(np.pi / 3 * np.exp(-from_blue * from_blue))
    result = np.empty(first.shape[1])
    difference_of_terms(first, second, chroma, np.sin(half_difference), np.cos(mean), np.sin(mean), turn, result)
    return result


_COS_30, _SIN_30 = 0.5 * 3.0**0.5, 0.5
_COS_6, _SIN_6 = float(np.cos(np.deg2rad(6.0))), float(np.sin(np.deg2rad(6.0)))
_COS_63, _SIN_63 = float(np.cos(np.deg2rad(63.0))), float(np.sin(np.deg2rad(63.0)))
_CHROMA_SCALE_7 = 25.0**7


@compiled
def white_ratios(srgb: Floats, powers: Floats, to_ratio: Floats, result: Floats) -> None:
    """Put X/Xn, Y/Yn, Z/Zn, (3, pixels), of sRGB into the result, given ((srgb + 0.055) / 1.055)^2.4."""
    linear = np.empty(3)
    for pixel in range(srgb.shape[1]):
        for channel in range(3):
            encoded = srgb[channel, pixel]
            linear[channel] = encoded / 12.92 if encoded <= 0.04045 else powers[channel, pixel]
        for row in range(3):
            result[row, pixel] = (
                to_ratio[row, 0] * linear[0] + to_ratio[row, 1] * linear[1] + to_ratio[row, 2] * linear[2]
            )


@compiled
def lab_of_ratios(ratios: Floats, roots: Floats) -> None:
    """Put L*, a*, b* in place of the ratios to white, (3, pixels), given their cube roots."""
    f = np.empty(3)
    for pixel in range(ratios.shape[1]):
        for row in range(3):
            ratio = ratios[row, pixel]
            f[row] = roots[row, pixel] if ratio > 216.0 / 24389.0 else ratio * (24389.0 / 27.0 / 116.0) + 16.0 / 116.0
        ratios[0, pixel] = 116.0 * f[1] - 16.0
        ratios[1, pixel] = 500.0 * (f[0] - f[1])
        ratios[2, pixel] = 200.0 * (f[1] - f[2])


@compiled
def stretched_red_green(first: Floats, second: Floats, chroma: Floats) -> None:
    """Put a' in place of a* of both colours, (3, pixels), and the chromas C' into (2, pixels)."""
    for pixel in range(first.shape[1]):
        a1, b1, a2, b2 = first[1, pixel], first[2, pixel], second[1, pixel], second[2, pixel]
        mean = (np.sqrt(a1 * a1 + b1 * b1) + np.sqrt(a2 * a2 + b2 * b2)) / 2.0
        seventh = mean * mean * mean * mean * mean * mean * mean
        stretch = 1.5 - 0.5 * np.sqrt(seventh / (seventh + _CHROMA_SCALE_7))
        a1 *= stretch
        a2 *= stretch
        first[1, pixel], second[1, pixel] = a1, a2
        chroma[0, pixel], chroma[1, pixel] = np.sqrt(a1 * a1 + b1 * b1), np.sqrt(a2 * a2 + b2 * b2)


@compiled
def hue_difference_and_mean(hues: Floats, chroma: Floats) -> None:
    """Put half the hue difference and the mean hue, on the circle, in place of two hues in -pi..pi, (2, pixels).

    A grey has no hue, so that the sum stands for the mean.
    """
    for pixel in range(hues.shape[1]):
        h1, h2 = hues[0, pixel], hues[1, pixel]
        h1 += 2.0 * np.pi if h1 < 0.0 else 0.0
        h2 += 2.0 * np.pi if h2 < 0.0 else 0.0
        difference, total = h2 - h1, h1 + h2
        mean = total
        if abs(difference) > np.pi:
            mean += 2.0 * np.pi if total < 2.0 * np.pi else -2.0 * np.pi
            difference += -2.0 * np.pi if difference > 0.0 else 2.0 * np.pi
        hues[0, pixel] = difference / 2.0
        hues[1, pixel] = total if chroma[0, pixel] * chroma[1, pixel] == 0.0 else mean / 2.0


@compiled
def difference_of_terms(
    first: Floats, second: Floats, chroma: Floats, sine_half: Floats, cosine: Floats, sine: Floats, turn: Floats,
    result: Floats,
) -> None:  # fmt: skip
    """Put CIEDE2000 into the result, (pixels,), from L* and C' of both colours and the sines and cosines of the hues.

    Of half the hue difference, of the mean hue, and of the rotation angle 60 deg exp(-((h - 275 deg) / 25 deg)^2).
    Multiples of the mean hue come from its cosine and sine.
    """
    for pixel in range(result.shape[0]):
        l1, l2, c1, c2 = first[0, pixel], second[0, pixel], chroma[0, pixel], chroma[1, pixel]
        c, s = cosine[pixel], sine[pixel]
        double, double_sine = 2.0 * c * c - 1.0, 2.0 * s * c
        triple, triple_sine = c * (2.0 * double - 1.0), s * (2.0 * double + 1.0)
        weight = (
            1.0
            - 0.17 * (c * _COS_30 + s * _SIN_30)
            + 0.24 * double
            + 0.32 * (triple * _COS_6 - triple_sine * _SIN_6)
            - 0.20 * ((2.0 * double * double - 1.0) * _COS_63 + 2.0 * double_sine * double * _SIN_63)
        )
        mean, from_grey = (c1 + c2) / 2.0, (l1 + l2) / 2.0 - 50.0
        seventh = mean * mean * mean * mean * mean * mean * mean
        lightness = (l2 - l1) / (1.0 + 0.015 * from_grey * from_grey / np.sqrt(20.0 + from_grey * from_grey))
        chroma_term = (c2 - c1) / (1.0 + 0.045 * mean)
        hue = 2.0 * np.sqrt(c1 * c2) * sine_half[pixel] / (1.0 + 0.015 * mean * weight)
        rotation = -2.0 * np.sqrt(seventh / (seventh + _CHROMA_SCALE_7)) * turn[pixel]
        square = lightness * lightness + chroma_term * chroma_term + hue * hue + rotation * chroma_term * hue
        # The form is positive definite but can round below zero for equal colours.
        result[pixel] = np.sqrt(max(square, 0.0))
