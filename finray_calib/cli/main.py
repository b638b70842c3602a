"""The command ``finray``: six verbs, one per stage, what stands beside them, and the script that completes them."""

import argparse
import atexit
import difflib
import errno
import gc
import itertools
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from data_schemas import FinrayError, ProcessDiedError, RecordError, keeping_options, system_words
from data_schemas.storage import OBJECTS_PER_COLLECTION, given_path
from finray_calib.cli import (
    add_bench,
    add_capture,
    add_certificate,
    add_check,
    add_compare,
    add_decide,
    add_demo,
    add_design,
    add_doctor,
    add_export,
    add_fit,
    add_fit_material,
    add_history,
    add_import,
    add_live,
    add_radiometry,
    add_recolour,
    add_rig,
    add_sense,
    add_simulate,
    add_study,
    add_trace,
    add_verify,
    current_spelling,
)
from finray_calib.cli._output import AS_JSON, QUIET, WIDTH, begin, fail, finish, give, say

USER_MISTAKE = 2
DIED = 3
INTERRUPTED = 130
TO_DO = {
    errno.ENOSPC: "free space on the disk, then run the command again",
    errno.EDQUOT: "your share of the disk is used up: free space, then run the command again",
    errno.EFBIG: "the file system, or 'ulimit -f', allows no larger file: write to another --out",
    errno.EIO: "the disk or the network folder has a fault ('dmesg' shows it): write to another --out",
    errno.EROFS: "this disk can only be read: write to another --out",
    errno.ENOMEM: "close other programs, then run the command again",
    errno.EMFILE: "allow more open files with 'ulimit -n 4096', then run the command again",
    errno.ENFILE: "close other programs, then run the command again",
    errno.EPIPE: "a process that finray talked to has ended: run the command again",
    errno.ECONNRESET: "a process that finray talked to has ended: run the command again",
}
"""What to do about an error of the operating system that names no file."""
COMPLETION_HELP = "print the script by which bash or zsh completes what you type"
COMPLETION_DESCRIPTION = """\
Print a script by which the shell completes commands, options and the choices of options when you press Tab; where a
file is wanted it completes files. Load it in the start file of your shell:

  bash   echo 'source <(finray completion bash)' >> ~/.bashrc
  zsh    echo 'source <(finray completion zsh)' >> ~/.zshrc"""
FOR_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
COMPLETION = """\
_finray() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" command="" word words=""
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case "$command $word" in
      {commands}) command="$command $word" ;;
    esac
  done
  case "$command|$current" in
{options}
  esac
  case "$command $before" in
{choices}
  esac
  COMPREPLY=()
  while IFS= read -r word; do COMPREPLY+=("${{word// /\\\\ }}"); done < <(compgen -W "$words" -- "$current")
}}
complete -o default -F _finray finray
"""


