import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_schemas import SaturatedError
from rigs.capture._exposure import brightest_dn, exposure_ladder, meter_exposure, rung_at_or_below, saturated_fraction

LADDER = exposure_ladder(1e-4, 30.0)
FULL_SCALE_DN, BLACK_DN = 1023, 16.0


class Region:
    """A uniformly lit region of a noiseless linear camera; counts how often it is exposed."""

    def __init__(self, signal_dn_per_s: float):
        self.signal_dn_per_s = signal_dn_per_s
        self.exposures_s: list[float] = []

    def take(self, exposure_s: float) -> np.ndarray:
        self.exposures_s.append(exposure_s)
        level_dn = min(BLACK_DN + self.signal_dn_per_s * exposure_s, FULL_SCALE_DN)
        return np.full((8, 8), round(level_dn), dtype=np.uint16)


def meter(region: Region, target_fraction: float = 0.7, first_guess_s: float | None = None) -> float:
    return meter_exposure(
        region.take, LADDER, FULL_SCALE_DN, BLACK_DN, target_fraction, "fluorescence behind 600", first_guess_s
    )


def test_a_long_exposure_is_told_before_it_is_made() -> None:
    region, told = Region(10.0), []

    def tell(text: str) -> None:
        told.append((len(region.exposures_s), text))

    meter_exposure(region.take, LADDER, FULL_SCALE_DN, BLACK_DN, 0.7, "white behind 405", tell=tell)
    assert region.exposures_s == pytest.approx([0.0512, 26.2144])
    longest = "the rig file allows at most 26.2 s"
    assert told == [(1, f"metering white behind 405: the exposure is now 26.2 s, because the signal is low; {longest}")]


def test_ladder_doubles_between_the_cameras_limits() -> None:
    assert LADDER[0] == 1e-4
    assert len(LADDER) == 19
    np.testing.assert_allclose(np.diff(np.log2(LADDER)), 1.0, rtol=1e-12)
    assert LADDER[-1] <= 30.0 < 2 * LADDER[-1]
    assert exposure_ladder(0.01, 0.01) == (0.01,)
    assert exposure_ladder(0.001, 0.008)[-1] == pytest.approx(0.008)


def test_rung_below_an_exposure() -> None:
    assert rung_at_or_below(LADDER, 0.25 * LADDER[7]) == LADDER[5]
    assert rung_at_or_below(LADDER, 1.9 * LADDER[7]) == LADDER[7]
    assert rung_at_or_below(LADDER, 1e-6) == LADDER[0]


@given(signal=st.floats(1e-3, 6.0e6), first_guess_s=st.one_of(st.none(), st.floats(1e-5, 60.0)))
def test_metering_finds_the_longest_exposure_that_fits(signal: float, first_guess_s: float | None) -> None:
    region = Region(signal)
    chosen_s = meter(region, first_guess_s=first_guess_s)
    fitting = [t for t in LADDER if round(min(BLACK_DN + signal * t, FULL_SCALE_DN)) <= 0.7 * FULL_SCALE_DN]
    # a prediction from at least 5 % of full scale multiplies half a count of rounding by up to 16
    near = [t for t in LADDER if abs(BLACK_DN + signal * t - 0.7 * FULL_SCALE_DN) < 8.0]
    assert chosen_s == max(fitting) or near
    assert chosen_s in fitting
    assert len(region.exposures_s) <= 9  # 19 rungs in steps of three while saturated, then two to settle


def test_dark_region_gets_the_longest_exposure() -> None:
    assert meter(Region(0.0)) == LADDER[-1]


def test_region_too_bright_at_the_shortest_exposure_is_refused() -> None:
    with pytest.raises(
        SaturatedError, match=r"fluorescence behind 600: .*70 % of full scale \(1023 DN\).*0\.0001 to 26"
    ):
        meter(Region(1e8))


def test_one_saturated_pixel_counts_even_below_the_percentile() -> None:
    def take(exposure_s: float) -> np.ndarray:
        counts = np.full((100, 100), 100, dtype=np.uint16)
        counts[3, 4] = FULL_SCALE_DN if exposure_s > 0.011 else 500
        return counts

    chosen_s = meter_exposure(take, LADDER, FULL_SCALE_DN, BLACK_DN, 0.7, "white")
    assert chosen_s == rung_at_or_below(LADDER, 0.011)


def test_brightest_bayer_site_decides() -> None:
    counts = np.full((40, 40), 50, dtype=np.uint16)
    counts[1::2, 1::2] = 700
    assert brightest_dn(counts) == 700
    assert saturated_fraction(counts, 700) == 0.25
