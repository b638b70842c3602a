"""How often the fit calls a sample without emission a paint, and whether it misses paints: on the simulated bench.

    python benchmarks/emission_detection.py --spectra ../shared/data/spectra --out bench-out/emission-detection.json

The light is that of the simulated bench, which shares no code with the fit: filters off their nominal centre, width,
shape and blocking, a laser with a pedestal. Frames are left out: each band value gets the photon noise of its region,
and a light that repeats to 0.1 %. Rigs differ by seed, camera, blocking (4 to 6 OD) and noise.

* blanks: white plastic, paper, grey, black and coloured reflectances, no emission
* weak emitters of a yield of 0.02 and less, modes of 490 to 680 nm, widths of 30 to 80 nm, on the same reflectances
* the fluorophores of a table of dyes (``dyes.csv``): with the laser as it excites them, and those that it does not
* measured re-radiation matrices
"""

import argparse
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import beta

from data_schemas import BandSignals, EmissionDetection, Optics
from data_schemas.storage import camera_response, halogen_lamp
from finray_calib.fit import EmissionPrior, band_data, detect_emission
from rigs import simulated_rig
from rigs.simulated import Bench
from rigs.simulated._bench import STEP_NM, WAVELENGTH_NM, sample_matrix

Floats = np.ndarray
CHANNEL_WEIGHTS = np.array([0.01, 0.09, 0.9])
PIXELS_OF_CHANNEL = 800  # of a region in a small frame
FULL_ELECTRONS, LONGEST_S, FRAMES, READ_E = 8000.0, 4.0, 4, 3.0
REPEATABILITY_REL = 1e-3
WEAK_WHITE_SNR = 30.0
BLOCKINGS_OD = (4.0, 5.0, 6.0)
LARGEST_FALSE_ALARM, LEAST_DETECTED = 0.03, 0.99


def rise(at_nm: float, low: float, high: float, width_nm: float = 15.0) -> Floats:
    """Return a reflectance that rises at a wavelength."""
    return low + (high - low) / (1 + np.exp(-(WAVELENGTH_NM - at_nm) / width_nm))


REFLECTANCES: dict[str, Floats] = {
    "white plastic": np.full(WAVELENGTH_NM.size, 0.9),
    "paper": rise(430.0, 0.6, 0.85),
    "grey": np.full(WAVELENGTH_NM.size, 0.2),
    "black": np.full(WAVELENGTH_NM.size, 0.04),
    "blue": 0.5 - rise(520.0, 0.0, 0.4),
    "orange": rise(560.0, 0.05, 0.7),
}


