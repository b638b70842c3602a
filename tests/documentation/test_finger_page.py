"""The page of a finger's design: all parts and numbers with where they come from, self-contained, and safe."""

import base64
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from example_records import example_results
from html_page import Page, assert_stands_alone

from data_schemas import FingerDesign, FingerStiffness, FingerTolerances, LightAngleDecision, SimulateError
from data_schemas.storage import read_record, write_record
from finray_calib.cli import _design_search
from finray_calib.reports import finger_page, stiffness_rows
from finray_calib.reports._finger_page import ScenePart, finger_scene, scene_values, sharp_edges
from sim import preset_design, read_design
from sim.mechanics import Sphere, body_mesh
from tests.capture.drivers.programs import require
from tests.command_line.running import finray, succeed

HOSTILE = "</script><script>alert(1)</script> & \"quoted\" 'name'"
PICTURE = b"\x89PNG stands in"
VIEW = "the camera sees 96 % of the coat\n  along the pad 3.3 to 7.0 px/mm"


@pytest.fixture(scope="module")
def html() -> str:
    return finger_page(FingerDesign(name=HOSTILE), PICTURE, VIEW)


def scene_of(html: str) -> dict:
    block = re.search(r'id="scene">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    return json.loads(block[1])


def test_every_part_is_named_shown_and_switched(html):
    page = Page(html)
    assert page.open == []
    names = [part["name"] for part in scene_of(html)["parts"]]
    assert names == [
        "coating", "red wall", "green wall", "gel", "film", "skeleton", "base plate", "backing", "mirror",
        "light panel", "camera", "indenter",
    ]  # fmt: skip
    boxes = [attributes for attributes in page.all("input") if attributes["type"] == "checkbox"]
    assert [box["data-part"] for box in boxes] == [str(i) for i in range(len(names))]
    assert ["checked" in box for box in boxes] == [name != "indenter" for name in names]
    for name in names:
        assert page.prose.count(name) >= 2
    # the shape of the whole finger, as the drawing gives it
    assert "90.8 mm long, 44.0 mm wide, 31.4 mm deep" in page.prose.replace("\u00a0", " ")


def test_every_number_says_where_it_comes_from(html):
    design, page = FingerDesign(), Page(html)
    rows = re.findall(r'<tr><th scope="row">([a-z_]+\.[a-z_.0-9]+)</th><td>(.*?)</td><td>(.*?)</td></tr>', html)
    found = {field: (value.replace("\u00a0", " "), origin) for field, value, origin in rows}
    assert found["pad.length_mm"] == ("70 mm", "paper")
    assert found["skeleton.rib_thickness_mm"] == ("1.2 mm", "assumed")
    assert found["camera.field_of_view_deg"] == ("120 deg", "paper")
    assert found["mechanics.skeleton.alpha"] == ("1.6663, -7.136", "paper")
    assert found["pad.semi_axes_mm"] == ("\N{EN DASH}", "not given")
    for field, origin in design.origin.items():
        assert found[field][1] == origin
    assumed = sum(origin == "assumed" for _, origin in found.values())
    assert f"Of the {len(found)} fields below {assumed} are assumptions" in page.prose
    assert "paper: length, width; assumed: thickness" in page.prose


def test_hostile_names_stay_text_and_nothing_comes_from_outside(html):
    assert HOSTILE not in html
    assert "alert(1)</script>" not in html
    assert HOSTILE in Page(html).prose
    page = Page(html)
    assert [script.get("type") for script in page.all("script")] == ["application/json", None]
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", html)
    assert page.all("link") == []
    assert all(image["src"].startswith("data:image/png;base64,") for image in page.all("img"))


def test_without_three_dimensions_or_scripts_the_drawing_serves(html):
    page = Page(html)
    (viewer,) = [attributes for attributes in page.all("div") if attributes.get("id") == "viewer"]
    assert "hidden" in viewer
    (words,) = [attributes for attributes in page.all("p") if attributes.get("id") == "no-viewer"]
    assert "hidden" not in words
    (image,) = page.all("img")
    assert base64.b64decode(str(image["src"]).partition(",")[2]) == PICTURE
    assert f"Drawing of the finger {HOSTILE} to scale" in str(image["alt"])
    assert "the camera sees 96 % of the coat" in page.prose


def test_it_can_be_used_by_keyboard_and_by_readers(html):
    page = Page(html)
    (canvas,) = page.all("canvas")
    assert canvas["tabindex"] == "0"
    assert canvas["aria-label"] == "The finger in three dimensions"
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    named = [a[key] for _, a in page.tags for key in ("aria-labelledby", "aria-describedby") if key in a]
    assert set(named) <= set(ids)
    assert len(page.all("caption")) == len(page.all("table")) == 2
    assert page.all("html")[0]["lang"] == "en"


def test_equal_designs_give_equal_pages_and_two_panels_are_two_parts(html):
    assert finger_page(FingerDesign(name=HOSTILE), PICTURE, VIEW) == html
    two = finger_page(preset_design("flat-70x35-two-lights"), PICTURE, VIEW)
    assert "light panel 1" in two
    assert "20 x 4 mm, 150 deg from the pad plane" in two.replace("\u00a0", " ")
    bare = Page(finger_page(preset_design("original-60x22"), PICTURE, VIEW)).prose
    assert "plate on the back fin" not in bare


def test_vertices_are_those_of_the_finger_within_half_a_step():
    parts = finger_scene(preset_design("ellipsoidal-30-8-90"))
    values = scene_values(parts)
    shown = np.concatenate([part.vertices_mm for part in parts if part.is_shown])
    centre = (shown.min(axis=0) + shown.max(axis=0)) / 2.0
    half_step = values["reach_mm"] / 32767 / 2.0
    for part, stored in zip(parts, values["parts"], strict=True):
        steps = np.frombuffer(base64.b64decode(stored["vertices"]), "<i2").reshape(-1, 3)
        read = centre + steps / 32767 * values["reach_mm"]
        # the reach itself is rounded to 0.1 um
        assert np.abs(read - part.vertices_mm).max() < half_step + 1e-4
        triangles = np.frombuffer(base64.b64decode(stored["triangles"]), "<u2").reshape(-1, 3)
        np.testing.assert_array_equal(triangles, part.triangles)
        assert part.colour.lower() == "#" + "".join(f"{round(255 * share):02x}" for share in stored["colour"])
    assert [part.name for part in parts][4] == "bond"


def test_parts_of_many_vertices_are_numbered_by_32_bits():
    count = 2**16 + 2
    line = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)])
    part = ScenePart("long", "#000000", True, line, np.array([[0, 1, count - 1]]))
    (stored,) = scene_values((part,))["parts"]
    assert stored["wide"]
    assert np.frombuffer(base64.b64decode(stored["triangles"]), "<u4").tolist() == [0, 1, count - 1]


