"""The committed JSON Schema files are those of the models, and stored records validate against them."""

import json

import jsonschema
import numpy as np
import pytest

from data_schemas import provenance
from data_schemas.json_schemas import FOLDER, STORED, WRITTEN_BY_PEOPLE, json_schema, schema_text
from data_schemas.storage import write_record
from tests.schemas.test_storage import capture


@pytest.mark.parametrize("record_type", [*WRITTEN_BY_PEOPLE, *STORED], ids=lambda t: t.__name__)
def test_schema_file_is_current(record_type):
    path = FOLDER / f"{record_type.__name__}.schema.json"
    assert path.read_text(encoding="utf-8") == schema_text(record_type), "run 'make schemas' and commit the result"


def test_no_schema_file_is_left_over():
    assert {p.name for p in FOLDER.iterdir()} == {f"{t.__name__}.schema.json" for t in (*WRITTEN_BY_PEOPLE, *STORED)}


@pytest.mark.parametrize("size", [4, 40])
def test_stored_record_validates(tmp_path, size):
    record = capture(np.ones((size, size, 1), np.uint16))
    path = write_record(record, tmp_path / "press.json", provenance("pytest"))
    assert jsonschema.Draft202012Validator(json_schema(type(record))).is_valid(json.loads(path.read_text()))


def test_schema_refuses_a_wrong_record(tmp_path):
    record = capture(np.ones((4, 4, 1), np.uint16))
    stored = json.loads(write_record(record, tmp_path / "press.json", provenance("pytest")).read_text())
    stored["record"]["exposure_ms"] = 5
    with pytest.raises(jsonschema.ValidationError, match="exposure_ms"):
        jsonschema.Draft202012Validator(json_schema(type(record))).validate(stored)
