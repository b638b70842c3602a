"""All six stages from files to files, and what every stored record says about itself."""

import re
import shutil
from argparse import ArgumentParser, Namespace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from data_schemas import (
    AngleObjective,
    LightAngleDecision,
    LightAngleSweep,
    PaintCalibration,
    PhotometricErrorReport,
    SimulatedPress,
    package_version,
    provenance,
)
from data_schemas.json_schemas import STORED, json_schema
from data_schemas.storage import read_frame, read_record, sha256_of, write_frame, write_record
from finray_calib.cli._simulate import _is_swept, _long_sweep
from finray_calib.cli.main import VERBS
from rigs._rig_files import RED_PAINT
from tests.command_line.records import BEST_DEG, capture_of
from tests.command_line.running import edit, finray, load, succeed
from tests.schemas.freeze import example_of

KINDS = {record_type.__name__: record_type for record_type in STORED}


def require_valid(path: Path) -> dict[str, object]:
    """Check a stored record against its JSON Schema and return its provenance."""
    stored = load(path)
    jsonschema.Draft202012Validator(json_schema(KINDS[stored["kind"]])).validate(stored)
    return dict(stored["record"]["provenance"])


def test_capture_and_radiometry_leave_valid_records(lab: Path) -> None:
    assert require_valid(lab / "session/session.json")["command"] == (
        f"finray capture {lab}/plan.toml --rig {lab}/rig.toml --out {lab}/session"
    )
    origin = require_valid(lab / "bands.json")
    assert origin["input_sha256"] == {f"{lab}/session/session.json": sha256_of(lab / "session/session.json")}
    assert origin["seed"] is None


def test_radiometry_is_repeatable_and_names_a_saturated_channel(lab: Path, tmp_path: Path) -> None:
    said = succeed(f"radiometry {lab}/session --out {tmp_path}/again.json")
    assert "8 filters x 3 channels over 3136 px" in said
    assert "saturated" not in said
    again, before = (load(path)["record"] for path in (tmp_path / "again.json", lab / "bands.json"))
    assert again.pop("provenance") != before.pop("provenance")
    assert again == before

    session = shutil.copytree(lab / "session", tmp_path / "session")
    for frame in load(session / "session.json")["record"]["frames"]:
        if (frame["frame_type"], frame["filter_name"]) == ("white", "560"):
            path = session / frame["file"]
            counts = read_frame(path, frame["sha256"]).copy()
            counts[::2, ::2] = 1023
            path.unlink()
            edit(session / "session.json", frame["sha256"], write_frame(path, counts, "red sites saturated"))
    assert "filter 560: red saturated\n" in succeed(f"radiometry {session} --out {tmp_path}/saturated.json")


def test_fit_finds_the_hidden_paint_and_stores_its_origin(lab: Path, paints: Path) -> None:
    path = paints / "red/paint.json"
    origin = require_valid(path)
    assert origin["input_sha256"] == {f"{lab}/bands.json": sha256_of(lab / "bands.json")}
    assert (origin["seed"], origin["package_version"]) == (5, package_version())
    paint = read_record(path, PaintCalibration)
    for mode in (paint.parameters["mode_nm"], paint.families[-1].quantities["mode_nm"]):
        # four posterior standard deviations: a correct fit misses in 6 of 100 000 runs
        assert abs(mode.estimate - RED_PAINT.mode_nm) < 4 * mode.sd
        assert mode.sd < 5.0  # half a filter's width


def test_rendered_press_compares_with_its_own_capture(rendered: Path, lab: Path, tmp_path: Path) -> None:
    origin = require_valid(rendered / "press.json")
    digest = sha256_of(rendered / "red/paint.json")
    assert origin["input_sha256"] == {
        f"{lab}/finger.toml": sha256_of(lab / "finger.toml"),
        f"{rendered}/red/paint.json": digest,
        f"{rendered}/green/paint.json": digest,
    }
    press = read_record(rendered / "press.json", SimulatedPress)
    assert press.paints == {"red": digest, "green": digest}
    assert press.label == "rendered, level b, scalar_rgb, without the film"

    dn_per_unit = 60_000.0 / float(max(press.contact.max(), press.no_contact.max()))
    write_record(capture_of(press, dn_per_unit), tmp_path / "capture.json", provenance("pytest"))
    arguments = f"compare {rendered}/press.json {tmp_path}/capture.json --seed 7"
    assert "headline: skill" in succeed(f"{arguments} --out {tmp_path}/report.json")
    assert require_valid(tmp_path / "report.json")["seed"] == 7
    report = read_record(tmp_path / "report.json", PhotometricErrorReport)
    # The capture is the render itself, scaled, with 1 DN of noise averaged over blocks of 64 pixels.
    assert report.headline_skill.estimate > 0.99
    assert report.exposure_factor == pytest.approx(dn_per_unit, rel=0.005)


