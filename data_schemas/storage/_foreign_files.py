"""The door through which the bytes of every file come in: checked before they are parsed, hashed as they are read.

Every reader of the packages takes its bytes from :func:`read_bytes` or :func:`open_regular`. These take regular files
only, so that a named pipe or a device never hangs a command, and no more bytes than such a file can rightly have. The
SHA-256 of what was read is remembered: :func:`digest_as_read` gives provenance the checksum of the bytes that were
parsed, whatever happens to the file afterwards.

A path may lead into a zip archive, ``set.zip/one.capture.json``, which is read as a folder is: :func:`folder_at`,
:func:`has_file` and :func:`files_below` take both.

The parsers here are strict: no key twice, finite numbers only, limits of depth and count before anything is built.
Arrays and images are read by :mod:`data_schemas.storage._array_files`.
"""

import csv
import errno
import hashlib
import io
import json
import math
import os
import re
import stat
import threading
import tomllib
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from data_schemas import FinrayError, RecordError
from data_schemas.storage._zip_archives import ENDING as ZIP_ENDING
from data_schemas.storage._zip_archives import ZipArchive

MB: Final = 1 << 20
LARGEST_TEXT_BYTES: Final = 64 * MB
"""Of a file that people or programs write as text: JSON, CSV."""
LARGEST_TOML_BYTES: Final = MB
"""More than a person writes."""
LARGEST_IMAGE_BYTES: Final = 1024 * MB
LARGEST_ARRAY_FILE_BYTES: Final = 8192 * MB
DEEPEST_JSON: Final = 64
DEEPEST_TOML: Final = 16
MOST_VALUES: Final = 2_000_000
MOST_COLUMNS: Final = 4096
LONGEST_WHOLE_NUMBER: Final = 2**64

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
# Possessive, and content with a missing end quote: linear in the length whatever it holds.
_JSON_TOKEN = re.compile(rb'"(?:[^"\\]|\\.)*+"?|[\[\]{},]', re.DOTALL)
_TOML_WORDS = re.compile(
    r"""
    \"{3} (?:[^\\"]|\\.|"(?!""))*+ (?:\"{3})?
    | '{3} (?:[^']|'(?!''))*+ (?:'{3})?
    | " (?:[^"\\\n]|\\.)*+ "?
    | ' [^'\n]*+ '?
    | \#[^\n]*+
    """,
    re.DOTALL | re.VERBOSE,
)
_TOML_CHAIN = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST_TOML}}}")
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_POINT_NUMBER = re.compile(r"^\s*[+-]?\d*\.\d+(?:[eE][+-]?\d+)?\s*$")
_SEPARATOR_LINE = re.compile(r"(?i)\A\s*sep=[,;\t]\r?\n")  # by which a spreadsheet is told what separates columns
_COMMA_NUMBER = re.compile(r"^(\s*[+-]?\d+),(\d+(?:[eE][+-]?\d+)?\s*)$")
_GROUPED = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")
_SURROGATE = re.compile("[\ud800-\udfff]")


class _Digests:
    """SHA-256 of files as they were last read, by absolute path and by the path behind links; any thread may ask."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_path: dict[str, str] = {}

    def remember(self, path: Path, digest: str) -> None:
        names = {os.path.abspath(path), os.path.realpath(path)}
        with self._lock:
            self._by_path.update(dict.fromkeys(names, digest))

    def of(self, path: Path) -> str | None:
        with self._lock:
            return self._by_path.get(os.path.abspath(path)) or self._by_path.get(os.path.realpath(path))


_AS_READ = _Digests()


def digest_as_read(path: Path) -> str | None:
    """Return the SHA-256 (64 hex digits) of a file's bytes as this program last read them; None if it read none."""
    return _AS_READ.of(path)


