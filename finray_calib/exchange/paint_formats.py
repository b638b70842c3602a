"""The formats in which a calibrated paint leaves finray."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data_schemas.curves import SpectralCurve
from data_schemas.fit import PaintCalibration
from data_schemas.provenance import Provenance
from finray_calib.exchange.led_camera_matrix import CameraResponse


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What some formats need beside the paint: lights and camera of the reduced matrix, seed of replicated data."""

    lights: Sequence[SpectralCurve]
    response: CameraResponse
    seed: int


def _csv(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.paint_text import csv_text

    return csv_text(paint, origin).encode()


def _json(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.paint_json import json_text
    from finray_calib.exchange.paint_spectra import paint_spectra

    return json_text(paint, paint_spectra(paint), origin).encode()


def _netcdf(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.inference_data import netcdf_bytes
    from finray_calib.exchange.paint_spectra import paint_spectra

    return netcdf_bytes(paint, paint_spectra(paint), origin, np.random.default_rng(options.seed))


def _spdx(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.spectral_distribution import spdx_bytes

    return spdx_bytes(paint, origin)


def _mitsuba(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.paint_text import mitsuba_text

    return mitsuba_text(paint, origin).encode()


def _rgb_reradiation(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.led_camera_json import led_camera_json
    from finray_calib.exchange.paint_spectra import paint_spectra

    return led_camera_json(paint_spectra(paint), options.lights, options.response, origin).encode()


def _exr(paint: PaintCalibration, origin: Provenance, options: ExportOptions) -> bytes:
    from finray_calib.exchange.bispectral_exr import exr_bytes
    from finray_calib.exchange.paint_spectra import paint_spectra

    return exr_bytes(paint_spectra(paint), origin)


PaintFormat = Callable[[PaintCalibration, Provenance, ExportOptions], bytes]
PAINT_FORMATS: dict[str, PaintFormat] = {
    "csv": _csv,
    "json": _json,
    "netcdf": _netcdf,
    "spdx": _spdx,
    "mitsuba": _mitsuba,
    "rgb-reradiation": _rgb_reradiation,
    "exr": _exr,
}
