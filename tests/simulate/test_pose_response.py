"""Derivatives of the contact image by the indenter's pose, against images of closed form and against renders."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import FingerDesign, SimulateError
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import assumed_camera_response
from finray_calib.compare._region_sums import render_layers
from sim.experiments import FingerScene, PaintedFinger, Rendering, pose_response, simulate_press
from sim.experiments import _rendered_press as module
from sim.experiments._rendered_press import POSE_STEPS_MM
from sim.optics import BAKE_SAMPLES, RenderSettings

DESIGN = FingerDesign(camera=TactileCamera(width_px=64, height_px=48))
CHAINS = ("led>red", "led>green", "led")
SHAPE = (4, 5)
BASE = np.random.default_rng(0).random((2, *SHAPE, 3)).astype(np.float32)
WITH_POSE = Rendering(samples_per_pixel=2, with_pose_response=True)


def closed_form(depth_mm, position_mm):
    """Light and half difference of a press: curved in depth, linear in position."""
    return (
        BASE[0] * (1.0 + 0.3 * depth_mm - 0.5 * depth_mm**2) + 0.1 * position_mm,
        BASE[1] * (1.0 + 0.2 * depth_mm) - 0.05 * position_mm,
    )


@pytest.fixture
def finger(paints):
    return PaintedFinger(DESIGN, paints, assumed_camera_response(), SimpleNamespace())


@pytest.fixture
def calls(monkeypatch):
    """Replace the renderer by the closed form; each call is noted."""
    noted = []

    def render(design, paints, renderer, settings, *, shapes, **_):
        noted.append(settings)
        less, more = (closed_form(s.depth_mm, s.position_mm) for s in shapes)
        return SimpleNamespace(
            chains=("led", "led>red"),
            no_contact_chains=less[0][..., [2, 0]], contact_chains=more[0][..., [2, 0]],
            no_contact_half_difference=less[1][..., [2, 0]], contact_half_difference=more[1][..., [2, 0]],
        )  # fmt: skip

    monkeypatch.setattr(module, "render_press", render)
    return noted


def shape_of(design):
    return SimpleNamespace(depth_mm=design.indenter.depth_mm, position_mm=design.indenter.position_mm)


def test_derivatives_are_central_differences(finger, calls):
    found = pose_response(finger, RenderSettings("b", 7, 16, 64), CHAINS, shape_of)
    assert calls == [RenderSettings("b", 7, 16, 64)] * 2
    assert found.names == ("depth_mm", "position_mm")
    assert found.steps_mm == tuple(POSE_STEPS_MM.values())
    depth = DESIGN.indenter.depth_mm
    # central differences of a parabola are exact; images are single precision, differences of 0.2 mm of them
    tolerance = 10.0 * np.finfo(np.float32).eps * 20.0 / 0.2
    for channel in (0, 2):
        expected = BASE[0, ..., channel] * (0.3 - depth)
        np.testing.assert_allclose(found.derivative[0, ..., channel], expected, atol=tolerance)
        np.testing.assert_allclose(found.derivative[1, ..., channel], 0.1, atol=tolerance)
        np.testing.assert_allclose(found.half_difference[0, ..., channel], 0.2 * BASE[1, ..., channel], atol=tolerance)
        np.testing.assert_allclose(found.half_difference[1, ..., channel], -0.05, atol=tolerance)
    # a chain that these renders did not keep is dark
    assert (found.derivative[..., 1] == 0.0).all()


@pytest.mark.parametrize(("field", "value_mm"), [("depth_mm", 0.05), ("position_mm", 0.1)])
def test_a_step_out_of_the_pad_is_refused_before_anything_is_rendered(finger, calls, field, value_mm):
    indenter = finger.design.indenter.model_copy(update={field: value_mm})
    near = replace(finger, design=finger.design.model_copy(update={"indenter": indenter}))
    with pytest.raises(SimulateError, match=rf"moves indenter\.{field} by .* mm is not possible; press deeper, or"):
        simulate_press(FingerScene(near), WITH_POSE, {})
    assert not calls


def test_given_shapes_have_no_response(finger):
    with pytest.raises(
        SimulateError, match="rendered only for the analytic press; leave out --pose-response or --surfaces"
    ):
        simulate_press(FingerScene(finger, shapes=(None, None)), WITH_POSE, {})


def test_a_rendered_press_holds_its_response(scalar, paints, monkeypatch):
    """Of chains, halves and pose in one order; the finger moves only where the indenter is near."""
    monkeypatch.setitem(BAKE_SAMPLES, True, 3000)
    scene = FingerScene(PaintedFinger(DESIGN, paints, assumed_camera_response(), scalar))
    press = simulate_press(scene, replace(WITH_POSE, seed=3, contact_samples_per_pixel=4), {})
    response = press.pose_response
    assert response.names == ("depth_mm", "position_mm")
    assert response.derivative.shape == response.half_difference.shape == (2, *press.contact_half_difference.shape)
    layers = render_layers(press)
    assert layers.pose_names == response.names
    assert layers.halves("contact", press.distance < 1.0, response.names)[0].shape[1] == 3 * press.layer_matrix.shape[1]
    assert np.isfinite(response.derivative).all()
    # with the random numbers of the press itself the far end of the pad hardly changes, beside what the contact does;
    # of 2 paths per pixel, single bright ones would decide a mean
    near, far = (
        np.median(np.abs(response.derivative[:, where]), axis=1).mean(axis=1)
        for where in (press.distance < 1.5, press.distance > 4.0)
    )
    assert (near > 2.0 * far).all()
