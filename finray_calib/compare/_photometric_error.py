"""How far a simulated press is from a capture: metrics of the noise-free images with what their inputs leave open.

Draws of the metrics of every region, of the sweep's objective as seen in an image (brightness beside the indenter), the
uncertainty budget (what each input does alone), and the validation statement per part of the region and channel, after
ASME V&V 20, with the area validation metric.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, InputUncertainty, Interval, ObjectiveError, TactileCapture, ValidationCell
from finray_calib.compare._comparison import Comparison
from finray_calib.compare._input_draws import (
    DRIFT,
    PIXELS,
    POSE,
    PRIOR_DRIFT_REL,
    WALLS,
    InputDraws,
    Inputs,
    Propagated,
    ends,
    pose_sd_mm,
    propagate,
)
from finray_calib.compare._prepared_images import Nuisances
from finray_calib.compare._region_sums import RegionSums
from finray_calib.compare._regions import every_channel, pixels_within, tile_indices, tile_side_px
from finray_calib.spectra import compiled

Floats = NDArray[np.float64]
CANDIDATES = ("do nothing", "simulation", "floor")


@dataclass(frozen=True, slots=True)
class RegionDraws:
    """Hold draws (draws, 3) of sums over a region.

    Attributes
    ----------
    error : dict of str to ndarray
        Squared error of each candidate; that of doing nothing is the contact signal.
    level : ndarray
        Sum of the captured values (of gradients: of the levels they are relative to).
    pixels : int
    """

    error: dict[str, Floats]
    level: Floats
    pixels: int

    def skill(self, candidate: str, channel_weights: Floats) -> Floats:
        """Return draws of 1 - sum w error / sum w signal, but for those of parts without any signal."""
        signal = self.error["do nothing"] @ channel_weights
        drawn = signal != 0.0
        return np.asarray(1.0 - (self.error[candidate] @ channel_weights)[drawn] / signal[drawn])

    def channel_skill(self, candidate: str) -> Floats:
        """Return draws (draws, 3) of the skill of each channel; not finite where contact changes nothing."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1.0 - self.error[candidate] / self.error["do nothing"])

    def relative_rms(self, candidate: str) -> Floats:
        """Return draws (draws, 3) of sqrt(mean error) / mean level; 0 where noise leaves nothing."""
        mean = self.level / self.pixels
        return np.asarray(np.sqrt(np.maximum(self.error[candidate], 0.0) / self.pixels) / mean)

    def relative_rms_of_all(self, candidate: str) -> Floats:
        """Return draws (draws,) of the root mean square of the relative error; 0 where noise leaves nothing."""
        squares = self.error[candidate] / self.pixels / (self.level / self.pixels) ** 2
        return np.asarray(np.sqrt(np.maximum(squares.mean(axis=1), 0.0)))


def propagated_draws(
    sums: RegionSums, drawn: InputDraws, exposure: Floats, rng: np.random.Generator | None
) -> RegionDraws:
    """Return draws of the sums for draws of the inputs; the pixels' noise varies where there is a generator."""
    draws = len(exposure)
    errors = {
        "simulation": sums.simulation(drawn.weights, exposure, drawn.drift),
        "do nothing": sums.signal(drawn.drift),
    }
    if sums.floor is not None:
        errors["floor"] = np.repeat(sums.floor[None], draws, axis=0)
    if rng is not None:
        of_error, of_signal = sums.noise.draw(draws, rng)
        errors["simulation"] = errors["simulation"] + of_error
        errors["do nothing"] = errors["do nothing"] + of_signal
        if "floor" in errors:
            errors["floor"] = errors["floor"] + sums.floor_noise_sd * rng.standard_normal((draws, 3))
    return RegionDraws(errors, drawn.drift[:, None] * sums.level, sums.pixels)


@dataclass(frozen=True, slots=True)
class TileSums:
    """Hold the sums of a region's squares over its square tiles; arrays of shape (tiles, 3).

    Attributes
    ----------
    squares : Mapping of str to ndarray
        "error", "signal", perhaps "floor", and "level".
    pixels_of : ndarray of int, shape (tiles,)
    pixels : int
    """

    squares: Mapping[str, Floats]
    pixels_of: NDArray[np.intp]
    pixels: int


