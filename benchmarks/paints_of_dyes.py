"""How far a fit of any paint can be believed: fluorophores made into paints, on simulated rigs, judged by group.

    python benchmarks/paints_of_dyes.py --spectra ../shared/data/spectra --out bench-out/paints.jsonl --cases 2
    python benchmarks/paints_of_dyes.py --spectra ../shared/data/spectra --out bench-out/paints.jsonl --table

Each fluorophore of ``dyes.csv`` that the laser excites becomes a paint by ``fluorescent_layer.py`` (which shares no
code and no equation with the fit; loads, thickness, yield, base and gloss are drawn), lies on a simulated rig without
frames (``emission_detection.py``: filters, laser, blocking, camera and noise drawn by seed; the lamp's temperature off
by some 30 K) and is fitted as ``finray fit`` does. The prior that the fit brings along is learned anew without the
fluorophore and all that resemble it. Cases already in the file are kept: stop and go on at any time.

A record that stops inside the judged wavelengths, where the paint still emits more than 5 % of its peak, or whose
excitation stops so, is a cliff that no paint has, and neither has one the hole of a missing value. The table is printed
of all, and of the rest. With ``--spectrum-alone`` only the posterior of the learned prior is made and judged,
in a tenth of the time: no families, no absorption, no warnings. With ``--rig sharp`` the rig states 0.1 % for the
response of its channels and for stray light in place of 0.3 % (the simulated rig has neither error). ``--rig exact``,
with the spectrum alone, asks what filters and prior allow: values from the fit's own weights, noise a tenth of usual,
no tolerances.

Binomial errors count fluorophores, not cases, as independent.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import find_peaks

from benchmarks.emission_detection import Rig
from benchmarks.fluorescent_layer import NM, Layer, Paint, paint, stokes_shifts_nm
from data_schemas import BandUncertainty, PaintCalibration
from data_schemas.storage import planck_relative
from finray_calib.fit import FitOptions, calibrate_paint
from finray_calib.fit._band_data import BandData, band_data, band_values
from finray_calib.fit._measured_spectra import learned_spectra
from finray_calib.fit._paint_calibration import curve_bands
from finray_calib.fit._reported_spectrum import conserving_draws, fit_spectrum, simultaneous_band
from finray_calib.spectra import WAVELENGTH_NM as OUT_NM
from finray_calib.spectra import curve_quantities
from rigs.simulated._bench import STEP_NM, WAVELENGTH_NM

Floats = np.ndarray
LASER_NM = 450.0
LEAST_EXCITED, LEAST_YIELD = 0.03, 0.02
MODES_NM = (465.0, 725.0)
CUT_AT = 0.1  # a curve that ends above this share of its peak was cut off by its record
LAMP_SD_K = 30.0
LAMP_K = 2856.0
JUDGED = (OUT_NM >= 470) & (OUT_NM <= 720)
COUNTED_REL = 0.05
HOLE_REL = 0.25  # a value this far below both its neighbours, 5 nm away: lines of emission rise, they do not fall
ALONE_DRAWS = 2000
SHARP = BandUncertainty(response_rel=1e-3, stray_light_rel=1e-3)
EXACT_NOISE = 0.1
GROUPS = ("paint-like", "narrow", "blue", "far red", "two peaks")


def dyes(path: Path) -> tuple[Floats, dict[str, tuple[Floats, Floats]]]:
    """Return wavelengths, and excitation and emission of each fluorophore that has both, by name."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    nm = np.array([float(cell) for cell in lines[0].split(",")[2:]])
    rows: dict[str, dict[str, Floats]] = {}
    for line in lines[1:]:
        cells = line.rsplit(",", len(nm))
        name, kind = cells[0].rsplit(",", 1)
        rows.setdefault(name, {})[kind] = np.array([float(cell or 0) for cell in cells[1:]])
    return nm, {name: (v["excitation"], v["emission"]) for name, v in rows.items() if len(v) == 2}


def complete(nm: Floats, emission: Floats) -> bool:
    """Whether a curve runs out on both sides inside its record."""
    on = np.flatnonzero(emission > 0.005)
    return bool(emission[on[0]] < CUT_AT and (emission[on[-1]] < CUT_AT or nm[on[-1]] >= OUT_NM[-1]))


