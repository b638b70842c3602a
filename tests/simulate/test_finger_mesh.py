"""The parametric finger as a mesh: shapes against closed forms, parts that conform, and what is refused."""

import functools
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.random_presses import random_design
from data_schemas import (
    Backing,
    ElasticSolid,
    FieldError,
    Film,
    FingerDesign,
    GelPad,
    LightPanel,
    NeoHookeSolid,
    OgdenSolid,
    SimulateError,
    Skeleton,
)
from data_schemas._design_parts import MeshPreset, Mirror
from sim import PRESETS, preset_design
from sim.mechanics import (
    STEPS,
    Block,
    FingerMesh,
    back_curve_mm,
    finger_mesh,
    mould_stl,
    pad_mesh,
    part_stl,
    skeleton_layout,
    skeleton_mesh,
)
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._mesh import Tie
from sim.mechanics._skeleton import BOND_MM, rib_wedge, skeleton_side_view
from sim.surface_meshes import boundary_quads, corner_jacobians_mm3, layout_scale, mirror_shape, split_quads, stl_bytes
from tests.simulate.surface_quality import hexahedra_volume_mm3, surface_quality

DESIGN = FingerDesign()
CYLINDER = GelPad(shape="cylindrical", radius_mm=60.0, film=Film())
# differences of coordinates of up to 100 mm in double precision
ROUNDING_MM = 1e-10


@functools.cache
def meshed(name="flat-70x35", preset="coarse"):
    return finger_mesh(preset_design(name), preset)


def with_skeleton(design=DESIGN, **fields):
    return design.model_copy(update={"skeleton": Skeleton(**{"backing": Backing(), **fields})})


@pytest.mark.parametrize(
    "pad", [GelPad(), CYLINDER, GelPad(shape="ellipsoidal", semi_axes_mm=(40.0, 15.0, 60.0))], ids=lambda pad: pad.shape
)
def test_no_line_over_the_pad_is_curved_more_than_its_bound(pad):
    """Second differences of the height, in twelve directions, right up to the corners."""
    step_mm = 0.01
    x_mm, z_mm = np.meshgrid(
        np.linspace(-1.0, 1.0, 41) * (pad.width_mm / 2.0 - step_mm),
        np.linspace(-1.0, 1.0, 41) * (pad.length_mm / 2.0 - step_mm),
    )
    steepest_per_mm = 0.0
    for turned in np.linspace(0.0, np.pi, 12, endpoint=False):
        dx_mm, dz_mm = step_mm * np.cos(turned), step_mm * np.sin(turned)
        around = [pad.drop_mm(x_mm + k * dx_mm, z_mm + k * dz_mm) for k in (-1, 0, 1)]
        steepest_per_mm = max(steepest_per_mm, float((around[0] - 2.0 * around[1] + around[2]).max()) / step_mm**2)
    bound_per_mm = pad.most_curvature_per_mm()
    # rounding of heights of up to 30 mm, twice over the step squared
    assert steepest_per_mm <= bound_per_mm + 1e-9 / step_mm**2
    # a bound that is far off would divide triangles in vain
    assert bound_per_mm <= 2.0 * steepest_per_mm or pad.shape == "flat"


def conforming(mesh):
    """Return all hexahedra that share nodes with the skeleton."""
    return np.concatenate([h for name, h in mesh.hexahedra.items() if name not in ("gel", "film", "bond")])


def quality(mesh, hexahedra):
    return surface_quality(split_quads(boundary_quads(hexahedra).quads, mesh.nodes_mm), mesh.nodes_mm, hexahedra)


