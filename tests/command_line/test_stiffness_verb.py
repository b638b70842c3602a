"""``finray study finger-stiffness``: its record, its table and what it says."""

import csv
import re
from pathlib import Path
from typing import Any

import pytest

from data_schemas import FingerDesign, FingerStiffness, NoEquilibriumError
from data_schemas.storage import read_record
from sim.mechanics import STEPS
from sim.mechanics._finger_mesh import MeshSteps
from tests.command_line.running import finray, succeed


def test_two_fingers_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # half as fine as coarse: torques and bending differ from those by under a per cent
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    (tmp_path / "thin.toml").write_text(
        'preset = "flat-70x35"\nname = "thin ribs"\n'
        "[pad]\nlength_mm = 48.0\nwidth_mm = 18.0\nfilm = {}\n[indenter]\nposition_mm = 24.0\n"
        "[skeleton]\nrib_count = 4\nrib_thickness_mm = 0.7\n"
    )
    said = succeed(f"study finger-stiffness baby-48x18 {tmp_path}/thin.toml --vary 0 --out {tmp_path}/stiffness")
    study = read_record(tmp_path / "stiffness" / "finger-stiffness.json", FingerStiffness)
    with (tmp_path / "stiffness" / "finger-stiffness.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["design"] for row in table] == [row.design for row in study.rows] == ["baby-48x18", "thin ribs"]
    for told, row in zip(table, study.rows, strict=True):
        assert float(told["twist_n_mm_per_deg"]) == row.twist_n_mm_per_deg
        assert float(told["slip_torque_per_friction_n_mm"]) == row.slip_torque_per_friction_n_mm
        # a cylinder across the middle: half the pad's width to the edge; the force leans along the finger by 0.06 of it
        assert row.tipping_torque_n_mm == pytest.approx(study.grip_force_n * 9.0, rel=5e-3)
        # a strip across the pad: parabolic pressure on it gives 3/16 N w, even 1/4, all of it at both edges 1/2
        assert 3.0 / 16.0 < row.slip_torque_per_friction_n_mm / (study.grip_force_n * 18.0) < 0.5
        assert f"{row.design}: bending {row.bending_n_per_mm:.3f} N/mm" in said
    assert re.search(r"twist_n_mm_per_deg: .* = \d\.\d{3}; no dimension was changed", said)


def test_a_finger_that_cannot_grip_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Quick:
        def __init__(self, design: FingerDesign, threads: int) -> None:
            pass

        def push(self, place: str, force_n: tuple[float, float, float]) -> Any:
            return type("Pushed", (), {"stiffness_n_per_mm": 2.0})

        def twist(self, angle_deg: float) -> Any:
            return type("Twisted", (), {"stiffness_n_mm_per_deg": 3.0})

    def never(*_: Any, **__: Any) -> None:
        raise NoEquilibriumError("no equilibrium at a push of 0.1 mm")

    monkeypatch.setattr("sim.experiments._design_sensitivities.LoadedFinger", Quick)
    monkeypatch.setattr("sim.experiments._design_sensitivities.press_to_force", never)
    said = succeed(f"study finger-stiffness baby-48x18 --vary 0 --out {tmp_path}/stiffness")
    assert "a cylinder gripped with 2 N has no result: no equilibrium at a push of 0.1 mm" in said
    row = read_record(tmp_path / "stiffness" / "finger-stiffness.json", FingerStiffness).rows[0]
    assert (row.bending_n_per_mm, row.slip_torque_per_friction_n_mm, row.tipping_torque_n_mm) == (2.0, None, None)
    assert row.grip_failure == "no equilibrium at a push of 0.1 mm"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("baby-48x18 --vary 60", "--vary: '60' must be a change in per cent of 0 to 50"),
        (
            "baby-48x18 baby-48x18",
            "two designs have the same name (baby-48x18, baby-48x18); give each design a unique name",
        ),
        ("no-such", "no preset design 'no-such'"),
        ("no-such.toml", "no-such.toml: no such file"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, arguments: str, message: str) -> None:
    outcome = finray(f"study finger-stiffness {arguments} --out {tmp_path}/stiffness")
    assert outcome.status == 2
    assert message in outcome.err
    assert not (tmp_path / "stiffness").exists()