def excited(path: Path) -> dict[str, tuple[Floats, Floats, Floats]]:
    """Return wavelengths, excitation and emission of the fluorophores that can be judged."""
    nm, all_dyes = dyes(path)
    return {
        name: (nm, np.clip(ex, 0, None) / ex.max(), np.clip(em, 0, None) / em.max())
        for name, (ex, em) in all_dyes.items()
        if MODES_NM[0] <= nm[em.argmax()] <= MODES_NM[1]
        and complete(nm, em)
        and ex.max() > 0
        and np.interp(LASER_NM, nm, ex) >= LEAST_EXCITED * ex.max()
    }


def runs_out(nm: Floats, excitation: Floats, emission: Floats, truth: Floats) -> bool:
    """Whether no record of a paint's emission (on the fit's grid) stops where it counts, or lacks a value.

    Judged by the records and the paint alone, never by a fit.
    """
    counted, on = truth > COUNTED_REL * truth.max(), np.flatnonzero(emission > 0)
    ends = [end for end in (nm[on[0]], nm[on[-1]]) if OUT_NM[JUDGED][0] <= end <= OUT_NM[JUDGED][-1]]
    last = np.flatnonzero(excitation > 0)[-1]
    if excitation[last] > COUNTED_REL * excitation.max():
        ends.append(nm[last])
    hole = np.minimum(emission[2:], emission[:-2]) - emission[1:-1] > HOLE_REL * emission.max()
    return not hole.any() and not any(counted[np.abs(OUT_NM - end) <= 1].any() for end in ends)


def group_of(curve: Floats) -> str:
    """Return the group of an emission curve on the fit's grid."""
    mode, fwhm, _ = scalars(curve)
    if mode < 495:
        return "blue"
    if mode > 670:
        return "far red"
    if find_peaks(np.r_[0, curve / curve.max(), 0], prominence=0.03)[0].size > 1:
        return "two peaks"
    return "narrow" if fwhm < 35 else "paint-like"


def scalars(curve: Floats) -> tuple[float, float, float]:
    """Return mode, width between the first falls to half on either side, and peak."""
    top = int(curve.argmax())
    half = curve[top] / 2
    red = next((i for i in range(top, curve.size) if curve[i] < half), curve.size - 1)
    blue = next((i for i in range(top, -1, -1) if curve[i] < half), 0)
    right = OUT_NM[red] - (half - curve[red]) / max(curve[red - 1] - curve[red], 1e-12)
    left = OUT_NM[blue] + (half - curve[blue]) / max(curve[blue + 1] - curve[blue], 1e-12)
    return float(OUT_NM[top]), float(right - left), float(curve[top])


class Case:
    """One fluorophore as one paint on one rig."""

    def __init__(self, name: str, number: int, curves: tuple[Floats, Floats, Floats], cameras: list[str]) -> None:
        seed = [sum(name.encode()), len(name), number]
        self.rng = np.random.default_rng(seed)
        nm, excitation, emission = curves
        self._records = nm, excitation, emission
        self.shifts = stokes_shifts_nm(nm, excitation, emission)
        absorbed, emitted = (np.clip(PchipInterpolator(nm, c)(NM), 0, None) for c in (excitation, emission))
        for _ in range(50):
            self.layer = Layer.drawn(self.rng)
            self.paint: Paint = paint(self.layer, absorbed, emitted)
            self.column = self._column(emission, nm)
            if self.column.sum() * STEP_NM >= LEAST_YIELD:
                break
        self.rig = Rig(
            int(self.rng.integers(1 << 30)), float(self.rng.choice((4.0, 5.0, 6.0))), str(self.rng.choice(cameras))
        )
        self.rig.optics = self.rig.optics.model_copy(update={"lamp_temperature_uncertainty_k": LAMP_SD_K})
        self.lamp_k = LAMP_K + LAMP_SD_K * self.rng.standard_normal()

    @property
    def truth(self) -> Floats:
        """Emission under the laser on the fit's grid."""
        return np.interp(OUT_NM, WAVELENGTH_NM, self.column)

    @property
    def runs_out(self) -> bool:
        """Whether its records do not stop where they count."""
        return runs_out(*self._records, self.truth)

    def _column(self, emission: Floats, nm: Floats) -> Floats:
        """Return the emission under the laser on the bench's wavelengths, with the dye's own detail."""
        coarse = np.array([np.interp(LASER_NM, NM, row) for row in self.paint.matrix_per_nm])
        energy = np.clip(PchipInterpolator(nm, emission)(NM), 0, None)
        escape = np.where(energy > 1e-6, coarse / np.maximum(energy, 1e-6), 0.0)
        fine = np.clip(PchipInterpolator(nm, emission)(WAVELENGTH_NM), 0, None) * np.interp(WAVELENGTH_NM, NM, escape)
        return np.where(WAVELENGTH_NM > LASER_NM + 5, fine, 0.0)

    def signals(self, name: str) -> Any:
        """Return the band signals."""
        bench = self.rig.bench
        lamp = planck_relative(WAVELENGTH_NM, self.lamp_k)
        bench.lights["lamp"] = lamp
        under_lamp = self.paint.matrix_per_nm @ np.interp(NM, WAVELENGTH_NM, lamp) * 5.0
        under_lamp = np.interp(WAVELENGTH_NM, NM, under_lamp)
        reflectance = np.interp(WAVELENGTH_NM, NM, self.paint.reflectance)
        return self.rig.signals(name, reflectance, self.column, self.rng, under_lamp)


