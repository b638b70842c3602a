"""What switches a laser off outside of the computer, and lasers that do not go on without it."""

import datetime
from pathlib import Path

import pytest
from pydantic import ValidationError

from data_schemas import LaserSettings, OutsideLayer, RefusedError, RigFile
from data_schemas.storage import read_toml
from rigs import open_laser, open_rig_laser, paper_rig, write_rig
from rigs.light_guard import TEST_VALID_DAYS, off_lines, require_outside_layer
from rigs.light_guard._guarded_light import HAZARDOUS_CLASSES, refusal
from tests.capture.drivers import file_switch

TODAY = datetime.date(2026, 11, 23)
ALL_CLASSES = ("1", "1M", "2", "2M", "3R", "3B", "4")


def laser(hazard: str, driver: str = "indi", tested_on: str | None = None, address: str = "pi/Panel") -> LaserSettings:
    label = {"wavelength_nm": 450.0, "power_mw": 4.5, "laser_class": hazard}
    layer = None
    if tested_on is not None:
        layer = {"kind": "interlock", "tested_on": tested_on, "test": "lid opened with the laser on: dark at once"}
    return LaserSettings.model_validate({"driver": driver, "address": address, "outside_layer": layer, **label})


def test_class_3r_and_above_need_a_layer_and_those_below_do_not() -> None:
    needing = tuple(hazard for hazard in ALL_CLASSES if refusal(laser(hazard), has_dead_man=False, today=TODAY))
    assert needing == HAZARDOUS_CLASSES == ("3R", "3B", "4")
    assert not any(refusal(laser(hazard), has_dead_man=True, today=TODAY) for hazard in ALL_CLASSES)


def test_the_refusal_names_the_way_out() -> None:
    said = refusal(laser("3B"), has_dead_man=False, today=TODAY)
    assert said is not None
    for what in (
        "class 3B",
        "computer hangs",
        "Arduino with our firmware",
        "interlock",
        "relay",
        "[laser.outside_layer]",
    ):
        assert what in said


@pytest.mark.parametrize(
    ("age_days", "said"),
    [
        (0, None),
        (TEST_VALID_DAYS, None),
        (
            TEST_VALID_DAYS + 1,
            "is 91 days ago, but at most 90 days are allowed for a class 3R laser; test the interlock again",
        ),
        (-1, "is in the future"),
    ],
)
def test_a_test_holds_for_some_time(age_days: int, said: str | None) -> None:
    day = (TODAY - datetime.timedelta(age_days)).isoformat()
    told = refusal(laser("3R", tested_on=day), has_dead_man=False, today=TODAY)
    assert (told is None) if said is None else (told is not None and said in told)


def test_what_is_said_before_the_light_goes_on() -> None:
    layer = OutsideLayer(kind="interlock", tested_on="2026-11-20", test="lid opened: dark at once")
    assert all(line[0].endswith("by the other processes, within 1 s") for line in (off_lines(False), off_lines(True)))
    assert "NO, the light stays on" in off_lines(False)[1]
    assert "yes, by the dead-man in the light's controller" in off_lines(True)[1]
    assert "only by the interlock (tested on 2026-11-20: lid opened: dark at once)" in off_lines(False, layer)[1]


@pytest.mark.parametrize("day", ["2026-13-01", "yesterday", "23.11.2026", 20261123, datetime.datetime(2026, 11, 23, 1)])
def test_a_day_is_a_day(day: object) -> None:
    with pytest.raises(ValidationError, match="tested_on"):
        OutsideLayer.model_validate({"kind": "interlock", "tested_on": day, "test": "lid opened: dark at once"})


def test_a_rig_file_declares_it(tmp_path: Path) -> None:
    rig = paper_rig({})
    declared = rig.model_copy(update={"laser": laser("3R", tested_on="2026-11-20")})
    for number, written in enumerate((rig, declared)):
        assert read_toml(write_rig(written, tmp_path / f"{number}.toml"), RigFile) == written
    by_hand = (
        (tmp_path / "1.toml").read_text().replace("2026-11-20", "2026-11-21").replace('"2026-11-21"', "2026-11-21")
    )
    (tmp_path / "2.toml").write_text(by_hand)  # as TOML writes a day
    layer = read_toml(tmp_path / "2.toml", RigFile).laser.outside_layer
    assert layer is not None
    assert layer.tested_on == "2026-11-21"


def test_a_session_refuses_before_anything_is_opened() -> None:
    with pytest.raises(
        RefusedError,
        match=r"laser at pi/Panel: a class 3R laser is switched on only if hardware outside",
    ):
        require_outside_layer(laser("3R"))
    require_outside_layer(laser("2"))
    require_outside_layer(laser("3R", "arduino", address="/dev/ttyACM0"))
    require_outside_layer(laser("3R", tested_on=datetime.date.today().isoformat()))
    require_outside_layer(LaserSettings())  # simulated


def test_an_open_laser_is_not_lit_but_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file_switch.install(monkeypatch)
    with open_laser(laser("3R", address=str(tmp_path))) as light:
        assert light.refusal is not None
        with (
            pytest.raises(
                RefusedError,
                match="a class 3R laser is switched on only if hardware outside",
            ),
            light.lit(),
        ):
            pytest.fail("lit")
        assert not (tmp_path / "on").exists()
        assert "NO, the light stays on" in light.notes[0]
    with open_laser(laser("3R", tested_on=datetime.date.today().isoformat(), address=str(tmp_path))) as light:
        assert "only by the interlock" in light.notes[0]
        with light.lit():
            assert (tmp_path / "on").exists()
        assert not (tmp_path / "on").exists()


def test_lone_lasers_are_held_to_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``pytest --pyargs rigs.contracts --with-laser`` and ``rig show`` open it so."""
    file_switch.install(monkeypatch)
    rig = paper_rig({}).model_copy(update={"laser": laser("4", address=str(tmp_path))})
    with open_rig_laser(rig, tmp_path) as light, pytest.raises(RefusedError, match="class 4 laser"), light.lit():
        pytest.fail("lit")
