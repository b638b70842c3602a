"""How many random faults of lines and devices need a person, and whether one ever leads to a wrong frame.

``python benchmarks/session_faults.py --rig serial --faults 250 --out bench-out/session-faults.jsonl`` captures whole
sessions over a faulty line until so many faults have befallen them, appends one line for each session, and goes on
where it was stopped; ``--table`` prints what the file holds. The devices are those of other people: lewis' FW212C
behind a pseudo-terminal, INDI's filter wheel and camera, the ASCOM Alpaca simulators' wheel, Aravis' fake camera; and
pictures over MJPEG, whose server is ours. A frame is wrong when the device itself, asked over a line without faults,
was at another slot than the record says, or when the picture is older than its request. A manual resume is a session
that ends with an error; it is resumed and goes on.
"""

import argparse
import io
import json
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from data_schemas import (
    CameraSettings,
    CaptureError,
    DeviceIdentity,
    FilterWheelSettings,
)
from rigs import Camera, FilterWheel, OpenRig, RawFrame, open_camera, open_rig, open_wheel, paint_plan, simulated_rig
from rigs.capture import SessionRequest, forecast, paint_steps, read_interrupted
from rigs.capture import _exposure as exposing
from rigs.capture._journal import read_journal
from rigs.capture._paint_session import capture_with
from rigs.transports import fault_listener
from tests.capture.drivers.alpaca_server import AlpacaServer
from tests.capture.drivers.fake_gigevision_camera import fake_camera
from tests.capture.drivers.faulty_line import KINDS, FaultyLine, Mishap
from tests.capture.drivers.indi_server import CCD, WHEEL, IndiServer
from tests.capture.drivers.thorlabs_wheel import emulated_wheel

BETWEEN_S = (0.2, 1.0)
"""After a fault has befallen the line, until the next is armed."""
BETWEEN_BIG_FRAMES_S = (2.0, 6.0)
"""The same where each frame is megabytes: more often, hardly one would come through whole."""
FRAMES_OF_A_SESSION = 40
"""Of a camera alone."""


class Device(NamedTuple):
    """A device behind a faulty line: how its rig file names it, the line, and the slot or instant that is true."""

    address: str
    line: Any
    true_slot: Callable[[], int | None]


@dataclass
class Outcome:
    """What befell one session."""

    rig: str
    seed: int
    faults: list[str] = field(default_factory=list)
    resumes: list[str] = field(default_factory=list)
    wrong: int = 0
    frames: int = 0
    repeated: int = 0
    longest_frame_s: float = 0.0
    stated_s: float = 0.0
    took_s: float = 0.0


@contextmanager
def mishaps(rig: str, line: Any, chance: random.Random, most: int) -> Iterator[None]:
    """Arm one fault after the other for a ``with`` block."""
    over = threading.Event()
    between_s = BETWEEN_BIG_FRAMES_S if rig == "indi camera" else BETWEEN_S

    def arm() -> None:
        while not over.wait(chance.uniform(*between_s)) and len(line.suffered) < most:
            if not line.is_armed:
                # Over MJPEG the host says nothing after its request.
                to_device = chance.random() < (0.0 if rig == "mjpeg" else 0.5)
                line.arm(Mishap(chance.choice(KINDS), to_device))

    arming = threading.Thread(target=arm, daemon=True)
    arming.start()
    try:
        yield
    finally:
        over.set()
        arming.join()
        line.arm(None)


@dataclass
class TurningBench:
    """A wheel behind the faulty line; before each exposure the bench's wheel is put where the device truly is."""

    wheel: FilterWheel
    bench: FilterWheel

    @property
    def slots(self) -> tuple[int, ...]:
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self) -> int | None:
        return None if self.bench.position() is None else self.wheel.position()

    def go_to(self, slot: int, deadline_s: float) -> None:
        self.wheel.go_to(slot, deadline_s)


@dataclass
class TrueCamera:
    """The bench's camera; each frame carries the slot at which the device truly was."""

    camera: Camera
    bench: FilterWheel
    true_slot: Callable[[], int | None]

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        true_slot = self.true_slot()
        if true_slot is not None and self.bench.position() is not None:
            self.bench.go_to(true_slot, deadline_s)
        raw = self.camera.expose(exposure_s, deadline_s)
        return replace(raw, settings={**raw.settings, "true_slot": float(true_slot or 0)})


