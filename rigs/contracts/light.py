"""What every light must do.

A class of tests derives from :class:`LightContract` and brings the fixture `light` (open).
"""

from collections.abc import Callable

import pytest

from rigs.protocols import Light

CYCLES = 3


class DisturbanceError(Exception):
    """What goes wrong in a block."""


class LightContract:
    """Tests of a light; they switch it on for moments."""

    @pytest.fixture
    def switch_off_behind(self) -> Callable[[], None] | None:
        """Return what switches the light off without the driver; None where nothing can."""
        return None

    def test_it_says_what_it_is(self, light: Light) -> None:
        """Its identity is not empty."""
        identity = light.identity()
        assert identity.role in ("laser", "lamp")
        assert identity.driver

    def test_it_is_off_when_opened(self, light: Light) -> None:
        """Nobody asked for light yet."""
        assert light.state() is False

    def test_on_and_off_are_confirmed(self, light: Light) -> None:
        """It is on inside each block and off after it."""
        for _ in range(CYCLES):
            with light.lit():
                assert light.state() is True
            assert light.state() is False

    def test_exception_leaves_it_off(self, light: Light) -> None:
        """However a block ends, the light is off, and the exception is not swallowed."""
        for kind in (DisturbanceError, KeyboardInterrupt):
            with pytest.raises(kind), light.lit():
                raise kind
            assert light.state() is False

    def test_state_is_asked_afresh(self, light: Light, switch_off_behind: Callable[[], None] | None) -> None:
        """A light that somebody else switched off is not reported on."""
        if switch_off_behind is None:
            pytest.skip("nothing here switches this light off behind the driver's back")
        with light.lit():
            assert light.state() is True
            switch_off_behind()
            assert light.state() is False


class TestLaser(LightContract):
    """The laser of the rig file that ``--rig`` names."""

    @pytest.fixture
    def light(self, laser: Light) -> Light:
        """Return the laser."""
        return laser


class TestLamp(LightContract):
    """The lamp of the rig file that ``--rig`` names."""

    @pytest.fixture
    def light(self, lamp: Light) -> Light:
        """Return the lamp."""
        return lamp