def open_regular(path: Path, what: str = "a regular file", error: type[FinrayError] = RecordError) -> io.BufferedReader:
    """Open a regular file for reading, without ever waiting for a pipe or a device.

    Parameters
    ----------
    path
        File; a link to one is followed.
    what
        What should lie there, for messages: "a stored record (.json)".
    error
        Class of the error.

    Raises
    ------
    FinrayError
        Of the class `error`: there is nothing, or no regular file, or it may not be read.
    """
    if (member := _member_at(path, error)) is not None:
        return io.BufferedReader(io.BytesIO(member.read(what, error, LARGEST_ARRAY_FILE_BYTES)))
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except FileNotFoundError:
        raise error(f"{path}: no such file; give the path of {what}") from None
    except NotADirectoryError:
        raise error(
            f"{path}: no such file, because a part of the path is a file and not a folder; give the path of {what}"
        ) from None
    except (OSError, ValueError) as fault:
        kind = _kind_at(path)
        if kind is not None:
            raise error(f"{path}: is {kind}; give the path of {what}") from None
        reason = (
            fault.strerror if isinstance(fault, OSError) else "it contains a null byte" if "\0" in str(path) else fault
        )
        raise error(f"{str(path)!r}: cannot be read ({reason}); check the path and its permissions") from None
    kind = _kind_of(os.fstat(handle).st_mode)
    if kind is not None:
        os.close(handle)
        raise error(f"{path}: is {kind}; give the path of {what}")
    return os.fdopen(handle, "rb")


def read_bytes(
    path: Path,
    what: str = "a regular file",
    error: type[FinrayError] = RecordError,
    largest_bytes: int = LARGEST_IMAGE_BYTES,
) -> bytes:
    """Return the bytes of a regular file and remember their SHA-256 for :func:`digest_as_read`.

    Parameters
    ----------
    path
        File; a link to one is followed.
    what
        What should lie there, for messages: "a stored record (.json)".
    error
        Class of the error.
    largest_bytes
        Longer files are refused before they are read.

    Raises
    ------
    FinrayError
        Of the class `error`: there is nothing, or no regular file, it is too long, or may not be read.
    """
    size = 0
    try:
        if (member := _member_at(path, error)) is not None:
            size = member.size
            content = member.read(what, error, largest_bytes)
            _AS_READ.remember(path, hashlib.sha256(content).hexdigest())
            return content
        with open_regular(path, what, error) as file:
            size = os.fstat(file.fileno()).st_size
            content = file.read(size + 1) if size <= largest_bytes else b""
            # a file of a pseudo file system says 0 and may have no end, and any file may grow while it is read
            while size < len(content) <= largest_bytes and (more := file.read(MB)):
                content += more
    except OSError as fault:
        raise error(f"{path}: cannot be read ({fault.strerror}); check the file and the disk that it is on") from None
    except MemoryError:
        raise error(f"{path}: has {size / MB:.4g} MB, more than the free memory; close other programs") from None
    if max(size, len(content)) > largest_bytes:
        raise error(_too_long(path, what, largest_bytes))
    _AS_READ.remember(path, hashlib.sha256(content).hexdigest())
    return content


def _too_long(path: Path, what: str, largest_bytes: int) -> str:
    """Return that a file is too long."""
    return (
        f"{path}: is too long; at most {largest_bytes} bytes ({largest_bytes / MB:.3g} MB) are read as "
        f"{what.removeprefix('the path of ')}. Give the right file"
    )


class _Member(NamedTuple):
    """A place in a zip archive: a file, a folder, or nothing.

    Attributes
    ----------
    path
        As it was given.
    file
        The archive's file.
    archive
        Its list of files.
    name
        Within it; "" is the archive itself.
    """

    path: Path
    file: Path
    archive: ZipArchive
    name: str

    @property
    def size(self) -> int:
        """Size of the file, bytes; 0 where there is none."""
        return self.archive.size(self.name) if self.name in self.archive else 0

    def read(self, what: str, error: type[FinrayError], largest_bytes: int) -> bytes:
        """Return the bytes of the file."""
        if self.name not in self.archive:
            raise error(f"{self.path}: no such file in the archive; give the path of {what}")
        if self.size > largest_bytes:
            raise error(_too_long(self.path, what, largest_bytes))
        try:
            with open_regular(self.file, "a zip archive", error) as file:
                return self.archive.read(self.name, file)
        except ValueError as fault:
            raise error(f"{self.path}: {fault}; create the archive again, or download it again") from None


