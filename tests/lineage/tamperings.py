"""Fifty ways in which a finished demo may be other than it was: accidents and edits, no forgery.

Each changes one thing in the folder and says which file must be named. Those below a decision's tree must be found by
``finray trace`` of the decision as well as by ``finray verify`` of the folder.
"""

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_schemas import provenance
from data_schemas.storage import write_frame, write_record

DECISION = "light-angle-decision.json"
SESSION = "red/session"


@dataclass(frozen=True)
class Tampering:
    """One change: its class, what it does, the file that must be named, whether it lies below the decision."""

    group: str
    what: str
    named: str
    change: Callable[[Path], None]
    in_tree: bool = True


def number(
    file: str, key: str, change: Callable[[float], float] = lambda value: value * 1.001
) -> Callable[[Path], None]:
    """Change the first number of this name in a JSON file."""

    def edit(folder: Path) -> None:
        path = folder / file
        text, count = re.subn(
            rf'("{key}": )(-?[0-9.eE+-]+)', lambda m: f"{m[1]}{change(float(m[2]))!r}", path.read_text(), count=1
        )
        assert count == 1, f"{path} holds no number {key}"
        path.write_text(text)

    return edit


def text(file: str, old: str, new: str) -> Callable[[Path], None]:
    """Replace a pattern, which must be there, at its first place."""

    def edit(folder: Path) -> None:
        path = folder / file
        changed, count = re.subn(old, new, path.read_text(), count=1)
        assert count == 1, f"{path} holds no {old}"
        path.write_text(changed)

    return edit


def byte(pattern: str, place: float = 0.6) -> Callable[[Path], None]:
    """Flip one bit of the first file of a pattern."""

    def edit(folder: Path) -> None:
        path = sorted(folder.glob(pattern))[0]
        content = bytearray(path.read_bytes())
        content[int(place * len(content))] ^= 4
        path.write_bytes(bytes(content))

    return edit


def remove(pattern: str) -> Callable[[Path], None]:
    """Remove the first file of a pattern."""
    return lambda folder: sorted(folder.glob(pattern))[0].unlink()


def cut(file: str, share: float = 0.5) -> Callable[[Path], None]:
    """Cut a file off, as a full disk does."""

    def edit(folder: Path) -> None:
        path = folder / file
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])

    return edit


def swap(first: str, second: str) -> Callable[[Path], None]:
    """Exchange the first files of two patterns."""

    def edit(folder: Path) -> None:
        one, other = sorted(folder.glob(first))[0], sorted(folder.glob(second))[-1]
        assert one.read_bytes() != other.read_bytes()
        aside = one.with_name("aside")
        one.rename(aside)
        other.rename(one)
        aside.rename(other)

    return edit


