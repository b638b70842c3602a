r"""Reduce frames to numbers: band signals of a paint with their covariance, or the characteristics of a camera.

.. math:: y_{bc} = \frac{F_{bc} / W_{bc}}{V}

with F the sample under the laser, W the white reference under the lamp and V the laser's level on the white reference,
all dark-corrected and linear: sensitivity of the pixels and transmission of the filters cancel. `band_signals` does so
over a region, `pixel_signals` for every raw pixel, `characterise_camera` gives gain, noise and saturation after EMVA
1288. Also what a Raspberry Pi camera did to its images. No devices; a caller's function reads the frames.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.radiometry._band_signals import (
        LaserLevel,
        Readings,
        band_signals,
        bands_of_steps,
        fluorescence_of_readings,
        level_of_readings,
        monochrome_bands,
        reflectance_of_readings,
        rig_optics,
        texture_variance_rel,
        tilt_ratios,
    )
    from finray_calib.radiometry._camera_characterisation import (
        characterise_camera,
        sensitivity_threshold_e,
        with_camera,
    )
    from finray_calib.radiometry._photon_transfer import FrameStack, PhotonTransfer, linearity, photon_transfer
    from finray_calib.radiometry._pixel_signals import laser_profile, pixel_signals
    from finray_calib.radiometry._raspberry_pi import (
        CaptureSettings,
        LibcameraTuning,
        capture_settings,
        parse_tuning,
        processed_signal,
        raw_signal,
        require_same_settings,
        shading_gains,
    )
    from finray_calib.radiometry._session_steps import SessionSteps, bleaching_trend, session_steps, signal_covariance
    from finray_calib.radiometry._step_signals import ReadFrame
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CaptureSettings",
    "FrameStack",
    "LaserLevel",
    "LibcameraTuning",
    "PhotonTransfer",
    "ReadFrame",
    "Readings",
    "SessionSteps",
    "band_signals",
    "bands_of_steps",
    "bleaching_trend",
    "capture_settings",
    "characterise_camera",
    "fluorescence_of_readings",
    "laser_profile",
    "level_of_readings",
    "linearity",
    "monochrome_bands",
    "parse_tuning",
    "photon_transfer",
    "pixel_signals",
    "processed_signal",
    "raw_signal",
    "reflectance_of_readings",
    "require_same_settings",
    "rig_optics",
    "sensitivity_threshold_e",
    "session_steps",
    "shading_gains",
    "signal_covariance",
    "texture_variance_rel",
    "tilt_ratios",
    "with_camera",
]
