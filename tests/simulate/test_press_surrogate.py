"""A taught surrogate: contact on the condensed finger, what is learned beyond it, bars that hold, and refusals."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_schemas import (
    FingerDesign,
    FingerSurfaces,
    Indenter,
    PressMechanics,
    PressSurrogate,
    SimulateError,
    TaughtPress,
)
from data_schemas.storage import read_record
from sim import read_design
from sim.experiments import (
    SurrogateFinger,
    TrainingSettings,
    candidate_presses,
    press_family,
    press_records,
    train_surrogate,
)
from sim.experiments import _press_surrogate as surrogate
from sim.mechanics import (
    STEPS,
    Condensation,
    CondensedFinger,
    PressSettings,
    condense_finger,
    face_points,
    press_finger,
    rigid_indenter,
)
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._penalty_contact import PenaltyContact, penalty_mpa_per_mm
from sim.surface_meshes import check_no_intersections, restore_shapes
from tests.command_line.running import edit, finray, succeed
from tests.command_line.test_mechanics_verb import BABY

PRESSES = 24


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FingerDesign]:
    """A small finger, meshed half as finely as coarse: what is shown does not hang on it."""
    file = tmp_path_factory.mktemp("surrogate") / "finger.toml"
    file.write_text(BABY + "radius_mm = 10.0\ndepth_mm = 2.0\n")
    with pytest.MonkeyPatch.context() as patched:
        rough = MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0)
        patched.setitem(STEPS, "coarse", rough)
        yield read_design(file)


@pytest.fixture(scope="module")
def condensed(design: FingerDesign) -> Condensation:
    return condense_finger(design)


@pytest.fixture(scope="module")
def finger(design: FingerDesign, condensed: Condensation) -> CondensedFinger:
    return CondensedFinger(design, "coarse", condensed)


def true_press(finger: CondensedFinger, design: FingerDesign, depth_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Return displacement and force of a press whose rest beyond condensation is a smooth law, as symmetric as it."""
    contact = finger.press(rigid_indenter(design), depth_mm)
    at = press_family(design).features(design.indenter.model_copy(update={"depth_mm": depth_mm}))
    z = finger.mesh.nodes_mm[:, 2] / design.pad.length_mm
    bend = 0.02 * depth_mm**2 * math.exp(0.4 * at[0] + 0.1 * at[5] - 0.2 * at[2]) * math.cos(at[1])
    field = np.zeros_like(finger.mesh.nodes_mm)
    field[:, 1] = -bend * np.sin(np.pi * z)
    field[:, 2] = bend * z**2 * (1.0 + 0.3 * at[3] ** 2)
    stiffer = 1.0 + 0.02 * depth_mm * (1.0 + 0.5 * at[0] + 0.3 * at[5] * at[2]) / math.cosh(0.5 * at[1])
    return finger.displacement_mm(contact) + field, contact.force_n * np.array([1.0, stiffer, 1.0])


def by_the_law(finger: CondensedFinger) -> Any:
    """Return what takes the place of finite elements: presses by :func:`true_press`."""

    def press(design: FingerDesign, preset: Any, *_: Any) -> TaughtPress:
        depths = design.indenter.depth_mm * np.arange(1, 5) / 4.0
        found = [true_press(finger, design, float(depth)) for depth in depths]
        return TaughtPress(
            preset=preset,
            design=design,
            depth_mm=depths,
            force_n=np.array([force for _, force in found]),
            displacement_mm=np.array([moved for moved, _ in found], dtype=np.float32),
            sound=4,
            unreached="",
            processor_s=1.0,
        )

    return press


@pytest.fixture(scope="module")
def presses() -> dict[int, TaughtPress]:
    return {}


