"""When a move of a wheel behind a server is over."""

import time

import pytest

from data_schemas import WrongPositionError
from rigs.filter_wheels import Arrival

ELSEWHERE_S = 0.05


def test_a_slow_wheel_that_names_the_slots_it_passes_is_on_its_way() -> None:
    arrival = Arrival("wheel", 5, ELSEWHERE_S)
    for passed in (1, 2, 3, 4):
        assert not arrival.sees(passed)
        time.sleep(1.2 * ELSEWHERE_S)
    assert not arrival.sees(5)
    assert arrival.sees(5)


def test_a_wheel_that_rests_elsewhere_is_found_out() -> None:
    arrival = Arrival("wheel", 5, ELSEWHERE_S)
    assert not arrival.sees(3)
    time.sleep(1.2 * ELSEWHERE_S)
    with pytest.raises(WrongPositionError, match="was sent to slot 5, but stopped at slot 3"):
        arrival.sees(3)


@pytest.mark.parametrize("between", [None, 5])
def test_moving_and_arriving_start_the_time_anew(between: int | None) -> None:
    arrival = Arrival("wheel", 5, ELSEWHERE_S)
    assert not arrival.sees(3)
    time.sleep(1.2 * ELSEWHERE_S)
    assert not arrival.sees(between)
    assert not arrival.sees(3)