@pytest.mark.parametrize("name", PRESETS)
def test_every_finger_is_meshed_coarsely_without_folds(name):
    design = preset_design(name)
    mesh = meshed(name)
    for block in mesh.blocks:
        assert corner_jacobians_mm3(mesh.nodes_mm, block.hexahedra).min() > 0.0
    assert 3 * len(mesh.nodes_mm) < 60_000
    expected = {"gel", "film" if design.pad.film else "bond", "skeleton", "base_plate", "mirror"}
    assert set(mesh.hexahedra) == expected | ({"backing"} if design.skeleton.backing else set())
    for hexahedra in (mesh.hexahedra["gel"], conforming(mesh)):
        found = quality(mesh, hexahedra)
        assert found.is_closed
        assert found.degenerate == 0
        # quads of 2 mm on an ellipsoid are warped by some um, which makes triangles and trilinear hexahedra differ
        assert found.volume_mm3 == pytest.approx(found.hexahedra_volume_mm3, rel=1e-4)


@pytest.mark.parametrize(("preset", "most"), [("medium", 150_000), ("fine", 700_000)])
def test_finer_presets_keep_to_their_steps(preset, most):
    mesh, steps = meshed(preset=preset), STEPS[preset]
    assert 3 * len(mesh.nodes_mm) < most
    coat = mesh.nodes_mm[mesh.surfaces["coat"]]
    assert np.linalg.norm(coat - np.roll(coat, 1, axis=1), axis=2).max() < 1.01 * steps.pad_mm
    front = mesh.nodes_mm[mesh.surfaces["front"]]
    front = front[front[:, :, 2].min(axis=1) > skeleton_layout(DESIGN).base_line[0] - ROUNDING_MM]
    edges = np.abs(front - np.roll(front, 1, axis=1))
    assert edges[:, :, 2].max() < 1.01 * steps.skeleton_mm
    assert edges[:, :, 0].max() < 1.01 * steps.across_mm


def test_the_preset_comes_from_the_design_or_the_caller():
    medium = DESIGN.model_copy(update={"mesh": MeshPreset(preset="medium")})
    assert len(finger_mesh(medium).nodes_mm) == len(meshed(preset="medium").nodes_mm)
    coarser = finger_mesh(DESIGN, steps=MeshSteps(4.0, 3.0, 5.0, 5.0))
    assert len(coarser.nodes_mm) < len(finger_mesh(DESIGN).nodes_mm) == len(meshed().nodes_mm)


@pytest.mark.parametrize("pad", [GelPad(film=Film()), CYLINDER, GelPad(shape="ellipsoidal", semi_axes_mm=(30, 8, 90))])
def test_the_coat_lies_on_the_designed_shape(pad):
    mesh = finger_mesh(FingerDesign(pad=pad), "coarse")
    x, y, z = mesh.nodes_mm[mesh.node_sets["coat"]].T
    np.testing.assert_allclose(y, pad.thickness_mm - pad.drop_mm(x, z - 35.0), atol=ROUNDING_MM)
    assert np.abs(x).max() == 17.5
    assert (z.min(), z.max()) == (0.0, 70.0)


def test_the_volume_of_a_cylindrical_pad_converges_to_the_closed_form():
    half, radius = 17.5, 60.0
    segment = half * np.sqrt(radius**2 - half**2) + radius**2 * np.arcsin(half / radius)
    exact = 70.0 * (2.0 * half * (6.0 - radius) + segment)

    def error(step_mm):
        mesh = pad_mesh(FingerDesign(pad=CYLINDER), step_mm, 2.0)
        return hexahedra_volume_mm3(mesh.nodes_mm, mesh.hexahedra["gel"]).sum() - exact

    # chords: of second order in the step
    assert error(1.75) / error(0.875) == pytest.approx(4.0, rel=0.02)
    # a chord lies h^2 / 12 R under its arc on average, somewhat more where the arc is steep
    assert error(0.875) == pytest.approx(-(0.875**2) / 12.0 / radius * 35.0 * 70.0, rel=0.06)


