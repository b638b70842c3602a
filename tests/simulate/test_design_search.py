"""Searching a finger's numbers: parameters and limits, what is kept, and going on after a kill."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import EvaluatedDesign, FingerDesign, LightPanel, SimulateError, provenance
from sim import preset_design
from sim.experiments import (
    OBJECTIVES,
    DesignEvaluations,
    DesignSpace,
    default_parameters,
    design_parameter,
    search_designs,
)
from sim.experiments._light_angle import in_the_way, panel_surface, panels_in_the_way
from sim.surface_meshes import Surface, check_no_intersections, rest_shape
from tests.command_line.running import load, succeed

FLAT = preset_design("flat-70x35")
ERROR = OBJECTIVES["normal-error"]


def space(*fields: str, design: FingerDesign = FLAT) -> DesignSpace:
    return DesignSpace(design, tuple(design_parameter(design, one) for one in fields))


def evaluated(design: FingerDesign) -> EvaluatedDesign:
    """Return a made-up error that is least at 47 deg and -11 mm; with the panel far below the pad nothing is seen."""
    y, z = design.light.position_mm[1:]
    error = 5.0 + ((design.light.angle_deg - 47.0) / 20.0) ** 2 + (y + 11.0) ** 2 / 4.0
    failure = "the camera sees too little of the pad" if z < -3.0 else ""
    return EvaluatedDesign(
        key="made up",
        design=design,
        values={} if failure else {"normal-error": error},
        failure=failure,
        processor_s=1.0,
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("light.angel_deg=0:60", "'light.angel_deg' is not a field of a design; 'finray design init' writes a file"),
        ("angle", "'angle' is not a field of a design, such as light.angle_deg"),
        ("light.angle_deg=0-60", "must be FIELD=LOW:HIGH, such as light.angle_deg=0:60"),
        ("light.angle_deg=60:0", "must be two finite numbers LOW:HIGH with LOW below HIGH"),
        ("light.angle_deg=0:nan", "must be two finite numbers"),
        ("light.angle_deg=40:60", "light.angle_deg must include the design's own value of 30"),
        ("light.angle_deg=0:300", "light.angle_deg = 300 is not possible"),
        ("light.position_mm=-14:-7", "for a place, name its coordinate, as in light.position_mm[y]"),
        ("camera.position_mm[y]=-14:-7", "write it into the design file first"),
        (
            "light.angle_deg[y]=0:60",
            "'light.angle_deg' of this finger is 30.0, which has no coordinates; leave out [y]",
        ),
        ("pad.shape=0:1", "is 'flat', which is not a number"),
        ("light.power_rel", "has no effect, because the power of all panels together is kept and this finger has one"),
        ("coating.diffuse_share", "has no default limits; give them as coating.diffuse_share=LOW:HIGH"),
    ],
)
def test_a_parameter_that_cannot_be_varied_is_refused(text: str, told: str) -> None:
    with pytest.raises(SimulateError) as refused:
        design_parameter(FLAT, text)
    assert told in str(refused.value)


def test_usual_parameters_go_with_what_is_asked_for() -> None:
    of_light = [one.field for one in default_parameters(FLAT, [ERROR])]
    assert of_light == ["light.angle_deg", "light.position_mm[y]", "light.position_mm[z]", "pad.thickness_mm"]
    of_loads = [one.field for one in default_parameters(FLAT, [OBJECTIVES["softness"]])]
    assert "skeleton.rib_thickness_mm" in of_loads
    assert "light.angle_deg" not in of_loads
    for one in default_parameters(FLAT, [ERROR, OBJECTIVES["softness"]]):
        assert one.low <= one.start <= one.high


def test_a_whole_number_stays_within_its_limits() -> None:
    start = FLAT.skeleton.rib_count
    varied = space(f"skeleton.rib_count={start - 1.6}:{start + 1.2}")
    ends = [varied.changes(np.array([at]))["skeleton.rib_count"] for at in (0.0, 1.0)]
    assert ends == [start - 1, start + 1]
    assert varied.snapped(np.array([0.1])).tolist() == [0.0]
    with pytest.raises(SimulateError, match="no two whole numbers"):
        design_parameter(FLAT, f"skeleton.rib_count={start - 0.6}:{start + 0.6}")


def test_a_place_is_a_design_and_back() -> None:
    varied = space("light.angle_deg=0:60", "light.position_mm[y]=-14:-8", "skeleton.rib_count=3:9")
    place = varied.snapped(np.array([0.5, 0.25, 0.43]))
    design = varied.design_at(place)
    assert design.light.angle_deg == pytest.approx(30.0)
    assert design.light.position_mm == pytest.approx((0.0, -12.5, -1.0))
    assert design.skeleton.rib_count == 6
    np.testing.assert_allclose(varied.place(design), place)
    # what was measured of the start is not of another design
    measured = FLAT.model_copy(update={"origin": {**FLAT.origin, "light.angle_deg": "measured"}})
    changed = space("light.angle_deg=0:60", design=measured).design_at(np.array([0.1]))
    assert "light.angle_deg" not in changed.origin
    assert "pad.length_mm" in changed.origin


def test_panels_share_the_power_of_the_start() -> None:
    two = preset_design("flat-70x35-two-lights")
    third = LightPanel(angle_deg=150.0, position_mm=(5.0, -6.0, 71.0))
    three = two.model_copy(update={"further_lights": (third,)})
    varied = space("second_light.power_rel=0.25:4", design=three)
    for at in (0.0, 0.7, 1.0):
        design = varied.design_at(np.array([at]))
        assert sum(panel.power_rel for panel in design.lights) == pytest.approx(3.0)
        assert design.second_light is not None
        assert design.second_light.power_rel / design.light.power_rel == pytest.approx(0.25 + at * 3.75)


def test_a_panel_that_passes_through_the_mirror_is_not_possible() -> None:
    varied = space("light.position_mm[y]=-60:-8")
    assert varied.is_possible(varied.place(FLAT))
    mirror_in_the_way = [varied.is_possible(np.array([at])) for at in np.linspace(0.0, 1.0, 9)]
    assert not all(mirror_in_the_way)


def test_the_search_finds_the_optimum_and_leaves_failures_alone() -> None:
    varied = space("light.angle_deg=0:75", "light.position_mm[y]=-14:-8", "light.position_mm[z]=-4:1")
    found = search_designs(varied, [ERROR], evaluated, 40, seed=2)
    best = found.evaluated[-1]
    assert best.values["normal-error"] < 1.02 * 5.0
    assert found.roles[0] == "start"
    assert found.roles[-1] == "chosen"
    screen = [one for one, role in zip(found.evaluated, found.roles, strict=True) if role == "screen"]
    proposed = [one for one, role in zip(found.evaluated, found.roles, strict=True) if role == "search"]
    failed = sum(bool(one.failure) for one in screen)
    assert failed > 0
    # a fifth of the limits fails: proposals know where
    assert sum(bool(one.failure) for one in proposed) < failed
    # the same seed, the same search
    again = search_designs(varied, [ERROR], evaluated, 40, seed=2)
    np.testing.assert_array_equal(again.places, found.places)


def test_too_few_evaluations_are_refused() -> None:
    with pytest.raises(SimulateError, match="12 are too few for 2 parameters; give at least 13"):
        search_designs(space("light.angle_deg", "pad.thickness_mm"), [ERROR], evaluated, 12, seed=1)


def test_the_screen_may_be_given_its_size() -> None:
    varied = space("light.angle_deg=0:75", "light.position_mm[y]=-14:-8")
    found = search_designs(varied, [ERROR], evaluated, 30, seed=3, screened=24)
    assert [found.roles.count(role) for role in ("start", "screen", "search", "chosen")] == [1, 24, 4, 1]
    for screened in (8, 29):
        with pytest.raises(
            SimulateError,
            match=f"--screen: must be from 9 to 28 with 30 evaluations and 2 parameters, got {screened}",
        ):
            search_designs(varied, [ERROR], evaluated, 30, seed=3, screened=screened)


def test_a_panel_is_tried_with_near_triangles_and_the_answer_is_that_of_all() -> None:
    """Panels all about the finger: what each passes through, by all triangles of each surface."""
    rest, rng = rest_shape(FLAT), np.random.default_rng(1)
    blocked = []
    for _ in range(16):
        place = (rng.uniform(-20.0, 20.0), rng.uniform(-30.0, 8.0), rng.uniform(-10.0, 80.0))
        panel = FLAT.light.model_copy(update={"angle_deg": rng.uniform(-60.0, 180.0), "position_mm": place})
        sheet = {"light panel": panel_surface(panel)}
        met = [name for name, surface in rest.surfaces.items() if is_crossed({**sheet, name: surface})]
        assert in_the_way(panel, rest) == (met[0] if met else "")
        blocked += met[:1]
    assert 4 <= len(blocked) <= 12
    assert len(set(blocked)) >= 2


def test_every_panel_is_tried_against_the_parts() -> None:
    """A second panel that stands through the mirror, beside a first one that fits."""
    behind = FLAT.light.model_copy(update={"angle_deg": 150.0, "position_mm": (0.0, -10.0, 50.0)})
    rest = rest_shape(FLAT)
    assert [in_the_way(panel, rest) for panel in (FLAT.light, behind)] == ["", "mirror"]
    for blocked in ({"second_light": behind}, {"further_lights": (FLAT.light, behind)}):
        assert panels_in_the_way(FLAT.model_copy(update=blocked), rest) == "mirror"


def is_crossed(surfaces: dict[str, Surface]) -> bool:
    """Return whether surfaces pass through each other."""
    try:
        check_no_intersections(surfaces)
    except SimulateError:
        return True
    return False


def test_a_start_that_fails_ends_the_search() -> None:
    def failing(design: FingerDesign) -> EvaluatedDesign:
        return EvaluatedDesign(key="", design=design, values={}, failure="the coat is black", processor_s=0.0)

    with pytest.raises(SimulateError, match="the unchanged design cannot be evaluated: the coat is black"):
        search_designs(space("light.angle_deg"), [ERROR], failing, 20, seed=1)


def test_a_search_that_was_killed_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations before the kill are read again, the others computed, and the search is that of one go."""
    computed = 0

    def numbers(self: DesignEvaluations, design: FingerDesign, again: int) -> dict[str, float]:
        nonlocal computed
        computed += 1
        if computed == killed_at:
            raise KeyboardInterrupt
        return evaluated(design).values

    monkeypatch.setattr(DesignEvaluations, "_values", numbers)
    varied, origin = space("light.angle_deg=0:75"), provenance("finray design optimise", {}, 2)

    def run(folder: Path) -> tuple[DesignEvaluations, np.ndarray]:
        evaluations = DesignEvaluations(folder, [ERROR], origin, None)
        return evaluations, search_designs(varied, [ERROR], evaluations.evaluate, 16, seed=2).places

    killed_at = 11
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "killed")
    assert len(list((tmp_path / "killed").glob("*.json"))) == 10
    killed_at = -1
    evaluations, places = run(tmp_path / "killed")
    whole, expected = run(tmp_path / "whole")
    np.testing.assert_array_equal(places, expected)
    assert evaluations.computed == whole.computed - 10
    # a longer search begins with what there is
    longer = DesignEvaluations(tmp_path / "whole", [ERROR], origin, None)
    search_designs(varied, [ERROR], longer.evaluate, 20, seed=2)
    assert longer.computed < 20


