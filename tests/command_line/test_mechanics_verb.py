"""``finray simulate press``: a push that finds no equilibrium leaves what it reached, to go on from."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_schemas import FingerSurfaces, NoEquilibriumError, PressIncrement, PressMechanics, RecordError
from data_schemas.storage import read_record, sha256_of
from finray_calib.cli._simulate_press import last_increment, mechanics_paths
from sim import read_design
from sim.mechanics import FORCE_EXCESS_REL, STEPS, PressSettings, press_finger
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._increments import Increment, load_increments
from sim.mechanics._newton import NewtonOptions
from sim.surface_meshes import check_no_intersections, restore_shapes, stl_bytes
from tests.command_line.mistakes import CUBE, FACETS
from tests.command_line.running import finray, succeed

BABY = """
preset = "flat-70x35"
name = "small"
[pad]
length_mm = 48.0
width_mm = 18.0
film = {}
[indenter]
position_mm = 24.0
"""
FINGER = BABY + "depth_mm = 0.2\nfriction = 0.3\n"


@pytest.fixture
def rough_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mesh half as finely as coarse: what is shown does not hang on it."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))


def impatient(
    assembly: Any, solver: Any, load: Any, stops: list[float], *place: Any, **more: Any
) -> Iterator[Increment]:
    """Find the first equilibrium, and allow the second one iteration."""
    first = next(load_increments(assembly, solver, load, stops[:1], *place, **more))
    yield first
    yield from load_increments(
        assembly,
        solver,
        load,
        stops[1:],
        (first.fraction, first.equilibrium.state),
        shortest_share=1.0,
        options=NewtonOptions(iterations=1),
    )


@pytest.mark.usefixtures("rough_mesh")
def test_a_push_that_ends_early_is_kept_and_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    press = f"simulate press {tmp_path}/finger.toml --increments 2 --out {tmp_path}"
    with monkeypatch.context() as patched:
        patched.setattr("sim.mechanics._press.load_increments", impatient)
        outcome = finray(f"{press}/early.press.json")
    assert outcome.status == 2
    errors = [line for line in outcome.err.splitlines() if not line.startswith("warning: the coat's elements of 3 mm")]
    assert len(errors) == 1
    assert re.search(
        r"the push ended early, at 0\.1 of 0\.2 mm: no equilibrium was found beyond 0\.5 of the load: .* are stored",
        outcome.err,
    ), outcome.err
    assert "push  0.100 mm" in outcome.out
    early = read_record(tmp_path / "early.mechanics.json", PressMechanics)
    assert early.unreached
    assert early.mesh_excess_rel == FORCE_EXCESS_REL["coarse"]
    assert early.depth_mm[-1] == pytest.approx(0.1)
    assert any("Coulomb friction 0.3, which follows stick and slip" in note for note in early.notes)
    assert (tmp_path / "early.mechanics.png").read_bytes().startswith(b"\x89PNG")
    # what --surfaces restores for the optics
    _, shape = restore_shapes(read_record(tmp_path / "early.surfaces.json", FingerSurfaces))
    check_no_intersections(shape.gel)

    resumed = finray(f"{press}/whole.press.json --resume {tmp_path}/early.increments")
    assert resumed.status == 0
    assert "push  0.200 mm" in resumed.out
    whole = read_record(tmp_path / "whole.mechanics.json", PressMechanics)
    assert not whole.unreached
    assert whole.force_n[0, 1] == early.force_n[-1, 1]
    assert whole.force_n[1, 1] > 1.5 * whole.force_n[0, 1]
    last = read_record(tmp_path / "whole.increments" / "002.json", PressIncrement)
    assert last.depth_mm[-1] == pytest.approx(0.2)


@pytest.mark.usefixtures("rough_mesh")
def test_an_indenter_follows_the_path_of_a_file(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    (tmp_path / "path.csv").write_text("push_mm,along_mm,turn_y_deg,increments\n0.3,0,0,1\n0.3,0.2,4,2\n")
    out = f"--path {tmp_path}/path.csv --out {tmp_path}/moved.press.json"
    said = succeed(f"simulate press {tmp_path}/finger.toml {out}")
    assert said.count("sticks") == 3
    # numbers that round to 0 from below do not move the columns of their line
    rows = [line for line in said.splitlines() if "sticks" in line]
    assert len({tuple(row.index(word) for word in ("turn", "force", "torque", " % of")) for row in rows}) == 1, said
    stored = read_record(tmp_path / "moved.mechanics.json", PressMechanics)
    motion = stored.motion
    assert motion is not None
    np.testing.assert_allclose(motion.moves_mm, [[0, -0.3, 0], [0, -0.3, 0.1], [0, -0.3, 0.2]])
    np.testing.assert_allclose(motion.turns_deg[:, 1], [0.0, 2.0, 4.0])
    # the pad is pulled along by the indenter, which is held back by no more than friction
    assert -motion.shear_mpa[-1, :, 2].sum() > 0.0
    assert (np.linalg.norm(motion.shear_mpa, axis=-1) <= 0.3 * motion.pressure_mpa * 1.01).all()
    # pressure is at right angles to a nearly plane coat: the points add up to the force along the normal
    pushed = motion.pressure_mpa @ motion.point_areas_mm2
    np.testing.assert_allclose(pushed, stored.force_n[:, 1], rtol=0.03)
    assert stored.provenance is not None
    assert any(name.endswith("path.csv") for name in stored.provenance.input_sha256)
    assert (tmp_path / "moved.mechanics.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "--force 2",
            "--path moves the indenter along given poses, which works only from first touch, with penalty contact and "
            "finray's own elements, and without sensitivities; leave out --path, or --force",
        ),
        (
            "--contact barrier",
            "--path moves the indenter along given poses, which works only from first touch, with penalty contact and "
            "finray's own elements, and without sensitivities; leave out --path, or --contact barrier",
        ),
        (
            "--sensitivities",
            "--path moves the indenter along given poses, which works only from first touch, with penalty contact and "
            "finray's own elements, and without sensitivities; leave out --path, or --sensitivities",
        ),
    ],
)
def test_a_path_does_not_go_with_other_presses(tmp_path: Path, options: str, message: str) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    (tmp_path / "path.csv").write_text("push_mm\n0.3\n")
    said = refused(f"simulate press {tmp_path}/finger.toml --path {tmp_path}/path.csv {options}")
    assert message in said


def test_a_path_that_is_not_there_is_told_before_the_press(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(FINGER)
    said = refused(f"simulate press {tmp_path}/finger.toml --path {tmp_path}/none.csv")
    assert "none.csv" in said


def test_a_push_that_never_begins_leaves_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any, **__: Any) -> Iterator[Increment]:
        raise NoEquilibriumError("no equilibrium was found beyond 0 of the load: the stiffness matrix is singular")
        yield

    (tmp_path / "finger.toml").write_text(FINGER)
    monkeypatch.setattr("sim.mechanics._press.load_increments", never)
    said = refused(f"simulate press {tmp_path}/finger.toml --out {tmp_path}/stuck.json")
    assert re.search(r"matrix is singular\. \S*stuck\.mechanics\.png shows where the indenter touches", said)
    assert (tmp_path / "stuck.mechanics.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["finger.toml", "stuck.mechanics.png"]


def test_an_earlier_increment_is_not_resumed_over_later_ones(tmp_path):
    folder = tmp_path / "d.increments"
    folder.mkdir()
    for number in (1, 2, 1000):
        (folder / f"{number:03d}.json").write_text("{}")
    assert last_increment(folder).name == "1000.json"
    with pytest.raises(RecordError, match="later increments are stored in the same folder"):
        mechanics_paths(tmp_path / "d.press.json", folder / "002.json")
    assert mechanics_paths(tmp_path / "d.press.json", folder / "1000.json")["increments"] == folder


def refused(arguments: str) -> str:
    """Run a command that must end in one line of explanation; return it."""
    outcome = finray(arguments)
    assert outcome.status == 2
    assert outcome.out == ""
    return outcome.err


@pytest.mark.usefixtures("rough_mesh")
def test_an_stl_that_changed_is_not_gone_on_with(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(BABY + 'depth_mm = 0.2\nshape = "mesh"\nfile = "cube.stl"\n')
    body = CUBE - np.array([2.5, 0.0, 2.5])
    (tmp_path / "cube.stl").write_bytes(stl_bytes(FACETS, body, "body"))
    press = f"simulate press {tmp_path}/finger.toml"
    succeed(f"{press} --increments 1 --out {tmp_path}/first.json")
    stored = read_record(tmp_path / "first.increments" / "001.json", PressIncrement)
    assert stored.contact == "penalty"
    assert stored.indenter_sha256 == sha256_of(tmp_path / "cube.stl")

    (tmp_path / "finger.toml").write_text(BABY + 'depth_mm = 0.3\nshape = "mesh"\nfile = "cube.stl"\n')
    # a taller body of the same face: it touches at the same place, and no node of the mesh tells it
    (tmp_path / "cube.stl").write_bytes(stl_bytes(FACETS, body * [1.0, 1.5, 1.0], "body"))
    said = refused(f"{press} --resume {tmp_path}/first.increments --out {tmp_path}/second.json")
    assert re.search(
        r"indenter\.file = 'cube\.stl', has changed since the stored increment .* restore the original file", said
    )
    assert not (tmp_path / "second.mechanics.json").exists()


def test_a_press_to_a_force_tells_the_depth_and_the_torque_at_slip(tmp_path: Path) -> None:
    (tmp_path / "finger.toml").write_text(BABY)
    said = succeed(f"simulate press {tmp_path}/finger.toml --force 0.8 --increments 2 --out {tmp_path}/held.json")
    record = read_record(tmp_path / "held.mechanics.json", PressMechanics)
    assert f"push  {record.depth_mm[-1]:.3f} mm   force   0.800 N" in said
    assert record.wanted_force_n == 0.8
    assert record.force_n[:, 1] == pytest.approx([0.4, 0.8], rel=1e-5)
    assert any("driven by a force of 0.8 N" in note for note in record.notes)
    # a cylinder across the middle: its resultant is half the pad's width from the edge
    assert record.tipping_torque_n_mm == pytest.approx(0.8 * 9.0, rel=1e-3)
    # a strip across the pad: even pressure on it gives N w / 4, all of it at both edges N w / 2
    assert 0.25 < record.slip_torque_per_friction_n_mm / (0.8 * 18.0) < 0.5
    assert "N mm times the friction coefficient" in said
    check_no_intersections(restore_shapes(read_record(tmp_path / "held.surfaces.json", FingerSurfaces))[1].gel)


@pytest.mark.usefixtures("rough_mesh")
def test_a_force_that_is_not_reached_is_told_as_what_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "finger.toml").write_text(BABY)
    monkeypatch.setattr("sim.mechanics._loads.load_increments", impatient)
    outcome = finray(f"simulate press {tmp_path}/finger.toml --force 0.8 --increments 2 --out {tmp_path}/held.json")
    assert outcome.status == 2
    assert (
        "error: the push ended early, at 0.4 of 0.8 N: no equilibrium was found beyond 0.5 of the load" in outcome.err
    )
    record = read_record(tmp_path / "held.mechanics.json", PressMechanics)
    assert record.force_n[:, 1] == pytest.approx([0.4], rel=1e-5)
    # not with the force that was tried last
    assert any(note.endswith("driven by a force of 0.4 N") for note in record.notes)


def test_a_press_is_stored_though_none_with_a_number_changed_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise NoEquilibriumError("no equilibrium was found beyond 0 of the load: the stiffness matrix is singular")

    (tmp_path / "finger.toml").write_text(BABY + "depth_mm = 0.2\n")
    monkeypatch.setattr("sim.experiments._design_sensitivities.press_sensitivities", never)
    press = f"simulate press {tmp_path}/finger.toml --increments 1 --sensitivities"
    outcome = finray(f"{press} --out {tmp_path}/lone.json")
    assert outcome.status == 2
    assert re.search(
        r"error: the sensitivities of the force could not be .* is singular\. The press itself is stored", outcome.err
    )
    assert "push  0.200 mm" in outcome.out
    record = read_record(tmp_path / "lone.mechanics.json", PressMechanics)
    assert record.depth_mm[-1] == pytest.approx(0.2)
    assert record.sensitivities is None
    assert any("the sensitivities of the force could not be computed" in note for note in record.notes)


@pytest.mark.parametrize(
    ("tables", "options", "message"),
    [
        (
            "",
            "--seed 1",
            r"finray simulate: error: 'finray simulate press' does not take --seed 1; .* --help' lists what can be",
        ),
        (
            "",
            "--force 2 --contact barrier",
            r"--force works only from first .*; leave out --force, or --contact barrier\n",
        ),
        ("", "--force 2 --resume d.increments", r"--force works only from first touch, with penalty contact"),
        ("", "--force two", r"--force: 'two' must be a force in N above 0 and at most 1000"),
        (
            "friction = 0.3",
            "--force 2",
            r"with --force, the indenter must be a cylinder, ball or cuboid without friction",
        ),
        ("edge_radius_mm = 1.0", "", r"indenter\.edge_radius_mm has no effect, because it belongs to a cuboid"),
        ("", "--budget 60 --sensitivities", r"--budget works only for a single press with finray's own elements"),
        ("", "--budget soon", r"--budget: 'soon' must be a processor time in s above 0 and at most"),
        (
            'shape = "cuboid"\nsize_mm = [9, 9, 9]\nradius_mm = 5',
            "",
            r"indenter\.radius_mm has no effect, because it belongs to a cylinder or a ball, not to shape = \"cuboid\"",
        ),
        ("[skeleton]\nrib_count = 1\nrib_spacing_mm = 9", "", r"rib_spacing_mm .* rib_count = 2 or"),
        ("[skeleton]\nrib_count = 40\nrib_thickness_mm = 2.5", "", r"overlap or nearly touch .*= 40,"),
        ("[skeleton]\nrib_count = 41", "", r"'skeleton\.rib_count': must be at most 40"),
    ],
)
def test_what_has_no_effect_is_refused(tmp_path: Path, tables: str, options: str, message: str) -> None:
    (tmp_path / "finger.toml").write_text(BABY + tables)
    said = refused(f"simulate press {tmp_path}/finger.toml {options} --out {tmp_path}/no.json")
    assert re.search(message, said), said


@pytest.mark.parametrize(
    ("radius_mm", "depth_mm", "message"),
    [
        (
            2.0,
            0.1,
            "touches no node of the coat, whose elements are 2 mm wide, so the force of 0 N comes from the mesh",
        ),
        # barrier: 0.428 N, 15 % more
        (2.0, 0.5, "the force there is some 15 % too low; press with --contact barrier"),
    ],
)
def test_a_force_that_rests_on_few_nodes_is_told(tmp_path, radius_mm, depth_mm, message):
    path = tmp_path / "ball.toml"
    path.write_text(BABY + f'shape = "ball"\nradius_mm = {radius_mm}\ndepth_mm = {depth_mm}\nacross_mm = 0.0\n')
    outcome = finray(f"simulate press {path} --increments 1 --out {tmp_path}/ball.press.json")
    assert outcome.status == (2 if "no node" in message else 0)
    assert message in outcome.err
    stored = read_record(tmp_path / "ball.mechanics.json", PressMechanics)
    assert any("the coat passes into the indenter" in note for note in stored.notes)


def small_ball(tmp_path: Path, radius_mm: float, depth_mm: float) -> Path:
    """Write a finger with a ball of less than an element over a side of the mesh."""
    path = tmp_path / "ball.toml"
    path.write_text(BABY + f'shape = "ball"\nradius_mm = {radius_mm}\ndepth_mm = {depth_mm}\n')
    return path


def test_a_force_of_no_touch_is_noted_as_the_meshs(tmp_path):
    finray(f"simulate press {small_ball(tmp_path, 2.0, 0.1)} --increments 1 --out {tmp_path}/b.press.json")
    stored = read_record(tmp_path / "b.mechanics.json", PressMechanics)
    assert stored.force_n[-1, 1] == 0.0
    assert any("touches no node, or has passed between the nodes" in note for note in stored.notes)


@pytest.mark.parametrize(
    ("indenter", "depth_mm"),
    [('shape = "cuboid"\nsize_mm = [30.0, 3.0, 10.0]', 3.0), ('shape = "ball"\nradius_mm = 1.0', 1.0)],
)
def test_an_indenter_that_would_jump_through_the_coat_takes_smaller_increments(
    tmp_path, indenter, depth_mm, monkeypatch
):
    """A push of its own height, or radius, in one increment finds an equilibrium behind the coat, too."""
    path, reached = tmp_path / "jump.toml", {}
    path.write_text(BABY + f"{indenter}\ndepth_mm = {depth_mm}\n")

    def press(name, increments):
        assert finray(f"simulate press {path} --increments {increments} --out {tmp_path}/{name}.press.json").status == 0
        reached[name] = read_record(tmp_path / f"{name}.mechanics.json", PressMechanics)

    press("four", 4)
    press("one", 1)
    # a search that starts from rest
    monkeypatch.setattr("sim.mechanics._penalty_contact.PenaltyPress.hold", lambda *_: False)
    press("jump", 1)
    assert len(reached["jump"].depth_mm) > 1
    assert reached["jump"].depth_mm[-1] == depth_mm
    # the same equilibrium by another way
    for found in reached.values():
        assert found.force_n[-1, 1] == pytest.approx(reached["four"].force_n[-1, 1], rel=1e-5)


@pytest.mark.usefixtures("rough_mesh")
def test_a_press_that_may_stand_at_an_unstable_equilibrium_is_warned_of(tmp_path, monkeypatch):
    def unstable(*place: Any, **more: Any) -> Iterator[Increment]:
        for step in load_increments(*place, **more):
            yield Increment(step.fraction, replace(step.equilibrium, unstable="the search could not leave it"))

    monkeypatch.setattr("sim.mechanics._press.load_increments", unstable)
    (tmp_path / "finger.toml").write_text(BABY + "depth_mm = 0.1\n")
    outcome = finray(f"simulate press {tmp_path}/finger.toml --increments 1 --out {tmp_path}/a.press.json")
    assert outcome.status == 0
    told = "at a push of 0.1 mm, the search could not leave it"
    assert f"warning: {told}; press in smaller increments" in outcome.err
    assert told in read_record(tmp_path / "a.mechanics.json", PressMechanics).notes


def test_an_indenter_that_passes_between_the_nodes_is_refused(tmp_path):
    outcome = finray(f"simulate press {small_ball(tmp_path, 0.5, 3.0)} --increments 1 --out {tmp_path}/b.press.json")
    assert outcome.status == 2
    assert re.search(r"at a push of 1\.\d+ mm the indenter touches no node of the coat", outcome.err)
    stored = read_record(tmp_path / "b.mechanics.json", PressMechanics)
    assert "the indenter has passed through the coat" in stored.unreached
    assert stored.slip_torque_per_friction_n_mm is None
    assert "the grip resists a torque" not in outcome.out


def test_a_force_on_an_indenter_that_touches_no_node_is_refused(tmp_path):
    path = small_ball(tmp_path, 2.0, 0.1)
    outcome = finray(f"simulate press {path} --force 0.05 --out {tmp_path}/b.press.json")
    assert outcome.status == 2
    assert (
        "the indenter touches no node of the coat at a push of 0.1 mm, where a press with --force begins" in outcome.err
    )
    assert (tmp_path / "b.mechanics.png").exists()


def dies_after_one(*place: Any, **more: Any) -> Iterator[Increment]:
    yield next(load_increments(*place, **more))
    raise KeyboardInterrupt


@pytest.mark.usefixtures("rough_mesh")
def test_an_interrupted_press_goes_on_with_the_same_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process dies while the last product is written; before that, while the second increment is sought."""
    (tmp_path / "finger.toml").write_text(BABY + "depth_mm = 0.3\n")
    press = f"simulate press {tmp_path}/finger.toml --increments 3 --out {tmp_path}"
    assert finray(f"{press}/whole.press.json").status == 0

    def dies(*_: Any, **__: Any) -> Iterator[Increment]:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("sim.mechanics._press.load_increments", dies_after_one)
        assert finray(f"{press}/cut.press.json").status == 130
    increments = tmp_path / "cut.increments"
    assert [path.name for path in sorted(increments.glob("*.json"))] == ["001.json"]
    first = sha256_of(increments / "001.json")
    with monkeypatch.context() as patched:
        patched.setattr("finray_calib.exchange._mesh_files.vtu_bytes", dies)
        outcome = finray(f"{press}/cut.press.json")
    assert (outcome.status, outcome.err.splitlines()[0]) == (
        130,
        f"{increments}: this press was interrupted; it continues after increment 001",
    )
    for left in ("cut.mechanics.json", "cut.surfaces.json"):  # of a set that was cut off
        for path in tmp_path.glob(f"{left.removesuffix('.json')}.*"):
            path.unlink()
    third = sha256_of(increments / "003.json")
    again = finray(f"{press}/cut.press.json")
    assert again.status == 0
    assert again.err.startswith(f"{increments}: this press was interrupted; it continues after increment 002\n")
    assert (sha256_of(increments / "001.json"), sha256_of(increments / "003.json")) == (first, third)
    whole, cut = (read_record(tmp_path / f"{name}.mechanics.json", PressMechanics) for name in ("whole", "cut"))
    np.testing.assert_allclose(cut.force_n, whole.force_n, rtol=1e-6)
    assert len(cut.depth_mm) == 3


