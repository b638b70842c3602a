"""The objective of a sweep, written out by hand: paint draws scale their own band, the same at every angle."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_schemas import FingerDesign
from data_schemas.storage import assumed_camera_response
from finray_calib.spectra import SkewCauchy
from sim.experiments import PaintedFinger
from sim.experiments import _light_angle as light_angle
from sim.optics import AngleSweep, PaintOptics, ProbePaths, paint_bands

GRID_NM = np.arange(380.0, 781.0)
DRAWS = {"red": (600.0, np.log(50.0), 1.0, np.log(0.003)), "green": (520.0, np.log(40.0), 0.5, np.log(0.004))}
ANGLES_DEG = np.array([0.0, 30.0, 60.0, 90.0])
REPEATS = 3


def paint(colour: str) -> PaintOptics:
    return PaintOptics(colour, GRID_NM, SkewCauchy.from_mode(*DRAWS[colour])(GRID_NM), np.full(GRID_NM.size, 0.05))


@pytest.fixture
def finger(monkeypatch) -> PaintedFinger:
    design = FingerDesign()
    bands = paint_bands(paint("red"), paint("green"), design.light)
    radiance = np.random.default_rng(3).uniform(0.5, 1.5, (ANGLES_DEG.size, REPEATS, 4, 3)) * [0.01, 0.02, 1.0]
    sweep = AngleSweep(ANGLES_DEG, radiance, np.zeros((4, 3)), bands, 1, 1, 0.0, "made up", "made up")
    monkeypatch.setattr(light_angle, "sweep_light_angle", lambda *_, **__: sweep)
    return PaintedFinger(
        design, {c: paint(c) for c in DRAWS}, assumed_camera_response(), SimpleNamespace(variant=lambda: "made up")
    )


@pytest.mark.parametrize("brighter", [1.0, 2.0])
def test_a_paint_draw_scales_its_own_band(finger, brighter):
    """All draws of the red paint are `brighter` times the mean paint; the green ones are the mean paint."""
    red, green = brighter * paint("red").emission_per_nm, paint("green").emission_per_nm
    calibrations = {
        colour: SimpleNamespace(emission_draws_per_nm=curve[None]) for colour, curve in (("red", red), ("green", green))
    }
    record = light_angle.light_angle_sweep(finger, calibrations, ANGLES_DEG, ProbePaths(1, REPEATS, 1), {})
    bands = paint_bands(finger.paints["red"], finger.paints["green"], finger.design.light)
    scaled = record.basis.mean(axis=2) * [brighter, 1.0, 1.0]
    rgb = np.array([[finger.camera_matrix(bands) @ one for one in row] for row in scaled])
    expected = (rgb / rgb.mean(axis=(0, 1))).mean(axis=2)
    np.testing.assert_allclose(record.values, expected, rtol=1e-9)
    assert record.values.mean() == pytest.approx(1.0)
