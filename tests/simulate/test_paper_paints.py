"""The paper's statements beside measured stand-ins: numbers read off by other means, verdicts, figure, command."""

import json
import re

import numpy as np
import pytest

from data_schemas import DonaldsonMatrix, PaperPaints, SimulateError, SpectralCurve
from data_schemas.storage import read_donaldson_matrix, read_record
from finray_calib.cli import _study as study
from finray_calib.cli.main import main
from finray_calib.reports import paper_paints_png
from sim.experiments import reproduce_paper_paints
from sim.experiments._paper_paints import LASER_NM, measure_stand_in

RED, GREEN = "hercules_orange_ink", ("textile_yellow", "postit_yellow_3m")


@pytest.fixture(scope="module")
def folder():
    from tests.conftest import SHARED_DATA

    if not (SHARED_DATA / "spectra" / "README.md").is_file():
        pytest.skip(f"MEASURED DATA ABSENT: {SHARED_DATA} not found; tests on real paint were NOT run")
    return SHARED_DATA / "spectra" / "materials"


@pytest.fixture(scope="module")
def paper(folder):
    red, *green = (read_donaldson_matrix(folder / f"{name}.csv") for name in (RED, *GREEN))
    return reproduce_paper_paints([red], green, np.random.default_rng(1))


def by_subject(paper):
    return {statement.subject: statement for statement in paper.statements}


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "location_nm", "scale_nm", "skewness", "mode_nm"),
    [
        (RED, 586.6, 31.3, 3.07, 597.3),
        ("textile_yellow", 512.7, 27.9, -0.08, 512.0),
        ("postit_yellow_3m", 512.2, 25.8, 0.72, 517.7),
    ],
)
def test_paper_curve_on_the_whole_spectrum(paper, name, location_nm, scale_nm, skewness, mode_nm):
    # The reference fits start at 490 nm and average other excitations; ours start at 470 nm, and where the paint
    # emits there (textile) the symmetric reference becomes a skewed curve with the same maximum.
    fit = next(p.paper_curve for p in paper.stand_ins if p.material == name)
    assert fit.mode_nm == pytest.approx(mode_nm, abs=3.0)  # noise of the matrices: some 2.7 nm
    if name != "textile_yellow":
        assert fit.parameters["location_nm"] == pytest.approx(location_nm, abs=3.0)
        assert fit.parameters["scale_nm"] == pytest.approx(scale_nm, rel=0.05)
        assert fit.parameters["skewness"] == pytest.approx(skewness, abs=0.4)


