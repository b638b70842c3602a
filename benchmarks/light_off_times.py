"""How long a light stays on after SIGKILL or SIGSTOP of its owner, its guard and its watch, in all combinations.

Each of the three is left alone, killed or stopped: 26 mishaps, those of several processes in a random order, each at a
random instant after "on". ``python benchmarks/light_off_times.py --light indi --busy 2 --tries 59 --out
bench-out/light-off.jsonl`` appends one line for each try and goes on where it was stopped; busy loops run from "on" to
"off"; ``--table`` prints what the file holds. ``--stay-lit 5 --guards 4``
keeps four lights lit for five minutes and tells how long their boards heard nothing: a dead-man would trip at 0.39 s.
The lights are those of other people: INDI's simulated panel, the ASCOM Alpaca simulators, and our firmware in QEMU's
Arduino; and a board without a dead-man (``board``) that answers as our firmware does and takes a tenth of QEMU's
work, for all mishaps that leave a process of ours. A witness (a second INDI client, a poll every 5 ms, the bytes on
the serial line) sees the light on before each mishap; times are those at which it heard "off", so upper bounds. Of
the firmware the file also holds when "off" was said to the board, and of its dead-man the silence that it waited for:
what the emulator adds shows there. A try in which the board tripped before it can have been silent for long was one
of a starved emulator; it is counted apart and taken again.
"""

import argparse
import json
import os
import random
import re
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection
from importlib import import_module
from itertools import pairwise, product
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple
from urllib.parse import urlencode, urlsplit

from data_schemas import LaserSettings
from rigs.capture.light_off_time import make_off
from rigs.light_guard import GuardedLight
from tests.capture.drivers.alpaca_server import AlpacaServer
from tests.capture.drivers.firmware_in_qemu import build, firmware_board
from tests.capture.drivers.indi_server import PANEL, IndiServer

LEFT_BAR_S, OUTSIDE_BAR_S = 0.3, 0.5
"""Where a process of ours is left, and where only the dead-man of the controller is."""
WATCHED_S = 3.0
SETTLED_S = (0.05, 0.7)
"""Between "on" and the mishap, drawn evenly."""
POLL_S = 0.005
TRIP_AFTER_S = 0.25
"""A board that trips sooner after a mishap had not heard its host for long before: the emulation starved."""
DEAD_MAN_S = 0.39
"""The shortest silence after which the firmware switches off."""
BLOWS = {"KILL": signal.SIGKILL, "STOP": signal.SIGSTOP}
PROCESSES = ("main", "guard", "watch")
Mishap = tuple[tuple[str, str], ...]
MISHAPS: list[Mishap] = [
    tuple((who, blow) for who, blow in zip(PROCESSES, blows, strict=True) if blow)
    for blows in product(("", *BLOWS), repeat=3)
    if any(blows)
]


class Seen(NamedTuple):
    """What a witness saw after a mishap (s).

    `off_s`: off; None when it was still on at the end. `said_s`: "off" was said to the board. `silence_s`: what the
    dead-man waited for since the host's last word.
    """

    off_s: float | None
    said_s: float | None = None
    silence_s: float | None = None


class StarvedError(Exception):
    """The emulated board had not run for so long that its dead-man acted before its time."""


Witness = Callable[[float], Seen]
"""Returns what is seen after an instant (s, monotonic)."""


class Held(NamedTuple):
    """A lit light and the processes that hold it."""

    main: int
    guard: int
    watch: int


class Lamp(NamedTuple):
    """A light: how a rig file names it, a witness, who is called while it is on, and what stands for hardware."""

    driver: str
    address: str
    witness: Callable[[], Witness]
    boards: tuple[int, ...] = ()
    words_heard: Callable[[], int] = lambda: 0


def words(mishap: Mishap) -> str:
    return ", ".join(f"{who} {blow}" for who, blow in mishap)


