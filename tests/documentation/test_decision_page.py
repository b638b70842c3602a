"""The page of a decision: what to build, how exactly, at which risk; self-contained, accessible and safe."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from example_records import example_decision, example_results
from html_page import TRUST, Page, assert_stands_alone

from data_schemas import AngleStatement, DecidedContact
from data_schemas.storage import write_record
from finray_calib.reports import _decision_page as words
from finray_calib.reports import angle_figure, decision_page
from finray_calib.reports._decision_figures import _LOOKS, contacts_figure, mounting_figure, other_objectives_figure
from tests.command_line.running import finray, succeed

SWEEP = example_results().sweep
ORIGIN = example_results().provenance
DECISION = example_decision("decided")
ALONE = example_decision("undecided", validated=False).model_copy(update={"other_objectives": ()})
HOSTILE = '</script><script>alert(1)</script> & "quoted" $\\frac{'
COMMAND = "finray decide sweep.json --out decision.json"
DIGESTS = {"sweep.json": "ab" * 32}


def page_of(decision=DECISION, sweep=SWEEP) -> str:
    return decision_page(decision, [sweep], COMMAND, DIGESTS)


def plain(html: str) -> str:
    """Return the prose of a page with common spaces."""
    return Page(html).prose.replace("\u00a0", " ")


@pytest.fixture(scope="module")
def html() -> str:
    return page_of()


def test_a_designer_finds_angle_tolerance_and_risk_before_anything_else(html):
    page = Page(html)
    assert page.open == []
    start = plain(html[: html.index(TRUST)])
    for text in (
        "Mount the light at 32 deg",
        "32 deg: true optimum within 5 deg with probability 0.71",
        "None better by more than 2 % 0.97 probability \u2713 good : a decision needs 0.95",
        "Another angle may be better by 0.3 % of the brightness, averaged over the possible errors of the simulation; "
        "at most 1.4 % with 95 % probability",
        "0 deg along the pad towards the tip, 90 deg straight into it",
        "On the drawing: 32 deg, -7 / +7 deg. At each angle inside this tolerance at most 2 % of the signal is lost",
        "on average 0.3 % of the signal is lost against the best possible angle, and in 19 of 20 cases not more than "
        "1.4 %",
        "The objectives disagree: surface normal is best at 62 deg and loses 21 % here",
        "One capture is part of this decision. By renders alone the angle would be 32 deg and the loss below 0.4 %",
    ):
        assert text in start
    # first what to do, then the finger with its light, then why
    assert (
        html.index('id="verdict"')
        < html.index("<img")
        < html.index(">Why, and how sure it is</h2>")
        < html.index("<table")
    )


@pytest.mark.parametrize(
    ("verdict", "title", "meaning"),
    [
        ("decided", "Mount the light at 32 deg", "only nearby angles are equally good"),
        (
            "tie",
            "Several angles are equally good; take 32 deg unless you have a reason",
            "easiest to build",
        ),
        ("undecided", "Not decided yet; 32 deg is the best guess so far", "More angles or more repeats would help"),
        (
            "needs captures",
            "32 deg is the best guess; the simulation is not good enough to decide",
            "More renders will not help",
        ),
    ],
)
def test_every_verdict_says_what_to_do(verdict, title, meaning):
    text = plain(page_of(example_decision(verdict)))
    assert title in text
    assert meaning in text


def test_what_the_renders_alone_say_is_said_of_their_own_angle():
    """Captures have moved the angle from 50 to 32 deg."""
    moved = {"angle_simulation_only_deg": 50.0}
    limited = words.decision_meaning(example_decision("needs captures").model_copy(update=moved))
    assert limited.startswith("By the renders alone 50 deg loses at most 0.4 %; ")
    assert "32 deg is the best guess and may lose 1.4 %" in limited
    undecided = words.decision_meaning(example_decision("undecided").model_copy(update=moved))
    assert "50 deg is their best guess so far, and may lose 0.4 %. With captures the best guess is 32 deg." in undecided
    assert "With captures" not in words.decision_meaning(ALONE)


def test_at_the_end_of_the_sweep_nothing_is_promised():
    html = page_of(example_decision("undecided").model_copy(update={"at_range_end": True}))
    text = plain(html)
    assert "The optimum may lie outside the sweep: widen the sweep." in text
    assert "Next: simulate a sweep that goes beyond 32 deg, and decide again." in text
    for absent in ("On the drawing", "Risk:", "Mounting tolerance", "Next render", "More angles or more repeats"):
        assert absent not in text


@pytest.mark.parametrize(
    ("expected", "most", "light"), [(0.003, 0.014, "good"), (0.003, 0.021, "care"), (0.021, 0.05, "bad")]
)
def test_the_light_of_the_loss_follows_the_tolerance(expected, most, light):
    claim = DECISION.statement.model_copy(update={"expected_regret": expected, "regret_95": most})
    html = page_of(DECISION.model_copy(update={"statement": claim}))
    assert f'<div class="{light}"><dt>Another angle may be better</dt>' in html


def test_what_to_do_next_does_not_contradict_the_verdict():
    """Over several places no render is looked for; where captures are needed, it is not said that none would help."""
    contact = DecidedContact(
        sweep="a", shape="ball", position_mm=10.0, across_mm=0.0, depth_mm=1.0, weight_share=0.5, best_deg=30.0,
        loss_rel=0.0, loss_95_rel=0.1,
    )  # fmt: skip
    nothing = {"next_render": None, "next_capture": None}
    several = example_decision("needs captures").model_copy(update={**nothing, "contacts": (contact, contact)})
    (told,) = words.next_sentences(several)
    assert told.startswith("Next capture: no single capture is expected to change the angle. Several ")
    normal = several.model_copy(update={"aim": "normal"})
    assert "not by the error of the normal" in " ".join(words.next_sentences(normal))
    assert words.next_sentences(DECISION.model_copy(update=nothing)) == (
        "Next render: none is expected to change the decision.",
        "Next capture: none is expected to change the decision.",
    )


def test_losses_that_are_equal_to_no_angle_are_said_in_words():
    claim = DECISION.statement.model_copy(update={"equivalent_deg": ()})
    said = words.capture_sentence(DECISION.model_copy(update={"statement": claim}))
    assert said.endswith(
        "with captures the angle is 32 deg and the loss below 1.4 % (95 % probability; within the tolerance: no angle)."
    )


def test_the_end_of_a_sweep_is_never_green():
    html = page_of(DECISION.model_copy(update={"at_range_end": True}))
    assert '<section class="verdict care"' in html
    assert '<div class="bad"><dt>Light angle</dt>' in html


def test_without_a_capture_it_is_said_at_once():
    html = page_of(ALONE)
    assert (
        "not validated against a capture. How far the finger differs from the simulation is assumed: 10 % (95 %: 2.5 % "
        "to 40 %) at each angle. If the simulation were exact, the loss would stay below 0.4 %"
    ) in plain(html[: html.index(TRUST)])
    text = plain(html)
    assert "At an angle without a capture the simulation may be off by 10 %" in text
    assert "assumed until a capture measures it" in text
    assert "At most 2 % is lost with probability 0.51" in text
    assert "Next capture: none is expected to change the decision." in text
    assert "Another objective may prefer another angle." in text
    assert (
        "Light at 32 deg, not validated against a capture claim with the assumed sim-to-real error renders alone"
        in text
    )
    for absent in (
        "with captures",
        "Captures in this decision",
        "Objectives side by side",
    ):
        assert absent not in text


def test_a_record_of_before_the_prior_says_that_it_rests_on_the_simulation():
    """Such a record of a decision without captures holds no sim-to-real error and no odds of a small loss."""
    bare = {"discrepancy_rel": None, "discrepancy_95_rel": None}
    claim = ALONE.statement_simulation_only.model_copy(update={"p_within_tolerance": None})
    text = plain(page_of(ALONE.model_copy(update={**bare, "statement": claim, "statement_simulation_only": claim})))
    assert "not validated against a capture: it holds only if the simulation is correct" in text
    assert "loss within 2 %, probability not stored" in text
    for absent in ("assumed sim-to-real error", "At an angle without a capture", "is lost with probability"):
        assert absent not in text


def test_a_simulation_that_no_capture_confirms_asks_for_one():
    limited = ALONE.model_copy(update={"verdict": "needs captures"})
    text = plain(page_of(limited))
    assert "32 deg is the best guess of the simulation; a capture has to confirm it" in text
    assert "but no capture has shown how far the finger differs from the simulation" in text


def test_no_tolerance_is_promised_where_none_is_known():
    for ranges in ((), ((10.0, 20.0),), ((32.0, 32.0),)):
        claim = DECISION.statement.model_copy(update={"equivalent_deg": ranges})
        decision = DECISION.model_copy(update={"statement": claim})
        assert words.tolerance_text(claim, 32.0) == "none known"
        assert "No tolerance can be stated" in words.mounting_sentence(decision)
    split = AngleStatement(
        p_within_5deg=0.5, expected_regret=0.01, regret_95=0.015, equivalent_deg=((10.0, 15.0), (30.0, 41.0))
    )
    assert words.tolerance_text(split, 32.0) == "-2 / +9 deg"


def test_captures_and_proposals_are_listed(html):
    text = plain(html)
    assert "cylinder press, simulated twin 30 \u00b1 0.52 deg +1.8 % 0.6 %" in text
    assert "Next render: at 28 deg. It may move the chosen angle; expected gain on average: below 0.1 %" in text
    assert "Next capture: at 35 deg." in text
    assert "may be off by 1.8 % (95 %: 0.6 % to 6 %)" in text
    two = DECISION.model_copy(update={"captures": 2 * DECISION.captures, "discrepancy_95_rel": None})
    assert words.capture_sentence(two).startswith("2 captures are part of this decision")
    assert "may be off by 1.8 %, as one standard deviation" in str(words.discrepancy_sentence(two))


def test_objectives_that_agree_or_cannot_be_told_are_not_called_a_disagreement():
    normal, uniformity = DECISION.other_objectives
    unsure = DECISION.model_copy(update={"other_objectives": (uniformity,)})
    assert words.disagreement_sentence(unsure) == (
        "No other objective of the sweep is shown to need another angle (for 1 the sweep is too noisy to decide this): "
        "uniformity."
    )
    agree = DECISION.model_copy(update={"other_objectives": (normal.model_copy(update={"disagrees": False}),)})
    assert words.disagreement_sentence(agree) == (
        "No other objective of the sweep is shown to need another angle: surface normal."
    )


def test_figures_show_captures_forbidden_angles_and_any_mounting():
    without = DECISION.model_copy(update={"captures": ()})
    assert len(angle_figure(DECISION, SWEEP).svg) > len(angle_figure(without, SWEEP).svg)
    # of several places a capture is on no curve of the figure
    several = over_places(captures=DECISION.captures)
    assert angle_figure(several, SWEEP) == angle_figure(over_places(), SWEEP)
    free = SWEEP.model_copy(update={"constraints": None})
    assert len(other_objectives_figure(DECISION, SWEEP)) > len(other_objectives_figure(DECISION, free))
    named = SWEEP.other_objectives[0].model_copy(update={"name": HOSTILE})
    assert "<svg" in other_objectives_figure(DECISION, SWEEP.model_copy(update={"other_objectives": (named,)}))
    short = SWEEP.design.model_copy(update={"pad": SWEEP.design.pad.model_copy(update={"length_mm": 30.0})})
    for angle_deg, design in ((0.0, SWEEP.design), (120.0, SWEEP.design), (90.0, short)):
        assert "<svg" in mounting_figure(DECISION.model_copy(update={"angle_deg": angle_deg}), design)


def test_hostile_names_stay_text_and_nothing_comes_from_outside():
    capture = DECISION.captures[0].model_copy(update={"captured": HOSTILE})
    decision = DECISION.model_copy(
        update={"sentence": HOSTILE, "objective": HOSTILE, "captures": (capture,), "notes": (HOSTILE,)}
    )
    design = SWEEP.design.model_copy(update={"name": HOSTILE})
    html = page_of(decision, SWEEP.model_copy(update={"name": HOSTILE, "design": design}))
    page = Page(html)
    assert "<script>alert" not in html
    assert page.prose.count(HOSTILE) >= 6
    assert_stands_alone(html)
    block = re.search(r'id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    assert json.loads(block[1])["decision"]["sentence"] == HOSTILE


def test_the_embedded_json_holds_decision_and_sweep(html):
    block = re.search(r'id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    numbers = json.loads(block[1])
    assert numbers["command"] == COMMAND
    assert numbers["decision"]["statement"]["regret_95"] == DECISION.statement.regret_95
    assert numbers["decision"]["mean"] == DECISION.mean.tolist()
    assert numbers["sweeps"][0]["angles_deg"] == SWEEP.angles_deg.tolist()


def test_it_reads_well_without_eyes_or_mouse(html):
    page = Page(html)
    texts = [str(image["alt"]) for image in page.all("img")]
    assert len(texts) == 3
    assert "shines at 32 deg from the pad's plane" in texts[0]
    assert "the best angle is near 32 deg. 32 deg: true optimum within 5 deg" in texts[1]
    assert "surface normal is best at 62 deg" in texts[2]
    assert {heading.get("scope") for heading in page.all("th")} == {"col", "row"}
    assert len(page.all("caption")) == len(page.all("table")) == 5
    boxes = [attributes for _, attributes in page.tags if attributes.get("class") == "scroll"]
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in boxes)
    assert page.all("html")[0]["lang"] == "en"


def test_equal_input_gives_equal_bytes_and_no_claim_of_traceability(html):
    assert page_of() == html
    assert "traceable" not in html.lower()


def test_the_verb_writes_record_and_page_or_neither(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_record(SWEEP, Path("sweep.json"), ORIGIN)
    said = succeed("decide sweep.json --out decision.json")
    assert "decision.html: the decision with its reasons" in said
    assert "finray decide sweep.json --out decision.json" in plain(Path("decision.html").read_text(encoding="utf-8"))
    Path("taken.html").touch()
    outcome = finray("decide sweep.json --out taken.json")
    assert outcome.status == 2
    assert "taken.html: exists already and is not overwritten" in outcome.err
    assert not Path("taken.json").exists()
    outcome = finray("decide sweep.json --out page.html")
    assert outcome.status == 2
    assert "page.html: must be a record: choose an --out that ends in .json" in outcome.err


PLACES_MM = (8.0, 20.0, 50.0)


def over_places(verdict="needs captures", criterion="average", **changes):
    """A decision of today over three places, which lose 22, 2 and 1 %."""
    grid = DECISION.grid_deg
    losses = np.array([0.22, 0.02, 0.01])
    tops = (63.0, 31.0, 10.0)
    value = np.array([1 - loss * ((grid - top) / (32.0 - top)) ** 2 for loss, top in zip(losses, tops, strict=True)])
    contacts = tuple(
        DecidedContact(
            sweep=f"place {place:g}", shape="cylinder", position_mm=place, across_mm=0.0, depth_mm=1.5,
            weight_share=1 / 3,
            best_deg=top, loss_rel=loss, loss_95_rel=loss + 0.3,
        )
        for place, top, loss in zip(PLACES_MM, tops, losses, strict=True)
    )  # fmt: skip
    first = "Mount the light at 32 \u00b1 6 deg: the brightness of the touch is on average 8.3 % below the best."
    told = {
        "headline": first, "sentence": f"{first} So says the simulation. It holds for touches at 8 to 50 mm.",
        "contacts": contacts, "contact_value": value, "angle_average_deg": 32.0, "angle_worst_deg": 47.0,
        "tolerance_deg": (26.0, 41.0), "criterion": criterion, "verdict": verdict,
    }  # fmt: skip
    return ALONE.model_copy(update={**told, **changes})


def test_no_range_is_hatched_where_none_is_known_and_a_disagreement_is_told_once():
    nowhere = DECISION.statement.model_copy(update={"equivalent_deg": ()})
    changes = {"at_range_end": True, "statement": nowhere, "other_objectives": DECISION.other_objectives}
    text = plain(decision_page(over_places(**changes), [SWEEP] * 3, COMMAND, DIGESTS))
    assert "hatched" not in text.lower()
    assert text[: text.index("How far to trust this")].count("The objectives disagree") == 0
    assert "The objectives disagree" in text


def test_each_objective_of_a_sweep_has_a_line_of_its_own():
    """A sweep with all objectives has five beside the one that was decided on."""
    assert len(set(_LOOKS)) >= 5


def test_a_decision_over_places_begins_with_what_to_do_then_the_finger_then_the_map_then_why():
    html = decision_page(over_places(), [SWEEP] * 3, COMMAND, DIGESTS)
    assert Page(html).open == []
    order = [
        "Mount the light at 32 \u00b1 6 deg: the brightness of the touch is on average 8.3 % below the best.",
        "The finger from the side, to scale.",
        "Hatched: angles between 26 and 41 deg cost at most 2 % more.",
        "The angle is not decided 32 deg ! with care : captures are needed",
        "What each place loses",
        "8 mm 33 % 63 deg 22 % 52 %",
        "Why, and how sure it is So says the simulation. It holds for touches at 8 to 50 mm.",
        "Best on average is 32 deg: a loss of 8.3 % on average and 22 % at most. Best at the worst place is 47 deg:",
        "The best on average was chosen: the criterion is 'average'.",
    ]
    text = plain(html[: html.index(TRUST)])
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    for absent in ("model-limited", "Risk:", "On the drawing"):
        assert absent not in text
    assert "The best at the worst place was chosen" in plain(
        decision_page(over_places(criterion="worst"), [SWEEP] * 3, COMMAND, DIGESTS)
    )
    numbers = json.loads(re.search(r'id="summary">(.*?)</script>', html, re.DOTALL)[1])
    assert [sweep["name"] for sweep in numbers["sweeps"]] == [SWEEP.name] * 3


def test_a_decision_on_the_normal_shows_its_error_and_what_others_cost():
    normal = DECISION.other_objectives[0].model_copy(update={"name": "brightness", "cost_rel": 0.2})
    html = decision_page(over_places(aim="normal", other_objectives=(normal,)), [SWEEP] * 3, COMMAND, DIGESTS)
    text = plain(html)
    for told in (
        "how much larger the error of the sensed normal is than at the best angle for that place (expected value)",
        "8 mm 33 % 63 deg 28 % 108 %",
        "Marks on the pad: the places that were looked at",
        "brightness 62 deg 25 % 21 % [17 %, 25 %] yes",
        "brightness is best at 62 deg and loses 21 % here (there: 25 % larger error of the normal)",
    ):
        assert told in text
    assert "Next capture" not in text


def test_the_map_needs_a_decision_that_holds_one():
    assert "<svg" in contacts_figure(over_places())
    same = tuple(contact.model_copy(update={"position_mm": 8.0}) for contact in over_places().contacts)
    assert "<svg" in contacts_figure(over_places(contacts=same))
    deep = (same[0], same[1].model_copy(update={"depth_mm": 3.0, "across_mm": 2.0, "shape": "ball"}))
    assert words.touch_text(deep[1], deep) == "8 mm, 2 mm across, 3 mm deep, ball"
    with pytest.raises(ValueError, match="contains no map over angle and touch; decide again on the same sweeps"):
        contacts_figure(DECISION)