def test_film_and_mirror_are_one_layer_of_their_thickness():
    mesh = meshed()
    for name, thickness in (("film", 0.1), ("mirror", 0.15)):
        points = mesh.nodes_mm[mesh.hexahedra[name]]
        quads = boundary_quads(mesh.hexahedra[name]).quads
        # each hexahedron of a single layer shows both its faces
        assert len(quads) >= 2 * len(points)
        shortest = np.linalg.norm(points - points[:, [3, 0, 1, 2, 7, 4, 5, 6]], axis=2).min(axis=1)
        across = np.linalg.norm(points[:, :4] - points[:, 4:], axis=2).min(axis=1)
        np.testing.assert_allclose(np.minimum(shortest, across), thickness, rtol=1e-6)
    without = meshed("ellipsoidal-30-8-90")
    assert next(b.material for b in without.blocks if b.name == "bond") == "gel"
    assert without.nodes_mm[without.node_sets["flange"], 1].max() == -BOND_MM


@pytest.mark.parametrize("name", PRESETS)
def test_the_mirror_of_the_mesh_is_the_sheet_that_light_meets(name):
    design = preset_design(name)
    mirror, mesh = mirror_shape(design), meshed(name)
    points = mesh.nodes_mm[np.unique(mesh.surfaces["mirror"])]
    along = (points[:, 1:] - mirror.apex_yz_mm) @ mirror.tangent_yz
    height = (points[:, 1:] - mirror.apex_yz_mm) @ mirror.normal_yz
    np.testing.assert_allclose(height, -(along**2) / (2.0 * mirror.radius_mm), atol=ROUNDING_MM)
    assert np.abs(points[:, 0]).max() == mirror.half_width_mm
    # a grid line within 0.1 mm takes the place of the mirror's end
    assert along.min() == pytest.approx(-mirror.half_length_mm, abs=0.1)
    if design.skeleton.tip_starts_mm is None:
        assert along.max() == pytest.approx(mirror.half_length_mm, abs=0.1)


@pytest.mark.parametrize("ribs", [0, 1, 5])
def test_handles_of_the_skeleton_count_its_ribs(ribs):
    mesh = skeleton_mesh(with_skeleton(rib_count=ribs), 3.0)
    # openings: the window, and the room between neighbouring ribs, base and tip on both sides; one less than openings
    # are handles
    assert quality(mesh, conforming(mesh)).euler_number == 2 - 2 * (2 * (ribs + 1))


@pytest.mark.parametrize("angle_deg", [-20.0, 0.0, 30.0])
def test_ribs_have_their_thickness_angle_and_spacing(angle_deg):
    design = with_skeleton(rib_angle_deg=angle_deg, rib_count=4, rib_spacing_mm=12.0, rib_thickness_mm=1.4)
    layout = skeleton_layout(design)
    front = np.stack([np.full((4, 2), layout.front_inner_mm), layout.ribs[..., 0]], axis=-1)
    back = back_curve_mm(layout.mirror, layout.ribs[..., 1], design.skeleton.mirror_thickness_mm)
    direction = (back - front) / np.linalg.norm(back - front, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.degrees(np.arctan2(direction[..., 1], -direction[..., 0])), angle_deg, atol=1e-6)
    apart = front[:, 1] - front[:, 0]
    np.testing.assert_allclose(np.abs(apart[:, 0] * direction[:, 0, 1] - apart[:, 1] * direction[:, 0, 0]), 1.4)
    np.testing.assert_allclose(np.diff(layout.ribs[:, 0, 0]), 12.0)
    mesh = skeleton_mesh(design, 2.5)
    for height, along in layout.ribs.reshape(-1, 2):
        on_front = (mesh.nodes_mm[:, 1] == layout.front_inner_mm) & (np.abs(mesh.nodes_mm[:, 2] - height) < ROUNDING_MM)
        on_back = np.abs(mesh.nodes_mm[:, 1:] - back_curve_mm(layout.mirror, along, 0.15)).max(axis=1) < ROUNDING_MM
        assert on_front.any()
        assert on_back.any()


def wedge(design, preset="coarse"):
    """The worst element of the ribs, from the corners of each quadrilateral of the side view."""
    layout, steps = skeleton_layout(design), STEPS[preset]
    view = skeleton_side_view(design, layout, steps.skeleton_mm, steps.corners)
    _, _, between, front, _ = view.ends
    return rib_wedge(view.points_mm[between : front + 1], view.kinds)


