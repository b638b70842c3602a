"""The tutorials run as they are printed, one after the other in one folder, with small pictures and few paths."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from data_schemas import LightAngleDecision, PaintCalibration, PhotometricErrorReport
from data_schemas.storage import read_record
from finray_calib.cli.main import build_parser
from tests.command_line.running import edit, finray

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
BLOCK = re.compile(r"^```(sh|toml)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
CHEAPER = {
    "--samples 32": "--samples 2",
    "--angles 0:120:10": "--angles 0:120:30 --samples 200",
    # it is refused whatever its walls emit, and this level traces no light to them
    "--out turned.press.json": "--out turned.press.json --level a",
}
SMALL_REGION = "row_px = 200\ncolumn_px = 264\nheight_px = 110\nwidth_px = 110"
WORDS_OF_A_TUTORIAL = 600


def pages() -> list[str]:
    """Return the pages in the order in which the first one lists them."""
    return re.findall(r"^\| \[[^\]]+\]\(([\w-]+\.md)\)", (TUTORIALS / "README.md").read_text(), flags=re.MULTILINE)


def follow(page: str, folder: Path) -> None:
    """Write the files and run the commands of a page, in its order."""
    for kind, text in BLOCK.findall((TUTORIALS / page).read_text(encoding="utf-8")):
        if kind == "toml":
            name = re.match(r"# (\S+\.toml)\n", text)
            assert name, f"{page}: a file without its name"
            small = text.replace("row_px = 402\ncolumn_px = 530\nheight_px = 220\nwidth_px = 220", SMALL_REGION)
            (folder / name[1]).write_text(small, encoding="utf-8")
            continue
        for line in text.splitlines():
            run(line, folder)


def run(line: str, folder: Path) -> None:
    """Run a printed command, rendering less."""
    if not line.startswith("finray "):
        subprocess.run(["bash", "-euc", line], cwd=folder, check=True)
        return
    for printed, cheaper in CHEAPER.items():
        line = line.replace(printed, cheaper)
    outcome = finray(line.removeprefix("finray "))
    assert outcome.status == 0, f"{line}\n{outcome.err}"
    if line.startswith("finray rig init"):
        rig = folder / line.split()[-1]
        rig.write_text(rig.read_text().replace("width_px = 1280", "width_px = 640").replace("= 1024", "= 512"))
    if line.startswith("finray design init"):
        edit(folder / "finger.toml", "width_px = 640\nheight_px = 480", "width_px = 320\nheight_px = 240")


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which all tutorials are followed."""
    return tmp_path_factory.mktemp("tutorials")


@pytest.fixture
def followed(desk: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """Follow a page, and those before it that were not followed yet."""
    monkeypatch.chdir(desk)
    for page in pages()[: pages().index(request.param) + 1]:
        done = desk / f"{page}.done"
        if not done.exists():
            follow(page, desk)
            done.touch()
    return desk


def test_the_list_of_tutorials_is_whole():
    assert sorted([*pages(), "README.md"]) == sorted(path.name for path in TUTORIALS.glob("*.md"))
    assert len(pages()) == 5


@pytest.mark.parametrize("page", pages())
def test_a_tutorial_is_short(page):
    prose = BLOCK.sub("", (TUTORIALS / page).read_text(encoding="utf-8"))
    assert len(prose.split()) <= WORDS_OF_A_TUTORIAL


@pytest.mark.parametrize("followed", ["first-paint.md"], indirect=True)
def test_the_first_paint_has_the_mode_of_the_page_and_of_the_bench(followed):
    page = (TUTORIALS / "first-paint.md").read_text(encoding="utf-8")
    printed = re.search(r"mode +(\S+) \[(\S+), (\S+)\] nm", page)
    assert printed
    mode_nm = read_record(followed / "red.paint.json", PaintCalibration).mode_nm
    # half as many pixels as on the page have other noise: a tenth of the interval, which is that of filters and lamp
    width_nm = float(printed[3]) - float(printed[2])
    found_nm = (mode_nm.estimate, mode_nm.low95, mode_nm.high95)
    assert found_nm == pytest.approx([float(printed[k]) for k in (1, 2, 3)], abs=0.1 * width_nm)
    assert mode_nm.low95 < 597.0 < mode_nm.high95  # of [simulated.paint]
    assert (followed / "red.html").is_file()


@pytest.mark.parametrize("followed", ["first-finger.md"], indirect=True)
def test_the_first_finger_is_pressed_and_rendered(followed):
    for name in ("finger.mechanics.png", "finger.png", "touch.press.json", "touch.optics/README.txt"):
        assert (followed / name).is_file(), name


@pytest.mark.parametrize("followed", ["first-comparison.md"], indirect=True)
def test_the_first_comparison_ends_with_a_report_and_a_refusal(followed):
    report = read_record(followed / "error.json", PhotometricErrorReport)
    assert report.headline_skill.low95 <= 1.0
    assert (followed / "error.html").is_file()
    refused = finray("compare turned.press.json built.capture.json --out refused.json")
    assert refused.status == 2
    assert "40" in refused.err
    assert "30" in refused.err


@pytest.mark.parametrize("followed", ["light-for-your-finger.md"], indirect=True)
def test_a_light_is_decided_on_with_its_doubts(followed):
    assert (followed / "light-angle-decision.html").is_file()
    decision = (followed / "light-angle-decision.json").read_text(encoding="utf-8")
    # with the few paths of this test the renders may be too noisy to choose at all
    assert re.search(r'"verdict": "(needs captures|undecided)"', decision)
    checked = read_record(followed / "checked.json", LightAngleDecision)
    assert "error.json" in checked.provenance.input_sha256


@pytest.mark.parametrize("followed", ["rig-on-the-practice-bench.md"], indirect=True)
def test_mistakes_on_the_practice_bench_are_found(followed):
    refused = finray("capture wrong-plan.toml --rig rig.toml --out wrong")
    assert refused.status == 2
    assert "excitation_filter" in refused.err
    assert finray("verify session").status == 1
    assert finray("radiometry session --out changed.bands.json").status == 2
    assert "frames" in finray("radiometry session --out changed.bands.json").err


@pytest.mark.parametrize("page", ["README.md", *pages()])
def test_every_inline_command_is_understood(page):
    text = (TUTORIALS / page).read_text(encoding="utf-8")
    lines = [line for line in re.findall(r"`(finray [^`]+)`", text) if "..." not in line]
    for line in lines:
        assert build_parser().parse_args(shlex.split(line)[1:])
