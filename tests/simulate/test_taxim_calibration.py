"""Ball presses for Taxim: where they lie, what each pixel sees, and that renders show the contact where it is said."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import CameraBelow, FingerDesign, GelPad, Indenter, PlainSensor, SimulateError
from sim.experiments import _sensor_press as taxim_finger
from sim.experiments import render_ball_presses
from sim.experiments._sensor_press import DEPTHS_REL, mm_per_px, planned_presses, surface_of
from sim.surface_meshes import contact_half_width_mm, pressed_height_mm

SENSOR = PlainSensor(camera=CameraBelow(width_px=48, height_px=48, field_of_view_deg=26.0))
DOME = GelPad(shape="ellipsoidal", length_mm=20.0, width_mm=20.0, thickness_mm=5.0, semi_axes_mm=(22.0, 14.0, 22.0))


class FlatRenderer:
    """Stands in for the renderer: every picture is grey."""

    def __init__(self, monkeypatch):
        for name in ("plain_sensor_scene", "plain_sensor_integrator"):
            monkeypatch.setattr(f"sim.experiments._sensor_press.{name}", lambda *_, **__: None)

    def render(self, *_, **__):
        return np.ones((48, 48, 3))

    def variant(self):
        return "none"


def test_presses_lie_evenly_on_the_pad():
    designs = planned_presses(SENSOR.pressed_pad(), 2.0, 48)
    places = np.array([[d.indenter.across_mm, d.indenter.position_mm - 10.0] for d in designs])
    rims = np.array([float(contact_half_width_mm(d)) for d in designs])
    assert (np.abs(places).max(axis=1) + rims <= 10.0 + 1e-9).all()
    assert sorted({d.indenter.depth_mm for d in designs}) == pytest.approx([4.0 * share for share in DEPTHS_REL])
    # a grid of 3 x 3 fields: every one holds presses, and none more than twice its share
    counts, *_ = np.histogram2d(*places.T, bins=3)
    assert counts.min() >= 3
    assert counts.max() <= 2 * 48 / 9


@pytest.mark.parametrize(
    ("pad", "ball_mm", "message"),
    [
        (DOME, 2.0, "Taxim's table treats every slope as contact"),
        (
            SENSOR.pad,
            1.0,
            "a ball of 1 mm radius does not fit a pad of 20 x 20 x 4 mm; its radius must be above 1.33 mm",
        ),
        (SENSOR.pad, 60.0, "does not fit a pad"),
    ],
)
def test_pads_and_balls_that_do_not_fit_are_refused(pad, ball_mm, message):
    design = FingerDesign(pad=pad, indenter=Indenter(position_mm=10.0))
    with pytest.raises(SimulateError, match=message):
        planned_presses(design, ball_mm, 3)


def test_a_ball_beside_the_middle_line_is_the_one_on_it_moved():
    """The pad is wide, so that its edges do not change what bulges."""
    wide = FingerDesign(pad=GelPad(length_mm=40.0, width_mm=40.0, thickness_mm=4.0))
    heights = []
    for across in (0.0, 6.0):
        ball = Indenter(shape="ball", radius_mm=2.0, depth_mm=0.8, position_mm=20.0, across_mm=across)
        x = np.linspace(-4.0, 4.0, 33) + across
        heights.append(pressed_height_mm(wide.model_copy(update={"indenter": ball}), x, np.linspace(16.0, 24.0, 33)))
    # the bulge's amplitude is made up over the whole pad, of which a little more is cut off beside the middle
    assert np.abs(heights[0] - heights[1]).max() < 0.01
    assert heights[0].min() == pytest.approx(3.2, abs=0.05)


def test_pixels_see_the_slopes_of_the_ball(monkeypatch):
    presses = render_ball_presses(SENSOR, FlatRenderer(monkeypatch), 2.0, 3)
    scale = mm_per_px(SENSOR)
    assert presses.mm_per_px == scale
    for k in range(3):
        rows, columns = np.nonzero(presses.distance[k] <= 0.6)
        offset = scale * np.stack([columns - presses.column_px[k], rows - presses.row_px[k]], axis=-1)
        expected = -offset / np.sqrt(4.0 - (offset**2).sum(axis=-1))[:, None]
        # the dent's floor lies nearer the camera than the pad at rest: it is seen up to 1.2 mm x tan(9 deg) aside
        assert np.abs(presses.slopes[k][rows, columns] - expected).max() < 0.15
        assert np.abs(np.mean(presses.slopes[k][rows, columns] - expected, axis=0)).max() < 0.1
    assert np.isnan(presses.slopes[0][0, 0]).all() == np.isnan(presses.distance[0][0, 0])


@pytest.mark.renderer
def test_the_contact_shows_where_it_is_said(llvm):
    presses = render_ball_presses(SENSOR, llvm, 2.0, 2, seed=1, samples_per_pixel=16)
    change = np.abs(presses.contacts - presses.no_contact).sum(axis=-1)
    rows, columns = np.indices(change.shape[1:])
    for k in range(2):
        near = presses.distance[k] <= 1.5
        # the steep rim changes most, evenly around the contact up to the lights' three directions
        centre = [(change[k] * near * at).sum() / (change[k] * near).sum() for at in (rows, columns)]
        assert np.hypot(centre[0] - presses.row_px[k], centre[1] - presses.column_px[k]) < 0.5 * presses.radius_px[k]
        assert change[k][presses.distance[k] <= 1.0].mean() > 3.0 * change[k][presses.distance[k] > 4.0].mean()


def maps_of(design, shape_px=(60, 90)):
    """What a camera straight above the pad would see: columns against z, rows along x."""
    rows, columns = np.indices(shape_px)
    z = design.pad.length_mm * (1.0 - (columns + 0.5) / shape_px[1])
    x = design.pad.width_mm * ((rows + 0.5) / shape_px[0] - 0.5)
    return SimpleNamespace(coat_mm=lambda _: np.stack([z, x], axis=-1))


def test_a_finger_is_brought_into_the_plane_of_its_pad(monkeypatch):
    """A picture whose colours are the places on the pad shows these places, in order, in the pad's plane."""
    design = FingerDesign()
    pad = design.pad

    def rendered(pressed, *_, **__):
        maps = maps_of(pressed)
        z, x = np.moveaxis(maps.coat_mm(pressed), -1, 0)
        place = np.stack([z, x + pad.width_mm, np.full_like(z, 5.0)], axis=-1).astype(np.float32)
        return SimpleNamespace(
            no_contact_bands=place, contact_bands=place, no_contact_maps=maps, contact_maps=maps, bands=None
        )

    monkeypatch.setattr(taxim_finger, "render_press", rendered)
    monkeypatch.setattr(taxim_finger.PaintedFinger, "camera_matrix", lambda *_: np.eye(3))
    finger = taxim_finger.PaintedFinger(design, {"red": None, "green": None}, (), None)
    presses = taxim_finger.render_finger_presses(finger, 4.0, 2)
    side = presses.mm_per_px
    assert side == pytest.approx(np.sqrt(pad.length_mm * pad.width_mm / (60 * 90)))
    inner = (slice(2, -2), slice(2, -2))
    rows, columns = (at[inner] for at in np.indices(presses.no_contact.shape[:2]))
    # grey balance: each colour is scaled to the brightest one's mean
    colours = presses.no_contact[inner] / presses.no_contact[inner].mean(axis=(0, 1))
    z, x = (columns + 0.5) * side, (rows + 0.5) * side
    assert np.allclose(colours[..., 0], z / z.mean(), atol=0.02)
    assert np.allclose(colours[..., 1], (x + pad.width_mm / 2.0) / (x + pad.width_mm / 2.0).mean(), atol=0.02)
    for k, pressed in enumerate(planned_presses(design, 4.0, 2)):
        surface = surface_of(pressed)
        expected = -surface.ev(x - pad.width_mm / 2.0, z, dy=1)
        # pixels of the camera are about as large as those of the plane: half a pixel of 0.67 mm on a ball of 4 mm
        assert np.abs(presses.slopes[k][inner][..., 0] - expected).mean() < 0.02
        middle = presses.distance[k][round(presses.row_px[k]), round(presses.column_px[k])]
        assert middle < 0.5


