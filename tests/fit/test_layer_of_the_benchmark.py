"""The layer behind the benchmark of the fit: photons are conserved, and known limits are met."""

import numpy as np
import pytest

from benchmarks.fluorescent_layer import NM, SLICES, Layer, paint, stokes_shifts_nm, transport
from benchmarks.paints_of_dyes import OUT_NM, runs_out


def bell(center_nm, width_nm):
    return np.exp(-0.5 * ((NM - center_nm) / width_nm) ** 2)


@pytest.mark.parametrize("optical", [0.1, 3.0, 40.0])
def test_without_absorption_all_light_comes_back(optical):
    for inside in (0.0, 0.5):  # of the surface: light that it throws back comes out later
        leaves = transport(optical, 1.0, 1.0, inside)[2]
        assert leaves.size == SLICES + 1
        assert leaves == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("albedo", [0.6, 0.9, 0.98])
def test_a_thick_layer_reflects_as_van_de_hulst_says(albedo):
    """Spherical albedo of a half-space that scatters isotropically, a fit good to 0.003; slices cost up to 0.015."""
    s = np.sqrt(1 - albedo)
    known = (1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s)
    assert transport(80.0, albedo, 0.0, 0.0)[2][-1] == pytest.approx(known, abs=0.02)


def test_light_through_an_empty_layer_is_that_of_its_backing():
    assert transport(1e-4, 0.0, 0.6, 0.0)[2][-1] == pytest.approx(0.6, abs=1e-3)


def test_photons_out_never_exceed_photons_in_and_reabsorption_reddens():
    layer = Layer(8.0, 1.0, 10.0, 0.1, 0.8, 0.95, 0.04, 0.55)
    absorbed, emitted = bell(480, 30), bell(530, 25)
    found = paint(layer, absorbed, emitted)
    photons = np.trapezoid(found.matrix_per_nm * NM[:, None] / NM[None, :], NM, axis=0)
    assert (photons + found.reflectance <= 1 + 1e-9).all()
    column = found.matrix_per_nm[:, np.searchsorted(NM, 450)]
    assert NM[column.argmax()] > NM[emitted.argmax()]


def test_stokes_shift_counts_from_the_last_maximum():
    last, largest = stokes_shifts_nm(NM, bell(400, 10) + 0.5 * bell(500, 15), bell(540, 20))
    assert last == pytest.approx(40, abs=1)
    assert largest == pytest.approx(140, abs=1)
    assert stokes_shifts_nm(NM, bell(400, 10) + 0.2 * bell(500, 15), bell(540, 20))[0] == pytest.approx(140, abs=1)


def test_records_that_stop_where_they_count_are_told_apart():
    nm = np.arange(400.0, 801.0, 5.0)
    excitation, emission = (np.exp(-0.5 * ((nm - at) / 25) ** 2) for at in (480.0, 560.0))

    def whole(excitation, emission):
        return runs_out(nm, excitation, emission, np.interp(OUT_NM, nm, emission))

    assert whole(excitation, emission)
    assert not whole(excitation, np.where(nm > 610, 0.0, emission))  # the record ends at a seventh of the peak
    assert whole(excitation, np.where(nm > 630, 0.0, emission))  # at 2 %: below what is judged
    assert not whole(np.where(nm > 520, 0.0, excitation), emission)
    assert not whole(excitation, np.where(nm == 575, 0.01, emission))
