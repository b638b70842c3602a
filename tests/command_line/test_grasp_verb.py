"""``finray simulate grasp``: a small grasp with its files, and what is refused."""

from pathlib import Path

import pytest

from data_schemas import FingerSurfaces, ObjectGrasp, PressMechanics
from data_schemas.storage import read_record
from finray_calib.cli import _simulate_grasp as grasp_verb
from finray_calib.cli._simulate_grasp import _mass
from sim.mechanics import STEPS
from sim.mechanics._finger_mesh import MeshSteps
from tests.command_line.running import finray

FINGER = """\
preset = "baby-48x18"
name = "a ball in two fingers"
[indenter]
shape = "ball"
radius_mm = 10.0
position_mm = 24.0
friction = 0.6
"""


@pytest.fixture
def rough_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mesh half as finely as coarse: what is stored does not hang on it."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))


@pytest.mark.usefixtures("rough_mesh")
def test_a_ball_is_gripped_and_carried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    monkeypatch.setattr(grasp_verb, "FEWEST_TOUCHING", 10_000)
    outcome = finray(
        f"simulate grasp {tmp_path}/finger.toml --force 0.5 --mass 0.01 --down side --increments 1 "
        f"--out {tmp_path}/ball.grasp.json"
    )
    assert outcome.status == 0, outcome.err
    said = outcome.out
    assert "points of its mesh touch the object, but below 10000 the force depends on where" in outcome.err
    grasp = read_record(tmp_path / "ball.grasp.json", ObjectGrasp)
    assert grasp.closing_force_n[-1] == pytest.approx(0.5, abs=0.003)
    assert grasp.carried_n[-1] == pytest.approx(0.0981, abs=1e-4)
    assert grasp.weight_n == pytest.approx(0.01 * 9.80665)
    assert not grasp.lost
    assert "the fingers hold the whole weight of 0.0981 N" in said
    # the weight pulls across the near finger, along its x; the far finger's x points the other way
    near, far = (read_record(tmp_path / f"ball.{side}.mechanics.json", PressMechanics) for side in ("near", "far"))
    balance_n = 0.005 * 0.5  # what a balance leaves over
    assert near.force_n[-1, 0] - far.force_n[-1, 0] == pytest.approx(-0.0981, abs=balance_n)
    for side in ("near", "far"):
        assert read_record(tmp_path / f"ball.{side}.surfaces.json", FingerSurfaces).name.endswith("pressed")
    assert (tmp_path / "ball.grasp.png").read_bytes().startswith(b"\x89PNG")


def test_no_mass_is_zero_however_it_is_written():
    assert [_mass(text) for text in ("0", "0.0", " 0 ", "0e0", "0.5")] == [0.0, 0.0, 0.0, 0.0, 0.5]


@pytest.mark.parametrize(
    ("words", "more", "message"),
    [
        ("--force 0", "", "'0' must be a force in N of 0.01 to 200"),
        ("--force strong", "", "'strong' must be a force in N of 0.01 to 200"),
        ("", "", "--force"),
        ("--force 1 --mass -1", "", "must be 0 or a mass in kg of 1e-06 to 20"),
        ("--force 1 --mass 1e-9", "", "must be 0 or a mass in kg of 1e-06 to 20"),
        ("--force 1 --down up", "", "invalid choice: 'up'"),
        ("--force 1 --out {tmp}/found.txt", "", "ends in .json"),
        ("--force 1", "[[indenter.path]]\npush_mm = 1.0\n", "indenter.path: has 1 poses"),
        (
            "--force 1 --mass 0.1",
            "frictionless",
            "indenter.friction = 0 cannot hold a weight that pulls along",
        ),
    ],
)
def test_what_cannot_be_gripped_is_refused(words: str, more: str, message: str, tmp_path: Path) -> None:
    design = FINGER.replace("friction = 0.6", "friction = 0.0") if more == "frictionless" else FINGER + more
    (tmp_path / "finger.toml").write_text(design)
    outcome = finray(f"simulate grasp {tmp_path}/finger.toml {words.format(tmp=tmp_path)}")
    assert outcome.status == 2
    assert message in " ".join(outcome.err.split())
    assert not list(tmp_path.glob("*.grasp.json"))
