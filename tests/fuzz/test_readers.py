"""Every reader on a few mutated files: refused in one line or read, never a traceback, a crash, a hang or much memory.

``make bench-fuzz`` does the same with some 5,000; this is its small twin.
"""

import contextlib
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_schemas import RecordError
from data_schemas.storage import parse_json
from data_schemas.storage._foreign_files import parse_toml
from tests.fuzz.examples import READERS, Reader
from tests.fuzz.host import FAULTS, Host
from tests.fuzz.mutations import mutated

SEEDS = 3
QUICK = [reader for reader in READERS if reader.every == 1]


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host() as started:
        yield started


@pytest.mark.timeout(600)
@pytest.mark.parametrize("reader", QUICK, ids=lambda reader: reader.name)
def test_mutated_files_are_refused_or_read(host: Host, reader: Reader) -> None:
    if "9DTact" in reader.name and not (Path(__file__).resolve().parents[3] / "shared" / "data").is_dir():
        pytest.skip("the measured sensor is not beside the checkout")
    for seed in range(100_000, 100_000 + SEEDS):
        found = host.run(reader.name, seed)
        assert found["outcome"] not in FAULTS, found


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400) | st.text(max_size=400).map(str.encode), st.sampled_from("[{\"'a.=\n\\"))
def test_any_bytes_are_refused_or_parsed(content: bytes, repeated: str) -> None:
    for parse in (parse_json, parse_toml):
        for text in (content, content + 3000 * repeated.encode()):
            with contextlib.suppress(RecordError):
                parse(text, "x")


def test_a_host_tells_a_traceback_a_crash_a_hang_and_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge is judged: each fault is made by hand."""
    import os
    import signal

    from tests.fuzz import host as module

    def spin() -> dict[str, str]:
        while True:
            pass

    def fill() -> dict[str, str]:
        return {"outcome": "accepted", "text": str(len(b"\1" * (1200 << 20)))}

    faults = {
        "traceback": lambda: {}["missing"],
        "crash": lambda: os.kill(os.getpid(), signal.SIGSEGV),
        "memory": fill,
    }
    for outcome, function in faults.items():
        assert module._in_fork(function)["outcome"] == outcome  # noqa: SLF001
    # last, since a machine that is short of memory has taken 5 s of the processor to fill it
    monkeypatch.setattr(module, "HANGS_S", 2.0)
    assert module._in_fork(spin)["outcome"] == "hang"  # noqa: SLF001


def test_mutations_are_drawn_by_their_seed_and_change_the_content() -> None:
    content = b'{"a": [1, 2.5, "x"], "b": {"c": true}}'
    first, again = (mutated(content, ".json", random.Random(4)) for _ in range(2))
    assert first == again
    changed = [mutated(content, ".json", random.Random(seed)).content != content for seed in range(200)]
    assert sum(changed) > 190
