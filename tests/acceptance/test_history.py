"""History of sessions: what is read of their frames, verdicts, the ledger of light, the page and the command."""

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import FinrayError
from finray_calib.acceptance import SessionFacts, chart_rules, session_facts, session_history, watch
from finray_calib.cli.main import main
from finray_calib.reports import history_page
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session, read_frame_of, read_session


def rig_with(seed=1, kelvin=2856, power_mw=4.5):
    rig = simulated_rig("red", width_px=96, height_px=80)
    return rig.model_copy(
        update={
            "lamp": rig.lamp.model_copy(update={"spectrum": f"planck-{kelvin}K"}),
            "laser": rig.laser.model_copy(update={"power_mw": power_mw}),
            "simulated": rig.simulated.model_copy(update={"seed": seed}),
        }
    )


def capture(out, **changes):
    rig = rig_with(**changes)
    capture_paint_session(rig, paint_plan("red", rig.camera), SessionRequest(out, "finray capture"))
    return out


def facts_of(folder) -> SessionFacts:
    return session_facts(folder.name, read_session(folder), lambda frame: read_frame_of(folder, frame))


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return facts_of(capture(tmp_path_factory.mktemp("usual") / "session"))


def test_lamp_and_laser_of_the_frames_are_those_of_the_bench(usual, tmp_path):
    """A lamp of 2906 K: its colour by Planck's law; a laser with 5 % more power: its level, and nothing of the lamp."""
    warm, strong = facts_of(capture(tmp_path / "warm", kelvin=2906)), facts_of(capture(tmp_path / "s", power_mw=4.725))
    centres = np.array([f.center_nm for f in rig_with().filter_wheel.filters])
    second_nm_k = 1.438776877e7
    change = 100 * (np.log(np.expm1(second_nm_k / (centres * 2856)) / np.expm1(second_nm_k / (centres * 2906))))
    slope = np.polyfit((centres - centres.mean()) / np.ptp(centres), change, 1)[0]
    colour = "lamp colour, long / short wavelengths (%)"
    assert warm.rig[colour] - usual.rig[colour] == pytest.approx(slope, abs=0.5)
    assert strong.rig["laser level (%)"] - usual.rig["laser level (%)"] == pytest.approx(100 * math.log(1.05), abs=0.5)
    assert strong.rig["lamp level (%)"] - usual.rig["lamp level (%)"] == pytest.approx(0.0, abs=0.3)
    assert strong.sample["emission (%)"] - usual.sample["emission (%)"] == pytest.approx(0.0, abs=1.0)


def test_dark_frames_and_dose(usual):
    rig = rig_with()
    assert usual.rig["dark level (DN)"] == pytest.approx(rig.camera.black_level_dn, abs=0.5)
    assert usual.dose_j > 0
    assert 550 < usual.sample["centroid of the emission (nm)"] < 650


def test_blur_lowers_the_sharpness(usual, tmp_path):
    """Frames that are blurred as they are read, by the mean of 2 x 2 neighbouring greens: edges are half as steep."""
    folder = capture(tmp_path / "session")
    session = read_session(folder)

    def blurred(frame):
        counts = read_frame_of(folder, frame).astype(float)
        shifted = [np.roll(counts, (i, j), (0, 1)) for i in (0, 2) for j in (0, 2)]
        return np.round(np.mean(shifted, axis=0)).astype(np.uint16)

    soft = session_facts("soft", session, blurred)
    name = "sharpness of the white frames (%)"
    assert soft.rig[name] < 0.85 * usual.rig[name]


