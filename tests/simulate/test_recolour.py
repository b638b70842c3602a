"""A recoloured press against a new render with the same random numbers, and what needs a new render."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import CompareError, FingerDesign, KnownInputs, SimulatedPress, SimulateError, provenance
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import assumed_camera_response, read_record, write_record
from finray_calib.cli import main
from finray_calib.compare import compare_press
from finray_calib.compare._prepared_images import prepare_images
from finray_calib.compare._region_sums import render_layers
from sim.experiments import FingerScene, PaintedFinger, Rendering, recoloured, simulate_press, simulated_capture
from sim.experiments import _painted_finger as painted_finger
from sim.experiments._rendered_press import light_record
from sim.optics import BAKE_SAMPLES, PaintOptics, camera_matrix, paint_bands

DESIGN = FingerDesign(camera=TactileCamera(width_px=96, height_px=72))
NO_SHA: dict[str, str] = {}
# sums of float32 samples in another order
FLOAT32 = 2e-4
CHAINS = ("led>red", "led>green", "led", "led>green>red")


@pytest.fixture
def exciting(paints) -> dict[str, PaintOptics]:
    """Paints of which green emission excites the red one."""
    w = paints["red"].wavelength_nm
    absorption = {name: np.exp(-0.5 * ((w - at) / 45.0) ** 2) for name, at in (("red", 500.0), ("green", 450.0))}
    return {name: replace(paint, absorption_rel=absorption[name]) for name, paint in paints.items()}


def other(paints, yield_rel=1.15, narrower=False, shift_nm=0.0, lighter=0.0):
    """Return the paints with another yield, emission shape, absorption or reflectance of the red one."""
    red = paints["red"]
    w = red.wavelength_nm
    emission = yield_rel * np.interp(w - shift_nm, w, red.emission_per_nm)
    if narrower:
        emission *= np.exp(-0.5 * ((w - 612.0) / 60.0) ** 2)
    return {
        **paints,
        "red": replace(red, emission_per_nm=emission, reflectance=np.minimum(red.reflectance + lighter, 1.0)),
    }


def press(paints, renderer=None, **changed):
    """Return a press of random chain images."""
    rng = np.random.default_rng(3)
    chains = [rng.random((36, 48, 4)).astype(np.float32) for _ in range(2)]
    bands = [np.stack([c[..., 0] + c[..., 3], c[..., 1], c[..., 2]], axis=-1) for c in chains]
    response, light = assumed_camera_response(), paint_bands(paints["red"], paints["green"], DESIGN.light)
    curves = np.array([curve(painted_finger.RESPONSE_NM) for curve in response])
    matrix = camera_matrix(curves, painted_finger.RESPONSE_NM, light)
    values = {
        "name": "press", "label": "rendered, level b, test", "method": "rendered", "encoding": "linear",
        "no_contact": bands[0] @ matrix.T, "contact": bands[1] @ matrix.T, "distance": np.ones((36, 48)),
        "variance": None, "no_contact_bands": bands[0], "contact_bands": bands[1],
        "contact_bands_variance": np.full((36, 48, 3), 1e-4), "bands": ("red", "green", "led"),
        "no_contact_chains": chains[0], "contact_chains": chains[1], "chains": CHAINS,
        "rendered_light": light_record(light, response), "camera_matrix": matrix, "light_angle_deg": 30.0,
        "design": DESIGN, "paints": {"red": "a" * 64, "green": "b" * 64}, "notes": ("shape of the finger: flat",),
    }  # fmt: skip
    return SimulatedPress(**{**values, **changed})


def rendered(paints, renderer, samples):
    scene = FingerScene(PaintedFinger(DESIGN, paints, assumed_camera_response(), renderer))
    return simulate_press(scene, Rendering("b", 4, samples), NO_SHA)


@pytest.mark.renderer
def test_recoloured_is_a_new_render_with_the_same_seed(llvm, exciting, monkeypatch):
    monkeypatch.setitem(BAKE_SAMPLES, False, 10_000)
    # another yield changes all chains through red paint; half the absorption width those excited by green light
    changed = other(exciting, narrower=True)
    changed["red"] = replace(changed["red"], absorption_rel=changed["red"].absorption_rel ** 1.5)
    new, old = (rendered(p, llvm, 4) for p in (changed, exciting))
    assert "led>green>red" in old.chains
    made = recoloured(old, changed)
    for name in ("no_contact", "contact", "contact_bands"):
        there, here = getattr(new, name), getattr(made, name)
        # the mean reflectance of the red paint over the narrower band has changed, by this much of all light at most
        np.testing.assert_allclose(here.mean(axis=(0, 1)), there.mean(axis=(0, 1)), rtol=4e-3)
        # a few paths end by chance elsewhere
        assert np.mean(np.abs(here - there) > 4e-3 * there + 1e-9) < 0.03
    assert made.contact_bands[..., 0].mean() != pytest.approx(old.contact_bands[..., 0].mean(), rel=0.02)
    np.testing.assert_allclose(made.camera_matrix, new.camera_matrix, rtol=1e-12)
    # a seventh of the red light comes by green, whose chain has grown otherwise than the first
    assert made.variance[..., 0].mean() == pytest.approx(new.variance[..., 0].mean(), rel=0.2)


@pytest.mark.renderer
def test_a_yield_alone_is_exact(llvm, paints, monkeypatch):
    monkeypatch.setitem(BAKE_SAMPLES, False, 10_000)
    # no paint excites paint, so no chain stands at the edge of being left out
    brighter = other(paints, yield_rel=1.3)
    new, old = (rendered(p, llvm, 2) for p in (brighter, paints))
    made = recoloured(old, brighter)
    for name in ("no_contact", "contact"):
        same_but_for_few_paths(getattr(made, name), getattr(new, name))
    same_but_for_few_paths(made.variance, new.variance, of_mean=0.05)  # a bright path alone is a part of it
    # what a comparison takes of a press: layers, their noise, and the matrix from layers to RGB
    fresh, recoloured_ones = render_layers(new), render_layers(made)
    for name in ("contact_half", "no_contact_half"):
        here, there = (layers.rgb(getattr(layers, name)) for layers in (recoloured_ones, fresh))
        same_but_for_few_paths(here, there)
    capture = simulated_capture(new, seed=3)
    skills = [compare_press(p, capture, 1).headline_skill for p in (made, new)]
    assert skills[0].estimate == pytest.approx(skills[1].estimate, abs=1e-3)


def same_but_for_few_paths(here, there, of_mean=2e-3):
    """Assert that images are equal, but for pixels of which a path met a threshold and went elsewhere.

    The power of the light is a float32 sum, whose last digit moves a path that stands at a threshold.
    """
    off = np.abs(here - there) > FLOAT32 * np.abs(there) + FLOAT32 * np.abs(there).mean()
    assert off.mean() < 0.05
    np.testing.assert_allclose(here.mean(axis=(0, 1)), there.mean(axis=(0, 1)), rtol=of_mean)


def test_camera_and_white_balance_are_a_matrix(exciting):
    rendered, response = press(exciting), assumed_camera_response()
    dimmer = tuple(curve.model_copy(update={"values": 0.5 * curve.values}) for curve in response)
    made = recoloured(rendered, response=dimmer, white_balance=(2.0, 1.0, 4.0))
    np.testing.assert_allclose(made.contact, rendered.contact * np.array([1.0, 0.5, 2.0]), rtol=1e-5)
    np.testing.assert_allclose(made.camera_matrix[2], 2.0 * rendered.camera_matrix[2])
    grey = recoloured(made, white_balance="pad")
    np.testing.assert_allclose(grey.no_contact.mean(axis=(0, 1)) / grey.no_contact[..., 1].mean(), 1.0, rtol=1e-5)
    # from a recoloured press back to the first
    back = recoloured(grey, response=response, white_balance=(1.0, 1.0, 1.0))
    np.testing.assert_allclose(back.contact, rendered.contact, rtol=1e-5)
    assert back.label == "rendered, level b, test, recoloured"
    assert back.notes == ("camera response: assumed", "shape of the finger: flat")


def test_a_balanced_press_is_not_compared_with_raw_channels(exciting):
    rendered = press(exciting)
    capture = simulated_capture(rendered, seed=1)
    balanced = recoloured(rendered, white_balance=(2.0, 1.0, 1.5))
    assert balanced.notes[-1] == "white balance (red:green:blue): 2:1:1.5"
    prepare_images(rendered, capture)
    with pytest.raises(CompareError, match="was given a white balance"):
        prepare_images(balanced, capture)


def test_other_paints_start_from_the_render_and_can_be_changed_back(exciting):
    rendered, brighter = press(exciting), other(exciting, yield_rel=1.3)
    made = recoloured(rendered, brighter, paint_sha256={"red": "c" * 64, "green": "b" * 64})
    np.testing.assert_allclose(made.contact_bands, rendered.contact_bands * np.array([1.3, 1, 1]), rtol=1e-6)
    assert made.contact_chains is rendered.contact_chains
    expected = np.einsum("cb,ijb->ijc", made.camera_matrix**2, rendered.contact_bands_variance * [1.69, 1.0, 1.0])
    np.testing.assert_allclose(made.variance, expected, rtol=1e-5)
    assert made.paints["red"] == "c" * 64
    # a later camera shows the paints that the press shows
    blue = recoloured(made, white_balance=(1.0, 1.0, 2.0))
    np.testing.assert_allclose(blue.contact, made.contact * np.array([1.0, 1.0, 2.0]), rtol=1e-5)
    np.testing.assert_allclose(
        recoloured(blue, exciting, white_balance=(1.0, 1.0, 1.0)).contact, rendered.contact, rtol=1e-5
    )


def test_layers_and_their_matrix_are_the_images(exciting):
    dimmer = tuple(c.model_copy(update={"values": 0.5 * c.values}) for c in assumed_camera_response())
    together = press(exciting, no_contact_chains=None, contact_chains=None, chains=())
    for made in (
        recoloured(press(exciting), other(exciting, yield_rel=1.3), dimmer, (2.0, 1.0, 4.0)),
        recoloured(together, response=dimmer, white_balance=(2.0, 1.0, 4.0)),
    ):
        for state in ("no_contact", "contact"):
            layers = getattr(made, f"{state}_chains" if made.chains else f"{state}_bands")
            np.testing.assert_allclose(getattr(made, state), layers @ made.layer_matrix.T, rtol=1e-5)


def test_draws_of_what_did_not_change_still_hold(exciting):
    names = ("red paint", "green paint", "camera response")
    known = KnownInputs(
        names=names,
        keys=("r", "g", "c"),
        evaluations=("A", "A", "B"),
        sources=("of red", "of green", "of the camera"),
        factors=np.random.default_rng(4).random((3, 5, 3, len(CHAINS))),
    )
    rendered, brighter = press(exciting, known_inputs=known), other(exciting, yield_rel=1.3)
    response = assumed_camera_response()
    for changes, kept in (
        ({"white_balance": (2.0, 1.0, 1.0)}, [0, 1, 2]),
        ({"paints": brighter}, [2]),
    ):
        left = recoloured(rendered, **changes).known_inputs
        for field in ("names", "keys", "evaluations", "sources"):
            assert getattr(left, field) == tuple(getattr(known, field)[i] for i in kept)
        np.testing.assert_array_equal(left.factors, known.factors[kept])
    # another camera sees a draw of a paint otherwise too
    assert recoloured(rendered, response=response).known_inputs is None
    assert recoloured(rendered, brighter, response).known_inputs is None
    assert recoloured(press(exciting), brighter).known_inputs is None


def test_what_needs_a_new_render_is_refused(exciting):
    rendered = press(exciting)
    with pytest.raises(
        SimulateError, match=r"the red paint's reflectance in the green band changed from .* render again"
    ):
        recoloured(rendered, other(exciting, lighter=0.03))
    flat = {name: replace(p, reflectance=np.full(p.reflectance.size, 0.1)) for name, p in exciting.items()}
    with pytest.raises(SimulateError, match=r"the red band's centroid moved from 610\.\d to 625\.\d nm, .* 10 nm"):
        recoloured(press(flat), other(flat, shift_nm=15.0))
    wide = {**flat, "red": replace(flat["red"], absorption_rel=flat["red"].absorption_rel ** 0.3)}
    with pytest.raises(SimulateError, match=r"the light of chain led>red>red, .* would grow 3\.\d times .* 3 times"):
        recoloured(press(flat), wide)
    together = press(exciting, no_contact_chains=None, contact_chains=None, chains=())
    with pytest.raises(SimulateError, match="does not contain each chain of fluorescence separately"):
        recoloured(together, other(exciting))
    assert recoloured(together, white_balance=(1.0, 1.0, 2.0)).chains == ()
    with pytest.raises(SimulateError, match="does not contain the light that it was rendered with"):
        recoloured(press(exciting, rendered_light=None), white_balance=(1.0, 1.0, 2.0))
    for wrong in ((1.0, 0.0, 1.0), (1.0, float("nan"), 1.0)):
        with pytest.raises(SimulateError, match="must be three positive gains"):
            recoloured(rendered, white_balance=wrong)
    dark = press(exciting, no_contact_chains=np.zeros((36, 48, 4)))
    with pytest.raises(SimulateError, match="the pad without contact is black in a channel"):
        recoloured(dark, white_balance="pad")
    untouched = press(exciting, distance=np.full((36, 48), np.nan))
    with pytest.raises(SimulateError, match="press has no contact, so its record does not state which pixels see"):
        recoloured(untouched, white_balance="pad")


def finray(capsys, *arguments):
    """Run the command line; return its status and what it said."""
    status = main.main([str(argument) for argument in arguments])
    return status, "".join(capsys.readouterr())


def test_the_verb_writes_a_new_record_and_tells_mistakes(exciting, tmp_path, capsys):
    file = write_record(press(exciting), tmp_path / "a.json", provenance("pytest"))
    status, told = finray(capsys, "recolour", file, "--white-balance", "pad", "--out", tmp_path / "grey.json")
    assert status == 0, told
    assert "rendered, level b, test, recoloured" in told
    grey = read_record(tmp_path / "grey.json", SimulatedPress)
    assert np.ptp(grey.no_contact.mean(axis=(0, 1))) < 1e-5 * grey.no_contact.mean()
    camera = tmp_path / "camera.csv"
    camera.write_text("wavelength_nm,red_percent,green_percent,blue_percent\n380,10,20,30\n780,10,20,30\n")
    status, told = finray(capsys, "recolour", file, "--camera", camera, "--white-balance", "2:1:1")
    assert status == 0, told
    assert (tmp_path / "a-recoloured.json").exists()
    for options, message in (
        ([], "no change was requested"),
        (["--paint", "red=r.json"], "give both red=FILE and green=FILE"),
        (["--white-balance", "2:1:1"], "a-recoloured.json: exists already"),
    ):
        status, told = finray(capsys, "recolour", file, *options)
        assert status == 2
        assert message in told
    for wrong in ("2:1", "0:1:1", "nan:1:1"):
        status, told = finray(capsys, "recolour", file, "--white-balance", wrong)
        assert status == 2
        assert "'" + wrong + "'" in told
