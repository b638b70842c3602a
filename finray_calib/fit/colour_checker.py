"""Non-fluorescent reflectance the paper's way: the ColorChecker patch that looks most like the paint in room light.

The 24 patches in the room-light frame give a matrix from camera RGB to XYZ; the paint's XYZ is compared with that of
every patch by CIEDE2000, and the reflectance curve of the closest patch stands in for the paint's.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame
from data_schemas.colour_checker import ColourCheckerMatch, PatchDistance
from data_schemas.curves import SpectralCurve
from data_schemas.errors import FitError, RadiometryError
from data_schemas.estimate import Estimate
from data_schemas.radiometry import Optics
from finray_calib.fit.colour_match import PATCH_SET, match_colour, match_uncertainty_rel, patch_colours, reflectance_sd
from finray_calib.radiometry.find_colour_checker import (
    LARGEST_CLIPPED_FRACTION,
    ColourCheckerPatches,
    find_colour_checker,
    linear_cells,
)
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, transmissions

Floats = NDArray[np.float64]
ReadFrame = Callable[[Frame], NDArray[np.uint16]]
_NORMAL_68, _NORMAL_95 = 0.994458, 1.959964


def colour_checker_reflectance(session: CaptureSession, read: ReadFrame, optics: Optics) -> ColourCheckerMatch:
    """Return the paint's reflectance after the closest ColorChecker patch in the session's room-light frames.

    The longest exposure in which neither a patch nor the paint is clipped is used.

    Parameters
    ----------
    session
        Paint session with room-light frames (sample beside a ColorChecker).
    read
        Reads a frame of the session.
    optics
        Filters at which the reflectance is wanted.

    Raises
    ------
    FitError
        The session has no room-light frame, or every one of them is clipped or without a readable chart.
    """
    frames = [f for f in session.frames if f.frame_type == "room light"]
    if not frames:
        raise FitError(
            "session.frames: no 'room light' frame; capture the sample beside a ColorChecker in room light, or use the "
            "reflectance measured under the lamp"
        )
    faults = []
    for frame in sorted(frames, key=lambda f: -f.exposure_s):
        cells = linear_cells(read(frame), _dark(session, frame, read), 2**session.rig.camera.bit_depth - 1)
        try:
            paint_dn = _paint_mean(cells, session)
            patches = find_colour_checker(cells, patch_colours().xyz)
        except RadiometryError as error:
            faults.append(f"{frame.file}: {error}")
            continue
        return _record(patches, paint_dn, frame, transmissions(optics))
    raise FitError("no room-light frame can be used; " + "; ".join(faults))


def _dark(session: CaptureSession, frame: Frame, read: ReadFrame) -> Floats | float:
    """Return the mean dark frame of the same exposure (DN), or the camera's black level if there is none."""
    darks = [f for f in session.frames if f.frame_type == "dark"]
    same = [read(f).astype(np.float64) for f in darks if f.exposure_requested_s == frame.exposure_requested_s]
    return np.mean(same, axis=0) if same else session.rig.camera.black_level_dn


def _paint_mean(cells: Floats, session: CaptureSession) -> Floats:
    """Return the mean over the painted region (3,), refusing a clipped one."""
    region = session.plan.region
    rows = slice(region.row_px // 2, (region.row_px + region.height_px) // 2)
    columns = slice(region.column_px // 2, (region.column_px + region.width_px) // 2)
    paint = cells[rows, columns].reshape(-1, 3)
    clipped = float(np.isnan(paint).any(axis=1).mean()) if len(paint) else 1.0
    if clipped > LARGEST_CLIPPED_FRACTION:
        raise RadiometryError(
            f"the painted region is clipped in {clipped:.1%} of its cells (at most {LARGEST_CLIPPED_FRACTION:.1%} is "
            "allowed); use a shorter exposure"
        )
    return np.asarray(np.nanmean(paint, axis=0))


def _record(patches: ColourCheckerPatches, paint_dn: Floats, frame: Frame, passed: Floats) -> ColourCheckerMatch:
    """Match and put into words."""
    reference = patch_colours()
    match = match_colour(patches.mean_dn, paint_dn)
    uncertainty_rel, sd = match_uncertainty_rel(match), reflectance_sd(match)
    order = np.argsort(match.paint_delta_e)
    ranked = [PatchDistance(patch=reference.names[n], delta_e=match.paint_delta_e[n]) for n in order]
    closest, runner_up = ranked[:2]
    curve = SpectralCurve(
        name=f"ColorChecker {closest.patch}",
        wavelength_nm=WAVELENGTH_NM,
        values=reference.reflectance[order[0]],
        uncertainty_rel=uncertainty_rel,
        source=f"colour-science, {PATCH_SET}",
    )
    return ColourCheckerMatch(
        patches=tuple(ranked),
        reflectance=curve,
        reflectance_sd=sd,
        at_filters=tuple(_at_filter(curve, one, sd) for one in passed),
        camera_median_delta_e=float(np.median(match.camera_delta_e)),
        camera_largest_delta_e=float(match.camera_delta_e.max()),
        patch_mean_dn=patches.mean_dn,
        patch_sd_dn=patches.sd_dn,
        paint_mean_dn=paint_dn,
        corners_px=2.0 * patches.corners_px + 0.5,  # centre of a 2 x 2 cell in raw pixels
        frame_file=frame.file,
        statement=(
            f"reflectance of ColorChecker patch '{closest.patch}', the closest to the paint in room light (CIEDE2000 "
            f"{closest.delta_e:.1f}; next '{runner_up.patch}' {runner_up.delta_e:.1f}; the camera predicts the patches "
            f"themselves within {np.median(match.camera_delta_e):.1f}): a stand-in with {uncertainty_rel:.0%} relative "
            f"standard uncertainty (+- {sd:.2f} at every wavelength); light that the paint re-emits is part of its "
            "colour"
        ),
    )


def _at_filter(curve: SpectralCurve, passed: Floats, sd: float) -> Estimate:
    """Return the curve averaged over a filter's transmission (L,), with its uncertainty; ends are cut at 0 and 1."""
    value = float((passed * curve(WAVELENGTH_NM)).sum() / passed.sum())
    low68, high68, low95, high95 = (
        float(np.clip(value + z * sd, 0.0, 1.0)) for z in (-_NORMAL_68, _NORMAL_68, -_NORMAL_95, _NORMAL_95)
    )
    return Estimate(estimate=value, sd=sd, low68=low68, high68=high68, low95=low95, high95=high95)
