"""From the image of a tactile sensor to surface normals and depth, and how well one light angle suits this.

Captured counts become one RGB value per pixel with the black level removed. A map turns the change of colour against
the no-contact image, and the place in the picture, into the slope of the gel; slopes are integrated to a depth, the
least-squares solution of Poisson's equation by cosine transforms. Applied to a simulated and a captured press, the same
map shows how much the sensor would see them differ. :func:`finray_calib.sensing.fit_normal_map` teaches the map with
presses of a ball.

How well a light angle suits the sensor is computed from tables of colours: a facet with slopes g = (g_x, g_z) over the
pad's plane has the normal n ~ (-g_x, 1, -g_z); signals are electrons per pixel, and the caller sets the exposure.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from data_schemas import CompareError, TactileCapture, bayer_planes

Floats = NDArray[np.float64]


def rgb_image(counts: NDArray[np.uint16], capture: TactileCapture) -> Floats:
    """Return (H, W, 3) values in DN with the black level removed.

    A Bayer frame becomes one RGB value per 2 x 2 cell (half the size, the two greens averaged): no value is
    interpolated from neighbours. Values are proportional to light only where ``capture.encoding`` is "linear".
    A value that was clipped in any sample of its cell is NaN.
    """
    values = np.subtract(counts, capture.black_level_dn, dtype=np.float64)
    np.putmask(values, counts >= 2**capture.bit_depth - 1, np.nan)
    return per_cell(values, capture)


def per_cell(values: Floats, capture: TactileCapture) -> Floats:
    """Return (H, W, 3) of an RGB image as it is, of a Bayer image one RGB value per cell."""
    return values if capture.layout == "RGB" else bayer_planes(values[..., 0])


def full_scale_dn(capture: TactileCapture) -> float:
    """Return full scale above black level, DN."""
    return float(2.0**capture.bit_depth - 1.0 - capture.black_level_dn)


Mask = NDArray[np.bool_]
# the frame of the picture, in shares of its shorter side
_FRAME_SHARE = 0.05


def frame_of(shape: tuple[int, ...]) -> Mask:
    """Return the pixels of the frame of a picture, where the gel is taken to be untouched."""
    width = max(1, round(_FRAME_SHARE * min(shape[:2])))
    frame: Mask = np.ones(shape[:2], dtype=np.bool_)
    frame[width:-width, width:-width] = False
    return frame


DEGREE: Final = 3
"""56 terms in three colours and two coordinates."""
_VARIABLES: Final = 5


@dataclass(frozen=True, slots=True)
class NormalMap:
    """A polynomial from colour change and place to slopes.

    Attributes
    ----------
    coefficients
        (term, 2): slope along columns and along rows, mm per mm; terms as :func:`polynomial_terms` orders them.
    degree
        Of the polynomial.
    low, high
        (3,) range of the relative colour change that the presses covered; beyond it the map holds its value.
    shape_px
        Rows and columns of the images.
    """

    coefficients: Floats
    degree: int
    low: Floats
    high: Floats
    shape_px: tuple[int, int]

    def slopes(self, image: Floats, no_contact: Floats, scale: float | None = None) -> Floats:
        """Return the slopes (H, W, 2) of the gel along columns and rows: d depth / d place, depth into the gel.

        Parameters
        ----------
        image, no_contact
            (H, W, 3) in one unit; of the map's size, or averaged over square blocks of it.
        scale
            What the change of colour is relative to, by default :func:`mean_level` of `no_contact`.

        Raises
        ------
        CompareError
            When the images have another size than those that taught the map, or the no-contact image is black.
        """
        self._check_size(image)
        self._check_size(no_contact)
        rows, columns = image.shape[:2]
        change = np.clip(relative_change(image, no_contact, scale), self.low, self.high)
        x, y = coordinates((rows, columns))
        terms = polynomial_terms(change.reshape(-1, 3), x.ravel(), y.ravel(), self.degree)
        return np.asarray((terms @ self.coefficients).reshape(rows, columns, 2))

    def outside_share(self, image: Floats, no_contact: Floats, region: Mask, scale: float | None = None) -> float:
        """Return the share of the region's pixels whose change of colour no calibration press showed."""
        change = relative_change(image, no_contact, scale)[region]
        return float(np.mean(((change < self.low) | (change > self.high)).any(axis=-1)))

    def _check_size(self, image: Floats) -> None:
        """Refuse an image that is neither of the map's size nor averaged over blocks of it."""
        rows, columns = self.shape_px
        if image.ndim == 3 and image.shape[2] == 3:
            block = max(1, round(rows / image.shape[0]))
            if image.shape[:2] == (rows // block, columns // block):
                return
        raise CompareError(
            f"the normal map was fitted to colour images of {columns} x {rows} px, but this image has "
            f"{size_in_words(image)}; fit a map to presses of this camera"
        )


def polynomial_terms(rgb: Floats, x: Floats, y: Floats, degree: int = DEGREE) -> Floats:
    """Return all monomials of colour and place up to a degree.

    Parameters
    ----------
    rgb
        (n, 3) change of colour, scaled to about 1.
    x, y
        (n,) place in the picture, -1 to 1.
    degree
        Highest degree, >= 0.

    Returns
    -------
    (n, (degree + 5)! / (degree! 5!)): 1 first, then by degree; 21 terms for degree 2, 56 for 3.
    """
    variables = np.column_stack([rgb, x, y])
    columns: dict[tuple[int, ...], int] = {(): 0}
    for order in range(1, degree + 1):
        for chosen in combinations_with_replacement(range(_VARIABLES), order):
            columns[chosen] = len(columns)
    terms = np.empty((len(variables), len(columns)), order="F")
    terms[:, 0] = 1.0
    for chosen, column in columns.items():
        if chosen:  # a term of one degree less, times one variable more
            np.multiply(terms[:, columns[chosen[:-1]]], variables[:, chosen[-1]], out=terms[:, column])
    return terms


def relative_change(image: Floats, no_contact: Floats, scale: float | None = None) -> Floats:
    """Return (image - no_contact) / scale, by default the mean level of the no-contact image.

    A scale common to all channels and pixels takes out exposure and brightness of the lights, and nothing else.
    """
    return np.asarray((image - no_contact) / (mean_level(no_contact) if scale is None else scale))


def mean_level(no_contact: Floats) -> float:
    """Return the mean of an image over all pixels and channels; NaN is left out.

    Raises
    ------
    CompareError
        When it is not above zero.
    """
    finite = np.isfinite(no_contact)
    level = float(no_contact[finite].mean()) if finite.any() else 0.0
    if not level > 0.0:
        raise CompareError("the no-contact image is black or clipped everywhere; check the exposure and the file")
    return level


@cache
def coordinates(shape_px: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return x along columns and y along rows of the pixels' centres, -1 to 1 from edge to edge, each (H, W)."""
    y, x = ((2.0 * np.arange(size) + 1.0) / size - 1.0 for size in shape_px)
    return np.tile(x, (shape_px[0], 1)), np.tile(y[:, None], (1, shape_px[1]))


def angles_deg(one: Floats, other: Floats) -> Floats:
    """Return the angle (...) between the normals (-slope, 1) of two fields of slopes (..., 2), deg."""
    # the cross product of both normals; an arc cosine of the dot product would be blind to small angles
    difference = one - other
    turn = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    sine = np.sqrt((difference**2).sum(axis=-1) + turn**2)
    return np.asarray(np.degrees(np.arctan2(sine, 1.0 + (one * other).sum(axis=-1))))


def size_in_words(image: Floats) -> str:
    """Return the size of an image in words."""
    return f"{image.shape[1]} x {image.shape[0]} px" if image.ndim == 3 else f"shape {image.shape}"


def filled_slopes(slopes: Floats) -> Floats:
    """Return slopes (H, W, 2) whose missing ones, of clipped pixels, are the mean of what lies around them.

    Weighted by a Gaussian of 4 px, farther where that finds nothing; flat where nothing is known. Taken as flat, the
    bright side of a dent would be missing from its depth.
    """
    usable: Mask = np.asarray(np.isfinite(slopes).all(axis=-1), dtype=np.bool_)
    known = np.where(usable[..., None], slopes, 0.0)
    found, missing = known.copy(), ~usable
    for sigma_px in (4.0, 8.0, 16.0, 32.0):
        if not missing.any():
            break
        weight = cv2.GaussianBlur(usable.astype(np.float64), (0, 0), sigma_px)
        mean = cv2.GaussianBlur(known, (0, 0), sigma_px)
        told = missing & (weight > _LEAST_WEIGHT)
        found[told] = mean[told] / weight[told][:, None]
        missing &= ~told
    return found


_LEAST_WEIGHT = 0.02


def poisson_depth_mm(slopes: Floats, mm_per_px: float) -> Floats:
    """Return the depth whose differences from pixel to pixel come nearest to the slopes.

    Minimises the sum over neighbours of (z_b - z_a - h (s_a + s_b) / 2)^2, h = `mm_per_px`; nothing is assumed at the
    edges (Neumann). Exact for every depth that is a polynomial of second degree.

    Parameters
    ----------
    slopes
        (H, W, 2): d depth / d column and d depth / d row, mm per mm; finite.
    mm_per_px
        Side of a pixel on the gel.

    Returns
    -------
    (H, W), mm, of mean zero: slopes do not determine a constant.
    """
    rows, columns = slopes.shape[:2]
    divergence = np.zeros((rows, columns))
    along = mm_per_px * (slopes[:, :-1, 0] + slopes[:, 1:, 0]) / 2.0
    down = mm_per_px * (slopes[:-1, :, 1] + slopes[1:, :, 1]) / 2.0
    divergence[:, :-1] += along
    divergence[:, 1:] -= along
    divergence[:-1] += down
    divergence[1:] -= down
    cosines = [2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in (rows, columns)]
    laplacian = -(cosines[0][:, None] + cosines[1])
    spectrum = dctn(divergence, type=2, norm="ortho")
    laplacian[0, 0] = 1.0
    spectrum /= laplacian
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, type=2, norm="ortho"))


