"""The camera between a render and a capture: an unknown tone curve, and gains that differ between two captures.

An 8-bit camera turns light L into DN = b + s L^p with an offset b and a scale s per channel (white balance). A render
in linear light meets such a capture in the ratio form

    S = b + (B - b) (L1 / L0)^p

with the captured no-contact image B and the render without and with contact, L0 and L1: scales, and every error of the
render's level, cancel, and a render that contact does not change gives S = B, whatever b and p are. Both are estimated
from the two no-contact images alone: fitted to the contact, a curve lets a render that knows nothing earn a score.

Beyond three half-widths from the contact the light should be that of no contact. What all of those pixels share is a
gain of the camera or of the light, channel by channel, and no effect of the touch.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import FittedToneCurve, Interval, WhiteBalanceDrift
from finray_calib.compare._image_noise import block_mean
from finray_calib.compare._region_sums import RenderLayers
from finray_calib.compare._regions import every_channel
from finray_calib.spectra import compiled

Floats = NDArray[np.float64]
#: Draws of the curve that are stored; with the first of them, and draws of the gains, the score is formed.
CURVE_DRAWS, NUISANCE_DRAWS = 200, 40
_BLOCK_PX = 8
_LEAST_BLOCKS = 24
_TILES = 3
#: Cameras of 8-bit images follow sRGB or nearly so; few are linear. (probability, exponent, its sd, offset, its sd),
#: the exponent at the mean level of the picture, offsets as a share of full scale: sRGB's own is -0.055 with 1 / 2.4.
_PRIORS = ((0.8, 0.45, 0.05, -0.027, 0.03), (0.2, 1.0, 0.05, 0.0, 0.03))
_EXPONENTS = np.linspace(0.2, 1.3, 111)
_OFFSETS = np.linspace(-0.11, 0.06, 18)
_LEAST_ABOVE_OFFSET = 0.005
#: Errors of a render that are as smooth as a ninth of the picture is large show in part only when one is left out: with
#: this factor 95 % intervals held the exponent of simulated pads in 91 to 99 % of the trials, by kind of curve and
#: error.
_SEEN_BY_PARTS = 0.4


@dataclass(frozen=True, slots=True)
class ToneFit:
    """Hold the curve DN = b + s L^p between a render and a capture without contact.

    Attributes
    ----------
    exponent, offset_dn : float
        Medians.
    draws : ndarray, shape (D, 2)
        Exponent and offset in DN.
    log_light : ndarray, shape (blocks, 3)
        Logarithm of the render's level, relative to each channel's mean.
    level_dn : ndarray, shape (blocks, 3)
        Of the capture.
    correlation : float
        Mean over channels of the correlation of the logarithms of both; 0 without contrast.
    white_balance_noise_rel : float
        Share of the light's own error that is left in the mean of a channel: few values of a pad are independent.
    lit : ndarray of bool, shape (3,)
        Channels in which the render has light: the others tell nothing of the curve.
    """

    exponent: float
    offset_dn: float
    draws: Floats
    log_light: Floats
    level_dn: Floats
    correlation: float
    white_balance_noise_rel: float
    lit: NDArray[np.bool_]

    def white_balance(self, light: Floats) -> tuple[Interval | None, Interval | None, Interval | None]:
        """Return the scale of each channel in linear light, relative to green; None without light in it or in green.

        Parameters
        ----------
        light : ndarray, shape (3,)
            Mean of the logarithm of the render's level per channel.
        """
        logs = [np.log(np.maximum(self.level_dn - b, 1e-3)) / p for p, b in self.draws]
        scale = np.array([log.mean(axis=0) - light for log in logs])
        scale -= scale[:, 1:2]
        # what the render's light is wrong by does not average out over a pad of few independent values
        left = np.mean([(_centred(log) - self.log_light).var(axis=0) for log in logs], axis=0)
        of_light = (left + left[1]) * self.white_balance_noise_rel**2 * (np.arange(3) != 1)
        half = 1.96 * np.sqrt(scale.var(axis=0) + of_light)
        red, green, blue = (
            Interval(estimate=float(np.exp(m)), low95=float(np.exp(m - h)), high95=float(np.exp(m + h)))
            if lit and self.lit[1]
            else None
            for m, h, lit in zip(np.median(scale, axis=0), half, self.lit, strict=True)
        )
        return red, green, blue


def fit_tone(
    render: Floats, captured: Floats, pad: NDArray[np.bool_], full_scale_dn: float, rng: np.random.Generator
) -> ToneFit:
    r"""Estimate exponent and offset from the no-contact images of a render and of a capture.

    With x = ln L and y = ln(B - b) of blocks, less their means per channel, the residual is y - p x where the capture's
    own texture is what the render does not know, and x - y / p where the render's light is wrong. Which of the two, the
    images do not tell, so that the likelihood is the mean of both. Each is that of a normal residual of unknown size
    over n independent values, :math:`(\overline{e^2} / v)^{-n/2}`, with the variance v of y or x; n follows from how
    much the slope changes when a ninth of the picture is left out (jackknife), as errors of a render are smooth. The
    prior joins cameras near sRGB (exponent 0.45 +- 0.05 at the mean level) and linear ones. Of a pad without contrast
    the prior stays.

    Parameters
    ----------
    render, captured : ndarray, shape (H, W, 3)
        Without contact; captured DN above the recorded black level, NaN where clipped.
    pad : ndarray of bool, shape (H, W)
        Pixels that see the pad.
    full_scale_dn : float
    rng : numpy.random.Generator

    Returns
    -------
    ToneFit
    """
    log_light, level_dn, tile, lit = _levels(render, captured, pad)
    x, level = log_light[:, lit], level_dn[:, lit]
    grid_p, grid_b, log_density = [], [], []
    independent = _independent_values(x, np.log(level), tile)
    for share in _OFFSETS:
        b = share * full_scale_dn
        if b > level.min() - _LEAST_ABOVE_OFFSET * full_scale_dn:
            continue
        y = _centred(np.log(level - b))
        mean_dn = float(level.mean())
        p = _EXPONENTS * mean_dn / (mean_dn - b)
        grid_p.append(p)
        grid_b.append(np.full(p.shape, b))
        log_density.append(_log_prior(_EXPONENTS, share) + _log_likelihood(x, y, p, independent))
    exponents, offsets, density = (np.concatenate(part) for part in (grid_p, grid_b, log_density))
    chance = np.exp(density - density.max())
    chosen = rng.choice(len(chance), size=CURVE_DRAWS, p=chance / chance.sum())
    steps = (_EXPONENTS[1] - _EXPONENTS[0], (_OFFSETS[1] - _OFFSETS[0]) * full_scale_dn)
    jitter = rng.uniform(-0.5, 0.5, (CURVE_DRAWS, 2)) * steps
    jitter[:, 1] = np.minimum(jitter[:, 1], 0.0) if level.min() - offsets.max() < steps[1] else jitter[:, 1]
    draws = np.stack([exponents[chosen], offsets[chosen]], axis=1) + jitter
    order = np.argsort(exponents)
    cumulative = np.cumsum(chance[order]) / chance.sum()
    exponent = float(exponents[order][np.searchsorted(cumulative, 0.5)])
    near = np.abs(exponents - exponent) <= 2.0 * steps[0]
    offset_dn = float((chance * offsets)[near].sum() / chance[near].sum())
    noise_rel = 1.0 / np.sqrt(max(independent / x.shape[1], 1.0))
    correlation = _correlation(x, _centred(np.log(level)))
    return ToneFit(exponent, offset_dn, draws, log_light, level_dn, correlation, noise_rel, lit)


def _levels(
    render: Floats, captured: Floats, pad: NDArray[np.bool_]
) -> tuple[Floats, Floats, NDArray[np.intp], NDArray[np.bool_]]:
    """Return centred ln L and B of blocks (blocks, 3), the tile (a ninth of the picture) of each, and lit channels.

    A channel in which most of the render is black, or the capture, is not lit: its ln L is 0. With fewer than 24 blocks
    of light in both, one block of no contrast stands for the picture: only the prior is left.
    """
    side = max(1, min(_BLOCK_PX, min(pad.shape) // 15))
    light, dn = block_mean(render.astype(np.float64), side), block_mean(captured, side)
    inside = block_mean(pad.astype(np.float64), side) > 0.999
    usable = np.isfinite(dn) & (dn > 0.0) & (light > 0.0)
    lit = usable[inside].mean(axis=0) > 0.5 if inside.any() else np.zeros(3, dtype=np.bool_)
    used = inside & every_channel(usable | ~lit)
    if used.sum() < _LEAST_BLOCKS or not lit.any():
        middle = float(np.nanmedian(captured)) if np.isfinite(captured).any() else 1.0
        every = np.ones(3, dtype=np.bool_)
        return np.zeros((1, 3)), np.full((1, 3), max(middle, 1.0)), np.zeros(1, dtype=np.intp), every
    rows, columns = np.nonzero(used)
    tile = rows * _TILES // used.shape[0] * _TILES + columns * _TILES // used.shape[1]
    logs = np.log(np.where(lit, light[used], 1.0))
    level = np.where(lit, dn[used], np.maximum(np.nan_to_num(dn[used]), 1e-3))
    return _centred(logs), level, np.asarray(tile, dtype=np.intp), lit


def _centred(values: Floats) -> Floats:
    """Return values less their mean over blocks."""
    return np.asarray(values - values.mean(axis=0))


def _correlation(x: Floats, y: Floats) -> float:
    """Return the correlation of centred values, mean over channels; 0 where one has no contrast."""
    norm = np.sqrt((x**2).sum(axis=0) * (y**2).sum(axis=0))
    return float(np.divide((x * y).sum(axis=0), norm, out=np.zeros_like(norm), where=norm > 0.0).mean())


def _independent_values(x: Floats, log_level: Floats, tile: NDArray[np.intp]) -> float:
    """Return how many independent values the slope of x over y rests on, by leaving out one tile after the other."""
    y = _centred(log_level)
    square, product = (y * y).sum(axis=1), (x * y).sum(axis=1)
    tiles = np.unique(tile)
    if len(tiles) < _TILES or not square.sum() > 0.0:
        return 2.0
    slopes = np.array([product[tile != t].sum() / max(square[tile != t].sum(), 1e-300) for t in tiles])
    variance = (len(tiles) - 1) / len(tiles) * ((slopes - slopes.mean()) ** 2).sum()
    residual = float(((x - y * product.sum() / square.sum()) ** 2).mean())
    found = _SEEN_BY_PARTS * residual / max(float(variance) * float((y * y).mean()), 1e-300)
    return float(np.clip(found, 2.0, x.size))


def _log_prior(exponent: Floats, offset_share: float) -> Floats:
    """Return the logarithm of the prior density, but for a constant."""
    parts = [
        share
        / (sd * offset_sd)
        * np.exp(-0.5 * ((exponent - p) / sd) ** 2 - 0.5 * ((offset_share - b) / offset_sd) ** 2)
        for share, p, sd, b, offset_sd in _PRIORS
    ]
    return np.asarray(np.log(np.maximum(sum(parts), 1e-300)))


def _log_likelihood(x: Floats, y: Floats, p: Floats, independent: float) -> Floats:
    """Return the logarithm of the likelihood of exponents p (n,), the mean of both kinds of residual."""
    xx, yy, xy = ((a * b).mean() for a, b in ((x, x), (y, y), (x, y)))
    if not (xx > 0.0 and yy > 0.0):
        return np.zeros(len(p))
    # a residual below a thousandth of the contrast is rounding
    of_capture = np.maximum((yy - 2.0 * p * xy + p**2 * xx) / yy, 1e-6)
    of_render = np.maximum((xx - 2.0 * xy / p + yy / p**2) / xx, 1e-6)
    logs = [-0.5 * independent * np.log(share) for share in (of_capture, of_render)]
    return np.asarray(np.logaddexp(*logs) - np.log(2.0))


def encoded_layers(linear: RenderLayers, no_contact: Floats, exponent: float, offset_dn: float) -> RenderLayers:
    """Return a render in linear light as the capture's camera would show it: S = b + (B - b) (L1 / L0)^p.

    Where the render or the capture is black without contact nothing can be said, and S = B. The noise of the render's
    halves goes along to first order: h = (S - b) p (h1 / L1 - h0 / L0).

    Parameters
    ----------
    linear : RenderLayers
    no_contact : ndarray, shape (H, W, 3)
        Captured, DN above the recorded black level.
    exponent, offset_dn : float
        p and b.
    """
    rest, pressed = linear.rgb(linear.no_contact), np.maximum(linear.rgb(linear.contact), 0.0)
    light = (rest > 0.0) & (no_contact > offset_dn)
    ratio = np.divide(pressed, rest, out=np.ones_like(rest), where=light)
    base = np.where(light, no_contact - offset_dn, 0.0)
    shown = no_contact + base * (ratio**exponent - 1.0)
    halves = [
        np.divide(linear.rgb(half), image, out=np.zeros_like(image), where=light & (image > 0.0))
        for half, image in ((linear.contact_half, pressed), (linear.no_contact_half, rest))
    ]
    half = (base + shown - no_contact) * exponent * (halves[0] - halves[1])
    none = np.zeros((0, *shown.shape), dtype=np.float32)
    # a pixel that the camera clipped is left out of every sum, and a layer must be a number
    missing = ~np.isfinite(shown)
    return RenderLayers(
        contact=np.where(missing, 0.0, shown).astype(np.float32),
        no_contact=np.where(missing, 0.0, no_contact).astype(np.float32),
        contact_half=np.where(missing, 0.0, half).astype(np.float32),
        no_contact_half=np.zeros(shown.shape, dtype=np.float32),
        pose=none,
        pose_half=none,
        pose_names=(),
        names=("red", "green", "blue"),
        matrix=np.eye(3),
        inputs=None,
    )


def tone_record(tone: ToneFit, light: Floats, skill_u: float, outside_share: float) -> FittedToneCurve:
    """Return the record of a fitted curve.

    Parameters
    ----------
    tone : ToneFit
    light : ndarray, shape (3,)
        Mean of the logarithm of the render's level.
    skill_u : float
        Standard uncertainty of the headline skill from curve and gains.
    outside_share : float
        Pixels of the headline region whose captured level does not occur without contact.
    """
    return FittedToneCurve(
        exponent=_interval(tone.draws[:, 0], tone.exponent),
        offset_dn=_interval(tone.draws[:, 1], tone.offset_dn),
        white_balance=tone.white_balance(light),
        correlation=tone.correlation,
        skill_u=skill_u,
        outside_share=outside_share,
        log_light=tone.log_light,
        level_dn=tone.level_dn,
        draws=tone.draws,
    )


def _interval(values: Floats, best: float) -> Interval:
    """Return the 95 % interval of draws around a best value."""
    low, high = np.quantile(values, (0.025, 0.975))
    return Interval(estimate=best, low95=min(float(low), best), high95=max(float(high), best))


#: Beyond this many half-widths from the contact the light should be that of no contact.
FAR = 3.0
#: A gain below this is none; beyond the others it is told, or refused.
LEAST_GAIN_REL, REFUSED_GAIN_REL, REFUSED_UNEVEN_REL = 0.01, 0.15, 0.05
_FAR_BLOCK_PX, _LEAST_FAR_BLOCKS, _LEAST_VALID = 16, 8, 0.6
_TRIM_SD, _SURE_SD = 3.0, 3.0
#: Neighbouring blocks go together: four of them count as one.
_BLOCKS_AS_ONE = 4.0
_DARKEST_SHARE, _BRIGHTEST_SHARE = 0.02, 0.98


@dataclass(frozen=True, slots=True)
class FarGain:
    """Hold the gain of contact over no contact far from the contact, per channel; arrays of shape (3,).

    Attributes
    ----------
    log_captured, log_simulated : ndarray
        Logarithm of contact over no contact, of the capture and of the render.
    noise_u : ndarray
        Standard uncertainty of their difference from how much the blocks scatter.
    u : ndarray
        Of the captured one as a gain: half of what it changes from the middle of the frame to its edge, and half of
        what it changes with the distance from the contact, are in it. What fades with the distance is an effect of the
        touch.
    uneven : ndarray
        Change of the difference across the frame.
    blocks : ndarray of int
    """

    log_captured: Floats
    log_simulated: Floats
    noise_u: Floats
    u: Floats
    uneven: Floats
    blocks: NDArray[np.int64]

    @property
    def log_gain(self) -> Floats:
        """Logarithm of the gain after what the render expects."""
        return np.asarray(self.log_captured - self.log_simulated)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Channels whose level far from the contact changed by more than noise and 1 %."""
        return self._stands_out(self.log_gain, self.noise_u)

    @property
    def to_correct(self) -> NDArray[np.bool_]:
        """Channels of the capture with a gain, whether the render has the same or not.

        Where one channel shows that the camera or the light changed, what the others show is taken for the same.
        """
        sure = self._stands_out(self.log_captured, self.u)
        return self._stands_out(self.log_captured, self.noise_u) if sure.any() else sure

    @property
    def is_refused(self) -> bool:
        """Whether a gain is too large, or changes too much across the frame, to be taken out."""
        size = np.abs(self.log_gain)
        large = size > np.log1p(REFUSED_GAIN_REL)
        uneven = (size > np.log1p(REFUSED_UNEVEN_REL)) & (self.uneven > size)
        return bool((self.seen & (large | uneven)).any())

    def _stands_out(self, values: Floats, u: Floats) -> NDArray[np.bool_]:
        beyond = np.abs(values) > np.maximum(np.log1p(LEAST_GAIN_REL), _SURE_SD * u)
        return np.asarray(beyond & (self.blocks >= _LEAST_FAR_BLOCKS))


