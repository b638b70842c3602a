"""The door of foreign bytes: what it lets in, what it refuses, and that it never waits."""

import hashlib
import io
import os
import socket
import threading
import time
import tracemalloc
import zipfile

import numpy as np
import pytest

from data_schemas import CurveError, RecordError
from data_schemas.storage import (
    digest_as_read,
    finite_number,
    parse_json,
    read_bytes,
    read_csv,
    read_json,
    read_npy,
    read_npz,
    read_text,
)
from data_schemas.storage._array_files import DeclaredArray, read_declared_arrays
from data_schemas.storage._foreign_files import parse_toml


def test_only_regular_files_are_read_and_nothing_waits(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        started = time.monotonic()
        for name, kind in (("pipe", "a named pipe"), ("socket", "a socket"), (".", "a folder")):
            with pytest.raises(CurveError, match=f"is {kind}; give the path of a curve"):
                read_bytes(tmp_path / name, "a curve", CurveError)
        with pytest.raises(RecordError, match="/dev/zero: is a device"):
            read_bytes(tmp_path.joinpath("/dev/zero"))
        assert time.monotonic() - started < 5.0
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    with pytest.raises(RecordError, match="is a named pipe"):
        read_bytes(tmp_path / "link")
    for name in ("nothing", "pipe/inside", "nothing/inside"):
        with pytest.raises(RecordError, match="no such file"):
            read_bytes(tmp_path / name)
    with pytest.raises(RecordError, match="null byte"):
        read_bytes(tmp_path / "a\0b")


def test_length_is_checked_before_and_while_reading(tmp_path):
    sparse = tmp_path / "sparse"
    with sparse.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(RecordError, match=r"is too long; at most 1073741824 bytes \(1.02e\+03 MB\)"):
        read_bytes(sparse)
    (tmp_path / "five").write_bytes(b"12345")
    assert read_bytes(tmp_path / "five", largest_bytes=5) == b"12345"
    with pytest.raises(RecordError, match="is too long; at most 4 bytes"):
        read_bytes(tmp_path / "five", largest_bytes=4)
    (tmp_path / "nothing").write_bytes(b"")
    tracemalloc.start()
    assert read_bytes(tmp_path / "nothing", largest_bytes=1 << 40) == b""
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    # its size says 0 although it holds something
    assert read_text(tmp_path.joinpath("/proc/self/status")).startswith("Name:")


def test_digest_is_that_of_the_bytes_that_were_read(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"[1]")
    (tmp_path / "link.json").symlink_to(path)
    assert digest_as_read(path) is None
    assert read_json(tmp_path / "link.json") == [1]
    path.write_bytes(b"[2]")
    first = hashlib.sha256(b"[1]").hexdigest()
    assert digest_as_read(path) == digest_as_read(tmp_path / "link.json") == first
    (tmp_path / "link.json").unlink()
    assert digest_as_read(tmp_path / "link.json") == first
    read_json(path)
    assert digest_as_read(path) == hashlib.sha256(b"[2]").hexdigest()


def test_digests_may_be_asked_from_many_threads(tmp_path):
    files = [tmp_path / f"{k}" for k in range(40)]
    for file in files:
        file.write_text(file.name)
    threads = [
        threading.Thread(target=lambda part: [read_bytes(f) for f in part], args=(files[k::4],)) for k in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [digest_as_read(f) for f in files] == [hashlib.sha256(f.name.encode()).hexdigest() for f in files]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"a": 1, "a": 2}', "the key 'a' occurs twice"),
        (b'{"b": {"a": 1, "c": 0, "a": 1}}', "the key 'a' occurs twice"),
        (b"[NaN]", "NaN is not a number; write null for a missing value"),
        (b"[-Infinity]", "-Infinity is not a number"),
        (b"[1e400]", "the number 1e400 is too large"),
        (b"[" + b"9" * 5000 + b"]", "the whole number 9+ is too large"),
        (b"[18446744073709551617]", "too large"),
        (b"[" * 100_000, "lists or objects are nested more than 64 deep"),
        (b"[" * 100_000 + b"]" * 100_000, "lists or objects are nested more than 64 deep"),
        (b'{"a":' * 70 + b"0" + b"}" * 70, "lists or objects are nested more than 64 deep"),
        (b"[" + b"0," * 2_000_001 + b"0]", "more than 2000000 values"),
        (b'["\\ud800"]', "an incomplete character"),
        (b'{"\\udfff": 1}', "an incomplete character"),
        (b"\xff", "cannot be read as JSON"),
        (b"", "cannot be read as JSON"),
        (b"{", "cannot be read as JSON"),
    ],
    ids=range(16),
)
def test_json_that_is_refused(content, message):
    with pytest.raises(RecordError, match=message):
        parse_json(content, "a.json")


