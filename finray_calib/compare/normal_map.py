"""A map from colour to surface normal: what a tactile sensor does when it senses.

It turns the change of colour against the no-contact image, and the place in the picture, into the slope of the gel.
:mod:`finray_calib.compare.normal_map_fit` teaches it with presses of a ball.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
            f"the normal map was fitted to colour images of {columns} x {rows} px, got {size_in_words(image)}: fit a "
            "map to presses of this camera"
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
