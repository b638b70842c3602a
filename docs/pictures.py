"""Make pictures of docs/images anew, by the commands that their pages tell: ``make pictures``, some ten minutes.

    python -m docs.pictures [touch] [classic-sensors] [press-slide-twist] [grasp]

Those of the gallery and of the paper's experiments have commands of their own, see the Makefile. Denoised views are
for the eye only; nothing is measured in them.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import finray_calib as finray
from rigs import paint_plan, simulated_rig, write_plan, write_rig

IMAGES = Path(__file__).parent / "images"
BALL = """preset = "flat-70x35"
name = "ball"
schema_version = 1
[indenter]
shape = "ball"
radius_mm = 8.0
depth_mm = 2.0
position_mm = 32.0
"""
AMPLIFICATION = 2.5
PAD_ROWS, PAD_COLUMNS = slice(36, 204), slice(128, 320)  # of the half-size picture of the flat finger


def drawn(untouched: NDArray[np.uint8], touched: NDArray[np.uint8]) -> Figure:
    """Return both views, (H, W, 3), and their amplified difference about mid-grey."""
    change = np.clip(128.0 + AMPLIFICATION * (touched.astype(float) - untouched), 0, 255).astype(np.uint8)
    figure = Figure(figsize=(9.0, 2.9), dpi=120, layout="constrained")
    titles = ("untouched", "touched by a ball of 8 mm radius", f"what the touch changes, {AMPLIFICATION:g} times")
    for axes, image, title in zip(figure.subplots(1, 3), (untouched, touched, change), titles, strict=True):
        axes.imshow(image[PAD_ROWS, PAD_COLUMNS], interpolation="bicubic")
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    return figure


def view(file: Path) -> NDArray[np.uint8]:
    """Read a picture as RGB."""
    return np.asarray(cv2.imread(str(file))[..., ::-1])


def finray_command(folder: Path, line: str) -> None:
    """Run a line as typed behind ``finray``."""
    subprocess.run([sys.executable, "-m", "finray_calib.cli.main", *line.split()], cwd=folder, check=True)


def touch(folder: Path) -> None:
    """Calibrate two paints on the practice bench, and draw what a camera sees of a ball in the flat finger."""
    (folder / "ball.toml").write_text(BALL, encoding="utf-8")
    for paint in ("red", "green"):
        rig = simulated_rig(paint, width_px=640, height_px=512)
        write_rig(rig, folder / f"{paint}.rig.toml")
        write_plan(paint_plan(paint, rig.camera), folder / f"{paint}.plan.toml")
        finray.capture_session(folder / f"{paint}.plan.toml", folder / f"{paint}.rig.toml", folder / paint)
        finray.write_record(finray.fit_paint(finray.reduce_session(folder / paint)), folder / f"{paint}.json")
    finray_command(folder, "simulate render ball.toml --paint red=red.json --paint green=green.json --images --denoise")
    views = (view(folder / "ball.optics" / f"{state}-view-denoised.png") for state in ("no_contact", "contact"))
    drawn(*views).savefig(IMAGES / "touch.png")


SENSORS = ("gelsight-flat", "digit", "9dtact", "gelsight-wedge")
TILE_PX, GAP_PX = 180, 4


def classic_sensors(folder: Path) -> None:
    """Render the ready-made sensors, and put contact above what it changes."""
    columns = []
    for sensor in SENSORS:
        finray_command(folder, f"design init {sensor}")
        finray_command(folder, f"simulate render {sensor}.toml --images")
        tiles = [view(folder / f"{sensor}.optics" / f"{name}-view.png") for name in ("contact", "change")]
        width_px = round(TILE_PX * tiles[0].shape[1] / tiles[0].shape[0])
        small = [cv2.resize(tile, (width_px, TILE_PX), interpolation=cv2.INTER_AREA) for tile in tiles]
        column = np.vstack([small[0], np.full((GAP_PX, width_px, 3), 255), small[1]])
        columns += [column, np.full((len(column), GAP_PX, 3), 255)]
    cv2.imwrite(str(IMAGES / "classic-sensors.png"), np.hstack(columns[:-1]).astype(np.uint8)[..., ::-1])


SLIDE = """preset = "baby-48x18"
name = "slide"
schema_version = 1
[indenter]
shape = "ball"
radius_mm = 20.0
depth_mm = 1.5
position_mm = 24.0
friction = 0.5
"""
PATH = """across_mm,push_mm,along_mm,turn_y_deg,increments
0,1.5,0,0,1
0,1.5,1.2,0,3
0,1.5,1.2,25,2
0,-0.3,1.2,25,1
"""


def press_slide_twist(folder: Path) -> None:
    """Press a large ball in, drag it, turn it and release it."""
    (folder / "slide.toml").write_text(SLIDE, encoding="utf-8")
    (folder / "path.csv").write_text(PATH, encoding="utf-8")
    finray_command(folder, "simulate press slide.toml --path path.csv")
    shutil.copy(folder / "slide.mechanics.png", IMAGES / "press-slide-twist.png")


def grasp(folder: Path) -> None:
    """Let two fingers close on a ball and carry it."""
    ball = SLIDE.replace('"slide"', '"ball"').replace("radius_mm = 20.0", "radius_mm = 10.0")
    (folder / "ball.toml").write_text(ball, encoding="utf-8")
    finray_command(folder, "simulate grasp ball.toml --force 2 --mass 0.05")
    shutil.copy(folder / "ball.grasp.png", IMAGES / "grasp.png")


PICTURES = {
    "touch": touch,
    "classic-sensors": classic_sensors,
    "press-slide-twist": press_slide_twist,
    "grasp": grasp,
}


def main() -> None:
    """Make the pictures that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", nargs="*", choices=[*PICTURES, []], default=[])
    for name in parser.parse_args().pictures or PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            PICTURES[name](Path(folder))


if __name__ == "__main__":
    main()
