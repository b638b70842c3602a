"""One image per chain of fluorescence, from which every paint, camera and white balance follows by arithmetic.

The light of a chain such as "led>green>red" is proportional to each conversion on its way (LED to green emission at
the green wall, green to red emission at the red wall) and lies in the band of its end. So an image with other
conversions, emission shapes, camera or white balance is one matrix product away; no path is traced again.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.optics.paint_bands import BAND_NAMES, SpectralBand

Floats = NDArray[np.float64]

LARGEST_REFLECTANCE_CHANGE = 0.01
"""Absolute change of a paint's reflectance in a band from which on its chains must be rendered again."""

LARGEST_CENTROID_SHIFT_NM = 10.0
"""Shift of a band from which on its images must be rendered again: the coating changes by 0.4 % per reflection."""

LARGEST_REEMISSION_GAIN = 3.0
"""Growth of a chain, relative to the first of its band, up to which one left out at 0.5 % stays below 1.5 %."""

NEGLIGIBLE_CONVERSION = 1e-3
"""Of a paint's conversion of LED light: less, before and after, is no light that was left out."""

# a product of more multiplications is spread over threads, whose start costs up to 100 ms where cores are shared
_MULTIPLICATIONS_PER_PRODUCT = 200_000


def steps(chain: str) -> tuple[tuple[str, str], ...]:
    """Return the conversions (band in, wall) of a chain: "led>green>red" has ("led", "green"), ("green", "red")."""
    bands = chain.split(">")
    if bands[0] != "led" or not set(bands) <= set(BAND_NAMES) or "led" in bands[1:]:
        raise SimulateError(
            f"'{chain}' is no chain of fluorescence: it starts with 'led' and goes on with 'red' and 'green', joined "
            "by '>'"
        )
    return tuple(pairwise(bands))


def conversion_gains(before: Mapping[str, Floats], after: Mapping[str, Floats]) -> dict[tuple[str, str], float]:
    """Return by how much each conversion (band in, wall) has grown.

    Parameters
    ----------
    before, after
        Per wall, energy conversion from each of the bands into the wall's own, (3,).

    Raises
    ------
    SimulateError
        When light appears where none was rendered.
    """
    gains = {}
    for wall, old in before.items():
        for k, band in enumerate(BAND_NAMES):
            led = BAND_NAMES.index("led")
            largest = NEGLIGIBLE_CONVERSION * max(old[led], after[wall][led])
            if max(old[k], after[wall][k]) <= largest:
                gains[band, wall] = 1.0 if old[k] else 0.0
                continue
            if old[k] == 0.0 and after[wall][k] > 0.0:
                raise SimulateError(
                    f"the {wall} paint converts light of the {band} band now and did not when the images were "
                    "rendered: render again"
                )
            gains[band, wall] = float(after[wall][k] / old[k]) if old[k] else 0.0
    return gains


def require_same_reflectance(before: Mapping[str, Floats], after: Mapping[str, Floats]) -> None:
    """Refuse to reuse images after a change of the walls' reflectance: light is reflected on the way.

    Raises
    ------
    SimulateError
        When a reflectance in a band has changed by more than LARGEST_REFLECTANCE_CHANGE.
    """
    for wall, old in before.items():
        change = np.abs(after[wall] - old)
        if change.max() > LARGEST_REFLECTANCE_CHANGE:
            k = int(np.argmax(change))
            raise SimulateError(
                f"the {wall} paint's reflectance in the {BAND_NAMES[k]} band went from {old[k]:.3f} to "
                f"{after[wall][k]:.3f}; changes up to {LARGEST_REFLECTANCE_CHANGE:g} can be made without a new render: "
                "render again"
            )