def test_a_pad_that_is_hardly_seen_is_refused(monkeypatch):
    maps = maps_of(FingerDesign(), (5, 5))
    small = SimpleNamespace(no_contact_maps=maps, contact_maps=maps, bands=None)
    monkeypatch.setattr(taxim_finger, "render_press", lambda *_, **__: small)
    monkeypatch.setattr(taxim_finger.PaintedFinger, "camera_matrix", lambda *_: np.eye(3))
    finger = taxim_finger.PaintedFinger(FingerDesign(), {"red": None, "green": None}, (), None)
    with pytest.raises(SimulateError, match="25 pixels see the pad, but at least 100 are needed"):
        taxim_finger.render_finger_presses(finger, 4.0, 2)
    with pytest.raises(SimulateError, match="count must be at least 1 press, got 0"):
        taxim_finger.render_finger_presses(finger, 4.0, 0)


@pytest.mark.parametrize(
    "turned", [{"tilt_deg": 5.0}, {"across_mm": 1.0}, {"roll_deg": 90.0}, {"calibration": "lens.yaml"}]
)
def test_a_camera_that_does_not_look_straight_is_refused(turned):
    camera = SENSOR.camera.model_copy(update=turned)
    with pytest.raises(
        SimulateError,
        match=rf"camera\.{next(iter(turned))} is not supported, because Taxim's pictures are those of a camera that",
    ):
        render_ball_presses(SENSOR.model_copy(update={"camera": camera}), SimpleNamespace(), 4.0, 3)
