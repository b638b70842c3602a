"""Folders of ball presses as other labs keep them, made of the sensor of closed form."""

import csv
import json
import pickle
from pathlib import Path

import cv2
import numpy as np

from tests.compare.three_lights import BALL_PX, SHAPE_PX, ball_press, ball_presses

MM_PER_PX = 0.1
BALL_DIAMETER_MM = 2.0 * BALL_PX * MM_PER_PX


class Trap:
    """Creates a file as soon as it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def presses(count):
    """Presses with images of whole DN."""
    return ball_presses(count, noise_dn=0.3)


def eight_bits(image):
    """RGB of 8 bits."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def write_taxim(folder, count=12, trap=None, **changed):
    """A Taxim calibration folder; `trap` is a file that only unpickling creates."""
    folder.mkdir()
    made = presses(count)
    no_contact = ball_press(30.0, 40.0, 10.0).no_contact
    arrays = {
        "f0": eight_bits(no_contact)[..., ::-1],
        "imgs": np.stack([eight_bits(p.contact)[..., ::-1] for p in made]),
        "touch_center": np.array([[p.column_px, p.row_px] for p in made]),
        "touch_radius": np.array([p.radius_px for p in made]),
        "img_size": np.array([*SHAPE_PX, 3]),
    }
    if trap is not None:
        arrays["names"] = np.array([Trap(trap)], dtype=object)
        (folder / "shadowTable.npz").write_bytes(pickle.dumps(Trap(trap)))
    arrays = {name: value for name, value in (arrays | changed).items() if value is not None}
    np.savez(folder / "dataPack.npz", allow_pickle=True, **arrays)
    np.savez(folder / "polycalib.npz", bins=125)
    (folder / "params.json").write_text(json.dumps({"simulator": {}, "sensor": {"pixmm": MM_PER_PX}}))
    return folder


def write_catalog(folder, count=3, labelled=None, diameters=True):
    """A folder as gs_sdk keeps it; of the presses the first `labelled` have circles."""
    folder.mkdir()
    save(folder / "background.png", ball_press(30.0, 40.0, 10.0).no_contact)
    rows = []
    for k, press in enumerate(presses(count)):
        inner = folder / "4.000mm" / str(k)
        inner.mkdir(parents=True)
        save(inner / "gelsight.png", press.contact)
        if labelled is None or k < labelled:
            np.savez(inner / "label.npz", center=[press.column_px, press.row_px], radius=press.radius_px)
        # catalogs written on Windows have backslashes
        rows.append([f"4.000mm\\{k}" if k == 1 else f"4.000mm/{k}", f"{BALL_DIAMETER_MM:.3f}"])
    with (folder / "catalog.csv").open("w", newline="") as file:
        header = ["experiment_reldir", "diameter(mm)"]
        csv.writer(file).writerows([header, *rows] if diameters else [header[:1], *(r[:1] for r in rows)])
    return folder


def write_circles(folder, count=2):
    """Plain images with a list of circles."""
    folder.mkdir()
    save(folder / "background.png", ball_press(30.0, 40.0, 10.0).no_contact)
    lines = ["image,column_px,row_px,radius_px"]
    for k, press in enumerate(presses(count)):
        save(folder / f"{k}.png", press.contact)
        lines.append(f"{k}.png,{press.column_px},{press.row_px},{press.radius_px}")
    (folder / "circles.csv").write_text("\n".join(lines) + "\n")
    return folder


def save(path, image):
    """Write an RGB image."""
    assert cv2.imwrite(str(path), eight_bits(image)[..., ::-1])