def test_json_that_is_read():
    brackets = b"[" * 5000
    text = b'{"a": [1, 2.5, -3e-5, null, true], "b": "' + brackets + b' \\" [", "c": "\\ud83d\\ude00"}'
    assert parse_json(text, "x") == {
        "a": [1, 2.5, -3e-5, None, True],
        "b": brackets.decode() + ' " [',
        "c": "\U0001f600",
    }
    deep = b"[" * 64 + b"]" * 64
    assert parse_json(deep, "x") is not None


@pytest.mark.parametrize(
    "content", [b'"' + b'\\"' * 2_000_000, b'["' * 1_000_000, b"\\" * 4_000_000], ids=("quotes", "open", "back")
)
def test_json_that_is_long_is_refused_in_a_time_that_grows_with_its_length(content):
    started = time.process_time()
    with pytest.raises(RecordError):
        parse_json(b"[" * 100 + content, "x")
    assert time.process_time() - started < 5.0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a = nan", "nan is not a finite number"),
        (b"a = [1.0, -inf]", "-inf is not a finite number"),
        (b"a = 1e999", "inf is not a finite number"),
        (b"a = 99999999999999999999999", "too large"),
        (b"a = 1\na = 2", "cannot be read as TOML"),
        (b"a = " + b"[" * 1000, "lists or tables are nested more than 16 deep; flatten"),
        (b"a = " + b"{b = " * 1000, "lists or tables are nested more than 16 deep; flatten"),
        (b".".join([b"a"] * 1000) + b" = 1", "a key has more than 16 parts"),
        (b" . ".join([b'"a"'] * 1000) + b" = 1", "a key has more than 16 parts"),
        (b"a = \xff", "cannot be read as TOML"),
    ],
    ids=range(10),
)
def test_toml_that_is_refused(content, message):
    with pytest.raises(RecordError, match=message):
        parse_toml(content, "a.toml")


def test_toml_that_is_read():
    text = b"""# [[[[[[[[[[[[[[[[[[[[[
a = "[[[[[[[[[[[[[[[[[[[["
b = '{{{{{{{{{{{{{{{{{{{{'
c = '''[[[[[[[[[[[[[[[[[[[[
'''
d = \"\"\"[[[[[[[[[[[[[[[[[[ \\" a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r
\"\"\"
[e.f]
g = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
"""
    assert parse_toml(text, "x")["e"]["f"]["g"][-1] == 0.8


@pytest.mark.parametrize(
    "content", [b"a" * 1_000_000, b"a." * 500_000, b"'" * 999_999, b'"""' * 333_333, b'"\\"' * 300_000]
)
def test_toml_of_a_million_characters_is_refused_soon(content):
    started = time.process_time()
    with pytest.raises(RecordError):
        parse_toml(content, "x")
    assert time.process_time() - started < 5.0


def test_numbers_are_decimal_and_finite():
    assert [finite_number(t) for t in (" 1", "-.5", "2.", "+1e-3", "1.5E+3")] == [1.0, -0.5, 2.0, 1e-3, 1500.0]
    for text in ("", "nan", "inf", "1_000", "0x10", "1e999", "1,5", "True", "\u0663", "--1", "1 2"):
        with pytest.raises(ValueError, match="is not a finite number"):
            finite_number(text)


