"""Surfaces of a finger that pass through each other are found, and told or avoided."""

import re

import numpy as np
import pytest
import scipy.sparse as sp

from data_schemas import NoEquilibriumError, SimulateError
from sim import preset_design
from sim.experiments import increment_record, press_records, stored_press
from sim.mechanics import STEPS, Block, FingerMesh, PressSettings, finger_mesh, press_finger
from sim.mechanics import _press as press_module
from sim.mechanics._assembly import Assembly, Elasticity, State
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._increments import Load, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import neo_hooke
from sim.mechanics._mesh import OwnSurfaces, Tie, outer_triangles
from sim.mechanics._newton import NewtonOptions, Supports
from sim.mechanics._parts_contact import PartsContact
from sim.mechanics._penalty_contact import NOT_OF_RIBS
from tests.certified.blocks import unit_cells

if contact_library_failure() is None:
    from sim.mechanics._barrier_contact import finger_parts_contact
    from sim.mechanics._colliding_surfaces import CollidingSurfaces

needs_the_toolkit = pytest.mark.skipif(
    contact_library_failure() is not None, reason=f"NO BARRIER CONTACT: {contact_library_failure()}"
)


def two_blocks(apart_mm, tied=False):
    """One unit block over another, and the nodes of the upper one."""
    below, above = unit_cells(2, 2, 2), unit_cells(3, 3, 3)
    nodes = np.concatenate([below.nodes_mm, above.nodes_mm + np.array([0.1, 1.0 + apart_mm, 0.1])])
    count = len(below.nodes_mm)
    blocks = (
        Block("lower_rib", below.hexahedra, "material", "mean_dilatation"),
        Block("upper_rib", above.hexahedra + count, "material", "mean_dilatation"),
    )
    face = count + np.flatnonzero(above.nodes_mm[:, 1] == 0.0)
    ties = (Tie(face, below.top_quads()),) if tied else ()
    return FingerMesh(nodes, blocks, {}, {}, ties), np.arange(count, len(nodes))


@pytest.mark.parametrize(("down_mm", "crosses"), [(0.0, False), (0.299, False), (0.301, True), (0.8, True)])
def test_a_part_that_passes_through_another_is_named(down_mm, crosses):
    mesh, upper = two_blocks(0.3)
    move = np.zeros_like(mesh.nodes_mm)
    move[upper, 1] = -down_mm
    told = OwnSurfaces(mesh).crossing(move)
    assert bool(told) == crosses
    if crosses:
        assert told.startswith("the finger passes through itself (its ")
        assert "upper rib" in told
        assert "lower rib" in told
        assert told.endswith(" mm of the undeformed finger")


def test_a_body_that_folds_through_itself_is_found():
    # a strip along x, bent by more than a whole turn about z: its end comes out of its beginning
    strip = unit_cells(40, 1, 1, size=(10.0, 0.1, 1.0))
    mesh = strip.mesh("incompatible_modes")
    surfaces = OwnSurfaces(mesh)
    for turns, crosses in ((0.9, False), (1.1, True)):
        radius = 10.0 / (2.0 * np.pi * turns)
        angle = mesh.nodes_mm[:, 0] / radius
        far = radius - mesh.nodes_mm[:, 1]
        place = np.column_stack([far * np.sin(angle), radius - far * np.cos(angle), mesh.nodes_mm[:, 2]])
        assert bool(surfaces.crossing(place - mesh.nodes_mm)) == crosses


def test_tied_faces_may_lie_in_each_other_and_nothing_else_may():
    mesh, upper = two_blocks(-1e-3, tied=True)
    rest = np.zeros_like(mesh.nodes_mm)
    assert OwnSurfaces(mesh).crossing(rest) == ""
    apart = FingerMesh(mesh.nodes_mm, mesh.blocks, {}, {}, ())
    assert OwnSurfaces(apart).crossing(rest)
    # the upper block's free faces reach the lower one's
    rest[upper, 1] = -0.9
    assert OwnSurfaces(mesh).crossing(rest)


