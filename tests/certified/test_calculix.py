"""CalculiX, a program of others, against the engine in process; and how it is run."""

import os
import re
import subprocess

import numpy as np
import pytest

from data_schemas import FingerDesign, MissingExtraError, NeoHookeSolid, PressMechanics, SimulateError
from data_schemas._design_parts import MechanicalMaterials
from data_schemas.storage import read_record
from sim import design_toml, preset_design
from sim.mechanics import Block, Cylinder, FingerMesh, PenaltyContact, Pose
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._increments import Load, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from sim.mechanics.other_engines import calculix_notes, calculix_version, press_finger_calculix
from sim.mechanics.other_engines._calculix import press_mesh_calculix
from sim.mechanics.other_engines._deck import Push, deck_lines, indenter_surface
from tests.capture.drivers.programs import require
from tests.certified.blocks import unit_cells
from tests.command_line.running import finray, succeed

GEL = neo_hooke(0.1333)
STIFFNESS = 26.66  # MPa/mm: 100 shear moduli per mm of element
DEPTH_MM, RADIUS_MM, TOP_MM = 0.6, 10.0, 4.0


def gel_on_the_floor():
    cells = unit_cells(4, 4, 12, size=(4.0, TOP_MM, 12.0))
    nodes = cells.nodes_mm - np.array([2.0, 0.0, 6.0])
    block = Block("gel", cells.hexahedra, "gel", "mean_dilatation")
    floor = cells.numbers[:, 0].ravel()
    return FingerMesh(nodes, (block,), {"fixed": floor}, {"coat": cells.top_quads()}, ())


def pressed_in_process(mesh):
    body = Cylinder(RADIUS_MM)
    contact = PenaltyContact(
        mesh.nodes_mm, mesh.surfaces["coat"], body, Pose((0.0, TOP_MM + RADIUS_MM, 0.0)), STIFFNESS, curvature=False
    )
    assembly = Assembly(Elasticity(mesh, {"gel": GEL}), [contact])
    supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])

    def loading(fraction):
        contact.place(Pose((0.0, TOP_MM + RADIUS_MM - fraction * DEPTH_MM, 0.0)))
        return supports

    forces, states = [], []
    for step in load_increments(assembly, linear_solver(), Load(loading), (0.5, 1.0)):
        states.append(step.equilibrium.state.u_mm)
        forces.append(contact.force_n(states[-1]))
    return np.array(forces), np.array(states)


@pytest.mark.rigs
def test_two_engines_press_a_block_alike():
    require("ccx", "calculix-ccx")
    mesh = gel_on_the_floor()
    pose = Pose((0.0, TOP_MM + RADIUS_MM, 0.0))
    push = Push(indenter_surface(Cylinder(RADIUS_MM), pose, 8.0), DEPTH_MM, 2, STIFFNESS)
    told = []
    theirs = press_mesh_calculix(mesh, deck_lines(mesh, {"gel": GEL}, push, "calculix", ()), DEPTH_MM, tell=told.append)
    force, moved = pressed_in_process(mesh)
    assert theirs.unreached == ""
    np.testing.assert_allclose(theirs.depth_mm, [0.5 * DEPTH_MM, DEPTH_MM], rtol=1e-5)
    # one point in C3D8R against eight with mean dilatation, facets, and other contact points: the bar of the issue
    np.testing.assert_allclose(theirs.force_n[:, 1], force[:, 1], rtol=0.03)
    difference = np.linalg.norm(theirs.displacement_mm[-1] - moved[-1], axis=1)
    assert np.sqrt((difference**2).mean()) <= 0.02 * np.linalg.norm(moved[-1], axis=1).max()
    # half of the work of a force that rises a little faster than the push
    assert 0.3 * force[-1, 1] * DEPTH_MM <= theirs.energy_n_mm[-1] <= 0.5 * force[-1, 1] * DEPTH_MM
    assert (theirs.iterations >= 2).all()
    touched = theirs.touch_mm[theirs.pressure_mpa > 0.0]
    assert np.abs(touched[:, 2]).max() <= 4.0
    assert theirs.pressure_mpa.max() == pytest.approx(theirs.pressure_mpa[np.abs(theirs.touch_mm[..., 2]) < 1.0].max())


