"""``finray bench``: score any simulator on any captures by one protocol: few presses teach, the others judge."""

import argparse
import contextlib
import csv
import hashlib
import io
import json
import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finray_calib.cli._output import give, say, suggest_file, wrote
from finray_calib.cli._run import add_out, add_seed, command_line, distinct_file_names, require_new, require_place

if TYPE_CHECKING:
    from data_schemas import ComparisonBatch, SimulatedPress, TactileCapture
    from sim.experiments import GelParameter

BENCH_HELP = "score a simulator on captures that it has not seen, by a fixed protocol"
TACTILE_DESCRIPTION = """\
Score a simulator on a set of tactile captures. At most six presses, spread over the set, may train it, and it is
judged on all others. Your command is run once, with these words replaced by folders:

  {teach}    a folder for each training press: contact.png, no_contact.png, press.json
  {judge}    a folder for each judged press: no_contact.png and press.json, without the contact
  {renders}  where your command writes a folder for each judged press, under the name of the press, with the files that
             'finray import render' reads

Your simulator is scored beside a look-up table trained on the same presses, and beside doing nothing, which scores 0.
With --elastic-gel it is also scored beside a physical model that is fitted to these presses: a ball in an elastic
layer under three lights. A press whose image was used for training is never judged. OUT will hold the page of the
comparison (scores/summary.html), and row.json and row.csv with the skill and its interval, the digests of all captures,
the command and the time that it took. A run that was interrupted or failed starts from the beginning when the same OUT
is given again."""
_ENDS_WITHIN_S = 2.0
TABLE, BLANK = "table of the training presses", "doing nothing"
GEL = "elastic gel under three lights"
MOST_TEACHING = 6
CAPTURE = ".capture.json"
ASKED, ROW = "asked.json", "row.json"
"""The first file of a run, which says what was asked, and its last."""
_MADE = ("protocol", "renders", "presses", "pairs.csv", "scores", "row.csv")
_COLUMNS = ("set", "simulator", "skill", "low95", "high95", "presses", "taught", "table", "seconds", "captures_sha256")


