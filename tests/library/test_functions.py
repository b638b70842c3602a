"""Every function of the library on small examples, from a rig to a decision."""

import re

import numpy as np
import pytest

import finray_calib as finray
from data_schemas import (
    CaptureError,
    DecideError,
    FinrayError,
    FitError,
    ImportFormatError,
    PlainSensor,
    RadiometryError,
    RecordError,
    SimulateError,
)
from data_schemas.storage import read_record, sha256_of
from finray_calib.lineage import findings
from sim import design_toml, preset_design
from sim.mechanics import STEPS
from sim.mechanics._finger_mesh import MeshSteps
from tests.command_line.running import succeed

pytestmark = pytest.mark.filterwarnings("ignore:scalar_rgb renders")


@pytest.fixture(scope="module")
def rendered(lab, paint):
    return finray.render_press(
        lab / "finger.toml", red=lab / "red.paint.json", green=paint, engine="scalar", samples=2, seed=6
    )


def test_what_was_captured_is_reduced_and_fitted(lab, paint):
    session = finray.read_record(lab / "session")
    assert isinstance(session, finray.CaptureSession)
    bands = finray.read_record(str(lab / "bands.json"))
    assert isinstance(bands, finray.BandSignals)
    assert bands.provenance.input_sha256 == {f"{lab}/session/session.json": sha256_of(lab / "session/session.json")}
    assert paint.provenance.seed == 5
    assert paint.provenance.command == "finray_calib.fit_paint, from Python"
    assert repr(paint).splitlines()[-1].startswith("  made: ")


def test_the_library_gives_the_numbers_of_the_command_line(lab, paint, tmp_path):
    succeed(f"fit {lab}/bands.json --seed 5 --out {tmp_path}/paint.json")
    verb = read_record(tmp_path / "paint.json", finray.PaintCalibration)
    assert verb.provenance.command.startswith("finray fit ")
    np.testing.assert_array_equal(verb.draws, paint.draws)


def test_what_the_library_stored_can_be_traced(lab):
    tree = finray.trace_record(lab / "red.paint.json")
    assert [part.kind for part in tree.all()] == ["PaintCalibration", "BandSignals", "CaptureSession", "file", "file"]
    assert findings(tree) == ()
    assert tree.is_intact


def test_a_record_that_was_read_is_written_with_its_history(lab, paint, tmp_path):
    renamed = paint.model_copy(update={"paint_name": "orange"})
    finray.write_record(renamed, tmp_path / "again.json")
    succeed(f"fit {lab}/bands.json --seed 5 --out {tmp_path}/verb.json")
    finray.write_record(finray.read_record(tmp_path / "verb.json"), tmp_path / "verb-again.json")
    told = finray.read_record(tmp_path / "verb-again.json").provenance
    assert told.command.startswith("finray_calib.write_record, of what was made by: finray fit ")
    assert told.arguments is None  # nothing that 'finray trace --replay' would run
    with pytest.raises(RecordError, match=r"again\.json"):
        finray.write_record(renamed, tmp_path / "again.json")


def test_pixels_are_mapped(lab, paint, monkeypatch):
    pixels = finray.reduce_pixels(lab / "session")
    assert isinstance(pixels, finray.PixelSignals)
    taken = []
    monkeypatch.setattr("finray_calib.fit.map_paint", lambda *given: taken.append(given) or paint)  # takes a minute
    fitted = finray.map_paint(pixels, lab / "red.paint.json")
    assert taken[0][0] is pixels
    assert taken[0][1].paint_name == paint.paint_name
    assert set(fitted.provenance.input_sha256) == {f"{lab}/red.paint.json"}


def test_a_characterised_camera_is_used(lab, tmp_path):
    from data_schemas import CameraCharacterisation
    from rigs import camera_plan, simulated_rig, write_plan

    write_plan(camera_plan("bench", simulated_rig("red", width_px=320, height_px=256).camera), tmp_path / "camera.toml")
    finray.capture_session(tmp_path / "camera.toml", lab / "rig.toml", tmp_path / "camera")
    camera = finray.reduce_session(tmp_path / "camera")
    assert isinstance(camera, CameraCharacterisation)
    bands = finray.reduce_session(lab / "session", camera=camera)
    assert finray.reduce_session(lab / "session").fluorescence.shape == bands.fluorescence.shape
    with pytest.raises(RadiometryError, match="is a camera session, but camera and accept_repeat are only for paint"):
        finray.reduce_session(tmp_path / "camera", camera=camera)