def test_swept_angles_lead_to_a_decision(rendered: Path, tmp_path: Path) -> None:
    require_valid(rendered / "sweep.json")
    sweep = read_record(rendered / "sweep.json", LightAngleSweep)
    np.testing.assert_array_equal(sweep.angles_deg, [0.0, 30.0, 60.0, 90.0])
    said = succeed(f"decide {rendered}/sweep.json --out {tmp_path}/decision.json")
    require_valid(tmp_path / "decision.json")
    decision = read_record(tmp_path / "decision.json", LightAngleDecision)
    assert 0.0 <= decision.angle_deg <= 90.0
    assert said.startswith(decision.headline)
    assert decision.sentence.removeprefix(decision.headline).strip() in said
    assert not decision.validated


def test_a_sweep_without_the_objectives_that_are_asked_of_its_place_is_not_taken_for_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = "finray simulate sweep finger.toml --objectives all"
    monkeypatch.setattr("sys.argv", command.split())
    for colour in ("red", "green"):
        (tmp_path / colour).write_text(colour)
    example = read_record(example_of(LightAngleSweep, 5), LightAngleSweep)
    paints = {colour: sha256_of(tmp_path / colour) for colour in ("red", "green")}
    bare = example.model_copy(update={"paints": paints, "other_objectives": (), "constraints": None})
    write_record(bare, tmp_path / "bare.json", provenance(command, {}, 1))
    full = bare.model_copy(update={"other_objectives": (_objective(example),)})
    write_record(full, tmp_path / "full.json", provenance(command, {}, 1))
    place = example.design.indenter.position_mm
    arguments = Namespace(
        paint=[(colour, tmp_path / colour) for colour in paints], seed=1, angles=example.angles_deg.tolist(),
        objectives="all", positions=[8.0, place],
    )  # fmt: skip
    # a place that is not the first has none, and the sweep of an earlier first place may keep its own
    assert _is_swept(tmp_path / "bare.json", example.design, place, arguments)
    assert _is_swept(tmp_path / "full.json", example.design, place, arguments)
    arguments.positions = [place, 50.0]
    assert not _is_swept(tmp_path / "bare.json", example.design, place, arguments)
    assert _is_swept(tmp_path / "full.json", example.design, place, arguments)
    arguments.out = None
    assert _long_sweep(arguments).kept.startswith("Finished places are kept, and the same command continues")


def _objective(sweep: LightAngleSweep) -> AngleObjective:
    """Return an objective at each angle of a sweep."""
    return AngleObjective(
        name="normal", meaning="error of the normal", unit="deg", values=np.ones((len(sweep.angles_deg), 2)),
        larger_is_better=False,
    )  # fmt: skip