@dataclass(frozen=True, slots=True)
class SensingError:
    """Difference between what the sensor senses in a render and in the capture.

    Attributes
    ----------
    normal_angle_mean_deg, normal_angle_p95_deg
        Angle between both normals over the region.
    depth_rms_mm
        Difference of both integrated depths over the region, its median removed.
    outside_share_simulated, outside_share_captured
        Share of the region's pixels whose change of colour no calibration press showed; there the map keeps its last
        value, and above a few per cent the other figures are not meaningful.
    pixels
        Of the region that could be used.
    angle_deg
        (H, W) the angle, NaN outside the region.
    """

    normal_angle_mean_deg: float
    normal_angle_p95_deg: float
    depth_rms_mm: float
    outside_share_simulated: float
    outside_share_captured: float
    pixels: int
    angle_deg: NDArray[np.float32]


def sensing_error(
    normal_map: NormalMap,
    simulated: Floats,
    simulated_no_contact: Floats,
    captured: Floats,
    no_contact: Floats,
    region: Mask,
    mm_per_px: float,
) -> SensingError:
    """Apply one normal map to a render and a capture, and compare normals and depth.

    Parameters
    ----------
    normal_map
        Fitted to calibration presses of the capture's sensor.
    simulated, simulated_no_contact, captured, no_contact
        (H, W, 3), in one unit and at one exposure (the render brought to the capture's level); NaN where clipped. All
        changes are relative to the mean level of `no_contact`.
    region
        (H, W), the contact.
    mm_per_px
        Side of a pixel of these images on the gel.

    Raises
    ------
    CompareError
        When no pixel of the region is usable, or a size differs from that of the map.
    """
    images = (simulated, simulated_no_contact, captured, no_contact)
    level = mean_level(no_contact)
    slopes = [normal_map.slopes(image, rest, level) for image, rest in (images[:2], images[2:])]
    usable: Mask = np.asarray(np.isfinite(np.concatenate(slopes, axis=-1)).all(axis=-1), dtype=np.bool_)
    used: Mask = region & usable
    if not used.any():
        raise CompareError(
            "every pixel of the region is clipped or missing in the render or the capture; reduce the exposure, or "
            "check the place of the contact"
        )
    angle = angles_deg(slopes[0], slopes[1])
    # a clipped pixel breaks both surfaces at the same place
    depths = [poisson_depth_mm(np.where(usable[..., None], s, 0.0), mm_per_px) for s in slopes]
    difference = (depths[0] - depths[1])[used]
    return SensingError(
        normal_angle_mean_deg=float(angle[used].mean()),
        normal_angle_p95_deg=float(np.percentile(angle[used], 95.0)),
        depth_rms_mm=float(np.sqrt(np.mean((difference - np.median(difference)) ** 2))),
        outside_share_simulated=normal_map.outside_share(simulated, simulated_no_contact, used, level),
        outside_share_captured=normal_map.outside_share(captured, no_contact, used, level),
        pixels=int(used.sum()),
        angle_deg=np.where(used, angle, np.nan).astype(np.float32),
    )