def curve_row(truth: Floats, mean: Floats, limits: dict[str, tuple[Floats, Floats] | None]) -> dict[str, Any]:
    """Return group, error, and which share of the curve each band holds, by name; of whole_* whether all of it."""
    counted = JUDGED & (truth > COUNTED_REL * truth.max())
    row: dict[str, Any] = {
        "group": group_of(truth),
        "error": float(np.linalg.norm((mean - truth)[JUDGED]) / np.linalg.norm(truth[JUDGED])),
    }
    for name, band in limits.items():
        if band is not None:
            held = ((band[0] <= truth) & (truth <= band[1]))[counted]
            row[name] = float(held.mean()) if name.startswith("curve") else bool(held.all())
            if name == "curve95":
                row["width"] = float((band[1] - band[0])[counted].mean() / truth.max())
    return row


def exact_data(case: Case, signals: Any, ln_blocking_sd: float) -> BandData:
    """Return band values that the fit's own weights, with its mean leak, give the paint, by a rig that is known."""
    data, weights = band_data(signals), band_data(signals).weights
    curve = np.interp(weights.wavelength_nm, WAVELENGTH_NM, case.column)
    reflectance = np.interp([LASER_NM], NM, case.paint.reflectance)
    values = band_values(curve[None], reflectance, weights, np.exp(ln_blocking_sd**2 / 2))[0].reshape(data.y.shape)
    return replace(data, y=values, covariance=EXACT_NOISE**2 * data.covariance, tolerances=None)


def judged_alone(case: Case, signals: Any, options: FitOptions, seed: int, exact: bool) -> dict[str, Any]:
    """Return the judged curve and scalars of the learned prior's posterior alone."""
    data = exact_data(case, signals, options.prior.ln_blocking_sd) if exact else band_data(signals)
    rng = np.random.default_rng(seed)
    spectra = options.spectra or learned_spectra()
    found = fit_spectrum(data, spectra, options.prior.ln_blocking_sd, ALONE_DRAWS, rng)
    draws = conserving_draws(found, data).curves
    band = curve_bands(draws)
    pointwise = (band.low95, band.high95)
    limits = {"curve95": pointwise, "curve68": (band.low68, band.high68), "whole_in_pointwise": pointwise}
    row = curve_row(case.truth, band.mean, {**limits, "simultaneous95": simultaneous_band(draws)})
    mode, fwhm, peak = scalars(case.truth)
    quantities = curve_quantities(draws, OUT_NM)
    values = {"mode_nm": mode, "fwhm_nm": fwhm, "peak_per_nm": peak, "energy_yield": float(case.truth.sum())}
    for name, value in values.items():
        for level in (95, 68):
            low, high = np.quantile(getattr(quantities, name), [0.5 - level / 200, 0.5 + level / 200])
            row[f"{name}:{level}"] = bool(low <= value <= high)
    return row | rgb(case, draws, case.truth)


