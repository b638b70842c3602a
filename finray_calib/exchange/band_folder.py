"""Folders of wavelength-named TIFF images of other labs as band signals."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame, LightState, PaintPlan, Target
from data_schemas.devices import CameraSettings, LampSettings
from data_schemas.errors import ImportFormatError
from data_schemas.filter_curves import coverage_notes
from data_schemas.provenance import digest_of_input
from data_schemas.radiometry import BandSignals
from data_schemas.rig import RigFile
from data_schemas.storage import read_toml
from finray_calib.exchange.band_folder_curves import (
    DESCRIPTION_NAME,
    filter_curves_of,
    lamp_of,
    named_files,
    require_inside,
    response_of,
    wheel_of,
)
from finray_calib.exchange.band_folder_file import BandFolder
from finray_calib.exchange.band_images import BandImage, find_images, read_image
from finray_calib.exchange.monochrome_signals import one_channel
from finray_calib.radiometry.band_signals import band_signals

Floats = NDArray[np.float64]
_SCENE: Mapping[str, tuple[Target, LightState]] = {
    "dark": ("white", "off"),
    "white": ("white", "lamp"),
    "laser white": ("white", "laser"),
    "reflectance": ("sample", "lamp"),
    "fluorescence": ("sample", "laser"),
}


def import_band_folder(folder: Path) -> tuple[BandSignals, dict[str, str]]:
    """Reduce a folder of band images and its ``bands.toml`` to band signals, with the arithmetic of paint sessions.

    Of a monochrome camera the green column holds the signals; red and blue are flagged "weak" and never used.

    Parameters
    ----------
    folder
        Holds ``bands.toml``, the images and the curves that it names.

    Returns
    -------
    BandSignals, dict
        The signals, and file name below the folder -> SHA-256 of every file that was used.

    Raises
    ------
    ImportFormatError
        An image is missing or not what the description says.
    RecordError
        ``bands.toml`` is missing or a field of it is wrong.
    CurveError
        A curve file is unusable.
    RadiometryError
        The images cannot be reduced: saturated bands, missing darks, an empty region.
    """
    description = read_toml(folder / DESCRIPTION_NAME, BandFolder)
    require_inside(folder, description)
    images = find_images(folder, description)
    _check_darks(images)
    frames = [_frame(n, image) for n, image in enumerate(images)]
    paths = {frame.file: image.path for frame, image in zip(frames, images, strict=True)}
    shape = _common_shape(images, description)
    black: dict[str, Floats] = {}
    if not description.darks:
        for frame, level_dn in _black_frames(description, images):
            frames.append(frame)
            black[frame.file] = np.full(shape, level_dn)

    def read(frame: Frame) -> Any:
        if frame.file in black:
            return black[frame.file]
        return read_image(paths[frame.file], description.camera)

    session = _session(folder, description, tuple(frames))
    bands = band_signals(session, read)
    used = [*(path.relative_to(folder).as_posix() for path in paths.values()), *named_files(description)]
    digests = {name: digest_of_input(folder / name) for name in used}
    return (one_channel(bands) if description.camera.layout == "monochrome" else bands), digests


def _frame(sequence: int, image: BandImage) -> Frame:
    """Return the frame record of an image; what the folder does not tell keeps a neutral value."""
    target, light = _SCENE[image.frame_type]
    return Frame(
        sequence=sequence,
        file=f"frames/{sequence:05d}-{re.sub('[^A-Za-z0-9_.-]', '-', image.path.name)}.tiff",
        frame_type=image.frame_type,
        target=target,
        light=light,
        filter_name=image.filter_name,
        slot_before=None,
        slot_after=None,
        exposure_requested_s=image.exposure_s,
        exposure_s=image.exposure_s,
        captured_utc="unknown",
        saturated_fraction=0.0,
        sha256="0" * 64,  # of no stored frame: the images are inputs, whose digests stand in the provenance
    )


def _black_frames(description: BandFolder, images: list[BandImage]) -> list[tuple[Frame, float]]:
    """Return dark frames made of the declared black level: two per exposure time, apart by its uncertainty.

    Radiometry reads half the difference d of before and after as a rectangular uncertainty d / sqrt(3).
    """
    spread_dn = np.sqrt(3.0) * description.camera.black_level_uncertainty_dn
    frames: list[tuple[Frame, float]] = []
    for side in (-1.0, 1.0):
        for exposure_s in sorted({image.exposure_s for image in images}):
            image = BandImage(Path(), "dark", None, exposure_s)
            level_dn = description.camera.black_level_dn + side * spread_dn
            frames.append((_frame(len(images) + len(frames), image), level_dn))
    return frames


def _check_darks(images: list[BandImage]) -> None:
    """Refuse dark frames that miss an exposure time in use."""
    dark_s = {image.exposure_s for image in images if image.frame_type == "dark"}
    for image in images:
        if dark_s and image.exposure_s not in dark_s:
            raise ImportFormatError(
                f"{image.path}: was exposed for {image.exposure_s:g} s, but the dark frames are of "
                f"{', '.join(f'{s:g}' for s in sorted(dark_s))} s; add a [[darks]] table of this time, or leave all "
                "out and give camera.black_level_dn"
            )


def _common_shape(images: list[BandImage], description: BandFolder) -> tuple[int, ...]:
    """Return the shape of all images (px), read one at a time; refuse images of different sizes."""
    first: tuple[int, ...] = ()
    for image in images:
        shape = read_image(image.path, description.camera).shape
        first = first or shape
        if shape != first:
            raise ImportFormatError(
                f"{image.path}: is {shape[0]} x {shape[1]} px, but {images[0].path.name} is {first[0]} x {first[1]} "
                "px; all images must come from the same camera settings"
            )
    return first


def _session(folder: Path, description: BandFolder, frames: tuple[Frame, ...]) -> CaptureSession:
    """Return the folder as the paint session that radiometry reduces; it is never stored."""
    camera = description.camera
    filter_curves = filter_curves_of(folder, description)
    wheel = wheel_of(folder, description, filter_curves)
    response, lamp = response_of(folder, description), lamp_of(folder, description)
    # Constructed, not validated: a rig wants drivers or a simulated bench, and an imported folder has neither.
    rig = RigFile.model_construct(
        name=f"imported from {folder.resolve().name}",
        camera=CameraSettings(
            bit_depth=camera.bit_depth,
            black_level_dn=camera.black_level_dn,
            gain_e_per_dn=camera.gain_e_per_dn,
            read_noise_e=camera.read_noise_e,
            response=camera.response,
        ),
        filter_wheel=wheel,
        laser=description.laser,
        lamp=LampSettings(),
        white_reference=description.white_reference,
        simulated=None,
        provenance=None,
    )
    return CaptureSession.model_construct(
        provenance=None,
        plan=PaintPlan(
            paint_name=description.paint_name,
            filters=tuple(f.name for f in description.filters),
            excitation_filter=description.excitation_filter,
            region=description.region,
        ),
        rig=rig,
        camera_response=response,
        filter_curves=filter_curves,
        lamp=lamp,
        frames=frames,
        notes=_notes(folder, description) + coverage_notes(wheel.filters, filter_curves, (*response, lamp)),
    )


def _notes(folder: Path, description: BandFolder) -> tuple[str, ...]:
    """Say what a reader of the signals must know of their origin."""
    notes = [f"imported from {folder.resolve().name} ({description.camera.layout}); laser dose unknown"]
    if not description.darks:
        notes.append(
            f"no dark frames: black level {description.camera.black_level_dn:g} DN with standard uncertainty "
            f"{description.camera.black_level_uncertainty_dn:g} DN, as declared"
        )
    if description.camera.response == "assumed":
        notes.append("the camera response is assumed")
    return tuple(notes)
