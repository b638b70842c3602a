"""A simulator of forty lines for ``finray bench tactile``: a rigid ball, and light that follows the normal of the gel.

    finray bench tactile CAPTURES --simulator "rigid ball" \
        --command "python examples/tactile-bench/rigid_ball.py {teach} {judge} {renders}"

What a touch changes, relative to the image without contact, is a polynomial of second degree in the slopes of the ball,
fitted to the training presses inside their circles. Outside the circle nothing changes: it knows no halo.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np


def read(folder):
    """Return image without contact, slopes of the ball (rows, columns, 5) and where it touches."""
    told = json.loads((folder / "press.json").read_text())
    circle, radius_mm = told["contact_circle"], told["indenter"]["radius_mm"]
    rest = cv2.imread(str(folder / "no_contact.png")).astype(float)
    rows, columns = np.indices(rest.shape[:2])
    along, down = columns - circle["column_px"], rows - circle["row_px"]
    away = np.hypot(along, down)
    height = np.sqrt(np.maximum((radius_mm / told["mm_per_px"]) ** 2 - away**2, 1.0))
    x, y = along / height, down / height
    return rest, np.stack([x, y, x * x, x * y, y * y], axis=-1), away <= circle["radius_px"]


def main():
    """Learn from the training presses, and render the judged ones."""
    teach, judge, renders = map(Path, sys.argv[1:4])
    terms, changes = [], []
    for folder in sorted(teach.iterdir()):
        rest, slopes, touched = read(folder)
        contact = cv2.imread(str(folder / "contact.png")).astype(float)
        terms.append(slopes[touched])
        changes.append((contact / np.maximum(rest, 1.0) - 1.0)[touched])
    law = np.linalg.lstsq(np.concatenate(terms), np.concatenate(changes), rcond=None)[0]
    for folder in sorted(judge.iterdir()):
        rest, slopes, touched = read(folder)
        contact = np.where(touched[..., None], rest * (1.0 + slopes @ law), rest)
        out = renders / folder.name
        out.mkdir(parents=True)
        for name, image in (("contact", contact), ("no_contact", rest)):
            cv2.imwrite(str(out / f"{name}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))
        (out / "render.json").write_text(json.dumps({"simulator": "rigid ball, light by slope"}))


if __name__ == "__main__":
    main()
