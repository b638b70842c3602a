"""The page of a search over designs says what the record says, and no more."""

import pytest

from data_schemas import DesignOptimum, LightPowers, NormalErrorChange
from data_schemas.storage import read_record
from finray_calib.reports.studies import front_rows, light_powers_page, optimum_page
from tests.schemas.freeze import example_of


@pytest.fixture(scope="module")
def optimum() -> DesignOptimum:
    return read_record(example_of(DesignOptimum, 1), DesignOptimum)


def page(optimum: DesignOptimum) -> str:
    return optimum_page(optimum, "finray design optimise x.toml", {"x.toml": "0" * 64}, "0.1.0")


def test_verdict_front_and_trade_are_told(optimum: DesignOptimum) -> None:
    text = page(optimum)
    # one objective was bought with another one: no green light
    assert "better than the start; light" in text
    assert "worse than the start" in text
    assert "with care" in text
    assert "shrinkage" in text
    assert "The chosen finger is the best of the front in error." in text or "Best in error: design" in text
    assert "could not be evaluated" not in text
    for row in front_rows(optimum):
        assert f"{row.changes['light.angle_deg']:.4g}" in text
    assert front_rows(optimum) == sorted(front_rows(optimum), key=lambda row: row.values["error"])
    assert page(optimum) == text


def test_an_unconfirmed_gain_is_called_so(optimum: DesignOptimum) -> None:
    gains = tuple(
        gain.model_copy(update={"confirmed_rel": None, "confirmed_95_rel": None, "shrinkage_rel": None})
        for gain in optimum.gains
    )
    text = page(optimum.model_copy(update={"gains": gains}))
    assert "not confirmed with other seeds" in text
    assert "not done" in text


def test_worse_than_the_screen_is_not_called_worse_than_the_start(optimum: DesignOptimum) -> None:
    gains = tuple(
        gain.model_copy(update={"confirmed_rel": -0.2, "confirmed_95_rel": (-0.3, -0.1)})
        if gain.against == "best of the screen"
        else gain.model_copy(update={"confirmed_rel": 0.2, "confirmed_95_rel": (0.1, 0.3)})
        for gain in optimum.gains
    )
    text = page(optimum.model_copy(update={"gains": gains, "sentence": "The sentence of the record."}))
    assert "really worse" in text
    assert "worse than the start" not in text


@pytest.mark.parametrize(("low95", "verdict"), [(-0.01, "No gain is certain"), (0.01, "More even, but")])
def test_powers_without_a_certain_gain_are_not_called_more_even(low95: float, verdict: str) -> None:
    record = read_record(example_of(LightPowers, 1), LightPowers)
    gain = record.gain_rel.model_copy(update={"low95": low95, "high95": 0.3})
    worse = NormalErrorChange(now_deg=5.0, recommended_deg=6.0, change_rel=0.2, low95_rel=0.1, high95_rel=0.3)
    text = light_powers_page(record.model_copy(update={"gain_rel": gain, "normal_error": worse}), "finray", {})
    assert verdict in text


def test_an_optimum_at_a_limit_is_told(optimum: DesignOptimum) -> None:
    assert "ends at its limit" not in page(optimum)
    chosen = optimum.designs[-1]
    at_limit = chosen.model_copy(update={"changes": {**chosen.changes, "pad.thickness_mm": 10.0}})
    text = page(optimum.model_copy(update={"designs": (*optimum.designs[:-1], at_limit)}))
    assert "pad.thickness_mm ends at its limit (10)" in text


def test_names_and_notes_are_escaped(optimum: DesignOptimum) -> None:
    text = page(optimum.model_copy(update={"name": "<script>alert(1)</script>", "notes": ("<img src=x>",)}))
    assert "<script>alert(1)" not in text
    assert "<img src=x>" not in text
