"""Workers elsewhere: a scheduler that dies and comes back, other code, another disk, another network."""

import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import dask
import pytest
from distributed import Client, LocalCluster, get_worker

from data_schemas import SimulateError, code_digest, provenance
from data_schemas import _provenance as provenance_module
from data_schemas._provenance import _source_names
from sim.studies import _engine as engine_module
from sim.studies._engine import (
    Unfit,
    Workers,
    _ended,
    _fault,
    _Steps,
    _token_in,
    each_computed,
    open_workers,
    run_study,
    when_seen,
)

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Job:
    """What is computed, by its number."""

    number: int


def jobs(count):
    return [Job(number) for number in range(1, count + 1)]


def copy_of_the_code(folder):
    """Copy the sources, and these tests, whose functions the workers call."""
    for package in ("data_schemas", "finray_calib", "rigs", "sim", "tests"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__", "frozen"))


class Server:
    """A Dask scheduler with a worker, on a port of its own, killed as a power cut does."""

    def __init__(self, port, code=ROOT, host="127.0.0.1", network=()):
        self.host, self.network, self.address = host, network, f"tcp://{host}:{port}"
        self.processes = []
        self._start(f"scheduler --host {host} --port {port}", code)
        self._wait(port)
        self.add_worker(code)

    def add_worker(self, code):
        """Add a worker that runs these sources, and wait until it is there."""
        self._start(f"worker {self.address} --host {self.host} --nthreads 1 --nworkers 1 --no-nanny", code)
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.processes) - 1, timeout=300)

    def end_worker(self):
        """End the worker that was added last."""
        worker = self.processes.pop()
        worker.kill()
        worker.wait()

    def _start(self, words, code):
        dask = str(Path(sys.executable).with_name("dask"))
        common = {"env": {**os.environ, "PYTHONPATH": str(code)}, "stderr": subprocess.DEVNULL, "cwd": code}
        self.processes.append(subprocess.Popen([*self.network, dask, *words.split(), "--no-dashboard"], **common))

    def _wait(self, port):
        """Return once the scheduler listens: a busy machine takes its time to import it."""
        deadline = time.monotonic() + 300.0
        while time.monotonic() < deadline:
            with socket.socket() as asking:
                if asking.connect_ex((self.host, port)) == 0:
                    return
            time.sleep(0.2)
        self.kill()
        raise TimeoutError(self.address)

    def kill(self):
        for process in self.processes:
            process.kill()
            process.wait()


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def slowly(folder, point):
    """Add a mark to the file of a point, after a while."""
    time.sleep(0.5)
    with (Path(folder) / f"{point.number}").open("a") as file:
        file.write("x")


@pytest.mark.timeout(1200)
def test_a_scheduler_that_goes_away_loses_nothing_that_is_finished(tmp_path, monkeypatch):
    """Once it is given up, the same command goes on with what is missing when it runs again."""
    monkeypatch.setattr(engine_module, "WAIT_FOR_SCHEDULER_S", 3.0)
    points = jobs(6)
    folder = tmp_path / "marks"
    folder.mkdir()
    server = Server(free_port())
    try:
        ended = each_computed(slowly, str(folder), points, "point ", (None, server.address))
        next(ended)
        server.kill()
        with pytest.raises(SimulateError, match="before the work was done; what was finished is kept"):
            list(ended)
        done = {path.name for path in folder.iterdir()}
        assert 1 <= len(done) < 6
        server = Server(free_port())
        missing = [point for point in points if f"{point.number}" not in done]
        again = [p.number for p, _ in each_computed(slowly, str(folder), missing, "point ", (None, server.address))]
        assert again == [point.number for point in missing]
    finally:
        server.kill()
    assert {path.name: path.read_text() for path in folder.iterdir()} == {f"{k}": "x" for k in range(1, 7)}


