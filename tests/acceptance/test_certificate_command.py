"""``finray certificate`` and ``finray check equivalence`` as users run them, on a session, its signals and a fit."""

import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from data_schemas import CERTIFIED, BandUncertainty, CertificateDetails, SessionScatter, provenance
from data_schemas.storage import sha256_of, write_record
from finray_calib.acceptance import certified_results
from finray_calib.cli.main import main
from finray_calib.fit import BudgetRow
from finray_calib.reports import certificate_page, certificate_pdf, paint_certificate
from rigs import paint_plan, simulated_rig
from rigs.capture import SessionRequest, capture_paint_session
from tests.acceptance.paints import MEASURED_ON, example

LABORATORY = Path(__file__).parents[1] / "schemas" / "frozen" / "CertificateDetails" / "v1" / "example.toml"


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    """A folder with a session, its band signals, and the example's calibration as if it were fitted to them."""
    folder = tmp_path_factory.mktemp("lab")
    rig = simulated_rig("red", width_px=160, height_px=128)
    capture_paint_session(rig, paint_plan("red", rig.camera), SessionRequest(folder / "session", "finray capture"))
    assert main(["radiometry", str(folder / "session"), "--out", str(folder / "red.bands.json")]) == 0
    inputs = {"red.bands.json": sha256_of(folder / "red.bands.json")}
    write_record(example(), folder / "red.paint.json", provenance("finray fit red.bands.json", inputs, 1))
    return folder


class _Tags(HTMLParser):
    """Collects the kinds of scripts and where anything is loaded from."""

    def __init__(self):
        super().__init__()
        self.scripts, self.sources = [], []

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        if tag == "script":
            self.scripts.append(named.get("type"))
        self.sources += [named[name] for name in ("src", "href") if name in named]