def test_a_wedge_is_its_length_over_its_thickness_times_the_slope_of_its_ends():
    # two layers through a rib of 0.5 mm, elements 1.25 and 0.5 mm long, whose ends slope by 10 and 20 deg
    low = np.array([[0.0, 0.0], [1.25, 0.0], [1.75, 0.0]])
    high = low + 0.5 * np.column_stack([np.tan(np.radians([-10.0, 10.0, -30.0])), np.ones(3)])
    points = np.stack([low, (low + high) / 2.0, high], axis=1)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    first_mm, second_mm = np.linalg.norm(np.diff((low + high) / 2.0, axis=0), axis=1)
    first, second = first_mm / 0.5 * np.tan(np.radians(10.0)), second_mm / 0.5 * np.tan(np.radians(20.0))
    assert rib_wedge(points[:2] @ turn.T, ("rib", "rib")) == pytest.approx(first)
    assert rib_wedge(points @ turn.T, ("rib", "rib")) == pytest.approx(max(first, second))
    assert rib_wedge(points, ("gap", "gap")) == 0.0


@pytest.mark.parametrize("preset", STEPS)
@pytest.mark.parametrize("name", PRESETS)
def test_no_rib_of_a_ready_made_finger_is_made_of_wedges(name, preset):
    assert wedge(preset_design(name), preset) <= 0.12


def test_no_rib_of_a_random_finger_is_made_of_wedges(tmp_path):
    fingers = 0
    for seed in range(100):
        try:
            found = wedge(random_design(seed, tmp_path))
        except SimulateError:  # parts that do not fit together
            continue
        assert found <= 0.12, seed
        fingers += 1
    assert fingers > 90


def test_steep_ribs_take_more_elements():
    steep = with_skeleton(rib_count=5, rib_thickness_mm=0.65, rib_angle_deg=-24.5, backing=None)
    assert wedge(steep) <= 0.12


def test_ribs_stand_beside_the_mirror_and_the_window_is_the_pad():
    mesh, layout = meshed(), skeleton_layout(DESIGN)
    middles = mesh.nodes_mm[mesh.hexahedra["skeleton"]].mean(axis=1)
    hollow = (middles[:, 2] > 0.0) & (middles[:, 2] < 70.0) & (np.abs(middles[:, 0]) < layout.mirror.half_width_mm)
    between = (middles[:, 1] < layout.front_inner_mm) & (
        (middles[:, 1:] - layout.mirror.apex_yz_mm) @ layout.mirror.normal_yz > 0.0
    )
    assert not (hollow & between).any()
    in_front = middles[:, 1] > layout.front_inner_mm
    window = (np.abs(middles[:, 0]) < 17.5) & (middles[:, 2] > 0.0) & (middles[:, 2] < 70.0)
    assert in_front.sum() > 100
    assert not (in_front & window).any()


def test_all_parts_but_the_pad_share_their_nodes():
    mesh = meshed()
    names = ("skeleton", "base_plate", "backing", "mirror")
    nodes = np.unique(conforming(mesh))
    assert len(np.unique(np.round(mesh.nodes_mm[nodes], 6), axis=0)) == len(nodes)
    for other in names[1:]:
        shared = np.intersect1d(mesh.hexahedra["skeleton"], mesh.hexahedra[other])
        assert len(shared) > 50
    np.testing.assert_array_equal(
        np.unique(np.concatenate(list(mesh.hexahedra.values()))), np.arange(len(mesh.nodes_mm))
    )
    backing = mesh.nodes_mm[np.unique(mesh.hexahedra["backing"])]
    assert backing[:, 2].max() == pytest.approx(60.0, abs=1.0)
    assert len(np.intersect1d(mesh.hexahedra["base_plate"], mesh.hexahedra["backing"])) > 10