def lines(file: str, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Change the lines of a text file."""

    def edit(folder: Path) -> None:
        path = folder / file
        before = path.read_text().splitlines(keepends=True)
        after = change(before)
        assert after != before
        path.write_text("".join(after))

    return edit


def empty(file: str) -> Callable[[Path], None]:
    """Leave nothing in a file."""
    return lambda folder: (folder / file).write_bytes(b"")


def made_anew(file: str) -> Callable[[Path], None]:
    """Make a product again, whole and sealed, with other content: what was made from it is stale."""

    def edit(folder: Path) -> None:
        from data_schemas.storage import read_record
        from finray_calib.lineage._trace import KINDS
        from tests.lineage.finished_demo import COMMAND

        path = folder / file
        kind = json.loads(path.read_text())["kind"]
        record = read_record(path, KINDS[kind])
        assert record.provenance is not None
        path.unlink()
        write_record(record, path, provenance(COMMAND, record.provenance.input_sha256, 99))

    return edit


def other_frame(folder: Path) -> None:
    """Write a whole frame with other counts in place of one: it opens in every program."""
    path = sorted((folder / SESSION / "frames").glob("*room-light*"))[0]
    import tifffile

    counts = tifffile.imread(path)
    path.unlink()
    write_frame(path, np.ascontiguousarray(counts[::-1]), "another")


def link(folder: Path) -> None:
    """Put a link to another file in the place of a frame."""
    frames = sorted((folder / SESSION / "frames").glob("*.tiff"))
    frames[3].unlink()
    os.symlink(frames[4].name, frames[3])


def copy_over(source: str, target: str) -> Callable[[Path], None]:
    """Put a copy of one file in the place of another."""

    def edit(folder: Path) -> None:
        one, other = sorted(folder.glob(source))[0], sorted(folder.glob(target))[0]
        assert one.read_bytes() != other.read_bytes()
        shutil.copyfile(one, other)

    return edit


JOURNAL, MANIFEST = f"{SESSION}/journal.jsonl", f"{SESSION}/manifest-sha256.txt"
RECORD = f"{SESSION}/session.json"

TAMPERINGS: tuple[Tampering, ...] = (
    # values of a session's record
    Tampering("session record", "reflectance of the white tile", RECORD, number(RECORD, "reflectance")),
    Tampering("session record", "an exposure", RECORD, number(RECORD, "exposure_s")),
    Tampering("session record", "centre of a filter", RECORD, number(RECORD, "center_nm", lambda v: v + 1)),
    Tampering(
        "session record",
        "a filter's name in a frame",
        RECORD,
        text(RECORD, '"filter_name": "500"', '"filter_name": "532"'),
    ),
    Tampering("session record", "power of the laser", RECORD, number(RECORD, "power_mw")),
    Tampering(
        "session record",
        "version lowered, seal removed",
        RECORD,
        lambda f: (
            text(RECORD, '"schema_version": [0-9]+', '"schema_version": 1')(f),
            text(RECORD, r',\s*"content_sha256": "[0-9a-f]+"', "")(f),
        )[0],
    ),
    Tampering("session record", "seal removed", RECORD, text(RECORD, r',\s*"content_sha256": "[0-9a-f]+"', "")),
    Tampering("session record", "removed", RECORD, remove(RECORD)),
    Tampering("session record", "cut off", RECORD, cut(RECORD)),
    Tampering("session record", "that of the other paint", RECORD, copy_over("green/session/session.json", RECORD)),
    # journal
    Tampering("journal", "removed", JOURNAL, remove(JOURNAL)),
    Tampering("journal", "a line removed", JOURNAL, lines(JOURNAL, lambda ls: ls[:5] + ls[6:])),
    Tampering("journal", "two lines exchanged", JOURNAL, lines(JOURNAL, lambda ls: [*ls[:5], ls[6], ls[5], *ls[7:]])),
    Tampering(
        "journal",
        "a time changed",
        JOURNAL,
        lines(JOURNAL, lambda ls: [*ls[:4], re.sub('("monotonic_s": )([0-9.]+)', r"\g<1>9\2", ls[4]), *ls[5:]]),
    ),
    Tampering("journal", "the last lines removed", JOURNAL, lines(JOURNAL, lambda ls: ls[:-2])),
    Tampering(
        "journal",
        "a line added",
        JOURNAL,
        lines(JOURNAL, lambda ls: [*ls, '{"event": "note", "utc": "", "monotonic_s": 0, "text": "x"}\n']),
    ),
    Tampering("journal", "emptied", JOURNAL, empty(JOURNAL)),
    # checksums
    Tampering("checksums", "of the session, removed", MANIFEST, remove(MANIFEST)),
    Tampering(
        "checksums",
        "of the session, a line changed",
        "session",
        lines(MANIFEST, lambda ls: [ls[0].replace(ls[0][:4], "beef"), *ls[1:]]),
    ),
    Tampering("checksums", "of the session, a line removed", MANIFEST, lines(MANIFEST, lambda ls: ls[1:])),
    Tampering("checksums", "of the session, emptied", MANIFEST, empty(MANIFEST)),
    Tampering("checksums", "of the demo, removed", "manifest-sha256.txt", remove("manifest-sha256.txt"), in_tree=False),
    # frames
    Tampering("frames", "one bit of a frame", "frames", byte(f"{SESSION}/frames/*.tiff")),
    Tampering("frames", "a frame that radiometry does not read", "room-light", other_frame),
    Tampering("frames", "a frame removed", "frames", remove(f"{SESSION}/frames/*fluorescence*")),
    Tampering("frames", "two frames exchanged", "frames", swap(f"{SESSION}/frames/*.tiff", f"{SESSION}/frames/*.tiff")),
    Tampering(
        "frames",
        "a frame of the other session",
        "frames",
        copy_over("green/session/frames/*white*", f"{SESSION}/frames/*white*"),
    ),
    Tampering(
        "frames",
        "a frame cut off",
        "frames",
        lambda f: cut(str(sorted((f / SESSION / "frames").glob("*.tiff"))[2].relative_to(f)))(f),
    ),
    Tampering("frames", "a link in place of a frame", "frames", link),
    # what people write
    Tampering(
        "plan and rig",
        "a number of the plan",
        "red/plan.toml",
        text("red/plan.toml", "target_fraction = 0.7", "target_fraction = 0.6"),
    ),
    Tampering("plan and rig", "the plan removed", "plan.toml", remove("red/plan.toml")),
    Tampering(
        "plan and rig",
        "a filter of the rig",
        "red/rig.toml",
        text("red/rig.toml", "center_nm = 500", "center_nm = 510"),
    ),
    Tampering(
        "plan and rig", "a comment of the rig", "red/rig.toml", text("red/rig.toml", "# A calibration rig", "# A rig")
    ),
    # records of products
    Tampering("records", "decided angle", DECISION, number(DECISION, "angle_deg", lambda v: v + 1)),
    Tampering(
        "records", "sentence of the decision", DECISION, text(DECISION, '"sentence": "', '"sentence": "Surely: ')
    ),
    Tampering("records", "seed in the provenance", DECISION, number(DECISION, "seed", lambda v: int(v) + 1)),
    Tampering(
        "records",
        "checksum of an input in the provenance",
        DECISION,
        text(DECISION, r'("sweep.json": ")[0-9a-f]{4}', r"\g<1>beef"),
    ),
    Tampering(
        "records", "a value of the bands", "red/bands.json", number("red/bands.json", "center_nm", lambda v: v + 1)
    ),
    Tampering("records", "the mode of a paint", "red/paint.json", number("red/paint.json", "estimate")),
    Tampering(
        "records", "a score of the report", "photometric-error.json", number("photometric-error.json", "estimate")
    ),
    Tampering(
        "records",
        "version raised",
        "sweep.json",
        text("sweep.json", '"schema_version": [0-9]+', '"schema_version": 99'),
    ),
    Tampering("records", "the capture removed", "tactile-capture.json", remove("tactile-capture.json")),
    Tampering("records", "the paints exchanged", "paint.json", swap("red/paint.json", "green/paint.json")),
    # arrays
    Tampering("arrays", "one bit of a render", "press.", byte("press.*.npz")),
    Tampering("arrays", "one bit of a sweep's or surface's arrays", ".npz", byte("pressed-finger.surfaces.*.npz", 0.3)),
    Tampering("arrays", "those of a paint removed", ".npz", remove("red/paint.*.npz")),
    # made anew
    Tampering("made anew", "the sweep, after the decision", "sweep.json", made_anew("sweep.json")),
    Tampering("made anew", "a paint, after the renders", "green/paint.json", made_anew("green/paint.json")),
    # pages and what stands beside
    Tampering(
        "pages", "a number in the report's page", "report.html", text("report.html", "<p>", "<p>x"), in_tree=False
    ),
    Tampering("pages", "the summary", "summary.json", text("summary.json", r"\{", '{"x": 1, '), in_tree=False),
)
