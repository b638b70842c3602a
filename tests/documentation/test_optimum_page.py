"""The page of a search over designs says what the record says, and no more."""

import pytest

from data_schemas import DesignOptimum
from data_schemas.storage import read_record
from finray_calib.reports.studies import front_rows, optimum_page
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
