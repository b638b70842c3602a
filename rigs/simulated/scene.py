"""Where things lie on the simulated bench: sample, black cloth, ColorChecker, and how the lights fall on them.

All maps have one value per 2 x 2 Bayer cell; positions are fractions of the frame's height from its centre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_schemas.capture import LightState

Floats = NDArray[np.float64]
SAMPLE_SIDE_REL = 0.36
CLOTH_REFLECTANCE = 0.04
LAMP_GRADIENT_REL = (0.06, 0.10)
SPOT_CENTER_REL = (0.015, -0.025)
SPOT_SD_REL = 0.14
TEXTURE_REL = 0.015
TEXTURE_LENGTH_CELLS = 1.5
BOARD_LEFT_REL, BOARD_RIGHT_REL = 0.20, 0.60
BOARD_HEIGHT_REL = 0.27
PATCH_FILL = 0.82


@dataclass(frozen=True, slots=True)
class Scene:
    """Maps of the bench, each of shape (h, w).

    Attributes
    ----------
    lamp, laser, room
        Irradiance relative to its level at the centre of the frame (laser: of the spot).
    texture
        Relative radiance of the sample or white tile (mean 1), by target.
    sample
        True where the sample or white tile lies.
    patch
        Number of the ColorChecker patch (1 to 24), 0 on its dark board, -1 elsewhere.
    """

    lamp: Floats
    laser: Floats
    room: Floats
    texture: dict[str, Floats]
    sample: NDArray[np.bool_]
    patch: NDArray[np.int64]

    def irradiance(self, light: LightState) -> Floats:
        """Return the relative irradiance of a light that shines, shape (h, w)."""
        return {"lamp": self.lamp, "laser": self.laser, "room": self.room}[light]


def lay_out(height: int, width: int, seed: int) -> Scene:
    """Lay out the bench for a frame of `height` x `width` Bayer cells; `seed` fixes the textures."""
    y = ((np.arange(height) - 0.5 * (height - 1)) / height)[:, None]
    x = ((np.arange(width) - 0.5 * (width - 1)) / height)[None, :]
    spot_distance2 = (y - SPOT_CENTER_REL[0]) ** 2 + (x - SPOT_CENTER_REL[1]) ** 2
    rng = np.random.default_rng([seed, 3])
    return Scene(
        lamp=1.0 + LAMP_GRADIENT_REL[0] * y + LAMP_GRADIENT_REL[1] * x,
        laser=np.exp(-0.5 * spot_distance2 / SPOT_SD_REL**2),
        room=np.ones((height, width)),
        texture={name: _texture((height, width), rng) for name in ("white", "sample")},
        sample=(np.abs(y) < 0.5 * SAMPLE_SIDE_REL) & (np.abs(x) < 0.5 * SAMPLE_SIDE_REL),
        patch=_colour_checker(y, x),
    )


def _texture(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """Return a smooth random map with mean 1 and a standard deviation of 1.5 %."""
    smooth: Floats = gaussian_filter(rng.standard_normal(shape), TEXTURE_LENGTH_CELLS, mode="wrap")
    return np.asarray(1.0 + TEXTURE_REL * (smooth - smooth.mean()) / smooth.std())


def _colour_checker(y: Floats, x: Floats) -> NDArray[np.int64]:
    """Return the patch number of each cell: a board of 4 rows x 6 columns to the right of the sample."""
    column = (x - BOARD_LEFT_REL) / (BOARD_RIGHT_REL - BOARD_LEFT_REL) * 6.0
    row = (y / BOARD_HEIGHT_REL + 0.5) * 4.0
    board = (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    edge = 0.5 * (1.0 - PATCH_FILL)
    inside = (np.abs(column % 1 - 0.5) < 0.5 - edge) & (np.abs(row % 1 - 0.5) < 0.5 - edge)
    number = 1 + 6 * np.floor(row) + np.floor(column)
    return np.where(board, np.where(inside, number, 0), -1).astype(np.int64)


def colour_checker_reflectances(wavelength_nm: Floats) -> Floats:
    """Return the spectral reflectance of the 24 patches, shape (24, L); end values are held outside 380-780 nm.

    Source: Ohta's measurements, "ColorChecker N Ohta" of colour-science.
    """
    import colour  # takes seconds to import and only the room-light frame needs it

    patches = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    return np.array([np.interp(wavelength_nm, sd.wavelengths, sd.values) for sd in patches])