@pytest.mark.renderer
def test_another_content_of_a_file_of_the_camera_is_another_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``finray design optimise`` again in the same folder, after the curves in the file were replaced."""
    monkeypatch.setattr(DesignEvaluations, "_values", lambda self, design, again: {"brightness": 1.0})
    (tmp_path / "finger.toml").write_text('preset = "flat-70x35"\n[camera]\nresponse = "camera.csv"\n')
    words = f"design optimise {tmp_path}/finger.toml --for brightness --within light.angle_deg=0:60 --evaluations 10"
    said = []
    for green in (1.0, 1.0, 0.5):
        rows = [f"{nm},{50.0 - 0.1 * abs(nm - 600)},{green * 40.0},30.0" for nm in range(380, 1001, 5)]
        curves = "\n".join(["wavelength_nm,red_percent,green_percent,blue_percent", *rows])
        (tmp_path / "camera.csv").write_text(curves)
        said.append(succeed(f"{words} --confirm 0 --out {tmp_path}/found"))
    assert ["0 computed now" in text for text in said] == [False, True, False]
    inputs = load(tmp_path / "found" / "optimum.json")["record"]["provenance"]["input_sha256"]
    assert f"{tmp_path}/camera.csv" in inputs


def test_failures_are_kept_with_their_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(self: DesignEvaluations, design: FingerDesign, again: int) -> dict[str, float]:
        raise SimulateError("the camera sees too little of the pad")

    monkeypatch.setattr(DesignEvaluations, "_values", failing)
    evaluations = DesignEvaluations(tmp_path, [ERROR], provenance("finray", {}, 1), None)
    assert evaluations.evaluate(FLAT).failure == "the camera sees too little of the pad"
    assert evaluations.evaluate(FLAT).failure == "the camera sees too little of the pad"
    assert evaluations.computed == 1
