"""Bad input: one clear line that names the file and what to do, status 2, and nothing on the disk is changed."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from data_schemas import CaptureError, RecordError
from data_schemas.storage import sha256_of
from finray_calib.cli._run import interruptible
from rigs import SystemClock
from rigs.capture import JOURNAL_NAME, read_session
from rigs.capture._journal import Journal
from tests.command_line.mistakes import CASES, USAGE, Case, edited
from tests.command_line.running import finray, tree

COMMAND = Path(sys.executable).with_name("finray")


@pytest.fixture
def places(lab: Path, paints: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """The folders a case may name; the working directory is the empty-handed one, so that a default --out shows."""
    monkeypatch.chdir(tmp_path)
    return {"lab": lab, "paints": paints, "tmp": tmp_path}


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.what)
def test_user_mistake_is_one_line_and_changes_nothing(case: Case, places: dict[str, Path]) -> None:
    if case.prepare is not None:
        case.prepare(places["lab"], places["tmp"])
    before = tree(*places.values())
    outcome = finray(case.arguments.format(**places))
    assert outcome.status == 2
    assert outcome.out == ""
    assert outcome.err.startswith(f"finray {case.arguments.split()[0]}: error: ")
    assert outcome.err.count("\n") == 1
    assert outcome.err.endswith("\n")
    assert re.search(case.message, outcome.err), outcome.err
    assert tree(*places.values()) == before


@pytest.mark.parametrize("case", USAGE, ids=lambda c: c.what)
def test_wrong_usage_shows_the_usage_and_changes_nothing(case: Case, places: dict[str, Path]) -> None:
    before = tree(*places.values())
    outcome = finray(case.arguments.format(**places))
    assert outcome.status == 2
    assert outcome.err.startswith("usage: finray")
    assert re.search(case.message, outcome.err.splitlines()[-1]), outcome.err
    assert tree(*places.values()) == before


def test_folder_that_may_not_be_written_to(places: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    # permissions do not bind root, who runs tests in many containers
    monkeypatch.setattr("os.access", lambda path, mode: False)
    outcome = finray("fit {lab}/bands.json --out {tmp}/below/paint.json".format(**places))
    assert outcome.status == 2
    assert re.search(r"below/paint\.json: cannot be written, because the folder \S+ is not writable; cho", outcome.err)


def test_capture_that_is_too_bright_says_what_to_do(places: dict[str, Path]) -> None:
    slow = edited("rig.toml", "shortest_exposure_s = 0.0001", "shortest_exposure_s = 0.1")
    slow(places["lab"], places["tmp"])
    outcome = finray("capture {lab}/plan.toml --rig {tmp}/rig.toml --out {tmp}/session".format(**places))
    assert outcome.status == 2
    assert re.search(
        r"through filter \d+: the region is brighter than 70 % .* allows 0\.1 to 25\.6 s\); dim", outcome.err
    )
    again = finray("radiometry {tmp}/session".format(**places))
    assert re.search(r"was not finished .* the last line of journal\.jsonl says why", again.err)
    assert "SaturatedError" in (places["tmp"] / "session/journal.jsonl").read_text().splitlines()[-1]


def test_real_process_prints_no_traceback(places: dict[str, Path]) -> None:
    done = subprocess.run(
        [COMMAND, "fit", places["lab"] / "plan.toml"], capture_output=True, text=True, timeout=600, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"finray fit: error: \S+plan\.toml: cannot be read as JSON .*\n", done.stderr)


def test_folder_of_another_capture_is_not_offered_for_resuming(
    places: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """While the other capture runs, this command would be refused: its session is not ours to continue."""
    out = places["tmp"] / "session"
    out.mkdir()
    (out / JOURNAL_NAME).write_text("{}\n")  # by the other capture, since this one looked for the folder
    with pytest.raises(CaptureError, match="choose another --out"), interruptible(out):
        Journal(out, SystemClock())
    with (
        pytest.raises(CaptureError, match="another capture is writing into this folder"),
        Journal(out, SystemClock(), resumed=True),
        interruptible(out),
    ):
        Journal(out, SystemClock(), resumed=True)
    assert "--resume" not in capsys.readouterr().err


def test_a_shell_takes_the_command_that_continues_a_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "red paint"
    out.mkdir()
    (out / JOURNAL_NAME).write_text("{}\n")
    with pytest.raises(KeyboardInterrupt), interruptible(out):
        raise KeyboardInterrupt
    command = capsys.readouterr().err.partition("continue with: ")[2]
    assert shlex.split(command) == ["finray", "capture", "--resume", str(out)]
    with pytest.raises(RecordError) as refused:
        read_session(out)
    assert shlex.split(str(refused.value).rpartition("Continue with '")[2].removesuffix("'"))[2:] == [
        "--resume",
        str(out),
    ]


def test_interrupted_capture_leaves_whole_files(lab: Path, tmp_path: Path) -> None:
    out = tmp_path / "session"
    arguments = [COMMAND, "capture", lab / "plan.toml", "--rig", lab / "rig.toml", "--out", out]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 600
    while len(list(out.glob("frames/*.tiff"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    said, complaint = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "Recovery from faults may add up to" in said
    assert "frames of" not in said
    way_on = f"{out}: holds what was captured so far; continue with: finray capture --resume {out}\n"
    # a busy machine takes long enough for a line of progress before it
    assert complaint.endswith(f"{way_on}finray capture: interrupted; files already written are complete\n")
    assert not list(out.rglob("*.part"))
    assert not (out / "session.json").exists()
    events = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    noted = {event["file"]: event["sha256"] for event in events if event["event"] == "frame"}
    assert len(noted) >= 4
    assert all(sha256_of(out / name) == digest for name, digest in noted.items())
    # the interrupt may fall between a frame and its line in the journal
    assert len(list(out.glob("frames/*"))) - len(noted) in {0, 1}
    assert events[-1]["outcome"].startswith("KeyboardInterrupt")
    assert "the capture was not finished" in finray(f"radiometry {out}").err
