"""What every command says: sentences, one JSON object, or warnings alone; where to look; completion."""

import json
import os
import pty
import re
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from data_schemas import package_version, provenance
from data_schemas.storage import write_record
from finray_calib.cli import _output as output
from finray_calib.cli.main import build_parser, commands, completion_script
from tests.command_line.records import capture_of, press
from tests.command_line.running import documented, finray, succeed

KEYS = {
    *("finray_version", "command", "exit_status", "error", "result", "written"),
    *("open_first", "look_at", "next", "warnings", "text"),
}
COMMANDS = tuple(commands(build_parser()))
# commands that take seconds, on the small laboratory; those of minutes are checked where their own tests run them,
# by tests.command_line.running.require_documented
QUICK = {
    "capture": "capture {lab}/plan.toml --rig {lab}/rig.toml --dry-run",
    "radiometry": "radiometry {lab}/session --out {tmp}/b.json",
    "compare": "compare {lab}/press.json {lab}/capture.json --out {tmp}/e.json",
    "decide": "decide {lab}/sweep.json --photometric-error {lab}/report.json --out {tmp}/d.json",
    "export": "export deck {lab}/finger.toml --dialect calculix --preset coarse --out {tmp}/f.inp",
    "rig init": "rig init --preset simulated --out {tmp}/rig.toml",
    "rig show": "rig show {lab}/rig.toml",
    "design list": "design list",
    "design init": "design init --out {tmp}/f.toml",
    "design show": "design show flat-70x35 --engine scalar --out {tmp}/f.png",
    "trace": "trace {lab}/bands.json",
    "verify": "verify {lab}/session",
    "import captures": "import captures --list",
    "completion": "completion bash",
}
STORES = ("radiometry", "compare", "decide", "export", "rig init", "design init", "design show")


def spoken(arguments: str) -> dict[str, object]:
    """Return the one JSON object that a command prints."""
    outcome = finray(f"{arguments} --json")
    assert outcome.out.count("\n") == 1
    said = json.loads(outcome.out)
    assert set(said) == KEYS
    assert said["exit_status"] == outcome.status
    assert said["finray_version"] == package_version()
    return said


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_prints_one_object_or_nothing_when_it_fails(command):
    said = spoken(f"{command} --no-such-option")
    assert said["command"] == command
    assert said["exit_status"] == 2
    assert said["result"] == {}
    assert "--no-such-option" in said["error"] or "required" in said["error"]
    quiet = finray(f"{command} --no-such-option --quiet")
    assert quiet.out == ""
    assert said["error"] in quiet.err


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_fits_eighty_columns_and_names_both_options(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = succeed(f"{command} --help")
    assert max(map(len, said.splitlines())) <= 80
    assert "--json" in said
    assert "--quiet" in said


@pytest.mark.parametrize("command", QUICK)
def test_the_object_of_a_command_that_succeeds(command, lab, tmp_path):
    said = spoken(QUICK[command].format(lab=lab, tmp=tmp_path))
    assert (said["command"], said["exit_status"], said["error"]) == (command, 0, None)
    assert said["result"]
    assert said["text"]
    assert all(Path(path).exists() for path in said["written"])
    assert bool(said["written"]) == (command in STORES)
    assert said["open_first"] is None or Path(said["open_first"]).exists()
    assert said["look_at"] == said["open_first"]


@pytest.mark.parametrize("command", QUICK)
def test_a_quiet_command_that_succeeds_says_nothing(command, lab, tmp_path):
    assert finray(f"{QUICK[command].format(lab=lab, tmp=tmp_path)} --quiet").out == ""


def test_every_key_of_the_page_is_given_somewhere():
    folder = Path(output.__file__).parent
    source = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    keys = {key for keys in documented().values() for key in keys}
    assert {key for key in keys if not re.search(rf'\b{key}=|"{key}"', source)} == set()


def test_the_numbers_have_their_intervals(lab, tmp_path):
    skill = spoken(QUICK["compare"].format(lab=lab, tmp=tmp_path))["result"]["headline_skill"]
    assert skill["low95"] <= skill["estimate"] <= skill["high95"]


def test_the_options_stand_anywhere_but_behind_two_dashes(tmp_path):
    assert json.loads(finray("--json design list").out)["command"] == "design list"
    assert json.loads(finray("design --json list").out)["exit_status"] == 0
    assert "no such file" in finray(f"fit -- {tmp_path}/--json").err


def test_an_abbreviated_option_and_a_bare_call_print_one_object_too():
    assert json.loads(finray("design list --js").out)["command"] == "design list"
    bare = json.loads(finray("--json").out)
    assert (bare["command"], bare["exit_status"]) == ("", 2)
    assert any("Start with: finray demo" in line for line in bare["text"])


def test_the_command_in_the_record_lacks_both(lab, tmp_path):
    succeed(f"decide {lab}/sweep.json --out {tmp_path}/d.json --quiet")
    stored = json.loads((tmp_path / "d.json").read_text())
    assert stored["record"]["provenance"]["command"] == f"finray decide {lab}/sweep.json --out {tmp_path}/d.json"


def test_the_last_line_says_where_to_look(lab, tmp_path):
    said = succeed(QUICK["compare"].format(lab=lab, tmp=tmp_path)).splitlines()
    assert said[-2:] == [f"next: finray decide SWEEP --photometric-error {tmp_path}/e.json",
                         f"look at: {tmp_path}/e.html"]  # fmt: skip


def test_a_report_that_a_decision_refuses_names_no_decision_as_next(tmp_path):
    """As of a render of another simulator, of which neither paints nor camera are known."""
    unknown = press()
    write_record(unknown, tmp_path / "p.json", provenance("pytest"))
    write_record(capture_of(unknown, 30.0), tmp_path / "c.json", provenance("pytest"))
    assert "next:" not in succeed(f"compare {tmp_path}/p.json {tmp_path}/c.json --out {tmp_path}/e.json")


def on_terminal(arguments: str, **environment: str) -> str:
    """Return what a terminal of 80 columns shows of a command, with its control sequences."""
    main, child = pty.openpty()
    words = [sys.executable, "-P", "-m", "finray_calib.cli.main", *arguments.split()]
    given = {**os.environ, "TERM": "xterm", "COLUMNS": "80", **environment}
    process = subprocess.Popen(words, stdout=child, stderr=child, stdin=subprocess.DEVNULL, env=given)
    os.close(child)
    shown = b""
    with suppress(OSError):  # how the end of a terminal reads
        while part := os.read(main, 65536):
            shown += part
    os.close(main)
    assert process.wait(timeout=100.0) in (0, 1, 2)
    return shown.decode().replace("\r\n", "\n")


def test_a_terminal_gets_lines_of_eighty_columns(lab, tmp_path):
    shown = on_terminal(f"decide {lab}/sweep.json --out {tmp_path}/d.json")
    paths = [word for word in shown.split() if len(word) > 40]
    assert all(len(line) <= 80 or any(path in line for path in paths) for line in shown.splitlines())
    assert any(len(line) > 80 for line in succeed(f"decide {lab}/sweep.json --out {tmp_path}/e.json").splitlines())


def test_colours_are_for_a_terminal_only_and_not_with_no_color(lab, tmp_path):
    for source in (lab / "report.json", *lab.glob("report.*.npz")):
        changed = source.read_bytes().replace(b"strip", b"strap")
        (tmp_path / source.name).write_bytes(changed)
    command = f"trace {tmp_path}/report.json"  # was changed: a terminal shows that in red
    assert "\x1b[31m" in on_terminal(command)
    assert "\x1b[31m" not in on_terminal(command, NO_COLOR="1")
    assert "\x1b" not in finray(command).out


def test_a_bar_moves_before_anything_is_counted(monkeypatch):
    class Terminal:
        def __init__(self):
            self.frames = []

        def write(self, text):
            self.frames.append(re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text))
            return len(text)

        def flush(self):
            pass

        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", terminal)
    output.begin([])
    with output.progress_bar("fit") as progress:
        progress(0, 2, "first half")
        deadline = time.monotonic() + 20.0
        while len({frame for frame in terminal.frames if "fit" in frame}) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
    shown = {frame for frame in terminal.frames if "fit" in frame}
    assert len(shown) >= 3
    assert not any(" 0 %" in frame or " 0%" in frame for frame in shown)