def test_frames_that_cannot_be_reduced_are_a_fault(tmp_path):
    folder = capture(tmp_path / "session")
    session = read_session(folder)
    dark = session.model_copy(update={"frames": tuple(f for f in session.frames if f.frame_type != "dark")})
    found = session_facts("no darks", dark, lambda frame: read_frame_of(folder, frame))
    assert "no dark frames" in found.fault
    good = [replace(found, name=f"s{i}", captured_utc=f"2026-01-{i + 1:02d}", rig={}, fault="") for i in range(7)]
    history = session_history([*good, replace(found, captured_utc="2026-02-01")], 6)
    assert history.verdict == "OUT OF CONTROL"
    assert "no darks: cannot be reduced" in history.reasons[0]


@pytest.mark.parametrize(
    ("kind", "what"), [("white", "lamp behind filter 405"), ("laser white", "laser behind filter 450")]
)
def test_a_session_without_light_is_a_fault_and_the_others_are_charted(usual, tmp_path, kind, what):
    """The frames of one light are dark frames less 1 DN, as of a lamp or laser that stayed off."""
    folder = capture(tmp_path / "session")
    session = read_session(folder)
    read = {frame.file: read_frame_of(folder, frame) for frame in session.frames}
    dark = {f.exposure_requested_s: read[f.file] for f in session.frames if f.frame_type == "dark"}

    def unlit(frame):
        return dark[frame.exposure_requested_s] - 1 if frame.frame_type == kind else read[frame.file]

    found = session_facts("unlit", session, unlit)
    assert f"{what}: the signal of the white tile is -" in found.fault
    scattered = noise(12)
    good = [replace(usual, name=f"s{i}", captured_utc=f"2026-01-{i + 1:02d}", sample={}) for i in range(12)]
    good = [
        replace(one, rig={name: value + extra for name, value in one.rig.items()})
        for one, extra in zip(good, scattered, strict=True)
    ]
    history = session_history([*good, replace(found, captured_utc="2026-02-01")])
    assert history.verdict == "OUT OF CONTROL"
    assert "unlit: cannot be reduced" in history.reasons[-1]


def made(values, *, paint="red", quantity="lamp level (%)", fading=None):
    """Return facts with one quantity of the rig."""
    return [
        SessionFacts(
            name=f"s{i:02d}",
            captured_utc=f"2026-01-{i + 1:02d}T00:00:00",
            rig_name="rig",
            paint_name=paint,
            dose_j=0.5,
            rig={quantity: float(value)},
            sample={},
            fading_per_j=fading,
            fading_sd_per_j=None if fading is None else 0.01,
        )
        for i, value in enumerate(values)
    ]


def noise(n, seed=1):
    return np.random.default_rng(seed).standard_normal(n)


def test_in_control_until_a_step():
    values = noise(16)
    assert session_history(made(values)).verdict == "IN CONTROL"
    values[13:] += 8.0
    found = session_history(made(values))
    assert found.verdict == "OUT OF CONTROL"
    assert found.reasons[0].startswith("s13: lamp level (%) is +")
    assert session_history(made(values), cleared="s15").verdict == "IN CONTROL"


def test_a_session_of_the_reference_that_stands_out_is_told_once_with_what_shows_it():
    values = noise(12)
    values[4] += 30.0
    facts = [
        replace(one, rig={f"filter {k} (%)": one.rig["lamp level (%)"] for k in (450, 500)}) for one in made(values)
    ]
    found = session_history(facts)
    assert found.outliers == {"s04": ["filter 450 (%)", "filter 500 (%)"]}
    page = history_page(found, "lab", 10)
    assert page.count("s04 differs from the rest of the reference") == 1
    assert "(filter 450 (%), filter 500 (%))" in page


def test_order_is_that_of_the_capture():
    values = noise(14)
    facts = made(values)
    assert session_history(facts[::-1]).watched[0].sessions == tuple(one.name for one in facts)


