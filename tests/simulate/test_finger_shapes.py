import tomllib

import numpy as np
import pytest

from data_schemas import FingerDesign, FingerSurfaces, GelPad, Indenter, LightPanel, SimulateError, provenance
from data_schemas.storage import read_record, write_record
from sim import PRESETS, design_toml, preset_design
from sim.surface_meshes import (
    FingerShape,
    Surface,
    bent,
    check_closed,
    check_no_intersections,
    contact_distance,
    contact_half_width_mm,
    pressed_height_mm,
    pressed_shape,
    rest_height_mm,
    rest_shape,
    restore_shapes,
    store_shapes,
    unpressed_design,
)
from sim.surface_meshes._finger_shape import BLEND_MM

DESIGN = FingerDesign()
ORIGIN = provenance("pytest", {}, seed=None)
# trapezoid rule on 0.1 mm steps against the profile's own quadrature
VOLUME_TOLERANCE = 1e-6


CYLINDER = GelPad(shape="cylindrical", radius_mm=60.0)
ELLIPSOID = GelPad(shape="ellipsoidal", semi_axes_mm=(30.0, 8.0, 90.0))
PADS = [GelPad(), CYLINDER, ELLIPSOID, GelPad(length_mm=48.0, width_mm=18.0)]


def press(**indenter):
    return FingerDesign(indenter=Indenter(**indenter))


def pressed_profile(design, z):
    return pressed_height_mm(design, np.zeros(1), z)[0]


def test_half_width_is_the_chord_of_the_circle():
    assert contact_half_width_mm(DESIGN) == pytest.approx(np.sqrt(10.0**2 - 8.5**2))
    assert contact_half_width_mm(press(radius_mm=2.0, depth_mm=3.0)) == 2.0
    assert contact_half_width_mm(unpressed_design(DESIGN)) == 0.0


@pytest.mark.parametrize("pad", PADS)
def test_without_a_press_the_face_is_that_of_the_pad(pad):
    design = unpressed_design(FingerDesign(pad=pad))
    x, z = np.linspace(-9.0, 9.0, 7), np.linspace(0.0, 48.0, 9)
    np.testing.assert_array_equal(pressed_height_mm(design, x, z), rest_height_mm(design, x[:, None], z))


def test_curved_faces_lie_on_their_cylinder_and_ellipsoid():
    x, z = np.meshgrid(np.linspace(-17.5, 17.5, 8), np.linspace(0.0, 70.0, 9), indexing="ij")
    y = rest_height_mm(FingerDesign(pad=CYLINDER), x, z)
    np.testing.assert_allclose(x**2 + (y - (6.0 - 60.0)) ** 2, 60.0**2)
    y = rest_height_mm(FingerDesign(pad=ELLIPSOID), x, z)
    np.testing.assert_allclose((x / 30.0) ** 2 + ((y - (6.0 - 8.0)) / 8.0) ** 2 + ((z - 35.0) / 90.0) ** 2, 1.0)


def test_the_face_follows_the_cylinder_inside_the_contact():
    z = DESIGN.indenter.position_mm + np.linspace(-2.5, 2.5, 51)
    cylinder = 6.0 - 1.5 + 10.0 - np.sqrt(100.0 - (z - DESIGN.indenter.position_mm) ** 2)
    # the smooth minimum deviates by blend * ln(1 + exp(-gap / blend)); the gap to the free face is > 1.18 mm here
    largest = BLEND_MM * np.log1p(np.exp(-1.18 / BLEND_MM))
    assert np.abs(pressed_profile(DESIGN, z) - cylinder).max() <= largest


@pytest.mark.parametrize(
    "indenter",
    [{}, {"depth_mm": 0.3}, {"radius_mm": 3.0, "depth_mm": 2.5}, {"position_mm": 66.0}, {"position_mm": 0.0}],
)
def test_the_gel_keeps_its_volume(indenter):
    design = press(**indenter)
    z = np.linspace(0.0, 70.0, 7001)
    mean_height = np.trapezoid(pressed_profile(design, z), z) / 70.0
    # both are trapezoid sums on fine grids (4001 and 7001 points), the difference is their error
    assert mean_height == pytest.approx(6.0, rel=2e-6)


def test_a_press_without_free_face_beside_it_is_refused():
    design = FingerDesign(
        pad=GelPad(length_mm=20.0), indenter=Indenter(radius_mm=500.0, depth_mm=1.0, position_mm=10.0)
    )
    with pytest.raises(SimulateError, match="leaves no free face"):
        pressed_profile(design, np.linspace(0.0, 20.0, 11))


@pytest.mark.parametrize(
    "design", [DESIGN, unpressed_design(DESIGN), FingerDesign(pad=GelPad(length_mm=48, width_mm=18))]
)
def test_the_gel_holds_the_volume_of_the_pad(design):
    pad = design.pad
    volume = check_closed(pressed_shape(design).gel)
    assert volume == pytest.approx(pad.length_mm * pad.width_mm * pad.thickness_mm, rel=VOLUME_TOLERANCE)