#: Of the polynomial from colour and place to slopes: 56 terms of five variables, enough for the bend of both.
POLYNOMIAL_DEGREE: Final = 3


def normal_sigma_deg(jacobian_e: Floats, variance_e2: Floats) -> Floats:
    r"""Return the least standard deviation with which one pixel gives the direction of a normal (Cramer-Rao bound).

    .. math:: F = J^T \mathrm{diag}(1 / v) J, \qquad \sigma = \sqrt{\mathrm{tr} F^{-1} / 2}

    Valid for independent normal noise of the channels and a facet near the plane, where a slope is an angle. It
    combines brightness and the separation of colours: three channels that change alike determine no direction.

    Parameters
    ----------
    jacobian_e
        Derivatives of the channels by both slopes, (..., channel, 2), in e.
    variance_e2
        Variance of each channel, (..., channel), in e^2.

    Returns
    -------
    array
        Standard deviation per direction in deg, (...); infinite where the colours determine no slope.

    Raises
    ------
    CompareError
        When shapes do not fit each other or a variance is not positive.

    References
    ----------
    S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory (1993), section 3.7.
    """
    if jacobian_e.shape != (*variance_e2.shape, 2) or not (variance_e2 > 0.0).all():
        raise CompareError(
            "the Fisher information needs derivatives of shape (..., channel, 2) and positive variances of shape "
            f"(..., channel), got shapes {jacobian_e.shape} and {variance_e2.shape} with a least variance of "
            f"{variance_e2.min():g} e^2. Check the table"
        )
    information = np.einsum("...ci,...c,...cj->...ij", jacobian_e, 1.0 / variance_e2, jacobian_e)
    a, b, c = information[..., 0, 0], information[..., 1, 1], information[..., 0, 1]
    determinant = a * b - c * c
    # a dozen roundings leave a singular matrix slightly off zero
    regular = determinant > 16.0 * np.finfo(np.float64).eps * np.maximum(a * b, np.finfo(np.float64).tiny)
    trace = np.divide(a + b, determinant, out=np.full(a.shape, np.inf), where=regular)
    return np.asarray(np.degrees(np.sqrt(trace / 2.0)))


