"""Which point of the coated face each pixel sees, in closed form: an oracle of the pixel maps, without a renderer.

The pixel's ray is followed through pinhole, convex mirror, refraction at the flat inner face, to the coated face.
"""

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign
from sim.optics._optical_layout import camera_pose, panel_frame, pixel_directions
from sim.surface_meshes import MirrorShape, mirror_shape, pressed_height_mm

_BISECTIONS = 48


def coat_positions(design: FingerDesign) -> NDArray[np.float64]:
    """Return where on the coated face each pixel looks.

    Returns
    -------
    array
        (z, x) in mm, shape (rows, columns, 2); NaN where the pixel does not see the coated face directly through
        mirror and inner face (walls, ends, box, or the light panel in front).
    """
    pose, mirror, pad = camera_pose(design), mirror_shape(design), design.pad
    with np.errstate(invalid="ignore", divide="ignore"):
        on_mirror, reflected = _reflect(pose.centre_mm, pixel_directions(pose), mirror)
        to_face = -on_mirror[..., 1] / reflected[..., 1]
        entry = on_mirror + to_face[..., None] * reflected
        seen = (reflected[..., 1] > 0.0) & (to_face > 0.0) & (np.abs(entry[..., 0]) < pad.width_mm / 2.0)
        seen &= (entry[..., 2] > 0.0) & (entry[..., 2] < pad.length_mm)
        seen &= ~_panel_blocks(design, np.broadcast_to(pose.centre_mm, entry.shape), on_mirror)
        seen &= ~_panel_blocks(design, on_mirror, entry)
        on_coat = _meet_coat(design, entry, _refract(reflected, pad.index_at(design.light.peak_wavelength_nm)))
        seen &= (np.abs(on_coat[..., 0]) < pad.width_mm / 2.0) & (on_coat[..., 2] > 0.0)
        seen &= on_coat[..., 2] < pad.length_mm
    return np.where(seen[..., None], on_coat[..., [2, 0]], np.nan)


def _reflect(
    origin: NDArray[np.float64], rays: NDArray[np.float64], mirror: MirrorShape
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where rays meet the mirror's front and their directions after it; NaN without a meeting."""
    start = origin[1:] - mirror.apex_yz_mm
    s0, h0 = start @ mirror.tangent_yz, start @ mirror.normal_yz
    ds, dh = rays[..., 1:] @ mirror.tangent_yz, rays[..., 1:] @ mirror.normal_yz
    # (h0 + t dh) + (s0 + t ds)^2 / (2 R) = 0 in the form that is stable for a flat mirror
    a, b, c = ds**2 / (2.0 * mirror.radius_mm), dh + s0 * ds / mirror.radius_mm, h0 + s0**2 / (2.0 * mirror.radius_mm)
    distance = 2.0 * c / (-b + np.sqrt(b**2 - 4.0 * a * c))
    s = s0 + distance * ds
    meets = origin + distance[..., None] * rays
    ok = (distance > 0.0) & (np.abs(s) < mirror.half_length_mm) & (np.abs(meets[..., 0]) < mirror.half_width_mm)
    normal_yz = mirror.normal_yz + (s / mirror.radius_mm)[..., None] * mirror.tangent_yz
    normal = np.concatenate([np.zeros((*s.shape, 1)), normal_yz], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    reflected = rays - 2.0 * np.sum(rays * normal, axis=-1, keepdims=True) * normal
    return np.where(ok[..., None], meets, np.nan), reflected


def _refract(rays: NDArray[np.float64], index: float) -> NDArray[np.float64]:
    """Refract rays with y > 0 into the gel at the plane y = 0."""
    refracted = rays / index
    refracted[..., 1] = np.sqrt(1.0 - refracted[..., 0] ** 2 - refracted[..., 2] ** 2)
    return refracted


def _meet_coat(design: FingerDesign, entry: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bisect for the point where rays from the inner face meet the coated face."""
    highest = design.pad.thickness_mm * 1.5
    near, far = np.zeros(entry.shape[:-1]), highest / rays[..., 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (near + far)
        below = middle * rays[..., 1] < _flat_pad_height_mm(design, entry[..., 2] + middle * rays[..., 2])
        near, far = np.where(below, middle, near), np.where(below, far, middle)
    return np.asarray(entry + (0.5 * (near + far))[..., None] * rays)


def _flat_pad_height_mm(design: FingerDesign, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the coat of a flat pad, which is the same all across."""
    return np.asarray(pressed_height_mm(design, np.zeros(1), z_mm.ravel())[0].reshape(z_mm.shape))


def _panel_blocks(design: FingerDesign, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell whether the light panel stands between two points."""
    frame = panel_frame(design.light)
    before, after = (start - frame.centre_mm) @ frame.normal, (end - frame.centre_mm) @ frame.normal
    share = before / (before - after)
    point = start + share[..., None] * (end - start) - frame.centre_mm
    inside = np.ones(share.shape, dtype=np.bool_)
    for edge in (frame.half_across_mm, frame.half_along_mm):
        inside &= np.abs(point @ edge) < edge @ edge
    return inside & (share > 0.0) & (share < 1.0)
