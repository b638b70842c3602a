"""``finray design tolerances``: limits of a finger with their page, and what is refused."""

from html import unescape
from pathlib import Path

import pytest

from data_schemas import FingerTolerances
from data_schemas.storage import read_record
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
        ("--vary light.angle_deg=-2", "0 (left out) or more"),
        ("--vary light.angle_deg", "must be FIELD=HALF_RANGE"),
        ("--runs 3", "runs"),
    ):
        outcome = finray(f"design tolerances flat-70x35 {files} {given} --out {tmp_path}/found.json")
        assert outcome.status == 2
        assert words in outcome.err
    only_red = finray(f"design tolerances flat-70x35 --paint red={paints}/red/paint.json --out {tmp_path}/found.json")
    assert only_red.status == 2
    assert "no paint for the green wall" in only_red.err
    assert not (tmp_path / "found.json").exists()
