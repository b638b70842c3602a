"""Mutations of the bytes of a file: by the structure of JSON, TOML and CSV, of arrays in archives, or byte by byte."""

import io
import json
import random
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

EXTREMES = (
    "0", "-1", "1", "-0.0", "1e-300", "1e308", "1e309", "-1e308", "9007199254740993", "99999999999999999999999", "1e6",
    "2147483648", "65536", "4294967296", "NaN", "nan", "Infinity", "-inf", "null", "true", "false", '""', '"x"', '"1"',
    "[]", "{}", "[[]]", "[1, 2]", '"\\ud800"', '"\\u0000"', '"../../etc/passwd"', '"/dev/zero"', "0.5", "-5", "3.14159",
)  # fmt: skip
_TOML_LINE = re.compile(r"^(\s*)([\w.\"-]+)(\s*=\s*)(.+?)(\s*(?:#.*)?)$", re.MULTILINE)
_TOML_TABLE = re.compile(r"^\[\[?[^\]\n]+\]\]?$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Mutation:
    """What the bytes became, of which class the change is, and in words what it was."""

    content: bytes
    kind: str
    words: str


def mutated(content: bytes, suffix: str, rng: random.Random) -> Mutation:
    """Return a mutation of a file's content: by structure in two cases of three where there is one, else bytewise."""
    structured = {
        ".json": _json, ".jsonl": _bytewise, ".toml": _toml, ".csv": _csv, ".npz": _npz, ".npy": _npy,
    }.get(suffix)  # fmt: skip
    if structured is not None and rng.random() < 2 / 3:
        try:
            return structured(content, rng)
        except (ValueError, IndexError, KeyError):
            pass
    return _bytewise(content, rng)


def _bytewise(content: bytes, rng: random.Random) -> Mutation:
    """Flip, cut, splice, zero, repeat, or overwrite a number near the beginning, where headers stand."""
    changed = bytearray(content)
    size = max(len(changed), 1)
    at = min(int(size * rng.random() ** rng.choice((1, 4))), size - 1)
    kind = rng.choice(("flips", "truncation", "splice", "zeros", "repeats", "header number", "empty", "deep nesting"))
    if kind == "flips":
        for _ in range(rng.choice((1, 1, 3, 30))):
            if changed:
                changed[int(rng.random() ** rng.choice((1, 3)) * len(changed))] ^= 1 << rng.randrange(8)
    elif kind == "truncation":
        del changed[at:]
    elif kind == "splice":
        other = rng.randrange(size)
        changed[at : at + rng.randrange(64)] = changed[other : other + rng.randrange(256)]
    elif kind == "zeros":
        length = rng.randrange(1, 256)
        changed[at : at + length] = bytes(length)
    elif kind == "repeats":
        part = changed[at : at + rng.randrange(1, 64)]
        changed[at:at] = part * rng.choice((2, 50, 5000))
    elif kind == "header number":
        width = rng.choice((1, 2, 4, 8))
        number = rng.choice((0, 1, 2 ** (8 * width) - 1, 2 ** (8 * width - 1), rng.randrange(2 ** (8 * width))))
        at = min(at, 512)
        changed[at : at + width] = number.to_bytes(width, rng.choice(("little", "big")))
    elif kind == "empty":
        changed = bytearray(
            rng.choice((b"", b"\0", b"\n", b"\xff\xfe", b"{}", b"[]", b"null", b"PK\x05\x06" + bytes(18)))
        )
    else:
        mark = rng.choice((b"[", b"{", b"(", b'{"a":', b"a: [", b"[[", b"'", b'"', b"a.", b"- ", b"&a [*a,"))
        changed = bytearray(
            rng.choice((b"", content, b"a = ", b"camera_matrix: ")) + mark * rng.choice((100, 1000, 100_000))
        )
    return Mutation(bytes(changed), kind, f"{kind} at {at} of {len(content)}")


class _Pairs(list[Any]):
    """An object whose keys may repeat."""


def _parsed(text: str) -> Any:
    return json.loads(text, object_pairs_hook=_Pairs)


def _written(value: Any) -> str:
    if isinstance(value, _Raw):
        return value.text
    if isinstance(value, _Pairs):
        return "{" + ", ".join(f"{json.dumps(k)}: {_written(v)}" for k, v in value) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_written, value)) + "]"
    return json.dumps(value)


