"""The first example of the README runs as it is printed; what would render for minutes is read from a file."""

import re
import shlex
from pathlib import Path

import pytest

import finray_calib as finray
from data_schemas.storage import read_record
from finray_calib.cli.main import build_parser

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")


def block(language: str, holding: str) -> str:
    """Return the one fenced block that holds a text."""
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    (found,) = [text for kind, text in blocks if kind == language and holding in text]
    return found


def test_the_library_example_runs(lab, tmp_path, monkeypatch):
    for name in ("bands.json", "capture.json"):
        (tmp_path / name).symlink_to(lab / name)
    for stored in lab.glob("bands.*.npz"), lab.glob("capture.*.npz"):
        for path in stored:
            (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    rendered = []

    def stored_press(design, *, red, green):
        rendered.append((finray.finger_design(design).name, red.paint_name, green))
        return finray.read_record(lab / "press.json")

    monkeypatch.setattr(finray, "render_press", stored_press)
    names: dict[str, object] = {}
    exec(compile(block("python", "import finray_calib as finray"), "README.md", "exec"), names)
    assert rendered == [("flat-70x35", "red", "green.paint.json")]
    assert re.fullmatch(r"\d{3}\.\d \[\d{3}\.\d, \d{3}\.\d\] nm", str(names["paint"].mode_nm))
    assert (tmp_path / "paint.svg").is_file()
    report = read_record(tmp_path / "report.json", finray.PhotometricErrorReport)
    assert re.fullmatch(r"[01]\.\d+ \[[01]\.\d+, [01]\.\d+\]", str(report.headline_skill))
    assert f"{tmp_path}/capture.json".endswith(next(iter(report.provenance.input_sha256)))


@pytest.mark.parametrize("line", block("", "finray compare flat").splitlines())
def test_the_commands_beside_it_are_valid(line):
    assert build_parser().parse_args(shlex.split(line)[1:]).run