def held_out_normal_error_deg(
    signals: Floats,
    places_mm: Floats,
    slopes: Floats,
    folds: int = 3,
    degree: int = POLYNOMIAL_DEGREE,
    taught: Floats | None = None,
) -> Floats:
    r"""Return the angle between true and estimated normals at places that the calibration has not seen.

    Points fall into folds in turn. For each fold the polynomial (R, G, B, x, z) -> (g_x, g_z) is fitted by least
    squares to all facets of the other folds and applied to the facets of this one, as a tactile sensor that was
    calibrated with presses elsewhere. Noise is in the signals, in the calibration as in the judgement.

    Parameters
    ----------
    signals
        (point, facet, frame, channel), any linear unit: frames are independent repeats of the camera's noise.
    places_mm
        (x, z) of the points, (point, 2).
    slopes
        True slopes of the facets, (facet, 2).
    folds
        At least 2, at most the number of points.
    degree
        Of the polynomial.
    taught
        Signals of the same points on the finger that was calibrated, in the same shape; by default it is this one.

    Returns
    -------
    array
        Angle in deg, (point, facet, frame).

    Raises
    ------
    CompareError
        When shapes do not fit each other, or the calibration has fewer rows than the polynomial has terms.
    """
    _check_table(signals, places_mm, slopes, folds, degree)
    if taught is not None and taught.shape != signals.shape:
        raise CompareError(
            f"the calibrated finger has signals of shape {taught.shape}, but this finger has signals of shape "
            f"{signals.shape}; give signals of the same shape"
        )
    points, facets, frames, _ = signals.shape
    place = np.broadcast_to(places_mm[:, None, None], (points, facets, frames, 2))
    inputs = np.concatenate([signals, place], axis=-1)
    teaching = inputs if taught is None else np.concatenate([taught, place], axis=-1)
    truth = np.broadcast_to(slopes[None, :, None], (points, facets, frames, 2))
    found = np.empty(truth.shape)
    for held_out, others in _folds(points, folds):
        seen = teaching[others].reshape(-1, inputs.shape[-1])
        centre, spread = seen.mean(axis=0), seen.std(axis=0)
        # a variable that does not vary tells nothing, and must not be divided by zero
        scale = np.where(spread > 0.0, spread, 1.0)
        terms = _monomials((seen - centre) / scale, degree)
        weights = np.linalg.lstsq(terms, truth[others].reshape(-1, 2), rcond=None)[0]
        asked = (inputs[held_out].reshape(-1, inputs.shape[-1]) - centre) / scale
        found[held_out] = (_monomials(asked, degree) @ weights).reshape(-1, facets, frames, 2)
    return angle_between_deg(found, truth)


