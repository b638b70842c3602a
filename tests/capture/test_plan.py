from itertools import pairwise

import pytest

from data_schemas.capture import PaintPlan, RegionOfInterest
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile
from rigs.capture.plan import paint_steps


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
        ({"excitation_filter": "500"}, r"filter '500' passes 495 to 505 nm and blocks the laser at 450 nm"),
        (
            {"region": RegionOfInterest(row_px=0, column_px=0, height_px=0, width_px=10)},
            r"region\.height_px: 0 px is empty; 2 to 128 px are allowed",
        ),
        (
            {"region": RegionOfInterest(row_px=0, column_px=150, height_px=10, width_px=20)},
            r"column_px = 150 with width_px = 20 ends at pixel 170, .* at most 160 px",
        ),
    ],
)
def test_plan_that_does_not_fit_the_rig_is_refused(
    plan: PaintPlan, rig: RigFile, fields: dict[str, object], message: str
) -> None:
    with pytest.raises(CaptureError, match=message):
        paint_steps(changed(plan, **fields), rig)
