"""The conventions of the code base, checked: names, units, sizes, what the command line loads."""

import ast
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
DUMPING_GROUNDS = {"util", "utils", "helper", "helpers", "common", "misc", "core", "base", "tools"}
UNIT = re.compile(
    r"_(nm|mm|px|s|deg|mpa|n|dn|e|mw|rel|od|db|dn2|k|per_nm|per_s|e_per_dn|e_per_s|dn_per_s|per_px|mm_per_px)$"
)
# Dimensionless by their nature, or named by a standard term whose unit is fixed.
DIMENSIONLESS = re.compile(
    r"(reflectance|transmission|fraction|share|skewness|alpha|index|chi_square|factor|skill|ssim|regret|probability|"
    r"p_within_5deg|regret_95|posterior_predictive_p|yield|estimate|low68|high68|low95|high95|sd|weight|maxima|"
    r"acceptance|shape_order|autocorrelation|r_hat|effective_samples|map_estimate|variance)"
)
HEAVY = ("numpy", "scipy", "matplotlib", "mitsuba", "cv2", "colour", "emcee", "pydantic", "rich", "skimage", "tifffile")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_is_one_room(path):
    lines = path.read_text(encoding="utf-8").count("\n")
    assert lines <= 500, f"{path} has {lines} lines; split it"
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
            assert UNIT.search(name) or DIMENSIONLESS.search(name), f"{model.__name__}.{name} has no unit suffix"


def test_help_loads_nothing_heavy_and_is_quick():
    code = (
        "import sys, time; start = time.perf_counter()\n"
        "from finray_calib.cli.main import build_parser; build_parser().format_help()\n"
        f"loaded = [m for m in {HEAVY!r} if m in sys.modules]\n"
        "sys.exit(f'loaded {loaded}' if loaded else 0 if time.perf_counter() - start < 0.3 else 'slow')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
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
