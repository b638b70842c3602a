"""Normal maps: against closed forms, on a gel whose colours are known, and what they refuse."""

from dataclasses import replace
from itertools import product
from math import comb

import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.sensing import fit_normal_map, held_out_score, polynomial_terms
from finray_calib.sensing._normal_map import angles_deg
from finray_calib.sensing._normal_map_fit import ball_slopes
from tests.compare.three_lights import BALL_PX, SHAPE_PX, ball_press, ball_presses, dent_slopes, shaded

NOISE_DN = 0.5


@pytest.fixture(scope="module")
def presses():
    return ball_presses(16, noise_dn=NOISE_DN)


@pytest.fixture(scope="module")
def fitted(presses):
    return fit_normal_map(presses, seed=1)


def test_terms_are_all_monomials():
    rng = np.random.default_rng(1)
    rgb, x, y = rng.normal(size=(7, 3)), rng.normal(size=7), rng.normal(size=7)
    values = np.column_stack([rgb, x, y])
    for degree in range(5):
        terms = polynomial_terms(rgb, x, y, degree)
        assert terms.shape == (7, comb(degree + 5, 5))
        powers = [p for p in product(range(degree + 1), repeat=5) if sum(p) <= degree]
        direct = np.array([np.prod(values ** np.array(p), axis=1) for p in powers])
        # the same set of columns, whatever their order
        assert np.allclose(np.sort(terms, axis=1), np.sort(direct.T, axis=1), rtol=1e-12, atol=1e-12)
        assert (terms[:, 0] == 1.0).all()


def test_angles_between_known_normals():
    tilts = np.radians([0.0, 1e-7, 30.0, 60.0])
    slopes = np.stack([np.tan(tilts), np.zeros(4)], axis=-1)
    assert np.allclose(angles_deg(slopes, np.zeros((4, 2))), np.degrees(tilts), rtol=1e-9)
    # 45 deg to either side of the vertical are at right angles
    assert angles_deg(np.array([1.0, 0.0]), np.array([-1.0, 0.0])) == pytest.approx(90.0)


def test_ball_slopes_are_the_derivative_of_the_ball():
    press, step = ball_press(30.0, 40.0, 12.0), 1e-5
    rows, columns = np.array([25.0, 30.0, 37.5]), np.array([33.0, 40.0, 44.0])

    def depth(r, c):
        return np.sqrt(BALL_PX**2 - (r - 30.0) ** 2 - (c - 40.0) ** 2)

    numeric = np.stack(
        [
            (depth(rows, columns + step) - depth(rows, columns - step)) / (2 * step),
            (depth(rows + step, columns) - depth(rows - step, columns)) / (2 * step),
        ],
        axis=-1,
    )
    assert np.allclose(ball_slopes(rows, columns, press), numeric, atol=1e-9)


def test_a_press_that_taught_nothing_is_sensed(fitted):
    truth = dent_slopes(31.0, 37.0, 10.0)
    rng = np.random.default_rng(7)
    no_contact = shaded(np.zeros((*SHAPE_PX, 2)))
    image = shaded(truth) + NOISE_DN * rng.standard_normal(no_contact.shape)
    inside = np.hypot(np.indices(SHAPE_PX)[0] - 31.0, np.indices(SHAPE_PX)[1] - 37.0) <= 9.0
    angle = angles_deg(fitted.slopes(image, no_contact), truth)
    # noise of 0.5 DN on changes of about 30 DN turns a normal by about 1 deg
    assert angle[inside].mean() < 2.0
    assert angles_deg(np.zeros((1, 2)), truth[inside]).mean() > 15.0
    assert angle[~inside & (truth == 0.0).all(axis=-1)].mean() < 2.0


def test_held_out_score_is_high_here_and_low_for_a_grey_sensor(presses):
    score = held_out_score(presses, seed=1)
    assert score.explained.shape == score.angle_deg.shape == (12,)
    assert score.explained.min() > 0.98
    assert score.angle_deg.max() < 3.0
    # one light for all colours tells one slope of two
    grey = [replace(p, contact=np.repeat(p.contact[..., :1], 3, axis=-1)) for p in presses]
    grey = [replace(p, no_contact=np.repeat(p.no_contact[..., :1], 3, axis=-1)) for p in grey]
    assert 0.3 < np.median(held_out_score(grey, seed=1).explained) < 0.7


