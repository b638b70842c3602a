"""Filter wheel and lamp in the operator's hands."""

import io

import pytest

from data_schemas import (
    BandPassFilter,
    CaptureError,
    FilterWheelSettings,
    LampSettings,
    RefusedError,
    Target,
    UnsafeError,
)
from rigs import TerminalOperator, open_lamp, open_wheel
from rigs.lights.manual import open_switch

WHEEL = FilterWheelSettings(
    driver="manual",
    model="filters in a drawer",
    filters=(
        BandPassFilter(slot=2, name="550 nm", center_nm=550.0),
        BandPassFilter(slot=1, name="500 nm", center_nm=500.0),
    ),
)


class Person:
    """An operator who does what is asked, until they walk away."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.is_there = True

    def place(self, target: Target) -> None:
        raise AssertionError("a wheel or a lamp places no target")

    def swing_wheel_out(self) -> None:
        raise AssertionError("a wheel or a lamp does not swing out")

    def tilt(self, angle_deg: float) -> None:
        raise AssertionError("a wheel or a lamp does not tilt")

    def do(self, instruction: str) -> None:
        self.heard.append(instruction)
        if not self.is_there:
            raise CaptureError("operator: nobody is there")

    def allows(self, question: str) -> bool:
        raise AssertionError("a wheel or a lamp asks nothing")


def test_the_operator_turns_the_wheel() -> None:
    person = Person()
    with open_wheel(WHEEL, person) as wheel:
        assert wheel.slots == (1, 2)
        assert wheel.position() is None
        wheel.go_to(2, 1.0)
        assert wheel.position() == 2
        asked = "Turn the filter wheel to slot 2: filter '550 nm', 550 nm."
        assert person.heard == [asked]
        assert wheel.identity().model == "filters in a drawer"
        assert (wheel.identity().role, wheel.identity().driver) == ("filter wheel", "manual")


def test_the_operator_is_asked_again_for_the_same_slot() -> None:
    # The frames may show that the filter in the beam is not the one that was confirmed.
    person = Person()
    with open_wheel(WHEEL, person) as wheel:
        wheel.go_to(1, 1.0)
        wheel.go_to(1, 1.0)
    assert len(person.heard) == 2


def test_a_slot_without_a_filter_is_refused_before_anybody_is_asked() -> None:
    person = Person()
    with (
        open_wheel(WHEEL, person) as wheel,
        pytest.raises(RefusedError, match="no filter in slot 3, only in 1, 2"),
    ):
        wheel.go_to(3, 1.0)
    assert not person.heard


def test_the_position_is_unknown_after_a_request_that_failed() -> None:
    person = Person()
    with open_wheel(WHEEL, person) as wheel:
        wheel.go_to(1, 1.0)
        person.is_there = False
        with pytest.raises(CaptureError, match="nobody is there"):
            wheel.go_to(2, 1.0)
        assert wheel.position() is None


def test_the_operator_at_the_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    with open_wheel(WHEEL, TerminalOperator()) as wheel:
        wheel.go_to(1, 1.0)
        assert wheel.position() == 1
        with pytest.raises(CaptureError, match="standard input is closed"):
            wheel.go_to(2, 1.0)
    assert "Turn the filter wheel to slot 1: filter '500 nm', 500 nm." in capsys.readouterr().err


def test_a_wheel_that_was_swung_out_is_asked_back(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n" * 4))
    person = TerminalOperator()
    person.place("white")
    person.place("white")
    assert capsys.readouterr().err.count("Press Enter") == 1
    person.swing_wheel_out()
    person.place("white")
    said = capsys.readouterr().err
    assert said.count("Press Enter") == 2
    assert said.index("Swing the filter wheel out") < said.index("swing the filter wheel into the beam")


def test_the_operator_switches_the_lamp_and_is_asked_no_more_than_needed() -> None:
    person = Person()
    with open_lamp(LampSettings(driver="manual"), person) as lamp:
        assert lamp.identity().driver == "manual"
        assert not lamp.state()
        with lamp.lit():
            assert lamp.state()
        assert not lamp.state()
    assert person.heard == ["Switch the lamp off.", "Switch the lamp on.", "Switch the lamp off."]


def test_the_lamps_state_is_unknown_until_somebody_confirms_it() -> None:
    with open_switch("", "lamp", Person()) as switch:
        assert not switch.has_dead_man
        switch.keep_alive()
        with pytest.raises(RefusedError, match="nobody has confirmed whether it is on or off"):
            switch.state(1.0)


def test_a_lamp_that_nobody_switches() -> None:
    person = Person()
    with open_switch("", "lamp", person) as switch:
        switch.switch(False, 1.0)
        person.is_there = False
        with pytest.raises(CaptureError, match="nobody is there"):
            switch.switch(True, 1.0)
        with pytest.raises(RefusedError, match="nobody has confirmed"):
            switch.state(1.0)
        with pytest.raises(UnsafeError, match=r"nobody confirms that it is off .* switch it off by hand"):
            switch.switch(False, 1.0)


def test_a_laser_is_not_switched_by_hand() -> None:
    with pytest.raises(RefusedError, match="laser: cannot be switched by hand"), open_switch("", "laser", Person()):
        pass
