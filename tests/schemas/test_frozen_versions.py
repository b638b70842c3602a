"""A kind's version rises with its schema, and files of every version ever written are read, or refused with reasons."""

import hashlib
import json
import re
import shutil

import numpy as np
import pytest
from pydantic import create_model

from data_schemas import (
    AcceptanceReport,
    ChecksumError,
    DesignOptimum,
    FingerDesign,
    LightAngleDecision,
    NewerSchemaError,
    PaintCalibration,
    RecordError,
    TactileCapture,
)
from data_schemas.json_schemas import STORED, WRITTEN_BY_PEOPLE
from data_schemas.storage import read_record, read_toml, write_record
from data_schemas.storage._records import (
    LAST_UNSEALED,
    MIGRATIONS,
    NOT_MIGRATED,
    content_sha256,
    is_sealed,
)
from tests.schemas.freeze import FROZEN, ORIGIN, example_of, folder_of, normalised_schema, schema_of

ALL = (*WRITTEN_BY_PEOPLE, *STORED)
VERSIONS = [(t, v) for t in ALL for v in range(1, t.schema_version + 1)]
READ = [(t, v) for t, v in VERSIONS if (t.__name__, v) not in NOT_MIGRATED]


def name_of(value: object) -> str:
    return value.__name__ if isinstance(value, type) else f"v{value}"


def read(record_type, version):
    path = example_of(record_type, version)
    return (read_toml if record_type in WRITTEN_BY_PEOPLE else read_record)(path, record_type)


@pytest.mark.parametrize("record_type", ALL, ids=name_of)
def test_version_rises_with_the_schema(record_type):
    version = record_type.schema_version
    path = folder_of(record_type, version) / "schema.json"
    assert path.is_file(), f"version {version} is not frozen yet: python -m tests.schemas.freeze"
    assert json.loads(path.read_text(encoding="utf-8")) == schema_of(record_type), (
        f"the schema of {record_type.__name__} changed: raise its schema_version to {version + 1}, add a step to "
        "data_schemas/storage/_records.py and run python -m tests.schemas.freeze "
        "(docs/explanation/versions-of-records.md)"
    )


@pytest.mark.parametrize(("record_type", "version"), VERSIONS, ids=name_of)
def test_a_file_of_every_version_is_kept(record_type, version):
    assert example_of(record_type, version).is_file()
    if record_type in STORED:
        stored = json.loads(example_of(record_type, version).read_text(encoding="utf-8"))
        assert (stored["kind"], stored["schema_version"]) == (record_type.__name__, version)
        assert ("content_sha256" in stored) == is_sealed(record_type.__name__, version)


@pytest.mark.parametrize(("record_type", "version"), READ, ids=name_of)
def test_every_version_is_read_as_today(record_type, version, tmp_path):
    """What is read from an old file is whole: written and read again it is the same."""
    record = read(record_type, version)
    again = read_record(write_record(record, tmp_path / "again.json", ORIGIN), record_type)
    np.testing.assert_equal(again.model_dump(exclude={"provenance"}), record.model_dump(exclude={"provenance"}))


@pytest.mark.parametrize("record_type", [t for t in STORED if t.schema_version > 1], ids=name_of)
def test_migration_keeps_what_was_stored(record_type):
    """No value of the version before is lost on the way, but where a step between says so."""
    before = json.loads(example_of(record_type, record_type.schema_version - 1).read_text(encoding="utf-8"))["record"]
    step = MIGRATIONS.get((record_type.__name__, record_type.schema_version - 1))
    after = json.loads(json.dumps(before)) if step is None else step(json.loads(json.dumps(before)))
    changed = {key for key in before if after.get(key) != before[key]}
    assert changed <= CHANGED.get((record_type.__name__, record_type.schema_version - 1), set())


CHANGED: dict[tuple[str, int], set[str]] = {
    ("DesignOptimum", 3): {"parameters"},
    ("NormalMapRecord", 4): {"taught_by_sha256"},
}
"""(kind, version) -> fields that its step changes or drops on purpose."""


