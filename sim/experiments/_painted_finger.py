"""A finger design with calibrated paints: what every study renders."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CameraCalibration,
    FingerDesign,
    FingerSurfaces,
    PaintCalibration,
    SimulateError,
    SpectralCurve,
    digest_of_input,
    require_coverage,
)
from data_schemas.storage import camera_response, read_bytes
from sim.optics import BAND_NAMES, PaintBands, PaintOptics, camera_matrix, read_calibration
from sim.surface_meshes import FingerShape, restore_shapes

Floats = NDArray[np.float64]
CameraResponse = tuple[SpectralCurve, SpectralCurve, SpectralCurve]
COLOURS = ("red", "green")
RESPONSE_NM: Floats = np.arange(380.0, 781.0, 1.0)
RESPONSE_NM.flags.writeable = False
_NAMED: Final = {
    "camera": ("calibration", "response"),
    "indenter": ("file",),
}
"""Part of a finger -> its fields that name a file."""
#: Words of such a field that name no file.
_NO_FILE: Final = (None, "assumed", "ideal")


@dataclass(frozen=True, slots=True)
class PaintedFinger:
    """Everything a render needs.

    Attributes
    ----------
    design
        Geometry, materials and light.
    paints
        Optics of the "red" and the "green" paint.
    response
        Tactile camera: red, green and blue curve.
    renderer
        Opened by :func:`sim.optics.open_renderer`.
    calibration
        Geometry of the tactile camera; an ideal pinhole without it.
    """

    design: FingerDesign
    paints: Mapping[str, PaintOptics]
    response: CameraResponse
    renderer: ModuleType
    calibration: CameraCalibration | None = None

    def __post_init__(self) -> None:
        missing = [colour for colour in COLOURS if colour not in self.paints]
        if missing:
            raise SimulateError(
                f"the paint of the {missing[0]} wall is missing; give --paint red=FILE and --paint green=FILE (both "
                "written by 'finray fit')"
            )

    def coverage_notes(self, bands: PaintBands) -> tuple[str, ...]:
        """Return :func:`coverage_notes` of this finger's camera."""
        return coverage_notes(self.response, bands)

    def camera_matrix(self, bands: PaintBands) -> Floats:
        """Return :func:`response_matrix` of this finger's camera."""
        return response_matrix(self.response, bands)


def coverage_notes(response: CameraResponse, bands: PaintBands) -> tuple[str, ...]:
    """Say for which bands a response curve ends too early and its end value is held.

    Raises
    ------
    CurveError
        A response curve misses more than 20 % of a band.
    """
    notes = (
        require_coverage(curve, band.wavelength_nm, band.density_per_nm, f"the {name} band")
        for curve in response
        for name, band in zip(BAND_NAMES, bands.bands, strict=True)
    )
    return tuple(f"camera response: {note}" for note in notes if note is not None)


def response_matrix(response: CameraResponse, bands: PaintBands) -> Floats:
    """Return the (3, 3) matrix from bands to camera RGB; :func:`coverage_notes` says what it rests on.

    Raises
    ------
    CurveError
        A response curve misses more than 20 % of a band.
    """
    coverage_notes(response, bands)
    return camera_matrix(np.array([curve(RESPONSE_NM) for curve in response]), RESPONSE_NM, bands)


def paint_optics(calibration: PaintCalibration) -> PaintOptics:
    """Return the optics of a calibrated paint.

    Fitted emission and absorption (posterior means), reflectance interpolated between the filters.
    """
    wavelength_nm = calibration.wavelength_nm
    centers = [f.center_nm for f in calibration.optics.filters]
    order = np.argsort(centers)
    absorption = calibration.reradiation
    reflectance = np.clip([r.estimate for r in calibration.reflectance], 0.0, 1.0)
    return PaintOptics(
        name=calibration.paint_name,
        wavelength_nm=wavelength_nm,
        emission_per_nm=np.maximum(calibration.emission_per_nm, 0.0),
        reflectance=np.interp(wavelength_nm, np.array(centers)[order], reflectance[order]),
        absorption_rel=np.interp(wavelength_nm, absorption.excitation_nm, absorption.absorption_rel),
    )


