"""The numbers that this version must reach: what, against what, the bar, what was measured, and whether it is met.

    python benchmarks/table.py bench-out

Reads what the other benchmarks left in a folder. A row whose benchmark has not run names the command that measures
it. Exit status 1 when a measured row misses its bar or, with --complete, when a row is not measured.
"""

import argparse
import json
import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MODELS = ("default", "zheng2014", "skew_t", "log_normal_wavenumber", "gaussian_mixture")
PIXEL_FAMILIES = ("zheng2014", "log_normal_wavenumber")
NOT_RUN = math.nan


@dataclass(frozen=True)
class Row:
    """One line of the table: a number of one file between two limits."""

    what: str
    against: str
    command: str
    file: str
    number: Callable[[Any], float]
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def measured(self, folder: Path) -> float:
        """Return the number, NaN when its benchmark has not run."""
        path = folder / self.file
        if not path.exists():
            return NOT_RUN
        parse = _properties if path.suffix == ".xml" else lambda p: json.loads(p.read_text())
        try:
            return float(self.number(parse(path)))
        except KeyError:
            return NOT_RUN

    @property
    def bar(self) -> str:
        if math.isinf(self.high):
            return f"at least {self.low:g}{self.unit}"
        return (
            f"at most {self.high:g}{self.unit}" if math.isinf(self.low) else f"{self.low:g} to {self.high:g}{self.unit}"
        )


def rows() -> list[Row]:
    """Return the table, in the order in which it is printed."""
    table = []
    for model, against, bar in (
        ("five parameters", "emcee, Python loop", 300.0),
        ("five parameters", "emcee, vectorised", 100.0),
        ("five parameters", "NumPyro NUTS", 1000.0),
        ("default model", "emcee, vectorised", 30.0),
    ):
        what = f"effective samples per second, {model}"
        table.append(Row(what, against, "samplers.py", "samplers.json", _ratio(model, against), low=bar, unit="x"))
        what = f"posterior means and sds, {model}, standard errors"
        table.append(Row(what, against, "samplers.py", "samplers.json", _largest_z(model, against), high=4.5))
    for family in PIXEL_FAMILIES:
        for key, what, limits in (
            ("ratio", "pixels per second of processor time", {"low": 300.0, "unit": "x"}),
            ("seconds", "1.3 MP", {"high": 15.0, "unit": " s"}),
            ("peak_mb", "largest memory", {"high": 2000.0, "unit": " MB"}),
        ):
            number = _property(f"test_pixels_per_second[{family}]", key)
            against = "scipy least_squares" if key == "ratio" else "-"
            table.append(Row(f"pixel maps, {family}: {what}", against, "pytest", "pytest.xml", number, **limits))
    left_out = ("leave_one_material_out.py", "left-out.json")
    what = "full-spectrum error, one material left out"
    table.append(Row(what, "the paper's family", *left_out, lambda r: r["ratio"], high=0.55, unit="x"))
    what = "coverage of 95 % bands, one material left out"
    table.append(Row(what, "nominal", *left_out, lambda r: r["coverage95"], low=0.90, high=0.98))
    for model in MODELS:
        calibration = ("simulation_based_calibration.py", f"sbc-{model}.json")
        what = f"calibration, {model}"
        table.append(Row(f"{what}: worst miss of 95 %", "uniform", *calibration, _worst_miss, high=3.0, unit=" points"))
        table.append(Row(f"{what}: least p after Holm", "uniform", *calibration, _least_p, low=0.01))
    command = ("fit_command_time.py", "fit-command.json")
    table.append(Row("finray fit, whole process, warm", "-", *command, lambda r: r["warm_s"], high=3.0, unit=" s"))
    table.append(Row("finray fit, whole process, cold", "-", *command, lambda r: r["cold_s"], high=20.0, unit=" s"))
    table.append(
        Row(
            "paint session over exposures and moves",
            "-",
            "session_time.py",
            "session-time.json",
            lambda r: r["ratio"],
            high=1.15,
            unit="x",
        )
    )
    return [*table, *_comparison_rows(), *_decision_rows(), *_optics_rows(), *_mechanics_rows()]


