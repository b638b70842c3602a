r"""Predict a press by a table that other presses taught: the yardstick that a simulator has to beat.

Around a contact the picture changes by a factor that depends on the distance from its outline (in half-widths), on the
direction of the outline there, and smoothly on the place in the picture:

.. math:: S / B - 1 = \frac{w}{w_0} \sum_{ijk} c_{ijk}\, h_i(d)\, a_j(\varphi)\, m_k(x, y)

with hat functions h of the distance d that break at the rim, a = 1, cos, sin, cos 2, sin 2 of the direction,
m = 1, x, y and the half-width w. It knows neither optics nor mechanics, but it does know the halo, which is taught too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, SimulatedPress, TactileCapture
from finray_calib.compare._tone_curve import far_gain
from finray_calib.sensing import contact_distance, contact_sha256, full_scale_dn, rgb_image

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TABLE_LABEL: Final = "table of other presses, not rendered"
RIDGE_REL: Final = 0.03
"""Penalty on the coefficients; from six real presses 0.003 and 0.03 explain the same, 0.03 is the safer of the two."""
REACH: Final = 2.6
"""What is farther from the contact, in half-widths, teaches nothing and is left as it is."""

_INNER = np.linspace(0.0, 1.0, 7)
_OUTER = np.array([1.0, 1.06, 1.15, 1.3, 1.5, 1.8, 2.2, 2.8])
_TERMS = 5 * 3 * (len(_INNER) + len(_OUTER))
_STRIDE_PX = 4
_PIXELS_AT_ONCE = 20_000


@dataclass(frozen=True, slots=True)
class PressTable:
    """What presses of one sensor taught.

    Attributes
    ----------
    coefficients : ndarray, shape (terms, 3)
    half_width_px : float
        Mean half-width of the contacts that taught.
    shape_px : tuple of int
        Rows and columns of the images.
    taught_by : tuple of str
        Names of the presses.
    taught_by_sha256 : tuple of str
        SHA-256 of their contact images: a press under another name is known by it.
    """

    coefficients: Floats
    half_width_px: float
    shape_px: tuple[int, int]
    taught_by: tuple[str, ...]
    taught_by_sha256: tuple[str, ...]


def teach_table(captures: Sequence[TactileCapture]) -> PressTable:
    """Fit the table to presses of one sensor by ridge regression.

    Parameters
    ----------
    captures
        One or more, each with its contact. The gain of each against its no-contact image is taken from pixels far from
        the contact, where there are enough.

    Raises
    ------
    CompareError
        There is none, one does not tell where its contact is, or images differ in size.
    """
    if not captures:
        raise CompareError("a table needs at least one press that teaches it")
    distances = [_distance(capture) for capture in captures]
    shape = distances[0].shape
    width_px = float(np.mean([_half_width_px(d) for d in distances]))
    normal, right = np.zeros((_TERMS, _TERMS)), np.zeros((_TERMS, 3))
    for capture, distance in zip(captures, distances, strict=True):
        if distance.shape != shape:
            raise CompareError(f"{capture.name}: has another size than {captures[0].name}; teach with one camera")
        contact, no_contact = (rgb_image(counts, capture) for counts in (capture.contact, capture.no_contact))
        gain = far_gain((contact, no_contact), (no_contact, no_contact), distance, full_scale_dn(capture))
        level = no_contact if gain is None else no_contact * np.exp(np.where(gain.to_correct, gain.log_captured, 0.0))
        used = _near(distance) & np.isfinite(contact + level).all(axis=-1) & (level > 0.0).all(axis=-1)
        used[np.arange(shape[0]) % _STRIDE_PX > 0] = False
        used[:, np.arange(shape[1]) % _STRIDE_PX > 0] = False
        terms = _terms(distance, used, width_px)
        target = contact[used] / level[used] - 1.0
        normal += terms.T @ terms
        right += terms.T @ target
    penalty = RIDGE_REL * np.trace(normal) / len(normal) * np.eye(len(normal))
    coefficients = np.linalg.solve(normal + penalty, right)
    names, digests = zip(*((capture.name, contact_sha256(capture)) for capture in captures), strict=True)
    return PressTable(coefficients, width_px, (shape[0], shape[1]), names, digests)


def predict_press(table: PressTable, capture: TactileCapture) -> SimulatedPress:
    """Return what the table makes of the no-contact image of a capture, with the contact where the capture has it.

    Raises
    ------
    CompareError
        The capture does not tell where its contact is, has another size, or taught the table itself.
    """
    if contact_sha256(capture) in table.taught_by_sha256:
        raise CompareError(
            f"{capture.name}: its contact image taught the table ({', '.join(table.taught_by)}), so that what it "
            "predicts of it proves nothing"
        )
    distance = _distance(capture)
    if distance.shape != table.shape_px:
        raise CompareError(f"{capture.name}: has another size than the presses that taught the table")
    full_dn = full_scale_dn(capture)
    no_contact = np.nan_to_num(rgb_image(capture.no_contact, capture), nan=full_dn)
    contact = no_contact.copy()
    near = np.flatnonzero(_near(distance))
    for part in np.array_split(near, max(1, len(near) // _PIXELS_AT_ONCE)):
        where = np.zeros(distance.size, dtype=np.bool_)
        where[part] = True
        where = where.reshape(distance.shape)
        change = _terms(distance, where, table.half_width_px) @ table.coefficients
        contact[where] = np.clip(no_contact[where] * (1.0 + change), 0.0, full_dn)
    return SimulatedPress(
        name=f"{capture.name}, table",
        label=TABLE_LABEL,
        method="table",
        encoding=capture.encoding,
        no_contact=no_contact.astype(np.float32),
        contact=contact.astype(np.float32),
        distance=distance.astype(np.float32),
        variance=None,
        light_angle_deg=None,
        design=None,
        notes=(
            f"taught by {len(table.taught_by)} other presses: {', '.join(table.taught_by)}",
            "the contact is where the capture has it, and the no-contact image is the capture's",
        ),
    )


def spread_over(count: int, chosen: int) -> list[int]:
    """Return which of `count` presses teach, spread evenly from the first to the last."""
    return [int(i) for i in np.unique(np.rint(np.linspace(0, count - 1, chosen)))]


def _distance(capture: TactileCapture) -> Floats:
    """Return the distance from the contact in half-widths."""
    distance = contact_distance(capture)
    if distance is None:
        raise CompareError(
            f"{capture.name}: does not state where its contact is; import it with a circle, an outline or a search"
        )
    return distance


def _near(distance: Floats) -> Bools:
    """Return the pixels that the table changes."""
    return np.asarray(distance < REACH)


def _half_width_px(distance: Floats) -> float:
    """Return the half-width of a contact in pixels, from how steeply the distance rises outside."""
    slopes = np.hypot(*np.gradient(distance))
    outside = (distance > 1.2) & (slopes > 0.0)
    return 1.0 / float(np.median(slopes[outside] if outside.any() else slopes[slopes > 0.0]))


def _terms(distance: Floats, used: Bools, width_px: float) -> Floats:
    """Return the terms (pixels, terms) at some pixels."""
    smooth = cv2.GaussianBlur(distance, (0, 0), 2.0)
    down, along = np.gradient(smooth)
    steep = np.hypot(down, along)[used]
    cosine, sine = (np.divide(g[used], steep, out=np.zeros_like(steep), where=steep > 0.0) for g in (along, down))
    angular = np.stack([np.ones_like(cosine), cosine, sine, cosine**2 - sine**2, 2.0 * cosine * sine], axis=-1)
    d = distance[used]
    inner = [np.interp(d, _INNER, row) * (d <= 1.0) for row in np.eye(len(_INNER))]
    outer = [np.interp(d, _OUTER, row, right=0.0) * (d > 1.0) for row in np.eye(len(_OUTER))]
    radial = np.stack([*inner, *outer], axis=-1) * (_half_width_px(distance) / width_px)
    rows, columns = np.nonzero(used)
    size = max(used.shape)
    place = np.stack([np.ones_like(d), columns / size - 0.5, rows / size - 0.5], axis=-1)
    return np.asarray(np.einsum("pi,pj,pk->pijk", radial, angular, place).reshape(len(d), -1))