def test_sharp_edges_are_those_that_a_draughtsman_draws():
    corners = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=np.float64)
    quads = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    edges = sharp_edges(corners, triangles)
    assert len(edges) == 12
    assert np.allclose(np.linalg.norm(corners[edges[:, 0]] - corners[edges[:, 1]], axis=1), 1.0)
    ball = body_mesh(Sphere(10.0), 0.05, 0.0)
    assert len(sharp_edges(ball.vertices_mm, ball.triangles)) == 0
    # an open sheet is bounded by its own edges
    assert len(sharp_edges(corners, triangles[:2])) == 4


@pytest.mark.parametrize(
    ("indenter", "across_mm"),
    [({"shape": "ball", "radius_mm": 5.0}, 10.0), ({"shape": "cuboid", "size_mm": (8.0, 6.0, 12.0)}, 8.0)],
)
def test_the_indenter_touches_the_pad(indenter, across_mm):
    design = FingerDesign.model_validate({"indenter": indenter})
    part = finger_scene(design)[-1]
    assert part.vertices_mm[:, 1].min() == pytest.approx(design.pad.thickness_mm, abs=0.05)
    assert np.ptp(part.vertices_mm[:, 0]) == pytest.approx(across_mm, abs=0.1)


def test_the_verb_writes_page_or_picture_by_its_name(tmp_path):
    design = tmp_path / "finger.toml"
    design.write_text('preset = "flat-70x35"\nname = "small finger"\n[camera]\nwidth_px = 128\nheight_px = 96\n')
    succeed(f"design show {design} --engine scalar --out {tmp_path}/finger.html")
    page = Page((tmp_path / "finger.html").read_text(encoding="utf-8"))
    assert "small finger: the camera sees 9" in page.prose
    (image,) = page.all("img")
    assert base64.b64decode(str(image["src"]).partition(",")[2]).startswith(b"\x89PNG")
    outcome = finray(f"design show {design} --engine scalar --out {tmp_path}/finger.pdf")
    assert outcome.status == 2
    assert "finger.pdf: a drawing's name must end in .png or .html" in outcome.err


@pytest.mark.rigs
@pytest.mark.parametrize("options", [["--use-angle=swiftshader", "--enable-unsafe-swiftshader"], ["--disable-3d-apis"]])
def test_a_browser_shows_the_viewer_where_it_can(html, tmp_path, options):
    browser = require("chromium", "chromium")
    (tmp_path / "finger.html").write_text(html, encoding="utf-8")
    command = [browser, "--headless=new", "--no-sandbox", f"--user-data-dir={tmp_path}/profile", *options]
    command += ["--virtual-time-budget=3000", "--dump-dom", f"file://{tmp_path}/finger.html"]
    dom = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout
    assert re.findall(r'<(div|p) id="(?:viewer|no-viewer)"[^>]* hidden', dom) == (
        ["div"] if "--disable-3d-apis" in options else ["p"]
    )


ROOT = Path(__file__).parents[2]
FROZEN = ROOT / "tests" / "schemas" / "frozen"


