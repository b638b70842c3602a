"""Formats of captures of packages outside the tree: found by name, refused in one sentence with their package."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_schemas import ImportFormatError, RecordError, TactileCapture
from data_schemas.storage import read_record
from finray_calib.exchange import capture_by_package
from tests.capture.drivers.driver_packages import install, site
from tests.command_line.running import finray

__all__ = ["site"]
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "import-captures.md"
GROUP = "finray_calib.import_formats"
RETURNS = "def read_capture(folder):\n    return {}\n"


def printed(language: str) -> str:
    """Return the page's only block of a language."""
    (block,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    return block


@pytest.fixture
def my_lab(site: Path) -> str:
    """Install the package of the page, from the page; return its format."""
    ((group, names),) = tomllib.loads(printed("toml"))["project"]["entry-points"].items()
    ((name, module),) = names.items()
    install(site, "my-lab-files", {group: names}, **{module: printed("python")})
    return name


@pytest.fixture
def press(tmp_path: Path) -> Path:
    folder = tmp_path / "press-7"
    folder.mkdir()
    for value, name in enumerate(("contact", "no_contact"), 100):
        np.save(folder / f"{name}.npy", np.full((4, 6, 3), value, dtype=np.uint8))
    return folder


def test_format_of_the_page_reads_a_press(my_lab, press, tmp_path):
    out = tmp_path / "seven.json"
    done = finray(f"import other {press} --format {my_lab} --out {out}")
    assert done.status == 0, done.err
    capture = read_record(out, TactileCapture)
    assert (capture.name, capture.source) == ("press-7", "my lab")
    assert np.array_equal(capture.contact, np.full((4, 6, 3), 100))
    assert capture.provenance is not None
    assert {Path(name).name for name in capture.provenance.input_sha256} == {"contact.npy", "no_contact.npy"}


def test_missing_file_of_a_press_is_named(my_lab, press):
    (press / "contact.npy").unlink()
    with pytest.raises(RecordError, match=r"contact\.npy: "):
        capture_by_package(my_lab, press)


def test_format_that_nobody_brings_is_refused_with_those_there_are(my_lab, press):
    told = r"no installed package provides the format 'mylab' \(available: format 'my-lab' of package my-lab-files 0\.1"
    with pytest.raises(ImportFormatError, match=told):
        capture_by_package("mylab", press)


def test_folder_that_is_not_there_is_refused(my_lab, tmp_path):
    with pytest.raises(ImportFormatError, match=r"nowhere: no such folder; give the folder of one press"):
        capture_by_package(my_lab, tmp_path / "nowhere")


def test_format_of_two_packages_is_refused(my_lab, site, press):
    install(site, "other-files", {GROUP: {my_lab: "other_format"}}, other_format=RETURNS)
    told = r"provided by my-lab-files 0\.1 and by other-files 0\.1, so finray cannot tell"
    with pytest.raises(ImportFormatError, match=told):
        capture_by_package(my_lab, press)


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("import not_there_at_all\n", r"cannot be imported \(ModuleNotFoundError: .*not_there_at_all"),
        ("def read(folder): ...\n", r"does not define read_capture\(folder\) in its module bad_format"),
        (RETURNS, r"press-7: .* returns a dict, but a data_schemas\.TactileCapture is needed"),
        ("raise SystemExit(7)\n", r"cannot be imported \(SystemExit: 7\)"),
        ("def read_capture(folder):\n    return 1 / 0\n", r"press-7: .* fails \(ZeroDivisionError: division by zero\)"),
    ],
)
def test_mistakes_of_an_author_name_the_package_and_what_is_expected(site, press, source, told):
    install(site, "bad-files", {GROUP: {"bad": "bad_format"}}, bad_format=source)
    with pytest.raises(ImportFormatError, match=rf"(?s){told}.*pip install --upgrade bad-files") as refused:
        capture_by_package("bad", press)
    assert "format 'bad' of package bad-files 0.1" in str(refused.value)


def test_format_that_reads_by_itself_is_refused(site, press):
    source = printed("python").replace("from data_schemas.storage import read_npy", "read_npy = np.load")
    assert source != printed("python")
    install(site, "own-files", {GROUP: {"own": "own_format"}}, own_format=source)
    with pytest.raises(ImportFormatError, match=r"did not read any file of the folder .* could not name its"):
        capture_by_package("own", press)
