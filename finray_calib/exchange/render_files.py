"""The optics of a press as files that image programs open: OpenEXR for numbers, PNG for raw frames and pictures."""

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import MissingExtraError
from data_schemas.product_set import ProductSet
from data_schemas.provenance import Provenance
from data_schemas.whole_files import refuse_taken
from finray_calib.exchange.bispectral_exr import exr_image
from sim.experiments.optics_products import OpticsProducts
from sim.optics.paint_bands import BAND_NAMES
from sim.optics.pixel_maps import PixelMaps

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
*-view*.png    for the eye only: white-balanced by the pad, sRGB; never measure in them
timings.json   seconds of each step
"""


def require_exr() -> ModuleType:
    """Return the OpenEXR package; called before anything is rendered.

    Raises
    ------
    MissingExtraError
        The OpenEXR package is not installed.
    """
    try:
        return import_module("OpenEXR")
    except ImportError:
        raise MissingExtraError("OpenEXR images need the OpenEXR package: pip install 'finray-calib[exr]'") from None


def write_optics_folder(
    folder: Path, products: OpticsProducts, views: Mapping[str, ByteImage], origin: Provenance, stored: ProductSet
) -> None:
    """Write all products of a press into a new folder, which is stored with a set.

    Parameters
    ----------
    folder
        Must not exist.
    products
        From :func:`sim.experiments.optics_products.optics_products`.
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
    MissingExtraError
        The OpenEXR package is not installed.
    """
    refuse_taken(folder)
    with TemporaryDirectory() as name:
        _write_exr_files(Path(name), products, f"{products.press.label}; made by {origin.command}")
        for file in sorted(Path(name).iterdir()):
            stored.add(folder / file.name, file.read_bytes())
    for name in ("contact", "no_contact"):
        counts: NDArray[np.uint16] = getattr(products.capture, name)[..., 0]
        stored.add(folder / f"{name}-raw.png", png(counts))
    for name, picture in {**geometry_pictures(products.maps), **views}.items():
        stored.add(folder / f"{name}.png", png(picture))
    timings = {"seconds": dict(products.timings_s), "label": products.press.label}
    stored.add(folder / "timings.json", (json.dumps(timings, indent=1) + "\n").encode())
    stored.add(folder / "README.txt", README.encode())


def write_exr(path: Path, channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, Any]) -> None:
    """Write single-precision channels (rows, columns) as one OpenEXR image, losslessly compressed.

    Parameters
    ----------
    path
        File to write.
    channels
        By name; a dot separates a layer from its channel.
    attributes
        Further fields of the header.
    """
    open_exr = require_exr()
    header = {"compression": open_exr.ZIP_COMPRESSION, "type": open_exr.scanlineimage, **attributes}
    pixels = {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in channels.items()}
    with open_exr.File(header, pixels) as file:
        file.write(str(path))


def read_exr(path: Path) -> dict[str, NDArray[np.float32]]:
    """Return the channels of an OpenEXR image, which is parsed in a child process with limits.

    Raises
    ------
    ImportFormatError
        It is missing, or no OpenEXR image.
    MissingExtraError
        The OpenEXR package is not installed.
    """
    return exr_image(path)


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


def _write_exr_files(folder: Path, products: OpticsProducts, comment: str) -> None:
    """Write bands, spectra and geometry."""
    bands = {
        f"{state}{kind}.{name}": images[state][..., k]
        for kind, images, names in (("", products.basis, products.basis_names), ("_sd", products.band_sd, BAND_NAMES))
        for state in images
        for k, name in enumerate(names)
    }
    write_exr(folder / "bands.exr", bands, {"comments": f"{comment}; radiance relative to the panel's"})
    spectral = {spectral_channel(nm): products.spectral[..., k] for k, nm in enumerate(products.wavelength_nm)}
    units = {"spectralLayoutVersion": SPECTRAL_LAYOUT_VERSION, "emissiveUnits": "W.m^-2.sr^-1", "EV": 0.0}
    note = f"{comment}; relative spectral radiance, rebuilt from bands times their spectra"
    write_exr(folder / "spectral.exr", spectral, {**units, "comments": note})
    parts = ", ".join(f"{k} {name}" for k, name in enumerate(products.maps.parts))
    write_exr(
        folder / "geometry.exr", geometry_channels(products.maps), {"comments": f"{comment}; part: -1 none, {parts}"}
    )
