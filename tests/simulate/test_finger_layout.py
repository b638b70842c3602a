"""Camera, mirror and panels where a finger's design puts them: the usual places when given, others by closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import FingerDesign, GelPad, LightPanel, finger_identity
from data_schemas._design_parts import Enclosure, Mirror, TactileCamera
from finray_calib.reports import finger_page
from sim import PRESETS, design_toml, preset_design, read_design
from sim.optics import camera_pose, camera_view, check_paints, inner_face, panel_frame
from sim.optics._gradients import move_panel, moved
from sim.optics._refraction import curved_irradiance
from sim.optics._scene import finger_scene
from sim.surface_meshes import layout_scale, mirror_shape, rest_shape
from tests.simulate.closed_form_view import coat_positions
from tests.simulate.flat_refraction import refracted_irradiance

SMALL = {"width_px": 160, "height_px": 120}
MOVED = FingerDesign(
    camera=TactileCamera(position_mm=(2.0, -13.0, -4.0), aim_deg=10.0, **SMALL),
    mirror=Mirror(base_yz_mm=(-23.0, -1.0), tip_yz_mm=(-6.0, 72.0), radius_mm=300.0, side_overhang_mm=2.0),
)


@pytest.mark.parametrize("name", PRESETS)
def test_the_usual_places_written_out_are_the_usual_ones(name):
    """Today's lay-out, which was constants of the code: every number of the scene stays what it was."""
    usual = preset_design(name)
    scale = layout_scale(usual)
    written = usual.model_copy(
        update={
            "camera": usual.camera.model_copy(update={"position_mm": (0.0, -15.0 * scale, -2.0 * scale)}),
            "mirror": usual.mirror.model_copy(
                update={"base_yz_mm": (-20.0 * scale, 0.0), "tip_yz_mm": (-4.5 * scale, 70.0 * scale)}
            ),
        }
    )
    for one, other in ((camera_pose(usual), camera_pose(written)), (mirror_shape(usual), mirror_shape(written))):
        for field in type(one).__dataclass_fields__:
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    assert (usual.camera.aim_deg, usual.mirror.overhang_mm, usual.mirror.side_overhang_mm) == (14.0, 4.0, 1.0)
    assert (usual.enclosure.panel_reflectance, usual.enclosure.cloth_clearance_mm) == (0.05, 8.0)


def test_what_a_moved_camera_sees_in_a_moved_mirror(scalar, tmp_path):
    view = camera_view(MOVED, tmp_path, scalar)
    rest = MOVED.model_copy(update={"indenter": MOVED.indenter.model_copy(update={"depth_mm": 0.0})})
    wanted, found = coat_positions(rest), view.maps.coat_mm(MOVED)
    both = np.isfinite(wanted[..., 0]) & np.isfinite(found[..., 0])
    assert both.sum() > 200
    # facets of the mirror of 0.3 mm on a radius of 300 mm turn a ray by 0.06 deg at most
    np.testing.assert_allclose(found[both], wanted[both], atol=0.1)
    usual = camera_view(FingerDesign(camera=TactileCamera(**SMALL)), tmp_path, scalar).maps.coat_mm(MOVED)
    assert np.nanmax(np.abs(found - usual)) > 2.0  # the comparison can fail
    told = str(view)
    assert "camera          x, y, z = 2.0, -13.0, -4.0 mm, 10 deg to the tip (assumed)" in told
    assert "mirror          y, z = -23.0, -1.0 to -6.0, 72.0 mm, radius 300 mm (assumed)" in told
    assert "light panel     x, y, z = 0.0, -10.0, -1.0 mm, 30 deg from the pad plane, azimuth 0 deg" in told


def test_a_measured_place_is_told_as_measured(scalar, tmp_path):
    told = str(camera_view(MOVED.model_copy(update={"origin": {"camera.position_mm": "measured"}}), tmp_path, scalar))
    assert "deg to the tip (measured)" in told


