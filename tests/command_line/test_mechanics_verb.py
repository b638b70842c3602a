"""``finray simulate --only mechanics``: a push that finds no equilibrium leaves what it reached, to go on from."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from data_schemas.errors import RecordError
from data_schemas.press_mechanics import PressIncrement, PressMechanics
from data_schemas.storage import read_record
from data_schemas.surfaces import FingerSurfaces
from finray_calib.cli.simulate_mechanics import last_increment, mechanics_paths
from sim.mechanics.newton import Increment, NewtonOptions, load_increments
from sim.surface_meshes.intersections import check_no_intersections
from sim.surface_meshes.stored_shape import restore_shapes
from tests.command_line.running import finray, succeed

FINGER = """
name = "short press"
[indenter]
depth_mm = 0.6
friction = 0.3
"""


def impatient(
    assembly: Any, solver: Any, loading: Any, stops: list[float], *place: Any, **more: Any
) -> Iterator[Increment]:
    """Find the first equilibrium, and allow the second one iteration."""
    first = next(load_increments(assembly, solver, loading, stops[:1], *place, **more))
    yield first
    yield from load_increments(
        assembly,
        solver,
        loading,
        stops[1:],
        first.equilibrium.state,
        first.fraction,
        shortest_share=1.0,
        options=NewtonOptions(iterations=1),
        settle=more["settle"],
    )


def test_a_push_that_ends_early_is_kept_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    press = f"simulate {tmp_path}/finger.toml --only mechanics --increments 2 --out {tmp_path}"
    with monkeypatch.context() as patched:
        patched.setattr("sim.mechanics.press.load_increments", impatient)
        outcome = finray(f"{press}/early.press.json")
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert re.search(
        r"error: the push ended early, at 0\.3 of 0\.6 mm: no equilibrium beyond 0\.5 of the load: .* is stored",
        outcome.err,
    ), outcome.err
    assert "push  0.300 mm" in outcome.out
    early = read_record(tmp_path / "early.mechanics.json", PressMechanics)
    assert early.unreached
    assert early.depth_mm[-1] == pytest.approx(0.3)
    assert any("friction 0.3 between indenter and finger" in note for note in early.notes)
    assert (tmp_path / "early.mechanics.png").read_bytes().startswith(b"\x89PNG")
    # what --surfaces restores for the optics
    _, shape = restore_shapes(read_record(tmp_path / "early.surfaces.json", FingerSurfaces))
    check_no_intersections(shape.gel)

    resumed = succeed(f"{press}/whole.press.json --resume {tmp_path}/early.increments")
    assert "push  0.600 mm" in resumed
    whole = read_record(tmp_path / "whole.mechanics.json", PressMechanics)
    assert not whole.unreached
    assert whole.force_n[0, 1] == early.force_n[-1, 1]
    assert whole.force_n[1, 1] > 1.5 * whole.force_n[0, 1]
    last = read_record(tmp_path / "whole.increments" / "002.json", PressIncrement)
    assert last.depth_mm[-1] == pytest.approx(0.6)


def test_an_earlier_increment_is_not_resumed_over_later_ones(tmp_path):
    folder = tmp_path / "d.increments"
    folder.mkdir()
    for number in (1, 2, 1000):
        (folder / f"{number:03d}.json").write_text("{}")
    assert last_increment(folder).name == "1000.json"
    with pytest.raises(RecordError, match="later increments stand beside it"):
        mechanics_paths(tmp_path / "d.press.json", folder / "002.json")
    assert mechanics_paths(tmp_path / "d.press.json", folder / "1000.json")["increments"] == folder
