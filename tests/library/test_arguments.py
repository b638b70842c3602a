"""What the functions of the library take: paths from home, progress, numbers with uncertainty, words of Python."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import finray_calib as finray
from data_schemas import (
    BandPassFilter,
    CaptureError,
    DecideError,
    FieldError,
    Quantity,
    RecordError,
    SimulateError,
    percent,
)
from data_schemas.storage import given_path
from finray_calib._arguments import _ARGUMENTS
from tests.command_line.records import sweep
from tests.command_line.running import finray as run_verb
from tests.command_line.running import succeed

ROOMS = Path(finray.__file__).parent
RENDERERS = tuple(
    ROOMS.parent / "sim" / path
    for path in (
        "experiments/_light_angle.py", "experiments/_painted_finger.py", "experiments/_rendered_press.py",
        "experiments/_sensor_fit.py", "experiments/_sensor_layers.py", "optics/_render.py",
        "optics/_shared_gathers.py", "surface_meshes/_finger_shape.py",
    )
)  # fmt: skip
LIBRARY_ROOMS = ("radiometry", "spectra", "fit", "sensing", "force", "compare", "decide")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
NOT_FROM_THE_LIBRARY = {
    "--number": "'finray design filters'",
    "--no-discrepancy": "budgets by source, of 'finray certificate'",
    "--scale": "'finray sense teach'",
    "--contact-depth-mm": "'finray sense teach'",
    "--circles": "'finray sense teach'",
    "--capture": "'finray import render'",
    "--pairs": "'finray compare' with folders",
    "--sensitivities": "named as a command, 'finray simulate press --sensitivities'",
    **dict.fromkeys(("--metadata", "--shutter", "--gain", "--awbgains", "--raw"), "rpicam-still"),
}


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_path_from_home_is_the_same_for_reading_and_writing(home):
    assert finray.write_record(sweep(), "~/sweep.json") == home / "sweep.json"
    assert finray.read_record("~/sweep.json").name == sweep().name
    decision = finray.decide_light_angle("~/sweep.json")
    assert set(decision.provenance.input_sha256) == {f"{home}/sweep.json"}
    assert decision.plot().save("~/decision.svg") == home / "decision.svg"
    succeed("decide ~/sweep.json --out=~/verb.json")
    found = {path.name for path in home.iterdir()}
    assert found >= {"decision.svg", "sweep.json", "verb.json"}
    assert "~" not in found


def test_names_that_only_begin_with_a_tilde_stay(home):
    (home / "~").mkdir()
    assert given_path("~$sweep.json", "path") == Path("~$sweep.json")
    assert given_path(Path("here/~/x"), "path") == Path("here/~/x")


def test_what_is_no_path_is_refused_by_its_argument(home):
    for wrong in (3, None, b"sweep.json", sweep()):
        with pytest.raises(RecordError, match="path: must be the path of a file or folder, got"):
            sweep().plot().save(wrong)
    with pytest.raises(RecordError, match="path: the path is empty; give the name of a file or folder"):
        finray.write_record(sweep(), "")
    assert "path: the path is empty" in run_verb("decide '' --out x.json").err


def test_progress_that_cannot_be_called_is_refused_before_the_work(lab, paint, tmp_path):
    finger, paints = lab / "finger.toml", {"red": paint, "green": paint}
    calls = (
        lambda: finray.capture_session(lab / "plan.toml", lab / "rig.toml", tmp_path / "s", progress=3),
        lambda: finray.press_finger(finger, progress=3),
        lambda: finray.render_press(finger, **paints, progress=3),
        lambda: finray.render_images(finger, **paints, progress=3),
        lambda: finray.sweep_light_angle(finger, [0, 30, 60, 90], **paints, progress=3),
        lambda: finray.fit_sensor(finger, [], progress=3),
    )
    for call in calls:
        with pytest.raises(
            RecordError, match=r"progress=3: must be None or a function of three arguments \(steps done,"
        ):
            call()
    assert not (tmp_path / "s").exists()


def test_a_number_with_its_uncertainty_can_be_formatted_and_taken_alone(paint):
    mode_nm = paint.mode_nm
    assert f"{mode_nm:.1f}" == f"{mode_nm.estimate:.1f} [{mode_nm.low95:.1f}, {mode_nm.high95:.1f}] nm"
    assert f"{mode_nm}" == str(mode_nm)
    assert f"{mode_nm:>40}" == str(mode_nm).rjust(40)
    assert f"{mode_nm:*<44.1f}" == f"{mode_nm:.1f}".ljust(44, "*")
    assert f"{mode_nm:+.3e}".startswith(f"{mode_nm.estimate:+.3e} [+")
    for form in ("d", "x", "08.1f", "=30", "hello"):
        with pytest.raises(ValueError, match="is not a format for a number with its interval; give decimals such as"):
            format(mode_nm, form)
    brightness = paint.propagate(np.max)
    assert float(brightness) == brightness.estimate
    assert f"{brightness:.3f}" == f"{brightness.estimate:.3f} [{brightness.low95:.3f}, {brightness.high95:.3f}]"


def test_a_number_with_a_unit_becomes_no_plain_number_and_arrays_mix_no_units(paint):
    """numpy asks each element for its float, and cannot see that the other has another unit."""
    in_nm = paint.mode_nm
    in_um = Quantity.of(in_nm.model_copy(update={"estimate": in_nm.estimate / 1000.0}), "um")
    for numbers in ([in_nm, in_um], [in_nm, in_nm]):
        with pytest.raises(TypeError, match=r"nm cannot become a plain number, .* unit, nm, .* write \.estimate"):
            np.array(numbers, float)
    assert np.array([q.estimate for q in (in_nm, in_um)]) == pytest.approx(in_nm.estimate * np.array([1.0, 1e-3]))
    assert float(paint.reflectance_at_laser) == paint.reflectance_at_laser.estimate


def test_per_cent_are_of_a_ratio_and_stand_after_a_space(paint):
    ratio = paint.reflectance_at_laser
    shown = [f"{100.0 * number:.1f} %" for number in (ratio.estimate, ratio.low95, ratio.high95)]
    assert f"{ratio:.1%}" == f"{shown[0]} [{shown[1]}, {shown[2]}]"
    with pytest.raises(ValueError, match=r"'\.0%' formats a ratio in per cent, but .* is in nm; give decimals"):
        format(paint.mode_nm, ".0%")


def test_a_plot_takes_a_pure_number_and_refuses_one_with_a_unit(paint):
    axes = Figure().subplots()
    (line,) = axes.plot([1.0], [paint.reflectance_at_laser], "o")
    assert line.get_ydata(orig=False) == pytest.approx([paint.reflectance_at_laser.estimate])
    with pytest.raises(TypeError, match=r"nm cannot become a plain number, .* unit, nm, .* write \.estimate"):
        axes.plot([1.0], [paint.mode_nm], "o")


def test_a_number_with_its_uncertainty_is_no_number_of_a_design(paint):
    """Its median would be taken in whatever unit it has."""
    with pytest.raises(FieldError, match=r"'center_nm' \(in nm\): must be a number, got .* with an uncertainty"):
        BandPassFilter(name="600", slot=1, center_nm=paint.mode_nm, fwhm_nm=10.0)
    assert isinstance(paint.mode_nm, Quantity)
    with pytest.raises(FieldError, match=r"'center_nm' \(in nm\): must be a number, got .* with an uncertainty"):
        BandPassFilter(name="600", slot=1, center_nm=paint.propagate(np.max), fwhm_nm=10.0)


def test_a_function_of_two_arguments_is_refused_with_a_remedy(paint):
    with pytest.raises(RecordError, match=r"takes \(a, b\), but is called with one argument, .*; give a"):
        paint.propagate(lambda a, b: a @ b)
    assert paint.propagate(lambda a, b=2.0: b * a.max()).estimate > 0.0
    assert paint.propagate(np.max).estimate > 0.0


def test_a_wrong_value_is_told_as_in_a_file(tmp_path):
    design = finray.finger_design()
    values = design.model_dump()
    values["pad"]["thickness_mm"] = -1.0
    with pytest.raises(
        FieldError, match=r"^'pad\.thickness_mm' \(in mm\): must be above 0, got -1\.0; correct it"
    ) as told:
        finray.FingerDesign(**values)
    assert isinstance(told.value, finray.FinrayError)
    assert isinstance(told.value, ValueError)
    (tmp_path / "d.toml").write_text('preset = "flat-70x35"\n[pad]\nthickness_mm = -1.0\n')
    with pytest.raises(RecordError, match=re.escape(str(told.value))):
        finray.finger_design(tmp_path / "d.toml")
    with pytest.raises(FieldError, match="'tickness_mm': unknown key; did you mean 'thickness_mm'"):
        type(design.pad)(**{**design.pad.model_dump(), "tickness_mm": 3.0})


def test_a_path_that_holds_an_option_is_told_as_it_is(tmp_path):
    place = tmp_path / "run--weights" / "x--samples.json"
    with pytest.raises(RecordError, match=re.escape(str(place))):
        finray.fit_paint(place)


def test_errors_of_the_library_name_arguments():
    twice = [sweep(), sweep()]
    with pytest.raises(DecideError, match="Give each sweep only once, and its weight by weights"):
        finray.decide_light_angle(twice)
    with pytest.raises(DecideError, match=r"simulate them with all_objectives=True, .* \(aim='brightness'\)"):
        finray.decide_light_angle(sweep(), aim="normal")


def test_errors_of_renders_name_arguments(lab, paint):
    finger, how = lab / "finger.toml", {"red": paint, "green": paint, "samples": 2, "engine": "scalar"}
    for render in (finray.render_press, finray.render_images):
        with pytest.raises(SimulateError, match=r"^shared_light needs a compiled .* or leave shared_light out$"):
            render(finger, shared_light=True, **how)
    with pytest.raises(SimulateError, match=r"leave out engine='scalar', .* or give all_objectives=False$"):
        finray.sweep_light_angle(finger, [0.0, 10.0, 20.0], all_objectives=True, **how)


def test_a_file_that_cannot_be_written_is_told_in_words(home):
    (home / "file").write_text("here")
    for place in ("a\0b.json", "x" * 300 + ".json", "file/x.json", "/proc/x.json"):
        with pytest.raises(RecordError, match=r"cannot be written \(.*\); choose another place"):
            finray.write_record(sweep(), place)
    with pytest.raises(RecordError, match=r"cannot be written \(.*\); choose another place"):
        sweep().plot().save("/proc/x.svg")
    with pytest.raises(RecordError, match=r"the name of a stored record must end in \.json; choose another name"):
        finray.write_record(sweep(), "x")
    finray.write_record(sweep(), "x.json")
    with pytest.raises(RecordError, match=r"x\.json: exists already and is not overwritten; choose another name"):
        finray.write_record(sweep(), "x.json")


def test_a_folder_that_a_session_has_is_told_by_its_argument(lab):
    with pytest.raises(CaptureError, match="a capture never overwrites files; choose another out"):
        finray.capture_session(lab / "plan.toml", lab / "rig.toml", lab / "session")


@pytest.mark.parametrize("increments", [0, 1001, 10**9, 2.5, True])
def test_increments_that_no_press_takes_are_refused_before_the_work(increments):
    """10^9 of them did not end, whatever `budget_s` was."""
    with pytest.raises(SimulateError, match="must be a whole number from 1 to 1000"):
        finray.press_finger("flat-70x35", increments=increments, budget_s=1.0)


def test_every_option_that_an_error_of_the_rooms_names_has_its_argument():
    files = [
        *(path for room in LIBRARY_ROOMS for path in (ROOMS / room).glob("*.py")),
        *RENDERERS,
        ROOMS / "exchange/_signal_table.py",
    ]
    named = {option for path in files for option in OPTION.findall(path.read_text(encoding="utf-8"))}
    known = {option for text in _ARGUMENTS for option in OPTION.findall(text)}
    assert named - known == set(NOT_FROM_THE_LIBRARY)
    assert known - named == {"--out"} - named  # of captures, in rigs


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.0034, "0.34 %"), (0.0001, "0.01 %"), (1.0, "100 %"), (0.003, "0.3 %"), (0.126, "13 %"), (-0.0, "0 %")],
)
def test_a_fraction_is_told_with_two_significant_digits(fraction, text):
    assert percent(fraction) == text
