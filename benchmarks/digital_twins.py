"""Do the stated intervals of the photometric error hold? Captures of fingers that the simulation does not know.

    python benchmarks/digital_twins.py [--fingers 20] [--paints-each 3] [--samples-per-pixel 1024] [--out FILE]

Each hidden finger has a light a few degrees off, another coating, and a press whose pose is off by what the capture
states. Its paints and camera are draws of what the simulation knows about them. The capture goes through the sensor,
with drift of the LED. What an interval must hold is the metric between the noise-free capture and the noise-free render
with the true paints, camera and pose, and the nominal light and coating. Bar: 95 % intervals hold it in 52 to 60 of 60.
"""

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, PhotometricErrorReport, SimulatedPress, TactileCapture
from finray_calib.compare import DILATED, Region, compare_press, strip_from_distance
from finray_calib.compare._comparison import prepare_comparison
from finray_calib.compare._image_noise import NO_NOISE, block_mean
from finray_calib.compare._input_draws import Inputs
from finray_calib.compare._photometric_error import best, brightness_draws, captured_share, ring_of
from finray_calib.compare._region_sums import Captured, RenderLayers
from finray_calib.compare._regions import FACTORS
from finray_calib.demo import DemoSettings
from finray_calib.demo._stages import Demo
from sim.experiments import PaintedFinger, paint_finger, paint_optics, pose_response, press_record
from sim.experiments._optics_products import LED_DRIFT_REL, BandImages, camera_capture
from sim.optics import PressRender, RenderSettings, choose_variant, render_press

Floats = NDArray[np.float64]
POSE_SD_MM = {"depth_mm": 0.05, "position_mm": 0.3}
LIGHT_SD_DEG, COATING_SD_REL = 3.0, 0.1
PAD_SAMPLES = 16
QUANTITIES = ("skill", "red rms", "green rms", "blue rms", "gradient", "objective")


@dataclass(frozen=True, slots=True)
class Hidden:
    """One hidden finger: its render, and that of the simulation's light and coating at the true pose."""

    capture: PressRender
    simulation: PressRender