@pytest.mark.usefixtures("rough_mesh")
@pytest.mark.parametrize(
    ("options", "depth_mm"),
    [("--increments 3", 0.2), ("--increments 2 --contact penalty", 0.2), ("--increments 2", 0.3)],
)
def test_an_interrupted_press_is_not_mixed_with_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: str, depth_mm: float
) -> None:
    (tmp_path / "finger.toml").write_text(BABY + "depth_mm = 0.2\n")
    press = f"simulate press {tmp_path}/finger.toml"
    with monkeypatch.context() as patched:
        patched.setattr("sim.mechanics._press.load_increments", dies_after_one)
        assert finray(f"{press} --increments 2 --out {tmp_path}/cut.press.json").status == 130
    (tmp_path / "finger.toml").write_text(BABY + f"depth_mm = {depth_mm}\n")
    said = refused(f"{press} {options} --out {tmp_path}/cut.press.json")
    assert "cut.increments: exists already and is not overwritten" in said


class Ticking:
    """A processor's clock that goes on by a second whenever it is read."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def process_time(self) -> float:
        self.now_s += 1.0
        return self.now_s


# ribs at -24.5 deg of 0.65 mm fold under a turned cuboid: two increments of 2.5 mm once took 225 s without a word
FOLDING = """
preset = "flat-70x35"
[skeleton]
rib_count = 5
rib_thickness_mm = 0.65
rib_angle_deg = -24.5
front_fin_thickness_mm = 2.35
back_fin_thickness_mm = 1.99
[indenter]
shape = "cuboid"
size_mm = [50, 12, 12]
position_mm = 13.5
across_mm = -2.7
rotation_deg = [0, 29.2, 0]
depth_mm = 5.0
"""


@pytest.mark.usefixtures("rough_mesh")
def test_a_press_that_hardly_goes_on_tells_each_iteration_and_ends_with_its_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "finger.toml").write_text(FOLDING)
    monkeypatch.setattr("sim.mechanics._increments.time", Ticking())
    told: list[str] = []
    with pytest.raises(NoEquilibriumError, match="the budget of 20 s of processor time is spent"):
        press_finger(
            read_design(tmp_path / "finger.toml"),
            PressSettings(increments=2, budget_s=20.0),
            progress=lambda *at: told.append(at[2]),
        )
    # the clock is read twice an iteration, and the last one is foreseen
    assert 8 <= sum("out of balance by " in line for line in told) <= 10


@pytest.mark.usefixtures("rough_mesh")
@pytest.mark.parametrize("force", ["", "--force 0.1"])
def test_the_last_increment_before_the_budget_was_spent_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: str
) -> None:
    from sim.mechanics._increments import Watch

    clock, reached = Ticking(), Watch.reached

    def slowly(watch: Watch, *told: Any) -> None:
        clock.now_s += 1000.0
        reached(watch, *told)

    monkeypatch.setattr("sim.mechanics._increments.time", clock)
    monkeypatch.setattr(Watch, "reached", slowly)
    (tmp_path / "finger.toml").write_text(BABY + "depth_mm = 0.4\n")
    press = f"simulate press {tmp_path}/finger.toml --increments 2 {force} --out {tmp_path}/d.press.json"
    outcome = finray(f"{press} --budget 900")
    assert outcome.status == 2
    assert re.search(r"the push ended early, at \S+ of \S+ (mm|N): the budget of 900 s of .* are stored", outcome.err)
    record = read_record(tmp_path / "d.mechanics.json", PressMechanics)
    assert len(record.depth_mm) == 1
    assert record.unreached.startswith("the budget of 900 s of processor time is spent")
    check_no_intersections(restore_shapes(read_record(tmp_path / "d.surfaces.json", FingerSurfaces))[1].gel)


@pytest.mark.usefixtures("rough_mesh")
def test_a_press_is_named_after_its_design_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):  # of the same name inside
        (tmp_path / f"{name}.toml").write_text(BABY + "depth_mm = 0.5\n")
        succeed(f"simulate press {name}.toml --increments 1")
        assert (tmp_path / f"{name}.mechanics.json").is_file()