@pytest.mark.timeout(1200)
def test_a_study_waits_for_its_scheduler_while_it_is_started_again(tmp_path):
    """What was in flight is given again; points that keep what they find are computed once."""
    points = jobs(8)
    folder = tmp_path / "marks"
    folder.mkdir()
    port = free_port()
    server, told = Server(port), []
    try:
        ended = each_computed(once_slowly, str(folder), points, "point ", (None, server.address), told_to(told))
        first, _ = next(ended)
        server.kill()
        restarting = threading.Timer(2.0, lambda: servers.append(Server(port)))
        servers = []
        restarting.start()
        numbers = [first.number, *(point.number for point, reason in ended if reason is None)]
        restarting.join()
    finally:
        for one in (server, *servers):
            one.kill()
    assert sorted(numbers) == list(range(1, 9))
    assert {path.name: path.read_text() for path in folder.iterdir()} == {f"{k}": "x" for k in range(1, 9)}
    assert f"the scheduler {server.address} does not answer any more; waiting for it, 10 minutes at most" in told


def told_to(told):
    return lambda done, of, what: told.append(what)


def once_slowly(folder, point):
    """Compute a point as studies do: nothing that is there already."""
    return None if (Path(folder) / f"{point.number}").exists() else slowly(folder, point)


@pytest.mark.timeout(1200)
def test_a_worker_with_other_code_or_another_disk_is_refused_or_left_out(tmp_path):
    """One that is there as the study begins is named; one that comes later gets no more points."""
    other = tmp_path / "other"
    copy_of_the_code(other)
    with (other / "sim" / "studies" / "_point.py").open("a") as file:
        file.write("\n# changed\n")
    points = jobs(6)
    folder, told = tmp_path / "marks", []
    folder.mkdir()
    server = Server(free_port(), other)
    try:
        with pytest.raises(SimulateError, match=r"worker tcp://\S+:\d+ runs other code \(finray-calib .* or stop"):
            list(each_computed(slowly, str(folder), points, "point ", (None, server.address), folder=folder))
        assert not list(folder.iterdir())
        server.end_worker()
        server.add_worker(ROOT)
        ended = each_computed(slowly, str(folder), points, "point ", (None, server.address), told_to(told), folder)
        first, _ = next(ended)
        server.add_worker(other)
        numbers = [first.number, *(point.number for point, reason in ended if reason is None)]
    finally:
        server.kill()
    assert sorted(numbers) == [1, 2, 3, 4, 5, 6]
    assert {path.name: path.read_text() for path in folder.iterdir()} == {f"{k}": "x" for k in range(1, 7)}


def test_a_folder_of_the_same_path_that_is_another_one_is_not_seen(tmp_path):
    with _token_in(tmp_path) as token:
        assert _fault(code_digest(), token) is None
        elsewhere = tmp_path / "elsewhere" / token.name
        assert _fault(code_digest(), elsewhere) == f"does not see {tmp_path}/elsewhere"
    assert not list(tmp_path.iterdir())


@pytest.fixture(autouse=True)
def own_dask_of_the_user():
    """What else uses Dask in this process, ArviZ for one, still finds its own default."""
    before = dask.config.get("scheduler", None)
    yield
    assert dask.config.get("scheduler", None) == before


@pytest.fixture
def cluster():
    """A scheduler with two workers in this process."""
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as started:
        yield started


def waits(seconds, job):
    time.sleep(seconds)


def marks_who(folder, point):
    """Add the worker to the file of a point; the worker named in the folder takes forty times as long."""
    worker = get_worker().address
    with (Path(folder) / f"{point.number}").open("a") as file:
        file.write(f"{worker}\n")
    time.sleep(8.0 if worker == (Path(folder) / "slow").read_text() else 0.2)