def _drawn(kinds: Sequence[TileSums], draws: int, rng: np.random.Generator) -> RegionDraws:
    """Return draws of the sums over as many tiles, drawn with replacement; each kind of sums has its share of them."""
    first = kinds[0]
    tiles, each = len(first.pixels_of), draws // len(kinds)
    counts = _times_drawn(tiles, each * len(kinds), rng)
    # the number of pixels differs from draw to draw; the sums are brought to that of the region
    share = first.pixels / (counts @ first.pixels_of)[:, None]
    counts = counts.reshape(len(kinds), each, tiles)

    def of(name: str) -> Floats:
        return np.asarray(share * (counts @ np.stack([kind.squares[name] for kind in kinds])).reshape(share.size, -1))

    names = {"simulation": "error", "do nothing": "signal", "floor": "floor"}
    errors = {n: of(name) for n, name in names.items() if name in first.squares}
    return RegionDraws(errors, of("level"), first.pixels)


def _times_drawn(tiles: int, draws: int, rng: np.random.Generator) -> Floats:
    """Return how often each tile is drawn (draws, tiles), of as many tiles drawn with replacement: a multinomial.

    Counting the drawn tiles takes a fifth of the time of the generator's own multinomial.
    """
    drawn = rng.integers(tiles, size=(draws, tiles)) + tiles * np.arange(draws)[:, None]
    return np.bincount(drawn.ravel(), minlength=draws * tiles).reshape(draws, tiles).astype(np.float64)


@dataclass(frozen=True, slots=True)
class _Tiles:
    """Which tile each of a region's numbers lies in (numbers,), of how many."""

    of_number: NDArray[np.intp]
    tiles: int

    def sums(self, values: Floats) -> Floats:
        """Return the sums (tiles, 3) of values (numbers, 3)."""
        return np.stack([np.bincount(self.of_number, weights=v, minlength=self.tiles) for v in values.T], axis=1)

    def of(self, sums: RegionSums, changed: Mapping[str, Floats] | None = None) -> TileSums:
        """Return the sums of a region's squares, some of them `changed`, (tiles, 3) each."""
        given = changed or {}
        squares = {n: given[n] if n in given else self.sums(values) for n, values in sums.per_pixel.items()}
        return TileSums(squares, np.bincount(self.of_number, minlength=self.tiles), sums.pixels)


