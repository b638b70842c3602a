"""A ColorChecker in perspective before a background, in linear camera values, rendered from spectra."""

import cv2
import numpy as np
from colour import SDS_COLOURCHECKERS

from data_schemas.storage import assumed_camera_response, planck_relative

GRID_NM = np.arange(380.0, 781.0, 2.0)
# Another set of measurements than the one that the patches are matched with: real charts differ too.
CHART = np.array(
    [np.interp(GRID_NM, sd.wavelengths, sd.values) for sd in SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()]
)
PATCH_PX, GAP_PX, MARGIN_PX = 40, 6, 10
HEIGHT_PX = 2 * MARGIN_PX + 4 * PATCH_PX + 3 * GAP_PX
WIDTH_PX = 2 * MARGIN_PX + 6 * PATCH_PX + 5 * GAP_PX
BRIGHTEST_DN = 800.0


def patch_rgb(temperature_k: float = 5000.0) -> tuple[np.ndarray, np.ndarray]:
    """(24, 3) camera values of the patches and (3,) of a perfect white, the brightest patch at 800 DN."""
    response = np.array([curve(GRID_NM) for curve in assumed_camera_response()])
    light = planck_relative(GRID_NM, temperature_k)
    rgb = (CHART * light) @ response.T
    return BRIGHTEST_DN * rgb / rgb.max(), BRIGHTEST_DN * (response @ light) / rgb.max()


def patch_centers() -> np.ndarray:
    """(24, 2) centres (x, y) of the patches on the flat chart."""
    step, first = PATCH_PX + GAP_PX, MARGIN_PX + PATCH_PX / 2 - 0.5
    return np.array([[first + column * step, first + row * step] for row in range(4) for column in range(6)])


def render(
    rng: np.random.Generator,
    width_px: float,
    turned_deg: float,
    tilt_share: float = 0.1,
    background: str = "cloth",
    temperature_k: float = 5000.0,
    size: tuple[int, int] = (512, 640),
) -> tuple[np.ndarray, np.ndarray]:
    """Linear image (H, W, 3) in DN and the true centres (24, 2) of the patches in it.

    `tilt_share` is how much larger one side of the chart appears than its centre.
    """
    rgb, white = patch_rgb(temperature_k)
    chart = np.broadcast_to(0.03 * white, (HEIGHT_PX, WIDTH_PX, 3)).copy()
    for value, (x, y) in zip(rgb, patch_centers(), strict=True):
        top, left = round(y - PATCH_PX / 2 + 0.5), round(x - PATCH_PX / 2 + 0.5)
        chart[top : top + PATCH_PX, left : left + PATCH_PX] = value
    homography = _homography(rng, width_px, turned_deg, tilt_share, size)
    shape = size[::-1]
    levels = {"cloth": np.full(size, 0.04), "table": _table(rng, size), "paper": np.full(size, 0.6)}
    covered = cv2.warpPerspective(np.ones((HEIGHT_PX, WIDTH_PX)), homography, shape)[..., None]
    image = cv2.warpPerspective(chart, homography, shape) + (1 - covered) * levels[background][..., None] * white
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    image *= 1 + 0.01 * rng.standard_normal(image.shape)
    image += 2.0 * rng.standard_normal(image.shape)
    return image, cv2.perspectiveTransform(patch_centers()[None], homography)[0]


def _homography(
    rng: np.random.Generator, width_px: float, turned_deg: float, tilt_share: float, size: tuple[int, int]
) -> np.ndarray:
    angle, direction = np.deg2rad(turned_deg), rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 * np.array([1, HEIGHT_PX / WIDTH_PX])
    seen = corners @ turn
    seen = width_px * seen * (1 + tilt_share * seen @ [np.cos(direction), np.sin(direction)])[:, None]
    seen += np.array([size[1] / 2, size[0] / 2]) + rng.uniform(-20, 20, 2)
    flat = np.array([[0, 0], [WIDTH_PX, 0], [WIDTH_PX, HEIGHT_PX], [0, HEIGHT_PX]]) - 0.5
    return cv2.getPerspectiveTransform(np.float32(flat), np.float32(seen))


def _table(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    grain = cv2.GaussianBlur(rng.standard_normal(size), (0, 0), 12)
    return np.clip(0.2 + 0.06 * grain / grain.std(), 0.02, 1)
