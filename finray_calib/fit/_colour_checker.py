"""Non-fluorescent reflectance the paper's way: the ColorChecker patch that looks most like the paint in room light.

The 24 patches in the room-light frame give a matrix from camera RGB to XYZ; the paint's XYZ is compared with that of
every patch by CIEDE2000, and the reflectance curve of the closest patch stands in for the paint's.

The stand-in is rough, and a fluorescent paint also glows in room light, which shifts its colour. Measured on four
fluorescent materials (relative RMS of the patch's curve from the measured reflectance): 0.14 to 0.36 when the colour
is that of the reflectance alone (root mean square 0.28), up to 0.47 when room light makes the paint glow (0.35). The
stated uncertainty, with its term for an ambiguous match, covers both: root mean square error over uncertainty 0.8 to
1.1 over five lights and three cameras. Being a share of the whole curve, it is carried as one standard uncertainty at
all wavelengths: 30 % of the local value would cover only 59 % of the filters at a nominal 95 %, this one 96 %.

OpenCV's chart detector proposes where the chart lies, at several magnifications; what it proposes is kept only if the
colours of the 24 patches are those of a ColorChecker, either way up. The detector sees a tone-mapped image; the patches
are measured in linear values.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CaptureSession,
    ColourCheckerMatch,
    Estimate,
    FitError,
    Frame,
    Optics,
    PatchDistance,
    RadiometryError,
    SpectralCurve,
    bayer_planes,
)
from finray_calib.spectra import WAVELENGTH_NM, transmissions

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
ReadFrame = Callable[[Frame], NDArray[np.uint16]]
_NORMAL_68, _NORMAL_95 = 0.994458, 1.959964


ROWS, COLUMNS = 4, 6
PATCHES = ROWS * COLUMNS
# Shorter side that the detector works at (px): small charts need magnification, large ones the opposite.
SHORTER_SIDES_PX = (1000, 500, 2000)
DISPLAY_GAMMA = 2.2
WHITE_PERCENTILE = 99.5
# Of the patch that the detector marks, only the middle is measured: its corners are good to a few pixels.
MEASURED_SHARE = 0.6
# Below this a misplaced corner reaches the neighbouring patch: charts of 60 cells' width were read wrong by up to 27 %.
SMALLEST_PATCH_PIXELS = 14
LARGEST_CLIPPED_FRACTION = 1e-3
# Relative residual of a linear map from the patches to the reference colours. Charts in the right place and the right
# way round stay below 0.07 with the cameras and lights tried; turned or shifted by one patch they are above 0.9.
LARGEST_MISMATCH_REL = 0.15
# As good as it gets: no other magnification needs to be tried.
GOOD_MISMATCH_REL = 0.075


@dataclass(frozen=True, slots=True)
class ColourCheckerPatches:
    """Linear values of the 24 patches, from "dark skin" row by row to "black".

    Attributes
    ----------
    mean_dn, sd_dn
        (24, 3) mean and standard deviation over the pixels of a patch.
    pixels
        (24,) Bayer cells measured.
    corners_px
        (4, 2) corners of the chart (column, row) in Bayer cells, first the one beside "dark skin", then clockwise.
    mismatch_rel
        Relative residual of the linear map to the reference colours.
    """

    mean_dn: Floats
    sd_dn: Floats
    pixels: NDArray[np.int64]
    corners_px: Floats
    mismatch_rel: float


def linear_cells(counts: NDArray[np.uint16], dark_dn: Floats | float, full_scale_dn: int) -> Floats:
    """Return one linear RGB value per 2 x 2 cell of an RGGB frame, (H/2, W/2, 3) in DN; clipped cells are NaN.

    Parameters
    ----------
    counts
        (H, W) raw counts (DN).
    dark_dn
        Dark frame (H, W) or one level (DN).
    full_scale_dn
        Largest count (DN).
    """
    return bayer_planes(np.where(counts >= full_scale_dn, np.nan, counts - dark_dn))


def find_colour_checker(linear_rgb: Floats, reference: Floats) -> ColourCheckerPatches:
    """Find a ColorChecker Classic and measure its patches.

    Parameters
    ----------
    linear_rgb
        (H, W, 3) linear camera values (DN), NaN where clipped. The chart may be tilted and turned; its patches need
        about 10 cells a side.
    reference
        (24, 3) linear colours of the patches in any basis (such as XYZ), in the chart's order.

    Returns
    -------
    ColourCheckerPatches

    Raises
    ------
    RadiometryError
        No chart is found, or patches of the chart are clipped.
    """
    best: tuple[ColourCheckerPatches, Floats] | None = None
    for quads in _proposals(linear_rgb):
        for turned in (quads, quads[::-1]):  # the detector may read a chart upside down
            measured = _measure(linear_rgb, turned, reference)
            if measured is not None and (best is None or measured[0].mismatch_rel < best[0].mismatch_rel):
                best = measured
        if best is not None and best[0].mismatch_rel < GOOD_MISMATCH_REL:
            break
    if best is None or best[0].mismatch_rel > LARGEST_MISMATCH_REL:
        seen = (
            "" if best is None else f" (the colours of the best candidate differ by {100 * best[0].mismatch_rel:.0f} %)"
        )
        raise RadiometryError(
            f"no ColorChecker was found in the frame of {linear_rgb.shape[0]} x {linear_rgb.shape[1]} cells{seen}; "
            "make sure that the whole chart is in view and unshaded, and its patches at least 10 cells (20 px) wide"
        )
    patches, clipped = best
    if clipped.max() > LARGEST_CLIPPED_FRACTION:
        numbers = ", ".join(str(n + 1) for n in np.flatnonzero(clipped > LARGEST_CLIPPED_FRACTION))
        raise RadiometryError(
            f"patches {numbers} of the ColorChecker are clipped, but at most {100 * LARGEST_CLIPPED_FRACTION:.1f} % "
            "of a patch may be at full scale; use a shorter exposure"
        )
    return patches


def _proposals(linear_rgb: Floats) -> Iterator[Floats]:
    """Yield (24, 4, 2) corners (x, y) of the middle parts of the patches, as the detector sees them."""
    shown = _displayed(linear_rgb)
    shorter = min(shown.shape[:2])
    for side in SHORTER_SIDES_PX:
        scale = side / shorter
        size = (round(shown.shape[1] * scale), round(shown.shape[0] * scale))
        resized = cv2.resize(shown, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        detector = cv2.mcc.CCheckerDetector.create()
        parameters = detector.getDetectionParams()
        parameters.minImageSize = side  # else the detector magnifies by itself
        detector.setDetectionParams(parameters)
        detector.setColorChartType(cv2.mcc.MCC24)
        if detector.process(resized, 1):
            corners = np.asarray(detector.getBestColorChecker().getColorCharts(), dtype=np.float64)
            # Pixel centres: (x + 1/2) scales, not x.
            yield (corners.reshape(PATCHES, 4, 2) + 0.5) / scale - 0.5


def _displayed(linear_rgb: Floats) -> NDArray[np.uint8]:
    """Return an 8-bit BGR image: channels scaled to a common white, gamma 2.2; for detection only."""
    white = np.nanpercentile(linear_rgb.reshape(-1, 3), WHITE_PERCENTILE, axis=0)
    relative = np.nan_to_num(linear_rgb / np.maximum(white, 1e-9), nan=1.0)
    encoded = np.clip(relative, 0.0, 1.0) ** (1.0 / DISPLAY_GAMMA)
    return np.ascontiguousarray(np.rint(255.0 * encoded[..., ::-1]), dtype=np.uint8)


def _measure(linear_rgb: Floats, quads: Floats, reference: Floats) -> tuple[ColourCheckerPatches, Floats] | None:
    """Return the patches and their clipped fractions (24,); None if a patch is too small or outside the frame."""
    middle = quads.mean(axis=1, keepdims=True)
    measured = middle + MEASURED_SHARE * (quads - middle)
    values = [linear_rgb[_inside(quad, linear_rgb.shape[:2])] for quad in measured]
    if min(len(v) for v in values) < SMALLEST_PATCH_PIXELS:
        return None
    clipped = np.array([np.isnan(v).any(axis=1).mean() for v in values])
    # A patch that is clipped as a whole counts with the brightest value seen, so that the chart can still be told.
    brightest = np.nanmax(linear_rgb.reshape(-1, 3), axis=0)
    filled = [np.where(np.isnan(v), brightest, v) for v in values]
    mean_dn = np.array([v.mean(axis=0) for v in filled])
    mapped = mean_dn @ np.linalg.lstsq(mean_dn, reference, rcond=None)[0]
    patches = ColourCheckerPatches(
        mean_dn=mean_dn,
        sd_dn=np.array([v.std(axis=0) for v in filled]),
        pixels=np.array([len(v) for v in values]),
        corners_px=_chart_corners(middle[:, 0]),
        mismatch_rel=float(np.linalg.norm(mapped - reference) / np.linalg.norm(reference - reference.mean(axis=0))),
    )
    return patches, clipped


def _inside(quad: Floats, shape: tuple[int, ...]) -> Mask:
    """Return the mask (H, W) of the cells inside a quadrilateral given as (x, y)."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(quad).astype(np.int32), 1)
    return mask.astype(bool)


