"""Every kind of page in a real browser under axe-core, light and dark: nothing that shuts a reader out.

Needs chromium, and axe.min.js of the npm package axe-core (MPL-2.0), which is not part of the project:
``npm install axe-core``, then FINRAY_AXE=node_modules/axe-core/axe.min.js.
"""

import html
import json
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from example_records import example_results

from data_schemas import DesignOptimum, FingerDesign, StudyFailure, StudyMetric, StudyPoint, StudyResult, StudyRow
from data_schemas.storage import read_record
from finray_calib.acceptance import judge
from finray_calib.demo import demo_report
from finray_calib.reports import (
    certificate_page,
    check_report,
    comparison_page,
    decision_page,
    finger_page,
    paint_report,
)
from finray_calib.reports.studies import design_study_page, optimum_page
from rigs import simulated_rig
from tests.acceptance.facts import PLAN, handshake, spoilt
from tests.acceptance.paints import example
from tests.acceptance.test_certificate_command import certificate
from tests.capture.drivers.programs import require
from tests.documentation.test_finger_page import PICTURE, VIEW
from tests.schemas.freeze import example_of

GRAVE = ("serious", "critical")
RUN = """<script>
addEventListener("load", async () => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const found = await axe.run(document, {resultTypes: ["violations"]});
  const told = found.violations.map((v) => ({
    id: v.id, impact: v.impact, help: v.help,
    nodes: v.nodes.slice(0, 5).map((n) => n.html.slice(0, 200) + " " + (n.any[0] ? n.any[0].message : "")),
  }));
  const out = document.createElement("pre");
  out.id = "axe-found";
  out.textContent = JSON.stringify({violations: told, passed: found.passes.length,
    dark: matchMedia("(prefers-color-scheme: dark)").matches, width_px: document.documentElement.clientWidth});
  document.body.append(out);
});
</script>"""

pytestmark = pytest.mark.rigs


def study_page() -> str:
    """The page of a study of three points, one of which failed."""
    metrics = (
        StudyMetric(name="evenness", value=0.4, low95=0.3, high95=0.5, unit="1", meaning="darkest over brightest"),
        StudyMetric(name="force_n", value=2.8, unit="N", meaning="force at the end of the push"),
    )
    image = np.linspace(0.0, 1.0, 24 * 32 * 3, dtype=np.float32).reshape(24, 32, 3)
    points = [
        StudyPoint(
            study="tilt",
            number=k,
            key="0" * 64,
            changes={"light.angle_deg": 30.0 * k},
            design=FingerDesign(),
            metrics=metrics,
            no_contact=image,
            contact=image[::-1],
            processor_s=1.0,
        )
        for k in (1, 2)
    ]
    rows = tuple(StudyRow(number=p.number, changes=p.changes, metrics=p.metrics) for p in points)
    failed = (StudyFailure(number=3, changes={"light.angle_deg": 90.0}, reason="no equilibrium"),)
    result = StudyResult(name="tilt", about="", varied=("light.angle_deg",), points=rows, failures=failed)
    return design_study_page(result, points, "finray study run tilt.toml", {"tilt.toml": "0" * 64}, "0.1.0")


def check_page() -> str:
    """The page of a rig that fails."""
    facts = spoilt(handshakes=(handshake(error="no answer"),), revisits=(), errors={"wheel": "stuck"})
    return check_report(judge(facts, PLAN, simulated_rig("red", width_px=64, height_px=64)))


RESULTS = example_results()
PAGES: dict[str, Callable[[], str]] = {
    "demo": lambda: demo_report(RESULTS),
    "fit": lambda: paint_report(RESULTS.paints["red"].calibration, RESULTS.paints["red"].bands),
    "comparison": lambda: comparison_page(RESULTS.report, RESULTS.press, RESULTS.capture, "finray compare", {}),
    "decision": lambda: decision_page(RESULTS.decision, [RESULTS.sweep], "finray decide", {}),
    "study": study_page,
    "optimum": lambda: optimum_page(
        read_record(example_of(DesignOptimum, 1), DesignOptimum), "finray design optimise", {}, "0.1.0"
    ),
    "check": check_page,
    "certificate": lambda: certificate_page(certificate(), example()),
    "finger": lambda: finger_page(FingerDesign(), PICTURE, VIEW),
}


def axe() -> str:
    """Return the source of axe-core; skip loudly where it is missing, which no command of the project installs."""
    path = Path(os.environ.get("FINRAY_AXE", "node_modules/axe-core/axe.min.js"))
    if not path.is_file():
        pytest.skip("axe-core is missing: npm install axe-core, then FINRAY_AXE=node_modules/axe-core/axe.min.js")
    return path.read_text(encoding="utf-8")


def findings(page: str, folder: Path, *options: str) -> dict[str, object]:
    """Return what axe-core finds in a page with its folds open."""
    path = folder / "page.html"
    policy = re.sub(r"<meta[^>]*Content-Security-Policy[^>]*>", "", page)  # which keeps foreign scripts out
    path.write_text(policy.replace("</body>", f"<script>{axe()}</script>{RUN}</body>"), encoding="utf-8")
    command = [require("chromium", "chromium"), "--headless=new", "--no-sandbox", "--disable-gpu",
               f"--user-data-dir={folder}/profile", "--virtual-time-budget=20000", "--dump-dom"]  # fmt: skip
    done = subprocess.run(
        [*command, *options, f"file://{path}"], capture_output=True, text=True, check=True, timeout=300
    )
    told = re.search(r'<pre id="axe-found">(.*?)</pre>', done.stdout, flags=re.DOTALL)
    assert told is not None, done.stderr[-500:]
    return dict(json.loads(html.unescape(told[1])))


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_no_serious_finding(name, dark, tmp_path):
    options = (
        ["--window-size=400,900", "--blink-settings=preferredColorScheme=0"] if dark else ["--window-size=1400,900"]
    )
    found = findings(PAGES[name](), tmp_path, *options)
    assert found["passed"] > 15
    assert found["dark"] == dark
    assert [v for v in found["violations"] if v["impact"] in GRAVE] == []


def test_a_page_with_faults_is_found(tmp_path):
    """Too little contrast, an image without words, no language."""
    page = '<html><head><title>t</title></head><body><img src="x.png"><p style="color:#bbb">pale</p></body></html>'
    found = {v["id"] for v in findings(page, tmp_path)["violations"]}
    assert {"color-contrast", "image-alt", "html-has-lang"} <= found
