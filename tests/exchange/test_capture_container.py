"""The container of captures as others see it: a reader and a writer without finray, and the JSON Schema."""

import ast
import json
import subprocess
import sys
import zipfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import jsonschema
import numpy as np
import pytest

from data_schemas import TactileCapture
from data_schemas.storage import read_record
from tests.command_line.running import finray
from tests.exchange.recipe_folders import write_fots

ROOT = Path(__file__).parents[2]
READER, WRITER = (ROOT / "examples" / "tactile-captures" / f"{verb}_captures.py" for verb in ("read", "write"))
SCHEMA = json.loads((ROOT / "data_schemas" / "json_schema" / "TactileCapture.schema.json").read_text())
PAGE = ROOT / "docs" / "reference" / "tactile-captures.md"


def module(path: Path) -> ModuleType:
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("container")
    write_fots(folder / "FOTS")
    assert finray(f"import captures {folder}/FOTS --recipe fots-gelsight --out {folder}/fots").status == 0
    assert finray(f"export captures {folder}/fots --out {folder}/fots.zip").status == 0
    return folder


@pytest.mark.parametrize("place", ["fots", "fots.zip"])
def test_the_reader_reads_what_finray_wrote(exported: Path, place: str) -> None:
    read = dict(module(READER).read_captures(exported / place))
    assert list(read) == ["0001", "0002", "0003", "0004", "0005"]
    for name, capture in read.items():
        ours = read_record(exported / f"fots/{name}.capture.json", TactileCapture)
        for image in ("contact", "no_contact"):
            assert np.array_equal(capture[image], getattr(ours, image))
        assert capture["contact_circle"] == ours.contact_circle.model_dump()
        assert [part["lost"] for part in capture["missing"]] == [part.lost for part in ours.missing]


def test_the_reader_sees_a_change(exported: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(exported / "fots.zip") as archive, zipfile.ZipFile(tmp_path / "a.zip", "w") as other:
        for entry in archive.infolist():
            other.writestr(entry.filename, archive.read(entry).replace(b'"column_px": 80.0', b'"column_px": 81.0'))
    with pytest.raises(ValueError, match=r"0001.capture.json: was changed"):
        list(module(READER).read_captures(tmp_path / "a.zip"))


def test_finray_reads_what_the_writer_wrote(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-I", WRITER, tmp_path / "my.zip"], check=True)
    checked = finray(f"verify {tmp_path}/my.zip")
    assert (checked.status, "unchanged: 4 files, 2 records" in checked.out) == (0, True)
    capture = read_record(tmp_path / "my.zip" / "press-1.capture.json", TactileCapture)
    assert (capture.contact_circle.column_px, capture.indenter.radius_mm) == (80.0, 3.0)
    change = capture.contact.astype(float) - capture.no_contact
    assert change[60, 96, 0] == pytest.approx(0.4 * 0.8 * 129.6, abs=6.0)  # 0.8 radii to the right, four noises
    bench = finray(f"bench tactile {tmp_path}/my.zip --teach 1 --out {tmp_path}/bench")
    assert bench.status == 0, bench.err
    told = subprocess.run(
        [sys.executable, "-I", READER, tmp_path / "my.zip"], check=True, capture_output=True, text=True
    )
    assert told.stdout.startswith("press-1: (120, 160, 3), largest change")


def test_both_keep_the_schema(exported: Path, tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-I", WRITER, tmp_path / "my.zip"], check=True)
    for path in (exported / "fots.zip", tmp_path / "my.zip"):
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith(".capture.json")]
            for name in names:
                jsonschema.validate(json.loads(archive.read(name)), SCHEMA)
        assert len(names) >= 2


def test_reader_and_writer_are_short_and_need_numpy_only() -> None:
    for path, most in ((READER, 60), (WRITER, 80)):
        text = path.read_text()
        assert len(text.splitlines()) <= most
        imported = {
            part.partition(".")[0]
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for part in ([a.name for a in node.names] if isinstance(node, ast.Import) else [str(node.module)])
        }
        assert imported <= {"hashlib", "io", "json", "sys", "zipfile", "pathlib", "numpy"}


def test_the_page_names_every_field_and_the_version() -> None:
    page = PAGE.read_text()
    fields = set(SCHEMA["properties"]["record"]["properties"])
    of_a_finger = {"light_angle_uncertainty_deg", "led_current_ma", "exposure_bracket_s", "mm_per_px_u_rel"}
    assert {field for field in fields - of_a_finger if f"`{field}`" not in page} == set()
    needed = set(SCHEMA["properties"]["record"]["required"])
    rows = {
        line.split("|")[1].strip(" `"): line.split("|")[2].strip() for line in page.splitlines() if line[:3] == "| `"
    }
    assert {field for field in needed if not rows[field].startswith("must")} == set()
    assert f"`{SCHEMA['properties']['schema_version']['const']}`. finray reads" in page