@pytest.mark.parametrize("pad", [CYLINDER, ELLIPSOID])
def test_curved_pads_keep_their_volume_under_the_press(pad):
    rest, pressed = (check_closed(f(FingerDesign(pad=pad)).gel) for f in (rest_shape, pressed_shape))
    # lines whose overlap is thinner than the blend of 0.15 mm are rounded there as well, which their bulge makes up
    assert pressed == pytest.approx(rest, rel=1e-5)


def test_a_ball_dents_the_pad_round_and_keeps_its_volume():
    design = press(shape="ball", radius_mm=5.0, depth_mm=1.0)
    shape = pressed_shape(design)
    assert check_closed(shape.gel) == pytest.approx(14700.0, rel=1e-5)  # coat of 0.5 mm steps against 0.09 x 0.18 mm
    x, z = np.linspace(-2.0, 2.0, 5), np.array([35.0])
    deep = 5.0 + 5.0 - np.sqrt(25.0 - x**2)
    # the blend at the smallest gap to the bulged face, some 0.6 mm, is 0.15 ln(1 + exp(-0.6 / 0.15)) = 0.003 mm
    np.testing.assert_allclose(pressed_height_mm(design, x, z)[:, 0], deep, atol=0.004)
    turned = pressed_height_mm(design, z * 0.0, 35.0 + x)[0]
    np.testing.assert_allclose(turned, pressed_height_mm(design, x, z)[:, 0], atol=1e-12)
    inside = contact_distance(design, x, 35.0) <= 1.0
    np.testing.assert_array_equal(inside, np.abs(x) <= np.sqrt(25.0 - 16.0))


def test_the_contact_of_a_curved_pad_ends_across_it():
    design = FingerDesign(pad=CYLINDER)
    x = np.linspace(-17.5, 17.5, 201)
    inside = contact_distance(design, x, 35.0) <= 1.0
    drop = 60.0 - np.sqrt(60.0**2 - x**2)
    np.testing.assert_array_equal(inside, drop <= design.indenter.depth_mm)
    assert np.isnan(contact_distance(unpressed_design(design), x, 35.0)).all()


def test_every_face_points_outward():
    outward = {"coat": (0, 1, 0), "inner": (0, -1, 0), "red": (-1, 0, 0), "green": (1, 0, 0)}
    outward |= {"base": (0, 0, -1), "tip": (0, 0, 1), "mirror": (0, 1, 0)}
    for name, surface in pressed_shape(DESIGN).surfaces.items():
        a, b, c = (surface.vertices_mm[surface.triangles[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a) @ np.array(outward[name]) > 0.0).all(), name


@pytest.mark.parametrize("radius_mm", [300.0, -300.0])
def test_bending_keeps_the_length_of_the_inner_face_and_moves_the_tip(radius_mm):
    shape = rest_shape(DESIGN)
    inner = bent(shape, radius_mm).surfaces["inner"]
    line = inner.vertices_mm[inner.uv[:, 0] == 0.5]
    # chords of 0.1 mm on an arc of 300 mm are shorter by 5e-9
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(70.0, rel=1e-7)
    turn = 70.0 / radius_mm
    np.testing.assert_allclose(line[-1], [0.0, -radius_mm * (1.0 - np.cos(turn)), radius_mm * np.sin(turn)], atol=1e-9)


def test_bending_that_folds_the_finger_is_refused():
    with pytest.raises(SimulateError, match="folds a finger"):
        bent(rest_shape(DESIGN), 30.0)


def gel():
    return dict(pressed_shape(DESIGN).gel)


def test_an_open_gel_is_refused_and_the_hole_named():
    surfaces = gel()
    del surfaces["tip"]
    with pytest.raises(
        SimulateError, match=r"gel is not closed, because .* edges are open .* at coat \(2\), inner \(2\)"
    ):
        check_closed(surfaces)


def test_one_turned_face_is_refused():
    surfaces = gel()
    surfaces["inner"] = surfaces["inner"].reversed()
    with pytest.raises(SimulateError, match="edges are open or belong to triangles of opposite orientation"):
        check_closed(surfaces)


@pytest.mark.parametrize("ways", [(1,), (-1,), (1, -1)])
def test_a_triangle_that_stands_twice_is_refused(ways):
    """Turned it belongs to edges that run twice; with its turned copy every edge has its opposite, twice."""
    surfaces = gel()
    tip = surfaces["tip"]
    more = [tip.triangles[:1, ::way] for way in ways]
    surfaces["tip"] = Surface(tip.vertices_mm, np.vstack([tip.triangles, *more]), tip.uv)
    with pytest.raises(SimulateError, match=r"gel is not closed, because .* at .*tip \("):
        check_closed(surfaces)


def test_a_gel_inside_out_is_refused():
    with pytest.raises(SimulateError, match="normals of the gel point inward"):
        check_closed({name: surface.reversed() for name, surface in gel().items()})


def test_a_shape_without_mirror_or_with_too_few_distances_is_refused():
    shape = pressed_shape(DESIGN)
    with pytest.raises(SimulateError, match="lacks the surfaces mirror"):
        FingerShape(gel(), shape.contact_distance, "no mirror")
    with pytest.raises(SimulateError, match="one value for each vertex of the coat"):
        FingerShape(shape.surfaces, np.zeros(3), "short")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices_mm": np.full((3, 3), np.nan)}, "vertices_mm must be finite"),
        ({"uv": np.zeros((2, 2))}, "one texture coordinate for each vertex"),
        ({"triangles": np.array([[0, 1, 3]])}, "must use only vertex indices from 0 to 2"),
    ],
)
def test_a_broken_surface_is_refused(change, message):
    parts = {"vertices_mm": np.eye(3), "triangles": np.array([[0, 1, 2]]), "uv": np.zeros((3, 2))}
    with pytest.raises(SimulateError, match=message):
        Surface(**parts | change)