def _chart_corners(centers: Floats) -> Floats:
    """Return the corners of the 6 x 4 grid of cells around the patch centres, from a homography through them."""
    grid = np.array([[column + 0.5, row + 0.5] for row in range(ROWS) for column in range(COLUMNS)])
    homography, _ = cv2.findHomography(grid, centers)
    outer = np.array([[[0.0, 0.0], [COLUMNS, 0.0], [COLUMNS, ROWS], [0.0, ROWS]]])
    return np.asarray(cv2.perspectiveTransform(outer, homography)[0], dtype=np.float64)


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
            "session.frames: the 'room light' frame is missing; capture the sample beside a ColorChecker in room "
            "light, or use the reflectance measured under the lamp"
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
            f"the painted region is clipped in {100 * clipped:.1f} % of its cells, but at most "
            f"{100 * LARGEST_CLIPPED_FRACTION:.1f} % is allowed; use a shorter exposure"
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
            f"themselves within {np.median(match.camera_delta_e):.1f}): used in place of a measurement, with "
            f"{100 * uncertainty_rel:.0f} % relative standard uncertainty (+- {sd:.2f} at every wavelength); light "
            f"that the "
            f"paint re-emits is part of its "
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


PATCH_SET = "BabelColor Average"
MATCH_UNCERTAINTY_REL = 0.30
# Two patches whose distances differ by less than this factor are about equally likely to be the closest.
AMBIGUOUS_FACTOR = 1.25


