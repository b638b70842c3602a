"""Whether a sample emits: blanks, weak emitters and what becomes of a sample without emission.

The samples are those of the simulated bench (benchmarks/emission_detection.py), which shares no code with the fit.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.emission_detection import (
    REFLECTANCES,
    WAVELENGTH_NM,
    Rig,
    bell,
    blanks,
    detect,
    dyes,
    limits_hold,
    weak,
)
from data_schemas import BandUncertainty, PaintCalibration, PaintWithoutEmission, RecordError, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.cli.main import main
from finray_calib.fit import EmissionPrior, FitOptions, band_data, calibrate_paint, detect_emission
from finray_calib.fit._detection import BLANKS, FALSE_ALARM, MISSED, _seen_from_sd, blank_model, draw_blanks
from finray_calib.reports import no_emission_page

NOTHING = np.zeros(WAVELENGTH_NM.size)


@pytest.fixture(scope="module")
def rig():
    return Rig(1, 5.0)


@pytest.fixture(scope="module")
def plastic(rig):
    return rig.signals("white plastic", REFLECTANCES["white plastic"], NOTHING, np.random.default_rng(1))


@pytest.fixture(scope="module")
def blank(plastic):
    return calibrate_paint(plastic, 1)


def test_blanks_are_no_paints():
    """60 blanks of six reflectances on 60 rigs; more than 4 at 1 % each has a probability of 3e-4."""
    found = blanks(60, np.random.default_rng(2), ["assumed"])
    assert sum(map(sum, found.values())) <= 4


def test_weak_emitters_are_found():
    """Of 40 emitters of 2 % at a detection probability of 0.99 more than 3 are missed with a probability of 6e-4."""
    assert sum(weak(0.02, 40, np.random.default_rng(3), ["assumed"])) >= 37


def test_the_limit_that_a_blank_states_is_one_that_would_be_seen():
    """Binomial(30, 0.95): below 25 with probability 3e-3; the limit is that of the shape that is hardest to see."""
    hits = limits_hold(30, np.random.default_rng(4), ["assumed"])
    assert sum(hits) >= len(hits) - 5


def test_two_peaks_and_narrow_lines_are_emission(rig):
    rng = np.random.default_rng(5)
    for curve in (0.5 * bell(510, 25) + 0.5 * bell(640, 30), bell(532, 8), bell(580, 120), bell(600, 200)):
        assert detect(rig.signals("odd", REFLECTANCES["paper"], 0.02 * curve, rng), 1).measured


@pytest.mark.shared_data
def test_dyes_are_found_where_the_laser_excites_them_and_only_there(rig, shared_data):
    rng = np.random.default_rng(6)
    seen = dark = 0
    for i, (name, at_laser, curve) in enumerate(dyes(shared_data / "spectra" / "dyes.csv")[::3]):
        above = np.where(WAVELENGTH_NM > 460, curve, 0.0)
        if not 490 <= WAVELENGTH_NM[above.argmax()] <= 680 or 0.001 <= at_laser < 0.07:
            continue
        emission = 0.3 * (at_laser if at_laser >= 0.07 else 0.0) * above / (above.sum() * 0.5)
        found = detect(rig.signals(name, REFLECTANCES["paper"], emission, rng), i).measured
        assert found == (at_laser >= 0.07), name
        seen, dark = seen + found, dark + (not found)
    assert seen >= 5
    assert dark >= 1


def test_blanks_have_the_moments_of_the_model(rig, plastic):
    """Log-normal leaks in closed form against their draws: 5 standard errors of 40,000."""
    data = band_data(plastic)
    model = blank_model(plastic, data, 0.5)
    drawn = draw_blanks(data, model, 0.5, 40_000, np.random.default_rng(7))
    error = drawn.std(axis=0) / 200
    assert (np.abs(drawn.mean(axis=0) - model.mean) < 5 * error + 0.005 * model.mean).all()
    # the leak of white, up to 6 % here, is taken to first order; heavy tails leave 5 % beside that
    first_order = 0.05 + 2 * data.weights.leaked_white[model.rows]
    assert (np.abs(drawn.std(axis=0) / np.sqrt(np.diag(model.covariance)) - 1) < first_order).all()


def test_the_threshold_is_that_of_the_blanks_and_not_of_the_normal_table(plastic):
    found = detect_emission(plastic, band_data(plastic), EmissionPrior(), 1)
    assert (found.blanks, found.false_alarm) == (BLANKS, FALSE_ALARM)
    assert 2.5 < found.threshold_sd < 6.0
    assert found.verdict == "no emission"
    assert 0.0005 < found.yield_limit < 0.01
    assert (found.limit_low_nm, found.limit_high_nm) == (490.0, 680.0)
    again = detect_emission(plastic, band_data(plastic), EmissionPrior(), 1)
    assert again == found


def of_a_tile(signals, uncertainty_rel):
    """Return the signals as radiometry writes them with a white reference that is known so well."""
    y, white = signals.fluorescence.ravel(), signals.optics.white_reference
    tile = white.model_copy(update={"uncertainty_rel": uncertainty_rel})
    return signals.model_copy(
        update={
            "optics": signals.optics.model_copy(update={"white_reference": tile}),
            "fluorescence_covariance": signals.fluorescence_covariance + uncertainty_rel**2 * np.outer(y, y),
        }
    )


@pytest.mark.parametrize("uncertainty_rel", [0.005, 0.1, 0.5])
@pytest.mark.parametrize("reflecting", ["black", "white plastic"])
def test_a_white_reference_known_badly_hides_no_emission(rig, reflecting, uncertainty_rel):
    """It multiplies the signal. Before, 10 % of it stood beside the blanks, and a yield of 0.1 was "no emission"."""
    rng = np.random.default_rng(11)
    bands = rig.signals("orange", REFLECTANCES[reflecting], 0.1 * bell(600, 50), rng)
    known = detect(bands, 1).statistic_sd
    found = detect(of_a_tile(bands, uncertainty_rel), 1)
    assert found.measured
    assert found.statistic_sd == pytest.approx(known, rel=0.05)


def test_a_white_reference_known_badly_makes_the_limit_larger_and_no_alarm(rig, plastic):
    limits = [detect(of_a_tile(plastic, u), 1) for u in (0.005, 0.2, 0.7)]
    assert not any(found.measured for found in limits)
    assert limits[0].yield_limit < limits[1].yield_limit < 3 * limits[0].yield_limit
    assert limits[2].yield_limit == 1.0


def test_the_yield_that_is_seen_through_a_wrong_white_reference():
    """By drawing: scatter and tile are normal; 4 standard errors of 400,000 draws of 5 % are 0.0014."""
    rng, threshold, tile_rel = np.random.default_rng(12), 3.2, 0.1
    scatter, tile = rng.standard_normal((2, 400_000))
    for reach in (1.645, 2.5):
        seen = _seen_from_sd(threshold, np.array([reach]), tile_rel)[0]
        missed = (seen * (1 + tile_rel * tile) + reach / 1.644854 * scatter < threshold).mean()
        assert missed == pytest.approx(MISSED, abs=0.0014)
    assert _seen_from_sd(threshold, np.array([2.0]), 0.0)[0] == pytest.approx(5.2)


def test_stated_stray_light_makes_the_limit_larger(plastic):
    """Ten times the usual one raises it, a tenth of it does not lower it: the laser's tail is another light."""

    def stated(stray_light_rel):
        optics = plastic.optics.model_copy(
            update={"band_uncertainty": BandUncertainty(stray_light_rel=stray_light_rel)}
        )
        bands = plastic.model_copy(update={"optics": optics})
        return blank_model(bands, band_data(plastic), 0.0)

    usual, more, less = (stated(rel) for rel in (0.003, 0.03, 0.0003))
    assert more.stray_per_nm == pytest.approx(10.0 * usual.stray_per_nm)
    assert less.stray_per_nm == usual.stray_per_nm
    extra, rows = more.covariance - usual.covariance, np.arange(usual.rows.size)
    assert (extra[rows, rows] > 0.0).all()
    assert np.linalg.eigvalsh(extra).min() > -1e-12 * np.linalg.eigvalsh(extra).max()
    many = [draw_blanks(band_data(plastic), one, 0.0, 4000, np.random.default_rng(3)) for one in (usual, more)]
    grown = many[1].var(axis=0) - many[0].var(axis=0)
    # where stray light is more than half of what varies; a variance of 4000 draws is good to 2 %
    ruled = np.diag(extra) > 0.5 * np.diag(more.covariance)
    assert ruled.sum() > 3
    assert grown[ruled] == pytest.approx(np.diag(extra)[ruled], rel=0.1)


