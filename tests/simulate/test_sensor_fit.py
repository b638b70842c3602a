"""The fit of a sensor to its captures: intervals hold on hidden sensors, and what the pictures do not tell is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from data_schemas import FingerDesign, FittedNumber, GelPad, SensorFit, SimulateError, provenance
from data_schemas.storage import read_record, write_record
from finray_calib.fit import PictureBlocks, sample_picture_posterior
from sim.experiments import FingerLayers, fit_sensor, fitted_design, paint_finger
from sim.experiments._sensor_fit import captured_pictures
from sim.experiments._sensor_layers import value_at, with_changed_values
from sim.optics import RenderSettings, render_press
from tests.simulate.drawn_sensor import COLUMNS, DESIGN, ROWS, DrawnSensor, captured, formula, hidden_sensor

NOISE_REL = 0.05
FREE = ["pad.thickness_mm"]


def fitted(number, discrepancy=None) -> tuple[dict[str, float], SensorFit]:
    truth, capture = hidden_sensor(number, NOISE_REL, discrepancy)
    return truth, fit_sensor(DrawnSensor(noise_rel=NOISE_REL), [capture], FREE, seed=number)


def of(fit: SensorFit, name: str) -> FittedNumber:
    return next(number for number in fit.numbers if number.name == name)


@pytest.fixture(scope="module")
def hidden():
    return [fitted(number) for number in range(12)]


def test_intervals_hold_on_hidden_sensors(hidden):
    inside = [
        number.posterior.low95 <= truth[number.name] <= number.posterior.high95
        for truth, fit in hidden
        for number in fit.numbers
    ]
    assert len(inside) == 12 * 11
    # numbers of one sensor go together: about 60 independent ones, of which 0.87 is three standard errors below 0.95
    assert np.mean(inside) >= 0.87
    # and they are worth having: of the gel's thickness a small part of what was not known is left
    assert np.median([of(fit, "pad.thickness_mm").left_of_prior_rel for _, fit in hidden]) < 0.3


def test_only_products_of_gain_and_power_are_determined(hidden):
    for truth, fit in hidden:
        names = [number.name for number in fit.numbers]
        powers = np.log(fit.draws[:, [names.index(f"lights.{k}.power_rel") for k in range(3)]])
        # a common factor on three lights is known as well as their mean is by the prior: 1 / sqrt(3) of it
        assert powers.mean(axis=1).std() == pytest.approx(0.2 / np.sqrt(3.0), rel=0.1)
        # ratios are told by the pictures
        ratio = powers[:, 0] - powers[:, 1]
        assert ratio.std() < 0.05
        assert of(fit, "lights.0.power_rel").verdict == "partly determined"
        assert any("lights.0.power_rel" in told and "lights.2.power_rel" in told for told in fit.not_told_apart)
        product = fit.draws[:, names.index("picture.gain")] * np.exp(powers[:, 0])
        assert product.std() / product.mean() < 0.05
        assert abs(np.log(product.mean() / (truth["picture.gain"] * truth["lights.0.power_rel"]))) < 0.15


def test_an_error_that_the_model_does_not_have_widens_the_intervals(hidden):
    row, column = np.mgrid[:ROWS, :COLUMNS]
    vignetting = 1.0 - 0.3 * ((row / ROWS - 0.5) ** 2 + (column / COLUMNS - 0.5) ** 2) / 0.5
    _, plain = hidden[0]
    _, dim = fitted(0, vignetting)
    assert plain.discrepancy_rel.high95 < 0.01 < dim.discrepancy_rel.low95
    layers = zip(plain.brightness, dim.brightness, strict=True)
    assert all(two.over_design_rel.sd > 2.0 * one.over_design_rel.sd for one, two in layers)


def test_what_makes_no_difference_is_said_not_to_be_determined():
    truth, capture = hidden_sensor(3, NOISE_REL)
    fit = fit_sensor(DrawnSensor(noise_rel=NOISE_REL), [capture], ["pad.refractive_index"])
    index = of(fit, "pad.refractive_index")
    assert index.verdict == "not determined by these pictures"
    assert index.left_of_prior_rel == pytest.approx(1.0, abs=0.06)
    # 2000 draws: the width of their spread is known to 1.6 %
    assert index.posterior.estimate == pytest.approx(index.prior.estimate, rel=0.01)
    kept = fitted_design(fit)
    assert kept.pad.refractive_index == DrawnSensor().design.pad.refractive_index
    assert "pad.refractive_index" not in kept.origin
    assert truth


def test_renders_that_are_too_noisy_are_not_trusted():
    _, capture = hidden_sensor(1, NOISE_REL)
    fit = fit_sensor(DrawnSensor(noise_rel=2.0), [capture], FREE)
    assert not fit.trusted
    told = next(note for note in fit.notes if "too noisy" in note and "--samples" in note)
    noisy = [number for number in fit.numbers if number.name in told]  # which they are depends on the last digits
    assert noisy
    assert {number.verdict for number in noisy} <= {
        "the renders are too noisy to tell",
        "not determined by these pictures",
    }


def test_the_record_and_the_fitted_design(hidden, tmp_path):
    truth, fit = hidden[1]
    write_record(fit, tmp_path / "drawn.sensor.json", provenance("a test", {}))
    again = read_record(tmp_path / "drawn.sensor.json", SensorFit)
    np.testing.assert_array_equal(again.draws, fit.draws)
    design = fitted_design(again)
    thickness = of(fit, "pad.thickness_mm")
    assert design.pad.thickness_mm == thickness.posterior.estimate
    assert design.origin["pad.thickness_mm"] == "measured"
    assert design.uncertainty_rel["pad.thickness_mm"] == pytest.approx(
        thickness.posterior.sd / thickness.posterior.estimate
    )
    assert abs(design.pad.thickness_mm - truth["pad.thickness_mm"]) < abs(4.0 - truth["pad.thickness_mm"])
    assert design.lights[0].power_rel == of(fit, "lights.0.power_rel").posterior.estimate


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"encoding": "unknown"}, "fitted only to linear values"),
        ({"exposure_s": 0.02}, "one gain holds for all captures"),
        ({"name": "hidden"}, "given twice"),
    ],
)
def test_captures_that_do_not_go_together_are_refused(change, told):
    _, capture = hidden_sensor(0)
    other = capture.model_copy(update={"name": "other", "contact": capture.contact * 1.001, **change})
    with pytest.raises(SimulateError, match=told):
        fit_sensor(DrawnSensor(), [capture, other], FREE)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("pad.nose", "must be the dotted path of a positive number"),
        ("lights.0.power_rel", "powers are always fitted; leave out"),
        ("indenter.depth_mm", "is always fitted for captures that state indenter.depth_uncertainty_mm; leave out"),
        ("indenter.radius_mm", "only depth_mm and position_mm of the indenter can be fitted"),
        ("camera.width_px", "must be the dotted path of a positive number"),
        ("walls", "must be the dotted path of a positive number"),
        ("lights.9.width_mm", "must be the dotted path of a positive number"),
        ("pad.3", "must be the dotted path of a positive number"),
        ("pad.thickness_mm.real", "must be the dotted path of a positive number"),
    ],
)
def test_numbers_that_cannot_be_free_are_refused(name, why):
    _, capture = hidden_sensor(0)
    with pytest.raises(SimulateError, match=f"--free {name}: {why}"):
        fit_sensor(DrawnSensor(), [capture], [name])


def test_entries_of_a_place_can_be_free():
    pad = GelPad(shape="ellipsoidal", length_mm=16.0, width_mm=16.0, thickness_mm=5.0, semi_axes_mm=(16.0, 10.0, 16.0))
    sensor = DESIGN.model_copy(update={"pad": pad})
    assert value_at(sensor, "pad.semi_axes_mm.1") == 10.0
    changed = with_changed_values(sensor, {"pad.semi_axes_mm.1": 11.0})
    assert changed.pad.semi_axes_mm == (16.0, 11.0, 16.0)
    assert value_at(FingerDesign(), "lights.0.width_mm") is None  # its panels are light, second_light, further_lights
    assert value_at(FingerDesign(), "further_lights.0.width_mm") is None


def test_pictures_of_another_size_are_refused():
    pictures = 1000.0 * formula(DrawnSensor().design, True)[:, ::2, ::2]
    capture = captured(np.stack([pictures, pictures]), np.random.default_rng(1))
    with pytest.raises(SimulateError, match=r"renders 64 x 48 px, but hidden has 32 x 24 px"):
        fit_sensor(DrawnSensor(), [capture], FREE)


def test_a_picture_without_contact_that_captures_share_counts_once():
    """Captures of a data set may share one: its noise does not average out."""
    _, first = hidden_sensor(0)
    _, second = hidden_sensor(1)
    shared = second.model_copy(update={"name": "shared", "no_contact": first.no_contact})
    picture, variance = (of_all[0] for of_all in captured_pictures([first]))
    same, known = (of_all[0] for of_all in captured_pictures([first, shared]))
    np.testing.assert_array_equal(same, picture)
    # the noise of the second is told from another pair of pictures
    assert np.median(known / variance) == pytest.approx(1.0, abs=0.1)
    own = captured_pictures([first, second.model_copy(update={"name": "own"})])[1][0]
    assert np.median(own / variance) == pytest.approx(0.5, abs=0.15)


def test_two_captures_are_better_than_one():
    _, capture = hidden_sensor(5, NOISE_REL)
    scene = DrawnSensor(noise_rel=0.01)
    one = fit_sensor(scene, [capture], FREE)
    again = capture.model_copy(update={"name": "again", "contact": np.nextafter(capture.contact, np.inf)})
    two = fit_sensor(scene, [capture, again], FREE)
    assert {n.name for n in two.numbers} - {n.name for n in one.numbers} == {"press.1.depth_mm", "press.1.position_mm"}
    assert of(two, "pad.thickness_mm").left_of_prior_rel <= 1.05 * of(one, "pad.thickness_mm").left_of_prior_rel
    assert replace(scene).design == two.sensor


def test_intervals_hold_where_channels_share_noise_and_edges_hold_most_of_it():
    rng, pictures, count = np.random.default_rng(3), 2, 4
    places = np.stack(np.meshgrid(np.arange(10) / 10.0, np.arange(5) / 10.0), axis=-1).reshape(-1, 2)
    channels = np.linalg.cholesky(np.full((3, 3), 0.95) + 0.05 * np.eye(3))
    away = []
    for _ in range(30):
        # of the noise of blocks the middle 90 % differ 27 fold in variance; what moves the picture does so at its edges
        sizes = np.exp(0.5 * rng.standard_normal(len(places)))
        slopes = 0.1 * rng.standard_normal((count, 1, 1, len(places))) * sizes
        slopes = np.repeat(np.repeat(slopes, pictures, axis=1), 3, axis=2)

        def noise(size, sizes=sizes):
            drawn = rng.standard_normal((3, len(places))) + 0.5 * rng.standard_normal((pictures, 3, len(places)))
            return size * sizes * (channels @ drawn)

        truth, of_model, half = rng.standard_normal(count), noise(0.02), noise(0.02)
        values = 1.0 + np.tensordot(truth, slopes, 1) + noise(0.06)
        blocks = PictureBlocks(values, np.full(values.shape, 1e-8), places, csr_matrix((len(places), 1)))

        def predict(theta, slopes=slopes, of_model=of_model, half=half):
            return np.stack([1.0 + np.tensordot(theta, slopes, 1) + of_model, half]).reshape(2, -1)

        found = sample_picture_posterior(predict, blocks, np.full(count, 0.25), rng, correlation_length=0.3)
        away.append((truth - found.theta.mean(axis=0)) / found.theta.std(axis=0))
    # 120 of them: 1.23 is 3.5 standard errors above 1
    assert np.sqrt(np.mean(np.square(away))) < 1.23


def test_a_black_channel_is_left_out_and_the_others_are_fitted():
    """A sensor of two colours, whose blue sees nothing, loses nothing that red and green tell."""
    _, capture = hidden_sensor(3, NOISE_REL)
    whole = fit_sensor(DrawnSensor(noise_rel=NOISE_REL), [capture], FREE, seed=3)

    def black(counts):
        return np.stack([counts[..., 0], counts[..., 1], np.full_like(counts[..., 2], 64)], axis=-1)

    dark = capture.model_copy(
        update={n: black(getattr(capture, n)) for n in ("contact", "no_contact", "repeat_no_contact")}
    )
    fit = fit_sensor(DrawnSensor(noise_rel=NOISE_REL), [dark], FREE, seed=3)
    assert any("the blue channel is left out of the fit: the captures hold no light" in note for note in fit.notes)
    assert of(fit, "lights.2.power_rel").left_of_prior_rel == pytest.approx(1.0, abs=0.1)
    assert [layer.channel for layer in fit.brightness] == ["red", "green"]
    # of the gel's thickness two channels tell what three do, within their joint uncertainty
    two, three = (of(f, "pad.thickness_mm").posterior for f in (fit, whole))
    assert abs(two.estimate - three.estimate) < 2.0 * np.hypot(two.sd, three.sd)
    assert of(fit, "pad.thickness_mm").left_of_prior_rel < 0.5


def test_a_design_without_light_in_a_channel_leaves_it_out():
    _, capture = hidden_sensor(3, NOISE_REL)
    fit = fit_sensor(OneColour(noise_rel=NOISE_REL), [capture], seed=3)
    left_out = [note for note in fit.notes if "left out of the fit: drawn has no light in it" in note]
    assert [note.split()[1] for note in left_out] == ["green", "blue"]


def test_the_uncertainty_that_a_design_states_of_all_lights_is_that_of_each():
    design = DESIGN.model_copy(update={"uncertainty_rel": {"lights.distance_mm": 0.3}})
    fit = fit_sensor(
        DrawnSensor(design, noise_rel=NOISE_REL), [hidden_sensor(3, NOISE_REL)[1]], ["lights.0.distance_mm"]
    )
    prior = of(fit, "lights.0.distance_mm")
    assert prior.prior_origin == "design: uncertainty_rel"
    assert prior.prior.high95 / prior.prior.estimate == pytest.approx(np.exp(1.96 * 0.3), rel=0.02)


def test_captures_and_design_without_a_common_channel_are_refused():
    _, capture = hidden_sensor(3, NOISE_REL)
    images = {n: np.array(getattr(capture, n)) for n in ("contact", "no_contact", "repeat_no_contact")}
    for image in images.values():
        image[..., 0] = 64
        image[::5, ::5, 0] = 65
    with pytest.raises(SimulateError, match="no channel has light both in the captures and in the design's pictures"):
        fit_sensor(OneColour(noise_rel=NOISE_REL), [capture.model_copy(update=images)], seed=3)


class OneColour(DrawnSensor):
    """All lights are red."""

    def mix(self, factors):
        powers = super().mix(factors)
        return np.stack([powers.sum(axis=0), np.zeros(3), np.zeros(3)])


def _pigmented(paints, red=1.0, green=1.0):
    """Return paints of other yields that absorb what walls emit, as every calibrated paint does."""

    def absorbed(center_nm, sigma_nm):
        return np.exp(-0.5 * ((paints["red"].wavelength_nm - center_nm) / sigma_nm) ** 2)

    absorption = {"red": 0.05 + absorbed(555.0, 30.0) + 0.5 * absorbed(450.0, 60.0), "green": absorbed(470.0, 30.0)}
    return {
        colour: replace(
            paints[colour], absorption_rel=absorption[colour], emission_per_nm=factor * paints[colour].emission_per_nm
        )
        for colour, factor in (("red", red), ("green", green))
    }


@pytest.mark.renderer
def test_layers_of_a_painted_finger_add_up_to_its_picture(paints, llvm):
    """Green emission makes the red wall emit too: without that, red was up to 16 % too dark, and unevenly so."""
    design = FingerDesign()
    small = design.camera.model_copy(update={"width_px": 40, "height_px": 30})
    design = design.model_copy(update={"camera": small})
    finger = paint_finger(design, _pigmented(paints), Path(), llvm)
    scene = FingerLayers(finger, seed=1, samples=16)
    found = scene.layers([design])
    assert len(scene.layer_names) == found.pictures.shape[2]

    def seen(paints, state):
        render = render_press(design, paints, llvm, RenderSettings("b", 1, 16))
        return getattr(render, f"{state}_bands")[found.on_pad] @ finger.camera_matrix(render.bands).T

    def mixed(factors, picture):
        return found.pictures[0, picture][:, found.on_pad].T @ scene.mix(factors).T

    for picture, state in enumerate(("no_contact", "contact")):
        # the same random numbers: single precision is left
        np.testing.assert_allclose(mixed({}, picture), seen(finger.paints, state), rtol=1e-4, atol=1e-9)
    of_yields = mixed({"paint.red.yield_rel": 0.9, "paint.green.yield_rel": 0.7}, 0).mean(axis=0)
    # chains of third order grow as those of second order do here: 0.7 of a percent of red
    np.testing.assert_allclose(of_yields, seen(_pigmented(paints, 0.9, 0.7), "no_contact").mean(axis=0), rtol=5e-3)
