"""Small folders of the layouts that recipes read, made of the sensor of closed form."""

import csv
import struct

import cv2
import numpy as np

from tests.compare.three_lights import dent_slopes, shaded
from tests.exchange.ball_press_folders import eight_bits

SHAPE_PX = (120, 160)
BALL_PX, CONTACT_PX = 46.0, 20.0
PLACES = [(60.0, 80.0), (45.0, 60.0), (70.0, 100.0), (50.0, 95.0), (75.0, 65.0)]


def dome(row_px, column_px, radius_px=CONTACT_PX, shape=SHAPE_PX):
    """An image (H, W, 3) of a ball of 46 px pressed in; its grey shading needs no lights' place."""
    return shaded(dent_slopes(row_px, column_px, radius_px, BALL_PX, shape))


def soft_dome(row_px, column_px, rng, radius_px=CONTACT_PX, shape=SHAPE_PX):
    """The same with a gel that is drawn in around the contact, rough inside it, and a camera of 1 DN noise."""
    rows, columns = np.indices(shape, dtype=float)
    along, down = columns - column_px, rows - row_px
    away = np.hypot(along, down) + 1e-9
    steep = np.where(away <= radius_px, away, radius_px * np.exp(-2.0 * (away / radius_px - 1.0))) / BALL_PX
    slopes = cv2.GaussianBlur(np.stack([-along / away * steep, -down / away * steep], axis=-1), (0, 0), 1.0)
    rough = 0.1 * cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 1.5) * (away < radius_px)
    return shaded(slopes) * (1.0 + rough[..., None]) + rng.standard_normal((*shape, 3))


def flat(shape=SHAPE_PX):
    """The untouched gel."""
    return shaded(np.zeros((*shape, 2)))


def save(path, image):
    """Write an RGB image, with the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.ascontiguousarray(eight_bits(image)[..., ::-1]))


def write_fots(folder):
    """Presses beside their background, with circles in a table of another machine's paths."""
    save(folder / "mlp_calib" / "0000.png", flat())
    rows = [["img_names", "center_x", "center_y", "radius"]]
    for k, (row, column) in enumerate(PLACES, start=1):
        save(folder / "mlp_calib" / "gelsight" / f"{k:04d}.png", dome(row, column))
        rows.append([f"C:/else/where/gelsight/{k:04d}.png", int(column), int(row), int(CONTACT_PX)])
    table = folder / "mlp_calib" / "csv" / "annotate.csv"
    table.parent.mkdir()
    with table.open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    return folder


def write_digit(folder):
    """Presses without circles and without an image of the untouched gel."""
    rng = np.random.default_rng(1)
    for k, (row, column) in enumerate([*PLACES, (95.0, 130.0), (25.0, 30.0), (30.0, 130.0), (90.0, 30.0)]):
        save(folder / "mlp_calib" / "digit" / f"{k:04d}.png", soft_dome(row, column, rng))
    return folder


def write_edges(folder, labelled=2):
    """Presses of an edge, with rectangles of its faces in npz files."""
    save(folder / "sensor_images" / "background.png", flat())
    for k in range(3):
        inner = folder / "sensor_images" / "10.000x10.000mm" / str(k)
        image = flat()
        image[50:60, 30 : 30 + 100] *= [1.4, 0.7, 1.0]
        image[60:68, 30 : 30 + 100] *= [0.6, 1.2, 1.1]
        save(inner / "gelsight.png", image)
        if k < labelled:
            np.savez(
                inner / "label.npz",
                line_length=100,
                rect1=[[30, 50], [130, 50], [130, 60], [30, 60]],
                rect2=[[30, 60], [130, 60], [130, 68], [30, 68]],
            )
    return folder


def write_balls(folder):
    """The layout of gs_sdk: a folder for each press, and a catalog with the ball's diameter."""
    save(folder / "background.png", flat())
    rows = [["experiment_reldir", "diameter(mm)"]]
    for k, (row, column) in enumerate(PLACES[:2]):
        save(folder / "6.000mm" / str(k) / "gelsight.png", dome(row, column))
        np.savez(folder / "6.000mm" / str(k) / "label.npz", center=[column, row], radius=CONTACT_PX)
        rows.append([f"6.000mm/{k}", "6.000"])
    with (folder / "catalog.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    return folder


def write_video(path, frames):
    """A Motion-JPEG video as OpenCV lays it out: headers, then a list of frames."""
    chunks = b""
    for frame in frames:
        jpeg = cv2.imencode(".jpg", eight_bits(frame)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 97])[1].tobytes()
        chunks += b"00dc" + struct.pack("<I", len(jpeg)) + jpeg + b"\0" * (len(jpeg) % 2)
    movie = b"LIST" + struct.pack("<I", len(chunks) + 4) + b"movi" + chunks
    header = b"LIST" + struct.pack("<I", 4) + b"hdrl"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"RIFF" + struct.pack("<I", len(header) + len(movie) + 4) + b"AVI " + header + movie)


def grasp(frames=30, before=12):
    """Frames of a grasp: nothing, then a ball that is held, then nothing again."""
    depth = np.interp(np.arange(frames), [before, before + 4, frames - 6, frames - 2], [0.0, 1.0, 1.0, 0.0])
    return [dome(60.0, 80.0, max(1.0, CONTACT_PX * d)) if d > 0.0 else flat() for d in depth]


BALLS = """\
name = "mine"
what = "presses of a ball"

[presses]
files = "{press}.png"

[no_contact]
file = "rest.png"

[contact]
file = "labels.csv"
press = "image"
circle = { column_px = "x", row_px = "y", radius_px = "r" }

[scale]
px_per_mm = 10.0

[indenter]
shape = "ball"
diameter_mm = 9.2
"""


def write_lab(folder, names=("p0", "p1", "p2", "p3"), columns=None):
    """What a lab has: presses of a ball of 9.2 mm at 0.1 mm a pixel, one image without contact, labels by hand."""
    rng = np.random.default_rng(3)
    noise = [rng.standard_normal((*SHAPE_PX, 3)) for _ in range(len(names) + 1)]
    save(folder / "rest.png", flat() + noise[-1])
    more = columns or {}
    rows = [["image", "x", "y", "r", *more]]
    for k, (name, (row, column)) in enumerate(zip(names, PLACES, strict=False)):
        save(folder / f"{name}.png", dome(row, column) + noise[k])
        rows.append([f"{name}.png", int(column), int(row), int(CONTACT_PX), *more.values()])
    with (folder / "labels.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    return folder


def repicture(folder, change, which="*.png", ending=".png"):
    """Write pictures of a folder anew, as `change` makes them: (H, W, 3) in, an array or bytes out."""
    for path in sorted(folder.glob(which)):
        changed = change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
        path.unlink()
        path = path.with_suffix(ending)
        path.write_bytes(changed if isinstance(changed, bytes) else cv2.imencode(ending, changed)[1].tobytes())
    return folder


def turned_jpeg(image, turned):
    """A JPEG with the mark of a camera (EXIF) that it is to be shown turned."""
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    tags = b"\0\1" + struct.pack(">HHIHH", 0x0112, 3, 1, turned, 0) + b"\0\0\0\0"
    exif = b"Exif\0\0MM\0*\0\0\0\x08" + tags
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