def wheel_session(outcome: Outcome, device: Device, chance: random.Random, folder: Path, most: int) -> None:
    """Capture one paint session on the bench, whose wheel is the device's."""
    rig = simulated_rig("red", width_px=64, height_px=64)
    plan = paint_plan("red", rig.camera).model_copy(
        update={"filters": ("450", "532", "600", "660"), "bracket": (1.0, 0.25), "darks_per_exposure": 1}
    )
    expected = forecast(plan, rig, paint_steps(plan, rig))
    outcome.stated_s = expected.typical_s + expected.healing_s  # the bench's exposures are shorter than typical ones
    driver = WHEEL_DRIVERS[outcome.rig]
    filters = rig.filter_wheel.filters
    settings = FilterWheelSettings.model_validate({"driver": driver, "address": device.address, "filters": filters})
    out, interrupted = folder / f"session-{outcome.seed}", None
    with ExitStack() as stack:
        bench = stack.enter_context(open_rig(rig, Path()))
        wheel = stack.enter_context(open_wheel(settings, bench.operator))
        opened: OpenRig = replace(
            bench,
            wheel=TurningBench(wheel, bench.wheel),
            camera=TrueCamera(bench.camera, bench.wheel, device.true_slot),
        )
        stack.enter_context(mishaps(outcome.rig, device.line, chance, most))
        while True:
            try:
                session = capture_with(
                    opened, rig, plan, paint_steps(plan, rig), SessionRequest(out, "benchmark"), interrupted=interrupted
                )
            except CaptureError as error:
                outcome.resumes.append(f"{type(error).__name__}: {error}")
                interrupted = read_interrupted(out) if (out / "journal.jsonl").exists() else None
                time.sleep(2.0)
            else:
                break
    outcome.frames = len(session.frames)
    outcome.wrong = sum(
        frame.settings["true_slot"] != frame.slot_before or frame.slot_after != frame.slot_before
        for frame in session.frames
        if frame.filter_name is not None
    )
    outcome.repeated = sum(line["event"] in ("fault", "refused") for line in read_journal(out))


def camera_session(outcome: Outcome, device: Device, chance: random.Random, most: int) -> None:
    """Take the frames of a session with the camera of the device, as a tactile session does."""
    exposures = {"shortest_exposure_s": 0.01, "longest_exposure_s": 0.1}
    settings = CameraSettings(address=device.address, black_level_dn=0, **exposures, **CAMERAS[outcome.rig])
    told: list[object] = []
    with open_camera(settings, Path()) as camera, fault_listener(told.append):
        checked = exposing.TactileCamera(camera, settings, True, told.append)
        exposure_s = settings.shortest_exposure_s

        def take() -> RawFrame:
            if outcome.rig != "indi camera":
                return checked.expose(exposure_s)[0]
            # INDI's is monochrome, which no tactile session takes: the same attempts without the check of colours.
            deadline_s = exposure_s + exposing.CAMERA_DEADLINE_MARGIN_S
            once = lambda attempt: exposing.exposed(camera, exposure_s, deadline_s)  # noqa: E731
            return exposing.within_attempts(once, told.append, "a frame")[0]

        with mishaps(outcome.rig, device.line, chance, most):
            while outcome.frames < FRAMES_OF_A_SESSION:
                asked_s = time.time()
                try:
                    raw = take()
                except CaptureError as error:
                    outcome.resumes.append(f"{type(error).__name__}: {error}")
                    time.sleep(2.0)
                    continue
                outcome.longest_frame_s = max(outcome.longest_frame_s, time.time() - asked_s)
                if settings.driver == "mjpeg" and (age_s := asked_s - instant_of(raw)) > ROUNDED_S:
                    outcome.wrong += 1
                    print(f"a picture {age_s:.2f} s older than its request, after {device.line.suffered[-2:]}")
                outcome.frames += 1
    outcome.repeated = len(told)


# An MJPEG server of ours: each picture tells when it was made.
ROUNDED_S = 0.05
WIDTH_PX, HEIGHT_PX = 64, 64


def picture() -> bytes:
    """Return a JPEG that holds the time of day, in blocks of black and white for the bits of twentieths of a second."""
    ticks = int(time.time() / ROUNDED_S) % 2**24
    bits = np.array([(ticks >> k) & 1 for k in range(24)], dtype=np.uint8).reshape(4, 6) * 200 + 20
    image = np.kron(bits, np.ones((8, 8), dtype=np.uint8))
    canvas = np.full((HEIGHT_PX, WIDTH_PX), 128, dtype=np.uint8)
    canvas[:32, :48] = image
    file = io.BytesIO()
    Image.fromarray(canvas).convert("RGB").save(file, "JPEG", quality=95)
    return file.getvalue()


