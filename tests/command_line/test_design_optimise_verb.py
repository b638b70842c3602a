"""``finray design optimise``: a search is stored evaluation by evaluation, goes on, and refuses what it cannot do."""

from pathlib import Path

import pytest

from data_schemas import DesignOptimum, EvaluatedDesign, FingerDesign
from data_schemas.storage import read_record
from sim import read_design
from sim.experiments import DesignEvaluations
from tests.command_line.running import finray, load, succeed

STIFF = "design optimise flat-70x35 --for bending-stiffness --and softness --within skeleton.rib_thickness_mm"


def loads(self: DesignEvaluations, design: FingerDesign, again: int) -> dict[str, float]:
    """Return the stiffness of a made-up finger: thicker ribs resist both forces."""
    thickness = design.skeleton.rib_thickness_mm
    return {"bending-stiffness": 0.5 * thickness**2, "softness": 1.0 + thickness, "twist-stiffness": thickness}


def test_a_search_is_stored_shown_and_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DesignEvaluations, "_values", loads)
    out = tmp_path / "found"
    said = succeed(f"{STIFF} --evaluations 12 --seed 4 --out {out}")
    optimum = read_record(out / "optimum.json", DesignOptimum)
    assert optimum.sentence in said
    assert said.rstrip().endswith(f"look at: {out}/optimum.html")
    assert "(14 computed now)" not in said
    # the recommended finger is a design file like any other
    finger = read_design(out / f"{optimum.design.name}.toml")
    chosen = optimum.designs[-1]
    assert finger.skeleton.rib_thickness_mm == pytest.approx(chosen.changes["skeleton.rib_thickness_mm"])
    assert chosen.values["softness"] == pytest.approx(1.0 + finger.skeleton.rib_thickness_mm)
    kept = [read_record(file, EvaluatedDesign) for file in sorted((out / "evaluations").glob("*.json"))]
    assert {one.key for one in kept} == {one.key for one in kept if len(one.key) == 64}
    assert f"({len(kept)} computed now)" in said
    assert load(out / "optimum.json")["record"]["provenance"]["seed"] == 4
    page = (out / "optimum.html").read_text()
    for words in ("The front", "What each parameter does", "shrinkage", "skeleton.rib_thickness_mm"):
        assert words in page
    # the same command computes nothing again, and says the same
    again = succeed(f"{STIFF} --evaluations 12 --seed 4 --out {out}")
    assert "(0 computed now)" in again
    assert optimum.sentence in again


@pytest.mark.renderer
def test_light_is_searched_with_the_paints_of_the_rig(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text('preset = "flat-70x35"\nname = "lit"\n')
    words = "--for normal-error --within light.angle_deg=20:40 --evaluations 10 --confirm 0"
    said = succeed(f"design optimise {tmp_path}/finger.toml {words} --out {tmp_path}/found")
    optimum = read_record(tmp_path / "found" / "optimum.json", DesignOptimum)
    assert all(not row.failure for row in optimum.designs)
    assert all(2.0 < row.values["normal-error"] < 20.0 for row in optimum.designs)
    assert "not confirmed" in said
    assert all(gain.confirmed_rel is None for gain in optimum.gains)
    assert any("stand-in" in note for note in optimum.notes)
    assert 20.0 <= optimum.design.light.angle_deg <= 40.0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--for beauty", "unknown objective 'beauty'; valid names are normal-error, evenness"),
        ("--for softness --and softness", "'softness' is given twice; give each objective once"),
        ("--for softness --within pad.thickness_mm --within pad.thickness_mm=5:7", "a field is given twice"),
        ("--for softness --within pad.thicknes_mm=5:7", "'pad.thicknes_mm' is not a field of a design"),
        (
            "--for softness --within pad.thickness_mm --evaluations 5",
            "5 are too few for 1 parameters; give at least 10",
        ),
        ("--for softness --confirm 2", "'2' must be 0, or a whole number from 3 to 100"),
        ("--for softness --evaluations many", "'many' must be a whole number from 1 to 1000"),
        ("--for normal-error --paint red=x.json", "give both red=FILE and green=FILE"),
    ],
)
def test_mistakes_are_told(words: str, told: str, tmp_path: Path) -> None:
    outcome = finray(f"design optimise flat-70x35 {words} --out {tmp_path}/found")
    assert outcome.status == 2
    assert told in outcome.err
    assert not (tmp_path / "found" / "optimum.json").exists()