@dataclass(frozen=True, slots=True)
class _Raw:
    text: str


def _places(value: Any, path: str = "") -> list[tuple[Any, int, str]]:
    """Return (container, index, path) of every value within a document; of long lists the first entries."""
    found = []
    for k, entry in enumerate(value[:40] if isinstance(value, list) else ()):
        name, inner = entry if isinstance(value, _Pairs) else (str(k), entry)
        found.append((value, k, f"{path}.{name}".lstrip(".")))
        found += _places(inner, f"{path}.{name}".lstrip("."))
    return found


def _json(content: bytes, rng: random.Random) -> Mutation:
    """Replace, delete, double, rename or nest one value of a JSON document."""
    document = _parsed(content.decode())
    container, k, path = rng.choice(_places(document))
    in_object = isinstance(container, _Pairs)
    value = container[k][1] if in_object else container[k]

    def put(new: Any) -> None:
        container[k] = (container[k][0], new) if in_object else new

    kind = rng.choice(
        ("extreme value", "extreme value", "other type", "deleted key", "doubled key", "renamed key", "nesting")
    )
    words = f"{path} {kind}"
    if kind == "extreme value" and isinstance(value, int | float) and not isinstance(value, bool):
        word = rng.choice(
            (
                "0",
                "-1",
                "1e-300",
                "1e308",
                "1e400",
                str(-value),
                repr(value * 1e6),
                repr(value * 1e-6),
                repr(value * 100),
            )
        )
        put(_Raw(word))
        words = f"{path}: {value!r} -> {word}"
    elif kind in ("extreme value", "other type"):
        word = rng.choice(EXTREMES)
        put(_Raw(word))
        kind = "other type"
        words = f"{path}: {_written(value)[:30]} -> {word}"
    elif kind == "deleted key":
        del container[k]
    elif kind == "doubled key":
        container.insert(k, container[k])
    elif kind == "renamed key" and in_object:
        container[k] = (container[k][0] + rng.choice(("x", "_", "\u00e9")), value)
    else:
        depth = rng.choice((70, 2000, 60_000))
        kind, words = "nesting", f"{path} nested {depth}"
        put(_Raw("[" * depth + "]" * depth))
    return Mutation(_written(document).encode(), kind, words)


def _toml(content: bytes, rng: random.Random) -> Mutation:
    """Replace, delete, double, rename or nest one line of a TOML file, or take out a table."""
    text = content.decode()
    kind = rng.choice(
        (
            "extreme value",
            "extreme value",
            "other type",
            "deleted key",
            "doubled key",
            "renamed key",
            "table",
            "nesting",
        )
    )
    line = rng.choice(list(_TOML_LINE.finditer(text)))
    key, value = line[2], line[4]
    if kind == "table":
        table = rng.choice(list(_TOML_TABLE.finditer(text)))
        end = _TOML_TABLE.search(text, table.end())
        cut = (table.start(), end.start() if end else len(text))
        doubled = rng.random() < 0.3
        new = text + "\n" + text[slice(*cut)] if doubled else text[: cut[0]] + text[cut[1] :]
        return Mutation(new.encode(), kind, f"{table[0]} {'doubled' if doubled else 'taken out'}")
    if kind == "extreme value":
        try:
            number = float(value)
            word = rng.choice(
                (
                    "0",
                    "-1",
                    "1e-300",
                    "1e308",
                    repr(-number),
                    repr(number * 1e6),
                    repr(number * 1e-6),
                    repr(number * 100),
                )
            )
        except ValueError:
            word = rng.choice(EXTREMES)
            kind = "other type"
        new = f"{line[1]}{key} = {word}"
    elif kind == "other type":
        word = rng.choice(EXTREMES)
        new = f"{line[1]}{key} = {word}"
    elif kind == "deleted key":
        word, new = "", ""
    elif kind == "doubled key":
        word, new = "twice", f"{line[0]}\n{line[0]}"
    elif kind == "renamed key":
        word, new = "renamed", f"{line[1]}{key}x{line[3]}{value}"
    else:
        depth = rng.choice((20, 2000, 60_000))
        word, new = f"nested {depth}", f"{line[1]}{key} = " + "[" * depth + "]" * depth
    changed = text[: line.start()] + new + text[line.end() :]
    return Mutation(changed.encode(), kind, f"{key}: {value[:30]} -> {word} ({kind})")


