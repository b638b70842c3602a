"""Default output names are plain names in the working directory, whatever a paint or finger is called."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from finray_calib.cli._run import LONGEST_NAME, file_name
from tests.command_line.running import edit, finray, succeed


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("red", "red"),
        ("red paint (2nd) v1.2+", "red-paint-(2nd)-v1.2+"),
        ("../../evil", "evil"),
        ("a\0b", "a-b"),
        ("/etc/passwd", "etc-passwd"),
        ("-rf", "rf"),
        ("...", "unnamed"),
        ("", "unnamed"),
        ("x" * 300, "x" * 80),
    ],
)
def test_file_name(name: str, expected: str) -> None:
    assert file_name(name) == expected


@given(name=st.text())
def test_any_name_becomes_a_plain_file_name(name: str) -> None:
    plain = file_name(name)
    assert re.fullmatch(r"[A-Za-z0-9_(+)][A-Za-z0-9_.()+-]*", plain)
    assert Path(plain).name == plain
    assert len(plain) <= LONGEST_NAME


@pytest.mark.parametrize("name", ["../../evil", "a\\u0000b"])
def test_default_outputs_stay_in_the_working_directory(
    name: str, lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "one" / "two"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    plain = {"../../evil": "evil", "a\\u0000b": "a-b"}[name]
    (here / "plan.toml").write_text((lab / "plan.toml").read_text())
    edit(here / "plan.toml", 'paint_name = "red"', f'paint_name = "{name}"')
    assert f"\n{plain}-session: " in succeed(f"capture plan.toml --rig {lab}/rig.toml")
    assert succeed(f"radiometry {plain}-session").startswith(f"{plain}.bands.json: ")
    assert succeed(f"fit {plain}.bands.json").startswith(f"{plain}.paint.json: ")
    assert {p.name for p in tmp_path.iterdir()} == {"one"}
    assert {p.name for p in (tmp_path / "one").iterdir()} == {"two"}


@pytest.mark.shared_data
def test_import_without_prediction_minds_its_own_file_only(shared_data: Path, tmp_path: Path) -> None:
    sensors = shared_data / "tactile" / "9dtact"
    (tmp_path / "one.press.json").write_text("mine")
    outcome = finray(
        f"import 9dtact {sensors}/sensor_1 --predict-from {sensors}/sensor_2 --out {tmp_path}/one.capture.json"
    )
    assert outcome.status == 2
    assert "one.press.json: exists already and is not overwritten" in outcome.err
    succeed(f"import 9dtact {sensors}/sensor_1 --out {tmp_path}/one.capture.json")
    assert (tmp_path / "one.press.json").read_text() == "mine"
