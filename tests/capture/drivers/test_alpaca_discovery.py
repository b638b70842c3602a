"""Alpaca servers in reach: no simulator at hand can be discovered, so a scripted one, which alpyca finds too."""

import json
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rigs.filter_wheels import alpaca as wheels
from rigs.lights import alpaca as lights
from rigs.transports import _alpaca_client as alpaca_discovery
from tests.capture.drivers.alpaca_server import scripted
from tests.capture.drivers.programs import others_python


@contextmanager
def answering(monkeypatch: pytest.MonkeyPatch, *answers: bytes, at: str = "127.0.0.1") -> Iterator[list[bytes]]:
    """A server that hears the question at an address and says its answers, on a port of its own; what it heard."""
    heard: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind((at, 0))
        line.settimeout(0.05)
        monkeypatch.setattr(alpaca_discovery, "DISCOVERY_PORT", line.getsockname()[1])
        done = threading.Event()

        def serve() -> None:
            while not done.is_set():
                try:
                    question, asker = line.recvfrom(1024)
                except TimeoutError:
                    continue
                heard.append(question)
                for answer in answers:
                    line.sendto(answer, asker)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield heard
        finally:
            done.set()
            thread.join()


def port_of(url: str) -> bytes:
    return json.dumps({"AlpacaPort": int(url.rsplit(":", 1)[1])}).encode()


LISTED = [
    {"DeviceName": "EFW", "DeviceType": "FilterWheel", "DeviceNumber": 1, "UniqueID": "a"},
    {"DeviceName": "Box", "DeviceType": "Switch", "DeviceNumber": 0, "UniqueID": "b"},
    {"DeviceName": "Panel", "DeviceType": "CoverCalibrator", "DeviceNumber": 2, "UniqueID": "c"},
    {"DeviceName": "Dome", "DeviceType": "Dome", "DeviceNumber": 0, "UniqueID": "d"},
]


def test_devices_of_servers_that_answer_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    with scripted(lambda method, member, fields: LISTED) as url, answering(monkeypatch, port_of(url)) as heard:
        assert wheels.found() == [(f"{url}/1", "Alpaca filter wheel EFW")]
        assert lights.found() == [
            (f"{url}/switch/0/0", "Alpaca switches Box; the last number chooses one"),
            (f"{url}/covercalibrator/2", "Alpaca cover calibrator Panel"),
        ]
    assert set(heard) == {b"alpacadiscovery1"}


@pytest.mark.parametrize(
    "answer", [b"", b"{", b"[]", b"7", b'{"AlpacaPort": "x"}', b'{"AlpacaPort": 0}', b'{"AlpacaPort": 1}', b"[" * 900]
)
def test_answers_of_others_are_passed_over(monkeypatch: pytest.MonkeyPatch, answer: bytes) -> None:
    """Also of a server whose port nobody listens at."""
    with answering(monkeypatch, answer):
        assert alpaca_discovery.alpaca_devices() == []


@pytest.mark.parametrize("value", [b"{", b"[]", b'{"Value": [{"DeviceType": "Switch"}]}', b'{"Value": 3}'])
def test_a_server_without_a_list_offers_nothing(monkeypatch: pytest.MonkeyPatch, value: bytes) -> None:
    with scripted(lambda method, member, fields: value) as url, answering(monkeypatch, port_of(url)):
        assert alpaca_discovery.alpaca_devices() == []


ALPYCA = """
from alpaca import discovery, management
discovery.port = {port}
found = discovery.search_ipv4(1, 1)
print(found, [d["DeviceName"] for d in management.configureddevices(found[0])])
"""


@pytest.mark.rigs
def test_the_makers_client_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """alpyca, ASCOM's own client, takes our server for one: it asks what we ask and reads what we read."""
    python = others_python("alpyca")
    broadcast = "127.255.255.255"  # alpyca asks there
    with (
        scripted(lambda method, member, fields: LISTED) as url,
        answering(monkeypatch, port_of(url), at=broadcast) as heard,
    ):
        program = ALPYCA.format(port=alpaca_discovery.DISCOVERY_PORT)
        run = subprocess.run([python, "-c", program], capture_output=True, text=True, check=True, timeout=60.0)
        assert set(heard) == {alpaca_discovery.QUESTION}
    assert run.stdout.strip() == f"[{url.removeprefix('http://')!r}] ['EFW', 'Box', 'Panel', 'Dome']"
