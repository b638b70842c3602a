"""Whether intervals of ``finray simulate fit`` hold on sensors whose numbers are hidden.

    python -m benchmarks.hidden_sensors [--drawn 40] [--uneven 10] [--rendered 16] [--first 0]

Drawn sensors are formulas with the noise of a render (tests/simulate/drawn_sensor.py); uneven ones have vignetting of
10 to 40 % and slopes of one channel up to 15 %, which the model does not have. Rendered ones are the default finger at
80 x 60 pixels with other random numbers than the model's; yields, responses, gain and the picture's place are hidden.
Four renders of the model serve them by turns: the noise of one would move all fits the same way. --first begins the
rendered ones at another number: those from 0 to 15 were looked at when the fit was made.
Bar: 0.90 to 0.98 of 95 % intervals hold; of uneven ones the share is told.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.fluorescence_levels import paints
from data_schemas import FingerDesign, SensorFit
from finray_calib.fit import placed_picture
from sim.experiments import FingerLayers, fit_sensor, paint_finger
from sim.optics import choose_variant, open_renderer
from tests.simulate.drawn_sensor import COLUMNS, ROWS, DrawnSensor, captured, hidden_sensor

LEAST, MOST = 0.90, 0.98
NOISE_REL = 0.05
MODEL_SAMPLES, TRUTH_SAMPLES, MODELS = 512, 64, 4


def drawn(number: int, is_uneven: bool) -> tuple[dict[str, float], SensorFit]:
    """Return truth and fit of a sensor by formula."""
    error = None
    if is_uneven:
        rng = np.random.default_rng([9, number])
        row, column = np.mgrid[:ROWS, :COLUMNS]
        away = ((row / ROWS - 0.5) ** 2 + (column / COLUMNS - 0.5) ** 2) / 0.5
        slopes = 1.0 + rng.uniform(-0.15, 0.15, (3, 1, 1)) * (column / COLUMNS - 0.5) * 2.0
        error = (1.0 - rng.uniform(0.1, 0.4) * away) * slopes
    truth, capture = hidden_sensor(number, NOISE_REL, error)
    return truth, fit_sensor(DrawnSensor(noise_rel=NOISE_REL), [capture], ["pad.thickness_mm"], seed=number)


class _Once:
    """A scene that is rendered once."""

    def __init__(self, scene: FingerLayers) -> None:
        self._scene, self._layers = scene, None

    def __getattr__(self, name: str):
        return getattr(self._scene, name)

    def layers(self, presses):
        """Return the layers of the only set of presses."""
        self._layers = self._layers or self._scene.layers(presses)
        return self._layers


def rendered(count: int, first: int) -> list[tuple[dict[str, float], SensorFit]]:
    """Return truth and fit of rendered fingers, from a number on."""
    design = FingerDesign()
    camera = design.camera.model_copy(update={"width_px": 160, "height_px": 120})
    design = design.model_copy(update={"camera": camera})
    renderer = open_renderer(choose_variant("llvm"))
    finger = paint_finger(design, paints(), Path(), renderer)
    models = [_Once(FingerLayers(finger, seed=1 + first + k, samples=MODEL_SAMPLES)) for k in range(min(MODELS, count))]
    found = []
    for number in range(first, first + count):
        model = models[number % len(models)]
        rng = np.random.default_rng([7, number])
        factors = {n.name: float(n.at(rng.standard_normal())) for n in model.layer_numbers}
        places = (*0.8 * rng.standard_normal(2), np.exp(0.01 * rng.standard_normal()))
        moves = (*places, 0.7 * np.exp(0.5 * rng.standard_normal()))
        layers = FingerLayers(finger, seed=1000 + number, samples=TRUTH_SAMPLES).layers([design]).pictures[0]
        light = np.einsum("cl,slij->scij", model.mix(factors), layers)
        gain = 1500.0 / np.percentile(light, 98.0) * np.exp(rng.uniform(-0.5, 0.5))
        seen = [[placed_picture(one, *moves) for one in state] for state in gain * light]
        names = ("shift_rows_px", "shift_columns_px", "scale", "blur_px", "gain")
        truth = factors | {f"picture.{name}": float(v) for name, v in zip(names, (*moves, gain), strict=True)}
        capture = captured(np.array(seen), rng)
        pose = capture.indenter.model_copy(
            update={
                "shape": design.indenter.shape, "radius_mm": design.indenter.radius_mm,
                "depth_mm": design.indenter.depth_mm, "position_mm": design.indenter.position_mm,
                "depth_uncertainty_mm": None, "position_uncertainty_mm": None,
            }
        )  # fmt: skip
        found.append((truth, fit_sensor(model, [capture.model_copy(update={"indenter": pose})], seed=number)))
    return found


def share(what: str, fits: list[tuple[dict[str, float], SensorFit]]) -> float:
    """Print and return how many intervals hold; those of numbers that renders are too noisy for count apart."""
    inside = defaultdict(list)
    for truth, fit in fits:
        for n in fit.numbers:
            key = f"{n.name}, too noisy" if "noisy" in n.verdict else n.name
            inside[key].append(n.posterior.low95 <= truth[n.name] <= n.posterior.high95)
    for name, of in inside.items():
        print(f"  {name:50s} {np.mean(of):.2f} of {len(of)}")
    judged = [is_in for name, of in inside.items() if not name.endswith("too noisy") for is_in in of]
    trusted = sum(fit.trusted for _, fit in fits)
    print(f"{what}: {np.mean(judged):.3f} of {len(judged)} intervals hold; {trusted} of {len(fits)} fits trusted")
    return float(np.mean(judged))


def main() -> None:
    """Print the shares and leave 1 where one is outside the bar."""
    parser = argparse.ArgumentParser()
    for name, default in (("drawn", 40), ("uneven", 10), ("rendered", 16), ("first", 0)):
        parser.add_argument(f"--{name}", type=int, default=default)
    args = parser.parse_args()
    judged = []
    if args.drawn:
        judged.append(share("drawn", [drawn(k, False) for k in range(args.drawn)]))
    if args.uneven:
        share("uneven", [drawn(k, True) for k in range(args.uneven)])
    if args.rendered:
        judged.append(share("rendered", rendered(args.rendered, args.first)))
    raise SystemExit(0 if all(LEAST <= one <= MOST for one in judged) else 1)


if __name__ == "__main__":
    main()
