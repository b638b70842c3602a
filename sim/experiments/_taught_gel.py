r"""A few real ball presses of a flat sensor teach a physical model of it, which then predicts presses of other depth.

The gel is an elastic layer under a ball, :func:`sim.mechanics.press_layer`, lit by three straight strips. In channel c

.. math:: S_c / B_c = \left( \frac{a_c + \sum_l w_{cl} E_l(n, u)}{a_c + \sum_l w_{cl} E_l(n_0, 0)} \right)^{\gamma},
          \qquad E_l = \overline{f(n \cdot d_l / |d_l|) / |d_l|^2}

with the normal n and the place of the pressed coat, d_l from there to a point of strip l, over whose length the mean is
taken, and without contact n_0 = (0, 0, 1). A strip lies across the direction in which it shines, parallel to the coat.
As it is not thin, its light does not end at a sharp line on the coat: f(x) is the mean of max(x, 0) over a normal
distribution of width s around x. The exponent is that of the camera's tone curve. A ratio needs neither the level of
the light nor the paint's shade.
Free are the strips' places and colours, their common length and s, light a_c that comes from everywhere, the exponent,
the layer's thickness, and how deep a ball is by its labelled circle of radius r: the cap's height times a factor, some
2 on a thick layer and 1 on a thin one, at a middle circle, and in proportion to a power of r.

No cast shadows, no second bounce, no highlights: where these rule, the full renderer must be fitted in its place.
The layer is that of small strains, at depths of a fifth of the gel and more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri, stdtrit

from data_schemas import CHANNELS, SimulatedPress, SimulateError, TactileCapture
from finray_calib.compare import levelled_images, predicted_press
from finray_calib.sensing import contact_distance, contact_sha256
from sim.mechanics import press_layer

Floats = NDArray[np.float64]

GEL_LABEL: Final = "elastic gel under three lights, fitted to other presses"
LEAST_TEACHING_PRESSES: Final = 3
"""Fewer give no interval, which leaves out one press at a time."""

POISSON_RATIO: Final = 0.49
#: Thickness and depth in ball radii for which the pressed layer is computed; between them it is interpolated, and a
#: thinner or thicker gel counts as the last one.
_THICKNESSES: Final = 0.3 * 1.6 ** np.arange(9)
_DEPTHS: Final = np.array([0.005, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0])
#: Half-width of the grid and its step, and distances from the middle, in about contact radii.
_HALF_GRID, _STEP = 6.0, 1.0 / 12.0
_PLACES: Final = np.concatenate([np.linspace(0.0, 0.96, 13), np.linspace(0.98, 1.6, 32), np.linspace(1.65, 5.0, 50)])
#: Steeper slopes are no part of a height map; pixels beyond this many half-widths teach nothing.
_STEEPEST, _REACH = 4.0, 2.6
#: Circles are drawn by hand to a pixel or two; the deepest are as wide as the ball.
_NEAREST_RIM, _LARGEST_CIRCLE = 0.999, 1.03
#: What the model leaves unexplained, of the image's level, at first and at least: then as much as it left unexplained.
#: It is smooth, so that a press shows it at few independent places.
_MODEL_ERROR, _LEAST_ERROR, _INDEPENDENT = 0.05, 0.003, 50
_STRIDE_PX, _LEAST_SEEN = 4, 0.2
_MOST_EVALUATIONS: Final = 200
_COVERAGE: Final = 0.95
#: Places along a strip of light and their weights, as shares of half the angle under which it is seen: so also a strip
#: many times as long as it is far away is met where its light comes from.
_ALONG, _WEIGHTS = np.polynomial.legendre.leggauss(9)


@dataclass(frozen=True, slots=True)
class GelParameter:
    """One fitted number of the model with its interval over presses.

    Attributes
    ----------
    name
        In words.
    value, low95, high95
        Estimate, and a 95 % interval from the curvature of the posterior at it (prior included) joined with the scatter
        over presses that are left out one after the other (Student's t). What the model lacks is not in it.
    unit
        "1" for a ratio.
    """

    name: str
    value: float
    low95: float
    high95: float
    unit: str


@dataclass(frozen=True, slots=True)
class FittedGel:
    """A model that presses of one sensor have taught.

    Attributes
    ----------
    theta
        Free numbers, standardised by their priors.
    start
        Directions of the lights from which the fit began, rad, (3,).
    circle_rel
        Radius of a middle circle of the presses that taught, in ball radii.
    shape_px
        Rows and columns of the images.
    mm_per_px, ball_radius_mm
        Of the presses that taught.
    training_presses, training_sha256
        Names of the presses, and SHA-256 of their contact images.
    numbers
        What was found.
    """

    theta: Floats
    start: Floats
    circle_rel: float
    shape_px: tuple[int, int]
    mm_per_px: float
    ball_radius_mm: float
    training_presses: tuple[str, ...]
    training_sha256: tuple[str, ...]
    numbers: tuple[GelParameter, ...]


@dataclass(frozen=True, slots=True)
class _Press:
    """Pixels of a press that teach, and where they lie.

    In ball radii: ``circle_rel``, the radius of the labelled circle, ``across`` and ``down`` from the contact's
    middle, ``x`` and ``y`` from the picture's; ``ratio`` (pixel, 3) is contact over no contact, NaN where clipped.
    """

    circle_rel: float
    across: Floats
    down: Floats
    x: Floats
    y: Floats
    ratio: Floats


@lru_cache(maxsize=1)
def _pressed_layers() -> tuple[Floats, Floats]:
    """Return contact radius (thickness, depth) and sunk depth (thickness, depth, place), all in ball radii.

    Lengths scale: a ball of one radius stands for all.
    """
    radii = np.empty((len(_THICKNESSES), len(_DEPTHS)))
    sunk = np.empty((*radii.shape, len(_PLACES)))
    for j, depth in enumerate(_DEPTHS):
        step = _STEP * min(np.sqrt(1.5 * depth), 1.0)
        grid = step * np.arange(-round(_HALF_GRID / _STEP), round(_HALF_GRID / _STEP) + 1)
        away, middle = np.hypot(grid[:, None], grid[None, :]), len(grid) // 2
        cap = np.where(away < 1.0, 1.0 - np.sqrt(np.maximum(1.0 - away**2, 0.0)), np.inf)
        for i, thickness in enumerate(_THICKNESSES):
            layer = press_layer(depth - cap, grid, grid, float(thickness), POISSON_RATIO)
            radii[i, j] = np.sqrt((layer.pressure_rel > 0.0).sum() / np.pi) * step
            sunk[i, j] = np.interp(_PLACES * radii[i, j], grid[middle:], layer.sunk_mm[middle, middle:])
    return radii, sunk


def _profile(thickness: float, depth: float) -> tuple[Floats, Floats]:
    """Return places and sunk depths along a radius, in ball radii, by interpolation; inside the contact the ball's."""
    radii, sunk = _pressed_layers()
    i, s = _between(np.log(_THICKNESSES), np.log(thickness))
    j, t = _between(np.log(_DEPTHS), np.log(depth))
    weights = np.outer([1.0 - s, s], [1.0 - t, t])
    radius = float((weights / np.sqrt(_DEPTHS[None, j : j + 2]) * radii[i : i + 2, j : j + 2]).sum() * np.sqrt(depth))
    outside = np.einsum("ij,ijp->p", weights / _DEPTHS[None, j : j + 2], sunk[i : i + 2, j : j + 2]) * depth
    places = _PLACES * radius
    inside = depth - 1.0 + np.sqrt(np.maximum(1.0 - places**2, 0.0))
    return places, np.where((_PLACES <= 1.0) & (places < 1.0), inside, outside)


def _between(grid: Floats, value: float) -> tuple[int, float]:
    """Return the interval of a grid and the share of it, at the ends that of the first or last."""
    at = int(np.clip(np.searchsorted(grid, value) - 1, 0, len(grid) - 2))
    return at, float(np.clip((value - grid[at]) / (grid[at + 1] - grid[at]), 0.0, 1.0))


# name in words, unit, mean and standard deviation of the prior; of all but directions, offsets and the power the
# logarithm is normal
_LIGHT = (
    ("direction of the {} light", "deg", 0.0, 0.5),
    ("distance of the {} light from the middle of the picture", "mm", 1.6, 1.0),
    ("height of the {} light below the coat", "mm", 0.9, 1.0),
)
_COLOURS, _AMBIENT = (-2.0, 1.5), (-1.5, 1.5)
_SHARED = (
    ("exponent of the tone curve", "1", np.log(0.5), 0.3),
    ("thickness of the gel", "mm", np.log(2.5), 0.8),
    ("depth / that of the labelled cap, at a middle circle", "1", np.log(1.8), 0.3),
    ("half-length of the lights / their distance", "1", np.log(0.3), 1.0),
    ("softness of the lights, as a sine", "1", np.log(0.1), 1.0),
)
# of a circle drawn without error 2 in a soft layer, where depth is radius squared over the ball's radius
_POWER = (("power of the circle's radius that the depth grows with", "1", 2.0, 1.0),)
# in ball radii: circles are drawn by hand, and a lens that looks askance moves them all alike
_OFFSETS = (
    ("contact right of its labelled circle", "mm", 0.0, 0.1),
    ("contact below its labelled circle", "mm", 0.0, 0.1),
)


def _prior() -> tuple[Floats, Floats]:
    """Return mean and standard deviation of all free numbers: 9 of places, 9 of colours, 5 shared, 3 of circles."""
    places = [line[2:] for _ in range(3) for line in _LIGHT]
    colours = [(_COLOURS, _COLOURS, _AMBIENT) for _ in range(3)]
    lines = [
        *places,
        *(one for three in colours for one in three),
        *(line[2:] for line in (*_SHARED, *_OFFSETS, *_POWER)),
    ]
    mean, sd = np.array(lines).T
    return mean, sd


@dataclass(frozen=True, slots=True)
class _Lights:
    """Free numbers in the units of the model: lengths in ball radii; ``circle_rel`` is that of a middle circle."""

    azimuth: Floats
    distance: Floats
    height: Floats
    weights: Floats
    ambient: Floats
    exponent: float
    thickness_rel: float
    depth_rel: float
    half_length: Floats
    softness_rel: float
    offset: Floats
    depth_exponent: float
    circle_rel: float

    @classmethod
    def of(cls, theta: Floats, start: Floats, circle_rel: float) -> "_Lights":
        """Return what standardised numbers mean."""
        mean, sd = _prior()
        values = mean + sd * theta
        places, colours = values[:9].reshape(3, 3), np.exp(values[9:18].reshape(3, 3))
        weights = np.eye(3)
        for c in range(3):  # the first two are those of the other lights, in order
            weights[c, [light for light in range(3) if light != c]] = colours[c, :2]
        exponent, thickness, depth, length, softness = np.exp(values[18:23])
        distance = np.exp(places[:, 1])
        return cls(
            start + places[:, 0], distance, np.exp(places[:, 2]), weights, colours[:, 2], exponent, thickness, depth,
            length * distance, softness, values[23:25], values[25], circle_rel,
        )  # fmt: skip

    def depth(self, circle_rel: float) -> float:
        """Return how deep a ball is pressed whose labelled circle has this radius, in ball radii."""
        return float(self.depth_rel * _cap(self.circle_rel) * (circle_rel / self.circle_rel) ** self.depth_exponent)

    def ratio(self, press: _Press) -> Floats:
        """Return contact over no contact of each pixel and channel, (pixel, 3)."""
        places, sunk = _profile(self.thickness_rel, self.depth(press.circle_rel))
        across, down = press.across - self.offset[0], press.down - self.offset[1]
        away = np.hypot(across, down)
        outward = np.clip(np.interp(away, places, np.gradient(sunk, places), right=0.0), -_STEEPEST, _STEEPEST)
        outward /= np.maximum(away, np.finfo(float).tiny)
        slopes = outward * across, outward * down
        pressed = self._light((press.x, press.y), slopes, np.interp(away, places, sunk))
        rest = self._light((press.x, press.y), (0.0, 0.0), 0.0)
        middle = self._light((0.0, 0.0), (0.0, 0.0), 0.0)
        lit, unlit = ((light / middle) @ self.weights.T + self.ambient for light in (pressed, rest))
        return np.asarray((lit / unlit) ** self.exponent)

    def _light(
        self, at: tuple[Floats | float, Floats | float], slopes: tuple[Floats | float, Floats | float],
        sunk: Floats | float,
    ) -> Floats:  # fmt: skip
        """Return what each light gives to places of the coat, (place, 3)."""
        steep = np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
        found = []
        for azimuth, distance, height, half in zip(
            self.azimuth, self.distance, self.height, self.half_length, strict=True
        ):
            along, across, given = np.cos(azimuth), np.sin(azimuth), np.zeros(())
            for place, weight in zip(*_strip(half, np.hypot(distance, height)), strict=True):
                to = distance * along - place * across - at[0], distance * across + place * along - at[1], height - sunk
                square = to[0] ** 2 + to[1] ** 2 + to[2] ** 2
                facing = (to[2] - slopes[0] * to[0] - slopes[1] * to[1]) / (steep * np.sqrt(square))
                given = given + weight * self._soft(facing) / square
            found.append(given)
        return np.stack(found, axis=-1)

    def _soft(self, facing: Floats | float) -> Floats:
        """Return the mean of max(x, 0) over a normal distribution around the cosine of a light."""
        share = np.divide(facing, self.softness_rel)
        return np.asarray(self.softness_rel * _NORMAL * np.exp(-0.5 * share**2) + facing * ndtr(share))


_NORMAL: Final = 1.0 / np.sqrt(2.0 * np.pi)


def _strip(half_length: float, away: float) -> tuple[Floats, Floats]:
    """Return places along a strip of light that is so far away, from its middle, and weights, whose sum is one."""
    widest = np.arctan2(half_length, away)
    angles = widest * _ALONG
    weights = 0.5 * _WEIGHTS * widest * away / (half_length * np.cos(angles) ** 2)
    return away * np.tan(angles), weights / weights.sum()


def _cap(circle_rel: float) -> float:
    """Return the height of a ball's cap over a circle, all in ball radii."""
    return float(1.0 - np.sqrt(1.0 - circle_rel**2))


def fit_gel(captures: Sequence[TactileCapture]) -> FittedGel:
    """Fit the model to ball presses of one sensor.

    Parameters
    ----------
    captures
        Three presses or more, each with the circle of its contact, the ball's radius and the scale. The gain of each
        against its no-contact image is taken from pixels far from the contact.

    Returns
    -------
    FittedGel
        The numbers with the greatest posterior density, and their intervals.

    Raises
    ------
    SimulateError
        There are too few, one lacks what is needed, or they are not of one sensor and ball.
    """
    if len(captures) < LEAST_TEACHING_PRESSES:
        raise SimulateError(
            f"there are only {len(captures)} training presses, but the model of an elastic gel needs at least "
            f"{LEAST_TEACHING_PRESSES}"
        )
    first = captures[0]
    radius_mm, scale = _ball_and_scale(first)
    digests = tuple(contact_sha256(capture) for capture in captures)
    twice = [capture.name for k, capture in enumerate(captures) if digests[k] in digests[:k]]
    if twice:
        raise SimulateError(f"{twice[0]}: the same contact image is given twice; give each press only once")
    for capture in captures[1:]:
        if _ball_and_scale(capture) != (radius_mm, scale) or capture.contact.shape != first.contact.shape:
            raise SimulateError(
                f"{capture.name}: the ball, the scale or the size of the picture differs from {first.name}; train with "
                "one ball and one camera"
            )
    presses = [_press(capture, taught=True) for capture in captures]
    for capture, press in zip(captures, presses, strict=True):
        _require_seen(capture, press)
    start = _Start(_directions(presses), float(np.median([press.circle_rel for press in presses])))
    theta, _ = _fitted(presses, start, np.zeros(len(_prior()[0])), _MODEL_ERROR)
    error = max(_unexplained(presses, start.lights(theta)), _LEAST_ERROR)
    theta, curvature = _fitted(presses, start, theta, error)
    rests = ([*presses[:k], *presses[k + 1 :]] for k in range(len(presses)))
    without = np.array([_fitted(rest, start, theta, error)[0] for rest in rests])
    shape = _distance(first).shape
    return FittedGel(
        theta, start.directions, start.circle_rel, (shape[0], shape[1]), scale, radius_mm,
        tuple(c.name for c in captures), digests, _numbers(theta, curvature, without, start.directions, radius_mm),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Start:
    """What a fit begins from: directions of the lights, rad, (3,), and the radius of a middle circle, ball radii."""

    directions: Floats
    circle_rel: float

    def lights(self, theta: Floats) -> _Lights:
        """Return what standardised numbers mean."""
        return _Lights.of(theta, self.directions, self.circle_rel)


def _require_seen(capture: TactileCapture, press: _Press) -> None:
    """Refuse a press that shows too little of its contact."""
    if not len(press.ratio):
        raise SimulateError(f"{capture.name}: the contact circle lies outside the picture; correct contact_circle")
    seen = np.isfinite(press.ratio).mean(axis=0)
    if seen.min() < _LEAST_SEEN:
        channel = int(seen.argmin())
        raise SimulateError(
            f"{capture.name}: near the contact {100 * (1.0 - seen[channel]):.0f} % of the {CHANNELS[channel]} values "
            "are clipped, or dark without contact; leave this press out, or capture it at another exposure"
        )


def predict_on_gel(gel: FittedGel, capture: TactileCapture) -> SimulatedPress:
    """Return what the model makes of the no-contact image of a capture, with the contact where the capture has it.

    Raises
    ------
    SimulateError
        The capture lacks circle, ball or scale, has another size, or taught the model itself.
    """
    if contact_sha256(capture) in gel.training_sha256:
        raise SimulateError(
            f"{capture.name}: the model was trained on this contact image (training presses: "
            f"{', '.join(gel.training_presses)}), so the model's prediction for this press proves nothing; leave the "
            "press out"
        )
    distance = _distance(capture)
    if distance.shape != gel.shape_px:
        raise SimulateError(
            f"{capture.name}: the size of the picture differs from the model's training presses; give captures of the "
            "same camera"
        )
    if _ball_and_scale(capture) != (gel.ball_radius_mm, gel.mm_per_px):
        raise SimulateError(
            f"{capture.name}: the ball or the scale differs from the model's training presses (a ball of "
            f"{gel.ball_radius_mm:g} mm radius at {gel.mm_per_px:g} mm per pixel); give captures with that ball and "
            "scale"
        )
    ratio = (
        _Lights.of(gel.theta, gel.start, gel.circle_rel)
        .ratio(_press(capture, taught=False))
        .reshape(*distance.shape, -1)
    )
    taught = f"fitted to {len(gel.training_presses)} other presses: {', '.join(gel.training_presses)}"
    return predicted_press(capture, ratio, distance, ("elastic gel", GEL_LABEL, "rendered"), taught)


def _ball_and_scale(capture: TactileCapture) -> tuple[float, float]:
    """Return the ball's radius and the side of a pixel of the colour image, mm."""
    pose, cell = capture.indenter, 1 if capture.layout == "RGB" else 2
    if pose.shape != "ball" or pose.radius_mm is None or capture.mm_per_px is None or capture.contact_circle is None:
        raise SimulateError(
            f"{capture.name}: contact_circle, indenter.radius_mm or mm_per_px is missing, or the indenter is not a "
            "ball, but the model of an elastic gel needs the circle of a ball's contact, the ball's radius and the "
            "scale"
        )
    return pose.radius_mm, capture.mm_per_px * cell


def _distance(capture: TactileCapture) -> Floats:
    """Return the distance from the contact of a capture that states it, half-widths."""
    distance = contact_distance(capture)
    if distance is None:
        raise SimulateError(
            f"{capture.name}: the capture does not state where the contact is; import the capture with a circle, an "
            "outline or a search"
        )
    return distance


def _press(capture: TactileCapture, *, taught: bool) -> _Press:
    """Return the pixels of a capture: those that teach, or all of them without what they show."""
    radius_mm, scale = _ball_and_scale(capture)
    distance = _distance(capture)
    circle, cell, step = capture.contact_circle, 1 if capture.layout == "RGB" else 2, scale / radius_mm
    half_width = 0.0 if circle is None else circle.radius_px / cell * step
    if circle is None or half_width > _LARGEST_CIRCLE:
        raise SimulateError(
            f"{capture.name}: the contact circle of {half_width * radius_mm:.3g} mm radius is larger than the ball of "
            f"{radius_mm:g} mm radius; correct contact_circle, mm_per_px or indenter.radius_mm"
        )
    half_width = min(half_width, _NEAREST_RIM)
    used = np.ones(distance.shape, dtype=np.bool_)
    ratio = np.empty((0, 3))
    if taught:
        used = (distance < _REACH) & (np.indices(distance.shape) % _STRIDE_PX == 0).all(axis=0)
        ratio = _seen_ratio(capture, distance)[used]
    rows, columns = (at.astype(np.float64) for at in np.nonzero(used))
    middle = [(value + 0.5) / cell - 0.5 for value in (circle.column_px, circle.row_px)]
    return _Press(
        half_width,
        (columns - middle[0]) * step,
        (rows - middle[1]) * step,
        (columns - (distance.shape[1] - 1) / 2.0) * step,
        (rows - (distance.shape[0] - 1) / 2.0) * step,
        ratio,
    )


def _seen_ratio(capture: TactileCapture, distance: Floats) -> Floats:
    """Return contact over no contact, (H, W, 3), the gain between the two taken out; NaN where clipped."""
    contact, level = levelled_images(capture, distance)
    return np.divide(contact, level, out=np.full_like(level, np.nan), where=level > 0.0)


def _directions(presses: Sequence[_Press]) -> Floats:
    """Return from where each channel is lit, rad: the coat that bulges into the gel is brighter on that side."""
    found = []
    for channel in range(3):
        pull = np.zeros(2)
        for press in presses:
            change = np.nan_to_num(press.ratio[:, channel] - 1.0)
            pull += [float(change @ press.across), float(change @ press.down)]
        found.append(np.arctan2(pull[1], pull[0]))
    return np.array(found)


def _unexplained(presses: Sequence[_Press], lights: _Lights) -> float:
    """Return the rms of what a model leaves of the ratios."""
    left = np.concatenate([(lights.ratio(press) - press.ratio).ravel() for press in presses])
    return float(np.sqrt(np.nanmean(left**2)))


def _fitted(presses: Sequence[_Press], start: _Start, theta: Floats, error: float) -> tuple[Floats, Floats]:
    """Return the numbers of greatest posterior density, and its curvature there, for an error of the model.

    Raises
    ------
    SimulateError
        The search did not come to its end.
    """

    def misfit(at: Floats) -> Floats:
        lights = start.lights(at)
        parts = [at]
        for press in presses:
            weight = np.sqrt(_INDEPENDENT / max(len(press.ratio), 1)) / error
            parts.append(weight * np.nan_to_num(lights.ratio(press) - press.ratio).ravel())
        return np.concatenate(parts)

    found = least_squares(misfit, theta, max_nfev=_MOST_EVALUATIONS)
    if found.status < 1:
        raise SimulateError(
            f"the fit of the model of an elastic gel did not converge in {_MOST_EVALUATIONS} steps; check that "
            "circles, ball and scale are those of the presses"
        )
    slopes = np.asarray(found.jac, dtype=np.float64)
    return np.asarray(found.x), slopes.T @ slopes


def _numbers(
    theta: Floats, curvature: Floats, without: Floats, start: Floats, radius_mm: float
) -> tuple[GelParameter, ...]:
    """Return what was found, with intervals."""
    count = len(without)
    spread = np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    known = np.sqrt(np.diag(np.linalg.inv(curvature)))
    tails = 0.5 + _COVERAGE / 2.0
    reach = np.hypot(float(ndtri(tails)) * known, float(stdtrit(count - 1, tails)) * spread)
    mean, sd = _prior()
    ends = mean + sd * np.stack([theta, theta - reach, theta + reach])
    found = []
    for light, channel in enumerate(CHANNELS):
        for k, (words, unit, *_) in enumerate(_LIGHT):
            values = ends[:, 3 * light + k]
            told = np.degrees(start[light] + values) if unit == "deg" else radius_mm * np.exp(values)
            found.append(_number(words.format(channel), told, unit))
    for k, (words, unit, *_) in enumerate(_SHARED):
        told = (radius_mm if unit == "mm" else 1.0) * np.exp(ends[:, 18 + k])
        found.append(_number(words, told, unit))
    for k, (words, unit, *_) in enumerate((*_OFFSETS, *_POWER)):
        found.append(_number(words, (radius_mm if unit == "mm" else 1.0) * ends[:, 23 + k], unit))
    return tuple(found)


def _number(name: str, told: Floats, unit: str) -> GelParameter:
    """Return a number from its estimate and the ends of its interval."""
    value, low, high = (float(one) for one in told)
    return GelParameter(name, value, low, high, unit)
