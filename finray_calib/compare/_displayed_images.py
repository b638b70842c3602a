"""The candidates as a screen would show them, and how different people see them: CIEDE2000 and FLIP.

Candidates are doing nothing, the render, and a perfect render seen on the repeat; each is formed once. Colour
differences are for displayed images only: a photometric error belongs in linear light. The pointwise arithmetic of
CIEDE2000 is compiled; powers and angles stay with numpy, which forms several at once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, MissingExtraError, TactileCapture
from finray_calib.compare._comparison import Comparison
from finray_calib.compare._region_sums import Captured
from finray_calib.compare._regions import usable_pixels
from finray_calib.compare._structural_similarity import (
    StructuralSimilarity,
    multi_scale_similarity,
    structural_similarity,
)
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
    flip : float or None
        Mean over the headline region; None without the extra 'flip'.
    colour_difference : ndarray, shape (H, W)
        CIEDE2000 to the capture as displayed; NaN where one of them is missing.
    """

    image: Floats
    variance: Floats
    similarity: StructuralSimilarity
    ms_ssim: float | None
    flip: float | None
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
    return {name: _shown(*image, captured, comparison.used[-1], capture) for name, image in images.items()}


def _shown(
    image: Floats, variance: Floats, captured: Captured, headline: Bools, capture: TactileCapture
) -> ShownCandidate:
    """Return a candidate with its likeness to the captured contact image."""
    linear, data_range_dn = capture.encoding == "linear", full_scale_dn(capture)
    white_dn = display_white_dn(captured.no_contact) if linear else data_range_dn
    contact = captured.contact
    usable: Bools = np.asarray(np.isfinite(contact + image).all(axis=2), dtype=np.bool_)
    shown = [displayed_image(np.where(usable[..., None], i, 0.0), white_dn, linear) for i in (image, contact)]
    multi_scale = multi_scale_similarity(image, contact, data_range_dn)
    return ShownCandidate(
        image,
        variance,
        structural_similarity(image, contact, data_range_dn),
        None if multi_scale is None else multi_scale.value,
        _flip(shown[1], shown[0], headline),
        np.where(usable, colour_difference_map(*shown), np.nan),
    )


def _flip(captured_srgb: Floats, candidate_srgb: Floats, where: Bools) -> float | None:
    """Return the mean FLIP, where its package is installed."""
    try:
        return flip_mean(captured_srgb, candidate_srgb, where)
    except MissingExtraError:
        return None


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
            f"The no-contact image is black ({WHITE_PERCENTILE} % of it lies at or below {white_dn:g} DN above the "
            "black level), so it cannot be shown: check the light and the black level of the capture"
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
        raise CompareError(f"The white level must be positive, got {white_dn} DN; give full scale, as 255 for 8 bit")
    share = np.clip(image / white_dn, 0.0, 1.0)
    if not linear:
        return np.asarray(share)
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)


#: A 0.7 m wide screen of 3840 pixels seen from 0.7 m: the default of FLIP's makers.
PIXELS_PER_DEGREE = 67.0
#: Nothing farther away enters a pixel: the widest filter, of blue and yellow, is cut at 3 sqrt(0.04 / 2 pi^2) deg.
_FLIP_REACH_DEG = 0.16


def flip_mean(
    reference_srgb: Floats, test_srgb: Floats, mask: NDArray[np.bool_], pixels_per_deg: float = PIXELS_PER_DEGREE
) -> float:
    """Return the mean LDR-FLIP over a region, 0 (no visible difference) to 1.

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
    MissingExtraError
        The package flip-evaluator is not installed.

    References
    ----------
    P. Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3 (2020) 15.
    """
    used = usable_pixels(mask, reference_srgb, test_srgb)
    try:
        import flip_evaluator
    except ImportError:
        raise MissingExtraError(
            "FLIP needs the package flip-evaluator: pip install 'finray-calib[flip]', or leave this row out"
        ) from None
    near = _around(used, int(np.ceil(_FLIP_REACH_DEG * pixels_per_deg)))
    reference_srgb, test_srgb, used = reference_srgb[near], test_srgb[near], used[near]
    finite = np.asarray(np.isfinite(reference_srgb + test_srgb).all(axis=2))[..., None]
    reference, test = (np.where(finite, image, 0.0).astype(np.float32) for image in (reference_srgb, test_srgb))
    error, _, _ = flip_evaluator.evaluate(
        reference, test, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False,
        parameters={"ppd": pixels_per_deg},
    )  # fmt: skip
    return float(np.asarray(error, dtype=np.float64).reshape(used.shape)[used].mean())


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
    encoded = _checked_srgb(srgb)
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
    return _in_chunks(_difference, first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape[:-1])


def colour_difference_map(first_srgb: Floats, second_srgb: Floats) -> Floats:
    """Return the CIEDE2000 difference of two displayed images, pixel by pixel.

    Parameters
    ----------
    first_srgb, second_srgb : ndarray, shape (H, W, 3)
        Encoded sRGB, 0..1.

    Returns
    -------
    ndarray, shape (H, W)

    Raises
    ------
    CompareError
        If the shapes differ or values lie outside 0..1.
    """
    if first_srgb.shape != second_srgb.shape:
        raise CompareError(
            f"Displayed images must have one shape, got {first_srgb.shape} and {second_srgb.shape}. Crop them first."
        )
    first, second = _checked_srgb(first_srgb), _checked_srgb(second_srgb)
    return _in_chunks(_srgb_difference, first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape[:-1])


def _checked_srgb(srgb: Floats) -> Floats:
    """Return sRGB values as floats, or say what they must be."""
    encoded = np.asarray(srgb, dtype=np.float64)
    if encoded.shape[-1:] != (3,) or not ((encoded >= 0) & (encoded <= 1)).all():
        raise CompareError(
            f"sRGB values must be 0..1 in three channels on the last axis, got shape {encoded.shape}. Divide 8-bit "
            "values by 255."
        )
    return encoded


def _in_chunks(difference: Callable[[Floats, Floats], Floats], first: Floats, second: Floats) -> Floats:
    """Apply a difference of planes (3, pixels) to two lists of pixels, shape (P, 3)."""
    result = np.empty(len(first))
    for start in range(0, len(first), _CHUNK_PX):
        chunk = slice(start, start + _CHUNK_PX)
        result[chunk] = difference(_planes(first[chunk]), _planes(second[chunk]))
    return result


def _planes(pixels: Floats) -> Floats:
    """Return a copy of a list of pixels as planes (3, pixels)."""
    return np.array(pixels.T, order="C")


def _lab_planes(srgb: Floats) -> Floats:
    """Return L*, a*, b* of sRGB planes."""
    ratios = np.empty_like(srgb)
    white_ratios(srgb, ((srgb + 0.055) / 1.055) ** 2.4, _TO_RATIO, ratios)
    lab_of_ratios(ratios, np.cbrt(ratios))
    return ratios


def _srgb_difference(first: Floats, second: Floats) -> Floats:
    """Return the CIEDE2000 difference of sRGB planes."""
    return _difference(_lab_planes(first), _lab_planes(second))


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