NEO_HOOKE_TWICE = {"NEO HOOKE": "3.959, 0.01263", "OGDEN, N=1": "7.918, 2., 0.01263"}


@pytest.mark.rigs
def test_why_ogden_is_replaced_for_calculix(tmp_path):
    """One energy in two forms, in a cube strained by 8e-6: the roots of Ogden's cubic drown in rounding."""
    program = require("ccx", "calculix-ccx")
    cells = unit_cells(3, 3, 3)
    inner = cells.numbers[1:-1, 1:-1, 1:-1].ravel()
    nodes = cells.nodes_mm.copy()
    nodes[inner] += np.random.default_rng(0).uniform(-0.06, 0.06, (len(inner), 3))
    strain = 8e-6 * np.array([[1.0, 0.2, 0.1], [0.2, -0.45, 0.3], [0.1, 0.3, -0.55]])
    outer = np.setdiff1d(np.arange(len(nodes)), inner)
    finished = {}
    for name, constants in NEO_HOOKE_TWICE.items():
        lines = ["*NODE, NSET=ALL", *(f"{n + 1}, {x:.15g}, {y:.15g}, {z:.15g}" for n, (x, y, z) in enumerate(nodes))]
        lines += ["*ELEMENT, TYPE=C3D8, ELSET=CUBE"]
        lines += [", ".join(map(str, (n, *(corners + 1)))) for n, corners in enumerate(cells.hexahedra, 1)]
        lines += ["*MATERIAL, NAME=RUBBER", f"*HYPERELASTIC, {name}", constants]
        lines += ["*SOLID SECTION, ELSET=CUBE, MATERIAL=RUBBER", "*STEP, NLGEOM", "*STATIC", "1., 1.", "*BOUNDARY"]
        lines += [f"{n + 1}, {k + 1}, {k + 1}, {u:.12g}" for n in outer for k, u in enumerate(nodes[n] @ strain.T)]
        (tmp_path / "cube.inp").write_text("\n".join([*lines, "*END STEP", ""]))
        limits = {**os.environ, "OMP_NUM_THREADS": "1"}
        asked = [program, "-i", "cube"]
        log = subprocess.run(asked, cwd=tmp_path, env=limits, capture_output=True, text=True, timeout=600, check=False)
        finished[name] = "Job finished" in log.stdout
    assert finished == {"NEO HOOKE": True, "OGDEN, N=1": False}


@pytest.mark.rigs
def test_the_version_is_told():
    require("ccx", "calculix-ccx")
    assert re.fullmatch(r"\d+\.\d+", calculix_version())


def test_notes_tell_the_stand_in():
    assert any("polynomial of the invariants" in note for note in calculix_notes(FingerDesign()))
    neo_hookean = MechanicalMaterials(gel=NeoHookeSolid(c10_mpa=0.2))
    plain = {**neo_hookean.skeleton.model_dump(), "mu_mpa": (7.9,), "alpha": (2.0,)}
    skeleton = type(neo_hookean.skeleton)(**plain)
    design = FingerDesign(mechanics=neo_hookean.model_copy(update={"skeleton": skeleton}))
    assert not any("polynomial" in note for note in calculix_notes(design))


def test_friction_is_told_as_unverified():
    indenter = FingerDesign().indenter.model_copy(update={"friction": 0.3})
    notes = calculix_notes(FingerDesign().model_copy(update={"indenter": indenter}))
    assert any(note.startswith("friction 0.3, with a stick slope of a tenth of the contact") for note in notes)


def test_a_missing_program_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingExtraError, match="apt-get install calculix-ccx"):
        press_finger_calculix(FingerDesign())