@pytest.fixture(scope="module")
def taught(
    design: FingerDesign, condensed: Condensation, finger: CondensedFinger, presses: dict[int, TaughtPress]
) -> PressSurrogate:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(surrogate, "condense_finger", lambda *_: condensed)
        patched.setattr(surrogate, "press_to_teach", by_the_law(finger))
        return train_surrogate(design, TrainingSettings(PRESSES), store=presses.__setitem__)


def test_a_small_push_on_the_condensed_finger_is_that_of_finite_elements(
    design: FingerDesign, finger: CondensedFinger
) -> None:
    small = design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": 0.05})})
    pressed = press_finger(small, PressSettings(increments=1, contact="penalty"))
    contact = finger.press(rigid_indenter(small), 0.05)
    # strains of a push of 0.05 mm in a pad of some 4 mm are a per cent, and so is what a linear finger leaves
    assert contact.force_n[1] == pytest.approx(pressed.force_n[-1, 1], rel=0.01)
    moved = pressed.displacement_mm[-1]
    assert np.abs(contact.coat_mm - moved[finger.coat]).max() < 0.01 * np.abs(moved[finger.coat]).max()
    assert np.abs(finger.displacement_mm(contact) - moved).max() < 0.02 * np.abs(moved).max()
    assert ((contact.pressure_mpa > 0.0) == (pressed.pressure_mpa > 0.0)).mean() > 0.99


@pytest.mark.parametrize(
    ("shape", "radius_mm", "per_side"), [("cylinder", 12.0, 2), ("ball", 12.0, 2), ("ball", 1.5, 3)]
)
def test_contact_and_condensed_finger_are_in_balance(
    design: FingerDesign, finger: CondensedFinger, condensed: Condensation, shape: str, radius_mm: float, per_side: int
) -> None:
    changed = {"shape": shape, "radius_mm": radius_mm, "across_mm": 2.0, "rotation_deg": (0.0, 20.0, 0.0)}
    indenter = rigid_indenter(design.model_copy(update={"indenter": design.indenter.model_copy(update=changed)}))
    contact = finger.press(indenter, 2.0)
    moved = condensed.compliance_mm_per_n.astype(float) @ contact.coat_forces_n.ravel()
    np.testing.assert_allclose(contact.coat_mm.ravel(), moved, atol=1e-5 * np.abs(moved).max())
    quads = np.searchsorted(finger.coat, finger.mesh.surfaces["coat"])
    assert indenter.body is not None
    penalty = penalty_mpa_per_mm(design, STEPS["coarse"].pad_mm)
    nodes, points = finger.mesh.nodes_mm[finger.coat], face_points(quads, per_side)
    own = PenaltyContact(nodes, points, indenter.body, indenter.pose(2.0), penalty)
    np.testing.assert_allclose(contact.touch_mm, own.points_mm(np.zeros_like(nodes)))
    off = own.gradient(contact.coat_mm) + contact.coat_forces_n
    # to which the search goes, and as much again for the single precision of the compliance
    assert np.linalg.norm(off) < 1e-3 * np.linalg.norm(contact.coat_forces_n)
    np.testing.assert_allclose(contact.force_n, -contact.coat_forces_n.sum(axis=0), atol=1e-3 * contact.force_n[1])


def test_the_shapes_hold_the_finger_behind_the_coat(condensed: Condensation) -> None:
    compliance = condensed.compliance_mm_per_n.astype(float)
    assert np.abs(compliance - compliance.T).max() == 0.0
    # of forces on single nodes, the sharpest there are: contact spreads them, and leaves less
    assert 0.0 < condensed.far_rest_rel < 0.05


def drawn_presses(design: FingerDesign, count: int) -> list[Indenter]:
    """Return presses of the family at random: both halves, all pushes."""
    family, rng = press_family(design), np.random.default_rng(5)
    ranges = (family.position_mm, family.across_mm, family.radius_mm, family.turn_deg, family.depth_mm)
    found = []
    for row in rng.random((count, len(ranges) + 1)):
        z, x, radius, turn, depth = (low + u * (high - low) for u, (low, high) in zip(row, ranges, strict=False))
        cylinder = row[-1] < 0.5
        found.append(
            Indenter(
                shape="cylinder" if cylinder else "ball",
                radius_mm=radius,
                position_mm=z,
                across_mm=x,
                rotation_deg=(0.0, turn if cylinder else 0.0, 0.0),
                depth_mm=depth,
            )
        )
    return found