def test_certificate_of_a_session(measured, tmp_path, capsys):
    page = tmp_path / "red.html"
    words = ["certificate", str(measured / "red.paint.json"), "--laboratory", str(LABORATORY), "--out", str(page)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "Full width at half maximum" in told
    text = page.read_text()
    assert "not traceable: no certificate valid on the day" in text
    assert "no paint was measured, because the rig is simulated" in text.lower()
    assert "reflectance: not traceable: no paint was measured" in text  # though the laboratory holds its certificate
    assert "The calibration and the 2 files behind it were hashed again" in text
    assert "laser dose on the sample" in text
    tags = _Tags()
    tags.feed(text)
    assert tags.scripts == ["application/json"]
    assert all(source.startswith("data:") for source in tags.sources)
    assert page.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    assert main(words) == 2


def test_nothing_is_traceable_whose_session_is_away_or_of_a_simulated_rig(measured, tmp_path, capsys):
    """A calibration does not say of which rig it is: without its session it may be simulated."""
    laboratory, lab = tmp_path / "laboratory.toml", tmp_path / "lab"
    held = '[[references]]\nof = "{}"\nnumber = "1"\nissued_by = "I"\ncalibrated_on = 2020-01-02\n'
    laboratory.write_text("".join(held.format(of) for of in ("white reference", "filters", "lamp")))
    inputs = {}
    for name in ("first", "second"):
        shutil.copytree(measured / "session", lab / name)
        assert main(["radiometry", str(lab / name), "--out", str(lab / f"{name}.bands.json")]) == 0
        inputs[f"{name}.bands.json"] = sha256_of(lab / f"{name}.bands.json")
    write_record(example(), lab / "both.paint.json", provenance("finray fit", inputs, 1))
    del inputs["second.bands.json"]
    write_record(example(), lab / "red.paint.json", provenance("finray fit", inputs, 1))

    def told(paint):
        page = tmp_path / f"{len(list(tmp_path.iterdir()))}.html"
        assert main(["certificate", str(lab / paint), "--laboratory", str(laboratory), "--out", str(page)]) == 0
        return capsys.readouterr().out

    for paint in ("red.paint.json", "both.paint.json"):
        assert "reflectance: not traceable: no paint was measured" in told(paint)
    simulated = "no paint was measured, because the rig is simulated; not traceable: no reference certificate recorded"
    for paint in ("red.paint.json", "both.paint.json"):
        assert main(["certificate", str(lab / paint), "--out", str(tmp_path / f"bare-{paint}.html")]) == 0
        assert simulated in " ".join(capsys.readouterr().out.split())
    shutil.move(lab / "second", tmp_path / "gone-2")
    assert "reflectance: not traceable: no paint was measured" in told("both.paint.json")
    shutil.move(lab / "first", tmp_path / "gone-1")
    for paint in ("red.paint.json", "both.paint.json"):
        assert "reflectance: not traceable: the session that it was measured in was not found" in told(paint)
    (lab / "first.bands.json").unlink()
    assert "reflectance: not traceable: the session that it was measured in was not found" in told("red.paint.json")


def test_files_that_were_changed_since_are_refused(measured, tmp_path, capsys):
    frame = next((measured / "session" / "frames").iterdir())
    whole = frame.read_bytes()
    frame.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    try:
        assert main(["certificate", str(measured / "red.paint.json"), "--out", str(tmp_path / "a.html")]) == 2
    finally:
        frame.write_bytes(whole)
    assert "a certificate needs files that have not changed since they were written" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_files_that_are_away_are_named(tmp_path, capsys):
    path = tmp_path / "red.paint.json"
    write_record(example(), path, provenance("finray fit red.bands.json", {"red.bands.json": "0" * 64}, 1))
    assert main(["certificate", str(path)]) == 0
    text = (tmp_path / "red.certificate.html").read_text()
    assert "1 were not found and not verified" in text
    assert "Not traceable: no reference certificate recorded." in text
    assert "No single session of the frames was found." in text


def test_a_page_has_the_ending_of_one(tmp_path, capsys):
    path = tmp_path / "red.paint.json"
    write_record(example(), path, provenance("finray fit x", {}, 1))
    assert main(["certificate", str(path), "--out", str(tmp_path / "red.pdf")]) == 2
    assert "must end in .html; choose another --out" in capsys.readouterr().err


def test_a_quantity_outside_its_limits_ends_with_1(tmp_path, capsys):
    path, laboratory = tmp_path / "red.paint.json", tmp_path / "laboratory.toml"
    write_record(example(), path, provenance("finray fit x", {}, 1))
    laboratory.write_text('[[limits]]\nquantity = "mode_nm"\nhigh = 500\n')
    assert main(["certificate", str(path), "--laboratory", str(laboratory)]) == 1
    assert "FAIL" in capsys.readouterr().out


def certificate(paint=None, **details):
    given, paint = CertificateDetails(**details), paint or example()
    sources = (*(f"source {i}" for i in range(10)), "lamp", "prior")
    shares = (*[0.02] * 10, 0.3, 0.5)
    budget = tuple(
        BudgetRow(name, source, "50 K", "B", 0.1, share)
        for name in (*CERTIFIED, "stokes_shift_nm")
        for source, share in zip(sources, shares, strict=True)
    )
    results = certified_results(paint, given, MEASURED_ON)
    return paint_certificate(paint, results, given, "0" * 64, MEASURED_ON, budget=budget)


def test_words_of_a_user_are_text_and_no_markup():
    text = certificate_page(certificate(customer="<script>alert(1)</script>", number="$\\frac{1}$"), example())
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert(1)" in text


def test_the_budget_stands_on_the_page_and_adds_up():
    text = certificate_page(certificate(), example())
    table = text[text.index("Budget: share of the variance") :]
    assert re.search(r"together.*?100\.0\s%", table, re.DOTALL)
    assert "Stokes" not in table[: table.index("</table>")]
    assert re.search(r"50\.0\s%", table)


def test_without_a_budget_the_stated_uncertainties_of_band_values_stand_there():
    paint = example()
    stated = BandUncertainty(calibration_rel=0.02, response_rel=0.004, stray_light_rel=0.006)
    paint = paint.model_copy(update={"optics": paint.optics.model_copy(update={"band_uncertainty": stated})})
    details = CertificateDetails()
    bare = paint_certificate(paint, certified_results(paint, details, MEASURED_ON), details, "0" * 64, MEASURED_ON)
    told = dict(bare.statements)["Uncertainty"]
    assert "was not requested" in told
    sources = r"2.*% for the calibration of each filter, 0\.4.*% for each channel's response, .* stray light 0\.6.*%"
    assert re.search(sources, told)
    assert "for the calibration of each filter" not in dict(certificate(paint).statements)["Uncertainty"]


def test_scatter_of_combined_sessions_stands_on_the_certificate():
    alone = example().model_copy(update={"between_sessions": None})
    off = alone.energy_yield.model_copy(update={"estimate": 0.0213, "low95": 0.003, "high95": 0.083})
    scatter = SessionScatter(level_rel=off, filter_rel=off, session_levels_rel=(0.01, -0.01, 0.0))
    paint = alone.model_copy(update={"between_sessions": scatter})
    assert "sessions were combined" not in certificate_page(certificate(alone), alone)
    told = certificate_page(certificate(paint), paint)
    assert re.search(r"3 sessions were combined\. .*2\.1\s%\s\[0\.3\s%,\s8\.3\s%\], and each filter", told)


def test_pdf_is_one_sheet_and_repeats():
    made = certificate(customer="$x_", laboratory="L" * 300, item="words " * 50, conditions="22 degC")
    pdf = certificate_pdf(made, example())
    assert pdf == certificate_pdf(made, example())
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 1


@pytest.mark.parametrize("number", ["No. 12", "A. B. 7", "$\\frac{1}$", "5$ to 6$"])
def test_the_foot_of_a_sheet_names_the_certificate_as_the_laboratory_numbers_it(number, monkeypatch):
    written, write = [], Figure.text

    def noted(figure, x, y, s, **options):
        written.append((s, options.get("parse_math", True)))
        return write(figure, x, y, s, **options)

    monkeypatch.setattr(Figure, "text", noted)
    certificate_pdf(certificate(number=number), example())
    foot = f"Certificate {number}, page 1 of 1. Not to be reproduced except in full. End of certificate."
    assert (foot, False) in written


def test_a_pdf_with_many_warnings_takes_more_sheets():
    warned = example().model_copy(update={"warnings": tuple(f"warning {i} " + "word " * 40 for i in range(60))})
    given = CertificateDetails()
    made = paint_certificate(warned, certified_results(warned, given, None), given, "0" * 64, MEASURED_ON)
    assert len(re.findall(rb"/Type\s*/Page\b", certificate_pdf(made, warned))) > 1


def test_numbers_of_the_page_stand_in_it_as_json():
    text = certificate_page(certificate(), example())
    summary = json.loads(re.search(r'id="summary">(.*?)</script>', text, re.DOTALL)[1])
    assert summary["results"][0][1] in text
    assert summary["traceability"].startswith("not traceable")


def test_equivalence_command(tmp_path, capsys):
    path = tmp_path / "red.paint.json"
    write_record(example(), path, provenance("finray fit x", {}, 1))
    write_record(example(), tmp_path / "again.paint.json", provenance("finray fit y", {}, 2))
    words = ["check", "equivalence", "--first", str(path), "--second", str(tmp_path / "again.paint.json")]
    assert main([*words, "--margin", "reflectance_at_laser=0.9"]) == 0
    assert "PASS" in capsys.readouterr().out
    assert main([*words, "--margin", "mode_nm=1", "--margin", "mode_nm=2"]) == 2
    assert "a quantity is given twice" in capsys.readouterr().err
    moved = example().parameters["reflectance_at_laser"]
    numbers = {name: getattr(moved, name) + (0.0 if name == "sd" else 0.5) for name in type(moved).model_fields}
    other = {**example().parameters, "reflectance_at_laser": type(moved)(**numbers)}
    write_record(example().model_copy(update={"parameters": other}), tmp_path / "b.json", provenance("x", {}, 1))
    words[-1] = str(tmp_path / "b.json")
    assert main([*words, "--margin", "reflectance_at_laser=0.1"]) == 1
    assert "FAIL" in capsys.readouterr().out


@pytest.mark.parametrize("margin", ["mode=1", "mode_nm", "mode_nm=0", "mode_nm=x", "mode_nm=inf"])
def test_a_margin_that_is_none(margin, capsys):
    assert main(["check", "equivalence", "--first", "a", "--second", "b", "--margin", margin]) == 2
    assert "must be QUANTITY=VALUE" in capsys.readouterr().err