def far_gain(
    captured: tuple[Floats, Floats], simulated: tuple[Floats, Floats], distance: Floats, full_scale_dn: float
) -> FarGain | None:
    """Estimate the gain per channel between two captures from blocks of pixels far from the contact.

    The logarithm of the ratio of sums over blocks of 16 px beyond three half-widths, between 2 % and 98 % of full
    scale, trimmed at three standard deviations (by the median). Valid for encoded values too where the curve is a
    power: a gain of the light is then a factor.

    Parameters
    ----------
    captured, simulated : two ndarrays, shape (H, W, 3)
        Contact and no contact; NaN where clipped. Simulated ones in the same values (light, or through the curve).
    distance : ndarray, shape (H, W)
        From the contact, half-widths.
    full_scale_dn : float

    Returns
    -------
    FarGain or None
        None where no channel has eight blocks: it cannot be told.
    """
    side = max(1, min(_FAR_BLOCK_PX, min(distance.shape) // 15))
    far, away = distance > FAR, block_mean(np.nan_to_num(distance), side)
    # the compiled sums read without bounds
    images = [np.broadcast_to(image, (*distance.shape, 3)) for image in (*captured, *simulated)]
    contact, rest, rendered, rendered_rest = (np.ascontiguousarray(image) for image in images)
    levels = np.array([_DARKEST_SHARE, _BRIGHTEST_SHARE]) * full_scale_dn
    sums = np.zeros((5, *away.shape, 3))
    _add_usable(contact, rest, rendered, rendered_rest, far, levels, side, sums)
    share = sums[4] / side**2
    found = [_channel_gain(share[..., c], sums[:4, ..., c], away) for c in range(3)]
    real, expected, noise_u, u, uneven, blocks = (np.array(values) for values in zip(*found, strict=True))
    if blocks.max() < _LEAST_FAR_BLOCKS:
        return None
    return FarGain(real, expected, noise_u, u, uneven, blocks.astype(np.int64))


@compiled
def _add_usable(
    contact: Floats,
    rest: Floats,
    rendered: Floats,
    rendered_rest: Floats,
    far: NDArray[np.bool_],
    levels: Floats,
    side: int,
    sums: Floats,
) -> None:
    """Add the far pixels (H, W, 3) between two levels to the sums of blocks, and last their number: (5, rows, ...)."""
    darkest, brightest = levels
    for row in range(sums.shape[1] * side):
        for column in range(sums.shape[2] * side):
            if not far[row, column]:
                continue
            i, j = row // side, column // side
            for c in range(3):
                a, b = contact[row, column, c], rest[row, column, c]
                if darkest < a < brightest and darkest < b < brightest:
                    sums[4, i, j, c] += 1.0
                    sums[0, i, j, c] += a
                    sums[1, i, j, c] += b
                    sums[2, i, j, c] += rendered[row, column, c]
                    sums[3, i, j, c] += rendered_rest[row, column, c]


def _channel_gain(share: Floats, sums: Floats, away: Floats) -> tuple[float, float, float, float, float, int]:
    """Return what `FarGain` holds of one channel; zeros if unknown.

    Of each block: the share of its pixels that are usable, their sums in the four images, and its distance.
    """
    used = (share >= _LEAST_VALID) & (sums > 0.0).all(axis=0)
    blocks = int(used.sum())
    if blocks < _LEAST_FAR_BLOCKS:
        return 0.0, 0.0, 0.0, 0.0, 0.0, blocks
    logs = np.log(sums[:, used])
    real, expected = logs[0] - logs[1], logs[2] - logs[3]
    gain = real - expected
    off = np.abs(gain - np.median(gain))
    kept = off <= _TRIM_SD * 1.4826 * np.median(off) + 1e-4
    place = np.array(np.nonzero(used)).T / np.array(used.shape) - 0.5
    away = away[used]
    reach = float(np.ptp(away[kept])) or 1.0
    terms = np.column_stack([np.ones(len(gain)), place, (away - away.mean()) / reach])[kept]
    slopes = np.linalg.lstsq(terms, np.column_stack([gain, real])[kept], rcond=None)[0]
    uneven, of_capture = (float(np.abs(slope[1:3]).sum()) for slope in slopes.T)
    noise_u = float(gain[kept].std() / np.sqrt(max(kept.sum() / _BLOCKS_AS_ONE, 1.0)))
    u = float(np.sqrt(noise_u**2 + (of_capture / 4.0) ** 2 + (slopes[3, 1] / 2.0) ** 2))
    return float(real[kept].mean()), float(expected[kept].mean()), noise_u, u, uneven, blocks


def drift_record(gain: FarGain, is_corrected: bool) -> WhiteBalanceDrift:
    """Return the record of the gains far from the contact."""

    def three(values: Floats) -> tuple[float, float, float]:
        first, second, third = (float(v) for v in values)
        return first, second, third

    return WhiteBalanceDrift(
        gains=three(np.exp(gain.log_captured)),
        expected_gains=three(np.exp(gain.log_simulated)),
        u_rel=three(gain.u),
        uneven_rel=three(gain.uneven),
        blocks=tuple(int(n) for n in gain.blocks),  # type: ignore[arg-type]
        corrected=is_corrected,
    )


def without_gain(image: Floats, log_gain: Floats, offset_dn: float) -> Floats:
    """Return an image at the light of another one: b + (image - b) / gain, per channel."""
    changed = np.subtract(image, offset_dn, dtype=np.float64)
    changed *= np.expm1(-log_gain)
    changed += image
    return np.asarray(changed)


def layers_without_gain(layers: RenderLayers, log_gain: Floats, offset_dn: float) -> RenderLayers:
    """Return a render whose layers are its three channels without a gain of the contact image."""
    contact = without_gain(layers.contact.astype(np.float64), log_gain, offset_dn).astype(np.float32)
    if layers.rest_noise is not None:
        layers = replace(layers, rest_noise=layers.rest_noise * np.exp(-2.0 * log_gain))
    if not layers.contact_half.any():
        return replace(layers, contact=contact)
    return replace(layers, contact=contact, contact_half=(layers.contact_half * np.exp(-log_gain)).astype(np.float32))