def add_completion(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("completion", help=COMPLETION_HELP, description=COMPLETION_DESCRIPTION)
    parser.add_argument("shell", choices=["bash", "zsh"], help="your shell")
    parser.set_defaults(run=run_completion)


def run_completion(arguments: argparse.Namespace) -> None:
    """Print the script."""
    script = completion_script(build_parser(), arguments.shell)
    give(shell=arguments.shell, script=script)
    say(script.rstrip("\n"), fold=False)


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the script for a shell, "bash" or "zsh", of what a parser understands."""
    rooms = dict(_rooms(parser, ""))
    options, choices = [], []
    for command, room in rooms.items():
        known = room._actions  # noqa: SLF001 - argparse offers no other way to what it knows
        first = " ".join(str(word) for action in known if not action.option_strings for word in action.choices or ())
        flags = " ".join(flag for action in known for flag in action.option_strings if flag.startswith("--"))
        options += [f'    "{command}|-"*) words="{flags}" ;;', f'    "{command}|"*) words="{first}" ;;']
        for action in known:
            if action.option_strings and action.choices:
                chosen = " ".join(str(choice).replace(" ", "\\ ") for choice in action.choices)
                choices += [f'    "{command} {flag}") words="{chosen}" ;;' for flag in action.option_strings]
    names = "|".join(f'"{command}"' for command in rooms if command)
    script = COMPLETION.format(commands=names, options="\n".join(options), choices="\n".join(choices))
    return FOR_ZSH + script if shell == "zsh" else script


def _rooms(parser: argparse.ArgumentParser, command: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield each command, a blank before each of its words, with its parser; the first is empty."""
    yield command, parser
    for name, inner in _verbs(parser).items():
        yield from _rooms(inner, f"{command} {name}")


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return what a parser has below it."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]  # noqa: SLF001
    return dict(below[0].choices) if below else {}


VERBS = {
    "capture": add_capture,
    "radiometry": add_radiometry,
    "fit": add_fit,
    "fit-material": add_fit_material,
    "simulate": add_simulate,
    "recolour": add_recolour,
    "compare": add_compare,
    "bench": add_bench,
    "sense": add_sense,
    "decide": add_decide,
    "import": add_import,
    "export": add_export,
    "rig": add_rig,
    "live": add_live,
    "check": add_check,
    "history": add_history,
    "certificate": add_certificate,
    "design": add_design,
    "study": add_study,
    "doctor": add_doctor,
    "trace": add_trace,
    "verify": add_verify,
    "demo": add_demo,
    "completion": add_completion,
}
DESCRIPTION = """\
Calibrate fluorescent-paint tactile fingers: from a painted sample to a decision on the light angle.

  capture -> radiometry -> fit -> simulate -> compare -> decide

Each verb reads stored records and writes the next one.

Start with: finray demo"""


class _Parser(argparse.ArgumentParser):
    """A parser whose help fits 80 columns and whose errors a program can read too."""

    def __init__(self, *given: Any, **options: Any) -> None:
        options["formatter_class"] = _Help
        super().__init__(*given, **options)
        self.register("type", Path, _path)

    def error(self, message: str) -> NoReturn:
        """Print the usage and what is wrong with it, and end with exit status 2."""
        self.print_usage(sys.stderr)
        fail(f"{self.prog}: error: {_with_a_guess(message)} '{self.prog} --help' explains the options")
        raise SystemExit(USER_MISTAKE)


def _path(text: str) -> Path:
    """Parse a path; a shell leaves the ~ of ``--out=~/x`` as it is."""
    try:
        return given_path(text, "path")
    except RecordError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class _Help(argparse.HelpFormatter):
    """Help in at most 80 columns: paragraphs are filled, and indented lines stay lines."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=min(shutil.get_terminal_size().columns, WIDTH) - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = []
        for is_prose, found in itertools.groupby(text.splitlines(), lambda line: line[:1] not in ("", " ")):
            group = list(found)
            lines += [_filled(line, width) for line in ([" ".join(group)] if is_prose else group)]
        return "\n".join(lines)


def _filled(line: str, width: int) -> str:
    """Return a paragraph in lines that fit; what goes on stands below the text of its column."""
    column = re.match(r" +\S+ {2,}(?=\S)", line)
    return textwrap.fill(
        line, width, subsequent_indent=" " * (column.end() if column else 0), replace_whitespace=False,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip


def _with_a_guess(message: str) -> str:
    """Return the message of a wrong choice with the choice that was probably meant, and of a wrong number in words."""
    message = re.sub(r"invalid int value: ('[^']*')", r"\1 must be a whole number", message)
    message = re.sub(r"invalid float value: ('[^']*')", r"\1 must be a number, with a decimal point", message)
    follows = r"\1: a value must follow it; if the value begins with '-', type \1=-VALUE"
    message = re.sub(r"argument (\S+): expected one argument", follows, message)
    message = message.replace("--angles=-VALUE", "--angles=-60:100:10")
    wrong = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
    near = difflib.get_close_matches(wrong.group(1).lower(), re.findall(r"[^', ]+", wrong.group(2)), 1) if wrong else []
    return f"{message}; did you mean '{near[0]}'?" if near else f"{message};"


def _meant(unknown: list[str], parser: argparse.ArgumentParser, command: str) -> str:
    """Return what was probably meant by words that nothing takes."""
    leaf = commands(parser).get(command, parser)
    flags = [flag for action in leaf._actions for flag in action.option_strings]  # noqa: SLF001
    near = difflib.get_close_matches(unknown[0].partition("=")[0], flags, 1, cutoff=0.75)
    if near:
        return f"did you mean '{near[0]}'? "
    if re.match(r"(red|green)=", unknown[0]):
        return "write --paint before each COLOUR=FILE; "
    if "--rig" in flags and unknown[0].endswith(".toml") and Path(unknown[0]).exists():
        return "write --rig before a rig file; "
    return "" if unknown[0].startswith("-") else "put a path with spaces in quotes; "


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line; heavy packages are not imported here."""
    parser: argparse.ArgumentParser = _Parser(prog="finray", description=DESCRIPTION)
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    for add_verb in VERBS.values():
        add_verb(verbs)
    parser.set_defaults(command="")
    for name, leaf in commands(parser).items():
        leaf.set_defaults(command=name)
        group = leaf.add_argument_group("what is printed")
        group.add_argument(AS_JSON, action="store_true", help="print one JSON object in place of sentences")
        group.add_argument(QUIET, action="store_true", help="print warnings and errors only")
    return parser


def commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return command -> its parser for everything that can be run: ``fit``, ``simulate press`` and so on."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]  # noqa: SLF001
    if not inner:
        return {parser.prog.removeprefix("finray "): parser}
    return {name: leaf for choice in inner[0].choices.values() for name, leaf in commands(choice).items()}


def main(arguments: Sequence[str] | None = None, in_own_process: bool = False) -> int:
    """Run the command line, a long verb in a process of its own if that is wanted, and return its exit status.

    0, 1 for a rig that is not accepted, records that are not whole or a machine that cannot run the demo, 2 for a
    user's mistake, 3 when the process of a long stage died, 130 when interrupted.
    """
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    words = current_spelling(begin(sys.argv[1:] if arguments is None else arguments))
    try:
        command, status = _run(words, in_own_process)
        finish(command, status)
    except FinrayError as error:  # standard output takes nothing more
        fail(f"finray: error: {_one_line(error)}")
        return USER_MISTAKE
    return status


def _run(words: list[str], in_own_process: bool) -> tuple[str, int]:
    """Run a command; return its name without options, and its exit status."""
    parser = build_parser()
    try:
        parsed, unknown = parser.parse_known_args(words)
    except SystemExit as stop:  # how argparse ends, after a help text or an error
        if not stop.code:
            raise
        known = {" ".join(name.split()[:k]) for name in commands(parser) for k in (1, 2)}
        return max((" ".join(words[:k]) for k in (1, 2) if " ".join(words[:k]) in known), default=""), USER_MISTAKE
    command: str = parsed.command
    if getattr(parsed, "json", False) or getattr(parsed, "quiet", False):  # abbreviated, so that begin() did not see it
        begin([AS_JSON] * parsed.json + [QUIET] * parsed.quiet)
    if unknown:
        named = f"finray {command}".strip()
        told = f"'{named}' does not take {' '.join(unknown)}; {_meant(unknown, parser, command)}"
        fail(f"{' '.join(named.split()[:2])}: error: {told}'{named} --help' lists what can be given")
        return command, USER_MISTAKE
    if parsed.verb is None and not parsed.version:
        say(parser.format_help().rstrip("\n"))
        return command, USER_MISTAKE
    try:
        return command, _work(parsed, words, in_own_process)
    except (FinrayError, OSError) as error:
        fail(f"finray {parsed.verb or '--version'}: error: {_one_line(error)}")
        return command, DIED if isinstance(error, ProcessDiedError) else USER_MISTAKE
    except KeyboardInterrupt:
        fail(f"finray {parsed.verb}: interrupted; files already written are complete")
        return command, INTERRUPTED


def _work(parsed: argparse.Namespace, words: list[str], in_own_process: bool) -> int:
    """Do what was asked for."""
    if parsed.version:
        from data_schemas import package_version

        say(f"finray {package_version()}")
        return 0
    describe = getattr(parsed, "long_work", None)
    if in_own_process and describe is not None:
        from finray_calib.cli._run import run_in_own_process

        return run_in_own_process(describe(parsed), words)
    with keeping_options():
        return int(parsed.run(parsed) or 0)


def _one_line(error: Exception) -> str:
    """Return the message in one line; errors of the operating system name the file and what to check."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        is_long = error.errno == errno.ENAMETOOLONG
        todo = "give a shorter name" if is_long else "check the path, its permissions and the space on the disk"
        text = f"{error.filename}: {error.strerror}; {todo}"
    elif isinstance(error, OSError):
        todo = TO_DO.get(error.errno or 0, "'finray doctor' lists what this computer lacks")
        text = f"this computer: {system_words(error)}; {todo}"
    return " ".join(text.split())


def program() -> int:
    """Run :func:`main` as a process of its own, which ends without a last search for cycles: a tenth of a fit."""
    atexit.register(gc.freeze)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started us, as service managers may
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))
    return main(in_own_process=True)


if __name__ == "__main__":
    sys.exit(program())