class _Archives:
    """Lists of files of the last few zip archives as they are now: of many files each is read once."""

    MOST_KEPT = 4

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[tuple[int, int, int, int], ZipArchive] = {}

    def at(self, path: Path, error: type[FinrayError]) -> ZipArchive:
        with self._lock:
            found = os.stat(path)
            key = (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)
            archive = self._kept.pop(key, None)
            if archive is None:
                with open_regular(path, "a zip archive", error) as file:
                    try:
                        archive = ZipArchive(file)
                    except ValueError as fault:
                        raise error(f"{path}: {fault}") from None
            self._kept[key] = archive
            while len(self._kept) > self.MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            return archive


_ARCHIVES = _Archives()


def _member_at(path: Path, error: type[FinrayError] = RecordError) -> _Member | None:
    """Return the place in a zip archive that a path leads to; None where it leads into none."""
    if ZIP_ENDING not in os.fspath(path.parent).lower():
        return None
    for above in path.parents:
        if above.suffix.lower() == ZIP_ENDING and above.is_file():
            return _Member(path, above, _ARCHIVES.at(above, error), path.relative_to(above).as_posix())
    return None


def folder_at(path: Path, error: type[FinrayError] = RecordError) -> Path | None:
    """Return the folder of files that a path names: a folder, one in a zip archive, or the archive itself.

    Parameters
    ----------
    path
        Folder, archive (``set.zip``) or a folder in it (``set.zip/part``).
    error
        Class of the error.

    Returns
    -------
    Path or None
        The path; of an archive that holds nothing but one folder, that folder. None where it is not a folder.

    Raises
    ------
    FinrayError
        Of the class `error`: a zip archive is not accepted.
    """
    if path.is_dir():
        return path
    if path.suffix.lower() == ZIP_ENDING and path.is_file():
        top = _ARCHIVES.at(path, error).top
        return path / top if top else path
    member = _member_at(path, error)
    return path if member is not None and member.name in member.archive.folders else None


def has_file(path: Path) -> bool:
    """Return whether a path names a regular file, on the disk or in a zip archive."""
    try:
        return path.is_file() or ((member := _member_at(path)) is not None and member.name in member.archive)
    except OSError as fault:
        if fault.errno == errno.ENAMETOOLONG:
            return False
        raise