def require_near_bands(before: Sequence[SpectralBand], after: Sequence[SpectralBand]) -> None:
    """Refuse to reuse images after a band has moved: the coating's reflectance is that at the band's centroid.

    Raises
    ------
    SimulateError
        When a centroid has moved by more than LARGEST_CENTROID_SHIFT_NM.
    """
    for name, old, new in zip(BAND_NAMES, before, after, strict=True):
        if abs(new.centroid_nm - old.centroid_nm) > LARGEST_CENTROID_SHIFT_NM:
            raise SimulateError(
                f"the {name} band's centroid went from {old.centroid_nm:.1f} to {new.centroid_nm:.1f} nm; shifts up to "
                f"{LARGEST_CENTROID_SHIFT_NM:g} nm can be made without a new render: render again"
            )


def require_small_reemission(chains: Sequence[str], gains: Mapping[tuple[str, str], float]) -> None:
    """Refuse gains that would raise chains which were left out as too weak.

    A chain grows relative to the first of its band by the product of its gains over that chain's gain. Chains of one
    step more than those that were rendered are judged: weaker ones stay weaker.

    Parameters
    ----------
    chains
        Names of the chains that were rendered.
    gains
        Change of each conversion (band in, wall).

    Raises
    ------
    SimulateError
        When a chain that was left out has grown by more than LARGEST_REEMISSION_GAIN.
    """
    walls = [name for name in BAND_NAMES if name != "led"]
    left_out = {f"{chain}>{wall}" for chain in chains if chain != "led" for wall in walls} - set(chains)
    for chain in sorted(left_out):
        first = gains.get(("led", chain.rsplit(">", 1)[-1]), 1.0)
        product = float(np.prod([gains.get(step, 1.0) for step in steps(chain)]))
        if product > LARGEST_REEMISSION_GAIN * first:
            growth = f"{product / first:.1f} times" if first > 0.0 else "beyond all bounds"
            raise SimulateError(
                f"the light of chain {chain}, too weak to be rendered, would grow {growth} beside that of its band; "
                f"up to {LARGEST_REEMISSION_GAIN:g} times can be made without a new render: render again"
            )


def chain_matrix(chains: Sequence[str], gains: Mapping[tuple[str, str], float] | None = None) -> Floats:
    """Return W (3 bands, chain) with band images = W @ chain images.

    Parameters
    ----------
    chains
        Names of the chains.
    gains
        Change of each conversion (band in, wall) since the chains were rendered; 1 where it is not named.
    """
    matrix = np.zeros((len(BAND_NAMES), len(chains)))
    for column, chain in enumerate(chains):
        row = BAND_NAMES.index(chain.rsplit(">", 1)[-1])
        matrix[row, column] = np.prod([(gains or {}).get(step, 1.0) for step in steps(chain)])
    return matrix


def mix(images: NDArray[np.float32], matrix: Floats) -> NDArray[np.float32]:
    """Return matrix @ image for every pixel, in single precision; images must be finite.

    ``mix(chain images, white_balance[:, None] * (camera_matrix @ chain_matrix(...)))`` is the camera's picture.

    Parameters
    ----------
    images
        (rows, columns, n).
    matrix
        (m, n).

    Returns
    -------
    array
        (rows, columns, m).

    Raises
    ------
    SimulateError
        When the matrix does not have one column per image.
    """
    if matrix.ndim != 2 or images.shape[-1:] != matrix.shape[1:]:
        raise SimulateError(f"a matrix of shape {matrix.shape} does not fit images of shape {images.shape}")
    m, n = matrix.shape
    flat, weights = np.ascontiguousarray(images, dtype=np.float32).reshape(-1, n), matrix.T.astype(np.float32)
    mixed = np.empty((len(flat), m), dtype=np.float32)
    # rows of two pixels: the product of such narrow matrices is three times faster when they are twice as wide
    even = len(flat) // 2 * 2
    of_two = np.kron(np.eye(2, dtype=np.float32), weights)
    pairs, mixed_pairs = flat[:even].reshape(-1, 2 * n), mixed[:even].reshape(-1, 2 * m)
    step = max(1, _MULTIPLICATIONS_PER_PRODUCT // of_two.size)
    for first in range(0, len(pairs), step):
        np.matmul(pairs[first : first + step], of_two, out=mixed_pairs[first : first + step])
    mixed[even:] = flat[even:] @ weights
    return mixed.reshape(*images.shape[:-1], m)
