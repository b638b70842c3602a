"""Run by the interpreter that has Taxim's port: render ball presses with a calibration folder. Arguments: folder, file.

The file (npz) holds row, column (px), depth_mm and ball_mm; the pictures go into file + ".png.npy".
"""

import sys
from pathlib import Path

import numpy as np
from taxim import Taxim

folder, file = Path(sys.argv[1]), Path(sys.argv[2])
taxim = Taxim(calib_folder=folder, backend="jax", device="cpu")
scale = taxim.sensor_params.pixmm
wanted = np.load(file)
rows, columns = np.indices((taxim.height, taxim.width))
pictures = []
for row, column, depth_mm in zip(wanted["row"], wanted["column"], wanted["depth_mm"], strict=True):
    offset = np.hypot(rows - row, columns - column) * scale
    ball = float(wanted["ball_mm"])
    # Taxim: distance of the object above the gel, below zero where it is pressed in
    below = np.where(offset < ball, ball - np.sqrt(np.maximum(ball**2 - offset**2, 0.0)) - depth_mm, ball)
    pictures.append(np.array(taxim.render(below.astype(np.float32), with_shadow=True)))
np.save(str(file) + ".pictures.npy", np.stack(pictures))
