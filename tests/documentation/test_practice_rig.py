"""The how-to pages can be followed on the rig without devices: their commands run as printed, and find the paint."""

import re
from pathlib import Path

import pytest

from data_schemas import PaintCalibration
from data_schemas.storage import read_record
from tests.command_line.running import finray
from tests.documentation.test_how_to_files import COMMAND, INDENTED_PLAN, printed_file, text_of

LEFT_OUT = {
    "--map": "a minute of processor time; tests/fit/test_pixel_maps.py",
    "red-again.bands.json": "needs two more sessions; tests/fit/test_repeated_sessions.py",
    "--other-light": "needs a second session, with another laser in the rig file",
    "render": "needs the green paint too; tests/command_line/test_optics_verbs.py",
}


def commands_of(page: str) -> list[str]:
    return [line for line in COMMAND.findall(text_of(page)) if not any(word in line.split() for word in LEFT_OUT)]


def test_the_pages_of_paint_camera_and_check_run_on_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (camera_plan,) = INDENTED_PLAN.findall(text_of("characterise-a-camera.md"))
    Path("camera.toml").write_text(re.sub(r"^ {7}", "", camera_plan, flags=re.MULTILINE), encoding="utf-8")
    Path("plan.toml").write_text(printed_file("calibrate-a-paint.md", "plan.toml"), encoding="utf-8")
    Path("check.toml").write_text(printed_file("check-a-rig.md", "check.toml"), encoding="utf-8")
    Path("finger-check.toml").write_text(printed_file("check-a-rig.md", "finger-check.toml"), encoding="utf-8")
    Path("finger").mkdir()
    paint = commands_of("calibrate-a-paint.md")
    camera = [line for line in commands_of("characterise-a-camera.md") if "red-session" not in line]
    assert paint[0] == "finray rig init --preset simulated --out rig.toml"
    characterised = paint.index("finray capture plan.toml --rig rig.toml --out red-session")  # step 5 comes before
    for line in (*paint[:characterised], *commands_of("check-a-rig.md"), *camera, *paint[characterised:]):
        outcome = finray(line.removeprefix("finray "))
        assert outcome.status == 0, f"{line}: {outcome.err}"
    mode_nm = read_record(Path("red.paint.json"), PaintCalibration).mode_nm
    assert mode_nm.low95 < 597.0 < mode_nm.high95  # of [simulated.paint]
    written = {path.name for path in tmp_path.iterdir()}
    assert written >= {"red.html", "red.csv", "camera.json", "lab-rig-check", "finger-check"}
