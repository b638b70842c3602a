"""Light between the painted walls: form factors, and fluorescence of fluorescence against matrix inverses."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from data_schemas import Coating, FingerDesign, GelPad
from data_schemas._design_parts import Enclosure, Mirror, TactileCamera
from sim.optics import BAND_NAMES, TEXELS_ALONG, WALLS, PaintBands, open_scene, paint_bands
from sim.optics._painted_walls import TEXELS_UP, LightOfTexels, WallExchange, texel_uv
from sim.optics._wall_spline import WallSmoother
from sim.surface_meshes import rest_shape

TEXELS = TEXELS_ALONG * TEXELS_UP
AS_TRACED = WallSmoother(np.ones((1, 2, TEXELS_ALONG)), np.ones((1, 2, TEXELS_ALONG, TEXELS_UP)))
# a cube, whose opposite faces see much of each other, and the default pad, whose walls see little
CUBE, PAD = GelPad(length_mm=40.0, width_mm=40.0, thickness_mm=40.0), GelPad(refractive_index=1.0)
# both paints excite each other, which no real pair does: only then does every order add to both walls
FROM_LED, GREEN_BY_RED = {"red": 0.12, "green": 0.35}, 0.4
STANDARD_ERRORS = 4.0


def opposite_form_factor(a, b, apart):
    """Return the form factor of two aligned rectangles a x b that face each other (Howell's catalogue, C-11)."""
    x, y = a / apart, b / apart
    p, q = 1.0 + x * x, 1.0 + y * y
    turned = x * np.sqrt(q) * np.arctan(x / np.sqrt(q)) + y * np.sqrt(p) * np.arctan(y / np.sqrt(p))
    straight = x * np.arctan(x) + y * np.arctan(y)
    return 2.0 / (np.pi * x * y) * (0.5 * np.log(p * q / (p + q - 1.0)) + turned - straight)


def texel_kernel(pad):
    """Return the irradiance of texels of one wall by unit radiance of those of the other, (TEXELS, TEXELS).

    cos cos / r^2 per texel area: texels are points, which for the cube's, 5 mm high, is right to 0.24 % of the mean.
    """
    up, along = (texel_uv() * [pad.thickness_mm, pad.length_mm]).reshape(-1, 2).T
    between2 = (up[:, None] - up) ** 2 + (along[:, None] - along) ** 2
    area_mm2 = pad.thickness_mm * pad.length_mm / TEXELS
    return pad.width_mm**2 / (pad.width_mm**2 + between2) ** 2 * area_mm2


def bands_of(red_by_green):
    """Return paints that reflect nothing; only their conversions matter."""
    conversion = {wall: np.zeros(len(BAND_NAMES)) for wall in WALLS}
    for wall, other, by_other in (("red", "green", red_by_green), ("green", "red", GREEN_BY_RED)):
        conversion[wall][[BAND_NAMES.index(other), BAND_NAMES.index("led")]] = by_other, FROM_LED[wall]
    return PaintBands((None, None, None), dict.fromkeys(WALLS, np.zeros(3)), conversion, {})


def all_orders(kernel, irradiance, bands):
    """Return the walls' emission (wall, TEXELS) of all orders: (1 - K G / pi)^-1 K E / pi, a dense system."""
    system, first = np.eye(2 * TEXELS), np.empty((2, TEXELS))
    for k, (wall, other) in enumerate(zip(WALLS, WALLS[::-1], strict=True)):
        here, there = (slice(i * TEXELS, (i + 1) * TEXELS) for i in (k, 1 - k))
        system[here, there] = -bands.conversion[wall][BAND_NAMES.index(other)] / np.pi * kernel
        first[k] = bands.conversion[wall][BAND_NAMES.index("led")] / np.pi * irradiance[k].ravel()
    return np.linalg.solve(system, first.ravel()).reshape(2, TEXELS)


@dataclass
class Met:
    """What rays of each group have met."""

    led: np.ndarray
    by_wall: LightOfTexels


class EmptyBox:
    """Straight rays between two walls and nothing else, with plain arithmetic; a second light halves what arrives."""

    def __init__(self, pad):
        self.pad = pad

    def trace(self, origins_mm, directions, per_group, seed, from_wall):
        assert from_wall
        pad, group = self.pad, np.arange(len(origins_mm)) // per_group
        far = np.where(directions[:, 0] > 0.0, 0.5, -0.5) * pad.width_mm
        spot = origins_mm + ((far - origins_mm[:, 0]) / directions[:, 0])[:, None] * directions
        up, along = spot[:, 1] / pad.thickness_mm, spot[:, 2] / pad.length_mm
        hit = (up > 0.0) & (up < 1.0) & (along > 0.0) & (along < 1.0)
        whole = np.zeros((group[-1] + 1, 2, TEXELS_ALONG, TEXELS_UP), dtype=np.float32)
        at = group[hit], (far[hit] > 0.0).astype(int), (along[hit] * TEXELS_ALONG).astype(int)
        np.add.at(whole, (*at, (up[hit] * TEXELS_UP).astype(int)), 1.0 / per_group)
        whole = whole.reshape(len(whole), -1)
        kept_away = csr_array(whole.shape, dtype=np.float32), csr_array(0.5 * whole)
        return Met(np.zeros((len(whole), 2)), LightOfTexels(whole, kept_away))


def test_form_factor_of_the_test_is_that_of_the_catalogue():
    assert opposite_form_factor(1.0, 1.0, 1.0) == pytest.approx(0.1998, abs=1e-4)
    # the kernel is the same form factor, point by point: mean irradiance by unit radiance is pi F
    for pad in (CUBE, PAD):
        factor = opposite_form_factor(pad.length_mm, pad.thickness_mm, pad.width_mm)
        assert texel_kernel(pad).sum(axis=1).mean() == pytest.approx(np.pi * factor, rel=3e-3)


def test_orders_of_even_walls_are_a_geometric_series():
    """Evenly lit, evenly seen walls: L_r = (a_r + b_r F a_g) / (1 - b_r b_g F^2), whatever their texels."""
    factor, red_by_green, bands = 0.4, 0.6, bands_of(0.6)
    whole = np.zeros((2, TEXELS, 2, TEXELS), dtype=np.float32)
    whole[0, :, 1] = whole[1, :, 0] = factor / TEXELS
    whole = whole.reshape(2 * TEXELS, 2 * TEXELS)
    walls = WallExchange(
        np.zeros((1, 2, TEXELS_ALONG, TEXELS_UP)), LightOfTexels(whole, (csr_array(whole.shape),)), AS_TRACED
    )
    seen = walls.emitted(np.full((1, 2, TEXELS_ALONG, TEXELS_UP), np.pi), bands)[0]
    loop = red_by_green * GREEN_BY_RED * factor**2
    expected = {
        "red": (FROM_LED["red"] + red_by_green * factor * FROM_LED["green"]) / (1.0 - loop),
        "green": (FROM_LED["green"] + GREEN_BY_RED * factor * FROM_LED["red"]) / (1.0 - loop),
    }
    for k, wall in enumerate(WALLS):
        # orders up to the sixth are three rounds of the loop
        np.testing.assert_allclose(seen[k], expected[wall], rtol=1.01 * loop**3)
        assert (seen[k] < expected[wall]).all()


def test_orders_in_an_empty_box_are_those_of_a_dense_inverse():
    """Rays between two faces of a cube against quadrature: green excites 10 % of the red, unevenly lit."""
    bands, kernel = bands_of(0.2), texel_kernel(CUBE)
    design = FingerDesign(pad=CUBE)
    walls = WallExchange.traced(EmptyBox(CUBE), rest_shape(design), 400_000, np.random.default_rng(1))
    direct = np.broadcast_to(np.linspace(3.0, 0.5, TEXELS_ALONG)[:, None], (2, TEXELS_ALONG, TEXELS_UP))
    expected = all_orders(kernel, direct, bands)
    first = FROM_LED["red"] / np.pi * direct[0].mean()
    assert 0.08 < 1.0 - first / expected[0].mean() < 0.12
    seen, halved = walls.emitted(np.stack([direct, direct]), bands)
    # the ten per cent along the wall: 400 000 rays, of which a fifth meets the other face, smoothed over ten texels
    np.testing.assert_allclose(seen.mean(axis=2), expected.reshape(seen.shape).mean(axis=2), rtol=3e-3)
    # a light that keeps half of what the walls send away
    np.testing.assert_allclose(
        halved.mean(axis=2),
        all_orders(0.5 * kernel, direct, bands).reshape(seen.shape).mean(axis=2),
        rtol=3e-3,
    )


@pytest.mark.renderer
def test_traced_walls_of_a_black_finger_see_each_other_by_their_form_factor(llvm, black_paints):
    """The renderer's own paths, index 1 and everything black: straight lines between two rectangles 6 x 70 mm."""
    from sim.optics._angle_paths import AnglePaths

    design = FingerDesign(
        camera=TactileCamera(width_px=64, height_px=48),
        pad=PAD,
        coating=Coating(diffuse_share=1.0, diffuse_reflectance=0.0),
        mirror=Mirror(reflectance=0.0),
        enclosure=Enclosure(cloth_reflectance=0.0, base_reflectance=0.0),
    )
    shape, optics = rest_shape(design), paint_bands(*black_paints().values(), design.light)
    tracer = AnglePaths(open_scene(design, shape, optics, llvm), design, shape, [design.light])
    samples, bands = 400_000, bands_of(0.8)
    walls = WallExchange.traced(tracer, shape, samples, np.random.default_rng(2))
    factor = opposite_form_factor(PAD.length_mm, PAD.thickness_mm, PAD.width_mm)
    # each ray meets the other wall or does not
    error_rel = np.sqrt((1.0 - factor) / factor / samples)
    even, ones = replace(walls, led=np.zeros_like(walls.led)), np.ones((TEXELS_ALONG, TEXELS_UP))
    exchange = walls.exchange.of_light(0).reshape(2, TEXELS_ALONG, TEXELS_UP, 2, TEXELS)
    arriving = walls.smoother(exchange.sum(axis=(3, 4))[None])[0]
    for here in range(2):
        assert arriving[here].mean() == pytest.approx(factor, rel=STANDARD_ERRORS * error_rel)
        # a wall is flat and does not see itself
        assert np.abs(exchange[here, :, :, here]).max() == 0.0
    direct = np.stack([ones, 2.0 * ones]) * np.linspace(2.0, 0.5, TEXELS_ALONG)[:, None]
    expected, seen = all_orders(texel_kernel(PAD), direct, bands), even.emitted(direct[None], bands)[0]
    second = 1.0 - FROM_LED["red"] / np.pi * direct[0].mean() / expected[0].mean()
    assert 0.08 < second < 0.25
    for k in range(2):
        added = expected[k].mean() - FROM_LED[WALLS[k]] / np.pi * direct[k].mean()
        assert seen[k].mean() == pytest.approx(expected[k].mean(), abs=2.0 * STANDARD_ERRORS * error_rel * added)