def hold(driver: str, address: str, ask_every_s: float) -> None:
    """For every line of standard input light it in a child, which a mishap may befall."""
    import_module("serial.urlhandler.protocol_socket")  # a real port needs no such module to be opened in a hurry
    for _ in sys.stdin:
        child = os.fork()
        if child == 0:
            keep_on(driver, address, ask_every_s)
            os._exit(0)
        with suppress(InterruptedError):
            os.waitpid(child, 0)


def keep_on(driver: str, address: str, ask_every_s: float) -> None:
    """Keep it on and ask for its state now and then, as a session does."""
    light = GuardedLight("laser", driver, address)
    try:
        light.open()
        with light.lit():
            print(json.dumps([os.getpid(), light.guard_pid, light.watch_pid]), flush=True)
            while True:
                time.sleep(ask_every_s)
                light.state()
    except Exception as error:
        print(json.dumps(repr(error)), file=sys.stderr, flush=True)
    finally:
        light.close()


@contextmanager
def holder(driver: str, address: str, ask_every_s: float = 0.1) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, __file__, "--hold", driver, address, str(ask_every_s)]
    pipe = subprocess.PIPE
    with (
        Path(tempfile.gettempdir(), "light-off-times.log").open("a") as log,
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=log, text=True, start_new_session=True) as process,
    ):
        try:
            yield process
        finally:
            process.kill()


def once(
    process: "subprocess.Popen[str]",
    lamp: Lamp,
    loops: list["subprocess.Popen[bytes]"],
    mishap: Mishap,
    settled_s: float,
) -> Seen:
    """Light it, strike, and return what the witness saw."""
    before = lamp.words_heard()
    process.stdin.write("\n")
    process.stdin.flush()
    while (
        lamp.boards and process.poll() is None and lamp.words_heard() == before
    ):  # an emulated board that nobody asks costs a core
        time.sleep(POLL_S)
    for pid in lamp.boards:
        os.kill(pid, signal.SIGCONT)
    with hurried(os.getpid(), *lamp.boards):  # from "on": a board that starved meanwhile trips when it is let go
        if not select.select([process.stdout], [], [], 60.0)[0]:
            raise TimeoutError("the light did not go on")
        held = Held(*json.loads(process.stdout.readline()))
        try:
            with awake(loops), as_urgent_as_any(*held, *(loop.pid for loop in loops)):
                time.sleep(settled_s)
                off_after_s = lamp.witness()
                began_s = time.monotonic()
                for who, blow in mishap:
                    os.kill(getattr(held, who), BLOWS[blow])
                seen = off_after_s(began_s)
        finally:
            for pid in held:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
    label = {"wavelength_nm": 450.0, "power_mw": 1.0, "laser_class": "2"}
    make_off(LaserSettings(driver=lamp.driver, address=lamp.address, **label))
    for pid in lamp.boards:
        os.kill(pid, signal.SIGSTOP)
    return seen


@contextmanager
def awake(loops: list["subprocess.Popen[bytes]"]) -> Iterator[None]:
    """Let busy loops run for a ``with`` block."""
    try:
        for loop in loops:
            loop.send_signal(signal.SIGCONT)
        yield
    finally:
        for loop in loops:
            loop.send_signal(signal.SIGSTOP)


@contextmanager
def indi(folder: Path) -> Iterator[Lamp]:
    """INDI's panel; a client that asked once hears what the driver tells everybody."""
    says = re.compile(rb"<(?:def|set)SwitchVector[^>]*FLAT_LIGHT_CONTROL.*?FLAT_LIGHT_ON[^>]*>\s*(On|Off)\s*<", re.S)
    with IndiServer(folder, {"indi_simulator_lightpanel": PANEL}) as server:

        def witness() -> Witness:
            line, heard = socket.create_connection(("127.0.0.1", server.port)), b""
            line.sendall(b'<getProperties version="1.7"/>\n')
            while not says.findall(heard):
                heard += line.recv(65536)
            assert says.findall(heard)[-1] == b"On"

            def off_s(began_s: float) -> Seen:
                told = heard
                with line:
                    while (left_s := began_s + WATCHED_S - time.monotonic()) > 0.0:
                        line.settimeout(left_s)
                        with suppress(TimeoutError):
                            told += line.recv(65536)
                        if says.findall(told)[-1] == b"Off":
                            return Seen(time.monotonic() - began_s)
                return Seen(None)

            return off_s

        yield Lamp("indi", server.address(PANEL), witness)