def test_few_sessions_decide_nothing_and_the_history_says_which_session_is_the_first_that_is_judged():
    found = session_history(made(noise(8)))
    assert found.verdict == "UNDECIDED"
    assert found.waiting == (
        "rig: has 8 of the 10 sessions that its reference needs; session 11 is the first that is judged: capture 3 "
        "more, or give a smaller reference (6 or more)",
    )
    assert session_history(made(noise(5)), reference=6).waiting[0].endswith("judged: capture 2 more")
    full = session_history(made(noise(10)))
    assert full.verdict == "UNDECIDED"
    assert full.waiting == (
        "rig: all 10 sessions belong to the reference; capture another, which is the first that is judged",
    )
    assert session_history(made(noise(11))).waiting == ()
    alike = session_history(made(np.ones(12)))
    assert (alike.verdict, alike.watched) == ("UNDECIDED", ())
    assert "exactly the same" in alike.waiting[0]


@pytest.mark.parametrize(("reference", "at_once", "within_five"), [(6, 9.1, 4.3), (10, 5.8, 3.0), (20, 4.5, 2.3)])
def test_deviations_that_are_found_half_of_the_time(reference, at_once, within_five):
    """The sizes of docs/how-to/watch-a-rig.md, for 18 charts that share 1 %; of sessions that scatter normally."""
    rules = chart_rules(1 - 0.99 ** (1 / 18), reference)
    rng = np.random.default_rng(reference)
    found = {at_once: 0, within_five: 0}
    for deviation, sessions in ((at_once, 1), (within_five, 5)):
        for _ in range(1500):
            values = rng.standard_normal(reference + sessions)
            values[reference:] += deviation
            found[deviation] += bool(watch(values, rules).alarms)
    # sizes are rounded to 0.1: up to 2 % more or less are found; four errors of 1500 rigs are 5.2 %
    assert [count / 1500 for count in found.values()] == pytest.approx([0.5, 0.5], abs=0.075)


def test_false_alarms_are_shared_by_all_charts():
    """400 rigs in control with 6 quantities and 20 more sessions: 1 % of the sessions raise an alarm."""
    rng = np.random.default_rng(2)
    alarmed = []
    for _ in range(400):
        facts = made(np.zeros(30))
        facts = [replace(one, rig={f"q{j}": float(rng.standard_normal()) for j in range(6)}) for one in facts]
        found = session_history(facts)
        alarmed.append(len({alarm.place for one in found.watched for alarm in one.chart.alarms}) / 20)
    error = np.std(alarmed) / np.sqrt(len(alarmed))
    assert np.mean(alarmed) == pytest.approx(0.01, abs=4 * error)


def test_ledger_sums_dose_and_fading():
    facts = [*made(noise(4), fading=0.05), *made(noise(2), paint="green", fading=0.001)]
    red, green = session_history(facts).ledger
    assert (red.sessions, red.dose_j) == (4, 2.0)
    assert red.fading_per_j == pytest.approx(0.05)
    assert red.fading_sd_per_j == pytest.approx(0.01 / 2)
    assert red.lost == pytest.approx(-math.expm1(-0.05 * 2.0))
    assert green.lost is None


def test_mistakes():
    with pytest.raises(FinrayError, match="give 6 or more"):
        session_history(made(noise(12)), 3)
    with pytest.raises(FinrayError, match="no session is called 'x'"):
        session_history(made(noise(12)), cleared="x")
    for share in (0.0, 2.0, float("nan")):
        with pytest.raises(FinrayError, match="give a share above 0 and up to"):
            session_history(made(noise(12)), false_alarm_share=share)


def test_page_holds_its_numbers_and_no_markup_of_names():
    values = noise(14)
    values[12] += 30.0
    facts = [replace(one, name=f"<b>{one.name}") for one in made(values)]
    text = history_page(session_history(facts), "<i>lab", 10)
    assert "OUT OF CONTROL" in text
    assert "<b>s12" not in text
    assert "&lt;b&gt;s12" in text
    summary = json.loads(re.search(r'id="summary">(.*?)</script>', text, re.DOTALL)[1])
    assert summary["series"][0]["values"] == pytest.approx(values)


