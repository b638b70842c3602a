"""``finray design paints``: ranks calibrated paints, stores what it says, and refuses what cannot be ranked."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import PaintChoice
from data_schemas.storage import read_record
from tests.command_line.running import finray, load, succeed

FINGER = 'preset = "flat-70x35"\nname = "coarse finger"\n[camera]\nwidth_px = 64\nheight_px = 48\n'


@pytest.mark.renderer
def test_paints_are_ranked_and_stored(paints: Path, tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    files = f"--paint {paints}/red/paint.json --paint {paints}/green/paint.json"
    said = succeed(f"design paints {tmp_path}/finger.toml {files} --out {tmp_path}/choice.json --seed 3")
    choice = read_record(tmp_path / "choice.json", PaintChoice)
    assert said.startswith(choice.sentence)
    # one paint on both walls of the same kind, exchanged: the finger is the same from both sides
    assert len(choice.pairs) == 2
    assert not choice.pairs[1].is_worse
    assert "not distinguishable" in said
    assert "next: finray simulate sweep" in said
    row = choice.pairs[0]
    assert row.normal_error_deg.estimate == pytest.approx(np.median(choice.normal_error_draws_deg[0]))
    origin = load(tmp_path / "choice.json")["record"]["provenance"]
    assert origin["seed"] == 3
    assert len(origin["input_sha256"]) == 3
    # a ranking is never overwritten
    again = finray(f"design paints {tmp_path}/finger.toml {files} --out {tmp_path}/choice.json")
    assert again.status == 2
    assert "exists already" in again.err


def test_one_paint_is_no_choice(paints: Path, tmp_path: Path) -> None:
    one = f"--paint {paints}/red/paint.json"
    for given in (one, f"{one} {one}"):
        outcome = finray(f"design paints flat-70x35 {given} --out {tmp_path}/choice.json")
        assert outcome.status == 2
        assert "must name at least two files, each once, because a finger carries two paints" in outcome.err
    assert not (tmp_path / "choice.json").exists()