@contextmanager
def alpaca(folder: Path) -> Iterator[Lamp]:
    """A switch of the Alpaca simulators, polled."""
    with AlpacaServer(folder) as server:

        def is_on() -> bool:
            asking = HTTPConnection("127.0.0.1", server.port, timeout=WATCHED_S)
            asking.request("GET", "/api/v1/switch/0/getswitch?Id=0&ClientID=9&ClientTransactionID=1")
            try:
                return bool(json.loads(asking.getresponse().read())["Value"])
            finally:
                asking.close()

        def off_s(began_s: float) -> Seen:
            while time.monotonic() - began_s < WATCHED_S:
                if not is_on():
                    return Seen(time.monotonic() - began_s)
                time.sleep(POLL_S)
            return Seen(None)

        def witness() -> Witness:
            assert is_on()
            return off_s

        yield Lamp("alpaca", f"{server.url}/switch/0/0", witness)


@contextmanager
def arduino(folder: Path) -> Iterator[Lamp]:
    """Our firmware in QEMU, heard on its serial line."""
    with firmware_board(build(folder)) as board:

        def off_s(began_s: float) -> Seen:
            while time.monotonic() - began_s < WATCHED_S:
                trips_s = board.times("device", b"TRIP", began_s)
                if told_s := [*board.times("device", b"OFF", began_s), *trips_s]:
                    return seen(began_s, min(told_s), min(told_s) in trips_s)
                time.sleep(POLL_S)
            return Seen(None)

        def seen(began_s: float, end_s: float, has_tripped: bool) -> Seen:
            if has_tripped:
                if end_s - began_s < TRIP_AFTER_S:
                    raise StarvedError
                last_s = max(line.at_s for line in board.lines if line.who == "host" and line.at_s < end_s)
                return Seen(end_s - began_s, silence_s=end_s - last_s)
            return Seen(end_s - began_s, said_s=min(board.times("host", b"L0", began_s)) - began_s)

        def witness() -> Witness:
            if [line.text for line in board.lines if line.who == "device"][-1] != b"ON":
                raise StarvedError
            return off_s

        def words_heard() -> int:
            return sum(line.who == "host" for line in board.lines)

        yield Lamp("arduino", board.address, witness, tuple(children("qemu-system-avr")), words_heard)


def children(name: str) -> list[int]:
    """Return the process numbers of our children with a name, which the kernel cuts after 15 letters."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            head, _, tail = stat.read_text().rpartition(")")
            pid, _, command = head.partition(" (")
            if command == name[:15] and tail.split()[1] == str(os.getpid()):
                found.append(int(pid))
    return found


@contextmanager
def hurried(*pids: int) -> Iterator[None]:
    """Let the witness, and a board that a real computer does not slow down, go before all others, where permitted."""
    schedule(pids, os.SCHED_FIFO, 1)
    try:
        yield
    finally:
        schedule(pids, os.SCHED_OTHER, 0)


@contextmanager
def as_urgent_as_any(*pids: int) -> Iterator[None]:
    """Give processes the priority of ordinary programs for a ``with`` block, where permitted: a capture has it."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    for thread in threads(pids):
        with suppress(PermissionError, ProcessLookupError):
            os.setpriority(os.PRIO_PROCESS, thread, min(usual, 0))
    try:
        yield
    finally:
        for thread in threads(pids):
            with suppress(PermissionError, ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, thread, usual)


def threads(pids: tuple[int, ...]) -> Iterator[int]:
    for pid in pids:
        with suppress(FileNotFoundError):
            yield from [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]


def schedule(pids: tuple[int, ...], policy: int, priority: int) -> None:
    for thread in threads(pids):
        with suppress(PermissionError, ProcessLookupError):
            os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