def _csv(content: bytes, rng: random.Random) -> Mutation:
    """Change one cell, row or column of a table."""
    lines = content.decode().splitlines()
    row = rng.randrange(len(lines))
    cells = lines[row].split(",")
    column = rng.randrange(len(cells))
    kind = rng.choice(("extreme value", "extreme value", "other type", "deleted key", "doubled key", "rows"))
    old = cells[column]
    if kind == "extreme value":
        words = ("0", "-1", "1e308", "1e-300", "nan", "inf", "1_0", f"{old}e6", f"-{old}", f"{old}00", "1,5")
        cells[column] = rng.choice(words)
    elif kind == "other type":
        cells[column] = rng.choice(('"', "x", "True", "", "\0", "1" * 5000, "=1+1", "\ufeff1"))
    elif kind == "deleted key":
        del cells[column]
    elif kind == "doubled key":
        cells.insert(column, old)
    else:
        lines[row:row] = [lines[row]] * rng.choice((1, 3, 20_000))
    if kind != "rows":
        lines[row] = ",".join(cells)
    return Mutation(
        ("\n".join(lines) + "\n").encode(), kind, f"line {row + 1}, {old[:20]} {kind}: {','.join(cells)[:60]}"
    )


def _npz(content: bytes, rng: random.Random) -> Mutation:
    """Change one array of an archive, or leave it out."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(members))
    how: Callable[[bytes, random.Random], Mutation] = rng.choice((_npy, _npy, _bytewise))
    change = how(members[name], rng)
    if rng.random() < 0.1:
        del members[name]
        change = Mutation(b"", "deleted key", "left out")
    else:
        members[name] = change.content
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for member, inner in members.items():
            archive.writestr(member, inner)
    return Mutation(buffer.getvalue(), change.kind, f"{name}: {change.words}")


def _npy(content: bytes, rng: random.Random) -> Mutation:
    """Give an array other numbers, another type or shape, or a header that lies."""
    array = np.load(io.BytesIO(content), allow_pickle=False)
    buffer = io.BytesIO()
    kind = rng.choice(("extreme value", "other type", "other shape", "lying header"))
    if kind == "lying header":
        shape = rng.choice(((10**12,), (2**40, 2**30), (-1,), (10**9, 3), (0,), array.shape[::-1]))
        np.lib.format.write_array_header_1_0(buffer, {"descr": array.dtype.str, "fortran_order": False, "shape": shape})
        return Mutation(buffer.getvalue() + array.tobytes(), kind, f"shape {shape}")
    if kind == "extreme value":
        changed = array.copy()
        value = rng.choice((0, -1, 255, 1e30, np.nan, np.inf))
        with np.errstate(all="ignore"):
            changed[rng.choice((slice(None), slice(0, 1)))] = (
                np.array(value).astype(array.dtype) if array.ndim else value
            )
        words = f"{value}"
    elif kind == "other type":
        dtype = rng.choice(("<f4", "<u1", ">f8", "|b1", "<U3", "<c16", "<i8"))
        changed, words = array.astype(dtype), dtype
    else:
        changed, words = array.ravel()[: array.size // 2], "half of it, flat"
    np.save(buffer, changed, allow_pickle=False)
    return Mutation(buffer.getvalue(), kind, words)
