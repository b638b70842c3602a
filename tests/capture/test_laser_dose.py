from dataclasses import dataclass

import pytest

from rigs.capture._frame_store import LaserDose


@dataclass
class StoppedClock:
    now_s: float = 100.0

    def utc(self) -> str:
        return ""

    def monotonic_s(self) -> float:
        return self.now_s


def test_only_the_time_of_the_blocks_counts() -> None:
    clock = StoppedClock()
    dose = LaserDose(4.0, clock)
    clock.now_s = 150.0
    assert dose.energy_j() == 0.0
    with dose.shining():
        clock.now_s = 160.0
        assert dose.energy_j() == pytest.approx(0.040)
        assert dose.energy_j(ago_s=2.5) == pytest.approx(0.030)
        assert dose.energy_j(ago_s=50.0) == 0.0  # before the block nothing fell
    clock.now_s = 500.0
    assert dose.energy_j() == pytest.approx(0.040)
    assert dose.energy_j(ago_s=5.0) == pytest.approx(0.040)
    with dose.shining():
        clock.now_s = 501.0
    assert dose.energy_j() == pytest.approx(0.044)


def stop_after_a_second(dose: LaserDose, clock: StoppedClock) -> None:
    with dose.shining():
        clock.now_s += 1.0
        raise RuntimeError("stop")


def test_an_error_ends_the_block() -> None:
    clock = StoppedClock()
    dose = LaserDose(1.0, clock)
    with pytest.raises(RuntimeError, match="stop"):
        stop_after_a_second(dose, clock)
    clock.now_s = 200.0
    assert dose.energy_j() == pytest.approx(0.001)
