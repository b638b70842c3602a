"""A finger design with calibrated paints: what every study renders."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CameraCalibration,
    FingerDesign,
    PaintCalibration,
    SimulateError,
    SpectralCurve,
    require_coverage,
)
from data_schemas.storage import camera_response
from sim.optics import BAND_NAMES, PaintBands, PaintOptics, camera_matrix, read_calibration

Floats = NDArray[np.float64]
CameraResponse = tuple[SpectralCurve, SpectralCurve, SpectralCurve]
COLOURS = ("red", "green")
RESPONSE_NM: Floats = np.arange(380.0, 781.0, 1.0)
RESPONSE_NM.flags.writeable = False


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
                f"no paint for the {missing[0]} wall: give --paint red=FILE and --paint green=FILE (both written by "
                "'finray fit')"
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
