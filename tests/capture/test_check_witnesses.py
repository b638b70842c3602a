"""Witnesses that do not depend on the devices of a rig that presses: a known mass, a gauge block, the picture's scale."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import ValidationError

from data_schemas import AcceptanceReport, CheckPlan, PressLimits
from data_schemas.storage import read_record
from tests.capture.test_check_press import changed, checked, lying, named, practice  # noqa: F401
from tests.command_line.running import finray

MASS = "rest_s = 10.0\n[known_mass]\nmass_kg = 0.2\nuncertainty_kg = 0.0002"


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.0, "PASS"), (1.05, "FAIL"), (0.95, "FAIL"), (1.02, "UNDECIDED"), (0.0, "UNDECIDED")]
)
def test_a_known_mass_judges_the_factor(practice: Path, monkeypatch, factor: float, verdict: str) -> None:  # noqa: F811
    """The mass that lies there is another one than the plan says, or none."""
    changed(practice, "check.toml", ("rest_s = 10.0", MASS))
    lying(monkeypatch, lambda opened: replace(opened, lay=lambda mass_kg: opened.lay(factor * mass_kg)))
    report, _ = checked(practice)
    found = named(report, "calibration holds")
    assert found.verdict == verdict, found
    if factor:
        assert found.value == pytest.approx(100 * (factor - 1.0), abs=0.05)
        # 0.1 % of the mass; noise, zero and form of the simulated cell are below 0.01 %
        assert found.sd == pytest.approx(0.1, rel=0.05)
    else:
        assert "was the mass laid on the cell?" in found.evidence


def test_a_mass_of_the_calibration_passes_with_a_certificate_only(practice: Path) -> None:  # noqa: F811
    same = MASS.replace("0.2\n", "0.3\n")
    changed(practice, "check.toml", ("rest_s = 10.0", same))
    found = named(checked(practice)[0], "calibration holds")
    assert found.verdict == "UNDECIDED"
    assert "one of the masses that calibrated the cell" in found.evidence
    changed(practice, "check.toml", (same, f'{same}\ncertificate = "M 12"'))
    finray(f"check run {practice}/check.toml --rig {practice}/rig.toml --out {practice}/certified")
    report = read_record(practice / "certified/check.json", AcceptanceReport)
    assert named(report, "calibration holds").verdict == "PASS"
    assert "M 12" in named(report, "calibration holds").evidence


def test_a_light_mass_proves_little(practice: Path) -> None:  # noqa: F811
    changed(practice, "check.toml", ("rest_s = 10.0", MASS.replace("0.2\n", "0.05\n").replace("0.0002", "0.00005")))
    found = named(checked(practice)[0], "calibration holds")
    assert (found.verdict, "less than 20 % of force_limit_n" in found.evidence) == ("UNDECIDED", True)


def test_a_mass_that_stays_on_the_cell_ends_all_that_moves(practice: Path, monkeypatch) -> None:  # noqa: F811
    changed(practice, "check.toml", ("rest_s = 10.0", MASS))
    lying(monkeypatch, lambda opened: replace(opened, lay=lambda mass_kg: opened.lay(mass_kg) if mass_kg else None))
    report, status = checked(practice)
    assert status == 1
    assert "after the mass was taken off" in named(report, "load cell").evidence
    assert "not tried" in named(report, "stage moves").evidence


def test_a_mass_that_the_cell_cannot_bear_is_refused(practice: Path) -> None:  # noqa: F811
    changed(practice, "check.toml", ("rest_s = 10.0", MASS.replace("0.2\n", "1.2\n")))
    outcome = finray(f"check run {practice}/check.toml --rig {practice}/rig.toml --out {practice}/out")
    assert outcome.status == 2
    assert re.search(r"mass_kg = 1\.2 kg weighs more than the 9\.8 N that the cell can bear", outcome.err)


@pytest.mark.parametrize("bad", ["0.0", "-0.1", "inf", "nan", "1e9"])
def test_limits_that_mean_nothing_are_refused(bad: str) -> None:
    for limits in (PressLimits, type(CheckPlan.model_fields["limits"].default)):
        for name in limits.model_fields:
            with pytest.raises(ValidationError, match=name):
                limits.model_validate({name: float(bad)})
