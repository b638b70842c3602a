"""Products of several files: killed or refused at every call, they are whole or absent, and a rerun completes."""

import errno
import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from data_schemas import RecordError, TactileCapture, provenance
from data_schemas.storage import ProductSet, clear_leftovers, read_record, write_bytes, write_record
from data_schemas.storage._product_set import is_complete
from tests.file_faults import KILLED, FileFaults, contents, in_child
from tests.schemas.test_storage import capture

ORIGIN = provenance("pytest")
IMAGE = np.arange(1800, dtype=np.uint16).reshape(30, 60, 1)
ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)


def record_with_page(folder: Path, elsewhere: Path) -> None:
    """A record with an array file, a page beside it and one in another folder."""
    with ProductSet(folder / "a.json") as products:
        products.add(folder / "a.html", b"page")
        products.add(elsewhere / "other.html", b"page in another folder")
        write_record(capture(IMAGE + 1), folder / "a.second.json", ORIGIN, products)
        write_record(capture(IMAGE), folder / "a.json", ORIGIN, products)


def folder_of_files(folder: Path, elsewhere: Path) -> None:
    """A new folder, with one inside, that holds all of the product."""
    with ProductSet(folder / "study") as products:
        products.add(folder / "study" / "inner" / "picture.png", b"picture")
        products.add(folder / "study" / "table.csv", b"1,2")
        write_record(capture(IMAGE), folder / "study" / "study.json", ORIGIN, products)


def folder_beside_record(folder: Path, elsewhere: Path) -> None:
    """A record, and a new folder beside it."""
    with ProductSet(folder / "press.json") as products:
        products.add(folder / "press.optics" / "one.exr", b"1")
        products.add(folder / "press.optics" / "two.exr", b"2")
        write_record(capture(IMAGE), folder / "press.json", ORIGIN, products)


def single_file(folder: Path, elsewhere: Path) -> None:
    """One file, after what every verb does first."""
    clear_leftovers(folder)
    write_bytes(folder / "single.csv", b"1,2,3")


SETS = {what.__name__: what for what in (record_with_page, folder_of_files, folder_beside_record, single_file)}
COMMITS = {"a.json", "study", "press.json", "single.csv"}


def without_links(work: Callable[[], None]) -> None:
    """Run on a file system without hard links and without renaming of folders."""
    rename = os.rename

    def no_link(source: Path, target: Path) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    def files_only(source: Path, target: Path) -> None:
        if Path(source).is_dir():
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        rename(source, target)

    with patch.object(os, "link", no_link), patch.object(os, "rename", files_only):
        work()


def as_is(work: Callable[[], None]) -> None:
    """Run on the file system as it is."""
    work()


class Try:
    """One kind of set, written again and again into fresh folders in which other things lie already."""

    def __init__(self, top: Path, write: Callable[[Path, Path], None], system: Callable[[Callable[[], None]], None]):
        self.folder, self.elsewhere, self._top = top / "here", top / "there", top
        self._write, self._system = write, system

    def fresh(self) -> dict[str, bytes]:
        """Make the folders anew, and return what lies in them."""
        for folder in (self.folder, self.elsewhere):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            for name in ("mine.html", ".mine.part", ".b.12345678.part", "a.0123456789ab.npz", ".x.set", "z.finray.set"):
                (folder / name).write_bytes(b"the user's own")
            (folder / "empty").mkdir()
        write_record(capture(IMAGE + 7), self.folder / "before.json", ORIGIN)
        return contents(self.folder, self.elsewhere)

    def run(self, faults: FileFaults | None = None) -> int:
        """Write the set in a child process and return its exit status."""

        def work() -> int:
            try:
                if faults is None:
                    self._system(lambda: self._write(self.folder, self.elsewhere))
                    return 0
                with faults.active():
                    self._system(lambda: self._write(self.folder, self.elsewhere))
            except (OSError, RecordError):
                return 2
            return 0

        return in_child(work)

    def points(self) -> list[str]:
        """Return the calls of a run that meets no fault."""
        self.fresh()
        faults = FileFaults((self.folder, self.elsewhere))
        with faults.active():
            self._system(lambda: self._write(self.folder, self.elsewhere))
        return faults.seen

    def require_whole_or_absent(self, before: dict[str, bytes], whole: dict[str, bytes]) -> bool:
        """Check what a fault left, and return whether the set is there."""
        now = contents(self.folder, self.elsewhere)
        assert before.items() <= now.items()
        is_there = all(now.get(path) == content for path, content in whole.items())
        commits = [self.folder / name for name in COMMITS]
        assert any(is_complete(path) for path in commits) == is_there
        for path in whole.keys() - before.keys():
            if not is_there and path.endswith(".json") and Path(path).exists():
                with pytest.raises(RecordError, match="belongs to products that were not completely stored"):
                    read_record(Path(path), TactileCapture)
        return is_there


@pytest.mark.parametrize("system", [as_is, without_links], ids=lambda system: system.__name__)
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("error_number", [None, *ERRORS], ids=lambda e: "kill" if e is None else errno.errorcode[e])
def test_at_every_call_the_set_is_whole_or_absent_and_a_rerun_completes(
    tmp_path, monkeypatch, kind, system, error_number
):
    monkeypatch.setattr(os, "fsync", lambda handle: None)  # counted as a point, but no power fails here
    tried = Try(tmp_path, SETS[kind], system)
    points = tried.points()
    whole = contents(tried.folder, tried.elsewhere)
    ended: Counter[int] = Counter()
    for number in range(len(points)):
        before = tried.fresh()
        status = tried.run(FileFaults((tried.folder, tried.elsewhere), number, error_number))
        ended[status] += 1
        assert status == KILLED if error_number is None else status in (0, 2), (number, points[number])
        is_there = tried.require_whole_or_absent(before, whole)
        if status == 2:
            assert not is_there, (number, points[number])
        if not is_there:
            assert tried.run() == 0, (number, points[number])
        else:
            tried.run()  # refused, for it is there; what is hidden is collected
        assert contents(tried.folder, tried.elsewhere) == whole, (number, points[number])
    assert len(points) > 5
    assert error_number is not None or ended[KILLED] == len(points)