@pytest.mark.shared_data
def test_numbers_read_off_the_files_by_hand(paper, folder):
    # energy yield: sum of the 450 nm column from 470 nm on, in bands of 10 nm; largest band, as the data's README says
    for paint, brightest in zip(paper.stand_ins, (0.058, 0.086, 0.032), strict=True):
        table = np.genfromtxt(folder / f"{paint.material}.csv", delimiter=",", skip_header=4)
        emission, column = table[:, 0], table[:, 1 + (450 - 300) // 10]
        assert paint.energy_yield == pytest.approx(column[emission >= 470].sum(), rel=0.01)  # interpolation, ends
        # averaging over excitations removes 5-15 % of noise, and a 10 nm filter sees the flanks of the peak
        assert max(paint.filter_bands.values()) == pytest.approx(brightest, rel=0.25)
        assert paint.photon_yield > paint.energy_yield
    orange = paper.stand_ins[0]
    assert orange.printed_patch == orange.closest_patch
    assert orange.printed_patch.error_rel == pytest.approx(0.32, abs=0.005)  # two digits are given
    assert [p.closest_patch.name for p in paper.stand_ins[1:]] == ["Yellow", "Yellow"]
    assert [p.closest_patch.error_rel for p in paper.stand_ins[1:]] == pytest.approx([0.14, 0.21], abs=0.005)


@pytest.mark.shared_data
def test_the_printed_shifts_lie_on_the_plateau_but_not_at_its_maximum(paper):
    statements = by_subject(paper)
    assert statements["Stokes shift, red paint"].verdict == "holds in part"
    assert statements["Stokes shift, green paint"].verdict == "holds in part"
    for paint in paper.stand_ins:
        assert paint.stokes_shift_low_nm <= paint.stokes_shift_nm <= paint.stokes_shift_high_nm
        assert 0 < paint.emission_peak_nm - paint.absorption_edge_nm < 20
        assert paint.one_laser.prior_driven


@pytest.mark.shared_data
def test_two_to_five_per_cent_is_a_band_and_not_the_light(paper):
    statements = by_subject(paper)
    assert statements["reradiation, if the percentage is that of one 10 nm band"].verdict == "holds in part"
    share = statements["reradiation, if the percentage is the share of all light"]
    assert share.verdict == "does not hold"
    assert share.ours[RED] == "44 % of the energy, 60 % of the photons"
    assert "4 to 27 times too dark" in share.why
    assert statements["lambda_0 of the curve"].verdict == "does not hold"
    assert statements["dependence on the excitation"].verdict == "holds"


@pytest.mark.shared_data
def test_the_paper_curve_is_too_sure_on_eight_bands_and_ours_is_not(paper):
    seen = by_subject(paper)["emission curve, from eight filter bands"]
    assert seen.verdict == "does not hold"
    theirs, ours = ([getattr(p, name) for p in paper.stand_ins] for name in ("paper_fit", "our_fit"))
    assert all(f.trusted for f in (*theirs, *ours))
    # Other programs measured on four materials: the paper's family alone 22-24 % off, its band holds 22 %; with a
    # discrepancy half of that and 93 %. Three materials and one noise draw scatter by a third of that.
    assert 0.15 < np.mean([f.residual_rel for f in theirs]) < 0.35
    assert np.mean([f.covered_share for f in theirs]) < 0.45
    assert np.mean([f.residual_rel for f in ours]) < 0.6 * np.mean([f.residual_rel for f in theirs])
    assert np.mean([f.covered_share for f in ours]) > 0.85
    for paint in paper.stand_ins:
        words = seen.ours[paint.material]
        assert f"the paper's curve {100 * paint.paper_fit.residual_rel:.0f} % (band holds" in words
        assert paint.paper_fit.parameters["location_nm"].sd > 0
        assert (paint.our_fit.low95_per_nm <= paint.our_fit.mean_per_nm).all()


def skew_cauchy_paint(shift_nm, energy_yield, mode_nm=560.0, step_nm=10.0, name="paper"):
    """Build a matrix that follows the paper to the letter: symmetric Cauchy emission, bell-shaped absorption."""
    emission, excitation = np.arange(380.0, 791.0, step_nm), np.arange(300.0, 791.0, step_nm)
    shape = 1 / (1 + ((emission - mode_nm) / 25) ** 2)
    shape *= energy_yield / (shape[emission >= 470].sum() * step_nm)
    absorbed = np.exp(-0.5 * ((excitation - (mode_nm - shift_nm)) / 40) ** 2) * excitation
    absorbed /= np.interp(LASER_NM, excitation, absorbed)
    stokes = emission[:, None] - excitation >= 15
    return DonaldsonMatrix(
        name=name,
        emission_nm=emission,
        excitation_nm=excitation,
        radiance_factor_per_nm=np.outer(shape, absorbed) * stokes,
        reflectance=SpectralCurve(
            name="r", wavelength_nm=np.array([380.0, 780.0]), values=np.array([0.05, 0.05]), source="test"
        ),
        source="closed form",
    )


def test_a_paint_as_the_paper_says_is_found_to_hold():
    red = skew_cauchy_paint(100.0, 0.035, name="red")
    green = skew_cauchy_paint(50.0, 0.035, mode_nm=540.0, name="green")
    paper = reproduce_paper_paints([red], [green], np.random.default_rng(2))
    statements = by_subject(paper)
    for colour, shift_nm in (("red", 100.0), ("green", 50.0)):
        paint = next(p for p in paper.stand_ins if p.colour == colour)
        assert paint.stokes_shift_nm == shift_nm
        # The bell halves 1.18 sd of 40 nm above its maximum; straight lines between samples lose half a nm.
        assert paint.emission_peak_nm - paint.absorption_edge_nm == pytest.approx(shift_nm - 47.1, abs=1.0)
        assert paint.energy_yield == pytest.approx(0.035, rel=0.01)
        assert statements[f"Stokes shift, {colour} paint"].verdict == "holds"
    assert statements["reradiation, if the percentage is the share of all light"].verdict == "holds"
    assert statements["lambda_0 of the curve"].verdict == "holds"
    assert statements["emission curve, from eight filter bands"].verdict == "holds"
    # The fitter gives back what went in: the mode is known to some half a nm, so that 3 nm are beyond chance.
    for paint, mode_nm in zip(paper.stand_ins, (560.0, 540.0), strict=True):
        assert paint.paper_fit.parameters["mode_nm"].estimate == pytest.approx(mode_nm, abs=3.0)
        assert paint.paper_fit.residual_rel < paint.our_fit.residual_rel  # no log-normal has such tails


def test_what_cannot_stand_for_a_paint_is_refused():
    paint = skew_cauchy_paint(50.0, 0.1)
    rng = np.random.default_rng(1)
    with pytest.raises(SimulateError, match="a measured re-radiation matrix for red or green is missing"):
        reproduce_paper_paints([paint], [], rng)
    with pytest.raises(SimulateError, match="material paper is given twice; give each file once, for one colour"):
        reproduce_paper_paints([paint], [paint], rng)
    short = paint.model_copy(
        update={
            "excitation_nm": paint.excitation_nm[:10],
            "radiance_factor_per_nm": paint.radiance_factor_per_nm[:, :10],
        }
    )
    with pytest.raises(SimulateError, match="covers excitation 300 to 390 nm"):
        measure_stand_in(short, "red", rng)
    dark = paint.model_copy(update={"radiance_factor_per_nm": 0 * paint.radiance_factor_per_nm})
    with pytest.raises(SimulateError, match="emits nothing above 470 nm under light of 450 nm"):
        measure_stand_in(dark, "red", rng)
    line = np.where(paint.emission_nm[:, None] == 560.0, paint.radiance_factor_per_nm, 0.0)
    with pytest.raises(SimulateError, match="the absorption cannot be read from the matrix"):
        measure_stand_in(paint.model_copy(update={"radiance_factor_per_nm": line}), "red", rng)


@pytest.mark.shared_data
def test_figure_is_a_png_that_repeats(paper):
    one = paper.model_copy(update={"stand_ins": paper.stand_ins[:1]})
    first, second = paper_paints_png(one), paper_paints_png(one)
    assert first[:8] == b"\x89PNG\r\n\x1a\n"
    assert first == second


@pytest.mark.shared_data
def test_command_writes_record_and_figure(folder, tmp_path, capsys):
    out = tmp_path / "study"
    arguments = ["--out", str(out), "--seed", "1"]
    arguments += ["--red", str(folder / f"{RED}.csv"), "--green", str(folder / f"{GREEN[1]}.csv")]
    assert main(["study", "paper-paints", *arguments]) == 0
    record = read_record(out / "paper-paints.json", PaperPaints)
    assert [p.material for p in record.stand_ins] == [RED, GREEN[1]]
    assert json.loads((out / "paper-paints.json").read_text())["record"]["provenance"]["seed"] == 1
    assert (out / "paper-paints.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert "DOES NOT HOLD: reradiation, if the percentage is the share of all light" in printed
    assert max(map(len, printed.replace(str(out), "").splitlines())) <= study.WIDTH


COLUMNS = np.arange(300, 801, 10)


def written(path, last_excitation_nm=800, last_emission_nm=800):
    """Write a paint as a CSV file: a bell of emission at 560 nm for every excitation."""
    emission, excitation = np.arange(380, last_emission_nm + 1, 10), COLUMNS[last_excitation_nm >= COLUMNS]
    values = np.where(
        emission[:, None] > excitation + 15, 0.05 * np.exp(-(((emission[:, None] - 560.0) / 30) ** 2)), 0.0
    )
    values[emission[:, None] == excitation] = 0.1
    header = "emission_nm," + ",".join(map(str, excitation))
    np.savetxt(path, np.column_stack([emission, values]), delimiter=",", header=header, comments="", fmt="%.6g")
    return path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--green {paint}", "a measured re-radiation matrix for red or green is missing; .* .--red CSV --green"),
        ("--red {tmp}/no.csv --green {paint}", r"no\.csv: no such file; give the path of a"),
        ("--red {tmp} --green {paint}", "cannot be read|is a folder"),
        ("--red {blue} --green {paint}", r"blue\.csv: covers excitation 300 to 420 nm .* up to the laser at 450 nm"),
        ("--red {cut} --green {paint}", r"cut\.csv: covers .* emission 380 to 700 nm, .* emission from 470 to 780 nm"),
        ("--red {paint} --green {paint}", "material paint is given twice; give each file once, for one colour"),
        ("--red {paint} --green {other} --out {tmp}", "exists already and is not overwritten"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    files = {
        "paint": written(tmp_path / "paint.csv"),
        "other": written(tmp_path / "other.csv"),
        "blue": written(tmp_path / "blue.csv", last_excitation_nm=420),
        "cut": written(tmp_path / "cut.csv", last_emission_nm=700),
    }
    before = sorted(tmp_path.rglob("*"))
    assert main(["study", "paper-paints", *arguments.format(tmp=tmp_path, **files).split()]) == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith("finray study: error: ")
    assert complaint.count("\n") == 1
    assert re.search(message, complaint), complaint
    assert sorted(tmp_path.rglob("*")) == before
