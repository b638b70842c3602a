"""A render of another indenter or push than the capture states is refused; what nobody states is not judged."""

import pytest

from data_schemas import CoatSurface, CompareError, FingerDesign, Indenter, IndenterPose, PlainSensor
from finray_calib.compare import CheckOptions, compare_checked, compare_press
from finray_calib.compare._prepared_images import require_same_conditions
from tests.command_line.records import capture_of, press

# as capture_of states it
STATED = {"shape": "cylinder", "radius_mm": 10.0, "depth_mm": 1.5, "position_mm": 35.0}


def pair(rendered=None, **captured):
    """Return a press of an indenter, by default the capture's, and a capture that states another pose."""
    design = FingerDesign(indenter=Indenter(**{**STATED, **(rendered or {})}))
    simulated = press().model_copy(update={"design": design})
    capture = capture_of(simulated, 50.0)
    return simulated, capture.model_copy(update={"indenter": IndenterPose(**{**STATED, **captured})})


@pytest.mark.parametrize(
    ("captured", "message"),
    [
        (
            {"shape": "ball", "radius_mm": 4.0},
            r"strip presses a cylinder of radius 10 mm, but capture of the strip presses a ball of radius 4 mm; "
            r"simulate with the capture's indenter\.shape",
        ),
        ({"shape": "mesh"}, "strip presses a cylinder of radius 10 mm, but capture of the strip presses a mesh;"),
        (
            {"radius_mm": 9.0},
            r"a cylinder of radius 9 mm, and the radii may differ by at most 2 %; .* indenter\.radius_mm",
        ),
        (
            {"depth_mm": 4.0},
            r"strip is pressed 1\.5 mm deep but capture of the strip 4 mm, and the depth may differ by at most "
            r"0\.05 mm\. Simulate with the capture's indenter\.depth_mm, or state depth_uncertainty_mm in the capture",
        ),
        ({"depth_mm": 1.8, "depth_uncertainty_mm": 0.09}, r"the depth may differ by at most 0\.27 mm"),
        (
            {"position_mm": 60.0},
            r"strip is pressed 35 mm along the pad but capture of the strip 60 mm, and the position may differ by at "
            r"most 0\.5 mm\. .* indenter\.position_mm, or state position_uncertainty_mm",
        ),
    ],
)
def test_another_indenter_or_push_is_refused_with_both_numbers(captured, message):
    simulated, capture = pair(**captured)
    with pytest.raises(CompareError, match=message):
        compare_press(simulated, capture, seed=1)
    # no finding of the images: what was pressed is known before they are looked at
    with pytest.raises(CompareError, match=message):
        compare_checked(simulated, capture, 1, CheckOptions(despite_mismatch=True))


@pytest.mark.parametrize(
    ("rendered", "captured"),
    [
        ({}, {}),
        ({}, {"radius_mm": 10.2}),
        ({}, {"depth_mm": 1.55, "position_mm": 35.5}),
        ({}, {"depth_mm": 1.8, "depth_uncertainty_mm": 0.1}),
        ({}, {"position_mm": 38.0, "position_uncertainty_mm": 1.0}),
        ({}, {"depth_mm": None, "position_mm": None}),
        # a capture states a radius for every shape; of a cuboid it means nothing
        ({"shape": "cuboid", "size_mm": (5.0, 5.0, 5.0)}, {"shape": "cuboid", "radius_mm": 1.0}),
    ],
    ids=["same", "size", "push", "uncertain depth", "uncertain position", "pose not known", "cuboid"],
)
def test_what_agrees_or_is_not_known_is_compared(rendered, captured):
    require_same_conditions(*pair(rendered, **captured))


def test_without_a_design_nothing_is_known_of_the_renders_indenter():
    simulated, capture = pair(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=60.0)
    require_same_conditions(simulated.model_copy(update={"design": None}), capture)


def test_what_a_classic_sensor_presses_in_is_compared_too():
    """Unless a height map stands in its place, of which no indenter is known."""
    ball = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0)
    sensor = PlainSensor(indenter=ball)
    simulated = press().model_copy(update={"design": None, "sensor": sensor, "light_angle_deg": None})
    assert simulated.indenter == ball
    capture = capture_of(press(), 50.0).model_copy(
        update={"indenter": IndenterPose(shape="ball", radius_mm=3.0, depth_mm=1.0, position_mm=10.0)}
    )
    with pytest.raises(
        CompareError,
        match=r"a ball of radius 4 mm, .* a ball of radius 3 mm, and the radii may differ "
        r"by at most 2 %",
    ):
        require_same_conditions(simulated, capture)
    given = sensor.model_copy(update={"surface": CoatSurface(file="coat.npy", step_mm=0.1)})
    mapped = simulated.model_copy(update={"sensor": given})
    assert mapped.indenter is None
    require_same_conditions(mapped, capture)
