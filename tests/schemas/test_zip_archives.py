"""Zip archives as folders: the same files, and one sentence for every archive that is made to do harm."""

import bz2
import os
import shutil
import stat
import subprocess
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from data_schemas import RecordError
from data_schemas.storage import _zip_archives as limits
from data_schemas.storage import (
    digest_as_read,
    files_below,
    files_in,
    folder_at,
    has_file,
    manifest_faults,
    open_regular,
    read_bytes,
    sha256_of,
    write_manifest,
    write_zip,
)

CONTENT = {"one.txt": b"1" * 100, "part/two.txt": bytes(range(256)) * 20, "part/deep/three.txt": b""}


def packed(path: Path, files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def entry(name: str, mode: int = 0, method: int = zipfile.ZIP_STORED) -> zipfile.ZipInfo:
    made = zipfile.ZipInfo(name)
    made.create_system, made.external_attr, made.compress_type = 3, mode << 16, method
    return made


def one(path: Path, made: zipfile.ZipInfo, content: bytes = b"x") -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(made, content)
    return path


def patched(path: Path, old: bytes, new: bytes) -> Path:
    """The archive with the same number of other bytes."""
    content = path.read_bytes()
    assert old in content
    assert len(old) == len(new)
    path.write_bytes(content.replace(old, new))
    return path


class TestAnArchiveIsReadAsAFolder:
    @pytest.fixture(params=["zipfile stored", "zipfile deflated", "Info-ZIP", "write_zip"])
    def archive(self, request: pytest.FixtureRequest, tmp_path: Path) -> Path:
        path = tmp_path / "set.zip"
        if request.param == "Info-ZIP":
            program = shutil.which("zip")
            if program is None:
                pytest.skip("Info-ZIP's zip is not installed")
            for name, content in CONTENT.items():
                (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
                (tmp_path / "in" / name).write_bytes(content)
            subprocess.run([program, "-qr", path, "."], cwd=tmp_path / "in", check=True)
        elif request.param == "write_zip":
            write_zip(path, CONTENT.items())
        else:
            packed(path, CONTENT, zipfile.ZIP_STORED if "stored" in request.param else zipfile.ZIP_DEFLATED)
        return path

    def test_its_files_are_those_that_were_packed(self, archive: Path) -> None:
        assert folder_at(archive) == archive
        assert {path.relative_to(archive).as_posix(): read_bytes(path) for path in files_below(archive)} == CONTENT
        assert files_in(archive) == [archive / "one.txt"]
        assert files_in(archive / "part", ".txt") == [archive / "part" / "two.txt"]
        assert list(files_below(archive / "part" / "deep")) == [archive / "part" / "deep" / "three.txt"]
        assert folder_at(archive / "part") == archive / "part"
        assert (folder_at(archive / "pa"), folder_at(archive / "one.txt")) == (None, None)
        assert (has_file(archive / "one.txt"), has_file(archive / "part"), has_file(archive)) == (True, False, True)
        with open_regular(archive / "one.txt") as file:
            assert file.read() == CONTENT["one.txt"]

    def test_what_is_read_is_hashed_under_its_path(self, archive: Path, tmp_path: Path) -> None:
        (tmp_path / "beside.txt").write_bytes(CONTENT["one.txt"])
        read_bytes(archive / "one.txt")
        assert (
            digest_as_read(archive / "one.txt") == sha256_of(tmp_path / "beside.txt") == sha256_of(archive / "one.txt")
        )

    def test_what_is_not_there_or_too_long_is_named(self, archive: Path) -> None:
        with pytest.raises(RecordError, match=r"set.zip/four.txt: no such file in the archive; give"):
            read_bytes(archive / "four.txt", "a text")
        with pytest.raises(RecordError, match=r"set.zip/one.txt: is too long; at most 99 bytes"):
            read_bytes(archive / "one.txt", largest_bytes=99)


def test_an_archive_of_one_folder_is_that_folder(tmp_path: Path) -> None:
    """As GitHub and 'zip -r set.zip set' have it; what the Finder of macOS adds is left out."""
    files = {"set/one.txt": b"1", "set/part/two.txt": b"2", "__MACOSX/set/._one.txt": b"?", ".DS_Store": b"?"}
    path = packed(tmp_path / "set.ZIP", files)
    assert folder_at(path) == path / "set"
    assert sorted(inside.name for inside in files_below(path / "set")) == ["one.txt", "two.txt"]
    assert not has_file(path / "__MACOSX" / "set" / "._one.txt")


def test_an_archive_that_changes_is_read_anew(tmp_path: Path) -> None:
    path = packed(tmp_path / "set.zip", {"one.txt": b"before"})
    assert read_bytes(path / "one.txt") == b"before"
    packed(tmp_path / "other.zip", {"one.txt": b"after all"}).replace(path)
    assert read_bytes(path / "one.txt") == b"after all"


def test_checksums_within_an_archive_are_compared(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "one.txt").write_bytes(b"1")
    manifest = write_manifest(tmp_path / "set")
    for content, states in ((b"1", []), (b"2", ["changed"])):
        path = packed(tmp_path / f"{content!r}.zip", {"one.txt": content, manifest.name: manifest.read_bytes()})
        faults, unlisted = manifest_faults(path)
        assert ([fault.state for fault in faults], unlisted) == (states, [])


@pytest.mark.parametrize("name", [" blank.txt", "line\u2028.txt", "\u0085next.txt", "form\x0c.txt"])
def test_checksums_list_every_name_that_one_line_can_hold(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"1")
    (tmp_path / "one.txt").write_bytes(b"1")
    write_manifest(tmp_path)
    assert manifest_faults(tmp_path) == ([], [])
    (tmp_path / name).write_bytes(b"2")
    assert [fault.path.name for fault in manifest_faults(tmp_path)[0]] == [name]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"no sum\n", "line 1: must contain a SHA-256, two spaces and the path of a file"),
        (b"0" * 64 + b"  a\r\n" + b"0" * 64 + b"  a\r\n", "line 2: must contain a SHA-256"),
        (b"\xff\n", "cannot be read as UTF-8 text"),
    ],
)
def test_the_fault_of_checksums_begins_with_a_word(tmp_path: Path, content: bytes, told: str) -> None:
    """Commands print the path and a colon before it."""
    (tmp_path / "manifest-sha256.txt").write_bytes(content)
    (fault,) = manifest_faults(tmp_path)[0]
    assert (fault.state, fault.text[: len(told)]) == ("changed", told)