def paint_finger(
    design: FingerDesign, paints: Mapping[str, PaintOptics], folder: Path, renderer: ModuleType
) -> PaintedFinger:
    """Join a design with its paints, and read the files of its camera.

    Parameters
    ----------
    design
        The finger.
    paints
        Optics of the "red" and of the "green" paint, see :func:`paint_optics`.
    folder
        Where relative paths in the design start.
    renderer
        From :func:`sim.optics.open_renderer`.
    """
    response = camera_response(design.camera.response, folder)
    file = design.camera.calibration
    calibration = None if file is None else read_calibration(folder / file)
    return PaintedFinger(design, paints, response, renderer, calibration)


@dataclass(frozen=True, slots=True)
class FingerScene:
    """What a press or a sweep is rendered from.

    Attributes
    ----------
    finger
        Design, paints, camera and renderer.
    calibrations
        Fits of the "red" and the "green" paint; empty where the paints are known otherwise.
    shapes
        The finger without and with contact, where a press by finite elements is rendered; None for the analytic press.
    """

    finger: PaintedFinger
    calibrations: Mapping[str, PaintCalibration] = field(default_factory=dict)
    shapes: tuple[FingerShape, FingerShape] | None = None


def finger_scene(
    design: FingerDesign,
    calibrations: Mapping[str, PaintCalibration],
    folder: Path,
    renderer: ModuleType,
    surfaces: FingerSurfaces | None = None,
) -> FingerScene:
    """Paint a finger, and put the surfaces of a press in the place of the analytic one.

    Parameters
    ----------
    design
        The finger; with `surfaces` its push becomes theirs, which is less where the press ended early.
    calibrations
        Fits of the "red" and the "green" paint.
    folder
        Where relative paths in the design start.
    renderer
        From :func:`sim.optics.open_renderer`.
    surfaces
        The finger without and with contact, by a press by finite elements.
    """
    shapes = None if surfaces is None else restore_shapes(surfaces)
    if surfaces is not None and surfaces.push_mm is not None:
        indenter = design.indenter.model_copy(update={"depth_mm": surfaces.push_mm})
        design = design.model_copy(update={"indenter": indenter})
    paints = {colour: paint_optics(calibration) for colour, calibration in calibrations.items()}
    return FingerScene(paint_finger(design, paints, folder, renderer), calibrations, shapes)


def require_paints_in_order(modes_nm: Mapping[str, float], names: Mapping[str, str], remedy: str) -> None:
    """Refuse a red paint whose emission has its mode below the green one's: the two look swapped.

    Parameters
    ----------
    modes_nm
        Wavelength of the emission's maximum of "red" and "green"; with one of them nothing can be said.
    names
        What the message calls them, such as their files.
    remedy
        What to give if the paints are meant so.

    Raises
    ------
    SimulateError
        They look swapped.
    """
    if len(modes_nm) < len(COLOURS) or modes_nm["red"] >= modes_nm["green"]:
        return
    raise SimulateError(
        f"the paints look swapped, because red={names['red']} emits most at {modes_nm['red']:.0f} nm, below "
        f"green={names['green']} at {modes_nm['green']:.0f} nm. Exchange the paints, or give {remedy} if this is "
        "intended"
    )


def read_design_files(design: FingerDesign, folder: Path, parts: Collection[str] = tuple(_NAMED)) -> dict[str, Path]:
    """Read the files that parts of a design name, so that their content is known; return field -> file.

    Parameters
    ----------
    design
        The finger.
    folder
        Where relative paths in the design start.
    parts
        "camera", "indenter" or both.

    Raises
    ------
    RecordError
        A file is not there or cannot be read.
    """
    files = _files(design, folder, parts)
    for name, file in files.items():
        read_bytes(file, f"a file ({name} of the design)")
    return files


def design_digests(design: FingerDesign, folder: Path, parts: Collection[str] = tuple(_NAMED)) -> dict[str, str]:
    """Return field -> SHA-256 of the files that parts of a design name, for keys: a name may stay with another content.

    Empty where the design names none. Parameters and errors as of :func:`read_design_files`.
    """
    files = read_design_files(design, folder, parts)
    # keys that are kept know the indenter's only file as "indenter"
    return {name.removesuffix(".file"): digest_of_input(file) for name, file in files.items()}


def _files(design: FingerDesign, folder: Path, parts: Collection[str]) -> dict[str, Path]:
    """Return field -> file of what parts of a design name."""
    named = {f"{part}.{name}": getattr(getattr(design, part), name) for part in parts for name in _NAMED[part]}
    return {name: folder / file for name, file in named.items() if file not in _NO_FILE}
