"""``finray verify`` and ``finray trace`` find each of fifty changes of a finished demo, and none where none is."""

import shutil
from pathlib import Path

import pytest

from finray_calib.lineage import Tracer, findings, verify_folder
from tests.lineage.finished_demo import finish_demo
from tests.lineage.tamperings import DECISION, TAMPERINGS


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finish_demo(tmp_path_factory.mktemp("demo") / "finray-demo")


def test_there_are_fifty():
    assert len(TAMPERINGS) == len({(tampering.group, tampering.what) for tampering in TAMPERINGS}) == 50


def test_an_unchanged_demo_is_whole_where_it_is_and_moved(demo, tmp_path):
    moved = tmp_path / "elsewhere" / "moved"
    shutil.copytree(demo, moved)
    for folder in (demo, moved):
        check = verify_folder(folder)
        assert check.faults == ()
        files = {path for path in folder.rglob("*") if path.is_file()}
        assert check.hashed == len(files) - 1  # all but the folder's own checksums
        tree = Tracer(working=tmp_path).trace(folder / DECISION)
        assert tree.is_intact
        assert sum(part.frames for part in tree.all() if not part.is_repeated) == len(
            list(folder.glob("*/session/frames/*"))
        )


@pytest.mark.parametrize("tampering", TAMPERINGS, ids=lambda t: f"{t.group}: {t.what}")
def test_each_is_found_and_named(demo, tmp_path, tampering):
    folder = tmp_path / "finray-demo"
    shutil.copytree(demo, folder, symlinks=True)
    tampering.change(folder)
    assert [f for f in verify_folder(folder).faults if tampering.named in str(f.path.relative_to(folder))]
    of_tree = findings(Tracer(working=tmp_path).trace(folder / DECISION))
    named = [f for f in of_tree if tampering.named in str(f.path.relative_to(folder))]
    assert bool(named) == tampering.in_tree