def test_a_written_archive_is_the_same_each_time_and_never_overwritten(tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        write_zip(tmp_path / name, CONTENT.items())
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    with pytest.raises(RecordError, match="exists already and is not overwritten"):
        write_zip(tmp_path / "a.zip", CONTENT.items())

    def breaks():  # type: ignore[no-untyped-def]
        yield "one.txt", b"1"
        raise OSError(5, "the medium is gone", "one.txt")

    with pytest.raises(OSError, match="medium"):
        write_zip(tmp_path / "c.zip", breaks())
    assert sorted(os.listdir(tmp_path)) == ["a.zip", "b.zip"]


def _twice(path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("one.txt", b"1")
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("one.txt", b"2")
    return path


def _overlapping(path: Path) -> Path:
    """Two names for one kernel of data: 16 MB each, and a thousandth of it in the archive."""
    packed(path, {"one.txt": bytes(1 << 20)})
    content = path.read_bytes()
    at = content.index(b"PK\x01\x02")
    record, tail = content[at : content.index(b"PK\x05\x06")], bytearray(content[content.index(b"PK\x05\x06") :])
    tail[8:12] = (2).to_bytes(2, "little") * 2
    tail[12:16] = (2 * len(record)).to_bytes(4, "little")
    path.write_bytes(content[:at] + record + record.replace(b"one.txt", b"two.txt") + bytes(tail))
    return path


def _forged_list(path: Path) -> Path:
    """An end that says the list of files takes 1 GB, in a sparse file of that length."""
    packed(path, {"one.txt": b"1"})
    end = bytearray(path.read_bytes()[-22:])
    end[12:16] = (1 << 30).to_bytes(4, "little")
    end[16:20] = (0).to_bytes(4, "little")
    with path.open("wb") as file:
        file.truncate(1 << 30)
        file.seek(1 << 30)
        file.write(bytes(end))
    return path


LINK, DEVICE = stat.S_IFLNK | 0o777, stat.S_IFCHR | 0o600
POISONED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "above": (lambda p: one(p, entry("../one.txt")), r"'\.\./one.txt' leads out of its folder"),
    "above within": (lambda p: one(p, entry("a/../../b")), "leads out of its folder"),
    "absolute": (lambda p: one(p, entry("/etc/one.txt")), "'/etc/one.txt' is not a path within the archive"),
    "drive": (lambda p: one(p, entry("C:/one.txt")), "is not a path within the archive"),
    "backslash": (lambda p: one(p, entry("..\\one.txt")), "null byte or a backslash"),
    "null": (lambda p: patched(one(p, entry("oneXtxt")), b"oneXtxt", b"one\0txt"), "null byte or a backslash"),
    "control": (lambda p: one(p, entry("one\x1b[2J")), "control characters"),
    "long": (lambda p: one(p, entry("n" * 1001)), "more than 1000 bytes"),
    "deep": (lambda p: one(p, entry("a/" * 16 + "b")), "more than 16 folders deep"),
    "link": (lambda p: one(p, entry("one.txt", LINK), b"/etc/passwd"), "'one.txt' is a link or a device"),
    "device": (lambda p: one(p, entry("one.txt", DEVICE)), "is a link or a device"),
    "twice": (_twice, "'one.txt' is in the archive twice"),
    "file and folder": (lambda p: packed(p, {"a": b"1", "a/b": b"2"}), "'a' is both a file and a folder"),
    "other packing": (lambda p: one(p, entry("a", method=zipfile.ZIP_BZIP2)), "a method other than deflate"),
    "bomb": (lambda p: packed(p, {"a": bytes(32 << 20)}), "grows from .* to 33554432 bytes, over 200 times"),
    "over another": (_overlapping, "overlaps another file"),
    "forged list": (_forged_list, "a list of files of 1073741824 bytes, but at most 16777216 are read"),
    "cut off": (lambda p: (p.write_bytes(packed(p, CONTENT).read_bytes()[:-30]), p)[1], "cannot be read as a zip"),
    "no archive": (lambda p: (p.write_bytes(b"PK\x03\x04" + bytes(99)), p)[1], "cannot be read as a zip archive"),
    "empty": (lambda p: (p.write_bytes(b""), p)[1], "cannot be read as a zip archive"),
}  # fmt: skip


@pytest.mark.parametrize("poison", POISONED)
def test_a_poisoned_archive_is_refused_in_one_sentence(tmp_path: Path, poison: str) -> None:
    make, says = POISONED[poison]
    path = make(tmp_path / "set.zip")
    with pytest.raises(RecordError, match=says) as refused:
        folder_at(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)
    with pytest.raises(RecordError, match=says):
        read_bytes(path / "one.txt")
    assert os.listdir(tmp_path) == ["set.zip"]


def test_an_encrypted_file_is_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "set.zip", {"one.txt": b"1"}, zipfile.ZIP_STORED)
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(bytes(content))
    with pytest.raises(RecordError, match="is encrypted"):
        folder_at(path)