def _comparison_rows() -> list[Row]:
    """Return the rows of compare."""
    throughput = ("comparison_throughput.py", "comparison-throughput.json")
    table = [
        Row(
            "finray compare, 1,000 pairs of 640 x 480",
            "-",
            *throughput,
            lambda r: r["seconds_1000"],
            high=60.0,
            unit=" s",
        ),
        Row("SSIM", "scikit-image", *throughput, lambda r: r["ssim_ratio"], low=3.0, unit="x"),
        Row("CIEDE2000", "colour-science", *throughput, lambda r: r["ciede2000_ratio"], low=3.0, unit="x"),
    ]
    twins = ("digital_twins.py", "digital-twins.json")
    for quantity in ("skill", "red rms", "green rms", "blue rms", "gradient", "objective"):
        what = f"95 % interval of the {quantity} holds the truth, of 60 twins"
        table.append(Row(what, "hidden fingers", *twins, _held(quantity), low=52.0, high=60.0))
    return table


def _decision_rows() -> list[Row]:
    """Return the rows of decide."""
    decision = ("light_angle_decision.py", "light-angle-decision.json")
    return [
        Row("claimed less actual hit rate, 3,000 curves", "-", *decision, lambda r: r["largest_miss"], high=0.05),
        Row("overclaimed under a foreign model error", "-", *decision, lambda r: r["largest_overclaim"], high=0.05),
        Row("regret", "argmax of means", *decision, _regret("ratio_means"), low=2.8, unit="x"),
        Row("regret", "single-shot", *decision, _regret("ratio_single"), low=4.0, unit="x"),
    ]


def _optics_rows() -> list[Row]:
    """Return the rows of the renderer."""
    levels, image = ("fluorescence_levels.py", "fluorescence-levels.json"), ("whole_image_time.py", "whole-image.json")
    table = []
    for band in ("red", "green"):
        what = f"{band} band, variance at equal time"
        table.append(Row(what, "paths (level c)", *levels, _of_band(band, "variance_gain"), low=5.0, unit="x"))
        table.append(
            Row(f"{band} band, bias beyond its errors", "paths (level c)", *levels, _bias(band), high=1.5, unit=" %")
        )
    return [
        *table,
        Row(
            "LED band, variance at equal time", "Mitsuba's path", *image,
            lambda r: r["led_variance_gain"], low=4.0, unit="x",
        ),
        Row(
            "picture of 320 x 240 with bakes, time", "Mitsuba's path", *image,
            lambda r: r["time_ratio"], high=1.5, unit="x",
        ),
        Row("largest memory, whole picture", "-", *image, lambda r: r["memory_gb"], high=2.0, unit=" GB"),
        Row(
            "sweep of 13 angles at equal noise", "13 images", "angle_sweep_speed.py", "angle-sweep.json",
            lambda r: r["equal_noise_ratio"], low=20.0, unit="x",
        ),
    ]  # fmt: skip


def _of_band(band: str, number: str) -> Callable[[Any], float]:
    return lambda record: float(record[band][number])


def _bias(band: str) -> Callable[[Any], float]:
    """Return how far level b is from level c beyond three combined errors, in per cent."""
    return lambda record: 100 * (abs(record[band]["ratio"] - 1) - 3 * record[band]["error"])