def test_a_rig_is_opened(lab):
    with finray.open_rig(lab / "rig.toml") as opened:
        assert len(opened.identities()) == 4


def test_plans_that_ask_a_person_are_left_to_the_command_line(lab, tmp_path):
    (tmp_path / "plan.toml").write_text('kind = "tactile"\n')
    with pytest.raises(CaptureError, match="plans of kind 'tactile' need a person at the rig"):
        finray.capture_session(tmp_path / "plan.toml", lab / "rig.toml", tmp_path / "session")


def test_designs_come_by_name_or_file(lab, tmp_path):
    assert finray.finger_design("baby-48x18").pad.length_mm == 48.0
    assert finray.finger_design(lab / "finger.toml").name == "small finger"
    with pytest.raises(SimulateError, match="no preset design 'flat-7x3'; valid names are flat-70x35, "):
        finray.finger_design("flat-7x3")
    with pytest.raises(RecordError, match=r"none\.toml"):
        finray.finger_design(tmp_path / "none.toml")


def test_a_render_names_its_paints_and_is_recoloured(lab, paint, rendered, tmp_path):
    digest = sha256_of(lab / "red.paint.json")
    assert rendered.paints["red"] == digest
    assert len(rendered.paints["green"]) == 64  # of the record's content: it came without a file
    assert rendered.provenance.input_sha256[f"{lab}/red.paint.json"] == digest
    assert f"{lab}/finger.toml" in rendered.provenance.input_sha256
    grey = finray.recolour_press(rendered, white_balance="pad")
    assert not np.array_equal(grey.contact, rendered.contact)
    with pytest.raises(SimulateError, match="no change was requested"):
        finray.recolour_press(rendered)
    with pytest.raises(SimulateError, match="only one of red and green is given; give both"):
        finray.recolour_press(rendered, red=paint)


@pytest.mark.parametrize("given", ["sun", "1:1:1", ("red", "green", "blue"), (1.0, 2.0), ((1.0,), (1.0, 2.0)), 3])
def test_a_white_balance_that_is_none_is_refused_with_what_is_allowed(rendered, given):
    allowed = 'must be three positive gains (red, green, blue) or "pad"'
    with pytest.raises(SimulateError, match=f"white_balance={re.escape(repr(given))}: {re.escape(allowed)}"):
        finray.recolour_press(rendered, white_balance=given)


def test_the_verb_renders_the_same_press(lab, paint, rendered, tmp_path):
    red = f"--paint red={lab}/red.paint.json --paint green={lab}/red.paint.json"
    succeed(f"simulate render {lab}/finger.toml {red} --engine scalar --samples 2 --seed 6 --out {tmp_path}/press.json")
    np.testing.assert_array_equal(read_record(tmp_path / "press.json", finray.SimulatedPress).contact, rendered.contact)


def test_swapped_paints_are_refused_unless_meant(lab, paint):
    shifted = paint.parameters["mode_nm"].model_copy(update={"estimate": paint.mode_nm.estimate - 80.0})
    bluer = paint.model_copy(update={"parameters": {**paint.parameters, "mode_nm": shifted}})
    with pytest.raises(
        SimulateError,
        match=r"look swapped.* Exchange the paints, or give --paints-as-given \(from Python paints_as_given=True\)",
    ):
        finray.render_press(lab / "finger.toml", red=bluer, green=paint)
    press = finray.render_press(
        lab / "finger.toml", red=bluer, green=paint, engine="scalar", samples=2, paints_as_given=True
    )
    assert press.method == "rendered"
    with pytest.raises(SimulateError, match="samples=3: must be an even number of 2 or more"):
        finray.render_press(lab / "finger.toml", red=paint, green=paint, samples=3)


