"""What packages outside bring to mechanics and comparisons: built from the page, with our own as oracles."""

import re
import tomllib
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from data_schemas import (
    CompareError,
    FingerDesign,
    GelPad,
    Indenter,
    NeoHookeSolid,
    PhotometricErrorReport,
    PressMechanics,
    SimulateError,
    check_pad_shape,
    finger_identity,
    provenance,
)
from data_schemas.storage import read_record, write_record
from finray_calib.compare import check_metric
from finray_calib.exchange import read_force_csv
from finray_calib.force import compare_force
from sim import design_toml, read_design
from sim.mechanics import (
    STEPS,
    LinearElastic,
    Sphere,
    check_indenter_shape,
    check_material_law,
    chord_shortfall_rel,
    pad_mesh,
    rigid_indenter,
)
from sim.mechanics._assembly import Elasticity
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._materials import material_of, neo_hooke
from sim.surface_meshes import rest_shape
from tests.capture.drivers.driver_packages import install, site
from tests.certified.blocks import unit_cells
from tests.command_line.records import capture_of, press, with_known_camera
from tests.command_line.running import finray, succeed

__all__ = ["site"]
PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "extend-finray.md").read_text("utf-8")
MODULES = dict(re.findall(r"^`(\w+)\.py`: .*?^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL))
PROJECT, DESIGN = (tomllib.loads(text) for text in re.findall(r"^```toml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL))
SMALL = """
preset = "flat-70x35"
name = "small"
[pad]
length_mm = 48.0
width_mm = 18.0
film = {}
"""
OURS = """shape = "cylindrical"
radius_mm = 40.0
[indenter]
shape = "ball"
radius_mm = 6.0
position_mm = 24.0
depth_mm = 0.4
"""
THEIRS = """shape = "barrel"
parameters = { radius_mm = 40.0 }
[indenter]
shape = "capsule"
parameters = { radius_mm = 6.0 }
position_mm = 24.0
depth_mm = 0.4
[mechanics.gel]
law = "yeoh"
parameters = { c1_mpa = 0.1333 }
"""


@pytest.fixture
def parts(site: Path) -> Path:
    """Install the package of the page."""
    install(site, PROJECT["project"]["name"], PROJECT["project"]["entry-points"], **MODULES)
    return site


def page_module(name: str) -> Any:
    """Return a module of the page, which is not installed."""
    module = ModuleType(name)
    exec(MODULES[name], module.__dict__)
    return module


def changed(name: str, old: str, new: str) -> Any:
    """Return a module of the page with one text replaced."""
    assert MODULES[name].count(old) == 1
    module = ModuleType(name)
    exec(MODULES[name].replace(old, new), module.__dict__)
    return module


def test_contracts_of_the_page_hold():
    *_, text = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    with pytest.MonkeyPatch.context() as patch:
        for name in MODULES:
            patch.setitem(__import__("sys").modules, name, page_module(name))
        space: dict[str, Any] = {}
        exec(text, space)
        space["test_contracts"]()
    assert len(MODULES) == 4


def test_press_with_all_three_is_the_press_with_ours(parts, tmp_path, monkeypatch):
    """Through the command line: the ball, the neo-Hookean gel and the cylindrical pad, written as plug-ins."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    stored = {}
    for name, text in (("ours", OURS), ("theirs", THEIRS)):
        (tmp_path / f"{name}.toml").write_text(SMALL + text)
        outcome = finray(f"simulate press {tmp_path}/{name}.toml --increments 1 --out {tmp_path}/{name}.press.json")
        assert outcome.status == 0, outcome.err
        stored[name] = read_record(tmp_path / f"{name}.mechanics.json", PressMechanics)
    ours, theirs = stored["ours"], stored["theirs"]
    assert ours.force_n[-1, 1] > 0.05
    # the same equilibria to the solver's residual of 1e-8
    np.testing.assert_allclose(theirs.force_n, ours.force_n, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(theirs.energy_n_mm, ours.energy_n_mm, rtol=1e-7)
    of = theirs.design
    packages = (of.pad.package, of.indenter.package, of.mechanics.gel.package)
    assert packages == ("my-finger-parts 0.1",) * 3
    assert of.indenter.parameters == {"radius_mm": 6.0}
    assert any("law yeoh of my-finger-parts 0.1 (c1_mpa = 0.1333)" in note for note in theirs.notes)
    unknown = 'the parameters of mechanics.gel.law = "yeoh" of my-finger-parts 0.1, whose uncertainty is not known'
    assert unknown in left_out_of_a_force_comparison(theirs, tmp_path)
    assert finger_identity(of).differs_in(finger_identity(ours.design)) == ("indenter", "mechanics", "pad")


def left_out_of_a_force_comparison(pressed: PressMechanics, tmp_path: Path) -> tuple[str, ...]:
    """Return what the intervals do not know where the press is compared with a force that was measured."""
    push_mm = np.linspace(0.1, 0.4, 6)
    (tmp_path / "force.csv").write_text("displacement_mm,force_n\n" + "".join(f"{d},{0.4 * d}\n" for d in push_mm))
    rows = {name: np.repeat(getattr(pressed, name), 6, axis=0) for name in ("force_n", "energy_n_mm", "iterations")}
    rows["force_n"] = rows["force_n"] * (push_mm / 0.4)[:, None]
    curve = pressed.model_copy(update={**rows, "depth_mm": push_mm})
    return compare_force(curve, read_force_csv(tmp_path / "force.csv"), np.random.default_rng(0)).not_included


@pytest.mark.usefixtures("parts")
def test_pad_of_the_page_has_our_mesh_and_surfaces():
    ours = GelPad(shape="cylindrical", radius_mm=60.0)
    theirs = GelPad(shape="barrel", parameters={"radius_mm": 60.0})
    assert theirs.most_curvature_per_mm() == ours.most_curvature_per_mm()
    meshes = [pad_mesh(FingerDesign(pad=pad), 3.0, 3.0).nodes_mm for pad in (ours, theirs)]
    assert np.array_equal(*meshes)
    shapes = [rest_shape(FingerDesign(pad=pad)) for pad in (ours, theirs)]
    for name, surface in shapes[0].surfaces.items():
        assert np.array_equal(surface.vertices_mm, shapes[1].surfaces[name].vertices_mm)


@pytest.mark.usefixtures("parts")
def test_capsule_without_length_is_the_ball():
    ball = FingerDesign(indenter=Indenter(shape="ball", radius_mm=6.0, depth_mm=0.5))
    capsule = FingerDesign(indenter=Indenter(shape="capsule", parameters={"radius_mm": 6.0}, depth_mm=0.5))
    ours, theirs = rigid_indenter(ball), rigid_indenter(capsule)
    assert theirs.touching.position_mm == pytest.approx(ours.touching.position_mm, abs=1e-8)
    points = np.random.default_rng(0).normal(0.0, 6.0, (50, 3))
    for a, b in zip(Sphere(6.0).distances(points)[:2], theirs.body.distances(points)[:2], strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-14, atol=1e-14)
    # facets with their corners on the body and their middles at most 4 um inside it
    corners = theirs.surface.vertices_mm[theirs.surface.triangles]
    assert np.linalg.norm(theirs.surface.vertices_mm, axis=1) == pytest.approx(6.0, abs=1e-9)
    assert np.linalg.norm(corners.mean(axis=1), axis=1).min() > 6.0 - 0.004
    shortfalls = [chord_shortfall_rel(design, "coarse", 0.5) for design in (ball, capsule)]
    # the radius is that of differences over 0.02 mm
    assert shortfalls[1] == pytest.approx(shortfalls[0], rel=1e-4)


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize("element", ["mean_dilatation", "incompatible_modes"])
def test_elements_of_a_given_law_are_those_of_the_compiled_one(element):
    solid = NeoHookeSolid(law="yeoh", parameters={"c1_mpa": 0.1333})
    given, compiled = material_of(solid), neo_hooke(0.1333)
    assert given.shear_modulus_mpa == pytest.approx(compiled.shear_modulus_mpa, rel=1e-15)
    cells = unit_cells(2, 2, 2)
    mesh = cells.mesh(element)
    u = 0.05 * np.random.default_rng(1).standard_normal(mesh.nodes_mm.shape)
    found = []
    for material in (compiled, given):
        elastic = Elasticity(mesh, {"material": material})
        modes = tuple(0.02 * np.random.default_rng(2).standard_normal(m.shape) for m in elastic.no_modes)
        for removed in (0.0, 0.3, 1.0):
            parts = [(p.force.copy(), p.tangent.copy()) for p in elastic.matrices(u, modes, removed)]
            found.append((elastic.energy(u, modes), *(np.concatenate(some) for some in zip(*parts, strict=True))))
    for ours, theirs in zip(found[:3], found[3:], strict=True):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-10, atol=1e-12)


def test_metric_of_the_page_stands_in_record_terminal_and_page(parts, tmp_path):
    linear = with_known_camera(press())
    origin = provenance("pytest")
    capture = capture_of(linear, 50.0)
    write_record(linear, tmp_path / "press.json", origin)
    write_record(capture, tmp_path / "capture.json", origin)
    told = succeed(f"compare {tmp_path}/press.json {tmp_path}/capture.json --metric mean-error --out {tmp_path}/r.json")
    assert "mean-error of my-finger-parts 0.1 (mean absolute error" in told
    (metric,) = read_record(tmp_path / "r.json", PhotometricErrorReport).packaged_metrics
    assert (metric.package, metric.unit, metric.better, metric.draws) == ("my-finger-parts 0.1", "1", "lower", 40)
    rows = {row.candidate: row.value for row in metric.rows}
    assert rows["simulation"].low95 < rows["simulation"].estimate < rows["simulation"].high95
    assert rows["simulation"].high95 < rows["do nothing"].estimate
    assert rows["do nothing"].low95 == rows["do nothing"].estimate
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "Metrics of other packages" in page
    assert f"{rows['do nothing'].estimate:.4g}" in page


def test_design_keeps_its_package_and_refuses_another_version(parts, tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text(SMALL + THEIRS)
    design = read_design(path)
    text = design_toml(design)
    assert 'package = "my-finger-parts 0.1"' in text
    path.write_text(text)
    assert read_design(path) == design
    path.write_text(text.replace("my-finger-parts 0.1", "my-finger-parts 0.0"))
    elsewhere = read_design(path)
    for use in (
        lambda: elsewhere.pad.drop_mm(0.0, 0.0),
        lambda: elsewhere.indenter.plug_in(),
        lambda: material_of(elsewhere.mechanics.gel),
    ):
        with pytest.raises(SimulateError, match=r"of my-finger-parts 0\.0, but my-finger-parts"):
            use()


@pytest.mark.usefixtures("parts")
def test_page_of_a_finger_shows_them(tmp_path):
    (tmp_path / "finger.toml").write_text(SMALL + THEIRS)
    told = finray(f"design show {tmp_path}/finger.toml --out {tmp_path}/finger.html")
    assert told.status == 0, told.err
    page = (tmp_path / "finger.html").read_text("utf-8")
    assert "capsule" in page


def test_record_is_read_where_the_package_is_not_installed():
    design = FingerDesign(pad=GelPad(shape="barrel", parameters={"radius_mm": 60.0}, package="my-finger-parts 0.1"))
    with pytest.raises(SimulateError, match=r"no installed package provides the .* 'barrel' \(available: flat, "):
        design.pad.drop_mm(0.0, 0.0)


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("table", "told"),
    [
        (
            'shape = "barel"',
            r"finger\.toml: 'pad': no installed package provides the pad shape 'barel' \(available",
        ),
        (
            'shape = "barrel"\nparameters = { radius = 40.0 }',
            r"pad shape 'barrel' of package my-finger-parts 0\.1 takes the parameters radius_mm, along_radius_mm \(by "
            r"default 0\.0\), but the design gives radius",
        ),
        ('shape = "barrel"\nparameters = { radius_mm = 9.0 }', r"fails|leaves no gel|not finite"),
        ('shape = "barrel"\nparameters = { radius_mm = "9" }', r"parameters\.radius_mm.*must be a number"),
        (
            'shape = "flat"\nparameters = { radius_mm = 40.0 }',
            r"pad\.parameters has no effect, because it belongs to",
        ),
        (
            'shape = "flat"\npackage = "my-finger-parts 0.1"',
            r"pad\.package has no effect, because it belongs to parts of other pack",
        ),
    ],
)
def test_mistakes_in_a_design_are_told(tmp_path, table, told):
    path = tmp_path / "finger.toml"
    path.write_text(f"{SMALL}{table}\n")
    outcome = finray(f"simulate press {path} --out {tmp_path}/p.press.json")
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert re.search(told, outcome.err), outcome.err


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("import not_there_at_all\n", r"cannot be imported \(ModuleNotFoundError"),
        ("def energy(stretches): ...\n", r"does not define energy_mpa\(stretches, \.\.\.\) in its module bad_law"),
        ("def energy_mpa(stretches):\n    return 1 / 0\n", r"fails \(ZeroDivisionError: division by zero\)"),
        (
            "def energy_mpa(stretches):\n    return stretches\n",
            r"must return a tuple of energy, gradient",
        ),
        ("def energy_mpa(s):\n    return s[:, 0], s, s\n", r"returns its second derivative of shape \(1, 3\), but"),
        ("def energy_mpa(s):\n    return s[:, 0] / 0.0, s, s[:, :, None] * s[:, None]\n", r"energy with \d+ NaN"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
def test_mistakes_of_an_author_name_the_package(site, source, told):
    install(site, "bad-rubbers", {"finray_calib.materials": {"bad": "bad_law"}}, bad_law=source)
    solid = NeoHookeSolid(law="bad")
    with pytest.raises(SimulateError, match=rf"{told}.*pip install --upgrade bad-rubbers") as refused:
        material_of(solid)
    assert "material 'bad' of package bad-rubbers 0.1" in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("slope = c1_mpa +", "slope = 1.01 * c1_mpa +", "gives a gradient that does not belong to the energy"),
        ("bend = 2.0", "bend = 3.0", "gives a second derivative that does not belong to the gradient"),
        ("energy = excess", "energy = 0.5 + excess", "gives an energy at rest that is not 0 MPa: off by 0.5 MPa"),
        ("- 3.0\n", "- 3.0 + 0.1 * (stretches[:, 0] - 1.0) ** 4\n", "a gradient that does not belong to the energy"),
        ("* np.eye(3)", "* (np.eye(3) + np.eye(3, k=1) * 0.1)", "second derivative that is not symmetric"),
    ],
)
def test_material_that_breaks_its_contract_is_refused(old, new, told):
    with pytest.raises(SimulateError, match=told):
        check_material_law(changed("my_yeoh", old, new), c1_mpa=0.1333, c2_mpa=0.01)


def test_unstable_material_is_refused():
    with pytest.raises(SimulateError, match=r"is unstable \(Drucker\) under uniaxial load at a stretch of"):
        check_material_law(page_module("my_yeoh"), c1_mpa=0.1333, c2_mpa=-0.1)
    with pytest.raises(SimulateError, match=r"initial shear modulus of .* must be positive, got -0\.2666 MPa"):
        check_material_law(page_module("my_yeoh"), c1_mpa=-0.1333)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "way / np.maximum(length",
            "1.01 * way / np.maximum(length",
            "a gradient that does not belong to its dist",
        ),
        (
            "return length - self.radius_mm, way /",
            "return 2 * (length - self.radius_mm), 2 * way /",
            "does not give a distance",
        ),
        (
            "return length - self.radius_mm,",
            "return length + self.radius_mm,",
            "is not a closed body around",
        ),
        ("return length - self.radius_mm,", "return length[:-1],", r"returns distances of shape \(400,\), but"),
        (
            "return Capsule(radius_mm, half_length_mm)",
            "return 7",
            "returns a int as its body, but a body must have distances",
        ),
    ],
)
def test_indenter_that_breaks_its_contract_is_refused(old, new, told):
    with pytest.raises(SimulateError, match=told):
        check_indenter_shape(changed("my_capsule", old, new), radius_mm=6.0)


def test_body_that_a_ray_leaves_twice_is_refused():
    def distances(points):
        far = points - np.array([0.0, 20.0, 0.0])
        near, other = np.linalg.norm(points, axis=1), np.linalg.norm(far, axis=1)
        first = (near - 6.0 <= other - 9.0)[:, None]
        way = np.where(first, points, far)
        return np.minimum(near - 6.0, other - 9.0), way / np.linalg.norm(way, axis=1, keepdims=True)

    two_balls = SimpleNamespace(body=lambda: SimpleNamespace(distances=distances))
    with pytest.raises(
        SimulateError, match=r"is not fully visible from its origin, because \d+ of 400 rays leave the body more"
    ):
        check_indenter_shape(two_balls)


def test_sharp_body_is_pressed_by_exact_distances_only(site, tmp_path):
    source = """
import numpy as np
TURN = np.array([[0.866025403784, 0.0, 0.5], [0.0, 1.0, 0.0], [-0.5, 0.0, 0.866025403784]])
class Cube:
    def distances(self, points):
        p = points @ TURN
        beyond = np.abs(p) - 4.0
        reach = np.maximum(beyond, 0.0)
        length = np.linalg.norm(reach, axis=1)
        out = length > 0.0
        flat = np.eye(3)[beyond.argmax(axis=1)]
        way = np.where(out[:, None], reach / np.where(out, length, 1.0)[:, None], flat)
        return np.where(out, length, beyond.max(axis=1)), (way * np.where(p >= 0.0, 1.0, -1.0)) @ TURN.T
def body():
    return Cube()
"""
    install(site, "sharp", {"finray_calib.indenter_shapes": {"cube": "sharp_cube"}}, sharp_cube=source)
    indenter = rigid_indenter(FingerDesign(indenter=Indenter(shape="cube", depth_mm=0.5)))
    assert 0.02 < indenter.surface_off_mm < 1.0
    with pytest.raises(SimulateError, match=r"has sharp edges, but at most 0\.02 mm is allowed where triangles are"):
        indenter.check_surface()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "return sagitta(radius_mm, x_mm) + along",
            "return sagitta(radius_mm, x_mm - 3.0) + along",
            "its crown in the wrong place",
        ),
        ("return sagitta(radius_mm, x_mm) + along", "return 9.0 * sagitta(radius_mm, x_mm) + along", "leaves no gel"),
        ("return max(r**2", "return 0.5 * max(r**2", "the bound of 0.0[0-9]+ per mm that its most_curvature_per_mm"),
        ("return sagitta(radius_mm, x_mm) + along", "return 0.0", r"drop_mm of shape \(\), but shape \(41, 41\)"),
    ],
)
def test_pad_that_breaks_its_contract_is_refused(old, new, told):
    with pytest.raises(SimulateError, match=told):
        check_pad_shape(changed("my_barrel", old, new), 70.0, 35.0, 6.0, radius_mm=40.0)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            'BETTER = "lower"',
            'BETTER = "higher"',
            "0 for the captured image itself and .* declares that higher is better",
        ),
        ('BETTER = "lower"', 'BETTER = "less"', "has BETTER = 'less', but"),
        ('UNIT = "1"', "UNIT = 1", "has UNIT = 1, but the value must be a non-empty text"),
        ("return float(", "return 0.0 * float(", "is 0 for the captured image itself and 0 .* lower is better"),
        ("(candidate - captured)[region]", "(candidate - captured)", "depends on pixels outside the region"),
        ("return float(", "candidate[0] = 0.0\n    return float(", "changes the images that it is given"),
        ("return float(", "return None and float(", "returns .* as value|value of shape|NaN or infinite"),
    ],
)
def test_metric_that_breaks_its_contract_is_refused(old, new, told):
    with pytest.raises(CompareError, match=told):
        check_metric(changed("my_mean_error", old, new))


def test_metric_that_nobody_brings_is_refused(parts, tmp_path):
    origin = provenance("pytest")
    linear = with_known_camera(press())
    write_record(linear, tmp_path / "press.json", origin)
    write_record(capture_of(linear, 50.0), tmp_path / "capture.json", origin)
    outcome = finray(
        f"compare {tmp_path}/press.json {tmp_path}/capture.json --metric men-error --out {tmp_path}/r.json"
    )
    assert outcome.status == 2
    assert (
        "no installed package provides the metric 'men-error' (available: metric 'mean-error' of package" in outcome.err
    )


def test_deck_refuses_what_it_cannot_hold(parts, tmp_path):
    for table, told in (
        (
            '[mechanics.gel]\nlaw = "yeoh"\nparameters = { c1_mpa = 0.1333 }',
            "is a law of another package, which an input deck of CalculiX or Abaqus cannot contain",
        ),
        (
            '[indenter]\nshape = "capsule"\nparameters = { radius_mm = 6.0 }',
            r'indenter.shape = "capsule" is not supported, because an input deck of CalculiX or Abaqus can contain',
        ),
    ):
        (tmp_path / "finger.toml").write_text(f"{SMALL}{table}\n")
        outcome = finray(f"export deck {tmp_path}/finger.toml --dialect abaqus --out {tmp_path}/deck.inp")
        assert outcome.status == 2
        assert told in outcome.err, outcome.err


def test_stiff_parts_keep_their_element():
    """A law of another package may use both elements; a linear elastic material still needs incompatible modes."""
    with pytest.raises(SimulateError, match="asks for mean dilatation, which is only for"):
        Elasticity(unit_cells(1, 1, 1).mesh("mean_dilatation"), {"material": LinearElastic(1500.0, 0.38)})