def test_bars_hold_the_errors_of_unseen_presses_at_their_level(
    design: FingerDesign, finger: CondensedFinger, taught: PressSurrogate
) -> None:
    opened = SurrogateFinger(taught)
    surface, force, alone, wide = [], [], [], []
    unseen = drawn_presses(design, 100)
    for indenter in unseen:
        answer = opened.press(indenter)
        moved, push = true_press(finger, design.model_copy(update={"indenter": indenter}), indenter.depth_mm)
        off = surrogate.rms_length((answer.displacement_mm - moved)[finger.coat])
        surface.append((off / surrogate.rms_length(moved[finger.coat]), off <= answer.surface_bar_mm))
        wide.append(answer.surface_bar_mm / off)
        miss = abs(answer.force_n[1] - push[1])
        force.append((miss / push[1], miss <= answer.force_bar_n))
        alone.append(
            surrogate.rms_length(answer.contact.coat_mm - moved[finger.coat]) / surrogate.rms_length(moved[finger.coat])
        )
    # 95 %, less three standard deviations of 100 draws
    least = 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / len(unseen))
    for found in (np.array(surface), np.array(force)):
        assert found[:, 1].mean() > least
        assert np.median(found[:, 0]) < 0.02
    assert np.median(np.array(surface)[:, 0]) < 0.2 * np.median(alone)
    # scores of a process have a 95 % quantile of some four times their median; the force's errors are below what a
    # contact is found to, which its bars hold
    assert np.median(wide) < 6.0


def test_presses_left_out_are_those_of_teaching_without_them(
    finger: CondensedFinger, presses: Any, taught: Any
) -> None:
    family, image = taught.family, surrogate.mirror_images(finger.mesh.nodes_mm)
    samples = surrogate.together(
        [surrogate.samples_of(finger, family, image, number, press) for number, press in presses.items()]
    )
    own = samples.press == 3
    process = surrogate.Process(taught.force_kernel, samples.features[~own])
    weights = np.linalg.solve(process.matrix, process.between(samples.features[own]).T)
    miss = np.abs(weights.T @ samples.force_rest_rel[~own, 1] - samples.force_rest_rel[own, 1]) / samples.force_rel[own]
    np.testing.assert_allclose(taught.left_out_force_rel[own], miss, rtol=1e-3, atol=1e-6)


