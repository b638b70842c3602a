"""The page of tolerances says what its record says, also where numbers of one side of the finger alone vary."""

from pathlib import Path

import numpy as np

from data_schemas import FingerTolerances, LightAngleDecision
from data_schemas.storage import read_record
from finray_calib.reports._finger_page import _assessed_numbers
from finray_calib.reports.studies import limit_text, tolerance_page
from finray_calib.reports.studies._tolerance_page import _labels
from sim import preset_design

EXAMPLE = Path(__file__).parents[1] / "schemas" / "frozen" / "FingerTolerances" / "v1" / "example.json"


def test_the_page_tells_limits_and_shares() -> None:
    found = read_record(EXAMPLE, FingerTolerances)
    page = " ".join(tolerance_page(found, "finray design tolerances <b>", {}).split())
    assert found.sentence in page
    assert "24.9 [22.4, 27.4]" in page
    assert "over 32" in page
    assert "not distinguishable from 0" in page
    assert "12 of 12" in page
    assert "&lt;b&gt;" in page
    assert "calibrated as it was built" in page


def test_a_number_of_the_mirror_alone_is_drawn() -> None:
    found = read_record(EXAMPLE, FingerTolerances)
    row = found.rows[0].model_copy(update={"field": "mirror.radius_mm", "unit": "mm"})
    alone = found.model_copy(update={"rows": (row,), "inputs": np.zeros((3, 1)), "calibration": "shared"})
    assert "calibration of the finger as drawn" in tolerance_page(alone, "", {})
    assert limit_text(row.less, "mm") == "24.9 mm"
    assert limit_text(row.more, "mm") == "over 32 mm"


def test_numbers_of_the_film_and_of_the_second_panel_stand_at_their_parts() -> None:
    found = read_record(EXAMPLE, FingerTolerances)
    rows = tuple(
        found.rows[0].model_copy(update={"field": field, "unit": unit})
        for field, unit in (("pad.film.thickness_mm", "mm"), ("second_light.angle_deg", "deg"))
    )
    design = preset_design("flat-70x35-two-lights")
    both = found.model_copy(update={"rows": rows, "design": design})
    assert "pad.film.thickness_mm" in tolerance_page(both, "", {})
    film, panel = _labels(both)[True]
    assert film.text.splitlines()[1].startswith("film thickness: ")
    _, y_mm, z_mm = design.second_light.position_mm
    assert (panel.text.splitlines()[0], panel.place_mm) == ("second light", (z_mm, y_mm))


def test_a_page_is_not_good_by_an_emulator_that_is_not_or_against_fingers_that_contradict_it() -> None:
    found = read_record(EXAMPLE, FingerTolerances)
    known = found.model_copy(
        update={"within_given_share": 0.99, "q2": 0.97, "checked_within": 60, "checked_fingers": 64}
    )
    for changes, light, words in (
        ({}, "good", "as many as chance explains"),
        ({"q2": 0.81}, "with care", "by an emulator that explains 81 % of its variance: give more runs"),
        # of 64 fingers of which 95 % stay, 55 or fewer do so in 0.3 %
        ({"checked_within": 55}, "with care", "fingers evaluated again contradict it"),
        ({"within_given_share": 0.3}, "not good", "in 30 % of fingers"),
    ):
        page = tolerance_page(known.model_copy(update=changes), "", {})
        heading = " ".join(page[page.index('<h2 id="verdict">') :][:500].split())
        assert f"</i> {light}</b>" in heading
        assert words in " ".join(page.split())


def test_an_assessment_says_how_much_its_emulator_of_tolerances_explains() -> None:
    folder = sorted((EXAMPLE.parents[2] / "LightAngleDecision").glob("v*"))[-1]
    decision = read_record(folder / "example.json", LightAngleDecision)
    found = read_record(EXAMPLE, FingerTolerances)
    for q2, light in ((0.97, "good"), (0.81, "care")):
        numbers = _assessed_numbers(decision, found.model_copy(update={"q2": q2}), [("pad", "1 N/mm", "")] * 3)
        assert numbers[1].light == light
        assert f"an emulator that explains {100 * q2:.0f} % of the variance" in numbers[1].reason
    # of 64 fingers of which 95 % stay, 55 or fewer do so in 0.3 %
    against = found.model_copy(update={"q2": 0.97, "checked_within": 55, "checked_fingers": 64})
    number = _assessed_numbers(decision, against, [("pad", "1 N/mm", "")] * 3)[1]
    assert number.light == "care"
    assert number.reason.endswith("; fingers evaluated again contradict it")
