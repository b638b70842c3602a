"""The sweep, whose paths serve all angles and whose panel reflects nothing, against the panel in the scene.

    python benchmarks/angle_sweep_bias.py [--angles 30 90] [--waves 1 1 6 6] [--paths 62500] [--repeats 8]

Each probe has its own number of waves of paths per repeat. Per angle, probe and band: ratio of the sweep's radiance to
that of the integrator of pictures, whose scene holds the panel with its 5 % reflectance, and the ratio's standard error
over independent repeats, each with its own bakes. Then two parts of the bias with common random numbers, where the
noise falls out: what the reflectance adds to the LED band, and which share of the walls' light the panel keeps away
(the sweep takes it off). Bar: each error below 1 %, bias below 1 % plus 3 errors.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fluorescence_levels import finger, paints
from data_schemas import FingerDesign
from sim.optics import BAND_NAMES, choose_variant, open_renderer, paint_bands
from sim.optics._painted_walls import WallExchange, direct_lights
from sim.optics._probes import Probes, default_probe_points_mm, probes_on
from sim.surface_meshes import FingerShape, pressed_shape

Floats = NDArray[np.float64]

BAR = 0.01
BAKE_PATHS = 160_000
LED = BAND_NAMES.index("led")


def at_angle(design: FingerDesign, angle_deg: float) -> FingerDesign:
    """Return the design with another light angle."""
    return design.model_copy(update={"light": design.light.model_copy(update={"angle_deg": angle_deg})})


def swept(
    designs: Sequence[FingerDesign], shape: FingerShape, probes: Probes, paths: Sequence[int], repeats: int
) -> tuple[Floats, Floats]:
    """Return the radiance (angle, repeat, probe, band) of the sweep, and the share of wall light kept away (angle)."""
    import mitsuba as mi

    from sim.optics import open_scene
    from sim.optics._angle_paths import AnglePaths

    design, lights = designs[0], [design.light for design in designs]
    bands = paint_bands(*paints().values(), design.light)
    tracer = AnglePaths(open_scene(design, shape, bands, mi), design, shape, lights)
    direct = direct_lights(design, shape, lights)
    radiance, kept = np.empty((len(designs), repeats, len(paths), 3)), []
    for repeat in range(repeats):
        walls = WallExchange.traced(tracer, shape, BAKE_PATHS, np.random.default_rng((1, repeat)))
        emitted = walls.emitted(direct, bands)
        for p, count in enumerate(paths):
            rays = [np.broadcast_to(v[p], (count, 3)) for v in (probes.origins_mm, probes.directions)]
            seen = tracer.trace(*rays, count, 1000 * p + repeat, from_wall=False)
            radiance[:, repeat, p, :LED] = seen.by_wall.received(emitted, range(len(designs)))[:, 0]
            radiance[:, repeat, p, LED] = seen.led[0]
            whole = emitted.reshape(len(designs), -1) @ seen.by_wall.whole[0]
            kept.append(1.0 - radiance[:, repeat, p, :LED].sum(axis=-1) / whole)
    return radiance, np.mean(kept, axis=0)


def in_scene(
    design: FingerDesign, shape: FingerShape, probes: Probes, wave: int, waves: Sequence[int], repeats: int
) -> tuple[Floats, Floats]:
    """Return (repeat, probe, band) with the panel in the scene, and what its reflectance adds to the LED band."""
    import mitsuba as mi

    from sim.optics import LoadedScene, bake_walls, open_scene
    from sim.optics._render import lit_integrator

    bands = paint_bands(*paints().values(), design.light)
    scene, radiance, added = open_scene(design, shape, bands, mi), [], []
    parameters = mi.traverse(scene)
    for repeat, light in enumerate(
        bake_walls(LoadedScene(scene, design, shape, bands, mi), "b", 7, BAKE_PATHS, repeats)
    ):
        integrator, chains = lit_integrator(scene, design, shape, mi, light)
        radiance.append(
            [
                np.mean([meter(integrator, scene, chains, probes, p, wave, (repeat, k)) for k in range(count)], axis=0)
                for p, count in enumerate(waves)
            ]
        )
        of_scenes = []
        for reflectance in (0.0, design.enclosure.panel_reflectance):
            parameters["panel0.bsdf.reflectance.value"] = mi.Color3f(reflectance)
            parameters.update()
            of_scenes.append(
                [meter(integrator, scene, chains, probes, p, wave, (repeat,))[LED] for p in range(len(waves))]
            )
        added.append(np.array(of_scenes[1]) / np.array(of_scenes[0]) - 1.0)
    return np.array(radiance), np.mean(added, axis=0)


def meter(
    integrator: Any, scene: Any, chains: Sequence[str], probes: Probes, p: int, paths: int, seed: tuple[int, ...]
) -> Floats:
    """Return the bands that a probe sees; an integrator wants the same number of paths each time."""
    import mitsuba as mi

    from sim.optics import chain_matrix

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(int(np.random.SeedSequence((p, *seed)).generate_state(1)[0]), paths)
    o, d = (np.repeat(v[p : p + 1].T.astype(np.float32), paths, axis=1) for v in (probes.origins_mm, probes.directions))
    rays = mi.Ray3f(mi.Point3f(o), mi.Vector3f(d))
    radiance, _, further = integrator.sample(scene, sampler, rays, None, mi.Bool(True))
    channels = [*radiance.numpy(), *(np.array(channel) for channel in further)]
    return np.asarray(chain_matrix(chains) @ [channel.mean(dtype=float) for channel in channels])


def main() -> None:
    """Print ratios, errors and parts of the bias."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--angles", type=float, nargs="+", default=[30.0, 90.0])
    parser.add_argument("--waves", type=int, nargs=4, default=[1, 1, 6, 6])
    parser.add_argument("--paths", type=int, default=62_500)
    parser.add_argument("--repeats", type=int, default=8)
    args = parser.parse_args()
    open_renderer(choose_variant("llvm"))
    designs = [at_angle(finger(640), angle) for angle in args.angles]
    shape = pressed_shape(designs[0])
    probes = probes_on(designs[0], shape, default_probe_points_mm(designs[0], shape))
    here, kept = swept(designs, shape, probes, [args.paths * n for n in args.waves], args.repeats)
    for k, design in enumerate(designs):
        there, added = in_scene(design, shape, probes, args.paths, args.waves, args.repeats)
        ratio = here[k].mean(axis=0) / there.mean(axis=0)
        error = np.hypot(*(v.std(axis=0, ddof=1) / np.sqrt(args.repeats) / v.mean(axis=0) for v in (here[k], there)))
        print(f"{args.angles[k]:g} deg: the panel keeps {100 * kept[k]:.3f} % of the walls' light away")
        for p, (x, _, z) in enumerate(probes.points_mm):
            values = ", ".join(
                f"{b} {r:.4f} +- {e:.4f}" for b, r, e in zip(BAND_NAMES, ratio[p], error[p], strict=True)
            )
            print(f"  x {x:5.1f} z {z:5.1f} mm: {values}; its reflectance adds {100 * added[p]:.3f} % of LED")
        verdict = "within" if (np.abs(ratio - 1.0) < BAR + 3.0 * error).all() else "BEYOND"
        print(f"  bias {verdict} {BAR:g} and 3 errors; largest error {error.max():.4f}", flush=True)


if __name__ == "__main__":
    main()
