"""Renders as files: the optics of a press for image programs, and what any other simulator rendered.

Out go OpenEXR for numbers, PNG for raw frames and pictures. In come folders of images, as the simulated side of a
comparison. One folder holds one press: ``contact`` and ``no_contact`` (PNG, JPEG, OpenEXR or npy), where the contact is
(``depth.npy``, how deep each pixel of the gel is pressed in, in mm; or a mask, ``contact_mask.png``; or a circle),
and ``render.json``, which says what the values are. A folder of such folders holds several presses. What cannot be
known from the files is asked for: PNG and JPEG are encoded and OpenEXR linear light unless render.json says otherwise,
npy says nothing by itself.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from data_schemas import ContactCircle, ImportFormatError, Model, Provenance, SimulatedPress, TactileCapture, explain
from data_schemas.storage import ProductSet, read_json, read_npy, refuse_existing
from finray_calib.exchange._set_files import exr_rgb, in_colour, pixels_of, require_alike
from finray_calib.sensing import contact_distance, outline_distance, rgb_image
from rigs.cameras import read_picture
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
    refuse_existing(folder)
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
    refuse_existing(folder)
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


Floats = NDArray[np.float64]
CONTACT: Final = "contact"
NO_CONTACT: Final = "no_contact"
DESCRIPTION: Final = "render.json"
DEPTH: Final = "depth.npy"
MASK: Final = "contact_mask.png"
IMAGE_ENDINGS: Final = (".exr", ".npy", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")
#: A gel that is pressed in by less than this share of the greatest depth is taken for one that is not touched.
LEAST_DEPTH_SHARE: Final = 0.01


class RenderDescription(Model):
    """What a render's folder says of itself (render.json); what is left out is not known."""

    simulator: str = Field(default="a simulator without a name", description="program and version")
    encoding: Literal["linear", "encoded"] | None = Field(
        default=None, description="linear: proportional to light; encoded: as a camera's 8-bit images"
    )
    channels: Literal["RGB", "BGR"] | None = Field(default=None, description="order in npy files")
    command: str = ""
    seed: int | None = None
    samples: int | None = None
    seconds: Annotated[float, Field(ge=0.0)] | None = None
    mm_per_px: Annotated[float, Field(gt=0.0)] | None = None
    contact_circle: ContactCircle | None = None


def read_renders(folder: Path, captures: Mapping[str, TactileCapture] | None = None) -> dict[str, SimulatedPress]:
    """Read the folder of one press, or a folder that holds one for each press.

    Parameters
    ----------
    folder
        Holds contact and no_contact images, or folders that do.
    captures
        Press name -> its capture, whose circle or outline stands for what the folder says of the contact.

    Returns
    -------
    dict of str to SimulatedPress
        By name of the press.

    Raises
    ------
    ImportFormatError
        A file is missing or not what the layout says, or the two images differ in size or kind.
    """
    if not folder.is_dir():
        raise ImportFormatError(
            f"{folder}: {'is a file' if folder.exists() else 'no such folder'}; give a folder with {CONTACT}.png and "
            f"{NO_CONTACT}.png"
        )
    if _image_file(folder, CONTACT) is not None:
        folders = [folder]
    else:
        folders = sorted(inner for inner in folder.iterdir() if inner.is_dir() and _image_file(inner, CONTACT))
    if not folders:
        endings = ", ".join(IMAGE_ENDINGS)
        raise ImportFormatError(
            f"{folder}: contains no file {CONTACT} ({endings}), neither directly nor in a folder inside it; add the "
            f"image with contact, and the image {NO_CONTACT} beside it"
        )
    known, common = captures or {}, None if folders == [folder] else _image_file(folder, NO_CONTACT)
    unknown = [inner.resolve().name for inner in folders if inner.resolve().name not in known]
    if known and len(unknown) == len(folders):
        raise ImportFormatError(
            f"{folder}: no folder of a press (such as {unknown[0]}) has the name of a capture; name the folders like "
            f"the captures ({', '.join(list(known)[:3])}{(', ...' if len(known) > 3 else '')})"
        )
    return {inner.resolve().name: _press(inner, known.get(inner.resolve().name), common) for inner in folders}


def _image_file(folder: Path, stem: str) -> Path | None:
    """Return the image of a name, its ending in small or large letters."""
    endings = [e for small in IMAGE_ENDINGS for e in (small, small.upper())]
    return next((folder / f"{stem}{e}" for e in endings if (folder / f"{stem}{e}").is_file()), None)