def test_same_seed_same_map(presses):
    one, other = (fit_normal_map(presses, seed=3) for _ in range(2))
    assert np.array_equal(one.coefficients, other.coefficients)
    assert np.array_equal(held_out_score(presses, 3).explained, held_out_score(presses, 3).explained)


def test_exposure_and_blocks_do_not_matter(fitted):
    image, no_contact = shaded(dent_slopes(30.0, 40.0, 11.0)), shaded(np.zeros((*SHAPE_PX, 2)))
    sensed = fitted.slopes(image, no_contact)
    assert np.allclose(fitted.slopes(3.0 * image, 3.0 * no_contact), sensed, atol=1e-12)

    def halved(a):
        return a.reshape(SHAPE_PX[0] // 2, 2, SHAPE_PX[1] // 2, 2, -1).mean(axis=(1, 3))

    inside = np.hypot(*(np.indices(SHAPE_PX) - np.array([30, 40])[:, None, None])) <= 9.0
    blocks = halved(inside[..., None])[..., 0] == 1.0
    difference = fitted.slopes(halved(image), halved(no_contact)) - halved(sensed)
    # the map is of third degree, so mean and map do not quite commute
    assert np.abs(difference[blocks]).max() < 0.02


def test_beyond_the_taught_colours_the_map_holds_and_says_so(fitted):
    no_contact = shaded(np.zeros((*SHAPE_PX, 2)))
    everywhere = np.ones(SHAPE_PX, dtype=bool)
    assert fitted.outside_share(no_contact, no_contact, everywhere) == 0.0
    assert fitted.outside_share(no_contact + 300.0, no_contact, everywhere) == 1.0
    one, other = (fitted.slopes(no_contact + dn, no_contact) for dn in (300.0, 600.0))
    assert np.array_equal(one, other)


def test_clipped_pixels_teach_nothing(presses):
    hurt = []
    for press in presses:
        contact = press.contact.copy()
        contact[20:30, 30:40] = np.nan
        hurt.append(replace(press, contact=contact))
    assert held_out_score(hurt, seed=1).explained.min() > 0.98


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius_px": 25.0}, "press 1: the contact circle of 25 px must be smaller than the ball of 20 px"),
        ({"radius_px": 0.0}, "the contact circle of 0 px"),
        ({"row_px": 500.0}, "press 1: the contact circle of .* has no usable pixel in a picture of 80 x 60 px"),
        ({"no_contact": np.ones((60, 81, 3))}, "press 1: the no-contact image has 81 x 60 px"),
        ({"no_contact": np.ones((60, 80))}, r"press 1: the no-contact image has shape \(60, 80\)"),
        ({"no_contact": np.zeros((60, 80, 3))}, "the no-contact image is black or clipped everywhere"),
        ({"no_contact": np.full((60, 80, 3), np.nan)}, "no usable pixel"),
    ],
)
def test_presses_that_cannot_be_are_refused(presses, change, message):
    with pytest.raises(CompareError, match=message):
        fit_normal_map([replace(presses[0], **change), *presses[1:]], seed=1)


def test_a_press_that_cannot_be_is_called_by_its_name(presses):
    named = [replace(presses[0], name="0007", radius_px=25.0), *presses[1:]]
    with pytest.raises(CompareError, match=r"^0007: the contact circle of 25 px .* mm per px and the circle"):
        fit_normal_map(named, seed=1)


def test_too_few_or_unchanged_presses_are_refused(presses):
    with pytest.raises(CompareError, match="needs at least 12 ball presses, got 11"):
        fit_normal_map(presses[:11], seed=1)
    with pytest.raises(CompareError, match="needs at least 12 ball presses, got 0"):
        held_out_score([], seed=1)
    with pytest.raises(CompareError, match="no press changes the picture"):
        fit_normal_map([replace(p, contact=p.no_contact) for p in presses], seed=1)


def test_images_of_another_size_are_refused(fitted):
    other = np.ones((50, 80, 3))
    with pytest.raises(CompareError, match="fitted to colour images of 80 x 60 px, but this image has 80 x 50 px"):
        fitted.slopes(other, other)
    with pytest.raises(CompareError, match=r"but this image has shape \(60, 80\)"):
        fitted.slopes(np.ones(SHAPE_PX), np.ones(SHAPE_PX))