def _tiles_of(sums: RegionSums) -> _Tiles:
    """Return the tiles of a region; of gradients both directions of a pixel lie in one."""
    tile = tile_indices(sums.where, tile_side_px(sums.where))
    return _Tiles(np.tile(tile, sums.pixels // len(tile)), int(tile.max()) + 1)


def resampled_draws(sums: RegionSums, draws: int, rng: np.random.Generator) -> RegionDraws:
    """Return draws of the sums over square tiles of the region, drawn with replacement.

    For images of which no input has a known uncertainty: the spread tells how much a number depends on which part of
    the region was looked at.
    """
    return _drawn([_tiles_of(sums).of(sums)], draws, rng)


RESAMPLED_DRAWS = 2000

_HEADLINE = "headline"


@dataclass(frozen=True, slots=True)
class RegionResult:
    """Hold the draws of one region and of its gradients."""

    images: RegionDraws
    gradients: RegionDraws | None


@dataclass(frozen=True, slots=True)
class ErrorDraws:
    """Hold the draws of every region.

    Attributes
    ----------
    regions : list of RegionResult
    whole : list of RegionResult or None
        The values over all of each region, where the draws come from parts of it.
    propagated : Propagated or None
        The draws of the inputs, where these have a known uncertainty.
    """

    regions: list[RegionResult]
    whole: list[RegionResult] | None
    propagated: Propagated | None


def error_draws(comparison: Comparison, rng: np.random.Generator) -> ErrorDraws:
    """Propagate the inputs where their uncertainty is known, else resample parts of the regions."""
    if comparison.inputs is None or comparison.layers.inputs is None:
        return ErrorDraws(resampled(comparison, rng), best(comparison), None)
    regions, all_draws = propagated(comparison, comparison.inputs, rng)
    return ErrorDraws(regions, None, all_draws)


def propagated(
    comparison: Comparison, inputs: Inputs, rng: np.random.Generator
) -> tuple[list[RegionResult], Propagated]:
    """Propagate all inputs until the headline skill is stable.

    Returns
    -------
    list of RegionResult
        One for each region.
    Propagated
        The draws behind them, with "exposure" among them, and whether the stopping rule was met.
    """

    def block(draws: int) -> dict[str, Floats]:
        drawn = comparison.conditioned(inputs.draw(draws, rng), rng)
        exposure = comparison.exposure_of(drawn.matrix, rng)
        found = {"exposure": exposure}
        for i, result in enumerate(_results(comparison, drawn, exposure, rng)):
            for part, of_part in (("images", result.images), ("gradients", result.gradients)):
                if of_part is not None:
                    found |= {f"{i} {part} {name}": values for name, values in of_part.error.items()}
                    found[f"{i} {part} level"] = of_part.level
            found[_HEADLINE] = result.images.skill("simulation", comparison.channel_weights)
        return found

    all_draws = propagate(block, _HEADLINE)
    return [_gathered(comparison, all_draws, i) for i in range(len(comparison.regions))], all_draws


def resampled(comparison: Comparison, rng: np.random.Generator) -> list[RegionResult]:
    """Return the regions' draws from parts of themselves, for images of which no input has a known uncertainty.

    Where a tone curve or gains are taken out, each of their draws gets its share of them.
    """
    drawn = _tile_draws(comparison, rng)
    regions = []
    for kinds, gradients in zip(drawn, comparison.gradients, strict=True):
        images = _drawn(kinds, RESAMPLED_DRAWS, rng)
        of_gradients = None if gradients is None else resampled_draws(gradients, RESAMPLED_DRAWS, rng)
        regions.append(RegionResult(images, of_gradients))
    return regions


def _tile_draws(comparison: Comparison, rng: np.random.Generator) -> list[list[TileSums]]:
    """Return the tiles of every region for each draw of tone curve and gains; a single one where there are none."""
    tiles = [_tiles_of(sums) for sums in comparison.sums]
    best = [of.of(sums) for of, sums in zip(tiles, comparison.sums, strict=True)]
    nuisances = comparison.nuisances
    if nuisances is None:
        return [[each] for each in best]
    found: list[list[TileSums]] = [[] for _ in tiles]
    for squares in square_draws(comparison, nuisances, tiles, rng):
        for kept, each, changed in zip(found, best, squares, strict=True):
            kept.append(replace(each, squares={**each.squares, **changed}))
    return found


def square_draws(
    comparison: Comparison, nuisances: Nuisances, tiles: Sequence[_Tiles], rng: np.random.Generator
) -> Iterator[list[dict[str, Floats]]]:
    """Yield the sums over tiles, (tiles, 3), of error, signal and level of every region for draws of curve and gains.

    The last region holds the others, so that a curve and gains are taken out of its pixels alone.
    """
    if nuisances.tone is None:
        yield from _squares_of_gains(comparison, tiles, nuisances.factor_draws(rng))
        return
    captured, k, widest = comparison.captured, comparison.best_exposure, comparison.sums[-1].where
    inside = [
        np.stack([np.flatnonzero(sums.where[widest]), of.of_number])
        for sums, of in zip(comparison.sums, tiles, strict=True)
    ]
    rest = captured.no_contact[widest]
    of_contact, of_rest = (captured.variance(i[widest]) for i in (captured.contact, captured.no_contact))
    everywhere = np.ones((1, len(rest)), dtype=np.bool_)
    for layers, contact in nuisances.at(widest).drawn(nuisances.tone, rng):
        first, second = (k * half @ layers.matrix.T for half in layers.halves("contact", everywhere))
        found = []
        for places, of in zip(inside, tiles, strict=True):
            sums = np.zeros((3, of.tiles, 3))
            add_squares(first, second, contact[0], rest, of_contact, of_rest, places, sums)
            found.append(dict(zip(("error", "signal", "level"), sums, strict=True)))
        yield found


def _squares_of_gains(
    comparison: Comparison, tiles: Sequence[_Tiles], factors: Floats
) -> Iterator[list[dict[str, Floats]]]:
    """Yield the sums of `square_draws` for factors (draws, 3) on the captured contact image D.

    Of (1 + g) D the error is (S1 - D)(S2 - D) - g D (S1 + S2 - 2 D) + g^2 D^2, and so is the signal: three more sums
    over tiles serve all draws.
    """
    captured, k, layers = comparison.captured, comparison.best_exposure, comparison.layers
    formed = []
    for sums, of in zip(comparison.sums, tiles, strict=True):
        d = sums.per_pixel["level"]
        twice = sum(half @ layers.matrix.T for half in layers.halves("contact", sums.where))
        rest = pixels_within(captured.no_contact, sums.where)
        best = of.of(sums).squares
        formed.append((best, of.sums(d * (k * twice - 2.0 * d)), of.sums(2.0 * d * (rest - d)), of.sums(d * d)))
    for g in factors - 1.0:
        yield [
            {
                "error": best["error"] - g * by_error + g**2 * square,
                "signal": best["signal"] - g * by_signal + g**2 * square,
                "level": (1.0 + g) * best["level"],
            }
            for best, by_error, by_signal, square in formed
        ]


@compiled
def add_squares(
    first: Floats, second: Floats, contact: Floats, rest: Floats, of_contact: Floats, of_rest: Floats,
    places: NDArray[np.intp], sums: Floats,
) -> None:  # fmt: skip
    """Add squared error, squared change by contact and level of some pixels, noise taken out, to their tiles' sums.

    Pixels are lists (P, 3) of both halves of the render, contact, no contact and the variances of their noise; places
    (2, n) are numbers of pixels, and of the tiles that they lie in.
    """
    for i in range(places.shape[1]):
        p, t = places[0, i], places[1, i]
        for c in range(contact.shape[1]):
            d, v = contact[p, c], of_contact[p, c]
            change = rest[p, c] - d
            sums[0, t, c] += (first[p, c] - d) * (second[p, c] - d) - v
            sums[1, t, c] += change * change - of_rest[p, c] - v
            sums[2, t, c] += d


def nuisance_skill_u(comparison: Comparison, rng: np.random.Generator) -> float:
    """Return the standard uncertainty of the headline skill from tone curve and gains alone; 0 without any."""
    if comparison.nuisances is None:
        return 0.0
    w, skills = comparison.channel_weights, []
    tiles = [_tiles_of(sums) for sums in comparison.sums]
    for squares in square_draws(comparison, comparison.nuisances, tiles, rng):
        error, signal = (squares[-1][name].sum(axis=0) for name in ("error", "signal"))
        skills.append(1.0 - error @ w / (signal @ w))
    return float(np.std(skills, ddof=1))


def best(comparison: Comparison) -> list[RegionResult]:
    """Return the regions at the best values of all inputs, as a single draw."""
    inputs = comparison.inputs or Inputs(comparison.layers, {}, None, None)
    drawn = inputs.best()
    return _results(comparison, drawn, comparison.exposure_of(drawn.matrix), None)


def _results(
    comparison: Comparison, drawn: InputDraws, exposure: Floats, rng: np.random.Generator | None
) -> list[RegionResult]:
    """Return the draws of all regions; noise of the pixels varies where there is a generator."""
    return [
        RegionResult(
            propagated_draws(sums, drawn, exposure, rng),
            None if gradients is None else propagated_draws(gradients, drawn, exposure, rng),
        )
        for sums, gradients in zip(comparison.sums, comparison.gradients, strict=True)
    ]


def _gathered(comparison: Comparison, all_draws: Propagated, i: int) -> RegionResult:
    """Return the draws of region `i` from all blocks."""
    found: dict[str, RegionDraws] = {}
    for part, sums in (("images", comparison.sums[i]), ("gradients", comparison.gradients[i])):
        if sums is not None:
            errors = {
                name: all_draws.draws[f"{i} {part} {name}"]
                for name in CANDIDATES
                if f"{i} {part} {name}" in all_draws.draws
            }
            found[part] = RegionDraws(errors, all_draws.draws[f"{i} {part} level"], sums.pixels)
    return RegionResult(found["images"], found.get("gradients"))


Bools = NDArray[np.bool_]
# The paper reads "a point near the indenter": a ring from the edge of the contact to half a half-width beyond.
RING = (1.0, 1.5)
STORED_DRAWS = 500


@dataclass(frozen=True, slots=True)
class BrightnessDraws:
    """Hold draws (draws, 3) of ln(k simulated / captured) per channel, and of the exposure factor k (draws,)."""

    log_ratio: Floats
    exposure: Floats

    def error_rel(self, captured_share: Floats) -> Floats:
        """Return draws (draws,) of simulated / captured - 1 of the white-balanced brightness.

        `captured_share` (3,) is the captured brightness of each channel over its own no-contact level.
        """
        return np.asarray(np.exp(self.log_ratio) @ captured_share / captured_share.sum() - 1.0)


def ring_of(distance: Floats, usable: Bools) -> Bools:
    """Return the usable pixels 1 to 1.5 contact half-widths from the indenter.

    Parameters
    ----------
    distance : ndarray, shape (H, W)
        From the contact's centre in half-widths, NaN off the pad.
    usable : ndarray of bool, shape (H, W)

    Raises
    ------
    CompareError
        There is none.
    """
    ring = usable & (distance >= RING[0]) & (distance <= RING[1])
    if not ring.any():
        raise CompareError(
            f"no usable pixel lies {RING[0]:g} to {RING[1]:g} contact half-widths from the indenter, because the press "
            "is too near the edge of the image or the image is clipped there"
        )
    return ring


def brightness_draws(
    comparison: Comparison, inputs: Inputs, ring: Bools, drawn: InputDraws, rng: np.random.Generator | None
) -> BrightnessDraws:
    """Return the brightness beside the indenter for draws; noise of the pixels varies where there is a generator.

    Parameters
    ----------
    comparison, inputs
        Both sides and what is uncertain.
    ring : ndarray of bool, shape (H, W)
    drawn
        Draws of the inputs.
    rng
        Generator of the noise.
    """
    draws = len(drawn.log_drift)
    exposure = comparison.exposure_of(drawn.matrix, rng)
    first, second = comparison.layers.halves("contact", ring, inputs.pose_names)
    simulated = exposure[:, None] * (drawn.weights @ ((first + second) / 2.0).mean(axis=0))
    contact = comparison.captured.contact
    captured = drawn.drift[:, None] * contact[ring].mean(axis=0)
    if rng is not None:
        count = ring.sum()
        captured_sd = np.sqrt(comparison.captured.variance(contact)[ring].mean(axis=0) / count)
        render_sd = comparison.best_exposure * np.sqrt(comparison.layers.contact_variance[ring].mean(axis=0) / count)
        captured = captured + captured_sd * rng.standard_normal((draws, 3))
        simulated = simulated + render_sd * rng.standard_normal((draws, 3))
    return BrightnessDraws(np.log(np.maximum(simulated, 1e-300) / np.maximum(captured, 1e-300)), exposure)


def captured_share(comparison: Comparison, ring: Bools, pad: Bools) -> Floats:
    """Return the captured brightness of the ring per channel, over the pad's level without contact, (3,)."""
    captured = comparison.captured
    usable = pad & every_channel(np.isfinite(captured.no_contact))
    return np.asarray(captured.contact[ring].mean(axis=0) / captured.no_contact[usable].mean(axis=0))


def objective_error(
    comparison: Comparison,
    inputs: Inputs,
    ring: Bools,
    share: Floats,
    capture: TactileCapture,
    rng: np.random.Generator,
) -> ObjectiveError:
    """Return the record of the error of the sweep's objective, with draws that reports can share."""
    draws = brightness_draws(comparison, inputs, ring, inputs.draw(STORED_DRAWS, rng, paired=True), rng)
    error = draws.error_rel(share)
    low, high = ends(error)
    known = comparison.layers.inputs
    exposed = capture.exposure_s is not None and capture.led_current_ma is not None
    log_exposure = None
    if exposed:
        log_exposure = np.log(draws.exposure / ((capture.exposure_s or 1.0) * (capture.led_current_ma or 1.0)))
    return ObjectiveError(
        error_rel=Interval(estimate=float(np.median(error)), low95=float(low), high95=float(high)),
        log_ratio_draws=draws.log_ratio,
        log_exposure_draws=log_exposure,
        source="; ".join(known.keys) if known is not None else "no input with a known uncertainty",
        rig=capture.rig,
    )


def objective_through_curve(
    comparison: Comparison, nuisances: Nuisances, distance: Floats, capture: TactileCapture, rng: np.random.Generator
) -> ObjectiveError:
    r"""Return the error of the sweep's objective of a render in linear light against encoded values.

    Both sides are the brightness of the ring relative to the same pixels without contact: L1 / L0 of the render,
    :math:`\sum (D - b)^{1/p} / \sum (B - b)^{1/p}` of the capture, for the draws of exponent, offset and gains;
    exposure and white balance cancel. Inputs of the render that are known are drawn in their stored order.
    """
    render = nuisances.render
    usable = every_channel(np.isfinite(comparison.captured.contact))
    ring = ring_of(distance, usable)
    inputs = Inputs(render, pose_sd_mm(render, capture), None, None)
    known = inputs.draw(STORED_DRAWS, rng, paired=True)
    first, second = render.halves("contact", ring, inputs.pose_names)
    contact = known.weights @ ((first + second) / 2.0).mean(axis=0)
    rest = known.matrix @ render.no_contact[ring].mean(axis=0).astype(np.float64)
    of_render = np.log(np.maximum(contact, 1e-300) / np.maximum(rest, 1e-300))
    tone, gain = nuisances.tone, nuisances.gain
    drawn = np.zeros((0, 2)) if tone is None else tone.draws
    images, of_capture = (nuisances.contact, nuisances.no_contact), []
    for i in range(STORED_DRAWS):
        p, b = drawn[i % len(drawn)]
        change = np.zeros(3)
        if nuisances.is_corrected and gain is not None:
            change = np.where(gain.to_correct, gain.log_gain + gain.u * rng.standard_normal(3), 0.0)
        pressed, untouched = (np.maximum(image[ring] - b, 0.0) ** (1.0 / p) for image in images)
        of_capture.append(np.log(pressed.sum(axis=0) / untouched.sum(axis=0)) - change / p)
    captured = np.array(of_capture)
    draws = BrightnessDraws(of_render - captured, np.ones(STORED_DRAWS))
    error = draws.error_rel(np.exp(np.median(captured, axis=0)))
    low, high = ends(error)
    return ObjectiveError(
        error_rel=Interval(estimate=float(np.median(error)), low95=float(low), high95=float(high)),
        log_ratio_draws=draws.log_ratio,
        log_exposure_draws=None,
        source="; ".join(render.inputs.keys) if render.inputs is not None else "no input with a known uncertainty",
        rig=capture.rig,
    )


Evaluation = Literal["A", "B"]
ALONE_DRAWS = 4000
"""Draws of one line of the budget; its standard uncertainty is then known to 1 %."""


def uncertainty_budget(
    comparison: Comparison,
    inputs: Inputs,
    ring: NDArray[np.bool_],
    share: Floats,
    capture: TactileCapture,
    rng: np.random.Generator,
) -> tuple[InputUncertainty, ...]:
    """Return one line for each input, the largest first.

    Each input varies alone, the others at their means: for the skill as the captured levels have narrowed it, for the
    objective as it is known before. As the skill is no linear function of the inputs, which the capture has also tied
    to each other, the squares of the lines need not add up to the square of the whole.

    Parameters
    ----------
    comparison, inputs
        Both sides and what is uncertain.
    ring, share
        Pixels and weights of the objective, see :mod:`finray_calib.compare._photometric_error`.
    capture
        Tells where the uncertainty of the pose comes from.
    rng
        Of the draws.
    """
    origins = _origins(inputs, capture)
    lines = []
    before = inputs.draw(ALONE_DRAWS, rng)
    after = comparison.conditioned(before, rng)
    for name, (evaluation, source) in origins.items():
        noise = rng if name == PIXELS else None
        drawn = after.only(name)
        draws = propagated_draws(comparison.sums[-1], drawn, comparison.exposure_of(drawn.matrix, noise), noise)
        skill = draws.skill("simulation", comparison.channel_weights)
        objective = brightness_draws(comparison, inputs, ring, before.only(name), noise).error_rel(share)
        lines.append(
            InputUncertainty(
                input=name,
                evaluation=evaluation,
                source=source,
                skill_u=float(skill.std(ddof=1)),
                objective_u_rel=float(objective.std(ddof=1)),
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.skill_u))


def _origins(inputs: Inputs, capture: TactileCapture) -> dict[str, tuple[Evaluation, str]]:
    """Return kind and source of every input."""
    known = inputs.layers.inputs
    found: dict[str, tuple[Evaluation, str]] = {}
    if known is not None:
        found |= {n: (e, s) for n, e, s in zip(known.names, known.evaluations, known.sources, strict=True)}
    for name, sd_mm in inputs.pose_sd_mm.items():
        found[POSE[name]] = ("B", f"{sd_mm:g} mm, as {capture.name} states")
    if inputs.walls is not None:
        found[WALLS] = ("A", "difference of the render's independent halves, with a prior")
    if inputs.drift is not None:
        scale, freedom = inputs.drift
        origin = (
            f"{100 * scale:.2f} %, from the repeat of the no-contact image and from"
            if freedom > 3
            else f"{100 * PRIOR_DRIFT_REL:.1f} %, from"
        )
        found[DRIFT] = ("A" if freedom > 3 else "B", f"{origin} what real sensors show")
    found[PIXELS] = ("A", "difference of both no-contact images at pixel scale, and of the render's halves")
    return found


VALIDATION_DRAWS = 2000
COVERAGE_FACTOR = 2.0
_CHANNELS: Final[tuple[Literal["red", "green", "blue"], ...]] = ("red", "green", "blue")
_CONTACT = 1


def validation_cells(comparison: Comparison, inputs: Inputs, rng: np.random.Generator) -> tuple[ValidationCell, ...]:
    """Compare mean levels of 3 x 3 parts of the headline region, in each channel.

    With the simulated and captured means S and D, E = S - D and u_val^2 = u_num^2 + u_input^2 + u_D^2: render noise,
    paints with camera and pose as known before the capture, and noise with drift of the capture. The model's error lies
    in E +- 2 u_val; where abs(E) <= 2 u_val it is within the validation uncertainty. The area metric is the area
    between the distribution of S over its inputs and the captured D, its parts above and below D apart.

    References
    ----------
    ASME V&V 20-2009, sections 1 and 6; S. Ferson, W. L. Oberkampf, L. Ginzburg, Comput. Methods Appl. Mech. Eng. 197
    (2008) 2408.
    """
    levels, exposure, drawn = comparison.levels, comparison.exposure, inputs.draw(VALIDATION_DRAWS, rng)
    if levels is None:
        return ()
    walls = drawn.only(WALLS)
    steady = Inputs(inputs.layers, inputs.pose_sd_mm, None, None).draw(VALIDATION_DRAWS, rng)
    ratios = {name: levels.log_ratio(d, exposure)[:, _CONTACT] for name, d in (("walls", walls), ("inputs", steady))}
    simulated = np.exp(ratios["inputs"])
    error = np.exp(levels.log_ratio(inputs.best(), exposure)[0, _CONTACT]) - 1.0
    render = levels.render_variance[_CONTACT]
    camera = levels.noise_variance[_CONTACT] - render
    # the render's noise is known relative to the simulated level, all else is stated relative to the captured one
    u_numerical = (1.0 + error) * np.sqrt(render + ratios["walls"].var(axis=0, ddof=1))
    u_data = np.sqrt(camera + drawn.log_drift.var(ddof=1))
    u_input = simulated.std(axis=0, ddof=1)
    u_validation = np.sqrt(u_numerical**2 + u_input**2 + u_data**2)
    return tuple(
        ValidationCell(
            row=row,
            column=column,
            channel=channel,
            pixels=int(levels.pixels[i]),
            error_rel=float(error[c, i]),
            u_numerical_rel=float(u_numerical[c, i]),
            u_input_rel=float(u_input[c, i]),
            u_data_rel=float(u_data[c, i]),
            u_validation_rel=float(u_validation[c, i]),
            within=bool(abs(error[c, i]) <= COVERAGE_FACTOR * u_validation[c, i]),
            area_too_bright_rel=float(np.maximum(simulated[:, c, i] - 1.0, 0.0).mean()),
            area_too_dark_rel=float(np.maximum(1.0 - simulated[:, c, i], 0.0).mean()),
        )
        for i, (row, column) in enumerate(levels.places)
        for c, channel in enumerate(_CHANNELS)
    )
