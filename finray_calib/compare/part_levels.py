"""Mean levels of 3 x 3 parts of a region, simulated and captured, in both images."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.exposure import ExposureFit
from finray_calib.compare.input_draws import Drawn
from finray_calib.compare.region_sums import Captured
from finray_calib.compare.render_layers import RenderLayers

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
PARTS_A_SIDE = 3
_LEAST_PIXELS = 10
_LEAST_LEVEL = 1e-9


@dataclass(frozen=True, slots=True)
class PartLevels:
    """Hold mean levels of the parts of a region; images are no contact, contact.

    Attributes
    ----------
    places : tuple of (int, int)
        Row and column of each part.
    pixels : ndarray of int, shape (parts,)
    no_contact_layers : ndarray, shape (parts, L)
    contact_layers : ndarray, shape (parts, L (1 + poses))
    captured : ndarray, shape (2, 3, parts)
    noise_variance : ndarray, shape (2, 3, parts)
        Of ln(simulated / captured), from render and camera.
    render_variance : ndarray, shape (2, 3, parts)
        The render's part of it.
    """

    places: tuple[tuple[int, int], ...]
    pixels: NDArray[np.int64]
    no_contact_layers: Floats
    contact_layers: Floats
    captured: Floats
    noise_variance: Floats
    render_variance: Floats

    def simulated(self, drawn: Drawn, exposure: Floats) -> Floats:
        """Return the render's levels (draws, 2, 3, parts)."""
        levels = [drawn.matrix @ self.no_contact_layers.T, drawn.weights @ self.contact_layers.T]
        return np.asarray(exposure[:, None, None, None] * np.stack(levels, axis=1))

    def log_ratio(self, drawn: Drawn, exposure: ExposureFit | None) -> Floats:
        """Return ln(simulated / captured) of the draws, (draws, 2, 3, parts)."""
        k = np.ones(len(drawn.log_drift)) if exposure is None else exposure(drawn.matrix)
        ratio = np.log(np.maximum(self.simulated(drawn, k) / self.captured, _LEAST_LEVEL))
        ratio[:, 1] -= drawn.log_drift[:, None, None]
        return ratio


def part_levels(layers: RenderLayers, captured: Captured, used: Bools, pose_names: tuple[str, ...]) -> PartLevels:
    """Form the levels of all parts that hold enough pixels and light.

    Raises
    ------
    CompareError
        There is none.
    """
    places, masks = [], []
    for row, column, where in _parts(used):
        if (captured.contact[where].mean(axis=0) > 0.0).all() and (captured.no_contact[where].mean(axis=0) > 0.0).all():
            places.append((row, column))
            masks.append(where)
    if not masks:
        raise CompareError(
            f"no part of the region ({PARTS_A_SIDE} x {PARTS_A_SIDE}) holds at least {_LEAST_PIXELS} pixels with light "
            "captured in every channel: take a larger image, or "
            "capture with more light"
        )
    pixels = np.array([int(m.sum()) for m in masks])
    halves = [
        [layers.halves(state, m, names) for m in masks]
        for state, names in (("no_contact", ()), ("contact", pose_names))
    ]
    means = [np.array([(a + b).mean(axis=0) / 2.0 for a, b in state]) for state in halves]
    images = (captured.no_contact, captured.contact)
    levels = np.array([[image[m].mean(axis=0) for m in masks] for image in images])
    of_camera = np.array([[captured.variance(image)[m].mean(axis=0) for m in masks] for image in images])
    of_render = np.array(
        [[v[m].mean(axis=0) for m in masks] for v in (layers.no_contact_variance, layers.contact_variance)]
    )
    best = np.array([mean[:, : layers.matrix.shape[1]] @ layers.matrix.T for mean in means])
    render = of_render / np.maximum(best, _LEAST_LEVEL) ** 2 / pixels[:, None]
    camera = of_camera / levels**2 / pixels[:, None]
    return PartLevels(
        places=tuple(places),
        pixels=pixels,
        no_contact_layers=means[0],
        contact_layers=means[1],
        captured=np.moveaxis(levels, 1, 2),
        noise_variance=np.moveaxis(render + camera, 1, 2),
        render_variance=np.moveaxis(render, 1, 2),
    )


def _parts(used: Bools) -> list[tuple[int, int, Bools]]:
    """Return row, column and pixels of each part of the region's bounding box that holds enough pixels."""
    rows, columns = np.nonzero(used)
    row_of, column_of = _third(rows), _third(columns)
    found = []
    for row in range(PARTS_A_SIDE):
        for column in range(PARTS_A_SIDE):
            inside = (row_of == row) & (column_of == column)
            if inside.sum() >= _LEAST_PIXELS:
                where = np.zeros_like(used)
                where[rows[inside], columns[inside]] = True
                found.append((row, column, where))
    return found


def _third(place: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return which third of their range places lie in."""
    first, span = place.min(), int(np.ptp(place)) + 1
    return np.asarray((place - first) * PARTS_A_SIDE // span)
