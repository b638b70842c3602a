"""``finray import signals``: band signals that somebody else measured, typed into a table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import BandSignals, CurveError, ImportFormatError, PaintCalibration, RecordError
from data_schemas.storage import read_record
from finray_calib.exchange import SignalOptions, import_band_folder, import_signal_table, signal_template
from finray_calib.spectra import WAVELENGTH_NM, rig_emission_weights
from tests.command_line.running import finray, succeed
from tests.exchange.band_folders import write_folder
from tests.exchange.signal_tables import CENTERS_NM, NM, READINGS, Truth, measured, readings, table

GREEN = (0.0, 1.0, 0.0)
OF_FILTERS = {"center_nm": np.array(CENTERS_NM), "fwhm_nm": np.full(len(CENTERS_NM), 10.0)}
BLUE_LASER = SignalOptions(laser_nm=450.0)


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.toml"
    succeed(f"rig init --preset simulated --out {path}")
    return path


def imported(tmp_path, columns, rig=None, options=None, **how):
    path = tmp_path / "red.csv"
    path.write_text(table(columns, **how), encoding="utf-8")
    return import_signal_table(path, rig, options)[0]


def exact(values=None, sd_rel=0.005):
    """Return readings without noise, with their uncertainties."""
    values = readings() if values is None else values
    return {f"{n}{end}": v * (sd_rel if end else 1) for n, v in values.items() for end in ("", "_sd")}


def without(columns, *names):
    return {name: values for name, values in columns.items() if name.removesuffix("_sd") not in names}


def assert_same(one, other, rtol=1e-12):
    """Assert that two records hold the same, but for rounding and what they say of their file."""
    for name in ("fluorescence", "fluorescence_covariance", "reflectance", "reflectance_covariance", "channel_weights"):
        first, second = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(second, first, rtol=rtol, atol=rtol * np.abs(first).max())
    assert (one.flags, one.optics, one.paint_name) == (other.flags, other.optics, other.paint_name)


def test_the_signals_are_those_of_integrals_that_share_no_code(tmp_path, rig):
    """The detector's slope within a filter, which the import takes for flat, makes 0.1 % of a band; the grids the rest.

    500 and 532 nm are left out: their signals are leaks, a thousand times below those of their neighbours.
    """
    truth = Truth()
    bands = imported(tmp_path, exact(readings(truth)), rig)
    weights = rig_emission_weights(bands.optics, GREEN)
    emission = np.interp(WAVELENGTH_NM, NM, truth.emission_per_nm)
    expected = (weights.emission @ emission + truth.reflected * weights.reflected_laser).reshape(-1, 3)[:, 1]
    bright = ~np.isin(CENTERS_NM, (500.0, 532.0))
    np.testing.assert_allclose(bands.fluorescence[bright, 1], expected[bright], rtol=0.01)
    assert bands.optics.excitation_filter == "450"
    assert bands.flags == (("weak", "ok", "weak"),) * len(CENTERS_NM)
    values = readings(truth)
    np.testing.assert_allclose(bands.reflectance[:, 1], 0.98 * values["paint_lamp"] / values["white_lamp"], rtol=1e-12)


def test_stated_uncertainties_are_those_of_many_noisy_tables(tmp_path, rig):
    """400 tables: a standard deviation is known to 3.5 %, here to four of these; correlations to 0.05, to four."""
    values = without(exact(sd_rel=0.02), "paint_lamp")
    stated = imported(tmp_path, values, rig, SignalOptions(white_uncertainty_rel=0.0)).fluorescence_covariance
    drawn = [
        imported(tmp_path, without(measured(readings(), sd_rel=0.02, seed=seed), "paint_lamp"), rig).fluorescence[:, 1]
        for seed in range(400)
    ]
    inside = np.ix_(*[3 * np.array([0, 3, 4, 5]) + 1] * 2)
    found, expected = np.cov(np.array(drawn)[:, [0, 3, 4, 5]].T), stated[inside]
    np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(expected)), rtol=0.14)
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(sd, sd), expected / np.outer(sd, sd), atol=0.3)


def test_a_fit_of_the_table_holds_the_truth(tmp_path, rig):
    truth = Truth()
    (tmp_path / "red.csv").write_text(table(measured(readings(truth), seed=2)))
    said = succeed(f"import signals {tmp_path}/red.csv --rig {rig} --out {tmp_path}/b.json")
    assert "7 filters, 7 usable values; filter 450 passes the laser" in said
    succeed(f"fit {tmp_path}/b.json --out {tmp_path}/p.json")
    paint = read_record(tmp_path / "p.json", PaintCalibration)
    assert paint.parameters["mode_nm"].low95 < truth.mode_nm < paint.parameters["mode_nm"].high95
    assert paint.parameters["fwhm_nm"].low95 < truth.fwhm_nm < paint.parameters["fwhm_nm"].high95
    assert paint.energy_yield.low95 < truth.energy_yield < paint.energy_yield.high95
    assert paint.reflectance[0].low95 < truth.reflected < paint.reflectance[0].high95
    assert f"{tmp_path}/red.csv" in read_record(tmp_path / "b.json", BandSignals).provenance.input_sha256


@pytest.mark.parametrize(
    ("factors", "how"),
    [
        ({}, {"mark": "\t"}),
        ({}, {"mark": ";", "point": ","}),
        ({}, {"mark": "\t", "point": ","}),
        (dict.fromkeys(READINGS, 1e-9), {}),
        ({"paint_laser": 1e3, "white_laser": 1e3}, {}),
        ({"paint_lamp": 7.0, "white_lamp": 7.0}, {}),
    ],
)
def test_marks_and_units_change_nothing(tmp_path, rig, factors, how):
    values = exact()
    scaled = {name: factors.get(name.removesuffix("_sd"), 1.0) * column for name, column in values.items()}
    assert_same(imported(tmp_path, values, rig), imported(tmp_path, scaled, rig, **how))


def test_rows_and_columns_in_any_order_with_comments_and_a_byte_order_mark(tmp_path, rig):
    values = exact()
    order = np.random.default_rng(1).permutation(len(CENTERS_NM))
    names = [f"{CENTERS_NM[k]:g}" for k in order]
    text = table({name: values[name][order] for name in reversed(values)}, names)
    plain = imported(tmp_path, values, rig)
    (tmp_path / "red.csv").write_text("\ufeff# photodiode, box 3; dark\n\n" + text.replace("filter", "Filter"))
    assert_same(plain, import_signal_table(tmp_path / "red.csv", rig)[0])


def test_a_dark_is_subtracted_and_its_error_is_common_to_a_row(tmp_path, rig):
    values = exact()
    dark = 0.05 * np.nanmedian(values["white_lamp"])
    on_dark = {n: v + (0 if n.endswith("_sd") else dark) for n, v in values.items()}
    ones = np.ones(len(CENTERS_NM))
    exactly = imported(tmp_path, {**on_dark, "dark": dark * ones, "dark_sd": 0 * ones}, rig)
    assert_same(imported(tmp_path, values, rig), exactly, rtol=1e-9)
    sd = 1e-3 * values["white_lamp"]
    uncertain = imported(tmp_path, {**on_dark, "dark": dark * ones, "dark_sd": sd}, rig)
    more = uncertain.reflectance_covariance[13, 13] - exactly.reflectance_covariance[13, 13]
    # d rho / d dark = (rho - R) / W, because paint and white lose the same
    np.testing.assert_allclose(more, (1e-3 * (exactly.reflectance[4, 1] - 0.98)) ** 2, rtol=1e-6)


def test_filters_may_be_described_by_the_table(tmp_path, rig):
    of_rig = imported(tmp_path, exact(), rig)
    told = {"blocking_od": np.full(7, 5.0), "center_uncertainty_nm": np.full(7, 0.15)}
    described = imported(tmp_path, {**OF_FILTERS, **told, **exact()}, None, BLUE_LASER)
    np.testing.assert_allclose(described.fluorescence, of_rig.fluorescence, rtol=1e-12)
    assert [band.center_nm for band in described.optics.filters] == list(CENTERS_NM)
    assert described.optics.filters[3].center_uncertainty_nm == 0.15
    assert described.optics.filters[3].fwhm_uncertainty_nm == 0.6  # of a catalogue


def test_widths_without_centres_are_refused_instead_of_left_out(tmp_path, rig):
    for name, value in (("fwhm_nm", 50.0), ("blocking_od", 2.0)):
        with pytest.raises(ImportFormatError, match=f"has the column '{name}', but neither 'center_nm' nor 'curve'"):
            imported(tmp_path, {name: np.full(7, value), **exact()}, rig)


def test_empty_columns_of_a_spreadsheet_are_left_out(tmp_path, rig):
    plain = imported(tmp_path, exact(), rig)
    text = (tmp_path / "red.csv").read_text().replace("\n", ",,\n")
    (tmp_path / "red.csv").write_text(text)
    assert_same(plain, import_signal_table(tmp_path / "red.csv", rig)[0])
    (tmp_path / "red.csv").write_text(text[:-2] + "7\n")
    with pytest.raises(ImportFormatError, match=r"line 8: has a value in a column without a name; name or remove"):
        import_signal_table(tmp_path / "red.csv", rig)


def test_a_measured_curve_lies_beside_the_table(tmp_path):
    rows = "".join(f"{x},{0.8 * 2.0 ** (-((2 * (x - 601) / 9.0) ** 4)):.6f}\n" for x in np.arange(585.0, 618.0, 0.5))
    (tmp_path / "fb600.csv").write_text("wavelength_nm,transmission\n" + rows)
    curve = ["fb600.csv" if nm == 600 else "" for nm in CENTERS_NM]
    centers = np.where(np.array(CENTERS_NM) == 600, np.nan, CENTERS_NM)
    widths = np.where(np.array(CENTERS_NM) == 600, np.nan, 10.0)
    columns = {"curve": curve, "center_nm": centers, "fwhm_nm": widths, **exact()}
    bands = imported(tmp_path, columns, None, BLUE_LASER)
    assert bands.optics.filters[4].center_nm == pytest.approx(601.0, abs=0.05)
    assert bands.optics.filter_curves["600"].source == "fb600.csv"
    with pytest.raises(CurveError, match="points outside the folder"):
        imported(tmp_path, {**columns, "curve": [c and "../fb600.csv" for c in curve]}, None, BLUE_LASER)


def test_without_paint_under_the_lamp_the_reflectance_is_anything(tmp_path, rig):
    bands = imported(tmp_path, without(exact(), "paint_lamp"), rig)
    np.testing.assert_allclose(np.diag(bands.reflectance_covariance)[1::3], 1 / 12)
    assert np.all(bands.reflectance[:, 1] == 0.5)
    assert any("its reflectance is not known, and counts as anything from 0 to 1" in note for note in bands.notes)
    np.testing.assert_allclose(bands.fluorescence, imported(tmp_path, exact(), rig).fluorescence)


def test_without_white_under_the_laser_a_yield_must_be_assumed_and_the_name_says_so(tmp_path, rig):
    values = without(exact(), "white_laser")
    with pytest.raises(ImportFormatError, match=r"'450': .* 'white_laser', .* the yield .* give --assume-yield Y"):
        imported(tmp_path, values, rig)
    bands = imported(tmp_path, values, rig, SignalOptions(paint_name="red", assumed_yield=0.1))
    assert bands.paint_name == "red, yield assumed"
    assert "follow from an assumed yield of about 0.1" in bands.notes[-1]
    whole = imported(tmp_path, exact(), rig).fluorescence[:, 1]
    ratio = bands.fluorescence[:, 1] / whole
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    # joined between filters 30 nm apart, the area of a curve 48 nm wide is right to a tenth
    assert ratio[0] == pytest.approx(0.1 / Truth().energy_yield, rel=0.1)
    (tmp_path / "red.csv").write_text(table(values))
    with pytest.raises(ImportFormatError, match=r"--assume-yield has no effect, because .* has 'white_laser'"):
        imported(tmp_path, exact(), rig, SignalOptions(assumed_yield=0.1))
    outcome = finray(f"import signals {tmp_path}/red.csv --rig {rig} --assume-yield 20")
    assert outcome.status == 2
    assert "'20' must be a yield above 0 and at most 1" in outcome.err
    dim = {name: column[:2] for name, column in values.items()}
    lightless = {**values, "paint_laser": -values["paint_laser"], "paint_laser_sd": values["paint_laser"]}
    for columns, names in ((dim, ["450", "500"]), (lightless, None)):
        with pytest.raises(ImportFormatError, match=r"the emission has no area, .* of two or more filters"):
            imported(tmp_path, columns, rig, SignalOptions(assumed_yield=0.1), names=names)


def test_a_calibrated_spectrometer_needs_no_lamp(tmp_path):
    """Readings of a flat detector through filters of peak 1 are integrals of spectral radiance."""
    values = readings(response=np.full(NM.shape, 2.0))
    with_lamp = imported(tmp_path, {**OF_FILTERS, **exact(values)}, None, BLUE_LASER)
    alone = {**OF_FILTERS, **without(exact(values), "white_lamp", "paint_lamp")}
    bands = imported(tmp_path, alone, None, SignalOptions(laser_nm=450.0, calibrated=True))
    # leaks, which integrals have none of, make most of 500 and 532 nm
    bright = ~np.isin(CENTERS_NM, (500.0, 532.0))
    np.testing.assert_allclose(bands.fluorescence[bright], with_lamp.fluorescence[bright], rtol=0.01)
    assert bands.optics.lamp_temperature_uncertainty_k == 0
    assert bands.optics.filters[0].peak_transmission == 1
    with pytest.raises(ImportFormatError, match=r"has no reading in the column 'white_lamp' .* give --calibrated"):
        imported(tmp_path, alone, None, BLUE_LASER)
    lit = {**OF_FILTERS, **without(exact(values), "white_lamp")}
    calibrated = SignalOptions(laser_nm=450.0, calibrated=True)
    with pytest.raises(ImportFormatError, match="'paint_lamp', but none of the white reference under the lamp"):
        imported(tmp_path, lit, None, calibrated)
    # radiance holds no response, which white from the curves would
    with pytest.raises(ImportFormatError, match=r"^--response is given with --calibrated, but .*; leave one of"):
        imported(tmp_path, alone, None, replace(calibrated, response=tmp_path / "response.csv"))
    colours = {"channel": ["red"] * len(CENTERS_NM), **alone}
    with pytest.raises(ImportFormatError, match="has the column 'channel', but a calibrated spectrometer has one"):
        imported(tmp_path, colours, None, calibrated)


def test_what_cannot_be_used_is_said(tmp_path, rig):
    values = exact()
    values["paint_laser"][6] = values["paint_laser_sd"][6] = np.nan
    values["white_lamp_sd"][2] = 0.2 * values["white_lamp"][2]
    bands = imported(tmp_path, values, rig)
    assert [flags[1] for flags in bands.flags] == ["ok", "ok", "weak", "ok", "ok", "ok", "weak"]
    assert "filter 532 is not used, because its white under the lamp is not above 10 standard" in str(bands.notes)
    assert "filter 660 is not used, because it has no reading of the paint under the laser" in str(bands.notes)
    values["white_lamp"][2] = values["white_lamp_sd"][2] = np.nan
    notes = str(imported(tmp_path, values, rig).notes)
    assert "filter 532 is not used, because it has no reading of the white reference under the lamp" in notes


def test_rows_without_a_dark_beside_rows_with_one_are_named(tmp_path, rig):
    dark = np.array([0.0, 0.0, np.nan, 0.0, np.nan, 0.0, 0.0])
    notes = imported(tmp_path, {**exact(), "dark": dark, "dark_sd": dark}, rig).notes
    assert "no dark reading of filters 532, 600: their readings are taken as they are" in notes
    # a row without readings needs no dark
    values = {name: np.where(np.isnan(dark), np.nan, column) for name, column in exact().items()}
    notes = imported(tmp_path, {**values, "dark": dark, "dark_sd": dark}, rig).notes
    assert not any("no dark reading" in note for note in notes)


def test_a_level_of_the_laser_that_is_hardly_measured_is_refused(tmp_path, rig):
    """The mean of 1/V would be off, and a normal distribution of y no longer hold."""
    imported(tmp_path, exact() | {"white_laser_sd": 0.09 * exact()["white_laser"]}, rig)
    with pytest.raises(
        ImportFormatError, match=r"'450': the level of the laser is known to 50 %, but .* 10 % or better"
    ):
        imported(tmp_path, exact() | {"white_laser_sd": 0.5 * exact()["white_laser"]}, rig)


def test_ratios_that_cannot_be_are_refused(tmp_path, rig):
    ratios = {"fluorescence": np.full(7, 0.05), "fluorescence_sd": np.full(7, 1e-3)}
    imported(tmp_path, ratios, rig)
    with pytest.raises(ImportFormatError, match=r"'450': the paint .* 8 times as bright as white .* at most 1\.2"):
        imported(tmp_path, {**ratios, "fluorescence": np.array([8.0, *[0.05] * 6])}, rig)
    with pytest.raises(ImportFormatError, match=r"red\.csv: the standard uncertainties of single values are too sm"):
        imported(tmp_path, {**ratios, "fluorescence_sd": np.full(7, 1e-12)}, rig)
    white = {name: exact()[name] for name in ("white_lamp", "white_lamp_sd")}
    with pytest.raises(ImportFormatError, match="'white_lamp' beside 'fluorescence', whose values are already"):
        imported(tmp_path, {**ratios, **white}, rig)


def test_more_filters_than_a_record_holds_are_refused_in_words(tmp_path):
    many = {name: np.ones(65) for name in ("paint_laser", "paint_laser_sd", "white_lamp", "white_lamp_sd")}
    many |= {"center_nm": np.linspace(450.0, 770.0, 65), "fwhm_nm": np.full(65, 5.0)}
    with pytest.raises(CurveError, match=r"red\.csv: has 65 filters, but at most 64 are supported; leave out"):
        imported(tmp_path, many, None, BLUE_LASER, names=[f"f{k}" for k in range(65)])


def test_names_keep_their_comma_under_a_header_in_capitals(tmp_path):
    names = [f"{nm:g},5" for nm in CENTERS_NM]
    path = tmp_path / "red.csv"
    path.write_text(table({**OF_FILTERS, **exact()}, names, ";", ",").replace("filter;", "FILTER;"))
    assert [band.name for band in import_signal_table(path, None, BLUE_LASER)[0].optics.filters] == names


def test_a_colour_camera_and_ratios_of_its_own_give_the_same_record(tmp_path):
    """Signals of images, written as a table of ratios: the rows of a record, and the weights of its channels."""
    first, _ = import_band_folder(write_folder(tmp_path / "f", "RGB"))
    n, white = len(first.optics.filters), first.optics.white_reference.uncertainty_rel
    rows = ["filter,channel,center_nm,fwhm_nm,fluorescence,fluorescence_sd,reflectance,reflectance_sd,laser_weight"]
    for b in range(n):
        band = first.optics.filters[b]
        for c, channel in enumerate(("red", "green", "blue")):
            k = 3 * b + c
            numbers = []
            for name in ("fluorescence", "reflectance"):
                value = getattr(first, name)[b, c]
                # without what the white reference adds, which the import adds again
                own = getattr(first, f"{name}_covariance")[k, k] - (white * value) ** 2
                numbers += [repr(float(value)), repr(float(np.sqrt(own)))]
            weight = repr(float(first.channel_weights[c])) if band.name == first.optics.excitation_filter else ""
            cells = [band.name, channel, f"{band.center_nm}", f"{band.fwhm_nm}", *numbers, weight]
            rows.append(",".join(cells))
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    laser = first.optics.laser
    again, _ = import_signal_table(
        tmp_path / "t.csv", None, SignalOptions(laser_nm=laser.wavelength_nm, laser_fwhm_nm=laser.fwhm_nm)
    )
    np.testing.assert_allclose(again.fluorescence, first.fluorescence, rtol=1e-12)
    np.testing.assert_allclose(again.reflectance, first.reflectance, rtol=1e-12)
    np.testing.assert_allclose(again.channel_weights, first.channel_weights, rtol=1e-12)
    for name in ("fluorescence_covariance", "reflectance_covariance"):
        np.testing.assert_allclose(np.diag(getattr(again, name)), np.diag(getattr(first, name)), rtol=1e-9)
    (tmp_path / "t.csv").write_text("\n".join(row.rpartition(",")[0] for row in rows) + "\n")
    with pytest.raises(ImportFormatError, match="laser_weight must be given for red, green and blue, with sum 1"):
        import_signal_table(tmp_path / "t.csv", None, BLUE_LASER)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_template_is_read_once_it_is_filled_in(tmp_path, rig, channels):
    succeed(f"import signals --template --channels {channels} --rig {rig} --out {tmp_path}/t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert sum(not line.startswith("#") for line in lines) == 1 + 8 * channels
    empty = finray(f"import signals {tmp_path}/t.csv --rig {rig} --out {tmp_path}/b.json")
    assert empty.status == 2
    assert "the column 'paint_laser' is empty in all rows; fill in what was measured" in empty.err
    filled = [
        line if line.startswith(("#", "filter")) else line.rstrip(",") + ",1,0.01,20,0.1,0.5,0.01,1,0.01,,"
        for line in lines
    ]
    # as a spreadsheet saves it: comments padded to the width of the table
    (tmp_path / "t.csv").write_text("\n".join(x + ",,,," if x.startswith("#") else x for x in filled))
    said = succeed(f"import signals {tmp_path}/t.csv --rig {rig} --out {tmp_path}/b.json")
    assert f"8 filters, {8 * channels} usable values" in said
    assert "paint_name" not in signal_template()


def test_a_filter_whose_name_looks_like_a_comment_stays_in_the_template(tmp_path, rig):
    rig.write_text(rig.read_text().replace('name = "600"', 'name = "#600"'))
    assert '\n"#600",,' in signal_template(rig)
    values = signal_template(rig).replace('\n"#600",,', '\n"#600",1,0.1')
    (tmp_path / "t.csv").write_text(values)
    with pytest.raises(ImportFormatError, match="has no reading in the column 'white_lamp'"):  # the row is read
        import_signal_table(tmp_path / "t.csv", rig)


def test_the_printed_table_is_read(tmp_path, rig):
    page = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "tables-of-band-signals.md").read_text()
    (tmp_path / "red.csv").write_text("filter,paint" + page.split("```\nfilter,paint")[1].split("```")[0])
    bands, _ = import_signal_table(tmp_path / "red.csv", rig)
    assert bands.usable().sum() == 6
    missing = [name for name in READINGS if f"`{name}`" not in page]
    assert not missing


FIRST = {"filter": "450", "paint_laser": "1", "paint_laser_sd": "0.1", "white_lamp": "2", "white_lamp_sd": "0.1"}


def with_more(name, value, sd):
    more = {**FIRST, name: value, f"{name}_sd": sd}
    return text_of(more, header=tuple(more))


def text_of(*rows, header=tuple(FIRST)):
    return "\n".join([",".join(header), *(",".join(row.get(name, "") for name in header) for row in rows)]) + "\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; give a header row and one row for each filter"),
        ("# notes only\n", "is empty; give a header row and one row for each filter"),
        (text_of(FIRST, header=("paint_laser", "paint_laser_sd")), "the column 'filter' is missing"),
        (text_of(), "has no row below its header; give one row for each filter"),
        (text_of(FIRST, header=("filter", "paint_lasr")), "'paint_lasr' is not supported; did you mean 'paint_laser"),
        (text_of(FIRST, header=("filter", "white_lamp")), r"'paint_laser' \(paint under the laser\) is missing"),
        (text_of(FIRST, header=("filter", "paint_laser")), "column 'paint_laser_sd' is missing; add the"),
        (text_of(FIRST, header=(*FIRST, "fluorescence")), "has both columns 'paint_laser' and 'fluorescence'"),
        (text_of(FIRST, header=(*FIRST, "Filter")), "a column appears twice; remove one"),
        (text_of(FIRST | {"filter": ""}), "line 2: the column 'filter' is empty"),
        (text_of(FIRST, FIRST | {"filter": "650"}), r"line 3, column 'filter': '650' is not a filter of .*"),
        (text_of(FIRST, FIRST), "line 3: filter '450' already stands in line 2; give the mean of repeated readings"),
        (text_of(FIRST | {"paint_laser": "five"}), "line 2, column 'paint_laser': 'five' is not a finite"),
        (text_of(FIRST | {"paint_laser_sd": "-1"}), "line 2, column 'paint_laser_sd': is -1, but must be at least 0"),
        (text_of(FIRST | {"paint_laser_sd": "0"}), "line 2, column 'paint_laser_sd': is 0, but must be above 0"),
        (text_of(FIRST | {"paint_laser": "-1.1"}), "line 2, column 'paint_laser': lies 11 standard uncertainties"),
        (with_more("paint_lamp", "-30", "2"), "line 2, column 'paint_lamp': lies 15 standard uncertainties below 0"),
        (with_more("dark", "7", "0.1"), "line 2, column 'paint_laser': lies 42.4 .* once its dark is subtracted"),
        (text_of(FIRST | {"white_lamp_sd": ""}), "line 2: has a value in the column 'white_lamp', but"),
        (text_of(FIRST | {"white_lamp": "1e300"}), r"only 0 and sizes from 1e-18 to 1e\+18 are"),
        (text_of(FIRST | {"channel": "grey"}, header=(*FIRST, "channel")), "'channel': is 'grey', but must be"),
        (
            with_more("white_laser", "0.5", "0.01"),
            "filter '450': the paint reads 1 under the laser, more than 1.2 times the 0.5 of the white reference",
        ),
        (
            with_more("white_laser", "-1", "0.01"),
            "the white reference under the laser reads -1 without its dark, but must be above 0",
        ),
        (
            with_more("reflectance", "45", "1"),
            r"the reflectance under the lamp is 45, but at most 5 times .* instead of per cent",
        ),
        (text_of(FIRST | {"white_lamp": "0"}), r"filter 450 is not used, because .* and no other filter can be used"),
    ],
)  # fmt: skip
def test_wrong_tables_are_refused_with_the_place_and_the_remedy(tmp_path, rig, text, message):
    path = tmp_path / "paint.csv"
    path.write_text(text)
    with pytest.raises(ImportFormatError, match=message) as caught:
        import_signal_table(path, rig)
    assert str(path) in str(caught.value)


def test_noise_about_zero_is_kept(tmp_path, rig):
    noisy = exact()
    noisy["paint_laser"][1] = -9.0 * noisy["paint_laser_sd"][1]
    assert imported(tmp_path, noisy, rig).fluorescence[1].min() < 0.0


def test_wrong_options_are_refused(tmp_path, rig):
    path = tmp_path / "red.csv"
    path.write_text(table(exact()))
    for words, message in (
        ("--laser-nm 450", "has no column that describes the filters, but no rig file is given; add the columns"),
        (f"--rig {rig} --laser-nm 470", "no filter passes the laser at 470 nm; correct the laser's wavelength"),
        (f"--rig {rig} --laser-fwhm-nm 90", "laser.fwhm_nm is 90 nm, but the excitation must be one line"),
        (f"--rig {rig} --laser-nm 20", "error: --laser-nm (in nm): must be at least"),
        (f"--rig {rig} --lamp candle", "error: --lamp: 'candle' is not supported; give planck-2856K"),
        (f"--rig {rig} --white-reflectance 98", "error: --white-reflectance: must be at most 1, got 98"),
        (f"--rig {rig} --white-uncertainty-rel=-1", "error: --white-uncertainty-rel: must be"),
        (f"--rig {rig} --calibrated", "--calibrated needs the transmission of the integrals"),
        (f"--rig {rig} --channels 3", "--channels works only with --template"),
        (f"--rig {rig} --template", "--template reads no table, but writes an empty one"),
        (f"--rig {tmp_path}/none.toml", "no such file"),
    ):
        outcome = finray(f"import signals {path} {words} --out {tmp_path}/b.json")
        assert outcome.status == 2, words
        assert message in outcome.err, outcome.err
        assert outcome.err.count("\n") == 1, outcome.err
    assert "TABLE is missing; give the table" in finray("import signals").err
    for option in ("--laser-nm 450", "--calibrated", "--paint-name red", "--assume-yield 0.3", f"--response {path}"):
        outcome = finray(f"import signals --template {option} --out {tmp_path}/t.csv")
        assert (outcome.status, (tmp_path / "t.csv").exists()) == (2, False), option
        assert f"{option.split()[0]} has no effect on an empty table; leave it out" in outcome.err
    curve = tmp_path / "response.csv"
    curve.write_text("wavelength_nm,response_percent\n400,50\n700,60\n")
    exchanged = finray(f"import signals {curve} --response {path} --rig {rig} --out {tmp_path}/b.json")
    assert exchanged.status == 2
    assert "response.csv: contains a curve over the wavelength (column 'wavelength_nm'), but a table" in exchanged.err
    path.write_text(table({**OF_FILTERS, **exact()}))
    assert "the wavelength of the laser is not known; give --rig RIG" in finray(f"import signals {path}").err
    wide = {**OF_FILTERS, "fwhm_nm": np.full(7, -1.0), **exact()}
    path.write_text(table(wide))
    with pytest.raises((ImportFormatError, RecordError), match=r"line 2: .*fwhm_nm"):
        import_signal_table(path, None, BLUE_LASER)
