"""The conventions of the code base, checked: names, units, sizes, what the command line loads."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from data_schemas.json_schemas import STORED, WRITTEN_BY_PEOPLE

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("data_schemas", "rigs", "finray_calib", "sim")
MODULES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))
# A face lists the names of its room, and is as long as they are many.
LONGEST_MODULE = 670
DUMPING_GROUNDS = {"util", "utils", "helper", "helpers", "common", "misc", "core", "base", "tools"}
UNIT = re.compile(
    r"_(nm|mm|mm2|mm3|px|s|deg|mpa|n|kg|dn|e|mw|ma|rel|od|db|dn2|k|j|per_j|per_nm|per_s|e_per_dn|e_per_s|dn_per_s|per_px|mm_per_px"
    r"|m_per_s2|n_per_mm|n_per_mm2|n_per_count|days|hz)$"
)
# Dimensionless by their nature: a name is allowed when one of these is a whole word of it.
DIMENSIONLESS_WORDS = frozenset(
    {
        "acceptance",
        "alpha",
        "chi",
        "chi2",
        "correlation",
        "cosine",
        "exponent",
        "factor",
        "fraction",
        "friction",
        "hat",
        "index",
        "kappa",
        "ln",
        "order",
        "ratio",
        "reflectance",
        "regret",
        "share",
        "skewness",
        "skill",
        "ssim",
        "tan",
        "transmission",
        "yield",
    }
)
# Names that say no unit and why that is right; a new one needs a suffix, or a reason to stand here.
EXCEPTIONS = {
    **dict.fromkeys(
        ("estimate", "sd", "low", "high", "low68", "high68", "low95", "high95", "mean", "value", "truth"),
        "a summary of another quantity, in its unit",
    ),
    **dict.fromkeys(("low90", "high90", "margin", "difference", "standard_uncertainty"), "of another, in its unit"),
    **dict.fromkeys(("first", "second"), "a metric of two studies, in its unit"),
    **dict.fromkeys(("mean_square", "variance"), "of values of any unit, in its square"),
    **dict.fromkeys(("p", "pooled_above", "risk"), "probability"),
    "size_pt": "points, as matplotlib counts",
    "laser_white": "stands below exposure_s of bands.toml, in s",
    **dict.fromkeys(("focus", "best_focus"), "squared gradient over squared signal"),
    **dict.fromkeys(("snr", "least_snr"), "signal over its noise"),
    "half_width": "of an interval, in the unit of its value",
    "p_within_5deg": "probability",
    **dict.fromkeys(("blanks_above", "false_alarm"), "share of blanks"),
    "yield_limit": "emitted over incident energy",
    **dict.fromkeys(("statistic_sd", "threshold_sd", "shift_sd"), "a number of standard deviations"),
    "p_within_tolerance": "probability",
    **dict.fromkeys(("nu", "smoothness"), "of a Matern covariance, a number"),
    "tolerance": "in the unit of the numbers that are compared",
    **dict.fromkeys(("probability", "posterior_predictive_p", "p_conform"), "probability"),
    "guard": "of a quantity under test, in its unit",
    "reflected_laser": "share of the laser's light that the sample reflects",
    **dict.fromkeys(("effective", "effective_samples"), "a number of samples"),
    **dict.fromkeys(("limit", "tried", "nominal", "given", "half_range"), "of a field of a design, in its unit"),
    **dict.fromkeys(("residual", "allowed", "noise"), "of a result of any unit, in its unit"),
    **dict.fromkeys(("together_low95", "together_high95"), "limits of a factor"),
    **dict.fromkeys(("q2", "unexplained_high"), "share of a variance"),
    "electrons_per_radiance": "electrons of the camera per relative radiance",
    "sign": "-1 or 1",
    "left_out_bands": "a sum of log densities, nats",
    "left_out_bands_sd": "its standard error, nats",
    "difference_sd": "of log densities, nats",
    **dict.fromkeys(("halved", "doubled"), "shift of a mean, in its standard deviations"),
    "chi_square_p": "probability",
    **dict.fromkeys(("slope", "slope_uncertainty"), "of a line through points of any units"),
    "k": "exposure factor, as in the paper",
    "u": "its relative uncertainty",
    "z": "standard score of a curve's shape",
    "turn": "-1 or +1: which way a surface is oriented",
    "step": "in the unit of the parameter that is moved",
    "start": "a share of a whole, 0 to 1",
    "abbe_number": "ratio of refractivity to dispersion",
    "bulk_over_shear": "ratio of two moduli",
    "scale": "of image values of any unit",
    "autocorrelation_times": "a count of autocorrelation times",
    "memory": "a correlation",
    "least_effective": "a number of samples",
    "reflected_laser_median": "share of reflected laser light",
    "amplitude": "h of the paper's skew-Cauchy",
    "width_in": "inches, as matplotlib counts",
    "height_in": "inches, as matplotlib counts",
    "seconds": "a duration in words",
    **dict.fromkeys(("ciede2000_mean", "ciede2000_p95"), "colour difference, as CIE 142 counts"),
    **dict.fromkeys(("flip", "flip_mean"), "visible difference, 0 to 1"),
    **dict.fromkeys(("rms", "noise_rms", "mean_red", "mean_green"), "of chromaticities, shares of light"),
    **dict.fromkeys(("scale_x", "scale_y"), "ratio of two pixel sizes"),
    **dict.fromkeys(("c1", "c2"), "of SSIM, in the square of the images' unit"),
}
HEAVY = ("numpy", "scipy", "matplotlib", "mitsuba", "cv2", "colour", "emcee", "pydantic", "rich", "skimage", "tifffile")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_is_one_subject(path):
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST_MODULE or path.name == "__init__.py", f"{path} has {lines} lines: is it one subject?"
    assert path.stem not in DUMPING_GROUNDS


def functions() -> Iterator[tuple[Path, ast.FunctionDef]]:
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                yield path, node


def test_functions_are_short():
    lengths = [(node.end_lineno or 0) - node.lineno + 1 for _, node in functions()]
    too_long = [
        f"{path.relative_to(ROOT)}:{node.name}"
        for path, node in functions()
        if len(ast.unparse(_without_docstring(node)).splitlines()) > 70
    ]
    assert not too_long
    assert sorted(lengths)[len(lengths) // 2] <= 35


def _without_docstring(node: ast.FunctionDef) -> ast.FunctionDef:
    body = [n for n in node.body if not (isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant))]
    return ast.FunctionDef(**{**{f: getattr(node, f) for f in node._fields}, "body": body or [ast.Pass()]}, lineno=1)


def models() -> Iterator[type[BaseModel]]:
    seen: set[type[BaseModel]] = set()
    waiting: list[type[BaseModel]] = [*WRITTEN_BY_PEOPLE, *STORED]
    while waiting:
        model = waiting.pop()
        if model in seen:
            continue
        seen.add(model)
        yield model
        for field in model.model_fields.values():
            waiting += _models_in(field.annotation)


def _models_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for inner in getattr(annotation, "__args__", ()) for m in _models_in(inner)]


@pytest.mark.parametrize("model", sorted(models(), key=lambda m: m.__name__), ids=lambda m: m.__name__)
def test_every_stored_float_says_its_unit(model):
    for name, field in model.model_fields.items():
        if field.annotation is float or field.annotation == (float | None):
            assert says_its_unit(name), f"{model.__name__}.{name} has no unit suffix"


def says_its_unit(name: str) -> bool:
    return bool(UNIT.search(name)) or name in EXCEPTIONS or not DIMENSIONLESS_WORDS.isdisjoint(name.split("_"))


FLOAT = re.compile(r"(Annotated\[)?float\b(?!\])|float \| None|None \| float")


def public_floats(source: str) -> Iterator[str]:
    """Yield "function(parameter)" and "Class.field" of everything public in a module that is annotated float."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef) and not (node.name.startswith("_") and node.name != "__init__"):
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            yield from (f"{node.name}({a.arg})" for a in arguments if _is_float(a.annotation))
        if isinstance(node, ast.ClassDef):
            fields = [n for n in node.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]
            yield from (f"{node.name}.{f.target.id}" for f in fields if _is_float(f.annotation))