@needs_the_toolkit
@pytest.mark.parametrize(("within_mm", "near"), [(0.2999, False), (0.3001, True)])
def test_pairs_are_near_by_their_distance_not_by_their_boxes(within_mm, near):
    """Boxes grown by 0.2999 mm meet over a gap of 0.3 mm; a factorisation pays for each place that stays empty."""
    mesh, upper = two_blocks(0.3)
    surfaces = CollidingSurfaces(mesh.nodes_mm, outer_triangles(mesh), None, 0.02)
    pairs = surfaces.node_pairs(surfaces.vertices_mm(np.zeros_like(mesh.nodes_mm)), within_mm)
    across = np.isin(pairs, upper).sum(axis=1) == 1
    assert across.any() == near


_BABY = preset_design("baby-48x18")
SMALL = _BABY.model_copy(
    update={"indenter": _BABY.indenter.model_copy(update={"position_mm": 24.0, "depth_mm": 0.6, "friction": 0.0})}
)


@pytest.fixture
def crossing_by_penalty(monkeypatch):
    """Let the surfaces of a press by the penalty cross beyond 0.4 mm, those by the barrier (one node more) never."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    nodes = len(finger_mesh(SMALL).nodes_mm)

    def crossing(_, displacement_mm):
        crosses = np.abs(displacement_mm).max() > 0.4 and len(displacement_mm) == nodes
        return "the finger passes through itself (its skeleton through its skeleton)" if crosses else ""

    monkeypatch.setattr(OwnSurfaces, "crossing", crossing)


@needs_the_toolkit
@pytest.mark.usefixtures("crossing_by_penalty")
def test_a_press_whose_ribs_meet_begins_again_with_the_barrier():
    told = []
    pressed = press_finger(SMALL, PressSettings(increments=2), progress=lambda *at: told.append(at[2]))
    assert (pressed.kind, pressed.crossing) == ("barrier", "")
    assert pressed.depth_mm == pytest.approx([0.3, 0.6])
    assert "with penalty contact, which was tried first, from a push of 0.6 mm on, the finger" in pressed.contact
    assert any("pressing again with contact of all parts" in what for what in told)
    whole = press_finger(SMALL, PressSettings(increments=2, contact="barrier"))
    assert pressed.force_n == pytest.approx(whole.force_n, rel=1e-9, abs=1e-9)


@needs_the_toolkit
@pytest.mark.usefixtures("crossing_by_penalty")
def test_what_is_clean_stays_where_the_barrier_finds_nothing(monkeypatch):
    path, searched = press_module.load_increments, []

    def stuck(assembly, *rest, **options):
        searched.append(assembly)
        if len(searched) == 2:
            raise NoEquilibriumError("no equilibrium further on")
        return path(assembly, *rest, **options)

    monkeypatch.setattr(press_module, "load_increments", stuck)
    pressed = press_finger(SMALL, PressSettings(increments=2))
    assert (pressed.kind, pressed.crossing) == ("penalty", "")
    assert pressed.depth_mm == pytest.approx([0.3])
    assert pressed.unreached.startswith(
        "no equilibrium further on; with penalty contact, from a push of 0.6 mm on, the finger"
    )


@pytest.mark.usefixtures("crossing_by_penalty")
def test_a_press_that_is_asked_for_by_the_penalty_tells_where_parts_meet():
    pressed = press_finger(SMALL, PressSettings(increments=2, contact="penalty"))
    assert pressed.kind == "penalty"
    assert pressed.crossing.startswith("from a push of 0.6 mm on, the finger passes through itself")
    mechanics, _ = press_records(SMALL, pressed)
    assert any("passes through itself" in note and "are not physical" in note for note in mechanics.notes)


class Springs:
    """Springs of 2 N/mm that pull nodes down to a target."""

    def __init__(self, count, nodes):
        self.target_mm, self._chosen = 0.0, np.zeros((count, 3))
        self._chosen[nodes, 1] = 2.0

    def energy(self, u):
        return float((0.5 * self._chosen * (u - self.target_mm) ** 2).sum())

    def gradient(self, u):
        return self._chosen * (u - self.target_mm)

    def hessian(self, u, project):
        return sp.diags_array(self._chosen.ravel()).tocoo()

    def max_step(self, u, du):
        return 1.0


def pressed_together(acts_from_rest, shortest_share=1.0 / 64.0):
    """Two unit blocks 0.3 mm apart whose springs aim at 0.2, 0.4, 0.6 and 0.8 mm; states, contact, what was told."""
    mesh, upper = two_blocks(0.3)
    top = upper[np.isclose(mesh.nodes_mm[upper, 1], 2.3)]
    springs = Springs(len(mesh.nodes_mm), top)
    assembly = Assembly(Elasticity(mesh, {"material": neo_hooke(0.1333, 20.0)}), [springs])
    parts = PartsContact(preset_design("flat-70x35"), mesh, assembly, 1, assembly.at_rest().u_mm)
    if acts_from_rest:
        assembly.terms += (finger_parts_contact(preset_design("flat-70x35"), mesh, 1),)
    supports = Supports.at_rest(len(mesh.nodes_mm), np.flatnonzero(mesh.nodes_mm[:, 1] == 0.0))
    supports.fixed[top] = (True, False, True)

    def at(share):
        springs.target_mm = -0.8 * share
        return supports

    take_up = None if acts_from_rest else lambda state, share: parts.take_up(state, 10.0 * share)
    told = []
    options = NewtonOptions(tell=told.append)
    load = Load(at, take_up=take_up, accept=parts.accept)
    stops = [0.25, 0.5, 0.75, 1.0]
    path = load_increments(assembly, linear_solver("superlu"), load, stops, None, shortest_share, options)
    states = {step.fraction: step.equilibrium.state.u_mm for step in path}
    return mesh, states, parts, [what for what in told if "contact between them acts" in what]


@needs_the_toolkit
def test_parts_that_come_near_keep_apart_from_there_on():
    """The increments before are those of contact that acts from rest, and so are the ones after it is taken up."""
    mesh, states, parts, told = pressed_together(acts_from_rest=False)
    _, from_rest, _, _ = pressed_together(acts_from_rest=True)
    surfaces = OwnSurfaces(mesh)
    assert len(told) == 1
    assert {0.25, 0.5, 0.75, 1.0} <= set(states)
    assert not any(surfaces.crossing(u) for u in states.values())
    # at 0.75 the flat faces have two places to rest, 0.004 mm apart
    for share in (0.25, 0.5, 1.0):
        assert states[share] == pytest.approx(from_rest[share], abs=1e-6)
    assert parts.energy_n_mm(states[0.25]) == 0.0
    assert parts.energy_n_mm(states[1.0]) > 0.0
    assert "within 0.02 mm of each other before a push of 5 mm" in told[0]
    of_penalty = "penalty contact; contact between ribs is not computed"
    assert parts.note(of_penalty, states[1.0], None) == of_penalty
    said = parts.note(of_penalty, states[1.0], 5.0)
    assert said.startswith(
        "penalty contact; barrier contact acts between parts of the finger, which come within 0.02 mm"
    )
    assert re.search(r"from a push of 5 mm on; [1-9]\d* pairs touch at the last increment", said)


@needs_the_toolkit
def test_contact_that_is_taken_up_is_no_failed_increment():
    """The same increment is sought again: taking contact up halves nothing, nor ends a press at its least increment."""
    _, states, _, told = pressed_together(acts_from_rest=False, shortest_share=1.0)
    assert len(told) == 1
    assert list(states) == [0.25, 0.5, 0.75, 1.0]


@needs_the_toolkit
def test_a_press_that_is_continued_takes_up_no_contact_that_it_lacked_where_parts_were_near():
    mesh, states, _, _ = pressed_together(acts_from_rest=False)
    for had in (True, False):
        assembly = Assembly(Elasticity(mesh, {"material": neo_hooke(0.1333, 20.0)}))
        parts = PartsContact(preset_design("flat-70x35"), mesh, assembly, 1, states[0.75], had)
        assert parts.take_up(State(states[1.0], ()), 10.0) == ""
        assert len(assembly.terms) == int(had)
        assert (parts.energy_n_mm(states[1.0]) > 0.0) == had


@needs_the_toolkit
def test_a_press_that_lacks_contact_where_parts_were_near_says_so():
    """A record of a version before 7 does not tell whether it had that contact: it must not be left out in silence."""
    mesh, states, _, _ = pressed_together(acts_from_rest=False)
    for at, near in ((0.25, False), (0.75, True)):
        assembly = Assembly(Elasticity(mesh, {"material": neo_hooke(0.1333, 20.0)}))
        parts = PartsContact(preset_design("flat-70x35"), mesh, assembly, 1, states[at])
        parts.check_start(7.5)
        parts.take_up(State(states[at], ()), 7.5)
        note = parts.note(f"penalty contact{NOT_OF_RIBS}", states[at], None)
        assert ("were within 0.02 mm of each other already" in note) is near
        assert ("before version 7" in note) is near


@needs_the_toolkit
def test_contact_that_would_have_acted_before_is_not_taken_up(monkeypatch):
    monkeypatch.setattr("sim.mechanics._parts_contact._SHALLOW_MM", 6.0)
    _, states, parts, told = pressed_together(acts_from_rest=False)
    assert told == []
    assert parts.energy_n_mm(states[1.0]) == 0.0
    assert parts.surfaces.crossing(states[1.0])


def folding(depth_mm):
    """A finger whose slanting ribs come near the fins at 3 mm."""
    ribs = _BABY.skeleton.model_copy(update={"rib_angle_deg": -20.0, "rib_thickness_mm": 0.8})
    indenter = SMALL.indenter.model_copy(update={"depth_mm": depth_mm})
    return _BABY.model_copy(update={"skeleton": ribs, "indenter": indenter})


WIDE = MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0)


@needs_the_toolkit
def test_a_press_whose_parts_touch_is_continued_with_their_contact_only(monkeypatch):
    monkeypatch.setitem(STEPS, "coarse", WIDE)
    stored = {}

    def store(pressed):
        stored[len(pressed.depth_mm)] = increment_record(folding(4.0), pressed)

    whole = press_finger(folding(4.0), PressSettings(increments=4), store=store)
    assert whole.parts_touch_from_mm == pytest.approx(3.0)
    assert [stored[k].parts_touch_from_mm for k in (1, 2, 3, 4)] == [None, None, *2 * [pytest.approx(3.0)]]
    resume = stored_press(stored[3], folding(4.0))
    again = press_finger(folding(4.0), PressSettings(increments=4), resume=resume)
    assert again.force_n == pytest.approx(whole.force_n, abs=1e-5 * whole.force_n[-1, 1])
    assert again.contact == whole.contact
    assert "of each other from a push of 3 mm on" in whole.contact
    with pytest.raises(
        SimulateError, match="from a push of 3 mm on, but --contact penalty leaves this contact out; continue"
    ):
        press_finger(folding(4.0), PressSettings(increments=4, contact="penalty"), resume=resume)


@needs_the_toolkit
def test_a_press_that_ends_before_an_increment_with_contact_states_none(monkeypatch):
    monkeypatch.setitem(STEPS, "coarse", WIDE)

    def ends(done, total, what):
        if "contact between them acts from here on" in what:
            raise NoEquilibriumError("no time is left")

    pressed = press_finger(folding(3.0), PressSettings(increments=2), progress=ends)
    assert (pressed.unreached, pressed.parts_touch_from_mm) == ("no time is left", None)
    assert pressed.contact.endswith("; contact between ribs is not computed")


@pytest.mark.usefixtures("crossing_by_penalty")
def test_a_press_is_not_continued_from_parts_that_cross():
    deeper = SMALL.model_copy(update={"indenter": SMALL.indenter.model_copy(update={"depth_mm": 0.9})})
    crossing = press_finger(SMALL, PressSettings(increments=2, contact="penalty"))
    pressed = press_finger(deeper, PressSettings(increments=3, contact="penalty"), resume=crossing)
    assert pressed.crossing.startswith("from a push of 0.6 mm or less on, the finger passes through itself")
    if contact_library_failure() is None:
        with pytest.raises(
            SimulateError, match=r"a push of 0\.6 mm\), the finger passes through itself.* --contact penalty"
        ):
            press_finger(deeper, PressSettings(increments=3), resume=crossing)
