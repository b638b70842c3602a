"""``finray design tolerances`` and ``design assess``: what they find, store and show, and what is refused."""

import argparse
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from data_schemas import FingerStiffness, FingerTolerances, LightAngleDecision, SimulateError
from data_schemas.storage import read_bytes, read_record
from finray_calib.cli import _design_search
from finray_calib.cli._design_search import _computed_from, _tolerances
from sim import preset_design, read_design, with_pad_size
from sim.mechanics import STEPS
from sim.mechanics._finger_mesh import MeshSteps
from tests.command_line.running import finray, load, succeed

FINGER = 'preset = "flat-70x35"\nname = "coarse finger"\n[camera]\nwidth_px = 64\nheight_px = 48\n'
LEFT_OUT = (
    "light.azimuth_deg", "light.position_mm.x", "light.position_mm.y", "light.position_mm.z", "camera.position_mm.x",
    "camera.position_mm.y", "camera.position_mm.z", "camera.aim_deg", "mirror.radius_mm", "pad.thickness_mm",
    "paint.green.yield_rel", "paint.red.emission_sd", "paint.green.emission_sd",
)  # fmt: skip


@pytest.mark.renderer
def test_limits_are_found_stored_and_shown(paints: Path, tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    # one paint on both walls: the two are equally long-waved, and none looks swapped
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    few = " ".join(f"--vary {field}=0" for field in LEFT_OUT) + " --vary light.angle_deg=5 --runs 8 --samples 32"
    out = f"{tmp_path}/found.json"
    said = succeed(f"design tolerances {tmp_path}/finger.toml {files} {few} --out {out} --seed 3")
    found = read_record(tmp_path / "found.json", FingerTolerances)
    assert said.startswith(found.sentence)
    assert f"look at: {tmp_path}/found.html" in said
    assert [row.field for row in found.rows] == ["light.angle_deg", "paint.red.yield_rel"]
    assert found.rows[0].given == 5.0
    assert found.rows[0].origin == "given"
    assert "assumed" in found.rows[1].origin
    page = " ".join(unescape((tmp_path / "found.html").read_text()).split())
    assert found.sentence in page
    origin = load(tmp_path / "found.json")["record"]["provenance"]
    assert origin["seed"] == 3
    assert len(origin["input_sha256"]) == 3
    again = finray(f"design tolerances {tmp_path}/finger.toml {files} --out {out}")
    assert again.status == 2
    assert "exists already" in again.err


def test_what_cannot_vary_is_refused(paints: Path, tmp_path: Path) -> None:
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    for given, words in (
        ("--vary light.angel_deg=2", "is not a number of this finger"),
        ("--vary light.angle_deg=-2", "0 or more, and finite"),
        ("--vary light.angle_deg", "must be FIELD=HALF_RANGE"),
        ("--runs 3", "runs"),
        ("--vary light.angle_deg=1 --vary light.angle_deg=2", "--vary: a field is given twice; give each field once"),
        ("--samples 0", "argument --samples: '0' must be a whole number from 1 to 1000000"),
    ):
        outcome = finray(f"design tolerances flat-70x35 {files} {given} --out {tmp_path}/found.json")
        assert outcome.status == 2
        assert words in outcome.err
    only_red = finray(f"design tolerances flat-70x35 --paint red={paints}/red/paint.json --out {tmp_path}/found.json")
    assert only_red.status == 2
    assert "the green wall has no paint" in only_red.err
    assert not (tmp_path / "found.json").exists()


@pytest.mark.renderer
@pytest.mark.timeout(3600)
def test_one_command_gives_light_tolerances_and_stiffness_of_a_new_pad(
    paints: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # half as fine as coarse, two places, six angles, two numbers: the same steps on a small task
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    monkeypatch.setattr(_design_search, "_PLACES_REL", (0.3, 0.7))
    monkeypatch.setattr(_design_search, "_ANGLES_DEG", (0.0, 15.0, 30.0, 45.0, 60.0, 75.0))

    def of_two_numbers(arguments: argparse.Namespace, *given: Any) -> FingerTolerances:
        arguments.vary, arguments.samples = [(field, 0.0) for field in LEFT_OUT], 32
        return _tolerances(arguments, *given)

    monkeypatch.setattr(_design_search, "_tolerances", of_two_numbers)
    (tmp_path / "finger.toml").write_text(FINGER)
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    out = tmp_path / "found"
    said = succeed(f"design assess {tmp_path}/finger.toml --pad 60x30 {files} --quick --out {out}")
    decision = read_record(out / "light-angle-decision.json", LightAngleDecision)
    tolerances = read_record(out / "tolerances.json", FingerTolerances)
    stiffness = read_record(out / "finger-stiffness.json", FingerStiffness)
    finger = read_design(out / "finger.toml")
    assert (finger.pad.length_mm, finger.pad.width_mm) == (60.0, 30.0)
    assert finger.light.angle_deg == tolerances.design.light.angle_deg == decision.angle_deg
    assert stiffness.designs[0].pad == finger.pad
    assert decision.headline in said
    assert tolerances.sentence in said
    assert f"under the middle of the pad: {stiffness.rows[0].pad_n_per_mm:.3g} N/mm" in said
    assert said.endswith(f"look at: {out}/assessment.html\n")
    page = " ".join(unescape((out / "assessment.html").read_text()).split())
    assert f"Light at {decision.angle_deg:.0f} deg" in page
    assert "Build tolerances" in page
    assert "moved most by" not in page  # in a quick assessment no dimension is changed
    assert tolerances.sentence in page


def test_a_pad_of_another_size_moves_what_depends_on_it() -> None:
    small = with_pad_size(preset_design("flat-70x35-two-lights"), 35.0, 20.0)
    assert small.light.position_mm == (0.0, -5.0, -0.5)
    assert small.second_light is not None
    assert small.second_light.position_mm == (0.0, -2.0, 35.5)  # 1 mm beyond the tip of the 70 mm pad
    assert small.indenter.position_mm == 17.5
    assert small.skeleton.backing is not None
    assert small.skeleton.backing.to_z_mm == 30.0
    assert "pad.length_mm" not in small.origin
    same = with_pad_size(preset_design("flat-70x35"), 70.0, 35.0)
    assert same.light == preset_design("flat-70x35").light


def test_a_pad_that_no_finger_has_is_refused_before_any_work(paints: Path, tmp_path: Path) -> None:
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json"
    for given, words in (
        ("--pad 60", "must be LENGTHxWIDTH"),
        ("--pad 60x-3", "must be LENGTHxWIDTH"),
        ("--pad 60x500", "pad.width_mm: 500 mm is outside 5 to 300 mm"),
        ("", "existed: contains something other than an assessment"),
    ):
        (tmp_path / "existed").mkdir(exist_ok=True)
        (tmp_path / "existed" / "notes.txt").write_text("mine")
        outcome = finray(f"design assess flat-70x35 {given} {files} --out {tmp_path}/{'found' if given else 'existed'}")
        assert outcome.status == 2
        assert words in outcome.err
    assert not (tmp_path / "found").exists()


def test_an_assessment_names_the_files_of_its_design(
    paints: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object) -> None:
        raise SimulateError("far enough")

    monkeypatch.setattr(_design_search, "_swept", stopped)
    rows = [f"{nm},40,40,40" for nm in range(380, 1001, 10)]
    (tmp_path / "camera.csv").write_text("\n".join(["wavelength_nm,red_percent,green_percent,blue_percent", *rows]))
    text = FINGER + 'response = "camera.csv"\n'
    files = f"--paint red={paints}/red/paint.json --paint green={paints}/green/paint.json --quick"
    found = []
    for number, more in enumerate(("", "", "450,40,41,40\n")):
        (tmp_path / "finger.toml").write_text(text)
        with (tmp_path / "camera.csv").open("a") as curves:
            curves.write(f"\n{more}" if more else "")
        outcome = finray(f"design assess {tmp_path}/finger.toml {files} --out {tmp_path}/found{number}")
        assert "far enough" in outcome.err
        found.append((tmp_path / f"found{number}" / _design_search.ASSESSED_FROM).read_text())
    assert found[0] == found[1] != found[2]


def test_an_assessment_is_known_by_what_each_input_is_for(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one.json", "two.json")]
    for file in files:
        file.write_text(file.name)
        read_bytes(file, "a paint")
    design = preset_design("flat-70x35")
    options = {"seed": 1, "quick": False, "engine": "auto", "paints_as_given": False}

    def key(paints: dict[str, Path], **other: Any) -> dict[str, object]:
        return _computed_from(argparse.Namespace(**options | other), design, files[:1], paints)

    red_first = key({"red": files[0], "green": files[1]})
    assert red_first == key({"green": files[1], "red": files[0]})
    assert red_first != key({"red": files[1], "green": files[0]})
    for other in ({"engine": "llvm"}, {"paints_as_given": True}, {"seed": 2}, {"quick": True}):
        assert red_first != key({"red": files[0], "green": files[1]}, **other)