def test_several_places_are_swept_by_one_command_and_decided_by_another(
    lab: Path, paints: Path, tmp_path: Path
) -> None:
    command = (
        f"simulate sweep {lab}/finger.toml --paint red={paints}/red/paint.json --paint green={paints}/green/paint.json "
        f"--engine scalar --samples 10 --angles 0:90:30 --out {tmp_path}/f.sweep.json"
    )
    succeed(f"{command} --positions 20")
    first = tmp_path / "f.20.0mm.sweep.json"
    before = first.read_bytes()
    said = succeed(f"{command} --positions 20:50:30")
    # what is swept already stays as it is: a run that was cut off goes on
    assert f"{first}: exists already, made from the same inputs" in said
    assert first.read_bytes() == before
    assert [
        read_record(path, LightAngleSweep).design.indenter.position_mm for path in sorted(tmp_path.glob("*.json"))
    ] == [
        20.0,
        50.0,
    ]
    for other in ("--seed 9", "--samples 12"):
        outcome = finray(f"{command.replace('--samples 10', '')} {other} --positions 20")
        assert outcome.status == 2
        assert "f.20.0mm.sweep.json: exists already" in outcome.err
    sweeps = " ".join(map(str, sorted(tmp_path.glob("*.sweep.json"))))
    succeed(f"decide {sweeps} --weights 3,1 --criterion worst --out {tmp_path}/d.json")
    decision = read_record(tmp_path / "d.json", LightAngleDecision)
    assert [contact.weight_share for contact in decision.contacts] == [0.75, 0.25]
    assert decision.criterion == "worst"
    assert len(decision.contact_value) == 2


def test_decision_finds_the_top_and_repeats_with_its_seed(lab: Path, tmp_path: Path) -> None:
    arguments = f"decide {lab}/sweep.json --photometric-error {lab}/report.json"
    decisions = {}
    for name, seed in {"first": 3, "again": 3, "other": 4}.items():
        succeed(f"{arguments} --seed {seed} --out {tmp_path}/{name}.json")
        origin = require_valid(tmp_path / f"{name}.json")
        assert origin["input_sha256"] == {
            f"{lab}/{file}": sha256_of(lab / file) for file in ("sweep.json", "report.json")
        }
        decisions[name] = load(tmp_path / f"{name}.json")["record"] | {"provenance": None}
    assert decisions["first"] == decisions["again"]
    assert decisions["first"]["statement"] != decisions["other"]["statement"]
    assert decisions["first"]["validated"]
    assert decisions["first"]["angle_deg"] == pytest.approx(BEST_DEG, abs=2.0)


def test_encoded_images_compare_but_withhold_what_needs_linear_light(lab: Path) -> None:
    require_valid(lab / "encoded-report.json")
    report = read_record(lab / "encoded-report.json", PhotometricErrorReport)
    assert report.values == "encoded values, encoding unknown"
    assert report.objective_error is None
    assert report.withheld


@pytest.mark.shared_data
def test_imported_captures_compare_with_the_table_of_another_sensor(shared_data: Path, tmp_path: Path) -> None:
    sensors = shared_data / "tactile" / "9dtact"
    succeed(f"import 9dtact {sensors}/sensor_1 --predict-from {sensors}/sensor_2 --out {tmp_path}/one.capture.json")
    succeed(f"compare {tmp_path}/one.press.json {tmp_path}/one.capture.json --out {tmp_path}/report.json")
    for name in ("one.capture", "one.press", "report"):
        require_valid(tmp_path / f"{name}.json")
    # the published skill of this table over twice the contact radius, to its three decimals
    skill = read_record(tmp_path / "report.json", PhotometricErrorReport).headline_skill
    assert skill.estimate == pytest.approx(0.662, abs=5e-4)


def test_version_and_bare_call() -> None:
    assert succeed("--version") == f"finray {package_version()}\n"
    bare = finray("")
    assert bare.status == 2
    assert "Start with: finray demo" in bare.out
    assert bare.err == ""


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_explains_itself(name: str) -> None:
    verbs = ArgumentParser().add_subparsers()
    VERBS[name](verbs)
    described = verbs.choices[name].description
    said = succeed(f"{name} --help")
    assert said.startswith(f"usage: finray {name} ")
    assert described
    assert " ".join(described.split()) in " ".join(said.split())
    assert re.search(rf"^    {name}\b", succeed("--help"), flags=re.MULTILINE)


def test_what_windows_does_to_a_file_does_not_matter(lab: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a folder of Zoë"
    folder.mkdir()
    for name in ("plan.toml", "rig.toml"):
        text = (lab / name).read_text(encoding="utf-8").replace("\n", "\r\n")
        (folder / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    said = succeed(f"capture '{folder}/plan.toml' --rig '{folder}/rig.toml' --dry-run")
    assert said.endswith(f"next: finray capture '{folder}/plan.toml' --rig '{folder}/rig.toml'\n")