def test_every_step_leads_somewhere():
    kinds = {t.__name__: t.schema_version for t in ALL}
    for kind, version in (*MIGRATIONS, *NOT_MIGRATED):
        assert 1 <= version < kinds[kind]
    assert not MIGRATIONS.keys() & NOT_MIGRATED.keys()


def refusals(new, old, defs, path=""):
    """Yield what a schema refuses that an older one allows; `defs` are the parts of the new and of the old one.

    Patterns of text cannot be compared; those of drivers and spectra allowed more names with time.
    """
    new, old = (
        of["$defs"][schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
        for schema, of in zip((new, old), defs, strict=True)
    )
    choices, before = (schema.get("anyOf", schema.get("oneOf")) for schema in (new, old))
    if before is not None:
        for one in before:
            yield from refusals(new, one, defs, path)
    elif choices is not None:
        yield from min((list(refusals(one, old, defs, path)) for one in choices), key=len)
    elif "enum" in new or "const" in new:
        had, allowed = ({*schema.get("enum", ()), schema.get("const")} - {None} for schema in (old, new))
        if not had or not had <= allowed:
            yield f"{path}: {had - allowed or 'any'}"
    elif new.get("type") != old.get("type") and (new.get("type"), old.get("type")) != ("number", "integer"):
        yield f"{path}: {old.get('type')}"
    else:
        for bound, sign in BOUNDS.items():
            if bound in new and (bound not in old or sign * new[bound] > sign * old[bound]):
                yield f"{path}: {bound}"
        yield from (f"{path}.{name} is required" for name in {*new.get("required", ())} - {*old.get("required", ())})
        for name, inner in old.get("properties", {}).items():
            if name in new.get("properties", {}):
                yield from refusals(new["properties"][name], inner, defs, f"{path}.{name}")
            elif new.get("additionalProperties") is False:
                yield f"{path}.{name} is unknown"
        for key in ("items", "additionalProperties"):
            if isinstance(new.get(key), dict) and isinstance(old.get(key), dict):
                yield from refusals(new[key], old[key], defs, f"{path}[]")
        for one, other in zip(new.get("prefixItems", ()), old.get("prefixItems", ()), strict=False):
            yield from refusals(one, other, defs, f"{path}[]")


BOUNDS = {
    **dict.fromkeys(("minimum", "exclusiveMinimum", "minItems", "minLength"), 1),
    **dict.fromkeys(("maximum", "exclusiveMaximum", "maxItems", "maxLength"), -1),
}


MOVED = {("PhotometricErrorReport", 5), ("ComparisonBatch", 3)}
"""Steps to a new field of what a note or the command said before; the test of relative comparisons is below."""


@pytest.mark.parametrize(
    ("record_type", "version"),
    [(t, v) for t, v in READ if t in STORED and v < t.schema_version and (folder_of(t, v) / "schema.json").is_file()],
    ids=name_of,
)
def test_a_version_has_a_step_where_the_next_refuses_what_it_allowed(record_type, version):
    """And only there, and where a step keeps what was said elsewhere: all else is read as it is."""
    new, old = (
        json.loads((folder_of(record_type, v) / "schema.json").read_text(encoding="utf-8"))
        for v in (version + 1, version)
    )
    refused = list(refusals(new, old, (new, old)))
    key = (record_type.__name__, version)
    assert (bool(refused) or key in MOVED) == (key in MIGRATIONS), refused


def test_frozen_folders_are_those_of_the_kinds():
    assert {path.name for path in FROZEN.iterdir()} == {t.__name__ for t in ALL}
    for record_type in ALL:
        names = {path.name for path in (FROZEN / record_type.__name__).iterdir()}
        assert names == {f"v{version}" for version in range(1, record_type.schema_version + 1)}


def test_limits_that_no_rig_keeps_are_read_from_old_reports(tmp_path):
    """A limit of 0, and a relative one above 1, could be stored in version 9 and earlier."""
    stored = json.loads((FROZEN / "AcceptanceReport" / "v9" / "example.json").read_text(encoding="utf-8"))
    stored["record"]["plan"]["limits"] |= {"revisit_rel": 0.0, "read_noise_rel": 2.5, "move_s": 4.0}
    stored["content_sha256"] = content_sha256(stored)
    path = tmp_path / "check.json"
    path.write_text(json.dumps(stored), encoding="utf-8")
    report = read_record(path, AcceptanceReport)
    limits = report.plan.limits
    assert (limits.revisit_rel, limits.read_noise_rel, limits.move_s) == (1e-9, 1.0, 4.0)
    assert report.notes[-2:] == (
        "the limit revisit_rel was 0 in this report, but is read as 1e-09, the nearest allowed value",
        "the limit read_noise_rel was 2.5 in this report, but is read as 1, the nearest allowed value",
    )


@pytest.mark.parametrize(("command", "relative"), [("--relative", True), ("--rela", True), ("--register", False)])
def test_what_a_note_and_a_command_said_of_a_relative_comparison_becomes_a_field(command, relative):
    note = "compared relative to the capture's own image without contact, which stands in the place of the render's"
    assert (
        MIGRATIONS["PhotometricErrorReport", 5]({"notes": ["other", note] if relative else []})["relative"] is relative
    )
    before = {"provenance": {"command": f"finray compare a b {command}"}}
    assert MIGRATIONS["ComparisonBatch", 3](before)["relative"] is relative


def test_a_version_that_cannot_be_migrated_says_why_and_what_to_run():
    message = r"version 1 of the PaintCalibration .*draws of another model.*; run 'finray fit' again"
    with pytest.raises(RecordError, match=message):
        read_record(example_of(PaintCalibration, 1), PaintCalibration)


def test_a_new_field_is_noticed_and_a_new_word_is_not():
    """The guard can fail: the schema of a changed model differs from the frozen one."""
    field = (str, "of no use")
    changed = create_model("LightAngleDecision", __base__=LightAngleDecision, weather=field)
    frozen = json.loads((folder_of(LightAngleDecision, LightAngleDecision.schema_version) / "schema.json").read_text())
    assert schema_of(changed) != frozen
    described = create_model("LightAngleDecision", __base__=LightAngleDecision, __doc__="Other words.")
    assert schema_of(described) == frozen


def test_another_default_counts_only_where_people_write():
    changed = create_model("FingerDesign", __base__=FingerDesign, name=(str, "another finger")).model_json_schema()
    before = FingerDesign.model_json_schema()
    assert normalised_schema(changed, by_people=True) != normalised_schema(before, by_people=True)
    assert normalised_schema(changed, by_people=False) == normalised_schema(before, by_people=False)


def test_a_step_is_applied_in_sequence(tmp_path, monkeypatch):
    """Two steps of a kind that was renamed and rescaled on the way: seconds from milliseconds, source from origin."""

    class Three(TactileCapture):
        schema_version = 3

    Three.__name__ = "TactileCapture"
    monkeypatch.setitem(
        MIGRATIONS,
        ("TactileCapture", 1),
        lambda body: {k: v for k, v in body.items() if k != "exposure_ms"} | {"exposure_s": body["exposure_ms"] / 1e3},
    )
    monkeypatch.setitem(
        MIGRATIONS,
        ("TactileCapture", 2),
        lambda body: {k: v for k, v in body.items() if k != "origin"} | {"source": body["origin"]},
    )
    stored = json.loads(example_of(TactileCapture, 1).read_text())
    record = stored["record"]
    wanted = (record["exposure_s"], record["source"])
    record["exposure_ms"], record["origin"] = 1e3 * record.pop("exposure_s"), record.pop("source")
    for path in folder_of(TactileCapture, 1).glob("*.npz"):
        shutil.copy(path, tmp_path)
    path = tmp_path / "old.json"
    path.write_text(json.dumps(stored))
    migrated = read_record(path, Three)
    assert (migrated.exposure_s, migrated.source) == (pytest.approx(wanted[0]), wanted[1])
    del record["exposure_ms"]
    path.write_text(json.dumps(stored))
    with pytest.raises(RecordError, match=r"old.json: cannot be read as version 1 of the TactileCapture .*exposure_ms"):
        read_record(path, Three)


class TestFilesPeopleWrite:
    @pytest.fixture
    def text(self) -> str:
        return example_of(FingerDesign, 1).read_text()

    def test_names_its_version(self, text, tmp_path):
        path = tmp_path / "finger.toml"
        path.write_text(f"schema_version = 1\n{text}")
        assert read_toml(path, FingerDesign) == read_toml(example_of(FingerDesign, 1), FingerDesign)

    def test_of_a_newer_version(self, text, tmp_path):
        path = tmp_path / "finger.toml"
        path.write_text(f"schema_version = 9\n{text}\n[feather]\ncolour = 'blue'\n")
        with pytest.raises(NewerSchemaError, match=r"finger.toml: schema_version 9 .*pip install -U finray-calib"):
            read_toml(path, FingerDesign)

    @pytest.mark.parametrize("version", ["true", "1.0", "'1'", "0"])
    def test_nonsense(self, text, tmp_path, version):
        path = tmp_path / "finger.toml"
        path.write_text(f"schema_version = {version}\n{text}")
        with pytest.raises(RecordError, match="whole number from 1"):
            read_toml(path, FingerDesign)


class TestSeal:
    """Every value of a stored record is under its seal."""

    @pytest.fixture
    def stored(self, tmp_path):
        record = read_record(example_of(LightAngleDecision, 1), LightAngleDecision)
        return write_record(record, tmp_path / "decision.json", ORIGIN)

    @pytest.mark.parametrize(
        ("old", "new"),
        [
            (r'"angle_deg": ([0-9.]+)', r'"angle_deg": 1\1'),
            (r'"schema_version": \d+', '"schema_version": 1'),
            (r'"seed": 1', '"seed": 2'),
            (r'"array_file": null', '"array_file": {"file": "x.npz", "sha256": "' + "0" * 64 + '"}'),
            (r'"content_sha256": "."?', '"content_sha256": "x'),
            (r',\s*"content_sha256": "[0-9a-f]+"', ""),
        ],
    )
    def test_a_change_is_noticed(self, stored, old, new):
        text, count = re.subn(old, new, stored.read_text(), count=1)
        assert count == 1
        stored.write_text(text)
        with pytest.raises(
            ChecksumError, match=r"decision.json: .*seal .*changed after it was written; .*finray decide"
        ):
            read_record(stored, LightAngleDecision)

    def test_layout_is_no_change(self, stored):
        before = read_record(stored, LightAngleDecision)
        envelope = json.loads(stored.read_text())
        stored.write_text(json.dumps(dict(reversed(envelope.items()))))
        assert read_record(stored, LightAngleDecision).model_dump_json() == before.model_dump_json()

    def test_canonical_form_by_another_route(self, stored):
        """As docs/explanation/versions-of-records.md states it, without our function."""
        envelope = json.loads(stored.read_text())
        seal = envelope.pop("content_sha256")
        text = json.dumps(envelope, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        assert hashlib.sha256(text.encode()).hexdigest() == seal == content_sha256(envelope)

    def test_files_before_seals_have_none(self):
        assert {t.__name__ for t in STORED if LAST_UNSEALED.get(t.__name__, 0) > 0} == set(LAST_UNSEALED)


def test_an_old_file_that_does_not_fit_names_the_commit_that_wrote_it(tmp_path):
    stored = json.loads(example_of(LightAngleDecision, 1).read_text())
    stored["record"]["tolerance"] = stored["record"].pop("tolerance_rel")
    path = tmp_path / "old.json"
    path.write_text(json.dumps(stored))
    with pytest.raises(
        RecordError,
        match=r"Earlier versions of finray stored different schemas as version 1; .* written by "
        r"commit 8ef2b25",
    ):
        read_record(path, LightAngleDecision)


def test_what_has_another_name_is_kept():
    """`is_whole` and `taught_by_sha256` of earlier files are read under the names of today."""
    search = json.loads(example_of(DesignOptimum, 3).read_text(encoding="utf-8"))["record"]
    search["parameters"][0]["is_whole"] = True
    found = MIGRATIONS["DesignOptimum", 3](search)["parameters"]
    assert [one["is_integer"] for one in found] == [True, *(False for _ in found[1:])]
    assert not any("is_whole" in one for one in found)
    known = {"taught_by_sha256": ["0" * 64], "seed": 1}
    assert MIGRATIONS["NormalMapRecord", 4](known) == {"training_sha256": ["0" * 64], "seed": 1}
