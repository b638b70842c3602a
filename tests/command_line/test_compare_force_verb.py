"""``finray simulate press --sensitivities``, then ``finray compare --force``: a press against a bench."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_schemas import FieldError, FingerDesign, ForceComparison, PressMechanics, provenance
from data_schemas.storage import read_record, write_record
from sim import design_toml
from tests.command_line.running import finray, succeed
from tests.compare.force_curves import force_at, power_law_press

FINGER = """
preset = "flat-70x35"
name = "short press"
[indenter]
depth_mm = 0.4
[uncertainty_rel]
"mechanics.gel.c10_mpa" = 0.1
"pad.shape" = 0.1
"""
# the whole list takes minutes: one material, one dimension, and one part that this finger does not have
FIELDS = ("mechanics.gel.c10_mpa", "skeleton.rib_thickness_mm", "pad.radius_mm")


def bench(path: Path, force: np.ndarray, displacement: np.ndarray, u_n: float = 0.01) -> Path:
    rows = "".join(f"{d:.6f},{f:.6f},{u_n}\n" for d, f in zip(displacement, force, strict=True))
    path.write_text(f"# a bench\ndisplacement_mm,force_n,force_uncertainty_n\n{rows}")
    return path


def test_a_press_with_sensitivities_is_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    monkeypatch.setattr("sim.experiments._design_sensitivities.UNCERTAIN_FIELDS", FIELDS)
    said = succeed(
        f"simulate press {tmp_path}/finger.toml --increments 2 --sensitivities --out {tmp_path}/f.press.json"
    )
    assert re.search(r"mechanics\.gel\.c10_mpa +\+0\.\d{3}", said)
    press = read_record(tmp_path / "f.mechanics.json", PressMechanics)
    gel, ribs = press.sensitivities.slopes
    assert (gel.field, ribs.field) == FIELDS[:2]
    assert not press.sensitivities.varied
    # a part that is stiffer or thicker stiffens the finger, but less than in proportion to a rib's cube
    assert all(
        0.05 < slope.ln_force_per_ln_number.min() <= slope.ln_force_per_ln_number.max() < 1.0 for slope in (gel, ribs)
    )
    force = np.interp(np.linspace(0.0, 0.38, 9), np.r_[0.0, press.depth_mm], np.r_[0.0, press.force_n[:, 1]])
    bench(tmp_path / "bench.csv", force, np.linspace(0.0, 0.38, 9) + 0.05)
    told = succeed(f"compare {tmp_path}/f.mechanics.json --force {tmp_path}/bench.csv --out {tmp_path}/f.force.json")
    found = read_record(tmp_path / "f.force.json", ForceComparison)
    # the interpolation between two increments differs from straight lines by a few thousandths of a newton
    assert found.first_touch.offset_mm.estimate == pytest.approx(0.05, abs=0.01)
    assert all(third.within for third in found.thirds)
    stated = {line.input: line.source for line in found.budget}
    assert stated["mechanics.gel.c10_mpa"] == "stated by the design"
    assert stated["skeleton.rib_thickness_mm"].startswith("assumed")
    assert re.search(r"do nothing +100\.0 %", told)
    assert re.search(r"simulation +\d+\.\d %  \[0\.0, \d+\.\d\] %", told)
    assert (tmp_path / "f.force.png").read_bytes().startswith(b"\x89PNG")


def test_stated_uncertainties_survive_the_file_of_a_design() -> None:
    design = FingerDesign(uncertainty_rel={"mechanics.gel.c10_mpa": 0.1})
    written = tomllib.loads(design_toml(design))
    assert written.pop("schema_version") == FingerDesign.schema_version
    assert FingerDesign.model_validate(written) == design
    with pytest.raises(FieldError, match=r"'mechanics\.gel\.c10' is not a field of the design; did you mean"):
        FingerDesign(uncertainty_rel={"mechanics.gel.c10": 0.1})


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    write_record(power_law_press(), tmp_path / "p.mechanics.json", provenance("pytest"))
    depth = np.linspace(0.1, 1.9, 9)
    bench(tmp_path / "bench.csv", 1.5 * force_at(depth), depth)
    return tmp_path


def test_a_model_that_is_off_is_told_and_drawn(lab: Path) -> None:
    command = f"compare {lab}/p.mechanics.json --force {lab}/bench.csv --known-first-touch --out {lab}/force.json"
    told = succeed(command)
    assert "off by > 2 u_val" in told
    assert "the zero of the measured displacements; not fitted" in told
    again = finray(command)
    assert again.status == 2
    assert "exists already and is not overwritten" in again.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("compare {lab}/p.mechanics.json {lab}/c.json --force {lab}/bench.csv", "without CAPTURE and --pairs"),
        ("compare --force {lab}/bench.csv", "give only NAME.mechanics.json"),
        ("compare {lab}/p.mechanics.json --force {lab}/bench.csv --register", "--force compares no images"),
        (
            "compare {lab}/p.mechanics.json --force {lab}/bench.csv --scale s.json --out {lab}/x.json",
            "--scale or --metric",
        ),
        (
            "compare {lab}/p.mechanics.json --force {lab}/bench.csv --out {lab}/x.png",
            "choose an --out that ends in .json",
        ),
        ("compare {lab}/p.json {lab}/c.json --known-first-touch", "work only with --force CSV"),
        ("compare {lab}/p.mechanics.json --force {lab}/none.csv --out {lab}/x.json", "none.csv: no such file"),
        (
            "compare {lab}/p.mechanics.json --force {lab}/bench.csv --out {lab}/x.json "
            "--other-mesh {lab}/p.mechanics.json",
            "p.mechanics.json: power law, push of 2 mm: is also on the coarse mesh",
        ),
        (
            "simulate render {lab}/finger.toml --sensitivities",
            "finray simulate: error: 'finray simulate render' does not take --sensitivities",
        ),
        (
            "simulate press {lab}/finger.toml --engine calculix --sensitivities",
            "finray's own finite elements; leave out --sensitivities, or --engine calculix\n",
        ),
    ],
)
def test_mistakes(arguments: str, message: str, lab: Path) -> None:
    (lab / "finger.toml").write_text(FINGER)
    outcome = finray(arguments.format(lab=lab))
    assert (outcome.status, outcome.err.count("\n")) == (2, 1), outcome.err
    assert message in outcome.err