def add_bench(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its job."""
    parser = verbs.add_parser("bench", help=BENCH_HELP, description=BENCH_HELP)
    jobs = parser.add_subparsers(dest="job", metavar="JOB", title="jobs", required=True)
    tactile = jobs.add_parser("tactile", help=BENCH_HELP, description=TACTILE_DESCRIPTION)
    tactile.add_argument(
        "captures",
        type=Path,
        metavar="CAPTURES",
        help="folder of captures (NAME.capture.json), or a zip archive of it",
    )
    tactile.add_argument("--simulator", metavar="NAME", help="name of your simulator in the results (needs --command)")
    tactile.add_argument(
        "--command", dest="simulator_command", metavar="WORDS",
        help="command that runs your simulator, as one string (default: none, so that only finray's own rows are "
             "scored)",
    )  # fmt: skip
    tactile.add_argument("--teach", type=int, default=MOST_TEACHING, metavar="N", help="training presses (default: 6)")
    tactile.add_argument(
        "--elastic-gel", action="store_true",
        help="also fit finray's physical model of a gel to the training presses (which must be presses of a ball, "
             "with contact circles)",
    )  # fmt: skip
    tactile.add_argument(
        "--limit-s", type=float, default=3600.0, metavar="S", help="time limit of the command in s (default: 3600)"
    )
    add_out(tactile, "CAPTURES.bench, a folder")
    add_seed(tactile)
    tactile.set_defaults(run=run_bench_tactile)


def run_bench_tactile(arguments: argparse.Namespace) -> None:
    """Split, let the simulator render, compare, and write the row."""
    from data_schemas import CompareError, ComparisonBatch
    from data_schemas.storage import ProductSet, read_record
    from finray_calib.cli._compare_folders import PAGE, SUMMARY, compare_folders

    if (arguments.simulator_command is None) != (arguments.simulator is None):
        raise CompareError(
            "--simulator NAME and --command WORDS must be given together; give both, or neither to score only "
            "finray's own rows"
        )
    if arguments.simulator in (TABLE, BLANK, GEL):
        raise CompareError(
            f"--simulator {arguments.simulator!r} is already the name of one of finray's own rows; give your "
            "simulator another name"
        )
    if arguments.simulator_command is not None:
        _words(arguments.simulator_command)
    if not arguments.limit_s > 0:
        raise CompareError(
            f"--limit-s {arguments.limit_s:g}: must be above 0 s; give the time that the command may take"
        )
    folder, captures = _captures(arguments.captures)
    name = arguments.captures.resolve().name.removesuffix(".zip")
    taught, judged = _split(captures, arguments.teach)
    out = _begin(arguments.out or Path(f"{name}.bench"), arguments)
    gel, numbers = _of_gel(captures, taught, judged) if arguments.elastic_gel else ({}, ())
    seconds, presses = _presses(arguments, out, captures, taught, judged)
    presses |= gel
    _store(out, presses, arguments.seed)
    listed = _pairs_csv(out, presses, folder)
    scores = out / "scores"
    options = dict.fromkeys(("register", "despite_mismatch", "relative"), False)
    compare_folders(
        argparse.Namespace(**options, pairs=listed, out=scores, seed=arguments.seed, normal_map=None, scale=None)
    )
    batch = read_record(scores / SUMMARY, ComparisonBatch)
    row = _row(arguments, batch, captures, taught, seconds, numbers)
    with ProductSet(out / ROW) as products:
        products.add(out / "row.csv", _as_csv(row).encode())
        products.add(out / ROW, (json.dumps(row, indent=1, sort_keys=True) + "\n").encode())
    say(_as_csv(row).rstrip())
    wrote(out, "holds row.json, row.csv and scores/summary.html")
    give(row=row)
    suggest_file(scores / PAGE)


def _begin(out: Path, arguments: argparse.Namespace) -> Path:
    """Return the folder to write: new, or what an interrupted run left, less all that it had made.

    A folder counts as left by a run where it says what was asked and has no row yet; files of others in it stay.
    """
    from data_schemas.storage import clear_leftovers, write_bytes

    for folder in (out, *(path for path in out.glob("**/*") if path.is_dir())):
        clear_leftovers(folder)
    if (out / ASKED).is_file() and not (out / ROW).exists():
        for name in _MADE:
            _remove(out / name)
        (out / ASKED).unlink()
    elif not (out.is_dir() and not any(out.iterdir())):
        require_new(out)
    require_place(out / ROW)
    out.mkdir(parents=True, exist_ok=True)
    asked = {"captures": str(arguments.captures.resolve()), "teach": arguments.teach, "seed": arguments.seed,
             "simulator": arguments.simulator, "command": arguments.simulator_command,
             "elastic_gel": arguments.elastic_gel}  # fmt: skip
    write_bytes(out / ASKED, (json.dumps(asked, indent=1) + "\n").encode())
    return out


def _remove(path: Path) -> None:
    """Remove a file, a link (not what it leads to) or a folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _captures(place: Path) -> "tuple[Path, dict[str, TactileCapture]]":
    """Return the folder of captures, and those whose contact is known."""
    from data_schemas import CompareError, TactileCapture
    from data_schemas.storage import files_in, folder_at, read_record

    if not place.exists():
        raise CompareError(f"{place}: no such folder; give the folder that 'finray import captures' wrote")
    folder = folder_at(place, CompareError) or place
    files = files_in(folder, CAPTURE)
    read = {file.name.removesuffix(CAPTURE): read_record(file, TactileCapture) for file in files}
    known = {n: c for n, c in read.items() if c.contact_circle is not None or c.contact_outline is not None}
    if len(known) < 2:
        raise CompareError(
            f"{place}: only {len(known)} captures state where the contact is, but at least 2 are needed; import a set "
            "with 'finray import captures'"
        )
    return folder, known


def _split(captures: "Mapping[str, TactileCapture]", count: int) -> tuple[list[str], list[str]]:
    """Return the names of teaching and judged presses; no image is in both."""
    from data_schemas import CompareError
    from finray_calib.compare import spread_over
    from finray_calib.sensing import contact_sha256

    names = list(captures)
    most = min(MOST_TEACHING, len(names) - 1)
    if not 1 <= count <= most:
        raise CompareError(
            f"--teach {count}: must be 1 to {most} for {len(names)} presses; the simulator is judged on the presses "
            "that are not used for training"
        )
    taught = [names[i] for i in spread_over(len(names), count)]
    seen = {contact_sha256(captures[name]) for name in taught}
    judged = [name for name in names if contact_sha256(captures[name]) not in seen]
    if not judged:
        raise CompareError(
            "no press is left to judge the simulator on, because every contact image is also used for training; give "
            "a set with more presses, or a smaller --teach"
        )
    return taught, judged


def _presses(
    arguments: argparse.Namespace,
    out: Path,
    captures: "Mapping[str, TactileCapture]",
    taught: Sequence[str],
    judged: Sequence[str],
) -> "tuple[float | None, dict[str, dict[str, SimulatedPress]]]":
    """Return seconds of the command, and simulator -> press -> what it makes of the press."""
    from data_schemas import CompareError
    from finray_calib.compare import predict_press, train_table
    from finray_calib.exchange import read_renders

    table = train_table([captures[name] for name in taught])
    of_table = {name: predict_press(table, captures[name]) for name in judged}
    blank = {
        name: press.model_copy(update={"contact": press.no_contact, "label": BLANK, "notes": ()})
        for name, press in of_table.items()
    }
    presses = {TABLE: of_table, BLANK: blank}
    if arguments.simulator_command is None:
        return None, presses
    protocol, renders = out / "protocol", out / "renders"
    _write_requests(protocol, captures, taught, judged)
    seconds = _run_simulator(arguments, protocol, renders)
    unasked = sorted({inner.name for inner in renders.iterdir() if inner.is_dir()} - set(judged))
    if unasked:
        raise CompareError(
            f"{renders}: contains {unasked[0]}, which is not a judged press; render only the presses in "
            f"{protocol / 'judge'}"
        )
    rendered = read_renders(renders, {name: captures[name] for name in judged})
    missing = sorted(set(judged) - rendered.keys())
    if missing:
        raise CompareError(
            f"{renders}: {len(missing)} of {len(judged)} judged presses are missing ({', '.join(missing[:5])}); "
            f"render all of them, because the score needs every press"
        )
    return seconds, {arguments.simulator: rendered, **presses}


def _of_gel(
    captures: "Mapping[str, TactileCapture]", taught: Sequence[str], judged: Sequence[str]
) -> "tuple[dict[str, dict[str, SimulatedPress]], tuple[GelParameter, ...]]":
    """Return what our model of a gel predicts, and the numbers that the training presses gave it."""
    from sim.experiments import fit_gel, predict_on_gel

    say(f"fitting {GEL} to {len(taught)} presses, which takes a minute or two")
    gel = fit_gel([captures[name] for name in taught])
    for number in gel.numbers:
        unit = "" if number.unit == "1" else f" {number.unit}"
        say(f"  {number.name}: {number.value:.3g} [{number.low95:.3g}, {number.high95:.3g}]{unit}")
    return {GEL: {name: predict_on_gel(gel, captures[name]) for name in judged}}, gel.numbers


def _write_requests(
    protocol: Path, captures: "Mapping[str, TactileCapture]", taught: Sequence[str], judged: Sequence[str]
) -> None:
    """Write what the simulator may see."""
    from data_schemas.storage import ProductSet
    from finray_calib.exchange import press_request

    with ProductSet(protocol) as products:
        for part, names in (("teach", taught), ("judge", judged)):
            for name in names:
                for file, content in press_request(captures[name], part == "teach").items():
                    products.add(protocol / part / name / file, content)


def _words(command: str) -> list[str]:
    """Return the program of a command and its arguments."""
    from data_schemas import CompareError

    try:
        words, fault = shlex.split(command), "no program"
    except ValueError as error:
        words, fault = [], str(error)
    if not words:
        raise CompareError(
            f"--command: {command!r} cannot be split into words ({fault}); give a program and its arguments, and close "
            "every quotation mark"
        )
    return words


def _run_simulator(arguments: argparse.Namespace, protocol: Path, renders: Path) -> float:
    """Run the user's command without a shell, and return its wall time, s."""
    from data_schemas import CompareError

    places = {"{teach}": protocol / "teach", "{judge}": protocol / "judge", "{renders}": renders}
    words = _words(arguments.simulator_command)
    for mark, place in places.items():
        words = [word.replace(mark, str(place.resolve())) for word in words]
    renders.mkdir(parents=True)
    start = time.monotonic()
    try:
        # a group of its own: what a script has started is ended with it, on Ctrl-C too
        with subprocess.Popen(words, stdin=subprocess.DEVNULL, process_group=0) as process:
            try:
                status = process.wait(arguments.limit_s)
            except BaseException:
                _end_group(process)
                raise
    except subprocess.TimeoutExpired:
        raise CompareError(
            f"--command: ran longer than {arguments.limit_s:g} s; raise --limit-s, or give fewer presses"
        ) from None
    except (OSError, ValueError) as error:
        raise CompareError(f"--command: {words[0]} cannot be run ({error}); correct the program's name") from None
    if status:
        raise CompareError(f"--command: failed with exit status {status}; see its output above for the reason")
    return time.monotonic() - start


def _end_group(process: "subprocess.Popen[bytes]") -> None:
    """End a program and what it has started: politely, then by force."""
    with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(_ENDS_WITHIN_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def _store(out: Path, presses: "Mapping[str, Mapping[str, SimulatedPress]]", seed: int) -> None:
    """Store every simulated press."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, write_record

    folders = distinct_file_names(presses)
    origin = provenance(command_line(), {}, seed)
    with ProductSet(out / "presses") as products:
        for simulator, of in presses.items():
            for name, press in of.items():
                write_record(press, out / "presses" / folders[simulator] / f"{name}.press.json", origin, products)


def _pairs_csv(out: Path, presses: "Mapping[str, Mapping[str, SimulatedPress]]", captures: Path) -> Path:
    """Write the list of pairs, and return it."""
    from data_schemas.storage import ProductSet

    folders, text = distinct_file_names(presses), io.StringIO(newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("simulator", "name", "simulated", "captured"))
    for simulator, of in presses.items():
        for name in of:
            captured = (captures / f"{name}{CAPTURE}").resolve()
            table.writerow((simulator, name, f"presses/{folders[simulator]}/{name}.press.json", captured))
    path = out / "pairs.csv"
    with ProductSet(path) as products:
        products.add(path, text.getvalue().encode())
    return path


def _row(
    arguments: argparse.Namespace,
    batch: "ComparisonBatch",
    captures: "Mapping[str, TactileCapture]",
    taught: Sequence[str],
    seconds: float | None,
    numbers: "Sequence[GelParameter]",
) -> dict[str, Any]:
    """Return the row of the table, sealed by the SHA-256 of its other entries."""
    from data_schemas import package_version
    from finray_calib.sensing import contact_sha256

    named = {s.simulator: None if s.skill is None else s.skill.model_dump() for s in batch.simulators}
    own = arguments.simulator or (GEL if numbers else TABLE)
    digests = sorted(contact_sha256(capture) for capture in captures.values())
    blank = named[BLANK] or {}
    row: dict[str, Any] = {
        "set": arguments.captures.resolve().name.removesuffix(".zip"),
        "source": next(iter(captures.values())).source,
        "simulator": own,
        "command": arguments.simulator_command,
        "skill": named[own],
        "table": named[TABLE],
        "blank": blank.get("estimate"),
        "differences": [d.model_dump() for d in batch.differences if own in (d.first, d.second)],
        "region": batch.headline_region,
        "taught": list(taught),
        "not_compared": {p.name: p.error for p in batch.pairs if p.simulator == own and p.error},
        "seconds": seconds,
        "captures_sha256": hashlib.sha256("\n".join(digests).encode()).hexdigest(),
        "version": package_version(),
    }
    if numbers:
        row["elastic_gel"] = {"skill": named[GEL], "numbers": [asdict(number) for number in numbers]}
    row["row_sha256"] = hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()
    return row


def _as_csv(row: Mapping[str, Any]) -> str:
    """Return the row as two lines of a table."""
    skill, table = row["skill"] or {}, row["table"] or {}

    def short(value: float | None) -> str:
        return "" if value is None else f"{value:.3f}"

    cells = (
        row["set"], row["simulator"], short(skill.get("estimate")), short(skill.get("low95")),
        short(skill.get("high95")), skill.get("presses", ""), len(row["taught"]), short(table.get("estimate")),
        short(row["seconds"]), row["captures_sha256"][:12],
    )  # fmt: skip
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([_COLUMNS, cells])
    return text.getvalue()