@pytest.mark.parametrize("preset", ["coarse", "medium"])
def test_the_flange_lies_on_the_quads_it_is_tied_to(preset):
    mesh = meshed(preset=preset)
    (tie,) = mesh.ties
    slaves, quads = mesh.nodes_mm[tie.slave_nodes], mesh.nodes_mm[tie.master_quads]
    np.testing.assert_allclose(slaves[:, 1], quads[0, 0, 1], atol=ROUNDING_MM)
    low, high = quads.min(axis=1) - ROUNDING_MM, quads.max(axis=1) + ROUNDING_MM
    for axis in (0, 2):
        assert slaves[:, axis].min() >= low[:, axis].min()
    inside = ((slaves[:, None] >= low) & (slaves[:, None] <= high)).all(axis=2)
    assert inside.any(axis=1).all()
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 2] - quads[:, 0])
    assert (normal[:, 1] > 0.0).all()
    # the flange goes all round: it is as long as the pad's rim on both its lines
    assert len(tie.slave_nodes) == len(mesh.node_sets["flange"])
    assert {tuple(np.sign(s)) for s in np.round(slaves[:, [0, 2]] - [0.0, 35.0], 6)} >= {
        (-1, -1),
        (-1, 1),
        (1, -1),
        (1, 1),
    }


def test_named_surfaces_of_the_pad_are_its_boundary():
    mesh = meshed()
    faces = np.concatenate([mesh.surfaces[name] for name in ("coat", "inner", "red", "green", "base", "tip")])
    boundary = boundary_quads(mesh.hexahedra["gel"]).quads

    def as_set(quads):
        return {tuple(np.roll(quad, -int(np.argmin(quad)))) for quad in quads.tolist()}

    assert as_set(faces) == as_set(boundary)  # with the same direction
    fixed = mesh.nodes_mm[mesh.node_sets["fixed"]]
    assert np.ptp(fixed[:, 2]) == 0.0
    assert fixed[0, 2] == mesh.nodes_mm[:, 2].min()
    assert (mesh.nodes_mm[mesh.node_sets["tip_end"], 2] == mesh.nodes_mm[:, 2].max()).all()


def test_the_base_plate_lies_under_camera_and_lights():
    wide = preset_design("wide-50x60")
    assert skeleton_layout(wide).base_line[0] <= -2.0 * layout_scale(wide) - 1.0
    low = DESIGN.model_copy(update={"light": LightPanel(position_mm=(0.0, -10.0, -8.0))})
    assert skeleton_layout(low).base_line[0] == -10.5
    mesh = finger_mesh(low, "coarse")
    assert mesh.nodes_mm[mesh.node_sets["fixed"], 2].max() == pytest.approx(-16.5)


@pytest.mark.parametrize(
    "design",
    [
        DESIGN.model_copy(update={"mirror": Mirror(radius_mm=100.0)}),
        DESIGN.model_copy(update={"mirror": Mirror(radius_mm=1e6)}),
        with_skeleton(rib_angle_deg=60.0, rib_spacing_mm=11.0),
        with_skeleton(rib_angle_deg=-20.0, rib_count=5),
        with_skeleton(tip_starts_mm=90.0),
        with_skeleton(rib_count=20),
        with_skeleton(width_mm=60.0, flange_mm=3.0),
        with_skeleton(backing=Backing(from_z_mm=20.0, to_z_mm=300.0)),
    ],
)
def test_unusual_fingers_stay_whole(design):
    mesh = finger_mesh(design, "coarse")
    found = quality(mesh, conforming(mesh))
    assert found.is_closed
    assert found.volume_mm3 == pytest.approx(found.hexahedra_volume_mm3, rel=1e-5)