def _press(folder: Path, capture: TactileCapture | None, common: Path | None) -> SimulatedPress:
    """Return one press; `common` is the image without contact of all presses, where there is one."""
    said = _description(folder / DESCRIPTION)
    contact_file, rest_file = _image_file(folder, CONTACT), _image_file(folder, NO_CONTACT) or common
    if contact_file is None or rest_file is None:
        raise ImportFormatError(
            f"{folder}: {NO_CONTACT} ({', '.join(IMAGE_ENDINGS)}) is missing beside {CONTACT}; render the untouched "
            "gel with the same settings, with a height of zero"
        )
    ending = contact_file.suffix.lower()
    if ending != rest_file.suffix.lower():
        raise ImportFormatError(
            f"{folder}: {contact_file.name} and {rest_file.name} have different formats; write both in the same format"
        )
    encoding = said.encoding or {".exr": "linear", ".npy": None}.get(ending, "encoded")
    if encoding is None:
        raise ImportFormatError(
            f'{folder}: the encoding is unknown, because npy files do not state it; write "encoding": "linear" '
            f'(proportional to light) or "encoded" (values of an 8-bit image) into {DESCRIPTION}'
        )
    depth = None if capture is None or capture.encoding == "linear" else capture.bit_depth
    contact, no_contact = _images(contact_file, rest_file, said.channels, depth)
    _require_sizes(folder, {contact_file.name: contact, rest_file.name: no_contact}, capture)
    distance, how = _distance(folder, contact.shape[:2], capture, said.contact_circle)
    notes = [f"imported from a folder of images, by {said.simulator}; its contact: {how}"]
    notes += [f"rendered by: {said.command}"] if said.command else []
    notes += (
        [] if said.samples is None else [f"{said.samples} samples per pixel: the render's noise stays in its errors"]
    )
    return SimulatedPress(
        name=folder.resolve().name,
        label=f"rendered, {said.simulator}",
        method="rendered",
        encoding="linear" if encoding == "linear" else "unknown",
        no_contact=no_contact.astype(np.float32),
        contact=contact.astype(np.float32),
        distance=distance.astype(np.float32),
        variance=None,
        light_angle_deg=None,
        design=None,
        notes=tuple(notes),
    )


def _require_sizes(folder: Path, images: Mapping[str, Floats], capture: TactileCapture | None) -> None:
    """Refuse two images of different sizes, or of another one than their capture is compared in."""
    (contact_name, contact), (rest_name, no_contact) = images.items()
    if contact.shape != no_contact.shape:
        raise ImportFormatError(
            f"{folder}: {contact_name} is {contact.shape[1]} x {contact.shape[0]} px, but {rest_name} is "
            f"{no_contact.shape[1]} x {no_contact.shape[0]} px; render both with one camera"
        )
    # a capture of Bayer counts is compared as a picture of half the side
    wanted = contact.shape if capture is None else rgb_image(capture.contact, capture).shape
    if capture is not None and contact.shape[:2] != wanted[:2]:
        sizes = [f"{shape[1]} x {shape[0]} px" for shape in (contact.shape, wanted)]
        raise ImportFormatError(
            f"{folder}: the images are {sizes[0]}, but the capture {capture.name} has {sizes[1]}; render as the "
            "camera sees it, with the same number of pixels and the same side up"
        )


def _description(path: Path) -> RenderDescription:
    """Return what render.json says; nothing where it is not there."""
    if not path.is_file():
        return RenderDescription()
    found = read_json(path, "the description of a render", ImportFormatError)
    try:
        return RenderDescription.model_validate(found)
    except ValidationError as error:
        raise ImportFormatError(f"{path}: {explain(error, RenderDescription)}") from None


def _images(contact: Path, rest: Path, channels: str | None, captured_bits: int | None) -> list[Floats]:
    """Return two images (H, W, 3) in RGB order; pictures in the steps of a capture of so many bits, else of 8 bits."""
    if contact.suffix.lower() in (".exr", ".npy"):
        return [_array(path, channels) for path in (contact, rest)]
    pictures = {path: pixels_of(path) for path in (contact, rest)}
    require_alike(pictures)
    return [_in_steps(in_colour(picture), path, captured_bits) for path, picture in pictures.items()]


def _in_steps(picture: NDArray[Any], path: Path, captured_bits: int | None) -> Floats:
    """Return a picture in the steps of a capture of so many bits, or of 8 bits."""
    if picture.dtype == np.uint16 and captured_bits in (None, 8):
        return np.asarray(picture / 257.0)  # 65535 is full scale, as 255 is
    if picture.dtype == np.uint8 and captured_bits not in (None, 8):
        raise ImportFormatError(
            f"{path}: has 8 bits, but the capture has {captured_bits}; write pictures of 16 bits on the scale of the "
            "capture's own image without contact"
        )
    return picture.astype(np.float64)