def test_a_lost_laser_filter_makes_the_limit_larger(plastic):
    flags = list(plastic.flags)
    flags[1] = ("saturated",) * 3
    lost = detect(plastic.model_copy(update={"flags": tuple(flags)}), 1)
    assert not lost.measured
    assert lost.yield_limit >= 0.9 * detect(plastic, 1).yield_limit


def test_the_bare_signal_of_a_blank_is_far_above_its_noise(plastic):
    """What the fit went by before: reflected laser light alone makes every filter significant."""
    emission = plastic.usable() & ~plastic.at_excitation()[:, None]
    sd = np.sqrt(np.diag(plastic.fluorescence_covariance)).reshape(-1, 3)
    assert (plastic.fluorescence[emission] / sd[emission]).max() > 20


def test_without_emission_there_is_no_spectrum(blank, plastic):
    assert isinstance(blank, PaintWithoutEmission)
    assert blank.detection.statement.startswith("no emission: the yield is below 0.00")
    assert not {"mode_nm", "fwhm_nm", "emission_per_nm", "draws", "parameters"} & blank.model_dump().keys()
    assert blank.reflectance_at_laser == pytest.approx(0.9, rel=0.02)
    assert [r.estimate for r in blank.reflectance] == pytest.approx([0.9] * 8, abs=0.03)
    used = blank.usable & (blank.blank_sd > 0)
    assert (np.abs(blank.measured - blank.blank)[used] < 4 * blank.blank_sd[used]).all()