def test_origins_mark_what_the_paper_gives():
    design = preset_design("flat-70x35")
    assert design.origin["skeleton.mirror_thickness_mm"] == "paper"
    assert "skeleton.rib_thickness_mm" not in design.origin
    assert "pad.length_mm" not in preset_design("original-60x22").origin
    soft, stiff = (preset_design(n).skeleton for n in ("flat-70x35-soft", "flat-70x35"))
    assert soft.rib_thickness_mm < stiff.rib_thickness_mm


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Skeleton(rib_thickness_mm=0.0012), "rib_thickness_mm.*in metres, so write 1.2"),
        (lambda: Skeleton(flange_mm=1500.0), "flange_mm.*in micrometres, so write 1.5"),
        (lambda: Skeleton(rib_width_mm=100.0), "rib_width_mm.*outside 0.2 to 20 mm"),
        (lambda: Skeleton(rib_thickness_mm=2.0, rib_spacing_mm=2.0), "rib_spacing_mm = 2 mm makes the ribs overlap"),
        (
            lambda: Skeleton(rib_thickness_mm=2.0, rib_spacing_mm=3.0, rib_angle_deg=60.0),
            r"more than rib_thickness_mm / cos\(rib_angle_deg\) = 4 mm",
        ),
        (lambda: Backing(from_z_mm=10.0, to_z_mm=10.5), "to_z_mm = 10.5 mm must lie at least 1 mm above"),
        (lambda: NeoHookeSolid(c10_mpa=133.3), "in kPa, so write 0.1333"),
        (lambda: NeoHookeSolid(c10_mpa=133300.0), "in Pa, so write 0.1333"),
        (lambda: ElasticSolid(youngs_modulus_mpa=2.1, poisson_ratio=0.38), "in GPa, so write 2100"),
        (lambda: ElasticSolid(youngs_modulus_mpa=2100.0, poisson_ratio=0.5), "must be below 0.5"),
        (lambda: OgdenSolid(mu_mpa=(6.0,), alpha=(1.6, 2.0)), "must have the same number of terms"),
        (
            lambda: OgdenSolid(mu_mpa=(5.231, -5.848), alpha=(1.6663, -7.136)),
            "initial shear modulus .* must be positive, but is -0.617",
        ),
        (
            lambda: OgdenSolid(mu_mpa=(0.006279, 0.001639)),
            r"mu_mpa: the initial shear modulus \(the sum of the terms\) of 0.007918 MPa is .* in GPa, so write 7.918",
        ),
        (lambda: FingerDesign(skeleton=Skeleton(width_mm=40.0)), "is too narrow"),
    ],
)
def test_impossible_numbers_are_refused_in_the_design(build, message):
    with pytest.raises(FieldError, match=f"(?s){message}"):
        build()


@pytest.mark.parametrize(
    ("design", "message"),
    [
        (
            FingerDesign(pad=GelPad(length_mm=0.07), indenter={"position_mm": 0.03}),
            "pad.length_mm: .*in metres, so write 70",
        ),
        (with_skeleton(rib_count=40, rib_thickness_mm=1.6), "rib_count = 40, rib_spacing_mm = 1.92"),
        (with_skeleton(rib_spacing_mm=20.0), "the base and rib 1 of the skeleton overlap"),
        (with_skeleton(rib_spacing_mm=13.5, rib_angle_deg=60.0), "rib 6 and the tip"),
        (with_skeleton(width_mm=42.0), "width_mm = 42 mm is too narrow, .* at least 44 mm"),
        (
            with_skeleton(flange_mm=5.0),
            r"flange_mm = 5 mm reaches beyond the front fin, .* is [\d.]+ mm; make flange_mm at most [\d.]+",
        ),
        (with_skeleton(tip_starts_mm=70.5), "tip_starts_mm = 70.5 mm must lie above the end of the pad"),
        (with_skeleton(front_fin_thickness_mm=6.0), "apart at the tip"),
        (
            # the line of the rib and the parabola of the back fin have no point in common
            with_skeleton(rib_count=1, rib_angle_deg=-56.2).model_copy(update={"mirror": Mirror(radius_mm=70.0)}),
            r"skeleton\.rib_angle_deg = -56\.2 deg does not meet the back fin, .*\(mirror\.radius_mm = 70 mm\)",
        ),
    ],
)
def test_parts_that_do_not_fit_are_refused(design, message):
    with pytest.raises(SimulateError, match=message):
        finger_mesh(design, "coarse")


