"""A model of a gel that presses teach, on a made-up sensor: Hertz's surface under lights, with no code of the model."""

import numpy as np
import pytest

from data_schemas import ContactCircle, IndenterPose, SimulateError, TactileCapture
from sim.experiments import fit_gel, predict_on_gel
from sim.experiments._taught_gel import _Lights

RADIUS_MM, MM_PER_PX, SHAPE = 6.0, 0.1, (120, 160)
EXPONENT, DIRECTIONS_DEG, LEVEL = 0.45, (-160.0, -30.0, 85.0), 55.0
WEIGHTS = np.array([[1.0, 0.1, 0.05], [0.2, 1.0, 0.1], [0.05, 0.15, 1.0]])


def hertz_sunk_mm(away_mm, half_width_mm):
    """Sunk face of a half-space under a ball, in closed form (Johnson, Contact Mechanics, 3.42)."""
    s = np.minimum(half_width_mm / np.maximum(away_mm, 1e-9), 1.0)
    inside = (2.0 * half_width_mm**2 - away_mm**2) / (2.0 * RADIUS_MM)
    outside = half_width_mm**2 / (np.pi * RADIUS_MM) * ((2.0 - 1.0 / s**2) * np.arcsin(s) + np.sqrt(1.0 / s**2 - 1.0))
    return np.where(away_mm <= half_width_mm, inside, outside)


def channels(row_px, column_px, half_width_mm, height_mm=12.0, half_length_mm=0.0):
    """Light of three channels, (H, W, 3), from lights 20 mm beside the picture's middle, below the coat.

    Strips of light are many points in a row, across the direction to the middle.
    """
    rows, columns = np.indices(SHAPE)
    away = np.hypot(rows - row_px, columns - column_px) * MM_PER_PX
    sunk = hertz_sunk_mm(away, half_width_mm) if half_width_mm else np.zeros(SHAPE)
    down, along = np.gradient(sunk, MM_PER_PX)
    x, y = ((at - (size - 1) / 2.0) * MM_PER_PX for at, size in ((columns, SHAPE[1]), (rows, SHAPE[0])))
    lights = []
    places = np.linspace(-half_length_mm, half_length_mm, 41 if half_length_mm else 1)
    for direction in np.radians(DIRECTIONS_DEG):
        points = []
        for place in places:
            to = (
                20.0 * np.cos(direction) - place * np.sin(direction) - x,
                20.0 * np.sin(direction) + place * np.cos(direction) - y,
                height_mm - sunk,
            )
            cosine = (to[2] - along * to[0] - down * to[1]) / np.sqrt(1.0 + along**2 + down**2)
            points.append(np.maximum(cosine, 0.0) / (to[0] ** 2 + to[1] ** 2 + to[2] ** 2) ** 1.5)
        lights.append(np.mean(points, axis=0))
    return (np.stack(lights, axis=-1) * 5000.0) @ WEIGHTS.T + 0.3


def capture(number, widths_mm=(1.0, 1.6), **lights):
    """One press in 8 bits with noise and another gain than its no-contact image."""
    rng = np.random.default_rng(number)
    row, column, half_width = rng.uniform(45, 75), rng.uniform(60, 100), rng.uniform(*widths_mm)
    images = []
    for width, gain in ((half_width, 1.0 + 0.03 * rng.standard_normal(3)), (0.0, np.ones(3)), (0.0, np.ones(3))):
        dn = LEVEL * channels(row, column, width, **lights) ** EXPONENT * gain + rng.standard_normal((*SHAPE, 3))
        images.append(np.rint(dn).clip(0, 255).astype(np.uint8))
    return TactileCapture(
        name=f"press {number}", contact=images[0], no_contact=images[1], repeat_no_contact=images[2], layout="RGB",
        encoding="unknown", bit_depth=8, black_level_dn=0.0, exposure_s=0.02, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=RADIUS_MM, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=row, column_px=column, radius_px=half_width / MM_PER_PX),
        mm_per_px=MM_PER_PX, source="made up",
    )  # fmt: skip


@pytest.fixture(scope="module")
def gel():
    return fit_gel([capture(number) for number in range(6)])


def test_it_finds_the_sensor_that_was_hidden(gel):
    """The truth lies in all ten intervals, and they say something: the touches change the picture by a tenth."""
    found = {number.name: number for number in gel.numbers}
    for channel, wanted in zip(("red", "green", "blue"), DIRECTIONS_DEG, strict=True):
        direction = found[f"direction of the {channel} light"]
        turned = (direction.value - wanted + 180.0) % 360.0 - 180.0
        assert direction.low95 - direction.value < -turned < direction.high95 - direction.value
        assert direction.high95 - direction.low95 < 40.0
        distance = found[f"distance of the {channel} light from the middle of the picture"]
        assert distance.low95 < 20.0 < distance.high95
        height = found[f"height of the {channel} light below the coat"]
        assert height.low95 < 12.0 < height.high95
    exponent = found["exponent of the tone curve"]
    assert exponent.low95 < EXPONENT < exponent.high95
    assert exponent.high95 / exponent.low95 < 2.5  # 3.2 by the prior alone
    # a half-space is found as a layer three contacts thick, which a ball enters less deep: not within their intervals
    assert found["thickness of the gel"].high95 > 6.0
    assert found["depth / that of the labelled cap, at a middle circle"].value == pytest.approx(2.0, rel=0.15)
    power = found["power of the circle's radius that the depth grows with"]
    assert power.low95 < 2.0 < power.high95
    assert power.high95 - power.low95 < 2.0
    # points of light are strips of no length and no softness
    assert found["softness of the lights, as a sine"].low95 < 0.1