def test_a_chart_says_session_value_and_distance_from_the_reference_under_the_pointer():
    values = noise(14)
    values[12] += 30.0
    facts = [replace(one, name=f"<b>{one.name}") for one in made(values)]
    history = session_history(facts)
    text = history_page(history, "lab", 10)
    words = r"<title>session (\d+), ([^:]*): ([-.e\d]+) %, ([-+.\d]+) sd from the reference(.*?)</title>"
    said = re.findall(words, text)
    chart = text.count('<div class="readable">')  # the first screen shows it again
    assert len(said) == chart * len(values)
    found = said[: len(values)]
    assert [one[1] for one in found] == [f"&lt;b&gt;s{k:02d}" for k in range(len(values))]
    reference = values[: history.watched[0].chart.rules.reference]
    # a quantity in per cent is a logarithm: only its differences are told, to two digits
    assert [float(one[2]) for one in found] == pytest.approx(values - reference.mean(), rel=0.051)
    apart = (values - reference.mean()) / reference.std(ddof=1)
    assert [float(one[3]) for one in found] == pytest.approx(apart, abs=0.051)
    assert found[12][4] == "; alarm"
    assert found[0][4] == ""


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    """Seven sessions; the last has a laser with 10 % less power."""
    folder = tmp_path_factory.mktemp("lab")
    for i in range(7):
        capture(folder / f"s{i}", seed=i + 1, power_mw=4.05 if i == 6 else 4.5)
    return folder


def test_command(lab, tmp_path, capsys):
    page = tmp_path / "history.html"
    assert main(["history", str(lab), "--reference", "6", "--report", str(page)]) == 1
    told = capsys.readouterr().out
    assert told.startswith("OUT OF CONTROL: 7 sessions")
    assert "s6: laser level (%)" in told
    assert "light on 'red'" in told
    assert "laser level" in page.read_text()
    assert main(["history", str(lab), "--reference", "6", "--cleared", "s6"]) == 0
    assert main(["history", str(lab), "--reference", "6", "--report", str(page)]) == 2
    assert main(["history", str(lab)]) == 0
    assert "  not judged: rig: has 7 of the 10 sessions" in capsys.readouterr().out.replace(rig_with().name, "rig")


def test_a_wrong_name_of_a_cleared_session_is_refused_before_any_session_is_read(lab, capsys, monkeypatch):
    monkeypatch.setattr("rigs.capture.read_session", lambda place: pytest.fail(f"{place} was read"))
    assert main(["history", str(lab), "--reference", "6", "--cleared", "s9"]) == 2
    assert "--cleared s9: no such session; give one of s0, s1, s2, s3, s4, s5, s6" in capsys.readouterr().err


def test_a_page_of_few_sessions_names_folder_and_newest_session_and_an_unfinished_one_is_told(
    lab, tmp_path, capsys, monkeypatch
):
    for name in ("s0", "s1"):
        shutil.copytree(lab / name, tmp_path / name)
    (tmp_path / "s2").mkdir()
    shutil.copy(lab / "s2" / "journal.jsonl", tmp_path / "s2")
    monkeypatch.chdir(tmp_path)
    assert main(["history", ".", "--report", "history.html"]) == 0
    told = capsys.readouterr()
    assert told.out.startswith("UNDECIDED: 2 sessions")
    assert "note: s2: its capture was not finished, so that this session is left out" in told.err
    page = (tmp_path / "history.html").read_text()
    assert str(tmp_path) in re.search(r"<title>(.*?)</title>", page, re.DOTALL)[1]
    newest = max(read_session(tmp_path / name).frames[0].captured_utc for name in ("s0", "s1"))
    assert newest[:10] in re.search(r"Newest session.{0,200}", page, re.DOTALL)[0]


def test_a_folder_without_sessions(tmp_path, capsys):
    assert main(["history", str(tmp_path)]) == 2
    assert "holds no paint session" in capsys.readouterr().err
