"""What every filter wheel must do.

A class of tests derives from :class:`FilterWheelContract` and brings the fixtures `wheel` (open) and `wheel_settings`.
"""

import time

import pytest

from data_schemas.devices import FilterWheelSettings
from data_schemas.errors import CaptureError, RefusedError
from rigs.capture.exchange import WHEEL_DEADLINE_S
from rigs.protocols import FilterWheel

LATE_S = 1.0
"""How much later than its deadline a move may be given up: one exchange, and a busy computer."""
TOO_SHORT_S = 0.001
"""No wheel with a motor moves, and no serial port answers, in so little time (s)."""


class FilterWheelContract:
    """Tests of a filter wheel; they turn it through all of its slots."""

    def test_it_says_what_it_is(self, wheel: FilterWheel) -> None:
        """Its identity is not empty."""
        identity = wheel.identity()
        assert identity.role == "filter wheel"
        assert identity.driver
        assert identity.model

    def test_it_has_the_slots_of_the_rig_file(self, wheel: FilterWheel, wheel_settings: FilterWheelSettings) -> None:
        """Its slots count upwards from 1 or more and hold every filter."""
        assert list(wheel.slots) == sorted(set(wheel.slots))
        assert min(wheel.slots) >= 1
        assert {optic.slot for optic in wheel_settings.filters} <= set(wheel.slots)

    def test_position_is_a_slot_or_unknown(self, wheel: FilterWheel) -> None:
        """What it reports before anybody moved it is one of its slots, or nothing."""
        assert wheel.position() in (None, *wheel.slots)

    def test_every_slot_is_reached_and_read_twice(self, wheel: FilterWheel) -> None:
        """After each move, also to where it stands, two readings name the slot."""
        for slot in (*wheel.slots, wheel.slots[-1], wheel.slots[0]):
            wheel.go_to(slot, WHEEL_DEADLINE_S)
            assert (wheel.position(), wheel.position()) == (slot, slot)

    def test_slot_that_it_lacks_is_refused_before_it_moves(self, wheel: FilterWheel) -> None:
        """Neither 0 nor the number after the last slot moves it."""
        wheel.go_to(wheel.slots[1], WHEEL_DEADLINE_S)
        for slot in (0, -1, wheel.slots[-1] + 1):
            with pytest.raises(RefusedError, match=f"no (slot|filter in slot) {slot}"):
                wheel.go_to(slot, WHEEL_DEADLINE_S)
            assert wheel.position() == wheel.slots[1]

    def test_deadline_is_kept_and_a_late_arrival_is_not_taken_for_the_next(self, wheel: FilterWheel) -> None:
        """A move that is given up raises at once; the next one ends at its own slot."""
        if wheel.identity().driver == "manual":
            pytest.skip("a wheel turned by hand: deadlines do not hold for people")
        wheel.go_to(wheel.slots[0], WHEEL_DEADLINE_S)
        began_s = time.monotonic()
        with pytest.raises(CaptureError):
            wheel.go_to(wheel.slots[len(wheel.slots) // 2], TOO_SHORT_S)
        assert time.monotonic() - began_s < TOO_SHORT_S + LATE_S
        assert wheel.position() in (None, *wheel.slots)
        wheel.go_to(wheel.slots[1], WHEEL_DEADLINE_S)
        assert (wheel.position(), wheel.position()) == (wheel.slots[1], wheel.slots[1])


class TestFilterWheel(FilterWheelContract):
    """The filter wheel of the rig file that ``--rig`` names."""