def test_a_mesh_names_only_its_nodes_and_is_unfolded():
    corners = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=np.float64)
    cube = Block("cube", np.arange(8)[None], "gel", "mean_dilatation")
    FingerMesh(corners, (cube,), {}, {}, ())
    for kwargs, what in (
        ({"node_sets": {"end": np.array([8])}}, "node set end"),
        ({"surfaces": {"top": np.array([[0, 1, 2, -1]])}}, "surface top"),
        ({"ties": (Tie(np.array([], dtype=np.int64), np.array([[0, 1, 2, 3]])),)}, "a tie"),
        ({"blocks": (Block("none", np.zeros((0, 8), np.int64), "gel", "mean_dilatation"),)}, "block none"),
    ):
        with pytest.raises(SimulateError, match=f"{what} of the mesh must name"):
            FingerMesh(
                **{"nodes_mm": corners, "blocks": (cube,), "node_sets": {}, "surfaces": {}, "ties": (), **kwargs}
            )
    corners[6] = (0.2, 0.2, 1.0)  # a corner pushed through the opposite edges
    with pytest.raises(SimulateError, match="1 hexahedra of block cube are inside out"):
        FingerMesh(corners, (cube,), {}, {}, ())


def read_stl(data):
    """Return triangles and vertices, joined at equal coordinates, of a binary STL file."""
    count = int(np.frombuffer(data[80:84], "<u4")[0])
    records = np.frombuffer(data[84:], dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    assert len(records) == count
    vertices, triangles = np.unique(records["v"].reshape(-1, 3), axis=0, return_inverse=True)
    return records["n"], triangles.reshape(-1, 3), vertices.astype(np.float64)


@pytest.mark.parametrize("part", ["skeleton", "base_plate", "backing"])
def test_printed_parts_are_closed_and_hold_their_volume(part):
    normals, triangles, vertices = read_stl(part_stl(DESIGN, part))
    mesh = skeleton_mesh(DESIGN, 1.0)
    found = surface_quality(triangles, vertices, np.zeros((0, 8), np.int64))
    assert found.is_closed
    # single precision of coordinates up to 80 mm
    volume = hexahedra_volume_mm3(mesh.nodes_mm, mesh.hexahedra[part]).sum()
    assert found.volume_mm3 == pytest.approx(volume, rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["flat-70x35", "ellipsoidal-30-8-90"])
def test_the_mould_is_its_block_less_the_pad(name):
    design = preset_design(name)
    _, triangles, vertices = read_stl(mould_stl(design, wall_mm=2.0, floor_mm=4.0))
    found = surface_quality(triangles, vertices, np.zeros((0, 8), np.int64))
    assert found.is_closed
    assert found.euler_number == 2
    pad = pad_mesh(design, 0.5, 3.0)
    gel = hexahedra_volume_mm3(pad.nodes_mm, pad.hexahedra["gel"]).sum()
    # the walls are as high as the pad's own edge, under which the mould is solid
    assert found.volume_mm3 == pytest.approx(39.0 * 74.0 * 10.0 - gel, rel=1e-5)


def test_stl_is_refused_where_it_could_not_be_read():
    with pytest.raises(SimulateError, match="no part backing; its parts are skeleton, base_plate, mirror"):
        part_stl(preset_design("original-60x22"), "backing")
    with pytest.raises(SimulateError, match="wall_mm and floor_mm of a mould must be positive, got 0 and 1 mm"):
        mould_stl(DESIGN, wall_mm=0.0, floor_mm=1.0)
    for title in ("solid finger", "x" * 81, "F\u00fcnger"):
        with pytest.raises(SimulateError, match="title of an STL file"):
            stl_bytes(np.array([[0, 1, 2]]), np.eye(3), title)


def test_steps_shrink_from_preset_to_preset():
    for coarse, fine in pairwise(STEPS.values()):
        assert fine.pad_mm < coarse.pad_mm
        assert fine.skeleton_mm < coarse.skeleton_mm