def files_below(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder and of all folders in it, hidden ones as well; of a zip archive sorted by name.

    Parameters
    ----------
    folder
        What :func:`folder_at` returned.
    """
    if folder.is_dir():
        yield from (path for path in folder.rglob("*") if path.is_file())
        return
    if (at := _member_at(folder / "any")) is not None:
        above = at.name.removesuffix("any")
        yield from (folder / name.removeprefix(above) for name in at.archive.names if name.startswith(above))


def files_in(folder: Path, ending: str = "") -> list[Path]:
    """Return the files that lie in a folder or zip archive itself and whose names end so, sorted."""
    inside = folder.iterdir() if folder.is_dir() else files_below(folder)
    return sorted(path for path in inside if path.parent == folder and path.name.endswith(ending) and has_file(path))


def read_text(
    path: Path, what: str = "a text file", error: type[FinrayError] = RecordError, encoding: str = "utf-8"
) -> str:
    """Return the text of a regular file; see :func:`read_bytes`.

    Raises
    ------
    FinrayError
        Of the class `error`: as :func:`read_bytes`, or the bytes are not text of this encoding.
    """
    try:
        return read_bytes(path, what, error, LARGEST_TEXT_BYTES).decode(encoding)
    except UnicodeDecodeError as fault:
        raise error(
            f"{path}: cannot be read as {encoding.upper().removesuffix('-SIG')} text ({fault}); give {what}, saved as "
            "UTF-8 (in Windows, choose the encoding under 'Save as')"
        ) from None


def parse_json(
    content: bytes,
    where: object,
    error: type[FinrayError] = RecordError,
    what: str = "",
    *,
    any_number: bool = False,
) -> Any:
    """Parse JSON: no key twice, no NaN and no infinite number, no half characters, at most :data:`DEEPEST_JSON` levels.

    Parameters
    ----------
    content
        UTF-8.
    where
        File or device it came from, for messages.
    error
        Class of the error.
    what
        What to give in its place, such as "a stored record (.json)", for the error about a file that is no JSON.
    any_number
        NaN and infinite numbers are read: the caller says what they mean in files that others wrote.

    Raises
    ------
    FinrayError
        Of the class `error`: it is no such JSON.
    """
    try:
        _require_shallow_json(content)
        text = content.decode("utf-8")
        parsed = json.loads(
            text,
            object_pairs_hook=_object_without_repeats,
            parse_constant=float if any_number else _refuse_constant,
            parse_float=float if any_number else _finite,
            parse_int=_whole,
        )
        if b"\\u" in content:
            _refuse_half_characters(parsed)
    except (ValueError, RecursionError) as fault:
        is_json = content.lstrip()[:1] in (b"{", b"[")
        give = f"; give the path of {what}" if what else ""
        mend = (
            "the file was edited or cut off, so restore it, or make it again"
            if is_json
            else f"the file {'does not begin with { or [' if content.strip() else 'is empty'}{give}"
        )
        raise error(f"{where}: cannot be read as JSON ({fault}); {mend}") from None
    return parsed


def read_json(
    path: Path, what: str = "a JSON file", error: type[FinrayError] = RecordError, *, any_number: bool = False
) -> Any:
    """Read a JSON file; see :func:`read_bytes` and :func:`parse_json`."""
    return parse_json(read_bytes(path, what, error, LARGEST_TEXT_BYTES), path, error, what, any_number=any_number)


def parse_toml(content: bytes, where: object, error: type[FinrayError] = RecordError) -> dict[str, Any]:
    """Parse TOML: no NaN and no infinite number, at most :data:`DEEPEST_TOML` levels, no longer than a person writes.

    Raises
    ------
    FinrayError
        Of the class `error`: it is no such TOML.
    """
    try:
        text = content.decode("utf-8-sig")
        _require_shallow_toml(text)
        parsed = tomllib.loads(text)
        _refuse_odd_numbers(parsed)
        _refuse_half_characters(parsed)
    except (ValueError, RecursionError) as fault:
        raise error(f"{where}: cannot be read as TOML ({fault}); {_toml_remedy(content, str(fault))}") from None
    return parsed


def read_toml_tables(path: Path, what: str = "a TOML file", error: type[FinrayError] = RecordError) -> dict[str, Any]:
    """Read a TOML file; see :func:`read_bytes` and :func:`parse_toml`."""
    return parse_toml(read_bytes(path, what, error, LARGEST_TOML_BYTES), path, error)


_TOML_MISTAKES = (
    (r"[\u201c\u201d\u2018\u2019\u201e]", "write straight quotes"),
    (r"=\s*[+-]?\d+,\d+\s*(#|$)", "the decimal mark is a point"),
    (r"=\s*[A-Za-z_][\w ./-]*(#|$)", "put text in straight quotes"),
)


def _toml_remedy(content: bytes, fault: str) -> str:
    """Return what to do about a file that is no TOML: where the parser stopped, and a common mistake there."""
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return "save it as UTF-8 text (in Windows, choose the encoding under 'Save as')"
    if content.lstrip()[:1] == b"{":
        return "it looks like a JSON file, but a TOML file is needed"
    number = re.search(r"line (\d+)", fault)
    line = lines[int(number[1]) - 1] if number and int(number[1]) <= len(lines) else ""
    hint = next((hint for mistake, hint in _TOML_MISTAKES if re.search(mistake, line)), "")
    shown = f"correct the line {line.strip()[:60]!r}" if line.strip() else "correct the file"
    return f"{shown} ({hint})" if hint else shown


def read_csv(
    path: Path,
    what: str = "a CSV file",
    error: type[FinrayError] = RecordError,
    comments: bool = False,
    skip_space: bool = False,
    other_marks: bool = False,
    names: Collection[str] = (),
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read a CSV file with a header row.

    Parameters
    ----------
    path, what, error
        See :func:`read_bytes`.
    comments
        Leave out lines that begin with ``#``.
    skip_space
        Leave out blanks behind a comma.
    other_marks
        Take semicolons or tabs for what separates columns where the header has one of them and no comma; the decimal
        mark of numbers between semicolons may then be a comma, and between tabs where no number has a point.
    names
        Columns that hold names, in which a comma is no decimal mark; the header may write them in capitals.

    Returns
    -------
    tuple
        Names of the columns, and (line, cells) of every row that is not empty; rows may be shorter than the header.

    Raises
    ------
    FinrayError
        Of the class `error`: as :func:`read_text`, a quote is not closed, a column's name stands twice, a row is longer
        than the header, or the table has too many cells.
    """
    text = _SEPARATOR_LINE.sub("\n", read_text(path, what, error, encoding="utf-8-sig"))
    lines = ("\n" if comments and line.startswith("#") else line for line in io.StringIO(text, newline=""))
    mark = _mark_between_columns(text, comments) if other_marks else ","
    reader = csv.reader(lines, delimiter=mark, strict=True, skipinitialspace=skip_space)
    rows: list[tuple[int, list[str]]] = []
    cells_in_all = 0
    try:
        for cells in reader:
            cells_in_all += len(cells)
            if len(cells) > MOST_COLUMNS or cells_in_all > MOST_VALUES:
                raise error(
                    f"{path}, line {reader.line_num}: the table is too large, because at most {MOST_COLUMNS} columns "
                    f"and {MOST_VALUES} cells in all are supported; give {what}"
                )
            if any(cell.strip() for cell in cells):
                rows.append((reader.line_num, cells))
    except csv.Error as fault:
        raise error(
            f"{path}, line {reader.line_num}: cannot be read as CSV ({fault}); close or remove the quotation marks"
        ) from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    if len(header) == 1 and re.search(r"[;\t]", header[0]):
        raise error(f"{path}: columns must be separated by commas, not semicolons or tabs; write decimals with a point")
    long = next(((line, cells) for line, cells in rows[1:] if any(c.strip() for c in cells[len(header) :])), None)
    if long is not None:
        raise error(
            f"{path}, line {long[0]}: has {len(long[1])} columns, but the header has {len(header)}; separate "
            "columns by commas, and write decimals with a point"
        )
    twice = next((name for name in header if name and header.count(name) > 1), None)
    if twice is not None:
        raise error(f"{path}: the column {twice!r} occurs twice in the header; remove one")
    return header, _with_points(header, rows[1:], mark, names)


def _with_points(
    header: Sequence[str], rows: list[tuple[int, list[str]]], mark: str, names: Collection[str]
) -> list[tuple[int, list[str]]]:
    """Return rows with decimal points in place of commas, where they can be meant, but for columns of names."""
    texts = {k for k, name in enumerate(header) if name in names or name.lower() in names}
    numbers = [cell for _, cells in rows for k, cell in enumerate(cells) if k not in texts]
    thousands = all(map(_GROUPED.fullmatch, filter(_COMMA_NUMBER.match, numbers)))  # 1,234 may be one between tabs
    if mark == "," or (mark == "\t" and (thousands or any(map(_POINT_NUMBER.match, numbers)))):
        return rows
    return [
        (line, [cell if k in texts else _COMMA_NUMBER.sub(r"\1.\2", cell) for k, cell in enumerate(cells)])
        for line, cells in rows
    ]


def _mark_between_columns(text: str, comments: bool) -> str:
    """Return what separates the columns of a header: a semicolon or tab where it has one and no comma."""
    header = re.sub(r"\A(?:#.*\n|\s)*+" if comments else r"\A\s*", "", text).partition("\n")[0]
    return next((mark for mark in ";\t" if mark in header and "," not in header), ",")


def finite_number(text: str) -> float:
    """Return a finite decimal number, as spreadsheets and programs write it: ``-1.5e3``.

    Raises
    ------
    ValueError
        It is none; NaN, infinity, and Python's underscores are none.
    """
    word = text.strip()
    if _NUMBER.fullmatch(word) is None or not math.isfinite(value := float(word)):
        raise ValueError(f"{word[:40]!r} is not a finite number")
    return value


def _kind_at(path: Path) -> str | None:
    """Return what lies at a path that cannot be opened, if it is no regular file."""
    try:
        return _kind_of(os.stat(path).st_mode)
    except (OSError, ValueError):
        return None


def _kind_of(mode: int) -> str | None:
    """Return what a file is in words; None for a regular one."""
    if stat.S_ISREG(mode):
        return None
    return next((words for is_kind, words in _KINDS if is_kind(mode)), "no regular file")


def _require_shallow_json(content: bytes) -> None:
    """Refuse deep nesting and endless lists, looking at brackets and commas outside of strings only."""
    openings = content.count(b"[") + content.count(b"{")
    if openings <= DEEPEST_JSON and content.count(b",") <= MOST_VALUES:
        return
    depth = values = 0
    for token in _JSON_TOKEN.finditer(content):
        mark = content[token.start()]
        if mark in b"[{":
            depth += 1
            values += 1
        elif mark in b"]}":
            depth -= 1
        elif mark in b",":
            values += 1
        if depth > DEEPEST_JSON:
            raise ValueError(f"lists or objects are nested more than {DEEPEST_JSON} deep; flatten them")
        if values > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values")


def _require_shallow_toml(text: str) -> None:
    """Refuse deep nesting and long dotted keys outside of strings and comments."""
    bare = _TOML_WORDS.sub("x", text)
    if _TOML_CHAIN.search(bare):
        raise ValueError(f"a key has more than {DEEPEST_TOML} parts; shorten it")
    depth = 0
    for mark in re.findall(r"[\[\]{}]", bare):
        depth += 1 if mark in "[{" else -1
        if depth > DEEPEST_TOML:
            raise ValueError(f"lists or tables are nested more than {DEEPEST_TOML} deep; flatten them")


def _object_without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object, whose keys must differ."""
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {twice[:80]!r} occurs twice in one object; keep only one")
    return found


def _refuse_constant(word: str) -> Any:
    raise ValueError(f"{word} is not a number; write null for a missing value")


def _finite(word: str) -> float:
    """Return a decimal number that a double can hold."""
    value = float(word)
    if math.isinf(value):
        raise ValueError(f"the number {word[:40]} is too large")
    return value


def _whole(word: str) -> int:
    """Return a whole number of at most 64 bits."""
    if len(word) > 20 or abs(value := int(word)) > LONGEST_WHOLE_NUMBER:
        raise ValueError(f"the whole number {word[:40]} is too large (at most 2^64)")
    return value


def _texts(value: Any) -> Iterator[str]:
    """Yield every text of a parsed document."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from _texts(inner)


def _refuse_half_characters(parsed: Any) -> None:
    """Refuse one half of a surrogate pair, which no file and no screen can show."""
    if any(_SURROGATE.search(text) for text in _texts(parsed)):
        raise ValueError("a text holds an incomplete character (a lone \\ud800 to \\udfff); type the text again")


def _refuse_odd_numbers(value: Any) -> None:
    """Refuse NaN, infinite and endless numbers in TOML tables."""
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            _refuse_odd_numbers(inner)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number; leave the key out if it is not known")
    elif isinstance(value, int) and abs(value) > LONGEST_WHOLE_NUMBER:
        raise ValueError("a whole number is too large (at most 2^64); correct it")
