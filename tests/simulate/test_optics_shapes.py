import numpy as np
import pytest

from data_schemas.design import FingerDesign, GelPad, Indenter
from data_schemas.errors import SimulateError
from sim.optics.gel_surfaces import check_closed, gel_surfaces
from sim.optics.pressed_pad import (
    BLEND_MM,
    contact_half_width_mm,
    pad_face,
    pressed_profile,
    without_press,
)

DESIGN = FingerDesign()
# trapezoid rule on 0.1 mm steps against the profile's own quadrature
VOLUME_TOLERANCE = 1e-6


def press(**indenter):
    return FingerDesign(indenter=Indenter(**indenter))


def test_half_width_is_the_chord_of_the_circle():
    assert contact_half_width_mm(DESIGN) == pytest.approx(np.sqrt(10.0**2 - 8.5**2))
    assert contact_half_width_mm(press(radius_mm=2.0, depth_mm=3.0)) == 2.0
    assert contact_half_width_mm(without_press(DESIGN)) == 0.0


def test_without_a_press_the_face_is_flat():
    np.testing.assert_array_equal(pad_face(without_press(DESIGN)).y_mm, DESIGN.pad.thickness_mm)


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


@pytest.mark.parametrize("design", [DESIGN, without_press(DESIGN), FingerDesign(pad=GelPad(length_mm=48, width_mm=18))])
def test_the_gel_is_closed_and_holds_the_volume_of_the_pad(design):
    pad = design.pad
    volume = check_closed(gel_surfaces(design))
    assert volume == pytest.approx(pad.length_mm * pad.width_mm * pad.thickness_mm, rel=VOLUME_TOLERANCE)


def test_every_face_points_outward():
    outward = {"coat": (0, 1, 0), "inner": (0, -1, 0), "red": (-1, 0, 0), "green": (1, 0, 0)}
    outward |= {"base": (0, 0, -1), "tip": (0, 0, 1)}
    for name, surface in gel_surfaces(DESIGN).items():
        a, b, c = (surface.vertices_mm[surface.triangles[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a) @ np.array(outward[name]) > 0.0).all(), name


def test_an_open_gel_is_refused():
    surfaces = gel_surfaces(DESIGN)
    del surfaces["tip"]
    with pytest.raises(SimulateError, match=r"is not closed: .* edges are open"):
        check_closed(surfaces)


def test_one_turned_face_is_refused():
    surfaces = gel_surfaces(DESIGN)
    surfaces["inner"] = surfaces["inner"].reversed()
    with pytest.raises(SimulateError, match="edges are open or run twice in one direction"):
        check_closed(surfaces)


def test_a_gel_inside_out_is_refused():
    with pytest.raises(SimulateError, match="normals point inward"):
        check_closed({name: surface.reversed() for name, surface in gel_surfaces(DESIGN).items()})