def test_a_paint_says_that_it_was_measured(rig):
    bands = rig.signals("orange", REFLECTANCES["black"], 0.2 * bell(600, 50), np.random.default_rng(8))
    few = replace(FitOptions().settings, importance_draws=4000, kept_draws=1000)
    paint = calibrate_paint(bands, 1, FitOptions(settings=few, family="log_normal_wavenumber"))
    assert isinstance(paint, PaintCalibration)
    assert paint.detection.measured
    assert paint.detection.yield_limit is None
    assert paint.detection.statement.startswith(
        "emission measured: the signal exceeds reflected laser, leak and stray light"
    )


def test_a_sample_in_the_dark_has_no_emission(plastic):
    dark = plastic.model_copy(
        update={"fluorescence": np.zeros((8, 3)), "fluorescence_covariance": np.diag(np.full(24, 1e-10))}
    )
    assert isinstance(calibrate_paint(dark, 1), PaintWithoutEmission)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, plastic):
    folder = tmp_path_factory.mktemp("blank")
    write_record(plastic, folder / "bands.json", provenance("finray radiometry"))
    assert main(["design", "init", "flat-70x35", "--out", str(folder / "finger.toml")]) == 0
    return folder


@pytest.fixture(scope="module")
def stored(folder):
    out, page = folder / "plastic.paint.json", folder / "plastic.html"
    assert main(["fit", str(folder / "bands.json"), "--out", str(out), "--report", str(page)]) == 0
    return out


class TestVerb:
    def test_record_terminal_and_page_hold_the_limit_and_no_spectrum(self, stored, folder, capsys):
        assert main(["fit", str(folder / "bands.json"), "--out", str(folder / "again.json")]) == 0
        said = capsys.readouterr().out
        page = (folder / "plastic.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
        assert "NO EMISSION found in 'white plastic'" in said
        for text in (said, page):
            assert re.search(r"yield is below 0\.00\d+ with 95 % probability \(modes from 490 to 680 nm\)", text)
            assert "FWHM" not in text
            assert "Emits most at" not in text
        assert read_record(stored, PaintWithoutEmission).detection.verdict == "no emission"

    @pytest.mark.parametrize(
        "command",
        [
            "export {0} --format csv --out {0}.csv",
            "simulate render {2}/finger.toml --paint red={0} --paint green={0} --images --out {0}.out.json",
            "export {0} --format mitsuba --out {0}.spd",
        ],
    )
    def test_what_needs_a_spectrum_refuses_it(self, stored, command, capsys):
        assert main(command.format(stored, stored, stored.parent).split()) == 2
        assert "found no emission in this sample" in capsys.readouterr().err

    def test_reading_it_as_a_paint_says_why_not(self, stored):
        with pytest.raises(
            RecordError, match=r"contains a paint without emission, but a paint calibration is needed; .*no emission"
        ):
            read_record(stored, PaintCalibration)


def test_a_hostile_name_stays_text(blank):
    hostile = blank.model_copy(update={"paint_name": "<script>alert(1)</script>"})
    page = no_emission_page(hostile, "finray fit", {"bands.json": "0" * 64})
    assert "<script>alert(1)" not in page
    assert no_emission_page(hostile, "finray fit", {"bands.json": "0" * 64}) == page
    assert Path(__file__).name not in page


@pytest.mark.parametrize(("stated_rel", "allowed"), [(0.003, "0.03"), (0.01, "0.1"), (0.2, "2")])
def test_the_page_tells_the_allowance_for_stray_light_that_the_decision_made(blank, stated_rel, allowed):
    """0.03 % of the laser for the usual 0.3 % of other light; it grows with what the rig file states, to no less."""
    stated = blank.optics.band_uncertainty.model_copy(update={"stray_light_rel": stated_rel})
    dusty = blank.model_copy(update={"optics": blank.optics.model_copy(update={"band_uncertainty": stated})})
    page = no_emission_page(dusty, "finray fit", {"bands.json": "0" * 64}).replace("\u00a0", " ")
    assert f"an allowance for stray light of {allowed} % of the laser" in page


def test_a_small_limit_is_not_said_to_be_below_below(blank):
    small = blank.model_copy(update={"detection": blank.detection.model_copy(update={"yield_limit": 2.6e-4})})
    page = no_emission_page(small, "finray fit", {"bands.json": "0" * 64}).replace("\u00a0", " ")
    assert "below 0.1 %" in page
    assert "below below" not in page