def _is_float(annotation: ast.expr | None) -> bool:
    return annotation is not None and FLOAT.match(ast.unparse(annotation)) is not None


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_public_float_says_its_unit(path):
    named = list(public_floats(path.read_text(encoding="utf-8")))
    assert [n for n in named if not says_its_unit(re.split(r"[.(]", n)[1].rstrip(")"))] == []


def test_a_float_without_unit_is_found():
    source = (
        "def f(length: float, width_mm: float, n: int, _x: str, *, gain: float | None = None): ...\n"
        "def _private(length: float): ...\n"
        "class C:\n    tilt: float = 0.0\n    sds: Annotated[float, Field(ge=0)] = 1.0\n"
        "    many: tuple[float, ...] = ()\n"
    )
    found = list(public_floats(source))
    assert found == ["f(length)", "f(width_mm)", "f(gain)", "C.tilt", "C.sds"]
    for name in ("length", "gain", "tilt", "sds", "mysd", "shareholder", "time"):
        assert not says_its_unit(name)
    for name in ("width_mm", "sd", "diffuse_share", "refractive_index"):
        assert says_its_unit(name)


def test_every_exception_is_still_needed():
    names = {re.split(r"[.(]", n)[1].rstrip(")") for p in MODULES for n in public_floats(p.read_text(encoding="utf-8"))}
    stored = {name for model in models() for name in model.model_fields}
    assert set(EXCEPTIONS) <= names | stored
    assert {word for name in names | stored for word in name.split("_")} >= DIMENSIONLESS_WORDS


