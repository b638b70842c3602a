"""Where the contact is in an image: distances from a circle or an outline, and a search.

Where nobody has drawn the contact, the search finds it. Under coloured lights a ball tilts the gel, so that one side of
the contact turns bright and the other dark: an odd signal. Sensors that darken with depth show an even one. The search
uses the stronger of the two.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from data_schemas import CompareError, ContactCircle, MissingPart, PlaceInImage, TactileCapture
from finray_calib.sensing._normal_map import per_cell, rgb_image

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

SMALLEST_RADIUS_PX: Final = 10.0
_LARGEST_SHARE = 0.35
_SCALES = 12
_COARSE_PX = 4
_SURROUND = 1.3
# rays around the circle, and where along them the rim is looked for, in radii
_RAYS = 72
_INSIDE, _OUTSIDE = np.linspace(0.86, 1.0, 4), np.linspace(1.1, 1.3, 4)
# how far the rim may lie from the centre of the coarse search, in radii of the smallest circle
_REACH_REL = 0.6
_STEPS_PX = (1.5, 0.75)
_SMOOTHED_PX: Final = 1.5
#: Pictures that are wider or higher are searched in blocks, and the circle is then refined in their own pixels.
LARGEST_SEARCHED_PX: Final = 640
# of an outline: what counts as a change of the picture
_LEAST_CHANGE, _CHANGED_SHARE = 0.01, 1.0 / 3.0


def outline_distance(inside: NDArray[np.bool_]) -> Floats:
    """Return the distance from the contact in half-widths for a contact of any shape.

    With d the distance from the outline in pixels, positive outside, and w the largest distance inside, 1 + d / w: 1 on
    the outline, 0 at the middle. Of a disc it is the distance from its centre over its radius.

    Parameters
    ----------
    inside : ndarray of bool, shape (H, W)
        At least one pixel.
    """
    if inside.all():
        return np.zeros(inside.shape)
    within = np.asarray(distance_transform_edt(inside), dtype=np.float64)
    outside = np.asarray(distance_transform_edt(~inside), dtype=np.float64)
    # the outline runs between pixels: half a pixel from the last one on either side
    signed = np.where(inside, 0.5 - within, outside - 0.5)
    width = max(float(within.max()) - 0.5, 0.5)
    return np.asarray(np.maximum(1.0 + signed / width, 0.0))


def contact_distance(capture: TactileCapture) -> Floats | None:
    """Return the distance from the contact in half-widths for each pixel of the capture's colour image.

    Returns
    -------
    ndarray, shape (H, W), or None
        A Bayer cell is one pixel. None where the capture has neither a circle nor an outline.

    Raises
    ------
    CompareError
        The outline encloses no pixel of the image.
    """
    raw_rows, raw_columns = capture.contact.shape[:2]
    circle, outline = capture.contact_circle, capture.contact_outline
    if circle is not None:
        cell = 1 if capture.layout == "RGB" else 2
        rows, columns = np.indices((raw_rows // cell, raw_columns // cell))
        row_px, column_px = ((value + 0.5) / cell - 0.5 for value in (circle.row_px, circle.column_px))
        return np.asarray(np.hypot(rows - row_px, columns - column_px) / (circle.radius_px / cell))
    if outline is None:
        return None
    corners = np.array([[place.column_px, place.row_px] for place in outline])
    filled = np.zeros((raw_rows, raw_columns, 1), np.uint8)
    cv2.fillPoly(filled, [np.rint(corners).astype(np.int32)], 1)
    inside = per_cell(filled.astype(np.float64), capture)[..., 0] > 0.5
    if not inside.any():
        raise CompareError(
            f"{capture.name}: the contact outline encloses no pixel of the image of {raw_columns} x {raw_rows} px; "
            "check whether rows and columns are exchanged"
        )
    return outline_distance(inside)


ROW_AND_COLUMN: Final = "row and column"
#: What may be exchanged between picture and label -> column and row of a circle if it were, from what they are.
CIRCLE_IF: Final[dict[str, Callable[[float, float, int, int], tuple[float, float]]]] = {
    ROW_AND_COLUMN: lambda column, row, columns, rows: (row, column),
    "left and right": lambda column, row, columns, rows: (columns - 1 - column, row),
    "top and bottom": lambda column, row, columns, rows: (column, rows - 1 - row),
    "left and right as well as top and bottom": lambda column, row, columns, rows: (
        columns - 1 - column,
        rows - 1 - row,
    ),
}


def changes_elsewhere(capture: TactileCapture) -> dict[str, float]:
    r"""Return how much denser the change by contact is where its circle would be in a picture arranged otherwise.

    .. math:: r = (c_{there} - m) / \max(c_{own} - m, m)

    with the mean change c within a circle and the median change m of the picture, which light and noise give anywhere.

    Returns
    -------
    dict
        What is exchanged, of `CIRCLE_IF` -> r, below 1 for a circle on its contact and above 1 for one that is not.
        Pixels of both circles do not count. What cannot tell is left out: circles outside the picture, those whose
        centre lies in the own one or that overlap it and change as much (many gels change on both sides of an axis),
        and presses that show nothing, c - m <= m in both circles.
    """
    circle, (rows, columns) = capture.contact_circle, capture.contact.shape[:2]
    if circle is None:
        return {}
    change = np.abs(capture.contact.astype(np.float64) - capture.no_contact).mean(axis=-1)
    anywhere = float(np.median(change))
    y, x = np.ogrid[:rows, :columns]

    def inside(column_px: float, row_px: float) -> NDArray[np.bool_]:
        return np.asarray(np.hypot(y - row_px, x - column_px) < circle.radius_px)

    def denser(pixels: NDArray[np.bool_]) -> float:
        return float(change[pixels].mean()) - anywhere if pixels.any() else 0.0

    own = inside(circle.column_px, circle.row_px)
    found = {}
    for said, place in CIRCLE_IF.items():
        column, row = place(circle.column_px, circle.row_px, columns, rows)
        apart = np.hypot(column - circle.column_px, row - circle.row_px) / circle.radius_px
        if row < rows and column < columns and apart >= 1.0:
            there = inside(column, row)
            of_both = denser(there & ~own), denser(own & ~there)
            ratio = of_both[0] / max(of_both[1], anywhere, 1e-9)
            if max(of_both) > anywhere and (apart >= 2.0 or not 1.0 / _DENSER_ELSEWHERE <= ratio <= _DENSER_ELSEWHERE):
                found[said] = ratio
    return found


#: A press speaks against its circle where the change by contact is so much denser elsewhere, and for it where it is so
#: much less dense; so many must speak against, more than twice as many as for, and a fifth of all that can tell: right
#: labels of 83 real presses had at most 3 against and then 9 for, mirrored and exchanged ones the reverse, of 42.
_DENSER_ELSEWHERE, _LEAST_PRESSES, _MAJORITY, _LEAST_SHARE = 1.5, 3, 2, 0.2
#: A single press speaks against its own circle from here on; right labels of these presses reached 1.8.
_SURELY_ELSEWHERE = 2.0


@dataclass(frozen=True, slots=True)
class CircleVote:
    """What is exchanged between pictures and labels by the majority of the presses that can tell.

    Attributes
    ----------
    exchanged
        Of `CIRCLE_IF`.
    presses, against, right
        That can tell: that change clearly more in one of both places; there, where their circle would be; where it is.
    median_ratio
        Of those against: how much denser the change is elsewhere, see :func:`changes_elsewhere`.
    """

    exchanged: str
    presses: int
    against: int
    right: int
    median_ratio: float


def vote_on_circles(changes: Sequence[Mapping[str, float]]) -> CircleVote | None:
    """Return what is exchanged, by what :func:`changes_elsewhere` found of each press; None where nothing is.

    Three presses at least must say so, more than twice as many as say the contrary, and a fifth of all of which
    something is known, so that neither a few wrong labels nor a gel that changes on both sides of an axis decides. One
    or two presses show that rows and columns are exchanged, if there are no more.
    """
    votes = []
    for said in CIRCLE_IF:
        of = [found[said] for found in changes if said in found]
        ratios, right = [r for r in of if r > _DENSER_ELSEWHERE], sum(r < 1.0 / _DENSER_ELSEWHERE for r in of)
        against = len(ratios)
        least = min(_LEAST_PRESSES, len(changes)) if said == ROW_AND_COLUMN else _LEAST_PRESSES
        if against >= max(least, _LEAST_SHARE * len(of), 1) and against > _MAJORITY * right:
            votes.append(CircleVote(said, against + right, against, right, float(np.median(ratios))))
    return max(votes, key=lambda vote: (vote.against - vote.right, vote.median_ratio), default=None)


def misplaced_circle(name: str, elsewhere: Mapping[str, float]) -> tuple[MissingPart, ...]:
    """Tell that a press alone changes more where its drawn circle would be, by what :func:`changes_elsewhere` found."""
    said = max(elsewhere, key=elsewhere.__getitem__, default=None)
    if said is None or elsewhere[said] <= _SURELY_ELSEWHERE:
        return ()
    lost = (
        f"{name} changes {elsewhere[said]:.2g} times as much where its circle would be with {said} exchanged: "
        "correct its label, or leave the press out"
    )
    return (MissingPart(what="a circle on the contact", lost=lost),)


@dataclass(frozen=True, slots=True)
class FoundCircle:
    """A contact circle that the search found.

    Attributes
    ----------
    circle
        Centre and radius in pixels of the colour image.
    is_even
        Whether the contact was seen as a disc that is darker or brighter, not as two opposite sides.
    """

    circle: ContactCircle
    is_even: bool


def find_contact_circle(capture: TactileCapture, largest_radius_px: float | None = None) -> FoundCircle:
    """Find the circle of a ball's contact in a picture.

    The logarithm of contact over no contact, less a plane that follows most pixels (drift), is filtered with discs
    whose halves have opposite signs and with uniform discs, each against its surround. The centre is where a filter
    responds most. The radius is that of the ring within which the gel is curved (odd signal), or where the mean signal
    over rings changes its sign (even).

    Parameters
    ----------
    capture
        Of one press.
    largest_radius_px
        Of the ball in pixels, where it is known: a contact circle is smaller.

    Raises
    ------
    CompareError
        The image is smaller than three of the smallest circles, or changes no more than a picture of noise does.
    """
    contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
    full = 2.0**capture.bit_depth - 1.0
    contact, no_contact = (np.nan_to_num(image, nan=full) for image in (contact, no_contact))
    largest = float(min(largest_radius_px or np.inf, _LARGEST_SHARE * min(contact.shape[:2])))
    if largest < SMALLEST_RADIUS_PX:
        raise CompareError(
            f"{capture.name}: no contact circle of {SMALLEST_RADIUS_PX:g} px or more fits; give the circle with "
            "--circles"
        )
    smallest = max(SMALLEST_RADIUS_PX, 0.3 * largest if largest_radius_px else 0.0)
    # in blocks, too, the largest circle is at least twice the smallest one that the search can see
    side = min(-(-max(contact.shape[:2]) // LARGEST_SEARCHED_PX), max(1, int(largest // (2.0 * SMALLEST_RADIUS_PX))))
    small = [_in_blocks(image, side) for image in (contact, no_contact)]
    # the smallest circle of a large picture is large in itself: SMALLEST_RADIUS_PX are those that are looked at
    found = _searched(small[0], small[1], max(smallest / side, SMALLEST_RADIUS_PX), largest / side)
    if found is None:
        raise CompareError(
            "its picture changes with contact no more than noise does, so the search finds no circle; check that it "
            "shows contact, or give the circle with --circles"
        )
    if side == 1:
        return found
    circle = ContactCircle(
        row_px=(found.circle.row_px + 0.5) * side - 0.5,
        column_px=(found.circle.column_px + 0.5) * side - 0.5,
        radius_px=found.circle.radius_px * side,
    )
    whole = FoundCircle(circle, found.is_even)
    return whole if found.is_even else _refined(contact, no_contact, whole, side, largest)


def _in_blocks(image: Floats, side_px: int) -> Floats:
    """Return the means over blocks of pixels; what is left at the edges is cut off."""
    if side_px == 1:
        return image
    rows, columns = (size // side_px for size in image.shape[:2])
    whole = image[: rows * side_px, : columns * side_px]
    small = cv2.resize(np.ascontiguousarray(whole), (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float64)


#: Of a search: so many pictures of white noise are searched alike, and a contact must answer so many times as strongly
#: as the strongest of them, in energy. Noise that demosaicing or JPEG correlates beyond the blocks in which it is
#: measured answered up to 3.5 times as strongly as white noise of the same measure.
_NOISE_PICTURES, _TIMES_NOISE = 10, 4.0


def _searched(contact: Floats, no_contact: Floats, smallest_px: float, largest_px: float) -> FoundCircle | None:
    """Return the circle that a picture of moderate size shows; None where it shows noise alone."""
    signal = _log_change(contact, no_contact, _SMOOTHED_PX)
    odd, even = _answers(signal, smallest_px, largest_px)
    blocks = [np.maximum(_in_blocks(image, _COARSE_PX), 0.0) for image in (contact, no_contact)]
    floor = 1.0 / 255.0 * max(float(blocks[1].max()), 1e-12)
    noise = _TIMES_NOISE * _noise_variance(np.log((blocks[0] + floor) / (blocks[1] + floor)))
    if max(odd.response_rel, even.response_rel) <= noise * _answer_of_noise(signal.shape[:2], smallest_px, largest_px):
        return None
    if even.response_rel > odd.response_rel:
        return _even_circle(signal, even)
    return _odd_circle(_log_change(contact, no_contact, 1.0), odd, smallest_px, largest_px)


def _answers(signal: Image, smallest_px: float, largest_px: float) -> "tuple[_Place, _Place]":
    """Return where the odd and the even filters answer most."""
    odd, even = (_coarse(signal, smallest_px, largest_px, is_even=is_even) for is_even in (False, True))
    return odd, even


def _noise_variance(change: Floats) -> float:
    """Return the variance of the noise of the noisiest channel of a change, in blocks.

    By the second difference along both axes (Immerkaer 1996), of which a smooth change has little, and the median over
    the picture, of which a contact covers less than half.
    """
    second = cv2.filter2D(change, cv2.CV_64F, np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0]))
    # 6 is the norm of the mask, 0.6745 the median of the size of a standard normal deviate
    deviation = np.median(np.abs(second), axis=(0, 1)) / (6.0 * 0.6745)
    return float(deviation.max()) ** 2


@lru_cache(maxsize=16)
def _answer_of_noise(shape: tuple[int, int], smallest_px: float, largest_px: float) -> float:
    """Return the strongest answer to pictures of white noise, over the variance that is measured in them."""
    rng, strongest = np.random.default_rng(0), 0.0
    for _ in range(_NOISE_PICTURES):
        noise = rng.standard_normal((*shape, 3))
        signal = _less_plane(np.asarray(cv2.GaussianBlur(noise, (0, 0), _SMOOTHED_PX), dtype=np.float64))
        found = max(place.response_rel for place in _answers(signal, smallest_px, largest_px))
        strongest = max(strongest, found / _noise_variance(_in_blocks(noise, _COARSE_PX)))
    return strongest


def _refined(contact: Floats, no_contact: Floats, found: FoundCircle, side_px: int, largest_px: float) -> FoundCircle:
    """Return a circle of blocks refined in the pixels around it, by the same rim at the same width."""
    circle = found.circle
    reach = int(np.ceil(1.6 * circle.radius_px))
    top, left = max(int(circle.row_px) - reach, 0), max(int(circle.column_px) - reach, 0)
    part = np.s_[top : int(circle.row_px) + reach + 1, left : int(circle.column_px) + reach + 1]
    energies = _curvature(_log_change(contact[part], no_contact[part], float(side_px)), float(side_px))
    rim = _Rim(np.sqrt((energies**2).sum(axis=-1)))
    best = (circle.column_px - left, circle.row_px - top, circle.radius_px)
    for step in (0.75 * side_px, 0.375 * side_px):
        best = rim.best_near(best, step, largest_px)
    refined = ContactCircle(row_px=best[1] + top, column_px=best[0] + left, radius_px=best[2])
    return FoundCircle(refined, found.is_even)


def find_contact_outline(capture: TactileCapture) -> tuple[PlaceInImage, ...]:
    """Find the outline of a contact of any shape: the hull of the largest part of the picture that changes.

    A pixel changes where the logarithm of contact over no contact, smoothed and less its plane, exceeds a third of the
    99 % quantile in size. The gel's halo belongs to it in part: the outline is rather too large.

    Returns
    -------
    tuple of PlaceInImage
        Corners in order, in pixels of the colour image.

    Raises
    ------
    CompareError
        Nothing changes.
    """
    contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
    full = 2.0**capture.bit_depth - 1.0
    signal = _log_change(np.nan_to_num(contact, nan=full), np.nan_to_num(no_contact, nan=full), 3.0)
    size = cv2.GaussianBlur(np.sqrt((signal**2).sum(axis=-1)), (0, 0), 3.0)
    level = float(np.percentile(size, 99.0))
    if not level > _LEAST_CHANGE:
        raise CompareError(
            f"{capture.name}: the picture hardly changes with contact; check that it is the right frame or file"
        )
    changed = (size > _CHANGED_SHARE * level).astype(np.uint8)
    parts, _ = cv2.findContours(changed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    hull = cv2.approxPolyDP(cv2.convexHull(max(parts, key=cv2.contourArea)), 1.0, True)[:, 0]
    return tuple(PlaceInImage(column_px=float(column), row_px=float(row)) for column, row in hull)


#: A region that shares this much with the circle of its area and centroid is a circle.
_ROUND_SHARE = 0.9


def contact_of_depths(depths_mm: Floats, least_mm: float) -> tuple[ContactCircle | None, tuple[PlaceInImage, ...]]:
    """Return where a gel is deeper than a depth, around its deepest pixel: the circle, if it is round, and the outline.

    Parameters
    ----------
    depths_mm : ndarray, shape (H, W)
        Positive into the gel.
    least_mm
        Below the greatest depth.

    Returns
    -------
    tuple
        The circle of the region's centroid and area, where 90 % of both together are common to both; and the corners
        of the outline through the pixels at the region's rim.
    """
    _, parts = cv2.connectedComponents((depths_mm > least_mm).astype(np.uint8))
    part = parts == parts[np.unravel_index(int(np.argmax(depths_mm)), depths_mm.shape)]
    rims, _ = cv2.findContours(part.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    rim = cv2.approxPolyDP(max(rims, key=len), 0.5, True)[:, 0]
    corners = tuple(PlaceInImage(column_px=float(column), row_px=float(row)) for column, row in rim)
    rows, columns = np.nonzero(part)
    row_px, column_px, radius_px = rows.mean(), columns.mean(), np.sqrt(part.sum() / np.pi)
    y, x = np.indices(part.shape)
    disc = np.hypot(y - row_px, x - column_px) < radius_px
    if (disc & part).sum() < _ROUND_SHARE * (disc | part).sum():
        return None, corners
    return ContactCircle(row_px=float(row_px), column_px=float(column_px), radius_px=float(radius_px)), corners


#: Pixels this far from the contact, in half-widths, give the smooth surface that stands for no contact.
_FAR_HALF_WIDTHS = 1.6
_SURFACE_DEGREE = 3


def with_far_surface(capture: TactileCapture) -> TactileCapture:
    """Return the capture with a smooth surface through its far pixels in the place of a no-contact image.

    Raises
    ------
    CompareError
        The place of its contact is not known, or too little of the picture is far from it.
    """
    distance = contact_distance(capture)
    if distance is None:
        raise CompareError("the place of the contact is unknown, so the pixels far from it are unknown as well")
    rows, columns = distance.shape
    y, x = np.mgrid[:rows, :columns] / max(rows, columns) - 0.5
    powers = [(i, j) for i in range(_SURFACE_DEGREE + 1) for j in range(_SURFACE_DEGREE + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    values = np.log(np.maximum(capture.contact.astype(np.float64), 0.5))
    far = (distance > _FAR_HALF_WIDTHS) & (capture.contact < 2**capture.bit_depth - 1).all(axis=-1)
    if far.mean() < 0.1:
        raise CompareError("less than a tenth of the picture is far from the contact; give an image without contact")
    surface = np.exp(terms @ np.linalg.lstsq(terms[far], values[far], rcond=None)[0])
    limited = np.clip(np.rint(surface), 0.0, 2**capture.bit_depth - 1).astype(np.uint16)
    return capture.model_copy(update={"no_contact": limited, "no_contact_from": "pixels far from the contact"})


def _log_change(contact: Floats, no_contact: Floats, sigma_px: float) -> Image:
    """Return ln(contact / no contact), smoothed, less the plane of most pixels per channel."""
    floor = 1.0 / 255.0 * max(float(no_contact.max()), 1e-12)
    smooth = [cv2.GaussianBlur(image, (0, 0), sigma_px) + floor for image in (contact, no_contact)]
    return _less_plane(np.log(smooth[0] / smooth[1]))


def _less_plane(change: Floats) -> Image:
    """Return a change less the plane of most pixels per channel."""
    rows, columns = change.shape[:2]
    down, along = np.mgrid[:rows, :columns] / max(rows, columns)
    plane = np.stack([np.ones((rows, columns)), along, down], axis=-1)
    terms = plane.reshape(-1, 3)[::7]
    found = np.empty(change.shape, np.float32)
    for c in range(change.shape[2]):
        values = change[..., c].ravel()[::7]
        kept = np.ones(len(values), bool)
        for _ in range(8):
            solution = np.linalg.lstsq(terms[kept], values[kept], rcond=None)[0]
            left = np.abs(values - terms @ solution)
            kept = left < 2.0 * 1.4826 * np.median(left) + 1e-3
        found[..., c] = change[..., c] - plane @ solution
    return found


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a filter answered most."""

    response_rel: float
    column_px: float
    row_px: float
    radius_px: float