def judged(case: Case, fit: PaintCalibration) -> dict[str, Any]:
    """Return errors, and whether each interval holds the truth."""
    truth, draws = case.truth, fit.emission_draws_per_nm
    pointwise = (fit.emission_low95_per_nm, fit.emission_high95_per_nm)
    low, high = fit.emission_low95_simultaneous_per_nm, fit.emission_high95_simultaneous_per_nm
    row = curve_row(
        truth,
        fit.emission_per_nm,
        {
            "curve95": pointwise,
            "curve68": (fit.emission_low68_per_nm, fit.emission_high68_per_nm),
            "whole_in_pointwise": pointwise,
            "simultaneous95": None if low is None or high is None else (low, high),
        },
    )
    mode, fwhm, peak = scalars(truth)
    energy = float(truth.sum())
    reflectance = float(np.interp(LASER_NM, NM, case.paint.reflectance))
    values = {"mode_nm": mode, "fwhm_nm": fwhm, "peak_per_nm": peak, "energy_yield": energy}
    for name, value in {**values, "reflectance_at_laser": reflectance}.items():
        told = fit.parameters[name]
        row[name] = [value, told.estimate, told.sd]
        row[f"{name}:95"], row[f"{name}:68"] = told.low95 <= value <= told.high95, told.low68 <= value <= told.high68
    told = fit.reradiation.stokes_shift_nm
    row["stokes"] = [*case.shifts, told.estimate, told.low95, told.high95, told.sd]
    row["stokes:95"] = told.low95 <= case.shifts[0] <= told.high95
    row["stokes:68"] = told.low68 <= case.shifts[0] <= told.high68
    row["stokes_of_largest:95"] = told.low95 <= case.shifts[1] <= told.high95
    row["stokes_measured"] = not fit.reradiation.prior_driven
    row |= rgb(case, draws, truth)
    row["warnings"] = [w[:60] for w in fit.warnings]
    row["family"], row["method"] = fit.family, fit.diagnostics.method
    row["partly"] = list(fit.mostly_prior)
    return row


def rgb(case: Case, draws: Floats, truth: Floats) -> dict[str, Any]:
    """Return whether the emission as a camera sees it lies inside the draws, channels jointly."""
    response = np.array([c(OUT_NM) for c in case.rig.optics.camera_response])
    seen, real = np.log(draws @ response.T + 1e-12), np.log(response @ truth + 1e-12)
    mean, sd = seen.mean(0), seen.std(0) + 1e-4
    apart = np.sort((np.abs(seen - mean) / sd).max(axis=1))
    own = float((np.abs(real - mean) / sd).max())
    at = {level: apart[min(int(level * len(apart)), len(apart) - 1)] for level in (0.95, 0.68)}
    return {
        "rgb:95": own <= at[0.95],
        "rgb:68": own <= at[0.68],
        "rgb_error": float(np.abs(np.exp(mean - real) - 1).max()),
    }


def run(spectra: Path, out: Path, cases: int, every: int, alone: bool, rig: str) -> None:
    """Add the cases that the file lacks."""
    done = {(r["name"], r["case"]) for r in stored(out)}
    cameras = ["assumed", *(str(path.resolve()) for path in sorted((spectra / "cameras").glob("*.csv")))]
    chosen = list(excited(spectra / "dyes.csv").items())[::every]
    priors = left_out_priors(spectra)
    out.parent.mkdir(parents=True, exist_ok=True)
    for number in range(cases):
        for name, curves in chosen:
            if (name, number) in done:
                continue
            case = Case(name, number, curves, cameras)
            if rig == "sharp":
                case.rig.optics = case.rig.optics.model_copy(update={"band_uncertainty": SHARP})
            row: dict[str, Any] = {"name": name, "case": number, "yield": float(case.column.sum() * STEP_NM)}
            row["runs_out"] = case.runs_out
            if alone:
                row |= judged_alone(case, case.signals(name), priors(name), number, rig == "exact")
            else:
                fit = calibrate_paint(case.signals(name), number, priors(name))
                row |= judged(case, fit) if isinstance(fit, PaintCalibration) else {"group": "no emission"}
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row, default=lambda v: v.item()) + "\n")


