"""How much of a neighbouring filter's light passes unseen where a wheel stops between two slots at one frame?

``python -m benchmarks.slipped_wheel [--sessions 300] [--tries 20]`` takes frames of the simulated bench in which a
share of the beam passes the neighbouring filter, while the light has drifted by up to 5 % since the metering, and
asks two comparisons of a paint session: the level with that of the metering (a factor of 1.25), and the ratios of the
channels. It prints the least share that is refused in at least 95 % of the tries, and how many sessions without any
slip are refused. The metering is right; a wheel that slips at the metering is another matter (its frames are
refused).
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from data_schemas import RigFile, SignalChangedError
from rigs import RawFrame, open_rig, paint_plan, simulated_rig
from rigs.capture import Step
from rigs.capture._exposure import BRIGHTEST_PERCENTILE, exposure_ladder, rung_at_or_below
from rigs.capture._frame_store import FrameStore, Metered
from rigs.capture._journal import Journal

SIZE_PX = 256
SHARES = (0.002, 0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.10, 0.15, 0.20, 0.30)
DRIFT_REL, BRIGHT, SEEN_RATE = 0.05, 0.6, 0.95
KINDS = (("white", "lamp"), ("sample", "lamp"), ("sample", "laser"))
TEN_BIT_E_PER_DN = 6.5


class Bench(NamedTuple):
    """The bench with what compares its frames, and a generator of noise."""

    rig: RigFile
    opened: Any
    store: FrameStore
    rng: np.random.Generator
    known: dict[tuple[tuple[str, str], int], Any]


def rig_of(bits: int) -> RigFile:
    """Return the practice rig with a camera of so many bits: its full well stays."""
    rig = simulated_rig("red", width_px=SIZE_PX, height_px=SIZE_PX)
    scale = 2.0 ** (bits - 10)
    camera = rig.camera.model_copy(
        update={"bit_depth": bits, "gain_e_per_dn": TEN_BIT_E_PER_DN / scale, "black_level_dn": 16.0 * max(scale, 0.25)}
    )
    return rig.model_copy(update={"camera": camera})


def rates_e(bench: Bench, kind: tuple[str, str], slot: int) -> Any:
    """Return the electrons per second of each pixel of the region."""
    if (kind, slot) not in bench.known:
        seen = np.asarray(bench.opened.camera.bench.electrons_per_s(*kind, slot))
        part = paint_plan("red", bench.rig.camera).region
        rows = slice(part.row_px, part.row_px + part.height_px)
        bench.known[kind, slot] = seen[rows, part.column_px : part.column_px + part.width_px].astype(float)
    return bench.known[kind, slot]


def frame(bench: Bench, electrons_per_s: Any, exposure_s: float) -> RawFrame:
    """Take one frame."""
    counts = bench.opened.camera.sensor.expose(electrons_per_s.copy(), exposure_s, bench.rng)
    return RawFrame(counts, exposure_s, exposure_s, "")


def exposure_of(bench: Bench, electrons_per_s: Any) -> float:
    """Return the exposure at which the brightest part of the region is well exposed, or the longest one."""
    camera = bench.rig.camera
    brightest = max(np.percentile(electrons_per_s[a::2, b::2], BRIGHTEST_PERCENTILE) for a in (0, 1) for b in (0, 1))
    wanted_s = (BRIGHT * (2**camera.bit_depth - 1) - camera.black_level_dn) * camera.gain_e_per_dn / brightest
    return rung_at_or_below(exposure_ladder(camera.shortest_exposure_s, camera.longest_exposure_s), wanted_s)


def is_refused(bench: Bench, step: Step, electrons_per_s: Any, metered_s: float, exposure_s: float) -> bool:
    """Return whether a frame is refused after a metering that was right."""
    right = rates_e(bench, (step.target, step.light), step.slot)
    metered = Metered(bench.store.rates(frame(bench, right, metered_s).counts, metered_s), metered_s)
    drift = 1.0 + DRIFT_REL * bench.rng.uniform(-1.0, 1.0)
    raw = frame(bench, drift * electrons_per_s, exposure_s)
    try:
        bench.store.require_as_metered(step, raw, metered)
        bench.store.require_same_colour(step, raw, metered)
    except SignalChangedError:
        return True
    return False


def steps(bench: Bench) -> Iterator[tuple[Step, Step]]:
    """Yield each step beside that of each of its two neighbours on the wheel."""
    filters = sorted(bench.rig.filter_wheel.filters, key=lambda band: band.slot)
    for target, light in KINDS:
        both = [Step("white", target, light, band.name, band.slot) for band in filters]
        for place, step in enumerate(both):
            yield step, both[place - 1]
            yield step, both[(place + 1) % len(both)]


def least_share(bench: Bench, step: Step, beside: Step, tries: int) -> float:
    """Return the least share of the neighbour's light that is refused, and every larger one too."""
    here, there = (rates_e(bench, (one.target, one.light), one.slot) for one in (step, beside))
    exposure_s, least = exposure_of(bench, here), np.inf
    for share in reversed(SHARES):
        mixed = (1.0 - share) * here + share * there
        seen = sum(is_refused(bench, step, mixed, exposure_s, exposure_s) for _ in range(tries))
        if seen < SEEN_RATE * tries:
            break
        least = share
    return float(least)


def refused_sessions(bench: Bench, sessions: int) -> int:
    """Return how many sessions without a slip are refused: each step at its metered exposure and at a quarter of it."""
    own = list(dict.fromkeys(step for step, _ in steps(bench)))
    rates = {step: rates_e(bench, (step.target, step.light), step.slot) for step in own}
    metered_s = {step: exposure_of(bench, rates[step]) for step in own}
    shortest_s = bench.rig.camera.shortest_exposure_s
    return sum(
        any(
            is_refused(bench, step, rates[step], metered_s[step], max(part * metered_s[step], shortest_s))
            for step in own
            for part in (1.0, 0.25)
        )
        for _ in range(sessions)
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=300)
    parser.add_argument("--tries", type=int, default=20)
    parser.add_argument("--bits", type=int, nargs="*", default=[8, 10, 12, 16])
    asked = parser.parse_args()
    for bits in asked.bits:
        rig = rig_of(bits)
        whole = paint_plan("red", rig.camera).region.model_copy(update={"row_px": 0, "column_px": 0})
        with (
            TemporaryDirectory() as folder,
            open_rig(rig, Path()) as opened,
            Journal(Path(folder), opened.clock, resumed=False) as journal,
        ):
            store = FrameStore(opened, rig, whole, Path(folder), journal)
            bench = Bench(rig, opened, store, np.random.default_rng(bits), {})
            print(f"{bits} bit", flush=True)
            for step, beside in steps(bench):
                share = 100 * least_share(bench, step, beside, asked.tries)
                words = f"{step.target} {step.light} {step.filter_name} with {beside.filter_name}"
                print(f"  {words}: {share:g} %", flush=True)
            refused = refused_sessions(bench, asked.sessions)
            print(f"  refused without a slip: {refused} of {asked.sessions} sessions", flush=True)


if __name__ == "__main__":
    main()