class TimedBoards(threading.Thread):
    """Boards that answer as our firmware does and note when each word of a host came; a tenth of QEMU's work, or less.

    What trips a real board is the host's silence, and that is all that is measured here.
    """

    def __init__(self, count: int) -> None:
        super().__init__(daemon=True)
        self._servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
        self.addresses = [f"socket://127.0.0.1:{server.getsockname()[1]}" for server in self._servers]
        self.heard_s: dict[int, list[float]] = defaultdict(list)
        self.off_s: dict[int, list[float]] = defaultdict(list)
        self.lit: dict[int, bool] = defaultdict(bool)
        self.start()

    def run(self) -> None:
        """Answer for ever."""
        poll, ends, lit, begun = select.poll(), {}, self.lit, defaultdict(bytes)
        for number, server in enumerate(self._servers):
            ends[server.fileno()] = (number, server)
            poll.register(server, select.POLLIN)
        while True:
            for descriptor, _ in poll.poll():
                number, end = ends[descriptor]
                if end is self._servers[number]:
                    line = end.accept()[0]
                    ends[line.fileno()] = (number, line)
                    poll.register(line, select.POLLIN)
                    continue
                try:
                    data = end.recv(256)
                except ConnectionResetError:  # the host was killed
                    data = b""
                if not data:
                    poll.unregister(end)
                    end.close()
                    continue
                now_s = time.monotonic()
                *whole, begun[number] = (begun[number] + data).split(b"\n")
                for word in whole:
                    if lit[number] and word == b"L0":
                        self.off_s[number].append(now_s)
                    lit[number] = word == b"L1" or (lit[number] and word != b"L0")
                    with suppress(ConnectionError):
                        end.sendall(b"LASER 1.2\n" if word == b"I" else b"ON\n" if lit[number] else b"OFF\n")
                    if lit[number]:
                        self.heard_s[number].append(now_s)


@contextmanager
def board(folder: Path) -> Iterator[Lamp]:
    """A board without a dead-man, which notes when "off" came."""
    boards = TimedBoards(1)

    def off_s(began_s: float) -> Seen:
        while time.monotonic() - began_s < WATCHED_S:
            if told_s := [at_s for at_s in boards.off_s[0] if at_s >= began_s]:
                return Seen(min(told_s) - began_s)
            time.sleep(POLL_S)
        return Seen(None)

    def witness() -> Witness:
        assert boards.lit[0]
        return off_s

    yield Lamp("arduino", boards.addresses[0], witness)


def stay_lit(busy: int, guards: int, minutes: float) -> int:
    """Keep lights lit side by side; print the silences that their boards heard, and return how many would trip one."""
    with ExitStack() as stack:
        boards = TimedBoards(guards)
        holders = [stack.enter_context(holder("arduino", address, 5.0)) for address in boards.addresses]
        for _ in range(busy):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
            stack.callback(loop.kill)
        for process in holders:
            process.stdin.write("\n")
            process.stdin.flush()
        held = [json.loads(process.stdout.readline()) for process in holders]
        began_s = time.monotonic()
        with hurried(os.getpid()):
            time.sleep(60.0 * minutes)
        end_s = time.monotonic()
        heard_s = [list(times_s) for times_s in boards.heard_s.values()]
        lost = sum(times_s[-1] < end_s - 1.0 for times_s in heard_s)
        for main_pid, *_ in held:
            with suppress(ProcessLookupError):
                os.kill(main_pid, signal.SIGTERM)
    silences_s = sorted(later - earlier for times_s in heard_s for earlier, later in pairwise(times_s))
    trips = sum(silence_s >= DEAD_MAN_S for silence_s in silences_s)
    shares = [f"{silences_s[int(share * (len(silences_s) - 1))]:.3f}" for share in (0.5, 0.99, 0.9999, 1.0)]
    print(
        f"{guards} guards, {busy} busy, {guards * (end_s - began_s) / 60:.1f} guard-minutes, load "
        f"{os.getloadavg()[0]:.1f}: {trips} silences of {DEAD_MAN_S} s or more, {lost} lights lost otherwise; "
        f"{len(silences_s)} silences between two words, 50 / 99 / 99.99 / 100 %: {' / '.join(shares)} s",
        flush=True,
    )
    return trips + lost