def put_records_in_place(folder, tolerances_begin=lambda: None):
    """Replace what an assessment computes by records; return the words of its command, and what was computed.

    It is run whole in tests/command_line/test_design_tolerances_verb.py.
    """
    results = example_results()
    for colour, paint in results.paints.items():
        file = folder / f"{colour}.paint.json"
        if not file.exists():
            write_record(paint.calibration, file, results.provenance)
    found = read_record(FROZEN / "FingerTolerances" / "v2" / "example.json", FingerTolerances)
    stiffness = read_record(FROZEN / "FingerStiffness" / "v4" / "example.json", FingerStiffness)
    computed = []

    def sweep(arguments, design, paints, number):
        computed.append(number)
        return results.sweep

    def tolerances(arguments, design, *_):
        tolerances_begin()
        computed.append(design)
        return found.model_copy(update={"provenance": None, "design": design})

    def stiff(*_):
        computed.append("stiffness")
        return stiffness.model_copy(update={"provenance": None})

    patch = pytest.MonkeyPatch()
    for name, instead in (("_sweep", sweep), ("_decided", lambda *_: results.decision), ("_tolerances", tolerances),
                          ("_stiffness", stiff)):  # fmt: skip
        patch.setattr(_design_search, name, instead)
    files = f"--paint red={folder}/red.paint.json --paint green={folder}/green.paint.json"
    return f"design assess flat-70x35 --pad 60x30 {files} --out {folder}/found", computed, patch


@pytest.fixture
def assessment(tmp_path):
    words, computed, patch = put_records_in_place(tmp_path)
    yield words, computed
    patch.undo()


def test_light_tolerances_and_stiffness_stand_on_one_page(tmp_path, assessment):
    words, computed = assessment
    said = succeed(words)
    names = {path.name for path in (tmp_path / "found").iterdir() if path.suffix != ".npz"}
    sweeps = {f"{place_mm:04.1f}mm.sweep.json" for place_mm in (7.2, 18.0, 30.0, 42.0, 52.8)}
    assert names == sweeps | {
        "assessment.html", "computed-from.sha256", "finger-stiffness.json", "finger.toml",
        "light-angle-decision.html", "light-angle-decision.json", "tolerances.html", "tolerances.json",
    }  # fmt: skip
    finger = read_design(tmp_path / "found" / "finger.toml")
    assert (finger.pad.length_mm, finger.pad.width_mm) == (60.0, 30.0)
    decision = read_record(tmp_path / "found" / "light-angle-decision.json", LightAngleDecision)
    tolerances = read_record(tmp_path / "found" / "tolerances.json", FingerTolerances)
    assert finger.light.angle_deg == computed[5].light.angle_deg == decision.angle_deg
    page = (tmp_path / "found" / "assessment.html").read_text()
    assert_stands_alone(page)
    text = " ".join(Page(page).prose.replace("\u00a0", " ").split())
    assert "A finger with a pad of 60 x 30 mm" in text
    assert tolerances.sentence in text
    for row in stiffness_rows(read_record(tmp_path / "found" / "finger-stiffness.json", FingerStiffness)):
        assert row[1] in text
        assert f"Stiffness, {row[0]}: {row[1]}" in said
    assert said.endswith("assessment.html\n")
    again = finray(words)
    assert again.status == 2
    assert "found: contains a finished assessment, which is not overwritten" in again.err


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.command_line.running import finray
from tests.documentation.test_finger_page import put_records_in_place
words, _, _ = put_records_in_place(Path(sys.argv[1]), lambda: os.kill(os.getpid(), signal.SIGKILL))
finray(words)
"""


def test_an_assessment_that_was_killed_continues_with_what_is_missing(tmp_path, assessment):
    words, computed = assessment
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([os.fspath(ROOT), os.fspath(Path(__file__).parent)])}
    killed = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], env=paths, check=False, timeout=600)
    assert killed.returncode == -signal.SIGKILL
    out = tmp_path / "found"
    kept = {path: path.read_bytes() for path in out.iterdir()}
    assert {"52.8mm.sweep.json", "light-angle-decision.json", "finger.toml"} <= {path.name for path in kept}
    assert not (out / "tolerances.json").exists()

    for changed in ("--seed 2", "--quick", "--pad 50x30"):
        refused = finray(f"{words} {changed}")
        assert refused.status == 2
        assert "contains an unfinished assessment that was started with another finger, pad, paint, seed" in refused.err
    said = succeed(words)
    assert said.startswith(f"{out}: continues; 6 finished parts are kept")
    assert [getattr(what, "name", what) for what in computed] == ["flat-70x35-pad-60x30", "stiffness"]
    assert all(path.read_bytes() == content for path, content in kept.items())
    assert (out / "assessment.html").exists()


def test_parts_of_other_code_are_told_when_an_assessment_continues(tmp_path, assessment, monkeypatch):
    words, _ = assessment
    with monkeypatch.context() as earlier:
        earlier.setattr("data_schemas._provenance.package_version", lambda: "0.0.9")
        earlier.setattr(_design_search, "_stiffness", stopped)
        assert finray(words).status == 2
    outcome = finray(words)
    assert outcome.status == 0
    assert "parts computed by other code than the present code" in outcome.err
    assert "tolerances by finray-calib 0.0.9" in outcome.err


def stopped(*_):
    raise SimulateError("no equilibrium")