def _mechanics_rows() -> list[Row]:
    """Return the rows of the pressed finger."""
    engines = ("mechanics_engines.py", "mechanics-engines.json")
    meshes = ("finger_mesh_convergence.py", "finger-mesh-convergence.json")
    presses = ("finger_press_times.py", "finger-press-times.json")
    return [
        Row(
            "force, coarse finger, 3 mm",
            "CalculiX",
            *engines,
            lambda r: 100 * r["force_difference_rel"],
            high=3.0,
            unit=" %",
        ),
        Row("field of the pad", "CalculiX", *engines, lambda r: 100 * r["pad_difference_rel"], high=2.0, unit=" %"),
        Row(
            "processor time of the whole command, coarse finger",
            "CalculiX",
            *engines,
            lambda r: r["speed_ratio"],
            low=5.0,
            unit="x",
        ),
        Row("force on the medium mesh", "fine mesh", *meshes, _medium_to_fine, high=2.0, unit=" %"),
        Row(
            "largest memory, fine mesh",
            "-",
            *meshes,
            lambda r: r["meshes"]["fine"]["largest_memory_gb"],
            high=8.0,
            unit=" GB",
        ),
        Row("one increment, fine mesh", "-", *meshes, lambda r: r["meshes"]["fine"]["wall_s"], high=240.0, unit=" s"),
        Row("coarse press to 2 mm", "-", *presses, _of_press("coarse, 2 mm", "wall_s"), high=25.0, unit=" s"),
        Row("medium press to 5 mm", "-", *presses, _of_press("medium, 5 mm", "wall_s"), high=150.0, unit=" s"),
        Row(
            "largest memory, medium press to 5 mm",
            "-",
            *presses,
            _of_press("medium, 5 mm", "largest_memory_gb"),
            high=1.5,
            unit=" GB",
        ),
        Row("presses to 10 mm that get there, of 5", "-", *presses, _reached_10_mm, low=5.0, high=5.0),
        Row(
            "stiff over soft finger, least over dimensions",
            "-",
            "finray study finger-stiffness",
            "finger-stiffness/finger-stiffness.json",
            lambda r: min(order["smallest_ratio"] for order in r["record"]["orders"]),
            low=1.0,
        ),
    ]


def _of_press(name: str, number: str) -> Callable[[Any], float]:
    return lambda record: float(record["presses"][name][number])


def _reached_10_mm(record: Any) -> float:
    """Return how many pushes to 10 mm ended there, without the medium one with friction, which is shown only."""
    coarse = [f"coarse, 10 mm, {body}{rough}" for body in ("cylinder", "cuboid") for rough in ("", ", friction 0.3")]
    return float(sum(record["presses"][name]["reached"] for name in [*coarse, "medium, 10 mm, cylinder"]))


def _medium_to_fine(record: Any) -> float:
    meshes = record["meshes"]
    return 100 * abs(float(meshes["medium"]["force_n"]) / float(meshes["fine"]["force_n"]) - 1)


def _held(quantity: str) -> Callable[[Any], float]:
    def count(record: Any) -> float:
        if record["twins"] != 60:
            raise KeyError("another number of twins than the bar is for")
        return float(record["covered"][quantity])

    return count


def _regret(against: str) -> Callable[[Any], float]:
    return lambda record: record["cases"]["8 % of the hill"][against]


def _ratio(model: str, against: str) -> Callable[[Any], float]:
    return lambda record: record["models"][model]["ratios"][against]


def _largest_z(model: str, against: str) -> Callable[[Any], float]:
    return lambda record: record["models"][model]["largest_z"][against]


def _property(test: str, name: str) -> Callable[[Any], float]:
    return lambda properties: properties[test][name]


def _worst_miss(record: Any) -> float:
    return 100 * max(abs(row["coverage95"] - 0.95) for row in record["table"].values())


def _least_p(record: Any) -> float:
    return min(row["p_holm"] for row in record["table"].values())


def _properties(path: Path) -> Mapping[str, Mapping[str, str]]:
    """Return what the tests of a JUnit file recorded with record_property, by test name."""
    cases = ET.parse(path).getroot().iter("testcase")
    return {c.attrib["name"]: {p.attrib["name"]: p.attrib["value"] for p in c.iter("property")} for c in cases}


def main() -> int:
    """Print the table; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--complete", action="store_true", help="a row that is not measured counts as missed")
    arguments = parser.parse_args()
    missed = 0
    print(f"{'what':62s} {'against':20s} {'bar':18s} {'measured':>12s}")
    for row in rows():
        value = row.measured(arguments.folder)
        if math.isnan(value):
            cell, verdict = "-", f"not measured: {row.command}"
            missed += arguments.complete
        else:
            met = row.low <= value <= row.high
            cell, verdict = (
                f"{value:.3g}{row.unit}" if value < 1000 else f"{value:.0f}{row.unit}",
                "met" if met else "MISSED",
            )
            missed += not met
        print(f"{row.what:62s} {row.against:20s} {row.bar:18s} {cell:>12s}  {verdict}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