@dataclass
class Rig:
    """One simulated rig without its frames."""

    seed: int
    blocking_od: float
    camera: str = "assumed"
    material: str | None = None
    emission_filters: tuple[tuple[float, float], ...] = ()
    """Centre and width, nm, of filters in place of all but the one at the laser; the paper's where empty."""
    bench: Bench = field(init=False)
    optics: Optics = field(init=False)

    def __post_init__(self) -> None:
        rig = simulated_rig(self.material or "red", seed=self.seed, width_px=64, height_px=64)
        wheel = rig.filter_wheel
        filters = tuple(f.model_copy(update={"blocking_od": self.blocking_od}) for f in wheel.filters)
        if self.emission_filters:
            at_laser = next(f for f in filters if f.name == "450")
            like = next(f for f in filters if f.name == "500")
            others = [
                like.model_copy(update={"name": f"{c:g}/{w:g}", "center_nm": float(c), "fwhm_nm": float(w)})
                for c, w in self.emission_filters
            ]
            ordered = sorted((at_laser, *others), key=lambda f: f.center_nm)
            filters = tuple(f.model_copy(update={"slot": slot}) for slot, f in enumerate(ordered, 1))
        rig = rig.model_copy(update={"filter_wheel": wheel.model_copy(update={"filters": filters})})
        response = camera_response(self.camera, Path())
        self.rig, self.bench = rig, Bench(rig, Path(), response)
        self.optics = Optics(
            filters=filters,
            excitation_filter="450",
            laser=rig.laser,
            lamp=halogen_lamp(),
            white_reference=rig.white_reference,
            band_uncertainty=rig.band_uncertainty,
            camera_response=response,
        )

    def signals(
        self,
        name: str,
        reflectance: Floats,
        emission_per_nm: Floats,
        rng: np.random.Generator,
        under_lamp: Floats | float = 0.0,
    ) -> BandSignals:
        """Return the band signals of a sample; emission for light at the laser line, on the bench's wavelengths.

        What the lamp makes it emit is left out unless given.
        """
        bench, white = self.bench, self.optics.white_reference.reflectance
        laser, lamp = bench.lights["laser"], bench.lights["lamp"]
        under_laser = reflectance * laser + emission_per_nm * laser.sum() * STEP_NM
        slots = [f.slot for f in self.optics.filters]
        f, f_rel = self.measured([bench.band_electrons_per_s(under_laser, s) for s in slots], rng)
        w, w_rel = self.measured([bench.band_electrons_per_s(white * lamp, s) for s in slots], rng)
        emitting = reflectance * lamp + under_lamp
        s, s_rel = self.measured([bench.band_electrons_per_s(emitting, s) for s in slots], rng)
        at = [f.name for f in self.optics.filters].index("450")
        v, v_rel = self.measured([bench.band_electrons_per_s(white * laser, slots[at])], rng)
        level = float(CHANNEL_WEIGHTS @ (v[0] / w[at]))
        y, rho = f / w / level, white * s / w
        common = float(np.hypot(v_rel[0, 2], w_rel[at, 2]))
        sd = (np.abs(y) * np.hypot(f_rel, w_rel)).ravel()
        return BandSignals(
            paint_name=name,
            optics=self.optics,
            fluorescence=y,
            fluorescence_covariance=np.diag(sd**2) + common**2 * np.outer(y, y),
            reflectance=rho,
            reflectance_covariance=np.diag((rho * np.hypot(s_rel, w_rel)).ravel() ** 2),
            channel_weights=CHANNEL_WEIGHTS,
            flags=tuple(tuple("ok" if e * WEAK_WHITE_SNR < 1 else "weak" for e in row) for row in w_rel),
            saturated_fraction=np.zeros_like(y),
            region_pixels=4 * PIXELS_OF_CHANNEL,
        )

    def measured(self, electrons_per_s: list[Floats], rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return rates (B, 3) with noise, and their relative standard deviations as the noise model knows them."""
        rate = np.array(electrons_per_s)
        exposure_s = np.minimum(FULL_ELECTRONS / rate.max(axis=1, keepdims=True), LONGEST_S)
        collected = rate * exposure_s * FRAMES * PIXELS_OF_CHANNEL
        sd = np.sqrt(collected + FRAMES * PIXELS_OF_CHANNEL * READ_E**2)
        seen = collected * (1 + REPEATABILITY_REL * rng.standard_normal((len(rate), 1)))
        seen = seen + sd * rng.standard_normal(rate.shape)
        relative = np.hypot(sd / np.maximum(np.abs(seen), 1.0), REPEATABILITY_REL)
        return np.where(seen == 0, 1.0, seen) / (exposure_s * FRAMES * PIXELS_OF_CHANNEL), relative


def detect(signals: BandSignals, seed: int) -> EmissionDetection:
    """Return the fit's decision."""
    return detect_emission(signals, band_data(signals), EmissionPrior(), seed)


def bell(mode_nm: float, fwhm_nm: float) -> Floats:
    """Return an emission of unit yield that is none of the fit's families: a hyperbolic secant with a red tail."""
    half = fwhm_nm / 2.634 * np.where(mode_nm > WAVELENGTH_NM, 0.8, 1.2)
    curve = 1 / np.cosh(np.clip((WAVELENGTH_NM - mode_nm) / half, -300, 300))
    return unit_yield(curve)


def unit_yield(curve: Floats) -> Floats:
    """Return a curve with an area of 1 between the laser and 780 nm, nothing below."""
    curve = np.where((WAVELENGTH_NM > 460) & (WAVELENGTH_NM <= 780), curve, 0.0)
    return curve / (curve.sum() * STEP_NM)


def random_rig(rng: np.random.Generator, cameras: list[str]) -> Rig:
    """Return a rig of another seed, blocking and camera."""
    return Rig(int(rng.integers(1 << 30)), float(rng.choice(BLOCKINGS_OD)), str(rng.choice(cameras)))


def blanks(number: int, rng: np.random.Generator, cameras: list[str]) -> dict[str, list[bool]]:
    """Return which blanks are called emission, by reflectance."""
    found: dict[str, list[bool]] = {name: [] for name in REFLECTANCES}
    nothing = np.zeros(WAVELENGTH_NM.size)
    for i in range(number):
        name = list(REFLECTANCES)[i % len(REFLECTANCES)]
        signals = random_rig(rng, cameras).signals(name, REFLECTANCES[name], nothing, rng)
        found[name].append(detect(signals, int(rng.integers(1 << 30))).measured)
    return found


def limits_hold(number: int, rng: np.random.Generator, cameras: list[str]) -> list[bool]:
    """Return whether samples whose yield is the limit that their own blank got are called emission."""
    hits = []
    for i in range(number):
        reflectance = list(REFLECTANCES.values())[i % len(REFLECTANCES)]
        rig = random_rig(rng, cameras)
        blank = detect(rig.signals("blank", reflectance, np.zeros(WAVELENGTH_NM.size), rng), i)
        if blank.yield_limit is None:
            continue
        emission = blank.yield_limit * bell(rng.uniform(490, 680), rng.uniform(30, 80))
        hits.append(detect(rig.signals("at the limit", reflectance, emission, rng), i).measured)
    return hits


def weak(energy_yield: float, number: int, rng: np.random.Generator, cameras: list[str]) -> list[bool]:
    """Return which weak emitters are found."""
    found = []
    for i in range(number):
        reflectance = list(REFLECTANCES.values())[i % len(REFLECTANCES)]
        emission = energy_yield * bell(rng.uniform(490, 680), rng.uniform(30, 80))
        signals = random_rig(rng, cameras).signals("weak", reflectance, emission, rng)
        found.append(detect(signals, i).measured)
    return found


def dyes(path: Path) -> list[tuple[str, float, Floats]]:
    """Return name, excitation at the laser relative to its maximum, and emission of unit yield of each fluorophore."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    header = lines[0].split(",")
    first = next(i for i, cell in enumerate(header) if cell.replace(".", "").isdigit())
    nm = np.array([float(cell) for cell in header[first:]])
    rows: dict[str, dict[str, Floats]] = {}
    for line in lines[1:]:
        cells = line.split(",")
        kind = next(k for k in ("excitation", "emission") if k in cells[:first])
        name = ",".join(c for c in cells[:first] if c != kind)
        rows.setdefault(name, {})[kind] = np.array([float(c or 0) for c in cells[first:]])
    found = []
    for name, curves in rows.items():
        if {"excitation", "emission"} <= curves.keys():
            excited = float(np.interp(450.0, nm, curves["excitation"]))
            emission = np.interp(WAVELENGTH_NM, nm, curves["emission"], left=0.0, right=0.0)
            found.append((name, excited, emission))
    return found


def interval(hits: list[bool]) -> tuple[float, float, float]:
    """Return the share and its 95 % Clopper-Pearson interval."""
    n, k = len(hits), sum(hits)
    low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))
    return k / n, low, high


def told(what: str, hits: list[bool]) -> str:
    """Return one line of the table."""
    share, low, high = interval(hits)
    return f"{what:58s} {sum(hits):5d} of {len(hits):5d}  {share:.3f} [{low:.3f}, {high:.3f}]"


def main() -> int:
    """Print the shares; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spectra", type=Path, help="folder with dyes.csv, materials/ and cameras/")
    parser.add_argument("--blanks", type=int, default=1200)
    parser.add_argument("--weak", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rng, cameras, table = np.random.default_rng(arguments.seed), ["assumed"], {}
    if arguments.spectra:
        cameras += [str(path.resolve()) for path in sorted((arguments.spectra / "cameras").glob("*.csv"))]

    def say(what: str, hits: list[bool]) -> None:
        table[what] = {"hits": sum(hits), "of": len(hits), "interval": interval(hits)}
        print(told(what, hits), flush=True)

    by_name = blanks(arguments.blanks, rng, cameras)
    for name, hits in by_name.items():
        say(f"blank called emission: {name}", hits)
    say("blank called emission: all", [hit for hits in by_name.values() for hit in hits])
    for energy_yield in (0.02, 0.005, 0.002):
        say(f"found: yield {energy_yield:g}, modes 490 to 680 nm", weak(energy_yield, arguments.weak, rng, cameras))
    say("found: at the limit that the blank stated (claimed 0.95)", limits_hold(arguments.weak, rng, cameras))
    if arguments.spectra:
        excited, dark = [], []
        for i, (name, at_laser, curve) in enumerate(dyes(arguments.spectra / "dyes.csv")):
            above = np.where(WAVELENGTH_NM > 460, curve, 0.0)
            if above.max() <= 0:
                continue
            mode_nm = WAVELENGTH_NM[above.argmax()]
            emission = 0.3 * at_laser * unit_yield(curve)
            reflectance = list(REFLECTANCES.values())[i % 4]
            hit = detect(random_rig(rng, cameras).signals(name, reflectance, emission, rng), i).measured
            if at_laser < 0.001:
                dark.append(hit)
            elif 0.3 * at_laser >= 0.02 and 490 <= mode_nm <= 680:
                excited.append(hit)
        say("found: dyes of yield 0.3 x excitation at 450 nm, >= 0.02", excited)
        say("dyes that the laser does not excite called emission", dark)
        materials = []
        for path in sorted((arguments.spectra / "materials").glob("*.csv")):
            for seed in range(5):
                rig = Rig(seed, 5.0, material=str(path.resolve()))
                matrix = sample_matrix(rig.rig, Path())
                column = matrix.emission_at(450.0)
                emission = np.interp(WAVELENGTH_NM, column.wavelength_nm, column.values)
                signals = rig.signals(path.stem, matrix.reflectance(WAVELENGTH_NM), emission, rng)
                materials.append(detect(signals, seed).measured)
        say("found: measured re-radiation matrices", materials)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps({"seed": arguments.seed, "table": table}, indent=1))
    false_alarms = table["blank called emission: all"]
    detected = table["found: yield 0.02, modes 490 to 680 nm"]
    met = false_alarms["hits"] <= LARGEST_FALSE_ALARM * false_alarms["of"]
    return int(not (met and detected["hits"] >= LEAST_DETECTED * detected["of"]))


if __name__ == "__main__":
    sys.exit(main())
