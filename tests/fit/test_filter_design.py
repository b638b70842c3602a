"""Filters by design: the exchange against every set, pairs of fits, the ranking of the next, and mistakes."""

import itertools

import numpy as np
import pytest

from benchmarks.drawn_paints import nominal_optics
from data_schemas import FilterWheelSettings, FitError
from data_schemas.storage import read_csv
from finray_calib.fit import (
    CatalogueFilter,
    design_filters,
    filter_catalogue,
    next_filters,
    stock_catalogue,
)
from finray_calib.fit._filter_design import _Screen, fitted_errors, paired_ratio
from tests.acceptance.paints import example

FEW = tuple(CatalogueFilter(float(c), 10.0, 0.6) for c in range(500, 700, 25))


@pytest.fixture(scope="module")
def screen():
    at_laser = tuple(f for f in nominal_optics().filters if f.name == "450")
    return _Screen.of(nominal_optics(), at_laser, FEW, np.random.default_rng(1))


def test_exchange_finds_the_best_of_all_sets(screen):
    """Of 8 filters three: 56 sets, tried one by one."""
    chosen, error = screen.exchanged(3, np.random.default_rng(2), lambda done, total, what: None)
    every = {s: screen.squared(s) for s in itertools.combinations(range(len(FEW)), 3)}
    ranks = sorted(every, key=every.get)
    assert ranks.index(chosen) <= 2  # the last sweep is of the mean error, the others of its square
    assert error == pytest.approx(screen.error(chosen))
    assert error <= screen.error(ranks[0]) * (1 + 1e-12)  # the same set may be summed in another order


def test_more_filters_never_tell_less(screen):
    errors = [screen.squared(range(n)) for n in range(1, len(FEW) + 1)]
    assert all(np.diff(errors) < 0)


def test_design_keeps_what_must_stay_and_is_screened_better():
    optics = nominal_optics()
    found = design_filters(optics, stock_catalogue(), keep_nm=[405.0], paints=0, seed=3)
    assert len(found.filters) == len(optics.filters)
    assert set(found.kept) == {"405", "450"}
    assert {f.center_nm for f in found.filters} >= {405.0, 450.0}
    assert len({(f.center_nm, f.fwhm_nm) for f in found.filters}) == len(found.filters)
    assert [f.slot for f in found.filters] == list(range(1, len(found.filters) + 1))
    assert found.screened_rel < 0.9 * found.screened_rig_rel
    assert np.isnan(found.mean_ratio[0])
    again = design_filters(optics, stock_catalogue(), keep_nm=[405.0], paints=0, seed=3)
    assert again.filters == found.filters


def test_no_two_filters_of_a_wheel_have_one_name():
    """A kept filter that is called as one of the catalogue is, and a catalogue that lists one twice."""
    optics = nominal_optics()
    kept = next(f for f in optics.filters if f.center_nm == 600.0)
    named = tuple(f.model_copy(update={"name": "600/10"}) if f is kept else f for f in optics.filters)
    catalogue = [CatalogueFilter(nm, 10.0, 0.6) for nm in (600.0, 560.0, 640.0, 520.0, 560.0)]
    found = design_filters(optics.model_copy(update={"filters": named}), catalogue, 5, [600.0], paints=0)
    names = [f.name for f in found.filters]
    assert len(set(names)) == len(names) == 5
    assert FilterWheelSettings(filters=found.filters).filters == found.filters
    with pytest.raises(FitError, match="3 others of the catalogue"):
        design_filters(optics.model_copy(update={"filters": named}), catalogue, 6, [600.0], paints=0)


def test_no_filter_that_passes_the_laser_is_chosen():
    optics = nominal_optics()
    found = design_filters(optics, stock_catalogue(), number=5, paints=0)
    new = [f for f in found.filters if f.name not in found.kept]
    assert len(found.filters) == 5
    assert all(f.center_nm - f.fwhm_nm > 450.0 for f in new)


def test_the_same_rig_has_the_same_errors():
    """Both sides of the pair see the same paints, noise and random numbers."""
    one, other = fitted_errors((nominal_optics(), nominal_optics()), 2, np.random.default_rng(4))
    assert one == pytest.approx(other, rel=1e-9)
    assert (one > 0).all()
    assert paired_ratio(one, other, np.mean, np.random.default_rng(5)) == pytest.approx((1.0, 1.0, 1.0))


def test_a_white_reference_that_is_poorly_known_makes_the_curve_so():
    """Of a tile known to 20 % the level of every curve is off by 0.16 in the mean, a half-normal's."""
    optics = nominal_optics()
    tile = optics.white_reference.model_copy(update={"uncertainty_rel": 0.2})
    sure, poor = fitted_errors(
        (optics, optics.model_copy(update={"white_reference": tile})), 6, np.random.default_rng(1)
    )
    found = sure < 0.1  # paints whose shape the filters tell: their error is that of the level
    assert found.sum() >= 2
    assert 0.05 < poor[found].mean() - sure[found].mean() < 0.3


def test_the_next_filter_is_where_the_posterior_is_widest():
    """Draws that differ at one place only: a filter there takes it all, and one elsewhere nothing."""
    paint, rng = example(), np.random.default_rng(6)
    bump = np.exp(-0.5 * ((paint.wavelength_nm - 580.0) / 8.0) ** 2)
    draws = paint.emission_per_nm + np.outer(
        0.5 * paint.emission_per_nm.max() * rng.standard_normal(len(paint.emission_draws_per_nm)), bump
    )
    wide = paint.model_copy(update={"emission_draws_per_nm": draws})
    ranked = next_filters(wide, FEW)
    assert ranked[0].filter.centre_nm == 575.0
    assert ranked[0].reduction_rel > 0.9
    assert ranked[-1].reduction_rel < 0.01


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"keep_nm": [406.0]}, "no filter of the rig is centred at 406 nm"),
        ({"number": 1}, "the number of filters must be 2 to"),
        ({"number": 200}, "the number of filters must be 2 to"),
    ],
)
def test_what_cannot_be_designed_is_refused(options, match):
    with pytest.raises(FitError, match=match):
        design_filters(nominal_optics(), FEW, paints=0, **options)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("centre_nm,width_nm\n500,10\n", "the column peak_transmission is missing"),
        ("centre_nm,width_nm,peak_transmission\n", "holds no filter"),
        (
            "centre_nm,width_nm,peak_transmission\n500,10,90\n",
            "line 2: peak_transmission is '90', but must be a number",
        ),
        ("centre_nm,width_nm,peak_transmission\n500,ten,0.9\n", "line 2: width_nm is 'ten'"),
        ("centre_nm,width_nm,peak_transmission\n500,10\n", "line 2: peak_transmission is ''"),
    ],
)
def test_mistakes_in_a_catalogue(tmp_path, text, match):
    path = tmp_path / "filters.csv"
    path.write_text(text)
    with pytest.raises(FitError, match=match):
        filter_catalogue(*read_csv(path), "filters.csv")
