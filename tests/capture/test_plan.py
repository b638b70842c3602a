from itertools import pairwise

import pytest
from pydantic import ValidationError

from data_schemas import CaptureError, PaintPlan, RegionOfInterest, RigFile
from rigs.capture import paint_steps
from rigs.capture._plan import metering_room_dn, with_repeat


def changed(plan: PaintPlan, **fields: object) -> PaintPlan:
    return plan.model_copy(update=fields)


def test_steps_cover_every_light_target_and_filter(plan: PaintPlan, rig: RigFile) -> None:
    steps = paint_steps(plan, rig)
    names = [f.name for f in rig.filter_wheel.filters]
    by_type = {kind: [s.filter_name for s in steps if s.frame_type == kind] for kind in {s.frame_type for s in steps}}
    assert by_type == {
        "white": names,
        "laser white": ["450"],
        "room light": [None],
        "reflectance": names,
        "fluorescence": names,
    }
    assert [s.slot for s in steps if s.frame_type == "reflectance"] == list(range(1, 9))
    swaps = sum(a.target != b.target for a, b in pairwise(steps))
    assert swaps == 2
    assert steps[0].target != "sample beside ColorChecker"
    assert steps[-1].target != "sample beside ColorChecker"
    assert steps[8].label == "laser white (white, laser) through filter 450"
    assert steps[9].label == "room light (sample beside ColorChecker, room) without filter"


def test_named_filters_are_captured_in_the_order_of_the_plan(plan: PaintPlan, rig: RigFile) -> None:
    steps = paint_steps(changed(plan, filters=("600", "450")), rig)
    assert [s.filter_name for s in steps if s.frame_type == "white"] == ["600", "450"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"filters": ("450", "451")}, r"no filter '451'; its filters are 405, 450, 500, 532"),
        ({"filters": ()}, r"plan\.filters: is empty"),
        ({"filters": ("500", "600")}, r"excitation_filter: '450' is not among the filters of the plan \(500, 600\)"),
        ({"excitation_filter": "500"}, r"filter '500' passes 495 to 505 nm, so it blocks the laser at 450 nm"),
        (
            {"region": RegionOfInterest(row_px=0, column_px=0, height_px=0, width_px=10)},
            r"region\.height_px: 0 px is too small; 2 to 128 px are allowed",
        ),
        (
            {"region": RegionOfInterest(row_px=0, column_px=150, height_px=10, width_px=20)},
            r"column_px = 150 with width_px = 20 ends at pixel 170, .* at most 160 px",
        ),
        (
            {"second_tilt_deg": 30.0, "second_tilt_filters": ("450", "451")},
            r"second_tilt_filters: '451' is not among the filters of the plan \(405, 450, 500",
        ),
    ],
)
def test_plan_that_does_not_fit_the_rig_is_refused(
    plan: PaintPlan, rig: RigFile, fields: dict[str, object], message: str
) -> None:
    with pytest.raises(CaptureError, match=message):
        paint_steps(changed(plan, **fields), rig)


@pytest.mark.parametrize("black_level_dn", [0.7 * 1023, 720.0])
def test_a_black_level_that_leaves_no_room_for_metering_is_refused(
    plan: PaintPlan, rig: RigFile, black_level_dn: float
) -> None:
    """At the target itself too, where no light is left to meter; just below it there is some."""
    camera = rig.camera.model_copy(update={"black_level_dn": black_level_dn, "bit_depth": 10})
    with pytest.raises(
        CaptureError, match=r"black_level_dn = 7\d\d?.* DN must be below target_fraction = 0\.7 of full"
    ):
        paint_steps(changed(plan, target_fraction=0.7), rig.model_copy(update={"camera": camera}))
    below = camera.model_copy(update={"black_level_dn": 700.0})
    assert paint_steps(changed(plan, target_fraction=0.7), rig.model_copy(update={"camera": below}))
    assert metering_room_dn(0.7, 1023, 700.0) == pytest.approx(16.1)


def test_tilted_steps_come_last_and_say_their_tilt(plan: PaintPlan, rig: RigFile) -> None:
    steps = paint_steps(changed(plan, second_tilt_deg=25.0, second_tilt_filters=("600", "450")), rig)
    assert [(s.frame_type, s.filter_name, s.tilt_deg) for s in steps[-2:]] == [
        ("tilted fluorescence", "600", 25.0),
        ("tilted fluorescence", "450", 25.0),
    ]
    assert steps[-1].label == "tilted fluorescence (sample tilted by 25 deg, laser) through filter 450"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"second_tilt_deg": 30.0}, "must be given together"),
        ({"second_tilt_filters": ("450", "600")}, "must be given together"),
        ({"second_tilt_deg": 30.0, "second_tilt_filters": ("450", "450")}, "second_tilt_filters: '450' is named twice"),
        ({"second_tilt_deg": 80.0, "second_tilt_filters": ("450", "600")}, "less than or equal to 75"),
    ],
)
def test_half_a_tilt_is_refused(plan: PaintPlan, fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PaintPlan.model_validate(plan.model_dump() | fields)


def test_brightest_emission_is_repeated_and_the_laser_filter_never(plan: PaintPlan, rig: RigFile) -> None:
    steps = paint_steps(changed(plan, filters=("450", "600", "630")), rig)
    exposures_s = {s: {"450": 0.001, "600": 0.02, "630": 0.01}.get(str(s.filter_name), 1.0) for s in steps}
    ordered = with_repeat(steps, "450", exposures_s)
    laser = [(s.frame_type, s.filter_name) for s in ordered if s.light == "laser" and s.target == "sample"]
    assert laser == [
        ("fluorescence", "630"),
        ("fluorescence", "450"),
        ("fluorescence", "600"),
        ("fluorescence repeat", "630"),
    ]
    assert len(ordered) == len(steps) + 1