@dataclass(frozen=True, slots=True)
class PatchColours:
    """The 24 patches of the chart under D65 for the 2 degree observer.

    Attributes
    ----------
    names
        In the chart's order.
    reflectance
        (24, L) on :data:`WAVELENGTH_NM`; end values are held outside the measured 380 to 730 nm.
    xyz
        (24, 3) tristimulus values, Y of a perfect diffuser 1.
    white_xyz
        (3,) those of a perfect diffuser.
    """

    names: tuple[str, ...]
    reflectance: Floats
    xyz: Floats
    white_xyz: Floats


@dataclass(frozen=True, slots=True)
class ColourMatch:
    """How a paint compares with the 24 patches.

    Attributes
    ----------
    paint_delta_e
        (24,) distance of the paint from each patch.
    camera_delta_e
        (24,) distance of each patch from its prediction by the camera.
    luminance_factor
        Y of the paint, 1 for a perfect diffuser; above 1 for a paint that glows.
    """

    paint_delta_e: Floats
    camera_delta_e: Floats
    luminance_factor: float


@cache
def patch_colours() -> PatchColours:
    """Return the patches: averages over 30 charts ("BabelColor Average" of colour-science), colours under D65."""
    import colour  # takes seconds to import and only the room-light frame needs it

    shape = colour.SpectralShape(WAVELENGTH_NM[0], WAVELENGTH_NM[-1], 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    weights = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values[:, None] * observer
    weights = weights / weights[:, 1].sum()
    spectra = colour.SDS_COLOURCHECKERS[PATCH_SET]
    reflectance = np.array([np.interp(WAVELENGTH_NM, sd.wavelengths, sd.values) for sd in spectra.values()])
    names = tuple(name.partition(" (")[0] for name in spectra)
    return PatchColours(names, reflectance, reflectance @ weights, weights.sum(axis=0))


def match_colour(patch_rgb: Floats, paint_rgb: Floats) -> ColourMatch:
    """Compare the paint's colour with the 24 patches by CIEDE2000.

    ``XYZ = rgb A`` with the (3, 3) matrix A by least squares on the patches seen in the same frame. Camera errors are
    those of leaving one patch out. Valid where chart and paint are lit alike.

    Parameters
    ----------
    patch_rgb
        (24, 3) linear camera values of the patches.
    paint_rgb
        (3,) of the paint, same scale.

    References
    ----------
    CIE 142-2001; Sharma, Wu, Dalal, Color Research and Application 30 (2005) 21.
    """
    reference = patch_colours()
    matrix = _camera_matrix(patch_rgb, reference.xyz)
    left_out = np.array(
        [
            patch_rgb[n] @ _camera_matrix(np.delete(patch_rgb, n, axis=0), np.delete(reference.xyz, n, axis=0))
            for n in range(PATCHES)
        ]
    )
    paint_xyz = paint_rgb @ matrix
    return ColourMatch(
        paint_delta_e=_delta_e(np.broadcast_to(paint_xyz, (PATCHES, 3)), reference.xyz),
        camera_delta_e=_delta_e(left_out, reference.xyz),
        luminance_factor=float(paint_xyz[1]),
    )


def match_uncertainty_rel(match: ColourMatch) -> float:
    """Return the standard uncertainty of the closest patch's curve as the paint's, relative to the RMS of the latter.

    The measured 0.30; where the runner-up is about as close (within a factor 1.25), half the relative RMS difference
    of the two curves is added in quadrature.
    """
    first, second = np.argsort(match.paint_delta_e)[:2]
    if match.paint_delta_e[second] > AMBIGUOUS_FACTOR * match.paint_delta_e[first]:
        return MATCH_UNCERTAINTY_REL
    one, other = patch_colours().reflectance[[first, second]]
    return float(np.hypot(MATCH_UNCERTAINTY_REL, 0.5 * np.linalg.norm(other - one) / np.linalg.norm(one)))


def reflectance_sd(match: ColourMatch) -> float:
    """Return the standard uncertainty of the paint's reflectance after the closest patch, equal at all wavelengths.

    The relative uncertainty times the RMS of the paint's curve, which is unknown: that of the patch's curve stands in,
    times the ratio of luminances where the paint is brighter than the patch.
    """
    closest = int(match.paint_delta_e.argmin())
    reference = patch_colours()
    rms = float(np.sqrt(np.mean(reference.reflectance[closest] ** 2)))
    return match_uncertainty_rel(match) * rms * max(1.0, match.luminance_factor / float(reference.xyz[closest, 1]))


def _camera_matrix(rgb: Floats, xyz: Floats) -> Floats:
    """Return the least-squares (3, 3) matrix from camera RGB to XYZ."""
    return np.asarray(np.linalg.lstsq(rgb, xyz, rcond=None)[0])


def _delta_e(first_xyz: Floats, second_xyz: Floats) -> Floats:
    """Return CIEDE2000 of pairs of XYZ under D65; what the matrix drives below zero counts as black."""
    import colour

    reference = patch_colours()
    white_xy = reference.white_xyz[:2] / reference.white_xyz.sum()
    first, second = (colour.XYZ_to_Lab(np.maximum(xyz, 0.0), white_xy) for xyz in (first_xyz, second_xyz))
    return np.asarray(colour.delta_E(first, second, method="CIE 2000"), dtype=np.float64)