def test_too_many_files_and_too_many_bytes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = packed(tmp_path / "set.zip", CONTENT)
    monkeypatch.setattr(limits, "MOST_MEMBERS", 2)
    with pytest.raises(RecordError, match="contains 3 files, but at most 2 are read"):
        folder_at(path)
    monkeypatch.setattr(limits, "MOST_MEMBERS", 3)
    monkeypatch.setattr(limits, "LARGEST_UNPACKED_BYTES", 1000)
    with pytest.raises(RecordError, match=r"GB when unpacked, but at most .* GB are read; unpack it"):
        folder_at(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_file_whose_bytes_changed_is_refused_as_it_is_read(tmp_path: Path, method: int) -> None:
    path = packed(tmp_path / "set.zip", {"one.txt": b"some content", "two.txt": b"2"}, method)
    content = bytearray(path.read_bytes())
    content[30 + len("one.txt") + 3] ^= 0x10
    path.write_bytes(bytes(content))
    with pytest.raises(
        RecordError, match=r"set.zip/one.txt: is corrupted in the archive \(.*\); create the archive again"
    ):
        read_bytes(path / "one.txt")
    assert read_bytes(path / "two.txt") == b"2"


def test_a_size_that_lies_gives_no_more_than_it_says(tmp_path: Path) -> None:
    """1 MB of zeros whose list of files says 10 bytes, with their checksum."""
    path = packed(tmp_path / "set.zip", {"one.txt": bytes(1 << 20)})
    content = bytearray(path.read_bytes())
    at = content.index(b"PK\x01\x02")
    content[at + 24 : at + 28] = (10).to_bytes(4, "little")
    content[at + 16 : at + 20] = zlib.crc32(bytes(10)).to_bytes(4, "little")
    path.write_bytes(bytes(content))
    assert read_bytes(path / "one.txt") == bytes(10)


def test_a_pipe_with_the_name_of_an_archive_is_no_folder(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "set.zip")
    assert folder_at(tmp_path / "set.zip") is None
    with pytest.raises(RecordError, match="is a named pipe"):
        read_bytes(tmp_path / "set.zip")


def test_a_folder_that_ends_in_zip_is_a_folder(tmp_path: Path) -> None:
    inside = tmp_path / "set.zip"
    inside.mkdir()
    (inside / "one.txt").write_bytes(bz2.compress(b"1"))
    assert folder_at(inside) == inside
    assert files_in(inside) == list(files_below(inside)) == [inside / "one.txt"]
    assert read_bytes(inside / "one.txt") == bz2.compress(b"1")