def instant_of(raw: RawFrame) -> float:
    """Return when the picture of a frame was made (s, time of day)."""
    grey = raw.counts[..., 1].astype(float)
    bits = [int(grey[8 * row + 2 : 8 * row + 6, 8 * column + 2 : 8 * column + 6].mean() > 110.0)
            for row in range(4) for column in range(6)]  # fmt: skip
    ticks, now = sum(bit << k for k, bit in enumerate(bits)), int(time.time() / ROUNDED_S)
    return (now - (now - ticks) % 2**24) * ROUNDED_S


@contextmanager
def mjpeg_server() -> Iterator[int]:
    """Serve pictures at 20 a second."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=part")
            self.end_headers()
            while True:
                body = picture()
                head = f"--part\r\nContent-Type: image/jpeg\r\nContent-Length: {len(body)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + body + b"\r\n")
                except ConnectionError:  # the camera's driver hung up; anything else is a fault of this server
                    return
                time.sleep(0.05)

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


class StoppedCamera:
    """Aravis' fake camera, whose packets no relay of ours passes on: it is frozen, or killed and started again."""

    def __init__(self, process: Any) -> None:
        self._camera, self.suffered = process, []  # type: ignore[var-annotated]
        self.is_armed = False

    def arm(self, mishap: Mishap | None) -> None:
        if mishap is None:
            return
        kind = mishap.kind
        self.suffered.append(mishap)
        if kind in ("reset", "restart", "unplug"):
            self._camera.kill()
            time.sleep(1.5 if kind == "unplug" else 0.0)
            self._camera.start()
            return
        self._camera.process.send_signal(signal.SIGSTOP)
        time.sleep({"drop": 1.5, "half": 1.0, "duplicate": 0.1}.get(kind, 0.4))
        self._camera.process.send_signal(signal.SIGCONT)


@contextmanager
def serial(folder: Path) -> Iterator[Device]:
    with emulated_wheel() as wheel:
        wheel.reset()

        def restart() -> None:
            wheel.control.put(pos=1, target=1, left_s=0.0, sensors=1, speed=0)

        lock = threading.Lock()

        def true_slot() -> int | None:
            with lock:
                return int(str(wheel.control.get("pos"))) if wheel.control.get("sensors") == 0 else 0

        with FaultyLine(wheel.port, lambda: locked(lock, restart), folder / "ttyWheel") as line:
            while not (folder / "ttyWheel").exists():
                time.sleep(0.02)
            yield Device(str(folder / "ttyWheel"), line, true_slot)


def locked(lock: threading.Lock, act: Callable[[], None]) -> None:
    with lock:
        act()


@contextmanager
def indi(folder: Path) -> Iterator[Device]:
    from rigs.transports import IndiClient

    with IndiServer(folder, {"indi_simulator_wheel": WHEEL}) as server:
        witness = IndiClient(server.address(WHEEL), "witness", "FILTER_SLOT")

        def asked(end_s: float) -> int:
            witness.ask("FILTER_SLOT", end_s)
            return int(witness.number("FILTER_SLOT", "FILTER_SLOT_VALUE"))

        def true_slot() -> int | None:
            return witness.within(time.monotonic() + 10.0, asked)

        def restart() -> None:
            server.put(WHEEL, "CONNECTION.DISCONNECT=On", stays=False)

        with FaultyLine(server.port, restart) as line:
            yield Device(f"127.0.0.1:{line.port}/{WHEEL}", line, true_slot)


@contextmanager
def alpaca(folder: Path) -> Iterator[Device]:
    from rigs.transports import AlpacaClient, alpaca_address

    with AlpacaServer(folder) as server:
        witness = AlpacaClient(alpaca_address(f"{server.url}/0", "witness", ""), "filterwheel", 0, "witness")

        def end_s() -> float:
            return time.monotonic() + 10.0

        def restart() -> None:
            witness.connect(end_s())
            witness.put("position", {"Position": 0}, end_s())
            witness.put("connected", {"Connected": False}, end_s())

        def true_slot() -> int | None:
            return witness.get_int("position", end_s()) + 1

        with FaultyLine(server.port, restart) as line:
            yield Device(f"http://127.0.0.1:{line.port}/0", line, true_slot)


@contextmanager
def mjpeg(folder: Path) -> Iterator[Device]:
    with mjpeg_server() as port, FaultyLine(port, lambda: None) as line:
        yield Device(f"http://127.0.0.1:{line.port}/stream", line, lambda: None)


