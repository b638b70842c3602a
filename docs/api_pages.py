"""Write docs/reference, a page for each face of the code, from the code: ``make reference``.

A face is the ``__init__.py`` of a folder: its ``__all__`` lists what others may use. The code is read, not imported, so
that the pages need no package and come out the same on every machine. A test fails when they differ from the code.
"""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "reference"
PACKAGES = ("finray_calib", "sim", "rigs", "data_schemas")
BESIDE = {
    "tactile-captures.md": "Tactile captures in one container: a layout that any program can write",
    "files-that-are-read.md": "Files that are read: formats, limits, what is refused, how it was tried",
    "tables-of-band-signals.md": "Tables of band signals: a paint that was measured by other means, as numbers",
    "rooms.md": "Packages of the code and what they import",
    "practice-faults.md": "Faults of the simulated rig, to practise on",
    "extend-finray.md": "Extend finray from a package of your own: ten kinds, a protocol and a contract each",
    "checks-of-a-rig.md": "Checks of a rig: what each one measures, and when it passes",
    "faults-that-charts-see.md": "Faults of a rig, and how soon control charts see them",
    "paper-experiments.md": "The paper's experiments: what it says, what the studies give, why they differ",
    "moduli-by-force-curves.md": "Moduli by force curves: what is given, fitted and not known; derivatives of a press",
    "other-simulators.md": "Other simulators of touch, and when to take them",
    "published-fin-ray.md": "A published Fin Ray finger, pressed: force and direction against measured ones",
    "taught-surrogates.md": "Surrogates of a finger: presses in milliseconds, and how far they are off",
    "times-to-light-off.md": "How long a light stays on when processes are killed or stopped",
    "scale-of-studies.md": "Studies on many machines, and what a million points cost",
    "frames-for-other-programs.md": "Frames for other programs: OME-TIFF, NeXus, bluesky documents and devices",
    "ros2.md": "Frames in ROS 2, by an example",
    "keys-of-json-results.md": "Keys of the results that `--json` prints, for scripts",
    "stage-and-load-cell.md": "A stage that presses, and a load cell that stops it: rig file, plan, what stops it",
    "only-hardware-can-show.md": "What only hardware can show, and what shows it on your rig",
}
"""Pages of the folder that are not of a face -> what they hold."""
HEAD = "Generated from the code by `make reference`. It lists what other packages may import."


class Defined(NamedTuple):
    """Where an exported name is defined: file, and the statement."""

    file: Path
    node: ast.stmt


def faces() -> list[str]:
    """Return the dotted names of all folders with a face, the library first."""
    found = [path.parent for package in PACKAGES for path in sorted((ROOT / package).rglob("__init__.py"))]
    return [".".join(folder.relative_to(ROOT).parts) for folder in found if exported(folder / "__init__.py")]


def exported(init: Path) -> list[str]:
    """Return the names of a face's ``__all__``."""
    for node in _parsed(init).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return [name for name in ast.literal_eval(node.value) if not name.startswith("__")]
    return []


def defined(name: str, file: Path) -> Defined:
    """Follow a name from a face to the statement that defines it.

    Raises
    ------
    LookupError
        It leads nowhere.
    """
    for node in ast.walk(_parsed(file)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return Defined(file, node)
        if isinstance(node, ast.Assign | ast.AnnAssign) and name in map(ast.unparse, _targets(node)):
            return Defined(file, node)
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                if name == (alias.asname or alias.name):
                    return defined(alias.name, _file_of(node.module))
    raise LookupError(f"{file}: exports {name}, which is defined nowhere")


def _targets(node: ast.Assign | ast.AnnAssign) -> list[ast.expr]:
    """Return what a statement gives a value to, each name by itself."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return [one for target in targets for one in (target.elts if isinstance(target, ast.Tuple) else [target])]


@cache
def _parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def _file_of(module: str) -> Path:
    """Return the file of a module or folder of this project."""
    path = ROOT.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def page(face: str) -> str:
    """Return the page of a face."""
    init = _file_of(face)
    names = exported(init)
    found = {name: defined(name, init) for name in names}
    kinds = {
        "Functions": [n for n in names if isinstance(found[n].node, ast.FunctionDef)],
        "Classes": [n for n in names if isinstance(found[n].node, ast.ClassDef)],
        "Constants and types": [n for n in names if isinstance(found[n].node, ast.Assign | ast.AnnAssign)],
    }
    text = re.sub(r"^(?:\.\. math:: |(?=>>> ))", "    ", ast.get_docstring(_parsed(init)) or "", flags=re.MULTILINE)
    parts = [f"# {face}", text, HEAD]
    for title, members in kinds.items():
        if members:
            parts += [f"## {title}", "\n".join(_entry(name, found[name]) for name in members)]
    return "\n\n".join(parts) + "\n"


def _entry(name: str, found: Defined) -> str:
    """Return the line of one name: how it is called, its docstring's first line, its file."""
    file = found.file.relative_to(ROOT).as_posix()
    where = f"[{found.file.stem}](../../{file})"
    if isinstance(found.node, ast.Assign | ast.AnnAssign):
        return f"- `{name}` {where}"
    text = (ast.get_docstring(found.node) or "").split("\n\n")[0].replace("\n", " ")
    return f"- **`{_written(found.node)}`** {text} {where}"


def _written(node: ast.stmt) -> str:
    """Return how a function is called and what it returns, or a class with its bases; parameters say their unit."""
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(map(ast.unparse, node.bases))
        return node.name + (f"({bases})" if bases else "")
    assert isinstance(node, ast.FunctionDef)  # noqa: S101 - the caller has sorted them
    after = f" -> {ast.unparse(node.returns).strip(chr(39))}" if node.returns else ""
    return f"{node.name}({_parameters(node.args)}){after}"


def _parameters(given: ast.arguments) -> str:
    """Return the parameters with their defaults, without types."""
    bare = ast.arguments(
        posonlyargs=[ast.arg(a.arg) for a in given.posonlyargs],
        args=[ast.arg(a.arg) for a in given.args],
        vararg=None if given.vararg is None else ast.arg(given.vararg.arg),
        kwonlyargs=[ast.arg(a.arg) for a in given.kwonlyargs],
        kw_defaults=given.kw_defaults,
        kwarg=None if given.kwarg is None else ast.arg(given.kwarg.arg),
        defaults=given.defaults,
    )
    return ast.unparse(bare)


def index() -> str:
    """Return the page that lists the faces."""
    rows = [f"| [{face}]({face}.md) | {_purpose(face)} |" for face in faces()]
    beside = [f"- [{what}]({name})" for name, what in BESIDE.items()]
    table = ["| package | what it is for |", "|---|---|", *rows]
    return "\n".join(["# Reference", "", HEAD, "", *table, "", "Other pages:", "", *beside, ""])


def _purpose(face: str) -> str:
    return (ast.get_docstring(_parsed(_file_of(face))) or "").split("\n")[0]


def pages() -> dict[str, str]:
    """Return file name -> text of all pages."""
    return {"README.md": index(), **{f"{face}.md": page(face) for face in faces()}}


def main() -> None:
    """Write the pages; those of faces that are gone are removed."""
    PAGES.mkdir(exist_ok=True)
    made = pages()
    for old in PAGES.glob("*.md"):
        if old.name not in made and old.name not in BESIDE:
            old.unlink()
    for name, text in made.items():
        (PAGES / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