def test_a_sweep_leads_to_a_decision(lab, paint):
    swept = finray.sweep_light_angle(
        lab / "finger.toml", [0, 30, 60, 90], red=paint, green=paint, engine="scalar", samples=40, seed=6
    )
    decision = finray.decide_light_angle(swept, seed=1)
    assert 0.0 <= decision.angle_deg <= 90.0
    assert not decision.validated
    with pytest.raises(SimulateError, match=r"angles_deg: .*rad"):
        finray.sweep_light_angle("flat-70x35", [0.0, 0.5, 1.0, 1.5], red=paint, green=paint)
    with pytest.raises(SimulateError, match="sweeps support only level b"):
        finray.sweep_light_angle("flat-70x35", [0, 30, 60, 90], red=paint, green=paint, level="c")


def test_presses_are_compared_and_captures_decide(lab):
    report = finray.compare_press(lab / "press.json", lab / "capture.json")
    assert report.headline_skill.estimate > 0.9
    assert set(report.provenance.input_sha256) == {f"{lab}/press.json", f"{lab}/capture.json"}
    decision = finray.decide_light_angle(lab / "sweep.json", [report])
    assert decision.validated
    with pytest.raises(RecordError, match="contains a tactile capture, but a simulated press is needed"):
        finray.compare_press(lab / "capture.json", lab / "press.json")
    with pytest.raises(
        RecordError,
        match=r"a simulated press is needed \(a SimulatedPress or the path of its file\), but a value of type int was ",
    ):
        finray.compare_press(7, lab / "capture.json")


def test_a_finger_is_pressed_rendered_and_its_force_compared(lab, paint, tmp_path, monkeypatch):
    steps = MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0)
    monkeypatch.setitem(STEPS, "coarse", steps)
    indenter = finray.finger_design().indenter.model_copy(update={"depth_mm": 0.6, "friction": 0.0})
    camera = finray.finger_design(lab / "finger.toml").camera
    design = finray.finger_design().model_copy(update={"indenter": indenter, "camera": camera})
    pressed = finray.press_finger(design, increments=3)
    assert pressed.mechanics.force_n[-1, 1] > 0.0
    push_mm = np.linspace(0.1, 0.6, 6)
    force_n = np.interp(push_mm, [0.0, *pressed.mechanics.depth_mm], [0.0, *pressed.mechanics.force_n[:, 1]])
    rows = [f"{d},{f}" for d, f in zip(push_mm, force_n, strict=True)]
    (tmp_path / "force.csv").write_text("\n".join(["displacement_mm,force_n", *rows]) + "\n")
    compared = finray.compare_force(pressed.mechanics, tmp_path / "force.csv", known_first_touch=True)
    assert f"{tmp_path}/force.csv" in compared.provenance.input_sha256
    press = finray.render_press(design, red=paint, green=paint, surfaces=pressed.surfaces, engine="scalar", samples=2)
    assert "finite elements" in " ".join(press.notes)
    forced = finray.press_finger(design, increments=2, force_n=0.5 * float(pressed.mechanics.force_n[-1, 1]))
    assert forced.mechanics.wanted_force_n is not None
    with pytest.raises(SimulateError, match="force_n works only with penalty contact"):
        finray.press_finger(design, force_n=1.0, contact="barrier")


def test_what_is_no_record_is_refused(lab, tmp_path):
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "other.json").write_text('{"kind": "Cat"}')
    for name, message in (("list.json", "is not a stored record, because its 'kind' is None"), ("other.json", "'Cat'"),
                          ("none.json", "none.json")):  # fmt: skip
        with pytest.raises(RecordError, match=message):
            finray.read_record(tmp_path / name)
    with pytest.raises(
        RecordError, match="a TOML file, not a stored record; to read a finger design, call finger_design"
    ):
        finray.read_record(lab / "finger.toml")
    with pytest.raises(RecordError, match="band signals are needed, but a plain sensor was given"):
        finray.fit_paint(PlainSensor())


def test_band_images_of_others_are_imported(tmp_path):
    with pytest.raises(ImportFormatError, match=r"bands\.toml"):
        finray.import_bands(tmp_path)


