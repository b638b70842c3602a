"""Automatic derivatives of probe radiances against differences with common random numbers, flat and bent."""

import numpy as np
import pytest

from data_schemas import FingerDesign, LightPanel, MissingExtraError, SimulateError
from data_schemas._design_parts import Enclosure, Mirror
from sim.optics import ProbePaths, paint_bands, probe_gradient
from sim.optics import _refraction as gel_face
from sim.optics._gradients import moved
from sim.surface_meshes import bent, pressed_shape

# nothing outside the gel returns light, so that almost all of it is connected
DARK = {"mirror": Mirror(reflectance=0.0), "enclosure": Enclosure(cloth_reflectance=0.0, base_reflectance=0.0)}
PROBES_MM = np.array([[2.0, 29.0], [-5.0, 45.0]])
FEW = {"probe_points_mm": PROBES_MM, "paths": ProbePaths(4000, 2, 5)}
HALF_STEPS = {"angle_deg": 1.0, "position_x_mm": 0.2, "position_y_mm": 0.2, "position_z_mm": 0.2}
# red, green, LED: the same random numbers, so that single paths at the pad's outline decide, which only differences
# see; 0.4 % was seen in the LED band, and 3 % in a painted one, whose walls reach the outline
LARGEST_DIFFERENCE_REL = np.array([0.1, 0.1, 0.01])


def lit(angle_deg=60.0, z_mm=10.0):
    light = LightPanel(angle_deg=angle_deg, position_mm=(1.0, -12.0, z_mm))
    return FingerDesign(light=light, **DARK)


def smooth(design, paints, renderer, shape=None):
    found = probe_gradient(design, paints, renderer, (), shape=shape, **FEW)
    return found.value_rel - found.rest_rel


@pytest.mark.renderer
@pytest.mark.parametrize(
    ("bending_radius_mm", "angle_deg", "names"),
    [(None, 90.0, tuple(HALF_STEPS)), (100.0, 60.0, ("angle_deg", "position_z_mm"))],
)
def test_automatic_derivatives_equal_differences_with_common_random_numbers(
    llvm, paints, bending_radius_mm, angle_deg, names
):
    design = lit(angle_deg)
    shape = None if bending_radius_mm is None else bent(pressed_shape(design), bending_radius_mm)
    found = probe_gradient(design, paints, llvm, names, shape=shape, **FEW)
    automatic = found.gradient - found.by_differences
    for k, name in enumerate(names):
        half = HALF_STEPS[name]
        ahead, behind = (smooth(moved(design, name, s * half), paints, llvm, shape) for s in (1.0, -1.0))
        differences = (ahead - behind) / (2.0 * half)
        # of the largest of the two probes, whose signal differs tenfold
        scale = np.abs(automatic[k]).max(axis=0)
        error_rel = np.abs(automatic[k] - differences) / scale
        assert (error_rel < LARGEST_DIFFERENCE_REL).all(), (name, error_rel)
    assert np.abs(automatic[0, :, 2]).min() > 0.0


@pytest.mark.renderer
def test_the_outline_of_the_pad_is_differentiated(llvm, paints, monkeypatch):
    """A panel before the pad's end: every step of it lets more of its light pass the outline of the inner face.

    Automatic differentiation sees the light of a path change, not which paths the outline lets through. With the rim
    left to differences both ways agree; without a rim (the negative control) the red band does not.
    """
    design = lit(z_mm=-6.0)
    few = {"probe_points_mm": np.array([[2.0, 3.0], [5.0, 29.0]]), "paths": ProbePaths(3000, 2, 5)}

    def red_and_led(automatic):
        found = probe_gradient(design, paints, llvm, ("position_z_mm",), automatic=automatic, **few)
        return found.gradient[0][:, [0, 2]]

    truth = red_and_led(automatic=False)
    # equal random numbers; 1 % was seen, the bias of the steps of 1 mm
    np.testing.assert_allclose(red_and_led(automatic=True), truth, rtol=0.03)
    monkeypatch.setattr(gel_face, "_RIM_MM", 1e-3)
    assert np.abs(red_and_led(automatic=True) / truth - 1.0)[1, 0] > 0.15


@pytest.mark.renderer
def test_bands_are_linear_in_the_conversion(llvm, paints):
    """Only the LED excites these paints, so that band = conversion * derivative, path by path."""
    found = probe_gradient(FingerDesign(), paints, llvm, ("red_conversion", "green_conversion"), **FEW)
    bands = paint_bands(paints["red"], paints["green"], FingerDesign().light)
    for k, wall in enumerate(("red", "green")):
        linear = np.zeros((2, 3))
        linear[:, k] = found.value_rel[:, k]
        np.testing.assert_allclose(bands.conversion[wall][2] * found.gradient[k], linear, rtol=1e-4, atol=1e-9)
    assert found.value_rel[:, :2].min() > 0.0
    assert (found.by_differences == 0.0).all()
    assert (found.rest_rel[:, 2] > 0.1 * found.value_rel[:, 2]).all()  # the mirror


@pytest.mark.renderer
def test_automatic_and_full_differences_agree_where_the_mirror_returns_light(llvm, paints):
    """The same light with and without automatic differentiation: equal within the bias of wide steps."""
    design = FingerDesign(light=LightPanel(angle_deg=80.0, position_mm=(1.0, -12.0, 10.0)))
    one, other = (
        probe_gradient(design, paints, llvm, ("angle_deg",), automatic=automatic, **FEW) for automatic in (True, False)
    )
    np.testing.assert_allclose(one.gradient[..., 2], other.gradient[..., 2], rtol=0.03)
    assert np.abs(one.by_differences[..., 2]).max() < np.abs(other.by_differences[..., 2]).max()


def test_refusals(scalar, paints):
    design = FingerDesign()
    with pytest.raises(SimulateError, match=r"must be among angle_deg.*, got 'angle'"):
        probe_gradient(design, paints, scalar, ("angle",))
    with pytest.raises(SimulateError, match="at least 2 repeats"):
        probe_gradient(design, paints, scalar, paths=ProbePaths(repeats=1))
    with pytest.raises(MissingExtraError, match="gradients need a compiled variant"):
        probe_gradient(design, paints, scalar)


@pytest.mark.renderer
def test_a_probe_beside_the_pad_is_refused(llvm, paints):
    with pytest.raises(SimulateError, match="lies outside the pad"):
        probe_gradient(FingerDesign(), paints, llvm, probe_points_mm=np.array([[0.0, 71.0]]))