@pytest.mark.timeout(300)
def test_a_slow_worker_delays_its_own_points_only(cluster, tmp_path):
    """Others do not wait for it, what it is given is computed once, and it is not taken for one that left."""
    with Client(cluster, set_as_default=False) as client:
        slow = min(client.nthreads())
    (tmp_path / "slow").write_text(slow)
    points = jobs(24)
    ended = list(each_computed(marks_who, str(tmp_path), points, "point ", (None, cluster.scheduler_address)))
    assert sorted(point.number for point, _ in ended) == [point.number for point in points]
    assert {failure for _, failure in ended} == {None}
    by = [(tmp_path / f"{point.number}").read_text().split() for point in points]
    assert {len(workers) for workers in by} == {1}
    # at most what it computes and what waits beside it, twice: half of them would be 12
    assert 1 <= sum(workers == [slow] for workers in by) <= 4


def test_a_point_for_a_worker_that_left_goes_to_another(cluster):
    with Client(cluster, set_as_default=False) as client:
        unfit, fit = client.nthreads()
        workers = Workers(client, cluster.scheduler_address, unfit={unfit: "runs other code", "tcp://gone:1": "left"})
        assert workers.count() == 1
        futures = [workers.submit(waits, 0.5, job, print) for job in jobs(3)]
        client.retire_workers([fit])
        assert [future.result(timeout=60) for future in futures] == [None, None, None]
        assert list(workers.unfit) == [unfit]


def test_fit_workers_that_are_away_for_a_moment_are_waited_for(cluster, monkeypatch):
    told = []
    with Client(cluster, set_as_default=False) as client:
        workers = Workers(client, cluster.scheduler_address, unfit=dict.fromkeys(client.nthreads(), "runs other code"))
        coming = threading.Timer(1.0, lambda: cluster.scale(3))
        coming.start()
        assert workers.submit(waits, 0.0, Job(1), told.append).result(timeout=60) is None
        assert told == ["none of the connected workers can be used; waiting for others, 10 minutes at most"]
        workers.unfit = dict.fromkeys(client.nthreads(), "runs other code")
        monkeypatch.setattr(engine_module, "WAIT_FOR_SCHEDULER_S", 0.1)
        with pytest.raises(SimulateError, match="runs other code"):
            workers.submit(waits, 0.0, Job(1), told.append)


def test_another_folder_of_the_same_path_is_noticed_also_by_a_worker_that_comes_later(cluster, tmp_path):
    with open_workers(1, cluster.scheduler_address, tmp_path) as workers:
        (token,) = tmp_path.iterdir()
        assert workers.submit(waits, 0.0, Job(1), print).result(timeout=60) is None
        token.rename(tmp_path / "elsewhere")  # as another folder of the path has none
        refused = workers.submit(waits, 0.0, Job(1), print).result(timeout=60)
        assert isinstance(refused, Unfit)
        assert refused.reason == f"does not see {tmp_path}"
        (tmp_path / "elsewhere").rename(token)
    assert not list(tmp_path.iterdir())


def test_workers_of_this_machine_that_are_ended_are_not_called_a_scheduler_elsewhere(cluster):
    with Client(cluster.scheduler_address, set_as_default=False) as client:
        threading.Timer(1.0, cluster.close).start()
        with pytest.raises(SimulateError, match="processes of this machine ended before their work was done"):
            list(_ended(Workers(client), waits, 5.0, jobs(4), _Steps(4, None)))


def test_a_file_that_the_network_shows_late_is_waited_for(tmp_path):
    looks = iter([None, None, "the record"])
    assert when_seen(lambda job: next(looks), jobs(1), tmp_path, 30.0) == {1: "the record"}
    assert when_seen(lambda job: None, jobs(1), tmp_path, 0.1) == {1: None}


