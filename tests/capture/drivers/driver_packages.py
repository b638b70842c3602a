"""Packages outside finray-calib, as an installation leaves them: modules beside a ``.dist-info`` folder."""

import sys
from pathlib import Path

import pytest

from data_schemas import plug_ins
from rigs import offered

ROOT = Path(__file__).parents[3]


def install(site: Path, package: str, entry_points: dict[str, dict[str, str]], **modules: str) -> None:
    """Write a package of version 0.1 with entry points (group -> name -> module) and modules (name -> source)."""
    site.mkdir(exist_ok=True)
    for name, source in modules.items():
        (site / f"{name}.py").write_text(source, encoding="utf-8")
    folder = site / f"{package.replace('-', '_')}-0.1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.1\n", encoding="utf-8")
    lines = [
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in entry_points.items()
    ]
    (folder / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    _look_again()


def _look_again() -> None:
    """Forget which packages there were."""
    plug_ins.cache_clear()
    offered.cache_clear()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> "Path":
    """Return a folder whose packages are installed, here and in every process that is started; call :func:`look`."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", f"{folder}:{ROOT}")
    before = set(sys.modules)
    _look_again()
    yield folder
    _look_again()
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
            del sys.modules[name]
