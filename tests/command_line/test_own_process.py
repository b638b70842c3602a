"""A long verb in a process of its own: the same words and status as before, and a sentence when that process dies."""

import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest

from data_schemas import PressMechanics
from data_schemas.storage import read_record
from tests.command_line.running import Program, finray, tree
from tests.schemas.test_child_process import gone_within

FINGER = """
preset = "flat-70x35"
name = "small"
[pad]
length_mm = 48.0
width_mm = 18.0
film = {}
[indenter]
position_mm = 24.0
depth_mm = 0.6
"""


def without_progress(err: str) -> list[str]:
    return [line for line in err.splitlines() if not line.startswith("simulate: ")]


def test_a_mistake_is_told_in_the_same_words_and_leaves_no_log(tmp_path):
    (tmp_path / "f.toml").write_text(FINGER)
    for arguments in ("simulate press f.toml --seed 1", "simulate none.toml", "simulate render f.toml --level x"):
        apart = Program(arguments, tmp_path).end()
        before = os.getcwd()
        os.chdir(tmp_path)
        try:
            here = finray(arguments)
        finally:
            os.chdir(before)
        assert apart == (2, here.out, here.err.replace("__main__.py", "finray"))
    assert [path.name for path in tmp_path.iterdir()] == ["f.toml"]


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGKILL])
def test_a_press_that_dies_is_one_sentence_and_goes_on(tmp_path, number):
    (tmp_path / "f.toml").write_text(FINGER)
    press = "simulate press f.toml --increments 3 --out "
    first = Program(press + "a.press.json", tmp_path)
    first.wait_for(tmp_path / "a.increments" / "001.json")
    (child,) = first.children()
    os.kill(child, number)
    status, out, err = first.end()
    assert (status, out) == (3, "")
    (said,) = without_progress(err)
    assert re.search(
        rf"^finray simulate: error: the press by finite elements was (ended by|killed \() ?{number.name}.*"
        r"; it had taken \d\.\d\d GiB of memory\. Its log is \S+a\.log\. Finished increments are kept, and the same "
        r"command continues after the last one\. If it fails again, run 'finray doctor' to see what this machine "
        r"lacks$",
        said,
    ), said
    assert "The process was " in (tmp_path / "a.log").read_text()
    kept = {path: what for path, what in tree(tmp_path / "a.increments").items() if not Path(path).name.startswith(".")}

    status, out, err = Program(press + "a.press.json", tmp_path).end()
    assert status == 0, err
    assert re.search(r"a\.increments: this press was interrupted; it continues after increment 00\d\n", err)
    assert "push  0.600 mm" in out
    assert kept.items() <= tree(tmp_path / "a.increments").items()
    status, _, err = Program(press + "b.press.json", tmp_path).end()
    assert status == 0, err
    gone_on, whole = (read_record(tmp_path / f"{name}.mechanics.json", PressMechanics) for name in "ab")
    np.testing.assert_allclose(gone_on.force_n, whole.force_n, rtol=1e-6)
    assert not (tmp_path / "b.log").exists()


def test_ctrl_c_ends_it_and_its_process(tmp_path):
    (tmp_path / "f.toml").write_text(FINGER)
    running = Program("simulate press f.toml --increments 6 --out a.press.json", tmp_path)
    running.wait_for(tmp_path / "a.increments" / "001.json")
    children = running.children()
    running.process.send_signal(signal.SIGINT)
    status, _, err = running.end()
    assert status == 130
    assert without_progress(err) == ["finray simulate: interrupted; files already written are complete"]
    assert len(children) == 1
    assert gone_within(children, 5.0)
    assert not (tmp_path / "a.log").exists()
