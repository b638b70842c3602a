"""JSON for people is still JSON."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from finray_calib.exchange._paint_reradiation import readable_json

leaves = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
trees = st.recursive(leaves, lambda t: st.lists(t, max_size=4) | st.dictionaries(st.text(), t, max_size=4))


@given(st.dictionaries(st.text(), trees, max_size=5))
def test_standard_reader_reads_it_back(content):
    assert json.loads(readable_json(content)) == content


def test_a_list_of_numbers_stands_on_one_line():
    assert readable_json({"a": [[1, 2], [3, 4]], "b": [{"c": 5}]}) == (
        '{\n "a": [[1, 2], [3, 4]],\n "b": [\n  {\n   "c": 5\n  }\n ]\n}\n'
    )


def test_nan_is_refused():
    with pytest.raises(ValueError, match="not JSON compliant"):
        readable_json({"a": float("nan")})
