"""Ball presses all over the pad of a painted finger, rendered and brought into the plane of its pad."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import map_coordinates

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.experiments.painted_finger import PaintedFinger
from sim.experiments.press import camera_rgb
from sim.experiments.taxim_calibration import BallPresses, planned_presses, surface_of
from sim.optics.pixel_maps import PixelMaps
from sim.optics.render import Progress, render_press
from sim.surface_meshes.pressed_pad import contact_distance, contact_half_width_mm

Floats = NDArray[np.float64]

# a pad that fewer pixels see is no picture
_FEWEST_PIXELS = 100


def render_finger_presses(
    finger: PaintedFinger,
    ball_radius_mm: float,
    count: int,
    seed: int = 0,
    samples_per_pixel: int = 64,
    progress: Progress | None = None,
) -> BallPresses:
    """Render ball presses on a finger; pictures are rectified by what each pixel sees of the pad at rest.

    Columns run along the pad from its base, rows across it from the red wall to the green one; a pixel's side is the
    square root of the area of pad that a pixel of the camera sees in the mean. Parts of the pad that the camera does
    not see are black, and teach nothing. Colours are balanced so that the pad is grey without contact in the mean.

    Parameters
    ----------
    finger
        Design, paints, camera and renderer; the design's own indenter does not matter.
    ball_radius_mm, count
        As in :func:`sim.experiments.taxim_calibration.planned_presses`, with its refusals.
    seed, samples_per_pixel
        Random seed, the same for all presses; paths per pixel.
    progress
        Called after each press.

    Raises
    ------
    SimulateError
        See above, as :func:`sim.optics.render.render_press` does, or when the camera hardly sees the pad.
    """
    pictures, no_contact, slopes, distances = [], np.empty(0), [], []
    designs = planned_presses(finger.design, ball_radius_mm, count)
    plane: _PadPlane | None = None
    for step, design in enumerate(designs, start=1):
        pressed = replace(finger, design=design)
        render = render_press(
            design, finger.paints, finger.renderer, "b", seed, samples_per_pixel, calibration=finger.calibration
        )
        matrix = pressed.camera_matrix(render.bands)
        if plane is None:
            plane = _pad_plane(design, render.no_contact_maps)
            no_contact = plane.rectified(camera_rgb(render.no_contact_bands, matrix))
        pictures.append(plane.rectified(camera_rgb(render.contact_bands, matrix)))
        slope, distance = plane.seen(design, render.contact_maps)
        slopes.append(slope)
        distances.append(distance)
        if progress is not None:
            progress(step, count, f"press {step}")
    if plane is None:
        raise SimulateError(f"count = {count}: at least one press must be rendered")
    scale, pad = plane.mm_per_px, finger.design.pad
    # 8 bits would leave nothing of red and green beside blue
    levels = no_contact[plane.is_seen].mean(axis=0)
    gains = levels.max() / levels
    indenters = [design.indenter for design in designs]
    return BallPresses(
        no_contact=(gains * no_contact).astype(np.float32),
        contacts=(gains * np.stack(pictures)).astype(np.float32),
        slopes=np.stack(slopes),
        distance=np.stack(distances),
        row_px=np.array([(i.across_mm + pad.width_mm / 2.0) / scale - 0.5 for i in indenters]),
        column_px=np.array([i.position_mm / scale - 0.5 for i in indenters]),
        radius_px=np.array([float(contact_half_width_mm(design)) / scale for design in designs]),
        ball_radius_mm=ball_radius_mm,
        thickness_mm=pad.thickness_mm,
        mm_per_px=scale,
        label=f"{finger.design.name}, rendered with {samples_per_pixel} paths per pixel, in the plane of its pad, "
        f"colours times {', '.join(f'{gain:.3g}' for gain in gains)} (grey without contact)",
    )


class _PadPlane:
    """The pad at rest as a grid of square pixels, and where in the camera's picture each of them is seen."""

    def __init__(self, rows: Floats, columns: Floats, mm_per_px: float) -> None:
        self.mm_per_px = mm_per_px
        self.is_seen = np.isfinite(rows)
        self._at = np.stack([np.nan_to_num(rows), np.nan_to_num(columns)])

    def rectified(self, image: NDArray[np.float32]) -> Floats:
        """Return an image (H, W, 3) of the camera in the pad's plane; black where the camera does not see the pad."""
        channels = np.moveaxis(image.astype(np.float64), -1, 0)
        sampled = [map_coordinates(channel, self._at, order=1, mode="nearest") for channel in channels]
        return np.where(self.is_seen[..., None], np.stack(sampled, axis=-1), 0.0)

    def seen(self, design: FingerDesign, maps: PixelMaps) -> tuple[Floats, Floats]:
        """Return slopes (H, W, 2) and contact distance (H, W) of the points of the coat that the pixels see."""
        at = np.rint(self._at).astype(np.int64)
        z, x = np.moveaxis(maps.coat_mm(design)[at[0], at[1]], -1, 0)
        surface = surface_of(design)
        known = np.isfinite(x) & self.is_seen
        x, z = np.where(known, x, 0.0), np.where(known, z, 0.0)
        slopes = np.stack([-surface.ev(x, z, dy=1), -surface.ev(x, z, dx=1)], axis=-1)
        return np.where(known[..., None], slopes, np.nan), np.where(known, contact_distance(design, x, z), np.nan)


def _pad_plane(design: FingerDesign, at_rest: PixelMaps) -> _PadPlane:
    """Return the pad's plane as a camera sees it at rest."""
    place = at_rest.coat_mm(design)
    seen = np.isfinite(place).all(axis=-1)
    if seen.sum() < _FEWEST_PIXELS:
        raise SimulateError(
            f"camera: {int(seen.sum())} pixels see the pad, at least {_FEWEST_PIXELS} are needed; give the camera more "
            "pixels or turn it to the pad"
        )
    pad = design.pad
    side = float(np.sqrt(pad.length_mm * pad.width_mm / seen.sum()))
    shape = (round(pad.width_mm / side), round(pad.length_mm / side))
    rows, columns = np.indices(shape)
    wanted = np.stack([(columns + 0.5) * side, (rows + 0.5) * side - pad.width_mm / 2.0], axis=-1)
    pixel = LinearNDInterpolator(place[seen], np.argwhere(seen).astype(np.float64))(wanted)
    return _PadPlane(pixel[..., 0], pixel[..., 1], side)
