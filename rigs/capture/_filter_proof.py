r"""Optical proof of the filters: whether white and laser-lit frames show what the wheel claims.

The rate of channel c behind filter f on the white tile is, up to one factor (aperture, lamp level, exposure),

.. math:: r_{fc} = \int T_f(\lambda) \, R_c(\lambda) \, L(\lambda) \, d\lambda

with the filter's nominal or measured transmission T, the camera's response R and the lamp's spectrum L. An exchange of
two filters that explains the measured logarithms clearly better than the claimed order convicts the wheel, and so does
one filter in the beam at all slots (a wheel that counts and does not turn). An exchange that explains them about as
well cannot be told from the claimed order, and is named.

The laser's line tells more. In the channel that sees it best the white tile behind the excitation filter x gives the
rate w of the line itself, and the sample under the laser behind a filter f no more light, wherever in its band:

.. math:: \frac{s_f}{w} \le \frac{\max_{\lambda \ge \lambda_L} T_f(\lambda) R(\lambda)}{T_x(\lambda_L) R(\lambda_L)}

because a paint sends back no more than falls on it, and nothing below the line. Were x and f exchanged, the ratio would
be that of the line, reflected by the sample, to what leaks through f: at least rho T_x / T_f at the line, with a
reflectance rho of the sample. A ratio far above the first convicts the wheel; one far below the second shows that x and
f are not exchanged, however alike the lamp makes them look.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandPassFilter, CaptureSession, FilterProof, SpectralCurve

FloatArray = NDArray[np.float64]

GRID_NM = np.arange(380.0, 781.0)
MODEL_SD_LN = 0.30
"""Standard deviation of ln(rate) around its prediction: response, lamp and filter data of a catalogue (about 30 %)."""
FLOOR_FRACTION = 0.02
"""Of a filter's brightest channel, which fills most of the camera's range: dimmer ones are mostly dark noise."""
TRUSTED_FRACTION = 0.1  # of a filter's brightest channel: bright enough, in one session, to be compared with the other
CLEAR_DIFFERENCE = 12.0
"""Of chi-square: an exchange this much better or worse is decided (odds of e^6)."""
LIT_SHARE = 0.5  # of the rate with the lamp on: what is left of it without the lamp, when the lamp lights the picture
LEAST_RATE_DN_PER_S = 1.0
LEAST_RELATIVE = 1e-6  # of all rates: a filter that passes nothing at all
FEWEST_COMMON = 3
LEAST_SIGNAL_FRACTION = 0.02
"""Of full scale: below it a change cannot be told from the dark level."""
TOO_DIM = "brighten the lamp, open the aperture, allow longer exposures, or correct black_level_dn of the rig file"
LARGEST_DRIFT_LN = 0.15
"""Of one filter against the median of all: lamps age and filters gather dust by a few per cent."""


def predicted_rates(
    filters: Sequence[BandPassFilter],
    filter_curves: Mapping[str, SpectralCurve],
    lamp: SpectralCurve,
    response: Sequence[SpectralCurve],
) -> FloatArray:
    """Return the relative rates of filters and channels on the white tile under the lamp, (F, 3).

    Parameters
    ----------
    filters
        What the wheel is said to hold.
    filter_curves
        Measured transmissions by the filter's name.
    lamp
        Relative spectral irradiance.
    response
        Relative response of red, green and blue.
    """
    light = lamp(GRID_NM) * np.array([curve(GRID_NM) for curve in response])
    return np.array([light @ transmission(f, filter_curves.get(f.name)) for f in filters])


def judge_filters(
    names: Sequence[str],
    measured: FloatArray,
    predicted: FloatArray,
    lamp_off: Callable[[str], Sequence[float]] = lambda name: (0.0, 0.0, 0.0),
    apart: Collection[frozenset[str]] = (),
    floor: FloatArray | None = None,
) -> FilterProof:
    """Return whether the measured rates show the filters in the claimed order.

    All exchanges of two filters are tried, and each filter at all slots. Another wrong order is seen as the exchange
    that undoes most of it.

    Parameters
    ----------
    names
        (F,) names of the filters in the claimed order.
    measured
        (F, 3) rates above the dark level, DN/s.
    predicted
        (F, 3) relative rates.
    lamp_off
        Returns the 3 rates behind a filter with the lamp off, DN/s. Asked only when all slots look alike: a camera that
        shows a picture of its own looks so, too.
    apart
        Pairs of filters that are known not to be exchanged, from the laser's line.
    floor
        (F,) rate that a filter's brightest channel must exceed to be a signal (:func:`signal_floor`), DN/s; filters
        below it are not judged.
    """
    seen = np.full(len(names), True) if floor is None else measured.max(axis=1) > floor
    if len(names) > 1 and 0 < seen.sum() < len(names):
        return _judge_seen(names, seen, measured, predicted, lamp_off, apart)
    if not seen.any():
        return FilterProof(verdict="cannot tell", text=f"the white tile gives no signal through any filter; {TOO_DIM}")
    if measured.max() < LEAST_RATE_DN_PER_S:
        return FilterProof(
            verdict="cannot tell",
            text="the white tile is dark through every filter, so the lamp is off or no light reaches the camera",
        )
    if len(names) < 2:
        return FilterProof(
            verdict="cannot tell", text="there is only one filter, so it cannot be compared with another one"
        )
    ln_measured, ln_predicted = _levels(measured), _levels(predicted)
    stuck = _only_filter(ln_measured, ln_predicted)
    if stuck is not None:
        still_lit = bool(sum(lamp_off(names[0])) > LIT_SHARE * measured[0].sum())
        return _alike_at_every_slot(names[stuck], still_lit)
    better, unclear_pairs = _exchanges(names, ln_measured, ln_predicted)
    if better:
        return FilterProof(
            verdict="contradicted",
            text=f"the frames fit much better with filters {max(better)[1]} exchanged; open the wheel and look, "
            "then correct the slots of the rig file, or put the filters into their slots",
        )
    unclear = [" and ".join(pair) for pair in unclear_pairs if frozenset(pair) not in apart]
    if unclear:
        # a picture that is the same at every slot leaves all pairs unclear
        others = f"; {FilterProof.others_in_place}" if 2 * len(unclear_pairs) < len(names) * (len(names) - 1) else ""
        return FilterProof(
            verdict="cannot tell", text="the frames cannot distinguish filters " + ", ".join(unclear) + others
        )
    return FilterProof(verdict="confirmed", text="the frames show every filter in its slot")


def _judge_seen(
    names: Sequence[str],
    seen: NDArray[np.bool_],
    measured: FloatArray,
    predicted: FloatArray,
    lamp_off: Callable[[str], Sequence[float]],
    apart: Collection[frozenset[str]],
) -> FilterProof:
    """Judge the filters that give a signal; the others are named, and nothing is confirmed of them."""
    unseen = ", ".join(name for name, is_seen in zip(names, seen, strict=True) if not is_seen)
    kept = [name for name, is_seen in zip(names, seen, strict=True) if is_seen]
    if len(kept) < FEWEST_COMMON:
        give = "filter gives" if len(kept) == 1 else "filters give"
        text = f"only {len(kept)} {give} a signal on the white tile; {TOO_DIM}"
        return FilterProof(verdict="cannot tell", text=text)
    proof = judge_filters(kept, measured[seen], predicted[seen], lamp_off, apart)
    verdict = proof.verdict if proof.verdict == "contradicted" else "cannot tell"
    dim = f"filter {unseen} is" if len(kept) == len(names) - 1 else f"filters {unseen} are"
    return FilterProof(verdict=verdict, text=f"{proof.text}; {dim} too dim to be judged ({TOO_DIM})")


def signal_floor(
    exposures_s: Sequence[float], full_scale_dn: float, uncertainty_dn_per_s: FloatArray | float = 0.0
) -> FloatArray:
    r"""Return the rate above which light is a signal (DN/s), for each exposure: 2 % of full scale and 5 u above that.

    .. math:: r > \frac{0.02 \, c_{max}}{t} + 5 u(r)

    Below it what is left of a wrong black level, dark current or noise looks like light of some colour.

    Parameters
    ----------
    exposures_s
        (F,) exposures (s).
    full_scale_dn
        Largest count of the camera (DN).
    uncertainty_dn_per_s
        Standard uncertainty u of the dark level (DN/s), (F,) or one for all.
    """
    return np.asarray(LEAST_SIGNAL_FRACTION * full_scale_dn / np.asarray(exposures_s) + 5.0 * uncertainty_dn_per_s)


def _alike_at_every_slot(name: str, still_lit: bool) -> FilterProof:
    """Return what frames prove that show one filter at every slot, whether or not the lamp is on."""
    if still_lit:
        return FilterProof(
            verdict="cannot tell",
            text="the picture is the same at every slot and hardly changes when the lamp goes off, so the camera "
            "does not see the lamp, or other light is much brighter",
        )
    return FilterProof(
        verdict="contradicted",
        text=f"the frames show filter {name} at every slot, so the wheel reports new slots but does not turn; check "
        "its motor, belt and filters",
    )


def _exchanges(
    names: Sequence[str], measured: FloatArray, predicted: FloatArray
) -> tuple[list[tuple[float, str]], list[tuple[str, str]]]:
    """Return the exchanges of two filters that explain the frames clearly better, and those that do so about as well.

    The former with what chi-square falls by.
    """
    order = np.arange(len(names))
    better: list[tuple[float, str]] = []
    unclear: list[tuple[str, str]] = []
    for first, second in combinations(range(len(names)), 2):
        exchanged = order.copy()
        exchanged[[first, second]] = exchanged[[second, first]]
        gain = _chi_square(measured, predicted) - _chi_square(measured, predicted[exchanged])
        pair = names[first], names[second]
        if gain > CLEAR_DIFFERENCE:
            better.append((gain, " and ".join(pair)))
        elif gain > -CLEAR_DIFFERENCE:
            unclear.append(pair)
    return better, unclear


def compare_with_last(
    names: Sequence[str], measured: FloatArray, last: CaptureSession, floor: FloatArray | None = None
) -> FilterProof:
    """Return whether the white rates are those of an earlier session, up to one factor (aperture, lamp level).

    Parameters
    ----------
    names
        (F,) names of the filters.
    measured
        (F, 3) rates above the dark level, DN/s.
    last
        The earlier session on the same rig.
    floor
        (F,) rate that a filter's brightest channel must exceed to be compared (:func:`signal_floor`), DN/s.
    """
    if measured.max() < LEAST_RATE_DN_PER_S:
        return FilterProof(
            verdict="cannot tell", text="the white tile is dark, so it cannot be compared with an earlier session"
        )
    before, unseen = _white_before(last)
    seen = np.full(len(names), True) if floor is None else measured.max(axis=1) > floor
    common = [name for name, is_seen in zip(names, seen, strict=True) if name in before and is_seen]
    if len(common) < FEWEST_COMMON:
        dim = "; the white tile was too dim in that session, so compare with another session" if unseen else ""
        dim = dim if seen.all() else f", of those that are bright enough; {TOO_DIM}"
        shared = f"only {len(common)} filter{'' if len(common) == 1 else 's'}" if common else "no filter"
        return FilterProof(verdict="cannot tell", text=f"the earlier session shares {shared} with this one{dim}")
    now, then = measured[[list(names).index(name) for name in common]], np.array([before[name] for name in common])
    bright = (_share_of_brightest(now) > TRUSTED_FRACTION) | (_share_of_brightest(then) > TRUSTED_FRACTION)
    apart = _levels(now) - _levels(then)
    off = np.where(bright, np.abs(apart - np.median(apart[bright])), 0.0).max(axis=1)
    worst = int(off.argmax())
    if off[worst] > LARGEST_DRIFT_LN:
        return FilterProof(
            verdict="contradicted",
            text=f"behind filter {common[worst]} the white tile differs from the earlier session by a factor of "
            f"{np.exp(off[worst]):.2f} (a factor of up to {np.exp(LARGEST_DRIFT_LN):.2f} counts as drift), "
            "so a filter was changed, soiled or slipped, or the lamp was replaced",
        )
    return FilterProof(
        verdict="confirmed",
        text=f"the white frames repeat those of the earlier session within {100 * np.expm1(off[worst]):.1f} % behind "
        f"{len(common)} filters",
    )


def _white_before(session: CaptureSession) -> tuple[dict[str, tuple[float, float, float]], int]:
    """Return the white rates of the filters that gave a signal in a session, and how many gave none."""
    exposures_s: dict[str, float] = {}
    for frame in session.frames:
        if frame.frame_type == "white":
            name = str(frame.filter_name)
            exposures_s[name] = max(frame.exposure_s, exposures_s.get(name, 0.0))
    floor = signal_floor(list(exposures_s.values()), 2**session.rig.camera.bit_depth - 1)
    known = list(zip(exposures_s, session.white_rates_dn_per_s, floor, strict=False))
    seen = {name: rates for name, rates, least in known if max(rates) > least}
    return seen, len(known) - len(seen)


def _only_filter(measured: FloatArray, predicted: FloatArray) -> int | None:
    """Return the filter that explains the frames of all slots, clearly better than the claimed order; None without."""
    alike = [_chi_square(measured, np.broadcast_to(row, measured.shape)) for row in predicted]
    best = int(np.argmin(alike))
    # one filter has one set of three errors of the model: a grey picture, of no camera that sees the lamp, fits none
    fits = _chi_square(measured.mean(axis=0), predicted[best]) < CLEAR_DIFFERENCE
    return best if fits and _chi_square(measured, predicted) - alike[best] > CLEAR_DIFFERENCE else None


def _levels(rates: FloatArray) -> FloatArray:
    """Return ln(rate) with the dim channels of each filter held at a floor."""
    brightest = np.maximum(rates.max(axis=1, keepdims=True), LEAST_RELATIVE * rates.max())
    return np.asarray(np.log(np.maximum(rates, FLOOR_FRACTION * brightest)))


def _share_of_brightest(rates: FloatArray) -> FloatArray:
    """Return each rate over the brightest of its filter."""
    brightest = np.maximum(rates.max(axis=1, keepdims=True), LEAST_RELATIVE * rates.max())
    return np.asarray(rates / brightest)


def _chi_square(measured: FloatArray, predicted: FloatArray) -> float:
    """Return the squared deviations over their variance after the best common factor."""
    apart = measured - predicted
    return float(np.square((apart - apart.mean()) / MODEL_SD_LN).sum())


def transmission(band: BandPassFilter, curve: SpectralCurve | None) -> FloatArray:
    """Return the transmission of a filter on the grid: the measured one where there is a curve."""
    floor = 10.0**-band.blocking_od
    if curve is not None:
        inside = (curve.wavelength_nm[0] <= GRID_NM) & (curve.wavelength_nm[-1] >= GRID_NM)
        return np.asarray(np.where(inside, np.maximum(curve(GRID_NM), floor), floor))
    off = np.abs(2 * (GRID_NM - band.center_nm) / band.fwhm_nm) ** (2 * band.shape_order)
    return np.asarray(band.peak_transmission * np.exp2(-np.minimum(off, 1000.0)) + floor)


CLEAR_FACTOR = float(np.exp(np.sqrt(2.0 * CLEAR_DIFFERENCE) * MODEL_SD_LN))
"""By which a ratio of two rates differs from its prediction before it decides."""
LEAST_REFLECTANCE = 0.01
"""Of a sample at the laser's wavelength: black flocking reflects as much."""
LEAST_LINE_RATE_DN_PER_S = 5.0
"""Of the line: dimmer ones may be dark current or stray light."""