def left_out_priors(spectra: Path) -> Callable[[str], FitOptions]:
    """Return what gives the options of a fit that has not seen a fluorophore or one like it."""
    from benchmarks.learn_measured_spectra import alike, curves, learned

    names, rows = curves(spectra)
    return cache(lambda name: FitOptions(spectra=learned(rows[~alike(names, rows, name)])))


def stored(out: Path) -> list[dict[str, Any]]:
    """Return the cases of a file."""
    return [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()] if out.exists() else []


def clustered(rows: list[dict[str, Any]], key: str) -> tuple[float, float]:
    """Return the mean over cases and its standard error with fluorophores as clusters."""
    by_name: dict[str, list[float]] = {}
    for row in rows:
        if key in row:
            by_name.setdefault(row["name"], []).append(float(row[key]))
    if not by_name:
        return float("nan"), float("nan")
    means = np.array([np.mean(values) for values in by_name.values()])
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(means.size)) if means.size > 1 else float("nan")


KEYS = (
    "curve95", "curve68", "whole_in_pointwise", "simultaneous95", "mode_nm:95", "mode_nm:68", "fwhm_nm:95",
    "fwhm_nm:68",
    "peak_per_nm:95", "peak_per_nm:68", "energy_yield:95", "energy_yield:68", "reflectance_at_laser:95", "stokes:95",
    "stokes:68", "stokes_of_largest:95", "rgb:95", "rgb:68", "width",
)  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of the measured shares, all and by group."""
    fitted = [r for r in rows if "error" in r]
    names = len({r["name"] for r in rows})
    lines = [f"{len(rows)} cases of {names} fluorophores; no emission found in {len(rows) - len(fitted)}"]
    sets = {"all": fitted, **{g: [r for r in fitted if r["group"] == g] for g in GROUPS}}
    sets = {name: chosen for name, chosen in sets.items() if chosen}
    lines.append(f"{'':24s}" + "".join(f"{f'{n} ({len(c)})':>18s}" for n, c in sets.items()))
    for label, how in (("error: median", np.median), ("error: mean", np.mean)):
        lines.append(f"{label:24s}" + "".join(f"{how([r['error'] for r in c]):18.3f}" for c in sets.values()))
    for key in KEYS:
        cells = [clustered(c, key) for c in sets.values()]
        lines.append(f"{key:24s}" + "".join(f"{f'{mean:.3f} +- {se:.3f}':>18s}" for mean, se in cells))
    warned: dict[str, int] = {}
    if not any("warnings" in r for r in fitted):
        return "\n".join(lines)
    for row in fitted:
        for text in row["warnings"]:
            warned[text[-45:]] = warned.get(text[-45:], 0) + 1
    shares = {"any warning": [bool(r["warnings"]) for r in fitted], "partly prior": [bool(r["partly"]) for r in fitted]}
    shares["Stokes shift measured"] = [r["stokes_measured"] for r in fitted]
    lines += [f"{name:24s}{np.mean(hits):18.3f}" for name, hits in shares.items()]
    lines += [f"  {count:4d}  {text}" for text, count in sorted(warned.items(), key=lambda item: -item[1])]
    return "\n".join(lines)


def main() -> int:
    """Run cases or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spectra", type=Path, required=True, help="folder with dyes.csv and cameras/")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=1, help="paints of each fluorophore")
    parser.add_argument("--every", type=int, default=1, help="only each so many-th fluorophore")
    parser.add_argument("--spectrum-alone", action="store_true", help="judge only the spectrum of the learned prior")
    parser.add_argument("--rig", choices=("usual", "sharp", "exact"), default="usual", help="how well the rig is known")
    parser.add_argument("--table", action="store_true", help="only print the table of the stored cases")
    arguments = parser.parse_args()
    if arguments.rig == "exact" and not arguments.spectrum_alone:
        parser.error("--rig exact needs --spectrum-alone")
    if not arguments.table:
        alone = arguments.spectrum_alone
        run(arguments.spectra, arguments.out, arguments.cases, arguments.every, alone, arguments.rig)
    rows = stored(arguments.out)
    print(table(rows))
    if any("runs_out" in row for row in rows):
        print("\nof records that run out where they count:\n" + table([r for r in rows if r.get("runs_out")]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
