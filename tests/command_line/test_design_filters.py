"""``finray design filters`` as users run it: of a rig, of a paint, with a catalogue of their own."""

import json

import pytest

from rigs import simulated_rig, write_rig
from tests.acceptance.paints import EXAMPLE, example
from tests.command_line.running import finray, succeed

CATALOGUE = "# a shop\ncentre_nm,width_nm,peak_transmission\n" + "".join(f"{c},25,0.9\n" for c in range(500, 700, 20))


@pytest.fixture
def rig(tmp_path):
    return write_rig(simulated_rig("red"), tmp_path / "rig.toml")


def test_filters_of_a_rig(rig, tmp_path):
    (tmp_path / "shop.csv").write_text(CATALOGUE)
    words = f"design filters {rig} --catalogue {tmp_path}/shop.csv --keep 405 --number 6 --paints 2 --seed 4"
    told = succeed(words)
    assert told.startswith("6 filters for '")
    assert "405 nm, 10 nm wide  (of the rig)" in told
    assert "fits of 2 simulated paints: median error" in told
    given = json.loads(succeed(f"{words} --json"))["result"]
    assert len(given["filters"]) == 6
    assert sum(one["kept"] for one in given["filters"]) == 2
    assert all(one["width_nm"] == 25.0 for one in given["filters"] if not one["kept"])
    assert given["mean_ratio"][1] <= given["mean_ratio"][0] <= given["mean_ratio"][2]


def test_the_next_filter_of_a_paint():
    path = EXAMPLE / f"v{type(example()).schema_version}" / "example.json"
    told = succeed(f"design filters {path}")
    assert told.startswith("filters that could be added for '")
    assert told.count("nm wide") == 8


def test_mistakes(rig, tmp_path):
    path = EXAMPLE / f"v{type(example()).schema_version}" / "example.json"
    for words, match in (
        (f"design filters {path} --keep 405", "are only for a rig"),
        (f"design filters {rig} --keep 406", "filters of the rig are centred at 405, 450"),
        (f"design filters {rig} --number 65", "must be 2 to 64 (--number), but 65 were requested; 1 are kept, "),
        (f"design filters {rig} --paints -1", "must be 0 or more"),
        (f"design filters {rig} --catalogue {tmp_path}/none.csv", "none.csv"),
    ):
        outcome = finray(words)
        assert outcome.status == 2
        assert match in outcome.err