def lost_by(gel, numbers, widths_mm=(1.0, 1.6), **lights):
    """Share of the change by contact that predictions of other presses lose; camera noise and gain are not judged."""
    lost = []
    for number in numbers:
        press = predict_on_gel(gel, judged := capture(number, widths_mm, **lights))
        circle, rest = judged.contact_circle, channels(0.0, 0.0, 0.0, **lights) ** EXPONENT
        half_width = circle.radius_px * MM_PER_PX
        pressed = channels(circle.row_px, circle.column_px, half_width, **lights) ** EXPONENT
        change = (pressed / rest - 1.0)[press.distance < 2.0]
        told = (press.contact / press.no_contact - 1.0)[press.distance < 2.0]
        lost.append(((told - change) ** 2).sum() / (change**2).sum())
    return lost


def test_it_predicts_presses_that_did_not_teach(gel):
    lost = lost_by(gel, range(20, 28))
    # the rim is found to half a step of a grid of a twelfth of the contact's radius
    assert np.median(lost) < 0.02
    assert max(lost) < 0.05


#: Low strips, as long as the pad, and deep presses: one side of the contact lies in the shade of its own slope.
STRIPS = {"widths_mm": (2.4, 3.2), "height_mm": 5.0, "half_length_mm": 16.0}


def test_strips_of_light_are_told_from_points():
    gel = fit_gel([capture(number, **STRIPS) for number in range(3)])
    length = next(number for number in gel.numbers if number.name == "half-length of the lights / their distance")
    assert length.low95 < 16.0 / 20.0 < length.high95
    # a model of points of light loses 0.013 to 0.018
    assert max(lost_by(gel, (20, 21, 22), **STRIPS)) < 0.01


@pytest.mark.parametrize("half_length", [0.3, 1.5, 4.0, 8.0])
def test_a_strip_of_any_length_gives_the_light_of_its_integral(half_length):
    """The integral of the cosine over the square along a straight strip, in closed form."""
    away, height, x, y, slope = 1.6, 0.9, np.array([0.0, 0.8, -0.8]), np.array([0.0, 0.5, -0.5]), -0.2
    half = half_length * away
    lights = _Lights(
        np.zeros(1), np.array([away]), np.array([height]), np.eye(1), np.zeros(1), 1.0, 1.0, 1.0,
        np.array([half]), 1e-3, np.zeros(2), 2.0, 0.3,
    )  # fmt: skip
    square = (away - x) ** 2 + height**2
    part = (half - y) / np.hypot(half - y, np.sqrt(square)) + (half + y) / np.hypot(half + y, np.sqrt(square))
    expected = (height - slope * (away - x)) / np.hypot(1.0, slope) * part / (2.0 * half * square)
    found = lights._light((x, y), (slope, 0.0), 0.0)[:, 0]  # noqa: SLF001
    # the light of the middle of the picture is divided by: a factor on all places alike shows nowhere
    assert found / found[0] == pytest.approx(expected / expected[0], rel=0.01)


def test_what_taught_is_not_predicted(gel):
    with pytest.raises(SimulateError, match=r"press 3: the model was trained on this contact image"):
        predict_on_gel(gel, capture(3).model_copy(update={"name": "press 3"}))


def test_refusals():
    presses = [capture(number) for number in range(3)]
    with pytest.raises(SimulateError, match="2 training presses, but the model of an elastic gel needs at least 3"):
        fit_gel(presses[:2])
    for change in (
        {"contact_circle": None}, {"mm_per_px": None},
        {"indenter": IndenterPose(shape="cuboid", radius_mm=None, depth_mm=0.5, position_mm=None)},
    ):  # fmt: skip
        with pytest.raises(SimulateError, match="needs the circle of a ball's contact, the ball's radius"):
            fit_gel([*presses[:2], presses[2].model_copy(update=change)])
    with pytest.raises(
        SimulateError, match="press 2: the ball, the scale or the size of the picture differs from press 0"
    ):
        fit_gel([*presses[:2], presses[2].model_copy(update={"mm_per_px": 0.2})])
    with pytest.raises(SimulateError, match="press 1: the same contact image is given twice"):
        fit_gel([*presses[:2], presses[1]])
    with pytest.raises(SimulateError, match="press 0: the same contact image is given twice"):
        fit_gel([presses[0], *presses])
    away = ContactCircle(row_px=900.0, column_px=900.0, radius_px=10.0)
    wide = ContactCircle(row_px=60.0, column_px=80.0, radius_px=70.0)
    dark = np.array(presses[2].no_contact)
    dark[..., 2] = 0
    for change, message in (
        ({"contact_circle": away}, "press 2: the contact circle lies outside the picture"),
        ({"contact_circle": wide}, "press 2: the contact circle of 7 mm radius is larger than the ball of 6 mm"),
        ({"no_contact": dark}, "press 2: near the contact 100 % of the blue values are clipped, or dark"),
    ):
        with pytest.raises(SimulateError, match=message):
            fit_gel([*presses[:2], presses[2].model_copy(update=change)])


def test_a_press_of_another_ball_is_not_predicted(gel):
    other = capture(40).model_copy(update={"mm_per_px": 0.05})
    with pytest.raises(
        SimulateError, match="press 40: the ball or the scale differs from the model's training presses"
    ):
        predict_on_gel(gel, other)