def test_a_table_of_band_signals_is_imported(tmp_path):
    rows = "".join(f"{nm},{nm},10,{f},0.01,2,0.01,3,0.01\n" for nm, f in ((450, 1), (560, 0.2), (600, 0.5), (640, 0.1)))
    header = "filter,center_nm,fwhm_nm,paint_laser,paint_laser_sd,white_lamp,white_lamp_sd,white_laser,white_laser_sd\n"
    (tmp_path / "red.csv").write_text(header + rows)
    bands = finray.import_signals(tmp_path / "red.csv", options=finray.SignalOptions(laser_nm=450.0))
    # (F / W) / (V / W_e) with one white reading for all filters
    np.testing.assert_allclose(bands.fluorescence[:, 1], [1 / 3, 0.2 / 3, 0.5 / 3, 0.1 / 3])
    assert f"{tmp_path}/red.csv" in bands.provenance.input_sha256
    with pytest.raises(ImportFormatError, match=r"is not known; give rig, or options\.laser_nm \(nm\)$"):
        finray.import_signals(tmp_path / "red.csv")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"laser_nm": 450.0}, r"^options: must be None or a SignalOptions, such as SignalOptions\(laser_nm=450\.0\)"),
        *(
            (
                finray.SignalOptions(laser_nm=450.0, assumed_yield=value),
                r"^options\.assumed_yield: must be a number a",
            )
            for value in (0.0, -0.2, 20, "a", float("nan"), True)
        ),
        (finray.SignalOptions(laser_nm="blue"), r"^options\.laser_nm \(in nm\): must be a number, got 'blue'"),
        (finray.SignalOptions(laser_nm=450.0, paint_name=5), r"^options\.paint_name: must be text"),
        (finray.SignalOptions(laser_nm=450.0, calibrated="no"), r"^options\.calibrated='no': must be True or False"),
        (finray.SignalOptions(laser_nm=450.0, response=5), r"^options\.response: must be the path of a file"),
        (finray.SignalOptions(laser_nm=450.0, response="none.csv"), r"^none\.csv: no such file"),
        (finray.SignalOptions(laser_nm=450.0, white_reflectance=98), r"^options\.white_reflectance: must be at most 1"),
    ],
)
def test_wrong_options_of_a_table_of_band_signals_are_refused(tmp_path, given, message):
    row = "450,450,10,1,0.01,2,0.01,3,0.01\n"
    header = "filter,center_nm,fwhm_nm,paint_laser,paint_laser_sd,white_lamp,white_lamp_sd,white_laser,white_laser_sd\n"
    (tmp_path / "red.csv").write_text(header + row)
    with pytest.raises(FinrayError, match=message):
        finray.import_signals(tmp_path / "red.csv", options=given)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", None, True, 2**70])
def test_a_seed_that_no_generator_takes_is_refused_before_the_work(lab, paint, seed):
    calls = (
        lambda: finray.fit_paint(lab / "bands.json", seed=seed),
        lambda: finray.compare_press(lab / "press.json", lab / "capture.json", seed=seed),
        lambda: finray.compare_force(lab / "press.json", "force.csv", seed=seed),
        lambda: finray.decide_light_angle(lab / "sweep.json", seed=seed),
        lambda: finray.render_press(lab / "finger.toml", red=paint, green=paint, seed=seed),
        lambda: finray.render_images(lab / "finger.toml", red=paint, green=paint, seed=seed),
        lambda: finray.render_sensor("gelsight-flat", seed=seed),
        lambda: finray.fit_sensor("gelsight-flat", [], seed=seed),
        lambda: finray.sweep_light_angle(lab / "finger.toml", [0, 30, 60, 90], red=paint, green=paint, seed=seed),
    )
    for call in calls:
        with pytest.raises(RecordError, match="must be a whole number from 0 to"):
            call()


def test_a_seed_of_numpy_is_a_seed(lab):
    decision = finray.decide_light_angle(lab / "sweep.json", seed=np.int64(3))
    assert decision.provenance.seed == 3
    assert decision.angle_deg == finray.decide_light_angle(lab / "sweep.json", seed=3).angle_deg


