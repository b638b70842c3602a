"""The shape of the tree: how wide its folders are, whether each has a face, how splintered, how deep, how long.

A module is a Python file other than ``__init__.py``. Faces are not counted where imports are: what goes through one
binds rooms, not files.
"""

import ast
import collections
import graphlib
import io
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.architecture.test_conventions import PACKAGES, ROOT

# four more than before: files of presses, their labels, surveys of folders and tables of band signals are subjects of
# their own
MOST_MODULES = 333
MOST_IN_A_FOLDER = 24
LONGEST_CHAIN = 11
LARGEST_SINGLE_CALLER_SHARE = 0.144
SILENT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}
LONGEST_FUNCTION_LINES = 45
MOST_PARAMETERS = 8
# loops of the renderer and of an element, whose state is one: cut apart, they pass all of it on
MOST_LONG_FUNCTIONS = 4
# two compiled kernels, which take plain arrays only, and the proof of filters by the line of the laser
MOST_WITH_MANY_PARAMETERS = 3


@dataclass(frozen=True)
class Function:
    """A function or method: where it stands, lines of code without its docstring, and parameters, ``self`` too."""

    place: str
    lines: int
    parameters: int


@dataclass
class Tree:
    """What the source says of its modules and faces, by dotted name.

    Attributes
    ----------
    modules
        Modules.
    faces
        Packages; True for those whose ``__init__`` has a docstring and a non-empty ``__all__``.
    imports
        Module -> modules that it imports, wherever in its text.
    imports_at_start
        The same at module level only: what is loaded with it.
    functions
        Functions and methods, wherever they are defined.
    """

    modules: set[str] = field(default_factory=set)
    faces: dict[str, bool] = field(default_factory=dict)
    imports: dict[str, set[str]] = field(default_factory=dict)
    imports_at_start: dict[str, set[str]] = field(default_factory=dict)
    functions: list[Function] = field(default_factory=list)

    def width(self) -> collections.Counter[str]:
        """Return the number of modules of each folder."""
        return collections.Counter(_room(module) for module in self.modules)

    def single_callers(self) -> dict[str, str]:
        """Return the modules that exactly one other module imports, which lies in the same folder, and that one."""
        importers: dict[str, list[str]] = collections.defaultdict(list)
        for importer, targets in self.imports.items():
            for target in targets:
                importers[target].append(importer)
        lone = {target: found[0] for target, found in importers.items() if len(found) == 1}
        return {target: importer for target, importer in lone.items() if _room(importer) == _room(target)}

    def longest_chain(self) -> list[str]:
        """Return the modules on the longest path of imports at module level, the lowest first."""
        chains: dict[str, list[str]] = {}
        for module in graphlib.TopologicalSorter(self.imports_at_start).static_order():
            below = max((chains[m] for m in self.imports_at_start[module]), key=len, default=[])
            chains[module] = [*below, module]
        return max(chains.values(), key=len)


def _room(module: str) -> str:
    return module.rpartition(".")[0]


def read_tree(root: Path, packages: Iterable[str]) -> Tree:
    """Read the packages below `root`; nothing is imported."""
    texts = {
        ".".join(path.relative_to(root).with_suffix("").parts): path.read_text(encoding="utf-8")
        for package in packages
        for path in sorted((root / package).rglob("*.py"))
    }
    sources = {name: ast.parse(text) for name, text in texts.items()}
    tree = Tree(modules={name for name in sources if not name.endswith(".__init__")})
    for name, source in sources.items():
        tree.functions += _functions(name, texts[name])
        if name in tree.modules:
            tree.imports[name] = set(_imported(ast.walk(source))) & tree.modules - {name}
            tree.imports_at_start[name] = set(_imported(source.body)) & tree.modules - {name}
        else:
            tree.faces[name.removesuffix(".__init__")] = _is_face(source)
    return tree


def _imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute: ruff TID252"
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _functions(module: str, text: str) -> Iterator[Function]:
    source = ast.parse(text)
    code = _code_lines(text, source)
    for node in ast.walk(source):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            count = len(given.posonlyargs) + len(given.args) + len(given.kwonlyargs)
            lines = sum(line in code for line in range(node.lineno, int(node.end_lineno or node.lineno) + 1))
            yield Function(f"{module}.{node.name}", lines, count)