def test_teaching_goes_on_after_the_last_press(
    design: FingerDesign,
    condensed: Condensation,
    finger: CondensedFinger,
    presses: dict[int, TaughtPress],
    taught: PressSurrogate,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(surrogate, "condense_finger", lambda *_: condensed)
    monkeypatch.setattr(surrogate, "press_to_teach", by_the_law(finger))
    kept = {number: press for number, press in presses.items() if number < 22}
    new: dict[int, TaughtPress] = {}
    again = train_surrogate(design, TrainingSettings(PRESSES), stored=kept.get, store=new.__setitem__)
    assert sorted(new) == [22, 23]
    np.testing.assert_array_equal(again.sample_features, taught.sample_features)
    np.testing.assert_allclose(again.amplitudes_rel, taught.amplitudes_rel)
    stiffer = design.model_copy(update={"pad": design.pad.model_copy(update={"length_mm": 50.0})})
    kept[0] = kept[0].model_copy(update={"design": stiffer})
    with pytest.raises(SimulateError, match="press 1 in the folder of presses belongs to another design"):
        train_surrogate(design, TrainingSettings(PRESSES), stored=kept.get)


def test_the_presses_beyond_the_first_are_those_least_known(design: FingerDesign, taught: PressSurrogate) -> None:
    """They are not the next ones of the sequence."""
    family = press_family(design)
    in_order = [family.features(i) for i in candidate_presses(family)[:PRESSES]]
    used = [taught.sample_features[taught.sample_press == number][6] for number in range(PRESSES)]
    np.testing.assert_allclose(used[:12], in_order[:12], atol=1e-12)
    assert np.abs(np.array(used[12:]) - np.array(in_order[12:])).max(axis=1).min() > 0.01


def test_more_candidates_begin_with_the_fewer_and_are_drawn_without_a_warning(design: FingerDesign) -> None:
    """More than 128 presses are chosen from a number that is no power of two, of which the sampler warned."""
    family = press_family(design)
    more = candidate_presses(family, 400)
    assert len(more) == 400
    assert more[:256] == candidate_presses(family)


def test_surfaces_are_those_of_the_records(design: FingerDesign, taught: PressSurrogate) -> None:
    opened = SurrogateFinger(taught, limit_rel=1.0)
    pressed, bars, notes, doubt = opened.press_as_designed(design, 2)
    mechanics, surfaces = press_records(design, pressed, "coarse", taught.label, notes)
    quick = opened.surfaces(opened.press(design.indenter))
    np.testing.assert_allclose(quick.vertices_mm, surfaces.vertices_mm, atol=1e-12)
    np.testing.assert_array_equal(quick.triangles, surfaces.triangles)
    np.testing.assert_allclose(quick.contact_distance, surfaces.contact_distance)
    assert not doubt
    assert bars.presses == PRESSES
    np.testing.assert_allclose(mechanics.depth_mm, [1.0, 2.0])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"shape": "cuboid", "size_mm": (20.0, 10.0, 10.0)}, 'indenter.shape = "cuboid"; it was trained on'),
        ({"friction": 0.2}, "indenter.friction = 0.2; it was trained on presses without friction"),
        ({"radius_mm": 3.0}, "indenter.radius_mm = 3 mm; it was trained on 6 to 20 mm"),
        ({"position_mm": 47.0}, "indenter.position_mm = 47 mm; it was trained on 9.6 to 40.8 mm"),
        ({"depth_mm": 4.5}, "indenter.depth_mm = 4.5 mm; it was trained on 0.5 to 4 mm"),
        ({"rotation_deg": (0.0, 45.0, 0.0)}, r"indenter.rotation_deg\[1\] = 45 deg; it was trained on -30 to 30 deg"),
        ({"rotation_deg": (0.0, 0.0, 5.0)}, "it was trained on cylinders that lie flat"),
    ],
)
def test_a_press_that_was_not_taught_is_refused(
    design: FingerDesign, taught: PressSurrogate, changed: dict[str, Any], said: str
) -> None:
    with pytest.raises(SimulateError, match=said):
        SurrogateFinger(taught).press(design.indenter.model_copy(update=changed))


def test_another_finger_is_refused_and_another_light_is_not(design: FingerDesign, taught: PressSurrogate) -> None:
    opened = SurrogateFinger(taught)
    opened.check_design(design.model_copy(update={"light": design.light.model_copy(update={"angle_deg": 50.0})}))
    softer = design.mechanics.model_copy(update={"gel": design.mechanics.gel.model_copy(update={"c10_mpa": 0.1})})
    with pytest.raises(SimulateError, match="was trained for another design, which differs in mechanics"):
        opened.check_design(design.model_copy(update={"mechanics": softer}))


def test_an_answer_is_doubted_beyond_the_limit_and_where_ribs_cross(
    design: FingerDesign, taught: PressSurrogate
) -> None:
    assert not SurrogateFinger(taught, 1.0).press(design.indenter).doubt
    assert "% allowed)" in SurrogateFinger(taught, 1e-9).press(design.indenter).doubt
    place = taught.family.features(design.indenter)[None]
    crossed = taught.model_copy(update={"crossed_features": place})
    assert "ribs pass through each other" in SurrogateFinger(crossed, 1.0).press(design.indenter).doubt