def test_the_press_of_each_point_is_looked_up_once(monkeypatch, tmp_path):
    looked, points = [], [SimpleNamespace(number=n, design=n % 2, changes={}) for n in range(1, 9)]
    monkeypatch.setattr(engine_module, "press_file", lambda task, design: looked.append(1) or Path(f"{design}"))
    monkeypatch.setattr(engine_module, "has_press", lambda task, file: False)
    monkeypatch.setattr(engine_module, "stored_point", lambda task, point: None)
    monkeypatch.setattr(engine_module, "open_workers", lambda *given: nullcontext())
    monkeypatch.setattr(engine_module, "_each", lambda *given: ((point, "broke") for point in given[3]))
    kept, failed = run_study(SimpleNamespace(folder=tmp_path), points, workers=1)
    assert kept == []
    assert [failure.reason for failure in failed] == ["its press: broke"] * 8
    assert len(looked) == 8


@pytest.fixture
def other_machine():
    """A network of its own, joined by a cable: the command that runs a program there, its address, and the cable."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("only root may make a network, with iproute2")
    name, cable, subnet = f"finray{os.getpid()}", f"fr{os.getpid() % 10**8}", 16 + os.getpid() % 200
    made = subprocess.run(["ip", "netns", "add", name], check=False).returncode == 0
    if not made:
        pytest.skip("this machine makes no network")
    inside = ["ip", "-n", name]
    try:
        for words in (
            ["ip", "link", "add", cable, "type", "veth", "peer", "name", "inside", "netns", name],
            ["ip", "addr", "add", f"10.213.{subnet}.1/24", "dev", cable],
            ["ip", "link", "set", cable, "up"],
            [*inside, "addr", "add", f"10.213.{subnet}.2/24", "dev", "inside"],
            [*inside, "link", "set", "inside", "up"],
            [*inside, "link", "set", "lo", "up"],
        ):
            if subprocess.run(words, check=False).returncode:
                pytest.skip("this machine joins no networks")
        yield ("ip", "netns", "exec", name), f"10.213.{subnet}.2", cable
    finally:
        subprocess.run(["ip", "netns", "del", name], check=True)


@pytest.mark.timeout(1200)
def test_a_scheduler_on_another_machine_computes_also_after_its_cable_was_pulled(tmp_path, other_machine):
    network, host, cable = other_machine
    there = tmp_path / "there"
    copy_of_the_code(there)
    points, folder = jobs(8), tmp_path / "marks"
    folder.mkdir()
    server = Server(8786, there, host, network)
    try:
        ended = each_computed(once_slowly, str(folder), points, "point ", (None, server.address), folder=folder)
        first, _ = next(ended)
        subprocess.run(["ip", "link", "set", cable, "down"], check=True)
        threading.Timer(5.0, lambda: subprocess.run(["ip", "link", "set", cable, "up"], check=True)).start()
        numbers = [first.number, *(point.number for point, reason in ended if reason is None)]
    finally:
        server.kill()
    assert sorted(numbers) == list(range(1, 9))
    assert {path.name: path.read_text() for path in folder.iterdir()} == {f"{k}": "x" for k in range(1, 9)}


def test_what_editors_and_tools_keep_is_not_code(tmp_path):
    package = tmp_path / "sim"
    for file in (package / "one.py", package / ".ipynb_checkpoints" / "one.py", package / ".#two.py"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("")
    for name in ("plan.toml", "notes.md"):
        (package / name).write_text("")
    assert _source_names(tmp_path) == [f"{package.name}/{name}" for name in ("one.py", "plan.toml")]


def test_a_record_names_the_machine_that_computed_it(monkeypatch):
    asked = provenance("finray study run PLAN", {"plan.toml": "0" * 64}, 3).model_copy(
        update={"processor": "asked", "packages": {"numpy": "1.0"}, "python_version": "3.0", "renderer": None}
    )
    monkeypatch.setattr(provenance_module, "_opened_renderer", ["llvm_ad_rgb"])
    stored = asked.of_this_process()
    here = provenance("")
    assert stored.renderer == "llvm_ad_rgb"
    for name in ("processor", "packages", "python_version"):
        assert getattr(stored, name) == getattr(here, name) != getattr(asked, name)
    for name in ("command", "input_sha256", "seed", "created_utc", "package_version", "git_commit"):
        assert getattr(stored, name) == getattr(asked, name)