def pushed_through(shape, name, depth_mm):
    """Push a stripe of one surface along y; the gel stays closed."""
    stripe = np.abs(shape.surfaces[name].vertices_mm[:, 2] - 35.0) < 1.0
    surface = shape.surfaces[name]
    moved = surface.vertices_mm.copy()
    inside = np.abs(moved[:, 0]) < 17.0
    moved[stripe & inside, 1] -= depth_mm
    return {**shape.gel, name: surface.moved_to(moved)}


@pytest.mark.parametrize("pad", PADS)
def test_presses_and_bends_do_not_intersect(pad):
    shape = pressed_shape(FingerDesign(pad=pad, indenter=Indenter(position_mm=24.0)))
    check_no_intersections(shape.gel)
    check_no_intersections(bent(shape, 200.0).gel)


def test_a_coat_pushed_through_the_inner_face_is_refused_and_named():
    surfaces = pushed_through(rest_shape(DESIGN), "coat", 7.0)
    check_closed(surfaces)
    with pytest.raises(SimulateError, match="surface coat passes through surface inner"):
        check_no_intersections(surfaces)


def test_stored_shapes_come_back_equal(tmp_path):
    shapes = (rest_shape(DESIGN), bent(pressed_shape(DESIGN), 250.0))
    path = write_record(store_shapes(*shapes, "bent"), tmp_path / "bent.surfaces.json", ORIGIN)
    for shape, back in zip(shapes, restore_shapes(read_record(path, FingerSurfaces)), strict=True):
        assert (back.label, list(back.surfaces)) == (shape.label, list(shape.surfaces))
        np.testing.assert_array_equal(back.contact_distance, shape.contact_distance)
        for name, surface in shape.surfaces.items():
            for field in ("vertices_mm", "triangles", "uv"):
                np.testing.assert_array_equal(getattr(back.surfaces[name], field), getattr(surface, field))


def test_counts_that_do_not_add_up_are_refused():
    record = store_shapes(rest_shape(DESIGN), pressed_shape(DESIGN), "pressed")
    with pytest.raises(ValueError, match="_counts must not be negative and must add up to"):
        FingerSurfaces(**record.model_dump() | {"vertex_counts": record.vertex_counts + 1})


@pytest.mark.parametrize("name", PRESETS)
def test_presets_survive_their_toml_and_have_a_shape(name):
    design = preset_design(name)
    written = tomllib.loads(design_toml(design))
    assert written.pop("schema_version") == FingerDesign.schema_version
    assert FingerDesign.model_validate(written) == design
    check_no_intersections(pressed_shape(design).gel)


def test_unknown_preset_lists_those_there_are():
    with pytest.raises(SimulateError, match="no preset design 'huge'; valid names are flat-70x35, "):
        preset_design("huge")


@pytest.mark.parametrize(
    ("pad", "message"),
    [
        ({"shape": "cylindrical"}, "radius_mm is missing"),
        ({"radius_mm": 50.0}, "radius_mm is supported only for shape = .cylindrical., but shape is .flat."),
        ({"shape": "cylindrical", "radius_mm": 17.0}, "more than half the width"),
        ({"shape": "ellipsoidal", "semi_axes_mm": (18.0, 8.0, 60.0)}, "does not cover the corners"),
        ({"shape": "cylindrical", "radius_mm": 18.0}, "leaves no gel at the corners"),
    ],
)
def test_pads_that_cannot_be_cast_are_refused(pad, message):
    with pytest.raises(ValueError, match=message):
        GelPad(**pad)


def test_index_follows_the_abbe_number():
    pad = GelPad(refractive_index=1.41, abbe_number=50.0)
    assert pad.index_at(589.3) == 1.41
    assert (pad.index_at(486.1) - pad.index_at(656.3)) * 50.0 == pytest.approx(0.41, rel=1e-12)


def test_two_panels_must_share_their_spectrum():
    with pytest.raises(ValueError, match=r"second_light\.peak_wavelength_nm must equal"):
        FingerDesign(second_light=LightPanel(peak_wavelength_nm=470.0))
