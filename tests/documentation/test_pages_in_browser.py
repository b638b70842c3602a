"""The pages of a comparison and a decision in a real browser: on a screen, on a phone and on paper."""

import re
import subprocess
from pathlib import Path

import pytest
from example_records import example_results

from finray_calib.reports import comparison_page, decision_page
from tests.capture.drivers.programs import require

RESULTS = example_results()
PAGES = {
    "comparison": lambda: comparison_page(RESULTS.report, RESULTS.press, RESULTS.capture, "finray compare", {}),
    "decision": lambda: decision_page(RESULTS.decision, [RESULTS.sweep], "finray decide", {}),
}
A4_PT = (595, 842)
PROBE = """<script>
addEventListener("load", () => {
  const images = [...document.images].every((image) => image.complete && image.naturalWidth > 0);
  const page = document.documentElement;
  const read = JSON.parse(document.getElementById("summary").textContent);
  document.title = `width ${page.scrollWidth} of ${page.clientWidth}, images ${images}, command ${read.command}`;
});
</script>"""

pytestmark = pytest.mark.rigs


@pytest.fixture(params=sorted(PAGES))
def page(request, tmp_path) -> Path:
    path = tmp_path / f"{request.param}.html"
    path.write_text(PAGES[request.param](), encoding="utf-8")
    return path


def chromium(folder: Path, *options: str) -> str:
    """Run the browser without a window and return what it wrote."""
    command = [require("chromium", "chromium"), "--headless=new", "--no-sandbox", f"--user-data-dir={folder}/profile"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True, timeout=600)
    return done.stdout


@pytest.mark.parametrize("width_px", [1280, 400])
def test_nothing_sticks_out_on_screen_or_phone_and_every_image_is_shown(page, tmp_path, width_px):
    """The page itself holds no script: one is put in to measure. A frame makes a phone of a window of 500 px."""
    probed = tmp_path / "probed.html"
    probed.write_text(page.read_text(encoding="utf-8").replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(
        f'<iframe src="probed.html" style="width:{width_px}px; height:2000px; border:0" '
        'onload="setTimeout(() => { document.title = this.contentDocument.title; }, 200)"></iframe>',
        encoding="utf-8",
    )
    dom = chromium(
        tmp_path,
        "--window-size=1400,900",
        "--allow-file-access-from-files",
        "--virtual-time-budget=4000",
        "--dump-dom",
        f"file://{frame}",
    )
    told = re.search(r"<title>width (\d+) of (\d+), images (\w+), command finray (\w+)</title>", dom)
    assert told is not None, dom[:400]
    assert int(told[1]) <= int(told[2]) <= width_px
    assert told[3] == "true"


def test_the_slider_has_a_name_and_moves_the_border_by_its_value(tmp_path):
    """Arrow keys are the browser's own on such an input; what they cause is caused here."""
    move = """<script>addEventListener("load", () => {
      const pair = document.querySelector(".pair"), slider = pair.querySelector("input");
      slider.focus();
      for (let step = 0; step < 25; step += 1) slider.stepUp();
      slider.dispatchEvent(new Event("input"));
      const [below, above] = [...pair.querySelectorAll("img")].map((image) => image.getBoundingClientRect());
      document.title = [slider.type, slider.getAttribute("aria-label"), document.activeElement === slider,
        getComputedStyle(pair.querySelectorAll("img")[1]).clipPath, below.top === above.top,
        below.left === above.left].join("|");
    });</script>"""
    page = tmp_path / "slider.html"
    page.write_text(PAGES["comparison"]().replace("</body>", f"{move}</body>"), encoding="utf-8")
    dom = chromium(tmp_path, "--window-size=1400,900", "--virtual-time-budget=2000", "--dump-dom", f"file://{page}")
    told = re.search(r"<title>([^<]*)</title>", dom)
    assert told is not None
    label = "Slide between the captured and the simulated touch"
    assert told[1] == f"range|{label}|true|inset(0px 0px 0px 75%)|true|true"


def test_it_prints_on_a4_with_its_folds_open(page, tmp_path):
    paper = tmp_path / "page.pdf"
    chromium(tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={paper}", f"file://{page}")
    content = paper.read_bytes()
    boxes = {tuple(round(float(v)) for v in box.split()[2:]) for box in re.findall(rb"/MediaBox \[([^\]]*)\]", content)}
    assert boxes == {A4_PT}
    sheets = len(re.findall(rb"/Type /Page\b", content))
    assert 2 <= sheets <= 8
    text = subprocess.run(
        [require("pdftotext", "poppler-utils"), str(paper), "-"], capture_output=True, text=True, check=True
    ).stdout
    wanted = {
        "comparison": ("Better than no simulation", "area too bright", "finray compare"),
        "decision": ("Several angles are equally good", "On the drawing: 32 deg", "finray decide"),
    }
    for words in wanted[page.stem]:  # the second of the comparison stands in a fold
        assert words in " ".join(text.split()).replace("\u00a0", " ")
