"""A sensor whose layers are formulas, with the noise of a render: hidden sensors cost nothing, and the truth is known.

Three lights shine from three sides on a gel with soft dark spots, into which a ball is pressed.
"""

from dataclasses import dataclass

import numpy as np

from data_schemas import CameraBelow, IndenterPose, PlainSensor, TactileCapture
from finray_calib.fit import placed_picture
from sim.experiments import FreeParameter, Layers

ROWS, COLUMNS = 48, 64
SIDES_DEG = (0.0, 120.0, 240.0)
DESIGN = PlainSensor(name="drawn", camera=CameraBelow(width_px=COLUMNS, height_px=ROWS))
BLACK_DN, FULL_BITS = 64.0, 12
DEPTH_U_MM, POSITION_U_MM = 0.05, 0.3


@dataclass(frozen=True)
class DrawnSensor:
    """Layers by formula; ``noise_rel`` is that of a pixel, the same random numbers for every design of one seed."""

    design: PlainSensor = DESIGN
    seed: int = 1
    noise_rel: float = 0.1
    label: str = "drawn"

    @property
    def layer_numbers(self):
        return tuple(
            FreeParameter(f"lights.{k}.power_rel", 1.0, 0.2, True, "assumed", "layer") for k in range(len(SIDES_DEG))
        )

    @property
    def layer_names(self):
        return tuple(f"light {k + 1}" for k in range(len(SIDES_DEG)))

    def mix(self, factors):
        return np.diag([factors.get(f"lights.{k}.power_rel", 1.0) for k in range(len(SIDES_DEG))])

    def layers(self, presses):
        """Return what the formulas give, with noise."""
        states = [formula(presses[0], False), *(formula(press, True) for press in presses)]
        means = np.array(states)
        halves = []
        for half in range(2):
            drawn = [
                np.random.default_rng([self.seed, half, k]).standard_normal(means[0].shape) for k in range(len(states))
            ]
            halves.append(means * (1.0 + np.sqrt(2.0) * self.noise_rel * np.array(drawn)))
        both = np.stack([(halves[0] + halves[1]) / 2.0, (halves[0] - halves[1]) / 2.0])
        return Layers(both, np.ones((ROWS, COLUMNS), dtype=np.bool_))


def formula(design, pressed):
    """Return the picture of each light, (3, row, column)."""
    z, x = np.meshgrid(np.linspace(20.0, 0.0, ROWS), np.linspace(-13.0, 13.0, COLUMNS), indexing="ij")
    thickness, depth, place = design.pad.thickness_mm, design.indenter.depth_mm, design.indenter.position_mm
    # a thicker gel is seen larger and lets the light farther in
    larger = 1.0 + 0.3 * (thickness / 4.0 - 1.0)
    x, z = x * larger, 10.0 + (z - 10.0) * larger
    radius2 = (x - design.indenter.across_mm) ** 2 + (z - place) ** 2
    hole = (depth if pressed else 0.0) * np.exp(-0.5 * radius2 / 1.5**2)
    slope_x, slope_z = hole * (x - design.indenter.across_mm) / 1.5**2, hole * (z - place) / 1.5**2
    dots = 1.0 - 0.5 * np.exp(-4.0 * (np.sin(np.pi * x / 9.0) ** 2 + np.sin(np.pi * z / 9.0) ** 2))
    pictures = []
    for side in np.radians(SIDES_DEG):
        inwards = x * np.sin(side) + (z - 10.0) * np.cos(side)
        fall = np.exp(-(inwards + 15.0) / (4.0 * thickness))
        facing = np.maximum(1.0 + 1.5 * (slope_x * np.sin(side) + slope_z * np.cos(side)), 0.05)
        pictures.append(fall * facing * dots)
    return np.array(pictures)


def captured(pictures, rng, name="hidden"):
    """Return a capture of pictures (2, 3, row, column) in DN, with a camera's noise."""

    def expose(picture):
        seen = rng.poisson(4.0 * np.maximum(picture, 0.0)) / 4.0 + rng.normal(0.0, 1.0, picture.shape)
        return np.clip(np.round(np.moveaxis(seen, 0, -1) + BLACK_DN), 0, 2**FULL_BITS - 1).astype(np.uint16)

    indenter = DESIGN.indenter
    return TactileCapture(
        name=name, contact=expose(pictures[1]), no_contact=expose(pictures[0]), repeat_no_contact=expose(pictures[0]),
        layout="RGB", encoding="linear", bit_depth=FULL_BITS, black_level_dn=BLACK_DN, exposure_s=0.01,
        light_angle_deg=None, contact_circle=None, mm_per_px=None, source="drawn",
        indenter=IndenterPose(
            shape=indenter.shape, radius_mm=indenter.radius_mm, depth_mm=indenter.depth_mm,
            position_mm=indenter.position_mm, depth_uncertainty_mm=DEPTH_U_MM, position_uncertainty_mm=POSITION_U_MM,
        ),
    )  # fmt: skip


def hidden_sensor(number, noise_rel=0.0, discrepancy=None):
    """Return the numbers of a sensor drawn from the prior, by name, and a capture of it."""
    rng = np.random.default_rng([41, number])
    truth = {f"lights.{k}.power_rel": float(np.exp(0.2 * rng.standard_normal())) for k in range(3)}
    truth["pad.thickness_mm"] = DESIGN.pad.thickness_mm * float(np.exp(0.1 * rng.standard_normal()))
    truth["press.0.depth_mm"] = DESIGN.indenter.depth_mm + DEPTH_U_MM * rng.standard_normal()
    truth["press.0.position_mm"] = DESIGN.indenter.position_mm + POSITION_U_MM * rng.standard_normal()
    truth["picture.gain"] = 1500.0 * float(np.exp(rng.uniform(-0.5, 0.5)))
    for name in ("rows", "columns"):
        truth[f"picture.shift_{name}_px"] = 0.01 * COLUMNS * rng.standard_normal()
    truth["picture.scale"] = float(np.exp(0.01 * rng.standard_normal()))
    truth["picture.blur_px"] = 0.7 * float(np.exp(0.5 * rng.standard_normal()))
    indenter = {"depth_mm": truth["press.0.depth_mm"], "position_mm": truth["press.0.position_mm"]}
    built = DESIGN.model_copy(
        update={
            "pad": DESIGN.pad.model_copy(update={"thickness_mm": truth["pad.thickness_mm"]}),
            "indenter": DESIGN.indenter.model_copy(update=indenter),
        }
    )
    layers = DrawnSensor(built, 1000 + number, noise_rel).layers([built]).pictures[0]
    powers = np.array([truth[f"lights.{k}.power_rel"] for k in range(3)])
    pictures = truth["picture.gain"] * powers[:, None, None] * layers
    if discrepancy is not None:
        pictures = pictures * discrepancy
    names = ("shift_rows_px", "shift_columns_px", "scale", "blur_px")
    moves = [truth[f"picture.{name}"] for name in names]
    seen = [[placed_picture(one, *moves) for one in state] for state in pictures]
    return truth, captured(np.array(seen), rng)