LIGHTS = {"indi": indi, "alpaca": alpaca, "arduino": arduino, "board": board}


def done(path: Path) -> list[dict[str, Any]]:
    """Return what the file holds."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def measure(name: str, busy: int, tries: int, out: Path, mishaps: list[Mishap]) -> None:
    """Take the tries that are missing, round by round, so that a stopped run has some of each."""
    out.parent.mkdir(parents=True, exist_ok=True)
    have = Counter((entry["light"], entry["busy"], entry["mishap"]) for entry in done(out) if "starved" not in entry)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        lamp = stack.enter_context(LIGHTS[name](folder))
        process = stack.enter_context(holder(lamp.driver, lamp.address))
        loops = []
        for _ in range(busy):
            loops.append(subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True))
            loops[-1].send_signal(signal.SIGSTOP)
            stack.callback(loops[-1].kill)
        for number in range(tries):
            for mishap in mishaps:
                # Where nothing is left that could act, one try shows it.
                enough = 1 if len(mishap) == 3 and name != "arduino" else tries
                while have[name, busy, words(mishap)] <= number < enough:
                    entry = {"light": name, "busy": busy, "mishap": words(mishap)}
                    entry |= one_entry(process, lamp, loops, mishap)
                    have[name, busy, words(mishap)] += "starved" not in entry
                    with out.open("a") as file:
                        file.write(json.dumps(entry) + "\n")
                    print(*entry.values(), flush=True)


def one_entry(
    process: "subprocess.Popen[str]", lamp: Lamp, loops: list["subprocess.Popen[bytes]"], mishap: Mishap
) -> dict[str, object]:
    """Take one try, in a random order and at a random instant, and return what the file keeps of it."""
    order, settled_s = tuple(random.sample(mishap, len(mishap))), random.uniform(*SETTLED_S)
    entry: dict[str, object] = {"order": [who for who, _ in order], "settled_s": round(settled_s, 3)}
    try:
        seen = once(process, lamp, loops, order, settled_s)
    except StarvedError:
        return entry | {"starved": True}
    rounded = {name: value if value is None else round(value, 4) for name, value in seen._asdict().items()}
    return entry | rounded | {"load": round(os.getloadavg()[0], 1)}


def table(path: Path) -> int:
    """Print the worst, the median and the number of each cell; return 1 when a bar is missed."""
    entries, missed = done(path), 0
    columns = sorted({(entry["light"], entry["busy"]) for entry in entries})
    print("| what happens | " + " | ".join(f"{name}, {busy} busy" for name, busy in columns) + " |")
    print("|---|" + "---|" * len(columns))
    for mishap in MISHAPS:
        cells = []
        for column in columns:
            tries = [
                entry["off_s"]
                for entry in entries
                if (entry["light"], entry["busy"]) == column and entry["mishap"] == words(mishap) and "off_s" in entry
            ]
            offs = [off_s for off_s in tries if off_s is not None]
            bar_s = OUTSIDE_BAR_S if len(mishap) == 3 else LEFT_BAR_S
            late = len(tries) - sum(off_s <= bar_s for off_s in offs)
            missed += late * (len(mishap) < 3 or column[0] == "arduino")
            worst = "stays on" if len(offs) < len(tries) else f"{max(offs, default=0.0):.2f}"
            middle = f", median {median(offs):.3f}" if offs else ""
            cells.append(f"{worst} ({late} of {len(tries)} beyond {bar_s} s{middle})" if tries else "-")
        print(f"| {words(mishap)} | " + " | ".join(cells) + " |")
    for column in columns:
        ours = [entry for entry in entries if (entry["light"], entry["busy"]) == column]
        silences_s = [entry["silence_s"] for entry in ours if entry.get("silence_s")]
        added_s = [entry["off_s"] - entry["said_s"] for entry in ours if entry.get("said_s")]
        loads = sorted(entry["load"] for entry in ours if "load" in entry)
        print(
            f"{column}: load {loads[:1]} to {loads[-1:]}; starved {sum('starved' in entry for entry in ours)}", end=""
        )
        for text, values_s in (("dead-man after a silence of", silences_s), ('"off" said to off heard', added_s)):
            if values_s:
                print(f"; {text} {min(values_s):.3f} to {max(values_s):.3f} s, n {len(values_s)}", end="")
        print()
    return int(missed > 0)


def bare_off(busy: int, tries: int) -> None:
    """Print how long an "off" takes that is sent straight to Alpaca's simulators, with nothing of ours beside it.

    In turn over a new connection to a number (no name to look up), as the watch sends it, and over one that is kept
    open: until the server has answered, and until the witness has seen it.
    """
    heard: dict[str, list[tuple[float, float]]] = {"new connection": [], "kept open": []}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        lamp = stack.enter_context(alpaca(folder))
        port = urlsplit(lamp.address).port
        for _ in range(busy):
            loop = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
            stack.callback(loop.kill)
        for way in list(heard) * tries:
            line = HTTPConnection("127.0.0.1", port, timeout=10.0 * WATCHED_S)
            say_alpaca(line, "connected", {"Connected": True})
            say_alpaca(line, "setswitch", {"Id": 0, "State": True})
            if way == "new connection":
                line.close()  # the next request opens one
            witness = lamp.witness()
            time.sleep(random.uniform(*SETTLED_S))
            began_s = time.monotonic()
            say_alpaca(line, "setswitch", {"Id": 0, "State": False})
            answered_s = time.monotonic() - began_s
            seen_s = witness(began_s).off_s
            line.close()
            heard[way].append((answered_s, WATCHED_S if seen_s is None else seen_s))
    for way, times in heard.items():
        for what, values_s in zip(("answered", "seen off"), zip(*times, strict=True), strict=True):
            slow = sum(value > LEFT_BAR_S for value in values_s)
            print(
                f"{way}: {what} after {median(values_s):.3f} s, at most {max(values_s):.3f} s, {slow} of {tries} late"
            )
    print(f"load {os.getloadavg()[0]:.1f}")


def say_alpaca(line: HTTPConnection, member: str, parameters: dict[str, object]) -> None:
    """Send one request and read its answer."""
    body = urlencode({**parameters, "ClientID": 9, "ClientTransactionID": 1})
    line.request("PUT", f"/api/v1/switch/0/{member}", body, {"Content-Type": "application/x-www-form-urlencoded"})
    line.getresponse().read()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--light", choices=sorted(LIGHTS), action="append")
    parser.add_argument("--busy", type=int, default=0, help="busy loops beside it")
    parser.add_argument("--tries", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("bench-out/light-off.jsonl"))
    parser.add_argument("--all-three", action="store_true", help="only those that leave no process of ours")
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--bare", action="store_true", help='an "off" alone, straight to Alpaca\'s simulators')
    parser.add_argument("--stay-lit", type=float, metavar="MINUTES", help="look for silences that trip a dead-man")
    parser.add_argument("--guards", type=int, default=4, help="lights that stay lit side by side")
    parser.add_argument("--hold", nargs=3, metavar=("DRIVER", "ADDRESS", "SECONDS"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.hold:
        driver, address, ask_every_s = arguments.hold
        hold(driver, address, float(ask_every_s))
        return 0
    # As Ctrl-C does: a board that is emulated before all other work must not outlive us.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if arguments.bare:
        bare_off(arguments.busy, arguments.tries)
        return 0
    if arguments.stay_lit is not None:
        return int(stay_lit(arguments.busy, arguments.guards, arguments.stay_lit) > 0)
    if not arguments.table:
        for name in arguments.light or sorted(LIGHTS):
            mishaps = [mishap for mishap in MISHAPS if len(mishap) == 3 or not arguments.all_three]
            mishaps = [mishap for mishap in mishaps if len(mishap) < 3 or name != "board"]
            measure(name, arguments.busy, arguments.tries, arguments.out, mishaps)
    return table(arguments.out)


if __name__ == "__main__":
    sys.exit(main())