def test_what_comes_after_ribs_cross_teaches_nothing(finger: CondensedFinger, presses: Any, taught: Any) -> None:
    press = presses[2].model_copy(update={"sound": 2})
    samples = surrogate.samples_of(finger, taught.family, surrogate.mirror_images(finger.mesh.nodes_mm), 0, press)
    assert len(samples) == 4
    assert samples.crossed.shape == (4, 6)


def test_a_condensation_of_another_mesh_is_refused(design: FingerDesign, condensed: Condensation) -> None:
    other = replace(condensed, compliance_mm_per_n=condensed.compliance_mm_per_n[:-3, :-3])
    with pytest.raises(SimulateError, match="belongs to another mesh, because its coat has"):
        CondensedFinger(design, "coarse", other)


def test_too_few_presses_are_refused(design: FingerDesign) -> None:
    with pytest.raises(SimulateError, match="19 presses are too few"):
        train_surrogate(design, TrainingSettings(19))


@pytest.fixture
def command(
    design: FingerDesign,
    condensed: Condensation,
    finger: CondensedFinger,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> str:
    """Teach by the command, with the law in place of finite elements; return what a press by it begins with."""
    monkeypatch.setattr(surrogate, "condense_finger", lambda *_: condensed)
    monkeypatch.setattr(surrogate, "press_to_teach", by_the_law(finger))
    (tmp_path / "finger.toml").write_text(BABY + "radius_mm = 10.0\ndepth_mm = 0.6\n")
    said = succeed(f"simulate teach {tmp_path}/finger.toml --presses 20 --out {tmp_path}/f.surrogate.json")
    assert "surface: with its press left out of the training, half of the samples have an error of up to" in said
    assert "look at" in said
    assert len(list((tmp_path / "f.presses").glob("*.json"))) == 20
    return f"simulate press {tmp_path}/finger.toml --surrogate {tmp_path}/f.surrogate.json --out {tmp_path}"


def test_the_command_answers_by_a_surrogate(command: str, tmp_path: Path) -> None:
    said = succeed(f"{command}/quick.press.json --largest-error 1")
    assert "+-" in said
    assert "computed by a surrogate" in said
    stored = read_record(tmp_path / "quick.mechanics.json", PressMechanics)
    assert stored.surrogate is not None
    assert np.isnan(stored.energy_n_mm).all()
    assert stored.label.startswith("surrogate trained on 20 presses")
    assert not (tmp_path / "quick.increments").exists()
    _, shape = restore_shapes(read_record(tmp_path / "quick.surfaces.json", FingerSurfaces))
    check_no_intersections(shape.gel)


def test_the_command_falls_back_on_finite_elements(command: str, tmp_path: Path) -> None:
    outcome = finray(f"{command}/sure.press.json --largest-error 0.00001 --increments 1")
    assert outcome.status == 0, outcome.err
    assert "the surrogate is not used, because its force may be wrong by" in outcome.err
    stored = read_record(tmp_path / "sure.mechanics.json", PressMechanics)
    assert stored.surrogate is None
    assert stored.label.startswith("finite elements")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("length_mm = 48.0", "length_mm = 50.0", "was trained for another design, which differs in pad"),
        (
            "depth_mm = 0.6",
            "depth_mm = 4.5",
            "does not cover indenter.depth_mm = 4.5 mm; it was trained on 0.5 to 4 mm",
        ),
    ],
)
def test_the_command_refuses_another_finger_and_another_press(
    command: str, tmp_path: Path, old: str, new: str, said: str
) -> None:
    edit(tmp_path / "finger.toml", old, new)
    outcome = finray(f"{command}/no.press.json")
    assert outcome.status == 2
    assert said in outcome.err
    assert not list(tmp_path.glob("no.*"))
