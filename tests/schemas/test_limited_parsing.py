"""A parser in a child process: what it returns, and its death as one sentence that names the file."""

import numpy as np
import pytest

from data_schemas import CurveError, ImportFormatError
from data_schemas.storage import _array_files as limited_parsing
from data_schemas.storage import parse_in_child
from data_schemas.storage._array_files import end_child
from tests.schemas import dying_parsers, large_parser


@pytest.fixture(autouse=True)
def _no_child_is_left():
    yield
    end_child()


def parse(name, content=b"abc"):
    return parse_in_child(f"{dying_parsers.__name__}:{name}", content, "x.dng", "DNG", CurveError)


def test_arrays_and_values_come_back_and_the_child_serves_the_next_file():
    value, arrays = parse("whole")
    assert value["where"] == "x.dng"
    assert arrays["a b/c"].tobytes() == b"abc"
    np.testing.assert_array_equal(arrays["d"], np.eye(3))
    assert parse("whole")[0]["pid"] == value["pid"]


def test_what_a_parser_refuses_is_its_own_error():
    with pytest.raises(ImportFormatError, match=r"^x\.dng: holds abc$"):
        parse("refusing")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("crashing", r"because the parser was ended by SIGSEGV .*; the file is corrupted"),
        ("hanging", r"because the parser took longer than 1 s.*; try again when the computer is less busy"),
        ("filling", r"because the parser ran out of memory"),
    ],
)
def test_a_death_is_one_sentence_and_the_next_file_is_read(monkeypatch, name, words):
    if name == "hanging":
        monkeypatch.setattr(limited_parsing, "LONGEST_PARSING_S", 1.0)
    with pytest.raises(CurveError, match=rf"^x\.dng: cannot be read as DNG, {words}"):
        parse(name)
    monkeypatch.undo()
    assert parse("whole")[0]["where"] == "x.dng"


def test_what_a_parser_is_made_of_does_not_count_as_memory_of_the_file():
    assert parse_in_child(f"{large_parser.__name__}:parsed", b"", "x.mp4", "a video")[0] == 300 << 20