@pytest.mark.parametrize("azimuth_deg", [-70.0, 25.0, 180.0])
def test_a_turned_panel_lights_the_gel_as_in_closed_form(azimuth_deg):
    light = LightPanel(angle_deg=50.0, azimuth_deg=azimuth_deg, position_mm=(6.0, -9.0, 20.0), width_mm=8.0)
    design = FingerDesign(pad=GelPad(film=None), light=light)
    face = inner_face(design, rest_shape(design))
    x, z = (v.ravel() for v in np.meshgrid(np.linspace(-14.0, 14.0, 6), np.linspace(6.0, 60.0, 7)))
    points = np.column_stack([x, np.full_like(x, 4.0), z])
    normals = np.broadcast_to([0.0, -1.0, 0.0], points.shape)
    foot = np.column_stack([x / 35.0 + 0.5, z / 70.0])
    found = curved_irradiance(points, normals, foot, light, face)
    wanted = refracted_irradiance(points, normals, light, design.pad)
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-6 * wanted.max())
    straight = curved_irradiance(points, normals, foot, light.model_copy(update={"azimuth_deg": 0.0}), face)
    assert np.abs(found - straight).max() > 0.1 * wanted.max()


def test_a_panel_s_derivative_turns_it_the_way_it_is_drawn(llvm):
    light = LightPanel(angle_deg=40.0, azimuth_deg=35.0)
    design, panel = FingerDesign(light=light), SimpleNamespace()
    move_panel(panel, light, llvm.Float(3.0), "angle_deg", llvm)
    frame = panel_frame(moved(design, "angle_deg", 3.0).light)
    np.testing.assert_allclose(np.array(panel.normal).ravel(), frame.normal, atol=1e-6)
    np.testing.assert_allclose(np.array(panel.along).ravel(), frame.half_along_mm, atol=1e-6)


def test_further_panels_are_panels(scalar, paints):
    tip = LightPanel(angle_deg=150.0, position_mm=(0.0, -4.0, 71.0))
    side = LightPanel(angle_deg=60.0, azimuth_deg=-90.0, position_mm=(14.0, -8.0, 40.0), power_rel=0.5)
    two = FingerDesign(second_light=tip)
    other_two = FingerDesign(further_lights=(tip,))
    three = FingerDesign(second_light=tip, further_lights=(side,))
    assert two.lights == other_two.lights == three.lights[:2]
    assert three.lights[2] == side
    scenes = [finger_scene(d, rest_shape(d), check_paints(d, paints), scalar) for d in (two, other_two, three)]
    values = [
        {key: np.array(v) for key, v in scalar.traverse(s).items() if "panel" in key and "bsdf" not in key}
        for s in scenes
    ]
    assert values[0].keys() == values[1].keys() < values[2].keys()
    for key, value in values[0].items():
        np.testing.assert_array_equal(value, values[1][key])
    np.testing.assert_allclose(values[2]["panel2.emitter.radiance.value"], [0.0, 0.0, 0.5])


def test_cloth_and_panels_of_the_enclosure(scalar, paints):
    enclosure = Enclosure(panel_reflectance=0.3, cloth_clearance_mm=20.0)
    sizes = []
    for design in (FingerDesign(), FingerDesign(enclosure=enclosure)):
        scene = finger_scene(design, rest_shape(design), check_paints(design, paints), scalar)
        sizes.append(np.array(scene.bbox().max) - np.array(scene.bbox().min))
        reflectance = np.array(scalar.traverse(scene)["panel0.bsdf.reflectance.value"])
        np.testing.assert_allclose(reflectance, design.enclosure.panel_reflectance)
    np.testing.assert_allclose(sizes[1] - sizes[0], 24.0, atol=1e-4)


def test_a_design_with_all_of_it_is_written_and_read(tmp_path):
    side = LightPanel(azimuth_deg=-90.0, position_mm=(14.0, -8.0, 40.0))
    design = MOVED.model_copy(update={"further_lights": (side, side.model_copy(update={"power_rel": 2.0}))})
    path = tmp_path / "finger.toml"
    path.write_text(design_toml(design))
    assert read_design(path) == design
    page = finger_page(design, b"", "view")
    assert "further_lights.azimuth_deg" in page
    assert "light panel 3" in page
    assert "# [[further_lights]] adds one more" in design_toml(FingerDesign())


def test_another_mirror_is_another_finger_and_another_view_is_not():
    """A sweep of the light looks along the pad's normal: the place of the camera changes nothing of it."""
    usual = finger_identity(FingerDesign())
    assert usual.differs_in(finger_identity(MOVED)) == ("mirror",)
    lit = FingerDesign(further_lights=(LightPanel(position_mm=(5.0, -9.0, 9.0)),))
    assert usual.differs_in(finger_identity(lit)) == ("further_lights",)
