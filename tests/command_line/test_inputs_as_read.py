"""Provenance holds the SHA-256 of the bytes that a command parsed, though its inputs are replaced while it works.

Each command runs twice. The first run counts how often it reads each file; in the second, every input is replaced by
other bytes right after its last reading, before anything is computed from it.
"""

import ast
import json
import shutil
from collections import Counter
from pathlib import Path

import pytest

from data_schemas.storage import _foreign_files as foreign_files
from data_schemas.storage import sha256_of
from tests.command_line.running import succeed

ROOT = Path(__file__).resolve().parents[2]
VERBS = {
    "radiometry": ("radiometry {0}/session --out {0}/new.json", ["session/session.json"]),
    "fit": ("fit {0}/bands.json --out {0}/new.json", ["bands.json"]),
    "compare": ("compare {0}/press.json {0}/capture.json --out {0}/new.json", ["press.json", "capture.json"]),
    "decide": (
        "decide {0}/sweep.json --photometric-error {0}/report.json --out {0}/new.json",
        ["sweep.json", "report.json"],
    ),
    "capture": ("capture {0}/plan.toml --rig {0}/rig.toml --out {0}/new", ["plan.toml", "rig.toml"]),
    "export": ("export {0}/red/paint.json --format csv --out {0}/new.csv", ["red/paint.json"]),
}


@pytest.fixture
def folder(lab: Path, paints: Path, tmp_path: Path) -> Path:
    copied = tmp_path / "lab"
    shutil.copytree(lab, copied)
    shutil.copytree(paints / "red", copied / "red")
    return copied


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch):
    """Count what is read; replace files after so many readings."""
    count: Counter[Path] = Counter()
    replace_after: dict[Path, int] = {}
    original = foreign_files._AS_READ.remember  # noqa: SLF001

    def remember(path: Path, digest: str) -> None:
        original(path, digest)
        place = Path(path).resolve()
        count[place] += 1
        if replace_after.get(place) == count[place]:
            place.unlink()
            place.write_bytes(b"another file, put here while the command works\n")

    monkeypatch.setattr(foreign_files._AS_READ, "remember", remember)  # noqa: SLF001
    return count, replace_after


def stored_inputs(folder: Path) -> dict[str, str]:
    """The inputs that a new product names."""
    if (folder / "new.csv").is_file():
        lines = (folder / "new.csv").read_text().splitlines()
        named = (line.removeprefix("# from: ").rsplit(", SHA-256 ", 1) for line in lines if ", SHA-256 " in line)
        return {name.split("from: ")[-1]: digest for name, digest in named}
    path = folder / "new/session.json" if (folder / "new").is_dir() else folder / "new.json"
    return dict(json.loads(path.read_text())["record"]["provenance"]["input_sha256"])


@pytest.mark.parametrize("verb", VERBS)
def test_replaced_inputs_are_stored_as_they_were_read(verb, folder, readings, tmp_path):
    command, names = VERBS[verb]
    count, replace_after = readings
    before = {(folder / name).as_posix(): sha256_of(folder / name) for name in names}
    rehearsal = tmp_path / "rehearsal"
    shutil.copytree(folder, rehearsal)
    succeed(command.format(rehearsal))
    for name in names:
        replace_after[(folder / name).resolve()] = count[(rehearsal / name).resolve()]
    succeed(command.format(folder))
    assert stored_inputs(folder) == before
    for path, digest in before.items():
        assert sha256_of(Path(path)) != digest  # it really was replaced


def test_no_verb_hashes_an_input_a_second_time():
    """All provenance of the verbs comes from what the gateway remembers; what hashes files anew is for trace."""
    allowed = {"finray_calib/demo/_run.py", "finray_calib/lineage/_trace.py"}
    hashing = {"sha256_of", "file_digest"}
    found = {
        path.relative_to(ROOT).as_posix()
        for package in ("finray_calib", "sim")
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Name | ast.Attribute) and getattr(node, "id", getattr(node, "attr", "")) in hashing
    }
    assert found == allowed