@contextmanager
def indi_camera(folder: Path) -> Iterator[Device]:
    with IndiServer(folder, {"indi_simulator_ccd": CCD}) as server:

        def restart() -> None:
            server.put(CCD, "CONNECTION.DISCONNECT=On", stays=False)

        with FaultyLine(server.port, restart) as line:
            yield Device(f"127.0.0.1:{line.port}/{CCD}", line, lambda: None)


@contextmanager
def aravis(folder: Path) -> Iterator[Device]:
    with fake_camera() as process:
        yield Device("127.0.0.1", StoppedCamera(process), lambda: None)


RIGS = {"serial": serial, "indi": indi, "alpaca": alpaca, "mjpeg": mjpeg, "indi camera": indi_camera, "aravis": aravis}
WHEEL_DRIVERS = {"serial": "thorlabs", "indi": "indi", "alpaca": "alpaca"}
CAMERAS: dict[str, dict[str, Any]] = {
    "mjpeg": {"driver": "mjpeg", "bit_depth": 8, "width_px": WIDTH_PX, "height_px": HEIGHT_PX},
    "aravis": {"driver": "aravis", "bit_depth": 8, "width_px": 512, "height_px": 512},
    "indi camera": {"driver": "indi", "bit_depth": 16, "width_px": 128, "height_px": 96},
}


def one_session(rig: str, device: Device, seed: int, most: int, folder: Path) -> Outcome:
    """Run one session, and return what befell it."""
    chance, outcome = random.Random(seed), Outcome(rig, seed)
    before, began_s = len(device.line.suffered), time.monotonic()
    if rig in WHEEL_DRIVERS:
        wheel_session(outcome, device, chance, folder, before + most)
    else:
        camera_session(outcome, device, chance, before + most)
    outcome.took_s = round(time.monotonic() - began_s, 2)
    outcome.faults = [
        f"{mishap.kind} {'to' if mishap.to_device else 'from'} device" for mishap in device.line.suffered[before:]
    ]
    return outcome


def measure(rig: str, faults: int, out: Path, first_seed: int) -> None:
    """Append sessions until the file holds so many faults of this rig."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, RIGS[rig](Path(scratch)) as device:
        while (left := faults - sum(len(line["faults"]) for line in stored(out) if line["rig"] == rig)) > 0:
            seed = first_seed + sum(line["rig"] == rig for line in stored(out))
            outcome = one_session(rig, device, seed, left, Path(scratch))
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(outcome.__dict__) + "\n")
            print(
                f"{rig} {seed}: {len(outcome.faults)} faults, {len(outcome.resumes)} resumes, {outcome.wrong} wrong, "
                f"{outcome.repeated} repeated, {outcome.took_s:.1f} s {outcome.resumes}",
                flush=True,
            )


def stored(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in out.read_text("utf-8").splitlines()] if out.exists() else []


def table(out: Path) -> str:
    """Return what the file holds, for each rig."""
    rows, by_rig = [], defaultdict(list)
    for line in stored(out):
        by_rig[line["rig"]].append(line)
    rows.append(
        "| rig | sessions | faults | kinds | manual resumes | wrong frames | frames | s a session, worst | s stated |"
    )
    rows.append("|---|---|---|---|---|---|---|---|---|")
    for rig, lines in by_rig.items():
        kinds = Counter(fault.split()[0] for line in lines for fault in line["faults"])
        rows.append(
            f"| {rig} | {len(lines)} | {sum(kinds.values())} | "
            f"{', '.join(f'{kind} {kinds[kind]}' for kind in KINDS if kinds[kind])} | "
            f"{sum(len(line['resumes']) for line in lines)} | {sum(line['wrong'] for line in lines)} | "
            f"{sum(line['frames'] for line in lines)} | {max(line['took_s'] for line in lines):.0f} | "
            f"{max(line['stated_s'] for line in lines):.0f} |"
        )
    return "\n".join(rows)


def main() -> int:
    """Measure, or print the table; exit status 1 when a frame was wrong or more than 1 % of faults needed a person."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rig", choices=tuple(RIGS))
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("bench-out/session-faults.jsonl"))
    parser.add_argument("--first-seed", type=int, default=1, help="of the first session of a rig in the file")
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    if arguments.rig:
        measure(arguments.rig, arguments.faults, arguments.out, arguments.first_seed)
    if arguments.table:
        print(table(arguments.out))
    lines = stored(arguments.out)
    faults = sum(len(line["faults"]) for line in lines)
    resumes = sum(len(line["resumes"]) for line in lines)
    late = any(line["took_s"] > line["stated_s"] > 0.0 for line in lines)
    return int(late or any(line["wrong"] for line in lines) or resumes > 0.01 * faults)


if __name__ == "__main__":
    sys.exit(main())
