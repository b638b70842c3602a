"""Folders of band images whose every signal is known: uniform light on a small sensor, no noise."""

from pathlib import Path

import numpy as np
import tifffile

SIDE_PX = 48
BLACK_DN = 20.0
EXPOSURE_S = 0.5
FILTERS = ("450", "500", "560", "600", "660")
CENTER_NM = np.array([450.0, 500.0, 560.0, 600.0, 660.0])
# DN per second of (filter, channel red green blue), and what the paint returns of it.
WHITE = np.array([[600, 1800, 9000], [1000, 6000, 4000], [3000, 9000, 900], [9000, 4000, 700], [8000, 1600, 600.0]])
REFLECTANCE = np.array([0.05, 0.06, 0.2, 0.5, 0.8])
FLUORESCENCE = np.array([0.08, 0.01, 0.3, 0.6, 0.2])
LEVEL = 0.9
WHITE_TILE = 0.98

TOML = """\
paint_name = "orange"
excitation_filter = "450"
region = {{ row_px = 4, column_px = 4, height_px = 40, width_px = 40 }}

[camera]
encoding = "linear"
layout = "{layout}"
bit_depth = 14
gain_e_per_dn = 1.0
read_noise_e = 3.0
black_level_dn = 20
black_level_uncertainty_dn = 0.1

{filters}
[files]
white = "white/{{filter}}nm.tif"
reflectance = "lamp/{{filter}}nm.tif"
fluorescence = "laser/{{filter}}nm.tif"
laser_white = "laser_white.tif"

[exposure_s]
white = {exposure_s}
reflectance = {exposure_s}
fluorescence = {exposure_s}
laser_white = {exposure_s}
"""
FILTER = '[[filters]]\nname = "{0}"\ncenter_nm = {0}\nfwhm_nm = 10\nblocking_od = 5\n\n'


def frame(dn_per_s, layout: str, exposure_s: float = EXPOSURE_S) -> np.ndarray:
    """Expose (3,) channels, or one of a monochrome camera, in the layout of the file."""
    counts = np.rint(np.asarray(dn_per_s) * exposure_s + BLACK_DN).astype(np.uint16)
    if layout == "monochrome":
        return np.full((SIDE_PX, SIDE_PX), counts[1], np.uint16)
    if layout == "RGB":
        return np.broadcast_to(counts, (SIDE_PX, SIDE_PX, 3)).copy()
    image = np.empty((SIDE_PX, SIDE_PX), np.uint16)
    for site, letter in enumerate(layout.removeprefix("Bayer ")):
        image[site // 2 :: 2, site % 2 :: 2] = counts["RGB".index(letter)]
    return image


def write_folder(folder: Path, layout: str, fluorescence=FLUORESCENCE, white=WHITE) -> Path:
    """Write images and bands.toml."""
    for name in ("white", "lamp", "laser"):
        (folder / name).mkdir(parents=True)
    for b, name in enumerate(FILTERS):
        for kind, signal in (
            ("white", white[b]),
            ("lamp", white[b] * REFLECTANCE[b] / WHITE_TILE),
            ("laser", white[b] * fluorescence[b] * LEVEL),
        ):
            tifffile.imwrite(folder / kind / f"{name}nm.tif", frame(signal, layout))
    tifffile.imwrite(folder / "laser_white.tif", frame(white[0] * LEVEL, layout))
    filters = "".join(FILTER.format(name) for name in FILTERS)
    (folder / "bands.toml").write_text(TOML.format(layout=layout, filters=filters, exposure_s=EXPOSURE_S))
    return folder


def edit(folder: Path, old: str, new: str) -> None:
    """Replace a text that stands in bands.toml."""
    file = folder / "bands.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