def _coarse(signal: Image, smallest_px: float, largest_px: float, is_even: bool) -> _Place:
    """Return the strongest answer of discs of all sizes in a coarse picture."""
    rows, columns = signal.shape[:2]
    small = cv2.resize(signal, (columns // _COARSE_PX, rows // _COARSE_PX), interpolation=cv2.INTER_AREA)
    if is_even:  # what all channels share: coloured lights answer a bulge with one channel against the other
        small = np.repeat(small.mean(axis=-1, keepdims=True), small.shape[-1], axis=-1)
    best = _Place(-1.0, 0.0, 0.0, 0.0)
    # the odd signal reaches beyond the contact, to about 1.7 radii
    reach = 1.0 if is_even else 1.7
    for radius in np.geomspace(reach * smallest_px, reach * largest_px, _SCALES):
        answers = [
            cv2.filter2D(small, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE) ** 2
            for kernel in _kernels(radius / _COARSE_PX, is_even)
        ]
        energy = np.sum(answers, axis=0).sum(axis=-1)
        row, column = np.unravel_index(int(energy.argmax()), energy.shape)
        if energy[row, column] > best.response_rel:
            column_px, row_px = ((float(at) + 0.5) * _COARSE_PX - 0.5 for at in (column, row))
            best = _Place(float(energy[row, column]), column_px, row_px, float(radius))
    return best


def _kernels(radius: float, is_even: bool) -> list[Image]:
    """Return filters of unit norm: a disc (times x, times y) against its surround."""
    half = int(np.ceil(_SURROUND * radius)) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    away = np.hypot(x, y)
    disc, ring = away <= radius, (away > radius) & (away <= _SURROUND * radius)
    found = []
    for weight in (np.ones_like(x),) if is_even else (x, y):
        parts = [np.where(where, weight, 0.0) for where in (disc, ring)]
        norms = [float(np.abs(p).sum()) if is_even else float(np.sqrt((p**2).sum())) for p in parts]
        kernel = parts[0] / max(norms[0], 1e-12) - parts[1] / max(norms[1], 1e-12)
        found.append((kernel / np.sqrt((kernel**2).sum())).astype(np.float32))
    return found


def _even_circle(signal: Image, coarse: _Place) -> FoundCircle:
    """Return the circle where the mean signal over rings, of one sign inside, changes its sign."""
    rows, columns = np.indices(signal.shape[:2])
    away = np.hypot(columns - coarse.column_px, rows - coarse.row_px)
    ring = (away / 2.0).astype(np.intp)
    count = np.maximum(np.bincount(ring.ravel()), 1)
    profile = np.bincount(ring.ravel(), weights=signal.mean(axis=-1).ravel()) / count
    sign = np.sign(profile[: max(int(coarse.radius_px / 4.0), 1)].mean())
    crossed = np.flatnonzero(sign * profile <= 0.0)
    beyond = crossed[crossed * 2.0 > 0.5 * coarse.radius_px]
    radius_px = 2.0 * float(beyond[0]) if beyond.size else coarse.radius_px
    circle = ContactCircle(row_px=coarse.row_px, column_px=coarse.column_px, radius_px=radius_px)
    return FoundCircle(circle, True)


def _odd_circle(signal: Image, coarse: _Place, smallest_px: float, largest_px: float) -> FoundCircle:
    """Return the circle within which the gel is curved, for the coarse centre alone is that of its halo."""
    energies = _curvature(signal)
    total = np.sqrt((energies**2).sum(axis=-1))
    rim = _Rim(total)
    rows, columns = signal.shape[:2]
    reach = max(3, int(_REACH_REL * max(smallest_px, coarse.radius_px / 3.4)) // 3 * 3)
    shifts = range(-reach, reach + 1, 3)
    radii = np.arange(smallest_px, largest_px + 0.1, 2.0)
    starts = [(coarse.column_px + i, coarse.row_px + j, float(r)) for i in shifts for j in shifts for r in radii]
    inside = [start for start in starts if 0.0 <= start[0] < columns and 0.0 <= start[1] < rows]
    x, y, r = max(inside or starts, key=rim.score)
    for step in _STEPS_PX:
        x, y, r = rim.best_near((x, y, r), step, largest_px)
    return FoundCircle(ContactCircle(row_px=y, column_px=x, radius_px=r), False)


def _curvature(signal: Image, width_px: float = 1.0) -> Image:
    """Return how strongly each channel changes over few widths; dirt that both images share is not in the signal."""
    high = np.abs(signal - cv2.GaussianBlur(signal, (0, 0), 4.0 * width_px))
    high = np.minimum(high, np.percentile(high, 98.0, axis=(0, 1)))
    return np.asarray(cv2.GaussianBlur(high, (0, 0), width_px), dtype=np.float32)


class _Rim:
    """Judge circles by how much more the gel is curved just inside than just outside."""

    def __init__(self, energy: NDArray[np.floating]) -> None:
        self._energy = np.ascontiguousarray(energy, dtype=np.float32)
        self._half_typical = 0.5 * float(np.median(energy)) + 1e-9
        turn = np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)
        self._x, self._y = (np.outer(np.concatenate([_INSIDE, _OUTSIDE]), f(turn)) for f in (np.cos, np.sin))

    def best_near(
        self, circle: tuple[float, float, float], step_px: float, largest_px: float
    ) -> tuple[float, float, float]:
        """Return the best of the circles one step away in any of column, row and radius."""
        x, y, r = circle
        near = [
            (x + i * step_px, y + j * step_px, min(r + k * step_px, largest_px))
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            for k in (-1, 0, 1)
        ]
        return max(near, key=self.score)

    def score(self, circle: tuple[float, float, float]) -> float:
        """Return the mean over rays of the bounded step at the rim, -1 to 1."""
        column, row, radius = circle
        values = cv2.remap(
            self._energy,
            (column + radius * self._x).astype(np.float32),
            (row + radius * self._y).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        half = len(_INSIDE)
        return float(np.tanh((values[:half].mean(axis=0) - values[half:].mean(axis=0)) / self._half_typical).mean())