def _array(path: Path, channels: str | None) -> Floats:
    """Return an OpenEXR or npy image (H, W, 3) in RGB order."""
    if path.suffix.lower() == ".exr":
        return exr_rgb(path)
    array = read_npy(path, "an image (npy)", ImportFormatError).astype(np.float64)
    if array.ndim != 3 or array.shape[2] != 3 or not np.isfinite(array).all() or array.min(initial=0.0) < 0.0:
        raise ImportFormatError(
            f"{path}: expected finite numbers of at least 0 and shape (rows, columns, 3), got shape {array.shape}; "
            "correct the array"
        )
    if channels is None:
        raise ImportFormatError(
            f'{path}: the order of the channels is unknown, because npy files do not state it; write "channels": '
            '"RGB" or "BGR"'
        )
    return np.asarray(array[..., ::-1] if channels == "BGR" else array)


def _distance(
    folder: Path, shape: tuple[int, ...], capture: TactileCapture | None, of_render: ContactCircle | None
) -> tuple[Floats, str]:
    """Return the distance from the contact in half-widths, and what tells where the contact is."""
    of_capture = None if capture is None else contact_distance(capture)
    if capture is not None and of_capture is not None:
        return of_capture, f"the {'outline' if capture.contact_circle is None else 'circle'} of the capture"
    if of_render is not None:
        rows, columns = np.indices(shape[:2])
        away = np.hypot(rows - of_render.row_px, columns - of_render.column_px)
        return np.asarray(away / of_render.radius_px), f"the circle of {DESCRIPTION}"
    if (folder / DEPTH).is_file():
        depth = read_npy(folder / DEPTH, "a map of depths (npy)", ImportFormatError).astype(np.float64)
        if depth.shape != shape[:2] or not np.isfinite(depth).all() or not depth.max(initial=0.0) > 0.0:
            raise ImportFormatError(
                f"{folder / DEPTH}: expected finite depths in mm (positive into the gel) of shape ({shape[0]}, "
                f"{shape[1]}), some above 0, got shape {depth.shape}"
            )
        inside = depth > LEAST_DEPTH_SHARE * depth.max()
        return outline_distance(inside), f"where {DEPTH} exceeds {100 * LEAST_DEPTH_SHARE:.0f} % of its largest depth"
    if (folder / MASK).is_file():
        mask = read_picture(folder / MASK, "a mask (PNG)", ImportFormatError)
        touched: NDArray[np.bool_] = np.asarray(mask if mask.ndim == 2 else mask.max(axis=2)) > 0
        if touched.shape != shape[:2] or not touched.any():
            raise ImportFormatError(
                f"{folder / MASK}: must have the size of the images, with white pixels where the contact is"
            )
        return outline_distance(touched), f"the mask {MASK}"
    raise ImportFormatError(
        f"{folder}: the place of the contact is missing, but a score needs it; write {DEPTH} (mm, positive into the "
        f"gel), {MASK}, or contact_circle into {DESCRIPTION}, or give the capture with --capture"
    )


REQUEST: Final = "press.json"


def press_request(capture: TactileCapture, with_contact: bool) -> dict[str, bytes]:
    """Return the files that describe a press to a simulator: to render it, or with its contact image to learn from it.

    ``no_contact.png`` (8 or 16 bits, counts above the black level), ``contact.png`` where it is to be learnt from, and
    ``press.json`` with the contact (circle, or corners of its outline), the indenter, the scale and the encoding; what
    the capture does not know is null.

    Parameters
    ----------
    capture
        Of the press.
    with_contact
        Whether the contact image is among them.

    Raises
    ------
    ImportFormatError
        The capture holds Bayer counts, which simulators of colour images do not read.
    """
    if capture.layout != "RGB":
        raise ImportFormatError(
            f"{capture.name}: contains {capture.layout} counts, but simulators of colour images need a capture in RGB"
        )
    circle, outline = capture.contact_circle, capture.contact_outline
    told = {
        "name": capture.name,
        "contact_circle": None if circle is None else circle.model_dump(),
        "contact_outline": None if outline is None else [corner.model_dump() for corner in outline],
        "indenter": capture.indenter.model_dump(),
        "mm_per_px": capture.mm_per_px,
        "encoding": "linear" if capture.encoding == "linear" else "encoded",
        "bit_depth": capture.bit_depth,
        "force_n": capture.force_n,
    }
    images = {NO_CONTACT: capture.no_contact, **({CONTACT: capture.contact} if with_contact else {})}
    files = {f"{name}.png": _counts_png(counts, capture) for name, counts in images.items()}
    return {**files, REQUEST: (json.dumps(told, indent=1) + "\n").encode()}


def _counts_png(counts: NDArray[np.uint16], capture: TactileCapture) -> bytes:
    """Return counts above the black level as a PNG image of 8 or 16 bits."""
    above = np.maximum(counts.astype(np.int64) - round(capture.black_level_dn), 0)
    return png(above.astype(np.uint8) if capture.bit_depth == 8 else above.astype(np.uint16))