def complete(folder: Path, *words: str) -> set[str]:
    """Return what bash offers after these words of a command line, the last one unfinished."""
    script = completion_script(build_parser(), "bash")
    ask = f'COMP_WORDS=("$@"); COMP_CWORD={len(words) - 1}; _finray; printf "%s\\n" "${{COMPREPLY[@]}}"'
    shell = ["bash", "-c", f"{script}\n{ask}", "bash", *words]
    done = subprocess.run(shell, cwd=folder, capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()) - {""}


def test_bash_completes_commands_options_and_choices(tmp_path):
    assert complete(tmp_path, "finray", "d") == {"decide", "design", "doctor", "demo"}
    assert complete(tmp_path, "finray", "simulate", "") == {"fit", "grasp", "press", "render", "sweep", "teach"}
    assert complete(tmp_path, "finray", "simulate", "press", "--cont") == {"--contact"}
    assert complete(tmp_path, "finray", "simulate", "press", "--contact", "") == {"auto", "penalty", "barrier"}
    # where a file is wanted nothing is offered, and bash offers files
    assert complete(tmp_path, "finray", "fit", "b") == set()
    for command in COMMANDS:
        assert {"--json", "--quiet"} <= complete(tmp_path, "finray", *command.split(), "--")


def test_bash_completes_a_choice_of_two_words_as_one(tmp_path):
    """The halves, which were offered, are no choices; the blank is typed as the shell wants it."""
    assert complete(tmp_path, "finray", "study", "dataset", "--press", "") == {"analytic", "finite\\ elements"}
    assert complete(tmp_path, "finray", "study", "dataset", "--press", "fi") == {"finite\\ elements"}


def test_the_script_is_not_folded_on_a_terminal():
    assert completion_script(build_parser(), "bash") in on_terminal("completion bash")


def test_zsh_gets_the_same_script_behind_its_own_loader():
    shared = completion_script(build_parser(), "bash")
    assert completion_script(build_parser(), "zsh").endswith(shared)
    assert "bashcompinit" not in shared
