"""A paint's colour against the 24 ColorChecker patches, and what the closest patch's reflectance is worth as its own.

The stand-in is rough, and a fluorescent paint also glows in room light, which shifts its colour. Measured on four
fluorescent materials (relative RMS of the patch's curve from the measured reflectance): 0.14 to 0.36 when the colour
is that of the reflectance alone (root mean square 0.28), up to 0.47 when room light makes the paint glow (0.35). The
stated uncertainty, with its term for an ambiguous match, covers both: root mean square error over uncertainty 0.8 to
1.1 over five lights and three cameras. Being a share of the whole curve, it is carried as one standard uncertainty at
all wavelengths: 30 % of the local value would cover only 59 % of the filters at a nominal 95 %, this one 96 %.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from finray_calib.radiometry.find_colour_checker import PATCHES
from finray_calib.spectra.rig_curves import WAVELENGTH_NM

Floats = NDArray[np.float64]
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