@pytest.mark.rigs
def test_the_verb_presses_with_calculix(tmp_path, monkeypatch):
    require("ccx", "calculix-ccx")
    small = preset_design("baby-48x18")
    shallow = small.model_copy(update={"indenter": small.indenter.model_copy(update={"depth_mm": 0.5})})
    (tmp_path / "x.toml").write_text(design_toml(shallow))
    monkeypatch.chdir(tmp_path)
    said = succeed("simulate press x.toml --engine calculix --increments 1 --out x.json")
    assert "x.mechanics.json: CalculiX 2." in said
    mechanics = read_record(tmp_path / "x.mechanics.json", PressMechanics)
    assert mechanics.force_n[-1, 1] > 0.1
    assert mechanics.energy_n_mm[-1] > 0.0
    assert any("polynomial of the invariants" in note for note in mechanics.notes)
    assert (tmp_path / "x.surfaces.json").exists()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ("--engine llvm", "argument --engine: invalid choice: 'llvm' (choose from"),
        ("--engine calculix --resume {file}", "--resume: CalculiX can only press from first touch"),
    ],
)
def test_mistakes_of_the_verb(tmp_path, options, match):
    file = tmp_path / "x.toml"
    file.write_text(design_toml(FingerDesign()))
    said = finray(f"simulate press {file} {options.format(file=file)}")
    assert said.status == 2
    assert match in said.err


def stand_in(folder, monkeypatch, *commands):
    """Put a program in the place of CalculiX."""
    program = folder / "ccx"
    program.write_text("\n".join(["#!/bin/sh", *commands, ""]))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.parametrize(
    ("commands", "match"),
    [
        (["echo ' *ERROR: too many cutbacks'", "exit 201"], "first increment .CalculiX stopped: too many cutbacks."),
        (["exit 3"], "CalculiX stopped: it ended with status 3"),
        (["echo Job finished"], "it gave no reason"),
        (["sleep 60 & wait"], "CalculiX was ended after 0.3 s"),
    ],
)
def test_a_run_without_any_increment_is_an_error(tmp_path, monkeypatch, commands, match):
    stand_in(tmp_path, monkeypatch, *commands)
    mesh = gel_on_the_floor()
    with pytest.raises(SimulateError, match=match):
        press_mesh_calculix(mesh, ["** nothing"], DEPTH_MM, time_limit_s=0.3 if "sleep" in commands[0] else 60.0)


def test_a_run_that_is_ended_keeps_its_increments(tmp_path, monkeypatch):
    mesh = gel_on_the_floor()
    count = len(mesh.nodes_mm)
    rows = "".join(f" -1{n:10d}{0.0:12.5E}{-0.1:12.5E}{0.0:12.5E}\n" for n in range(1, count + 1))
    touch = "".join(
        f" -1{n:10d}" + f"{0.0:12.5E}" * 3 + f"{0.02:12.5E}" + f"{0.0:12.5E}" * 2 + "\n" for n in (1, count)
    )
    frame = f"  100CL  101{0.5:12.5E}           2                     0    1           1\n"
    frd = f"{frame} -4  DISP        4    1\n{rows} -3\n{frame} -4  CONTACT     6    1\n{touch} -3\n"
    # the second frame breaks off
    (tmp_path / "frd").write_text(frd + frame + f" -4  DISP        4    1\n{rows[:200]}")
    totals = " total force (fx,fy,fz) for set INDENTER and time  0.5000000E+00\n\n  0.0 -1.25 0.0\n\n"
    (tmp_path / "dat").write_text(totals + " total internal energy for set GEL and time  0.5000000E+00\n\n  0.3\n")
    (tmp_path / "sta").write_text("     1          1     1     7  0.500000E+00  0.500000E+00  0.500000E+00\n")
    copies = [f"cp {tmp_path / kind} finger.{kind}" for kind in ("frd", "dat", "sta")]
    stand_in(tmp_path, monkeypatch, *copies, "sleep 60 & wait")
    told = []
    kept = press_mesh_calculix(mesh, ["** nothing"], DEPTH_MM, tell=told.append, time_limit_s=1.0)
    assert kept.unreached.startswith("CalculiX was ended after 1 s")
    np.testing.assert_allclose(kept.depth_mm, [0.5 * DEPTH_MM])
    np.testing.assert_allclose(kept.force_n, [[0.0, 1.25, 0.0]])
    assert (kept.iterations.tolist(), kept.energy_n_mm.tolist()) == ([7], [0.3])
    assert kept.displacement_mm.shape == (1, count, 3)
    assert kept.pressure_mpa.max() > 0.0
    assert told[-1] == 0.5