def test_what_is_no_list_of_records_is_refused_by_its_own_name(lab, paint, tmp_path):
    for wrong in (None, 7, np.nan):
        with pytest.raises(
            RecordError, match="bands: must be a list whose elements are each a BandSignals or the path"
        ):
            finray.fit_paint(wrong)
    for path in (lab / "bands.json", str(lab / "bands.json")):
        with pytest.raises(RecordError, match=r"other_lights: must be a list .*, but a single path was given"):
            finray.fit_paint(lab / "bands.json", other_lights=path)
    with pytest.raises(RecordError, match=r"sweeps: a light angle sweep is needed, but a paint calibration was given"):
        finray.decide_light_angle(paint)
    with pytest.raises(RecordError, match="reports: must be a list"):
        finray.decide_light_angle(lab / "sweep.json", lab / "report.json")
    with pytest.raises(RecordError, match="captures: must be a list"):
        finray.fit_sensor(lab / "finger.toml", lab / "capture.json")
    with pytest.raises(FitError, match="no band signals are given"):
        finray.fit_paint([])
    with pytest.raises(RecordError, match=r"x\.json: the first argument must be a record, .* of type ndarray"):
        finray.write_record(np.zeros(3), tmp_path / "x.json")
    with pytest.raises(RecordError, match=r"^the first argument must be a record, .* is of type str$"):
        finray.write_record("x.json", paint)
    with pytest.raises(
        RecordError, match=r"this folder contains no session \(session\.json is missing\); give the path of"
    ):
        finray.read_record(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_same_session_does_not_count_twice(lab):
    with pytest.raises(FitError, match="session 2 contains the same values as session 1, so it would count twice"):
        finray.fit_paint([lab / "bands.json", lab / "bands.json"])


def test_one_session_reduced_two_ways_does_not_count_twice(lab, tmp_path):
    bands = finray.read_record(lab / "bands.json")
    other = finray.reduce_session(lab / "session", accept_repeat=True)
    other = other.model_copy(update={"fluorescence": 1.001 * other.fluorescence})  # as other options would make it
    with pytest.raises(FitError, match="sessions 1 and 2 were reduced from the same captured session"):
        finray.fit_paint([bands, other])


def test_one_capture_under_two_names_does_not_count_twice(lab):
    capture = finray.read_record(lab / "capture.json")
    again = capture.model_copy(update={"name": "again"})
    finger = finray.finger_design()
    sensor = PlainSensor(pad=finger.pad, indenter=finger.indenter)
    with pytest.raises(
        SimulateError, match=f"again contains the same picture as {capture.name}, which would count twice"
    ):
        finray.fit_sensor(sensor, [capture, again])


@pytest.mark.parametrize("value", ["no", 0, None, np.array([True])])
def test_what_is_neither_true_nor_false_is_no_option(lab, paint, value):
    paints = {"red": paint, "green": paint}
    calls = (
        ("accept_repeat", lambda: finray.reduce_session(lab / "session", accept_repeat=value)),
        ("whole_frame", lambda: finray.reduce_pixels(lab / "session", whole_frame=value)),
        ("check", lambda: finray.fit_paint(lab / "bands.json", check=value)),
        ("discrepancy", lambda: finray.fit_paint(lab / "bands.json", discrepancy=value)),
        ("register", lambda: finray.compare_press(lab / "press.json", lab / "capture.json", register=value)),
        ("known_first_touch", lambda: finray.compare_force(lab / "press.json", "f.csv", known_first_touch=value)),
        ("narrow_sweep", lambda: finray.decide_light_angle(lab / "sweep.json", narrow_sweep=value)),
        ("pose_response", lambda: finray.render_press(lab / "finger.toml", pose_response=value, **paints)),
        ("all_objectives", lambda: finray.sweep_light_angle(lab / "finger.toml", [0, 90], all_objectives=value,
                                                            **paints)),
    )  # fmt: skip
    for name, call in calls:
        with pytest.raises(RecordError, match=rf"{name}=.*: must be True or False"):
            call()


def test_a_truth_of_numpy_is_one(lab):
    assert finray.decide_light_angle(lab / "sweep.json", narrow_sweep=np.bool_(False))


def test_texts_dicts_and_sets_are_no_lists_of_numbers(lab, paint):
    for angles_deg in ("036", b"036", {0: 1, 30: 2, 60: 3}, {0, 30, 60, 90}):
        with pytest.raises(SimulateError, match="must be a list of finite angles in deg"):
            finray.sweep_light_angle(lab / "finger.toml", angles_deg, red=paint, green=paint)
    for weights in ("1", {1: "a"}, {1.0}):
        with pytest.raises(DecideError, match="give one number above 0 for each sweep, in the order of the sweeps"):
            finray.decide_light_angle(lab / "sweep.json", weights=weights)
    for several in ({lab / "bands.json": 1}, {lab / "bands.json"}):
        with pytest.raises(RecordError, match="bands: must be a list"):
            finray.fit_paint(several)
    with pytest.raises(
        SimulateError, match=r"free='pad.thickness_mm': must be a list of dotted paths to numbers of the design"
    ):
        finray.fit_sensor("gelsight-flat", [lab / "capture.json"], free="pad.thickness_mm")


def test_a_fit_without_captures_is_refused():
    with pytest.raises(SimulateError, match="captures: the list is empty; give at least one"):
        finray.fit_sensor("gelsight-flat", [])


def test_a_record_that_was_changed_to_what_cannot_be_is_not_stored(lab, tmp_path):
    bands = finray.read_record(lab / "bands.json")
    with pytest.raises(
        RecordError,
        match=r"x\.json: was not written, .*: .reflectance. has 8 entries along .filter., but .fluorescence. has 2",
    ):
        finray.write_record(bands.model_copy(update={"fluorescence": np.zeros((2, 3))}), tmp_path / "x.json")
    with pytest.raises(RecordError, match="BandSignals has no field 'flourescence'; valid names are bleaching"):
        bands.model_copy(update={"flourescence": bands.fluorescence})
    assert list(tmp_path.iterdir()) == []


def test_a_decision_without_sweeps_or_with_unknown_choices_is_refused(lab):
    with pytest.raises(DecideError, match="no sweep is given"):
        finray.decide_light_angle([])
    with pytest.raises(DecideError, match="aim='normals' is unknown; it is one of None, 'brightness', 'normal'"):
        finray.decide_light_angle(lab / "sweep.json", aim="normals")
    with pytest.raises(DecideError, match="criterion='best' is unknown; it is one of 'average', 'worst'"):
        finray.decide_light_angle(lab / "sweep.json", criterion="best")
    for weights in ([np.inf], [np.nan], [0], ["a"], "a", 3, [1, 1]):
        with pytest.raises(DecideError, match="do not fit one sweep; give one number above 0 for each sweep"):
            finray.decide_light_angle(lab / "sweep.json", weights=weights)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (
            {"sampels": 40},
            "sampels: is not an option of this function; valid options are all_objectives, engine, level",
        ),
        ({"pose_response": True}, "pose_response: is not an option of this function"),
        ({"samples": 0}, "samples=0: must be a whole number of 1 or more"),
        ({"samples": 1.5}, r"samples=1\.5: must be a whole number"),
        ({"engine": "cpu"}, "engine='cpu': must be one of auto, llvm, scalar, cuda"),
        ({"position_mm": 500.0}, r"indenter\.position_mm = 500\.0 mm must lie on the pad \(0 to 70\.0 mm\)"),
        ({"position_mm": np.nan}, r"'indenter\.position_mm' \(in mm\): must be a finite number"),
    ],
)
def test_an_option_that_a_sweep_does_not_have_is_refused(lab, paint, option, message):
    with pytest.raises(SimulateError, match=message):
        finray.sweep_light_angle(lab / "finger.toml", [0, 30, 60, 90], red=paint, green=paint, **option)


