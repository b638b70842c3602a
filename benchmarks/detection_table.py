"""How small a fault of the rig do the charts of ``finray history`` see? Size against detection rate, simulated.

    python -m benchmarks.detection_table [--clean 300] [--faulty 40] [--out bench-out/detection]

One session of the simulated rig is captured; every other one takes its frames anew, with noise of its own, with what
differs from session to session on a good rig (`GOOD`, assumed: sizes of faults scale with it), and with a fault. Its
frames are reduced and charted as the command does. A fault is seen when the quantity that was named for it beforehand
alarms, at 1 % false alarms for each session and quantity and a reference of 20 sessions: in the first session with the
fault, and within five that have it. Exposures stay those of the captured session, though a rig would meter anew. The
region has 18 x 18 pixels only: quantities that noise limits (sharpness, dark) are seen better on a real region.

One file for each fault and size; the same command goes on with what is missing, for the same code.
"""

import argparse
import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from data_schemas import EXCHANGED_FILTERS, CaptureSession, Frame, PracticeFault
from finray_calib.acceptance import chart_rules, session_facts, watch
from rigs import open_rig, paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session
from rigs.simulated import RigCondition, with_fault

Floats = NDArray[np.float64]
REFERENCE, RATE, WITHIN = 20, 0.01, 5
LONG = 40
"""Sessions behind the reference of a series in control."""
SERIES = 400
"""Random series drawn from the sessions for each fault and size."""
COLOUR = "lamp colour, long / short wavelengths (%)"


GOOD = {
    "lamp_rel": 0.005, "lamp_k": 4.0, "laser_rel": 0.01, "emission_rel": 0.01, "filter_rel": 0.001, "blur_px": 0.05,
    "black_dn": 0.05, "stray_dn_per_s": 0.02,
}  # fmt: skip
"""Standard deviations from session to session: level and temperature of a lamp that is started anew, a laser diode,
a sample that is mounted anew, a wheel that is homed, focus, black level and light that leaks into the box."""
BLUR_PX = 0.4


def good(rng: np.random.Generator, filters: int) -> RigCondition:
    """Return a session of a good rig."""
    return RigCondition(
        lamp_rel=GOOD["lamp_rel"] * rng.standard_normal(),
        lamp_k=GOOD["lamp_k"] * rng.standard_normal(),
        laser_rel=GOOD["laser_rel"] * rng.standard_normal(),
        emission_rel=GOOD["emission_rel"] * rng.standard_normal(),
        filters_rel=tuple(GOOD["filter_rel"] * rng.standard_normal(filters)),
        blur_px=BLUR_PX + GOOD["blur_px"] * rng.standard_normal(),
        black_dn=GOOD["black_dn"] * rng.standard_normal(),
        stray_dn_per_s=0.1 + GOOD["stray_dn_per_s"] * rng.standard_normal(),
    )


