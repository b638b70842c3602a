"""Pairs of paints on a finger whose ranking is known by construction, on one set of paths."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FingerDesign, SimulateError, SpectralCurve
from data_schemas._design_parts import TactileCamera
from finray_calib.decide import rank_by_draws
from sim.experiments import PaintDraws, UnpaintedFinger, paint_pairs
from sim.experiments._light_angle import POINTS_ACROSS, POINTS_ALONG, facet_slopes
from sim.experiments._paint_choice import trace_pairs
from sim.optics import (
    BAND_NAMES,
    ProbePaths,
    chain_matrix,
    measure_together,
    paint_bands,
    seen_points,
    tilted_facets,
)
from sim.surface_meshes import rest_shape

DESIGN = FingerDesign(camera=TactileCamera(width_px=64, height_px=48))
RAYS, REPEATS, DRAWS = 512, 2, 40
#: Of the yield of a paint, as a calibration leaves it.
YIELD_SD_REL = 0.03


NM = np.arange(380.0, 781.0)


def steps():
    """A camera that sees light below 500 nm, from there to 570 nm and above, each in one channel."""
    edges = ((570.0, 800.0), (500.0, 570.0), (300.0, 500.0))
    return tuple(
        SpectralCurve(name=name, wavelength_nm=NM, values=((low <= NM) & (high > NM)).astype(float), source="made up")
        for name, (low, high) in zip("RGB", edges, strict=True)
    )


def finger(renderer):
    return UnpaintedFinger(DESIGN, steps(), renderer)


def calibrated(paint, seed):
    factors = np.exp(YIELD_SD_REL * np.random.default_rng(seed).standard_normal((200, 1)))
    return PaintDraws(paint, factors * paint.emission_per_nm)


def like_the_led(paint):
    """A paint of the same yield that emits just above the LED, where the same channel of the camera sees it."""
    emission = np.exp(-0.5 * ((paint.wavelength_nm - 485.0) / 5.0) ** 2)
    scale = np.trapezoid(paint.emission_per_nm, paint.wavelength_nm) / np.trapezoid(emission, paint.wavelength_nm)
    return replace(paint, emission_per_nm=scale * emission)


@pytest.mark.renderer
def test_the_ranking_is_the_one_that_was_made(llvm, paints):
    red, green = paints["red"], paints["green"]
    dull = replace(red, emission_per_nm=red.emission_per_nm / 4.0)
    candidates = {
        "red": calibrated(red, 1),
        "twin": calibrated(red, 2),
        "dull": calibrated(dull, 3),
        "green": calibrated(green, 4),
        "bluish": calibrated(like_the_led(green), 5),
    }
    told = []
    found = paint_pairs(
        finger(llvm), candidates, 1, DRAWS, ProbePaths(RAYS, REPEATS, 1), lambda done, total, what: told.append(done)
    )
    assert len(found.pairs) == 20
    assert told == list(range(1, 30))
    assert found.normal_error_deg.shape == found.separation_deg.shape == (20, DRAWS)
    ranking = rank_by_draws(found.normal_error_deg)
    number = {pair: k for k, pair in enumerate(found.pairs)}
    mean = found.normal_error_deg.mean(axis=1)

    def is_worse(one, other):
        return mean[number[one]] > mean[number[other]] and ranking.distinguishable[number[one], number[other]]

    # a quarter of the yield, the same colour; half of it differs by as much as so few paths scatter
    assert is_worse(("dull", "green"), ("red", "green"))
    assert is_worse(("green", "dull"), ("green", "red"))
    # what the camera cannot tell from LED light
    assert is_worse(("red", "bluish"), ("red", "green"))
    assert is_worse(("bluish", "red"), ("green", "red"))
    # two calibrations of one paint
    assert not ranking.distinguishable[number["red", "green"], number["twin", "green"]]
    # the finger is the same from both sides
    assert not ranking.distinguishable[number["red", "green"], number["green", "red"]]
    best = {name for pair, rank in zip(found.pairs, ranking.best_share, strict=True) if rank for name in pair}
    assert best <= {"red", "twin", "green"}


@pytest.mark.renderer
def test_one_set_of_paths_gives_what_each_pair_gives_by_itself(llvm, paints):
    """Against the tracer that knows the pair: its reflectances, all orders of fluorescence, its own bands."""
    red, green = paints["red"], paints["green"]
    absorbing = replace(red, absorption_rel=np.exp(-0.5 * ((red.wavelength_nm - 500.0) / 50.0) ** 2))
    pale = replace(red, reflectance=np.minimum(0.1 + 0.6 * red.reflectance, 1.0))
    light, paths = DESIGN.light, ProbePaths(RAYS, REPEATS, 1)
    # the last emits where it reflects nothing, the others where they reflect nearly all
    chosen = ((absorbing, green), (green, absorbing), (pale, green), (like_the_led(red), green))
    pairs = [paint_bands(one, other, light) for one, other in chosen]
    traced = trace_pairs(finger(llvm), pairs, paths)
    rest = rest_shape(DESIGN)
    points = seen_points(DESIGN, rest, llvm, POINTS_ACROSS, POINTS_ALONG)
    facets = tilted_facets(points.normals, facet_slopes())
    for bands in pairs:
        conversions = {
            (band, wall): row[k] for wall, row in bands.conversion.items() for k, band in enumerate(BAND_NAMES)
        }
        found = traced.of(bands) @ chain_matrix(traced.chains, conversions).T
        alone = measure_together([DESIGN], rest, bands, llvm, points.probes, facets, paths, None)[0]
        # measured 0.2 to 2.5 %, of which up to 2 % are the coat's wavelength; without the lower ends light is negative
        assert (found >= 0.0).all()
        assert np.abs(found / alone - 1.0).mean(axis=(0, 1, 2)).max() < 0.035
        # of the colours relative to no contact, which the map from colour to normal takes
        relative = (found / found[:, :1]) / (alone / alone[:, :1])
        assert np.abs(relative - 1.0).mean(axis=(0, 1, 2)).max() < 0.015


@pytest.mark.renderer
def test_without_a_change_of_reflectance_it_is_the_same_to_rounding(llvm, paints):
    absorbing = replace(
        paints["red"], absorption_rel=np.exp(-0.5 * ((paints["red"].wavelength_nm - 500.0) / 50.0) ** 2)
    )
    bands = paint_bands(absorbing, paints["green"], DESIGN.light)
    traced = trace_pairs(finger(llvm), [bands], ProbePaths(RAYS, 1, 1))
    rest = rest_shape(DESIGN)
    points = seen_points(DESIGN, rest, llvm, POINTS_ACROSS, POINTS_ALONG)
    facets = tilted_facets(points.normals, facet_slopes())
    alone = measure_together([DESIGN], rest, bands, llvm, points.probes, facets, ProbePaths(RAYS, 1, 1), None)[0]
    conversions = {(band, wall): row[k] for wall, row in bands.conversion.items() for k, band in enumerate(BAND_NAMES)}
    found = traced.of(bands) @ chain_matrix(traced.chains, conversions).T
    # single precision of the renderer, and chains of four conversions and more: 1e-5 of a band
    np.testing.assert_allclose(found, alone, rtol=1e-4)


def test_what_cannot_be_compared_is_refused(scalar, paints):
    one = {"red": calibrated(paints["red"], 1)}
    with pytest.raises(SimulateError, match="needs at least two paints, got 1"):
        paint_pairs(finger(scalar), one, 1)
    two = one | {"green": calibrated(paints["green"], 2)}
    with pytest.raises(SimulateError, match="needs a compiled variant"):
        paint_pairs(finger(scalar), two, 1)