class LaserLine:
    """What the laser shows behind the filters of a session.

    Parameters
    ----------
    filters
        (F,) what the wheel is said to hold.
    excitation
        Name of the filter that passes the laser.
    laser_nm
        Wavelength of the laser.
    filter_curves
        Measured transmissions by the filter's name.
    response
        Relative response of red, green and blue.
    white_dn_per_s
        Rates of red, green and blue on the white tile under the laser behind the excitation filter.
    sample_dn_per_s
        (F, 3) those of the sample under the laser behind each filter.
    white_floor_dn_per_s, sample_floor_dn_per_s
        Rates above which light is a signal (:func:`signal_floor`), DN/s: of the white tile, and (F,) of the sample.
    """

    def __init__(
        self,
        filters: Sequence[BandPassFilter],
        excitation: str,
        laser_nm: float,
        filter_curves: Mapping[str, SpectralCurve],
        response: Sequence[SpectralCurve],
        white_dn_per_s: Sequence[float],
        sample_dn_per_s: Sequence[Sequence[float]],
        white_floor_dn_per_s: float = 0.0,
        sample_floor_dn_per_s: Sequence[float] | FloatArray = (),
    ) -> None:
        curves = np.array([curve(GRID_NM) for curve in response])
        line = int(np.abs(GRID_NM - laser_nm).argmin())
        self._channel = channel = int(curves[:, line].argmax())
        passed = {f.name: transmission(f, filter_curves.get(f.name)) for f in filters}
        through = passed[excitation][line]
        others = [(k, f) for k, f in enumerate(filters) if f.name != excitation]
        self._excitation, self._others = excitation, [f.name for _, f in others]
        sent = np.array([(passed[f.name] * curves[channel])[line:].max() for _, f in others])
        # what a filter should not pass at all may still be stray light: never more than the line itself
        self._most = np.maximum(sent / max(through * curves[channel, line], LEAST_RELATIVE), 1.0)
        leaks = np.array([passed[f.name][line] * 10.0**f.blocking_uncertainty_od for _, f in others])
        self._if_exchanged = LEAST_REFLECTANCE * through / leaks
        self._rates = np.array([sample_dn_per_s[k][channel] for k, _ in others])
        self._floor = max(white_floor_dn_per_s, LEAST_LINE_RATE_DN_PER_S)
        self._white = max(float(white_dn_per_s[channel]), self._floor)
        self._signals = np.array(
            [
                len(sample_floor_dn_per_s) == 0 or self._rates[n] > sample_floor_dn_per_s[k]
                for n, (k, _) in enumerate(others)
            ]
        )

    def judge(self, laser_off: Callable[[str], Sequence[float]]) -> FilterProof:
        """Return whether the laser's line comes through the excitation filter.

        Parameters
        ----------
        laser_off
            Returns the 3 rates of the sample behind a filter with the laser off, DN/s. Asked only before a
            conviction: a camera that shows a picture of its own does not see the laser.
        """
        if not self._others:
            return FilterProof(verdict="cannot tell", text="no other filter of the rig could pass the laser's line")
        most = int(np.where(self._signals, self._rates / self._most, -np.inf).argmax())
        name, rate = self._others[most], float(self._rates[most])
        if self._signals[most] and rate > CLEAR_FACTOR * self._most[most] * self._white:
            if laser_off(name)[self._channel] > LIT_SHARE * rate:
                return FilterProof(verdict="cannot tell", text="the sample looks the same when the laser goes off")
            return FilterProof(
                verdict="contradicted",
                text=f"under the laser the sample behind filter {name} is {rate / self._white:.3g} times as bright as "
                f"the laser's line on the white tile behind filter {self._excitation}, which is not possible for a "
                f"paint. {self._excitation} and {name} are exchanged, or the laser did not reach the tile; look into "
                "the wheel and correct the slots of the rig file, or correct the places of filters and tile",
            )
        if not self._is_seen():
            return FilterProof(verdict="cannot tell", text="the camera does not see the laser's line")
        unclear = [other for other in self._others if other not in self.not_exchanged()]
        if unclear:
            return FilterProof(
                verdict="cannot tell",
                text=f"the laser's line comes through {self._excitation} or {' or '.join(unclear)}",
            )
        return FilterProof(verdict="confirmed", text=f"only filter {self._excitation} passes the laser's line")

    def not_exchanged(self) -> frozenset[str]:
        """Return the names of the filters that the line shows not to be in the excitation filter's place."""
        if not self._others or not self._is_seen():
            return frozenset()
        clear = self._rates * CLEAR_FACTOR < self._if_exchanged * self._white
        return frozenset(name for name, is_clear in zip(self._others, clear, strict=True) if is_clear)

    def _is_seen(self) -> bool:
        """Whether the line is there, and fades behind some filter as a picture of the camera's own would not."""
        return self._white > self._floor and float(self._rates.min()) < LIT_SHARE * self._white
