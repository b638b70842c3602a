"""The face of the library: light to import, complete, and in nobody's way."""

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import finray_calib as finray
from data_schemas import package_version
from finray_calib import require_own_packages

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "scipy", "pydantic", "matplotlib", "mitsuba", "numba", "cv2", "rich", "tifffile", "xarray", "arviz")


def test_import_loads_nothing_heavy_and_is_quick():
    code = (
        "import sys, time; start = time.process_time(); import finray_calib\n"
        f"took = time.process_time() - start; loaded = [m for m in {HEAVY!r} if m in sys.modules]\n"
        "sys.exit(f'loaded {loaded}' if loaded else 0 if took < 0.3 else f'{took} s')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def test_import_writes_no_file_and_says_nothing(tmp_path):
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import finray_calib"
    done = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_every_name_is_there_and_none_is_a_folder():
    rooms = {path.parent.name for path in (ROOT / "finray_calib").glob("*/__init__.py")}
    assert "fit" in rooms
    assert rooms.isdisjoint(finray.__all__)
    for room in sorted(rooms):  # importing one of them must leave every name of the library as it was
        __import__(f"finray_calib.{room}")
    for name in finray.__all__:
        assert getattr(finray, name) is not None
    assert dir(finray) == sorted(finray.__all__)
    assert finray.__version__ == package_version()
    with pytest.raises(AttributeError, match="has no attribute 'fit_pants'"):
        _ = finray.fit_pants


def test_every_function_explains_itself():
    functions = [getattr(finray, name) for name in finray.__all__ if name[0].islower() and not name.startswith("_")]
    assert 15 <= len(functions) <= 22
    assert all(function.__doc__ and len(function.__doc__) > 60 for function in functions)
    listed = re.findall(r"\w+", "".join(re.findall(r"^ {4}\w[\w ]*  .*|^ {16}.*", finray.__doc__, re.MULTILINE)))
    assert {function.__name__ for function in functions} <= set(listed)  # on the first screen of help(finray)


def test_every_type_of_the_library_can_be_looked_up():
    """Programs that build forms or check arguments ask for the types, which are loaded late."""
    for name in set(finray.__all__) - {"__version__"}:
        hints = get_type_hints(getattr(finray, name))
        assert name[0].isupper() or "return" in hints, name
    engines = get_args(get_type_hints(finray.RenderOptions)["engine"])
    assert "cuda" in engines
    assert all(f'"{engine}"' in finray.RenderOptions.__doc__ for engine in engines)


def test_another_package_of_the_same_name_is_named(tmp_path, monkeypatch):
    (tmp_path / "simulacrum").mkdir()
    (tmp_path / "simulacrum/__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    require_own_packages(tmp_path, ("simulacrum",))
    with pytest.raises(
        ImportError,
        match=r"its own package 'simulacrum', .* a different package of the same name at "
        r".*simulacrum/__init__\.py; ren",
    ):
        require_own_packages(ROOT, ("simulacrum",))
    with pytest.raises(
        ImportError, match=r"needs the package 'nowhere_at_all', but it is missing from .*; install finray-calib again"
    ):
        require_own_packages(ROOT, ("nowhere_at_all",))


def test_types_reach_who_installs_the_packages():
    assert all((ROOT / package / "py.typed").is_file() for package in ("data_schemas", "rigs", "finray_calib", "sim"))
