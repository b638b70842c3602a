"""The optics of a press as files that image programs open: OpenEXR for numbers, PNG for raw frames and pictures."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import Provenance, SimulatedPress
from data_schemas.storage import ProductSet, refuse_taken
from sim.experiments import OpticsProducts
from sim.optics import BAND_NAMES, PixelMaps, exr_image

ByteImage = NDArray[np.uint8]

SPECTRAL_LAYOUT_VERSION = "1.0"
DEPTH_UNIT_MM = 1e-3
"""Unit of the depth PNG: one micrometre; what a 16-bit image cannot hold is clipped."""

README = """\
bands.exr      radiance per chain of fluorescence ("led>green>red": LED light turned green, then red), relative to the
               panel's; a band is the sum of its chains; layers contact, no_contact; *_sd: render noise of the bands
spectral.exr   contact, spectral radiance per nm at each wavelength (layout of Fichet 2021: S0.<nm>nm)
geometry.exr   per pixel of the contact: part seen, texture coordinates, position, normal, depth, contact distance;
               axes of the undeformed pad in mm (x across, y into the gel, z along), NaN where there is none
*-raw.png      raw counts of the sensor (RGGB, 16 bit, right-aligned, black level in the capture)
depth.png      how far the coat has moved inward, in 0.001 mm; moved outward or not seen: 0
contact.png    white where the contact is seen
normal.png     normal, -1..1 as 0..255
*-view*.png    for the eye only, never measure in them: white-balanced by the pad, sRGB
*-view-pi.png  for the eye only: as the image processing of a Raspberry Pi (camera module 2) would show it
timings.json   seconds of each step
"""


def write_optics_folder(
    folder: Path, products: OpticsProducts, views: Mapping[str, ByteImage], origin: Provenance, stored: ProductSet
) -> None:
    """Write all products of a press into a new folder, which is stored with a set.

    Parameters
    ----------
    folder
        Must not exist.
    products
        From :func:`sim.experiments.simulate_images`.
    views
        Pictures for the eye by file name without suffix, (rows, columns, 3) sRGB.
    origin
        Provenance of the press, stored in the header of each EXR image.
    stored
        The set that the folder belongs to.

    Raises
    ------
    RecordError
        The folder exists already.
    """
    refuse_taken(folder)
    for name, image in _exr_images(products, f"{products.press.label}; made by {origin.command}").items():
        stored.add(folder / f"{name}.exr", image)
    for name in ("contact", "no_contact"):
        counts: NDArray[np.uint16] = getattr(products.capture, name)[..., 0]
        stored.add(folder / f"{name}-raw.png", png(counts))
    for name, picture in {**geometry_pictures(products.maps), **views}.items():
        stored.add(folder / f"{name}.png", png(picture))
    timings = {"seconds": dict(products.timings_s), "label": products.press.label}
    stored.add(folder / "timings.json", (json.dumps(timings, indent=1) + "\n").encode())
    stored.add(folder / "README.txt", README.encode())


PICTURE_README = """\
images.exr     linear red, green and blue; layers contact, no_contact, and variance of contact from render noise
*-view.png     for the eye only, never measure in them: sRGB, all channels on one scale
change-view    four times what contact changes, grey where it changes nothing
"""


def write_picture_folder(
    folder: Path, press: SimulatedPress, views: Mapping[str, ByteImage], origin: Provenance, stored: ProductSet
) -> None:
    """Write the images of a classic sensor's press into a new folder, which is stored with a set.

    Parameters
    ----------
    folder
        Must not exist.
    press
        Rendered, with its variance.
    views
        Pictures for the eye by file name without suffix, (rows, columns, 3) sRGB.
    origin
        Provenance of the press, stored in the header of the EXR image.
    stored
        The set that the folder belongs to.

    Raises
    ------
    RecordError
        The folder exists already.
    """
    refuse_taken(folder)
    images = {"no_contact": press.no_contact, "contact": press.contact, "variance": press.variance}
    channels = {
        f"{name}.{colour}": image[..., k]
        for name, image in images.items()
        if image is not None
        for k, colour in enumerate("RGB")
    }
    stored.add(folder / "images.exr", exr_image(channels, {"comments": f"{press.label}; made by {origin.command}"}))
    for name, picture in views.items():
        stored.add(folder / f"{name}.png", png(picture))
    stored.add(folder / "README.txt", PICTURE_README.encode())


def png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return an image of 8 or 16 bit, grey (rows, columns) or RGB (rows, columns, 3), as PNG bytes."""
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1] if image.ndim == 3 else image))
    return encoded.tobytes()


def spectral_channel(wavelength_nm: float) -> str:
    """Return the name of a channel of unpolarised spectral radiance, such as "S0.450,000000nm"."""
    return f"S0.{wavelength_nm:.6f}nm".replace(".", ",").replace("S0,", "S0.", 1)


def geometry_channels(maps: PixelMaps) -> dict[str, NDArray[Any]]:
    """Return the channels of geometry.exr."""
    channels: dict[str, NDArray[Any]] = {
        "part": maps.part,
        "depth.mm": maps.depth_mm,
        "depth_along_ray.mm": maps.depth_along_ray_mm,
        "contact_distance": maps.contact_distance,
    }
    for layer, values, names in (
        ("uv", maps.uv, "uv"),
        ("position", maps.position_mm, "XYZ"),
        ("normal", maps.normal, "XYZ"),
    ):
        channels |= {f"{layer}.{name}": values[..., k] for k, name in enumerate(names)}
    return channels


def geometry_pictures(maps: PixelMaps) -> dict[str, NDArray[Any]]:
    """Return depth (16 bit), contact mask and normals as pictures."""
    depth = np.clip(np.rint(np.nan_to_num(maps.depth_mm) / DEPTH_UNIT_MM), 0, 65535).astype(np.uint16)
    normal = np.rint(255.0 * (np.nan_to_num(maps.normal, nan=-1.0) * 0.5 + 0.5)).astype(np.uint8)
    return {"depth": depth, "contact": (255 * maps.contact).astype(np.uint8), "normal": normal}


def _exr_images(products: OpticsProducts, comment: str) -> dict[str, bytes]:
    """Return bands, spectra and geometry by the name of their file."""
    bands = {
        f"{state}{kind}.{name}": images[state][..., k]
        for kind, images, names in (("", products.basis, products.basis_names), ("_sd", products.band_sd, BAND_NAMES))
        for state in images
        for k, name in enumerate(names)
    }
    spectral = {spectral_channel(nm): products.spectral[..., k] for k, nm in enumerate(products.wavelength_nm)}
    note = f"{comment}; relative spectral radiance, rebuilt from bands times their spectra; EV 0"
    layout = {"spectralLayoutVersion": SPECTRAL_LAYOUT_VERSION, "emissiveUnits": "W.m^-2.sr^-1", "comments": note}
    parts = ", ".join(f"{k} {name}" for k, name in enumerate(products.maps.parts))
    return {
        "bands": exr_image(bands, {"comments": f"{comment}; radiance relative to the panel's"}),
        "spectral": exr_image(spectral, layout),
        "geometry": exr_image(geometry_channels(products.maps), {"comments": f"{comment}; part: -1 none, {parts}"}),
    }