def test_options_of_a_press_are_checked(lab, paint):
    for option, message in (({"all_objectives": True}, "all_objectives: is not an option of this function"),
                            ({"level": "B"}, "level='B': must be one of a, a_inverse_square, b, c"),
                            ({"position_mm": -1.0}, "must lie on the pad")):  # fmt: skip
        with pytest.raises(SimulateError, match=message):
            finray.render_press(lab / "finger.toml", red=paint, green=paint, **option)
    with pytest.raises(SimulateError, match="samples=3: must be an even number of 2 or more"):
        finray.render_sensor("gelsight-flat", samples=3)
    with pytest.raises(SimulateError, match="paints: must name one paint for each wall"):
        finray.fit_sensor(lab / "finger.toml", [lab / "capture.json"], paints={"rde": paint, "green": paint})


@pytest.mark.parametrize("angles_deg", [None, 7, [], "0:90:30", [0, 30, 60, np.nan]])
def test_angles_are_a_list_of_finite_numbers(lab, paint, angles_deg):
    with pytest.raises(SimulateError, match="must be a list of finite angles in deg"):
        finray.sweep_light_angle(lab / "finger.toml", angles_deg, red=paint, green=paint)


def test_numbers_of_a_push_are_checked_before_it():
    for numbers, message in (({"increments": 0}, "increments=0: must be a whole number from 1"),
                             ({"increments": 1.5}, r"increments=1\.5"),
                             ({"force_n": -1.0}, r"force_n=-1\.0: must be a finite number above 0 N"),
                             ({"force_n": np.nan}, "force_n=nan"),
                             ({"budget_s": 0}, "budget_s=0: must be a finite number above 0 s"),
                             ({"contact": "glue"}, "contact='glue': must be one of")):  # fmt: skip
        with pytest.raises(SimulateError, match=message):
            finray.press_finger("flat-70x35", **numbers)


