"""Make docs/images/touch.png, what the camera of a finger sees of a touch: ``make pictures``, some minutes.

Two paints are calibrated on the practice bench, a ball is pressed into the flat finger, and the denoised views of the
render are drawn side by side. The denoised views are for the eye only; nothing is measured in them.
"""

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

PICTURE = Path(__file__).parent / "images" / "touch.png"
DESIGN = """preset = "flat-70x35"
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


def main() -> None:
    """Calibrate, render, draw."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "ball.toml").write_text(DESIGN, encoding="utf-8")
        for paint in ("red", "green"):
            rig = simulated_rig(paint, width_px=640, height_px=512)
            write_rig(rig, folder / f"{paint}.rig.toml")
            write_plan(paint_plan(paint, rig.camera), folder / f"{paint}.plan.toml")
            finray.capture_session(folder / f"{paint}.plan.toml", folder / f"{paint}.rig.toml", folder / paint)
            finray.write_record(finray.fit_paint(finray.reduce_session(folder / paint)), folder / f"{paint}.json")
        render = "simulate render ball.toml --paint red=red.json --paint green=green.json --images --denoise"
        program = [sys.executable, "-m", "finray_calib.cli.main", *render.split(), "--out", "ball.press.json"]
        subprocess.run(program, cwd=folder, check=True)
        views = (view(folder / "ball.optics" / f"{state}-view-denoised.png") for state in ("no_contact", "contact"))
        drawn(*views).savefig(PICTURE)


if __name__ == "__main__":
    main()