def _code_lines(text: str, source: ast.Module) -> set[int]:
    """Return the lines that hold code: not blank, no comment, no docstring."""
    used = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in SILENT
        for line in range(token.start[0], token.end[0] + 1)
    }
    bare = (node for node in ast.walk(source) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
    return used - {line for node in bare for line in range(node.lineno, int(node.end_lineno or node.lineno) + 1)}


def _is_face(source: ast.Module) -> bool:
    exported = [
        node.value
        for node in source.body
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets)
    ]
    names = [name for value in exported if isinstance(value, ast.List | ast.Tuple) for name in value.elts]
    return bool(ast.get_docstring(source)) and bool(names)


@pytest.fixture(scope="module")
def tree() -> Tree:
    return read_tree(ROOT, PACKAGES)


def test_no_folder_is_too_wide_to_be_read(tree):
    wide = {folder: n for folder, n in tree.width().items() if n > MOST_IN_A_FOLDER}
    assert not wide, f"more than {MOST_IN_A_FOLDER} modules: find the rooms in it, or what is one subject"


def test_the_tree_is_not_splintered(tree):
    assert len(tree.modules) <= MOST_MODULES
    single = tree.single_callers()
    listed = "\n".join(f"{module} <- {importer}" for module, importer in sorted(single.items()))
    assert len(single) / len(tree.modules) <= LARGEST_SINGLE_CALLER_SHARE, (
        f"a file that only its neighbour uses is part of it, unless readers look for its subject:\n{listed}"
    )


def test_every_package_has_a_face(tree):
    without = sorted(package for package, is_face in tree.faces.items() if not is_face)
    assert not without, "an __init__.py says what the room is for and exports what others may use (__all__)"


def test_imports_do_not_go_round_and_their_chains_are_short(tree):
    chain = tree.longest_chain()
    assert len(chain) <= LONGEST_CHAIN, " <- ".join(chain)


def test_functions_are_short_but_for_a_few(tree):
    long = sorted(f"{f.place}: {f.lines} lines" for f in tree.functions if f.lines > LONGEST_FUNCTION_LINES)
    assert len(long) <= MOST_LONG_FUNCTIONS, "\n".join(long)


def test_functions_take_few_parameters_but_for_a_few(tree):
    many = sorted(f"{f.place}: {f.parameters} parameters" for f in tree.functions if f.parameters > MOST_PARAMETERS)
    assert len(many) <= MOST_WITH_MANY_PARAMETERS, (
        "what travels together is one thing, if it is a subject of the field:\n" + "\n".join(many)
    )


class TestFiguresOfASmallTree:
    @pytest.fixture
    def root(self, tmp_path) -> Path:
        room = tmp_path / "house" / "room"
        room.mkdir(parents=True)
        (tmp_path / "house" / "__init__.py").write_text('"""A house without a door."""\n__all__ = []\n')
        (room / "__init__.py").write_text(
            '"""A room."""\n'
            "from house.room._floor import BOARD\n"
            "from house.room._wall import WALL\n"
            '__all__ = ["WALL"]\n'
        )
        (room / "_floor.py").write_text("BOARD = 1\n")
        (room / "_wall.py").write_text("from house.room._floor import BOARD\nWALL = BOARD\n")
        (tmp_path / "house" / "roof.py").write_text(
            "from house.room import _wall\n\ndef late():\n    from house import cellar\n    return cellar\n"
        )
        (tmp_path / "house" / "cellar.py").write_text("DARK = True\n")
        return tmp_path

    def test_they_are_as_counted_by_hand(self, root):
        tree = read_tree(root, ["house"])
        assert tree.width() == {"house": 2, "house.room": 2}
        assert tree.faces == {"house": False, "house.room": True}
        assert tree.single_callers() == {"house.room._floor": "house.room._wall", "house.cellar": "house.roof"}
        assert tree.longest_chain() == ["house.room._floor", "house.room._wall", "house.roof"]

    def test_functions_are_measured_as_counted_by_hand(self, root):
        (root / "house" / "cellar.py").write_text(
            "DARK = True\n\n\nclass Lamp:\n    def light(\n        self, watts, *, lamp_mm=1.0\n    ):\n"
            '        """Light.\n\n        Brightly.\n        """\n'
            "        # why\n\n        return (\n            watts\n"
            "        )\n"
        )
        functions = {f.place: f for f in read_tree(root, ["house"]).functions}
        assert functions["house.cellar.light"] == Function("house.cellar.light", lines=6, parameters=3)
        assert functions["house.roof.late"] == Function("house.roof.late", lines=3, parameters=0)

    def test_imports_that_go_round_are_found(self, root):
        (root / "house" / "room" / "_floor.py").write_text("from house.room._wall import WALL\n")
        with pytest.raises(graphlib.CycleError):
            read_tree(root, ["house"]).longest_chain()