def test_a_design_changed_in_python_is_checked_again(paint):
    design = finray.finger_design()
    metres = design.indenter.model_copy(update={"depth_mm": -1.5})
    with pytest.raises(SimulateError, match=r"the design 'flat-70x35': 'indenter\.depth_mm' \(in mm\): must be"):
        finray.render_press(design.model_copy(update={"indenter": metres}), red=paint, green=paint)


def test_a_sensor_is_needed_and_ready_made_ones_are_named(tmp_path):
    with pytest.raises(
        SimulateError, match=r"knuckle\.toml: no such file; give a ready-made sensor \(gelsight-flat, digit"
    ):
        finray.render_sensor("knuckle.toml")
    (tmp_path / "finger.toml").write_text(design_toml(preset_design("flat-70x35")))
    needed = r"finger\.toml: contains the design of a finger, but that of a classic sensor is needed$"
    with pytest.raises(RecordError, match=needed):
        finray.render_sensor(tmp_path / "finger.toml")


def test_a_sensor_changed_in_python_is_checked_again(lab):
    sensor = PlainSensor()
    metres = sensor.model_copy(update={"camera": sensor.camera.model_copy(update={"distance_mm": -40.0})})
    for call in (lambda: finray.render_sensor(metres), lambda: finray.fit_sensor(metres, [lab / "capture.json"])):
        with pytest.raises(SimulateError, match=r"the design 'plain-20x20': 'camera\.distance_mm' \(in mm\): must be"):
            call()


def test_angles_beyond_half_a_turn_are_refused(lab, paint):
    with pytest.raises(SimulateError, match="300 deg is out of range; light angles must be from -180 to 180 deg"):
        finray.sweep_light_angle(lab / "finger.toml", [0, 100, 300, 500], red=paint, green=paint)


@pytest.mark.parametrize("angles_deg", [[0, 20, 10, 30], [0, 10, 10, 20]])
def test_angles_that_do_not_increase_are_refused(lab, paint, angles_deg):
    with pytest.raises(SimulateError, match=r"10 deg follows [12]0 deg, but the angles must increase"):
        finray.sweep_light_angle(lab / "finger.toml", angles_deg, red=paint, green=paint)


@pytest.mark.parametrize(
    "call",
    [finray.finger_design, finray.read_record, finray.trace_record, finray.import_bands, finray.import_signals,
     finray.reduce_session, finray.render_sensor],
)  # fmt: skip
def test_what_is_no_path_is_refused(call):
    with pytest.raises(RecordError, match="must be the path of a file or folder, got type NoneType"):
        call(None)