def test_csv(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b'\xef\xbb\xbfa, b\r\n1,2\r\n\r\n"3\n4",5\n')
    assert read_csv(path) == (["a", "b"], [(2, ["1", "2"]), (5, ["3\n4", "5"])])
    path.write_text("a,a\n1,2\n")
    with pytest.raises(RecordError, match="the column 'a' occurs twice"):
        read_csv(path)
    path.write_text('a,b\n"1,2\n')
    with pytest.raises(RecordError, match="cannot be read as CSV"):
        read_csv(path)
    path.write_text("a,b\n" + "1," * 5000)
    with pytest.raises(RecordError, match="line 2: the table is too large, because at most 4096 columns"):
        read_csv(path)
    path.write_text("a,b\n1,2,\n1,5,2\n")
    with pytest.raises(
        RecordError, match=r"line 3: has 3 columns, but the header has 2; .* write decimals with a point"
    ):
        read_csv(path)
    path.write_text("a" * 200_000)
    with pytest.raises(RecordError, match="cannot be read as CSV"):
        read_csv(path)


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def test_arrays_are_read_as_they_are_declared():
    values = np.arange(6.0).reshape(2, 3)
    content = npz(a=values, b=np.asfortranarray(values), c=np.array([True, False]), d=np.zeros((0, 3)))
    declared = {
        "a": DeclaredArray((2, 3), "<f8"),
        "b": DeclaredArray((2, 3), "<f8"),
        "c": DeclaredArray((2,), "|b1"),
        "d": DeclaredArray((0, 3), "<f8"),
    }
    found = read_declared_arrays(content, declared, "x.npz")
    assert (found["a"] == values).all()
    assert (found["b"] == values).all()
    assert found["c"].tolist() == [True, False]
    assert found["d"].shape == (0, 3)
    assert not any(array.flags.writeable for array in found.values() if array.size)
    # what is not declared is not even looked at
    broken = bytearray(content)
    at = content.index(b"\x93NUMPY", content.index(b"b.npy"))
    broken[at : at + 6] = b"broken"
    assert read_declared_arrays(bytes(broken), {"a": declared["a"]}, "x.npz").keys() == {"a"}
    with pytest.raises(RecordError, match="cannot be read as numpy arrays"):
        read_declared_arrays(bytes(broken), declared, "x.npz")


@pytest.mark.parametrize(
    ("name", "shape", "dtype", "message"),
    [
        ("a", (3, 2), "<f8", "is <f8 of shape .2, 3., but the record declares <f8 of shape .3, 2."),
        ("a", (2, 3), "<f4", "the record declares <f4"),
        ("z", (2, 3), "<f8", "array 'z' is missing"),
    ],
)
def test_arrays_that_are_not_as_declared(name, shape, dtype, message):
    with pytest.raises(RecordError, match=message):
        read_declared_arrays(npz(a=np.zeros((2, 3))), {name: DeclaredArray(shape, dtype)}, "x.npz")


def header_only(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": dtype, "fortran_order": False, "shape": shape})
    return buffer.getvalue()


def test_an_array_that_promises_more_than_there_is_takes_no_memory(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(header_only((10**7, 10**5)))
    bomb = tmp_path / "a.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as member:
        member.write(header_only((64, 1 << 20)))
        for _ in range(64):
            member.write(bytes(8 << 20))
    assert bomb.stat().st_size < 1 << 20
    tracemalloc.start()
    with pytest.raises(RecordError, match="does not have the number of bytes"):
        read_npy(path)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("a.npy", path.read_bytes())
    with pytest.raises(RecordError, match="but at most 512 MB are allowed"):
        read_npz(tmp_path / "b.npz")
    with zipfile.ZipFile(tmp_path / "c.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header_only((100,)) + bytes(100))
    with pytest.raises(RecordError, match="does not have the number of bytes"):
        read_npz(tmp_path / "c.npz")
    declared = {"a": DeclaredArray((64, 1 << 20), "<f8")}
    with pytest.raises(RecordError, match="array 'a' is compressed"):
        read_declared_arrays(bomb.read_bytes(), declared, bomb)
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


def test_pickles_are_told_apart_and_never_loaded(tmp_path):
    path = tmp_path / "a.npz"
    path.write_bytes(npz(a=np.arange(3), b=np.array([{}], dtype=object), c=np.array(["text"])))
    arrays, pickled = read_npz(path)
    assert arrays.keys() == {"a"}
    assert pickled == ("b",)
    np.save(tmp_path / "b.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(RecordError, match="pickled"):
        read_npy(tmp_path / "b.npy")
