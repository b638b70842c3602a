"""The folder of a demo: whose it is, which stages are whole in it, and how an interrupted demo goes on."""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from data_schemas.errors import RecordError
from data_schemas.folder_manifest import MANIFEST_NAME
from data_schemas.foreign_files import open_regular, parse_json, read_json, read_text
from data_schemas.leftovers import clear_leftovers
from data_schemas.model import Record
from data_schemas.provenance import provenance
from data_schemas.storage import read_record
from data_schemas.whole_files import lock, sha256_of, write_bytes

SETTINGS, TIMES = "demo.json", "stage-times.jsonl"
LOGS = "logs"
SUMMARY, REPORT_PAGE = "summary.json", "report.html"


@dataclass(frozen=True, slots=True)
class Product:
    """A record that a stage stores.

    Attributes
    ----------
    file
        Its path in the folder of the demo.
    record_type
        "module:class" of the record.
    inputs
        The stored files that it is made from; the record holds their SHA-256.
    is_session
        Whether it belongs to a session, whose checksums cover its frames.
    """

    file: str
    record_type: str
    inputs: tuple[str, ...] = ()
    is_session: bool = False


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the demo that runs at one go.

    Attributes
    ----------
    kind
        Which of the six stages it belongs to.
    words
        What it is called in a sentence, such as "the fit of the red paint".
    function, arguments
        "module:function" that runs it and stores its products, and what that is given beside the settings.
    products
        What it leaves.
    process
        Stages of one name share a process.
    """

    kind: str
    words: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    products: tuple[Product, ...] = ()
    process: str = ""


def identity(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what must be the same for a demo to go on: version, seed, materials, camera, renderer and its effort.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.stages.settings_json` returns them.
    """
    made_now = provenance("")
    files = {**settings["materials"], "sensor": settings["sensor"]}
    return {
        "version": made_now.package_version,
        "source": made_now.git_commit,
        "packages": made_now.packages,
        "seed": settings["seed"],
        "files_sha256": {name: sha256_of(Path(path)) for name, path in files.items() if path is not None},
        "renderer": settings["engine"]["variant"],
        "effort": settings["effort"],
    }


@contextlib.contextmanager
def held(out: Path, settings: Mapping[str, Any]) -> Iterator[None]:
    """Make the folder of a new demo, or take over that of an interrupted one; nobody else writes into it meanwhile.

    Raises
    ------
    RecordError
        The folder holds something else, a finished demo, one with other settings, or one that is running.
    """
    mine = identity(settings)
    clear_leftovers(out)  # of a demo that was killed before its first file had its name
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        write_bytes(out / SETTINGS, (json.dumps(mine, indent=1) + "\n").encode())
    if not (out / SETTINGS).is_file():
        raise RecordError(f"{out}: exists already and is not empty; choose another --out or move it away")
    with open_regular(out / SETTINGS) as file:
        if not _is_free(file):
            raise RecordError(f"{out}: another 'finray demo' is writing into it; wait, or choose another --out")
        if (why := _why_not(out, mine)) is not None:
            raise RecordError(f"{out}: {why}; choose another --out")
        for folder in (out, *(path for path in out.iterdir() if path.is_dir())):
            clear_leftovers(folder)  # what a killed stage was writing
        yield


def can_go_on(out: Path, settings: Mapping[str, Any]) -> bool:
    """Return whether the folder holds an interrupted demo with these settings which nobody is running."""
    if not (out / SETTINGS).is_file() or _why_not(out, identity(settings)) is not None:
        return False
    with open_regular(out / SETTINGS) as file:
        return _is_free(file)


def _is_free(file: BinaryIO) -> bool:
    """Lock an open file until it is closed; False where another process has locked it."""
    return lock(file.fileno()) is not False


def _why_not(out: Path, mine: Mapping[str, Any]) -> str | None:
    """Return why a demo cannot go on in a folder of a demo, or None when it can."""
    if (out / REPORT_PAGE).exists():
        return f"holds a finished demo already, whose report is {out / REPORT_PAGE}"
    try:
        theirs = read_json(out / SETTINGS)
    except RecordError as error:
        return f"does not say how its demo began ({error})"
    if not isinstance(theirs, dict) or theirs.keys() != mine.keys():
        return f"{SETTINGS} was written by another version of finray"
    other = [text for name in mine for text in _differences(name, theirs[name], mine[name])]
    return f"holds an unfinished demo with another {', another '.join(other)}, which would be mixed" if other else None


def _differences(name: str, theirs: Any, mine: Any) -> list[str]:
    """Return in words what differs in a setting, or in the entries of a table of them."""
    if isinstance(theirs, dict) and isinstance(mine, dict):
        names = sorted(theirs.keys() | mine.keys())
        return [text for key in names for text in _differences(key, theirs.get(key), mine.get(key))]
    return [] if theirs == mine else [f"{name} {theirs} (now {mine})"]


def whole_stages(out: Path, stages: Sequence[Stage]) -> set[int]:
    """Return the numbers of the stages whose products are all there, as their records and checksums prove.

    Raises
    ------
    RecordError
        A product was changed, or made from other files than those that are there.
    """
    whole, missing = set[int](), set[str]()
    for number, stage in enumerate(stages):
        absent = {product.file for product in stage.products if not _is_whole(out, product, missing)}
        missing |= absent
        if stage.products and not absent:
            whole.add(number)
    return whole


def _is_whole(out: Path, product: Product, missing: set[str]) -> bool:
    """Return whether a product is there; one that is there must be what its record says."""
    path = out / product.file
    if not path.exists() or (product.is_session and not (path.parent / MANIFEST_NAME).exists()):
        return False
    module, name = product.record_type.split(":")
    record_type: type[Record] = getattr(import_module(module), name)
    record = read_record(path, record_type)
    made_from = {} if record.provenance is None else record.provenance.input_sha256
    for needed in product.inputs:
        if needed in missing or made_from.get(needed) != sha256_of(out / needed):
            raise RecordError(
                f"{path}: was made from another {needed} than the one that is there; move it away to have it made again"
            )
    if product.is_session:
        _require_whole(path.parent)
    return True


def _require_whole(folder: Path) -> None:
    """Refuse a session that is not as it was captured."""
    from rigs.capture.verify_session import verify_session

    for fault in verify_session(folder).faults:
        raise RecordError(f"{fault.path}: {fault.text}; move {folder} away to have it captured again")


def note_time(out: Path, stage: Stage, seconds: float) -> None:
    """Add the wall time (s) of a finished stage to those of the folder."""
    with (out / TIMES).open("a", encoding="utf-8") as file:
        file.write(json.dumps({"kind": stage.kind, "stage": stage.words, "seconds": round(seconds, 3)}) + "\n")
        file.flush()
        os.fsync(file.fileno())


def noted_times(out: Path, stages: Sequence[Stage]) -> dict[str, float]:
    """Return the wall time (s) of each of the six stages; 0 where a demo was cut off before it was noted."""
    seconds = {stage.kind: 0.0 for stage in stages if stage.kind}
    lines = read_text(out / TIMES).splitlines() if (out / TIMES).is_file() else []
    for line in lines:
        with contextlib.suppress(RecordError, KeyError, TypeError):  # a line that was cut off
            noted = parse_json(line.encode(), out / TIMES)
            seconds[noted["kind"]] += float(noted["seconds"])
    return seconds