class SimulatedSessions:
    """Sessions of one simulated rig, made from the frames of one that was captured."""

    def __init__(self, folder: Path):
        rig = simulated_rig("red", width_px=96, height_px=80)
        self.rig = rig
        out = folder / "session"
        self.session: CaptureSession = capture_paint_session(
            self.rig, paint_plan("red", self.rig.camera), SessionRequest(out, "finray capture")
        )
        self.names = [band.name for band in self.rig.filter_wheel.filters]
        self._centres = np.array([band.center_nm for band in self.rig.filter_wheel.filters])
        self._slots = {band.name: band.slot for band in self.rig.filter_wheel.filters}
        with open_rig(self.rig, Path()) as opened:
            self._bench, self._sensor = opened.camera.bench, opened.camera.sensor  # type: ignore[attr-defined]
        self._rates: dict[tuple[str, str, str | None], tuple[Floats, Floats]] = {}

    def _bench_rates(self, frame: Frame) -> tuple[Floats, Floats]:
        """Return the electrons per second of a frame's target and light, and the emitted part of them."""
        key = (frame.target, frame.light, frame.filter_name)
        if key not in self._rates:
            slot = None if frame.filter_name is None else self._slots[frame.filter_name]
            fresh = np.array(self._bench.electrons_per_s(frame.target, frame.light, slot))
            self._rates[key] = fresh, self._bench.emitted_electrons_per_s(frame.target, frame.light, slot)
        return self._rates[key]

    def facts(self, what: RigCondition, rng: np.random.Generator) -> dict[str, float]:
        """Return what is charted of a session."""
        found = session_facts("s", self.session, lambda frame: self._frame(frame, what, rng))
        if found.fault:
            raise RuntimeError(found.fault)
        return {**found.rig, **found.sample}

    def _frame(self, frame: Frame, what: RigCondition, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Take a frame anew."""
        gain = self.rig.camera.gain_e_per_dn
        rate = np.full(self._sensor_shape(), what.stray_dn_per_s * gain)
        if frame.light != "off":
            name = what.truly_in_beam(frame.filter_name)
            fresh, emitted = self._bench_rates(frame.model_copy(update={"filter_name": name}))
            place = None if name is None else self.names.index(name)
            band = None if place is None else (place, float(self._centres[place]))
            flicker = 1 + 0.002 * rng.standard_normal()
            rate = rate + what.seen(fresh, emitted, frame.light, band, self.rig.lamp.temperature_k, flicker)
        counts = self._sensor.expose(np.maximum(rate, 0.0), frame.exposure_s, rng).astype(np.float64)
        full = 2**self.rig.camera.bit_depth - 1
        return np.clip(np.round(counts + what.black_dn + rng.uniform(-0.5, 0.5, counts.shape)), 0, full).astype(
            np.uint16
        )

    def _sensor_shape(self) -> tuple[int, int]:
        """Return rows and columns of a frame."""
        return self.rig.camera.height_px, self.rig.camera.width_px


@dataclass(frozen=True, slots=True)
class Fault:
    """A practice fault with the quantities in which it is looked for.

    Attributes
    ----------
    told
        How it is called in the table.
    name, pair
        How the practice rig calls it, and the filters that are exchanged.
    unit, sizes
        Of its sizes.
    watched
        Quantities that are charted.
    filter_name
        Of the filter that slips or is dirty.
    """

    told: str
    name: str
    unit: str
    sizes: tuple[float, ...]
    watched: tuple[str, ...]
    filter_name: str = ""
    pair: tuple[str, str] = ("", "")

    def make(self, good: RigCondition, size: float, names: list[str]) -> RigCondition:
        """Return the condition of a rig with this fault fully developed."""
        place = names.index(self.filter_name) if self.filter_name else 0
        return with_fault(good, PracticeFault(self.name, size, self.pair), len(names), place)


FAULTS = (
    Fault("slipping wheel: its edge takes light of one filter, in one session", "slipping wheel", "% of the light",
          (0.2, 0.5, 1.0, 2.0), ("filter 532 (%)",), "532"),
    Fault("dirty filter: less light in all sessions", "dirty filter", "% of the light", (0.1, 0.2, 0.5, 1.0),
          ("filter 600 (%)",), "600"),
    Fault("drifting laser", "drifting laser", "% of its power", (1.0, 2.0, 4.0, 6.0), ("laser level (%)",)),
    Fault("bleaching paint", "bleaching paint", "% of the emission", (1.0, 2.0, 4.0, 6.0), ("emission (%)",)),
    Fault("lamp ageing", "lamp ageing", "K colder", (5.0, 10.0, 15.0, 25.0), (COLOUR,)),
    Fault("exchanged filters 500 and 532", EXCHANGED_FILTERS, "pair", (1.0,), ("filter 500 (%)",),
          pair=("500", "532")),
    Fault("exchanged filters 560 and 600", EXCHANGED_FILTERS, "pair", (1.0,), ("filter 600 (%)",),
          pair=("560", "600")),
    Fault("focus shift", "focus shift", "px of blur added in squares", (0.25, 0.5, 0.75, 1.0),
          ("sharpness of the white frames (%)",)),
    Fault("stray light", "stray light", "DN/s", (0.05, 0.1, 0.2, 0.4), ("dark rate (DN/s)",)),
)  # fmt: skip


def values_of(folder: Path, name: str, number: int, make: Callable[[int], dict[str, float]]) -> list[dict[str, float]]:
    """Return the values of sessions, read where they were computed before."""
    path = folder / f"{name}.json"
    if path.exists():
        return list(json.loads(path.read_text(encoding="utf-8")))
    values = [make(i) for i in range(number)]
    path.write_text(json.dumps(values), encoding="utf-8")
    return values


def detection(clean: Floats, faulty: Floats, rng: np.random.Generator) -> tuple[float, float]:
    """Return the shares of random series that alarm in the first session with the fault, and within five."""
    rules = chart_rules(RATE, REFERENCE)
    found = np.zeros(2)
    for _ in range(SERIES):
        series = np.r_[rng.choice(clean, REFERENCE, replace=False), rng.choice(faulty, WITHIN, replace=False)]
        places = {alarm.place for alarm in watch(series, rules).alarms}
        found += [REFERENCE in places, bool(places)]
    first, within = found / SERIES
    return float(first), float(within)


def false_alarms(clean: Floats, rng: np.random.Generator) -> float:
    """Return the alarms for each session of random series in control."""
    rules, count = chart_rules(RATE, REFERENCE), 0
    for _ in range(SERIES):
        count += len({alarm.place for alarm in watch(rng.choice(clean, REFERENCE + LONG, replace=False), rules).alarms})
    return count / (SERIES * LONG)


def interval(share: float, sessions: int) -> tuple[float, float]:
    """Return the 95 % interval (Clopper-Pearson) of a share, for as many sessions as there truly are."""
    hits = round(share * sessions)
    low = float(beta.ppf(0.025, hits, sessions - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, sessions - hits)) if hits < sessions else 1.0
    return low, high


def rows(folder: Path, clean_sessions: int, faulty_sessions: int) -> Iterator[str]:
    """Yield the lines of the tables."""
    with TemporaryDirectory() as scratch:
        rig = SimulatedSessions(Path(scratch))

        def usual(i: int) -> dict[str, float]:
            rng = np.random.default_rng([1, i])
            return rig.facts(good(rng, len(rig.names)), rng)

        clean = values_of(folder, f"clean-{clean_sessions}", clean_sessions, usual)
        rng = np.random.default_rng(0)
        yield "| quantity | sd from session to session | false alarms for each session |"
        yield "|---|---|---|"
        for quantity in clean[0]:
            values = np.array([one[quantity] for one in clean])
            share = false_alarms(values, rng)
            low, high = interval(share, clean_sessions)
            yield f"| {quantity} | {values.std(ddof=1):.2g} | {100 * share:.1f} % [{100 * low:.1f}, {100 * high:.1f}] |"
        yield ""
        yield "| fault | looked for in | size | seen in its first session | within five sessions |"
        yield "|---|---|---|---|---|"
        for number, fault in enumerate(FAULTS):
            for size in fault.sizes:
                yield _row(rig, folder, fault, (number, size), faulty_sessions, clean)


def _row(
    rig: SimulatedSessions, folder: Path, fault: Fault, place: tuple[int, float], sessions: int,
    clean: list[dict[str, float]],
) -> str:  # fmt: skip
    """Return the line of one fault and size."""
    number, size = place

    def broken(i: int) -> dict[str, float]:
        rng = np.random.default_rng([2, number, round(1000 * size), i])
        return rig.facts(fault.make(good(rng, len(rig.names)), size, rig.names), rng)

    faulty = values_of(folder, f"fault-{number}-{size:g}-{sessions}", sessions, broken)
    quantity, rng = fault.watched[0], np.random.default_rng([3, number])
    first, within = detection(
        np.array([one[quantity] for one in clean]), np.array([one[quantity] for one in faulty]), rng
    )
    low, high = interval(first, sessions)
    told = f"{100 * within:.0f} %" if not fault.told.startswith("slipping") else "-"
    seen = f"{100 * first:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
    return f"| {fault.told} | {quantity} | {size:g} {fault.unit} | {seen} | {told} |"


def main() -> None:
    """Compute what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--clean", type=int, default=300)
    parser.add_argument("--faulty", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("bench-out/detection"))
    arguments = parser.parse_args()
    code = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    folder = arguments.out / code
    folder.mkdir(parents=True, exist_ok=True)
    for line in rows(folder, arguments.clean, arguments.faulty):
        print(line, flush=True)


if __name__ == "__main__":
    main()