def calibrated_finger(folder: Path, width_px: int) -> tuple[PaintedFinger, Demo]:
    """Capture and fit both paints on the simulated rig, and return the finger that is believed in."""
    demo = Demo(DemoSettings(folder, {}, None, 1, "digital twins"), choose_variant())
    for colour in ("red", "green"):
        demo.capture(colour, lambda *_: None)
        demo.radiometry(colour)
        demo.fit(colour)
    design = FingerDesign()
    camera = design.camera.model_copy(update={"width_px": width_px, "height_px": width_px * 3 // 4})
    paints = {colour: paint_optics(p) for colour, p in demo.calibrations().items()}
    finger = paint_finger(design.model_copy(update={"camera": camera}), paints, folder, demo.renderer)
    return finger, demo


def changed(design: FingerDesign, light_deg: float, coating_rel: float, pose_mm: dict[str, float]) -> FingerDesign:
    """Return the design with another light, coating and pose."""
    values = design.model_dump()
    values["light"]["angle_deg"] += light_deg
    for field in ("roughness_alpha", "diffuse_share"):
        values["coating"][field] = float(np.clip(values["coating"][field] * (1.0 + coating_rel), 0.01, 1.0))
    for field, move_mm in pose_mm.items():
        values["indenter"][field] += move_mm
    return FingerDesign.model_validate(values)


def hidden_finger(finger: PaintedFinger, samples: int, seed: int, rng: np.random.Generator) -> Hidden:
    """Render a finger whose light, coating and pose are off, and the nominal one at the same pose."""
    pose_mm = {name: float(sd * rng.standard_normal()) for name, sd in POSE_SD_MM.items()}
    light_deg, coating_rel = LIGHT_SD_DEG * rng.standard_normal(), COATING_SD_REL * rng.standard_normal()
    designs = (changed(finger.design, light_deg, coating_rel, pose_mm), changed(finger.design, 0.0, 0.0, pose_mm))
    renders = [
        render_press(d, finger.paints, finger.renderer, RenderSettings("b", seed + i, PAD_SAMPLES, samples))
        for i, d in enumerate(designs)
    ]
    return Hidden(renders[0], renders[1])


def true_matrix(press: SimulatedPress, chains: tuple[str, ...], draw: int) -> Floats:
    """Return the matrix from layers to RGB with one draw of every paint and the camera."""
    known, matrix = press.known_inputs, press.layer_matrix
    if known is None or matrix is None:
        raise SystemExit("the press holds no draws of its inputs")
    stored = known.factors.shape[1]
    factors = np.prod([known.factors[i, (draw + 331 * i) % stored] for i in range(len(known.names))], axis=0)
    return np.asarray((matrix * factors)[:, [press.chains.index(c) for c in chains]])


def exposed(render: PressRender, matrix: Floats, design: FingerDesign, seed: int) -> tuple[TactileCapture, Captured]:
    """Return the capture of a render through the sensor, and what it would be without noise and drift."""
    contact, no_contact = render.contact_chains, render.no_contact_chains
    capture = camera_capture(
        BandImages(contact, no_contact, np.zeros_like(no_contact)),
        matrix,
        design,
        seed,
        light_angle_deg=design.light.angle_deg,
        name=f"twin {seed}",
        source="digital twin",
        led_drift_rel=LED_DRIFT_REL,
    )
    pose = {f"{name.removesuffix('_mm')}_uncertainty_mm": sd_mm for name, sd_mm in POSE_SD_MM.items()}
    capture = capture.model_copy(update={"indenter": capture.indenter.model_copy(update=pose)})
    clean = (np.asarray(image.astype(np.float64) @ matrix.T) for image in (contact, no_contact))
    return capture, Captured(*clean, repeat=None, noise=NO_NOISE)


def truth(render: PressRender, matrix: Floats, clean: Captured, distance: Floats, block_px: int) -> dict[str, float]:
    """Return the metrics between the noise-free capture and the noise-free render with the true inputs."""
    none = np.zeros((0, *render.contact_chains.shape), dtype=np.float32)
    layers = RenderLayers(
        render.contact_chains, render.no_contact_chains, render.contact_half_difference,
        render.no_contact_half_difference, none, none, (), render.chains, matrix, None,
    )  # fmt: skip
    layers, clean, distance = layers.blocked(block_px), clean.blocked(block_px), block_mean(distance, block_px)
    regions = [Region(name, strip_from_distance(distance, factor), factor) for name, factor in FACTORS.items()]
    comparison = prepare_comparison(layers, clean, regions, None, fit_exposure=True, relative_weights=True)
    result = best(comparison)[-1]
    rms = result.images.relative_rms("simulation")[0]
    inputs = Inputs(layers, {}, None, None)
    ring = ring_of(distance, np.ones(distance.shape, dtype=np.bool_))
    share = captured_share(comparison, ring, np.isfinite(distance))
    objective = brightness_draws(comparison, inputs, ring, inputs.best(), None).error_rel(share)
    gradient = 0.0 if result.gradients is None else float(result.gradients.relative_rms_of_all("simulation")[0])
    skill = float(result.images.skill("simulation", comparison.channel_weights)[0])
    return dict(zip(QUANTITIES, (skill, *map(float, rms), gradient, float(objective[0])), strict=True))


def stated(report: PhotometricErrorReport) -> dict[str, tuple[float, float, float]]:
    """Return estimate and interval of every quantity that the report states."""
    region = next(r for r in report.regions if r.region == DILATED)
    row = next(r for r in region.rows if r.candidate == "simulation")
    if row.relative_rms is None or row.difference_gradient_rms_per_px is None or report.objective_error is None:
        raise SystemExit("the report of a capture in linear light lacks a number")
    found = (row.skill, *row.relative_rms, row.difference_gradient_rms_per_px, report.objective_error.error_rel)
    return {name: (i.estimate, i.low95, i.high95) for name, i in zip(QUANTITIES, found, strict=True)}


def main() -> None:
    """Run the study and print the coverage of every quantity."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--fingers", type=int, default=20)
    parser.add_argument("--paints-each", type=int, default=3)
    parser.add_argument("--samples-per-pixel", type=int, default=1024)
    parser.add_argument("--width", type=int, default=160)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    begun, rng = time.monotonic(), np.random.default_rng(arguments.seed)
    covered = dict.fromkeys(QUANTITIES, 0)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        finger, demo = calibrated_finger(Path(folder), arguments.width)
        pose = None
        for i in range(arguments.fingers):
            seed = 1000 * arguments.seed + 10 * i
            render = render_press(
                finger.design,
                finger.paints,
                finger.renderer,
                RenderSettings("b", seed, PAD_SAMPLES, arguments.samples_per_pixel // 4),
            )
            if pose is None:
                pose = pose_response(
                    finger, RenderSettings("b", seed + 5, PAD_SAMPLES, arguments.samples_per_pixel), render.chains
                )
            press = press_record(finger, render, {}, demo.calibrations(), pose)
            hidden = hidden_finger(finger, arguments.samples_per_pixel, seed + 6, rng)
            for j in range(arguments.paints_each):
                draw = int(rng.integers(1000))
                capture, clean = exposed(
                    hidden.capture, true_matrix(press, hidden.capture.chains, draw), finger.design, seed + j
                )
                report = compare_press(press, capture, 1)
                distance = press.distance.astype(np.float64)
                matrix = true_matrix(press, hidden.simulation.chains, draw)
                true = truth(hidden.simulation, matrix, clean, distance, report.block_px)
                says = stated(report)
                for name in QUANTITIES:
                    covered[name] += says[name][1] <= true[name] <= says[name][2]
                rows.append({"true": true, "stated": says})
                line = ", ".join(f"{n} {true[n]:.3f} in [{says[n][1]:.3f}, {says[n][2]:.3f}]" for n in QUANTITIES)
                print(f"finger {i} paints {j}: {line}", flush=True)
    twins = arguments.fingers * arguments.paints_each
    print(f"{twins} twins, {time.monotonic() - begun:.0f} s")
    for name, count in covered.items():
        print(f"{name:10s} 95 % interval holds the truth in {count} of {twins}")
    if arguments.out is not None:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps({"twins": twins, "covered": covered, "rows": rows}))


if __name__ == "__main__":
    main()
