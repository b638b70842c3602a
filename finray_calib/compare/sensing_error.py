"""Simulated against captured press as a sensor senses them: the same normal map applied to both."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.normal_map import Floats, Mask, NormalMap, angles_deg, mean_level
from finray_calib.compare.poisson_depth import poisson_depth_mm


@dataclass(frozen=True, slots=True)
class SensingError:
    """How far what is sensed in a render is from what is sensed in the capture.

    Attributes
    ----------
    normal_angle_mean_deg, normal_angle_p95_deg
        Angle between both normals over the region.
    depth_rms_mm
        Difference of both integrated depths over the region, its median removed.
    outside_share_simulated, outside_share_captured
        Share of the region's pixels whose change of colour no calibration press showed; there the map is held at its
        last value, and above some per cent the other figures say little.
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
            "the region has no pixel that is neither clipped nor missing in render and capture; reduce the exposure or "
            "check the contact's place"
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
