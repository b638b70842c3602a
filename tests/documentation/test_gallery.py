"""The gallery shows twenty pictures that are there, and what stands below them can be run."""

import re
import shlex
from pathlib import Path

import pytest

from docs import gallery
from finray_calib.cli.main import build_parser
from tests.command_line.running import finray

TEXT = gallery.PAGE.read_text(encoding="utf-8")
PICTURES = re.findall(r"^!\[([^\]]+)\]\(([^)]+)\)", TEXT, flags=re.MULTILINE)
BLOCKS = gallery.BLOCK.findall(TEXT)
LARGEST_KB = 1000


def test_there_are_twenty_pictures_each_with_what_it_shows():
    assert len(PICTURES) == 20
    assert len({alt for alt, _ in PICTURES}) == 20


@pytest.mark.parametrize("name", [path for _, path in PICTURES])
def test_the_picture_is_there_and_small(name):
    path = gallery.PAGE.parent / name
    assert 1 < path.stat().st_size / 1024 < LARGEST_KB


def test_every_picture_of_its_own_is_made_by_what_stands_below_it():
    parts = gallery.PICTURE.split(TEXT)[1:]
    assert len(parts) == 2 * 12
    for name, below in zip(parts[::2], parts[1::2], strict=True):
        made = name.replace("map.svg", "map.json")  # the figure is stored beside the record
        assert made in "".join(block for _, block in gallery.BLOCK.findall(below)), name


@pytest.mark.parametrize("line", [line for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()])
def test_every_command_is_understood(line):
    words = shlex.split(line)
    if words[0] == "finray":
        assert build_parser().parse_args(words[1:]).run
    else:
        assert words[0] in ("sed", "cp")


def test_python_of_the_page_is_python():
    for kind, block in BLOCKS:
        if kind == "python":
            assert compile(block, gallery.PAGE.name, "exec").co_filename == gallery.PAGE.name


def test_a_page_is_followed_in_its_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    page = (
        "```toml\n# a.toml\nx = 1\n```\n\n```sh\ncp a.toml b.toml\n```\n\n```python\nfrom pathlib import Path\n"
        "text = Path('b.toml').read_text()\n```\n\n```python\nPath('c.toml').write_text(text + 'y = 2')\n```\n"
    )
    gallery.follow(page, tmp_path)
    assert (tmp_path / "c.toml").read_text() == "# a.toml\nx = 1\ny = 2"


def test_the_plan_of_the_page_fits_the_practice_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (plan,) = (block for kind, block in BLOCKS if kind == "toml")
    (tmp_path / "red-plan.toml").write_text(plan)
    assert finray("rig init --preset simulated --out red-rig.toml").status == 0
    assert finray("capture red-plan.toml --rig red-rig.toml --dry-run").status == 0