def angle_between_deg(slopes: Floats, other_slopes: Floats) -> Floats:
    """Return the angle between the normals of slopes (..., 2) and (..., 2) in deg, (...)."""
    a, b = (np.concatenate([-g[..., :1], np.ones((*g.shape[:-1], 1)), -g[..., 1:]], axis=-1) for g in (
        slopes, other_slopes))  # fmt: skip
    # exact for small angles, where the cosine is not
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (a * b).sum(axis=-1))))


def uniformity(luminance: Floats) -> float:
    """Return the 5 % over the 95 % quantile of the luminance without contact: 1 where all places are equally bright.

    Raises
    ------
    CompareError
        When there is no place, or one without light.
    """
    if luminance.size == 0 or not (luminance > 0.0).all():
        raise CompareError(
            f"the uniformity needs positive luminances at one place or more, got {luminance.size} values with a "
            f"minimum of {luminance.min(initial=np.inf):g}. Check the light panel"
        )
    low, high = np.quantile(luminance, [0.05, 0.95])
    return float(low / high)


def _folds(points: int, folds: int) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Yield which points are held out and which are not."""
    fold = np.arange(points) % folds
    for k in range(folds):
        yield fold == k, fold != k


def _monomials(inputs: Floats, degree: int) -> Floats:
    """Return all products of up to `degree` of the variables, (row, term)."""
    columns = [np.ones(len(inputs))]
    for order in range(1, degree + 1):
        for chosen in combinations_with_replacement(range(inputs.shape[1]), order):
            columns.append(np.prod(inputs[:, chosen], axis=1))
    return np.stack(columns, axis=1)


def _check_table(signals: Floats, places_mm: Floats, slopes: Floats, folds: int, degree: int) -> None:
    """Refuse a table that allows no calibration."""
    if signals.ndim != 4 or places_mm.shape != (signals.shape[0], 2) or slopes.shape != (signals.shape[1], 2):
        raise CompareError(
            "a calibration table needs signals of shape (point, facet, frame, channel), places of shape (point, 2) "
            f"and slopes of shape (facet, 2), got {signals.shape}, {places_mm.shape} and {slopes.shape}"
        )
    variables = signals.shape[3] + 2
    terms = len(_monomials(np.zeros((1, variables)), degree)[0])
    points = signals.shape[0]
    if not 2 <= folds <= points:
        raise CompareError(f"the number of folds must be 2 to {points} for {points} held-out points, got {folds}")
    rows = (points - -(-points // folds)) * signals.shape[1] * signals.shape[2]
    if rows < terms:
        raise CompareError(
            f"the calibration has only {rows} rows, but needs at least {terms}, one for each term of a polynomial of "
            f"degree {degree}; take more points, facets or frames, or a smaller degree"
        )
