"""Files and commands that the how-to pages print are valid as printed."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from data_schemas import NO_ADDRESS, BandFolder, CameraPlan, CertificateDetails, CheckPlan, PaintPlan, RigFile
from data_schemas._check import CheckLimits
from data_schemas.storage import read_toml
from finray_calib.cli.main import build_parser
from rigs.capture import camera_step, check_filters, paint_steps
from sim.studies import SHIPPED_PLANS, read_plan, study_points

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"
PAGES = sorted(HOW_TO.glob("*.md"))
FENCED = re.compile(r"^```toml\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
INDENTED_PLAN = re.compile(r'^ +kind = "camera"\n(?:(?: +.*)?\n)+?(?=^ *Optional)', flags=re.MULTILINE)
COMMAND = re.compile(r"^ +(finray .+?)(?: +#.*)?$", flags=re.MULTILINE)
RECORD_OF = {
    "rig.toml": RigFile,
    "plan.toml": PaintPlan,
    "bands.toml": BandFolder,
    "check.toml": CheckPlan,
    "laboratory.toml": CertificateDetails,
}


def text_of(page: str) -> str:
    return (HOW_TO / page).read_text(encoding="utf-8")


def printed_file(page: str, name: str) -> str:
    """Return the TOML block of a page that opens with a comment naming the file, or the page's only one."""
    blocks = FENCED.findall(text_of(page))
    named = [block for block in blocks if block.startswith(f"# {name}\n")] or blocks
    assert len(named) == 1
    return named[0]


def read_as_user(text: str, name: str, folder: Path):
    """Read a printed file the way the command line reads it."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_toml(path, RECORD_OF.get(name, CameraPlan))


def commands() -> list[tuple[str, str]]:
    found = [(page.name, line) for page in PAGES for line in COMMAND.findall(page.read_text(encoding="utf-8"))]
    return [(page, line) for page, line in found if not line.endswith("\\")]


def test_rig_and_plan_of_the_paint_page_go_together(tmp_path):
    rig = read_as_user(printed_file("calibrate-a-paint.md", "rig.toml"), "rig.toml", tmp_path)
    plan = read_as_user(printed_file("calibrate-a-paint.md", "plan.toml"), "plan.toml", tmp_path)
    steps = paint_steps(plan, rig)
    assert {step.filter_name for step in steps if step.frame_type == "fluorescence"} == {
        f.name for f in rig.filter_wheel.filters
    }


def test_commented_lines_of_the_plan_are_valid_too(tmp_path):
    rig = read_as_user(printed_file("calibrate-a-paint.md", "rig.toml"), "rig.toml", tmp_path)
    text = printed_file("calibrate-a-paint.md", "plan.toml")
    uncommented = re.sub(r"^# (?=\w+ = )", "", text, flags=re.MULTILINE)
    assert uncommented.count("\nsecond_tilt") == 2
    plan = read_as_user(uncommented, "plan.toml", tmp_path)
    assert {step.tilt_deg for step in paint_steps(plan, rig)} == {0.0, plan.second_tilt_deg}


def test_printed_rig_states_every_number_of_laser_and_camera():
    loaded = tomllib.loads(printed_file("calibrate-a-paint.md", "rig.toml"))
    fields = RigFile.model_fields
    for table in ("camera", "laser", "lamp", "white_reference"):
        unused = {"address"} if loaded[table].get("driver") in NO_ADDRESS else set()
        if loaded[table].get("driver") == "arduino":
            unused |= {"outside_layer"}  # its firmware is one; the page on lasers prints the table for others
        assert set(loaded[table]) == set(fields[table].annotation.model_fields) - unused


def test_camera_plan_of_the_camera_page_fits_the_rig(tmp_path):
    (indented,) = INDENTED_PLAN.findall(text_of("characterise-a-camera.md"))
    plan = read_as_user(re.sub(r"^ {7}", "", indented, flags=re.MULTILINE), "camera.toml", tmp_path)
    rig = read_as_user(printed_file("calibrate-a-paint.md", "rig.toml"), "rig.toml", tmp_path)
    assert camera_step(plan, rig).filter_name == plan.filter_name


def test_check_plan_states_every_limit_as_it_is_by_default_and_fits_the_rig(tmp_path):
    text = printed_file("check-a-rig.md", "check.toml")
    plan = read_as_user(text, "check.toml", tmp_path)
    assert set(tomllib.loads(text)["limits"]) == set(CheckLimits.model_fields)
    assert plan.limits == CheckLimits()
    rig = read_as_user(printed_file("calibrate-a-paint.md", "rig.toml"), "rig.toml", tmp_path)
    assert check_filters(plan, rig) == list(rig.filter_wheel.filters)


def test_bands_file_of_the_import_page_is_valid(tmp_path):
    folder = read_as_user(printed_file("import-band-images.md", "bands.toml"), "bands.toml", tmp_path)
    assert folder.excitation_filter in {f.name for f in folder.filters}


@pytest.mark.parametrize(("page", "line"), commands(), ids=lambda text: text)
def test_every_printed_command_is_understood(page, line):
    assert build_parser().parse_args(shlex.split(line)[1:]).run


def test_commands_are_found_at_all():
    lines = [line for page, line in commands() if page == "calibrate-a-paint.md"]
    assert {line.split()[1] for line in lines} == {"rig", "capture", "radiometry", "fit", "simulate", "export"}


def test_file_of_the_laboratory_is_valid(tmp_path):
    details = read_as_user(printed_file("certify-a-paint.md", "laboratory.toml"), "laboratory.toml", tmp_path)
    assert [reference.of for reference in details.references] == ["white reference"]
    assert details.limits[0].quantity == "mode_nm"


def test_plans_of_the_study_page_make_points(tmp_path):
    blocks = FENCED.findall(text_of("run-a-design-study.md"))
    counts = []
    for block in blocks:
        (tmp_path / "plan.toml").write_text(block, encoding="utf-8")
        counts.append(len(study_points(*read_plan(tmp_path / "plan.toml"))))
    assert counts == [9, 64]
    assert all(f"| `{name}` |" in text_of("run-a-design-study.md") for name in SHIPPED_PLANS)