def test_help_loads_nothing_heavy_and_is_quick(tmp_path):
    code = (
        "import sys, time; start = time.process_time()\n"
        "from finray_calib.cli.main import build_parser; build_parser().format_help()\n"
        f"loaded = [m for m in {HEAVY!r} if m in sys.modules]\n"
        "sys.exit(f'loaded {loaded}' if loaded else 0 if time.process_time() - start < 0.3 else 'slow')"
    )
    # as installed: the first try compiles the modules; environments of tests often forbid to keep that
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(tmp_path)}
    command = [sys.executable, "-c", code]
    for _ in range(5):  # the least of five: what else the machine does adds to processor time, and never takes from it
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=environment)
        if done.stderr.strip() != "slow":
            break
    assert done.returncode == 0, done.stderr


def test_every_error_of_the_tree_is_drawn_and_used():
    source = (ROOT / "data_schemas/errors.py").read_text(encoding="utf-8")
    names = re.findall(r"^class (\w+)\(", source, flags=re.MULTILINE)
    docstring = ast.get_docstring(ast.parse(source)) or ""
    everything = "\n".join(p.read_text(encoding="utf-8") for p in MODULES if p.name != "errors.py")
    for name in names:
        assert name in docstring
        assert re.search(rf"\b{name}\(", everything) or name == "FinrayError", f"{name} is never raised"


def test_nothing_names_a_particular_machine():
    pattern = re.compile(r"(?<![\w.])/(work|home|root|farm)/")
    files = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    for name in files:
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".j2", ".yml"} and path != Path(__file__):
            assert not pattern.search(path.read_text(encoding="utf-8")), name


LOOKUP_DOOR = ROOT / "sim" / "optics" / "_path_rules.py"
# what reads or writes by a computed place, and what makes an integer of a float
BY_PLACE = re.compile(
    r"(packet_)?gather|scatter(_\w+)?|eval_(1|3|cubic|fetch)\w*|U?Int(8|16|32|64)?|u?int\w*_array_t|slice"
)
WITHOUT_LANES = re.compile(r"\d+|[A-Z_]+|[A-Z_]+ if [\w.]+ else [A-Z_]+")
# call, and why no lane can leave anything by it
SAFE_CALLS = {
    "mi.UInt32(start)": "a constant of sim.optics._panel_light",
    "self.scatter(si, si.bsdf(ray), sampler, direction, on_coat, active)": "scatters light at a surface",
    "paths.scatter(si, bsdf, sampler, direction, on_coat, active)": "the same, of paths from the coat",
    "mi.UInt32(k)": "the number of a paint, counted by Python",
    "self.rays.eval_cubic(place, active, force_nonaccel=True)": "the renderer's own texture holds its places within",
}


def calls_by_place(source: str) -> Iterator[str]:
    """Look-ups of the renderer's lanes, and casts to integers of what may differ from lane to lane."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and BY_PLACE.fullmatch(node.func.attr):
            arguments = ", ".join(ast.unparse(argument) for argument in node.args)
            if "nt" not in node.func.attr or not WITHOUT_LANES.fullmatch(arguments):
                yield ast.unparse(node)


def test_lanes_look_up_by_one_door_only():
    found = {
        path.relative_to(ROOT): set(calls_by_place(path.read_text(encoding="utf-8")))
        for path in MODULES
        if re.search("drjit|mitsuba", path.read_text(encoding="utf-8"))
    }
    assert found.pop(LOOKUP_DOOR.relative_to(ROOT))
    around = {f"{path}: {call}" for path, calls in found.items() for call in calls - set(SAFE_CALLS)}
    assert not around, f"read and write by sim.optics._path_rules, which no lane can leave: {sorted(around)}"
    assert set(SAFE_CALLS) == {call for calls in found.values() for call in calls}


def test_a_way_around_the_door_of_lookups_is_found():
    calls = "dr.gather(mi.Float, t, i)", "dr.scatter_add(t, v, i)", "mi.UInt32(x)", "mi.Int32(dr.floor(x))"
    assert list(calls_by_place("\n".join(calls))) == list(calls)
    assert not list(calls_by_place("mi.UInt32(0)\nmi.UInt32(FROM_EYE)\nmi.UInt32(ONE if self.wall else OTHER)\nint(x)"))
